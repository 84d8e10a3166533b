//! Every mistake is answered with its place and with what exists.

use crate::experiment::{Experiment, TINY, edited, tiny_on_scans};
use caphy::ablation::Ablation;
use caphy::config::Config;
use caphy::plugins::Plugins;
use caphy_core::Error;
use std::path::Path;

const FILE: &str = "experiment.toml";

fn error(text: &str) -> Error {
    match Config::parse(Path::new(FILE), text) {
        Ok(_) => panic!("this must not be accepted:\n{text}"),
        Err(error) => error,
    }
}

/// The error of a text names all of `words`.
fn assert_says(text: &str, words: &[&str]) {
    let said = error(text).to_string();
    for word in words {
        assert!(said.contains(word), "`{word}` is missing in: {said}");
    }
}

/// The error names the file and the line on which `key` stands, and all of `words`.
fn assert_points_at(text: &str, key: &str, words: &[&str]) {
    let line = 1 + text.lines().position(|l| l.contains(key)).expect("the key's line");
    assert!(matches!(error(text), Error::Format { .. }));
    let place = format!("{FILE}, line {line}, column ");
    assert_says(text, &[&[place.as_str()], words].concat());
}

#[test]
fn shipped_configurations_are_valid() {
    for name in ["quickstart.toml", "standin.toml", "subject.toml", "walker.toml", "cmu.toml", "paper.toml"] {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("configs").join(name);
        let config = Config::read(&path).unwrap_or_else(|e| panic!("{e}"));
        assert_written_configuration_parses(&config);
    }
}

#[test]
fn the_shipped_ablation_is_valid_and_equal_in_training() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("configs/ablation.toml");
    let ablation = Ablation::open(&path, None, &Plugins::new().expect("the linked types"));
    let steps = ablation.unwrap_or_else(|e| panic!("{e}")).steps(8).unwrap_or_else(|e| panic!("{e}"));
    assert_eq!(steps, [22 * 54; 5], "every variant trains as long as the others");
}

#[test]
fn the_papers_constants_are_in_their_file() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("configs/paper.toml");
    let paper = Config::read(&path).unwrap_or_else(|e| panic!("{e}"));
    assert_eq!(paper.views.count, 32);
    let train = &paper.train;
    assert_eq!((train.windows, train.window, train.scan_epochs), (10_000, 5, 4));
    assert!(paper.garments().all(|(_, _, g)| g.styles == 300));
    assert_eq!(paper.net.table()["layers"].as_integer(), Some(4));
    assert_eq!(paper.finetune.epochs, 10);
}

#[test]
fn configurations_survive_being_written() {
    let schedules =
        "windows = 48\nweights = { strain = { from = 0.1, to = 1, until = 0.3 }, scan = [[0, 1], [0.5, 300]] }";
    let scheduled = edited(TINY, &[("windows = 48", schedules)]);
    for text in [TINY.to_string(), tiny_on_scans("scans", &["a", "b"]), scheduled] {
        let config = Config::parse(Path::new(FILE), &text).unwrap_or_else(|e| panic!("{e}"));
        assert_written_configuration_parses(&config);
    }
}

/// With all defaults filled in, as in a run folder, it means the same.
fn assert_written_configuration_parses(config: &Config) {
    let written = toml::to_string(config).expect("TOML");
    let read = Config::parse(Path::new("config.toml"), &written).unwrap_or_else(|e| panic!("{e}\n{written}"));
    let value = |c: &Config| serde_json::to_value(c).expect("JSON");
    assert_eq!(value(&read), value(config));
}

