//! Collision fine-tuning of both garments together (Sec. 3.5, Eqs. 11-12): random windows and scan poses in turn, the scan
//! poses with their Eq. 9 terms.

use super::Context;
use super::preprocess::Subject;
use super::train::{Nets, Pupil};
use crate::config::TrainConfig;
use crate::progress::{Pace, Work};
use crate::scene::{FrameNames, Scene, scan_frames};
use crate::trainer::{self, Batch, Fault, LearnerState};
use crate::training::{GarmentStep, Order, Plan, Preview, Trainee, learn};
use caphy_core::{Error, Result};
use caphy_garment::energy::{Layer, Layering};
use caphy_render::Rgb;
use std::time::Duration;

/// Both garments.
struct Pair<'a> {
    upper: Pupil<'a>,
    lower: Pupil<'a>,
    layering: Layering<f32>,
    config: &'a TrainConfig,
}

impl<'a> Pair<'a> {
    fn both(&self) -> [&Pupil<'a>; 2] {
        [&self.upper, &self.lower]
    }
}

impl Trainee for Pair<'_> {
    fn garments(&self) -> Vec<String> {
        self.both().map(|pupil| pupil.fitted.kind.to_string()).to_vec()
    }
    fn step(&mut self, batch: &Batch, share: f64, rate: f64, measure: bool) -> Result<Vec<GarmentStep>> {
        let (upper, lower) = (&mut self.upper.learner, &mut self.lower.learner);
        let (mut u, mut l) = (upper.forward(batch)?, lower.forward(batch)?);
        let mut energy = vec![0.0; batch.frames.len()];
        let weight = self.config.weights.layering.at(share) / batch.frames.len() as f64;
        self.layering.add(
            Layer { positions: &u.positions, gradient: Some(&mut u.gradient) },
            Layer { positions: &l.positions, gradient: Some(&mut l.gradient) },
            weight,
            &mut energy,
        )?;
        upper.backward(&u)?;
        lower.backward(&l)?;
        // Both before either steps: a way back finds them as they were.
        Error::check_finite("gradient of the upper garment", &upper.gradient)?;
        Error::check_finite("gradient of the lower garment", &lower.gradient)?;
        let norms = [upper.step(rate, self.config.clip_norm)?, lower.step(rate, self.config.clip_norm)?];
        let layering = energy.iter().sum();
        let mut done = Vec::new();
        for ((pupil, pass), gradient_norm) in self.both().into_iter().zip([u, l]).zip(norms) {
            let measures = measure.then(|| pupil.measures(batch, &pass)).transpose()?;
            let mut energies = pass.energies;
            // What both have between them stands in the record of each.
            energies.push(("layering", layering));
            done.push(GarmentStep { energies, gradient_norm, measures });
        }
        Ok(done)
    }
    fn scheduled(&self, share: f64) -> Vec<(&'static str, f64)> {
        let layering = &self.config.weights.layering;
        if layering.is_constant() { Vec::new() } else { vec![("layering", layering.at(share))] }
    }
    fn fault(&self, batch: &Batch) -> Option<(String, Fault)> {
        let of = |pupil: &Pupil<'_>| Some((pupil.fitted.kind.to_string(), pupil.learner.fault(batch)?));
        self.both().into_iter().find_map(of)
    }
    fn snapshot(&self) -> Vec<LearnerState> {
        self.both().map(|pupil| pupil.learner.snapshot()).to_vec()
    }
    fn restore(&mut self, states: &[LearnerState]) -> Result<()> {
        Error::check_length("garments of a checkpoint", 2, states.len())?;
        self.upper.learner.restore(&states[0])?;
        self.lower.learner.restore(&states[1])
    }
    fn profile(&self) -> Vec<(&'static str, Duration)> {
        // Parts of both garments, summed.
        let mut sums = self.upper.learner.profile();
        for (part, time) in self.lower.learner.profile() {
            match sums.iter_mut().find(|(name, _)| *name == part) {
                Some((_, sum)) => *sum += time,
                None => sums.push((part, time)),
            }
        }
        sums
    }
    fn draw(&self, preview: &Preview<'_>) -> Result<Rgb> {
        let [upper, lower] = self.both().map(Pupil::trained);
        preview.draw(&[(self.upper.fitted, &upper), (self.lower.fitted, &lower)])
    }
}

/// Fine-tunes the nets; a subject with one garment, or no epochs, keeps its nets.
pub fn run(context: &Context<'_>, subject: &Subject, nets: &Nets) -> Result<Nets> {
    let settings = &context.config.finetune;
    if subject.garments.len() < 2 || settings.epochs == 0 {
        return Ok(nets.clone());
    }
    let config = &context.config.train;
    let scene = Scene::new(context, subject)?;
    let (motion, clips) = scene.named_motion(context)?;
    let names = FrameNames::new(clips, subject);
    let track = scene.scan_track(subject)?;
    let preview =
        (config.preview_every > 0).then(|| Preview::new(context, &scene, &motion, &track, &names)).transpose()?;
    let scans =
        subject.garments.iter().map(|g| scan_frames(context, subject, g, track.clone())).collect::<Result<Vec<_>>>()?;
    let mut pupils = Vec::new();
    for ((fitted, trained), scans) in subject.garments.iter().zip(&nets.garments).zip(&scans) {
        pupils.push(Pupil::new(context, &scene, fitted, trained.clone(), &motion, scans)?);
    }
    let count = pupils.len();
    let Ok([upper, lower]) = <[Pupil<'_>; 2]>::try_from(pupils) else {
        return Err(Error::Length { what: "garments to fine-tune".into(), expected: 2, got: count });
    };
    let layering = Layering::<f32>::new(&upper.learner.rest, &lower.learner.rest, settings.layering)?;
    let seed = context.config.run.seed.wrapping_mul(1000).wrapping_add(999);
    let mut order = Order::new(settings.epochs, |epoch| {
        if epoch % 2 == 0 {
            trainer::window_batches(&motion, config, settings.windows, seed, epoch as u64)
        } else {
            trainer::scan_batches(track.len(), config, seed, epoch as u64)
        }
    });
    let frames = [config.batch * config.window, config.batch.min(track.len())];
    let left = order.left(0);
    let mut pace = Pace::new([0, 1].map(|kind| Work { size: frames[kind] as f64, left: left[kind] }).to_vec());
    let mut pair = Pair { upper, lower, layering, config };
    let plan = Plan {
        context,
        name: "finetune",
        order,
        learning_rate: settings.learning_rate,
        names: &names,
        preview: preview.as_ref(),
        pace: &mut pace,
        kinds: [0, 1],
        part: [0.0, 1.0],
    };
    learn(&mut pair, plan)?;
    let mut out = nets.clone();
    for (trained, pupil) in out.garments.iter_mut().zip(pair.both()) {
        trained.parameters = pupil.learner.parameters.clone();
    }
    Ok(out)
}
