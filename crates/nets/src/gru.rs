//! Gated recurrent units: the net of SNUG and CaPhy.

use crate::layout::{self, MAX_LAYERS, MAX_WIDTH, check_ends, check_size, pair};
use crate::squash::{sigmoid, tanh};
use crate::{dense, initial};
use caphy_core::net::{BackwardBlock, BackwardCall, DeformationNet, ForwardBlock, ForwardCall, NetManifest, NetSpec};
use caphy_core::{Real, Result, simd_kernel};
use serde::{Deserialize, Serialize};
use std::ops::Range;

/// `type = "gru"`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct NetGruSpec {
    /// GRU layers, 1 to 64. 4 as in SNUG, which CaPhy follows.
    pub layers: usize,
    /// Units per layer, 1 to 65536. 256 as in SNUG.
    pub hidden: usize,
}

impl Default for NetGruSpec {
    fn default() -> Self {
        Self { layers: 4, hidden: 256 }
    }
}

#[typetag::serde(name = "gru")]
impl NetSpec for NetGruSpec {
    fn build(&self, inputs: usize, outputs: usize) -> Result<Box<dyn DeformationNet>> {
        Ok(Box::new(NetGru::new(self, inputs, outputs)?))
    }
}

/// `layers` GRU layers of `hidden` units and a linear head without activation.
///
/// Per layer, with PyTorch's gate order r, z, n and its two biases (`nn.GRU`):
///
/// ```text
/// r  = σ(W_ir x + b_ir + W_hr h + b_hr)
/// z  = σ(W_iz x + b_iz + W_hz h + b_hz)
/// n  = tanh(W_in x + b_in + r ⊙ q),  q = W_hn h + b_hn
/// h' = (1 - z) ⊙ n + z ⊙ h
/// ```
///
/// # Tensors
/// For each layer k: `gru.weight_ih_l{k}` `[3·hidden, inputs or hidden]`, `gru.weight_hh_l{k}` `[3·hidden, hidden]`,
/// `gru.bias_ih_l{k}`, `gru.bias_hh_l{k}` `[3·hidden]`; then `head.weight` `[outputs, hidden]`, `head.bias` `[outputs]`.
///
/// # State
/// `[window][layer][unit]`: the hidden values h of every layer.
///
/// # Tape
/// For each layer, `h` `[steps + 1][window][unit]` (first the state before, then after each step), then
/// `[step][window][r | z | n | q]`. Without a tape, the pass allocates one of its own: cut very long passes into parts.
#[derive(Debug, Clone)]
pub struct NetGru {
    manifest: NetManifest,
    layers: usize,
    hidden: usize,
}

/// Where one layer's tensors stand in the flat parameters.
struct Layer {
    inputs: usize,
    weight_ih: Range<usize>,
    weight_hh: Range<usize>,
    bias_ih: Range<usize>,
    bias_hh: Range<usize>,
}

impl NetGru {
    /// A net of these sizes.
    ///
    /// # Errors
    /// [`Error::Config`](caphy_core::Error::Config) for a size of zero or beyond the limits of [`NetGruSpec`].
    pub fn new(spec: &NetGruSpec, inputs: usize, outputs: usize) -> Result<Self> {
        let NetGruSpec { layers, hidden } = *spec;
        check_size("net.layers", layers, MAX_LAYERS)?;
        check_size("net.hidden", hidden, MAX_WIDTH)?;
        check_ends(inputs, outputs)?;
        let mut shapes = Vec::with_capacity(4 * layers + 2);
        for k in 0..layers {
            let width = if k == 0 { inputs } else { hidden };
            shapes.push((format!("gru.weight_ih_l{k}"), vec![3 * hidden, width]));
            shapes.push((format!("gru.weight_hh_l{k}"), vec![3 * hidden, hidden]));
            shapes.push((format!("gru.bias_ih_l{k}"), vec![3 * hidden]));
            shapes.push((format!("gru.bias_hh_l{k}"), vec![3 * hidden]));
        }
        shapes.push(("head.weight".into(), vec![outputs, hidden]));
        shapes.push(("head.bias".into(), vec![outputs]));
        let manifest = NetManifest::new("gru", inputs, outputs, layers * hidden, shapes);
        Ok(Self { manifest, layers, hidden })
    }

