//! A full [`MaterialModel`] from an energy.

use super::dual::{Dual, PlainScalar, Scalar};
use super::{EnergyMaterial, HingeState};
use crate::material::{
    HingeBlock, HingeCall, MaterialDescription, MaterialModel, MaterialOutputs, MembraneBlock, MembraneCall,
};
use crate::params::{Parameter, check_values};
use crate::{Result, simd_kernel, strain_limit};

/// Elements per piece: all of a piece's arrays stay in the first cache, and its loops vectorise without alias checks.
const CHUNK: usize = 16;

/// What a [`FromEnergy`] answers: all but the four orthotropic constants, which a general energy does not have.
const OFFERS: MaterialOutputs = MaterialOutputs { stiffness: false, ..MaterialOutputs::ALL };

/// The model of an energy.
#[derive(Debug, Clone)]
pub struct FromEnergy<M>(pub M);

impl<M: EnergyMaterial> FromEnergy<M> {
    /// As a trait object: the last line of a specification's `build`.
    pub fn boxed(material: M) -> Box<dyn MaterialModel> {
        Box::new(Self(material))
    }

    fn membrane_block<T: PlainScalar>(&self, block: &mut MembraneBlock<'_, T>) -> Result<()> {
        let theta = self.0.parameters();
        block.check(theta.len())?;
        OFFERS.check_membrane(block, &self.0.facts().name)?;
        strain_limit::within(M::LARGEST_STRAIN, block, |block| self.membrane_answers(&theta, block));
        Ok(())
    }
    fn membrane_answers<T: PlainScalar>(&self, theta: &[Parameter], block: &mut MembraneBlock<'_, T>) {
        let plain: Vec<T> = theta.iter().map(|p| T::of(p.value)).collect();
        if block.energy.wanted() || block.stress.wanted() {
            membrane_values::<T, M>(&self.0, &plain, block);
        }
        if block.tangent_held.wanted() || block.tangent_total.wanted() {
            let fixed: Vec<Dual<T, 3>> = plain.iter().map(|p| Dual::fixed(*p)).collect();
            membrane_tangent::<T, M>(&self.0, &fixed, block);
        }
        if block.stress_by_parameter.wanted() {
            for index in 0..plain.len() {
                let varied = vary(&plain, index);
                membrane_by_parameter::<T, M>(&self.0, &varied, index, block);
            }
        }
    }

    fn hinge_block<T: PlainScalar>(&self, block: &mut HingeBlock<'_, T>) -> Result<()> {
        let theta = self.0.parameters();
        block.check(theta.len())?;
        let plain: Vec<T> = theta.iter().map(|p| T::of(p.value)).collect();
        if block.stiffness.wanted() {
            hinge_values::<T, M>(&self.0, &plain, block);
        }
        if block.stiffness_by_angle.wanted() || block.stiffness_by_length.wanted() {
            let fixed: Vec<Dual<T, 2>> = plain.iter().map(|p| Dual::fixed(*p)).collect();
            hinge_slopes::<T, M>(&self.0, &fixed, block);
        }
        if block.stiffness_by_parameter.wanted() {
            for index in 0..plain.len() {
                let varied = vary(&plain, index);
                hinge_by_parameter::<T, M>(&self.0, &varied, index, block);
            }
        }
        Ok(())
    }
}

/// Parameters of which one is the variable.
fn vary<T: PlainScalar>(plain: &[T], index: usize) -> Vec<Dual<T, 1>> {
    let one = |(i, value): (usize, &T)| if i == index { Dual::variable(*value, 0) } else { Dual::fixed(*value) };
    plain.iter().enumerate().map(one).collect()
}

impl<M: EnergyMaterial> MaterialModel for FromEnergy<M> {
    fn describe(&self) -> MaterialDescription {
        let facts = self.0.facts();
        MaterialDescription {
            name: facts.name,
            density: facts.density,
            stiffness_frozen: false,
            hinge_length: facts.hinge_length,
            linear_in_parameters: facts.linear_in_parameters,
            offers: OFFERS,
        }
    }
    fn membrane(&self, call: MembraneCall<'_, '_>) -> Result<()> {
        match call {
            MembraneCall::F32(block) => self.membrane_block(block),
            MembraneCall::F64(block) => self.membrane_block(block),
        }
    }
    fn hinge(&self, call: HingeCall<'_, '_>) -> Result<()> {
        match call {
            HingeCall::F32(block) => self.hinge_block(block),
            HingeCall::F64(block) => self.hinge_block(block),
        }
    }
    fn strain_limits(&self) -> Option<[f64; 2]> {
        Some([M::LARGEST_STRAIN; 2])
    }
    fn parameters(&self) -> Vec<Parameter> {
        self.0.parameters()
    }
    fn with_parameters(&self, values: &[f64]) -> Result<Box<dyn MaterialModel>> {
        check_values(&self.0.parameters(), values)?;
        Ok(Box::new(Self(self.0.with_values(values)?)))
    }
}

