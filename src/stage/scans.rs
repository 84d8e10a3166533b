//! Folders of scans: which files they are, what unit and axis they have, and what speaks against using one.

use super::{ScanFile, Scans, split};
use crate::artifact;
use crate::config::{LengthUnit, ScansConfig, SubjectConfig};
use crate::files::ProjectFiles;
use caphy_bodymodel::registration::find_up;
use caphy_core::body::BodyModel;
use caphy_core::files::Files;
use caphy_core::pose::Pose;
use caphy_core::scan::{Label, LabelledPoints, Scan};
use caphy_core::{Error, Result, Vec3};
use caphy_formats::motion::UpAxis;
use caphy_formats::npz::Npz;
use caphy_formats::scan::{SCAN_ENDINGS, read_scan, texture_files};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Largest extents that a standing, sitting or stretched person's scan can have [m]: a small child to a tall adult.
const PERSON: (f64, f64) = (0.5, 3.0);

/// How positions of a file become metres with y up.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ScanFrame {
    /// Metres per unit of the file.
    pub metres_per_unit: f64,
    /// The file's axis that points up.
    pub up: UpAxis,
}

impl ScanFrame {
    /// Metres, y up: what caphy writes itself.
    pub const OWN: Self = Self { metres_per_unit: 1.0, up: UpAxis::Y };

    fn apply(&self, scan: &mut Scan) {
        // Nothing is rounded where nothing changes.
        if *self == Self::OWN {
            return;
        }
        let turn = self.up.to_y_up();
        scan.mesh.vertices.iter_mut().for_each(|p| *p = turn * (*p * self.metres_per_unit));
    }
}

/// Scans of a user's folder.
///
/// # Errors
/// [`Error::Config`] for a folder without scans, two files of one name, a named scan that is not there, none to learn from.
pub fn scan_list(files: &ProjectFiles, config: &ScansConfig, seed: u64) -> Result<Scans> {
    let paths = files.list(&config.folder, &SCAN_ENDINGS)?;
    let mut list = Vec::new();
    for path in paths {
        let name = path.file_stem().unwrap_or_default().to_string_lossy().to_string();
        if let Some(ScanFile { path: other, .. }) = list.iter().find(|s: &&ScanFile| s.name == name) {
            return Err(Error::config(
                "subject.folder",
                format!("{} and {} are both scan `{name}`", other.display(), path.display()),
                "rename or move one of them",
            ));
        }
        list.push(ScanFile { name, path, held_out: false, content: None });
    }
    if list.is_empty() {
        return Err(Error::config(
            "subject.folder",
            format!("{} holds no scan (*.ply, *.obj)", config.folder.display()),
            "give a folder with at least one scan that is not held out",
        ));
    }
    if !config.only.is_empty() {
        if let Some(missing) = config.only.iter().find(|name| !list.iter().any(|s| s.name == **name)) {
            let there: Vec<&str> = list.iter().map(|s| s.name.as_str()).collect();
            let remedy = format!("there are: {}", there.join(", "));
            return Err(Error::config("subject.only", format!("there is no scan `{missing}`"), remedy));
        }
        list.retain(|scan| config.only.contains(&scan.name));
    }
    let names: Vec<String> = list.iter().map(|s| s.name.clone()).collect();
    let held = split::held_out(&names, &config.held_out, seed)?;
    list.iter_mut().zip(held).for_each(|(scan, held)| scan.held_out = held);
    Ok(Scans { list, truth: None })
}

/// Hash of one scan's files: itself, its materials and textures.
///
/// # Errors
/// [`Error::Io`]; [`Error::Format`] for a scan that caphy made and somebody changed.
pub fn hash_scan(files: &ProjectFiles, file: &ScanFile) -> Result<String> {
    let mut all = artifact::hash(&files.read(&file.path)?);
    if let Some(made) = file.content.as_ref().filter(|made| **made != all) {
        let problem = format!("its hash is {all}, the scan that was made had {made}: damaged or edited");
        return Err(Error::format(&file.path, "content", problem, "delete the file: it will then be made again"));
    }
    // A damaged file is known by its own bytes.
    for beside in texture_files(&file.path, files).unwrap_or_default() {
        all += &files.read(&beside).map_or_else(|_| "missing".into(), |bytes| artifact::hash(&bytes));
    }
    Ok(all)
}

/// Hash of all scans' contents and roles.
///
/// # Errors
/// [`Error::Io`].
pub fn hash_scans(files: &ProjectFiles, scans: &Scans) -> Result<String> {
    let mut all = String::new();
    for file in &scans.list {
        all += &format!("{}{}{}", file.name, file.held_out, hash_scan(files, file)?);
    }
    Ok(artifact::hash(all.as_bytes()))
}

