//! Runs the stages in order, one artifact each; a stage whose inputs have not changed is not run again.

mod difference;
mod replay;

pub use difference::{Changed, Difference, compare};
pub use replay::{Replayed, replay};

use crate::artifact;
use crate::config::{Choice, Config, PluginConfig, Setting, SubjectConfig};
use crate::files::ProjectFiles;
use crate::forecast;
use crate::manifest::{CONFIG, Manifest, Program, StageRecord};
use crate::physics::solver_forces;
use crate::plan::ScenePlan;
use crate::plugins::Plugins;
use crate::progress::{self, Progress};
use crate::scene::Scene;
use crate::stage::preprocess::Subject;
use crate::stage::train::Nets;
use crate::stage::{self, Context, Scans, StageOutput};
use caphy_core::files::Files;
use caphy_core::{Error, Result};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Mutex;

/// A run directory with its configuration, held by one process.
pub struct Run {
    config: Config,
    files: ProjectFiles,
    folder: PathBuf,
    timings: Mutex<BTreeMap<String, f64>>,
    plan: ScenePlan,
    dry: bool,
    profile: bool,
    /// Whether a plan also tells times.
    timed: bool,
    /// Scans and subject, where a plan found them there.
    known: Option<(Scans, Subject)>,
    ran: Vec<&'static str>,
    fabrics: Vec<stage::optimise::Estimates>,
    manifest: Manifest,
    /// Held until the run is dropped: two processes in one folder would overwrite each other's checkpoints.
    _lock: std::fs::File,
}

/// What a run did.
#[derive(Debug, Default)]
pub struct Summary {
    /// The run directory.
    pub folder: PathBuf,
    /// Stages that were run, the others were up to date.
    pub ran: Vec<&'static str>,
    /// Tables of what was measured, as text.
    pub table: String,
    /// Milliseconds per step by garment and part, of trainings of this run.
    pub profile: Vec<(String, f64)>,
    /// What was found about the fabrics, one per alternation.
    pub fabrics: Vec<stage::optimise::Estimates>,
    /// The report, unless the run was narrowed to another stage.
    pub report: Option<PathBuf>,
}

/// Why the stages end early.
enum Halt {
    Failed(Error),
    /// A dry run does not run this stage.
    NotDone(&'static str),
}

impl From<Error> for Halt {
    fn from(error: Error) -> Self {
        Self::Failed(error)
    }
}

/// What names of measured parts of steps begin with.
pub(crate) const PROFILE: &str = "step of ";
/// Keys of `[train]` that change no bit of what is learnt.
const LOOKING: [&str; 4] = ["metrics_every", "measure_every", "preview_every", "keep_bodies_mib"];

/// Tables of the configuration that preprocessing reads, besides the garments'.
const PREPROCESSING: [&str; 5] = ["body", "segmenter", "views", "registration", "templates"];

/// Estimated fabrics of trained nets: what a simulation depends on of them.
fn fabric_hash(nets: Option<&Nets>) -> String {
    let fabrics: Vec<&Vec<f64>> = nets.iter().flat_map(|n| &n.garments).filter_map(|g| g.material.as_ref()).collect();
    artifact::hash(format!("{fabrics:?}").as_bytes())
}

impl Run {
    /// Opens (or makes) the run directory of a configuration file.
    ///
    /// `out` replaces the file's `run.out`.
    pub fn open(config_path: &Path, out: Option<PathBuf>) -> Result<Run> {
        Self::open_with(config_path, out, &mut Plugins::new()?)
    }

    /// As [`Run::open`], with libraries that were loaded before.
    pub fn open_with(config_path: &Path, out: Option<PathBuf>, plugins: &mut Plugins) -> Result<Run> {
        Self::open_set(config_path, out, &[], plugins)
    }

    /// As [`Run::open_with`], with settings that take the place of the file's own.
    pub fn open_set(
        config_path: &Path,
        out: Option<PathBuf>,
        settings: &[Setting],
        plugins: &mut Plugins,
    ) -> Result<Run> {
        let config = Config::read_set(config_path, settings, plugins)?;
        let mut run = Self::of(config, config_path.parent().unwrap_or(Path::new(".")), out)?;
        let chosen = run.config.choice.iter().flat_map(|choice| choice.set.iter().cloned());
        run.manifest.set = settings.iter().map(Setting::to_string).chain(chosen).collect();
        Ok(run)
    }

