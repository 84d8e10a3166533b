//! Pose features: what a net is told about a frame.
//!
//! Model only what a scene requires: joints that move no garment vertex are left out, and the root's heading is replaced by
//! gravity seen from the root, since nothing else in a frame depends on it.

use caphy_core::body::{BlendWeights, Joint};
use caphy_core::pose::Pose;
use caphy_core::{Error, Real, Result, Vec3};
use nalgebra::Rotation3;
use serde::{Deserialize, Serialize};

/// Smallest standard deviation that features are divided by. Entries of rotations are of order 1: a joint that hardly moved
/// in training must not throw the net off by tens of deviations when it moves later.
const SMALLEST_DEVIATION: f64 = 0.1;

/// How a rotation is written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RotationForm {
    /// The first two columns of the rotation matrix: 6 numbers, continuous everywhere.
    #[default]
    SixD,
    /// Axis times angle [rad]: 3 numbers, as SNUG; jumps at π.
    AxisAngle,
}

impl RotationForm {
    /// Numbers per rotation.
    pub fn len(self) -> usize {
        match self {
            Self::SixD => 6,
            Self::AxisAngle => 3,
        }
    }
    /// Never: every form has numbers.
    pub fn is_empty(self) -> bool {
        false
    }
}

/// What is told besides the chosen joints.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FeatureOptions {
    /// How rotations are written. Default 6D.
    pub rotation: RotationForm,
    /// Whether the direction of gravity in the root's frame is told (3 numbers). Default true: the net must know where down is.
    pub gravity: bool,
    /// Whether the root's linear [m/s] and angular [rad/s] velocity in its own frame are told (6 numbers). Default false:
    /// quasi-static garments do not depend on it, and static scan poses have none.
    pub root_velocity: bool,
    /// Whether the root's own rotation is told, as in the paper's θ. Default false: gravity in the root's frame says all that matters.
    pub root_rotation: bool,
}

impl Default for FeatureOptions {
    fn default() -> Self {
        Self { rotation: RotationForm::SixD, gravity: true, root_velocity: false, root_rotation: false }
    }
}

/// Joints that move a garment against the root: those with weights and their ancestors, without the root, ascending.
pub fn moving_joints(joints: &[Joint], weights: &BlendWeights) -> Vec<usize> {
    let mut moves = vec![false; joints.len()];
    for (&j, &w) in weights.joints.iter().zip(&weights.weights) {
        let mut at = (w != 0.0).then_some(usize::from(j));
        while let Some(joint) = at.filter(|&joint| joint < joints.len() && !moves[joint]) {
            moves[joint] = true;
            at = joints[joint].parent;
        }
    }
    (0..joints.len()).filter(|&j| moves[j] && joints[j].parent.is_some()).collect()
}

/// Features of one garment's net, with their standardisation.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PoseFeatures {
    joints: Vec<usize>,
    options: FeatureOptions,
    /// Direction of gravity in the world (unit).
    down: Vec3,
    /// Mean and standard deviation of each feature over the frames that [`PoseFeatures::standardise`] saw; 0 and 1 before.
    mean: Vec<f64>,
    deviation: Vec<f64>,
}

impl PoseFeatures {
    /// For chosen joints (see [`moving_joints`]) and gravity as an acceleration [m/s²] (its direction counts).
    ///
    /// # Errors
    /// [`Error::Config`] when gravity has no direction but is to be told, or when there is nothing to tell.
    pub fn new(joints: Vec<usize>, options: FeatureOptions, gravity: Vec3) -> Result<Self> {
        let down = match gravity.try_normalize(1e-12) {
            Some(down) if down.iter().all(|c| c.is_finite()) => down,
            _ if !options.gravity => Vec3::zeros(),
            _ => {
                let problem = format!("gravity ({}, {}, {}) has no direction", gravity.x, gravity.y, gravity.z);
                return Err(Error::config("features.gravity", problem, "set it to false, or give gravity a length"));
            }
        };
        let mut out = Self { joints, options, down, mean: Vec::new(), deviation: Vec::new() };
        let n = out.count();
        if n == 0 {
            let remedy = "choose at least one joint, gravity or the root's velocity";
            return Err(Error::config("features", "a net without features cannot depend on the pose", remedy));
        }
        out.mean = vec![0.0; n];
        out.deviation = vec![1.0; n];
        Ok(out)
    }
    /// Features per frame.
    pub fn count(&self) -> usize {
        let o = &self.options;
        (self.joints.len() + usize::from(o.root_rotation)) * o.rotation.len()
            + 3 * usize::from(o.gravity)
            + 6 * usize::from(o.root_velocity)
    }
    /// Joints that are told.
    pub fn joints(&self) -> &[usize] {
        &self.joints
    }
    /// What is told besides.
    pub fn options(&self) -> &FeatureOptions {
        &self.options
    }

