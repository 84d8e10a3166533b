//! Contact sheets of the mannequin: `mannequin_sheet POSES.png [SHAPES.png [RESOLUTION]]`.
//!
//! The first shows poses from the front, the side and the back, and hand, face and foot from near; the second each shape
//! coefficient at -2 and +2.

use caphy_bodymodel::BodyMannequin;
use caphy_bodymodel::mannequin::MANNEQUIN_SHAPE;
use caphy_bodymodel::smplx::BodySmplx;
use caphy_core::body::{BodyModel, BodyParameters};
use caphy_core::pose::{SMPLX_JOINTS, smplx_joint};
use caphy_core::segmenter::Camera;
use caphy_core::{TriMesh, Vec3, mesh};
use caphy_render::shade::CLAY;
use caphy_render::{Layer, Picture, Projection, Rgb, contact_sheet, frame, look_at, png};
use nalgebra::Rotation3;

const X: Vec3 = Vec3::new(1.0, 0.0, 0.0);
const Y: Vec3 = Vec3::new(0.0, 1.0, 0.0);
const Z: Vec3 = Vec3::new(0.0, 0.0, 1.0);

/// Joint without its side, axis for the left side, angle left and right [rad].
type Turn = (&'static str, Vec3, [f64; 2]);

/// Turns of a joint are applied in order, the last one first in the body's frame.
fn pose(turns: &[Turn]) -> Vec<Vec3> {
    let mut out = vec![Rotation3::identity(); SMPLX_JOINTS.len()];
    for (name, axis, angles) in turns {
        if let Some(j) = smplx_joint(name) {
            out[j] *= Rotation3::from_scaled_axis(axis * angles[0]);
            continue;
        }
        for (side, angle) in ["left", "right"].iter().zip(angles) {
            // A mirror keeps rotations about x and turns those about y and z.
            let mirror = if *side == "left" { 1.0 } else { -1.0 };
            let axis = Vec3::new(axis.x, mirror * axis.y, mirror * axis.z);
            let j = smplx_joint(&format!("{side}_{name}")).expect("a joint of the layout");
            out[j] *= Rotation3::from_scaled_axis(axis * *angle);
        }
    }
    out.iter().map(Rotation3::scaled_axis).collect()
}

fn poses() -> Vec<(&'static str, Vec<Vec3>)> {
    let arms = |down: f64| vec![("collar", Z, [-0.08 * down; 2]), ("shoulder", Z, [-0.92 * down; 2])];
    let with = |down: f64, more: &[Turn]| {
        let mut turns: Vec<Turn> = arms(down);
        turns.extend_from_slice(more);
        pose(&turns)
    };
    vec![
        ("T", pose(&[])),
        ("A", with(1.05, &[])),
        ("arms up", pose(&[("collar", Z, [0.4; 2]), ("shoulder", Z, [0.9; 2])])),
        (
            "squat",
            pose(&[
                ("hip", X, [-1.7; 2]),
                ("hip", Z, [0.25; 2]),
                ("knee", X, [2.0; 2]),
                ("ankle", X, [-0.5; 2]),
                ("spine1", X, [0.3; 2]),
                ("shoulder", Y, [-1.3; 2]),
            ]),
        ),
        (
            "stride",
            with(
                1.2,
                &[
                    ("hip", X, [-0.6, 0.35]),
                    ("knee", X, [0.25, 0.5]),
                    ("shoulder", Y, [0.5, -0.5]),
                    ("elbow", Y, [-0.4; 2]),
                ],
            ),
        ),
        ("knee up", with(1.1, &[("hip", X, [-1.7, 0.0]), ("knee", X, [1.7, 0.0])])),
        ("seated", with(1.0, &[("hip", X, [-1.57; 2]), ("knee", X, [1.57; 2]), ("elbow", Y, [-1.2; 2])])),
        (
            "twist",
            with(
                0.6,
                &[("spine1", Y, [0.35; 2]), ("spine2", Y, [0.35; 2]), ("spine3", Y, [0.25; 2]), ("head", Y, [0.4; 2])],
            ),
        ),
        ("90 bends", with(0.5, &[("elbow", Y, [-1.57; 2]), ("knee", X, [1.57, 0.0]), ("hip", X, [-0.3, 0.0])])),
        ("arms hang", with(1.3, &[("elbow", Y, [-0.15; 2])])),
    ]
}

fn posed(body: &BodySmplx, rotations: Vec<Vec3>, shape: &[f64]) -> TriMesh {
    let parameters = BodyParameters { rotations, ..BodyParameters::rest(SMPLX_JOINTS.len(), shape) };
    let vertices = body.forward(&parameters).expect("parameters fit the body").vertices;
    TriMesh { vertices, faces: body.describe().faces.clone() }
}

fn draw(mesh: &TriMesh, camera: Camera, smooth: bool) -> Rgb {
    let mut layer = Layer::uniform(mesh, CLAY);
    layer.smooth = smooth;
    Picture { crease_radius: 0.05, ..Picture::new(camera, vec![layer]) }.draw()
}

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let Some(out) = arguments.first() else {
        eprintln!("usage: mannequin_sheet POSES.png [SHAPES.png [RESOLUTION]]");
        std::process::exit(2);
    };
    let mut specification = BodyMannequin::default();
    if let Some(resolution) = arguments.get(2) {
        specification.resolution = resolution.parse().expect("a resolution in metres");
    }
    let start = std::time::Instant::now();
    let body = specification.generate().expect("the mannequin can be made");
    println!("{} vertices in {:.3} s", body.describe().vertex_count, start.elapsed().as_secs_f64());

    let mut pictures: Vec<(String, Rgb)> = Vec::new();
    for (name, rotations) in poses() {
        let mesh = posed(&body, rotations, &[]);
        let bounds = mesh::bounds(&mesh.vertices).expect("vertices");
        for (view, from) in [("front", Z), ("side", Vec3::new(1.0, 0.1, 0.35)), ("back", Vec3::new(-0.4, 0.05, -1.0))] {
            let camera = frame(bounds, &from, Projection::Perspective { field_of_view: 0.4 }, 380, 440);
            pictures.push((format!("{name}, {view}"), draw(&mesh, camera, true)));
        }
    }
    let rest = posed(&body, pose(&[]), &[]);
    let at = |x: f64, y: f64, z: f64| Vec3::new(x, y - 0.95, z);
    let mut near = |label: &str, mesh: &TriMesh, target: Vec3, from: Vec3, width: f64, smooth: bool| {
        let distance = 6.0 * width;
        let camera = look_at(
            &(target + from.normalize() * distance),
            &target,
            if from.y.abs() > 0.9 { &Z } else { &Y },
            2.0 * (0.5 * width / distance).atan(),
            380,
            440,
        );
        pictures.push((label.to_string(), draw(mesh, camera, smooth)));
    };
    let face = at(0.0, 1.60, 0.03);
    near("face, front", &rest, face, Z, 0.30, true);
    near("face, three quarters", &rest, face, Vec3::new(0.7, 0.1, 0.8), 0.30, true);
    near("face, side", &rest, face, X, 0.30, true);
    let hand = at(0.785, 1.395, 0.0);
    near("hand, above", &rest, hand, Vec3::new(0.0, 1.0, 0.01), 0.25, true);
    near("hand, front", &rest, hand, Vec3::new(0.2, 0.3, 1.0), 0.22, true);
    let names = ["index", "middle", "ring", "pinky"];
    let joints: Vec<String> = names.iter().flat_map(|n| (1..=3).map(move |k| format!("{n}{k}"))).collect();
    let mut fist = vec![Vec3::zeros(); SMPLX_JOINTS.len()];
    for name in &joints {
        fist[smplx_joint(&format!("left_{name}")).expect("a finger")] = Z * -0.9;
    }
    let fist = posed(&body, fist, &[]);
    near("hand bent", &fist, hand, Vec3::new(0.5, -0.4, 1.0), 0.22, true);
    near("foot, front", &rest, at(0.15, 0.06, 0.04), Vec3::new(0.5, 0.7, 1.0), 0.34, true);
    near("foot, side", &rest, at(0.15, 0.08, 0.04), Vec3::new(1.0, 0.1, 0.0), 0.34, true);
    let hang = posed(&body, poses().swap_remove(9).1, &[]);
    near("shoulder, hanging", &hang, at(0.15, 1.35, 0.0), Vec3::new(0.5, 0.2, 1.0), 0.5, true);
    near("armpit", &rest, at(0.16, 1.33, 0.0), Vec3::new(0.3, -0.3, 1.0), 0.45, true);
    near("groin", &rest, at(0.0, 0.85, 0.0), Vec3::new(0.2, -0.3, 1.0), 0.5, true);
    near("buttocks", &rest, at(0.0, 0.90, 0.0), Vec3::new(0.3, 0.0, -1.0), 0.5, true);
    let named = |name: &str| poses().into_iter().find(|(n, _)| *n == name).map(|(_, p)| posed(&body, p, &[]));
    let (seated, bends, up) = (named("seated"), named("90 bends"), named("arms up"));
    let [seated, bends, up] = [seated, bends, up].map(|mesh| mesh.expect("a pose of the list"));
    near("seated, front", &seated, at(0.0, 0.90, 0.2), Vec3::new(0.1, 0.1, 1.0), 0.6, true);
    near("seated, above", &seated, at(0.05, 0.95, 0.1), Vec3::new(0.8, 0.6, 1.0), 0.6, true);
    near("seated, behind", &seated, at(0.0, 0.92, 0.0), Vec3::new(0.6, 0.0, -1.0), 0.6, true);
    near("knee bent", &bends, at(0.12, 0.52, 0.05), Vec3::new(1.0, 0.1, -0.3), 0.5, true);
    near("elbow bent", &bends, at(0.42, 1.28, 0.0), Vec3::new(0.3, 1.0, 0.2), 0.45, true);
    near("elbow bent, outside", &bends, at(0.42, 1.28, 0.0), Vec3::new(0.8, 0.1, -0.6), 0.45, true);
    near("shoulders, arms up", &up, at(0.1, 1.42, 0.0), Vec3::new(0.3, 0.2, 1.0), 0.6, true);
    near("shoulders, behind", &up, at(0.1, 1.42, 0.0), Vec3::new(0.3, 0.2, -1.0), 0.6, true);
    near("shoulder, hanging, behind", &hang, at(0.15, 1.35, 0.0), Vec3::new(0.5, 0.2, -1.0), 0.5, true);
    near("triangles, face", &rest, face, Vec3::new(0.5, 0.1, 1.0), 0.30, false);
    near("triangles, hand", &rest, hand, Vec3::new(0.0, 1.0, 0.01), 0.22, false);
    near("triangles, torso", &rest, at(0.0, 1.2, 0.0), Vec3::new(0.5, 0.1, 1.0), 0.7, false);
    let sheet: Vec<(&str, &Rgb)> = pictures.iter().map(|(l, p)| (l.as_str(), p)).collect();
    std::fs::write(out, png(&contact_sheet(&sheet, 6)).expect("a picture")).expect("the file can be written");

    let Some(out) = arguments.get(1) else { return };
    let mut pictures: Vec<(String, Rgb)> = Vec::new();
    let a_pose = poses().swap_remove(1).1;
    for (k, name) in MANNEQUIN_SHAPE.iter().enumerate() {
        for value in [-2.0, 2.0] {
            let mut shape = vec![0.0; MANNEQUIN_SHAPE.len()];
            shape[k] = value;
            let mesh = posed(&body, a_pose.clone(), &shape);
            let bounds = (Vec3::new(-0.6, -1.1, -0.3), Vec3::new(0.6, 0.95, 0.3));
            for from in [Z, Vec3::new(1.0, 0.1, 0.3)] {
                let camera = frame(bounds, &from, Projection::Perspective { field_of_view: 0.4 }, 300, 420);
                pictures.push((format!("{name} {value:+}"), draw(&mesh, camera, true)));
            }
        }
    }
    let sheet: Vec<(&str, &Rgb)> = pictures.iter().map(|(l, p)| (l.as_str(), p)).collect();
    std::fs::write(out, png(&contact_sheet(&sheet, 8)).expect("a picture")).expect("the file can be written");
}
