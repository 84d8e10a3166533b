//! Dependencies between the crates point one way (see CONTRIBUTING.md).

use std::collections::{BTreeMap, BTreeSet};

/// For each crate the workspace crates it may build on; dev-dependencies are free, as they ship nothing.
fn allowed() -> BTreeMap<&'static str, BTreeSet<&'static str>> {
    let plugin = ["caphy-core", "caphy-formats", "caphy-render"];
    let base = ["caphy-core"];
    let all = [
        "caphy-core",
        "caphy-materials",
        "caphy-bodymodel",
        "caphy-nets",
        "caphy-segmentation",
        "caphy-garment",
        "caphy-formats",
        "caphy-render",
    ];
    BTreeMap::from([
        ("caphy", all.into()),
        ("caphy-materials", plugin.into()),
        ("caphy-bodymodel", plugin.into()),
        ("caphy-nets", plugin.into()),
        ("caphy-segmentation", plugin.into()),
        ("caphy-garment", plugin.into()),
        ("caphy-formats", base.into()),
        ("caphy-render", base.into()),
        ("caphy-core", BTreeSet::new()),
    ])
}

#[test]
fn dependencies_point_one_way() {
    let output = std::process::Command::new(env!("CARGO"))
        .args(["metadata", "--format-version", "1", "--no-deps", "--offline"])
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .output()
        .expect("cargo metadata runs");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let metadata: serde_json::Value = serde_json::from_slice(&output.stdout).expect("cargo metadata prints JSON");
    let allowed = allowed();
    let packages = metadata["packages"].as_array().expect("a list of packages");
    assert_eq!(packages.len(), allowed.len(), "a new crate needs its line in `allowed`");
    for package in packages {
        let name = package["name"].as_str().unwrap();
        let may = allowed.get(name).unwrap_or_else(|| panic!("{name} needs its line in `allowed`"));
        for dependency in package["dependencies"].as_array().unwrap() {
            let on = dependency["name"].as_str().unwrap();
            if dependency["kind"].is_null() && on.starts_with("caphy") {
                assert!(may.contains(on), "{name} must not depend on {on}");
            }
        }
    }
}

/// Lines of `cargo tree`: each package with its features.
fn features(arguments: &[&str]) -> BTreeSet<String> {
    let output = std::process::Command::new(env!("CARGO"))
        .args(["tree", "--offline", "--prefix", "none", "--format", "{p} {f}"])
        .args(arguments)
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .output()
        .expect("cargo tree runs");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let text = String::from_utf8_lossy(&output.stdout);
    text.lines().map(|line| line.trim_end_matches(" (*)").to_string()).collect()
}

/// A library that tests ask for more features of than the program does is built twice, and all that stand on it.
#[test]
fn the_program_and_its_tests_are_one_build() {
    let program = features(&["--package", "caphy", "--edges", "normal,build"]);
    let tests = features(&["--workspace", "--edges", "normal,build,dev"]);
    let twice: Vec<&String> = program.difference(&tests).collect();
    assert!(twice.is_empty(), "ask for the tests' features in the root's [dependencies], too: {twice:?}");
}
