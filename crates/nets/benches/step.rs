//! One training step of the net alone at T-shirt scale: 4424 vertices, 16 windows of 5 frames, single precision, one
//! thread: GRU(4 x 256) and head 256 -> 13272, forward, backward, Adam with clipping.

use caphy_core::array::{In, Out};
use caphy_core::net::{BackwardBlock, BackwardCall, DeformationNet, ForwardBlock, ForwardCall};
use caphy_nets::adam::Adam;
use caphy_nets::{NetGru, NetGruSpec};
use criterion::{Criterion, criterion_group, criterion_main};

const STEPS: usize = 5;
const BATCH: usize = 16;
const INPUTS: usize = 85;
const OUTPUTS: usize = 3 * 4424;

struct Step {
    net: NetGru,
    parameters: Vec<f32>,
    features: Vec<f32>,
    output: Vec<f32>,
    output_gradient: Vec<f32>,
    tape: Vec<f32>,
    gradient: Vec<f32>,
    moments: (Vec<f32>, Vec<f32>),
    adam: Adam,
}

impl Step {
    fn new() -> Self {
        let net = NetGru::new(&NetGruSpec::default(), INPUTS, OUTPUTS).expect("sizes in range");
        let parameters: Vec<f32> = net.initialise(1).expect("values").iter().map(|v| *v as f32).collect();
        let n = parameters.len();
        let wave = |n: usize, scale: f32| (0..n).map(|i| scale * (i as f32 * 0.7).sin()).collect::<Vec<f32>>();
        Self {
            features: wave(STEPS * BATCH * INPUTS, 1.0),
            output: vec![0.0; STEPS * BATCH * OUTPUTS],
            output_gradient: wave(STEPS * BATCH * OUTPUTS, 1e-3),
            tape: vec![0.0; net.tape_len(STEPS, BATCH).expect("a length")],
            gradient: vec![0.0; n],
            moments: (vec![0.0; n], vec![0.0; n]),
            adam: Adam { learning_rate: 1e-6, ..Adam::default() },
            parameters,
            net,
        }
    }

    fn forward(&mut self) {
        let mut block = ForwardBlock {
            steps: STEPS,
            batch: BATCH,
            parameters: self.parameters[..].into(),
            features: self.features[..].into(),
            state_before: In::absent(),
            output: self.output.as_mut_slice().into(),
            state_after: Out::absent(),
            tape: self.tape.as_mut_slice().into(),
        };
        self.net.forward(ForwardCall::F32(&mut block)).expect("lengths fit");
    }

    fn backward(&mut self) {
        let mut block = BackwardBlock {
            steps: STEPS,
            batch: BATCH,
            parameters: self.parameters[..].into(),
            features: self.features[..].into(),
            state_before: In::absent(),
            tape: self.tape[..].into(),
            output_gradient: self.output_gradient[..].into(),
            parameter_gradient: self.gradient.as_mut_slice().into(),
            feature_gradient: Out::absent(),
        };
        self.net.backward(BackwardCall::F32(&mut block)).expect("lengths fit");
    }

    fn adam(&mut self) {
        let (m, v) = &mut self.moments;
        self.adam.step(Some(1.0), &mut self.parameters, &mut self.gradient, m, v).expect("finite gradient");
    }
}

fn step(c: &mut Criterion) {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("a thread");
    let mut step = Step::new();
    let mut group = c.benchmark_group("gru 4x256, 80 meshes, one thread");
    group.sample_size(20);
    group.bench_function("forward", |b| b.iter(|| pool.install(|| step.forward())));
    group.bench_function("backward", |b| b.iter(|| pool.install(|| step.backward())));
    group.bench_function("adam", |b| b.iter(|| pool.install(|| step.adam())));
    group.bench_function("whole step", |b| {
        b.iter(|| {
            pool.install(|| {
                step.forward();
                step.backward();
                step.adam();
            })
        });
    });
    group.finish();
}

criterion_group!(benches, step);
criterion_main!(benches);
