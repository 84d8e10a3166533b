//! Plain 8-bit pictures and their PNG encoding.

use crate::raster::Image;
use caphy_core::segmenter::NO_TRIANGLE;
use caphy_core::{Error, Result};
use image::{ExtendedColorType, ImageEncoder, codecs::png::PngEncoder};

/// An 8-bit sRGB picture, row by row from the top.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Rgb {
    /// Width [pixels].
    pub width: usize,
    /// Height [pixels].
    pub height: usize,
    /// sRGB, shape [height · width].
    pub pixels: Vec<[u8; 3]>,
}

impl Rgb {
    /// A picture of one colour.
    pub fn filled(width: usize, height: usize, colour: [u8; 3]) -> Self {
        Self { width, height, pixels: vec![colour; width * height] }
    }

    /// The unshaded colours of a rendered view over a background.
    pub fn from_view(view: &Image, background: [u8; 3]) -> Self {
        let shown = |(c, t): (&[u8; 3], &u32)| if *t == NO_TRIANGLE { background } else { *c };
        let pixels = view.colour.iter().zip(&view.triangle).map(shown).collect();
        Self { width: view.width, height: view.height, pixels }
    }

    /// Copies `other` with its upper left corner at (`left`, `top`); what does not fit is cut off.
    pub fn paste(&mut self, other: &Rgb, left: usize, top: usize) {
        if other.width == 0 || left >= self.width {
            return;
        }
        let columns = other.width.min(self.width - left);
        let rows = other.pixels.chunks_exact(other.width).take(self.height.saturating_sub(top));
        for (y, row) in rows.enumerate() {
            let start = (top + y) * self.width + left;
            self.pixels[start..start + columns].copy_from_slice(&row[..columns]);
        }
    }
}

/// The picture as the bytes of a PNG file.
///
/// # Errors
/// [`Error::Length`] when the pixels do not fill the picture, [`Error::Numerics`] for a picture that PNG cannot hold
/// (no pixels).
pub fn png(picture: &Rgb) -> Result<Vec<u8>> {
    Error::check_length("picture pixels [height · width]", picture.width * picture.height, picture.pixels.len())?;
    let cannot = |problem: String| {
        let what = format!("PNG of a {} × {} picture", picture.width, picture.height);
        Error::numerics(what, problem, "give it a width and a height from 1 to 2^31 - 1")
    };
    let (Ok(width), Ok(height)) = (u32::try_from(picture.width), u32::try_from(picture.height)) else {
        return Err(cannot("a side is too long".into()));
    };
    if width == 0 || height == 0 {
        return Err(cannot("it has no pixels".into()));
    }
    let mut bytes = Vec::new();
    PngEncoder::new(&mut bytes)
        .write_image(picture.pixels.as_flattened(), width, height, ExtendedColorType::Rgb8)
        .map_err(|e| cannot(e.to_string()))?;
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn png_reads_back() {
        let mut picture = Rgb::filled(5, 3, [10, 20, 30]);
        picture.paste(&Rgb::filled(3, 3, [200, 0, 0]), 4, 1);
        let read = image::load_from_memory(&png(&picture).unwrap()).unwrap().to_rgb8();
        assert_eq!((read.width(), read.height()), (5, 3));
        assert_eq!(read.as_raw().as_slice(), picture.pixels.as_flattened());
        assert_eq!(picture.pixels[9], [200, 0, 0]);
        assert_eq!(picture.pixels[8], [10, 20, 30]);
    }

    #[test]
    fn a_picture_without_pixels_or_with_too_few_is_refused() {
        assert!(png(&Rgb::filled(0, 3, [0; 3])).unwrap_err().to_string().contains("0 × 3"));
        let mut cut = Rgb::filled(4, 4, [0; 3]);
        cut.pixels.pop();
        assert!(png(&cut).unwrap_err().to_string().contains("expected 16"));
    }
}
