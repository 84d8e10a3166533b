//! What every state is asked.

use super::states::{EXTREMES, shaken};
use super::{cloth, constants, fabric, fabrics};
use caphy_core::lanes::Frames;
use caphy_core::material::{HingeLength, MaterialModel, MaterialReal};
use caphy_core::{Error, TriMesh, Vec3};
use caphy_garment::GarmentRest;
use caphy_garment::energy::*;
use caphy_garment::solver::{Dynamics, Forces, Scene, Solver, SolverSettings};
use std::sync::Arc;

/// Frames of three steps, the extreme last, so that inertia sees it; two windows.
fn steps<T: MaterialReal>(rest: &GarmentRest, positions: &[Vec3]) -> Frames<T> {
    let mut x = Frames::zeros(3, positions.len(), 2);
    for lane in 0..2 {
        x.set_frame(0, lane, &rest.template.vertices).expect("a frame");
        x.set_frame(1, lane, &shaken(&rest.template.vertices, 1e-3)).expect("a frame");
        x.set_frame(2, lane, positions).expect("a frame");
    }
    x
}

/// A body surface that the cloth cuts through: the garment lies inside of it in part.
fn body<T: MaterialReal>(steps: usize) -> (Frames<T>, Frames<T>) {
    let mesh = TriMesh {
        vertices: (0..36)
            .map(|v| Vec3::new(0.03 * f64::from(v % 6) - 0.02, 0.03 * f64::from(v / 6) - 0.02, 1e-3))
            .collect(),
        faces: (0..25)
            .flat_map(|q| {
                let a = (q / 5) * 6 + q % 5;
                [[a, a + 1, a + 7], [a, a + 7, a + 6]]
            })
            .collect(),
    };
    let mut x = Frames::zeros(steps, 36, 2);
    (0..2 * steps).for_each(|f| x.set_frame(f / 2, f % 2, &mesh.vertices).expect("a frame"));
    let normals = frame_normals(&x, &mesh.faces).expect("normals");
    (x, normals)
}

/// Everything but strain and bending, which need a fabric.
fn other_terms<T: MaterialReal>(rest: &GarmentRest, step: f64) -> Vec<Box<dyn EnergyTerm<T>>> {
    vec![
        Box::new(Gravity::new(rest, gravity::EARTH)),
        Box::new(Inertia::new(rest, step, InertiaRule::KnownVelocity).expect("inertia")),
        Box::new(Collision::new(rest, &ContactOptions::default()).expect("collision")),
        Box::new(Attachment::new(rest, 1000.0)),
        Box::new(Chamfer::new(rest, None).expect("the scan term")),
    ]
}

fn elastic_terms<T: MaterialReal>(
    rest: &GarmentRest,
    material: &Arc<dyn MaterialModel>,
) -> Vec<Box<dyn EnergyTerm<T>>> {
    vec![
        Box::new(Strain::new(rest, material.clone())),
        Box::new(Bending::new(rest, material.clone(), RestAngle::Template)),
    ]
}

/// Energy of the last step of the first window, and the gradient there.
fn evaluate<T: MaterialReal>(term: &dyn EnergyTerm<T>, x: &Frames<T>) -> Result<(f64, Vec<Vec3>), Error> {
    let (points, normals) = body::<T>(x.blocks());
    let held: Vec<Vec3> = cloth().template.vertices[..5].to_vec();
    let mut targets = Frames::zeros(x.blocks(), 5, 2);
    (0..2 * x.blocks()).for_each(|f| targets.set_frame(f / 2, f % 2, &held).expect("a frame"));
    let scan = ScanCloud::new("scan", &cloth().template.vertices).expect("a cloud");
    let scans = vec![&scan; x.frames()];
    let state = State::new(x)
        .with_body(BodyState { positions: &points, normals: &normals, nearest: None })
        .with_targets(&targets)
        .with_scans(&scans);
    let mut energy = vec![0.0; x.frames()];
    let mut gradient = Frames::zeros(x.blocks(), x.vertices(), x.lanes_used());
    term.add(&state, 1.0, &mut energy, Some(&mut gradient))?;
    let last = x.blocks() - 1;
    Ok((energy[2 * last], gradient.frame(last, 0)))
}

