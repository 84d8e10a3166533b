//! Membrane constants of isotropic sheets, in whichever units they are given.

use crate::bounds::LARGEST_STIFFNESS;
use caphy_core::units::{KilogramPerSquareMetre, Metre, NewtonMetre, NewtonPerMetre, Pascal};
use caphy_core::{Error, Result};

/// The groups of keys that give the membrane constants, as error messages list them.
const GROUPS: &str = "give exactly one of: (lambda_pa, mu_pa, thickness_m), (lambda_n_per_m, mu_n_per_m), \
                      (young_pa, poisson, thickness_m)";

/// The keys that give λ and μ: exactly one group of them.
pub(crate) struct LameKeys {
    pub(crate) lambda_pa: Option<Pascal>,
    pub(crate) mu_pa: Option<Pascal>,
    pub(crate) lambda_n_per_m: Option<NewtonPerMetre>,
    pub(crate) mu_n_per_m: Option<NewtonPerMetre>,
    pub(crate) young_pa: Option<Pascal>,
    pub(crate) poisson: Option<f64>,
    pub(crate) thickness_m: Option<Metre>,
}

impl LameKeys {
    /// λ and μ of the sheet [N/m] from whichever group was given.
    ///
    /// # Errors
    /// [`Error::Config`] when no group or more than one is given, or a value is not physical.
    pub(crate) fn lame(&self) -> Result<(NewtonPerMetre, NewtonPerMetre)> {
        let (lambda, mu) = self.given()?;
        check_lame(lambda.0, mu.0).map_err(|_| {
            Error::config(
                "material",
                format!("lambda = {lambda} and mu = {mu} do not make a stable sheet"),
                format!("mu and lambda + mu must be positive and at most {LARGEST_STIFFNESS:e} N/m"),
            )
        })?;
        Ok((lambda, mu))
    }

    fn given(&self) -> Result<(NewtonPerMetre, NewtonPerMetre)> {
        let given = (
            (self.lambda_pa, self.mu_pa),
            (self.lambda_n_per_m, self.mu_n_per_m),
            (self.young_pa, self.poisson),
            self.thickness_m,
        );
        match given {
            ((Some(lambda), Some(mu)), (None, None), (None, None), Some(thickness)) => {
                let thickness = positive_thickness(thickness)?;
                Ok((lambda.times_thickness(thickness), mu.times_thickness(thickness)))
            }
            ((None, None), (Some(lambda), Some(mu)), (None, None), None) => Ok((lambda, mu)),
            ((None, None), (None, None), (Some(young), Some(poisson)), Some(thickness)) => {
                let thickness = positive_thickness(thickness)?;
                if !(poisson > -1.0 && poisson <= 0.5) {
                    return Err(Error::config(
                        "material.poisson",
                        format!("{poisson} is not a Poisson's ratio"),
                        "give a value in (-1, 0.5]; 0.5 is incompressible",
                    ));
                }
                let plane = young.0 / (1.0 - poisson * poisson);
                Ok((
                    Pascal(plane * poisson).times_thickness(thickness),
                    Pascal(plane * (1.0 - poisson) / 2.0).times_thickness(thickness),
                ))
            }
            _ => Err(Error::config("material", format!("membrane keys given: {}", self.given_keys()), GROUPS)),
        }
    }

    fn given_keys(&self) -> String {
        let keys = [
            ("lambda_pa", self.lambda_pa.is_some()),
            ("mu_pa", self.mu_pa.is_some()),
            ("lambda_n_per_m", self.lambda_n_per_m.is_some()),
            ("mu_n_per_m", self.mu_n_per_m.is_some()),
            ("young_pa", self.young_pa.is_some()),
            ("poisson", self.poisson.is_some()),
            ("thickness_m", self.thickness_m.is_some()),
        ];
        let given: Vec<&str> = keys.iter().filter(|k| k.1).map(|k| k.0).collect();
        if given.is_empty() { "none".into() } else { given.join(", ") }
    }
}

/// `Ok` for a bending stiffness in [0, 1e9] N·m.
pub(crate) fn check_bending(bending: NewtonMetre) -> Result<NewtonMetre> {
    if bending.0 >= 0.0 && bending.0 <= LARGEST_STIFFNESS {
        return Ok(bending);
    }
    Err(Error::config(
        "material.bending_nm",
        format!("{bending} is not a bending stiffness"),
        format!("give a value in [0, {LARGEST_STIFFNESS:e}] N·m"),
    ))
}

fn positive_thickness(thickness: Metre) -> Result<Metre> {
    if thickness.0 > 0.0 && thickness.0.is_finite() {
        Ok(thickness)
    } else {
        Err(Error::config(
            "material.thickness_m",
            format!("{thickness} is not a thickness"),
            "give a positive value in metres; clothes have 1e-4 to 5e-3",
        ))
    }
}

/// `Ok` for an absent density or one that is positive and finite.
pub(crate) fn check_density(density: Option<KilogramPerSquareMetre>) -> Result<()> {
    match density {
        Some(value) if !(value.0 > 0.0 && value.0.is_finite()) => Err(Error::config(
            "material.density_kg_per_m2",
            format!("{value} is not an area density"),
            "give a positive value; clothes have 0.05 to 1 kg/m²",
        )),
        _ => Ok(()),
    }
}

/// `Ok` when the sheet's energy is positive for every strain: μ > 0 and λ + μ > 0 (two dimensions).
pub(crate) fn check_lame(lambda: f64, mu: f64) -> Result<()> {
    let problem = |name: &str, value: f64, lower: f64| Error::Parameter {
        name: name.into(),
        value,
        lower,
        upper: LARGEST_STIFFNESS,
        unit: NewtonPerMetre::SYMBOL.into(),
    };
    if !(mu > 0.0 && mu <= LARGEST_STIFFNESS) {
        Err(problem("mu", mu, 0.0))
    } else if !(lambda > -mu && lambda <= LARGEST_STIFFNESS) {
        Err(problem("lambda", lambda, -mu))
    } else {
        Ok(())
    }
}
