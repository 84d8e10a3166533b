//! What commands that move a dressed body have in common: body, garments, motion, and the files that come out.

use super::show::Shape;
use caphy::artifact::write_atomically;
use caphy::config::Translation;
use caphy::dressed::Dressed;
use caphy::inputs::{self, GarmentArgument, MotionArgument};
use caphy::motion::load;
use caphy::moving::{self, MovingFigure, MovingFormat};
use caphy::plugins::Plugins;
use caphy_core::body::BodyModel;
use caphy_core::motion::MotionClip;
use caphy_core::{Error, Result, Vec3};
use caphy_garment::skinning::WeightOptions;
use caphy_garment::template::{BodyRest, Tailor};
use std::path::PathBuf;

/// Pictures on the preview.
const PREVIEW: usize = 16;

/// Which body wears what.
#[derive(clap::Args)]
pub(crate) struct Figure {
    /// The body. [default: mannequin]
    #[arg(long)]
    pub(crate) body: Option<String>,
    #[command(flatten)]
    pub(crate) shape: Shape,
    /// A garment; may be given several times.
    #[arg(long)]
    pub(crate) garment: Vec<String>,
    /// Edge length of garments that are cut on the body [m].
    #[arg(long, default_value_t = 0.02)]
    pub(crate) resolution: f64,
    /// Skin garments by their nearest body vertex, as the paper does, instead of by smoothed weights.
    #[arg(long)]
    pub(crate) nearest_weights: bool,
}

/// How it moves.
#[derive(clap::Args)]
pub(crate) struct Motion {
    /// The motion.
    #[arg(long)]
    motion: String,
    /// Longest part of the clip that is played, and length of a generated motion [s].
    #[arg(long, default_value_t = 10.0)]
    seconds: f64,
    /// What the translation of an .npz means.
    #[arg(long, value_enum, default_value_t)]
    translation: Translation,
}

/// What is written.
#[derive(clap::Args)]
pub(crate) struct Files {
    /// Files to write.
    #[arg(long, value_enum, default_value_t = MovingFormat::Glb)]
    format: MovingFormat,
    /// Folder of the files.
    #[arg(long, value_name = "DIR")]
    pub(crate) out: PathBuf,
}

impl Figure {
    pub(crate) fn body(&self, plugins: &Plugins) -> Result<Box<dyn BodyModel>> {
        inputs::body(self.body.as_deref().unwrap_or("mannequin"), plugins)
    }
    /// How garments take their weights from the body.
    pub(crate) fn weights(&self) -> WeightOptions {
        if self.nearest_weights { WeightOptions::nearest() } else { WeightOptions::default() }
    }
    /// Dresses the body for a clip.
    pub(crate) fn dress<'a>(
        &self,
        body: &'a dyn BodyModel,
        clip: MotionClip,
        plugins: &Plugins,
    ) -> Result<Dressed<'a>> {
        let shape = &self.shape.shape;
        let mut templates = Vec::new();
        if !self.garment.is_empty() {
            let tailor = Tailor::new(BodyRest::from_model(body, &body.rest(shape))?)?;
            for argument in &self.garment {
                let named = GarmentArgument::parse(argument, plugins)?;
                let style = named.worn(&tailor)?;
                templates.push(named.source().template(&tailor, &style, self.resolution)?);
            }
        }
        Dressed::new(body, shape, templates, &self.weights(), clip)
    }
}

impl Motion {
    /// The clip at a frame rate [1/s], with the body's rest pelvis [m].
    pub(crate) fn clip(&self, fps: f64, pelvis: &Vec3) -> Result<MotionClip> {
        if !(self.seconds.is_finite() && self.seconds > 0.0) {
            return Err(Error::config("--seconds", self.seconds.to_string(), "give a positive number"));
        }
        let named = MotionArgument::parse(&self.motion, self.seconds, self.translation)?;
        let mut clip = load(&named.files, &named.clip, None, fps, pelvis)?.clip;
        clip.poses.truncate((self.seconds * clip.fps).floor() as usize + 1);
        Ok(clip)
    }
}

impl Files {
    /// Writes a figure with a preview and prints the files' names.
    pub(crate) fn write(&self, figure: &dyn MovingFigure) -> Result<()> {
        let mut files = moving::write(figure, self.format, &self.out)?;
        let preview = self.out.join("preview.png");
        write_atomically(&preview, &moving::preview(figure, PREVIEW)?)?;
        files.push(preview);
        for file in files {
            println!("{}", file.display());
        }
        Ok(())
    }
}
