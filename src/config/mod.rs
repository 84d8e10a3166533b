//! The one TOML file of an experiment.
//!
//! Unknown keys and types are errors that name the key, its line, and what exists. Every default stands beside its field
//! with its reason.

mod budget;
mod check;
mod optimise;
mod perceptual;
pub(crate) mod place;
mod set;
mod silent;
mod synthetic;
mod tradeoff;
mod weights;

pub use budget::{BudgetConfig, Choice};
pub use optimise::{EstimatorConfig, Inner, OptimiseConfig, WornAlternation, WornEquilibrium};
pub use perceptual::PerceptualConfig;
pub use set::Setting;
pub use synthetic::{RestScale, RigConfig, SyntheticConfig, Texture};
pub use tradeoff::TradeoffConfig;
pub use weights::{Ramp, Schedule, TermWeights};

use crate::files::ProjectFiles;
use crate::motion::variation::MotionVariation;
use crate::plugins::{Kind, PluginTable, Plugins};
use caphy_bodymodel::registration::RegistrationSettings;
use caphy_core::motion::MotionLimits;
use caphy_core::{Error, Result};
use caphy_formats::motion::UpAxis;
use caphy_garment::energy::{ContactOptions, LayeringOptions};
use caphy_garment::skinning::WeightOptions;
use caphy_garment::solver::SolverSettings;
use caphy_garment::template::GarmentKind;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// A whole experiment.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// Where results go and what seeds chance.
    pub run: RunConfig,
    /// The scans.
    pub subject: SubjectConfig,
    /// Libraries with types of your own; their types can be chosen in the tables below.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub plugin: Vec<PluginConfig>,
    /// The naked body: `type = "mannequin" | "smplx"`.
    pub body: PluginTable,
    /// Labels for rendered views: `type = "vertex" | "colour" | "labels" | "onnx"`. Scans need it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub segmenter: Option<PluginTable>,
    /// Views for label fusion.
    #[serde(default)]
    pub views: ViewsConfig,
    /// Fitting the body under the clothes.
    #[serde(default)]
    pub registration: RegistrationSettings,
    /// What garments are compared with.
    #[serde(default)]
    pub templates: TemplatesConfig,
    /// The garment on the torso; none when it is left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub upper: Option<GarmentConfig>,
    /// The garment on the legs; none when it is left out. One of both there must be.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lower: Option<GarmentConfig>,
    /// The deformation net: `type = "gru" | "mlp"`.
    pub net: PluginTable,
    /// Motion to train on.
    pub motion: MotionConfig,
    /// Training.
    #[serde(default)]
    pub train: TrainConfig,
    /// Fabric estimation.
    #[serde(default)]
    pub optimise: OptimiseConfig,
    /// Collision fine-tuning of both garments.
    #[serde(default)]
    pub finetune: FinetuneConfig,
    /// What is measured at the end.
    #[serde(default)]
    pub evaluate: EvaluateConfig,
    /// Comparison of trained nets with the reference solver; none when it is left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub compare: Option<CompareConfig>,
    /// What the avatar plays at the end; nothing when it is left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub animate: Option<AnimateConfig>,
    /// What `caphy tradeoff` measures on; a run does not look at it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tradeoff: Option<TradeoffConfig>,
    /// Picks a point of a measured front in place of knobs that the file does not set. A resolved configuration holds what it picked,
    /// and no budget.
    #[serde(default, skip_serializing)]
    pub budget: Option<BudgetConfig>,
    /// What the budget picked.
    #[serde(skip)]
    pub choice: Option<Choice>,
}

