//! Many poses at once in f32: frames in lanes, pose correctives and skinning in one pass over the vertices.

use super::{BodySmplx, CHUNK};
use caphy_core::body::BodyParameters;
use caphy_core::lanes::Frames;
use caphy_core::{Error, Real, Result, Vec3, simd_kernel};
use rayon::prelude::*;
use std::ops::Range;

/// Frames per register of f32.
const L: usize = <f32 as Real>::LANES;
/// Values of a 3×4 transform, row by row, in every lane.
const TRANSFORM: usize = 12 * L;

/// Blocks whose correctives are summed at once: three coordinates of so many blocks stay in registers, so that each
/// direction is loaded once for all of them.
fn blocks_at_once() -> usize {
    #[cfg(target_arch = "x86_64")]
    {
        if caphy_core::simd::has_avx512() {
            return 5;
        }
        if caphy_core::simd::has_avx2() {
            return 2;
        }
    }
    1
}

/// What all vertices of a batch share.
struct Batch<'a, T> {
    /// Rows of 3×4 blend transforms, `[block][joint][12][16]`.
    transforms: &'a [T],
    joint_count: usize,
    /// R - I, `[column][block][16]`; empty without correctives.
    features: &'a [T],
    /// Columns that are not zero in all frames.
    columns: &'a [Range<usize>],
    blocks_at_once: usize,
}

/// Some vertices.
struct Chunk<'a, T> {
    /// T(β) + dT [m] when all frames share it; else it stands in the output already.
    surface: Option<&'a [[T; 3]]>,
    ids: &'a [u32],
    /// Correctives of all vertices of the body, `[vertex][xyz][width]`; empty without.
    directions: &'a [T],
    width: usize,
    /// Skinning weights in compressed rows: one offset more than there are vertices.
    offsets: &'a [u32],
    joints: &'a [u16],
    weights: &'a [T],
}

simd_kernel! {
    /// Poses a chunk of vertices in all blocks; `pieces` is `[block][vertex][xyz][16]`.
    fn pose_chunk<T>(batch: &Batch<'_, T>, chunk: &Chunk<'_, T>, pieces: &mut [&mut [T]]) {
        for vertex in 0..chunk.ids.len() {
            let mut first = 0;
            for group in pieces.chunks_mut(batch.blocks_at_once) {
                match group {
                    [a, b, c, d, e] => pose_vertex(batch, chunk, vertex, first, [a, b, c, d, e]),
                    [a, b, c, d] => pose_vertex(batch, chunk, vertex, first, [a, b, c, d]),
                    [a, b, c] => pose_vertex(batch, chunk, vertex, first, [a, b, c]),
                    [a, b] => pose_vertex(batch, chunk, vertex, first, [a, b]),
                    group => {
                        for (block, piece) in group.iter_mut().enumerate() {
                            pose_vertex(batch, chunk, vertex, first + block, [piece]);
                        }
                    }
                }
                first += batch.blocks_at_once;
            }
        }
    }
}

/// Poses one vertex in B blocks from block `first` on.
#[inline(always)]
fn pose_vertex<T: Real, const B: usize>(
    batch: &Batch<'_, T>,
    chunk: &Chunk<'_, T>,
    vertex: usize,
    first: usize,
    pieces: [&mut &mut [T]; B],
) {
    let moved = correctives::<T, B>(batch, chunk, vertex, first);
    let row = chunk.offsets[vertex] as usize..chunk.offsets[vertex + 1] as usize;
    let (joints, weights) = (&chunk.joints[row.clone()], &chunk.weights[row]);
    for (block, piece) in pieces.into_iter().enumerate() {
        let Some(point) = piece.as_chunks_mut::<48>().0.get_mut(vertex) else { return };
        let mut p = [T::zero(); 48];
        for axis in 0..3 {
            for l in 0..16 {
                let at = chunk.surface.map_or(point[16 * axis + l], |surface| surface[vertex][axis]);
                p[16 * axis + l] = at + moved[block][axis][l];
            }
        }
        let from = (first + block) * batch.joint_count * TRANSFORM;
        let transforms = batch.transforms[from..from + batch.joint_count * TRANSFORM].as_chunks::<TRANSFORM>().0;
        let mut sum = [T::zero(); 48];
        for (&joint, &w) in joints.iter().zip(weights) {
            let t = &transforms[joint as usize];
            // One loop over lanes per joint: this shape is what the compiler turns into whole registers.
            for l in 0..16 {
                let (x, y, z) = (p[l], p[16 + l], p[32 + l]);
                sum[l] += w * (t[l] * x + t[16 + l] * y + t[32 + l] * z + t[48 + l]);
                sum[16 + l] += w * (t[64 + l] * x + t[80 + l] * y + t[96 + l] * z + t[112 + l]);
                sum[32 + l] += w * (t[128 + l] * x + t[144 + l] * y + t[160 + l] * z + t[176 + l]);
            }
        }
        *point = sum;
    }
}

