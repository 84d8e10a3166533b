//! The linear map `y = W x + b` over many frames, and its vector-Jacobian products.
//!
//! A large `W` (the head: one row per garment coordinate) is cut into panels of [`PANEL`] rows that threads share. The
//! cut depends on the sizes alone and partial sums are added in panel order, so the bits do not depend on the threads.

use crate::product::{View, multiply};
use caphy_core::{Real, simd_kernel};
use rayon::prelude::*;

/// Rows of `W` in one task: a panel of 256 columns fills the second cache, and 13 000 rows still feed a dozen threads.
const PANEL: usize = 1024;
/// Frames that are written back together: one cache line of the transposed product.
const FRAMES: usize = 16;

/// `output = input Wᵀ + b`.
///
/// Shapes: `output` `[frames, outputs]`, `input` `[frames, inputs]`, `weight` `[outputs, inputs]`, `bias` `[outputs]`.
pub(crate) fn forward<T: Real>(output: &mut [T], input: &[T], weight: &[T], bias: &[T]) {
    let outputs = bias.len();
    let frames = output.len() / outputs;
    if frames == 0 {
        return;
    }
    let inputs = weight.len() / outputs;
    // The product is made as [outputs, frames]: so `W`, by far the larger factor, is read once, in order, without a
    // packed copy. What is copied back to frame-major order is small.
    let mut columns = vec![T::zero(); outputs * frames];
    let x = View::rows(input, frames, inputs).transposed();
    let panel = |y: &mut [T], w: &[T]| multiply(y, View::rows(w, w.len() / inputs, inputs), x, false);
    if outputs <= PANEL {
        panel(&mut columns, weight);
        output
            .chunks_mut(FRAMES * outputs)
            .enumerate()
            .for_each(|(i, out)| write_back(out, &columns, bias, frames, i * FRAMES));
    } else {
        columns.par_chunks_mut(PANEL * frames).zip(weight.par_chunks(PANEL * inputs)).for_each(|(y, w)| panel(y, w));
        output
            .par_chunks_mut(FRAMES * outputs)
            .enumerate()
            .for_each(|(i, out)| write_back(out, &columns, bias, frames, i * FRAMES));
    }
}

/// Frames `first..` of `columns` `[outputs, frames]` plus the bias, into `out` `[at most FRAMES, outputs]`.
fn write_back<T: Real>(out: &mut [T], columns: &[T], bias: &[T], frames: usize, first: usize) {
    const BLOCK: usize = 16;
    let outputs = bias.len();
    for start in (0..outputs).step_by(BLOCK) {
        let bias = &bias[start..(start + BLOCK).min(outputs)];
        for (f, row) in out.chunks_exact_mut(outputs).enumerate() {
            let values = columns[start * frames + first + f..].iter().step_by(frames);
            for ((y, b), x) in row[start..start + bias.len()].iter_mut().zip(bias).zip(values) {
                *y = *x + *b;
            }
        }
    }
}

/// Adds the gradient of `forward` by `W` and `b`.
///
/// Shapes as in [`forward`]; `gradient` is the gradient by the output.
pub(crate) fn add_parameter_gradient<T: Real>(
    weight_gradient: &mut [T],
    bias_gradient: &mut [T],
    gradient: &[T],
    input: &[T],
) {
    let outputs = bias_gradient.len();
    let frames = gradient.len() / outputs;
    if frames == 0 {
        return;
    }
    let inputs = input.len() / frames;
    let x = View::rows(input, frames, inputs);
    let panel = |index: usize, dw: &mut [T], db: &mut [T]| {
        let first = index * PANEL;
        let dy = View::strided(&gradient[first..], frames, db.len(), outputs);
        multiply(dw, dy.transposed(), x, true);
        for row in gradient.chunks_exact(outputs) {
            add(db, &row[first..first + db.len()]);
        }
    };
    if outputs <= PANEL {
        panel(0, weight_gradient, bias_gradient);
    } else {
        weight_gradient
            .par_chunks_mut(PANEL * inputs)
            .zip(bias_gradient.par_chunks_mut(PANEL))
            .enumerate()
            .for_each(|(i, (dw, db))| panel(i, dw, db));
    }
}

