//! `type = "mesh"`: one garment of the user's own, registered to the T-posed body.

use super::{TemplateSource, TemplateSpec};
use crate::template::{FitOptions, GarmentKind, GivenMesh, GivenStyle, Style, Tailor, Template};
use caphy_core::files::Files;
use caphy_core::{Error, Result};
use caphy_formats::{obj::read_obj, ply::read_ply};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// ```toml
/// [upper]
/// template = { type = "mesh", path = "my-shirt.obj", fit = { metres_per_unit = 0.01 } }
/// ```
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TemplateMesh {
    /// OBJ (whose texture coordinates may be the sewing pattern) or PLY.
    pub path: PathBuf,
    /// How it is brought onto the body.
    #[serde(default)]
    pub fit: FitOptions,
}

/// Reads a garment from OBJ or PLY; layout coordinates from OBJ where every face has them.
///
/// # Errors
/// Those of the readers; [`Error::Format`] for another ending.
pub fn read_garment(path: &Path, bytes: &[u8]) -> Result<GivenMesh> {
    let name = path.file_stem().map(|s| s.to_string_lossy().into_owned()).unwrap_or_default();
    let ending = path.extension().map(|e| e.to_string_lossy().to_lowercase()).unwrap_or_default();
    match ending.as_str() {
        "obj" => {
            let obj = read_obj(path, bytes)?;
            let uv = match obj.uvs {
                None => None,
                Some(uvs) => Some(
                    uvs.faces
                        .iter()
                        .map(|f| {
                            let at = |c: u32| uvs.coords.get(c as usize).copied();
                            match [at(f[0]), at(f[1]), at(f[2])] {
                                [Some(a), Some(b), Some(c)] => Ok([a, b, c]),
                                _ => Err(Error::format(
                                    path,
                                    "texture coordinates",
                                    format!("ids {f:?} but there are {}", uvs.coords.len()),
                                    "the file is damaged: write it again",
                                )),
                            }
                        })
                        .collect::<Result<Vec<_>>>()?,
                ),
            };
            Ok(GivenMesh { name, mesh: obj.scan.mesh, uv })
        }
        "ply" => Ok(GivenMesh { name, mesh: read_ply(path, bytes)?.mesh, uv: None }),
        other => Err(Error::format(path, "ending", format!("`{other}` is no garment's"), "give OBJ or PLY")),
    }
}

/// A garment file and how it is brought onto the body.
pub(super) struct OneGarment {
    pub(super) given: GivenMesh,
    pub(super) fit: FitOptions,
}

impl OneGarment {
    pub(super) fn style(&self, garment: GarmentKind) -> Style {
        Style::Given(GivenStyle { garment, name: self.given.name.clone(), coefficients: Vec::new() })
    }
    pub(super) fn is(&self, style: &Style) -> bool {
        matches!(style, Style::Given(s) if s.name == self.given.name)
    }
    pub(super) fn kind(&self, tailor: &Tailor) -> Result<GarmentKind> {
        tailor.kind_of(self.given.clone(), &self.fit)
    }
    pub(super) fn template(&self, tailor: &Tailor, style: &Style, resolution_m: f64) -> Result<Template> {
        let fit = FitOptions { kind: Some(style.kind()), ..self.fit };
        let mut template = tailor.fit(self.given.clone(), &[], resolution_m, &fit)?;
        if let Some(facts) = &mut template.given {
            facts.kind_given = self.fit.kind.is_some();
        }
        Ok(template)
    }
}

#[typetag::serde(name = "mesh")]
impl TemplateSpec for TemplateMesh {
    fn build(&self, files: &dyn Files) -> Result<Box<dyn TemplateSource>> {
        let given = read_garment(&self.path, &files.read(&self.path)?)?;
        Ok(Box::new(OneGarment { given, fit: self.fit }))
    }
}

impl TemplateSource for OneGarment {
    fn styles(&self, tailor: &Tailor, kind: GarmentKind, _count: usize, _seed: u64) -> Result<Vec<Style>> {
        let found = self.kind(tailor)?;
        if found != kind {
            return Err(Error::config(
                "template.path",
                format!("`{}` is no {kind} garment: by its openings it is {found}", self.given.name),
                format!("give a garment of that kind, or set `fit.kind = \"{kind}\"` where it is meant to be one"),
            ));
        }
        Ok(vec![self.style(kind)])
    }
    fn template(&self, tailor: &Tailor, style: &Style, resolution_m: f64) -> Result<Template> {
        if !self.is(style) {
            return Err(Error::unsupported(format!("the style {style:?}"), format!("the mesh `{}`", self.given.name)));
        }
        OneGarment::template(self, tailor, style, resolution_m)
    }
}
