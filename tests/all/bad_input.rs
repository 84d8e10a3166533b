//! A person's own mistakes end in errors that name the file or key and say what to do; nothing panics.

use crate::experiment::{Experiment, TINY, edited, tiny_on_scans};
use caphy::config::Config;
use caphy::files::ProjectFiles;
use caphy_core::body::BodyParameters;
use caphy_core::scan::{Label, Scan};
use caphy_core::{TriMesh, Vec3};
use caphy_formats::obj::write_obj;
use caphy_formats::ply::write_ply;
use std::path::Path;

/// An experiment on a folder with one scan, `scans/anna.ply`.
fn with_scan(bytes: &[u8]) -> Experiment {
    let experiment = Experiment::new(&tiny_on_scans("scans", &[]));
    experiment.write("scans/anna.ply", bytes);
    experiment
}

fn assert_error(experiment: &Experiment, words: &[&str]) {
    let said = experiment.error();
    for word in words {
        assert!(said.contains(word), "`{word}` is missing in: {said}");
    }
}

/// The coarse mannequin in its T-pose, dressed by colour and label only: top and trousers by height.
pub(crate) fn person() -> Scan {
    let config = Config::parse(Path::new("tiny.toml"), &tiny_on_scans("scans", &[])).expect("a configuration");
    let body = config.body.body(&ProjectFiles::new(".")).expect("a body");
    let joints = body.describe().joints.len();
    let posed = body.forward(&BodyParameters::rest(joints, &[])).expect("a posed body");
    let mesh = TriMesh { vertices: posed.vertices, faces: body.describe().faces.clone() };
    let label = |p: &Vec3| match p.y {
        _ if p.x.abs() > 0.6 => Label::Body,
        -0.8..0.0 => Label::Lower,
        0.0..0.5 => Label::Upper,
        _ => Label::Body,
    };
    let labels = mesh.vertices.iter().map(label).collect();
    Scan { name: "anna".into(), colours: Some(vec![[128; 3]; mesh.vertices.len()]), labels: Some(labels), mesh }
}

/// The smallest closed scan.
fn tetrahedron() -> Scan {
    let vertices = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]].map(Vec3::from).to_vec();
    let faces = vec![[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]];
    let labels = Some(vec![Label::Upper; 4]);
    Scan { name: "anna".into(), mesh: TriMesh { vertices, faces }, colours: None, labels }
}

#[test]
fn folders_without_scans() {
    let experiment = Experiment::new(&tiny_on_scans("scans", &[]));
    assert_error(&experiment, &[&experiment.folder.path().join("scans").display().to_string(), "cannot list"]);
    std::fs::create_dir(experiment.folder.path().join("scans")).expect("a folder");
    assert_error(&experiment, &["`subject.folder`", "*.ply", "at least one scan"]);
    experiment.write("scans/notes.txt", b"not a scan");
    assert_error(&experiment, &["`subject.folder`", "*.ply", "at least one scan"]);
}

#[test]
fn variables_that_are_not_set() {
    let folder = "${CAPHY_TEST_VARIABLE_THAT_IS_NOT_SET}/scans";
    let experiment = Experiment::new(&tiny_on_scans(folder, &[]));
    assert_error(&experiment, &[folder, "CAPHY_TEST_VARIABLE_THAT_IS_NOT_SET is not set", "export"]);
    let experiment = Experiment::new(&tiny_on_scans("${CAPHY_TEST/scans", &[]));
    assert_error(&experiment, &["`${`", "`}`"]);
}

#[test]
fn held_out_scans_must_exist_and_leave_some() {
    let experiment = with_scan(&write_ply(&tetrahedron()));
    experiment.configure(&tiny_on_scans("scans", &["berta"]));
    assert_error(&experiment, &["`subject.held_out`", "`berta`", "anna"]);
    experiment.configure(&tiny_on_scans("scans", &["anna"]));
    assert_error(&experiment, &["`subject.held_out`", "anna", "to learn from"]);
    // Generated scans are held out in the same way, and refused before they are made.
    for (held, words) in [("[\"scan-03\"]", "scan-02"), ("[\"scan-00\", \"scan-01\", \"scan-02\"]", "to learn from")] {
        let experiment = Experiment::new(&edited(TINY, &[("[\"scan-02\"]", held)]));
        assert_error(&experiment, &["`subject.held_out`", words]);
        assert!(!experiment.out().join("scans").exists());
    }
}

