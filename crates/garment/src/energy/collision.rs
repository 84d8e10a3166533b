//! Body collision: a penalty of vertices that come closer to the body's surface than a margin.

use super::single::{Single, SingleTerm, check_single};
use super::tangent::{EnergyTangent, Stencil, Tangent, only_frame};
use super::{BodyState, EnergyTerm, MAX_LANES, State, add_blocks, add_row, check_same_frames, needed, row};
use crate::GarmentRest;
use caphy_core::lanes::Frames;
use caphy_core::material::MaterialReal;
use caphy_core::query::NearestGrid;
use caphy_core::{Error, Real, Result, simd_kernel};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// How stiff contact is, said in lengths and loads instead of in J/m⁵.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ContactOptions {
    /// Margin ε: distance at which contact begins [m]. Default 2 mm, the clearance of SNUG's post-process.
    pub margin: f64,
    /// How far cloth may sink into the margin under the reference load [m]. Default 1 mm: half the margin, so that a loaded
    /// garment still lies outside.
    pub allowed_depth: f64,
    /// Reference load, as a number of the garment's own layers lying on the spot (pressure = load · density · 9.81 m/s²).
    /// Default 50: a garment's weight hangs on a few per cent of its area (shoulders, waist), and tight cloth presses with
    /// tension times curvature, about 10-100 Pa where one layer weighs 2 Pa.
    pub load: f64,
}

impl Default for ContactOptions {
    fn default() -> Self {
        Self { margin: 2e-3, allowed_depth: 1e-3, load: 50.0 }
    }
}

impl ContactOptions {
    /// Penalty weight w [J/m⁵] of E = Σ A w max(ε − d, 0)³: its pressure 3 w s² at the allowed depth s is the reference load.
    pub fn weight(&self, density: f64) -> f64 {
        self.load * density * 9.81 / (3.0 * self.allowed_depth * self.allowed_depth)
    }
    fn check(&self) -> Result<()> {
        for (name, value) in
            [("contact margin", self.margin), ("allowed depth", self.allowed_depth), ("contact load", self.load)]
        {
            if !(value > 0.0 && value.is_finite()) {
                let unit = if name == "contact load" { "layers" } else { "m" };
                return Err(Error::Parameter {
                    name: name.into(),
                    value,
                    lower: 0.0,
                    upper: f64::INFINITY,
                    unit: unit.into(),
                });
            }
        }
        Ok(())
    }
}

/// E = Σ w_v max(ε − n_b·(x − x_b), 0)³ with the nearest body vertex b of each garment vertex; the choice of b, and n_b, are
/// held while differentiating.
pub struct Collision<T> {
    margin: T,
    weights: Vec<T>,
}

impl<T: MaterialReal> Collision<T> {
    /// The default: weights follow the vertices' areas, so that template resolution does not change the contact.
    ///
    /// # Errors
    /// [`Error::Parameter`] for options that are not positive.
    pub fn new(rest: &GarmentRest, options: &ContactOptions) -> Result<Self> {
        options.check()?;
        let w = options.weight(rest.density.0);
        Ok(Self { margin: T::of(options.margin), weights: rest.vertex_areas.iter().map(|a| T::of(w * a)).collect() })
    }
    /// SNUG's sum over vertices: margin ε [m] and one weight [J/m³] for every vertex.
    pub fn faithful(rest: &GarmentRest, margin: f64, weight: f64) -> Self {
        Self { margin: T::of(margin), weights: vec![T::of(weight); rest.vertex_count()] }
    }
}

impl<T: MaterialReal> EnergyTerm<T> for Collision<T> {
    fn name(&self) -> &'static str {
        "collision"
    }
    fn add(
        &self,
        state: &State<'_, T>,
        weight: f64,
        energy: &mut [f64],
        gradient: Option<&mut Frames<T>>,
    ) -> Result<()> {
        let x = state.positions;
        let body = needed("collision", "a posed body", state.body)?;
        check_body(x, &body)?;
        let found;
        let nearest = match body.nearest {
            Some(nearest) => {
                check_nearest(x, &body, nearest)?;
                nearest
            }
            None => {
                found = nearest_body_vertices(x, body.positions)?;
                &found[..]
            }
        };
        let per_block = x.vertices() * T::LANES;
        add_blocks("collision", self.weights.len(), x, energy, gradient, |b, part| {
            let mut energy = [0.0; MAX_LANES];
            let mut none = [];
            let (wanted, part) = part.map_or((false, &mut none[..]), |part| (true, part));
            let nearest = &nearest[b * per_block..][..per_block];
            let body = (body.positions.block(b), body.normals.block(b));
            penalty(&self.weights, self.margin, T::of(weight), x.block(b), body, nearest, &mut energy, wanted, part);
            Ok(energy)
        })
    }
}

