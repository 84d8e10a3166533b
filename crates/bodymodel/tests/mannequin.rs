//! The mannequin as a body: closed, skinned without bleeding, shaped, quick, the same every time.

use caphy_bodymodel::BodyMannequin;
use caphy_bodymodel::mannequin::MANNEQUIN_SHAPE;
use caphy_core::body::{BodyModel, BodyParameters, BodySpec};
use caphy_core::pose::{SMPLX_JOINTS, smplx_joint};
use caphy_core::query::{Adjacency, hinges};
use caphy_core::{TriMesh, Vec3};

fn volume(mesh: &TriMesh) -> f64 {
    (0..mesh.faces.len())
        .map(|f| {
            let [a, b, c] = mesh.corners(f);
            a.dot(&b.cross(&c)) / 6.0
        })
        .sum()
}

#[test]
fn it_is_one_closed_surface_of_an_adult() {
    let body = BodyMannequin::default().generate().unwrap();
    let d = body.describe();
    let mesh = TriMesh::new("mannequin", body.shaped(&[], &[]).unwrap(), d.faces.clone()).unwrap();
    assert!((6000..9000).contains(&mesh.vertices.len()), "{} vertices", mesh.vertices.len());
    let (good, bad) = hinges(&mesh.faces);
    assert!(bad.is_empty() && 2 * good.len() == 3 * mesh.faces.len());
    assert_eq!(Adjacency::new(mesh.vertices.len(), &mesh.faces).components().1, 1);
    // A closed surface without handles: V - E + F = 2.
    assert_eq!(mesh.vertices.len() + mesh.faces.len(), good.len() + 2);
    let (lo, hi) = mesh.bounds().unwrap();
    assert!(((hi.y - lo.y) - 1.72).abs() < 0.01, "height {}", hi.y - lo.y);
    assert!((hi.x + lo.x).abs() < 0.004 && ((hi.x - lo.x) - 1.73).abs() < 0.03, "span {}", hi.x - lo.x);
    // 1.72 m and about 65 kg at 1.0 kg/l.
    assert!((0.055..0.072).contains(&volume(&mesh)), "volume {}", volume(&mesh));
    for f in 0..mesh.faces.len() {
        let [a, b, c] = mesh.corners(f);
        let sides = (b - a).norm_squared() + (c - b).norm_squared() + (a - c).norm_squared();
        // 1 for equilateral triangles.
        let quality = 2.0 * 3f64.sqrt() * (b - a).cross(&(c - a)).norm() / sides;
        assert!(quality > 0.4, "face {f} is a sliver: {quality}");
    }
}

#[test]
fn joints_are_where_the_figure_has_them_and_in_order() {
    let body = BodyMannequin::default().generate().unwrap();
    let joints = body.forward(&BodyParameters::rest(55, &[])).unwrap().joints;
    let at = |name: &str| joints[smplx_joint(name).unwrap()];
    assert!(at("pelvis").norm() < 1e-9);
    for (j, name) in SMPLX_JOINTS.iter().enumerate() {
        let mirror = name.replace("left_", "right_");
        if mirror != *name {
            let m = at(&mirror);
            assert!((joints[j] - Vec3::new(-m.x, m.y, m.z)).norm() < 1e-9, "{name}");
        }
    }
    assert!(at("left_wrist").x > at("left_elbow").x && at("left_elbow").x > at("left_shoulder").x);
    assert!(at("left_ankle").y < at("left_knee").y && at("left_knee").y < at("left_hip").y);
    assert!(at("left_foot").z > at("left_ankle").z);
}

#[test]
fn skin_follows_its_own_limb() {
    let body = BodyMannequin::default().generate().unwrap();
    let d = body.describe();
    let vertices = body.shaped(&[], &[]).unwrap();
    for (v, p) in vertices.iter().enumerate() {
        let row: Vec<(usize, f64)> = d.weights.row(v).collect();
        assert!(row.len() <= 6 && (row.iter().map(|(_, w)| w).sum::<f64>() - 1.0).abs() < 1e-12);
        let of = |names: &[&str]| -> f64 {
            row.iter().filter(|(j, _)| names.contains(&SMPLX_JOINTS[*j])).map(|(_, w)| w).sum()
        };
        // Well below the crotch nothing follows the other leg; above it only what lies near the middle does.
        let other = if p.x > 0.0 { ["right_hip", "right_knee"] } else { ["left_hip", "left_knee"] };
        if p.y < -0.25 {
            assert!(of(&other) == 0.0, "vertex {v} at {p:?}");
        } else if p.x.abs() > 0.05 {
            assert!(of(&other) < 0.02, "vertex {v} at {p:?}: {}", of(&other));
        }
        // The chest's side under the armpit is not the arm's.
        if p.y < 0.30 && p.x.abs() < 0.30 {
            assert!(
                of(&["left_shoulder", "right_shoulder", "left_elbow", "right_elbow"]) < 0.05,
                "vertex {v} at {p:?}"
            );
        }
        if p.x.abs() > 0.55 {
            let side = if p.x > 0.0 { "left_" } else { "right_" };
            assert!(row.iter().all(|(j, _)| SMPLX_JOINTS[*j].starts_with(side)), "vertex {v} at {p:?}");
        }
    }
}

