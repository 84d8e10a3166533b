//! Images in: textures (PNG, JPEG) and images whose pixels are class numbers (PNG).

use caphy_core::{Error, Result};
use std::io::Cursor;
use std::path::Path;
use zune_jpeg::JpegDecoder;
use zune_jpeg::zune_core::colorspace::ColorSpace;
use zune_jpeg::zune_core::options::DecoderOptions;

/// Largest width and height that are read [pixels].
const LARGEST: usize = 16_384;

/// Rows of sRGB pixels from the top.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ColourImage {
    /// Width [pixels].
    pub width: usize,
    /// Height [pixels].
    pub height: usize,
    /// Shape [height · width].
    pub pixels: Vec<[u8; 3]>,
}

impl ColourImage {
    /// The colour at texture coordinates (u to the right, v upwards, repeated outside of [0, 1]), between the four nearest pixels.
    pub fn at(&self, [u, v]: [f64; 2]) -> [f64; 3] {
        let place = |t: f64, n: usize| {
            let x = (t - t.floor()) * n as f64 - 0.5;
            let low = x.floor();
            let wrap = |i: f64| (i as i64).rem_euclid(n as i64) as usize;
            (wrap(low), wrap(low + 1.0), x - low)
        };
        let (x0, x1, fx) = place(u, self.width);
        let (y0, y1, fy) = place(1.0 - v, self.height);
        let pixel = |x: usize, y: usize| self.pixels[y * self.width + x].map(f64::from);
        let [a, b, c, d] = [pixel(x0, y0), pixel(x1, y0), pixel(x0, y1), pixel(x1, y1)];
        std::array::from_fn(|k| (a[k] * (1.0 - fx) + b[k] * fx) * (1.0 - fy) + (c[k] * (1.0 - fx) + d[k] * fx) * fy)
    }
}

/// Rows of class numbers from the top.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ClassImage {
    /// Width [pixels].
    pub width: usize,
    /// Height [pixels].
    pub height: usize,
    /// Shape [height · width].
    pub classes: Vec<u8>,
}

const EXPORT: &str = "export the image again as PNG or JPEG";

fn check_size(path: &Path, width: usize, height: usize) -> Result<()> {
    if (1..=LARGEST).contains(&width) && (1..=LARGEST).contains(&height) {
        return Ok(());
    }
    let problem = format!("is {width} × {height} pixels, 1 to {LARGEST} are read");
    Err(Error::format(path, "image", problem, "scale the image"))
}

/// Reads a PNG or JPEG, known by its first bytes. Transparency is left out.
///
/// # Errors
/// [`Error::Format`] for other formats, damaged files and images larger than 16384 pixels a side.
pub fn read_image(path: &Path, bytes: &[u8]) -> Result<ColourImage> {
    if bytes.starts_with(b"\x89PNG") {
        let png = Png::read(path, bytes, png::Transformations::EXPAND | png::Transformations::STRIP_16)?;
        let step = png.colour.samples();
        let pixels = png.samples.chunks_exact(step).map(|p| if step < 3 { [p[0]; 3] } else { [p[0], p[1], p[2]] });
        return Ok(ColourImage { width: png.width, height: png.height, pixels: pixels.collect() });
    }
    if bytes.starts_with(b"\xff\xd8") {
        let options = DecoderOptions::default()
            .jpeg_set_out_colorspace(ColorSpace::RGB)
            .set_max_width(LARGEST)
            .set_max_height(LARGEST);
        let mut decoder = JpegDecoder::new_with_options(Cursor::new(bytes), options);
        let bad = |e: String| Error::format(path, "JPEG", e, EXPORT);
        let samples = decoder.decode().map_err(|e| bad(e.to_string()))?;
        let (width, height) = decoder.dimensions().ok_or_else(|| bad("has no size".into()))?;
        check_size(path, width, height)?;
        let pixels: Vec<[u8; 3]> = samples.chunks_exact(3).map(|p| [p[0], p[1], p[2]]).collect();
        Error::check_length(&format!("pixels of {}", path.display()), width * height, pixels.len())?;
        return Ok(ColourImage { width, height, pixels });
    }
    Err(Error::format(path, "first bytes", "is neither a PNG nor a JPEG", EXPORT))
}

