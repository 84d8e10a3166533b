//! [`MaterialModel`]: what a fabric answers when it is strained and folded.

use crate::array::{In, Out};
use crate::params::Parameter;
use crate::units::KilogramPerSquareMetre;
use crate::{Error, Real, Result};

/// Input and wanted outputs of one membrane call: `count` triangle-frames, structure of arrays.
///
/// Shapes are `[component][count]`, flat. Outputs that are absent must not be computed. All constants are N/m and all
/// energies J/m² of rest *area* (a model in Pa multiplies by its thickness first).
#[repr(C)]
pub struct MembraneBlock<'a, T> {
    /// Number of triangle-frames.
    pub count: usize,
    /// Green strain G = ½(FᵀF − I) in the material frame (Eq. 4), `[Guu, Gvv, Guv][count]`.
    pub green: In<'a, T>,
    /// Energy density ψ [J/m²], `[count]`.
    pub energy: Out<'a, T>,
    /// Second Piola-Kirchhoff stress [N/m], `[Suu, Svv, Suv][count]`; Suv is the tensor's off-diagonal entry, so that
    /// dψ = Suu dGuu + Svv dGvv + 2 Suv dGuv.
    pub stress: Out<'a, T>,
    /// ∂(Suu, Svv, Suv)/∂(Guu, Gvv, Guv) [N/m] with the stiffness held, row-major `[9][count]`.
    pub tangent_held: Out<'a, T>,
    /// The same with the stiffness's dependence on G, row-major `[9][count]`; not symmetric when `stress` itself is
    /// computed with held stiffness.
    pub tangent_total: Out<'a, T>,
    /// ∂(Suu, Svv, Suv)/∂Θ [N/m per parameter unit], `[parameter][3][count]`.
    pub stress_by_parameter: Out<'a, T>,
    /// Orthotropic stiffness at G [N/m], `[k0, k1, k2, k3][count]`, for reports.
    pub stiffness: Out<'a, T>,
}

/// Input and wanted outputs of one hinge call: `count` hinge-frames, structure of arrays.
#[repr(C)]
pub struct HingeBlock<'a, T> {
    /// Number of hinge-frames.
    pub count: usize,
    /// Dihedral angle θ [rad], 0 when flat, positive when the faces fold toward their normal side, `[count]`.
    pub angle: In<'a, T>,
    /// Rest dihedral angle [rad], `[count]`.
    pub angle_rest: In<'a, T>,
    /// Edge length l by the rule of [`MaterialDescription::hinge_length`] [m], `[count]`.
    pub length: In<'a, T>,
    /// Sum of both rest areas [m²], `[count]`.
    pub area: In<'a, T>,
    /// Material direction (du, dv) of the edge on side 0, any length, `[2][count]`.
    pub direction0: In<'a, T>,
    /// The same on side 1 (differs on a seam), `[2][count]`.
    pub direction1: In<'a, T>,
    /// Bending stiffness k of Eq. 7 [N·m], `[count]`.
    pub stiffness: Out<'a, T>,
    /// dk/dθ [N·m/rad], `[count]`.
    pub stiffness_by_angle: Out<'a, T>,
    /// dk/dl [N], `[count]`.
    pub stiffness_by_length: Out<'a, T>,
    /// ∂k/∂Θ [N·m per parameter unit], `[parameter][count]`.
    pub stiffness_by_parameter: Out<'a, T>,
}

macro_rules! block_checks {
    ($name:ident { $($input:ident: $in_rows:expr),* } { $($output:ident: $out_rows:expr),* }) => {
        impl<T: Real> $name<'_, T> {
            /// `Ok` when every given array has its length for `parameter_count` parameters and inputs are finite.
            pub fn check(&self, parameter_count: usize) -> Result<()> {
                let _ = parameter_count;
                $(
                    let name = concat!(stringify!($name), ".", stringify!($input));
                    let values = self.$input.or_empty();
                    Error::check_length(name, $in_rows * self.count, values.len())?;
                    Error::check_finite(name, values)?;
                )*
                $(
                    if self.$output.wanted() {
                        let rows: fn(usize) -> usize = $out_rows;
                        Error::check_length(
                            concat!(stringify!($name), ".", stringify!($output)),
                            rows(parameter_count) * self.count,
                            self.$output.len(),
                        )?;
                    }
                )*
                Ok(())
            }
        }
    };
}

block_checks!(MembraneBlock { green: 3 } {
    energy: |_| 1, stress: |_| 3, tangent_held: |_| 9, tangent_total: |_| 9,
    stress_by_parameter: |p| 3 * p, stiffness: |_| 4
});
block_checks!(HingeBlock { angle: 1, angle_rest: 1, length: 1, area: 1, direction0: 2, direction1: 2 } {
    stiffness: |_| 1, stiffness_by_angle: |_| 1, stiffness_by_length: |_| 1, stiffness_by_parameter: |p| p
});

