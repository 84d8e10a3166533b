//! The energies of Eqs. 3-12: values and vertex gradients over batches of posed garments.
//!
//! A term is one file and one implementation of [`EnergyTerm`]. Frames are lanes (see [`caphy_core::lanes`]): block = time
//! step, lane = window. Every sum has a fixed order and threads split blocks or frames, so that results are the same bits
//! on any thread count.

mod arc_tangent;
pub mod attachment;
pub mod bending;
pub mod chamfer;
pub mod collision;
pub mod friction;
pub mod gravity;
pub mod guards;
pub mod inertia;
pub mod layering;
pub mod normals;
pub mod single;
pub mod strain;
pub mod tangent;

pub use attachment::Attachment;
pub use bending::{Bending, RestAngle};
pub use chamfer::{Chamfer, ScanCloud};
pub use collision::{Collision, ContactOptions, Touch, nearest_body_vertices};
pub(crate) use collision::{NoNearest, lane_points, square_distance};
pub use friction::Friction;
pub use gravity::Gravity;
pub use guards::GuardCounts;
pub use inertia::{Inertia, InertiaRule};
pub use layering::{Layer, Layering, LayeringOptions, LayeringOrder};
pub use normals::{frame_normals, frame_normals_into};
pub use single::{Single, SingleBody, SingleTerm};
pub use strain::Strain;
pub use tangent::{EnergyTangent, Stencil, Tangent};

use caphy_core::lanes::Frames;
use caphy_core::material::MaterialReal;
use caphy_core::{Error, Real, Result};
use rayon::prelude::*;

/// Elements (triangles, hinges) that travel through a material in one call, times the lanes: 256 values in f32.
const CHUNK: usize = 16;
/// The widest register, in values: length of the per-lane scratch of kernels.
const MAX_LANES: usize = 16;

/// The body's part that the garment can reach, posed.
#[derive(Debug, Clone, Copy)]
pub struct BodyState<'a, T> {
    /// Body vertices [m].
    pub positions: &'a Frames<T>,
    /// Outward unit normals at them.
    pub normals: &'a Frames<T>,
    /// Body vertex (row of `positions`) for each garment vertex, `[block][garment vertex][lane]` with all `T::LANES` lanes, as
    /// [`nearest_body_vertices`] writes it; `None` searches.
    pub nearest: Option<&'a [u32]>,
}

/// A batch of posed garments and what surrounds them. All frames of a batch share blocks and lanes.
#[derive(Debug, Clone, Copy)]
pub struct State<'a, T> {
    /// Garment vertices in the world [m].
    pub positions: &'a Frames<T>,
    /// The posed body, for collision.
    pub body: Option<BodyState<'a, T>>,
    /// Where held vertices belong [m]: one row per vertex of the [`Attachment`] term, in its order.
    pub targets: Option<&'a Frames<T>>,
    /// Scan of each frame, `[block * lanes_used + lane]`, for [`Chamfer`].
    pub scans: &'a [&'a ScanCloud<T>],
    /// Garment vertices of the two steps before the first, in two blocks, for [`Inertia`]; `None` where nothing is known of them.
    pub past: Option<&'a Frames<T>>,
}

impl<'a, T: Real> State<'a, T> {
    /// Garments alone in the world.
    pub fn new(positions: &'a Frames<T>) -> Self {
        Self { positions, body: None, targets: None, scans: &[], past: None }
    }
    /// The same with a posed body.
    pub fn with_body(self, body: BodyState<'a, T>) -> Self {
        Self { body: Some(body), ..self }
    }
    /// The same with targets of held vertices.
    pub fn with_targets(self, targets: &'a Frames<T>) -> Self {
        Self { targets: Some(targets), ..self }
    }
    /// The same with the two steps before the first.
    pub fn with_past(self, past: &'a Frames<T>) -> Self {
        Self { past: Some(past), ..self }
    }
    /// The same with a scan per frame.
    pub fn with_scans(self, scans: &'a [&'a ScanCloud<T>]) -> Self {
        Self { scans, ..self }
    }
}

/// One energy of a garment.
///
/// # Promise
/// Pure; equal states give equal bits on any thread count. The gradient is the derivative of the energy by the garment's
/// vertices, except where a term says that something is held (stiffness, contact pairs, normals, past frames).
///
/// # Shapes and units
/// `energy`: J per frame, `[block * lanes_used + lane]`; `gradient`: N, the shape of the positions. Both are *added to*,
/// multiplied by `weight`. Gradients are of the sum over frames; whoever wants a mean puts it into `weight`.
///
/// # Errors
/// [`Error::Length`] for shapes that do not fit, [`Error::Config`] for a part of the state that the term needs and nobody
/// gave, [`Error::Numerics`] naming the element and frame where a value is not finite. After an error, `energy` is
/// unchanged and `gradient` is not defined.
pub trait EnergyTerm<T: MaterialReal>: Send + Sync {
    /// Short name in configurations, metrics and errors.
    fn name(&self) -> &'static str;
    /// Adds `weight` times the energy and, where wanted, its gradient.
    fn add(
        &self,
        state: &State<'_, T>,
        weight: f64,
        energy: &mut [f64],
        gradient: Option<&mut Frames<T>>,
    ) -> Result<()>;
}

