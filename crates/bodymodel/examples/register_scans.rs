//! How far the fitted body is from a known one: `cargo run --release -p caphy-bodymodel --example register_scans -- BODY.npz FOLDER`.
//!
//! The folder holds scans with labels (`*.ply`) and `ground_truth.npz` with `<scan>__full_pose` (55, 3) and `<scan>__joints55`
//! (55, 3), perhaps `<scan>__vertices`. The true shape is its `betas`, or with `--shape KEY` an array of the body's file. With `--starts N DEGREES`, every scan is also fitted alone N times from a pose whose joints are each turned
//! about a random axis by up to so many degrees.

use caphy_bodymodel::registration::{RegistrationScan, RegistrationSettings, register};
use caphy_bodymodel::smplx::{SmplxOptions, load};
use caphy_core::body::{BodyModel, BodyParameters};
use caphy_core::pose::Pose;
use caphy_core::query::{NearestGrid, NearestSurface};
use caphy_core::scan::{Label, LabelledPoints};
use caphy_core::{Result, TriMesh, Vec3};
use caphy_formats::npz::Npz;
use caphy_formats::ply::read_ply;
use nalgebra::Rotation3;
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use std::path::Path;

struct Truth {
    pose: Pose,
    joints: Vec<Vec3>,
    vertices: Option<Vec<Vec3>>,
}

fn points(truth: &Npz, name: &str) -> Result<Vec<Vec3>> {
    Ok(truth.f64s(name)?.data.chunks_exact(3).map(Vec3::from_column_slice).collect())
}

/// Translations that bring the joints of a shape to the true ones (median over all joints, since regressed knees and feet can be off).
fn place(body: &dyn BodyModel, shape: &[f64], truths: &mut [Truth]) -> Result<()> {
    for t in truths {
        let joints = body.skeleton(&body.rest(shape).posed(&t.pose))?.joints;
        t.pose.translation = Vec3::from_fn(|axis, _| {
            let offs = joints.iter().zip(&t.joints).map(|(j, k)| k[axis] - j[axis]);
            let mut offs: Vec<f64> = offs.filter(|d| d.is_finite()).collect();
            offs.sort_by(f64::total_cmp);
            offs.get(offs.len() / 2).copied().unwrap_or(0.0)
        });
    }
    Ok(())
}

fn quantiles(mut values: Vec<f64>) -> String {
    if values.is_empty() {
        return "none".into();
    }
    values.sort_by(f64::total_cmp);
    let at = |q: f64| values[((values.len() - 1) as f64 * q).round() as usize] * 1e3;
    format!("{:5.1} {:5.1} {:5.1} {:5.1}", at(0.5), at(0.75), at(0.95), at(1.0))
}

