//! How long the stages of an experiment will take on this machine: each is tried on two scans and a few batches, at the
//! experiment's own sizes, and what that took is multiplied by the experiment's numbers.

use crate::config::{Config, EstimatorConfig, HeldOut, Inner, SubjectConfig, TrainConfig};
use crate::files::ProjectFiles;
use crate::plan::ScenePlan;
use crate::progress::{Progress, duration};
use crate::stage::preprocess::{self, Subject, SubjectScan};
use crate::stage::train::{Nets, Start};
use crate::stage::{self, Context, Scans, alternation_names, evaluate};
use crate::trainer::BatchKind;
use crate::training::Part;
use caphy_core::{Error, Result};
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::time::Instant;

/// Scans that stages are tried on: a single one may be an easy one.
const SCANS: usize = 2;
/// Batches of each kind that nets are tried on; the first is not counted.
const BATCHES: usize = 5;
/// Most seconds of a clip that are played, and simulated, to try that.
const PLAYED_S: f64 = 4.0;
const SIMULATED_S: f64 = 0.2;
/// Folder in the run folder that stages are tried in; it is removed again.
const FOLDER: &str = "trial";

/// Estimated times.
#[derive(Debug, Clone, Default, Serialize)]
pub struct Forecast {
    /// Seconds of each stage that has something to do.
    pub seconds: BTreeMap<&'static str, f64>,
    /// Stages whose time cannot be told before, and why.
    pub unknown: BTreeMap<&'static str, &'static str>,
    /// Seconds that trying took.
    pub tried_s: f64,
    /// Threads that were used.
    pub threads: usize,
}

impl Forecast {
    /// Seconds of all stages that are known.
    pub fn total(&self) -> f64 {
        self.seconds.values().sum()
    }
    /// As text.
    pub fn text(&self) -> String {
        let mut out = format!("Time: about {}", duration(self.total()));
        for (stage, why) in &self.unknown {
            out += &format!(", and {stage}, of which nobody knows before: {why}");
        }
        out + &format!(
            "\n  estimated           tried on {SCANS} scans and {BATCHES} batches of each kind on {} threads, in {}; what else the machine does \
             then and now counts\n",
            self.threads,
            duration(self.tried_s)
        )
    }
}

/// Numbers of scans to learn from and held out.
#[derive(Debug, Clone, Copy)]
struct Count {
    training: usize,
    held: usize,
}

/// Stages are tried here.
struct Trial<'a> {
    config: &'a Config,
    small: Config,
    files: &'a ProjectFiles,
    folder: PathBuf,
    plan: &'a ScenePlan,
    count: Count,
    timings: Mutex<BTreeMap<String, f64>>,
    progress: Progress,
    out: Forecast,
}

impl Drop for Trial<'_> {
    fn drop(&mut self) {
        std::fs::remove_dir_all(&self.folder).ok();
    }
}

/// Time of `all` things that are done beside each other, by the time of `tried` of them [s].
fn side_by_side(seconds: f64, tried: usize, all: usize, threads: usize) -> f64 {
    if all == 0 {
        return 0.0;
    }
    let each = seconds / tried.div_ceil(threads).max(1) as f64;
    each * (all as f64 / threads as f64).max(1.0)
}

/// Numbers of parts of one net's training of so many rounds.
fn parts_of_training(config: &TrainConfig, rounds: usize, scans: usize) -> [(Part, usize); 5] {
    let batches = |count: usize| count.div_ceil(config.batch);
    let steps = rounds * config.steps_of_round(scans);
    [
        (Part::Step(BatchKind::Windows), rounds * batches(config.windows)),
        (Part::Step(BatchKind::Still), rounds * batches(config.still_poses)),
        (Part::Step(BatchKind::Scans), rounds * config.scan_epochs * batches(scans)),
        (Part::Picture, pictures(config, rounds)),
        (Part::Checkpoint, steps.div_ceil(config.checkpoint_every)),
    ]
}

/// The same of fine-tuning, whose epochs are of windows and of scans in turn.
fn parts_of_finetuning(config: &Config, scans: usize) -> [(Part, usize); 4] {
    let (train, epochs) = (&config.train, config.finetune.epochs);
    let windows = epochs.div_ceil(2) * config.finetune.windows.div_ceil(train.batch);
    let poses = epochs / 2 * scans.div_ceil(train.batch);
    [
        (Part::Step(BatchKind::Windows), windows),
        (Part::Step(BatchKind::Scans), poses),
        (Part::Picture, pictures(train, epochs)),
        (Part::Checkpoint, (windows + poses).div_ceil(train.checkpoint_every)),
    ]
}

