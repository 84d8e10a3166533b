//! The promise of [`DeformationNet`], checked.

use super::differences::{Tally, scattered};
use super::material::answered;
use super::{Outcome, Verdict, ensure, table_checks, unexpected};
use crate::array::{In, Out};
use crate::net::{BackwardBlock, DeformationNet, ForwardBlock, NetReal, NetSpec};
use crate::{Error, Real, Result};

/// A net as its table makes it.
pub struct NetSubject {
    /// A valid table: `type` and its keys. Small sizes make quick checks.
    pub toml: String,
    /// Makes a net of some numbers of inputs and outputs from a table.
    pub create: Box<dyn Fn(&str, usize, usize) -> Result<Box<dyn DeformationNet>> + Send + Sync>,
    /// Writes a table back with every default, where the plugin can.
    pub normalise: Option<Box<dyn Fn(&str) -> Result<String> + Send + Sync>>,
}

/// Inputs and outputs of the nets that are checked.
const SIZES: (usize, usize) = (7, 9);

impl NetSubject {
    /// A net that is linked into this program, by its table.
    pub fn linked(toml: &str) -> Self {
        fn spec(text: &str) -> Result<Box<dyn NetSpec>> {
            toml::from_str(text).map_err(|e| Error::config("net", e.message().trim(), "correct the table"))
        }
        let write = |text: &str| {
            toml::to_string(&spec(text)?).map_err(|e| Error::config("net", e.to_string(), "correct the table"))
        };
        let create = |text: &str, inputs, outputs| spec(text)?.build(inputs, outputs);
        Self { toml: toml.into(), create: Box::new(create), normalise: Some(Box::new(write)) }
    }
    /// A small net.
    pub fn model(&self) -> std::result::Result<Box<dyn DeformationNet>, String> {
        self.model_of(&self.toml)
    }
    fn model_of(&self, toml: &str) -> std::result::Result<Box<dyn DeformationNet>, String> {
        (self.create)(toml, SIZES.0, SIZES.1).map_err(unexpected("making the net"))
    }
}

crate::conformance_list! { net, conformance_checks NetSubject }

table_checks!(NetSubject, same);

/// `Ok` when two nets answer alike.
fn same(a: &dyn DeformationNet, b: &dyn DeformationNet) -> std::result::Result<(), String> {
    ensure(a.manifest() == b.manifest(), || format!("{:?} became {:?}", a.manifest(), b.manifest()))?;
    let run = |net| Case::<f32>::new(net, 2, 3)?.forward(net);
    ensure(run(a)? == run(b)?, || "answers changed".into())
}

/// [`CHECKS`]: the manifest's name is the `type`.
pub fn name_is_the_type(subject: &NetSubject) -> Outcome {
    let name = subject.model()?.manifest().name.clone();
    let table: toml::Table = toml::from_str(&subject.toml).map_err(|e| e.message().to_string())?;
    let wanted = table.get("type").and_then(|t| t.as_str()).unwrap_or_default();
    ensure(name == wanted, || format!("`type = \"{wanted}\"` calls itself `{name}`"))?;
    Ok(Verdict::Passed)
}

/// [`CHECKS`]: sizes of the manifest.
pub fn sizes_are_those_asked_for(subject: &NetSubject) -> Outcome {
    for (inputs, outputs) in [(3, 6), SIZES, (1, 3)] {
        let net = (subject.create)(&subject.toml, inputs, outputs).map_err(unexpected("making the net"))?;
        let got = (net.manifest().inputs, net.manifest().outputs);
        ensure(got == (inputs, outputs), || format!("asked for {:?}, got {got:?}", (inputs, outputs)))?;
    }
    Ok(Verdict::Passed)
}

/// [`CHECKS`]: tensors in order, without gaps, named once each.
pub fn tensors_are_dense(net: &dyn DeformationNet) -> Outcome {
    let (mut next, manifest) = (0, net.manifest());
    let mut names: Vec<&str> = manifest.tensors.iter().map(|t| t.name.as_str()).collect();
    for tensor in &manifest.tensors {
        ensure(tensor.offset == next, || format!("`{}` starts at {}, not at {next}", tensor.name, tensor.offset))?;
        next += tensor.len();
    }
    ensure(next > 0, || "there is nothing to train".into())?;
    names.sort_unstable();
    ensure(names.windows(2).all(|w| w[0] != w[1]), || "two tensors share a name".into())?;
    Ok(Verdict::Passed)
}

