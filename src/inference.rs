//! Playing a trained garment: a whole clip with carried state, or single poses.

use crate::config::TrainConfig;
use crate::garment::{FittedGarment, TrainedGarment};
use crate::plugins::PluginTable;
use crate::track::BodyTrack;
use caphy_core::array::Out;
use caphy_core::lanes::Frames;
use caphy_core::net::{DeformationNet, ForwardBlock, ForwardCall};
use caphy_core::pose::Pose;
use caphy_core::query::NearestGrid;
use caphy_core::{Error, Real, Result, TriMesh, Vec3};
use caphy_garment::contact::ContactMap;
use caphy_garment::skinning::Skinner;
use nalgebra::{Matrix3x4, UnitQuaternion};

/// How frames follow each other.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Play {
    /// Consecutive frames of one clip: state is carried, velocities are known from the second frame on.
    Clip,
    /// Unrelated static poses.
    Poses,
}

/// A trained garment that is posed frame by frame, in memory of its own.
pub struct Player<'a> {
    trained: &'a TrainedGarment,
    net: Box<dyn DeformationNet>,
    skinner: Skinner<f32>,
    state: Vec<f32>,
    next_state: Vec<f32>,
    displacement: Vec<f32>,
    vertices: Vec<[f32; 3]>,
}

