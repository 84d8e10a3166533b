//! From scans to labels, a naked body under the clothes, and garment templates (Sec. 3.1).

use super::{Context, ScanFile, Scans, StageOutput, read_scan};
use crate::config::GarmentConfig;
use crate::fixed_shape::FixedShape;
use crate::garment::FittedGarment;
use crate::pictures;
use crate::scene::{label_of, thin};
use caphy_bodymodel::registration::{RegistrationScan, ScanFit, register};
use caphy_core::body::{BodyModel, BodyParameters, PosedBody};
use caphy_core::pose::Pose;
use caphy_core::scan::{Label, LabelledPoints, Scan};
use caphy_core::{Error, Result, TriMesh, Vec3};
use caphy_garment::template::{
    BodyRest, ChooseOptions, GarmentKind, Tailor, Template, choose_template, pose_by_nearest_vertex, refine, templates,
};
use caphy_render::Layer;
use caphy_segmentation::fusion::{FusionReport, FusionSettings, label_scan};
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// A subject after preprocessing.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Subject {
    /// Shape β, learned from training scans.
    pub shape: Vec<f64>,
    /// Displacements dT [m], learned from training scans; empty for none.
    pub displacement: Vec<Vec3>,
    /// All scans with their poses.
    pub scans: Vec<SubjectScan>,
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

/// One scan, labelled and fitted.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct SubjectScan {
    /// The scan's name.
    pub name: String,
    /// Kept for evaluation.
    pub held_out: bool,
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
}

/// How a template was chosen.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct TemplateChoice {
    /// Upper or lower.
    pub kind: GarmentKind,
    /// The scan it was compared with.
    pub scan: String,
    /// Number of styles tried.
    pub styles: usize,
    /// Mean squared Chamfer distance of the best sample, both directions summed [mm²].
    pub best_sample_mm2: f64,
    /// The same of the median sample [mm²].
    pub median_sample_mm2: f64,
    /// The same after the style was refined [mm²].
    pub refined_mm2: f64,
    /// Rest area [m²].
    pub area_m2: f64,
    /// Girths of the boundary loops [m].
    pub girths_m: Vec<(String, f64)>,
}

impl Subject {
    /// Scans that may be learned from.
    pub fn training_scans(&self) -> impl Iterator<Item = &SubjectScan> {
        self.scans.iter().filter(|s| !s.held_out)
    }
}

/// Edge length of the templates that styles are compared with [m]: style does not show in detail.
const CANDIDATE_RESOLUTION: f64 = 0.035;
/// Scan points per garment that styles are compared with.
const CANDIDATE_POINTS: usize = 3000;
/// Templates generated while the best sample is refined.
const REFINEMENTS: usize = 24;

/// Labels, fits, chooses.
pub fn run(context: &Context<'_>, scans: &Scans) -> Result<Subject> {
    let config = context.config;
    let progress = context.progress;
    let body = config.body.body(context.files)?;
    let table = config
        .segmenter
        .as_ref()
        .ok_or_else(|| Error::config("segmenter", "there is no such table", "add [segmenter]"))?;
    let segmenter = table.segmenter(context.files)?;
    let count = scans.list.len() as f64;

    let settings = FusionSettings { views: config.views.count, size: config.views.size, ..FusionSettings::default() };
    let mut labelled = Vec::new();
    for (i, file) in scans.list.iter().enumerate() {
        progress.set(0.3 * i as f64 / count, &format!("labels of {}", file.name));
        let scan = read_scan(file)?;
        check_size(file, &scan)?;
        let fusion = label_scan(&scan, &*segmenter, &settings)?;
        let agreement = scan.labels.as_ref().map(|stored| {
            let same = stored.iter().zip(&fusion.labels).filter(|(a, b)| a == b).count();
            same as f64 / stored.len().max(1) as f64
        });
        let normals = scan.mesh.vertex_normals();
        let points = LabelledPoints { points: scan.mesh.vertices.clone(), normals, labels: fusion.labels };
        labelled.push((file, scan, points, fusion.report, agreement));
    }

    let training: Vec<usize> = (0..labelled.len()).filter(|&i| !labelled[i].0.held_out).collect();
    let as_scan = |i: usize| RegistrationScan { name: &labelled[i].0.name, points: &labelled[i].2, start: None };
    let inputs: Vec<RegistrationScan<'_>> = training.iter().map(|&i| as_scan(i)).collect();
    let share = training.len() as f64 / count;
    let fit = register(&*body, &inputs, &config.registration, &|s| {
        progress.set(0.3 + 0.5 * share * s, "body under the clothes");
    })?;
    let mut poses: Vec<Option<(Pose, ScanFit)>> = vec![None; labelled.len()];
    for ((&i, pose), report) in training.iter().zip(&fit.poses).zip(&fit.report) {
        poses[i] = Some((pose.clone(), report.clone()));
    }
    let mut subject_body = body.rest(&fit.shape);
    subject_body.displacement = fit.displacement.clone();
    // Held-out scans get a pose, but no say in the shape.
    let fixed = FixedShape::new(&*body, &subject_body)?;
    let held: Vec<usize> = (0..labelled.len()).filter(|&i| labelled[i].0.held_out).collect();
    for (k, &i) in held.iter().enumerate() {
        let settings = caphy_bodymodel::registration::RegistrationSettings {
            displacement_sigma: 0.0,
            ..config.registration.clone()
        };
        let fit = register(&fixed, &[as_scan(i)], &settings, &|s| {
            progress.set(0.3 + 0.5 * (share + (1.0 - share) * (k as f64 + s) / held.len() as f64), "held-out pose");
        })?;
        if let (Some(pose), Some(report)) = (fit.poses.first(), fit.report.first()) {
            poses[i] = Some((pose.clone(), report.clone()));
        }
    }

    let mut subject = Subject {
        shape: fit.shape,
        displacement: fit.displacement,
        scans: Vec::new(),
        garments: Vec::new(),
        choices: Vec::new(),
        pictures: Vec::new(),
    };
    let mut surfaces = Vec::new();
    for ((file, scan, points, fusion, label_agreement), fitted) in labelled.into_iter().zip(poses) {
        let (pose, fit) = fitted.ok_or_else(|| {
            Error::numerics(format!("scan {}", file.name), "was not fitted", "look at the labels in the report")
        })?;
        let (name, held_out) = (file.name.clone(), file.held_out);
        subject.scans.push(SubjectScan { name, held_out, pose, points, fusion, label_agreement, fit });
        surfaces.push(scan);
    }

    progress.set(0.8, "garment templates");
    let rest = BodyRest::from_model(&*body, &subject_body)?;
    let rest_vertices = rest.mesh.vertices.clone();
    let tailor = Tailor::new(rest)?;
    for (k, (kind, _, settings)) in config.garments().enumerate() {
        progress.set(0.8 + 0.07 * k as f64, &format!("{kind} template"));
        let (template, choice) = choose(context, &*body, &subject_body, &subject, &tailor, (kind, settings))?;
        let options = &settings.weights;
        let weights = &body.describe().weights;
        subject.choices.push(choice);
        subject.garments.push(FittedGarment::new(template, &rest_vertices, weights, options)?);
    }
    progress.set(0.95, "pictures");
    subject.pictures = draw(context, &*body, &subject_body, &subject, &surfaces)?;
    Ok(subject)
}

