//! Pieces of a block in fixed-size arrays: loops of known length over them vectorise and need no allocation.

use caphy_core::Real;

/// Elements per piece: four AVX-512 registers of f32, small enough that all arrays of a piece stay in the first cache.
pub(crate) const CHUNK: usize = 64;

/// One value per element of a piece.
pub(crate) type Row<T> = [T; CHUNK];

/// `value` held inside [low, high]; NaN becomes `low`. Written as the processor's max and min are.
#[inline(always)]
pub(crate) fn clamp<T: Real>(value: T, low: T, high: T) -> T {
    let value = if value > low { value } else { low };
    if value < high { value } else { high }
}

/// The whole part of a value in [0, 2³¹) as an index.
#[inline(always)]
pub(crate) fn index<T: Real>(whole: T) -> usize {
    whole.to_f64() as i32 as usize
}

/// Elements `start..start + CHUNK` of a row: in place when there are as many, else copied to `spare`, zero behind the end.
#[inline(always)]
pub(crate) fn piece<'a, T: Real>(row: &'a [T], start: usize, spare: &'a mut Row<T>) -> &'a Row<T> {
    let rest = &row[start..];
    match rest.first_chunk::<CHUNK>() {
        Some(full) => full,
        None => {
            *spare = [T::zero(); CHUNK];
            spare[..rest.len()].copy_from_slice(rest);
            spare
        }
    }
}

/// The rest of a row, zero behind its end.
#[inline(always)]
pub(crate) fn padded<T: Real>(rest: &[T]) -> Row<T> {
    let mut row = [T::zero(); CHUNK];
    row[..rest.len()].copy_from_slice(rest);
    row
}

/// Shadows each row by its elements `start..start + CHUNK`: in place when there are as many, else a copy that is only made
/// then (clearing room for it on every call costs more than the copies).
macro_rules! in_pieces {
    ($start:expr; $($row:ident),*) => {
        $(
            let rest = &$row[$start..];
            let spare;
            let $row = match rest.first_chunk::<CHUNK>() {
                Some(full) => full,
                None => {
                    spare = crate::chunk::padded(rest);
                    &spare
                }
            };
        )*
    };
}
pub(crate) use in_pieces;

/// Writes `value(i)` to the elements `start..start + CHUNK` of a row, as far as it goes.
#[inline(always)]
pub(crate) fn write<T: Real>(row: &mut [T], start: usize, value: impl Fn(usize) -> T) {
    let rest = &mut row[start..];
    match rest.first_chunk_mut::<CHUNK>() {
        Some(full) => {
            for i in 0..CHUNK {
                full[i] = value(i);
            }
        }
        None => {
            for (i, out) in rest.iter_mut().enumerate() {
                *out = value(i);
            }
        }
    }
}
