//! Random states in large numbers: what a grid misses.

use super::ask;
use crate::random::uniform;
use caphy_core::Result;
use caphy_core::extension::Hinge;
use caphy_core::material::{MaterialModel, MaterialReal};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use serde::Serialize;

/// States that travel through the material in one call.
const BLOCK: usize = 4096;
/// Share of strains that no deformation has, up to the largest of single precision.
const WILD: f64 = 0.1;
/// Steps of differences along a random direction of strain, as shares of the largest strain or 1; the small ones for cloth that is
/// stretched far one way and crushed the other. Where none of them is right, the gradient is wrong: kinks are rarer than that.
const STEPS: [f64; 6] = [1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9];

/// What was found among random strains and folds.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct RandomStates {
    /// Strains, and as many folds.
    pub states: usize,
    /// Strains with an energy, stress or tangent that is not finite in either precision; folds with a k that is not finite or
    /// negative.
    pub not_finite: usize,
    /// Strains with the energy's slope compared with the stress: those of deformations; none with frozen stiffness.
    pub slopes: usize,
    /// Of these, slopes that are not the stress.
    pub gradient_wrong: usize,
    /// The first state that is not as it should be.
    pub first: Option<String>,
}

impl RandomStates {
    /// Whether every state was as it should be.
    pub fn sound(&self) -> bool {
        self.first.is_none()
    }
    fn note(&mut self, problem: impl FnOnce() -> String) {
        if self.first.is_none() {
            self.first = Some(problem());
        }
    }
}

/// Asks a material about so many random strains and folds; the same seed, the same states.
///
/// # Errors
/// What the material refuses a finite block for.
pub fn random_states(material: &dyn MaterialModel, states: usize, seed: u64) -> Result<RandomStates> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut found = RandomStates { states, ..Default::default() };
    let mut left = states;
    while left > 0 {
        let n = left.min(BLOCK);
        left -= n;
        let strains: Vec<([f64; 3], bool)> = (0..n).map(|_| strain(&mut rng)).collect();
        strains_of::<f32>(material, &strains, &mut found)?;
        strains_of::<f64>(material, &strains, &mut found)?;
        if !material.describe().stiffness_frozen {
            let directions: Vec<[f64; 3]> =
                (0..n).map(|_| std::array::from_fn(|_| uniform(&mut rng, -1.0, 1.0))).collect();
            slopes(material, &strains, &directions, &mut found)?;
        }
        let hinges: Vec<Hinge> = (0..n).map(|_| hinge(&mut rng)).collect();
        folds::<f32>(material, &hinges, &mut found)?;
        folds::<f64>(material, &hinges, &mut found)?;
    }
    Ok(found)
}

/// Between bounds, evenly in the logarithm.
fn decades(rng: &mut ChaCha8Rng, from: f64, to: f64) -> f64 {
    10f64.powf(uniform(rng, from, to))
}

/// A strain, and whether a deformation has it: principal stretches of a thousandth to 30 in any direction.
fn strain(rng: &mut ChaCha8Rng) -> ([f64; 3], bool) {
    if uniform(rng, 0.0, 1.0) < WILD {
        let size = decades(rng, -6.0, 38.0);
        return (std::array::from_fn(|_| size * uniform(rng, -1.0, 1.0)), false);
    }
    let [g1, g2] = [0, 1].map(|_| 0.5 * (decades(rng, -3.0, 1.5).powi(2) - 1.0));
    let (s, c) = uniform(rng, 0.0, std::f64::consts::PI).sin_cos();
    ([g1 * c * c + g2 * s * s, g1 * s * s + g2 * c * c, (g1 - g2) * s * c], true)
}

fn hinge(rng: &mut ChaCha8Rng) -> Hinge {
    let pi = std::f64::consts::PI;
    Hinge {
        angle: uniform(rng, -pi, pi),
        angle_rest: uniform(rng, -pi, pi),
        length: decades(rng, -8.0, 2.0),
        area: decades(rng, -14.0, 2.0),
        directions: [0, 1].map(|_| [0, 1].map(|_| uniform(rng, -1.0, 1.0) * decades(rng, -6.0, 1.0))),
    }
}

