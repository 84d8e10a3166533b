//! [`BodySmplx`]: a body in the SMPL-X layout (Eq. 1), from a file or from [`SmplxArrays`].

mod arrays;
mod derivatives;
mod frames;
mod hands;
mod joint_names;
mod landmarks;
mod load;
mod pose_correctives;
mod rotation;
mod spec;

pub use arrays::SmplxArrays;
pub use hands::{HandComponents, HandMean, HandPose};
pub use landmarks::{FaceContour, PICKED_VERTICES, SmplxLandmarks};
pub use load::{SmplxOptions, load};
pub use spec::SmplxSpec;

use caphy_core::body::{
    BodyDescription, BodyGradient, BodyModel, BodyParameters, PosedBody, PosedSkeleton, SurfacePoint,
};
use caphy_core::lanes::Frames;
use caphy_core::{Error, Result, Vec3};
use nalgebra::{DMatrix, Matrix3, Matrix3x4};
use pose_correctives::PoseCorrectives;
use rayon::prelude::*;

/// Vertices per parallel task; fixed, so that sums never depend on the number of threads.
const CHUNK: usize = 512;

/// A body in the SMPL-X layout: T(β,θ,dT) = W(T(β)+dT, J(β), θ, w) (Eq. 1).
///
/// T(β) = template + shape + expression directions; joints are regressed from T(β) without dT; pose correctives and dT
/// are added before skinning. Zero rotations mean flat hands, unless [`BodySmplx::with_hands`] adds the mean hand pose.
///
/// Joints and then landmarks are in the order in which the official package returns them together: 55 joints, 21 picked
/// vertices, 51 points of the face, 17 of its contour.
#[derive(Debug, Clone)]
pub struct BodySmplx {
    description: BodyDescription,
    template: Vec<Vec3>,
    /// Shape directions, then expression directions, each of shape [vertex_count].
    directions: Vec<Vec<Vec3>>,
    /// Joints of the template [m].
    joint_template: Vec<Vec3>,
    /// Joint displacement per coefficient [m], shape [shape_count + expression_count][joint_count].
    joint_directions: Vec<Vec<Vec3>>,
    correctives: Option<PoseCorrectives>,
    /// Added to all rotations [rad], shape [joint_count]; empty means nothing.
    relaxed: Vec<Vec3>,
    hands: Option<Box<[HandComponents; 2]>>,
    landmarks: Option<Box<landmarks::Placed>>,
}

/// What posing leaves behind for derivatives: local rotations, world rotations and joint positions before translation.
struct Skeleton {
    /// J(β) [m].
    rest: Vec<Vec3>,
    /// R_j relative to the parent.
    local: Vec<Matrix3<f64>>,
    /// Product of rotations from the root down.
    world: Vec<Matrix3<f64>>,
    /// Posed joints before the translation [m].
    posed: Vec<Vec3>,
}

impl BodySmplx {
    /// A body from its arrays.
    ///
    /// # Errors
    /// [`Error::Length`], [`Error::NonFinite`] and [`Error::Mesh`] for arrays that do not fit together.
    pub fn new(arrays: SmplxArrays) -> Result<Self> {
        arrays.check()?;
        let regress = |field: &[Vec3]| -> Vec<Vec3> {
            let row = |row: &Vec<(u32, f64)>| row.iter().map(|&(v, w)| field[v as usize] * w).sum();
            arrays.joint_regressor.iter().map(row).collect()
        };
        let joint_template = regress(&arrays.template);
        let (shape_count, expression_count) = (arrays.shape_directions.len(), arrays.expression_directions.len());
        let directions: Vec<_> = arrays.shape_directions.iter().chain(&arrays.expression_directions).cloned().collect();
        let joint_directions = directions.iter().map(|d| regress(d)).collect();
        let correctives = PoseCorrectives::new(arrays.pose_directions, arrays.template.len());
        let description = BodyDescription {
            name: arrays.name,
            joints: arrays.joints,
            vertex_count: arrays.template.len(),
            faces: arrays.faces,
            shape_count,
            expression_count,
            weights: arrays.weights,
        };
        Ok(Self {
            description,
            template: arrays.template,
            directions,
            joint_template,
            joint_directions,
            correctives,
            relaxed: Vec::new(),
            hands: None,
            landmarks: None,
        })
    }

