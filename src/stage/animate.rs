//! The avatar plays a motion clip.

use super::preprocess::Subject;
use super::reference::fabric;
use super::train::Nets;
use super::{Context, StageOutput};
use crate::garment::{FittedGarment, TrainedGarment};
use crate::inference::{Play, clearance, contacts, play, push_layers, push_out};
use crate::motion;
use crate::moving::{MovingFigure, MovingGarment, picture};
use crate::physics::solver_forces;
use crate::pictures;
use crate::plugins::PluginTable;
use crate::scene::Scene;
use crate::simulate::{SimulationOptions, Steps, simulate_layers};
use crate::track::BodyTrack;
use caphy_core::body::BodyModel;
use caphy_core::motion::MotionClip;
use caphy_core::{Error, Result, TriMesh, Vec3};
use caphy_garment::energy::{LayeringOptions, LayeringOrder};
use caphy_garment::solver::SolverSettings;
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

/// How residual penetrations are treated, and what counts as one.
#[derive(Debug, Clone, Copy)]
pub struct PushOut {
    /// Distance to which vertices are moved out of the body and of the garment below [m]; 0 leaves them.
    pub gap: f64,
    /// A vertex deeper than this inside the body counts as penetrating [m].
    pub limit: f64,
    /// Which garment is outside.
    pub layering: LayeringOptions,
}

/// Vertices of garments along a clip [m], shape [garment][frame][vertex].
type Shapes = Vec<Vec<Vec<Vec3>>>;

/// What nets say of a clip, with carried state.
///
/// # Errors
/// What a net refuses; values that are not finite.
pub fn by_nets(
    garments: &[FittedGarment],
    nets: &[TrainedGarment],
    spec: &PluginTable,
    track: &BodyTrack,
) -> Result<Shapes> {
    garments.iter().zip(nets).map(|(fitted, trained)| play(fitted, trained, spec, track, Play::Clip)).collect()
}

/// Plays a clip: what `shapes` says of it, with vertices in the body or in the garment below pushed out; `progress` hears the share of
/// frames that this is done for.
///
/// # Errors
/// What the body or `shapes` refuse.
pub fn perform(
    scene: &Scene,
    garments: &[FittedGarment],
    clip: MotionClip,
    shapes: impl FnOnce(&BodyTrack) -> Result<Shapes>,
    push: &PushOut,
    progress: &dyn Fn(f64),
) -> Result<Film> {
    let track = scene.track(&clip.poses)?;
    let mut played = shapes(&track)?;
    let maps = garments.iter().map(|g| scene.contact(g)).collect::<Result<Vec<_>>>()?;
    let mut depth = vec![(0usize, 0.0f64); played.len()];
    for frame in 0..clip.poses.len() {
        progress(frame as f64 / clip.poses.len() as f64);
        for ((frames, depth), map) in played.iter_mut().zip(&mut depth).zip(&maps) {
            let touching = contacts(map, &track, frame, &frames[frame])?;
            for d in clearance(&frames[frame], &touching) {
                depth.0 += usize::from(d < -push.limit);
                depth.1 = depth.1.min(d);
            }
            if push.gap > 0.0 {
                push_out(&mut frames[frame], &touching, push.gap);
            }
        }
        if push.gap > 0.0
            && let [upper, lower] = &mut played[..]
        {
            let (outer, inner, worn) = match push.layering.order {
                LayeringOrder::Over => (upper, lower, 1),
                LayeringOrder::Tucked => (lower, upper, 0),
            };
            let under = TriMesh { vertices: inner[frame].clone(), faces: garments[worn].mesh.faces.clone() };
            push_layers(&mut outer[frame], &under, push.gap, push.layering.reach);
        }
    }
    let garments = garments
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
    Ok(Film { clip, garments, pictures: Vec::new() })
}

