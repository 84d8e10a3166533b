//! `examples/plugin-net-burn`: built, checked, trained, timed.
//!
//! Burn takes minutes to build, so that these tests run only when they are asked for:
//! `.ci/slow`, or `cargo test --test all -- --ignored burn --nocapture`.

use crate::commands::{caphy, text};
use crate::experiment::{Experiment, TINY, edited, header, value};
use crate::pipeline::{killed_at, program};
use caphy::plugins::{Kind, PluginTable, Plugins};
use caphy::stage::train::Nets;
use caphy_core::array::{In, Out};
use caphy_core::extension::DeformationNetExt;
use caphy_core::net::{BackwardBlock, DeformationNet, ForwardBlock, NetReal};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::OnceLock;
use std::time::Instant;

/// The library, built once in a folder of its own beside these tests'. Always optimised: Burn is useless without.
fn library() -> &'static Path {
    static PATH: OnceLock<PathBuf> = OnceLock::new();
    PATH.get_or_init(|| {
        let profile = Path::new(env!("CARGO_BIN_EXE_caphy")).parent().expect("target/PROFILE");
        let target = profile.parent().expect("the target folder").join("plugin-net-burn");
        let manifest = Path::new(env!("CARGO_MANIFEST_DIR")).join("examples/plugin-net-burn/Cargo.toml");
        let mut cargo = Command::new(env!("CARGO"));
        cargo.args(["build", "--release", "--locked", "--manifest-path"]).arg(manifest);
        // What cargo tells is of interest: the build is long.
        cargo.arg("--target-dir").arg(&target).stdin(Stdio::null());
        assert!(cargo.status().expect("cargo runs").success(), "the example does not build");
        let name = format!("{}caphy_plugin_tcn{}", std::env::consts::DLL_PREFIX, std::env::consts::DLL_SUFFIX);
        target.join("release").join(name)
    })
}

fn net(table: &str, inputs: usize, outputs: usize) -> Box<dyn DeformationNet> {
    let mut plugins = Plugins::new().expect("linked plugins");
    plugins.load(library()).expect("a plugin");
    let table = PluginTable::parse(&plugins, Kind::Net, Path::new("net.toml"), table).expect("a net's table");
    table.net(inputs, outputs).expect("a net")
}

#[test]
#[ignore = "builds Burn for minutes: .ci/slow runs it"]
fn the_net_keeps_its_promises() {
    let folder = tempfile::tempdir().expect("a folder");
    let output = caphy(folder.path(), &["check", library().to_str().expect("UTF-8")]);
    let table = text(&output.stdout);
    println!("{table}");
    assert!(output.status.success() && table.contains("0 failed"), "{table}{}", text(&output.stderr));
    assert!(table.contains(" 0 not offered"), "{table}");
    for (wrong, says) in [("kernel = 1", "net.kernel"), ("hidden = 0", "net.hidden"), ("layers = 65", "net.layers")] {
        std::fs::write(folder.path().join("t.toml"), format!("type = \"tcn\"\n{wrong}\n")).expect("a file");
        let output = caphy(folder.path(), &["check", library().to_str().expect("UTF-8"), "--table", "t.toml"]);
        let table = text(&output.stdout);
        assert!(!output.status.success() && table.contains(says), "{table}");
    }
}

/// Memory ends after `layers (kernel - 1)` frames: a fresh window of that length says the same as any long clip.
#[test]
#[ignore = "builds Burn for minutes: .ci/slow runs it"]
fn frame_300_is_that_of_a_fresh_window() {
    let net = net("type = \"tcn\"\nlayers = 2\nhidden = 16\nkernel = 3", 6, 9);
    let manifest = net.manifest();
    // The head starts at zero; move everything off its first value.
    let wave = |i: usize| (i as f32 * 0.7).sin();
    let first = net.initialise(1).expect("values");
    let parameters: Vec<f32> = first.iter().enumerate().map(|(i, p)| *p as f32 + 0.1 * wave(i)).collect();
    let features = |frame: usize| (0..6).map(|k| wave(7 * frame + k)).collect::<Vec<f32>>();
    let from = |start: usize| {
        let mut state = vec![0.0; manifest.state];
        (start..=300).map(|f| net.frame(&parameters, &features(f), &mut state).expect("a frame")).last().expect("one")
    };
    let (long, whole, short) = (from(0), from(296), from(297));
    assert!(long.iter().all(|v| v.is_finite()) && long.iter().any(|v| *v != 0.0));
    assert_eq!(long, whole, "five frames are all that it remembers");
    assert_ne!(long, short, "the fifth is remembered");
}

/// [`TINY`] with the loaded net and more training.
fn with_burn() -> String {
    let plugin = format!("[[plugin]]\npath = {:?}\n\n[run]", library());
    let net = "type = \"tcn\"\nhidden = 32";
    edited(TINY, &[("[run]", &plugin), ("type = \"gru\"\nlayers = 2\nhidden = 32", net), ("rounds = 3", "rounds = 12")])
}