impl<'a, T> HingeBlock<'a, T> {
    /// A block with no output wanted; arrays as in the fields.
    pub fn new(count: usize, [angle, angle_rest, length, area]: [&'a [T]; 4], directions: [&'a [T]; 2]) -> Self {
        Self {
            count,
            angle: angle.into(),
            angle_rest: angle_rest.into(),
            length: length.into(),
            area: area.into(),
            direction0: directions[0].into(),
            direction1: directions[1].into(),
            stiffness: Out::absent(),
            stiffness_by_angle: Out::absent(),
            stiffness_by_length: Out::absent(),
            stiffness_by_parameter: Out::absent(),
        }
    }
}

impl<'a, T> MembraneBlock<'a, T> {
    /// A block with no output wanted.
    pub fn new(count: usize, green: &'a [T]) -> Self {
        Self {
            count,
            green: green.into(),
            energy: Out::absent(),
            stress: Out::absent(),
            tangent_held: Out::absent(),
            tangent_total: Out::absent(),
            stress_by_parameter: Out::absent(),
            stiffness: Out::absent(),
        }
    }
}

/// Where a material is asked in single or double precision. One generic function usually serves both.
#[repr(C)]
pub enum MembraneCall<'b, 'a> {
    /// Single precision.
    F32(&'b mut MembraneBlock<'a, f32>),
    /// Double precision.
    F64(&'b mut MembraneBlock<'a, f64>),
}

/// As [`MembraneCall`], for hinges.
#[repr(C)]
pub enum HingeCall<'b, 'a> {
    /// Single precision.
    F32(&'b mut HingeBlock<'a, f32>),
    /// Double precision.
    F64(&'b mut HingeBlock<'a, f64>),
}

impl<'b, 'a> From<&'b mut MembraneBlock<'a, f32>> for MembraneCall<'b, 'a> {
    fn from(block: &'b mut MembraneBlock<'a, f32>) -> Self {
        Self::F32(block)
    }
}
impl<'b, 'a> From<&'b mut MembraneBlock<'a, f64>> for MembraneCall<'b, 'a> {
    fn from(block: &'b mut MembraneBlock<'a, f64>) -> Self {
        Self::F64(block)
    }
}
impl<'b, 'a> From<&'b mut HingeBlock<'a, f32>> for HingeCall<'b, 'a> {
    fn from(block: &'b mut HingeBlock<'a, f32>) -> Self {
        Self::F32(block)
    }
}
impl<'b, 'a> From<&'b mut HingeBlock<'a, f64>> for HingeCall<'b, 'a> {
    fn from(block: &'b mut HingeBlock<'a, f64>) -> Self {
        Self::F64(block)
    }
}

/// A [`Real`] that knows its variant of the calls, so that generic callers can ask a material.
pub trait MaterialReal: Real {
    /// Asks for the membrane answer in this precision.
    fn membrane(model: &dyn MaterialModel, block: &mut MembraneBlock<'_, Self>) -> Result<()>;
    /// Asks for the hinge answer in this precision.
    fn hinge(model: &dyn MaterialModel, block: &mut HingeBlock<'_, Self>) -> Result<()>;
}
impl MaterialReal for f32 {
    fn membrane(model: &dyn MaterialModel, block: &mut MembraneBlock<'_, Self>) -> Result<()> {
        model.membrane(MembraneCall::F32(block))
    }
    fn hinge(model: &dyn MaterialModel, block: &mut HingeBlock<'_, Self>) -> Result<()> {
        model.hinge(HingeCall::F32(block))
    }
}
impl MaterialReal for f64 {
    fn membrane(model: &dyn MaterialModel, block: &mut MembraneBlock<'_, Self>) -> Result<()> {
        model.membrane(MembraneCall::F64(block))
    }
    fn hinge(model: &dyn MaterialModel, block: &mut HingeBlock<'_, Self>) -> Result<()> {
        model.hinge(HingeCall::F64(block))
    }
}

/// Which edge length enters Eq. 7 and the stiffness lookup, and whether its change makes a force.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum HingeLength {
    /// The rest length (ARCSim 0.2.1).
    #[default]
    Rest,
    /// The deformed length, held while differentiating (ARCSim 0.3.1).
    CurrentHeld,
    /// The deformed length, differentiated (SNUG).
    Current,
}

/// Facts about a material that its callers need.
#[derive(Debug, Clone, PartialEq)]
pub struct MaterialDescription {
    /// The `type` name in TOML.
    pub name: String,
    /// Area density, when the material knows it.
    pub density: Option<KilogramPerSquareMetre>,
    /// Whether `stress` holds the stiffness at its present value instead of differentiating it: then it is not the
    /// gradient of `energy`.
    pub stiffness_frozen: bool,
    /// Rule for the edge length in bending.
    pub hinge_length: HingeLength,
    /// Whether energy and stress are linear in the parameters where no clamp is active (Eq. 10 as least squares).
    pub linear_in_parameters: bool,
    /// Which optional outputs are answered; asking for another one is [`Error::Unsupported`].
    pub offers: MaterialOutputs,
}

/// The outputs beyond energy, stress and bending stiffness, which every material answers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct MaterialOutputs {
    /// [`MembraneBlock::tangent_held`].
    pub tangent_held: bool,
    /// [`MembraneBlock::tangent_total`].
    pub tangent_total: bool,
    /// [`MembraneBlock::stress_by_parameter`] and [`HingeBlock::stiffness_by_parameter`].
    pub by_parameter: bool,
    /// [`MembraneBlock::stiffness`]: the model has four orthotropic constants.
    pub stiffness: bool,
    /// [`HingeBlock::stiffness_by_angle`] and [`HingeBlock::stiffness_by_length`].
    pub hinge_slopes: bool,
}

