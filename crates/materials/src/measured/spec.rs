//! The keys of `[material] type = "measured"`.

use super::MaterialMeasured;
use super::custom::FabricTable;
use super::fabrics::Fabric;
use super::parameters::Entries;
use crate::exact;
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

/// All switches at once, as some program sets them; each can be overridden by its own key.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub enum Preset {
    /// Every switch at its own default.
    #[default]
    #[serde(rename = "default")]
    Default,
    /// ARCSim 0.2.1: orthotropic, table, frozen, faithful bending, rest length.
    #[serde(rename = "arcsim-0.2.1")]
    Arcsim021,
    /// ARCSim 0.3.1: the same with the current edge length.
    #[serde(rename = "arcsim-0.3.1")]
    Arcsim031,
}

/// The switches of a measured material, resolved.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Switches {
    /// What is made of the four constants.
    pub form: Form,
    /// How stiffness is found.
    pub lookup: StretchLookup,
    /// Whether the stress differentiates the stiffness.
    pub stiffness_gradient: StiffnessGradient,
    /// How a fold is looked up.
    pub bending: BendingLookup,
    /// Edge length in Eq. 7 and the bending lookup.
    pub edge_length: EdgeLength,
}

impl Preset {
    /// Its switches.
    pub fn switches(self) -> Switches {
        let arcsim = |edge_length| Switches { bending: BendingLookup::Faithful, edge_length, ..Switches::default() };
        match self {
            Self::Default => Switches::default(),
            Self::Arcsim021 => arcsim(EdgeLength::Rest),
            Self::Arcsim031 => arcsim(EdgeLength::Current),
        }
    }
}

/// The keys of `[material] type = "measured"`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MaterialMeasuredSpec {
    /// One of the ten names of [`Fabric::all`]. No default: a fabric is the user's choice.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fabric: Option<String>,
    /// All switches at once. Default `default`.
    #[serde(default)]
    pub preset: Preset,
    /// Default `orthotropic`: the measured model, which Eq. 5 abbreviates.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub form: Option<Form>,
    /// Default `table`: what the data's own simulator uses, continuous, and the faster one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lookup: Option<StretchLookup>,
    /// Default `frozen`: equals ARCSim's force and never pushes cloth longer.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stiffness_gradient: Option<StiffnessGradient>,
    /// Default `repaired`: the faithful lookup makes a fold's stiffness depend on the side its normals face.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub bending: Option<BendingLookup>,
    /// Default `rest`: bending energy is then a function of the angle alone.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub edge_length: Option<EdgeLength>,
    /// Factors on the columns c11, c12, c22, c33. Default 1: the fabric as measured.
    #[serde(default = "ones", deserialize_with = "exact::row")]
    pub membrane_multipliers: [f64; 4],
    /// Factors on the bending rows at 0, 45, 90°. Default 1: the fabric as measured.
    #[serde(default = "ones", deserialize_with = "exact::row")]
    pub bending_multipliers: [f64; 3],
    /// Area density [kg/m²]. Default: the fabric's own.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub density_kg_per_m2: Option<KilogramPerSquareMetre>,
    /// Measurements of your own, in place of `fabric`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub table: Option<FabricTable>,
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
        let (membrane_multipliers, bending_multipliers) = (ones(), ones());
        Self { fabric: Some(fabric.into()), membrane_multipliers, bending_multipliers, ..Self::default() }
    }

    /// The preset's switches with this table's own keys in their place.
    pub fn switches(&self) -> Switches {
        let preset = self.preset.switches();
        Switches {
            form: self.form.unwrap_or(preset.form),
            lookup: self.lookup.unwrap_or(preset.lookup),
            stiffness_gradient: self.stiffness_gradient.unwrap_or(preset.stiffness_gradient),
            bending: self.bending.unwrap_or(preset.bending),
            edge_length: self.edge_length.unwrap_or(preset.edge_length),
        }
    }

    /// The table behind `fabric` or `table`.
    fn source(&self) -> Result<FabricTable> {
        match (&self.fabric, &self.table) {
            (Some(name), None) => Ok(FabricTable::from(Fabric::named(name)?)),
            (None, Some(table)) => {
                table.check()?;
                Ok(table.clone())
            }
            (given, _) => Err(Error::config(
                "material.fabric",
                if given.is_some() { "is given together with `table`" } else { "is missing, and so is `table`" },
                format!("give one of the two: a table of your own, or one of {}", Fabric::names()?.join(", ")),
            )),
        }
    }

    /// The material itself, for callers that know its type.
    ///
    /// # Errors
    /// [`Error::Config`] naming the key, its value and the valid alternatives.
    pub fn build_measured(&self) -> Result<MaterialMeasured> {
        let (fabric, switches) = (self.source()?, self.switches());
        if switches.lookup == StretchLookup::Direct && switches.stiffness_gradient == StiffnessGradient::Full {
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
        let mut entries = Entries { stretching: fabric.stretching_n_per_m, bending: fabric.bending_nm };
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
        let density = self.density_kg_per_m2.unwrap_or(fabric.density_kg_per_m2);
        Ok(MaterialMeasured::assemble(&fabric.name, switches, entries, density))
    }
}

#[typetag::serde(name = "measured")]
impl MaterialSpec for MaterialMeasuredSpec {
    fn build(&self) -> Result<Box<dyn MaterialModel>> {
        Ok(Box::new(self.build_measured()?))
    }
}
