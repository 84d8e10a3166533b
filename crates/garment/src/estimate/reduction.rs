//! Fewer unknowns than native parameters: Θ = B m + c, with m = exp(y) or m = y.
//!
//! A fabric's native table has tens of entries of which a handful of drapes determine few. The default reduction gives
//! one multiplier to each group of entries that belong together: for a measured fabric the four columns of the membrane table and
//! the three rows of the bending table. Others are the whole table, its well-determined combinations alone, and a blend of given
//! fabrics.

use caphy_core::material::MaterialModel;
use caphy_core::params::Parameter;
use caphy_core::{Error, Result};
use nalgebra::{DMatrix, DVector};

/// Largest factor up or down that an unknown on a logarithmic scale may take.
pub const LARGEST_FACTOR: f64 = 1e3;
/// Largest change, in multiples of each native value, that an unknown on a linear scale may make.
const LARGEST_CHANGE: f64 = 0.95;

/// A named group of native parameters.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Group {
    /// Name: the parameters' names without their last index.
    pub name: String,
    /// Indices into [`MaterialModel::parameters`].
    pub members: Vec<usize>,
}

/// Groups parameters by their names without the last index, in order of first appearance: `c11[row 3]` belongs to `c11`,
/// `bend[row 1, column 2]` to `bend[row 1]`, `mu` to itself.
pub fn groups(material: &dyn MaterialModel) -> Vec<Group> {
    let mut out: Vec<Group> = Vec::new();
    for (i, parameter) in material.parameters().iter().enumerate() {
        let name = without_last_index(&parameter.name);
        match out.iter_mut().find(|g| g.name == name) {
            Some(group) => group.members.push(i),
            None => out.push(Group { name, members: vec![i] }),
        }
    }
    out
}

fn without_last_index(name: &str) -> String {
    let Some((head, indices)) = name.split_once('[') else { return name.trim().into() };
    match indices.trim_end_matches(']').rsplit_once(',') {
        Some((first, _)) => format!("{}[{}]", head.trim(), first.trim()),
        None => head.trim().into(),
    }
}

/// Unknowns y and the native parameters that they stand for.
#[derive(Debug, Clone, PartialEq)]
pub struct Reduction {
    /// Name of each unknown.
    pub names: Vec<String>,
    /// B, shape [native][unknown].
    pub map: DMatrix<f64>,
    /// c, in the parameters' units.
    pub offset: DVector<f64>,
    /// Whether m = exp(y) (factors), else m = y.
    pub logarithmic: bool,
    /// Where the unknowns start, and where the prior expects them.
    pub start: DVector<f64>,
    bounds: Vec<[f64; 2]>,
}