#[test]
fn unknown_keys_are_named_with_their_line() {
    let cases = [
        // The root, plain sections, tables in sections.
        ("[run]", "sed = 1\n[run]", "sed", "`run`"),
        ("out = \"out\"", "out = \"out\"\nsede = 3", "sede", "`seed`"),
        ("count = 8", "counts = 8", "counts", "`count`"),
        ("windows = 48", "windows = 48\nepochs = 2", "epochs", "`rounds`"),
        ("windows = 48", "windows = 48\nweights = { stain = 1.0 }", "stain", "`strain`"),
        ("windows = 48", "windows = 48\ncontact = { margn = 1e-3 }", "margn", "`margin`"),
        (
            "windows = 48",
            "windows = 48\nweights = { strain = { form = 0.1, to = 1.0, until = 1.0 } }",
            "form",
            "`from`",
        ),
        (
            "type = \"alternation\"",
            "type = \"alternation\", force_balance = { factor = 2.0 }",
            "factor =",
            "`largest_factor`",
        ),
        ("type = \"alternation\"", "type = \"equilibrium\", fit = { gat = 2.0 }", "gat =", "`gate`"),
        ("scans = 3", "scans = 3\nscan = 3", "scan = 3", "`scans`"),
        ("iterations = 8", "iterations = 8\nitrations = 3", "itrations", "`iterations`"),
        ("kind = \"walk\", seconds = 2", "kind = \"walk\", seconds = 2, foo = 2", "foo", "`seconds`"),
        // Tables that a plugin reads.
        ("resolution = 0.03", "resolution = 0.03\nresolutions = 1", "resolutions", "`resolution`"),
        ("type = \"vertex\"", "type = \"vertex\"\npalette = []", "palette", "no fields"),
        ("hidden = 32", "hidden = 32\nlayer = 3", "layer = 3", "`layers`"),
        // Materials, which are kept as written until they are needed.
        ("\"navy-sparkle-sweat\"", "\"navy-sparkle-sweat\", densty = 1.0", "densty", "`density_kg_per_m2`"),
        ("\"camel-ponte-roma\"", "\"camel-ponte-roma\", lookups = 1", "lookups", "`lookup`"),
        ("\"gray-interlock\"", "\"gray-interlock\", edge = 1.0", "edge = 1.0", "`edge_length`"),
    ];
    for (old, new, key, exists) in cases {
        let text = edited(TINY, &[(old, new)]);
        let name = key.split(' ').next().expect("a word");
        assert_points_at(&text, key, &[&format!("unknown field `{name}`"), exists]);
    }
}

#[test]
fn unknown_types_list_what_exists() {
    for (old, wrong, exist) in [
        ("\"mannequin\"", "\"smpl\"", ["`mannequin`", "`smplx`"]),
        ("\"gru\"", "\"lstm\"", ["`gru`", "`mlp`"]),
        ("\"vertex\"", "\"parser\"", ["`colour`", "`vertex`"]),
        ("\"synthetic\"", "\"invented\"", ["`synthetic`", "`scans`"]),
        ("\"procedural\", kind", "\"dance\", kind", ["`amass`", "`asf_amc`"]),
        ("\"walk\", seconds = 2", "\"wolk\", seconds = 2", ["`walk`", "`squat`"]),
        ("\"measured\", fabric = \"gray", "\"linear\", fabric = \"gray", ["`measured`", "`stvk`"]),
        ("\"measured\", fabric = \"camel", "\"neohooke\", fabric = \"camel", ["`measured`", "`stvk`"]),
    ] {
        let text = edited(TINY, &[(old, wrong)]);
        let name = wrong.split('"').nth(1).expect("a quoted name");
        assert_points_at(
            &text,
            &format!("\"{name}\""),
            &["unknown ", &format!(" `{name}`, expected"), exist[0], exist[1]],
        );
    }
    let material = "type = \"measured\", fabric = \"camel-ponte-roma\"";
    let no_type = edited(TINY, &[(material, "fabric = \"camel-ponte-roma\"")]);
    assert_points_at(&no_type, "camel-ponte-roma", &["missing field `type`"]);
    let fabric = edited(TINY, &[("navy-sparkle-sweat", "denim")]);
    assert_says(
        &fabric,
        &["`upper.material.fabric`", "`denim`", "11oz-black-denim", "navy-sparkle-sweat", "royal-target"],
    );
}

