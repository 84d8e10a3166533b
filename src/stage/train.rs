//! Training of both garments' nets (Secs. 3.2, 3.3): one epoch of random windows by Eq. 6, four epochs of scan poses by Eq. 8,
//! repeated.

use super::optimise::Estimates;
use super::preprocess::Subject;
use super::{Context, StageOutput, material};
use crate::config::{ContactWith, TrainConfig};
use crate::garment::{FittedGarment, TrainedGarment};
use crate::progress::{Pace, Work};
use crate::scene::{FrameNames, Scene, scan_frames};
use crate::trainer::{
    self, Batch, BatchKind, CurvePoint, Fault, GarmentLearner, LearnerState, MotionFrames, ScanFrames,
};
use crate::training::measures::{Measures, depth, stretches};
use crate::training::{GarmentStep, Order, Plan, Preview, Trainee, learn};
use caphy_core::{Error, Result};
use caphy_garment::contact::ContactMap;
use caphy_garment::template::GarmentKind;
use caphy_render::Rgb;
use serde::{Deserialize, Serialize};
use std::sync::Arc;
use std::time::Duration;

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
        let fabrics = estimates.garments.iter().map(|e| Some(e.fabric.after.clone())).collect();
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

/// One garment and its learner: what is trained alone here, and together in fine-tuning.
pub struct Pupil<'a> {
    /// The template.
    pub fitted: &'a FittedGarment,
    /// What training started from.
    pub first: TrainedGarment,
    /// Net and optimiser.
    pub learner: GarmentLearner<'a>,
    contact: ContactMap,
    motion: &'a MotionFrames,
    scans: &'a ScanFrames,
}

impl<'a> Pupil<'a> {
    /// A garment in a scene, going on from a net.
    ///
    /// # Errors
    /// As [`GarmentLearner::new`].
    pub fn new(
        context: &Context<'a>,
        scene: &Scene,
        fitted: &'a FittedGarment,
        first: TrainedGarment,
        motion: &'a MotionFrames,
        scans: &'a ScanFrames,
    ) -> Result<Pupil<'a>> {
        let table = &context.config.garment(fitted.kind)?.material;
        let model: Arc<_> = Arc::from(material(table, config_key(fitted.kind), first.material.as_deref())?);
        let (net, config, contact) = (&context.config.net, &context.config.train, scene.contact(fitted)?);
        let mut learner = GarmentLearner::new(fitted, &first, model, net, config, motion, scans, contact.clone())?;
        learner.set_profiling(context.profile);
        if config.contact_with == ContactWith::Triangle {
            learner.meet_triangles(&scene.reach.faces)?;
        }
        Ok(Pupil { fitted, first, learner, contact, motion, scans })
    }
    /// The garment with its net as it is now.
    pub fn trained(&self) -> TrainedGarment {
        TrainedGarment { parameters: self.learner.parameters.clone(), ..self.first.clone() }
    }
    /// What a pass over a batch shows.
    ///
    /// # Errors
    /// As [`depth`].
    pub fn measures(&self, batch: &Batch, pass: &trainer::Pass) -> Result<Measures> {
        let track = if batch.kind == BatchKind::Scans { &*self.scans.track } else { &self.motion.track };
        let [major_stretch, minor_stretch] = stretches(&self.learner.rest, &pass.positions);
        let body = depth(&self.contact, track, batch, &pass.positions)?;
        Ok(Measures { major_stretch, minor_stretch, body })
    }
}

/// A garment trained alone.
pub struct Alone<'a> {
    /// The garment.
    pub pupil: Pupil<'a>,
    /// `[train]`.
    pub config: &'a TrainConfig,
    /// Whether schedules run; if not, they stand at their ends.
    pub scheduled: bool,
}

impl Trainee for Alone<'_> {
    fn garments(&self) -> Vec<String> {
        vec![self.pupil.fitted.kind.to_string()]
    }
    fn step(&mut self, batch: &Batch, share: f64, rate: f64, measure: bool) -> Result<Vec<GarmentStep>> {
        let learner = &mut self.pupil.learner;
        if self.scheduled {
            learner.set_share(share);
        }
        let pass = learner.forward(batch)?;
        learner.backward(&pass)?;
        let gradient_norm = learner.step(rate, self.config.clip_norm)?;
        let measures = measure.then(|| self.pupil.measures(batch, &pass)).transpose()?;
        Ok(vec![GarmentStep { energies: pass.energies, gradient_norm, measures }])
    }
    fn scheduled(&self, share: f64) -> Vec<(&'static str, f64)> {
        let share = if self.scheduled { share } else { 1.0 };
        let weights = self.config.weights.named();
        weights.iter().filter(|(n, w)| *n != "layering" && !w.is_constant()).map(|(n, w)| (*n, w.at(share))).collect()
    }
    fn fault(&self, batch: &Batch) -> Option<(String, Fault)> {
        self.pupil.learner.fault(batch).map(|fault| (self.pupil.fitted.kind.to_string(), fault))
    }
    fn snapshot(&self) -> Vec<LearnerState> {
        vec![self.pupil.learner.snapshot()]
    }
    fn restore(&mut self, states: &[LearnerState]) -> Result<()> {
        Error::check_length("garments of a checkpoint", 1, states.len())?;
        self.pupil.learner.restore(&states[0])
    }
    fn profile(&self) -> Vec<(&'static str, Duration)> {
        self.pupil.learner.profile()
    }
    fn draw(&self, preview: &Preview<'_>) -> Result<Rgb> {
        preview.draw(&[(self.pupil.fitted, &self.pupil.trained())])
    }
}

