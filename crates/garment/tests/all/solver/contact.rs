//! Contact and friction: a sheet on a sphere, a patch on an incline.

use super::analytic::{measured, solver, stvk};
use super::{frame, quiet, shaken, sheet};
use caphy_core::Vec3;
use caphy_core::lanes::Frames;
use caphy_garment::GarmentRest;
use caphy_garment::solver::{Dynamics, Forces, Obstacle, Scene, Solver, SolverSettings};

/// Points spread evenly over a sphere about the origin, with their normals.
fn sphere(radius: f64, count: usize) -> (Frames<f64>, Frames<f64>) {
    let golden = std::f64::consts::PI * (3.0 - 5.0f64.sqrt());
    let normals: Vec<Vec3> = (0..count)
        .map(|i| {
            let y = 1.0 - 2.0 * (i as f64 + 0.5) / count as f64;
            let r = (1.0 - y * y).sqrt();
            Vec3::new(r * (golden * i as f64).cos(), y, r * (golden * i as f64).sin())
        })
        .collect();
    let points: Vec<Vec3> = normals.iter().map(|n| n * radius).collect();
    (frame(&points), frame(&normals))
}

/// A square laid flat at a height over the sphere.
fn cloth(height: f64) -> (GarmentRest, Vec<Vec3>) {
    let rest = sheet(14, 14, [0.28, 0.28], 0.2);
    let flat: Vec<Vec3> = rest.template.vertices.iter().map(|p| Vec3::new(p.x - 0.14, height, 0.14 - p.y)).collect();
    (rest, flat)
}

#[test]
fn a_cloth_comes_to_rest_on_a_sphere_from_above_and_from_inside() {
    let (body, normals) = sphere(0.1, 4000);
    let obstacle = Obstacle { positions: &body, normals: &normals, before: None, search: None };
    let scene = Scene { body: Some(obstacle), ..Default::default() };
    // Starting at 0.05 m its middle is 5 cm inside.
    for (height, friction) in [(0.103, 0.3), (0.05, 0.3), (0.103, 0.0)] {
        let (rest, flat) = cloth(height);
        let settings = SolverSettings { friction, iterations: 300, ..Default::default() };
        let mut solver = solver(&rest, stvk(20.0, 11.0, 4e-5), settings);
        let solution = solver.solve(&scene, &shaken(&flat, 1e-4, 3), &quiet).unwrap();
        let r = &solution.report;
        eprintln!(
            "from {height} m, friction {friction}: {:?}, {} steps, {} factorisations, {} rounds, residual {:e} N, open {}",
            r.outcome, r.iterations, r.factorisations, r.rounds, r.residual_n, r.pairs_open
        );
        assert!(r.residual_n.is_finite());
        let deepest = solution.positions.iter().map(|p| 0.1 - p.norm()).fold(f64::NEG_INFINITY, f64::max);
        assert!(deepest < 1e-3, "{deepest} m inside");
        // Without friction it slides off: no rest, but an answer.
        if friction > 0.0 {
            assert!(solution.converged(), "{r:?}");
            // Contact and friction carry the weight.
            let weight = 9.81 * rest.mass();
            let normal: f64 = solution.contacts.iter().map(|c| c.force * c.normal[1]).sum();
            assert!(normal > 0.5 * weight && normal < 1.2 * weight, "{normal} of {weight}");
        }
    }
}

