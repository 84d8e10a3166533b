//! [`BodyModel`]: a naked body that takes shape and pose.

use crate::files::Files;
use crate::lanes::Frames;
use crate::{Error, Result, Vec3};
use nalgebra::{DMatrix, Matrix3x4};
use serde::{Deserialize, Serialize};

/// A joint and its parent.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Joint {
    /// Name; the SMPL-X names where they fit, so that motion finds it.
    pub name: String,
    /// Parent joint, always of smaller index; `None` for a root.
    pub parent: Option<usize>,
}

/// Skinning weights w: per vertex the joints that move it, in compressed rows; each row sums to 1.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct BlendWeights {
    /// Row starts, shape [vertex_count + 1].
    pub offsets: Vec<u32>,
    /// Joint of each entry.
    pub joints: Vec<u16>,
    /// Weight of each entry.
    pub weights: Vec<f64>,
}

impl BlendWeights {
    /// From rows of (joint, weight).
    pub fn from_rows(rows: impl IntoIterator<Item = Vec<(u16, f64)>>) -> Self {
        let mut out = Self { offsets: vec![0], ..Self::default() };
        for row in rows {
            for (joint, weight) in row {
                out.joints.push(joint);
                out.weights.push(weight);
            }
            out.offsets.push(out.joints.len() as u32);
        }
        out
    }
    /// Number of vertices.
    pub fn vertex_count(&self) -> usize {
        self.offsets.len().saturating_sub(1)
    }
    /// Entries of one vertex.
    pub fn row(&self, vertex: usize) -> impl Iterator<Item = (usize, f64)> + '_ {
        let range = self.offsets[vertex] as usize..self.offsets[vertex + 1] as usize;
        range.map(|i| (self.joints[i] as usize, self.weights[i]))
    }
    /// Blended transform M = Σ w_j A_j of one vertex.
    pub fn blend(&self, vertex: usize, transforms: &[Matrix3x4<f64>]) -> Matrix3x4<f64> {
        self.row(vertex).fold(Matrix3x4::zeros(), |m, (j, w)| m + transforms[j] * w)
    }
}

/// Facts about a body that its callers need.
#[derive(Debug, Clone, PartialEq)]
pub struct BodyDescription {
    /// The `type` name in TOML, with the file's name where there is one.
    pub name: String,
    /// Joints, parents first.
    pub joints: Vec<Joint>,
    /// Triangles of the surface.
    pub faces: Vec<[u32; 3]>,
    /// Number of surface vertices.
    pub vertex_count: usize,
    /// Number of shape coefficients β (may be larger than a caller wants to use).
    pub shape_count: usize,
    /// Number of expression coefficients.
    pub expression_count: usize,
    /// Skinning weights w.
    pub weights: BlendWeights,
}

impl BodyDescription {
    /// Index of a joint by name.
    pub fn joint(&self, name: &str) -> Option<usize> {
        self.joints.iter().position(|j| j.name == name)
    }
    /// `Ok` when all these vertices exist, else an [`Error::Mesh`] that names the first that does not.
    pub fn check_vertices(&self, ids: &[u32]) -> Result<()> {
        match ids.iter().find(|id| **id as usize >= self.vertex_count) {
            None => Ok(()),
            Some(id) => Err(Error::mesh(
                self.name.clone(),
                format!("vertex {id}"),
                format!("does not exist, there are {}", self.vertex_count),
                "ask for vertices of this body",
            )),
        }
    }
}

/// Parameters of one posed body (Eq. 1).
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct BodyParameters {
    /// Shape β [1]; shorter than `shape_count` means zeros behind.
    pub shape: Vec<f64>,
    /// Expression [1]; likewise.
    pub expression: Vec<f64>,
    /// Axis-angle per joint relative to its parent [rad], shape [joint_count].
    pub rotations: Vec<Vec3>,
    /// Translation added after posing [m].
    pub translation: Vec3,
    /// Displacements dT of the T-posed surface [m], shape [vertex_count]; empty means none.
    pub displacement: Vec<Vec3>,
}

