//! Eq. 10 solved directly: the fabric in which given garment shapes would be at rest.
//!
//! E_phys is linear in the stiffness of each group wherever no clamp switches, so the gradient of Eq. 10 is A z + b and the
//! equation is a bounded least-squares problem in the multipliers z.
//!
//! Differs from the paper: solved exactly instead of by gradient descent, because it is linear; and rows of vertices in
//! contact are dropped, because contact forces are not the fabric's.

use super::bounded;
use super::reduction::{self, Group};
use caphy_core::material::MaterialModel;
use caphy_core::{Error, Result};
use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

/// Settings of [`force_balance`].
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ForceBalanceSettings {
    /// λ_reg of Eq. 10 on (z − 1)², relative to each group's own squared force. Default 0.1.
    pub regularisation: f64,
    /// Multipliers stay within [1/x, x]. Default 3: shapes that are not exact equilibria pull all stiffness to zero.
    pub largest_factor: f64,
}

impl Default for ForceBalanceSettings {
    fn default() -> Self {
        Self { regularisation: 0.1, largest_factor: 3.0 }
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
    /// Rows used and rows in all.
    pub rows: [usize; 2],
    /// Things the user must know.
    pub warnings: Vec<String>,
}

/// What to expect of Eq. 10; printed whenever it runs.
pub const WARNING: &str = "Eq. 10 is exact on exact equilibria only: 0.02 mm of noise, another mesh or an unconverged net biases every stiffness \
     towards zero. Read the multipliers as a direction, not as a measurement; only stiffness over density is observable.";

/// Solves Eq. 10 for the groups' multipliers.
///
/// `gradient(m)` gives ∂E_phys/∂dV [N] of all poses, flat, for fabric `m`, without any scan term; `keep` says which entries
/// count (not those in contact or held).
///
/// Errors: [`Error::Unsupported`] for a material that is not linear in its parameters, [`Error::Length`],
/// [`Error::NonFinite`], and errors of `gradient`.
pub fn force_balance(
    material: &dyn MaterialModel,
    mut gradient: impl FnMut(&dyn MaterialModel) -> Result<Vec<f64>>,
    keep: &[bool],
    settings: &ForceBalanceSettings,
) -> Result<FabricEstimate> {
    let description = material.describe();
    if !description.linear_in_parameters {
        return Err(Error::unsupported(
            "Eq. 10 as least squares (it is not linear in its parameters)",
            description.name,
        ));
    }
    let groups = reduction::groups(material);
    let mut kept = |m: &dyn MaterialModel| -> Result<DVector<f64>> {
        let all = gradient(m)?;
        Error::check_length("gradient rows of Eq. 10", keep.len(), all.len())?;
        let rows: Vec<f64> = all.into_iter().zip(keep).filter(|(_, k)| **k).map(|(v, _)| v).collect();
        Error::check_finite("gradient rows of Eq. 10", &rows)?;
        Ok(DVector::from_vec(rows))
    };
    let start = kept(material)?;
    let rows = start.len();
    let n = groups.len();
    // Linear in each group: halving a group and comparing gives half its column exactly, and stays inside bounds.
    let mut a = DMatrix::zeros(rows, n);
    for (g, _) in groups.iter().enumerate() {
        let mut multipliers = vec![1.0; n];
        multipliers[g] = 0.5;
        let halved = reduction::scaled(material, &groups, &multipliers)?;
        let column = (&start - kept(&*halved)?) * 2.0;
        a.set_column(g, &column);
    }
    let ones = DVector::from_element(n, 1.0);
    let b = &start - &a * &ones;

    let lengths = DVector::from_fn(n, |g, _| a.column(g).norm());
    let longest = lengths.amax();
    let excited: Vec<bool> = lengths.iter().map(|&l| l > 1e-12 * longest && l > 0.0).collect();
    let normal = a.transpose() * &a;
    let regularised = DMatrix::from_fn(n, n, |i, j| {
        normal[(i, j)] + if i == j { settings.regularisation * lengths[i] * lengths[i] } else { 0.0 }
    });
    let right = DVector::from_fn(n, |i, _| -a.column(i).dot(&b) + settings.regularisation * lengths[i] * lengths[i]);
    let lower = ones.clone() / settings.largest_factor;
    let upper = ones.clone() * settings.largest_factor;
    let z = bounded::solve(&regularised, &right, &lower, &upper, &ones)?;

    let unit = DMatrix::from_fn(rows, n, |r, g| if excited[g] { a[(r, g)] / lengths[g] } else { 0.0 });
    // Small: the singular values of A are the square roots of the eigenvalues of AᵀA.
    let mut singular_values: Vec<f64> =
        (unit.transpose() * &unit).symmetric_eigenvalues().iter().map(|v| v.max(0.0).sqrt()).collect();
    singular_values.sort_by(|x, y| y.total_cmp(x));
    let inverse = regularised.clone().pseudo_inverse(1e-300).ok();
    let multipliers: Vec<f64> = z.iter().copied().collect();
    let estimated = reduction::scaled(material, &groups, &multipliers)?;
    let after = kept(&*estimated)?;
    let rms = |v: &DVector<f64>| if rows == 0 { 0.0 } else { v.norm() / (rows as f64).sqrt() };
    let groups: Vec<GroupEstimate> = groups
        .iter()
        .enumerate()
        .map(|(g, Group { name, .. })| {
            // Posterior over prior variance: 1 when the data says nothing.
            let prior = settings.regularisation * lengths[g] * lengths[g];
            let left = inverse.as_ref().map_or(1.0, |i| i[(g, g)] * prior);
            GroupEstimate {
                name: name.clone(),
                multiplier: z[g],
                determined: if excited[g] { (1.0 - left).clamp(0.0, 1.0) } else { 0.0 },
                at_bound: z[g] <= lower[g] * (1.0 + 1e-9) || z[g] >= upper[g] * (1.0 - 1e-9),
                excited: excited[g],
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
    Ok(FabricEstimate {
        parameters: estimated.parameters().iter().map(|p| p.value).collect(),
        residual_before_n: rms(&start),
        residual_after_n: rms(&after),
        singular_values,
        rows: [rows, keep.len()],
        groups,
        warnings,
    })
}
