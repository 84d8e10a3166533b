//! Garments along a clip by the reference solver: without a network, the accuracy end of the trade.

use crate::garment::FittedGarment;
use crate::random::normal;
use crate::scene::outer;
use crate::track::BodyTrack;
use caphy_core::lanes::Frames;
use caphy_core::material::MaterialModel;
use caphy_core::{Error, Real, Result, Vec3};
use caphy_garment::contact::ContactMap;
use caphy_garment::energy::{LayeringOrder, frame_normals};
use caphy_garment::solver::{
    Dynamics, Forces, Obstacle, Outcome, Scene, Solution, SolveReport, Solver, SolverSettings,
};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// How frames follow each other.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "snake_case")]
#[value(rename_all = "snake_case")]
pub enum Steps {
    /// Every frame at rest: no inertia.
    QuasiStatic,
    /// Backward Euler steps, one per frame; the clip begins at rest on a body that already moves.
    Dynamic,
}

/// What acts, and how exactly it is solved.
#[derive(Debug, Clone, Copy)]
pub struct SimulationOptions {
    /// At rest in every frame, or in motion.
    pub steps: Steps,
    /// Frames per second: the time step of motion.
    pub fps: f64,
    /// Energies and their weights.
    pub forces: Forces,
    /// The solver's settings.
    pub settings: SolverSettings,
    /// What disturbs every frame's first guess; none for a plain run. Where the answers differ, a pose has several.
    pub disturbance: Option<Disturbance>,
}

/// Noise on first guesses.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Disturbance {
    /// Standard deviation of every coordinate [m].
    pub deviation_m: f64,
    /// Its seed.
    pub seed: u64,
}

/// Another garment underneath, in the same frames.
#[derive(Clone, Copy)]
pub struct Under<'a> {
    /// Its triangles.
    pub faces: &'a [[u32; 3]],
    /// Its vertices [m], shape [frame][vertex].
    pub frames: &'a [Vec<Vec3>],
}

/// A simulated garment.
#[derive(Debug, Clone)]
pub struct Simulation {
    /// Vertices [m], shape [frame][vertex].
    pub frames: Vec<Vec<Vec3>>,
    /// How each frame was solved.
    pub reports: Vec<SolveReport>,
}

impl Simulation {
    /// Frames in which forces did not come below the tolerance.
    pub fn unconverged(&self) -> usize {
        self.reports.iter().filter(|r| matches!(r.outcome, Outcome::IterationLimit | Outcome::Stalled)).count()
    }
    /// Largest force that was left on a vertex in any frame [N].
    pub fn worst_residual_n(&self) -> f64 {
        self.reports.iter().map(|r| r.residual_n).fold(0.0, f64::max)
    }
    /// Mean energy per term over all frames [J]; of terms that act in every frame.
    pub fn mean_energies(&self) -> Vec<(String, f64)> {
        let Some(first) = self.reports.first() else { return Vec::new() };
        let count = self.reports.len() as f64;
        let mean = |name: &str| self.reports.iter().map(|r| r.energy(name)).sum::<f64>() / count;
        first.energies.iter().map(|(name, _)| (name.clone(), mean(name))).collect()
    }
    /// Newton steps over all frames.
    pub fn iterations(&self) -> usize {
        self.reports.iter().map(|r| r.iterations).sum()
    }
}

/// Solves for a garment in every frame of a track; each frame starts from the one before, carried along by skinning.
///
/// `progress` hears the share that is done and a word on it.
///
/// # Errors
/// As [`Solver::solve`]; [`Error::Length`] for another number of frames underneath.
pub fn simulate(
    garment: &FittedGarment,
    material: Arc<dyn MaterialModel>,
    track: &BodyTrack,
    contact: &ContactMap,
    under: Option<Under<'_>>,
    options: &SimulationOptions,
    progress: &dyn Fn(f64, &str),
) -> Result<Simulation> {
    simulate_from(garment, material, (track, contact, under), None, options, progress)
}

