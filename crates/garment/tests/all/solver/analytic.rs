//! Closed forms, invariance, convergence down to rounding, threads.

use super::{quiet, shaken, sheet};
use caphy_core::Vec3;
use caphy_core::material::{MaterialModel, MaterialSpec};
use caphy_garment::GarmentRest;
use caphy_garment::solver::{Dynamics, Forces, Outcome, Scene, Solver, SolverSettings};
use caphy_materials::{MaterialMeasuredSpec, MaterialStvk, MaterialStvkSpec};
use nalgebra::Rotation3;
use std::sync::Arc;

pub(super) fn stvk(lambda: f64, mu: f64, bending: f64) -> Arc<dyn MaterialModel> {
    let text = format!("lambda_n_per_m = {lambda:?}\nmu_n_per_m = {mu:?}\nbending_nm = {bending:?}\n");
    let spec: MaterialStvkSpec = toml::from_str(&text).unwrap();
    Arc::new(spec.build_stvk().unwrap())
}

pub(super) fn measured(keys: &str) -> Arc<dyn MaterialModel> {
    let spec: MaterialMeasuredSpec = toml::from_str(&format!("fabric = \"gray-interlock\"\n{keys}")).unwrap();
    Arc::from(spec.build().unwrap())
}

pub(super) fn solver(rest: &GarmentRest, material: Arc<dyn MaterialModel>, settings: SolverSettings) -> Solver {
    Solver::new(rest, material, Forces::default(), settings).unwrap()
}

/// A strip that is pulled to 1.2 times its length and narrows freely: Suu = 0.
#[test]
fn uniaxial_tension_of_stvk() {
    let (lambda, mu) = (20.0, 11.0);
    let rest = sheet(4, 12, [0.04, 0.12], 0.2);
    let long: f64 = 1.2;
    let gvv = 0.5 * (long * long - 1.0);
    let guu = -lambda / (lambda + 2.0 * mu) * gvv;
    let narrow = (1.0 + 2.0 * guu).sqrt();
    let goal: Vec<Vec3> =
        rest.template.vertices.iter().map(|p| Vec3::new(narrow * (p.x - 0.02), long * p.y, 0.0)).collect();
    let ends: Vec<u32> = (0..rest.vertex_count() as u32)
        .filter(|&v| [0.0, 0.12].iter().any(|y| (rest.template.vertices[v as usize].y - y).abs() < 1e-9))
        .collect();
    let mut start = shaken(&goal, 2e-3, 1);
    ends.iter().for_each(|&v| start[v as usize] = goal[v as usize]);
    let forces = Forces { gravity: Vec3::zeros(), ..Forces::default() };
    let settings = SolverSettings { tolerance_n: 1e-10, ..Default::default() };
    let mut solver = Solver::new(&rest, stvk(lambda, mu, 1e-6), forces, settings).unwrap();
    let solution = solver.solve(&Scene { fixed: &ends, ..Default::default() }, &start, &quiet).unwrap();
    assert!(solution.converged(), "{:?}", solution.report);
    assert!(solution.report.residual_n <= 1e-10);
    assert!(solution.report.iterations < 15, "Newton converges in a few steps: {}", solution.report.iterations);
    for (x, goal) in solution.positions.iter().zip(&goal) {
        assert!((x - goal).norm() < 1e-9, "{x} {goal}");
    }
    // ψ = ½ S : G with S = Svv alone.
    let young = 4.0 * mu * (lambda + mu) / (lambda + 2.0 * mu);
    let energy = 0.04 * 0.12 * 0.5 * young * gvv * gvv;
    assert!((solution.report.energy("strain") - energy).abs() < 1e-12);
}

/// A strip under its own weight with λ = 0: every cut carries the weight below, width μ f (f² − 1) = m g.
#[test]
fn a_strip_hangs_by_its_weight() {
    let (mu, width, cell, rows) = (2.0, 0.01, 0.01, 30usize);
    let rest = sheet(1, rows, [width, cell * rows as f64], 0.3);
    let top = [2 * rows as u32, 2 * rows as u32 + 1];
    let mut solver = solver(&rest, stvk(0.0, mu, 1e-7), SolverSettings { tolerance_n: 1e-10, ..Default::default() });
    let start = shaken(&rest.template.vertices, 1e-4, 2);
    let mut start: Vec<Vec3> = start.iter().map(|p| Vec3::new(p.x, p.y, 0.2 * p.z)).collect();
    top.iter().for_each(|&v| start[v as usize] = rest.template.vertices[v as usize]);
    let solution = solver.solve(&Scene { fixed: &top, ..Default::default() }, &start, &quiet).unwrap();
    assert!(solution.converged(), "{:?}", solution.report);
    let masses: Vec<f64> = (0..=rows).map(|j| rest.vertex_masses[2 * j] + rest.vertex_masses[2 * j + 1]).collect();
    let mut y = cell * rows as f64;
    for j in (0..rows).rev() {
        let weight = 9.81 * masses[..=j].iter().sum::<f64>();
        // μ w f (f² − 1) = weight, by Newton.
        let mut f: f64 = 1.1;
        for _ in 0..50 {
            f -= (mu * width * f * (f * f - 1.0) - weight) / (mu * width * (3.0 * f * f - 1.0));
        }
        y -= f * cell;
        let mean = 0.5 * (solution.positions[2 * j].y + solution.positions[2 * j + 1].y);
        // Rows are not quite level, since vertex masses alternate; that is second order in their tilt.
        assert!(
            (mean - y).abs() < 1e-3 * (cell * rows as f64 - y - (rows - j) as f64 * cell).abs() + 1e-7,
            "row {j}: {mean} {y}"
        );
    }
}

