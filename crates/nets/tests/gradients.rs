//! Backward passes against finite differences, and single against double precision.

mod support;

use support::{Case, difference, small_nets};

#[test]
fn every_gradient_is_the_slope_of_the_objective() {
    for (name, net) in small_nets() {
        for with_state in [true, false] {
            let mut case = Case::<f64>::new(&*net, 4, 3);
            if !with_state {
                case.state = None;
            }
            let gradient = case.backward(&*net, &case.forward(&*net));
            // Central differences: the error is h²/6 times a third derivative of order one plus rounding 1e-16/h, so
            // about 1e-11 for h = 1e-5. Relu has kinks: no value of these nets lies within h of one (the numbers are
            // fixed), or the comparison would fail by far.
            let h = 1e-5;
            let mut parameters = vec![0.0; case.parameters.len()];
            for i in 0..parameters.len() {
                let x = case.parameters[i];
                case.parameters[i] = x + h;
                let high = case.objective(&*net);
                case.parameters[i] = x - h;
                parameters[i] = (high - case.objective(&*net)) / (2.0 * h);
                case.parameters[i] = x;
            }
            let mut features = vec![0.0; case.features.len()];
            for i in 0..features.len() {
                let x = case.features[i];
                case.features[i] = x + h;
                let high = case.objective(&*net);
                case.features[i] = x - h;
                features[i] = (high - case.objective(&*net)) / (2.0 * h);
                case.features[i] = x;
            }
            let worst = (difference(&gradient.parameters, &parameters), difference(&gradient.features, &features));
            println!("{name}, state {with_state}: {worst:?}");
            assert!(worst.0 < 1e-9 && worst.1 < 1e-9, "{name}, state {with_state}: {worst:?}");
        }
    }
}

#[test]
fn single_precision_follows_double_precision() {
    for (name, net) in small_nets() {
        let (narrow, wide) = (Case::<f32>::new(&*net, 5, 3), Case::<f64>::new(&*net, 5, 3));
        let (y, want) = (narrow.forward(&*net), wide.forward(&*net));
        let (dy, want_dy) = (narrow.backward(&*net, &y), wide.backward(&*net, &want));
        // 1e-6 = about 16 roundings of 6e-8, relative to the largest value.
        for d in [
            difference(&y.output, &want.output),
            difference(&dy.parameters, &want_dy.parameters),
            difference(&dy.features, &want_dy.features),
        ] {
            assert!(d < 1e-6, "{name}: {d}");
        }
    }
}

#[test]
fn the_gradient_reaches_every_parameter() {
    for (name, net) in small_nets() {
        let case = Case::<f64>::new(&*net, 3, 8);
        let gradient = case.backward(&*net, &case.forward(&*net)).parameters;
        for tensor in &net.manifest().tensors {
            let part = &gradient[tensor.offset..tensor.offset + tensor.len()];
            // A rectified unit may be off in all 24 frames; elsewhere no entry is zero.
            let reached = part.iter().filter(|g| **g != 0.0).count();
            let enough = if name.contains("Relu") { part.len() / 2 } else { part.len() };
            assert!(reached >= enough, "{name} {}: {reached} of {}", tensor.name, part.len());
        }
    }
}

#[test]
fn the_parameter_gradient_is_added_and_the_feature_gradient_replaced() {
    use caphy_core::net::{BackwardBlock, BackwardCall};
    for (name, net) in small_nets() {
        let case = Case::<f64>::new(&*net, 2, 3);
        let forward = case.forward(&*net);
        let once = case.backward(&*net, &forward);
        let mut twice = once.clone();
        let mut block = BackwardBlock {
            steps: 2,
            batch: 3,
            parameters: case.parameters[..].into(),
            features: case.features[..].into(),
            state_before: case.state.as_deref().map_or_else(caphy_core::array::In::absent, Into::into),
            tape: forward.tape[..].into(),
            output_gradient: case.output_gradient[..].into(),
            parameter_gradient: twice.parameters.as_mut_slice().into(),
            feature_gradient: twice.features.as_mut_slice().into(),
        };
        net.backward(BackwardCall::F64(&mut block)).unwrap();
        let doubled: Vec<f64> = once.parameters.iter().map(|g| 2.0 * g).collect();
        assert!(difference(&twice.parameters, &doubled) < 1e-14, "{name}");
        assert_eq!(twice.features, once.features, "{name}");
    }
}
