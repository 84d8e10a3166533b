//! `[evaluate.perceptual_network]`: whose opinion of renderings counts.

use caphy_core::{Error, Result};
use caphy_formats::onnx::Pixels;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// A network whose features tell renderings apart: the paper's is VGG-16 (Table 1).
///
/// ```toml
/// [evaluate.perceptual_network]
/// path = "vgg16.onnx"
/// outputs = ["relu2_2", "relu3_3"]
/// ```
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PerceptualConfig {
    /// ONNX file: one float input of shape [1, 3, height, width], features as outputs.
    pub path: PathBuf,
    /// Outputs that are compared. Default: all of them.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub outputs: Vec<String>,
    /// Channels and normalisation. Default torchvision's.
    #[serde(default)]
    pub pixels: Pixels,
    /// Threads that work on one picture. Default 2; a fixed number, whatever the machine has.
    #[serde(default = "threads")]
    pub threads: usize,
}

fn threads() -> usize {
    2
}

impl PerceptualConfig {
    /// Its table, for messages.
    pub const KEY: &str = "evaluate.perceptual_network";

    /// Refuses values that cannot be used.
    pub(super) fn check(&self) -> Result<()> {
        self.pixels.check(&format!("{}.pixels", Self::KEY))?;
        if !(1..=256).contains(&self.threads) {
            return Err(Error::config(format!("{}.threads", Self::KEY), format!("{}", self.threads), "give 1 to 256"));
        }
        Ok(())
    }
}
