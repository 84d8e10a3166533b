//! Pose correctives: B_P(θ) = P (R - I), where skinning alone would collapse the skin at joints.

use super::CHUNK;
use caphy_core::Vec3;
use nalgebra::{Matrix3, SMatrix};
use rayon::prelude::*;

/// The directions P of the joints that have any; joints whose columns are all zero are dropped.
#[derive(Debug, Clone)]
pub(super) struct PoseCorrectives {
    /// Joints that have correctives, ascending.
    joints: Vec<usize>,
    /// P [m], shape [vertex_count · 3][9 · joints], flat.
    data: Vec<f32>,
}

impl PoseCorrectives {
    /// From all directions, shape [vertex_count][xyz][9 · (joint_count - 1)]; `None` when they are absent or all zero.
    pub(super) fn new(all: Vec<f32>, vertex_count: usize) -> Option<Self> {
        let width = all.len() / (3 * vertex_count);
        let mut used = vec![false; width / 9];
        for row in all.chunks_exact(width.max(1)) {
            for (used, columns) in used.iter_mut().zip(row.chunks_exact(9)) {
                *used |= columns.iter().any(|&p| p != 0.0);
            }
        }
        let joints: Vec<usize> = (0..used.len()).filter(|&i| used[i]).map(|i| i + 1).collect();
        if joints.is_empty() {
            return None;
        }
        if 9 * joints.len() == width {
            return Some(Self { joints, data: all });
        }
        let mut data = Vec::with_capacity(3 * vertex_count * 9 * joints.len());
        for row in all.chunks_exact(width) {
            for j in &joints {
                data.extend_from_slice(&row[9 * (j - 1)..9 * j]);
            }
        }
        Some(Self { joints, data })
    }
    /// Number of columns.
    pub(super) fn width(&self) -> usize {
        9 * self.joints.len()
    }
    /// The joint of each group of nine columns.
    pub(super) fn joints(&self) -> &[usize] {
        &self.joints
    }
    /// All directions [m], shape [vertex_count][xyz][width], flat.
    pub(super) fn data(&self) -> &[f32] {
        &self.data
    }
    /// The three rows of a vertex, shape [xyz][width].
    pub(super) fn rows(&self, vertex: usize) -> &[f32] {
        &self.data[3 * vertex * self.width()..3 * (vertex + 1) * self.width()]
    }
    /// R - I, row by row, for each joint that has correctives.
    pub(super) fn features(&self, local: &[Matrix3<f64>]) -> Vec<f64> {
        let mut out = Vec::with_capacity(self.width());
        for &j in &self.joints {
            let m = local[j] - Matrix3::identity();
            out.extend((0..3).flat_map(|r| (0..3).map(move |c| (r, c))).map(|rc| m[rc]));
        }
        out
    }
    /// Adds the correctives of a pose to all vertices [m].
    pub(super) fn add(&self, local: &[Matrix3<f64>], vertices: &mut [Vec3]) {
        let features = self.features(local);
        let Some((from, to)) = nonzero_range(&features) else { return };
        let features = &features[from..to];
        vertices.par_chunks_mut(CHUNK).enumerate().for_each(|(chunk, vertices)| {
            for (i, v) in vertices.iter_mut().enumerate() {
                for (axis, row) in self.rows(chunk * CHUNK + i).chunks_exact(self.width()).enumerate() {
                    v[axis] += dot(&row[from..to], features);
                }
            }
        });
    }
    /// Gradient with respect to the features, for cotangents of all vertices.
    pub(super) fn features_gradient(&self, cotangents: &[Vec3]) -> Vec<f64> {
        let partial: Vec<Vec<f64>> = cotangents
            .par_chunks(CHUNK)
            .enumerate()
            .map(|(chunk, cotangents)| {
                let mut out = vec![0.0; self.width()];
                for (i, g) in cotangents.iter().enumerate() {
                    for (axis, row) in self.rows(chunk * CHUNK + i).chunks_exact(self.width()).enumerate() {
                        if g[axis] != 0.0 {
                            for (o, p) in out.iter_mut().zip(row) {
                                *o += g[axis] * f64::from(*p);
                            }
                        }
                    }
                }
                out
            })
            .collect();
        let mut out = vec![0.0; self.width()];
        for part in partial {
            for (o, p) in out.iter_mut().zip(part) {
                *o += p;
            }
        }
        out
    }
    /// Derivative of a vertex's corrective by the entries of one joint's rotation (row by row), `group` counted among
    /// [`PoseCorrectives::joints`].
    pub(super) fn block(&self, vertex: usize, group: usize) -> SMatrix<f64, 3, 9> {
        let rows = self.rows(vertex);
        SMatrix::from_fn(|axis, k| f64::from(rows[axis * self.width() + 9 * group + k]))
    }
}

/// The smallest range of whole joints that holds all features other than zero.
fn nonzero_range(features: &[f64]) -> Option<(usize, usize)> {
    let first = features.iter().position(|f| *f != 0.0)?;
    let last = features.iter().rposition(|f| *f != 0.0)?;
    Some((first / 9 * 9, last / 9 * 9 + 9))
}

/// Dot product with eight running sums, so that the additions do not wait for each other.
fn dot(p: &[f32], f: &[f64]) -> f64 {
    let (mut sums, split) = ([0.0; 8], p.len() / 8 * 8);
    for (p, f) in p[..split].chunks_exact(8).zip(f[..split].chunks_exact(8)) {
        for k in 0..8 {
            sums[k] += f64::from(p[k]) * f[k];
        }
    }
    let rest: f64 = p[split..].iter().zip(&f[split..]).map(|(p, f)| f64::from(*p) * f).sum();
    sums.iter().sum::<f64>() + rest
}
