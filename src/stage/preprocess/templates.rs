//! Which garment a person wears: of many styles the one that lies nearest to a scan when it is worn, then refined (Sec. 3.1).
//!
//! A template against a scan would measure how cloth hangs: candidates are put on the fitted body in the scan's pose and brought to
//! rest, the inner garment first, the outer one over it.

use super::{Subject, SubjectScan};
use crate::config::GarmentConfig;
use crate::garment::FittedGarment;
use crate::physics::solver_forces;
use crate::scene::{Scene, label_of, outer, thin};
use crate::simulate::{SimulationOptions, Steps, Under, simulate};
use crate::stage::preprocess::standard::distance_to_standard;
use crate::stage::scans::read_framed;
use crate::stage::{Context, Scans, material};
use caphy_core::body::{BodyModel, PosedBody};
use caphy_core::material::MaterialModel;
use caphy_core::scan::Label;
use caphy_core::{Error, Result, TriMesh, Vec3};
use caphy_garment::solver::SolverSettings;
use caphy_garment::template::{
    BodyRest, ChooseOptions, GarmentKind, GarmentMeasures, Seen, Tailor, Template, Worn, choose_template, finish,
    pose_by_nearest_vertex, refine, templates,
};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Edge length of the templates that styles are compared with [m]: style does not show in detail.
const CANDIDATE_RESOLUTION: f64 = 0.035;
/// Scan points per garment that styles are compared with.
const CANDIDATE_POINTS: usize = 3000;
/// Points of the edges of a garment that styles are refined with.
const EDGE_POINTS: usize = 600;
/// Force that may be left on worn candidates, as a share of a vertex's weight, and most steps to get there: millimetres do not matter.
const ROUGHLY: f64 = 0.05;
const STEPS: usize = 60;
/// Friction of cloth on skin and cloth, cotton on cotton: without it garments slide off shoulders.
const FRICTION: f64 = 0.3;

/// How a template was chosen.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct TemplateChoice {
    /// Upper or lower.
    pub kind: GarmentKind,
    /// The scan it was compared with.
    pub scan: String,
    /// Number of styles tried.
    pub styles: usize,
    /// Mean squared Chamfer distance of the best sample as it was compared last (worn, or by skinning alone), both directions summed [mm²].
    pub best_sample_mm2: f64,
    /// The same of the median sample, posed by skinning alone [mm²].
    pub median_sample_mm2: f64,
    /// The same after the style was refined, before it was taken to the template's resolution [mm²].
    pub refined_mm2: f64,
    /// Distance of the scan's edges from those of the refined template along the cloth, root mean square [mm]; 0 where the scan shows
    /// none.
    pub edges_off_mm: f64,
    /// The template's measures.
    pub measures: GarmentMeasures,
}

/// The person in the scan nearest to the standard pose, ready to try garments on.
pub(super) struct Choosing<'a> {
    context: &'a Context<'a>,
    body: Arc<dyn BodyModel>,
    subject: &'a Subject,
    standard: &'a SubjectScan,
    /// Its points with their labels; triangles say where labels meet.
    scan: TriMesh,
    posed: PosedBody,
    skin: Vec<Vec3>,
    tailor: Tailor,
}

/// A garment that is worn already: triangles and vertices [m].
type Inner = (Vec<[u32; 3]>, Vec<Vec<Vec3>>);

impl<'a> Choosing<'a> {
    pub(super) fn new(
        context: &'a Context<'a>,
        body: Arc<dyn BodyModel>,
        subject: &'a Subject,
        scans: &Scans,
    ) -> Result<Self> {
        let joints = &body.describe().joints;
        let standard = subject
            .training_scans()
            .min_by(|a, b| {
                let distance = |s: &SubjectScan| distance_to_standard(&s.pose, joints);
                distance(a).total_cmp(&distance(b))
            })
            .ok_or_else(|| Error::config("subject", "no training scan", "hold out fewer scans"))?;
        let file = scans.list.iter().find(|file| file.name == standard.name).ok_or_else(|| {
            Error::config("subject", format!("scan {} is not there any more", standard.name), "put it back")
        })?;
        let scan = read_framed(context.files, file, &standard.frame)?.mesh;
        let what = format!("labels of scan {}", standard.name);
        Error::check_length(&what, scan.vertices.len(), standard.points.labels.len())?;
        let mut parameters = body.rest(&subject.shape);
        parameters.displacement.clone_from(&subject.displacement);
        let rest = BodyRest::from_model(&*body, &parameters)?;
        let skin = rest.mesh.vertices.clone();
        let posed = body.forward(&parameters.posed(&standard.pose))?;
        Ok(Self { context, subject, standard, scan, posed, skin, tailor: Tailor::new(rest)?, body })
    }

