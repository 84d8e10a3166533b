//! What came out: Chamfer distances on held-out scans, penetrations, energies, and errors to the truth where there is one.

use super::optimise::Estimates;
use super::preprocess::{Subject, SubjectScan};
use super::scans::read_framed;
use super::train::{Nets, config_key};
use super::{Context, Scans, StageOutput, material};
use crate::inference::{Play, clearance, contacts, play};
use crate::physics::Physics;
use crate::pictures;
use crate::scene::{Scene, label_of, scan_frames};
use caphy_core::files::Files;
use caphy_core::lanes::Frames;
use caphy_core::pose::SMPLX_JOINTS;
use caphy_core::query::{NearestGrid, NearestSurface};
use caphy_core::{Error, Result, TriMesh, Vec3, mesh};
use caphy_formats::npz::Npz;
use caphy_garment::estimate::reduction;
use caphy_garment::template::{GarmentKind, pose_by_weights};
use caphy_render::Layer;
use serde::{Deserialize, Serialize};
use std::fmt::Write;
use std::path::PathBuf;
use std::sync::Arc;

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
    /// Share of vertices whose fused label is the stored one.
    pub label_agreement: Option<f64>,
}

/// One garment in one scan's pose.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct GarmentScore {
    /// Upper or lower.
    pub kind: GarmentKind,
    /// Mean distance from scan points to the garment's surface [mm], not squared.
    pub scan_to_garment_mm: f64,
    /// Mean distance from visible garment vertices to the nearest scan point [mm], not squared.
    pub garment_to_scan_mm: f64,
    /// Eq. 9: sum of both means of *squared* distances between points and vertices [mm²]; the template's edge length sets its
    /// floor.
    pub chamfer_mm2: f64,
    /// [`GarmentScore::scan_to_garment_mm`] of the skinned template, without the net.
    pub skinned_scan_to_garment_mm: f64,
    /// [`GarmentScore::garment_to_scan_mm`] of the skinned template [mm].
    pub skinned_garment_to_scan_mm: f64,
    /// Share of vertices deeper inside the body than the configured limit.
    pub penetrating: f64,
    /// Deepest vertex [mm], 0 when none is inside.
    pub deepest_mm: f64,
    /// Strain and bending energy [J].
    pub elastic_j: f64,
    /// The same of the skinned template [J].
    pub skinned_elastic_j: f64,
}

/// Fabric before and after estimation against the truth.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct FabricScore {
    /// Upper or lower.
    pub kind: GarmentKind,
    /// Per group: name, median ratio to the truth at the start, and after estimation.
    pub groups: Vec<(String, f64, f64)>,
}

impl Scores {
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
                    g.scan_to_garment_mm,
                    format!("({:.2})", g.skinned_scan_to_garment_mm),
                    g.garment_to_scan_mm,
                    format!("({:.2})", g.skinned_garment_to_scan_mm),
                    100.0 * g.penetrating,
                    g.elastic_j,
                    g.skinned_elastic_j
                );
            }
        }
        for scan in &self.scans {
            if let Some([median, most]) = scan.joint_error_mm {
                let _ =
                    writeln!(out, "{}: joints {median:.1} mm from the truth (median), {most:.1} mm at most", scan.name);
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
        for fabric in &self.fabrics {
            for (group, before, after) in &fabric.groups {
                let _ =
                    writeln!(out, "{} {group}: {before:.2} × the truth at the start, {after:.2} × after", fabric.kind);
            }
        }
        out
    }
}

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
                label_agreement: scan.label_agreement,
            })
        })
        .collect::<Result<_>>()?;
    let mut worn = Vec::new();
    for (fitted, trained) in subject.garments.iter().zip(&avatar.garments) {
        let shapes = play(fitted, trained, &context.config.net, &track, Play::Poses)?;
        let visible = scan_frames(context, subject, fitted, training.clone())?.visible;
        let table = &context.config.garment(fitted.kind)?.material;
        let model = Arc::from(material(table, config_key(fitted.kind), trained.material.as_deref())?);
        let rest = fitted.rest(&*model)?;
        let train = &context.config.train;
        let map = scene.contact(fitted)?;
        let physics = Physics::<f64>::new(&rest, model, &train.contact, trained.fps, &train.weights)?;
        for (i, scan) in subject.scans.iter().enumerate() {
            context.progress.set(i as f64 / subject.scans.len() as f64, &scan.name);
            let skinned = pose_by_weights(&fitted.mesh.vertices, &fitted.weights, &track.transforms[i])?;
            let inside = clearance(&shapes[i], &contacts(&map, &track, i, &shapes[i])?);
            let limit = context.config.evaluate.penetration_m;
            let deep = inside.iter().filter(|&&d| d < -limit).count();
            let measured = distances(scan, fitted, &shapes[i], &visible)?;
            let without_net = distances(scan, fitted, &skinned, &visible)?;
            rows[i].garments.push(GarmentScore {
                kind: fitted.kind,
                scan_to_garment_mm: measured.scan_to_garment * 1e3,
                garment_to_scan_mm: measured.garment_to_scan * 1e3,
                chamfer_mm2: measured.chamfer * 1e6,
                skinned_scan_to_garment_mm: without_net.scan_to_garment * 1e3,
                skinned_garment_to_scan_mm: without_net.garment_to_scan * 1e3,
                penetrating: deep as f64 / inside.len().max(1) as f64,
                deepest_mm: 0.0 - 1e3 * inside.iter().copied().fold(0.0, f64::min),
                elastic_j: elastic(&physics, &shapes[i])?,
                skinned_elastic_j: elastic(&physics, &skinned)?,
            });
        }
        worn.push(shapes);
    }
    let pictures = draw(context, subject, &scene, scans, &worn)?;
    let layering = layering(context, subject, &scene, nets, avatar)?;
    Ok(Scores { scans: rows, layering, fabrics: fabric_scores(context, fabrics, scans)?, pictures })
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
        let posed = scene.body.forward(&scene.subject.posed(&scan.pose))?;
        let body = TriMesh { vertices: posed.vertices, faces: scene.rest.faces.clone() };
        let garments = subject
            .garments
            .iter()
            .zip(worn)
            .map(|(g, shapes)| TriMesh { vertices: shapes[i].clone(), faces: g.mesh.faces.clone() })
            .collect();
        let dressed = pictures::Dressed { body: &body, garments };
        cells.push(("avatar".to_string(), pictures::dressed(&dressed, &pictures::FRONT)));
    }
    context.write("pictures/evaluation.png", &pictures::sheet(&cells, 2 * SHOWN)?)?;
    Ok(vec!["pictures/evaluation.png".into()])
}

