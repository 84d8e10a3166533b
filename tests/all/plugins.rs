//! Loaded plugins in the whole program: chosen in a configuration, checked, refused.

use crate::commands::{caphy, refusal, text};
use crate::experiment::{Experiment, TINY, edited};
use crate::pipeline::finished;
use caphy::config::Config;
use caphy::plugins::{Kind, PluginTable, Plugins};
use caphy_core::{Error, PluginProblem};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;

/// The library of an example, built once in the target folder of these tests.
fn example(name: &str, library: &str) -> PathBuf {
    let profile = Path::new(env!("CARGO_BIN_EXE_caphy")).parent().expect("target/PROFILE");
    let manifest = Path::new(env!("CARGO_MANIFEST_DIR")).join("examples").join(name).join("Cargo.toml");
    let mut cargo = Command::new(env!("CARGO"));
    cargo.args(["build", "--quiet", "--locked", "--manifest-path"]).arg(manifest);
    cargo.arg("--target-dir").arg(profile.parent().expect("the target folder"));
    if profile.ends_with("release") {
        // How fast a library is, is nobody's question here; most of its build is the interface.
        cargo.args(["--release", "--config", "profile.release.package.caphy-core.opt-level=1"]);
    }
    let output = cargo.output().expect("cargo runs");
    assert!(output.status.success(), "{}", text(&output.stderr));
    profile.join(format!("{}{library}{}", std::env::consts::DLL_PREFIX, std::env::consts::DLL_SUFFIX))
}

pub(crate) fn woven() -> &'static Path {
    static PATH: OnceLock<PathBuf> = OnceLock::new();
    PATH.get_or_init(|| example("plugin-material", "caphy_plugin_woven"))
}

fn linear() -> &'static Path {
    static PATH: OnceLock<PathBuf> = OnceLock::new();
    PATH.get_or_init(|| example("plugin-net", "caphy_plugin_linear"))
}

/// [`TINY`] with a loaded fabric and a loaded net.
fn with_plugins() -> String {
    let libraries = format!("[[plugin]]\npath = {:?}\n\n[[plugin]]\npath = {:?}\n\n[run]", woven(), linear());
    let fabric = "material = { type = \"measured\", fabric = \"camel-ponte-roma\" }";
    let net = "type = \"gru\"\nlayers = 2\nhidden = 32";
    edited(
        TINY,
        &[
            ("[run]", &libraries),
            (fabric, "material = { type = \"woven\", k0 = 300.0 }"),
            (net, "type = \"linear\"\nfade = 0.25"),
        ],
    )
}

#[test]
fn an_experiment_runs_on_loaded_plugins() {
    let experiment = Experiment::copy_of(finished(), &with_plugins());
    let summary = experiment.run();
    assert!(summary.ran.contains(&"train") && summary.ran.contains(&"optimise"), "{:?}", summary.ran);
    assert!(summary.table.contains("lower"), "{}", summary.table);
    let resolved = std::fs::read_to_string(experiment.out().join("config.toml")).expect("the resolved configuration");
    // Defaults are filled in by the libraries themselves.
    for written in ["k1 = 40.0", "bend_v = ", "fade = 0.25", "libcaphy_plugin_woven"] {
        assert!(resolved.contains(written), "`{written}` is missing in {resolved}");
    }
    assert!(experiment.run().ran.is_empty(), "a second run finds everything done");
}

