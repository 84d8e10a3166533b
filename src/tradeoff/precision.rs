//! Single against double precision where both exist: the energies. Training is single, the solver double; neither has a switch.

use super::cost::Stopwatch;
use super::yardstick::{Yardstick, fabric, scene_of};
use crate::config::Config;
use crate::files::ProjectFiles;
use crate::garment::FittedGarment;
use crate::physics::{Dynamics, Physics};
use crate::scene::Scene;
use crate::stage::preprocess::Subject;
use crate::track::BodyTrack;
use caphy_core::lanes::Frames;
use caphy_core::material::MaterialReal;
use caphy_core::{Result, Vec3};
use caphy_garment::energy::{BodyState, State};
use serde::{Deserialize, Serialize};

/// Energies and their gradient on one garment's shapes of the motion, skinned.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Precision {
    /// The garment.
    pub garment: String,
    /// Processor time of energies and gradient of a frame [ms], in single and in double precision.
    pub frame_ms: [f64; 2],
    /// Relative difference of the energy.
    pub energy: f64,
    /// Largest difference of a force over the largest force.
    pub force: f64,
}

/// Least processor time over which a time is measured [s].
const LEAST: f64 = 0.3;

/// For each garment.
pub(super) fn measure(
    config: &Config,
    files: &ProjectFiles,
    subject: &Subject,
    yardstick: &Yardstick,
) -> Result<Vec<Precision>> {
    let scene = scene_of(files, config, subject)?;
    let poses = yardstick.motions[0].judged();
    let one = |garment: &FittedGarment| {
        let track = scene.track(poses)?;
        let shapes = track.transforms.iter().map(|t| garment.skinned(t)).collect::<Result<Vec<_>>>()?;
        let single = side::<f32>(config, &scene, garment, &track, &shapes)?;
        let double = side::<f64>(config, &scene, garment, &track, &shapes)?;
        let largest = double.forces.iter().map(Vec3::norm).fold(f64::MIN_POSITIVE, f64::max);
        let differences = single.forces.iter().zip(&double.forces).map(|(a, b)| (a - b).norm());
        Ok(Precision {
            garment: garment.kind.to_string(),
            frame_ms: [single.frame_ms, double.frame_ms],
            energy: (single.energy - double.energy).abs() / double.energy.abs().max(f64::MIN_POSITIVE),
            force: differences.fold(0.0, f64::max) / largest,
        })
    };
    subject.garments.iter().map(one).collect()
}

struct Side {
    frame_ms: f64,
    energy: f64,
    forces: Vec<Vec3>,
}

/// Strain, bending, gravity, contact in one precision; without the waistband, whose targets are always double.
fn side<T: MaterialReal>(
    config: &Config,
    scene: &Scene,
    garment: &FittedGarment,
    track: &BodyTrack,
    shapes: &[Vec<Vec3>],
) -> Result<Side> {
    let material = fabric(config, garment)?;
    let mut rest = garment.rest(&*material)?;
    rest.held.clear();
    let physics = Physics::<T>::new(&rest, material, &config.train.contact, config.motion.fps, &config.train.weights)?;
    // The same frames in both: whole registers of either where there are as many.
    let frames = [16, 8, 1].into_iter().find(|&n| n <= shapes.len()).unwrap_or(0);
    let lanes = T::LANES.min(frames).max(1);
    let vertices = garment.mesh.vertices.len();
    let mut positions = Frames::<T>::zeros(frames / lanes, vertices, lanes);
    for (frame, shape) in shapes[..frames].iter().enumerate() {
        positions.set_frame(frame / lanes, frame % lanes, shape)?;
    }
    let ids: Vec<usize> = (0..frames).collect();
    let (body, normals) = track.gather::<T>(&ids, lanes)?;
    let nearest = scene.contact(garment)?.nearest(&positions, &body)?;
    let body = BodyState { positions: &body, normals: &normals, nearest: Some(&nearest) };
    let state = State::new(&positions).with_body(body);
    let watch = Stopwatch::start();
    let (mut rounds, mut energy) = (0usize, 0.0);
    let mut gradient = Frames::<T>::zeros(frames / lanes, vertices, lanes);
    while rounds == 0 || watch.read().processor_s < LEAST {
        for _ in 0..16 {
            gradient.data_mut().fill(T::of(0.0));
            energy = physics.add(&state, Dynamics::Static, 1.0, Some(&mut gradient))?.iter().map(|e| e.1).sum();
            rounds += 1;
        }
    }
    let frame_ms = 1e3 * watch.read().processor_s / (rounds * frames.max(1)) as f64;
    let forces = (0..vertices).map(|v| gradient.get(0, 0, v)).collect();
    Ok(Side { frame_ms, energy, forces })
}
