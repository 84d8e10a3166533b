//! Variants of one experiment, each in a run folder of its own: what ablations and sweeps of the knobs share.

use crate::plugins::Plugins;
use caphy_core::{Error, Result};
use std::path::Path;

/// Libraries of the command line once more: the types of a configuration are settled when it is read.
pub(crate) fn anew(plugins: &Plugins) -> Result<Plugins> {
    let mut again = Plugins::new()?;
    for path in plugins.paths() {
        again.load(path)?;
    }
    Ok(again)
}

/// Files of a run folder that say what it is or how it went: each run has its own.
const OWN: [&str; 4] = ["config.toml", "run.json", "timings.json", "lock"];

/// Puts all results of one run folder into another one, as links where the disk can: files are replaced, never changed.
pub(crate) fn share(from: &Path, to: &Path) -> Result<()> {
    std::fs::create_dir_all(to).map_err(|e| Error::io(to, "create", e))?;
    for entry in std::fs::read_dir(from).map_err(|e| Error::io(from, "list", e))? {
        let path = entry.map_err(|e| Error::io(from, "list", e))?.path();
        let Some(name) = path.file_name() else { continue };
        let target = to.join(name);
        if path.is_dir() {
            share(&path, &target)?;
        } else if !OWN.iter().any(|own| name == *own) {
            // A link cannot take the place of a file.
            if target.exists() {
                std::fs::remove_file(&target).map_err(|e| Error::io(&target, "replace", e))?;
            }
            if std::fs::hard_link(&path, &target).is_err() {
                std::fs::copy(&path, &target).map_err(|e| Error::io(&target, "write", e))?;
            }
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::artifact;

    #[test]
    fn shared_files_are_there_and_may_be_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let (from, to) = (folder.path().join("from"), folder.path().join("to"));
        std::fs::create_dir_all(from.join("scans")).unwrap();
        for name in ["scans/a.ply", "synth.caphy", "config.toml"] {
            std::fs::write(from.join(name), name).unwrap();
        }
        share(&from, &to).unwrap();
        assert_eq!(std::fs::read(to.join("scans/a.ply")).unwrap(), b"scans/a.ply");
        assert!(!to.join("config.toml").exists());
        artifact::write_atomically(&to.join("synth.caphy"), b"another").unwrap();
        assert_eq!(std::fs::read(from.join("synth.caphy")).unwrap(), b"synth.caphy");
        share(&from, &to).unwrap();
        assert_eq!(std::fs::read(to.join("synth.caphy")).unwrap(), b"synth.caphy");
    }
}