#[test]
fn a_patch_on_an_incline_sticks_below_the_friction_angle_and_slides_above() {
    // The plane is level and gravity leans: tan α = 0.3.
    let slope: f64 = 0.3;
    let alpha = slope.atan();
    let gravity = Vec3::new(9.81 * alpha.sin(), -9.81 * alpha.cos(), 0.0);
    let spots: Vec<Vec3> = (0..200)
        .flat_map(|i| (0..9).map(move |j| Vec3::new(0.01 * i as f64 - 0.2, 0.0, 0.01 * j as f64 - 0.04)))
        .collect();
    let body = frame(&spots);
    let up = frame(&vec![Vec3::y(); spots.len()]);
    let scene = Scene {
        body: Some(Obstacle { positions: &body, normals: &up, before: None, search: None }),
        ..Default::default()
    };
    let rest = sheet(2, 2, [0.04, 0.04], 0.3);
    let flat: Vec<Vec3> = rest.template.vertices.iter().map(|p| Vec3::new(p.x, 1.8e-3, 0.02 - p.y)).collect();
    let step = 1.0 / 60.0;
    let forces = Forces { gravity, ..Forces::default() };
    let with = |friction: f64| SolverSettings { friction, tolerance_n: 1e-10, ..Default::default() };
    let mean = |x: &[Vec3]| x.iter().map(|p| p.x).sum::<f64>() / x.len() as f64;
    let mut solver = Solver::new(&rest, stvk(20.0, 11.0, 4e-5), forces, with(2.0)).unwrap();
    let mut motion = Dynamics::new(flat, None, step).unwrap();
    for _ in 0..20 {
        motion.advance(&mut solver, &scene, None, &quiet).unwrap();
    }
    let settled = motion.clone();
    // Sticking: 5 % above the angle nothing creeps.
    solver.set_settings(with(1.05 * slope)).unwrap();
    let before = mean(motion.positions());
    for _ in 0..40 {
        let solution = motion.advance(&mut solver, &scene, None, &quiet).unwrap();
        assert!(solution.converged(), "{:?}", solution.report);
    }
    let drift = mean(motion.positions()) - before;
    let fast = motion.velocity().iter().map(|v| v.norm()).fold(0.0, f64::max);
    assert!(drift.abs() < 1e-4 && fast < 1e-6, "{drift} m, {fast} m/s");
    // Sliding: a = g (sin α − μ cos α).
    for friction in [0.0, 0.5 * slope, 0.9 * slope] {
        let mut motion = settled.clone();
        solver.set_settings(with(friction)).unwrap();
        let mut velocity = Vec::new();
        for _ in 0..30 {
            motion.advance(&mut solver, &scene, None, &quiet).unwrap();
            velocity.push(mean(motion.velocity()));
        }
        let acceleration = (velocity[29] - velocity[9]) / (20.0 * step);
        let expected = 9.81 * (alpha.sin() - friction * alpha.cos());
        assert!((acceleration - expected).abs() < 0.01 * 9.81 * alpha.sin(), "μ {friction}: {acceleration} {expected}");
    }
}

#[test]
fn a_sticking_patch_rides_on_a_moving_floor() {
    let spots: Vec<Vec3> = (0..60)
        .flat_map(|i| (0..9).map(move |j| Vec3::new(0.01 * i as f64 - 0.2, 0.0, 0.01 * j as f64 - 0.04)))
        .collect();
    let up = frame(&vec![Vec3::y(); spots.len()]);
    let rest = sheet(2, 2, [0.04, 0.04], 0.3);
    let flat: Vec<Vec3> = rest.template.vertices.iter().map(|p| Vec3::new(p.x, 1.8e-3, 0.02 - p.y)).collect();
    let settings = SolverSettings { friction: 1.0, tolerance_n: 1e-10, ..Default::default() };
    let mut solver = solver(&rest, stvk(20.0, 11.0, 4e-5), settings);
    let mut motion = Dynamics::new(flat, None, 1.0 / 60.0).unwrap();
    let floor = |t: usize| frame(&spots.iter().map(|p| p + Vec3::x() * (1e-3 * t as f64)).collect::<Vec<_>>());
    let mut first = 0.0;
    for t in 1..60usize {
        let (before, now) = (floor(t - 1), floor(t));
        let body = Obstacle { positions: &now, normals: &up, before: Some(&before), search: None };
        motion.advance(&mut solver, &Scene { body: Some(body), ..Default::default() }, None, &quiet).unwrap();
        let offset = motion.positions()[4].x - 1e-3 * t as f64;
        if t == 30 {
            first = offset;
        }
    }
    let last = motion.positions()[4].x - 1e-3 * 59.0;
    assert!((last - first).abs() < 1e-5, "it rides along: {first} {last}");
}

#[test]
fn from_a_scan_by_attaching_and_letting_go() {
    let (body, normals) = sphere(0.1, 4000);
    let obstacle = Obstacle { positions: &body, normals: &normals, before: None, search: None };
    let scene = Scene { body: Some(obstacle), ..Default::default() };
    let (rest, flat) = cloth(0.103);
    let settings = SolverSettings { friction: 0.3, iterations: 300, ..Default::default() };
    let mut solver = solver(&rest, measured(""), settings);
    let truth = solver.solve(&scene, &shaken(&flat, 1e-4, 3), &quiet).unwrap();
    // Half a millimetre of noise on every point, as a scan has.
    let scanned = shaken(&truth.positions, 5e-4, 9);
    let all: Vec<u32> = (0..rest.vertex_count() as u32).collect();
    let scene = Scene { anchors: Some(&truth.anchors), ..scene };
    let found = solver.attach_and_release(&scene, &scanned, (&all, &scanned), &quiet).unwrap();
    let rms = |a: &[Vec3]| {
        (a.iter().zip(&truth.positions).map(|(a, b)| (a - b).norm_squared()).sum::<f64>() / a.len() as f64).sqrt()
    };
    eprintln!("{:?}: {} m from the truth", found.report.outcome, rms(&found.positions));
    assert!(rms(&found.positions) < 1e-3, "the same branch: {}", rms(&found.positions));
}