#[test]
fn two_files_of_one_name() {
    let experiment = with_scan(&write_ply(&tetrahedron()));
    experiment.write("scans/anna.obj", &write_obj(&tetrahedron().mesh, None).expect("an OBJ"));
    assert_error(&experiment, &["`subject.folder`", "anna.obj", "anna.ply", "rename"]);
}

#[test]
fn damaged_ply_files() {
    let sound = write_ply(&person());
    let end = b"end_header\n";
    let header = sound.windows(end.len()).position(|w| w == end).expect("a header") + end.len();
    for length in [0, 2, header / 2, header - 1, header + 1000, sound.len() - 1] {
        let experiment = with_scan(&sound[..length]);
        let said = experiment.error();
        let remedy = ["get it again", "write the file again"].iter().any(|r| said.contains(r));
        assert!(said.contains("anna.ply") && remedy, "cut off at {length}: {said}");
    }
    assert_error(&with_scan(b"solid anna\n"), &["anna.ply", "line 1", "get it again"]);

    for (component, bad) in [(0, f64::NAN), (1, f64::INFINITY), (2, f64::NEG_INFINITY)] {
        let mut scan = tetrahedron();
        scan.mesh.vertices[2][component] = bad;
        assert_error(&with_scan(&write_ply(&scan)), &["anna.ply", "vertex", "2", "not finite", "repair"]);
    }
    let mut scan = tetrahedron();
    scan.mesh.faces[1][2] = 4;
    assert_error(&with_scan(&write_ply(&scan)), &["anna.ply", "face", "vertex id 4", "4 vertices"]);
}

#[test]
fn damaged_obj_files() {
    let experiment = Experiment::new(&tiny_on_scans("scans", &[]));
    for text in ["v 0 0\n", "v 0 0 nan\nf 1 1 1\n", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n"] {
        experiment.write("scans/anna.obj", text.as_bytes());
        assert_error(&experiment, &["anna.obj"]);
    }
}

#[test]
fn scans_that_no_label_can_be_read_from() {
    let no_labels = Scan { labels: None, ..tetrahedron() };
    assert_error(&with_scan(&write_ply(&no_labels)), &["`anna`", "`vertex`", "`label`", "\"colour\""]);
    let unknown = Scan { labels: Some(vec![Label::Ignore; 4]), ..tetrahedron() };
    assert_error(&with_scan(&write_ply(&unknown)), &["`anna`", "label"]);
    // OBJ has colours, but no labels.
    let experiment = Experiment::new(&tiny_on_scans("scans", &[]));
    experiment.write("scans/anna.obj", &write_obj(&tetrahedron().mesh, None).expect("an OBJ"));
    assert_error(&experiment, &["`anna`", "\"colour\""]);

    let colour = "type = \"colour\"\npalette = [{ label = \"upper\", colour = [0, 0, 0] }]";
    experiment.configure(&edited(&tiny_on_scans("scans", &[]), &[("type = \"vertex\"", colour)]));
    assert_error(&experiment, &["`anna`", "colour"]);
}

#[test]
fn scans_that_no_person_can_be_fitted_to() {
    let points = Scan { mesh: TriMesh { faces: Vec::new(), ..tetrahedron().mesh }, ..tetrahedron() };
    assert_error(&with_scan(&write_ply(&points)), &["`anna`", "0 faces", "triangulated"]);
    assert_error(&with_scan(&write_ply(&tetrahedron())), &["`anna`", "points", "100"]);
    let naked = Scan { labels: Some(vec![Label::Body; person().mesh.vertices.len()]), ..person() };
    assert_error(&with_scan(&write_ply(&naked)), &["`anna`", "upper garment", "labels", "segmenter"]);
}

