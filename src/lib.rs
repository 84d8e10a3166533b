//! caphy turns a folder of 3D scans of one clothed person into an avatar whose garments move by that person's own fabrics
//! (the method of the paper "CaPhy", 2023), driven by one TOML file.
//!
//! The stages in [`stage`] follow the paper's method section; [`runner`] runs them in order and skips what is done.

pub mod ablation;
pub mod artifact;
pub mod avatar;
pub mod colours;
pub mod config;
pub mod conformity;
pub mod dressed;
pub mod estimate;
pub mod files;
pub mod fixed_shape;
pub mod forecast;
pub mod garment;
pub mod inference;
pub mod inputs;
mod judge;
pub mod manifest;
pub mod markdown;
pub mod measure;
pub mod memory;
pub mod motion;
pub mod moving;
mod page;
pub mod physics;
pub mod pictures;
pub mod plan;
pub mod plot;
pub mod plugins;
pub mod probe;
pub mod progress;
pub mod quality;
mod random;
pub mod registered;
pub mod runner;
pub mod scene;
pub mod show;
pub mod simulate;
pub mod stage;
pub mod stress;
pub mod synth;
pub mod track;
pub mod tradeoff;
pub mod trainer;
pub mod training;
mod variants;

/// The worked examples of docs/plugins.md, compiled and run.
#[cfg(doctest)]
#[doc = include_str!("../docs/plugins.md")]
mod plugins_page {}
