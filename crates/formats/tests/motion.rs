//! Motion: the same clips by two ways, other layouts, damage.

mod support;

use caphy_core::motion::MotionClip;
use caphy_core::pose::{Pose, SMPLX_PARENTS, smplx_joint};
use caphy_core::{Result, Vec3};
use caphy_formats::motion::{AmassTranslation, SkeletonMapping, read_amass_npz, read_amass_npz_as, read_asf_amc};
use nalgebra::UnitQuaternion;
use npyz::WriterBuilder;
use npyz::npz::NpzWriter;
use std::io::Cursor;
use std::path::Path;

const PELVIS: Vec3 = Vec3::new(0.01, -0.35, 0.02);

fn turn(v: Vec3) -> UnitQuaternion<f64> {
    UnitQuaternion::from_scaled_axis(v)
}

/// Largest angle between joint rotations [rad] and largest distance between translations [m].
fn difference(a: &MotionClip, b: &MotionClip) -> (f64, f64) {
    assert_eq!(a.poses.len(), b.poses.len());
    let pairs = || a.poses.iter().zip(&b.poses);
    let angle = pairs()
        .flat_map(|(p, q)| p.rotations.iter().zip(&q.rotations).map(|(r, s)| turn(*r).angle_to(&turn(*s))))
        .fold(0.0, f64::max);
    let distance = pairs().map(|(p, q)| (p.translation - q.translation).norm()).fold(0.0, f64::max);
    (angle, distance)
}

#[test]
fn asf_amc_and_npz_of_a_clip_agree() {
    for (subject, clip, frames) in [("35", "35_01", 358), ("49", "49_18", 1102)] {
        let read = |name: String| support::shared(&format!("data/mocap/{name}"));
        let (Some(asf), Some(amc), Some(npz)) =
            (read(format!("{subject}.asf")), read(format!("{clip}.amc")), read(format!("cmu_{clip}_smplh.npz")))
        else {
            return;
        };
        let (asf_path, amc_path, cmu) =
            (Path::new("s.asf"), Path::new("s/clip.amc"), SkeletonMapping::cmu_asf().unwrap());
        let direct = read_asf_amc(asf_path, &asf, amc_path, &amc, 120.0, &cmu, &PELVIS).unwrap();
        let stored = read_amass_npz(Path::new("clip.npz"), npz, &PELVIS).unwrap();
        assert_eq!((direct.poses.len(), direct.fps, direct.name.as_str()), (frames, stored.fps, "clip"));
        let (angle, distance) = difference(&direct, &stored);
        println!("{clip}: largest difference {angle:.2e} rad, {distance:.2e} m");
        // The archive holds f32: an axis-angle up to pi has 24 bits, so 3 components of 1.2e-7 rad each; metres alike.
        assert!(angle < 4e-7 && distance < 4e-7, "{clip}: {angle:e} rad, {distance:e} m");
    }
}

#[test]
fn a_walk_stands_upright_and_moves_forward() {
    let Some(npz) = support::shared("data/mocap/cmu_35_01_smplh.npz") else { return };
    let clip = read_amass_npz(Path::new("walk.npz"), npz, &PELVIS).unwrap();
    let (first, last) = (&clip.poses[0], &clip.poses[357]);
    for pose in &clip.poses {
        let height = (pose.translation + PELVIS).y;
        assert!((0.8..1.2).contains(&height), "pelvis at {height} m");
        // The trunk leans less than 30 degrees: spine2's up stays up.
        let mut world = vec![UnitQuaternion::identity(); 55];
        for (j, r) in pose.rotations.iter().enumerate() {
            world[j] = if j == 0 { turn(*r) } else { world[SMPLX_PARENTS[j]] * turn(*r) };
        }
        assert!((world[smplx_joint("spine2").unwrap()] * Vec3::y()).y > 0.87);
    }
    let way = last.translation - first.translation;
    let facing = turn(first.rotations[0]) * Vec3::z();
    assert!(way.norm() > 2.0 && way.normalize().dot(&facing) > 0.9, "walked {way}, facing {facing}");
}

#[test]
fn smplx_clips_are_read() {
    for (clip, frames) in [("49_19", 957), ("01_01", 2751)] {
        let Some(npz) = support::shared(&format!("data/mocap/cmu_{clip}_smplx.npz")) else { return };
        let clip = read_amass_npz(Path::new("clip.npz"), npz, &PELVIS).unwrap();
        assert_eq!((clip.poses.len(), clip.fps), (frames, 120.0));
    }
}

