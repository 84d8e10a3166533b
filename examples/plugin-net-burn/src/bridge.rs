//! A [`DeformationNet`] of any Burn module: the host's flat slices in, the host's flat slices out.
//!
//! Each call copies the parameters into fresh Burn tensors, so that the library keeps nothing between calls. A backward pass
//! runs the forward pass once more, this time recorded, contracts the output with the host's gradient and lets Burn
//! differentiate that sum; the host's tape is therefore empty, and a training step pays for two forward passes.

use burn::module::{Module, ModuleMapper, ModuleVisitor, Param};
use burn::tensor::{Device, Element, Gradients, Tensor, TensorData};
use caphy_core::net::{BackwardBlock, BackwardCall, DeformationNet, ForwardBlock, ForwardCall, NetManifest};
use caphy_core::{Error, Real, Result};
use std::sync::{Mutex, PoisonError};

/// A module over windows of frames.
pub(crate) trait WindowModule: Module {
    /// Features `[step, window, input]` and the state before `[window, state]` to outputs `[step, window, output]` and the
    /// state after.
    fn forward(&self, features: Tensor<3>, state: Tensor<2>) -> (Tensor<3>, Tensor<2>);
}

/// Burn draws first values from one generator per process, which a seed resets: one drawer at a time. No other library
/// shares it, since each has a Burn of its own.
static GENERATOR: Mutex<()> = Mutex::new(());

/// A net whose module is made anew, without values, for every call.
pub(crate) struct NetBurn<F> {
    manifest: NetManifest,
    module: F,
}

impl<M: WindowModule, F: Fn(&Device) -> M> NetBurn<F> {
    /// Names and shapes of tensors are those of the module.
    pub(crate) fn new(name: &str, inputs: usize, outputs: usize, state: usize, module: F) -> Self {
        let mut layout = Layout::default();
        module(&Device::flex()).visit(&mut layout);
        Self { manifest: NetManifest::new(name, inputs, outputs, state, layout.shapes), module }
    }

    /// The module with the host's parameters, recorded where the device differentiates.
    fn loaded<T: Real + Element>(&self, parameters: &[T], device: &Device) -> M {
        (self.module)(device).map(&mut Load { rest: parameters, device })
    }

    /// Features and state as tensors; absent state is zeros.
    fn ends<T: Real + Element>(
        &self,
        (steps, batch): (usize, usize),
        features: &[T],
        state: Option<&[T]>,
        device: &Device,
    ) -> (Tensor<3>, Tensor<2>) {
        let NetManifest { inputs, state: width, .. } = self.manifest;
        let state = state.map_or_else(|| vec![T::zero(); batch * width], <[T]>::to_vec);
        (tensor(features.to_vec(), [steps, batch, inputs], device), tensor(state, [batch, width], device))
    }

    fn run_forward<T: Real + Element>(&self, block: &mut ForwardBlock<'_, T>) -> Result<()> {
        block.check(&self.manifest, 0)?;
        let device = Device::flex();
        let module = self.loaded(block.parameters.or_empty(), &device);
        let sizes = (block.steps, block.batch);
        let (features, state) = self.ends(sizes, block.features.or_empty(), block.state_before.get(), &device);
        let (output, after) = module.forward(features, state);
        if let Some(to) = block.output.get() {
            to.copy_from_slice(&values(output)?);
        }
        if let Some(to) = block.state_after.get() {
            to.copy_from_slice(&values(after)?);
        }
        Ok(())
    }

    fn run_backward<T: Real + Element>(&self, block: &mut BackwardBlock<'_, T>) -> Result<()> {
        block.check(&self.manifest, 0)?;
        let device = Device::flex().autodiff();
        let module = self.loaded(block.parameters.or_empty(), &device);
        let sizes = (block.steps, block.batch);
        let (mut features, state) = self.ends(sizes, block.features.or_empty(), block.state_before.get(), &device);
        if block.feature_gradient.wanted() {
            features = features.require_grad();
        }
        let (output, _) = module.forward(features.clone(), state);
        let upstream = tensor(block.output_gradient.or_empty().to_vec(), output.dims(), &device);
        let mut gradients = (output * upstream).sum().backward();
        if let Some(to) = block.parameter_gradient.get() {
            let mut add = Add { rest: to, gradients: &mut gradients, outcome: Ok(()) };
            module.visit(&mut add);
            add.outcome?;
        }
        if let Some(to) = block.feature_gradient.get() {
            match features.grad_remove(&mut gradients) {
                Some(gradient) => to.copy_from_slice(&values(gradient)?),
                None => to.fill(T::zero()),
            }
        }
        Ok(())
    }
}

