//! The scene plan, line by line: what it leaves out changes nothing.

use caphy::config::{Schedule, TermWeights, TrainConfig};
use caphy::garment::{FittedGarment, TrainedGarment};
use caphy::physics::{Dynamics, GRAVITY, Physics};
use caphy::plugins::{Kind, PluginTable, Plugins};
use caphy::track::{BodyTrack, Reach};
use caphy::trainer::{Batch, BatchKind, GarmentLearner, MotionFrames, ScanFrames, untrained};
use caphy_bodymodel::BodyMannequin;
use caphy_bodymodel::procedural_motion::{MotionKind, procedural_clip};
use caphy_core::body::{BodyModel, BodyParameters};
use caphy_core::lanes::Frames;
use caphy_core::material::MaterialModel;
use caphy_core::net::NetManifest;
use caphy_core::pose::Pose;
use caphy_core::{TriMesh, Vec3};
use caphy_garment::energy::{
    BodyState, ContactOptions, Layer, Layering, LayeringOptions, ScanCloud, State, frame_normals,
};
use caphy_garment::features::{FeatureOptions, PoseFeatures};
use caphy_garment::skinning::WeightOptions;
use caphy_garment::template::{BodyRest, LowerStyle, Style, Tailor, UpperStyle};
use std::path::Path;
use std::sync::Arc;

/// A small person in a shirt and trousers, walking.
struct Dressed {
    body: Arc<dyn BodyModel>,
    subject: BodyParameters,
    skin: TriMesh,
    shirt: FittedGarment,
    trousers: FittedGarment,
    poses: Vec<Pose>,
    net: PluginTable,
    material: Arc<dyn MaterialModel>,
}

/// A batch of windows, one of single poses, one of scans.
fn batches() -> [Batch; 3] {
    [
        Batch {
            frames: (0..4).flat_map(|t| (0..5).map(move |w| 3 * w + t)).collect(),
            windows: 5,
            kind: BatchKind::Windows,
        },
        Batch { frames: (0..6).map(|i| 3 * i).collect(), windows: 6, kind: BatchKind::Still },
        Batch { frames: vec![1, 0], windows: 2, kind: BatchKind::Scans },
    ]
}

