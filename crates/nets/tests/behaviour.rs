//! What every net promises: carried state, equal bits, first values, typed errors.

mod support;

use caphy_core::array::{In, Out};
use caphy_core::net::NetReal;
use caphy_core::net::{BackwardBlock, BackwardCall, DeformationNet, ForwardBlock, ForwardCall, NetSpec};
use caphy_core::{Error, Real};
use caphy_nets::{NetGru, NetGruSpec, NetMlp, NetMlpSpec};
use support::{Case, difference, numbers, small_nets};

/// Two nets whose output layer is cut into panels.
fn wide_nets() -> Vec<(&'static str, Box<dyn DeformationNet>)> {
    let gru = NetGruSpec { layers: 2, hidden: 24 };
    let mlp = NetMlpSpec { hidden: vec![24], ..NetMlpSpec::default() };
    vec![
        ("gru", Box::new(NetGru::new(&gru, 10, 3000).unwrap())),
        ("mlp", Box::new(NetMlp::new(&mlp, 10, 3000).unwrap())),
    ]
}

fn parts_equal_whole<T: NetReal>(net: &dyn DeformationNet, name: &str, tolerance: f64) {
    let m = net.manifest();
    let whole = Case::<T>::new(net, 7, 3);
    let want = whole.forward(net);
    let mut state = whole.state.clone();
    let mut output = Vec::new();
    for (first, steps) in [(0, 2), (2, 1), (3, 4)] {
        let part = Case {
            steps,
            batch: 3,
            parameters: whole.parameters.clone(),
            features: whole.features[first * 3 * m.inputs..(first + steps) * 3 * m.inputs].to_vec(),
            state: state.clone(),
            output_gradient: vec![],
        };
        let out = part.forward(net);
        output.extend(out.output);
        state = (m.state > 0).then_some(out.state);
    }
    let d = difference(&output, &want.output);
    assert!(d < tolerance, "{name}: {d}");
    if let Some(state) = state {
        assert!(difference(&state, &want.state) < tolerance, "{name}");
    }
}

#[test]
fn a_whole_window_equals_its_parts_with_carried_state() {
    // Products of other sizes may add in another order: a few roundings of the working precision.
    for (name, net) in small_nets() {
        parts_equal_whole::<f32>(&*net, &name, 1e-6);
        parts_equal_whole::<f64>(&*net, &name, 1e-14);
    }
    for (name, net) in wide_nets() {
        parts_equal_whole::<f32>(&*net, name, 1e-6);
    }
}

#[test]
fn windows_do_not_see_each_other() {
    for (name, net) in small_nets() {
        let m = net.manifest();
        let both = Case::<f64>::new(&*net, 3, 2);
        let want = both.forward(&*net).output;
        for window in 0..2 {
            let pick = |values: &[f64], width: usize| -> Vec<f64> {
                values.chunks_exact(width).skip(window).step_by(2).flatten().copied().collect()
            };
            let one = Case {
                steps: 3,
                batch: 1,
                parameters: both.parameters.clone(),
                features: pick(&both.features, m.inputs),
                state: both.state.as_deref().map(|s| pick(s, m.state)),
                output_gradient: vec![],
            };
            assert!(difference(&one.forward(&*net).output, &pick(&want, m.outputs)) < 1e-14, "{name}");
        }
    }
}

#[test]
fn no_state_means_zeros_and_no_tape_gives_the_same_output() {
    for (name, net) in small_nets() {
        let m = net.manifest();
        let mut case = Case::<f32>::new(&*net, 3, 2);
        case.state = None;
        let want = case.forward(&*net).output;
        let zeros = vec![0.0; 2 * m.state];
        let mut output = vec![f32::NAN; want.len()];
        let mut block = ForwardBlock {
            steps: 3,
            batch: 2,
            parameters: case.parameters[..].into(),
            features: case.features[..].into(),
            state_before: if m.state > 0 { zeros[..].into() } else { In::absent() },
            output: output.as_mut_slice().into(),
            state_after: Out::absent(),
            tape: Out::absent(),
        };
        net.forward(ForwardCall::F32(&mut block)).unwrap();
        assert_eq!(output, want, "{name}");
    }
}

fn bits<T: NetReal>(net: &dyn DeformationNet, threads: usize) -> Vec<f64> {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
    pool.install(|| {
        let case = Case::<T>::new(net, 5, 4);
        let forward = case.forward(net);
        let backward = case.backward(net, &forward);
        let all = [forward.output, forward.state, backward.parameters, backward.features];
        all.iter().flatten().map(|x| (*x).to_f64()).collect()
    })
}

#[test]
fn bits_do_not_depend_on_the_threads() {
    for (name, net) in wide_nets() {
        assert_eq!(bits::<f32>(&*net, 1), bits::<f32>(&*net, 2), "{name}");
        assert_eq!(bits::<f64>(&*net, 1), bits::<f64>(&*net, 3), "{name}");
    }
}

