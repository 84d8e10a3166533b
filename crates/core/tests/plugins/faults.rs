//! Libraries that are no plugins, or bad ones: a typed error each.

use crate::build;
use caphy_core::host::Library;
use caphy_core::material::{HingeBlock, MembraneBlock};
use caphy_core::{Error, PluginProblem, Result};
use std::path::{Path, PathBuf};
use tempfile::TempDir;

struct Fixture {
    folder: TempDir,
}

impl Fixture {
    fn new() -> Self {
        Self { folder: tempfile::tempdir().expect("a folder") }
    }
    /// The library with a fault; `None` where there is no C compiler.
    fn faulty(&self, fault: &str) -> Option<PathBuf> {
        let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/plugins/faulty.c");
        build::c(&source, self.folder.path(), fault, &[&format!("FAULT_{fault}")])
    }
}

fn problem<T>(result: Result<T>) -> PluginProblem {
    match result {
        Err(Error::Plugin { problem, library }) => {
            assert!(!library.as_os_str().is_empty());
            problem
        }
        Err(other) => panic!("another error: {other}"),
        Ok(_) => panic!("accepted"),
    }
}

#[test]
fn files_that_are_no_plugins() {
    let fixture = Fixture::new();
    let text = fixture.folder.path().join("notes.txt");
    std::fs::write(&text, "not a library").expect("a file");
    assert!(matches!(problem(Library::load(&text)), PluginProblem::NotALibrary { .. }));
    let missing = fixture.folder.path().join("missing.so");
    assert!(matches!(Library::load(&missing), Err(Error::Io { path, .. }) if path == missing));
    assert!(Library::load(fixture.folder.path()).is_err(), "a folder");
    if let Some(path) = fixture.faulty("NONE") {
        Library::load(&path).expect("without a fault it loads");
    }
}

#[test]
fn missing_symbols_and_other_versions() {
    let fixture = Fixture::new();
    for (fault, symbol) in [("NO_VERSION", "caphy_plugin_abi_version"), ("NO_TABLE", "caphy_plugin")] {
        let Some(path) = fixture.faulty(fault) else { return };
        let PluginProblem::MissingSymbol { symbol: missing } = problem(Library::load(&path)) else { panic!("{fault}") };
        assert_eq!(missing, symbol);
    }
    let Some(path) = fixture.faulty("VERSION") else { return };
    let PluginProblem::AbiVersion { got, expected } = problem(Library::load(&path)) else { panic!("VERSION") };
    assert_eq!(got, expected + 41);
}

#[test]
fn malformed_libraries() {
    let fixture = Fixture::new();
    for (fault, words) in [
        ("TABLE_IS_NULL", "null"),
        ("PLUGIN_SIZE", "1 bytes"),
        ("NO_TYPES", "no type"),
        ("TYPES_ARE_NULL", "null"),
        ("KIND", "kind 9"),
        ("TYPE_IS_NOT_UTF8", "UTF-8"),
        ("TYPE_IS_NULL", "UTF-8"),
        ("NO_MATERIAL_TABLE", "no material table"),
        ("TABLE_SIZE", "8 bytes"),
    ] {
        let Some(path) = fixture.faulty(fault) else { return };
        let problem = problem(Library::load(&path));
        assert!(
            matches!(&problem, PluginProblem::Malformed { what, .. } if what.contains(words)),
            "{fault}: {problem}"
        );
    }
    let Some(path) = fixture.faulty("DUPLICATE") else { return };
    let problem = problem(Library::load(&path));
    assert!(matches!(&problem, PluginProblem::Duplicate { type_name, .. } if type_name == "zero"), "{problem}");
}

#[test]
fn malformed_answers() {
    let fixture = Fixture::new();
    for (fault, words) in [
        ("NULL_HANDLE", "handle is null"),
        ("NULL_FUNCTION", "function is null"),
        ("MANY_PARAMETERS", "parameters"),
        ("DENSITY", "-1"),
        ("FLAG", "stiffness_frozen is 2"),
        ("LENGTH_RULE", "hinge_length is 3"),
        ("PARAMETER_OUTSIDE", "outside"),
        ("NAME_IS_NOT_UTF8", "UTF-8"),
    ] {
        let Some(path) = fixture.faulty(fault) else { return };
        let library = Library::load(&path).expect("it loads");
        let problem = problem(library.material("zero", "type = \"zero\""));
        assert!(
            matches!(&problem, PluginProblem::Malformed { what, .. } if what.contains(words)),
            "{fault}: {problem}"
        );
    }
    let Some(path) = fixture.faulty("CHANGED_IS_NULL") else { return };
    let model = Library::load(&path).and_then(|l| l.material("zero", "")).expect("a material");
    assert!(matches!(problem(model.with_parameters(&[0.5])), PluginProblem::Malformed { .. }));
}

