//! An avatar in one file: what plays a clip without the experiment that made it.

use crate::artifact;
use crate::garment::{FittedGarment, TrainedGarment};
use crate::inputs::{self, TableArgument};
use crate::plugins::{Kind, PluginTable, Plugins};
use crate::scene::Scene;
use crate::stage::Context;
use crate::stage::preprocess::Subject;
use crate::stage::train::Nets;
use caphy_core::{Error, Result, Vec3};
use caphy_garment::energy::LayeringOptions;
use serde::{Deserialize, Serialize};
use std::path::Path;
use std::sync::Arc;

/// What stands in the file's header as its stage.
const KIND: &str = "avatar";

/// Body, garments and nets of an avatar. Licensed bodies stay where they are: the file names them.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Avatar {
    /// The body's table (TOML); paths of its files are absolute.
    body: String,
    /// The net's table (TOML).
    net: String,
    /// Shape coefficients.
    shape: Vec<f64>,
    /// Displacements dT [m]; empty for none.
    displacement: Vec<Vec3>,
    /// Garments, upper first.
    pub garments: Vec<FittedGarment>,
    /// Their nets, in the same order.
    pub nets: Vec<TrainedGarment>,
    /// Which garment is outside.
    pub layering: LayeringOptions,
    /// Vertex colours (sRGB) of body and garments, from scans; none where scans have none.
    pub colours: Vec<Vec<[u8; 3]>>,
}

impl Avatar {
    /// The avatar that a run ends with.
    ///
    /// # Errors
    /// [`Error::Config`] for a path with an unset variable.
    pub fn new(context: &Context<'_>, subject: &Subject, nets: &Nets, colours: Vec<Vec<[u8; 3]>>) -> Result<Self> {
        let body = TableArgument { table: context.config.body.clone(), files: context.files.clone() }.anywhere()?;
        Ok(Self {
            body: body.to_string(),
            net: context.config.net.text(),
            shape: subject.shape.clone(),
            displacement: subject.displacement.clone(),
            garments: subject.garments.clone(),
            // The record of training is not part of what plays.
            nets: nets.garments.iter().map(|g| TrainedGarment { curve: Vec::new(), ..g.clone() }).collect(),
            layering: context.config.finetune.layering,
            colours,
        })
    }

    /// Writes it.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn save(&self, path: &Path) -> Result<()> {
        artifact::save(path, KIND, "", self).map(drop)
    }

    /// Reads it.
    ///
    /// # Errors
    /// [`Error::Io`]; [`Error::Format`] for a file that is damaged, of another version, or no avatar.
    pub fn load(path: &Path) -> Result<Self> {
        match artifact::load(path, KIND, "")? {
            Some((avatar, _)) => Ok(avatar),
            None => {
                let remedy = "give the `export/avatar.caphy` of a run of this version of caphy";
                Err(if path.exists() {
                    Error::format(path, "header", "is no avatar, or another version's", remedy)
                } else {
                    Error::io(path, "read", std::io::ErrorKind::NotFound.into())
                })
            }
        }
    }

    /// The dressed body, ready to be posed; `body` names another file or type than the avatar's own, for an avatar that has moved.
    ///
    /// # Errors
    /// What the body is refused for; [`Error::Length`] for a body with other vertices or coefficients than the avatar's.
    pub fn scene(&self, body: Option<&str>, plugins: &Plugins) -> Result<Scene> {
        let body = match body {
            Some(argument) => inputs::body(argument, plugins)?,
            None => PluginTable::parse(plugins, Kind::Body, Path::new("avatar's body"), &self.body)?
                .body(&crate::files::ProjectFiles::new("."))?,
        };
        Scene::dressed(Arc::from(body), &self.shape, &self.displacement, &self.garments)
    }

    /// The table that makes its nets.
    ///
    /// # Errors
    /// [`Error::Format`] for a type that is not there: a library that must be loaded first.
    pub fn net(&self, plugins: &Plugins) -> Result<PluginTable> {
        PluginTable::parse(plugins, Kind::Net, Path::new("avatar's net"), &self.net)
    }
}