/// Reads a scan whose frame is known.
///
/// # Errors
/// Those of [`read_scan`].
pub fn read_framed(files: &ProjectFiles, file: &ScanFile, frame: &ScanFrame) -> Result<Scan> {
    let (mut scan, _) = read_scan(&file.path, files)?;
    scan.name.clone_from(&file.name);
    frame.apply(&mut scan);
    Ok(scan)
}

/// Reads a scan, finds its unit and its upward axis unless the configuration says them; notes say what was found and what is
/// missing.
///
/// # Errors
/// Those of [`read_scan`]; [`Error::Format`] for a size that no person has in any unit.
pub fn read_scan_of(
    files: &ProjectFiles,
    subject: &SubjectConfig,
    body: &dyn BodyModel,
    file: &ScanFile,
) -> Result<(Scan, ScanFrame, Vec<String>)> {
    let (mut scan, mut notes) = read_scan(&file.path, files)?;
    scan.name.clone_from(&file.name);
    let mut frame = ScanFrame::OWN;
    if let SubjectConfig::Scans(config) = subject {
        frame.metres_per_unit = unit(file, &scan, config.units, &mut notes)?;
        // Axes do not change sizes, so that the unit comes first.
        let scaled = |p: &Vec3| p * frame.metres_per_unit;
        frame.up = match config.up {
            Some(up) => up,
            None => upward(body, &scan, scaled, &mut notes)?,
        };
    } else {
        unit(file, &scan, Some(LengthUnit::Metre), &mut notes)?;
    }
    frame.apply(&mut scan);
    Ok((scan, frame, notes))
}

/// Metres per unit: the given one, or the one in which the scan is a person.
fn unit(file: &ScanFile, scan: &Scan, given: Option<LengthUnit>, notes: &mut Vec<String>) -> Result<f64> {
    let Some((low, high)) = scan.mesh.bounds() else { return Ok(1.0) };
    let size = (high - low).max();
    let fits = |unit: &LengthUnit| (PERSON.0..=PERSON.1).contains(&(size * unit.metres()));
    let found = match given {
        Some(unit) => Some(unit).filter(fits),
        None => [LengthUnit::Metre, LengthUnit::Centimetre, LengthUnit::Millimetre].into_iter().find(fits),
    };
    let Some(unit) = found else {
        let metres = size * given.unwrap_or(LengthUnit::Metre).metres();
        let problem = format!("the scan measures {metres:.3} m, a person {} to {} m", PERSON.0, PERSON.1);
        let remedy = "write it in metres, or say `subject.units`; and the person alone, without floor and backdrop";
        return Err(Error::format(&file.path, "positions", problem, remedy));
    };
    if given.is_none() && unit != LengthUnit::Metre {
        notes.push(format!("is taken to be in {unit}: its largest extent is {size:.0}"));
    }
    Ok(unit.metres())
}

/// Another axis must fit this much better than y, which most files have [1].
const CLEARLY: f64 = 0.85;

fn upward(
    body: &dyn BodyModel,
    scan: &Scan,
    scaled: impl Fn(&Vec3) -> Vec3,
    notes: &mut Vec<String>,
) -> Result<UpAxis> {
    if scan.mesh.faces.is_empty() {
        return Ok(UpAxis::Y);
    }
    let points = LabelledPoints {
        points: scan.mesh.vertices.iter().map(scaled).collect(),
        normals: scan.mesh.vertex_normals(),
        labels: vec![Label::Body; scan.mesh.vertices.len()],
    };
    let ways = find_up(body, &points)?;
    let of = |up: UpAxis| ways.iter().find(|w| w.0 == up).map_or(f64::INFINITY, |w| w.1);
    match ways.first() {
        Some(&(up, misfit)) if up != UpAxis::Y && misfit < CLEARLY * of(UpAxis::Y) => {
            notes.push(format!("is taken to have {} up; say `subject.up` if that is wrong", up.name()));
            Ok(up)
        }
        _ => Ok(UpAxis::Y),
    }
}

