//! A garment with everything that pulls at it: Eq. 6 term by term, with the configured weights.

mod fault;

pub use fault::PhysicsFault;

use crate::config::{TermWeights, TrainConfig};
use crate::trainer::StageClock;
use caphy_core::lanes::Frames;
use caphy_core::material::{MaterialModel, MaterialReal};
use caphy_core::{Result, Vec3};
use caphy_garment::GarmentRest;
use caphy_garment::energy::{
    Attachment, Bending, Collision, ContactOptions, EnergyTerm, Gravity, Inertia, InertiaRule, RestAngle, State, Strain,
};
use caphy_garment::solver::Forces;
use std::sync::Arc;

/// Acceleration of free fall [m/s²].
pub const GRAVITY: Vec3 = Vec3::new(0.0, -9.81, 0.0);
/// Stiffness that holds a waistband [N/m²]: a metre of waistband with half a kilogram of trousers slips by 5 mm.
pub const WAISTBAND: f64 = 1000.0;

/// The terms of one garment, except those that need scans or the other garment.
pub struct Physics<T> {
    strain: Strain<T>,
    bending: Bending<T>,
    gravity: Gravity<T>,
    inertia: Inertia<T>,
    collision: Collision<T>,
    /// Springs of the waistband: their vertices say which targets a state needs.
    pub attachment: Attachment<T>,
    material: Arc<dyn MaterialModel>,
    weights: TermWeights,
    clock: StageClock,
    /// Share of training that is done, for the weights' schedules.
    share: f64,
}

/// What a batch asks for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Dynamics {
    /// Consecutive frames in blocks: inertia counts.
    Moving,
    /// Unrelated poses: no inertia.
    Static,
}

/// Energy per term, J per frame on average over the batch (inertia: per transition), unweighted by λ except contact and
/// attachment, whose stiffness is their own.
pub type TermEnergies = Vec<(&'static str, f64)>;

impl<T: MaterialReal> Physics<T> {
    /// All terms of a garment made of a material; `fps` sets the time step of inertia. Weights are those at the end of training
    /// until [`Physics::set_share`] says otherwise.
    pub fn new(
        rest: &GarmentRest,
        material: Arc<dyn MaterialModel>,
        contact: &ContactOptions,
        fps: f64,
        weights: &TermWeights,
    ) -> Result<Self> {
        Ok(Self {
            strain: Strain::new(rest, material.clone()),
            bending: Bending::new(rest, material.clone(), RestAngle::Template),
            gravity: Gravity::new(rest, GRAVITY),
            inertia: Inertia::new(rest, 1.0 / fps, InertiaRule::KnownVelocity)?,
            collision: Collision::new(rest, contact)?,
            attachment: Attachment::new(rest, WAISTBAND),
            material,
            weights: weights.clone(),
            clock: StageClock::off(),
            share: 1.0,
        })
    }
    /// Times each term by its name from now on.
    pub fn set_clock(&mut self, clock: StageClock) {
        self.clock = clock;
    }
    /// Sets the share of training that is done.
    pub fn set_share(&mut self, share: f64) {
        self.share = share;
    }
    /// Whether contact with the body counts at this share of training: else nobody needs to pose it.
    pub fn meets_body(&self) -> bool {
        self.weights.collision.at(self.share) != 0.0
    }
    /// λ3d [J/m²] at this share of training, for who adds the scan term.
    pub fn scan_weight(&self) -> f64 {
        self.weights.scan.at(self.share)
    }
    /// The same garment made of another material.
    pub fn set_material(&mut self, material: Arc<dyn MaterialModel>) {
        self.strain.set_material(material.clone());
        self.bending.set_material(material.clone());
        self.material = material;
    }
    fn terms(&self) -> [(&dyn EnergyTerm<T>, f64); 6] {
        let w = &self.weights;
        [
            (&self.strain, w.strain.at(self.share)),
            (&self.bending, w.bending.at(self.share)),
            (&self.gravity, w.gravity.at(self.share)),
            (&self.inertia, w.inertia.at(self.share)),
            (&self.collision, w.collision.at(self.share)),
            (&self.attachment, w.attachment.at(self.share)),
        ]
    }
    /// Strain plus bending energy summed over frames [J], unweighted: needs no body.
    pub fn elastic(&self, positions: &Frames<T>) -> Result<f64> {
        let state = State::new(positions);
        let mut energy = vec![0.0; positions.frames()];
        self.strain.add(&state, 1.0, &mut energy, None)?;
        self.bending.add(&state, 1.0, &mut energy, None)?;
        Ok(energy.iter().sum())
    }
    /// Adds `scale` times the gradient of the *sum* over frames (inertia: scaled so that a mean over transitions weighs like a
    /// mean over frames) and returns mean energies.
    pub fn add(
        &self,
        state: &State<'_, T>,
        dynamics: Dynamics,
        scale: f64,
        mut gradient: Option<&mut Frames<T>>,
    ) -> Result<TermEnergies> {
        let frames = state.positions.frames();
        let mut out = TermEnergies::new();
        for (term, weight) in self.terms() {
            if weight == 0.0 {
                continue;
            }
            let mut factor = weight * scale;
            let mut mean_of = frames;
            if term.name() == "inertia" {
                let transitions = self.inertia.transitions(state.positions.blocks(), state.past.is_some());
                let transitions = transitions * state.positions.lanes_used();
                if dynamics == Dynamics::Static || transitions == 0 {
                    continue;
                }
                factor *= frames as f64 / transitions as f64;
                mean_of = transitions;
            }
            let mut energy = vec![0.0; frames];
            self.clock.time(term.name(), || term.add(state, factor, &mut energy, gradient.as_deref_mut()))?;
            let sum: f64 = energy.iter().sum();
            let mean = if factor == 0.0 { 0.0 } else { sum / factor * weight / mean_of as f64 };
            out.push((term.name(), mean));
        }
        Ok(out)
    }
}

/// The reference solver's forces for the energies that nets are trained with in the end.
pub fn solver_forces(train: &TrainConfig) -> Forces {
    let w = &train.weights;
    Forces {
        gravity: GRAVITY,
        rest_angle: RestAngle::Template,
        contact: train.contact,
        attachment: WAISTBAND,
        weights: [&w.strain, &w.bending, &w.gravity, &w.collision, &w.attachment].map(|weight| weight.at(1.0)),
    }
}
