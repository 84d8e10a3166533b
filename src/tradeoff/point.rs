//! One point: a subject, nets trained on it, what they cost and how far they are from the solver.

use super::cost::{Stopwatch, load, peak_mib, reset_peak};
use super::error::Errors;
use super::knobs::{self, Acts, is_of_subject};
use super::preprocessed::Preprocessed;
use super::search::{Mesh, Method};
use super::table::{Offer, Row, SolverRow};
use super::yardstick::{Yardstick, scene_of, settings, solve};
use super::{Tradeoff, begin};
use crate::artifact;
use crate::config::{AnimateConfig, Config, Setting};
use crate::files::ProjectFiles;
use crate::garment::FittedGarment;
use crate::inference::{Play, Player, play};
use crate::plugins::Plugins;
use crate::runner::input_hashes;
use crate::scene::Scene;
use crate::stage::preprocess::{BODIES, Subject};
use crate::stage::train::Nets;
use crate::variants::anew;
use caphy_core::{Error, Result};
use caphy_garment::solver::SolverSettings;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// What is known of a trained point.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Measured {
    /// Vertices of all garments.
    pub vertices: usize,
    /// Parameters of all nets.
    pub parameters: usize,
    /// Training steps of all nets.
    pub steps: usize,
    /// Processor time of training [s].
    pub train_s: f64,
    /// Wall time of training [s].
    pub train_wall_s: f64,
    /// Processor time of a training step, mean over all nets' steps [ms].
    pub step_ms: f64,
    /// Time of a frame of all garments: net and skinning, on one thread, the least of many plays [ms].
    pub frame_ms: f64,
    /// Highest memory of the process while it trained [MiB]; the sweep's own is in it.
    pub peak_mib: Option<f64>,
    /// Processes that the machine had running or waiting after training, mean of a minute.
    pub load: Option<f64>,
    /// Errors on the motion of the sweep.
    pub error: Errors,
    /// Errors on other motion.
    pub check: Errors,
    /// Energy of all garments in batches of windows, by the share of training that is done: what training minimises [J].
    pub curve: Vec<(f64, f64)>,
}

/// Raised when a point is measured otherwise.
const VERSION: u32 = 2;
/// The same of the solver.
const SOLVER_VERSION: u32 = 3;

/// Makes points.
pub(super) struct Bench<'a> {
    pub(super) sweep: &'a Tradeoff,
    pub(super) plugins: &'a Plugins,
}

/// Processor time for which frames are played to measure one [s].
const LEAST: f64 = 0.3;

