//! A loaded library and the types that it offers.

use super::call::Callee;
use super::material::LoadedMaterial;
use super::net::LoadedNet;
use crate::conformance::material::MaterialSubject;
use crate::conformance::net::NetSubject;
use crate::material::MaterialModel;
use crate::net::DeformationNet;
use crate::plugin::abi::{
    ABI_VERSION, KIND_MATERIAL, KIND_NET, MaterialTable, NetTable, PluginEntry, PluginTable, TABLE_SYMBOL, Text,
    VERSION_SYMBOL,
};
use crate::{Error, PluginProblem, Result};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Writes a table back.
type Normaliser = Box<dyn Fn(&str) -> Result<String> + Send + Sync>;

/// What a loaded type is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PluginKind {
    /// [`MaterialModel`].
    Material,
    /// [`DeformationNet`].
    Net,
}

/// A type that a library offers.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PluginType {
    /// Which trait it implements.
    pub kind: PluginKind,
    /// Its `type` name in TOML.
    pub name: String,
}

/// Functions of a type.
#[derive(Clone, Copy)]
enum Functions {
    Material(&'static MaterialTable),
    Net(&'static NetTable),
}

/// A plugin library, loaded for as long as the program runs: code that is still referred to is never unloaded.
pub struct Library {
    path: PathBuf,
    types: Vec<PluginType>,
    functions: Vec<Functions>,
}

impl std::fmt::Debug for Library {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Library").field("path", &self.path).field("types", &self.types).finish()
    }
}

impl Library {
    /// Loads a library and reads its table.
    ///
    /// # Errors
    /// [`Error::Io`] for a file that is not there, [`Error::Plugin`] for one that is not a library, no plugin, of another
    /// version, or whose table contradicts the interface.
    pub fn load(path: &Path) -> Result<Self> {
        // The loader would also search the system's folders, and does not say which file it missed.
        if let Err(source) = std::fs::metadata(path) {
            return Err(Error::io(path, "read", source));
        }
        let absolute = std::path::absolute(path).map_err(|e| Error::io(path, "find", e))?;
        let library = open(&absolute).map_err(|e| {
            // The loader's own words are the error's source.
            let reason = std::error::Error::source(&e).map_or_else(|| e.to_string(), ToString::to_string);
            Error::plugin(path, PluginProblem::NotALibrary { reason })
        })?;
        // Never unloaded: handles, tables and names point into it.
        let library: &'static libloading::Library = Box::leak(Box::new(library));
        let missing = |symbol: &str| Error::plugin(path, PluginProblem::MissingSymbol { symbol: symbol.into() });
        // SAFETY: the symbol's type is part of every version of the interface.
        let version: libloading::Symbol<'_, unsafe extern "C" fn() -> u32> =
            unsafe { library.get(VERSION_SYMBOL) }.map_err(|_| missing(VERSION_SYMBOL))?;
        // SAFETY: as above; the function takes nothing and returns a number.
        let got = unsafe { version() };
        if got != ABI_VERSION {
            return Err(Error::plugin(path, PluginProblem::AbiVersion { got, expected: ABI_VERSION }));
        }
        // SAFETY: the version says that the symbol has this type.
        let table: libloading::Symbol<'_, unsafe extern "C" fn() -> *const PluginTable> =
            unsafe { library.get(TABLE_SYMBOL) }.map_err(|_| missing(TABLE_SYMBOL))?;
        // SAFETY: as above; the table lives as long as the library, which is never unloaded.
        unsafe { Self::from_table(path, table()) }
    }

