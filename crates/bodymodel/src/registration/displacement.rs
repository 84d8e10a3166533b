//! Displacements dT on top of shape and pose (the non-rigid step), and how well the whole fits.
//!
//! dT moves along the normals of the T-posed surface by a smooth height field h that minimises
//! ∫ Σ_scans w (h - t)²/σ_skin² + (h² + ℓ²|∇h|²)/σ_dT² dA, with t the wanted height where bare skin lies on a scan or
//! where skin sticks out of cloth. Skin inside cloth wants nothing.

use super::correspondence::NormalIndex;
use super::solve::{Level, Problem, ScanData, State, pose_body, pulls};
use caphy_core::body::BodyParameters;
use caphy_core::pose::Pose;
use caphy_core::query::Adjacency;
use caphy_core::scan::Label;
use caphy_core::{Result, TriMesh, Vec3, mesh};
use rayon::prelude::*;

/// Farthest partner, in robust scales.
const REACH: f64 = 1.5;
/// Conjugate gradients stop when the residual has fallen this far, or after this many steps.
const TOLERANCE: f64 = 1e-8;
const STEPS_MAX: usize = 400;

/// Half the sum of the two cotangents of an edge between equilateral triangles.
const EDGE_WEIGHT: f64 = 0.577_350_269_189_625_8;

/// The shared displacements dT [m] of all vertices.
pub(super) fn displace(problem: &Problem, scans: &[&ScanData], state: &State, level: &Level) -> Result<Vec<Vec3>> {
    let settings = problem.settings;
    let description = problem.body.describe();
    let n = description.vertex_count;
    if settings.displacement_sigma <= 0.0 {
        return Ok(vec![Vec3::zeros(); n]);
    }
    // Weight and weighted height per vertex and scan.
    let wishes: Vec<Vec<[f64; 2]>> = scans
        .par_iter()
        .zip(&state.poses)
        .map(|(scan, pose)| {
            let (posed, normals) = pose_body(problem.body, &state.shape, pose)?;
            Ok((0..n)
                .map(|v| {
                    let (x, normal) = (posed.vertices[v], normals[v]);
                    let Some((id, d)) = scan.index.nearest(&x, &normal, REACH * level.scale) else { return [0.0; 2] };
                    let r = scan.index.normal(id).dot(&(x - scan.index.point(id)));
                    let label = scan.labels[id];
                    if label != Label::Body && r <= 0.0 {
                        return [0.0; 2];
                    }
                    // Only the bound speaks here, not the expected ease.
                    let weight = pulls(settings, level, label, r, d)
                        .iter()
                        .find(|p| p.target == 0.0 && p.weight > 0.0)
                        .map_or(0.0, |p| p.weight);
                    [weight, -weight * r]
                })
                .collect())
        })
        .collect::<Result<_>>()?;
    let (rest, normals) = pose_body(problem.body, &state.shape, &Pose::rest(description.joints.len()))?;
    let surface = TriMesh { vertices: rest.vertices, faces: description.faces.clone() };
    let areas = surface.vertex_areas();
    let adjacency = Adjacency::new(n, &surface.faces);
    let stiffness = settings.displacement_sigma.powi(-2);
    let edge = EDGE_WEIGHT * settings.displacement_smoothness.powi(2) * stiffness;
    let mut diagonal = vec![0.0; n];
    let mut right = vec![0.0; n];
    for v in 0..n {
        let [w, wt] = wishes.iter().fold([0.0; 2], |s, scan| [s[0] + scan[v][0], s[1] + scan[v][1]]);
        diagonal[v] = areas[v] * (stiffness + w) + edge * adjacency.of(v).len() as f64;
        right[v] = areas[v] * wt;
    }
    let apply = |x: &[f64], out: &mut [f64]| {
        for v in 0..n {
            out[v] = diagonal[v] * x[v] - edge * adjacency.of(v).iter().map(|&w| x[w as usize]).sum::<f64>();
        }
    };
    let height = conjugate_gradients(&apply, &diagonal, &right);
    Ok(normals.iter().zip(height).map(|(n, h)| n * h).collect())
}

