//! [`DeformationNet`]: pose features in, canonical garment displacements out.

use crate::array::{In, Out};
use crate::{Error, Real, Result};
use serde::{Deserialize, Serialize};

/// One tensor inside the flat parameter vector.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Tensor {
    /// Name as in PyTorch's state dict, e.g. `gru.weight_ih_l0`.
    pub name: String,
    /// Row-major shape.
    pub shape: Vec<usize>,
    /// First element in the flat vector.
    pub offset: usize,
}

impl Tensor {
    /// Number of elements.
    pub fn len(&self) -> usize {
        self.shape.iter().product()
    }
    /// Whether the tensor has no elements.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

/// Sizes and parameter layout of a net.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct NetManifest {
    /// The `type` name in TOML.
    pub name: String,
    /// Features per frame.
    pub inputs: usize,
    /// Outputs per frame (3 per garment vertex).
    pub outputs: usize,
    /// Values of carried state per window; 0 for a net without memory.
    pub state: usize,
    /// Tensors, dense and in order: they cover the flat parameter vector without gaps.
    pub tensors: Vec<Tensor>,
}

impl NetManifest {
    /// Lays out tensors one after the other.
    pub fn new(name: &str, inputs: usize, outputs: usize, state: usize, shapes: Vec<(String, Vec<usize>)>) -> Self {
        let mut offset = 0;
        let tensors = shapes
            .into_iter()
            .map(|(name, shape)| {
                let tensor = Tensor { name, shape, offset };
                offset += tensor.len();
                tensor
            })
            .collect();
        Self { name: name.into(), inputs, outputs, state, tensors }
    }
    /// Length of the flat parameter vector.
    pub fn parameter_count(&self) -> usize {
        self.tensors.iter().map(Tensor::len).sum()
    }
    /// A tensor by name.
    pub fn tensor(&self, name: &str) -> Option<&Tensor> {
        self.tensors.iter().find(|t| t.name == name)
    }
}

/// A forward pass over `steps` consecutive frames of `batch` independent windows.
#[repr(C)]
pub struct ForwardBlock<'a, T> {
    /// Consecutive frames per window.
    pub steps: usize,
    /// Windows.
    pub batch: usize,
    /// Flat parameters, owned by the host.
    pub parameters: In<'a, T>,
    /// Pose features, `[step][window][input]`.
    pub features: In<'a, T>,
    /// Carried state before the first step, `[window][state]`; absent means zeros.
    pub state_before: In<'a, T>,
    /// Canonical displacements dV [m], `[step][window][output]`; absent where only the state is wanted.
    pub output: Out<'a, T>,
    /// Carried state after the last step, `[window][state]`.
    pub state_after: Out<'a, T>,
    /// What the backward pass needs, of [`DeformationNet::tape_len`]; absent in inference.
    pub tape: Out<'a, T>,
}

/// A backward pass over the tape of a forward pass.
#[repr(C)]
pub struct BackwardBlock<'a, T> {
    /// As in the forward pass.
    pub steps: usize,
    /// As in the forward pass.
    pub batch: usize,
    /// As in the forward pass.
    pub parameters: In<'a, T>,
    /// As in the forward pass.
    pub features: In<'a, T>,
    /// As in the forward pass.
    pub state_before: In<'a, T>,
    /// The tape that the forward pass wrote.
    pub tape: In<'a, T>,
    /// Gradient of the loss by the output, `[step][window][output]`.
    pub output_gradient: In<'a, T>,
    /// Gradient by the parameters: *added to*.
    pub parameter_gradient: Out<'a, T>,
    /// Gradient by the features, `[step][window][input]`: overwritten.
    pub feature_gradient: Out<'a, T>,
}

impl<T: Real> ForwardBlock<'_, T> {
    /// `Ok` when every array has its length.
    pub fn check(&self, manifest: &NetManifest, tape_len: usize) -> Result<()> {
        let frames = self.steps * self.batch;
        let state = self.batch * manifest.state;
        let parameters = manifest.parameter_count();
        Error::check_length("net parameters", parameters, self.parameters.or_empty().len())?;
        Error::check_length("net features", frames * manifest.inputs, self.features.or_empty().len())?;
        if let Some(s) = self.state_before.get() {
            Error::check_length("net state before", state, s.len())?;
        }
        if self.output.wanted() {
            Error::check_length("net output", frames * manifest.outputs, self.output.len())?;
        }
        if self.state_after.wanted() {
            Error::check_length("net state after", state, self.state_after.len())?;
        }
        if self.tape.wanted() {
            Error::check_length("net tape", tape_len, self.tape.len())?;
        }
        Ok(())
    }
}

