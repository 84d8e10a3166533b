//! What cannot be estimated says why.

use super::study::*;
use caphy_core::Vec3;
use caphy_garment::estimate::equilibrium::equilibrium;
use caphy_garment::estimate::{EquilibriumSettings, Problem, Reduction, ScanPoints, cloth};
use caphy_garment::solver::SolverSettings;

fn small() -> Problem {
    let material = fabric("gray-interlock");
    let rest = cloth::sheet(4, 4, [SIDE, SIDE], 0.2).unwrap();
    let setups = setups(&rest, false);
    let shapes: Vec<Vec<Vec3>> = setups.iter().map(|s| s.start.clone()).collect();
    problem(&rest, &setups, &shapes, material, 5e-4, 1, SolverSettings::default())
}

fn refused(problem: &Problem, settings: &EquilibriumSettings) -> String {
    let reduction = Reduction::multipliers(&*problem.material).unwrap();
    equilibrium(problem, reduction, settings, None, &mut |_| Ok(())).unwrap_err().to_string()
}

#[test]
fn poses_that_nothing_holds_or_that_may_turn() {
    let settings = EquilibriumSettings::default();
    let mut problem = small();
    problem.captures[1].fixed.clear();
    let text = refused(&problem, &settings);
    assert!(text.contains("stick out along u") && text.contains("nothing holds"), "{text}");
    problem.captures[1].fixed = vec![3];
    let text = refused(&problem, &settings);
    assert!(text.contains("may turn"), "{text}");
    problem.captures[1].fixed = vec![3, 900];
    let text = refused(&problem, &settings);
    assert!(text.contains("900"), "{text}");
    problem.captures.clear();
    assert!(refused(&problem, &settings).contains("pose"));
}

#[test]
fn scans_without_points_and_shapes_that_are_not_finite() {
    let settings = EquilibriumSettings::default();
    let mut problem = small();
    problem.captures[0].scan = ScanPoints::Surface { points: vec![], faces: vec![], visible: None };
    let text = refused(&problem, &settings);
    assert!(text.contains("hang by two corners") && text.contains("no point"), "{text}");
    let mut problem = small();
    problem.captures[2].start[5].x = f64::NAN;
    assert!(refused(&problem, &settings).contains("not finite"));
    let mut problem = small();
    // Too few points to tell their noise.
    problem.captures[0].scan = ScanPoints::Known { vertices: vec![0, 1], points: vec![Vec3::zeros(); 2] };
    assert!(refused(&problem, &settings).contains("sigma_m"));
}

#[test]
fn settings_that_cannot_act() {
    let problem = small();
    let with = |change: fn(&mut EquilibriumSettings)| {
        let mut settings = EquilibriumSettings::default();
        change(&mut settings);
        refused(&problem, &settings)
    };
    assert!(with(|s| s.continuation = vec![0.1, 0.3]).contains("continuation"));
    assert!(with(|s| s.gate = 0.9).contains("gate"));
    assert!(with(|s| s.prior_log_sd = 0.0).contains("prior_log_sd"));
    // An offset of a body that there is not.
    assert!(with(|s| s.body_offset_sd_m = 2e-3).contains("body_offset_sd_m"));
}
