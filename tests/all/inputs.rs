//! `caphy show body|garment|motion` and `caphy animate`, as a shell would call them.

use crate::commands::{caphy, refusal, text};
use crate::experiment::shared;
use caphy_core::Vec3;
use caphy_formats::obj::read_obj;
use serde_json::Value;
use std::path::Path;

/// A coarse mannequin: these tests look at the commands, not at the body.
const BODY: &str = "type = \"mannequin\"\nresolution = 0.03\n";

fn folder() -> tempfile::TempDir {
    let folder = tempfile::tempdir().expect("a folder");
    std::fs::write(folder.path().join("body.toml"), BODY).expect("a written file");
    folder
}

fn ok(folder: &Path, arguments: &[&str]) -> String {
    let output = caphy(folder, arguments);
    assert!(output.status.success(), "{arguments:?}: {}", text(&output.stderr));
    text(&output.stdout)
}

fn json(folder: &Path, arguments: &[&str]) -> Value {
    serde_json::from_str(&ok(folder, arguments)).expect("JSON")
}

fn is_png(path: &Path) -> bool {
    std::fs::read(path).is_ok_and(|bytes| bytes.starts_with(b"\x89PNG"))
}

#[test]
fn a_body_is_shown() {
    let folder = folder();
    let at = folder.path();
    let facts = json(at, &["show", "body", "body.toml", "--json", "--picture", "body.png"]);
    assert_eq!(facts["joints"].as_array().map(Vec::len), Some(55));
    assert_eq!((&facts["boundary_loops"], &facts["bad_edges"]), (&0.into(), &0.into()), "the mannequin is closed");
    let height = facts["size_m"][1].as_f64().expect("a height");
    assert!((1.5..2.1).contains(&height), "{height}");
    assert!(is_png(&at.join("body.png")));
    // A body of another shape is another body.
    let taller = json(at, &["show", "body", "body.toml", "--shape", "1.5", "--json"]);
    assert_ne!(taller["size_m"][1], facts["size_m"][1]);
    assert!(ok(at, &["show", "body", "body.toml"]).contains("litres"));
    let wrong = refusal(at, &["show", "body", "manequin"]);
    assert!(wrong.contains("manequin") && wrong.contains("mannequin, smplx"), "{wrong}");
    assert!(refusal(at, &["show", "body", "nobody.npz"]).contains("nobody.npz"));
}

#[test]
fn garments_are_shown() {
    let folder = folder();
    let at = folder.path();
    let arguments = ["show", "garment", "lower", "--body", "body.toml", "--resolution", "0.03", "--json"];
    let some = json(at, &[&arguments[..], &["--count", "2", "--seed", "3", "--picture", "lower.png"]].concat());
    let some = some.as_array().expect("a list");
    assert_eq!(some.len(), 2);
    assert_ne!(some[0]["style"], some[1]["style"]);
    assert!(is_png(&at.join("lower.png")));
    let own = ["show", "garment", "upper:0.4,0.5,0.02,0.1", "--body", "body.toml", "--resolution", "0.03", "--json"];
    let shirt = &json(at, &own)[0];
    assert_eq!(shirt["style"]["sleeve_length"], 0.4);
    let loops: Vec<&str> =
        shirt["loops"].as_array().expect("loops").iter().filter_map(|l| l["name"].as_str()).collect();
    assert!(loops.contains(&"neck") && loops.len() == 4, "{loops:?}");
    let wrong = refusal(at, &["show", "garment", "upper:0.4", "--body", "body.toml"]);
    assert!(wrong.contains("expected 4 values, got 1"), "{wrong}");
    assert!(refusal(at, &["show", "garment", "upper:0.4,0.5,9,0.1", "--body", "body.toml"]).contains("looseness"));
    assert!(refusal(at, &["show", "garment", "skirt", "--body", "body.toml"]).contains("skirt"));
}

#[test]
fn motion_is_shown() {
    let folder = folder();
    let at = folder.path();
    let arguments =
        ["show", "motion", "walk", "--body", "body.toml", "--seconds", "2", "--json", "--picture", "walk.png"];
    let facts = json(at, &arguments);
    assert_eq!((&facts["frames"], &facts["fps"]), (&61.into(), &30.0.into()));
    assert_eq!(facts["windows"].as_u64(), Some(57), "all windows of five frames are sound");
    assert!(facts["root_path_m"].as_f64().is_some_and(|way| way > 0.5));
    assert!(is_png(&at.join("walk.png")));
    std::fs::write(at.join("clip.toml"), "type = \"procedural\"\nkind = \"squat\"\nseconds = 1.0\nsped = 2\n")
        .expect("a file");
    let wrong = refusal(at, &["show", "motion", "clip.toml"]);
    assert!(wrong.contains("clip.toml") && wrong.contains("sped") && wrong.contains('4'), "{wrong}");
    assert!(refusal(at, &["show", "motion", "dance"]).contains("walk"));
}

