//! `[optimise]`: how the garments' fabrics are found between trainings (Sec. 3.4).

use crate::estimate::ReductionChoice;
use caphy_core::Error;
use caphy_garment::estimate::{AlternationSettings, EquilibriumSettings, ForceBalanceSettings, GradientBy};
use caphy_garment::solver::SolverSettings;
use serde::de::{DeserializeOwned, Error as _};
use serde::{Deserialize, Deserializer, Serialize};

/// `[optimise]`
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct OptimiseConfig {
    /// Times that estimation and training alternate, at most 8. Default 1; 0 keeps the starting fabric.
    pub alternations: usize,
    /// Rounds of training after each alternation. Default 8.
    pub rounds: usize,
    /// What finds the fabric. Default `{ type = "equilibrium" }`.
    pub estimator: EstimatorConfig,
}

impl Default for OptimiseConfig {
    fn default() -> Self {
        Self { alternations: 1, rounds: 8, estimator: EstimatorConfig::Equilibrium(WornEquilibrium::default()) }
    }
}

/// `[optimise.estimator]`
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(tag = "type", rename_all = "snake_case")]
pub enum EstimatorConfig {
    /// The fabric whose simulated equilibria lie nearest to the scans, with intervals.
    Equilibrium(WornEquilibrium),
    /// The paper's: Eq. 10 on garments between physics and scan. Pulls stiffness down where scans have noise.
    Alternation(WornAlternation),
}

/// `[optimise.estimator] type = "equilibrium"`
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct WornEquilibrium {
    /// Most training scans that are fitted, those whose poses differ most. Default 4: more tighten intervals as 1/√n, and the body's
    /// and the template's errors, which weigh more, not at all.
    pub scans: usize,
    /// What is turned of the fabric's numbers. Default `multipliers`.
    pub reduction: ReductionChoice,
    /// Training keeps its fabric where poses fit worse than this many times the scans' noise: such an answer makes up for an error of
    /// body or cut (trousers of a wrong length came out 69 times as stiff as they started, at 4.4). The report shows it all the same. Default 3.
    pub largest_misfit: f64,
    /// The fit. Defaults as for `caphy estimate`, except that the cut (`ease_sd` 0.02) and the body's surface
    /// (`body_offset_sd_m` 0.002) are fitted along, that the springs begin at 0.1 (the garment is put on its scan before), and that one
    /// friction is believed (`friction_spread` empty: each value costs as much as the fit).
    #[serde(deserialize_with = "worn_fit")]
    pub fit: EquilibriumSettings,
    /// The reference solver, with the friction that is believed. Default 0.3, and forces down to 3e-4 N, a tenth of a vertex's
    /// weight: folds are then where they are, and scans are off by half a millimetre.
    #[serde(deserialize_with = "worn_solver")]
    pub solver: SolverSettings,
}

impl Default for WornEquilibrium {
    fn default() -> Self {
        Self {
            scans: 4,
            reduction: ReductionChoice::Multipliers,
            largest_misfit: 3.0,
            fit: EquilibriumSettings {
                ease_sd: 0.02,
                body_offset_sd_m: 2e-3,
                continuation: vec![0.1, 0.0],
                friction_spread: Vec::new(),
                soft_modes: 0,
                ..EquilibriumSettings::default()
            },
            solver: believed(),
        }
    }
}

/// What a file gives of a table, over defaults that are not the type's own.
pub(super) fn over<'de, D: Deserializer<'de>, T: Serialize + DeserializeOwned>(
    file: D,
    defaults: T,
) -> Result<T, D::Error> {
    let given = toml::Table::deserialize(file)?;
    let mut all = toml::Table::try_from(defaults).map_err(D::Error::custom)?;
    all.extend(given);
    all.try_into().map_err(|e: toml::de::Error| D::Error::custom(e.message()))
}
fn worn_fit<'de, D: Deserializer<'de>>(file: D) -> Result<EquilibriumSettings, D::Error> {
    over(file, WornEquilibrium::default().fit)
}
fn worn_solver<'de, D: Deserializer<'de>>(file: D) -> Result<SolverSettings, D::Error> {
    over(file, believed())
}

fn believed() -> SolverSettings {
    SolverSettings { friction: 0.3, tolerance_n: 3e-4, ..SolverSettings::default() }
}

