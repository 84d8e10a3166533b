//! `run.json`: what a run folder was made of, beside its resolved `config.toml`.

use crate::artifact::{self, write_atomically};
use caphy_core::{Error, Result};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Name of the file.
const FILE: &str = "run.json";
/// Name of the resolved configuration beside it.
pub const CONFIG: &str = "config.toml";

/// Program, seed, inputs and stages of a run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Manifest {
    /// The program that ran last.
    pub program: Program,
    /// Folder that relative paths of the configuration start from, absolute.
    pub base: PathBuf,
    /// Seed of everything random.
    pub seed: u64,
    /// Settings that took the place of the file's own, as `key=value`; `config.toml` holds them already.
    pub set: Vec<String>,
    /// Hashes of input files, by their paths as configured; scans by their names.
    pub inputs: BTreeMap<String, String>,
    /// Stages whose artifacts are there, by their names.
    pub stages: BTreeMap<String, StageRecord>,
}

/// Which code ran.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Program {
    /// Version of caphy.
    pub version: String,
    /// Hash of the program's file: another build has another one.
    pub hash: String,
}

/// What identifies a stage's result.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct StageRecord {
    /// Hash of everything that it depends on.
    pub key: String,
    /// Hash of what it left.
    pub content: String,
}

impl Program {
    /// The one that is running.
    ///
    /// # Errors
    /// [`Error::Io`] where the system does not show it.
    pub fn running() -> Result<Self> {
        // Linux keeps the program that runs, even where a new build has taken the place of its file.
        let kept = std::fs::read("/proc/self/exe");
        let bytes = kept.or_else(|_| {
            let at = std::env::current_exe().map_err(|e| Error::io("the running program", "find", e))?;
            std::fs::read(&at).map_err(|e| Error::io(&at, "read", e))
        })?;
        Ok(Self { version: env!("CARGO_PKG_VERSION").into(), hash: artifact::hash(&bytes) })
    }
}

impl Manifest {
    /// Of a run folder.
    ///
    /// # Errors
    /// [`Error::Io`] where there is none, [`Error::Format`] for one that is damaged.
    pub fn read(folder: &Path) -> Result<Self> {
        let path = folder.join(FILE);
        let bytes = std::fs::read(&path).map_err(|e| Error::io(&path, "read", e))?;
        serde_json::from_slice(&bytes).map_err(|e| {
            let at = format!("line {}", e.line());
            Error::format(&path, at, e.to_string(), "delete it and run the experiment again: what is done is kept")
        })
    }

    /// Writes it, unless the file says the same already.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn write(&self, folder: &Path) -> Result<()> {
        let path = folder.join(FILE);
        let mut text = serde_json::to_string_pretty(self)
            .map_err(|e| Error::numerics(FILE, e.to_string(), "report this as a defect"))?;
        text.push('\n');
        if std::fs::read(&path).is_ok_and(|old| old == text.as_bytes()) {
            return Ok(());
        }
        write_atomically(&path, text.as_bytes())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn manifests_survive_and_damage_is_named() {
        let folder = tempfile::tempdir().unwrap();
        assert!(Manifest::read(folder.path()).unwrap_err().to_string().contains("run.json"));
        let record = StageRecord { key: "k".into(), content: "c".into() };
        let manifest = Manifest {
            program: Program::running().unwrap(),
            base: "/somewhere".into(),
            seed: 7,
            set: vec!["train.rounds=3".into()],
            inputs: BTreeMap::from([("a.npz".to_string(), "h".to_string())]),
            stages: BTreeMap::from([("train".to_string(), record)]),
        };
        manifest.write(folder.path()).unwrap();
        assert_eq!(Manifest::read(folder.path()).unwrap(), manifest);
        assert_eq!(manifest.program, Program::running().unwrap());
        std::fs::write(folder.path().join("run.json"), "{").unwrap();
        let said = Manifest::read(folder.path()).unwrap_err().to_string();
        assert!(said.contains("run.json") && said.contains("delete it"), "{said}");
    }
}
