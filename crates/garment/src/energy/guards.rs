//! How often the guards of energies act: where a state is so far from cloth that it is answered as something milder.
//!
//! Guards change no regular state, and energy and gradient agree across them; a simulation or training in which they act all the
//! time has left what its energies mean.

use super::bending::is_needle;
use crate::GarmentRest;
use caphy_core::lanes::Frames;
use caphy_core::material::{MaterialModel, MaterialReal};
use caphy_core::strain_limit;
use serde::Serialize;

/// Activations over all frames of a batch.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct GuardCounts {
    /// Triangles whose strain the material draws back ([`caphy_core::strain_limit`]); `None` where it does not say its limit.
    pub strains: Option<usize>,
    /// Hinges with a face lower than a thousandth of the edge, or the other way round, which lose their bending energy.
    pub needles: usize,
    /// Vertices without a normal: none of their faces has an area, and what asks for their side is not pushed.
    pub sideless: usize,
}

impl GuardCounts {
    /// Activations in the present positions [m] of a garment.
    pub fn of<T: MaterialReal>(rest: &GarmentRest, material: &dyn MaterialModel, positions: &Frames<T>) -> Self {
        let limit = material.strain_limits().map(|limits| limits[usize::from(size_of::<T>() == 8)]);
        let mut counts = Self { strains: limit.map(|_| 0), needles: 0, sideless: 0 };
        for frame in 0..positions.frames() {
            let x = positions.frame(frame / positions.lanes_used(), frame % positions.lanes_used());
            if let (Some(count), Some(limit)) = (&mut counts.strains, limit) {
                *count +=
                    (0..rest.faces().len()).filter(|&f| strain_limit::beyond(limit, &rest.green(f, &x)) > 0).count();
            }
            counts.needles += rest.hinges.iter().filter(|h| is_needle(h.vertices.map(|v| x[v as usize]))).count();
            let mut normals = vec![caphy_core::Vec3::zeros(); x.len()];
            for face in rest.faces() {
                let [a, b, c] = face.map(|v| x[v as usize]);
                let n = (b - a).cross(&(c - a));
                face.iter().for_each(|&v| normals[v as usize] += n);
            }
            counts.sideless += normals.iter().filter(|n| n.norm_squared() == 0.0).count();
        }
        counts
    }
    /// All of them.
    pub fn total(&self) -> usize {
        self.strains.unwrap_or(0) + self.needles + self.sideless
    }
}
