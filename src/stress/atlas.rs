//! What is found at every point of the grids.

use super::ask;
use caphy_core::conformance::differences::agrees_within;
use caphy_core::extension::{Hinge, MaterialModelExt};
use caphy_core::material::{MaterialModel, MaterialReal};
use caphy_core::{Real, Result};
use nalgebra::Matrix3;
use serde::Serialize;

/// Directions of the first principal stretch, and of fold lines, from the u axis [degrees].
const DIRECTIONS: [f64; 5] = [0.0, 22.5, 45.0, 67.5, 90.0];
/// Logarithmic steps per decade of stretch, from a hundredth to tenfold.
const PER_DECADE: usize = 16;
/// Steps of fold angle from −π to π.
const ANGLES: usize = 48;
/// Edge lengths of folds [m], six per decade from 0.1 mm to 0.1 m.
const LENGTHS: (f64, usize) = (1e-4, 18);
/// How many roundings of f32 a stress may be off by, relative to the largest tangent entry times the largest strain: lookups, sums
/// and logarithms of shipped fabrics take a few dozen.
pub const ROUNDINGS: f64 = 64.0;

/// What a material is like in one state; the worst of all directions counts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum State {
    /// Energy finite, gradient right, tangent positive.
    Sound,
    /// The tangent ∂S/∂G (for folds: the moment's slope) has a negative direction: the cloth gives way.
    GivesWay,
    /// The stress is not the energy's gradient (for frozen stiffness: not K G), or in f32 not that of f64.
    GradientWrong,
    /// Something is not finite, or k is negative.
    NotFinite,
}

impl State {
    /// One letter for the maps in JSON.
    pub fn letter(self) -> char {
        match self {
            Self::Sound => '.',
            Self::GivesWay => 't',
            Self::GradientWrong => 'g',
            Self::NotFinite => 'x',
        }
    }
}

/// A map over the two principal stretches.
#[derive(Debug, Clone, Serialize)]
pub struct Membrane {
    /// Values of either stretch, 0 first.
    pub stretches: Vec<f64>,
    /// Rows of the second stretch, one letter per first stretch (see [`State::letter`]).
    pub map: Vec<String>,
    /// Share of states.
    pub summary: Summary,
    /// Range of the first stretch around 1, sides held, in which every direction is sound.
    pub sound_from: f64,
    /// Its upper end.
    pub sound_to: f64,
    /// Largest error of S over the largest |S| (f32 against f64), where finite.
    pub largest_error: f64,
}

/// A map over fold angle and edge length of an equilateral pair of triangles, flat at rest.
#[derive(Debug, Clone, Serialize)]
pub struct Fold {
    /// Angles [rad].
    pub angles: Vec<f64>,
    /// Edge lengths [m]; curvature is θ l/(2 A) = 2 θ/(√3 l).
    pub lengths: Vec<f64>,
    /// Rows of lengths, one letter per angle.
    pub map: Vec<String>,
    /// Share of states.
    pub summary: Summary,
    /// Largest curvature below which every state is sound [1/m].
    pub sound_to: f64,
}

/// Shares of a map's states that are finite; finite with the right gradient; and also of positive tangent.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Summary {
    /// Of all.
    pub finite: f64,
    /// Of all.
    pub gradient: f64,
    /// Of all.
    pub positive: f64,
}

impl Summary {
    fn of(states: &[State]) -> Self {
        let share = |worst: State| states.iter().filter(|s| **s <= worst).count() as f64 / states.len().max(1) as f64;
        Self { finite: share(State::GradientWrong), gradient: share(State::GivesWay), positive: share(State::Sound) }
    }
}

/// One precision of an [`Atlas`].
#[derive(Debug, Clone, Serialize)]
pub struct Precision {
    /// Strains.
    pub membrane: Membrane,
    /// Folds.
    pub fold: Fold,
}

/// What was found of one fabric.
#[derive(Debug, Clone, Serialize)]
pub struct Atlas {
    /// Its name.
    pub material: String,
    /// Whether its stress holds the stiffness: then it is K G, not the energy's gradient.
    pub stiffness_frozen: bool,
    /// Largest |S − ∂ψ/∂G| over the largest entry of S among sound states up to a stretch of 1.5: what freezing leaves out.
    pub frozen_gap: f64,
    /// Strains beyond this are drawn back, in f32 and f64; absent where the material does not say.
    pub strain_limits: Option<[f64; 2]>,
    /// Single precision.
    pub single: Precision,
    /// Double precision.
    pub double: Precision,
}

