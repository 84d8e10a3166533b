//! The stability atlas: where in strain and curvature a fabric's energy is finite, its gradient right, its tangent positive.
//!
//! Asked of the material alone, by the block calls that energies use, in both precisions; of linked fabrics and loaded ones.

mod ask;
mod atlas;
mod page;
mod random;

pub use atlas::{Atlas, Fold, Membrane, Precision, ROUNDINGS, State, Summary};
pub use page::{strain_map, table, write};
pub use random::{RandomStates, random_states};

use crate::inputs;
use crate::plugins::{Kind, Plugins};
use caphy_core::material::MaterialModel;
use caphy_core::{Error, Result};
use caphy_materials::measured::Fabric;

/// A fabric of an atlas: name and material.
pub type Named = (String, Box<dyn MaterialModel>);

/// SNUG's constants, for types that need some.
const CONSTANTS: &str = "young_pa = 0.7e5\npoisson = 0.485\nthickness_m = 4.7e-4\n";

/// The material that an argument names (see [`inputs::material`]), or for `all`: the ten measured fabrics, each linked type with
/// constants, and every loaded type.
///
/// # Errors
/// As [`inputs::material`].
pub fn materials(argument: &str, plugins: &Plugins) -> Result<Vec<Named>> {
    if argument != "all" {
        return Ok(vec![(argument.to_string(), inputs::material(argument, plugins)?)]);
    }
    let mut out = Vec::new();
    for fabric in Fabric::all()? {
        out.push((fabric.name.clone(), inputs::material(&fabric.name, plugins)?));
    }
    for name in plugins.names(Kind::Material) {
        if name == "measured" {
            continue;
        }
        let table = match plugins.library(Kind::Material, &name) {
            Some(_) => format!("type = \"{name}\"\n"),
            None => format!("type = \"{name}\"\n{CONSTANTS}"),
        };
        let table = crate::plugins::PluginTable::parse(plugins, Kind::Material, std::path::Path::new(&name), &table);
        let made = table.and_then(|table| table.material("material"));
        let material = made.map_err(|e| {
            Error::config(name.clone(), e.to_string(), "write its table into a .toml and name that with --material")
        })?;
        out.push((name, material));
    }
    Ok(out)
}
