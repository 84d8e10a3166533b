//! `caphy simulate`

use super::figure::{Figure, Files, Motion};
use super::json;
use caphy::artifact::write_atomically;
use caphy::inputs;
use caphy::plugins::Plugins;
use caphy::progress::Progress;
use caphy::simulate::{SimulationOptions, Steps};
use caphy_core::material::MaterialModel;
use caphy_core::{Error, Result};
use caphy_garment::energy::LayeringOrder;
use caphy_garment::solver::{Forces, SolveReport, SolverSettings};
use serde::Serialize;
use std::process::ExitCode;
use std::sync::Arc;
use std::time::Instant;

pub(crate) const EXAMPLES: &str = "Examples:
  caphy simulate --garment upper --material gray-interlock --motion walk --seconds 2 --out swing
  caphy simulate --garment upper --garment lower --material knit.toml --material denim.toml --motion 35_01.amc --steps quasi_static --out walk

The reference solver minimises the energies of every frame directly, without a network. --body, --garment and --motion take what
`caphy show body|garment|motion` take. MATERIAL is one of the ten fabrics (`caphy show fabrics`), or a TOML file that holds what
an experiment's material table holds. Beside the files, DIR/simulation.json says how each frame was solved.";

#[derive(clap::Args)]
pub(crate) struct Arguments {
    #[command(flatten)]
    figure: Figure,
    /// The fabric of each garment, in their order; one for all may stand alone.
    #[arg(long, required = true)]
    material: Vec<String>,
    #[command(flatten)]
    motion: Motion,
    /// At rest in every frame, or in motion.
    #[arg(long, value_enum, default_value_t = Steps::Dynamic)]
    steps: Steps,
    /// Frame rate, and the time step of motion [1/s].
    #[arg(long, default_value_t = 30.0)]
    fps: f64,
    /// Coulomb's friction coefficient of cloth on what is underneath.
    #[arg(long, default_value_t = 0.0)]
    friction: f64,
    /// Largest force that may be left on a vertex [N].
    #[arg(long, default_value_t = 1e-5)]
    tolerance: f64,
    /// The upper garment is tucked into the lower one.
    #[arg(long)]
    tucked: bool,
    #[command(flatten)]
    files: Files,
}

/// One garment in `simulation.json`.
#[derive(Serialize)]
struct Solved<'a> {
    garment: String,
    vertices: usize,
    frames: &'a [SolveReport],
}

pub(crate) fn run(arguments: &Arguments, plugins: &Plugins) -> Result<ExitCode> {
    let started = Instant::now();
    let body = arguments.figure.body(plugins)?;
    let pelvis = body.skeleton(&body.rest(&arguments.figure.shape.shape))?.joints[0];
    let clip = arguments.motion.clip(arguments.fps, &pelvis)?;
    let mut dressed = arguments.figure.dress(&*body, clip, plugins)?;
    let count = dressed.worn().len();
    if count == 0 {
        return Err(Error::config("--garment", "is not given", "name what is to be simulated, such as `upper`"));
    }
    let mut materials: Vec<Arc<dyn MaterialModel>> = Vec::new();
    for argument in &arguments.material {
        materials.push(Arc::from(inputs::material(argument, plugins)?));
    }
    if let [one] = &materials[..] {
        materials = vec![one.clone(); count];
    }
    if materials.len() != count {
        let problem = format!("{} fabrics for {count} garments", materials.len());
        return Err(Error::config("--material", problem, "give one for all, or one for each in their order"));
    }
    let options = SimulationOptions {
        steps: arguments.steps,
        fps: dressed.fps(),
        forces: Forces::default(),
        settings: SolverSettings {
            friction: arguments.friction,
            tolerance_n: arguments.tolerance,
            ..SolverSettings::default()
        },
        disturbance: None,
    };
    let order = if arguments.tucked { LayeringOrder::Tucked } else { LayeringOrder::Over };
    let progress = Progress::start("simulate");
    let solved = dressed.simulate(&materials, order, &options, &|share, text| progress.set(share, text))?;
    progress.finish();
    let list: Vec<Solved<'_>> = dressed
        .worn()
        .iter()
        .zip(&solved)
        .map(|(g, s)| Solved { garment: g.kind.to_string(), vertices: g.mesh.vertices.len(), frames: &s.reports })
        .collect();
    write_atomically(&arguments.files.out.join("simulation.json"), json(&list)?.as_bytes())?;
    arguments.files.write(&dressed)?;
    say!("{}", arguments.files.out.join("simulation.json").display())?;
    for (garment, simulation) in dressed.worn().iter().zip(&solved) {
        note!(
            "{}: {} vertices, {} steps, largest force left {:.1e} N, {} of {} frames not converged",
            garment.kind,
            garment.mesh.vertices.len(),
            simulation.iterations(),
            simulation.worst_residual_n(),
            simulation.unconverged(),
            simulation.frames.len()
        );
    }
    note!("{} frames in {:.1} s.", dressed.frame_count(), started.elapsed().as_secs_f64());
    Ok(ExitCode::SUCCESS)
}