    fn layer(&self, k: usize) -> Layer {
        Layer {
            inputs: if k == 0 { self.manifest.inputs } else { self.hidden },
            weight_ih: layout::range(&self.manifest, 4 * k),
            weight_hh: layout::range(&self.manifest, 4 * k + 1),
            bias_ih: layout::range(&self.manifest, 4 * k + 2),
            bias_hh: layout::range(&self.manifest, 4 * k + 3),
        }
    }

    /// The head's weight and bias.
    fn head(&self) -> (Range<usize>, Range<usize>) {
        (layout::range(&self.manifest, 4 * self.layers), layout::range(&self.manifest, 4 * self.layers + 1))
    }

    /// Tape of one layer.
    fn layer_tape(&self, steps: usize, batch: usize) -> usize {
        (steps + 1) * batch * self.hidden + steps * batch * 4 * self.hidden
    }

    fn run_forward<T: Real>(&self, block: &mut ForwardBlock<'_, T>) -> Result<()> {
        let (steps, batch, hidden) = (block.steps, block.batch, self.hidden);
        let tape_len = self.tape_values(steps, batch);
        block.check(&self.manifest, tape_len)?;
        let parameters = block.parameters.or_empty();
        let features = block.features.or_empty();
        let before = block.state_before.get();
        let state = self.manifest.state;
        let (frames, rows) = (steps * batch, batch * hidden);

        let mut own = Vec::new();
        let tape = match block.tape.get() {
            Some(tape) => tape,
            None => {
                own.resize(tape_len, T::zero());
                &mut own[..]
            }
        };
        let mut input_gates = vec![T::zero(); frames * 3 * hidden];
        let mut hidden_gates = vec![T::zero(); batch * 3 * hidden];
        let mut rest = tape;
        let mut below = features;
        for k in 0..self.layers {
            let layer = self.layer(k);
            let (h, after) = rest.split_at_mut((steps + 1) * rows);
            let (gates, after) = after.split_at_mut(frames * 4 * hidden);
            rest = after;
            for window in 0..batch {
                let first = &mut h[window * hidden..(window + 1) * hidden];
                match before {
                    Some(s) => first.copy_from_slice(&s[window * state + k * hidden..][..hidden]),
                    None => first.fill(T::zero()),
                }
            }
            // The input side of all steps at once; only the recurrent side has to wait for the step before.
            dense::forward(&mut input_gates, below, &parameters[layer.weight_ih], &parameters[layer.bias_ih]);
            for step in 0..steps {
                let (past, next) = h[step * rows..(step + 2) * rows].split_at_mut(rows);
                let (weight, bias) = (&parameters[layer.weight_hh.clone()], &parameters[layer.bias_hh.clone()]);
                dense::forward(&mut hidden_gates, past, weight, bias);
                let input_gates = &input_gates[step * 3 * rows..(step + 1) * 3 * rows];
                let gates = &mut gates[step * 4 * rows..(step + 1) * 4 * rows];
                cell_forward(hidden, input_gates, &hidden_gates, past, gates, next);
            }
            if let Some(s) = block.state_after.get() {
                for window in 0..batch {
                    let last = &h[steps * rows + window * hidden..][..hidden];
                    s[window * state + k * hidden..][..hidden].copy_from_slice(last);
                }
            }
            below = &h[rows..];
        }
        let (weight, bias) = self.head();
        if let Some(output) = block.output.get() {
            dense::forward(output, below, &parameters[weight], &parameters[bias]);
        }
        Ok(())
    }

