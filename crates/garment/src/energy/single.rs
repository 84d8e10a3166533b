//! Energies of one pose alone: elements in lanes instead of frames.
//!
//! [`super::EnergyTerm`] fills a vector register with frames; a solver that works on one pose would throw all but one of them
//! away. Here eight triangles, hinges or vertices share a register, and positions are flat. Answers are those of
//! [`super::EnergyTerm::add`] up to the order of the energy's sum.

use super::MAX_LANES;
use caphy_core::{Error, Real, Result};

/// The posed body of one frame.
#[derive(Debug, Clone, Copy)]
pub struct SingleBody<'a> {
    /// Body vertices [m].
    pub positions: &'a [[f64; 3]],
    /// Outward unit normals at them.
    pub normals: &'a [[f64; 3]],
    /// Body vertex of each garment vertex.
    pub nearest: &'a [u32],
}

/// One posed garment and what surrounds it.
#[derive(Debug, Clone, Copy)]
pub struct Single<'a> {
    /// Garment vertices [m], shape [vertex][3].
    pub positions: &'a [f64],
    /// The posed body, for collision.
    pub body: Option<SingleBody<'a>>,
    /// Where held vertices belong [m], shape [held vertex][3].
    pub targets: Option<&'a [f64]>,
}

impl<'a> Single<'a> {
    /// A garment alone in the world.
    pub fn new(positions: &'a [f64]) -> Self {
        Self { positions, body: None, targets: None }
    }
    /// Shapes fit a garment of so many vertices.
    pub(super) fn check(&self, name: &str, vertex_count: usize, gradient: Option<&[f64]>) -> Result<()> {
        Error::check_length(&format!("positions of the garment in {name}"), 3 * vertex_count, self.positions.len())?;
        match gradient {
            Some(g) => Error::check_length(&format!("gradient of {name}"), 3 * vertex_count, g.len()),
            None => Ok(()),
        }
    }
}

/// An energy of one pose.
///
/// # Promise, shapes and units
/// As [`super::EnergyTerm`]: the answer is `weight` times the energy [J], the gradient [N], shape [vertex][3], is added to.
///
/// # Errors
/// As [`super::EnergyTerm::add`]; the gradient is not defined after one.
pub trait SingleTerm: Send + Sync {
    /// `weight` times the energy; adds the gradient where wanted.
    fn add_single(&self, pose: &Single<'_>, weight: f64, gradient: Option<&mut [f64]>) -> Result<f64>;
}

/// `Ok` for a finite energy, else an error that names the first bad vertex.
pub(super) fn check_single(name: &str, positions: &[f64], value: f64) -> Result<f64> {
    if value.is_finite() {
        return Ok(value);
    }
    let problem = match positions.iter().position(|x| !x.is_finite()) {
        Some(i) => format!("vertex {} has a coordinate of {} m", i / 3, positions[i]),
        None => format!("the energy is {value} at finite positions"),
    };
    Err(Error::numerics(
        format!("energy `{name}`"),
        problem,
        "go back to the last good state with a smaller step, and check that the template and the body are in metres",
    ))
}

/// The k-th vertices of a group of elements side by side, `[xyz][lane]`.
#[inline(always)]
pub(super) fn gathered<T: Real, E>(group: &[E], x: &[T], vertex: impl Fn(&E) -> u32) -> [T; 3 * MAX_LANES] {
    let mut out = [T::zero(); 3 * MAX_LANES];
    for (l, element) in group.iter().enumerate() {
        let at = 3 * vertex(element) as usize;
        for k in 0..3 {
            out[k * T::LANES + l] = x[at + k];
        }
    }
    out
}

/// Adds lane l of `values` `[xyz][lane]` to a vertex.
#[inline(always)]
pub(super) fn add_lane<T: Real>(gradient: &mut [T], vertex: u32, values: &[T; 3 * MAX_LANES], l: usize) {
    let out = &mut gradient[3 * vertex as usize..][..3];
    for k in 0..3 {
        out[k] += values[k * T::LANES + l];
    }
}

/// Σ over lanes, in order.
pub(super) fn lane_sum(values: &[f64; MAX_LANES]) -> f64 {
    values.iter().sum()
}
