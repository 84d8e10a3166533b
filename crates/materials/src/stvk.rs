//! Plain Saint Venant-Kirchhoff sheet: two membrane constants, one bending constant (Eqs. 5 and 7).

use crate::bounds::{STRAIN_LIMITS, bounded, limit};
use crate::lame::{LameKeys, check_bending, check_density, check_lame};
use caphy_core::material::{
    HingeBlock, HingeCall, HingeLength, MaterialDescription, MaterialModel, MaterialOutputs, MaterialSpec,
    MembraneBlock, MembraneCall,
};
use caphy_core::params::{Parameter, check_values};
use caphy_core::units::{KilogramPerSquareMetre, Metre, NewtonMetre, NewtonPerMetre, Pascal};
use caphy_core::{Error, Real, Result, simd_kernel, strain_limit};
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// SNUG's bending constant [N·m]: 50 E t³ / (12 (1−ν²)).
pub(crate) const SNUG_BENDING: f64 = 3.959_56e-5;

/// The keys of `[material] type = "stvk"`.
///
/// Membrane constants come as exactly one group: Lamé moduli in Pa with a thickness, Lamé constants of the sheet [N/m],
/// or Young's modulus in Pa and Poisson's ratio (plane stress) with a thickness.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MaterialStvkSpec {
    /// λ of Eq. 5, bulk in Pa. No default: a fabric is the user's choice.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lambda_pa: Option<Pascal>,
    /// μ of Eq. 5, bulk in Pa.
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
    /// k of Eq. 7 [N·m]. Default 3.95956e-5, SNUG's: a fold then behaves as in the method that this one follows.
    #[serde(default = "default_bending")]
    pub bending_nm: NewtonMetre,
    /// Area density [kg/m²]. No default: without it the garment's weighed mass must be given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub density_kg_per_m2: Option<KilogramPerSquareMetre>,
    /// Edge length in Eq. 7. Default `rest`: the energy is then a function of the angle alone.
    #[serde(default)]
    pub hinge_length: HingeLength,
}

pub(crate) fn default_bending() -> NewtonMetre {
    NewtonMetre(SNUG_BENDING)
}

impl MaterialStvkSpec {
    /// SNUG's fabric: E = 0.7e5 Pa, ν = 0.485, t = 0.47 mm, 426 kg/m³, bending with the current edge length.
    pub fn snug() -> Self {
        Self {
            lambda_pa: None,
            mu_pa: None,
            lambda_n_per_m: None,
            mu_n_per_m: None,
            young_pa: Some(Pascal(0.7e5)),
            poisson: Some(0.485),
            thickness_m: Some(Metre(4.7e-4)),
            bending_nm: default_bending(),
            density_kg_per_m2: Some(KilogramPerSquareMetre(426.0 * 4.7e-4)),
            hinge_length: HingeLength::Current,
        }
    }

    fn keys(&self) -> LameKeys {
        LameKeys {
            lambda_pa: self.lambda_pa,
            mu_pa: self.mu_pa,
            lambda_n_per_m: self.lambda_n_per_m,
            mu_n_per_m: self.mu_n_per_m,
            young_pa: self.young_pa,
            poisson: self.poisson,
            thickness_m: self.thickness_m,
        }
    }

    /// The material itself, for callers that know its type.
    ///
    /// # Errors
    /// [`Error::Config`] naming the key, its value and the valid range or groups.
    pub fn build_stvk(&self) -> Result<MaterialStvk> {
        let (lambda, mu) = self.keys().lame()?;
        let bending = check_bending(self.bending_nm)?;
        check_density(self.density_kg_per_m2)?;
        let parameters = [
            bounded("lambda".into(), NewtonPerMetre::SYMBOL, lambda.0, mu.0),
            bounded("mu".into(), NewtonPerMetre::SYMBOL, mu.0, mu.0),
            bounded("bending".into(), NewtonMetre::SYMBOL, bending.0, SNUG_BENDING),
        ];
        Ok(MaterialStvk {
            lambda,
            mu,
            bending,
            density: self.density_kg_per_m2,
            hinge_length: self.hinge_length,
            parameters: Arc::new(parameters),
        })
    }
}

#[typetag::serde(name = "stvk")]
impl MaterialSpec for MaterialStvkSpec {
    fn build(&self) -> Result<Box<dyn MaterialModel>> {
        Ok(Box::new(self.build_stvk()?))
    }
}

/// A homogeneous isotropic sheet: ψ = λ/2 tr(G)² + μ tr(G²) per rest area (Eq. 5 times thickness), constant k (Eq. 7).
///
/// Its stress is the gradient of its energy, so the held and the total tangent are the same matrix. Native parameters:
/// `lambda`, `mu` [N/m], `bending` [N·m].
///
/// ```
/// use caphy_core::material::{MaterialModel, MembraneBlock};
/// use caphy_materials::MaterialStvk;
/// let material = MaterialStvk::snug()?;
/// let mut energy = [0.0f64];
/// let mut block = MembraneBlock::new(1, &[0.1, 0.0, 0.0]);
/// block.energy = (&mut energy[..]).into();
/// material.membrane((&mut block).into())?;
/// assert!((energy[0] - 0.5 * 43.019 * 0.01).abs() < 1e-5);
/// # Ok::<(), caphy_core::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct MaterialStvk {
    lambda: NewtonPerMetre,
    mu: NewtonPerMetre,
    bending: NewtonMetre,
    density: Option<KilogramPerSquareMetre>,
    hinge_length: HingeLength,
    /// Names and bounds as built; copies with other values keep the bounds.
    parameters: Arc<[Parameter; 3]>,
}