fn pictures(config: &TrainConfig, rounds: usize) -> usize {
    if config.preview_every == 0 { 0 } else { rounds.div_ceil(config.preview_every) }
}

/// How many there are of both.
fn count(config: &Config, files: &ProjectFiles) -> Result<Count> {
    let held: Vec<bool> = match &config.subject {
        SubjectConfig::Dressed(_) => Vec::new(),
        SubjectConfig::Synthetic(s) => stage::synth::roles(s, config.run.seed)?.into_iter().map(|r| r.1).collect(),
        SubjectConfig::Scans(s) => {
            stage::scans::scan_list(files, s, config.run.seed)?.list.into_iter().map(|f| f.held_out).collect()
        }
    };
    let count = held.iter().filter(|h| **h).count();
    Ok(Count { training: held.len() - count, held: count })
}

/// The experiment with few scans and steps.
fn small(config: &Config) -> Config {
    let mut small = config.clone();
    if let SubjectConfig::Synthetic(s) = &mut small.subject {
        (s.scans, s.held_out) = (SCANS, HeldOut::Names(Vec::new()));
    }
    let train = &mut small.train;
    train.windows = BATCHES * train.batch;
    train.still_poses = if train.still_poses > 0 { BATCHES * train.batch } else { 0 };
    train.scan_epochs = if train.scan_epochs > 0 { BATCHES } else { 0 };
    (train.measure_every, train.checkpoint_every) = (0, usize::MAX);
    (small.finetune.epochs, small.finetune.windows) = (2 * BATCHES, train.batch);
    small.evaluate.solver_floor = false;
    if let Some(animate) = &mut small.animate {
        animate.seconds = animate.seconds.min(PLAYED_S);
    }
    if let Some(compare) = &mut small.compare {
        compare.seconds = compare.seconds.min(SIMULATED_S);
    }
    small
}

/// The first scans of a subject, to learn from; the same ones again and again, until there are `fill`.
fn few(subject: &Subject, fill: usize) -> Subject {
    let first: Vec<SubjectScan> =
        subject.scans.iter().take(SCANS).map(|s| SubjectScan { held_out: false, ..s.clone() }).collect();
    let count = if first.is_empty() { 0 } else { fill.max(first.len()) };
    Subject { scans: first.into_iter().cycle().take(count).collect(), ..subject.clone() }
}

/// Tries the stages that a plan has and that are not done. `known`: scans and subject, where they are there.
///
/// # Errors
/// What stages give.
pub(crate) fn forecast(
    config: &Config,
    files: &ProjectFiles,
    folder: &Path,
    plan: &ScenePlan,
    known: Option<(Scans, Subject)>,
) -> Result<Forecast> {
    let started = Instant::now();
    let folder = std::path::absolute(folder.join(FOLDER)).map_err(|e| Error::io(folder, "find", e))?;
    // Of a forecast that was killed.
    std::fs::remove_dir_all(&folder).ok();
    let mut trial = Trial {
        config,
        small: small(config),
        files,
        folder,
        plan,
        count: count(config, files)?,
        timings: Mutex::default(),
        progress: Progress::start("forecast"),
        out: Forecast { threads: rayon::current_num_threads(), ..Forecast::default() },
    };
    trial.all(known)?;
    let mut out = std::mem::take(&mut trial.out);
    out.tried_s = started.elapsed().as_secs_f64();
    trial.progress.finish();
    Ok(out)
}

