//! Garment skinning (Eq. 2): V(θ) = W(V_T + dV(θ), J(β), θ, w_G), in lanes, and its vector-Jacobian product.

use caphy_core::body::BlendWeights;
use caphy_core::lanes::Frames;
use caphy_core::query::{Adjacency, NearestGrid};
use caphy_core::{Error, Real, Result, TriMesh, Vec3, simd_kernel};
use nalgebra::Matrix3x4;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// The widest register, in values: length of the per-lane scratch of kernels.
const MAX_LANES: usize = 16;
/// Entries of a blend transform.
const ENTRIES: usize = 12;
/// Vertices of a block that one thread skins in a row.
const PART: usize = 512;
/// Values of each lane that are turned from windows to lanes, or back, at a time: whole vertices.
const TILE: usize = 48;

/// How garment weights w_G are made from the body's: the paper's copy of the nearest body vertex, or that copy smoothed.
///
/// A copy jumps from arm to trunk and from thigh to thigh, and its tearing dominates the strain; smoothing trades it for drift
/// away from where the copy would go. Measured on the mannequin / the Anny body with templates of 25 mm edges, six poses (arms
/// down, up and forward, knee up, squat, straddle; `--example templates -- tearing`): largest stretch of an edge, stretch that 99 %
/// of the edges stay below, mean drift.
///
/// | `smoothing_m` | shirt, largest | trousers, largest | 99 % of edges | drift, mm |
/// |---|---|---|---|---|
/// | 0 (nearest) | 4.2 / 5.5 | 16.9 / 23.8 | 1.84 / 1.73 | 0 |
/// | 0.02 | 2.8 / 3.0 | 7.7 / 11.3 | 1.84 / 1.62 | 0.9 |
/// | 0.04 | 2.3 / 2.4 | 5.1 / 7.5 | 1.74 / 1.53 | 2 |
/// | 0.08 | 1.8 / 1.8 | 3.4 / 4.8 | 1.47 / 1.39 | 6 |
/// | 0.16 | 2.0 / 1.5 | 2.4 / 3.3 | 1.34 / 1.33 | 16 |
///
/// With 12 mm edges a copy tears more (25 / 35 in trousers), smoothed weights hardly (3.6 / 4.2 at 0.08).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct WeightOptions {
    /// Standard deviation of the smoothing over the garment's surface [m], so that templates of any resolution get the same;
    /// 0 is the paper's copy of the nearest body vertex. Default 0.08.
    pub smoothing_m: f64,
    /// Joints kept per vertex after smoothing, the strongest first; the rest is spread over them. Default 8.
    pub joints: usize,
}

impl Default for WeightOptions {
    fn default() -> Self {
        Self { smoothing_m: 0.08, joints: 8 }
    }
}

impl WeightOptions {
    /// The paper's: each vertex takes the weights of its nearest body vertex (Sec. 3.2).
    pub fn nearest() -> Self {
        Self { smoothing_m: 0.0, ..Self::default() }
    }
}

/// Widest smoothing [m]: beyond it a garment would move as one.
const WIDEST_SMOOTHING: f64 = 0.5;
/// Share that a vertex takes from the mean of its neighbours in a sweep.
const STEP: f64 = 0.5;
/// Most sweeps: the finest templates reach 0.08 m in 700.
const MOST_SWEEPS: f64 = 5000.0;

/// Weights w_G of garment vertices: rows of the nearest body vertices in the T-pose, then smoothed by the options.
///
/// `template` [m], shape [garment vertex]; `body` [m], shape [body vertex]: T-posed, shaped, with dT.
///
/// # Errors
/// [`Error::Length`] for body vertices without weights, [`Error::Mesh`] for an empty body, [`Error::Parameter`] for options
/// out of range.
pub fn garment_weights(
    template: &[Vec3],
    faces: &[[u32; 3]],
    body: &[Vec3],
    body_weights: &BlendWeights,
    options: &WeightOptions,
) -> Result<BlendWeights> {
    smoothed_weights(&nearest_weights(template, body, body_weights)?, template, faces, options)
}

