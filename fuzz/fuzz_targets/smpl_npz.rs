#![no_main]
//! Clips of body parameters: the archive itself, and arrays of any type, shape and content behind right checksums.

use caphy_core::Vec3;
use caphy_formats::motion::{SmplNpzOptions, TranslationMeaning, UpAxis, read_smpl_npz};
use libfuzzer_sys::fuzz_target;
use std::path::Path;

/// What the arrays of an input are called, in its order.
const NAMES: [&[&str]; 4] = [
    &["poses.npy", "trans.npy", "mocap_framerate.npy"],
    &["poses.npy", "transl.npy", "fps.npy"],
    &["root_orient.npy", "pose_body.npy", "trans.npy", "mocap_frame_rate.npy", "pose_hand.npy", "pose_jaw.npy"],
    &["global_orient.npy", "body_pose.npy", "transl.npy", "fps.npy", "left_hand_pose.npy", "leye_pose.npy"],
];

fuzz_target!(|data: &[u8]| {
    let Some((&mode, rest)) = data.split_first() else { return };
    let translation = if mode & 1 == 0 { TranslationMeaning::PelvisPosition } else { TranslationMeaning::BodyOffset };
    let up = if mode & 2 == 0 { UpAxis::Z } else { UpAxis::Y };
    let options = SmplNpzOptions { up, ..SmplNpzOptions::amass(translation) };
    let bytes = if mode & 4 == 0 {
        rest.to_vec()
    } else {
        let names = NAMES[usize::from(mode >> 3) % NAMES.len()];
        let entries: Vec<(&str, &[u8])> = names.iter().copied().zip(split(rest, b"\n--\n")).collect();
        caphy_fuzz::stored_zip(&entries)
    };
    let clip = read_smpl_npz(Path::new("clip.npz"), bytes, &options, &Vec3::new(0.01, -0.35, 0.02));
    let Some(clip) = caphy_fuzz::accepted("clip.npz", clip) else { return };
    assert!(clip.fps > 0.0 && !clip.poses.is_empty());
    for pose in &clip.poses {
        assert_eq!(pose.rotations.len(), 55);
        assert!(pose.rotations.iter().chain([&pose.translation]).all(|v| v.iter().all(|x| x.is_finite())));
    }
});

/// Entries parted by a line: what the mutator can move about.
fn split<'a>(mut bytes: &'a [u8], by: &[u8]) -> Vec<&'a [u8]> {
    let mut parts = Vec::new();
    while let Some(at) = bytes.windows(by.len()).position(|w| w == by) {
        parts.push(&bytes[..at]);
        bytes = &bytes[at + by.len()..];
    }
    parts.push(bytes);
    parts
}
