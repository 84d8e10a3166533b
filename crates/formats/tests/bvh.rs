//! BVH: a real clip, every rotation order, other axes and mappings, damage.

mod support;

use caphy_core::motion::MotionClip;
use caphy_core::pose::{Pose, SMPLX_JOINTS, SMPLX_PARENTS, smplx_joint};
use caphy_core::{Result, Vec3};
use caphy_formats::motion::{SkeletonMapping, UpAxis, read_bvh};
use nalgebra::{Rotation3, Unit, UnitQuaternion};
use std::fmt::Write;
use std::path::Path;

const PELVIS: Vec3 = Vec3::new(0.01, -0.35, 0.02);

fn mapping(text: &str) -> Result<SkeletonMapping> {
    SkeletonMapping::from_toml(Path::new("map.toml"), text.as_bytes())
}

/// World rotation of every joint.
fn world(pose: &Pose) -> Vec<UnitQuaternion<f64>> {
    let mut world = Vec::new();
    for (j, r) in pose.rotations.iter().enumerate() {
        let own = UnitQuaternion::from_scaled_axis(*r);
        world.push(if j == 0 { own } else { world[SMPLX_PARENTS[j]] * own });
    }
    world
}

#[test]
fn a_real_clip_walks_upright() {
    let Some(bytes) = support::shared("data/mocap/cmu_131_01.bvh") else { return };
    let cmu = SkeletonMapping::cmu_bvh().unwrap();
    let clip = read_bvh(Path::new("cmu_131_01.bvh"), &bytes, &cmu, &PELVIS).unwrap();
    assert_eq!((clip.poses.len(), clip.name.as_str()), (994, "cmu_131_01"));
    assert!((clip.fps - 1.0 / 0.0083333).abs() < 1e-9, "{}", clip.fps);
    let joint = |name: &str| smplx_joint(name).unwrap();
    let mut way = 0.0;
    for (frame, pose) in clip.poses.iter().enumerate() {
        let height = (pose.translation + PELVIS).y;
        // The actor lunges and crouches in between.
        assert!((0.45..1.1).contains(&height), "frame {frame}: pelvis at {height} m");
        let world = world(pose);
        let up = |name: &str| (world[joint(name)] * Vec3::y()).y;
        assert!(up("spine2") > 0.5 && up("head") > 0.2, "frame {frame}: {} {}", up("spine2"), up("head"));
        // Knees bend backwards only: the shank, seen from the thigh, does not point forward.
        for name in ["left_knee", "right_knee"] {
            let shank = UnitQuaternion::from_scaled_axis(pose.rotations[joint(name)]) * -Vec3::y();
            assert!(shank.z < 0.15, "frame {frame}: {name} {shank}");
        }
        if frame > 0 {
            way += (pose.translation - clip.poses[frame - 1].translation).norm();
        }
    }
    println!("way {way:.2} m in {:.2} s", clip.duration());
    assert!(way > 2.0 && way < 20.0, "{way} m");
}

