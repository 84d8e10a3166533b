//! The easy way to write a material: its energy, once, generic over the scalar.
//!
//! An author implements [`EnergyMaterial`]; [`FromEnergy`] makes a full [`MaterialModel`] of it. Stress, tangents and
//! derivatives by the parameters come from dual numbers, exact, in both precisions, in the processor's vector units. Who
//! wants the stress faster writes it by hand ([`EnergyMaterial::stress`]).
//!
//! A complete material:
//!
//! ```
//! use caphy_core::energy_material::{EnergyFacts, EnergyMaterial, FromEnergy, HingeState, Scalar};
//! use caphy_core::extension::MaterialModelExt;
//! use caphy_core::material::{MaterialModel, MaterialSpec};
//! use caphy_core::params::Parameter;
//! use caphy_core::Result;
//!
//! /// `type = "springy"`: a sheet that resists the square of its strain's trace.
//! #[derive(Debug, Clone, serde::Serialize, serde::Deserialize)]
//! #[serde(deny_unknown_fields)]
//! struct MaterialSpringySpec {
//!     /// Stiffness [N/m].
//!     stiffness_n_per_m: f64,
//! }
//!
//! #[derive(Clone)]
//! struct MaterialSpringy(f64);
//!
//! impl EnergyMaterial for MaterialSpringy {
//!     fn facts(&self) -> EnergyFacts {
//!         EnergyFacts { linear_in_parameters: true, ..EnergyFacts::named("springy") }
//!     }
//!     fn parameters(&self) -> Vec<Parameter> {
//!         let (name, unit) = ("stiffness".into(), "N/m".into());
//!         vec![Parameter { name, unit, value: self.0, lower: 0.0, upper: 1e6 }]
//!     }
//!     fn with_values(&self, values: &[f64]) -> Result<Self> {
//!         Ok(Self(values[0]))
//!     }
//!     #[inline(always)]
//!     fn energy<S: Scalar>(&self, theta: &[S], [uu, vv, uv]: [S; 3]) -> S {
//!         theta[0] * ((uu + vv).squared() + (uu - vv).squared() + uv.squared()).times(0.5)
//!     }
//!     #[inline(always)]
//!     fn bending_stiffness<S: Scalar>(&self, theta: &[S], _: &HingeState<S>) -> S {
//!         theta[0].times(1e-6) // [N·m]
//!     }
//! }
//!
//! #[typetag::serde(name = "springy")]
//! impl MaterialSpec for MaterialSpringySpec {
//!     fn build(&self) -> Result<Box<dyn MaterialModel>> {
//!         Ok(FromEnergy::boxed(MaterialSpringy(self.stiffness_n_per_m)))
//!     }
//! }
//!
//! let fabric = MaterialSpringySpec { stiffness_n_per_m: 10.0 }.build()?;
//! assert_eq!(fabric.at([0.1, 0.0, 0.2])?.stress, [2.0, 0.0, 1.0]); // Suv is half of ∂ψ/∂Guv
//! # Ok::<(), caphy_core::Error>(())
//! ```

mod dual;
mod model;

pub use dual::{Dual, PlainScalar, Scalar};
pub use model::FromEnergy;

use crate::Result;
use crate::material::HingeLength;
use crate::params::Parameter;
use crate::units::KilogramPerSquareMetre;

/// What callers need to know of an [`EnergyMaterial`].
#[derive(Debug, Clone, PartialEq)]
pub struct EnergyFacts {
    /// The `type` name in TOML.
    pub name: String,
    /// Area density, when the material knows it.
    pub density: Option<KilogramPerSquareMetre>,
    /// Rule for the edge length in bending.
    pub hinge_length: HingeLength,
    /// Whether energy and bending stiffness are linear in the parameters.
    pub linear_in_parameters: bool,
}

impl EnergyFacts {
    /// A name and nothing else known.
    pub fn named(name: &str) -> Self {
        Self { name: name.into(), density: None, hinge_length: HingeLength::Rest, linear_in_parameters: false }
    }
}

/// One hinge (fields of [`HingeBlock`](crate::material::HingeBlock)).
#[derive(Debug, Clone, Copy)]
pub struct HingeState<S> {
    /// Dihedral angle [rad].
    pub angle: S,
    /// Rest dihedral angle [rad].
    pub angle_rest: S,
    /// Edge length by the material's rule [m].
    pub length: S,
    /// Sum of both rest areas [m²].
    pub area: S,
    /// Material direction (du, dv) of the edge on both sides, any length.
    pub directions: [[S; 2]; 2],
}

/// A hyperelastic fabric by its energy.
///
/// # Promise
/// `energy` is zero with zero slope at zero strain, and finite with finite derivatives for every strain up to twice
/// [`EnergyMaterial::LARGEST_STRAIN`], physical (C = I + 2G positive) or not. `bending_stiffness` is finite and not negative
/// for every finite hinge, zero lengths and areas included. Both are plain arithmetic of [`Scalar`]s; mark them
/// `#[inline(always)]`, or they leave the vector loops.
///
/// # Units
/// As in [`MaterialModel`](crate::material::MaterialModel): J/m² of rest area, N·m.
pub trait EnergyMaterial: Clone + Send + Sync + 'static {
    /// Strains larger than this, √(G:G), are drawn back to at most twice it ([`crate::strain_limit`]), so that an energy that grows
    /// with a high power stays finite: |ψ| must stay below 1e38 at twice this with the largest allowed parameters. At least 1.
    const LARGEST_STRAIN: f64 = 1e6;

    /// Name and conventions.
    fn facts(&self) -> EnergyFacts;
    /// Native parameters Θ with their present values and bounds.
    fn parameters(&self) -> Vec<Parameter>;
    /// The same material with other values, which are within bounds and of the right number.
    ///
    /// # Errors
    /// [`crate::Error::Parameter`] for combinations that do not make a material.
    fn with_values(&self, values: &[f64]) -> Result<Self>;
    /// ψ(Θ, G) [J/m²] (Eq. 5).
    fn energy<S: Scalar>(&self, theta: &[S], green: [S; 3]) -> S;
    /// k(Θ, hinge) of Eq. 7 [N·m].
    fn bending_stiffness<S: Scalar>(&self, theta: &[S], hinge: &HingeState<S>) -> S;
    /// (Suu, Svv, Suv) [N/m] by hand, Suv half of ∂ψ/∂Guv. Default `None`: from the energy.
    #[inline(always)]
    fn stress<S: Scalar>(&self, theta: &[S], green: [S; 3]) -> Option<[S; 3]> {
        let _ = (theta, green);
        None
    }
}
