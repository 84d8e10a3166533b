//! Every energy term: gradient against finite differences in f64, invariances, extremes, precision, threads.

use crate::support;

use caphy_core::lanes::Frames;
use caphy_core::material::{HingeLength, MaterialModel, MaterialReal};
use caphy_core::query::boundary_loops;
use caphy_core::units::KilogramPerSquareMetre;
use caphy_core::{Error, TriMesh, Vec3};
use caphy_garment::GarmentRest;
use caphy_garment::energy::*;
use nalgebra::Rotation3;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::sync::Arc;
use support::Fabric;

/// A tube that is not round, 6 rings of 8, about 5 cm edges; uv is its unrolled surface.
fn tube() -> GarmentRest {
    let (rings, around) = (6usize, 8usize);
    let angle = |a: usize| a as f64 / around as f64 * std::f64::consts::TAU;
    let vertices = (0..rings * around)
        .map(|i| {
            let (ring, a) = (i / around, angle(i % around));
            let r = 0.1 + 0.01 * ring as f64;
            Vec3::new(r * a.cos(), 0.05 * ring as f64, 0.8 * r * a.sin())
        })
        .collect();
    let (mut faces, mut uv) = (Vec::new(), Vec::new());
    for ring in 0..rings - 1 {
        for a in 0..around {
            let id = |r: usize, a: usize| (r * around + a % around) as u32;
            let at = |r: usize, a: usize| [-(a as f64) * 0.09, r as f64 * 0.05 + 0.002 * a as f64];
            faces.push([id(ring, a), id(ring + 1, a), id(ring, a + 1)]);
            uv.push([at(ring, a), at(ring + 1, a), at(ring, a + 1)]);
            faces.push([id(ring, a + 1), id(ring + 1, a), id(ring + 1, a + 1)]);
            uv.push([at(ring, a + 1), at(ring + 1, a), at(ring + 1, a + 1)]);
        }
    }
    let mesh = TriMesh { vertices, faces };
    let band = boundary_loops(&mesh.faces)[0].clone();
    GarmentRest::new("tube", mesh, uv, KilogramPerSquareMetre(0.2), "unrolled")
        .unwrap()
        .holding("waistband", &band)
        .unwrap()
}

fn shaken(rest: &GarmentRest, size: f64, seed: u64) -> Vec<Vec3> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rest.template.vertices.iter().map(|p| p + Vec3::from_fn(|_, _| rng.random_range(-size..size))).collect()
}

fn batch<T: MaterialReal>(rest: &GarmentRest, blocks: usize, lanes: usize) -> Frames<T> {
    let mut frames = Frames::zeros(blocks, rest.vertex_count(), lanes);
    for frame in 0..blocks * lanes {
        frames.set_frame(frame / lanes, frame % lanes, &shaken(rest, 0.01, frame as u64)).unwrap();
    }
    frames
}

/// Energy of all frames and gradient.
fn evaluate<T: MaterialReal>(term: &dyn EnergyTerm<T>, state: &State<'_, T>) -> (Vec<f64>, Frames<T>) {
    let x = state.positions;
    let mut energy = vec![0.0; x.frames()];
    let mut gradient = Frames::zeros(x.blocks(), x.vertices(), x.lanes_used());
    term.add(state, 1.0, &mut energy, Some(&mut gradient)).unwrap();
    let mut alone = vec![0.0; x.frames()];
    term.add(state, 1.0, &mut alone, None).unwrap();
    assert_eq!(energy, alone, "the value does not depend on whether a gradient is wanted");
    (energy, gradient)
}

