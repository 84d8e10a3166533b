//! The reference solver at its finest, on motion that training does not see, and how far it is from itself when it is disturbed.

use super::cost::{Spent, Stopwatch};
use super::error::{Errors, Shapes, Yard};
use super::point::contents;
use crate::artifact;
use crate::config::{ClipConfig, Config, TradeoffConfig};
use crate::files::ProjectFiles;
use crate::garment::FittedGarment;
use crate::judge::Judge;
use crate::motion;
use crate::physics::solver_forces;
use crate::quality::penetration;
use crate::scene::Scene;
use crate::simulate::{Disturbance, Simulation, SimulationOptions, Steps, simulate};
use crate::stage::preprocess::Subject;
use crate::stage::train::config_key;
use caphy_core::material::MaterialModel;
use caphy_core::pose::Pose;
use caphy_core::{Result, Vec3};
use caphy_garment::solver::SolverSettings;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::path::Path;
use std::sync::Arc;

/// Time from which on a clip is compared [s].
const WARM_UP: f64 = 0.2;
/// Standard deviation of what disturbs first guesses [m]: less than any wrinkle, more than any rounding.
const DISTURBANCE: f64 = 1e-3;
/// How much earlier each restart begins than the one before [s]. Folds, and where a shirt has slid to, are a matter of what came
/// before: a simulation that began a little earlier is as right as any.
const EARLIER: f64 = 0.25;
/// Most Newton steps per frame: a pinched fold that has not let go by then often does not after several hundred. How many frames
/// that concerns is told.
const STEPS: usize = 120;

/// The solver's settings at a tolerance [N].
pub(super) fn settings(config: &Config, tolerance_n: f64) -> SolverSettings {
    let own = config.compare.as_ref().map_or_else(SolverSettings::default, |c| c.solver);
    SolverSettings { tolerance_n, iterations: STEPS, ..own }
}

/// A clip and where in it the solver begins and comparison begins.
pub(super) struct Motion {
    /// From the clip's beginning to the last simulated frame.
    pub(super) poses: Vec<Pose>,
    /// First simulated frame.
    pub(super) from: usize,
    /// First compared frame.
    pub(super) compared: usize,
    /// Frames per second.
    pub(super) fps: f64,
}

impl Motion {
    /// Of a clip, cut to what is needed.
    pub(super) fn load(files: &ProjectFiles, config: &Config, clip: &ClipConfig, scene: &Scene) -> Result<Self> {
        let (settings, fps) = (config.tradeoff(), config.motion.fps);
        let mut poses = motion::load(files, clip, None, fps, &scene.rest_joints[0])?.clip.poses;
        let count = ((settings.seconds * fps).round() as usize).max(1) + 1;
        // A clip that is too short for its beginning to be left out is taken from as late as it can be.
        let from = ((settings.from_s * fps).round() as usize).min(poses.len().saturating_sub(count));
        poses.truncate(from + count);
        let compared = (from + (WARM_UP * fps).round() as usize).min(poses.len() - 1);
        Ok(Self { poses, from, compared, fps })
    }
    /// The same with a simulation that begins earlier, by so many times [`EARLIER`] as the clip has room for.
    fn restarted(&self, times: usize) -> Self {
        let frames = (times as f64 * EARLIER * self.fps).round() as usize;
        Self { poses: self.poses.clone(), from: self.from.saturating_sub(frames), ..*self }
    }
    /// Frames that are simulated.
    pub(super) fn simulated(&self) -> &[Pose] {
        &self.poses[self.from..]
    }
    /// Frames that are compared.
    pub(super) fn judged(&self) -> &[Pose] {
        &self.poses[self.compared..]
    }
}

/// A simulated garment, where it is compared.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(super) struct Simulated {
    /// Vertices [m], shape [frame][vertex].
    pub(super) frames: Vec<Vec<Vec3>>,
    /// Mean energy of a frame without inertia [J].
    pub(super) energy_j: f64,
    /// Frames whose forces did not come below the tolerance, of all that were simulated.
    pub(super) unconverged: [usize; 2],
    /// What all frames took.
    pub(super) spent: Spent,
}

