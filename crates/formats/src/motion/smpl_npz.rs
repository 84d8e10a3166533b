//! Parameters of SMPL, SMPL-H and SMPL-X bodies per frame in `.npz`: AMASS, and what video trackers write.

use super::axes::UpAxis;
use super::named_clip;
use super::text::MOST_FRAMES;
use crate::npz::Npz;
use caphy_core::motion::MotionClip;
use caphy_core::pose::{Pose, SMPLX_JOINTS};
use caphy_core::{Error, Result, Vec3};
use nalgebra::{Matrix3, Rotation3, UnitQuaternion};
use std::path::Path;

/// What the translation of a file means.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TranslationMeaning {
    /// Where the pelvis is [m]: clips retargeted from ASF/AMC or BVH.
    PelvisPosition,
    /// What is added to the posed body [m]: clips fitted with a body model, AMASS's own and trackers'.
    BodyOffset,
}

/// What the files do not say.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SmplNpzOptions {
    /// Upward axis of their world.
    pub up: UpAxis,
    /// Meaning of their translation.
    pub translation: TranslationMeaning,
    /// Frame rate [1/s]; wins over the file's own.
    pub fps: Option<f64>,
}

impl SmplNpzOptions {
    /// AMASS: z up, the file says its rate.
    pub fn amass(translation: TranslationMeaning) -> Self {
        Self { up: UpAxis::Z, translation, fps: None }
    }
}

/// Names of the frame rate: the two of AMASS, and the plain one.
const RATES: [&str; 3] = ["mocap_framerate", "mocap_frame_rate", "fps"];
/// Names of the translation: AMASS's and the `smplx` package's.
const TRANSLATIONS: [&str; 2] = ["trans", "transl"];

/// Which SMPL-X joints the rotations of an array move, one group per rotation.
type Targets = Vec<Vec<usize>>;

/// Single joints.
fn joints(range: std::ops::Range<usize>) -> Targets {
    range.map(|j| vec![j]).collect()
}

/// SMPL's two hands turn as a whole at the knuckles: the first joints of the four fingers do.
fn smpl_hands() -> Targets {
    [25, 40].map(|first| [0, 3, 6, 9].map(|finger| first + finger).to_vec()).to_vec()
}

/// Layouts of one array with everything, by its number of rotations: SMPL-H's body and hands without a face, SMPL-X, SMPL,
/// and a body without hands.
fn whole_body(rotations: usize) -> Option<Targets> {
    match rotations {
        22 => Some(joints(0..22)),
        24 => Some([joints(0..22), smpl_hands()].concat()),
        52 => Some([joints(0..22), joints(25..55)].concat()),
        55 => Some(joints(0..55)),
        _ => None,
    }
}

/// One part of the pose in an array of its own.
struct Part {
    /// Its names: AMASS's and the `smplx` package's.
    names: &'static [&'static str],
    /// Layouts by number of rotations.
    layouts: Vec<Targets>,
    required: bool,
}

/// The parts of SMPL-X and SMPL; two names of one part are alternatives.
fn parts() -> Vec<Part> {
    let part = |names, layouts, required| Part { names, layouts, required };
    vec![
        part(&["root_orient", "global_orient"], vec![joints(0..1)], true),
        part(&["pose_body", "body_pose"], vec![joints(1..22), [joints(1..22), smpl_hands()].concat()], true),
        part(&["pose_jaw", "jaw_pose"], vec![joints(22..23)], false),
        part(&["pose_eye"], vec![joints(23..25)], false),
        part(&["leye_pose"], vec![joints(23..24)], false),
        part(&["reye_pose"], vec![joints(24..25)], false),
        part(&["pose_hand"], vec![joints(25..55)], false),
        part(&["left_hand_pose"], vec![joints(25..40)], false),
        part(&["right_hand_pose"], vec![joints(40..55)], false),
    ]
}