/// `[[plugin]]`
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PluginConfig {
    /// The library (`.so`, `.dylib`, `.dll`), relative to the configuration's folder unless absolute.
    pub path: PathBuf,
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

fn is_zero(seed: &u64) -> bool {
    *seed == 0
}

/// `[subject]`
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(tag = "type", rename_all = "lowercase", deny_unknown_fields)]
pub enum SubjectConfig {
    /// A generated person with known shape, style and fabric: scans are made first, then read like any other.
    Synthetic(Box<SyntheticConfig>),
    /// A folder of PLY or OBJ scans.
    Scans(ScansConfig),
    /// Nobody's scans: a body of a given shape in given garments, whose nets learn from physics alone.
    Dressed(DressedConfig),
}

/// `[subject] type = "dressed"`
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DressedConfig {
    /// Shape coefficients of the body; those left out are 0. Default none.
    #[serde(default)]
    pub shape: Vec<f64>,
}

/// `[subject] type = "scans"`
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ScansConfig {
    /// Folder with `*.ply` and `*.obj`.
    pub folder: PathBuf,
    /// The scans of the folder that count, by name (file stems). Default: all.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub only: Vec<String>,
    /// Scans that are kept for evaluation: names (file stems), or a share that `run.seed` draws, whole sequences where there are
    /// some. Default 0.2, as in the paper.
    #[serde(default)]
    pub held_out: HeldOut,
    /// Unit of positions: `"m"`, `"cm"`, `"mm"`, `"in"`. Default: of metres, centimetres and millimetres the one in which a scan
    /// is a person.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub units: Option<LengthUnit>,
    /// Upward axis: `"y"`, `"z"`, `"-y"`, … Default: the way up in which the body fits each scan best.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub up: Option<UpAxis>,
    /// An `.npz` with rough poses, of a keypoint fit say: `<scan>__full_pose` (joints, 3) [rad] and perhaps `<scan>__translation`
    /// (3) [m], in metres with y up. Default none: poses are searched for.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub starts: Option<PathBuf>,
}

/// Scans that nothing is learnt from.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(untagged, expecting = "a list of names of scans, or a share of them as 0.2")]
pub enum HeldOut {
    /// These, by name.
    Names(Vec<String>),
    /// A share of all, drawn by the seed [1].
    Share(f64),
}

impl Default for HeldOut {
    fn default() -> Self {
        Self::Share(0.2)
    }
}

/// A unit of length.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum LengthUnit {
    /// Metres.
    #[serde(rename = "m")]
    Metre,
    /// Centimetres.
    #[serde(rename = "cm")]
    Centimetre,
    /// Millimetres.
    #[serde(rename = "mm")]
    Millimetre,
    /// Inches.
    #[serde(rename = "in")]
    Inch,
}

impl LengthUnit {
    /// Its length [m].
    pub fn metres(self) -> f64 {
        match self {
            Self::Metre => 1.0,
            Self::Centimetre => 0.01,
            Self::Millimetre => 0.001,
            Self::Inch => 0.0254,
        }
    }
}

impl std::fmt::Display for LengthUnit {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Metre => "metres",
            Self::Centimetre => "centimetres",
            Self::Millimetre => "millimetres",
            Self::Inch => "inches",
        })
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

/// `[templates]`
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TemplatesConfig {
    /// Scans that garments are cut by, those nearest to the standard pose. Default 6; the paper takes one, whose folds then are in the cut.
    pub scans: usize,
}

impl Default for TemplatesConfig {
    fn default() -> Self {
        Self { scans: 6 }
    }
}

