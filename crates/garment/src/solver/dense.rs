//! Dense factorisations of fronts, column-major, blocked so that most work is in matrix products.

use gemm::{Parallelism, gemm};

/// Columns that are factorised together.
const BLOCK: usize = 32;

/// A matrix in a slice, column-major: element (i, j) stands at `i + j * stride`.
#[derive(Clone, Copy)]
struct View<'a> {
    data: &'a [f64],
    rows: usize,
    columns: usize,
    row_stride: usize,
    column_stride: usize,
}

impl<'a> View<'a> {
    fn new(data: &'a [f64], rows: usize, columns: usize, stride: usize) -> Self {
        Self { data, rows, columns, row_stride: 1, column_stride: stride }
    }
    fn transposed(self) -> Self {
        Self {
            rows: self.columns,
            columns: self.rows,
            row_stride: self.column_stride,
            column_stride: self.row_stride,
            ..self
        }
    }
    fn span(&self) -> usize {
        if self.rows == 0 || self.columns == 0 {
            0
        } else {
            (self.rows - 1) * self.row_stride + (self.columns - 1) * self.column_stride + 1
        }
    }
}

/// `out -= a b` with `out` column-major; one thread, so that the order of every sum depends on the sizes alone.
fn subtract_product(out: &mut [f64], stride: usize, a: View<'_>, b: View<'_>) {
    if a.rows == 0 || b.columns == 0 || a.columns == 0 {
        return;
    }
    assert_eq!(a.columns, b.rows, "inner sizes of a matrix product");
    assert!((b.columns - 1) * stride + a.rows <= out.len() && a.rows <= stride, "result of a matrix product");
    assert!(a.span() <= a.data.len() && b.span() <= b.data.len(), "operands of a matrix product");
    // SAFETY: the assertions above keep every address that the strides reach inside its slice, and `out` is borrowed
    // uniquely.
    unsafe {
        gemm(
            a.rows,
            b.columns,
            a.columns,
            out.as_mut_ptr(),
            stride as isize,
            1,
            true,
            a.data.as_ptr(),
            a.column_stride as isize,
            a.row_stride as isize,
            b.data.as_ptr(),
            b.column_stride as isize,
            b.row_stride as isize,
            1.0,
            -1.0,
            false,
            false,
            false,
            Parallelism::None,
        );
    }
}

/// Cholesky of the leading s columns of a matrix of `rows` rows: afterwards they hold L (its first s rows lower triangular). `false`
/// when a pivot is not above `least`.
pub(super) fn cholesky(panel: &mut [f64], rows: usize, s: usize, least: f64) -> bool {
    for k in (0..s).step_by(BLOCK) {
        let width = BLOCK.min(s - k);
        let (left, right) = panel.split_at_mut((k + width) * rows);
        for j in k..k + width {
            let (before, column) = left.split_at_mut(j * rows);
            let column = &mut column[j..rows];
            for p in k..j {
                let other = &before[p * rows + j..(p + 1) * rows];
                let factor = other[0];
                column.iter_mut().zip(other).for_each(|(c, o)| *c -= factor * o);
            }
            let pivot = column[0];
            // Written so that NaN is refused, too.
            if !(pivot > least && pivot.is_finite()) {
                return false;
            }
            let inverse = 1.0 / pivot.sqrt();
            column.iter_mut().for_each(|c| *c *= inverse);
        }
        let rest = s - k - width;
        if rest > 0 {
            let source = &left[k * rows + k + width..];
            let below = View::new(source, rows - k - width, width, rows);
            let across = View::new(source, rest, width, rows);
            subtract_product(&mut right[k + width..], rows, below, across.transposed());
        }
    }
    true
}

/// `schur -= L21 L21ᵀ`, lower triangle (and some of the upper), L21 the rows of `panel` below its first s.
pub(super) fn update_symmetric(schur: &mut [f64], panel: &[f64], rows: usize, s: usize) {
    let b = rows - s;
    for j in (0..b).step_by(64) {
        let width = 64.min(b - j);
        if s == 0 {
            return;
        }
        let left = View::new(&panel[s + j..], b - j, s, rows);
        let right = View::new(&panel[s + j..], width, s, rows);
        subtract_product(&mut schur[j * b + j..], b, left, right.transposed());
    }
}