/// Distances between a posed garment and a scan's points of it.
struct Distances {
    /// Mean distance of scan points to the garment's surface [m].
    scan_to_garment: f64,
    /// Mean distance of visible garment vertices to the scan's points [m].
    garment_to_scan: f64,
    /// Eq. 9 between scan points and garment vertices [m²].
    chamfer: f64,
}

fn distances(
    scan: &SubjectScan,
    fitted: &crate::garment::FittedGarment,
    garment: &[Vec3],
    visible: &[bool],
) -> Result<Distances> {
    let kind = fitted.kind;
    let (points, _) = scan.points.with_label(label_of(kind));
    let seen: Vec<Vec3> = garment.iter().zip(visible).filter(|(_, v)| **v).map(|(p, _)| *p).collect();
    if points.is_empty() || seen.is_empty() {
        return Err(Error::numerics(
            format!("scan {}", scan.name),
            format!("{} points and {} visible vertices of the {kind} garment", points.len(), seen.len()),
            "look at the labels in the report, or leave the scan out",
        ));
    }
    let on_surface = NearestSurface::new(garment, &fitted.mesh.faces)?.nearest_all(&points, None)?;
    let scan_to_garment = on_surface.iter().map(|at| at.squared_distance.sqrt()).sum::<f64>() / points.len() as f64;
    // Mean distance and mean squared distance.
    let mean = |from: &[Vec3], to: &[Vec3]| {
        let grid = NearestGrid::from_points(to);
        let squares: Vec<f64> = from.iter().filter_map(|p| grid.nearest_point(p)).map(|(_, d)| d).collect();
        let n = squares.len().max(1) as f64;
        (squares.iter().map(|d| d.sqrt()).sum::<f64>() / n, squares.iter().sum::<f64>() / n)
    };
    let (_, there) = mean(&points, &seen);
    let (garment_to_scan, back) = mean(&seen, &points);
    Ok(Distances { scan_to_garment, garment_to_scan, chamfer: there + back })
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
        return Ok(truth.joints.iter().cloned().map(Some).collect());
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

/// Median and largest distance over the joints that are known [mm].
fn joint_error(fitted: &[Vec3], truth: &[Vec3]) -> [f64; 2] {
    let mut distances: Vec<f64> =
        fitted.iter().zip(truth).map(|(a, b)| (a - b).norm() * 1e3).filter(|d| d.is_finite()).collect();
    distances.sort_by(f64::total_cmp);
    let median = distances.get(distances.len() / 2).copied().unwrap_or(f64::NAN);
    [median, distances.last().copied().unwrap_or(f64::NAN)]
}

/// Share of upper vertices inside the lower garment over the training scans' poses, before and after fine-tuning.
fn layering(
    context: &Context<'_>,
    subject: &Subject,
    scene: &Scene,
    nets: &Nets,
    avatar: &Nets,
) -> Result<Option<[f64; 2]>> {
    let [upper, lower] = &subject.garments[..] else { return Ok(None) };
    let track = scene.motion(context)?.track;
    // A sample of the motion says as much as all of it.
    let poses: Vec<_> = track.poses.iter().step_by((track.len() / 24).max(1)).cloned().collect();
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