    /// Opens (or makes) the run directory of a configuration whose relative paths start from `base`.
    fn of(config: Config, base: &Path, out: Option<PathBuf>) -> Result<Run> {
        let files = ProjectFiles::new(base);
        let folder = match out {
            Some(out) => out,
            None => files.resolve(&config.run.out)?,
        };
        std::fs::create_dir_all(&folder).map_err(|e| Error::io(&folder, "create", e))?;
        let lock_path = folder.join("lock");
        let lock = std::fs::File::create(&lock_path).map_err(|e| Error::io(&lock_path, "create", e))?;
        if lock.try_lock().is_err() {
            return Err(Error::config(
                "run.out",
                format!("{} is in use by another run", folder.display()),
                "wait for it, or choose another folder",
            ));
        }
        let resolved = toml::to_string(&config)
            .map_err(|e| Error::config("(whole file)", e.to_string(), "report this as a defect"))?;
        let path = folder.join(CONFIG);
        if !std::fs::read(&path).is_ok_and(|old| old == resolved.as_bytes()) {
            artifact::write_atomically(&path, resolved.as_bytes())?;
        }
        let timings = std::fs::read(folder.join("timings.json"))
            .ok()
            .and_then(|bytes| serde_json::from_slice(&bytes).ok())
            .unwrap_or_default();
        let plan = ScenePlan::new(&config);
        let base = if base.as_os_str().is_empty() { Path::new(".") } else { base };
        let mut manifest = Manifest {
            program: Program::running()?,
            base: std::path::absolute(base).map_err(|e| Error::io(base, "find", e))?,
            seed: config.run.seed,
            set: Vec::new(),
            inputs: BTreeMap::new(),
            stages: BTreeMap::new(),
        };
        // A narrowed run leaves what it does not look at as it was.
        if let Ok(old) = Manifest::read(&folder) {
            manifest.stages = old.stages.into_iter().filter(|(name, _)| plan.has(name)).collect();
            manifest.inputs = old.inputs;
        }
        Ok(Run {
            config,
            files,
            folder,
            timings: Mutex::new(timings),
            plan,
            dry: false,
            profile: false,
            timed: false,
            known: None,
            ran: Vec::new(),
            fabrics: Vec::new(),
            manifest,
            _lock: lock,
        })
    }

    /// The resolved configuration.
    pub fn config(&self) -> &Config {
        &self.config
    }

    /// Narrows the run to one stage and what it needs.
    ///
    /// # Errors
    /// As [`ScenePlan::only`].
    pub fn only(mut self, target: &str) -> Result<Self> {
        self.plan = self.plan.only(target)?;
        Ok(self)
    }

    /// Narrows the run to one stage and all before it.
    ///
    /// # Errors
    /// As [`ScenePlan::only`].
    pub fn until(mut self, target: &str) -> Result<Self> {
        self.plan = self.plan.until(target)?;
        Ok(self)
    }

    /// Has one stage, and whatever uses its results, run again even where it is up to date.
    ///
    /// # Errors
    /// As [`ScenePlan::only`].
    pub fn from(mut self, target: &str) -> Result<Self> {
        self.plan = self.plan.from(target)?;
        Ok(self)
    }

    /// Measures where the time of training steps goes: see [`Summary::profile`].
    pub fn profiled(mut self) -> Self {
        self.profile = true;
        self
    }

    /// Has the plan say how long stages will take: see [`crate::forecast`].
    pub fn timed(mut self) -> Self {
        self.timed = true;
        self
    }

