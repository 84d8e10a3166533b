#![no_main]
//! AMASS clips: arrays of any type, shape and content behind right checksums.

use caphy_core::Vec3;
use caphy_formats::motion::{AmassTranslation, read_amass_npz_as};
use libfuzzer_sys::fuzz_target;
use std::path::Path;

fuzz_target!(|data: &[u8]| {
    let Some((&mode, rest)) = data.split_first() else { return };
    let meaning = if mode & 1 == 0 { AmassTranslation::PelvisPosition } else { AmassTranslation::BodyOffset };
    let bytes = if mode & 2 == 0 {
        rest.to_vec()
    } else {
        // Entries parted by a line: what the mutator can move about.
        let entries: Vec<&[u8]> = split(rest, b"\n--\n");
        let names =
            ["poses.npy", "trans.npy", if mode & 4 == 0 { "mocap_framerate.npy" } else { "mocap_frame_rate.npy" }];
        let entries: Vec<(&str, &[u8])> = names.into_iter().zip(entries).collect();
        caphy_fuzz::stored_zip(&entries)
    };
    let clip = read_amass_npz_as(Path::new("clip.npz"), bytes, &Vec3::new(0.01, -0.35, 0.02), meaning);
    let Some(clip) = caphy_fuzz::accepted("clip.npz", clip) else { return };
    assert!(clip.fps > 0.0 && !clip.poses.is_empty());
    for pose in &clip.poses {
        assert_eq!(pose.rotations.len(), 55);
        assert!(pose.rotations.iter().chain([&pose.translation]).all(|v| v.iter().all(|x| x.is_finite())));
    }
});

fn split<'a>(mut bytes: &'a [u8], by: &[u8]) -> Vec<&'a [u8]> {
    let mut parts = Vec::new();
    while let Some(at) = bytes.windows(by.len()).position(|w| w == by) {
        parts.push(&bytes[..at]);
        bytes = &bytes[at + by.len()..];
    }
    parts.push(bytes);
    parts
}
