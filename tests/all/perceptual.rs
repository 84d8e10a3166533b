//! Perceptual distance by a network in an ONNX file, made here.

// Each user of the file needs another part of it.
#[allow(dead_code)]
#[path = "../../crates/formats/tests/onnx/model.rs"]
mod model;

use crate::experiment::{Experiment, TINY, value};
use caphy::config::PerceptualConfig;
use caphy::measure::{PERCEPTUAL, Perceptual, ScanGarment};
use caphy::pictures::Dressed;
use caphy::quality::SpectrumFilter;
use caphy::stage::evaluate::Scores;
use caphy_core::files::Files;
use caphy_core::scan::{Label, LabelledPoints};
use caphy_core::{Result, TriMesh, Vec3};
use caphy_garment::template::GarmentKind;
use model::{Model, Type, runnable};
use std::path::Path;

/// Several outputs, as a cut VGG-16 has them: 2 r + 1 and −b per pixel, the means of both over blocks of 2 × 2, and numbers, which are
/// no features.
fn network() -> Vec<u8> {
    Model::default()
        .input("picture", Type::Float, &[1, 3, -1, -1])
        .floats("weights", &[2, 3, 1, 1], &[2.0, 0.0, 0.0, 0.0, 0.0, -1.0])
        .floats("bias", &[2], &[1.0, 0.0])
        .node("Conv", &["picture", "weights", "bias"], "fine", &[("kernel_shape", &[1, 1])])
        .node("AveragePool", &["fine"], "coarse", &[("kernel_shape", &[2, 2]), ("strides", &[2, 2])])
        .node("ArgMax", &["fine"], "numbers", &[("axis", &[1]), ("keepdims", &[0])])
        .output("fine", Type::Float, &[1, 2, -1, -1])
        .output("coarse", Type::Float, &[1, 2, -1, -1])
        .output("numbers", Type::Int64, &[1, -1, -1])
        .bytes()
}

struct OneFile;
impl Files for OneFile {
    fn read(&self, _: &Path) -> Result<Vec<u8>> {
        Ok(network())
    }
}

const BOTH: &str = "outputs = [\"fine\", \"coarse\"]";

fn open(keys: &str) -> Result<Perceptual> {
    let config: PerceptualConfig = toml::from_str(&format!("path = \"net.onnx\"\n{keys}")).expect("a table");
    Perceptual::open(&config, &OneFile)
}

#[test]
fn distances_are_sums_of_mean_squares_over_outputs() {
    if !runnable() {
        return;
    }
    let plain = "pixels = { mean = [0.0, 0.0, 0.0], std = [1.0, 0.5, 0.25] }";
    // Sixteenths: every value is exact. Two pictures of 2 × 4 pixels.
    let a: Vec<f32> = (0..8u8).map(|i| f32::from(i * 3 % 8) / 16.0).collect();
    let b: Vec<f32> = (0..8u8).map(|i| f32::from(i * i % 16) / 16.0).collect();
    let of = |keys: &str| {
        let network = open(&format!("{keys}\n{plain}")).unwrap();
        let [a, b] = [&a, &b].map(|picture| network.features(picture, 2, 4).unwrap());
        assert_eq!(a.distance(&a).unwrap(), 0.0);
        a.distance(&b).unwrap()
    };
    let d: Vec<f64> = a.iter().zip(&b).map(|(a, b)| f64::from(a - b)).collect();
    let blocks = [0, 2].map(|x| 0.25 * (d[x] + d[x + 1] + d[4 + x] + d[5 + x]));
    // Two channels: 2 of red, and blue, which a quarter's deviation makes 4; the bias cancels.
    let mean = |list: &[f64]| list.iter().map(|d| (4.0 + 16.0) * d * d).sum::<f64>() / (2 * list.len()) as f64;
    assert_eq!(of("outputs = [\"fine\"]"), mean(&d));
    assert_eq!(of("outputs = [\"coarse\"]"), mean(&blocks));
    assert_eq!(of(BOTH), mean(&d) + mean(&blocks));
    // Pictures of other sizes cannot be compared.
    let network = open(&format!("{BOTH}\n{plain}")).unwrap();
    let (whole, half) = (network.features(&a, 2, 4).unwrap(), network.features(&a[..4], 2, 2).unwrap());
    assert!(whole.distance(&half).is_err());
}