    /// Everything, from scans to the report.
    pub fn all(mut self) -> Result<Summary> {
        if let Some(choice) = &self.config.choice {
            progress::say("budget", &choice.text());
        }
        let told = self.stages(false).map_err(|halt| match halt {
            Halt::Failed(error) => error,
            Halt::NotDone(stage) => Error::unsupported(stage, "a run that only plans"),
        })?;
        self.manifest.write(&self.folder)?;
        let report = self.plan.has("report").then(|| self.folder.join("report.html"));
        let profile = self.timings().into_iter().filter(|(name, _)| name.starts_with(PROFILE)).collect();
        Ok(Summary { folder: self.folder, ran: self.ran, table: told, profile, fabrics: self.fabrics, report })
    }

    /// What the run would do: nothing but the dressing of a subject without scans, which takes seconds, is run; with
    /// [`Run::timed`], stages are tried beside it.
    ///
    /// # Errors
    /// As [`Run::all`], for what is looked at.
    pub fn plan(mut self) -> Result<ScenePlan> {
        match self.stages(true) {
            Ok(_) | Err(Halt::NotDone(_)) => {}
            Err(Halt::Failed(error)) => return Err(error),
        }
        if self.timed && self.plan.stages.iter().any(|s| s.off.is_none() && !s.done) {
            let known = self.known.take();
            self.plan.time = Some(forecast::forecast(&self.config, &self.files, &self.folder, &self.plan, known)?);
        }
        Ok(self.plan)
    }