/// Whether the gradient along a direction is the energy's slope there, by differences over several steps: one that neither
/// rounds nor crosses a kink is enough.
fn slope_agrees(term: &dyn EnergyTerm<f64>, rest: &GarmentRest, positions: &[Vec3], name: &str) {
    let direction = shaken(&vec![Vec3::zeros(); positions.len()], 1.0);
    let strength = |gradient: &[Vec3]| gradient.iter().zip(&direction).map(|(g, d)| g.norm() * d.norm()).sum::<f64>();
    let (here, gradient) = evaluate(term, &steps(rest, positions)).expect(name);
    // Where forces vanish, those of a cloth that is a little out of shape say what is small.
    let usual = strength(&evaluate(term, &steps(rest, &shaken(&rest.template.vertices, 2e-3))).expect(name).1);
    let scale = strength(&gradient).max(usual);
    let expected: f64 = gradient.iter().zip(&direction).map(|(g, d)| g.dot(d)).sum();
    let largest = positions.iter().map(|p| p.norm()).fold(0.0, f64::max);
    let at = |h: f64| {
        let moved: Vec<Vec3> = positions.iter().zip(&direction).map(|(p, d)| p + d * h).collect();
        evaluate(term, &steps(rest, &moved)).expect(name).0
    };
    let mut said = Vec::new();
    for h in (5..13).map(|k| 10f64.powi(-k)) {
        let (plus, minus) = (at(h), at(-h));
        // Energies are rounded by some 1e-15 of themselves, and, as positions are, by that of the forces times the distance from the
        // origin. (h is itself rounded when it is added.)
        let noise = (1e-14 * here.abs().max(plus.abs()) + 4e-16 * largest * scale) / h;
        if noise > 0.02 * scale {
            continue;
        }
        for slope in [(plus - minus) / (2.0 * h), (plus - here) / h, (here - minus) / h] {
            if (slope - expected).abs() <= 2e-4 * scale + 2.0 * noise {
                return;
            }
            said.push(slope);
        }
    }
    panic!("{name}: the energy's slope is {said:?}, the gradient's {expected}, of {scale}");
}

#[test]
fn every_state_has_a_finite_answer_and_its_gradient() {
    let rest = cloth();
    for extreme in EXTREMES {
        let positions = (extreme.positions)(&rest.template.vertices);
        let (single, double) = (steps::<f32>(&rest, &positions), steps::<f64>(&rest, &positions));
        let finite = |name: &str, (energy, gradient): (f64, Vec<Vec3>)| {
            let all = energy.is_finite() && gradient.iter().all(|g| g.iter().all(|c| c.is_finite()));
            assert!(all, "{}: {name}: {energy} J", extreme.name);
        };
        for (which, material) in fabrics() {
            let name = format!("{}: {which}", extreme.name);
            for term in elastic_terms::<f32>(&rest, &material) {
                finite(&name, evaluate(&*term, &single).expect(&name));
            }
            let facts = material.describe();
            for term in elastic_terms::<f64>(&rest, &material) {
                finite(&name, evaluate(&*term, &double).expect(&name));
                // Held while differentiating: k of a frozen fabric, and the length of `current_held`.
                if !facts.stiffness_frozen && facts.hinge_length != HingeLength::CurrentHeld {
                    slope_agrees(&*term, &rest, &positions, &format!("{name}: {}", term.name()));
                }
            }
            let acted = GuardCounts::of(&rest, &*material, &single);
            let strains =
                facts.name == "neo_hookean" && extreme.name.contains("x1000") || extreme.name.contains("torn");
            assert!(extreme.guarded == (acted.needles > 0), "{name}: {acted:?}");
            assert!(strains || acted.strains == Some(0), "{name}: {acted:?}");
        }
        for step in [1e-4, 1.0 / 30.0, 1.0] {
            for term in other_terms::<f32>(&rest, step) {
                finite(term.name(), evaluate(&*term, &single).expect(extreme.name));
            }
            for term in other_terms::<f64>(&rest, step) {
                finite(term.name(), evaluate(&*term, &double).expect(extreme.name));
                let pairs_held = ["collision", "chamfer"].contains(&term.name());
                if !pairs_held {
                    slope_agrees(&*term, &rest, &positions, &format!("{}: {} at {step} s", extreme.name, term.name()));
                }
            }
        }
    }
}

