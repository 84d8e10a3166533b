//! Energy, stress and derivatives of the four-constant sheet, whatever the lookup of its stiffness.
//!
//! ψ = Σₐ kₐ qₐ with q = (½ Guu², Guu Gvv, ½ Gvv², Guv²): the potential of ARCSim's force for held k.

use super::fabrics::{STRETCH_COLUMNS, STRETCH_ROWS};
use super::spec::{Form, StiffnessGradient};
use crate::chunk::{CHUNK, Row, piece, write};
use caphy_core::Real;
use caphy_core::material::MembraneBlock;

/// Four stiffness constants of every element of a piece [N/m].
pub(super) type Stiffness<T> = [[T; 4]; CHUNK];

/// Stiffness and its derivatives by G at one strain.
pub(super) struct Jet<T> {
    /// k [N/m].
    pub(super) value: [T; 4],
    /// ∂k/∂(Guu, Gvv, Guv) [N/m], shape [strain][constant].
    pub(super) slope: [[T; 4]; 3],
    /// ∂²k/∂Guu∂Gvv, ∂²k/∂Guu∂Guv, ∂²k/∂Gvv∂Guv [N/m], shape [pair][constant]; the pure ones vanish inside a cell.
    pub(super) mixed: [[T; 4]; 3],
}

/// ∂k/∂(raw table entry): shape [row][constant], entry (row, a) acts on constant a alone.
pub(super) type Weights<T> = [[T; STRETCH_COLUMNS]; STRETCH_ROWS];

/// Weights and their derivatives by (Guu, Gvv, Guv).
pub(super) struct WeightsJet<T> {
    pub(super) value: Weights<T>,
    pub(super) slope: [Weights<T>; 3],
}

/// A rule that turns strain into four stiffness constants.
pub(super) trait Lookup<T> {
    /// Stiffness of a whole piece.
    fn stiffness(&self, green: &[Row<T>; 3], out: &mut Stiffness<T>);
    /// Stiffness with derivatives at one strain.
    fn jet(&self, green: [T; 3]) -> Jet<T>;
    /// Influence of the table's entries at one strain.
    fn weights(&self, green: [T; 3]) -> WeightsJet<T>;
}

/// What is done with the looked-up constants.
#[derive(Debug, Clone, Copy)]
pub(super) struct Rule {
    pub(super) form: Form,
    pub(super) gradient: StiffnessGradient,
}

impl Form {
    /// The linear map from looked-up to used constants, shape [used][looked up].
    ///
    /// Isotropic: λ = (k0 + 6 k1 + k2 − 2 k3)/8 and μ = (k0 + k2 − 2 k1 + 2 k3)/8 are the rotational average (reference
    /// note 5, option A), and (λ + 2μ, λ, λ + 2μ, 2μ) takes Eq. 5 back to four constants.
    fn map(self) -> [[f64; 4]; 4] {
        match self {
            Self::Orthotropic => [[1., 0., 0., 0.], [0., 1., 0., 0.], [0., 0., 1., 0.], [0., 0., 0., 1.]],
            Self::Isotropic => {
                let stiff = [0.375, 0.25, 0.375, 0.25];
                [stiff, [0.125, 0.75, 0.125, -0.25], stiff, [0.25, -0.5, 0.25, 0.5]]
            }
        }
    }

    #[inline(always)]
    fn apply<T: Real>(self, k: [T; 4]) -> [T; 4] {
        match self {
            Self::Orthotropic => k,
            Self::Isotropic => {
                let eighth = T::of(0.125);
                let (two, six) = (T::of(2.0), T::of(6.0));
                let lambda = eighth * (k[0] + six * k[1] + k[2] - two * k[3]);
                let twice_mu = T::of(0.25) * (k[0] + k[2] - two * k[1] + two * k[3]);
                [lambda + twice_mu, lambda, lambda + twice_mu, twice_mu]
            }
        }
    }
}

