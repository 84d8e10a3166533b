//! Second derivatives against differences of gradients, and projected ones against their eigenvalues.

use super::support::Fabric;
use super::{frame, shaken, sheet};
use caphy_core::Vec3;
use caphy_core::lanes::Frames;
use caphy_core::material::{HingeLength, MaterialModel, MaterialSpec};
use caphy_garment::GarmentRest;
use caphy_garment::energy::*;
use caphy_materials::{MaterialMeasuredSpec, MaterialNeoHookeanSpec, MaterialStvk};
use nalgebra::DMatrix;
use std::sync::Arc;

fn gradient(term: &dyn EnergyTangent, state: &State<'_, f64>, x: &[Vec3]) -> Vec<f64> {
    let positions = frame(x);
    let mut g = Frames::zeros(1, x.len(), 1);
    term.add(&State { positions: &positions, ..*state }, 0.7, &mut [0.0], Some(&mut g)).unwrap();
    (0..x.len()).flat_map(|v| g.get(0, 0, v).iter().copied().collect::<Vec<_>>()).collect()
}

/// The assembled matrix of a term, weight 0.7.
fn matrix(term: &dyn EnergyTangent, state: &State<'_, f64>, kind: Tangent) -> DMatrix<f64> {
    let n = state.positions.vertices();
    let stencil = term.stencil();
    let mut blocks = vec![f64::NAN; stencil.block_values()];
    term.tangents(state, 0.7, kind, &mut blocks).unwrap();
    let side = 3 * stencil.width;
    let mut out = DMatrix::zeros(3 * n, 3 * n);
    for (element, block) in stencil.vertices.chunks(stencil.width).zip(blocks.chunks(side * side)) {
        if kind == Tangent::Projected {
            let block = DMatrix::from_row_slice(side, side, block);
            assert!((&block - block.transpose()).amax() <= 1e-12 * block.amax());
            let least = block.symmetric_eigenvalues().min();
            assert!(least >= -1e-11 * block.amax().max(1e-300), "{}: eigenvalue {least:e} in {block}", term.name());
        }
        for i in 0..side {
            for j in 0..side {
                let at = |k: usize| 3 * element[k / 3] as usize + k % 3;
                out[(at(i), at(j))] += block[i * side + j];
            }
        }
    }
    out
}

fn check(term: &dyn EnergyTangent, state: &State<'_, f64>, tolerance: f64) {
    check_at(term, state, tolerance, 2e-5);
}

/// Every column against differences of the gradient (step `h` [m] and half of it, extrapolated: error h⁴).
fn check_at(term: &dyn EnergyTangent, state: &State<'_, f64>, tolerance: f64, h: f64) {
    let exact = matrix(term, state, Tangent::Exact);
    matrix(term, state, Tangent::Projected);
    let x = state.positions.frame(0, 0);
    let scale = exact.amax();
    assert!(scale > 0.0, "{} has no second derivative to check", term.name());
    for i in 0..3 * x.len() {
        let slope = |h: f64| -> Vec<f64> {
            let side = |h: f64| {
                let mut moved = x.clone();
                moved[i / 3][i % 3] += h;
                gradient(term, state, &moved)
            };
            side(h).iter().zip(side(-h)).map(|(a, b)| (a - b) / (2.0 * h)).collect()
        };
        let (fine, coarse) = (slope(0.5 * h), slope(h));
        for j in 0..3 * x.len() {
            let numeric = (4.0 * fine[j] - coarse[j]) / 3.0;
            let error = (numeric - exact[(j, i)]).abs();
            assert!(
                error < tolerance * scale,
                "{}: ({j}, {i}) {:e} against {numeric:e}, scale {scale:e}",
                term.name(),
                exact[(j, i)]
            );
        }
    }
}

fn cloth() -> (GarmentRest, Frames<f64>) {
    let rest = sheet(3, 2, [0.15, 0.1], 0.2);
    // Folds of some 30°, strains of some 20 %.
    let x = frame(&shaken(&rest.template.vertices, 0.012, 3));
    (rest, x)
}

#[test]
fn strain_of_every_material() {
    let (rest, x) = cloth();
    let state = State::new(&x);
    let stvk: Arc<dyn MaterialModel> = Arc::new(MaterialStvk::snug().unwrap());
    check(&Strain::new(&rest, stvk), &state, 1e-8);
    // Offers no tangent: differenced by the term.
    check(&Strain::new(&rest, Arc::new(Fabric::snug())), &state, 1e-7);
    let neo: MaterialNeoHookeanSpec =
        toml::from_str("mu_n_per_m = 11.0\nlambda_n_per_m = 20.0\n").expect("keys of the neo-Hookean sheet");
    check(&Strain::new(&rest, Arc::from(neo.build().unwrap())), &state, 1e-7);
}