/// The paper's weights: each garment vertex takes the row of the nearest body vertex.
pub fn nearest_weights(template: &[Vec3], body: &[Vec3], body_weights: &BlendWeights) -> Result<BlendWeights> {
    Error::check_length("rows of body skinning weights", body.len(), body_weights.vertex_count())?;
    let grid = NearestGrid::from_points(body);
    let rows = template
        .iter()
        .enumerate()
        .map(|(v, point)| match grid.nearest_point(point) {
            Some((id, _)) => Ok(body_weights.row(id as usize).map(|(j, w)| (j as u16, w)).collect()),
            None => Err(Error::mesh(
                "garment template",
                format!("vertex {v}"),
                format!("at ({}, {}, {}) has no nearest of {} body vertices", point.x, point.y, point.z, body.len()),
                "give a finite template and a body with vertices",
            )),
        })
        .collect::<Result<Vec<Vec<(u16, f64)>>>>()?;
    Ok(BlendWeights::from_rows(rows))
}

/// Laplacian smoothing of weights over a mesh: sweeps of w ← (1 − s) w + s mean of the neighbours' w; rows keep their strongest
/// joints and sum to 1.
///
/// A sweep over an even mesh of edge length L adds s L²/2 to the variance along each direction, so n = 2 σ²/(s L²) sweeps
/// smooth with standard deviation σ; `vertices` [m] tell L.
///
/// # Errors
/// As [`garment_weights`].
pub fn smoothed_weights(
    weights: &BlendWeights,
    vertices: &[Vec3],
    faces: &[[u32; 3]],
    options: &WeightOptions,
) -> Result<BlendWeights> {
    let n = weights.vertex_count();
    Error::check_length("rows of garment weights", vertices.len(), n)?;
    let within = (0.0..=WIDEST_SMOOTHING).contains(&options.smoothing_m);
    if !within || options.joints == 0 {
        let (name, value, lower, upper, unit) = match within {
            true => ("joints per garment vertex", 0.0, 1.0, f64::INFINITY, "1"),
            false => ("smoothing of garment weights", options.smoothing_m, 0.0, WIDEST_SMOOTHING, "m"),
        };
        return Err(Error::Parameter { name: name.into(), value, lower, upper, unit: unit.into() });
    }
    if let Some(face) = faces.iter().position(|f| f.iter().any(|&id| id as usize >= n)) {
        let problem = format!("names vertices {:?} but there are weights for {n}", faces[face]);
        return Err(Error::mesh("garment", format!("face {face}"), problem, "give weights for every vertex"));
    }
    let edge = TriMesh { vertices: vertices.to_vec(), faces: faces.to_vec() }.mean_edge_length();
    let sweeps = (2.0 / STEP * (options.smoothing_m / edge).powi(2)).round().min(MOST_SWEEPS);
    // No faces, no edges, nothing to smooth over.
    if options.smoothing_m == 0.0 || !sweeps.is_finite() {
        return Ok(weights.clone());
    }
    let columns = weights.joints.iter().map(|&j| usize::from(j) + 1).max().unwrap_or(0);
    let mut dense = vec![0.0; n * columns];
    for v in 0..n {
        for (j, w) in weights.row(v) {
            dense[v * columns + j] += w;
        }
    }
    let adjacency = Adjacency::new(n, faces);
    let mut next = dense.clone();
    for _ in 0..sweeps as usize {
        for v in 0..n {
            let neighbours = adjacency.of(v);
            if neighbours.is_empty() {
                continue;
            }
            let share = STEP / neighbours.len() as f64;
            for j in 0..columns {
                let sum: f64 = neighbours.iter().map(|&u| dense[u as usize * columns + j]).sum();
                next[v * columns + j] = (1.0 - STEP) * dense[v * columns + j] + share * sum;
            }
        }
        std::mem::swap(&mut dense, &mut next);
    }
    Ok(BlendWeights::from_rows(dense.chunks_exact(columns.max(1)).map(|row| strongest(row, options.joints))))
}

/// The strongest entries of a dense row, in joint order, summing to 1.
fn strongest(row: &[f64], count: usize) -> Vec<(u16, f64)> {
    let mut entries: Vec<(u16, f64)> =
        row.iter().enumerate().filter(|(_, w)| **w > 1e-5).map(|(j, &w)| (j as u16, w)).collect();
    // Ties go to the smaller joint, so that the choice does not depend on the sort.
    entries.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
    entries.truncate(count);
    entries.sort_by_key(|e| e.0);
    let total: f64 = entries.iter().map(|e| e.1).sum();
    entries.iter_mut().for_each(|e| e.1 /= total);
    entries
}

