//! A fabric for tests: written again from the formulas, so that terms are not checked against the crate of
//! materials but against an independent answer.
#![allow(dead_code)]

use caphy_core::material::{
    HingeBlock, HingeCall, HingeLength, MaterialDescription, MaterialModel, MaterialOutputs, MembraneBlock,
    MembraneCall,
};
use caphy_core::params::Parameter;
use caphy_core::{Error, Real, Result};
use std::path::PathBuf;

/// Constant membrane and bending stiffness: ψ = μ tr G² + λ/2 tr² G [N/m], k [N·m].
#[derive(Debug, Clone)]
pub(crate) struct Fabric {
    /// λ t [N/m].
    pub(crate) lambda: f64,
    /// μ t [N/m].
    pub(crate) mu: f64,
    /// Bending stiffness of Eq. 7 [N·m]; the fold adds `slope` times its square.
    pub(crate) bending: f64,
    /// Share by which k grows with fold² (0 for a constant).
    pub(crate) slope: f64,
    /// Rule for the edge length.
    pub(crate) length: HingeLength,
}

impl Fabric {
    /// SNUG's constants (reference/snug_maths.md).
    pub(crate) fn snug() -> Self {
        let (young, poisson, thickness) = (0.7e5, 0.485, 0.47e-3);
        Self {
            lambda: young * poisson / (1.0 - poisson * poisson) * thickness,
            mu: young / (2.0 * (1.0 + poisson)) * thickness,
            bending: 50.0 * young * thickness * thickness * thickness / (12.0 * (1.0 - poisson * poisson)),
            slope: 0.0,
            length: HingeLength::Current,
        }
    }
    fn answer_membrane<T: Real>(&self, block: &mut MembraneBlock<'_, T>) -> Result<()> {
        block.check(0)?;
        let n = block.count;
        let (l, m) = (T::of(self.lambda), T::of(self.mu));
        let g = block.green.or_empty();
        let half = T::of(0.5);
        if let Some(energy) = block.energy.get() {
            for i in 0..n {
                let (uu, vv, uv) = (g[i], g[n + i], g[2 * n + i]);
                let trace = uu + vv;
                energy[i] = m * (uu * uu + vv * vv + uv * uv + uv * uv) + half * l * trace * trace;
            }
        }
        if let Some(stress) = block.stress.get() {
            let two = m + m;
            for i in 0..n {
                let (uu, vv, uv) = (g[i], g[n + i], g[2 * n + i]);
                let trace = l * (uu + vv);
                stress[i] = two * uu + trace;
                stress[n + i] = two * vv + trace;
                stress[2 * n + i] = two * uv;
            }
        }
        Ok(())
    }
    fn answer_hinge<T: Real>(&self, block: &mut HingeBlock<'_, T>) -> Result<()> {
        block.check(0)?;
        let (k, s) = (T::of(self.bending), T::of(self.slope));
        let fold: Vec<T> =
            block.angle.or_empty().iter().zip(block.angle_rest.or_empty()).map(|(a, b)| *a - *b).collect();
        if let Some(out) = block.stiffness.get() {
            out.iter_mut().zip(&fold).for_each(|(o, f)| *o = k * (T::one() + s * *f * *f));
        }
        if let Some(out) = block.stiffness_by_angle.get() {
            out.iter_mut().zip(&fold).for_each(|(o, f)| *o = k * s * (*f + *f));
        }
        if let Some(out) = block.stiffness_by_length.get() {
            out.fill(T::zero());
        }
        Ok(())
    }
}

impl MaterialModel for Fabric {
    fn describe(&self) -> MaterialDescription {
        MaterialDescription {
            name: "test fabric".into(),
            density: None,
            stiffness_frozen: false,
            hinge_length: self.length,
            linear_in_parameters: true,
            offers: MaterialOutputs::REQUIRED,
        }
    }
    fn membrane(&self, call: MembraneCall<'_, '_>) -> Result<()> {
        match call {
            MembraneCall::F32(block) => self.answer_membrane(block),
            MembraneCall::F64(block) => self.answer_membrane(block),
        }
    }
    fn hinge(&self, call: HingeCall<'_, '_>) -> Result<()> {
        match call {
            HingeCall::F32(block) => self.answer_hinge(block),
            HingeCall::F64(block) => self.answer_hinge(block),
        }
    }
    fn parameters(&self) -> Vec<Parameter> {
        Vec::new()
    }
    fn with_parameters(&self, values: &[f64]) -> Result<Box<dyn MaterialModel>> {
        Error::check_length("parameter values", 0, values.len())?;
        Ok(Box::new(self.clone()))
    }
}

/// The folder of reference numbers, or a loud skip.
pub(crate) fn reference(file: &str) -> Option<PathBuf> {
    let shared = std::env::var_os("CAPHY_SHARED")
        .map_or_else(|| PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared")), PathBuf::from);
    let path = shared.join("reference").join(file);
    if path.exists() {
        return Some(path);
    }
    eprintln!("SKIPPED: {} is missing; set CAPHY_SHARED to the folder that holds reference/{file}", path.display());
    None
}
