//! A body and its clothes along a clip, skinned: what can be shown before any network is trained.

use crate::moving::{MovingFigure, MovingGarment};
use caphy_core::body::{BlendWeights, BodyModel, BodyParameters};
use caphy_core::motion::MotionClip;
use caphy_core::{Result, TriMesh, Vec3};
use caphy_garment::skinning::{WeightOptions, garment_weights};
use caphy_garment::template::{Template, pose_by_weights};
use nalgebra::Matrix3x4;
use rayon::prelude::*;

/// A garment that follows the body by its blend weights alone (Eq. 2 with dV = 0).
struct SkinnedGarment {
    template: Template,
    weights: BlendWeights,
}

/// A body in a shape, dressed, and its motion.
pub struct Dressed<'a> {
    body: &'a dyn BodyModel,
    subject: BodyParameters,
    /// The T-posed surface [m].
    rest: TriMesh,
    garments: Vec<SkinnedGarment>,
    clip: MotionClip,
    /// Blend transforms of each frame, shape [frame][joint].
    transforms: Vec<Vec<Matrix3x4<f64>>>,
}

impl<'a> Dressed<'a> {
    /// Dresses a body of this shape; templates lie on it in its T-pose.
    ///
    /// # Errors
    /// Shapes and poses that are not the body's; weight options out of range.
    pub fn new(
        body: &'a dyn BodyModel,
        shape: &[f64],
        templates: Vec<Template>,
        weights: &WeightOptions,
        clip: MotionClip,
    ) -> Result<Self> {
        let subject = body.rest(shape);
        let description = body.describe();
        let rest = TriMesh { vertices: body.forward(&subject)?.vertices, faces: description.faces.clone() };
        let garments = templates
            .into_iter()
            .map(|template| {
                let mesh = &template.mesh;
                let weights =
                    garment_weights(&mesh.vertices, &mesh.faces, &rest.vertices, &description.weights, weights)?;
                Ok(SkinnedGarment { template, weights })
            })
            .collect::<Result<Vec<_>>>()?;
        let frames: Vec<Result<_>> =
            clip.poses.par_iter().map(|pose| Ok(body.skeleton(&subject.posed(pose))?.transforms)).collect();
        let transforms = frames.into_iter().collect::<Result<Vec<_>>>()?;
        Ok(Self { body, subject, rest, garments, clip, transforms })
    }
    /// Number of frames.
    pub fn frame_count(&self) -> usize {
        self.clip.poses.len()
    }
}

impl MovingFigure for Dressed<'_> {
    fn body(&self) -> &dyn BodyModel {
        self.body
    }
    fn rest(&self) -> &TriMesh {
        &self.rest
    }
    fn rest_joints(&self) -> Result<Vec<Vec3>> {
        Ok(self.body.skeleton(&self.subject)?.joints)
    }
    fn clip(&self) -> &MotionClip {
        &self.clip
    }
    fn body_frame(&self, frame: usize) -> Result<Vec<Vec3>> {
        Ok(self.body.forward(&self.subject.posed(&self.clip.poses[frame]))?.vertices)
    }
    fn garments(&self) -> Vec<MovingGarment<'_>> {
        self.garments.iter().map(|g| MovingGarment { kind: g.template.kind, mesh: &g.template.mesh }).collect()
    }
    fn garment_frame(&self, garment: usize, frame: usize) -> Result<Vec<Vec3>> {
        let worn = &self.garments[garment];
        pose_by_weights(&worn.template.mesh.vertices, &worn.weights, &self.transforms[frame])
    }
}
