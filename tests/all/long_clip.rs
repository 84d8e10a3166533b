//! A clip of eleven seconds, though training saw windows of five frames: its beginning is forgotten and nothing drifts.

use caphy::config::TrainConfig;
use caphy::garment::{FittedGarment, TrainedGarment};
use caphy::inference::{Play, play};
use caphy::plugins::{Kind, PluginTable, Plugins};
use caphy::track::{BodyTrack, Reach};
use caphy::trainer::{self, Batch, BatchKind, GarmentLearner, MotionFrames, ScanFrames};
use caphy_bodymodel::BodyMannequin;
use caphy_bodymodel::procedural_motion::{MotionKind, procedural_clip};
use caphy_core::body::{BodyModel, BodyParameters};
use caphy_core::extension::DeformationNetExt;
use caphy_core::pose::Pose;
use caphy_core::{TriMesh, Vec3};
use caphy_garment::energy::ScanCloud;
use caphy_garment::skinning::WeightOptions;
use caphy_garment::template::{BodyRest, Style, Tailor, UpperStyle};
use std::f64::consts::TAU;
use std::path::Path;
use std::sync::Arc;

const FPS: f64 = 30.0;
/// Frames after which the long clip's poses repeat.
const PERIOD: usize = 30;
/// The first frame of the period that is looked at; the clip ends with that period.
const LATE: usize = 300;
/// Way per frame [m]: walking.
const PACE: f64 = 0.04;

/// A coarse shirt on a coarse mannequin.
struct Shirt {
    body: Box<dyn BodyModel>,
    subject: BodyParameters,
    rest: TriMesh,
    garment: FittedGarment,
    reach: Reach,
    net: PluginTable,
    material: PluginTable,
    config: TrainConfig,
}

impl Shirt {
    fn new() -> Shirt {
        let body = BodyMannequin { resolution: 0.03 }.generate().expect("a mannequin");
        let subject = BodyParameters::rest(body.describe().joints.len(), &[]);
        let rest = BodyRest::from_model(&body, &subject).expect("a body at rest");
        let mesh = rest.mesh.clone();
        let style = UpperStyle { sleeve_length: 0.4, body_length: 0.5, looseness: 0.02, neckline: 0.3 };
        let template = Tailor::new(rest).and_then(|t| t.generate(&Style::Upper(style), 0.05)).expect("a shirt");
        let weights = &body.describe().weights;
        let garment =
            FittedGarment::new(template, &mesh.vertices, weights, &WeightOptions::default()).expect("weights");
        let reach = Reach::new(&mesh, &[&garment.mesh.vertices], 0.12).expect("a reachable body");
        let plugins = Plugins::new().expect("linked plugins");
        let table = |kind, text| PluginTable::parse(&plugins, kind, Path::new("test.toml"), text).expect("a table");
        Shirt {
            body: Box::new(body),
            subject,
            rest: mesh,
            garment,
            reach,
            net: table(Kind::Net, "type = \"gru\"\nlayers = 2\nhidden = 32"),
            material: table(Kind::Material, "type = \"measured\"\nfabric = \"gray-interlock\""),
            config: TrainConfig { learning_rate: 2e-3, ..TrainConfig::default() },
        }
    }

    fn track(&self, poses: &[Pose]) -> BodyTrack {
        BodyTrack::new(&*self.body, &self.subject, &self.reach, poses).expect("posed bodies")
    }

    fn motion(&self, poses: &[Pose]) -> MotionFrames {
        let starts = (0..=poses.len() - self.config.window).collect();
        let has_before = (0..poses.len()).map(|i| i > 0).collect();
        MotionFrames { track: self.track(poses), starts, has_before, fps: FPS }
    }

    fn scans(&self, pose: &Pose) -> ScanFrames {
        ScanFrames {
            track: Arc::new(self.track(std::slice::from_ref(pose))),
            clouds: vec![ScanCloud::new("none", &[Vec3::zeros()]).expect("a cloud")],
            visible: vec![true; self.garment.mesh.vertices.len()],
        }
    }

