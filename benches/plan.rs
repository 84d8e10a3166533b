//! What the scene plan saves on a T-shirt over a body of SMPL-X's size: bodies posed and nearest vertices searched, whole and
//! pruned; inputs of the net; terms that are off.
//!
//! `CAPHY_SHARED=… cargo bench --bench plan`; needs `data/body/anny_smplx_layout.npz` in that folder.

use caphy::config::{TermWeights, TrainConfig};
use caphy::garment::{FittedGarment, TrainedGarment};
use caphy::inputs;
use caphy::physics::GRAVITY;
use caphy::plugins::{Kind, PluginTable, Plugins};
use caphy::track::{BodyTrack, Reach};
use caphy::trainer::{Batch, BatchKind, GarmentLearner, MotionFrames, ScanFrames, untrained};
use caphy_bodymodel::procedural_motion::{MotionKind, procedural_clip};
use caphy_core::Vec3;
use caphy_core::body::{BlendWeights, BodyModel, BodyParameters};
use caphy_core::lanes::Frames;
use caphy_garment::contact::ContactMap;
use caphy_garment::energy::{ScanCloud, nearest_body_vertices};
use caphy_garment::features::{FeatureOptions, PoseFeatures};
use caphy_garment::skinning::WeightOptions;
use caphy_garment::template::{BodyRest, LowerStyle, Style, Tailor, UpperStyle};
use criterion::{Criterion, criterion_group, criterion_main};
use std::hint::black_box;
use std::path::{Path, PathBuf};
use std::sync::Arc;

