//! The 39 native parameters Θ of a measured fabric: 24 stretching entries, then 15 bending entries, row by row.

use super::fabrics::{BEND_COLUMNS, BEND_ROWS, BendEntries, STRETCH_COLUMNS, STRETCH_ROWS, StretchEntries};
use crate::bounds::bounded;
use caphy_core::params::Parameter;
use caphy_core::units::{NewtonMetre, NewtonPerMetre};

/// Number of stretching entries, which come first.
pub(super) const STRETCH_PARAMETERS: usize = STRETCH_ROWS * STRETCH_COLUMNS;
/// Number of all native parameters.
pub const PARAMETERS: usize = STRETCH_PARAMETERS + BEND_ROWS * BEND_COLUMNS;

const COLUMN_NAMES: [&str; STRETCH_COLUMNS] = ["c11", "c12", "c22", "c33"];

/// Table entries of one material: published ones times the multipliers, or estimated ones.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Entries {
    pub(super) stretching: StretchEntries,
    pub(super) bending: BendEntries,
}

impl Entries {
    /// All values in parameter order.
    pub(super) fn values(&self) -> [f64; PARAMETERS] {
        let mut values = [0.0; PARAMETERS];
        let flat = self.stretching.iter().flatten().chain(self.bending.iter().flatten());
        for (value, entry) in values.iter_mut().zip(flat) {
            *value = *entry;
        }
        values
    }
    /// From values in parameter order.
    pub(super) fn from_values(values: &[f64; PARAMETERS]) -> Self {
        Self {
            stretching: std::array::from_fn(|r| std::array::from_fn(|a| values[r * STRETCH_COLUMNS + a])),
            bending: std::array::from_fn(|r| {
                std::array::from_fn(|j| values[STRETCH_PARAMETERS + r * BEND_COLUMNS + j])
            }),
        }
    }
    /// Named parameters with bounds around these values.
    pub(super) fn parameters(&self) -> Vec<Parameter> {
        let mut parameters = Vec::with_capacity(PARAMETERS);
        for (r, row) in self.stretching.iter().enumerate() {
            for (column, value) in COLUMN_NAMES.iter().zip(row) {
                // No published entry is zero; 1 N/m would be the scale of one that is.
                parameters.push(bounded(format!("{column}[row {r}]"), NewtonPerMetre::SYMBOL, *value, 1.0));
            }
        }
        for (r, row) in self.bending.iter().enumerate() {
            for (j, value) in row.iter().enumerate() {
                parameters.push(bounded(format!("bend[row {r}, column {j}]"), NewtonMetre::SYMBOL, *value, 1e-5));
            }
        }
        parameters
    }
}
