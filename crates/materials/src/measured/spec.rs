//! The keys of `[material] type = "measured"`.

use super::MaterialMeasured;
use super::fabrics::Fabric;
use super::parameters::Entries;
use crate::lame::check_density;
use caphy_core::material::{MaterialModel, MaterialSpec};
use caphy_core::units::KilogramPerSquareMetre;
use caphy_core::{Error, Result};
use serde::{Deserialize, Serialize};

/// What is made of the four looked-up constants.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Form {
    /// The four-constant sheet itself.
    #[default]
    Orthotropic,
    /// Its rotational average, the literal Eq. 5: anisotropy survives only through the lookup, and the two stiff wovens
    /// shear far too stiffly.
    Isotropic,
}

/// How stiffness is found from strain.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum StretchLookup {
    /// ARCSim's 30³ table, trilinear.
    #[default]
    Table,
    /// The published rows at the exact principal strain and angle; jumps at equal principal strains.
    Direct,
}

/// Whether the stress differentiates the stiffness.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum StiffnessGradient {
    /// No: ARCSim's force.
    #[default]
    Frozen,
    /// Yes: the energy's gradient, with its kinks and, for some fabrics, negative tension.
    Full,
}

/// How a fold is looked up in the bending table.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum BendingLookup {
    /// |θ − θ_rest|, held inside the table.
    #[default]
    Repaired,
    /// θ itself; folds away from the normal side extrapolate the first segment, as in ARCSim.
    Faithful,
}

/// Edge length in Eq. 7 and in the bending lookup.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum EdgeLength {
    /// The rest length (ARCSim 0.2.1).
    #[default]
    Rest,
    /// The deformed length, held while differentiating (ARCSim 0.3.1).
    Current,
}

/// The keys of `[material] type = "measured"`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MaterialMeasuredSpec {
    /// One of the ten names of [`Fabric::all`]. No default: a fabric is the user's choice.
    pub fabric: String,
    /// Default `orthotropic`: the measured model, which Eq. 5 abbreviates.
    #[serde(default)]
    pub form: Form,
    /// Default `table`: what the data's own simulator uses, continuous, and the faster one.
    #[serde(default)]
    pub lookup: StretchLookup,
    /// Default `frozen`: equals ARCSim's force and never pushes cloth longer.
    #[serde(default)]
    pub stiffness_gradient: StiffnessGradient,
    /// Default `repaired`: the faithful lookup makes a fold's stiffness depend on the side its normals face.
    #[serde(default)]
    pub bending: BendingLookup,
    /// Default `rest`: bending energy is then a function of the angle alone.
    #[serde(default)]
    pub edge_length: EdgeLength,
    /// Factors on the columns c11, c12, c22, c33. Default 1: the fabric as measured.
    #[serde(default = "ones")]
    pub membrane_multipliers: [f64; 4],
    /// Factors on the bending rows at 0, 45, 90°. Default 1: the fabric as measured.
    #[serde(default = "ones")]
    pub bending_multipliers: [f64; 3],
    /// Area density [kg/m²]. Default: the fabric's own.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub density_kg_per_m2: Option<KilogramPerSquareMetre>,
}

fn ones<const N: usize>() -> [f64; N] {
    [1.0; N]
}

/// Multipliers allowed: the same three decades that fabric estimation has.
const MULTIPLIERS: std::ops::RangeInclusive<f64> = 1e-3..=1e3;

fn check_multipliers(key: &str, values: &[f64]) -> Result<()> {
    match values.iter().find(|m| !MULTIPLIERS.contains(m)) {
        None => Ok(()),
        Some(bad) => Err(Error::config(
            key,
            format!("{bad} is not a multiplier"),
            format!("give values in [{:e}, {:e}]", MULTIPLIERS.start(), MULTIPLIERS.end()),
        )),
    }
}

impl MaterialMeasuredSpec {
    /// A fabric with every other key at its default.
    pub fn new(fabric: impl Into<String>) -> Self {
        Self {
            fabric: fabric.into(),
            form: Form::default(),
            lookup: StretchLookup::default(),
            stiffness_gradient: StiffnessGradient::default(),
            bending: BendingLookup::default(),
            edge_length: EdgeLength::default(),
            membrane_multipliers: ones(),
            bending_multipliers: ones(),
            density_kg_per_m2: None,
        }
    }

    /// The material itself, for callers that know its type.
    ///
    /// # Errors
    /// [`Error::Config`] naming the key, its value and the valid alternatives.
    pub fn build_measured(&self) -> Result<MaterialMeasured> {
        let fabric = Fabric::named(&self.fabric)?;
        if self.lookup == StretchLookup::Direct && self.stiffness_gradient == StiffnessGradient::Full {
            return Err(Error::config(
                "material.stiffness_gradient",
                "`full` needs a continuous stiffness, which `lookup = \"direct\"` is not",
                "use lookup = \"table\", or stiffness_gradient = \"frozen\"",
            ));
        }
        check_multipliers("material.membrane_multipliers", &self.membrane_multipliers)?;
        check_multipliers("material.bending_multipliers", &self.bending_multipliers)?;
        check_density(self.density_kg_per_m2)?;
        // A positive factor commutes with max(0, ·): multiplying entries equals multiplying stiffnesses.
        let mut entries = Entries { stretching: fabric.stretching, bending: fabric.bending };
        for row in &mut entries.stretching {
            for (entry, factor) in row.iter_mut().zip(self.membrane_multipliers) {
                *entry *= factor;
            }
        }
        for (row, factor) in entries.bending.iter_mut().zip(self.bending_multipliers) {
            for entry in row {
                *entry *= factor;
            }
        }
        Ok(MaterialMeasured::assemble(self, entries, self.density_kg_per_m2.unwrap_or(fabric.density)))
    }
}

#[typetag::serde(name = "measured")]
impl MaterialSpec for MaterialMeasuredSpec {
    fn build(&self) -> Result<Box<dyn MaterialModel>> {
        Ok(Box::new(self.build_measured()?))
    }
}
