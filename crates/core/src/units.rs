//! Units as types where mixing them up would be silent: Pa and N/m differ by the thickness, a factor of about 2000.

use serde::{Deserialize, Serialize};

macro_rules! unit {
    ($(#[$meta:meta])* $name:ident, $symbol:literal) => {
        $(#[$meta])*
        #[derive(Debug, Clone, Copy, PartialEq, PartialOrd, Serialize, Deserialize)]
        #[serde(transparent)]
        pub struct $name(pub f64);
        impl $name {
            /// The unit's symbol.
            pub const SYMBOL: &'static str = $symbol;
        }
        impl std::fmt::Display for $name {
            fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                write!(f, "{} {}", self.0, $symbol)
            }
        }
    };
}

unit!(
    /// A bulk modulus of elasticity [Pa]: multiplies a rest *volume*.
    Pascal, "Pa"
);
unit!(
    /// A membrane stiffness [N/m]: multiplies a rest *area*.
    NewtonPerMetre, "N/m"
);
unit!(
    /// A bending stiffness [N·m].
    NewtonMetre, "N·m"
);
unit!(
    /// A length [m].
    Metre, "m"
);
unit!(
    /// An area density [kg/m²].
    KilogramPerSquareMetre, "kg/m²"
);

impl Pascal {
    /// The membrane stiffness of a sheet of this modulus: the only way from Pa to N/m.
    ///
    /// ```compile_fail
    /// use caphy_core::units::{NewtonPerMetre, Pascal};
    /// let wrong: NewtonPerMetre = Pascal(7e4);
    /// ```
    pub fn times_thickness(self, thickness: Metre) -> NewtonPerMetre {
        NewtonPerMetre(self.0 * thickness.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn snug_membrane_stiffness() {
        // reference/fabric-evaluation.md, section 6: μ t = 11.0774 N/m.
        let mu = Pascal(23569.02).times_thickness(Metre(4.7e-4));
        assert!((mu.0 - 11.0774).abs() < 1e-4, "{mu}");
    }
}
