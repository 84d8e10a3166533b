//! What the reference note warns of, and what is done here about each (shear factor, negative rows and ridges stand in
//! `closed_form`).

use crate::asking::{FABRICS, measured};
use caphy_core::extension::{Hinge, MaterialModelExt};
use caphy_materials::measured::{BendingLookup, Fabric, StiffnessGradient, StretchLookup, average_lame};

fn stiffness(fabric: &str, lookup: StretchLookup, g: [f64; 3]) -> [f64; 4] {
    measured(fabric, |s| s.lookup = Some(lookup)).at(g).unwrap().stiffness.unwrap()
}

/// k0, k1, k2, k3, λ, μ of section 2.5.
const AT_REST: [[f64; 6]; 10] = [
    // The note prints 0.51 for k1; its own reference file has 0.5047, as we do.
    [89.80, 0.50, 157.60, 151.06, -6.46, 68.56],
    [301.55, 202.33, 497.68, 60.49, 236.53, 64.44],
    [4019.82, 7.28, 4075.38, 39.07, 1007.59, 1019.85],
    [30.89, 0.00, 46.24, 34.72, 0.96, 18.32],
    [72.60, 0.00, 117.67, 63.76, 7.84, 39.72],
    [41.64, 0.00, 109.84, 66.89, 2.21, 35.66],
    [414.36, 25.01, 2033.50, 108.84, 297.53, 326.94],
    [96.21, 16.93, 216.67, 111.85, 23.85, 62.84],
    [98.44, 107.73, 360.85, 28.89, 130.98, 37.70],
    [4046.94, 23.95, 4089.58, 197.81, 985.58, 1060.53],
];

#[test]
fn rest_stiffness_is_a_cells_mean_as_published() {
    for (name, want) in FABRICS.into_iter().zip(AT_REST) {
        let k = stiffness(name, StretchLookup::Table, [0.0; 3]);
        let [lambda, mu] = average_lame(k);
        for (got, want) in k.into_iter().chain([lambda, mu]).zip(want) {
            // Printed with two decimals.
            assert!((got - want).abs() <= 0.005 + 1e-9, "{name}: {got} instead of {want}");
        }
        // Zero strain is the centre of a cell, three of whose nodes are stretched: not twice the unstretched row.
        let row = Fabric::named(name).unwrap().stretching[0].map(|c| 2.0 * c.max(0.0));
        assert!((k[0] / row[0] - 1.0).abs() > 1e-3, "{name}");
    }
}

#[test]
fn stiffness_is_twice_the_raw_entry() {
    for name in FABRICS {
        let row = Fabric::named(name).unwrap().stretching[0];
        assert_eq!(stiffness(name, StretchLookup::Direct, [0.0; 3]), row.map(|c| 2.0 * c.max(0.0)), "{name}");
    }
}

#[test]
fn table_and_direct_evaluation_differ_and_each_says_which_it_is() {
    // Median 0.3 %, and at the worst most of the constant: nobody may mix them up.
    let mut differences: Vec<f64> = Vec::new();
    for name in FABRICS {
        for i in 0..60 {
            let x = f64::from(i);
            let g = [0.2 + 0.2 * (x * 0.7).sin(), 0.1 * (x * 1.7).cos(), 0.1 * (x * 0.9).sin()];
            let (table, direct) = (stiffness(name, StretchLookup::Table, g), stiffness(name, StretchLookup::Direct, g));
            let largest = direct.iter().fold(0.0f64, |m, k| m.max(*k));
            let apart = (0..4).map(|a| (table[a] - direct[a]).abs()).fold(0.0, f64::max);
            differences.push(apart / largest);
        }
    }
    differences.sort_by(f64::total_cmp);
    assert!(differences[differences.len() / 2] < 0.03 && differences[differences.len() - 1] > 0.03);
}

#[test]
fn kinks_are_in_the_slope_not_in_the_value() {
    // A plane of the table: Guu = 3/30 − 1/4 + 7/30.
    let plane = 10.0 / 30.0 - 0.25;
    let gray = measured("gray-interlock", |s| s.stiffness_gradient = Some(StiffnessGradient::Full));
    let at = |h: f64| gray.at([plane + h, 0.01, 0.02]).unwrap();
    let slope = |h: f64| gray.tangent_total_at([plane + h, 0.01, 0.02]).unwrap()[0][0];
    assert!((at(1e-9).energy - at(-1e-9).energy).abs() < 1e-6 * at(0.0).energy);
    assert!((slope(1e-6) - slope(-1e-6)).abs() > 1e-3 * slope(1e-6).abs(), "the tangent jumps there");
    // On Guv = 0 the slope by shear is the mean of both sides: 0 by symmetry, not NaN.
    let flat = gray.at([0.05, 0.01, 0.0]).unwrap();
    assert_eq!(flat.stress[2], 0.0);
}

