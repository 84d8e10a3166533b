//! `caphy animate`

use super::figure::{Figure, Files, Motion};
use caphy::plugins::Plugins;
use caphy_core::Result;
use std::process::ExitCode;
use std::time::Instant;

pub(crate) const EXAMPLES: &str = "Examples:
  caphy animate --garment upper --garment lower --motion walk --out walk
  caphy animate --body SMPLX_NEUTRAL.npz --garment shirt.obj --motion 35_01.amc --format usd --out walk

Garments follow the body by skinning alone. --body, --garment and --motion take what `caphy show body|garment|motion` take.";

#[derive(clap::Args)]
pub(crate) struct Arguments {
    #[command(flatten)]
    figure: Figure,
    #[command(flatten)]
    motion: Motion,
    /// Frame rate [1/s].
    #[arg(long, default_value_t = 30.0)]
    fps: f64,
    #[command(flatten)]
    files: Files,
}

pub(crate) fn run(arguments: &Arguments, plugins: &Plugins) -> Result<ExitCode> {
    let started = Instant::now();
    let body = arguments.figure.body(plugins)?;
    let pelvis = body.skeleton(&body.rest(&arguments.figure.shape.shape))?.joints[0];
    let clip = arguments.motion.clip(arguments.fps, &pelvis)?;
    let dressed = arguments.figure.dress(&*body, clip, plugins)?;
    arguments.files.write(&dressed)?;
    eprintln!("{} frames in {:.1} s.", dressed.frame_count(), started.elapsed().as_secs_f64());
    Ok(ExitCode::SUCCESS)
}