impl Atlas {
    /// Whether every state is finite with the right gradient, in both precisions.
    pub fn sound(&self) -> bool {
        let all = [&self.single, &self.double];
        all.iter().all(|p| p.membrane.summary.gradient == 1.0 && p.fold.summary.gradient == 1.0)
    }
    /// Asks a material everywhere.
    ///
    /// # Errors
    /// What the material refuses a finite block for.
    pub fn new(name: &str, material: &dyn MaterialModel) -> Result<Self> {
        let facts = material.describe();
        Ok(Self {
            material: name.to_string(),
            stiffness_frozen: facts.stiffness_frozen,
            frozen_gap: if facts.stiffness_frozen { frozen_gap(material)? } else { 0.0 },
            strain_limits: material.strain_limits(),
            single: Precision { membrane: membrane::<f32>(material)?, fold: fold::<f32>(material)? },
            double: Precision { membrane: membrane::<f64>(material)?, fold: fold::<f64>(material)? },
        })
    }
}

/// Stretches from 0 over a hundredth to tenfold; 1 is among them.
fn stretches() -> Vec<f64> {
    let log = (0..=3 * PER_DECADE).map(|i| 10f64.powf(i as f64 / PER_DECADE as f64 - 2.0));
    std::iter::once(0.0).chain(log).collect()
}

/// Sine and cosine, exact along the axes: shear of rounding alone lies beside the kink at Guv = 0.
fn direction(degrees: f64) -> (f64, f64) {
    let exact = |x: f64| if x.abs() < 1e-12 { 0.0 } else { x };
    let (s, c) = degrees.to_radians().sin_cos();
    (exact(s), exact(c))
}

/// Green strain of principal stretches, the first along a direction.
fn green([s1, s2]: [f64; 2], degrees: f64) -> [f64; 3] {
    let (s, c) = direction(degrees);
    let (g1, g2) = (0.5 * (s1 * s1 - 1.0), 0.5 * (s2 * s2 - 1.0));
    [g1 * c * c + g2 * s * s, g1 * s * s + g2 * c * c, (g1 - g2) * s * c]
}

fn largest(values: &[f64]) -> f64 {
    values.iter().fold(0.0f64, |m, v| m.max(v.abs()))
}

/// Smallest eigenvalue of the second derivative of ψ over the space of strains with the product G:G, from ∂S/∂G; what is not
/// symmetric (frozen stiffness) counts by its symmetric part.
fn weakest(tangent: &[f64; 9]) -> f64 {
    // Guv stands for two entries: in the basis (uu, vv, √2 uv) the product is the usual one.
    let root = std::f64::consts::SQRT_2;
    let m = Matrix3::from_row_slice(tangent);
    let scale = |i: usize| if i == 2 { root } else { 1.0 };
    let even = Matrix3::from_fn(|r, c| m[(r, c)] * scale(r) / scale(c));
    (0.5 * (even + even.transpose())).symmetric_eigenvalues().min()
}

fn membrane<T: MaterialReal>(material: &dyn MaterialModel) -> Result<Membrane> {
    let stretches = stretches();
    let n = stretches.len();
    let pairs: Vec<[f64; 2]> = (0..n * n).map(|i| [stretches[i % n], stretches[i / n]]).collect();
    let mut worst = vec![State::Sound; n * n];
    let (mut error, mut peak) = (0.0f64, 0.0f64);
    for degrees in DIRECTIONS {
        // Strains that T holds exactly, so that only the evaluation differs.
        let strains: Vec<[f64; 3]> = pairs.iter().map(|p| green(*p, degrees).map(|g| T::of(g).to_f64())).collect();
        let here = ask::membrane::<T>(material, &strains, true)?;
        let truth = ask::membrane::<f64>(material, &strains, true)?;
        for (i, strain) in strains.iter().enumerate() {
            let state = strain_state::<T>(material, strain, i, &here, &truth);
            if state < State::NotFinite {
                let off: [f64; 3] = std::array::from_fn(|c| here.stress[i][c] - truth.stress[i][c]);
                error = error.max(largest(&off));
                peak = peak.max(largest(&truth.stress[i]));
            }
            worst[i] = worst[i].max(state);
        }
    }
    let rest = stretches.iter().position(|s| (s - 1.0).abs() < 1e-9).unwrap_or(0);
    let along = &worst[rest * n..(rest + 1) * n];
    let sound = |i: &usize| along[*i] == State::Sound;
    let low = (0..=rest).rev().take_while(sound).last().unwrap_or(rest);
    let high = (rest..n).take_while(sound).last().unwrap_or(rest);
    Ok(Membrane {
        map: worst.chunks(n).map(|row| row.iter().map(|s| s.letter()).collect()).collect(),
        summary: Summary::of(&worst),
        sound_from: stretches[low],
        sound_to: stretches[high],
        largest_error: if peak > 0.0 { error / peak } else { 0.0 },
        stretches,
    })
}

