//! The mannequin as a body: closed, skinned without bleeding, shaped, quick, the same every time.

use caphy_bodymodel::BodyMannequin;
use caphy_bodymodel::mannequin::MANNEQUIN_SHAPE;
use caphy_bodymodel::smplx::{BodySmplx, SmplxArrays};
use caphy_core::body::{BodyModel, BodyParameters, BodySpec};
use caphy_core::pose::{SMPLX_JOINTS, smplx_joint};
use caphy_core::query::{Adjacency, hinges};
use caphy_core::{TriMesh, Vec3};
use std::collections::{BTreeMap, BTreeSet};

fn volume(mesh: &TriMesh) -> f64 {
    (0..mesh.faces.len())
        .map(|f| {
            let [a, b, c] = mesh.corners(f);
            a.dot(&b.cross(&c)) / 6.0
        })
        .sum()
}

/// The shaped mannequin at rest.
fn shaped(body: &BodySmplx, shape: &[f64]) -> TriMesh {
    TriMesh { vertices: body.shaped(shape, &[]).unwrap(), faces: body.describe().faces.clone() }
}

/// Whether the segment from `p` to `q` crosses a triangle.
fn crosses(p: &Vec3, q: &Vec3, [a, b, c]: &[Vec3; 3]) -> bool {
    let volume = |u: &Vec3, v: &Vec3, w: &Vec3, x: &Vec3| (v - u).cross(&(w - u)).dot(&(x - u));
    let ends = [volume(a, b, c, p), volume(a, b, c, q)];
    if ends[0] * ends[1] >= 0.0 {
        return false;
    }
    let sides = [volume(p, q, a, b), volume(p, q, b, c), volume(p, q, c, a)];
    sides.iter().all(|s| *s > 0.0) || sides.iter().all(|s| *s < 0.0)
}

/// Pairs of faces without a common vertex of which an edge of one crosses the other, found on a grid.
fn crossing_faces(mesh: &TriMesh) -> Vec<(usize, usize)> {
    let cell = 0.02;
    let mut grid: BTreeMap<[i32; 3], Vec<usize>> = BTreeMap::new();
    for f in 0..mesh.faces.len() {
        let [a, b, c] = mesh.corners(f);
        let [low, high] = [a.inf(&b).inf(&c), a.sup(&b).sup(&c)].map(|p| p.map(|x| (x / cell).floor() as i32));
        for i in low.x..=high.x {
            for j in low.y..=high.y {
                for k in low.z..=high.z {
                    grid.entry([i, j, k]).or_default().push(f);
                }
            }
        }
    }
    let mut found = Vec::new();
    for faces in grid.values() {
        for (n, &f) in faces.iter().enumerate() {
            for &g in &faces[n + 1..] {
                if mesh.faces[f].iter().any(|v| mesh.faces[g].contains(v)) {
                    continue;
                }
                let (p, q) = (mesh.corners(f), mesh.corners(g));
                if (0..3).any(|k| crosses(&p[k], &p[(k + 1) % 3], &q) || crosses(&q[k], &q[(k + 1) % 3], &p)) {
                    found.push((f, g));
                }
            }
        }
    }
    found
}

/// Smallest angle of each face [degrees], ascending.
fn smallest_angles(mesh: &TriMesh) -> Vec<f64> {
    let mut out: Vec<f64> = (0..mesh.faces.len())
        .map(|f| {
            let p = mesh.corners(f);
            (0..3)
                .map(|k| (p[(k + 1) % 3] - p[k]).angle(&(p[(k + 2) % 3] - p[k])).to_degrees())
                .fold(f64::INFINITY, f64::min)
        })
        .collect();
    out.sort_by(f64::total_cmp);
    out
}

