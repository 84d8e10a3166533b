//! Measures the equilibrium fit on the study's cloth: 0.3 m square, 441 vertices, five poses, 0.5 mm of noise, same mesh.
//!
//! ```text
//! cargo run --release -p caphy-garment --example estimate_study -- near 20 gray-interlock 11oz-black-denim royal-target
//! cargo run --release -p caphy-garment --example estimate_study -- far
//! ```
//! `near SEEDS [FABRIC…]` starts 15 % off and says bias, scatter and coverage; `surface SEEDS [FABRIC…]` the same from points to
//! surface; `contact SEEDS [FABRIC…]` with one pose on a sphere; `far [FABRIC…]` starts at 4 times, a quarter and another
//! fabric's seven numbers; `files DIR [FABRIC]` writes the poses as scans with a file for `caphy estimate`.

#[path = "../tests/all/estimate/study.rs"]
mod study;

use caphy_core::material::MaterialModel;
use caphy_garment::estimate::{
    EquilibriumEstimate, EquilibriumSettings, Problem, Reduction, ScanPoints, equilibrium, reduction,
};
use std::sync::Arc;
use std::time::Instant;
use study::{Case, NOISE_M, fabric, scaled};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let mode = arguments.next().unwrap_or("near".into());
    let rest: Vec<String> = arguments.collect();
    if mode == "files" {
        let folder = rest.first().ok_or("give a folder")?;
        return write_files(std::path::Path::new(folder), rest.get(1).map_or("gray-interlock", |f| f.as_str()));
    }
    let (seeds, names) = match rest.split_first() {
        Some((first, names)) if mode != "far" => (first.parse()?, names),
        _ => (20, &rest[..]),
    };
    let all: Vec<String> = caphy_materials::measured::Fabric::names()?;
    let names = if names.is_empty() { &all[..] } else { names };
    match mode.as_str() {
        "far" => far(names, &all),
        "near" | "surface" | "contact" => near(names, seeds, &mode),
        _ => Err(format!("`{mode}` is none of near, surface, contact, far, files").into()),
    }
}

fn fit(problem: &Problem, settings: &EquilibriumSettings) -> caphy_core::Result<EquilibriumEstimate> {
    let reduction = Reduction::multipliers(&*problem.material)?;
    let started = Instant::now();
    equilibrium(problem, reduction, settings, None, &mut |p| {
        eprintln!("{:7.2} s {} {:.2?}", started.elapsed().as_secs_f64(), p.message, p.state.y);
        Ok(())
    })
}

fn near(names: &[String], seeds: u64, mode: &str) -> Result<(), Box<dyn std::error::Error>> {
    let (mut inside, mut of) = (0, 0);
    for name in names {
        let case = Case::new(name, mode == "contact");
        let settings = EquilibriumSettings {
            continuation: vec![0.0],
            mesh_log_sd: 0.0,
            friction_spread: vec![],
            ..Default::default()
        };
        let (mut logs, mut sds): (Vec<Vec<f64>>, Vec<Vec<f64>>) = (vec![], vec![]);
        let (mut seconds, mut out, mut chi2) = (0.0, 0, 0.0);
        let mut unknowns = Vec::new();
        for seed in 0..seeds {
            let mut problem = case.problem(scaled(&case.truth, 1.15), NOISE_M, 100 + seed);
            if mode == "surface" {
                for capture in &mut problem.captures {
                    let points = capture.scan.points().to_vec();
                    let faces = case.rest.faces().to_vec();
                    capture.scan = ScanPoints::Surface { points, faces, visible: None };
                }
            }
            let started = Instant::now();
            let found = fit(&problem, &settings)?;
            seconds += started.elapsed().as_secs_f64();
            out += found.poses.iter().filter(|p| p.left_out.is_some()).count();
            chi2 += found.poses.iter().map(|p| p.chi2).sum::<f64>() / found.poses.len() as f64;
            logs.push(case.ratios(&found.parameters).iter().map(|r| r.ln()).collect());
            sds.push(found.unknowns.iter().map(|u| u.log_sd_noise).collect());
            unknowns = found.unknowns;
        }
        println!(
            "{}: {:.1} s a fit, {out} of {} poses left out, χ² {:.3}",
            case.name,
            seconds / seeds as f64,
            5 * seeds,
            chi2 / seeds as f64
        );
        for (k, u) in unknowns.iter().enumerate() {
            let column: Vec<f64> = logs.iter().map(|l| l[k]).collect();
            let sd: Vec<f64> = sds.iter().map(|l| l[k]).collect();
            let mean = |v: &[f64]| v.iter().sum::<f64>() / v.len() as f64;
            let scatter = (column.iter().map(|v| v * v).sum::<f64>() / column.len() as f64).sqrt();
            let held = column.iter().zip(&sd).filter(|(l, s)| l.abs() <= 1.96 * *s).count();
            let worst = column.iter().zip(&sd).map(|(l, s)| l.abs() / s).fold(0.0, f64::max);
            let free = mean(&sd) < settings.held_above;
            if free {
                inside += held;
                of += column.len();
            }
            println!(
                "  {:12} bias {:+.4} rms {scatter:.4} predicted {:.4} covered {held}/{} worst {worst:.1} sd{}",
                u.name,
                mean(&column),
                mean(&sd),
                column.len(),
                if free { "" } else { " (held by the prior)" }
            );
        }
    }
    println!("covered {inside} of {of}");
    Ok(())
}