/// Reads a PNG whose pixels are class numbers: indices into a palette (as human parsers write them), grey levels, or
/// colours of PASCAL VOC's colour map, which such palettes hold, where a program has turned indices into colours.
///
/// # Errors
/// [`Error::Format`] for what is no PNG or damaged, for 16 bits, and for a colour that is not of that map.
pub fn read_class_image(path: &Path, bytes: &[u8]) -> Result<ClassImage> {
    if !bytes.starts_with(b"\x89PNG") {
        let remedy = "write label images as PNG: JPEG changes the numbers";
        return Err(Error::format(path, "first bytes", "is no PNG", remedy));
    }
    let png = Png::read(path, bytes, png::Transformations::IDENTITY)?;
    let (width, height) = (png.width, png.height);
    let classes = match (png.colour, png.depth) {
        (png::ColorType::Indexed | png::ColorType::Grayscale, 8) => png.samples,
        (png::ColorType::Indexed | png::ColorType::Grayscale, bits @ (1 | 2 | 4)) => {
            let row = (width * usize::from(bits)).div_ceil(8);
            let of = |x: usize, y: usize| {
                let bit = x * usize::from(bits);
                png.samples[y * row + bit / 8] >> (8 - usize::from(bits) - bit % 8) & ((1 << bits) - 1)
            };
            (0..height).flat_map(|y| (0..width).map(move |x| (x, y))).map(|(x, y)| of(x, y)).collect()
        }
        (png::ColorType::GrayscaleAlpha, 8) => png.samples.chunks_exact(2).map(|p| p[0]).collect(),
        (png::ColorType::Rgb | png::ColorType::Rgba, 8) => {
            let map: Vec<[u8; 3]> = (0..=255).map(voc_colour).collect();
            let mut classes = Vec::with_capacity(width * height);
            for (i, p) in png.samples.chunks_exact(png.colour.samples()).enumerate() {
                let colour = [p[0], p[1], p[2]];
                let class = map.iter().position(|c| *c == colour).ok_or_else(|| {
                    let at = format!("pixel ({}, {})", i % width, i / width);
                    let problem = format!("the colour {colour:?} is not of PASCAL VOC's colour map");
                    Error::format(
                        path,
                        at,
                        problem,
                        "save the class numbers themselves, as palette indices or grey levels",
                    )
                })?;
                classes.push(class as u8);
            }
            classes
        }
        (colour, bits) => {
            let problem = format!("{colour:?} with {bits} bits");
            return Err(Error::format(
                path,
                "PNG",
                problem,
                "save class numbers as 8-bit palette indices or grey levels",
            ));
        }
    };
    Error::check_length(&format!("pixels of {}", path.display()), width * height, classes.len())?;
    Ok(ClassImage { width, height, classes })
}

/// The colour of a class in PASCAL VOC's map: the class's bits, three at a time, from the colours' highest bits on.
fn voc_colour(class: u8) -> [u8; 3] {
    let mut colour = [0u8; 3];
    for j in 0..3 {
        for (k, c) in colour.iter_mut().enumerate() {
            let bit = 3 * j + k;
            if bit < 8 {
                *c |= (class >> bit & 1) << (7 - j);
            }
        }
    }
    colour
}

struct Png {
    width: usize,
    height: usize,
    colour: png::ColorType,
    depth: u8,
    samples: Vec<u8>,
}

