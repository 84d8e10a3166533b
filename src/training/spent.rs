//! How long a training's steps, pictures and checkpoints took: what a forecast multiplies by their numbers.

use crate::stage::Context;
use crate::trainer::BatchKind;
use std::collections::BTreeMap;

/// What is told apart, in the words of `timings.json`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Part {
    Step(BatchKind),
    Picture,
    Checkpoint,
    /// Everything from the first step to the last.
    All,
}

impl Part {
    fn words(self) -> &'static str {
        match self {
            Part::Step(BatchKind::Windows) => "a step of windows",
            Part::Step(BatchKind::Still) => "a step of poses",
            Part::Step(BatchKind::Scans) => "a step of scans",
            Part::Picture => "a picture",
            Part::Checkpoint => "a checkpoint",
            Part::All => "all steps",
        }
    }
    /// The mean time of a part [s], as a training of this stage and name told it; 0 for what it did not have.
    pub(crate) fn of(self, timings: &BTreeMap<String, f64>, stage: &str, name: &str) -> f64 {
        timings.get(&self.key(stage, name)).copied().unwrap_or(0.0)
    }
    fn key(self, stage: &str, name: &str) -> String {
        format!("{stage}, {name}: {}", self.words())
    }
}

/// Times of one training [s].
#[derive(Default)]
pub(super) struct Spent(Vec<(Part, Vec<f64>)>);

impl Spent {
    pub(super) fn add(&mut self, part: Part, seconds: f64) {
        match self.0.iter_mut().find(|(p, _)| *p == part) {
            Some((_, times)) => times.push(seconds),
            None => self.0.push((part, vec![seconds])),
        }
    }
    /// Tells the means. The first of a kind fills memory and caches: it counts only where it is the only one.
    pub(super) fn tell(&self, context: &Context<'_>, name: &str) {
        for (part, times) in &self.0 {
            let times = if times.len() > 1 { &times[1..] } else { times };
            context.time(&part.key(context.stage, name), times.iter().sum::<f64>() / times.len() as f64);
        }
    }
}
