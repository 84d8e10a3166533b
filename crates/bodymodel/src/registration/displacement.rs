//! Displacements dT on top of shape and pose (the non-rigid step), and how well the whole fits.
//!
//! dT moves along the normals of the T-posed surface by a smooth height field h that minimises
//! ∫ Σ_scans w (h - t)²/σ_skin² + (h² + ℓ²|∇h|²)/σ_dT² dA, with t the wanted height where bare skin lies on a scan or
//! where skin sticks out of cloth. Skin inside cloth wants nothing, but where cloth comes near in some of the poses it is taken to touch.

use super::correspondence::NormalIndex;
use super::rows::{Pull, pulls, robust};
use super::settings::RegistrationSettings;
use super::solve::{Level, Problem, ScanData, State, pose_body};
use caphy_core::pose::Pose;
use caphy_core::query::Adjacency;
use caphy_core::scan::Label;
use caphy_core::{Result, TriMesh, Vec3};
use rayon::prelude::*;

/// Farthest partner, in robust scales or greatest depths of cloth.
const REACH: f64 = 1.5;

/// How far partners may be [m].
fn reach(settings: &RegistrationSettings, level: &Level) -> f64 {
    REACH * level.scale.max(settings.cloth_depth_max)
}
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
    let (rest, normals) = pose_body(problem.body, &state.shape, &Pose::rest(description.joints.len()), &[])?;
    let heights: Vec<f64> = match &state.displacement[..] {
        [] => vec![0.0; n],
        known => known.iter().zip(&normals).map(|(d, n)| d.dot(n)).collect(),
    };
    let told: Vec<Vec<Told>> = scans
        .par_iter()
        .zip(&state.poses)
        .map(|(scan, pose)| {
            let (posed, normals) = pose_body(problem.body, &state.shape, pose, &state.displacement)?;
            Ok((0..n).map(|v| tell(settings, scan, level, posed.vertices[v], normals[v])).collect())
        })
        .collect::<Result<_>>()?;
    let surface = TriMesh { vertices: rest.vertices, faces: description.faces.clone() };
    let areas = surface.vertex_areas();
    let adjacency = Adjacency::new(n, &surface.faces);
    let stiffness = settings.displacement_sigma.powi(-2);
    let edge = EDGE_WEIGHT * settings.displacement_smoothness.powi(2) * stiffness;
    let mut diagonal = vec![0.0; n];
    let mut right = vec![0.0; n];
    for v in 0..n {
        // What lacks at the height that is there already.
        let (mut weight, mut lacks, mut depths) = (0.0, 0.0, Vec::new());
        for scan in &told {
            match scan[v] {
                Told::Nothing => {}
                Told::Height { weight: w, lack } => (weight, lacks) = (weight + w, lacks + w * lack),
                Told::Depth(depth) => depths.push(depth),
            }
        }
        if let Some(pull) = touching(settings, &mut depths) {
            (weight, lacks) = (weight + pull.weight, lacks + pull.weight * pull.target);
        }
        diagonal[v] = areas[v] * (stiffness + weight) + edge * adjacency.of(v).len() as f64;
        right[v] = areas[v] * (lacks + weight * heights[v]);
    }
    let apply = |x: &[f64], out: &mut [f64]| {
        for v in 0..n {
            out[v] = diagonal[v] * x[v] - edge * adjacency.of(v).iter().map(|&w| x[w as usize]).sum::<f64>();
        }
    };
    let height = conjugate_gradients(&apply, &diagonal, &right);
    Ok(normals.iter().zip(height).map(|(n, h)| n * h).collect())
}

/// What one scan says of one vertex.
#[derive(Debug, Clone, Copy)]
enum Told {
    Nothing,
    /// It should be higher by `lack` [m], with a weight [1/m²].
    Height {
        weight: f64,
        lack: f64,
    },
    /// It lies under cloth at this depth [m].
    Depth(f64),
}

fn tell(settings: &RegistrationSettings, scan: &ScanData, level: &Level, x: Vec3, normal: Vec3) -> Told {
    let Some((id, d)) = scan.index.nearest(&x, &normal, reach(settings, level)) else { return Told::Nothing };
    let r = scan.index.normal(id).dot(&(x - scan.index.point(id)));
    let label = scan.labels[id];
    if label != Label::Body && r <= 0.0 {
        return Told::Depth(-r);
    }
    // Only the bound speaks here, not the expected ease.
    let bound = pulls(settings, level, label, r, d).into_iter().find(|p| p.target == 0.0 && p.weight > 0.0);
    bound.map_or(Told::Nothing, |p| Told::Height { weight: p.weight, lack: -r })
}

/// Share of the scans in which cloth may come nearer than where it touches: poses are not exact.
const NEARER: f64 = 0.2;

/// How much higher a covered vertex should be, by its depths in all scans [m]: over many poses cloth comes to lie on nearly all skin, so that
/// where it comes near it is taken to touch. (The minimal clothing of Zhang et al. 2017 is seen in the same way.) Cloth that stays far
/// away says little, and one scan alone nothing.
fn touching(settings: &RegistrationSettings, depths: &mut [f64]) -> Option<Pull> {
    depths.sort_by(f64::total_cmp);
    if depths.len() < 2 {
        return None;
    }
    let lack = depths[(NEARER * depths.len() as f64) as usize] - settings.contact_gap;
    let weight = robust(lack, settings.contact_reach) / settings.contact_sigma.powi(2);
    (lack > 0.0).then_some(Pull { target: lack, weight })
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
pub(super) fn measure(problem: &Problem, scan: &ScanData, state: &State, which: usize, level: &Level) -> Result<Fit> {
    let pose = &state.poses[which];
    let (posed, normals) = pose_body(problem.body, &state.shape, pose, &state.displacement)?;
    let body = NormalIndex::new(&posed.vertices, &normals, problem.settings.normal_angle_max, |_| true);
    let (mut skin, mut found, mut squares) = (0usize, 0usize, 0.0);
    for &id in scan.samples.many.iter().filter(|&&id| scan.labels[id as usize] == Label::Body) {
        let (p, n) = (scan.index.point(id as usize), scan.index.normal(id as usize));
        skin += 1;
        if let Some((v, _)) = body.nearest(&p, &n, level.scale) {
            found += 1;
            squares += n.dot(&(posed.vertices[v] - p)).powi(2);
        }
    }
    let mut depths = Vec::new();
    for &v in &problem.samples.many {
        let x = posed.vertices[v as usize];
        if let Some((id, _)) = scan.index.nearest(&x, &normals[v as usize], reach(problem.settings, level))
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
    fn cloth_that_comes_near_in_some_poses_touches() {
        let settings = RegistrationSettings::default();
        assert!(touching(&settings, &mut [0.004]).is_none(), "one pose says nothing");
        assert!(touching(&settings, &mut [0.002; 5]).is_none(), "it touches already");
        // The nearest of five may be a pose that is off: the second, 5 mm deep where 3 mm touch.
        let near = touching(&settings, &mut [0.02, 0.001, 0.005, 0.012, 0.03]).unwrap();
        assert!((near.target - 0.002).abs() < 1e-12);
        let far = touching(&settings, &mut [0.04; 5]).unwrap();
        assert!(far.weight < 1e-3 * near.weight);
    }

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
