//! Pictures as networks take them: size, order of channels, normalisation; and where in an answer a pixel is.

use caphy_core::{Error, Result};
use serde::{Deserialize, Serialize};

/// Which channel of a picture comes first.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ChannelOrder {
    /// Red, as in torchvision.
    #[default]
    Rgb,
    /// Blue, as in OpenCV and Caffe.
    Bgr,
}

/// What a network was trained on: channels in [0, 1], less a mean, over a standard deviation.
///
/// ```toml
/// channels = "bgr"
/// mean = [0.406, 0.456, 0.485]
/// std = [0.225, 0.224, 0.229]
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Pixels {
    /// Which channel comes first. Default red.
    pub channels: ChannelOrder,
    /// Mean of each channel, in their order [1]. Default ImageNet's, red first.
    pub mean: [f32; 3],
    /// Standard deviation of each channel, in their order [1]. Default ImageNet's, red first.
    pub std: [f32; 3],
}

impl Default for Pixels {
    fn default() -> Self {
        Self { channels: ChannelOrder::Rgb, mean: [0.485, 0.456, 0.406], std: [0.229, 0.224, 0.225] }
    }
}

impl Pixels {
    /// Refuses values that no picture survives; `key` is the table's dotted path.
    ///
    /// # Errors
    /// [`Error::Config`] for a mean that is not finite, a deviation that is not positive.
    pub fn check(&self, key: &str) -> Result<()> {
        if self.mean.iter().any(|m| !m.is_finite()) {
            return Err(Error::config(format!("{key}.mean"), format!("{:?}", self.mean), "give finite numbers"));
        }
        if self.std.iter().any(|s| !(s.is_finite() && *s > 0.0)) {
            return Err(Error::config(format!("{key}.std"), format!("{:?}", self.std), "give positive numbers"));
        }
        Ok(())
    }

    /// A picture, red first in [0, 1], shape [height · width], as a network's input, shape [3 · height · width] of `placement`:
    /// bilinear between pixels, `background` beside the picture.
    ///
    /// # Errors
    /// [`Error::Length`] for a picture of another size than that of `placement`.
    pub fn tensor(&self, picture: &[[f32; 3]], background: [f32; 3], placement: &Placement) -> Result<Vec<f32>> {
        let ([height, width], [rows, columns]) = (placement.picture, placement.input);
        Error::check_length("picture [height · width]", height * width, picture.len())?;
        let plane = rows * columns;
        let mut out = vec![0.0; 3 * plane];
        for row in 0..rows {
            for column in 0..columns {
                let [y, x] = placement.picture_at([row as f64 + 0.5, column as f64 + 0.5]);
                let inside = y >= 0.0 && x >= 0.0 && y <= height as f64 && x <= width as f64;
                let colour = match inside {
                    true => {
                        let corners = Corners::new([y - 0.5, x - 0.5], placement.picture);
                        std::array::from_fn(|k| corners.mix(|pixel| picture[pixel][k]))
                    }
                    false => background,
                };
                for k in 0..3 {
                    let channel = match self.channels {
                        ChannelOrder::Rgb => colour[k],
                        ChannelOrder::Bgr => colour[2 - k],
                    };
                    out[k * plane + row * columns + column] = (channel - self.mean[k]) / self.std[k];
                }
            }
        }
        Ok(out)
    }
}

/// How a picture of other proportions than a network's becomes its input.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Fit {
    /// Scaled alike in both directions, in the middle, with background beside it.
    #[default]
    Letterbox,
    /// Scaled in each direction to fill it.
    Stretch,
}

/// Where a picture lies in a network's input. Positions are (row, column) from the upper left corner [pixels], centres of pixels at
/// half-integers; sizes are [height, width].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Placement {
    picture: [usize; 2],
    input: [usize; 2],
    /// Input pixels per picture pixel.
    scale: [f64; 2],
    /// Of the picture's corner in the input.
    offset: [f64; 2],
}