    /// Reads the table of a library that is in memory already; `path` is for messages.
    ///
    /// # Errors
    /// As [`Library::load`].
    ///
    /// # Safety
    /// `table` is null or a table of this version that lives as long as the program.
    pub unsafe fn from_table(path: &Path, table: *const PluginTable) -> Result<Self> {
        let callee = Callee::new(path, "(library)");
        let wrong = |what: String| callee.malformed("caphy_plugin", what);
        // SAFETY: null or a valid table, as the caller vouches.
        let table = unsafe { table.as_ref() }.ok_or_else(|| wrong("the table is null".into()))?;
        check_size(&callee, "caphy_plugin", table.struct_size, size_of::<PluginTable>())?;
        if table.types.is_null() && table.type_count > 0 {
            return Err(wrong(format!("{} types, but their array is null", table.type_count)));
        }
        let mut library = Self { path: path.into(), types: Vec::new(), functions: Vec::new() };
        for index in 0..table.type_count {
            // SAFETY: the array holds `type_count` entries.
            let entry = unsafe { &*table.types.add(index) };
            library.add(&callee, index, entry)?;
        }
        if library.types.is_empty() {
            return Err(wrong("it offers no type".into()));
        }
        Ok(library)
    }

    fn add(&mut self, callee: &Callee, index: usize, entry: &PluginEntry) -> Result<()> {
        let wrong = |what: String| callee.malformed("caphy_plugin", format!("type {index}: {what}"));
        // SAFETY: names live as long as the library.
        let name = unsafe { entry.name.get() }.filter(|n| !n.is_empty());
        let name = name.ok_or_else(|| wrong("its name is empty or not UTF-8".into()))?.to_string();
        let (kind, functions) = match entry.kind {
            KIND_MATERIAL => {
                // SAFETY: null or a valid table that lives as long as the library.
                let table = unsafe { entry.material.as_ref() };
                let table = table.ok_or_else(|| wrong(format!("`{name}` has no material table")))?;
                check_size(callee, &name, table.struct_size, size_of::<MaterialTable>())?;
                (PluginKind::Material, Functions::Material(table))
            }
            KIND_NET => {
                // SAFETY: as above.
                let table = unsafe { entry.net.as_ref() };
                let table = table.ok_or_else(|| wrong(format!("`{name}` has no net table")))?;
                check_size(callee, &name, table.struct_size, size_of::<NetTable>())?;
                (PluginKind::Net, Functions::Net(table))
            }
            other => return Err(wrong(format!("`{name}` is of kind {other}, known are 0 (material) and 1 (net)"))),
        };
        let offered = PluginType { kind, name };
        if self.types.contains(&offered) {
            let other = "the same library".into();
            return Err(Error::plugin(&self.path, PluginProblem::Duplicate { type_name: offered.name, other }));
        }
        self.types.push(offered);
        self.functions.push(functions);
        Ok(())
    }

    /// The library's file.
    pub fn path(&self) -> &Path {
        &self.path
    }
    /// What it offers, in its own order.
    pub fn types(&self) -> &[PluginType] {
        &self.types
    }

    fn find(&self, kind: PluginKind, name: &str) -> Result<Functions> {
        match self.types.iter().position(|t| t.kind == kind && t.name == name) {
            Some(place) => Ok(self.functions[place]),
            None => {
                let names: Vec<String> = self.types.iter().map(|t| format!("`{}`", t.name)).collect();
                let problem = format!("{} offers no {kind:?} `{name}`", self.path.display());
                Err(Error::config("type", problem, format!("it has {}", names.join(", "))))
            }
        }
    }

    /// Makes a material from its TOML table.
    ///
    /// # Errors
    /// [`Error::Config`] for a table that the plugin refuses, [`Error::Plugin`] for a plugin that breaks the contract.
    pub fn material(&self, name: &str, toml: &str) -> Result<Box<dyn MaterialModel>> {
        let callee = Callee::new(&self.path, name);
        match self.find(PluginKind::Material, name)? {
            Functions::Material(table) => Ok(Box::new(LoadedMaterial::create(callee, table, toml)?)),
            Functions::Net(_) => Err(callee.malformed("create", "a net's table")),
        }
    }

