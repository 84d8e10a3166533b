//! Subjects without scans: `caphy train`, `caphy simulate`, the scene plan, and nets against the reference solver.

use crate::commands::{caphy, refusal, text};
use crate::experiment::{Experiment, edited, value};
use caphy::plan::ScenePlan;
use caphy::runner::Run;
use caphy::stage::animate::Film;
use caphy::stage::compare::Comparison;
use caphy_formats::obj::read_obj;
use serde_json::Value;
use std::path::Path;

/// One shirt, trained a little and compared on half a second.
const SHIRT: &str = r#"
[run]
out = "out"

[subject]
type = "dressed"
shape = [0.5]

[body]
type = "mannequin"
resolution = 0.03

[upper]
material = { type = "stvk", young_pa = 0.7e5, poisson = 0.485, thickness_m = 0.47e-3, density_kg_per_m2 = 0.2 }
style = [0.3, 0.4, 0.015, 0.05]
resolution_m = 0.05

[net]
type = "gru"
layers = 2
hidden = 32

[motion]
clips = [{ type = "procedural", kind = "walk", seconds = 2 }]

[train]
rounds = 4
windows = 160

[compare]
clip = { type = "procedural", kind = "walk", seconds = 0.5, seed = 11 }
rest_every = 8

[animate]
clip = { type = "procedural", kind = "walk", seconds = 0.5, seed = 11 }
push_out_m = 0
"#;

fn planned(experiment: &Experiment) -> ScenePlan {
    Run::open(&experiment.config(), Some(experiment.out())).and_then(Run::plan).unwrap_or_else(|e| panic!("{e}"))
}

#[test]
fn a_dressed_body_is_planned_trained_compared_and_played() {
    let experiment = Experiment::new(SHIRT);
    let plan = planned(&experiment);
    let off = |name: &str| {
        plan.stages.iter().find(|s| s.name == name).unwrap_or_else(|| panic!("no stage {name}")).off.clone()
    };
    assert_eq!(off("train"), None);
    assert!(off("evaluate").is_some_and(|why| why.contains("scans")));
    assert!(off("finetune").is_some_and(|why| why.contains("one garment")));
    assert!(plan.stages.iter().all(|s| s.done == (s.name == "dress")), "a plan runs nothing: {}", plan.text());
    let shirt = &plan.garments[0];
    assert!(shirt.body_vertices[0] < shirt.body_vertices[1], "legs are out of a shirt's reach");
    assert!(!shirt.joints.iter().any(|j| j.contains("knee")), "{:?}", shirt.joints);
    let active: Vec<&str> = shirt.terms.iter().filter(|t| t.off.is_none()).map(|t| t.name).collect();
    assert_eq!(active, ["strain", "bending", "gravity", "inertia", "collision"]);

    let narrowed = Run::open(&experiment.config(), Some(experiment.out())).and_then(|r| r.only("train"));
    let summary = narrowed.and_then(Run::all).unwrap_or_else(|e| panic!("{e}"));
    // Planning has dressed the body already.
    assert_eq!((summary.ran, summary.report), (vec!["train"], None));
    assert_eq!(experiment.run().ran, ["reference", "compare", "animate", "export", "report"]);
    assert!(experiment.run().ran.is_empty());
    assert!(planned(&experiment).stages.iter().all(|s| s.done == s.off.is_none()));

    let comparison: Comparison = value(&experiment.out(), "compare");
    let g = &comparison.garments[0];
    assert_eq!(g.unconverged.map(|u| u[0]), [0, 0], "{}", comparison.table());
    let sum = |list: &[(String, f64)]| list.iter().map(|e| e.1).sum::<f64>();
    let (skinned, net, solver) = (sum(&g.at_rest.skinned), sum(&g.at_rest.net), sum(&g.at_rest.solver));
    // Nothing lies below a minimum; a little training leads from the skinned template towards it.
    assert!(solver < net && net < skinned, "{}", comparison.table());
    assert!((0.0..1.0).contains(&g.excess()));
    assert_eq!(g.hem_m.solver.len(), 16);
    assert!(g.swing_m.skinned == 0.0 && g.swing_m.solver > 0.0);

    // The avatar plays without its experiment, as it did within.
    let film: Film = value(&experiment.out(), "animate");
    let mut clip = edited("type = \"procedural\"\nkind = \"walk\"\nseconds = S\nseed = 11\n", &[("S", "0.5")]);
    clip.push('\n');
    experiment.write("clip.toml", clip.as_bytes());
    let at = experiment.folder.path();
    let play = ["animate", "out/export/avatar.caphy", "--motion", "clip.toml", "--format", "obj"];
    let played = caphy(at, &[&play[..], &["--push-out", "0", "--seconds", "0.5", "--out", "played"]].concat());
    assert!(played.status.success(), "{}", text(&played.stderr));
    let path = at.join("played/upper/frame_0009.obj");
    let mesh = read_obj(&path, &std::fs::read(&path).expect("an OBJ")).expect("a mesh").scan.mesh;
    for (a, b) in mesh.vertices.iter().zip(film.garments[0].vertices(8)) {
        assert!((a - b).norm() < 1e-6, "{a} is not {b}");
    }
    // Another body than the avatar's own is refused: its joints or vertices are others.
    let refused = refusal(at, &["animate", "out/dress.caphy", "--motion", "walk", "--out", "x"]);
    assert!(refused.contains("dress.caphy") && refused.contains("no avatar"), "{refused}");
    let both =
        refusal(at, &["animate", "out/export/avatar.caphy", "--garment", "upper", "--motion", "walk", "--out", "x"]);
    assert!(both.contains("--garment"), "{both}");
}