/// The SMPL-X joints as a BVH file that rests in the T-pose, each joint with another rotation order.
fn bvh_of(clip: &MotionClip, up: UpAxis) -> String {
    let axes = [Vec3::x_axis(), Vec3::y_axis(), Vec3::z_axis()];
    let orders = [[0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]];
    let order = |j: usize| orders[j % 6];
    let back = up.to_y_up().inverse();
    let mut children = vec![Vec::new(); 55];
    for j in 1..55 {
        children[SMPLX_PARENTS[j]].push(j);
    }
    fn joint(text: &mut String, j: usize, children: &[Vec<usize>], order: &dyn Fn(usize) -> [usize; 3]) {
        let (kind, position) = if j == 0 { ("ROOT", "Xposition Yposition Zposition ") } else { ("JOINT", "") };
        let count = if j == 0 { 6 } else { 3 };
        let rotations = order(j).map(|a| format!("{}rotation", ["X", "Y", "Z"][a])).join(" ");
        write!(text, "{kind} {}\n{{\nOFFSET 0 1 0\nCHANNELS {count} {position}{rotations}\n", SMPLX_JOINTS[j]).unwrap();
        for &c in &children[j] {
            joint(text, c, children, order);
        }
        if children[j].is_empty() {
            text.push_str("End Site\n{\nOFFSET 0 1 0\n}\n");
        }
        text.push_str("}\n");
    }
    let mut text = "HIERARCHY\n".to_string();
    joint(&mut text, 0, &children, &order);
    write!(text, "MOTION\nFrames: {}\nFrame Time: {}\n", clip.poses.len(), 1.0 / clip.fps).unwrap();
    // Rows follow the hierarchy's order of joints, depth first.
    fn depth_first(j: usize, children: &[Vec<usize>], out: &mut Vec<usize>) {
        out.push(j);
        children[j].iter().for_each(|&c| depth_first(c, children, out));
    }
    let mut sequence = Vec::new();
    depth_first(0, &children, &mut sequence);
    for pose in &clip.poses {
        let place = back * (pose.translation + PELVIS) * 100.0;
        write!(text, "{} {} {}", place.x, place.y, place.z).unwrap();
        for &j in &sequence {
            let own = back * UnitQuaternion::from_scaled_axis(pose.rotations[j]) * back.inverse();
            let seq: [Unit<Vec3>; 3] = order(j).map(|a| axes[a]);
            let (angles, _) = Rotation3::from(own).euler_angles_ordered(seq, false);
            angles.iter().for_each(|a| write!(text, " {:.12}", a.to_degrees()).unwrap());
        }
        text.push('\n');
    }
    text
}

/// SMPL-X names for SMPL-X joints.
fn own_names(up: &str) -> SkeletonMapping {
    let joints: String = SMPLX_JOINTS.iter().map(|n| format!("{n} = \"{n}\"\n")).collect();
    mapping(&format!("up = \"{up}\"\nmetres_per_unit = 0.01\nrest = \"t_pose\"\n[joints]\n{joints}")).unwrap()
}

/// A clip that turns every joint about every axis.
fn lively() -> MotionClip {
    let poses = (0..7)
        .map(|i| {
            let mut pose = Pose::rest(55);
            for (j, r) in pose.rotations.iter_mut().enumerate() {
                let x = |k: usize| ((i * 31 + j * 7 + k * 3) as f64).sin();
                *r = Vec3::new(x(0), x(1), x(2));
            }
            pose.translation = Vec3::new(0.3 * i as f64, 0.9, -0.1 * i as f64);
            pose
        })
        .collect();
    MotionClip::new("lively", 50.0, poses).unwrap()
}

#[test]
fn every_rotation_order_and_up_axis_gives_the_same_poses() {
    let clip = lively();
    for (up, name) in [(UpAxis::Y, "y"), (UpAxis::Z, "z"), (UpAxis::MinusY, "-y"), (UpAxis::MinusX, "-x")] {
        let text = bvh_of(&clip, up);
        let read = read_bvh(Path::new("lively.bvh"), text.as_bytes(), &own_names(name), &PELVIS).unwrap();
        assert_eq!(read.poses.len(), 7);
        assert!((read.fps - 50.0).abs() < 1e-12);
        for (a, b) in clip.poses.iter().zip(&read.poses) {
            // 12 decimals of a degree, 3 angles, amplified near the poles of Euler angles by less than 1e4.
            let worst = world(a).iter().zip(&world(b)).map(|(p, q)| p.angle_to(q)).fold(0.0, f64::max);
            assert!(worst < 1e-7, "{name}: {worst:e} rad");
            assert!((a.translation - b.translation).norm() < 1e-12);
        }
    }
}