/// A measured fabric with smooth stiffness inside a table cell; `gradient` is `frozen` or `full`.
fn measured(gradient: &str) -> Arc<dyn MaterialModel> {
    let text = format!("fabric = \"gray-interlock\"\nstiffness_gradient = \"{gradient}\"\n");
    let spec: MaterialMeasuredSpec = toml::from_str(&text).unwrap();
    Arc::from(spec.build().unwrap())
}

#[test]
fn measured_strain_frozen_and_full() {
    // Small strains stay inside one cell of the table (see the reference: nodes at ±1/60 around rest).
    let rest = sheet(3, 2, [0.15, 0.1], 0.2);
    let x = frame(&shaken(&rest.template.vertices, 2e-4, 3));
    let state = State::new(&x);
    for gradient in ["frozen", "full"] {
        // Steps of 1e-7 m do not reach the kink at Guv = 0; what is left is rounding of the gradient, 1e-16 over 1e-7.
        check_at(&Strain::new(&rest, measured(gradient)), &state, 1e-6, 1e-7);
    }
    // While held, forces are those of constant stiffness, and the derivative is theirs.
    let (rest, x) = cloth();
    let state = State::new(&x);
    let mut strain = Strain::new(&rest, measured("frozen"));
    let before = gradient(&strain, &state, &x.frame(0, 0));
    strain.hold(&state).unwrap();
    let held = gradient(&strain, &state, &x.frame(0, 0));
    let scale = before.iter().fold(0.0f64, |m, g| m.max(g.abs()));
    assert!(
        before.iter().zip(&held).all(|(a, b)| (a - b).abs() < 1e-13 * scale),
        "the force at the held state is kept"
    );
    let elsewhere = frame(&shaken(&x.frame(0, 0), 0.004, 8));
    check(&strain, &State::new(&elsewhere), 1e-8);
    // A true gradient: its energy answers to a move.
    let points = elsewhere.frame(0, 0);
    let g = gradient(&strain, &state, &points);
    let h = 1e-6;
    let value = |sign: f64| {
        let mut moved = points.clone();
        moved[5].y += sign * h;
        let mut energy = [0.0];
        EnergyTerm::add(&strain, &State::new(&frame(&moved)), 0.7, &mut energy, None).unwrap();
        energy[0]
    };
    let slope = (value(1.0) - value(-1.0)) / (2.0 * h);
    assert!((slope - g[16]).abs() < 1e-6 * g[16].abs().max(1.0), "{slope} {}", g[16]);
}

#[test]
fn bending_with_every_rule_of_length() {
    let (rest, x) = cloth();
    let state = State::new(&x);
    for length in [HingeLength::Rest, HingeLength::CurrentHeld, HingeLength::Current] {
        for slope in [0.0, 0.7] {
            let fabric = Arc::new(Fabric { slope, length, ..Fabric::snug() });
            // Slopes that are differenced twice keep about six digits.
            let tolerance = if slope == 0.0 { 1e-7 } else { 1e-5 };
            check(&Bending::new(&rest, fabric.clone(), RestAngle::Template), &state, tolerance);
            let mut held = Bending::new(&rest, fabric, RestAngle::Template);
            held.hold(&state).unwrap();
            check(&held, &State::new(&frame(&shaken(&x.frame(0, 0), 0.004, 9))), 1e-7);
        }
    }
}

#[test]
fn bending_of_sharp_folds() {
    // All fold angles up to nearly closed, both ways.
    let rest = sheet(1, 1, [0.05, 0.04], 0.2);
    let fabric = Arc::new(Fabric { length: HingeLength::Current, ..Fabric::snug() });
    for degrees in (-170..=170).step_by(20) {
        let turn = nalgebra::Rotation3::from_axis_angle(
            &nalgebra::Unit::new_normalize(rest.template.vertices[3] - rest.template.vertices[0]),
            f64::from(degrees).to_radians(),
        );
        let mut points = rest.template.vertices.clone();
        points[1] = turn * points[1];
        let x = frame(&shaken(&points, 0.002, degrees as u64));
        check(&Bending::new(&rest, fabric.clone(), RestAngle::Flat), &State::new(&x), 1e-7);
    }
}

#[test]
fn measured_bending_frozen_and_full() {
    let (rest, x) = cloth();
    for gradient in ["frozen", "full"] {
        for length in ["rest", "current"] {
            let text = format!(
                "fabric = \"gray-interlock\"\nstiffness_gradient = \"{gradient}\"\nedge_length = \"{length}\"\n"
            );
            let spec: MaterialMeasuredSpec = toml::from_str(&text).unwrap();
            let material: Arc<dyn MaterialModel> = Arc::from(spec.build().unwrap());
            // Small folds: away from the kinks at the table's columns (5 1/m).
            let points: Vec<Vec3> =
                x.frame(0, 0).iter().zip(&rest.template.vertices).map(|(x, r)| r + (x - r) * 0.02).collect();
            check(&Bending::new(&rest, material, RestAngle::Template), &State::new(&frame(&points)), 1e-5);
        }
    }
}

