//! Fewer unknowns than native parameters: Θ = Θ₀ scaled group by group.
//!
//! A fabric's native table has tens of entries of which a handful of drapes determine few. The default reduction gives
//! one multiplier to each group of entries that belong together: the columns of the membrane table, the rows of the bending
//! table.

use caphy_core::Result;
use caphy_core::material::MaterialModel;

/// A named group of native parameters.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Group {
    /// Name: what stands before the first `[` in the parameters' names.
    pub name: String,
    /// Indices into [`MaterialModel::parameters`].
    pub members: Vec<usize>,
}

/// Groups parameters by the part of their name before `[`, in order of first appearance.
pub fn groups(material: &dyn MaterialModel) -> Vec<Group> {
    let mut out: Vec<Group> = Vec::new();
    for (i, parameter) in material.parameters().iter().enumerate() {
        let name = parameter.name.split('[').next().unwrap_or(&parameter.name).trim();
        match out.iter_mut().find(|g| g.name == name) {
            Some(group) => group.members.push(i),
            None => out.push(Group { name: name.into(), members: vec![i] }),
        }
    }
    out
}

/// The material with each group's parameters multiplied, kept inside their bounds.
pub fn scaled(material: &dyn MaterialModel, groups: &[Group], multipliers: &[f64]) -> Result<Box<dyn MaterialModel>> {
    let parameters = material.parameters();
    let mut values: Vec<f64> = parameters.iter().map(|p| p.value).collect();
    for (group, &multiplier) in groups.iter().zip(multipliers) {
        for &i in &group.members {
            values[i] = (values[i] * multiplier).clamp(parameters[i].lower, parameters[i].upper);
        }
    }
    material.with_parameters(&values)
}
