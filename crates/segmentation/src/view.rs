//! What every segmenter checks of a view before it reads it.

use caphy_core::scan::Label;
use caphy_core::segmenter::View;
use caphy_core::{Error, Result};

/// `Ok` when the images and the labels all have the camera's size.
pub(crate) fn check(view: &View<'_>, labels: &[Label]) -> Result<()> {
    let count = view.camera.width * view.camera.height;
    let image = |what: &str| format!("{what} of view {} of scan `{}` [height · width]", view.index, view.scan.name);
    Error::check_length(&image("colour image"), count, view.colour.len())?;
    Error::check_length(&image("depth image"), count, view.depth.len())?;
    Error::check_length(&image("triangle image"), count, view.triangle.len())?;
    Error::check_length(&image("labels"), count, labels.len())
}

/// `Ok` when the scan has the colours that the segmenter `name` looks at.
pub(crate) fn check_colours(view: &View<'_>, name: &str) -> Result<()> {
    if view.scan.colours.is_some() {
        return Ok(());
    }
    Err(Error::mesh(
        &view.scan.name,
        "vertex colours",
        format!("the scan stores none, but the segmenter `{name}` reads them"),
        "bake the texture into vertex colours, or use `type = \"vertex\"` with stored labels",
    ))
}
