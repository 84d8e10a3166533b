//! Motion clips: poses at a steady rate.

use crate::pose::Pose;
use crate::{Error, Result};
use serde::{Deserialize, Serialize};

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
    /// The same motion at another rate, resampled by time (never by dropping every n-th frame).
    pub fn resampled(&self, fps: f64) -> Result<MotionClip> {
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
    fn bad_clips_are_refused() {
        assert!(MotionClip::new("x", 0.0, vec![Pose::rest(1)]).is_err());
        assert!(MotionClip::new("x", 30.0, vec![]).is_err());
        let mut bad = Pose::rest(1);
        bad.translation.y = f64::INFINITY;
        assert!(MotionClip::new("x", 30.0, vec![bad]).unwrap_err().to_string().contains("frame 0"));
    }
}