#[test]
fn unusable_values_name_their_key() {
    for (old, new, key) in [
        ("count = 8", "count = 0", "views.count"),
        ("size = 128", "size = 1", "views.size"),
        ("scans = 3", "scans = 1", "subject.scans"),
        ("held_out = [\"scan-02\"]", "held_out = 1", "subject.held_out"),
        ("resolution_m = 0.04", "resolution_m = 0.0", "subject.resolution_m"),
        ("resolution_m = 0.05", "resolution_m = -0.05", "upper.resolution_m"),
        ("styles = 6", "styles = 0", "upper.styles"),
        ("[motion]", "[motion]\nfps = -30.0", "motion.fps"),
        ("windows = 48", "windows = 0", "train.windows"),
        ("windows = 48", "windows = 48\nwindow = 0", "train.window"),
        ("windows = 48", "windows = 48\nbatch = 17", "train.batch"),
        ("windows = 48", "windows = 48\nlearning_rate = -1e-3", "train.learning_rate"),
        ("windows = 48", "windows = 48\nlearning_rate = nan", "train.learning_rate"),
        ("windows = 48", "windows = 48\nclip_norm = inf", "train.clip_norm"),
        ("checkpoint_every = 5", "checkpoint_every = 0", "train.checkpoint_every"),
        ("windows = 48", "windows = 48\nmetrics_every = 0", "train.metrics_every"),
        ("rounds = 2", "alternations = 9", "optimise.alternations"),
        (
            "type = \"alternation\"",
            "type = \"alternation\", force_balance = { largest_factor = 0.5 }",
            "optimise.estimator.force_balance.largest_factor",
        ),
        ("type = \"alternation\"", "type = \"equilibrium\", scans = 0", "optimise.estimator.scans"),
        ("type = \"alternation\"", "type = \"equilibrium\", fit = { gate = 0.5 }", "optimise.estimator.fit.gate"),
        ("type = \"alternation\"", "type = \"alternation\", lambda = 2.0", "optimise.estimator.inner"),
        (
            "type = \"alternation\"",
            "type = \"alternation\", inner = \"solver\", rounds = 0",
            "optimise.estimator.rounds",
        ),
        ("epochs = 6", "learning_rate = 0.0", "finetune.learning_rate"),
        ("[animate]", "[animate]\nobj_every = 0", "animate.obj_every"),
        ("seconds = 2 }", "seconds = 0 }", "motion.clips.seconds"),
        ("seconds = 1, seed", "seconds = nan, seed", "animate.clip.seconds"),
        ("scans = 3", "scans = 3\nrig = { noise_m = -1e-3 }", "subject.rig.noise_m"),
        ("scans = 3", "scans = 3\nrig = { edge_m = 0.0 }", "subject.rig.edge_m"),
        ("scans = 3", "scans = 3\nrig = { labels = false }", "subject.rig.labels"),
        ("scans = 3", "scans = 3\nfriction = -0.3", "subject.friction"),
        ("scans = 3", "scans = 3\ndisplacement_m = 0.1", "subject.displacement_m"),
        ("scans = 3", "scans = 3\nrest = { girth = 2.0 }", "subject.rest.girth"),
        ("scans = 3", "scans = 3\nupper_style = [0.5, 0.5, 0.9, 0.5]", "subject.upper_style"),
        ("iterations = 8", "iterations = 8\nskin_sigma = -1.0", "registration.skin_sigma"),
        ("hidden = 32", "hidden = 0", "net.hidden"),
        ("windows = 48", "windows = 48\nfinal_rate = 2.0", "train.final_rate"),
        ("windows = 48", "windows = 48\nscan_points = 0", "train.scan_points"),
        ("windows = 48", "windows = 48\nweights = { strain = -1.0 }", "train.weights.strain"),
        (
            "windows = 48",
            "windows = 48\nweights = { gravity = { from = -1, to = 1, until = 1 } }",
            "train.weights.gravity",
        ),
        (
            "windows = 48",
            "windows = 48\nweights = { scan = { from = 0, to = 1, until = 1.5 } }",
            "train.weights.scan.until",
        ),
        ("windows = 48", "windows = 48\nweights = { inertia = [[0.5, 1.0], [0.5, 2.0]] }", "train.weights.inertia"),
        ("windows = 48", "windows = 48\nweights = { bending = [] }", "train.weights.bending"),
        ("windows = 48", "windows = 48\nweights = { layering = [[0.0, nan]] }", "train.weights.layering"),
        ("windows = 48", "windows = 48\ncontact = { allowed_depth = 0.0 }", "train.contact.allowed_depth"),
        ("epochs = 6", "layering = { margin = -1e-3 }", "finetune.layering.margin"),
        (
            "type = \"alternation\"",
            "type = \"alternation\", force_balance = { regularisation = -1.0 }",
            "optimise.estimator.force_balance.regularisation",
        ),
        ("[animate]", "[evaluate]\npenetration_m = nan\n\n[animate]", "evaluate.penetration_m"),
        ("[animate]", "[animate]\npush_out_m = -1e-3", "animate.push_out_m"),
        ("[animate]", "[animate]\nseconds = -1.0", "animate.seconds"),
    ] {
        let error = error(&edited(TINY, &[(old, new)]));
        assert!(matches!(&error, Error::Config { key: named, .. } if named == key), "{new}: {error}");
        assert!(error.to_string().contains("give"), "no remedy: {error}");
    }
    assert_points_at(&edited(TINY, &[("count = 8", "count = -8")]), "count = -8", &["-8"]);
    assert_points_at(&edited(TINY, &[("count = 8", "count = \"8\"")]), "count = \"8\"", &["string"]);
    let weight = |text: &str| edited(TINY, &[("windows = 48", &format!("windows = 48\nweights.strain = {text}"))]);
    assert_points_at(&weight("\"1\""), "weights.strain", &["a number, a ramp { from, to, until }, or points"]);
    assert_points_at(&weight("{ from = 0.1, to = 1.0 }"), "weights.strain", &["missing field `until`"]);
    assert_points_at(&weight("[[0.0, 1.0], [1.0]]"), "weights.strain", &["array of length 2"]);
    // In tables that a plugin reads, too.
    assert_points_at(&edited(TINY, &[("hidden = 32", "hidden = \"32\"")]), "hidden = \"32\"", &["string"]);
    let fabric = "fabric = \"navy-sparkle-sweat\"";
    let multipliers = format!("{fabric}, membrane_multipliers = [1.0, 2.0]");
    assert_points_at(&edited(TINY, &[(fabric, &multipliers)]), "membrane_multipliers", &["2 values, expected 4"]);
    let no_clips = "clips = [{ type = \"procedural\", kind = \"walk\", seconds = 2 }]";
    assert_says(&edited(TINY, &[(no_clips, "clips = []")]), &["motion.clips"]);
    let other = [("type = \"alternation\"", "type = \"equilibria\"")];
    assert_points_at(&edited(TINY, &other), "equilibria", &["expected `equilibrium` or `alternation`"]);
    assert_says(&edited(TINY, &[("[net]\ntype = \"gru\"\nlayers = 2\nhidden = 32\n", "")]), &["missing field `net`"]);
}