/// Blend transforms A_j of the joints that move a garment, of many frames, in lanes: `[block][joint][12][lane]`, row-major.
#[derive(Debug, Clone, PartialEq)]
pub struct JointFrames<T> {
    blocks: usize,
    joints: usize,
    lanes_used: usize,
    data: Vec<T>,
}

impl<T: Real> JointFrames<T> {
    /// Blocks (time steps).
    pub fn blocks(&self) -> usize {
        self.blocks
    }
    /// Lanes that carry a frame of their own.
    pub fn lanes_used(&self) -> usize {
        self.lanes_used
    }
    fn block(&self, block: usize) -> &[T] {
        let n = self.joints * ENTRIES * T::LANES;
        &self.data[block * n..][..n]
    }
}

/// Linear blend skinning of one garment.
///
/// A net's displacement is `[step][window][3 V]` (its natural output), frames are `[step][vertex][xyz][lane]`; the skinner
/// changes between the two.
#[derive(Debug, Clone)]
pub struct Skinner<T> {
    template: Vec<[T; 3]>,
    offsets: Vec<u32>,
    /// Index into `joints` and weight.
    entries: Vec<(u32, T)>,
    joints: Vec<usize>,
}

impl<T: Real> Skinner<T> {
    /// For a template V_T [m] and its weights w_G, both shape [garment vertex].
    ///
    /// # Errors
    /// [`Error::Length`] when they do not match, [`Error::NonFinite`] for bad values.
    pub fn new(template: &[Vec3], weights: &BlendWeights) -> Result<Self> {
        Error::check_length("rows of garment weights", template.len(), weights.vertex_count())?;
        Error::check_finite("garment weights", &weights.weights)?;
        let template: Vec<[T; 3]> = template.iter().map(|p| [T::of(p.x), T::of(p.y), T::of(p.z)]).collect();
        Error::check_finite("garment template", template.as_flattened())?;
        let mut joints: Vec<usize> = weights.joints.iter().map(|&j| usize::from(j)).collect();
        joints.sort_unstable();
        joints.dedup();
        let entries = weights
            .joints
            .iter()
            .zip(&weights.weights)
            .map(|(&j, &w)| (joints.partition_point(|&k| k < usize::from(j)) as u32, T::of(w)))
            .collect();
        Ok(Self { template, offsets: weights.offsets.clone(), entries, joints })
    }
    /// Only some vertices, in the given order: for targets of held vertices.
    ///
    /// # Errors
    /// [`Error::Mesh`] for a vertex that does not exist.
    pub fn select(&self, vertices: &[u32]) -> Result<Self> {
        let mut out = Self { template: Vec::new(), offsets: vec![0], entries: Vec::new(), joints: self.joints.clone() };
        for &v in vertices {
            let Some(&point) = self.template.get(v as usize) else {
                let problem = format!("does not exist, there are {}", self.template.len());
                return Err(Error::mesh("garment", format!("vertex {v}"), problem, "choose vertices of this garment"));
            };
            out.template.push(point);
            out.entries.extend_from_slice(&self.entries[self.row(v as usize)]);
            out.offsets.push(out.entries.len() as u32);
        }
        Ok(out)
    }
    /// Number of vertices.
    pub fn vertex_count(&self) -> usize {
        self.template.len()
    }
    /// Body joints that move the garment, ascending.
    pub fn joints(&self) -> &[usize] {
        &self.joints
    }
    fn row(&self, vertex: usize) -> std::ops::Range<usize> {
        self.offsets[vertex] as usize..self.offsets[vertex + 1] as usize
    }

