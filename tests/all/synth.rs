//! Scans of a generated person against what is true of them.

use crate::experiment::{Experiment, TINY, edited, files, value};
use crate::pipeline::{finished, killed_at, program};
use caphy::config::Config;
use caphy::stage::Scans;
use caphy::synth::Truth;
use caphy_bodymodel::BodyMannequin;
use caphy_core::body::{BodyModel, BodyParameters};
use caphy_core::query::NearestSurface;
use caphy_core::scan::{Label, Scan};
use caphy_core::{TriMesh, Vec3, mesh};
use caphy_formats::ply::read_ply;
use caphy_garment::solver::Outcome;
use caphy_render::capture::LARGEST_ERROR;
use std::path::Path;

/// Edge length of a scan's triangles [m], and its noise [m]: the defaults.
const EDGE: f64 = 0.01;
const NOISE: f64 = 0.5e-3;

fn truth(folder: &Path) -> Truth {
    let scans: Scans = value(folder, "synth");
    scans.truth.expect("the truth")
}

fn scan(folder: &Path, name: &str) -> Scan {
    let path = folder.join("scans").join(format!("{name}.ply"));
    read_ply(&path, &std::fs::read(&path).expect("a scan")).unwrap_or_else(|e| panic!("{e}"))
}

/// The true surfaces of a scan, round as they are scanned: body, then garments, upper first.
fn surfaces(truth: &Truth, scan: usize) -> Vec<(Label, TriMesh)> {
    let body = BodyMannequin { resolution: 0.03 }.generate().expect("the body of TINY");
    let mut subject = BodyParameters { displacement: truth.displacement.clone(), ..body.rest(&truth.shape) };
    subject = subject.posed(&truth.poses[scan]);
    let skin = mesh::rounded(&body.forward(&subject).expect("posed").vertices, &body.describe().faces);
    let mut all = vec![(Label::Body, skin)];
    for (garment, label) in truth.garments.iter().zip([Label::Upper, Label::Lower]) {
        all.push((label, mesh::rounded(&garment.at_rest[scan], &garment.template.faces)));
    }
    all
}

#[test]
fn garments_hang_still_in_every_pose() {
    let truth = truth(finished());
    assert_eq!(truth.garments.len(), 2);
    for garment in &truth.garments {
        assert_eq!(garment.solved.len(), truth.poses.len());
        for (i, solved) in garment.solved.iter().enumerate() {
            assert!(solved.outcome == Outcome::Converged, "{} in scan {i}: {solved:?}", garment.kind);
            assert!(solved.residual_n <= 5e-5, "{} in scan {i}: {} N", garment.kind, solved.residual_n);
        }
        // It has moved with the body, and hangs on it: below its own highest point by no more than it is long.
        let height = |shape: &[Vec3]| {
            let y = |f: fn(f64, f64) -> f64, s: f64| shape.iter().map(|p| p.y).fold(s, f);
            y(f64::max, f64::NEG_INFINITY) - y(f64::min, f64::INFINITY)
        };
        let long = height(&garment.template.vertices);
        for shape in &garment.at_rest {
            assert!(height(shape) < 1.2 * long, "{} is pulled out of shape", garment.kind);
        }
    }
}

