//! Training of both garments' nets (Secs. 3.2, 3.3): one epoch of random windows by Eq. 6, four epochs of scan poses by Eq. 8,
//! repeated.

use super::optimise::Estimates;
use super::preprocess::Subject;
use super::{Context, StageOutput, material};
use crate::artifact;
use crate::garment::TrainedGarment;
use crate::scene::{Scene, scan_frames};
use crate::trainer::{self, Batch, CurvePoint, GarmentLearner, LearnerState, MotionFrames};
use caphy_core::{Error, Result};
use caphy_garment::template::GarmentKind;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Trained nets, upper first.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Nets {
    /// One per garment of the subject, in its order.
    pub garments: Vec<TrainedGarment>,
}

impl StageOutput for Nets {}

impl Nets {
    /// The net of a garment.
    pub fn of(&self, kind: GarmentKind) -> Option<&TrainedGarment> {
        self.garments.iter().find(|g| g.kind == kind)
    }
}

/// Where training starts.
#[derive(Debug, Clone, Default)]
pub struct Start {
    /// Nets to go on from; none: zero-initialised heads, so that garments start as the skinned template.
    pub nets: Option<Nets>,
    /// Estimated fabric parameters per garment; none: as configured.
    pub fabrics: Vec<Option<Vec<f64>>>,
    /// Rounds of 1 + `scan_epochs` epochs.
    pub rounds: usize,
}

impl Start {
    /// From nothing, with the configured fabrics.
    pub fn fresh(rounds: usize) -> Start {
        Start { rounds, ..Start::default() }
    }
    /// From trained nets with newly estimated fabrics.
    pub fn from_estimate(nets: &Nets, estimates: &Estimates, rounds: usize) -> Start {
        let fabrics = estimates.garments.iter().map(|e| Some(e.estimate.parameters.clone())).collect();
        Start { nets: Some(nets.clone()), fabrics, rounds }
    }
}

/// Key of a garment's table in the configuration.
pub fn config_key(kind: GarmentKind) -> &'static str {
    match kind {
        GarmentKind::Upper => "upper.material",
        GarmentKind::Lower => "lower.material",
    }
}

/// A checkpoint: everything that the next step depends on.
#[derive(Serialize, Deserialize)]
struct Checkpoint {
    step: usize,
    state: LearnerState,
    rate_factor: f64,
    curve: Vec<CurvePoint>,
}

/// Points of the curve kept per training.
const CURVE_POINTS: usize = 120;
/// Times that training goes back to its last good state with a smaller step before it gives up.
const MOST_ROLLBACKS: usize = 6;

/// Trains every garment of the subject.
pub fn run(context: &Context<'_>, subject: &Subject, start: &Start) -> Result<Nets> {
    let scene = Scene::new(context, subject)?;
    context.progress.set(0.0, "posing the body");
    let motion = scene.motion(context)?;
    let scan_track = scene.scan_track(subject)?;
    let count = subject.garments.len();
    let mut nets = Nets { garments: Vec::new() };
    for (index, fitted) in subject.garments.iter().enumerate() {
        let config = &context.config.train;
        let scans = scan_frames(context, subject, fitted, scan_track.clone())?;
        let seed = context.config.run.seed.wrapping_mul(1000).wrapping_add(index as u64);
        let first = match &start.nets {
            Some(nets) => nets.garments.get(index).cloned().ok_or_else(|| Error::Length {
                what: "trained garments".into(),
                expected: count,
                got: nets.garments.len(),
            })?,
            None => trainer::untrained(
                fitted,
                scene.body.describe(),
                &context.config.net,
                config,
                &motion,
                &scan_track,
                seed,
            )?,
        };
        let table = &context.config.garment(fitted.kind)?.material;
        let fabric = start.fabrics.get(index).cloned().flatten().or_else(|| first.material.clone());
        let model: Arc<_> = Arc::from(material(table, config_key(fitted.kind), fabric.as_deref())?);
        let mut learner = {
            let contact = scene.contact(fitted)?;
            GarmentLearner::new(fitted, &first, model, &context.config.net, config, &motion, &scans, contact)?
        };
        let batches = plan(context, &motion, scans.clouds.len(), start.rounds, seed);
        let name = fitted.kind.to_string();
        let share = |s: f64| (index as f64 + s) / count as f64;
        let (curve, step_ms) = learn(context, &mut learner, &batches, &name, &|s, text| {
            context.progress.set(share(s), text);
        })?;
        write_metrics(context, &name, &curve)?;
        nets.garments.push(TrainedGarment {
            parameters: learner.parameters.clone(),
            material: fabric,
            curve: first.curve.iter().cloned().chain(shifted(curve, &first.curve)).collect(),
            ..first
        });
        if step_ms > 0.0 {
            context.time(&format!("step of {name}, ms"), step_ms);
        }
        context.progress.note(&format!("{name}: {step_ms:.1} ms per step of {} windows", config.batch));
    }
    Ok(nets)
}

