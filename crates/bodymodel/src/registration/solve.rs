//! One Gauss-Newton step of all scans: correspondences, residuals, priors, and the arrow system of poses and one shape.

use super::correspondence::NormalIndex;
use super::prior::{Group, HINGE_SD, JointPrior};
use super::settings::RegistrationSettings;
use caphy_core::body::{BodyModel, BodyParameters, PosedBody};
use caphy_core::pose::Pose;
use caphy_core::scan::{Label, LabelledPoints};
use caphy_core::{Error, Result, Vec3, mesh};
use nalgebra::{DMatrix, DVector, Matrix3};
use rayon::prelude::*;

/// A scan prepared for searching.
pub(super) struct ScanData<'a> {
    pub(super) name: &'a str,
    pub(super) labels: &'a [Label],
    pub(super) index: NormalIndex<'a>,
    /// Points that look for the body.
    pub(super) samples: Vec<u32>,
}

/// What stays the same over the iterations.
pub(super) struct Problem<'a> {
    pub(super) body: &'a dyn BodyModel,
    pub(super) settings: &'a RegistrationSettings,
    pub(super) priors: &'a [JointPrior],
    /// Vertices that look for the scans.
    pub(super) samples: &'a [u32],
}

/// The unknowns.
#[derive(Debug, Clone)]
pub(super) struct State {
    pub(super) shape: Vec<f64>,
    pub(super) poses: Vec<Pose>,
}

/// Where in the coarse-to-fine schedule an iteration stands.
#[derive(Debug, Clone, Copy)]
pub(super) struct Level {
    /// Robust scale [m].
    pub(super) scale: f64,
    /// 0: far away, cloth attracts like skin; 1: cloth only bounds.
    pub(super) fineness: f64,
    /// Last group of joints that moves.
    pub(super) group: Group,
    /// Whether the shape moves.
    pub(super) shape: bool,
}

impl Level {
    /// Level of progress `x` in [0, 1] from the settings' first robust scale to the last.
    pub(super) fn at(settings: &RegistrationSettings, x: f64, group: Group, shape: bool) -> Self {
        let ratio = settings.robust_end / settings.robust_start;
        Self { scale: settings.robust_start * ratio.powf(x), fineness: x, group, shape }
    }
}

/// What one pair says: the distance along the scan's normal should be `target`, with a weight.
pub(super) struct Pull {
    /// Wanted n·(v - p) [m]; negative is inside.
    pub(super) target: f64,
    /// 1/σ² [1/m²], robust weight included.
    pub(super) weight: f64,
}

/// The residuals of a vertex at signed distance `r` = n·(v - p) and distance `d` [m] from a scan point.
///
/// Skin is attracted. Cloth holds the body inside: outside it, a stiff pull to the surface; deeper than allowed, a
/// weak pull to that depth; in between only the expected ease, which is weak too.
pub(super) fn pulls(settings: &RegistrationSettings, level: &Level, label: Label, r: f64, d: f64) -> [Pull; 2] {
    let none = || Pull { target: 0.0, weight: 0.0 };
    // Far from the solution cloth says as clearly as skin where a limb is.
    let blend = |fine: f64| settings.skin_sigma.powf(1.0 - level.fineness) * fine.powf(level.fineness);
    match label {
        Label::Ignore => [none(), none()],
        Label::Body => [Pull { target: 0.0, weight: robust(d, level.scale) / settings.skin_sigma.powi(2) }, none()],
        Label::Upper | Label::Lower => {
            let w = robust((d - settings.cloth_depth_max).max(0.0), level.scale);
            let ease = Pull { target: -settings.cloth_ease, weight: w / blend(settings.cloth_ease_sigma).powi(2) };
            let bound = if r > 0.0 {
                Pull { target: 0.0, weight: w / settings.outside_sigma.powi(2) }
            } else if r < -settings.cloth_depth_max {
                Pull { target: -settings.cloth_depth_max, weight: w / blend(settings.cloth_deep_sigma).powi(2) }
            } else {
                none()
            };
            [ease, bound]
        }
    }
}

/// Geman-McClure weight of a residual [m] at a scale [m].
fn robust(d: f64, scale: f64) -> f64 {
    let s = scale * scale;
    (s / (s + d * d)).powi(2)
}

/// A sum of quadratics in the displacements of single vertices: Σ ½ δᵀMδ + bᵀδ.
///
/// Pairs are many, vertices fewer: summing per vertex first keeps the Jacobian small.
struct VertexQuadratics {
    slot_of: Vec<u32>,
    vertices: Vec<u32>,
    matrices: Vec<Matrix3<f64>>,
    vectors: Vec<Vec3>,
    cost: f64,
}

