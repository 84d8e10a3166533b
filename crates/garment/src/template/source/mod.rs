//! Where templates come from: one file per source.
//!
//! A source is chosen by `type` in TOML and sees files through the host. To add one, write a file with a specification (the
//! TOML keys, [`TemplateSpec`]) and a source ([`TemplateSource`]), and name its module below.

mod folder;
mod linear;
mod mesh;
mod parametric;

pub use folder::TemplateFolder;
pub use linear::TemplateLinear;
pub use mesh::{TemplateMesh, read_garment};
pub use parametric::TemplateParametric;

use super::{GarmentKind, Style, Tailor, Template};
use caphy_core::files::Files;
use caphy_core::{Error, Result};
use rayon::prelude::*;

/// The `template` table of a garment: `{ type = "parametric" }`, `"folder"`, `"mesh"` or `"linear"`.
#[typetag::serde(tag = "type")]
pub trait TemplateSpec: std::fmt::Debug + Send + Sync {
    /// Checks the keys, reads files through the host, makes the source.
    fn build(&self, files: &dyn Files) -> Result<Box<dyn TemplateSource>>;
}

/// A family of garments to choose a template from.
///
/// # Promise
/// Pure and deterministic: the same arguments give the same bits on any number of threads. Every [`Style`] that
/// [`TemplateSource::styles`] gives is one that [`TemplateSource::template`] can make, or refuses with its reason.
///
/// # Shapes and units
/// Templates lie on the tailor's T-posed body, in metres.
pub trait TemplateSource: Send + Sync {
    /// Garments of a kind to choose among: `count` samples of a space (the same for the same seed, and the first n of a longer
    /// row are the row of n), or all there are of a collection.
    ///
    /// # Errors
    /// [`caphy_core::Error::Config`] when there is none of that kind; whatever makes one unusable.
    fn styles(&self, tailor: &Tailor, kind: GarmentKind, count: usize, seed: u64) -> Result<Vec<Style>>;
    /// One garment, with edges of about `resolution_m` [m] where the source can do that.
    ///
    /// # Errors
    /// [`caphy_core::Error::Unsupported`] for a style of another source; whatever makes the garment unusable.
    fn template(&self, tailor: &Tailor, style: &Style, resolution_m: f64) -> Result<Template>;
    /// Where a style lies in its space, in [0, 1] per axis; none where nothing lies between the garments.
    fn coordinates(&self, _style: &Style) -> Vec<f64> {
        Vec::new()
    }
    /// The style at coordinates of the space that `like` lies in; those outside [0, 1] are brought to the nearest bound.
    ///
    /// # Errors
    /// [`Error::Length`] for another number of axes.
    fn at(&self, like: &Style, coordinates: &[f64]) -> Result<Style> {
        Error::check_length("coordinates of a garment that has no style space", 0, coordinates.len())?;
        Ok(like.clone())
    }
}

/// Many garments in parallel; the result does not depend on the number of threads.
///
/// # Errors
/// The first failure in the order of the styles.
pub fn templates(
    source: &dyn TemplateSource,
    tailor: &Tailor,
    styles: &[Style],
    resolution_m: f64,
) -> Result<Vec<Template>> {
    let made: Vec<Result<Template>> = styles.par_iter().map(|s| source.template(tailor, s, resolution_m)).collect();
    made.into_iter().collect()
}