/// Largest extents that a standing, sitting or stretched person's scan can have [m]: a small child to a tall adult.
const PERSON: (f64, f64) = (0.5, 3.0);

/// Refuses scans in other units before they are fitted: nothing later would say so.
fn check_size(file: &ScanFile, scan: &Scan) -> Result<()> {
    let Some((low, high)) = scan.mesh.bounds() else { return Ok(()) };
    let size = (high - low).max();
    if (PERSON.0..=PERSON.1).contains(&size) {
        return Ok(());
    }
    let problem = format!("the scan measures {size:.3} m, a person {} to {} m", PERSON.0, PERSON.1);
    Err(Error::format(&file.path, "positions", problem, "write it in metres, and the person alone"))
}

/// The template of one garment: the best of the sampled styles, refined.
fn choose(
    context: &Context<'_>,
    body: &dyn BodyModel,
    subject_body: &BodyParameters,
    subject: &Subject,
    tailor: &Tailor,
    (kind, settings): (GarmentKind, &GarmentConfig),
) -> Result<(Template, TemplateChoice)> {
    let joints = &body.describe().joints;
    let standard = subject
        .training_scans()
        .min_by(|a, b| {
            let distance = |s: &SubjectScan| pictures::distance_to_standard(&s.pose, joints);
            distance(a).total_cmp(&distance(b))
        })
        .ok_or_else(|| Error::config("subject", "no training scan", "hold out fewer scans"))?;
    let posed: PosedBody = body.forward(&subject_body.posed(&standard.pose))?;
    let weights = &body.describe().weights;
    let pose = |t: &Template| pose_by_nearest_vertex(t, weights, &posed.transforms);
    let (points, _) = standard.points.with_label(label_of(kind));
    if points.is_empty() {
        return Err(Error::mesh(
            &standard.name,
            "labels",
            format!("no point belongs to the {kind} garment"),
            "check the segmenter and the labels of the scan",
        ));
    }
    let points = thin(&points, CANDIDATE_POINTS);
    let cover = match kind {
        GarmentKind::Upper => Vec::new(),
        GarmentKind::Lower => thin(&standard.points.with_label(Label::Upper).0, CANDIDATE_POINTS),
    };
    let options = ChooseOptions { covered_by: &cover };
    let source = settings.template.template(context.files)?;
    let styles = source.styles(tailor, kind, settings.styles, context.config.run.seed)?;
    let candidates = templates(&*source, tailor, &styles, CANDIDATE_RESOLUTION)?;
    let shapes = candidates.iter().map(pose).collect::<Result<Vec<_>>>()?;
    let choice = choose_template(&shapes, &points, &options)?;
    let best = &candidates[choice.index];
    let refined = refine(&*source, tailor, &best.style, CANDIDATE_RESOLUTION, &points, &options, REFINEMENTS, pose)?;
    let template = source.template(tailor, &refined.style, settings.resolution_m)?;
    let mut all: Vec<f64> = choice.report.iter().map(|c| c.squared * 1e6).collect();
    all.sort_by(f64::total_cmp);
    let report = TemplateChoice {
        kind,
        scan: standard.name.clone(),
        styles: styles.len(),
        best_sample_mm2: all[0],
        median_sample_mm2: all[all.len() / 2],
        refined_mm2: refined.chamfer.squared * 1e6,
        area_m2: template.area(),
        girths_m: template.girths(),
    };
    Ok((template, report))
}

/// Scan, labels, body and overlay of each scan (as the paper's Fig. 3), and the templates.
fn draw(
    context: &Context<'_>,
    body: &dyn BodyModel,
    subject_body: &BodyParameters,
    subject: &Subject,
    surfaces: &[Scan],
) -> Result<Vec<PathBuf>> {
    let mut cells = Vec::new();
    // Enough to see whether it worked; every scan would make a long page.
    for (scan, surface) in subject.scans.iter().zip(surfaces).take(6) {
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