#[test]
fn a_dressed_body_moves_in_every_format() {
    let folder = folder();
    let at = folder.path();
    let common = ["animate", "--body", "body.toml", "--garment", "upper", "--garment", "lower", "--motion", "walk"];
    let rest = ["--seconds", "0.3", "--resolution", "0.04", "--format"];
    let run = |format: &str| {
        let out = format!("out-{format}");
        ok(at, &[&common[..], &rest, &[format, "--out", &out]].concat());
        assert!(is_png(&at.join(&out).join("preview.png")));
        at.join(out)
    };
    let bytes = |path: &Path| std::fs::read(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    let glb = bytes(&run("glb").join("avatar.glb"));
    assert!(glb.starts_with(b"glTF") && glb.len() == u32::from_le_bytes([glb[8], glb[9], glb[10], glb[11]]) as usize);
    let usd = text(&bytes(&run("usd").join("avatar.usda")));
    for name in ["\"body\"", "\"upper\"", "\"lower\""] {
        assert!(usd.contains(&format!("def Mesh {name}")), "{name}");
    }
    // 0.3 s at 30 frames per second are ten frames, in every file the same.
    let obj = run("obj");
    let frame = |name: &str, i: usize| -> Vec<Vec3> {
        let path = obj.join(name).join(format!("frame_{i:04}.obj"));
        read_obj(&path, &bytes(&path)).expect("an OBJ").scan.mesh.vertices
    };
    let pc2 = run("pc2");
    for name in ["body", "upper", "lower"] {
        assert!(obj.join(name).join("frame_0010.obj").is_file() && !obj.join(name).join("frame_0011.obj").exists());
        let cache = bytes(&pc2.join(format!("{name}.pc2")));
        let vertices = frame(name, 10);
        assert_eq!(cache.len(), 32 + 10 * 12 * vertices.len());
        let last = &cache[32 + 9 * 12 * vertices.len()..];
        for (point, v) in last.chunks_exact(12).zip(&vertices) {
            let x = f32::from_le_bytes([point[0], point[1], point[2], point[3]]);
            // Rounding of OBJ's eight digits and of f32 at a few metres.
            assert!((f64::from(x) - v.x).abs() < 1e-6, "{name}");
        }
        assert_ne!(frame(name, 1), vertices, "{name} moves");
    }
}

#[test]
fn garments_and_motion_that_nobody_here_made() {
    let Some(shared) = shared() else { return };
    let data = shared.join("data");
    let path = |name: &str| data.join(name).display().to_string();
    let (body, shirt) = (path("body/anny_smplx_layout.npz"), path("garments/male_casualsuit02_upper.obj"));
    // The shape that the garments were made for.
    let shape = {
        let bytes = std::fs::read(&body).expect("the body");
        let npz = caphy_formats::npz::Npz::from_bytes(Path::new(&body), bytes).expect("an archive");
        let betas = npz.f64s("ref__0__mid_betas").expect("coefficients");
        betas.data.iter().map(f64::to_string).collect::<Vec<_>>().join(",")
    };
    let folder = folder();
    let at = folder.path();
    let facts = json(at, &["show", "garment", &shirt, "--body", &body, "--shape", &shape, "--json"]);
    assert_eq!(facts[0]["kind"], "upper");
    assert_eq!(facts[0]["given"]["penetration"]["inside_share"][1], 0.0);
    for clip in ["cmu_131_01.bvh", "35_01.amc", "cmu_49_18_smplh.npz"] {
        let clip = path(&format!("mocap/{clip}"));
        let facts = json(at, &["show", "motion", &clip, "--translation", "pelvis_position", "--json"]);
        assert!(
            facts["source_fps"].as_f64().is_some_and(|fps| (fps - 120.0).abs() < 0.01),
            "{clip}: {}",
            facts["source_fps"]
        );
    }
}

#[test]
fn a_trackers_file_is_smoothed_and_stood_up() {
    let folder = folder();
    let at = folder.path();
    // What is no tracker's is not read as one.
    let play = ["animate", "--garment", "upper", "--motion", "walk", "--out", "x"];
    let said = refusal(at, &[&play[..], &["--up", "z"]].concat());
    assert!(said.contains("--up") && said.contains("no .npz"), "{said}");
    let said = refusal(at, &[&play[..], &["--smoothing", "0.1"]].concat());
    assert!(said.contains("--smoothing") && said.contains("--gravity"), "{said}");
    let Some(shared) = shared() else { return };
    let clip = shared.join("data/mocap/cmu_49_18_smplh.npz").display().to_string();
    let frames = |name: &str, options: &[&str]| {
        let play = ["animate", "--body", "body.toml", "--motion", &clip, "--translation", "pelvis_position"];
        let out = ["--seconds", "0.2", "--format", "obj", "--out", name];
        let output = caphy(at, &[&play[..], &out, options].concat());
        assert!(output.status.success(), "{}", text(&output.stderr));
        let path = at.join(name).join("body/frame_0004.obj");
        read_obj(&path, &std::fs::read(&path).expect("an OBJ")).expect("a mesh").scan.mesh.vertices
    };
    let apart = |a: &[Vec3], b: &[Vec3]| a.iter().zip(b).map(|(a, b)| (a - b).norm()).fold(0.0, f64::max);
    let recorded = frames("amass", &[]);
    // Eight digits of a few metres.
    assert!(apart(&recorded, &frames("axis", &["--up", "z", "--smoothing", "0"])) < 1e-6);
    assert!(apart(&recorded, &frames("gravity", &["--gravity", "0,0,-9.81", "--smoothing", "0"])) < 1e-6);
    let smoothed = apart(&recorded, &frames("smoothed", &["--gravity", "0,0,-1", "--smoothing", "0.2"]));
    assert!(smoothed > 1e-3 && smoothed < 0.5, "{smoothed}");
    let tilted = frames("tilted", &["--gravity", "0,0.5,-1"]);
    assert!(apart(&recorded, &tilted) > 0.1);
    let said = refusal(at, &["animate", "--motion", &clip, "--gravity", "0,0,0", "--out", "x"]);
    assert!(said.contains("--gravity"), "{said}");
}
