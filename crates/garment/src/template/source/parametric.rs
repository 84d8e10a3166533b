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
    fn neighbours(&self, style: &Style, step: f64) -> Vec<Style> {
        if matches!(style, Style::Given(_)) {
            return Vec::new();
        }
        let unit = style.to_unit();
        let mut out = Vec::new();
        for axis in 0..unit.len() {
            for sign in [1.0, -1.0] {
                let mut next = unit.clone();
                next[axis] = (next[axis] + sign * step).clamp(0.0, 1.0);
                if next[axis] != unit[axis] {
                    out.extend(Style::from_unit(style.kind(), &next));
                }
            }
        }
        out
    }
}
