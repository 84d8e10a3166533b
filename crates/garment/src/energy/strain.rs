//! Strain energy (Eqs. 3-5): Σ A ψ(G) over triangles, with the material's ψ and stress.

mod single;
mod tangent;

use super::{CHUNK, EnergyTerm, MAX_LANES, State, add_blocks, add_row, pad_to_chunks, row};
use crate::GarmentRest;
use caphy_core::array::Out;
use caphy_core::lanes::Frames;
use caphy_core::material::{MaterialModel, MaterialReal, MembraneBlock};
use caphy_core::{Error, Real, Result, simd_kernel};
use std::sync::Arc;

/// A triangle at rest; `area` is 0 for padding.
#[derive(Debug, Clone, Copy)]
struct Triangle<T> {
    vertices: [u32; 3],
    dm_inverse: [T; 4],
    area: T,
}

/// A triangle's material linearised about a strain: ψ, S and dS/dG with held stiffness.
#[derive(Debug, Clone, Copy)]
struct Held<T> {
    green: [T; 3],
    energy: T,
    stress: [T; 3],
    slope: [T; 9],
}

impl<T: Real> Held<T> {
    /// ψ and S at another strain. ψ integrates S: the shear entry counts twice.
    #[inline(always)]
    fn at(&self, green: [T; 3]) -> (T, [T; 3]) {
        let d = [green[0] - self.green[0], green[1] - self.green[1], green[2] - self.green[2]];
        let c = &self.slope;
        let change = [
            c[0] * d[0] + c[1] * d[1] + c[2] * d[2],
            c[3] * d[0] + c[4] * d[1] + c[5] * d[2],
            c[6] * d[0] + c[7] * d[1] + c[8] * d[2],
        ];
        let s = self.stress;
        let half = T::of(0.5);
        let mean = [s[0] + half * change[0], s[1] + half * change[1], s[2] + half * change[2]];
        let energy = self.energy + mean[0] * d[0] + mean[1] * d[1] + (mean[2] + mean[2]) * d[2];
        (energy, [s[0] + change[0], s[1] + change[1], s[2] + change[2]])
    }
}

/// Strain energy of a garment made of one material.
///
/// The gradient uses the material's stress: with frozen stiffness it is the force of ARCSim, not the derivative of the
/// energy (`stiffness_frozen` of [`caphy_core::material::MaterialDescription`]).
pub struct Strain<T> {
    triangles: Vec<Triangle<T>>,
    /// Triangles that are not padding.
    count: usize,
    vertex_count: usize,
    material: Arc<dyn MaterialModel>,
    /// Per triangle while the stiffness is held.
    held: Option<Vec<Held<T>>>,
}

impl<T: MaterialReal> Strain<T> {
    /// From a rest state; areas are the template's, D_m the material layout's.
    pub fn new(rest: &GarmentRest, material: Arc<dyn MaterialModel>) -> Self {
        let mut triangles: Vec<_> = (0..rest.faces().len())
            .map(|f| Triangle {
                vertices: rest.faces()[f],
                dm_inverse: rest.dm_inverse[f].map(T::of),
                area: T::of(rest.areas[f]),
            })
            .collect();
        let count = triangles.len();
        pad_to_chunks(&mut triangles, |t| t.area = T::zero());
        Self { triangles, count, vertex_count: rest.vertex_count(), material, held: None }
    }
    /// The same garment of another material; nothing is held.
    pub fn set_material(&mut self, material: Arc<dyn MaterialModel>) {
        self.material = material;
        self.held = None;
    }

    fn block(&self, step: usize, x: &[T], weight: f64, mut gradient: Option<&mut [T]>) -> Result<[f64; MAX_LANES]> {
        let count = CHUNK * T::LANES;
        let mut green = vec![T::zero(); 3 * count];
        let mut deformation = vec![T::zero(); 6 * count];
        let mut density = vec![T::zero(); count];
        let mut stress = vec![T::zero(); 3 * count];
        let mut energy = [0.0; MAX_LANES];
        for (c, chunk) in self.triangles.chunks_exact(CHUNK).enumerate() {
            measure(chunk, x, &mut green, &mut deformation);
            if let Some(held) = &self.held {
                linearised(&held[c * CHUNK..][..CHUNK], &green, &mut density, &mut stress);
            } else {
                let mut block = MembraneBlock::new(count, &green);
                block.energy = Out::from(&mut density[..]);
                if gradient.is_some() {
                    block.stress = Out::from(&mut stress[..]);
                }
                T::membrane(&*self.material, &mut block).map_err(|e| self.locate(e, step, c))?;
            }
            sum(chunk, T::of(weight), &density, &mut energy);
            if let Some(gradient) = gradient.as_deref_mut() {
                scatter(chunk, T::of(weight), &deformation, &stress, gradient);
            }
        }
        Ok(energy)
    }
    /// Says where a strain was that the material refused.
    fn locate(&self, error: Error, step: usize, chunk: usize) -> Error {
        let Error::NonFinite { what, index, value } = error else { return error };
        let element = index % (CHUNK * T::LANES);
        let (triangle, window) = (chunk * CHUNK + element / T::LANES, element % T::LANES);
        Error::numerics(
            "energy `strain`",
            format!("{what} is {value} at triangle {triangle} of step {step}, window {window}"),
            "go back to the last good state with a smaller step, and check that the template is in metres",
        )
    }
}

