//! Motion: the same clips by two ways, other layouts, damage.

mod support;

use caphy_core::motion::{ClipPreparation, MotionClip, MotionLimits, MotionWindows, sort_clips};
use caphy_core::pose::{Pose, SMPLX_PARENTS, smplx_joint};
use caphy_core::{Result, Vec3};
use caphy_formats::motion::{
    SkeletonMapping, SmplNpzOptions, TranslationMeaning, UpAxis, read_asf_amc, read_bvh, read_smpl_npz,
};
use nalgebra::UnitQuaternion;
use std::path::Path;

const PELVIS: Vec3 = Vec3::new(0.01, -0.35, 0.02);

/// A clip of the shared folder: AMASS's layout, pelvis positions.
fn read_amass_npz(path: &Path, bytes: Vec<u8>, pelvis: &Vec3) -> Result<MotionClip> {
    read_smpl_npz(path, bytes, &SmplNpzOptions::amass(TranslationMeaning::PelvisPosition), pelvis)
}

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

/// Name, shape, values.
type Entry = (&'static str, Vec<u64>, Vec<f64>);

fn archive(entries: Vec<Entry>) -> Vec<u8> {
    let arrays: Vec<(&str, Vec<u8>)> =
        entries.into_iter().map(|(name, shape, values)| (name, support::array(&shape, values))).collect();
    support::archive(&arrays, false)
}

/// Recorded people are sound but for the glitches of their markers.
#[test]
fn few_windows_of_recorded_clips_are_dropped() {
    let at_rate = ClipPreparation { smoothing: 0.0, fps: 30.0, limits: Some(MotionLimits::default()) };
    let mut clips = Vec::new();
    for name in ["cmu_35_01_smplh", "cmu_49_18_smplh", "cmu_49_19_smplx", "cmu_01_01_smplx"] {
        let Some(npz) = support::shared(&format!("data/mocap/{name}.npz")) else { return };
        clips.push(read_amass_npz(Path::new(name), npz, &PELVIS).unwrap());
    }
    let Some(bvh) = support::shared("data/mocap/cmu_131_01.bvh") else { return };
    clips.push(read_bvh(Path::new("cmu_131_01.bvh"), &bvh, &SkeletonMapping::cmu_bvh().unwrap(), &PELVIS).unwrap());
    let mut prepared: Vec<_> = clips.iter().map(|clip| at_rate.prepare(clip).unwrap()).collect();
    for clip in &prepared {
        let facts = clip.facts(5);
        println!("{}: {} windows, {} dropped", facts.name, facts.windows, facts.dropped_windows);
        facts.findings.iter().for_each(|f| println!("  {f}"));
        assert!(facts.windows as f64 > 0.75 * (facts.frames - 4) as f64, "{}", facts.name);
    }
    sort_clips(&mut prepared).unwrap();
    let windows = MotionWindows::new(&prepared, 5).unwrap();
    println!("{}", windows.report);
    // A broken copy of a clip loses its broken windows and no others.
    let mut broken = clips[0].clone();
    broken.poses[200].rotations[smplx_joint("left_knee").unwrap()] = Vec3::new(-2.0, 0.0, 0.0);
    broken.poses[300..].iter_mut().for_each(|p| p.translation.x += 1.0);
    let (before, after) = (at_rate.prepare(&clips[0]).unwrap().facts(5), at_rate.prepare(&broken).unwrap().facts(5));
    assert!(
        after.windows < before.windows && after.windows + 12 >= before.windows,
        "{} {}",
        before.windows,
        after.windows
    );
    let reasons =
        |joint: &str| after.findings.iter().filter(|f| f.joint == joint).map(|f| f.first_frame).collect::<Vec<_>>();
    assert!(reasons("left_knee").contains(&200) && reasons("pelvis").contains(&300), "{:?}", after.findings);
}

fn amass(width: u64, rate: &'static str, fps: f64, fill: impl Fn(usize) -> f64, trans_frames: u64) -> Vec<u8> {
    archive(vec![
        ("poses", vec![2, width], (0..2 * width as usize).map(fill).collect()),
        ("trans", vec![trans_frames, 3], (0..3 * trans_frames).map(|i| i as f64).collect()),
        (rate, vec![], vec![fps]),
    ])
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
    let offset =
        read_smpl_npz(Path::new("x.npz"), bytes(), &SmplNpzOptions::amass(TranslationMeaning::BodyOffset), &PELVIS)
            .unwrap();
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
        (read(amass(75, "mocap_framerate", 30.0, zero, 2)), ["clip.npz", "poses", "75"]),
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

/// `count` numbers from `first` on, in thousandths.
fn numbers(first: usize, count: usize) -> Vec<f64> {
    (first..first + count).map(|i| 1e-3 * i as f64).collect()
}

/// The parts of a clip of one frame, by two sets of names, and the same as one array.
fn parts() -> [Vec<Entry>; 3] {
    let trans = |name| (name, vec![1, 3], vec![0.1, 0.2, 0.3]);
    let rate = || ("fps", vec![1], vec![25.0]);
    [
        vec![
            ("root_orient", vec![1, 3], numbers(0, 3)),
            ("pose_body", vec![1, 63], numbers(3, 63)),
            ("pose_jaw", vec![1, 3], numbers(66, 3)),
            ("pose_eye", vec![1, 6], numbers(69, 6)),
            ("pose_hand", vec![1, 90], numbers(75, 90)),
            trans("trans"),
            rate(),
        ],
        vec![
            ("global_orient", vec![1, 1, 3], numbers(0, 3)),
            ("body_pose", vec![1, 21, 3], numbers(3, 63)),
            ("jaw_pose", vec![1, 3], numbers(66, 3)),
            ("leye_pose", vec![1, 3], numbers(69, 3)),
            ("reye_pose", vec![1, 3], numbers(72, 3)),
            ("left_hand_pose", vec![1, 45], numbers(75, 45)),
            ("right_hand_pose", vec![1, 45], numbers(120, 45)),
            trans("transl"),
            rate(),
        ],
        vec![("poses", vec![1, 165], numbers(0, 165)), trans("trans"), rate()],
    ]
}

const TRACKED: SmplNpzOptions =
    SmplNpzOptions { up: UpAxis::Y, translation: TranslationMeaning::BodyOffset, fps: None };

fn tracked(entries: Vec<Entry>, options: SmplNpzOptions) -> Result<MotionClip> {
    read_smpl_npz(Path::new("track.npz"), archive(entries), &options, &PELVIS)
}

#[test]
fn parts_by_either_name_are_the_whole() {
    let [amass, smplx, whole] = parts().map(|entries| tracked(entries, TRACKED).unwrap());
    assert_eq!(amass, whole);
    assert_eq!(smplx, whole);
    let pose = &whole.poses[0];
    assert_eq!((whole.fps, whole.name.as_str()), (25.0, "track"));
    for (j, r) in pose.rotations.iter().enumerate() {
        assert!((r - Vec3::from_vec(numbers(3 * j, 3))).norm() < 1e-15, "{j}");
    }
    assert!((pose.translation - Vec3::new(0.1, 0.2, 0.3)).norm() < 1e-15, "y up stays as it is");
    let own = tracked(parts()[2].clone(), SmplNpzOptions { fps: Some(50.0), ..TRACKED }).unwrap();
    assert_eq!(own.fps, 50.0);
}

#[test]
fn smpl_bodies_turn_their_fingers_with_their_hands() {
    let [_, _, mut entries] = parts();
    entries[0] = ("poses", vec![1, 72], numbers(0, 72));
    let pose = &tracked(entries.clone(), TRACKED).unwrap().poses[0];
    for j in 0..55 {
        let wanted = match j {
            0..22 => Vec3::from_vec(numbers(3 * j, 3)),
            25 | 28 | 31 | 34 => Vec3::from_vec(numbers(66, 3)),
            40 | 43 | 46 | 49 => Vec3::from_vec(numbers(69, 3)),
            _ => Vec3::zeros(),
        };
        assert!((pose.rotations[j] - wanted).norm() < 1e-15, "{j}");
    }
    // The same as root and body, and as matrices.
    let matrices = pose.rotations[..22]
        .iter()
        .chain([&pose.rotations[25], &pose.rotations[40]])
        .flat_map(|r| nalgebra::Rotation3::from_scaled_axis(*r).into_inner().transpose().as_slice().to_vec());
    let matrices: Vec<f64> = matrices.collect();
    entries[0] = ("poses", vec![1, 24, 3, 3], matrices.clone());
    let [_, mut split, _] = parts();
    split.truncate(1);
    split.extend([("body_pose", vec![1, 69], numbers(3, 69)), entries[1].clone(), entries[2].clone()]);
    let mut both = entries.clone();
    both[0] = ("global_orient", vec![1, 3, 3], matrices[..9].to_vec());
    both.push(("body_pose", vec![1, 23, 3, 3], matrices[9..].to_vec()));
    for entries in [entries, split, both] {
        let other = &tracked(entries, TRACKED).unwrap().poses[0];
        assert!(pose.rotations.iter().zip(&other.rotations).all(|(a, b)| (a - b).norm() < 1e-12));
    }
}

#[test]
fn every_up_axis_stands_upright() {
    // A body with its feet below its pelvis in the file's world, facing as that world's turn to y up says.
    for (up, down) in [(UpAxis::Y, [0.0, -1.0, 0.0]), (UpAxis::MinusY, [0.0, 1.0, 0.0]), (UpAxis::Z, [0.0, 0.0, -1.0])]
    {
        let turned = up.to_y_up().inverse();
        let root = turned.scaled_axis();
        let entries = vec![
            ("global_orient", vec![1, 3], root.as_slice().to_vec()),
            ("body_pose", vec![1, 63], vec![0.0; 63]),
            // One metre above the origin.
            ("transl", vec![1, 3], down.map(|x: f64| -x).to_vec()),
            ("fps", vec![], vec![30.0]),
        ];
        let options = SmplNpzOptions { up, translation: TranslationMeaning::PelvisPosition, fps: None };
        let pose = &tracked(entries, options).unwrap().poses[0];
        assert!(pose.rotations[0].norm() < 1e-12, "{up:?}: upright, facing +z");
        assert!((pose.translation + PELVIS - Vec3::y()).norm() < 1e-12, "{up:?}");
    }
}

#[test]
fn bad_parameters_are_refused_with_place_and_value() {
    let [amass, smplx, whole] = parts();
    let with = |mut entries: Vec<Entry>, name: &str, entry: Option<Entry>| {
        let at = entries.iter().position(|e| e.0 == name).unwrap();
        match entry {
            Some(entry) => entries[at] = entry,
            None => drop(entries.remove(at)),
        }
        tracked(entries, TRACKED).unwrap_err().to_string()
    };
    let mut nan = numbers(0, 63);
    nan[5] = f64::NAN;
    for (text, words) in [
        (with(amass.clone(), "root_orient", None), ["no pose", "root_orient"]),
        (with(amass.clone(), "pose_body", None), ["no pose", "pose_body"]),
        (with(amass.clone(), "trans", None), ["no translation", "transl"]),
        (with(amass.clone(), "fps", None), ["no frame rate", "mocap_framerate"]),
        (with(amass.clone(), "fps", Some(("fps", vec![2], vec![30.0; 2]))), ["`fps`", "[2]"]),
        (with(amass.clone(), "fps", Some(("fps", vec![], vec![-1.0]))), ["`fps`", "-1"]),
        (with(amass.clone(), "pose_body", Some(("pose_body", vec![1, 60], numbers(0, 60)))), ["`pose_body`", "60"]),
        (with(amass.clone(), "pose_body", Some(("pose_body", vec![63], numbers(0, 63)))), ["`pose_body`", "[63]"]),
        (
            with(amass.clone(), "pose_body", Some(("pose_body", vec![2, 63], numbers(0, 126)))),
            ["`pose_body`", "2 frames"],
        ),
        (with(amass.clone(), "pose_body", Some(("pose_body", vec![1, 63], nan))), ["`pose_body`, frame 0", "column 5"]),
        (with(amass.clone(), "pose_body", Some(("pose_body", vec![], vec![0.0]))), ["`pose_body`", "[]"]),
        (
            with(smplx, "left_hand_pose", Some(("left_hand_pose", vec![1, 6], numbers(0, 6)))),
            ["`left_hand_pose`", "PCA"],
        ),
        (with(whole.clone(), "poses", Some(("poses", vec![0, 165], vec![]))), ["[1, 3]", "0 frames"]),
        (
            with(whole.clone(), "poses", Some(("poses", vec![1, 24, 3, 3], vec![0.5; 216]))),
            ["`poses`, frame 0, rotation 0", "no rotation"],
        ),
        (
            with(whole, "trans", Some(("trans", vec![1, 3], vec![0.0, f64::INFINITY, 0.0]))),
            ["`trans`, frame 0", "column 1 is inf"],
        ),
    ] {
        assert!(text.contains("track.npz") && words.iter().all(|w| text.contains(w)), "{text}");
    }
    let none: Vec<Entry> =
        vec![("poses", vec![0, 165], vec![]), ("trans", vec![0, 3], vec![]), ("fps", vec![], vec![30.0])];
    assert!(tracked(none, TRACKED).unwrap_err().to_string().contains("0 frames"));
    for fps in [0.0, f64::NAN] {
        assert!(tracked(amass.clone(), SmplNpzOptions { fps: Some(fps), ..TRACKED }).is_err());
    }
    // Cut off anywhere: an error, not a panic. Every byte changed: no panic.
    let bytes = archive(amass);
    let read = |bytes: &[u8]| read_smpl_npz(Path::new("track.npz"), bytes.to_vec(), &TRACKED, &PELVIS);
    for cut in (0..bytes.len()).step_by(7) {
        assert!(read(&bytes[..cut]).is_err());
        let mut bad = bytes.clone();
        bad[cut] ^= 0xff;
        let _ = read(&bad);
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