/// How often the surface winds around a point: solid angles of the faces over 4π (Van Oosterom and Strackee 1983).
fn winding(mesh: &TriMesh, at: &Vec3) -> f64 {
    let solid_angle = |f: usize| {
        let [a, b, c] = mesh.corners(f).map(|p| p - at);
        let [la, lb, lc] = [a.norm(), b.norm(), c.norm()];
        let denominator = la * lb * lc + a.dot(&b) * lc + b.dot(&c) * la + c.dot(&a) * lb;
        2.0 * a.dot(&b.cross(&c)).atan2(denominator)
    };
    (0..mesh.faces.len()).map(solid_angle).sum::<f64>() / (4.0 * std::f64::consts::PI)
}

#[test]
fn it_is_one_closed_surface_of_an_adult() {
    let body = BodyMannequin::default().generate().unwrap();
    let d = body.describe();
    let mesh = TriMesh::new("mannequin", body.shaped(&[], &[]).unwrap(), d.faces.clone()).unwrap();
    assert!((6000..10_000).contains(&mesh.vertices.len()), "{} vertices", mesh.vertices.len());
    let (good, bad) = hinges(&mesh.faces);
    assert!(bad.is_empty() && 2 * good.len() == 3 * mesh.faces.len());
    assert_eq!(Adjacency::new(mesh.vertices.len(), &mesh.faces).components().1, 1);
    // A closed surface without handles: V - E + F = 2.
    assert_eq!(mesh.vertices.len() + mesh.faces.len(), good.len() + 2);
    let (lo, hi) = mesh.bounds().unwrap();
    assert!((hi.y - 0.77).abs() < 1e-12 && (lo.y + 0.95).abs() < 1e-12, "{lo:?} to {hi:?}");
    assert!(hi.x == -lo.x && ((hi.x - lo.x) - 1.74).abs() < 0.02, "span {}", hi.x - lo.x);
    // 1.72 m and about 65 kg at 1.0 kg/l.
    assert!((0.058..0.072).contains(&volume(&mesh)), "volume {}", volume(&mesh));
    // It stands on soles: at least half a shoe print each is within 2 mm of the floor.
    let sole: f64 = (0..mesh.faces.len())
        .filter(|&f| mesh.corners(f).iter().all(|p| p.y < lo.y + 0.002))
        .map(|f| mesh.face_areas()[f])
        .sum();
    assert!(sole > 0.01, "sole of {sole} m²");
}

#[test]
fn left_and_right_are_mirror_images_to_the_bit() {
    let arrays = BodyMannequin::default().arrays().unwrap();
    let key = |p: &Vec3| [p.x.to_bits(), p.y.to_bits(), p.z.to_bits()];
    // -0.0 and 0.0 are the same place.
    let reflected = |p: &Vec3| Vec3::new(if p.x == 0.0 { 0.0 } else { -p.x }, p.y, p.z);
    let ids: BTreeMap<_, usize> = arrays.template.iter().enumerate().map(|(v, p)| (key(p), v)).collect();
    let mirror: Vec<usize> = arrays.template.iter().map(|p| ids[&key(&reflected(p))]).collect();
    let faces: BTreeSet<[usize; 3]> = arrays.faces.iter().map(|f| rotated(f.map(|v| v as usize))).collect();
    assert!(arrays.faces.iter().all(|f| faces.contains(&rotated([f[0], f[2], f[1]].map(|v| mirror[v as usize])))));
    let other = |j: usize| {
        let name = SMPLX_JOINTS[j];
        let swapped = name.replace("left_", "#").replace("right_", "left_").replace('#', "right_");
        smplx_joint(&swapped).unwrap()
    };
    for v in 0..mirror.len() {
        let mut row: Vec<(usize, f64)> = arrays.weights.row(mirror[v]).map(|(j, w)| (other(j), w)).collect();
        row.sort_by_key(|(j, _)| *j);
        for ((j, w), (k, x)) in arrays.weights.row(v).zip(&row) {
            assert!(j == *k && (w - x).abs() < 1e-15, "vertex {v}");
        }
        for directions in &arrays.shape_directions {
            assert_eq!(directions[mirror[v]], reflected(&directions[v]), "vertex {v}");
        }
    }
}

