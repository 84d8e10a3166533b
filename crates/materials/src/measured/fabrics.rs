//! The ten fabrics of Wang et al. 2011 as published, raw.

use caphy_core::units::KilogramPerSquareMetre;
use caphy_core::{Error, Result};
use serde::Deserialize;

/// Rows of the stretching table: row 0 unstretched, rows 1..=5 at stretch 7/6 and 0, 22.5, 45, 67.5, 90°.
pub const STRETCH_ROWS: usize = 6;
/// Columns of the stretching table: c11, c12, c22, c33.
pub const STRETCH_COLUMNS: usize = 4;
/// Rows of the bending table: fold line at 0, 45, 90° from the u axis.
pub const BEND_ROWS: usize = 3;
/// Columns of the bending table: curvature 0, 5, 10, 15, 20 1/m.
pub const BEND_COLUMNS: usize = 5;

/// The stretching table [N/m], raw: the evaluated stiffness is 2 max(0, interpolated entry). Shape [row][column].
pub type StretchEntries = [[f64; STRETCH_COLUMNS]; STRETCH_ROWS];
/// The bending table [N·m]. Shape [row][column].
pub type BendEntries = [[f64; BEND_COLUMNS]; BEND_ROWS];

/// One measured fabric.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct Fabric {
    /// Number m in 1..=10 of the shipped list.
    pub m: usize,
    /// Name, e.g. `gray-interlock`.
    pub name: String,
    /// What it is usually made into.
    pub typical_use: String,
    /// Fibres.
    pub composition: String,
    /// Area density.
    pub density: KilogramPerSquareMetre,
    /// Stretching table [N/m].
    pub stretching: StretchEntries,
    /// Bending table [N·m].
    pub bending: BendEntries,
}

#[derive(Deserialize)]
struct Catalogue {
    fabrics: Vec<Fabric>,
}

impl Fabric {
    /// All ten, in the order of the published list.
    ///
    /// # Errors
    /// [`Error::Format`] when the embedded catalogue was damaged before the build.
    pub fn all() -> Result<Vec<Self>> {
        serde_json::from_str::<Catalogue>(include_str!("../fabrics.json")).map(|c| c.fabrics).map_err(|problem| {
            Error::format(
                "fabrics.json",
                format!("line {}", problem.line()),
                problem.to_string(),
                "restore crates/materials/src/fabrics.json and build again",
            )
        })
    }

    /// The ten names.
    ///
    /// # Errors
    /// As [`Fabric::all`].
    pub fn names() -> Result<Vec<String>> {
        Ok(Self::all()?.into_iter().map(|f| f.name).collect())
    }

    /// The fabric of this name.
    ///
    /// # Errors
    /// [`Error::Config`] listing the ten names.
    pub fn named(name: &str) -> Result<Self> {
        let mut fabrics = Self::all()?;
        match fabrics.iter().position(|f| f.name == name) {
            Some(place) => Ok(fabrics.swap_remove(place)),
            None => {
                let names: Vec<&str> = fabrics.iter().map(|f| f.name.as_str()).collect();
                Err(Error::config(
                    "material.fabric",
                    format!("`{name}` is not a measured fabric"),
                    format!("choose one of: {}", names.join(", ")),
                ))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ten_fabrics_with_twenty_negative_entries_and_positive_bending() {
        let fabrics = Fabric::all().unwrap();
        assert_eq!(fabrics.len(), 10);
        assert!(fabrics.iter().enumerate().all(|(i, f)| f.m == i + 1 && f.density.0 > 0.05));
        let negative = |f: &Fabric| f.stretching.iter().flatten().filter(|c| **c < 0.0).count();
        assert_eq!(fabrics.iter().map(negative).sum::<usize>(), 20);
        assert!(fabrics.iter().all(|f| f.bending.iter().flatten().all(|c| *c > 0.0)));
    }

    #[test]
    fn an_unknown_name_lists_the_ten() {
        let error = Fabric::named("tweed").unwrap_err().to_string();
        for fabric in Fabric::all().unwrap() {
            assert!(error.contains(&fabric.name), "{error}");
        }
    }
}
