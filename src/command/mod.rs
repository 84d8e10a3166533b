//! The subcommands: arguments in, text out. What they do stands in the library.

pub(crate) mod ablation;
pub(crate) mod animate;
pub(crate) mod check;
pub(crate) mod estimate;
mod figure;
pub(crate) mod probe;
pub(crate) mod run;
pub(crate) mod show;
pub(crate) mod simulate;
pub(crate) mod stress;
pub(crate) mod synth;
pub(crate) mod tradeoff;
pub(crate) mod train;
pub(crate) mod views;

use caphy_core::{Error, Result};
use serde::Serialize;

/// A value as JSON for scripts: every float with all its digits.
fn json(value: &impl Serialize) -> Result<String> {
    serde_json::to_string_pretty(value).map_err(|e| Error::numerics("JSON", e.to_string(), "report this as a defect"))
}
