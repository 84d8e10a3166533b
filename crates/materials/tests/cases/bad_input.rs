//! Typed errors that name the place, and configuration round trips.

use crate::asking::measured;
use caphy_core::Error;
use caphy_core::material::{HingeLength, MaterialModel, MaterialSpec, MembraneBlock};
use caphy_materials::{MaterialMeasuredSpec, MaterialStvk, MaterialStvkSpec};

fn build(text: &str) -> Result<Box<dyn MaterialModel>, String> {
    toml::from_str::<Box<dyn MaterialSpec>>(text).map_err(|e| e.to_string())?.build().map_err(|e| e.to_string())
}

fn refused(text: &str, words: &[&str]) {
    let Err(error) = build(text) else { panic!("accepted: {text}") };
    for word in words {
        assert!(error.contains(word), "`{word}` missing in: {error}");
    }
}

#[test]
fn unknown_keys_names_and_values_list_what_exists() {
    refused("type = \"measured\"\nfabric = \"gray-interlock\"\nfabrik = 1", &["fabrik", "fabric"]);
    refused("type = \"measured\"\nfabric = \"tweed\"", &["tweed", "gray-interlock", "royal-target"]);
    refused("type = \"measured\"", &["fabric"]);
    refused("type = \"measured\"\nfabric = \"gray-interlock\"\nlookup = \"tree\"", &["tree", "table", "direct"]);
    refused(
        "type = \"measured\"\nfabric = \"gray-interlock\"\nlookup = \"direct\"\nstiffness_gradient = \"full\"",
        &["stiffness_gradient", "table"],
    );
    refused(
        "type = \"measured\"\nfabric = \"gray-interlock\"\nbending_multipliers = [1, -1, 1]",
        &["bending_multipliers", "-1"],
    );
    refused("type = \"measured\"\nfabric = \"gray-interlock\"\nmembrane_multipliers = [1, 1]", &["4"]);
    refused("type = \"measured\"\nfabric = \"gray-interlock\"\ndensity_kg_per_m2 = 0", &["density", "0"]);
    refused("type = \"stvk\"\nlambda = 1", &["lambda", "lambda_n_per_m"]);
    refused("type = \"velvet\"", &["velvet"]);
}

#[test]
fn exactly_one_group_of_stvk_keys() {
    let groups = ["lambda_pa", "lambda_n_per_m", "young_pa", "thickness_m"];
    refused("type = \"stvk\"", &groups);
    refused("type = \"stvk\"\nlambda_pa = 1\nmu_pa = 1", &groups);
    refused("type = \"stvk\"\nlambda_n_per_m = 1\nmu_n_per_m = 1\nthickness_m = 1e-3", &groups);
    refused("type = \"stvk\"\nlambda_n_per_m = 1\nmu_n_per_m = 1\nyoung_pa = 1", &groups);
    refused("type = \"stvk\"\nlambda_n_per_m = 1", &groups);
    refused("type = \"stvk\"\nlambda_n_per_m = 1\nmu_n_per_m = 0", &["mu", "positive"]);
    refused("type = \"stvk\"\nlambda_n_per_m = nan\nmu_n_per_m = 1", &["lambda"]);
    refused("type = \"stvk\"\nyoung_pa = 1e5\npoisson = 0.6\nthickness_m = 1e-3", &["0.6", "poisson"]);
    refused("type = \"stvk\"\nyoung_pa = 1e5\npoisson = 0.3\nthickness_m = -1e-3", &["thickness_m"]);
    refused("type = \"stvk\"\nlambda_n_per_m = 1\nmu_n_per_m = 1\nbending_nm = -1", &["bending_nm"]);
}

#[test]
fn round_trips() {
    for text in [
        "type = \"stvk\"\nlambda_n_per_m = 20.0\nmu_n_per_m = 11.0\nhinge_length = \"current\"",
        "type = \"measured\"\nfabric = \"royal-target\"\nedge_length = \"current\"\nbending = \"faithful\"",
    ] {
        let spec: Box<dyn MaterialSpec> = toml::from_str(text).unwrap();
        let written = toml::to_string(&spec).unwrap();
        let again: Box<dyn MaterialSpec> = toml::from_str(&written).unwrap();
        assert_eq!(written, toml::to_string(&again).unwrap());
        let (a, b) = (spec.build().unwrap(), again.build().unwrap());
        assert_eq!(a.describe(), b.describe());
        assert_eq!(a.parameters(), b.parameters());
    }
    let snug = MaterialStvkSpec::snug();
    assert_eq!(toml::from_str::<MaterialStvkSpec>(&toml::to_string(&snug).unwrap()).unwrap(), snug);
    let gray = MaterialMeasuredSpec::new("gray-interlock");
    assert_eq!(toml::from_str::<MaterialMeasuredSpec>("fabric = \"gray-interlock\"").unwrap(), gray);
    let current = build("type = \"measured\"\nfabric = \"gray-interlock\"\nedge_length = \"current\"").unwrap();
    assert_eq!(current.describe().hinge_length, HingeLength::CurrentHeld);
    assert_eq!(MaterialStvk::snug().unwrap().describe().hinge_length, HingeLength::Current);
}

#[test]
fn bad_blocks() {
    for model in [measured("gray-interlock", |_| ()), Box::new(MaterialStvk::snug().unwrap())] {
        let mut short = MembraneBlock::<f32>::new(2, &[0.0; 5]);
        assert!(matches!(model.membrane((&mut short).into()), Err(Error::Length { expected: 6, got: 5, .. })));
        let green = [0.0, f32::NAN, 0.0];
        let bad = model.membrane((&mut MembraneBlock::new(1, &green)).into());
        assert!(matches!(bad, Err(Error::NonFinite { index: 1, .. })));
        let mut energy = [0.0; 2];
        let mut block = MembraneBlock::<f64>::new(1, &[0.0; 3]);
        block.energy = (&mut energy[..]).into();
        assert!(matches!(model.membrane((&mut block).into()), Err(Error::Length { expected: 1, got: 2, .. })));
    }
}

#[test]
fn bad_parameters() {
    for model in [measured("gray-interlock", |_| ()), Box::new(MaterialStvk::snug().unwrap())] {
        let values: Vec<f64> = model.parameters().iter().map(|p| p.value).collect();
        assert!(matches!(model.with_parameters(&values[1..]), Err(Error::Length { .. })));
        for bad in [f64::NAN, 1e12, -1e12] {
            let mut moved = values.clone();
            moved[0] = bad;
            assert!(matches!(model.with_parameters(&moved), Err(Error::Parameter { .. })), "{bad}");
        }
        let copy = model.with_parameters(&values).unwrap();
        assert_eq!(copy.parameters(), model.parameters());
    }
}

#[test]
fn names_and_units_of_the_native_parameters() {
    let parameters = measured("gray-interlock", |_| ()).parameters();
    assert_eq!(parameters.len(), 39);
    assert_eq!((parameters[0].name.as_str(), parameters[0].unit.as_str()), ("c11[row 0]", "N/m"));
    assert_eq!(parameters[23].name, "c33[row 5]");
    assert_eq!((parameters[24].name.as_str(), parameters[24].unit.as_str()), ("bend[row 0, column 0]", "N·m"));
    let mut names: Vec<&str> = parameters.iter().map(|p| p.name.as_str()).collect();
    names.sort_unstable();
    names.dedup();
    assert_eq!(names.len(), 39);
}