fn amass(width: u64, rate: &str, fps: f64, fill: impl Fn(usize) -> f64, trans_frames: u64) -> Vec<u8> {
    let mut bytes = Cursor::new(Vec::new());
    {
        let mut w = NpzWriter::new(&mut bytes);
        let mut put = |name: &str, shape: &[u64], values: Vec<f64>| {
            w.array(name, Default::default())
                .unwrap()
                .default_dtype()
                .shape(shape)
                .begin_nd()
                .unwrap()
                .extend(values)
                .unwrap();
        };
        put("poses", &[2, width], (0..2 * width as usize).map(fill).collect());
        put("trans", &[trans_frames, 3], (0..3 * trans_frames).map(|i| i as f64).collect());
        put(rate, &[], vec![fps]);
    }
    bytes.into_inner()
}

#[test]
fn both_widths_both_rate_keys() {
    let small = |i: usize| 1e-3 * (i % 165) as f64;
    let smplx =
        read_amass_npz(Path::new("x.npz"), amass(165, "mocap_frame_rate", 59.99999, small, 2), &PELVIS).unwrap();
    assert_eq!(smplx.fps, 59.99999);
    assert!((smplx.poses[1].rotations[54].z - 0.164).abs() < 1e-12, "SMPL-X order is kept");
    let smplh = read_amass_npz(Path::new("h.npz"), amass(156, "mocap_framerate", 120.0, small, 2), &PELVIS).unwrap();
    let pose = &smplh.poses[0];
    assert!((22..25).all(|j| pose.rotations[j] == Vec3::zeros()), "jaw and eyes rest");
    // Joint 22 of SMPL-H is the left index finger, joint 25 of SMPL-X.
    assert!((pose.rotations[25].x - 0.066).abs() < 1e-12 && (pose.rotations[54].z - 0.155).abs() < 1e-12);
    // z up (0, 1, 2) is y up (0, 2, -1).
    assert!((pose.translation - (Vec3::new(0.0, 2.0, -1.0) - PELVIS)).norm() < 1e-15);
}

#[test]
fn the_two_meanings_of_trans_put_the_pelvis_alike() {
    let bytes = || amass(165, "mocap_framerate", 30.0, |_| 0.0, 2);
    let offset = read_amass_npz_as(Path::new("x.npz"), bytes(), &PELVIS, AmassTranslation::BodyOffset).unwrap();
    // The file's body, z up, has its pelvis at trans + rest pelvis; both turn into the y-up world together.
    let rest = Vec3::new(0.01, -0.35, 0.02);
    let place = Vec3::new(0.0, 1.0, 2.0) + rest;
    let wanted = Vec3::new(place.x, place.z, -place.y);
    let mut rested = Pose::rest(55);
    rested.translation = offset.poses[0].translation;
    assert!((rested.translation + PELVIS - wanted).norm() < 1e-15);
}

#[test]
fn bad_clips_are_refused_with_place_and_value() {
    let read = |bytes: Vec<u8>| read_amass_npz(Path::new("clip.npz"), bytes, &PELVIS).unwrap_err().to_string();
    let zero = |_: usize| 0.0;
    for (text, words) in [
        (read(amass(72, "mocap_framerate", 30.0, zero, 2)), ["clip.npz", "poses", "72"]),
        (read(amass(165, "rate", 30.0, zero, 2)), ["clip.npz", "mocap_frame_rate", "rate"]),
        (read(amass(165, "mocap_framerate", 0.0, zero, 2)), ["clip.npz", "mocap_framerate", "0"]),
        (read(amass(165, "mocap_framerate", 30.0, zero, 3)), ["clip.npz", "trans", "[3, 3]"]),
        (
            read(amass(165, "mocap_framerate", 30.0, |i| if i == 170 { f64::NAN } else { 0.0 }, 2)),
            ["clip.npz", "`poses`, frame 1", "column 5"],
        ),
    ] {
        assert!(words.iter().all(|w| text.contains(w)), "{text}");
    }
}

