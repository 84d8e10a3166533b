//! How plugins get at files: through the host, which expands variables, records hashes and owns the disk.

use crate::{Error, Result};
use std::path::{Path, PathBuf};

/// Reads whole files. Readers of formats take bytes, so that they can be fuzzed and never touch the disk.
pub trait Files: Send + Sync {
    /// The file's content; an [`Error::Io`] that names the path otherwise.
    fn read(&self, path: &Path) -> Result<Vec<u8>>;
    /// Files of a folder with one of the endings (lower case, without dot), sorted by name; [`Files::read`] takes them as they
    /// are. A host without folders keeps the default.
    ///
    /// # Errors
    /// [`Error::Io`] that names the folder, [`Error::Unsupported`] by default.
    fn list(&self, folder: &Path, endings: &[&str]) -> Result<Vec<PathBuf>> {
        let what = format!("listing {} for files ending in {}", folder.display(), endings.join(", "));
        Err(Error::unsupported(what, "this host"))
    }
}

/// The plain disk, paths as they are: for tests and small tools.
#[derive(Debug, Clone, Copy, Default)]
pub struct Disk;

impl Files for Disk {
    fn read(&self, path: &Path) -> Result<Vec<u8>> {
        std::fs::read(path).map_err(|e| Error::io(path, "read", e))
    }
    fn list(&self, folder: &Path, endings: &[&str]) -> Result<Vec<PathBuf>> {
        let entries = std::fs::read_dir(folder).map_err(|e| Error::io(folder, "list", e))?;
        let mut found = Vec::new();
        for entry in entries {
            let path = entry.map_err(|e| Error::io(folder, "list", e))?.path();
            let ending = path.extension().map(|e| e.to_string_lossy().to_lowercase());
            if ending.is_some_and(|e| endings.contains(&e.as_str())) {
                found.push(path);
            }
        }
        found.sort();
        Ok(found)
    }
}