/// Trains every garment of the subject.
pub fn run(context: &Context<'_>, subject: &Subject, start: &Start) -> Result<Nets> {
    let config = &context.config.train;
    let scene = Scene::new(context, subject)?;
    context.progress.set(0.0, "posing the body");
    let (motion, clips) = scene.named_motion(context)?;
    let names = FrameNames::new(clips, subject);
    let scan_track = scene.scan_track(subject)?;
    let preview =
        (config.preview_every > 0).then(|| Preview::new(context, &scene, &motion, &scan_track, &names)).transpose()?;
    let count = subject.garments.len();
    let order = |index: usize| order(context, &motion, scan_track.len(), start.rounds, seed(context, index));
    // A window step works on whole windows of all vertices, a scan step on single poses: until both are measured, the one
    // says what the other will take.
    let mut pace = Pace::new(
        (0..count)
            .flat_map(|index| {
                let vertices = subject.garments[index].mesh.vertices.len();
                let frames = [config.batch * config.window, config.batch.min(scan_track.len())];
                let left = order(index).left(0);
                [0, 1].map(|kind| Work { size: (vertices * frames[kind]) as f64, left: left[kind] })
            })
            .collect(),
    );
    let mut nets = Nets { garments: Vec::new() };
    for (index, fitted) in subject.garments.iter().enumerate() {
        let scans = scan_frames(context, subject, fitted, scan_track.clone())?;
        let mut first = match &start.nets {
            Some(nets) => nets.garments.get(index).cloned().ok_or_else(|| Error::Length {
                what: "trained garments".into(),
                expected: count,
                got: nets.garments.len(),
            })?,
            None => {
                let (body, net) = (scene.body.describe(), &context.config.net);
                trainer::untrained(fitted, body, net, config, &motion, &scan_track, seed(context, index))?
            }
        };
        first.material = start.fabrics.get(index).cloned().flatten().or(first.material);
        let pupil = Pupil::new(context, &scene, fitted, first, &motion, &scans)?;
        let mut trainee = Alone { pupil, config, scheduled: start.nets.is_none() };
        let name = fitted.kind.to_string();
        let plan = Plan {
            context,
            name: &name,
            order: order(index),
            learning_rate: config.learning_rate,
            names: &names,
            preview: preview.as_ref(),
            pace: &mut pace,
            kinds: [2 * index, 2 * index + 1],
            part: [index as f64 / count as f64, (index + 1) as f64 / count as f64],
        };
        let outcome = learn(&mut trainee, plan)?;
        let mut trained = trainee.pupil.trained();
        let points = outcome.curves.into_iter().flatten().collect();
        trained.curve.extend(shifted(points, &trainee.pupil.first.curve));
        nets.garments.push(trained);
        if outcome.step_ms > 0.0 {
            context.time(&format!("step of {name}, ms"), outcome.step_ms);
            context.progress.note(&format!("{name}: {:.1} ms per step of {} windows", outcome.step_ms, config.batch));
        }
    }
    Ok(nets)
}

/// Each garment draws its own batches.
fn seed(context: &Context<'_>, index: usize) -> u64 {
    let config = context.config;
    // Far from the garments' numbers, and nothing for the first training.
    config.run.seed.wrapping_mul(1000).wrapping_add(index as u64).wrapping_add(config.train.seed << 32)
}

/// Numbers the points of a second training after those of the first.
fn shifted(curve: Vec<CurvePoint>, before: &[CurvePoint]) -> Vec<CurvePoint> {
    let offset = before.last().map_or(0, |p| p.step + 1);
    curve.into_iter().map(|p| CurvePoint { step: p.step + offset, ..p }).collect()
}

/// Some batches spread evenly among many.
fn spread(many: Vec<Batch>, some: Vec<Batch>) -> Vec<Batch> {
    let (count, all) = (some.len(), many.len().max(1));
    let mut some = some.into_iter();
    let mut out = Vec::new();
    for (i, batch) in many.into_iter().enumerate() {
        out.push(batch);
        let due = (i + 1) * count / all - i * count / all;
        out.extend(some.by_ref().take(due));
    }
    out.extend(some);
    out
}

/// A round is 1 epoch of windows with single poses among them and `scan_epochs` epochs of scan poses.
fn order<'a>(context: &Context<'a>, motion: &'a MotionFrames, scans: usize, rounds: usize, seed: u64) -> Order<'a> {
    let config = &context.config.train;
    Order::new(rounds, move |round| {
        let round = round as u64;
        let windows = trainer::window_batches(motion, config, config.windows, seed, round);
        let still = trainer::still_batches(motion, config, seed, round);
        let mut batches = spread(windows, still);
        for epoch in 0..config.scan_epochs as u64 {
            batches.extend(trainer::scan_batches(scans, config, seed, round * config.scan_epochs as u64 + epoch));
        }
        batches
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn single_poses_are_spread_among_windows() {
        let batches = |kind, count| (0..count).map(|i| Batch { frames: vec![i], windows: 1, kind }).collect::<Vec<_>>();
        for (many, some) in [(8, 3), (2, 5), (0, 2), (4, 0)] {
            let all = spread(batches(BatchKind::Windows, many), batches(BatchKind::Still, some));
            let of = |kind| all.iter().filter(|b| b.kind == kind).map(|b| b.frames[0]).collect::<Vec<_>>();
            // Nothing is lost, and each keeps its order.
            assert_eq!(of(BatchKind::Windows), (0..many).collect::<Vec<_>>());
            assert_eq!(of(BatchKind::Still), (0..some).collect::<Vec<_>>());
        }
        let all = spread(batches(BatchKind::Windows, 9), batches(BatchKind::Still, 3));
        let still: Vec<usize> = (0..12).filter(|&i| all[i].kind == BatchKind::Still).collect();
        assert_eq!(still, [3, 7, 11]);
    }
}
