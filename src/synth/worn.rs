//! Clothes at rest in one pose: the lower garment first, the upper one over it.

use super::Person;
use crate::config::SyntheticConfig;
use crate::garment::FittedGarment;
use crate::physics::{GRAVITY, WAISTBAND};
use crate::scene::Scene;
use crate::simulate::{SimulationOptions, Steps, simulate_layers};
use caphy_core::pose::Pose;
use caphy_core::{Result, Vec3};
use caphy_garment::energy::{ContactOptions, LayeringOrder, RestAngle};
use caphy_garment::solver::{Forces, SolveReport, SolverSettings};
use serde::{Deserialize, Serialize};

/// Clothes at rest in one pose.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Worn {
    /// Vertices of each garment [m], upper first.
    pub shapes: Vec<Vec<Vec3>>,
    /// How they were found.
    pub reports: Vec<SolveReport>,
}

/// The same as training's default.
const CONTACT: ContactOptions = ContactOptions { margin: 4e-3, allowed_depth: 1e-3, load: 50.0 };

/// Brings all clothes to rest in a pose, each from where skinning puts it.
///
/// # Errors
/// As [`simulate_layers`].
pub fn wear(config: &SyntheticConfig, person: &Person, scene: &Scene, pose: &Pose) -> Result<Worn> {
    let track = scene.track(std::slice::from_ref(pose))?;
    let options = SimulationOptions {
        steps: Steps::QuasiStatic,
        // A rate is of no importance at rest.
        fps: 30.0,
        forces: Forces {
            gravity: GRAVITY,
            rest_angle: RestAngle::Template,
            contact: CONTACT,
            attachment: WAISTBAND,
            ..Forces::default()
        },
        settings: SolverSettings {
            tolerance_n: config.tolerance_n,
            friction: config.friction,
            ..SolverSettings::default()
        },
        disturbance: None,
    };
    let Person { garments, materials, .. } = person;
    let contact = |garment: &FittedGarment| scene.contact(garment);
    let done = simulate_layers(garments, materials, LayeringOrder::Over, &track, &contact, &options, &|_, _| {})?;
    let (mut shapes, mut reports) = (Vec::new(), Vec::new());
    for mut simulation in done {
        shapes.push(simulation.frames.remove(0));
        reports.push(simulation.reports.remove(0));
    }
    Ok(Worn { shapes, reports })
}