#[test]
fn broken_toml_points_at_its_line() {
    assert_points_at(&edited(TINY, &[("[net]", "[net")]), "[net", &["correct the line"]);
    assert_points_at(&edited(TINY, &[("hidden = 32", "hidden = 32\nhidden = 33")]), "hidden = 33", &["duplicate key"]);
    let experiment = Experiment::new(TINY);
    experiment.write(FILE, &[0xff, 0xfe, 0x00]);
    assert!(experiment.error().contains(FILE));
    std::fs::remove_file(experiment.config()).expect("removed");
    assert!(experiment.error().contains(FILE));
}

#[test]
fn settings_without_effect_are_refused() {
    for (old, new, key, because) in [
        ("epochs = 6", "epochs = 0", "finetune.windows", "finetune.epochs = 0"),
        (
            "epochs = 6\nwindows = 64",
            "epochs = 0\nlayering = { order = \"tucked\" }",
            "finetune.layering",
            "finetune.epochs = 0",
        ),
        ("rounds = 2", "rounds = 2\nalternations = 0", "optimise.estimator", "optimise.alternations = 0"),
        ("windows = 48", "windows = 48\nweights = { scan = 0.0 }\nscan_points = 9", "train.scan_points", "scan = 0"),
        (
            "windows = 48",
            "windows = 48\nwindow = 2\nlead_in = 0\nweights = { inertia = 2 }",
            "train.weights.inertia",
            "window < 3",
        ),
        ("[animate]", "[evaluate]\nground_truth = \"x.npz\"\n\n[animate]", "evaluate.ground_truth", "synthetic"),
    ] {
        let error = error(&edited(TINY, &[(old, new)]));
        assert!(matches!(&error, Error::Config { key: named, .. } if named == key), "{new}: {error}");
        assert!(error.to_string().contains("has no effect") && error.to_string().contains(because), "{error}");
    }
    // What is written out with all defaults stays valid.
    let off = edited(TINY, &[("epochs = 6\nwindows = 64", "epochs = 0")]);
    let config = Config::parse(Path::new(FILE), &off).unwrap_or_else(|e| panic!("{e}"));
    assert_written_configuration_parses(&config);
}