/// Simulates a garment along a motion.
pub(super) fn solve(
    config: &Config,
    scene: &Scene,
    garment: &FittedGarment,
    motion: &Motion,
    settings: SolverSettings,
    disturbance: Option<Disturbance>,
) -> Result<Simulated> {
    let options = SimulationOptions {
        steps: Steps::Dynamic,
        fps: motion.fps,
        forces: solver_forces(&config.train),
        settings,
        disturbance,
    };
    let track = scene.track(motion.simulated())?;
    let contact = scene.contact(garment)?;
    let material = fabric(config, garment)?;
    let watch = Stopwatch::start();
    let simulation: Simulation = simulate(garment, material, &track, &contact, None, &options, &|_, _| ())?;
    let spent = watch.read();
    let skip = motion.compared - motion.from;
    let energies = simulation.reports[skip..].iter().map(|report| {
        let statics = report.energies.iter().filter(|e| e.0 != "inertia");
        statics.map(|e| e.1).sum::<f64>()
    });
    let energy_j = energies.sum::<f64>() / (simulation.reports.len() - skip) as f64;
    let unconverged = [simulation.unconverged(), simulation.frames.len()];
    Ok(Simulated { frames: simulation.frames[skip..].to_vec(), energy_j, unconverged, spent })
}

/// The fabric that the experiment itself names.
pub(super) fn fabric(config: &Config, garment: &FittedGarment) -> Result<Arc<dyn MaterialModel>> {
    Ok(Arc::from(config.garment(garment.kind)?.material.material(config_key(garment.kind))?))
}

/// The solver's finest answers.
pub(super) struct Yardstick {
    /// What points are chosen by, and what they are checked on.
    pub(super) motions: [Motion; 2],
    /// Shape [motion][garment].
    yards: [Vec<Yard>; 2],
    /// Mean energies [J], shape [motion][garment].
    energies: [Vec<f64>; 2],
    /// Restarts, begun earlier and disturbed, against the first answer, per motion: mean over garments and restarts.
    pub(super) floors: [Errors; 2],
    /// Frames that did not converge, of all.
    pub(super) unconverged: [usize; 2],
    /// Vertices over all garments.
    pub(super) vertices: usize,
    /// What it depends on.
    pub(super) hash: String,
}

/// One simulation of the yardstick.
struct Job {
    garment: usize,
    motion: usize,
    /// 0 is not disturbed.
    restart: usize,
}