    fn learner<'a>(&self, net: &TrainedGarment, motion: &'a MotionFrames, scans: &'a ScanFrames) -> GarmentLearner<'a> {
        let material = Arc::from(self.material.material("material").expect("a material"));
        let contact = self.reach.contact(&self.rest, &self.garment).expect("a contact map");
        GarmentLearner::new(&self.garment, net, material, &self.net, &self.config, motion, scans, contact)
            .expect("a learner")
    }

    /// A net before and after some steps on windows of walking.
    fn trained(&self, clip: &[Pose], steps: usize) -> [TrainedGarment; 2] {
        let (motion, scans) = (self.motion(clip), self.scans(&clip[0]));
        let first =
            trainer::untrained(&self.garment, self.body.describe(), &self.net, &self.config, &motion, &scans.track, 1)
                .expect("an untrained net");
        let mut learner = self.learner(&first, &motion, &scans);
        let windows = steps * self.config.batch;
        let batches = trainer::window_batches(&motion, &self.config, windows, 1, 0);
        for (step, batch) in batches.iter().enumerate() {
            let pass = learner.forward(batch).expect("a pass");
            learner.backward(&pass).expect("a gradient");
            let share = step as f64 / batches.len() as f64;
            let rate = trainer::learning_rate(&self.config, self.config.learning_rate, share);
            learner.step(rate, self.config.clip_norm).expect("a step");
        }
        let after = TrainedGarment { parameters: learner.parameters.clone(), ..first.clone() };
        [first, after]
    }
}

/// From one pose of a walk to another and back, over and over, while the figure walks away.
fn periodic(from: &Pose, to: &Pose, frames: usize) -> Vec<Pose> {
    let pose = |frame: usize| {
        let share = 0.5 - 0.5 * (TAU * (frame % PERIOD) as f64 / PERIOD as f64).cos();
        let rotations = from.rotations.iter().zip(&to.rotations).map(|(a, b)| a + (b - a) * share).collect();
        Pose { rotations, translation: from.translation + Vec3::z() * (PACE * frame as f64) }
    };
    (0..frames).map(pose).collect()
}

/// The largest distance between two garments in coordinates that move with the figure [m].
fn apart(a: &[Vec3], at: &Pose, b: &[Vec3], bt: &Pose) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - at.translation - (b - bt.translation)).norm()).fold(0.0, f64::max)
}

/// How far two equal garments can be apart by single precision [m]: a coordinate is a blend of some joints, and each
/// entry of their transforms, each product and each sum is rounded by half a unit in the last place of the way.
fn rounding(way: f64, joints: usize) -> f64 {
    let coordinate = (1 + 2 * joints) as f64 * way * f64::from(f32::EPSILON) / 2.0;
    2.0 * 3f64.sqrt() * coordinate
}