    /// Puts transforms A_j of frames `[block * lanes_used + lane]` (each shape [body joint], as in
    /// [`caphy_core::body::PosedBody`]) into lanes; spare lanes repeat the last window.
    ///
    /// # Errors
    /// [`Error::Length`] for too many lanes, a frame count that is not a multiple of them, or a frame with too few joints.
    pub fn joint_frames(&self, frames: &[&[Matrix3x4<f64>]], lanes_used: usize) -> Result<JointFrames<T>> {
        if lanes_used == 0 || lanes_used > T::LANES {
            return Err(Error::Length { what: "lanes in use".into(), expected: T::LANES, got: lanes_used });
        }
        let blocks = frames.len() / lanes_used;
        Error::check_length("frames of joint transforms", blocks * lanes_used, frames.len())?;
        let needed = self.joints.last().map_or(0, |j| j + 1);
        if let Some(short) = frames.iter().find(|f| f.len() < needed) {
            return Err(Error::Length {
                what: "joint transforms of a frame".into(),
                expected: needed,
                got: short.len(),
            });
        }
        let mut data = Vec::with_capacity(blocks * self.joints.len() * ENTRIES * T::LANES);
        for block in frames.chunks_exact(lanes_used) {
            for &joint in &self.joints {
                for entry in 0..ENTRIES {
                    let at = (entry / 4, entry % 4);
                    data.extend((0..T::LANES).map(|l| T::of(block[l.min(lanes_used - 1)][joint][at])));
                }
            }
        }
        Ok(JointFrames { blocks, joints: self.joints.len(), lanes_used, data })
    }

    /// World positions W(V_T + dV, …) of every frame (Eq. 2) [m]. `displacement` is dV [m] as a net gives it,
    /// `[step][window][3 V]`; `None` skins the template itself.
    ///
    /// # Errors
    /// [`Error::Length`] for shapes that do not fit.
    pub fn forward(&self, joints: &JointFrames<T>, displacement: Option<&[T]>, out: &mut Frames<T>) -> Result<()> {
        self.forward_scaled(joints, displacement, T::one(), out)
    }

    /// [`Skinner::forward`] of `scale` times the displacement, rounded once more.
    ///
    /// # Errors
    /// As [`Skinner::forward`].
    pub fn forward_scaled(
        &self,
        joints: &JointFrames<T>,
        displacement: Option<&[T]>,
        scale: T,
        out: &mut Frames<T>,
    ) -> Result<()> {
        self.check("skinned positions", joints, out)?;
        let per_block = joints.lanes_used * 3 * self.vertex_count();
        if let Some(d) = displacement {
            Error::check_length("displacements dV, [step][window][3 V]", joints.blocks * per_block, d.len())?;
        }
        let (n, lanes) = (out.block_len(), joints.lanes_used);
        if n == 0 {
            return Ok(());
        }
        // Blocks are few: parts of them keep all threads busy to the end.
        let width = 3 * self.vertex_count();
        out.data_mut().par_chunks_mut(n).enumerate().for_each(|(block, out)| {
            let dv = displacement.map_or(&[][..], |d| &d[block * per_block..][..per_block]);
            out.par_chunks_mut(PART * 3 * T::LANES).enumerate().for_each(|(part, out)| {
                let first = part * PART;
                to_lanes(dv, width, 3 * first, lanes, out);
                blend_points(self.rows(first), joints.block(block), scale, out);
            });
        });
        Ok(())
    }

    /// One pose alone: `scale` times a displacement dV [m], shape [3 V], skinned by the transforms A_j of a frame, to positions
    /// [m], shape [V]. The bits of [`Skinner::forward_scaled`]; but where that fills its lanes with other frames, here a
    /// lane holds an entry of the transform.
    ///
    /// # Errors
    /// [`Error::Length`] for shapes that do not fit.
    pub fn pose(
        &self,
        transforms: &[Matrix3x4<f64>],
        displacement: &[T],
        scale: T,
        out: &mut Vec<[T; 3]>,
    ) -> Result<()> {
        let needed = self.joints.last().map_or(0, |j| j + 1);
        if transforms.len() < needed {
            let what = "joint transforms of a frame".into();
            return Err(Error::Length { what, expected: needed, got: transforms.len() });
        }
        Error::check_length("displacements dV, [3 V]", 3 * self.vertex_count(), displacement.len())?;
        let row = |&joint: &usize| {
            let by_rows = transforms[joint].transpose();
            std::array::from_fn(|i| by_rows.get(i).map_or(T::zero(), |&a| T::of(a)))
        };
        let rows: Vec<[T; MAX_LANES]> = self.joints.iter().map(row).collect();
        out.resize(self.vertex_count(), [T::zero(); 3]);
        blend_pose(self.rows(0), &rows, displacement.as_chunks().0, scale, out);
        Ok(())
    }

