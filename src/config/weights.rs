//! Weights of energy terms, fixed or changing over training.

use caphy_core::{Error, Result};
use serde::de::value::{MapAccessDeserializer, SeqAccessDeserializer};
use serde::de::{Deserializer, MapAccess, SeqAccess, Visitor};
use serde::{Deserialize, Serialize};

/// A number over the share of training that is done: `1.0`, `{ from = 0.1, to = 1.0, until = 0.3 }`, or points
/// `[[share, value], …]` with straight lines between them.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(untagged)]
pub enum Schedule {
    /// The same all the time.
    Constant(f64),
    /// A straight line, then constant.
    Ramp(Ramp),
    /// Share in [0, 1] and value, shares rising; constant before the first and after the last.
    Points(Vec<[f64; 2]>),
}

/// From one value to another.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Ramp {
    /// Value at the start.
    pub from: f64,
    /// Value from `until` on.
    pub to: f64,
    /// Share of training, in (0, 1].
    pub until: f64,
}

impl Schedule {
    /// The value at a share of training.
    pub fn at(&self, share: f64) -> f64 {
        match self {
            Self::Constant(value) => *value,
            Self::Ramp(ramp) if share >= ramp.until => ramp.to,
            Self::Ramp(ramp) => ramp.from + (ramp.to - ramp.from) * (share / ramp.until).max(0.0),
            Self::Points(points) => {
                let next = points.partition_point(|p| p[0] <= share);
                match (next.checked_sub(1).map(|i| points[i]), points.get(next).copied()) {
                    (Some([a, x]), Some([b, y])) => x + (y - x) * (share - a) / (b - a),
                    (Some([_, value]), None) | (None, Some([_, value])) => value,
                    (None, None) => 0.0,
                }
            }
        }
    }
    /// Whether it is one number.
    pub fn is_constant(&self) -> bool {
        matches!(self, Self::Constant(_))
    }
    /// Whether it is 0 all the time.
    pub fn is_zero(&self) -> bool {
        match self {
            Self::Constant(value) => *value == 0.0,
            Self::Ramp(ramp) => ramp.from == 0.0 && ramp.to == 0.0,
            Self::Points(points) => points.iter().all(|p| p[1] == 0.0),
        }
    }
    /// Refuses values below 0 and shares that make no schedule.
    ///
    /// # Errors
    /// [`Error::Config`] naming `key`.
    pub fn check(&self, key: &str) -> Result<()> {
        let value = |value: f64| {
            if value.is_finite() && value >= 0.0 {
                return Ok(());
            }
            Err(Error::config(key, format!("{value}"), "give 0 or a positive number"))
        };
        match self {
            Self::Constant(only) => value(*only),
            Self::Ramp(Ramp { from, to, until }) => {
                value(*from)?;
                value(*to)?;
                if *until > 0.0 && *until <= 1.0 {
                    return Ok(());
                }
                Err(Error::config(
                    format!("{key}.until"),
                    format!("{until}"),
                    "give a share of training, above 0 and at most 1",
                ))
            }
            Self::Points(points) => {
                points.iter().try_for_each(|p| value(p[1]))?;
                let shares: Vec<f64> = points.iter().map(|p| p[0]).collect();
                let inside = shares.iter().all(|s| (0.0..=1.0).contains(s));
                if inside && !shares.is_empty() && shares.is_sorted_by(|a, b| a < b) {
                    return Ok(());
                }
                let remedy = "give at least one point [share, value], shares of training from 0 to 1, each larger than the one before";
                Err(Error::config(key, format!("its shares are {shares:?}"), remedy))
            }
        }
    }
}

impl From<f64> for Schedule {
    fn from(value: f64) -> Self {
        Self::Constant(value)
    }
}

impl<'de> Deserialize<'de> for Schedule {
    // By hand: serde's answer to a mistake in one of several shapes is that none of them fits.
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> std::result::Result<Self, D::Error> {
        struct Shapes;
        impl<'de> Visitor<'de> for Shapes {
            type Value = Schedule;
            fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                f.write_str("a number, a ramp { from, to, until }, or points [[share, value], …]")
            }
            fn visit_f64<E>(self, value: f64) -> std::result::Result<Schedule, E> {
                Ok(Schedule::Constant(value))
            }
            fn visit_i64<E>(self, value: i64) -> std::result::Result<Schedule, E> {
                Ok(Schedule::Constant(value as f64))
            }
            fn visit_u64<E>(self, value: u64) -> std::result::Result<Schedule, E> {
                Ok(Schedule::Constant(value as f64))
            }
            fn visit_map<A: MapAccess<'de>>(self, map: A) -> std::result::Result<Schedule, A::Error> {
                Ramp::deserialize(MapAccessDeserializer::new(map)).map(Schedule::Ramp)
            }
            fn visit_seq<A: SeqAccess<'de>>(self, seq: A) -> std::result::Result<Schedule, A::Error> {
                Vec::deserialize(SeqAccessDeserializer::new(seq)).map(Schedule::Points)
            }
        }
        deserializer.deserialize_any(Shapes)
    }
}