impl Trial<'_> {
    /// Whether a stage has something to do.
    fn to_do(&self, stage: &str) -> bool {
        self.plan.stages.iter().any(|s| s.name == stage && s.off.is_none() && !s.done)
    }
    /// What a stage makes of the small experiment, and how long that takes [s].
    fn of<T>(&self, stage: &'static str, run: impl FnOnce(&Context<'_>) -> Result<T>) -> Result<(T, f64)> {
        self.progress.note(&format!("trying {stage}"));
        let silent = Progress::silent();
        let context = Context {
            config: &self.small,
            files: self.files,
            folder: &self.folder,
            stage,
            key: FOLDER,
            progress: &silent,
            profile: false,
            timings: &self.timings,
        };
        let started = Instant::now();
        let made = run(&context)?;
        Ok((made, started.elapsed().as_secs_f64()))
    }
    /// Times that stages told [s].
    fn told(&self) -> BTreeMap<String, f64> {
        self.timings.lock().map(|t| t.clone()).unwrap_or_default()
    }
    fn part(&self, name: &str) -> f64 {
        self.told().get(name).copied().unwrap_or(0.0)
    }
    /// Time of so many scans side by side, by the time of those that were tried [s].
    fn scans(&self, seconds: f64, tried: usize, all: usize) -> f64 {
        side_by_side(seconds, tried, all, self.out.threads)
    }

    /// All stages, in their order.
    fn all(&mut self, known: Option<(Scans, Subject)>) -> Result<()> {
        let is_known = known.is_some();
        let (scans, subject) = match known {
            Some(known) => known,
            None => match self.subject()? {
                Some(made) => made,
                None => return Ok(()),
            },
        };
        if !self.plan.has("train") {
            return Ok(());
        }
        // A batch of scans takes as long as it is large.
        let fill = self.count.training.min(self.config.train.batch);
        let pupils = if is_known { subject.clone() } else { few(&subject, fill) };
        let tried = few(&subject, 0);
        let (nets, avatar) = self.nets(&pupils, &tried, &scans)?;
        self.measured(&tried, &scans, &nets, &avatar)?;
        self.moved(&tried, &scans, &nets, &avatar)
    }

    /// A subject from few scans; none where the plan ends before it.
    fn subject(&mut self) -> Result<Option<(Scans, Subject)>> {
        let Count { training, held } = self.count;
        let scans = match &self.small.subject {
            SubjectConfig::Synthetic(synthetic) => {
                let (mut scans, seconds) = self.of("synth", |cx| stage::synth::run(cx, synthetic))?;
                if self.to_do("synth") {
                    let seconds = self.scans(seconds, SCANS, training + held);
                    self.out.seconds.insert("synth", seconds);
                }
                scans.list.iter_mut().for_each(|scan| scan.path = self.folder.join(&scan.path));
                scans
            }
            SubjectConfig::Scans(folder) => {
                let mut scans = stage::scans::scan_list(self.files, folder, self.config.run.seed)?;
                scans.list.retain(|scan| !scan.held_out);
                scans.list.truncate(SCANS);
                scans
            }
            // The plan has dressed it.
            SubjectConfig::Dressed(_) => return Ok(None),
        };
        if !self.plan.has("preprocess") {
            return Ok(None);
        }
        let (subject, seconds) = self.of("preprocess", |cx| preprocess::run(cx, &scans))?;
        let tried = scans.list.len();
        let [labels, bodies] = [preprocess::SCANS_TIME, preprocess::BODIES_TIME].map(|name| self.part(name));
        // A held-out scan's pose is searched for once more when the body is known.
        let of_scans = self.scans(labels, tried, training + held)
            + self.scans(bodies, tried, training)
            + self.scans(labels + bodies, tried, held);
        self.out.seconds.insert("preprocess", of_scans + seconds - labels - bodies);
        Ok(Some((scans, subject)))
    }

    /// Nets before and after fine-tuning.
    fn nets(&mut self, pupils: &Subject, tried: &Subject, scans: &Scans) -> Result<(Nets, Nets)> {
        let (config, training) = (self.config, self.count.training);
        let names: Vec<String> = pupils.garments.iter().map(|g| g.kind.to_string()).collect();
        let (nets, seconds) = self.of("train", |cx| stage::train::run(cx, pupils, &Start::fresh(1)))?;
        let told = self.told();
        // What a training does before its first step takes as long in all of them.
        let beginning = seconds - names.iter().map(|name| Part::All.of(&told, "train", name)).sum::<f64>();
        let of_rounds = |rounds: usize| {
            let parts = parts_of_training(&config.train, rounds, training);
            let of =
                |name: &String| parts.iter().map(|(part, n)| *n as f64 * part.of(&told, "train", name)).sum::<f64>();
            beginning + names.iter().map(of).sum::<f64>()
        };
        if self.to_do("train") {
            self.out.seconds.insert("train", of_rounds(config.train.rounds));
        }
        for alternation in 0..config.optimise.alternations {
            let (name, again) = alternation_names(alternation);
            match &config.optimise.estimator {
                _ if !self.to_do(name) => {}
                EstimatorConfig::Alternation(a) if a.inner == Inner::Net => {
                    let (_, seconds) = self.of(name, |cx| stage::optimise::run(cx, tried, &nets, scans))?;
                    self.out.seconds.insert(name, seconds * training as f64 / tried.scans.len().max(1) as f64);
                }
                _ => {
                    self.out.unknown.insert(name, "a fit ends when it has converged");
                }
            }
            if self.to_do(again) {
                self.out.seconds.insert(again, of_rounds(config.optimise.rounds));
            }
        }
        if !self.to_do("finetune") {
            return Ok((nets.clone(), nets));
        }
        let (avatar, seconds) = self.of("finetune", |cx| stage::finetune::run(cx, pupils, &nets))?;
        let told = self.told();
        let of = |part: Part| part.of(&told, "finetune", "finetune");
        let steps: f64 = parts_of_finetuning(config, training).iter().map(|(part, n)| *n as f64 * of(*part)).sum();
        self.out.seconds.insert("finetune", seconds - of(Part::All) + steps);
        Ok((nets, avatar))
    }

    /// Evaluation, and comparison with the solver.
    fn measured(&mut self, tried: &Subject, scans: &Scans, nets: &Nets, avatar: &Nets) -> Result<()> {
        let config = self.config;
        if self.to_do("evaluate") && config.evaluate.solver_floor {
            self.out.unknown.insert("evaluate", "the solver of `evaluate.solver_floor` ends when it has converged");
        } else if self.to_do("evaluate") {
            let run = |cx: &Context<'_>| evaluate::run(cx, tried, nets, avatar, &[], scans);
            let (_, seconds) = self.of("evaluate", run)?;
            let of_scans = self.part(evaluate::SCANS_TIME);
            let all = self.scans(of_scans, tried.scans.len(), self.count.training + self.count.held);
            self.out.seconds.insert("evaluate", seconds - of_scans + all);
        }
        let (Some(whole), Some(small)) = (&config.compare, self.small.compare.as_ref().map(|c| c.seconds)) else {
            return Ok(());
        };
        let times = whole.seconds / small;
        if self.to_do("reference") || self.to_do("compare") {
            let (reference, seconds) = self.of("reference", |cx| stage::reference::run(cx, tried, Some(nets)))?;
            if self.to_do("reference") {
                self.out.seconds.insert("reference", seconds * times);
            }
            if self.to_do("compare") {
                let (_, seconds) = self.of("compare", |cx| stage::compare::run(cx, tried, nets, &reference))?;
                self.out.seconds.insert("compare", seconds * times);
            }
        }
        Ok(())
    }

    /// The avatar in motion, and its files.
    fn moved(&mut self, tried: &Subject, scans: &Scans, nets: &Nets, avatar: &Nets) -> Result<()> {
        let avatar = if self.plan.has("finetune") { avatar } else { nets };
        let (mut film, mut times) = (None, 1.0);
        if let (Some(whole), Some(small)) = (&self.config.animate, self.small.animate.as_ref().map(|a| a.seconds))
            && (self.to_do("animate") || self.to_do("export"))
        {
            // A clip may end before.
            let (played, seconds) = self.of("animate", |cx| stage::animate::run(cx, tried, avatar))?;
            let is_cut = played.clip.duration() >= 0.9 * small;
            times = if is_cut { whole.seconds / small } else { 1.0 };
            if self.to_do("animate") {
                self.out.seconds.insert("animate", seconds * times);
            }
            film = Some(played);
        }
        if self.to_do("export") {
            let (_, seconds) = self.of("export", |cx| stage::export::run(cx, tried, avatar, film.as_ref(), scans))?;
            self.out.seconds.insert("export", seconds * times);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_are_as_many_as_a_run_makes() {
        let text = include_str!("../tests/all/tiny.toml");
        let config = Config::parse(Path::new("tiny.toml"), text).unwrap();
        // Per round 3 batches of windows, 1 of single poses, 4 of the two scans.
        let parts = parts_of_training(&config.train, 3, 2).map(|p| p.1);
        assert_eq!(parts, [9, 3, 12, 1, 5]);
        assert_eq!(parts[..3].iter().sum::<usize>(), 3 * config.train.steps_of_round(2));
        // 6 epochs: three of 4 batches of windows, three of the scans.
        assert_eq!(parts_of_finetuning(&config, 2).map(|p| p.1), [12, 3, 2, 3]);
        assert_eq!(pictures(&TrainConfig { preview_every: 0, ..config.train.clone() }, 3), 0);
        let count = count(&config, &ProjectFiles::new(".")).unwrap();
        assert_eq!((count.training, count.held), (2, 1));
    }

    #[test]
    fn scans_side_by_side_take_turns() {
        // Two on two threads take as long as one.
        assert_eq!(side_by_side(3.0, 2, 10, 2), 15.0);
        assert_eq!(side_by_side(3.0, 2, 10, 1), 15.0);
        assert_eq!(side_by_side(3.0, 2, 10, 16), 3.0);
        assert_eq!(side_by_side(3.0, 2, 0, 2), 0.0);
        assert_eq!(side_by_side(3.0, 1, 1, 8), 3.0);
    }
}