fn strain_state<T: Real>(
    material: &dyn MaterialModel,
    strain: &[f64; 3],
    i: usize,
    here: &ask::Answers,
    truth: &ask::Answers,
) -> State {
    let tangents = here.tangents.iter().filter(|t| !t.is_empty()).flat_map(|t| t[i]);
    let mut values = [here.energy[i]].into_iter().chain(here.stress[i]).chain(tangents);
    if values.any(|v| !v.is_finite()) {
        return State::NotFinite;
    }
    let tangent = here.tangents.iter().rev().find(|t| !t.is_empty()).map(|t| t[i]);
    let right = if size_of::<T>() == 4 {
        let entries = truth.tangents.iter().filter(|t| !t.is_empty()).map(|t| largest(&t[i])).fold(0.0, f64::max);
        let size = (entries * largest(strain)).max(largest(&truth.stress[i]));
        (0..3).all(|c| (here.stress[i][c] - truth.stress[i][c]).abs() <= ROUNDINGS * f64::from(f32::EPSILON) * size)
    } else {
        gradient_right(material, strain, &here.stress[i], tangent.map_or(0.0, |t| largest(&t)))
    };
    if !right {
        return State::GradientWrong;
    }
    match tangent {
        // Rounding of the eigenvalues is of the largest entry.
        Some(t) if weakest(&t) < -16.0 * T::epsilon().to_f64() * largest(&t) => State::GivesWay,
        _ => State::Sound,
    }
}

/// The stress against differences of the energy; with frozen stiffness against K G.
fn gradient_right(material: &dyn MaterialModel, strain: &[f64; 3], stress: &[f64; 3], stiffness: f64) -> bool {
    // At rest, the stress of a millionth of strain says what is small.
    let scale = largest(stress).max(1e-6 * stiffness);
    let step = largest(strain).max(1.0);
    if material.describe().stiffness_frozen {
        let Ok(tangent) = material.tangent_held_at(*strain) else { return true };
        let size = largest(tangent.as_flattened()) * step;
        return (0..3).all(|r| {
            let held: f64 = (0..3).map(|c| tangent[r][c] * strain[c]).sum();
            (held - stress[r]).abs() <= 1e-11 * size
        });
    }
    let energy = |green: [f64; 3]| material.at(green).map_or(f64::NAN, |a| a.energy);
    let noise = 8.0 * f64::EPSILON * energy(*strain).abs().max(scale * step);
    (0..3).all(|c| {
        let slope = stress[c] * if c == 2 { 2.0 } else { 1.0 };
        let at = |h: f64| {
            let mut moved = *strain;
            moved[c] += h;
            energy(moved)
        };
        // Smaller steps for cloth that is stretched far one way and crushed the other.
        agrees_within(slope, scale, step, noise, at) || agrees_within(slope, scale, 1e-3 * step, noise, at)
    })
}

fn frozen_gap(material: &dyn MaterialModel) -> Result<f64> {
    let (mut gap, mut peak) = (0.0f64, 0.0f64);
    for degrees in DIRECTIONS {
        for i in 0..=40 {
            let strain = green([0.7 + 0.02 * f64::from(i), 1.0], degrees);
            let stress = material.at(strain)?.stress;
            peak = peak.max(largest(&stress));
            let h = 1e-6;
            for c in 0..3 {
                let at = |by: f64| {
                    let mut moved = strain;
                    moved[c] += by;
                    material.at(moved).map(|a| a.energy)
                };
                let slope = (at(h)? - at(-h)?) / (2.0 * h) / if c == 2 { 2.0 } else { 1.0 };
                gap = gap.max((slope - stress[c]).abs());
            }
        }
    }
    Ok(if peak > 0.0 { gap / peak } else { 0.0 })
}

