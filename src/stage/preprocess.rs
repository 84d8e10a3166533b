//! From scans to labels, a naked body under the clothes, and garment templates (Sec. 3.1).

mod bodies;
mod ends;
mod standard;
mod templates;
mod touching;

pub(crate) use bodies::FILE as BODIES;
pub use templates::TemplateChoice;

use super::scans::{ScanFrame, hash_scan, read_framed, read_scan_of, start_poses};
use super::{Context, ScanFile, Scans, StageOutput};
use crate::artifact;
use crate::config::{Config, ScansConfig, SubjectConfig};
use crate::garment::FittedGarment;
use crate::pictures;
use crate::runner::input_hashes;
use crate::scene::label_of;
use bodies::FittedScan;
use caphy_bodymodel::registration::{RegistrationScan, ScanFit, ScanStart, find_starts};
use caphy_core::body::{BodyModel, BodyParameters};
use caphy_core::pose::Pose;
use caphy_core::scan::LabelledPoints;
use caphy_core::segmenter::Segmenter;
use caphy_core::{Error, Result, TriMesh, Vec3};
use caphy_render::Layer;
use caphy_segmentation::fusion::{FusionReport, FusionSettings, label_scan};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Instant;

/// A subject after preprocessing.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Subject {
    /// Shape β, learned from training scans.
    pub shape: Vec<f64>,
    /// Displacements dT [m], learned from training scans; empty for none.
    pub displacement: Vec<Vec3>,
    /// All scans with their poses.
    pub scans: Vec<SubjectScan>,
    /// Scans that could not be used.
    pub skipped: Vec<SkippedScan>,
    /// Templates, upper first.
    pub garments: Vec<FittedGarment>,
    /// How the templates were chosen.
    pub choices: Vec<TemplateChoice>,
    /// Files with pictures, relative to the run directory.
    pub pictures: Vec<PathBuf>,
}

impl StageOutput for Subject {
    fn files(&self) -> Vec<PathBuf> {
        self.pictures.clone()
    }
}

/// A scan that was left out.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct SkippedScan {
    /// The scan's name.
    pub name: String,
    /// Why.
    pub problem: String,
}

/// One scan, labelled and fitted.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct SubjectScan {
    /// The scan's name.
    pub name: String,
    /// Kept for evaluation.
    pub held_out: bool,
    /// How its file became metres with y up.
    pub frame: ScanFrame,
    /// What was noticed about it.
    pub notes: Vec<String>,
    /// Fitted pose.
    pub pose: Pose,
    /// All points with normals and labels.
    pub points: LabelledPoints,
    /// What label fusion saw.
    pub fusion: FusionReport,
    /// Share of vertices whose fused label equals the one stored with the scan, where one is stored.
    pub label_agreement: Option<f64>,
    /// How well the body fits.
    pub fit: ScanFit,
    /// Share of its points farther than 15 cm from the fitted body [1].
    pub strange_share: f64,
}

impl Subject {
    /// Scans that may be learned from.
    pub fn training_scans(&self) -> impl Iterator<Item = &SubjectScan> {
        self.scans.iter().filter(|s| !s.held_out)
    }
}