#[test]
fn outputs_that_hold_no_features_are_named() {
    if !runnable() {
        return;
    }
    let said = open("").unwrap_err().to_string();
    assert!(said.contains("`numbers` (integer") && said.contains("evaluate.perceptual_network.outputs"), "{said}");
    let said = open("outputs = [\"relu2_2\"]").unwrap_err().to_string();
    assert!(said.contains("`relu2_2`") && said.contains("`coarse`"), "{said}");
}

#[test]
fn a_garment_is_nearer_to_itself_than_to_one_beside_it() {
    if !runnable() {
        return;
    }
    let network = open(BOTH).unwrap();
    // A wavy sheet of 0.4 m.
    let sheet = |phase: f64| {
        let at = |i: u32| 0.02 * f64::from(i) - 0.2;
        let wave = |x: f64| 0.02 * (40.0 * x + phase).sin();
        let mut mesh = TriMesh::default();
        for j in 0..=20 {
            mesh.vertices.extend((0..=20).map(|i| Vec3::new(at(i), at(j), wave(at(i)))));
        }
        for j in 0..20 {
            for i in 0..20 {
                let v = j * 21 + i;
                mesh.faces.extend([[v, v + 1, v + 21], [v + 1, v + 22, v + 21]]);
            }
        }
        mesh
    };
    let scan = sheet(0.0);
    let labels = vec![Label::Upper; scan.vertices.len()];
    let points = LabelledPoints { points: scan.vertices.clone(), normals: scan.vertex_normals(), labels };
    let of = |network: Option<&Perceptual>, phase: f64| {
        let compared = ScanGarment::new("s", GarmentKind::Upper, &scan, &points, network).unwrap();
        let (body, garment) = (TriMesh::default(), sheet(phase));
        let filter = SpectrumFilter::new(&garment);
        let seen = vec![true; garment.vertices.len()];
        let figure = Dressed { body: &body, garments: vec![garment] };
        compared.compare(&figure, 0, &seen, &filter).unwrap()
    };
    let distance = |phase| of(Some(&network), phase).perceptual.expect("a network was given");
    let (same, near, far) = (distance(0.0), distance(0.3), distance(3.0));
    assert!(same == 0.0 && near > 1e-4 && far > 2.0 * near, "{same} {near} {far}");
    let without = of(None, 0.3);
    assert_eq!(without.perceptual, None);
    assert!(without.named().iter().all(|(name, _)| *name != PERCEPTUAL));
    assert!(of(Some(&network), 0.3).named().iter().any(|(name, value)| *name == PERCEPTUAL && *value == near));
}

#[test]
fn a_run_asks_the_network_and_says_so() {
    if !runnable() {
        return;
    }
    let table = format!("[evaluate.perceptual_network]\npath = \"net.onnx\"\n{BOTH}\n");
    let experiment = Experiment::new(&format!("{TINY}\n{table}"));
    let missing = experiment.error();
    assert!(missing.contains("evaluate.perceptual_network") && missing.contains("is not a file"), "{missing}");
    experiment.write("net.onnx", &network());
    let summary = experiment.run();
    let row =
        summary.table.lines().find(|line| line.contains(PERCEPTUAL)).unwrap_or_else(|| panic!("{}", summary.table));
    // Avatar and skinned template; the true garment is nearer than either.
    let values: Vec<f64> = row.split_whitespace().filter_map(|cell| cell.parse().ok()).collect();
    let [avatar, skinned, truth] = values[..] else { panic!("{row}") };
    assert!(truth > 0.0 && truth < avatar && truth < skinned, "{row}");
    assert!(!summary.table.contains("stand in for VGG-16"));
    let scores: Scores = value(&experiment.out(), "evaluate");
    assert!(scores.scans.iter().flat_map(|s| &s.garments).all(|g| g.net.perceptual.is_some_and(|d| d > 0.0)));
    // Another file is another measurement; what it says is the same.
    experiment.write("net.onnx", &[network(), b"\x12\x04made".to_vec()].concat());
    assert_eq!(experiment.run().ran, ["evaluate"]);
}