#[test]
fn equal_principal_strains_have_an_answer() {
    // The exact direction jumps there; the table smears the jump over one cell, and nothing is NaN.
    for lookup in [StretchLookup::Table, StretchLookup::Direct] {
        let around: Vec<[f64; 4]> = [[0.1, 0.1, 0.0], [0.1 + 1e-9, 0.1, 0.0], [0.1, 0.1 + 1e-9, 0.0], [0.1, 0.1, 1e-9]]
            .into_iter()
            .map(|g| stiffness("gray-interlock", lookup, g))
            .collect();
        assert!(around.iter().flatten().all(|k| k.is_finite()));
        let apart = (around[1][2] - around[2][2]).abs();
        match lookup {
            StretchLookup::Table => assert!(apart < 1e-3, "{around:?}"),
            // 423 N/m on the u side, 650 on the v side.
            StretchLookup::Direct => assert!(apart > 100.0, "{around:?}"),
        }
    }
    // Equal strains count as stretched along u.
    let (equal, along_u) = ([0.1, 0.1, 0.0], [0.1 + 1e-9, 0.1, 0.0]);
    let (a, b) = (
        stiffness("gray-interlock", StretchLookup::Direct, equal),
        stiffness("gray-interlock", StretchLookup::Direct, along_u),
    );
    assert!((0..4).all(|i| (a[i] - b[i]).abs() < 1e-3), "{a:?} {b:?}");
}

#[test]
fn outside_of_the_table_stiffness_stays_and_strain_goes_on() {
    let gray = measured("gray-interlock", |_| ());
    let (border, beyond) = (gray.at([0.7167, 0.0, 0.0]).unwrap(), gray.at([5.0, 0.0, 0.0]).unwrap());
    for (a, b) in border.stiffness.unwrap().iter().zip(beyond.stiffness.unwrap()) {
        assert!((a - b).abs() < 1e-3 * a.abs().max(1.0));
    }
    assert!((beyond.stress[0] / beyond.stiffness.unwrap()[0] - 5.0).abs() < 1e-12);
    // Compression is looked up as rest: row 0 at full strength, no softening.
    let compressed = stiffness("gray-interlock", StretchLookup::Direct, [-0.2, -0.1, 0.0]);
    assert_eq!(compressed, stiffness("gray-interlock", StretchLookup::Direct, [0.0; 3]));
}

/// Tension along 45° at a stretch, sides held [N/m].
fn pull(gradient: StiffnessGradient, stretch: f64) -> f64 {
    let navy = measured("navy-sparkle-sweat", |s| s.stiffness_gradient = Some(gradient));
    let g = 0.25 * (stretch * stretch - 1.0);
    let [suu, svv, suv] = navy.at([g, g, g]).unwrap().stress;
    stretch * (0.5 * (suu + svv) + suv)
}

#[test]
fn tension_is_not_monotone_and_a_full_gradient_may_push() {
    let stretches: Vec<f64> = (0..60).map(|i| 1.0 + 0.005 * f64::from(i)).collect();
    let full: Vec<f64> = stretches.iter().map(|s| pull(StiffnessGradient::Full, *s)).collect();
    let frozen: Vec<f64> = stretches.iter().map(|s| pull(StiffnessGradient::Frozen, *s)).collect();
    assert!(full.iter().any(|t| *t < -1.0), "navy's energy falls with stretch near 45°: {full:?}");
    assert!(frozen.iter().all(|t| *t >= 0.0), "held stiffness never pushes: {frozen:?}");
    assert!(frozen.windows(2).any(|w| w[1] < w[0]), "but it is not monotone either");
}

fn fold(angle: f64, angle_rest: f64, directions: [[f64; 2]; 2]) -> Hinge {
    // Curvature θ l / 2A of 10 θ.
    Hinge { angle, angle_rest, length: 0.01, area: 5e-4, directions }
}

#[test]
fn a_curved_rest_shape_is_not_looked_up_as_bent() {
    let k = |lookup, hinge: &Hinge| {
        measured("white-dots-on-blk", |s| s.bending = Some(lookup)).bending_stiffness(hinge).unwrap()
    };
    let u = [[1.0, 0.0]; 2];
    let (curved, flat) = (fold(0.8, 0.8, u), fold(0.0, 0.0, u));
    assert_eq!(k(BendingLookup::Repaired, &curved), k(BendingLookup::Repaired, &flat));
    assert!(k(BendingLookup::Faithful, &curved) != k(BendingLookup::Faithful, &flat));
    // Both sides of a fold are alike, and the last column holds for all beyond it.
    assert_eq!(k(BendingLookup::Repaired, &fold(0.5, 0.0, u)), k(BendingLookup::Repaired, &fold(-0.5, 0.0, u)));
    assert_eq!(k(BendingLookup::Repaired, &fold(2.1, 0.0, u)), k(BendingLookup::Repaired, &fold(3.0, 0.0, u)));
}

#[test]
fn on_a_seam_the_softer_side_wins() {
    let gray = measured("gray-interlock", |_| ());
    let k = |directions| gray.bending_stiffness(&fold(0.2, 0.0, directions)).unwrap();
    let (u, v) = ([0.01, 0.0], [0.0, 0.01]);
    assert_eq!(k([u, v]), k([u, u]).min(k([v, v])));
    assert!(k([u, u]) != k([v, v]));
    // The fold line counts, not its sense.
    assert_eq!(k([[0.01, 0.004]; 2]), k([[-0.01, -0.004]; 2]));
    assert_eq!(k([[0.01, 0.004]; 2]), k([[0.01, -0.004]; 2]));
}
