//! Colours: sRGB and linear light, and maps from scalar fields to colours.

/// Linear light in [0, 1] of an sRGB byte (IEC 61966-2-1).
pub fn srgb_to_linear(byte: u8) -> f32 {
    let c = f32::from(byte) / 255.0;
    if c <= 0.04045 { c / 12.92 } else { ((c + 0.055) / 1.055).powf(2.4) }
}

/// The nearest sRGB byte of linear light, clamped to [0, 1].
pub fn linear_to_srgb(light: f32) -> u8 {
    let l = light.clamp(0.0, 1.0);
    let c = if l <= 0.003_130_8 { 12.92 * l } else { 1.055 * l.powf(1.0 / 2.4) - 0.055 };
    (c * 255.0 + 0.5) as u8
}

/// A map from [0, 1] to sRGB.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ColourMap {
    /// Dark violet to yellow, equal steps look equal: for amounts.
    Viridis,
    /// Blue through white to red: for signed fields, with zero at the middle of the range.
    BlueWhiteRed,
}

/// Colour of a value that is not finite.
pub const NOT_FINITE: [u8; 3] = [255, 0, 255];

/// Nine equally spaced samples of matplotlib's viridis map (CC0).
const VIRIDIS: [[u8; 3]; 9] = [
    [68, 1, 84],
    [71, 44, 122],
    [59, 81, 139],
    [44, 113, 142],
    [33, 144, 141],
    [39, 173, 129],
    [92, 200, 99],
    [170, 220, 50],
    [253, 231, 37],
];

const BLUE_WHITE_RED: [[u8; 3]; 5] = [[33, 64, 154], [120, 160, 220], [245, 245, 245], [232, 130, 110], [170, 20, 40]];

impl ColourMap {
    /// Colour at `t`, clamped to [0, 1]; [`NOT_FINITE`] for NaN.
    pub fn at(self, t: f64) -> [u8; 3] {
        if t.is_nan() {
            return NOT_FINITE;
        }
        let stops: &[[u8; 3]] = match self {
            Self::Viridis => &VIRIDIS,
            Self::BlueWhiteRed => &BLUE_WHITE_RED,
        };
        let s = t.clamp(0.0, 1.0) * (stops.len() - 1) as f64;
        let i = (s as usize).min(stops.len() - 2);
        let f = s - i as f64;
        std::array::from_fn(|k| (f64::from(stops[i][k]) * (1.0 - f) + f64::from(stops[i + 1][k]) * f).round() as u8)
    }
}

/// A colour per value: `range.0` is the map's start and `range.1` its end, values beyond take the ends' colours. An
/// empty range gives everything the middle.
pub fn field_colours(values: &[f64], range: (f64, f64), map: ColourMap) -> Vec<[u8; 3]> {
    let width = range.1 - range.0;
    let place = |v: &f64| {
        if width != 0.0 {
            (v - range.0) / width
        } else if v.is_finite() {
            0.5
        } else {
            f64::NAN
        }
    };
    values.iter().map(|v| map.at(place(v))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn srgb_goes_there_and_back() {
        assert!((0..=255).all(|b| linear_to_srgb(srgb_to_linear(b)) == b));
        assert_eq!((linear_to_srgb(-1.0), linear_to_srgb(9.0), linear_to_srgb(f32::NAN)), (0, 255, 0));
    }

    #[test]
    fn maps_reach_their_ends_and_mark_nan() {
        let c = field_colours(&[-1.0, 0.0, 1.0, 7.0, f64::NAN], (-1.0, 1.0), ColourMap::BlueWhiteRed);
        assert_eq!(c, [[33, 64, 154], [245, 245, 245], [170, 20, 40], [170, 20, 40], NOT_FINITE]);
        assert_eq!(ColourMap::Viridis.at(0.0), [68, 1, 84]);
        assert_eq!(field_colours(&[3.0, f64::NAN], (2.0, 2.0), ColourMap::Viridis), [[33, 144, 141], NOT_FINITE]);
    }
}
