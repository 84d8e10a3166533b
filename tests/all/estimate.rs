use crate::commands::{caphy, refusal, text};
use crate::experiment::{Experiment, TINY, edited, value};
use crate::pipeline::finished;
use caphy::stage::optimise::Estimates;
use caphy::stage::train::Nets;
use caphy_core::material::{MaterialModel, MaterialSpec};
use caphy_core::scan::Scan;
use caphy_core::{TriMesh, Vec3};
use caphy_garment::estimate::cloth;
use caphy_garment::solver::{Forces, Scene, Solver, SolverSettings};
use serde_json::Value;
use std::path::Path;
use std::sync::Arc;

const STVK: &str = "lambda_n_per_m = 30.0\nmu_n_per_m = 12.0\nbending_nm = 6e-5\ndensity_kg_per_m2 = 0.2\n";

/// A 0.2 m cloth that sticks out by half along u and along v, scanned with 0.2 mm of ripple, and the file that asks for its fabric.
fn write_swatch(folder: &Path) -> Arc<dyn MaterialModel> {
    let truth: Arc<dyn MaterialModel> =
        Arc::from(toml::from_str::<caphy_materials::MaterialStvkSpec>(STVK).unwrap().build().unwrap());
    let rest = cloth::sheet(8, 8, [0.2, 0.2], 0.2).unwrap();
    let mut file = format!(
        "out = \"fitted\"\ncloth = {{ type = \"rectangle\", size_m = [0.2, 0.2], edge_m = 0.025, mass_g = {} }}\n\
         [material]\ntype = \"stvk\"\nlambda_n_per_m = 45.0\nmu_n_per_m = 18.0\nbending_nm = 9e-5\n",
        1e3 * rest.mass()
    );
    for (name, axis) in [("along u", 0), ("along v", 1)] {
        let flat = &rest.template.vertices;
        let held = |p: &Vec3| p[axis] <= 0.1 + 1e-9;
        let start: Vec<Vec3> = flat.iter().map(|p| Vec3::new(p.x, 1e-3 * (p.x - p.y), -p.y)).collect();
        let fixed: Vec<u32> = (0..flat.len() as u32).filter(|&v| held(&flat[v as usize])).collect();
        let mut solver = Solver::new(&rest, truth.clone(), Forces::default(), SolverSettings::default()).unwrap();
        let scene = Scene { fixed: &fixed, ..Default::default() };
        let shape = solver.solve(&scene, &start, &|_| {}).unwrap().positions;
        let mesh = TriMesh { vertices: shape, faces: rest.faces().to_vec() };
        let mut scan = Scan { name: name.into(), mesh: mesh.subdivided(), ..Default::default() };
        for (i, p) in scan.mesh.vertices.iter_mut().enumerate() {
            *p += 2e-4 * Vec3::new((12.3 * i as f64).sin(), (4.56 * i as f64).sin(), (7.89 * i as f64).sin());
        }
        std::fs::write(folder.join(format!("{axis}.ply")), caphy_formats::ply::write_ply(&scan)).unwrap();
        let laid = TriMesh { vertices: start, faces: rest.faces().to_vec() };
        std::fs::write(folder.join(format!("{axis}.obj")), caphy_formats::obj::write_obj(&laid, None).unwrap())
            .unwrap();
        let normal = if axis == 0 { "[-1.0, 0.0, 0.0]" } else { "[0.0, -1.0, 0.0]" };
        file += &format!(
            "[[pose]]\nname = \"{name}\"\nscan = \"{axis}.ply\"\nstart = \"{axis}.obj\"\n\
             clamps = [{{ normal = {normal}, offset_m = -0.1001 }}]\n"
        );
    }
    std::fs::write(folder.join("swatch.toml"), file).unwrap();
    truth
}

