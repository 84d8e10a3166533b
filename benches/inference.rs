//! One pose of a trained garment at T-shirt scale (about 4400 vertices), one thread: the net alone, and with skinning.
//!
//! `RAYON_NUM_THREADS=1 cargo bench --bench inference`

use caphy::garment::{FittedGarment, TrainedGarment};
use caphy::inference::Player;
use caphy::plugins::{Kind, PluginTable, Plugins};
use caphy_bodymodel::BodyMannequin;
use caphy_bodymodel::procedural_motion::{MotionKind, procedural_clip};
use caphy_core::Vec3;
use caphy_core::body::{BodyModel, BodyParameters};
use caphy_garment::features::{FeatureOptions, PoseFeatures, moving_joints};
use caphy_garment::skinning::WeightOptions;
use caphy_garment::template::{BodyRest, Style, Tailor, UpperStyle};
use criterion::{Criterion, criterion_group, criterion_main};
use std::hint::black_box;
use std::path::Path;

fn inference(c: &mut Criterion) {
    let body = BodyMannequin::default().generate().expect("the mannequin can be made");
    let subject = BodyParameters::rest(body.describe().joints.len(), &[]);
    let rest = BodyRest::from_model(&body, &subject).expect("a body at rest");
    let skin = rest.mesh.vertices.clone();
    let style = UpperStyle { sleeve_length: 0.4, body_length: 0.5, looseness: 0.02, neckline: 0.3 };
    let template = Tailor::new(rest).and_then(|t| t.generate(&Style::Upper(style), 0.0154)).expect("a shirt");
    let shirt =
        FittedGarment::new(template, &skin, &body.describe().weights, &WeightOptions::default()).expect("weights");
    let clip = procedural_clip(MotionKind::Walk, 1, 4.0, 30.0).expect("a clip");
    let transforms: Vec<_> = clip
        .poses
        .iter()
        .map(|pose| body.skeleton(&subject.posed(pose)).expect("a posed skeleton").transforms)
        .collect();
    let joints = moving_joints(&body.describe().joints, &shirt.weights);
    let gravity = Vec3::new(0.0, -9.81, 0.0);
    let options = FeatureOptions { root_velocity: true, ..FeatureOptions::default() };
    let features = PoseFeatures::new(joints, options, gravity).expect("features");
    let (plugins, path) = (Plugins::new().expect("linked plugins"), Path::new("bench.toml"));
    let spec = PluginTable::parse(&plugins, Kind::Net, path, "type = \"gru\"").expect("a net");
    let net = spec.net(features.count(), 3 * shirt.mesh.vertices.len()).expect("a net");
    let trained = TrainedGarment {
        kind: shirt.kind,
        manifest: net.manifest().clone(),
        parameters: net.initialise(1).expect("parameters").into_iter().map(|p| p as f32).collect(),
        features,
        output_scale_m: 0.02,
        fps: 30.0,
        material: None,
        curve: Vec::new(),
    };
    println!("shirt {} vertices, net of {} parameters", shirt.mesh.vertices.len(), trained.parameters.len());
    let mut player = Player::new(&shirt, &trained, &spec).expect("a player");
    println!("{} threads", rayon::current_num_threads());
    let mut frame = 0;
    let mut next = || {
        frame = frame % (clip.poses.len() - 1) + 1;
        (&clip.poses[frame], Some(&clip.poses[frame - 1]), &transforms[frame])
    };
    let mut net = |player: &mut Player<'_>| {
        let (pose, before, _) = next();
        black_box(player.displace(pose, before).expect("displacements")[0]);
    };
    fastest("net", || net(&mut player));
    let mut group = c.benchmark_group("one pose");
    group.bench_function("net", |b| b.iter(|| net(&mut player)));
    let mut whole = |player: &mut Player<'_>| {
        let (pose, before, transforms) = next();
        black_box(player.frame(pose, before, transforms).expect("a garment")[0]);
    };
    fastest("net and skinning", || whole(&mut player));
    group.bench_function("net and skinning", |b| b.iter(|| whole(&mut player)));
    group.finish();
}

/// Prints the fastest of many calls: other work on the machine only ever adds.
fn fastest(what: &str, mut call: impl FnMut()) {
    let time = |call: &mut dyn FnMut()| {
        let started = std::time::Instant::now();
        call();
        started.elapsed()
    };
    let least = (0..3000).map(|_| time(&mut call)).min().expect("calls");
    println!("{what}: fastest of 3000 poses {:.3} ms", least.as_secs_f64() * 1e3);
}

criterion_group!(benches, inference);
criterion_main!(benches);
