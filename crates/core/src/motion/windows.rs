//! Windows of consecutive frames over many clips.

use super::preparation::PreparedClip;
use crate::{Error, Result};
use serde::{Deserialize, Serialize};

/// Where a window begins.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct WindowStart {
    /// Index of the clip.
    pub clip: usize,
    /// First frame after resampling.
    pub frame: usize,
}

/// All windows of sound motion: drawing from `starts` is uniform over frames, not over clips.
#[derive(Debug, Clone, PartialEq)]
pub struct MotionWindows {
    /// Frames per window.
    pub length: usize,
    /// Every window once, by clip and frame.
    pub starts: Vec<WindowStart>,
    /// What was left out.
    pub report: WindowReport,
}

/// What was left out of some clips, and why.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct WindowReport {
    /// Clips looked at.
    pub clips: usize,
    /// Frames of all clips after resampling.
    pub frames: usize,
    /// Windows that may be drawn.
    pub windows: usize,
    /// Windows that damage touches.
    pub dropped_windows: usize,
    /// Findings of each kind over all clips: angles past their range, joints too fast, pelvis too fast.
    pub findings: [usize; 3],
    /// Clips that are shorter than a window.
    pub too_short: Vec<String>,
    /// Clips that are long enough but have no sound window.
    pub all_dropped: Vec<String>,
}

impl std::fmt::Display for WindowReport {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let [angles, joints, roots] = self.findings;
        write!(
            f,
            "{} windows in {} frames of {} clips; {} dropped ({angles} runs of joint angles, {joints} of joint speeds, {roots} of \
             pelvis speeds past their limits)",
            self.windows, self.frames, self.clips, self.dropped_windows
        )?;
        for (what, names) in [("too short", &self.too_short), ("without a sound window", &self.all_dropped)] {
            if !names.is_empty() {
                write!(f, "; {what}: {}", names.join(", "))?;
            }
        }
        Ok(())
    }
}

impl MotionWindows {
    /// Windows of `length` frames of clips in a given order. Names decide, not the order in which a system lists a folder:
    /// sort the clips with [`sort_clips`] first.
    ///
    /// # Errors
    /// [`Error::Config`] for a length of zero, and if no window is left, saying why.
    pub fn new(clips: &[PreparedClip], length: usize) -> Result<Self> {
        if length == 0 {
            return Err(Error::config("window", "0 frames", "give at least one frame"));
        }
        let mut starts = Vec::new();
        let mut report = WindowReport { clips: clips.len(), ..WindowReport::default() };
        for (clip, prepared) in clips.iter().enumerate() {
            let frames = prepared.clip.poses.len();
            report.frames += frames;
            for finding in &prepared.screening.findings {
                use super::screening::MotionProblem::{AngleX, AngleY, AngleZ, JointSpeed, RootSpeed};
                let kind = match finding.problem {
                    AngleX | AngleY | AngleZ => 0,
                    JointSpeed => 1,
                    RootSpeed => 2,
                };
                report.findings[kind] += 1;
            }
            let whole = (frames + 1).saturating_sub(length);
            let before = starts.len();
            starts.extend(
                (0..whole).filter(|&frame| prepared.sound(frame, length)).map(|frame| WindowStart { clip, frame }),
            );
            let kept = starts.len() - before;
            report.dropped_windows += whole - kept;
            if whole == 0 {
                report.too_short.push(prepared.clip.name.clone());
            } else if kept == 0 {
                report.all_dropped.push(prepared.clip.name.clone());
            }
        }
        report.windows = starts.len();
        if starts.is_empty() {
            let remedy = "give longer clips, a shorter window or wider limits";
            return Err(Error::config("motion", format!("no window of {length} frames is left: {report}"), remedy));
        }
        Ok(Self { length, starts, report })
    }
}

/// Sorts clips by name.
///
/// # Errors
/// [`Error::Config`] for two clips of one name, whose order would be left to chance.
pub fn sort_clips(clips: &mut [PreparedClip]) -> Result<()> {
    clips.sort_by(|a, b| a.clip.name.cmp(&b.clip.name));
    match clips.windows(2).find(|w| w[0].clip.name == w[1].clip.name) {
        None => Ok(()),
        Some(w) => Err(Error::config("motion", format!("two clips are called `{}`", w[0].clip.name), "rename one")),
    }
}

#[cfg(test)]
mod tests {
    use super::super::{ClipPreparation, MotionClip, MotionLimits};
    use super::*;
    use crate::pose::Pose;

    fn prepared(name: &str, frames: usize, jump: Option<usize>) -> PreparedClip {
        let mut poses = vec![Pose::rest(55); frames];
        if let Some(at) = jump {
            poses[at..].iter_mut().for_each(|p| p.translation.y = 5.0);
        }
        let clip = MotionClip::new(name, 30.0, poses).unwrap();
        ClipPreparation { smoothing: 0.0, fps: 30.0, limits: Some(MotionLimits::default()) }.prepare(&clip).unwrap()
    }

    #[test]
    fn windows_are_counted_by_frames_and_sorted_by_name() {
        let mut clips = vec![prepared("b", 20, Some(10)), prepared("c", 3, None), prepared("a", 8, None)];
        sort_clips(&mut clips).unwrap();
        let windows = MotionWindows::new(&clips, 5).unwrap();
        // a: 4 windows; b: 16, less the 4 that hold the step 9 -> 10; c is too short.
        assert_eq!((windows.report.windows, windows.report.dropped_windows), (16, 4));
        assert_eq!(windows.starts[4], WindowStart { clip: 1, frame: 0 });
        assert!(windows.starts.contains(&WindowStart { clip: 1, frame: 5 }));
        assert!(!windows.starts.contains(&WindowStart { clip: 1, frame: 6 }));
        assert!(windows.starts.contains(&WindowStart { clip: 1, frame: 10 }));
        assert_eq!((windows.report.findings, windows.report.too_short.as_slice()), ([0, 0, 1], &["c".to_string()][..]));
        clips.reverse();
        sort_clips(&mut clips).unwrap();
        assert_eq!(MotionWindows::new(&clips, 5).unwrap(), windows);
        assert!(sort_clips(&mut [prepared("a", 5, None), prepared("a", 6, None)]).is_err());
    }

    #[test]
    fn nothing_left_is_an_error_that_says_why() {
        let text =
            MotionWindows::new(&[prepared("short", 4, None), prepared("bad", 6, Some(3))], 5).unwrap_err().to_string();
        assert!(text.contains("too short: short") && text.contains("without a sound window: bad"), "{text}");
        assert!(MotionWindows::new(&[], 5).is_err() && MotionWindows::new(&[prepared("x", 9, None)], 0).is_err());
    }
}