/// Checks shapes, runs `f` on every block in parallel (each with its own part of the gradient), checks the answers and adds
/// them in order. `f` returns the weighted energy per lane.
fn add_blocks<T: Real>(
    name: &'static str,
    vertex_count: usize,
    positions: &Frames<T>,
    energy: &mut [f64],
    gradient: Option<&mut Frames<T>>,
    f: impl Fn(usize, Option<&mut [T]>) -> Result<[f64; MAX_LANES]> + Sync,
) -> Result<()> {
    check_shapes(name, vertex_count, positions, energy, gradient.as_deref())?;
    let blocks = positions.blocks();
    if vertex_count == 0 || blocks == 0 {
        return Ok(());
    }
    // Results are collected before the first error is looked for, so that the same error comes back on any thread count.
    let results: Vec<Result<[f64; MAX_LANES]>> = match gradient {
        Some(gradient) => {
            let n = gradient.block_len();
            gradient.data_mut().par_chunks_mut(n).enumerate().map(|(block, part)| f(block, Some(part))).collect()
        }
        None => (0..blocks).into_par_iter().map(|block| f(block, None)).collect(),
    };
    let values = results.into_iter().collect::<Result<Vec<_>>>()?;
    let lanes = positions.lanes_used();
    for (block, value) in values.iter().enumerate() {
        for (lane, value) in value[..lanes].iter().enumerate() {
            check_energy(name, positions, block, lane, *value)?;
        }
    }
    for (block, value) in values.iter().enumerate() {
        for (lane, value) in value[..lanes].iter().enumerate() {
            energy[block * lanes + lane] += value;
        }
    }
    Ok(())
}

fn check_shapes<T: Real>(
    name: &str,
    vertex_count: usize,
    positions: &Frames<T>,
    energy: &[f64],
    gradient: Option<&Frames<T>>,
) -> Result<()> {
    Error::check_length(&format!("vertices of the garment in {name}"), vertex_count, positions.vertices())?;
    Error::check_length(&format!("energies of {name}, one per frame"), positions.frames(), energy.len())?;
    if let Some(gradient) = gradient {
        check_same_frames(&format!("gradient of {name}"), positions, gradient)?;
        Error::check_length(&format!("vertices of the gradient of {name}"), vertex_count, gradient.vertices())?;
    }
    Ok(())
}

/// Blocks and lanes of two batches agree.
fn check_same_frames<T: Real>(what: &str, expected: &Frames<T>, got: &Frames<T>) -> Result<()> {
    Error::check_length(&format!("{what}, blocks"), expected.blocks(), got.blocks())?;
    Error::check_length(&format!("{what}, lanes in use"), expected.lanes_used(), got.lanes_used())
}

/// `Ok` for a finite energy, else an error that names the first bad vertex of the frame.
fn check_energy<T: Real>(name: &str, positions: &Frames<T>, block: usize, lane: usize, value: f64) -> Result<()> {
    if value.is_finite() {
        return Ok(());
    }
    let problem =
        match (0..positions.vertices()).find(|&v| !positions.get(block, lane, v).iter().all(|c| c.is_finite())) {
            Some(vertex) => {
                let p = positions.get(block, lane, vertex);
                format!("vertex {vertex} of step {block}, window {lane} is at ({}, {}, {})", p.x, p.y, p.z)
            }
            None => format!("the energy of step {block}, window {lane} is {value} at finite positions"),
        };
    Err(Error::numerics(
        format!("energy `{name}`"),
        problem,
        "go back to the last good state with a smaller step, and check that the template and the body are in metres",
    ))
}

/// A part of the state that a term cannot do without.
fn needed<V>(term: &str, what: &str, value: Option<V>) -> Result<V> {
    value.ok_or_else(|| {
        Error::config(term, format!("the term needs {what} and the state has none"), "give it, or leave the term out")
    })
}

/// Lane values of one vertex, `[xyz][lane]`, in a block.
#[inline(always)]
fn row<T: Real>(values: &[T], vertex: u32) -> &[T] {
    let n = 3 * T::LANES;
    &values[vertex as usize * n..][..n]
}

/// Lane values of one vertex on a kernel's stack, `[xyz][lane]` with `T::LANES` lanes (f64 leaves the rest unused).
///
/// Kernels keep the lane loop outermost and these rows flat: nested as arrays of arrays, the compiler unrolls the lanes and
/// vectorises across components, with gathers.
type Row<T> = [T; 3 * MAX_LANES];

/// Adds lane values to one vertex of a block.
#[inline(always)]
fn add_row<T: Real>(values: &mut [T], vertex: u32, add: &Row<T>) {
    let n = 3 * T::LANES;
    let out = &mut values[vertex as usize * n..][..n];
    for i in 0..n {
        out[i] += add[i];
    }
}

/// Fills the list up to whole chunks with copies of its last element, changed by `weightless` to have no effect: kernels and
/// materials then always see blocks of one size.
fn pad_to_chunks<E: Clone>(elements: &mut Vec<E>, weightless: impl Fn(&mut E)) {
    let Some(mut last) = elements.last().cloned() else { return };
    weightless(&mut last);
    elements.resize(elements.len().next_multiple_of(CHUNK), last);
}
