//! A run made again from what its folder says, and compared with it bit by bit.

use super::{Run, Summary};
use crate::artifact;
use crate::config::Config;
use crate::manifest::{CONFIG, Manifest, Program};
use crate::plugins::Plugins;
use caphy_core::{Error, Result};
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// What came of a replay.
#[derive(Debug, Serialize)]
pub struct Replayed {
    /// The run that was replayed.
    pub of: PathBuf,
    /// Where its repetition is.
    pub folder: PathBuf,
    /// Stages whose artifacts hold the same bits, in the order of their names.
    pub same: Vec<String>,
    /// Stages whose artifacts differ.
    pub other: Vec<String>,
    /// Input files that have changed since.
    pub inputs: Vec<String>,
    /// Files of results that differ or are in one folder only.
    pub files: Vec<String>,
    /// Number of files of results that are the same.
    pub same_files: usize,
    /// Whether another build of the program ran.
    pub another_program: bool,
    #[serde(skip)]
    /// What the repetition did.
    pub summary: Summary,
}

/// Folders of a run whose files are results; what lies beside them tells times and progress, too.
const RESULTS: [&str; 4] = ["scans", "truth", "pictures", "export"];

/// Runs the stages that a run folder has into another one, by default `RUN-replay`.
///
/// # Errors
/// Where the folder has no `run.json` or `config.toml`, and whatever running gives.
pub fn replay(of: &Path, out: Option<PathBuf>, plugins: &mut Plugins) -> Result<Replayed> {
    let manifest = Manifest::read(of)?;
    let path = of.join(CONFIG);
    let text = std::fs::read_to_string(&path).map_err(|e| Error::io(&path, "read", e))?;
    // Relative paths mean what they meant: libraries are found from there, too.
    let config = Config::parse_with(&manifest.base.join(CONFIG), &text, plugins).map_err(|error| match error {
        Error::Format { at, problem, remedy, .. } => Error::format(&path, at, problem, remedy),
        other => other,
    })?;
    let folder = out.unwrap_or_else(|| {
        let mut name = of.file_name().unwrap_or_default().to_os_string();
        name.push("-replay");
        of.with_file_name(name)
    });
    let there = |path: &Path| std::fs::canonicalize(path).ok();
    if folder.exists() && there(of) == there(&folder) {
        let problem = format!("{} is the run itself", folder.display());
        return Err(Error::config("--out", problem, "name another folder"));
    }
    // What another build left there would not be this one's repetition.
    let stale = Manifest::read(&folder).is_ok_and(|old| Program::running().is_ok_and(|now| now != old.program));
    let mut run = Run::of(config, &manifest.base, Some(folder.clone()))?;
    run.plan = run.plan.like(manifest.stages.keys())?;
    if stale {
        run.plan.all_again();
    }
    let summary = run.all()?;
    let again = Manifest::read(&folder)?;
    let content = |m: &Manifest, stage: &str| m.stages.get(stage).map(|s| s.content.clone());
    let report = |name: &&String| *name != "report";
    // The page tells how long everything took.
    let (same, other) = manifest
        .stages
        .keys()
        .filter(report)
        .cloned()
        .partition(|name| content(&manifest, name) == content(&again, name));
    let inputs = manifest.inputs.iter().filter(|(name, hash)| again.inputs.get(*name) != Some(*hash));
    let (before, after) = (results(of)?, results(&folder)?);
    let names = before.keys().chain(after.keys().filter(|name| !before.contains_key(*name)));
    let (equal, files): (Vec<String>, Vec<String>) =
        names.cloned().partition(|name| before.get(name) == after.get(name));
    Ok(Replayed {
        of: of.into(),
        folder,
        same,
        other,
        inputs: inputs.map(|(name, _)| name.clone()).collect(),
        files,
        same_files: equal.len(),
        another_program: manifest.program != again.program,
        summary,
    })
}

impl Replayed {
    /// Whether everything came out the same.
    pub fn is_same(&self) -> bool {
        self.other.is_empty() && self.files.is_empty()
    }

    /// What differs, as text.
    pub fn text(&self) -> String {
        let mut out = String::new();
        let mut line = |text: String| out.extend([text, "\n".into()]);
        for stage in &self.other {
            line(format!("{stage}: other bits"));
        }
        self.files.iter().for_each(|file| line(format!("{file}: other bits, or in one run only")));
        self.inputs.iter().for_each(|input| line(format!("input {input}: has changed since")));
        if self.another_program {
            line("Another build of caphy made the first run.".into());
        }
        let (stages, all) = (self.same.len(), self.same.len() + self.other.len());
        let files = self.same_files + self.files.len();
        line(format!("The same bits in {stages} of {all} stages and {} of {files} files.", self.same_files));
        out
    }
}

/// Hashes of result files by their names relative to the run folder.
fn results(folder: &Path) -> Result<BTreeMap<String, String>> {
    let mut found = BTreeMap::new();
    let mut open: Vec<PathBuf> = RESULTS.iter().map(|name| folder.join(name)).filter(|path| path.is_dir()).collect();
    while let Some(path) = open.pop() {
        for entry in std::fs::read_dir(&path).map_err(|e| Error::io(&path, "list", e))? {
            let path = entry.map_err(|e| Error::io(&path, "list", e))?.path();
            if path.is_dir() {
                open.push(path);
                continue;
            }
            let bytes = std::fs::read(&path).map_err(|e| Error::io(&path, "read", e))?;
            let name = path.strip_prefix(folder).unwrap_or(&path).to_string_lossy().into_owned();
            found.insert(name, artifact::hash(&bytes));
        }
    }
    Ok(found)
}
