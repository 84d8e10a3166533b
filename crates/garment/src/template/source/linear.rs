//! `type = "linear"`: a linear style space, mean + Σ c σ component, the form that TailorNet's can be exported to.

use super::{TemplateSource, TemplateSpec};
use crate::template::style::{MOST_AXES, unit_samples};
use crate::template::{FitOptions, GarmentKind, GivenMesh, GivenStyle, Style, Tailor, Template};
use caphy_core::files::Files;
use caphy_core::{Error, Result, TriMesh, Vec3};
use caphy_formats::npz::Npz;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// An `.npz` with `mean` (V, 3), `components` (K, V, 3), `faces` (F, 3) and, optionally, `std` (K): the standard deviation of
/// each coefficient (1 without it) and `mean_betas` (any length): the shape of the body that the mean dresses, for reports.
///
/// Coefficients are in standard deviations. The garments must lie on the T-posed body that they are fitted to.
///
/// ```toml
/// [upper]
/// template = { type = "linear", path = "shirts.npz", coefficients = 4, spread = 2.0 }
/// ```
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TemplateLinear {
    /// The archive.
    pub path: PathBuf,
    /// Leading coefficients that are varied, at most 8; the others stay 0. Default 4: they hold nearly all of a
    /// garment's style.
    #[serde(default = "default_coefficients")]
    pub coefficients: usize,
    /// Largest coefficient of samples, in standard deviations. Default 2.
    #[serde(default = "default_spread")]
    pub spread: f64,
    /// How garments are brought onto the body.
    #[serde(default)]
    pub fit: FitOptions,
}

fn default_coefficients() -> usize {
    4
}
fn default_spread() -> f64 {
    2.0
}

/// A linear space in memory.
struct Linear {
    name: String,
    mean: Vec<Vec3>,
    /// Component times standard deviation [file's unit], shape [component][vertex].
    components: Vec<Vec<Vec3>>,
    faces: Vec<[u32; 3]>,
    made_for_shape: Vec<f64>,
    varied: usize,
    spread: f64,
    fit: FitOptions,
}

fn wrong_shape(path: &Path, name: &str, shape: &[usize], wanted: &str) -> Error {
    Error::format(
        path,
        format!("array `{name}`"),
        format!("has shape {shape:?}, {wanted} is needed"),
        "save `mean` (V, 3), `components` (K, V, 3), `faces` (F, 3) and optionally `std` (K)",
    )
}

fn points(data: &[f64]) -> Vec<Vec3> {
    data.chunks_exact(3).map(Vec3::from_column_slice).collect()
}

