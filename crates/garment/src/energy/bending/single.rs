//! Bending energy of one pose, hinges in lanes.

use super::{Bending, CHUNK, Element, Input, KEPT, MAX_LANES, SHARE, fade_forces, forces, geometry};
use crate::energy::single::{Single, SingleTerm, add_lane, check_single, gathered, lane_sum};
use caphy_core::material::HingeLength;
use caphy_core::{Error, Result, simd_kernel};

/// Hinges that travel through the material in one call.
const BATCH: usize = 256;

impl SingleTerm for Bending<f64> {
    fn add_single(&self, pose: &Single<'_>, weight: f64, mut gradient: Option<&mut [f64]>) -> Result<f64> {
        pose.check("bending", self.vertex_count, gradient.as_deref())?;
        let facts = self.material.describe();
        let mut buffers = Buffers::new(BATCH);
        let mut energy = [0.0; MAX_LANES];
        let current = facts.hinge_length != HingeLength::Rest;
        let length_flows = facts.hinge_length == HingeLength::Current;
        for (b, batch) in self.hinges.chunks(BATCH).enumerate() {
            if batch.len() != buffers.stiffness.len() {
                buffers = Buffers::new(batch.len());
            }
            let Buffers { input, kept, stiffness, by_angle, by_length } = &mut buffers;
            measure(batch, current, pose.positions, input, kept);
            if let Some(held) = &self.held {
                for (i, [k, length]) in held[b * BATCH..][..batch.len()].iter().enumerate() {
                    stiffness[i] = *k;
                    if facts.hinge_length == HingeLength::CurrentHeld {
                        input.length[i] = *length;
                    }
                }
            } else {
                self.ask(&facts, gradient.is_some(), input, stiffness, by_angle, by_length)
                    .map_err(|e| self.locate_single(e, b, batch.len()))?;
            }
            sum(batch, weight, input, kept, stiffness, &mut energy);
            if let Some(gradient) = gradient.as_deref_mut() {
                let slopes = (&by_angle[..], &by_length[..]);
                scatter(batch, length_flows, weight, pose.positions, input, kept, stiffness, slopes, gradient);
            }
        }
        check_single("bending", pose.positions, lane_sum(&energy))
    }
}

impl Bending<f64> {
    /// Says where a fold was that the material refused.
    fn locate_single(&self, error: Error, batch: usize, size: usize) -> Error {
        let Error::NonFinite { what, index, value } = error else { return error };
        let [n0, n1, ..] = self.hinges[batch * BATCH + index % size.max(1)].vertices;
        Error::numerics(
            "energy `bending`",
            format!("{what} is {value} at edge {n0}-{n1}"),
            "go back to the last good state with a smaller step, and check that the template is in metres",
        )
    }
}

/// What one batch needs; the material wants arrays of its very size.
struct Buffers {
    input: Input<f64>,
    kept: Vec<f64>,
    stiffness: Vec<f64>,
    by_angle: Vec<f64>,
    by_length: Vec<f64>,
}

impl Buffers {
    fn new(count: usize) -> Self {
        let zeros = || vec![0.0; count];
        Self {
            input: Input::new(count),
            kept: vec![0.0; KEPT * count],
            stiffness: zeros(),
            by_angle: zeros(),
            by_length: zeros(),
        }
    }
}

simd_kernel! {
    /// Angle and length of each hinge, its rest quantities, and what [`scatter`] needs to `kept` `[group][12][lane]`.
    fn measure<T>(batch: &[Element<T>], current: bool, x: &[T], input: &mut Input<T>, kept: &mut [T]) {
        let lanes = T::LANES;
        debug_assert!(CHUNK.is_multiple_of(lanes) && batch.len().is_multiple_of(lanes));
        let n = batch.len();
        for (g, group) in batch.chunks_exact(lanes).enumerate() {
            let x0 = gathered(group, x, |h| h.vertices[0]);
            let x1 = gathered(group, x, |h| h.vertices[1]);
            let x2 = gathered(group, x, |h| h.vertices[2]);
            let x3 = gathered(group, x, |h| h.vertices[3]);
            let mut angle = [T::zero(); MAX_LANES];
            let mut length = [T::zero(); MAX_LANES];
            let keep = &mut kept[g * KEPT * lanes..][..KEPT * lanes];
            geometry([&x0, &x1, &x2, &x3], &mut angle, &mut length, keep);
            let at = g * lanes;
            input.angle[at..][..lanes].copy_from_slice(&angle[..lanes]);
            for (l, hinge) in group.iter().enumerate() {
                input.length[at + l] = if current { length[l] } else { hinge.length };
                input.angle_rest[at + l] = hinge.angle;
                input.area[at + l] = hinge.area;
                for k in 0..2 {
                    input.direction0[k * n + at + l] = hinge.direction0[k];
                    input.direction1[k * n + at + l] = hinge.direction1[k];
                }
            }
        }
    }
}

