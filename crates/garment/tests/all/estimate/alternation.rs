//! The paper's loop: exact on exact scans, low with noise, nothing at a large λ.

use super::study::*;
use caphy_garment::estimate::alternation::{alternation, between};
use caphy_garment::estimate::{AlternationSettings, ForceBalanceSettings, Reduction};

fn run(case: &Case, factor: f64, noise: f64, rounds: usize, lambda: f64) -> (Vec<f64>, Vec<String>) {
    let problem = case.problem(scaled(&case.truth, factor), noise, 7);
    let reduction = Reduction::multipliers(&*problem.material).unwrap();
    let settings = AlternationSettings {
        rounds,
        lambda,
        force_balance: ForceBalanceSettings { regularisation: 0.0, largest_factor: 1e3, ..Default::default() },
        ..Default::default()
    };
    let found = alternation(&problem, &reduction, &settings, &mut between(&problem, lambda), &mut |_, _| {}).unwrap();
    let ratios = case.ratios(&found.last.parameters);
    eprintln!("λ {lambda}, noise {noise}, {} rounds: {ratios:.3?}", found.history.len());
    (ratios, found.last.warnings)
}

#[test]
fn exact_scans_are_met_in_twelve_rounds() {
    let case = Case::new("gray-interlock", false);
    let (ratios, warnings) = run(&case, 1.3, 0.0, 12, 10.0);
    assert!(ratios.iter().all(|r| (r - 1.0).abs() < 0.02), "{ratios:?}");
    assert!(!warnings.iter().any(|w| w.contains("falls steadily")), "{warnings:?}");
}

#[test]
fn noise_pulls_stiffness_down_and_a_large_lambda_collapses_it() {
    let case = Case::new("gray-interlock", false);
    let (ratios, warnings) = run(&case, 1.0, NOISE_M, 12, 1.0);
    let mean = ratios.iter().map(|r| r.max(1e-9).ln()).sum::<f64>() / ratios.len() as f64;
    assert!(mean < 0.3f64.ln(), "{ratios:?}");
    assert!(warnings.iter().any(|w| w.contains("falls steadily")), "{warnings:?}");
}