    /// Makes a net of these sizes from its TOML table.
    ///
    /// # Errors
    /// As [`Library::material`].
    pub fn net(&self, name: &str, toml: &str, inputs: usize, outputs: usize) -> Result<Box<dyn DeformationNet>> {
        let callee = Callee::new(&self.path, name);
        match self.find(PluginKind::Net, name)? {
            Functions::Net(table) => Ok(Box::new(LoadedNet::create(callee, table, toml, inputs, outputs)?)),
            Functions::Material(_) => Err(callee.malformed("create", "a material's table")),
        }
    }

    /// A material type with a table of its own, ready for [`crate::conformance`].
    pub fn material_subject(self: &Arc<Self>, name: &str, toml: &str) -> MaterialSubject {
        let (library, type_name) = (Arc::clone(self), name.to_string());
        MaterialSubject {
            toml: toml.into(),
            create: Box::new(move |text| library.material(&type_name, text)),
            normalise: self.normaliser(PluginKind::Material, name),
        }
    }

    /// A net type with a table of its own, ready for [`crate::conformance`].
    pub fn net_subject(self: &Arc<Self>, name: &str, toml: &str) -> NetSubject {
        let (library, type_name) = (Arc::clone(self), name.to_string());
        NetSubject {
            toml: toml.into(),
            create: Box::new(move |text, inputs, outputs| library.net(&type_name, text, inputs, outputs)),
            normalise: self.normaliser(PluginKind::Net, name),
        }
    }

    /// [`Library::normalise`] of one type, where it has one.
    fn normaliser(self: &Arc<Self>, kind: PluginKind, name: &str) -> Option<Normaliser> {
        let has = match self.find(kind, name).ok()? {
            Functions::Material(table) => table.normalise.is_some(),
            Functions::Net(table) => table.normalise.is_some(),
        };
        let (library, name) = (Arc::clone(self), name.to_string());
        has.then(|| {
            let write = move |text: &str| {
                let written = library.normalise(kind, &name, text)?;
                written.ok_or_else(|| Error::unsupported("writing a table back", &name))
            };
            Box::new(write) as Normaliser
        })
    }

    /// A table with every default filled in; `None` when the plugin cannot say.
    ///
    /// # Errors
    /// As [`Library::material`].
    pub fn normalise(&self, kind: PluginKind, name: &str, toml: &str) -> Result<Option<String>> {
        let normalise = match self.find(kind, name)? {
            Functions::Material(table) => table.normalise,
            Functions::Net(table) => table.normalise,
        };
        let Some(normalise) = normalise else { return Ok(None) };
        // SAFETY: text and sinks outlive the call.
        let text = Callee::new(&self.path, name)
            .text("normalise", |out, error| unsafe { normalise(Text::borrowed(toml), out, error) })?;
        Ok(Some(text))
    }
}

/// Opens a library with all of its symbols resolved: bound at their first call, a missing one would end the program there.
#[cfg(unix)]
fn open(path: &Path) -> std::result::Result<libloading::Library, libloading::Error> {
    use libloading::os::unix::{Library, RTLD_LOCAL, RTLD_NOW};
    // SAFETY: loading runs the library's initialisers; whoever names a library in a configuration trusts its code.
    unsafe { Library::open(Some(path), RTLD_NOW | RTLD_LOCAL) }.map(Into::into)
}

/// Opens a library; this system's loader resolves its symbols at once.
#[cfg(not(unix))]
fn open(path: &Path) -> std::result::Result<libloading::Library, libloading::Error> {
    // SAFETY: loading runs the library's initialisers; whoever names a library in a configuration trusts its code.
    unsafe { libloading::Library::new(path) }
}

/// Within one version, structs have one size: another one means another compiler's layout or a damaged library.
fn check_size(callee: &Callee, what: &str, got: usize, expected: usize) -> Result<()> {
    if got == expected {
        return Ok(());
    }
    Err(callee.malformed("caphy_plugin", format!("the table of {what} has {got} bytes, expected {expected}")))
}
