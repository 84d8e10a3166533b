//! Matrix products over plain slices.

use caphy_core::Real;
use gemm::Parallelism;

/// A matrix seen in a slice: element `(i, j)` stands at `i * row_stride + j * column_stride`.
#[derive(Clone, Copy)]
pub(crate) struct View<'a, T> {
    data: &'a [T],
    rows: usize,
    columns: usize,
    row_stride: usize,
    column_stride: usize,
}

impl<'a, T> View<'a, T> {
    /// Rows one after the other, without gaps.
    pub(crate) fn rows(data: &'a [T], rows: usize, columns: usize) -> Self {
        Self::strided(data, rows, columns, columns)
    }
    /// Rows that start `row_stride` values apart.
    pub(crate) fn strided(data: &'a [T], rows: usize, columns: usize, row_stride: usize) -> Self {
        Self { data, rows, columns, row_stride, column_stride: 1 }
    }
    /// The transpose; nothing moves.
    pub(crate) fn transposed(self) -> Self {
        Self {
            data: self.data,
            rows: self.columns,
            columns: self.rows,
            row_stride: self.column_stride,
            column_stride: self.row_stride,
        }
    }
    /// Number of values from the first element to the last, both included.
    fn span(&self) -> usize {
        if self.rows == 0 || self.columns == 0 {
            0
        } else {
            (self.rows - 1) * self.row_stride + (self.columns - 1) * self.column_stride + 1
        }
    }
}

/// `out = a b`, or `out += a b` with `add`; `out` is row-major without gaps, shape `[a.rows, b.columns]`.
///
/// One thread: the order of every sum depends on the sizes alone.
pub(crate) fn multiply<T: Real>(out: &mut [T], a: View<'_, T>, b: View<'_, T>, add: bool) {
    assert_eq!(a.columns, b.rows, "inner sizes of a matrix product");
    assert_eq!(out.len(), a.rows * b.columns, "result of a matrix product");
    assert!(a.span() <= a.data.len() && b.span() <= b.data.len(), "operands of a matrix product");
    if out.is_empty() {
        return;
    }
    // SAFETY: the assertions above keep every address that the strides reach inside its slice, `out` is borrowed
    // uniquely, and `T` is `f32` or `f64` (the only types that implement `Real`), which `gemm` accepts.
    unsafe {
        gemm::gemm(
            a.rows,
            b.columns,
            a.columns,
            out.as_mut_ptr(),
            1,
            b.columns as isize,
            add,
            a.data.as_ptr(),
            a.column_stride as isize,
            a.row_stride as isize,
            b.data.as_ptr(),
            b.column_stride as isize,
            b.row_stride as isize,
            T::one(),
            T::one(),
            false,
            false,
            false,
            Parallelism::None,
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn products_of_views_and_their_transposes() {
        // [1 2 3; 4 5 6], and the same inside rows of 5.
        let a = [1.0f64, 2.0, 3.0, 4.0, 5.0, 6.0];
        let wide = [1.0, 2.0, 3.0, 9.0, 9.0, 4.0, 5.0, 6.0, 9.0, 9.0];
        let mut square = [100.0; 4];
        multiply(&mut square, View::rows(&a, 2, 3), View::rows(&a, 2, 3).transposed(), false);
        assert_eq!(square, [14.0, 32.0, 32.0, 77.0]);
        multiply(&mut square, View::strided(&wide, 2, 3, 5), View::rows(&a, 2, 3).transposed(), true);
        assert_eq!(square, [28.0, 64.0, 64.0, 154.0]);
        let mut outer = [0.0; 9];
        multiply(&mut outer, View::rows(&a, 2, 3).transposed(), View::rows(&a, 2, 3), false);
        assert_eq!(outer, [17.0, 22.0, 27.0, 22.0, 29.0, 36.0, 27.0, 36.0, 45.0]);
    }

    #[test]
    #[should_panic(expected = "operands of a matrix product")]
    fn a_view_beyond_its_slice_is_refused() {
        let a = [0.0f32; 5];
        multiply(&mut [0.0; 4], View::rows(&a, 2, 3), View::rows(&[0.0; 6], 3, 2), false);
    }
}