#[test]
fn failures_carry_the_plugins_words() {
    let fixture = Fixture::new();
    for (fault, words) in
        [("FAILS", "the loom is broken"), ("FAILS_SILENTLY", "status 77"), ("ERROR_IS_NOT_UTF8", "\u{fffd}")]
    {
        let Some(path) = fixture.faulty(fault) else { return };
        let library = Library::load(&path).expect("it loads");
        let problem = problem(library.material("zero", ""));
        let told = matches!(&problem, PluginProblem::Failed { type_name, call, message }
            if type_name == "zero" && call == "create" && message.contains(words));
        assert!(told, "{fault}: {problem}");
    }
}

#[test]
fn errors_with_numbers_keep_their_type() {
    let fixture = Fixture::new();
    let refused = |fault: &str| {
        let path = fixture.faulty(fault)?;
        Some(Library::load(&path).expect("it loads").material("zero", "").err().expect("refused"))
    };
    let Some(error) = refused("LENGTH_ERROR") else { return };
    assert!(matches!(&error, Error::Length { what, expected: 12, got: 7 } if what == "weft counts"), "{error}");
    let Some(error) = refused("NON_FINITE_ERROR") else { return };
    let told = matches!(&error, Error::NonFinite { what, index: 3, value } if what == "warp tension" && value.is_nan());
    assert!(told, "{error}");
    let Some(error) = refused("PARAMETER_ERROR") else { return };
    let told = matches!(&error, Error::Parameter { name, value, lower, upper, unit }
        if name == "k" && *value == -1.5 && *lower == 0.0 && *upper == 1e6 && unit == "N/m");
    assert!(told, "{error}");
    let Some(error) = refused("GARBLED_ERROR") else { return };
    assert!(error.to_string().contains("status 5 with the text `k\nmany\nfew`"), "{error}");
}

/// Bound when it is first called, it would end the program there.
#[test]
#[cfg(target_os = "linux")]
fn a_function_that_is_nowhere_is_found_missing_when_loading() {
    let fixture = Fixture::new();
    let Some(path) = fixture.faulty("MISSING_FUNCTION") else { return };
    let problem = problem(Library::load(&path));
    let told = matches!(&problem, PluginProblem::NotALibrary { reason } if reason.contains("a_loom_that_nobody_built"));
    assert!(told, "{problem}");
}

#[test]
fn wrong_lengths_never_reach_the_library() {
    let fixture = Fixture::new();
    let Some(path) = fixture.faulty("NONE") else { return };
    let model = Library::load(&path).and_then(|l| l.material("zero", "")).expect("a material");
    let mut energy = [0.0f64; 2];
    let green = [0.0; 5];
    let mut block = MembraneBlock::new(2, &green);
    block.energy = (&mut energy[..]).into();
    assert!(matches!(model.membrane((&mut block).into()), Err(Error::Length { .. })));
    let green = [0.0; 6];
    let mut block = MembraneBlock::new(2, &green);
    block.stiffness = (&mut energy[..]).into();
    assert!(model.membrane((&mut block).into()).is_err());
    let mut stiffness = [0.0f64; 8];
    let mut block = MembraneBlock::new(2, &green);
    block.stiffness = (&mut stiffness[..]).into();
    assert!(matches!(model.membrane((&mut block).into()), Err(Error::Unsupported { .. })));
    let (one, two) = ([0.1f32], [0.0f32, 1.0]);
    let mut k = [0.0f32; 1];
    let mut block = HingeBlock::new(1, [&one, &one, &one, &one], [&two, &one]);
    block.stiffness = (&mut k[..]).into();
    assert!(matches!(model.hinge((&mut block).into()), Err(Error::Length { .. })));
    assert!(matches!(model.with_parameters(&[1.0, 1.0]), Err(Error::Length { .. })));
    assert!(matches!(model.with_parameters(&[f64::NAN]), Err(Error::Parameter { .. })));
}