impl Linear {
    fn read(spec: &TemplateLinear, bytes: Vec<u8>) -> Result<Self> {
        let path = &spec.path;
        let npz = Npz::from_bytes(path, bytes)?;
        let finite = |name: &str, data: &[f64]| Error::check_finite(&format!("`{name}` of {}", path.display()), data);
        let mean = npz.f64s("mean")?;
        let &[vertices, 3] = mean.shape.as_slice() else {
            return Err(wrong_shape(path, "mean", &mean.shape, "(V, 3)"));
        };
        finite("mean", &mean.data)?;
        let components = npz.f64s("components")?;
        let count = match components.shape.as_slice() {
            &[k, v, 3] if v == vertices && k > 0 => k,
            shape => return Err(wrong_shape(path, "components", shape, &format!("(K, {vertices}, 3) with K > 0"))),
        };
        finite("components", &components.data)?;
        let faces = npz.i64s("faces")?;
        if !matches!(faces.shape.as_slice(), &[_, 3]) {
            return Err(wrong_shape(path, "faces", &faces.shape, "(F, 3)"));
        }
        if let Some(at) = faces.data.iter().position(|&v| v < 0 || v >= vertices as i64) {
            let problem = format!("names vertex {} but there are {vertices}", faces.data[at]);
            let remedy = "number vertices from 0, as in `mean`";
            return Err(Error::format(path, format!("array `faces`, row {}", at / 3), problem, remedy));
        }
        let std = if npz.has("std") {
            let std = npz.f64s("std")?;
            if std.shape != [count] {
                return Err(wrong_shape(path, "std", &std.shape, &format!("({count})")));
            }
            finite("std", &std.data)?;
            std.data
        } else {
            vec![1.0; count]
        };
        let made_for_shape = if npz.has("mean_betas") {
            let betas = npz.f64s("mean_betas")?;
            if betas.shape.len() != 1 {
                return Err(wrong_shape(path, "mean_betas", &betas.shape, "one row"));
            }
            finite("mean_betas", &betas.data)?;
            betas.data
        } else {
            Vec::new()
        };
        let config = |key: &str, problem: String, remedy: String| Err(Error::config(key, problem, remedy));
        if spec.coefficients > MOST_AXES {
            let problem = format!("{} of {count} coefficients", spec.coefficients);
            return config("template.coefficients", problem, format!("vary at most {MOST_AXES}"));
        }
        if !(spec.spread > 0.0 && spec.spread <= 10.0) {
            return config("template.spread", format!("{}", spec.spread), "give a value above 0, at most 10".into());
        }
        Ok(Self {
            name: path.file_stem().map(|s| s.to_string_lossy().into_owned()).unwrap_or_default(),
            mean: points(&mean.data),
            components: components
                .data
                .chunks_exact(3 * vertices.max(1))
                .zip(&std)
                .map(|(c, s)| points(c).into_iter().map(|p| p * *s).collect())
                .collect(),
            faces: faces.data.chunks_exact(3).map(|f| [f[0] as u32, f[1] as u32, f[2] as u32]).collect(),
            made_for_shape,
            varied: spec.coefficients.min(count),
            spread: spec.spread,
            fit: spec.fit,
        })
    }
    fn given(&self, coefficients: &[f64]) -> Result<GivenMesh> {
        if coefficients.len() > self.components.len() {
            let what = format!("style coefficients of {}", self.name);
            return Err(Error::Length { what, expected: self.components.len(), got: coefficients.len() });
        }
        let mut vertices = self.mean.clone();
        for (c, component) in coefficients.iter().zip(&self.components) {
            vertices.iter_mut().zip(component).for_each(|(p, d)| *p += d * *c);
        }
        Ok(GivenMesh { name: self.name.clone(), mesh: TriMesh { vertices, faces: self.faces.clone() }, uv: None })
    }
    fn style(&self, garment: GarmentKind, coefficients: Vec<f64>) -> Style {
        Style::Given(GivenStyle { garment, name: self.name.clone(), coefficients })
    }
}

#[typetag::serde(name = "linear")]
impl TemplateSpec for TemplateLinear {
    fn build(&self, files: &dyn Files) -> Result<Box<dyn TemplateSource>> {
        Ok(Box::new(Linear::read(self, files.read(&self.path)?)?))
    }
}

impl TemplateSource for Linear {
    /// The mean first, then samples.
    fn styles(&self, tailor: &Tailor, kind: GarmentKind, count: usize, seed: u64) -> Result<Vec<Style>> {
        let found = tailor.kind_of(self.given(&[])?, &self.fit)?;
        if found != kind {
            return Err(Error::config(
                "template.path",
                format!("`{}` holds no {kind} garments: by its openings the mean is {found}", self.name),
                format!("give a space of that kind, or set `fit.kind = \"{kind}\"` where it is meant to be one"),
            ));
        }
        let mut styles = vec![self.style(kind, vec![0.0; self.varied])];
        let samples = unit_samples(self.varied, count.saturating_sub(1), seed);
        styles
            .extend(samples.map(|u| self.style(kind, u.into_iter().map(|x| (2.0 * x - 1.0) * self.spread).collect())));
        styles.truncate(count);
        Ok(styles)
    }
    fn template(&self, tailor: &Tailor, style: &Style, resolution_m: f64) -> Result<Template> {
        let s = match style {
            Style::Given(s) if s.name == self.name => s,
            _ => {
                let by = format!("the linear style space `{}`", self.name);
                return Err(Error::unsupported(format!("the style {style:?}"), by));
            }
        };
        style.check()?;
        let fit = FitOptions { kind: Some(s.garment), ..self.fit };
        let mut template = tailor.fit(self.given(&s.coefficients)?, &s.coefficients, resolution_m, &fit)?;
        if let Some(facts) = &mut template.given {
            facts.kind_given = self.fit.kind.is_some();
            facts.made_for_shape = self.made_for_shape.clone();
        }
        Ok(template)
    }
    fn coordinates(&self, style: &Style) -> Vec<f64> {
        let Style::Given(s) = style else { return Vec::new() };
        s.coefficients.iter().map(|c| 0.5 * (c / self.spread + 1.0)).collect()
    }
    fn at(&self, like: &Style, coordinates: &[f64]) -> Result<Style> {
        let coefficients = coordinates.iter().map(|u| (2.0 * u.clamp(0.0, 1.0) - 1.0) * self.spread);
        Ok(self.style(like.kind(), coefficients.collect()))
    }
}
