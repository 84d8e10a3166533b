//! Derivatives through what lies behind the vertices (landmarks) and before the rotations (hands).

use crate::smplx::generated::{Layout, frames};
use caphy_bodymodel::smplx::{BodySmplx, HandMean, HandPose, SmplxOptions, load};
use caphy_core::body::{BodyModel, BodyParameters};
use caphy_core::{Error, Vec3};
use std::path::Path;

fn body() -> BodySmplx {
    let options =
        SmplxOptions { face_contour: true, extra_joints: [("nose".to_string(), 4)].into(), ..SmplxOptions::default() };
    let layout = Layout { columns: 20, ..Layout::smplx(300) };
    load(Path::new("generated.npz"), layout.file().stored(), &options).unwrap()
}

/// Fourth-order central difference; truncation and rounding are both below 1e-10 for values of order 10.
fn slope(f: impl Fn(f64) -> f64) -> f64 {
    let h = 1e-3;
    (8.0 * (f(h) - f(-h)) - (f(2.0 * h) - f(-2.0 * h))) / (12.0 * h)
}

fn direction(i: usize) -> Vec3 {
    Vec3::new((i as f64).sin(), (i as f64 * 1.7).cos(), (i as f64 * 0.3).sin())
}

#[test]
fn gradients_go_through_landmarks() {
    let body = body();
    let mut p = frames(55, 1).remove(0);
    // The head looks 12.2° to the side, in the middle of a row of the contour and well away from the next.
    for j in [0, 3, 6, 9, 12] {
        p.rotations[j] = Vec3::zeros();
    }
    p.rotations[12].y = 12.2f64.to_radians();
    assert_eq!(body.landmark_names().len(), 1 + 51 + 17);
    let loss = |p: &BodyParameters| -> f64 {
        let vertices = body.forward(p).unwrap().vertices;
        let points = body.landmarks(&p.rotations).unwrap();
        points.iter().enumerate().map(|(i, point)| point.on(&vertices).dot(&direction(i))).sum()
    };
    let mut cotangents = vec![Vec3::zeros(); 300];
    for (i, point) in body.landmarks(&p.rotations).unwrap().iter().enumerate() {
        point.pull_back(&direction(i), &mut cotangents);
    }
    let g = body.vjp(&p, &cotangents, &[]).unwrap();
    let close = |what: &str, exact: f64, change: &dyn Fn(&mut BodyParameters, f64)| {
        let numeric = slope(|h| {
            let mut q = p.clone();
            change(&mut q, h);
            loss(&q)
        });
        assert!((numeric - exact).abs() < 1e-7, "{what}: {exact} instead of {numeric}");
    };
    for k in 0..3 {
        close("shape", g.shape[k], &|q, h| q.shape[k] += h);
        close("translation", g.translation[k], &|q, h| q.translation[k] += h);
        for j in [0, 12, 15, 20, 54] {
            close("rotation", g.rotations[j][k], &|q, h| q.rotations[j][k] += h);
        }
    }
}

/// The same surface points in all poses but for the contour, which follows the head and not the arms.
#[test]
fn the_contour_slides_as_the_head_turns() {
    let body = body();
    let mut turned = vec![Vec3::zeros(); 55];
    let rest = body.landmarks(&turned).unwrap();
    turned[16] = Vec3::new(0.0, 1.0, 0.0);
    assert_eq!(body.landmarks(&turned).unwrap(), rest);
    turned[6] = Vec3::new(0.0, -0.2, 0.0);
    turned[0] = Vec3::new(0.0, -0.1, 0.0);
    let side = body.landmarks(&turned).unwrap();
    assert_eq!(side[..52], rest[..52]);
    // 0.3 rad are 17.2°: the contour's row 17.
    let file = Layout { columns: 20, ..Layout::smplx(300) }.file();
    let ids = crate::smplx::oracle::values(&file.arrays["dynamic_lmk_faces_idx"]);
    let faces = crate::smplx::oracle::values(&file.arrays["f"]);
    for (i, point) in side[52..].iter().enumerate() {
        let face = ids[17 * 17 + i] as usize;
        assert_eq!(point.vertices, [0, 1, 2].map(|k| faces[3 * face + k] as u32), "contour point {i}");
    }
    assert!(matches!(body.landmarks(&turned[1..]), Err(Error::Length { .. })));
    turned[3].x = f64::NAN;
    assert!(matches!(body.landmarks(&turned), Err(Error::NonFinite { .. })));
}

#[test]
fn gradients_go_through_hand_coefficients() {
    let body = body();
    let base = frames(55, 1).remove(0);
    let coefficients = [0.4, -0.8, 0.2, 0.1, -0.3, 0.6];
    let posed = |c: &[f64]| {
        let mut p = base.clone();
        body.set_hands([HandPose::Coefficients(c), HandPose::Coefficients(&[])], HandMean::Added, &mut p.rotations)
            .unwrap();
        p
    };
    let p = posed(&coefficients);
    let cotangents: Vec<Vec3> = (0..300).map(direction).collect();
    let g = body.vjp(&p, &cotangents, &[]).unwrap();
    let left = &body.hands().unwrap()[0];
    let exact = left.pull_back(&g.rotations, coefficients.len()).unwrap();
    for k in 0..coefficients.len() {
        let numeric = slope(|h| {
            let mut c = coefficients;
            c[k] += h;
            body.forward(&posed(&c)).unwrap().vertices.iter().zip(&cotangents).map(|(v, g)| v.dot(g)).sum()
        });
        assert!((numeric - exact[k]).abs() < 1e-7, "coefficient {k}: {} instead of {numeric}", exact[k]);
    }
}

#[test]
fn hand_poses_that_do_not_fit_are_refused() {
    let body = body();
    let [left, _] = body.hands().unwrap();
    assert_eq!((left.count(), left.joints().len(), left.joints()[0]), (45, 15, 25));
    let wrong = left.rotations(HandPose::Coefficients(&[0.0; 46]), HandMean::Flat);
    assert!(matches!(wrong, Err(Error::Length { expected: 45, got: 46, .. })));
    let wrong = left.rotations(HandPose::Coefficients(&[0.0, f64::NAN]), HandMean::Flat);
    assert!(matches!(wrong, Err(Error::NonFinite { index: 1, .. })));
    assert!(left.rotations(HandPose::Rotations(&[Vec3::zeros(); 14]), HandMean::Flat).is_err());
    assert!(left.pull_back(&[Vec3::zeros(); 55], 46).is_err() && left.pull_back(&[Vec3::zeros(); 30], 1).is_err());
    let none = HandPose::Coefficients(&[]);
    assert!(body.set_hands([none; 2], HandMean::Flat, &mut [Vec3::zeros(); 54]).is_err());
    let mut file = Layout { columns: 20, ..Layout::smplx(300) }.file();
    file.arrays.remove("hands_componentsr");
    let bare = load(Path::new("generated.npz"), file.stored(), &SmplxOptions::default()).unwrap();
    assert!(bare.hands().is_none());
    let refused = bare.set_hands([none; 2], HandMean::Flat, &mut [Vec3::zeros(); 55]);
    assert!(matches!(refused, Err(Error::Unsupported { .. })));
}