impl Png {
    fn read(path: &Path, bytes: &[u8], transformations: png::Transformations) -> Result<Self> {
        let bad = |e: png::DecodingError| Error::format(path, "PNG", e.to_string(), EXPORT);
        let mut decoder = png::Decoder::new(Cursor::new(bytes));
        decoder.set_transformations(transformations);
        let mut reader = decoder.read_info().map_err(bad)?;
        let (width, height) = (reader.info().width as usize, reader.info().height as usize);
        check_size(path, width, height)?;
        let size =
            reader.output_buffer_size().ok_or_else(|| Error::format(path, "PNG", "is too large", "scale the image"))?;
        let mut samples = vec![0; size];
        let frame = reader.next_frame(&mut samples).map_err(bad)?;
        samples.truncate(frame.buffer_size());
        Ok(Self { width, height, colour: frame.color_type, depth: frame.bit_depth as u8, samples })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn png(colour: png::ColorType, depth: png::BitDepth, width: u32, height: u32, data: &[u8]) -> Vec<u8> {
        let mut bytes = Vec::new();
        let mut encoder = png::Encoder::new(&mut bytes, width, height);
        encoder.set_color(colour);
        encoder.set_depth(depth);
        if colour == png::ColorType::Indexed {
            encoder.set_palette((0..16).flat_map(voc_colour).collect::<Vec<u8>>());
        }
        encoder.write_header().unwrap().write_image_data(data).unwrap();
        bytes
    }

    #[test]
    fn class_numbers_from_indices_grey_levels_and_colours() {
        let path = Path::new("p.png");
        let expected = vec![0, 5, 9, 12, 1, 15];
        let cases = [
            png(png::ColorType::Indexed, png::BitDepth::Eight, 3, 2, &expected),
            png(png::ColorType::Grayscale, png::BitDepth::Eight, 3, 2, &expected),
            // Four bits: rows begin at whole bytes.
            png(png::ColorType::Indexed, png::BitDepth::Four, 3, 2, &[0x05, 0x90, 0xc1, 0xf0]),
            png(
                png::ColorType::Rgb,
                png::BitDepth::Eight,
                3,
                2,
                &expected.iter().flat_map(|&c| voc_colour(c)).collect::<Vec<u8>>(),
            ),
        ];
        for bytes in cases {
            let image = read_class_image(path, &bytes).unwrap();
            assert_eq!((image.width, image.height, &image.classes), (3, 2, &expected));
        }
        // The published start of the map.
        assert_eq!(
            [1, 2, 3, 4, 15].map(voc_colour),
            [[128, 0, 0], [0, 128, 0], [128, 128, 0], [0, 0, 128], [192, 128, 128]]
        );
        let other = png(png::ColorType::Rgb, png::BitDepth::Eight, 1, 1, &[1, 2, 3]);
        let text = read_class_image(path, &other).unwrap_err().to_string();
        assert!(text.contains("p.png") && text.contains("[1, 2, 3]") && text.contains("palette indices"), "{text}");
        assert!(read_class_image(path, b"\xff\xd8\xff").unwrap_err().to_string().contains("JPEG changes"));
    }

    #[test]
    fn textures_are_sampled_with_v_upwards_and_damage_is_named() {
        let bytes = png(png::ColorType::Rgb, png::BitDepth::Eight, 2, 2, &[255, 0, 0, 0, 255, 0, 0, 0, 255, 9, 9, 9]);
        let image = read_image(Path::new("t.png"), &bytes).unwrap();
        assert_eq!(image.at([0.25, 0.75]), [255.0, 0.0, 0.0]);
        assert_eq!(image.at([0.25, 0.25]), [0.0, 0.0, 255.0]);
        assert_eq!(image.at([0.5, 0.75]), [127.5, 127.5, 0.0]);
        for cut in [3, 8, 40, bytes.len() - 20] {
            let text = read_image(Path::new("t.png"), &bytes[..cut]).unwrap_err().to_string();
            assert!(text.contains("t.png"), "{text}");
        }
        assert!(read_image(Path::new("t.jpg"), b"\xff\xd8\xff\xe0\x00").unwrap_err().to_string().contains("t.jpg"));
    }
}
