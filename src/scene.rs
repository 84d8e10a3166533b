//! What training, fabric estimation and fine-tuning share: the subject's body in every frame of motion and scan.

use crate::garment::FittedGarment;
use crate::motion;
use crate::plan::PlannedMotion;
use crate::stage::Context;
use crate::stage::preprocess::Subject;
use crate::track::{BodyTrack, Reach};
use crate::trainer::{MotionFrames, ScanFrames};
use caphy_core::body::{BodyModel, BodyParameters};
use caphy_core::motion::{MotionWindows, PreparedClip};
use caphy_core::pose::Pose;
use caphy_core::query::NearestGrid;
use caphy_core::scan::Label;
use caphy_core::{Error, Result, TriMesh, Vec3};
use caphy_garment::contact::ContactMap;
use caphy_garment::energy::{LayeringOrder, ScanCloud};
use caphy_garment::template::GarmentKind;
use std::sync::Arc;

/// Body vertices farther than this from every garment in the T-pose are left out of collision [m].
pub(crate) const REACH: f64 = 0.12;

/// The subject's body and where garments can touch it.
pub struct Scene {
    /// The body model.
    pub body: Arc<dyn BodyModel>,
    /// Shape and dT of the subject, T-posed.
    pub subject: BodyParameters,
    /// T-posed surface [m].
    pub rest: TriMesh,
    /// T-posed joints [m].
    pub rest_joints: Vec<Vec3>,
    /// Reachable part.
    pub reach: Reach,
}

impl Scene {
    /// Builds the body of a preprocessed subject.
    pub fn new(context: &Context<'_>, subject: &Subject) -> Result<Scene> {
        Self::dressed(
            Arc::from(context.config.body.body(context.files)?),
            &subject.shape,
            &subject.displacement,
            &subject.garments,
        )
    }
    /// A body of a shape with displacements [m] (none: empty) under garments.
    pub fn dressed(
        body: Arc<dyn BodyModel>,
        shape: &[f64],
        displacement: &[Vec3],
        garments: &[FittedGarment],
    ) -> Result<Scene> {
        let mut parameters = body.rest(shape);
        parameters.displacement = displacement.to_vec();
        let posed = body.forward(&parameters)?;
        let rest = TriMesh { vertices: posed.vertices, faces: body.describe().faces.clone() };
        let templates: Vec<&[Vec3]> = garments.iter().map(|g| &g.mesh.vertices[..]).collect();
        let reach = Reach::new(&rest, &templates, REACH)?;
        Ok(Scene { body, subject: parameters, rest, rest_joints: posed.joints, reach })
    }
    /// The body in given poses.
    pub fn track(&self, poses: &[Pose]) -> Result<BodyTrack> {
        BodyTrack::new(&*self.body, &self.subject, &self.reach, poses)
    }
    /// What each vertex of a garment can touch, for frames of [`Scene::track`].
    pub fn contact(&self, garment: &FittedGarment) -> Result<ContactMap> {
        self.reach.contact(&self.rest, garment)
    }
    /// The configured motion.
    pub fn motion(&self, context: &Context<'_>) -> Result<MotionFrames> {
        Ok(self.named_motion(context)?.0)
    }
    /// The configured motion, with its clips' names and first frames.
    pub fn named_motion(&self, context: &Context<'_>) -> Result<(MotionFrames, Vec<(String, usize)>)> {
        let clips = self.clips(context)?;
        let windows = MotionWindows::new(&clips, context.config.train.window)?;
        if windows.report.dropped_windows > 0 {
            context.progress.note(&windows.report.to_string());
        }
        let (mut poses, mut first, mut has_before) = (Vec::new(), Vec::new(), Vec::new());
        for prepared in &clips {
            first.push(poses.len());
            // A velocity over damage is none.
            has_before.extend((0..prepared.clip.poses.len()).map(|i| i > 0 && prepared.sound(i - 1, 2)));
            poses.extend(prepared.clip.poses.iter().cloned());
        }
        let starts = windows.starts.iter().map(|start| first[start.clip] + start.frame).collect();
        let limit = context.config.train.keep_bodies_mib.saturating_mul(1 << 20);
        let track = BodyTrack::within(limit, &self.body, &self.subject, &self.reach, &poses)?;
        let names = clips.iter().map(|prepared| prepared.clip.name.clone()).zip(first).collect();
        Ok((MotionFrames { track, starts, has_before, fps: context.config.motion.fps }, names))
    }
    /// The configured clips with their variations.
    fn clips(&self, context: &Context<'_>) -> Result<Vec<PreparedClip>> {
        let config = context.config;
        motion::load_all(context.files, &config.motion, &self.rest_joints[0], config.run.seed)
    }
    /// How much motion there is to train on, without posing a body.
    pub fn windows(&self, context: &Context<'_>) -> Result<PlannedMotion> {
        let clips = self.clips(context)?;
        let windows = MotionWindows::new(&clips, context.config.train.window)?;
        let frames = clips.iter().map(|c| c.clip.poses.len()).sum();
        let bodies = BodyTrack::kept_bytes(frames, &self.reach);
        let limit = context.config.train.keep_bodies_mib.saturating_mul(1 << 20);
        Ok(PlannedMotion { frames, windows: windows.starts.len(), bodies, kept: bodies <= limit })
    }
    /// Body track of the scans that may be learned from.
    pub fn scan_track(&self, subject: &Subject) -> Result<Arc<BodyTrack>> {
        let poses: Vec<Pose> = subject.training_scans().map(|s| s.pose.clone()).collect();
        Ok(Arc::new(self.track(&poses)?))
    }
}