/// `[upper]` and `[lower]`
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GarmentConfig {
    /// The fabric that training starts from; `docs/scans.md` says which one to take for which garment.
    pub material: PluginTable,
    /// Its mass [g], weighed: sets the area density, without which scans at rest only show stiffness over density. Default: the
    /// fabric's density.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mass_g: Option<f64>,
    /// Number of styles that are tried as template. Default 30; the paper takes 300.
    #[serde(default = "thirty")]
    pub styles: usize,
    /// How many of them, those nearest by skinning alone, are brought to rest on the body and compared again; the best is then refined
    /// as it is worn. Default 6. 0 compares and refines by skinning alone: seconds faster, lengths off by centimetres.
    #[serde(default = "six")]
    pub worn: usize,
    /// The fabric that they are worn in. Default: `material`, whose change then costs the fit of bodies and templates again.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub worn_in: Option<PluginTable>,
    /// Edge length of the template [m]. Default 0.025: about 1000 vertices.
    #[serde(default = "template_resolution")]
    pub resolution_m: f64,
    /// Where templates come from: `type = "parametric" | "mesh" | "folder" | "linear"`. Default `parametric`: cut on the body.
    #[serde(default = "parametric")]
    pub template: PluginTable,
    /// How the garment takes its skinning weights from the body.
    #[serde(default)]
    pub weights: WeightOptions,
    /// The style of a dressed subject's garment: values of the style space, or coefficients of a linear one. Default: the
    /// middle of the space, a linear space's mean, the only garment of a file. With scans, the style is found.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub style: Option<Vec<f64>>,
}

fn parametric() -> PluginTable {
    PluginTable::of_type("parametric")
}

fn thirty() -> usize {
    30
}
fn six() -> usize {
    6
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
    /// What counts as damage: windows that it touches are not drawn. Infinite limits let everything pass.
    #[serde(default)]
    pub limits: MotionLimits,
    /// Copies of the clips that differ from them, for training.
    #[serde(default)]
    pub variation: MotionVariation,
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
    /// An AMASS-style `.npz` (SMPL, SMPL-H or SMPL-X), z up.
    Amass {
        /// The file.
        path: PathBuf,
        /// What its `trans` means: `"body_offset"` (AMASS's own files, the default) or `"pelvis_position"` (clips retargeted
        /// from a skeleton). The file does not say.
        #[serde(default)]
        translation: Translation,
    },
    /// Body parameters per frame that a video tracker wrote as `.npz`, by the names of AMASS or of the `smplx` package.
    Tracked {
        /// The file.
        path: PathBuf,
        /// Upward axis of its world: `"y"`, `"-y"` (most cameras), `"z"`, … No default: the file does not say. This or `gravity`.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        up: Option<UpAxis>,
        /// Direction in which things fall in its world, of any length: a camera that looks down by an angle a has
        /// `[0, cos a, sin a]`, with x right, y down, z away. In place of `up`.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        gravity: Option<[f64; 3]>,
        /// What its translation means, as for `amass`.
        #[serde(default)]
        translation: Translation,
        /// Frame rate of the video [1/s]; by default the file's own.
        #[serde(default)]
        fps: Option<f64>,
        /// Standard deviation of the Gaussian that smooths it [s]; 0 for none. Default 0.03, which halves the power of what shakes
        /// at 4.4 Hz: walking stays, jitter from frame to frame goes.
        #[serde(default = "tracked_smoothing")]
        smoothing_s: f64,
    },
    /// A BVH file.
    Bvh {
        /// The file.
        path: PathBuf,
        /// Mapping of its joints (TOML, see `caphy_formats::motion::SkeletonMapping`). Default: the CMU database's BVH names.
        #[serde(default)]
        mapping: Option<PathBuf>,
        /// Metres per length unit of the file. Default: the mapping's.
        #[serde(default)]
        metres_per_unit: Option<f64>,
    },
    /// A skeleton and its motion, CMU's or mapped.
    AsfAmc {
        /// The `.asf` file.
        skeleton: PathBuf,
        /// The `.amc` file.
        path: PathBuf,
        /// Its frame rate [1/s]; the format does not say. Default 120 (CMU).
        #[serde(default = "cmu_fps")]
        fps: f64,
        /// Mapping of its bones, as for `bvh`. Default: the CMU database's bones.
        #[serde(default)]
        mapping: Option<PathBuf>,
    },
    /// All `.npz` (AMASS), `.bvh` and `.amc` files of a folder, sorted by name; for training, not for `animate`.
    Folder {
        /// The folder.
        path: PathBuf,
        /// What `trans` means in its `.npz`, as for `amass`.
        #[serde(default)]
        translation: Translation,
        /// Mapping of its `.bvh`, as for `bvh`.
        #[serde(default)]
        mapping: Option<PathBuf>,
        /// Frame rate of its `.amc` [1/s], whose skeleton is the `.asf` named like the part before the first `_` (`35_01.amc`:
        /// `35.asf`). Default 120 (CMU).
        #[serde(default = "cmu_fps")]
        amc_fps: f64,
    },
}