    /// Whether the model has pose correctives that are not all zero.
    pub fn has_pose_correctives(&self) -> bool {
        self.correctives.is_some()
    }

    /// T(β) with expression [m], shape [vertex_count]; coefficients shorter than the model's mean zeros behind.
    pub fn shaped(&self, shape: &[f64], expression: &[f64]) -> Result<Vec<Vec3>> {
        let coefficients = self.coefficients(shape, expression)?;
        Ok(self.shaped_by(&coefficients))
    }

    /// (direction, coefficient) pairs that are not zero, after the checks.
    fn coefficients(&self, shape: &[f64], expression: &[f64]) -> Result<Vec<(usize, f64)>> {
        let mut out = Vec::new();
        let groups = [
            ("shape coefficients", shape, 0, self.description.shape_count),
            ("expression coefficients", expression, self.description.shape_count, self.description.expression_count),
        ];
        for (what, given, first, count) in groups {
            let what = || format!("{what} of `{}`", self.description.name);
            if given.len() > count {
                return Err(Error::Length { what: what(), expected: count, got: given.len() });
            }
            if !given.iter().all(|c| c.is_finite()) {
                Error::check_finite(&what(), given)?;
            }
            out.extend(given.iter().enumerate().filter(|(_, c)| **c != 0.0).map(|(k, c)| (first + k, *c)));
        }
        Ok(out)
    }

    fn shaped_by(&self, coefficients: &[(usize, f64)]) -> Vec<Vec3> {
        let mut out = self.template.clone();
        for &(k, c) in coefficients {
            for (v, d) in out.iter_mut().zip(&self.directions[k]) {
                *v += d * c;
            }
        }
        out
    }

    /// Checks rotations, shape [joint_count].
    fn check_rotations(&self, rotations: &[Vec3]) -> Result<()> {
        let (name, count) = (&self.description.name, self.description.joints.len());
        if rotations.len() != count {
            Error::check_length(&format!("rotations of `{name}`"), count, rotations.len())?;
        }
        for (joint, r) in self.description.joints.iter().zip(rotations) {
            if !r.iter().all(|c| c.is_finite()) {
                Error::check_finite(&format!("rotation of `{}` of `{name}`", joint.name), r.as_slice())?;
            }
        }
        Ok(())
    }

    /// Checks everything in the parameters but the coefficients.
    fn check(&self, parameters: &BodyParameters) -> Result<()> {
        self.check_pose(parameters)?;
        self.check_displacement(parameters, 0..self.template.len())
    }

    fn check_pose(&self, parameters: &BodyParameters) -> Result<()> {
        self.check_rotations(&parameters.rotations)?;
        let what = format!("translation of `{}`", self.description.name);
        Error::check_finite(&what, parameters.translation.as_slice())
    }

    /// Checks the number of displacements, and the values of those of some vertices.
    fn check_displacement(&self, parameters: &BodyParameters, ids: impl Iterator<Item = usize>) -> Result<()> {
        if parameters.displacement.is_empty() {
            return Ok(());
        }
        let name = &self.description.name;
        Error::check_length(&format!("displacements of `{name}`"), self.template.len(), parameters.displacement.len())?;
        for v in ids {
            let d = &parameters.displacement[v];
            if !d.iter().all(|c| c.is_finite()) {
                Error::check_finite(&format!("displacement of vertex {v} of `{name}`"), d.as_slice())?;
            }
        }
        Ok(())
    }

    /// Rotations as they act: with what the body adds itself.
    fn acting(&self, rotations: &[Vec3]) -> Vec<Vec3> {
        let added = self.relaxed.iter().copied().chain(std::iter::repeat(Vec3::zeros()));
        rotations.iter().zip(added).map(|(r, a)| r + a).collect()
    }

    /// Joints down the tree: G_j = G_parent [R_j | J_j - J_parent]; the root turns about its own joint.
    fn skeleton_of(&self, coefficients: &[(usize, f64)], rotations: &[Vec3]) -> Skeleton {
        let mut rest = self.joint_template.clone();
        for &(k, c) in coefficients {
            for (j, d) in rest.iter_mut().zip(&self.joint_directions[k]) {
                *j += d * c;
            }
        }
        let local: Vec<_> = self.acting(rotations).iter().map(rotation::rotation).collect();
        let mut world = Vec::with_capacity(local.len());
        let mut posed: Vec<Vec3> = Vec::with_capacity(local.len());
        for (j, joint) in self.description.joints.iter().enumerate() {
            match joint.parent {
                None => {
                    world.push(local[j]);
                    posed.push(rest[j]);
                }
                Some(p) => {
                    posed.push(world[p] * (rest[j] - rest[p]) + posed[p]);
                    world.push(world[p] * local[j]);
                }
            }
        }
        Skeleton { rest, local, world, posed }
    }