/// Stress in any scalar: by hand, or the energy's slope.
#[inline(always)]
fn stress<S: Scalar, M: EnergyMaterial>(model: &M, theta: &[S], lifted: &[Dual<S, 3>], green: [S; 3]) -> [S; 3] {
    match model.stress(theta, green) {
        Some(stress) => stress,
        None => slope(model, lifted, green).1,
    }
}

/// Energy and its stress.
#[inline(always)]
fn slope<S: Scalar, M: EnergyMaterial>(model: &M, lifted: &[Dual<S, 3>], green: [S; 3]) -> (S, [S; 3]) {
    let [u, v, w] = green;
    let psi = model.energy(lifted, [Dual::variable(u, 0), Dual::variable(v, 1), Dual::variable(w, 2)]);
    (psi.value, [psi.slope[0], psi.slope[1], psi.slope[2].times(0.5)])
}

/// Strains of a piece; zeros behind the end.
#[inline(always)]
fn load<T: PlainScalar>(green: &[T], count: usize, start: usize) -> [[T; CHUNK]; 3] {
    let mut piece = [[T::zero(); CHUNK]; 3];
    let used = CHUNK.min(count - start);
    for (c, row) in piece.iter_mut().enumerate() {
        row[..used].copy_from_slice(&green[c * count + start..][..used]);
    }
    piece
}

/// Copies a piece to row `row` of an output.
#[inline(always)]
fn store<T: PlainScalar>(out: &mut [T], count: usize, row: usize, start: usize, piece: &[T; CHUNK]) {
    let used = CHUNK.min(count - start);
    out[row * count + start..][..used].copy_from_slice(&piece[..used]);
}

simd_kernel! {
    /// Energy and stress.
    fn membrane_values<T: PlainScalar, M: EnergyMaterial>(model: &M, theta: &[T], block: &mut MembraneBlock<'_, T>) {
        let n = block.count;
        let green = block.green.or_empty();
        let lifted: Vec<Dual<T, 3>> = theta.iter().map(|p| Dual::fixed(*p)).collect();
        let energy_alone = !block.stress.wanted();
        let mut start = 0;
        while start < n {
            let g = load(green, n, start);
            let mut energy = [T::zero(); CHUNK];
            let mut rows = [[T::zero(); CHUNK]; 3];
            if energy_alone {
                for i in 0..CHUNK {
                    energy[i] = model.energy(theta, [g[0][i], g[1][i], g[2][i]]);
                }
            } else {
                for i in 0..CHUNK {
                    let (psi, slope) = slope(model, &lifted, [g[0][i], g[1][i], g[2][i]]);
                    energy[i] = psi;
                    for c in 0..3 {
                        rows[c][i] = slope[c];
                    }
                }
                for i in 0..CHUNK {
                    // Known when the model is compiled: where there is no hand-written stress, this loop is empty.
                    if let Some(stress) = model.stress(theta, [g[0][i], g[1][i], g[2][i]]) {
                        for c in 0..3 {
                            rows[c][i] = stress[c];
                        }
                    }
                }
            }
            if let Some(out) = block.energy.get() {
                store(out, n, 0, start, &energy);
            }
            if let Some(out) = block.stress.get() {
                for c in 0..3 {
                    store(out, n, c, start, &rows[c]);
                }
            }
            start += CHUNK;
        }
    }
}