fn skeleton() -> String {
    let bones = "lfemur rfemur lowerback ltibia rtibia upperback lfoot rfoot thorax ltoes rtoes upperneck lclavicle \
        rclavicle head lhumerus rhumerus lradius rradius lhand rhand";
    let mut asf = ":version 1.10\n:units\nlength 0.45\nangle deg\n:root\norder TX TY TZ RX RY RZ\naxis XYZ\n\
        position 0 0 0\norientation 0 0 0\n:bonedata\n"
        .to_string();
    for bone in bones.split_whitespace() {
        asf += &format!("begin\nname {bone}\ndirection 0 1 0\nlength 1\naxis 0 0 20 XYZ\ndof rx rz\nend\n");
    }
    asf + &format!(":hierarchy\nbegin\nroot {bones}\nend\n")
}

fn frames() -> String {
    let frame = "root 1 2 3 4 5 6\nlfemur 10 20\nltibia 1.5 2.5\n";
    format!("#!OML:ASF\n:FULLY-SPECIFIED\n:DEGREES\n1\n{frame}2\n{frame}")
}

fn clip(asf: &[u8], amc: &[u8]) -> Result<MotionClip> {
    clip_at(asf, amc, 120.0)
}

fn clip_at(asf: &[u8], amc: &[u8], fps: f64) -> Result<MotionClip> {
    let cmu = SkeletonMapping::cmu_asf().unwrap();
    read_asf_amc(Path::new("a.asf"), asf, Path::new("a.amc"), amc, fps, &cmu, &PELVIS)
}

#[test]
fn bad_skeletons_and_frames_are_refused_with_place_and_value() {
    let (asf, amc) = (skeleton(), frames());
    assert_eq!(clip(asf.as_bytes(), amc.as_bytes()).unwrap().poses.len(), 2);
    for (from, to, words) in [
        ("name rhand", "name paw", ["a.asf", "rhand", "bonedata"]),
        ("root lfemur", "root hip lfemur", ["a.asf", "line", "`hip`"]),
        ("root lfemur", "root lfemur lfemur", ["a.asf", "lfemur", "two parents"]),
        ("length 0.45", "length zero", ["a.asf", "line 3", "zero"]),
        ("angle deg", "angle grad", ["a.asf", "line 4", "grad"]),
        ("direction 0 1 0", "direction 0 0 0", ["a.asf", "lfemur", "direction"]),
        ("dof rx rz", "dof rx rw", ["a.asf", "line", "rw"]),
    ] {
        let text = clip(asf.replacen(from, to, 1).as_bytes(), amc.as_bytes()).unwrap_err().to_string();
        assert!(words.iter().all(|w| text.contains(w)), "{to}: {text}");
    }
    for (from, to, words) in [
        ("lfemur 10 20", "lfemur 10", ["a.amc", "line 6", "1 values"]),
        ("lfemur 10 20", "lfemur 10 inf", ["a.amc", "line 6", "inf"]),
        ("lfemur 10 20", "tail 10 20", ["a.amc", "line 6", "tail"]),
        ("root 1 2 3 4 5 6\n", "", ["a.amc", "line", "root"]),
        ("1\nroot", "root", ["a.amc", "line 4", "before the first frame"]),
    ] {
        let text = clip(asf.as_bytes(), amc.replacen(from, to, 1).as_bytes()).unwrap_err().to_string();
        assert!(words.iter().all(|w| text.contains(w)), "{to}: {text}");
    }
    assert!(clip_at(asf.as_bytes(), amc.as_bytes(), 0.0).is_err());
}

#[test]
fn damage_anywhere_does_not_panic() {
    let (asf, amc) = (skeleton().into_bytes(), frames().into_bytes());
    for cut in 0..asf.len() {
        let _ = clip(&asf[..cut], &amc);
        let mut bad = asf.clone();
        bad[cut] = 0xff;
        let _ = clip(&bad, &amc);
    }
    for cut in 0..amc.len() {
        let whole = clip(&asf, &amc[..cut]);
        // A cut between two frames leaves a shorter clip; a cut inside a number may leave a number.
        assert!(whole.is_err() || whole.unwrap().poses.len() <= 2);
        for value in [0, b' ', b'9', 0xff] {
            let mut bad = amc.clone();
            bad[cut] = value;
            let _ = clip(&asf, &bad);
        }
    }
    // In the middle of a real file: frame 2 has lost its last bones.
    let cut = frames().replacen("2\nroot 1 2 3 4 5 6\nlfemur 10 20\nltibia 1.5 2.5\n", "2\nroot 1 2 3 4 5 6\n", 1);
    assert!(clip(&asf, cut.as_bytes()).unwrap_err().to_string().contains("gives 1 bones, the first gives 3"));
}