#[test]
#[ignore = "builds Burn for minutes: .ci/slow runs it"]
fn an_experiment_trains_the_net_and_resumes() {
    let config = with_burn();
    let whole = Experiment::new(&config);
    let output = program(&whole).stderr(Stdio::piped()).output().expect("the program ends");
    assert!(output.status.success(), "{}", text(&output.stderr));
    let nets: Nets = value(&whole.out(), "train");
    for garment in &nets.garments {
        assert_eq!(garment.manifest.name, "tcn");
        let totals: Vec<f64> = garment
            .curve
            .iter()
            .filter(|p| !p.scans)
            .map(|p| p.energies.iter().filter(|(name, _)| name != "gravity").map(|(_, e)| e).sum())
            .collect();
        println!("{}: energy without gravity [J] {totals:.4?}", garment.kind);
        let mean = |some: &[f64]| some.iter().sum::<f64>() / some.len() as f64;
        assert!(totals.len() >= 12, "{} points", totals.len());
        let (start, end) = (mean(&totals[..3]), mean(&totals[totals.len() - 3..]));
        assert!(end < start, "{}: the loss went from {start} to {end}", garment.kind);
    }

    // Killed at a checkpoint, and on to the same bits. A busy machine may let the stage finish between two looks.
    let killed = (0..5).map(|_| Experiment::new(&config)).find(|e| killed_at(e, "checkpoint-upper.caphy", "train"));
    let killed = killed.expect("training was never caught at a checkpoint");
    let output = program(&killed).stderr(Stdio::piped()).output().expect("the program ends");
    let said = text(&output.stderr);
    assert!(output.status.success() && said.contains("upper: going on from step "), "{said}");
    for stage in ["train", "finetune", "animate"] {
        let content = |e: &Experiment| header(&e.out().join(format!("{stage}.caphy"))).content;
        assert_eq!(content(&killed), content(&whole), "{stage} has other bits");
    }
}

/// Forward and backward times of a net at T-shirt scale, 16 windows of 5 frames [ms], sorted.
fn times(net: &dyn DeformationNet) -> [Vec<f64>; 2] {
    const STEPS: usize = 5;
    const BATCH: usize = 16;
    let manifest = net.manifest();
    let wave = |n: usize, scale: f32| (0..n).map(|i| scale * (i as f32 * 0.7).sin()).collect::<Vec<f32>>();
    let parameters: Vec<f32> = net.initialise(1).expect("values").iter().map(|v| *v as f32).collect();
    let features = wave(STEPS * BATCH * manifest.inputs, 1.0);
    let upstream = wave(STEPS * BATCH * manifest.outputs, 1e-3);
    let mut output = vec![0.0; upstream.len()];
    let mut tape = vec![0.0; net.tape_len(STEPS, BATCH).expect("a length")];
    let mut gradient = vec![0.0; parameters.len()];
    let mut all = [Vec::new(), Vec::new()];
    for _ in 0..21 {
        let started = Instant::now();
        let mut block = ForwardBlock {
            steps: STEPS,
            batch: BATCH,
            parameters: parameters[..].into(),
            features: features[..].into(),
            state_before: In::absent(),
            output: output.as_mut_slice().into(),
            state_after: Out::absent(),
            tape: tape.as_mut_slice().into(),
        };
        f32::forward(net, &mut block).expect("a pass");
        all[0].push(started.elapsed().as_secs_f64() * 1e3);
        let started = Instant::now();
        let mut block = BackwardBlock {
            steps: STEPS,
            batch: BATCH,
            parameters: parameters[..].into(),
            features: features[..].into(),
            state_before: In::absent(),
            tape: tape[..].into(),
            output_gradient: upstream[..].into(),
            parameter_gradient: gradient.as_mut_slice().into(),
            feature_gradient: Out::absent(),
        };
        f32::backward(net, &mut block).expect("a pass");
        all[1].push(started.elapsed().as_secs_f64() * 1e3);
    }
    all.iter_mut().for_each(|t| t.sort_by(f64::total_cmp));
    all
}

/// Prints what the README of the example says; nothing is asserted of the times.
#[test]
#[ignore = "builds Burn for minutes: .ci/slow runs it"]
fn a_step_beside_the_gru() {
    let (inputs, outputs) = (85, 3 * 4424);
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("a thread");
    let nets = ["type = \"gru\"", "type = \"tcn\"\nlayers = 7"].map(|table| net(table, inputs, outputs));
    let [gru, tcn] = [0, 1].map(|i| nets[i].manifest().parameter_count() as f64);
    assert!((tcn / gru - 1.0).abs() < 0.02, "{gru} and {tcn} parameters are not of one size");
    for net in &nets {
        let [forward, backward] = pool.install(|| times(&**net));
        println!(
            "{}: {} parameters; forward {:.1} ms (median {:.1}), backward {:.1} ms (median {:.1})",
            net.manifest().name,
            net.manifest().parameter_count(),
            forward[0],
            forward[forward.len() / 2],
            backward[0],
            backward[backward.len() / 2]
        );
    }
}