#[test]
fn stiffness_from_a_thousandth_to_a_hundred_million() {
    let rest = cloth();
    for kind in ["stvk", "neo_hookean"] {
        for (lambda, mu, bending) in
            [(1e-3, 1e-3, 1e-12), (1e8, 1e8, 1e8), (1e-3, 1e8, 1e-3), (1e8, 1e-3, 0.0), (0.0, 1e8, 1e8)]
        {
            let material = fabric(&constants(kind, lambda, mu, bending, "current"));
            for extreme in EXTREMES {
                let positions = (extreme.positions)(&rest.template.vertices);
                let name = format!("{}: {kind} {lambda} {mu} {bending}", extreme.name);
                for term in elastic_terms::<f32>(&rest, &material) {
                    let (energy, gradient) = evaluate(&*term, &steps::<f32>(&rest, &positions)).expect(&name);
                    assert!(energy.is_finite() && gradient.iter().flatten().all(|c| c.is_finite()), "{name}");
                }
                for term in elastic_terms::<f64>(&rest, &material) {
                    slope_agrees(&*term, &rest, &positions, &format!("{name}: {}", term.name()));
                }
            }
        }
    }
}

#[test]
fn values_that_are_not_finite_are_named_with_vertex_step_and_window() {
    let rest = cloth();
    for value in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1e300] {
        let mut positions = rest.template.vertices.clone();
        positions[3].y = value;
        let refused = |term: &str, answer: Result<(f64, Vec<Vec3>), Error>| {
            let error = answer.err().unwrap_or_else(|| panic!("{term} takes {value}"));
            let text = error.to_string();
            assert!(matches!(error, Error::Numerics { .. }), "{term}: {text}");
            let place = ["step 2, window 0", "triangle", "edge", "vertex 3"].iter().any(|p| text.contains(p));
            assert!(place && text.contains("last good state"), "{term}: {text}");
        };
        for (_, material) in fabrics() {
            for term in elastic_terms::<f32>(&rest, &material) {
                refused(term.name(), evaluate(&*term, &steps::<f32>(&rest, &positions)));
            }
        }
        // 1e300 m is infinite in single precision alone; double precision may have an answer.
        for term in other_terms::<f32>(&rest, 0.1) {
            refused(term.name(), evaluate(&*term, &steps::<f32>(&rest, &positions)));
        }
    }
}

#[test]
fn time_steps_that_are_none_are_refused_everywhere() {
    let rest = cloth();
    let start = rest.template.vertices.clone();
    for step in [0.0, -0.1, f64::NAN, f64::INFINITY] {
        let named = |error: Error| assert!(error.to_string().contains("time step"), "{step}: {error}");
        for rule in [InertiaRule::KnownVelocity, InertiaRule::Faithful] {
            named(Inertia::<f32>::new(&rest, step, rule).err().expect("an error"));
            named(Inertia::<f64>::new(&rest, step, rule).err().expect("an error"));
        }
        named(Dynamics::new(start.clone(), None, step).expect_err("an error"));
    }
}

