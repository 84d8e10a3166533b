//! What shapes of a garment on a body are worth by the energies that it is trained with, whoever made them.

use crate::config::TrainConfig;
use crate::garment::FittedGarment;
use crate::inference::{clearance, contacts};
use crate::physics::{Dynamics, Physics, TermEnergies};
use crate::scene::Scene;
use crate::track::BodyTrack;
use caphy_core::lanes::Frames;
use caphy_core::material::MaterialModel;
use caphy_core::{Result, Vec3};
use caphy_garment::GarmentRest;
use caphy_garment::contact::ContactMap;
use caphy_garment::energy::{BodyState, State};
use caphy_garment::skinning::Skinner;
use std::sync::Arc;

/// Measures one garment.
pub(crate) struct Judge<'a> {
    garment: &'a FittedGarment,
    /// The garment at rest.
    pub(crate) rest: GarmentRest,
    physics: Physics<f64>,
    contact: ContactMap,
    holder: Skinner<f64>,
}

impl<'a> Judge<'a> {
    /// A garment made of a material, by the energies of a training in its end.
    ///
    /// # Errors
    /// What the garment is refused for.
    pub(crate) fn new(
        scene: &Scene,
        garment: &'a FittedGarment,
        material: Arc<dyn MaterialModel>,
        fps: f64,
        train: &TrainConfig,
    ) -> Result<Self> {
        let rest = garment.rest(&*material)?;
        let physics = Physics::<f64>::new(&rest, material, &train.contact, fps, &train.weights)?;
        let skinner = Skinner::<f64>::new(&garment.mesh.vertices, &garment.weights)?;
        let holder = skinner.select(physics.attachment.vertices())?;
        Ok(Self { garment, rest, contact: scene.contact(garment)?, holder, physics })
    }
    /// Energies of one shape [m] in one frame, without inertia [J].
    ///
    /// # Errors
    /// [`Error::Length`](caphy_core::Error::Length) for another number of vertices.
    pub(crate) fn energies(&self, track: &BodyTrack, frame: usize, shape: &[Vec3]) -> Result<TermEnergies> {
        let mut positions = Frames::<f64>::zeros(1, shape.len(), 1);
        positions.set_frame(0, 0, shape)?;
        let (body, normals) = track.gather::<f64>(&[frame], 1)?;
        let nearest = self.contact.nearest(&positions, &body)?;
        let mut targets = Frames::zeros(1, self.holder.vertex_count(), 1);
        self.holder.forward(&self.holder.joint_frames(&track.transforms(&[frame]), 1)?, None, &mut targets)?;
        let state = State::new(&positions)
            .with_body(BodyState { positions: &body, normals: &normals, nearest: Some(&nearest) })
            .with_targets(&targets);
        self.physics.add(&state, Dynamics::Static, 1.0, None)
    }
    /// Mean energies per term of a shape per frame [J].
    ///
    /// # Errors
    /// As [`Judge::energies`].
    pub(crate) fn mean_energies(&self, track: &BodyTrack, shapes: &[Vec<Vec3>]) -> Result<Vec<(String, f64)>> {
        let mut sums: Vec<(String, f64)> = Vec::new();
        for (frame, shape) in shapes.iter().enumerate() {
            for (i, (name, energy)) in self.energies(track, frame, shape)?.into_iter().enumerate() {
                if i == sums.len() {
                    sums.push((name.to_string(), 0.0));
                }
                sums[i].1 += energy / shapes.len() as f64;
            }
        }
        Ok(sums)
    }
    /// Signed distances to the body over all frames [m].
    ///
    /// # Errors
    /// As [`Judge::energies`].
    pub(crate) fn clearances(&self, track: &BodyTrack, shapes: &[Vec<Vec3>]) -> Result<Vec<f64>> {
        let mut all = Vec::new();
        for (frame, shape) in shapes.iter().enumerate() {
            all.extend(clearance(shape, &contacts(&self.contact, track, frame, shape)?));
        }
        Ok(all)
    }
    /// The garment as skinning alone puts it on [m], shape [frame][vertex].
    ///
    /// # Errors
    /// As [`FittedGarment::skinned`].
    pub(crate) fn skinned(&self, track: &BodyTrack) -> Result<Vec<Vec<Vec3>>> {
        (0..track.len()).map(|f| self.garment.skinned(track.transforms(&[f])[0])).collect()
    }
    /// Vertices at the free ends: the hem, or the ends of the legs.
    pub(crate) fn hem(&self) -> Vec<u32> {
        let named = |wanted: &str| {
            self.garment.loops.iter().filter(|l| l.name.starts_with(wanted)).flat_map(|l| l.vertices.clone()).collect()
        };
        let hem: Vec<u32> = named("hem");
        if hem.is_empty() { named("cuff") } else { hem }
    }
}
