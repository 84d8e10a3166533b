//! Damage in a clip: joints that turn too far, joints and bodies that jump.

use super::MotionClip;
use super::limits::{MotionLimits, joint_angles};
use crate::pose::SMPLX_JOINTS;
use crate::{Error, Result, Vec3};
use nalgebra::UnitQuaternion;
use serde::{Deserialize, Serialize};

/// What is wrong with some frames of a clip.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum MotionProblem {
    /// A joint past its range about x [degrees].
    AngleX,
    /// A joint past its range about y [degrees].
    AngleY,
    /// A joint past its range about z [degrees].
    AngleZ,
    /// A joint that turns too fast against its parent [degrees/s].
    JointSpeed,
    /// A pelvis that moves too fast [m/s].
    RootSpeed,
}

impl MotionProblem {
    /// Unit of the value and the limit.
    pub fn unit(self) -> &'static str {
        match self {
            Self::AngleX | Self::AngleY | Self::AngleZ => "degrees",
            Self::JointSpeed => "degrees/s",
            Self::RootSpeed => "m/s",
        }
    }
}

/// One problem of one joint over a run of frames.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MotionFinding {
    /// Name of the clip.
    pub clip: String,
    /// First frame, as numbered in the file from 0. For speeds, the frame that the jump arrives at.
    pub first_frame: usize,
    /// Last frame of the run.
    pub last_frame: usize,
    /// SMPL-X joint.
    pub joint: String,
    /// What is wrong.
    pub problem: MotionProblem,
    /// The value farthest past its limit, in [`MotionProblem::unit`].
    pub value: f64,
    /// The limit that it passes.
    pub limit: f64,
}

impl std::fmt::Display for MotionFinding {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let what = match self.problem {
            MotionProblem::AngleX => "turns too far about x",
            MotionProblem::AngleY => "turns too far about y",
            MotionProblem::AngleZ => "turns too far about z",
            MotionProblem::JointSpeed => "turns too fast",
            MotionProblem::RootSpeed => "moves too fast",
        };
        let frames = if self.first_frame == self.last_frame {
            format!("frame {}", self.first_frame)
        } else {
            format!("frames {} to {}", self.first_frame, self.last_frame)
        };
        let unit = self.problem.unit();
        write!(
            f,
            "{}, {frames}: {} {what}: {:.1} {unit}, limit {:.1} {unit}",
            self.clip, self.joint, self.value, self.limit
        )
    }
}

/// Damage of one clip.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct MotionScreening {
    /// What was found, by joint, problem and frame.
    pub findings: Vec<MotionFinding>,
    /// Times without sound motion, sorted, apart from each other; open intervals [s], shape [count][from, to].
    pub spans: Vec<[f64; 2]>,
}

impl MotionScreening {
    /// Whether anything between two times is damaged; the times themselves count if damage lies at them.
    pub fn touches(&self, from: f64, to: f64) -> bool {
        // Times are frame numbers over rates: rounding must not make neighbours overlap.
        let slack = 1e-9;
        let first = self.spans.partition_point(|span| span[1] <= from + slack);
        self.spans.get(first).is_some_and(|span| span[0] < to - slack)
    }
    /// The same findings where every frame mixes with those up to `reach` [s] away.
    pub(super) fn widened(mut self, reach: f64) -> Self {
        self.spans = merged(self.spans.iter().map(|[from, to]| [from - reach, to + reach]).collect());
        self
    }
}

fn merged(mut spans: Vec<[f64; 2]>) -> Vec<[f64; 2]> {
    spans.sort_by(|a, b| a[0].total_cmp(&b[0]));
    let mut out: Vec<[f64; 2]> = Vec::new();
    for [from, to] in spans {
        match out.last_mut() {
            // Open intervals that only share an end leave the frame at that end sound.
            Some(last) if from < last[1] => last[1] = last[1].max(to),
            _ => out.push([from, to]),
        }
    }
    out
}

