//! Which garment a person wears: of many styles the one that lies nearest to a scan when it is worn, then refined (Sec. 3.1).
//!
//! A template against a scan would measure how cloth hangs: candidates are put on the fitted body in the scan's pose and brought to
//! rest, the inner garment first, the outer one over it.

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
use caphy_core::query::{Adjacency, NearestGrid, boundary_loops};
use caphy_core::scan::Label;
use caphy_core::{Error, Result, TriMesh, Vec3};
use caphy_garment::solver::SolverSettings;
use caphy_garment::template::{
    BodyRest, ChooseOptions, GarmentKind, GarmentMeasures, Seen, Tailor, Template, Worn, WornAs, choose_template, ease,
    finish, hung_like, pose_by_nearest_vertex, refine, templates,
};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};

/// Edge length of the templates that styles are compared with [m]: style does not show in detail.
const CANDIDATE_RESOLUTION: f64 = 0.035;
/// Scan points per garment that styles are compared with.
const CANDIDATE_POINTS: usize = 3000;
/// Points of the edges of a garment that styles are refined with.
const EDGE_POINTS: usize = 600;
/// Skin under cloth, and skin beside it where it ends, are this near to each other on the body at rest, where limbs are apart [m].
const SAME_PLACE: f64 = 0.07;
/// Widest gap of a scan between cloth and where it ends, in its edges, and how far from ends without a gap ends at a gap are [m].
const GAP: f64 = 4.0;
const BESIDE: f64 = 0.04;
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
    let coarse = settings.worn + 25 + 5 * scans.saturating_sub(1);
    coarse as f64 + 6.0 * scans as f64 * FROM_A_GUESS * wearing((CANDIDATE_RESOLUTION / settings.resolution_m).powi(2))
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

