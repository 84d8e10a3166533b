//! Acclaim skeletons and motion (`.asf`, `.amc`).

use super::mapping::SkeletonMapping;
use super::named_clip;
use super::retarget::{Retarget, SourceJoint, turn};
use super::text::{Lines, MOST_FRAMES, MOST_JOINTS};
use caphy_core::motion::MotionClip;
use caphy_core::{Error, Result, Vec3};
use nalgebra::UnitQuaternion;
use std::collections::HashMap;
use std::path::Path;

/// Reads a clip and retargets it to the SMPL-X joints by a mapping ([`SkeletonMapping::cmu_asf`] for the CMU database).
///
/// `fps` [1/s] is the clip's rate, which the files do not hold (CMU: 120). `pelvis` [m] is the rest pelvis of the body
/// that will be moved: its pelvis then goes where the skeleton's root goes.
///
/// # Errors
/// [`Error::Format`] naming file and line: what is no number, unknown or missing bones, wrong counts of values, a frame
/// that is cut off; [`Error::Numerics`] for a rate that is not positive.
pub fn read_asf_amc(
    asf_path: &Path,
    asf: &[u8],
    amc_path: &Path,
    amc: &[u8],
    fps: f64,
    mapping: &SkeletonMapping,
    pelvis: &Vec3,
) -> Result<MotionClip> {
    let skeleton = Skeleton::parse(asf_path, asf)?;
    let metres = mapping.metres_per_unit / skeleton.length;
    let retarget = Retarget::new(asf_path, &skeleton.source(), mapping, metres)?;
    if retarget.pelvis() != ROOT {
        return Err(Error::format(
            mapping.path(),
            "`joints`",
            "the pelvis is not the skeleton's root, whose position is the only one in an .amc",
            "map `root` to `pelvis`",
        ));
    }
    let mut poses = Vec::new();
    let mut world = vec![UnitQuaternion::identity(); skeleton.bones.len() + 1];
    read_frames(amc_path, amc, &skeleton, |frame| {
        world[ROOT] = frame.root;
        for (b, bone) in skeleton.bones.iter().enumerate() {
            // Parents stand before children: `parse` orders them by the hierarchy.
            let parent = world[bone.parent.map_or(ROOT, |p| p + 1)];
            world[b + 1] = parent * bone.axis * frame.bones[b] * bone.axis.inverse();
        }
        poses.push(retarget.pose(&world, &frame.position, pelvis));
    })?;
    named_clip(amc_path, fps, poses)
}

/// Place of the root among the joints; bones follow it.
const ROOT: usize = 0;

/// One degree of freedom: which number it is, or a length that does not turn anything.
#[derive(Clone, Copy)]
enum Channel {
    Rotation(usize),
    Translation(usize),
    Length,
}

struct Bone {
    name: String,
    parent: Option<usize>,
    /// Rest direction in the world, unit length.
    direction: Vec3,
    /// Local frame in which the channels turn.
    axis: UnitQuaternion<f64>,
    channels: Vec<Channel>,
}

struct Skeleton {
    /// In hierarchy order, parents first.
    bones: Vec<Bone>,
    index: HashMap<String, usize>,
    root_channels: Vec<Channel>,
    root_position: Vec3,
    root_axis: UnitQuaternion<f64>,
    radians: f64,
    /// Number that divides its lengths.
    length: f64,
}

/// A bone as it stands in the file, before its parent is known.
#[derive(Default)]
struct Entry {
    line: usize,
    name: String,
    direction: Option<Vec3>,
    axis: Vec3,
    order: String,
    channels: Vec<Channel>,
}

/// A turn about each axis in the order given ("XYZ": x first), angles in that order [rad].
fn turns(angles: impl IntoIterator<Item = (usize, f64)>) -> UnitQuaternion<f64> {
    angles.into_iter().fold(UnitQuaternion::identity(), |q, (axis, angle)| turn(axis, angle) * q)
}

fn channel(word: &str) -> Option<Channel> {
    let word = word.to_ascii_lowercase();
    let axis = |c: char| "xyz".find(c);
    let mut chars = word.chars();
    match (chars.next()?, chars.next().and_then(axis)) {
        ('r', Some(axis)) => Some(Channel::Rotation(axis)),
        ('t', Some(axis)) => Some(Channel::Translation(axis)),
        ('l', None) => Some(Channel::Length),
        _ => None,
    }
}

