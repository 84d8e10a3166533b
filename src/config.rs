//! The one TOML file of an experiment.
//!
//! Unknown keys and types are errors that name the key, its line, and what exists. Every default stands beside its field
//! with its reason.

use crate::files::ProjectFiles;
use caphy_bodymodel::registration::RegistrationSettings;
use caphy_core::body::BodySpec;
use caphy_core::material::MaterialSpec;
use caphy_core::net::NetSpec;
use caphy_core::segmenter::SegmenterSpec;
use caphy_core::{Error, Result};
use caphy_garment::energy::{ContactOptions, LayeringOptions};
use caphy_garment::estimate::ForceBalanceSettings;
use caphy_garment::template::{RESOLUTION_RANGE, StyleRange};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// A whole experiment.
#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// Where results go and what seeds chance.
    pub run: RunConfig,
    /// The scans.
    pub subject: SubjectConfig,
    /// The naked body: `type = "mannequin" | "smplx"`.
    pub body: Box<dyn BodySpec>,
    /// Labels for rendered views: `type = "vertex" | "colour"`.
    pub segmenter: Box<dyn SegmenterSpec>,
    /// Views for label fusion.
    #[serde(default)]
    pub views: ViewsConfig,
    /// Fitting the body under the clothes.
    #[serde(default)]
    pub registration: RegistrationSettings,
    /// The garment on the torso.
    pub upper: GarmentConfig,
    /// The garment on the legs.
    pub lower: GarmentConfig,
    /// The deformation net: `type = "gru" | "mlp"`.
    pub net: Box<dyn NetSpec>,
    /// Motion to train on.
    pub motion: MotionConfig,
    /// Training.
    #[serde(default)]
    pub train: TrainConfig,
    /// Fabric estimation by Eq. 10.
    #[serde(default)]
    pub optimise: OptimiseConfig,
    /// Collision fine-tuning of both garments.
    #[serde(default)]
    pub finetune: FinetuneConfig,
    /// What is measured at the end.
    #[serde(default)]
    pub evaluate: EvaluateConfig,
    /// What the avatar plays at the end.
    pub animate: AnimateConfig,
}

/// `[run]`
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RunConfig {
    /// Folder of the results, relative to the configuration's folder unless absolute.
    pub out: PathBuf,
    /// Seed of everything random. Default 1.
    #[serde(default = "one")]
    pub seed: u64,
}

fn one() -> u64 {
    1
}

/// `[subject]`
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(tag = "type", rename_all = "lowercase", deny_unknown_fields)]
pub enum SubjectConfig {
    /// A generated person with known shape, style and fabric: scans are made first, then read like any other.
    Synthetic(SyntheticConfig),
    /// A folder of PLY or OBJ scans in metres, y up.
    Scans(ScansConfig),
}

/// `[subject] type = "synthetic"`
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SyntheticConfig {
    /// Number of scans.
    pub scans: usize,
    /// How many of them are held out, from the end. Default 1.
    #[serde(default = "one_scan")]
    pub held_out: usize,
    /// Standard deviation of the noise on every coordinate [m]. Default 0.5 mm, a good multi-camera rig.
    #[serde(default = "half_millimetre")]
    pub noise_m: f64,
    /// Edge length of the simulated garments [m]; finer than what the pipeline will use. Default 0.018.
    #[serde(default = "synthetic_resolution")]
    pub resolution_m: f64,
    /// The true fabric of the upper garment.
    pub upper_material: MaterialTable,
    /// The true fabric of the lower garment.
    pub lower_material: MaterialTable,
}

fn one_scan() -> usize {
    1
}
fn half_millimetre() -> f64 {
    0.5e-3
}
fn synthetic_resolution() -> f64 {
    0.018
}

/// `[subject] type = "scans"`
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ScansConfig {
    /// Folder with `*.ply` and `*.obj`.
    pub folder: PathBuf,
    /// Names (file stems) of scans that are kept for evaluation. Default none.
    #[serde(default)]
    pub held_out: Vec<String>,
}

/// A material that can be cloned: the table as it stands in the file.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(transparent)]
pub struct MaterialTable(pub toml::Table);

impl MaterialTable {
    /// The specification behind the table.
    pub fn spec(&self, key: &str) -> Result<Box<dyn MaterialSpec>> {
        self.0
            .clone()
            .try_into()
            .map_err(|e: toml::de::Error| Error::config(key, e.message().to_string(), "correct the key"))
    }
}