#[test]
fn first_values_come_from_the_seed_and_start_at_the_template() {
    for (name, net) in small_nets() {
        let m = net.manifest();
        let values = net.initialise(7).expect("values");
        assert_eq!(values.len(), m.parameter_count());
        assert_eq!(values, net.initialise(7).expect("values"), "{name}");
        let (weight, rest) = (&m.tensors[m.tensors.len() - 2], &m.tensors[..m.tensors.len() - 2]);
        assert!(values[weight.offset..].iter().all(|v| *v == 0.0), "{name}");
        for t in rest {
            let part = &values[t.offset..t.offset + t.len()];
            let bound = match t.name.contains("weight_ih") {
                true => (3.0 / t.shape[1] as f64).sqrt(),
                false if name.starts_with("gru") => 1.0 / 5f64.sqrt(),
                false => 1.0 / (m.tensor(&t.name.replace("bias", "weight")).unwrap().shape[1] as f64).sqrt(),
            };
            assert!(part.iter().all(|v| v.abs() <= bound && *v != 0.0), "{name} {}", t.name);
        }
        if !rest.is_empty() {
            assert_ne!(values, net.initialise(8).expect("values"), "{name}");
        }
        let mut case = Case::<f32>::new(&*net, 2, 2);
        case.parameters = values.iter().map(|v| f32::of(*v)).collect();
        assert!(case.forward(&*net).output.iter().all(|y| *y == 0.0), "{name}");
    }
}

/// The head learns from the square of what the last layer says: were less than half of a signal left behind four layers, a deep net
/// would learn slower than a shallow one. PyTorch's own first values leave a fifth.
#[test]
fn first_values_keep_a_signal_through_the_layers() {
    let spec = NetGruSpec { layers: 4, hidden: 128 };
    let net = spec.build(40, 3).expect("a net");
    let values: Vec<f32> = net.initialise(3).expect("values").iter().map(|v| *v as f32).collect();
    // Two windows that stand still in other poses; biases are the same in both, the signal is what differs.
    let (steps, batch) = (30, 2);
    let pose: Vec<f32> = numbers::<f32>(40 * batch, 1, 1.7);
    let features: Vec<f32> = (0..steps).flat_map(|_| pose.iter().copied()).collect();
    let mut after = vec![0.0f32; 4 * 128 * batch];
    let mut block = ForwardBlock {
        steps,
        batch,
        parameters: values[..].into(),
        features: features[..].into(),
        state_before: In::absent(),
        output: Out::absent(),
        state_after: (&mut after[..]).into(),
        tape: Out::absent(),
    };
    net.forward(ForwardCall::F32(&mut block)).expect("a pass");
    let (one, other) = after.split_at(4 * 128);
    let signal = |layer: usize| {
        let part = |state: &[f32]| state[layer * 128..(layer + 1) * 128].to_vec();
        part(one).iter().zip(part(other)).map(|(a, b)| f64::from(a - b).powi(2)).sum::<f64>().sqrt()
    };
    let all = [0, 1, 2, 3].map(signal);
    assert!(all[3] > 0.5 * all[0] && all[0] > 1.0, "{all:?}");
}

#[test]
fn wrong_lengths_are_typed_errors() {
    for (name, net) in small_nets() {
        let m = net.manifest();
        let case = Case::<f32>::new(&*net, 2, 3);
        let lengths = [
            m.parameter_count(),
            6 * m.inputs,
            3 * m.state,
            6 * m.outputs,
            3 * m.state,
            net.tape_len(2, 3).expect("a length"),
        ];
        for (short, length) in lengths.iter().enumerate() {
            if *length == 0 {
                continue;
            }
            let mut arrays: Vec<Vec<f32>> = lengths.iter().map(|n| numbers(*n, 1, 1.0)).collect();
            arrays[short].pop();
            let [parameters, features, before, output, after, tape] = &mut arrays[..] else { unreachable!() };
            let mut block = ForwardBlock {
                steps: 2,
                batch: 3,
                parameters: parameters[..].into(),
                features: features[..].into(),
                state_before: before[..].into(),
                output: output.as_mut_slice().into(),
                state_after: after.as_mut_slice().into(),
                tape: tape.as_mut_slice().into(),
            };
            let error = net.forward(ForwardCall::F32(&mut block)).unwrap_err();
            let Error::Length { expected, got, .. } = error else { panic!("{name}: {error}") };
            assert_eq!((expected, got), (*length, length - 1), "{name} array {short}");
        }
        // A tape of another size, as left by a pass over fewer steps.
        let tape = vec![0.0f32; net.tape_len(1, 3).expect("a length")];
        if tape.len() != net.tape_len(2, 3).expect("a length") {
            let mut gradient = vec![0.0f32; m.parameter_count()];
            let mut block = BackwardBlock {
                steps: 2,
                batch: 3,
                parameters: case.parameters[..].into(),
                features: case.features[..].into(),
                state_before: In::absent(),
                tape: tape[..].into(),
                output_gradient: case.output_gradient[..].into(),
                parameter_gradient: gradient.as_mut_slice().into(),
                feature_gradient: Out::absent(),
            };
            let error = net.backward(BackwardCall::F32(&mut block)).unwrap_err();
            assert!(error.to_string().contains("net tape"), "{name}: {error}");
        }
    }
}