fn fold<T: MaterialReal>(material: &dyn MaterialModel) -> Result<Fold> {
    let pi = std::f64::consts::PI;
    let angles: Vec<f64> = (0..=ANGLES).map(|i| pi * (2.0 * i as f64 / ANGLES as f64 - 1.0)).collect();
    let lengths: Vec<f64> = (0..=LENGTHS.1).map(|i| LENGTHS.0 * 10f64.powf(i as f64 / 6.0)).collect();
    let frozen = material.describe().stiffness_frozen;
    let mut worst = vec![State::Sound; angles.len() * lengths.len()];
    for degrees in DIRECTIONS {
        let (s, c) = direction(degrees);
        let hinge = |i: usize, by: f64| {
            let (angle, length) = (angles[i % angles.len()] + by, lengths[i / angles.len()]);
            let area = 2.0 * 3f64.sqrt() / 4.0 * length * length;
            Hinge { angle, angle_rest: 0.0, length, area, directions: [[c, s]; 2] }
        };
        let at = |by: f64| -> Vec<Hinge> { (0..worst.len()).map(|i| hinge(i, by)).collect() };
        let k = ask::hinges::<T>(material, &at(0.0))?;
        // The moment's slope by differences of k in f64: h where k has a kink is a step of 1e-4 rad.
        let h = 1e-4;
        let (plus, minus) = (ask::hinges::<f64>(material, &at(h))?, ask::hinges::<f64>(material, &at(-h))?);
        let truth = ask::hinges::<f64>(material, &at(0.0))?;
        for i in 0..worst.len() {
            let angle = angles[i % angles.len()];
            let state = if !(k[i].is_finite() && k[i] >= 0.0) {
                State::NotFinite
            } else if (k[i] - truth[i]).abs()
                > ROUNDINGS * f64::from(T::epsilon().to_f64() as f32) * truth[i].abs().max(1e-12)
            {
                State::GradientWrong
            } else {
                // E/factor = k θ²; with frozen stiffness the moment is 2 k θ.
                let slope = if frozen {
                    (2.0 * plus[i] * (angle + h) - 2.0 * minus[i] * (angle - h)) / (2.0 * h)
                } else {
                    let e = |k: f64, a: f64| k * a * a;
                    (e(plus[i], angle + h) - 2.0 * e(truth[i], angle) + e(minus[i], angle - h)) / (h * h)
                };
                let rounding = 1e-14 * truth[i] * angle * angle / (h * h);
                if slope < -rounding - 1e-9 * truth[i] { State::GivesWay } else { State::Sound }
            };
            worst[i] = worst[i].max(state);
        }
    }
    let curvature = |i: usize| 2.0 * angles[i % angles.len()].abs() / (3f64.sqrt() * lengths[i / angles.len()]);
    let unsound = (0..worst.len()).filter(|&i| worst[i] > State::Sound).map(curvature);
    let steepest = (0..worst.len()).map(curvature).fold(0.0, f64::max);
    Ok(Fold {
        map: worst.chunks(angles.len()).map(|row| row.iter().map(|s| s.letter()).collect()).collect(),
        summary: Summary::of(&worst),
        sound_to: unsound.fold(steepest, f64::min),
        angles,
        lengths,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use caphy_materials::{MaterialMeasuredSpec, MaterialStvk};

    #[test]
    fn stvk_is_sound_everywhere_and_a_measured_fabric_gives_way_where_it_is_known_to() {
        let atlas = Atlas::new("stvk", &MaterialStvk::snug().unwrap()).unwrap();
        for precision in [&atlas.single, &atlas.double] {
            assert_eq!(precision.membrane.summary.positive, 1.0);
            assert_eq!(precision.fold.summary.positive, 1.0);
            assert_eq!((precision.membrane.sound_from, precision.membrane.sound_to), (0.0, 10.0));
        }
        assert!(atlas.single.membrane.largest_error < 1e-6 && atlas.double.membrane.largest_error == 0.0);
        let navy = MaterialMeasuredSpec::new("navy-sparkle-sweat").build_measured().unwrap();
        let atlas = Atlas::new("navy", &navy).unwrap();
        let double = &atlas.double.membrane;
        assert!(double.summary.gradient == 1.0 && double.summary.positive < 1.0, "{:?}", double.summary);
        assert!(atlas.stiffness_frozen && atlas.frozen_gap > 0.01);
    }

    #[test]
    fn tangents_are_judged_in_the_product_of_tensors() {
        // ψ = ½ (u² + v²) + w²: the identity of that product.
        assert!((weakest(&[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]) - 1.0).abs() < 1e-15);
        assert!(weakest(&[1.0, 2.0, 0.0, 2.0, 1.0, 0.0, 0.0, 0.0, 1.0]) < -0.99);
    }
}
