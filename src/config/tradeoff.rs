//! `[tradeoff]`: what `caphy tradeoff` measures an experiment's knobs on.

use super::ClipConfig;
use caphy_bodymodel::procedural_motion::MotionKind;
use caphy_core::{Error, Result};
use serde::{Deserialize, Serialize};

/// `[tradeoff]`
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TradeoffConfig {
    /// Motion that errors are measured on and points are chosen by; not one that is trained on. Default: the clip of `[compare]`, else
    /// a generated walk.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub clip: Option<ClipConfig>,
    /// Other motion, by which nothing is chosen: what was chosen is measured on it once more. Default: a generated clip of reaching.
    pub check: ClipConfig,
    /// Where in both clips the solver begins [s]. Default 1: generated motion grows out of the A-pose for 0.8 s.
    pub from_s: f64,
    /// How long it simulates [s]. Default 0.7. The first fifth of a second is not compared: the solver starts from rest, a net from its
    /// memory of the clip.
    pub seconds: f64,
    /// Rounds of training at the experiment's own point, unless `--full` is given. Default 4, at most `train.rounds`.
    pub rounds: usize,
    /// Trainings of the experiment's own point, each with another seed: their spread is that of every point. Default 3.
    pub seeds: usize,
    /// Restarts of the solver per clip, each begun a quarter of a second earlier than the one before and with disturbed first guesses:
    /// their distance from the first answer is the floor. Default 1.
    pub restarts: usize,
    /// Largest force that the finest solver leaves on a vertex [N]. Default 1e-6, a thousandth of a vertex's weight.
    pub tolerance_n: f64,
    /// Knobs to sweep, by name. Default: all that the experiment has.
    pub knobs: Vec<String>,
    /// Combinations that are tried in each direction, towards cheaper and towards more accurate. Default 4.
    pub combinations: usize,
}

impl Default for TradeoffConfig {
    fn default() -> Self {
        let generated = |kind, seed| ClipConfig::Procedural { kind, seed, seconds: 4.0 };
        Self {
            clip: None,
            check: generated(MotionKind::Reach, 12),
            from_s: 1.0,
            seconds: 0.7,
            rounds: 4,
            seeds: 3,
            restarts: 1,
            tolerance_n: 1e-6,
            knobs: Vec::new(),
            combinations: 4,
        }
    }
}

impl TradeoffConfig {
    /// The motion that points are chosen by.
    pub fn clip(&self, compare: Option<&ClipConfig>) -> ClipConfig {
        let walk = ClipConfig::Procedural { kind: MotionKind::Walk, seed: 11, seconds: 4.0 };
        self.clip.as_ref().or(compare).cloned().unwrap_or(walk)
    }
    pub(super) fn check(&self) -> Result<()> {
        let wrong =
            |key: &str, value: String, remedy: &str| Err(Error::config(format!("tradeoff.{key}"), value, remedy));
        for (key, value, least) in [
            ("from_s", self.from_s, 0.0),
            ("seconds", self.seconds, f64::MIN_POSITIVE),
            ("tolerance_n", self.tolerance_n, f64::MIN_POSITIVE),
        ] {
            if !(value.is_finite() && value >= least) {
                return wrong(key, value.to_string(), "give a positive number");
            }
        }
        for (key, value) in [("rounds", self.rounds), ("seeds", self.seeds), ("restarts", self.restarts)] {
            if value == 0 {
                return wrong(key, "0".into(), "give at least 1");
            }
        }
        Ok(())
    }
}