/// Default of a tracked clip's `smoothing_s` [s].
pub const TRACKED_SMOOTHING: f64 = 0.03;

fn tracked_smoothing() -> f64 {
    TRACKED_SMOOTHING
}

/// The rate of the CMU database's clips, which its files do not say [1/s].
pub(crate) fn cmu_fps() -> f64 {
    120.0
}

/// Meaning of `trans` in an AMASS-style file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "snake_case")]
#[value(rename_all = "snake_case")]
pub enum Translation {
    /// What is added to the posed body.
    #[default]
    BodyOffset,
    /// Where the pelvis is.
    PelvisPosition,
}

/// What of the body garments meet.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ContactWith {
    /// The nearest vertex.
    #[default]
    Vertex,
    /// The nearest point of the triangles around the nearest vertex.
    Triangle,
}

/// `[train]`
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TrainConfig {
    /// Rounds of one epoch of random windows and `scan_epochs` epochs of scan poses. Default 24.
    pub rounds: usize,
    /// Draws another training of the same subject, beside `run.seed`, which draws everything. Default 0.
    #[serde(skip_serializing_if = "is_zero")]
    pub seed: u64,
    /// Windows per epoch. Default 640; the paper takes 10000.
    pub windows: usize,
    /// Windows per step; at most 16 travel together. Default 16.
    pub batch: usize,
    /// Frames per window. Default 5 (Sec. 3.2).
    pub window: usize,
    /// Frames before each window that the net only watches: what it carries and how fast the cloth moves are then as in the middle
    /// of a clip, and inertia counts in every frame of the window. Default 8, a quarter of a second. Differs from the paper,
    /// whose windows come from nothing (0).
    pub lead_in: usize,
    /// Single poses per epoch of windows, drawn from the motion, in which nothing moves: the net of a clip under way would not know
    /// what hangs still. Default 160.
    pub still_poses: usize,
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
    /// Posed bodies of the motion are kept in memory up to this size [MiB]; longer motion is posed anew in every step, the same
    /// to the bit. Default 512: about 5000 frames under a shirt, and with nets, optimiser and step the whole training stays
    /// below 1 GiB. 0 always poses.
    pub keep_bodies_mib: usize,
    /// Steps between lines of `metrics-STAGE-GARMENT.jsonl` and points in TensorBoard. Default 1.
    pub metrics_every: usize,
    /// Steps between measurements of stretch and of depth inside the body, which get a line in any case. Default 50: one costs
    /// about as much as half a step. 0 for none.
    pub measure_every: usize,
    /// Rounds (in fine-tuning: epochs) between pictures of a few fixed poses in `previews/`; the end of a training always gets
    /// one. Default 4. 0 for none.
    pub preview_every: usize,
    /// Largest number of scan points per garment and scan in Eq. 9. Default 4000.
    pub scan_points: usize,
    /// A net's output of 1 displaces a vertex by this [m]. Default 0.02: wrinkles are centimetres, and Adam's first steps then
    /// move cloth by millimetres.
    pub output_scale_m: f64,
    /// How stiff the body's contact is.
    pub contact: ContactOptions,
    /// What of the body garments meet in training: `"vertex"`, the nearest vertex (default; the reference solver's contact, too), or
    /// `"triangle"`, the nearest point of the triangles around it, smoother and about half a step dearer.
    pub contact_with: ContactWith,
    /// Weights of the terms.
    pub weights: TermWeights,
}