impl VertexQuadratics {
    fn new(vertex_count: usize) -> Self {
        Self { slot_of: vec![u32::MAX; vertex_count], vertices: vec![], matrices: vec![], vectors: vec![], cost: 0.0 }
    }
    fn add(&mut self, vertex: u32, matrix: Matrix3<f64>, vector: Vec3) {
        let slot = &mut self.slot_of[vertex as usize];
        if *slot == u32::MAX {
            *slot = self.vertices.len() as u32;
            self.vertices.push(vertex);
            self.matrices.push(matrix);
            self.vectors.push(vector);
        } else {
            self.matrices[*slot as usize] += matrix;
            self.vectors[*slot as usize] += vector;
        }
    }
    /// Adds a pair of a vertex at `v` and scan point `p` with normal `n`.
    fn pair(
        &mut self,
        settings: &RegistrationSettings,
        level: &Level,
        share: f64,
        vertex: u32,
        v: Vec3,
        p: Vec3,
        n: Vec3,
        label: Label,
    ) {
        if label == Label::Ignore {
            return;
        }
        let (r, d) = (n.dot(&(v - p)), (v - p).norm());
        let mut total = 0.0;
        for pull in pulls(settings, level, label, r, d) {
            if pull.weight > 0.0 {
                let w = pull.weight * share;
                self.add(vertex, n * n.transpose() * w, n * (w * (r - pull.target)));
                total = f64::max(total, w);
                self.cost += 0.5 * w * (r - pull.target).powi(2);
            }
        }
        // Far from the solution surfaces must not only touch but also stop sliding. Later that would only hold a limb's
        // twist, which no smooth surface shows, where it happens to be.
        let sideways = total * SLIDING * (1.0 - level.fineness / TRIAL_END).max(0.0);
        if sideways > 0.0 {
            let tangent = Matrix3::identity() - n * n.transpose();
            self.add(vertex, tangent * sideways, tangent * (v - p) * sideways);
            self.cost += 0.5 * sideways * (d * d - r * r).max(0.0);
        }
    }
    /// A sample without a partner costs as much as one at the edge of the search.
    fn missing(&mut self, settings: &RegistrationSettings, level: &Level, share: f64) {
        self.cost += 0.5 * share * (level.scale / settings.skin_sigma).powi(2) * 0.25;
    }
}

/// Weight of the distance along the surface against that along the normal, in the first iteration.
const SLIDING: f64 = 0.3;

/// How far the trials of start poses go in the coarse-to-fine schedule; sliding is free from there on.
pub(super) const TRIAL_END: f64 = 0.35;

/// Farthest partner, in robust scales: its weight is 1 %.
const REACH: f64 = 3.0;

fn quadratics(
    problem: &Problem,
    scan: &ScanData,
    posed: &PosedBody,
    normals: &[Vec3],
    level: &Level,
) -> VertexQuadratics {
    let settings = problem.settings;
    let mut out = VertexQuadratics::new(posed.vertices.len());
    let reach = REACH * level.scale;
    let share = settings.evidence / problem.samples.len().max(1) as f64;
    for &vertex in problem.samples {
        let (v, n) = (posed.vertices[vertex as usize], normals[vertex as usize]);
        match scan.index.nearest(&v, &n, reach) {
            Some((id, _)) => {
                out.pair(
                    settings,
                    level,
                    share,
                    vertex,
                    v,
                    scan.index.point(id),
                    scan.index.normal(id),
                    scan.labels[id],
                );
            }
            None => out.missing(settings, level, share),
        }
    }
    let body = NormalIndex::new(&posed.vertices, normals, settings.normal_angle_max, |_| true);
    let share = settings.evidence / scan.samples.len().max(1) as f64;
    for &id in &scan.samples {
        let (p, n) = (scan.index.point(id as usize), scan.index.normal(id as usize));
        match body.nearest(&p, &n, reach) {
            Some((vertex, _)) => {
                let v = posed.vertices[vertex];
                out.pair(settings, level, share, vertex as u32, v, p, n, scan.labels[id as usize]);
            }
            None => out.missing(settings, level, share),
        }
    }
    out
}

/// Normal equations of one scan: pose block, shape block, and their coupling.
struct Block {
    pose: DMatrix<f64>,
    coupling: DMatrix<f64>,
    shape: DMatrix<f64>,
    pose_gradient: DVector<f64>,
    shape_gradient: DVector<f64>,
}

/// Levenberg damping: the standard deviation of one step in translation [m], rotation [rad], shape [1].
const STEP_SD: [f64; 3] = [0.1, 0.6, 1.0];
/// Longest step in translation [m], rotation [rad], shape [1]: correspondences do not hold for longer.
const STEP_MAX: [f64; 3] = [0.2, 0.4, 1.0];

fn parameters(shape: &[f64], pose: &Pose) -> BodyParameters {
    BodyParameters {
        shape: shape.to_vec(),
        rotations: pose.rotations.clone(),
        translation: pose.translation,
        ..BodyParameters::default()
    }
}

