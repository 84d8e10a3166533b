//! Variations of recorded motion: little motion is learnt by heart, and what a net then makes of other motion is worse the longer it
//! learns.

use crate::random::{normal, uniform};
use caphy_core::motion::MotionClip;
use caphy_core::pose::{Pose, SMPLX_JOINTS, smplx_joint};
use caphy_core::{Error, Result, Vec3};
use nalgebra::UnitQuaternion;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;

/// `[motion.variation]`: copies of every training clip that differ from it.
///
/// A copy is mirrored or not (an even chance), plays faster or slower, half the time holds the arms of another clip, and its joints
/// turn slowly about those of the clip. Copies pass the same limits as recorded motion.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct MotionVariation {
    /// Copies of every clip. Default 0: the clips alone, for hours of motion; a minute of it takes about 10.
    pub copies: usize,
    /// Most that a copy is faster or slower, as a factor. Default 1.3; 1 keeps the pace.
    pub tempo: f64,
    /// Whether copies may be mirrored. Default true.
    pub mirror: bool,
    /// Whether copies may hold the arms of other clips. Default true.
    pub arms: bool,
    /// How far shoulders and elbows turn away from the clip (standard deviation over copies of an amplitude) [degrees]; hips and
    /// knees turn by two thirds of it, trunk, neck and collars by one third. Default 6: at 15 nets spend themselves on poses that
    /// nobody takes.
    pub turn_degrees: f64,
}

impl Default for MotionVariation {
    fn default() -> Self {
        Self { copies: 0, tempo: 1.3, mirror: true, arms: true, turn_degrees: 6.0 }
    }
}

/// Periods of the slow turns [s]: slower than steps, quicker than a clip.
const PERIODS: (f64, f64) = (1.5, 5.0);

impl MotionVariation {
    /// Checks the numbers.
    ///
    /// # Errors
    /// [`Error::Config`] naming the key.
    pub fn check(&self) -> Result<()> {
        if !(self.tempo >= 1.0 && self.tempo <= 4.0) {
            let remedy = "give a factor from 1 (as recorded) to 4";
            return Err(Error::config("motion.variation.tempo", format!("{}", self.tempo), remedy));
        }
        if !(self.turn_degrees >= 0.0 && self.turn_degrees <= 60.0) {
            let problem = format!("{}", self.turn_degrees);
            return Err(Error::config("motion.variation.turn_degrees", problem, "give 0 to 60 degrees"));
        }
        Ok(())
    }
    /// Copy number `copy` of clip number `clip` among all recorded clips; a function of the seed and the two numbers.
    ///
    /// # Errors
    /// As [`MotionClip::new`].
    pub fn vary(&self, clips: &[MotionClip], clip: usize, copy: usize, seed: u64) -> Result<MotionClip> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed ^ 0x7a61_5269);
        rng.set_stream((clip as u64) << 32 | copy as u64);
        let source = &clips[clip];
        let pace = uniform(&mut rng, -1.0, 1.0);
        let fps = source.fps * self.tempo.powf(pace);
        let mirrored = uniform(&mut rng, 0.0, 1.0) < 0.5;
        let other = &clips[((uniform(&mut rng, 0.0, 1.0) * clips.len() as f64) as usize).min(clips.len() - 1)];
        let start = uniform(&mut rng, 0.0, 1.0) * other.duration();
        let borrows = uniform(&mut rng, 0.0, 1.0) < 0.5;
        let turns: Vec<[Turn; 3]> = SMPLX_JOINTS
            .iter()
            .map(|name| {
                let amplitude = self.turn_degrees.to_radians() * share(name);
                std::array::from_fn(|_| Turn::draw(&mut rng, amplitude))
            })
            .collect();
        let poses = (0..source.poses.len())
            .map(|frame| {
                let time = frame as f64 / fps;
                let mut pose = source.poses[frame].clone();
                if self.arms && borrows {
                    let arms = other.at(there_and_back(start + time, other.duration()));
                    for (j, name) in SMPLX_JOINTS.iter().enumerate().take(pose.rotations.len()) {
                        if let (true, Some(rotation)) = (of_arm(name), arms.rotations.get(j)) {
                            pose.rotations[j] = *rotation;
                        }
                    }
                }
                if self.mirror && mirrored {
                    pose = mirror(&pose);
                }
                for (rotation, turns) in pose.rotations.iter_mut().zip(&turns) {
                    let [x, y, z] = turns.each_ref().map(|turn| turn.at(time));
                    if x != 0.0 || y != 0.0 || z != 0.0 {
                        let turn = UnitQuaternion::from_scaled_axis(Vec3::new(x, y, z));
                        *rotation = (turn * UnitQuaternion::from_scaled_axis(*rotation)).scaled_axis();
                    }
                }
                pose
            })
            .collect();
        MotionClip::new(format!("{} (copy {})", source.name, copy + 1), fps, poses)
    }
}