#[test]
fn scans_in_other_units() {
    // In no unit a person: 9 m, 9 cm and 9 mm; 1.8 mm.
    for factor in [5.0, 1e-3] {
        let mut scan = person();
        scan.mesh.vertices.iter_mut().for_each(|v| *v *= factor);
        assert_error(&with_scan(&write_ply(&scan)), &["anna.ply", "measures", "in metres"]);
    }
}

#[test]
fn motion_and_body_that_are_not_there() {
    let config = tiny_on_scans("scans", &[]);
    let experiment = with_scan(&write_ply(&person()));
    let body = "type = \"mannequin\"\nresolution = 0.03";
    experiment.configure(&edited(&config, &[(body, "type = \"smplx\"\npath = \"body.npz\"")]));
    assert_error(&experiment, &["body.npz", "cannot read"]);
    experiment.write("body.npz", b"PK but no archive");
    assert_error(&experiment, &["body.npz"]);

    let clip = "type = \"procedural\", kind = \"walk\", seconds = 2";
    let last = "type = \"procedural\", kind = \"walk\", seconds = 1, seed = 11";
    let amass = "type = \"amass\", path = \"clip.npz\"";
    let amc = "type = \"asf_amc\", skeleton = \"clip.npz\", path = \"clip.npz\"";
    for (old, new, key) in [
        (clip, amass, "motion.clips"),
        (clip, amc, "motion.clips"),
        // Read after hours of training: looked for at the start.
        (last, amass, "animate.clip"),
        ("[animate]", "[evaluate]\nground_truth = \"clip.npz\"\n\n[animate]", "evaluate.ground_truth"),
    ] {
        experiment.configure(&edited(&config, &[(old, new)]));
        assert_error(&experiment, &[key, "clip.npz", "is not a file"]);
    }
    experiment.write("clip.npz", b"neither an archive nor a skeleton");
    experiment.configure(&edited(&config, &[(clip, amass)]));
    assert_error(&experiment, &["clip.npz"]);
    experiment.configure(&edited(&config, &[(clip, amc)]));
    assert_error(&experiment, &["clip.npz"]);
}

#[test]
fn a_run_folder_that_cannot_be_made() {
    let experiment = Experiment::new(&tiny_on_scans("scans", &[]));
    experiment.write("out", b"a file");
    assert_error(&experiment, &[&experiment.out().display().to_string(), "cannot create"]);
}

#[cfg(not(feature = "onnx"))]
#[test]
fn networks_in_a_build_without_them() {
    let config = tiny_on_scans("scans", &[]);
    let experiment = with_scan(&write_ply(&person()));
    let segmenter = "type = \"onnx\"\npath = \"parser.onnx\"\nmap = \"lip\"";
    experiment.configure(&edited(&config, &[("type = \"vertex\"", segmenter)]));
    assert_error(&experiment, &["`segmenter.type`", "ONNX Runtime", "cargo build --release --features onnx"]);
    experiment.configure(&format!("{config}\n[evaluate.perceptual_network]\npath = \"vgg16.onnx\"\n"));
    assert_error(&experiment, &["`evaluate.perceptual_network`", "cargo build --release --features onnx"]);
}

#[test]
fn networks_whose_settings_cannot_be_used() {
    let config = tiny_on_scans("scans", &[]);
    let experiment = with_scan(&write_ply(&person()));
    for (keys, words) in [
        ("threads = 0", ["evaluate.perceptual_network.threads", "1 to 256"]),
        ("pixels = { std = [1.0, 0.0, 1.0] }", ["evaluate.perceptual_network.pixels.std", "positive"]),
        ("layers = [\"relu2_2\"]", ["experiment.toml", "layers"]),
    ] {
        experiment.configure(&format!("{config}\n[evaluate.perceptual_network]\npath = \"vgg16.onnx\"\n{keys}\n"));
        assert_error(&experiment, &words);
    }
}
