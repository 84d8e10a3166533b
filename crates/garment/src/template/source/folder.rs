//! `type = "folder"`: all garments of a kind among the files of a folder.

use super::mesh::{OneGarment, read_garment};
use super::{TemplateSource, TemplateSpec};
use crate::template::{FitOptions, GarmentKind, Style, Tailor, Template};
use caphy_core::files::Files;
use caphy_core::{Error, Result};
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// ```toml
/// [lower]
/// template = { type = "folder", path = "garments" }
/// ```
///
/// Uppers and lowers may lie together: each is used where its kind is asked for.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TemplateFolder {
    /// Folder of OBJ and PLY files.
    pub path: PathBuf,
    /// How each is brought onto the body.
    #[serde(default)]
    pub fit: FitOptions,
}

struct Folder {
    path: PathBuf,
    garments: Vec<OneGarment>,
}

#[typetag::serde(name = "folder")]
impl TemplateSpec for TemplateFolder {
    fn build(&self, files: &dyn Files) -> Result<Box<dyn TemplateSource>> {
        let garments = files
            .list(&self.path, &["obj", "ply"])?
            .iter()
            .map(|path| Ok(OneGarment { given: read_garment(path, &files.read(path)?)?, fit: self.fit }))
            .collect::<Result<Vec<_>>>()?;
        let mut names: Vec<&str> = garments.iter().map(|g| g.given.name.as_str()).collect();
        names.sort_unstable();
        if let Some(twice) = names.windows(2).find(|n| n[0] == n[1]) {
            let problem = format!("holds two garments named `{}`", twice[0]);
            return Err(Error::config("template.path", problem, "rename one: garments are told apart by name"));
        }
        Ok(Box::new(Folder { path: self.path.clone(), garments }))
    }
}

impl TemplateSource for Folder {
    fn styles(&self, tailor: &Tailor, kind: GarmentKind, _count: usize, _seed: u64) -> Result<Vec<Style>> {
        let mut styles = Vec::new();
        for garment in &self.garments {
            if garment.kind(tailor)? == kind {
                styles.push(garment.style(kind));
            }
        }
        if styles.is_empty() {
            let problem = format!("{} holds {} garments, no {kind} one", self.path.display(), self.garments.len());
            return Err(Error::config("template.path", problem, "put OBJ or PLY garments of that kind there"));
        }
        Ok(styles)
    }
    fn template(&self, tailor: &Tailor, style: &Style, resolution_m: f64) -> Result<Template> {
        match self.garments.iter().find(|g| g.is(style)) {
            Some(garment) => garment.template(tailor, style, resolution_m),
            None => {
                Err(Error::unsupported(format!("the style {style:?}"), format!("the folder {}", self.path.display())))
            }
        }
    }
}
