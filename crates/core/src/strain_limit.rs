//! The one guard of membranes against overflow: strains beyond a limit are drawn back, and energy, stress and tangent follow.
//!
//! With n = √(G:G) and a limit L, a strain with n > L is answered as if it were m(G) = L (2 − L/n) G/n: it keeps its direction, its
//! size grows from L towards 2 L and never beyond. The energy is ψ(m(G)), and stress, tangents and derivatives by parameters are
//! its derivatives by the chain rule, so that energy and gradient agree on both sides of the limit and across it. C = I + 2 m
//! stays positive where I + 2 G is. Strains up to the limit are answered with the very same bits as without it.

use crate::array::Out;
use crate::material::MembraneBlock;
use crate::{Real, simd_kernel};

/// Weights of the components in the product of two symmetric tensors: Guv stands for two entries.
const SHARES: [f64; 3] = [1.0, 1.0, 2.0];

/// Answers a checked block by `answer`, with strains beyond `limit` drawn back.
///
/// Returns the number of strains that were: see [`beyond`].
pub fn within<T: Real>(
    limit: f64,
    block: &mut MembraneBlock<'_, T>,
    answer: impl Fn(&mut MembraneBlock<'_, T>),
) -> usize {
    let green = block.green.or_empty();
    if !any_beyond(T::of(0.5 * limit), green) {
        answer(block);
        return 0;
    }
    let n = block.count;
    let drawn: Vec<(usize, Drawn)> = (0..n)
        .filter_map(|i| Some((i, Drawn::new(limit, std::array::from_fn(|c| green[c * n + i].to_f64()))?)))
        .collect();
    let mut moved = green.to_vec();
    for (i, d) in &drawn {
        (0..3).for_each(|c| moved[c * n + i] = T::of(d.strain[c]));
    }
    let mut inner = MembraneBlock::new(n, &moved);
    inner.energy = lent(&mut block.energy);
    inner.stress = lent(&mut block.stress);
    inner.tangent_held = lent(&mut block.tangent_held);
    inner.tangent_total = lent(&mut block.tangent_total);
    inner.stress_by_parameter = lent(&mut block.stress_by_parameter);
    inner.stiffness = lent(&mut block.stiffness);
    answer(&mut inner);
    let stress = stress_at::<T>(&drawn, &answer);
    for ((i, d), stress) in drawn.iter().zip(&stress) {
        for out in [block.tangent_held.get(), block.tangent_total.get()].into_iter().flatten() {
            let inner = std::array::from_fn(|e| out[e * n + i].to_f64());
            d.tangent(inner, stress).iter().enumerate().for_each(|(e, t)| out[e * n + i] = T::of(*t));
        }
        if let Some(out) = block.stress.get() {
            d.apply(stress).iter().enumerate().for_each(|(c, s)| out[c * n + i] = T::of(*s));
        }
        if let Some(out) = block.stress_by_parameter.get() {
            for rows in out.chunks_exact_mut(3 * n) {
                let inner = std::array::from_fn(|c| rows[c * n + i].to_f64());
                d.apply(&inner).iter().enumerate().for_each(|(c, s)| rows[c * n + i] = T::of(*s));
            }
        }
    }
    drawn.len()
}

/// Number of strains `[Guu, Gvv, Guv][count]` beyond a limit: how often the guard acts on them.
pub fn beyond<T: Real>(limit: f64, green: &[T]) -> usize {
    let n = green.len() / 3;
    (0..n).filter(|i| Drawn::new(limit, std::array::from_fn(|c| green[c * n + i].to_f64())).is_some()).count()
}

simd_kernel! {
    /// Whether any value is larger than `half`, up to sign: only then can a strain be beyond twice that.
    fn any_beyond<T>(half: T, values: &[T]) -> bool {
        let mut any = false;
        for value in values {
            any |= value.abs() > half;
        }
        any
    }
}

fn lent<'b, T>(out: &'b mut Out<'_, T>) -> Out<'b, T> {
    out.get().map_or_else(Out::absent, Out::from)
}

/// Stress at the drawn-back strains: tangents need it whether it is wanted or not.
fn stress_at<T: Real>(drawn: &[(usize, Drawn)], answer: impl Fn(&mut MembraneBlock<'_, T>)) -> Vec<[f64; 3]> {
    let n = drawn.len();
    let green: Vec<T> = (0..3).flat_map(|c| drawn.iter().map(move |(_, d)| T::of(d.strain[c]))).collect();
    let mut stress = vec![T::zero(); 3 * n];
    let mut block = MembraneBlock::new(n, &green);
    block.stress = (&mut stress[..]).into();
    answer(&mut block);
    (0..n).map(|i| std::array::from_fn(|c| stress[c * n + i].to_f64())).collect()
}

/// A strain that was drawn back.
struct Drawn {
    /// m(G).
    strain: [f64; 3],
    /// G/n.
    direction: [f64; 3],
    /// |m|/n, d|m|/dn, (d|m|/dn − |m|/n)/n, d²|m|/dn².
    along: [f64; 4],
}

impl Drawn {
    /// `None` for a strain within the limit.
    fn new(limit: f64, green: [f64; 3]) -> Option<Self> {
        let largest = green.iter().fold(0.0f64, |m, g| m.max(g.abs()));
        // Scaled first: squares of large strains overflow. Neither can the ratio, for limits of 1 and more.
        let scaled = green.map(|g| if largest > 0.0 { g / largest } else { 0.0 });
        let norm = dot(&scaled, &scaled).sqrt();
        let x = largest / limit * norm;
        if x <= 1.0 {
            return None;
        }
        let direction = scaled.map(|g| g / norm);
        let size = limit * (2.0 - 1.0 / x);
        let (share, slope) = ((2.0 - 1.0 / x) / x, 1.0 / (x * x));
        let bend = 2.0 * (1.0 / x - 1.0) / x / x / limit;
        let curve = -2.0 / x / x / x / limit;
        Some(Self { strain: direction.map(|d| size * d), direction, along: [share, slope, bend, curve] })
    }
    /// (dm/dG) S: the derivative by G of what has the derivative S by m.
    fn apply(&self, s: &[f64; 3]) -> [f64; 3] {
        let [share, slope, ..] = self.along;
        let along = dot(s, &self.direction);
        std::array::from_fn(|c| share * s[c] + (slope - share) * along * self.direction[c])
    }
    /// ∂/∂G of [`Self::apply`] from the tangent and stress at m, both row-major.
    fn tangent(&self, inner: [f64; 9], s: &[f64; 3]) -> [f64; 9] {
        let [share, slope, bend, curve] = self.along;
        let (g, along) = (&self.direction, dot(s, &self.direction));
        let jacobian =
            |r: usize, c: usize| (if r == c { share } else { 0.0 }) + (slope - share) * g[r] * SHARES[c] * g[c];
        std::array::from_fn(|e| {
            let (r, c) = (e / 3, e % 3);
            let mut value = 0.0;
            for i in 0..3 {
                for j in 0..3 {
                    value += jacobian(r, i) * inner[3 * i + j] * jacobian(j, c);
                }
            }
            let (w, unit) = (SHARES[c], if r == c { 1.0 } else { 0.0 });
            value
                + bend * w * g[c] * s[r]
                + (curve - bend) * w * g[c] * along * g[r]
                + bend * w * (s[c] - along * g[c]) * g[r]
                + bend * along * (unit - g[r] * w * g[c])
        })
    }
}

fn dot(a: &[f64; 3], b: &[f64; 3]) -> f64 {
    (0..3).map(|c| SHARES[c] * a[c] * b[c]).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMIT: f64 = 3.0;

    /// ψ = ½ (u² + 2 v² + 3 w²) + u v²: nothing about it is linear or isotropic.
    fn answer<T: Real>(block: &mut MembraneBlock<'_, T>) {
        let n = block.count;
        for i in 0..n {
            let [u, v, w]: [f64; 3] = std::array::from_fn(|c| block.green.or_empty()[c * n + i].to_f64());
            if let Some(out) = block.energy.get() {
                out[i] = T::of(0.5 * (u * u + 2.0 * v * v + 3.0 * w * w) + u * v * v);
            }
            if let Some(out) = block.stress.get() {
                let s = [u + v * v, 2.0 * v + 2.0 * u * v, 1.5 * w];
                (0..3).for_each(|c| out[c * n + i] = T::of(s[c]));
            }
            for out in [block.tangent_total.get(), block.tangent_held.get()].into_iter().flatten() {
                let t = [1.0, 2.0 * v, 0.0, 2.0 * v, 2.0 + 2.0 * u, 0.0, 0.0, 0.0, 1.5];
                (0..9).for_each(|e| out[e * n + i] = T::of(t[e]));
            }
            if let Some(out) = block.stress_by_parameter.get() {
                [u, 0.0, 0.5 * w].iter().enumerate().for_each(|(c, s)| out[c * n + i] = T::of(*s));
            }
        }
    }

    /// Energy, stress, total tangent, stress by the parameter.
    fn ask(green: [f64; 3], guarded: bool) -> (f64, [f64; 3], [f64; 9], [f64; 3]) {
        let (mut energy, mut stress, mut tangent, mut by) = ([0.0], [0.0; 3], [0.0; 9], [0.0; 3]);
        let mut block = MembraneBlock::new(1, &green);
        block.energy = (&mut energy[..]).into();
        block.stress = (&mut stress[..]).into();
        block.tangent_total = (&mut tangent[..]).into();
        block.stress_by_parameter = (&mut by[..]).into();
        if guarded {
            let acted = within(LIMIT, &mut block, answer);
            assert_eq!(acted, beyond(LIMIT, &green));
        } else {
            answer(&mut block);
        }
        (energy[0], stress, tangent, by)
    }

    #[test]
    fn strains_within_the_limit_keep_their_bits_and_the_limit_is_no_step() {
        for green in [[0.1, -0.2, 0.3], [1.7, 0.0, 1.0], [3.0, 0.0, 0.0], [-1.5, 1.5, 1.4]] {
            assert_eq!(beyond(LIMIT, &green), 0, "{green:?}");
            assert!(ask(green, true) == ask(green, false));
        }
        let (below, above) = (ask([3.0, 0.0, 0.0], true), ask([3.0 + 1e-12, 0.0, 0.0], true));
        assert!((below.0 - above.0).abs() < 1e-10 && (below.1[0] - above.1[0]).abs() < 1e-10);
    }

    #[test]
    fn beyond_it_stress_and_tangent_are_derivatives() {
        for green in [[3.5, 0.0, 0.0], [2.0, 2.0, 2.0], [-4.0, 7.0, 1.0], [40.0, -30.0, 90.0]] {
            assert_eq!(beyond(LIMIT, &green), 1);
            let (_, stress, tangent, by) = ask(green, true);
            for c in 0..3 {
                // Central differences: h²/6 times third derivatives of order one, and rounding of energies up to 100 over 2 h.
                let h = 1e-5;
                let at = |by: f64| {
                    let mut moved = green;
                    moved[c] += by;
                    ask(moved, true)
                };
                let (plus, minus) = (at(h), at(-h));
                let slope = (plus.0 - minus.0) / (2.0 * h) / SHARES[c];
                assert!((slope - stress[c]).abs() < 1e-8, "{green:?} {c}: {slope} {}", stress[c]);
                for r in 0..3 {
                    let slope = (plus.1[r] - minus.1[r]) / (2.0 * h);
                    assert!((slope - tangent[3 * r + c]).abs() < 1e-8, "{green:?} {r} {c}: {slope} {tangent:?}");
                }
            }
            // The parameter multiplies ½ u² + ½ w²: its energy at the drawn-back strain has this stress.
            let drawn = Drawn::new(LIMIT, green).unwrap();
            let expected = drawn.apply(&[drawn.strain[0], 0.0, 0.5 * drawn.strain[2]]);
            assert_eq!(by, expected);
        }
    }

    #[test]
    fn nothing_overflows_and_only_the_far_elements_change() {
        let far = f32::MAX;
        let green = [0.1f32, far, -far, 0.2, far, 0.0, 0.3, -far, 1e-30];
        let (mut stress, mut tangent) = ([0.0f32; 9], [0.0f32; 27]);
        let mut block = MembraneBlock::new(3, &green);
        block.stress = (&mut stress[..]).into();
        block.tangent_held = (&mut tangent[..]).into();
        assert_eq!(within(LIMIT, &mut block, answer), 2);
        assert!(stress.iter().chain(&tangent).all(|v| v.is_finite()), "{stress:?} {tangent:?}");
        assert_eq!(stress[0], 0.1 + 0.2 * 0.2);
        assert_eq!(within(1e100, &mut MembraneBlock::new(1, &[f64::MAX, f64::MAX, -f64::MAX]), answer), 1);
    }
}
