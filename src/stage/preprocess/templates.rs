//! Which garment a person wears: of many styles the one that lies nearest to a scan when it is worn, then refined (Sec. 3.1).
//!
//! A template against a scan would measure how cloth hangs: candidates are put on the fitted body in the scan's pose and brought to
//! rest, the inner garment first, the outer one over it.

use super::ends::Ends;
use super::{Subject, SubjectScan};
use crate::config::GarmentConfig;
use crate::garment::FittedGarment;
use crate::physics::solver_forces;
use crate::scene::{Scene, label_of, outer, thin};
use crate::simulate::{SimulationOptions, Steps, Under, simulate_from};
use crate::stage::preprocess::standard::distance_to_standard;
use crate::stage::scans::read_framed;
use crate::stage::{Context, Scans, material};
use caphy_core::body::{BodyModel, PosedBody};
use caphy_core::material::MaterialModel;
use caphy_core::query::NearestGrid;
use caphy_core::scan::Label;
use caphy_core::{Error, Result, TriMesh, Vec3};
use caphy_garment::solver::SolverSettings;
use caphy_garment::template::{
    BodyRest, ChooseOptions, GarmentKind, GarmentMeasures, Rim, Seen, Tailor, Template, Worn, WornAs, choose_template,
    ease, finish, hung_like, pose_by_nearest_vertex, refine, templates,
};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::sync::{Arc, Mutex};

/// Edge length of the templates that styles are compared with [m]: style does not show in detail.
const CANDIDATE_RESOLUTION: f64 = 0.035;
/// Styles are refined with this many of the scans at most; all of them ease the template.
const STYLED: usize = 3;
/// Scan points per garment that styles are compared with.
const CANDIDATE_POINTS: usize = 3000;
/// Points of the edges of a garment that styles are refined with.
const EDGE_POINTS: usize = 600;
/// Skin under cloth, and skin beside it where it ends, are this near to each other on the body at rest, where limbs are apart [m].
const SAME_PLACE: f64 = 0.07;
/// Force that may be left on worn candidates, as a share of a vertex's weight, and most steps to get there: millimetres do not matter.
const ROUGHLY: f64 = 0.05;
const STEPS: usize = 60;
/// Friction of cloth on skin and cloth, cotton on cotton: without it garments slide off shoulders.
const FRICTION: f64 = 0.3;

/// What finding a template costs, about in seconds.
pub(super) fn effort(settings: &GarmentConfig, scans: usize) -> f64 {
    if settings.worn == 0 {
        return 2.0;
    }
    // Some rounds of refinement; each further scan is measured along all axes; then a few templates as fine as wanted, from good guesses.
    let styled = scans.min(STYLED);
    let coarse = settings.worn + 25 + 5 * styled.saturating_sub(1);
    let fine = 3.5 * styled as f64 + 3.0 * scans as f64;
    coarse as f64 + fine * FROM_A_GUESS * wearing((CANDIDATE_RESOLUTION / settings.resolution_m).powi(2))
}

/// What wearing a garment costs from a good guess, against that from skinning alone.
const FROM_A_GUESS: f64 = 0.45;

/// What wearing a garment of so many times a candidate's vertices costs, in candidates.
fn wearing(vertices: f64) -> f64 {
    vertices.powf(1.25)
}

/// How a template was chosen.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct TemplateChoice {
    /// Upper or lower.
    pub kind: GarmentKind,
    /// The scan that samples were compared with.
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

/// The person, ready to try garments on.
pub(super) struct Choosing<'a> {
    context: &'a Context<'a>,
    body: Arc<dyn BodyModel>,
    subject: &'a Subject,
    /// In the scans nearest to the standard pose, nearest first.
    standing: Vec<Standing<'a>>,
    skin: Vec<Vec3>,
    tailor: Tailor,
}

/// The person in one scan.
struct Standing<'a> {
    /// Points with their labels.
    of: &'a SubjectScan,
    /// Triangles say where labels meet.
    mesh: TriMesh,
    posed: PosedBody,
}

/// What a scan shows of a garment, points thinned [m].
struct Shown {
    points: Vec<Vec3>,
    edges: Vec<Vec3>,
    rims: Vec<Rim>,
    joined: Vec<Rim>,
    cover: Vec<Vec3>,
}

impl Shown {
    fn seen(&self) -> Seen<'_> {
        Seen {
            points: &self.points,
            edges: &self.edges,
            rims: &self.rims,
            joined: &self.joined,
            covered_by: &self.cover,
        }
    }
}

/// A garment that is worn already: triangles, and vertices in each scan [m].
type Inner = (Vec<[u32; 3]>, Vec<Vec<Vec3>>);

