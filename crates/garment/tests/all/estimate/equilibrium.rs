//! The equilibrium fit of the study's case.

use super::study::*;
use caphy_core::Vec3;
use caphy_core::material::MaterialModel;
use caphy_garment::estimate::equilibrium::equilibrium;
use caphy_garment::estimate::{CutPart, EquilibriumSettings, FitState, Problem, Reduction, ScanPoints, cloth};
use caphy_garment::solver::SolverSettings;
use caphy_materials::MaterialStvkSpec;
use std::sync::Arc;

fn settings() -> EquilibriumSettings {
    EquilibriumSettings { mesh_log_sd: 0.0, ..Default::default() }
}

#[test]
fn a_knit_is_found_from_near_and_from_four_times_too_stiff() {
    let case = Case::new("gray-interlock", false);
    for factor in [1.2, 4.0] {
        let problem = case.problem(scaled(&case.truth, factor), NOISE_M, 3);
        let reduction = Reduction::multipliers(&*problem.material).unwrap();
        let found = equilibrium(&problem, reduction, &settings(), None, &mut |_| Ok(())).unwrap();
        let ratios = case.ratios(&found.parameters);
        for (u, ratio) in found.unknowns.iter().zip(&ratios) {
            eprintln!("from {factor}: {:12} {ratio:.4} of the truth, sd {:.4}", u.name, u.log_sd_noise);
            assert!(!u.held_by_prior, "{u:?}");
            // Four standard deviations: fourteen numbers, once in 1000 times.
            assert!(ratio.ln().abs() < 4.0 * u.log_sd_noise, "{} {ratio}", u.name);
            if u.name.starts_with("bend") {
                assert!((ratio - 1.0).abs() < 0.05, "{} {ratio}", u.name);
            }
        }
        assert!((found.inflation - 1.0).abs() < 0.1, "{}", found.inflation);
        assert!(found.warnings.iter().any(|w| w.contains("effective at this mesh")));
    }
}

/// A small sheet of StVK that hangs by two corners and sticks out: fast.
fn small(noise: f64, points: impl Fn(&[Vec3]) -> ScanPoints) -> (Problem, Vec<f64>) {
    let text = "lambda_n_per_m = 30.0\nmu_n_per_m = 12.0\nbending_nm = 6e-5\n";
    let truth: Arc<dyn MaterialModel> =
        Arc::new(toml::from_str::<MaterialStvkSpec>(text).unwrap().build_stvk().unwrap());
    let rest = cloth::sheet(10, 10, [SIDE, SIDE], 0.2).unwrap();
    let setups = setups(&rest, false);
    let solver = SolverSettings { tolerance_n: 1e-9, ..Default::default() };
    let setups: Vec<Setup> = setups.into_iter().take(3).collect();
    let shapes: Vec<_> = setups.iter().map(|s| at_rest(&rest, &truth, s, solver)).collect();
    let mut out = problem(&rest, &setups, &shapes, scaled(&truth, 1.3), noise, 5, solver);
    for (capture, shape) in out.captures.iter_mut().zip(&shapes) {
        capture.sigma_m = Some(noise);
        if let ScanPoints::Known { points: seen, .. } = &capture.scan {
            let _ = shape;
            capture.scan = points(seen);
        }
    }
    (out, truth.parameters().iter().map(|p| p.value).collect())
}

fn known(points: &[Vec3]) -> ScanPoints {
    ScanPoints::Known { vertices: (0..points.len() as u32).collect(), points: points.to_vec() }
}

#[test]
fn another_kind_of_fabric_is_estimated_by_its_own_parameters() {
    let (problem, truth) = small(3e-4, known);
    let reduction = Reduction::multipliers(&*problem.material).unwrap();
    assert!(reduction.len() >= 3, "{:?}", reduction.names);
    let found = equilibrium(&problem, reduction, &settings(), None, &mut |_| Ok(())).unwrap();
    for (i, u) in found.unknowns.iter().enumerate() {
        if u.held_by_prior {
            continue;
        }
        let ratio: f64 = found.parameters[i] / truth[i];
        assert!(ratio.ln().abs() < 4.0 * u.log_sd_noise, "{} {ratio} ± {}", u.name, u.log_sd_noise);
    }
}

#[test]
fn a_scanned_surface_does_as_well_as_known_points() {
    let rest = cloth::sheet(10, 10, [SIDE, SIDE], 0.2).unwrap();
    let faces = rest.faces().to_vec();
    let surface =
        |points: &[Vec3]| ScanPoints::Surface { points: points.to_vec(), faces: faces.clone(), visible: None };
    let (problem, truth) = small(3e-4, surface);
    let reduction = Reduction::multipliers(&*problem.material).unwrap();
    let found = equilibrium(&problem, reduction, &settings(), None, &mut |_| Ok(())).unwrap();
    for (i, u) in found.unknowns.iter().enumerate() {
        let ratio: f64 = found.parameters[i] / truth[i];
        eprintln!("{:12} {ratio:.4} of the truth, sd {:.4}", u.name, u.log_sd_noise);
        // One-sided distances at the edge are not Gaussian: some room.
        if !u.held_by_prior {
            assert!(ratio.ln().abs() < 6.0 * u.log_sd_noise + 0.02, "{} {ratio} ± {}", u.name, u.log_sd_noise);
        }
    }
}

