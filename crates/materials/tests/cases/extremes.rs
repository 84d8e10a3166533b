//! Rest, huge strains, collapsed hinges; single against double precision; equal bits whatever the block.

use crate::asking::{FABRICS, Hinge, folds, hinges, measured, membrane, strains};
use caphy_core::material::{MaterialModel, MembraneBlock};
use caphy_materials::MaterialStvk;
use caphy_materials::measured::{BendingLookup, StiffnessGradient, StretchLookup};

fn models() -> Vec<Box<dyn MaterialModel>> {
    let mut all: Vec<Box<dyn MaterialModel>> = vec![Box::new(MaterialStvk::snug().unwrap())];
    for fabric in FABRICS {
        all.push(measured(fabric, |_| ()));
        all.push(measured(fabric, |s| s.lookup = Some(StretchLookup::Direct)));
        all.push(measured(fabric, |s| s.stiffness_gradient = Some(StiffnessGradient::Full)));
        all.push(measured(fabric, |s| s.bending = Some(BendingLookup::Faithful)));
    }
    all
}

#[test]
fn rest_is_exactly_zero() {
    for model in models() {
        for a in [membrane::<f32>(model.as_ref(), &[[0.0; 3]]), membrane::<f64>(model.as_ref(), &[[0.0; 3]])] {
            assert_eq!(a[0].energy, 0.0);
            assert_eq!(a[0].stress, [0.0; 3]);
            assert!(a[0].stiffness[0] > 0.0);
        }
    }
}

#[test]
fn every_output_is_finite_for_every_finite_strain() {
    let sizes = [0.0, 1e-45, 1e-20, 1e-7, 0.1, 1.0, 10.0, 1e3, 1e6, 1e15, 3e38];
    let mut grid = Vec::new();
    for u in sizes {
        for v in sizes {
            for w in sizes {
                grid.push([u, v, w]);
                grid.push([-u, v, -w]);
                grid.push([u, -v, w]);
                grid.push([-u, -v, w]);
            }
        }
    }
    for model in models() {
        for (g, a) in grid.iter().zip(membrane::<f32>(model.as_ref(), &grid)) {
            assert!(a.values().all(f64::is_finite), "f32 {g:?}");
        }
        for (g, a) in grid.iter().zip(membrane::<f64>(model.as_ref(), &grid)) {
            assert!(a.values().all(f64::is_finite), "f64 {g:?}");
        }
        let far = [[1e300, -1e300, f64::MAX]];
        assert!(membrane::<f64>(model.as_ref(), &far)[0].values().all(f64::is_finite));
    }
}

#[test]
fn every_hinge_output_is_finite() {
    let mut grid = Vec::new();
    let pi = std::f64::consts::PI;
    for angle in [0.0, 1e-7, -1e-7, pi, -pi] {
        for rest in [0.0, pi, -pi] {
            for length in [0.0, 1e-20, 0.01, 1e20] {
                for area in [0.0, 1e-45, 1e-12, 1e-4, 1e30] {
                    for direction0 in [[0.0, 0.0], [1.0, 0.0], [0.0, -1e30], [1e-40, 1e-40]] {
                        grid.push(Hinge { angle, rest, length, area, direction0, direction1: [0.0, 1.0] });
                    }
                }
            }
        }
    }
    for model in models() {
        for (k32, k64) in hinges::<f32>(model.as_ref(), &grid).iter().zip(hinges::<f64>(model.as_ref(), &grid)) {
            assert!(k32.values().chain(k64.values()).all(f64::is_finite));
            assert!(k32.stiffness >= 0.0 && k64.stiffness >= 0.0);
        }
    }
}

/// 0/0 is not "beyond the table": without a least area it would be looked up at the table's end.
#[test]
fn a_flat_hinge_of_no_area_is_looked_up_flat() {
    let u = [1.0, 0.0];
    let of = |area| Hinge { angle: 0.0, rest: 0.0, length: 0.01, area, direction0: u, direction1: u };
    for model in models() {
        for found in
            [hinges::<f32>(model.as_ref(), &[of(0.0), of(1e-4)]), hinges::<f64>(model.as_ref(), &[of(0.0), of(1e-4)])]
        {
            assert_eq!(found[0].stiffness, found[1].stiffness);
            assert_eq!(found[0].by_length, 0.0);
        }
    }
}

#[test]
fn single_precision_follows_double() {
    let eps = f64::from(f32::EPSILON);
    let grid = strains(500, 0.6);
    for fabric in FABRICS {
        let model = measured(fabric, |_| ());
        let single = membrane::<f32>(model.as_ref(), &grid);
        // Strains that f32 holds exactly, so that only the evaluation differs.
        let rounded: Vec<[f64; 3]> = grid.iter().map(|g| g.map(|x| f64::from(x as f32))).collect();
        let double = membrane::<f64>(model.as_ref(), &rounded);
        let largest = double.iter().flat_map(|a| a.stiffness).fold(0.0f64, f64::max);
        for (s, d) in single.iter().zip(&double) {
            for a in 0..4 {
                // A coordinate up to 29 is off by 29 eps of a cell, a cell spans at most `largest`; three axes.
                assert!((s.stiffness[a] - d.stiffness[a]).abs() < 3.0 * 29.0 * eps * largest, "{fabric}");
            }
            assert!((s.energy - d.energy).abs() < 4.0 * 3.0 * 29.0 * eps * largest * 0.36);
        }
        let grid = folds(500);
        let table = hinges::<f64>(model.as_ref(), &grid);
        let largest = table.iter().map(|a| a.stiffness).fold(0.0f64, f64::max);
        for (s, d) in hinges::<f32>(model.as_ref(), &grid).iter().zip(&table) {
            // The inputs are rounded too: s up to 4 with five roundings, rows with four more.
            assert!((s.stiffness - d.stiffness).abs() < 64.0 * eps * largest, "{fabric}");
        }
    }
}

#[test]
fn equal_strains_give_equal_bits_wherever_they_stand_in_a_block() {
    let model = measured("gray-interlock", |_| ());
    let grid = strains(200, 0.5);
    let whole = membrane::<f32>(model.as_ref(), &grid);
    for i in [0, 1, 63, 64, 65, 127, 128, 199] {
        let alone = membrane::<f32>(model.as_ref(), &grid[i..=i]);
        assert!(whole[i].values().zip(alone[0].values()).all(|(a, b)| a.to_bits() == b.to_bits()), "{i}");
    }
}

#[test]
fn an_empty_block_and_absent_outputs_are_fine() {
    for model in models() {
        model.membrane((&mut MembraneBlock::<f32>::new(0, &[])).into()).unwrap();
        model.membrane((&mut MembraneBlock::<f64>::new(1, &[0.1, 0.0, 0.0])).into()).unwrap();
    }
}
