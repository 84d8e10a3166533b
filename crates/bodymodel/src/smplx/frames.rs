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
        for (point, row) in points.as_chunks_mut::<48>().0.iter_mut().zip(offsets.windows(2)) {
            let mut blended = [[T::zero(); 16]; 12];
            for entry in row[0] as usize..row[1] as usize {
                let w = weights[entry];
                let from = joints[entry] as usize * 192;
                let transform = transforms[from..from + 192].as_chunks::<16>().0;
                for (b, t) in blended.iter_mut().zip(transform) {
                    for l in 0..16 {
                        b[l] += w * t[l];
                    }
                }
            }
            let p = *point;
            for axis in 0..3 {
                for l in 0..16 {
                    point[16 * axis + l] = blended[4 * axis][l] * p[l]
                        + blended[4 * axis + 1][l] * p[16 + l]
                        + blended[4 * axis + 2][l] * p[32 + l]
                        + blended[4 * axis + 3][l];
                }
            }
        }
    }
}

/// Skinning weights of the vertices asked for.
struct SubsetWeights {
    offsets: Vec<u32>,
    joints: Vec<u16>,
    weights: Vec<f32>,
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
        self.place_unposed(frames, ids, out)?;

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

    /// Writes T(β) + dT into all lanes. Frames of one body (the usual batch) compute it once.
    fn place_unposed(&self, frames: &[BodyParameters], ids: &[u32], out: &mut Frames<f32>) -> Result<()> {
        let lanes = out.lanes_used();
        let mut previous: Option<(&BodyParameters, Vec<Vec3>)> = None;
        for (i, parameters) in frames.iter().enumerate() {
            let same = previous.as_ref().is_some_and(|(p, _)| {
                p.shape == parameters.shape
                    && p.expression == parameters.expression
                    && p.displacement == parameters.displacement
            });
            if !same {
                let coefficients = self.coefficients(&parameters.shape, &parameters.expression)?;
                let point = |&id: &u32| {
                    let v = id as usize;
                    let mut p = self.template[v];
                    for &(k, c) in &coefficients {
                        p += self.directions[k][v] * c;
                    }
                    p + parameters.displacement.get(v).copied().unwrap_or_else(Vec3::zeros)
                };
                previous = Some((parameters, ids.iter().map(point).collect()));
            }
            if let Some((_, points)) = &previous {
                out.set_frame(i / lanes, i % lanes, points)?;
            }
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