/// A stiff ribbon between two points takes the catenary's shape.
#[test]
fn a_ribbon_hangs_as_a_catenary() {
    let (length, span, n) = (0.4, 0.3, 60);
    let rest = sheet(n, 1, [length, 0.005], 0.2);
    let ends = [0, n as u32, n as u32 + 1, 2 * n as u32 + 1];
    // A parabola of about the right sag.
    let start: Vec<Vec3> = rest
        .template
        .vertices
        .iter()
        .map(|p| {
            let s = 2.0 * p.x / length - 1.0;
            Vec3::new(0.5 * span * s, -0.11 * (1.0 - s * s), p.y)
        })
        .collect();
    let settings = SolverSettings { tolerance_n: 1e-10, ..Default::default() };
    let mut solver = solver(&rest, stvk(0.0, 5e3, 1e-12), settings);
    let solution = solver.solve(&Scene { fixed: &ends, ..Default::default() }, &start, &quiet).unwrap();
    assert!(solution.converged(), "{:?}", solution.report);
    // 2 a sinh(span / 2a) = length, by bisection.
    let (mut low, mut high) = (0.01, 10.0);
    for _ in 0..200 {
        let a: f64 = 0.5 * (low + high);
        if 2.0 * a * (0.5 * span / a).sinh() > length { low = a } else { high = a }
    }
    let sag = low * ((0.5 * span / low).cosh() - 1.0);
    let lowest = solution.positions.iter().map(|p| p.y).fold(0.0, f64::min);
    // n links of a polygon: (length/n)²/(8 a) per link, below a thousandth.
    assert!((lowest + sag).abs() < 2e-3 * sag, "{lowest} {sag}");
}

#[test]
fn free_fall_is_backward_euler_exactly() {
    let rest = sheet(3, 3, [0.1, 0.1], 0.2);
    let step = 1.0 / 30.0;
    let mut solver = solver(&rest, stvk(20.0, 11.0, 4e-5), SolverSettings { tolerance_n: 1e-12, ..Default::default() });
    let start = rest.template.vertices.clone();
    let throw = vec![Vec3::new(0.4, 1.0, -0.2); start.len()];
    let mut motion = Dynamics::new(start.clone(), Some(throw.clone()), step).unwrap();
    for n in 1..=5 {
        let solution = motion.advance(&mut solver, &Scene::default(), None, &quiet).unwrap();
        assert!(solution.converged(), "{:?}", solution.report);
        let fall = Vec3::new(0.0, -9.81, 0.0) * (step * step * f64::from(n * (n + 1)) / 2.0);
        for (x, x0) in motion.positions().iter().zip(&start) {
            let expected = x0 + throw[0] * (step * f64::from(n)) + fall;
            assert!((x - expected).norm() < 1e-10, "{x} {expected}");
        }
    }
    assert!(Dynamics::new(start.clone(), None, 0.0).is_err());
    assert!(Dynamics::new(start, Some(Vec::new()), 0.1).is_err());
}

/// A hanging square, held at one corner's edge, from a crumpled start.
fn flag(settings: SolverSettings, material: Arc<dyn MaterialModel>) -> (Solver, Vec<Vec3>) {
    let rest = sheet(8, 8, [0.2, 0.2], 0.2);
    let start = shaken(&rest.template.vertices, 2e-3, 6);
    (solver(&rest, material, settings), start)
}
const HELD: [u32; 2] = [72, 73];

#[test]
fn a_flag_converges_to_rounding_and_turns_with_the_world() {
    let settings = SolverSettings { tolerance_n: 1e-10, ..Default::default() };
    let (mut upright, start) = flag(settings, stvk(20.0, 11.0, 4e-5));
    let scene = Scene { fixed: &HELD, ..Default::default() };
    let solution = upright.solve(&scene, &start, &quiet).unwrap();
    assert!(solution.converged() && solution.report.residual_n <= 1e-10, "{:?}", solution.report);
    let turn = Rotation3::from_scaled_axis(Vec3::new(0.7, -1.1, 0.4));
    let forces = Forces { gravity: turn * Forces::default().gravity, ..Forces::default() };
    let mut turned = Solver::new(upright.rest(), upright.material().clone(), forces, settings).unwrap();
    let start: Vec<Vec3> = solution.positions.iter().map(|p| turn * p).collect();
    let start = shaken(&start, 1e-5, 7);
    let mut start = start;
    HELD.iter().for_each(|&v| start[v as usize] = turn * solution.positions[v as usize]);
    let again = turned.solve(&scene, &start, &quiet).unwrap();
    assert!(again.converged());
    for (a, b) in again.positions.iter().zip(&solution.positions) {
        // Forces of 1e-10 N on modes of some 1e-2 N/m.
        assert!((a - turn * b).norm() < 1e-6, "{a} {b}");
    }
    let sum = |r: &caphy_garment::solver::SolveReport| r.energies.iter().map(|e| e.1).sum::<f64>();
    assert!((sum(&again.report) - sum(&solution.report)).abs() < 1e-12);
}