impl BodyParameters {
    /// The T-pose at the origin with a shape.
    pub fn rest(joint_count: usize, shape: &[f64]) -> Self {
        Self { shape: shape.to_vec(), rotations: vec![Vec3::zeros(); joint_count], ..Self::default() }
    }
    /// The same body in another pose.
    pub fn posed(&self, pose: &crate::pose::Pose) -> Self {
        Self { rotations: pose.rotations.clone(), translation: pose.translation, ..self.clone() }
    }
}

/// A posed body.
#[derive(Debug, Clone, PartialEq)]
pub struct PosedBody {
    /// Surface vertices [m], shape [vertex_count].
    pub vertices: Vec<Vec3>,
    /// Joints [m], shape [joint_count].
    pub joints: Vec<Vec3>,
    /// Blend transform A_j of each joint (rotation | translation [m]): takes T-posed, shaped points to posed ones,
    /// translation included. Garments are skinned with these.
    pub transforms: Vec<Matrix3x4<f64>>,
}

/// Joints and blend transforms of a posed body, without its surface.
#[derive(Debug, Clone, PartialEq)]
pub struct PosedSkeleton {
    /// As in [`PosedBody::joints`].
    pub joints: Vec<Vec3>,
    /// As in [`PosedBody::transforms`].
    pub transforms: Vec<Matrix3x4<f64>>,
}

/// A point that rides on the surface: a weighted mean of three vertices, linear in them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SurfacePoint {
    /// Vertices; repeated ones count together.
    pub vertices: [u32; 3],
    /// Weights, sum 1.
    pub weights: [f64; 3],
}

impl SurfacePoint {
    /// The point of a single vertex.
    pub fn vertex(id: u32) -> Self {
        Self { vertices: [id; 3], weights: [1.0, 0.0, 0.0] }
    }
    /// Where it is on a posed surface [m].
    ///
    /// # Panics
    /// When a vertex does not exist.
    pub fn on(&self, vertices: &[Vec3]) -> Vec3 {
        self.vertices.iter().zip(&self.weights).map(|(&v, w)| vertices[v as usize] * *w).sum()
    }
    /// Adds a cotangent of this point to the cotangents of the vertices, for [`BodyModel::vjp`].
    ///
    /// # Panics
    /// When a vertex does not exist.
    pub fn pull_back(&self, cotangent: &Vec3, vertex_cotangents: &mut [Vec3]) {
        for (&v, w) in self.vertices.iter().zip(&self.weights) {
            vertex_cotangents[v as usize] += cotangent * *w;
        }
    }
}

/// Gradient with respect to [`BodyParameters`]; shapes as there, `shape` of the length given.
#[derive(Debug, Clone, PartialEq)]
pub struct BodyGradient {
    /// d/dβ.
    pub shape: Vec<f64>,
    /// d/d expression.
    pub expression: Vec<f64>,
    /// d/d rotations [1/rad].
    pub rotations: Vec<Vec3>,
    /// d/d translation [1/m].
    pub translation: Vec3,
    /// d/d dT [1/m], shape [vertex_count].
    pub displacement: Vec<Vec3>,
}