impl Dressed {
    fn new() -> Self {
        let body: Arc<dyn BodyModel> = Arc::new(BodyMannequin { resolution: 0.03 }.generate().expect("a body"));
        let subject = BodyParameters::rest(body.describe().joints.len(), &[]);
        let rest = BodyRest::from_model(&*body, &subject).expect("a body at rest");
        let skin = rest.mesh.clone();
        let tailor = Tailor::new(rest).expect("a tailor");
        let fitted = |style: Style| {
            let template = tailor.generate(&style, 0.035).expect("a garment");
            let weights = &body.describe().weights;
            FittedGarment::new(template, &skin.vertices, weights, &WeightOptions::default()).expect("weights")
        };
        let upper = UpperStyle { sleeve_length: 0.3, body_length: 0.5, looseness: 0.02, neckline: 0.3 };
        let lower = LowerStyle { leg_length: 0.9, looseness: 0.02, rise: 0.5 };
        let (shirt, trousers) = (fitted(Style::Upper(upper)), fitted(Style::Lower(lower)));
        let (plugins, path) = (Plugins::new().expect("plugins"), Path::new("plan.toml"));
        let table = |kind, text| PluginTable::parse(&plugins, kind, path, text).expect("a table");
        let fabric = table(Kind::Material, "type = \"measured\"\nfabric = \"gray-interlock\"");
        let poses = procedural_clip(MotionKind::Walk, 1, 1.0, 30.0).expect("a clip").poses;
        Self {
            net: table(Kind::Net, "type = \"gru\"\nhidden = 24\nlayers = 2"),
            material: Arc::from(fabric.material("material").expect("a fabric")),
            body,
            subject,
            skin,
            shirt,
            trousers,
            poses,
        }
    }
    fn motion(&self, reach: &Reach, kept: bool) -> MotionFrames {
        let limit = if kept { usize::MAX } else { 0 };
        let count = self.poses.len();
        MotionFrames {
            track: BodyTrack::within(limit, &self.body, &self.subject, reach, &self.poses).expect("bodies"),
            starts: (0..count - 4).collect(),
            has_before: (0..count).map(|i| i > 0).collect(),
            fps: 30.0,
        }
    }
    fn scans(&self, reach: &Reach, count: usize) -> ScanFrames {
        let cloud = |i: usize| ScanCloud::new("scan", &[Vec3::new(0.1, 0.02 * i as f64, 0.1)]).expect("a cloud");
        let track = BodyTrack::new(&*self.body, &self.subject, reach, &self.poses[3..3 + count]).expect("bodies");
        let visible = vec![true; self.shirt.mesh.vertices.len()];
        ScanFrames { track: Arc::new(track), clouds: (0..count).map(cloud).collect(), visible }
    }
    /// A net whose head says something.
    fn first(&self, motion: &MotionFrames, config: &TrainConfig) -> TrainedGarment {
        let track =
            BodyTrack::new(&*self.body, &self.subject, &self.reach(0.12, false), &self.poses[3..5]).expect("bodies");
        let mut first =
            untrained(&self.shirt, self.body.describe(), &self.net, config, motion, &track, 1).expect("a net");
        first.parameters.iter_mut().enumerate().for_each(|(i, p)| *p += 0.05 * (i as f32).sin());
        first
    }
    fn reach(&self, distance: f64, both: bool) -> Reach {
        let upper = &self.shirt.mesh.vertices[..];
        let garments = [upper, &self.trousers.mesh.vertices[..]];
        Reach::new(&self.skin, &garments[..if both { 2 } else { 1 }], distance).expect("a reachable body")
    }
    /// Energies and gradients of the batches, and the parameters' gradient summed over them.
    fn passes(&self, reach: &Reach, first: &TrainedGarment, config: &TrainConfig, kept: bool, only: usize) -> Passes {
        let (motion, scans) = (self.motion(reach, kept), self.scans(reach, 2));
        let contact = reach.contact(&self.skin, &self.shirt).expect("a contact map");
        let (net, material) = (&self.net, self.material.clone());
        let mut learner = GarmentLearner::new(&self.shirt, first, material, net, config, &motion, &scans, contact)
            .expect("a learner");
        let mut out = Passes::default();
        for batch in &batches()[..only] {
            let pass = learner.forward(batch).expect("a pass");
            learner.backward(&pass).expect("a gradient");
            out.energies.push(pass.energies.clone());
            out.positions.extend_from_slice(pass.positions.data());
            out.gradients.extend_from_slice(pass.gradient.data());
        }
        out.by_parameter = learner.gradient.clone();
        out
    }
}

