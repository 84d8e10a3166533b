//! The neo-Hookean sheet in closed form, beside StVK, at its joint and at the extremes.

use caphy_core::Error;
use caphy_core::extension::MaterialModelExt;
use caphy_core::material::{MaterialModel, MaterialSpec};
use caphy_materials::neo_hookean::JOINT;

const LAMBDA: f64 = 20.0;
const MU: f64 = 11.0;

fn model(kind: &str) -> Box<dyn MaterialModel> {
    let text = format!("type = \"{kind}\"\nlambda_n_per_m = {LAMBDA}\nmu_n_per_m = {MU}");
    toml::from_str::<Box<dyn MaterialSpec>>(&text).unwrap().build().unwrap()
}

#[test]
fn energy_and_stress_in_closed_form() {
    let sheet = model("neo_hookean");
    for (a, b) in [(1.2, 0.9), (0.7, 0.8), (2.0, 1.5), (1.0, 0.4)] {
        // Principal stretches a along u, b along v: S = μ (1 − C⁻¹) + λ ln J C⁻¹.
        let log = f64::ln(a * b);
        let answer = sheet.at([0.5 * (a * a - 1.0), 0.5 * (b * b - 1.0), 0.0]).unwrap();
        let psi = 0.5 * MU * (a * a + b * b - 2.0 - 2.0 * log) + 0.5 * LAMBDA * log * log;
        assert!((answer.energy - psi).abs() < 1e-13 * psi.max(1.0), "{} {psi}", answer.energy);
        for (c, s) in [(0, a), (1, b)] {
            let want = MU * (1.0 - 1.0 / (s * s)) + LAMBDA * log / (s * s);
            assert!((answer.stress[c] - want).abs() < 1e-12 * want.abs().max(1.0), "{:?} {want}", answer.stress);
        }
        assert_eq!(answer.stress[2], 0.0);
    }
}

#[test]
fn small_strains_are_those_of_stvk() {
    let (neo, stvk) = (model("neo_hookean"), model("stvk"));
    for size in [1e-2, 1e-4, 1e-6] {
        let g = [0.7 * size, -0.4 * size, 0.5 * size];
        let (a, b) = (neo.at(g).unwrap(), stvk.at(g).unwrap());
        // They differ in third order: relative to the second, by a few times the strain.
        assert!((a.energy / b.energy - 1.0).abs() < 8.0 * size, "{size}: {} {}", a.energy, b.energy);
        for c in 0..3 {
            assert!((a.stress[c] - b.stress[c]).abs() < 8.0 * size * MU * size * 4.0, "{size}: {a:?} {b:?}");
        }
    }
}

#[test]
fn it_pushes_back_where_stvk_gives_way() {
    // Force per width along u at stretch s: s Suu.
    let push = |sheet: &dyn MaterialModel, s: f64| -s * sheet.at([0.5 * (s * s - 1.0), 0.0, 0.0]).unwrap().stress[0];
    let (neo, stvk) = (model("neo_hookean"), model("stvk"));
    assert!(push(&*stvk, 0.05) < push(&*stvk, 0.3), "StVK softens on the way to collapse");
    assert!(push(&*neo, 0.3) > push(&*neo, 0.6) && push(&*neo, 0.12) > push(&*neo, 0.3));
    assert!(push(&*neo, 0.12) > 10.0 * push(&*stvk, 0.12));
}

/// Area ratio below which the energy falls again as the sheet is squeezed further; 0 when it never does.
fn gives_way(lambda: f64, evenly: bool) -> f64 {
    let text = format!("type = \"neo_hookean\"\nlambda_n_per_m = {}\nmu_n_per_m = {MU}", lambda * MU);
    let sheet = toml::from_str::<Box<dyn MaterialSpec>>(&text).unwrap().build().unwrap();
    let steps = 4000;
    let ratio = |i: i32| f64::from(i) / f64::from(steps);
    let energy = |area: f64| {
        let (u, v) = if evenly { (area, area) } else { (area * area, 1.0) };
        sheet.at([0.5 * (u - 1.0), 0.5 * (v - 1.0), 0.0]).unwrap().energy
    };
    // Rounding of energies of at most a few times mu.
    let rises = |i: &i32| energy(ratio(*i)) > energy(ratio(i - 1)) + 1e-12 * MU;
    (1..=steps).rev().find(rises).map_or(0.0, ratio)
}

#[test]
fn it_resists_collapse_within_the_documented_limits() {
    for lambda in [0.0, 0.5, 2.0] {
        assert!(gives_way(lambda, true) <= 0.0051, "{lambda}: {}", gives_way(lambda, true));
    }
    assert!(gives_way(-0.3, true) <= 0.05, "{}", gives_way(-0.3, true));
    let soft = gives_way(-0.5, true);
    assert!(soft > 0.19 && soft <= 0.21, "{soft}");
    for lambda in [-0.3, 0.0, 2.0] {
        assert_eq!(gives_way(lambda, false), 0.0, "{lambda}");
    }
}

#[test]
fn energy_stress_and_tangent_cross_the_joint_without_a_jump() {
    let sheet = model("neo_hookean");
    // det C = JOINT by squeezing u alone, with some shear.
    let w = 0.02;
    let u = 0.5 * (JOINT + 4.0 * w * w - 1.0);
    let h = 1e-9;
    let (below, above) = ([u - h, 0.0, w], [u + h, 0.0, w]);
    let (a, b) = (sheet.at(below).unwrap(), sheet.at(above).unwrap());
    let (ta, tb) = (sheet.tangent_total_at(below).unwrap(), sheet.tangent_total_at(above).unwrap());
    let largest = ta.iter().flatten().fold(0.0f64, |m, t| m.max(t.abs()));
    assert!((a.energy - b.energy).abs() < 4.0 * h * a.stress[0].abs());
    assert!((a.stress[0] - b.stress[0]).abs() < 4.0 * h * largest);
    // The third derivative jumps, so that the tangent moves by at most a few of its own per step / JOINT.
    for (a, b) in ta.iter().flatten().zip(tb.iter().flatten()) {
        assert!((a - b).abs() < 100.0 * h / JOINT * largest, "{ta:?} {tb:?}");
    }
    // Further in, collapse included, energy goes on growing.
    let squeezed = |u: f64| sheet.at([u, 0.0, 0.0]).unwrap();
    assert!(squeezed(-0.5).energy > squeezed(-0.499).energy && squeezed(-0.5).stress[0] < squeezed(-0.49).stress[0]);
}

#[test]
fn mistakes_are_those_of_stvk() {
    let build = |text: &str| toml::from_str::<Box<dyn MaterialSpec>>(text).unwrap().build();
    let none = build("type = \"neo_hookean\"").err().unwrap();
    assert!(matches!(&none, Error::Config { remedy, .. } if remedy.contains("young_pa")), "{none}");
    assert!(build("type = \"neo_hookean\"\nlambda_n_per_m = 1.0\nmu_n_per_m = -1.0").is_err());
    assert!(build("type = \"neo_hookean\"\nlambda_n_per_m = 1.0\nmu_n_per_m = 1.0\nbending_nm = -1.0").is_err());
    assert!(toml::from_str::<Box<dyn MaterialSpec>>("type = \"neo_hookean\"\nmu = 1.0").is_err());
}