/// A leg that rests splayed and an arm that hangs, with positions on a joint and words that touch.
const SMALL: &str = "HIERARCHY\nROOT Hips{\nOFFSET 1 2 3\nCHANNELS 6 Xrotation Xposition Zposition Yrotation Yposition Zrotation\n\
    JOINT Left Leg\n{\nOFFSET 10 0 0\nCHANNELS 3 Yrotation Xrotation Zrotation\n\
    JOINT Knee\n{\nOFFSET 20 -40 0\nCHANNELS 4 Zposition Zrotation Xrotation Yrotation\nEnd Site\n{\nOFFSET 0 -40 0\n}\n}\n}\n\
    JOINT Arm\n{\nOFFSET 0 50 0\nCHANNELS 0\nJOINT Helper { OFFSET 0 0 0 CHANNELS 0\nEnd Site { OFFSET 0 -30 0 } } }\n}\n\
    MOTION\nFrames: 2\nFrame Time:0.04\n\
    10 100 300 20 200 30 15 25 35 7 40 50 60\n\
    0 0 0 0 0 0 0 0 0 0 0 0 0\n";
const SMALL_MAP: &str = "metres_per_unit = 0.01\n[joints]\nHips = \"pelvis\"\n\"Left Leg\" = \"left_hip\"\n\
    Knee = \"left_knee\"\nArm = \"left_shoulder\"\n";

fn small(text: &str) -> Result<MotionClip> {
    read_bvh(Path::new("small.bvh"), text.as_bytes(), &mapping(SMALL_MAP).unwrap(), &PELVIS)
}

#[test]
fn channels_in_any_order_turn_and_move_as_they_stand() {
    let clip = small(SMALL).unwrap();
    assert_eq!((clip.poses.len(), clip.fps), (2, 25.0));
    let [x, y, z] = [Vec3::x_axis(), Vec3::y_axis(), Vec3::z_axis()];
    let about = |axis: Unit<Vec3>, degrees: f64| Rotation3::from_axis_angle(&axis, degrees.to_radians());
    let hips = about(x, 10.0) * about(y, 20.0) * about(z, 30.0);
    let leg = hips * about(y, 15.0) * about(x, 25.0) * about(z, 35.0);
    let knee = leg * about(z, 40.0) * about(x, 50.0) * about(y, 60.0);
    let turned = world(&clip.poses[0]);
    let joint = |name: &str| smplx_joint(name).unwrap();
    assert!((turned[0] * Vec3::x() - hips * Vec3::x()).norm() < 1e-12);
    // Limbs point where the file's bones point; the knee's end site hangs straight down at rest.
    let thigh = leg * Vec3::new(20.0, -40.0, 0.0).normalize();
    assert!((turned[joint("left_hip")] * -Vec3::y() - thigh).norm() < 1e-12);
    assert!((turned[joint("left_knee")] * -Vec3::y() - knee * -Vec3::y()).norm() < 1e-12);
    assert!((turned[joint("left_shoulder")] * Vec3::x() - hips * -Vec3::y()).norm() < 1e-12, "a hanging arm");
    assert!((turned[joint("left_elbow")] * Vec3::x() - hips * -Vec3::y()).norm() < 1e-12, "the forearm follows");
    assert!((turned[joint("spine3")] * Vec3::y() - hips * Vec3::y()).norm() < 1e-12, "unmapped joints follow");
    assert!((clip.poses[0].translation + PELVIS - Vec3::new(1.0, 2.0, 3.0)).norm() < 1e-12);
    // Positions of any joint: the pelvis follows the knee, at hips + R(10, 0, 0) + R_leg(20, -40, 7).
    let other = "metres_per_unit = 0.01\nrest = \"t_pose\"\n[joints]\nKnee = \"pelvis\"\n";
    let clip = read_bvh(Path::new("small.bvh"), SMALL.as_bytes(), &mapping(other).unwrap(), &PELVIS).unwrap();
    let place = Vec3::new(100.0, 200.0, 300.0) + hips * Vec3::new(10.0, 0.0, 0.0) + leg * Vec3::new(20.0, -40.0, 7.0);
    assert!((clip.poses[0].translation + PELVIS - place * 0.01).norm() < 1e-12);
}