/// `[views]`
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ViewsConfig {
    /// Number of views around a scan. Default 32 (Sec. 3.1).
    pub count: usize,
    /// Width and height of a view [pixels]. Default 512.
    pub size: usize,
}

impl Default for ViewsConfig {
    fn default() -> Self {
        Self { count: 32, size: 512 }
    }
}

/// `[upper]` and `[lower]`
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GarmentConfig {
    /// The fabric that training starts from.
    pub material: MaterialTable,
    /// Number of styles that are tried as template. Default 30; the paper takes 300.
    #[serde(default = "thirty")]
    pub styles: usize,
    /// Edge length of the template [m]. Default 0.025: about 1000 vertices.
    #[serde(default = "template_resolution")]
    pub resolution_m: f64,
}

fn thirty() -> usize {
    30
}
fn template_resolution() -> f64 {
    0.025
}

/// `[motion]`
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MotionConfig {
    /// Frame rate that clips are resampled to [1/s]. Default 30 (Sec. 3.2).
    #[serde(default = "thirty_fps")]
    pub fps: f64,
    /// The clips.
    pub clips: Vec<ClipConfig>,
}

fn thirty_fps() -> f64 {
    30.0
}

/// One clip.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(tag = "type", rename_all = "snake_case", deny_unknown_fields)]
pub enum ClipConfig {
    /// A generated clip.
    Procedural {
        /// What the person does.
        kind: caphy_bodymodel::procedural_motion::MotionKind,
        /// Seed of its variation.
        #[serde(default = "one")]
        seed: u64,
        /// Length [s].
        seconds: f64,
    },
    /// An AMASS-style `.npz` (SMPL-H or SMPL-X).
    Amass {
        /// The file.
        path: PathBuf,
        /// What its `trans` means: `"body_offset"` (AMASS's own files, the default) or `"pelvis_position"` (clips retargeted
        /// from a skeleton). The file does not say.
        #[serde(default)]
        translation: Translation,
    },
    /// A CMU skeleton and its motion.
    AsfAmc {
        /// The `.asf` file.
        skeleton: PathBuf,
        /// The `.amc` file.
        path: PathBuf,
        /// Its frame rate [1/s]; the format does not say. Default 120 (CMU).
        #[serde(default = "cmu_fps")]
        fps: f64,
    },
}

fn cmu_fps() -> f64 {
    120.0
}

/// Meaning of `trans` in an AMASS-style file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Translation {
    /// What is added to the posed body.
    #[default]
    BodyOffset,
    /// Where the pelvis is.
    PelvisPosition,
}

/// Weights of the terms of Eqs. 6, 8 and 11. Energies are in joules, so 1 is physical.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TermWeights {
    /// Membrane strain. Default 1.
    pub strain: f64,
    /// Bending. Default 1.
    pub bending: f64,
    /// Gravity. Default 1.
    pub gravity: f64,
    /// Inertia. Default 1.
    pub inertia: f64,
    /// Body collision. Default 1: its own stiffness follows from `[train.contact]`.
    pub collision: f64,
    /// Waistband and neckline. Default 1: its own stiffness follows from the garment's weight.
    pub attachment: f64,
    /// λ3d of Eq. 8 [J/m²]: energy per squared metre of mean Chamfer distance. Default 300, so that 1 cm costs 30 mJ, about
    /// what a shirt's strain costs.
    pub scan: f64,
    /// Upper against lower garment, relative to the body's collision. Default 1.
    pub layering: f64,
}

impl Default for TermWeights {
    fn default() -> Self {
        Self {
            strain: 1.0,
            bending: 1.0,
            gravity: 1.0,
            inertia: 1.0,
            collision: 1.0,
            attachment: 1.0,
            scan: 300.0,
            layering: 1.0,
        }
    }
}