#[test]
fn mistakes_in_loaded_tables_have_their_place() {
    let path = Path::new("experiment.toml");
    let says = |text: &str| Config::parse(path, text).expect_err("a mistake").to_string();
    let line = |text: &str, word: &str| 1 + text.lines().position(|l| l.contains(word)).expect("the word's line");
    let unknown = edited(&with_plugins(), &[("k0 = 300.0", "kO = 300.0")]);
    let said = says(&unknown);
    assert!(said.contains(&format!("line {}, column", line(&unknown, "kO"))) && said.contains("`kO`"), "{said}");
    let wrong = edited(&with_plugins(), &[("fade = 0.25", "fade = \"a little\"")]);
    let said = says(&wrong);
    assert!(said.contains(&format!("line {}, column 1", line(&wrong, "fade"))) && said.contains("string"), "{said}");
    let value = says(&edited(&with_plugins(), &[("fade = 0.25", "fade = 1.5")]));
    assert!(value.contains("net.fade") && value.contains("1.5"), "{value}");
    let without = edited(&with_plugins(), &[("type = \"woven\"", "type = \"knitted\"")]);
    let said = says(&without);
    assert!(said.contains("`woven`") && said.contains("`measured`") && said.contains("[[plugin]]"), "{said}");
}

#[test]
fn libraries_come_first_and_names_once() {
    let mut plugins = Plugins::new().expect("linked plugins");
    plugins.load(woven()).expect("a plugin");
    plugins.load(woven()).expect("the same library is no second one");
    // A copy under another name offers the same type.
    let folder = tempfile::tempdir().expect("a folder");
    let copy = folder.path().join("copy.so");
    std::fs::copy(woven(), &copy).expect("a copy");
    match plugins.load(&copy) {
        Err(Error::Plugin { problem: PluginProblem::Duplicate { type_name, other }, .. }) => {
            assert!(type_name == "woven" && other.contains("woven"), "{other}");
        }
        other => panic!("{other:?}"),
    }
    let table = PluginTable::parse(&plugins, Kind::Material, Path::new("m.toml"), "type = \"woven\"").expect("a table");
    assert_eq!(table.material("material").expect("a material").describe().name, "woven");
    // Types are settled now.
    match plugins.load(linear()) {
        Err(Error::Plugin { problem: PluginProblem::TooLate { read }, .. }) => assert_eq!(read, "m.toml"),
        other => panic!("{other:?}"),
    }
}

#[test]
fn checks_of_loaded_and_linked_types() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = |p: &Path| p.to_str().expect("UTF-8").to_string();
    for subject in [path(woven()), path(linear()), "measured".into(), "vertex".into()] {
        let output = caphy(folder.path(), &["check", &subject]);
        let table = text(&output.stdout);
        assert!(output.status.success() && table.contains("0 failed"), "{table}{}", text(&output.stderr));
    }
    // A table that the type refuses fails its checks, and the exit code says so.
    std::fs::write(folder.path().join("t.toml"), "type = \"woven\"\nk0 = -1.0\n").expect("a file");
    let output = caphy(folder.path(), &["check", &path(woven()), "--table", "t.toml"]);
    assert!(!output.status.success() && text(&output.stdout).contains("failed"), "{}", text(&output.stdout));
    let json = caphy(folder.path(), &["check", &path(woven()), "--json"]);
    let reports: serde_json::Value = serde_json::from_slice(&json.stdout).expect("JSON");
    assert_eq!((&reports[0]["name"], reports[0]["checks"][0]["outcome"].as_str()), (&"woven".into(), Some("passed")));

    assert!(refusal(folder.path(), &["check", "wooven"]).contains("measured"));
    assert!(refusal(folder.path(), &["check", "./missing.so"]).contains("missing.so"));
    std::fs::write(folder.path().join("text.so"), "no library").expect("a file");
    let said = refusal(folder.path(), &["check", "text.so"]);
    assert!(said.contains("text.so") && said.contains("not a library"), "{said}");

    // A loaded type can be probed, once its library is named.
    std::fs::write(folder.path().join("m.toml"), "type = \"woven\"\n").expect("a file");
    std::fs::write(folder.path().join("f.json"), "[[[1.1, 0], [0, 1], [0, 0]]]").expect("a file");
    let probe = ["probe", "m.toml", "--gradients", "f.json"];
    assert!(refusal(folder.path(), &probe).contains("--plugin"));
    let output = caphy(folder.path(), &[&probe[..], &["--plugin", &path(woven())]].concat());
    assert!(output.status.success(), "{}", text(&output.stderr));
}
