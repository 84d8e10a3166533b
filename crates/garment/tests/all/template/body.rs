//! Bodies to cut garments on: one of capsules, the mannequin, and the free Anny body where it is there.

use caphy_bodymodel as _;
use caphy_core::body::{BlendWeights, BodyParameters, BodySpec};
use caphy_core::files::Disk;
use caphy_core::pose::{SMPLX_JOINTS, smplx_joint};
use caphy_core::{TriMesh, Vec3};
use caphy_garment::template::BodyRest;
use std::f64::consts::{PI, TAU};
use std::path::PathBuf;

struct Builder {
    mesh: TriMesh,
    rows: Vec<Vec<(u16, f64)>>,
    joints: Vec<Vec3>,
}

impl Builder {
    /// A capsule from `a` to `b`, flattened by `scale` about its axis; each vertex moves with the nearest of `names`.
    fn capsule(&mut self, a: Vec3, b: Vec3, radius: f64, scale: Vec3, names: &[&str]) {
        const AROUND: usize = 24;
        let axis = (b - a).normalize();
        let side = axis.cross(&if axis.y.abs() > 0.9 { Vec3::z() } else { Vec3::y() }).normalize();
        let other = axis.cross(&side);
        let mut rings: Vec<(Vec3, f64)> = (0..=6)
            .map(|i| 0.5 * PI * f64::from(i) / 6.0)
            .map(|t| (a - axis * radius * t.cos(), radius * t.sin()))
            .collect();
        let count = ((b - a).norm() / 0.03).ceil().max(1.0) as usize;
        rings.extend((1..count).map(|i| (a.lerp(&b, i as f64 / count as f64), radius)));
        rings.extend(
            (0..=6).map(|i| 0.5 * PI * f64::from(i) / 6.0).map(|t| (b + axis * radius * t.sin(), radius * t.cos())),
        );
        let first = self.mesh.vertices.len() as u32;
        let middle = (a + b) * 0.5;
        for (centre, r) in &rings {
            for k in 0..AROUND {
                let (s, c) = (TAU * k as f64 / AROUND as f64).sin_cos();
                // No ring shrinks to a point: holes of a micrometre let nothing through.
                let p = centre + (side * c + other * s) * r.max(1e-6);
                self.mesh.vertices.push(middle + (p - middle).component_mul(&scale));
            }
        }
        for i in 0..rings.len() as u32 - 1 {
            for k in 0..AROUND as u32 {
                let (p, q) = (first + i * AROUND as u32 + k, first + i * AROUND as u32 + (k + 1) % AROUND as u32);
                let (r, s) = (p + AROUND as u32, q + AROUND as u32);
                self.mesh.faces.extend([[p, q, r], [q, s, r]]);
            }
        }
        for v in first as usize..self.mesh.vertices.len() {
            let p = self.mesh.vertices[v];
            let ids = names.iter().filter_map(|n| smplx_joint(n));
            let near = ids.min_by(|&i, &j| (self.joints[i] - p).norm().total_cmp(&(self.joints[j] - p).norm()));
            self.rows.push(vec![(near.unwrap_or(0) as u16, 1.0)]);
        }
    }
}