/// `[train]`
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TrainConfig {
    /// Rounds of one epoch of random windows and `scan_epochs` epochs of scan poses. Default 24.
    pub rounds: usize,
    /// Windows per epoch. Default 640; the paper takes 10000.
    pub windows: usize,
    /// Windows per step; at most 16 travel together. Default 16.
    pub batch: usize,
    /// Frames per window. Default 5 (Sec. 3.2).
    pub window: usize,
    /// Epochs of scan poses per epoch of windows. Default 4 (Sec. 3.3).
    pub scan_epochs: usize,
    /// Adam's first learning rate. Default 5e-4: at 1e-3 single garments left their minimum and did not come back.
    pub learning_rate: f64,
    /// The learning rate falls to this share by a cosine. Default 0.05.
    pub final_rate: f64,
    /// Largest norm of a gradient; longer ones are shortened. Default 1.
    pub clip_norm: f64,
    /// A frame's gradient counts at most this many times the batch's median. Default 3: captured bodies pass through
    /// themselves, and the forces of such a frame would drown the others. 0 takes every frame as it is.
    pub frame_clip: f64,
    /// Steps between checkpoints. Default 200.
    pub checkpoint_every: usize,
    /// Largest number of scan points per garment and scan in Eq. 9. Default 4000.
    pub scan_points: usize,
    /// A net's output of 1 displaces a vertex by this [m]. Default 0.02: wrinkles are centimetres, and Adam's first steps then
    /// move cloth by millimetres.
    pub output_scale_m: f64,
    /// How stiff the body's contact is.
    pub contact: ContactOptions,
    /// Weights of the terms.
    pub weights: TermWeights,
}

impl Default for TrainConfig {
    fn default() -> Self {
        Self {
            rounds: 24,
            windows: 640,
            batch: 16,
            window: 5,
            scan_epochs: 4,
            learning_rate: 5e-4,
            final_rate: 0.05,
            clip_norm: 1.0,
            frame_clip: 3.0,
            checkpoint_every: 200,
            scan_points: 4000,
            output_scale_m: 0.02,
            contact: ContactOptions { margin: 4e-3, ..ContactOptions::default() },
            weights: TermWeights::default(),
        }
    }
}

/// `[optimise]`
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct OptimiseConfig {
    /// Times that Eq. 10 and training alternate, at most 8. Default 1; 0 keeps the starting fabric.
    pub alternations: usize,
    /// λ_reg and bounds of Eq. 10.
    pub force_balance: ForceBalanceSettings,
    /// Rounds of training after each alternation. Default 8.
    pub rounds: usize,
}

impl Default for OptimiseConfig {
    fn default() -> Self {
        Self { alternations: 1, force_balance: ForceBalanceSettings::default(), rounds: 8 }
    }
}

/// `[finetune]`
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FinetuneConfig {
    /// Epochs, alternating random windows and scan poses. Default 10 (Sec. 3.5).
    pub epochs: usize,
    /// Windows per epoch of random poses. Default 480.
    pub windows: usize,
    /// Learning rate. Default 3e-4.
    pub learning_rate: f64,
    /// Which garment is outside (`order = "over" | "tucked"`), and how stiff their contact is.
    pub layering: LayeringOptions,
}

impl Default for FinetuneConfig {
    fn default() -> Self {
        Self { epochs: 10, windows: 480, learning_rate: 3e-4, layering: LayeringOptions::default() }
    }
}

/// `[evaluate]`
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct EvaluateConfig {
    /// A vertex deeper than this inside the body counts as penetrating [m]. Default 1 mm.
    pub penetration_m: f64,
    /// An `.npz` with true joints, arrays `<scan name>__joints55` of shape (55, 3) [m] in SMPL-X order, NaN where unknown. Only
    /// evaluation reads it.
    pub ground_truth: Option<PathBuf>,
}

impl Default for EvaluateConfig {
    fn default() -> Self {
        Self { penetration_m: 1e-3, ground_truth: None }
    }
}

/// `[animate]`
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AnimateConfig {
    /// The motion, not one that was trained on if you want to learn something from it.
    pub clip: ClipConfig,
    /// Most seconds of it that are played. Default 10.
    #[serde(default = "ten_seconds")]
    pub seconds: f64,
    /// Push garment vertices that end up inside the body, or inside the garment below, out to this distance [m]; 0 leaves them.
    /// Default 2 mm (SNUG).
    #[serde(default = "two_millimetres")]
    pub push_out_m: f64,
    /// Every n-th frame is also written as OBJ. Default 5; the GLB holds them all.
    #[serde(default = "every_fifth")]
    pub obj_every: usize,
}

fn every_fifth() -> usize {
    5
}
fn ten_seconds() -> f64 {
    10.0
}
fn two_millimetres() -> f64 {
    2e-3
}