/// LU with row exchanges among the first s rows of the leading s columns of `panel` (`rows` rows); `upper` (s × b) holds the first
/// s rows of the columns behind and takes part. Pivots below `least` are replaced by it; returns the exchanges and how
/// many pivots were replaced.
pub(super) fn lu(panel: &mut [f64], rows: usize, s: usize, upper: &mut [f64], least: f64) -> (Vec<u32>, usize) {
    let mut exchanges = vec![0u32; s];
    let mut replaced = 0;
    let b = upper.len().checked_div(s).unwrap_or(0);
    for k in (0..s).step_by(BLOCK) {
        let width = BLOCK.min(s - k);
        for j in k..k + width {
            let (before, column) = panel.split_at_mut(j * rows);
            let column = &mut column[..rows];
            // Columns of this block act on column j, top down; columns of earlier blocks already have.
            for p in k..j {
                let factor = column[p];
                let other = &before[p * rows..][..rows];
                column[p + 1..].iter_mut().zip(&other[p + 1..]).for_each(|(c, o)| *c -= factor * o);
            }
            let mut best = j;
            for i in j + 1..s {
                if column[i].abs() > column[best].abs() {
                    best = i;
                }
            }
            exchanges[j] = best as u32;
            if best != j {
                for column in panel.chunks_exact_mut(rows) {
                    column.swap(j, best);
                }
                for column in upper.chunks_exact_mut(s) {
                    column.swap(j, best);
                }
            }
            let column = &mut panel[j * rows..][..rows];
            if column[j].abs() <= least || column[j].is_nan() {
                column[j] = if column[j] < 0.0 { -least } else { least };
                replaced += 1;
            }
            let inverse = 1.0 / column[j];
            column[j + 1..].iter_mut().for_each(|c| *c *= inverse);
        }
        let (left, right) = panel.split_at_mut((k + width) * rows);
        for column in right.chunks_exact_mut(rows) {
            lower_solve(&left[k * rows..], rows, k, width, column);
        }
        let rest = s - k - width;
        if rest > 0 {
            // Rows k..k+width of the right part are U; the rows below get L U subtracted.
            let u: Vec<f64> = right.chunks_exact(rows).flat_map(|c| c[k..k + width].iter().copied()).collect();
            let below = View::new(&left[k * rows + k + width..], rows - k - width, width, rows);
            subtract_product(&mut right[k + width..], rows, below, View::new(&u, width, rest, width));
        }
    }
    // The columns behind: L11⁻¹ times them, block by block.
    for k in (0..s).step_by(BLOCK) {
        let width = BLOCK.min(s - k);
        for column in upper.chunks_exact_mut(s.max(1)) {
            lower_solve(&panel[k * rows..], rows, k, width, column);
        }
        let rest = s - k - width;
        if rest > 0 && b > 0 {
            let u: Vec<f64> = upper.chunks_exact(s).flat_map(|c| c[k..k + width].iter().copied()).collect();
            let below = View::new(&panel[k * rows + k + width..], rest, width, rows);
            subtract_product(&mut upper[k + width..], s, below, View::new(&u, width, b, width));
        }
    }
    (exchanges, replaced)
}

/// Rows k..k + width of `column` by the unit lower triangle in columns k..k + width (`left` starts at column k).
fn lower_solve(left: &[f64], rows: usize, k: usize, width: usize, column: &mut [f64]) {
    for p in 0..width {
        let factor = column[k + p];
        for i in p + 1..width {
            column[k + i] -= factor * left[p * rows + k + i];
        }
    }
}

/// `schur -= L21 U12`.
pub(super) fn update_general(schur: &mut [f64], panel: &[f64], rows: usize, s: usize, upper: &[f64]) {
    let b = rows - s;
    if s > 0 && b > 0 {
        subtract_product(schur, b, View::new(&panel[s..], b, s, rows), View::new(upper, s, b, s));
    }
}