/// Reads a clip of body parameters, in any number type.
///
/// Poses [rad]: one array `poses`, axis-angle per joint, of SMPL-X (165 numbers per frame), SMPL-H (156), SMPL (72) or a body
/// without hands (66); or its parts by AMASS's names (`root_orient`, `pose_body`, `pose_hand`, `pose_jaw`, `pose_eye`) or the
/// `smplx` package's (`global_orient`, `body_pose`, `left_hand_pose`, `right_hand_pose`, `jaw_pose`, `leye_pose`, `reye_pose`),
/// of which root and body are needed and others rest. Each may hold rotation matrices (last axes 3, 3) instead. Translation [m]:
/// `trans` or `transl`, shape [frames, 3]. Rate [1/s]: `mocap_framerate`, `mocap_frame_rate` or `fps`.
///
/// SMPL-H's hands go to SMPL-X's; SMPL's hands, which turn as a whole, to the first joints of the fingers. The world turns from
/// [`SmplNpzOptions::up`] to y up. With [`TranslationMeaning::PelvisPosition`], a body with its rest pelvis at `pelvis` [m]
/// has its pelvis where the file says; with [`TranslationMeaning::BodyOffset`], `pelvis` should be the rest pelvis of the body
/// that the clip was fitted with (y up): that of another body moves the whole clip by one constant step.
///
/// # Errors
/// [`Error::Format`]: missing arrays, unknown widths, hands as PCA coefficients, unequal frame counts, values that are not finite,
/// matrices that do not rotate, no frames, more than two million, no positive rate.
pub fn read_smpl_npz(path: &Path, bytes: Vec<u8>, options: &SmplNpzOptions, pelvis: &Vec3) -> Result<MotionClip> {
    let npz = Npz::from_bytes(path, bytes)?;
    let bad = |at: &str, problem: String, remedy: &str| Error::format(path, at, problem, remedy);
    let one_of = |names: &[&'static str]| names.iter().copied().find(|n| npz.has(n));
    let missing = |what: &str, names: &[&str], remedy: &str| {
        let problem = format!("no {what}: none of {} among {}", names.join(", "), npz.names().join(", "));
        bad("whole file", problem, remedy)
    };

    let mut arrays = Vec::new();
    if npz.has("poses") {
        arrays.push(Rotations::read(
            path,
            &npz,
            "poses",
            &[22, 24, 52, 55].map(whole_body).into_iter().flatten().collect::<Vec<_>>(),
        )?);
    } else {
        for part in parts() {
            match one_of(part.names) {
                Some(name) => arrays.push(Rotations::read(path, &npz, name, &part.layouts)?),
                None if part.required => {
                    let names = [&["poses"], part.names].concat();
                    return Err(missing("pose", &names, "give a file of SMPL, SMPL-H or SMPL-X parameters"));
                }
                None => {}
            }
        }
    }
    let name = one_of(&TRANSLATIONS).ok_or_else(|| {
        missing("translation", &TRANSLATIONS, "add zeros, shape [frames, 3], for a person who stays in place")
    })?;
    let trans = npz.f64s(name)?;
    let frames = arrays.first().map_or(0, |a| a.frames);
    if trans.shape != [frames, 3] && trans.shape != [frames, 1, 3] {
        let problem = format!("has shape {:?}, the poses have {frames} frames", trans.shape);
        return Err(bad(&format!("array `{name}`"), problem, "[frames, 3] is needed"));
    }
    if let Some(other) = arrays.iter().find(|a| a.frames != frames) {
        let problem = format!("has {} frames, array `{}` has {frames}", other.frames, arrays[0].name);
        return Err(bad(&format!("array `{}`", other.name), problem, "all must have the same number"));
    }
    check_finite(path, name, &trans.data, 3)?;
    if frames == 0 || frames > MOST_FRAMES {
        let remedy = format!("give a clip of 1 to {MOST_FRAMES} frames");
        return Err(bad("whole file", format!("has {frames} frames"), &remedy));
    }
    let fps = match options.fps {
        Some(fps) => fps,
        None => {
            let name =
                one_of(&RATES).ok_or_else(|| missing("frame rate", &RATES, "add it, or set the clip's `fps`"))?;
            let fps = npz.f64_scalar(name)?;
            if !(fps.is_finite() && fps > 0.0) {
                return Err(bad(&format!("array `{name}`"), format!("frame rate {fps} 1/s"), "it must be positive"));
            }
            fps
        }
    };

    let upright = options.up.to_y_up().to_rotation_matrix();
    let poses = trans
        .data
        .chunks_exact(3)
        .enumerate()
        .map(|(frame, place)| {
            let mut pose = Pose::rest(SMPLX_JOINTS.len());
            arrays.iter().for_each(|array| array.put(frame, &mut pose));
            pose.translation = Vec3::from_column_slice(place);
            match options.translation {
                TranslationMeaning::PelvisPosition => {
                    pose.rotate_world(&upright, &Vec3::zeros());
                    pose.translation -= pelvis;
                }
                TranslationMeaning::BodyOffset => pose.rotate_world(&upright, pelvis),
            }
            pose
        })
        .collect();
    named_clip(path, fps, poses)
}

/// Rotations of some joints over all frames.
struct Rotations {
    name: &'static str,
    frames: usize,
    targets: Targets,
    /// Axis-angle [rad], shape [frames, targets].
    vectors: Vec<Vec3>,
}

impl Rotations {
    fn read(path: &Path, npz: &Npz, name: &'static str, layouts: &[Targets]) -> Result<Self> {
        let array = npz.f64s(name)?;
        let bad = |at: String, problem: String, remedy: String| Error::format(path, at, problem, remedy);
        let (frames, rest) = array.shape.split_first().map_or((0, &[][..]), |(frames, rest)| (*frames, rest));
        // The reader has checked that the product fits.
        let width: usize = if array.shape.is_empty() { 0 } else { rest.iter().product() };
        let matrices = rest.ends_with(&[3, 3]);
        let size = |layout: &&Targets| width == 3 * layout.len() || (matrices && width == 9 * layout.len());
        let Some(targets) = layouts.iter().find(size) else {
            let widths: Vec<String> = layouts.iter().map(|l| (3 * l.len()).to_string()).collect();
            let mut remedy =
                format!("[frames, {}] of axis-angle rotations are read, and matrices", widths.join(" or "));
            if name.ends_with("hand_pose") {
                remedy += "; PCA coefficients of hands must be expanded (smplx: use_pca=False)";
            }
            return Err(bad(format!("array `{name}`"), format!("has shape {:?}", array.shape), remedy));
        };
        let targets = targets.clone();
        check_finite(path, name, &array.data, width)?;
        let vectors = if width == 3 * targets.len() {
            array.data.chunks_exact(3).map(Vec3::from_column_slice).collect()
        } else {
            let rotation = |(i, values): (usize, &[f64])| {
                let m = Matrix3::from_row_slice(values);
                // Half precision and networks' own rounding pass.
                let bounded = values.iter().all(|x| x.abs() < 2.0);
                if !bounded || (m.transpose() * m - Matrix3::identity()).amax() > 1e-2 || m.determinant() < 0.0 {
                    let at = format!("array `{name}`, frame {}, rotation {}", i / targets.len(), i % targets.len());
                    return Err(bad(at, format!("{values:.3?} is no rotation"), "give proper rotations".into()));
                }
                Ok(UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(m)).scaled_axis())
            };
            array.data.chunks_exact(9).enumerate().map(rotation).collect::<Result<_>>()?
        };
        Ok(Self { name, frames, targets, vectors })
    }
    fn put(&self, frame: usize, pose: &mut Pose) {
        for (joints, vector) in self.targets.iter().zip(&self.vectors[frame * self.targets.len()..]) {
            joints.iter().for_each(|&j| pose.rotations[j] = *vector);
        }
    }
}

fn check_finite(path: &Path, name: &str, values: &[f64], columns: usize) -> Result<()> {
    match values.iter().position(|x| !x.is_finite()) {
        None => Ok(()),
        Some(i) => Err(Error::format(
            path,
            format!("array `{name}`, frame {}", i / columns.max(1)),
            format!("column {} is {}", i % columns.max(1), values[i]),
            "repair or cut the clip",
        )),
    }
}
