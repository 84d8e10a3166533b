//! Registration of a realistic free body to the stand-in scans, whose joints are known (`data/scans`, `data/body`).

use caphy_bodymodel::registration::{RegistrationScan, RegistrationSettings, register};
use caphy_bodymodel::smplx::{SmplxOptions, load};
use caphy_core::Vec3;
use caphy_core::body::{BodyModel, BodyParameters};
use caphy_core::scan::LabelledPoints;
use caphy_formats::npz::Npz;
use caphy_formats::ply::read_ply;
use std::path::{Path, PathBuf};

fn shared(relative: &str) -> Option<(PathBuf, Vec<u8>)> {
    let root = std::env::var("CAPHY_SHARED")
        .unwrap_or_else(|_| concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared").to_string());
    let path = Path::new(&root).join(relative);
    match std::fs::read(&path) {
        Ok(bytes) => Some((path, bytes)),
        Err(e) => {
            eprintln!("SKIPPED: {} cannot be read ({e}); set CAPHY_SHARED", path.display());
            None
        }
    }
}

#[test]
fn three_clothed_scans_from_nothing() {
    let Some((path, bytes)) = shared("data/body/anny_smplx_layout.npz") else { return };
    let body =
        load(&path, bytes, &SmplxOptions { expression_coefficients: Some(0), ..SmplxOptions::default() }).unwrap();
    let Some((path, bytes)) = shared("data/scans/ground_truth.npz") else { return };
    let truth = Npz::from_bytes(&path, bytes).unwrap();
    let names = ["p1_apose", "p1_kneeup", "p1_star"];
    let mut points = Vec::new();
    for name in names {
        let Some((path, bytes)) = shared(&format!("data/scans/{name}.ply")) else { return };
        let scan = read_ply(&path, &bytes).unwrap();
        points.push(LabelledPoints {
            normals: scan.mesh.vertex_normals(),
            points: scan.mesh.vertices,
            labels: scan.labels.unwrap(),
        });
    }
    let scans: Vec<_> =
        names.iter().zip(&points).map(|(name, points)| RegistrationScan { name, points, start: None }).collect();
    let clock = std::time::Instant::now();
    let fit = register(&body, &scans, &RegistrationSettings::default(), &|_| {}).unwrap();
    println!("{:.1} s for {} scans, shape {:.2?}", clock.elapsed().as_secs_f64(), scans.len(), fit.shape);
    for (i, name) in names.iter().enumerate() {
        let parameters = BodyParameters::rest(55, &fit.shape).posed(&fit.poses[i]);
        let joints = body.forward(&parameters).unwrap().joints;
        let known: Vec<Vec3> = truth
            .f64s(&format!("{name}__joints55"))
            .unwrap()
            .data
            .chunks_exact(3)
            .map(Vec3::from_column_slice)
            .collect();
        let mut errors: Vec<(f64, usize)> = joints
            .iter()
            .zip(&known)
            .enumerate()
            .filter(|(_, (_, k))| k.x.is_finite())
            .map(|(j, (a, k))| ((a - k).norm() * 1e3, j))
            .collect();
        let limbs: Vec<String> = errors
            .iter()
            .filter(|e| e.1 < 22)
            .map(|e| format!("{} {:.0}", body.describe().joints[e.1].name, e.0))
            .collect();
        errors.sort_by(|a, b| a.0.total_cmp(&b.0));
        let median = errors[errors.len() / 2].0;
        println!("{:?}", fit.report[i]);
        println!("  joints: median {median:.1} mm, largest {:.1} mm; {}", errors[errors.len() - 1].0, limbs.join(", "));
        assert!(median <= 15.0, "{name}: median joint error {median:.1} mm");
        assert!(fit.report[i].inside_share > 0.9);
    }
}