impl Bench<'_> {
    fn config(&self, settings: &[Setting]) -> Result<Config> {
        let all = [&self.sweep.common[..], settings].concat();
        Config::read_set(&self.sweep.path, &all, &mut anew(self.plugins)?)
    }
    fn folder(&self, name: &str) -> PathBuf {
        self.sweep.folder.join(name)
    }
    /// A folder's name for settings: the same for the same configuration, however it is written.
    fn name(&self, kind: &str, config: &Config) -> Result<String> {
        let mut value = serde_json::to_value(config)
            .map_err(|e| Error::config("(whole file)", e.to_string(), "report this as a defect"))?;
        // What is swept does not change a point.
        if let Some(table) = value.as_object_mut() {
            ["tradeoff", "animate", "compare", "evaluate"].iter().for_each(|key| drop(table.remove(*key)));
            if let Some(run) = table.get_mut("run").and_then(|r| r.as_object_mut()) {
                run.remove("out");
            }
        }
        Ok(format!("{kind}-{}", &artifact::hash(value.to_string().as_bytes())[..12]))
    }
    fn read_subject(&self, name: &str) -> Result<(Subject, String)> {
        let stage = self.sweep.subject_stage();
        let path = self.folder(name).join(format!("{stage}.caphy"));
        let subject: Subject = artifact::open(&path, stage)?;
        let bytes = std::fs::read(&path).map_err(|e| Error::io(&path, "read", e))?;
        Ok((subject, artifact::hash(&bytes)))
    }
    /// The subject as the experiment has it, made in the folder that all others begin with.
    pub(super) fn first_subject(&self) -> Result<Preprocessed> {
        let none = || Preprocessed { processor_s: 0.0, wall_s: 0.0, wrong_labels: None, body_mm: 0.0, skipped: 0 };
        if self.sweep.subject_stage() == "dress" {
            self.sweep.open_run("subject", &[], self.plugins)?.until("dress")?.all()?;
            return Ok(none());
        }
        Ok(self.timed_preprocess("subject", &[], None)?.0)
    }
    /// The subject as the experiment has it.
    pub(super) fn own_subject(&self) -> Result<Subject> {
        Ok(self.read_subject("subject")?.0)
    }
    /// Name of the folder with the subject of a point; made if it is not there.
    fn subject_folder(&self, set: &[Setting]) -> Result<String> {
        let own: Vec<Setting> = set.iter().filter(|s| is_of_subject(s)).cloned().collect();
        if own.is_empty() {
            return Ok("subject".into());
        }
        let name = self.name("subject", &self.config(&own)?)?;
        begin(&self.folder("subject"), &self.folder(&name))?;
        self.sweep.open_run(&name, &own, self.plugins)?.until(self.sweep.subject_stage())?.all()?;
        Ok(name)
    }
    /// The subject of a point with the hash of its artifact.
    pub(super) fn subject_of(&self, set: &[Setting]) -> Result<(Subject, String)> {
        self.read_subject(&self.subject_folder(set)?)
    }

    /// Preprocessing with other settings, timed as a whole, and whether it was done now; compared with what it gave with the
    /// settings `against`, the experiment's own where there are none.
    pub(super) fn preprocess(&self, set: &[Setting], against: Option<&[Setting]>) -> Result<(Preprocessed, bool)> {
        let folder = |set: &[Setting]| self.name("preprocess", &self.config(set)?);
        let (name, other) = (folder(set)?, against.map_or(Ok("subject".into()), folder)?);
        begin(&self.folder("subject"), &self.folder(&name))?;
        self.timed_preprocess(&name, set, Some(&other))
    }

    /// Preprocesses in a folder, unless that was measured; what a measurement that was interrupted left is thrown away, so that
    /// the time is that of a whole one.
    fn timed_preprocess(&self, name: &str, set: &[Setting], against: Option<&str>) -> Result<(Preprocessed, bool)> {
        let (folder, stage) = (self.folder(name), self.sweep.subject_stage());
        let path = folder.join("measured.caphy");
        let own = against.map(|of| self.read_subject(of)).transpose()?;
        let key = artifact::hash(
            format!("{}{:?}", self.name("", &self.config(set)?)?, own.as_ref().map(|o| &o.1)).as_bytes(),
        );
        let results = folder.join(format!("{stage}.caphy"));
        if results.exists()
            && let Some((value, _)) = artifact::load::<Preprocessed>(&path, "preprocessed", &key)?
        {
            return Ok((value, false));
        }
        remove(&results)?;
        remove(&folder.join(BODIES))?;
        let labelled = folder.join("labelled");
        if labelled.exists() {
            std::fs::remove_dir_all(&labelled).map_err(|e| Error::io(&labelled, "remove", e))?;
        }
        let run = self.sweep.open_run(name, set, self.plugins)?.until(stage)?;
        let watch = Stopwatch::start();
        run.all()?;
        let spent = watch.read();
        let (subject, _) = self.read_subject(name)?;
        let value =
            Preprocessed::new(&self.sweep.config, &self.sweep.files, &subject, own.as_ref().map(|o| &o.0), spent)?;
        artifact::save(&path, "preprocessed", &key, &value)?;
        Ok((value, true))
    }

    /// Trains and measures a point, unless that is done; `repeat` changes the seed. Also whether it was done now.
    pub(super) fn row(
        &self,
        knob: &str,
        level: &str,
        acts: Acts,
        set: &[Setting],
        repeat: usize,
        yardstick: &Yardstick,
    ) -> Result<(Row, bool)> {
        let subject_folder = self.subject_folder(set)?;
        let config = self.config(set)?;
        let name = format!("{}-{repeat}", self.name("point", &config)?);
        let folder = self.folder(&name);
        let (subject, subject_hash) = self.read_subject(&subject_folder)?;
        let inputs = contents(&self.sweep.files, &config.motion)?;
        let key = artifact::hash(format!("{VERSION}{}{subject_hash}{name}{inputs}", yardstick.hash).as_bytes());
        let path = folder.join("measured.caphy");
        let fixed = knobs::fixed(&config)?.iter().map(Setting::to_string).collect();
        let row = |measured| Row::new(knob, level, acts, set, fixed, repeat, measured);
        if let Some((measured, _)) = artifact::load::<Measured>(&path, "measured", &key)? {
            return Ok((row(measured), false));
        }
        begin(&self.folder(&subject_folder), &folder)?;
        // A whole training, or its time would be that of a part.
        remove(&folder.join("train.caphy"))?;
        for garment in &subject.garments {
            remove(&folder.join(format!("checkpoint-{}.caphy", garment.kind)))?;
        }
        let run = self.sweep.open_run(&name, &[set, &self.reseeded(repeat)?].concat(), self.plugins)?.only("train")?;
        reset_peak();
        let watch = Stopwatch::start();
        run.all()?;
        let (spent, peak_mib) = (watch.read(), peak_mib());
        let nets: Nets = artifact::open(&folder.join("train.caphy"), "train")?;
        let scene = scene_of(&self.sweep.files, &config, &subject)?;
        let steps = subject.garments.len()
            * config.train.rounds
            * config.train.steps_of_round(subject.training_scans().count());
        let measured = Measured {
            vertices: subject.garments.iter().map(|g| g.mesh.vertices.len()).sum(),
            parameters: nets.garments.iter().map(|g| g.parameters.len()).sum(),
            steps,
            train_s: spent.processor_s,
            train_wall_s: spent.wall_s,
            step_ms: 1e3 * spent.processor_s / steps.max(1) as f64,
            frame_ms: frame_ms(&config, &scene, &subject, &nets, yardstick)?,
            peak_mib,
            load: load(),
            error: self.errors(&config, &scene, &subject, &nets, yardstick, 0)?,
            check: self.errors(&config, &scene, &subject, &nets, yardstick, 1)?,
            curve: curve(&nets),
        };
        artifact::save(&path, "measured", &key, &measured)?;
        Ok((row(measured), true))
    }

    /// Settings of a repeat: another seed of training; scans, bodies and templates stay.
    fn reseeded(&self, repeat: usize) -> Result<Vec<Setting>> {
        if repeat == 0 {
            return Ok(Vec::new());
        }
        Ok(vec![Setting::new("train.seed", (repeat as i64).into())?])
    }

    fn errors(
        &self,
        config: &Config,
        scene: &Scene,
        subject: &Subject,
        nets: &Nets,
        yardstick: &Yardstick,
        motion: usize,
    ) -> Result<Errors> {
        let played = &yardstick.motions[motion];
        // From the clip's beginning: the net carries what it has seen.
        let track = scene.track(&played.poses)?;
        let mut all = Vec::new();
        for (index, (garment, trained)) in subject.garments.iter().zip(&nets.garments).enumerate() {
            let frames = play(garment, trained, &config.net, &track, Play::Clip)?;
            let own = &self.sweep.config;
            all.push(yardstick.judge(own, scene, garment, index, motion, &frames[played.compared..], None)?);
        }
        Ok(Errors::mean(&all))
    }

    /// The solver as a way to animate: its time per frame and its error; and whether it was computed now.
    pub(super) fn solver(&self, method: &Method, yardstick: &Yardstick) -> Result<(SolverRow, bool)> {
        let base = knobs::Base { config: &self.sweep.config, own_rounds: 1, scans: None };
        let set = match method.mesh {
            Mesh::Coarse => knobs::coarsest(&base)?,
            Mesh::Own => Vec::new(),
            Mesh::Fine => knobs::finest(&base)?,
        };
        let name = self.subject_folder(&set)?;
        let (subject, hash) = self.read_subject(&name)?;
        let key = artifact::hash(format!("{SOLVER_VERSION}{}{hash}{method:?}", yardstick.hash).as_bytes());
        let path = self.folder("solver").join(format!("{}.caphy", &key[..12]));
        if let Some((row, _)) = artifact::load::<SolverRow>(&path, "solver", &key)? {
            return Ok((row, false));
        }
        let config = &self.sweep.config;
        let scene = scene_of(&self.sweep.files, config, &subject)?;
        let vertices = subject.garments.iter().map(|g| g.mesh.vertices.len()).sum();
        let (frame_ms, unconverged, error) = self.played_by(method, &scene, &subject, yardstick, 0)?;
        let mut row = SolverRow { method: method.name.into(), vertices, frame_ms, unconverged, error, offer: None };
        if let (true, Some(tolerance)) = (method.offered, method.tolerance_n) {
            let (.., check) = self.played_by(method, &scene, &subject, yardstick, 1)?;
            let templates = knobs::fixed(&self.config(&set)?)?.into_iter().filter(is_of_subject);
            let solver = Setting::new("animate.solver", unusual(&settings(config, tolerance))?.into())?;
            row.offer = Some(Offer { set: templates.chain([solver]).map(|s| s.to_string()).collect(), check });
        }
        artifact::save(&path, "solver", &key, &row)?;
        Ok((row, true))
    }

    /// A method along one of the motions: processor time of a frame of all garments [ms], frames that did not converge of how many,
    /// error.
    fn played_by(
        &self,
        method: &Method,
        scene: &Scene,
        subject: &Subject,
        yardstick: &Yardstick,
        motion: usize,
    ) -> Result<(f64, [usize; 2], Errors)> {
        let (config, played) = (&self.sweep.config, &yardstick.motions[motion]);
        let one = |(index, garment): (usize, &FittedGarment)| -> Result<(f64, [usize; 2], Errors)> {
            let (frames, energy, seconds, unconverged) = match method.tolerance_n {
                Some(tolerance) => {
                    let solved = solve(config, scene, garment, played, settings(config, tolerance), None)?;
                    (solved.frames, Some(solved.energy_j), solved.spent.processor_s, solved.unconverged)
                }
                None => {
                    let track = scene.track(played.judged())?;
                    let watch = Stopwatch::start();
                    let (mut least, mut skinned) = (f64::INFINITY, Vec::new());
                    while watch.read().processor_s < LEAST {
                        let play = Stopwatch::start();
                        skinned = track.transforms.iter().map(|t| garment.skinned(t)).collect::<Result<_>>()?;
                        least = least.min(play.read().wall_s);
                    }
                    // Per simulated frame, as the others.
                    (skinned, None, least * played.simulated().len() as f64 / played.judged().len() as f64, [0; 2])
                }
            };
            let error = yardstick.judge(config, scene, garment, index, motion, &frames, energy)?;
            Ok((seconds, unconverged, error))
        };
        // One after the other where they are timed.
        let all: Vec<_> = match motion {
            0 => subject.garments.iter().enumerate().map(one).collect(),
            _ => subject.garments.par_iter().enumerate().map(one).collect(),
        };
        let all = all.into_iter().collect::<Result<Vec<_>>>()?;
        let seconds: f64 = all.iter().map(|a| a.0).sum();
        let unconverged = [0, 1].map(|k| all.iter().map(|a| a.1[k]).sum());
        let errors: Vec<Errors> = all.into_iter().map(|a| a.2).collect();
        Ok((1e3 * seconds / played.simulated().len() as f64, unconverged, Errors::mean(&errors)))
    }
}