/// q of the module's formula, and ∂S/∂k for held stiffness, shape [Suu, Svv, Suv][constant].
#[inline(always)]
fn quadratics<T: Real>(g: [T; 3]) -> ([T; 4], [[T; 4]; 3]) {
    let (half, zero) = (T::of(0.5), T::zero());
    let q = [half * g[0] * g[0], g[0] * g[1], half * g[1] * g[1], g[2] * g[2]];
    (q, [[g[0], g[1], zero, zero], [zero, g[0], g[1], zero], [zero, zero, zero, g[2]]])
}

#[inline(always)]
fn dot<T: Real>(a: &[T; 4], b: &[T; 4]) -> T {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3]
}

/// Held tangent ∂S/∂G, shape [Suu, Svv, Suv][Guu, Gvv, Guv].
#[inline(always)]
fn held<T: Real>(k: &[T; 4]) -> [[T; 3]; 3] {
    let zero = T::zero();
    [[k[0], k[1], zero], [k[1], k[2], zero], [zero, zero, k[3]]]
}

/// Suv is the tensor's entry: half of ∂ψ/∂Guv.
#[inline(always)]
fn tensor_share<T: Real>(component: usize) -> T {
    T::of(if component == 2 { 0.5 } else { 1.0 })
}

/// Answers a checked block.
#[inline(always)]
pub(super) fn answer<T: Real, L: Lookup<T>>(lookup: &L, rule: Rule, block: &mut MembraneBlock<'_, T>) {
    let n = block.count;
    let green = block.green.or_empty();
    let (guu, rest) = green.split_at(n);
    let (gvv, guv) = rest.split_at(n);
    let full = rule.gradient == StiffnessGradient::Full;
    let held_wanted = block.energy.wanted()
        || (block.stress.wanted() && !full)
        || block.tangent_held.wanted()
        || block.stiffness.wanted();
    if let Some(out) = block.stress_by_parameter.get() {
        out.fill(T::zero());
    }

    let mut g = [[T::zero(); CHUNK]; 3];
    let mut constants = [[T::zero(); 4]; CHUNK];
    let mut spare = [T::zero(); CHUNK];
    let mut start = 0;
    while start < n {
        for (held, row) in g.iter_mut().zip([guu, gvv, guv]) {
            let given = piece(row, start, &mut spare);
            held.copy_from_slice(given);
        }
        if held_wanted {
            lookup.stiffness(&g, &mut constants);
            if rule.form == Form::Isotropic {
                for entry in &mut constants {
                    *entry = rule.form.apply(*entry);
                }
            }
            held_outputs(&g, &constants, full, start, block);
        }
        if block.tangent_total.wanted() || (full && block.stress.wanted()) {
            moving_outputs(lookup, rule, &g, start, block);
        }
        if block.stress_by_parameter.wanted() {
            parameter_outputs(lookup, rule, &g, start, block);
        }
        start += CHUNK;
    }
}

/// Outputs that need k alone.
#[inline(always)]
fn held_outputs<T: Real>(
    g: &[Row<T>; 3],
    k: &Stiffness<T>,
    full: bool,
    start: usize,
    block: &mut MembraneBlock<'_, T>,
) {
    let n = block.count;
    if let Some(energy) = block.energy.get() {
        let half = T::of(0.5);
        write(energy, start, |i| {
            let (u, v, w) = (g[0][i], g[1][i], g[2][i]);
            half * (k[i][0] * u * u + k[i][2] * v * v) + k[i][1] * u * v + k[i][3] * w * w
        });
    }
    if !full && let Some(stress) = block.stress.get() {
        let (suu, rest) = stress.split_at_mut(n);
        let (svv, suv) = rest.split_at_mut(n);
        write(suu, start, |i| k[i][0] * g[0][i] + k[i][1] * g[1][i]);
        write(svv, start, |i| k[i][2] * g[1][i] + k[i][1] * g[0][i]);
        write(suv, start, |i| k[i][3] * g[2][i]);
    }
    if let Some(out) = block.tangent_held.get() {
        // Constant behind each entry of the 3x3 matrix; `None` is zero.
        let constants = [Some(0), Some(1), None, Some(1), Some(2), None, None, None, Some(3)];
        for (entry, constant) in constants.into_iter().enumerate() {
            let row = &mut out[entry * n..(entry + 1) * n];
            match constant {
                Some(a) => write(row, start, |i| k[i][a]),
                None => write(row, start, |_| T::zero()),
            }
        }
    }
    if let Some(out) = block.stiffness.get() {
        for a in 0..4 {
            write(&mut out[a * n..(a + 1) * n], start, |i| k[i][a]);
        }
    }
}

