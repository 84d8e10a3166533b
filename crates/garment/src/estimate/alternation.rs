//! Sec. 3.4 as the paper has it: garments between physics and scan, then Eq. 10 with these shapes held, again and again.
//!
//! Exact scans are met in the limit, the faster the larger λ3d; with noise the answer is biased low, and past some λ3d all
//! stiffness collapses. λ_reg does not move the fixed point, it only slows the way there.

use super::capture::Capture;
use super::equilibrium::{Problem, held_shapes};
use super::force_balance::{FabricEstimate, ForceBalanceSettings};
use super::reduction::Reduction;
use super::shapes::{GradientBy, ShapeBalance};
use caphy_core::material::MaterialModel;
use caphy_core::{Error, Result, Vec3};
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Rounds over which a steady fall is looked for.
const WATCHED: usize = 4;
/// Fall of the mean logarithm over these rounds that is worth a warning.
const FALL: f64 = 0.05;

/// Settings of [`alternation`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct AlternationSettings {
    /// Most rounds. Default 40: what 0.5 mm of noise takes at the default λ.
    pub rounds: usize,
    /// λ3d: springs to the scan, in weights of a vertex per mm. Default 0.1: at 0.5 mm of noise it keeps 0.8-1 of the stiffness
    /// after 40 rounds, 1 collapses. Exact scans (of a simulation) want 10 or more.
    pub lambda: f64,
    /// By what Eq. 10 differentiates. Default `canonical`, as printed.
    pub gradient: GradientBy,
    /// Rows of vertices nearer to the body than the contact margin plus this are dropped [m]. Default 2 mm.
    pub contact_slack_m: f64,
    /// Ends when no multiplier moves by more than this share in a round. Default 1e-4.
    pub tolerance: f64,
    /// Eq. 10.
    pub force_balance: ForceBalanceSettings,
}

impl Default for AlternationSettings {
    fn default() -> Self {
        Self {
            rounds: 40,
            lambda: 0.1,
            gradient: GradientBy::Canonical,
            contact_slack_m: 2e-3,
            tolerance: 1e-4,
            force_balance: ForceBalanceSettings { largest_factor: 1e3, ..ForceBalanceSettings::default() },
        }
    }
}

/// What the rounds came to.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct AlternationEstimate {
    /// The last solution of Eq. 10, its multipliers those of the starting fabric.
    pub last: FabricEstimate,
    /// Multipliers after each round, `[round][group]`.
    pub history: Vec<Vec<f64>>,
    /// Shapes of the last round [m], `[pose][vertex]`.
    pub shapes: Vec<Vec<[f64; 3]>>,
    /// Whether multipliers settled.
    pub settled: bool,
}

/// Alternates between shapes and Eq. 10.
///
/// `inner` makes the garments of a fabric, one shape per pose [m], the last ones given; [`between`] is the solver's.
/// `progress` hears the share done and a word on it.
///
/// # Errors
/// As [`Problem::check`] and [`ShapeBalance::estimate`]; [`Error::Config`] for settings that cannot act; those of `inner`.
pub fn alternation(
    problem: &Problem,
    reduction: &Reduction,
    settings: &AlternationSettings,
    inner: &mut dyn FnMut(&Arc<dyn MaterialModel>, &[Vec<Vec3>]) -> Result<Vec<Vec<Vec3>>>,
    progress: &mut dyn FnMut(f64, &str),
) -> Result<AlternationEstimate> {
    problem.check()?;
    if settings.rounds == 0 || !(settings.lambda > 0.0 && settings.lambda.is_finite()) {
        let problem = format!("{} rounds at λ {}", settings.rounds, settings.lambda);
        return Err(Error::config("alternation", problem, "give at least one round and a positive λ"));
    }
    let balance = ShapeBalance::of(problem, settings.gradient, settings.contact_slack_m);
    let mut multipliers: Vec<f64> = vec![1.0; reduction.len()];
    let mut shapes: Vec<Vec<Vec3>> = problem.captures.iter().map(|c: &Capture| c.start.clone()).collect();
    let mut history: Vec<Vec<f64>> = Vec::new();
    let mut last = None;
    let mut settled = false;
    for round in 0..settings.rounds {
        progress(round as f64 / settings.rounds as f64, &format!("round {}", round + 1));
        let y: Vec<f64> = multipliers.iter().map(|m| m.ln()).collect();
        let material: Arc<dyn MaterialModel> = Arc::from(reduction.material(&*problem.material, &y)?);
        shapes = inner(&material, &shapes)?;
        let estimate =
            balance.estimate(&*problem.material, reduction, &multipliers, &shapes, &settings.force_balance)?;
        let next: Vec<f64> = estimate.groups.iter().map(|g| g.multiplier).collect();
        let moved = next.iter().zip(&multipliers).map(|(a, b)| (a / b - 1.0).abs()).fold(0.0, f64::max);
        multipliers.clone_from(&next);
        history.push(next);
        last = Some(estimate);
        if moved < settings.tolerance {
            settled = true;
            break;
        }
    }
    let Some(mut last) = last else {
        return Err(Error::config("alternation.rounds", "0", "give at least one round"));
    };
    if let Some(warning) = drift(&history, &last) {
        last.warnings.push(warning);
    }
    let shapes = shapes.iter().map(|x| x.iter().map(|p| [p.x, p.y, p.z]).collect()).collect();
    Ok(AlternationEstimate { last, history, shapes, settled })
}

/// The solver's garments between physics and scan for [`alternation`].
pub fn between<'p>(
    problem: &'p Problem,
    lambda: f64,
) -> impl FnMut(&Arc<dyn MaterialModel>, &[Vec<Vec3>]) -> Result<Vec<Vec<Vec3>>> + 'p {
    move |material, last| held_shapes(problem, material, last, lambda)
}

/// A warning when the excited multipliers fall round after round.
fn drift(history: &[Vec<f64>], last: &FabricEstimate) -> Option<String> {
    let mean = |m: &Vec<f64>| {
        let logs: Vec<f64> =
            m.iter().zip(&last.groups).filter(|(_, g)| g.excited).map(|(m, _)| m.max(1e-300).ln()).collect();
        logs.iter().sum::<f64>() / logs.len().max(1) as f64
    };
    let recent: Vec<f64> = history.iter().rev().take(WATCHED).rev().map(mean).collect();
    let (first, end) = (recent.first()?, recent.last()?);
    let steadily = recent.len() >= WATCHED && recent.windows(2).all(|w| w[1] < w[0]);
    (steadily && first - end > FALL).then(|| {
        format!(
            "stiffness falls steadily, by {:.0} % over the last {WATCHED} rounds: the drift of noisy scans; lower λ3d, or use the \
             equilibrium estimator",
            100.0 * (1.0 - (end - first).exp())
        )
    })
}
