//! Which plugins exist, and how a configuration's table becomes one.
//!
//! A plugin is *linked* (a crate of this workspace, found by `typetag`) or *loaded* (a library with the C interface of
//! [`caphy_core::plugin`], named by `[[plugin]] path = "…"` or `--plugin`). Both are chosen the same way, by `type = "…"`,
//! and from then on a [`PluginTable`] hides which one it was.

mod kind;
mod table;

pub use kind::Kind;
pub use table::PluginTable;

// A static crate that nobody mentions is dropped by the linker, and with it its entries in typetag's registry.
use caphy_bodymodel as _;
use caphy_materials as _;
use caphy_nets as _;
use caphy_segmentation as _;

use caphy_core::host::Library;
use caphy_core::{Error, PluginProblem, Result};
use std::path::Path;
use std::sync::{Arc, OnceLock};

/// Types that this program ships. One that is not linked is a mistake of the build, found at the start of every run.
const SHIPPED: [(Kind, &[&str]); 5] = [
    (Kind::Material, &["measured", "neo_hookean", "stvk"]),
    (Kind::Net, &["gru", "mlp"]),
    (Kind::Body, &["mannequin", "smplx"]),
    (Kind::Segmenter, &["colour", "labels", "onnx", "vertex"]),
    (Kind::Template, &["folder", "linear", "mesh", "parametric"]),
];

/// The plugins of one run: the linked ones and the libraries that were loaded.
#[derive(Default)]
pub struct Plugins {
    libraries: Vec<Arc<Library>>,
    /// What was read with them first: from then on nothing may be added.
    read: OnceLock<String>,
}

impl Plugins {
    /// The linked plugins alone.
    ///
    /// # Errors
    /// [`Error::Config`] naming shipped types that are not linked.
    pub fn new() -> Result<Self> {
        for (kind, names) in SHIPPED {
            check_linked(kind, names)?;
        }
        Ok(Self::default())
    }

    /// Loads a library; it stays loaded as long as the program runs.
    ///
    /// # Errors
    /// [`Error::Plugin`]: what [`Library::load`] says, a type that exists already, or a library that comes after a
    /// configuration was read.
    pub fn load(&mut self, path: &Path) -> Result<Arc<Library>> {
        if let Some(read) = self.read.get() {
            return Err(Error::plugin(path, PluginProblem::TooLate { read: read.clone() }));
        }
        // Absolute: a run folder's configuration is read from another place.
        let path = &std::path::absolute(path).map_err(|e| Error::io(path, "find", e))?;
        if let Some(loaded) = self.libraries.iter().find(|l| l.path() == path) {
            return Ok(Arc::clone(loaded));
        }
        let library = Arc::new(Library::load(path)?);
        for offered in library.types() {
            let Some(kind) = Kind::ALL.into_iter().find(|k| k.loadable() == Some(offered.kind)) else { continue };
            let other = match self.library(kind, &offered.name) {
                Some(other) => other.path().display().to_string(),
                None if kind.linked_names().contains(&offered.name) => "this program".to_string(),
                None => continue,
            };
            return Err(Error::plugin(path, PluginProblem::Duplicate { type_name: offered.name.clone(), other }));
        }
        self.libraries.push(Arc::clone(&library));
        Ok(library)
    }

    /// Files of the loaded libraries, absolute, in the order of loading.
    pub fn paths(&self) -> impl Iterator<Item = &Path> {
        self.libraries.iter().map(|l| l.path())
    }

    /// All types of a kind, sorted.
    pub fn names(&self, kind: Kind) -> Vec<String> {
        let loaded = self.libraries.iter().flat_map(|l| l.types()).filter(|t| Some(t.kind) == kind.loadable());
        let mut names: Vec<String> = loaded.map(|t| t.name.clone()).chain(kind.linked_names()).collect();
        names.sort();
        names
    }

    /// Marks the types as settled: `what` has been read with them.
    pub(crate) fn settle(&self, what: &Path) {
        self.read.get_or_init(|| what.display().to_string());
    }

    /// The library that offers a type.
    pub(crate) fn library(&self, kind: Kind, name: &str) -> Option<&Arc<Library>> {
        let offers = |l: &&Arc<Library>| l.types().iter().any(|t| Some(t.kind) == kind.loadable() && t.name == name);
        self.libraries.iter().find(offers)
    }
}

/// `Ok` when all of `names` are linked.
fn check_linked(kind: Kind, names: &[&str]) -> Result<()> {
    let linked = kind.linked_names();
    match names.iter().find(|name| !linked.iter().any(|l| l == *name)) {
        None => Ok(()),
        Some(missing) => Err(Error::config(
            kind.key(),
            format!("the {kind} `{missing}` is not linked into this program"),
            "mention its crate in src/plugins/mod.rs (`use the_crate as _;`) and build again",
        )),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_type_that_is_not_linked_is_noticed() {
        Plugins::new().expect("everything that ships is linked");
        let error = check_linked(Kind::Net, &["gru", "transformer"]).unwrap_err().to_string();
        assert!(error.contains("`transformer` is not linked") && error.contains("plugins"), "{error}");
    }
}
