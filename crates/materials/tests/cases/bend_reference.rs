//! All 220 cases of `data/arcsim_bend.json`, both rules for the edge length, `bending = "faithful"`.

use crate::asking::{FABRICS, Hinge, hinges, measured};
use caphy_core::Vec3;
use caphy_materials::measured::{BendingLookup, EdgeLength};
use serde::Deserialize;

#[derive(Deserialize)]
struct Reference {
    cases: Vec<Case>,
}

#[derive(Deserialize)]
struct Case {
    id: String,
    fabric: String,
    u_side0: [[f64; 2]; 3],
    u_side1: [[f64; 2]; 3],
    x: [[f64; 3]; 4],
    theta_rest: f64,
    current_length: Answer,
    rest_length: Answer,
}

#[derive(Deserialize)]
struct Answer {
    theta: f64,
    k_side0: f64,
    k_side1: f64,
    k: f64,
    energy: f64,
    force_frozen_k: [[f64; 3]; 4],
}

fn area(u: &[[f64; 2]; 3]) -> f64 {
    let (a, b) = ([u[1][0] - u[0][0], u[1][1] - u[0][1]], [u[2][0] - u[0][0], u[2][1] - u[0][1]]);
    0.5 * (a[0] * b[1] - a[1] * b[0]).abs()
}

fn edge(u: &[[f64; 2]; 3]) -> [f64; 2] {
    [u[1][0] - u[0][0], u[1][1] - u[0][1]]
}

/// Dihedral angle and its gradient by the four vertices (reference note, section 3).
fn dihedral(x: &[Vec3; 4]) -> (f64, [Vec3; 4]) {
    let e = x[1] - x[0];
    let length = e.norm();
    let normal0 = e.cross(&(x[2] - x[0])).normalize();
    let normal1 = (x[0] - x[1]).cross(&(x[3] - x[1])).normalize();
    let theta = (-(e / length).dot(&normal0.cross(&normal1))).atan2(normal0.dot(&normal1));
    let foot = |p: Vec3| {
        let t = (p - x[0]).dot(&e) / (length * length);
        (t, (p - x[0] - e * t).norm().max(1e-3 * length))
    };
    let ((t2, h0), (t3, h1)) = (foot(x[2]), foot(x[3]));
    let (g2, g3) = (normal0 / h0, normal1 / h1);
    (theta, [-(g2 * (1.0 - t2) + g3 * (1.0 - t3)), -(g2 * t2 + g3 * t3), g2, g3])
}

fn compare(edge_length: EdgeLength) {
    let reference: Reference = serde_json::from_str(include_str!("../data/arcsim_bend.json")).unwrap();
    assert_eq!(reference.cases.len(), 220);
    for fabric in FABRICS {
        let model = measured(fabric, |s| {
            s.bending = Some(BendingLookup::Faithful);
            s.edge_length = Some(edge_length);
        });
        for case in reference.cases.iter().filter(|c| c.fabric == fabric) {
            let x = case.x.map(|p| Vec3::new(p[0], p[1], p[2]));
            let (theta, gradient) = dihedral(&x);
            let (d0, d1) = (edge(&case.u_side0), edge(&case.u_side1));
            let (want, length) = match edge_length {
                EdgeLength::Current => (&case.current_length, (x[1] - x[0]).norm()),
                EdgeLength::Rest => (&case.rest_length, 0.5 * (d0[0].hypot(d0[1]) + d1[0].hypot(d1[1]))),
            };
            let id = &case.id;
            assert!((theta - want.theta).abs() < 1e-9, "{id}: theta {theta}, reference {}", want.theta);
            let area = area(&case.u_side0) + area(&case.u_side1);
            let seam = Hinge { angle: theta, rest: case.theta_rest, length, area, direction0: d0, direction1: d1 };
            let sides = [Hinge { direction1: d0, ..seam }, Hinge { direction0: d1, ..seam }, seam];
            let k: Vec<f64> = hinges::<f64>(model.as_ref(), &sides).iter().map(|a| a.stiffness).collect();
            for (got, want) in k.iter().zip([want.k_side0, want.k_side1, want.k]) {
                assert!((got - want).abs() <= 1e-9 * want + 1e-15, "{id}: k {got:e}, reference {want:e}");
            }
            let turn = theta - case.theta_rest;
            let energy = k[2] * length * length / (8.0 * area) * turn * turn;
            assert!((energy - want.energy).abs() <= 1e-8 * want.energy + 1e-18, "{id}: energy {energy:e}");
            let size = want.force_frozen_k.as_flattened().iter().fold(0.0f64, |m, f| m.max(f.abs()));
            for (gradient, want) in gradient.iter().zip(&want.force_frozen_k) {
                let force = gradient * (-k[2] * length * length / (4.0 * area) * turn);
                for axis in 0..3 {
                    let error = (force[axis] - want[axis]).abs();
                    assert!(error <= 1e-7 * size + 1e-12, "{id}: force {force:?}, reference {want:?}");
                }
            }
        }
    }
}

#[test]
fn rest_edge_length() {
    compare(EdgeLength::Rest);
}

#[test]
fn current_edge_length() {
    compare(EdgeLength::Current);
}
