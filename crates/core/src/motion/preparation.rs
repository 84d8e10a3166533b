//! From a clip as recorded to frames that may be trained on: screened, smoothed, resampled; and what is known about it.

use super::limits::{MotionLimits, joint_angles};
use super::screening::{MotionFinding, MotionScreening, joint_speed};
use super::{MotionClip, smoothing};
use crate::Result;
use crate::pose::SMPLX_JOINTS;
use serde::{Deserialize, Serialize};

/// What is done to a clip, in this order: damage is looked for, noise is smoothed, time is resampled.
#[derive(Debug, Clone, PartialEq)]
pub struct ClipPreparation {
    /// Standard deviation of the smoothing [s]; 0 for none.
    pub smoothing: f64,
    /// Rate to resample to [1/s].
    pub fps: f64,
    /// Limits of sound motion; `None` takes every frame.
    pub limits: Option<MotionLimits>,
}

impl ClipPreparation {
    /// Prepares a clip as its reader returns it.
    ///
    /// # Errors
    /// As [`MotionLimits::screen`], [`MotionClip::smoothed`] and [`MotionClip::resampled`].
    pub fn prepare(&self, recorded: &MotionClip) -> Result<PreparedClip> {
        let screening = match &self.limits {
            // Smoothing carries damage to the frames that it mixes with.
            Some(limits) => limits.screen(recorded)?.widened(smoothing::reach(self.smoothing)),
            None => MotionScreening::default(),
        };
        Ok(PreparedClip {
            clip: recorded.smoothed(self.smoothing)?.resampled(self.fps)?,
            source_fps: recorded.fps,
            source_frames: recorded.poses.len(),
            screening,
        })
    }
}

/// A clip that is ready for use, and where it is damaged.
#[derive(Debug, Clone, PartialEq)]
pub struct PreparedClip {
    /// The clip at its new rate, all frames.
    pub clip: MotionClip,
    /// Rate of the file [1/s].
    pub source_fps: f64,
    /// Frames of the file.
    pub source_frames: usize,
    /// Its damage.
    pub screening: MotionScreening,
}

impl PreparedClip {
    /// Gives the clip another name, in its findings, too.
    pub fn rename(&mut self, name: impl Into<String>) {
        self.clip.name = name.into();
        for finding in &mut self.screening.findings {
            finding.clip.clone_from(&self.clip.name);
        }
    }
    /// Whether `count` frames from `first` on are sound, and the steps between them.
    pub fn sound(&self, first: usize, count: usize) -> bool {
        let time = |frame: usize| frame as f64 / self.clip.fps;
        first + count <= self.clip.poses.len()
            && (count == 0 || !self.screening.touches(time(first), time(first + count - 1)))
    }
    /// Facts for people; `window` is the number of consecutive frames that are used together.
    pub fn facts(&self, window: usize) -> ClipFacts {
        let clip = &self.clip;
        let joints = (0..clip.poses[0].rotations.len().min(SMPLX_JOINTS.len())).map(|joint| {
            let mut range = [[f64::INFINITY, f64::NEG_INFINITY]; 3];
            let mut largest: f64 = 0.0;
            for pose in &clip.poses {
                for (range, angle) in range.iter_mut().zip(joint_angles(joint, &pose.rotations[joint])) {
                    *range = [range[0].min(angle), range[1].max(angle)];
                }
                let turn = nalgebra::UnitQuaternion::from_scaled_axis(pose.rotations[joint]);
                largest = largest.max(turn.angle().to_degrees());
            }
            JointFacts {
                joint: SMPLX_JOINTS[joint].into(),
                x_degrees: range[0],
                y_degrees: range[1],
                z_degrees: range[2],
                largest_degrees: largest,
                fastest_degrees_per_s: joint_speed(clip, joint).to_degrees(),
            }
        });
        let steps: Vec<f64> = clip.poses.windows(2).map(|w| (w[1].translation - w[0].translation).norm()).collect();
        let path: f64 = steps.iter().sum();
        let first = clip.poses[0].translation;
        let heights = clip.poses.iter().map(|p| p.translation.y - first.y);
        ClipFacts {
            name: clip.name.clone(),
            duration_s: clip.duration(),
            source_fps: self.source_fps,
            source_frames: self.source_frames,
            fps: clip.fps,
            frames: clip.poses.len(),
            root_path_m: path,
            root_displacement_m: clip.poses.last().map_or(0.0, |p| (p.translation - first).norm()),
            root_mean_speed_m_per_s: if clip.duration() > 0.0 { path / clip.duration() } else { 0.0 },
            root_fastest_m_per_s: steps.iter().copied().fold(0.0, f64::max) * clip.fps,
            root_height_range_m: heights.fold([0.0, 0.0], |[low, high], y| [y.min(low), y.max(high)]),
            joints: joints.collect(),
            dropped_frames: (0..clip.poses.len()).filter(|&i| !self.sound(i, 1)).count(),
            windows: (0..clip.poses.len()).filter(|&i| self.sound(i, window)).count(),
            dropped_windows: (0..(clip.poses.len() + 1).saturating_sub(window))
                .filter(|&i| !self.sound(i, window))
                .count(),
            findings: self.screening.findings.clone(),
        }
    }
}