/// The record of training as one JSON object per line.
fn write_metrics(context: &Context<'_>, name: &str, curve: &[CurvePoint]) -> Result<()> {
    let mut lines = String::new();
    for point in curve {
        let line = serde_json::to_string(point)
            .map_err(|e| Error::numerics("training metrics", e.to_string(), "report this as a defect"))?;
        lines.push_str(&line);
        lines.push('\n');
    }
    context.write(&format!("metrics-{}-{name}.jsonl", context.stage), lines.as_bytes())
}

/// Numbers the points of a second training after those of the first.
fn shifted(curve: Vec<CurvePoint>, before: &[CurvePoint]) -> Vec<CurvePoint> {
    let offset = before.last().map_or(0, |p| p.step + 1);
    curve.into_iter().map(|p| CurvePoint { step: p.step + offset, ..p }).collect()
}

/// All batches of a training in order: 1 epoch of windows, `scan_epochs` epochs of scan poses, `rounds` times.
fn plan(context: &Context<'_>, motion: &MotionFrames, scans: usize, rounds: usize, seed: u64) -> Vec<Batch> {
    let config = &context.config.train;
    let mut batches = Vec::new();
    for round in 0..rounds as u64 {
        batches.extend(trainer::window_batches(motion, config, config.windows, seed, round));
        for epoch in 0..config.scan_epochs as u64 {
            let epoch = round * config.scan_epochs as u64 + epoch;
            batches.extend(trainer::scan_batches(scans, config, seed, epoch));
        }
    }
    batches
}

/// Runs all batches with checkpoints; returns the curve and the median time of a step on windows [ms].
fn learn(
    context: &Context<'_>,
    learner: &mut GarmentLearner<'_>,
    batches: &[Batch],
    name: &str,
    progress: &dyn Fn(f64, &str),
) -> Result<(Vec<CurvePoint>, f64)> {
    let config = &context.config.train;
    let path = context.folder.join(format!("checkpoint-{name}.caphy"));
    let key = format!("{}-{name}", context.key);
    let mut at = Checkpoint { step: 0, state: learner.snapshot(), rate_factor: 1.0, curve: Vec::new() };
    if let Some((saved, _)) = artifact::load::<Checkpoint>(&path, "checkpoint", &key)? {
        context.progress.note(&format!("{name}: going on from step {} of {}", saved.step, batches.len()));
        learner.restore(&saved.state)?;
        at = saved;
    }
    let every = batches.len().div_ceil(CURVE_POINTS).max(1);
    let mut times = Vec::new();
    let mut rollbacks = 0;
    let mut step = at.step;
    let mut curve = at.curve.clone();
    while step < batches.len() {
        let batch = &batches[step];
        let share = step as f64 / batches.len().max(1) as f64;
        let rate = at.rate_factor * trainer::learning_rate(config, config.learning_rate, share);
        let started = std::time::Instant::now();
        let outcome = learner.forward(batch).and_then(|pass| {
            learner.backward(&pass)?;
            let norm = learner.step(rate, config.clip_norm)?;
            Ok((pass.energies, norm))
        });
        match outcome {
            Ok((energies, norm)) => {
                if !batch.scans && batch.windows == config.batch {
                    times.push(started.elapsed().as_secs_f64() * 1e3);
                }
                if step.is_multiple_of(every) || batch.scans && step % every < config.scan_epochs {
                    curve.push(CurvePoint {
                        step,
                        scans: batch.scans,
                        energies: energies.iter().map(|(n, e)| (n.to_string(), *e)).collect(),
                        gradient_norm: norm,
                    });
                }
                step += 1;
                if step.is_multiple_of(10) {
                    let total: f64 = energies.iter().map(|e| e.1).sum();
                    progress(share, &format!("{name}: step {step} of {}, {total:.3} J", batches.len()));
                }
                if step.is_multiple_of(config.checkpoint_every) {
                    at = Checkpoint {
                        step,
                        state: learner.snapshot(),
                        rate_factor: at.rate_factor,
                        curve: curve.clone(),
                    };
                    artifact::save(&path, "checkpoint", &key, &at)?;
                }
            }
            Err(error @ (Error::NonFinite { .. } | Error::Numerics { .. })) if rollbacks < MOST_ROLLBACKS => {
                rollbacks += 1;
                at.rate_factor *= 0.5;
                context.progress.note(&format!(
                    "{name}: step {step} left the finite numbers ({error}); back to step {} with half the step size",
                    at.step
                ));
                learner.restore(&at.state)?;
                step = at.step;
                curve = at.curve.clone();
            }
            Err(error) => return Err(error),
        }
    }
    if at.step != step {
        at = Checkpoint { step, state: learner.snapshot(), rate_factor: at.rate_factor, curve: curve.clone() };
        artifact::save(&path, "checkpoint", &key, &at)?;
    }
    times.sort_by(f64::total_cmp);
    Ok((curve, times.get(times.len() / 2).copied().unwrap_or(0.0)))
}
