//! Faulty nets around a correct one: a linear recurrence, s ← a s + W f, out = V s + c.

use super::table::{TABLE, read, write};
use caphy_core::conformance::net::{CHECKS, NetSubject};
use caphy_core::net::{BackwardBlock, BackwardCall, DeformationNet, ForwardBlock, ForwardCall, NetManifest, NetOffers};
use caphy_core::{Error, Real, Result};
use std::thread::ThreadId;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Fault {
    None,
    NothingOptional,
    OtherName,
    AnotherTableWrittenBack,
    UnknownKeysTaken,
    OtherSizes,
    TensorsOfOneName,
    SeedIgnored,
    HeadNotZero,
    StateForgotten,
    AbsentStateIsOnes,
    StateOnlyWithOutput,
    BatchMatters,
    GradientHalved,
    FeatureGradientHalved,
    SpareParameters,
    GradientOverwritten,
    SingleIsAnother,
    NoChecks,
    OverflowsEarly,
    HidesNoNumber,
    ThreadMatters,
    AnswersWhatItDoesNotOffer,
}

const STATE: usize = 4;

struct Recurrence {
    manifest: NetManifest,
    fault: Fault,
    made_on: ThreadId,
    size: f64,
}

impl Recurrence {
    fn is(&self, fault: Fault) -> bool {
        self.fault == fault
    }
    fn tape(&self, steps: usize, batch: usize) -> usize {
        steps * batch * STATE
    }
    /// Offsets of a, W, V, c.
    fn parts(&self) -> [usize; 4] {
        let (i, o) = (self.manifest.inputs, self.manifest.outputs);
        [0, STATE, STATE + STATE * i, STATE + STATE * i + STATE * o]
    }
    fn before<T: Real>(&self, given: Option<&[T]>, batch: usize) -> Vec<T> {
        match given {
            Some(state) if !self.is(Fault::StateForgotten) => state.to_vec(),
            None if self.is(Fault::AbsentStateIsOnes) => vec![T::one(); batch * STATE],
            _ => vec![T::zero(); batch * STATE],
        }
    }

    fn forward_in<T: Real>(&self, block: &mut ForwardBlock<'_, T>) -> Result<()> {
        let (steps, batch) = (block.steps, block.batch);
        if !self.is(Fault::NoChecks) {
            block.check(&self.manifest, self.tape(steps, batch))?;
        }
        let ([a, w, v, c], (inputs, outputs)) = (self.parts(), (self.manifest.inputs, self.manifest.outputs));
        let (p, features) = (block.parameters.or_empty(), block.features.or_empty());
        let mut state = self.before(block.state_before.get(), batch);
        let mut tape = Vec::new();
        let mut factor = self.size;
        factor *= if self.is(Fault::SingleIsAnother) && size_of::<T>() == 4 { 1.01 } else { 1.0 };
        let elsewhere = self.is(Fault::ThreadMatters) && std::thread::current().id() != self.made_on;
        factor *= if elsewhere { 1.0 + 1e-5 } else { 1.0 };
        let offset = if self.is(Fault::BatchMatters) && batch == 4 { T::of(1e-2) } else { T::zero() };
        for step in 0..steps {
            for b in 0..batch {
                for k in 0..STATE {
                    let mut s = p[a + k] * state[b * STATE + k];
                    for i in 0..inputs {
                        s += p[w + k * inputs + i] * features[(step * batch + b) * inputs + i];
                    }
                    if self.is(Fault::OverflowsEarly) && s.abs() > T::of(1e3) {
                        s = T::infinity();
                    }
                    if self.is(Fault::HidesNoNumber) && s.is_nan() {
                        s = T::zero();
                    }
                    state[b * STATE + k] = s;
                }
                for o in 0..outputs {
                    let sum: T = (0..STATE).map(|k| p[v + o * STATE + k] * state[b * STATE + k]).sum();
                    if let Some(out) = block.output.get() {
                        out[(step * batch + b) * outputs + o] = T::of(factor) * (sum + p[c + o]) + offset;
                    }
                }
            }
            tape.extend_from_slice(&state);
        }
        if let Some(out) = block.tape.get() {
            out.copy_from_slice(&tape);
        }
        let kept = self.is(Fault::StateOnlyWithOutput) && !block.output.wanted();
        if let Some(out) = block.state_after.get().filter(|_| !kept) {
            out.copy_from_slice(&state);
        }
        Ok(())
    }