/// P (R - I) of one vertex in B blocks from block `first` on, `[block][xyz][16]`.
#[inline(always)]
fn correctives<T: Real, const B: usize>(
    batch: &Batch<'_, T>,
    chunk: &Chunk<'_, T>,
    vertex: usize,
    first: usize,
) -> [[[T; 16]; 3]; B] {
    let mut sums = [[[T::zero(); 16]; 3]; B];
    if batch.columns.is_empty() {
        return sums;
    }
    let width = chunk.width;
    let rows = &chunk.directions[3 * width * chunk.ids[vertex] as usize..][..3 * width];
    let (x, yz) = rows.split_at(width);
    let (y, z) = yz.split_at(width);
    let stride = batch.features.len() / width;
    for columns in batch.columns {
        let features = &batch.features[stride * columns.start..stride * columns.end];
        let directions = x[columns.clone()].iter().zip(&y[columns.clone()]).zip(&z[columns.clone()]);
        for (((x, y), z), features) in directions.zip(features.chunks_exact(stride)) {
            let Some(features) = features.as_chunks::<16>().0.get(first..).and_then(|f| f.first_chunk::<B>()) else {
                return sums;
            };
            for block in 0..B {
                let sum = &mut sums[block];
                sum[0] = multiply_add(sum[0], *x, features[block]);
                sum[1] = multiply_add(sum[1], *y, features[block]);
                sum[2] = multiply_add(sum[2], *z, features[block]);
            }
        }
    }
    sums
}

/// `sum + d f` in every lane. By value: this shape keeps the sums of all blocks in registers.
#[inline(always)]
fn multiply_add<T: Real>(sum: [T; 16], d: T, f: [T; 16]) -> [T; 16] {
    let mut out = [T::zero(); 16];
    for l in 0..16 {
        out[l] = sum[l] + d * f[l];
    }
    out
}

/// Skinning weights of the vertices asked for.
struct SubsetWeights {
    offsets: Vec<u32>,
    joints: Vec<u16>,
    weights: Vec<f32>,
}

/// Whether two sets of parameters differ in the pose alone, as far as some vertices are concerned.
fn same_body(a: &BodyParameters, b: &BodyParameters, ids: &[u32]) -> bool {
    let dt = |p: &BodyParameters, id: u32| p.displacement.get(id as usize).copied();
    a.shape == b.shape
        && a.expression == b.expression
        && a.displacement.len() == b.displacement.len()
        && (a.displacement.is_empty() || ids.iter().all(|&id| dt(a, id) == dt(b, id)))
}