impl Collision<f64> {
    /// Contact of each vertex that touches: vertex, body vertex, its normal, force along it [N].
    ///
    /// # Errors
    /// As [`EnergyTerm::add`].
    pub fn contacts(&self, state: &State<'_, f64>, weight: f64) -> Result<Vec<Touch>> {
        let mut out = Vec::new();
        self.each_touch(state, 0.0, |v, body, normal, depth| {
            out.push(Touch { vertex: v, body, normal, force: 3.0 * weight * self.weights[v as usize] * depth * depth });
        })?;
        Ok(out)
    }
    /// Calls `f` with vertex, body vertex, normal and depth [m] of each vertex closer than the margin and `reach` more [m].
    fn each_touch(&self, state: &State<'_, f64>, reach: f64, mut f: impl FnMut(u32, u32, [f64; 3], f64)) -> Result<()> {
        let x = only_frame("collision", state.positions)?;
        Error::check_length("vertices of the garment in collision", self.weights.len(), x.len())?;
        let body = needed("collision", "a posed body", state.body)?;
        check_body(state.positions, &body)?;
        let (points, normals) = (lane_points(body.positions, 0, 0), lane_points(body.normals, 0, 0));
        let nearest: Vec<u32> = match body.nearest {
            Some(nearest) => {
                check_nearest(state.positions, &body, nearest)?;
                nearest.iter().step_by(<f64 as Real>::LANES).copied().collect()
            }
            None => nearest_of_all(&NearestGrid::new(&points), &x).map_err(|e| e.into_error(0, 0))?,
        };
        for (v, (x, &b)) in x.iter().zip(&nearest).enumerate() {
            let (p, n) = (points[b as usize], normals[b as usize]);
            let depth = self.margin - (n[0] * (x[0] - p[0]) + n[1] * (x[1] - p[1]) + n[2] * (x[2] - p[2]));
            if depth > -reach {
                f(v as u32, b, n, depth);
            }
        }
        Ok(())
    }
}

impl SingleTerm for Collision<f64> {
    fn add_single(&self, pose: &Single<'_>, weight: f64, mut gradient: Option<&mut [f64]>) -> Result<f64> {
        pose.check("collision", self.weights.len(), gradient.as_deref())?;
        let body = needed("collision", "a posed body", pose.body)?;
        Error::check_length("nearest body vertices, one per garment vertex", self.weights.len(), body.nearest.len())?;
        let mut energy = 0.0;
        for (v, ((x, &b), w)) in pose.positions.chunks_exact(3).zip(body.nearest).zip(&self.weights).enumerate() {
            let (Some(p), Some(n)) = (body.positions.get(b as usize), body.normals.get(b as usize)) else {
                return Err(named_beyond(b, v, body.positions.len().min(body.normals.len())));
            };
            let d = n[0] * (x[0] - p[0]) + n[1] * (x[1] - p[1]) + n[2] * (x[2] - p[2]);
            // Written so that NaN counts as depth and is found out.
            if d >= self.margin {
                continue;
            }
            let depth = self.margin - d;
            let square = w * weight * depth * depth;
            energy += square * depth;
            if let Some(gradient) = gradient.as_deref_mut() {
                (0..3).for_each(|k| gradient[3 * v + k] -= 3.0 * square * n[k]);
            }
        }
        check_single("collision", pose.positions, energy)
    }
}

/// How far beyond the margin steps see contact coming, and how deep it then counts, as shares of the margin.
const NEAR: f64 = 0.5;
const LIGHT: f64 = 0.1;

