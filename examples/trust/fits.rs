//! The equilibrium fit: from near, and from another fabric.

use crate::study::{Case, NOISE_M, fabric, scaled};
use crate::{Section, table};
use caphy_core::material::MaterialModel;
use caphy_garment::estimate::equilibrium::equilibrium;
use caphy_garment::estimate::{
    EquilibriumEstimate, EquilibriumSettings, NativeEvidence, Problem, Reduction, reduction,
};
use std::sync::Arc;

/// Without the mesh's share of the intervals: scan and cloth have the same triangles here.
pub(crate) fn same_mesh() -> EquilibriumSettings {
    EquilibriumSettings { mesh_log_sd: 0.0, friction_spread: Vec::new(), soft_modes: 0, ..Default::default() }
}

pub(crate) fn fit(problem: &Problem, settings: &EquilibriumSettings) -> caphy_core::Result<EquilibriumEstimate> {
    equilibrium(problem, Reduction::multipliers(&*problem.material)?, settings, None, &mut |_| Ok(()))
}

/// Bias, scatter and coverage.
pub(crate) fn near(fabrics: &[&str], seeds: u64) -> Section {
    let settings = EquilibriumSettings { continuation: vec![0.0], ..same_mesh() };
    let (mut covered, mut of) = (0, 0);
    let mut rows = Vec::new();
    for name in fabrics {
        let case = Case::new(name, false);
        let (mut logs, mut sds): (Vec<Vec<f64>>, Vec<Vec<f64>>) = (Vec::new(), Vec::new());
        let mut names = Vec::new();
        for seed in 0..seeds {
            let found = fit(&case.problem(scaled(&case.truth, 1.15), NOISE_M, 100 + seed), &settings)?;
            logs.push(case.ratios(&found.parameters).iter().map(|r| r.ln()).collect());
            sds.push(found.unknowns.iter().map(|u| u.log_sd_noise).collect());
            names = found.unknowns.iter().map(|u| u.name.clone()).collect();
        }
        for (k, unknown) in names.iter().enumerate() {
            let mean = |of: &dyn Fn(usize) -> f64| (0..logs.len()).map(of).sum::<f64>() / logs.len() as f64;
            let sd = mean(&|s| sds[s][k]);
            let held = sd > settings.held_above;
            let inside = (0..logs.len()).filter(|&s| logs[s][k].abs() <= 1.96 * sds[s][k]).count();
            if !held {
                covered += inside;
                of += logs.len();
            }
            rows.push(vec![
                name.to_string(),
                unknown.clone(),
                format!("{:+.1} %", 100.0 * mean(&|s| logs[s][k])),
                format!("{:.1} %", 100.0 * mean(&|s| logs[s][k].powi(2)).sqrt()),
                format!("{:.1} %", 100.0 * sd),
                if held { "held by the prior".into() } else { format!("{inside} of {}", logs.len()) },
            ]);
        }
    }
    let head = ["fabric", "factor of", "bias", "rms error", "predicted sd", "95 % interval covers"];
    Ok(format!(
        "Started 15 % too stiff, {seeds} seeds of noise per fabric. Of {of} intervals {covered} cover the truth ({:.0} %).\n{}",
        100.0 * covered as f64 / of.max(1) as f64,
        table(&head, &rows)
    ))
}

/// All ten, each from another's table: what is nearest?
pub(crate) fn confusion() -> Section {
    let all = caphy::estimate::ten_fabrics()?;
    let mut rows = Vec::new();
    let (mut right, mut before_all, mut after_all) = (0, Vec::new(), Vec::new());
    for (k, (name, _)) in all.iter().enumerate() {
        let other = &all[(k + 3) % all.len()].0;
        let case = Case::new(name, false);
        let problem = case.problem(fabric(other), NOISE_M, 7);
        // The true cloth was weighed; the starting fabric's density plays no part.
        let settings = same_mesh();
        let found = match fit(&problem, &settings) {
            Ok(found) => found,
            Err(error) => {
                rows.push(vec![name.clone(), other.clone(), error.to_string()]);
                continue;
            }
        };
        let odds = NativeEvidence::at(&problem, &found, &settings)?.odds(&all, 0.0)?;
        let listed = |values: &[f64]| {
            let groups = reduction::groups(&*case.truth);
            let ratios = case.ratios(values);
            let kept = groups.iter().zip(ratios).filter(|(g, _)| g.name != "k1" && !g.name.contains("c12"));
            let mut logs: Vec<f64> = kept.map(|(_, r)| r.max(1e-6).ln().abs()).collect();
            logs.sort_by(f64::total_cmp);
            logs[logs.len() / 2]
        };
        let start: Vec<f64> = problem.material.parameters().iter().map(|p| p.value).collect();
        let (before, after) = (listed(&start), listed(&found.parameters));
        before_all.push(before);
        after_all.push(after);
        let place = odds.iter().position(|o| o.name == *name).map_or(0, |p| p + 1);
        right += usize::from(place == 1);
        let out = found.poses.iter().filter(|p| p.left_out.is_some()).count();
        rows.push(vec![
            name.clone(),
            other.clone(),
            format!("{:.2}", before),
            format!("{:.2}", after),
            odds[0].name.clone(),
            place.to_string(),
            format!("{:.2}", found.inflation),
            out.to_string(),
        ]);
    }
    let middle = |mut v: Vec<f64>| {
        v.sort_by(f64::total_cmp);
        v.get(v.len() / 2).copied().unwrap_or(f64::NAN)
    };
    let head = [
        "truth",
        "started from",
        "median ∣log ratio∣ before",
        "after",
        "nearest of the ten",
        "place of the truth",
        "factor on the noise's variance",
        "poses left out",
    ];
    Ok(format!(
        "One seed each, the whole table of another fabric as start, the cloth weighed. The truth is the nearest of the ten for {right} of {}; \
         the median ∣log ratio∣ of the tables' columns (without the Poisson coupling) goes from {:.2} to {:.2}: seven factors do not \
         turn one table into another.\n{}",
        all.len(),
        middle(before_all),
        middle(after_all),
        table(&head, &rows)
    ))
}

/// Median |log ratio| of what the poses determine, the largest of them, and the share of intervals that cover.
pub(crate) fn judged(case: &Case, found: &EquilibriumEstimate, limit: f64) -> (f64, f64, usize, usize) {
    let ratios = case.ratios(&found.parameters);
    let known: Vec<usize> = (0..ratios.len()).filter(|&k| found.unknowns[k].log_sd_noise < limit).collect();
    let mut logs: Vec<f64> = known.iter().map(|&k| ratios[k].ln().abs()).collect();
    logs.sort_by(f64::total_cmp);
    let covered = known.iter().filter(|&&k| ratios[k].ln().abs() <= 1.96 * found.unknowns[k].log_sd).count();
    let (middle, worst) = (logs.get(logs.len() / 2).copied(), logs.last().copied());
    (middle.unwrap_or(f64::NAN), worst.unwrap_or(f64::NAN), covered, known.len())
}

/// The same material with another density, for nothing but to be given.
pub(crate) fn begun(truth: &Arc<dyn MaterialModel>) -> Arc<dyn MaterialModel> {
    scaled(truth, 1.15)
}
