//! Measurements of the user's own, in the form of the published ones.

use super::fabrics::{BEND_COLUMNS, BEND_ROWS, BendEntries, Fabric, STRETCH_COLUMNS, STRETCH_ROWS, StretchEntries};
use crate::bounds::LARGEST_STIFFNESS;
use crate::exact;
use crate::lame::check_density;
use caphy_core::units::KilogramPerSquareMetre;
use caphy_core::{Error, Result};
use serde::{Deserialize, Serialize};

/// A fabric's tables, as `[material.table]` gives them.
///
/// # What is refused
/// * Entries that are not finite, or larger than 1e9.
/// * c11 or c22 that are not positive, in any row: a sheet without tension along one of its yarns.
/// * An unstretched row with c12² > c11 c22 (negative c12 counts as 0): at rest the sheet would fold itself up.
/// * Negative bending entries.
///
/// c12 and c33 may be negative, as 20 of the published ones are: the interpolation is clamped at 0. Stretched rows may have
/// c12² > c11 c22, as navy-sparkle-sweat has: a Newton solver projects such tangents.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FabricTable {
    /// Name for reports. Default `custom`.
    #[serde(default = "custom")]
    pub name: String,
    /// Area density [kg/m²].
    pub density_kg_per_m2: KilogramPerSquareMetre,
    /// c11, c12, c22, c33 [N/m], raw (the stiffness is twice the interpolated entry): unstretched, then at stretch 7/6 and 0,
    /// 22.5, 45, 67.5, 90° from u. Shape [6][4].
    #[serde(deserialize_with = "exact::rows")]
    pub stretching_n_per_m: StretchEntries,
    /// Bending stiffness [N·m] for fold lines at 0, 45, 90° from u and curvatures 0, 5, 10, 15, 20 1/m. Shape [3][5].
    #[serde(deserialize_with = "exact::rows")]
    pub bending_nm: BendEntries,
}

fn custom() -> String {
    "custom".into()
}

impl From<Fabric> for FabricTable {
    fn from(fabric: Fabric) -> Self {
        Self {
            name: fabric.name,
            density_kg_per_m2: fabric.density,
            stretching_n_per_m: fabric.stretching,
            bending_nm: fabric.bending,
        }
    }
}

impl FabricTable {
    /// `Ok` for tables that make a sheet.
    ///
    /// # Errors
    /// [`Error::Config`] naming row and column.
    pub(super) fn check(&self) -> Result<()> {
        const NAMES: [&str; STRETCH_COLUMNS] = ["c11", "c12", "c22", "c33"];
        let refuse = |key: String, problem: String, remedy: &str| Err(Error::config(key, problem, remedy));
        check_density(Some(self.density_kg_per_m2))?;
        for row in 0..STRETCH_ROWS {
            for column in 0..STRETCH_COLUMNS {
                let value = self.stretching_n_per_m[row][column];
                let key = || format!("material.table.stretching_n_per_m[{row}][{column}]");
                if value.is_nan() || value.abs() > LARGEST_STIFFNESS {
                    let problem = format!("{} = {value} N/m is not a stiffness", NAMES[column]);
                    return refuse(key(), problem, "give a finite value of at most 1e9 N/m");
                }
                if column % 2 == 0 && value <= 0.0 {
                    let problem = format!("{} = {value} N/m: the sheet has no tension along a yarn", NAMES[column]);
                    return refuse(key(), problem, "give positive values for c11 and c22");
                }
            }
        }
        let [c11, c12, c22, _] = self.stretching_n_per_m[0];
        if c12.max(0.0).powi(2) > c11 * c22 {
            let problem = format!("c12 = {c12} N/m with c11 = {c11} and c22 = {c22}: indefinite, c12² exceeds c11 c22");
            return refuse("material.table.stretching_n_per_m[0][1]".into(), problem, "give a smaller c12");
        }
        for row in 0..BEND_ROWS {
            for column in 0..BEND_COLUMNS {
                let value = self.bending_nm[row][column];
                if !(0.0..=LARGEST_STIFFNESS).contains(&value) {
                    let key = format!("material.table.bending_nm[{row}][{column}]");
                    return refuse(
                        key,
                        format!("{value} N·m is not a bending stiffness"),
                        "give a value in [0, 1e9] N·m",
                    );
                }
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_published_tables_pass() {
        for fabric in Fabric::all().unwrap() {
            FabricTable::from(fabric).check().unwrap();
        }
    }
}
