//! `type = "woven"`: a sheet of two yarn systems, as a plugin library.
//!
//! ψ = ½ k0 Guu² + k1 Guu Gvv + ½ k2 Gvv² + k3 Guv², with a bending stiffness between a value for folds along u and one for
//! folds along v. Only the energy is written here: stress, tangents and derivatives by the parameters follow from it.

use caphy_core::energy_material::{EnergyFacts, EnergyMaterial, FromEnergy, HingeState, Scalar};
use caphy_core::material::{MaterialModel, MaterialSpec};
use caphy_core::params::Parameter;
use caphy_core::units::KilogramPerSquareMetre;
use caphy_core::{Error, Result};
use serde::{Deserialize, Serialize};

/// The keys of `type = "woven"`. Defaults: a light cotton.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct MaterialWovenSpec {
    /// Stiffness along u, coupling, stiffness along v, shear [N/m].
    k0: f64,
    k1: f64,
    k2: f64,
    k3: f64,
    /// Bending stiffness of folds along u and along v [N·m].
    bend_u: f64,
    bend_v: f64,
    /// Area density [kg/m²].
    density: f64,
}

impl Default for MaterialWovenSpec {
    fn default() -> Self {
        Self { k0: 500.0, k1: 40.0, k2: 400.0, k3: 20.0, bend_u: 4e-5, bend_v: 3e-5, density: 0.15 }
    }
}

const NAMES: [(&str, &str); 6] =
    [("k0", "N/m"), ("k1", "N/m"), ("k2", "N/m"), ("k3", "N/m"), ("bend_u", "N·m"), ("bend_v", "N·m")];

#[typetag::serde(name = "woven")]
impl MaterialSpec for MaterialWovenSpec {
    fn build(&self) -> Result<Box<dyn MaterialModel>> {
        let values = [self.k0, self.k1, self.k2, self.k3, self.bend_u, self.bend_v];
        if !(self.density > 0.0 && self.density.is_finite()) {
            return Err(Error::config("density", format!("{} kg/m²", self.density), "give a positive value"));
        }
        let material = MaterialWoven { values, density: self.density };
        for p in material.parameters() {
            p.check().map_err(|e| Error::config(&p.name, e.to_string(), "give a value within"))?;
        }
        Ok(FromEnergy::boxed(material.with_values(&values)?))
    }
}

#[derive(Debug, Clone)]
struct MaterialWoven {
    values: [f64; 6],
    density: f64,
}

impl EnergyMaterial for MaterialWoven {
    fn facts(&self) -> EnergyFacts {
        EnergyFacts {
            density: Some(KilogramPerSquareMetre(self.density)),
            linear_in_parameters: true,
            ..EnergyFacts::named("woven")
        }
    }
    fn parameters(&self) -> Vec<Parameter> {
        let one = |((name, unit), value): (&(&str, &str), f64)| Parameter {
            name: (*name).into(),
            unit: (*unit).into(),
            value,
            lower: 0.0,
            upper: 1e6,
        };
        NAMES.iter().zip(self.values).map(one).collect()
    }
    fn with_values(&self, values: &[f64]) -> Result<Self> {
        let mut changed = self.clone();
        Error::check_length("parameter values", changed.values.len(), values.len())?;
        changed.values.copy_from_slice(values);
        let [k0, k1, k2, ..] = changed.values;
        if k1 * k1 > k0 * k2 {
            return Err(Error::config("k1", format!("{k1} N/m: k1² exceeds k0 k2"), "give a smaller k1"));
        }
        Ok(changed)
    }
    #[inline(always)]
    fn energy<S: Scalar>(&self, k: &[S], [u, v, w]: [S; 3]) -> S {
        (k[0] * u * u + k[2] * v * v).times(0.5) + k[1] * u * v + k[3] * w * w
    }
    #[inline(always)]
    fn bending_stiffness<S: Scalar>(&self, k: &[S], hinge: &HingeState<S>) -> S {
        let side = |[du, dv]: [S; 2]| {
            let (u, v) = (du.squared(), dv.squared());
            // A direction of no length folds along v.
            let along_u = u / (u + v + S::constant(1e-30));
            k[5] + (k[4] - k[5]) * along_u
        };
        (side(hinge.directions[0]) + side(hinge.directions[1])).times(0.5)
    }
}

caphy_core::export_plugin! { materials: ["woven"], nets: [] }
