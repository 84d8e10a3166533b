//! Strain energy of one pose, triangles in lanes.

use super::{CHUNK, Held, MAX_LANES, Strain, Triangle};
use crate::energy::single::{Single, SingleTerm, add_lane, check_single, gathered, lane_sum};
use caphy_core::array::Out;
use caphy_core::material::{MaterialReal, MembraneBlock};
use caphy_core::{Error, Result, simd_kernel};

/// Triangles that travel through the material in one call.
const BATCH: usize = 256;

impl SingleTerm for Strain<f64> {
    fn add_single(&self, pose: &Single<'_>, weight: f64, mut gradient: Option<&mut [f64]>) -> Result<f64> {
        pose.check("strain", self.vertex_count, gradient.as_deref())?;
        let mut green = vec![0.0; 3 * BATCH];
        let mut deformation = vec![0.0; 6 * BATCH];
        let mut density = vec![0.0; BATCH];
        let mut stress = vec![0.0; 3 * BATCH];
        let mut energy = [0.0; MAX_LANES];
        for (b, batch) in self.triangles.chunks(BATCH).enumerate() {
            let n = batch.len();
            let (green, stress, density) = (&mut green[..3 * n], &mut stress[..3 * n], &mut density[..n]);
            measure(batch, pose.positions, green, &mut deformation);
            if let Some(held) = &self.held {
                linearised(&held[b * BATCH..][..n], green, density, stress);
            } else {
                let mut block = MembraneBlock::new(n, green);
                block.energy = Out::from(&mut *density);
                if gradient.is_some() {
                    block.stress = Out::from(&mut *stress);
                }
                f64::membrane(&*self.material, &mut block).map_err(|e| locate(e, b, n))?;
            }
            sum(batch, weight, density, &mut energy);
            if let Some(gradient) = gradient.as_deref_mut() {
                scatter(batch, weight, &deformation, stress, gradient);
            }
        }
        check_single("strain", pose.positions, lane_sum(&energy))
    }
}

/// Says where a strain was that the material refused.
fn locate(error: Error, batch: usize, size: usize) -> Error {
    let Error::NonFinite { what, index, value } = error else { return error };
    Error::numerics(
        "energy `strain`",
        format!("{what} is {value} at triangle {}", batch * BATCH + index % size.max(1)),
        "go back to the last good state with a smaller step, and check that the template is in metres",
    )
}

simd_kernel! {
    /// F (Eq. 3) to `deformation` `[group][Fu xyz, Fv xyz][lane]`, G (Eq. 4) to `green` `[3][triangle]`.
    fn measure<T>(batch: &[Triangle<T>], x: &[T], green: &mut [T], deformation: &mut [T]) {
        let lanes = T::LANES;
        debug_assert!(CHUNK.is_multiple_of(lanes) && batch.len().is_multiple_of(lanes));
        let n = batch.len();
        let half = T::of(0.5);
        for (g, group) in batch.chunks_exact(lanes).enumerate() {
            let a = gathered(group, x, |t| t.vertices[0]);
            let b = gathered(group, x, |t| t.vertices[1]);
            let c = gathered(group, x, |t| t.vertices[2]);
            let mut m = [T::zero(); 4 * MAX_LANES];
            for (l, t) in group.iter().enumerate() {
                for k in 0..4 {
                    m[k * lanes + l] = t.dm_inverse[k];
                }
            }
            let f = &mut deformation[g * 6 * lanes..][..6 * lanes];
            let mut strain = [T::zero(); 3 * MAX_LANES];
            for l in 0..lanes {
                let (m00, m01, m10, m11) = (m[l], m[lanes + l], m[2 * lanes + l], m[3 * lanes + l]);
                let (mut uu, mut vv, mut uv) = (T::zero(), T::zero(), T::zero());
                for k in 0..3 {
                    let i = k * lanes + l;
                    let (d1, d2) = (b[i] - a[i], c[i] - a[i]);
                    let (fu, fv) = (d1 * m00 + d2 * m10, d1 * m01 + d2 * m11);
                    uu += fu * fu;
                    vv += fv * fv;
                    uv += fu * fv;
                    f[i] = fu;
                    f[3 * lanes + i] = fv;
                }
                strain[l] = half * (uu - T::one());
                strain[lanes + l] = half * (vv - T::one());
                strain[2 * lanes + l] = half * uv;
            }
            for k in 0..3 {
                green[k * n + g * lanes..][..lanes].copy_from_slice(&strain[k * lanes..][..lanes]);
            }
        }
    }
}

simd_kernel! {
    /// ψ and S of held stiffness.
    fn linearised<T>(held: &[Held<T>], green: &[T], density: &mut [T], stress: &mut [T]) {
        let n = held.len();
        for (i, held) in held.iter().enumerate() {
            let (energy, s) = held.at([green[i], green[n + i], green[2 * n + i]]);
            density[i] = energy;
            stress[i] = s[0];
            stress[n + i] = s[1];
            stress[2 * n + i] = s[2];
        }
    }
}

simd_kernel! {
    /// Adds Σ A ψ per lane.
    fn sum<T>(batch: &[Triangle<T>], weight: T, density: &[T], energy: &mut [f64; MAX_LANES]) {
        for (group, psi) in batch.chunks_exact(T::LANES).zip(density.chunks_exact(T::LANES)) {
            for l in 0..T::LANES {
                energy[l] += (weight * group[l].area * psi[l]).to_f64();
            }
        }
    }
}

simd_kernel! {
    /// Adds the gradient A P D_m⁻ᵀ with P = F S to the three corners.
    fn scatter<T>(batch: &[Triangle<T>], weight: T, deformation: &[T], stress: &[T], gradient: &mut [T]) {
        let lanes = T::LANES;
        let n = batch.len();
        for (g, group) in batch.chunks_exact(lanes).enumerate() {
            let mut m = [T::zero(); 4 * MAX_LANES];
            for (l, t) in group.iter().enumerate() {
                let area = weight * t.area;
                for k in 0..4 {
                    m[k * lanes + l] = area * t.dm_inverse[k];
                }
            }
            let f = &deformation[g * 6 * lanes..][..6 * lanes];
            let suu = &stress[g * lanes..][..lanes];
            let svv = &stress[n + g * lanes..][..lanes];
            let suv = &stress[2 * n + g * lanes..][..lanes];
            let mut g0 = [T::zero(); 3 * MAX_LANES];
            let mut g1 = [T::zero(); 3 * MAX_LANES];
            let mut g2 = [T::zero(); 3 * MAX_LANES];
            for l in 0..lanes {
                let (m00, m01, m10, m11) = (m[l], m[lanes + l], m[2 * lanes + l], m[3 * lanes + l]);
                for k in 0..3 {
                    let i = k * lanes + l;
                    let (fu, fv) = (f[i], f[3 * lanes + i]);
                    let pu = fu * suu[l] + fv * suv[l];
                    let pv = fu * suv[l] + fv * svv[l];
                    let (d1, d2) = (pu * m00 + pv * m01, pu * m10 + pv * m11);
                    g1[i] = d1;
                    g2[i] = d2;
                    g0[i] = -(d1 + d2);
                }
            }
            for (l, t) in group.iter().enumerate() {
                let [a, b, c] = t.vertices;
                add_lane(gradient, a, &g0, l);
                add_lane(gradient, b, &g1, l);
                add_lane(gradient, c, &g2, l);
            }
        }
    }
}
