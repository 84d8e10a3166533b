//! Derivatives, batches and bad input of a body in the SMPL-X layout, on a small generated model.

use caphy_bodymodel::smplx::{BodySmplx, SmplxArrays};
use caphy_core::body::{BlendWeights, BodyModel, BodyParameters, BodySpec, Joint};
use caphy_core::lanes::Frames;
use caphy_core::{Error, Vec3};
use nalgebra::Rotation3;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

const VERTICES: usize = 1100; // more than two parallel chunks
const PARENTS: [Option<usize>; 6] = [None, Some(0), Some(1), Some(0), Some(3), Some(1)];

fn vector(rng: &mut ChaCha8Rng, size: f64) -> Vec3 {
    Vec3::from_fn(|_, _| size * (2.0 * rng.random::<f64>() - 1.0))
}

fn arrays(seed: u64) -> SmplxArrays {
    let rng = &mut ChaCha8Rng::seed_from_u64(seed);
    let mut field = |size: f64| -> Vec<Vec3> { (0..VERTICES).map(|_| vector(rng, size)).collect() };
    let template = field(0.8);
    let shape_directions = (0..4).map(|_| field(0.03)).collect();
    let expression_directions = (0..2).map(|_| field(0.01)).collect();
    let pose_directions = (0..VERTICES * 3 * 9 * 5)
        // The third joint has no correctives: it must be dropped without a trace.
        .map(|i| if (i / 9) % 5 == 2 { 0.0 } else { (0.02 * (rng.random::<f64>() - 0.5)) as f32 })
        .collect();
    let joint_regressor = (0..6)
        .map(|_| {
            let raw: Vec<f64> = (0..5).map(|_| rng.random::<f64>() - 0.1).collect();
            let sum: f64 = raw.iter().sum();
            raw.iter().map(|w| (rng.random_range(0..VERTICES as u32), w / sum)).collect()
        })
        .collect();
    let weights = BlendWeights::from_rows((0..VERTICES).map(|v| {
        let a = rng.random::<f64>();
        vec![((v % 6) as u16, a), (((v + 2) % 6) as u16, 1.0 - a)]
    }));
    let joints = PARENTS.iter().enumerate().map(|(j, &parent)| Joint { name: format!("joint{j}"), parent }).collect();
    let faces = (0..VERTICES as u32 - 2).map(|v| [v, v + 1, v + 2]).collect();
    SmplxArrays {
        name: "generated".into(),
        template,
        faces,
        shape_directions,
        expression_directions,
        pose_directions,
        joint_regressor,
        weights,
        joints,
    }
}

fn body() -> BodySmplx {
    BodySmplx::new(arrays(1)).unwrap()
}

fn parameters(seed: u64, angle: f64) -> BodyParameters {
    let rng = &mut ChaCha8Rng::seed_from_u64(seed);
    BodyParameters {
        shape: (0..3).map(|_| 2.0 * rng.random::<f64>() - 1.0).collect(),
        expression: (0..2).map(|_| 2.0 * rng.random::<f64>() - 1.0).collect(),
        rotations: (0..6).map(|_| vector(rng, angle)).collect(),
        translation: vector(rng, 1.0),
        displacement: (0..VERTICES).map(|_| vector(rng, 0.01)).collect(),
    }
}

/// Fourth-order central difference of `f` along a change of parameters. At h = 1e-3 truncation is about 1e-12 and
/// rounding about 1e-13 relative to values of order 1e2.
fn slope(f: impl Fn(f64) -> f64) -> f64 {
    let h = 1e-3;
    (8.0 * (f(h) - f(-h)) - (f(2.0 * h) - f(-2.0 * h))) / (12.0 * h)
}

fn scalar(body: &BodySmplx, p: &BodyParameters, gv: &[Vec3], gj: &[Vec3]) -> f64 {
    let posed = body.forward(p).unwrap();
    let vertices: f64 = posed.vertices.iter().zip(gv).map(|(v, g)| v.dot(g)).sum();
    let joints: f64 = posed.joints.iter().zip(gj).map(|(j, g)| j.dot(g)).sum();
    vertices + joints
}

