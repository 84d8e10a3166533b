//! Named, bounded, unit-carrying parameters: what fabric estimation turns and reports.

use crate::{Error, Result};
use serde::{Deserialize, Serialize};

/// One native parameter of a material.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Parameter {
    /// Stable name, unique within the material, e.g. `c11[row 3]`.
    pub name: String,
    /// Unit symbol, e.g. `N/m`.
    pub unit: String,
    /// Present value, in `unit`.
    pub value: f64,
    /// Smallest allowed value, in `unit`.
    pub lower: f64,
    /// Largest allowed value, in `unit`.
    pub upper: f64,
}

impl Parameter {
    /// `Ok` when the value is finite and inside the bounds.
    pub fn check(&self) -> Result<()> {
        if self.value.is_finite() && self.lower <= self.value && self.value <= self.upper {
            Ok(())
        } else {
            Err(Error::Parameter {
                name: self.name.clone(),
                value: self.value,
                lower: self.lower,
                upper: self.upper,
                unit: self.unit.clone(),
            })
        }
    }
}

/// Checks a new vector of values against a parameter list: count, finiteness, bounds.
pub fn check_values(parameters: &[Parameter], values: &[f64]) -> Result<()> {
    Error::check_length("parameter values", parameters.len(), values.len())?;
    for (parameter, &value) in parameters.iter().zip(values) {
        Parameter { value, ..parameter.clone() }.check()?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bounds_are_held_and_the_error_carries_the_values() {
        let p = Parameter { name: "k0".into(), unit: "N/m".into(), value: 1.0, lower: 0.0, upper: 2.0 };
        assert!(check_values(std::slice::from_ref(&p), &[2.0]).is_ok());
        let error = check_values(std::slice::from_ref(&p), &[3.0]).unwrap_err().to_string();
        assert!(error.contains("k0") && error.contains('3') && error.contains("N/m"), "{error}");
        assert!(check_values(std::slice::from_ref(&p), &[f64::NAN]).is_err());
        assert!(check_values(&[p], &[]).is_err());
    }
}
