//! One Gauss-Newton step of all scans: correspondences, residuals, priors, and the arrow system of poses and one shape.

use super::correspondence::{NormalIndex, Samples};
use super::prior::{Group, HINGE_SD, JointPrior};
use super::rows::Rows;
use super::settings::RegistrationSettings;
use caphy_core::body::{BodyModel, BodyParameters, PosedBody};
use caphy_core::pose::Pose;
use caphy_core::query::Fans;
use caphy_core::scan::{Label, LabelledPoints};
use caphy_core::{Error, Result, Vec3, mesh};
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

/// A scan prepared for searching.
pub(super) struct ScanData<'a> {
    pub(super) name: &'a str,
    pub(super) labels: &'a [Label],
    pub(super) index: NormalIndex<'a>,
    /// Points that look for the body.
    pub(super) samples: Samples,
}

/// What stays the same over the iterations.
pub(super) struct Problem<'a> {
    pub(super) body: &'a dyn BodyModel,
    pub(super) settings: &'a RegistrationSettings,
    pub(super) priors: &'a [JointPrior],
    /// Vertices that look for the scans.
    pub(super) samples: &'a Samples,
    pub(super) fans: &'a Fans,
}

/// The unknowns.
#[derive(Debug, Clone)]
pub(super) struct State {
    pub(super) shape: Vec<f64>,
    pub(super) poses: Vec<Pose>,
    /// dT of the T-posed surface [m]; none until it is known.
    pub(super) displacement: Vec<Vec3>,
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

/// How far the trials of start poses go in the coarse-to-fine schedule; sliding is free from there on.
pub(super) const TRIAL_END: f64 = 0.35;

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

fn parameters(shape: &[f64], pose: &Pose, displacement: &[Vec3]) -> BodyParameters {
    BodyParameters {
        shape: shape.to_vec(),
        displacement: displacement.to_vec(),
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
pub(super) fn pose_body(
    body: &dyn BodyModel,
    shape: &[f64],
    pose: &Pose,
    displacement: &[Vec3],
) -> Result<(PosedBody, Vec<Vec3>)> {
    let posed = body.forward(&parameters(shape, pose, displacement))?;
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

fn block(problem: &Problem, scan: &ScanData, state: &State, pose: &Pose, level: &Level) -> Result<Block> {
    let (shape, displacement) = (&state.shape[..], &state.displacement[..]);
    let (posed, normals) = pose_body(problem.body, shape, pose, displacement)?;
    let data = Rows::new(problem, scan, &posed, &normals, level);
    let jacobian = problem.body.jacobian(&parameters(shape, pose, displacement), &data.vertices)?;
    let columns = active_columns(problem.priors, level.group);
    let pose_count = columns.len();
    let shape_start = 3 + 3 * pose.rotations.len();
    let all: Vec<usize> = columns.iter().copied().chain((0..shape.len()).map(|k| shape_start + k)).collect();
    Error::check_length("columns of the body's Jacobian", shape_start + shape.len(), jacobian.ncols())?;
    Error::check_length("rows of the body's Jacobian", 3 * data.vertices.len(), jacobian.nrows())?;
    let (mut hessian, mut gradient) = data.equations(&jacobian.select_columns(&all));
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
        .map(|(scan, pose)| block(problem, scan, state, pose, level))
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
    let (posed, normals) = pose_body(problem.body, shape, pose, &[])?;
    let mut total = Rows::new(problem, scan, &posed, &normals, level).cost;
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
    let samples = Samples::new(&kept, settings.sample_vertices).of(&ids);
    let index = NormalIndex::new(&points.points, &points.normals, settings.normal_angle_max, usable);
    Ok(ScanData { name, labels: &points.labels, index, samples })
}

/// Points below which a scan is not worth fitting: fewer than the unknowns of a pose.
const LEAST_POINTS: usize = 100;
