//! Biovision hierarchies (`.bvh`): a skeleton and its motion in one file.

use super::mapping::SkeletonMapping;
use super::named_clip;
use super::retarget::{Retarget, SourceJoint, turn};
use super::text::{Lines, MOST_FRAMES, MOST_JOINTS};
use caphy_core::motion::MotionClip;
use caphy_core::{Error, Result, Vec3};
use nalgebra::UnitQuaternion;
use std::collections::VecDeque;
use std::path::Path;

/// Reads a clip and retargets it to the SMPL-X joints by a mapping.
///
/// Rotations are in degrees, in any order, the first channel outermost (`Zrotation Yrotation Xrotation` is Rz Ry Rx);
/// position channels may stand at any joint and replace its OFFSET, component by component; joints without channels stay
/// as they rest. Lengths are the file's own: the mapping says how many metres they are. `pelvis` [m] is the rest pelvis of
/// the body that will be moved: its pelvis then goes where the joint that is mapped to it goes.
///
/// # Errors
/// [`Error::Format`] naming file, line and joint: broken hierarchy, unknown channels, doubled or missing joints, no frames,
/// a frame time that is not positive, frames that are cut off, too long or not numbers, more frames than the file can hold.
pub fn read_bvh(path: &Path, bytes: &[u8], mapping: &SkeletonMapping, pelvis: &Vec3) -> Result<MotionClip> {
    let lines = Lines::new(path, bytes, None);
    let mut words = Words::new(&lines);
    let hierarchy = Hierarchy::parse(&lines, &mut words)?;
    let retarget = Retarget::new(path, &hierarchy.source(), mapping, mapping.metres_per_unit)?;
    let header = Header::parse(&lines, &mut words, hierarchy.channel_count)?;
    let mut frames = Frames::new(&hierarchy);
    let mut poses = Vec::with_capacity(header.frames);
    for (line, row) in words.rows() {
        if poses.len() == header.frames {
            let problem = format!("a row after the {} frames that are declared", header.frames);
            return Err(lines.bad(line, problem));
        }
        frames.read(&lines, line, &row, poses.len())?;
        poses.push(retarget.pose(&frames.rotations, &frames.positions[retarget.pelvis()], pelvis));
    }
    if poses.len() < header.frames {
        let problem = format!("{} frames, {} are declared", poses.len(), header.frames);
        return Err(lines.bad_at("end of the file".into(), problem));
    }
    named_clip(path, 1.0 / header.frame_time, poses)
}

/// What one number of a row does.
#[derive(Clone, Copy)]
enum Channel {
    Position(usize),
    Rotation(usize),
}

impl Channel {
    fn parse(word: &str) -> Option<Self> {
        let lower = word.to_ascii_lowercase();
        let axis = |letters: &str| "xyz".find(letters).filter(|_| letters.len() == 1);
        if let Some(axis) = lower.strip_suffix("position").and_then(axis) {
            return Some(Self::Position(axis));
        }
        lower.strip_suffix("rotation").and_then(axis).map(Self::Rotation)
    }
}

struct Joint {
    name: String,
    parent: Option<usize>,
    offset: Vec3,
    channels: Vec<Channel>,
}

struct Hierarchy {
    /// Parents first.
    joints: Vec<Joint>,
    /// Joint and offset of the end sites.
    ends: Vec<(usize, Vec3)>,
    channel_count: usize,
}

/// An open brace.
#[derive(Clone, Copy)]
enum Open {
    Joint(usize),
    End(usize),
}