impl Skeleton {
    fn parse(path: &Path, bytes: &[u8]) -> Result<Self> {
        let lines = Lines::new(path, bytes, Some('#'));
        let mut section = String::new();
        let mut radians = None;
        let mut length = None;
        let mut root_channels = Vec::new();
        let (mut root_position, mut root_angles, mut root_order) = (Vec3::zeros(), Vec3::zeros(), "XYZ".to_string());
        let mut entries: Vec<Entry> = Vec::new();
        let mut open = None;
        let mut links: Vec<(usize, String, String)> = Vec::new();
        for (line, words) in lines.iter() {
            let first = words[0];
            if first.starts_with(':') {
                section = first.to_ascii_lowercase();
                continue;
            }
            let channels = |words: &[&str]| -> Result<Vec<Channel>> {
                let known = |w: &&str| channel(w).ok_or_else(|| lines.bad(line, format!("unknown channel `{w:.40}`")));
                words.iter().map(known).collect()
            };
            match (section.as_str(), first) {
                (":units", "length") => length = Some(lines.number(line, words.get(1).unwrap_or(&""))?),
                (":units", "angle") => {
                    radians = match words.get(1) {
                        Some(&"deg") => Some(std::f64::consts::PI / 180.0),
                        Some(&"rad") => Some(1.0),
                        other => return Err(lines.bad(line, format!("angle unit {other:?}, not deg or rad"))),
                    }
                }
                (":root", "order") => root_channels = channels(&words[1..])?,
                (":root", "axis") => root_order = words.get(1).unwrap_or(&"").to_string(),
                (":root", "position") => root_position = lines.three(line, &words)?,
                (":root", "orientation") => root_angles = lines.three(line, &words)?,
                (":bonedata", "begin") => open = Some(Entry { line, ..Entry::default() }),
                (":bonedata", "end") => {
                    entries.extend(open.take());
                    if entries.len() > MOST_JOINTS {
                        return Err(lines.bad(line, format!("more than {MOST_JOINTS} bones")));
                    }
                }
                (":bonedata", key) => {
                    let Some(bone) = &mut open else {
                        return Err(lines.bad(line, format!("`{key:.40}` outside begin and end")));
                    };
                    match key {
                        "name" => bone.name = words.get(1).unwrap_or(&"").to_string(),
                        "direction" => bone.direction = lines.three(line, &words)?.try_normalize(1e-9),
                        "axis" => {
                            bone.axis = lines.three(line, &words)?;
                            bone.order = words.get(4).unwrap_or(&"XYZ").to_string();
                        }
                        "dof" => bone.channels = channels(&words[1..])?,
                        // Length and limits do not matter for a retarget of directions.
                        _ => {}
                    }
                }
                (":hierarchy", "begin" | "end") => {}
                (":hierarchy", parent) => {
                    links.extend(words[1..].iter().map(|child| (line, parent.to_string(), child.to_string())));
                }
                _ => {}
            }
        }
        let missing = |what: &str| {
            Error::format(path, "whole file", format!("no {what}"), "the file is damaged or no skeleton: get it again")
        };
        let radians = radians.ok_or_else(|| missing("angle unit"))?;
        let length = length.filter(|&l| l > 0.0).ok_or_else(|| missing("positive length unit"))?;
        if open.is_some() || root_channels.is_empty() || entries.is_empty() {
            return Err(missing("complete :root and :bonedata"));
        }
        let frame = |line: usize, order: &str, angles: Vec3| -> Result<UnitQuaternion<f64>> {
            let axes: Vec<usize> = order.to_ascii_lowercase().chars().filter_map(|c| "xyz".find(c)).collect();
            if axes.len() != 3 || order.len() != 3 {
                return Err(lines.bad(line, format!("axis order `{order:.40}`, not like XYZ")));
            }
            Ok(turns(axes.into_iter().zip(angles.iter().map(|a| a * radians))))
        };
        let mut skeleton = Self {
            bones: Vec::with_capacity(entries.len()),
            index: HashMap::new(),
            root_channels,
            root_position,
            root_axis: frame(0, &root_order, root_angles)?,
            radians,
            length,
        };
        let by_name: HashMap<&str, &Entry> = entries.iter().map(|e| (e.name.as_str(), e)).collect();
        for (line, parent, child) in &links {
            let parent =
                match parent.as_str() {
                    "root" => None,
                    name => Some(*skeleton.index.get(name).ok_or_else(|| {
                        lines.bad(*line, format!("`{name:.40}` has children before it has a parent"))
                    })?),
                };
            let entry = by_name
                .get(child.as_str())
                .ok_or_else(|| lines.bad(*line, format!("bone `{child:.40}` is not in :bonedata")))?;
            if skeleton.index.insert(child.clone(), skeleton.bones.len()).is_some() {
                return Err(lines.bad(*line, format!("bone `{child:.40}` has two parents")));
            }
            let direction =
                entry.direction.ok_or_else(|| lines.bad(entry.line, format!("bone `{child:.40}` has no direction")))?;
            let axis = frame(entry.line, if entry.order.is_empty() { "XYZ" } else { &entry.order }, entry.axis)?;
            let (name, channels) = (child.clone(), entry.channels.clone());
            skeleton.bones.push(Bone { name, parent, direction, axis, channels });
        }
        Ok(skeleton)
    }
    /// The root and the bones, in the order of world rotations.
    fn source(&self) -> Vec<SourceJoint> {
        let root = SourceJoint { name: "root".into(), direction: None };
        let bones = self.bones.iter().map(|b| SourceJoint { name: b.name.clone(), direction: Some(b.direction) });
        [root].into_iter().chain(bones).collect()
    }
}