#[test]
fn vjp_equals_finite_differences_also_at_zero_rotation() {
    let body = body();
    // `exactly`: every joint turns by just this angle, about an axis of its own.
    let half = std::f64::consts::PI;
    let turns = [half, half - 1e-6, half + 1e-3, 2.0 * half].map(|angle| (12, angle, true));
    for (seed, angle, exactly) in [0.0, 1e-5, 0.7, 1.8].map(|angle| (2, angle, false)).into_iter().chain(turns) {
        let mut p = parameters(seed, angle);
        if exactly {
            p.rotations.iter_mut().for_each(|r| *r = r.normalize() * angle);
        }
        let rng = &mut ChaCha8Rng::seed_from_u64(seed + 100);
        let gv: Vec<Vec3> = (0..VERTICES).map(|_| vector(rng, 1.0) / VERTICES as f64).collect();
        let gj: Vec<Vec3> = (0..6).map(|_| vector(rng, 1.0)).collect();
        let g = body.vjp(&p, &gv, &gj).unwrap();
        let close = |what: &str, exact: f64, change: &dyn Fn(&mut BodyParameters, f64)| {
            let numeric = slope(|h| {
                let mut q = p.clone();
                change(&mut q, h);
                scalar(&body, &q, &gv, &gj)
            });
            assert!((numeric - exact).abs() < 1e-9, "angle {angle}, {what}: {exact} against {numeric}");
        };
        for k in 0..3 {
            close(&format!("shape {k}"), g.shape[k], &|q, h| q.shape[k] += h);
            close(&format!("translation {k}"), g.translation[k], &|q, h| q.translation[k] += h);
            for j in 0..6 {
                close(&format!("rotation {j}.{k}"), g.rotations[j][k], &|q, h| q.rotations[j][k] += h);
            }
            for v in [0, 511, 512, 1099] {
                close(&format!("dT {v}.{k}"), g.displacement[v][k], &|q, h| q.displacement[v][k] += h);
            }
        }
        for k in 0..2 {
            close(&format!("expression {k}"), g.expression[k], &|q, h| q.expression[k] += h);
        }
    }
}

#[test]
fn vjp_of_joints_alone_needs_no_vertices() {
    let body = body();
    let p = parameters(6, 0.9);
    let gj: Vec<Vec3> = (0..6).map(|j| Vec3::new(1.0, -0.5, 0.1 * j as f64)).collect();
    let short = body.vjp(&p, &[], &gj).unwrap();
    let long = body.vjp(&p, &vec![Vec3::zeros(); VERTICES], &gj).unwrap();
    assert_eq!(short, long);
}

#[test]
fn jacobian_equals_one_vjp_per_row() {
    /// The trait's own way, one vector-Jacobian product per row.
    struct Plain(BodySmplx);
    impl BodyModel for Plain {
        fn describe(&self) -> &caphy_core::body::BodyDescription {
            self.0.describe()
        }
        fn forward(&self, p: &BodyParameters) -> caphy_core::Result<caphy_core::body::PosedBody> {
            self.0.forward(p)
        }
        fn vjp(
            &self,
            p: &BodyParameters,
            gv: &[Vec3],
            gj: &[Vec3],
        ) -> caphy_core::Result<caphy_core::body::BodyGradient> {
            self.0.vjp(p, gv, gj)
        }
    }
    let subset = [0, 17, 512, 1099];
    for (seed, angle) in [(7, 0.0), (8, 1.3)] {
        let p = parameters(seed, angle);
        let fast = body().jacobian(&p, &subset).unwrap();
        let slow = Plain(body()).jacobian(&p, &subset).unwrap();
        assert_eq!(fast.shape(), (12, 3 + 18 + 3));
        assert!((fast - slow).amax() < 1e-12);
    }
}

#[test]
fn batches_equal_single_poses() {
    let body = body();
    let mut frames: Vec<BodyParameters> = (0..6).map(|i| parameters(20 + i, 0.4 * i as f64)).collect();
    let subset: Vec<u32> = (0..VERTICES as u32).rev().step_by(2).collect();
    for shared_shape in [false, true] {
        if shared_shape {
            let first = frames[0].clone();
            for f in &mut frames {
                (f.shape, f.expression) = (first.shape.clone(), first.expression.clone());
                f.displacement.clear();
            }
        }
        for subset in [None, Some(subset.as_slice())] {
            let count = subset.map_or(VERTICES, |s| s.len());
            let mut out = Frames::<f32>::zeros(2, count, 3);
            body.forward_frames(&frames, subset, &mut out).unwrap();
            for (i, p) in frames.iter().enumerate() {
                let posed = body.forward(p).unwrap();
                for (k, got) in out.frame(i / 3, i % 3).iter().enumerate() {
                    let id = subset.map_or(k, |s| s[k] as usize);
                    // Coordinates below 4 m in f32: about ten roundings of 2.4e-7 m.
                    assert!((got - posed.vertices[id]).amax() < 2.5e-6, "frame {i}, vertex {id}");
                }
                assert_eq!(out.get(i / 3, 15, 0), out.get(i / 3, 2, 0), "spare lanes repeat the last");
            }
        }
    }
}

#[test]
fn batches_are_the_same_bits_on_any_number_of_threads() {
    let body = body();
    let frames: Vec<BodyParameters> = (0..4).map(|i| parameters(30 + i, 1.0)).collect();
    let on = |threads: usize| {
        rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(|| {
            let mut out = Frames::<f32>::zeros(1, VERTICES, 4);
            body.forward_frames(&frames, None, &mut out).unwrap();
            let g = body.vjp(&frames[0], &vec![Vec3::new(0.1, 0.2, 0.3); VERTICES], &[]).unwrap();
            (out, g)
        })
    };
    assert_eq!(on(1), on(3));
}

