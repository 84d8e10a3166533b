//! Eq. 10 on shapes of a garment: forces of strain, bending, gravity and waistband at every vertex that touches nothing.

use super::balance_system::BalanceSystem;
use super::capture::Capture;
use super::equilibrium::Problem;
use super::force_balance::{FabricEstimate, ForceBalanceSettings, reported, solve};
use super::reduction::Reduction;
use crate::GarmentRest;
use crate::energy::{Attachment, Bending, Gravity, Single, SingleTerm, State, Strain, nearest_body_vertices};
use crate::solver::Forces;
use caphy_core::lanes::Frames;
use caphy_core::material::MaterialModel;
use caphy_core::{Error, Result, Vec3};
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Times that A is taken anew where clamps of the fabric may have switched, or its forces are not linear.
const RENEWALS: usize = 12;
/// Steps down the slope for a fabric that is not linear in its parameters.
const DESCENTS: usize = 400;

/// By what the energy is differentiated in Eq. 10.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum GradientBy {
    /// Canonical displacements dV as Eq. 10 is printed: Mᵀ f with M the blended transform of each vertex.
    #[default]
    Canonical,
    /// World positions: f itself.
    World,
}

/// How the shapes of a cloth are asked for their fabric.
pub struct ShapeBalance<'a> {
    /// The cloth.
    pub rest: &'a GarmentRest,
    /// What acts on it.
    pub forces: Forces,
    /// The poses that the shapes belong to: clamps, waistband, bodies, blended transforms. Their scans are not looked at.
    pub captures: &'a [Capture],
    /// By what the energy is differentiated.
    pub gradient: GradientBy,
    /// Rows of vertices nearer to the body than the contact margin plus this are dropped [m]: above the noise of the shapes.
    pub contact_slack_m: f64,
}

struct Kept {
    /// Vertices whose rows count.
    vertices: Vec<usize>,
    frame: Frames<f64>,
    flat: Vec<f64>,
    targets: Vec<f64>,
}

impl<'a> ShapeBalance<'a> {
    /// For the cloth, forces and poses of a problem.
    pub fn of(problem: &'a Problem, gradient: GradientBy, contact_slack_m: f64) -> Self {
        let Problem { rest, forces, captures, .. } = problem;
        Self { rest, forces: *forces, captures, gradient, contact_slack_m }
    }

    /// Solves Eq. 10 for a reduction's multipliers, starting at `multipliers` of `material`; λ_reg pulls back to them.
    ///
    /// A material that is linear in its parameters is solved as bounded least squares, A taken anew until no clamp switches; any
    /// other goes down the slope of Eq. 10.
    ///
    /// # Errors
    /// [`Error::Length`] for shapes of another garment, [`Error::Unsupported`] for a material without derivatives by its
    /// parameters or a reduction that is not one of factors.
    pub fn estimate(
        &self,
        material: &dyn MaterialModel,
        reduction: &Reduction,
        multipliers: &[f64],
        shapes: &[Vec<Vec3>],
        settings: &ForceBalanceSettings,
    ) -> Result<FabricEstimate> {
        if !reduction.logarithmic {
            return Err(Error::unsupported("a reduction to combinations", "Eq. 10"));
        }
        Error::check_length("shapes, one per pose", self.captures.len(), shapes.len())?;
        let kept: Vec<Kept> = self.captures.iter().zip(shapes).map(|(c, x)| self.kept(c, x)).collect::<Result<_>>()?;
        let start = DVector::from_column_slice(multipliers);
        let first = self.system(material, reduction, &start, &kept)?;
        let before = first.residual(&start);
        let mut m = start.clone();
        let mut system = first;
        let linear = material.describe().linear_in_parameters;
        let solution = if linear {
            let mut solution = solve(&system, &reduction.names, &start, settings)?;
            for _ in 0..RENEWALS {
                let moved = (&solution.multipliers - &m).component_div(&m).amax();
                m.clone_from(&solution.multipliers);
                if moved < 1e-12 {
                    break;
                }
                system = self.system(material, reduction, &m, &kept)?;
                solution = solve(&system, &reduction.names, &start, settings)?;
            }
            solution
        } else {
            m = self.descend(material, reduction, &start, &kept, settings)?;
            system = self.system(material, reduction, &m, &kept)?;
            let mut solution = solve(&system, &reduction.names, &m, settings)?;
            solution.multipliers.clone_from(&m);
            solution
        };
        let values = values_of(reduction, &solution.multipliers);
        let after = self.system(material, reduction, &solution.multipliers, &kept)?.residual(&solution.multipliers);
        let all: usize = shapes.iter().map(|x| 3 * x.len()).sum();
        Ok(reported(&reduction.names, values, &solution, [before, after], [system.rows, all], settings))
    }