fn main() -> std::result::Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let (Some(body_path), Some(folder)) = (arguments.first(), arguments.get(1)) else {
        return Err("give a body (.npz) and a folder with scans and ground_truth.npz".into());
    };
    let body_path = Path::new(body_path);
    let options = SmplxOptions { expression_coefficients: Some(0), ..SmplxOptions::default() };
    let body = load(body_path, std::fs::read(body_path)?, &options)?;
    let folder = Path::new(folder);
    let truth_path = folder.join("ground_truth.npz");
    let truth = Npz::from_bytes(&truth_path, std::fs::read(&truth_path)?)?;
    let mut paths: Vec<_> = std::fs::read_dir(folder)?.filter_map(|e| Some(e.ok()?.path())).collect();
    paths.retain(|p| p.extension().is_some_and(|e| e == "ply"));
    paths.sort();
    let (mut names, mut scans, mut truths) = (Vec::new(), Vec::new(), Vec::new());
    for path in &paths {
        let scan = read_ply(path, &std::fs::read(path)?)?;
        let name = path.file_stem().unwrap_or_default().to_string_lossy().to_string();
        let labels = scan.labels.clone().ok_or("a scan without labels")?;
        scans.push(LabelledPoints { normals: scan.mesh.vertex_normals(), points: scan.mesh.vertices, labels });
        let rotations = points(&truth, &format!("{name}__full_pose"))?;
        let pose = Pose { rotations, translation: Vec3::zeros() };
        let vertices = format!("{name}__vertices");
        let vertices = truth.has(&vertices).then(|| points(&truth, &vertices)).transpose()?;
        truths.push(Truth { pose, joints: points(&truth, &format!("{name}__joints55"))?, vertices });
        names.push(name);
    }
    let count = body.describe().shape_count.min(10);
    let key = arguments.iter().position(|a| a == "--shape").and_then(|at| arguments.get(at + 1));
    let shape = match key {
        Some(key) => Npz::from_bytes(body_path, std::fs::read(body_path)?)?.f64s(key)?.data[..count].to_vec(),
        None => truth.f64s("betas")?.data[..count].to_vec(),
    };
    place(&body, &shape, &mut truths)?;
    println!("true shape   {shape:6.2?}");
    let mut true_bodies = Vec::new();
    for t in &truths {
        let posed = body.forward(&BodyParameters::rest(55, &shape).posed(&t.pose))?;
        let off: Vec<f64> =
            posed.joints.iter().zip(&t.joints).map(|(a, b)| (a - b).norm()).filter(|d| d.is_finite()).collect();
        println!("true body's joints against the file's, mm (50 75 95 100 %): {}", quantiles(off));
        true_bodies.push(t.vertices.clone().unwrap_or(posed.vertices));
    }
    let settings = RegistrationSettings::default();
    let inputs = |start: &dyn Fn(usize) -> Option<Pose>| -> Vec<RegistrationScan<'_>> {
        (0..scans.len()).map(|i| RegistrationScan { name: &names[i], points: &scans[i], start: start(i) }).collect()
    };
    let clock = std::time::Instant::now();
    let fit = register(&body, &inputs(&|_| None), &settings, &|_| {})?;
    println!("fitted shape {:6.2?} in {:.1} s", fit.shape, clock.elapsed().as_secs_f64());
    println!("distances in mm: 50 75 95 100 %");
    let faces = body.describe().faces.clone();
    for (i, name) in names.iter().enumerate() {
        let mut parameters = BodyParameters::rest(55, &fit.shape).posed(&fit.poses[i]);
        parameters.displacement = fit.displacement.clone();
        let posed = body.forward(&parameters)?;
        println!("{name}  {:?}", fit.report[i]);
        let known = |j: &usize| truths[i].joints[*j].x.is_finite();
        let off = |j: usize| (posed.joints[j] - truths[i].joints[j]).norm();
        println!("  joints of the body {}", quantiles((0..22).filter(known).map(off).collect()));
        println!("  all joints         {}", quantiles((0..55).filter(known).map(off).collect()));
        let worst: Vec<String> = (0..22)
            .filter(|&j| off(j) > 0.01)
            .map(|j| format!("{} {:.0}", body.describe().joints[j].name, 1e3 * off(j)))
            .collect();
        println!("    over 10 mm: {}", worst.join(", "));
        // Whether a vertex of the true body is covered says the label of the nearest scan point.
        let grid = NearestGrid::from_points(&scans[i].points);
        let near = NearestSurface::from_mesh(&TriMesh { vertices: posed.vertices.clone(), faces: faces.clone() })?;
        for (what, bare) in [("skin", true), ("under cloth", false)] {
            let (mut to_vertex, mut to_surface, mut to_scan) = (Vec::new(), Vec::new(), Vec::new());
            for (v, t) in true_bodies[i].iter().enumerate() {
                let Some((p, d2)) = grid.nearest_point(t) else { continue };
                let skin = scans[i].labels[p as usize] == Label::Body;
                // Skin that no scan point is near to is inside the mouth or under a sleeve's end.
                if skin == bare && (!bare || d2.sqrt() < 0.006) {
                    to_vertex.push((posed.vertices[v] - t).norm());
                    to_surface.push(near.nearest(t).map_or(f64::INFINITY, |n| n.squared_distance.sqrt()));
                    to_scan.push(d2.sqrt());
                }
            }
            println!("  {what:11} vertex   {}", quantiles(to_vertex));
            println!("  {what:11} surface  {}", quantiles(to_surface));
            println!("  {what:11} true body to scan points {}", quantiles(to_scan));
        }
    }
    if let Some(at) = arguments.iter().position(|a| a == "--starts") {
        let count: usize = arguments.get(at + 1).ok_or("--starts N DEGREES")?.parse()?;
        let degrees: f64 = arguments.get(at + 2).ok_or("--starts N DEGREES")?.parse()?;
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let (mut good, mut all) = (0, 0);
        for (i, name) in names.iter().enumerate() {
            for k in 0..count {
                let mut start = truths[i].pose.clone();
                for r in &mut start.rotations[..22] {
                    let axis = Vec3::from_fn(|_, _| rng.random::<f64>() - 0.5).normalize();
                    let turn = Rotation3::new(axis * degrees.to_radians() * rng.random::<f64>());
                    *r = (Rotation3::new(*r) * turn).scaled_axis();
                }
                let one = [RegistrationScan { name, points: &scans[i], start: Some(start) }];
                let fit = register(&body, &one, &settings, &|_| {})?;
                let posed = body.skeleton(&BodyParameters::rest(55, &fit.shape).posed(&fit.poses[0]))?;
                let off: Vec<f64> = (0..22).map(|j| (posed.joints[j] - truths[i].joints[j]).norm()).collect();
                let most = off.iter().copied().fold(0.0, f64::max);
                println!("{name} start {k}: joints {}", quantiles(off));
                (good, all) = (good + usize::from(most < 0.03), all + 1);
            }
        }
        println!("{good} of {all} starts end with every joint within 30 mm");
    }
    Ok(())
}
