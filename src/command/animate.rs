//! `caphy animate`

use super::figure::{Figure, Files, Motion};
use caphy::avatar::Avatar;
use caphy::plugins::Plugins;
use caphy::stage::animate::{Played, PushOut, by_nets, perform};
use caphy::track::BodyTrack;
use caphy_core::{Error, Result};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Instant;

pub(crate) const EXAMPLES: &str = "Examples:
  caphy animate runs/quickstart/export/avatar.caphy --motion 35_01.amc --out walk
  caphy animate runs/quickstart/export/avatar.caphy --motion tracked.npz --gravity 0,0.9,0.4 --smoothing 0.05 --out video
  caphy animate --garment upper --garment lower --motion walk --out walk
  caphy animate --body SMPLX_NEUTRAL.npz --garment shirt.obj --motion 35_01.amc --format usd --out walk

An AVATAR's garments are moved by its nets; without one, garments follow the body by skinning alone. --body, --garment and
--motion take what `caphy show body|garment|motion` take.";

#[derive(clap::Args)]
pub(crate) struct Arguments {
    /// What a run has exported: body, garments and nets.
    #[arg(conflicts_with_all = ["garment", "shape", "resolution", "nearest_weights", "fps"])]
    avatar: Option<PathBuf>,
    #[command(flatten)]
    figure: Figure,
    #[command(flatten)]
    motion: Motion,
    /// Frame rate [1/s]; an avatar has its own.
    #[arg(long, default_value_t = 30.0)]
    fps: f64,
    /// Push an avatar's vertices that end up inside the body, or inside the garment below, out to this distance [m]; 0 leaves
    /// them.
    #[arg(long, default_value_t = 2e-3, requires = "avatar")]
    push_out: f64,
    #[command(flatten)]
    files: Files,
}

pub(crate) fn run(arguments: &Arguments, plugins: &Plugins) -> Result<ExitCode> {
    let started = Instant::now();
    let frames = match &arguments.avatar {
        Some(path) => avatar(arguments, path, plugins)?,
        None => {
            let body = arguments.figure.body(plugins)?;
            let pelvis = body.skeleton(&body.rest(&arguments.figure.shape.shape))?.joints[0];
            let clip = arguments.motion.clip(arguments.fps, &pelvis)?;
            let dressed = arguments.figure.dress(&*body, clip, plugins)?;
            arguments.files.write(&dressed)?;
            dressed.frame_count()
        }
    };
    note!("{frames} frames in {:.1} s.", started.elapsed().as_secs_f64());
    Ok(ExitCode::SUCCESS)
}

/// Plays an avatar; returns the number of frames.
fn avatar(arguments: &Arguments, path: &Path, plugins: &Plugins) -> Result<usize> {
    if !(arguments.push_out.is_finite() && arguments.push_out >= 0.0) {
        return Err(Error::config("--push-out", arguments.push_out.to_string(), "give 0 or a positive number"));
    }
    let avatar = Avatar::load(path)?;
    let scene = avatar.scene(arguments.figure.body.as_deref(), plugins)?;
    let fps = avatar.nets.first().map_or(arguments.fps, |n| n.fps);
    let clip = arguments.motion.clip(fps, &scene.rest_joints[0])?;
    let push = PushOut { gap: arguments.push_out, limit: 0.0, layering: avatar.layering };
    let net = avatar.net(plugins)?;
    let shapes = |track: &BodyTrack| by_nets(&avatar.garments, &avatar.nets, &net, track);
    let film = perform(&scene, &avatar.garments, clip, shapes, &push, &|_| {})?;
    for garment in &film.garments {
        note!(
            "{}: {:.2} % of vertices inside the body before they were pushed out, {:.1} mm at most",
            garment.kind,
            100.0 * garment.penetrating,
            garment.deepest_mm
        );
    }
    arguments.files.write(&Played {
        scene: &scene,
        garments: &avatar.garments,
        film: &film,
        colours: &avatar.colours,
    })?;
    Ok(film.clip.poses.len())
}
