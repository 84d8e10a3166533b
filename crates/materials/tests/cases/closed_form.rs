//! StVK by hand, and the pitfalls of the measured tables.

use crate::asking::{Hinge, hinges, measured, membrane};
use caphy_core::material::MaterialModel;
use caphy_materials::measured::BendingLookup;
use caphy_materials::{MaterialStvk, MaterialStvkSpec};

#[test]
fn stvk_uniaxial_and_shear() {
    let model = MaterialStvk::snug().unwrap();
    // Reference note, section 6: μ t = 11.0774, λ t = 20.8643 N/m, area density 0.20022 kg/m².
    let (lambda, mu) = (model.lambda().0, model.mu().0);
    assert!((lambda - 20.8643).abs() < 5e-5 && (mu - 11.0774).abs() < 5e-5);
    assert!((model.describe().density.unwrap().0 - 0.20022).abs() < 1e-9);
    // The constant itself, from E, ν, t: 50 E t³ / (12 (1 − ν²)).
    let bending: f64 = 50.0 * 0.7e5 / (1.0 - 0.485 * 0.485) * 4.7e-4f64.powi(3) / 12.0;
    assert!((model.bending().0 - bending).abs() < 1e-10);

    let g = 0.105; // stretch 1.1 along u
    let a = membrane::<f64>(&model, &[[g, 0.0, 0.0], [0.0, 0.0, 0.2]]);
    assert!((a[0].energy - (0.5 * lambda + mu) * g * g).abs() < 1e-14);
    assert!((a[0].stress[0] - (lambda + 2.0 * mu) * g).abs() < 1e-13);
    assert!((a[0].stress[1] - lambda * g).abs() < 1e-13 && a[0].stress[2] == 0.0);
    assert!((a[1].energy - 2.0 * mu * 0.04).abs() < 1e-14);
    assert!((a[1].stress[2] - 2.0 * mu * 0.2).abs() < 1e-14);
    assert_eq!(a[0].stiffness, [lambda + 2.0 * mu, lambda, lambda + 2.0 * mu, 2.0 * mu]);
}

#[test]
fn stvk_tangents_are_its_hessian() {
    let model = MaterialStvk::snug().unwrap();
    let grid = crate::asking::strains(20, 2.0);
    for (g, a) in grid.iter().zip(membrane::<f64>(&model, &grid)) {
        assert_eq!(a.held, a.total);
        for c in 0..3 {
            let predicted: f64 = (0..3).map(|d| a.held[c][d] * g[d]).sum();
            assert!((predicted - a.stress[c]).abs() < 1e-13 * 200.0);
        }
        let work: f64 = (0..3).map(|c| a.stress[c] * g[c] * if c == 2 { 2.0 } else { 1.0 }).sum();
        assert!((0.5 * work - a.energy).abs() < 1e-12 * (1.0 + a.energy));
    }
}

#[test]
fn the_three_groups_of_stvk_keys_agree() {
    let snug = MaterialStvk::snug().unwrap();
    let parse = |text: &str| toml::from_str::<MaterialStvkSpec>(text).unwrap().build_stvk().unwrap();
    let young = parse("young_pa = 0.7e5\npoisson = 0.485\nthickness_m = 4.7e-4");
    let bulk = parse("lambda_pa = 44392.14\nmu_pa = 23569.02\nthickness_m = 4.7e-4");
    let sheet = parse("lambda_n_per_m = 20.8643\nmu_n_per_m = 11.0774");
    for other in [young, bulk, sheet] {
        assert!((other.lambda().0 - snug.lambda().0).abs() < 1e-4 && (other.mu().0 - snug.mu().0).abs() < 1e-4);
        assert_eq!(other.bending(), snug.bending());
    }
}

#[test]
fn pitfall_shear_energy_matches_the_force() {
    // Pure shear: ARCSim's energy routine would give half of this.
    let model = measured("white-swim-solid", |_| ());
    let a = &membrane::<f64>(model.as_ref(), &[[0.0, 0.0, 0.01]])[0];
    assert!((a.energy - a.stiffness[3] * 1e-4).abs() < 1e-15);
    assert!((a.stress[2] * 0.01 - a.energy).abs() < 1e-15);
}

#[test]
fn pitfall_negative_rows_stay_raw_and_evaluate_to_zero() {
    let model = measured("gray-interlock", |_| ());
    let parameters = model.parameters();
    let negative: Vec<_> = parameters.iter().filter(|p| p.value < 0.0).collect();
    assert!(!negative.is_empty() && negative.iter().all(|p| p.lower < p.value && p.upper > 0.0));
    for a in membrane::<f64>(model.as_ref(), &crate::asking::strains(300, 0.7)) {
        assert!(a.stiffness.iter().all(|k| *k >= 0.0));
    }
    // A bounded estimate may lift a negative entry to zero and above.
    let values: Vec<f64> = parameters.iter().map(|p| p.value.max(0.0)).collect();
    assert!(model.with_parameters(&values).is_ok());
}

#[test]
fn pitfall_ridges() {
    let fold = |angle: f64| Hinge {
        angle,
        rest: 0.0,
        length: 0.1,
        area: 0.005,
        direction0: [1.0, 0.0],
        direction1: [1.0, 0.0],
    };
    let both = [fold(1.0), fold(-1.0), fold(3.0)];
    let repaired = hinges::<f64>(measured("white-dots-on-blk", |_| ()).as_ref(), &both);
    assert_eq!(repaired[0].stiffness, repaired[1].stiffness);
    // Beyond curvature 20 1/m the last column holds: s = 3·0.1/0.05 = 6.
    let model = measured("white-dots-on-blk", |_| ());
    let last = model.parameters()[24 + 4].value;
    assert!((repaired[2].stiffness - last).abs() < 1e-18);
    assert_eq!(repaired[2].by_angle, 0.0);
    let faithful =
        hinges::<f64>(measured("white-dots-on-blk", |s| s.bending = Some(BendingLookup::Faithful)).as_ref(), &both);
    assert!(faithful[0].stiffness != faithful[1].stiffness);
}

#[test]
fn multipliers_scale_stiffness_exactly_as_they_scale_entries() {
    let plain = measured("camel-ponte-roma", |_| ());
    let scaled = measured("camel-ponte-roma", |s| {
        s.membrane_multipliers = [2.0, 0.5, 3.0, 10.0];
        s.bending_multipliers = [2.0, 2.0, 2.0];
    });
    let grid = crate::asking::strains(50, 0.4);
    let (plain_answers, scaled_answers) =
        (membrane::<f64>(plain.as_ref(), &grid), membrane::<f64>(scaled.as_ref(), &grid));
    for (a, b) in plain_answers.iter().zip(&scaled_answers) {
        for (i, factor) in [2.0, 0.5, 3.0, 10.0].iter().enumerate() {
            assert!((a.stiffness[i] * factor - b.stiffness[i]).abs() < 1e-10);
        }
    }
    let folds = crate::asking::folds(50);
    for (a, b) in hinges::<f64>(plain.as_ref(), &folds).iter().zip(hinges::<f64>(scaled.as_ref(), &folds)) {
        assert!((2.0 * a.stiffness - b.stiffness).abs() < 1e-18);
    }
}
