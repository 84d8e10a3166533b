//! A plugin's table in a configuration.

use super::{Kind, Plugins};
use crate::config::{self, place};
use caphy_core::body::{BodyModel, BodySpec};
use caphy_core::files::Files;
use caphy_core::host::{Library, PluginKind};
use caphy_core::material::{MaterialModel, MaterialSpec};
use caphy_core::net::{DeformationNet, NetSpec};
use caphy_core::plugin::WHOLE_TABLE;
use caphy_core::segmenter::{Segmenter, SegmenterSpec};
use caphy_core::{Error, Result};
use caphy_garment::template::{TemplateSource, TemplateSpec};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use std::path::Path;
use std::sync::Arc;

/// `type = "…"` and the keys of that type: which plugin, and how it is set.
///
/// Resolved once against the [`Plugins`] of a run; it then holds every default and builds without them.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
#[serde(transparent)]
pub struct PluginTable {
    table: toml::Table,
    /// Where the type comes from, when not from a linked crate.
    #[serde(skip)]
    library: Option<Arc<Library>>,
}

impl PluginTable {
    /// A type without further keys, not resolved yet: for defaults.
    pub(crate) fn of_type(name: &str) -> Self {
        Self { table: toml::Table::from_iter([("type".to_string(), toml::Value::from(name))]), library: None }
    }

    /// Whether it chooses a measured fabric.
    pub(crate) fn is_measured(&self) -> bool {
        self.table.get("type").and_then(|t| t.as_str()) == Some("measured")
    }

    /// Reads a file that holds one such table and nothing else, and resolves it; `path` is for messages.
    ///
    /// # Errors
    /// [`Error::Format`] with line and column.
    pub fn parse(plugins: &Plugins, kind: Kind, path: &Path, text: &str) -> Result<Self> {
        let mut table = Self { table: config::parse_table(path, text)?, library: None };
        table.resolve_in(plugins, kind, path, text, "")?;
        plugins.settle(path);
        Ok(table)
    }

    /// Finds the type and fills in its defaults; the table stands in `text` under the dotted path `key`.
    ///
    /// # Errors
    /// [`Error::Format`] with line and column.
    pub(crate) fn resolve_in(
        &mut self,
        plugins: &Plugins,
        kind: Kind,
        path: &Path,
        text: &str,
        key: &str,
    ) -> Result<()> {
        let written = self.table.clone();
        self.resolve(plugins, kind).map_err(|message| {
            let complaint = |table: &toml::Table| {
                let mut changed = Self { table: table.clone(), library: None };
                changed.resolve(plugins, kind).err()
            };
            place::error(path, text, key, &written, &message, &complaint)
        })
    }

    /// The table; with every default once it is resolved.
    pub fn table(&self) -> &toml::Table {
        &self.table
    }

    /// The table as text.
    pub fn text(&self) -> String {
        self.table.to_string()
    }

    /// As [`PluginTable::resolve_in`], complaining in the words of the parser.
    fn resolve(&mut self, plugins: &Plugins, kind: Kind) -> std::result::Result<(), String> {
        let name = match self.table.get("type") {
            Some(toml::Value::String(name)) => name.clone(),
            Some(other) => return Err(format!("invalid type: {}, expected the name of a {kind}", other.type_str())),
            None => return Err("missing field `type`".into()),
        };
        if let Some((library, loadable)) = plugins.library(kind, &name).zip(kind.loadable()) {
            // Loaded types check their keys when they are built; sizes that no net has are enough for that.
            let text = self.text();
            match loadable {
                PluginKind::Material => library.material(&name, &text).map(drop),
                PluginKind::Net => library.net(&name, &text, 1, 3).map(drop),
            }
            .map_err(|error| match error {
                // What a parser says of a table is said in the file's own terms.
                Error::Config { key, problem, .. } if key == WHOLE_TABLE => problem,
                other => other.to_string(),
            })?;
            if let Some(full) = library.normalise(loadable, &name, &text).map_err(|e| e.to_string())? {
                self.table = toml::from_str(&full).map_err(|e| format!("`{name}` wrote a table back wrongly: {e}"))?;
            }
            self.library = Some(Arc::clone(library));
            return Ok(());
        }
        let names = plugins.names(kind);
        if !names.contains(&name) {
            return Err(format!(
                "unknown {kind} type `{name}`, expected one of {}; a type of a library of yours needs \
                 `[[plugin]] path = \"…\"` in this file, or `--plugin`",
                names.iter().map(|n| format!("`{n}`")).collect::<Vec<_>>().join(", ")
            ));
        }
        self.table = kind.linked(&self.table)?;
        Ok(())
    }

    /// The table as a linked specification.
    fn spec<S: ?Sized>(&self, key: &str) -> Result<Box<S>>
    where
        Box<S>: DeserializeOwned,
    {
        let wrong = |e: toml::de::Error| Error::config(key, e.message().to_string(), "correct the key");
        self.table.clone().try_into().map_err(wrong)
    }

    /// The library and the type's name, for a loaded type.
    fn loaded(&self) -> Option<(&Library, &str)> {
        self.library.as_deref().zip(self.table.get("type").and_then(|t| t.as_str()))
    }

    /// Makes the material; `key` is the table's dotted path in its file.
    ///
    /// # Errors
    /// [`Error::Config`] naming the key, its value and what is valid; for loaded types whatever they answer.
    pub fn material(&self, key: &str) -> Result<Box<dyn MaterialModel>> {
        let built = match self.loaded() {
            Some((library, name)) => library.material(name, &self.text()),
            None => self.spec::<dyn MaterialSpec>(key)?.build(),
        };
        built.map_err(|error| placed(error, Kind::Material, key))
    }

    /// Makes a net of these sizes.
    ///
    /// # Errors
    /// As [`PluginTable::material`].
    pub fn net(&self, inputs: usize, outputs: usize) -> Result<Box<dyn DeformationNet>> {
        match self.loaded() {
            Some((library, name)) => library.net(name, &self.text(), inputs, outputs),
            None => self.spec::<dyn NetSpec>("net")?.build(inputs, outputs),
        }
    }

    /// Makes the body.
    ///
    /// # Errors
    /// As [`PluginTable::material`], and what reading its files gives.
    pub fn body(&self, files: &dyn Files) -> Result<Box<dyn BodyModel>> {
        self.spec::<dyn BodySpec>("body")?.build(files)
    }

    /// Makes the segmenter.
    ///
    /// # Errors
    /// As [`PluginTable::body`].
    pub fn segmenter(&self, files: &dyn Files) -> Result<Box<dyn Segmenter>> {
        self.spec::<dyn SegmenterSpec>("segmenter")?.build(files)
    }

    /// Makes the source of garment templates.
    ///
    /// # Errors
    /// As [`PluginTable::body`].
    pub fn template(&self, files: &dyn Files) -> Result<Box<dyn TemplateSource>> {
        self.spec::<dyn TemplateSpec>("template")?.build(files)
    }
}

/// A plugin knows its own keys only: the table's path is put in front of them.
fn placed(error: Error, kind: Kind, key: &str) -> Error {
    match error {
        Error::Config { key: own, problem, remedy } => {
            let inner = own.strip_prefix(kind.key()).unwrap_or(&own);
            Error::config(format!("{key}.{}", inner.trim_start_matches('.')).trim_end_matches('.'), problem, remedy)
        }
        other => other,
    }
}