#[test]
fn frozen_stiffness_converges_on_its_own_forces() {
    let settings = SolverSettings { tolerance_n: 1e-10, ..Default::default() };
    for keys in ["", "edge_length = \"current\"\n", "stiffness_gradient = \"full\"\n"] {
        let (mut solver, start) = flag(settings, measured(keys));
        let solution = solver.solve(&Scene { fixed: &HELD, ..Default::default() }, &start, &quiet).unwrap();
        eprintln!("{keys:?}: {:?}", solution.report);
        // `full` has kinks and no convexity: it must end, and finitely; frozen must arrive.
        if keys.contains("full") {
            assert!(solution.report.residual_n.is_finite());
        } else {
            assert!(solution.converged(), "{keys}: {:?}", solution.report);
        }
    }
}

#[test]
fn bits_do_not_depend_on_threads() {
    let with = |threads: usize| {
        rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(|| {
            let (mut solver, start) = flag(SolverSettings::default(), measured(""));
            solver.solve(&Scene { fixed: &HELD, ..Default::default() }, &start, &quiet).unwrap().positions
        })
    };
    assert_eq!(with(1), with(2));
}

#[test]
fn lbfgs_finds_the_same_flag() {
    let scene = Scene { fixed: &HELD, ..Default::default() };
    let (mut newton, start) = flag(SolverSettings { tolerance_n: 1e-9, ..Default::default() }, stvk(20.0, 11.0, 4e-5));
    let exact = newton.solve(&scene, &start, &quiet).unwrap();
    let settings = SolverSettings { tolerance_n: 1e-6, largest_factorised: 10, iterations: 600, ..Default::default() };
    let (mut large, _) = flag(settings, stvk(20.0, 11.0, 4e-5));
    // From nearby: far starts may find another buckling branch.
    let mut near = shaken(&exact.positions, 1e-4, 8);
    HELD.iter().for_each(|&v| near[v as usize] = exact.positions[v as usize]);
    let rough = large.solve(&scene, &near, &quiet).unwrap();
    assert_eq!(rough.report.outcome, Outcome::Converged, "{:?}", rough.report);
    assert!(rough.report.residual_n < 1e-5);
    let worst = rough.positions.iter().zip(&exact.positions).map(|(a, b)| (a - b).norm()).fold(0.0, f64::max);
    assert!(worst < 1e-3, "{worst}");
}

#[test]
fn a_pendulum_is_the_softest_mode() {
    // A stiff sheet that hangs from two pins swings as a compound pendulum: ω² = g c / (c² + r²), c the depth of the
    // centre of mass, r² its radius of gyration.
    let rest = sheet(4, 6, [0.1, 0.15], 0.2);
    let pins = [30, 34];
    let settings = SolverSettings { soft_modes: 2, tolerance_n: 1e-9, ..Default::default() };
    let mut solver = solver(&rest, stvk(100.0, 1e4, 10.0), settings);
    let solution =
        solver.solve(&Scene { fixed: &pins, ..Default::default() }, &rest.template.vertices, &quiet).unwrap();
    let mode = &solution.report.soft_modes[0];
    let (mass, first, second) =
        rest.template.vertices.iter().zip(&rest.vertex_masses).fold((0.0, 0.0, 0.0), |s, (p, m)| {
            let depth = 0.15 - p.y;
            (s.0 + m, s.1 + m * depth, s.2 + m * depth * depth)
        });
    assert!(mass > 0.0);
    let expected = 9.81 * first / second;
    assert!((mode.omega_squared - expected).abs() < 1e-2 * expected, "{} {expected}", mode.omega_squared);
    assert!(mode.participation[2] > 0.5 && mode.participation[0] < 0.01, "{:?}", mode.participation);
}

#[test]
fn the_material_can_be_exchanged() {
    let (mut solver, start) = flag(SolverSettings::default(), stvk(20.0, 11.0, 4e-5));
    let scene = Scene { fixed: &HELD, ..Default::default() };
    let soft = solver.solve(&scene, &start, &quiet).unwrap();
    solver.set_material(Arc::new(MaterialStvk::snug().unwrap()));
    let snug = solver.solve(&scene, &start, &quiet).unwrap();
    assert!(soft.converged() && snug.converged());
    assert_ne!(soft.positions, snug.positions);
}