/// What frames of training are called by people.
#[derive(Debug, Clone, Default)]
pub struct FrameNames {
    /// Clips with their first frames in the track of the motion, in its order.
    pub clips: Vec<(String, usize)>,
    /// Scans, one per frame of their track.
    pub scans: Vec<String>,
}

impl FrameNames {
    /// For the clips of [`Scene::named_motion`] and the frames of [`Scene::scan_track`].
    pub fn new(clips: Vec<(String, usize)>, subject: &Subject) -> FrameNames {
        FrameNames { clips, scans: subject.training_scans().map(|s| s.name.clone()).collect() }
    }
    /// In a sentence: clip and frame in it, counted from 0 at the motion's rate, or the scan.
    pub fn long(&self, frame: usize, scans: bool) -> String {
        match (scans, self.clip(frame)) {
            (true, _) => format!("scan `{}`", self.scans.get(frame).map_or("?", |name| name)),
            (false, Some((name, frame))) => format!("frame {frame} of clip `{name}`"),
            (false, None) => format!("frame {frame}"),
        }
    }
    /// Under a picture.
    pub fn short(&self, frame: usize, scans: bool) -> String {
        match (scans, self.clip(frame)) {
            (true, _) => self.scans.get(frame).cloned().unwrap_or_default(),
            (false, Some((name, frame))) => format!("{name} {frame}"),
            (false, None) => format!("{frame}"),
        }
    }
    fn clip(&self, frame: usize) -> Option<(&str, usize)> {
        let clip = self.clips.partition_point(|(_, first)| *first <= frame).checked_sub(1)?;
        let (name, first) = &self.clips[clip];
        Some((name, frame - first))
    }
}

/// The label of a garment's points.
pub fn label_of(kind: GarmentKind) -> Label {
    match kind {
        GarmentKind::Upper => Label::Upper,
        GarmentKind::Lower => Label::Lower,
    }
}

/// The garment that lies over the other one.
pub fn outer(order: LayeringOrder) -> GarmentKind {
    match order {
        LayeringOrder::Over => GarmentKind::Upper,
        LayeringOrder::Tucked => GarmentKind::Lower,
    }
}

/// Every n-th element, so that at most `most` are left.
pub fn thin<T: Copy>(values: &[T], most: usize) -> Vec<T> {
    let every = values.len().div_ceil(most.max(1)).max(1);
    values.iter().copied().step_by(every).collect()
}

/// Scan poses and points of one garment, with the garment vertices that scans see.
pub fn scan_frames(
    context: &Context<'_>,
    subject: &Subject,
    garment: &FittedGarment,
    track: Arc<BodyTrack>,
) -> Result<ScanFrames> {
    let label = label_of(garment.kind);
    let mut clouds = Vec::new();
    let mut votes = vec![0usize; garment.mesh.vertices.len()];
    for (frame, scan) in subject.training_scans().enumerate() {
        let (points, _) = scan.points.with_label(label);
        clouds.push(ScanCloud::new(&scan.name, &thin(&points, context.config.train.scan_points))?);
        // A vertex is seen when the scan's surface nearest to it is this garment: a waist under a shirt is not.
        let grid = NearestGrid::from_points(&scan.points.points);
        for (v, point) in garment.mesh.vertices.iter().enumerate() {
            let posed = garment.weights.blend(v, &track.transforms[frame]) * point.push(1.0);
            if let Some((id, _)) = grid.nearest_point(&posed)
                && scan.points.labels[id as usize] == label
            {
                votes[v] += 1;
            }
        }
    }
    let scans = clouds.len();
    let visible: Vec<bool> = votes.iter().map(|&v| 2 * v > scans).collect();
    if scans == 0 {
        return Ok(ScanFrames { track, clouds, visible: vec![true; garment.mesh.vertices.len()] });
    }
    if !visible.contains(&true) {
        return Err(Error::mesh(
            garment.kind.to_string(),
            "template",
            "no vertex lies near its own points in most scans",
            "look at the segmentation and the fitted poses in the report",
        ));
    }
    Ok(ScanFrames { track, clouds, visible })
}