/// Outputs that need dk/dG: the total tangent, and the stress when it is the energy's full gradient.
#[inline(always)]
fn moving_outputs<T: Real, L: Lookup<T>>(
    lookup: &L,
    rule: Rule,
    g: &[Row<T>; 3],
    start: usize,
    block: &mut MembraneBlock<'_, T>,
) {
    let n = block.count;
    let full = rule.gradient == StiffnessGradient::Full;
    for i in 0..CHUNK.min(n - start) {
        let strain = [g[0][i], g[1][i], g[2][i]];
        let jet = lookup.jet(strain);
        let k = rule.form.apply(jet.value);
        let slope = jet.slope.map(|s| rule.form.apply(s));
        let (q, by_k) = quadratics(strain);
        if full && let Some(stress) = block.stress.get() {
            for c in 0..3 {
                stress[c * n + start + i] = dot(&by_k[c], &k) + tensor_share::<T>(c) * dot(&slope[c], &q);
            }
        }
        if let Some(out) = block.tangent_total.get() {
            let mut tangent = held(&k);
            for c in 0..3 {
                for d in 0..3 {
                    tangent[c][d] += dot(&by_k[c], &slope[d]);
                }
            }
            if full {
                // Derivative of ½∂k/∂G q: by q, and inside a cell by the mixed second derivatives of k.
                let mixed = jet.mixed.map(|s| dot(&rule.form.apply(s), &q));
                let second =
                    [[T::zero(), mixed[0], mixed[1]], [mixed[0], T::zero(), mixed[2]], [mixed[1], mixed[2], T::zero()]];
                for c in 0..3 {
                    for d in 0..3 {
                        // ∂q/∂G_d is ∂S_d/∂k divided by the tensor's share.
                        let by_quadratic = dot(&slope[c], &by_k[d]) / tensor_share::<T>(d);
                        tangent[c][d] += tensor_share::<T>(c) * (by_quadratic + second[c][d]);
                    }
                }
            }
            for (entry, value) in tangent.iter().flatten().enumerate() {
                out[entry * n + start + i] = *value;
            }
        }
    }
}

/// ∂S/∂Θ of the stretching entries; the bending entries behind them stay zero.
#[inline(always)]
fn parameter_outputs<T: Real, L: Lookup<T>>(
    lookup: &L,
    rule: Rule,
    g: &[Row<T>; 3],
    start: usize,
    block: &mut MembraneBlock<'_, T>,
) {
    let n = block.count;
    let full = rule.gradient == StiffnessGradient::Full;
    let map = rule.form.map();
    let Some(out) = block.stress_by_parameter.get() else { return };
    for i in 0..CHUNK.min(n - start) {
        let strain = [g[0][i], g[1][i], g[2][i]];
        let weights = lookup.weights(strain);
        let (q, by_k) = quadratics(strain);
        for a in 0..STRETCH_COLUMNS {
            let column = [T::of(map[0][a]), T::of(map[1][a]), T::of(map[2][a]), T::of(map[3][a])];
            let by_quadratic = dot(&column, &q);
            for c in 0..3 {
                let by_constant = dot(&column, &by_k[c]);
                for row in 0..STRETCH_ROWS {
                    let mut value = by_constant * weights.value[row][a];
                    if full {
                        value += tensor_share::<T>(c) * by_quadratic * weights.slope[c][row][a];
                    }
                    out[((row * STRETCH_COLUMNS + a) * 3 + c) * n + start + i] = value;
                }
            }
        }
    }
}
