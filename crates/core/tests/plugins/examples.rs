//! The examples are built, loaded, asked and checked.

use crate::build;
use caphy_core::Error;
use caphy_core::conformance::{Row, Verdict, material, net, run_all};
use caphy_core::extension::{Hinge, MaterialModelExt};
use caphy_core::host::{Library, PluginKind};
use caphy_core::material::MaterialModel;
use caphy_core::units::KilogramPerSquareMetre;
use std::sync::Arc;

fn not_offered(rows: &[Row]) -> Vec<&str> {
    let failed: Vec<&Row> = rows.iter().filter(|r| r.outcome.is_err()).collect();
    assert!(failed.is_empty(), "{failed:#?}");
    rows.iter().filter(|r| r.outcome == Ok(Verdict::NotOffered)).map(|r| r.name).collect()
}

/// k = (500, 40, 400, 20) N/m by hand.
fn assert_woven(model: &dyn MaterialModel) {
    let g = [0.05, -0.02, 0.03];
    let answer = model.at(g).expect("an answer");
    let psi = 0.5 * (500.0 * g[0] * g[0] + 400.0 * g[1] * g[1]) + 40.0 * g[0] * g[1] + 20.0 * g[2] * g[2];
    let stress = [500.0 * g[0] + 40.0 * g[1], 400.0 * g[1] + 40.0 * g[0], 20.0 * g[2]];
    assert!((answer.energy - psi).abs() < 1e-14 * psi, "{} {psi}", answer.energy);
    for c in 0..3 {
        assert!((answer.stress[c] - stress[c]).abs() < 1e-13, "{:?} {stress:?}", answer.stress);
    }
    let fold = |directions| Hinge { angle: 0.3, angle_rest: 0.0, length: 0.01, area: 1e-4, directions };
    let bend = |directions| model.bending_stiffness(&fold(directions)).expect("a stiffness");
    assert!((bend([[1.0, 0.0]; 2]) - 4e-5).abs() < 1e-18 && (bend([[0.0, 0.01]; 2]) - 3e-5).abs() < 1e-18);
    assert!((bend([[0.01, 0.01]; 2]) - 3.5e-5).abs() < 1e-17);
}

#[test]
fn a_material_in_rust() {
    let library = Arc::new(Library::load(&build::rust("plugin-material", "caphy-plugin-woven")).expect("a plugin"));
    assert_eq!(
        library.types().iter().map(|t| (t.kind, &*t.name)).collect::<Vec<_>>(),
        [(PluginKind::Material, "woven")]
    );
    let model = library.material("woven", "type = \"woven\"").expect("a material");
    assert_woven(&*model);
    assert_eq!(model.describe().density, Some(KilogramPerSquareMetre(0.15)));
    let rows = run_all(material::CHECKS, &library.material_subject("woven", "type = \"woven\"\nk1 = 30.0"));
    assert!(not_offered(&rows).is_empty());

    // Errors of the plugin's own are the same as if it were linked.
    let refused = |toml: &str| library.material("woven", toml).err().expect("refused");
    assert!(matches!(refused("type = \"woven\"\nk0 = -1.0"), Error::Config { key, .. } if key == "k0"));
    assert!(refused("type = \"woven\"\nkO = 1.0").to_string().contains("`kO`"));
    assert!(refused("type = \"woven\"\nk0 = \"stiff\"").to_string().contains("string"));
    let mut values: Vec<f64> = model.parameters().iter().map(|p| p.value).collect();
    values[1] = 1000.0;
    assert!(matches!(model.with_parameters(&values), Err(Error::Config { key, .. }) if key == "k1"));
    values[1] = -1.0;
    assert!(matches!(model.with_parameters(&values), Err(Error::Parameter { .. })));
}

#[test]
fn the_same_material_in_c() {
    let folder = tempfile::tempdir().expect("a folder");
    let Some(path) = build::example_in_c(folder.path()) else { return };
    let library = Arc::new(Library::load(&path).expect("a plugin"));
    let model = library.material("woven_c", "type = \"woven_c\"").expect("a material");
    assert_woven(&*model);
    let rows = run_all(material::CHECKS, &library.material_subject("woven_c", "type = \"woven_c\"\nk1 = 30.0"));
    assert_eq!(not_offered(&rows), ["parameter_derivatives_are_exact"]);

    // The same numbers as in Rust.
    let other = Library::load(&build::rust("plugin-material", "caphy-plugin-woven")).expect("a plugin");
    let other = other.material("woven", "type = \"woven\"").expect("a material");
    for i in 0..200 {
        let x = f64::from(i);
        let green = [0.3 * (x * 0.7).sin(), 0.3 * (x * 1.3).cos(), 0.2 * (x * 0.4).sin()];
        let (a, b) = (model.at(green).expect("an answer"), other.at(green).expect("an answer"));
        assert!((a.energy - b.energy).abs() <= 1e-14 * a.energy && a.stiffness.is_some() && b.stiffness.is_none());
        // Rust sums Suu in another order: two roundings of its terms, which are at most 150 + 12 N/m.
        assert!((0..3).all(|c| (a.stress[c] - b.stress[c]).abs() <= 1e-13), "{a:?} {b:?}");
    }
    let refused = |toml: &str| library.material("woven_c", toml).err().expect("refused");
    assert!(
        matches!(refused("k1 = 1e5"), Error::Config { key, problem, .. } if key == "k1" && problem.contains("k0 k2"))
    );
    assert!(refused("kO = 1").to_string().contains("`kO`"));
    // Nothing is passed over: each line is blank, a comment, or `key = number`.
    let long = format!("k0 = 1{}", " ".repeat(300));
    for malformed in ["k0", "k0 =", "= 1", "[woven]", "k0 = 1 2", "k0 1", "k0 = 1x", long.as_str()] {
        assert!(matches!(refused(malformed), Error::Config { .. }), "{malformed}");
    }
    library.material("woven_c", "\n  # the default\ntype = \"woven_c\"\r\n\tk0 = 1e3 # stiff\n").expect("a material");
}

#[test]
fn a_net_in_rust() {
    let library = Arc::new(Library::load(&build::rust("plugin-net", "caphy-plugin-linear")).expect("a plugin"));
    let rows = run_all(net::CHECKS, &library.net_subject("linear", "type = \"linear\"\nfade = 0.7"));
    assert!(not_offered(&rows).is_empty());
    assert!(matches!(library.net("linear", "type = \"linear\"\nfade = 1.5", 2, 3), Err(Error::Config { .. })));
    // A kind or name that the library does not have lists what it has.
    let error = library.net("gru", "type = \"gru\"", 2, 3).err().expect("refused").to_string();
    assert!(error.contains("`linear`"), "{error}");
    assert!(library.material("linear", "type = \"linear\"").is_err());
}
