//! The loop around training steps: order of batches, record, pictures, checkpoints, the way back from values that are not
//! finite.
//!
//! What is trained is a [`Trainee`]: one garment, or two whose nets learn together. A run that is killed at any moment goes
//! on from its last checkpoint to the same bits: batches are a function of seed and round, a checkpoint holds nets,
//! optimisers and the length of every record, and all that happens after it happens again.

pub mod measures;
mod order;
mod preview;
pub mod record;
mod spent;

pub use order::Order;
pub use preview::Preview;
pub(crate) use spent::Part;

use crate::artifact;
use crate::config::TrainConfig;
use crate::physics::TermEnergies;
use crate::progress::Pace;
use crate::scene::FrameNames;
use crate::stage::Context;
use crate::trainer::{self, Batch, BatchKind, CurvePoint, Fault, LearnerState};
use caphy_core::{Error, Result};
use caphy_render::{Rgb, png};
use measures::Measures;
use record::{Line, Position, Record, kind};
use serde::{Deserialize, Serialize};
use spent::Spent;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// What one step did to one garment.
pub struct GarmentStep {
    /// Mean energies before the step.
    pub energies: TermEnergies,
    /// Norm of the gradient before it was shortened.
    pub gradient_norm: f64,
    /// Where they were asked for.
    pub measures: Option<Measures>,
}

