//! Pictures of labels.

use caphy_core::scan::{Label, Scan};
use caphy_core::segmenter::Camera;
use caphy_core::{Error, Result};
use caphy_render::{Layer, Picture, Rgb};

/// The sRGB colour that stands for a label in pictures.
pub fn label_colour(label: Label) -> [u8; 3] {
    match label {
        Label::Body => [222, 184, 158],
        Label::Upper => [70, 122, 190],
        Label::Lower => [86, 156, 104],
        Label::Ignore => [190, 60, 170],
    }
}

/// A colour per label.
pub fn label_colours(labels: &[Label]) -> Vec<[u8; 3]> {
    labels.iter().map(|l| label_colour(*l)).collect()
}

/// A shaded picture of a scan in the colours of its labels (shape [vertex_count]), as `camera` sees it.
///
/// # Errors
/// [`Error::Length`] when the labels are not as many as the vertices.
pub fn label_picture(scan: &Scan, labels: &[Label], camera: &Camera) -> Result<Rgb> {
    let what = format!("labels for a picture of scan `{}` [vertex_count]", scan.name);
    Error::check_length(&what, scan.mesh.vertices.len(), labels.len())?;
    let colours = label_colours(labels);
    Ok(Picture::new(camera.clone(), vec![Layer::per_vertex(&scan.mesh, &colours)]).draw())
}
