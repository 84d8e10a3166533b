//! Clips named in a configuration.

pub mod variation;

use crate::config::{ClipConfig, MotionConfig, Translation, cmu_fps};
use crate::files::ProjectFiles;
use caphy_bodymodel::procedural_motion::procedural_clip;
use caphy_core::files::Files;
use caphy_core::motion::{ClipPreparation, MotionClip, MotionLimits, PreparedClip};
use caphy_core::{Error, Result, Vec3};
use caphy_formats::motion::{
    SkeletonMapping, SmplNpzOptions, TranslationMeaning, read_asf_amc, read_bvh, read_smpl_npz,
};
use nalgebra::UnitQuaternion;
use std::path::{Path, PathBuf};

/// Reads or generates one clip, looks for damage if there are `limits`, smooths and resamples it. `pelvis` is the body's rest
/// pelvis [m]: recorded translations are the pelvis's own.
///
/// # Errors
/// What the readers refuse; [`Error::Config`] for a folder, which holds many clips.
pub fn load(
    files: &ProjectFiles,
    clip: &ClipConfig,
    limits: Option<&MotionLimits>,
    fps: f64,
    pelvis: &Vec3,
) -> Result<PreparedClip> {
    let preparation = ClipPreparation { smoothing: smoothing_of(clip), fps, limits: limits.cloned() };
    preparation.prepare(&read(files, clip, fps, pelvis)?)
}

/// All training clips in the order of the configuration, those of a folder by name, each followed by its variations.
///
/// # Errors
/// As [`load`]; a folder without clips.
pub fn load_all(files: &ProjectFiles, motion: &MotionConfig, pelvis: &Vec3, seed: u64) -> Result<Vec<PreparedClip>> {
    let (mut recorded, mut smoothings) = (Vec::new(), Vec::new());
    for clip in &motion.clips {
        for (name, clip) in expand(files, clip)? {
            let mut read = read(files, &clip, motion.fps, pelvis)?;
            if let Some(name) = name {
                read.name = name;
            }
            recorded.push(read);
            smoothings.push(smoothing_of(&clip));
        }
    }
    let mut out = Vec::new();
    for (i, (clip, smoothing)) in recorded.iter().zip(smoothings).enumerate() {
        let preparation = ClipPreparation { smoothing, fps: motion.fps, limits: Some(motion.limits.clone()) };
        out.push(preparation.prepare(clip)?);
        for copy in 0..motion.variation.copies {
            out.push(preparation.prepare(&motion.variation.vary(&recorded, i, copy, seed)?)?);
        }
    }
    Ok(out)
}

/// Standard deviation of the smoothing that a clip asks for [s].
fn smoothing_of(clip: &ClipConfig) -> f64 {
    match clip {
        ClipConfig::Tracked { smoothing_s, .. } => *smoothing_s,
        _ => 0.0,
    }
}

/// A clip as itself, a folder as its clips with their files' names: `35_01.amc` and `35_01.npz` are two clips.
fn expand(files: &ProjectFiles, clip: &ClipConfig) -> Result<Vec<(Option<String>, ClipConfig)>> {
    let ClipConfig::Folder { path, translation, mapping, amc_fps } = clip else {
        return Ok(vec![(None, clip.clone())]);
    };
    let found = files.list(path, &["npz", "bvh", "amc"])?;
    if found.is_empty() {
        let problem = format!("{} holds no .npz, .bvh or .amc", path.display());
        return Err(Error::config("motion.clips", problem, "give a folder of clips"));
    }
    let of = |path: PathBuf| {
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let mut clip = clip_of_file(path, *translation)?;
        match &mut clip {
            ClipConfig::Bvh { mapping: own, .. } => own.clone_from(mapping),
            ClipConfig::AsfAmc { fps, .. } => *fps = *amc_fps,
            _ => {}
        }
        Some((Some(name), clip))
    };
    Ok(found.into_iter().filter_map(of).collect())
}