impl<'a> Choosing<'a> {
    pub(super) fn new(
        context: &'a Context<'a>,
        body: Arc<dyn BodyModel>,
        subject: &'a Subject,
        scans: &Scans,
    ) -> Result<Self> {
        let joints = &body.describe().joints;
        let mut order: Vec<(f64, &SubjectScan)> =
            subject.training_scans().map(|s| (distance_to_standard(&s.pose, joints), s)).collect();
        order.sort_by(|a, b| a.0.total_cmp(&b.0));
        order.truncate(context.config.templates.scans);
        if order.is_empty() {
            return Err(Error::config("subject", "no training scan", "hold out fewer scans"));
        }
        let mut parameters = body.rest(&subject.shape);
        parameters.displacement.clone_from(&subject.displacement);
        let rest = BodyRest::from_model(&*body, &parameters)?;
        let skin = rest.mesh.vertices.clone();
        let stands = |of: &'a SubjectScan| -> Result<Standing<'a>> {
            let file = scans.list.iter().find(|file| file.name == of.name).ok_or_else(|| {
                Error::config("subject", format!("scan {} is not there any more", of.name), "put it back")
            })?;
            let mesh = read_framed(context.files, file, &of.frame)?.mesh;
            Error::check_length(&format!("labels of scan {}", of.name), mesh.vertices.len(), of.points.labels.len())?;
            Ok(Standing { of, mesh, posed: body.forward(&parameters.posed(&of.pose))? })
        };
        let standing = order.into_iter().map(|(_, of)| stands(of)).collect::<Result<_>>()?;
        Ok(Self { context, subject, standing, skin, tailor: Tailor::new(rest)?, body })
    }

    /// All configured garments with how they were chosen, upper first; progress goes from the one share to the other.
    pub(super) fn all(&self, [from, to]: [f64; 2]) -> Result<(Vec<FittedGarment>, Vec<TemplateChoice>)> {
        let config = self.context.config;
        let mut wanted: Vec<(GarmentKind, &str, &GarmentConfig)> = config.garments().collect();
        let outer = outer(config.finetune.layering.order);
        // What lies inside is put on first.
        wanted.sort_by_key(|w| w.0 == outer);
        let mut inner: Option<Inner> = None;
        let mut found = Vec::new();
        let effort = |settings: &GarmentConfig| effort(settings, self.standing.len());
        let whole: f64 = wanted.iter().map(|w| effort(w.2)).sum();
        let mut before = 0.0;
        for (kind, key, settings) in wanted {
            let own = effort(settings);
            let tell = |spent: f64| {
                let done = (before + spent.min(own)) / whole;
                self.context.progress.set(from + (to - from) * done, &format!("{kind} template"));
            };
            tell(0.0);
            let fabric: Arc<dyn MaterialModel> = Arc::from(material(settings.worn_in(), key, None)?);
            let (template, choice, worn) = self.choose(kind, settings, &fabric, inner.as_ref(), &tell)?;
            before += own;
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
        tell: &(impl Fn(f64) + Sync),
    ) -> Result<(Template, TemplateChoice, Inner)> {
        let covered = kind != outer(self.context.config.finetune.layering.order);
        let nearest = &self.standing[0];
        let shown = self.standing.iter().map(|s| s.shown(kind, covered, &self.skin)).collect::<Result<Vec<_>>>()?;
        let all: Vec<Seen<'_>> = shown.iter().map(Shown::seen).collect();
        let seen = all[0];
        let points = seen.points;
        let options = ChooseOptions { covered_by: seen.covered_by };
        let source = settings.template.template(self.context.files)?;
        let tailor = &self.tailor;
        let styles = source.styles(tailor, kind, settings.styles, self.context.config.run.seed)?;
        let candidates = templates(&*source, tailor, &styles, CANDIDATE_RESOLUTION)?;
        let weights = &self.body.describe().weights;
        let pose =
            |t: &Template, scan: usize| pose_by_nearest_vertex(t, weights, &self.standing[scan].posed.transforms);
        let shapes = candidates.iter().map(|t| pose(t, 0)).collect::<Result<Vec<_>>>()?;
        let posed = choose_template(&shapes, points, &options)?;
        let mut order: Vec<usize> = (0..candidates.len()).collect();
        order.sort_by(|&a, &b| posed.report[a].squared.total_cmp(&posed.report[b].squared));
        let median = posed.report[order[order.len() / 2]].squared;
        order.truncate(settings.worn.max(1));
        let spent = Mutex::new(0.0);
        let coarse = candidates.first().map_or(1, |c| c.mesh.vertices.len().max(1)) as f64;
        let wear = |t: &Template, scan: usize, like: Option<WornAs<'_>>| {
            if settings.worn == 0 {
                return pose(t, scan);
            }
            let worn = self.worn(t, scan, like, settings, (fabric, inner));
            if let Ok(mut spent) = spent.lock() {
                let share = if like.is_some() && t.resolution_m < CANDIDATE_RESOLUTION { FROM_A_GUESS } else { 1.0 };
                *spent += share * wearing(t.mesh.vertices.len() as f64 / coarse);
                tell(*spent);
            }
            worn
        };
        let worn: Vec<Result<Vec<Vec3>>> = order.par_iter().map(|&i| wear(&candidates[i], 0, None)).collect();
        let worn = worn.into_iter().collect::<Result<Vec<_>>>()?;
        let sampled = choose_template(&worn, points, &options)?;
        let (best, vertices) = (&candidates[order[sampled.index]], worn[sampled.index].clone());
        let start = Worn { template: best.clone(), vertices };
        let wear = |t: &Template, scan: usize, like: WornAs<'_>| wear(t, scan, Some(like));
        let refined = refine(&*source, tailor, start, CANDIDATE_RESOLUTION, seen, |t, like| wear(t, 0, like))?;
        let after = choose_template(&refined.worn, points, &options)?;
        let resolutions = [CANDIDATE_RESOLUTION, settings.resolution_m];
        let finished = finish(&*source, tailor, &refined, resolutions, &all[..all.len().min(STYLED)], wear)?;
        let finished = ease(tailor, finished, &all, wear)?;
        let choice = TemplateChoice {
            kind,
            scan: nearest.of.name.clone(),
            styles: styles.len(),
            best_sample_mm2: sampled.report[sampled.index].squared * 1e6,
            median_sample_mm2: median * 1e6,
            refined_mm2: after.report[after.index].squared * 1e6,
            edges_off_mm: finished.edges_off_m * 1e3,
            measures: finished.template.measures(),
        };
        let worn = (finished.template.mesh.faces.clone(), finished.worn);
        Ok((finished.template, choice, worn))
    }

