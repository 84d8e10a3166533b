//! The stages of a run, one file each, in the order of the paper's method section.
//!
//! Every stage is a function `run(&Context, inputs) -> Result<Output>`; its output is one artifact on disk.

pub mod animate;
pub mod compare;
pub mod dress;
pub mod evaluate;
pub mod export;
pub mod finetune;
pub mod optimise;
pub mod preprocess;
pub mod reference;
pub mod report;
pub mod scans;
mod split;
pub mod synth;
pub mod train;

use crate::artifact;
use crate::config::Config;
use crate::files::ProjectFiles;
use crate::progress::Progress;
use caphy_core::Result;
use caphy_core::material::MaterialModel;
use serde::{Deserialize, Serialize, de::DeserializeOwned};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Mutex;

/// What every stage gets besides its inputs.
pub struct Context<'a> {
    /// The experiment.
    pub config: &'a Config,
    /// Files named in it.
    pub files: &'a ProjectFiles,
    /// The run directory.
    pub folder: &'a Path,
    /// Name of the stage.
    pub stage: &'a str,
    /// Key of the stage's artifact: checkpoints of another key are not continued.
    pub key: &'a str,
    /// Where the stage says how far it is.
    pub progress: &'a Progress,
    /// Whether training measures where the time of its steps goes.
    pub profile: bool,
    /// Times that were measured, by name: they stay out of artifacts, which are the same bits in every run.
    pub timings: &'a Mutex<BTreeMap<String, f64>>,
}

impl Context<'_> {
    /// Records a measured time.
    pub fn time(&self, name: &str, value: f64) {
        if let Ok(mut timings) = self.timings.lock() {
            timings.insert(name.into(), value);
        }
    }
    /// Writes a file of the run directory, whole or not at all.
    pub fn write(&self, name: &str, bytes: &[u8]) -> Result<()> {
        artifact::write_atomically(&self.folder.join(name), bytes)
    }
}

/// The artifact of a stage.
pub trait StageOutput: Serialize + DeserializeOwned {
    /// Files that the stage wrote beside its artifact, relative to the run directory: when one is gone, the stage runs
    /// again.
    fn files(&self) -> Vec<PathBuf> {
        Vec::new()
    }
}

/// One scan on disk.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct ScanFile {
    /// The file's stem.
    pub name: String,
    /// Where it is; of a generated scan relative to the run directory, so that the artifact says the same wherever that is.
    pub path: PathBuf,
    /// Kept for evaluation: no stage before it learns shape, template, fabric or net from it.
    pub held_out: bool,
    /// Hash of the file where caphy made it; none for a user's.
    #[serde(default)]
    pub content: Option<String>,
}

/// The scans of a subject.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Scans {
    /// In the order of their names.
    pub list: Vec<ScanFile>,
    /// What is known about a generated subject; only evaluation and report look at it.
    pub truth: Option<crate::synth::Truth>,
}

impl StageOutput for Scans {
    fn files(&self) -> Vec<PathBuf> {
        self.list.iter().map(|s| s.path.clone()).collect()
    }
}

/// Names of the artifacts of one alternation between Eq. 10 and training: as many as anyone will ever want.
pub fn alternation_names(alternation: usize) -> (&'static str, &'static str) {
    const NAMES: [(&str, &str); 8] = [
        ("optimise", "train-optimised"),
        ("optimise-2", "train-optimised-2"),
        ("optimise-3", "train-optimised-3"),
        ("optimise-4", "train-optimised-4"),
        ("optimise-5", "train-optimised-5"),
        ("optimise-6", "train-optimised-6"),
        ("optimise-7", "train-optimised-7"),
        ("optimise-8", "train-optimised-8"),
    ];
    NAMES[alternation.min(NAMES.len() - 1)]
}

/// The configured material of a garment with other parameter values, where there are any.
pub fn material(
    table: &crate::plugins::PluginTable,
    key: &str,
    parameters: Option<&[f64]>,
) -> Result<Box<dyn MaterialModel>> {
    let configured = table.material(key)?;
    match parameters {
        Some(values) => configured.with_parameters(values),
        None => Ok(configured),
    }
}