    /// All stages that are on, in their order; returns the tables of what was measured. `dry`: up to the first that is not done.
    fn stages(&mut self, dry: bool) -> std::result::Result<String, Halt> {
        self.dry = dry;
        let mut c = serde_json::to_value(&self.config)
            .map_err(|e| Error::config("(whole file)", e.to_string(), "report this as a defect"))?;
        // What only looks at training does not change it.
        if let Some(train) = c["train"].as_object_mut() {
            LOOKING.iter().for_each(|key| drop(train.remove(*key)));
        }
        // Parts of the configuration by their dotted paths.
        let part = |paths: &[&str]| -> Vec<serde_json::Value> {
            paths.iter().map(|path| path.split('.').fold(&c, |value, name| &value[name]).clone()).collect()
        };
        self.config.check_files(&self.files)?;
        // A garment's own tables, without its fabric.
        let templates = ["styles", "resolution_m", "template", "weights", "style", "mass_g"]
            .iter()
            .flat_map(|key| [format!("upper.{key}"), format!("lower.{key}")])
            .collect::<Vec<_>>();
        let templates: Vec<&str> = templates.iter().map(String::as_str).collect();

        let worn = self.worn();

        let mut scans = Scans { list: Vec::new(), truth: None };
        let (subject, subject_hash) = match &self.config.subject {
            SubjectConfig::Dressed(dressed) => {
                let dressed = dressed.clone();
                let key = part(&[&["body", "subject"][..], &templates].concat());
                // The plan needs the garments.
                self.dry = false;
                let out = self.stage("dress", &key, "", |cx| stage::dress::run(cx, &dressed))?;
                self.dry = dry;
                out
            }
            SubjectConfig::Synthetic(synthetic) => {
                let synthetic = synthetic.clone();
                // Poses of a clip depend on the rate that it is resampled to.
                let key = part(&["subject", "body", "motion.fps"]);
                scans = self.stage("synth", &key, "", |cx| stage::synth::run(cx, &synthetic))?.0;
                for scan in &mut scans.list {
                    // Absolute: what reads scans puts relative paths behind the configuration's folder.
                    let path = self.folder.join(&scan.path);
                    scan.path = std::path::absolute(&path).map_err(|e| Error::io(&path, "find", e))?;
                }
                if !self.plan.has("preprocess") {
                    return Ok(String::new());
                }
                let key = part(&[&PREPROCESSING, &templates[..]].concat());
                self.preprocess(&[key, worn].concat(), &scans)?
            }
            SubjectConfig::Scans(folder) => {
                scans = stage::scans::scan_list(&self.files, folder, self.config.run.seed)?;
                if dry {
                    let segmenter =
                        self.config.segmenter.as_ref().and_then(|s| s.table()["type"].as_str()).unwrap_or_default();
                    self.plan.scans = stage::scans::inspect(&self.files, folder, segmenter, &scans);
                }
                // The folder's name and roles of scans are in the hash of the scans.
                let frame = ["subject.units", "subject.up", "subject.starts"];
                let key = part(&[&PREPROCESSING[..], &frame, &templates].concat());
                self.preprocess(&[key, worn].concat(), &scans)?
            }
        };
        if dry {
            self.describe(&subject)?;
            self.known = self.timed.then(|| (scans.clone(), subject.clone()));
        }

        let key = part(&["upper", "lower", "body", "net", "motion", "train"]);
        let rounds = self.config.train.rounds;
        let mut trained: Option<(Nets, String)> = None;
        if self.plan.has("train") {
            let start = stage::train::Start::fresh(rounds);
            trained = Some(self.stage("train", &key, &subject_hash, |cx| stage::train::run(cx, &subject, &start))?);
        }
        let mut fabrics = Vec::new();
        for alternation in 0..self.config.optimise.alternations {
            let (name, again) = stage::alternation_names(alternation);
            let Some((nets, hash)) = trained.as_ref().filter(|_| self.plan.has(name)) else { continue };
            let (nets, hash) = (nets.clone(), hash.clone());
            let key = part(&["upper", "lower", "body", "net", "train", "optimise", "finetune.layering.order"]);
            let (estimate, estimate_hash) =
                self.stage(name, &key, &hash, |cx| stage::optimise::run(cx, &subject, &nets, &scans))?;
            if self.plan.has(again) {
                let key = part(&["upper", "lower", "body", "net", "motion", "train", "optimise"]);
                let rounds = self.config.optimise.rounds;
                let start = stage::train::Start::from_estimate(&nets, &estimate, rounds);
                trained = Some(self.stage(again, &key, &estimate_hash, |cx| stage::train::run(cx, &subject, &start))?);
            }
            fabrics.push(estimate);
        }
        self.fabrics.clone_from(&fabrics);
        let mut tables: String = fabrics.iter().map(stage::optimise::Estimates::table).collect();
        let mut compared = None;
        let mut compared_hash = String::new();
        if self.plan.has("reference") {
            // Nothing of the nets: another training is compared with the same simulation.
            let key = part(&["upper", "lower", "body", "compare", "motion.fps", "train.contact", "train.weights"]);
            let fitted = subject_hash.clone() + &fabric_hash(trained.as_ref().map(|t| &t.0));
            let materials = trained.as_ref().map(|t| t.0.clone());
            let (reference, reference_hash) =
                self.stage("reference", &key, &fitted, |cx| stage::reference::run(cx, &subject, materials.as_ref()))?;
            if let Some((nets, hash)) = trained.as_ref().filter(|_| self.plan.has("compare")) {
                let (nets, upstream) = (nets.clone(), format!("{hash}{reference_hash}"));
                let key = part(&["upper", "lower", "body", "net", "compare", "train.contact", "train.weights"]);
                let (comparison, hash) =
                    self.stage("compare", &key, &upstream, |cx| stage::compare::run(cx, &subject, &nets, &reference))?;
                tables.push_str(&comparison.table());
                (compared, compared_hash) = (Some(comparison), hash);
            }
        }
        let Some((nets, hash)) = trained else { return Ok(tables) };
        let (mut avatar, mut avatar_hash) = (nets.clone(), hash.clone());
        if self.plan.has("finetune") {
            let key = part(&["upper", "lower", "body", "net", "motion", "train", "finetune"]);
            (avatar, avatar_hash) =
                self.stage("finetune", &key, &hash, |cx| stage::finetune::run(cx, &subject, &nets))?;
        }
        // Labels and poses may stay as they were where colours or triangles of a scan have changed.
        let scan_hash = stage::scans::hash_scans(&self.files, &scans)?;
        let (mut scores, mut scores_hash) = (None, String::new());
        if self.plan.has("evaluate") {
            let key = part(&["upper", "lower", "body", "net", "motion", "train", "finetune", "evaluate", "subject"]);
            let (measured, hash) = self.stage("evaluate", &key, &format!("{avatar_hash}{scan_hash}"), |cx| {
                stage::evaluate::run(cx, &subject, &nets, &avatar, &fabrics, &scans)
            })?;
            tables.insert_str(0, &measured.table());
            (scores, scores_hash) = (Some(measured), hash);
        }
        let (mut film, mut film_hash) = (None, avatar_hash.clone());
        if self.plan.has("animate") {
            let key = part(&["body", "net", "motion.fps", "animate", "evaluate.penetration_m"]);
            let (played, hash) =
                self.stage("animate", &key, &avatar_hash, |cx| stage::animate::run(cx, &subject, &avatar))?;
            (film, film_hash) = (Some(played), hash);
        }
        if !self.plan.has("export") {
            return Ok(tables);
        }
        let (exported, export_hash) =
            self.stage("export", &part(&["finetune"]), &format!("{film_hash}{scan_hash}"), |cx| {
                stage::export::run(cx, &subject, &avatar, film.as_ref(), &scans)
            })?;
        if !self.plan.has("report") {
            return Ok(tables);
        }
        let timings = self.timings();
        let inputs = stage::report::Inputs {
            scans: &scans,
            subject: &subject,
            fabrics: &fabrics,
            nets: &nets,
            scores: scores.as_ref(),
            comparison: compared.as_ref(),
            film: film.as_ref(),
            exported: &exported,
            timings: &timings,
        };
        // The list of exported files says nothing of what is in them, so that the report looks at the film, too.
        let chosen = self.config.choice.as_ref().map(Choice::text).unwrap_or_default();
        let upstream =
            format!("{subject_hash}{hash}{scores_hash}{compared_hash}{film_hash}{export_hash}{scan_hash}{chosen}");
        self.stage("report", &part(&["run", "upper", "lower"]), &upstream, |cx| stage::report::run(cx, &inputs))?;
        Ok(tables)
    }

