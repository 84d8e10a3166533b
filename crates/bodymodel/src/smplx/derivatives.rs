//! Exact derivatives of [`BodySmplx`]: the vector-Jacobian product, and the Jacobian of a few vertices.

use super::rotation::rotation_derivatives;
use super::{BodySmplx, CHUNK, Skeleton};
use caphy_core::body::{BodyGradient, BodyParameters};
use caphy_core::{Error, Result, Vec3};
use nalgebra::{DMatrix, Matrix3, SVector};
use rayon::prelude::*;

/// Sums over vertices for one joint: Σ w g pᵀ and Σ w g.
#[derive(Clone, Copy)]
struct JointSums {
    outer: Matrix3<f64>,
    plain: Vec3,
}

const NO_SUMS: JointSums =
    JointSums { outer: Matrix3::new(0., 0., 0., 0., 0., 0., 0., 0., 0.), plain: Vec3::new(0., 0., 0.) };

impl BodySmplx {
    /// See `BodyModel::vjp`.
    pub(super) fn backward(
        &self,
        parameters: &BodyParameters,
        vertex_cotangents: &[Vec3],
        joint_cotangents: &[Vec3],
    ) -> Result<BodyGradient> {
        self.check(parameters)?;
        let coefficients = self.coefficients(&parameters.shape, &parameters.expression)?;
        let (n, joint_count) = (self.template.len(), self.joint_template.len());
        for (what, count, given) in
            [("vertex cotangents", n, vertex_cotangents), ("joint cotangents", joint_count, joint_cotangents)]
        {
            if !given.is_empty() {
                Error::check_length(what, count, given.len())?;
                for g in given {
                    Error::check_finite(what, g.as_slice())?;
                }
            }
        }
        let skeleton = self.skeleton_of(&coefficients, &parameters.rotations);

        // x = Σ_j w_j (G_j (p - J_j) + t_j): per joint all vertices come down to two sums.
        let mut sums = vec![NO_SUMS; joint_count];
        let mut unposed_gradient = vec![Vec3::zeros(); n];
        if !vertex_cotangents.is_empty() {
            let unposed = self.unposed(parameters, &coefficients, &skeleton);
            let weights = &self.description.weights;
            let partial: Vec<Vec<JointSums>> = unposed_gradient
                .par_chunks_mut(CHUNK)
                .enumerate()
                .map(|(chunk, gradient)| {
                    let mut sums = vec![NO_SUMS; joint_count];
                    for (i, gradient) in gradient.iter_mut().enumerate() {
                        let v = chunk * CHUNK + i;
                        let g = vertex_cotangents[v];
                        if g == Vec3::zeros() {
                            continue;
                        }
                        let outer = g * unposed[v].transpose();
                        for (j, w) in weights.row(v) {
                            sums[j].outer += outer * w;
                            sums[j].plain += g * w;
                            *gradient += skeleton.world[j].tr_mul(&g) * w;
                        }
                    }
                    sums
                })
                .collect();
            for part in partial {
                for (sum, part) in sums.iter_mut().zip(part) {
                    sum.outer += part.outer;
                    sum.plain += part.plain;
                }
            }
        }

        let mut world = Vec::with_capacity(joint_count);
        let mut posed = Vec::with_capacity(joint_count);
        let mut rest = Vec::with_capacity(joint_count);
        for (j, sum) in sums.iter().enumerate() {
            world.push(sum.outer - sum.plain * skeleton.rest[j].transpose());
            posed.push(sum.plain + joint_cotangents.get(j).copied().unwrap_or_else(Vec3::zeros));
            rest.push(-skeleton.world[j].tr_mul(&sum.plain));
        }
        let translation = posed.iter().sum();

        // Up the tree: children come after their parents.
        let mut local = vec![Matrix3::zeros(); joint_count];
        for (j, joint) in self.description.joints.iter().enumerate().rev() {
            match joint.parent {
                None => {
                    local[j] += world[j];
                    rest[j] += posed[j];
                }
                Some(p) => {
                    let (dw, dt): (Matrix3<f64>, Vec3) = (world[j], posed[j]);
                    local[j] += skeleton.world[p].tr_mul(&dw);
                    world[p] +=
                        dw * skeleton.local[j].transpose() + dt * (skeleton.rest[j] - skeleton.rest[p]).transpose();
                    posed[p] += dt;
                    let back = skeleton.world[p].tr_mul(&dt);
                    rest[j] += back;
                    rest[p] -= back;
                }
            }
        }
        if let (Some(correctives), false) = (&self.correctives, vertex_cotangents.is_empty()) {
            let features = correctives.features_gradient(&unposed_gradient);
            for (&j, f) in correctives.joints().iter().zip(features.chunks_exact(9)) {
                local[j] += Matrix3::from_row_slice(f);
            }
        }
        let rotations = self
            .acting(&parameters.rotations)
            .iter()
            .zip(&local)
            .map(|(r, g)| Vec3::from(rotation_derivatives(r).map(|d| d.dot(g))))
            .collect();

        let along = |k: usize| -> f64 {
            let surface: f64 = self.directions[k].iter().zip(&unposed_gradient).map(|(d, g)| d.dot(g)).sum();
            let joints: f64 = self.joint_directions[k].iter().zip(&rest).map(|(d, g)| d.dot(g)).sum();
            surface + joints
        };
        let shape_count = self.description.shape_count;
        let shape = (0..parameters.shape.len()).into_par_iter().map(along).collect();
        let expression = (0..parameters.expression.len()).into_par_iter().map(|k| along(shape_count + k)).collect();
        Ok(BodyGradient { shape, expression, rotations, translation, displacement: unposed_gradient })
    }

