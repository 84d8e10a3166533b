#![no_main]
//! ASF/AMC: skeleton and motion, parted by a zero byte.

use caphy_core::Vec3;
use caphy_formats::motion::{SkeletonMapping, read_asf_amc};
use libfuzzer_sys::fuzz_target;
use std::path::Path;
use std::sync::LazyLock;

static MAPPING: LazyLock<SkeletonMapping> = LazyLock::new(|| SkeletonMapping::cmu_asf().unwrap());

fuzz_target!(|data: &[u8]| {
    let at = data.iter().position(|&b| b == 0).unwrap_or(data.len());
    let (asf, amc) = (&data[..at], data.get(at + 1..).unwrap_or_default());
    let clip = read_asf_amc(Path::new("clip.asf"), asf, Path::new("clip.amc"), amc, 120.0, &MAPPING, &Vec3::zeros());
    let Some(clip) = caphy_fuzz::accepted("clip.a", clip) else { return };
    for pose in &clip.poses {
        assert_eq!(pose.rotations.len(), 55);
        assert!(pose.rotations.iter().chain([&pose.translation]).all(|v| v.iter().all(|x| x.is_finite())));
    }
});
