//! Energies of one pose, elements in lanes, against the batched ones that put frames in lanes.

use super::{frame, shaken, sheet};
use caphy_core::lanes::Frames;
use caphy_core::material::{HingeLength, MaterialModel, MaterialSpec};
use caphy_core::{Real, Vec3};
use caphy_garment::GarmentRest;
use caphy_garment::energy::*;
use caphy_materials::{MaterialMeasuredSpec, MaterialStvk};
use std::sync::Arc;

fn flat(points: &[Vec3]) -> Vec<f64> {
    points.iter().flat_map(|p| [p.x, p.y, p.z]).collect()
}

/// What a gradient holds before a term adds to it [N].
const BEFORE: f64 = 1e-9;

/// Energy and gradient both ways, with a gradient that was there before.
fn compare(term: &(impl EnergyTerm<f64> + SingleTerm), state: &State<'_, f64>, pose: &Single<'_>) {
    let n = state.positions.vertices();
    let (mut energy, mut batched) = ([0.0], Frames::zeros(1, n, 1));
    batched.data_mut().fill(BEFORE);
    term.add(state, 0.7, &mut energy, Some(&mut batched)).unwrap();
    let mut single = vec![BEFORE; 3 * n];
    let value = term.add_single(pose, 0.7, Some(&mut single)).unwrap();
    // Sums of a few hundred terms in another order.
    assert!((value - energy[0]).abs() <= 1e-13 * energy[0].abs(), "{}: {value} {}", term.name(), energy[0]);
    assert!(value != 0.0, "{} does nothing here", term.name());
    let batched = flat(&batched.frame(0, 0));
    let scale = batched.iter().fold(0.0f64, |m, g| m.max(g.abs()));
    for (i, (a, b)) in single.iter().zip(&batched).enumerate() {
        assert!((a - b).abs() <= 1e-13 * scale, "{}: vertex {} {a} {b}", term.name(), i / 3);
    }
    assert!(scale > 2.0 * BEFORE, "{} has no gradient here", term.name());
    let alone = term.add_single(pose, 0.7, None).unwrap();
    assert_eq!(alone.to_bits(), value.to_bits(), "{} without its gradient", term.name());
    // A vertex that is not finite is found, a wrong shape refused.
    let mut bad = pose.positions.to_vec();
    bad[4] = f64::NAN;
    assert!(term.add_single(&Single { positions: &bad, ..*pose }, 0.7, None).is_err(), "{}", term.name());
    assert!(term.add_single(&Single { positions: &bad[3..], ..*pose }, 0.7, None).is_err(), "{}", term.name());
    assert!(term.add_single(pose, 0.7, Some(&mut single[3..])).is_err(), "{}", term.name());
}

/// More triangles and hinges than one batch, and no multiple of it.
fn cloth() -> (GarmentRest, Vec<Vec3>) {
    let rest = sheet(14, 11, [0.5, 0.4], 0.2);
    let x = shaken(&rest.template.vertices, 0.006, 3);
    (rest, x)
}

fn measured(keys: &str) -> Arc<dyn MaterialModel> {
    let spec: MaterialMeasuredSpec = toml::from_str(&format!("fabric = \"gray-interlock\"\n{keys}")).unwrap();
    Arc::from(spec.build().unwrap())
}

#[test]
fn strain_and_bending_of_every_kind_of_fabric() {
    let (rest, x) = cloth();
    let positions = frame(&x);
    let state = State::new(&positions);
    let x = flat(&x);
    let pose = Single::new(&x);
    let mut fabrics: Vec<Arc<dyn MaterialModel>> = vec![Arc::new(MaterialStvk::snug().unwrap())];
    for gradient in ["frozen", "full"] {
        for length in ["rest", "current"] {
            fabrics.push(measured(&format!("stiffness_gradient = \"{gradient}\"\nedge_length = \"{length}\"\n")));
        }
    }
    for length in [HingeLength::Rest, HingeLength::CurrentHeld, HingeLength::Current] {
        fabrics.push(Arc::new(super::support::Fabric { slope: 0.7, length, ..super::support::Fabric::snug() }));
    }
    let before = frame(&shaken(&rest.template.vertices, 0.004, 5));
    for fabric in fabrics {
        let mut strain = Strain::new(&rest, fabric.clone());
        let mut bending = Bending::new(&rest, fabric, RestAngle::Template);
        compare(&strain, &state, &pose);
        compare(&bending, &state, &pose);
        strain.hold(&State::new(&before)).unwrap();
        bending.hold(&State::new(&before)).unwrap();
        compare(&strain, &state, &pose);
        compare(&bending, &state, &pose);
    }
}

#[test]
fn gravity_contact_friction_and_springs() {
    let (rest, x) = cloth();
    let rest = rest.holding("edge", &[0, 1, 2, 3]).unwrap();
    let positions = frame(&x);
    let below: Vec<Vec3> = shaken(&rest.template.vertices, 0.003, 4).iter().map(|p| p - Vec3::z() * 0.005).collect();
    let body = frame(&below);
    let normals = frame_normals(&body, rest.faces()).unwrap();
    let lanes = nearest_body_vertices(&positions, &body).unwrap();
    let nearest: Vec<u32> = lanes.iter().step_by(<f64 as Real>::LANES).copied().collect();
    let points = |f: &Frames<f64>| -> Vec<[f64; 3]> { f.frame(0, 0).iter().map(|p| (*p).into()).collect() };
    let (skin, out) = (points(&body), points(&normals));
    let state =
        State::new(&positions).with_body(BodyState { positions: &body, normals: &normals, nearest: Some(&lanes) });
    let x = flat(&x);
    let single = SingleBody { positions: &skin, normals: &out, nearest: &nearest };
    let pose = Single { body: Some(single), ..Single::new(&x) };
    compare(&Gravity::new(&rest, gravity::EARTH), &state, &pose);
    let collision = Collision::new(&rest, &ContactOptions { margin: 0.02, ..ContactOptions::default() }).unwrap();
    compare(&collision, &state, &pose);
    let touches = collision.contacts(&state, 1.0).unwrap();
    for slip in [1e-4, 0.1] {
        let anchor = |t: &Touch| rest.template.vertices[t.vertex as usize] + Vec3::new(0.003, 0.001, 0.0);
        let friction = Friction::new(&touches, 40.0, slip, rest.vertex_count(), anchor).unwrap();
        compare(&friction, &state, &pose);
    }
    let attachment = Attachment::new(&rest, 1000.0);
    let targets: Vec<Vec3> = attachment.vertices().iter().map(|&v| rest.template.vertices[v as usize]).collect();
    let (targets, flat_targets) = (frame(&targets), flat(&targets));
    let held = Single { targets: Some(&flat_targets), ..pose };
    compare_held(&attachment, &State::new(&positions).with_targets(&targets), &held);
    // A body vertex that is not there.
    let beyond = vec![skin.len() as u32; nearest.len()];
    let single = SingleBody { nearest: &beyond, ..single };
    assert!(collision.add_single(&Single { body: Some(single), ..pose }, 1.0, None).is_err());
    assert!(collision.add_single(&Single::new(&x), 1.0, None).is_err());
    assert!(attachment.add_single(&Single::new(&x), 1.0, None).is_err());
}

/// Vertex 1 is held, so that [`compare`] finds its NaN.
fn compare_held(attachment: &Attachment<f64>, state: &State<'_, f64>, pose: &Single<'_>) {
    assert!(attachment.vertices().contains(&1));
    compare(attachment, state, pose);
}
