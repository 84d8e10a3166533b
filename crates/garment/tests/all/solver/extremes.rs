//! What must end in a finite answer or a typed error.

use super::analytic::{measured, stvk};
use super::{frame, quiet, shaken, sheet};
use caphy_core::{Error, Vec3};
use caphy_garment::energy::Attachment;
use caphy_garment::solver::{Dynamics, Forces, Momentum, Obstacle, Scene, Solver, SolverSettings, Springs};

fn finite(solver: &mut Solver, scene: &Scene<'_>, start: &[Vec3], what: &str) {
    match solver.solve(scene, start, &quiet) {
        Ok(solution) => {
            assert!(solution.positions.iter().all(|p| p.iter().all(|c| c.is_finite())), "{what}");
            assert!(solution.report.residual_n.is_finite(), "{what}: {:?}", solution.report);
        }
        Err(Error::Numerics { .. } | Error::NonFinite { .. }) => {}
        Err(other) => panic!("{what}: {other}"),
    }
}

#[test]
fn bad_starts() {
    let rest = sheet(4, 4, [0.1, 0.1], 0.2);
    let settings = SolverSettings { iterations: 60, ..Default::default() };
    let x = &rest.template.vertices;
    for material in [stvk(20.0, 11.0, 4e-5), measured("")] {
        let mut solver = Solver::new(&rest, material, Forces::default(), settings).unwrap();
        let scene = Scene { fixed: &[20, 24], ..Default::default() };
        let starts: Vec<(&str, Vec<Vec3>)> = vec![
            ("collapsed to a point", vec![Vec3::new(0.1, 0.2, 0.3); x.len()]),
            ("collapsed to a line", x.iter().map(|p| Vec3::new(p.x, 0.0, 0.0)).collect()),
            ("turned inside out", x.iter().map(|p| Vec3::new(-p.x, p.y, 0.0)).collect()),
            ("stretched tenfold", x.iter().map(|p| p * 10.0).collect()),
            ("crumpled", shaken(x, 0.05, 1)),
            ("far away", x.iter().map(|p| p + Vec3::repeat(1e4)).collect()),
            ("folded flat onto itself", x.iter().map(|p| Vec3::new((p.x - 0.05).abs(), p.y, 0.0)).collect()),
            ("huge", x.iter().map(|p| p * 1e30).collect()),
        ];
        for (what, start) in &starts {
            finite(&mut solver, &scene, start, what);
        }
        let mut nan = x.clone();
        nan[3].y = f64::NAN;
        assert!(matches!(solver.solve(&scene, &nan, &quiet), Err(Error::NonFinite { .. })));
        assert!(matches!(solver.solve(&scene, &x[1..], &quiet), Err(Error::Length { .. })));
        // Nothing holds it: no equilibrium, but an answer.
        let falling = solver.solve(&Scene::default(), x, &quiet).unwrap();
        assert!(!falling.converged() && falling.positions[0].y < x[0].y);
    }
}

#[test]
fn extreme_stiffness_and_steps() {
    let rest = sheet(4, 4, [0.1, 0.1], 0.2);
    let start = shaken(&rest.template.vertices, 1e-3, 2);
    let settings = SolverSettings { iterations: 60, ..Default::default() };
    for (lambda, mu, bending) in
        [(1e-3, 1e-3, 1e-12), (1e8, 1e8, 1e-9), (1e-3, 1e-3, 1e3), (0.0, 1e8, 1e8), (1e8, 1e-3, 0.0)]
    {
        let Ok(material) = std::panic::catch_unwind(|| stvk(lambda, mu, bending)) else { continue };
        let mut solver = Solver::new(&rest, material, Forces::default(), settings).unwrap();
        finite(
            &mut solver,
            &Scene { fixed: &[20, 24], ..Default::default() },
            &start,
            &format!("{lambda} {mu} {bending}"),
        );
        for step in [1e-4, 1.0] {
            let mut motion = Dynamics::new(start.clone(), None, step).unwrap();
            for _ in 0..3 {
                if let Ok(solution) =
                    motion.advance(&mut solver, &Scene { fixed: &[20, 24], ..Default::default() }, None, &quiet)
                {
                    assert!(solution.positions.iter().all(|p| p.iter().all(|c| c.is_finite())));
                }
            }
        }
    }
}

#[test]
fn wrong_scenes_are_typed_errors() {
    let rest = sheet(2, 2, [0.1, 0.1], 0.2);
    let x = rest.template.vertices.clone();
    let make = |rest| Solver::new(rest, stvk(20.0, 11.0, 4e-5), Forces::default(), SolverSettings::default());
    let mut solver = make(&rest).unwrap();
    assert!(matches!(solver.solve(&Scene { fixed: &[9], ..Default::default() }, &x, &quiet), Err(Error::Mesh { .. })));
    let momentum = |step: f64, velocity| Momentum { step, now: &x, velocity };
    let still = vec![Vec3::zeros(); x.len()];
    let scene = |m| Scene { momentum: Some(m), ..Default::default() };
    assert!(matches!(solver.solve(&scene(momentum(0.0, &still)), &x, &quiet), Err(Error::Parameter { .. })));
    assert!(matches!(solver.solve(&scene(momentum(0.1, &[])), &x, &quiet), Err(Error::Length { .. })));
    let springs = Attachment::springs(&[1], &[5.0], x.len()).unwrap();
    let wrong = Scene { springs: Some(Springs { attachment: &springs, targets: &x }), ..Default::default() };
    assert!(matches!(solver.solve(&wrong, &x, &quiet), Err(Error::Length { .. })));
    let held = make(&rest.clone().holding("band", &[0, 1]).unwrap()).unwrap().solve(&Scene::default(), &x, &quiet);
    assert!(matches!(held, Err(Error::Config { .. })));
    let empty = frame(&[]);
    let body = Obstacle { positions: &empty, normals: &empty, before: None, search: None };
    assert!(solver.solve(&Scene { body: Some(body), ..Default::default() }, &x, &quiet).is_err());
    for settings in [
        SolverSettings { tolerance_n: 0.0, ..Default::default() },
        SolverSettings { max_move_m: f64::NAN, ..Default::default() },
        SolverSettings { friction: -1.0, ..Default::default() },
    ] {
        assert!(matches!(solver.set_settings(settings), Err(Error::Parameter { .. })));
    }
}