    /// What choosing a template depends on besides its garment's own tables: who covers whom; and where styles are worn, in which fabric and
    /// by which forces.
    fn worn(&self) -> Vec<serde_json::Value> {
        let order = format!("{:?}", self.config.finetune.layering.order);
        let forces = format!("{:?}", solver_forces(&self.config.train));
        let of_garments = self.config.garments().map(|(_, _, garment)| match garment.worn {
            0 => "by skinning".to_string(),
            worn => format!("{worn} in {} by {forces}", garment.worn_in().text()),
        });
        std::iter::once(order).chain(of_garments).map(serde_json::Value::from).collect()
    }

    fn preprocess(&mut self, key: &[serde_json::Value], scans: &Scans) -> std::result::Result<(Subject, String), Halt> {
        let hash = stage::scans::hash_scans(&self.files, scans)?;
        for scan in &scans.list {
            let content = artifact::hash(stage::scans::hash_scan(&self.files, scan)?.as_bytes());
            self.manifest.inputs.insert(format!("scan {}", scan.name), content);
        }
        self.stage("preprocess", key, &hash, |cx| stage::preprocess::run(cx, scans))
    }

    /// What the plan says once the subject is there.
    fn describe(&mut self, subject: &Subject) -> Result<()> {
        let progress = Progress::silent();
        let context = self.context("plan", "", &progress);
        let scene = Scene::new(&context, subject)?;
        let motion = scene.windows(&context)?;
        let mut plan = self.plan.clone();
        plan.describe(&self.config, &scene, subject, motion)?;
        self.plan = plan;
        Ok(())
    }

    fn context<'a>(&'a self, stage: &'a str, key: &'a str, progress: &'a Progress) -> Context<'a> {
        let (config, files, folder, timings) = (&self.config, &self.files, &self.folder, &self.timings);
        Context { config, files, folder, stage, key, progress, profile: self.profile, timings }
    }

    fn timings(&self) -> BTreeMap<String, f64> {
        self.timings.lock().map(|t| t.clone()).unwrap_or_default()
    }
    /// Checkpoints of a finished stage are of no further use; one that cannot be removed does no harm, as its key is old.
    fn drop_checkpoints(&self) {
        let entries = std::fs::read_dir(&self.folder).into_iter().flatten().flatten();
        for entry in entries.filter(|e| e.file_name().to_string_lossy().starts_with("checkpoint-")) {
            std::fs::remove_file(entry.path()).ok();
        }
    }

