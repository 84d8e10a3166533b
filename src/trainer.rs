//! Training of one garment's net: batches, loss, gradient, Adam, checkpoints (Secs. 3.2-3.3).
//!
//! Nothing here knows a stage: `train` gives it one garment, `finetune` two.

mod clock;
mod fault;
mod pool;
#[cfg(test)]
mod step_tests;

pub use clock::StageClock;
pub use fault::Fault;
pub use pool::{Lent, Memory};

use crate::config::TrainConfig;
use crate::garment::{FittedGarment, TrainedGarment};
use crate::physics::{Dynamics, GRAVITY, Physics, TermEnergies};
use crate::plugins::PluginTable;
use crate::track::BodyTrack;
use caphy_core::array::{In, Out};
use caphy_core::body::BodyDescription;
use caphy_core::lanes::Frames;
use caphy_core::material::MaterialModel;
use caphy_core::net::{BackwardBlock, BackwardCall, DeformationNet, ForwardBlock, ForwardCall};
use caphy_core::{Error, Real, Result, simd_kernel};
use caphy_garment::GarmentRest;
use caphy_garment::contact::ContactMap;
use caphy_garment::contact_surface::{ContactPoints, ContactSurface};
use caphy_garment::energy::{BodyState, Chamfer, EnergyTerm, ScanCloud, State};
use caphy_garment::features::{FeatureOptions, PoseFeatures, moving_joints};
use caphy_garment::skinning::{JointFrames, Skinner};
use caphy_nets::adam::Adam;
use pool::Pool;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::sync::Arc;
use std::time::Duration;

/// Frames of motion with the windows that may be drawn from them.
pub struct MotionFrames {
    /// All clips, one after the other.
    pub track: BodyTrack,
    /// First frames of windows that do not leave their clip.
    pub starts: Vec<usize>,
    /// Whether the frame before belongs to the same clip.
    pub has_before: Vec<bool>,
    /// Frames per second.
    pub fps: f64,
}

/// Scan poses with the garment's points in each.
pub struct ScanFrames {
    /// One frame per scan.
    pub track: Arc<BodyTrack>,
    /// Points of this garment, one cloud per frame.
    pub clouds: Vec<ScanCloud<f32>>,
    /// Garment vertices that the scans can see.
    pub visible: Vec<bool>,
}

/// A batch of frames `[step][window]`.
#[derive(Debug, Clone)]
pub struct Batch {
    /// Frames of the track, `[step * windows + window]`.
    pub frames: Vec<usize>,
    /// Windows.
    pub windows: usize,
    /// What the frames are.
    pub kind: BatchKind,
}

/// What a batch shows a net.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum BatchKind {
    /// Windows of motion.
    Windows,
    /// Single frames of motion, in which nothing moves.
    Still,
    /// Scan poses, with their scans.
    Scans,
}

/// The random windows of one epoch, in batches; a function of seed and epoch alone, so that a resumed run draws the same.
pub fn window_batches(motion: &MotionFrames, config: &TrainConfig, count: usize, seed: u64, epoch: u64) -> Vec<Batch> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(epoch);
    let mut order: Vec<usize> = Vec::new();
    while order.len() < count {
        let mut all = motion.starts.clone();
        all.shuffle(&mut rng);
        order.extend(all);
    }
    order.truncate(count);
    order
        .chunks(config.batch)
        .map(|starts| Batch {
            frames: (0..config.window).flat_map(|t| starts.iter().map(move |s| s + t)).collect(),
            windows: starts.len(),
            kind: BatchKind::Windows,
        })
        .collect()
}

/// Single poses of one round, in batches: frames of windows that may be drawn.
pub fn still_batches(motion: &MotionFrames, config: &TrainConfig, seed: u64, round: u64) -> Vec<Batch> {
    let poses = TrainConfig { window: 1, ..config.clone() };
    let mut batches = window_batches(motion, &poses, config.still_poses, seed ^ 0x57_1115, round);
    batches.iter_mut().for_each(|batch| batch.kind = BatchKind::Still);
    batches
}

/// The scan poses of one epoch, in batches, shuffled like [`window_batches`].
pub fn scan_batches(count: usize, config: &TrainConfig, seed: u64, epoch: u64) -> Vec<Batch> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed ^ 0x5ca1_ab1e);
    rng.set_stream(epoch);
    let mut order: Vec<usize> = (0..count).collect();
    order.shuffle(&mut rng);
    order
        .chunks(config.batch)
        .map(|frames| Batch { frames: frames.to_vec(), windows: frames.len(), kind: BatchKind::Scans })
        .collect()
}