fn far(names: &[String], all: &[String]) -> Result<(), Box<dyn std::error::Error>> {
    for name in names {
        let case = Case::new(name, false);
        let place = all.iter().position(|n| n == name).unwrap_or(0);
        let other = &all[(place + 3) % all.len()];
        // Another fabric's seven numbers in this one's table: its own table could not become this one by factors.
        let numbers = case.ratios(&fabric(other).parameters().iter().map(|p| p.value.abs()).collect::<Vec<_>>());
        let sizes = case.ratios(&case.truth.parameters().iter().map(|p| p.value.abs()).collect::<Vec<_>>());
        let mut values: Vec<f64> = case.truth.parameters().iter().map(|p| p.value).collect();
        for (k, group) in reduction::groups(&*case.truth).iter().enumerate() {
            group.members.iter().for_each(|&i| values[i] *= numbers[k] / sizes[k]);
        }
        let starts: [(String, Arc<dyn MaterialModel>); 3] = [
            ("× 4".into(), scaled(&case.truth, 4.0)),
            ("÷ 4".into(), scaled(&case.truth, 0.25)),
            (other.clone(), Arc::from(case.truth.with_parameters(&values)?)),
        ];
        for (from, begin) in starts {
            let problem = case.problem(begin, NOISE_M, 7);
            let settings = EquilibriumSettings { mesh_log_sd: 0.0, ..Default::default() };
            let started = Instant::now();
            let found = match fit(&problem, &settings) {
                Ok(found) => found,
                Err(error) => {
                    println!("{name} from {from}: {error}");
                    continue;
                }
            };
            let ratios = case.ratios(&found.parameters);
            let known: Vec<usize> = (0..ratios.len()).filter(|&k| found.unknowns[k].log_sd_noise < 0.07).collect();
            let worst = known.iter().map(|&k| ratios[k].ln().abs()).fold(0.0, f64::max);
            let out = found.poses.iter().filter(|p| p.left_out.is_some()).count();
            println!(
                "{name} from {from}: {:.0} s, {} evaluations, {out} poses out, χ² {:.2}, worst of {} known {:.3}, ratios {:.3?} sd {:.3?}",
                started.elapsed().as_secs_f64(),
                found.evaluations,
                found.inflation,
                known.len(),
                worst.exp() - 1.0,
                ratios,
                found.unknowns.iter().map(|u| u.log_sd_noise).collect::<Vec<_>>()
            );
        }
    }
    Ok(())
}

/// Scans of the poses, finer than the cloth by midpoints and not in its order, with a file that asks for their fabric from another one.
fn write_files(folder: &std::path::Path, name: &str) -> Result<(), Box<dyn std::error::Error>> {
    use caphy_core::TriMesh;
    use caphy_core::scan::Scan;
    let case = Case::new(name, true);
    std::fs::create_dir_all(folder)?;
    let mut random = study::Normal::new(1);
    let begin = if name == "gray-interlock" { "camel-ponte-roma" } else { "gray-interlock" };
    let mut toml = format!(
        "out = \"fitted\"\ncloth = {{ type = \"rectangle\", size_m = [0.3, 0.3], edge_m = 0.015, mass_g = {} }}\n\
         material = {{ type = \"measured\", fabric = \"{begin}\" }}\n\n[equilibrium]\nmesh_log_sd = 0.0\n",
        1e3 * case.rest.mass()
    );
    for (i, (setup, shape)) in case.setups.iter().zip(&case.shapes).enumerate() {
        let faces = case.rest.faces().to_vec();
        let fine = TriMesh { vertices: shape.clone(), faces: faces.clone() }.subdivided();
        let mesh = TriMesh { vertices: random.shaken(&fine.vertices, NOISE_M), faces: fine.faces };
        let scan = Scan { name: setup.name.into(), mesh, colours: None, labels: None };
        std::fs::write(folder.join(format!("scan-{i}.ply")), caphy_formats::ply::write_ply(&scan))?;
        // Registered to a few millimetres; clamps where they are.
        let mut start = random.shaken(shape, 1e-3);
        setup.fixed.iter().for_each(|&v| start[v as usize] = shape[v as usize]);
        let start = TriMesh { vertices: start, faces };
        std::fs::write(folder.join(format!("start-{i}.obj")), caphy_formats::obj::write_obj(&start, None)?)?;
        toml += &format!(
            "\n[[pose]]\nname = \"{}\"\nscan = \"scan-{i}.ply\"\nstart = \"start-{i}.obj\"\nclamps = [{{ vertices = {:?} }}]\n",
            setup.name, setup.fixed
        );
        if setup.body.is_some() {
            toml += "on = { type = \"sphere\", centre = [0.0, -0.08, 0.0], radius_m = 0.08 }\n";
        }
    }
    std::fs::write(folder.join("swatch.toml"), toml)?;
    println!("{}", folder.join("swatch.toml").display());
    Ok(())
}
