//! `type = "linear"`: displacements linear in the pose features, with a memory that fades, as a plugin library.
//!
//! h ← fade h + features, output = W h + b. With `fade = 0` it is linear regression: a baseline that any net should beat.

use caphy_core::net::{BackwardBlock, BackwardCall, DeformationNet, ForwardBlock, ForwardCall, NetManifest, NetSpec};
use caphy_core::{Error, Real, Result};
use serde::{Deserialize, Serialize};

/// The keys of `type = "linear"`.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct NetLinearSpec {
    /// Share of the memory that stays from frame to frame, in [0, 1). Default 0.5.
    fade: f64,
}

impl Default for NetLinearSpec {
    fn default() -> Self {
        Self { fade: 0.5 }
    }
}

#[typetag::serde(name = "linear")]
impl NetSpec for NetLinearSpec {
    fn build(&self, inputs: usize, outputs: usize) -> Result<Box<dyn DeformationNet>> {
        if !(0.0..1.0).contains(&self.fade) {
            return Err(Error::config("net.fade", format!("{}", self.fade), "give a share in [0, 1)"));
        }
        let shapes = vec![("weight".to_string(), vec![outputs, inputs]), ("bias".to_string(), vec![outputs])];
        let manifest = NetManifest::new("linear", inputs, outputs, inputs, shapes);
        Ok(Box::new(NetLinear { manifest, fade: self.fade }))
    }
}

struct NetLinear {
    manifest: NetManifest,
    fade: f64,
}

impl NetLinear {
    /// The memory h of every frame.
    fn tape(&self, steps: usize, batch: usize) -> usize {
        steps * batch * self.manifest.inputs
    }

    fn run_forward<T: Real>(&self, block: &mut ForwardBlock<'_, T>) -> Result<()> {
        let (steps, batch) = (block.steps, block.batch);
        block.check(&self.manifest, self.tape(steps, batch))?;
        let (inputs, outputs) = (self.manifest.inputs, self.manifest.outputs);
        let (weight, bias) = block.parameters.or_empty().split_at(outputs * inputs);
        let features = block.features.or_empty();
        let mut memory = block.state_before.get().map_or_else(|| vec![T::zero(); batch * inputs], <[T]>::to_vec);
        for step in 0..steps {
            let rows = step * batch * inputs..(step + 1) * batch * inputs;
            for (h, f) in memory.iter_mut().zip(&features[rows.clone()]) {
                *h = T::of(self.fade) * *h + *f;
            }
            if let Some(tape) = block.tape.get() {
                tape[rows].copy_from_slice(&memory);
            }
            if let Some(out) = block.output.get() {
                for b in 0..batch {
                    let h = &memory[b * inputs..(b + 1) * inputs];
                    for o in 0..outputs {
                        let row = &weight[o * inputs..(o + 1) * inputs];
                        let sum: T = row.iter().zip(h).map(|(w, h)| *w * *h).sum();
                        out[(step * batch + b) * outputs + o] = sum + bias[o];
                    }
                }
            }
        }
        if let Some(after) = block.state_after.get() {
            after.copy_from_slice(&memory);
        }
        Ok(())
    }

    fn run_backward<T: Real>(&self, block: &mut BackwardBlock<'_, T>) -> Result<()> {
        let (steps, batch) = (block.steps, block.batch);
        block.check(&self.manifest, self.tape(steps, batch))?;
        let (inputs, outputs) = (self.manifest.inputs, self.manifest.outputs);
        let weight = &block.parameters.or_empty()[..outputs * inputs];
        let (tape, upstream) = (block.tape.or_empty(), block.output_gradient.or_empty());
        if let Some(gradient) = block.parameter_gradient.get() {
            let (by_weight, by_bias) = gradient.split_at_mut(outputs * inputs);
            for row in 0..steps * batch {
                let h = &tape[row * inputs..(row + 1) * inputs];
                for o in 0..outputs {
                    let up = upstream[row * outputs + o];
                    by_bias[o] += up;
                    for (g, h) in by_weight[o * inputs..(o + 1) * inputs].iter_mut().zip(h) {
                        *g += up * *h;
                    }
                }
            }
        }
        if let Some(by_feature) = block.feature_gradient.get() {
            // Backwards in time: a feature acts on its own frame and, faded, on all that follow.
            let mut carried = vec![T::zero(); batch * inputs];
            for step in (0..steps).rev() {
                for b in 0..batch {
                    let row = step * batch + b;
                    for i in 0..inputs {
                        let here: T = (0..outputs).map(|o| upstream[row * outputs + o] * weight[o * inputs + i]).sum();
                        let sum = here + T::of(self.fade) * carried[b * inputs + i];
                        carried[b * inputs + i] = sum;
                        by_feature[row * inputs + i] = sum;
                    }
                }
            }
        }
        Ok(())
    }
}

impl DeformationNet for NetLinear {
    fn manifest(&self) -> &NetManifest {
        &self.manifest
    }
    /// Zeros: training starts from the skinned template, whatever the seed.
    fn initialise(&self, _seed: u64) -> Result<Vec<f64>> {
        Ok(vec![0.0; self.manifest.parameter_count()])
    }
    fn tape_len(&self, steps: usize, batch: usize) -> Result<usize> {
        Ok(self.tape(steps, batch))
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

caphy_core::export_plugin! { materials: [], nets: ["linear"] }
