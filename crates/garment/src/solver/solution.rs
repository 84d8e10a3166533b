//! What a solver answers.

use super::state::Frozen;
use crate::energy::Touch;
use caphy_core::Vec3;
use serde::{Deserialize, Serialize};

/// How a solve ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Outcome {
    /// Forces are below the tolerance, contact pairs and friction agree with the positions.
    Converged,
    /// Forces are below the tolerance with the pairs as they were held, but some vertices have a nearer body vertex, or friction still
    /// changes: see `pairs_open` and `friction_open_n`.
    PairsOpen,
    /// The steps were used up.
    IterationLimit,
    /// No step along the search direction lowers the energy or the forces any more: rounding, or a kink of the material.
    Stalled,
}

/// How forces were balanced.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Method {
    /// Newton steps with a sparse factorisation.
    Newton,
    /// Limited-memory BFGS, for large garments.
    Lbfgs,
}

/// What was done.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SolveReport {
    /// How it ended.
    pub outcome: Outcome,
    /// How forces were balanced.
    pub method: Method,
    /// Largest force on a vertex that may move [N]: the material's own force, also with frozen stiffness.
    pub residual_n: f64,
    /// Vertex that it acts on.
    pub residual_vertex: usize,
    /// Newton (or L-BFGS) steps.
    pub iterations: usize,
    /// Factorisations, those included that failed.
    pub factorisations: usize,
    /// Evaluations of energy, forces or both.
    pub evaluations: usize,
    /// Searches for contact pairs.
    pub rounds: usize,
    /// Factorisations that needed something added to the diagonal, because the matrix was singular or the step too long.
    pub damped: usize,
    /// Energy per term [J].
    pub energies: Vec<(String, f64)>,
    /// Vertices that touch the body and have a nearer body vertex than the one they were held to.
    pub pairs_open: usize,
    /// Largest change of a friction limit between the last two rounds [N].
    pub friction_open_n: f64,
    /// The softest modes, softest first, when asked for.
    pub soft_modes: Vec<SoftMode>,
}

impl SolveReport {
    /// After so many steps; what is not known yet is nothing.
    pub(super) fn new(outcome: Outcome, method: Method, iterations: usize) -> Self {
        Self {
            outcome,
            method,
            residual_n: 0.0,
            residual_vertex: 0,
            iterations,
            factorisations: 0,
            evaluations: 0,
            rounds: 0,
            damped: 0,
            energies: Vec::new(),
            pairs_open: 0,
            friction_open_n: 0.0,
            soft_modes: Vec::new(),
        }
    }
    /// Energy of a term [J]; 0 for one that did not act.
    pub fn energy(&self, term: &str) -> f64 {
        self.energies.iter().find(|e| e.0 == term).map_or(0.0, |e| e.1)
    }
}

/// A way in which the garment moves with little resistance.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SoftMode {
    /// ω² = φᵀHφ / φᵀMφ [1/s²]; near zero for free sliding, negative where the state is no minimum. Gravity on a pendulum of
    /// length L gives 9.81/L.
    pub omega_squared: f64,
    /// (φᵀM e)² / (φᵀMφ · m) per axis: the share of the garment's mass that moves along x, y, z as one.
    pub participation: [f64; 3],
    /// Vertex that moves most.
    pub vertex: usize,
    /// Displacement φ [m per unit], shape [vertex][3], of unit modal mass.
    pub shape: Vec<[f64; 3]>,
}

/// A garment at rest (or after one time step).
#[derive(Debug, Clone)]
pub struct Solution {
    /// Positions [m].
    pub positions: Vec<Vec3>,
    /// Vertices that touch the body, with their forces.
    pub contacts: Vec<Touch>,
    /// Where friction holds each vertex [m], for the next pose or step (see [`super::Scene::anchors`]); the positions without
    /// friction.
    pub anchors: Vec<Vec3>,
    /// What was done.
    pub report: SolveReport,
    pub(super) frozen: Frozen,
}

impl Solution {
    /// Body vertex that each garment vertex is held to, `[garment vertex][lane]`.
    pub(super) fn pairs(&self) -> Option<&[u32]> {
        self.frozen.nearest.as_deref()
    }
    /// Whether forces, pairs and friction all settled.
    pub fn converged(&self) -> bool {
        self.report.outcome == Outcome::Converged
    }
}

/// Where a solve stands.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Progress {
    /// Search for contact pairs, from 0.
    pub round: usize,
    /// Step over all rounds.
    pub iteration: usize,
    /// Largest force on a vertex [N].
    pub residual_n: f64,
    /// Sum of energies [J].
    pub energy_j: f64,
}
