//! `caphy show`

use super::json;
use caphy::artifact::write_atomically;
use caphy::config::Translation;
use caphy::inputs::{self, GarmentArgument, MotionArgument};
use caphy::motion::load;
use caphy::plugins::Plugins;
use caphy::show::{body, fabrics, garment, motion};
use caphy_core::motion::MotionLimits;
use caphy_core::{Result, TriMesh};
use caphy_garment::template::{BodyRest, Tailor, templates};
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

const BODY_EXAMPLES: &str = "Examples:
  caphy show body mannequin --picture mannequin.png
  caphy show body SMPLX_NEUTRAL.npz --shape 1.5,-0.5 --json

BODY is a type without keys, an .npz in the SMPL-X layout, or a TOML file with an experiment's [body] table.";

const GARMENT_EXAMPLES: &str = "Examples:
  caphy show garment upper --count 8 --picture shirts.png
  caphy show garment upper:0.4,0.5,0.02,0.1
  caphy show garment trousers.obj --body SMPLX_NEUTRAL.npz --json

GARMENT is `upper` or `lower` (cut on the body), an OBJ or PLY garment on the T-posed body, a folder of them, an .npz with a
linear style space, or a TOML file with an experiment's `template` table. Behind a colon: style values, in the order in which
they are listed.";

const MOTION_EXAMPLES: &str = "Examples:
  caphy show motion walk
  caphy show motion 35_01.amc --picture walk.png
  caphy show motion clip.npz --translation pelvis_position --json

CLIP is a generated motion (walk, squat, reach, turn, twist), an .npz (AMASS), a .bvh, an .amc beside its .asf, or a TOML file
with an experiment's clip table.";

#[derive(clap::Subcommand)]
pub(crate) enum What {
    /// The ten measured fabrics.
    #[command(
        after_help = "Examples:\n  caphy show fabrics\n  caphy show fabrics --json\n  caphy show fabrics --plot fabrics/"
    )]
    Fabrics {
        /// All numbers as a JSON array of ten objects.
        #[arg(long)]
        json: bool,
        /// Write stress-strain and bending curves of each fabric into this folder.
        #[arg(long, value_name = "DIR")]
        plot: Option<PathBuf>,
    },
    /// A body: its surface, joints and coefficients; poses of it.
    #[command(after_help = BODY_EXAMPLES)]
    Body {
        /// The body.
        body: String,
        #[command(flatten)]
        shape: Shape,
        #[command(flatten)]
        form: Form,
    },
    /// Garments: samples of a style space, or files made ready to be worn.
    #[command(after_help = GARMENT_EXAMPLES)]
    Garment {
        /// The garment.
        garment: String,
        /// The body that they are for.
        #[arg(long, default_value = "mannequin")]
        body: String,
        #[command(flatten)]
        shape: Shape,
        /// Number of samples of a style space.
        #[arg(long, default_value_t = 4)]
        count: usize,
        /// Seed of the samples.
        #[arg(long, default_value_t = 1)]
        seed: u64,
        /// Edge length [m].
        #[arg(long, default_value_t = 0.02)]
        resolution: f64,
        #[command(flatten)]
        form: Form,
    },
    /// A motion clip: duration, rates, ranges, what is dropped and why; frames of it.
    #[command(after_help = MOTION_EXAMPLES)]
    Motion {
        /// The clip.
        clip: String,
        /// The body that moves by it.
        #[arg(long, default_value = "mannequin")]
        body: String,
        #[command(flatten)]
        shape: Shape,
        /// Frame rate to resample to [1/s].
        #[arg(long, default_value_t = 30.0)]
        fps: f64,
        /// Length of a generated motion [s].
        #[arg(long, default_value_t = 4.0)]
        seconds: f64,
        /// Frames that are used together: windows that damage touches are dropped.
        #[arg(long, default_value_t = 5)]
        window: usize,
        /// What the translation of an .npz means.
        #[arg(long, value_enum, default_value_t)]
        translation: Translation,
        #[command(flatten)]
        form: Form,
    },
}

/// Shape of a body.
#[derive(clap::Args)]
pub(crate) struct Shape {
    /// Shape coefficients, comma separated; those left out are 0.
    #[arg(long, value_delimiter = ',', allow_hyphen_values = true)]
    pub(crate) shape: Vec<f64>,
}

/// Form of the answer.
#[derive(clap::Args)]
pub(crate) struct Form {
    /// Answer as JSON instead of text.
    #[arg(long)]
    json: bool,
    /// Write a contact sheet to this PNG.
    #[arg(long, value_name = "FILE")]
    picture: Option<PathBuf>,
}

impl Form {
    fn answer<F: Serialize>(
        &self,
        facts: &F,
        text: impl FnOnce(&F) -> String,
        picture: impl FnOnce() -> Result<Vec<u8>>,
    ) -> Result<()> {
        if self.json {
            say!("{}", json(facts)?)?;
        } else {
            tell!("{}", text(facts))?;
        }
        if let Some(path) = &self.picture {
            write_atomically(Path::new(path), &picture()?)?;
            note!("Picture: {}", path.display());
        }
        Ok(())
    }
}

pub(crate) fn run(what: &What, plugins: &Plugins) -> Result<ExitCode> {
    match what {
        What::Fabrics { json: as_json, plot } => {
            if let Some(folder) = plot {
                let page = fabrics::plot(folder)?;
                note!("Curves: {}", page.display());
            }
            if *as_json {
                say!("{}", json(&fabrics::facts()?)?)?;
            } else if plot.is_none() {
                tell!("{}", fabrics::table()?)?;
            }
        }
        What::Body { body: name, shape, form } => {
            let model = inputs::body(name, plugins)?;
            let facts = body::facts(&*model, &shape.shape)?;
            form.answer(&facts, body::text, || body::sheet(&*model, &shape.shape))?;
        }
        What::Garment { garment: name, body, shape, count, seed, resolution, form } => {
            let model = inputs::body(body, plugins)?;
            let rest = model.rest(&shape.shape);
            let tailor = Tailor::new(BodyRest::from_model(&*model, &rest)?)?;
            let named = GarmentArgument::parse(name, plugins)?;
            let styles = named.styles(&tailor, *count, *seed)?;
            let made = templates(named.source(), &tailor, &styles, *resolution)?;
            let facts: Vec<_> = made.iter().map(caphy_garment::template::Template::facts).collect();
            let surface = TriMesh { vertices: model.forward(&rest)?.vertices, faces: model.describe().faces.clone() };
            form.answer(&facts, |all| all.iter().map(garment::text).collect(), || garment::sheet(&surface, &made))?;
        }
        What::Motion { clip, body, shape, fps, seconds, window, translation, form } => {
            let model = inputs::body(body, plugins)?;
            let named = MotionArgument::parse(clip, *seconds, *translation)?;
            let pelvis = model.skeleton(&model.rest(&shape.shape))?.joints[0];
            let prepared = load(&named.files, &named.clip, Some(&MotionLimits::default()), *fps, &pelvis)?;
            let facts = prepared.facts(*window);
            form.answer(&facts, motion::text, || motion::sheet(&*model, &shape.shape, &prepared))?;
        }
    }
    Ok(ExitCode::SUCCESS)
}