/// One pass with parameters that no symmetry spoils.
#[derive(Clone)]
struct Case<T> {
    steps: usize,
    batch: usize,
    parameters: Vec<T>,
    features: Vec<T>,
    state: Option<Vec<T>>,
}

/// Output, state after, tape.
type Forward<T> = (Vec<T>, Vec<T>, Vec<T>);

fn numbers<T: Real>(count: usize, dimension: usize, scale: f64) -> Vec<T> {
    (0..count).map(|i| T::of((scale * scattered(i, dimension)) as f32 as f64)).collect()
}

impl<T: NetReal> Case<T> {
    fn new(net: &dyn DeformationNet, steps: usize, batch: usize) -> std::result::Result<Self, String> {
        let manifest = net.manifest();
        let first = net.initialise(3).map_err(unexpected("initialise"))?;
        ensure(first.len() == manifest.parameter_count(), || {
            format!("{} first values for {} parameters", first.len(), manifest.parameter_count())
        })?;
        // The last layer starts at zero: move everything off its first value.
        let shift = numbers::<f64>(first.len(), 1, 0.3);
        let parameters = first.iter().zip(shift).map(|(p, s)| T::of((p + s) as f32 as f64)).collect();
        let features = numbers(steps * batch * manifest.inputs, 2, 1.0);
        let state = (manifest.state > 0).then(|| numbers(batch * manifest.state, 3, 0.5));
        Ok(Self { steps, batch, parameters, features, state })
    }
    fn before(&self) -> In<'_, T> {
        self.state.as_deref().map_or_else(In::absent, In::from)
    }
    fn forward(&self, net: &dyn DeformationNet) -> std::result::Result<Forward<T>, String> {
        let manifest = net.manifest();
        let tape = net.tape_len(self.steps, self.batch).map_err(unexpected("tape_len"))?;
        let mut output = vec![T::nan(); self.steps * self.batch * manifest.outputs];
        let (mut after, mut tape) = (vec![T::nan(); self.batch * manifest.state], vec![T::zero(); tape]);
        let mut block = ForwardBlock {
            steps: self.steps,
            batch: self.batch,
            parameters: (&self.parameters[..]).into(),
            features: (&self.features[..]).into(),
            state_before: self.before(),
            output: output.as_mut_slice().into(),
            state_after: if after.is_empty() { Out::absent() } else { after.as_mut_slice().into() },
            tape: if tape.is_empty() { Out::absent() } else { tape.as_mut_slice().into() },
        };
        T::forward(net, &mut block).map_err(unexpected("a forward pass"))?;
        Ok((output, after, tape))
    }
    /// Gradients of Σ weights · output, added to what stands in `parameter_gradient`.
    fn backward(
        &self,
        net: &dyn DeformationNet,
        tape: &[T],
        weights: &[T],
        parameter_gradient: &mut [T],
        feature_gradient: Option<&mut [T]>,
    ) -> Result<()> {
        let mut block = BackwardBlock {
            steps: self.steps,
            batch: self.batch,
            parameters: (&self.parameters[..]).into(),
            features: (&self.features[..]).into(),
            state_before: self.before(),
            tape: tape.into(),
            output_gradient: weights.into(),
            parameter_gradient: parameter_gradient.into(),
            feature_gradient: feature_gradient.map_or_else(Out::absent, Out::from),
        };
        T::backward(net, &mut block)
    }
    /// Only some windows.
    fn windows(&self, net: &dyn DeformationNet, range: std::ops::Range<usize>) -> Self {
        let (inputs, state) = (net.manifest().inputs, net.manifest().state);
        let part = |step: usize| {
            let start = (step * self.batch + range.start) * inputs;
            &self.features[start..start + range.len() * inputs]
        };
        Self {
            batch: range.len(),
            features: (0..self.steps).flat_map(|s| part(s).to_vec()).collect(),
            state: self.state.as_ref().map(|s| s[range.start * state..range.end * state].to_vec()),
            ..self.clone()
        }
    }
}