/// What a scan shows of a garment, thinned [m].
struct Shown {
    points: Vec<Vec3>,
    edges: Vec<Vec3>,
    cover: Vec<Vec3>,
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
        let Shown { points, edges, cover } = &nearest.shown(kind, covered, &self.skin)?;
        let options = ChooseOptions { covered_by: cover };
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
            let guess =
                like.map(|like| hung_like(t, like, weights, &self.standing[scan].posed.transforms)).transpose()?;
            let worn = self.worn(t, scan, guess.as_deref(), settings, (fabric, inner));
            if let Ok(mut spent) = spent.lock() {
                let share = if guess.is_some() && t.resolution_m < CANDIDATE_RESOLUTION { FROM_A_GUESS } else { 1.0 };
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
        let seen = Seen { points, edges, covered_by: cover };
        let refined = refine(&*source, tailor, start, CANDIDATE_RESOLUTION, seen, |t, like| wear(t, 0, like))?;
        let after = choose_template(&refined.worn, points, &options)?;
        let shown =
            self.standing[1..].iter().map(|s| s.shown(kind, covered, &self.skin)).collect::<Result<Vec<_>>>()?;
        let more = shown.iter().map(|s| Seen { points: &s.points, edges: &s.edges, covered_by: &s.cover });
        let all: Vec<Seen<'_>> = std::iter::once(seen).chain(more).collect();
        let resolutions = [CANDIDATE_RESOLUTION, settings.resolution_m];
        let finished = finish(&*source, tailor, &refined, resolutions, &all, wear)?;
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

    /// A candidate at rest on the body in a scan's pose [m], from where skinning or a guess puts it [m].
    fn worn(
        &self,
        template: &Template,
        scan: usize,
        guess: Option<&[Vec3]>,
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
        let simulation = simulate_from(&garment, fabric.clone(), around, guess, &options, &|_, _| {})?;
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
        Ok(Shown { points: self.seen(kind)?, edges: thin(&self.edges(kind, covered, skin), EDGE_POINTS), cover })
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
    fn edges(&self, kind: GarmentKind, covered: bool, skin: &[Vec3]) -> Vec<Vec3> {
        let hiding = covered.then(|| label_of(other(kind)));
        let grid = NearestGrid::from_points(&self.posed.vertices);
        let at_rest = |p: &Vec3| grid.nearest_point(p).map(|(v, _)| skin[v as usize]);
        // A hand on a hip is beside cloth that does not end there.
        let goes_on = |cloth: &Vec3, beside: &Vec3| match (at_rest(cloth), at_rest(beside)) {
            (Some(a), Some(b)) => (a - b).norm() < SAME_PLACE,
            _ => true,
        };
        ends(&self.mesh, &self.of.points.labels, label_of(kind), hiding, goes_on)
    }
}

/// Where cloth of a label ends in a scan [m]: at skin, and at the other garment unless that one hides it; also across a gap that no camera
/// looked into, as under a collar. Other holes are no ends, nor is what only touches: the body `goes_on` from a place of cloth to one
/// beside it.
fn ends(
    mesh: &TriMesh,
    labels: &[Label],
    own: Label,
    hiding: Option<Label>,
    goes_on: impl Fn(&Vec3, &Vec3) -> bool,
) -> Vec<Vec3> {
    let place = |v: u32| mesh.vertices[v as usize];
    let mut lengths: Vec<f64> = mesh.faces.iter().map(|f| (place(f[1]) - place(f[0])).norm()).collect();
    lengths.sort_by(f64::total_cmp);
    let typical = lengths.get(lengths.len() / 2).copied().unwrap_or(0.0);
    let ends_at = |label: Label| label != own && hiding != Some(label);
    let mut out = Vec::new();
    for face in &mesh.faces {
        // Each edge is met once from either of its triangles.
        for (a, b) in [(face[0], face[1]), (face[1], face[2]), (face[2], face[0])] {
            if labels[a as usize] == own && ends_at(labels[b as usize]) && goes_on(&place(a), &place(b)) {
                // Labels change somewhere between; beyond a step in depth cloth goes no farther than elsewhere.
                let way = place(b) - place(a);
                out.push(place(a) + way * (0.5 * (typical / way.norm().max(1e-12)).min(1.0)));
            }
        }
    }
    let sure = NearestGrid::from_points(&out);
    let loops = boundary_loops(&mesh.faces);
    let rim: Vec<u32> = loops.iter().flatten().copied().collect();
    // Along the rim, from the vertex before to the one after.
    let mut along: BTreeMap<u32, Vec3> = BTreeMap::new();
    for ring in &loops {
        for (i, &v) in ring.iter().enumerate() {
            let [before, after] = [i + ring.len() - 1, i + 1].map(|at| place(ring[at % ring.len()]));
            along.insert(v, (after - before).try_normalize(0.0).unwrap_or_else(Vec3::zeros));
        }
    }
    let own_rim: Vec<u32> = rim.iter().copied().filter(|v| labels[*v as usize] == own).collect();
    let nearest = NearestGrid::from_points(&own_rim.iter().map(|&v| place(v)).collect::<Vec<_>>());
    let gap = GAP * typical;
    // From the other side of the gap: the rim of a hole that lies across an end goes on into the cloth.
    let mut met: Vec<u32> = Vec::new();
    for &v in rim.iter().filter(|v| ends_at(labels[**v as usize])) {
        let Some((near, square)) = nearest.nearest_point(&place(v)) else { continue };
        let near = own_rim[near as usize];
        if square < gap * gap && goes_on(&place(near), &place(v)) {
            met.push(near);
        }
    }
    met.sort_unstable();
    met.dedup();
    // Where cloth can be followed to its end, a rim beside that is the bottom of a gap that cameras look into.
    met.retain(|&v| sure.nearest_within(&place(v).into(), BESIDE * BESIDE).is_none());
    let neighbours = Adjacency::new(mesh.vertices.len(), &mesh.faces);
    let own_of = |v: u32| neighbours.of(v as usize).iter().copied().filter(|&n| labels[n as usize] == own);
    out.extend(met.into_iter().map(|v| {
        // The last vertex that is seen is half an edge inside on average.
        let ring: Vec<Vec3> = own_of(v).flat_map(own_of).filter(|&n| n != v).map(place).collect();
        let inside = ring.iter().sum::<Vec3>() / ring.len().max(1) as f64;
        let way = place(v) - inside;
        let along = along.get(&v).copied().unwrap_or_else(Vec3::zeros);
        let outward = (way - along * along.dot(&way)).try_normalize(1e-9).unwrap_or_else(Vec3::zeros);
        place(v) + outward * (if ring.is_empty() { 0.0 } else { 0.5 * typical })
    }));
    out
}

fn other(kind: GarmentKind) -> GarmentKind {
    match kind {
        GarmentKind::Upper => GarmentKind::Lower,
        GarmentKind::Lower => GarmentKind::Upper,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cloth_ends_at_skin_and_across_gaps_and_not_at_holes() {
        // A sheet of 1 cm squares: cloth up to x = 0.1, skin from there on.
        let square = |i: u32| [[i, i + 1, i + 21], [i + 1, i + 22, i + 21]];
        let sheet = |keep: &dyn Fn(u32) -> bool| TriMesh {
            vertices: (0..441).map(|i| Vec3::new(f64::from(i % 21), f64::from(i / 21), 0.0) * 0.01).collect(),
            faces: (0..420).filter(|i| i % 21 < 20 && keep(*i)).flat_map(square).collect(),
        };
        let label = |i: usize| if i % 21 <= 10 { Label::Upper } else { Label::Body };
        let labels: Vec<Label> = (0..441).map(label).collect();
        let anywhere = |_: &Vec3, _: &Vec3| true;
        let whole = ends(&sheet(&|_| true), &labels, Label::Upper, None, anywhere);
        // Half an edge beyond the cloth; its own last vertex at the sheet's rim.
        assert!(whole.len() > 21 && whole.iter().all(|p| p.x > 0.0999 && p.x < 0.11), "{whole:?}");
        assert!(ends(&sheet(&|_| true), &labels, Label::Upper, Some(Label::Body), anywhere).is_empty());
        // Something that only touches the cloth along half of that.
        let touching = ends(&sheet(&|_| true), &labels, Label::Upper, None, |a, _| a.y > 0.1);
        assert!(touching.len() > 9 && touching.iter().all(|p| p.y > 0.09), "{touching:?}");
        // A gap of two squares beside the cloth, and a hole in the middle of it.
        let torn = sheet(&|i| !(10..12).contains(&(i % 21)) && (i % 21, i / 21) != (4, 9));
        let across = ends(&torn, &labels, Label::Upper, None, anywhere);
        assert!(across.len() >= 20, "{across:?}");
        // Half an edge beyond the last vertex; at the sheet's corners it leans.
        let inner = across.iter().filter(|p| p.y > 0.005 && p.y < 0.195);
        assert!(inner.clone().count() >= 19 && inner.clone().all(|p| (p.x - 0.105).abs() < 1e-9), "{across:?}");
        // The gap is closed along a part: around there the closed part says where the cloth ends.
        let partly = sheet(&|i| !(10..12).contains(&(i % 21)) || i / 21 < 8);
        let both = ends(&partly, &labels, Label::Upper, None, anywhere);
        let at_gap: Vec<&Vec3> = both.iter().filter(|p| p.y > 0.081).collect();
        assert!(at_gap.len() > 5 && at_gap.iter().all(|p| p.y > 0.08 + BESIDE - 0.011), "{at_gap:?}");
    }
}