#[derive(Default, PartialEq)]
struct Passes {
    energies: Vec<Vec<(&'static str, f64)>>,
    positions: Vec<f32>,
    gradients: Vec<f32>,
    by_parameter: Vec<f32>,
}

/// Largest difference over the largest value.
fn off(a: &[f32], b: &[f32]) -> f32 {
    assert_eq!(a.len(), b.len());
    let peak = a.iter().fold(0.0f32, |m, v| m.max(v.abs()));
    a.iter().zip(b).fold(0.0f32, |m, (a, b)| m.max((a - b).abs())) / peak
}

#[test]
fn body_vertices_that_no_garment_reaches() {
    let dressed = Dressed::new();
    let (near, whole) = (dressed.reach(0.12, false), dressed.reach(10.0, false));
    assert!(
        whole.vertices.len() == dressed.skin.vertices.len() && 2 * near.vertices.len() < whole.vertices.len() * 3 / 2
    );
    let config = TrainConfig { lead_in: 2, ..TrainConfig::default() };
    let first = dressed.first(&dressed.motion(&near, true), &config);
    let (pruned, full) =
        (dressed.passes(&near, &first, &config, true, 3), dressed.passes(&whole, &first, &config, true, 3));
    assert!(pruned.energies[0].iter().any(|(name, e)| *name == "collision" && *e > 0.0), "{:?}", pruned.energies);
    // Candidates for contact lie well inside of what is kept: the same bits.
    assert!(pruned == full);
}

#[test]
fn garments_that_are_not_trained_now() {
    // The reach of two garments is that of both; what the shirt learns does not see the difference.
    let dressed = Dressed::new();
    let (alone, both) = (dressed.reach(0.12, false), dressed.reach(0.12, true));
    assert!(alone.vertices.len() < both.vertices.len());
    let config = TrainConfig::default();
    let first = dressed.first(&dressed.motion(&alone, true), &config);
    assert!(dressed.passes(&alone, &first, &config, true, 3) == dressed.passes(&both, &first, &config, true, 3));
}

#[test]
fn poses_that_are_kept_or_posed_anew() {
    let dressed = Dressed::new();
    let reach = dressed.reach(0.12, false);
    let config = TrainConfig::default();
    let first = dressed.first(&dressed.motion(&reach, true), &config);
    assert!(dressed.passes(&reach, &first, &config, true, 3) == dressed.passes(&reach, &first, &config, false, 3));
}

/// Parameters of a net of fewer inputs in one of more: `column` says where each input went; new inputs weigh nothing.
fn widened(from: &NetManifest, values: &[f32], to: &NetManifest, column: &[usize]) -> Vec<f32> {
    let mut out = Vec::new();
    let mut at = 0;
    for (small, large) in from.tensors.iter().zip(&to.tensors) {
        assert_eq!(small.name, large.name);
        let part = &values[at..at + small.len()];
        at += small.len();
        if small.shape == large.shape {
            out.extend_from_slice(part);
            continue;
        }
        let (narrow, wide) = (small.shape[1], large.shape[1]);
        for row in part.chunks_exact(narrow) {
            let mut wider = vec![0.0; wide];
            row.iter().zip(column).for_each(|(w, c)| wider[*c] = *w);
            out.extend(wider);
        }
    }
    out
}

#[test]
fn joints_that_move_no_vertex() {
    let dressed = Dressed::new();
    let reach = dressed.reach(0.12, false);
    let config = TrainConfig { lead_in: 2, ..TrainConfig::default() };
    let motion = dressed.motion(&reach, true);
    let few = dressed.first(&motion, &config);
    // The same net told of every joint, standardised by the same frames.
    let joints: Vec<usize> = (1..dressed.body.describe().joints.len()).collect();
    let options = FeatureOptions { root_velocity: true, ..FeatureOptions::default() };
    let mut features = PoseFeatures::new(joints.clone(), options, GRAVITY).expect("features");
    let mut raw = Vec::new();
    for (frame, pose) in motion.track.poses.iter().enumerate() {
        let before = (frame > 0).then(|| &motion.track.poses[frame - 1]);
        raw.push(features.raw(pose, before, 1.0 / 30.0).expect("features"));
    }
    for pose in &dressed.poses[3..5] {
        raw.push(features.raw(pose, None, 1.0 / 30.0).expect("features"));
    }
    features.standardise(&raw).expect("features");
    let net = dressed.net.net(features.count(), 3 * dressed.shirt.mesh.vertices.len()).expect("a net");
    let per = features.options().rotation.len();
    let kept = few.features.joints();
    assert!(2 * kept.len() < joints.len(), "{} of {}", kept.len(), joints.len());
    let mut column: Vec<usize> = kept.iter().flat_map(|j| (0..per).map(move |k| (j - 1) * per + k)).collect();
    column.extend(joints.len() * per..features.count());
    assert_eq!(column.len(), few.features.count());
    let all = TrainedGarment {
        parameters: widened(&few.manifest, &few.parameters, net.manifest(), &column),
        manifest: net.manifest().clone(),
        features,
        ..few.clone()
    };
    let (pruned, full) =
        (dressed.passes(&reach, &few, &config, true, 3), dressed.passes(&reach, &all, &config, true, 3));
    // Sums with zeros in between come in another order: a few roundings of the net, through contact that stiffens with depth.
    assert!(off(&pruned.positions, &full.positions) < 1e-6, "{}", off(&pruned.positions, &full.positions));
    assert!(off(&pruned.gradients, &full.gradients) < 1e-3, "{}", off(&pruned.gradients, &full.gradients));
    let shared = widened(&few.manifest, &pruned.by_parameter, net.manifest(), &column);
    let mask = widened(&few.manifest, &vec![1.0; few.parameters.len()], net.manifest(), &column);
    let seen: Vec<f32> = full.by_parameter.iter().zip(&mask).map(|(g, m)| g * m).collect();
    assert!(off(&shared, &seen) < 1e-3, "{}", off(&shared, &seen));
}

#[test]
fn terms_that_are_off() {
    let dressed = Dressed::new();
    let reach = dressed.reach(0.12, false);
    let rest = dressed.shirt.rest(&*dressed.material).expect("a rest state");
    let motion = dressed.motion(&reach, true);
    let frames: Vec<usize> = (0..4).flat_map(|t| (0..5).map(move |w| 3 * w + t)).collect();
    let (body, normals) = motion.track.gather::<f64>(&frames, 5).expect("bodies");
    let mut x = Frames::<f64>::zeros(4, rest.vertex_count(), 5);
    for (i, &frame) in frames.iter().enumerate() {
        let posed = dressed.shirt.skinned(&motion.track.transforms[frame]).expect("a pose");
        x.set_frame(i / 5, i % 5, &posed).expect("a frame");
    }
    let contact = reach.contact(&dressed.skin, &dressed.shirt).expect("a contact map");
    let nearest = contact.nearest(&x, &body).expect("pairs");
    let targets = Frames::<f64>::zeros(4, 0, 5);
    let state = State::new(&x)
        .with_body(BodyState { positions: &body, normals: &normals, nearest: Some(&nearest) })
        .with_targets(&targets);
    let gradient = |weights: &TermWeights, dynamics, x: &State<'_, f64>| {
        let contact = ContactOptions::default();
        let physics = Physics::<f64>::new(&rest, dressed.material.clone(), &contact, 30.0, weights).expect("physics");
        let mut out = Frames::zeros(4, rest.vertex_count(), 5);
        let energies = physics.add(x, dynamics, 1.0, Some(&mut out)).expect("energies");
        (energies, out)
    };
    let zero = || Schedule::from(0.0);
    let none = || TermWeights {
        strain: zero(),
        bending: zero(),
        gravity: zero(),
        inertia: zero(),
        collision: zero(),
        attachment: zero(),
        scan: zero(),
        layering: zero(),
    };
    let all = TermWeights::default();
    let (_, whole) = gradient(&all, Dynamics::Moving, &state);
    let peak = whole.data().iter().fold(0.0f64, |m, g| m.max(g.abs()));
    // What is left out is what that term alone would have added, and is not named among the energies.
    type Pick = fn(&mut TermWeights) -> &mut Schedule;
    let terms: [(&str, Pick); 5] = [
        ("strain", |w| &mut w.strain),
        ("bending", |w| &mut w.bending),
        ("gravity", |w| &mut w.gravity),
        ("inertia", |w| &mut w.inertia),
        ("collision", |w| &mut w.collision),
    ];
    for (name, pick) in terms {
        let (mut without, mut alone) = (all.clone(), none());
        *pick(&mut without) = zero();
        *pick(&mut alone) = pick(&mut all.clone()).clone();
        let (energies, rest_of_it) = gradient(&without, Dynamics::Moving, &state);
        let (one, part) = gradient(&alone, Dynamics::Moving, &state);
        assert!(energies.iter().all(|e| e.0 != name) && one.len() == 1 && one[0].0 == name, "{name}: {one:?}");
        for ((w, r), p) in whole.data().iter().zip(rest_of_it.data()).zip(part.data()) {
            assert!((w - r - p).abs() < 1e-13 * peak, "{name}");
        }
    }
    // A shirt has no waistband: its springs are none.
    let (_, without) = gradient(&TermWeights { attachment: zero(), ..all.clone() }, Dynamics::Moving, &state);
    assert!(without == whole);
    // Where nothing moves, inertia has no force.
    let mut still = x.clone();
    for i in 0..frames.len() {
        let posed = x.frame(0, i % 5);
        still.set_frame(i / 5, i % 5, &posed).expect("a frame");
    }
    let state = State { positions: &still, ..state };
    let (_, moving) = gradient(&all, Dynamics::Moving, &state);
    let (energies, standing) = gradient(&all, Dynamics::Static, &state);
    assert!(moving == standing && energies.iter().all(|e| e.0 != "inertia"));
}

