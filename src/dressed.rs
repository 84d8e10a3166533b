//! A body and its clothes along a clip: what can be shown and simulated before any network is trained.

use crate::garment::FittedGarment;
use crate::moving::{MovingFigure, MovingGarment};
use crate::scene::REACH;
use crate::simulate::{Simulation, SimulationOptions, simulate_layers};
use crate::track::{BodyTrack, Reach};
use caphy_core::body::{BodyModel, BodyParameters};
use caphy_core::material::MaterialModel;
use caphy_core::motion::MotionClip;
use caphy_core::{Result, TriMesh, Vec3};
use caphy_garment::energy::LayeringOrder;
use caphy_garment::skinning::WeightOptions;
use caphy_garment::template::Template;
use nalgebra::Matrix3x4;
use rayon::prelude::*;
use std::sync::Arc;

/// A body in a shape, dressed, and its motion.
pub struct Dressed<'a> {
    body: &'a dyn BodyModel,
    subject: BodyParameters,
    /// The T-posed surface [m].
    rest: TriMesh,
    garments: Vec<FittedGarment>,
    /// Simulated vertices [m], shape [garment][frame][vertex]; empty: garments follow the body by their weights alone.
    shapes: Vec<Vec<Vec<Vec3>>>,
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
            .map(|template| FittedGarment::new(template, &rest.vertices, &description.weights, weights))
            .collect::<Result<Vec<_>>>()?;
        let frames: Vec<Result<_>> =
            clip.poses.par_iter().map(|pose| Ok(body.skeleton(&subject.posed(pose))?.transforms)).collect();
        let transforms = frames.into_iter().collect::<Result<Vec<_>>>()?;
        Ok(Self { body, subject, rest, garments, shapes: Vec::new(), clip, transforms })
    }
    /// Simulates every garment. Frames show the answers from then on; returns how they were solved.
    ///
    /// # Errors
    /// As [`simulate_layers`].
    pub fn simulate(
        &mut self,
        materials: &[Arc<dyn MaterialModel>],
        order: LayeringOrder,
        options: &SimulationOptions,
        progress: &dyn Fn(f64, &str),
    ) -> Result<Vec<Simulation>> {
        let templates: Vec<&[Vec3]> = self.garments.iter().map(|g| &g.mesh.vertices[..]).collect();
        let reach = Reach::new(&self.rest, &templates, REACH)?;
        let track = BodyTrack::new(self.body, &self.subject, &reach, &self.clip.poses)?;
        let contact = |garment: &FittedGarment| reach.contact(&self.rest, garment);
        let done = simulate_layers(&self.garments, materials, order, &track, &contact, options, progress)?;
        self.shapes = done.iter().map(|s| s.frames.clone()).collect();
        Ok(done)
    }
    /// The garments.
    pub fn worn(&self) -> &[FittedGarment] {
        &self.garments
    }
    /// Frames per second.
    pub fn fps(&self) -> f64 {
        self.clip.fps
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
        self.garments.iter().map(|g| MovingGarment { kind: g.kind, mesh: &g.mesh }).collect()
    }
    fn garment_frame(&self, garment: usize, frame: usize) -> Result<Vec<Vec3>> {
        match self.shapes.get(garment) {
            Some(frames) => Ok(frames[frame].clone()),
            None => self.garments[garment].skinned(&self.transforms[frame]),
        }
    }
}