/// Central differences of the sum of energies (step 1e-5 m and half of it, extrapolated) at every vertex of one frame.
fn check_gradient(term: &dyn EnergyTerm<f64>, state: &State<'_, f64>, block: usize, lane: usize) {
    let (_, gradient) = evaluate(term, state);
    let mut x = state.positions.clone();
    let scale = (0..x.vertices()).map(|v| gradient.get(block, lane, v).norm()).fold(0.0, f64::max);
    assert!(scale > 0.0, "{} has no gradient to check", term.name());
    let mut value = |vertex: usize, axis: usize, h: f64| {
        let p = state.positions.get(block, lane, vertex);
        let mut moved = p;
        moved[axis] += h;
        x.set(block, lane, vertex, &moved);
        let mut energy = vec![0.0; x.frames()];
        term.add(&State { positions: &x, ..*state }, 1.0, &mut energy, None).unwrap();
        x.set(block, lane, vertex, &p);
        // Only this frame: inertia holds the past, so later frames do not answer.
        energy[block * x.lanes_used() + lane]
    };
    for vertex in 0..state.positions.vertices() {
        for axis in 0..3 {
            let mut slope = |h: f64| (value(vertex, axis, h) - value(vertex, axis, -h)) / (2.0 * h);
            let h = 2e-5;
            // Richardson: error h⁴.
            let numeric = (4.0 * slope(0.5 * h) - slope(h)) / 3.0;
            let exact = gradient.get(block, lane, vertex)[axis];
            assert!(
                (numeric - exact).abs() < 1e-7 * scale,
                "{}: vertex {vertex} axis {axis}: {exact:e} against {numeric:e}, scale {scale:e}",
                term.name()
            );
        }
    }
}

fn fabric(slope: f64, length: HingeLength) -> Arc<dyn MaterialModel> {
    Arc::new(Fabric { slope, length, ..Fabric::snug() })
}

#[test]
fn gradients_of_shape_terms() {
    let rest = tube();
    let x = batch::<f64>(&rest, 4, 2);
    let state = State::new(&x);
    check_gradient(&Strain::new(&rest, fabric(0.0, HingeLength::Rest)), &state, 1, 1);
    for slope in [0.0, 0.7] {
        for length in [HingeLength::Rest, HingeLength::Current] {
            check_gradient(&Bending::new(&rest, fabric(slope, length), RestAngle::Template), &state, 2, 0);
        }
    }
    check_gradient(&Gravity::new(&rest, Vec3::new(1.0, -9.0, 2.0)), &state, 0, 0);
    check_gradient(&Inertia::new(&rest, 1.0 / 30.0, InertiaRule::KnownVelocity).unwrap(), &state, 3, 1);
    check_gradient(&Inertia::new(&rest, 1.0 / 30.0, InertiaRule::Faithful).unwrap(), &state, 1, 0);
}

#[test]
fn the_held_length_is_held() {
    let rest = tube();
    let x = batch::<f64>(&rest, 1, 1);
    let state = State::new(&x);
    let of = |length| evaluate(&Bending::<f64>::new(&rest, fabric(0.0, length), RestAngle::Flat), &state);
    let (held, current) = (of(HingeLength::CurrentHeld), of(HingeLength::Current));
    assert_eq!(held.0, current.0);
    assert_ne!(held.1, current.1);
}

/// A body: a smaller shaken tube with its own normals.
fn body(rest: &GarmentRest, blocks: usize, lanes: usize) -> (Frames<f64>, Frames<f64>) {
    let mut frames = Frames::zeros(blocks, rest.vertex_count(), lanes);
    for frame in 0..blocks * lanes {
        let points: Vec<Vec3> = shaken(rest, 0.002, 100 + frame as u64).iter().map(|p| p * 0.99).collect();
        frames.set_frame(frame / lanes, frame % lanes, &points).unwrap();
    }
    let normals = frame_normals(&frames, rest.faces()).unwrap();
    (frames, normals)
}