/// How a motion file is read when nothing but its name is known: `.npz` as AMASS, `.bvh` and `.amc` as CMU's, the skeleton of
/// an `.amc` beside it (`35_01.amc`: `35.asf`). `None` for other endings.
pub fn clip_of_file(path: PathBuf, translation: Translation) -> Option<ClipConfig> {
    match path.extension()?.to_string_lossy().to_lowercase().as_str() {
        "npz" => Some(ClipConfig::Amass { path, translation }),
        "bvh" => Some(ClipConfig::Bvh { path, mapping: None, metres_per_unit: None }),
        "amc" => {
            let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
            let subject = name.split(['_', '.']).next().unwrap_or_default();
            let skeleton = path.with_file_name(format!("{subject}.asf"));
            Some(ClipConfig::AsfAmc { skeleton, path, fps: cmu_fps(), mapping: None })
        }
        _ => None,
    }
}

/// The clip as it was recorded.
fn read(files: &ProjectFiles, clip: &ClipConfig, fps: f64, pelvis: &Vec3) -> Result<MotionClip> {
    let mapping = |path: &Option<PathBuf>, built_in: fn() -> Result<SkeletonMapping>| match path {
        Some(path) => SkeletonMapping::from_toml(&files.resolve(path)?, &files.read(path)?),
        None => built_in(),
    };
    let npz = |path: &Path, options: SmplNpzOptions| {
        read_smpl_npz(&files.resolve(path)?, files.read(path)?, &options, pelvis)
    };
    match clip {
        ClipConfig::Procedural { kind, seed, seconds } => procedural_clip(*kind, *seed, *seconds, fps),
        ClipConfig::Amass { path, translation } => npz(path, SmplNpzOptions::amass((*translation).into())),
        ClipConfig::Tracked { path, up, gravity, translation, fps, .. } => {
            let up = up.unwrap_or_default();
            let clip = npz(path, SmplNpzOptions { up, translation: (*translation).into(), fps: *fps })?;
            Ok(match gravity {
                Some(gravity) => stood_up(clip, &Vec3::from(*gravity), pelvis),
                None => clip,
            })
        }
        ClipConfig::Bvh { path, mapping: map, metres_per_unit } => {
            let mut map = mapping(map, SkeletonMapping::cmu_bvh)?;
            if let Some(metres) = metres_per_unit {
                map = map.with_metres_per_unit(*metres)?;
            }
            read_bvh(&files.resolve(path)?, &files.read(path)?, &map, pelvis)
        }
        ClipConfig::AsfAmc { skeleton, path, fps, mapping: map } => read_asf_amc(
            &files.resolve(skeleton)?,
            &files.read(skeleton)?,
            &files.resolve(path)?,
            &files.read(path)?,
            *fps,
            &mapping(map, SkeletonMapping::cmu_asf)?,
            pelvis,
        ),
        ClipConfig::Folder { path, .. } => {
            Err(Error::config("clip", format!("{} is a folder", path.display()), "name one clip"))
        }
    }
}

/// The clip in a world in which things fall along -y, turned by the smallest rotation from one in which they fall along `gravity`;
/// `pelvis` is the body's rest pelvis [m], about which roots rotate.
fn stood_up(mut clip: MotionClip, gravity: &Vec3, pelvis: &Vec3) -> MotionClip {
    // No axis is the smallest rotation's when everything stands on its head.
    let half_turn = || UnitQuaternion::from_axis_angle(&Vec3::x_axis(), std::f64::consts::PI);
    let turn = UnitQuaternion::rotation_between(gravity, &-Vec3::y()).unwrap_or_else(half_turn);
    for pose in &mut clip.poses {
        if let Some(root) = pose.rotations.first_mut() {
            *root = (turn * UnitQuaternion::new(*root)).scaled_axis();
        }
        pose.translation = turn * (pelvis + pose.translation) - pelvis;
    }
    clip
}