impl Config {
    /// Parses and checks a configuration; `path` is for messages.
    pub fn parse(path: &Path, text: &str) -> Result<Config> {
        let config: Config = toml::from_str(text).map_err(|e| parse_error(path, text, &e, 0))?;
        for (key, table) in config.materials() {
            // Material tables are kept as written: their mistakes are looked for where the table stands.
            let at = key.split('.').fold(0, |from, part| find_word(text, part, from).unwrap_or(from));
            let spec: std::result::Result<Box<dyn MaterialSpec>, _> = table.0.clone().try_into();
            spec.map_err(|e| parse_error(path, text, &e, at))?;
        }
        config.check()?;
        Ok(config)
    }
    /// Reads and parses a file.
    pub fn read(path: &Path) -> Result<Config> {
        let text = std::fs::read_to_string(path).map_err(|e| Error::io(path, "read", e))?;
        Self::parse(path, &text)
    }
    /// All materials with their keys.
    fn materials(&self) -> Vec<(&'static str, &MaterialTable)> {
        let mut all = vec![("upper.material", &self.upper.material), ("lower.material", &self.lower.material)];
        if let SubjectConfig::Synthetic(s) = &self.subject {
            all.push(("subject.upper_material", &s.upper_material));
            all.push(("subject.lower_material", &s.lower_material));
        }
        all
    }
    /// Refuses paths that lead to no file, before hours are spent on the way to the stage that reads them.
    ///
    /// # Errors
    /// [`Error::Config`] naming the key and the path.
    pub fn check_files(&self, files: &ProjectFiles) -> Result<()> {
        let mut named: Vec<(&str, &Path)> = Vec::new();
        let clips = self.motion.clips.iter().map(|clip| ("motion.clips", clip));
        for (key, clip) in clips.chain([("animate.clip", &self.animate.clip)]) {
            match clip {
                ClipConfig::Procedural { .. } => {}
                ClipConfig::Amass { path, .. } => named.push((key, path)),
                ClipConfig::AsfAmc { skeleton, path, .. } => named.extend([(key, &**skeleton), (key, &**path)]),
            }
        }
        named.extend(self.evaluate.ground_truth.as_deref().map(|path| ("evaluate.ground_truth", path)));
        for (key, path) in named {
            let resolved = files.resolve(path)?;
            if !resolved.is_file() {
                return Err(Error::config(key, format!("{} is not a file", resolved.display()), "correct the path"));
            }
        }
        Ok(())
    }
    fn check(&self) -> Result<()> {
        let positive = |key: &str, value: f64| {
            if value.is_finite() && value > 0.0 {
                Ok(())
            } else {
                Err(Error::config(key, format!("{value}"), "give a positive number"))
            }
        };
        let count = |key: &str, value: usize, least: usize, most: usize| {
            if (least..=most).contains(&value) {
                Ok(())
            } else {
                Err(Error::config(key, format!("{value}"), format!("give {least} to {most}")))
            }
        };
        let not_negative = |key: &str, value: f64| {
            if value.is_finite() && value >= 0.0 {
                Ok(())
            } else {
                Err(Error::config(key, format!("{value}"), "give 0 or a positive number"))
            }
        };
        let resolution = |key: &str, value: f64| {
            let StyleRange { lower, upper, .. } = RESOLUTION_RANGE;
            if (lower..=upper).contains(&value) {
                Ok(())
            } else {
                Err(Error::config(key, format!("{value}"), format!("give {lower} to {upper} m")))
            }
        };
        for (key, material) in self.materials() {
            material.spec(key)?.build().map_err(|error| match error {
                // A material knows its own keys only.
                Error::Config { key: own, problem, remedy } => {
                    let own = own.strip_prefix("material.").unwrap_or(&own);
                    Error::config(format!("{key}.{own}"), problem, remedy)
                }
                other => other,
            })?;
        }
        for (name, garment) in [("upper", &self.upper), ("lower", &self.lower)] {
            count(&format!("{name}.styles"), garment.styles, 1, 100_000)?;
            resolution(&format!("{name}.resolution_m"), garment.resolution_m)?;
        }
        for (key, clip) in
            self.motion.clips.iter().map(|c| ("motion.clips", c)).chain([("animate.clip", &self.animate.clip)])
        {
            match clip {
                ClipConfig::Procedural { seconds, .. } => positive(&format!("{key}.seconds"), *seconds)?,
                ClipConfig::Amass { .. } => {}
                ClipConfig::AsfAmc { fps, .. } => positive(&format!("{key}.fps"), *fps)?,
            }
        }
        self.registration.check()?;
        // Sizes that no net can have; the real numbers of inputs and outputs follow from body and garment.
        self.net.build(1, 3)?;
        if let SubjectConfig::Synthetic(s) = &self.subject {
            count("subject.scans", s.scans, 2, 1000)?;
            count("subject.held_out", s.held_out, 0, s.scans - 1)?;
            not_negative("subject.noise_m", s.noise_m)?;
            resolution("subject.resolution_m", s.resolution_m)?;
        }
        count("views.count", self.views.count, 1, 10_000)?;
        count("views.size", self.views.size, 16, 16_384)?;
        count("motion.clips", self.motion.clips.len(), 1, 1_000_000)?;
        positive("motion.fps", self.motion.fps)?;
        let train = &self.train;
        count("train.batch", train.batch, 1, 16)?;
        count("train.window", train.window, 1, 1000)?;
        count("train.windows", train.windows, 1, usize::MAX)?;
        count("train.checkpoint_every", train.checkpoint_every, 1, usize::MAX)?;
        count("optimise.alternations", self.optimise.alternations, 0, 8)?;
        positive("train.learning_rate", train.learning_rate)?;
        positive("train.final_rate", train.final_rate)?;
        positive("train.clip_norm", train.clip_norm)?;
        if train.final_rate > 1.0 {
            return Err(Error::config("train.final_rate", format!("{}", train.final_rate), "give a share, at most 1"));
        }
        positive("train.output_scale_m", train.output_scale_m)?;
        count("train.scan_points", train.scan_points, 1, usize::MAX)?;
        let TermWeights { strain, bending, gravity, inertia, collision, attachment, scan, layering } = train.weights;
        for (name, weight) in [
            ("strain", strain),
            ("bending", bending),
            ("gravity", gravity),
            ("inertia", inertia),
            ("collision", collision),
            ("attachment", attachment),
            ("scan", scan),
            ("layering", layering),
        ] {
            not_negative(&format!("train.weights.{name}"), weight)?;
        }
        let ContactOptions { margin, allowed_depth, load } = train.contact;
        not_negative("train.contact.margin", margin)?;
        positive("train.contact.allowed_depth", allowed_depth)?;
        not_negative("train.contact.load", load)?;
        let layering = &self.finetune.layering;
        not_negative("finetune.layering.margin", layering.margin)?;
        not_negative("finetune.layering.reach", layering.reach)?;
        not_negative("finetune.layering.weight", layering.weight)?;
        not_negative("optimise.force_balance.regularisation", self.optimise.force_balance.regularisation)?;
        not_negative("evaluate.penetration_m", self.evaluate.penetration_m)?;
        not_negative("animate.push_out_m", self.animate.push_out_m)?;
        positive("finetune.learning_rate", self.finetune.learning_rate)?;
        let factor = self.optimise.force_balance.largest_factor;
        if factor.is_nan() || factor < 1.0 {
            let key = "optimise.force_balance.largest_factor";
            return Err(Error::config(key, factor.to_string(), "give a number of at least 1"));
        }
        count("animate.obj_every", self.animate.obj_every, 1, usize::MAX)?;
        positive("animate.seconds", self.animate.seconds)
    }
}