    /// A candidate at rest on the body in a scan's pose [m], from where skinning puts it, or from how another one hangs.
    fn worn(
        &self,
        template: &Template,
        scan: usize,
        like: Option<WornAs<'_>>,
        settings: &GarmentConfig,
        (fabric, inner): (&Arc<dyn MaterialModel>, Option<&Inner>),
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
        let track = scene.track(std::slice::from_ref(&self.standing[scan].of.pose))?;
        let under = inner.map(|(faces, worn)| Under { faces, frames: &worn[scan..=scan] });
        let contact = scene.contact(&garment)?;
        let around = (&track, &contact, under);
        let hung = |like: WornAs<'_>| -> Result<Vec<Vec3>> {
            let [there, here] = [like.scan, scan].map(|s| &self.standing[s].posed.transforms);
            let hung = hung_like(template, like, &self.body.describe().weights, there)?;
            Ok(if like.scan == scan { hung } else { garment.carried(&hung, there, here) })
        };
        let guess = like.map(hung).transpose()?;
        let simulation = simulate_from(&garment, fabric.clone(), around, guess.as_deref(), &options, &|_, _| {})?;
        simulation
            .frames
            .into_iter()
            .next()
            .ok_or_else(|| Error::numerics("draping of a candidate", "there is no frame", "report this as a defect"))
    }
}

impl Standing<'_> {
    /// `skin`: the body's vertices at rest [m].
    fn shown(&self, kind: GarmentKind, covered: bool, skin: &[Vec3]) -> Result<Shown> {
        let cover = if covered { thin(&self.of_label(label_of(other(kind))), CANDIDATE_POINTS) } else { Vec::new() };
        let ends = self.ends(kind, covered, skin);
        Ok(Shown {
            points: self.seen(kind)?,
            edges: thin(&ends.points, EDGE_POINTS),
            rims: ends.rims,
            joined: ends.joined,
            cover,
        })
    }
    /// Scan points of a garment, thinned.
    fn seen(&self, kind: GarmentKind) -> Result<Vec<Vec3>> {
        let points = self.of_label(label_of(kind));
        if points.is_empty() {
            return Err(Error::mesh(
                &self.of.name,
                "labels",
                format!("no point belongs to the {kind} garment"),
                "check the segmenter and the labels of the scan",
            ));
        }
        Ok(thin(&points, CANDIDATE_POINTS))
    }
    fn of_label(&self, label: Label) -> Vec<Vec3> {
        self.of.points.with_label(label).0
    }
    fn ends(&self, kind: GarmentKind, covered: bool, skin: &[Vec3]) -> Ends {
        let hiding = covered.then(|| label_of(other(kind)));
        let grid = NearestGrid::from_points(&self.posed.vertices);
        let at_rest = |p: &Vec3| grid.nearest_point(p).map(|(v, _)| skin[v as usize]);
        // A hand on a hip is beside cloth that does not end there.
        let goes_on = |cloth: &Vec3, beside: &Vec3| match (at_rest(cloth), at_rest(beside)) {
            (Some(a), Some(b)) => (a - b).norm() < SAME_PLACE,
            _ => true,
        };
        Ends::new(&self.mesh, &self.of.points.labels, label_of(kind), hiding, goes_on)
    }
}

fn other(kind: GarmentKind) -> GarmentKind {
    match kind {
        GarmentKind::Upper => GarmentKind::Lower,
        GarmentKind::Lower => GarmentKind::Upper,
    }
}