impl From<Translation> for TranslationMeaning {
    fn from(translation: Translation) -> Self {
        match translation {
            Translation::BodyOffset => Self::BodyOffset,
            Translation::PelvisPosition => Self::PelvisPosition,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CLIP: &str = "HIERARCHY\nROOT Hips\n{\nOFFSET 0 0 0\nCHANNELS 6 Xposition Yposition Zposition Zrotation Yrotation \
        Xrotation\n}\nMOTION\nFrames: 2\nFrame Time: 0.1\n0 1 0 0 0 0\n0 1 0.5 0 0 0\n";
    const MAPPING: &str = "metres_per_unit = 1.0\n[joints]\nHips = \"pelvis\"\n";

    fn config(text: &str) -> MotionConfig {
        toml::from_str(text).unwrap()
    }

    #[test]
    fn a_tilted_camera_is_put_upright() {
        use caphy_bodymodel::procedural_motion::MotionKind;
        let pelvis = Vec3::new(0.01, 0.95, 0.02);
        let upright = procedural_clip(MotionKind::Walk, 1, 0.5, 30.0).unwrap();
        // What a camera sees that looks down by 25°, in its axes: x right, y down, z away.
        let tilt = 25f64.to_radians();
        let gravity = Vec3::new(0.0, tilt.cos(), tilt.sin());
        let camera = UnitQuaternion::rotation_between(&-Vec3::y(), &gravity)
            .unwrap_or_else(|| UnitQuaternion::from_axis_angle(&Vec3::x_axis(), std::f64::consts::PI));
        let mut seen = upright.clone();
        for pose in &mut seen.poses {
            pose.rotations[0] = (camera * UnitQuaternion::new(pose.rotations[0])).scaled_axis();
            pose.translation = camera * (pelvis + pose.translation) - pelvis;
        }
        let back = stood_up(seen.clone(), &(3.0 * gravity), &pelvis);
        for (a, b) in back.poses.iter().zip(&upright.poses) {
            // Heading is not known from gravity: both are the smallest rotations, there and back.
            assert!((a.translation - b.translation).norm() < 1e-12);
            let root = |p: &caphy_core::pose::Pose| UnitQuaternion::new(p.rotations[0]);
            assert!(root(a).angle_to(&root(b)) < 1e-7 && a.rotations[1..] == b.rotations[1..]);
        }
        // An axis is a direction, too.
        let along = stood_up(upright.clone(), &-Vec3::y(), &pelvis);
        assert!((along.poses[3].translation - upright.poses[3].translation).norm() < 1e-12);
        let over = stood_up(upright, &Vec3::y(), &pelvis);
        assert!(over.poses[0].translation.y < -1.5, "{}", over.poses[0].translation);
    }

    #[test]
    fn a_folder_is_its_clips_by_name_with_their_mapping() {
        let folder = tempfile::tempdir().unwrap();
        let write = |name: &str, text: &str| std::fs::write(folder.path().join(name), text).unwrap();
        std::fs::create_dir(folder.path().join("clips")).unwrap();
        write("hips.toml", MAPPING);
        // Written in another order than their names'.
        for name in ["clips/b.bvh", "clips/c.bvh", "clips/a.bvh", "clips/readme.txt"] {
            write(name, CLIP);
        }
        let files = ProjectFiles::new(folder.path());
        let motion = config("clips = [{ type = \"folder\", path = \"clips\", mapping = \"hips.toml\" }]");
        let clips = load_all(&files, &motion, &Vec3::zeros(), 1).unwrap();
        let names: Vec<_> = clips.iter().map(|c| c.clip.name.as_str()).collect();
        assert_eq!(names, ["a.bvh", "b.bvh", "c.bvh"]);
        assert_eq!((clips[0].clip.poses.len(), clips[0].source_frames), (4, 2));
        let one = config(
            "clips = [{ type = \"bvh\", path = \"clips/a.bvh\", mapping = \"hips.toml\", metres_per_unit = 0.01 }]",
        );
        let clip = &load_all(&files, &one, &Vec3::zeros(), 1).unwrap()[0].clip;
        assert!((clip.poses[3].translation - Vec3::new(0.0, 0.01, 0.005)).norm() < 1e-12);
        // Without its mapping the hips are the CMU skeleton's, whose other joints are missing.
        let wrong = config("clips = [{ type = \"folder\", path = \"clips\" }]");
        assert!(load_all(&files, &wrong, &Vec3::zeros(), 1).unwrap_err().to_string().contains("a.bvh"));
        let empty = config("clips = [{ type = \"folder\", path = \".\" }]");
        assert!(load_all(&files, &empty, &Vec3::zeros(), 1).unwrap_err().to_string().contains("no .npz"));
        assert!(load(&files, &wrong.clips[0], None, 30.0, &Vec3::zeros()).is_err());
    }
}