#[test]
fn shape_coefficients_do_what_they_are_called() {
    let body = BodyMannequin::default().generate().unwrap();
    assert_eq!(body.describe().shape_count, MANNEQUIN_SHAPE.len());
    let faces = &body.describe().faces;
    let measure = |k: usize, value: f64| {
        let mut shape = vec![0.0; MANNEQUIN_SHAPE.len()];
        shape[k] = value;
        let posed = body.forward(&BodyParameters::rest(55, &shape)).unwrap();
        let mesh = TriMesh { vertices: posed.vertices, faces: faces.clone() };
        (mesh, posed.joints)
    };
    let (rest, joints) = measure(0, 0.0);
    for (k, name) in MANNEQUIN_SHAPE.iter().enumerate() {
        for value in [-2.5, 2.5] {
            let (mesh, _) = measure(k, value);
            let largest = mesh.vertices.iter().zip(&rest.vertices).map(|(a, b)| (a - b).norm()).fold(0.0, f64::max);
            assert!((0.01..0.2).contains(&largest), "{name}: {largest}");
            // No face turns over at two and a half standard deviations.
            let (old, new) = (rest.vertex_normals(), mesh.vertex_normals());
            let turned = old.iter().zip(&new).position(|(a, b)| a.dot(b) <= 0.5);
            assert!(turned.is_none(), "{name} at {value}: {:?}", turned.map(|v| rest.vertices[v]));
        }
    }
    let wrist = smplx_joint("left_wrist").unwrap();
    let knee = smplx_joint("left_knee").unwrap();
    let shoulder = smplx_joint("left_shoulder").unwrap();
    let index = |name: &str| MANNEQUIN_SHAPE.iter().position(|n| *n == name).unwrap();
    let height = |m: &TriMesh| m.bounds().map(|(lo, hi)| hi.y - lo.y).unwrap();
    assert!((height(&measure(index("stature"), 1.0).0) - height(&rest) - 0.069).abs() < 0.002);
    assert!(volume(&measure(index("girth"), 1.0).0) > 1.1 * volume(&rest));
    assert!(measure(index("leg length"), 1.0).1[knee].y < joints[knee].y - 0.01);
    assert!((measure(index("arm length"), 1.0).1[wrist].x - joints[wrist].x - 0.02).abs() < 0.003);
    assert!((measure(index("shoulder width"), 1.0).1[shoulder].x - joints[shoulder].x - 0.014).abs() < 0.003);
}

#[test]
fn it_is_the_same_every_time_and_at_other_resolutions() {
    let a = BodyMannequin::default().arrays().unwrap();
    assert_eq!(a, BodyMannequin::default().arrays().unwrap());
    for resolution in [0.015, 0.017, 0.022, 0.026, 0.030] {
        let body = BodyMannequin { resolution }.generate().unwrap();
        assert_eq!(body.describe().joints.len(), 55);
    }
    for resolution in [0.0, f64::NAN, 1.0] {
        let error = BodyMannequin { resolution }.generate().unwrap_err().to_string();
        assert!(error.contains("body.resolution"), "{error}");
    }
}

#[test]
fn the_configuration_needs_no_key_but_the_type() {
    let spec: Box<dyn BodySpec> = toml::from_str("type = \"mannequin\"\nresolution = 0.028").unwrap();
    assert_eq!(spec.build(&caphy_core::files::Disk).unwrap().describe().name, "mannequin");
    toml::from_str::<Box<dyn BodySpec>>("type = \"mannequin\"").unwrap();
    assert!(toml::from_str::<Box<dyn BodySpec>>("type = \"mannequin\"\nhight = 1.8").is_err());
}