#[test]
fn gradients_of_contact_attachment_and_scan() {
    let rest = tube();
    let x = batch::<f64>(&rest, 2, 2);
    let (positions, normals) = body(&rest, 2, 2);
    let nearest = nearest_body_vertices(&x, &positions).unwrap();
    let state =
        State::new(&x).with_body(BodyState { positions: &positions, normals: &normals, nearest: Some(&nearest) });
    let options = ContactOptions { margin: 0.02, ..ContactOptions::default() };
    check_gradient(&Collision::new(&rest, &options).unwrap(), &state, 1, 0);
    check_gradient(&Collision::faithful(&rest, 0.01, 250.0), &state, 0, 1);

    let attachment = Attachment::new(&rest, 1000.0);
    let mut targets = Frames::zeros(2, attachment.vertices().len(), 2);
    for frame in 0..4 {
        let points: Vec<Vec3> = attachment.vertices().iter().map(|&v| rest.template.vertices[v as usize]).collect();
        targets.set_frame(frame / 2, frame % 2, &points).unwrap();
    }
    check_gradient(&attachment, &state.with_targets(&targets), 1, 1);

    let cloud = ScanCloud::new("scan", &shaken(&rest, 0.012, 77)).unwrap();
    let scans = [&cloud; 4];
    let state = State::new(&x).with_scans(&scans);
    check_gradient(&Chamfer::new(&rest, None).unwrap(), &state, 0, 1);
    let visible: Vec<bool> = (0..rest.vertex_count()).map(|v| v >= 8).collect();
    let chamfer = Chamfer::new(&rest, Some(&visible)).unwrap();
    check_gradient(&chamfer, &state, 1, 0);
    let (_, gradient) = evaluate(&chamfer, &state);
    assert!((0..8).all(|v| gradient.get(0, 0, v) == Vec3::zeros()), "hidden vertices are not pulled");
}

#[test]
fn chamfer_is_both_means_of_squares() {
    let rest = tube();
    let x = batch::<f64>(&rest, 1, 1);
    let points = shaken(&rest, 0.02, 5);
    let cloud = ScanCloud::new("scan", &points[..30]).unwrap();
    let scans = [&cloud];
    let (energy, _) = evaluate(&Chamfer::new(&rest, None).unwrap(), &State::new(&x).with_scans(&scans));
    let mean = |from: &[Vec3], to: &[Vec3]| {
        let least = |p: &Vec3| to.iter().map(|q| (p - q).norm_squared()).fold(f64::INFINITY, f64::min);
        from.iter().map(least).sum::<f64>() / from.len() as f64
    };
    let garment = x.frame(0, 0);
    let expected = mean(&garment, &points[..30]) + mean(&points[..30], &garment);
    assert!((energy[0] - expected).abs() < 1e-14, "{} {expected}", energy[0]);
}

#[test]
fn layering_pushes_both_garments_apart() {
    let lower = tube();
    let upper = tube();
    for order in [LayeringOrder::Over, LayeringOrder::Tucked] {
        let scale = if order == LayeringOrder::Over { 0.985 } else { 1.015 };
        let xl = batch::<f64>(&lower, 1, 2);
        let mut xu = Frames::<f64>::zeros(1, upper.vertex_count(), 2);
        for lane in 0..2 {
            let points: Vec<Vec3> = shaken(&upper, 0.003, 900 + lane as u64)
                .iter()
                .map(|p| Vec3::new(p.x * scale, p.y, p.z * scale))
                .collect();
            xu.set_frame(0, lane, &points).unwrap();
        }
        let layering = Layering::new(&upper, &lower, LayeringOptions { order, ..Default::default() }).unwrap();
        let add = |xu: &Frames<f64>, gu: Option<&mut Frames<f64>>, gl: Option<&mut Frames<f64>>| {
            let mut energy = vec![0.0; 2];
            let (u, l) = (Layer { positions: xu, gradient: gu }, Layer { positions: &xl, gradient: gl });
            layering.add(u, l, 1.0, &mut energy).unwrap();
            energy
        };
        let (mut gu, mut gl) = (xu.clone(), xl.clone());
        gu.clear();
        gl.clear();
        let energy = add(&xu, Some(&mut gu), Some(&mut gl));
        assert!(energy[0] > 0.0 && energy == add(&xu, None, None));
        let sum = |g: &Frames<f64>| g.frame(0, 1).iter().sum::<Vec3>();
        assert!((sum(&gu) + sum(&gl)).norm() < 1e-12 * sum(&gu).norm().max(1e-9), "forces balance");
        // A step against the gradient of the upper garment lowers the energy by its square.
        let mut moved = xu.clone();
        let h = 1e-9;
        for v in 0..upper.vertex_count() {
            moved.set(0, 1, v, &(xu.get(0, 1, v) - h * gu.get(0, 1, v)));
        }
        let square: f64 = gu.frame(0, 1).iter().map(|g| g.norm_squared()).sum();
        let drop = energy[1] - add(&moved, None, None)[1];
        assert!((drop - h * square).abs() < 1e-4 * h * square, "{drop:e} {:e}", h * square);
        // Far away there is nothing.
        let mut far = xu.clone();
        (0..upper.vertex_count()).for_each(|v| {
            for lane in 0..2 {
                far.set(0, lane, v, &(xu.get(0, lane, v) + Vec3::new(5.0, 0.0, 0.0)));
            }
        });
        assert_eq!(add(&far, None, None), [0.0; 2]);
    }
    assert!(Layering::<f64>::new(&upper, &lower, LayeringOptions { margin: 0.0, ..Default::default() }).is_err());
}

