//! Eq. 10 solved directly: the fabric in which given garment shapes would be at rest.
//!
//! E_phys is linear in the stiffness of each group wherever no clamp switches, so the gradient of Eq. 10 is A m + b and the
//! equation is a bounded least-squares problem in the multipliers m. A fabric that is not linear in its parameters goes down the
//! slope of Eq. 10 instead ([`super::shapes`]).
//!
//! Differs from the paper: solved exactly instead of by gradient descent, where it is linear; and rows of vertices in
//! contact are dropped, because contact forces are not the fabric's.

use super::balance_system::{BalanceRules, BalanceSolution, BalanceSystem};
use caphy_core::{Error, Result};
use nalgebra::DVector;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Settings of Eq. 10.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ForceBalanceSettings {
    /// λ_reg of Eq. 10 on (m − 1)², relative to each group's own squared force. Default 0.1.
    pub regularisation: f64,
    /// Multipliers stay within [1/x, x]. Default 3: shapes that are not exact equilibria pull all stiffness to zero.
    pub largest_factor: f64,
    /// Groups whose logarithm is the unknown, by the beginning of their names. Default `bend`: the paper reparametrises bending to
    /// balance magnitudes; it acts through λ_reg and bounds.
    pub logarithmic: Vec<String>,
    /// λ_reg of single groups instead of `regularisation`, by their names. Default none.
    pub regularisation_of: BTreeMap<String, f64>,
}

impl Default for ForceBalanceSettings {
    fn default() -> Self {
        Self {
            regularisation: 0.1,
            largest_factor: 3.0,
            logarithmic: vec!["bend".into()],
            regularisation_of: BTreeMap::new(),
        }
    }
}

impl ForceBalanceSettings {
    /// λ_reg per group.
    ///
    /// # Errors
    /// [`Error::Config`] for a group that there is not, or a value that is negative.
    pub(crate) fn regularisations(&self, names: &[String]) -> Result<Vec<f64>> {
        for (name, value) in &self.regularisation_of {
            let key = format!("regularisation_of.{name}");
            if !names.contains(name) {
                let remedy = format!("this fabric has: {}", names.join(", "));
                return Err(Error::config(key, "is no group of this fabric", remedy));
            }
            if !(*value >= 0.0 && value.is_finite()) {
                return Err(Error::config(key, value.to_string(), "give a number that is not negative"));
            }
        }
        Ok(names.iter().map(|n| self.regularisation_of.get(n).copied().unwrap_or(self.regularisation)).collect())
    }
    pub(crate) fn logarithms(&self, names: &[String]) -> Vec<bool> {
        names.iter().map(|n| self.logarithmic.iter().any(|l| n.starts_with(l.as_str()))).collect()
    }
}

/// One group's estimate.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct GroupEstimate {
    /// The group's name.
    pub name: String,
    /// Multiplier of the starting values.
    pub multiplier: f64,
    /// Share of the solution that the data determined, 0 (all prior) to 1 (all data).
    pub determined: f64,
    /// Whether a bound holds it.
    pub at_bound: bool,
    /// Whether the shapes excite the group at all.
    pub excited: bool,
}

/// What Eq. 10 says about a fabric.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FabricEstimate {
    /// One entry per group.
    pub groups: Vec<GroupEstimate>,
    /// Native parameter values after the solve.
    pub parameters: Vec<f64>,
    /// Root-mean-square of the kept gradient rows before [N].
    pub residual_before_n: f64,
    /// The same after [N], from the material itself, not from the linear model.
    pub residual_after_n: f64,
    /// Singular values of A with columns scaled to unit length, largest first: near zero means that combinations of groups
    /// cannot be told apart.
    pub singular_values: Vec<f64>,
    /// The combinations that these belong to, parts of the groups in units of their columns.
    #[serde(default)]
    pub combinations: Vec<Vec<f64>>,
    /// Rows used and rows in all.
    pub rows: [usize; 2],
    /// Things the user must know.
    pub warnings: Vec<String>,
}

/// What to expect of Eq. 10; printed whenever it runs.
pub const WARNING: &str = "Eq. 10 is exact on exact equilibria only: 0.02 mm of noise, another mesh or an unconverged net biases every stiffness \
     towards zero. Read the multipliers as a direction, not as a measurement; only stiffness over density is observable.";

/// The multipliers that balance a system from `start`.
pub(crate) fn solve(
    system: &BalanceSystem,
    names: &[String],
    start: &DVector<f64>,
    settings: &ForceBalanceSettings,
) -> Result<BalanceSolution> {
    system.solve(&BalanceRules {
        start,
        regularisation: &settings.regularisations(names)?,
        logarithmic: &settings.logarithms(names),
        lower: &DVector::from_element(names.len(), 1.0 / settings.largest_factor),
        upper: &DVector::from_element(names.len(), settings.largest_factor),
    })
}

/// A solution with what the user must know about it.
pub(crate) fn reported(
    names: &[String],
    parameters: Vec<f64>,
    solution: &BalanceSolution,
    [residual_before_n, residual_after_n]: [f64; 2],
    rows: [usize; 2],
    settings: &ForceBalanceSettings,
) -> FabricEstimate {
    let n = names.len();
    let longest = solution.lengths.amax();
    let (lower, upper) = (1.0 / settings.largest_factor, settings.largest_factor);
    let groups: Vec<GroupEstimate> = names
        .iter()
        .enumerate()
        .map(|(g, name)| {
            let (z, length) = (solution.multipliers[g], solution.lengths[g]);
            let excited = length > 1e-12 * longest && length > 0.0;
            GroupEstimate {
                name: name.clone(),
                multiplier: z,
                determined: if excited { (1.0 - solution.left_to_prior[g]).clamp(0.0, 1.0) } else { 0.0 },
                at_bound: z <= lower * (1.0 + 1e-9) || z >= upper * (1.0 - 1e-9),
                excited,
            }
        })
        .collect();
    let mut warnings = vec![WARNING.to_string()];
    let falling = groups.iter().filter(|g| g.excited && g.multiplier < 0.7).count();
    if 2 * falling > groups.iter().filter(|g| g.excited).count() {
        warnings.push(format!(
            "{falling} of {n} multipliers fell below 0.7: the downward drift that noise causes, see the first warning"
        ));
    }
    let held: Vec<&str> = groups.iter().filter(|g| !g.excited).map(|g| g.name.as_str()).collect();
    if !held.is_empty() {
        warnings.push(format!("these shapes do not excite {}: kept as configured", held.join(", ")));
    }
    FabricEstimate {
        parameters,
        residual_before_n,
        residual_after_n,
        singular_values: solution.singular_values.clone(),
        combinations: solution.combinations.clone(),
        rows,
        groups,
        warnings,
    }
}
