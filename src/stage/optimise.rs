//! Fabric from trained garments in scan poses (Sec. 3.4): Eq. 10 as a bounded least-squares problem.

use super::preprocess::Subject;
use super::train::{Nets, config_key};
use super::{Context, StageOutput, material};
use crate::inference::{Play, play};
use crate::physics::{Dynamics, Physics};
use crate::scene::Scene;
use caphy_core::lanes::Frames;
use caphy_core::material::MaterialModel;
use caphy_core::{Error, Real, Result};
use caphy_garment::energy::{BodyState, State};
use caphy_garment::estimate::{FabricEstimate, force_balance};
use caphy_garment::skinning::Skinner;
use caphy_garment::template::GarmentKind;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Estimates of all garments.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Estimates {
    /// One per garment of the subject, in its order.
    pub garments: Vec<GarmentFabric>,
}

impl StageOutput for Estimates {}

/// The estimate of one garment's fabric.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct GarmentFabric {
    /// Upper or lower.
    pub kind: GarmentKind,
    /// Native parameters before.
    pub before: Vec<f64>,
    /// What Eq. 10 says.
    pub estimate: FabricEstimate,
}

/// Rows of vertices closer to the body than the contact margin plus this are dropped [m]: their forces are not the
/// fabric's, and the net's error is of this size.
const CONTACT_SLACK: f64 = 2e-3;

/// Solves Eq. 10 for every garment, each in its trained shapes in the training scans' poses.
pub fn run(context: &Context<'_>, subject: &Subject, nets: &Nets) -> Result<Estimates> {
    let scene = Scene::new(context, subject)?;
    let track = scene.scan_track(subject)?;
    let config = &context.config.train;
    let mut garments = Vec::new();
    for (index, (fitted, trained)) in subject.garments.iter().zip(&nets.garments).enumerate() {
        context.progress.set(index as f64 / subject.garments.len() as f64, &fitted.kind.to_string());
        let shapes = play(fitted, trained, &context.config.net, &track, Play::Poses)?;
        // Up to eight poses share a block; every lane of a block must be a pose of its own.
        let lanes = (1..=<f64 as Real>::LANES).rev().find(|l| shapes.len() % l == 0).unwrap_or(1);
        let frames: Vec<usize> = (0..shapes.len()).collect();
        let mut positions = Frames::<f64>::zeros(shapes.len() / lanes, fitted.mesh.vertices.len(), lanes);
        for (frame, shape) in shapes.iter().enumerate() {
            positions.set_frame(frame / lanes, frame % lanes, shape)?;
        }
        let (body, normals) = track.gather::<f64>(&frames, lanes)?;
        let nearest = scene.contact(fitted)?.nearest(&positions, &body)?;
        let table = &context.config.garment(fitted.kind)?.material;
        let start = material(table, config_key(fitted.kind), trained.material.as_deref())?;
        let start: Arc<dyn MaterialModel> = Arc::from(start);
        let rest = fitted.rest(&*start)?;
        let skinner = Skinner::<f64>::new(&fitted.mesh.vertices, &fitted.weights)?;
        let transforms = track.transforms(&frames);
        let joints = skinner.joint_frames(&transforms, lanes)?;
        let mut physics = Physics::<f64>::new(&rest, start.clone(), &config.contact, trained.fps, &config.weights)?;
        let held = physics.attachment.vertices().to_vec();
        let holder = skinner.select(&held)?;
        let mut targets = Frames::zeros(positions.blocks(), held.len(), lanes);
        holder.forward(&holder.joint_frames(&transforms, lanes)?, None, &mut targets)?;
        let state = State::new(&positions)
            .with_body(BodyState { positions: &body, normals: &normals, nearest: Some(&nearest) })
            .with_targets(&targets);

        let mut keep = vec![true; shapes.len() * fitted.mesh.vertices.len() * 3];
        let margin = config.contact.margin + CONTACT_SLACK;
        for frame in 0..shapes.len() {
            let (block, lane) = (frame / lanes, frame % lanes);
            for v in 0..positions.vertices() {
                let id = nearest[(block * positions.vertices() + v) * <f64 as Real>::LANES + lane] as usize;
                let gap = positions.get(block, lane, v) - body.get(block, lane, id);
                if normals.get(block, lane, id).dot(&gap) < margin || held.contains(&(v as u32)) {
                    let row = (frame * positions.vertices() + v) * 3;
                    keep[row..row + 3].fill(false);
                }
            }
        }
        let gradient = |model: &dyn MaterialModel| -> Result<Vec<f64>> {
            // The terms want to own their material: a copy with the same parameters.
            let values: Vec<f64> = model.parameters().iter().map(|p| p.value).collect();
            physics.set_material(Arc::from(model.with_parameters(&values)?));
            let mut world = Frames::zeros(positions.blocks(), positions.vertices(), lanes);
            physics.add(&state, Dynamics::Static, 1.0, Some(&mut world))?;
            let mut canonical = vec![0.0; keep.len()];
            skinner.vjp(&joints, &world, &mut canonical)?;
            Ok(canonical)
        };
        let estimate = force_balance(&*start, gradient, &keep, &context.config.optimise.force_balance)?;
        for warning in &estimate.warnings {
            context.progress.note(&format!("{}: {warning}", fitted.kind));
        }
        let before = start.parameters().iter().map(|p| p.value).collect();
        garments.push(GarmentFabric { kind: fitted.kind, before, estimate });
    }
    if garments.is_empty() {
        return Err(Error::Length { what: "garments".into(), expected: 1, got: 0 });
    }
    Ok(Estimates { garments })
}