fn strains_of<T: MaterialReal>(
    material: &dyn MaterialModel,
    strains: &[([f64; 3], bool)],
    found: &mut RandomStates,
) -> Result<()> {
    let green: Vec<[f64; 3]> = strains.iter().map(|s| s.0).collect();
    let answers = ask::membrane::<T>(material, &green, true)?;
    for (i, green) in green.iter().enumerate() {
        let tangents = answers.tangents.iter().filter(|t| !t.is_empty()).flat_map(|t| t[i]);
        let mut values = [answers.energy[i]].into_iter().chain(answers.stress[i]).chain(tangents);
        if values.any(|v| !v.is_finite()) {
            found.not_finite += 1;
            found.note(|| format!("G = {green:?} has an answer that is not finite in {} bits", 8 * size_of::<T>()));
        }
    }
    Ok(())
}

fn slopes(
    material: &dyn MaterialModel,
    strains: &[([f64; 3], bool)],
    directions: &[[f64; 3]],
    found: &mut RandomStates,
) -> Result<()> {
    let (green, directions): (Vec<_>, Vec<_>) =
        strains.iter().zip(directions).filter(|(s, _)| s.1).map(|(s, d)| (s.0, *d)).unzip();
    let here = ask::membrane::<f64>(material, &green, false)?;
    let largest = |v: &[f64; 3]| v.iter().fold(0.0f64, |m, x| m.max(x.abs()));
    let moved = |h: f64| -> Vec<[f64; 3]> {
        let one = |(g, d): (&[f64; 3], &[f64; 3])| std::array::from_fn(|c| g[c] + h * largest(g).max(1.0) * d[c]);
        green.iter().zip(&directions).map(one).collect()
    };
    let mut right = vec![false; green.len()];
    for share in STEPS {
        let plus = ask::membrane::<f64>(material, &moved(share), false)?.energy;
        let minus = ask::membrane::<f64>(material, &moved(-share), false)?.energy;
        for (i, right) in right.iter_mut().enumerate() {
            let (s, d, size) = (&here.stress[i], &directions[i], largest(&green[i]).max(1.0));
            let h = share * size;
            let expected = s[0] * d[0] + s[1] * d[1] + 2.0 * s[2] * d[2];
            let noise = 8.0 * f64::EPSILON * here.energy[i].abs().max(largest(s) * size);
            // As in the conformance kit, of a sum of four terms.
            let near = |slope: f64| (slope - expected).abs() <= 8e-5 * largest(s) + 2.0 * noise / h;
            let e = here.energy[i];
            *right |= near((plus[i] - minus[i]) / (2.0 * h)) || near((plus[i] - e) / h) || near((e - minus[i]) / h);
        }
    }
    found.slopes += right.len();
    for (i, right) in right.into_iter().enumerate() {
        if !right {
            found.gradient_wrong += 1;
            found.note(|| format!("S = {:?} is not the energy's slope at G = {:?}", here.stress[i], green[i]));
        }
    }
    Ok(())
}

fn folds<T: MaterialReal>(material: &dyn MaterialModel, hinges: &[Hinge], found: &mut RandomStates) -> Result<()> {
    for (k, hinge) in ask::hinges::<T>(material, hinges)?.into_iter().zip(hinges) {
        if !(k.is_finite() && k >= 0.0) {
            found.not_finite += 1;
            found.note(|| format!("k = {k} N·m in {} bits for {hinge:?}", 8 * size_of::<T>()));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plugins::Plugins;
    use crate::stress::materials;

    fn sweep(states: usize) {
        for (name, material) in materials("all", &Plugins::new().unwrap()).unwrap() {
            let found = random_states(&*material, states, 20_261_126).unwrap();
            assert!(found.sound(), "{name}: {found:?}");
            assert!(found.slopes > 0 || material.describe().stiffness_frozen);
        }
    }

    #[test]
    fn twenty_thousand_random_states_per_material() {
        sweep(20_000);
    }

    #[test]
    #[ignore = "a million states of every material take minutes; .ci/slow runs it"]
    fn a_million_random_states_per_material() {
        sweep(1_000_000);
    }
}
