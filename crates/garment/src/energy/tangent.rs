//! Second derivatives of energies: one small dense block per element, for Newton steps and for sensitivities.

use super::{EnergyTerm, State};
use caphy_core::lanes::Frames;
use caphy_core::{Error, Result};

/// Which second derivative.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Tangent {
    /// The derivative of the gradient that the term answers: indefinite where the energy is not convex, not symmetric where a
    /// stiffness is frozen.
    Exact,
    /// Symmetric and positive semidefinite, the exact one where that already is: for steps that must go downhill. Frozen
    /// stiffness counts as constant.
    Projected,
}

/// Which vertices the elements of a term couple.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Stencil {
    /// Vertices of one element.
    pub width: usize,
    /// Vertices, `[element][width]`.
    pub vertices: Vec<u32>,
}

impl Stencil {
    /// Number of elements.
    pub fn len(&self) -> usize {
        self.vertices.len() / self.width.max(1)
    }
    /// Whether there is no element.
    pub fn is_empty(&self) -> bool {
        self.vertices.is_empty()
    }
    /// Values of all blocks: (3 width)² per element.
    pub fn block_values(&self) -> usize {
        self.len() * 9 * self.width * self.width
    }
}

/// An energy with a second derivative.
///
/// # Promise
/// The stencil never changes, so that a matrix pattern made from it stays good. Pairs, normals and past frames that the
/// gradient holds are held here, too.
///
/// # Shapes and units
/// `blocks`: N/m, `[element][3 width][3 width]` row-major, vertex by vertex x, y, z; overwritten, times `weight`. The state
/// has one frame.
///
/// # Errors
/// As [`EnergyTerm::add`]; [`Error::Unsupported`] for a state of more than one frame.
pub trait EnergyTangent: EnergyTerm<f64> {
    /// The elements.
    fn stencil(&self) -> Stencil;
    /// Second derivatives of every element.
    fn tangents(&self, state: &State<'_, f64>, weight: f64, kind: Tangent, blocks: &mut [f64]) -> Result<()>;
}

/// The only frame of a state.
pub(super) fn only_frame(term: &str, positions: &Frames<f64>) -> Result<Vec<[f64; 3]>> {
    if positions.frames() != 1 {
        let what = format!("second derivatives of {} frames at once (one frame per call)", positions.frames());
        return Err(Error::unsupported(what, format!("energy `{term}`")));
    }
    Ok(super::lane_points(positions, 0, 0))
}

/// Writes a multiple of the unit matrix per element.
pub(super) fn isotropic(stiffness: impl Iterator<Item = f64>, blocks: &mut [f64]) {
    for (block, k) in blocks.chunks_exact_mut(9).zip(stiffness) {
        block.copy_from_slice(&[k, 0.0, 0.0, 0.0, k, 0.0, 0.0, 0.0, k]);
    }
}

/// The nearest positive semidefinite matrix to [[a, b], [b, d]]: negative eigenvalues become zero.
pub(super) fn clamp_2x2([a, b, d]: [f64; 3]) -> [f64; 3] {
    let (mean, half) = (0.5 * (a + d), 0.5 * (a - d));
    let radius = half.hypot(b);
    let (low, high) = (mean - radius, mean + radius);
    if low >= 0.0 {
        return [a, b, d];
    }
    if high <= 0.0 || radius == 0.0 {
        return [0.0; 3];
    }
    // high · w wᵀ with w wᵀ = ½ (I + R / radius), R = [[half, b], [b, −half]].
    let scale = 0.5 * high / radius;
    [scale * (radius + half), scale * b, scale * (radius - half)]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn clamped_pairs_keep_positive_eigenvalues_alone() {
        assert_eq!(clamp_2x2([2.0, 0.5, 1.0]), [2.0, 0.5, 1.0]);
        assert_eq!(clamp_2x2([-2.0, 0.5, -1.0]), [0.0; 3]);
        let [a, b, d] = clamp_2x2([1.0, 3.0, -2.0]);
        // Rank one, with the trace of the positive eigenvalue.
        let positive = -0.5 + (1.5f64 * 1.5 + 9.0).sqrt();
        assert!((a * d - b * b).abs() < 1e-14 && (a + d - positive).abs() < 1e-14);
    }
}
