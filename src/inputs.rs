//! Bodies, garments and motion that a command names: by name, by file, or by the TOML table that an experiment would hold.

use crate::config::{self, ClipConfig, Translation};
use crate::files::ProjectFiles;
use crate::motion::clip_of_file;
use crate::plugins::{Kind, PluginTable, Plugins};
use caphy_bodymodel::procedural_motion::MotionKind;
use caphy_core::body::BodyModel;
use caphy_core::material::MaterialModel;
use caphy_core::{Error, Result};
use caphy_garment::template::{GarmentKind, GivenStyle, Style, Tailor, TemplateSource};
use caphy_materials::measured::Fabric;
use std::path::{Path, PathBuf};

/// The file's ending in lower case; empty without one.
fn ending(path: &Path) -> String {
    path.extension().map(|e| e.to_string_lossy().to_lowercase()).unwrap_or_default()
}

/// A table that is made of a file's name, as if somebody had written it.
fn table_of(kind: Kind, type_name: &str, path: &Path, plugins: &Plugins) -> Result<PluginTable> {
    let path = std::path::absolute(path).map_err(|e| Error::io(path, "find", e))?;
    let table = toml::Table::from_iter([
        ("type".to_string(), toml::Value::from(type_name)),
        ("path".to_string(), toml::Value::from(path.to_string_lossy().into_owned())),
    ]);
    PluginTable::parse(plugins, kind, &path, &table.to_string())
}

/// A table in a file of its own, and the folder that its paths are relative to.
fn table_in(kind: Kind, path: &Path, plugins: &Plugins) -> Result<TableArgument> {
    let text = std::fs::read_to_string(path).map_err(|e| Error::io(path, "read", e))?;
    Ok(TableArgument { table: PluginTable::parse(plugins, kind, path, &text)?, files: beside(path) })
}

/// Paths in a file are relative to it.
fn beside(path: &Path) -> ProjectFiles {
    ProjectFiles::new(path.parent().unwrap_or(Path::new(".")))
}

/// A plugin's table that an argument names, and where its paths are.
pub struct TableArgument {
    /// The table, as an experiment would hold it.
    pub table: PluginTable,
    /// Where relative paths in it start.
    pub files: ProjectFiles,
}

impl TableArgument {
    fn here(table: PluginTable) -> Self {
        Self { table, files: ProjectFiles::new(".") }
    }
    /// The table as an experiment in another folder would hold it: its file's path is absolute.
    ///
    /// # Errors
    /// [`Error::Config`] for a path with an unset variable.
    pub fn anywhere(&self) -> Result<toml::Table> {
        let mut table = self.table.table().clone();
        make_absolute(&mut table, &self.files)?;
        Ok(table)
    }
}

/// Makes the paths of a table's files absolute.
///
/// # Errors
/// [`Error::Config`] for a path with an unset variable.
pub fn make_absolute(table: &mut toml::Table, files: &ProjectFiles) -> Result<()> {
    for key in ["path", "skeleton", "mapping"] {
        if let Some(toml::Value::String(path)) = table.get_mut(key) {
            let resolved = files.resolve(Path::new(path.as_str()))?;
            let absolute = std::path::absolute(&resolved).map_err(|e| Error::io(&resolved, "find", e))?;
            *path = absolute.to_string_lossy().into_owned();
        }
    }
    Ok(())
}

/// `mannequin` or another type without keys, an `.npz` in the SMPL-X layout, or a TOML file with a body's table.
///
/// # Errors
/// What the table or the body's file is refused for; [`Error::Config`] for a name that is none of these.
pub fn body_table(argument: &str, plugins: &Plugins) -> Result<TableArgument> {
    let path = Path::new(argument);
    match ending(path).as_str() {
        "toml" => table_in(Kind::Body, path, plugins),
        // A pickle is refused by the reader of `.npz`, with the way to convert it.
        "npz" | "pkl" => table_of(Kind::Body, "smplx", path, plugins).map(TableArgument::here),
        _ => {
            let remedy = "give an .npz in the SMPL-X layout, a .toml with a table, or a type";
            type_table(Kind::Body, argument, plugins, remedy)
        }
    }
}

/// A type that needs no keys.
fn type_table(kind: Kind, name: &str, plugins: &Plugins, remedy: &str) -> Result<TableArgument> {
    let names = plugins.names(kind);
    if !names.iter().any(|n| n == name) {
        let problem = format!("`{name}` is neither a file nor a type");
        return Err(Error::config(kind.key(), problem, format!("{remedy}: {}", names.join(", "))));
    }
    let text = format!("type = \"{name}\"\n");
    PluginTable::parse(plugins, kind, Path::new(name), &text).map(TableArgument::here)
}

