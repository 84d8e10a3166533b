//! Posed bodies of many frames: kept, since training visits every frame of its motion again and again, or posed anew where
//! keeping them would take too much memory.

use crate::garment::FittedGarment;
use caphy_core::body::{BodyModel, BodyParameters};
use caphy_core::lanes::Frames;
use caphy_core::pose::Pose;
use caphy_core::{Error, Real, Result, TriMesh, Vec3};
use caphy_garment::contact::ContactMap;
use caphy_garment::energy::frame_normals_into;
use nalgebra::Matrix3x4;
use rayon::prelude::*;
use std::sync::{Arc, Mutex, PoisonError};

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
    surface: Surface,
    vertices: usize,
}

/// Where the reachable surface comes from; both give the same bits.
enum Surface {
    Kept {
        /// `[frame][vertex][xyz]` [m].
        positions: Vec<f32>,
        /// `[frame][vertex][xyz]`.
        normals: Vec<f32>,
    },
    Posed {
        body: Arc<dyn BodyModel>,
        subject: BodyParameters,
        reach: Reach,
        /// Parameters of the last batch, of which the next changes the poses: dT is as large as the body.
        spare: Mutex<Vec<BodyParameters>>,
    },
}

/// Bytes of one vertex of a kept frame: position and normal.
const KEPT_VERTEX: usize = 2 * 3 * size_of::<f32>();

