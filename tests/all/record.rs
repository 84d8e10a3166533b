//! What training leaves behind for people, and what it survives.

use crate::experiment::{Experiment, TINY, edited, files, value};
use crate::pipeline::{finished, on_threads, program};
use caphy::config::{Config, TrainConfig};
use caphy::files::ProjectFiles;
use caphy::physics::TermEnergies;
use caphy::progress::{Pace, Progress, Work};
use caphy::scene::{FrameNames, Scene, scan_frames};
use caphy::stage::preprocess::Subject;
use caphy::stage::train::{Alone, Nets, Pupil, Start};
use caphy::stage::{Context, train};
use caphy::trainer::{self, Batch, BatchKind, Fault, GarmentLearner, LearnerState};
use caphy::training::{GarmentStep, Order, Plan, Preview, Trainee, learn};
use caphy_core::material::{HingeCall, MaterialDescription, MaterialModel, MembraneCall};
use caphy_core::params::Parameter;
use caphy_core::{Error, Result};
use caphy_render::Rgb;
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::process::Stdio;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

/// One value of an event file: step, name, and a number's or a picture's bytes.
type Seen = (u64, String, Vec<u8>);

/// Reads an event file by the published formats alone, checks included; wall times are left out.
fn events(bytes: &[u8]) -> Vec<Seen> {
    // CRC-32C bit by bit.
    fn crc(data: &[u8]) -> u32 {
        let mut crc = !0u32;
        for byte in data {
            crc ^= u32::from(*byte);
            for _ in 0..8 {
                crc = (crc >> 1) ^ (0x82f6_3b78 * (crc & 1));
            }
        }
        let crc = !crc;
        crc.rotate_right(15).wrapping_add(0xa282_ead8)
    }
    /// Fields of a message: number and content; fixed and variable numbers as little-endian bytes.
    fn fields(mut data: &[u8]) -> Vec<(u64, Vec<u8>)> {
        fn varint(data: &mut &[u8]) -> u64 {
            let mut value = 0;
            for shift in (0..64).step_by(7) {
                let byte = data[0];
                *data = &data[1..];
                value |= u64::from(byte & 0x7f) << shift;
                if byte < 0x80 {
                    return value;
                }
            }
            panic!("a number of more than ten bytes");
        }
        let mut out = Vec::new();
        while !data.is_empty() {
            let key = varint(&mut data);
            let length = match key & 7 {
                0 => {
                    out.push((key >> 3, varint(&mut data).to_le_bytes().to_vec()));
                    continue;
                }
                1 => 8,
                2 => varint(&mut data) as usize,
                5 => 4,
                other => panic!("wire type {other}"),
            };
            out.push((key >> 3, data[..length].to_vec()));
            data = &data[length..];
        }
        out
    }
    let mut seen = Vec::new();
    let mut at = 0;
    let mut first = true;
    while at < bytes.len() {
        let length = u64::from_le_bytes(bytes[at..at + 8].try_into().expect("eight bytes")) as usize;
        let word = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().expect("four bytes"));
        assert_eq!(word(at + 8), crc(&bytes[at..at + 8]), "check of the length at byte {at}");
        let data = &bytes[at + 12..at + 12 + length];
        assert_eq!(word(at + 12 + length), crc(data), "check of the record at byte {at}");
        at += 16 + length;
        let event = fields(data);
        if std::mem::take(&mut first) {
            assert!(event.contains(&(3, b"brain.Event:2".to_vec())), "no version in {event:?}");
            continue;
        }
        let number = |bytes: &[u8]| u64::from_le_bytes(bytes.try_into().expect("eight bytes"));
        let step = event.iter().find(|f| f.0 == 2).map_or(0, |f| number(&f.1));
        let summary = &event.iter().find(|f| f.0 == 5).expect("a summary").1;
        for (_, value) in fields(summary) {
            let parts: BTreeMap<u64, Vec<u8>> = fields(&value).into_iter().collect();
            let tag = String::from_utf8(parts[&1].clone()).expect("text");
            let content = parts.get(&2).cloned().unwrap_or_else(|| {
                let image: BTreeMap<u64, Vec<u8>> = fields(&parts[&4]).into_iter().collect();
                let png = &image[&4];
                assert_eq!(&png[..4], b"\x89PNG");
                // Width and height stand big-endian in the PNG's first chunk.
                let side = |at: usize| u64::from(u32::from_be_bytes(png[at..at + 4].try_into().expect("four bytes")));
                assert_eq!((number(&image[&2]), number(&image[&1])), (side(16), side(20)));
                png.clone()
            });
            seen.push((step, tag, content));
        }
    }
    seen
}

