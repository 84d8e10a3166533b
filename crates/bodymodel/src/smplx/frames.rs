//! Many poses at once in f32: pose correctives as one matrix product per chunk of vertices, skinning in lanes.

use super::pose_correctives::nonzero_range;
use super::{BodySmplx, CHUNK};
use caphy_core::body::BodyParameters;
use caphy_core::lanes::Frames;
use caphy_core::{Error, Real, Result, Vec3, simd_kernel};
use rayon::prelude::*;

/// Frames per register of f32.
const L: usize = <f32 as Real>::LANES;

simd_kernel! {
    /// Skins one chunk of vertices of one block in place. `points` and `transforms` are `[vertex][xyz][16]` and
    /// `[joint][12][16]` (rows of a 3×4 matrix); `offsets` has one more entry than there are vertices.
    fn skin<T>(points: &mut [T], offsets: &[u32], joints: &[u16], weights: &[T], transforms: &[T]) {
        let transforms = transforms.as_chunks::<192>().0;
        for (point, row) in points.as_chunks_mut::<48>().0.iter_mut().zip(offsets.windows(2)) {
            let p = *point;
            let mut sum = [T::zero(); 48];
            let entries = row[0] as usize..row[1] as usize;
            for (&joint, &w) in joints[entries.clone()].iter().zip(&weights[entries]) {
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
}

/// Skinning weights of the vertices asked for.
struct SubsetWeights {
    offsets: Vec<u32>,
    joints: Vec<u16>,
    weights: Vec<f32>,
}

/// Whether two sets of parameters differ in the pose alone.
fn same_body(a: &BodyParameters, b: &BodyParameters) -> bool {
    a.shape == b.shape && a.expression == b.expression && a.displacement == b.displacement
}

impl BodySmplx {
    /// See `BodyModel::forward_frames`.
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
        if let Some(id) = ids.iter().find(|id| **id as usize >= self.template.len()) {
            return Err(Error::mesh(
                self.description.name.clone(),
                format!("vertex {id}"),
                format!("does not exist, there are {}", self.template.len()),
                "ask for vertices of this body",
            ));
        }
        let (blocks, lanes, joint_count) = (out.blocks(), out.lanes_used(), self.joint_template.len());
        if ids.is_empty() || blocks == 0 {
            return Ok(());
        }

        // Joints per frame in f64: cheap, and rounded once.
        let width = self.correctives.as_ref().map_or(0, |c| c.width());
        let mut transforms = vec![0.0f32; blocks * joint_count * 192];
        let mut features = vec![0.0f64; width * blocks * L];
        for (i, parameters) in frames.iter().enumerate() {
            self.check(parameters)?;
            let coefficients = self.coefficients(&parameters.shape, &parameters.expression)?;
            let skeleton = self.skeleton(&coefficients, &parameters.rotations);
            let (block, lane) = (i / lanes, i % lanes);
            // Spare lanes repeat the last frame of their block.
            let last = if lane + 1 == lanes { L } else { lane + 1 };
            for (j, m) in skeleton.transforms(&parameters.translation).iter().enumerate() {
                for (entry, value) in m.transpose().iter().enumerate() {
                    let at = ((block * joint_count + j) * 12 + entry) * L;
                    transforms[at + lane..at + last].fill(*value as f32);
                }
            }
            if let Some(correctives) = &self.correctives {
                for (k, f) in correctives.features(&skeleton.local).iter().enumerate() {
                    let at = k * blocks * L + block * L;
                    features[at + lane..at + last].fill(*f);
                }
            }
        }
        // The usual batch is one body in many poses: its surface is spread over the lanes once.
        let one_body = frames.windows(2).all(|pair| same_body(&pair[0], &pair[1]));
        let shared = match frames.first() {
            Some(first) if one_body => self.unposed_points(first, ids)?,
            _ => {
                self.place_unposed(frames, ids, out)?;
                Vec::new()
            }
        };

        let range = {
            let busy: Vec<f64> =
                features.chunks_exact(blocks * L).map(|row| row.iter().map(|f| f.abs()).sum()).collect();
            nonzero_range(&busy)
        };
        let features: Vec<f32> = features.iter().map(|f| *f as f32).collect();
        let weights = self.subset_weights(ids);

        // All blocks of a chunk of vertices travel together, so that its correctives are read once.
        let block_len = out.block_len();
        let mut pieces: Vec<Vec<&mut [f32]>> = ids.chunks(CHUNK).map(|_| Vec::with_capacity(blocks)).collect();
        for block in out.data_mut().chunks_exact_mut(block_len) {
            for (chunk, piece) in block.chunks_mut(CHUNK * 3 * L).enumerate() {
                pieces[chunk].push(piece);
            }
        }
        pieces.into_par_iter().enumerate().for_each(|(chunk, mut pieces)| {
            let from = chunk * CHUNK;
            let ids = &ids[from..(from + CHUNK).min(ids.len())];
            if one_body {
                for piece in &mut pieces {
                    for (lanes, p) in piece.chunks_exact_mut(3 * L).zip(&shared[from..]) {
                        for axis in 0..3 {
                            lanes[axis * L..(axis + 1) * L].fill(p[axis] as f32);
                        }
                    }
                }
            }
            if let (Some(_), Some(range)) = (&self.correctives, range) {
                self.add_correctives(ids, &features, range, &mut pieces);
            }
            let offsets = &weights.offsets[from..=from + ids.len()];
            for (block, piece) in pieces.iter_mut().enumerate() {
                let transforms = &transforms[block * joint_count * 192..(block + 1) * joint_count * 192];
                skin(piece, offsets, &weights.joints, &weights.weights, transforms);
            }
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

    /// Adds P (R - I) to one chunk of vertices in all blocks; `features` is `[column][block][16]`.
    fn add_correctives(&self, ids: &[u32], features: &[f32], range: (usize, usize), pieces: &mut [&mut [f32]]) {
        let Some(correctives) = &self.correctives else { return };
        let (rows, depth, columns) = (3 * ids.len(), range.1 - range.0, pieces.len() * L);
        let mut directions = Vec::with_capacity(rows * depth);
        for &id in ids {
            for row in correctives.rows(id as usize).chunks_exact(correctives.width()) {
                directions.extend_from_slice(&row[range.0..range.1]);
            }
        }
        let features = &features[range.0 * columns..range.1 * columns];
        let mut product = vec![0.0f32; rows * columns];
        assert!(directions.len() == rows * depth && features.len() == depth * columns);
        // SAFETY: the three matrices are row-major with the row lengths given, and their sizes were checked just above;
        // `product` is not aliased.
        unsafe {
            gemm::gemm(
                rows,
                columns,
                depth,
                product.as_mut_ptr(),
                1,
                columns as isize,
                false,
                directions.as_ptr(),
                1,
                depth as isize,
                features.as_ptr(),
                1,
                columns as isize,
                0.0,
                1.0,
                false,
                false,
                false,
                gemm::Parallelism::None,
            );
        }
        for (block, piece) in pieces.iter_mut().enumerate() {
            for (out, row) in piece.chunks_exact_mut(L).zip(product.chunks_exact(columns)) {
                for (o, p) in out.iter_mut().zip(&row[block * L..(block + 1) * L]) {
                    *o += p;
                }
            }
        }
    }
}
