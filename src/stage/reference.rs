//! Garments along a clip by the reference solver, each alone on the body: what trained nets are compared with.

use super::preprocess::Subject;
use super::train::{Nets, config_key};
use super::{Context, StageOutput, material};
use crate::config::CompareConfig;
use crate::motion;
use crate::physics::solver_forces;
use crate::scene::Scene;
use crate::simulate::{Simulation, SimulationOptions, Steps, simulate};
use caphy_core::material::MaterialModel;
use caphy_core::pose::Pose;
use caphy_core::{Error, Result, Vec3};
use caphy_garment::template::GarmentKind;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Simulated garments.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Reference {
    /// Poses of the clip.
    pub poses: Vec<Pose>,
    /// Frames per second.
    pub fps: f64,
    /// Frames that were brought to rest.
    pub resting: Vec<usize>,
    /// One per garment of the subject, in its order.
    pub garments: Vec<ReferenceGarment>,
}

/// One garment, by the solver.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct ReferenceGarment {
    /// Upper or lower.
    pub kind: GarmentKind,
    /// In motion [m], shape [frame][vertex].
    pub moving: Vec<Vec<Vec3>>,
    /// At rest [m], shape [resting][vertex].
    pub at_rest: Vec<Vec<Vec3>>,
    /// Mean energies per term, in motion and at rest [J]: of the solver's own contacts, which keep cloth in a fold of the body on
    /// its side.
    pub energies: [Vec<(String, f64)>; 2],
    /// Largest force left on a vertex, in motion and at rest [N].
    pub residual_n: [f64; 2],
    /// Frames whose forces did not come below the tolerance, in motion and at rest.
    pub unconverged: [usize; 2],
}

impl StageOutput for Reference {}

/// The fabric of a garment: estimated with the nets, where it was.
pub(super) fn fabric(context: &Context<'_>, kind: GarmentKind, nets: Option<&Nets>) -> Result<Arc<dyn MaterialModel>> {
    let estimated = nets.and_then(|n| n.of(kind)).and_then(|g| g.material.as_deref());
    Ok(Arc::from(material(&context.config.garment(kind)?.material, config_key(kind), estimated)?))
}

/// The table that asks for the comparison.
fn settings<'c>(context: &Context<'c>) -> Result<&'c CompareConfig> {
    let missing = || Error::config("compare", "there is no such table", "add [compare] with a `clip`");
    context.config.compare.as_ref().ok_or_else(missing)
}

/// Simulates every garment.
pub fn run(context: &Context<'_>, subject: &Subject, nets: Option<&Nets>) -> Result<Reference> {
    let compare = settings(context)?;
    let scene = Scene::new(context, subject)?;
    let fps = context.config.motion.fps;
    let mut clip = motion::load(context.files, &compare.clip, None, fps, &scene.rest_joints[0])?.clip;
    clip.poses.truncate((compare.seconds * fps).floor() as usize + 1);
    let track = scene.track(&clip.poses)?;
    let resting: Vec<usize> = (0..clip.poses.len()).step_by(compare.rest_every).collect();
    let standing: Vec<Pose> = resting.iter().map(|&f| clip.poses[f].clone()).collect();
    let still = scene.track(&standing)?;
    let count = subject.garments.len();
    let mut garments = Vec::new();
    for (k, garment) in subject.garments.iter().enumerate() {
        let contact = scene.contact(garment)?;
        let solve = |steps: Steps, from: f64, to: f64| -> Result<Simulation> {
            let options = SimulationOptions {
                steps,
                fps,
                forces: solver_forces(&context.config.train),
                settings: compare.solver,
                disturbance: None,
            };
            let say = |s: f64, text: &str| {
                let share = (k as f64 + from + (to - from) * s) / count as f64;
                context.progress.set(share, &format!("{}: {text}", garment.kind));
            };
            let track = if steps == Steps::Dynamic { &track } else { &still };
            simulate(garment, fabric(context, garment.kind, nets)?, track, &contact, None, &options, &say)
        };
        let at_rest = solve(Steps::QuasiStatic, 0.0, 0.3)?;
        let moving = solve(Steps::Dynamic, 0.3, 1.0)?;
        let energies = [moving.mean_energies(), at_rest.mean_energies()];
        let residual_n = [moving.worst_residual_n(), at_rest.worst_residual_n()];
        let unconverged = [moving.unconverged(), at_rest.unconverged()];
        context.progress.note(&format!(
            "{}: {} steps; not converged {} of {} frames in motion (most {:.1e} N), {} of {} at rest (most {:.1e} N)",
            garment.kind,
            moving.iterations() + at_rest.iterations(),
            unconverged[0],
            moving.frames.len(),
            residual_n[0],
            unconverged[1],
            at_rest.frames.len(),
            residual_n[1],
        ));
        garments.push(ReferenceGarment {
            kind: garment.kind,
            moving: moving.frames,
            at_rest: at_rest.frames,
            energies,
            residual_n,
            unconverged,
        });
    }
    Ok(Reference { poses: clip.poses, fps, resting, garments })
}