#[test]
fn what_a_scene_does_not_have_is_refused() {
    for (edit, named) in [
        (("[compare]", "[segmenter]\ntype = \"vertex\"\n\n[compare]"), ["segmenter", "no scans"]),
        (("[compare]", "[finetune]\nepochs = 3\n\n[compare]"), ["finetune", "one garment"]),
        (("rounds = 4", "rounds = 4\nscan_epochs = 2"), ["train.scan_epochs", "no scans"]),
        (("style = [0.3, 0.4, 0.015, 0.05]", "style = [0.3]"), ["4 values", "got 1"]),
    ] {
        let error = Experiment::new(&edited(SHIRT, &[edit])).error();
        assert!(named.iter().all(|n| error.contains(n)), "{named:?} are not in: {error}");
    }
    let scans = [
        ("type = \"dressed\"\nshape = [0.5]", "type = \"scans\"\nfolder = \"scans\""),
        ("style = [0.3, 0.4, 0.015, 0.05]\n", ""),
    ];
    let error = Experiment::new(&edited(SHIRT, &scans)).error();
    assert!(error.contains("add [segmenter]"), "{error}");
    let (garment, rest) = SHIRT.split_once("[upper]").expect("a garment");
    let bare = format!("{garment}{}", &rest[rest.find("[net]").expect("a net")..]);
    let error = Experiment::new(&bare).error();
    assert!(error.contains("there is no garment"), "{error}");
    let experiment = Experiment::new(SHIRT);
    let at = experiment.folder.path();
    let unknown = refusal(at, &["run", "experiment.toml", "--only", "trian"]);
    assert!(unknown.contains("trian") && unknown.contains("train"), "{unknown}");
    let off = refusal(at, &["run", "experiment.toml", "--only", "evaluate"]);
    assert!(off.contains("no scans"), "{off}");
}

#[test]
fn a_template_a_fabric_and_motion_become_an_avatar() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = folder.path();
    std::fs::write(at.join("body.toml"), "type = \"mannequin\"\nresolution = 0.03\n").expect("a written file");
    std::fs::write(at.join("net.toml"), "type = \"mlp\"\nhidden = [16]\n").expect("a written file");
    let given =
        ["train", "--body", "body.toml", "--garment", "lower", "--material", "gray-interlock", "--motion", "walk"];
    let how = ["--seconds", "1", "--resolution", "0.05", "--rounds", "1", "--net", "net.toml", "--out", "trousers"];
    let trained = caphy(at, &[&given[..], &how].concat());
    assert!(trained.status.success(), "{}", text(&trained.stderr));
    assert!(text(&trained.stdout).contains("avatar.caphy"));
    // What it has written is the experiment.
    let again = caphy(at, &["run", "trousers/experiment.toml", "--only", "export"]);
    assert!(again.status.success() && text(&again.stdout).contains("Nothing to do"), "{}", text(&again.stderr));
    let plan = caphy(at, &["run", "trousers/experiment.toml", "--plan", "--json"]);
    let plan: Value = serde_json::from_slice(&plan.stdout).expect("JSON");
    assert_eq!(plan["garments"][0]["name"], "lower");
    assert!(plan["stages"].as_array().is_some_and(|s| s.iter().any(|s| s["name"] == "train" && s["done"] == true)));
    let two = refusal(
        at,
        &[&given[..], &["--garment", "upper", "--material", "a", "--material", "b", "--material", "c"], &how].concat(),
    );
    assert!(two.contains("4 fabrics for 2 garments"), "{two}");
    let unknown = refusal(at, &["train", "--garment", "upper", "--material", "silk", "--motion", "walk", "--out", "x"]);
    assert!(unknown.contains("silk") && unknown.contains("gray-interlock"), "{unknown}");
}

#[test]
fn garments_are_simulated() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = folder.path();
    std::fs::write(at.join("body.toml"), "type = \"mannequin\"\nresolution = 0.03\n").expect("a written file");
    let worn = ["simulate", "--body", "body.toml", "--garment", "upper:0.3,0.4,0.015,0.05", "--garment", "lower"];
    let how = ["--motion", "walk", "--seconds", "0.1", "--resolution", "0.05", "--format", "obj"];
    for steps in ["dynamic", "quasi_static"] {
        let fabric = ["--material", "gray-interlock", "--steps", steps, "--out", steps];
        let output = caphy(at, &[&worn[..], &how, &fabric].concat());
        assert!(output.status.success(), "{}", text(&output.stderr));
        let path = at.join(steps).join("simulation.json");
        let solved: Value = serde_json::from_slice(&std::fs::read(path).expect("a file")).expect("JSON");
        let garments = solved.as_array().expect("garments");
        assert_eq!(garments.len(), 2);
        for garment in garments {
            let frames = garment["frames"].as_array().expect("frames");
            assert_eq!(frames.len(), 4);
            for (i, frame) in frames.iter().enumerate() {
                let moves = frame["energies"].as_array().is_some_and(|e| e.iter().any(|e| e[0] == "inertia"));
                assert_eq!(moves, steps == "dynamic" && i > 0, "{garment}");
                if frame["outcome"] == "converged" {
                    assert!(frame["residual_n"].as_f64().is_some_and(|r| r <= 1e-5), "{frame}");
                }
            }
        }
        assert!(at.join(steps).join("upper/frame_0004.obj").exists() && at.join(steps).join("preview.png").exists());
    }
    let none = refusal(at, &["simulate", "--material", "gray-interlock", "--motion", "walk", "--out", "x"]);
    assert!(none.contains("--garment"), "{none}");
    assert!(!Path::new("x").exists());
}
