//! Garment against garment (Eq. 12): the upper garment over the lower one, or tucked into it.

use super::collision::{lane_points, square_distance};
use super::{check_energy, check_same_frames, check_shapes, frame_normals};
use crate::GarmentRest;
use caphy_core::lanes::Frames;
use caphy_core::query::{NearestGrid, boundary_loops};
use caphy_core::{Error, Real, Result};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Which garment is outside.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LayeringOrder {
    /// The upper garment hangs over the lower one.
    #[default]
    Over,
    /// The upper garment is tucked into the lower one.
    Tucked,
}

/// Settings of [`Layering`].
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LayeringOptions {
    /// Which garment is outside.
    pub order: LayeringOrder,
    /// Margin δ between the layers [m]. Default 4 mm, as between training and body: nets miss it by a millimetre or two. With 2 mm, two
    /// thicknesses of cloth, three times as many vertices of the quickstart stay inside.
    pub margin: f64,
    /// Upper vertices farther than this from the lower garment do not take part [m]. Default 30 mm: deeper penetrations
    /// would be indistinguishable from the far side of a leg.
    pub reach: f64,
    /// Penalty weight w [J/m⁵] of E = Σ A_u w max(…)³. Default 1e7: 30 Pa, some fifteen layers of cloth, at 1 mm.
    pub weight: f64,
}

impl Default for LayeringOptions {
    fn default() -> Self {
        Self { order: LayeringOrder::Over, margin: 4e-3, reach: 0.03, weight: 1e7 }
    }
}

/// E = Σ_u A_u w max(δ − s n_l·(x_u − x_l), 0)³ over upper vertices u with their nearest lower vertex l, s = 1 over and −1
/// tucked. Pairs and n_l are held while differentiating; both garments get their gradient.
///
/// Differs from the paper: Eq. 12 prints max(n_l·(v_u − v_l − δ), 0)³, which would penalise the outside. It is also weighted
/// by area, and a pair whose lower vertex lies on that garment's boundary only counts when x_u is beside it, not beyond it
/// (farther along the surface than an edge): above the waistband there is no lower garment.
pub struct Layering<T> {
    options: LayeringOptions,
    weights: Vec<T>,
    lower_boundary: Vec<bool>,
    lower_faces: Vec<[u32; 3]>,
    edge: T,
}

/// One garment of a batch: positions [m] and, where wanted, the gradient to add to [N].
pub struct Layer<'a, T> {
    /// Positions [m].
    pub positions: &'a Frames<T>,
    /// Gradient, added to.
    pub gradient: Option<&'a mut Frames<T>>,
}

/// A contact: upper vertex, lower vertex, gradient by the upper vertex (the lower one gets its opposite).
type Pair<T> = (u32, u32, [T; 3]);

impl<T: Real> Layering<T> {
    /// For an upper and a lower garment.
    ///
    /// # Errors
    /// [`Error::Parameter`] for a margin, reach or weight that is not positive.
    pub fn new(upper: &GarmentRest, lower: &GarmentRest, options: LayeringOptions) -> Result<Self> {
        for (name, value, unit) in [
            ("layering margin", options.margin, "m"),
            ("layering reach", options.reach, "m"),
            ("layering weight", options.weight, "J/m^5"),
        ] {
            if !(value > 0.0 && value.is_finite()) {
                let (lower, upper) = (0.0, f64::INFINITY);
                return Err(Error::Parameter { name: name.into(), value, lower, upper, unit: unit.into() });
            }
        }
        let mut lower_boundary = vec![false; lower.vertex_count()];
        for v in boundary_loops(lower.faces()).into_iter().flatten() {
            lower_boundary[v as usize] = true;
        }
        Ok(Self {
            options,
            weights: upper.vertex_areas.iter().map(|a| T::of(a * options.weight)).collect(),
            lower_boundary,
            lower_faces: lower.faces().to_vec(),
            edge: T::of(lower.template.mean_edge_length()),
        })
    }

