//! All 320 cases of `data/arcsim_stretch.json` (ARCSim's own lookup, energy and force; provenance in its header).

use crate::asking::{FABRICS, Membrane, measured, membrane};
use caphy_materials::measured::{Form, StiffnessGradient, StretchLookup};
use serde::Deserialize;

#[derive(Deserialize)]
struct Reference {
    cases: Vec<Case>,
}

#[derive(Deserialize)]
#[allow(non_snake_case)]
struct Case {
    id: String,
    fabric: String,
    F: [[f64; 2]; 3],
    k: [f64; 4],
    k_direct: Option<[f64; 4]>,
    W_force: f64,
    S_force: [f64; 3],
    grad_W_force: Option<[[f64; 2]; 3]>,
}

impl Case {
    fn green(&self) -> [f64; 3] {
        let f = &self.F;
        let product = |a: usize, b: usize| (0..3).map(|row| f[row][a] * f[row][b]).sum::<f64>();
        [(product(0, 0) - 1.0) / 2.0, (product(1, 1) - 1.0) / 2.0, product(0, 1) / 2.0]
    }
}

fn cases() -> Vec<Case> {
    let reference: Reference = serde_json::from_str(include_str!("../data/arcsim_stretch.json")).unwrap();
    assert_eq!(reference.cases.len(), 320);
    reference.cases
}

/// Asks each fabric for its cases and hands (case, answer) on.
fn each(lookup: StretchLookup, gradient: StiffnessGradient, mut check: impl FnMut(&Case, &Membrane)) {
    let cases = cases();
    let mut seen = 0;
    for fabric in FABRICS {
        let model = measured(fabric, |s| {
            s.lookup = Some(lookup);
            s.stiffness_gradient = Some(gradient);
        });
        let mine: Vec<&Case> = cases.iter().filter(|c| c.fabric == fabric).collect();
        let green: Vec<[f64; 3]> = mine.iter().map(|c| c.green()).collect();
        for (case, answer) in mine.iter().zip(membrane::<f64>(model.as_ref(), &green)) {
            check(case, &answer);
            seen += 1;
        }
    }
    assert_eq!(seen, 320);
}

/// Relative to the array's largest entry, with an absolute floor.
fn close(id: &str, what: &str, got: &[f64], want: &[f64], relative: f64, floor: f64) {
    let size = want.iter().fold(0.0f64, |m, w| m.max(w.abs()));
    for (g, w) in got.iter().zip(want) {
        assert!((g - w).abs() <= relative * size + floor, "{id} {what}: {got:?}, reference {want:?}");
    }
}

#[test]
fn table_stiffness_energy_and_stress() {
    each(StretchLookup::Table, StiffnessGradient::Frozen, |case, answer| {
        close(&case.id, "k", &answer.stiffness, &case.k, 1e-9, 1e-7);
        close(&case.id, "W", &[answer.energy], &[case.W_force], 1e-8, 1e-10);
        close(&case.id, "S", &answer.stress, &case.S_force, 1e-8, 1e-7);
    });
}

#[test]
fn direct_stiffness() {
    let mut compared = 0;
    each(StretchLookup::Direct, StiffnessGradient::Frozen, |case, answer| {
        // Null where the reference's principal direction is ill-conditioned.
        if let Some(k) = case.k_direct {
            close(&case.id, "k", &answer.stiffness, &k, 1e-9, 1e-7);
            compared += 1;
        }
    });
    assert!(compared > 200, "{compared}");
}

#[test]
fn full_stress_is_the_reference_gradient() {
    let mut compared = 0;
    each(StretchLookup::Table, StiffnessGradient::Full, |case, answer| {
        // Null where the reference's difference stencil crosses a kink.
        if let Some(gradient) = case.grad_W_force {
            let [suu, svv, suv] = answer.stress;
            let piola: Vec<f64> =
                case.F.iter().flat_map(|f| [f[0] * suu + f[1] * suv, f[0] * suv + f[1] * svv]).collect();
            close(&case.id, "dW/dF", &piola, gradient.as_flattened(), 1e-5, 1e-5);
            compared += 1;
        }
    });
    assert_eq!(compared, 260);
}

#[test]
fn isotropic_form_is_the_rotational_average() {
    // λ and μ at rest, reference note section 2.5, two decimals.
    for (fabric, lambda, mu) in
        [("ivory-rib-knit", -6.46, 68.56), ("11oz-black-denim", 297.53, 326.94), ("royal-target", 985.58, 1060.53)]
    {
        let model = measured(fabric, |s| s.form = Some(Form::Isotropic));
        let k = membrane::<f64>(model.as_ref(), &[[0.0; 3]])[0].stiffness;
        assert!((k[1] - lambda).abs() < 0.005 && (k[3] / 2.0 - mu).abs() < 0.005, "{fabric}: {k:?}");
        assert!((k[0] - k[1] - k[3]).abs() < 1e-9 && k[0] == k[2], "{fabric}: {k:?}");
    }
}

#[test]
fn the_shipped_catalogue_is_the_reference_one() {
    let shared = std::env::var("CAPHY_SHARED")
        .unwrap_or_else(|_| concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared").to_owned());
    let path = std::path::Path::new(&shared).join("reference/fabrics.json");
    match std::fs::read_to_string(&path) {
        Ok(reference) => assert_eq!(reference, include_str!("../../src/fabrics.json")),
        Err(problem) => println!("SKIPPED: the shipped catalogue was not compared, {}: {problem}", path.display()),
    }
}
