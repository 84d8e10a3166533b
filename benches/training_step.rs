//! One training step by the trainer's own functions, at T-shirt scale: about 4400 vertices, 16 windows of 5 frames, a body of
//! about 10 500 vertices cut down to what the shirt can reach and posed in the step, all terms but Chamfer; with the split by
//! stage.
//!
//! `cargo bench --bench training_step`

use caphy::config::TrainConfig;
use caphy::garment::FittedGarment;
use caphy::plugins::{Kind, PluginTable, Plugins};
use caphy::track::{BodyTrack, Reach};
use caphy::trainer::{Batch, BatchKind, GarmentLearner, MotionFrames, ScanFrames, untrained};
use caphy_bodymodel::BodyMannequin;
use caphy_bodymodel::procedural_motion::{MotionKind, procedural_clip};
use caphy_core::Vec3;
use caphy_core::body::{BodyModel, BodyParameters};
use caphy_core::material::MaterialModel;
use caphy_garment::energy::ScanCloud;
use caphy_garment::skinning::WeightOptions;
use caphy_garment::template::{BodyRest, Style, Tailor, UpperStyle};
use criterion::{Criterion, criterion_group, criterion_main};
use std::hint::black_box;
use std::path::Path;
use std::sync::Arc;

fn training_step(c: &mut Criterion) {
    let body = BodyMannequin { resolution: 0.0193 }.generate().expect("the mannequin can be made");
    let body: Arc<dyn BodyModel> = Arc::new(body);
    let joints = body.describe().joints.len();
    let subject = BodyParameters::rest(joints, &[]);
    let rest = BodyRest::from_model(&*body, &subject).expect("a body at rest");
    let rest_mesh = rest.mesh.clone();
    let style = UpperStyle { sleeve_length: 0.4, body_length: 0.5, looseness: 0.02, neckline: 0.3 };
    let template = Tailor::new(rest).and_then(|t| t.generate(&Style::Upper(style), 0.0154)).expect("a shirt");
    let shirt = FittedGarment::new(template, &rest_mesh.vertices, &body.describe().weights, &WeightOptions::default())
        .expect("weights");
    let reach = Reach::new(&rest_mesh, &[&shirt.mesh.vertices], 0.12).expect("a reachable body");
    let clip = procedural_clip(MotionKind::Walk, 1, 4.0, 30.0).expect("a clip");
    // A limit of 0: nothing is kept, bodies are posed in the step.
    let track = BodyTrack::within(0, &body, &subject, &reach, &clip.poses).expect("posed bodies");
    println!(
        "shirt {} vertices, body {} vertices of which {} can be reached",
        shirt.mesh.vertices.len(),
        rest_mesh.vertices.len(),
        reach.vertices.len()
    );
    let count = clip.poses.len();
    let motion = MotionFrames {
        track,
        starts: (0..count - 5).collect(),
        has_before: (0..count).map(|i| i > 0).collect(),
        fps: 30.0,
    };
    let scan_track = Arc::new(BodyTrack::new(&*body, &subject, &reach, &clip.poses[..1]).expect("a posed body"));
    let cloud = ScanCloud::new("bench", &[Vec3::zeros()]).expect("a cloud");
    let scans = ScanFrames { track: scan_track, clouds: vec![cloud], visible: vec![true; shirt.mesh.vertices.len()] };
    // The step itself; what leads into its windows is measured beside it.
    let config = TrainConfig { lead_in: 0, ..TrainConfig::default() };
    let led = TrainConfig::default();
    let (plugins, path) = (Plugins::new().expect("linked plugins"), Path::new("bench.toml"));
    let net = PluginTable::parse(&plugins, Kind::Net, path, "type = \"gru\"").expect("a net");
    let first = untrained(&shirt, body.describe(), &net, &config, &motion, &scans.track, 1).expect("an untrained net");
    let batch = Batch {
        frames: (0..5).flat_map(|t| (0..16).map(move |w| 7 * w + t)).collect(),
        windows: 16,
        kind: BatchKind::Windows,
    };
    for (material, table) in [
        ("stvk", "type = \"stvk\"\nyoung_pa = 0.7e5\npoisson = 0.485\nthickness_m = 0.47e-3\ndensity_kg_per_m2 = 0.2"),
        ("measured", "type = \"measured\"\nfabric = \"gray-interlock\""),
    ] {
        let table = PluginTable::parse(&plugins, Kind::Material, path, table).expect("a material's table");
        let model: Arc<dyn MaterialModel> = Arc::from(table.material("material").expect("a material"));
        let contact = reach.contact(&rest_mesh, &shirt).expect("a contact map");
        let mut learner = GarmentLearner::new(&shirt, &first, model.clone(), &net, &config, &motion, &scans, contact)
            .expect("a learner");
        for threads in [1, std::thread::available_parallelism().map_or(1, usize::from)] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
            let mut group = c.benchmark_group(format!("{material}, {threads} threads"));
            group.sample_size(10);
            split(&pool, &mut learner, &batch, &format!("{material}, {threads} threads"));
            group.bench_function("forward (net, body, skinning, energies)", |b| {
                b.iter(|| pool.install(|| black_box(learner.forward(&batch).expect("a pass"))));
            });
            let pass = learner.forward(&batch).expect("a pass");
            group.bench_function("backward and Adam", |b| {
                b.iter(|| {
                    pool.install(|| {
                        learner.backward(&pass).expect("a gradient");
                        black_box(learner.step(1e-9, 1.0).expect("a step"))
                    })
                });
            });
            let contact = reach.contact(&rest_mesh, &shirt).expect("a contact map");
            let mut under_way =
                GarmentLearner::new(&shirt, &first, model.clone(), &net, &led, &motion, &scans, contact)
                    .expect("a learner");
            group.bench_function(format!("whole step, {} frames leading in", led.lead_in), |b| {
                b.iter(|| {
                    pool.install(|| {
                        let pass = under_way.forward(&batch).expect("a pass");
                        under_way.backward(&pass).expect("a gradient");
                        black_box(under_way.step(1e-9, 1.0).expect("a step"))
                    })
                });
            });
            group.bench_function("whole step", |b| {
                b.iter(|| {
                    pool.install(|| {
                        let pass = learner.forward(&batch).expect("a pass");
                        learner.backward(&pass).expect("a gradient");
                        black_box(learner.step(1e-9, 1.0).expect("a step"))
                    })
                });
            });
            group.finish();
        }
    }
}

/// Prints where the time of a step goes, by the learner's own clock: the fastest of some steps, since other work on the machine
/// only ever adds.
fn split(pool: &rayon::ThreadPool, learner: &mut GarmentLearner<'_>, batch: &Batch, what: &str) {
    let mut step = || {
        learner.set_profiling(true);
        let started = std::time::Instant::now();
        pool.install(|| {
            let pass = learner.forward(batch).expect("a pass");
            learner.backward(&pass).expect("a gradient");
            learner.step(1e-9, 1.0).expect("a step");
        });
        (started.elapsed(), learner.profile())
    };
    let fastest = (0..60).map(|_| step()).min_by_key(|s| s.0).expect("steps");
    let ms = |time: std::time::Duration| time.as_secs_f64() * 1e3;
    println!("{what}: fastest of 60 steps {:.1} ms", ms(fastest.0));
    for (stage, time) in &fastest.1 {
        println!("  {stage:18} {:6.2} ms", ms(*time));
    }
    println!("  {:18} {:6.2} ms", "rest", ms(fastest.0 - fastest.1.iter().map(|s| s.1).sum()));
    learner.set_profiling(false);
}

criterion_group!(benches, training_step);
criterion_main!(benches);