    /// All configured garments with how they were chosen, upper first.
    pub(super) fn all(&self) -> Result<(Vec<FittedGarment>, Vec<TemplateChoice>)> {
        let config = self.context.config;
        let mut wanted: Vec<(GarmentKind, &str, &GarmentConfig)> = config.garments().collect();
        let outer = outer(config.finetune.layering.order);
        // What lies inside is put on first.
        wanted.sort_by_key(|w| w.0 == outer);
        let mut inner: Option<Inner> = None;
        let mut found = Vec::new();
        for (k, (kind, key, settings)) in wanted.into_iter().enumerate() {
            self.context.progress.set(0.8 + 0.07 * k as f64, &format!("{kind} template"));
            let fabric: Arc<dyn MaterialModel> = Arc::from(material(settings.worn_in(), key, None)?);
            let (template, choice, worn) = self.choose(kind, settings, &fabric, inner.as_ref())?;
            inner = Some(worn);
            found.push((self.fitted(template, settings)?, choice));
        }
        found.sort_by_key(|(garment, _)| garment.kind != GarmentKind::Upper);
        Ok(found.into_iter().unzip())
    }

    fn fitted(&self, template: Template, settings: &GarmentConfig) -> Result<FittedGarment> {
        let weights = &self.body.describe().weights;
        Ok(FittedGarment::new(template, &self.skin, weights, &settings.weights)?.weighing(settings.mass_g))
    }

    /// The template of one garment: the best of the sampled styles, refined.
    fn choose(
        &self,
        kind: GarmentKind,
        settings: &GarmentConfig,
        fabric: &Arc<dyn MaterialModel>,
        inner: Option<&Inner>,
    ) -> Result<(Template, TemplateChoice, Inner)> {
        let points = self.seen(kind)?;
        let covered = kind != outer(self.context.config.finetune.layering.order);
        let cover = if covered { thin(&self.of_label(label_of(other(kind))), CANDIDATE_POINTS) } else { Vec::new() };
        let options = ChooseOptions { covered_by: &cover };
        let source = settings.template.template(self.context.files)?;
        let tailor = &self.tailor;
        let styles = source.styles(tailor, kind, settings.styles, self.context.config.run.seed)?;
        let candidates = templates(&*source, tailor, &styles, CANDIDATE_RESOLUTION)?;
        let weights = &self.body.describe().weights;
        let pose = |t: &Template| pose_by_nearest_vertex(t, weights, &self.posed.transforms);
        let shapes = candidates.iter().map(pose).collect::<Result<Vec<_>>>()?;
        let posed = choose_template(&shapes, &points, &options)?;
        let mut order: Vec<usize> = (0..candidates.len()).collect();
        order.sort_by(|&a, &b| posed.report[a].squared.total_cmp(&posed.report[b].squared));
        let median = posed.report[order[order.len() / 2]].squared;
        order.truncate(settings.worn.max(1));
        let wear = |t: &Template| match settings.worn {
            0 => pose(t),
            _ => self.worn(t, settings, fabric, inner),
        };
        let worn: Vec<Result<Vec<Vec3>>> = order.par_iter().map(|&i| wear(&candidates[i])).collect();
        let worn = worn.into_iter().collect::<Result<Vec<_>>>()?;
        let sampled = choose_template(&worn, &points, &options)?;
        let (best, vertices) = (&candidates[order[sampled.index]], worn[sampled.index].clone());
        let start = Worn { template: best.clone(), vertices };
        let edges = thin(&self.edges(kind, covered), EDGE_POINTS);
        let seen = Seen { points: &points, edges: &edges, covered_by: &cover };
        let refined = refine(&*source, tailor, start, CANDIDATE_RESOLUTION, seen, wear)?;
        let after = choose_template(std::slice::from_ref(&refined.worn), &points, &options)?;
        let finished = finish(&*source, tailor, &refined, settings.resolution_m, seen, wear)?;
        let choice = TemplateChoice {
            kind,
            scan: self.standard.name.clone(),
            styles: styles.len(),
            best_sample_mm2: sampled.report[sampled.index].squared * 1e6,
            median_sample_mm2: median * 1e6,
            refined_mm2: after.report[after.index].squared * 1e6,
            edges_off_mm: finished.edges_off_m * 1e3,
            measures: finished.template.measures(),
        };
        let worn = (finished.template.mesh.faces.clone(), vec![finished.worn]);
        Ok((finished.template, choice, worn))
    }