#[test]
fn directions_of_the_mapping_win_and_facing_turns_the_body() {
    let given = format!("{SMALL_MAP}[rest_directions]\nArm = [1.0, 0.0, 0.0]\n");
    let clip = read_bvh(Path::new("s.bvh"), SMALL.as_bytes(), &mapping(&given).unwrap(), &PELVIS).unwrap();
    let rest = world(&clip.poses[1]);
    assert!(
        rest[smplx_joint("left_shoulder").unwrap()].angle() < 1e-12,
        "an arm that rests sideways needs no correction"
    );
    let facing = format!("facing = \"x\"\n{SMALL_MAP}");
    let clip = read_bvh(Path::new("s.bvh"), SMALL.as_bytes(), &mapping(&facing).unwrap(), &PELVIS).unwrap();
    // The file's x is caphy's z: its y stays up, its z is caphy's -x.
    let place = clip.poses[0].translation + PELVIS;
    assert!((place - Vec3::new(-3.0, 2.0, 1.0)).norm() < 1e-12, "{place}");
}

#[test]
fn bad_files_are_refused_with_place_and_value() {
    assert!(small(SMALL).is_ok());
    for (from, to, words) in [
        ("HIERARCHY", "HIRARCHY", ["line 1", "HIRARCHY"]),
        ("OFFSET 10 0 0", "OFFSET 10 x 0", ["line 7, joint `Left Leg`", "`x`"]),
        ("OFFSET 10 0 0", "OFFSET 10 nan 0", ["line 7, joint `Left Leg`", "nan"]),
        ("OFFSET 10 0 0\n", "", ["joint `Left Leg`", "without an OFFSET"]),
        ("CHANNELS 3 Yrotation", "CHANNELS 3 Wrotation", ["line 8, joint `Left Leg`", "Wrotation"]),
        ("CHANNELS 3 Yrotation", "CHANNELS 99 Yrotation", ["line 8, joint `Left Leg`", "99"]),
        ("CHANNELS 3 Yrotation", "CHANNELS -3 Yrotation", ["line 8, joint `Left Leg`", "-3"]),
        ("CHANNELS 3 Yrotation", "CHANNELS 2 Yrotation", ["line 8, joint `Left Leg`", "Zrotation"]),
        ("JOINT Knee", "JOINT Left Leg", ["line 9, joint `Left Leg`", "twice"]),
        ("JOINT Knee", "JOINT", ["line 9", "without a name"]),
        ("JOINT Knee", "JOINT Shin", ["joint `Knee`", "map.toml"]),
        ("JOINT Arm", "JOINT Arm\nJOINT", ["line 20", "instead of `{`"]),
        ("MOTION", "", ["line 27", "Frames:"]),
        ("Frames: 2", "Frames: two", ["line 27", "two"]),
        ("Frames: 2", "Frames: 0", ["line 27", "no frames"]),
        ("Frames: 2", "Frames: -2", ["line 27", "-2"]),
        ("Frames: 2", "Frames: 1000000000", ["line 27", "1000000000 frames"]),
        ("Frames: 2", "Frames: 3", ["end of the file", "2 frames, 3"]),
        ("Frames: 2", "Frames: 1", ["line 30", "after the 1 frames"]),
        ("Time:0.04", "Time:0", ["line 28", "frame time 0"]),
        ("Time:0.04", "Time:-1", ["line 28", "frame time -1"]),
        ("Time:0.04", "Time:1e-320", ["line 28", "frame time"]),
        ("Time:0.04", "Time:nan", ["line 28", "nan"]),
        ("35 7 40", "35 40", ["line 29, frame 0", "12 values"]),
        ("35 7 40", "35 7 7 40", ["line 29, frame 0", "14 values"]),
        ("35 7 40", "35 NaN 40", ["line 29, frame 0, joint `Knee`", "NaN"]),
        ("15 25 35", "15 1e999 35", ["line 29, frame 0, joint `Left Leg`", "1e999"]),
    ] {
        assert!(SMALL.contains(from), "{from}");
        let text = small(&SMALL.replacen(from, to, 1)).unwrap_err().to_string();
        assert!(text.contains("small.bvh") && words.iter().all(|w| text.contains(w)), "{to}: {text}");
    }
    let still = "HIERARCHY\nROOT Hips\n{\nOFFSET 0 0 0\nCHANNELS 0\n}\nMOTION\nFrames: 5\nFrame Time: 1\n";
    assert!(small(still).unwrap_err().to_string().contains("map.toml"));
    let only = mapping("metres_per_unit = 1\n[joints]\nHips = \"pelvis\"\n").unwrap();
    let text = read_bvh(Path::new("a.bvh"), still.as_bytes(), &only, &PELVIS).unwrap_err().to_string();
    assert!(text.contains("no joint has channels"), "{text}");
    // Deep and wide hierarchies end at the joint limit, not on the stack.
    let deep: String = (0..5000).map(|i| format!("JOINT j{i}\n{{\nOFFSET 0 0 1\nCHANNELS 0\n")).collect();
    let text = small(&format!("HIERARCHY\nROOT Hips\n{{\nOFFSET 0 0 0\nCHANNELS 0\n{deep}")).unwrap_err().to_string();
    assert!(text.contains("more than 1024 joints"), "{text}");
}

