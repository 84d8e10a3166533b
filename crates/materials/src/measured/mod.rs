//! The ten measured fabrics: four membrane constants by strain, bending stiffness by fold direction and curvature.
//!
//! The mathematics is ARCSim's evaluation of the tables of Wang et al. 2011, written from its description. Where it
//! departs: shear energy (its energy routine has half the shear term of its force; here they agree), the bending lookup
//! (`repaired` unless asked), and double or single precision throughout (its angles pass through single precision,
//! 1e-4 N/m).

mod bending;
mod custom;
mod fabrics;
mod isotropic;
mod membrane;
mod parameters;
mod point;
mod sample_point;
mod spec;
mod stretch_table;

pub use custom::FabricTable;
pub use fabrics::{BEND_COLUMNS, BEND_ROWS, BendEntries, Fabric, STRETCH_COLUMNS, STRETCH_ROWS, StretchEntries};
pub use isotropic::{average_lame, principal_lame};
pub use parameters::PARAMETERS;
pub use spec::{
    BendingLookup, EdgeLength, Form, MaterialMeasuredSpec, Preset, StiffnessGradient, StretchLookup, Switches,
};

use crate::bounds::{STRAIN_LIMITS, limit};
use bending::{BendCurves, hinge_by_table};
use caphy_core::material::{HingeCall, HingeLength, MaterialDescription, MaterialModel, MaterialOutputs, MembraneCall};
use caphy_core::params::{Parameter, check_values};
use caphy_core::units::KilogramPerSquareMetre;
use caphy_core::{Error, Result, strain_limit};
use membrane::Rule;
use parameters::Entries;
use point::{PointLookup, membrane_by_point};
use std::sync::Arc;
use stretch_table::{StretchTable, membrane_by_table};

/// One of the ten fabrics, or one with other table entries.
///
/// Native parameters (39): the 24 stretching entries `c11[row 0]` … `c33[row 5]` [N/m], raw (the stiffness is twice the
/// clamped interpolation), then the 15 bending entries `bend[row 0, column 0]` … [N·m]. Multipliers of the configuration
/// are already in them. Bounds: positive entries within 1e-3 and 1e3 times their start; the negative ones within 1e3 times
/// their size.
///
/// Energy and stress are linear in the entries except where the clamp max(0, ·) is active; there the derivative is 0.
///
/// ```
/// use caphy_core::material::{MaterialModel, MembraneBlock};
/// use caphy_materials::MaterialMeasuredSpec;
/// let material = MaterialMeasuredSpec::new("gray-interlock").build_measured()?;
/// let mut stiffness = [0.0f64; 4];
/// let mut block = MembraneBlock::new(1, &[0.0, 0.0, 0.0]);
/// block.stiffness = (&mut stiffness[..]).into();
/// material.membrane((&mut block).into())?;
/// assert!((stiffness[0] - 41.64).abs() < 0.005 && (stiffness[3] - 66.89).abs() < 0.005);
/// # Ok::<(), caphy_core::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct MaterialMeasured {
    fabric: String,
    density: KilogramPerSquareMetre,
    switches: Switches,
    entries: Entries,
    /// Names and bounds as built; copies with other values keep the bounds.
    parameters: Arc<Vec<Parameter>>,
    /// `None` for the direct lookup.
    table: Option<Arc<StretchTable>>,
}

impl MaterialMeasured {
    fn assemble(name: &str, switches: Switches, entries: Entries, density: KilogramPerSquareMetre) -> Self {
        let table = match switches.lookup {
            StretchLookup::Table => Some(Arc::new(StretchTable::new(&entries.stretching))),
            StretchLookup::Direct => None,
        };
        let parameters = Arc::new(entries.parameters());
        Self { fabric: name.into(), density, switches, entries, parameters, table }
    }

    /// Name of the fabric that it started from.
    pub fn fabric(&self) -> &str {
        &self.fabric
    }
    /// Stretching entries in use [N/m], raw.
    pub fn stretching(&self) -> &StretchEntries {
        &self.entries.stretching
    }
    /// Bending entries in use [N·m].
    pub fn bending(&self) -> &BendEntries {
        &self.entries.bending
    }

    /// How it is evaluated.
    pub fn switches(&self) -> Switches {
        self.switches
    }

    fn rule(&self) -> Rule {
        Rule { form: self.switches.form, gradient: self.switches.stiffness_gradient }
    }
}

impl MaterialModel for MaterialMeasured {
    fn describe(&self) -> MaterialDescription {
        MaterialDescription {
            name: "measured".into(),
            density: Some(self.density),
            stiffness_frozen: self.switches.stiffness_gradient == StiffnessGradient::Frozen,
            hinge_length: match self.switches.edge_length {
                EdgeLength::Rest => HingeLength::Rest,
                EdgeLength::Current => HingeLength::CurrentHeld,
            },
            linear_in_parameters: true,
            offers: MaterialOutputs::ALL,
        }
    }

    fn membrane(&self, call: MembraneCall<'_, '_>) -> Result<()> {
        let rule = self.rule();
        match call {
            MembraneCall::F32(block) => {
                block.check(PARAMETERS)?;
                strain_limit::within(limit::<f32>(), block, |block| match &self.table {
                    Some(table) => membrane_by_table(table.single(), rule, block),
                    None => membrane_by_point(PointLookup::new(self.stretching()), rule, block),
                });
            }
            MembraneCall::F64(block) => {
                block.check(PARAMETERS)?;
                strain_limit::within(limit::<f64>(), block, |block| match &self.table {
                    Some(table) => membrane_by_table(table.double(), rule, block),
                    None => membrane_by_point(PointLookup::new(self.stretching()), rule, block),
                });
            }
        }
        Ok(())
    }

    fn hinge(&self, call: HingeCall<'_, '_>) -> Result<()> {
        match call {
            HingeCall::F32(block) => {
                block.check(PARAMETERS)?;
                hinge_by_table(BendCurves::new(self.bending()), self.switches.bending, block);
            }
            HingeCall::F64(block) => {
                block.check(PARAMETERS)?;
                hinge_by_table(BendCurves::new(self.bending()), self.switches.bending, block);
            }
        }
        Ok(())
    }

    fn strain_limits(&self) -> Option<[f64; 2]> {
        Some(STRAIN_LIMITS)
    }

    fn parameters(&self) -> Vec<Parameter> {
        let values = self.entries.values();
        self.parameters.iter().zip(values).map(|(p, value)| Parameter { value, ..p.clone() }).collect()
    }

    fn with_parameters(&self, values: &[f64]) -> Result<Box<dyn MaterialModel>> {
        check_values(&self.parameters, values)?;
        let values: &[f64; PARAMETERS] = values.try_into().map_err(|_| Error::Length {
            what: "parameter values".into(),
            expected: PARAMETERS,
            got: values.len(),
        })?;
        let entries = Entries::from_values(values);
        let table = match &self.table {
            // Bending alone changed: the stretching table is shared.
            Some(table) if entries.stretching == self.entries.stretching => Some(Arc::clone(table)),
            Some(table) => Some(Arc::new(table.with_entries(&entries.stretching))),
            None => None,
        };
        Ok(Box::new(Self { entries, table, ..self.clone() }))
    }
}