/// Everything that turns batches into gradients of one garment's net.
pub struct GarmentLearner<'a> {
    /// Rest state.
    pub rest: GarmentRest,
    physics: Physics<f32>,
    chamfer: Chamfer,
    scan_weight: f64,
    skinner: Skinner<f32>,
    held: Skinner<f32>,
    net: Box<dyn DeformationNet>,
    features: PoseFeatures,
    motion_features: Vec<Vec<f32>>,
    still_features: Vec<Vec<f32>>,
    scan_features: Vec<Vec<f32>>,
    motion: &'a MotionFrames,
    scans: &'a ScanFrames,
    contact: ContactMap,
    /// Triangles of the body, where they are met rather than vertices.
    surface: Option<ContactSurface>,
    frame_clip: f64,
    lead_in: usize,
    output_scale: f32,
    /// Flat parameters of the net.
    pub parameters: Vec<f32>,
    /// Gradient, added to by [`GarmentLearner::backward`].
    pub gradient: Vec<f32>,
    first_moment: Vec<f32>,
    second_moment: Vec<f32>,
    adam: Adam,
    pool: Pool,
    clock: StageClock,
}

/// What a forward pass leaves for the backward pass.
pub struct Pass {
    /// Posed garments [m].
    pub positions: Lent<Frames<f32>>,
    /// Gradient by them [N], to which others may add.
    pub gradient: Lent<Frames<f32>>,
    /// Mean energies.
    pub energies: TermEnergies,
    features: Lent<Vec<f32>>,
    joints: JointFrames<f32>,
    tape: Lent<Vec<f32>>,
    /// What the net carried into the windows; none: zeros.
    state: Option<Vec<f32>>,
    steps: usize,
    windows: usize,
}

/// What happened before the windows of a batch.
pub(super) struct LeadIn {
    /// What the net carries into them, `[window][state]`.
    pub(super) state: Vec<f32>,
    /// The garments in the two frames before [m].
    pub(super) past: Lent<Frames<f32>>,
}

/// What a garment's net is told: the joints that move it, not standardised yet.
///
/// # Errors
/// As [`PoseFeatures::new`].
pub fn pose_features(garment: &FittedGarment, body: &BodyDescription) -> Result<PoseFeatures> {
    let joints = moving_joints(&body.joints, &garment.weights);
    // The root's velocity drives inertia; static poses stand still, which is what a zero says.
    let options = FeatureOptions { root_velocity: true, ..FeatureOptions::default() };
    PoseFeatures::new(joints, options, GRAVITY)
}

/// Net, features and first parameters of a garment that was never trained.
pub fn untrained(
    garment: &FittedGarment,
    body: &BodyDescription,
    spec: &PluginTable,
    config: &TrainConfig,
    motion: &MotionFrames,
    scans: &BodyTrack,
    seed: u64,
) -> Result<TrainedGarment> {
    let mut features = pose_features(garment, body)?;
    let mut raw = Vec::new();
    for frame in 0..motion.track.len() {
        raw.push(features.raw(&motion.track.poses[frame], before(motion, frame), 1.0 / motion.fps)?);
    }
    for pose in &scans.poses {
        raw.push(features.raw(pose, None, 1.0 / motion.fps)?);
    }
    features.standardise(&raw)?;
    let net = spec.net(features.count(), 3 * garment.mesh.vertices.len())?;
    let parameters = net.initialise(seed)?.into_iter().map(|p| p as f32).collect();
    Ok(TrainedGarment {
        kind: garment.kind,
        features,
        manifest: net.manifest().clone(),
        parameters,
        output_scale_m: config.output_scale_m,
        fps: motion.fps,
        material: None,
        curve: Vec::new(),
    })
}

fn before(motion: &MotionFrames, frame: usize) -> Option<&caphy_core::pose::Pose> {
    motion.has_before[frame].then(|| &motion.track.poses[frame - 1])
}