/// What settings of a solver say that `[animate] solver = {}` does not.
fn unusual(settings: &SolverSettings) -> Result<toml::Table> {
    let table = |settings: &SolverSettings| {
        toml::Table::try_from(settings)
            .map_err(|e| Error::config("animate.solver", e.to_string(), "report this as a defect"))
    };
    let usual = table(&AnimateConfig::solver_defaults())?;
    Ok(table(settings)?.into_iter().filter(|(key, value)| usual.get(key) != Some(value)).collect())
}

/// Hashes of the files that a part of a configuration names, one after the other.
pub(super) fn contents(files: &ProjectFiles, part: &impl Serialize) -> Result<String> {
    let value = serde_json::to_value(part)
        .map_err(|e| Error::config("(whole file)", e.to_string(), "report this as a defect"))?;
    Ok(input_hashes(files, &[value])?.into_iter().map(|input| input.1).collect())
}

fn remove(path: &Path) -> Result<()> {
    if path.exists() { std::fs::remove_file(path).map_err(|e| Error::io(path, "remove", e)) } else { Ok(()) }
}

/// Time of one frame of all garments [ms]: the least over many plays of the clip, each garment on one thread. A play takes less than
/// a tick of the processor's clock, and what else runs on the machine only makes it longer.
fn frame_ms(config: &Config, scene: &Scene, subject: &Subject, nets: &Nets, yardstick: &Yardstick) -> Result<f64> {
    let track = scene.track(&yardstick.motions[0].poses)?;
    let mut total = 0.0;
    for (garment, trained) in subject.garments.iter().zip(&nets.garments) {
        let mut player = Player::new(garment, trained, &config.net)?;
        let watch = Stopwatch::start();
        let mut least = f64::INFINITY;
        while watch.read().processor_s < LEAST {
            let play = Stopwatch::start();
            for frame in 0..track.len() {
                let previous = frame.checked_sub(1).map(|before| &track.poses[before]);
                std::hint::black_box(player.frame(&track.poses[frame], previous, &track.transforms[frame])?);
            }
            least = least.min(play.read().wall_s);
        }
        total += 1e3 * least / track.len() as f64;
    }
    Ok(total)
}

/// Total energy in batches of windows by the share of training that is done, summed over garments, which draw alike many.
fn curve(nets: &Nets) -> Vec<(f64, f64)> {
    let mut out: Vec<(f64, f64)> = Vec::new();
    for garment in &nets.garments {
        let windows: Vec<_> = garment.curve.iter().filter(|p| !p.scans).collect();
        let last = garment.curve.last().map_or(1, |p| p.step + 1) as f64;
        for (i, point) in windows.iter().enumerate() {
            let energy: f64 = point.energies.iter().map(|e| e.1).sum();
            match out.get_mut(i) {
                Some(sum) => sum.1 += energy,
                None => out.push(((point.step + 1) as f64 / last, energy)),
            }
        }
    }
    let shortest = nets.garments.iter().map(|g| g.curve.iter().filter(|p| !p.scans).count()).min().unwrap_or(0);
    out.truncate(shortest);
    out
}
