//! Solving with the factors of one front: its own unknowns and those of its boundary lie side by side, so that every column of the factor
//! is one run through memory.

use super::vector::{add_scaled, dot, partial_products};
use caphy_core::simd_kernel;

/// A front's factors, column-major, for s own unknowns and b of its boundary.
#[derive(Clone, Copy)]
pub(super) struct Columns<'a> {
    /// (s + b) × s: the diagonal block above L21.
    pub(super) panel: &'a [f64],
    /// s × b: U12 of LU, empty for Cholesky.
    pub(super) upper: &'a [f64],
    /// Rows of LU that were exchanged.
    pub(super) exchanges: &'a [u32],
    /// s.
    pub(super) own: usize,
}

impl Columns<'_> {
    /// L⁻¹ of L Lᵀ, going up.
    pub(super) fn forward_cholesky(self, x: &mut [f64]) {
        down(self.panel, self.own, false, x);
    }
    /// L⁻ᵀ of L Lᵀ, going down.
    pub(super) fn backward_cholesky(self, x: &mut [f64]) {
        up(self.panel, self.own, false, x);
    }
    /// L⁻¹P of P A = L U.
    pub(super) fn forward_lu(self, x: &mut [f64]) {
        for (j, &other) in self.exchanges.iter().enumerate() {
            x.swap(j, other as usize);
        }
        down(self.panel, self.own, true, x);
    }
    /// U⁻¹.
    pub(super) fn backward_lu(self, x: &mut [f64]) {
        let (s, rows) = (self.own, x.len());
        let (own, boundary) = x.split_at_mut(s);
        for (value, column) in boundary.iter().zip(self.upper.chunks_exact(s.max(1))) {
            add_scaled(own, -value, column);
        }
        for j in (0..s).rev() {
            let column = &self.panel[j * rows..][..s];
            own[j] /= column[j];
            let value = own[j];
            add_scaled(&mut own[..j], -value, &column[..j]);
        }
    }
    /// U⁻ᵀ, going up.
    pub(super) fn forward_transposed(self, x: &mut [f64]) {
        let (s, rows) = (self.own, x.len());
        let (own, boundary) = x.split_at_mut(s);
        for j in 0..s {
            let column = &self.panel[j * rows..][..s];
            own[j] = (own[j] - dot(&column[..j], &own[..j])) / column[j];
        }
        for (value, column) in boundary.iter_mut().zip(self.upper.chunks_exact(s.max(1))) {
            *value -= dot(own, column);
        }
    }
    /// PᵀL⁻ᵀ, going down.
    pub(super) fn backward_transposed(self, x: &mut [f64]) {
        up(self.panel, self.own, true, x);
        for (j, &other) in self.exchanges.iter().enumerate().rev() {
            x.swap(j, other as usize);
        }
    }
}

simd_kernel! {
    /// L⁻¹ for the first s unknowns, subtracted from those behind; `unit`: the diagonal is 1.
    fn down<T>(panel: &[T], s: usize, unit: bool, x: &mut [T]) {
        let rows = x.len();
        for j in 0..s {
            let column = &panel[j * rows..][..rows];
            if !unit {
                x[j] /= column[j];
            }
            let value = x[j];
            for (x, c) in x[j + 1..].iter_mut().zip(&column[j + 1..]) {
                *x -= *c * value;
            }
        }
    }
}

simd_kernel! {
    /// L⁻ᵀ for the first s unknowns, those behind known; `unit`: the diagonal is 1.
    fn up<T>(panel: &[T], s: usize, unit: bool, x: &mut [T]) {
        let rows = x.len();
        for j in (0..s).rev() {
            let column = &panel[j * rows..][..rows];
            let value = x[j] - partial_products(&column[j + 1..], &x[j + 1..]);
            x[j] = if unit { value } else { value / column[j] };
        }
    }
}