/// Labels, fits, chooses.
///
/// A scan that cannot be used is left out with a note that says why, and the others go on; without any that can be learned from,
/// its problem is the run's. Labels and start pose of each scan are an artifact of their own, and so are the bodies: a killed run, or one
/// with more scans in the folder, goes on from there.
pub fn run(context: &Context<'_>, scans: &Scans) -> Result<Subject> {
    let config = context.config;
    let progress = context.progress;
    let body: Arc<dyn BodyModel> = Arc::from(config.body.body(context.files)?);
    let table = config
        .segmenter
        .as_ref()
        .ok_or_else(|| Error::config("segmenter", "there is no such table", "add [segmenter]"))?;
    let segmenter = table.segmenter(context.files)?;
    let count = scans.list.len() as f64;
    let starts = match &config.subject {
        SubjectConfig::Scans(ScansConfig { starts: Some(path), .. }) => {
            start_poses(context.files, path, scans, &*body)?
        }
        _ => vec![None; scans.list.len()],
    };

    let mut skipped: Vec<SkippedScan> = Vec::new();
    let mut failures: Vec<Error> = Vec::new();
    let mut skip = |file: &ScanFile, error: Error| {
        progress.note(&format!("warning: scan {} is left out: {error}", file.name));
        skipped.push(SkippedScan { name: file.name.clone(), problem: error.to_string() });
        failures.push(error);
    };
    let [until_labels, until_bodies] = shares(config, scans.list.len());
    let done = AtomicUsize::new(0);
    let started = Instant::now();
    let known: Vec<Result<LabelledScan>> = scans
        .list
        .par_iter()
        .zip(starts)
        .map(|(file, start)| {
            let known = labelled_scan(context, &*body, &*segmenter, file, start);
            let share = (done.fetch_add(1, Ordering::Relaxed) + 1) as f64 / count;
            progress.set(until_labels * share, &format!("labels and start of {}", file.name));
            known
        })
        .collect();
    let mut labelled: Vec<(&ScanFile, LabelledScan)> = Vec::new();
    for (file, known) in scans.list.iter().zip(known) {
        match known {
            Ok(scan) => {
                scan.notes.iter().for_each(|note| progress.note(&format!("scan {} {note}", file.name)));
                labelled.push((file, scan));
            }
            Err(error) => skip(file, error),
        }
    }
    context.time(SCANS_TIME, started.elapsed().as_secs_f64());
    let started = Instant::now();
    let bodies = bodies::fitted(context, &*body, &labelled, [until_labels, until_bodies])?;
    context.time(BODIES_TIME, started.elapsed().as_secs_f64());
    let mut used: Vec<(&ScanFile, LabelledScan, FittedScan)> = Vec::new();
    for ((file, scan), fitted) in labelled.into_iter().zip(bodies.scans) {
        match fitted {
            Some(fitted) if !fitted.is_strange() => {
                fitted.notes().iter().for_each(|note| progress.note(&format!("scan {} {note}", file.name)));
                used.push((file, scan, fitted));
            }
            Some(fitted) => skip(file, fitted.strange(&file.name)),
            // Held out, and nothing to learn a shape from.
            None => {}
        }
    }
    let Some((shape, displacement)) = bodies.shape else {
        // The first problem: later ones often follow from the same cause.
        return Err(failures
            .into_iter()
            .next()
            .unwrap_or_else(|| Error::config("subject", "no training scan", "hold out fewer scans")));
    };
    let mut subject_body = body.rest(&shape);
    subject_body.displacement.clone_from(&displacement);
    let mut subject = Subject {
        shape,
        displacement,
        scans: Vec::new(),
        skipped,
        garments: Vec::new(),
        choices: Vec::new(),
        pictures: Vec::new(),
    };
    for (file, mut scan, FittedScan { pose, fit, strange_share }) in used {
        if let Some(note) = touching::note(&*body, &subject_body.posed(&pose))? {
            progress.note(&format!("scan {} {note}", file.name));
            scan.notes.push(note);
        }
        subject.scans.push(SubjectScan {
            name: file.name.clone(),
            held_out: file.held_out,
            frame: scan.frame,
            notes: scan.notes,
            pose,
            points: scan.points,
            fusion: scan.fusion,
            label_agreement: scan.label_agreement,
            fit,
            strange_share,
        });
    }

    let choosing = templates::Choosing::new(context, body.clone(), &subject, scans)?;
    let (garments, choices) = choosing.all([until_bodies, PICTURES])?;
    (subject.garments, subject.choices) = (garments, choices);
    progress.set(PICTURES, "pictures");
    subject.pictures = draw(context, &*body, &subject_body, &subject, scans)?;
    Ok(subject)
}

/// Share of the work that is done when only pictures are left.
const PICTURES: f64 = 0.98;

/// Shares of the work that are done with all scans labelled, and with all bodies fitted.
fn shares(config: &Config, scans: usize) -> [f64; 2] {
    // About seconds on one machine; what counts is how they compare.
    let (labels, bodies) = (2.8 * scans as f64, 2.0 * scans as f64);
    let on = config.templates.scans.min(scans);
    let templates: f64 = config.garments().map(|g| templates::effort(g.2, on)).sum();
    let all = (labels + bodies + templates) / PICTURES;
    [labels / all, (labels + bodies) / all]
}

/// A scan as it is known by itself: the artifact of one file.
#[derive(Debug, Clone, Serialize, Deserialize)]
struct LabelledScan {
    frame: ScanFrame,
    notes: Vec<String>,
    points: LabelledPoints,
    fusion: FusionReport,
    label_agreement: Option<f64>,
    start: ScanStart,
    /// The user's rough pose.
    given: Option<Pose>,
    /// Key of its artifact: hash of all that it was made of.
    #[serde(skip)]
    key: String,
}

