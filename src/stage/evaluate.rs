//! What came out: Chamfer distances on held-out scans, penetrations, energies, and errors to the truth where there is one.

use super::optimise::Estimates;
use super::preprocess::{Subject, SubjectScan, TemplateChoice};
use super::scans::read_framed;
use super::train::{Nets, config_key};
use super::{Context, Scans, StageOutput, material};
use crate::config::{SubjectConfig, TrainConfig};
use crate::garment::FittedGarment;
use crate::inference::{Play, clearance, contacts, play};
use crate::measure::{Fit, Perceptual, ScanGarment, pose_distance, scan_spectrum, shown};
use crate::physics::{Physics, solver_forces};
use crate::pictures::{self, Dressed};
use crate::plot::number;
use crate::quality::{Spectrum, SpectrumFilter};
use crate::registered::{BodyError, body_error, joint_error, true_body};
use crate::scene::{Scene, scan_frames};
use crate::simulate::{SimulationOptions, Steps, simulate_layers};
use crate::synth::Truth;
use crate::track::BodyTrack;
use caphy_core::files::Files;
use caphy_core::lanes::Frames;
use caphy_core::material::MaterialModel;
use caphy_core::pose::{Pose, SMPLX_JOINTS};
use caphy_core::query::NearestGrid;
use caphy_core::{Error, Result, TriMesh, Vec3, mesh};
use caphy_formats::npz::Npz;
use caphy_garment::energy::LayeringOrder;
use caphy_garment::estimate::reduction;
use caphy_garment::solver::SolverSettings;
use caphy_garment::template::{GarmentKind, MeasureErrors};
use caphy_render::Layer;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::fmt::Write;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Instant;

/// All measurements.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Scores {
    /// One per scan.
    pub scans: Vec<ScanScore>,
    /// Share of upper vertices inside the lower garment in training motion, before and after fine-tuning; none for one
    /// garment.
    pub layering: Option<[f64; 2]>,
    /// Fabric against the truth, per garment, where it is known.
    pub fabrics: Vec<FabricScore>,
    /// Templates against the true garments' patterns, where they are known.
    pub templates: Vec<TemplateScore>,
    /// Pictures, relative to the run directory.
    pub pictures: Vec<PathBuf>,
}

impl StageOutput for Scores {
    fn files(&self) -> Vec<PathBuf> {
        self.pictures.clone()
    }
}

/// One scan's measurements.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct ScanScore {
    /// The scan.
    pub name: String,
    /// Whether nothing was learned from it.
    pub held_out: bool,
    /// One per garment.
    pub garments: Vec<GarmentScore>,
    /// Median and largest distance of fitted to true joints [mm].
    pub joint_error_mm: Option<[f64; 2]>,
    /// The naked body against the true one.
    pub body_error: Option<BodyError>,
    /// Share of vertices whose fused label is the stored one.
    pub label_agreement: Option<f64>,
}

/// One garment in one scan's pose.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct GarmentScore {
    /// Upper or lower.
    pub kind: GarmentKind,
    /// The avatar.
    pub net: Fit,
    /// The skinned template, without the net.
    pub skinned: Fit,
    /// The true garment, where there is one: what noise and holes of the scan leave of a perfect answer.
    pub truth: Option<Fit>,
    /// The reference solver with the true fabric, where it was asked for: what body and template leave of it.
    pub solver: Option<Fit>,
    /// Energy of the scan's own normals by wavelength, seen at the avatar's vertices.
    pub scan_spectrum: Spectrum,
    /// Share of vertices deeper inside the body than the configured limit.
    pub penetrating: f64,
    /// Deepest vertex [mm], 0 when none is inside.
    pub deepest_mm: f64,
    /// Strain and bending energy [J].
    pub elastic_j: f64,
    /// The same of the skinned template [J].
    pub skinned_elastic_j: f64,
    /// From the nearest other pose that a scan was learnt from: root mean square angle of the joints that the net is told of [°].
    pub nearest_scan_deg: Option<f64>,
    /// From the nearest pose of the training motion [°].
    pub nearest_motion_deg: Option<f64>,
}

/// A template against the true garment's.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct TemplateScore {
    /// Upper or lower.
    pub kind: GarmentKind,
    /// Template less truth.
    pub errors: MeasureErrors,
}