impl Hierarchy {
    /// Reads up to and with the word MOTION.
    fn parse(lines: &Lines<'_>, words: &mut Words<'_>) -> Result<Self> {
        let mut out = Self { joints: Vec::new(), ends: Vec::new(), channel_count: 0 };
        // What is known of the joint of each open brace: its OFFSET, its CHANNELS.
        let mut open: Vec<(Open, bool, bool)> = Vec::new();
        let (line, word) = words.expect(lines, "HIERARCHY")?;
        if !word.eq_ignore_ascii_case("HIERARCHY") {
            return Err(lines.bad(line, format!("`{word:.40}` instead of HIERARCHY")));
        }
        loop {
            let (line, word) = words.expect(lines, "MOTION")?;
            let at = |out: &Self| match open.last() {
                Some(&(Open::Joint(j), ..)) => format!("line {line}, joint `{}`", out.joints[j].name),
                Some(&(Open::End(j), ..)) => format!("line {line}, end site of joint `{}`", out.joints[j].name),
                None => format!("line {line}"),
            };
            match (word.to_ascii_uppercase().as_str(), open.last().copied()) {
                ("MOTION", None) if !out.joints.is_empty() => return Ok(out),
                ("ROOT", None) => open.push((out.begin(lines, words, line, None)?, false, false)),
                ("JOINT", Some((Open::Joint(parent), ..))) => {
                    open.push((out.begin(lines, words, line, Some(parent))?, false, false));
                }
                ("END", Some((Open::Joint(parent), ..))) => {
                    // "End Site", at times with a name.
                    words.name(lines, line)?;
                    open.push((Open::End(parent), false, false));
                }
                ("OFFSET", Some((what, false, _))) => {
                    let mut offset = Vec3::zeros();
                    for x in offset.iter_mut() {
                        let (line, word) = words.expect(lines, "three numbers of an OFFSET")?;
                        *x = lines.number(line, word).map_err(|_| {
                            lines.bad_at(at(&out), format!("OFFSET holds `{word:.40}`, which is no finite number"))
                        })?;
                    }
                    match what {
                        Open::Joint(j) => out.joints[j].offset = offset,
                        Open::End(j) => out.ends.push((j, offset)),
                    }
                    if let Some(last) = open.last_mut() {
                        last.1 = true;
                    }
                }
                ("CHANNELS", Some((Open::Joint(j), _, false))) => {
                    let (_, count) = words.expect(lines, "a number of CHANNELS")?;
                    let count = count.parse::<usize>().ok().filter(|&n| n <= 12).ok_or_else(|| {
                        lines.bad_at(at(&out), format!("`{count:.40}` channels, a joint has at most 12"))
                    })?;
                    for _ in 0..count {
                        let (_, word) = words.expect(lines, "names of CHANNELS")?;
                        let channel = Channel::parse(word).ok_or_else(|| {
                            lines.bad_at(at(&out), format!("unknown channel `{word:.40}` among {count} channels"))
                        })?;
                        out.joints[j].channels.push(channel);
                    }
                    out.channel_count += count;
                    if let Some(last) = open.last_mut() {
                        last.2 = true;
                    }
                }
                ("}", Some((_, true, _))) => drop(open.pop()),
                ("}", Some(_)) => return Err(lines.bad_at(at(&out), "closes without an OFFSET")),
                _ => return Err(lines.bad_at(at(&out), format!("`{word:.40}` does not belong here"))),
            }
        }
    }

    fn begin(&mut self, lines: &Lines<'_>, words: &mut Words<'_>, line: usize, parent: Option<usize>) -> Result<Open> {
        let name = words.name(lines, line)?;
        if name.is_empty() {
            return Err(lines.bad(line, "a joint without a name"));
        }
        if self.joints.len() == MOST_JOINTS {
            return Err(lines.bad(line, format!("more than {MOST_JOINTS} joints")));
        }
        if self.joints.iter().any(|j| j.name == name) {
            return Err(Error::format(
                lines.path(),
                format!("line {line}, joint `{name}`"),
                "the name stands twice in the hierarchy",
                "rename one of the two",
            ));
        }
        self.joints.push(Joint { name, parent, offset: Vec3::zeros(), channels: Vec::new() });
        Ok(Open::Joint(self.joints.len() - 1))
    }

    /// Names and rest directions: towards the first child at a distance, or that child's first.
    fn source(&self) -> Vec<SourceJoint> {
        let mut directions: Vec<Option<Vec3>> = vec![None; self.joints.len()];
        for &(joint, offset) in self.ends.iter().rev() {
            directions[joint] = offset.try_normalize(1e-9).or(directions[joint]);
        }
        // Children stand behind their parents; the first of them is met last.
        for j in (0..self.joints.len()).rev() {
            let joint = &self.joints[j];
            if let Some(parent) = joint.parent {
                directions[parent] = joint.offset.try_normalize(1e-9).or(directions[j]).or(directions[parent]);
            }
        }
        self.joints
            .iter()
            .zip(directions)
            .map(|(joint, direction)| SourceJoint { name: joint.name.clone(), direction })
            .collect()
    }
}

struct Header {
    frames: usize,
    /// Time between frames [s].
    frame_time: f64,
}

impl Header {
    /// `Frames: n` and `Frame Time: t`, checked against what the file can hold.
    fn parse(lines: &Lines<'_>, words: &mut Words<'_>, channels: usize) -> Result<Self> {
        if channels == 0 {
            return Err(lines.bad_at("hierarchy".into(), "no joint has channels, so nothing can move"));
        }
        let (line, text) = words.value(lines, &["Frames:"])?;
        let frames = text.parse::<usize>().map_err(|_| lines.bad(line, format!("`{text:.40}` frames")))?;
        if frames == 0 {
            let remedy = "give a clip of at least one frame";
            return Err(Error::format(lines.path(), format!("line {line}"), "declares no frames", remedy));
        }
        // A number takes at least a digit and a blank: no memory on the word of the header alone.
        let most = (lines.len() / (2 * channels) + 1).min(MOST_FRAMES);
        if frames > most {
            let problem = format!("declares {frames} frames of {channels} channels, the file can hold {most}");
            return Err(lines.bad(line, problem));
        }
        let (line, text) = words.value(lines, &["Frame", "Time:"])?;
        let frame_time = lines.number(line, text)?;
        if !(frame_time > 0.0 && (1.0 / frame_time).is_finite()) {
            let problem = format!("frame time {frame_time} s");
            return Err(Error::format(lines.path(), format!("line {line}"), problem, "it must be positive"));
        }
        Ok(Self { frames, frame_time })
    }
}