    fn run_backward<T: Real>(&self, block: &mut BackwardBlock<'_, T>) -> Result<()> {
        let (steps, batch, hidden) = (block.steps, block.batch, self.hidden);
        block.check(&self.manifest, self.tape_values(steps, batch))?;
        let parameters = block.parameters.or_empty();
        let features = block.features.or_empty();
        let tape = block.tape.or_empty();
        let output_gradient = block.output_gradient.or_empty();
        let (frames, rows) = (steps * batch, batch * hidden);
        let Some(gradient) = block.parameter_gradient.get() else { return Ok(()) };
        let layer_tape = self.layer_tape(steps, batch);
        let h_len = (steps + 1) * rows;

        // The head.
        let (weight, bias) = self.head();
        let top = &tape[(self.layers - 1) * layer_tape..][..h_len];
        let (dw, db) = pair(gradient, &weight, &bias);
        dense::add_parameter_gradient(dw, db, output_gradient, &top[rows..]);
        let mut dh = vec![T::zero(); frames * hidden];
        dense::input_gradient(&mut dh, output_gradient, &parameters[weight], hidden, false);

        // The layers from the top, each through time from the end.
        let mut input_gates = vec![T::zero(); frames * 3 * hidden];
        let mut hidden_gates = vec![T::zero(); frames * 3 * hidden];
        let mut carried = vec![T::zero(); rows];
        for k in (0..self.layers).rev() {
            let layer = self.layer(k);
            let tape_of = |k: usize| tape[k * layer_tape..(k + 1) * layer_tape].split_at(h_len);
            let (h, gates) = tape_of(k);
            carried.fill(T::zero());
            for step in (0..steps).rev() {
                let d_hidden = &mut hidden_gates[step * 3 * rows..(step + 1) * 3 * rows];
                cell_backward(
                    hidden,
                    &gates[step * 4 * rows..(step + 1) * 4 * rows],
                    &h[step * rows..(step + 1) * rows],
                    &dh[step * rows..(step + 1) * rows],
                    &mut carried,
                    &mut input_gates[step * 3 * rows..(step + 1) * 3 * rows],
                    d_hidden,
                );
                if step > 0 {
                    // The state before the first step is the host's: nobody asks for its gradient.
                    let weight = &parameters[layer.weight_hh.clone()];
                    dense::input_gradient(&mut carried, d_hidden, weight, hidden, true);
                }
            }
            let (dw, db) = pair(gradient, &layer.weight_hh, &layer.bias_hh);
            dense::add_parameter_gradient(dw, db, &hidden_gates, &h[..frames * hidden]);
            let below = if k == 0 { features } else { &tape_of(k - 1).0[rows..] };
            let (dw, db) = pair(gradient, &layer.weight_ih, &layer.bias_ih);
            dense::add_parameter_gradient(dw, db, &input_gates, below);
            let weight = &parameters[layer.weight_ih];
            if k > 0 {
                dense::input_gradient(&mut dh, &input_gates, weight, layer.inputs, false);
            } else if let Some(out) = block.feature_gradient.get() {
                dense::input_gradient(out, &input_gates, weight, layer.inputs, false);
            }
        }
        Ok(())
    }
}

