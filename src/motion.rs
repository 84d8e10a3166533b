//! Clips named in a configuration.

use crate::config::{ClipConfig, MotionConfig, Translation};
use crate::files::ProjectFiles;
use caphy_bodymodel::procedural_motion::procedural_clip;
use caphy_core::files::Files;
use caphy_core::motion::MotionClip;
use caphy_core::{Result, Vec3};
use caphy_formats::motion::{AmassTranslation, SkeletonMapping, read_amass_npz_as, read_asf_amc};

/// Reads or generates a clip and resamples it. `pelvis` is the body's rest pelvis [m]: recorded translations are the
/// pelvis's own.
pub fn load(files: &ProjectFiles, clip: &ClipConfig, fps: f64, pelvis: &Vec3) -> Result<MotionClip> {
    let clip = match clip {
        ClipConfig::Procedural { kind, seed, seconds } => procedural_clip(*kind, *seed, *seconds, fps)?,
        ClipConfig::Amass { path, translation } => {
            let meaning = match translation {
                Translation::BodyOffset => AmassTranslation::BodyOffset,
                Translation::PelvisPosition => AmassTranslation::PelvisPosition,
            };
            read_amass_npz_as(&files.resolve(path)?, files.read(path)?, pelvis, meaning)?
        }
        ClipConfig::AsfAmc { skeleton, path, fps } => read_asf_amc(
            &files.resolve(skeleton)?,
            &files.read(skeleton)?,
            &files.resolve(path)?,
            &files.read(path)?,
            *fps,
            &SkeletonMapping::cmu_asf()?,
            pelvis,
        )?,
    };
    clip.resampled(fps)
}

/// All training clips.
pub fn load_all(files: &ProjectFiles, config: &MotionConfig, pelvis: &Vec3) -> Result<Vec<MotionClip>> {
    config.clips.iter().map(|clip| load(files, clip, config.fps, pelvis)).collect()
}