    /// Features of one frame before standardisation: joints, root rotation, gravity, root velocity.
    ///
    /// `previous` is the frame `step` seconds before; without it the velocity is zero.
    ///
    /// # Errors
    /// [`Error::Length`] for a pose with too few joints, [`Error::NonFinite`] for a bad one.
    pub fn raw(&self, pose: &Pose, previous: Option<&Pose>, step: f64) -> Result<Vec<f64>> {
        let rotations = &pose.rotations;
        let needed = self.joints.iter().max().map_or(0, |j| j + 1).max(1);
        for pose in previous.into_iter().chain([pose]) {
            if pose.rotations.len() < needed {
                let what = "joint rotations of a pose".into();
                return Err(Error::Length { what, expected: needed, got: pose.rotations.len() });
            }
        }
        let mut out = Vec::with_capacity(self.count());
        let root = Rotation3::from_scaled_axis(rotations[0]);
        for &j in &self.joints {
            self.write_rotation(&rotations[j], &mut out);
        }
        if self.options.root_rotation {
            self.write_rotation(&rotations[0], &mut out);
        }
        if self.options.gravity {
            out.extend((root.inverse() * self.down).iter());
        }
        if self.options.root_velocity {
            let (linear, angular) = match previous {
                None => (Vec3::zeros(), Vec3::zeros()),
                Some(previous) => {
                    // Both by backward difference; the root turns about its own joint, so its translation is its motion.
                    let before = Rotation3::from_scaled_axis(previous.rotations[0]);
                    let linear = root.inverse() * ((pose.translation - previous.translation) / step);
                    (linear, (before.inverse() * root).scaled_axis() / step)
                }
            };
            out.extend(linear.iter().chain(angular.iter()));
        }
        Error::check_finite("pose features", &out)?;
        Ok(out)
    }
    fn write_rotation(&self, axis_angle: &Vec3, out: &mut Vec<f64>) {
        match self.options.rotation {
            RotationForm::AxisAngle => out.extend(axis_angle.iter()),
            RotationForm::SixD => {
                let r = Rotation3::from_scaled_axis(*axis_angle);
                out.extend(r.matrix().fixed_columns::<2>(0).iter());
            }
        }
    }