#[test]
fn layering_of_one_garment_and_scans_that_are_none() {
    let dressed = Dressed::new();
    // The other garment, so far away that it might not be there.
    let (upper, lower) = (
        dressed.shirt.rest(&*dressed.material).expect("a rest state"),
        dressed.trousers.rest(&*dressed.material).expect("a rest state"),
    );
    let frame = |points: &[Vec3], shift: f64| {
        let mut x = Frames::<f64>::zeros(1, points.len(), 1);
        let moved: Vec<Vec3> = points.iter().map(|p| p + Vec3::repeat(shift)).collect();
        x.set_frame(0, 0, &moved).expect("a frame");
        x
    };
    let (xu, xl) = (frame(&upper.template.vertices, 0.0), frame(&lower.template.vertices, 9.0));
    let layering = Layering::new(&upper, &lower, LayeringOptions::default()).expect("layering");
    let (mut energy, mut gradient) = ([0.0], Frames::zeros(1, upper.vertex_count(), 1));
    let layer = Layer { positions: &xu, gradient: Some(&mut gradient) };
    layering.add(layer, Layer { positions: &xl, gradient: None }, 1.0, &mut energy).expect("energies");
    assert!(energy == [0.0] && gradient.data().iter().all(|g| *g == 0.0));
    assert!(frame_normals(&xu, upper.faces()).is_ok());

    // Batches of motion are the same with and without scans.
    let reach = dressed.reach(0.12, false);
    let config = TrainConfig::default();
    let motion = dressed.motion(&reach, true);
    let first = dressed.first(&motion, &config);
    let run = |scans: &ScanFrames| {
        let contact = reach.contact(&dressed.skin, &dressed.shirt).expect("a contact map");
        let (net, material) = (&dressed.net, dressed.material.clone());
        let learner = GarmentLearner::new(&dressed.shirt, &first, material, net, &config, &motion, scans, contact)
            .expect("a learner");
        let pass = learner.forward(&batches()[0]).expect("a pass");
        (pass.energies.clone(), pass.gradient.data().to_vec())
    };
    assert!(run(&dressed.scans(&reach, 2)) == run(&dressed.scans(&reach, 0)));
}

