//! A fully connected net: one frame at a time, no memory.

use crate::layout::{self, MAX_LAYERS, MAX_WIDTH, check_ends, check_size, pair};
use crate::squash::{sigmoid, tanh};
use crate::{dense, initial};
use caphy_core::net::{BackwardBlock, BackwardCall, DeformationNet, ForwardBlock, ForwardCall, NetManifest, NetSpec};
use caphy_core::{Error, Real, Result, simd_kernel};
use serde::{Deserialize, Serialize};
use std::ops::Range;

/// What stands between two layers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Activation {
    /// x σ(x).
    Silu,
    /// tanh x.
    Tanh,
    /// max(x, 0), with derivative 0 at 0.
    Relu,
}

/// `type = "mlp"`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct NetMlpSpec {
    /// Units of each hidden layer, 1 to 65536 each; 64 layers at most. Two of the GRU's width by default.
    pub hidden: Vec<usize>,
    /// What stands after each hidden layer. `silu` by default: smooth, so that the avatar moves smoothly with the pose.
    pub activation: Activation,
}

impl Default for NetMlpSpec {
    fn default() -> Self {
        Self { hidden: vec![256, 256], activation: Activation::Silu }
    }
}

#[typetag::serde(name = "mlp")]
impl NetSpec for NetMlpSpec {
    fn build(&self, inputs: usize, outputs: usize) -> Result<Box<dyn DeformationNet>> {
        Ok(Box::new(NetMlp::new(self, inputs, outputs)?))
    }
}

/// Linear layers with an activation after each but the last.
///
/// # Tensors
/// For each layer k: `layers.{k}.weight` `[out, in]`, `layers.{k}.bias` `[out]`, the linear output layer last
/// (PyTorch: `layers = nn.ModuleList` of `nn.Linear`).
///
/// # State
/// None.
///
/// # Tape
/// For each hidden layer, the linear output `[step][window][unit]`, then the activated one. Without a tape, the pass
/// allocates one of its own.
#[derive(Debug, Clone)]
pub struct NetMlp {
    manifest: NetManifest,
    hidden: Vec<usize>,
    activation: Activation,
}

impl NetMlp {
    /// A net of these sizes.
    ///
    /// # Errors
    /// [`Error::Config`] for a size of zero or beyond the limits of [`NetMlpSpec`].
    pub fn new(spec: &NetMlpSpec, inputs: usize, outputs: usize) -> Result<Self> {
        check_ends(inputs, outputs)?;
        if spec.hidden.len() > MAX_LAYERS {
            return Err(Error::config(
                "net.hidden",
                format!("{} hidden layers", spec.hidden.len()),
                format!("give at most {MAX_LAYERS} widths, for example [256, 256]"),
            ));
        }
        for (k, &width) in spec.hidden.iter().enumerate() {
            check_size(&format!("net.hidden[{k}]"), width, MAX_WIDTH)?;
        }
        let mut shapes = Vec::with_capacity(2 * spec.hidden.len() + 2);
        let mut below = inputs;
        for (k, &width) in spec.hidden.iter().chain([&outputs]).enumerate() {
            shapes.push((format!("layers.{k}.weight"), vec![width, below]));
            shapes.push((format!("layers.{k}.bias"), vec![width]));
            below = width;
        }
        let manifest = NetManifest::new("mlp", inputs, outputs, 0, shapes);
        Ok(Self { manifest, hidden: spec.hidden.clone(), activation: spec.activation })
    }

    /// Weight and bias of layer `k`.
    fn layer(&self, k: usize) -> (Range<usize>, Range<usize>) {
        (layout::range(&self.manifest, 2 * k), layout::range(&self.manifest, 2 * k + 1))
    }

    fn run_forward<T: Real>(&self, block: &mut ForwardBlock<'_, T>) -> Result<()> {
        let tape_len = self.tape_values(block.steps, block.batch);
        block.check(&self.manifest, tape_len)?;
        let frames = block.steps * block.batch;
        let parameters = block.parameters.or_empty();
        let mut below = block.features.or_empty();
        let mut own = Vec::new();
        let mut rest = match block.tape.get() {
            Some(tape) => tape,
            None => {
                own.resize(tape_len, T::zero());
                &mut own[..]
            }
        };
        for (k, &width) in self.hidden.iter().enumerate() {
            let (linear, after) = rest.split_at_mut(frames * width);
            let (activated, after) = after.split_at_mut(frames * width);
            rest = after;
            let (weight, bias) = self.layer(k);
            dense::forward(linear, below, &parameters[weight], &parameters[bias]);
            match self.activation {
                Activation::Silu => silu_forward(linear, activated),
                Activation::Tanh => tanh_forward(linear, activated),
                Activation::Relu => relu_forward(linear, activated),
            }
            below = activated;
        }
        let (weight, bias) = self.layer(self.hidden.len());
        if let Some(output) = block.output.get() {
            dense::forward(output, below, &parameters[weight], &parameters[bias]);
        }
        Ok(())
    }

