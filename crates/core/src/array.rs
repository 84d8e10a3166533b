//! Slices that cross the C ABI: pointer and length, nullable, `repr(C)`.
//!
//! They are only ever made from Rust slices on this side, so reading them back is sound; a C plugin sees
//! `{ const T *data; size_t len; }`.

use std::marker::PhantomData;

/// A borrowed input array; [`In::absent`] is the null one.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct In<'a, T> {
    data: *const T,
    len: usize,
    life: PhantomData<&'a [T]>,
}

// SAFETY: `In` is a shared slice in other clothes and inherits the slice's thread safety.
unsafe impl<T: Sync> Send for In<'_, T> {}
// SAFETY: as above.
unsafe impl<T: Sync> Sync for In<'_, T> {}

impl<'a, T> In<'a, T> {
    /// No array.
    pub fn absent() -> Self {
        Self { data: std::ptr::null(), len: 0, life: PhantomData }
    }
    /// The array, or `None` when absent.
    #[inline(always)]
    pub fn get(&self) -> Option<&'a [T]> {
        if self.data.is_null() {
            None
        } else {
            // SAFETY: non-null pointers come from `From<&[T]>` alone, whose borrow `'a` still holds.
            Some(unsafe { std::slice::from_raw_parts(self.data, self.len) })
        }
    }
    /// The array, empty when absent.
    #[inline(always)]
    pub fn or_empty(&self) -> &'a [T] {
        self.get().unwrap_or(&[])
    }
}

impl<'a, T> From<&'a [T]> for In<'a, T> {
    fn from(slice: &'a [T]) -> Self {
        Self { data: slice.as_ptr(), len: slice.len(), life: PhantomData }
    }
}

/// A borrowed output array; [`Out::absent`] (the default) means "not wanted": it must not be computed.
#[repr(C)]
pub struct Out<'a, T> {
    data: *mut T,
    len: usize,
    life: PhantomData<&'a mut [T]>,
}

// SAFETY: `Out` is a unique slice in other clothes and inherits the slice's thread safety.
unsafe impl<T: Send> Send for Out<'_, T> {}

impl<'a, T> Out<'a, T> {
    /// An output that nobody wants.
    pub fn absent() -> Self {
        Self { data: std::ptr::null_mut(), len: 0, life: PhantomData }
    }
    /// Whether the caller wants it.
    #[inline(always)]
    pub fn wanted(&self) -> bool {
        !self.data.is_null()
    }
    /// The array to write, or `None` when not wanted.
    #[inline(always)]
    pub fn get(&mut self) -> Option<&mut [T]> {
        if self.data.is_null() {
            None
        } else {
            // SAFETY: non-null pointers come from `From<&mut [T]>` alone, whose unique borrow `'a` still holds, and
            // `&mut self` keeps the returned slice unique.
            Some(unsafe { std::slice::from_raw_parts_mut(self.data, self.len) })
        }
    }
    /// Length of the array, 0 when not wanted.
    pub fn len(&self) -> usize {
        self.len
    }
    /// Whether there is nothing to write.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }
}

impl<T> Default for Out<'_, T> {
    fn default() -> Self {
        Self::absent()
    }
}

impl<'a, T> From<&'a mut [T]> for Out<'a, T> {
    fn from(slice: &'a mut [T]) -> Self {
        Self { data: slice.as_mut_ptr(), len: slice.len(), life: PhantomData }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arrays_round_trip_and_absence_is_visible() {
        let a = [1.0, 2.0];
        assert_eq!(In::from(&a[..]).get(), Some(&a[..]));
        assert!(In::<f32>::absent().get().is_none());
        let mut b = [0.0; 2];
        let mut out = Out::from(&mut b[..]);
        out.get().unwrap()[1] = 5.0;
        assert_eq!(b, [0.0, 5.0]);
        assert!(!Out::<f32>::absent().wanted());
    }
}