/// The body that [`body_table`] names.
///
/// # Errors
/// As [`body_table`], and what the body's file is refused for.
pub fn body(argument: &str, plugins: &Plugins) -> Result<Box<dyn BodyModel>> {
    let TableArgument { table, files } = body_table(argument, plugins)?;
    table.body(&files)
}

/// A net's type without keys, or a TOML file with a net's table.
///
/// # Errors
/// As [`body_table`], for nets.
pub fn net_table(argument: &str, plugins: &Plugins) -> Result<TableArgument> {
    let path = Path::new(argument);
    match ending(path).as_str() {
        "toml" => table_in(Kind::Net, path, plugins),
        _ => type_table(Kind::Net, argument, plugins, "give a .toml with a table, or a type"),
    }
}

/// One of the ten fabrics by name, a material's type without keys, or a TOML file with a material's table.
///
/// # Errors
/// As [`body_table`], for materials.
pub fn material_table(argument: &str, plugins: &Plugins) -> Result<TableArgument> {
    let path = Path::new(argument);
    if ending(path) == "toml" {
        return table_in(Kind::Material, path, plugins);
    }
    let fabrics: Vec<String> = Fabric::all()?.into_iter().map(|f| f.name).collect();
    if fabrics.iter().any(|f| f == argument) {
        let text = format!("type = \"measured\"\nfabric = \"{argument}\"\n");
        return PluginTable::parse(plugins, Kind::Material, path, &text).map(TableArgument::here);
    }
    let remedy = format!("give a .toml with a table, a fabric ({}), or a type", fabrics.join(", "));
    type_table(Kind::Material, argument, plugins, &remedy)
}

/// The material that [`material_table`] names.
///
/// # Errors
/// As [`material_table`]; [`Error::Format`] for a table's value that cannot be used.
pub fn material(argument: &str, plugins: &Plugins) -> Result<Box<dyn MaterialModel>> {
    material_table(argument, plugins)?.table.material("material").map_err(|error| match error {
        // A material knows its keys, not the file that they stand in.
        Error::Config { key, problem, remedy } => {
            Error::format(Path::new(argument), format!("`{key}`"), problem, remedy)
        }
        other => other,
    })
}

/// Garments that an argument names.
pub struct GarmentArgument {
    /// The argument without its values, for messages.
    name: String,
    table: TableArgument,
    source: Box<dyn TemplateSource>,
    /// The kind, where the argument says it.
    kind: Option<GarmentKind>,
    /// Style values or coefficients behind the last colon.
    values: Option<Vec<f64>>,
}

impl GarmentArgument {
    /// `upper` or `lower` (cut on the body), an OBJ or PLY garment, a folder of them, an `.npz` with a linear style space, or
    /// a TOML file with a template's table; behind a colon, style values: `upper:0.4,0.5,0.02,0.1`.
    ///
    /// # Errors
    /// As [`body`], for templates.
    pub fn parse(argument: &str, plugins: &Plugins) -> Result<Self> {
        let (name, values) = match argument.rsplit_once(':') {
            Some((name, list)) => match list.split(',').map(|v| v.trim().parse()).collect() {
                Ok(values) => (name, Some(values)),
                // A path may hold colons of its own.
                Err(_) => (argument, None),
            },
            None => (argument, None),
        };
        let path = Path::new(name);
        let kind = match name {
            "upper" => Some(GarmentKind::Upper),
            "lower" => Some(GarmentKind::Lower),
            _ => None,
        };
        let of = |type_name| table_of(Kind::Template, type_name, path, plugins).map(TableArgument::here);
        let table = match ending(path).as_str() {
            _ if kind.is_some() => {
                TableArgument::here(PluginTable::parse(plugins, Kind::Template, path, "type = \"parametric\"\n")?)
            }
            "toml" => table_in(Kind::Template, path, plugins)?,
            "npz" | "pkl" => of("linear")?,
            "obj" | "ply" => of("mesh")?,
            _ if path.is_dir() => of("folder")?,
            _ => {
                let problem = format!("`{name}` is no garment");
                let remedy = "give upper, lower, an .obj or .ply, a folder of them, an .npz style space, or a .toml";
                return Err(Error::config("garment", problem, remedy));
            }
        };
        let source = table.table.template(&table.files)?;
        Ok(Self { name: name.into(), table, source, kind, values })
    }