impl BodySmplx {
    /// See `BodyModel::forward_frames`. Displacements of vertices that are not asked for are not looked at.
    pub(super) fn pose_frames(
        &self,
        frames: &[BodyParameters],
        subset: Option<&[u32]>,
        out: &mut Frames<f32>,
    ) -> Result<()> {
        Error::check_length("frames of a batch", out.frames(), frames.len())?;
        let all: Vec<u32>;
        let ids = match subset {
            Some(ids) => ids,
            None => {
                all = (0..self.template.len() as u32).collect();
                &all
            }
        };
        Error::check_length("vertices of a frame", out.vertices(), ids.len())?;
        self.description.check_vertices(ids)?;
        let (blocks, lanes, joint_count) = (out.blocks(), out.lanes_used(), self.joint_template.len());

        // Joints per frame in f64: cheap, and rounded once.
        let width = self.correctives.as_ref().map_or(0, |c| c.width());
        let mut transforms = vec![0.0f32; blocks * joint_count * TRANSFORM];
        let mut features = vec![0.0f32; width * blocks * L];
        let mut busy = vec![false; width / 9];
        let mut one_body = true;
        for (i, parameters) in frames.iter().enumerate() {
            self.check_pose(parameters)?;
            let same = i > 0 && same_body(&frames[i - 1], parameters, ids);
            if !same {
                self.check_displacement(parameters, ids.iter().map(|id| *id as usize))?;
                one_body = i == 0;
            }
            let coefficients = self.coefficients(&parameters.shape, &parameters.expression)?;
            let skeleton = self.skeleton_of(&coefficients, &parameters.rotations);
            let (block, lane) = (i / lanes, i % lanes);
            // Spare lanes repeat the last frame of their block.
            let last = if lane + 1 == lanes { L } else { lane + 1 };
            for (j, m) in skeleton.transforms(&parameters.translation).iter().enumerate() {
                for (entry, value) in m.transpose().iter().enumerate() {
                    let at = (block * joint_count + j) * TRANSFORM + entry * L;
                    transforms[at + lane..at + last].fill(*value as f32);
                }
            }
            if let Some(correctives) = &self.correctives {
                for (k, f) in correctives.features(&skeleton.local).iter().enumerate() {
                    busy[k / 9] |= *f != 0.0;
                    let at = (k * blocks + block) * L;
                    features[at + lane..at + last].fill(*f as f32);
                }
            }
        }
        if ids.is_empty() || frames.is_empty() {
            return Ok(());
        }
        // The usual batch is one body in many poses: its surface is shared by all lanes.
        let shared = if one_body {
            self.unposed_points(&frames[0], ids)?.iter().map(|p| [0, 1, 2].map(|k| p[k] as f32)).collect()
        } else {
            self.place_unposed(frames, ids, out)?;
            Vec::new()
        };
        let weights = self.subset_weights(ids);
        let batch = Batch {
            transforms: &transforms,
            joint_count,
            features: &features,
            columns: &busy_columns(&busy),
            blocks_at_once: blocks_at_once(),
        };

        // All blocks of a chunk of vertices travel together, so that its correctives are read once.
        let block_len = out.block_len();
        let mut pieces: Vec<Vec<&mut [f32]>> = ids.chunks(CHUNK).map(|_| Vec::with_capacity(blocks)).collect();
        for block in out.data_mut().chunks_exact_mut(block_len) {
            for (chunk, piece) in block.chunks_mut(CHUNK * 3 * L).enumerate() {
                pieces[chunk].push(piece);
            }
        }
        pieces.into_par_iter().enumerate().for_each(|(chunk, mut pieces)| {
            let range = chunk * CHUNK..((chunk + 1) * CHUNK).min(ids.len());
            let chunk = Chunk {
                surface: one_body.then(|| &shared[range.clone()]),
                ids: &ids[range.clone()],
                directions: self.correctives.as_ref().map_or(&[], |c| c.data()),
                width,
                offsets: &weights.offsets[range.start..=range.end],
                joints: &weights.joints,
                weights: &weights.weights,
            };
            pose_chunk(&batch, &chunk, &mut pieces);
        });
        Ok(())
    }

    /// T(β) + dT of some vertices [m].
    fn unposed_points(&self, parameters: &BodyParameters, ids: &[u32]) -> Result<Vec<Vec3>> {
        let coefficients = self.coefficients(&parameters.shape, &parameters.expression)?;
        let point = |&id: &u32| {
            let v = id as usize;
            let mut p = self.template[v];
            for &(k, c) in &coefficients {
                p += self.directions[k][v] * c;
            }
            p + parameters.displacement.get(v).copied().unwrap_or_else(Vec3::zeros)
        };
        Ok(ids.iter().map(point).collect())
    }

    /// Writes T(β) + dT of each frame into its lane.
    fn place_unposed(&self, frames: &[BodyParameters], ids: &[u32], out: &mut Frames<f32>) -> Result<()> {
        let lanes = out.lanes_used();
        for (i, parameters) in frames.iter().enumerate() {
            out.set_frame(i / lanes, i % lanes, &self.unposed_points(parameters, ids)?)?;
        }
        Ok(())
    }

    fn subset_weights(&self, ids: &[u32]) -> SubsetWeights {
        let mut out = SubsetWeights { offsets: vec![0], joints: Vec::new(), weights: Vec::new() };
        for &id in ids {
            for (j, w) in self.description.weights.row(id as usize) {
                out.joints.push(j as u16);
                out.weights.push(w as f32);
            }
            out.offsets.push(out.joints.len() as u32);
        }
        out
    }
}

/// Runs of columns of joints that turn in some frame; nine columns per joint.
fn busy_columns(busy: &[bool]) -> Vec<Range<usize>> {
    let mut out: Vec<Range<usize>> = Vec::new();
    for group in (0..busy.len()).filter(|&g| busy[g]) {
        match out.last_mut() {
            Some(run) if run.end == 9 * group => run.end += 9,
            _ => out.push(9 * group..9 * group + 9),
        }
    }
    out
}