fn plan(c: &mut Criterion) {
    let Some(shared) = std::env::var_os("CAPHY_SHARED").map(PathBuf::from) else {
        eprintln!("SKIPPED: CAPHY_SHARED does not say where data/body/anny_smplx_layout.npz is");
        return;
    };
    let file = shared.join("data/body/anny_smplx_layout.npz");
    let plugins = Plugins::new().expect("linked plugins");
    let body: Arc<dyn BodyModel> =
        Arc::from(inputs::body(&file.display().to_string(), &plugins).expect("a body of SMPL-X's size"));
    let subject = BodyParameters::rest(body.describe().joints.len(), &[]);
    let rest = BodyRest::from_model(&*body, &subject).expect("a body at rest");
    let skin = rest.mesh.clone();
    let style = UpperStyle { sleeve_length: 0.4, body_length: 0.5, looseness: 0.02, neckline: 0.3 };
    let tailor = Tailor::new(rest).expect("a tailor");
    let fitted = |style: &Style, edge: f64| {
        let template = tailor.generate(style, edge).expect("a garment");
        FittedGarment::new(template, &skin.vertices, &body.describe().weights, &WeightOptions::default())
            .expect("weights")
    };
    let (shirt, coarse) = (fitted(&Style::Upper(style), 0.0154), fitted(&Style::Upper(style), 0.028));
    let trousers = fitted(&Style::Lower(LowerStyle { leg_length: 0.9, looseness: 0.02, rise: 0.5 }), 0.0154);
    let clip = procedural_clip(MotionKind::Walk, 1, 4.0, 30.0).expect("a clip");
    let frames: Vec<usize> = (0..5).flat_map(|t| (0..16).map(move |w| 7 * w + t)).collect();
    let reach = |distance: f64| Reach::new(&skin, &[&shirt.mesh.vertices], distance).expect("a reachable body");
    let (near, whole) = (reach(0.12), reach(10.0));
    println!(
        "shirt {} vertices, body {} of {} vertices in contact",
        shirt.mesh.vertices.len(),
        near.vertices.len(),
        whole.vertices.len()
    );
    let one_joint = BlendWeights::from_rows(shirt.mesh.vertices.iter().map(|_| vec![(0u16, 1.0)]));
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("a thread");
    let mut garment = Frames::<f32>::zeros(5, shirt.mesh.vertices.len(), 16);
    let mut group = c.benchmark_group("80 frames, one thread");
    group.sample_size(10);
    let mut unpruned: Option<Vec<_>> = None;
    for (name, reach) in [("whole body", &whole), ("planned part", &near)] {
        // A limit of 0: bodies are posed whenever they are asked for.
        let track = BodyTrack::within(0, &body, &subject, reach, &clip.poses).expect("posed bodies");
        for (i, &frame) in frames.iter().enumerate() {
            let posed = shirt.skinned(&track.transforms[frame]).expect("a posed shirt");
            garment.set_frame(i / 16, i % 16, &posed).expect("a frame");
        }
        let (mut positions, mut normals) =
            (Frames::<f32>::zeros(5, track.vertices(), 16), Frames::<f32>::zeros(5, track.vertices(), 16));
        group.bench_function(format!("bodies posed, {name}"), |b| {
            b.iter(|| pool.install(|| track.gather_into(&frames, &mut positions, &mut normals).expect("bodies")));
        });
        group.bench_function(format!("nearest vertex, {name}"), |b| {
            b.iter(|| pool.install(|| black_box(nearest_body_vertices(&garment, &positions).expect("pairs"))));
        });
        let contact = reach.contact(&skin, &shirt).expect("a contact map");
        let mut nearest = Vec::new();
        group.bench_function(format!("contact map, {name}"), |b| {
            b.iter(|| pool.install(|| contact.nearest_into(&garment, &positions, &mut nearest).expect("pairs")));
        });
        // The same search without the plan: every part of the body is a candidate for all of the garment.
        let at: Vec<Vec3> = reach.vertices.iter().map(|&v| skin.vertices[v as usize]).collect();
        let every = ContactMap::new(&shirt.mesh.vertices, &one_joint, &at, &vec![Vec3::z(); at.len()], 10.0);
        let every = every.expect("a map of everything");
        let mut unlimited = Vec::new();
        group.bench_function(format!("every vertex a candidate, {name}"), |b| {
            b.iter(|| pool.install(|| every.nearest_into(&garment, &positions, &mut unlimited).expect("pairs")));
        });
        let ids = |found: &[u32]| found.iter().map(|&id| reach.vertices[id as usize]).collect::<Vec<_>>();
        if let Some(whole) = &unpruned {
            let same = ids(&unlimited).iter().zip(whole).filter(|(a, b)| a == b).count();
            let share = 100.0 * same as f64 / unlimited.len() as f64;
            println!("{name}: every vertex a candidate, {share:.2} % of pairs as with the whole body");
        } else {
            unpruned = Some(ids(&unlimited));
        }
        let same = nearest.iter().zip(&unlimited).filter(|(a, b)| a == b).count();
        println!("{name}: the map gives {:.2} % of pairs as without it", 100.0 * same as f64 / nearest.len() as f64);
    }
    group.finish();
    steps(c, &pool, &plugins, &body, &subject, &skin, [&shirt, &coarse, &trousers], &whole, &clip.poses);
}

/// A training step with or without a line of the plan.
#[derive(Clone, Copy)]
struct Variant<'a> {
    name: &'static str,
    garment: &'a FittedGarment,
    reach: &'a Reach,
    config: &'a TrainConfig,
    /// Whether bodies of all frames stay posed.
    kept: bool,
    /// Whether the net is told of joints that do not move the garment.
    every_joint: bool,
}

/// A net that is told of every joint of the body.
fn told_of_every_joint(
    planned: &TrainedGarment,
    spec: &PluginTable,
    body: &dyn BodyModel,
    motion: &MotionFrames,
) -> TrainedGarment {
    let joints = (1..body.describe().joints.len()).collect();
    let options = FeatureOptions { root_velocity: true, ..FeatureOptions::default() };
    let mut features = PoseFeatures::new(joints, options, GRAVITY).expect("features");
    let poses = &motion.track.poses;
    let raw = (0..poses.len()).map(|i| features.raw(&poses[i], i.checked_sub(1).map(|b| &poses[b]), 1.0 / motion.fps));
    let raw: Vec<_> = raw.collect::<Result<_, _>>().expect("features");
    features.standardise(&raw).expect("features");
    let net = spec.net(features.count(), planned.manifest.outputs).expect("a net");
    let parameters = net.initialise(1).expect("parameters").into_iter().map(|p| p as f32).collect();
    TrainedGarment { manifest: net.manifest().clone(), parameters, features, ..planned.clone() }
}