impl<T: Real> BackwardBlock<'_, T> {
    /// `Ok` when every array has its length.
    pub fn check(&self, manifest: &NetManifest, tape_len: usize) -> Result<()> {
        let frames = self.steps * self.batch;
        let parameters = manifest.parameter_count();
        Error::check_length("net parameters", parameters, self.parameters.or_empty().len())?;
        Error::check_length("net features", frames * manifest.inputs, self.features.or_empty().len())?;
        if let Some(s) = self.state_before.get() {
            Error::check_length("net state before", self.batch * manifest.state, s.len())?;
        }
        Error::check_length("net tape", tape_len, self.tape.or_empty().len())?;
        Error::check_length("net output gradient", frames * manifest.outputs, self.output_gradient.or_empty().len())?;
        Error::check_length("net parameter gradient", parameters, self.parameter_gradient.len())?;
        if self.feature_gradient.wanted() {
            let n = frames * manifest.inputs;
            Error::check_length("net feature gradient", n, self.feature_gradient.len())?;
        }
        Ok(())
    }
}

/// A forward pass in one of the two precisions.
#[repr(C)]
pub enum ForwardCall<'b, 'a> {
    /// Single precision.
    F32(&'b mut ForwardBlock<'a, f32>),
    /// Double precision.
    F64(&'b mut ForwardBlock<'a, f64>),
}

/// A backward pass in one of the two precisions.
#[repr(C)]
pub enum BackwardCall<'b, 'a> {
    /// Single precision.
    F32(&'b mut BackwardBlock<'a, f32>),
    /// Double precision.
    F64(&'b mut BackwardBlock<'a, f64>),
}

/// A [`Real`] that knows its variant of the calls, so that generic callers can run a net.
pub trait NetReal: Real {
    /// Forward pass in this precision.
    fn forward(net: &dyn DeformationNet, block: &mut ForwardBlock<'_, Self>) -> Result<()>;
    /// Backward pass in this precision.
    fn backward(net: &dyn DeformationNet, block: &mut BackwardBlock<'_, Self>) -> Result<()>;
}
impl NetReal for f32 {
    fn forward(net: &dyn DeformationNet, block: &mut ForwardBlock<'_, Self>) -> Result<()> {
        net.forward(ForwardCall::F32(block))
    }
    fn backward(net: &dyn DeformationNet, block: &mut BackwardBlock<'_, Self>) -> Result<()> {
        net.backward(BackwardCall::F32(block))
    }
}
impl NetReal for f64 {
    fn forward(net: &dyn DeformationNet, block: &mut ForwardBlock<'_, Self>) -> Result<()> {
        net.forward(ForwardCall::F64(block))
    }
    fn backward(net: &dyn DeformationNet, block: &mut BackwardBlock<'_, Self>) -> Result<()> {
        net.backward(BackwardCall::F64(block))
    }
}

/// What a net answers beyond a single-precision pass; asking for the rest is [`Error::Unsupported`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct NetOffers {
    /// Passes in double precision.
    pub double: bool,
    /// [`BackwardBlock::feature_gradient`].
    pub feature_gradient: bool,
}

impl NetOffers {
    /// Everything.
    pub const ALL: Self = Self { double: true, feature_gradient: true };
}

/// dV(θ) of Eq. 2: a function of pose features with carried state.
///
/// # Promise
/// Pure: parameters, state and tape belong to the host, the net holds sizes only. Equal inputs give equal bits whatever
/// the thread count. A forward pass over a whole window equals passes over its parts with the state carried. A net knows
/// nothing of energies, bodies or frameworks.
///
/// # Shapes and units
/// As in [`ForwardBlock`] and [`BackwardBlock`]; outputs in metres in canonical (T-pose) space.
///
/// # Errors
/// [`Error::Length`] for wrong sizes, [`Error::Unsupported`] for a precision that is not offered.
pub trait DeformationNet: Send + Sync {
    /// Sizes and parameter layout.
    fn manifest(&self) -> &NetManifest;
    /// Which optional passes are answered. Default: all.
    fn offers(&self) -> NetOffers {
        NetOffers::ALL
    }
    /// First values of the flat parameters from a seed. The last layer is zero, so that training starts from the skinned
    /// template.
    fn initialise(&self, seed: u64) -> Result<Vec<f64>>;
    /// Length of the tape for a pass of this size.
    fn tape_len(&self, steps: usize, batch: usize) -> Result<usize>;
    /// Runs the net.
    fn forward(&self, call: ForwardCall<'_, '_>) -> Result<()>;
    /// Vector-Jacobian product of the last forward pass.
    fn backward(&self, call: BackwardCall<'_, '_>) -> Result<()>;
}

/// The `[net]` table of a configuration.
#[typetag::serde(tag = "type")]
pub trait NetSpec: std::fmt::Debug + Send + Sync {
    /// Checks the keys and makes a net of these sizes.
    fn build(&self, inputs: usize, outputs: usize) -> Result<Box<dyn DeformationNet>>;
}