    fn backward_in<T: Real>(&self, block: &mut BackwardBlock<'_, T>) -> Result<()> {
        let (steps, batch) = (block.steps, block.batch);
        if !self.is(Fault::NoChecks) {
            block.check(&self.manifest, self.tape(steps, batch))?;
        }
        if self.is(Fault::NothingOptional) && block.feature_gradient.wanted() {
            return Err(Error::unsupported("the gradient by the features", "small"));
        }
        let ([a, w, v, c], (inputs, outputs)) = (self.parts(), (self.manifest.inputs, self.manifest.outputs));
        let (p, features, tape) = (block.parameters.or_empty(), block.features.or_empty(), block.tape.or_empty());
        let (upstream, before) = (block.output_gradient.or_empty(), self.before(block.state_before.get(), batch));
        let mut g = vec![T::zero(); p.len()];
        let mut by_feature = vec![T::zero(); features.len()];
        let size = T::of(self.size);
        for b in 0..batch {
            let mut carried = [T::zero(); STATE];
            for step in (0..steps).rev() {
                let row = step * batch + b;
                for k in 0..STATE {
                    for o in 0..outputs {
                        let up = size * upstream[row * outputs + o];
                        g[v + o * STATE + k] += up * tape[row * STATE + k];
                        carried[k] += up * p[v + o * STATE + k];
                    }
                    let earlier = if step == 0 { before[b * STATE + k] } else { tape[(row - batch) * STATE + k] };
                    g[a + k] += carried[k] * earlier;
                    for i in 0..inputs {
                        g[w + k * inputs + i] += carried[k] * features[row * inputs + i];
                        by_feature[row * inputs + i] += carried[k] * p[w + k * inputs + i];
                    }
                    carried[k] *= p[a + k];
                }
                for o in 0..outputs {
                    g[c + o] += size * upstream[row * outputs + o];
                }
            }
        }
        if self.is(Fault::GradientHalved) {
            g[a..w].iter_mut().for_each(|x| *x *= T::of(0.5));
        }
        let overwrite = self.is(Fault::GradientOverwritten);
        if let Some(out) = block.parameter_gradient.get() {
            for (out, g) in out.iter_mut().zip(&g) {
                *out = if overwrite { *g } else { *out + *g };
            }
        }
        let share = T::of(if self.is(Fault::FeatureGradientHalved) { 0.5 } else { 1.0 });
        if let Some(out) = block.feature_gradient.get() {
            out.iter_mut().zip(&by_feature).for_each(|(out, g)| *out = share * *g);
        }
        Ok(())
    }

    fn no_double(&self) -> Result<()> {
        if self.is(Fault::NothingOptional) { Err(Error::unsupported("double precision", "small")) } else { Ok(()) }
    }
}

impl DeformationNet for Recurrence {
    fn manifest(&self) -> &NetManifest {
        &self.manifest
    }
    fn offers(&self) -> NetOffers {
        let all = !self.is(Fault::NothingOptional);
        NetOffers { double: all, feature_gradient: all && !self.is(Fault::AnswersWhatItDoesNotOffer) }
    }
    fn initialise(&self, seed: u64) -> Result<Vec<f64>> {
        let seed = if self.is(Fault::SeedIgnored) { 1 } else { seed };
        let head = self.parts()[2];
        let first = |i: usize| {
            let x = ((i as u64 + 1) * (2 * seed + 1)).wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 40;
            if i < head || self.is(Fault::HeadNotZero) { x as f64 / f64::from(1 << 24) - 0.5 } else { 0.0 }
        };
        Ok((0..self.manifest.parameter_count()).map(first).collect())
    }
    fn tape_len(&self, steps: usize, batch: usize) -> Result<usize> {
        Ok(self.tape(steps, batch))
    }
    fn forward(&self, call: ForwardCall<'_, '_>) -> Result<()> {
        match call {
            ForwardCall::F32(block) => self.forward_in(block),
            ForwardCall::F64(block) => self.no_double().and_then(|()| self.forward_in(block)),
        }
    }
    fn backward(&self, call: BackwardCall<'_, '_>) -> Result<()> {
        match call {
            BackwardCall::F32(block) => self.backward_in(block),
            BackwardCall::F64(block) => self.no_double().and_then(|()| self.backward_in(block)),
        }
    }
}

