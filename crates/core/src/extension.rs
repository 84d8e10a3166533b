//! Conveniences for those who *use* the four traits: one strain, one fold, one frame, one view at a time.
//!
//! Implementers need none of this; every method here is answered through the required ones.

use crate::body::{BodyModel, BodyParameters};
use crate::material::{HingeBlock, MaterialModel, MembraneBlock};
use crate::net::{DeformationNet, ForwardBlock, ForwardCall};
use crate::scan::Label;
use crate::segmenter::{Segmenter, View};
use crate::{Error, Result, TriMesh};

/// What a material says of one Green strain; all per rest area.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MembraneAnswer {
    /// Energy density ψ [J/m²].
    pub energy: f64,
    /// Second Piola-Kirchhoff stress (Suu, Svv, Suv) [N/m].
    pub stress: [f64; 3],
    /// Orthotropic stiffness k0..k3 [N/m], where the model has four constants.
    pub stiffness: Option<[f64; 4]>,
}

/// One hinge in one state.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hinge {
    /// Dihedral angle θ [rad].
    pub angle: f64,
    /// Rest angle [rad].
    pub angle_rest: f64,
    /// Edge length by the material's rule [m].
    pub length: f64,
    /// Sum of both rest areas [m²].
    pub area: f64,
    /// Material direction (du, dv) of the edge on both sides.
    pub directions: [[f64; 2]; 2],
}

/// Uses of a [`MaterialModel`] for a single strain or fold, in double precision.
///
/// ```
/// use caphy_core::extension::MaterialModelExt;
/// # use caphy_core::material::*;
/// # use caphy_core::{params::Parameter, Result};
/// fn tension(fabric: &dyn MaterialModel) -> Result<f64> {
///     Ok(fabric.at([0.05, 0.0, 0.0])?.stress[0])
/// }
/// ```
pub trait MaterialModelExt {
    /// Energy, stress and, where there are any, the four constants at a Green strain (Guu, Gvv, Guv).
    ///
    /// # Errors
    /// [`Error::NonFinite`] for a strain that is not finite.
    fn at(&self, green: [f64; 3]) -> Result<MembraneAnswer>;
    /// ∂S/∂G [N/m] at a Green strain, rows (Suu, Svv, Suv), columns (Guu, Gvv, Guv), with the stiffness held.
    ///
    /// # Errors
    /// As [`MaterialModelExt::at`]; [`Error::Unsupported`] where the material has no tangent.
    fn tangent_held_at(&self, green: [f64; 3]) -> Result<[[f64; 3]; 3]>;
    /// As [`MaterialModelExt::tangent_held_at`], with the stiffness's dependence on the strain.
    ///
    /// # Errors
    /// As [`MaterialModelExt::tangent_held_at`].
    fn tangent_total_at(&self, green: [f64; 3]) -> Result<[[f64; 3]; 3]>;
    /// Bending stiffness k of Eq. 7 [N·m].
    ///
    /// # Errors
    /// [`Error::NonFinite`] for a hinge that is not finite.
    fn bending_stiffness(&self, hinge: &Hinge) -> Result<f64>;
    /// Bending energy k l²/(8A)(θ − θ_rest)² of Eq. 7 [J].
    ///
    /// # Errors
    /// As [`MaterialModelExt::bending_stiffness`].
    fn bending_energy(&self, hinge: &Hinge) -> Result<f64>;
}

/// A tangent in rows from the block's `[9][1]`.
fn rows(flat: [f64; 9]) -> [[f64; 3]; 3] {
    std::array::from_fn(|r| std::array::from_fn(|c| flat[3 * r + c]))
}