fn largest<T: Real>(values: &[T]) -> f64 {
    values.iter().fold(0.0f64, |m, v| m.max(Real::to_f64(*v).abs()))
}

/// `Ok` when two arrays agree relative to their largest value; NaN agrees with nothing.
fn close<T: Real>(what: &str, a: &[T], b: &[T], relative: f64) -> std::result::Result<(), String> {
    let scale = largest(a).max(largest(b));
    ensure(a.len() == b.len(), || format!("{what}: {} and {} values", a.len(), b.len()))?;
    let near = |(a, b): (&T, &T)| Real::to_f64(*a - *b).abs() <= relative * scale;
    let wrong = a.iter().zip(b).position(|pair| !near(pair));
    match wrong {
        None => Ok(()),
        Some(i) => Err(format!("{what}: {} and {} at {i}", a[i], b[i])),
    }
}

/// [`CHECKS`]: [`DeformationNet::initialise`].
pub fn first_values_come_from_the_seed(net: &dyn DeformationNet) -> Outcome {
    let of = |seed| net.initialise(seed).map_err(unexpected("initialise"));
    let (a, again, other) = (of(7)?, of(7)?, of(8)?);
    ensure(a.len() == net.manifest().parameter_count(), || format!("{} first values", a.len()))?;
    ensure(a.iter().all(|v| v.is_finite()), || "first values are not finite".into())?;
    ensure(a == again, || "the same seed gave other values".into())?;
    // A net that starts at zero everywhere has no use for its seed.
    ensure(a != other || a.iter().all(|v| *v == 0.0), || "another seed gave the same values".into())?;
    Ok(Verdict::Passed)
}

/// [`CHECKS`]: zero output with first values.
pub fn training_starts_at_the_template(net: &dyn DeformationNet) -> Outcome {
    let mut case = Case::<f32>::new(net, 2, 3)?;
    case.parameters = net.initialise(5).map_err(unexpected("initialise"))?.into_iter().map(|v| v as f32).collect();
    let output = case.forward(net)?.0;
    ensure(output.iter().all(|v| *v == 0.0), || format!("displaces by up to {}", largest(&output)))?;
    Ok(Verdict::Passed)
}

/// [`CHECKS`]: state carry, within rounding (1e-5 in single precision: sums of another size may be taken in another order).
pub fn a_window_equals_its_parts(net: &dyn DeformationNet) -> Outcome {
    let (steps, batch) = (5, 3);
    let case = Case::<f32>::new(net, steps, batch)?;
    let (whole, after, _) = case.forward(net)?;
    let (mut parts, mut state) = (Vec::new(), case.state.clone());
    for steps_of in [0..2, 2..3, 3..5] {
        let row = batch * net.manifest().inputs;
        let features = case.features[steps_of.start * row..steps_of.end * row].to_vec();
        let part = Case { steps: steps_of.len(), features, state: state.clone(), ..case.clone() };
        let (output, after, _) = part.forward(net)?;
        parts.extend(output);
        state = (!after.is_empty()).then_some(after);
    }
    close("the window and its parts", &whole, &parts, 1e-5)?;
    close("the state behind them", &after, &state.unwrap_or_default(), 1e-5)?;
    Ok(Verdict::Passed)
}

/// [`CHECKS`]: absent state.
pub fn no_state_means_zeros(net: &dyn DeformationNet) -> Outcome {
    let mut case = Case::<f32>::new(net, 2, 3)?;
    let zeros = case.state.as_ref().map(|s| vec![0.0; s.len()]);
    case.state = None;
    let absent = case.forward(net)?;
    case.state = zeros;
    ensure(absent == case.forward(net)?, || "absent state and zeros differ".into())?;
    Ok(Verdict::Passed)
}