/// Fabric before and after estimation against the truth.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct FabricScore {
    /// Upper or lower.
    pub kind: GarmentKind,
    /// Per group: name, median ratio to the truth at the start, and after estimation.
    pub groups: Vec<(String, f64, f64)>,
}

impl GarmentScore {
    /// What is compared between runs, by name and unit.
    pub fn named(&self) -> Vec<(&'static str, f64)> {
        let mut all = self.net.named();
        all.extend([
            ("inside body, %", 100.0 * self.penetrating),
            ("deepest, mm", self.deepest_mm),
            ("strain + bending, J", self.elastic_j),
        ]);
        all
    }
}

impl Scores {
    /// Means over the held-out scans (over all, where none was) of everything that is measured, as text: the avatar beside the skinned
    /// template and the floors.
    pub fn seen(&self) -> String {
        let any = self.scans.iter().any(|s| s.held_out);
        let mut out = String::new();
        for kind in [GarmentKind::Upper, GarmentKind::Lower] {
            let rows: Vec<&GarmentScore> = self
                .scans
                .iter()
                .filter(|s| s.held_out == any)
                .filter_map(|s| s.garments.iter().find(|g| g.kind == kind))
                .collect();
            if rows.is_empty() {
                continue;
            }
            let scans = if any { "held-out scans" } else { "scans" };
            let title = format!("{kind}, mean of {} {scans}", rows.len());
            let _ = writeln!(out, "{title:<50} {:>9} {:>9} {:>9} {:>9}", "avatar", "skinned", "solver*", "truth*");
            // One column of means; none where a row has none.
            let column = |fit: fn(&GarmentScore) -> Option<&Fit>| -> Option<Vec<f64>> {
                let all: Vec<_> = rows.iter().map(|g| Some(fit(g)?.named())).collect::<Option<_>>()?;
                let mean = |i: usize| all.iter().map(|values| values[i].1).sum::<f64>() / all.len() as f64;
                Some((0..all[0].len()).map(mean).collect())
            };
            let columns = [
                column(|g| Some(&g.net)),
                column(|g| Some(&g.skinned)),
                column(|g| g.solver.as_ref()),
                column(|g| g.truth.as_ref()),
            ];
            for (i, (name, _)) in rows[0].net.named().iter().enumerate() {
                let cells = columns.iter().map(|c| c.as_ref().map_or("–".into(), |c| number(c[i])));
                let cells: Vec<String> = cells.map(|c| format!("{c:>9}")).collect();
                let _ = writeln!(out, "  {name:<48} {}", cells.join(" "));
            }
            let n = rows.len() as f64;
            let mut bands = [0.0; 3];
            for g in &rows {
                (0..3).for_each(|k| bands[k] += g.scan_spectrum.0[k] / n);
            }
            let _ = writeln!(out, "  the scan's own normals, fine to coarse: {}", bands.map(number).join(", "));
            for (what, angle) in [
                ("scan that was learnt from", (|g| g.nearest_scan_deg) as fn(&GarmentScore) -> Option<f64>),
                ("pose of the training motion", |g| g.nearest_motion_deg),
            ] {
                let angles: Option<Vec<f64>> = rows.iter().map(|g| angle(g)).collect();
                if let Some(angles) = angles {
                    let _ =
                        writeln!(out, "  joints from the nearest {what}: {} °", number(angles.iter().sum::<f64>() / n));
                }
            }
        }
        if !self.perceptual() {
            out.push_str("Normal maps and MS-SSIM stand in for VGG-16's perceptual distance.\n");
        }
        out.push_str(
            "*floors: the reference solver with the true fabric (evaluate.solver_floor), and the true garment.\n",
        );
        out
    }

    /// Whether a network was asked.
    pub fn perceptual(&self) -> bool {
        self.scans.iter().flat_map(|s| &s.garments).any(|g| g.net.perceptual.is_some())
    }

    /// Means over the held-out scans and over the others, per garment, by name and unit.
    pub fn means(&self) -> Vec<(String, f64)> {
        let mut out = Vec::new();
        for held_out in [true, false] {
            for kind in [GarmentKind::Upper, GarmentKind::Lower] {
                let of_kind = |s: &ScanScore| s.garments.iter().find(|g| g.kind == kind).map(GarmentScore::named);
                let rows: Vec<_> = self.scans.iter().filter(|s| s.held_out == held_out).filter_map(of_kind).collect();
                let Some(first) = rows.first() else { continue };
                for (i, (name, _)) in first.iter().enumerate() {
                    let mean = rows.iter().map(|r| r[i].1).sum::<f64>() / rows.len() as f64;
                    let scans = if held_out { "held out" } else { "learnt from" };
                    out.push((format!("{kind}, {scans}: {name}"), mean));
                }
            }
        }
        out
    }