/// A garment vertex that touches the body.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Touch {
    /// Garment vertex.
    pub vertex: u32,
    /// Body vertex.
    pub body: u32,
    /// The body's outward normal there.
    pub normal: [f64; 3],
    /// Force that pushes the garment out [N].
    pub force: f64,
}

impl EnergyTangent for Collision<f64> {
    fn stencil(&self) -> Stencil {
        Stencil { width: 1, vertices: (0..self.weights.len() as u32).collect() }
    }
    /// Projected: vertices about to touch count as lightly touching, else steps would run them into the body.
    fn tangents(&self, state: &State<'_, f64>, weight: f64, kind: Tangent, blocks: &mut [f64]) -> Result<()> {
        Error::check_length("second derivatives of collision", 9 * self.weights.len(), blocks.len())?;
        blocks.fill(0.0);
        let (reach, least) = match kind {
            Tangent::Exact => (0.0, 0.0),
            Tangent::Projected => (NEAR * self.margin, LIGHT * self.margin),
        };
        self.each_touch(state, reach, |v, _, n, depth| {
            let stiffness = 6.0 * weight * self.weights[v as usize] * depth.max(least);
            for i in 0..9 {
                blocks[9 * v as usize + i] = stiffness * n[i / 3] * n[i % 3];
            }
        })
    }
}

fn check_body<T: Real>(x: &Frames<T>, body: &BodyState<'_, T>) -> Result<()> {
    check_same_frames("body frames of collision", x, body.positions)?;
    check_same_frames("body normals of collision", x, body.normals)?;
    Error::check_length("body normals of collision", body.positions.vertices(), body.normals.vertices())
}

fn check_nearest<T: Real>(x: &Frames<T>, body: &BodyState<'_, T>, nearest: &[u32]) -> Result<()> {
    let count = x.blocks() * x.vertices() * T::LANES;
    Error::check_length("nearest body vertices, [block][garment vertex][lane]", count, nearest.len())?;
    let n = body.positions.vertices();
    match nearest.iter().position(|&id| id as usize >= n) {
        None => Ok(()),
        Some(at) => Err(named_beyond(nearest[at], at, n)),
    }
}

fn named_beyond(body_vertex: u32, at: usize, posed: usize) -> Error {
    Error::mesh(
        "body",
        format!("vertex {body_vertex}"),
        format!("is named as nearest at index {at} but {posed} body vertices are posed"),
        "search again after changing the posed part of the body",
    )
}

/// Nearest body vertex of each garment vertex, `[block][garment vertex][lane]`, exact; spare lanes repeat the last frame.
///
/// # Errors
/// [`Error::Mesh`] for a body without finite vertices, [`Error::Numerics`] naming a garment vertex that is not finite.
pub fn nearest_body_vertices<T: Real>(garment: &Frames<T>, body: &Frames<T>) -> Result<Vec<u32>> {
    check_same_frames("body frames of the nearest-vertex search", garment, body)?;
    let (lanes, n) = (garment.lanes_used(), garment.vertices());
    let per_frame: Vec<Result<Vec<u32>>> = (0..garment.frames())
        .into_par_iter()
        .map(|frame| {
            let (block, lane) = (frame / lanes, frame % lanes);
            let points = lane_points(body, block, lane);
            nearest_of_all(&NearestGrid::new(&points), &lane_points(garment, block, lane))
                .map_err(|problem| problem.into_error(block, lane))
        })
        .collect();
    let per_frame = per_frame.into_iter().collect::<Result<Vec<_>>>()?;
    let mut out = vec![0u32; garment.blocks() * n * T::LANES];
    if n == 0 {
        return Ok(out);
    }
    for (block, rows) in out.chunks_exact_mut(n * T::LANES).enumerate() {
        let frames = &per_frame[block * lanes..][..lanes];
        for (v, row) in rows.chunks_exact_mut(T::LANES).enumerate() {
            for (l, slot) in row.iter_mut().enumerate() {
                *slot = frames[l.min(lanes - 1)][v];
            }
        }
    }
    Ok(out)
}