/// The same face with its smallest vertex first.
fn rotated(f: [usize; 3]) -> [usize; 3] {
    let k = (0..3).min_by_key(|&k| f[k]).unwrap();
    [f[k], f[(k + 1) % 3], f[(k + 2) % 3]]
}

#[test]
fn its_triangles_are_good_and_do_not_cross() {
    let body = BodyMannequin::default().generate().unwrap();
    let mesh = shaped(&body, &[]);
    let angles = smallest_angles(&mesh);
    let share = |s: f64| angles[(s * angles.len() as f64) as usize];
    // 60 for equilateral triangles; half a square has 45.
    let quality = [angles[0], share(0.01), share(0.5)];
    assert!(quality[0] > 12.0 && quality[1] > 26.0 && quality[2] > 44.0, "{quality:?}");
    assert_eq!(crossing_faces(&mesh), [], "at rest");
    for k in 0..MANNEQUIN_SHAPE.len() {
        for value in [-2.0, 2.0] {
            let mut shape = [0.0; MANNEQUIN_SHAPE.len()];
            shape[k] = value;
            assert_eq!(crossing_faces(&shaped(&body, &shape)), [], "{} {value}", MANNEQUIN_SHAPE[k]);
        }
    }
}

#[test]
fn the_check_for_crossing_faces_sees_a_crossing() {
    let flat = [Vec3::zeros(), Vec3::x() * 0.01, Vec3::y() * 0.01];
    let through = flat.map(|p| Vec3::new(p.x + 0.002, 0.002, p.y - 0.005));
    let mesh = |second: [Vec3; 3]| TriMesh {
        vertices: flat.into_iter().chain(second).collect(),
        faces: vec![[0, 1, 2], [3, 4, 5]],
    };
    assert!(!crossing_faces(&mesh(through)).is_empty());
    assert!(crossing_faces(&mesh(through.map(|p| p + Vec3::z() * 0.006))).is_empty());
}

#[test]
fn joints_are_inside() {
    let body = BodyMannequin::default().generate().unwrap();
    for shape in [vec![], vec![0.0, -2.0], vec![0.0, 2.0]] {
        let mesh = shaped(&body, &shape);
        let joints = body.forward(&BodyParameters::rest(55, &shape)).unwrap().joints;
        for (name, at) in SMPLX_JOINTS.iter().zip(&joints) {
            let turns = winding(&mesh, at);
            assert!((turns - 1.0).abs() < 1e-6, "{name} at {at:?}: {turns}");
        }
    }
}

#[test]
fn weights_change_smoothly() {
    let body = BodyMannequin::default().generate().unwrap();
    let (d, mesh) = (body.describe(), shaped(&body, &[]));
    let dense = |v: u32| {
        let mut row = [0.0; 55];
        d.weights.row(v as usize).for_each(|(j, w)| row[j] = w);
        row
    };
    for f in &mesh.faces {
        for k in 0..3 {
            let (a, b) = (f[k], f[(k + 1) % 3]);
            let change: f64 = dense(a).iter().zip(dense(b)).map(|(x, y)| 0.5 * (x - y).abs()).sum();
            let length = (mesh.vertices[a as usize] - mesh.vertices[b as usize]).norm();
            // A border of width w is a cubic of slope 1.5 / w. The narrowest of trunk and limbs is the head's, 60 mm and
            // tilted: 32 per metre. On fingers they are 16 mm, 94 per metre, and the webs are shared more steeply still.
            let hand = mesh.vertices[a as usize].x.abs() > 0.66;
            let steepest = if hand { 120.0 } else { 32.0 };
            assert!(change < steepest * length, "{change} over {length} m at {:?}", mesh.vertices[a as usize]);
        }
    }
}