impl MaterialOutputs {
    /// Everything.
    pub const ALL: Self =
        Self { tangent_held: true, tangent_total: true, by_parameter: true, stiffness: true, hinge_slopes: true };
    /// Nothing beyond what is required.
    pub const REQUIRED: Self =
        Self { tangent_held: false, tangent_total: false, by_parameter: false, stiffness: false, hinge_slopes: false };

    /// `Ok` when a membrane block asks for nothing else, else [`Error::Unsupported`] naming the output and `by`.
    pub fn check_membrane<T>(&self, block: &MembraneBlock<'_, T>, by: &str) -> Result<()> {
        Self::refuse(
            by,
            [
                ("tangent_held", block.tangent_held.wanted() && !self.tangent_held),
                ("tangent_total", block.tangent_total.wanted() && !self.tangent_total),
                ("stress_by_parameter", block.stress_by_parameter.wanted() && !self.by_parameter),
                ("stiffness (four orthotropic constants)", block.stiffness.wanted() && !self.stiffness),
            ],
        )
    }
    /// As [`MaterialOutputs::check_membrane`], for hinges.
    pub fn check_hinge<T>(&self, block: &HingeBlock<'_, T>, by: &str) -> Result<()> {
        Self::refuse(
            by,
            [
                ("stiffness_by_angle", block.stiffness_by_angle.wanted() && !self.hinge_slopes),
                ("stiffness_by_length", block.stiffness_by_length.wanted() && !self.hinge_slopes),
                ("stiffness_by_parameter", block.stiffness_by_parameter.wanted() && !self.by_parameter),
            ],
        )
    }
    fn refuse<const N: usize>(by: &str, wanted: [(&str, bool); N]) -> Result<()> {
        match wanted.into_iter().find(|w| w.1) {
            None => Ok(()),
            Some((output, _)) => Err(Error::unsupported(output, by)),
        }
    }
}

/// A fabric: energy density and stress from Green strain (Eqs. 3-5), bending stiffness from fold and curvature (Eq. 7).
///
/// # Promise
/// Pure: equal blocks give equal bits, on any thread. Zero strain gives zero energy and stress. Every wanted output is
/// finite for finite strain, however large. Geometry (deformation gradients, normals, dihedral angles, areas) is the
/// caller's; the material never sees a mesh.
///
/// # Shapes and units
/// As in [`MembraneBlock`] and [`HingeBlock`]: flat `[component][count]`, SI, per unit rest area.
///
/// # Errors
/// [`Error::Length`] and [`Error::NonFinite`] for bad blocks, [`Error::Unsupported`] for an output that the material does
/// not offer, [`Error::Parameter`] for a value out of bounds.
pub trait MaterialModel: Send + Sync {
    /// Name, density and conventions.
    fn describe(&self) -> MaterialDescription;
    /// Answers a membrane block.
    fn membrane(&self, call: MembraneCall<'_, '_>) -> Result<()>;
    /// Answers a hinge block: k of Eq. 7; the energy k l²/(8A)(θ−θ_rest)² is the caller's.
    fn hinge(&self, call: HingeCall<'_, '_>) -> Result<()>;
    /// Native parameters Θ with their present values, in a fixed order.
    fn parameters(&self) -> Vec<Parameter>;
    /// A copy with other parameter values, in the order of [`MaterialModel::parameters`].
    fn with_parameters(&self, values: &[f64]) -> Result<Box<dyn MaterialModel>>;
    /// Strains larger than this, √(G:G), in single and in double precision, are answered as smaller ones so that nothing
    /// overflows ([`crate::strain_limit`], which also counts them). `None`, the default: the material does not say, as one of a
    /// loaded library.
    fn strain_limits(&self) -> Option<[f64; 2]> {
        None
    }
}

/// The `[material]` table of a configuration: `type = "…"` chooses the implementation, the rest are its keys.
#[typetag::serde(tag = "type")]
pub trait MaterialSpec: std::fmt::Debug + Send + Sync {
    /// Checks the keys and makes the material.
    fn build(&self) -> Result<Box<dyn MaterialModel>>;
}