    /// The table as text.
    pub fn table(&self) -> String {
        let mut out = String::from(
            "Mean distances in mm (not squared); in brackets the skinned template without the net.\n\
             scan                  garment  scan→surface     vertices→scan    inside body  strain+bending\n",
        );
        for scan in &self.scans {
            for g in &scan.garments {
                let name = format!("{}{}", scan.name, if scan.held_out { " (held out)" } else { "" });
                // Writing to a String cannot fail.
                let _ = writeln!(
                    out,
                    "{name:<21} {:<8} {:<6.2} {:<9} {:<6.2} {:<9} {:>6.2} %     {:.4} J ({:.4})",
                    g.kind.to_string(),
                    g.net.scan_to_garment_mm,
                    format!("({:.2})", g.skinned.scan_to_garment_mm),
                    g.net.garment_to_scan_mm,
                    format!("({:.2})", g.skinned.garment_to_scan_mm),
                    100.0 * g.penetrating,
                    g.elastic_j,
                    g.skinned_elastic_j
                );
            }
        }
        out.push_str(&self.seen());
        for scan in &self.scans {
            if let Some([median, most]) = scan.joint_error_mm {
                let _ =
                    writeln!(out, "{}: joints {median:.1} mm from the truth (median), {most:.1} mm at most", scan.name);
            }
            if let Some(b) = scan.body_error {
                let girth = if b.outward_mm[1] < 0.0 { "thin" } else { "fat" };
                let _ = writeln!(
                    out,
                    "{}: body {:.1} mm from the truth on skin (95 %: {:.1}), {:.1} mm under clothes (95 %: {:.1}), {:.1} mm too {girth} there",
                    scan.name,
                    b.skin_mm[0],
                    b.skin_mm[1],
                    b.covered_mm[0],
                    b.covered_mm[1],
                    b.outward_mm[1].abs()
                );
            }
            if let Some(share) = scan.label_agreement {
                let _ = writeln!(out, "{}: {:.2} % of labels as stored with the scan", scan.name, 100.0 * share);
            }
        }
        if let Some([before, after]) = self.layering {
            let _ = writeln!(
                out,
                "upper garment inside the lower one: {:.2} % of vertices before, {:.2} % after fine-tuning",
                100.0 * before,
                100.0 * after
            );
        }
        for template in &self.templates {
            let area = 100.0 * template.errors.area;
            let _ = write!(out, "{} template against the truth: area {area:+.1} %", template.kind);
            for (name, error) in &template.errors.lengths_m {
                let _ = write!(out, ", {name} {:+.0} mm", 1e3 * error);
            }
            out.push('\n');
        }
        for fabric in &self.fabrics {
            for (group, before, after) in &fabric.groups {
                let _ =
                    writeln!(out, "{} {group}: {before:.2} × the truth at the start, {after:.2} × after", fabric.kind);
            }
        }
        out
    }
}

/// Time of the comparison of all scans, by its name in `timings.json` [s].
pub(crate) const SCANS_TIME: &str = "evaluate: scans";

