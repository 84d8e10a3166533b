//! What a solver is told once.

use crate::energy::{ContactOptions, RestAngle, gravity::EARTH};
use caphy_core::{Error, Result, Vec3};
use serde::{Deserialize, Serialize};

/// When to stop and how carefully to step.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SolverSettings {
    /// Converged when no vertex is pushed harder than this [N]. Default 1e-8, a ten-thousandth of the weight of one vertex of a
    /// shirt; 1e-10 can be reached on smooth cases.
    pub tolerance_n: f64,
    /// Most Newton steps over all rounds. Default 400.
    pub iterations: usize,
    /// Most L-BFGS steps before all others of a pose with a body. They end earlier near rest, or where forces no longer fall.
    /// Default 500: some fifty cost as much as one Newton step, and they untangle a wild start.
    pub warm_steps: usize,
    /// Most L-BFGS steps after those that take their first guess from a factorised tangent matrix, ending likewise. Default 1000:
    /// some ten cost as much as one Newton step. Contact pairs, friction and frozen stiffness settle in them.
    pub guided_steps: usize,
    /// Longest move of a vertex in one step [m]. Default 20 mm: less than the radius of a wrist, so that nothing jumps through a
    /// limb.
    pub max_move_m: f64,
    /// Newton steps between two searches for contact pairs while they still change. Default 6.
    pub steps_per_round: usize,
    /// Most searches for contact pairs and renewals of friction. Default 100.
    pub rounds: usize,
    /// Coulomb's coefficient μ of cloth on the body. Default 0: no friction.
    pub friction: f64,
    /// Slip distance δ of friction [m]: up to it a vertex sticks and may creep. Default 0.1 mm.
    pub slip_m: f64,
    /// Garments of more vertices are solved by L-BFGS. Default 60 000: the factor then takes about 2 GiB.
    pub largest_factorised: usize,
    /// Softest modes to report. Default 0: none, they cost some fifty solves.
    pub soft_modes: usize,
}

impl Default for SolverSettings {
    fn default() -> Self {
        Self {
            tolerance_n: 1e-8,
            iterations: 400,
            warm_steps: 500,
            guided_steps: 1000,
            max_move_m: 0.02,
            steps_per_round: 6,
            rounds: 100,
            friction: 0.0,
            slip_m: 1e-4,
            largest_factorised: 60_000,
            soft_modes: 0,
        }
    }
}

impl SolverSettings {
    pub(super) fn check(&self) -> Result<()> {
        let positive = [
            ("solver tolerance", self.tolerance_n, "N"),
            ("longest move of a step", self.max_move_m, "m"),
            ("slip distance", self.slip_m, "m"),
        ];
        for (name, value, unit) in positive {
            if !(value > 0.0 && value.is_finite()) {
                return Err(out_of_bounds(name, value, unit));
            }
        }
        if !(self.friction >= 0.0 && self.friction.is_finite()) {
            return Err(out_of_bounds("friction coefficient", self.friction, ""));
        }
        Ok(())
    }
}

pub(super) fn out_of_bounds(name: &str, value: f64, unit: &str) -> Error {
    Error::Parameter { name: name.into(), value, lower: 0.0, upper: f64::INFINITY, unit: unit.into() }
}

/// Which energies act on the garment, and how strongly.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Forces {
    /// Acceleration of free fall [m/s²].
    pub gravity: Vec3,
    /// What dihedral angles are measured from.
    pub rest_angle: RestAngle,
    /// Contact with the body; only asked for where a scene has one.
    pub contact: ContactOptions,
    /// Stiffness that holds a waistband [N/m²], see [`crate::energy::Attachment::new`].
    pub attachment: f64,
    /// Factors of strain, bending, gravity, collision, attachment. Default 1 each.
    pub weights: [f64; 5],
}

impl Default for Forces {
    fn default() -> Self {
        Self {
            gravity: EARTH,
            rest_angle: RestAngle::Template,
            contact: ContactOptions::default(),
            attachment: 1000.0,
            weights: [1.0; 5],
        }
    }
}
