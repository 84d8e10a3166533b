//! Plain 8-bit pictures and their PNG encoding.

use crate::raster::Image;
use caphy_core::segmenter::NO_TRIANGLE;
use caphy_core::{Error, Result};

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
    let mut encoder = png::Encoder::new(&mut bytes, width, height);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    let mut writer = encoder.write_header().map_err(|e| cannot(e.to_string()))?;
    writer.write_image_data(picture.pixels.as_flattened()).map_err(|e| cannot(e.to_string()))?;
    writer.finish().map_err(|e| cannot(e.to_string()))?;
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn png_reads_back() {
        let mut picture = Rgb::filled(5, 3, [10, 20, 30]);
        picture.paste(&Rgb::filled(3, 3, [200, 0, 0]), 4, 1);
        let bytes = png(&picture).unwrap();
        let mut reader = png::Decoder::new(std::io::Cursor::new(&bytes)).read_info().unwrap();
        let mut read = vec![0; 5 * 3 * 3];
        let info = reader.next_frame(&mut read).unwrap();
        assert_eq!((info.width, info.height, info.color_type), (5, 3, png::ColorType::Rgb));
        assert_eq!(read, picture.pixels.as_flattened());
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