#[test]
fn scans_lie_on_what_can_be_seen_and_say_what_it_is() {
    let truth = truth(finished());
    for i in 0..truth.poses.len() {
        let scan = scan(finished(), &format!("scan-{i:02}"));
        let labels = scan.labels.as_ref().expect("labels");
        assert_eq!(labels, &truth.labels[i]);
        assert!(scan.colours.is_some() && scan.mesh.vertices.len() > 5000, "{} vertices", scan.mesh.vertices.len());
        let all = surfaces(&truth, i);
        let searches: Vec<_> =
            all.iter().map(|(label, mesh)| (*label, NearestSurface::from_mesh(mesh).unwrap())).collect();
        let (mut far, mut wrong) = (0, 0);
        for (p, label) in scan.mesh.vertices.iter().zip(labels) {
            let distance = |l: Label| {
                let found = searches.iter().find(|s| s.0 == l).and_then(|s| s.1.nearest(p)).expect("a surface");
                found.squared_distance.sqrt()
            };
            let own = distance(*label);
            // Where surfaces meet a share of a cell, five deviations of noise; skin under cloth gives way by up to 8 mm.
            let gives_way = if *label == Label::Upper { 0.0 } else { 8e-3 };
            assert!(own < LARGEST_ERROR * EDGE + 5.0 * NOISE + gives_way, "a vertex lies {own} m off its {label:?}");
            far += usize::from(*label == Label::Upper && own > 0.1 * EDGE + 3.0 * NOISE);
            let nearest = Label::ALL.into_iter().min_by(|a, b| distance(*a).total_cmp(&distance(*b))).expect("three");
            wrong += usize::from(nearest != *label);
        }
        let count = labels.len() as f64;
        assert!((far as f64) < 0.05 * count, "{far} of {count} lie off");
        // Cloth 3 mm above skin, noise of half a millimetre: only borders are in doubt.
        assert!((wrong as f64) < 0.02 * count, "{wrong} of {count} labels");
    }
}

#[test]
fn what_is_hidden_is_missing() {
    let truth = truth(finished());
    let scan = scan(finished(), "scan-00");
    let all = surfaces(&truth, 0);
    // Skin of the trunk between shirt hem and chest, in the A-pose: vertices whose nearest cloth is far from any border.
    let shirt = &all[1].1;
    let border: Vec<Vec3> = caphy_core::query::boundary_loops(&shirt.faces)
        .into_iter()
        .flatten()
        .map(|v| shirt.vertices[v as usize])
        .collect();
    let cloth = NearestSurface::from_mesh(shirt).unwrap();
    let hidden: Vec<Vec3> = all[0]
        .1
        .vertices
        .iter()
        .filter(|p| cloth.nearest_within(p, 0.03 * 0.03).is_some() && border.iter().all(|b| (b - *p).norm() > 0.12))
        .copied()
        .collect();
    assert!(hidden.len() > 50, "{} vertices of skin are well covered", hidden.len());
    let grid = caphy_core::query::NearestGrid::from_points(&hidden);
    let labels = scan.labels.expect("labels");
    let seen = scan
        .mesh
        .vertices
        .iter()
        .zip(&labels)
        .filter(|(p, l)| **l == Label::Body && grid.nearest_within(&[p.x, p.y, p.z], 0.02 * 0.02).is_some())
        .count();
    assert_eq!(seen, 0, "skin under the shirt was scanned");
    // The surface has triangles of its own: no garment vertex is a vertex of it.
    let own = caphy_core::query::NearestGrid::from_points(&scan.mesh.vertices);
    let same = shirt.vertices.iter().filter(|p| own.nearest_within(&[p.x, p.y, p.z], 1e-12).is_some()).count();
    assert_eq!(same, 0);
}

