//! Pictures of a garment in a few fixed poses while its net is trained.

use crate::garment::{FittedGarment, TrainedGarment};
use crate::inference::{Play, play};
use crate::pictures::{self, Dressed};
use crate::plugins::PluginTable;
use crate::scene::{FrameNames, Scene};
use crate::stage::Context;
use crate::track::BodyTrack;
use crate::trainer::MotionFrames;
use caphy_core::pose::Pose;
use caphy_core::{Result, TriMesh};
use caphy_render::{Rgb, contact_sheet};

/// The poses, and the body in them.
///
/// Garments are posed by their nets alone, apart from training: nothing that is drawn can change what is learned.
pub struct Preview<'a> {
    net: &'a PluginTable,
    shots: Vec<Shot>,
}

struct Shot {
    label: String,
    /// Frames that lead to the one that is shown, the last.
    track: BodyTrack,
    body: TriMesh,
}

impl<'a> Preview<'a> {
    /// The ends of two windows of the motion, and the first scan pose.
    ///
    /// # Errors
    /// What posing the body gives.
    pub fn new(
        context: &Context<'a>,
        scene: &Scene,
        motion: &MotionFrames,
        scans: &BodyTrack,
        names: &FrameNames,
    ) -> Result<Preview<'a>> {
        let window = context.config.train.window;
        let mut chosen: Vec<(String, Vec<Pose>)> = Vec::new();
        for quarter in [1, 3] {
            if let Some(&start) = motion.starts.get(quarter * motion.starts.len() / 4) {
                let frames = start..start + window;
                chosen.push((names.short(frames.end - 1, false), motion.track.poses[frames].to_vec()));
            }
        }
        chosen.extend(scans.poses.first().map(|pose| (names.short(0, true), vec![pose.clone()])));
        let shot = |(label, poses): (String, Vec<Pose>)| {
            let last = &poses[poses.len() - 1];
            let vertices = scene.body.forward(&scene.subject.posed(last))?.vertices;
            let body = TriMesh { vertices, faces: scene.rest.faces.clone() };
            Ok(Shot { label, track: scene.track(&poses)?, body })
        };
        Ok(Preview { net: &context.config.net, shots: chosen.into_iter().map(shot).collect::<Result<_>>()? })
    }
    /// Garments with their nets on the body: every pose from the front and from behind.
    ///
    /// # Errors
    /// What the nets give, [`caphy_core::Error::NonFinite`] where they leave the finite numbers.
    pub fn draw(&self, garments: &[(&FittedGarment, &TrainedGarment)]) -> Result<Rgb> {
        let mut drawn = Vec::new();
        for shot in &self.shots {
            let mut worn = Vec::new();
            for (fitted, trained) in garments {
                let mut frames = play(fitted, trained, self.net, &shot.track, Play::Clip)?;
                let vertices = frames.pop().unwrap_or_default();
                worn.push(TriMesh { vertices, faces: fitted.mesh.faces.clone() });
            }
            let dressed = Dressed { body: &shot.body, garments: worn };
            for from in [&pictures::FRONT, &pictures::BACK] {
                drawn.push((shot.label.as_str(), pictures::dressed(&dressed, from)));
            }
        }
        let list: Vec<(&str, &Rgb)> = drawn.iter().map(|(label, picture)| (*label, picture)).collect();
        Ok(contact_sheet(&list, list.len()))
    }
}
