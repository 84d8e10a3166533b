//! A configuration in a folder of its own, and what its runs leave there.

use caphy::artifact::{self, Header};
use caphy::runner::{Run, Summary};
use caphy_core::Result;
use serde::de::DeserializeOwned;
use std::collections::BTreeMap;
use std::io::Write;
use std::path::{Path, PathBuf};
use tempfile::TempDir;

/// The whole road in some seconds.
pub(crate) const TINY: &str = include_str!("tiny.toml");

/// A text with some of its parts replaced; each must occur.
pub(crate) fn edited(text: &str, edits: &[(&str, &str)]) -> String {
    edits.iter().fold(text.to_string(), |text, (old, new)| {
        assert!(text.contains(old), "the text has no `{old}`");
        text.replacen(old, new, 1)
    })
}

/// [`TINY`] on the scans of a folder beside the configuration.
pub(crate) fn tiny_on_scans(folder: &str, held_out: &[&str]) -> String {
    let (before, rest) = TINY.split_once("[subject]").expect("a subject");
    let (_, after) = rest.split_once("[body]").expect("a body");
    format!("{before}[subject]\ntype = \"scans\"\nfolder = \"{folder}\"\nheld_out = {held_out:?}\n\n[body]{after}")
}

/// A configuration file and its run folder, removed at the end.
pub(crate) struct Experiment {
    pub(crate) folder: TempDir,
}

impl Experiment {
    pub(crate) fn new(config: &str) -> Experiment {
        let experiment = Experiment { folder: tempfile::tempdir().expect("a temporary folder") };
        experiment.configure(config);
        experiment
    }
    /// Goes on from the run folder of another experiment.
    pub(crate) fn copy_of(out: &Path, config: &str) -> Experiment {
        let experiment = Experiment::new(config);
        copy_folder(out, &experiment.out());
        experiment
    }
    /// Replaces the configuration.
    pub(crate) fn configure(&self, config: &str) {
        self.write("experiment.toml", config.as_bytes());
    }
    pub(crate) fn config(&self) -> PathBuf {
        self.folder.path().join("experiment.toml")
    }
    pub(crate) fn out(&self) -> PathBuf {
        self.folder.path().join("out")
    }
    /// Writes a file beside the configuration.
    pub(crate) fn write(&self, name: &str, bytes: &[u8]) {
        let path = self.folder.path().join(name);
        std::fs::create_dir_all(path.parent().expect("a parent")).expect("a folder");
        std::fs::write(path, bytes).expect("a written file");
    }
    pub(crate) fn try_run(&self) -> Result<Summary> {
        Run::open(&self.config(), Some(self.out()))?.all()
    }
    pub(crate) fn run(&self) -> Summary {
        self.try_run().unwrap_or_else(|e| panic!("{e}"))
    }
    pub(crate) fn run_until(&self, stage: &str) -> Summary {
        let run = Run::open(&self.config(), Some(self.out())).and_then(|run| run.until(stage));
        run.and_then(|run| run.all()).unwrap_or_else(|e| panic!("{e}"))
    }
    /// The text of the error that a run ends with.
    pub(crate) fn error(&self) -> String {
        match self.try_run() {
            Ok(summary) => panic!("this must not run, but it ran {:?}", summary.ran),
            Err(error) => error.to_string(),
        }
    }
}

/// All files below a folder, by their name relative to it.
pub(crate) fn files(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    fn collect(root: &Path, folder: &Path, all: &mut BTreeMap<String, Vec<u8>>) {
        for entry in std::fs::read_dir(folder).expect("a folder") {
            let path = entry.expect("an entry").path();
            if path.is_dir() {
                collect(root, &path, all);
            } else {
                let name = path.strip_prefix(root).expect("a path below the root").to_string_lossy().to_string();
                all.insert(name, std::fs::read(&path).expect("a file"));
            }
        }
    }
    let mut all = BTreeMap::new();
    collect(folder, folder, &mut all);
    all
}

pub(crate) fn copy_folder(from: &Path, to: &Path) {
    for (name, bytes) in files(from) {
        let path = to.join(name);
        std::fs::create_dir_all(path.parent().expect("a parent")).expect("a folder");
        std::fs::write(path, bytes).expect("a copy");
    }
}

/// The header of an artifact.
pub(crate) fn header(path: &Path) -> Header {
    let bytes = std::fs::read(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    let line = bytes.split(|&b| b == b'\n').next().expect("a header line");
    serde_json::from_slice(line).expect("a header")
}

/// The value in an artifact of a run folder.
pub(crate) fn value<T: DeserializeOwned>(out: &Path, stage: &str) -> T {
    let path = out.join(format!("{stage}.caphy"));
    let key = header(&path).key;
    artifact::load::<T>(&path, stage, &key).expect("a sound artifact").expect("the artifact of this key").0
}

/// The folder with shared data, when it is there.
pub(crate) fn shared() -> Option<PathBuf> {
    let folder = std::env::var_os("CAPHY_SHARED")
        .map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared"), PathBuf::from);
    for needed in ["data/scans/ground_truth.npz", "data/body/anny_smplx_layout.npz", "data/mocap/cmu_35_01_smplh.npz"] {
        let path = folder.join(needed);
        if !path.exists() {
            // Straight to the terminal: what the print macros write is only shown for tests that fail.
            let _ = writeln!(
                std::io::stderr(),
                "SKIPPED: {} is missing; set CAPHY_SHARED to the folder that holds data/",
                path.display()
            );
            return None;
        }
    }
    Some(std::fs::canonicalize(folder).expect("the shared folder"))
}
