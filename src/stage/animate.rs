//! The avatar plays a motion clip.

use super::preprocess::Subject;
use super::train::Nets;
use super::{Context, StageOutput};
use crate::inference::{Play, clearance, contacts, play, push_layers, push_out};
use crate::motion;
use crate::pictures;
use crate::scene::Scene;
use caphy_core::motion::MotionClip;
use caphy_core::{Result, TriMesh, Vec3};
use caphy_garment::energy::LayeringOrder;
use caphy_garment::template::GarmentKind;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// A played clip.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Film {
    /// The motion at the avatar's frame rate.
    pub clip: MotionClip,
    /// Garments, upper first.
    pub garments: Vec<GarmentFilm>,
    /// Pictures, relative to the run directory.
    pub pictures: Vec<PathBuf>,
}

impl StageOutput for Film {
    fn files(&self) -> Vec<PathBuf> {
        self.pictures.clone()
    }
}

/// One garment in every frame.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct GarmentFilm {
    /// Upper or lower.
    pub kind: GarmentKind,
    /// Vertices [m], shape [frame][vertex][3].
    pub frames: Vec<Vec<[f32; 3]>>,
    /// Mean share of vertices inside the body before they were pushed out.
    pub penetrating: f64,
    /// Deepest vertex before that [mm].
    pub deepest_mm: f64,
}

impl GarmentFilm {
    /// Vertices of one frame [m].
    pub fn vertices(&self, frame: usize) -> Vec<Vec3> {
        self.frames[frame].iter().map(|p| Vec3::new(p[0].into(), p[1].into(), p[2].into())).collect()
    }
}

/// Frames of the picture strip that the report plays.
const STRIP: usize = 24;
/// Pictures on the contact sheet.
const SHEET: usize = 8;

/// Plays `[animate] clip`.
pub fn run(context: &Context<'_>, subject: &Subject, avatar: &Nets) -> Result<Film> {
    let scene = Scene::new(context, subject)?;
    let config = &context.config.animate;
    let fps = avatar.garments.first().map_or(context.config.motion.fps, |g| g.fps);
    // Whatever a clip holds is played.
    let mut clip = motion::load(context.files, &config.clip, None, fps, &scene.rest_joints[0])?.clip;
    clip.poses.truncate((config.seconds * fps).ceil() as usize + 1);
    let track = scene.track(&clip.poses)?;
    let mut played = Vec::new();
    for (fitted, trained) in subject.garments.iter().zip(&avatar.garments) {
        played.push(play(fitted, trained, &context.config.net, &track, Play::Clip)?);
    }
    let maps = subject.garments.iter().map(|g| scene.contact(g)).collect::<Result<Vec<_>>>()?;
    let mut depth = vec![(0usize, 0.0f64); played.len()];
    let limit = context.config.evaluate.penetration_m;
    let mut bodies = Vec::new();
    for frame in 0..clip.poses.len() {
        context.progress.set(0.7 * frame as f64 / clip.poses.len() as f64, "frames");
        let posed = scene.body.forward(&scene.subject.posed(&clip.poses[frame]))?;
        for ((frames, depth), map) in played.iter_mut().zip(&mut depth).zip(&maps) {
            let touching = contacts(map, &track, frame, &frames[frame])?;
            for d in clearance(&frames[frame], &touching) {
                depth.0 += usize::from(d < -limit);
                depth.1 = depth.1.min(d);
            }
            if config.push_out_m > 0.0 {
                push_out(&mut frames[frame], &touching, config.push_out_m);
            }
        }
        bodies.push(posed.vertices);
        if config.push_out_m > 0.0
            && let [upper, lower] = &mut played[..]
        {
            let layering = &context.config.finetune.layering;
            let (outer, inner, worn) = match layering.order {
                LayeringOrder::Over => (upper, lower, 1),
                LayeringOrder::Tucked => (lower, upper, 0),
            };
            let under = TriMesh { vertices: inner[frame].clone(), faces: subject.garments[worn].mesh.faces.clone() };
            push_layers(&mut outer[frame], &under, config.push_out_m, layering.reach);
        }
    }
    let picture = |frame: usize, from: &Vec3| {
        let body = TriMesh { vertices: bodies[frame].clone(), faces: scene.rest.faces.clone() };
        let garments = subject
            .garments
            .iter()
            .zip(&played)
            .map(|(g, frames)| TriMesh { vertices: frames[frame].clone(), faces: g.mesh.faces.clone() })
            .collect();
        pictures::dressed(&pictures::Dressed { body: &body, garments }, from)
    };
    let last = clip.poses.len() - 1;
    let spread = |count: usize| (0..count).map(move |i| i * last / (count - 1).max(1));
    let sheet: Vec<_> = spread(SHEET)
        .enumerate()
        .map(|(i, frame)| {
            let label = format!("{:.1} s", frame as f64 / fps);
            (label, picture(frame, if i % 2 == 0 { &pictures::FRONT } else { &pictures::BACK }))
        })
        .collect();
    context.write("pictures/animation.png", &pictures::sheet(&sheet, SHEET)?)?;
    context.progress.set(0.85, "pictures");
    let strip: Vec<_> = spread(STRIP).map(|frame| (String::new(), picture(frame, &pictures::FRONT))).collect();
    context.write("pictures/strip.png", &pictures::sheet(&strip, STRIP)?)?;
    let garments = subject
        .garments
        .iter()
        .zip(played)
        .zip(depth)
        .map(|((g, frames), (count, deepest))| GarmentFilm {
            kind: g.kind,
            penetrating: count as f64 / (frames.len() * g.mesh.vertices.len()).max(1) as f64,
            deepest_mm: 0.0 - 1e3 * deepest,
            frames: frames.iter().map(|f| f.iter().map(|p| [p.x as f32, p.y as f32, p.z as f32]).collect()).collect(),
        })
        .collect();
    Ok(Film { clip, garments, pictures: vec!["pictures/animation.png".into(), "pictures/strip.png".into()] })
}

/// Number of frames in the strip.
pub fn strip_frames() -> usize {
    STRIP
}
