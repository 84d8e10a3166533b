//! Bounds of a native parameter, derived from its start value.

use caphy_core::Real;
use caphy_core::params::Parameter;

/// Largest stiffness of any kind [N/m or N·m]: 1e9 keeps f32 energies finite up to the strain limit.
pub(crate) const LARGEST_STIFFNESS: f64 = 1e9;

/// Largest strains of fabrics whose energy is a square of strain, in single and double precision: at twice them, the square times
/// [`LARGEST_STIFFNESS`] is finite.
pub(crate) const STRAIN_LIMITS: [f64; 2] = [1e14, 1e100];

/// The one of [`STRAIN_LIMITS`] for a precision.
pub(crate) fn limit<T: Real>() -> f64 {
    STRAIN_LIMITS[usize::from(size_of::<T>() == 8)]
}

/// Three decades either way: what fabric estimation allows before it reports an active bound.
const DECADES: f64 = 1e3;

/// A parameter with bounds around its start value.
///
/// * positive: [1e-3, 1e3] times the value, so that a logarithm of it can be estimated;
/// * negative (20 published table entries): 1e3 times its size either way, so that a table may be multiplied as a whole;
/// * zero: from 0 to 1e3 times `scale`, a typical size of its kind.
pub(crate) fn bounded(name: String, unit: &str, value: f64, scale: f64) -> Parameter {
    let (lower, upper) = if value > 0.0 {
        (value / DECADES, value * DECADES)
    } else if value < 0.0 {
        (value * DECADES, -value * DECADES)
    } else {
        (0.0, scale * DECADES)
    };
    Parameter { name, unit: unit.into(), value, lower, upper: upper.min(LARGEST_STIFFNESS) }
}

#[cfg(test)]
mod tests {
    use super::bounded;

    #[test]
    fn the_start_value_is_always_admitted() {
        for value in [1e-6, 1.0, 1e8, -1e-3, -170.0, 0.0] {
            bounded("p".into(), "N/m", value, 1.0).check().unwrap();
        }
    }
}