#[test]
fn a_killed_fit_goes_on_to_the_same_bits() {
    let (problem, _) = small(3e-4, known);
    let reduction = || Reduction::multipliers(&*problem.material).unwrap();
    let mut states: Vec<FitState> = Vec::new();
    let whole = equilibrium(&problem, reduction(), &settings(), None, &mut |p| {
        states.push(p.state.clone());
        Ok(())
    })
    .unwrap();
    let middle = states[states.len() / 2].clone();
    let resumed = equilibrium(&problem, reduction(), &settings(), Some(middle), &mut |_| Ok(())).unwrap();
    assert_eq!(whole.parameters, resumed.parameters);
    assert_eq!(whole.shapes, resumed.shapes);
    let threads = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    let alone = threads.install(|| equilibrium(&problem, reduction(), &settings(), None, &mut |_| Ok(())).unwrap());
    assert_eq!(whole, alone);
}

#[test]
fn a_pose_on_another_branch_is_left_out_and_a_weightless_answer_says_so() {
    let (mut problem, truth) = small(3e-4, known);
    problem.weighed = false;
    // The scan of the second pose is bent the other way, as no cloth hangs.
    if let ScanPoints::Known { points, .. } = &mut problem.captures[1].scan {
        points.iter_mut().for_each(|p| p.y = -p.y);
    }
    let reduction = Reduction::multipliers(&*problem.material).unwrap();
    let found = equilibrium(&problem, reduction, &settings(), None, &mut |_| Ok(())).unwrap();
    assert!(found.poses[1].left_out.is_some(), "{:?}", found.poses);
    assert!(found.poses.iter().filter(|p| p.left_out.is_some()).count() == 1, "{:?}", found.poses);
    assert!(found.warnings.iter().any(|w| w.contains(&found.poses[1].name) && w.contains("left out")));
    assert!(found.warnings.iter().any(|w| w.contains("stiffness over density")));
    let bend = found.parameters.len() - 1;
    assert!((found.parameters[bend] / truth[bend] - 1.0).abs() < 0.05);
}

#[test]
fn each_part_of_the_cut_is_found_by_itself() {
    // Scans of a cloth of which one half is cut 2 % longer than believed, the other half 2 % shorter: no one ease says that.
    let (mut problem, truth) = small(3e-4, known);
    let rest = problem.rest.clone();
    let near: Vec<f64> = (0..rest.faces().len())
        .map(|f| rest.faces()[f].iter().map(|&v| rest.template.vertices[v as usize].y).sum::<f64>() / 3.0)
        .map(|y| f64::from(u8::from(y < 0.5 * SIDE)))
        .collect();
    let cut = |f: usize| if near[f] > 0.5 { 1.02 } else { 0.98 };
    let uv = rest.material_uv.iter().enumerate().map(|(f, c)| c.map(|p| [p[0], p[1] / cut(f)])).collect();
    problem.rest =
        caphy_garment::GarmentRest::new("halves", rest.template.clone(), uv, rest.density, rest.grain.clone()).unwrap();
    let part = |name: &str, of: &dyn Fn(f64) -> f64| CutPart {
        name: name.into(),
        share: near.iter().map(|n| of(*n)).collect(),
    };
    problem.parts = vec![part("near", &|n| n), part("far", &|n| 1.0 - n)];
    let settings = EquilibriumSettings { ease_sd: 0.03, ..settings() };
    let reduction = Reduction::multipliers(&*problem.material).unwrap();
    let found = equilibrium(&problem, reduction, &settings, None, &mut |_| Ok(())).unwrap();
    for (which, expected) in [(1, 0.02), (3, -0.02)] {
        let ease = &found.nuisances[which];
        assert!((ease.value - expected).abs() < 4.0 * ease.sd && ease.sd < 0.005, "{:?}", found.nuisances);
    }
    assert!(found.nuisances[1].name.starts_with("near: ") && found.nuisances[1].name.contains("girth"));
    let bend = found.parameters.len() - 1;
    assert!((found.parameters[bend] / truth[bend] - 1.0).abs() < 0.1);
    problem.parts.clear();
    let reduction = Reduction::multipliers(&*problem.material).unwrap();
    let text = equilibrium(&problem, reduction, &settings, None, &mut |_| Ok(())).unwrap_err().to_string();
    assert!(text.contains("ease_sd") && text.contains("part"), "{text}");
}

#[test]
fn ease_of_the_cut_is_found_along() {
    // Scans of a cloth cut 1 % longer than the one that is believed.
    let (mut problem, truth) = small(3e-4, known);
    let uv = problem.rest.material_uv.iter().map(|f| f.map(|p| [p[0], p[1] / 1.01])).collect();
    problem.rest = caphy_garment::GarmentRest::new(
        "short",
        problem.rest.template.clone(),
        uv,
        problem.rest.density,
        problem.rest.grain.clone(),
    )
    .unwrap();
    let reduction = Reduction::multipliers(&*problem.material).unwrap();
    let settings = EquilibriumSettings { ease_sd: 0.02, ..settings() };
    let found = equilibrium(&problem, reduction, &settings, None, &mut |_| Ok(())).unwrap();
    let ease = &found.nuisances[1];
    assert!((ease.value - 0.01).abs() < 4.0 * ease.sd && ease.sd < 0.005, "{:?}", found.nuisances);
    let bend = found.parameters.len() - 1;
    assert!((found.parameters[bend] / truth[bend] - 1.0).abs() < 0.1);
}