#[test]
fn a_swatch_is_estimated_from_files_and_shown() {
    let folder = tempfile::tempdir().unwrap();
    let truth = write_swatch(folder.path());
    let output = caphy(folder.path(), &["estimate", "swatch.toml", "--json"]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    let found: Value = serde_json::from_slice(&output.stdout).unwrap();
    let after: Vec<f64> = found["after"].as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect();
    let bend = truth.parameters().iter().position(|p| p.name.starts_with("bend")).unwrap();
    let ratio = after[bend] / truth.parameters()[bend].value;
    assert!((ratio - 1.0).abs() < 0.05, "bending {ratio} of the truth");
    assert!(found["weighed"].as_bool().unwrap());
    let page = std::fs::read_to_string(folder.path().join("fitted/report.html")).unwrap();
    assert!(page.contains("effective at this mesh") && page.matches("data:image/png").count() == 4);
    // Again: from the kept state, to the same values.
    let again = caphy(folder.path(), &["estimate", "swatch.toml", "--json"]);
    let again: Value = serde_json::from_slice(&again.stdout).unwrap();
    assert_eq!(found["after"], again["after"]);
}

/// A finished run with another estimator: only the fabric is looked for again.
#[test]
fn an_experiment_estimates_its_garments() {
    let lower = "\n[lower]\nmaterial = { type = \"measured\", fabric = \"camel-ponte-roma\" }";
    for (estimator, has, used) in [
        // A step at one λ and then two without: how good the values are is not this test's.
        (
            "type = \"equilibrium\", scans = 1, largest_misfit = 100, fit = { steps_while_held = 1, steps = 2 }",
            "What the poses determine",
            true,
        ),
        // Templates of this coarse subject are centimetres off.
        (
            "type = \"equilibrium\", scans = 1, fit = { steps_while_held = 1, steps = 1 }",
            "not used: the poses fit",
            false,
        ),
        ("type = \"alternation\", inner = \"solver\", rounds = 2", "Eq. 10: gradient", true),
    ] {
        let config =
            edited(TINY, &[("type = \"alternation\"", estimator), (lower, &format!("{lower}\nmass_g = 350.0"))]);
        let experiment = Experiment::copy_of(finished(), &config);
        let folder = experiment.folder.path();
        let out = experiment.out();
        let arguments = ["estimate", "experiment.toml", "--json", "--out", out.to_str().unwrap()];
        let output = caphy(folder, &arguments);
        assert!(output.status.success(), "{}", text(&output.stderr));
        let found: Value = serde_json::from_slice(&output.stdout).unwrap();
        let garments = found[0]["garments"].as_array().unwrap();
        assert_eq!(garments.len(), 2);
        for (garment, weighed) in garments.iter().zip([false, true]) {
            let fabric = &garment["fabric"];
            assert_eq!(fabric["weighed"].as_bool(), Some(weighed));
            let values = |key: &str| -> Vec<f64> {
                fabric[key].as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect()
            };
            let (before, after) = (values("before"), values("after"));
            assert_eq!(before.len(), after.len());
            assert!((before != after) == used && after.iter().all(|v| v.is_finite()), "{after:?}");
            let page = std::fs::read_to_string(out.join(garment["page"].as_str().unwrap())).unwrap();
            assert!(page.contains(has) && page.matches("data:image/png").count() >= 2);
            assert!(out.join(garment["picture"]["file"].as_str().unwrap()).exists());
        }
        let summary = experiment.run_until("train-optimised");
        assert_eq!(summary.ran, ["train-optimised"], "the estimate is kept, and goes into training");
        let nets: Nets = value(&out, "train-optimised");
        let kept: Estimates = value(&out, "optimise");
        assert_eq!(nets.garments[1].material.as_ref(), Some(&kept.garments[1].fabric.after));
    }
}

#[test]
fn what_cannot_be_estimated_is_refused_with_its_place() {
    let folder = tempfile::tempdir().unwrap();
    write_swatch(folder.path());
    let file = std::fs::read_to_string(folder.path().join("swatch.toml")).unwrap();
    let with = |from: &str, to: &str| {
        assert!(file.contains(from), "{from}");
        std::fs::write(folder.path().join("bad.toml"), file.replace(from, to)).unwrap();
        refusal(folder.path(), &["estimate", "bad.toml"])
    };
    let said = with("name = \"along u\"", "nome = \"along u\"");
    assert!(said.contains("nome") && said.contains("bad.toml, line"), "{said}");
    let said = with("mu_n_per_m", "nu_n_per_m");
    assert!(said.contains("nu_n_per_m") && said.contains("line"), "{said}");
    let said = with("mass_g = 8", "mass_g = -8");
    assert!(said.contains("mass_g") && said.contains("weigh"), "{said}");
    let said = with("offset_m = -0.1001", "offset_m = 9.0");
    assert!(said.contains("clamps") && said.contains("holds no vertex"), "{said}");
    let said = with("[material]", "[alternation]\nrounds = 3\n[material]");
    assert!(said.contains("alternation") && said.contains("no effect"), "{said}");
    let said = with("scan = \"0.ply\"", "scan = \"none.ply\"");
    assert!(said.contains("none.ply"), "{said}");
}