#[test]
fn damage_anywhere_does_not_panic() {
    for cut in 0..SMALL.len() {
        // A cut inside the last number may leave a number.
        let whole = small(&SMALL[..cut]);
        assert!(whole.is_err() || cut >= SMALL.len() - 2, "cut at {cut}");
        for value in [0, b' ', b'9', b'{', b'}', b'\n', 0xff] {
            let mut bad = SMALL.as_bytes().to_vec();
            bad[cut] = value;
            let _ = read_bvh(Path::new("s.bvh"), &bad, &mapping(SMALL_MAP).unwrap(), &PELVIS);
        }
    }
    assert!(small("").is_err());
}

#[test]
fn bad_mappings_are_refused_with_place_and_value() {
    assert!(SkeletonMapping::cmu_asf().is_ok() && SkeletonMapping::cmu_bvh().is_ok());
    for (from, to, words) in [
        ("metres_per_unit = 0.01", "metres_per_unit = 0", ["metres_per_unit", "0"]),
        ("metres_per_unit = 0.01", "metres_per_unit = nan", ["metres_per_unit", "NaN"]),
        ("metres_per_unit = 0.01", "", ["line", "metres_per_unit"]),
        ("metres_per_unit = 0.01", "metres_per_unit = 1\nscale = 2", ["line 2", "scale"]),
        ("metres_per_unit = 0.01", "metres_per_unit = 1\nup = \"w\"", ["line 2", "w"]),
        ("metres_per_unit = 0.01", "metres_per_unit = 1\nfacing = \"-y\"", ["facing", "along `up`"]),
        ("\"pelvis\"", "\"hips\"", ["joints.Hips", "`hips`"]),
        ("\"pelvis\"", "\"left_hip\"", ["already follows", "left_hip"]),
        ("\"pelvis\"", "\"spine1\"", ["pelvis", "no joint"]),
        ("Arm = \"left_shoulder\"", "[rest_directions]\nArm = [1, 0, 0]", ["rest_directions.Arm", "not among"]),
        ("Hips = \"pelvis\"", "Hips = \"pelvis\"\n[rest_directions]\nHips = [0, 1, 0]\n[joints2]", ["line", "joints2"]),
    ] {
        let text = mapping(&SMALL_MAP.replacen(from, to, 1)).unwrap_err().to_string();
        assert!(text.contains("map.toml") && words.iter().all(|w| text.contains(w)), "{to}: {text}");
    }
    for (more, words) in [
        ("[rest_directions]\nArm = [0, 0, 0]\n", ["rest_directions.Arm", "0.0"]),
        ("[rest_directions]\nArm = [inf, 0, 0]\n", ["rest_directions.Arm", "inf"]),
        ("[rest_directions]\nHips = [0, 1, 0]\n", ["rest_directions.Hips", "no effect"]),
    ] {
        let text = mapping(&format!("{SMALL_MAP}{more}")).unwrap_err().to_string();
        assert!(words.iter().all(|w| text.contains(w)), "{more}: {text}");
    }
    // An arm without anything attached has no direction.
    let bare = SMALL.replace("JOINT Helper { OFFSET 0 0 0 CHANNELS 0\nEnd Site { OFFSET 0 -30 0 } } }", "}");
    assert!(small(&bare).unwrap_err().to_string().contains("no rest direction"));
}