/// Weights of the terms of Eqs. 6, 8 and 11. Energies are in joules, so 1 is physical. Each is a [`Schedule`]: it runs over
/// the first training of the nets; training with an estimated fabric and fine-tuning stay at its last value, which is also
/// what fabrics are estimated with. `layering`, which only fine-tuning knows, runs over fine-tuning.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TermWeights {
    /// Membrane strain. Default 1.
    pub strain: Schedule,
    /// Bending. Default 1.
    pub bending: Schedule,
    /// Gravity. Default 1.
    pub gravity: Schedule,
    /// Inertia. Default 1.
    pub inertia: Schedule,
    /// Body collision. Default 1: its own stiffness follows from `[train.contact]`.
    pub collision: Schedule,
    /// Waistband and neckline. Default 1: its own stiffness follows from the garment's weight.
    pub attachment: Schedule,
    /// λ3d of Eq. 8 [J/m²]: energy per squared metre of mean Chamfer distance. Default 300, so that 1 cm costs 30 mJ, about
    /// what a shirt's strain costs.
    pub scan: Schedule,
    /// Upper against lower garment, relative to the body's collision. Default 1.
    pub layering: Schedule,
}

impl TermWeights {
    /// All of them by their keys.
    pub fn named(&self) -> [(&'static str, &Schedule); 8] {
        let Self { strain, bending, gravity, inertia, collision, attachment, scan, layering } = self;
        [
            ("strain", strain),
            ("bending", bending),
            ("gravity", gravity),
            ("inertia", inertia),
            ("collision", collision),
            ("attachment", attachment),
            ("scan", scan),
            ("layering", layering),
        ]
    }
}

impl Default for TermWeights {
    fn default() -> Self {
        let one = Schedule::Constant(1.0);
        Self {
            strain: one.clone(),
            bending: one.clone(),
            gravity: one.clone(),
            inertia: one.clone(),
            collision: one.clone(),
            attachment: one.clone(),
            scan: Schedule::Constant(300.0),
            layering: one,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Schedule {
        let table: std::collections::BTreeMap<String, Schedule> = toml::from_str(&format!("w = {text}")).unwrap();
        table["w"].clone()
    }

    #[test]
    fn schedules_have_the_values_of_their_lines() {
        let ramp = read("{ from = 0.2, to = 1, until = 0.4 }");
        for (share, value) in [(0.0, 0.2), (0.1, 0.4), (0.3, 0.8), (0.4, 1.0), (1.0, 1.0)] {
            assert!((ramp.at(share) - value).abs() < 1e-15, "{share}: {}", ramp.at(share));
        }
        // The last value is the one that was written, to the bit.
        assert_eq!(read("{ from = 0.1, to = 0.3, until = 0.7 }").at(0.7), 0.3);
        let points = read("[[0.25, 0], [0.5, 2.0], [0.75, 1.0]]");
        for (share, value) in [(0.0, 0.0), (0.25, 0.0), (0.375, 1.0), (0.5, 2.0), (0.625, 1.5), (0.75, 1.0), (1.0, 1.0)]
        {
            assert_eq!(points.at(share), value, "{share}");
        }
        assert_eq!((read("3").at(0.7), read("0.1").at(0.7)), (3.0, 0.1));
        assert!(read("[[0.0, 0.0]]").is_zero() && read("0").is_zero() && !points.is_zero());
        assert!(read("0").is_constant() && !ramp.is_constant());
    }

    #[test]
    fn schedules_are_written_as_they_were_read() {
        for text in ["2.5", "{ from = 0.1, to = 1.0, until = 0.3 }", "[[0.0, 0.1], [0.5, 1.0]]"] {
            let weights: TermWeights = toml::from_str(&format!("strain = {text}")).unwrap();
            let written = toml::to_string(&weights).unwrap();
            assert_eq!(toml::from_str::<TermWeights>(&written).unwrap(), weights, "{written}");
        }
        assert!(toml::to_string(&TermWeights::default()).unwrap().contains("scan = 300.0\n"));
    }
}
