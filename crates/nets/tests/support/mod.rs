//! Passes of a net over owned vectors.

#![allow(dead_code, reason = "each test file uses its part")]

use caphy_core::Real;
use caphy_core::net::{BackwardBlock, DeformationNet, ForwardBlock, NetReal};
use caphy_nets::{Activation, NetGru, NetGruSpec, NetMlp, NetMlpSpec};

/// What a pass is made on.
pub(crate) struct Case<T> {
    pub(crate) steps: usize,
    pub(crate) batch: usize,
    pub(crate) parameters: Vec<T>,
    pub(crate) features: Vec<T>,
    pub(crate) state: Option<Vec<T>>,
    pub(crate) output_gradient: Vec<T>,
}

/// What a forward pass gives.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Forward<T> {
    pub(crate) output: Vec<T>,
    pub(crate) state: Vec<T>,
    pub(crate) tape: Vec<T>,
}

/// What a backward pass gives.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Backward<T> {
    pub(crate) parameters: Vec<T>,
    pub(crate) features: Vec<T>,
}

/// Numbers in [-scale, scale) without a pattern, exact in single precision.
pub(crate) fn numbers<T: Real>(n: usize, seed: u64, scale: f64) -> Vec<T> {
    let mut x = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
    (0..n)
        .map(|_| {
            x ^= x << 13;
            x ^= x >> 7;
            x ^= x << 17;
            T::of(scale * ((x >> 53) as f64 / 1024.0 - 1.0))
        })
        .collect()
}

impl<T: NetReal> Case<T> {
    /// A pass with every input away from zero, the head included.
    pub(crate) fn new(net: &dyn DeformationNet, steps: usize, batch: usize) -> Self {
        let m = net.manifest();
        let frames = steps * batch;
        Self {
            steps,
            batch,
            parameters: numbers(m.parameter_count(), 1, 0.5),
            features: numbers(frames * m.inputs, 2, 2.0),
            state: (m.state > 0).then(|| numbers(batch * m.state, 3, 1.0)),
            output_gradient: numbers(frames * m.outputs, 4, 1.0),
        }
    }

    pub(crate) fn forward(&self, net: &dyn DeformationNet) -> Forward<T> {
        let m = net.manifest();
        let mut out = Forward {
            output: vec![T::nan(); self.steps * self.batch * m.outputs],
            state: vec![T::nan(); self.batch * m.state],
            tape: vec![T::nan(); net.tape_len(self.steps, self.batch).expect("a length")],
        };
        let mut block = ForwardBlock {
            steps: self.steps,
            batch: self.batch,
            parameters: self.parameters[..].into(),
            features: self.features[..].into(),
            state_before: self.state.as_deref().map_or_else(caphy_core::array::In::absent, Into::into),
            output: out.output.as_mut_slice().into(),
            state_after: out.state.as_mut_slice().into(),
            tape: out.tape.as_mut_slice().into(),
        };
        T::forward(net, &mut block).unwrap();
        out
    }

    pub(crate) fn backward(&self, net: &dyn DeformationNet, forward: &Forward<T>) -> Backward<T> {
        let mut out = Backward {
            parameters: vec![T::zero(); self.parameters.len()],
            features: vec![T::nan(); self.features.len()],
        };
        let mut block = BackwardBlock {
            steps: self.steps,
            batch: self.batch,
            parameters: self.parameters[..].into(),
            features: self.features[..].into(),
            state_before: self.state.as_deref().map_or_else(caphy_core::array::In::absent, Into::into),
            tape: forward.tape[..].into(),
            output_gradient: self.output_gradient[..].into(),
            parameter_gradient: out.parameters.as_mut_slice().into(),
            feature_gradient: out.features.as_mut_slice().into(),
        };
        T::backward(net, &mut block).unwrap();
        out
    }

    /// Output times output gradient: the scalar whose gradient the backward pass gives.
    pub(crate) fn objective(&self, net: &dyn DeformationNet) -> f64 {
        self.forward(net).output.iter().zip(&self.output_gradient).map(|(y, g)| (*y).to_f64() * (*g).to_f64()).sum()
    }
}

/// One small net of each kind.
pub(crate) fn small_nets() -> Vec<(String, Box<dyn DeformationNet>)> {
    let mut nets: Vec<(String, Box<dyn DeformationNet>)> = Vec::new();
    for layers in [1, 3] {
        let spec = NetGruSpec { layers, hidden: 5 };
        nets.push((format!("gru {layers}"), Box::new(NetGru::new(&spec, 4, 6).unwrap())));
    }
    for activation in [Activation::Silu, Activation::Tanh, Activation::Relu] {
        let spec = NetMlpSpec { hidden: vec![5, 7], activation };
        nets.push((format!("mlp {activation:?}"), Box::new(NetMlp::new(&spec, 4, 6).unwrap())));
    }
    let spec = NetMlpSpec { hidden: vec![], activation: Activation::Silu };
    nets.push(("mlp linear".into(), Box::new(NetMlp::new(&spec, 4, 6).unwrap())));
    nets
}

/// Largest difference, relative to the largest value of the second.
pub(crate) fn difference<A: Real, B: Real>(a: &[A], b: &[B]) -> f64 {
    assert_eq!(a.len(), b.len());
    let size = b.iter().map(|b| (*b).to_f64().abs()).fold(1e-300, f64::max);
    let worst = a.iter().zip(b).map(|(a, b)| {
        let d = ((*a).to_f64() - (*b).to_f64()).abs();
        if d.is_nan() { f64::INFINITY } else { d }
    });
    worst.fold(0.0, f64::max) / size
}