/// Measures an avatar.
pub fn run(
    context: &Context<'_>,
    subject: &Subject,
    nets: &Nets,
    avatar: &Nets,
    fabrics: &[Estimates],
    scans: &Scans,
) -> Result<Scores> {
    let scene = Scene::new(context, subject)?;
    let poses: Vec<_> = subject.scans.iter().map(|s| s.pose.clone()).collect();
    let track = scene.track(&poses)?;
    let training = scene.scan_track(subject)?;
    let motion = scene.motion(context)?.track;
    let truth = true_joints(context, subject, scans)?;
    let mut rows: Vec<ScanScore> = subject
        .scans
        .iter()
        .zip(truth)
        .map(|(scan, truth)| {
            let fitted = scene.body.forward(&scene.subject.posed(&scan.pose))?;
            Ok(ScanScore {
                name: scan.name.clone(),
                held_out: scan.held_out,
                garments: Vec::new(),
                joint_error_mm: truth.map(|t| joint_error(&fitted.joints, &t)),
                body_error: body_error_of(&scene, scans, scan, &fitted.vertices)?,
                label_agreement: scan.label_agreement,
            })
        })
        .collect::<Result<_>>()?;
    let (mut worn, mut skinned) = (Vec::new(), Vec::new());
    for (fitted, trained) in subject.garments.iter().zip(&avatar.garments) {
        worn.push(play(fitted, trained, &context.config.net, &track, Play::Poses)?);
        skinned.push(track.transforms.iter().map(|t| fitted.skinned(t)).collect::<Result<Vec<_>>>()?);
    }
    let solved = solver_floor(context, subject, &scene, &poses)?;
    let visible = subject
        .garments
        .iter()
        .map(|fitted| Ok(scan_frames(context, subject, fitted, training.clone())?.visible))
        .collect::<Result<Vec<_>>>()?;
    let filters: Vec<SpectrumFilter> = subject.garments.iter().map(|g| SpectrumFilter::new(&g.mesh)).collect();
    let network = context.config.evaluate.perceptual_network.as_ref();
    let network = network.map(|network| Perceptual::open(network, context.files)).transpose()?;
    let finished = AtomicUsize::new(0);
    let started = Instant::now();
    // One error for one input, whatever the number of threads.
    let compared: Vec<Result<Vec<GarmentScore>>> = subject
        .scans
        .par_iter()
        .enumerate()
        .map(|(i, scan)| {
            let Some(file) = scans.list.iter().find(|file| file.name == scan.name) else { return Ok(Vec::new()) };
            let surface = read_framed(context.files, file, &scan.frame)?.mesh;
            let body = posed_body(&scene, &scan.pose)?;
            let dressed = |shapes: &[Vec<Vec<Vec3>>]| Dressed {
                body: &body,
                garments: shapes.iter().zip(&subject.garments).map(|(s, g)| of_mesh(&s[i], &g.mesh)).collect(),
            };
            let (avatar_figure, skinned_figure) = (dressed(&worn), dressed(&skinned));
            let solver_figure = solved.as_ref().filter(|s| !s[0][i].is_empty()).map(|shapes| dressed(shapes));
            let mut scores = Vec::new();
            for (k, fitted) in subject.garments.iter().enumerate() {
                let compared = ScanGarment::new(&scan.name, fitted.kind, &surface, &scan.points, network.as_ref())?;
                let fit = |figure: &Dressed<'_>| compared.compare(figure, k, &visible[k], &filters[k]);
                let truth = scans
                    .truth
                    .as_ref()
                    .zip(true_index(scans, &scan.name))
                    .map(|(t, index)| true_fit(&scene, t, index, scan, &compared));
                let garment = &avatar_figure.garments[k];
                scores.push(GarmentScore {
                    net: fit(&avatar_figure)?,
                    skinned: fit(&skinned_figure)?,
                    truth: truth.transpose()?.flatten(),
                    solver: solver_figure.as_ref().map(fit).transpose()?,
                    scan_spectrum: scan_spectrum(&scan.points, garment, fitted.kind, &visible[k], &filters[k]),
                    ..GarmentScore::unmeasured(fitted.kind)
                });
            }
            let count = finished.fetch_add(1, Ordering::Relaxed) + 1;
            context.progress.set(0.9 * count as f64 / subject.scans.len() as f64, &scan.name);
            Ok(scores)
        })
        .collect();
    context.time(SCANS_TIME, started.elapsed().as_secs_f64());
    for (row, scores) in rows.iter_mut().zip(compared) {
        row.garments = scores?;
    }
    for (k, (fitted, trained)) in subject.garments.iter().zip(&avatar.garments).enumerate() {
        let table = &context.config.garment(fitted.kind)?.material;
        let model = Arc::from(material(table, config_key(fitted.kind), trained.material.as_deref())?);
        let rest = fitted.rest(&*model)?;
        let train = &context.config.train;
        let map = scene.contact(fitted)?;
        let physics = Physics::<f64>::new(&rest, model, &train.contact, trained.fps, &train.weights)?;
        for (i, scan) in subject.scans.iter().enumerate() {
            let Some(score) = rows[i].garments.get_mut(k) else { continue };
            let shape = &worn[k][i];
            let inside = clearance(shape, &contacts(&map, &track, i, shape)?);
            let limit = context.config.evaluate.penetration_m;
            let deep = inside.iter().filter(|&&d| d < -limit).count();
            score.penetrating = deep as f64 / inside.len().max(1) as f64;
            score.deepest_mm = 0.0 - 1e3 * inside.iter().copied().fold(0.0, f64::min);
            score.elastic_j = elastic(&physics, shape)?;
            score.skinned_elastic_j = elastic(&physics, &skinned[k][i])?;
            let joints = trained.features.joints();
            let nearest = |poses: &mut dyn Iterator<Item = &Pose>| -> Option<f64> {
                poses.map(|pose| pose_distance(&scan.pose, pose, joints).to_degrees()).min_by(f64::total_cmp)
            };
            score.nearest_scan_deg =
                nearest(&mut subject.training_scans().filter(|s| s.name != scan.name).map(|s| &s.pose));
            score.nearest_motion_deg = nearest(&mut motion.poses.iter());
        }
    }
    let pictures = draw(context, subject, &scene, scans, &worn)?;
    let layering = layering(context, subject, &scene, &motion, nets, avatar)?;
    let fabrics = fabric_scores(context, fabrics, scans)?;
    Ok(Scores { scans: rows, layering, fabrics, templates: template_scores(subject, scans), pictures })
}