#[test]
fn every_option_of_a_subject_acts() {
    let tidy = edited(
        TINY,
        &[
            ("scans = 3", "scans = 2"),
            ("held_out = [\"scan-02\"]", "held_out = [\"scan-01\"]"),
            ("type = \"vertex\"", "type = \"colour\"\npalette = [{ label = \"upper\", colour = [1, 2, 3] }]"),
        ],
    );
    let plain = Experiment::new(&tidy);
    let only = |experiment: &Experiment| {
        let run =
            caphy::runner::Run::open(&experiment.config(), Some(experiment.out())).unwrap_or_else(|e| panic!("{e}"));
        run.only("synth").and_then(|run| run.all()).unwrap_or_else(|e| panic!("{e}"));
    };
    only(&plain);
    let options = "scans = 2\nclip = { type = \"procedural\", kind = \"squat\", seconds = 2 }\nshape = [0.5]\ndisplacement_m = 4e-3\n\
        upper_style = [0.5, 0.4, 0.02, 0.3]\nlower_style = [0.6, 0.015, 0.5]\nrest = { girth = 1.04, length = 0.97 }\n\
        rig = { texture = \"patterned\", holes = 5, hole_radius_m = 0.03, labels = false, edge_m = 0.015, noise_m = 0.0 }";
    let fancy = Experiment::new(&edited(&tidy, &[("scans = 2", options)]));
    only(&fancy);
    let (a, b) = (truth(&plain.out()), truth(&fancy.out()));
    assert_eq!(b.shape, [0.5]);
    let size = (b.displacement.iter().map(|d| d.norm_squared()).sum::<f64>() / b.displacement.len() as f64).sqrt();
    assert!(a.displacement.is_empty() && (size - 4e-3).abs() < 1e-6, "{size} m");
    assert_eq!(b.garments[0].style.values(), [0.5, 0.4, 0.02, 0.3]);
    assert_eq!(b.garments[1].style.values(), [0.6, 0.015, 0.5]);
    assert_eq!(b.garments[0].rest_scale, [1.04, 0.97]);
    assert_ne!(a.poses, b.poses);
    assert_ne!(b.poses[0], b.poses[1], "first and last frame of the clip");
    let (p, q) = (scan(&plain.out(), "scan-01"), scan(&fancy.out(), "scan-01"));
    assert!(p.labels.is_some() && q.labels.is_none());
    assert_eq!(b.labels[1].len(), q.mesh.vertices.len(), "the truth knows them");
    let edge = |s: &Scan| s.mesh.mean_edge_length();
    assert!(edge(&q) > 1.3 * edge(&p), "{} {}", edge(&p), edge(&q));
    // Two colours of shirt, five holes.
    let spread = |scan: &Scan, labels: &[Label]| {
        let blue: Vec<f64> = scan
            .colours
            .iter()
            .flatten()
            .zip(labels)
            .filter(|(_, l)| **l == Label::Upper)
            .map(|(c, _)| f64::from(c[2]))
            .collect();
        let mean = blue.iter().sum::<f64>() / blue.len() as f64;
        (blue.iter().map(|b| (b - mean).powi(2)).sum::<f64>() / blue.len() as f64).sqrt()
    };
    assert!(spread(&q, &b.labels[1]) > 2.0 * spread(&p, &a.labels[1]));
    assert!(fancy.out().join("truth/truth.json").exists() && fancy.out().join("truth/scan-01.ply").exists());
    Config::read(&fancy.out().join("config.toml")).unwrap_or_else(|e| panic!("{e}"));
}

#[test]
fn killed_between_two_poses_it_goes_on_to_the_same_bits() {
    let config = edited(TINY, &[("scans = 3", "scans = 6"), ("held_out = [\"scan-02\"]", "held_out = 0.34")]);
    let whole = Experiment::new(&config);
    let done = program(&whole).args(["--only", "synth"]).status().expect("the program ends");
    assert!(done.success());
    let mut attempts = 0;
    let killed = loop {
        let experiment = Experiment::new(&config);
        if killed_at(&experiment, "checkpoint-synth-scan-00.caphy", "synth") {
            break experiment;
        }
        attempts += 1;
        assert!(attempts < 5, "it was never caught between two poses");
    };
    assert!(program(&killed).args(["--only", "synth"]).status().expect("the program ends").success());
    let results = |e: &Experiment| -> Vec<(String, Vec<u8>)> {
        let kept = |n: &str| n.starts_with("scans/") || n.starts_with("truth/") || n == "synth.caphy";
        files(&e.out()).into_iter().filter(|(n, _)| kept(n)).collect()
    };
    assert!(results(&whole).len() > 12 && results(&whole) == results(&killed));
}