impl Reduction {
    /// One factor per group of [`groups`], y = ln of it, starting at 0.
    ///
    /// # Errors
    /// [`Error::Unsupported`] for a material without parameters.
    pub fn multipliers(material: &dyn MaterialModel) -> Result<Self> {
        Self::of_groups(material, groups(material))
    }
    /// One factor per native parameter.
    ///
    /// # Errors
    /// As [`Reduction::multipliers`].
    pub fn table(material: &dyn MaterialModel) -> Result<Self> {
        let own = |(i, p): (usize, &Parameter)| Group { name: p.name.clone(), members: vec![i] };
        Self::of_groups(material, material.parameters().iter().enumerate().map(own).collect())
    }
    fn of_groups(material: &dyn MaterialModel, groups: Vec<Group>) -> Result<Self> {
        let parameters = material.parameters();
        if parameters.is_empty() {
            return Err(Error::unsupported("estimation, it has no parameters", material.describe().name));
        }
        let mut map = DMatrix::zeros(parameters.len(), groups.len());
        for (k, group) in groups.iter().enumerate() {
            for &i in &group.members {
                map[(i, k)] = parameters[i].value;
            }
        }
        Ok(Self {
            start: DVector::zeros(groups.len()),
            names: groups.into_iter().map(|g| g.name).collect(),
            map,
            offset: DVector::zeros(parameters.len()),
            logarithmic: true,
            bounds: parameters.iter().map(|p| [p.lower, p.upper]).collect(),
        })
    }
    /// Moves the table along given combinations only: Θ = Θ₀ + diag(Θ₀) V y with unit columns V, shape [native][unknown], and
    /// Θ₀ the material's present values. Names say the largest parts of each.
    ///
    /// # Errors
    /// [`Error::Length`] for a V of another height.
    pub fn along(material: &dyn MaterialModel, directions: &DMatrix<f64>) -> Result<Self> {
        let parameters = material.parameters();
        Error::check_length("rows of the combinations", parameters.len(), directions.nrows())?;
        let names: Vec<String> = parameters.iter().map(|p| p.name.clone()).collect();
        let values = DVector::from_iterator(parameters.len(), parameters.iter().map(|p| p.value));
        Ok(Self {
            names: directions.column_iter().map(|v| in_words(&names, v.as_slice())).collect(),
            map: DMatrix::from_fn(parameters.len(), directions.ncols(), |i, k| values[i] * directions[(i, k)]),
            offset: values,
            logarithmic: false,
            start: DVector::zeros(directions.ncols()),
            bounds: parameters.iter().map(|p| [p.lower, p.upper]).collect(),
        })
    }
    /// A blend of fabrics with positive weights, Θ = Σ w_f Θ_f; all weights start alike with sum 1. Entries may leave the bounds
    /// around the material's own values only as far as the fabrics do.
    ///
    /// # Errors
    /// [`Error::Length`] for a fabric of another table, [`Error::Config`] without fabrics.
    pub fn blend(material: &dyn MaterialModel, fabrics: &[(String, Vec<f64>)]) -> Result<Self> {
        let parameters = material.parameters();
        if fabrics.is_empty() {
            return Err(Error::config("reduction.fabrics", "there are none to blend", "name at least one fabric"));
        }
        for (name, values) in fabrics {
            Error::check_length(&format!("parameters of {name}"), parameters.len(), values.len())?;
        }
        Ok(Self {
            names: fabrics.iter().map(|f| f.0.clone()).collect(),
            map: DMatrix::from_fn(parameters.len(), fabrics.len(), |i, k| fabrics[k].1[i]),
            offset: DVector::zeros(parameters.len()),
            logarithmic: true,
            start: DVector::from_element(fabrics.len(), -(fabrics.len() as f64).ln()),
            bounds: parameters.iter().map(|p| [p.lower, p.upper]).collect(),
        })
    }
    /// Number of unknowns.
    pub fn len(&self) -> usize {
        self.names.len()
    }
    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.names.is_empty()
    }
    /// Smallest and largest value of an unknown.
    pub fn limits(&self, unknown: usize) -> [f64; 2] {
        let reach = if self.logarithmic { LARGEST_FACTOR.ln() } else { LARGEST_CHANGE };
        [self.start[unknown] - reach, self.start[unknown] + reach]
    }
    fn multiplier(&self, y: f64) -> f64 {
        if self.logarithmic { y.exp() } else { y }
    }
    /// Native values at y, inside their bounds.
    pub fn values(&self, y: &[f64]) -> Vec<f64> {
        let m = DVector::from_iterator(self.len(), y.iter().map(|&y| self.multiplier(y)));
        let free = &self.map * m + &self.offset;
        free.iter().zip(&self.bounds).map(|(v, [lower, upper])| v.clamp(*lower, *upper)).collect()
    }
    /// dΘ/dy of one unknown at y, in the parameters' units; zero where a bound holds a native parameter.
    pub fn direction(&self, y: &[f64], unknown: usize) -> Vec<f64> {
        let factor = if self.logarithmic { y[unknown].exp() } else { 1.0 };
        let m = DVector::from_iterator(self.len(), y.iter().map(|&y| self.multiplier(y)));
        let free = &self.map * m + &self.offset;
        (0..free.len())
            .map(|i| {
                let [lower, upper] = self.bounds[i];
                if (lower..=upper).contains(&free[i]) { self.map[(i, unknown)] * factor } else { 0.0 }
            })
            .collect()
    }
    /// The material at y.
    ///
    /// # Errors
    /// What the material refuses.
    pub fn material(&self, material: &dyn MaterialModel, y: &[f64]) -> Result<Box<dyn MaterialModel>> {
        material.with_parameters(&self.values(y))
    }
}

/// A combination of unknowns in words, its largest parts first: `c22 (0.91) with bend[row 0] (-0.38)`. Parts below a quarter of the
/// largest are left out.
pub fn in_words(names: &[String], parts: &[f64]) -> String {
    let mut order: Vec<usize> = (0..parts.len().min(names.len())).collect();
    order.sort_by(|&a, &b| parts[b].abs().total_cmp(&parts[a].abs()));
    let Some(&first) = order.first() else { return String::new() };
    let sign = parts[first].signum();
    let words: Vec<String> = order
        .into_iter()
        .take_while(|&i| parts[i].abs() >= 0.25 * parts[first].abs())
        .take(4)
        .map(|i| format!("{} ({:+.2})", names[i], sign * parts[i]))
        .collect();
    words.join(" with ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_lose_their_last_index() {
        let of = |n: &str| without_last_index(n);
        assert_eq!([of("c11[row 3]"), of("bend[row 1, column 4]"), of("mu")], ["c11", "bend[row 1]", "mu"]);
    }

    #[test]
    fn combinations_in_words() {
        let names: Vec<String> = ["a", "b", "c"].map(String::from).into();
        assert_eq!(in_words(&names, &[0.1, -0.9, 0.4]), "b (+0.90) with c (-0.40)");
        assert_eq!(in_words(&[], &[]), "");
    }
}
