//! Runs the stages in order, one artifact each; a stage whose inputs have not changed is not run again.

use crate::artifact;
use crate::config::{Config, PluginConfig, SubjectConfig};
use crate::files::ProjectFiles;
use crate::plugins::Plugins;
use crate::progress::Progress;
use crate::stage::{self, Context, StageOutput};
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
    ran: Vec<&'static str>,
    /// Held until the run is dropped: two processes in one folder would overwrite each other's checkpoints.
    _lock: std::fs::File,
}

/// What a run did.
#[derive(Debug)]
pub struct Summary {
    /// The run directory.
    pub folder: PathBuf,
    /// Stages that were run, the others were up to date.
    pub ran: Vec<&'static str>,
    /// The table of the evaluation, as text.
    pub table: String,
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
        let config = Config::read_with(config_path, plugins)?;
        let files = ProjectFiles::new(config_path.parent().unwrap_or(Path::new(".")));
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
        artifact::write_atomically(&folder.join("config.toml"), resolved.as_bytes())?;
        let timings = std::fs::read(folder.join("timings.json"))
            .ok()
            .and_then(|bytes| serde_json::from_slice(&bytes).ok())
            .unwrap_or_default();
        Ok(Run { config, files, folder, timings: Mutex::new(timings), ran: Vec::new(), _lock: lock })
    }

    /// Everything, from scans to the report.
    pub fn all(mut self) -> Result<Summary> {
        let c = serde_json::to_value(&self.config)
            .map_err(|e| Error::config("(whole file)", e.to_string(), "report this as a defect"))?;
        // Parts of the configuration by their dotted paths.
        let part = |paths: &[&str]| -> Vec<serde_json::Value> {
            paths.iter().map(|path| path.split('.').fold(&c, |value, name| &value[name]).clone()).collect()
        };
        self.config.check_files(&self.files)?;

        let scans = match &self.config.subject {
            SubjectConfig::Synthetic(synthetic) => {
                let synthetic = synthetic.clone();
                let key = part(&["subject", "body"]);
                let mut scans = self.stage("synth", &key, "", |cx| stage::synth::run(cx, &synthetic))?.0;
                for scan in &mut scans.list {
                    scan.path = self.folder.join(&scan.path);
                }
                scans
            }
            SubjectConfig::Scans(scans) => {
                let scans = scans.clone();
                stage::scan_list(&self.files, &scans)?
            }
        };
        let scan_hash = stage::hash_scans(&scans)?;

        // No fabric yet: another one must not cost another registration.
        let templates = ["styles", "resolution_m", "template", "weights"]
            .iter()
            .flat_map(|key| [format!("upper.{key}"), format!("lower.{key}")])
            .collect::<Vec<_>>();
        let templates: Vec<&str> = templates.iter().map(String::as_str).collect();
        let key = part(&[&["body", "segmenter", "views", "registration"][..], &templates].concat());
        let (subject, subject_hash) =
            self.stage("preprocess", &key, &scan_hash, |cx| stage::preprocess::run(cx, &scans))?;

        let key = part(&["upper", "lower", "body", "net", "motion", "train"]);
        let rounds = self.config.train.rounds;
        let (mut nets, mut hash) = self.stage("train", &key, &subject_hash, |cx| {
            stage::train::run(cx, &subject, &stage::train::Start::fresh(rounds))
        })?;
        let mut fabrics = Vec::new();
        for alternation in 0..self.config.optimise.alternations {
            let key = part(&["upper", "lower", "body", "net", "train", "optimise"]);
            let (name, again) = stage::alternation_names(alternation);
            let (estimate, estimate_hash) =
                self.stage(name, &key, &hash, |cx| stage::optimise::run(cx, &subject, &nets))?;
            let key = part(&["upper", "lower", "body", "net", "motion", "train", "optimise"]);
            let rounds = self.config.optimise.rounds;
            let start = stage::train::Start::from_estimate(&nets, &estimate, rounds);
            (nets, hash) = self.stage(again, &key, &estimate_hash, |cx| stage::train::run(cx, &subject, &start))?;
            fabrics.push(estimate);
        }
        let key = part(&["upper", "lower", "body", "net", "motion", "train", "finetune"]);
        let (avatar, avatar_hash) =
            self.stage("finetune", &key, &hash, |cx| stage::finetune::run(cx, &subject, &nets))?;

        let key = part(&["upper", "lower", "body", "net", "motion", "train", "finetune", "evaluate", "subject"]);
        let (scores, scores_hash) = self.stage("evaluate", &key, &avatar_hash, |cx| {
            stage::evaluate::run(cx, &subject, &nets, &avatar, &fabrics, &scans)
        })?;
        let key = part(&["body", "net", "motion.fps", "animate", "evaluate.penetration_m"]);
        let (film, film_hash) =
            self.stage("animate", &key, &avatar_hash, |cx| stage::animate::run(cx, &subject, &avatar))?;
        let (exported, export_hash) =
            self.stage("export", &key, &film_hash, |cx| stage::export::run(cx, &subject, &avatar, &film))?;

        let timings = self.timings();
        let inputs = stage::report::Inputs {
            scans: &scans,
            subject: &subject,
            fabrics: &fabrics,
            nets: &nets,
            scores: &scores,
            film: &film,
            exported: &exported.files,
            timings: &timings,
        };
        // The list of exported files says nothing of what is in them, so that the report looks at the film, too.
        let upstream = format!("{subject_hash}{hash}{scores_hash}{film_hash}{export_hash}{scan_hash}");
        self.stage("report", &part(&["run", "upper", "lower"]), &upstream, |cx| stage::report::run(cx, &inputs))?;
        Ok(Summary { folder: self.folder, ran: self.ran, table: scores.table() })
    }

    fn context<'a>(&'a self, stage: &'a str, key: &'a str, progress: &'a Progress) -> Context<'a> {
        let (config, files, folder, timings) = (&self.config, &self.files, &self.folder, &self.timings);
        Context { config, files, folder, stage, key, progress, timings }
    }

    /// Hashes of the files that a part of the configuration names: a stage runs again when a body or a clip has changed.
    fn input_hashes(&self, key: &[serde_json::Value]) -> Result<Vec<String>> {
        /// Keys of the configuration whose values are paths of input files.
        const PATHS: [&str; 4] = ["path", "skeleton", "mapping", "ground_truth"];
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
            let resolved = self.files.resolve(&path)?;
            if resolved.is_dir() {
                // Whatever lies there: a new file counts as a change, too.
                for file in self.files.all(&resolved)? {
                    let name = file.file_name().unwrap_or_default().to_string_lossy().into_owned();
                    hashes.push(name + &artifact::hash(&self.files.read(&file)?));
                }
            } else {
                hashes.push(artifact::hash(&self.files.read(&path)?));
            }
        }
        Ok(hashes)
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
    ) -> Result<(T, String)> {
        let inputs = self.input_hashes(key)?;
        let library = |l: &PluginConfig| Ok(artifact::hash(&self.files.read(&l.path)?));
        let libraries = self.config.plugin.iter().map(library).collect::<Result<Vec<String>>>()?;
        let material = serde_json::to_vec(&(
            name,
            env!("CARGO_PKG_VERSION"),
            self.config.run.seed,
            key,
            inputs,
            libraries,
            upstream,
        ))
        .map_err(|e| Error::config(name, e.to_string(), "report this as a defect"))?;
        let key = artifact::hash(&material);
        let path = self.folder.join(format!("{name}.caphy"));
        if let Some((value, content)) = artifact::load::<T>(&path, name, &key)?
            && value.files().iter().all(|f| self.folder.join(f).exists())
        {
            return Ok((value, content));
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
        Ok((value, content))
    }
}
