//! Sums over flat vectors in a fixed order, eight at a time.

use caphy_core::{Real, simd_kernel};

/// Σ a b, the same bits on every machine: eight partial sums, added in order.
pub(super) fn dot(a: &[f64], b: &[f64]) -> f64 {
    products(a, b)
}
/// y += c x.
pub(super) fn add_scaled(y: &mut [f64], c: f64, x: &[f64]) {
    axpy(c, x, y);
}
/// x + step d.
pub(super) fn moved(x: &[f64], step: f64, d: &[f64]) -> Vec<f64> {
    let mut out = x.to_vec();
    axpy(step, d, &mut out);
    out
}

simd_kernel! {
    fn products<T>(a: &[T], b: &[T]) -> T {
        partial_products(a, b)
    }
}

/// [`dot`] inside of other kernels.
#[inline(always)]
pub(super) fn partial_products<T: Real>(a: &[T], b: &[T]) -> T {
    let mut sums = [T::zero(); 8];
    let (a, b) = (&a[..a.len().min(b.len())], &b[..a.len().min(b.len())]);
    let (blocks_a, rest_a) = (a.chunks_exact(8), a.chunks_exact(8).remainder());
    let (blocks_b, rest_b) = (b.chunks_exact(8), b.chunks_exact(8).remainder());
    for (a, b) in blocks_a.zip(blocks_b) {
        for l in 0..8 {
            sums[l] += a[l] * b[l];
        }
    }
    let mut total = T::zero();
    for sum in sums {
        total += sum;
    }
    for (a, b) in rest_a.iter().zip(rest_b) {
        total += *a * *b;
    }
    total
}

simd_kernel! {
    fn axpy<T>(c: T, x: &[T], y: &mut [T]) {
        for (y, x) in y.iter_mut().zip(x) {
            *y += c * *x;
        }
    }
}

/// Largest vector per vertex: length and vertex.
pub(super) fn largest(g: &[f64]) -> (f64, usize) {
    let mut out = (0.0, 0);
    for (v, g) in g.chunks_exact(3).enumerate() {
        let square = g[0] * g[0] + g[1] * g[1] + g[2] * g[2];
        // NaN counts as the largest.
        if square > out.0 || square.is_nan() {
            out = (square, v);
        }
    }
    (f64::sqrt(out.0), out.1)
}