#[test]
fn rest_is_the_shaped_template_and_the_root_turns_everything_about_its_joint() {
    let body = body();
    let shape = [0.5, -1.0];
    let rest = body.forward(&BodyParameters::rest(6, &shape)).unwrap();
    let shaped = body.shaped(&shape, &[]).unwrap();
    for (a, b) in rest.vertices.iter().zip(&shaped) {
        assert!((a - b).norm() < 1e-14);
    }
    let mut p = parameters(9, 0.8);
    let before = body.forward(&p).unwrap();
    let turn = Vec3::new(0.3, 1.1, -0.4);
    let old = Rotation3::from_scaled_axis(p.rotations[0]);
    let rotation = Rotation3::from_scaled_axis(turn);
    p.rotations[0] = (rotation * old).scaled_axis();
    let after = body.forward(&p).unwrap();
    let pivot = before.joints[0];
    assert!((after.joints[0] - pivot).norm() < 1e-12);
    for (a, b) in after.vertices.iter().zip(&before.vertices) {
        assert!((a - (rotation * (b - pivot) + pivot)).norm() < 1e-12);
    }
}

#[test]
fn extreme_rotations_stay_finite() {
    let mut p = parameters(10, 1.0);
    for r in [std::f64::consts::PI, 1e-300, 1e8] {
        p.rotations.fill(Vec3::new(r, 0.0, 0.0));
        assert!(body().forward(&p).unwrap().vertices.iter().all(|v| v.iter().all(|c| c.is_finite())));
        let g = body().vjp(&p, &vec![Vec3::x(); VERTICES], &[]).unwrap();
        assert!(g.rotations.iter().all(|v| v.iter().all(|c| c.is_finite())));
    }
}

#[test]
fn bad_parameters_are_refused_with_their_name() {
    let body = body();
    let good = parameters(11, 0.5);
    let refuse = |change: &dyn Fn(&mut BodyParameters)| {
        let mut p = good.clone();
        change(&mut p);
        let error = body.forward(&p).unwrap_err();
        assert!(body.vjp(&p, &[], &[]).is_err() && body.jacobian(&p, &[0]).is_err());
        let mut out = Frames::<f32>::zeros(1, VERTICES, 1);
        assert!(body.forward_frames(std::slice::from_ref(&p), None, &mut out).is_err());
        error
    };
    assert!(matches!(refuse(&|p| p.shape = vec![0.0; 5]), Error::Length { expected: 4, got: 5, .. }));
    assert!(matches!(refuse(&|p| p.expression[1] = f64::NAN), Error::NonFinite { index: 1, .. }));
    assert!(refuse(&|p| p.rotations[3].y = f64::INFINITY).to_string().contains("joint3"));
    assert!(matches!(refuse(&|p| p.rotations.truncate(2)), Error::Length { expected: 6, got: 2, .. }));
    assert!(matches!(refuse(&|p| p.displacement.truncate(2)), Error::Length { .. }));
    assert!(matches!(refuse(&|p| p.translation.x = f64::NAN), Error::NonFinite { .. }));
    assert!(body.jacobian(&good, &[VERTICES as u32]).is_err());
    assert!(body.vjp(&good, &[Vec3::zeros()], &[]).is_err());
}

#[test]
fn bad_models_are_refused_with_the_place() {
    let refuse = |change: &dyn Fn(&mut SmplxArrays)| {
        let mut a = arrays(1);
        change(&mut a);
        BodySmplx::new(a).unwrap_err().to_string()
    };
    assert!(refuse(&|a| a.template.clear()).contains("0 vertices"));
    assert!(refuse(&|a| a.template[7].x = f64::NAN).contains("vertex 7"));
    assert!(refuse(&|a| a.faces[3] = [0, 1, 5000]).contains("face 3"));
    assert!(refuse(&|a| a.weights.weights[0] += 0.5).contains("vertex 0"));
    assert!(refuse(&|a| a.weights.joints[0] = 77).contains("vertex 0"));
    assert!(refuse(&|a| a.joints[2].parent = Some(4)).contains("joint 2"));
    assert!(refuse(&|a| a.joint_regressor[1][0].0 = 9999).contains("joint1"));
    assert!(refuse(&|a| a.pose_directions.truncate(9)).contains("pose directions"));
    assert!(refuse(&|a| a.shape_directions[2].truncate(9)).contains("shape direction 2"));
}

#[test]
fn the_configuration_names_its_keys() {
    let spec: Box<dyn BodySpec> = toml::from_str("type = \"smplx\"\npath = \"nowhere.npz\"").unwrap();
    let Err(error) = spec.build(&caphy_core::files::Disk) else { panic!("a missing file was read") };
    assert!(error.to_string().contains("nowhere.npz"), "{error}");
    let wrong = "type = \"smplx\"\npath = \"x.npz\"\nshape_coeficients = 3";
    let error = toml::from_str::<Box<dyn BodySpec>>(wrong).unwrap_err().to_string();
    assert!(error.contains("shape_coeficients") && error.contains("shape_coefficients"), "{error}");
}