/// [`CHECKS`]: absent output.
pub fn a_state_needs_no_output(net: &dyn DeformationNet) -> Outcome {
    if net.manifest().state == 0 {
        return Ok(Verdict::NotOffered);
    }
    let case = Case::<f32>::new(net, 3, 2)?;
    let wanted = case.forward(net)?.1;
    let mut after = vec![f32::NAN; wanted.len()];
    let mut block = ForwardBlock {
        steps: 3,
        batch: 2,
        parameters: (&case.parameters[..]).into(),
        features: (&case.features[..]).into(),
        state_before: case.before(),
        output: Out::absent(),
        state_after: after.as_mut_slice().into(),
        tape: Out::absent(),
    };
    f32::forward(net, &mut block).map_err(unexpected("a forward pass without an output"))?;
    ensure(after == wanted, || "the state is another one where no output is asked for".into())?;
    Ok(Verdict::Passed)
}

/// [`CHECKS`]: windows of a batch by themselves, within rounding.
pub fn batches_are_independent(net: &dyn DeformationNet) -> Outcome {
    let (steps, batch, outputs) = (2, 4, net.manifest().outputs);
    let case = Case::<f32>::new(net, steps, batch)?;
    let whole = case.forward(net)?.0;
    for range in [0..1, 1..4] {
        let part = case.windows(net, range.clone()).forward(net)?.0;
        let of = |s: usize| &whole[(s * batch + range.start) * outputs..(s * batch + range.end) * outputs];
        let wanted: Vec<f32> = (0..steps).flat_map(|s| of(s).to_vec()).collect();
        close(&format!("windows {range:?} alone and in a batch"), &part, &wanted, 1e-5)?;
    }
    Ok(Verdict::Passed)
}

/// Passes of gradient checks: steps, windows.
const PASS: (usize, usize) = (3, 2);

/// [`CHECKS`]: backward against differences in double precision; not offered by nets without it.
pub fn backward_is_the_gradient(net: &dyn DeformationNet) -> Outcome {
    if !net.offers().double {
        return Ok(Verdict::NotOffered);
    }
    let case = Case::<f64>::new(net, PASS.0, PASS.1)?;
    let (output, _, tape) = case.forward(net)?;
    let weights: Vec<f64> = numbers(output.len(), 4, 1.0);
    let loss = |case: &Case<f64>| -> std::result::Result<f64, String> {
        Ok(case.forward(net)?.0.iter().zip(&weights).map(|(o, w)| o * w).sum())
    };
    let mut by_parameter = vec![0.0; case.parameters.len()];
    let mut by_feature = vec![f64::NAN; case.features.len()];
    let features = net.offers().feature_gradient.then_some(&mut by_feature[..]);
    case.backward(net, &tape, &weights, &mut by_parameter, features).map_err(unexpected("a backward pass"))?;
    let compare = |what: &str, gradient: &[f64], of: fn(&mut Case<f64>) -> &mut Vec<f64>, from: usize, to: usize| {
        // Relative to the part's own size: a wrong bias must not hide behind large weights.
        let scale = largest(&gradient[from..to]).max(1e-3 * largest(gradient));
        let mut tally = Tally::default();
        for i in (from..to).step_by(((to - from) / 24).max(1)) {
            let shifted = |h: f64| {
                let mut moved = case.clone();
                of(&mut moved)[i] += h;
                loss(&moved)
            };
            let h = 1e-5;
            let difference = (shifted(h)? - shifted(-h)?) / (2.0 * h);
            let right = (difference - gradient[i]).abs() <= 1e-6 * scale;
            tally.add(right, || format!("{i}: {} instead of {difference}", gradient[i]));
        }
        tally.check(what)
    };
    for t in &net.manifest().tensors {
        let what = format!("the gradient by `{}`", t.name);
        compare(&what, &by_parameter, |c| &mut c.parameters, t.offset, t.offset + t.len())?;
    }
    if net.offers().feature_gradient {
        compare("the gradient by the features", &by_feature, |c| &mut c.features, 0, by_feature.len())?;
    }
    Ok(Verdict::Passed)
}