/// Labels and start pose of one scan, from its artifact when nothing has changed.
fn labelled_scan(
    context: &Context<'_>,
    body: &dyn BodyModel,
    segmenter: &dyn Segmenter,
    file: &ScanFile,
    given: Option<Pose>,
) -> Result<LabelledScan> {
    let config = context.config;
    let frame = match &config.subject {
        SubjectConfig::Scans(scans) => Some((scans.units, scans.up)),
        _ => None,
    };
    let settings = FusionSettings { views: config.views.count, size: config.views.size, ..FusionSettings::default() };
    let material =
        serde_json::to_value((&config.body, &config.segmenter, &settings, &config.registration, frame, &given))
            .map_err(|e| Error::config("(whole file)", e.to_string(), "report this as a defect"))?;
    let inputs = input_hashes(context.files, std::slice::from_ref(&material))?;
    let contents = hash_scan(context.files, file)?;
    let garments: Vec<&str> = config.garments().map(|g| g.1).collect();
    let key = format!("{}{material}{inputs:?}{contents}{garments:?}", env!("CARGO_PKG_VERSION"));
    let key = artifact::hash(key.as_bytes());
    let path = context.folder.join("labelled").join(format!("{}.caphy", file.name));
    // A damaged artifact is made anew: it is only a shortcut.
    if let Ok(Some((scan, _))) = artifact::load::<LabelledScan>(&path, "labelled", &key) {
        return Ok(LabelledScan { key, ..scan });
    }
    let (scan, frame, mut notes) = read_scan_of(context.files, &config.subject, body, file)?;
    let fusion = label_scan(&scan, segmenter, &settings)?;
    let label_agreement = scan.labels.as_ref().map(|stored| {
        let same = stored.iter().zip(&fusion.labels).filter(|(a, b)| a == b).count();
        same as f64 / stored.len().max(1) as f64
    });
    if fusion.report.unseen > UNSEEN {
        notes.push(format!("has {:.0} % of vertices that no view shows with a label", 100.0 * fusion.report.unseen));
    }
    let normals = scan.mesh.vertex_normals();
    let points = LabelledPoints { points: scan.mesh.vertices, normals, labels: fusion.labels };
    let input = [RegistrationScan { name: &file.name, points: &points, start: given.clone() }];
    let found = find_starts(body, &input, &config.registration, &|_| ())?;
    let start = found
        .into_iter()
        .next()
        .ok_or_else(|| Error::numerics("registration", "no start", "report this as a defect"))?;
    let fusion = fusion.report;
    for (kind, ..) in config.garments() {
        let own = fusion.counts[label_of(kind) as usize];
        if own == 0 {
            return Err(Error::mesh(
                &file.name,
                "labels",
                format!("no point belongs to the {kind} garment"),
                "check the segmenter and the labels of the scan",
            ));
        }
        if own * 50 < points.labels.len() {
            let share = 100.0 * own as f64 / points.labels.len() as f64;
            notes.push(format!("shows little of the {kind} garment: {share:.1} % of its vertices"));
        }
    }
    let made = LabelledScan { frame, notes, points, fusion, label_agreement, start, given, key };
    artifact::save(&path, "labelled", &made.key, &made)?;
    Ok(made)
}

/// Times of two parts, by their names in `timings.json` [s]: labels and start poses of all scans, and the fit of all bodies.
pub(crate) const SCANS_TIME: &str = "preprocess: labels and starts";
pub(crate) const BODIES_TIME: &str = "preprocess: bodies";
/// Share of vertices without a label of their own from which on it is worth a note.
const UNSEEN: f64 = 0.2;
/// Scan, labels, body and overlay of each scan (as the paper's Fig. 3), and the templates.
fn draw(
    context: &Context<'_>,
    body: &dyn BodyModel,
    subject_body: &BodyParameters,
    subject: &Subject,
    scans: &Scans,
) -> Result<Vec<PathBuf>> {
    let mut cells = Vec::new();
    // Enough to see whether it worked; every scan would make a long page. Where those that fit worst are right, all are.
    let mut shown: Vec<&SubjectScan> = subject.scans.iter().collect();
    shown.sort_by(|a, b| a.fit.skin_found_share.total_cmp(&b.fit.skin_found_share));
    shown.truncate(6);
    shown.sort_by(|a, b| a.name.cmp(&b.name));
    for scan in shown {
        let Some(file) = scans.list.iter().find(|file| file.name == scan.name) else { continue };
        let surface = read_framed(context.files, file, &scan.frame)?;
        let posed = body.forward(&subject_body.posed(&scan.pose))?;
        let naked = TriMesh { vertices: posed.vertices, faces: body.describe().faces.clone() };
        let bounds = pictures::padded(surface.mesh.bounds().unwrap_or((Vec3::zeros(), Vec3::repeat(1.0))));
        let labels = pictures::label_colours(&scan.points);
        let shot = |layers| pictures::draw(layers, bounds, &pictures::FRONT);
        let scanned = match &surface.colours {
            Some(colours) => Layer::per_vertex(&surface.mesh, colours),
            None => Layer::uniform(&surface.mesh, caphy_render::shade::CLAY),
        };
        let clay = caphy_render::shade::CLAY_SKIN;
        cells.push((scan.name.clone(), shot(vec![scanned])));
        cells.push(("labels".to_string(), shot(vec![Layer::per_vertex(&surface.mesh, &labels)])));
        cells.push(("body".to_string(), shot(vec![Layer::uniform(&naked, clay)])));
        let red = Layer::uniform(&naked, [200, 70, 60]);
        cells.push(("body over scan".to_string(), shot(vec![red, Layer::uniform(&surface.mesh, [205, 205, 200])])));
    }
    context.write("pictures/scans.png", &pictures::sheet(&cells, 8)?)?;
    let rest = body.forward(subject_body)?;
    let rest = TriMesh { vertices: rest.vertices, faces: body.describe().faces.clone() };
    let garments: Vec<TriMesh> = subject.garments.iter().map(|g| g.mesh.clone()).collect();
    let dressed = pictures::Dressed { body: &rest, garments };
    let templates = [("templates", pictures::FRONT), ("from behind", pictures::BACK)]
        .map(|(label, from)| (label.to_string(), pictures::dressed(&dressed, &from)));
    context.write("pictures/templates.png", &pictures::sheet(&templates, 2)?)?;
    Ok(vec!["pictures/scans.png".into(), "pictures/templates.png".into()])
}