simd_kernel! {
    /// Adds Σ k l²/(8A)(τ − τ_T)² per lane (Eq. 7).
    fn sum<T>(
        batch: &[Element<T>],
        weight: T,
        input: &Input<T>,
        kept: &[T],
        stiffness: &[T],
        energy: &mut [f64; MAX_LANES],
    ) {
        let lanes = T::LANES;
        for (g, group) in batch.chunks_exact(lanes).enumerate() {
            let at = g * lanes;
            let share = &kept[at * KEPT + SHARE * lanes..][..lanes];
            let (angle, rest, length) =
                (&input.angle[at..][..lanes], &input.angle_rest[at..][..lanes], &input.length[at..][..lanes]);
            let (area, k) = (&input.area[at..][..lanes], &stiffness[at..][..lanes]);
            for l in 0..lanes {
                let fold = angle[l] - rest[l];
                let factor = weight * group[l].weight / (T::of(8.0) * area[l]);
                energy[l] += (factor * k[l] * length[l] * length[l] * fold * fold * share[l]).to_f64();
            }
        }
    }
}

simd_kernel! {
    /// Adds the gradient of Eq. 7 to the four vertices.
    fn scatter<T>(
        batch: &[Element<T>],
        length_flows: bool,
        weight: T,
        x: &[T],
        input: &Input<T>,
        kept: &[T],
        stiffness: &[T],
        slopes: (&[T], &[T]),
        gradient: &mut [T],
    ) {
        let lanes = T::LANES;
        let flow = if length_flows { T::one() } else { T::zero() };
        for (g, group) in batch.chunks_exact(lanes).enumerate() {
            let at = g * lanes;
            let (angle, rest, length) =
                (&input.angle[at..][..lanes], &input.angle_rest[at..][..lanes], &input.length[at..][..lanes]);
            let (area, k) = (&input.area[at..][..lanes], &stiffness[at..][..lanes]);
            let (by_angle, by_length) = (&slopes.0[at..][..lanes], &slopes.1[at..][..lanes]);
            let kept = &kept[at * KEPT..][..KEPT * lanes];
            let mut turn = [T::zero(); MAX_LANES];
            let mut pull = [T::zero(); MAX_LANES];
            let share = &kept[SHARE * lanes..][..lanes];
            let mut needle = false;
            for l in 0..lanes {
                let fold = angle[l] - rest[l];
                needle |= share[l] != T::one();
                let factor = weight * group[l].weight / (T::of(8.0) * area[l]);
                turn[l] = factor * length[l] * length[l] * fold * (k[l] + k[l] + by_angle[l] * fold);
                pull[l] = flow * share[l] * factor * fold * fold * length[l] * (k[l] + k[l] + by_length[l] * length[l]);
            }
            let mut rows = forces(&turn, &pull, kept);
            if needle {
                let mut whole = [T::zero(); MAX_LANES];
                for l in 0..lanes {
                    let fold = angle[l] - rest[l];
                    let factor = weight * group[l].weight / (T::of(8.0) * area[l]);
                    whole[l] = factor * k[l] * length[l] * length[l] * fold * fold;
                }
                let x: [_; 4] = std::array::from_fn(|v| gathered(group, x, |h| h.vertices[v]));
                fade_forces([&x[0][..], &x[1], &x[2], &x[3]], &whole, &mut rows);
            }
            for (l, hinge) in group.iter().enumerate() {
                for (vertex, row) in hinge.vertices.iter().zip(&rows) {
                    add_lane(gradient, *vertex, row, l);
                }
            }
        }
    }
}
