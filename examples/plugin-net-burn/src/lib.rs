//! `type = "tcn"`: a temporal convolution with layer normalisation, written in Burn, as a plugin library.
//!
//! ```text
//! h      = W x + b                                       every frame by itself
//! u      = LayerNorm(h),   h ← h + GELU(conv(u, past))   `layers` times, causal over `kernel` frames
//! output = W LayerNorm(h) + b
//! ```
//!
//! What it remembers is finite: an output depends on its own frame and the `layers (kernel - 1)` frames before it, and on
//! nothing older. With the defaults that is a training window of five, so that a long clip never leaves what training saw.
//!
//! This file has no derivative in it: the network is a Burn module, its gradients are Burn's. `bridge.rs` makes a
//! `DeformationNet` of any such module, and is what to copy for another one.

mod bridge;

use bridge::{NetBurn, WindowModule};
use burn::module::Module;
use burn::nn::conv::{Conv1d, Conv1dConfig};
use burn::nn::{Initializer, LayerNorm, LayerNormConfig, Linear, LinearConfig};
use burn::tensor::activation::gelu;
use burn::tensor::{Device, Tensor};
use caphy_core::net::{DeformationNet, NetSpec};
use caphy_core::{Error, Result};
use serde::{Deserialize, Serialize};

/// The keys of `type = "tcn"`.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct NetTcnSpec {
    /// Convolutions over time, 1 to 64. Default 2.
    layers: usize,
    /// Channels, 1 to 65536. Default 256, as wide as the GRU of SNUG.
    hidden: usize,
    /// Frames that one convolution sees, 2 to 64. Default 3.
    kernel: usize,
}

impl Default for NetTcnSpec {
    fn default() -> Self {
        Self { layers: 2, hidden: 256, kernel: 3 }
    }
}

#[typetag::serde(name = "tcn")]
impl NetSpec for NetTcnSpec {
    fn build(&self, inputs: usize, outputs: usize) -> Result<Box<dyn DeformationNet>> {
        let sizes = [
            ("net.layers", self.layers, 1, 64),
            ("net.hidden", self.hidden, 1, 65_536),
            ("net.kernel", self.kernel, 2, 64),
        ];
        for (key, value, least, most) in sizes {
            if !(least..=most).contains(&value) {
                let remedy = format!("give a number from {least} to {most}");
                return Err(Error::config(key, format!("{value} is not a usable size"), remedy));
            }
        }
        if inputs == 0 || outputs == 0 {
            let problem = format!("the net would have {inputs} inputs and {outputs} outputs");
            return Err(Error::config("net", problem, "a net needs at least one pose feature and one garment vertex"));
        }
        let spec = self.clone();
        let state = spec.layers * spec.hidden * (spec.kernel - 1);
        Ok(Box::new(NetBurn::new("tcn", inputs, outputs, state, move |device| {
            Tcn::new(&spec, inputs, outputs, device)
        })))
    }
}

/// The network.
#[derive(Module, Debug)]
struct Tcn {
    embed: Linear,
    blocks: Vec<Block>,
    norm: LayerNorm,
    head: Linear,
}

/// One convolution over time.
#[derive(Module, Debug)]
struct Block {
    norm: LayerNorm,
    conv: Conv1d,
}

impl Tcn {
    fn new(spec: &NetTcnSpec, inputs: usize, outputs: usize, device: &Device) -> Self {
        let hidden = spec.hidden;
        let block = |_| Block {
            norm: LayerNormConfig::new(hidden).init(device),
            conv: Conv1dConfig::new(hidden, hidden, spec.kernel).init(device),
        };
        Self {
            embed: LinearConfig::new(inputs, hidden).init(device),
            blocks: (0..spec.layers).map(block).collect(),
            norm: LayerNormConfig::new(hidden).init(device),
            // Zeros: training starts from the skinned template.
            head: LinearConfig::new(hidden, outputs).with_initializer(Initializer::Zeros).init(device),
        }
    }
}

impl WindowModule for Tcn {
    /// State: for each layer, the normalised values of the last `kernel - 1` frames, `[window][layer][channel][frame]`.
    fn forward(&self, features: Tensor<3>, state: Tensor<2>) -> (Tensor<3>, Tensor<2>) {
        let [steps, windows, _] = features.dims();
        let mut h = self.embed.forward(features);
        let hidden = h.dims()[2];
        let mut after = Vec::with_capacity(self.blocks.len());
        for (k, block) in self.blocks.iter().enumerate() {
            let past = block.conv.kernel_size - 1;
            let memory = hidden * past;
            let before = state.clone().slice([0..windows, k * memory..(k + 1) * memory]);
            // A convolution wants [window, channel, frame]; with the frames before in front it needs no padding.
            let u = block.norm.forward(h.clone()).permute([1, 2, 0]);
            let u = Tensor::cat(vec![before.reshape([windows, hidden, past]), u], 2);
            let last = u.clone().slice([0..windows, 0..hidden, steps..steps + past]);
            after.push(last.reshape([windows, memory]));
            h = h + gelu(block.conv.forward(u)).permute([2, 0, 1]);
        }
        (self.head.forward(self.norm.forward(h)), Tensor::cat(after, 1))
    }
}

caphy_core::export_plugin! { materials: [], nets: ["tcn"] }
