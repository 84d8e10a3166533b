//! The style space: few numbers that say what a garment looks like on any body.

use caphy_core::{Error, Result};
use serde::{Deserialize, Serialize};

/// What a garment covers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum GarmentKind {
    /// Shirts: trunk and arms.
    Upper,
    /// Trousers: pelvis and legs.
    Lower,
}

impl std::fmt::Display for GarmentKind {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Upper => "upper",
            Self::Lower => "lower",
        })
    }
}

/// Style of a shirt. Lengths are fractions of the body's own, so that a style means the same on every body.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct UpperStyle {
    /// 0 sleeveless, 1 down to the wrist.
    pub sleeve_length: f64,
    /// 0 down to the waist, 0.5 about the crotch, 1 down to mid-thigh.
    pub body_length: f64,
    /// Ease [m]: how far the cloth stands off the chest; 0 tight.
    pub looseness: f64,
    /// 0 a crew neck, 1 a deep scoop.
    pub neckline: f64,
}

/// Style of trousers.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LowerStyle {
    /// 0 shorts that end just below the crotch, 1 down to the ankle.
    pub leg_length: f64,
    /// Ease [m]: how far the cloth stands off the thigh; 0 tight.
    pub looseness: f64,
    /// 0 waistband on the hips, 1 at the natural waist.
    pub rise: f64,
}

/// A garment that was given rather than cut here.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GivenStyle {
    /// What it covers.
    pub garment: GarmentKind,
    /// Its name: the file's, without folder and ending.
    pub name: String,
    /// Coefficients of its space; none for a single mesh.
    pub coefficients: Vec<f64>,
}

/// Which garment a template is: a point of the parametric style space, or a given garment.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum Style {
    /// A shirt.
    Upper(UpperStyle),
    /// Trousers.
    Lower(LowerStyle),
    /// A given garment.
    Given(GivenStyle),
}

/// One axis of the style space.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StyleRange {
    /// The field's name.
    pub name: &'static str,
    /// Unit of both bounds.
    pub unit: &'static str,
    /// Smallest value.
    pub lower: f64,
    /// Largest value.
    pub upper: f64,
}

impl StyleRange {
    /// # Errors
    /// [`Error::Parameter`] for a value outside (NaN too).
    pub(crate) fn check(&self, value: f64) -> Result<()> {
        if value >= self.lower && value <= self.upper {
            return Ok(());
        }
        let (name, unit) = (self.name.into(), self.unit.into());
        Err(Error::Parameter { name, value, lower: self.lower, upper: self.upper, unit })
    }
}

const fn range(name: &'static str, unit: &'static str, lower: f64, upper: f64) -> StyleRange {
    StyleRange { name, unit, lower, upper }
}

/// Axes of [`UpperStyle`], in the order of its fields.
pub const UPPER_RANGES: [StyleRange; 4] = [
    range("sleeve_length", "1", 0.0, 1.0),
    range("body_length", "1", 0.0, 1.0),
    range("looseness", "m", 0.0, 0.05),
    range("neckline", "1", 0.0, 1.0),
];

/// Axes of [`LowerStyle`], in the order of its fields.
pub const LOWER_RANGES: [StyleRange; 3] =
    [range("leg_length", "1", 0.0, 1.0), range("looseness", "m", 0.0, 0.05), range("rise", "1", 0.0, 1.0)];

impl GarmentKind {
    /// Axes of its style space.
    pub fn ranges(self) -> &'static [StyleRange] {
        match self {
            Self::Upper => &UPPER_RANGES,
            Self::Lower => &LOWER_RANGES,
        }
    }
}