    /// The source's table.
    pub fn table(&self) -> &TableArgument {
        &self.table
    }

    /// Style values that the argument gives.
    pub fn values(&self) -> Option<&[f64]> {
        self.values.as_deref()
    }

    /// Where the garments come from.
    pub fn source(&self) -> &dyn TemplateSource {
        &*self.source
    }

    /// `count` styles to look at: samples of a space, or all of a collection; the one style when values are given.
    ///
    /// # Errors
    /// [`Error::Config`] when there is none; values that are no style.
    pub fn styles(&self, tailor: &Tailor, count: usize, seed: u64) -> Result<Vec<Style>> {
        if let (Some(kind), Some(values)) = (self.kind, &self.values) {
            return Ok(vec![Style::from_values(kind, values)?]);
        }
        let kinds = self.kind.map_or(vec![GarmentKind::Upper, GarmentKind::Lower], |kind| vec![kind]);
        let mut styles = Vec::new();
        let mut refused = None;
        for kind in kinds {
            match self.source.styles(tailor, kind, count, seed) {
                Ok(more) => styles.extend(more),
                // A source that holds one kind refuses the other.
                Err(error) => refused = Some(error),
            }
        }
        match refused {
            Some(error) if styles.is_empty() => Err(error),
            _ => match &self.values {
                None => Ok(styles),
                Some(values) => self.with_coefficients(styles, values),
            },
        }
    }

    /// The style that is worn: the middle of a style space, a space's mean, the only garment of a file.
    ///
    /// # Errors
    /// [`Error::Config`] when there are several to choose from.
    pub fn worn(&self, tailor: &Tailor) -> Result<Style> {
        if let (Some(kind), None) = (self.kind, &self.values) {
            return Style::from_unit(kind, &vec![0.5; kind.ranges().len()]);
        }
        let mut styles = self.styles(tailor, 1, 0)?;
        match styles.pop() {
            Some(style) if styles.is_empty() => Ok(style),
            _ => {
                let problem = format!("`{}` holds {} garments", self.name, styles.len() + 1);
                Err(Error::config("garment", problem, "name one of its files"))
            }
        }
    }

    fn with_coefficients(&self, styles: Vec<Style>, values: &[f64]) -> Result<Vec<Style>> {
        match styles.into_iter().next() {
            Some(Style::Given(GivenStyle { garment, name, coefficients })) if !coefficients.is_empty() => {
                Ok(vec![Style::Given(GivenStyle { garment, name, coefficients: values.to_vec() })])
            }
            _ => {
                let problem = format!("`{}` has no style values to choose", self.name);
                Err(Error::config("garment", problem, "leave out what stands behind the colon"))
            }
        }
    }
}

/// A clip that an argument names, with the files that it is read from.
#[derive(Debug)]
pub struct MotionArgument {
    /// As an experiment would hold it.
    pub clip: ClipConfig,
    /// Where its paths are.
    pub files: ProjectFiles,
}

impl MotionArgument {
    /// The name of a generated motion, a motion file (`.npz`, `.bvh`, `.amc`), or a TOML file with a clip's table.
    ///
    /// `seconds` is how long a generated motion is; `translation` what `trans` of an `.npz` means.
    ///
    /// # Errors
    /// [`Error::Config`] for a name that is none of these, [`Error::Format`] with line and column of a table.
    pub fn parse(argument: &str, seconds: f64, translation: Translation) -> Result<Self> {
        let path = Path::new(argument);
        if ending(path) == "toml" {
            let text = std::fs::read_to_string(path).map_err(|e| Error::io(path, "read", e))?;
            return Ok(Self { clip: config::clip_table(path, &text)?, files: beside(path) });
        }
        let here = ProjectFiles::new(".");
        if let Some(kind) = MotionKind::ALL.into_iter().find(|kind| kind.name() == argument) {
            return Ok(Self { clip: ClipConfig::Procedural { kind, seed: 1, seconds }, files: here });
        }
        match clip_of_file(PathBuf::from(argument), translation) {
            Some(clip) => Ok(Self { clip, files: here }),
            None => {
                let names: Vec<&str> = MotionKind::ALL.iter().map(|kind| kind.name()).collect();
                let problem = format!("`{argument}` is neither a motion file nor a generated motion");
                let remedy = format!("give an .npz, .bvh, .amc or .toml, or one of {}", names.join(", "));
                Err(Error::config("motion", problem, remedy))
            }
        }
    }
}