impl<M: MaterialModel + ?Sized> MaterialModelExt for M {
    fn at(&self, green: [f64; 3]) -> Result<MembraneAnswer> {
        let (mut energy, mut stress, mut stiffness) = ([0.0], [0.0; 3], [0.0; 4]);
        let offered = self.describe().offers.stiffness;
        let mut block = MembraneBlock::new(1, &green);
        block.energy = (&mut energy[..]).into();
        block.stress = (&mut stress[..]).into();
        if offered {
            block.stiffness = (&mut stiffness[..]).into();
        }
        self.membrane((&mut block).into())?;
        Ok(MembraneAnswer { energy: energy[0], stress, stiffness: offered.then_some(stiffness) })
    }
    fn tangent_held_at(&self, green: [f64; 3]) -> Result<[[f64; 3]; 3]> {
        let mut flat = [0.0; 9];
        let mut block = MembraneBlock::new(1, &green);
        block.tangent_held = (&mut flat[..]).into();
        self.membrane((&mut block).into())?;
        Ok(rows(flat))
    }
    fn tangent_total_at(&self, green: [f64; 3]) -> Result<[[f64; 3]; 3]> {
        let mut flat = [0.0; 9];
        let mut block = MembraneBlock::new(1, &green);
        block.tangent_total = (&mut flat[..]).into();
        self.membrane((&mut block).into())?;
        Ok(rows(flat))
    }
    fn bending_stiffness(&self, hinge: &Hinge) -> Result<f64> {
        let scalars = [[hinge.angle], [hinge.angle_rest], [hinge.length], [hinge.area]];
        let mut stiffness = [0.0];
        let mut block = HingeBlock::new(
            1,
            std::array::from_fn(|i| &scalars[i][..]),
            [&hinge.directions[0][..], &hinge.directions[1][..]],
        );
        block.stiffness = (&mut stiffness[..]).into();
        self.hinge((&mut block).into())?;
        Ok(stiffness[0])
    }
    fn bending_energy(&self, hinge: &Hinge) -> Result<f64> {
        let turn = hinge.angle - hinge.angle_rest;
        Ok(self.bending_stiffness(hinge)? * hinge.length * hinge.length / (8.0 * hinge.area) * turn * turn)
    }
}

/// Uses of a [`BodyModel`].
pub trait BodyModelExt {
    /// Parameters of the T-pose with a shape, of the right lengths.
    fn rest(&self, shape: &[f64]) -> BodyParameters;
    /// The posed surface as a mesh [m].
    ///
    /// # Errors
    /// As [`BodyModel::forward`].
    fn posed_mesh(&self, parameters: &BodyParameters) -> Result<TriMesh>;
}

impl<B: BodyModel + ?Sized> BodyModelExt for B {
    fn rest(&self, shape: &[f64]) -> BodyParameters {
        BodyParameters::rest(self.describe().joints.len(), shape)
    }
    fn posed_mesh(&self, parameters: &BodyParameters) -> Result<TriMesh> {
        Ok(TriMesh { vertices: self.forward(parameters)?.vertices, faces: self.describe().faces.clone() })
    }
}

/// Uses of a [`DeformationNet`].
pub trait DeformationNetExt {
    /// One frame of one window in single precision: displacements [m], shape [output]. `state`, shape [state], goes one step
    /// on; zeros before the first frame.
    ///
    /// # Errors
    /// As [`DeformationNet::forward`].
    fn frame(&self, parameters: &[f32], features: &[f32], state: &mut [f32]) -> Result<Vec<f32>>;
}

impl<N: DeformationNet + ?Sized> DeformationNetExt for N {
    fn frame(&self, parameters: &[f32], features: &[f32], state: &mut [f32]) -> Result<Vec<f32>> {
        let mut output = vec![0.0; self.manifest().outputs];
        let before = state.to_vec();
        let mut block = ForwardBlock {
            steps: 1,
            batch: 1,
            parameters: parameters.into(),
            features: features.into(),
            state_before: (&before[..]).into(),
            output: (&mut output[..]).into(),
            state_after: state.into(),
            tape: Default::default(),
        };
        self.forward(ForwardCall::F32(&mut block))?;
        Ok(output)
    }
}

/// Uses of a [`Segmenter`].
pub trait SegmenterExt {
    /// Labels of one view, shape [height · width].
    ///
    /// # Errors
    /// As [`Segmenter::segment`].
    fn labels(&self, view: &View<'_>) -> Result<Vec<Label>>;
}

impl<S: Segmenter + ?Sized> SegmenterExt for S {
    fn labels(&self, view: &View<'_>) -> Result<Vec<Label>> {
        let pixels = view.camera.width * view.camera.height;
        Error::check_length("triangles of a view [height · width]", pixels, view.triangle.len())?;
        let mut labels = vec![Label::Ignore; pixels];
        self.segment(view, &mut labels)?;
        Ok(labels)
    }
}
