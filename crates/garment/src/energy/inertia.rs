//! Inertia: Σ m/(2Δt²) |x_t − x_{t−1} − Δt v_{t−1}|², past frames held.

use super::{Attachment, EnergyTerm, MAX_LANES, State, add_blocks, add_row, row};
use crate::GarmentRest;
use caphy_core::lanes::Frames;
use caphy_core::material::MaterialReal;
use caphy_core::{Error, Real, Result, simd_kernel};
use serde::{Deserialize, Serialize};

/// Which transitions of a window count.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum InertiaRule {
    /// Those with a known velocity v_{t−1} = (x_{t−1} − x_{t−2})/Δt: from the third step on.
    #[default]
    KnownVelocity,
    /// SNUG's: from the second step on, with v = 0 for the first transition, which then dwarfs the others.
    Faithful,
}

/// Incremental potential of implicit Euler in world space; block t against blocks t − 1 and t − 2.
///
/// Differs from SNUG's published loss: the gradient reaches x_t only. Fully differentiated, the past is pulled towards the
/// future.
pub struct Inertia<T> {
    masses: Vec<T>,
    step: f64,
    rule: InertiaRule,
}

impl<T: MaterialReal> Inertia<T> {
    /// With a time step Δt [s].
    ///
    /// # Errors
    /// [`Error::Parameter`] for a step that is not positive.
    pub fn new(rest: &GarmentRest, step: f64, rule: InertiaRule) -> Result<Self> {
        if !(step > 0.0 && step.is_finite()) {
            return Err(Error::Parameter {
                name: "time step of inertia".into(),
                value: step,
                lower: 0.0,
                upper: f64::INFINITY,
                unit: "s".into(),
            });
        }
        Ok(Self { masses: rest.vertex_masses.iter().map(|&m| T::of(m)).collect(), step, rule })
    }
    /// The same energy of one step to come, seen as springs of m/Δt² from every vertex to 2 x_t − x_{t−1}: what a solver of
    /// backward Euler steps minimises.
    ///
    /// # Errors
    /// As [`Attachment::springs`].
    pub fn next_step(&self) -> Result<Attachment<T>> {
        let all: Vec<u32> = (0..self.masses.len() as u32).collect();
        let stiffness: Vec<f64> = self.masses.iter().map(|&m| Real::to_f64(m) / (self.step * self.step)).collect();
        Attachment::springs(&all, &stiffness, self.masses.len())
    }
    /// Number of transitions that count in windows of `steps` frames, `past`: with the two frames before: the divisor of a mean.
    pub fn transitions(&self, steps: usize, past: bool) -> usize {
        steps.saturating_sub(match self.rule {
            _ if past => 0,
            InertiaRule::KnownVelocity => 2,
            InertiaRule::Faithful => 1,
        })
    }
}

impl<T: MaterialReal> EnergyTerm<T> for Inertia<T> {
    fn name(&self) -> &'static str {
        "inertia"
    }
    /// The energy of the transition into step t is that of frame t; frames without one have none.
    fn add(
        &self,
        state: &State<'_, T>,
        weight: f64,
        energy: &mut [f64],
        gradient: Option<&mut Frames<T>>,
    ) -> Result<()> {
        let x = state.positions;
        let factor = T::of(weight / (self.step * self.step));
        if let Some(past) = state.past {
            Error::check_length("steps before the first, for inertia", 2, past.blocks())?;
            Error::check_length("vertices of the steps before the first", x.vertices(), past.vertices())?;
            Error::check_length("windows of the steps before the first", x.lanes_used(), past.lanes_used())?;
        }
        add_blocks("inertia", self.masses.len(), x, energy, gradient, |b, part| {
            let mut energy = [0.0; MAX_LANES];
            let past = match (b, state.past, self.rule) {
                (0, Some(past), _) => (past.block(1), past.block(0)),
                (1, Some(past), _) => (x.block(0), past.block(1)),
                (0, ..) | (1, _, InertiaRule::KnownVelocity) => return Ok(energy),
                // A second past frame that equals the first is a velocity of zero.
                (1, _, InertiaRule::Faithful) => (x.block(0), x.block(0)),
                _ => (x.block(b - 1), x.block(b - 2)),
            };
            let mut none = [];
            let (wanted, part) = part.map_or((false, &mut none[..]), |part| (true, part));
            momentum(&self.masses, factor, x.block(b), past, &mut energy, wanted, part);
            Ok(energy)
        })
    }
}

simd_kernel! {
    /// Adds ½ factor m |r|² per lane and factor m r to the gradient, r = x_t − 2 x_{t−1} + x_{t−2}.
    fn momentum<T>(
        masses: &[T],
        factor: T,
        now: &[T],
        past: (&[T], &[T]),
        energy: &mut [f64; MAX_LANES],
        wanted: bool,
        gradient: &mut [T],
    ) {
        let lanes = T::LANES;
        let half = T::of(0.5);
        for (v, &m) in masses.iter().enumerate() {
            let (x, y, z) = (row(now, v as u32), row(past.0, v as u32), row(past.1, v as u32));
            let fm = factor * m;
            let mut g = [T::zero(); 3 * MAX_LANES];
            for l in 0..lanes {
                let mut square = T::zero();
                for axis in 0..3 {
                    let i = axis * lanes + l;
                    let r = (x[i] - y[i]) - (y[i] - z[i]);
                    square += r * r;
                    g[i] = fm * r;
                }
                energy[l] += (half * fm * square).to_f64();
            }
            if wanted {
                add_row(gradient, v as u32, &g);
            }
        }
    }
}