#[test]
fn carried_state_is_sane_at_frame_300() {
    let shirt = Shirt::new();
    let walk = procedural_clip(MotionKind::Walk, 1, 4.0, FPS).expect("a clip").poses;
    let [untrained, trained] = shirt.trained(&walk, 80);
    let poses = periodic(&walk[40], &walk[57], LATE + PERIOD);
    let (motion, scans) = (shirt.motion(&poses), shirt.scans(&poses[0]));
    let played = play(&shirt.garment, &trained, &shirt.net, &motion.track, Play::Clip).expect("a played clip");
    let weights = &shirt.garment.weights;
    let joints = (0..shirt.garment.mesh.vertices.len()).map(|v| weights.row(v).count()).max().expect("vertices");
    let rounding = rounding(PACE * poses.len() as f64 + 1.0, joints);

    // The poses repeat, and so must the cloth, once the beginning is forgotten.
    let repeats = |period: usize| {
        let frames = period * PERIOD..(period + 1) * PERIOD;
        frames.map(|f| apart(&played[f], &poses[f], &played[f + PERIOD], &poses[f + PERIOD])).fold(0.0, f64::max)
    };
    let (first, last) = (repeats(0), repeats(LATE / PERIOD - 1));
    println!("from one period to the next [m]: first {first:.1e}, last {last:.1e}, rounding {rounding:.1e}");
    assert!(last <= rounding, "cloth is {last} m elsewhere after a period, {rounding} m by rounding");
    assert!(first > 10.0 * rounding, "the beginning left no trace ({first} m): nothing was carried");

    // A clip that begins where joints turn at an even pace goes on from what was before it, which a pose alone does not know.
    let begins = LATE + PERIOD / 4;
    let cut = shirt.track(&poses[begins..]);
    let [led, alone] = [Play::Clip, Play::Poses].map(|how| {
        let part = play(&shirt.garment, &trained, &shirt.net, &cut, how).expect("a played clip");
        apart(&part[0], &poses[begins], &played[begins], &poses[begins])
    });
    println!("a clip's first frame from the carried state [m]: {led:.1e}, of a pose alone {alone:.1e}");
    assert!(led < 0.5 * alone, "the beginning of a clip leaps by {led} m, that of a pose by {alone} m");

    // Windows that start anew and end at a late frame: the longer, the nearer to the carried state.
    let learner = shirt.learner(&trained, &motion, &scans);
    let late: Vec<usize> = (LATE..LATE + PERIOD).collect();
    let restarted = |length: usize| {
        let mut largest = 0.0f64;
        for ends in late.chunks(shirt.config.batch) {
            let frames = (0..length).flat_map(|t| ends.iter().map(move |end| end + 1 + t - length)).collect();
            let batch = Batch { frames, windows: ends.len(), kind: BatchKind::Windows };
            let positions = learner.forward(&batch).expect("a pass").positions;
            for (lane, &end) in ends.iter().enumerate() {
                let fresh = positions.frame(length - 1, lane);
                largest = largest.max(apart(&fresh, &poses[end], &played[end], &poses[end]));
            }
        }
        largest
    };
    let lengths = [1, shirt.config.window, 10, 20, 40, 80];
    let gaps = lengths.map(restarted);
    println!("windows of {lengths:?} frames from the carried state [m]: {gaps:?}");
    assert!(gaps[1] > 10.0 * rounding, "windows as in training already remember everything");
    for (pair, length) in gaps.windows(2).zip(&lengths[1..]) {
        assert!(pair[1] <= pair[0].max(rounding), "{length} frames of memory are worse than fewer: {gaps:?}");
    }
    assert!(gaps[5] <= rounding, "{} m from a window of 80 frames, {rounding} m by rounding", gaps[5]);

    // What a gated unit holds is a mean of what it held and of a tanh.
    let net = shirt.net.net(trained.features.count(), trained.manifest.outputs).expect("a net");
    let mut state = vec![0.0f32; trained.manifest.state];
    for f in 0..poses.len() {
        let before = f.checked_sub(1).map(|b| &poses[b]);
        let features = trained.features.frame::<f32>(&poses[f], before, 1.0 / FPS).expect("features");
        net.frame(&trained.parameters, &features, &mut state).expect("a frame");
        assert!(state.iter().all(|s| s.abs() <= 1.0), "frame {f} holds {state:?}");
    }

    // What training gained in its windows is not lost in the long clip: static energies over the same thirty frames.
    let sum = |garment: &TrainedGarment, frames: Vec<usize>, windows: usize| -> f64 {
        let count = frames.len() as f64;
        let learner = shirt.learner(garment, &motion, &scans);
        let pass = learner.forward(&Batch { frames, windows, kind: BatchKind::Windows }).expect("a pass");
        pass.energies.iter().filter(|(name, _)| *name != "inertia").map(|(_, mean)| count * mean).sum()
    };
    let count = PERIOD / shirt.config.window;
    let windows: Vec<usize> =
        (0..shirt.config.window).flat_map(|t| (0..count).map(move |w| LATE + w * PERIOD / count + t)).collect();
    let before = sum(&untrained, windows.clone(), count);
    let fresh = sum(&trained, windows, count);
    let carried = sum(&trained, (0..LATE + PERIOD).collect(), 1) - sum(&trained, (0..LATE).collect(), 1);
    println!("energy of thirty frames [J]: untrained {before:.3}, in windows {fresh:.3}, in the clip {carried:.3}");
    assert!(fresh < before, "training gained nothing: {before} J, then {fresh} J");
    assert!(carried - fresh <= 0.1 * (before - fresh), "{carried} J in the clip, {fresh} J in windows of five");
}