impl<'a> GarmentLearner<'a> {
    /// A learner that goes on from a trained (or untrained) garment.
    pub fn new(
        garment: &FittedGarment,
        trained: &TrainedGarment,
        material: Arc<dyn MaterialModel>,
        spec: &PluginTable,
        config: &TrainConfig,
        motion: &'a MotionFrames,
        scans: &'a ScanFrames,
        contact: ContactMap,
    ) -> Result<GarmentLearner<'a>> {
        let rest = garment.rest(&*material)?;
        let physics = Physics::new(&rest, material, &config.contact, motion.fps, &config.weights)?;
        let skinner = Skinner::new(&garment.mesh.vertices, &garment.weights)?;
        let held = skinner.select(physics.attachment.vertices())?;
        let net = spec.net(trained.features.count(), 3 * garment.mesh.vertices.len())?;
        if *net.manifest() != trained.manifest {
            return Err(Error::config(
                "net",
                "the trained net has other sizes than the configured one",
                "train again from the start: delete the run folder or choose another",
            ));
        }
        let step = 1.0 / motion.fps;
        let motion_features = (0..motion.track.len())
            .map(|f| trained.features.frame(&motion.track.poses[f], before(motion, f), step))
            .collect::<Result<Vec<Vec<f32>>>>()?;
        let alone = |pose| trained.features.frame(pose, None, step);
        let still_features = match config.still_poses {
            0 => Vec::new(),
            _ => motion.track.poses.iter().map(alone).collect::<Result<Vec<Vec<f32>>>>()?,
        };
        let scan_features = scans.track.poses.iter().map(alone).collect::<Result<Vec<Vec<f32>>>>()?;
        let n = trained.parameters.len();
        Ok(GarmentLearner {
            chamfer: Chamfer::new(&rest, Some(&scans.visible))?,
            scan_weight: physics.scan_weight(),
            rest,
            physics,
            skinner,
            held,
            net,
            features: trained.features.clone(),
            motion_features,
            still_features,
            scan_features,
            motion,
            scans,
            contact,
            surface: None,
            frame_clip: config.frame_clip,
            lead_in: config.lead_in,
            output_scale: trained.output_scale_m as f32,
            parameters: trained.parameters.clone(),
            gradient: vec![0.0; n],
            first_moment: vec![0.0; n],
            second_moment: vec![0.0; n],
            adam: Adam { learning_rate: config.learning_rate as f32, ..Adam::default() },
            pool: Pool::default(),
            clock: StageClock::off(),
        })
    }
    /// Lets the garment meet the body's triangles from now on, which are those of the track's vertices.
    ///
    /// # Errors
    /// As [`ContactSurface::new`].
    pub fn meet_triangles(&mut self, faces: &[[u32; 3]]) -> Result<()> {
        self.surface = Some(ContactSurface::new(self.motion.track.vertices(), faces)?);
        Ok(())
    }
    /// Measures from now on where the time of steps goes, from zero; or stops measuring.
    pub fn set_profiling(&mut self, on: bool) {
        self.clock = if on { StageClock::on() } else { StageClock::off() };
        self.physics.set_clock(self.clock.clone());
    }
    /// Wall time by stage of all steps since [`GarmentLearner::set_profiling`], in the order of a step; empty where nothing is
    /// measured. Energies are named as in the metrics.
    pub fn profile(&self) -> Vec<(&'static str, Duration)> {
        self.clock.sums()
    }

    /// Poses a batch by the net and adds up its energies and their gradients by the garment's vertices, as means over frames.
    pub fn forward(&self, batch: &Batch) -> Result<Pass> {
        let (track, features) = self.told(batch);
        let windows = batch.windows;
        let steps = batch.frames.len() / windows;
        let (pool, clock) = (&self.pool, &self.clock);
        let mut inputs = pool.values(batch.frames.len() * self.net.manifest().inputs);
        for (row, &f) in inputs.chunks_exact_mut(self.net.manifest().inputs.max(1)).zip(&batch.frames) {
            row.copy_from_slice(&features[f]);
        }
        let lead = if batch.kind == BatchKind::Windows { self.lead(batch)? } else { None };
        let state_before = lead.as_ref().map_or(In::absent(), |lead| (&lead.state[..]).into());
        // Zeros: a net of somebody else's may add to what it finds.
        let mut output = pool.zeros(batch.frames.len() * self.net.manifest().outputs);
        let mut tape = pool.zeros(self.net.tape_len(steps, windows)?);
        clock.time("net forward", || {
            let mut block = ForwardBlock {
                steps,
                batch: windows,
                parameters: (&self.parameters[..]).into(),
                features: (&inputs[..]).into(),
                state_before,
                output: (&mut output[..]).into(),
                state_after: Out::absent(),
                tape: (&mut tape[..]).into(),
            };
            self.net.forward(ForwardCall::F32(&mut block))
        })?;

        let mut positions = pool.frames(steps, self.skinner.vertex_count(), windows);
        let mut targets = pool.frames(steps, self.held.vertex_count(), windows);
        let joints = clock.time("skinning", || {
            let joints = self.skinner.joint_frames(&track.transforms(&batch.frames), windows)?;
            self.skinner.forward_scaled(&joints, Some(&output), self.output_scale, &mut positions)?;
            self.held.forward(&joints, None, &mut targets)?;
            Ok(joints)
        })?;
        // Free for what follows.
        drop(output);
        let meets_body = self.physics.meets_body();
        let posed = if meets_body { track.vertices() } else { 0 };
        let mut body = pool.frames(steps, posed, windows);
        let mut normals = pool.frames(steps, posed, windows);
        let mut nearest = Vec::new();
        if meets_body {
            clock.time("body", || track.gather_into(&batch.frames, &mut body, &mut normals))?;
            clock.time("contact search", || self.contact.nearest_into(&positions, &body, &mut nearest))?;
        }
        let points =
            |s: &ContactSurface| clock.time("contact points", || s.points(&positions, &body, &normals, &nearest));
        let met = self.surface.as_ref().filter(|_| meets_body).map(points).transpose()?;
        let vertices = BodyState { positions: &body, normals: &normals, nearest: Some(&nearest) };
        let state = State::new(&positions).with_targets(&targets);
        let state =
            if meets_body { state.with_body(met.as_ref().map_or(vertices, ContactPoints::state)) } else { state };
        let state = lead.as_ref().map_or(state, |lead| state.with_past(&lead.past));
        let mut gradient = pool.frames(steps, self.skinner.vertex_count(), windows);
        gradient.clear();
        let scale = 1.0 / (steps * windows) as f64;
        let dynamics = if batch.kind == BatchKind::Windows { Dynamics::Moving } else { Dynamics::Static };
        let mut energies = self.physics.add(&state, dynamics, scale, Some(&mut gradient))?;
        if batch.kind == BatchKind::Scans {
            let clouds: Vec<&ScanCloud<f32>> = batch.frames.iter().map(|&f| &self.scans.clouds[f]).collect();
            let state = state.with_scans(&clouds);
            let mut squared = vec![0.0; batch.frames.len()];
            if self.scan_weight > 0.0 {
                clock.time("scan", || {
                    self.chamfer.add(&state, self.scan_weight * scale, &mut squared, Some(&mut gradient))
                })?;
            }
            energies.push(("scan", squared.iter().sum::<f64>()));
        }
        if self.frame_clip > 0.0 {
            clock.time("limit of frames", || limit_frames(&mut gradient, self.frame_clip));
        }
        Ok(Pass {
            positions,
            gradient,
            energies,
            features: inputs,
            state: lead.map(|l| l.state),
            joints,
            tape,
            steps,
            windows,
        })
    }

    /// Bodies of a batch's frames, and what the net is told of each.
    fn told(&self, batch: &Batch) -> (&BodyTrack, &[Vec<f32>]) {
        match batch.kind {
            BatchKind::Windows => (&self.motion.track, &self.motion_features),
            BatchKind::Still => (&self.motion.track, &self.still_features),
            BatchKind::Scans => (&self.scans.track, &self.scan_features),
        }
    }

    /// Plays the frames before the windows of a batch, without a gradient: a clip that begins later stands still in its first frame
    /// until then. `None` where nothing leads in.
    pub(super) fn lead(&self, batch: &Batch) -> Result<Option<LeadIn>> {
        let (steps, windows) = (self.lead_in, batch.windows);
        if steps == 0 {
            return Ok(None);
        }
        let mut first = batch.frames[..windows].to_vec();
        let mut frames = vec![0; steps * windows];
        for step in (0..steps).rev() {
            for (window, frame) in first.iter_mut().enumerate() {
                if self.motion.has_before[*frame] {
                    *frame -= 1;
                }
                frames[step * windows + window] = *frame;
            }
        }
        let manifest = self.net.manifest();
        let mut inputs = self.pool.values(frames.len() * manifest.inputs);
        for (row, &f) in inputs.chunks_exact_mut(manifest.inputs.max(1)).zip(&frames) {
            row.copy_from_slice(&self.motion_features[f]);
        }
        // Only the last two frames are posed: before them the net is asked for what it carries, if it carries anything.
        let (early, late) = (steps.saturating_sub(2), steps.min(2));
        let mut output = self.pool.zeros(late * windows * manifest.outputs);
        let mut state = vec![0.0f32; windows * manifest.state];
        let mut carried = vec![0.0f32; if early > 0 { state.len() } else { 0 }];
        let (first, last) = inputs.split_at(early * windows * manifest.inputs);
        let run = |steps, features: &[f32], before: &[f32], output: Option<&mut [f32]>, after: &mut [f32]| {
            let mut block = ForwardBlock {
                steps,
                batch: windows,
                parameters: (&self.parameters[..]).into(),
                features: features.into(),
                state_before: if before.is_empty() { In::absent() } else { before.into() },
                output: output.map_or_else(Out::absent, Out::from),
                state_after: if after.is_empty() { Out::absent() } else { after.into() },
                tape: Out::absent(),
            };
            self.net.forward(ForwardCall::F32(&mut block))
        };
        self.clock.time("net lead-in", || {
            if !carried.is_empty() {
                run(early, first, &[], None, &mut carried)?;
            }
            run(late, last, &carried, Some(&mut output), &mut state)
        })?;
        let last = early * windows;
        let mut past = self.pool.frames(2, self.skinner.vertex_count(), windows);
        self.clock.time("skinning", || {
            let joints = self.skinner.joint_frames(&self.motion.track.transforms(&frames[last..]), windows)?;
            self.skinner.forward_scaled(&joints, Some(&output), self.output_scale, &mut past)
        })?;
        Ok(Some(LeadIn { state, past }))
    }

    /// Carries a pass's gradient back into the net's parameters.
    pub fn backward(&mut self, pass: &Pass) -> Result<()> {
        let outputs = self.net.manifest().outputs;
        let mut displacement = self.pool.values(pass.steps * pass.windows * outputs);
        self.clock.time("skinning backward", || {
            self.skinner.vjp_scaled(&pass.joints, &pass.gradient, self.output_scale, &mut displacement)
        })?;
        let mut block = BackwardBlock {
            steps: pass.steps,
            batch: pass.windows,
            parameters: (&self.parameters[..]).into(),
            features: (&pass.features[..]).into(),
            state_before: pass.state.as_ref().map_or(In::absent(), |state| (&state[..]).into()),
            tape: (&pass.tape[..]).into(),
            output_gradient: (&displacement[..]).into(),
            parameter_gradient: (&mut self.gradient[..]).into(),
            feature_gradient: Out::absent(),
        };
        self.clock.time("net backward", || self.net.backward(BackwardCall::F32(&mut block)))
    }

    /// One step of Adam; returns the gradient's norm before it was shortened.
    pub fn step(&mut self, learning_rate: f64, clip_norm: f64) -> Result<f64> {
        self.adam.learning_rate = learning_rate as f32;
        self.clock.time("Adam", || {
            self.adam.step(
                Some(clip_norm as f32),
                &mut self.parameters,
                &mut self.gradient,
                &mut self.first_moment,
                &mut self.second_moment,
            )
        })
    }

    /// Says which share of training is done, for the weights' schedules; a new learner stands at the end.
    pub fn set_share(&mut self, share: f64) {
        self.physics.set_share(share);
        self.scan_weight = self.physics.scan_weight();
    }
    /// State for a checkpoint.
    pub fn snapshot(&self) -> LearnerState {
        LearnerState {
            parameters: self.parameters.clone(),
            first_moment: self.first_moment.clone(),
            second_moment: self.second_moment.clone(),
            adam_step: self.adam.step,
        }
    }
    /// Goes back to a checkpoint.
    pub fn restore(&mut self, state: &LearnerState) -> Result<()> {
        for (what, values) in [
            ("net parameters of a checkpoint", &state.parameters),
            ("first moments of a checkpoint", &state.first_moment),
            ("second moments of a checkpoint", &state.second_moment),
        ] {
            Error::check_length(what, self.parameters.len(), values.len())?;
        }
        self.parameters.copy_from_slice(&state.parameters);
        self.first_moment.copy_from_slice(&state.first_moment);
        self.second_moment.copy_from_slice(&state.second_moment);
        self.gradient.fill(0.0);
        self.adam.step = state.adam_step;
        Ok(())
    }
    /// Features of the net.
    pub fn features(&self) -> &PoseFeatures {
        &self.features
    }
}