    fn run_backward<T: Real>(&self, block: &mut BackwardBlock<'_, T>) -> Result<()> {
        block.check(&self.manifest, self.tape_values(block.steps, block.batch))?;
        let frames = block.steps * block.batch;
        let parameters = block.parameters.or_empty();
        let features = block.features.or_empty();
        let mut tape = block.tape.or_empty();
        let Some(gradient) = block.parameter_gradient.get() else { return Ok(()) };
        // Gradient by the linear output of layer `k`, from the top down.
        let mut above = block.output_gradient.or_empty().to_vec();
        for k in (0..=self.hidden.len()).rev() {
            let (weight, bias) = self.layer(k);
            let (dw, db) = pair(gradient, &weight, &bias);
            let Some(width) = k.checked_sub(1).and_then(|below| self.hidden.get(below)) else {
                dense::add_parameter_gradient(dw, db, &above, features);
                if let Some(out) = block.feature_gradient.get() {
                    dense::input_gradient(out, &above, &parameters[weight], self.manifest.inputs, false);
                }
                break;
            };
            let (lower, layer) = tape.split_at(tape.len() - 2 * frames * width);
            let (linear, activated) = layer.split_at(frames * width);
            tape = lower;
            dense::add_parameter_gradient(dw, db, &above, activated);
            let mut below = vec![T::zero(); frames * width];
            dense::input_gradient(&mut below, &above, &parameters[weight], *width, false);
            match self.activation {
                Activation::Silu => silu_backward(linear, &mut below),
                Activation::Tanh => tanh_backward(activated, &mut below),
                Activation::Relu => relu_backward(activated, &mut below),
            }
            above = below;
        }
        Ok(())
    }
}

simd_kernel! {
    /// y = x σ(x).
    fn silu_forward<T>(x: &[T], y: &mut [T]) {
        for (y, x) in y.iter_mut().zip(x) {
            *y = *x * sigmoid(*x);
        }
    }
}

simd_kernel! {
    /// g *= d(x σ(x))/dx = σ (1 + x (1 - σ)).
    fn silu_backward<T>(x: &[T], g: &mut [T]) {
        for (g, x) in g.iter_mut().zip(x) {
            let s = sigmoid(*x);
            *g *= s * (T::one() + *x * (T::one() - s));
        }
    }
}

simd_kernel! {
    /// y = tanh x.
    fn tanh_forward<T>(x: &[T], y: &mut [T]) {
        for (y, x) in y.iter_mut().zip(x) {
            *y = tanh(*x);
        }
    }
}

simd_kernel! {
    /// g *= 1 - y², y = tanh x.
    fn tanh_backward<T>(y: &[T], g: &mut [T]) {
        for (g, y) in g.iter_mut().zip(y) {
            *g *= T::one() - *y * *y;
        }
    }
}

simd_kernel! {
    /// y = max(x, 0); not-a-number stays.
    fn relu_forward<T>(x: &[T], y: &mut [T]) {
        for (y, x) in y.iter_mut().zip(x) {
            *y = if *x < T::zero() { T::zero() } else { *x };
        }
    }
}

simd_kernel! {
    /// g = 0 where y is 0.
    fn relu_backward<T>(y: &[T], g: &mut [T]) {
        for (g, y) in g.iter_mut().zip(y) {
            *g = if *y == T::zero() { T::zero() } else { *g };
        }
    }
}

impl NetMlp {
    /// Length of the tape.
    fn tape_values(&self, steps: usize, batch: usize) -> usize {
        2 * steps * batch * self.hidden.iter().sum::<usize>()
    }
}

impl DeformationNet for NetMlp {
    fn manifest(&self) -> &NetManifest {
        &self.manifest
    }
    /// Uniform in ±1/√(layer's inputs) (PyTorch's default for `nn.Linear`), zeros in the output layer.
    fn initialise(&self, seed: u64) -> Result<Vec<f64>> {
        let mut bounds = Vec::with_capacity(self.manifest.tensors.len());
        for width in [self.manifest.inputs].iter().chain(&self.hidden).take(self.hidden.len()) {
            let bound = 1.0 / (*width as f64).sqrt();
            bounds.extend([bound, bound]);
        }
        bounds.extend([0.0, 0.0]);
        Ok(initial::uniform(&self.manifest, seed, &bounds))
    }
    fn tape_len(&self, steps: usize, batch: usize) -> Result<usize> {
        Ok(self.tape_values(steps, batch))
    }
    fn forward(&self, call: ForwardCall<'_, '_>) -> Result<()> {
        match call {
            ForwardCall::F32(block) => self.run_forward(block),
            ForwardCall::F64(block) => self.run_forward(block),
        }
    }
    fn backward(&self, call: BackwardCall<'_, '_>) -> Result<()> {
        match call {
            BackwardCall::F32(block) => self.run_backward(block),
            BackwardCall::F64(block) => self.run_backward(block),
        }
    }
}
