//! `type = "parametric"`: shirts and trousers cut on the body, the default.

use super::{TemplateSource, TemplateSpec};
use crate::template::{GarmentKind, Style, Tailor, Template, sample_styles};
use caphy_core::Result;
use caphy_core::files::Files;
use serde::{Deserialize, Serialize};

/// The style space of [`crate::template::UpperStyle`] and [`crate::template::LowerStyle`]; no keys.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TemplateParametric {}

#[typetag::serde(name = "parametric")]
impl TemplateSpec for TemplateParametric {
    fn build(&self, _files: &dyn Files) -> Result<Box<dyn TemplateSource>> {
        Ok(Box::new(*self))
    }
}

impl TemplateSource for TemplateParametric {
    fn styles(&self, _tailor: &Tailor, kind: GarmentKind, count: usize, seed: u64) -> Result<Vec<Style>> {
        Ok(sample_styles(kind, count, seed))
    }
    fn template(&self, tailor: &Tailor, style: &Style, resolution_m: f64) -> Result<Template> {
        tailor.generate(style, resolution_m)
    }
    fn coordinates(&self, style: &Style) -> Vec<f64> {
        if matches!(style, Style::Given(_)) { Vec::new() } else { style.to_unit() }
    }
    fn at(&self, like: &Style, coordinates: &[f64]) -> Result<Style> {
        Style::from_unit(like.kind(), coordinates)
    }
}
