//! How much memory training will take, said before it starts.

use crate::config::TrainConfig;
use caphy_core::Real;
use caphy_core::lanes::Frames;
use caphy_core::net::NetManifest;
use serde::Serialize;

/// Bytes of one value in single precision.
const VALUE: usize = size_of::<f32>();
/// Arrays as long as the net's parameters that a learner holds: parameters, gradient, two moments of Adam.
const LEARNT: usize = 4;
/// Arrays of the last good state that training goes back to: parameters and both moments; and the parameters that it began with.
const KEPT: usize = 4;
/// Bytes of a joint's transform in a track.
const TRANSFORM: usize = 12 * size_of::<f64>();

/// What training of one garment holds at its largest [bytes]; small things and the program itself, some 50 MB, are left out.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct MemoryNeed {
    /// The net's parameters with their gradient and Adam's moments.
    pub net: usize,
    /// The state to go back to.
    pub good_state: usize,
    /// Posed garments, gradients, bodies and the net's notes of one step.
    pub step: usize,
    /// Bodies that are kept posed, transforms and features of all frames.
    pub motion: usize,
}

/// What [`MemoryNeed`] depends on.
#[derive(Debug, Clone, Copy)]
pub struct Sizes<'a> {
    /// The net.
    pub net: &'a NetManifest,
    /// Values that it notes in a step, as [`caphy_core::net::DeformationNet::tape_len`] says.
    pub tape: usize,
    /// Garment vertices.
    pub vertices: usize,
    /// Body vertices in contact.
    pub body_vertices: usize,
    /// Joints of the body.
    pub joints: usize,
    /// Frames of motion.
    pub frames: usize,
}

impl MemoryNeed {
    /// Of training by a configuration.
    pub fn training(sizes: &Sizes<'_>, config: &TrainConfig) -> Self {
        let parameters: usize = sizes.net.tensors.iter().map(|t| t.len()).sum();
        let (steps, windows) = (config.window, config.batch.min(<f32 as Real>::LANES));
        let lanes = |blocks: usize, vertices: usize| VALUE * blocks * Frames::<f32>::length_of_block(vertices);
        let flat = |frames: usize| VALUE * frames * 3 * sizes.vertices;
        let garment = lanes(steps, sizes.vertices);
        // The net's displacements lie where the gradient does later, and come back as their own gradient.
        let displacements = flat(steps * windows);
        let nearest = size_of::<u32>() * steps * sizes.vertices * <f32 as Real>::LANES;
        let lead = if config.lead_in > 0 { lanes(2, sizes.vertices) + flat(2 * windows) } else { 0 };
        let body = 2 * lanes(steps, sizes.body_vertices);
        let kept = sizes.frames.saturating_mul(2 * 3 * VALUE * sizes.body_vertices);
        let kept = if kept <= config.keep_bodies_mib.saturating_mul(1 << 20) { kept } else { 0 };
        let features = if config.still_poses > 0 { 2 } else { 1 } * VALUE * sizes.net.inputs;
        Self {
            net: LEARNT * VALUE * parameters,
            good_state: KEPT * VALUE * parameters,
            step: garment.max(displacements) + garment + displacements + nearest + lead + body + VALUE * sizes.tape,
            motion: kept + sizes.frames * (TRANSFORM * sizes.joints + features),
        }
    }
    /// All of it [bytes].
    pub fn total(&self) -> usize {
        self.net + self.good_state + self.step + self.motion
    }
}

/// Memory that the system could give to programs now [bytes], where it says so.
pub fn available() -> Option<usize> {
    let text = std::fs::read_to_string("/proc/meminfo").ok()?;
    let line = text.lines().find_map(|l| l.strip_prefix("MemAvailable:"))?;
    line.trim().strip_suffix("kB")?.trim().parse::<usize>().ok().map(|kib| 1024 * kib)
}

/// Bytes for people.
pub fn readable(bytes: usize) -> String {
    let mib = bytes as f64 / (1 << 20) as f64;
    if mib < 1024.0 { format!("{mib:.0} MiB") } else { format!("{:.1} GiB", mib / 1024.0) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_asked_for_is_what_is_counted() {
        let shapes = vec![("head".to_string(), vec![30, 4])];
        let net = NetManifest::new("test", 4, 30, 0, shapes);
        let sizes = Sizes { net: &net, tape: 7, vertices: 10, body_vertices: 100, joints: 2, frames: 50 };
        let config =
            TrainConfig { window: 5, batch: 16, lead_in: 0, still_poses: 0, keep_bodies_mib: 1, ..Default::default() };
        let need = MemoryNeed::training(&sizes, &config);
        assert_eq!((need.net, need.good_state), (4 * 4 * 120, 4 * 4 * 120));
        // Three times 16 lanes of 5 frames of 10 vertices, what is nearest to them, two bodies, the tape.
        assert_eq!(need.step, 3 * (5 * 10 * 48 * 4) + 5 * 10 * 16 * 4 + 2 * (5 * 100 * 48 * 4) + 28);
        assert_eq!(need.motion, 50 * (100 * 24 + 2 * 96 + 4 * 4));
        // Bodies that would take more than may be kept are posed in the step.
        let config = TrainConfig { keep_bodies_mib: 0, ..config };
        assert_eq!(MemoryNeed::training(&sizes, &config).motion, 50 * (2 * 96 + 4 * 4));
        assert_eq!(readable(3 << 29), "1.5 GiB");
        if cfg!(target_os = "linux") {
            assert!(available().is_some_and(|bytes| bytes > 1 << 20));
        }
    }
}