/// What makes the garments between physics and scan.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Inner {
    /// The trained nets, as in the paper: one solve of Eq. 10 between two trainings.
    #[default]
    Net,
    /// The reference solver minimises each pose directly, round after round.
    Solver,
}

/// `[optimise.estimator] type = "alternation"`
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct WornAlternation {
    /// What makes the garments between physics and scan. Default `net`.
    pub inner: Inner,
    /// By what Eq. 10 differentiates. Default `canonical`, as printed.
    pub gradient: GradientBy,
    /// Rows of vertices nearer to the body than the contact margin plus this are dropped [m]. Default 2 mm: their forces are not
    /// the fabric's.
    pub contact_slack_m: f64,
    /// λ_reg and bounds of Eq. 10.
    pub force_balance: ForceBalanceSettings,
    /// With `inner = "solver"`: most rounds. Default 12.
    pub rounds: usize,
    /// With `inner = "solver"`: λ3d, springs to the scan in weights of a vertex per mm. Default 0.1.
    pub lambda: f64,
    /// With `inner = "solver"`: the reference solver. Default as for `equilibrium`.
    #[serde(deserialize_with = "worn_solver")]
    pub solver: SolverSettings,
}

impl Default for WornAlternation {
    fn default() -> Self {
        let plain = AlternationSettings::default();
        Self {
            inner: Inner::Net,
            gradient: plain.gradient,
            contact_slack_m: plain.contact_slack_m,
            force_balance: ForceBalanceSettings::default(),
            rounds: 12,
            lambda: plain.lambda,
            solver: believed(),
        }
    }
}

impl WornAlternation {
    /// Settings of the solver's alternation.
    pub fn settings(&self) -> AlternationSettings {
        AlternationSettings {
            rounds: self.rounds,
            lambda: self.lambda,
            gradient: self.gradient,
            contact_slack_m: self.contact_slack_m,
            force_balance: self.force_balance.clone(),
            ..AlternationSettings::default()
        }
    }
}

impl OptimiseConfig {
    /// Refuses values that cannot act.
    pub(super) fn check(&self) -> caphy_core::Result<()> {
        let within = |e: Error| match e {
            Error::Config { key, problem, remedy } => {
                Error::config(format!("optimise.estimator.fit.{key}"), problem, remedy)
            }
            other => other,
        };
        match &self.estimator {
            EstimatorConfig::Equilibrium(e) => {
                if e.scans == 0 {
                    return Err(Error::config("optimise.estimator.scans", "0", "give at least one scan to fit"));
                }
                if e.largest_misfit.is_nan() || e.largest_misfit <= 0.0 {
                    let problem = e.largest_misfit.to_string();
                    return Err(Error::config("optimise.estimator.largest_misfit", problem, "give a positive number"));
                }
                e.fit.check().map_err(within)
            }
            EstimatorConfig::Alternation(a) => a.check(),
        }
    }
}

impl WornAlternation {
    fn check(&self) -> caphy_core::Result<()> {
        let refuse = |key: &str, problem: String, remedy: &str| {
            Err(Error::config(format!("optimise.estimator.{key}"), problem, remedy))
        };
        let balance = &self.force_balance;
        if !(balance.regularisation >= 0.0 && balance.regularisation.is_finite()) {
            let problem = balance.regularisation.to_string();
            return refuse("force_balance.regularisation", problem, "give a number that is not negative");
        }
        if balance.largest_factor.is_nan() || balance.largest_factor < 1.0 {
            let problem = balance.largest_factor.to_string();
            return refuse("force_balance.largest_factor", problem, "give a number of at least 1");
        }
        if !(self.contact_slack_m >= 0.0 && self.contact_slack_m.is_finite()) {
            return refuse("contact_slack_m", self.contact_slack_m.to_string(), "give metres, 0 or more");
        }
        if self.inner == Inner::Solver && (self.rounds == 0 || !(self.lambda > 0.0 && self.lambda.is_finite())) {
            let problem = format!("{} rounds at λ {}", self.rounds, self.lambda);
            return refuse("rounds", problem, "give at least one round and a positive λ");
        }
        let plain = Self::default();
        if self.inner == Inner::Net
            && (self.rounds != plain.rounds || self.lambda != plain.lambda || self.solver != plain.solver)
        {
            let problem = "rounds, lambda and solver have no effect, because inner = \"net\"".into();
            return refuse("inner", problem, "remove them, or give inner = \"solver\"");
        }
        Ok(())
    }
}
