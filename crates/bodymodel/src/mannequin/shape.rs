//! Shape coefficients of the mannequin: ten smooth displacement fields, each worth about one standard deviation of
//! adults per unit.

use super::figure::PELVIS_HEIGHT;
use super::smoothstep;
use super::surface::Symmetric;
use caphy_core::body::BlendWeights;
use caphy_core::pose::SMPLX_JOINTS;
use caphy_core::query::Adjacency;
use caphy_core::{TriMesh, Vec3};
use rayon::prelude::*;

/// What the shape coefficients mean, in order. The height is exactly 1.72 m (1 + 0.04 stature) + 0.028 m leg length +
/// 0.020 m torso length; shoulder width moves each shoulder by 14 mm, arm length each wrist by 20 mm; the others grow the
/// body along its normals: girth everywhere, belly, limb thickness, chest and hip width where they say.
pub const MANNEQUIN_SHAPE: [&str; 10] = [
    "stature",
    "girth",
    "belly",
    "shoulder width",
    "leg length",
    "arm length",
    "limb thickness",
    "chest",
    "hip width",
    "torso length",
];

/// Growth of a body part along its normal [m] for one unit of girth, and of limb thickness.
fn growth(joint: &str) -> (f64, f64) {
    let part = joint.trim_start_matches("left_").trim_start_matches("right_");
    match part {
        "pelvis" => (0.014, 0.001),
        "spine1" => (0.016, 0.000),
        "spine2" => (0.015, 0.000),
        "spine3" => (0.012, 0.000),
        "collar" => (0.007, 0.002),
        "neck" => (0.005, 0.000),
        "hip" => (0.010, 0.008),
        "knee" => (0.006, 0.005),
        "ankle" | "foot" => (0.001, 0.001),
        "shoulder" => (0.006, 0.006),
        "elbow" => (0.004, 0.004),
        "wrist" => (0.001, 0.001),
        "head" => (0.001, 0.000),
        _ => (0.0, 0.0),
    }
}

/// Displacement fields per unit [m], shape [10][vertex_count].
pub(super) fn directions(body: &Symmetric, weights: &BlendWeights) -> Vec<Vec<Vec3>> {
    let mesh = &body.mesh;
    let normals = smooth_normals(mesh);
    let growth: Vec<(f64, f64)> = SMPLX_JOINTS.iter().map(|j| growth(j)).collect();
    let mut out = vec![Vec::with_capacity(mesh.vertices.len()); MANNEQUIN_SHAPE.len()];
    for (v, (p, n)) in mesh.vertices.iter().zip(&normals).enumerate() {
        let (x, y, z) = (p.x.abs(), p.y + PELVIS_HEIGHT, p.z);
        let side = p.x.signum();
        let bump = |d: f64, width: f64| (-(d / width).powi(2)).exp();
        // The insides of the thighs have little room to grow.
        let room = if y < 0.87 { 0.3 + 0.7 * smoothstep(0.0, 0.08, x) } else { 1.0 };
        let (girth, limb) =
            weights.row(v).fold((0.0, 0.0), |(g, l), (j, w)| (g + room * w * growth[j].0, l + room * w * growth[j].1));
        let trunk = x < 0.3;
        let only = |condition: bool, value: f64| if condition { value } else { 0.0 };
        let fields = [
            p * 0.04,
            n * girth,
            n * only(trunk, 0.020 * bump(y - 1.06, 0.085) * bump(x, 0.12) * smoothstep(-0.03, 0.07, z)),
            Vec3::x() * (side * 0.014 * smoothstep(0.03, 0.17, x) * smoothstep(1.16, 1.30, y)),
            Vec3::y() * (-0.028 * ramp(0.90 - y, 0.74)),
            Vec3::x() * (side * 0.020 * only(y > 1.1, ramp(x - 0.19, 0.495))),
            n * limb,
            n * only(trunk, 0.012 * bump(y - 1.285, 0.055) * bump(x - 0.08, 0.065) * smoothstep(0.02, 0.08, z)),
            n * only(trunk, 0.012 * bump(y - 0.90, 0.095) * smoothstep(0.02, 0.10, x)),
            Vec3::y() * (0.020 * ramp(y - 0.97, 0.43)),
        ];
        for (out, field) in out.iter_mut().zip(fields) {
            out.push(field);
        }
    }
    // Growth along normals would fold the skin in creases (crotch, armpit, under the chin): neighbours share it.
    let adjacency = Adjacency::new(mesh.vertices.len(), &mesh.faces);
    for name in ["girth", "belly", "limb thickness", "chest", "hip width"] {
        if let Some(k) = MANNEQUIN_SHAPE.iter().position(|n| *n == name) {
            for _ in 0..10 {
                out[k] = (0..mesh.vertices.len())
                    .into_par_iter()
                    .map(|v| {
                        let around = adjacency.of(v);
                        let mean = around.iter().map(|&w| out[k][w as usize]).sum::<Vec3>() / around.len() as f64;
                        (out[k][v] + mean) * 0.5
                    })
                    .collect();
            }
        }
    }
    // Sums over neighbours differ in their last bits between the sides.
    for field in &mut out {
        for v in 0..field.len() {
            let of = body.mirror[v] as usize;
            if of <= v {
                field[v] = Vec3::new(if of == v { 0.0 } else { -field[of].x }, field[of].y, field[of].z);
            }
        }
    }
    out
}

/// 0, then rising steadily to 1 over a length, both corners rounded over a tenth of it.
fn ramp(x: f64, length: f64) -> f64 {
    let t = x / length;
    let soft = |t: f64| {
        let r: f64 = 0.1;
        if t < -r {
            0.0
        } else if t > r {
            t
        } else {
            (t + r).powi(2) / (4.0 * r)
        }
    };
    soft(t) - soft(t - 1.0)
}

/// Vertex normals averaged over neighbours, so that bumps do not open creases.
fn smooth_normals(mesh: &TriMesh) -> Vec<Vec3> {
    let adjacency = Adjacency::new(mesh.vertices.len(), &mesh.faces);
    let mut normals = mesh.vertex_normals();
    for _ in 0..3 {
        normals = (0..normals.len())
            .into_par_iter()
            .map(|v| {
                let sum: Vec3 = adjacency.of(v).iter().map(|&w| normals[w as usize]).sum::<Vec3>() + normals[v] * 2.0;
                sum.try_normalize(1e-12).unwrap_or(normals[v])
            })
            .collect();
    }
    normals
}