#[test]
fn garments_and_meshes_that_are_none_are_named() {
    let rest = cloth();
    let none = TriMesh { vertices: Vec::new(), faces: Vec::new() };
    // An empty garment is one without energy.
    if let Ok(empty) = GarmentRest::new("nothing", none, Vec::new(), rest.density, "none") {
        let x = Frames::<f64>::zeros(1, 0, 1);
        for term in elastic_terms::<f64>(&empty, &fabric(&constants("stvk", 20.0, 11.0, 1e-5, "rest"))) {
            let mut energy = [0.0];
            term.add(&State::new(&x), 1.0, &mut energy, None).expect("no energy");
            assert_eq!(energy, [0.0]);
        }
    }
    let build = |mesh: TriMesh, uv: Vec<[[f64; 2]; 3]>| GarmentRest::new("shirt", mesh, uv, rest.density, "test");
    let told = |mesh: TriMesh, uv: Vec<[[f64; 2]; 3]>, words: &[&str]| {
        let said = build(mesh, uv).expect_err(words[0]).to_string();
        assert!(words.iter().all(|w| said.contains(w)), "{words:?} is missing in: {said}");
    };
    let mut flat = rest.template.clone();
    flat.vertices[7] = flat.vertices[12];
    told(flat, rest.material_uv.clone(), &["face", "area", "shirt", "remove"]);
    let mut needle = rest.template.clone();
    needle.vertices[6] = 0.5 * (needle.vertices[5] + needle.vertices[7]) + Vec3::new(0.0, 1e-12, 0.0);
    needle.faces = vec![[5, 7, 6]];
    told(needle, rest.material_uv[..1].to_vec(), &["face 0", "area", "shirt"]);
    let mut three = rest.template.clone();
    three.faces.push([0, 6, 12]);
    let uv = [&rest.material_uv[..], &rest.material_uv[..1]].concat();
    told(three, uv, &["edge", "three or more faces", "shirt", "split"]);
    let mut nan = rest.template.clone();
    nan.vertices[3].x = f64::NAN;
    told(nan, rest.material_uv.clone(), &["shirt", "3"]);
    let mut beyond = rest.template.clone();
    beyond.faces[2][1] = 99;
    told(beyond, rest.material_uv.clone(), &["shirt", "99"]);
    assert!(matches!(ScanCloud::<f64>::new("scan-3", &[]), Err(Error::Mesh { .. })));
    // One point is a scan.
    assert!(ScanCloud::<f64>::new("scan-3", &[Vec3::zeros()]).is_ok());
}

#[test]
fn the_solver_ends_everywhere() {
    let rest = cloth();
    let settings = SolverSettings { iterations: 25, warm_steps: 40, guided_steps: 40, ..Default::default() };
    let tables = [
        constants("stvk", 20.9, 11.1, 4e-5, "rest"),
        constants("neo_hookean", 20.9, 11.1, 4e-5, "rest"),
        constants("stvk", 1e8, 1e8, 1e-9, "rest"),
        constants("stvk", 1e-3, 1e-3, 1e3, "rest"),
        "type = \"measured\"\nfabric = \"navy-sparkle-sweat\"".to_string(),
    ];
    for table in tables {
        let mut solver = Solver::new(&rest, fabric(&table), Forces::default(), settings).expect("a solver");
        let targets: Vec<Vec3> = rest.template.vertices[..5].to_vec();
        for extreme in EXTREMES {
            let start = (extreme.positions)(&rest.template.vertices);
            let scene = Scene { fixed: &[0, 4], targets: Some(&targets), ..Default::default() };
            let name = format!("{}: {table}", extreme.name);
            let solution = solver.solve(&scene, &start, &|_| ()).unwrap_or_else(|e| panic!("{name}: {e}"));
            assert!(solution.positions.iter().flatten().all(|c| c.is_finite()), "{name}");
            assert!(solution.report.residual_n.is_finite(), "{name}");
        }
        for step in [1e-4, 1.0] {
            let mut motion = Dynamics::new(shaken(&rest.template.vertices, 1e-3), None, step).expect("a motion");
            let scene = Scene { fixed: &[0, 4], targets: Some(&targets), ..Default::default() };
            for _ in 0..2 {
                let solution = motion.advance(&mut solver, &scene, None, &|_| ()).expect("a step");
                assert!(solution.positions.iter().flatten().all(|c| c.is_finite()), "{table} {step}");
            }
        }
    }
}
