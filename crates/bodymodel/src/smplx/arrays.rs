//! The arrays of a model in the SMPL-X layout, from a file or made by a program, and the checks on them.

use caphy_core::body::{BlendWeights, Joint};
use caphy_core::{Error, Result, TriMesh, Vec3};

/// Everything that defines a body in the SMPL-X layout. Any number of vertices and joints.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct SmplxArrays {
    /// Name for descriptions and error messages.
    pub name: String,
    /// T-posed vertices of the mean body [m], shape [vertex_count].
    pub template: Vec<Vec3>,
    /// Triangles, counter-clockwise seen from outside.
    pub faces: Vec<[u32; 3]>,
    /// Displacement per unit of each shape coefficient [m], shape [shape_count][vertex_count].
    pub shape_directions: Vec<Vec<Vec3>>,
    /// Displacement per unit of each expression coefficient [m], shape [expression_count][vertex_count].
    pub expression_directions: Vec<Vec<Vec3>>,
    /// Pose correctives [m], shape [vertex_count][xyz][9 · (joint_count - 1)], flat; column (j-1)·9+3r+c is multiplied by
    /// (R_j - I)[r,c]. Empty means none.
    pub pose_directions: Vec<f32>,
    /// Per joint the vertices it is regressed from, with weights that sum to 1, shape [joint_count].
    pub joint_regressor: Vec<Vec<(u32, f64)>>,
    /// Skinning weights, rows sum to 1.
    pub weights: BlendWeights,
    /// Joints, parents first.
    pub joints: Vec<Joint>,
}

/// How far a row of weights may be from 1 before the file counts as damaged: single precision is off by about 1e-6, half
/// precision by 5e-4.
const WEIGHT_SUM_TOLERANCE: f64 = 1e-3;

/// Whether a sum of weights is not 1; NaN counts.
pub(super) fn is_off_one(sum: f64) -> bool {
    sum.is_nan() || (sum - 1.0).abs() > WEIGHT_SUM_TOLERANCE
}

/// What is wrong with a joint tree, if anything: the first joint is the only root and parents come before their children, so
/// that there is no cycle.
pub(super) fn tree_problem(parents: &[Option<usize>]) -> Option<String> {
    let wrong = |(j, parent): (usize, &Option<usize>)| (j == 0) != parent.is_none() || parent.is_some_and(|p| p >= j);
    let j = parents.iter().enumerate().position(wrong)?;
    Some(match parents[j] {
        None => format!("joint {j} has no parent, which only joint 0 may"),
        Some(p) => format!("joint {j} has parent {p}"),
    })
}

impl SmplxArrays {
    /// Checks lengths, ids, finiteness, the joint tree and the sums of weights.
    pub(super) fn check(&self) -> Result<()> {
        let (n, joints) = (self.template.len(), self.joints.len());
        let name = &self.name;
        if n == 0 || joints == 0 {
            return Err(Error::mesh(
                name,
                "vertices and joints",
                format!("{n} vertices and {joints} joints"),
                "a body needs at least one of each",
            ));
        }
        let parents: Vec<Option<usize>> = self.joints.iter().map(|j| j.parent).collect();
        if let Some(problem) = tree_problem(&parents) {
            let remedy = "the first joint is the only root and parents come before their children";
            return Err(Error::mesh(name, "joint tree", problem, remedy));
        }
        TriMesh::new(name, self.template.clone(), self.faces.clone())?;
        for (what, directions) in [("shape", &self.shape_directions), ("expression", &self.expression_directions)] {
            for (k, field) in directions.iter().enumerate() {
                let what = format!("`{name}`, {what} direction {k}");
                Error::check_length(&what, n, field.len())?;
                for vector in field {
                    Error::check_finite(&what, vector.as_slice())?;
                }
            }
        }
        if !self.pose_directions.is_empty() {
            let what = format!("`{name}`, pose directions");
            Error::check_length(&what, 27 * n * (joints - 1), self.pose_directions.len())?;
            Error::check_finite(&what, &self.pose_directions)?;
        }
        Error::check_length(&format!("`{name}`, rows of the joint regressor"), joints, self.joint_regressor.len())?;
        for (j, row) in self.joint_regressor.iter().enumerate() {
            let sum: f64 = row.iter().map(|(_, w)| w).sum();
            if row.iter().any(|&(v, _)| v as usize >= n) || is_off_one(sum) {
                return Err(Error::mesh(
                    name,
                    format!("joint {j} `{}`", self.joints[j].name),
                    format!("its regressor weights sum to {sum}, over {} vertices of {n}", row.len()),
                    "each joint is a weighted mean of existing vertices",
                ));
            }
        }
        Error::check_length(&format!("`{name}`, rows of the skinning weights"), n, self.weights.vertex_count())?;
        for v in 0..n {
            let sum: f64 = self.weights.row(v).map(|(_, w)| w).sum();
            let bad = self.weights.row(v).any(|(j, w)| j >= joints || w < -WEIGHT_SUM_TOLERANCE);
            if bad || is_off_one(sum) {
                return Err(Error::mesh(
                    name,
                    format!("vertex {v}"),
                    format!("skinning weights {:?} sum to {sum}", self.weights.row(v).collect::<Vec<_>>()),
                    "weights are non-negative, name existing joints and sum to 1",
                ));
            }
        }
        Ok(())
    }
}
