//! Gravity: E = −Σ m g·x.

use super::single::{Single, SingleTerm, check_single};
use super::{EnergyTangent, EnergyTerm, MAX_LANES, State, Stencil, Tangent, add_blocks, row};
use crate::GarmentRest;
use caphy_core::lanes::Frames;
use caphy_core::material::MaterialReal;
use caphy_core::{Result, Vec3, simd_kernel};

/// Potential energy of the garment's mass; zero at the world's origin, so it may be negative.
pub struct Gravity<T> {
    masses: Vec<T>,
    acceleration: [T; 3],
}

/// Standard use: 9.81 m/s² downwards, as SNUG.
pub const EARTH: Vec3 = Vec3::new(0.0, -9.81, 0.0);

impl<T: MaterialReal> Gravity<T> {
    /// With an acceleration [m/s²]; its direction is a setting because tracked cameras are tilted.
    pub fn new(rest: &GarmentRest, acceleration: Vec3) -> Self {
        Self {
            masses: rest.vertex_masses.iter().map(|&m| T::of(m)).collect(),
            acceleration: [0, 1, 2].map(|k| T::of(acceleration[k])),
        }
    }
}

impl<T: MaterialReal> EnergyTerm<T> for Gravity<T> {
    fn name(&self) -> &'static str {
        "gravity"
    }
    fn add(
        &self,
        state: &State<'_, T>,
        weight: f64,
        energy: &mut [f64],
        gradient: Option<&mut Frames<T>>,
    ) -> Result<()> {
        let pull = self.acceleration.map(|g| -g * T::of(weight));
        add_blocks("gravity", self.masses.len(), state.positions, energy, gradient, |b, part| {
            let mut energy = [0.0; MAX_LANES];
            potential(&self.masses, pull, state.positions.block(b), &mut energy);
            if let Some(part) = part {
                for (row, &m) in part.chunks_exact_mut(3 * T::LANES).zip(&self.masses) {
                    for (axis, values) in row.chunks_exact_mut(T::LANES).enumerate() {
                        values.iter_mut().for_each(|v| *v += m * pull[axis]);
                    }
                }
            }
            Ok(energy)
        })
    }
}

impl SingleTerm for Gravity<f64> {
    fn add_single(&self, pose: &Single<'_>, weight: f64, gradient: Option<&mut [f64]>) -> Result<f64> {
        pose.check("gravity", self.masses.len(), gradient.as_deref())?;
        let pull = self.acceleration.map(|g| -g * weight);
        let energy = pose.positions.chunks_exact(3).zip(&self.masses);
        let energy = energy.map(|(p, m)| m * (pull[0] * p[0] + pull[1] * p[1] + pull[2] * p[2])).sum();
        if let Some(gradient) = gradient {
            for (g, m) in gradient.chunks_exact_mut(3).zip(&self.masses) {
                (0..3).for_each(|k| g[k] += m * pull[k]);
            }
        }
        check_single("gravity", pose.positions, energy)
    }
}

impl EnergyTangent for Gravity<f64> {
    /// No elements: gravity is linear in the positions.
    fn stencil(&self) -> Stencil {
        Stencil { width: 1, vertices: Vec::new() }
    }
    fn tangents(&self, _: &State<'_, f64>, _: f64, _: Tangent, _: &mut [f64]) -> Result<()> {
        Ok(())
    }
}

simd_kernel! {
    /// Adds Σ m pull·x per lane.
    fn potential<T>(masses: &[T], pull: [T; 3], x: &[T], energy: &mut [f64; MAX_LANES]) {
        let lanes = T::LANES;
        for (v, &m) in masses.iter().enumerate() {
            let p = row(x, v as u32);
            for l in 0..lanes {
                energy[l] += (m * (pull[0] * p[l] + pull[1] * p[lanes + l] + pull[2] * p[2 * lanes + l])).to_f64();
            }
        }
    }
}
