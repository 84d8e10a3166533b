//! Eq. 10 on observed shapes, alone and in the paper's alternation.

use crate::study::{Case, scaled};
use crate::{Figures, Section, table};
use caphy::plot::{Axes, Curve, lines};
use caphy_garment::estimate::alternation::{alternation, between};
use caphy_garment::estimate::{AlternationSettings, ForceBalanceSettings, GradientBy, Reduction, ShapeBalance};

/// Rounds of an alternation.
const ROUNDS: usize = 12;

fn free() -> ForceBalanceSettings {
    ForceBalanceSettings { regularisation: 0.0, largest_factor: 1e3, ..Default::default() }
}

/// Eq. 10 on shapes with noise.
pub(crate) fn noise(fabrics: &[&str]) -> Section {
    let mut rows = Vec::new();
    let mut names = Vec::new();
    for fabric in fabrics {
        let case = Case::solved(fabric, false, 1e-11);
        for noise in [0.0, 2e-5, 1e-4, 5e-4] {
            let problem = case.problem(scaled(&case.truth, 1.3), noise, 1);
            let reduction = Reduction::multipliers(&*problem.material)?;
            let balance = ShapeBalance::of(&problem, GradientBy::Canonical, 2e-3);
            let shapes: Vec<_> = problem.captures.iter().map(|c| c.scan.points().to_vec()).collect();
            let ones = vec![1.0; reduction.len()];
            let found = balance.estimate(&*problem.material, &reduction, &ones, &shapes, &free())?;
            names.clone_from(&reduction.names);
            let mut row = vec![fabric.to_string(), format!("{}", 1e3 * noise)];
            row.extend(case.ratios(&found.parameters).iter().map(|r| format!("{r:.3}")));
            rows.push(row);
        }
    }
    let head: Vec<&str> = ["fabric", "noise, mm"].into_iter().chain(names.iter().map(String::as_str)).collect();
    Ok(format!(
        "Eq. 10 asks in which fabric the observed shape would be at rest. On exact equilibria it is exact; 0.02 mm of noise make it \
         useless, because membrane forces are second differences of positions.\n{}",
        table(&head, &rows)
    ))
}

/// The alternation of shapes between physics and scan with Eq. 10.
fn curve(case: &Case, noise: f64, lambda: f64) -> Result<Vec<f64>, Box<dyn std::error::Error>> {
    let problem = case.problem(case.truth.clone(), noise, 7);
    let reduction = Reduction::multipliers(&*problem.material)?;
    let settings = AlternationSettings { rounds: ROUNDS, lambda, force_balance: free(), ..Default::default() };
    let found = alternation(&problem, &reduction, &settings, &mut between(&problem, lambda), &mut |_, _| {})?;
    let mean = |m: &Vec<f64>| (m.iter().map(|m| m.max(1e-3).ln()).sum::<f64>() / m.len() as f64).exp();
    Ok(found.history.iter().map(mean).collect())
}

pub(crate) fn drift(fabric: &str, figures: &Figures) -> Section {
    let case = Case::new(fabric, false);
    let mut curves = Vec::new();
    let mut rows = Vec::new();
    for (noise, lambda) in [(0.0, 10.0), (5e-4, 0.1), (5e-4, 0.3), (5e-4, 1.0)] {
        let history = curve(&case, noise, lambda)?;
        let last = history.last().copied().unwrap_or(f64::NAN);
        rows.push(vec![format!("{}", 1e3 * noise), lambda.to_string(), format!("{last:.3}")]);
        curves.push(Curve {
            name: format!("{} mm, λ {lambda}", 1e3 * noise),
            points: std::iter::once((0.0, 1.0))
                .chain(history.iter().enumerate().map(|(i, m)| ((i + 1) as f64, *m)))
                .collect(),
        });
    }
    let axes = Axes { title: "Mean factor over rounds", x: "round", y: "estimate over truth", log_y: true };
    Ok(format!(
        "Garments between physics and scan, then Eq. 10 with their shapes, again and again, started at the truth ({fabric}; λ in weights of \
         a vertex per mm). With noise stiffness drifts down, the faster the larger λ; past some λ it collapses.\n{}{}",
        table(&["noise, mm", "λ", "geometric mean of the seven ratios after 12 rounds"], &rows),
        figures.plot("alternation", "Alternation", &lines(&axes, &curves))?
    ))
}
