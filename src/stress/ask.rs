//! Many strains or folds in one call, answers widened to double precision.

use caphy_core::Result;
use caphy_core::array::Out;
use caphy_core::extension::Hinge;
use caphy_core::material::{HingeBlock, MaterialModel, MaterialReal, MembraneBlock};

/// Answers to strains; what the material does not offer is empty.
pub(super) struct Answers {
    /// ψ [J/m²].
    pub(super) energy: Vec<f64>,
    /// S [N/m].
    pub(super) stress: Vec<[f64; 3]>,
    /// ∂S/∂G [N/m], with the stiffness held and with its change.
    pub(super) tangents: [Vec<[f64; 9]>; 2],
}

/// Asks in precision T.
pub(super) fn membrane<T: MaterialReal>(
    model: &dyn MaterialModel,
    green: &[[f64; 3]],
    tangents: bool,
) -> Result<Answers> {
    let (n, offers) = (green.len(), model.describe().offers);
    let flat: Vec<T> = (0..3).flat_map(|c| green.iter().map(move |g| T::of(g[c]))).collect();
    let room = |wanted: bool, rows: usize| vec![T::zero(); if wanted { rows * n } else { 0 }];
    let (mut energy, mut stress) = (room(true, 1), room(true, 3));
    let mut held = room(tangents && offers.tangent_held, 9);
    let mut total = room(tangents && offers.tangent_total, 9);
    let mut block = MembraneBlock::new(n, &flat);
    block.energy = Out::from(&mut energy[..]);
    block.stress = Out::from(&mut stress[..]);
    if !held.is_empty() {
        block.tangent_held = Out::from(&mut held[..]);
    }
    if !total.is_empty() {
        block.tangent_total = Out::from(&mut total[..]);
    }
    T::membrane(model, &mut block)?;
    fn rows<T: MaterialReal, const N: usize>(values: &[T], n: usize) -> Vec<[f64; N]> {
        let count = if values.is_empty() { 0 } else { n };
        (0..count).map(|i| std::array::from_fn(|row| values[row * n + i].to_f64())).collect()
    }
    Ok(Answers {
        energy: energy.into_iter().map(|e| e.to_f64()).collect(),
        stress: rows(&stress, n),
        tangents: [rows(&held, n), rows(&total, n)],
    })
}

/// k [N·m] of folds in precision T.
pub(super) fn hinges<T: MaterialReal>(model: &dyn MaterialModel, hinges: &[Hinge]) -> Result<Vec<f64>> {
    let column = |f: fn(&Hinge) -> f64| hinges.iter().map(|h| T::of(f(h))).collect::<Vec<T>>();
    let [angle, rest] = [column(|h| h.angle), column(|h| h.angle_rest)];
    let [length, area] = [column(|h| h.length), column(|h| h.area)];
    let side =
        |s: usize| -> Vec<T> { (0..2).flat_map(|k| hinges.iter().map(move |h| T::of(h.directions[s][k]))).collect() };
    let (side0, side1) = (side(0), side(1));
    let mut k = vec![T::zero(); hinges.len()];
    let mut block = HingeBlock::new(hinges.len(), [&angle, &rest, &length, &area], [&side0, &side1]);
    block.stiffness = Out::from(&mut k[..]);
    T::hinge(model, &mut block)?;
    Ok(k.into_iter().map(|k| k.to_f64()).collect())
}