impl GarmentScore {
    /// Nothing measured yet.
    fn unmeasured(kind: GarmentKind) -> Self {
        let fit = Fit::default();
        Self {
            kind,
            net: fit.clone(),
            skinned: fit,
            truth: None,
            solver: None,
            scan_spectrum: Spectrum::default(),
            penetrating: 0.0,
            deepest_mm: 0.0,
            elastic_j: 0.0,
            skinned_elastic_j: 0.0,
            nearest_scan_deg: None,
            nearest_motion_deg: None,
        }
    }
}

/// A shape with the triangles of its template.
fn of_mesh(vertices: &[Vec3], template: &TriMesh) -> TriMesh {
    TriMesh { vertices: vertices.to_vec(), faces: template.faces.clone() }
}

fn posed_body(scene: &Scene, pose: &Pose) -> Result<TriMesh> {
    let posed = scene.body.forward(&scene.subject.posed(pose))?;
    Ok(TriMesh { vertices: posed.vertices, faces: scene.rest.faces.clone() })
}

/// Place of a scan in the truth.
fn true_index(scans: &Scans, name: &str) -> Option<usize> {
    scans.list.iter().position(|file| file.name == name)
}

/// The fitted body's vertices [m] against the true ones, where those are known.
fn body_error_of(scene: &Scene, scans: &Scans, scan: &SubjectScan, fitted: &[Vec3]) -> Result<Option<BodyError>> {
    let (Some(truth), Some(index)) = (&scans.truth, true_index(scans, &scan.name)) else { return Ok(None) };
    let real = true_body(&*scene.body, truth, index)?;
    Ok(Some(body_error(fitted, &real, &scene.rest.faces, &scan.points)?))
}

/// The true garment against the scan of it.
fn true_fit(
    scene: &Scene,
    truth: &Truth,
    scan: usize,
    points: &SubjectScan,
    compared: &ScanGarment<'_>,
) -> Result<Option<Fit>> {
    let Some(own) = truth.garments.iter().position(|g| g.kind == compared.kind()) else { return Ok(None) };
    let body = of_mesh(&true_body(&*scene.body, truth, scan)?, &scene.rest);
    let garments = truth.garments.iter().map(|g| of_mesh(&g.at_rest[scan], &g.template)).collect();
    let figure = Dressed { body: &body, garments };
    let visible = shown(&figure.garments[own].vertices, compared.kind(), &points.points);
    let filter = SpectrumFilter::new(&truth.garments[own].template);
    compared.compare(&figure, own, &visible, &filter).map(Some)
}