impl Yardstick {
    /// Simulates what is not there yet, on all threads; `done` hears of every simulation that ends.
    ///
    /// # Errors
    /// As [`simulate`].
    pub(super) fn new(
        folder: &Path,
        files: &ProjectFiles,
        config: &Config,
        subject: &Subject,
        subject_hash: &str,
        done: &(dyn Fn(usize, usize, bool) + Sync),
    ) -> Result<Self> {
        let wanted: &TradeoffConfig = config.tradeoff();
        let scene = scene_of(files, config, subject)?;
        let clips = [wanted.clip(config.compare.as_ref().map(|c| &c.clip)), wanted.check.clone()];
        let motions = clips
            .iter()
            .map(|clip| Motion::load(files, config, clip, &scene))
            .collect::<Result<Vec<_>>>()?
            .try_into()
            .map_err(|_| caphy_core::Error::unsupported("other than two motions", "the yardstick"))?;
        let fabrics: Vec<String> = config.garments().map(|g| g.2.material.text()).collect();
        let told = serde_json::to_string(&(
            &clips,
            wanted.from_s,
            wanted.seconds,
            config.motion.fps,
            config.evaluate.penetration_m,
        ))
        .map_err(|e| caphy_core::Error::numerics("yardstick", e.to_string(), "report this as a defect"))?;
        let told = told + &contents(files, &clips)?;
        let solver = format!("{:?}{:?}{EARLIER}", settings(config, wanted.tolerance_n), solver_forces(&config.train));
        let hash =
            artifact::hash(format!("{}{subject_hash}{told}{fabrics:?}{solver}", env!("CARGO_PKG_VERSION")).as_bytes());
        let mut jobs = Vec::new();
        for restart in 0..=wanted.restarts {
            for motion in 0..2 {
                jobs.extend((0..subject.garments.len()).map(|garment| Job { garment, motion, restart }));
            }
        }
        let motions: [Motion; 2] = motions;
        let count = jobs.len();
        let ended = std::sync::atomic::AtomicUsize::new(0);
        let simulated = jobs
            .par_iter()
            .map(|job| {
                let garment = &subject.garments[job.garment];
                let name = format!("{}-{}-{}", garment.kind, ["clip", "check"][job.motion], job.restart);
                let path = folder.join(format!("{name}.caphy"));
                let key = format!("{hash}-{name}");
                let known = artifact::load::<Simulated>(&path, "yardstick", &key)?;
                let now = known.is_none();
                let value = match known {
                    Some((value, _)) => value,
                    None => {
                        let disturbance = (job.restart > 0)
                            .then_some(Disturbance { deviation_m: DISTURBANCE, seed: job.restart as u64 });
                        let settings = settings(config, wanted.tolerance_n);
                        let motion = motions[job.motion].restarted(job.restart);
                        let value = solve(config, &scene, garment, &motion, settings, disturbance)?;
                        artifact::save(&path, "yardstick", &key, &value)?;
                        value
                    }
                };
                let before = ended.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
                done(before + 1, count, now);
                Ok(value)
            })
            .collect::<Result<Vec<Simulated>>>()?;
        let (mut yards, mut energies) = ([Vec::new(), Vec::new()], [Vec::new(), Vec::new()]);
        let mut unconverged = [0; 2];
        for (job, simulated) in jobs.iter().zip(&simulated) {
            let garment = &subject.garments[job.garment];
            if job.restart == 0 {
                let rest = garment.rest(&*fabric(config, garment)?)?;
                yards[job.motion].push(Yard::new(rest, &garment.mesh, simulated.frames.clone())?);
                energies[job.motion].push(simulated.energy_j);
            }
            unconverged.iter_mut().zip(simulated.unconverged).for_each(|(sum, n)| *sum += n);
        }
        let vertices = subject.garments.iter().map(|g| g.mesh.vertices.len()).sum();
        let mut out = Self { motions, yards, energies, floors: Default::default(), unconverged, vertices, hash };
        for motion in 0..2 {
            let restarts = jobs.iter().zip(&simulated).filter(|(job, _)| job.motion == motion && job.restart > 0);
            let all = restarts.map(|(job, simulated)| {
                let garment = &subject.garments[job.garment];
                out.judge(config, &scene, garment, job.garment, motion, &simulated.frames, Some(simulated.energy_j))
            });
            let all = all.collect::<Result<Vec<_>>>()?;
            out.floors[motion] = Errors::mean(&all);
        }
        Ok(out)
    }
    /// Errors of one garment's shapes in the compared frames of a motion; `energy_j` is their mean energy where the solver itself
    /// says it.
    ///
    /// # Errors
    /// What the garment is refused for.
    pub(super) fn judge(
        &self,
        config: &Config,
        scene: &Scene,
        garment: &FittedGarment,
        index: usize,
        motion: usize,
        frames: &[Vec<Vec3>],
        energy_j: Option<f64>,
    ) -> Result<Errors> {
        let played = &self.motions[motion];
        let mut out = self.yards[motion][index].errors(&Shapes { template: &garment.mesh, frames })?;
        let judge = Judge::new(scene, garment, fabric(config, garment)?, played.fps, &config.train)?;
        let track = scene.track(played.judged())?;
        let total = |shapes: &[Vec<Vec3>]| -> Result<f64> {
            Ok(judge.mean_energies(&track, shapes)?.iter().map(|e| e.1).sum())
        };
        let own = energy_j.map_or_else(|| total(frames), Ok)?;
        let best = self.energies[motion][index];
        out.energy = (own - best) / (total(&judge.skinned(&track)?)? - best);
        let [inside, deepest] = penetration(&judge.clearances(&track, frames)?, config.evaluate.penetration_m);
        (out.inside, out.deepest_mm) = (inside, 1e3 * deepest);
        Ok(out)
    }
}

/// The scene of a subject.
pub(super) fn scene_of(files: &ProjectFiles, config: &Config, subject: &Subject) -> Result<Scene> {
    Scene::dressed(Arc::from(config.body.body(files)?), &subject.shape, &subject.displacement, &subject.garments)
}
