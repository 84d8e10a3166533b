//! Pictures of the pipeline's results, for the report.

use caphy_core::scan::{Label, LabelledPoints};
use caphy_core::{Result, TriMesh, Vec3, mesh};
use caphy_garment::template::GarmentKind;
use caphy_render::shade::{CLAY_LOWER, CLAY_SKIN, CLAY_UPPER};
use caphy_render::{Layer, Picture, Projection, Rgb, frame, png};

/// Width and height of a picture in a sheet [pixels].
pub const SIZE: [usize; 2] = [260, 420];
/// From the front, a little from above and from the side.
pub const FRONT: Vec3 = Vec3::new(0.35, 0.15, 1.0);
/// From behind.
pub const BACK: Vec3 = Vec3::new(-0.5, 0.2, -1.0);

/// A dressed body: skin, upper, lower.
pub struct Dressed<'a> {
    /// The body's surface.
    pub body: &'a TriMesh,
    /// Garments, upper first.
    pub garments: Vec<TriMesh>,
}

/// Draws layers from a side, framed by `bounds`.
pub fn draw(layers: Vec<Layer<'_>>, bounds: (Vec3, Vec3), from: &Vec3) -> Rgb {
    let camera = frame(bounds, from, Projection::Orthographic, SIZE[0], SIZE[1]);
    Picture::new(camera, layers).with_ground(bounds.0.y).draw()
}

/// A dressed body from one side.
pub fn dressed(dressed: &Dressed<'_>, from: &Vec3) -> Rgb {
    let colours = [CLAY_UPPER, CLAY_LOWER];
    let mut layers = vec![Layer::uniform(dressed.body, CLAY_SKIN)];
    layers.extend(dressed.garments.iter().zip(colours).map(|(mesh, colour)| Layer::uniform(mesh, colour)));
    let bounds = mesh::bounds(&dressed.body.vertices).unwrap_or((Vec3::zeros(), Vec3::repeat(1.0)));
    draw(layers, padded(bounds), from)
}

/// A body in one garment, near: framed by the garment.
pub fn worn(body: &TriMesh, garment: &TriMesh, kind: GarmentKind, from: &Vec3) -> Rgb {
    let colour = match kind {
        GarmentKind::Upper => CLAY_UPPER,
        GarmentKind::Lower => CLAY_LOWER,
    };
    let layers = vec![Layer::uniform(body, CLAY_SKIN), Layer::uniform(garment, colour)];
    let bounds = mesh::bounds(&garment.vertices).unwrap_or((Vec3::zeros(), Vec3::repeat(1.0)));
    draw(layers, padded(bounds), from)
}

/// Room around a body for its clothes.
pub fn padded(bounds: (Vec3, Vec3)) -> (Vec3, Vec3) {
    let pad = Vec3::new(0.06, 0.03, 0.06);
    (bounds.0 - Vec3::new(pad.x, 0.0, pad.z), bounds.1 + pad)
}

/// Colour of a label in pictures.
pub fn label_colour(label: Label) -> [u8; 3] {
    match label {
        Label::Body => CLAY_SKIN,
        Label::Upper => CLAY_UPPER,
        Label::Lower => CLAY_LOWER,
        Label::Ignore => [230, 60, 200],
    }
}

/// Label colours of a labelled scan, one per vertex.
pub fn label_colours(points: &LabelledPoints) -> Vec<[u8; 3]> {
    points.labels.iter().map(|&l| label_colour(l)).collect()
}

/// PNG bytes of pictures side by side with labels.
pub fn sheet(pictures: &[(String, Rgb)], columns: usize) -> Result<Vec<u8>> {
    let list: Vec<(&str, &Rgb)> = pictures.iter().map(|(label, picture)| (label.as_str(), picture)).collect();
    png(&caphy_render::contact_sheet(&list, columns))
}
