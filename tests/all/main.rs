//! Tests of the whole program, one module per thing that must hold.

/// Parts of the method left out.
mod ablation;
/// Missing, damaged and unsuitable input.
mod bad_input;
/// The net on a framework, when asked for.
mod burn;
/// The small commands, as a shell would call them.
mod commands;
/// What a configuration may say, and what is answered to one that is wrong.
mod config;
/// Subjects without scans.
mod dressed;
/// Fabric from scans of a swatch, by files.
mod estimate;
/// Very small experiments in folders of their own.
mod experiment;
/// Bodies, garments and motion, shown and played.
mod inputs;
/// Killed at any moment.
mod killed;
/// Played for longer than training ever saw.
mod long_clip;
/// A network's opinion of renderings, when it can be asked.
#[cfg(feature = "onnx")]
mod perceptual;
/// From scans to report: results, resuming, same bits.
mod pipeline;
/// The scene plan: what it leaves out changes nothing.
mod plan;
/// Plugin libraries in the whole program.
mod plugins;
/// What training leaves behind, and what it survives.
mod record;
/// Folders of scans as people bring them.
mod scans;
/// Clothed people that nobody here made.
mod standin;
/// The stability atlas.
mod stress;
/// Scans of generated people.
mod synth;
/// What knobs cost and buy.
mod tradeoff;
/// Disks, folders and files that let a run down.
#[cfg(unix)]
mod trouble;