impl MaterialStvk {
    /// SNUG's fabric, see [`MaterialStvkSpec::snug`].
    ///
    /// # Errors
    /// None in practice: the constants are valid; the type is that of every other way to make one.
    pub fn snug() -> Result<Self> {
        MaterialStvkSpec::snug().build_stvk()
    }
    /// λ of the sheet.
    pub fn lambda(&self) -> NewtonPerMetre {
        self.lambda
    }
    /// μ of the sheet.
    pub fn mu(&self) -> NewtonPerMetre {
        self.mu
    }
    /// k of Eq. 7.
    pub fn bending(&self) -> NewtonMetre {
        self.bending
    }

    fn membrane_block<T: Real>(&self, block: &mut MembraneBlock<'_, T>) -> Result<()> {
        block.check(self.parameters.len())?;
        let (lambda, mu) = (T::of(self.lambda.0), T::of(self.mu.0));
        strain_limit::within(limit::<T>(), block, |block| membrane_kernel(lambda, mu, block));
        Ok(())
    }

    fn hinge_block<T: Real>(&self, block: &mut HingeBlock<'_, T>) -> Result<()> {
        block.check(self.parameters.len())?;
        let count = block.count;
        if let Some(out) = block.stiffness.get() {
            out.fill(T::of(self.bending.0));
        }
        for out in [block.stiffness_by_angle.get(), block.stiffness_by_length.get()].into_iter().flatten() {
            out.fill(T::zero());
        }
        if let Some(out) = block.stiffness_by_parameter.get() {
            out.fill(T::zero());
            out[2 * count..].fill(T::one());
        }
        Ok(())
    }
}

impl MaterialModel for MaterialStvk {
    fn describe(&self) -> MaterialDescription {
        MaterialDescription {
            name: "stvk".into(),
            density: self.density,
            stiffness_frozen: false,
            hinge_length: self.hinge_length,
            linear_in_parameters: true,
            offers: MaterialOutputs::ALL,
        }
    }
    fn membrane(&self, call: MembraneCall<'_, '_>) -> Result<()> {
        match call {
            MembraneCall::F32(block) => self.membrane_block(block),
            MembraneCall::F64(block) => self.membrane_block(block),
        }
    }
    fn hinge(&self, call: HingeCall<'_, '_>) -> Result<()> {
        match call {
            HingeCall::F32(block) => self.hinge_block(block),
            HingeCall::F64(block) => self.hinge_block(block),
        }
    }
    fn strain_limits(&self) -> Option<[f64; 2]> {
        Some(STRAIN_LIMITS)
    }
    fn parameters(&self) -> Vec<Parameter> {
        let values = [self.lambda.0, self.mu.0, self.bending.0];
        self.parameters.iter().zip(values).map(|(p, value)| Parameter { value, ..p.clone() }).collect()
    }
    fn with_parameters(&self, values: &[f64]) -> Result<Box<dyn MaterialModel>> {
        check_values(&self.parameters[..], values)?;
        let &[lambda, mu, bending] = values else {
            return Err(Error::Length { what: "parameter values".into(), expected: 3, got: values.len() });
        };
        check_lame(lambda, mu)?;
        Ok(Box::new(Self {
            lambda: NewtonPerMetre(lambda),
            mu: NewtonPerMetre(mu),
            bending: NewtonMetre(bending),
            ..self.clone()
        }))
    }
}

simd_kernel! {
    /// Eq. 5 over a checked block; λ and μ in N/m.
    fn membrane_kernel<T>(lambda: T, mu: T, block: &mut MembraneBlock<'_, T>) {
        let n = block.count;
        let green = block.green.or_empty();
        let (guu, rest) = green.split_at(n);
        let (gvv, guv) = rest.split_at(n);
        let guv = &guv[..n];
        let two = T::of(2.0);
        let half_lambda = T::of(0.5) * lambda;
        let stiff = lambda + two * mu;
        if let Some(energy) = block.energy.get() {
            let energy = &mut energy[..n];
            for i in 0..n {
                let u = guu[i];
                let v = gvv[i];
                let w = guv[i];
                let trace = u + v;
                energy[i] = half_lambda * trace * trace + mu * (u * u + v * v + two * w * w);
            }
        }
        if let Some(stress) = block.stress.get() {
            let (suu, rest) = stress.split_at_mut(n);
            let (svv, suv) = rest.split_at_mut(n);
            let suv = &mut suv[..n];
            for i in 0..n {
                let u = guu[i];
                let v = gvv[i];
                let w = guv[i];
                suu[i] = stiff * u + lambda * v;
                svv[i] = stiff * v + lambda * u;
                suv[i] = two * mu * w;
            }
        }
        let matrix = [[stiff, lambda, T::zero()], [lambda, stiff, T::zero()], [T::zero(), T::zero(), two * mu]];
        for out in [block.tangent_held.get(), block.tangent_total.get()].into_iter().flatten() {
            for (entry, value) in matrix.iter().flatten().enumerate() {
                out[entry * n..(entry + 1) * n].fill(*value);
            }
        }
        if let Some(stiffness) = block.stiffness.get() {
            for (entry, value) in [stiff, lambda, stiff, two * mu].iter().enumerate() {
                stiffness[entry * n..(entry + 1) * n].fill(*value);
            }
        }
        if let Some(out) = block.stress_by_parameter.get() {
            // [parameter λ, μ, k_b][Suu, Svv, Suv][count]
            out.fill(T::zero());
            for i in 0..n {
                let u = guu[i];
                let v = gvv[i];
                let w = guv[i];
                out[i] = u + v;
                out[n + i] = u + v;
                out[3 * n + i] = two * u;
                out[4 * n + i] = two * v;
                out[5 * n + i] = two * w;
            }
        }
    }
}