impl MotionLimits {
    /// Looks through a clip of SMPL-X joints for angles past [`MotionLimits::allowed`] and for jumps. Best on the clip as
    /// recorded: resampling and smoothing blur jumps.
    ///
    /// # Errors
    /// As [`MotionLimits::check`]; [`Error::Length`] for a clip with other joints.
    pub fn screen(&self, clip: &MotionClip) -> Result<MotionScreening> {
        self.check()?;
        Error::check_length("joints of a screened clip", SMPLX_JOINTS.len(), clip.poses[0].rotations.len())?;
        let mut out = MotionScreening::default();
        for joint in 0..SMPLX_JOINTS.len() {
            let turns: Vec<UnitQuaternion<f64>> =
                clip.poses.iter().map(|p| UnitQuaternion::from_scaled_axis(p.rotations[joint])).collect();
            if let Some(allowed) = self.allowed(joint) {
                let problems = [MotionProblem::AngleX, MotionProblem::AngleY, MotionProblem::AngleZ];
                let mut angles = [const { Vec::new() }; 3];
                for pose in &clip.poses {
                    let frame = joint_angles(joint, &pose.rotations[joint]);
                    angles.iter_mut().zip(frame).for_each(|(list, angle)| list.push(angle));
                }
                for (axis, problem) in problems.into_iter().enumerate() {
                    out.add(clip, joint, problem, angles[axis].iter().copied().enumerate(), allowed[axis]);
                }
            }
            let speeds = turns.windows(2).map(|w| w[0].angle_to(&w[1]).to_degrees() * clip.fps);
            let limit = [f64::NEG_INFINITY, self.joint_speed_degrees_per_s];
            out.add(clip, joint, MotionProblem::JointSpeed, speeds.enumerate().map(|(i, v)| (i + 1, v)), limit);
        }
        let steps = clip.poses.windows(2).map(|w| (w[1].translation - w[0].translation).norm() * clip.fps);
        let limit = [f64::NEG_INFINITY, self.root_speed_m_per_s];
        out.add(clip, 0, MotionProblem::RootSpeed, steps.enumerate().map(|(i, v)| (i + 1, v)), limit);
        out.spans = merged(std::mem::take(&mut out.spans));
        Ok(out)
    }
}

impl MotionScreening {
    /// Adds the runs of frames whose values leave `limits`.
    fn add(
        &mut self,
        clip: &MotionClip,
        joint: usize,
        problem: MotionProblem,
        values: impl Iterator<Item = (usize, f64)>,
        limits: [f64; 2],
    ) {
        let past = |value: f64| (value - limits[1]).max(limits[0] - value);
        let mut run: Option<MotionFinding> = None;
        for (frame, value) in values {
            if past(value) <= 0.0 {
                self.findings.extend(run.take());
                continue;
            }
            let limit = if value > limits[1] { limits[1] } else { limits[0] };
            let run = run.get_or_insert_with(|| MotionFinding {
                clip: clip.name.clone(),
                first_frame: frame,
                last_frame: frame,
                joint: SMPLX_JOINTS[joint].into(),
                problem,
                value,
                limit,
            });
            run.last_frame = frame;
            if past(value) > past(run.value) {
                (run.value, run.limit) = (value, limit);
            }
            // A jump spoils what lies between its two frames, a bad pose also what lies between it and the next.
            let jump = matches!(problem, MotionProblem::JointSpeed | MotionProblem::RootSpeed);
            let to = if jump { frame as f64 } else { frame as f64 + 1.0 };
            self.spans.push([(frame as f64 - 1.0) / clip.fps, to / clip.fps]);
        }
        self.findings.extend(run);
    }
}