#[test]
fn correctives_keep_the_volume_of_bent_limbs() {
    let arrays = BodyMannequin::default().arrays().unwrap();
    let with = BodySmplx::new(arrays.clone()).unwrap();
    let without = BodySmplx::new(SmplxArrays { pose_directions: Vec::new(), ..arrays }).unwrap();
    assert!(with.has_pose_correctives() && !without.has_pose_correctives());
    let rest = volume(&shaped(&with, &[]));
    let change = |body: &BodySmplx, turns: &[(&str, Vec3)]| {
        let mut parameters = BodyParameters::rest(55, &[]);
        for (joint, turn) in turns {
            parameters.rotations[smplx_joint(joint).unwrap()] = *turn;
        }
        let vertices = body.forward(&parameters).unwrap().vertices;
        1e6 * (volume(&TriMesh { vertices, faces: body.describe().faces.clone() }) - rest)
    };
    let right = std::f64::consts::FRAC_PI_2;
    // At rest there are none: what is left is rounding in (1 + w - w) of the blend.
    assert!(change(&with, &[]).abs() < 1e-6);
    // [ml]: 3 % of what bends, a length of limb of twice its radius on either side of the joint (about 0.4 l at the elbow,
    // 1 l at the knee, 4 l at the hip, 1 l at the shoulder, 0.15 l at the wrist).
    for (name, turns, bound) in [
        ("elbow", [("left_elbow", Vec3::y() * -right)], 12.0),
        ("knee", [("left_knee", Vec3::x() * right)], 30.0),
        ("hip", [("left_hip", Vec3::x() * -right)], 120.0),
        ("shoulder", [("left_shoulder", Vec3::z() * -1.2)], 25.0),
        ("twisted wrist", [("left_wrist", Vec3::x() * right)], 4.5),
    ] {
        let (kept, lost) = (change(&with, &turns), change(&without, &turns));
        println!("{name}: {kept:.1} ml with correctives, {lost:.1} ml without");
        assert!(kept.abs() < bound && lost < -5.0 * bound, "{name}: {kept} ml, without {lost} ml");
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
    for (name, value, expected) in [
        ("stature", 1.0, 1.72 * 1.04),
        ("stature", -2.0, 1.72 * 0.92),
        ("leg length", 2.0, 1.776),
        ("torso length", -1.0, 1.70),
    ] {
        let got = height(&measure(index(name), value).0);
        assert!((got - expected).abs() < 1e-9, "{name} {value}: {got}");
    }
    assert!(volume(&measure(index("girth"), 1.0).0) > 1.1 * volume(&rest));
    assert!(measure(index("leg length"), 1.0).1[knee].y < joints[knee].y - 0.01);
    assert!((measure(index("arm length"), 1.0).1[wrist].x - joints[wrist].x - 0.02).abs() < 0.003);
    assert!((measure(index("shoulder width"), 1.0).1[shoulder].x - joints[shoulder].x - 0.014).abs() < 0.003);
}

#[test]
fn it_is_the_same_every_time_and_on_any_number_of_threads() {
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| BodyMannequin::default().arrays().unwrap())
    };
    let one = on(1);
    assert_eq!(one, on(1));
    assert_eq!(one, on(3));
}

#[test]
fn finer_cells_make_more_vertices() {
    let mut before = usize::MAX;
    for (resolution, vertices) in [
        (0.012, 25_000..30_000),
        (0.015, 16_000..18_500),
        (0.017, 12_500..14_500),
        (0.020, 9000..10_000),
        (0.023, 7500..8500),
        (0.026, 6000..7200),
        (0.030, 5000..6000),
    ] {
        let body = BodyMannequin { resolution }.generate().unwrap();
        let count = body.describe().vertex_count;
        assert!(vertices.contains(&count) && count < before, "{count} vertices at {resolution} m");
        before = count;
        let mesh = shaped(&body, &[]);
        let height = mesh.bounds().map(|(lo, hi)| hi.y - lo.y).unwrap();
        assert!((height - 1.72).abs() < 1e-12, "{height} m at {resolution} m");
        assert_eq!(crossing_faces(&mesh), [], "at {resolution} m");
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