/// A body: T(β,θ,dT) = W(T(β)+dT, J(β), θ, w) (Eq. 1).
///
/// # Promise
/// Pure and thread-safe. The parameters of [`BodyModel::rest`] (zero rotations, unless a body says otherwise) give T(β). The
/// root's rotation turns the whole body about its joint; the translation comes last. Derivatives are exact, also at zero
/// rotation. Joints come from T(β) without dT.
///
/// Landmarks are optional: a body without any has no names and no points, which is no error.
///
/// # Shapes and units
/// As in [`BodyParameters`] and [`PosedBody`]: metres and radians. Nothing here assumes SMPL-X: joints are named and
/// counted by [`BodyModel::describe`].
///
/// # Errors
/// [`Error::Length`] for wrong counts (too many coefficients included), [`Error::NonFinite`] for bad values.
pub trait BodyModel: Send + Sync {
    /// Joints, faces, counts and skinning weights.
    fn describe(&self) -> &BodyDescription;
    /// Poses the body.
    fn forward(&self, parameters: &BodyParameters) -> Result<PosedBody>;
    /// Vector-Jacobian product: gradients of `Σ gv·v + Σ gj·j` for cotangents of vertices, shape [vertex_count] (or empty)
    /// and of joints, shape [joint_count] (or empty).
    fn vjp(
        &self,
        parameters: &BodyParameters,
        vertex_cotangents: &[Vec3],
        joint_cotangents: &[Vec3],
    ) -> Result<BodyGradient>;
    /// Jacobian of some posed vertices, rows `[vertex][xyz]`, columns translation (3), rotations (3 per joint), shape (as
    /// many as `parameters.shape` has): for Gauss-Newton fits. The default calls [`BodyModel::vjp`] once per row.
    fn jacobian(&self, parameters: &BodyParameters, vertices: &[u32]) -> Result<DMatrix<f64>> {
        let n = self.describe().vertex_count;
        let columns = 3 + 3 * parameters.rotations.len() + parameters.shape.len();
        let mut out = DMatrix::zeros(3 * vertices.len(), columns);
        let mut cotangents = vec![Vec3::zeros(); n];
        for (i, &v) in vertices.iter().enumerate() {
            self.describe().check_vertices(&[v])?;
            for axis in 0..3 {
                cotangents[v as usize][axis] = 1.0;
                let g = self.vjp(parameters, &cotangents, &[])?;
                cotangents[v as usize][axis] = 0.0;
                let row = g.translation.iter().chain(g.rotations.iter().flat_map(|r| r.iter())).chain(&g.shape);
                for (column, value) in row.enumerate() {
                    out[(3 * i + axis, column)] = *value;
                }
            }
        }
        Ok(out)
    }
    /// The T-pose at the origin with a shape: the parameters that give T(β). Bodies that measure rotations from another pose
    /// than the T-pose (relaxed hands) override it.
    fn rest(&self, shape: &[f64]) -> BodyParameters {
        BodyParameters::rest(self.describe().joints.len(), shape)
    }
    /// Joints and transforms alone, the same as [`BodyModel::forward`] gives. The default poses the surface, too.
    fn skeleton(&self, parameters: &BodyParameters) -> Result<PosedSkeleton> {
        self.forward(parameters).map(|posed| PosedSkeleton { joints: posed.joints, transforms: posed.transforms })
    }
    /// Names of the points beyond the joints that [`BodyModel::landmarks`] places: unique, and no joint's name. Default none.
    fn landmark_names(&self) -> &[String] {
        &[]
    }
    /// Where the landmarks sit on the surface in a pose, shape [landmark_names]: [`SurfacePoint::on`] the posed vertices gives
    /// them, [`SurfacePoint::pull_back`] takes their cotangents to the vertices. Most do not depend on the pose; contours
    /// slide in steps, between which they are constant.
    ///
    /// # Errors
    /// As [`BodyModel::forward`] for the rotations, shape [joint_count].
    fn landmarks(&self, rotations: &[Vec3]) -> Result<Vec<SurfacePoint>> {
        Error::check_length("rotations", self.describe().joints.len(), rotations.len())?;
        Ok(Vec::new())
    }
    /// Poses many frames into lanes: frame `i` goes to block `i / lanes_used`, lane `i % lanes_used`. `subset` picks vertices
    /// (in its order), `None` means all; displacements of the others may go unchecked. The default goes through
    /// [`BodyModel::forward`].
    fn forward_frames(&self, frames: &[BodyParameters], subset: Option<&[u32]>, out: &mut Frames<f32>) -> Result<()> {
        Error::check_length("frames of a batch", out.frames(), frames.len())?;
        self.describe().check_vertices(subset.unwrap_or(&[]))?;
        let lanes = out.lanes_used();
        for (i, parameters) in frames.iter().enumerate() {
            let posed = self.forward(parameters)?;
            match subset {
                None => out.set_frame(i / lanes, i % lanes, &posed.vertices)?,
                Some(ids) => {
                    let points: Vec<Vec3> = ids.iter().map(|&id| posed.vertices[id as usize]).collect();
                    out.set_frame(i / lanes, i % lanes, &points)?;
                }
            }
        }
        Ok(())
    }
}

/// The `[body]` table of a configuration.
#[typetag::serde(tag = "type")]
pub trait BodySpec: std::fmt::Debug + Send + Sync {
    /// Checks the keys, reads files through the host, makes the body.
    fn build(&self, files: &dyn Files) -> Result<Box<dyn BodyModel>>;
}
