//! Whole steps of a small shirt: the same bits whatever the threads, whatever memory held before, wherever bodies come from.

use super::*;
use crate::plugins::{Kind, Plugins};
use crate::track::Reach;
use caphy_bodymodel::BodyMannequin;
use caphy_bodymodel::procedural_motion::{MotionKind, procedural_clip};
use caphy_core::Vec3;
use caphy_core::body::{BodyModel, BodyParameters};
use caphy_garment::skinning::WeightOptions;
use caphy_garment::template::{BodyRest, Style, Tailor, UpperStyle};
use std::path::Path;

/// A batch of windows, one of scans, one of fewer windows, one of single poses.
fn batches() -> [Batch; 4] {
    let windows = |count: usize| Batch {
        frames: (0..4).flat_map(|t| (0..count).map(move |w| 3 * w + t)).collect(),
        windows: count,
        kind: BatchKind::Windows,
    };
    let still = Batch { frames: (0..7).map(|i| 4 * i).collect(), windows: 7, kind: BatchKind::Still };
    [windows(6), Batch { frames: vec![1, 0], windows: 2, kind: BatchKind::Scans }, windows(3), still]
}

#[test]
fn threads_used_memory_and_kept_bodies_do_not_change_a_bit_and_the_clock_names_every_stage() {
    let body: Arc<dyn BodyModel> = Arc::new(BodyMannequin { resolution: 0.03 }.generate().unwrap());
    let subject = BodyParameters::rest(body.describe().joints.len(), &[]);
    let rest = BodyRest::from_model(&*body, &subject).unwrap();
    let skin = rest.mesh.clone();
    let style = UpperStyle { sleeve_length: 0.3, body_length: 0.5, looseness: 0.02, neckline: 0.3 };
    let template = Tailor::new(rest).unwrap().generate(&Style::Upper(style), 0.035).unwrap();
    let shirt =
        FittedGarment::new(template, &skin.vertices, &body.describe().weights, &WeightOptions::default()).unwrap();
    let reach = Reach::new(&skin, &[&shirt.mesh.vertices], 0.12).unwrap();
    let poses = procedural_clip(MotionKind::Walk, 1, 1.0, 30.0).unwrap().poses;
    let motion = |limit: usize| MotionFrames {
        track: BodyTrack::within(limit, &body, &subject, &reach, &poses).unwrap(),
        starts: (0..poses.len() - 4).collect(),
        has_before: (0..poses.len()).map(|i| i > 0).collect(),
        fps: 30.0,
    };
    let clouds = (0..2).map(|i| ScanCloud::new("scan", &[Vec3::new(0.1, 0.02 * f64::from(i), 0.1)]).unwrap()).collect();
    let scans = ScanFrames {
        track: Arc::new(BodyTrack::new(&*body, &subject, &reach, &poses[3..5]).unwrap()),
        clouds,
        visible: vec![true; shirt.mesh.vertices.len()],
    };
    let config = TrainConfig { lead_in: 0, ..TrainConfig::default() };
    let (plugins, path) = (Plugins::new().unwrap(), Path::new("test.toml"));
    let net = PluginTable::parse(&plugins, Kind::Net, path, "type = \"gru\"\nhidden = 24\nlayers = 2").unwrap();
    let fabric = PluginTable::parse(&plugins, Kind::Material, path, "type = \"measured\"\nfabric = \"gray-interlock\"");
    let material: Arc<dyn MaterialModel> = Arc::from(fabric.unwrap().material("material").unwrap());
    let (kept, posed) = (motion(usize::MAX), motion(0));
    let mut first = untrained(&shirt, body.describe(), &net, &config, &kept, &scans.track, 1).unwrap();
    // A head of zeros would hide what the net does.
    first.parameters.iter_mut().enumerate().for_each(|(i, p)| *p += 0.05 * (i as f32).sin());

    let watching = TrainConfig { lead_in: 3, ..TrainConfig::default() };
    let train_as = |config: &TrainConfig, triangles: bool, motion: &MotionFrames, threads: usize, order: &[usize]| {
        let contact = reach.contact(&skin, &shirt).unwrap();
        let mut learner =
            GarmentLearner::new(&shirt, &first, material.clone(), &net, config, motion, &scans, contact).unwrap();
        if triangles {
            learner.meet_triangles(&reach.faces).unwrap();
        }
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let batches = batches();
            // Passes that are thrown away leave their values in the memory of the next.
            for &wasted in order {
                learner.forward(&batches[wasted]).unwrap();
            }
            let mut energies = Vec::new();
            for batch in &batches {
                let pass = learner.forward(batch).unwrap();
                learner.backward(&pass).unwrap();
                learner.step(1e-3, 1.0).unwrap();
                energies.push(pass.energies.clone());
            }
            (learner.snapshot(), energies)
        })
    };
    let train = |motion: &MotionFrames, threads, order: &[usize]| train_as(&config, false, motion, threads, order);
    let reference = train(&kept, 1, &[]);
    assert!(reference.1[0].iter().any(|(name, e)| *name == "collision" && *e > 0.0), "{:?}", reference.1);
    assert!(reference == train(&kept, 2, &[2, 0, 1, 1]));
    assert!(reference == train(&posed, 2, &[0, 2]));
    // Knobs that act, as repeatably.
    for (config, triangles) in [(&watching, false), (&config, true)] {
        let changed = train_as(config, triangles, &kept, 1, &[]);
        assert!(changed.0 != reference.0);
        assert!(changed == train_as(config, triangles, &posed, 2, &[2, 1]));
    }
    // What the net carries into a window counts by itself, too.
    let weights = crate::config::TermWeights { inertia: 0.0.into(), ..Default::default() };
    let still = |lead_in: usize| TrainConfig { lead_in, weights: weights.clone(), ..TrainConfig::default() };
    assert!(train_as(&still(3), false, &kept, 1, &[]) != train_as(&still(0), false, &kept, 1, &[]));
    // Inertia counts in every frame that something led into: here all of them, without in two of four.
    let inertia = |energies: &TermEnergies| energies.iter().find(|e| e.0 == "inertia").map(|e| e.1);
    let led = train_as(&watching, false, &kept, 1, &[]);
    assert!(inertia(&led.1[0]) != inertia(&reference.1[0]) && inertia(&led.1[0]).is_some());

    let contact = reach.contact(&skin, &shirt).unwrap();
    let mut learner = GarmentLearner::new(&shirt, &first, material, &net, &config, &posed, &scans, contact).unwrap();
    learner.forward(&batches()[0]).unwrap();
    assert!(learner.profile().is_empty());
    learner.set_profiling(true);
    let started = std::time::Instant::now();
    let pass = learner.forward(&batches()[0]).unwrap();
    learner.backward(&pass).unwrap();
    learner.step(1e-3, 1.0).unwrap();
    let (whole, profile) = (started.elapsed(), learner.profile());
    let stages = "net forward, skinning, body, contact search, strain, bending, gravity, inertia, collision, attachment, \
                  limit of frames, skinning backward, net backward, Adam";
    assert_eq!(profile.iter().map(|s| s.0).collect::<Vec<_>>().join(", "), stages);
    let sum: Duration = profile.iter().map(|s| s.1).sum();
    assert!(sum <= whole);
}