#[test]
fn contact_friction_springs_and_scan() {
    let (rest, x) = cloth();
    let rest = rest.holding("edge", &[0, 1, 2, 3]).unwrap();
    let below: Vec<Vec3> = shaken(&rest.template.vertices, 0.003, 4).iter().map(|p| p - Vec3::z() * 0.005).collect();
    let body = frame(&below);
    let normals = frame_normals(&body, rest.faces()).unwrap();
    let nearest = nearest_body_vertices(&x, &body).unwrap();
    let state = State::new(&x).with_body(BodyState { positions: &body, normals: &normals, nearest: Some(&nearest) });
    let options = ContactOptions { margin: 0.02, ..ContactOptions::default() };
    let collision = Collision::new(&rest, &options).unwrap();
    check(&collision, &state, 1e-8);
    let touches = collision.contacts(&state, 1.0).unwrap();
    assert!(!touches.is_empty());
    for slip in [1e-4, 0.1] {
        // Sliding and sticking.
        let friction = Friction::new(&touches, 0.4, slip, rest.vertex_count(), |t| {
            rest.template.vertices[t.vertex as usize] + Vec3::new(0.003, 0.001, 0.0)
        })
        .unwrap();
        check(&friction, &state, 1e-7);
    }
    let attachment = Attachment::new(&rest, 1000.0);
    let targets: Vec<Vec3> = attachment.vertices().iter().map(|&v| rest.template.vertices[v as usize]).collect();
    let targets = frame(&targets);
    check(&attachment, &State::new(&x).with_targets(&targets), 1e-9);
    let cloud = ScanCloud::new("scan", &shaken(&rest.template.vertices, 0.003, 5)).unwrap();
    let scans = [&cloud];
    check(&Chamfer::new(&rest, None).unwrap(), &State::new(&x).with_scans(&scans), 1e-8);
    assert!(Attachment::<f64>::springs(&[99], &[1.0], 12).is_err());
    assert!(Attachment::<f64>::springs(&[1], &[-1.0], 12).is_err());
}

#[test]
fn a_hinge_that_folds_through_itself_jumps_by_what_is_said() {
    let rest = sheet(1, 1, [0.05, 0.04], 0.2);
    let axis = nalgebra::Unit::new_normalize(rest.template.vertices[3] - rest.template.vertices[0]);
    let turned = |angle: f64| -> Vec<f64> {
        let mut points = rest.template.vertices.clone();
        points[1] = nalgebra::Rotation3::from_axis_angle(&axis, angle) * points[1];
        points.iter().flat_map(|p| [p.x, p.y, p.z]).collect()
    };
    // A fold at rest makes both sides of π differ.
    let mut bent = rest.clone();
    bent.hinges[0].angle = 0.3;
    let mut bending = Bending::new(&bent, Arc::new(Fabric::snug()), RestAngle::Template);
    for hold in [false, true] {
        if hold {
            bending.hold(&State::new(&frame(&rest.template.vertices))).unwrap();
        }
        for sign in [1.0, -1.0] {
            let x = |angle: f64| turned(sign * angle);
            let energy = |x: &[f64]| bending.add_single(&Single::new(x), 0.7, None).unwrap();
            let jump = |a: f64, b: f64| bending.jump_between(&x(a), &x(b), 0.7).unwrap();
            let pi = std::f64::consts::PI;
            let across = energy(&x(pi + 1e-7)) - energy(&x(pi - 1e-7));
            assert!(across.abs() > 1e-5, "the energy jumps by {across}");
            // The energy's own change over 2e-7 rad is some 1e-11 J.
            assert!((jump(pi - 1e-7, pi + 1e-7) - across).abs() < 1e-9, "{} {across}", jump(pi - 1e-7, pi + 1e-7));
            assert_eq!(jump(0.5, pi - 1e-3), 0.0);
            // With it, the way across is a parabola.
            let smooth = |a: f64, b: f64| energy(&x(b)) - energy(&x(a)) - jump(a, b);
            let second = smooth(3.1, 3.3) - (energy(&x(3.1)) - energy(&x(2.9)));
            let third = energy(&x(3.1)) - 2.0 * energy(&x(2.9)) + energy(&x(2.7));
            assert!((second - third).abs() < 1e-9, "{second:e} {third:e}");
        }
    }
}
