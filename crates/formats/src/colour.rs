//! Colours of meshes in files.

use caphy_core::{Error, Result};

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