/// `input_gradient = gradient W`, shapes `[frames, inputs]`, `[frames, outputs]`, `[outputs, inputs]`; with `accumulate`
/// the product is added.
pub(crate) fn input_gradient<T: Real>(
    input_gradient: &mut [T],
    gradient: &[T],
    weight: &[T],
    inputs: usize,
    accumulate: bool,
) {
    let frames = input_gradient.len() / inputs;
    let outputs = weight.len() / inputs;
    if frames == 0 {
        return;
    }
    let panel = |index: usize, dx: &mut [T], w: &[T], accumulate: bool| {
        let rows = w.len() / inputs;
        let dy = View::strided(&gradient[index * PANEL..], frames, rows, outputs);
        multiply(dx, dy, View::rows(w, rows, inputs), accumulate);
    };
    if outputs <= PANEL {
        return panel(0, input_gradient, weight, accumulate);
    }
    let parts: Vec<Vec<T>> = weight
        .par_chunks(PANEL * inputs)
        .enumerate()
        .map(|(i, w)| {
            let mut part = vec![T::zero(); frames * inputs];
            panel(i, &mut part, w, false);
            part
        })
        .collect();
    if !accumulate {
        input_gradient.fill(T::zero());
    }
    for part in &parts {
        add(input_gradient, part);
    }
}

simd_kernel! {
    /// `y += x`.
    fn add<T>(y: &mut [T], x: &[T]) {
        for (y, x) in y.iter_mut().zip(x) {
            *y += *x;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Small whole numbers, so that every sum is exact and order cannot hide a mistake.
    fn numbers(n: usize, seed: usize) -> Vec<f32> {
        (0..n).map(|i| ((i * 7 + seed * 5 + i * i % 11) % 9) as f32 - 4.0).collect()
    }

    #[test]
    fn panels_and_plain_loops_agree_exactly() {
        for (frames, inputs, outputs) in [(1, 3, 5), (18, 4, 7), (1, 2, 2500), (17, 3, 2 * PANEL + 13)] {
            let (w, b) = (numbers(outputs * inputs, 1), numbers(outputs, 2));
            let (x, dy) = (numbers(frames * inputs, 3), numbers(frames * outputs, 4));
            let mut y = vec![9.0; frames * outputs];
            forward(&mut y, &x, &w, &b);
            let (mut dw, mut db) = (vec![1.0; w.len()], vec![2.0; b.len()]);
            add_parameter_gradient(&mut dw, &mut db, &dy, &x);
            let mut dx = vec![3.0; x.len()];
            input_gradient(&mut dx, &dy, &w, inputs, true);
            let mut fresh = vec![3.0; x.len()];
            input_gradient(&mut fresh, &dy, &w, inputs, false);
            for o in 0..outputs {
                for f in 0..frames {
                    let sum: f32 = (0..inputs).map(|i| w[o * inputs + i] * x[f * inputs + i]).sum();
                    assert_eq!(y[f * outputs + o], sum + b[o]);
                }
                for i in 0..inputs {
                    let sum: f32 = (0..frames).map(|f| dy[f * outputs + o] * x[f * inputs + i]).sum();
                    assert_eq!(dw[o * inputs + i], sum + 1.0);
                }
                assert_eq!(db[o], 2.0 + (0..frames).map(|f| dy[f * outputs + o]).sum::<f32>());
            }
            for f in 0..frames {
                for i in 0..inputs {
                    let sum: f32 = (0..outputs).map(|o| dy[f * outputs + o] * w[o * inputs + i]).sum();
                    assert_eq!((dx[f * inputs + i], fresh[f * inputs + i]), (sum + 3.0, sum));
                }
            }
        }
    }
}