fn lines(text: &[u8]) -> Vec<Value> {
    let text = std::str::from_utf8(text).expect("text");
    assert!(text.ends_with('\n'));
    text.lines().map(|line| serde_json::from_str(line).unwrap_or_else(|e| panic!("{e}: {line}"))).collect()
}

#[test]
fn every_step_of_a_run_is_on_record() {
    let all = files(finished());
    let settings = TrainConfig::default();
    for (stage, garment, steps) in [("train", "upper", 3 * 8), ("train", "lower", 3 * 8), ("finetune", "upper", 3 * 5)]
    {
        let name = format!("{stage}-{garment}");
        let lines = lines(&all[&format!("metrics-{name}.jsonl")]);
        assert_eq!(lines.len(), steps, "{name}");
        for (step, line) in lines.iter().enumerate() {
            assert_eq!(line["step"], step, "{line}");
            let kind = line["kind"].as_str().expect("a kind");
            let energies = line["energies"].as_object().expect("energies");
            assert_eq!(energies.contains_key("scan"), kind == "scans", "{line}");
            assert_eq!(energies.contains_key("inertia"), kind == "windows", "{line}");
            assert_eq!(energies.contains_key("layering"), stage == "finetune", "{line}");
            assert!(energies.values().chain([&line["gradient_norm"], &line["learning_rate"]]).all(Value::is_number));
            assert_eq!(line.get("body").is_some(), step.is_multiple_of(settings.measure_every), "{line}");
        }
        let spread = &lines[0]["major_stretch"];
        let part = |name: &str| spread[name].as_f64().expect("a number");
        let parts = ["least", "p1", "p50", "p99", "most"].map(part);
        assert!(parts.is_sorted() && parts[0] > 0.1 && parts[4] < 10.0, "{spread}");
        // The first pass of training shows the skinned template, most of which is hardly stretched.
        assert!((0.8..1.25).contains(&parts[2]), "{spread}");
        assert!((0.0..=1.0).contains(&lines[0]["body"]["inside"].as_f64().expect("a share")));

        // TensorBoard shows the same.
        let seen = events(&all[&format!("tensorboard/{name}/events.out.tfevents.0.caphy")]);
        for line in &lines {
            let tag = format!("{}/strain", line["kind"].as_str().expect("a kind"));
            let step = line["step"].as_u64().expect("a step");
            let bits = (line["energies"]["strain"].as_f64().expect("a number") as f32).to_le_bytes().to_vec();
            assert!(seen.contains(&(step, tag.clone(), bits)), "{tag} of step {step}");
        }
        // The end of every training is drawn.
        let shown = if stage == "train" { name.as_str() } else { "finetune" };
        let picture = &all[&format!("previews/{shown}-{steps:06}.png")];
        assert!(seen.contains(&(steps as u64, "preview".into(), picture.clone())));
        let keys: BTreeSet<(u64, &str)> = seen.iter().map(|(step, tag, _)| (*step, tag.as_str())).collect();
        assert_eq!(keys.len(), seen.len(), "a value of a step stands twice");
    }
}

/// The stage's surroundings in a folder of its own.
struct Stage {
    config: Config,
    files: ProjectFiles,
    folder: tempfile::TempDir,
    progress: Progress,
    timings: Mutex<BTreeMap<String, f64>>,
}

impl Stage {
    fn new(text: &str) -> Stage {
        let path = Path::new("experiment.toml");
        Stage {
            config: Config::parse(path, text).unwrap_or_else(|e| panic!("{e}")),
            files: ProjectFiles::new(Path::new(".")),
            folder: tempfile::tempdir().expect("a temporary folder"),
            progress: Progress::start("train"),
            timings: Mutex::default(),
        }
    }
    fn context(&self) -> Context<'_> {
        let Stage { config, files, folder, progress, timings } = self;
        Context { config, files, folder: folder.path(), stage: "train", key: "key", progress, profile: false, timings }
    }
    fn lines(&self, garment: &str) -> Vec<Value> {
        let path = self.folder.path().join(format!("metrics-train-{garment}.jsonl"));
        lines(&std::fs::read(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display())))
    }
}