impl<M: WindowModule, F: Fn(&Device) -> M + Send + Sync> DeformationNet for NetBurn<F> {
    fn manifest(&self) -> &NetManifest {
        &self.manifest
    }
    /// Burn's own, from its generator.
    fn initialise(&self, seed: u64) -> Result<Vec<f64>> {
        let _alone = GENERATOR.lock().unwrap_or_else(PoisonError::into_inner);
        let device = Device::flex();
        device.seed(seed);
        let mut first = First { values: Vec::with_capacity(self.manifest.parameter_count()), outcome: Ok(()) };
        (self.module)(&device).visit(&mut first);
        first.outcome?;
        Ok(first.values)
    }
    fn tape_len(&self, _steps: usize, _batch: usize) -> Result<usize> {
        Ok(0)
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

/// A tensor in the precision of its values.
fn tensor<T: Real + Element, const D: usize>(values: Vec<T>, shape: [usize; D], device: &Device) -> Tensor<D> {
    Tensor::from_data(TensorData::new(values, shape), (device, <T as Element>::dtype()))
}

/// The values of a tensor.
fn values<T: Real + Element, const D: usize>(tensor: Tensor<D>) -> Result<Vec<T>> {
    let unreadable = |e: String| Error::numerics("a tensor of Burn", e, "report it with the net's table");
    let data = tensor.try_into_data().map_err(|e| unreadable(e.to_string()))?;
    data.try_into_vec().map_err(|e| unreadable(e.to_string()))
}

/// Collects names and shapes.
#[derive(Default)]
struct Layout {
    path: Vec<String>,
    shapes: Vec<(String, Vec<usize>)>,
}

impl ModuleVisitor for Layout {
    fn enter_module(&mut self, name: &str, _: &str) {
        self.path.push(name.into());
    }
    fn exit_module(&mut self, _: &str, _: &str) {
        self.path.pop();
    }
    fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
        self.shapes.push((self.path.join("."), param.lazy_shape().to_vec()));
    }
}

/// Collects first values.
struct First {
    values: Vec<f64>,
    outcome: Result<()>,
}

impl ModuleVisitor for First {
    fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
        match values::<f32, D>(param.val()) {
            Ok(some) => self.values.extend(some.into_iter().map(f64::from)),
            Err(error) => self.outcome = Err(error),
        }
    }
}

/// Replaces values, in the order of [`Layout`], by the host's.
struct Load<'a, T> {
    rest: &'a [T],
    device: &'a Device,
}

impl<T: Real + Element> ModuleMapper for Load<'_, T> {
    fn map_float<const D: usize>(&mut self, param: Param<Tensor<D>>) -> Param<Tensor<D>> {
        let shape: [usize; D] = param.lazy_shape().dims();
        let (here, rest) = self.rest.split_at(shape.iter().product());
        self.rest = rest;
        let value = tensor(here.to_vec(), shape, self.device);
        let value = if self.device.is_autodiff() { value.require_grad() } else { value };
        Param::initialized(param.id, value)
    }
}

/// Adds gradients, in the order of [`Layout`], to the host's.
struct Add<'a, T> {
    rest: &'a mut [T],
    gradients: &'a mut Gradients,
    outcome: Result<()>,
}

impl<T: Real + Element> ModuleVisitor for Add<'_, T> {
    fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
        let (here, rest) = std::mem::take(&mut self.rest).split_at_mut(param.lazy_shape().num_elements());
        self.rest = rest;
        let Some(gradient) = param.val().grad_remove(self.gradients) else { return };
        match values::<T, D>(gradient) {
            Ok(gradient) => here.iter_mut().zip(gradient).for_each(|(to, g)| *to += g),
            Err(error) => self.outcome = Err(error),
        }
    }
}