#[test]
fn rigid_motion_costs_nothing() {
    let rest = tube();
    let x = batch::<f64>(&rest, 1, 1);
    let turn = Rotation3::from_scaled_axis(Vec3::new(0.3, 2.0, -1.0));
    let mut moved = x.clone();
    let points: Vec<Vec3> = x.frame(0, 0).iter().map(|p| turn * p + Vec3::new(3.0, -2.0, 1.0)).collect();
    moved.set_frame(0, 0, &points).unwrap();
    let terms: [Box<dyn EnergyTerm<f64>>; 2] = [
        Box::new(Strain::new(&rest, fabric(0.0, HingeLength::Rest))),
        Box::new(Bending::new(&rest, fabric(0.3, HingeLength::Current), RestAngle::Template)),
    ];
    for term in &terms {
        let (a, ga) = evaluate(&**term, &State::new(&x));
        let (b, gb) = evaluate(&**term, &State::new(&moved));
        assert!((a[0] - b[0]).abs() < 1e-11 * a[0], "{}", term.name());
        for v in 0..x.vertices() {
            let (ga, gb) = (turn * ga.get(0, 0, v), gb.get(0, 0, v));
            assert!((ga - gb).norm() < 1e-8 * gb.norm().max(1e-3), "{} {v}", term.name());
        }
    }
    // Gravity with its direction, and inertia of uniform motion.
    let mut glide = Frames::<f64>::zeros(4, rest.vertex_count(), 1);
    for step in 0..4 {
        let shift = Vec3::new(0.5, -0.25, 0.125) * step as f64;
        let points: Vec<Vec3> = x.frame(0, 0).iter().map(|p| p + shift).collect();
        glide.set_frame(step, 0, &points).unwrap();
    }
    let inertia = Inertia::<f64>::new(&rest, 0.1, InertiaRule::KnownVelocity).unwrap();
    assert_eq!(inertia.transitions(5, false), 3);
    let (energy, _) = evaluate(&inertia, &State::new(&glide));
    assert!(energy.iter().all(|e| e.abs() < 1e-25), "{energy:?}");
    // With the two steps before, the rest of a window has the energy and forces of the whole.
    let mut bent = glide.clone();
    let points: Vec<Vec3> = glide.frame(3, 0).iter().map(|p| p + 0.1 * p.y * Vec3::z()).collect();
    bent.set_frame(3, 0, &points).unwrap();
    let (whole, forces) = evaluate(&inertia, &State::new(&bent));
    let (mut past, mut window) = (Frames::<f64>::zeros(2, points.len(), 1), Frames::<f64>::zeros(2, points.len(), 1));
    for step in 0..4 {
        let part = if step < 2 { &mut past } else { &mut window };
        part.set_frame(step % 2, 0, &bent.frame(step, 0)).unwrap();
    }
    assert_eq!((inertia.transitions(2, false), inertia.transitions(2, true)), (0, 2));
    let (energy, own) = evaluate(&inertia, &State::new(&window).with_past(&past));
    assert_eq!(energy, whole[2..]);
    assert!(whole[3] > 0.0);
    for v in 0..points.len() {
        assert_eq!((own.get(0, 0, v), own.get(1, 0, v)), (forces.get(2, 0, v), forces.get(3, 0, v)));
    }
    let (energy, _) = evaluate(&Inertia::new(&rest, 0.1, InertiaRule::Faithful).unwrap(), &State::new(&glide));
    let expected = rest.mass() / (2.0 * 0.01) * Vec3::new(0.5, -0.25, 0.125).norm_squared();
    assert!((energy[1] - expected).abs() < 1e-12 * expected && energy[2] < 1e-25);
}