/// Whole steps, planned and not.
fn steps(
    c: &mut Criterion,
    pool: &rayon::ThreadPool,
    plugins: &Plugins,
    body: &Arc<dyn BodyModel>,
    subject: &BodyParameters,
    skin: &caphy_core::TriMesh,
    [shirt, coarse, trousers]: [&FittedGarment; 3],
    whole: &Reach,
    poses: &[caphy_core::pose::Pose],
) {
    let (config, path) = (TrainConfig { lead_in: 0, ..TrainConfig::default() }, Path::new("bench.toml"));
    let net = PluginTable::parse(plugins, Kind::Net, path, "type = \"gru\"").expect("a net");
    let fabric = PluginTable::parse(plugins, Kind::Material, path, "type = \"measured\"\nfabric = \"gray-interlock\"");
    let fabric = fabric.expect("a fabric's table");
    let batch = Batch {
        frames: (0..5).flat_map(|t| (0..16).map(move |w| 7 * w + t)).collect(),
        windows: 16,
        kind: BatchKind::Windows,
    };
    let mut group = c.benchmark_group("training step, one thread");
    group.sample_size(10);
    let without = |weights: TermWeights| TrainConfig { weights, ..config.clone() };
    let no_contact = without(TermWeights { collision: 0.0.into(), ..Default::default() });
    let no_inertia = without(TermWeights { inertia: 0.0.into(), ..Default::default() });
    let near = |garment: &FittedGarment| Reach::new(skin, &[&garment.mesh.vertices], 0.12).expect("a reachable body");
    let reaches = [shirt, coarse, trousers].map(near);
    let planned = Variant {
        name: "planned part",
        garment: shirt,
        reach: &reaches[0],
        config: &config,
        kept: false,
        every_joint: false,
    };
    let variants = [
        Variant { name: "whole body", reach: whole, ..planned },
        Variant { name: "bodies kept", kept: true, ..planned },
        Variant { name: "every joint an input", every_joint: true, ..planned },
        Variant { name: "contact off", config: &no_contact, ..planned },
        Variant { name: "inertia off", config: &no_inertia, ..planned },
        Variant { name: "edges of 28 instead of 15 mm", garment: coarse, reach: &reaches[1], ..planned },
        Variant { name: "a second garment, trousers", garment: trousers, reach: &reaches[2], ..planned },
        planned,
    ];
    for Variant { name, garment, reach, config, kept, every_joint } in variants {
        let count = poses.len();
        let limit = if kept { usize::MAX } else { 0 };
        let motion = MotionFrames {
            track: BodyTrack::within(limit, body, subject, reach, poses).expect("bodies"),
            starts: (0..count - 5).collect(),
            has_before: (0..count).map(|i| i > 0).collect(),
            fps: 30.0,
        };
        let scans = ScanFrames {
            track: Arc::new(BodyTrack::new(&**body, subject, reach, &poses[..1]).expect("a body")),
            clouds: vec![ScanCloud::new("bench", &[Vec3::zeros()]).expect("a cloud")],
            visible: vec![true; garment.mesh.vertices.len()],
        };
        let mut first = untrained(garment, body.describe(), &net, config, &motion, &scans.track, 1).expect("a net");
        if every_joint {
            first = told_of_every_joint(&first, &net, &**body, &motion);
        }
        println!("{name}: {} inputs, {} vertices", first.manifest.inputs, garment.mesh.vertices.len());
        let contact = reach.contact(skin, garment).expect("a contact map");
        let material = Arc::from(fabric.material("material").expect("a fabric"));
        let mut learner =
            GarmentLearner::new(garment, &first, material, &net, config, &motion, &scans, contact).expect("a learner");
        group.bench_function(name, |b| {
            b.iter(|| {
                pool.install(|| {
                    let pass = learner.forward(&batch).expect("a pass");
                    learner.backward(&pass).expect("a gradient");
                    black_box(learner.step(1e-9, 1.0).expect("a step"))
                })
            });
        });
    }
    group.finish();
}

criterion_group!(benches, plan);
criterion_main!(benches);