    /// T(β) + dT + pose correctives: the surface that is skinned [m].
    fn unposed(&self, parameters: &BodyParameters, coefficients: &[(usize, f64)], skeleton: &Skeleton) -> Vec<Vec3> {
        let mut out = self.shaped_by(coefficients);
        for (v, d) in out.iter_mut().zip(&parameters.displacement) {
            *v += d;
        }
        if let Some(correctives) = &self.correctives {
            correctives.add(&skeleton.local, &mut out);
        }
        out
    }
}

impl Skeleton {
    /// Blend transforms A_j (rotation | translation): rest surface to posed surface.
    fn transforms(&self, translation: &Vec3) -> Vec<Matrix3x4<f64>> {
        (0..self.world.len())
            .map(|j| {
                let t = self.posed[j] - self.world[j] * self.rest[j] + translation;
                let mut m = Matrix3x4::zeros();
                m.fixed_columns_mut::<3>(0).copy_from(&self.world[j]);
                m.set_column(3, &t);
                m
            })
            .collect()
    }
}

impl BodyModel for BodySmplx {
    fn describe(&self) -> &BodyDescription {
        &self.description
    }

    fn forward(&self, parameters: &BodyParameters) -> Result<PosedBody> {
        self.check(parameters)?;
        let coefficients = self.coefficients(&parameters.shape, &parameters.expression)?;
        let skeleton = self.skeleton_of(&coefficients, &parameters.rotations);
        let mut vertices = self.unposed(parameters, &coefficients, &skeleton);
        let transforms = skeleton.transforms(&parameters.translation);
        let weights = &self.description.weights;
        vertices.par_chunks_mut(CHUNK).enumerate().for_each(|(chunk, vertices)| {
            for (i, v) in vertices.iter_mut().enumerate() {
                *v = weights.blend(chunk * CHUNK + i, &transforms) * v.push(1.0);
            }
        });
        let joints = skeleton.posed.iter().map(|j| j + parameters.translation).collect();
        Ok(PosedBody { vertices, joints, transforms })
    }

    fn vjp(
        &self,
        parameters: &BodyParameters,
        vertex_cotangents: &[Vec3],
        joint_cotangents: &[Vec3],
    ) -> Result<BodyGradient> {
        self.backward(parameters, vertex_cotangents, joint_cotangents)
    }

    fn jacobian(&self, parameters: &BodyParameters, vertices: &[u32]) -> Result<DMatrix<f64>> {
        self.vertex_jacobian(parameters, vertices)
    }

    fn rest(&self, shape: &[f64]) -> BodyParameters {
        let mut parameters = BodyParameters::rest(self.joint_template.len(), shape);
        parameters.rotations.iter_mut().zip(&self.relaxed).for_each(|(r, relaxed)| *r = -relaxed);
        parameters
    }

    fn skeleton(&self, parameters: &BodyParameters) -> Result<PosedSkeleton> {
        self.check(parameters)?;
        let coefficients = self.coefficients(&parameters.shape, &parameters.expression)?;
        let skeleton = self.skeleton_of(&coefficients, &parameters.rotations);
        let joints = skeleton.posed.iter().map(|j| j + parameters.translation).collect();
        Ok(PosedSkeleton { joints, transforms: skeleton.transforms(&parameters.translation) })
    }

    fn landmark_names(&self) -> &[String] {
        self.landmarks.as_ref().map_or(&[], |l| &l.names)
    }

    fn landmarks(&self, rotations: &[Vec3]) -> Result<Vec<SurfacePoint>> {
        self.check_rotations(rotations)?;
        Ok(self.landmarks.as_ref().map_or_else(Vec::new, |l| l.points(&self.acting(rotations))))
    }

    fn forward_frames(&self, frames: &[BodyParameters], subset: Option<&[u32]>, out: &mut Frames<f32>) -> Result<()> {
        self.pose_frames(frames, subset, out)
    }
}