    /// One stage: loads its artifact when the key still matches and its files are there, else runs it.
    fn stage<T: StageOutput>(
        &mut self,
        name: &'static str,
        key: &[serde_json::Value],
        upstream: &str,
        run: impl FnOnce(&Context<'_>) -> Result<T>,
    ) -> std::result::Result<(T, String), Halt> {
        let inputs = input_hashes(&self.files, key)?;
        let library = |l: &PluginConfig| Ok((l.path.display().to_string(), artifact::hash(&self.files.read(&l.path)?)));
        let libraries = self.config.plugin.iter().map(library).collect::<Result<Vec<_>>>()?;
        let material = serde_json::to_vec(&(
            name,
            env!("CARGO_PKG_VERSION"),
            self.config.run.seed,
            key,
            inputs.iter().map(|input| &input.1).collect::<Vec<_>>(),
            libraries.iter().map(|library| &library.1).collect::<Vec<_>>(),
            upstream,
        ))
        .map_err(|e| Error::config(name, e.to_string(), "report this as a defect"))?;
        let key = artifact::hash(&material);
        let path = self.folder.join(format!("{name}.caphy"));
        self.manifest.inputs.extend(inputs.into_iter().chain(libraries));
        if !self.plan.is_again(name)
            && let Some((value, content)) = artifact::load::<T>(&path, name, &key)?
            && value.files().iter().all(|f| self.folder.join(f).exists())
        {
            self.finished(name, key, &content);
            return Ok((value, content));
        }
        if self.dry {
            return Err(Halt::NotDone(name));
        }
        let progress = Progress::start(name);
        let value = run(&self.context(name, &key, &progress))?;
        let content = artifact::save(&path, name, &key, &value)?;
        let seconds = progress.finish();
        self.context(name, &key, &progress).time(name, seconds);
        let timings = serde_json::to_vec_pretty(&self.timings())
            .map_err(|e| Error::config(name, e.to_string(), "report this as a defect"))?;
        artifact::write_atomically(&self.folder.join("timings.json"), &timings)?;
        self.drop_checkpoints();
        self.ran.push(name);
        self.finished(name, key, &content);
        self.manifest.write(&self.folder)?;
        Ok((value, content))
    }

    /// Notes that a stage's artifact is up to date.
    fn finished(&mut self, name: &str, key: String, content: &str) {
        self.plan.done(name);
        self.manifest.stages.insert(name.into(), StageRecord { key, content: content.into() });
    }
}

/// Paths and hashes of the files that a part of the configuration names: a stage runs again when a body or a clip has changed.
pub(crate) fn input_hashes(files: &ProjectFiles, key: &[serde_json::Value]) -> Result<Vec<(String, String)>> {
    /// Keys of the configuration whose values are paths of input files.
    const PATHS: [&str; 5] = ["path", "skeleton", "mapping", "ground_truth", "starts"];
    fn named(value: &serde_json::Value, out: &mut Vec<PathBuf>) {
        match value {
            serde_json::Value::Array(list) => list.iter().for_each(|v| named(v, out)),
            serde_json::Value::Object(map) => {
                for (key, value) in map {
                    match value.as_str() {
                        Some(path) if PATHS.contains(&key.as_str()) => out.push(path.into()),
                        _ => named(value, out),
                    }
                }
            }
            _ => {}
        }
    }
    let mut paths = Vec::new();
    key.iter().for_each(|value| named(value, &mut paths));
    let mut hashes = Vec::new();
    for path in paths {
        let resolved = files.resolve(&path)?;
        if resolved.is_dir() {
            // Whatever lies there: a new file counts as a change, too.
            for file in files.all(&path)? {
                let name = file.file_name().unwrap_or_default().to_string_lossy().into_owned();
                let content = artifact::hash(&files.read(&file)?);
                hashes.push((path.join(&name).display().to_string(), name + &content));
            }
        } else {
            hashes.push((path.display().to_string(), artifact::hash(&files.read(&path)?)));
        }
    }
    Ok(hashes)
}