/// Solves A x = b for a symmetric positive matrix with a positive diagonal as preconditioner (0/0 rows stay 0).
fn conjugate_gradients(apply: &dyn Fn(&[f64], &mut [f64]), diagonal: &[f64], b: &[f64]) -> Vec<f64> {
    let n = b.len();
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(x, y)| x * y).sum::<f64>();
    let precondition =
        |r: &[f64]| -> Vec<f64> { r.iter().zip(diagonal).map(|(r, d)| if *d > 0.0 { r / d } else { 0.0 }).collect() };
    let mut x = vec![0.0; n];
    let mut r = b.to_vec();
    let mut z = precondition(&r);
    let mut p = z.clone();
    let mut rz = dot(&r, &z);
    let first = rz;
    let mut ap = vec![0.0; n];
    for _ in 0..STEPS_MAX {
        if rz <= first * TOLERANCE * TOLERANCE {
            break;
        }
        apply(&p, &mut ap);
        let curvature = dot(&p, &ap);
        if curvature <= 0.0 {
            break;
        }
        let alpha = rz / curvature;
        for i in 0..n {
            x[i] += alpha * p[i];
            r[i] -= alpha * ap[i];
        }
        z = precondition(&r);
        let next = dot(&r, &z);
        let beta = next / rz;
        rz = next;
        for i in 0..n {
            p[i] = z[i] + beta * p[i];
        }
    }
    x
}

/// What [`measure`] finds; see `ScanFit` for the meaning, here in metres.
pub(super) struct Fit {
    pub(super) skin_rms: f64,
    pub(super) skin_found_share: f64,
    pub(super) inside_share: f64,
    pub(super) cloth_depth: f64,
}

/// Skin that sticks out of cloth by less than this counts as inside [m]: scan noise.
const INSIDE_TOLERANCE: f64 = 0.002;

/// Measures the fit of one scan with its displacements.
pub(super) fn measure(
    problem: &Problem,
    scan: &ScanData,
    state: &State,
    which: usize,
    displacement: &[Vec3],
    level: &Level,
) -> Result<Fit> {
    let pose = &state.poses[which];
    let posed = problem.body.forward(&BodyParameters {
        shape: state.shape.clone(),
        rotations: pose.rotations.clone(),
        translation: pose.translation,
        displacement: displacement.to_vec(),
        ..BodyParameters::default()
    })?;
    let normals = mesh::vertex_normals(&posed.vertices, &problem.body.describe().faces);
    let body = NormalIndex::new(&posed.vertices, &normals, problem.settings.normal_angle_max, |_| true);
    let (mut skin, mut found, mut squares) = (0usize, 0usize, 0.0);
    for &id in scan.samples.iter().filter(|&&id| scan.labels[id as usize] == Label::Body) {
        let (p, n) = (scan.index.point(id as usize), scan.index.normal(id as usize));
        skin += 1;
        if let Some((v, _)) = body.nearest(&p, &n, level.scale) {
            found += 1;
            squares += n.dot(&(posed.vertices[v] - p)).powi(2);
        }
    }
    let mut depths = Vec::new();
    for &v in problem.samples {
        let x = posed.vertices[v as usize];
        if let Some((id, _)) = scan.index.nearest(&x, &normals[v as usize], REACH * level.scale)
            && scan.labels[id] != Label::Body
        {
            depths.push(-scan.index.normal(id).dot(&(x - scan.index.point(id))));
        }
    }
    depths.sort_by(f64::total_cmp);
    let inside = depths.iter().filter(|&&d| d > -INSIDE_TOLERANCE).count();
    let share = |part: usize, whole: usize| if whole == 0 { 1.0 } else { part as f64 / whole as f64 };
    Ok(Fit {
        skin_rms: if found == 0 { 0.0 } else { (squares / found as f64).sqrt() },
        skin_found_share: share(found, skin),
        inside_share: share(inside, depths.len()),
        cloth_depth: depths.get(depths.len() / 2).copied().unwrap_or(0.0),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn conjugate_gradients_solve_a_chain() {
        let n = 60;
        let diagonal = vec![2.1; n];
        let apply = |x: &[f64], out: &mut [f64]| {
            for i in 0..n {
                let left = if i > 0 { x[i - 1] } else { 0.0 };
                let right = if i + 1 < n { x[i + 1] } else { 0.0 };
                out[i] = 2.1 * x[i] - left - right;
            }
        };
        let truth: Vec<f64> = (0..n).map(|i| (i as f64 * 0.7).sin()).collect();
        let mut b = vec![0.0; n];
        apply(&truth, &mut b);
        let x = conjugate_gradients(&apply, &diagonal, &b);
        assert!(x.iter().zip(&truth).all(|(a, b)| (a - b).abs() < 1e-6));
    }
}
