//! `[subject] type = "synthetic"`: a generated person with known shape, clothes and fabrics, and the rig that scans them.

use super::{ClipConfig, HeldOut};
use crate::plugins::PluginTable;
use caphy_core::{Error, Result};
use caphy_garment::template::{GarmentKind, Style};
use serde::{Deserialize, Serialize};

/// `[subject] type = "synthetic"`
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SyntheticConfig {
    /// Number of scans.
    pub scans: usize,
    /// Scans that are kept for evaluation: names (`scan-00` and on), or a share that `run.seed` draws. Default 0.2, as in the paper.
    #[serde(default)]
    pub held_out: HeldOut,
    /// Clip that poses are taken from, evenly from its first to its last frame. Default: none, the built-in poses of a scan session,
    /// the A-pose first.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub clip: Option<ClipConfig>,
    /// Shape coefficients of the body; those left out are 0. Default: four, drawn by `run.seed`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub shape: Option<Vec<f64>>,
    /// Root mean square of a smooth displacement of the skin that no shape coefficient describes [m]. Default 0.
    #[serde(default)]
    pub displacement_m: f64,
    /// Edge length of the simulated garments [m]. Default 0.027, about 1500 vertices: one to three seconds of processor time per garment
    /// and pose; make it finer than the pipeline's templates where time allows.
    #[serde(default = "garment_resolution")]
    pub resolution_m: f64,
    /// Coulomb's friction coefficient of cloth on skin and cloth. Default 0.3, cotton on cotton; without it garments slide off
    /// shoulders.
    #[serde(default = "friction")]
    pub friction: f64,
    /// Largest force that may be left on a vertex at rest [N]. Default 5e-5, some per cent of the weight of one vertex.
    #[serde(default = "tolerance")]
    pub tolerance_n: f64,
    /// The true fabric of the upper garment.
    pub upper_material: PluginTable,
    /// The true fabric of the lower garment.
    pub lower_material: PluginTable,
    /// The true style of the upper garment: values of the style space. Default: drawn by `run.seed` among everyday shirts; none of
    /// the styles that templates are sampled from.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub upper_style: Option<Vec<f64>>,
    /// The true style of the lower garment, likewise.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lower_style: Option<Vec<f64>>,
    /// How far the cloth at rest differs from the template that it is cut by: nobody knows a worn garment's rest shape.
    #[serde(default)]
    pub rest: RestScale,
    /// How the person is scanned.
    #[serde(default)]
    pub rig: RigConfig,
}

/// `[subject.rest]`: factors of the rest shape's girth (along weft) and length (along warp). Default 1 each: cut as worn.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RestScale {
    /// Across the grain.
    pub girth: f64,
    /// Along the grain.
    pub length: f64,
}

impl Default for RestScale {
    fn default() -> Self {
        Self { girth: 1.0, length: 1.0 }
    }
}

/// What the surfaces look like.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "snake_case")]
#[value(rename_all = "snake_case")]
pub enum Texture {
    /// One colour per garment, without light and shade.
    #[default]
    Plain,
    /// A striped shirt, checked trousers, hair and shoes; a light from above makes shade.
    Patterned,
}

/// `[subject.rig]`
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RigConfig {
    /// Cameras all around, from a little below level to high above. Default 32.
    pub cameras: usize,
    /// Width and height of a depth image [pixels]. Default 512: 4 mm on a person.
    pub pixels: usize,
    /// Edge length of the scans' triangles [m]. Default 0.01: about 25 000 vertices.
    pub edge_m: f64,
    /// Standard deviation of the noise of every vertex along its normal [m]. Default 0.5 mm, a good multi-camera rig.
    pub noise_m: f64,
    /// Small holes in every scan. Default 0.
    pub holes: usize,
    /// Radius of a hole [m]. Default 0.02.
    pub hole_radius_m: f64,
    /// What the surfaces look like. Default `"plain"`.
    pub texture: Texture,
    /// Whether scans carry the true label of every vertex, which the segmenter `vertex` reads. Default true.
    pub labels: bool,
}

impl Default for RigConfig {
    fn default() -> Self {
        Self {
            cameras: 32,
            pixels: 512,
            edge_m: 0.01,
            noise_m: 0.5e-3,
            holes: 0,
            hole_radius_m: 0.02,
            texture: Texture::Plain,
            labels: true,
        }
    }
}

fn garment_resolution() -> f64 {
    0.027
}
fn friction() -> f64 {
    0.3
}
fn tolerance() -> f64 {
    5e-5
}

impl SyntheticConfig {
    /// The chosen style of a garment, if one is chosen.
    ///
    /// # Errors
    /// [`Error::Config`] naming the key, for values outside the style space.
    pub fn style(&self, kind: GarmentKind) -> Result<Option<Style>> {
        let (values, key) = match kind {
            GarmentKind::Upper => (&self.upper_style, "subject.upper_style"),
            GarmentKind::Lower => (&self.lower_style, "subject.lower_style"),
        };
        let Some(values) = values else { return Ok(None) };
        let style = Style::from_values(kind, values);
        style.map(Some).map_err(|e| Error::config(key, e.to_string(), "give values of the style space"))
    }
    /// Refuses values that no scan could be made with.
    pub(super) fn check(&self) -> Result<()> {
        let within = |key: &str, value: f64, low: f64, high: f64| {
            if value >= low && value <= high {
                Ok(())
            } else {
                Err(Error::config(format!("subject.{key}"), value.to_string(), format!("give {low} to {high}")))
            }
        };
        within("displacement_m", self.displacement_m, 0.0, 0.02)?;
        within("friction", self.friction, 0.0, 10.0)?;
        within("tolerance_n", self.tolerance_n, 1e-10, 1e-2)?;
        within("rest.girth", self.rest.girth, 0.8, 1.25)?;
        within("rest.length", self.rest.length, 0.8, 1.25)?;
        for kind in [GarmentKind::Upper, GarmentKind::Lower] {
            self.style(kind)?;
        }
        let rig = &self.rig;
        within("rig.cameras", rig.cameras as f64, 1.0, 1000.0)?;
        within("rig.pixels", rig.pixels as f64, 16.0, 8192.0)?;
        within("rig.edge_m", rig.edge_m, 1e-3, 0.05)?;
        within("rig.noise_m", rig.noise_m, 0.0, 0.01)?;
        within("rig.holes", rig.holes as f64, 0.0, 1000.0)?;
        within("rig.hole_radius_m", rig.hole_radius_m, 1e-3, 0.2)
    }
}
