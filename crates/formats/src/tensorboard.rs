//! TensorBoard event files: scalars and pictures by step.
//!
//! An event file is a sequence of records (`TFRecord`), each one protocol buffer (`tensorflow.Event`). Both are small and
//! have not changed in years, so that they are written here by hand. A file may be cut behind any record and gone on
//! with: TensorBoard then reads on as if nothing had happened. Its name must contain `tfevents`.
//!
//! A record is as long for one wall time as for another: two files with the same steps, names and pictures differ in
//! the eight bytes of each wall time and in what checks them.

/// Something seen at a step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Value<'a> {
    /// A number.
    Scalar(f32),
    /// A PNG file in RGB.
    Picture {
        /// Width [pixels].
        width: usize,
        /// Height [pixels].
        height: usize,
        /// The file's bytes.
        png: &'a [u8],
    },
}

/// The record that an event file begins with; `wall_time` in seconds since 1970.
pub fn first_record(wall_time: f64) -> Vec<u8> {
    let mut event = Vec::new();
    double(&mut event, 1, wall_time);
    bytes(&mut event, 3, b"brain.Event:2");
    record(&event)
}

/// The record of one step: values by name. TensorBoard groups names by what stands before their first `/`.
pub fn step_record(wall_time: f64, step: u64, values: &[(&str, Value<'_>)]) -> Vec<u8> {
    let mut summary = Vec::new();
    for (tag, value) in values {
        let mut entry = Vec::new();
        bytes(&mut entry, 1, tag.as_bytes());
        match value {
            Value::Scalar(value) => {
                key(&mut entry, 2, 5);
                entry.extend(value.to_le_bytes());
            }
            Value::Picture { width, height, png } => {
                /// `tensorflow.Summary.Image.colorspace`: RGB.
                const RGB: u64 = 3;
                let mut image = Vec::with_capacity(png.len() + 24);
                number(&mut image, 1, *height as u64);
                number(&mut image, 2, *width as u64);
                number(&mut image, 3, RGB);
                bytes(&mut image, 4, png);
                bytes(&mut entry, 4, &image);
            }
        }
        bytes(&mut summary, 1, &entry);
    }
    let mut event = Vec::new();
    double(&mut event, 1, wall_time);
    number(&mut event, 2, step);
    bytes(&mut event, 5, &summary);
    record(&event)
}

/// Length, its check, data, its check.
fn record(data: &[u8]) -> Vec<u8> {
    let length = (data.len() as u64).to_le_bytes();
    let mut out = Vec::with_capacity(data.len() + 16);
    out.extend(length);
    out.extend(masked(crc32c(&length)).to_le_bytes());
    out.extend(data);
    out.extend(masked(crc32c(data)).to_le_bytes());
    out
}

/// A check that may itself be checked: a sum over data that holds its own sum says little.
fn masked(crc: u32) -> u32 {
    crc.rotate_right(15).wrapping_add(0xa282_ead8)
}

/// CRC-32C (Castagnoli), bits reflected.
fn crc32c(data: &[u8]) -> u32 {
    const TABLE: [u32; 256] = {
        let mut table = [0; 256];
        let mut i = 0;
        while i < 256 {
            let mut value = i as u32;
            let mut bit = 0;
            while bit < 8 {
                value = if value & 1 == 1 { value >> 1 ^ 0x82f6_3b78 } else { value >> 1 };
                bit += 1;
            }
            table[i] = value;
            i += 1;
        }
        table
    };
    !data.iter().fold(!0, |crc, byte| TABLE[((crc ^ u32::from(*byte)) & 0xff) as usize] ^ crc >> 8)
}

/// Seven bits a byte, the lowest first, the top bit where more follow.
fn varint(out: &mut Vec<u8>, mut value: u64) {
    while value >= 0x80 {
        out.push(value as u8 | 0x80);
        value >>= 7;
    }
    out.push(value as u8);
}

fn key(out: &mut Vec<u8>, field: u64, wire_type: u64) {
    varint(out, field << 3 | wire_type);
}

/// A whole number; zero is what an absent one means.
fn number(out: &mut Vec<u8>, field: u64, value: u64) {
    if value != 0 {
        key(out, field, 0);
        varint(out, value);
    }
}

fn double(out: &mut Vec<u8>, field: u64, value: f64) {
    key(out, field, 1);
    out.extend(value.to_le_bytes());
}

fn bytes(out: &mut Vec<u8>, field: u64, value: &[u8]) {
    key(out, field, 2);
    varint(out, value.len() as u64);
    out.extend(value);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn crc32c_meets_its_published_vectors() {
        // RFC 3720, B.4; the last is the check value of the CRC catalogue.
        assert_eq!(crc32c(&[0; 32]), 0x8a91_36aa);
        assert_eq!(crc32c(&[0xff; 32]), 0x62a8_ab43);
        assert_eq!(crc32c(&(0..32).collect::<Vec<u8>>()), 0x46dd_794e);
        assert_eq!(crc32c(b"123456789"), 0xe306_9283);
    }
}