    /// Vector-Jacobian product: gradient by dV, `[step][window][3 V]` (overwritten), of a gradient by world positions: Mᵀ f
    /// with M the rotation part of the blended transform.
    ///
    /// # Errors
    /// [`Error::Length`] for shapes that do not fit.
    pub fn vjp(&self, joints: &JointFrames<T>, gradient: &Frames<T>, out: &mut [T]) -> Result<()> {
        self.vjp_scaled(joints, gradient, T::one(), out)
    }

    /// `scale` times [`Skinner::vjp`]: the gradient by what [`Skinner::forward_scaled`] scales.
    ///
    /// # Errors
    /// As [`Skinner::vjp`].
    pub fn vjp_scaled(&self, joints: &JointFrames<T>, gradient: &Frames<T>, scale: T, out: &mut [T]) -> Result<()> {
        self.check("gradient of skinned positions", joints, gradient)?;
        let per_block = joints.lanes_used * 3 * self.vertex_count();
        Error::check_length("gradient of dV, [step][window][3 V]", joints.blocks * per_block, out.len())?;
        if per_block == 0 {
            return Ok(());
        }
        let width = 3 * self.vertex_count();
        out.par_chunks_mut(per_block).enumerate().for_each(|(block, out)| {
            // Rows of windows, cut alike into parts of vertices.
            let mut parts: Vec<Vec<&mut [T]>> = Vec::new();
            parts.resize_with(self.vertex_count().div_ceil(PART), || Vec::with_capacity(joints.lanes_used));
            for window in out.chunks_exact_mut(width) {
                for (part, piece) in parts.iter_mut().zip(window.chunks_mut(3 * PART)) {
                    part.push(piece);
                }
            }
            parts.into_par_iter().enumerate().for_each(|(part, mut windows)| {
                let first = part * PART;
                let gradient = &gradient.block(block)[first * 3 * T::LANES..];
                blend_back(self.rows(first), joints.block(block), scale, gradient, &mut windows);
            });
        });
        Ok(())
    }
    /// The garment from a vertex on.
    fn rows(&self, first: usize) -> Rows<'_, T> {
        (&self.template[first..], &self.offsets[first..], &self.entries)
    }
    fn check(&self, what: &str, joints: &JointFrames<T>, frames: &Frames<T>) -> Result<()> {
        Error::check_length("joints of the transforms", self.joints.len(), joints.joints)?;
        Error::check_length(&format!("{what}, vertices"), self.vertex_count(), frames.vertices())?;
        Error::check_length(&format!("{what}, blocks"), joints.blocks, frames.blocks())?;
        Error::check_length(&format!("{what}, lanes in use"), joints.lanes_used, frames.lanes_used())
    }
}

/// Template, row offsets, entries of a [`Skinner`].
type Rows<'a, T> = (&'a [[T; 3]], &'a [u32], &'a [(u32, T)]);

/// Net layout `[window][3 V]` (rows of `width`) of one block to lanes `[vertex][xyz][lane]`, from value `first` of each window on;
/// zeros for an empty `values`.
///
/// Outside the kernels on purpose: with AVX-512 the compiler would make gathers of it, five times slower. In tiles: read along
/// windows, written along lanes, both within reach of the first cache.
fn to_lanes<T: Real>(values: &[T], width: usize, first: usize, used: usize, out: &mut [T]) {
    if values.is_empty() {
        out.fill(T::zero());
        return;
    }
    for (tile, out) in out.chunks_mut(TILE * T::LANES).enumerate() {
        let count = out.len() / T::LANES;
        for lane in 0..T::LANES {
            let from = &values[lane.min(used - 1) * width + first + tile * TILE..][..count];
            for (slot, value) in out[lane..].iter_mut().step_by(T::LANES).zip(from) {
                *slot = *value;
            }
        }
    }
}