#[test]
fn extremes_stay_finite() {
    let rest = tube();
    let n = rest.vertex_count();
    let template = &rest.template.vertices;
    let cases: Vec<(&str, Vec<Vec3>)> = vec![
        ("all in one point", vec![Vec3::new(0.1, 0.2, 0.3); n]),
        ("all on a line", template.iter().map(|p| Vec3::new(0.0, p.y, 0.0)).collect()),
        ("flat", template.iter().map(|p| Vec3::new(p.x, p.y, 0.0)).collect()),
        ("inside out", template.iter().map(|p| Vec3::new(-p.x, p.y, p.z)).collect()),
        ("stretched ten times", template.iter().map(|p| p * 10.0).collect()),
        ("shrunk to a micrometre", template.iter().map(|p| p * 1e-5).collect()),
        ("one spike", template.iter().enumerate().map(|(v, p)| if v == 20 { p * 50.0 } else { *p }).collect()),
    ];
    fn check<T: MaterialReal>(rest: &GarmentRest, name: &str, points: &[Vec3]) {
        let mut x = Frames::<T>::zeros(1, points.len(), 1);
        x.set_frame(0, 0, points).unwrap();
        let body = BodyState { positions: &x, normals: &frame_normals(&x, rest.faces()).unwrap(), nearest: None };
        let state = State::new(&x).with_body(body);
        let terms: Vec<Box<dyn EnergyTerm<T>>> = vec![
            Box::new(Strain::new(rest, fabric(0.0, HingeLength::Rest))),
            Box::new(Bending::new(rest, fabric(0.1, HingeLength::Current), RestAngle::Template)),
            Box::new(Collision::new(rest, &ContactOptions::default()).unwrap()),
        ];
        for term in &terms {
            let (energy, gradient) = evaluate(&**term, &state);
            assert!(energy[0].is_finite(), "{name}: {}", term.name());
            assert!(gradient.data().iter().all(|g| g.is_finite()), "{name}: gradient of {}", term.name());
        }
    }
    for (name, points) in &cases {
        check::<f32>(&rest, name, points);
        check::<f64>(&rest, name, points);
    }
}

#[test]
fn a_hinge_folds_to_half_a_turn_with_a_finite_force() {
    let fold = |angle: f64| {
        let (s, c) = angle.sin_cos();
        vec![
            Vec3::zeros(),
            Vec3::new(0.0, 0.01, 0.0),
            Vec3::new(-0.01, 0.005, 0.0),
            Vec3::new(0.01 * c, 0.005, 0.01 * s),
        ]
    };
    let uv = vec![[[0.0, 0.0], [0.0, 0.01], [-0.01, 0.005]], [[0.0, 0.01], [0.0, 0.0], [0.01, 0.005]]];
    let mesh = TriMesh { vertices: fold(0.0), faces: vec![[0, 1, 2], [1, 0, 3]] };
    let rest = GarmentRest::new("strip", mesh, uv, KilogramPerSquareMetre(0.2), "test").unwrap();
    let k = Fabric::snug().bending;
    let bending = Bending::<f64>::new(&rest, fabric(0.0, HingeLength::Rest), RestAngle::Template);
    for i in -20..=20 {
        let angle = f64::from(i) / 20.0 * std::f64::consts::PI;
        let mut x = Frames::zeros(1, 4, 1);
        x.set_frame(0, 0, &fold(angle)).unwrap();
        let (energy, gradient) = evaluate(&bending, &State::new(&x));
        // Eq. 7 with l = 0.01 m and both areas 5e-5 m².
        let expected = k * 1e-4 / (8.0 * 1e-4) * angle * angle;
        assert!((energy[0] - expected).abs() < 1e-12 * k, "{angle}: {} {expected}", energy[0]);
        // dE/dτ over the height of 0.01 m.
        let pull = gradient.get(0, 0, 3).norm();
        assert!((pull - k * 0.25 * angle.abs() / 0.01).abs() < 1e-9 * k, "{angle}: {pull}");
    }
}