impl<'a> Player<'a> {
    /// At rest: no state carried.
    ///
    /// # Errors
    /// [`Error::Config`] for another net than the trained one.
    pub fn new(garment: &FittedGarment, trained: &'a TrainedGarment, spec: &PluginTable) -> Result<Player<'a>> {
        let outputs = 3 * garment.mesh.vertices.len();
        let net = spec.net(trained.features.count(), outputs)?;
        if *net.manifest() != trained.manifest {
            return Err(Error::config(
                "net",
                "the trained net has other sizes than the configured one",
                "use the configuration that the avatar was trained with",
            ));
        }
        let state = vec![0.0; trained.manifest.state];
        Ok(Player {
            trained,
            net,
            skinner: Skinner::new(&garment.mesh.vertices, &garment.weights)?,
            next_state: state.clone(),
            state,
            displacement: vec![0.0; outputs],
            vertices: Vec::new(),
        })
    }
    /// Forgets the frames so far.
    pub fn rest(&mut self) {
        self.state.fill(0.0);
    }
    /// The net's answer to a pose after another: dV in units of [`TrainedGarment::output_scale_m`], shape [3 V]. The state goes
    /// one step on.
    ///
    /// # Errors
    /// A pose that is not finite or has too few joints; what the net refuses.
    pub fn displace(&mut self, pose: &Pose, previous: Option<&Pose>) -> Result<&[f32]> {
        let features: Vec<f32> = self.trained.features.frame(pose, previous, 1.0 / self.trained.fps)?;
        let mut block = ForwardBlock {
            steps: 1,
            batch: 1,
            parameters: (&self.trained.parameters[..]).into(),
            features: (&features[..]).into(),
            state_before: (&self.state[..]).into(),
            output: (&mut self.displacement[..]).into(),
            state_after: (&mut self.next_state[..]).into(),
            tape: Out::absent(),
        };
        self.net.forward(ForwardCall::F32(&mut block))?;
        std::mem::swap(&mut self.state, &mut self.next_state);
        Ok(&self.displacement)
    }
    /// The garment in a pose after another [m], shape [V]; `transforms` are the body's A_j in that pose.
    ///
    /// # Errors
    /// As [`Player::displace`]; [`Error::Length`] for too few transforms.
    pub fn frame(
        &mut self,
        pose: &Pose,
        previous: Option<&Pose>,
        transforms: &[Matrix3x4<f64>],
    ) -> Result<&[[f32; 3]]> {
        self.displace(pose, previous)?;
        let scale = self.trained.output_scale_m as f32;
        self.skinner.pose(transforms, &self.displacement, scale, &mut self.vertices)?;
        Ok(&self.vertices)
    }
}

/// Where a pose was as long before the first one as `later` comes after it, if nothing changed its pace: joints turn, and the root
/// moves, on as they do after it.
fn earlier(first: &Pose, later: &Pose) -> Pose {
    let before = |(a, b): (&Vec3, &Vec3)| {
        let (a, b) = (UnitQuaternion::from_scaled_axis(*a), UnitQuaternion::from_scaled_axis(*b));
        (a * b.inverse() * a).scaled_axis()
    };
    Pose {
        rotations: first.rotations.iter().zip(&later.rotations).map(before).collect(),
        translation: 2.0 * first.translation - later.translation,
    }
}

/// Garment vertices of every frame of a track [m], shape [frame][vertex].
///
/// A clip goes on from a motion that it does not show. The net watches as many frames of it as windows are led into with: from
/// nothing its first answers leap.
pub fn play(
    garment: &FittedGarment,
    trained: &TrainedGarment,
    spec: &PluginTable,
    track: &BodyTrack,
    how: Play,
) -> Result<Vec<Vec<Vec3>>> {
    let mut player = Player::new(garment, trained, spec)?;
    let mut out = Vec::with_capacity(track.len());
    let mut before: Option<Pose> = None;
    if how == Play::Clip {
        let lead_in = TrainConfig::default().lead_in.min(track.len().saturating_sub(1));
        for frame in (1..=lead_in).rev() {
            let pose = earlier(&track.poses[0], &track.poses[frame]);
            player.displace(&pose, before.as_ref())?;
            before = Some(pose);
        }
    }
    for frame in 0..track.len() {
        let previous = match how {
            Play::Clip if frame > 0 => Some(&track.poses[frame - 1]),
            Play::Clip => before.as_ref(),
            Play::Poses => None,
        };
        if how == Play::Poses {
            player.rest();
        }
        let posed = player.frame(&track.poses[frame], previous, &track.transforms[frame])?;
        Error::check_finite(&format!("posed {} of frame {frame}", garment.kind), posed.as_flattened())?;
        out.push(posed.iter().map(|p| Vec3::from_fn(|k, _| f64::from(p[k]))).collect());
    }
    Ok(out)
}

/// Where each garment vertex would touch the body: point [m] and outward normal of its nearest candidate in one frame of a
/// track.
pub fn contacts(map: &ContactMap, track: &BodyTrack, frame: usize, garment: &[Vec3]) -> Result<Vec<(Vec3, Vec3)>> {
    let mut positions = Frames::<f64>::zeros(1, garment.len(), 1);
    positions.set_frame(0, 0, garment)?;
    let (body, normals) = track.gather::<f64>(&[frame], 1)?;
    let nearest = map.nearest(&positions, &body)?;
    Ok((0..garment.len())
        .map(|v| {
            let id = nearest[v * <f64 as Real>::LANES] as usize;
            (body.get(0, 0, id), normals.get(0, 0, id))
        })
        .collect())
}

/// Signed distance of each vertex to the tangent plane where it would touch [m], negative inside.
pub fn clearance(garment: &[Vec3], contacts: &[(Vec3, Vec3)]) -> Vec<f64> {
    garment.iter().zip(contacts).map(|(p, (at, normal))| normal.dot(&(p - at))).collect()
}

/// Moves vertices that are closer than `gap` [m] out along the normal (SNUG's post-process).
pub fn push_out(garment: &mut [Vec3], contacts: &[(Vec3, Vec3)], gap: f64) {
    for (p, (at, normal)) in garment.iter_mut().zip(contacts) {
        let distance = normal.dot(&(*p - at));
        if distance < gap {
            *p += normal * (gap - distance);
        }
    }
}

/// Moves vertices of the outer garment that lie beneath the inner one, or closer above it than `gap` [m], out of it. Only within
/// `reach` [m], and only beside a vertex of the inner garment, not beyond its border.
pub fn push_layers(outer: &mut [Vec3], inner: &TriMesh, gap: f64, reach: f64) {
    let normals = inner.vertex_normals();
    let grid = NearestGrid::from_points(&inner.vertices);
    let beside = inner.mean_edge_length();
    for p in outer {
        let Some((id, square)) = grid.nearest_within(&[p.x, p.y, p.z], reach * reach) else { continue };
        let normal = normals[id as usize];
        let distance = normal.dot(&(*p - inner.vertices[id as usize]));
        if distance < gap && square - distance * distance < beside * beside {
            *p += normal * (gap - distance);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_before_a_clip_keeps_its_pace() {
        let (first, later) = (Vec3::new(0.3, -0.2, 0.9), Vec3::new(-0.1, 0.5, 1.1));
        let pose = |rotation: Vec3, translation: Vec3| Pose { rotations: vec![rotation], translation };
        let (a, b) = (pose(first, Vec3::x()), pose(later, Vec3::new(1.5, 0.1, 0.0)));
        let before = earlier(&a, &b);
        let turn = |from: &Pose, to: &Pose| {
            let [from, to] = [from, to].map(|p| UnitQuaternion::from_scaled_axis(p.rotations[0]));
            to * from.inverse()
        };
        assert!(turn(&before, &a).angle_to(&turn(&a, &b)) < 1e-12);
        assert!((before.translation - Vec3::new(0.5, -0.1, 0.0)).norm() < 1e-12);
        // Who stands still has stood still.
        assert!((earlier(&a, &a).rotations[0] - first).norm() < 1e-12);
    }

    #[test]
    fn pushing_out_leaves_a_gap_and_nothing_else_moves() {
        let contacts = [(Vec3::zeros(), Vec3::y()); 2];
        let mut cloth = [Vec3::new(0.001, -0.01, 0.0), Vec3::new(0.0, 0.05, 0.0)];
        push_out(&mut cloth, &contacts, 0.002);
        assert!((cloth[0].y - 0.002).abs() < 1e-15 && cloth[1].y == 0.05);
        assert!(clearance(&cloth, &contacts).iter().all(|&d| d > 0.0019));
    }
}
