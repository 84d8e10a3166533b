//! Outputs, states, gradients and optimiser steps of PyTorch; `data/pytorch_parity.py` made the numbers.

mod support;

use caphy_core::Real;
use caphy_core::net::NetReal;
use caphy_core::net::{DeformationNet, NetSpec};
use caphy_nets::adam::Adam;
use caphy_nets::{NetGruSpec, NetMlpSpec};
use serde_json::Value;
use support::{Case, difference};

fn reference() -> Value {
    serde_json::from_str(include_str!("data/pytorch_parity.json")).unwrap()
}

fn array<T: Real>(value: &Value) -> Vec<T> {
    value.as_array().unwrap().iter().map(|x| T::of(x.as_f64().unwrap())).collect()
}

fn size(value: &Value, key: &str) -> usize {
    value[key].as_u64().unwrap() as usize
}

/// Puts PyTorch's tensors into the flat vector by name and compares everything that both compute.
fn compare<T: NetReal>(reference: &Value, net: &dyn DeformationNet, tolerance: f64) {
    let m = net.manifest();
    let mut parameters = vec![T::nan(); m.parameter_count()];
    let mut gradient = vec![f64::NAN; m.parameter_count()];
    for tensor in reference["tensors"].as_array().unwrap() {
        let own = m.tensor(tensor["name"].as_str().unwrap()).unwrap();
        let shape: Vec<usize> =
            tensor["shape"].as_array().unwrap().iter().map(|n| n.as_u64().unwrap() as usize).collect();
        assert_eq!(own.shape, shape, "{}", own.name);
        parameters[own.offset..own.offset + own.len()].copy_from_slice(&array(&tensor["value"]));
        gradient[own.offset..own.offset + own.len()].copy_from_slice(&array(&tensor["gradient"]));
    }
    let case = Case::<T> {
        steps: size(reference, "steps"),
        batch: size(reference, "batch"),
        parameters,
        features: array(&reference["features"]),
        state: reference.get("state_before").map(array),
        output_gradient: array(&reference["output_gradient"]),
    };
    let forward = case.forward(net);
    let backward = case.backward(net, &forward);
    assert!(difference(&forward.output, &array::<f64>(&reference["output"])) < tolerance);
    if let Some(state) = reference.get("state_after") {
        assert!(difference(&forward.state, &array::<f64>(state)) < tolerance);
    }
    for t in &m.tensors {
        let part = t.offset..t.offset + t.len();
        let d = difference(&backward.parameters[part.clone()], &gradient[part]);
        assert!(d < tolerance, "{}: {d}", t.name);
    }
    assert!(difference(&backward.features, &array::<f64>(&reference["feature_gradient"])) < tolerance);
}

#[test]
fn gru_equals_pytorch() {
    let gru = &reference()["gru"];
    let spec = NetGruSpec { layers: size(gru, "layers"), hidden: size(gru, "hidden") };
    let net = spec.build(size(gru, "inputs"), size(gru, "outputs")).unwrap();
    compare::<f32>(gru, &*net, 1e-6);
    // The file holds 12 digits.
    compare::<f64>(gru, &*net, 1e-11);
}

#[test]
fn mlp_equals_pytorch() {
    let all = reference();
    for mlp in all["mlp"].as_array().unwrap() {
        let hidden = mlp["hidden"].as_array().unwrap().iter().map(|n| n.as_u64().unwrap() as usize).collect();
        let activation = serde_json::from_value(mlp["activation"].clone()).unwrap();
        let net = NetMlpSpec { hidden, activation }.build(size(mlp, "inputs"), size(mlp, "outputs")).unwrap();
        compare::<f32>(mlp, &*net, 1e-6);
        compare::<f64>(mlp, &*net, 1e-11);
    }
}

#[test]
fn adam_with_clipping_equals_pytorch() {
    let reference = &reference()["adam"];
    let mut adam = Adam { learning_rate: reference["learning_rate"].as_f64().unwrap() as f32, ..Adam::default() };
    let clip = reference["clip_norm"].as_f64().map(|c| c as f32);
    let mut p: Vec<f32> = array(&reference["start"]);
    let (mut m, mut v) = (vec![0.0; p.len()], vec![0.0; p.len()]);
    let steps = reference["gradients"].as_array().unwrap().iter().zip(reference["parameters"].as_array().unwrap());
    for ((gradient, want), norm) in steps.zip(array::<f64>(&reference["norms"])) {
        let mut g: Vec<f32> = array(gradient);
        let got = adam.step(clip, &mut p, &mut g, &mut m, &mut v).unwrap();
        assert!((got / norm - 1.0).abs() < 1e-11, "{got} {norm}");
        assert!(difference(&p, &array::<f64>(want)) < 1e-6);
    }
}