/// Line and column of the TOML parser's error, or of the key it names when a plugin's table lost its place.
///
/// `from` is where the table stands whose place was lost.
fn parse_error(path: &Path, text: &str, error: &toml::de::Error, from: usize) -> Error {
    let message = error.message().trim().to_string();
    let named = message
        .strip_prefix("unknown field `")
        .or_else(|| message.strip_prefix("unknown variant `"))
        .and_then(|rest| rest.split('`').next());
    let from = error.span().map_or(from, |s| s.start);
    let place = named.and_then(|name| find_word(text, name, from).or_else(|| find_word(text, name, 0))).unwrap_or(from);
    let before = &text[..place.min(text.len())];
    let line = before.matches('\n').count() + 1;
    let column = before.rsplit('\n').next().map_or(0, |l| l.chars().count()) + 1;
    let remedy = if named.is_some() { "correct or remove it" } else { "correct the line" };
    Error::format(path, format!("line {line}, column {column}"), message, remedy)
}

/// Byte position of a whole word at or after `from`.
fn find_word(text: &str, word: &str, from: usize) -> Option<usize> {
    let is_word = |c: char| c.is_alphanumeric() || c == '_' || c == '-';
    text[from..].match_indices(word).map(|(i, _)| i + from).find(|&i| {
        !text[..i].chars().next_back().is_some_and(is_word)
            && !text[i + word.len()..].chars().next().is_some_and(is_word)
    })
}