    /// See `BodyModel::jacobian`: an analytic form whose cost is that of the rows asked for.
    pub(super) fn vertex_jacobian(&self, parameters: &BodyParameters, vertices: &[u32]) -> Result<DMatrix<f64>> {
        self.check(parameters)?;
        let coefficients = self.coefficients(&parameters.shape, &parameters.expression)?;
        self.description.check_vertices(vertices)?;
        let skeleton = self.skeleton_of(&coefficients, &parameters.rotations);
        let unposed = self.unposed(parameters, &coefficients, &skeleton);
        let rows = JacobianRows::new(self, parameters, &skeleton, &unposed);
        let columns = rows.columns();
        let mut data = vec![0.0; 3 * vertices.len() * columns];
        data.par_chunks_mut(3 * columns).zip(vertices).for_each(|(out, &v)| rows.write(v as usize, out));
        Ok(DMatrix::from_row_slice(3 * vertices.len(), columns, &data))
    }
}

/// What all rows of a Jacobian share.
struct JacobianRows<'a> {
    body: &'a BodySmplx,
    skeleton: &'a Skeleton,
    unposed: &'a [Vec3],
    /// Per joint the world axes about which its three axis-angle components turn.
    axes: Vec<[Vec3; 3]>,
    /// ∂R_j/∂r, row by row, per joint with correctives.
    rotation_derivatives: Vec<[SVector<f64, 9>; 3]>,
    /// Per shape coefficient and joint: d/dβ of the blend transform's translation t_j - G_j J_j [m].
    joint_shape: Vec<Vec<Vec3>>,
}

impl<'a> JacobianRows<'a> {
    fn new(body: &'a BodySmplx, parameters: &BodyParameters, skeleton: &'a Skeleton, unposed: &'a [Vec3]) -> Self {
        let joints = &body.description.joints;
        let derivatives: Vec<[Matrix3<f64>; 3]> =
            body.acting(&parameters.rotations).iter().map(rotation_derivatives).collect();
        let axes = (0..joints.len())
            .map(|j| {
                derivatives[j].map(|d| {
                    // dR Rᵀ = [ω]×: the left Jacobian's column, turned into the world by the parent.
                    let x = d * skeleton.local[j].transpose();
                    let omega = Vec3::new(x[(2, 1)], x[(0, 2)], x[(1, 0)]);
                    joints[j].parent.map_or(omega, |p| skeleton.world[p] * omega)
                })
            })
            .collect();
        let row_major = |m: Matrix3<f64>| SVector::<f64, 9>::from_fn(|k, _| m[(k / 3, k % 3)]);
        let rotation_derivatives =
            body.correctives.iter().flat_map(|c| c.joints()).map(|&j| derivatives[j].map(row_major)).collect();
        let joint_shape = (0..parameters.shape.len())
            .map(|k| {
                let moved = &body.joint_directions[k];
                let mut posed: Vec<Vec3> = Vec::with_capacity(joints.len());
                for (j, joint) in joints.iter().enumerate() {
                    posed.push(match joint.parent {
                        None => moved[j],
                        Some(p) => skeleton.world[p] * (moved[j] - moved[p]) + posed[p],
                    });
                }
                posed.iter().zip(moved).zip(&skeleton.world).map(|((t, m), g)| t - g * m).collect()
            })
            .collect();
        Self { body, skeleton, unposed, axes, rotation_derivatives, joint_shape }
    }
    fn columns(&self) -> usize {
        3 + 3 * self.axes.len() + self.joint_shape.len()
    }
    /// The three rows of a vertex, shape [xyz][columns].
    fn write(&self, vertex: usize, out: &mut [f64]) {
        let columns = self.columns();
        let mut put = |column: usize, value: Vec3| {
            for axis in 0..3 {
                out[axis * columns + column] += value[axis];
            }
        };
        for axis in 0..3 {
            put(axis, Vec3::ith(axis, 1.0));
        }
        // What each joint carries of this vertex: Σ w and Σ w y over the joint and all below it.
        let joints = &self.body.description.joints;
        let mut carried = vec![(0.0, Vec3::zeros()); joints.len()];
        let mut blended = Matrix3::zeros();
        for (j, w) in self.body.description.weights.row(vertex) {
            let y = self.skeleton.world[j] * (self.unposed[vertex] - self.skeleton.rest[j]) + self.skeleton.posed[j];
            blended += self.skeleton.world[j] * w;
            let mut at = Some(j);
            while let Some(a) = at {
                carried[a].0 += w;
                carried[a].1 += y * w;
                at = joints[a].parent;
            }
            for (k, moved) in self.joint_shape.iter().enumerate() {
                put(3 + 3 * joints.len() + k, moved[j] * w);
            }
        }
        for (j, (w, y)) in carried.iter().enumerate() {
            if *w != 0.0 {
                let arm = y - self.skeleton.posed[j] * *w;
                for (k, axis) in self.axes[j].iter().enumerate() {
                    put(3 + 3 * j + k, axis.cross(&arm));
                }
            }
        }
        if let Some(correctives) = &self.body.correctives {
            for (group, (&j, derivatives)) in correctives.joints().iter().zip(&self.rotation_derivatives).enumerate() {
                let turned = blended * correctives.block(vertex, group);
                for (k, derivative) in derivatives.iter().enumerate() {
                    put(3 + 3 * j + k, turned * derivative);
                }
            }
        }
        for k in 0..self.joint_shape.len() {
            put(3 + 3 * joints.len() + k, blended * self.body.directions[k][vertex]);
        }
    }
}