/// Garments of the subject's templates and true fabrics, brought to rest in held-out scans' poses, the upper one over the lower one:
/// vertices [m] per garment and scan, none for scans that were learnt from; `None` unless it is asked for.
fn solver_floor(
    context: &Context<'_>,
    subject: &Subject,
    scene: &Scene,
    poses: &[Pose],
) -> Result<Option<Vec<Vec<Vec<Vec3>>>>> {
    let SubjectConfig::Synthetic(synthetic) = &context.config.subject else { return Ok(None) };
    let held: Vec<usize> = (0..poses.len()).filter(|&i| subject.scans[i].held_out).collect();
    if !context.config.evaluate.solver_floor || held.is_empty() {
        return Ok(None);
    }
    let track = scene.track(&held.iter().map(|&i| poses[i].clone()).collect::<Vec<_>>())?;
    let options = SimulationOptions {
        steps: Steps::QuasiStatic,
        fps: context.config.motion.fps,
        // With the weights of the energies as they are, whatever a net was trained with.
        forces: solver_forces(&TrainConfig { contact: context.config.train.contact, ..TrainConfig::default() }),
        settings: SolverSettings {
            tolerance_n: synthetic.tolerance_n,
            friction: synthetic.friction,
            ..SolverSettings::default()
        },
        disturbance: None,
    };
    let cloth = |fitted: &FittedGarment| -> Result<Arc<dyn MaterialModel>> {
        let (table, key) = match fitted.kind {
            GarmentKind::Upper => (&synthetic.upper_material, "subject.upper_material"),
            GarmentKind::Lower => (&synthetic.lower_material, "subject.lower_material"),
        };
        Ok(Arc::from(table.material(key)?))
    };
    let materials = subject.garments.iter().map(cloth).collect::<Result<Vec<_>>>()?;
    let contact = |garment: &FittedGarment| scene.contact(garment);
    let say = |share: f64, text: &str| context.progress.set(share, &format!("solver, {text}"));
    let order = LayeringOrder::Over;
    let done = simulate_layers(&subject.garments, &materials, order, &track, &contact, &options, &say)?;
    for (fitted, simulation) in subject.garments.iter().zip(&done).filter(|(_, s)| s.unconverged() > 0) {
        context.progress.note(&format!(
            "{}: the solver did not come to rest in {} of {} held-out poses, {:.1e} N left at most",
            fitted.kind,
            simulation.unconverged(),
            held.len(),
            simulation.worst_residual_n()
        ));
    }
    let spread = |frames: Vec<Vec<Vec3>>| {
        let mut all = vec![Vec::new(); poses.len()];
        held.iter().zip(frames).for_each(|(&i, frame)| all[i] = frame);
        all
    };
    Ok(Some(done.into_iter().map(|simulation| spread(simulation.frames)).collect()))
}

/// Scans that are shown beside the avatar.
const SHOWN: usize = 4;

/// Scan and avatar side by side, held-out scans first. `worn`: vertices per garment and scan [m].
fn draw(
    context: &Context<'_>,
    subject: &Subject,
    scene: &Scene,
    scans: &Scans,
    worn: &[Vec<Vec<Vec3>>],
) -> Result<Vec<PathBuf>> {
    let mut order: Vec<usize> = (0..subject.scans.len()).collect();
    order.sort_by_key(|&i| !subject.scans[i].held_out);
    let mut cells = Vec::new();
    for &i in order.iter().take(SHOWN) {
        let scan = &subject.scans[i];
        let Some(file) = scans.list.iter().find(|file| file.name == scan.name) else { continue };
        let surface = read_framed(context.files, file, &scan.frame)?.mesh;
        let colours = pictures::label_colours(&scan.points);
        let bounds = pictures::padded(surface.bounds().unwrap_or((Vec3::zeros(), Vec3::repeat(1.0))));
        let layer = Layer::per_vertex(&surface, &colours);
        let name = format!("{}{}", scan.name, if scan.held_out { " held out" } else { "" });
        cells.push((name, pictures::draw(vec![layer], bounds, &pictures::FRONT)));
        let body = posed_body(scene, &scan.pose)?;
        let garments = subject.garments.iter().zip(worn).map(|(g, shapes)| of_mesh(&shapes[i], &g.mesh)).collect();
        let dressed = Dressed { body: &body, garments };
        cells.push(("avatar".to_string(), pictures::dressed(&dressed, &pictures::FRONT)));
    }
    context.write("pictures/evaluation.png", &pictures::sheet(&cells, 2 * SHOWN)?)?;
    Ok(vec!["pictures/evaluation.png".into()])
}

/// Strain plus bending energy [J] of one shape.
fn elastic(physics: &Physics<f64>, shape: &[Vec3]) -> Result<f64> {
    let mut positions = Frames::zeros(1, shape.len(), 1);
    positions.set_frame(0, 0, shape)?;
    physics.elastic(&positions)
}

