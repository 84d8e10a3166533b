//! Motion clips: poses at a steady rate, from the file's frames to windows of sound motion.

mod limits;
mod preparation;
mod screening;
mod smoothing;
mod windows;

pub use limits::{MotionLimits, joint_angles, joint_range};
pub use preparation::{ClipFacts, ClipPreparation, JointFacts, PreparedClip};
pub use screening::{MotionFinding, MotionProblem, MotionScreening};
pub use windows::{MotionWindows, WindowReport, WindowStart, sort_clips};

use crate::pose::Pose;
use crate::{Error, Result};
use serde::{Deserialize, Serialize};

/// Most frames that resampling makes: 37 hours at 30 frames per second. More is a slip of the unit.
const MOST_FRAMES: f64 = 4e6;

/// A clip of poses in SMPL-X joint order, y up.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MotionClip {
    /// Name, usually the file's stem.
    pub name: String,
    /// Frames per second.
    pub fps: f64,
    /// One pose per frame.
    pub poses: Vec<Pose>,
}

impl MotionClip {
    /// A checked clip: at least one frame, a positive finite rate, finite poses of equal joint count.
    pub fn new(name: impl Into<String>, fps: f64, poses: Vec<Pose>) -> Result<Self> {
        let name = name.into();
        if !(fps.is_finite() && fps > 0.0) {
            return Err(Error::numerics(
                format!("motion clip `{name}`"),
                format!("frame rate {fps} 1/s"),
                "give a positive frame rate",
            ));
        }
        let Some(first) = poses.first() else {
            return Err(Error::numerics(
                format!("motion clip `{name}`"),
                "has no frames",
                "give a clip of at least one frame",
            ));
        };
        let joints = first.rotations.len();
        for (frame, pose) in poses.iter().enumerate() {
            let what = format!("motion clip `{name}`, frame {frame}");
            Error::check_length(&format!("{what}, rotations"), joints, pose.rotations.len())?;
            for (joint, r) in pose.rotations.iter().chain([&pose.translation]).enumerate() {
                Error::check_finite(&format!("{what}, joint {joint}"), r.as_slice())?;
            }
        }
        Ok(Self { name, fps, poses })
    }
    /// Time of the last frame [s].
    pub fn duration(&self) -> f64 {
        (self.poses.len() - 1) as f64 / self.fps
    }
    /// The pose at a time [s], clamped to the clip, rotations interpolated as quaternions.
    pub fn at(&self, time: f64) -> Pose {
        let last = self.poses.len() - 1;
        let x = (time * self.fps).clamp(0.0, last as f64);
        let i = (x.floor() as usize).min(last);
        if i == last { self.poses[last].clone() } else { self.poses[i].interpolate(&self.poses[i + 1], x - i as f64) }
    }
    /// The same motion at another rate, resampled by time (never by dropping every n-th frame). The first frame stays; the last
    /// is the last that the clip still reaches.
    ///
    /// # Errors
    /// [`Error::Config`] for a rate that is not positive and finite, or that would give more than four million frames.
    pub fn resampled(&self, fps: f64) -> Result<MotionClip> {
        if !(fps.is_finite() && fps > 0.0) || self.duration() * fps > MOST_FRAMES {
            let problem = format!("{fps} 1/s for the clip `{}` of {} s", self.name, self.duration());
            return Err(Error::config(
                "fps",
                problem,
                format!("give a positive rate, and at most {MOST_FRAMES} frames"),
            ));
        }
        // A rate like 59.99999 must not lose the last frame to rounding.
        let count = (self.duration() * fps + 1e-3).floor() as usize + 1;
        MotionClip::new(self.name.clone(), fps, (0..count).map(|i| self.at(i as f64 / fps)).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Vec3;

    #[test]
    fn resampling_by_time_keeps_duration_and_speed() {
        let poses = (0..=120)
            .map(|i| {
                let mut p = Pose::rest(2);
                p.rotations[1] = Vec3::new(i as f64 / 120.0, 0.0, 0.0);
                p
            })
            .collect();
        let clip = MotionClip::new("turn", 119.99999, poses).unwrap();
        let slow = clip.resampled(30.0).unwrap();
        assert_eq!(slow.poses.len(), 31);
        assert!((slow.poses[15].rotations[1].x - 0.5).abs() < 1e-6);
    }

    #[test]
    fn both_ends_stay_at_rates_that_are_almost_whole() {
        for (rate, frames, kept) in [(59.99999, 121, 61), (60.00001, 121, 61), (29.97, 100, 100), (120.00048, 994, 249)]
        {
            let poses = (0..frames).map(|i| Pose { translation: Vec3::x() * i as f64, ..Pose::rest(1) }).collect();
            let clip = MotionClip::new("way", rate, poses).unwrap();
            let slow = clip.resampled(30.0).unwrap();
            assert_eq!(slow.poses.len(), kept, "{rate}");
            assert_eq!(slow.poses[0], clip.poses[0]);
            for (i, pose) in slow.poses.iter().enumerate() {
                // Where the clip is at that time; its end may lie a rounding before it.
                let wanted = (i as f64 * rate / 30.0).min((frames - 1) as f64);
                assert!((pose.translation.x - wanted).abs() < 1e-9, "{rate}: {i}");
            }
        }
        let one = MotionClip::new("one", 60.0, vec![Pose::rest(1)]).unwrap();
        assert_eq!(one.resampled(30.0).unwrap().poses.len(), 1);
        // Up and down again: the old frames are among the new.
        let poses = (0..9).map(|i| Pose { translation: Vec3::x() * (i * i) as f64, ..Pose::rest(1) }).collect();
        let clip = MotionClip::new("up", 30.0, poses).unwrap();
        let back = clip.resampled(120.0).unwrap().resampled(30.0).unwrap();
        assert!(clip.poses.iter().zip(&back.poses).all(|(a, b)| (a.translation - b.translation).norm() < 1e-9));
        for bad in [0.0, -30.0, f64::NAN, f64::INFINITY, 1e12] {
            assert!(clip.resampled(bad).unwrap_err().to_string().contains("fps"), "{bad}");
        }
    }

    #[test]
    fn bad_clips_are_refused() {
        assert!(MotionClip::new("x", 0.0, vec![Pose::rest(1)]).is_err());
        assert!(MotionClip::new("x", 30.0, vec![]).is_err());
        let mut bad = Pose::rest(1);
        bad.translation.y = f64::INFINITY;
        assert!(MotionClip::new("x", 30.0, vec![bad]).unwrap_err().to_string().contains("frame 0"));
    }
}