#[test]
fn contact_that_is_off_needs_no_body() {
    let dressed = Dressed::new();
    let reach = dressed.reach(0.12, false);
    let off = TrainConfig {
        weights: TermWeights { collision: 0.0.into(), ..TermWeights::default() },
        ..TrainConfig::default()
    };
    let first = dressed.first(&dressed.motion(&reach, true), &off);
    let (motion, scans) = (dressed.motion(&reach, true), dressed.scans(&reach, 2));
    let contact = reach.contact(&dressed.skin, &dressed.shirt).expect("a contact map");
    let mut learner = GarmentLearner::new(
        &dressed.shirt,
        &first,
        dressed.material.clone(),
        &dressed.net,
        &off,
        &motion,
        &scans,
        contact,
    )
    .expect("a learner");
    learner.set_profiling(true);
    learner.forward(&batches()[0]).expect("a pass");
    let stages: Vec<&str> = learner.profile().iter().map(|s| s.0).collect();
    assert!(!stages.contains(&"body") && !stages.contains(&"contact search"), "{stages:?}");
    // The other terms are those of a run that meets the body.
    let (without, with) = (
        dressed.passes(&reach, &first, &off, true, 1),
        dressed.passes(&reach, &first, &TrainConfig::default(), true, 1),
    );
    let of = |p: &Passes| p.energies[0].iter().filter(|e| e.0 != "collision").copied().collect::<Vec<_>>();
    assert!(of(&without) == of(&with) && without.positions == with.positions);
}
