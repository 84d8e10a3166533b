//! Pieces of a block in fixed-size arrays: loops of known length over them vectorise and need no allocation.

use caphy_core::Real;

/// Elements per piece: four AVX-512 registers of f32, small enough that all arrays of a piece stay in the first cache.
pub(crate) const CHUNK: usize = 64;

/// One value per element of a piece.
pub(crate) type Row<T> = [T; CHUNK];

/// `value` held inside [low, high]; NaN becomes `low`.
#[inline(always)]
pub(crate) fn clamp<T: Real>(value: T, low: T, high: T) -> T {
    if value > high {
        high
    } else if value >= low {
        value
    } else {
        low
    }
}

/// Largest strain that enters an energy: its square times [`crate::bounds::LARGEST_STIFFNESS`] is finite.
#[inline(always)]
pub(crate) fn strain_limit<T: Real>() -> T {
    T::of(if size_of::<T>() == 4 { 1e14 } else { 1e100 })
}

/// The whole part of a value in [0, 2³¹) as an index.
#[inline(always)]
pub(crate) fn index<T: Real>(whole: T) -> usize {
    whole.to_f64() as i32 as usize
}

/// Elements `start..start + CHUNK` of a row, zero behind its end.
#[inline(always)]
pub(crate) fn load<T: Real>(row: &[T], start: usize) -> Row<T> {
    let mut piece = [T::zero(); CHUNK];
    let rest = &row[start..];
    match rest.first_chunk::<CHUNK>() {
        Some(full) => piece = *full,
        None => piece[..rest.len()].copy_from_slice(rest),
    }
    piece
}

/// Writes a piece back, without what lies behind the row's end.
#[inline(always)]
pub(crate) fn store<T: Real>(row: &mut [T], start: usize, piece: &Row<T>) {
    let rest = &mut row[start..];
    match rest.first_chunk_mut::<CHUNK>() {
        Some(full) => *full = *piece,
        None => {
            let count = rest.len();
            rest.copy_from_slice(&piece[..count]);
        }
    }
}