/// The first training of [`finished`], with another `[train]`.
fn trained(stage: &Stage) -> String {
    let subject: Subject = value(finished(), "preprocess");
    let start = Start::fresh(stage.config.train.rounds);
    let nets = train::run(&stage.context(), &subject, &start).unwrap_or_else(|e| panic!("{e}"));
    serde_json::to_string(&nets).expect("JSON")
}

fn with_train(keys: &str) -> String {
    edited(TINY, &[("windows = 48", &format!("windows = 48\n{keys}"))])
}

#[test]
fn looking_and_constant_schedules_change_no_bit() {
    let expected = serde_json::to_string(&value::<Nets>(finished(), "train")).expect("JSON");
    let looked = Stage::new(&with_train("metrics_every = 3\nmeasure_every = 2\npreview_every = 1"));
    assert!(trained(&looked) == expected, "looking changed the nets");
    let steps: Vec<u64> = looked.lines("upper").iter().map(|l| l["step"].as_u64().expect("a step")).collect();
    assert_eq!(steps[..6], [0, 2, 3, 4, 6, 8]);
    let previews = files(&looked.folder.path().join("previews"));
    let names: Vec<&str> = previews.keys().map(String::as_str).collect();
    let of = |garment: &str| [8, 16, 24].map(|step| format!("train-{garment}-{step:06}.png"));
    assert_eq!(names, [of("lower"), of("upper")].concat());

    let scheduled = "weights = { strain = [[0.0, 1.0]], scan = { from = 300.0, to = 300.0, until = 0.5 } }";
    let off = Stage::new(&with_train(&format!("{scheduled}\nmeasure_every = 0\npreview_every = 0")));
    assert!(trained(&off) == expected, "a schedule of one value is no constant");
    assert!(!off.folder.path().join("previews").exists());
    assert!(off.lines("upper").iter().all(|l| l.get("body").is_none() && l["weights"]["strain"] == 1.0));
}

#[test]
fn weights_follow_their_schedule() {
    let constant = serde_json::to_string(&value::<Nets>(finished(), "train")).expect("JSON");
    let ramp = Stage::new(&with_train("weights = { strain = { from = 0.0, to = 1.0, until = 0.5 } }"));
    assert!(trained(&ramp) != constant);
    let lines = ramp.lines("lower");
    let steps = lines.len() as f64;
    for (step, line) in lines.iter().enumerate() {
        let weight = (step as f64 / steps / 0.5).min(1.0);
        assert!((line["weights"]["strain"].as_f64().expect("a weight") - weight).abs() < 1e-15, "{line}");
        // What is off costs nothing and is not measured.
        assert_eq!(line["energies"].get("strain").is_some(), weight > 0.0, "{line}");
    }
}

/// A fabric whose stress is no number beyond a strain along u.
struct Tearing {
    inner: Box<dyn MaterialModel>,
    strain: f32,
}

impl MaterialModel for Tearing {
    fn describe(&self) -> MaterialDescription {
        self.inner.describe()
    }
    fn membrane(&self, call: MembraneCall<'_, '_>) -> Result<()> {
        let MembraneCall::F32(block) = call else { return self.inner.membrane(call) };
        self.inner.membrane(MembraneCall::F32(block))?;
        let (count, green) = (block.count, block.green.or_empty().to_vec());
        if let Some(stress) = block.stress.get() {
            for i in (0..count).filter(|&i| green[i] > self.strain) {
                stress[i] = f32::NAN;
            }
        }
        Ok(())
    }
    fn hinge(&self, call: HingeCall<'_, '_>) -> Result<()> {
        self.inner.hinge(call)
    }
    fn parameters(&self) -> Vec<Parameter> {
        self.inner.parameters()
    }
    fn with_parameters(&self, values: &[f64]) -> Result<Box<dyn MaterialModel>> {
        Ok(Box::new(Tearing { inner: self.inner.with_parameters(values)?, strain: self.strain }))
    }
}