/// A slow turn about one axis.
struct Turn {
    amplitude: f64,
    frequency: f64,
    phase: f64,
}

impl Turn {
    fn draw(rng: &mut ChaCha8Rng, amplitude: f64) -> Turn {
        // Everything is drawn, whether it counts or not: one setting does not change what another one draws.
        let size = normal(rng);
        let frequency = 1.0 / uniform(rng, PERIODS.0, PERIODS.1);
        Turn { amplitude: amplitude * size, frequency, phase: uniform(rng, 0.0, TAU) }
    }
    fn at(&self, time: f64) -> f64 {
        if self.amplitude == 0.0 { 0.0 } else { self.amplitude * (TAU * self.frequency * time + self.phase).sin() }
    }
}

/// Share of [`MotionVariation::turn_degrees`] by which a joint turns: what moves far moves farther. Hands and face stay, and the root
/// leans no more than the trunk bends.
fn share(joint: &str) -> f64 {
    match joint.rsplit('_').next().unwrap_or_default() {
        "shoulder" | "elbow" => 1.0,
        "hip" | "knee" => 2.0 / 3.0,
        "pelvis" | "spine1" | "spine2" | "spine3" | "neck" | "head" | "collar" => 1.0 / 3.0,
        _ => 0.0,
    }
}

fn of_arm(joint: &str) -> bool {
    let Some((side, part)) = joint.split_once('_') else { return false };
    matches!(side, "left" | "right") && !matches!(part, "hip" | "knee" | "ankle" | "foot") && !part.starts_with("eye")
}

/// The mirror image of a pose, left for right: an axis is a pseudovector, so its part in the mirror's plane turns round.
fn mirror(pose: &Pose) -> Pose {
    let mut out = pose.clone();
    for (j, name) in SMPLX_JOINTS.iter().enumerate().take(pose.rotations.len()) {
        let other = match name.split_once('_') {
            Some(("left", part)) => smplx_joint(&format!("right_{part}")),
            Some(("right", part)) => smplx_joint(&format!("left_{part}")),
            _ => None,
        };
        let Some(r) = pose.rotations.get(other.unwrap_or(j)) else { continue };
        out.rotations[j] = Vec3::new(r.x, -r.y, -r.z);
    }
    out.translation.x = -pose.translation.x;
    out
}

/// Time in a clip that is played there and back again for ever [s].
fn there_and_back(time: f64, duration: f64) -> f64 {
    if duration <= 0.0 {
        return 0.0;
    }
    let t = time.rem_euclid(2.0 * duration);
    if t > duration { 2.0 * duration - t } else { t }
}

#[cfg(test)]
mod tests {
    use super::*;
    use caphy_bodymodel::procedural_motion::{MotionKind, procedural_clip};

    fn clips() -> Vec<MotionClip> {
        let clip = |kind| procedural_clip(kind, 1, 3.0, 60.0).unwrap();
        vec![clip(MotionKind::Walk), clip(MotionKind::Reach)]
    }

    #[test]
    fn a_copy_differs_is_smooth_and_comes_again_from_its_seed() {
        let clips = clips();
        let settings = MotionVariation { copies: 3, ..MotionVariation::default() };
        let a = settings.vary(&clips, 0, 1, 5).unwrap();
        assert_eq!(a, settings.vary(&clips, 0, 1, 5).unwrap());
        for (other, why) in [(settings.vary(&clips, 0, 2, 5), "copy"), (settings.vary(&clips, 0, 1, 6), "seed")] {
            assert!(a.poses != other.unwrap().poses, "{why}");
        }
        // No jump: the fastest turn of the sources at the quickest pace, and the slow turns at six deviations.
        let fastest = |clip: &MotionClip, scale: f64| {
            let turn = |p: &[Pose], j: usize| {
                let [a, b] = [0, 1].map(|i| UnitQuaternion::from_scaled_axis(p[i].rotations[j]));
                a.angle_to(&b) * scale
            };
            (0..22).flat_map(|j| clip.poses.windows(2).map(move |p| turn(p, j))).fold(0.0, f64::max)
        };
        let source = clips.iter().map(|c| fastest(c, c.fps)).fold(0.0, f64::max);
        let slow = 3f64.sqrt() * 6.0 * settings.turn_degrees.to_radians() * TAU / PERIODS.0;
        for copy in 0..8 {
            let varied = settings.vary(&clips, 0, copy, 5).unwrap();
            let limit = source * settings.tempo.max(1.0) + slow;
            assert!(fastest(&varied, varied.fps) <= limit, "{copy}");
            assert!((varied.fps / clips[0].fps).ln().abs() <= settings.tempo.ln() + 1e-12);
        }
    }

