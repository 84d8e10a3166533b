//! The fabric of a cloth from scans of it at rest: of garments worn in a run, and of cloths given by files (`caphy estimate`).

mod config;
mod fit;
mod found;
mod input;
pub(crate) mod report;
mod run;
pub(crate) mod worn;

pub use config::{
    Clamp, ClothConfig, EstimateConfig, Method, PoseConfig, ReductionChoice, SurroundingsConfig, is_experiment,
};
pub use fit::{How, Kept, fit, ten_fabrics};
pub use found::{Estimated, FabricFound, Factor};
pub use run::{Summary, run};
pub use worn::{WornOn, attached, capture, put_on};