#[test]
fn a_value_that_is_no_number_is_named_by_term_triangle_and_frame() {
    let stage = Stage::new(TINY);
    let context = stage.context();
    let subject: Subject = value(finished(), "preprocess");
    let scene = Scene::new(&context, &subject).expect("a scene");
    let (motion, clips) = scene.named_motion(&context).expect("motion");
    let names = FrameNames::new(clips, &subject);
    let track = scene.scan_track(&subject).expect("scan poses");
    let fitted = &subject.garments[0];
    let scans = scan_frames(&context, &subject, fitted, track.clone()).expect("scans");
    let (config, net) = (&stage.config.train, &stage.config.net);
    let first = trainer::untrained(fitted, scene.body.describe(), net, config, &motion, &track, 1).expect("a net");
    let mut pupil = Pupil::new(&context, &scene, fitted, first.clone(), &motion, &scans).expect("a garment");
    let batches = |_| trainer::window_batches(&motion, config, 48, 7, 0);
    let batch = &batches(0)[0];

    // Strain along u of every triangle in every frame of the first batch: the fabric tears at the largest alone.
    let pass = pupil.learner.forward(batch).expect("a pass");
    let rest = &pupil.learner.rest;
    let mut all = Vec::new();
    for (at, &frame) in batch.frames.iter().enumerate() {
        for (triangle, face) in rest.faces().iter().enumerate() {
            let corner = |i: usize| pass.positions.get(at / batch.windows, at % batch.windows, face[i] as usize);
            let [m00, _, m10, _] = rest.dm_inverse[triangle];
            let fu = (corner(1) - corner(0)) * m00 + (corner(2) - corner(0)) * m10;
            all.push((0.5 * (fu.norm_squared() - 1.0), triangle, frame));
        }
    }
    all.sort_by(|a, b| b.0.total_cmp(&a.0));
    let most = all[0].0;
    let second = all.iter().find(|other| other.0 < most - 1e-5).expect("smaller strains").0;
    let strain = (0.5 * (most + second)) as f32;
    // Usually one; frames that follow each other may be as good as equal.
    let torn: Vec<(usize, usize)> =
        all.iter().filter(|one| one.0 > f64::from(strain)).map(|&(_, triangle, frame)| (triangle, frame)).collect();
    assert!(torn.len() < 8, "{torn:?}");
    let inner = stage.config.upper.as_ref().expect("a garment").material.material("upper.material").expect("a fabric");
    let contact = scene.contact(fitted).expect("a contact map");
    let tearing = Arc::new(Tearing { inner, strain });
    pupil.learner =
        GarmentLearner::new(fitted, &first, tearing, net, config, &motion, &scans, contact).expect("a learner");

    let mut pace = Pace::new(vec![Work { size: 1.0, left: 3 }, Work { size: 1.0, left: 0 }]);
    let plan = Plan {
        context: &context,
        name: "upper",
        order: Order::new(1, batches),
        learning_rate: config.learning_rate,
        names: &names,
        preview: None,
        pace: &mut pace,
        kinds: [0, 1],
        part: [0.0, 1.0],
    };
    let mut trainee = Alone { pupil, config, scheduled: true };
    let Err(error) = learn(&mut trainee, plan) else { panic!("no number is no result") };
    let said = error.to_string();
    for word in ["step 0", "energy `strain` of upper", "NaN"] {
        assert!(said.contains(word), "`{word}` is missing in: {said}");
    }
    // The same frame may be in several windows; its triangle is the one.
    let named = torn.iter().find(|(triangle, frame)| {
        let place = names.long(*frame, false);
        assert!(place.starts_with("frame ") && place.contains("of clip `"), "{place}");
        said.contains(&format!("at triangle {triangle} (vertices ")) && said.contains(&place)
    });
    let (triangle, _) = named.unwrap_or_else(|| panic!("none of {torn:?} is named in: {said}"));
    // Every attempt is on record.
    let lines = stage.lines("upper");
    assert_eq!(lines.len(), 6);
    assert!(lines.iter().all(|l| l["kind"] == "rollback" && l["step"] == 0 && l["from"] == 0), "{lines:?}");
    assert!(lines[0]["because"].as_str().expect("a reason").contains(&format!("triangle {triangle} ")));
}

/// Counts its steps; at one of them it leaves the finite numbers, as often as it is told.
struct Counting {
    batch_sum: usize,
    rates: Vec<f64>,
    bad: (usize, usize),
    state: LearnerState,
}

