//! Collision fine-tuning of both garments together (Sec. 3.5, Eqs. 11-12): random windows and scan poses in turn, the scan
//! poses with their Eq. 9 terms.

use super::preprocess::Subject;
use super::train::{Nets, config_key};
use super::{Context, material};
use crate::artifact;
use crate::scene::{Scene, scan_frames};
use crate::trainer::{self, GarmentLearner, LearnerState};
use caphy_core::{Error, Result};
use caphy_garment::energy::{Layer, Layering};
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Both garments at some step.
#[derive(Serialize, Deserialize)]
struct Checkpoint {
    step: usize,
    states: Vec<LearnerState>,
}

/// Fine-tunes the nets; a subject with one garment, or no epochs, keeps its nets.
pub fn run(context: &Context<'_>, subject: &Subject, nets: &Nets) -> Result<Nets> {
    let settings = &context.config.finetune;
    if subject.garments.len() < 2 || settings.epochs == 0 {
        return Ok(nets.clone());
    }
    let config = &context.config.train;
    let scene = Scene::new(context, subject)?;
    let motion = scene.motion(context)?;
    let track = scene.scan_track(subject)?;
    let scans =
        subject.garments.iter().map(|g| scan_frames(context, subject, g, track.clone())).collect::<Result<Vec<_>>>()?;
    let mut learners = Vec::new();
    for ((fitted, trained), scans) in subject.garments.iter().zip(&nets.garments).zip(&scans) {
        let table = &context.config.garment(fitted.kind)?.material;
        let model = Arc::from(material(table, config_key(fitted.kind), trained.material.as_deref())?);
        let (net, contact) = (&context.config.net, scene.contact(fitted)?);
        learners.push(GarmentLearner::new(fitted, trained, model, net, config, &motion, scans, contact)?);
    }
    let [upper, lower] = &mut learners[..] else {
        return Err(Error::Length { what: "garments to fine-tune".into(), expected: 2, got: learners.len() });
    };
    let layering = Layering::<f32>::new(&upper.rest, &lower.rest, settings.layering)?;
    let seed = context.config.run.seed.wrapping_mul(1000).wrapping_add(999);
    let mut batches = Vec::new();
    for epoch in 0..settings.epochs as u64 {
        if epoch % 2 == 0 {
            batches.extend(trainer::window_batches(&motion, config, settings.windows, seed, epoch));
        } else {
            batches.extend(trainer::scan_batches(track.len(), config, seed, epoch));
        }
    }
    let path = context.folder.join("checkpoint-finetune.caphy");
    let mut step = 0;
    if let Some((saved, _)) = artifact::load::<Checkpoint>(&path, "checkpoint", context.key)? {
        for (learner, state) in [&mut *upper, &mut *lower].into_iter().zip(&saved.states) {
            learner.restore(state)?;
        }
        step = saved.step;
    }
    while step < batches.len() {
        let batch = &batches[step];
        let share = step as f64 / batches.len() as f64;
        let (mut u, mut l) = (upper.forward(batch)?, lower.forward(batch)?);
        let mut energy = vec![0.0; batch.frames.len()];
        let weight = config.weights.layering / batch.frames.len() as f64;
        layering.add(
            Layer { positions: &u.positions, gradient: Some(&mut u.gradient) },
            Layer { positions: &l.positions, gradient: Some(&mut l.gradient) },
            weight,
            &mut energy,
        )?;
        upper.backward(&u)?;
        lower.backward(&l)?;
        let rate = trainer::learning_rate(config, settings.learning_rate, share);
        upper.step(rate, config.clip_norm)?;
        lower.step(rate, config.clip_norm)?;
        step += 1;
        if step % 5 == 0 {
            let joules: f64 = energy.iter().sum();
            context.progress.set(share, &format!("step {step} of {}, layering {joules:.2e} J", batches.len()));
        }
        if step % config.checkpoint_every == 0 {
            let states = vec![upper.snapshot(), lower.snapshot()];
            artifact::save(&path, "checkpoint", context.key, &Checkpoint { step, states })?;
        }
    }
    let mut out = nets.clone();
    for (trained, learner) in out.garments.iter_mut().zip(&learners) {
        trained.parameters = learner.parameters.clone();
    }
    Ok(out)
}