/// Columns of the body's Jacobian that move, before the shape's.
fn active_columns(priors: &[JointPrior], group: Group) -> Vec<usize> {
    let joints = (0..priors.len()).filter(|&j| priors[j].group <= group).flat_map(|j| [0, 1, 2].map(|k| 3 + 3 * j + k));
    [0, 1, 2].into_iter().chain(joints).collect()
}

/// Poses the body and its normals.
pub(super) fn pose_body(body: &dyn BodyModel, shape: &[f64], pose: &Pose) -> Result<(PosedBody, Vec<Vec3>)> {
    let posed = body.forward(&parameters(shape, pose))?;
    let normals = mesh::vertex_normals(&posed.vertices, &body.describe().faces);
    Ok((posed, normals))
}

/// Prior's gradient and curvature of one rotation component, and its cost.
fn prior_term(prior: &JointPrior, scale: f64, axis: usize, angle: f64) -> (f64, f64, f64) {
    let mut curvature = (prior.sd[axis] * scale).powi(-2);
    if let Some((hinge, sign)) = prior.hinge
        && hinge == axis
        && sign * angle < 0.0
    {
        curvature += HINGE_SD.powi(-2);
    }
    (curvature * angle, curvature, 0.5 * curvature * angle * angle)
}

fn block(problem: &Problem, scan: &ScanData, shape: &[f64], pose: &Pose, level: &Level) -> Result<Block> {
    let (posed, normals) = pose_body(problem.body, shape, pose)?;
    let data = quadratics(problem, scan, &posed, &normals, level);
    let jacobian = problem.body.jacobian(&parameters(shape, pose), &data.vertices)?;
    let columns = active_columns(problem.priors, level.group);
    let pose_count = columns.len();
    let shape_start = 3 + 3 * pose.rotations.len();
    let all: Vec<usize> = columns.iter().copied().chain((0..shape.len()).map(|k| shape_start + k)).collect();
    Error::check_length("columns of the body's Jacobian", shape_start + shape.len(), jacobian.ncols())?;
    Error::check_length("rows of the body's Jacobian", 3 * data.vertices.len(), jacobian.nrows())?;
    // H = Jᵀ M J and g = Jᵀ b with M block-diagonal.
    let a = jacobian.select_columns(&all);
    let mut weighted = a.clone();
    let mut gradient = DVector::zeros(all.len());
    for (c, mut column) in weighted.column_iter_mut().enumerate() {
        let mut sum = 0.0;
        for (i, (m, b)) in data.matrices.iter().zip(&data.vectors).enumerate() {
            let j = Vec3::new(column[3 * i], column[3 * i + 1], column[3 * i + 2]);
            sum += j.dot(b);
            column.fixed_rows_mut::<3>(3 * i).copy_from(&(m * j));
        }
        gradient[c] = sum;
    }
    let mut hessian = a.transpose() * weighted;
    for i in 0..pose_count {
        let kind = usize::from(i >= 3);
        hessian[(i, i)] += STEP_SD[kind].powi(-2);
        if i >= 3 {
            let (joint, axis) = ((columns[i] - 3) / 3, (columns[i] - 3) % 3);
            let angle = pose.rotations[joint][axis];
            let (g, h, _) = prior_term(&problem.priors[joint], problem.settings.pose_prior_scale, axis, angle);
            gradient[i] += g;
            hessian[(i, i)] += h;
        }
    }
    let k = shape.len();
    Ok(Block {
        pose: hessian.view((0, 0), (pose_count, pose_count)).into_owned(),
        coupling: hessian.view((0, pose_count), (pose_count, k)).into_owned(),
        shape: hessian.view((pose_count, pose_count), (k, k)).into_owned(),
        pose_gradient: gradient.rows(0, pose_count).into_owned(),
        shape_gradient: gradient.rows(pose_count, k).into_owned(),
    })
}

