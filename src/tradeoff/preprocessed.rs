//! What preprocessing costs and how far its labels and bodies are off.

use super::cost::Spent;
use crate::config::Config;
use crate::files::ProjectFiles;
use crate::stage::preprocess::Subject;
use caphy_core::{Result, Vec3};
use serde::{Deserialize, Serialize};

/// One way to preprocess.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Preprocessed {
    /// Processor time [s].
    pub processor_s: f64,
    /// Wall time [s].
    pub wall_s: f64,
    /// Share of labels that are not those stored with the scans, mean over scans; none where none are stored.
    pub wrong_labels: Option<f64>,
    /// Mean distance of the T-posed body's vertices from those that the experiment's own preprocessing finds [mm].
    pub body_mm: f64,
    /// Scans that could not be used.
    pub skipped: usize,
}

impl Preprocessed {
    /// Of a subject, against the experiment's own.
    ///
    /// # Errors
    /// What the body is refused for.
    pub(super) fn new(
        config: &Config,
        files: &ProjectFiles,
        subject: &Subject,
        own: Option<&Subject>,
        spent: Spent,
    ) -> Result<Self> {
        let body = config.body.body(files)?;
        let shape = |subject: &Subject| -> Result<Vec<Vec3>> {
            let mut rest = body.rest(&subject.shape);
            rest.displacement.clone_from(&subject.displacement);
            Ok(body.forward(&rest)?.vertices)
        };
        let body_mm = match own {
            None => 0.0,
            Some(own) => {
                let (a, b) = (shape(subject)?, shape(own)?);
                1e3 * a.iter().zip(&b).map(|(a, b)| (a - b).norm()).sum::<f64>() / a.len().max(1) as f64
            }
        };
        let stored: Option<Vec<f64>> = subject.scans.iter().map(|s| s.label_agreement).collect();
        let wrong_labels = stored.filter(|s| !s.is_empty()).map(|s| 1.0 - s.iter().sum::<f64>() / s.len() as f64);
        Ok(Self {
            processor_s: spent.processor_s,
            wall_s: spent.wall_s,
            wrong_labels,
            body_mm,
            skipped: subject.skipped.len(),
        })
    }
}
