//! The disk as seen by a run: paths relative to the configuration, `${VARIABLES}` expanded.

use caphy_core::files::{Disk, Files};
use caphy_core::{Error, Result};
use std::path::{Path, PathBuf};

/// Reads files named in a configuration.
#[derive(Debug, Clone)]
pub struct ProjectFiles {
    base: PathBuf,
}

impl ProjectFiles {
    /// Paths are relative to `base`, the configuration's folder.
    pub fn new(base: impl Into<PathBuf>) -> Self {
        Self { base: base.into() }
    }
    /// The path on disk: `${NAME}` replaced from the environment, relative paths put behind the base.
    pub fn resolve(&self, path: &Path) -> Result<PathBuf> {
        let text = path.to_string_lossy();
        let mut out = String::new();
        let mut rest = text.as_ref();
        while let Some(start) = rest.find("${") {
            let Some(end) = rest[start..].find('}') else {
                return Err(Error::config(
                    text.to_string(),
                    "a `${` without its `}`",
                    "close the variable's name with `}`",
                ));
            };
            let name = &rest[start + 2..start + end];
            let value = std::env::var(name).map_err(|_| {
                Error::config(
                    text.to_string(),
                    format!("the environment variable {name} is not set"),
                    format!("set it, for example `export {name}=/path/to/folder`"),
                )
            })?;
            out.push_str(&rest[..start]);
            out.push_str(&value);
            rest = &rest[start + end + 1..];
        }
        out.push_str(rest);
        Ok(self.base.join(out))
    }
    /// All files of a folder, sorted by name, as absolute paths.
    ///
    /// # Errors
    /// [`Error::Io`] that names the folder.
    pub fn all(&self, folder: &Path) -> Result<Vec<PathBuf>> {
        let folder = std::path::absolute(self.resolve(folder)?).map_err(|e| Error::io(folder, "find", e))?;
        let failed = |e| Error::io(&folder, "list", e);
        let mut found = Vec::new();
        for entry in std::fs::read_dir(&folder).map_err(failed)? {
            let path = entry.map_err(failed)?.path();
            if path.is_file() {
                found.push(path);
            }
        }
        found.sort();
        Ok(found)
    }
}

/// A path as a person at a shell would write it: without detours, relative where it lies below the working directory.
pub fn shown(path: &Path) -> PathBuf {
    let Ok(whole) = std::fs::canonicalize(path) else { return path.into() };
    let here = std::env::current_dir().and_then(std::fs::canonicalize);
    here.ok().and_then(|here| whole.strip_prefix(here).ok().map(Path::to_path_buf)).unwrap_or(whole)
}

impl Files for ProjectFiles {
    fn read(&self, path: &Path) -> Result<Vec<u8>> {
        let path = self.resolve(path)?;
        Disk.read(&path)
    }
    fn list(&self, folder: &Path, endings: &[&str]) -> Result<Vec<PathBuf>> {
        // What comes back is absolute or relative to the program's own place: made absolute, `read` takes it as it is.
        let folder = std::path::absolute(self.resolve(folder)?).map_err(|e| Error::io(folder, "find", e))?;
        Disk.list(&folder, endings)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_are_shown_without_detours() {
        // Tests run in the crate's folder.
        assert_eq!(shown(Path::new("src/stage/../files.rs")), Path::new("src/files.rs"));
        let folder = tempfile::tempdir().unwrap();
        assert_eq!(shown(&folder.path().join(".")), std::fs::canonicalize(folder.path()).unwrap());
        assert_eq!(shown(Path::new("not/../there")), Path::new("not/../there"));
    }

    #[test]
    fn unset_variables_and_missing_files_are_named() {
        let files = ProjectFiles::new("/nowhere");
        let text = files.resolve(Path::new("${CAPHY_NOT_SET}/a")).unwrap_err().to_string();
        assert!(text.contains("CAPHY_NOT_SET"), "{text}");
        assert_eq!(files.resolve(Path::new("a/b")).unwrap(), Path::new("/nowhere/a/b"));
        // What a listing gives can be read, wherever the program was started: `src` of this crate, from a relative base.
        let relative = ProjectFiles::new("src");
        for listed in [relative.all(Path::new("stage")), relative.list(Path::new("stage"), &["rs"])] {
            let listed = listed.unwrap();
            assert!(listed.iter().all(|file| relative.read(file).is_ok()) && listed.len() > 5);
        }
        assert!(files.read(Path::new("x.ply")).unwrap_err().to_string().contains("/nowhere/x.ply"));
    }
}