impl Trainee for Counting {
    fn garments(&self) -> Vec<String> {
        vec!["upper".into()]
    }
    fn step(&mut self, batch: &Batch, _: f64, rate: f64, _: bool) -> Result<Vec<GarmentStep>> {
        if batch.frames[0] == self.bad.0 && self.bad.1 > 0 {
            self.bad.1 -= 1;
            return Err(Error::NonFinite { what: "a test".into(), index: 0, value: f64::NAN });
        }
        self.batch_sum += batch.frames[0];
        self.rates.push(rate);
        let energies: TermEnergies = vec![("strain", batch.frames[0] as f64)];
        Ok(vec![GarmentStep { energies, gradient_norm: 1.0, measures: None }])
    }
    fn scheduled(&self, _: f64) -> Vec<(&'static str, f64)> {
        Vec::new()
    }
    fn fault(&self, _: &Batch) -> Option<(String, Fault)> {
        None
    }
    fn snapshot(&self) -> Vec<LearnerState> {
        vec![self.state.clone()]
    }
    fn restore(&mut self, _: &[LearnerState]) -> Result<()> {
        self.batch_sum = 0;
        self.rates.clear();
        Ok(())
    }
    fn profile(&self) -> Vec<(&'static str, Duration)> {
        Vec::new()
    }
    fn draw(&self, _: &Preview<'_>) -> Result<Rgb> {
        Ok(Rgb::filled(1, 1, [0; 3]))
    }
}

#[test]
fn training_goes_back_to_its_last_good_state_with_half_the_step() {
    let stage = Stage::new(TINY);
    let context = stage.context();
    let subject: Subject = value(finished(), "preprocess");
    let scene = Scene::new(&context, &subject).expect("a scene");
    let motion = scene.motion(&context).expect("motion");
    let track = scene.scan_track(&subject).expect("scan poses");
    let fitted = &subject.garments[0];
    let scans = scan_frames(&context, &subject, fitted, track.clone()).expect("scans");
    let (config, net) = (&stage.config.train, &stage.config.net);
    let first = trainer::untrained(fitted, scene.body.describe(), net, config, &motion, &track, 1).expect("a net");
    let state = Pupil::new(&context, &scene, fitted, first, &motion, &scans).expect("a garment").learner.snapshot();
    let names = FrameNames::default();
    // 20 steps with checkpoints every 5: the 13th fails twice.
    let make = |round: usize| -> Vec<Batch> {
        (0..10).map(|i| Batch { frames: vec![10 * round + i], windows: 1, kind: BatchKind::Windows }).collect()
    };
    let mut counting = Counting { batch_sum: 0, rates: Vec::new(), bad: (13, 2), state };
    let mut pace = Pace::new(vec![Work { size: 1.0, left: 20 }, Work { size: 1.0, left: 0 }]);
    let plan = Plan {
        context: &context,
        name: "upper",
        order: Order::new(2, make),
        learning_rate: 1e-3,
        names: &names,
        preview: None,
        pace: &mut pace,
        kinds: [0, 1],
        part: [0.0, 1.0],
    };
    learn(&mut counting, plan).expect("two ways back are allowed");
    // Since the last way back: steps 10 to 19.
    assert_eq!(counting.batch_sum, (10..20).sum::<usize>());
    assert_eq!(counting.rates[0], 0.25 * trainer::learning_rate(config, 1e-3, 0.5));
    assert_eq!(pace.left(), Some(0.0));
    let lines = stage.lines("upper");
    let said: Vec<(u64, &str)> =
        lines.iter().map(|l| (l["step"].as_u64().expect("a step"), l["kind"].as_str().expect("a kind"))).collect();
    let steps = |from: u64, to: u64| (from..to).map(|step| (step, "windows"));
    let expected: Vec<(u64, &str)> =
        steps(0, 10).chain([(10, "rollback"), (10, "rollback")]).chain(steps(10, 20)).collect();
    assert_eq!(said, expected);
    assert_eq!(lines[10]["from"], 13);
    let path = stage.folder.path().join("tensorboard/train-upper/events.out.tfevents.0.caphy");
    let seen = events(&std::fs::read(path).expect("an event file"));
    let steps: Vec<u64> = seen.iter().filter(|s| s.1 == "windows/strain").map(|s| s.0).collect();
    assert_eq!(steps, (0..20).collect::<Vec<u64>>(), "what was taken back is gone");
}