impl Placement {
    /// Puts a picture into an input of another size.
    pub fn new(picture: [usize; 2], input: [usize; 2], fit: Fit) -> Self {
        let mut scale: [f64; 2] = std::array::from_fn(|k| input[k] as f64 / picture[k].max(1) as f64);
        if fit == Fit::Letterbox {
            scale = [scale[0].min(scale[1]); 2];
        }
        let offset = std::array::from_fn(|k| 0.5 * (input[k] as f64 - scale[k] * picture[k] as f64));
        Self { picture, input, scale, offset }
    }

    /// Size of the input.
    pub fn input(&self) -> [usize; 2] {
        self.input
    }

    fn picture_at(&self, at: [f64; 2]) -> [f64; 2] {
        std::array::from_fn(|k| (at[k] - self.offset[k]) / self.scale[k])
    }

    /// The pixels of an answer of `size` around a position in the picture. `corners`: whether the centres of the answer's corner
    /// pixels are those of the input's (`align_corners` in PyTorch), or the answer's corners the input's corners.
    pub fn answer_at(&self, at: [f64; 2], size: [usize; 2], corners: bool) -> Corners {
        let place = std::array::from_fn(|k| {
            let in_input = self.offset[k] + self.scale[k] * at[k];
            let (answer, input) = (size[k] as f64, self.input[k] as f64);
            match corners {
                // Where both have the same size the ratio is exactly 1: nothing is mixed.
                true if self.input[k] > 1 => (in_input - 0.5) * ((answer - 1.0) / (input - 1.0)),
                _ => in_input * (answer / input) - 0.5,
            }
        });
        Corners::new(place, size)
    }
}

/// Four neighbouring pixels and how much of each counts at a place between their centres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Corners {
    pixels: [usize; 4],
    /// Shares of the lower row and the right column.
    share: [f64; 2],
}

impl Corners {
    /// Around (row, column) counted from the first pixel's centre; beyond the border its pixels go on.
    fn new(place: [f64; 2], size: [usize; 2]) -> Self {
        let last = size.map(|n| n.saturating_sub(1));
        let clamped: [f64; 2] = std::array::from_fn(|k| place[k].clamp(0.0, last[k] as f64));
        let first = clamped.map(|c| c as usize);
        let next: [usize; 2] = std::array::from_fn(|k| (first[k] + 1).min(last[k]));
        let pixel = |row: usize, column: usize| row * size[1] + column;
        Self {
            pixels: [
                pixel(first[0], first[1]),
                pixel(first[0], next[1]),
                pixel(next[0], first[1]),
                pixel(next[0], next[1]),
            ],
            share: std::array::from_fn(|k| clamped[k] - first[k] as f64),
        }
    }

    /// Bilinear mean of values by pixel.
    pub fn mix(&self, value: impl Fn(usize) -> f32) -> f32 {
        let [a, b, c, d] = self.pixels.map(|p| f64::from(value(p)));
        let [down, right] = self.share;
        let row = |left: f64, next: f64| left + right * (next - left);
        let (upper, lower) = (row(a, b), row(c, d));
        (upper + down * (lower - upper)) as f32
    }