    /// Takes mean and standard deviation from raw features of many frames. Deviations are at least 0.1.
    ///
    /// # Errors
    /// [`Error::Length`] for no frame or one of the wrong length.
    pub fn standardise(&mut self, frames: &[Vec<f64>]) -> Result<()> {
        let n = self.count();
        if frames.is_empty() {
            return Err(Error::Length { what: "frames to standardise features with".into(), expected: 1, got: 0 });
        }
        for frame in frames {
            Error::check_length("features of a frame", n, frame.len())?;
            Error::check_finite("features of a frame", frame)?;
        }
        let count = frames.len() as f64;
        for k in 0..n {
            let mean = frames.iter().map(|f| f[k]).sum::<f64>() / count;
            let variance = frames.iter().map(|f| (f[k] - mean).powi(2)).sum::<f64>() / count;
            let deviation = variance.sqrt();
            self.mean[k] = mean;
            self.deviation[k] = deviation.max(SMALLEST_DEVIATION);
        }
        Ok(())
    }
    /// Standardised features of one frame: (raw − mean) / deviation.
    ///
    /// # Errors
    /// As [`PoseFeatures::raw`].
    pub fn frame<T: Real>(&self, pose: &Pose, previous: Option<&Pose>, step: f64) -> Result<Vec<T>> {
        let raw = self.raw(pose, previous, step)?;
        Ok(raw.iter().zip(&self.mean).zip(&self.deviation).map(|((x, m), d)| T::of((x - m) / d)).collect())
    }
    /// Standardised features of windows of equal length, `[step][window][feature]`, as nets take them.
    ///
    /// `before` holds the frame before each window, where there is one (then the first step has a velocity).
    ///
    /// # Errors
    /// [`Error::Length`] for windows of different length, and as [`PoseFeatures::raw`].
    pub fn windows<T: Real>(&self, windows: &[&[Pose]], before: &[Option<&Pose>], step: f64) -> Result<Vec<T>> {
        Error::check_length("frames before the windows", windows.len(), before.len())?;
        let steps = windows.first().map_or(0, |w| w.len());
        if let Some(other) = windows.iter().find(|w| w.len() != steps) {
            return Err(Error::Length { what: "poses of a window".into(), expected: steps, got: other.len() });
        }
        let mut out = Vec::with_capacity(steps * windows.len() * self.count());
        for t in 0..steps {
            for (window, before) in windows.iter().zip(before) {
                let previous = if t == 0 { *before } else { Some(&window[t - 1]) };
                out.extend(self.frame::<T>(&window[t], previous, step)?);
            }
        }
        Ok(out)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pose(seed: f64) -> Pose {
        let mut pose = Pose::rest(4);
        for (j, r) in pose.rotations.iter_mut().enumerate() {
            *r = Vec3::new((seed + j as f64).sin(), (2.0 * seed + j as f64).cos(), (3.0 * seed).sin());
        }
        pose.translation = Vec3::new(seed, 0.0, -seed);
        pose
    }
    fn down() -> Vec3 {
        Vec3::new(0.0, -9.81, 0.0)
    }

    #[test]
    fn gravity_and_velocity_do_not_see_the_heading() {
        let options = FeatureOptions { root_velocity: true, ..FeatureOptions::default() };
        let features = PoseFeatures::new(vec![1, 3], options, down()).unwrap();
        assert_eq!(features.count(), 2 * 6 + 3 + 6);
        let (mut a, mut b) = (pose(0.3), pose(0.35));
        let before = features.raw(&b, Some(&a), 1.0 / 30.0).unwrap();
        let turn = Rotation3::from_scaled_axis(Vec3::new(0.0, 1.1, 0.0));
        a.rotate_world(&turn, &Vec3::zeros());
        b.rotate_world(&turn, &Vec3::zeros());
        let after = features.raw(&b, Some(&a), 1.0 / 30.0).unwrap();
        for (x, y) in before.iter().zip(&after) {
            assert!((x - y).abs() < 1e-12);
        }
        assert!(features.raw(&b, None, 1.0 / 30.0).unwrap()[15..].iter().all(|v| *v == 0.0));
    }

    #[test]
    fn six_d_is_continuous_at_pi_and_axis_angle_is_kept_raw() {
        let features = PoseFeatures::new(vec![1], FeatureOptions::default(), down()).unwrap();
        let mut a = Pose::rest(2);
        let mut b = Pose::rest(2);
        a.rotations[1] = Vec3::new(0.0, std::f64::consts::PI - 1e-9, 0.0);
        b.rotations[1] = Vec3::new(0.0, -std::f64::consts::PI + 1e-9, 0.0);
        let (a, b) = (features.raw(&a, None, 1.0).unwrap(), features.raw(&b, None, 1.0).unwrap());
        assert!(a.iter().zip(&b).all(|(x, y)| (x - y).abs() < 1e-8));
        let options = FeatureOptions { rotation: RotationForm::AxisAngle, gravity: false, ..Default::default() };
        let features = PoseFeatures::new(vec![1], options, down()).unwrap();
        assert_eq!(features.raw(&pose(0.2), None, 1.0).unwrap(), pose(0.2).rotations[1].as_slice());
    }

    #[test]
    fn standardised_features_have_mean_zero_and_deviation_one_and_survive_storage() {
        let mut features = PoseFeatures::new(vec![1, 2], FeatureOptions::default(), down()).unwrap();
        let poses: Vec<Pose> = (0..50).map(|i| pose(f64::from(i) * 0.37)).collect();
        let raw: Vec<Vec<f64>> = poses.iter().map(|p| features.raw(p, None, 1.0).unwrap()).collect();
        features.standardise(&raw).unwrap();
        let all: Vec<Vec<f64>> = poses.iter().map(|p| features.frame(p, None, 1.0).unwrap()).collect();
        for k in 0..features.count() {
            let mean = all.iter().map(|f| f[k]).sum::<f64>() / 50.0;
            let square = all.iter().map(|f| f[k] * f[k]).sum::<f64>() / 50.0;
            assert!(mean.abs() < 1e-12 && (square - 1.0).abs() < 1e-9, "{k}: {mean} {square}");
        }
        // A joint that never moves does not divide by zero.
        features.standardise(&vec![raw[0].clone(); 3]).unwrap();
        assert!(features.frame::<f32>(&poses[0], None, 1.0).unwrap().iter().all(|v| v.abs() < 1e-6));
        let text = serde_json::to_string(&features).unwrap();
        assert_eq!(serde_json::from_str::<PoseFeatures>(&text).unwrap(), features);
        assert!(features.standardise(&[]).is_err());
    }

    #[test]
    fn windows_are_step_major_and_bad_poses_are_refused() {
        let features = PoseFeatures::new(vec![1], FeatureOptions::default(), down()).unwrap();
        let (a, b) = ([pose(0.1), pose(0.2)], [pose(0.3), pose(0.4)]);
        let all: Vec<f64> = features.windows(&[&a, &b], &[None, None], 0.1).unwrap();
        assert_eq!(all[9..18], features.frame::<f64>(&b[0], None, 0.1).unwrap());
        assert!(features.windows::<f64>(&[&a, &b[..1]], &[None, None], 0.1).is_err());
        assert!(features.raw(&Pose::rest(1), None, 0.1).is_err());
        let mut bad = pose(0.1);
        bad.rotations[1].x = f64::NAN;
        assert!(features.raw(&bad, None, 0.1).is_err());
        assert!(PoseFeatures::new(vec![1], FeatureOptions::default(), Vec3::zeros()).is_err());
    }

    #[test]
    fn joints_that_move_nothing_are_left_out_but_ancestors_stay() {
        let joint = |parent| Joint { name: String::new(), parent };
        let joints = [joint(None), joint(Some(0)), joint(Some(1)), joint(Some(0)), joint(Some(2))];
        let weights = BlendWeights::from_rows([vec![(0, 0.5), (2, 0.5)], vec![(2, 1.0)], vec![(4, 0.0), (0, 1.0)]]);
        assert_eq!(moving_joints(&joints, &weights), [1, 2]);
    }
}