/// Long enough to be killed in: training and fine-tuning of [`TINY`], no fabric.
fn longer() -> String {
    edited(
        TINY,
        &[
            ("rounds = 3", "rounds = 12\nmeasure_every = 9\npreview_every = 5"),
            ("checkpoint_every = 5", "checkpoint_every = 7"),
            ("[optimise]\nrounds = 2\nestimator = { type = \"alternation\" }", "[optimise]\nalternations = 0"),
            ("epochs = 6", "epochs = 12"),
        ],
    )
}

/// Everything that training and fine-tuning leave, without wall times.
pub(crate) fn left_behind(out: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut all = files(out);
    all.retain(|name, _| {
        let folder = name.starts_with("previews/") || name.starts_with("tensorboard/");
        folder || name.starts_with("metrics-") || name == "train.caphy" || name == "finetune.caphy"
    });
    for (name, bytes) in &mut all {
        if name.starts_with("tensorboard/") {
            let seen = events(bytes);
            let keys: BTreeSet<(u64, &str)> = seen.iter().map(|(step, tag, _)| (*step, tag.as_str())).collect();
            assert_eq!(keys.len(), seen.len(), "{name}: a value of a step stands twice");
            *bytes = seen
                .into_iter()
                .flat_map(|(step, tag, value)| format!("{step} {tag} {value:?}\n").into_bytes())
                .collect();
        }
    }
    all
}

/// A copy of [`finished`] in which training has not begun.
fn before_training(config: &str) -> Experiment {
    let experiment = Experiment::copy_of(finished(), config);
    for name in files(&experiment.out()).keys() {
        let record = ["metrics-", "tensorboard/", "previews/"].iter().any(|start| name.starts_with(start));
        if record || ["train.caphy", "finetune.caphy"].contains(&name.as_str()) {
            std::fs::remove_file(experiment.out().join(name)).expect("removed");
        }
    }
    experiment
}

/// Bytes of all metrics so far.
fn recorded(out: &Path) -> u64 {
    let names = ["train-upper", "train-lower", "finetune-upper", "finetune-lower"];
    let length = |name: &str| std::fs::metadata(out.join(format!("metrics-{name}.jsonl"))).map_or(0, |m| m.len());
    names.into_iter().map(length).sum()
}

#[test]
fn a_run_killed_five_times_leaves_what_an_uninterrupted_one_does() {
    let started = Instant::now();
    let experiment = before_training(&longer());
    on_threads(2, || experiment.run());
    let (expected, whole) = (left_behind(&experiment.out()), recorded(&experiment.out()));
    assert!(expected.len() > 12, "{:?}", expected.keys());

    let mut chance = 0x2545_f491_4f6c_dd1du64;
    let mut random = |below: u64| {
        chance ^= chance << 13;
        chance ^= chance >> 7;
        chance ^= chance << 17;
        chance % below
    };
    for threads in ["1", "2"] {
        let experiment = before_training(&longer());
        let (out, done) = (experiment.out(), experiment.out().join("finetune.caphy"));
        let mut went_on = 0;
        // Five deaths, each somewhere in its sixth of the way; the end is stopped as soon as the last artifact is there.
        for death in 0..=5 {
            let until = whole * death / 6 + random(whole / 6);
            let mut child =
                program(&experiment).args(["--threads", threads]).stderr(Stdio::null()).spawn().expect("a child");
            let reached = || if death < 5 { recorded(&out) >= until } else { done.exists() };
            while !reached() {
                assert!(child.try_wait().expect("a child").is_none(), "it ended by itself before death {death}");
                assert!(started.elapsed() < Duration::from_secs(300), "death {death} is not reached");
                std::thread::sleep(Duration::from_micros(300));
            }
            std::thread::sleep(Duration::from_micros(random(4000)));
            child.kill().expect("killed");
            child.wait().expect("a child");
            went_on += usize::from(files(&out).keys().any(|name| name.starts_with("checkpoint-")));
            assert!(death == 5 || !done.exists(), "death {death} came too late");
        }
        assert!(went_on >= 3, "only {went_on} deaths left a checkpoint to go on from");
        let got = left_behind(&out);
        assert!(got.keys().eq(expected.keys()), "{:?}\n{:?}", got.keys(), expected.keys());
        for (name, bytes) in &expected {
            assert!(&got[name] == bytes, "{name} has other bits on {threads} threads after five deaths");
        }
    }
    println!("eleven starts and ten deaths take {:.1} s", started.elapsed().as_secs_f64());
}