/// Shortens the gradient of each frame to at most `factor` times the median length over the batch. Frames whose gradient is not
/// finite are left for the optimiser to refuse.
fn limit_frames(gradient: &mut Frames<f32>, factor: f64) {
    let (lanes, n) = (gradient.lanes_used(), gradient.block_len());
    if n == 0 {
        return;
    }
    let squares: Vec<[f64; LANES]> = gradient.data().par_chunks(n).map(lane_squares).collect();
    let lengths: Vec<[f64; LANES]> = squares.iter().map(|block| block.map(f64::sqrt)).collect();
    let mut sorted: Vec<f64> = lengths.iter().flat_map(|block| block[..lanes].iter().copied()).collect();
    sorted.sort_by(f64::total_cmp);
    let most = factor * sorted.get(sorted.len() / 2).copied().unwrap_or(0.0);
    gradient.data_mut().par_chunks_mut(n).zip(&lengths).for_each(|(block, lengths)| {
        let factors = lengths.map(|length| if length > most && most > 0.0 { (most / length) as f32 } else { 1.0 });
        if factors.iter().any(|f| *f != 1.0) {
            scale_lanes(&factors, block);
        }
    });
}

const LANES: usize = <f32 as Real>::LANES;

simd_kernel! {
    /// Σ x² of each lane of a block, in double precision.
    fn lane_squares<T>(block: &[T]) -> [f64; LANES] {
        let mut sums = [0.0; LANES];
        for row in block.chunks_exact(LANES) {
            for l in 0..LANES {
                let x = row[l].to_f64();
                sums[l] += x * x;
            }
        }
        sums
    }
}

