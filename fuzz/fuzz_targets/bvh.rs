#![no_main]
//! BVH: a clip that is read has finite poses of 55 joints.

use caphy_core::Vec3;
use caphy_formats::motion::{SkeletonMapping, read_bvh};
use libfuzzer_sys::fuzz_target;
use std::path::Path;
use std::sync::LazyLock;

/// Few joints, so that small files are whole; z up and a rest pose of its own, so that every correction runs.
static MAPPING: LazyLock<SkeletonMapping> = LazyLock::new(|| {
    let text = "up = \"z\"\nmetres_per_unit = 0.01\n[joints]\na = \"pelvis\"\nb = \"left_hip\"\nc = \"left_knee\"\n";
    SkeletonMapping::from_toml(Path::new("fuzz.toml"), text.as_bytes()).unwrap()
});

fuzz_target!(|data: &[u8]| {
    let clip = read_bvh(Path::new("clip.bvh"), data, &MAPPING, &Vec3::zeros());
    let Some(clip) = caphy_fuzz::accepted("clip.bvh", clip) else { return };
    assert!(clip.fps > 0.0 && !clip.poses.is_empty());
    for pose in &clip.poses {
        assert_eq!(pose.rotations.len(), 55);
        assert!(pose.rotations.iter().chain([&pose.translation]).all(|v| v.iter().all(|x| x.is_finite())));
    }
});
