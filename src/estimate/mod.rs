//! `caphy estimate`: the fabric of a cloth from scans of it at rest, worn or in the laboratory, by one TOML file.

mod config;
mod input;
mod report;
mod run;

pub use config::{Clamp, ClothConfig, EstimateConfig, Method, PoseConfig, ReductionChoice, SurroundingsConfig};
pub use run::{Estimated, Summary, run};