#[test]
fn bad_values_are_named() {
    let rest = tube();
    let bad = |value: f64| {
        let mut x = batch::<f32>(&rest, 2, 3);
        x.set(1, 2, 7, &Vec3::new(value, 0.0, 0.0));
        x
    };
    let body = batch::<f32>(&rest, 2, 3);
    let normals = frame_normals(&body, rest.faces()).unwrap();
    let cloud = ScanCloud::new("scan", &rest.template.vertices).unwrap();
    let scans = [&cloud; 6];
    let terms: Vec<Box<dyn EnergyTerm<f32>>> = vec![
        Box::new(Strain::new(&rest, fabric(0.0, HingeLength::Rest))),
        Box::new(Bending::new(&rest, fabric(0.0, HingeLength::Current), RestAngle::Template)),
        Box::new(Gravity::new(&rest, gravity::EARTH)),
        Box::new(Inertia::new(&rest, 0.1, InertiaRule::Faithful).unwrap()),
        Box::new(Collision::new(&rest, &ContactOptions::default()).unwrap()),
        Box::new(Chamfer::new(&rest, None).unwrap()),
    ];
    for value in [f64::NAN, f64::INFINITY] {
        let x = bad(value);
        let state = State::new(&x)
            .with_body(BodyState { positions: &body, normals: &normals, nearest: None })
            .with_scans(&scans);
        for term in &terms {
            let mut energy = vec![0.0; 6];
            let mut gradient = batch::<f32>(&rest, 2, 3);
            let error = term.add(&state, 1.0, &mut energy, Some(&mut gradient)).unwrap_err();
            let text = error.to_string();
            assert!(matches!(error, Error::Numerics { .. }), "{}: {text}", term.name());
            assert!(text.contains("step 1, window 2"), "{}: {text}", term.name());
            assert_eq!(energy, [0.0; 6]);
        }
    }
    // Parts of the state that are missing or do not fit.
    let x = batch::<f32>(&rest, 2, 3);
    let mut energy = vec![0.0; 6];
    assert!(matches!(terms[4].add(&State::new(&x), 1.0, &mut energy, None), Err(Error::Config { .. })));
    assert!(matches!(terms[5].add(&State::new(&x), 1.0, &mut energy, None), Err(Error::Length { .. })));
    assert!(matches!(terms[0].add(&State::new(&x), 1.0, &mut energy[..5], None), Err(Error::Length { .. })));
    let nearest = vec![1_000_000u32; 2 * rest.vertex_count() * 16];
    let state = State::new(&x).with_body(BodyState { positions: &body, normals: &normals, nearest: Some(&nearest) });
    assert!(matches!(terms[4].add(&state, 1.0, &mut energy, None), Err(Error::Mesh { .. })));
    assert!(Collision::<f32>::new(&rest, &ContactOptions { margin: -1.0, ..Default::default() }).is_err());
    assert!(Inertia::<f32>::new(&rest, 0.0, InertiaRule::Faithful).is_err());
    assert!(ScanCloud::<f32>::new("scan", &[]).is_err());
    assert!(Chamfer::new(&rest, Some(&vec![false; rest.vertex_count()])).is_err());
}