/// Largest turn of a joint between neighbouring frames [rad/s].
pub(super) fn joint_speed(clip: &MotionClip, joint: usize) -> f64 {
    let turn = |v: &Vec3| UnitQuaternion::from_scaled_axis(*v);
    let angles = clip.poses.windows(2).map(|w| turn(&w[0].rotations[joint]).angle_to(&turn(&w[1].rotations[joint])));
    angles.fold(0.0, f64::max) * clip.fps
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pose::{Pose, smplx_joint};

    fn still(frames: usize) -> MotionClip {
        MotionClip::new("still", 30.0, vec![Pose::rest(55); frames]).unwrap()
    }

    #[test]
    fn damage_is_found_where_it_is() {
        let knee = smplx_joint("left_knee").unwrap();
        let limits = MotionLimits::default();
        let clean = limits.screen(&still(20)).unwrap();
        assert!(clean.findings.is_empty() && clean.spans.is_empty() && !clean.touches(0.0, 1.0));
        // Knees bend by positive angles about x: -87 is broken, and 0 -> -87 in a frame is 2610 degrees/s.
        let mut clip = still(20);
        for frame in 7..=9 {
            clip.poses[frame].rotations[knee].x = -(80.0 + frame as f64).to_radians();
        }
        let found = limits.screen(&clip).unwrap();
        let brief: Vec<_> = found.findings.iter().map(|f| (f.problem, f.first_frame, f.last_frame)).collect();
        assert_eq!(
            brief,
            [(MotionProblem::AngleX, 7, 9), (MotionProblem::JointSpeed, 7, 7), (MotionProblem::JointSpeed, 10, 10)]
        );
        assert!((found.findings[0].value + 89.0).abs() < 1e-9 && found.findings[0].limit == -30.0);
        assert!((found.findings[1].value - 87.0 * 30.0).abs() < 1e-6);
        assert_eq!(found.spans.len(), 1);
        let text = found.findings[0].to_string();
        assert!(text.contains("still, frames 7 to 9: left_knee") && text.contains("-89.0"), "{text}");
        let at = |a: usize, b: usize| found.touches(a as f64 / 30.0, b as f64 / 30.0);
        assert!(!at(2, 6) && at(3, 7) && at(9, 13) && !at(10, 14) && at(8, 8) && !at(10, 10) && !at(6, 6));
    }

    #[test]
    fn a_jump_separates_sound_frames() {
        let mut clip = still(20);
        for pose in &mut clip.poses[10..] {
            pose.translation.x = 2.0;
        }
        let found = MotionLimits::default().screen(&clip).unwrap();
        assert_eq!(found.findings.len(), 1);
        let f = &found.findings[0];
        assert_eq!((f.problem, f.joint.as_str(), f.first_frame), (MotionProblem::RootSpeed, "pelvis", 10));
        assert!((f.value - 60.0).abs() < 1e-9);
        let at = |a: usize, b: usize| found.touches(a as f64 / 30.0, b as f64 / 30.0);
        assert!(!at(5, 9) && at(6, 10) && at(9, 10) && !at(10, 14));
        let wide = found.clone().widened(0.1);
        assert!(wide.touches(3.0 / 30.0, 7.0 / 30.0) && !wide.touches(2.0 / 30.0, 6.0 / 30.0));
    }

    #[test]
    fn limits_are_a_setting() {
        let elbow = smplx_joint("right_elbow").unwrap();
        let mut clip = still(3);
        clip.poses.iter_mut().for_each(|p| p.rotations[elbow].y = 100f64.to_radians());
        assert!(MotionLimits::default().screen(&clip).unwrap().findings.is_empty());
        let own = MotionLimits {
            margin_degrees: 5.0,
            ranges: [("right_elbow".to_string(), [[0.0, 0.0], [0.0, 90.0], [0.0, 0.0]])].into(),
            ..MotionLimits::default()
        };
        let found = own.screen(&clip).unwrap();
        assert_eq!(found.findings.len(), 1);
        assert!((found.findings[0].value - 100.0).abs() < 1e-9 && found.findings[0].limit == 95.0);
        let none = MotionLimits { margin_degrees: f64::INFINITY, ..own };
        assert!(none.screen(&clip).unwrap().findings.is_empty());
        let two = MotionClip::new("two", 30.0, vec![Pose::rest(2)]).unwrap();
        assert!(none.screen(&two).is_err());
    }
}