/// What `show motion` says about a clip.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ClipFacts {
    /// Its name.
    pub name: String,
    /// From the first to the last frame [s].
    pub duration_s: f64,
    /// Rate of the file [1/s].
    pub source_fps: f64,
    /// Frames of the file.
    pub source_frames: usize,
    /// Rate after resampling [1/s].
    pub fps: f64,
    /// Frames after resampling.
    pub frames: usize,
    /// Length of the pelvis's way [m].
    pub root_path_m: f64,
    /// From its first to its last place [m].
    pub root_displacement_m: f64,
    /// Way over duration [m/s].
    pub root_mean_speed_m_per_s: f64,
    /// Fastest step between frames [m/s].
    pub root_fastest_m_per_s: f64,
    /// Lowest and highest place of the pelvis against its first [m].
    pub root_height_range_m: [f64; 2],
    /// Every joint, SMPL-X order.
    pub joints: Vec<JointFacts>,
    /// Frames after resampling that damage touches.
    pub dropped_frames: usize,
    /// Windows that may be drawn.
    pub windows: usize,
    /// Windows that damage touches.
    pub dropped_windows: usize,
    /// Why.
    pub findings: Vec<MotionFinding>,
}

/// One joint over a clip; angles as in [`joint_angles`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct JointFacts {
    /// SMPL-X name.
    pub joint: String,
    /// Smallest and largest angle about x [degrees].
    pub x_degrees: [f64; 2],
    /// Smallest and largest angle about y [degrees].
    pub y_degrees: [f64; 2],
    /// Smallest and largest angle about z [degrees].
    pub z_degrees: [f64; 2],
    /// Largest turn away from the T-pose, about whatever axis [degrees].
    pub largest_degrees: f64,
    /// Fastest turn between frames [degrees/s].
    pub fastest_degrees_per_s: f64,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Vec3;
    use crate::pose::{Pose, smplx_joint};

    /// 121 frames at 120 fps, one metre along z, the left knee from 0 to 60 degrees, its frame 61 broken.
    fn recorded() -> MotionClip {
        let knee = smplx_joint("left_knee").unwrap();
        let poses = (0..=120)
            .map(|i| {
                let mut pose = Pose::rest(55);
                pose.translation.z = i as f64 / 120.0;
                pose.rotations[knee].x = (i as f64 / 2.0).to_radians();
                if i == 61 {
                    pose.rotations[knee] = Vec3::new(-1.5, 0.0, 0.0);
                }
                pose
            })
            .collect();
        MotionClip::new("walk", 120.0, poses).unwrap()
    }

    #[test]
    fn damage_between_the_new_frames_is_kept_out_of_windows() {
        let preparation = ClipPreparation { smoothing: 0.0, fps: 30.0, limits: Some(MotionLimits::default()) };
        let prepared = preparation.prepare(&recorded()).unwrap();
        assert_eq!((prepared.clip.poses.len(), prepared.source_frames, prepared.source_fps), (31, 121, 120.0));
        // Frame 61 lies between the new frames 15 and 16: both are sound, the step between them is not.
        assert!(prepared.sound(15, 1) && prepared.sound(16, 1) && !prepared.sound(15, 2));
        assert!(prepared.sound(11, 5) && !prepared.sound(12, 5) && !prepared.sound(15, 5) && prepared.sound(16, 5));
        assert!(prepared.sound(26, 5) && !prepared.sound(27, 5), "windows end with the clip");
        let facts = prepared.facts(5);
        assert_eq!((facts.windows, facts.dropped_windows, facts.dropped_frames), (23, 4, 0));
        assert!(facts.findings.iter().any(|f| f.joint == "left_knee" && f.first_frame == 61));
        assert!((facts.root_path_m - 1.0).abs() < 1e-12 && (facts.root_mean_speed_m_per_s - 1.0).abs() < 1e-12);
        let knee = &facts.joints[smplx_joint("left_knee").unwrap()];
        assert!((knee.x_degrees[1] - 60.0).abs() < 1e-9 && (knee.largest_degrees - 60.0).abs() < 1e-9);
        assert!((knee.fastest_degrees_per_s - 60.0).abs() < 1e-6, "{}", knee.fastest_degrees_per_s);

        let smooth = ClipPreparation { smoothing: 0.02, ..preparation.clone() }.prepare(&recorded()).unwrap();
        assert!(!smooth.sound(14, 1) || !smooth.sound(15, 1), "smoothing spreads the damage");
        assert!(smooth.facts(5).dropped_windows > facts.dropped_windows);
        let all = ClipPreparation { limits: None, ..preparation }.prepare(&recorded()).unwrap();
        assert_eq!((all.facts(5).windows, all.facts(5).dropped_windows), (27, 0));
    }
}