simd_kernel! {
    /// Multiplies each lane of a block by a factor of its own.
    fn scale_lanes<T>(factors: &[T; LANES], block: &mut [T]) {
        for row in block.chunks_exact_mut(LANES) {
            for l in 0..LANES {
                row[l] *= factors[l];
            }
        }
    }
}

/// Net and optimiser at some step.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LearnerState {
    parameters: Vec<f32>,
    first_moment: Vec<f32>,
    second_moment: Vec<f32>,
    adam_step: u64,
}

/// One recorded point of training.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CurvePoint {
    /// Step.
    pub step: usize,
    /// Whether the batch was scan poses.
    pub scans: bool,
    /// Mean energy per term [J per frame]; `scan` is λ3d times the mean squared distance.
    pub energies: Vec<(String, f64)>,
    /// Norm of the gradient.
    pub gradient_norm: f64,
}

/// The learning rate at a share of the whole: a short rise, then a cosine down to `final_rate`.
pub fn learning_rate(config: &TrainConfig, first: f64, share: f64) -> f64 {
    const RISE: f64 = 0.01;
    let rise = (share / RISE).clamp(0.05, 1.0);
    let cosine = 0.5 * (1.0 + (std::f64::consts::PI * share.clamp(0.0, 1.0)).cos());
    first * rise * (config.final_rate + (1.0 - config.final_rate) * cosine)
}

#[cfg(test)]
mod tests {
    use super::*;
    use caphy_core::Vec3;

    #[test]
    fn one_wild_frame_is_shortened_and_the_others_stay() {
        let mut gradient = Frames::<f32>::zeros(1, 2, 5);
        for lane in 0..5 {
            let size = if lane == 3 { 1000.0 } else { 1.0 + 0.1 * lane as f64 };
            gradient.set(0, lane, 0, &Vec3::new(size, 0.0, 0.0));
        }
        limit_frames(&mut gradient, 3.0);
        assert!((gradient.get(0, 3, 0).x - 3.0 * 1.2).abs() < 1e-5, "{}", gradient.get(0, 3, 0).x);
        assert_eq!(gradient.get(0, 1, 0).x, f64::from(1.1f32));
    }

    #[test]
    fn the_learning_rate_rises_then_falls_to_its_share() {
        let config = TrainConfig::default();
        assert!(learning_rate(&config, 1.0, 0.0) < learning_rate(&config, 1.0, 0.01));
        assert!((learning_rate(&config, 1.0, 1.0) - config.final_rate).abs() < 1e-12);
    }
}
