//! Attachment: springs from held vertices (a waistband, straps) to where the body carries them.

use super::single::{Single, SingleTerm, check_single};
use super::tangent::{EnergyTangent, Stencil, Tangent, isotropic};
use super::{EnergyTerm, MAX_LANES, State, add_blocks, add_row, check_same_frames, needed, row};
use crate::GarmentRest;
use caphy_core::lanes::Frames;
use caphy_core::material::MaterialReal;
use caphy_core::{Error, Result, simd_kernel};

/// E = ½ κ Σ ℓ_v |x_v − target_v|² over all held sets of a garment, ℓ_v the boundary length that a vertex stands for.
///
/// Nothing else holds trousers up. κ [N/m²] is a force per metre of boundary and metre of slip, so that template resolution
/// does not change it. Targets come with the state: the skinned positions of [`Attachment::vertices`], in their order.
pub struct Attachment<T> {
    vertices: Vec<u32>,
    stiffness: Vec<T>,
    vertex_count: usize,
}

impl<T: MaterialReal> Attachment<T> {
    /// Stiffness κ [N/m²]. A waistband of 1 m that carries 0.5 kg slips by 5 / κ metres: 5 mm for 1000 N/m².
    pub fn new(rest: &GarmentRest, stiffness: f64) -> Self {
        let vertices = rest.held.iter().flat_map(|set| set.vertices.iter().copied()).collect();
        let stiffness = rest.held.iter().flat_map(|set| &set.lengths).map(|l| T::of(stiffness * l)).collect();
        Self { vertices, stiffness, vertex_count: rest.vertex_count() }
    }
    /// Springs of one's own: stiffness [N/m] per vertex, for known scan points, pins, or the momentum of a time step.
    ///
    /// # Errors
    /// [`Error::Length`], [`Error::Mesh`] for a vertex that the garment does not have, [`Error::Parameter`] for a stiffness that
    /// is negative or not finite.
    pub fn springs(vertices: &[u32], stiffness: &[f64], vertex_count: usize) -> Result<Self> {
        Error::check_length("stiffness of springs, one per vertex", vertices.len(), stiffness.len())?;
        if let Some(v) = vertices.iter().find(|&&v| v as usize >= vertex_count) {
            let problem = format!("has a spring but there are {vertex_count} vertices");
            return Err(Error::mesh("garment", format!("vertex {v}"), problem, "attach vertices of this garment"));
        }
        if let Some(&value) = stiffness.iter().find(|k| !(**k >= 0.0 && k.is_finite())) {
            let (lower, upper) = (0.0, f64::INFINITY);
            return Err(Error::Parameter { name: "spring stiffness".into(), value, lower, upper, unit: "N/m".into() });
        }
        let stiffness = stiffness.iter().map(|&k| T::of(k)).collect();
        Ok(Self { vertices: vertices.to_vec(), stiffness, vertex_count })
    }
    /// Garment vertices that are held, in the order of the targets.
    pub fn vertices(&self) -> &[u32] {
        &self.vertices
    }
}

impl<T: MaterialReal> EnergyTerm<T> for Attachment<T> {
    fn name(&self) -> &'static str {
        "attachment"
    }
    fn add(
        &self,
        state: &State<'_, T>,
        weight: f64,
        energy: &mut [f64],
        gradient: Option<&mut Frames<T>>,
    ) -> Result<()> {
        let x = state.positions;
        if self.vertices.is_empty() {
            return Ok(());
        }
        let targets = needed("attachment", "targets of the held vertices", state.targets)?;
        check_same_frames("targets of attachment", x, targets)?;
        Error::check_length("targets of attachment", self.vertices.len(), targets.vertices())?;
        add_blocks("attachment", self.vertex_count, x, energy, gradient, |b, part| {
            let mut energy = [0.0; MAX_LANES];
            let mut none = [];
            let (wanted, part) = part.map_or((false, &mut none[..]), |part| (true, part));
            let held = (&self.vertices[..], &self.stiffness[..]);
            springs(held, T::of(weight), x.block(b), targets.block(b), &mut energy, wanted, part);
            Ok(energy)
        })
    }
}

impl SingleTerm for Attachment<f64> {
    fn add_single(&self, pose: &Single<'_>, weight: f64, mut gradient: Option<&mut [f64]>) -> Result<f64> {
        pose.check("attachment", self.vertex_count, gradient.as_deref())?;
        if self.vertices.is_empty() {
            return Ok(0.0);
        }
        let targets = needed("attachment", "targets of the held vertices", pose.targets)?;
        Error::check_length("targets of attachment", 3 * self.vertices.len(), targets.len())?;
        let mut energy = 0.0;
        for ((&v, k), target) in self.vertices.iter().zip(&self.stiffness).zip(targets.chunks_exact(3)) {
            let (k, at) = (weight * k, 3 * v as usize);
            let r: [f64; 3] = std::array::from_fn(|axis| pose.positions[at + axis] - target[axis]);
            energy += 0.5 * k * (r[0] * r[0] + r[1] * r[1] + r[2] * r[2]);
            if let Some(gradient) = gradient.as_deref_mut() {
                (0..3).for_each(|axis| gradient[at + axis] += k * r[axis]);
            }
        }
        check_single("attachment", pose.positions, energy)
    }
}

impl EnergyTangent for Attachment<f64> {
    fn stencil(&self) -> Stencil {
        Stencil { width: 1, vertices: self.vertices.clone() }
    }
    fn tangents(&self, _: &State<'_, f64>, weight: f64, _: Tangent, blocks: &mut [f64]) -> Result<()> {
        Error::check_length("second derivatives of attachment", 9 * self.vertices.len(), blocks.len())?;
        isotropic(self.stiffness.iter().map(|k| weight * k), blocks);
        Ok(())
    }
}

simd_kernel! {
    /// Adds Σ ½ k |x − target|² per lane and its gradient.
    fn springs<T>(
        held: (&[u32], &[T]),
        weight: T,
        x: &[T],
        targets: &[T],
        energy: &mut [f64; MAX_LANES],
        wanted: bool,
        gradient: &mut [T],
    ) {
        let lanes = T::LANES;
        let half = T::of(0.5);
        for (i, (&v, &k)) in held.0.iter().zip(held.1).enumerate() {
            let k = weight * k;
            let (x, t) = (row(x, v), row(targets, i as u32));
            let mut g = [T::zero(); 3 * MAX_LANES];
            for l in 0..lanes {
                let mut square = T::zero();
                for axis in 0..3 {
                    let i = axis * lanes + l;
                    let r = x[i] - t[i];
                    square += r * r;
                    g[i] = k * r;
                }
                energy[l] += (half * k * square).to_f64();
            }
            if wanted {
                add_row(gradient, v, &g);
            }
        }
    }
}
