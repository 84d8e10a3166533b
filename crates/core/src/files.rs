//! How plugins get at files: through the host, which expands variables, records hashes and owns the disk.

use crate::{Error, Result};
use std::path::Path;

/// Reads whole files. Readers of formats take bytes, so that they can be fuzzed and never touch the disk.
pub trait Files: Send + Sync {
    /// The file's content; an [`Error::Io`] that names the path otherwise.
    fn read(&self, path: &Path) -> Result<Vec<u8>>;
}

/// The plain disk, paths as they are: for tests and small tools.
#[derive(Debug, Clone, Copy, Default)]
pub struct Disk;

impl Files for Disk {
    fn read(&self, path: &Path) -> Result<Vec<u8>> {
        std::fs::read(path).map_err(|e| Error::io(path, "read", e))
    }
}