/// Garments whose nets learn together, step by step.
pub trait Trainee {
    /// Names of the garments, in the order of everything below.
    fn garments(&self) -> Vec<String>;
    /// One step. After an error in the finite numbers, parameters are as before it.
    fn step(&mut self, batch: &Batch, share: f64, rate: f64, measure: bool) -> Result<Vec<GarmentStep>>;
    /// Weights on a schedule at a share of training, by term.
    fn scheduled(&self, share: f64) -> Vec<(&'static str, f64)>;
    /// After a step that failed: what was not finite, with the garment's name.
    fn fault(&self, batch: &Batch) -> Option<(String, Fault)>;
    /// Nets and optimisers.
    fn snapshot(&self) -> Vec<LearnerState>;
    /// Goes back to a snapshot.
    fn restore(&mut self, states: &[LearnerState]) -> Result<()>;
    /// Wall time of all steps by part, in their order; nothing unless the context asks for it.
    fn profile(&self) -> Vec<(&'static str, Duration)>;
    /// The garments on the body, now.
    fn draw(&self, preview: &Preview<'_>) -> Result<Rgb>;
}

/// What the loop is given besides the trainee.
pub struct Plan<'a, 'c> {
    /// The stage.
    pub context: &'a Context<'c>,
    /// Names checkpoint, pictures and messages: the garment, or the stage where garments learn together.
    pub name: &'a str,
    /// All batches.
    pub order: Order<'a>,
    /// Adam's first learning rate; it falls as `[train]` says.
    pub learning_rate: f64,
    /// Names of frames, for messages.
    pub names: &'a FrameNames,
    /// Poses to draw.
    pub preview: Option<&'a Preview<'a>>,
    /// Times of steps: [`Plan::kinds`] says which of its kinds are windows and scan poses here.
    pub pace: &'a mut Pace,
    /// Kinds in `pace`.
    pub kinds: [usize; 2],
    /// Part of the stage's progress, from and to.
    pub part: [f64; 2],
}

/// What a training leaves.
pub struct Outcome {
    /// Per garment, thinned for the report.
    pub curves: Vec<Vec<CurvePoint>>,
    /// Median time of a step on a whole batch of windows [ms]; 0 without any.
    pub step_ms: f64,
}

/// Everything that the next step depends on.
#[derive(Serialize, Deserialize)]
struct Checkpoint {
    step: usize,
    states: Vec<LearnerState>,
    rate_factor: f64,
    rollbacks: usize,
    curves: Vec<Vec<CurvePoint>>,
    records: Vec<Position>,
}

/// Points of the curve kept per training.
const CURVE_POINTS: usize = 120;
/// Times that training goes back to its last good state with a smaller step before it gives up.
const MOST_ROLLBACKS: usize = 6;

/// Runs all batches.
///
/// # Errors
/// What steps give; values that are not finite only after several ways back, naming term, element and frame.
pub fn learn(trainee: &mut dyn Trainee, mut plan: Plan<'_, '_>) -> Result<Outcome> {
    let (context, name) = (plan.context, plan.name);
    let config = &context.config.train;
    let steps = plan.order.len();
    let path = context.folder.join(format!("checkpoint-{name}.caphy"));
    let key = format!("{}-{name}", context.key);
    let garments = trainee.garments();
    let mut at = Checkpoint {
        step: 0,
        states: trainee.snapshot(),
        rate_factor: 1.0,
        rollbacks: 0,
        curves: vec![Vec::new(); garments.len()],
        records: vec![Position::default(); garments.len()],
    };
    if let Some((saved, _)) = artifact::load::<Checkpoint>(&path, "checkpoint", &key)? {
        context.progress.note(&format!("{name}: going on from step {} of {steps}", saved.step));
        trainee.restore(&saved.states)?;
        at = saved;
    } else {
        drop_previews(context, name);
    }
    let mut records = Vec::new();
    for (garment, position) in garments.iter().zip(&at.records) {
        let (record, warning) = Record::open(context.folder, &format!("{}-{garment}", context.stage), *position)?;
        if let Some(warning) = warning {
            context.progress.note(&warning);
        }
        records.push(record);
    }
    at.records = records.iter().map(Record::position).collect();
    let mut step = at.step;
    let mut curves = at.curves.clone();
    let mut times = Vec::new();
    let every = steps.div_ceil(CURVE_POINTS).max(1);
    let set_left = |plan: &mut Plan<'_, '_>, step: usize| {
        for (kind, left) in plan.kinds.into_iter().zip(plan.order.left(step)) {
            plan.pace.set_left(kind, left);
        }
    };
    set_left(&mut plan, step);
    let mut last = Instant::now();
    let (begun, mut spent) = (last, Spent::default());
    let mut stepped = 0usize;
    while step < steps {
        let share = step as f64 / steps as f64;
        let rate = at.rate_factor * trainer::learning_rate(config, plan.learning_rate, share);
        let round = plan.order.round(step);
        let measure = config.measure_every > 0 && step.is_multiple_of(config.measure_every);
        let batch = plan.order.batch(step);
        let started = Instant::now();
        let outcome = trainee.step(batch, share, rate, measure);
        let seconds = started.elapsed().as_secs_f64();
        stepped += 1;
        match outcome {
            Ok(done) => {
                if !measure {
                    spent.add(Part::Step(batch.kind), seconds);
                }
                let (scans, single) = (batch.kind == BatchKind::Scans, batch.kind != BatchKind::Windows);
                if !single && batch.windows == config.batch && !measure {
                    times.push(seconds * 1e3);
                }
                let weights = trainee.scheduled(share);
                for ((garment, record), curve) in done.iter().zip(&mut records).zip(&mut curves) {
                    if step.is_multiple_of(config.metrics_every) || measure {
                        record.step(&Line {
                            step,
                            kind: kind(batch),
                            round,
                            learning_rate: rate,
                            energies: &garment.energies,
                            gradient_norm: garment.gradient_norm,
                            weights: &weights,
                            measures: garment.measures,
                        })?;
                    }
                    let shown = step.is_multiple_of(every) || scans && step % every < config.scan_epochs;
                    // Curves are of windows and of scans.
                    if shown && (scans || !single) {
                        curve.push(CurvePoint {
                            step,
                            scans,
                            energies: garment.energies.iter().map(|(n, e)| (n.to_string(), *e)).collect(),
                            gradient_norm: garment.gradient_norm,
                        });
                    }
                }
                step += 1;
                if draws_after(config, &plan.order, step)
                    && let Some(preview) = plan.preview
                {
                    let started = Instant::now();
                    draw(context, name, trainee, preview, step, &mut records)?;
                    spent.add(Part::Picture, started.elapsed().as_secs_f64());
                }
                if step.is_multiple_of(config.checkpoint_every) || step == steps {
                    let started = Instant::now();
                    records.iter().try_for_each(Record::sync)?;
                    // Nets are large: two snapshots are never held at once.
                    at.states.clear();
                    at = Checkpoint {
                        step,
                        states: trainee.snapshot(),
                        curves: curves.clone(),
                        records: records.iter().map(Record::position).collect(),
                        ..at
                    };
                    artifact::save(&path, "checkpoint", &key, &at)?;
                    spent.add(Part::Checkpoint, started.elapsed().as_secs_f64());
                }
                plan.pace.step(plan.kinds[usize::from(single)], seconds);
                plan.pace.between((last.elapsed().as_secs_f64() - seconds).max(0.0));
                last = Instant::now();
                let [from, to] = plan.part;
                let total: f64 = done.iter().flat_map(|g| &g.energies).map(|e| e.1).sum();
                let text = format!("{name}: step {step} of {steps}, {total:.3} J");
                context.progress.set_left(from + (to - from) * step as f64 / steps as f64, plan.pace.left(), &text);
            }
            Err(error @ (Error::NonFinite { .. } | Error::Numerics { .. })) => {
                let because = explain(trainee, batch, plan.names, &error);
                if at.rollbacks == MOST_ROLLBACKS {
                    return Err(Error::numerics(
                        format!("training of {name}, step {step}"),
                        format!("{because}; this was tried {} times, each with half the step size", MOST_ROLLBACKS + 1),
                        "look at that frame and element; a smaller train.learning_rate or train.clip_norm may help",
                    ));
                }
                at.rollbacks += 1;
                at.rate_factor *= 0.5;
                context.progress.note(&format!(
                    "{name}: step {step} left the finite numbers: {because}; back to step {} with half the step size",
                    at.step
                ));
                trainee.restore(&at.states)?;
                for (record, position) in records.iter_mut().zip(&at.records) {
                    record.cut(*position)?;
                    record.rollback(at.step, step, &because)?;
                }
                // That it was tried stays in the record when it is tried again.
                at.records = records.iter().map(Record::position).collect();
                step = at.step;
                curves = at.curves.clone();
                set_left(&mut plan, step);
                last = Instant::now();
            }
            Err(error) => return Err(error),
        }
    }
    for (i, (part, time)) in trainee.profile().into_iter().enumerate() {
        let ms = time.as_secs_f64() * 1e3 / stepped.max(1) as f64;
        context.time(&format!("step of {name}: {:02} {part}, ms", i + 1), ms);
    }
    spent.add(Part::All, begun.elapsed().as_secs_f64());
    spent.tell(context, name);
    times.sort_by(f64::total_cmp);
    Ok(Outcome { curves, step_ms: times.get(times.len() / 2).copied().unwrap_or(0.0) })
}

/// Garment, term, element and frame of a value that is not finite; the error itself where it cannot be found again.
fn explain(trainee: &dyn Trainee, batch: &Batch, names: &FrameNames, error: &Error) -> String {
    let Some((garment, fault)) = trainee.fault(batch) else { return error.to_string() };
    let place = match fault.frame.map(|frame| (frame, batch.frames.iter().position(|f| *f == frame))) {
        Some((frame, Some(at))) => {
            let (step, window) = (at / batch.windows, at % batch.windows);
            format!(
                ", in {} (window {window} of the batch, frame {step} of it)",
                names.long(frame, batch.kind == BatchKind::Scans)
            )
        }
        Some((frame, None)) => format!(", in {}", names.long(frame, batch.kind == BatchKind::Scans)),
        None => String::new(),
    };
    format!("{} of {garment}: {}{place}", fault.source, fault.what)
}

fn draws_after(config: &TrainConfig, order: &Order<'_>, steps: usize) -> bool {
    let every = config.preview_every;
    every > 0 && order.rounds_done(steps).is_some_and(|rounds| rounds.is_multiple_of(every) || steps == order.len())
}

/// Draws to `previews/STAGE-NAME-STEP.png`. A picture that cannot be drawn is left out: training does not hang on it.
fn draw(
    context: &Context<'_>,
    name: &str,
    trainee: &dyn Trainee,
    preview: &Preview<'_>,
    steps: usize,
    records: &mut [Record],
) -> Result<()> {
    let (picture, bytes) = match trainee.draw(preview).and_then(|picture| png(&picture).map(|bytes| (picture, bytes))) {
        Ok(drawn) => drawn,
        Err(error) => {
            context.progress.note(&format!("{name}: no picture after step {steps}: {error}"));
            return Ok(());
        }
    };
    context.write(&format!("{PREVIEWS}/{}{steps:06}.png", prefix(context, name)), &bytes)?;
    for record in records {
        record.picture(steps, [picture.width, picture.height], &bytes)?;
    }
    Ok(())
}

/// Folder of the pictures in a run folder.
const PREVIEWS: &str = "previews";

fn prefix(context: &Context<'_>, name: &str) -> String {
    if context.stage == name { format!("{name}-") } else { format!("{}-{name}-", context.stage) }
}

/// Pictures in a run folder: what was trained in which stage, and the files with their steps, rising.
pub fn previews(folder: &Path) -> Vec<(String, Vec<(usize, PathBuf)>)> {
    let mut all: BTreeMap<String, Vec<(usize, PathBuf)>> = BTreeMap::new();
    let entries = std::fs::read_dir(folder.join(PREVIEWS)).into_iter().flatten().flatten();
    for entry in entries {
        let path = entry.path();
        let stem = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        if let Some((what, step)) = stem.rsplit_once('-')
            && let Ok(step) = step.parse()
            && path.extension().is_some_and(|e| e == "png")
        {
            all.entry(what.to_string()).or_default().push((step, Path::new(PREVIEWS).join(entry.file_name())));
        }
    }
    all.values_mut().for_each(|files| files.sort());
    all.into_iter().collect()
}

/// Pictures of a training that is begun anew: it may have other steps. One that cannot be removed only confuses.
fn drop_previews(context: &Context<'_>, name: &str) {
    let whose = prefix(context, name);
    for (what, files) in previews(context.folder) {
        if format!("{what}-") == whose {
            for (_, file) in files {
                std::fs::remove_file(context.folder.join(file)).ok();
            }
        }
    }
}