impl BodyTrack {
    /// Poses a body of fixed shape in every frame and keeps them all.
    ///
    /// # Errors
    /// What the body refuses a pose for.
    pub fn new(body: &dyn BodyModel, subject: &BodyParameters, reach: &Reach, poses: &[Pose]) -> Result<BodyTrack> {
        let n = reach.vertices.len();
        let mut kept = [0, 1].map(|_| Vec::with_capacity(poses.len() * n * 3));
        let mut parameters = Vec::new();
        let mut frames = [0, 1].map(|_| Frames::<f32>::zeros(0, 0, 1));
        let all: Vec<&Pose> = poses.iter().collect();
        for chunk in all.chunks(<f32 as Real>::LANES) {
            for frames in &mut frames {
                let memory = std::mem::replace(frames, Frames::zeros(0, 0, 1)).into_memory();
                *frames = Frames::with_memory(memory, 1, n, chunk.len());
            }
            let [positions, normals] = &mut frames;
            pose_frames(body, subject, reach, chunk, &mut parameters, positions, normals)?;
            for lane in 0..chunk.len() {
                for (from, to) in frames.iter().zip(&mut kept) {
                    let row = from.block(0).chunks_exact(<f32 as Real>::LANES).map(|values| values[lane]);
                    to.extend(row);
                }
            }
        }
        let [positions, normals] = kept;
        Self::with_surface(body, subject, poses, n, Surface::Kept { positions, normals })
    }
    /// As [`BodyTrack::new`] where that keeps at most `limit` bytes; else bodies are posed whenever they are asked for.
    ///
    /// # Errors
    /// As [`BodyTrack::new`].
    pub fn within(
        limit: usize,
        body: &Arc<dyn BodyModel>,
        subject: &BodyParameters,
        reach: &Reach,
        poses: &[Pose],
    ) -> Result<BodyTrack> {
        if Self::kept_bytes(poses.len(), reach) <= limit {
            return Self::new(&**body, subject, reach, poses);
        }
        let surface = Surface::Posed {
            body: body.clone(),
            subject: subject.clone(),
            reach: reach.clone(),
            spare: Mutex::default(),
        };
        Self::with_surface(&**body, subject, poses, reach.vertices.len(), surface)
    }
    /// What keeping so many frames takes [bytes].
    pub fn kept_bytes(frames: usize, reach: &Reach) -> usize {
        frames.saturating_mul(reach.vertices.len() * KEPT_VERTEX)
    }
    fn with_surface(
        body: &dyn BodyModel,
        subject: &BodyParameters,
        poses: &[Pose],
        vertices: usize,
        surface: Surface,
    ) -> Result<BodyTrack> {
        // One error for one input, whatever the number of threads.
        let transforms: Vec<Result<_>> =
            poses.par_iter().map(|p| body.skeleton(&subject.posed(p)).map(|posed| posed.transforms)).collect();
        let transforms = transforms.into_iter().collect::<Result<Vec<_>>>()?;
        Ok(BodyTrack { poses: poses.to_vec(), transforms, surface, vertices })
    }
    /// Number of frames.
    pub fn len(&self) -> usize {
        self.poses.len()
    }
    /// Whether there are no frames.
    pub fn is_empty(&self) -> bool {
        self.poses.is_empty()
    }
    /// Vertices of the reachable surface.
    pub fn vertices(&self) -> usize {
        self.vertices
    }
    /// Positions and normals of frames `[block * lanes + lane]`, in lanes.
    ///
    /// # Errors
    /// As [`BodyTrack::gather_into`].
    pub fn gather<T: Real>(&self, frames: &[usize], lanes: usize) -> Result<(Frames<T>, Frames<T>)> {
        let blocks = frames.len() / lanes;
        let mut single = [0, 1].map(|_| Frames::<f32>::zeros(blocks, self.vertices, lanes));
        let [positions, normals] = &mut single;
        self.gather_into(frames, positions, normals)?;
        let widened = single.map(|single| {
            let mut out = Frames::<T>::zeros(blocks, self.vertices, lanes);
            let rows = out.data_mut().chunks_exact_mut(T::LANES);
            for (to, from) in rows.zip(single.data().chunks_exact(<f32 as Real>::LANES)) {
                for (l, to) in to.iter_mut().enumerate() {
                    *to = T::of(f64::from(from[l.min(lanes - 1)]));
                }
            }
            out
        });
        let [positions, normals] = widened;
        Ok((positions, normals))
    }
    /// Positions and normals of frames `[block * lanes + lane]`, into frames of [`BodyTrack::vertices`] with so many blocks and
    /// lanes, whatever they held.
    ///
    /// # Errors
    /// [`Error::Length`] for another shape; what the body refuses, where frames are not kept.
    pub fn gather_into(&self, frames: &[usize], positions: &mut Frames<f32>, normals: &mut Frames<f32>) -> Result<()> {
        for out in [&*positions, &*normals] {
            Error::check_length("vertices of gathered bodies", self.vertices, out.vertices())?;
            Error::check_length("frames of gathered bodies", frames.len(), out.frames())?;
        }
        match &self.surface {
            Surface::Kept { positions: from, normals: from_normals } => {
                for (out, from) in [(positions, from), (normals, from_normals)] {
                    let (n, lanes) = (out.block_len(), out.lanes_used());
                    if n > 0 {
                        out.data_mut().par_chunks_mut(n).zip(frames.par_chunks(lanes)).for_each(|(block, ids)| {
                            to_lanes(from, ids, block);
                        });
                    }
                }
                Ok(())
            }
            Surface::Posed { body, subject, reach, spare } => {
                let mut parameters = std::mem::take(&mut *spare.lock().unwrap_or_else(PoisonError::into_inner));
                let poses: Vec<&Pose> = frames.iter().map(|&f| &self.poses[f]).collect();
                let done = pose_frames(&**body, subject, reach, &poses, &mut parameters, positions, normals);
                *spare.lock().unwrap_or_else(PoisonError::into_inner) = parameters;
                done
            }
        }
    }
    /// Transforms of frames, as the skinner wants them.
    pub fn transforms(&self, frames: &[usize]) -> Vec<&[Matrix3x4<f64>]> {
        frames.iter().map(|&f| &self.transforms[f][..]).collect()
    }
}