#[test]
fn single_precision_follows_double() {
    let rest = tube();
    let (x32, x64) = (batch::<f32>(&rest, 2, 3), batch::<f64>(&rest, 2, 3));
    fn terms<T: MaterialReal>(rest: &GarmentRest) -> [Box<dyn EnergyTerm<T>>; 2] {
        [
            Box::new(Strain::new(rest, fabric(0.0, HingeLength::Rest))),
            Box::new(Bending::new(rest, fabric(0.4, HingeLength::Current), RestAngle::Template)),
        ]
    }
    for (a, b) in terms::<f32>(&rest).iter().zip(&terms::<f64>(&rest)) {
        let (a, b) = (evaluate(&**a, &State::new(&x32)), evaluate(&**b, &State::new(&x64)));
        for (a, b) in a.0.iter().zip(&b.0) {
            assert!((a - b).abs() < 3e-6 * b, "{a} {b}");
        }
        let norm = b.1.frame(1, 2).iter().map(|g| g.norm_squared()).sum::<f64>().sqrt();
        let off: f64 = (0..rest.vertex_count()).map(|v| (a.1.get(1, 2, v) - b.1.get(1, 2, v)).norm_squared()).sum();
        assert!(off.sqrt() < 1e-5 * norm);
    }
}

#[test]
fn weights_scale_and_results_do_not_depend_on_threads() {
    let rest = tube();
    let x = batch::<f32>(&rest, 5, 16);
    let body = batch::<f32>(&rest, 5, 16);
    let normals = frame_normals(&body, rest.faces()).unwrap();
    let cloud = ScanCloud::new("scan", &shaken(&rest, 0.02, 3)).unwrap();
    let scans = [&cloud; 80];
    let terms: Vec<Box<dyn EnergyTerm<f32>>> = vec![
        Box::new(Strain::new(&rest, fabric(0.0, HingeLength::Rest))),
        Box::new(Bending::new(&rest, fabric(0.2, HingeLength::Current), RestAngle::Template)),
        Box::new(Gravity::new(&rest, gravity::EARTH)),
        Box::new(Inertia::new(&rest, 0.1, InertiaRule::KnownVelocity).unwrap()),
        Box::new(Collision::new(&rest, &ContactOptions { margin: 0.02, ..Default::default() }).unwrap()),
        Box::new(Chamfer::new(&rest, None).unwrap()),
    ];
    let state =
        State::new(&x).with_body(BodyState { positions: &body, normals: &normals, nearest: None }).with_scans(&scans);
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| terms.iter().map(|t| evaluate(&**t, &state)).collect::<Vec<_>>())
    };
    let (one, two) = (run(1), run(2));
    assert!(one == two);
    for (term, (energy, _)) in terms.iter().zip(&one) {
        assert!(energy.iter().any(|e| *e != 0.0), "{}", term.name());
        let mut doubled = energy.clone();
        term.add(&state, 2.0, &mut doubled, None).unwrap();
        for (d, e) in doubled.iter().zip(energy) {
            assert!((d - 3.0 * e).abs() <= 1e-6 * e.abs(), "{}: {d} {e}", term.name());
        }
    }
}

#[test]
fn the_default_contact_carries_its_load_at_the_allowed_depth() {
    let rest = tube();
    let options = ContactOptions::default();
    let mut x = Frames::<f64>::zeros(1, rest.vertex_count(), 1);
    x.set_frame(0, 0, &rest.template.vertices).unwrap();
    let normals = frame_normals(&x, rest.faces()).unwrap();
    // The body lies inside by margin − depth along its normals.
    let mut body = x.clone();
    for v in 0..rest.vertex_count() {
        body.set(0, 0, v, &(x.get(0, 0, v) - normals.get(0, 0, v) * (options.margin - options.allowed_depth)));
    }
    let state = State::new(&x).with_body(BodyState { positions: &body, normals: &normals, nearest: None });
    let (_, gradient) = evaluate(&Collision::new(&rest, &options).unwrap(), &state);
    for v in 0..rest.vertex_count() {
        let pressure = gradient.get(0, 0, v).norm() / rest.vertex_areas[v];
        assert!((pressure - options.load * 0.2 * 9.81).abs() < 1e-9 * pressure, "{pressure}");
    }
}
