//! Adam on flat vectors: the optimiser of every net, in one pass over memory.

use caphy_core::{Error, Result, simd_kernel};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Values in one task and one partial sum of the norm. The cut depends on the length alone, so the bits do not depend on
/// the threads.
const CHUNK: usize = 1 << 16;

/// Adam (Kingma and Ba 2015, Algorithm 1) with clipping by the global norm.
///
/// Holds the settings and the count of steps; parameters, gradient and both moments belong to the host, so that a
/// checkpoint is these flat vectors and this small struct.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Adam {
    /// Step size α; the host may change it between steps (a schedule).
    pub learning_rate: f32,
    /// Decay β₁ of the first moment.
    pub beta1: f32,
    /// Decay β₂ of the second moment.
    pub beta2: f32,
    /// ε beside the root of the second moment: keeps the quotient finite.
    pub epsilon: f32,
    /// Steps made so far, for the bias correction.
    pub step: u64,
}

impl Default for Adam {
    /// The article's settings.
    fn default() -> Self {
        Self { learning_rate: 1e-3, beta1: 0.9, beta2: 0.999, epsilon: 1e-8, step: 0 }
    }
}

impl Adam {
    /// One step: scales the gradient to a norm of at most `clip_norm` (if given), updates both moments and the
    /// parameters, and *leaves the gradient at zero*, ready for the next pass to add to. Returns the norm before clipping.
    ///
    /// All slices are `[parameter_count]`; the moments start at zero. As `torch.optim.Adam` after
    /// `torch.nn.utils.clip_grad_norm_`, whose divisor has the same 1e-6 added to the norm.
    ///
    /// # Errors
    /// [`Error::Length`] for unequal lengths; [`Error::NonFinite`] for a gradient that is not finite (nothing is changed
    /// then); [`Error::Config`] for settings outside their ranges.
    pub fn step(
        &mut self,
        clip_norm: Option<f32>,
        parameters: &mut [f32],
        gradient: &mut [f32],
        first_moment: &mut [f32],
        second_moment: &mut [f32],
    ) -> Result<f64> {
        let n = parameters.len();
        Error::check_length("Adam gradient", n, gradient.len())?;
        Error::check_length("Adam first moment", n, first_moment.len())?;
        Error::check_length("Adam second moment", n, second_moment.len())?;
        self.check(clip_norm)?;
        let norm = global_norm(gradient);
        if !norm.is_finite() {
            Error::check_finite("Adam gradient", gradient)?;
        }
        let scale = match clip_norm {
            Some(limit) if norm > f64::from(limit) => f64::from(limit) / (norm + 1e-6),
            _ => 1.0,
        };
        self.step += 1;
        // Both corrections of the bias towards the zero start, folded into the step size and ε.
        let t = self.step.min(i32::MAX as u64) as i32;
        let root = (1.0 - f64::from(self.beta2).powi(t)).sqrt();
        let rate = f64::from(self.learning_rate) * root / (1.0 - f64::from(self.beta1).powi(t));
        let epsilon = f64::from(self.epsilon) * root;
        let (beta1, beta2) = (self.beta1, self.beta2);
        let (scale, rate, epsilon) = (scale as f32, rate as f32, epsilon as f32);
        parameters
            .par_chunks_mut(CHUNK)
            .zip(gradient.par_chunks_mut(CHUNK))
            .zip(first_moment.par_chunks_mut(CHUNK).zip(second_moment.par_chunks_mut(CHUNK)))
            .for_each(|((p, g), (m, v))| update(scale, beta1, beta2, rate, epsilon, p, g, m, v));
        Ok(norm)
    }

    fn check(&self, clip_norm: Option<f32>) -> Result<()> {
        let positive = |x: f32| x.is_finite() && x > 0.0;
        let decay = |x: f32| (0.0..1.0).contains(&x);
        let rules = [
            ("learning_rate", self.learning_rate, positive(self.learning_rate), "give a positive number such as 1e-3"),
            ("beta1", self.beta1, decay(self.beta1), "give a number in [0, 1) such as 0.9"),
            ("beta2", self.beta2, decay(self.beta2), "give a number in [0, 1) such as 0.999"),
            ("epsilon", self.epsilon, positive(self.epsilon), "give a positive number such as 1e-8"),
            ("clip_norm", clip_norm.unwrap_or(1.0), clip_norm.is_none_or(positive), "give a positive number or none"),
        ];
        match rules.iter().find(|(_, _, holds, _)| !holds) {
            None => Ok(()),
            Some((key, value, _, remedy)) => {
                Err(Error::config(*key, format!("{value} cannot be used by Adam"), *remedy))
            }
        }
    }
}

