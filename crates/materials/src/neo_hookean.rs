//! Neo-Hookean sheet: a fabric that stiffens as it is squeezed, written as its energy alone.

use crate::bounds::bounded;
use crate::lame::{LameKeys, check_bending, check_density, check_lame};
use crate::stvk::{SNUG_BENDING, default_bending};
use caphy_core::energy_material::{EnergyFacts, EnergyMaterial, FromEnergy, HingeState, Scalar};
use caphy_core::material::{HingeLength, MaterialModel, MaterialSpec};
use caphy_core::params::Parameter;
use caphy_core::units::{KilogramPerSquareMetre, Metre, NewtonMetre, NewtonPerMetre, Pascal};
use caphy_core::{Error, Result};
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// det C below which ln det C is continued by its second-order Taylor polynomial: an area ratio of 0.1.
///
/// Energy, stress and tangent are continuous there. Without it a collapsed triangle (det C = 0) has infinite energy, and
/// strains that no deformation has, but that a solver may try, have none.
pub const JOINT: f64 = 0.01;

/// The keys of `[material] type = "neo_hookean"`.
///
/// Membrane constants come as exactly one group, as for `stvk`, and mean the same at small strains.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MaterialNeoHookeanSpec {
    /// λ, bulk in Pa. No default: a fabric is the user's choice.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lambda_pa: Option<Pascal>,
    /// μ, bulk in Pa.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mu_pa: Option<Pascal>,
    /// λ times thickness [N/m].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lambda_n_per_m: Option<NewtonPerMetre>,
    /// μ times thickness [N/m].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mu_n_per_m: Option<NewtonPerMetre>,
    /// Young's modulus E in Pa.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub young_pa: Option<Pascal>,
    /// Poisson's ratio ν, in (-1, 0.5].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub poisson: Option<f64>,
    /// Thickness t in m; needed with moduli in Pa, refused with constants in N/m, which already hold it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub thickness_m: Option<Metre>,
    /// k of Eq. 7 [N·m]. Default 3.95956e-5, as for `stvk`: the two differ in the membrane alone.
    #[serde(default = "default_bending")]
    pub bending_nm: NewtonMetre,
    /// Area density [kg/m²]. No default: without it the garment's weighed mass must be given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub density_kg_per_m2: Option<KilogramPerSquareMetre>,
    /// Edge length in Eq. 7. Default `rest`: the energy is then a function of the angle alone.
    #[serde(default)]
    pub hinge_length: HingeLength,
}

impl MaterialNeoHookeanSpec {
    /// The material itself, for callers that know its type.
    ///
    /// # Errors
    /// [`Error::Config`] naming the key, its value and the valid range or groups.
    pub fn build_neo_hookean(&self) -> Result<MaterialNeoHookean> {
        let keys = LameKeys {
            lambda_pa: self.lambda_pa,
            mu_pa: self.mu_pa,
            lambda_n_per_m: self.lambda_n_per_m,
            mu_n_per_m: self.mu_n_per_m,
            young_pa: self.young_pa,
            poisson: self.poisson,
            thickness_m: self.thickness_m,
        };
        let (lambda, mu) = keys.lame()?;
        let bending = check_bending(self.bending_nm)?;
        check_density(self.density_kg_per_m2)?;
        let parameters = [
            bounded("lambda".into(), NewtonPerMetre::SYMBOL, lambda.0, mu.0),
            bounded("mu".into(), NewtonPerMetre::SYMBOL, mu.0, mu.0),
            bounded("bending".into(), NewtonMetre::SYMBOL, bending.0, SNUG_BENDING),
        ];
        Ok(MaterialNeoHookean {
            values: [lambda.0, mu.0, bending.0],
            density: self.density_kg_per_m2,
            hinge_length: self.hinge_length,
            parameters: Arc::new(parameters),
        })
    }
}

