//! Where tests find the shared data.

use std::path::PathBuf;

/// A file of the shared folder, or `None` with a loud line.
pub(crate) fn shared(name: &str) -> Option<Vec<u8>> {
    let folder = std::env::var_os("CAPHY_SHARED")
        .map_or_else(|| PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared")), PathBuf::from);
    let path = folder.join(name);
    match std::fs::read(&path) {
        Ok(bytes) => Some(bytes),
        Err(e) => {
            println!("SKIPPED: {}: {e}; set CAPHY_SHARED to the shared folder", path.display());
            None
        }
    }
}