impl Default for TrainConfig {
    fn default() -> Self {
        Self {
            rounds: 24,
            seed: 0,
            windows: 640,
            batch: 16,
            window: 5,
            lead_in: 8,
            still_poses: 160,
            scan_epochs: 4,
            learning_rate: 5e-4,
            final_rate: 0.05,
            clip_norm: 1.0,
            frame_clip: 3.0,
            checkpoint_every: 200,
            keep_bodies_mib: 512,
            metrics_every: 1,
            measure_every: 50,
            preview_every: 4,
            scan_points: 4000,
            output_scale_m: 0.02,
            contact: ContactOptions { margin: 4e-3, ..ContactOptions::default() },
            contact_with: ContactWith::Vertex,
            weights: TermWeights::default(),
        }
    }
}

impl TrainConfig {
    /// Steps that one garment's net makes in a round, with so many scans to learn from.
    pub fn steps_of_round(&self, scans: usize) -> usize {
        let batches = |count: usize| count.div_ceil(self.batch);
        batches(self.windows) + batches(self.still_poses) + self.scan_epochs * batches(scans)
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
    /// Of a synthetic subject: also bring its templates, made of the true fabrics, to rest in the held-out scans' poses by the
    /// reference solver, as a floor for nets. Default false: it costs as much as simulating these poses.
    pub solver_floor: bool,
    /// The paper's perceptual distance by VGG-16, beside the distance of normal maps and MS-SSIM, which need no network.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub perceptual_network: Option<PerceptualConfig>,
}

impl Default for EvaluateConfig {
    fn default() -> Self {
        Self { penetration_m: 1e-3, ground_truth: None, solver_floor: false, perceptual_network: None }
    }
}

/// `[compare]`: trained nets against the reference solver on the same garments and motion.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CompareConfig {
    /// The motion, not one that was trained on.
    pub clip: ClipConfig,
    /// Most seconds of it that are simulated. Default 2: a minute or two per garment.
    #[serde(default = "two_seconds")]
    pub seconds: f64,
    /// Every n-th frame is also brought to rest, without inertia. Default 10.
    #[serde(default = "every_tenth")]
    pub rest_every: usize,
    /// The solver's settings. Default: forces down to 1e-5 N, a hundredth of a vertex's weight.
    #[serde(default = "comparing")]
    pub solver: SolverSettings,
}

fn two_seconds() -> f64 {
    2.0
}
fn every_tenth() -> usize {
    10
}
fn comparing() -> SolverSettings {
    SolverSettings { tolerance_n: 1e-5, ..SolverSettings::default() }
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
    /// Simulate the garments instead of asking their nets: a thousand times the time, and what nets come near to. `{}` takes forces
    /// down to 1e-2 N, some times the weight of a vertex, in at most 120 steps, which docs/trade.md finds as near as less, with friction
    /// of 0.3: without it a wide neck slides off a shoulder. Default none: nets.
    #[serde(default, skip_serializing_if = "Option::is_none", deserialize_with = "animating")]
    pub solver: Option<SolverSettings>,
    /// Push garment vertices that end up inside the body, or inside the garment below, out to this distance [m]; 0 leaves them.
    /// Default 2 mm (SNUG).
    #[serde(default = "two_millimetres")]
    pub push_out_m: f64,
    /// Every n-th frame is also written as OBJ. Default 5; the GLB holds them all.
    #[serde(default = "every_fifth")]
    pub obj_every: usize,
}

impl AnimateConfig {
    /// What `solver = {}` means.
    pub(crate) fn solver_defaults() -> SolverSettings {
        SolverSettings { tolerance_n: 1e-2, iterations: 120, friction: 0.3, ..SolverSettings::default() }
    }
}