/// [`CHECKS`]: no tensor is out of reach, and at most half of all parameters are (units that happen to be off).
pub fn gradients_reach_every_parameter(net: &dyn DeformationNet) -> Outcome {
    // Many frames: a rectified unit is off in half of them.
    let case = Case::<f32>::new(net, 4, 16)?;
    let (output, _, tape) = case.forward(net)?;
    let weights: Vec<f32> = numbers(output.len(), 4, 1.0);
    let mut gradient = vec![0.0; case.parameters.len()];
    case.backward(net, &tape, &weights, &mut gradient, None).map_err(unexpected("a backward pass"))?;
    for t in &net.manifest().tensors {
        let reached = gradient[t.offset..t.offset + t.len()].iter().any(|g| *g != 0.0);
        ensure(reached, || format!("no gradient reaches `{}`", t.name))?;
    }
    let reached = gradient.iter().filter(|g| **g != 0.0).count();
    ensure(2 * reached >= gradient.len(), || format!("{reached} of {} parameters have a gradient", gradient.len()))?;
    Ok(Verdict::Passed)
}

/// [`CHECKS`]: what stands in the gradients before.
pub fn parameter_gradients_are_added(net: &dyn DeformationNet) -> Outcome {
    let case = Case::<f32>::new(net, PASS.0, PASS.1)?;
    let (output, _, tape) = case.forward(net)?;
    let weights: Vec<f32> = numbers(output.len(), 4, 1.0);
    let run = |start: f32, features: f32| {
        let mut parameters = vec![start; case.parameters.len()];
        let mut by_feature = vec![features; case.features.len()];
        let wanted = net.offers().feature_gradient.then_some(&mut by_feature[..]);
        case.backward(net, &tape, &weights, &mut parameters, wanted).map_err(unexpected("a backward pass"))?;
        Ok::<_, String>((parameters, by_feature))
    };
    let (zero, one) = (run(0.0, f32::NAN)?, run(1.0, 5.0)?);
    let back: Vec<f32> = one.0.iter().map(|g| g - 1.0).collect();
    // Adding 1 and taking it away costs a rounding of 1.
    let scale = f64::from(f32::EPSILON) * 4.0 / largest(&zero.0).max(1e-30) + 1e-5;
    close("the gradient from 0 and from 1", &zero.0, &back, scale)?;
    if net.offers().feature_gradient {
        ensure(zero.1 == one.1, || "the feature gradient keeps what stood there".into())?;
    }
    Ok(Verdict::Passed)
}

/// [`CHECKS`]: f32 against f64; not offered by nets without double precision.
pub fn single_agrees_with_double(net: &dyn DeformationNet) -> Outcome {
    if !net.offers().double {
        return Ok(Verdict::NotOffered);
    }
    let single = Case::<f32>::new(net, PASS.0, PASS.1)?.forward(net)?;
    let double = Case::<f64>::new(net, PASS.0, PASS.1)?.forward(net)?;
    let narrow = |v: &[f64]| v.iter().map(|v| *v as f32).collect::<Vec<_>>();
    close("outputs", &single.0, &narrow(&double.0), 1e-5)?;
    close("states", &single.1, &narrow(&double.1), 1e-5)?;
    Ok(Verdict::Passed)
}

/// [`CHECKS`]: [`Error::Length`].
pub fn wrong_lengths_are_refused(net: &dyn DeformationNet) -> Outcome {
    let good = Case::<f32>::new(net, 2, 3)?;
    let (output, _, tape) = good.forward(net)?;
    let mut cases = vec![("parameters", good.clone()), ("features", good.clone())];
    cases[0].1.parameters.pop();
    cases[1].1.features.push(0.0);
    if let Some(state) = &good.state {
        let mut case = good.clone();
        case.state = Some(state[1..].to_vec());
        cases.push(("state", case));
    }
    for (what, case) in &cases {
        let mut room = vec![0.0; output.len()];
        let mut block = ForwardBlock {
            steps: 2,
            batch: 3,
            parameters: (&case.parameters[..]).into(),
            features: (&case.features[..]).into(),
            state_before: case.before(),
            output: room.as_mut_slice().into(),
            state_after: Out::absent(),
            tape: Out::absent(),
        };
        let refused = matches!(f32::forward(net, &mut block), Err(Error::Length { .. }));
        ensure(refused, || format!("a wrong number of {what} is no Length error in the forward pass"))?;
        let mut gradient = vec![0.0; good.parameters.len()];
        let refused = matches!(case.backward(net, &tape, &output, &mut gradient, None), Err(Error::Length { .. }));
        ensure(refused, || format!("a wrong number of {what} is no Length error in the backward pass"))?;
    }
    let mut gradient = vec![0.0; good.parameters.len() - 1];
    let refused = matches!(good.backward(net, &tape, &output, &mut gradient, None), Err(Error::Length { .. }));
    ensure(refused, || "room for too few gradients is no Length error".into())?;
    Ok(Verdict::Passed)
}