    #[test]
    fn with_nothing_to_vary_a_copy_is_its_clip() {
        let clips = clips();
        let none = MotionVariation { copies: 1, tempo: 1.0, mirror: false, arms: false, turn_degrees: 0.0 };
        for copy in 0..4 {
            let varied = none.vary(&clips, 1, copy, 3).unwrap();
            assert!(varied.poses == clips[1].poses && varied.fps == clips[1].fps);
        }
        assert!(MotionVariation { tempo: 0.9, ..none.clone() }.check().is_err());
        assert!(MotionVariation { turn_degrees: f64::NAN, ..none }.check().is_err());
    }

    #[test]
    fn arms_come_from_the_other_clip_and_legs_stay() {
        let clips = clips();
        let only = MotionVariation { copies: 1, tempo: 1.0, mirror: false, arms: true, turn_degrees: 0.0 };
        let [elbow, knee] = ["left_elbow", "left_knee"].map(|name| smplx_joint(name).unwrap());
        let mut borrowed = 0;
        for copy in 0..16 {
            let varied = only.vary(&clips, 0, copy, 3).unwrap();
            assert!(varied.poses.iter().zip(&clips[0].poses).all(|(a, b)| a.rotations[knee] == b.rotations[knee]));
            let same = varied.poses.iter().zip(&clips[0].poses).all(|(a, b)| a.rotations[elbow] == b.rotations[elbow]);
            borrowed += usize::from(!same);
        }
        assert!((2..=14).contains(&borrowed), "{borrowed} of 16");
    }

    #[test]
    fn the_mirror_image_of_a_body_is_the_body_in_the_mirrored_pose() {
        // Joints of a symmetric body, by forward kinematics on limbs of the T-pose.
        let joints = |pose: &Pose| -> Vec<Vec3> {
            let mut out: Vec<(UnitQuaternion<f64>, Vec3)> = Vec::new();
            for (j, name) in SMPLX_JOINTS.iter().enumerate().take(22) {
                let side = if name.starts_with("left") { 1.0 } else { -1.0 };
                let offset = if name.starts_with("left") || name.starts_with("right") {
                    Vec3::new(0.2 * side, 0.1, 0.03)
                } else {
                    Vec3::new(0.0, 0.2, 0.01)
                };
                let own = UnitQuaternion::from_scaled_axis(pose.rotations[j]);
                let (parent, at) = match caphy_core::pose::SMPLX_PARENTS[j] {
                    usize::MAX => (UnitQuaternion::identity(), pose.translation - offset),
                    p => out[p],
                };
                out.push((parent * own, at + parent * offset));
            }
            out.into_iter().map(|(_, at)| at).collect()
        };
        let mut pose = clips()[0].poses[40].clone();
        pose.rotations[0] = Vec3::new(0.3, 0.5, -0.2);
        pose.translation = Vec3::new(0.4, 1.0, -0.3);
        let (here, there) = (joints(&pose), joints(&mirror(&pose)));
        for (j, name) in SMPLX_JOINTS.iter().enumerate().take(22) {
            let other = match name.split_once('_') {
                Some(("left", part)) => smplx_joint(&format!("right_{part}")).unwrap(),
                Some(("right", part)) => smplx_joint(&format!("left_{part}")).unwrap(),
                _ => j,
            };
            let image = Vec3::new(-here[other].x, here[other].y, here[other].z);
            assert!((there[j] - image).norm() < 1e-12, "{name}");
        }
        assert_eq!(mirror(&mirror(&pose)), pose);
    }
}