/// Poses the reachable surface, with its normals.
fn pose_frames(
    body: &dyn BodyModel,
    subject: &BodyParameters,
    reach: &Reach,
    poses: &[&Pose],
    parameters: &mut Vec<BodyParameters>,
    positions: &mut Frames<f32>,
    normals: &mut Frames<f32>,
) -> Result<()> {
    if parameters.len() < poses.len() {
        parameters.resize(poses.len(), subject.clone());
    }
    for (parameters, pose) in parameters.iter_mut().zip(poses) {
        parameters.rotations.clone_from(&pose.rotations);
        parameters.translation = pose.translation;
    }
    body.forward_frames(&parameters[..poses.len()], Some(&reach.vertices), positions)?;
    frame_normals_into(positions, &reach.faces, normals)
}

/// Frames `ids` of `[frame][value]` to one block `[value][lane]`; spare lanes repeat the last.
fn to_lanes(source: &[f32], ids: &[usize], block: &mut [f32]) {
    const LANES: usize = <f32 as Real>::LANES;
    let width = block.len() / LANES;
    // Tiles of 1 kB: read along frames, written along lanes, both within reach of the first cache.
    for (tile, out) in block.chunks_mut(LANES * LANES).enumerate() {
        let count = out.len() / LANES;
        for lane in 0..LANES {
            let id = ids[lane.min(ids.len() - 1)];
            let from = &source[id * width + tile * LANES..][..count];
            for (slot, value) in out[lane..].iter_mut().step_by(LANES).zip(from) {
                *slot = *value;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use caphy_bodymodel::BodyMannequin;
    use caphy_bodymodel::procedural_motion::{MotionKind, procedural_clip};

    #[test]
    fn kept_bodies_and_bodies_posed_in_the_step_are_the_same_to_the_bit() {
        let body: Arc<dyn BodyModel> = Arc::new(BodyMannequin { resolution: 0.03 }.generate().unwrap());
        let mut subject = BodyParameters::rest(body.describe().joints.len(), &[0.4, -0.3]);
        let count = body.describe().vertex_count;
        subject.displacement = (0..count).map(|v| Vec3::new(0.001 * (v as f64).sin(), 0.0, 0.002)).collect();
        let rest = TriMesh { vertices: body.forward(&subject).unwrap().vertices, faces: body.describe().faces.clone() };
        let keep: Vec<bool> = rest.vertices.iter().map(|v| v.y > 0.1).collect();
        let (mesh, vertices) = rest.submesh(&keep);
        assert!((1000..count).contains(&vertices.len()), "{}", vertices.len());
        let reach = Reach { vertices, faces: mesh.faces };
        let poses = procedural_clip(MotionKind::Walk, 1, 1.5, 20.0).unwrap().poses;
        let bytes = poses.len() * reach.vertices.len() * KEPT_VERTEX;
        let kept = BodyTrack::within(bytes, &body, &subject, &reach, &poses).unwrap();
        let posed = BodyTrack::within(bytes - 1, &body, &subject, &reach, &poses).unwrap();
        assert!(matches!(kept.surface, Surface::Kept { .. }) && matches!(posed.surface, Surface::Posed { .. }));
        for (frames, lanes) in [(vec![3, 9, 4, 10, 5, 11], 2), ((0..20).collect(), 5), (vec![7], 1)] {
            let a = kept.gather::<f32>(&frames, lanes).unwrap();
            assert!(a == posed.gather::<f32>(&frames, lanes).unwrap(), "{frames:?}");
            assert!(kept.gather::<f64>(&frames, lanes).unwrap() == posed.gather::<f64>(&frames, lanes).unwrap());
            // Against the body itself, in double precision: single precision at the size of a body, and the sum of the
            // roundings of a few transforms.
            for (i, &frame) in frames.iter().enumerate() {
                let truth = body.forward(&subject.posed(&poses[frame])).unwrap();
                for (at, &id) in reach.vertices.iter().enumerate().step_by(97) {
                    assert!((a.0.get(i / lanes, i % lanes, at) - truth.vertices[id as usize]).norm() < 1e-5);
                }
            }
        }
        let mut wrong = Frames::zeros(1, 3, 2);
        assert!(kept.gather_into(&[0, 1], &mut wrong.clone(), &mut wrong).is_err());
    }
}