/// The frame that is being read.
struct Frames<'a> {
    hierarchy: &'a Hierarchy,
    /// World rotation of each joint.
    rotations: Vec<UnitQuaternion<f64>>,
    /// World position of each joint [file's unit].
    positions: Vec<Vec3>,
}

impl<'a> Frames<'a> {
    fn new(hierarchy: &'a Hierarchy) -> Self {
        let count = hierarchy.joints.len();
        Self { hierarchy, rotations: vec![UnitQuaternion::identity(); count], positions: vec![Vec3::zeros(); count] }
    }
    fn read(&mut self, lines: &Lines<'_>, line: usize, row: &[&str], frame: usize) -> Result<()> {
        if row.len() != self.hierarchy.channel_count {
            let problem = format!("{} values, the hierarchy has {} channels", row.len(), self.hierarchy.channel_count);
            return Err(lines.bad_at(format!("line {line}, frame {frame}"), problem));
        }
        let mut row = row.iter();
        for (j, joint) in self.hierarchy.joints.iter().enumerate() {
            let (mut position, mut rotation) = (joint.offset, UnitQuaternion::identity());
            for (channel, word) in joint.channels.iter().zip(row.by_ref()) {
                let value = lines.number(line, word).map_err(|_| {
                    let at = format!("line {line}, frame {frame}, joint `{}`", joint.name);
                    lines.bad_at(at, format!("`{word:.40}` is no finite number"))
                })?;
                match *channel {
                    Channel::Position(axis) => position[axis] = value,
                    Channel::Rotation(axis) => rotation *= turn(axis, value.to_radians()),
                }
            }
            let (above, origin) = match joint.parent {
                Some(p) => (self.rotations[p], self.positions[p]),
                None => (UnitQuaternion::identity(), Vec3::zeros()),
            };
            self.rotations[j] = above * rotation;
            self.positions[j] = origin + above * position;
        }
        Ok(())
    }
}

/// The words of the hierarchy and the header one by one, then whole rows. Braces are words of their own.
struct Words<'a> {
    lines: Box<dyn Iterator<Item = (usize, Vec<&'a str>)> + 'a>,
    line: usize,
    words: VecDeque<&'a str>,
}

impl<'a> Words<'a> {
    fn new(lines: &'a Lines<'_>) -> Self {
        Self { lines: Box::new(lines.iter()), line: 0, words: VecDeque::new() }
    }
    fn next(&mut self) -> Option<(usize, &'a str)> {
        while self.words.is_empty() {
            let (line, words) = self.lines.next()?;
            self.line = line;
            for word in words {
                for part in word.split_inclusive(['{', '}']) {
                    let name = part.trim_end_matches(['{', '}']);
                    self.words.extend([name, &part[name.len()..]].into_iter().filter(|w| !w.is_empty()));
                }
            }
        }
        self.words.pop_front().map(|word| (self.line, word))
    }
    fn expect(&mut self, lines: &Lines<'_>, what: &str) -> Result<(usize, &'a str)> {
        self.next().ok_or_else(|| lines.bad_at("end of the file".into(), format!("{what} is missing")))
    }
    /// The words up to an opening brace: a name, which may hold blanks but ends with its line.
    fn name(&mut self, lines: &Lines<'_>, line: usize) -> Result<String> {
        let mut name: Vec<&str> = Vec::new();
        loop {
            let (at, word) = self.expect(lines, "`{`")?;
            match word {
                "{" => return Ok(name.join(" ")),
                _ if at == line && word != "}" => name.push(word),
                _ => return Err(lines.bad(at, format!("`{word:.40}` instead of `{{` after `{:.40}`", name.join(" ")))),
            }
        }
    }
    /// The word behind a label, which may touch it: "Frames: 12", "Frames:12".
    fn value(&mut self, lines: &Lines<'_>, label: &[&str]) -> Result<(usize, &'a str)> {
        let whole = label.join(" ");
        for (i, part) in label.iter().enumerate() {
            let (line, word) = self.expect(lines, &format!("`{whole}`"))?;
            let head = word.get(..part.len()).filter(|head| head.eq_ignore_ascii_case(part));
            match (head, &word[head.map_or(0, str::len)..]) {
                (Some(_), "") => {}
                (Some(_), value) if i + 1 == label.len() => return Ok((line, value)),
                _ => return Err(lines.bad(line, format!("`{word:.40}` instead of `{whole}`"))),
            }
        }
        self.expect(lines, &format!("the value of `{whole}`"))
    }
    /// Line and words of what remains, row by row.
    fn rows(self) -> impl Iterator<Item = (usize, Vec<&'a str>)> {
        let rest = (!self.words.is_empty()).then(|| (self.line, Vec::from(self.words)));
        rest.into_iter().chain(self.lines)
    }
}