    fn kept(&self, capture: &Capture, x: &[Vec3]) -> Result<Kept> {
        let n = self.rest.vertex_count();
        Error::check_length(&format!("vertices of the shape of pose `{}`", capture.name), n, x.len())?;
        let mut frame = Frames::zeros(1, n, 1);
        frame.set_frame(0, 0, x)?;
        let mut keep = vec![true; n];
        let held = self.rest.held.iter().flat_map(|set| &set.vertices);
        capture.fixed.iter().chain(held).for_each(|&v| keep[v as usize] = false);
        if let Some(body) = &capture.body {
            let nearest = match &body.search {
                Some(search) => search(&frame, &body.positions)?,
                None => nearest_body_vertices(&frame, &body.positions)?,
            };
            let lanes = nearest.len() / n.max(1);
            let margin = self.forces.contact.margin + self.contact_slack_m;
            for (v, keep) in keep.iter_mut().enumerate() {
                let id = nearest[v * lanes] as usize;
                let gap = x[v] - body.positions.get(0, 0, id);
                *keep &= body.normals.get(0, 0, id).dot(&gap) >= margin;
            }
        }
        let flat = |v: &[Vec3]| v.iter().flat_map(|p| [p.x, p.y, p.z]).collect::<Vec<f64>>();
        let vertices = (0..n).filter(|&v| keep[v]).collect();
        Ok(Kept { vertices, frame, flat: flat(x), targets: flat(&capture.targets) })
    }

    /// A and b at multipliers, the rows of all poses one after the other.
    fn system(
        &self,
        material: &dyn MaterialModel,
        reduction: &Reduction,
        m: &DVector<f64>,
        kept: &[Kept],
    ) -> Result<BalanceSystem> {
        let y: Vec<f64> = m.iter().map(|m| m.ln()).collect();
        let now: Arc<dyn MaterialModel> = Arc::from(reduction.material(material, &y)?);
        let strain = Strain::<f64>::new(self.rest, now.clone());
        let bending = Bending::<f64>::new(self.rest, now, self.forces.rest_angle);
        let n = reduction.len();
        let directions: Vec<Vec<f64>> = (0..n).map(|k| reduction.direction(&y, k)).collect();
        let parts: Vec<Result<BalanceSystem>> = kept
            .par_iter()
            .zip(self.captures)
            .map(|(kept, capture)| {
                let state = State::new(&kept.frame);
                let size = kept.flat.len();
                let mut columns = Vec::with_capacity(n + 1);
                for (direction, m) in directions.iter().zip(m.iter()) {
                    let mut column = vec![0.0; size];
                    strain.add_by_direction(&state, self.forces.weights[0], direction, &mut column)?;
                    bending.add_by_direction(&state, self.forces.weights[1], direction, &mut column)?;
                    // By the multiplier, not by its logarithm.
                    column.iter_mut().for_each(|c| *c /= m);
                    columns.push(column);
                }
                let mut force = self.gradient(&strain, &bending, kept)?;
                for (column, m) in columns.iter().zip(m.iter()) {
                    force.iter_mut().zip(column).for_each(|(f, c)| *f -= c * m);
                }
                columns.push(force);
                Ok(BalanceSystem::of_rows(self.rows(kept, capture, &columns)))
            })
            .collect();
        let mut all = BalanceSystem::new(n);
        for part in parts {
            all.join(&part?);
        }
        Ok(all)
    }
    fn gradient(&self, strain: &Strain<f64>, bending: &Bending<f64>, kept: &Kept) -> Result<Vec<f64>> {
        let [stretch, bend, weight, _, hold] = self.forces.weights;
        let mut out = vec![0.0; kept.flat.len()];
        let single = Single { positions: &kept.flat, body: None, targets: Some(&kept.targets) };
        strain.add_single(&single, stretch, Some(&mut out))?;
        bending.add_single(&single, bend, Some(&mut out))?;
        Gravity::new(self.rest, self.forces.gravity).add_single(&single, weight, Some(&mut out))?;
        if !self.rest.held.is_empty() {
            Attachment::new(self.rest, self.forces.attachment).add_single(&single, hold, Some(&mut out))?;
        }
        Ok(out)
    }
    /// Rows of the vertices that count, by canonical displacements where asked for.
    fn rows(&self, kept: &Kept, capture: &Capture, columns: &[Vec<f64>]) -> DMatrix<f64> {
        let blended = self.gradient == GradientBy::Canonical && !capture.blends.is_empty();
        let mut out = DMatrix::zeros(3 * kept.vertices.len(), columns.len());
        for (k, column) in columns.iter().enumerate() {
            for (r, &v) in kept.vertices.iter().enumerate() {
                let world = Vec3::new(column[3 * v], column[3 * v + 1], column[3 * v + 2]);
                let g = if blended { capture.blends[v].transpose() * world } else { world };
                (0..3).for_each(|axis| out[(3 * r + axis, k)] = g[axis]);
            }
        }
        out
    }

