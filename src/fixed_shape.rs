//! A body whose shape is settled: only its pose is left to fit.

use caphy_core::body::{
    BodyDescription, BodyGradient, BodyModel, BodyParameters, PosedBody, PosedSkeleton, SurfacePoint,
};
use caphy_core::{Result, Vec3};
use nalgebra::DMatrix;

/// A body model with β and dT built in and no shape coefficients of its own.
pub struct FixedShape<'a> {
    body: &'a dyn BodyModel,
    settled: BodyParameters,
    description: BodyDescription,
}

impl<'a> FixedShape<'a> {
    /// With shape and displacements of `settled`.
    pub fn new(body: &'a dyn BodyModel, settled: &BodyParameters) -> Result<Self> {
        // Refuses a shape that does not belong to this body now rather than in the middle of a fit.
        body.forward(settled)?;
        let description = BodyDescription { shape_count: 0, expression_count: 0, ..body.describe().clone() };
        Ok(Self { body, settled: settled.clone(), description })
    }
    fn full(&self, parameters: &BodyParameters) -> BodyParameters {
        BodyParameters {
            rotations: parameters.rotations.clone(),
            translation: parameters.translation,
            ..self.settled.clone()
        }
    }
}

impl BodyModel for FixedShape<'_> {
    fn describe(&self) -> &BodyDescription {
        &self.description
    }
    fn forward(&self, parameters: &BodyParameters) -> Result<PosedBody> {
        self.body.forward(&self.full(parameters))
    }
    fn vjp(&self, parameters: &BodyParameters, vertices: &[Vec3], joints: &[Vec3]) -> Result<BodyGradient> {
        let full = self.body.vjp(&self.full(parameters), vertices, joints)?;
        Ok(BodyGradient { shape: Vec::new(), expression: Vec::new(), ..full })
    }
    fn jacobian(&self, parameters: &BodyParameters, vertices: &[u32]) -> Result<DMatrix<f64>> {
        let full = self.body.jacobian(&self.full(parameters), vertices)?;
        let columns = 3 + 3 * parameters.rotations.len();
        Ok(full.columns(0, columns).into_owned())
    }
    fn rest(&self, shape: &[f64]) -> BodyParameters {
        BodyParameters { shape: shape.to_vec(), ..self.body.rest(&[]) }
    }
    fn skeleton(&self, parameters: &BodyParameters) -> Result<PosedSkeleton> {
        self.body.skeleton(&self.full(parameters))
    }
    fn landmark_names(&self) -> &[String] {
        self.body.landmark_names()
    }
    fn landmarks(&self, rotations: &[Vec3]) -> Result<Vec<SurfacePoint>> {
        self.body.landmarks(rotations)
    }
}