/// Moves all scans' poses and the shared shape by one step; returns the largest change of a rotation component [rad] or
/// of the translation [m] per scan.
///
/// The system has an arrow's shape, since scans only meet in the shape: each pose block is eliminated by Schur's
/// complement, the shape is solved, the poses follow.
pub(super) fn step(problem: &Problem, scans: &[&ScanData], state: &mut State, level: &Level) -> Result<Vec<f64>> {
    let blocks: Vec<Block> = scans
        .par_iter()
        .zip(&state.poses)
        .map(|(scan, pose)| block(problem, scan, &state.shape, pose, level))
        .collect::<Result<_>>()?;
    let failed = |scan: &ScanData| {
        Error::numerics(
            format!("registration of scan `{}`", scan.name),
            "the normal equations are not positive definite",
            "look at the scan's labels and units: it must show a body in metres",
        )
    };
    // Per scan H_pp⁻¹ g_p and H_pp⁻¹ H_ps.
    let eliminated: Vec<(DVector<f64>, DMatrix<f64>)> = blocks
        .iter()
        .zip(scans)
        .map(|(b, scan)| {
            let factor = b.pose.clone().cholesky().ok_or_else(|| failed(scan))?;
            Ok((factor.solve(&b.pose_gradient), factor.solve(&b.coupling)))
        })
        .collect::<Result<_>>()?;
    let mut shape_step = DVector::zeros(state.shape.len());
    if level.shape && !state.shape.is_empty() {
        let prior = problem.settings.shape_prior_scale.powi(-2);
        let k = state.shape.len();
        let mut system = DMatrix::identity(k, k) * (prior + STEP_SD[2].powi(-2));
        let mut right = -DVector::from_column_slice(&state.shape) * prior;
        for (b, (y, big_y)) in blocks.iter().zip(&eliminated) {
            system += &b.shape - b.coupling.tr_mul(big_y);
            right -= &b.shape_gradient - b.coupling.tr_mul(y);
        }
        let factor = system.cholesky().ok_or_else(|| {
            Error::numerics(
                "registration, shape",
                "the normal equations are not positive definite",
                "check the scans' units",
            )
        })?;
        shape_step = factor.solve(&right);
        let longest = shape_step.amax();
        if longest > STEP_MAX[2] {
            shape_step *= STEP_MAX[2] / longest;
        }
    }
    let columns = active_columns(problem.priors, level.group);
    let mut moves = Vec::with_capacity(scans.len());
    for ((y, big_y), pose) in eliminated.iter().zip(&mut state.poses) {
        let mut delta = -y - big_y * &shape_step;
        let shift = delta.rows(0, 3).norm();
        let angle = delta.rows(3, delta.len() - 3).amax();
        let shorten = (STEP_MAX[0] / shift.max(STEP_MAX[0])).min(STEP_MAX[1] / angle.max(STEP_MAX[1]));
        delta *= shorten;
        for (value, &column) in delta.iter().zip(&columns) {
            match column {
                0..3 => pose.translation[column] += value,
                _ => pose.rotations[(column - 3) / 3][(column - 3) % 3] += value,
            }
        }
        moves.push(shorten * shift.max(angle));
    }
    state.shape.iter_mut().zip(shape_step.iter()).for_each(|(s, d)| *s += d);
    Ok(moves)
}

/// Cost of one scan at a level: data and pose prior.
pub(super) fn cost(problem: &Problem, scan: &ScanData, shape: &[f64], pose: &Pose, level: &Level) -> Result<f64> {
    let (posed, normals) = pose_body(problem.body, shape, pose)?;
    let mut total = quadratics(problem, scan, &posed, &normals, level).cost;
    for (prior, rotation) in problem.priors.iter().zip(&pose.rotations) {
        for axis in 0..3 {
            total += prior_term(prior, problem.settings.pose_prior_scale, axis, rotation[axis]).2;
        }
    }
    Ok(total + shape.iter().map(|s| 0.5 * s * s / problem.settings.shape_prior_scale.powi(2)).sum::<f64>())
}

/// Prepares a scan: refuses arrays of different lengths and scans without enough usable points.
pub(super) fn prepare<'a>(
    name: &'a str,
    points: &'a LabelledPoints,
    settings: &RegistrationSettings,
) -> Result<ScanData<'a>> {
    let n = points.points.len();
    Error::check_length(&format!("normals of scan `{name}`"), n, points.normals.len())?;
    Error::check_length(&format!("labels of scan `{name}`"), n, points.labels.len())?;
    let finite = |v: &Vec3| v.iter().all(|c| c.is_finite());
    let usable = |i: usize| {
        points.labels[i] != Label::Ignore && finite(&points.points[i]) && points.normals[i].norm_squared() > 0.25
    };
    let ids: Vec<u32> = (0..n as u32).filter(|&i| usable(i as usize)).collect();
    if ids.len() < LEAST_POINTS {
        return Err(Error::mesh(
            name,
            "points",
            format!("{} of {n} have a label, a finite position and a normal; {LEAST_POINTS} are needed", ids.len()),
            "look at the scan and its labels",
        ));
    }
    let kept: Vec<Vec3> = ids.iter().map(|&i| points.points[i as usize]).collect();
    let samples =
        super::correspondence::spread(&kept, settings.sample_vertices).into_iter().map(|i| ids[i as usize]).collect();
    let index = NormalIndex::new(&points.points, &points.normals, settings.normal_angle_max, usable);
    Ok(ScanData { name, labels: &points.labels, index, samples })
}

/// Points below which a scan is not worth fitting: fewer than the unknowns of a pose.
const LEAST_POINTS: usize = 100;