simd_kernel! {
    /// ∂S/∂G; nothing is frozen, so that both tangents are the same matrix.
    fn membrane_tangent<T: PlainScalar, M: EnergyMaterial>(
        model: &M,
        theta: &[Dual<T, 3>],
        block: &mut MembraneBlock<'_, T>,
    ) {
        let n = block.count;
        let green = block.green.or_empty();
        let lifted: Vec<Dual<Dual<T, 3>, 3>> = theta.iter().map(|p| Dual::fixed(*p)).collect();
        let mut start = 0;
        while start < n {
            let g = load(green, n, start);
            let mut entries = [[T::zero(); CHUNK]; 9];
            for i in 0..CHUNK {
                let variables = [Dual::variable(g[0][i], 0), Dual::variable(g[1][i], 1), Dual::variable(g[2][i], 2)];
                let stress = stress(model, theta, &lifted, variables);
                for r in 0..3 {
                    for c in 0..3 {
                        entries[3 * r + c][i] = stress[r].slope[c];
                    }
                }
            }
            for out in [block.tangent_held.get(), block.tangent_total.get()].into_iter().flatten() {
                for (row, piece) in entries.iter().enumerate() {
                    store(out, n, row, start, piece);
                }
            }
            start += CHUNK;
        }
    }
}

simd_kernel! {
    /// ∂S/∂Θ of parameter `index`, which is the variable of `theta`.
    fn membrane_by_parameter<T: PlainScalar, M: EnergyMaterial>(
        model: &M,
        theta: &[Dual<T, 1>],
        index: usize,
        block: &mut MembraneBlock<'_, T>,
    ) {
        let n = block.count;
        let green = block.green.or_empty();
        let lifted: Vec<Dual<Dual<T, 1>, 3>> = theta.iter().map(|p| Dual::fixed(*p)).collect();
        let Some(out) = block.stress_by_parameter.get() else { return };
        let mut start = 0;
        while start < n {
            let g = load(green, n, start);
            let mut rows = [[T::zero(); CHUNK]; 3];
            for i in 0..CHUNK {
                let fixed = [Dual::fixed(g[0][i]), Dual::fixed(g[1][i]), Dual::fixed(g[2][i])];
                let stress = stress(model, theta, &lifted, fixed);
                for c in 0..3 {
                    rows[c][i] = stress[c].slope[0];
                }
            }
            for c in 0..3 {
                store(out, n, 3 * index + c, start, &rows[c]);
            }
            start += CHUNK;
        }
    }
}

/// A hinge of a block, lifted to any scalar.
#[inline(always)]
fn hinge_at<T: PlainScalar, S: Scalar>(block: &HingeBlock<'_, T>, i: usize, lift: impl Fn(T) -> S) -> HingeState<S> {
    let n = block.count;
    let direction = |d: &[T]| [lift(d[i]), lift(d[n + i])];
    HingeState {
        angle: lift(block.angle.or_empty()[i]),
        angle_rest: lift(block.angle_rest.or_empty()[i]),
        length: lift(block.length.or_empty()[i]),
        area: lift(block.area.or_empty()[i]),
        directions: [direction(block.direction0.or_empty()), direction(block.direction1.or_empty())],
    }
}

simd_kernel! {
    /// k.
    fn hinge_values<T: PlainScalar, M: EnergyMaterial>(model: &M, theta: &[T], block: &mut HingeBlock<'_, T>) {
        for i in 0..block.count {
            let k = model.bending_stiffness(theta, &hinge_at(block, i, |x| x));
            if let Some(out) = block.stiffness.get() {
                out[i] = k;
            }
        }
    }
}

simd_kernel! {
    /// dk/dθ and dk/dl.
    fn hinge_slopes<T: PlainScalar, M: EnergyMaterial>(
        model: &M,
        theta: &[Dual<T, 2>],
        block: &mut HingeBlock<'_, T>,
    ) {
        for i in 0..block.count {
            let mut hinge: HingeState<Dual<T, 2>> = hinge_at(block, i, Dual::fixed);
            hinge.angle = Dual::variable(hinge.angle.value, 0);
            hinge.length = Dual::variable(hinge.length.value, 1);
            let k = model.bending_stiffness(theta, &hinge);
            if let Some(out) = block.stiffness_by_angle.get() {
                out[i] = k.slope[0];
            }
            if let Some(out) = block.stiffness_by_length.get() {
                out[i] = k.slope[1];
            }
        }
    }
}

simd_kernel! {
    /// ∂k/∂Θ of parameter `index`, which is the variable of `theta`.
    fn hinge_by_parameter<T: PlainScalar, M: EnergyMaterial>(
        model: &M,
        theta: &[Dual<T, 1>],
        index: usize,
        block: &mut HingeBlock<'_, T>,
    ) {
        let n = block.count;
        for i in 0..n {
            let k = model.bending_stiffness(theta, &hinge_at(block, i, Dual::fixed));
            if let Some(out) = block.stiffness_by_parameter.get() {
                out[index * n + i] = k.slope[0];
            }
        }
    }
}