/// [`CHECKS`]: features of ±1e4, far from anything standardised, in every precision that is offered; a feature that is not a number
/// is an error or makes the output none, if the net listens to it at all.
pub fn large_features_stay_finite(net: &dyn DeformationNet) -> Outcome {
    fn in_precision<T: NetReal>(net: &dyn DeformationNet) -> std::result::Result<(), String> {
        let mut case = Case::<T>::new(net, PASS.0, PASS.1)?;
        case.features.iter_mut().for_each(|f| *f *= T::of(1e4));
        let (output, after, tape) = case.forward(net)?;
        ensure(output.iter().chain(&after).all(|v| v.is_finite()), || "the forward pass is not finite".into())?;
        let mut gradient = vec![T::zero(); case.parameters.len()];
        case.backward(net, &tape, &output, &mut gradient, None).map_err(unexpected("a backward pass"))?;
        ensure(gradient.iter().all(|v| v.is_finite()), || "the gradient is not finite".into())?;
        // A net may be deaf to a feature, but not tell numbers from none by silence.
        case.features[0] = T::of(-3.0);
        let heard = case.forward(net)?.0 != output;
        case.features[0] = T::nan();
        let hidden = case.forward(net).is_ok_and(|(output, ..)| output.iter().all(|v| v.is_finite()));
        ensure(!(heard && hidden), || "a feature that is not a number has a finite output".into())
    }
    in_precision::<f32>(net)?;
    if net.offers().double {
        in_precision::<f64>(net)?;
    }
    Ok(Verdict::Passed)
}

/// [`CHECKS`]: pure, on any thread.
pub fn threads_change_nothing(net: &dyn DeformationNet) -> Outcome {
    let run = || -> std::result::Result<_, String> {
        let case = Case::<f32>::new(net, PASS.0, PASS.1)?;
        let forward = case.forward(net)?;
        let mut gradient = vec![0.0; case.parameters.len()];
        case.backward(net, &forward.2, &forward.0, &mut gradient, None).map_err(unexpected("a backward pass"))?;
        Ok((forward.0, forward.1, gradient))
    };
    let first = run()?;
    let others: Vec<std::result::Result<bool, String>> = std::thread::scope(|scope| {
        let threads: Vec<_> = (0..4).map(|_| scope.spawn(|| Ok(run()? == first))).collect();
        threads.into_iter().map(|t| t.join().unwrap_or_else(|_| Err("a thread panicked".into()))).collect()
    });
    for same in others {
        ensure(same?, || "other bits on another thread".into())?;
    }
    Ok(Verdict::Passed)
}

/// [`CHECKS`]: double precision and the gradient by the features are answered where declared, else [`Error::Unsupported`].
pub fn offers_are_true(net: &dyn DeformationNet) -> Outcome {
    let case = Case::<f32>::new(net, 2, 2)?;
    let (output, _, tape) = case.forward(net)?;
    let (mut gradient, mut features) = (vec![0.0; case.parameters.len()], vec![0.0; case.features.len()]);
    let result = case.backward(net, &tape, &output, &mut gradient, Some(&mut features));
    answered("the gradient by the features", net.offers().feature_gradient, result)?;
    let case = Case::<f64>::new(net, 2, 2)?;
    let mut output = vec![0.0; 4 * net.manifest().outputs];
    let mut block = ForwardBlock {
        steps: 2,
        batch: 2,
        parameters: (&case.parameters[..]).into(),
        features: (&case.features[..]).into(),
        state_before: case.before(),
        output: output.as_mut_slice().into(),
        state_after: Out::absent(),
        tape: Out::absent(),
    };
    answered("double precision", net.offers().double, f64::forward(net, &mut block))?;
    Ok(Verdict::Passed)
}