fn animating<'de, D: serde::Deserializer<'de>>(file: D) -> std::result::Result<Option<SolverSettings>, D::Error> {
    optimise::over(file, AnimateConfig::solver_defaults()).map(Some)
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

impl GarmentConfig {
    /// The fabric that styles are worn in while a template is chosen.
    pub fn worn_in(&self) -> &PluginTable {
        self.worn_in.as_ref().unwrap_or(&self.material)
    }
}

impl Config {
    /// Parses and checks a configuration with the linked plugins and the libraries that it names; `path` is for messages
    /// and for where relative libraries are.
    pub fn parse(path: &Path, text: &str) -> Result<Config> {
        Self::parse_with(path, text, &mut Plugins::new()?)
    }

    /// As [`Config::parse`], with more libraries loaded before.
    ///
    /// # Errors
    /// [`Error::Format`] with line and column of what TOML or a type does not know, [`Error::Config`] for values that cannot
    /// be used or have no effect, [`Error::Plugin`] for libraries.
    pub fn parse_with(path: &Path, text: &str, plugins: &mut Plugins) -> Result<Config> {
        Self::parse_set(path, text, &[], plugins)
    }

    /// As [`Config::parse_with`], with settings that take the place of the file's own.
    ///
    /// # Errors
    /// As [`Config::parse_with`]; what is wrong because of a setting names it.
    pub fn parse_set(path: &Path, text: &str, settings: &[Setting], plugins: &mut Plugins) -> Result<Config> {
        let written = parse_table(path, text)?;
        let table = set::applied(&written, settings)?;
        let files = ProjectFiles::new(path.parent().unwrap_or(Path::new(".")));
        // Before anything else is read: the types below may be theirs.
        for library in libraries(&table) {
            plugins.load(&files.resolve(&library)?)?;
        }
        plugins.settle(path);
        let whole = |table: toml::Table| -> Result<Config> {
            let (table, choice) = budget::applied(table, &files)?;
            Ok(Config { choice, ..Self::from_table(path, text, &table, plugins)? })
        };
        whole(table)
            .map_err(|error| set::blame(error, settings, |others| whole(set::applied(&written, others)?).map(drop)))
    }

    /// A table, which stands in `text`, as a configuration.
    fn from_table(path: &Path, text: &str, table: &toml::Table, plugins: &Plugins) -> Result<Config> {
        let read = |table: &toml::Table| -> std::result::Result<Config, String> {
            table.clone().try_into().map_err(|e: toml::de::Error| e.message().trim().to_string())
        };
        let mut config =
            read(table).map_err(|message| place::error(path, text, "", table, &message, &|table| read(table).err()))?;
        for (kind, key, chosen) in config.tables_mut() {
            chosen.resolve_in(plugins, kind, path, text, key)?;
        }
        silent::check(table, &config)?;
        config.check()?;
        // Those of the command line, too: the run depends on them.
        config.plugin = plugins.paths().map(|path| PluginConfig { path: path.into() }).collect();
        Ok(config)
    }

    /// Reads and parses a file.
    pub fn read(path: &Path) -> Result<Config> {
        Self::read_with(path, &mut Plugins::new()?)
    }

    /// As [`Config::read`], with more libraries loaded before.
    pub fn read_with(path: &Path, plugins: &mut Plugins) -> Result<Config> {
        Self::read_set(path, &[], plugins)
    }

    /// As [`Config::read_with`], with settings that take the place of the file's own.
    pub fn read_set(path: &Path, settings: &[Setting], plugins: &mut Plugins) -> Result<Config> {
        let text = std::fs::read_to_string(path).map_err(|e| Error::io(path, "read", e))?;
        Self::parse_set(path, &text, settings, plugins)
    }

    /// The garments that are modelled, upper first, with the names of their tables.
    pub fn garments(&self) -> impl Iterator<Item = (GarmentKind, &'static str, &GarmentConfig)> {
        [(GarmentKind::Upper, "upper", &self.upper), (GarmentKind::Lower, "lower", &self.lower)]
            .into_iter()
            .filter_map(|(kind, key, garment)| Some((kind, key, garment.as_ref()?)))
    }

    /// What `caphy tradeoff` measures on, with its defaults.
    pub fn tradeoff(&self) -> &TradeoffConfig {
        static DEFAULT: std::sync::LazyLock<TradeoffConfig> = std::sync::LazyLock::new(TradeoffConfig::default);
        self.tradeoff.as_ref().unwrap_or(&DEFAULT)
    }

    /// The table of a garment.
    ///
    /// # Errors
    /// [`Error::Config`] where the experiment has none.
    pub fn garment(&self, kind: GarmentKind) -> Result<&GarmentConfig> {
        let found = self.garments().find(|g| g.0 == kind);
        found.map(|g| g.2).ok_or_else(|| {
            Error::config(kind.to_string(), "there is no such table", "add it, with the garment's `material`")
        })
    }

    /// Tables that choose a plugin.
    fn tables_mut(&mut self) -> Vec<(Kind, &'static str, &mut PluginTable)> {
        let mut all = vec![(Kind::Body, "body", &mut self.body)];
        all.extend(self.segmenter.as_mut().map(|table| (Kind::Segmenter, "segmenter", table)));
        all.push((Kind::Net, "net", &mut self.net));
        for (keys, garment) in [
            (["upper.material", "upper.template", "upper.worn_in"], &mut self.upper),
            (["lower.material", "lower.template", "lower.worn_in"], &mut self.lower),
        ] {
            let Some(garment) = garment else { continue };
            all.push((Kind::Material, keys[0], &mut garment.material));
            all.push((Kind::Template, keys[1], &mut garment.template));
            all.extend(garment.worn_in.as_mut().map(|table| (Kind::Material, keys[2], table)));
        }
        if let SubjectConfig::Synthetic(s) = &mut self.subject {
            all.push((Kind::Material, "subject.upper_material", &mut s.upper_material));
            all.push((Kind::Material, "subject.lower_material", &mut s.lower_material));
        }
        all
    }

    /// All materials with their keys.
    fn materials(&self) -> Vec<(&'static str, &PluginTable)> {
        let mut all = Vec::new();
        for (keys, garment) in
            [(["upper.material", "upper.worn_in"], &self.upper), (["lower.material", "lower.worn_in"], &self.lower)]
        {
            let Some(garment) = garment else { continue };
            all.push((keys[0], &garment.material));
            all.extend(garment.worn_in.as_ref().map(|table| (keys[1], table)));
        }
        if let SubjectConfig::Synthetic(s) = &self.subject {
            all.push(("subject.upper_material", &s.upper_material));
            all.push(("subject.lower_material", &s.lower_material));
        }
        all
    }
}

/// A TOML file that holds one clip's table and nothing else.
///
/// # Errors
/// [`Error::Format`] with line and column.
pub fn clip_table(path: &Path, text: &str) -> Result<ClipConfig> {
    let table = parse_table(path, text)?;
    let read = |table: &toml::Table| -> std::result::Result<ClipConfig, String> {
        table.clone().try_into().map_err(|e: toml::de::Error| e.message().trim().to_string())
    };
    read(&table).map_err(|message| place::error(path, text, "", &table, &message, &|table| read(table).err()))
}

/// A TOML file as a table.
///
/// # Errors
/// [`Error::Format`] with line and column.
pub(crate) fn parse_table(path: &Path, text: &str) -> Result<toml::Table> {
    text.parse().map_err(|e: toml::de::Error| {
        place::at(path, text, e.span().map_or(0, |s| s.start), e.message().trim(), "correct the line")
    })
}

/// Paths of the libraries that a configuration names, as far as it can be read yet.
fn libraries(table: &toml::Table) -> Vec<PathBuf> {
    let listed = table.get("plugin").and_then(|p| p.as_array()).into_iter().flatten();
    listed.filter_map(|p| Some(PathBuf::from(p.get("path")?.as_str()?))).collect()
}
