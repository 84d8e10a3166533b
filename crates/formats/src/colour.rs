//! Colours of meshes in files.

use caphy_core::{Error, Result};

/// Above this a channel cannot be an overshoot of [0, 1] (interpolation, rounding): the file counts to 255.
const LARGEST_OVERSHOOT: f32 = 2.0;

/// Colour of a mesh, sRGB.
#[derive(Debug, Clone, Copy)]
pub enum MeshColour<'a> {
    /// One colour.
    Uniform([u8; 3]),
    /// A colour per vertex, shape [vertex_count].
    PerVertex(&'a [[u8; 3]]),
}

impl MeshColour<'_> {
    pub(crate) fn check(&self, name: &str, vertex_count: usize) -> Result<()> {
        match self {
            Self::Uniform(_) => Ok(()),
            Self::PerVertex(colours) => {
                Error::check_length(&format!("mesh `{name}`, vertex colours"), vertex_count, colours.len())
            }
        }
    }
}

/// Linear intensity of an sRGB channel (IEC 61966-2-1).
pub(crate) fn linear(channel: u8) -> f64 {
    let c = f64::from(channel) / 255.0;
    if c <= 0.04045 { c / 12.92 } else { ((c + 0.055) / 1.055).powf(2.4) }
}

/// Channels in [0, 1], or in [0, 255] throughout the file, as bytes.
pub(crate) fn to_bytes(colours: &[[f32; 3]]) -> Vec<[u8; 3]> {
    let largest = colours.iter().flatten().fold(0.0, |a: f32, &c| a.max(c));
    let scale = if largest > LARGEST_OVERSHOOT { 1.0 } else { 255.0 };
    // Casts to u8 round towards zero and saturate.
    colours.iter().map(|rgb| rgb.map(|c| (c * scale + 0.5) as u8)).collect()
}