simd_kernel! {
    /// One step of one layer. Shapes: `input_gates`, `hidden_gates` `[window][3·hidden]` with biases, `past`, `next`
    /// `[window][hidden]`, `gates` `[window][r | z | n | q]`.
    fn cell_forward<T>(
        hidden: usize,
        input_gates: &[T],
        hidden_gates: &[T],
        past: &[T],
        gates: &mut [T],
        next: &mut [T],
    ) {
        let rows = input_gates.chunks_exact(3 * hidden).zip(hidden_gates.chunks_exact(3 * hidden));
        let states = past.chunks_exact(hidden).zip(next.chunks_exact_mut(hidden));
        for (((gi, gh), (past, next)), gates) in rows.zip(states).zip(gates.chunks_exact_mut(4 * hidden)) {
            let (r, rest) = gates.split_at_mut(hidden);
            let (z, rest) = rest.split_at_mut(hidden);
            let (n, q) = rest.split_at_mut(hidden);
            for i in 0..hidden {
                r[i] = sigmoid(gi[i] + gh[i]);
            }
            for i in 0..hidden {
                z[i] = sigmoid(gi[hidden + i] + gh[hidden + i]);
            }
            for i in 0..hidden {
                q[i] = gh[2 * hidden + i];
                n[i] = tanh(gi[2 * hidden + i] + r[i] * q[i]);
            }
            for i in 0..hidden {
                next[i] = (T::one() - z[i]) * n[i] + z[i] * past[i];
            }
        }
    }
}

simd_kernel! {
    /// Backward of [`cell_forward`]. `dh` is the gradient by `next` from above, `carried` that from the step after: on
    /// return `carried` holds the direct part of the gradient by `past` (the part through the gates is added by the caller).
    /// `d_input` and `d_hidden` `[window][3·hidden]` get the gradients by the two gate sums.
    fn cell_backward<T>(
        hidden: usize,
        gates: &[T],
        past: &[T],
        dh: &[T],
        carried: &mut [T],
        d_input: &mut [T],
        d_hidden: &mut [T],
    ) {
        let rows = d_input.chunks_exact_mut(3 * hidden).zip(d_hidden.chunks_exact_mut(3 * hidden));
        let states = past.chunks_exact(hidden).zip(carried.chunks_exact_mut(hidden)).zip(dh.chunks_exact(hidden));
        for (((di, dg), ((past, carried), dh)), gates) in rows.zip(states).zip(gates.chunks_exact(4 * hidden)) {
            let (r, rest) = gates.split_at(hidden);
            let (z, rest) = rest.split_at(hidden);
            let (n, q) = rest.split_at(hidden);
            let (dir, rest) = di.split_at_mut(hidden);
            let (diz, din) = rest.split_at_mut(hidden);
            let (dgr, rest) = dg.split_at_mut(hidden);
            let (dgz, dgq) = rest.split_at_mut(hidden);
            for i in 0..hidden {
                let one = T::one();
                let total = dh[i] + carried[i];
                let dn = total * (one - z[i]) * (one - n[i] * n[i]);
                let dz = total * (past[i] - n[i]) * z[i] * (one - z[i]);
                let dr = dn * q[i] * r[i] * (one - r[i]);
                dir[i] = dr;
                diz[i] = dz;
                din[i] = dn;
                dgr[i] = dr;
                dgz[i] = dz;
                dgq[i] = dn * r[i];
                carried[i] = total * z[i];
            }
        }
    }
}

impl NetGru {
    /// Length of the tape.
    fn tape_values(&self, steps: usize, batch: usize) -> usize {
        self.layers * self.layer_tape(steps, batch)
    }
}

impl DeformationNet for NetGru {
    fn manifest(&self) -> &NetManifest {
        &self.manifest
    }
    /// Uniform: what comes from below in ±√(3/width), so that signals keep their size from layer to layer; everything else in
    /// ±1/√hidden, PyTorch's default for `nn.GRU`; zeros in the head.
    ///
    /// Differs from PyTorch, whose ±1/√hidden from below, too, leaves 0.58 of a signal per layer: after four layers a fifth of
    /// the first one's is left, and the head learns from its square.
    fn initialise(&self, seed: u64) -> Result<Vec<f64>> {
        let hidden = 1.0 / (self.hidden as f64).sqrt();
        let mut bounds = Vec::with_capacity(4 * self.layers + 2);
        for k in 0..self.layers {
            let below = (3.0 / self.layer(k).inputs as f64).sqrt();
            bounds.extend([below, hidden, hidden, hidden]);
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