impl Style {
    /// What it is a style of.
    pub fn kind(&self) -> GarmentKind {
        match self {
            Self::Upper(_) => GarmentKind::Upper,
            Self::Lower(_) => GarmentKind::Lower,
            Self::Given(s) => s.garment,
        }
    }
    /// Values in the order of [`GarmentKind::ranges`]; of a given garment its coefficients.
    pub fn values(&self) -> Vec<f64> {
        match self {
            Self::Upper(s) => vec![s.sleeve_length, s.body_length, s.looseness, s.neckline],
            Self::Lower(s) => vec![s.leg_length, s.looseness, s.rise],
            Self::Given(s) => s.coefficients.clone(),
        }
    }
    /// The style with these values.
    ///
    /// # Errors
    /// [`Error::Length`] for a wrong count, [`Error::Parameter`] for a value outside its range (NaN too).
    pub fn from_values(kind: GarmentKind, values: &[f64]) -> Result<Self> {
        let ranges = kind.ranges();
        Error::check_length("values of a garment style", ranges.len(), values.len())?;
        let style = match (kind, values) {
            (GarmentKind::Upper, &[sleeve_length, body_length, looseness, neckline]) => {
                Self::Upper(UpperStyle { sleeve_length, body_length, looseness, neckline })
            }
            (_, &[leg_length, looseness, rise, ..]) => Self::Lower(LowerStyle { leg_length, looseness, rise }),
            _ => {
                return Err(Error::Length { what: "values of a garment style".into(), expected: 3, got: values.len() });
            }
        };
        style.check()?;
        Ok(style)
    }
    /// Checks that every value lies in its range; of a given garment, that its coefficients are finite.
    ///
    /// # Errors
    /// [`Error::Parameter`] with the value and its range, [`Error::NonFinite`] for a coefficient.
    pub fn check(&self) -> Result<()> {
        if let Self::Given(s) = self {
            return Error::check_finite(&format!("style coefficients of {}", s.name), &s.coefficients);
        }
        self.values().into_iter().zip(self.kind().ranges()).try_for_each(|(value, r)| r.check(value))
    }
    /// From coordinates in [0, 1] per axis; values outside are brought to the nearest bound.
    pub fn from_unit(kind: GarmentKind, unit: &[f64]) -> Result<Self> {
        let ranges = kind.ranges();
        Error::check_length("coordinates of a garment style", ranges.len(), unit.len())?;
        let values: Vec<f64> =
            unit.iter().zip(ranges).map(|(u, r)| r.lower + u.clamp(0.0, 1.0) * (r.upper - r.lower)).collect();
        Self::from_values(kind, &values)
    }
    /// Coordinates in [0, 1] per axis of the parametric style space.
    pub fn to_unit(&self) -> Vec<f64> {
        self.values().iter().zip(self.kind().ranges()).map(|(v, r)| (v - r.lower) / (r.upper - r.lower)).collect()
    }
}

/// `count` styles that fill the style space evenly (a Halton sequence, shifted by the seed); the same for the same seed, and the
/// first n of a longer row are the row of n.
pub fn sample_styles(kind: GarmentKind, count: usize, seed: u64) -> Vec<Style> {
    unit_samples(kind.ranges().len(), count, seed).filter_map(|unit| Style::from_unit(kind, &unit).ok()).collect()
}

/// Most axes that [`unit_samples`] fills evenly.
pub(crate) const MOST_AXES: usize = 8;

/// `count` points of the unit cube: a Halton sequence, shifted by the seed. At most [`MOST_AXES`] axes.
pub(crate) fn unit_samples(dimensions: usize, count: usize, seed: u64) -> impl Iterator<Item = Vec<f64>> {
    const BASES: [u64; MOST_AXES] = [2, 3, 5, 7, 11, 13, 17, 19];
    let shift: Vec<f64> = (0..dimensions as u64)
        .map(|d| {
            // SplitMix64: one well-mixed number per seed and axis.
            let mut x = seed.wrapping_add((d + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15));
            x = (x ^ (x >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
            x = (x ^ (x >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
            ((x ^ (x >> 31)) >> 11) as f64 / (1u64 << 53) as f64
        })
        .collect();
    (1..=count as u64).map(move |i| {
        (0..dimensions).map(|d| (radical_inverse(i, BASES[d % BASES.len()]) + shift[d]).fract()).collect()
    })
}

fn radical_inverse(mut i: u64, base: u64) -> f64 {
    let (mut value, mut digit) = (0.0, 1.0 / base as f64);
    while i > 0 {
        value += (i % base) as f64 * digit;
        i /= base;
        digit /= base as f64;
    }
    value
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn samples_fill_every_axis_and_repeat() {
        for kind in [GarmentKind::Upper, GarmentKind::Lower] {
            let styles = sample_styles(kind, 60, 7);
            assert_eq!(styles, sample_styles(kind, 60, 7));
            assert_ne!(styles, sample_styles(kind, 60, 8));
            assert_eq!(styles[..10], sample_styles(kind, 10, 7));
            for axis in 0..kind.ranges().len() {
                let mut u: Vec<f64> = styles.iter().map(|s| s.to_unit()[axis]).collect();
                u.sort_by(f64::total_cmp);
                // A shifted Halton row of 60 in base 7 leaves no gap above 2/49.
                assert!(u[0] < 0.05 && u[59] > 0.95 && u.windows(2).all(|w| w[1] - w[0] < 0.05), "{kind:?} {axis}");
            }
        }
    }

    #[test]
    fn values_outside_their_range_are_named() {
        let text = Style::from_values(GarmentKind::Upper, &[0.5, 1.5, 0.01, 0.0]).unwrap_err().to_string();
        assert!(text.contains("body_length") && text.contains("1.5") && text.contains("[0, 1]"), "{text}");
        assert!(Style::from_values(GarmentKind::Lower, &[0.5, f64::NAN, 0.0]).is_err());
        assert!(Style::from_values(GarmentKind::Lower, &[0.5]).is_err());
        let style = Style::from_values(GarmentKind::Lower, &[0.5, 0.02, 0.25]).unwrap();
        let back = Style::from_unit(GarmentKind::Lower, &style.to_unit()).unwrap();
        assert!(style.values().iter().zip(back.values()).all(|(a, b)| (a - b).abs() < 1e-12));
    }
}
