//! dx*/dΘ against solving again, forward against adjoint.

use super::analytic::{measured, stvk};
use super::{frame, quiet, shaken, sheet};
use caphy_core::Vec3;
use caphy_core::material::MaterialModel;
use caphy_garment::solver::{Forces, Obstacle, Scene, Solution, Solver, SolverSettings};
use std::sync::Arc;

/// A sheet held at two corners' edges over a floor that its lower end lies on.
fn solved(solver: &mut Solver, scene: &Scene<'_>, start: &[Vec3]) -> Solution {
    let solution = solver.solve(scene, start, &quiet).unwrap();
    assert!(solution.converged(), "{:?}", solution.report);
    solution
}

fn flat(x: &[Vec3]) -> Vec<f64> {
    x.iter().flat_map(|p| [p.x, p.y, p.z]).collect()
}

/// Step of the differences, as a share of each parameter. Solves end within 1e-11 N, on modes of some 0.1 N/m: both ends are
/// known to 1e-10 m and the difference to 1e-7 m, which falls with the step; its own error is of second order, 1e-6.
const STEP: f64 = 1e-3;

fn check(material: Arc<dyn MaterialModel>, tolerance: f64) {
    let step = STEP;
    let rest = sheet(6, 6, [0.12, 0.12], 0.2);
    let fixed = [42, 43, 47, 48];
    let spots: Vec<Vec3> = (0..40)
        .flat_map(|i| (0..40).map(move |j| Vec3::new(0.01 * i as f64 - 0.15, 0.03, 0.01 * j as f64 - 0.2)))
        .collect();
    let (body, up) = (frame(&spots), frame(&vec![Vec3::y(); spots.len()]));
    let scene = Scene {
        body: Some(Obstacle { positions: &body, normals: &up, before: None, search: None }),
        fixed: &fixed,
        ..Default::default()
    };
    let settings = SolverSettings { tolerance_n: 1e-11, ..Default::default() };
    let mut solver = Solver::new(&rest, material.clone(), Forces::default(), settings).unwrap();
    let mut start = shaken(&rest.template.vertices, 3e-3, 5);
    // Bow out of the plane, so that the sheet folds on one side; held ends closer together.
    start.iter_mut().for_each(|p| p.z += 2.0 * (0.12 - p.y) * p.y);
    fixed.iter().for_each(|&v| start[v as usize] = rest.template.vertices[v as usize] * 0.95);
    let base = solved(&mut solver, &scene, &start);
    assert!(!base.contacts.is_empty(), "the floor takes part");
    let names = material.parameters();
    let n = names.len();
    // Relative directions: one parameter at a time up to eight, then a mixture.
    let mut directions: Vec<Vec<f64>> = (0..n)
        .step_by(n.div_ceil(8))
        .map(|j| (0..n).map(|k| if k == j { names[j].value.abs().max(1e-9) } else { 0.0 }).collect())
        .collect();
    directions.push((0..n).map(|k| names[k].value * (1.0 + (k as f64).sin())).collect());
    let v: Vec<f64> = (0..base.positions.len() * 3).map(|i| (0.37 * i as f64).sin()).collect();
    let (forward, adjoint) = {
        let line = solver.linearise(&scene, &base).unwrap();
        assert_eq!(line.replaced_pivots(), 0);
        let forward: Vec<Vec<f64>> = directions.iter().map(|d| line.response_to_parameters(d).unwrap()).collect();
        (forward, line.adjoint_of_parameters(&v).unwrap())
    };
    for (direction, forward) in directions.iter().zip(&forward) {
        let size = forward.iter().fold(0.0f64, |m, x| m.max(x.abs()));
        let product = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let (one, other) = (product(&v, forward), product(&adjoint, direction));
        assert!((one - other).abs() <= 1e-7 * (one.abs() + size), "adjoint {other:e}, forward {one:e}");
        if size < 1e-9 {
            continue;
        }
        let mut moved = |sign: f64| {
            let values: Vec<f64> = names.iter().zip(direction).map(|(p, d)| p.value + sign * step * d).collect();
            solver.set_material(Arc::from(material.with_parameters(&values).unwrap()));
            flat(&solved(&mut solver, &scene, &base.positions).positions)
        };
        let (ahead, behind) = (moved(1.0), moved(-1.0));
        for i in 0..forward.len() {
            let numeric = (ahead[i] - behind[i]) / (2.0 * step);
            assert!((numeric - forward[i]).abs() < tolerance * size, "{i}: {} {numeric}, size {size}", forward[i]);
        }
    }
    solver.set_material(material);
    // dx*/d(anything): a force on one vertex.
    let line = solver.linearise(&scene, &base).unwrap();
    let mut change = vec![0.0; flat(&base.positions).len()];
    change[3 * 10 + 2] = 1.0;
    let response = line.response(&change).unwrap();
    let back = line.multiply(&response);
    let worst = back.iter().zip(&change).enumerate().filter(|(i, _)| !fixed.contains(&((i / 3) as u32)));
    assert!(worst.map(|(_, (a, b))| (a + b).abs()).fold(0.0, f64::max) < 1e-8);
    assert!(line.response(&change[1..]).is_err());
}

#[test]
fn of_stvk() {
    // The smallest answer is 5e-4 m.
    check(stvk(20.0, 11.0, 4e-5), 2e-4);
}

#[test]
fn of_a_measured_fabric_with_frozen_stiffness() {
    // The smallest answer is 2e-5 m.
    check(measured(""), 5e-3);
}
