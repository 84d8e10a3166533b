//! Text in pictures, and contact sheets: several pictures in a grid, each with a short label.

use crate::font;
use crate::rgb::Rgb;

/// Empty space around each picture of a sheet [pixels].
pub const MARGIN: usize = 8;

const TEXT: [u8; 3] = [40, 42, 48];
const PAPER: [u8; 3] = [255; 3];

/// Width of a text [pixels] at `dot` pixels per dot of the font.
pub fn text_width(text: &str, dot: usize) -> usize {
    (text.chars().count() * (font::WIDTH + 1)).saturating_sub(1) * dot
}

/// Writes a text with its upper left corner at (`left`, `top`), `dot` pixels per dot (a letter is 7 dots high). What
/// does not fit is cut off; small letters are shown as capitals.
pub fn write_text(picture: &mut Rgb, text: &str, left: usize, top: usize, dot: usize, colour: [u8; 3]) {
    for (i, c) in text.chars().enumerate() {
        let x0 = left + i * (font::WIDTH + 1) * dot;
        for (row, bits) in font::glyph(c).iter().enumerate() {
            for column in (0..font::WIDTH).filter(|column| bits >> (font::WIDTH - 1 - column) & 1 == 1) {
                for y in (top + row * dot..top + (row + 1) * dot).take_while(|y| *y < picture.height) {
                    for x in x0 + column * dot..(x0 + (column + 1) * dot).min(picture.width) {
                        picture.pixels[y * picture.width + x] = colour;
                    }
                }
            }
        }
    }
}

/// Pictures in rows of `columns` (at least 1), each in a cell of the largest picture's size with its label below, on
/// white. Labels that are too wide for their cell are cut off. Without pictures the sheet is one empty margin.
pub fn contact_sheet(pictures: &[(&str, &Rgb)], columns: usize) -> Rgb {
    let columns = columns.clamp(1, pictures.len().max(1));
    let rows = pictures.len().div_ceil(columns);
    let width = pictures.iter().map(|(_, p)| p.width).max().unwrap_or(0);
    let height = pictures.iter().map(|(_, p)| p.height).max().unwrap_or(0);
    let dot = if width >= 200 { 2 } else { 1 };
    let labelled = pictures.iter().any(|(label, _)| !label.is_empty());
    let line = if labelled { (font::HEIGHT + 3) * dot } else { 0 };
    let (step_x, step_y) = (width + MARGIN, height + line + MARGIN);
    let mut sheet = Rgb::filled(MARGIN + columns * step_x, MARGIN + rows * step_y, PAPER);
    for (i, (label, picture)) in pictures.iter().enumerate() {
        let (left, top) = (MARGIN + i % columns * step_x, MARGIN + i / columns * step_y);
        sheet.paste(picture, left + (width - picture.width) / 2, top + (height - picture.height) / 2);
        let fits = (width + dot) / ((font::WIDTH + 1) * dot);
        let text: String = label.chars().take(fits).collect();
        let indent = (width - text_width(&text, dot).min(width)) / 2;
        write_text(&mut sheet, &text, left + indent, top + height + 2 * dot, dot, TEXT);
    }
    sheet
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sheet_holds_its_pictures_and_labels() {
        let (red, blue) = (Rgb::filled(40, 30, [255, 0, 0]), Rgb::filled(20, 30, [0, 0, 255]));
        let sheet = contact_sheet(&[("one", &red), ("two", &blue), ("a label far too long", &red)], 2);
        assert_eq!((sheet.width, sheet.height), (8 + 2 * 48, 8 + 2 * (30 + 10 + 8)));
        let count = |c: [u8; 3]| sheet.pixels.iter().filter(|p| **p == c).count();
        assert_eq!((count([255, 0, 0]), count([0, 0, 255])), (2400, 600));
        assert!(count(TEXT) > 50);
        // Labels stay in their cells: nothing is written beside the third picture.
        assert!((0..sheet.height).all(|y| sheet.pixels[y * sheet.width + sheet.width - 1] == PAPER));
        assert_eq!(contact_sheet(&[], 0).width, 16);
    }

    #[test]
    fn text_outside_is_cut_off() {
        let mut small = Rgb::filled(4, 4, [0; 3]);
        write_text(&mut small, "W", 1, 1, 1, [9; 3]);
        write_text(&mut small, "W", 100, 100, 3, [9; 3]);
        assert!(small.pixels.contains(&[9; 3]));
    }
}