    /// ½‖f‖² + ½ Σ λ_k ℓ_k² (m_k − start_k)² (logarithms where asked for) down its slope, unknowns scaled by their columns at the start.
    fn descend(
        &self,
        material: &dyn MaterialModel,
        reduction: &Reduction,
        start: &DVector<f64>,
        kept: &[Kept],
        settings: &ForceBalanceSettings,
    ) -> Result<DVector<f64>> {
        let n = reduction.len();
        let regularisation = settings.regularisations(&reduction.names)?;
        // Logarithms throughout: steps down a slope stay positive.
        let y0 = start.map(f64::ln);
        let reach = settings.largest_factor.ln();
        let first = self.system(material, reduction, start, kept)?;
        let lengths = first.column_lengths();
        let unit = DVector::from_fn(n, |k, _| if lengths[k] > 0.0 { 1.0 / (lengths[k] * start[k]) } else { 0.0 });
        let value_and_slope = |y: &DVector<f64>| -> Result<(f64, DVector<f64>)> {
            let m = y.map(f64::exp);
            let system = self.system(material, reduction, &m, kept)?;
            let (half, slope) = system.half_square(&m);
            let pull = |k: usize| regularisation[k] * (lengths[k] * start[k]).powi(2);
            let back: f64 = (0..n).map(|k| 0.5 * pull(k) * (y[k] - y0[k]).powi(2)).sum();
            let g = DVector::from_fn(n, |k, _| (slope[k] * m[k] + pull(k) * (y[k] - y0[k])) * unit[k]);
            Ok((half + back, g))
        };
        let mut y = y0.clone();
        let (mut value, mut g) = value_and_slope(&y)?;
        // In scaled unknowns the curvature is about one.
        let mut step = 1.0;
        for _ in 0..DESCENTS {
            let mut taken = false;
            for _ in 0..30 {
                let next =
                    DVector::from_fn(n, |k, _| (y[k] - step * g[k] * unit[k]).clamp(y0[k] - reach, y0[k] + reach));
                let d = &next - &y;
                let promised: f64 = (0..n).filter(|&k| unit[k] > 0.0).map(|k| -g[k] * d[k] / unit[k]).sum();
                if promised <= 1e-14 * value {
                    return Ok(y.map(f64::exp));
                }
                let (v, ng) = value_and_slope(&next)?;
                if v <= value - 1e-4 * promised {
                    // Barzilai and Borwein: the next step's length from how the slope changed.
                    let scaled = DVector::from_fn(n, |k, _| if unit[k] > 0.0 { d[k] / unit[k] } else { 0.0 });
                    let change = &ng - &g;
                    let curvature = scaled.dot(&change);
                    if curvature > 0.0 {
                        step = (scaled.norm_squared() / curvature).clamp(1e-6, 1e6);
                    }
                    (y, value, g, taken) = (next, v, ng, true);
                    break;
                }
                step *= 0.3;
            }
            if !taken {
                break;
            }
        }
        Ok(y.map(f64::exp))
    }
}

fn values_of(reduction: &Reduction, m: &DVector<f64>) -> Vec<f64> {
    reduction.values(&m.iter().map(|m| m.ln()).collect::<Vec<_>>())
}