/// Start poses of scans: an `.npz` with `<scan>__full_pose` (joints, 3) [rad] and, where it is known, `<scan>__translation` (3) [m].
///
/// # Errors
/// [`Error::Format`] for a pose of another number of joints or values that are not finite, and for a file without any scan's pose.
pub fn start_poses(
    files: &ProjectFiles,
    path: &Path,
    scans: &Scans,
    body: &dyn BodyModel,
) -> Result<Vec<Option<Pose>>> {
    let resolved = files.resolve(path)?;
    let arrays = Npz::from_bytes(&resolved, files.read(path)?)?;
    let joints = body.describe().joints.len();
    let mut found = Vec::new();
    for file in &scans.list {
        let key = format!("{}__full_pose", file.name);
        if !arrays.has(&key) {
            found.push(None);
            continue;
        }
        let values = arrays.finite_f64s(&key)?.data;
        if values.len() != 3 * joints {
            let problem = format!("has {} numbers, the body {joints} joints", values.len());
            return Err(Error::format(resolved, format!("array `{key}`"), problem, "give three per joint, axis-angle"));
        }
        let mut pose = Pose::rest(joints);
        pose.rotations = values.chunks_exact(3).map(Vec3::from_column_slice).collect();
        let key = format!("{}__translation", file.name);
        if arrays.has(&key) {
            let values = arrays.finite_f64s(&key)?.data;
            let [x, y, z] = values[..] else {
                let problem = format!("has {} numbers", values.len());
                return Err(Error::format(resolved, format!("array `{key}`"), problem, "give three [m]"));
            };
            pose.translation = Vec3::new(x, y, z);
        }
        found.push(Some(pose));
    }
    if found.iter().all(Option::is_none) {
        let names: Vec<&str> = scans.list.iter().map(|s| s.name.as_str()).collect();
        let problem = format!("no array `<scan>__full_pose` for any of {}", names.join(", "));
        return Err(Error::format(resolved, "arrays", problem, "name the arrays like the scans"));
    }
    Ok(found)
}

/// What a look at one file of the folder says, for the plan.
#[derive(Debug, Clone, Serialize)]
pub struct PlannedScan {
    /// The scan's name.
    pub name: String,
    /// Kept for evaluation.
    pub held_out: bool,
    /// What it has.
    pub facts: String,
    /// What is missing or wrong.
    pub problems: Vec<String>,
}

/// Looks at each scan of a folder: whether it can be read, its size and unit, and whether it has what the segmenter reads.
pub fn inspect(files: &ProjectFiles, config: &ScansConfig, segmenter: &str, scans: &Scans) -> Vec<PlannedScan> {
    let look = |file: &ScanFile| -> Result<(String, Vec<String>)> {
        let (scan, mut problems) = read_scan(&file.path, files)?;
        let metres = unit(file, &scan, config.units, &mut Vec::new())?;
        let size = scan.mesh.bounds().map_or(0.0, |(low, high)| (high - low).max()) * metres;
        let (vertices, faces) = (scan.mesh.vertices.len(), scan.mesh.faces.len());
        let has = |what: bool, name: &'static str| if what { name } else { "" };
        let facts = format!(
            "{vertices} vertices, {faces} triangles, {size:.2} m{}{}",
            has(scan.colours.is_some(), ", colours"),
            has(scan.labels.is_some(), ", labels")
        );
        if faces == 0 {
            problems.push("has no triangles: labels need a surface".into());
        }
        if ["colour", "onnx"].contains(&segmenter) && scan.colours.is_none() {
            problems.push(format!("has no colours, which the segmenter `{segmenter}` reads"));
        }
        if segmenter == "vertex" && scan.labels.is_none() {
            problems.push("has no labels on its vertices, which the segmenter `vertex` reads".into());
        }
        Ok((facts, problems))
    };
    let described = |file: &ScanFile| {
        let (facts, problems) = look(file).unwrap_or_else(|error| (String::new(), vec![error.to_string()]));
        PlannedScan { name: file.name.clone(), held_out: file.held_out, facts, problems }
    };
    scans.list.iter().map(described).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_named_scans_count() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["a", "b", "c"] {
            std::fs::write(folder.path().join(format!("{name}.ply")), name).unwrap();
        }
        let list = |keys: &str| {
            let config: ScansConfig = toml::from_str(&format!("folder = {:?}\n{keys}", folder.path())).unwrap();
            scan_list(&ProjectFiles::new(folder.path()), &config, 1)
        };
        let names = |keys: &str| -> Vec<(String, bool)> {
            list(keys).unwrap().list.into_iter().map(|s| (s.name, s.held_out)).collect()
        };
        assert_eq!(names("held_out = []").len(), 3);
        let two = [("a".to_string(), false), ("c".to_string(), true)];
        assert_eq!(names("only = [\"c\", \"a\"]\nheld_out = [\"c\"]"), two);
        for (keys, word) in [("only = [\"d\"]", "subject.only"), ("only = [\"a\"]\nheld_out = [\"b\"]", "held_out")] {
            let said = list(keys).unwrap_err().to_string();
            assert!(said.contains(word) && said.contains("there are: a"), "{said}");
        }
    }
}