impl<T: MaterialReal> EnergyTerm<T> for Strain<T> {
    fn name(&self) -> &'static str {
        "strain"
    }
    fn add(
        &self,
        state: &State<'_, T>,
        weight: f64,
        energy: &mut [f64],
        gradient: Option<&mut Frames<T>>,
    ) -> Result<()> {
        add_blocks("strain", self.vertex_count, state.positions, energy, gradient, |b, part| {
            self.block(b, state.positions.block(b), weight, part)
        })
    }
}

simd_kernel! {
    /// F = D_s D_m⁻¹ (Eq. 3) to `deformation` `[triangle][Fu xyz, Fv xyz][lane]`, G = ½(FᵀF − I) (Eq. 4) to `green` `[3][triangle][lane]`.
    fn measure<T>(chunk: &[Triangle<T>], x: &[T], green: &mut [T], deformation: &mut [T]) {
        let lanes = T::LANES;
        let count = CHUNK * lanes;
        let half = T::of(0.5);
        for (e, triangle) in chunk.iter().enumerate() {
            let [a, b, c] = triangle.vertices;
            let (a, b, c) = (row(x, a), row(x, b), row(x, c));
            let [m00, m01, m10, m11] = triangle.dm_inverse;
            let f = &mut deformation[e * 6 * lanes..][..6 * lanes];
            let mut strain = [T::zero(); 3 * MAX_LANES];
            for l in 0..lanes {
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
                green[k * count + e * lanes..][..lanes].copy_from_slice(&strain[k * lanes..][..lanes]);
            }
        }
    }
}

simd_kernel! {
    /// ψ and S of held stiffness.
    fn linearised<T>(held: &[Held<T>], green: &[T], density: &mut [T], stress: &mut [T]) {
        let lanes = T::LANES;
        let count = CHUNK * lanes;
        for (e, held) in held.iter().enumerate() {
            for i in e * lanes..(e + 1) * lanes {
                let (energy, s) = held.at([green[i], green[count + i], green[2 * count + i]]);
                density[i] = energy;
                stress[i] = s[0];
                stress[count + i] = s[1];
                stress[2 * count + i] = s[2];
            }
        }
    }
}

simd_kernel! {
    /// Adds Σ A ψ per lane: in T within a chunk, in f64 across chunks.
    fn sum<T>(chunk: &[Triangle<T>], weight: T, density: &[T], energy: &mut [f64; MAX_LANES]) {
        let mut total = [T::zero(); MAX_LANES];
        for (triangle, psi) in chunk.iter().zip(density.chunks_exact(T::LANES)) {
            for l in 0..T::LANES {
                total[l] += triangle.area * psi[l];
            }
        }
        for l in 0..T::LANES {
            energy[l] += (weight * total[l]).to_f64();
        }
    }
}

simd_kernel! {
    /// Adds the gradient A P D_m⁻ᵀ with P = F S to the three corners.
    fn scatter<T>(chunk: &[Triangle<T>], weight: T, deformation: &[T], stress: &[T], gradient: &mut [T]) {
        let lanes = T::LANES;
        let count = CHUNK * lanes;
        for (e, triangle) in chunk.iter().enumerate() {
            let area = weight * triangle.area;
            let [m00, m01, m10, m11] = triangle.dm_inverse.map(|m| area * m);
            let f = &deformation[e * 6 * lanes..][..6 * lanes];
            let suu = &stress[e * lanes..][..lanes];
            let svv = &stress[count + e * lanes..][..lanes];
            let suv = &stress[2 * count + e * lanes..][..lanes];
            let mut g0 = [T::zero(); 3 * MAX_LANES];
            let mut g1 = [T::zero(); 3 * MAX_LANES];
            let mut g2 = [T::zero(); 3 * MAX_LANES];
            for l in 0..lanes {
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
            let [a, b, c] = triangle.vertices;
            add_row(gradient, a, &g0);
            add_row(gradient, b, &g1);
            add_row(gradient, c, &g2);
        }
    }
}