struct Frame {
    /// Root position [file's length unit].
    position: Vec3,
    /// Root rotation in the world.
    root: UnitQuaternion<f64>,
    /// Rotation of each bone in its own axes.
    bones: Vec<UnitQuaternion<f64>>,
}

/// Hands each complete frame to `take`.
fn read_frames(path: &Path, bytes: &[u8], skeleton: &Skeleton, mut take: impl FnMut(&Frame)) -> Result<()> {
    let lines = Lines::new(path, bytes, Some('#'));
    let mut radians = skeleton.radians;
    let rest = || Frame {
        position: Vec3::zeros(),
        root: UnitQuaternion::identity(),
        bones: vec![UnitQuaternion::identity(); skeleton.bones.len()],
    };
    let mut open: Option<Frame> = None;
    let mut count = 0;
    // Which bones the first frame gives; every other must give the same, else it is cut off.
    let mut given_first: Option<usize> = None;
    let mut given = vec![false; skeleton.bones.len() + 1];
    let complete = |given: &[bool], first: &mut Option<usize>, line: usize| -> Result<()> {
        let count = given.iter().filter(|&&g| g).count();
        if !given.last().copied().unwrap_or(false) {
            return Err(lines.bad(line, "the frame before this line has no `root`"));
        }
        match *first.get_or_insert(count) {
            f if f == count => Ok(()),
            f => Err(lines.bad(line, format!("the frame before this line gives {count} bones, the first gives {f}"))),
        }
    };
    let mut last_line = 0;
    for (line, words) in lines.iter() {
        last_line = line;
        if words[0].starts_with(':') {
            match words[0].to_ascii_uppercase().as_str() {
                ":DEGREES" => radians = std::f64::consts::PI / 180.0,
                ":RADIANS" => radians = 1.0,
                _ => {}
            }
            continue;
        }
        if let [number] = words.as_slice()
            && number.bytes().all(|b| b.is_ascii_digit())
        {
            if let Some(frame) = &open {
                complete(&given, &mut given_first, line)?;
                take(frame);
            }
            count += 1;
            if count > MOST_FRAMES {
                return Err(lines.bad(line, format!("more than {MOST_FRAMES} frames")));
            }
            given.fill(false);
            open = Some(rest());
            continue;
        }
        let Some(frame) = &mut open else {
            return Err(lines.bad(line, format!("`{:.40}` before the first frame number", words[0])));
        };
        let bone = match words[0] {
            "root" => None,
            name => Some(*skeleton.index.get(name).ok_or_else(|| {
                Error::format(
                    path,
                    format!("line {line}"),
                    format!("bone `{name:.40}` is not in the skeleton"),
                    "use the .asf of the same subject",
                )
            })?),
        };
        let channels = bone.map_or(&skeleton.root_channels, |b| &skeleton.bones[b].channels);
        if channels.len() != words.len() - 1 {
            let problem = format!("`{:.40}` has {} values, its skeleton {}", words[0], words.len() - 1, channels.len());
            return Err(lines.bad(line, problem));
        }
        let mut angles = Vec::with_capacity(3);
        let mut position = skeleton.root_position;
        for (channel, word) in channels.iter().zip(&words[1..]) {
            let value = lines.number(line, word)?;
            match *channel {
                Channel::Rotation(axis) => angles.push((axis, value * radians)),
                Channel::Translation(axis) => position[axis] += value,
                Channel::Length => {}
            }
        }
        match bone {
            Some(b) => frame.bones[b] = turns(angles),
            None => {
                frame.position = position;
                frame.root = skeleton.root_axis * turns(angles);
            }
        }
        if let Some(slot) = given.get_mut(bone.unwrap_or(skeleton.bones.len())) {
            *slot = true;
        }
    }
    let Some(frame) = &open else {
        return Err(lines.bad(last_line, "no frames"));
    };
    complete(&given, &mut given_first, last_line)?;
    take(frame);
    Ok(())
}