    /// Adds `weight` times the energy of each frame `[block * lanes_used + lane]` and the gradients of both garments.
    ///
    /// # Errors
    /// As [`super::EnergyTerm::add`].
    pub fn add(&self, upper: Layer<'_, T>, lower: Layer<'_, T>, weight: f64, energy: &mut [f64]) -> Result<()> {
        let (xu, xl) = (upper.positions, lower.positions);
        check_shapes("layering", self.weights.len(), xu, energy, upper.gradient.as_deref())?;
        check_same_frames("lower garment of layering", xu, xl)?;
        check_shapes("layering", self.lower_boundary.len(), xl, energy, lower.gradient.as_deref())?;
        let normals = frame_normals(xl, &self.lower_faces)?;
        let lanes = xu.lanes_used();
        let results: Vec<Result<(f64, Vec<Pair<T>>)>> = (0..xu.frames())
            .into_par_iter()
            .map(|frame| {
                let (block, lane) = (frame / lanes, frame % lanes);
                let points = |f: &Frames<T>| lane_points(f, block, lane);
                let (upper, lower) = (points(xu), points(xl));
                let answer = self.frame(&upper, &lower, &points(&normals), T::of(weight));
                let culprit = if lower.iter().flatten().all(|c| c.is_finite()) { xu } else { xl };
                check_energy("layering", culprit, block, lane, answer.0)?;
                Ok(answer)
            })
            .collect();
        let results = results.into_iter().collect::<Result<Vec<_>>>()?;
        for (slot, (value, _)) in energy.iter_mut().zip(&results) {
            *slot += value;
        }
        for (gradient, is_upper) in [(upper.gradient, true), (lower.gradient, false)] {
            let Some(gradient) = gradient else { continue };
            for (frame, (_, pairs)) in results.iter().enumerate() {
                let (block, lane) = (frame / lanes, frame % lanes);
                let last = if lane + 1 == lanes { T::LANES } else { lane + 1 };
                let values = gradient.block_mut(block);
                for (u, l, g) in pairs {
                    for k in 0..3 {
                        let (vertex, g) = if is_upper { (*u, g[k]) } else { (*l, -g[k]) };
                        let at = (vertex as usize * 3 + k) * T::LANES;
                        values[at + lane..at + last].iter_mut().for_each(|slot| *slot += g);
                    }
                }
            }
        }
        Ok(())
    }

    fn frame(&self, upper: &[[T; 3]], lower: &[[T; 3]], normals: &[[T; 3]], weight: T) -> (f64, Vec<Pair<T>>) {
        let grid = NearestGrid::new(lower);
        let sign = match self.options.order {
            LayeringOrder::Over => T::one(),
            LayeringOrder::Tucked => -T::one(),
        };
        let limit = T::of(self.options.reach * self.options.reach);
        let margin = T::of(self.options.margin);
        let mut energy = 0.0;
        let mut pairs = Vec::new();
        for (u, x) in upper.iter().enumerate() {
            if x.iter().any(|c| !c.is_finite()) {
                return (f64::NAN, Vec::new());
            }
            let Some((l, square)) = grid.nearest_within(x, limit) else { continue };
            let (p, n) = (lower[l as usize], normals[l as usize]);
            let normal = n[0] * (x[0] - p[0]) + n[1] * (x[1] - p[1]) + n[2] * (x[2] - p[2]);
            let depth = margin - sign * normal;
            // Not written as its opposite: NaN must reach the energy and be found out.
            if depth <= T::zero() {
                continue;
            }
            debug_assert!(square == square_distance(x, &p));
            let beyond = square - normal * normal > self.edge * self.edge;
            if self.lower_boundary[l as usize] && beyond {
                continue;
            }
            let w = weight * self.weights[u] * depth * depth;
            energy += (w * depth).to_f64();
            let push = -T::of(3.0) * w * sign;
            pairs.push((u as u32, l, n.map(|c| push * c)));
        }
        (energy, pairs)
    }
}