#[typetag::serde(name = "neo_hookean")]
impl MaterialSpec for MaterialNeoHookeanSpec {
    fn build(&self) -> Result<Box<dyn MaterialModel>> {
        Ok(FromEnergy::boxed(self.build_neo_hookean()?))
    }
}

/// ψ = μ/2 (tr C − 2 − ln det C) + λ/8 (ln det C)², C = I + 2G, per rest area (Bonet and Wood, *Nonlinear Continuum
/// Mechanics*, Eq. 6.27, of a sheet), constant k (Eq. 7).
///
/// At small strains it is [`MaterialStvk`](crate::MaterialStvk) of the same λ and μ. Where StVK goes soft under compression
/// and gives way altogether, this one stiffens: use it for garments that are pushed together. Native parameters: `lambda`,
/// `mu` [N/m], `bending` [N·m]; energy and stress are linear in them.
///
/// # Limits
/// Below an area ratio of 0.1 ([`JOINT`]) the energy is continued so that it stays finite, and the last of the resistance is
/// lost with it: squeezed evenly toward a point, the sheet pushes back down to an area ratio of 0.005 for λ ≥ 0, 0.05 for
/// λ ≥ −0.3 μ, and only 0.21 for λ = −0.5 μ. Squeezed along one axis it pushes back all the way for λ ≥ −0.3 μ. Nothing here
/// keeps a triangle from turning over: det C does not see which side is up.
///
/// The source is this energy and nothing else: stress, tangents and sensitivities are derived from it
/// ([`caphy_core::energy_material`]).
#[derive(Debug, Clone)]
pub struct MaterialNeoHookean {
    values: [f64; 3],
    density: Option<KilogramPerSquareMetre>,
    hinge_length: HingeLength,
    /// Names and bounds as built; copies with other values keep the bounds.
    parameters: Arc<[Parameter; 3]>,
}

impl EnergyMaterial for MaterialNeoHookean {
    /// ψ grows with the eighth power below the joint. Tenfold stretch both ways is 70, far outside of what cloth does; at
    /// twice this, strains that no deformation has cost 1e35 J/m² with the largest λ.
    const LARGEST_STRAIN: f64 = 100.0;

    fn facts(&self) -> EnergyFacts {
        EnergyFacts {
            name: "neo_hookean".into(),
            density: self.density,
            hinge_length: self.hinge_length,
            linear_in_parameters: true,
        }
    }
    fn parameters(&self) -> Vec<Parameter> {
        self.parameters.iter().zip(self.values).map(|(p, value)| Parameter { value, ..p.clone() }).collect()
    }
    fn with_values(&self, values: &[f64]) -> Result<Self> {
        let &[lambda, mu, bending] = values else {
            return Err(Error::Length { what: "parameter values".into(), expected: 3, got: values.len() });
        };
        check_lame(lambda, mu)?;
        Ok(Self { values: [lambda, mu, bending], ..self.clone() })
    }

    #[inline(always)]
    fn energy<S: Scalar>(&self, theta: &[S], [u, v, w]: [S; 3]) -> S {
        let (lambda, mu) = (theta[0], theta[1]);
        // det C = 1 + x with x = 2 tr G + 4 det G; written in x, nothing cancels at small strains.
        let det_green = u * v - w * w;
        let x = (u + v).times(2.0) + det_green.times(4.0);
        let inside = x.max(S::constant(JOINT - 1.0));
        // Below the joint ln det C goes on as its Taylor polynomial; r is 0 above it.
        let r = (x - inside).times(1.0 / JOINT);
        let x_less_log = inside.less_ln_1p() + (x - inside) - r + r.squared().times(0.5);
        let log = x - x_less_log;
        mu * (x_less_log - det_green.times(4.0)).times(0.5) + lambda * log.squared().times(0.125)
    }

    #[inline(always)]
    fn bending_stiffness<S: Scalar>(&self, theta: &[S], _: &HingeState<S>) -> S {
        theta[2]
    }
}
