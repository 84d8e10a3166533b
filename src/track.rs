//! Posed bodies of many frames, kept: training visits every frame of its motion again and again.

use crate::garment::FittedGarment;
use caphy_core::body::{BodyModel, BodyParameters};
use caphy_core::lanes::Frames;
use caphy_core::pose::Pose;
use caphy_core::{Error, Real, Result, TriMesh, Vec3};
use caphy_garment::contact::ContactMap;
use caphy_garment::energy::frame_normals;
use nalgebra::Matrix3x4;
use rayon::prelude::*;

/// How far from a garment's own region skin can be and still touch it [m]: loose cloth slides by a few centimetres.
const TOUCH: f64 = 0.08;

/// The part of a body that garments can reach.
#[derive(Debug, Clone)]
pub struct Reach {
    /// Body vertices.
    pub vertices: Vec<u32>,
    /// Triangles among them, in their numbering.
    pub faces: Vec<[u32; 3]>,
}

impl Reach {
    /// Body vertices within `distance` [m] of any garment vertex in the T-pose, with the triangles among them.
    ///
    /// Collision is only ever searched among these: a shirt cannot meet a foot.
    pub fn new(rest: &TriMesh, garments: &[&[Vec3]], distance: f64) -> Result<Reach> {
        let points: Vec<Vec3> = garments.iter().flat_map(|g| g.iter().copied()).collect();
        let grid = caphy_core::query::NearestGrid::from_points(&points);
        let limit = distance * distance;
        let keep: Vec<bool> =
            rest.vertices.par_iter().map(|v| grid.nearest_within(&[v.x, v.y, v.z], limit).is_some()).collect();
        let (mesh, vertices) = rest.submesh(&keep);
        if vertices.is_empty() {
            return Err(Error::mesh(
                "body",
                "vertices near the garments",
                format!("none within {distance} m"),
                "the templates do not lie on this body: fit them again",
            ));
        }
        Ok(Reach { vertices, faces: mesh.faces })
    }
    /// What each vertex of a garment can touch of the T-posed body, in the numbering of a [`BodyTrack`].
    pub fn contact(&self, rest: &TriMesh, garment: &FittedGarment) -> Result<ContactMap> {
        let body: Vec<Vec3> = self.vertices.iter().map(|&v| rest.vertices[v as usize]).collect();
        let all = rest.vertex_normals();
        let normals: Vec<Vec3> = self.vertices.iter().map(|&v| all[v as usize]).collect();
        ContactMap::new(&garment.mesh.vertices, &garment.weights, &body, &normals, TOUCH)
    }
}

/// Joint transforms and reachable surface of a body in many frames.
pub struct BodyTrack {
    /// Pose of each frame.
    pub poses: Vec<Pose>,
    /// Blend transforms of each frame, shape [joint_count].
    pub transforms: Vec<Vec<Matrix3x4<f64>>>,
    /// `[frame][vertex][xyz]` [m].
    positions: Vec<f32>,
    /// `[frame][vertex][xyz]`.
    normals: Vec<f32>,
    vertices: usize,
}

impl BodyTrack {
    /// Poses a body of fixed shape in every frame.
    pub fn new(body: &dyn BodyModel, subject: &BodyParameters, reach: &Reach, poses: &[Pose]) -> Result<BodyTrack> {
        let parameters: Vec<BodyParameters> = poses.iter().map(|p| subject.posed(p)).collect();
        let transforms = parameters
            .par_iter()
            .map(|p| body.skeleton(p).map(|posed| posed.transforms))
            .collect::<Vec<_>>()
            .into_iter()
            .collect::<Result<Vec<_>>>()?;
        let n = reach.vertices.len();
        let mut track = BodyTrack {
            poses: poses.to_vec(),
            transforms,
            positions: Vec::with_capacity(poses.len() * n * 3),
            normals: Vec::with_capacity(poses.len() * n * 3),
            vertices: n,
        };
        for chunk in parameters.chunks(<f32 as Real>::LANES) {
            let mut frames = Frames::<f32>::zeros(1, n, chunk.len());
            body.forward_frames(chunk, Some(&reach.vertices), &mut frames)?;
            let normals = frame_normals(&frames, &reach.faces)?;
            for lane in 0..chunk.len() {
                for (from, to) in [(&frames, &mut track.positions), (&normals, &mut track.normals)] {
                    let row = from.block(0).chunks_exact(<f32 as Real>::LANES).map(|values| values[lane]);
                    to.extend(row);
                }
            }
        }
        Ok(track)
    }
    /// Number of frames.
    pub fn len(&self) -> usize {
        self.poses.len()
    }
    /// Whether there are no frames.
    pub fn is_empty(&self) -> bool {
        self.poses.is_empty()
    }
    /// Positions and normals of frames `[block * lanes + lane]`, in lanes.
    pub fn gather<T: Real>(&self, frames: &[usize], lanes: usize) -> (Frames<T>, Frames<T>) {
        let blocks = frames.len() / lanes;
        let mut out = [0, 1].map(|_| Frames::<T>::zeros(blocks, self.vertices, lanes));
        let width = 3 * self.vertices;
        for (out, source) in out.iter_mut().zip([&self.positions, &self.normals]) {
            let n = out.block_len();
            if n == 0 {
                continue;
            }
            out.data_mut().par_chunks_mut(n).enumerate().for_each(|(block, values)| {
                let ids = &frames[block * lanes..(block + 1) * lanes];
                for (i, slot) in values.chunks_exact_mut(T::LANES).enumerate() {
                    for (l, slot) in slot.iter_mut().enumerate() {
                        *slot = T::of(f64::from(source[ids[l.min(lanes - 1)] * width + i]));
                    }
                }
            });
        }
        let [positions, normals] = out;
        (positions, normals)
    }
    /// Transforms of frames, as the skinner wants them.
    pub fn transforms(&self, frames: &[usize]) -> Vec<&[Matrix3x4<f64>]> {
        frames.iter().map(|&f| &self.transforms[f][..]).collect()
    }
}
