//! What an estimation found.

use caphy_core::Vec3;
use caphy_garment::estimate::equilibrium::FabricOdds;
use caphy_garment::estimate::{AlternationEstimate, EquilibriumEstimate, FabricEstimate, Problem};
use serde::{Deserialize, Serialize};

/// A fabric with its evidence, by estimator.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Estimated {
    /// By the equilibrium fit.
    Equilibrium(Box<EquilibriumEstimate>),
    /// By the paper's alternation, the reference solver between physics and scan.
    Alternation(Box<AlternationEstimate>),
    /// By one round of the paper's alternation: Eq. 10 on the garments of a trained net.
    Net(Box<FabricEstimate>),
    /// Not found, for a reason: the values at the start.
    Kept {
        /// Those values.
        parameters: Vec<f64>,
        /// Why.
        warnings: Vec<String>,
    },
}

/// One unknown in a line.
#[derive(Debug, Clone)]
pub struct Factor {
    /// The group's name.
    pub name: String,
    /// Factor of the values at the start.
    pub factor: f64,
    /// Its 95 % interval, where the estimator has one.
    pub interval: Option<[f64; 2]>,
    /// What is to be known of it, or nothing.
    pub note: &'static str,
}

impl Estimated {
    /// Native parameters.
    pub fn parameters(&self) -> &[f64] {
        match self {
            Self::Equilibrium(e) => &e.parameters,
            Self::Alternation(a) => &a.last.parameters,
            Self::Net(e) => &e.parameters,
            Self::Kept { parameters, .. } => parameters,
        }
    }
    /// What the user must know.
    pub fn warnings(&self) -> &[String] {
        match self {
            Self::Equilibrium(e) => &e.warnings,
            Self::Alternation(a) => &a.last.warnings,
            Self::Net(e) => &e.warnings,
            Self::Kept { warnings, .. } => warnings,
        }
    }
    /// Shapes at the end [m], `[pose][vertex]`, where the estimator makes any.
    pub fn shapes(&self) -> &[Vec<[f64; 3]>] {
        match self {
            Self::Equilibrium(e) => &e.shapes,
            Self::Alternation(a) => &a.shapes,
            Self::Net(_) | Self::Kept { .. } => &[],
        }
    }
    /// The unknowns.
    pub fn factors(&self) -> Vec<Factor> {
        let balanced = |e: &FabricEstimate| {
            let of = |g: &caphy_garment::estimate::GroupEstimate| Factor {
                name: g.name.clone(),
                factor: g.multiplier,
                interval: None,
                note: match (g.excited, g.at_bound) {
                    (false, _) => "not excited, kept",
                    (true, true) => "at its bound",
                    (true, false) => "",
                },
            };
            e.groups.iter().map(of).collect()
        };
        match self {
            Self::Equilibrium(e) => {
                let of = |u: &caphy_garment::estimate::equilibrium::UnknownEstimate| Factor {
                    name: u.name.clone(),
                    factor: u.multiplier,
                    interval: Some(u.interval),
                    note: match (u.at_bound, u.held_by_prior) {
                        (true, _) => "at its bound",
                        (_, true) => "held by the prior",
                        _ => "",
                    },
                };
                e.unknowns.iter().map(of).collect()
            }
            Self::Alternation(a) => balanced(&a.last),
            Self::Net(e) => balanced(e),
            Self::Kept { .. } => Vec::new(),
        }
    }
}

/// The fabric of one cloth.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct FabricFound {
    /// The material's name.
    pub material: String,
    /// Names and units of its native parameters.
    pub parameter_names: Vec<[String; 2]>,
    /// Native parameters before.
    pub before: Vec<f64>,
    /// Native parameters after.
    pub after: Vec<f64>,
    /// Area density that was assumed [kg/m²].
    pub density_kg_per_m2: f64,
    /// Whether the cloth was weighed.
    pub weighed: bool,
    /// The estimate with its evidence.
    pub estimate: Estimated,
    /// The ten measured fabrics, nearest first; for a measured material by the equilibrium fit.
    pub nearest: Vec<FabricOdds>,
}

impl FabricFound {
    /// What `problem` came to.
    pub fn new(problem: &Problem, estimate: Estimated, nearest: Vec<FabricOdds>) -> Self {
        let parameters = problem.material.parameters();
        Self {
            material: problem.material.describe().name,
            parameter_names: parameters.iter().map(|p| [p.name.clone(), p.unit.clone()]).collect(),
            before: parameters.iter().map(|p| p.value).collect(),
            after: estimate.parameters().to_vec(),
            density_kg_per_m2: problem.rest.density.0,
            weighed: problem.weighed,
            estimate,
            nearest,
        }
    }
    /// Shapes at the end [m], `[pose][vertex]`.
    pub fn shapes(&self) -> Vec<Vec<Vec3>> {
        self.estimate.shapes().iter().map(|x| x.iter().map(|p| Vec3::from(*p)).collect()).collect()
    }
}