#[test]
fn a_pass_over_nothing_is_allowed() {
    for (_, net) in small_nets() {
        for (steps, batch) in [(0, 3), (2, 0)] {
            let case = Case::<f32>::new(&*net, steps, batch);
            let forward = case.forward(&*net);
            if steps == 0 && net.manifest().state > 0 {
                assert_eq!(Some(&forward.state), case.state.as_ref());
            }
            assert!(case.backward(&*net, &forward).parameters.iter().all(|g| *g == 0.0));
        }
    }
}

#[test]
fn not_a_number_is_not_hidden() {
    for (name, net) in small_nets() {
        let mut case = Case::<f32>::new(&*net, 2, 1);
        case.features[0] = f32::NAN;
        assert!(case.forward(&*net).output.iter().any(|y| y.is_nan()), "{name}");
    }
}

#[test]
fn huge_inputs_stay_finite_in_a_gru() {
    let net = NetGru::new(&NetGruSpec { layers: 2, hidden: 5 }, 4, 6).unwrap();
    let mut case = Case::<f32>::new(&net, 3, 2);
    for (i, x) in case.features.iter_mut().enumerate() {
        *x = if i % 2 == 0 { 1e30 } else { -1e30 };
    }
    let forward = case.forward(&net);
    let backward = case.backward(&net, &forward);
    Error::check_finite("output", &forward.output).unwrap();
    Error::check_finite("gradient", &backward.parameters).unwrap();
}

fn parse(text: &str) -> Result<Box<dyn NetSpec>, String> {
    toml::from_str(text).map_err(|e: toml::de::Error| e.to_string())
}

#[test]
fn nets_are_chosen_by_toml() {
    let net = parse("type = \"gru\"").unwrap().build(85, 30).unwrap();
    let m = net.manifest();
    assert_eq!((m.name.as_str(), m.inputs, m.outputs, m.state), ("gru", 85, 30, 1024));
    assert_eq!(m.tensor("gru.weight_ih_l0").unwrap().shape, [768, 85]);
    assert_eq!(m.tensor("gru.weight_hh_l3").unwrap().shape, [768, 256]);
    assert_eq!(m.tensor("head.weight").unwrap().shape, [30, 256]);
    let net = parse("type = \"gru\"\nlayers = 1\nhidden = 8").unwrap().build(4, 6).unwrap();
    assert_eq!(net.manifest().parameter_count(), 24 * 4 + 24 * 8 + 48 + 6 * 8 + 6);
    let net = parse("type = \"mlp\"\nhidden = [8]\nactivation = \"tanh\"").unwrap().build(4, 6).unwrap();
    assert_eq!(net.manifest().tensor("layers.1.weight").unwrap().shape, [6, 8]);
    assert_eq!(parse("type = \"mlp\"").unwrap().build(4, 6).unwrap().manifest().tensors.len(), 6);
    // A specification survives its own text.
    let text = toml::to_string(&parse("type = \"mlp\"\nhidden = [3, 2]").unwrap()).unwrap();
    assert_eq!(parse(&text).unwrap().build(1, 1).unwrap().manifest().tensors[0].shape, [3, 1]);
}

#[test]
fn unknown_names_keys_and_sizes_are_refused() {
    for (text, wanted) in [
        ("type = \"lstm\"", "gru"),
        ("type = \"gru\"\nlayer = 2", "layer"),
        ("type = \"mlp\"\nlayers = 2", "layers"),
        ("type = \"mlp\"\nactivation = \"step\"", "silu"),
    ] {
        let error = parse(text).err().unwrap_or_else(|| panic!("accepted {text}"));
        assert!(error.contains(wanted), "{error}");
    }
    for (text, key) in [
        ("type = \"gru\"\nlayers = 0", "net.layers"),
        ("type = \"gru\"\nhidden = 0", "net.hidden"),
        ("type = \"gru\"\nhidden = 9000000", "net.hidden"),
        ("type = \"mlp\"\nhidden = [4, 0]", "net.hidden[1]"),
    ] {
        let error = parse(text).unwrap().build(4, 6).err().unwrap();
        assert!(matches!(error, Error::Config { key: ref k, .. } if k == key), "{error}");
    }
    assert!(NetGruSpec::default().build(0, 6).is_err() && NetMlpSpec::default().build(4, 0).is_err());
}