/// Euclidean norm of a gradient: squares are summed in double precision, in an order that depends on the length alone.
pub fn global_norm(gradient: &[f32]) -> f64 {
    let parts: Vec<f64> = gradient.par_chunks(CHUNK).map(sum_of_squares::<f32>).collect();
    parts.iter().sum::<f64>().sqrt()
}

simd_kernel! {
    /// Σ x², in 16 fixed lanes.
    fn sum_of_squares<T>(x: &[T]) -> f64 {
        let mut lanes = [0.0f64; 16];
        let blocks = x.chunks_exact(16);
        let rest = blocks.remainder();
        for block in blocks {
            for (lane, x) in lanes.iter_mut().zip(block) {
                let x = (*x).to_f64();
                *lane += x * x;
            }
        }
        for (lane, x) in lanes.iter_mut().zip(rest) {
            let x = (*x).to_f64();
            *lane += x * x;
        }
        let mut sum = 0.0;
        for lane in lanes {
            sum += lane;
        }
        sum
    }
}

simd_kernel! {
    /// m = β₁ m + (1 - β₁) g; v = β₂ v + (1 - β₂) g²; p -= α m / (√v + ε); g = 0.
    fn update<T>(
        scale: T,
        beta1: T,
        beta2: T,
        rate: T,
        epsilon: T,
        parameters: &mut [T],
        gradient: &mut [T],
        first: &mut [T],
        second: &mut [T],
    ) {
        let (rest1, rest2) = (T::one() - beta1, T::one() - beta2);
        for (((p, g), m), v) in parameters.iter_mut().zip(gradient).zip(first).zip(second) {
            let slope = *g * scale;
            *m = beta1 * *m + rest1 * slope;
            *v = beta2 * *v + rest2 * (slope * slope);
            *p -= rate * *m / (v.sqrt() + epsilon);
            *g = T::zero();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_step_has_the_length_of_the_learning_rate() {
        let mut adam = Adam { learning_rate: 0.01, ..Adam::default() };
        let (mut p, mut g) = ([1.0f32, 1.0, 1.0], [3.0f32, -4.0, 0.0]);
        let (mut m, mut v) = ([0.0; 3], [0.0; 3]);
        let norm = adam.step(None, &mut p, &mut g, &mut m, &mut v).unwrap();
        assert_eq!((norm, adam.step, g), (5.0, 1, [0.0; 3]));
        for (p, want) in p.iter().zip([0.99, 1.01, 1.0]) {
            assert!((p - want).abs() < 1e-6, "{p} {want}");
        }
    }

    #[test]
    fn clipping_scales_the_moments_and_not_the_reported_norm() {
        let (mut p, mut g, mut m, mut v) = ([0.0f32; 2], [3.0f32, -4.0], [0.0; 2], [0.0; 2]);
        assert_eq!(Adam::default().step(Some(1.0), &mut p, &mut g, &mut m, &mut v).unwrap(), 5.0);
        assert!((m[0] - 0.1 * 0.6).abs() < 1e-6 && (m[1] + 0.1 * 0.8).abs() < 1e-6);
    }

    #[test]
    fn bad_input_is_named_and_changes_nothing() {
        let mut adam = Adam::default();
        let (mut p, mut m, mut v) = ([1.0f32; 2], [0.5f32; 2], [0.5f32; 2]);
        let error = adam.step(None, &mut p, &mut [0.0], &mut m, &mut v).unwrap_err();
        assert!(matches!(error, Error::Length { expected: 2, got: 1, .. }));
        let error = adam.step(None, &mut p, &mut [0.0, f32::NAN], &mut m, &mut v).unwrap_err();
        assert!(matches!(error, Error::NonFinite { index: 1, .. }));
        let error = adam.step(Some(0.0), &mut p, &mut [0.0; 2], &mut m, &mut v).unwrap_err();
        assert!(matches!(error, Error::Config { ref key, .. } if key == "clip_norm"));
        adam.beta2 = 1.0;
        let error = adam.step(None, &mut p, &mut [0.0; 2], &mut m, &mut v).unwrap_err();
        assert!(matches!(error, Error::Config { ref key, .. } if key == "beta2"));
        assert_eq!((p, m, v, adam.step), ([1.0; 2], [0.5; 2], [0.5; 2], 0));
    }

    #[test]
    fn bits_do_not_depend_on_the_threads() {
        let n = 3 * CHUNK + 5;
        let run = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let mut p = vec![0.5f32; n];
            let mut g: Vec<f32> = (0..n).map(|i| (i as f32 * 0.37).sin()).collect();
            let (mut m, mut v) = (vec![0.0; n], vec![0.0; n]);
            let norm = pool.install(|| Adam::default().step(Some(1.0), &mut p, &mut g, &mut m, &mut v)).unwrap();
            (norm, p, m, v)
        };
        assert_eq!(run(1), run(2));
    }
}
