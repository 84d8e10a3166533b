//! The whole road on the stand-in scans (`data/scans`), with a body and motion that nobody here made, at low resolution.

use crate::experiment::{Experiment, shared, value};
use caphy::config::Config;
use caphy::files::ProjectFiles;
use caphy::stage::animate::Film;
use caphy::stage::evaluate::Scores;
use caphy::stage::preprocess::Subject;
use caphy_core::Vec3;
use caphy_core::body::BodyParameters;
use caphy_formats::npz::Npz;
use caphy_formats::ply::read_ply;
use std::path::Path;

/// Low resolution everywhere but in the registration, whose result is measured.
fn config(shared: &Path) -> String {
    let data = shared.join("data").display().to_string();
    format!(
        r#"
[run]
out = "out"

[subject]
type = "scans"
folder = "{data}/scans"
held_out = ["p1_star"]

[body]
type = "smplx"
path = "{data}/body/anny_smplx_layout.npz"

[segmenter]
type = "vertex"

[views]
count = 12
size = 256

[registration]
sample_vertices = 500
displacement_sigma = 0

[upper]
material = {{ type = "stvk", young_pa = 2e5, poisson = 0.3, thickness_m = 5e-4, density_kg_per_m2 = 0.2 }}
styles = 6
resolution_m = 0.05

[lower]
material = {{ type = "measured", fabric = "11oz-black-denim" }}
styles = 6
resolution_m = 0.05

[net]
type = "mlp"
hidden = [32]

[motion]
fps = 15
clips = [
  {{ type = "asf_amc", skeleton = "{data}/mocap/49.asf", path = "{data}/mocap/49_18.amc" }},
  {{ type = "procedural", kind = "squat", seconds = 1 }},
]

[train]
rounds = 2
windows = 64

[optimise]
alternations = 0

[finetune]
epochs = 2
windows = 16

[evaluate]
ground_truth = "{data}/scans/ground_truth.npz"

[animate]
clip = {{ type = "amass", path = "clip.npz", translation = "pelvis_position" }}
seconds = 1
"#
    )
}

#[test]
fn three_clothed_scans_become_an_avatar_that_walks() {
    let Some(shared) = shared() else { return };
    let text = config(&shared);
    let experiment = Experiment::new(&text);
    let clip = |name: &str| std::fs::read(shared.join("data/mocap").join(name)).expect("a clip");
    experiment.write("clip.npz", &clip("cmu_35_01_smplh.npz"));
    let summary = experiment.run();
    assert_eq!(summary.ran, ["preprocess", "train", "finetune", "evaluate", "animate", "export", "report"]);

    let subject: Subject = value(&experiment.out(), "preprocess");
    let names: Vec<_> = subject.scans.iter().map(|s| (&*s.name, s.held_out)).collect();
    assert_eq!(names, [("p1_apose", false), ("p1_kneeup", false), ("p1_star", true)]);
    let body = Config::parse(&experiment.config(), &text)
        .and_then(|config| config.body.body(&ProjectFiles::new(".")))
        .unwrap_or_else(|e| panic!("{e}"));
    let path = shared.join("data/scans/ground_truth.npz");
    let truth = Npz::from_bytes(&path, std::fs::read(&path).expect("the truth")).unwrap_or_else(|e| panic!("{e}"));
    let scores: Scores = value(&experiment.out(), "evaluate");
    for (scan, score) in subject.scans.iter().zip(&scores.scans) {
        let path = shared.join(format!("data/scans/{}.ply", scan.name));
        let stored = read_ply(&path, &std::fs::read(&path).expect("a scan")).unwrap_or_else(|e| panic!("{e}"));
        let stored = stored.labels.expect("labels");
        assert_eq!(stored.len(), scan.points.labels.len());
        let same = stored.iter().zip(&scan.points.labels).filter(|(a, b)| a == b).count();
        let share = same as f64 / stored.len() as f64;
        assert!(share >= 0.95, "{}: {:.1} % of the labels", scan.name, 100.0 * share);
        assert_eq!(score.label_agreement, Some(share));

        let mut parameters = BodyParameters::rest(body.describe().joints.len(), &subject.shape).posed(&scan.pose);
        parameters.displacement = subject.displacement.clone();
        let fitted = body.forward(&parameters).unwrap_or_else(|e| panic!("{e}")).joints;
        let known = truth.f64s(&format!("{}__joints55", scan.name)).unwrap_or_else(|e| panic!("{e}")).data;
        let mut errors: Vec<f64> = fitted
            .iter()
            .zip(known.chunks_exact(3).map(Vec3::from_column_slice))
            .map(|(fitted, known)| 1e3 * (fitted - known).norm())
            .filter(|e| e.is_finite())
            .collect();
        errors.sort_by(f64::total_cmp);
        // All joints but the jaw are known.
        assert_eq!(errors.len(), 54);
        let median = errors[27];
        println!("{}: {:.2} % of labels, joints {median:.1} mm (median)", scan.name, 100.0 * share);
        assert!(median <= 30.0, "{}: joints {median:.1} mm from the truth (median)", scan.name);
        assert_eq!(score.joint_error_mm.map(|[median, _]| median), Some(median));
    }

    let film: Film = value(&experiment.out(), "animate");
    // What a file holds counts, not only what it is called.
    experiment.write("clip.npz", &clip("cmu_35_01_smplh.npz"));
    assert!(experiment.run().ran.is_empty());
    experiment.write("clip.npz", &clip("cmu_49_19_smplx.npz"));
    assert_eq!(experiment.run().ran, ["animate", "export", "report"]);
    assert_eq!(film.clip.poses.len(), 16);
    let walked = film.clip.poses[15].translation - film.clip.poses[0].translation;
    assert!(walked.norm() > 0.5, "in 1 s the walk comes {:.2} m far", walked.norm());
    for garment in &film.garments {
        for (pose, frame) in film.clip.poses.iter().zip(&garment.frames) {
            let far = |p: &[f32; 3]| (0..3).any(|k| (f64::from(p[k]) - pose.translation[k]).abs() > 1.25);
            assert!(!frame.iter().any(far), "{}: cloth far from the person", garment.kind);
        }
    }
}