    /// The nearest pixel.
    pub fn nearest(&self) -> usize {
        self.pixels[2 * usize::from(self.share[0] >= 0.5) + usize::from(self.share[1] >= 0.5)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Column, row and 0.5, in [0, 1].
    fn ramps([height, width]: [usize; 2]) -> Vec<[f32; 3]> {
        let at = |i: usize| [(i % width) as f32 / width as f32, (i / width) as f32 / height as f32, 0.5];
        (0..height * width).map(at).collect()
    }

    const PLAIN: Pixels = Pixels { channels: ChannelOrder::Rgb, mean: [0.0; 3], std: [1.0; 3] };

    #[test]
    fn the_same_size_is_the_same_picture() {
        let size = [5, 7];
        let picture = ramps(size);
        for fit in [Fit::Letterbox, Fit::Stretch] {
            let tensor = PLAIN.tensor(&picture, [9.0; 3], &Placement::new(size, size, fit)).unwrap();
            let planes: Vec<f32> = (0..3).flat_map(|k| picture.iter().map(move |p| p[k])).collect();
            assert_eq!(tensor, planes);
        }
        assert!(PLAIN.tensor(&picture[1..], [0.0; 3], &Placement::new(size, size, Fit::Stretch)).is_err());
    }

    #[test]
    fn channels_are_put_in_order_before_they_are_normalised() {
        let pixels = Pixels { channels: ChannelOrder::Bgr, mean: [0.1, 0.2, 0.3], std: [1.0, 2.0, 4.0] };
        let tensor =
            pixels.tensor(&[[0.25, 0.5, 1.0]], [0.0; 3], &Placement::new([1; 2], [1; 2], Fit::Stretch)).unwrap();
        assert_eq!(tensor, [(1.0 - 0.1) / 1.0, (0.5 - 0.2) / 2.0, (0.25 - 0.3) / 4.0]);
    }

    #[test]
    fn letterboxes_have_background_beside_and_keep_proportions() {
        // Twice as wide as high into a square: a quarter above and below.
        let (picture, placement) = (ramps([4, 8]), Placement::new([4, 8], [16, 16], Fit::Letterbox));
        let tensor = PLAIN.tensor(&picture, [7.0, 8.0, 9.0], &placement).unwrap();
        let at = |k: usize, row: usize, column: usize| tensor[(k * 16 + row) * 16 + column];
        for row in [0, 3, 12, 15] {
            assert_eq!([at(0, row, 5), at(1, row, 5), at(2, row, 5)], [7.0, 8.0, 9.0]);
        }
        // Between centres a ramp is a ramp: at 2 pixels per pixel, centre 6.5 is at 3.25, which is 2.75 from the first centre.
        assert!((at(0, 8, 6) - 2.75 / 8.0).abs() < 1e-6);
        // Above the first centre it does not go on.
        assert_eq!(at(1, 4, 8), 0.0);
        let stretched = PLAIN.tensor(&picture, [7.0; 3], &Placement::new([4, 8], [16, 16], Fit::Stretch)).unwrap();
        assert!(stretched.iter().all(|v| *v < 1.0));
    }

    #[test]
    fn answers_are_read_where_the_picture_is() {
        // An answer of a quarter of the size that holds a ramp in input coordinates by either convention gives it back.
        let placement = Placement::new([40, 80], [65, 65], Fit::Letterbox);
        let size = [17, 17];
        for (corners, step, first) in [(true, 4.0, 0.5), (false, 65.0 / 17.0, 0.5 * 65.0 / 17.0)] {
            let value = |pixel: usize| (first + step * (pixel % 17) as f64) as f32;
            for column in [10.0, 33.3, 64.5] {
                let read = placement.answer_at([20.0, column], size, corners).mix(value);
                let expected = column * 65.0 / 80.0;
                assert!((f64::from(read) - expected).abs() < 1e-4, "{corners} {column}: {read} is not {expected}");
            }
        }
        // The same size: the pixel itself.
        let same = Placement::new([9, 9], [9, 9], Fit::Letterbox);
        for corners in [true, false] {
            let at = same.answer_at([2.5, 4.5], [9, 9], corners);
            assert_eq!((at.nearest(), at.mix(|p| if p == 2 * 9 + 4 { 1.0 } else { f32::MAX })), (22, 1.0));
        }
    }

    #[test]
    fn values_that_no_picture_survives_are_refused() {
        assert!(Pixels::default().check("segmenter.pixels").is_ok());
        let mean = Pixels { mean: [0.0, f32::NAN, 0.0], ..PLAIN }.check("segmenter.pixels").unwrap_err().to_string();
        let std = Pixels { std: [1.0, 0.0, 1.0], ..PLAIN }.check("segmenter.pixels").unwrap_err().to_string();
        assert!(mean.contains("segmenter.pixels.mean") && std.contains("segmenter.pixels.std"), "{mean} {std}");
    }
}