/// Plays `[animate] clip`.
pub fn run(context: &Context<'_>, subject: &Subject, avatar: &Nets) -> Result<Film> {
    let scene = Scene::new(context, subject)?;
    let missing = || Error::config("animate", "there is no such table", "add [animate] with a `clip`");
    let config = context.config.animate.as_ref().ok_or_else(missing)?;
    let fps = avatar.garments.first().map_or(context.config.motion.fps, |g| g.fps);
    // Whatever a clip holds is played.
    let mut clip = motion::load(context.files, &config.clip, None, fps, &scene.rest_joints[0])?.clip;
    clip.poses.truncate((config.seconds * fps).ceil() as usize + 1);
    let push = PushOut {
        gap: config.push_out_m,
        limit: context.config.evaluate.penetration_m,
        layering: context.config.finetune.layering,
    };
    let shapes = |track: &BodyTrack| match config.solver {
        Some(settings) => by_solver(context, subject, &scene, avatar, settings, fps, track),
        None => by_nets(&subject.garments, &avatar.garments, &context.config.net, track),
    };
    let say = |s: f64| context.progress.set(0.7 * s, "frames");
    let mut film = perform(&scene, &subject.garments, clip, shapes, &push, &say)?;
    let figure = Played { scene: &scene, garments: &subject.garments, film: &film, colours: &[] };
    let last = film.clip.poses.len() - 1;
    let spread = |count: usize| (0..count).map(move |i| i * last / (count - 1).max(1));
    let sheet: Vec<_> = spread(SHEET)
        .enumerate()
        .map(|(i, frame)| {
            let label = format!("{:.1} s", frame as f64 / fps);
            Ok((label, picture(&figure, frame, if i % 2 == 0 { &pictures::FRONT } else { &pictures::BACK })?))
        })
        .collect::<Result<_>>()?;
    context.write("pictures/animation.png", &pictures::sheet(&sheet, SHEET)?)?;
    context.progress.set(0.85, "pictures");
    let strip: Vec<_> = spread(STRIP)
        .map(|frame| Ok((String::new(), picture(&figure, frame, &pictures::FRONT)?)))
        .collect::<Result<_>>()?;
    context.write("pictures/strip.png", &pictures::sheet(&strip, STRIP)?)?;
    film.pictures = vec!["pictures/animation.png".into(), "pictures/strip.png".into()];
    Ok(film)
}

/// What the reference solver says of a clip in the avatar's fabrics, with the energies of training.
fn by_solver(
    context: &Context<'_>,
    subject: &Subject,
    scene: &Scene,
    avatar: &Nets,
    settings: SolverSettings,
    fps: f64,
    track: &BodyTrack,
) -> Result<Shapes> {
    let fabrics = subject.garments.iter().map(|g| fabric(context, g.kind, Some(avatar))).collect::<Result<Vec<_>>>()?;
    let forces = solver_forces(&context.config.train);
    let options = SimulationOptions { steps: Steps::Dynamic, fps, forces, settings, disturbance: None };
    let order = context.config.finetune.layering.order;
    let contact = |garment: &FittedGarment| scene.contact(garment);
    let say = |share: f64, text: &str| context.progress.set(0.7 * share, &format!("solver, {text}"));
    let solved = simulate_layers(&subject.garments, &fabrics, order, track, &contact, &options, &say)?;
    for (garment, simulation) in subject.garments.iter().zip(&solved).filter(|(_, s)| s.unconverged() > 0) {
        context.progress.note(&format!(
            "{}: forces did not come below {:.0e} N in {} of {} frames, {:.1e} N left at most",
            garment.kind,
            settings.tolerance_n,
            simulation.unconverged(),
            simulation.frames.len(),
            simulation.worst_residual_n()
        ));
    }
    Ok(solved.into_iter().map(|simulation| simulation.frames).collect())
}

/// Number of frames in the strip.
pub fn strip_frames() -> usize {
    STRIP
}

/// The avatar as it was played.
pub struct Played<'a> {
    /// The body.
    pub scene: &'a Scene,
    /// Its garments.
    pub garments: &'a [FittedGarment],
    /// Their frames.
    pub film: &'a Film,
    /// Vertex colours (sRGB) of body and garments; none for clay.
    pub colours: &'a [Vec<[u8; 3]>],
}

impl MovingFigure for Played<'_> {
    fn body(&self) -> &dyn BodyModel {
        &*self.scene.body
    }
    fn rest(&self) -> &TriMesh {
        &self.scene.rest
    }
    fn rest_joints(&self) -> Result<Vec<Vec3>> {
        Ok(self.scene.rest_joints.clone())
    }
    fn clip(&self) -> &MotionClip {
        &self.film.clip
    }
    fn body_frame(&self, frame: usize) -> Result<Vec<Vec3>> {
        Ok(self.scene.body.forward(&self.scene.subject.posed(&self.film.clip.poses[frame]))?.vertices)
    }
    fn garments(&self) -> Vec<MovingGarment<'_>> {
        self.garments.iter().map(|g| MovingGarment { kind: g.kind, mesh: &g.mesh }).collect()
    }
    fn garment_frame(&self, garment: usize, frame: usize) -> Result<Vec<Vec3>> {
        Ok(self.film.garments[garment].vertices(frame))
    }
    fn colours(&self, part: usize) -> Option<&[[u8; 3]]> {
        self.colours.get(part).map(Vec::as_slice)
    }
}
