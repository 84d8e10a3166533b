//! Vertex colours that files give as floats.

/// Above this a channel cannot be an overshoot of [0, 1] (interpolation, rounding): the file counts to 255.
const LARGEST_OVERSHOOT: f32 = 2.0;

/// Channels in [0, 1], or in [0, 255] throughout the file, as bytes.
pub(crate) fn to_bytes(colours: &[[f32; 3]]) -> Vec<[u8; 3]> {
    let largest = colours.iter().flatten().fold(0.0, |a: f32, &c| a.max(c));
    let scale = if largest > LARGEST_OVERSHOOT { 1.0 } else { 255.0 };
    // Casts to u8 round towards zero and saturate.
    colours.iter().map(|rgb| rgb.map(|c| (c * scale + 0.5) as u8)).collect()
}