/// One frame as arrays [m].
pub(crate) fn lane_points<T: Real>(frames: &Frames<T>, block: usize, lane: usize) -> Vec<[T; 3]> {
    let l = T::LANES;
    frames.block(block).chunks_exact(3 * l).map(|row| [row[lane], row[l + lane], row[2 * l + lane]]).collect()
}

/// Why a nearest point could not be found.
pub(crate) enum NoNearest<T> {
    /// The set of points is empty.
    Empty,
    /// A query is not finite.
    Query(usize, [T; 3]),
}

impl<T: Real> NoNearest<T> {
    pub(crate) fn into_error(self, block: usize, lane: usize) -> Error {
        match self {
            Self::Empty => Error::mesh(
                "points to search",
                format!("step {block}, window {lane}"),
                "no finite point".to_string(),
                "give the part of the body (or the scan, or the other garment) that can be reached",
            ),
            Self::Query(vertex, [x, y, z]) => Error::numerics(
                "nearest point",
                format!("vertex {vertex} of step {block}, window {lane} is at ({x}, {y}, {z})"),
                "go back to the last good state with a smaller step",
            ),
        }
    }
}

/// Nearest point of each query. The answer of the query before bounds the search: neighbours in a mesh's order are usually
/// neighbours in space.
pub(crate) fn nearest_of_all<T: Real>(
    grid: &NearestGrid<T>,
    queries: &[[T; 3]],
) -> std::result::Result<Vec<u32>, NoNearest<T>> {
    let mut out = Vec::with_capacity(queries.len());
    let mut last = u32::MAX;
    for (v, query) in queries.iter().enumerate() {
        match grid.nearest_from(query, last) {
            Some((id, _)) => {
                out.push(id);
                last = id;
            }
            None if query.iter().all(|c| c.is_finite()) => return Err(NoNearest::Empty),
            None => return Err(NoNearest::Query(v, *query)),
        }
    }
    Ok(out)
}

#[inline(always)]
pub(crate) fn square_distance<T: Real>(a: &[T; 3], b: &[T; 3]) -> T {
    let (x, y, z) = (a[0] - b[0], a[1] - b[1], a[2] - b[2]);
    x * x + y * y + z * z
}

simd_kernel! {
    /// Adds Σ w max(ε − n·(x − p), 0)³ per lane and its gradient by x.
    fn penalty<T>(
        weights: &[T],
        margin: T,
        weight: T,
        x: &[T],
        body: (&[T], &[T]),
        nearest: &[u32],
        energy: &mut [f64; MAX_LANES],
        wanted: bool,
        gradient: &mut [T],
    ) {
        let lanes = T::LANES;
        let (points, normals) = body;
        let three = T::of(3.0);
        for (v, (&w, ids)) in weights.iter().zip(nearest.chunks_exact(lanes)).enumerate() {
            let w = w * weight;
            let x = row(x, v as u32);
            let mut p = [T::zero(); 3 * MAX_LANES];
            let mut n = [T::zero(); 3 * MAX_LANES];
            for l in 0..lanes {
                let at = ids[l] as usize * 3 * lanes + l;
                for axis in 0..3 {
                    p[axis * lanes + l] = points[at + axis * lanes];
                    n[axis * lanes + l] = normals[at + axis * lanes];
                }
            }
            let mut depth = [T::zero(); MAX_LANES];
            let mut touched = false;
            for l in 0..lanes {
                let (i, j) = (lanes + l, 2 * lanes + l);
                let d = n[l] * (x[l] - p[l]) + n[i] * (x[i] - p[i]) + n[j] * (x[j] - p[j]);
                // Written so that NaN counts as depth and is found out.
                depth[l] = if d >= margin { T::zero() } else { margin - d };
                touched |= depth[l] != T::zero();
            }
            if !touched {
                continue;
            }
            let mut g = [T::zero(); 3 * MAX_LANES];
            for l in 0..lanes {
                let square = w * depth[l] * depth[l];
                energy[l] += (square * depth[l]).to_f64();
                let push = -three * square;
                for axis in 0..3 {
                    g[axis * lanes + l] = push * n[axis * lanes + l];
                }
            }
            if wanted {
                add_row(gradient, v as u32, &g);
            }
        }
    }
}
