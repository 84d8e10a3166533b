//! `caphy animate`

use super::show::Shape;
use caphy::artifact::write_atomically;
use caphy::config::Translation;
use caphy::dressed::Dressed;
use caphy::inputs::{self, GarmentArgument, MotionArgument};
use caphy::motion::load;
use caphy::moving::{self, MovingFormat};
use caphy::plugins::Plugins;
use caphy_core::{Error, Result};
use caphy_garment::skinning::WeightOptions;
use caphy_garment::template::{BodyRest, Tailor};
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Instant;

pub(crate) const EXAMPLES: &str = "Examples:
  caphy animate --garment upper --garment lower --motion walk --out walk
  caphy animate --body SMPLX_NEUTRAL.npz --garment shirt.obj --motion 35_01.amc --format usd --out walk

Garments follow the body by skinning alone. --body, --garment and --motion take what `caphy show body|garment|motion` take.";

/// Pictures on the preview.
const PREVIEW: usize = 16;

#[derive(clap::Args)]
pub(crate) struct Arguments {
    /// The body.
    #[arg(long, default_value = "mannequin")]
    body: String,
    #[command(flatten)]
    shape: Shape,
    /// A garment; may be given several times.
    #[arg(long)]
    garment: Vec<String>,
    /// The motion.
    #[arg(long)]
    motion: String,
    /// Files to write.
    #[arg(long, value_enum, default_value_t = MovingFormat::Glb)]
    format: MovingFormat,
    /// Folder of the files.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Frame rate [1/s].
    #[arg(long, default_value_t = 30.0)]
    fps: f64,
    /// Longest part of the clip that is played, and length of a generated motion [s].
    #[arg(long, default_value_t = 10.0)]
    seconds: f64,
    /// Edge length of garments that are cut on the body [m].
    #[arg(long, default_value_t = 0.02)]
    resolution: f64,
    /// Skin garments by their nearest body vertex, as the paper does, instead of by smoothed weights.
    #[arg(long)]
    nearest_weights: bool,
    /// What the translation of an .npz means.
    #[arg(long, value_enum, default_value_t)]
    translation: Translation,
}

pub(crate) fn run(arguments: &Arguments, plugins: &Plugins) -> Result<ExitCode> {
    let started = Instant::now();
    if !(arguments.seconds.is_finite() && arguments.seconds > 0.0) {
        return Err(Error::config("--seconds", arguments.seconds.to_string(), "give a positive number"));
    }
    let body = inputs::body(&arguments.body, plugins)?;
    let shape = &arguments.shape.shape;
    let rest = body.rest(shape);
    let mut templates = Vec::new();
    if !arguments.garment.is_empty() {
        let tailor = Tailor::new(BodyRest::from_model(&*body, &rest)?)?;
        for argument in &arguments.garment {
            let named = GarmentArgument::parse(argument, plugins)?;
            let style = named.worn(&tailor)?;
            templates.push(named.source().template(&tailor, &style, arguments.resolution)?);
        }
    }
    let named = MotionArgument::parse(&arguments.motion, arguments.seconds, arguments.translation)?;
    let pelvis = body.skeleton(&rest)?.joints[0];
    let mut clip = load(&named.files, &named.clip, None, arguments.fps, &pelvis)?.clip;
    clip.poses.truncate((arguments.seconds * clip.fps).floor() as usize + 1);
    let weights = if arguments.nearest_weights { WeightOptions::nearest() } else { WeightOptions::default() };
    let dressed = Dressed::new(&*body, shape, templates, &weights, clip)?;
    let mut files = moving::write(&dressed, arguments.format, &arguments.out)?;
    let preview = arguments.out.join("preview.png");
    write_atomically(&preview, &moving::preview(&dressed, PREVIEW)?)?;
    files.push(preview);
    for file in files {
        println!("{}", file.display());
    }
    eprintln!("{} frames in {:.1} s.", dressed.frame_count(), started.elapsed().as_secs_f64());
    Ok(ExitCode::SUCCESS)
}
