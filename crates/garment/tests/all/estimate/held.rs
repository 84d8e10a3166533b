//! Rest with contacts held: where it was, and as the sensitivities say beside it.

use super::study::*;
use caphy_core::Vec3;
use caphy_garment::estimate::{Reduction, cloth};
use caphy_garment::solver::{Contacts, Forces, Obstacle, Scene, Solver, SolverSettings};

#[test]
fn contacts_that_are_held_leave_rest_where_it_was_and_answer_by_the_sensitivities() {
    let truth = fabric("11oz-black-denim");
    let rest = cloth::sheet(10, 10, [SIDE, SIDE], truth.describe().density.unwrap().0).unwrap();
    let setup = setups(&rest, true).pop().unwrap();
    let body = setup.body.as_ref().unwrap();
    let scene = Scene {
        body: Some(Obstacle { positions: &body.positions, normals: &body.normals, before: None, search: None }),
        fixed: &setup.fixed,
        anchors: Some(&setup.start),
        ..Default::default()
    };
    let settings = SolverSettings { tolerance_n: 1e-9, friction: 0.3, ..Default::default() };
    let mut solver = Solver::new(&rest, truth.clone(), Forces::default(), settings).unwrap();
    let found = solver.solve(&scene, &setup.start, &|_| {}).unwrap();
    assert!(found.contacts.len() > 3, "{} vertices touch", found.contacts.len());

    // At rest there is nothing to do.
    let again = solver.solve_held(Contacts::Of(&found), &scene, &found.positions, &|_| {}).unwrap();
    assert_eq!((again.report.iterations, &again.positions), (0, &found.positions));

    // From some tenths of a millimetre away the same rest is found.
    let shaken = Normal::new(1).shaken(&found.positions, 1e-4);
    let moved: Vec<Vec3> = (0..shaken.len())
        .map(|v| if setup.fixed.contains(&(v as u32)) { found.positions[v] } else { shaken[v] })
        .collect();
    let back = solver.solve_held(Contacts::Of(&found), &scene, &moved, &|_| {}).unwrap();
    let apart = |a: &[Vec3], b: &[Vec3]| a.iter().zip(b).map(|(a, b)| (a - b).norm()).fold(0.0, f64::max);
    assert!(apart(&back.positions, &found.positions) < 1e-6, "{:.1e} m", apart(&back.positions, &found.positions));

    // The answer to a small change of all stiffness is the one that the factorisation predicts, to second order.
    let reduction = Reduction::multipliers(&*truth).unwrap();
    let zero = vec![0.0; reduction.len()];
    let line = solver.linearise(&scene, &found).unwrap();
    let mut slope = vec![0.0; 3 * rest.vertex_count()];
    for k in 0..reduction.len() {
        let one = line.response_to_parameters(&reduction.direction(&zero, k)).unwrap();
        slope.iter_mut().zip(one).for_each(|(s, o)| *s += o);
    }
    let longest = slope.chunks_exact(3).map(|s| Vec3::new(s[0], s[1], s[2]).norm()).fold(0.0, f64::max);
    let error = |step: f64| {
        let y = vec![step; reduction.len()];
        let mut other =
            Solver::new(&rest, reduction.material(&*truth, &y).unwrap().into(), Forces::default(), settings).unwrap();
        let there = other.solve_held(Contacts::Of(&found), &scene, &found.positions, &|_| {}).unwrap();
        let predicted: Vec<Vec3> = found
            .positions
            .iter()
            .zip(slope.chunks_exact(3))
            .map(|(p, s)| p + step * Vec3::new(s[0], s[1], s[2]))
            .collect();
        apart(&there.positions, &predicted) / (step * longest)
    };
    let (coarse, fine) = (error(4e-3), error(1e-3));
    assert!(fine < 0.02 && fine < 0.5 * coarse, "off by {coarse:.4} and {fine:.4} of the change");
}

#[test]
fn contacts_of_another_scene_are_refused() {
    let truth = fabric("11oz-black-denim");
    let rest = cloth::sheet(6, 6, [SIDE, SIDE], truth.describe().density.unwrap().0).unwrap();
    let setup = setups(&rest, true).pop().unwrap();
    let body = setup.body.as_ref().unwrap();
    let scene = Scene {
        body: Some(Obstacle { positions: &body.positions, normals: &body.normals, before: None, search: None }),
        fixed: &setup.fixed,
        ..Default::default()
    };
    let settings = SolverSettings { tolerance_n: 1e-6, ..Default::default() };
    let mut solver = Solver::new(&rest, truth, Forces::default(), settings).unwrap();
    let found = solver.solve(&scene, &setup.start, &|_| {}).unwrap();
    let small = cloth::sphere(Vec3::zeros(), 0.01, 5e-3).unwrap();
    let other = Scene {
        body: Some(Obstacle { positions: &small.positions, normals: &small.normals, before: None, search: None }),
        ..scene
    };
    let said = solver.solve_held(Contacts::Of(&found), &other, &found.positions, &|_| {}).unwrap_err().to_string();
    assert!(said.contains("touched by the earlier solution"), "{said}");
}
