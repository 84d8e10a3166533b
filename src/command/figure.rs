//! What commands that move a dressed body have in common: body, garments, motion, and the files that come out.

use super::show::Shape;
use caphy::artifact::write_atomically;
use caphy::config::{ClipConfig, TRACKED_SMOOTHING, Translation};
use caphy::dressed::Dressed;
use caphy::inputs::{self, GarmentArgument, MotionArgument};
use caphy::motion::load;
use caphy::moving::{self, MovingFigure, MovingFormat};
use caphy::plugins::Plugins;
use caphy_core::body::BodyModel;
use caphy_core::motion::MotionClip;
use caphy_core::{Error, Result, Vec3};
use caphy_formats::motion::UpAxis;
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
    /// The .npz is a video tracker's, and this axis of its world points up: y, -y (most cameras), z, ...
    #[arg(long, value_name = "AXIS", allow_hyphen_values = true, conflicts_with = "gravity")]
    up: Option<String>,
    /// The .npz is a video tracker's, and things fall along this direction of its world: `0,0.9,0.4` for a camera that looks down a little.
    #[arg(long, value_name = "X,Y,Z", value_delimiter = ',', allow_hyphen_values = true)]
    gravity: Vec<f64>,
    /// Standard deviation of the Gaussian that smooths a tracker's poses [s]; 0 for none. [default: 0.03]
    #[arg(long, value_name = "S")]
    smoothing: Option<f64>,
    /// Frame rate of a tracker's video [1/s]; by default the file's own.
    #[arg(long, value_name = "FPS")]
    video_fps: Option<f64>,
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
        let mut named = MotionArgument::parse(&self.motion, self.seconds, self.translation)?;
        named.clip = self.tracked(named.clip)?;
        let mut clip = load(&named.files, &named.clip, None, fps, pelvis)?.clip;
        clip.poses.truncate((self.seconds * clip.fps).floor() as usize + 1);
        Ok(clip)
    }
    /// The clip as a tracker's, where options say so.
    fn tracked(&self, clip: ClipConfig) -> Result<ClipConfig> {
        let remedy = "leave it out, or give a tracker's .npz with `--up` or `--gravity`";
        if self.up.is_none() && self.gravity.is_empty() {
            let alone = [("--smoothing", self.smoothing.is_some()), ("--video-fps", self.video_fps.is_some())];
            return match alone.iter().find(|(_, given)| *given) {
                Some((option, _)) => Err(Error::config(*option, "says nothing of a file that is no tracker's", remedy)),
                None => Ok(clip),
            };
        }
        let option = if self.up.is_some() { "--up" } else { "--gravity" };
        let ClipConfig::Amass { path, translation } = clip else {
            return Err(Error::config(option, format!("`{}` is no .npz", self.motion), remedy));
        };
        let up = self.up.as_ref().map(|name| {
            let names = UpAxis::ALL.map(UpAxis::name);
            let found = UpAxis::ALL.into_iter().find(|axis| axis.name() == name);
            found.ok_or_else(|| Error::config("--up", format!("`{name}`"), format!("give one of {}", names.join(", "))))
        });
        let gravity = match &self.gravity[..] {
            [] => None,
            &[x, y, z] if [x, y, z].iter().all(|v| v.is_finite()) && [x, y, z] != [0.0; 3] => Some([x, y, z]),
            other => return Err(Error::config("--gravity", format!("{other:?}"), "give a direction: x,y,z")),
        };
        let smoothing_s = self.smoothing.unwrap_or(TRACKED_SMOOTHING);
        if !(smoothing_s.is_finite() && smoothing_s >= 0.0) {
            return Err(Error::config("--smoothing", smoothing_s.to_string(), "give 0 or a positive number"));
        }
        if let Some(fps) = self.video_fps.filter(|fps| !(fps.is_finite() && *fps > 0.0)) {
            return Err(Error::config("--video-fps", fps.to_string(), "give a positive number"));
        }
        Ok(ClipConfig::Tracked { path, up: up.transpose()?, gravity, translation, fps: self.video_fps, smoothing_s })
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
            say!("{}", file.display())?;
        }
        Ok(())
    }
}