/// True joints of each scan, NaN where one is not known.
fn true_joints(context: &Context<'_>, subject: &Subject, scans: &Scans) -> Result<Vec<Option<Vec<Vec3>>>> {
    if let Some(truth) = &scans.truth {
        let of = |scan: &SubjectScan| true_index(scans, &scan.name).map(|i| truth.joints[i].clone());
        return Ok(subject.scans.iter().map(of).collect());
    }
    let Some(path) = &context.config.evaluate.ground_truth else {
        return Ok(vec![None; subject.scans.len()]);
    };
    let resolved = context.files.resolve(path)?;
    let npz = Npz::from_bytes(&resolved, context.files.read(path)?)?;
    subject
        .scans
        .iter()
        .map(|scan| {
            let name = format!("{}__joints55", scan.name);
            if !npz.has(&name) {
                return Ok(None);
            }
            let joints = npz.f64s(&name)?;
            Error::check_length(&name, 3 * SMPLX_JOINTS.len(), joints.data.len())?;
            Ok(Some(joints.data.chunks_exact(3).map(Vec3::from_column_slice).collect()))
        })
        .collect()
}

/// Share of upper vertices inside the lower garment over the training scans' poses, before and after fine-tuning.
fn layering(
    context: &Context<'_>,
    subject: &Subject,
    scene: &Scene,
    motion: &BodyTrack,
    nets: &Nets,
    avatar: &Nets,
) -> Result<Option<[f64; 2]>> {
    let [upper, lower] = &subject.garments[..] else { return Ok(None) };
    // A sample of the motion says as much as all of it.
    let poses: Vec<_> = motion.poses.iter().step_by((motion.len() / 24).max(1)).cloned().collect();
    let track = scene.track(&poses)?;
    let reach = context.config.finetune.layering.reach;
    let inside = |nets: &Nets| -> Result<f64> {
        let [u, l] = &nets.garments[..] else { return Ok(0.0) };
        let spec = &context.config.net;
        let (u, l) = (play(upper, u, spec, &track, Play::Poses)?, play(lower, l, spec, &track, Play::Poses)?);
        let (mut count, mut all) = (0usize, 0usize);
        for (u, l) in u.iter().zip(&l) {
            let normals = mesh::vertex_normals(l, &lower.mesh.faces);
            let grid = NearestGrid::from_points(l);
            for p in u {
                all += 1;
                let near = grid.nearest_within(&[p.x, p.y, p.z], reach * reach);
                if near.is_some_and(|(id, _)| normals[id as usize].dot(&(p - l[id as usize])) < 0.0) {
                    count += 1;
                }
            }
        }
        Ok(count as f64 / all.max(1) as f64)
    };
    Ok(Some([inside(nets)?, inside(avatar)?]))
}

/// Templates against the true garments', where they are known.
fn template_scores(subject: &Subject, scans: &Scans) -> Vec<TemplateScore> {
    let Some(truth) = &scans.truth else { return Vec::new() };
    let of = |choice: &TemplateChoice| {
        let own = truth.garments.iter().find(|g| g.kind == choice.kind)?;
        Some(TemplateScore { kind: choice.kind, errors: choice.measures.against(&own.measures) })
    };
    subject.choices.iter().filter_map(of).collect()
}

/// Median ratio to the truth per group of parameters, at the start and after the last estimate, where the truth is of the
/// same model.
fn fabric_scores(context: &Context<'_>, fabrics: &[Estimates], scans: &Scans) -> Result<Vec<FabricScore>> {
    let (Some(truth), Some(first), Some(last)) = (&scans.truth, fabrics.first(), fabrics.last()) else {
        return Ok(Vec::new());
    };
    let mut out = Vec::new();
    for ((before, after), truth) in first.garments.iter().zip(&last.garments).zip(&truth.garments) {
        let table = &context.config.garment(before.kind)?.material;
        let model = material(table, config_key(before.kind), None)?;
        if truth.parameters.len() != before.fabric.before.len() || truth.kind != before.kind {
            continue;
        }
        let groups = reduction::groups(&*model)
            .into_iter()
            .map(|group| {
                let ratio = |values: &[f64]| {
                    let mut ratios: Vec<f64> = group
                        .members
                        .iter()
                        .filter(|&&i| truth.parameters[i] > 0.0 && values[i] > 0.0)
                        .map(|&i| values[i] / truth.parameters[i])
                        .collect();
                    ratios.sort_by(f64::total_cmp);
                    ratios.get(ratios.len() / 2).copied().unwrap_or(f64::NAN)
                };
                (group.name.clone(), ratio(&before.fabric.before), ratio(&after.fabric.after))
            })
            .collect();
        out.push(FabricScore { kind: before.kind, groups });
    }
    Ok(out)
}