/// A body of overlapping capsules, exactly mirror-symmetric in its joints.
pub(crate) fn capsules() -> BodyRest {
    let mut joints = vec![Vec3::zeros(); SMPLX_JOINTS.len()];
    let places: [(&str, [f64; 3]); 14] = [
        ("pelvis", [0.0, 0.0, 0.0]),
        ("spine1", [0.0, 0.1, 0.0]),
        ("spine2", [0.0, 0.2, 0.0]),
        ("spine3", [0.0, 0.3, 0.0]),
        ("neck", [0.0, 0.5, 0.0]),
        ("head", [0.0, 0.62, 0.0]),
        ("left_collar", [0.06, 0.43, 0.0]),
        ("left_shoulder", [0.18, 0.43, 0.0]),
        ("left_elbow", [0.45, 0.43, 0.0]),
        ("left_wrist", [0.7, 0.43, 0.0]),
        ("left_hip", [0.1, -0.05, 0.0]),
        ("left_knee", [0.1, -0.45, 0.0]),
        ("left_ankle", [0.1, -0.85, 0.0]),
        ("left_foot", [0.1, -0.9, 0.1]),
    ];
    for (name, [x, y, z]) in places {
        joints[smplx_joint(name).unwrap()] = Vec3::new(x, y, z);
        if let Some(rest) = name.strip_prefix("left_") {
            joints[smplx_joint(&format!("right_{rest}")).unwrap()] = Vec3::new(-x, y, z);
        }
    }
    let mut b = Builder { mesh: TriMesh::default(), rows: Vec::new(), joints };
    let v = Vec3::new;
    let one = v(1.0, 1.0, 1.0);
    let spine = ["pelvis", "spine1", "spine2", "spine3"];
    b.capsule(v(0.0, -0.02, 0.0), v(0.0, 0.33, 0.0), 0.14, v(1.15, 1.0, 0.75), &spine);
    b.capsule(v(-0.16, 0.41, 0.0), v(0.16, 0.41, 0.0), 0.06, one, &["spine3", "left_collar", "right_collar"]);
    b.capsule(v(0.0, 0.42, 0.0), v(0.0, 0.62, 0.0), 0.055, one, &["neck"]);
    b.capsule(v(0.0, 0.72, 0.0), v(0.0, 0.73, 0.0), 0.1, one, &["head"]);
    for (side, s) in [("left", 1.0), ("right", -1.0)] {
        let name = |joint: &str| format!("{side}_{joint}");
        let arm = [name("shoulder"), name("elbow"), name("wrist")];
        b.capsule(v(0.18 * s, 0.43, 0.0), v(0.75 * s, 0.43, 0.0), 0.045, one, &arm.each_ref().map(|n| n.as_str()));
        let leg = [name("hip"), name("knee"), name("ankle")];
        b.capsule(v(0.1 * s, -0.05, 0.0), v(0.1 * s, -0.9, 0.0), 0.075, one, &leg.each_ref().map(|n| n.as_str()));
    }
    BodyRest::new(b.mesh, b.joints, BlendWeights::from_rows(b.rows)).unwrap()
}

/// The shared data's folder.
pub(crate) fn shared() -> PathBuf {
    std::env::var_os("CAPHY_SHARED")
        .map_or_else(|| PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared")), PathBuf::from)
}

/// The T-posed body of a `[body]` table and a shape.
fn model(spec: &str, shape: &[f64]) -> BodyRest {
    let body = toml::from_str::<Box<dyn BodySpec>>(spec).unwrap().build(&Disk).unwrap();
    let parameters = BodyParameters::rest(body.describe().joints.len(), shape);
    BodyRest::from_model(&*body, &parameters).unwrap()
}

/// The embedded default body.
pub(crate) fn mannequin() -> BodyRest {
    model("type = \"mannequin\"", &[])
}

/// The Anny body of the shared data with its mean shape; `None`, said aloud, where it is missing.
pub(crate) fn anny() -> Option<BodyRest> {
    let path = shared().join("data/body/anny_smplx_layout.npz");
    if !path.exists() {
        println!("SKIPPED: {} is not there (set CAPHY_SHARED)", path.display());
        return None;
    }
    Some(model(&format!("type = \"smplx\"\npath = '{}'", path.display()), &[]))
}

/// The Anny body with the shape that the shared garments were made for.
pub(crate) fn anny_mid() -> Option<BodyRest> {
    anny()?;
    let path = shared().join("data/body/anny_smplx_layout.npz");
    let npz = caphy_formats::npz::Npz::from_bytes(&path, std::fs::read(&path).unwrap()).unwrap();
    let shape = npz.f64s("ref__0__mid_betas").unwrap().data;
    Some(model(&format!("type = \"smplx\"\npath = '{}'", path.display()), &shape))
}