    /// A candidate at rest on the body in the scan's pose [m].
    fn worn(
        &self,
        template: &Template,
        settings: &GarmentConfig,
        fabric: &Arc<dyn MaterialModel>,
        inner: Option<&Inner>,
    ) -> Result<Vec<Vec3>> {
        let garment = self.fitted(template.clone(), settings)?;
        let forces = solver_forces(&self.context.config.train);
        let rest = garment.rest(&**fabric)?;
        let weight = rest.mass() * forces.gravity.norm() / rest.vertex_count() as f64;
        let options = SimulationOptions {
            steps: Steps::QuasiStatic,
            // A rate is of no importance at rest.
            fps: 30.0,
            forces,
            settings: SolverSettings {
                tolerance_n: ROUGHLY * weight,
                iterations: STEPS,
                friction: FRICTION,
                ..SolverSettings::default()
            },
            disturbance: None,
        };
        let subject = self.subject;
        let garments = std::slice::from_ref(&garment);
        let scene = Scene::dressed(self.body.clone(), &subject.shape, &subject.displacement, garments)?;
        let track = scene.track(std::slice::from_ref(&self.standard.pose))?;
        let under = inner.map(|(faces, frames)| Under { faces, frames });
        let contact = scene.contact(&garment)?;
        let simulation = simulate(&garment, fabric.clone(), &track, &contact, under, &options, &|_, _| {})?;
        simulation
            .frames
            .into_iter()
            .next()
            .ok_or_else(|| Error::numerics("draping of a candidate", "there is no frame", "report this as a defect"))
    }

    /// Scan points of a garment, thinned.
    fn seen(&self, kind: GarmentKind) -> Result<Vec<Vec3>> {
        let points = self.of_label(label_of(kind));
        if points.is_empty() {
            return Err(Error::mesh(
                &self.standard.name,
                "labels",
                format!("no point belongs to the {kind} garment"),
                "check the segmenter and the labels of the scan",
            ));
        }
        Ok(thin(&points, CANDIDATE_POINTS))
    }
    fn of_label(&self, label: Label) -> Vec<Vec3> {
        self.standard.points.with_label(label).0
    }
    /// Where a garment ends in the scan [m]: at skin, and, unless the other garment covers it, at that one.
    fn edges(&self, kind: GarmentKind, covered: bool) -> Vec<Vec3> {
        let labels = &self.standard.points.labels;
        let (own, hiding) = (label_of(kind), covered.then(|| label_of(other(kind))));
        let mut lengths: Vec<f64> = self
            .scan
            .faces
            .iter()
            .map(|f| (self.scan.vertices[f[1] as usize] - self.scan.vertices[f[0] as usize]).norm())
            .collect();
        lengths.sort_by(f64::total_cmp);
        let typical = lengths.get(lengths.len() / 2).copied().unwrap_or(0.0);
        let mut out = Vec::new();
        for face in &self.scan.faces {
            // Each edge is met once from either of its triangles.
            for (a, b) in [(face[0], face[1]), (face[1], face[2]), (face[2], face[0])] {
                let (a, b) = (a as usize, b as usize);
                if labels[a] == own && labels[b] != own && hiding != Some(labels[b]) {
                    // Labels change somewhere between; beyond a step in depth cloth goes no farther than elsewhere.
                    let (p, way) = (self.scan.vertices[a], self.scan.vertices[b] - self.scan.vertices[a]);
                    out.push(p + way * (0.5 * (typical / way.norm().max(1e-12)).min(1.0)));
                }
            }
        }
        out
    }
}

fn other(kind: GarmentKind) -> GarmentKind {
    match kind {
        GarmentKind::Upper => GarmentKind::Lower,
        GarmentKind::Lower => GarmentKind::Upper,
    }
}