fn subject(fault: Fault) -> NetSubject {
    let create = move |text: &str, inputs: usize, outputs: usize| -> Result<Box<dyn DeformationNet>> {
        let size = read(text, fault == Fault::UnknownKeysTaken)?;
        let outputs = if fault == Fault::OtherSizes && outputs == 3 { 6 } else { outputs };
        let twice = fault == Fault::TensorsOfOneName;
        let name = |name: &str| if twice { "tensor".to_string() } else { name.to_string() };
        let mut shapes = vec![
            (name("a"), vec![STATE]),
            (name("w"), vec![STATE, inputs]),
            (name("v"), vec![outputs, STATE]),
            (name("c"), vec![outputs]),
        ];
        if fault == Fault::SpareParameters {
            shapes.push(("spare".into(), vec![3]));
        }
        let name = if fault == Fault::OtherName { "large" } else { "small" };
        let manifest = NetManifest::new(name, inputs, outputs, STATE, shapes);
        Ok(Box::new(Recurrence { manifest, fault, made_on: std::thread::current().id(), size }))
    };
    let normalise = move |text: &str| write(text, fault == Fault::AnotherTableWrittenBack);
    NetSubject { toml: TABLE.into(), create: Box::new(create), normalise: Some(Box::new(normalise)) }
}

/// Faults and the checks that reject them.
fn faults() -> Vec<(Fault, Vec<&'static str>)> {
    vec![
        (Fault::OtherName, vec!["name_is_the_type"]),
        (Fault::AnotherTableWrittenBack, vec!["table_survives_a_round_trip"]),
        (Fault::UnknownKeysTaken, vec!["unknown_keys_are_refused"]),
        (Fault::OtherSizes, vec!["sizes_are_those_asked_for"]),
        (Fault::TensorsOfOneName, vec!["tensors_are_dense"]),
        (Fault::SeedIgnored, vec!["first_values_come_from_the_seed"]),
        (Fault::HeadNotZero, vec!["training_starts_at_the_template"]),
        (Fault::StateForgotten, vec!["a_window_equals_its_parts"]),
        (Fault::AbsentStateIsOnes, vec!["no_state_means_zeros"]),
        (Fault::StateOnlyWithOutput, vec!["a_state_needs_no_output"]),
        (Fault::BatchMatters, vec!["batches_are_independent"]),
        (Fault::GradientHalved, vec!["backward_is_the_gradient"]),
        (Fault::FeatureGradientHalved, vec!["backward_is_the_gradient"]),
        (Fault::SpareParameters, vec!["gradients_reach_every_parameter"]),
        (Fault::GradientOverwritten, vec!["parameter_gradients_are_added"]),
        (Fault::SingleIsAnother, vec!["single_agrees_with_double"]),
        (Fault::NoChecks, vec!["wrong_lengths_are_refused"]),
        (Fault::OverflowsEarly, vec!["large_features_stay_finite"]),
        (Fault::HidesNoNumber, vec!["large_features_stay_finite"]),
        (Fault::ThreadMatters, vec!["threads_change_nothing"]),
        (Fault::AnswersWhatItDoesNotOffer, vec!["offers_are_true"]),
    ]
}

#[test]
fn correct_nets_pass() {
    super::assert_accepted(CHECKS, &subject(Fault::None), &[]);
    let optional = ["backward_is_the_gradient", "single_agrees_with_double"];
    super::assert_accepted(CHECKS, &subject(Fault::NothingOptional), &optional);
}

#[test]
fn each_fault_is_rejected_by_its_check() {
    for (fault, expected) in faults() {
        super::assert_rejected(CHECKS, &format!("{fault:?}"), &subject(fault), &expected);
    }
    let sets: Vec<Vec<&str>> = faults().into_iter().map(|f| f.1).collect();
    super::assert_covered(CHECKS, &sets);
}