/// Blended transform Σ w_j A_j, `[12][lane]`: one flat loop, which the compiler turns into whole registers.
#[inline(always)]
fn blend<T: Real>(entries: &[(u32, T)], joints: &[T], m: &mut [T; ENTRIES * MAX_LANES]) {
    let n = ENTRIES * T::LANES;
    for &(joint, w) in entries {
        let a = &joints[joint as usize * n..][..n];
        for i in 0..n {
            m[i] += w * a[i];
        }
    }
}

simd_kernel! {
    /// dV to Σ w_j A_j (V_T + scale dV) of some vertices of one block, in place.
    fn blend_points<T>(garment: Rows<'_, T>, joints: &[T], scale: T, points: &mut [T]) {
        let lanes = T::LANES;
        let (template, offsets, entries) = garment;
        for (v, (point, out)) in template.iter().zip(points.chunks_exact_mut(3 * lanes)).enumerate() {
            let mut m = [T::zero(); ENTRIES * MAX_LANES];
            blend(&entries[offsets[v] as usize..offsets[v + 1] as usize], joints, &mut m);
            for l in 0..lanes {
                let x = point[0] + scale * out[l];
                let y = point[1] + scale * out[lanes + l];
                let z = point[2] + scale * out[2 * lanes + l];
                out[l] = m[l] * x + m[lanes + l] * y + m[2 * lanes + l] * z + m[3 * lanes + l];
                out[lanes + l] = m[4 * lanes + l] * x + m[5 * lanes + l] * y + m[6 * lanes + l] * z + m[7 * lanes + l];
                out[2 * lanes + l] = m[8 * lanes + l] * x + m[9 * lanes + l] * y + m[10 * lanes + l] * z + m[11 * lanes + l];
            }
        }
    }
}

simd_kernel! {
    /// Σ w_j A_j (V_T + scale dV) of one pose; a row per joint holds the entries of A_j.
    fn blend_pose<T>(garment: Rows<'_, T>, joints: &[[T; MAX_LANES]], displacement: &[[T; 3]], scale: T, out: &mut [[T; 3]]) {
        let (template, offsets, entries) = garment;
        for (v, ((point, d), out)) in template.iter().zip(displacement).zip(out).enumerate() {
            let mut m = [T::zero(); MAX_LANES];
            for &(joint, w) in &entries[offsets[v] as usize..offsets[v + 1] as usize] {
                let a = &joints[joint as usize];
                for i in 0..MAX_LANES {
                    m[i] += w * a[i];
                }
            }
            let [x, y, z] = [0, 1, 2].map(|k| point[k] + scale * d[k]);
            *out = [0, 4, 8].map(|i| m[i] * x + m[i + 1] * y + m[i + 2] * z + m[i + 3]);
        }
    }
}

simd_kernel! {
    /// scale Mᵀ f of some vertices of one block, to the net's layout: a row per window in use.
    fn blend_back<T>(garment: Rows<'_, T>, joints: &[T], scale: T, gradient: &[T], windows: &mut [&mut [T]]) {
        let lanes = T::LANES;
        let (_, offsets, entries) = garment;
        let count = windows.first().map_or(0, |w| w.len() / 3);
        let mut tile = [T::zero(); TILE * MAX_LANES];
        for v in 0..count {
            let f = &gradient[v * 3 * lanes..][..3 * lanes];
            let mut m = [T::zero(); ENTRIES * MAX_LANES];
            blend(&entries[offsets[v] as usize..offsets[v + 1] as usize], joints, &mut m);
            let g = &mut tile[v * 3 % TILE * lanes..][..3 * lanes];
            for l in 0..lanes {
                for k in 0..3 {
                    let i = k * lanes + l;
                    g[i] = scale * (m[i] * f[l] + m[4 * lanes + i] * f[lanes + l] + m[8 * lanes + i] * f[2 * lanes + l]);
                }
            }
            let filled = v * 3 % TILE + 3;
            if filled == TILE || v + 1 == count {
                for (l, window) in windows.iter_mut().enumerate() {
                    let from = tile[l..].iter().step_by(lanes);
                    for (slot, value) in window[3 * (v + 1) - filled..3 * (v + 1)].iter_mut().zip(from) {
                        *slot = *value;
                    }
                }
            }
        }
    }
}
