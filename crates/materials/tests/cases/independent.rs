//! The reference note once more, as plainly as it can be written, against the shipped evaluation on strains and folds that
//! no reference file holds.

use crate::asking::{FABRICS, measured};
use caphy_core::extension::{Hinge, MaterialModelExt};
use caphy_materials::measured::{BendingLookup, Fabric, StretchLookup};

/// Section 2.1.
fn direct(table: &[[f64; 4]; 6], u: f64, v: f64, w: f64) -> [f64; 4] {
    let r = ((u - v).powi(2) + 4.0 * w * w).sqrt();
    let e = (1.0 + u + v + r).max(0.0).sqrt() - 1.0;
    let t = (6.0 * e).clamp(0.0, 1.0 - 1e-6);
    let phi =
        if w == 0.0 { if u >= v { 0.0 } else { std::f64::consts::FRAC_PI_2 } } else { (2.0 * w).atan2(u - v + r) };
    let p = (8.0 * phi / std::f64::consts::PI).min(4.0 - 1e-6);
    let (row, f) = (p.floor() as usize, p - p.floor());
    std::array::from_fn(|a| {
        let stretched = table[1 + row][a] * (1.0 - f) + table[2 + row][a] * f;
        2.0 * ((1.0 - t) * table[0][a] + t * stretched).max(0.0)
    })
}

/// Section 2.2.
fn gridded(table: &[[f64; 4]; 6], g: [f64; 3]) -> [f64; 4] {
    let coordinate = |x: f64| (30.0 * x).clamp(0.0, 29.0 - 1e-5);
    let x = [coordinate(g[0] + 0.25), coordinate(g[1] + 0.25), coordinate(g[2].abs())];
    let mut k = [0.0; 4];
    for corner in 0..8 {
        let (mut share, mut node) = (1.0, [0.0; 3]);
        for axis in 0..3 {
            let up = f64::from(corner >> axis & 1);
            let f = x[axis] - x[axis].floor();
            share *= if up == 1.0 { f } else { 1.0 - f };
            node[axis] = x[axis].floor() + up;
        }
        let at = direct(table, node[0] / 30.0 - 0.25, node[1] / 30.0 - 0.25, node[2] / 30.0);
        for a in 0..4 {
            k[a] += share * at[a];
        }
    }
    k
}

/// Section 3; both sides and the smaller one.
fn bending(table: &[[f64; 5]; 3], hinge: &Hinge, lookup: BendingLookup) -> f64 {
    let (theta, low) = match lookup {
        BendingLookup::Faithful => (hinge.angle, f64::NEG_INFINITY),
        BendingLookup::Repaired => ((hinge.angle - hinge.angle_rest).abs(), 0.0),
    };
    let s = (theta * hinge.length / (2.0 * hinge.area) / 5.0).clamp(low, 4.0);
    let column = (s.floor().clamp(0.0, 3.0)) as usize;
    let side = |[du, dv]: [f64; 2]| {
        let mut b = dv.atan2(du).abs() * 4.0 / std::f64::consts::PI;
        if b > 2.0 {
            b = 4.0 - b;
        }
        let row = (b.floor() as usize).min(1);
        let along = |r: usize| table[r][column] + (s - column as f64) * (table[r][column + 1] - table[r][column]);
        (along(row) + (b - row as f64) * (along(row + 1) - along(row))).max(0.0)
    };
    side(hinge.directions[0]).min(side(hinge.directions[1]))
}

/// Numbers in [-1, 1) from a fixed linear congruence.
struct Numbers(u64);
impl Numbers {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    }
}

#[test]
fn stretching_inside_and_outside_of_the_table() {
    let mut random = Numbers(1);
    for name in FABRICS {
        let table = Fabric::named(name).unwrap().stretching;
        let (grid, point) = (measured(name, |_| ()), measured(name, |s| s.lookup = Some(StretchLookup::Direct)));
        let largest = table.iter().flatten().fold(0.0f64, |m, c| m.max(c.abs()));
        let mut strains: Vec<[f64; 3]> = Vec::new();
        for scale in [0.05, 0.3, 1.5] {
            strains.extend((0..250).map(|_| [scale * random.next(), scale * random.next(), scale * random.next()]));
        }
        // On table planes, borders and corners, with either sign of shear.
        for i in [0, 1, 7, 28, 29] {
            let g = f64::from(i) / 30.0 - 0.25;
            strains.extend([[g, 0.1, 0.02], [0.1, g, -0.02], [g, g, 0.0], [0.05, -0.05, f64::from(i) / 30.0]]);
        }
        for g in strains {
            let k = grid.at(g).unwrap().stiffness.unwrap();
            let want = gridded(&table, g);
            for a in 0..4 {
                assert!(
                    (k[a] - want[a]).abs() <= 1e-9 * want[a].abs() + 1e-11 * largest,
                    "{name} {g:?}: {k:?} {want:?}"
                );
            }
            // The exact evaluation jumps where both principal strains are equal.
            let apart = ((g[0] - g[1]).powi(2) + 4.0 * g[2] * g[2]).sqrt();
            if apart > 1e-3 {
                let k = point.at(g).unwrap().stiffness.unwrap();
                let want = direct(&table, g[0], g[1], g[2].abs());
                for a in 0..4 {
                    // The angle's rounding, 1e-16 / apart, times the table's rise per unit of it.
                    assert!((k[a] - want[a]).abs() <= 1e-11 * largest / apart, "{name} {g:?}: {k:?} {want:?}");
                }
            }
        }
    }
}

#[test]
fn folds_of_every_kind() {
    let mut random = Numbers(2);
    for name in FABRICS {
        let table = Fabric::named(name).unwrap().bending;
        for lookup in [BendingLookup::Faithful, BendingLookup::Repaired] {
            let model = measured(name, |s| s.bending = Some(lookup));
            for i in 0..400 {
                let mut direction = || [0.01 * random.next(), 0.01 * random.next()];
                let directions = [direction(), direction()];
                let directions = if i % 3 == 0 { [directions[0]; 2] } else { directions };
                let hinge = Hinge {
                    angle: 3.1 * random.next(),
                    angle_rest: random.next(),
                    length: 0.02 + 0.015 * random.next(),
                    area: 6e-4 + 5e-4 * random.next(),
                    directions,
                };
                let (k, want) = (model.bending_stiffness(&hinge).unwrap(), bending(&table, &hinge, lookup));
                // Far folds extrapolate the first segment: relative to what was added up.
                let scale = table.iter().flatten().fold(want, |m, c| m.max(*c)) * 40.0;
                assert!((k - want).abs() <= 1e-13 * scale, "{name} {lookup:?} {hinge:?}: {k:e} {want:e}");
            }
        }
    }
}