/// [`simulate`], the first frame from a guess [m]. Friction holds the cloth where skinning puts it all the same, so that the answer is
/// that of a start from there, found sooner, where there is only one.
///
/// # Errors
/// As [`simulate`]; [`Error::Length`] for another number of vertices.
pub fn simulate_from(
    garment: &FittedGarment,
    material: Arc<dyn MaterialModel>,
    (track, contact, under): (&BodyTrack, &ContactMap, Option<Under<'_>>),
    guess: Option<&[Vec3]>,
    options: &SimulationOptions,
    progress: &dyn Fn(f64, &str),
) -> Result<Simulation> {
    if let Some(under) = under {
        Error::check_length("frames of the garment underneath", track.len(), under.frames.len())?;
    }
    let rest = garment.rest(&*material)?;
    let mut solver = Solver::new(&rest, material, options.forces, options.settings)?;
    let contact = match under {
        Some(under) => contact.clone().with_obstacle(under.frames.first().map_or(0, Vec::len)),
        None => contact.clone(),
    };
    let count = track.len();
    let mut out = Simulation { frames: Vec::with_capacity(count), reports: Vec::with_capacity(count) };
    let mut motion: Option<Dynamics> = None;
    let mut before: Option<Frames<f64>> = None;
    let mut last: Option<Solution> = None;
    for frame in 0..count {
        let (body, normals) = surroundings(track, under, frame)?;
        let transforms = track.transforms(&[frame])[0];
        let skinned = garment.skinned(transforms)?;
        let targets: Vec<Vec3> = solver.held_vertices().iter().map(|&v| skinned[v as usize]).collect();
        let mut start = match (out.frames.last(), guess) {
            (Some(last), _) => garment.carried(last, track.transforms(&[frame - 1])[0], transforms),
            (None, Some(guess)) => guess.to_vec(),
            (None, None) => skinned.clone(),
        };
        if let Some(Disturbance { deviation_m, seed }) = options.disturbance {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            rng.set_stream(frame as u64);
            start.iter_mut().for_each(|p| *p += Vec3::from_fn(|_, _| deviation_m * normal(&mut rng)));
        }
        let nearest = |x: &Frames<f64>| contact.nearest(x, &body);
        let scene = Scene {
            body: Some(Obstacle {
                positions: &body,
                normals: &normals,
                before: before.as_ref(),
                search: Some(&nearest),
            }),
            targets: Some(&targets),
            anchors: last.as_ref().map(|s| &s.anchors[..]).or(guess.is_some().then_some(&skinned[..])),
            ..Scene::default()
        };
        let say = |p: caphy_garment::solver::Progress| {
            // How many steps a frame takes is not known in advance: the bar moves by frames.
            let share = frame as f64 / count as f64;
            progress(share, &format!("frame {frame} of {count}, step {}, {:.1e} N", p.iteration, p.residual_n));
        };
        let solution = match (&mut motion, &last) {
            (Some(motion), _) => motion.advance(&mut solver, &scene, Some(&start), &say)?,
            (None, Some(last)) => solver.solve_from(last, &scene, &start, &say)?,
            (None, None) => solver.solve(&scene, &start, &say)?,
        };
        if options.steps == Steps::Dynamic && frame == 0 && count > 1 {
            // The clip goes on from a motion that it does not show: the cloth moves with the body at first.
            let next = garment.carried(&solution.positions, transforms, track.transforms(&[1])[0]);
            let velocity = next.iter().zip(&solution.positions).map(|(b, a)| (b - a) * options.fps).collect();
            motion = Some(Dynamics::new(solution.positions.clone(), Some(velocity), 1.0 / options.fps)?);
        }
        out.frames.push(solution.positions.clone());
        out.reports.push(solution.report.clone());
        last = Some(solution);
        before = Some(body);
    }
    Ok(out)
}

/// Solves for garments over each other, the inner ones first: lower before upper garments when `order` is over, the other way round
/// when tucked. In the garments' order; `materials` has one for each, `contact` finds what each may touch of the body.
///
/// # Errors
/// As [`simulate`]; [`Error::Length`] for another number of materials than garments.
pub fn simulate_layers(
    garments: &[FittedGarment],
    materials: &[Arc<dyn MaterialModel>],
    order: LayeringOrder,
    track: &BodyTrack,
    contact: &dyn Fn(&FittedGarment) -> Result<ContactMap>,
    options: &SimulationOptions,
    progress: &dyn Fn(f64, &str),
) -> Result<Vec<Simulation>> {
    Error::check_length("materials, one per garment", garments.len(), materials.len())?;
    let outer = outer(order);
    let mut inside_out: Vec<usize> = (0..garments.len()).collect();
    inside_out.sort_by_key(|&g| garments[g].kind == outer);
    let mut done: Vec<(usize, Simulation)> = Vec::new();
    for (k, &g) in inside_out.iter().enumerate() {
        let garment = &garments[g];
        let map = contact(garment)?;
        let under = done
            .last()
            .map(|(inner, simulation)| Under { faces: &garments[*inner].mesh.faces, frames: &simulation.frames });
        let count = inside_out.len() as f64;
        let say = |s: f64, text: &str| progress((k as f64 + s) / count, &format!("{}: {text}", garment.kind));
        done.push((g, simulate(garment, materials[g].clone(), track, &map, under, options, &say)?));
    }
    done.sort_by_key(|d| d.0);
    Ok(done.into_iter().map(|d| d.1).collect())
}

/// Positions and normals of everything that the garment may touch in one frame.
fn surroundings(track: &BodyTrack, under: Option<Under<'_>>, frame: usize) -> Result<(Frames<f64>, Frames<f64>)> {
    let (body, normals) = track.gather::<f64>(&[frame], 1)?;
    let Some(under) = under else { return Ok((body, normals)) };
    let vertices = &under.frames[frame];
    let mut other = Frames::zeros(1, vertices.len(), 1);
    other.set_frame(0, 0, vertices)?;
    let other_normals = frame_normals(&other, under.faces)?;
    Ok((joined(&body, &other), joined(&normals, &other_normals)))
}

/// Vertices of both, one after the other.
pub fn joined<T: Real>(a: &Frames<T>, b: &Frames<T>) -> Frames<T> {
    let mut out = Frames::zeros(a.blocks(), a.vertices() + b.vertices(), a.lanes_used());
    for block in 0..a.blocks() {
        let (front, back) = out.block_mut(block).split_at_mut(a.block_len());
        front.copy_from_slice(a.block(block));
        back.copy_from_slice(b.block(block));
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{Config, SubjectConfig};
    use crate::files::ProjectFiles;
    use crate::physics::GRAVITY;
    use crate::plugins::Plugins;
    use crate::synth::Person;
    use caphy_core::body::BodyModel;
    use caphy_core::pose::Pose;

    #[test]
    fn a_guess_is_where_a_solve_starts_and_not_where_friction_holds() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("tiny.toml");
        std::fs::write(&path, include_str!("../tests/all/tiny.toml")).unwrap();
        let config = Config::read_set(&path, &[], &mut Plugins::new().unwrap()).unwrap();
        let SubjectConfig::Synthetic(synthetic) = config.subject else { panic!("tiny is synthetic") };
        let body: Arc<dyn BodyModel> = Arc::from(config.body.body(&ProjectFiles::new(folder.path())).unwrap());
        let person = Person::new(&synthetic, body.clone(), 1).unwrap();
        let shirt = &person.garments[0];
        let scene = crate::scene::Scene::dressed(body.clone(), &person.subject.shape, &[], std::slice::from_ref(shirt))
            .unwrap();
        let track = scene.track(&[Pose::rest(body.describe().joints.len())]).unwrap();
        let contact = scene.contact(shirt).unwrap();
        let options = SimulationOptions {
            steps: Steps::QuasiStatic,
            fps: 30.0,
            forces: Forces { gravity: GRAVITY, ..Forces::default() },
            settings: SolverSettings { tolerance_n: 1e-6, friction: 0.3, ..SolverSettings::default() },
            disturbance: None,
        };
        let solve = |guess: Option<&[Vec3]>| {
            let around = (&track, &contact, None);
            simulate_from(shirt, person.materials[0].clone(), around, guess, &options, &|_, _| ())
        };
        let cold = solve(None).unwrap();
        assert_eq!(cold.unconverged(), 0);
        // From the answer itself nothing is left to do, since friction pulls to where skinning puts the cloth as before: 1e-6 N are a
        // thousandth of a vertex's weight, on springs of friction that yield 0.1 mm under it.
        let again = solve(Some(&cold.frames[0])).unwrap();
        assert_eq!(again.unconverged(), 0);
        let off = again.frames[0].iter().zip(&cold.frames[0]).map(|(a, b)| (a - b).norm()).fold(0.0, f64::max);
        assert!(
            off < 1e-4 && again.iterations() <= cold.iterations(),
            "{off} {} {}",
            again.iterations(),
            cold.iterations()
        );
        assert!(matches!(solve(Some(&cold.frames[0][1..])), Err(Error::Length { .. })));
    }
}
