//! Garment skinning: against the body's own blend, its vector-Jacobian product, weights.

use caphy_core::body::BlendWeights;
use caphy_core::lanes::Frames;
use caphy_core::{Real, Vec3};
use caphy_garment::skinning::{Skinner, WeightOptions, garment_weights, nearest_weights, smoothed_weights};
use nalgebra::{Isometry3, Matrix3x4};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

const BLOCKS: usize = 2;
const WINDOWS: usize = 3;

struct Case {
    template: Vec<Vec3>,
    weights: BlendWeights,
    transforms: Vec<Vec<Matrix3x4<f64>>>,
    displacement: Vec<f64>,
}

fn case() -> Case {
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    let mut point = || Vec3::from_fn(|_, _| rng.random_range(-1.0..1.0));
    let template: Vec<Vec3> = (0..37).map(|_| point()).collect();
    let transforms = (0..BLOCKS * WINDOWS)
        .map(|_| {
            (0..9)
                .map(|_| Isometry3::new(point(), point() * 3.0).to_homogeneous().fixed_rows::<3>(0).into_owned())
                .collect()
        })
        .collect();
    let displacement = (0..BLOCKS * WINDOWS * 37).flat_map(|_| (point() * 0.05).data.0[0]).collect();
    // Joint 0 and 5 move nothing.
    let weights = BlendWeights::from_rows((0..37).map(|v| match v % 3 {
        0 => vec![(8u16, 1.0)],
        1 => vec![(1, 0.25), (4, 0.75)],
        _ => vec![(2, 0.2), (3, 0.3), (6, 0.1), (7, 0.4)],
    }));
    Case { template, weights, transforms, displacement }
}

fn views(case: &Case) -> Vec<&[Matrix3x4<f64>]> {
    case.transforms.iter().map(Vec::as_slice).collect()
}

fn forward_agrees<T: Real>(tolerance: f64) {
    let case = case();
    let skinner = Skinner::<T>::new(&case.template, &case.weights).unwrap();
    assert_eq!(skinner.joints(), [1, 2, 3, 4, 6, 7, 8]);
    let joints = skinner.joint_frames(&views(&case), WINDOWS).unwrap();
    let dv: Vec<T> = case.displacement.iter().map(|d| T::of(*d)).collect();
    let mut out = Frames::zeros(BLOCKS, 37, WINDOWS);
    skinner.forward(&joints, Some(&dv), &mut out).unwrap();
    for frame in 0..BLOCKS * WINDOWS {
        for v in 0..37 {
            let d = Vec3::from_column_slice(&case.displacement[(frame * 37 + v) * 3..][..3]);
            let expected = case.weights.blend(v, &case.transforms[frame]) * (case.template[v] + d).push(1.0);
            let got = out.get(frame / WINDOWS, frame % WINDOWS, v);
            assert!((got - expected).norm() < tolerance, "frame {frame} vertex {v}: {got} {expected}");
        }
    }
    // Spare lanes repeat the last window.
    assert_eq!(out.data()[WINDOWS - 1], out.data()[T::LANES - 1]);
    // A selection gives the same points; without dV it is the skinned template.
    let chosen = skinner.select(&[5, 30, 1]).unwrap();
    let mut some = Frames::zeros(BLOCKS, 3, WINDOWS);
    chosen.forward(&joints, None, &mut some).unwrap();
    let mut all = Frames::zeros(BLOCKS, 37, WINDOWS);
    skinner.forward(&joints, None, &mut all).unwrap();
    assert_eq!(some.get(1, 2, 1), all.get(1, 2, 30));
    assert!(skinner.select(&[37]).is_err());
}

#[test]
fn forward_is_the_blend_of_the_body() {
    forward_agrees::<f64>(1e-13);
    forward_agrees::<f32>(3e-6);
}

#[test]
fn the_product_with_the_jacobian_is_its_transpose() {
    // The forward pass is affine in dV: <g, forward(d) − forward(0)> = <vjp(g), d> exactly.
    let case = case();
    let skinner = Skinner::<f64>::new(&case.template, &case.weights).unwrap();
    let joints = skinner.joint_frames(&views(&case), WINDOWS).unwrap();
    let (mut with, mut without) = (Frames::zeros(BLOCKS, 37, WINDOWS), Frames::zeros(BLOCKS, 37, WINDOWS));
    skinner.forward(&joints, Some(&case.displacement), &mut with).unwrap();
    skinner.forward(&joints, None, &mut without).unwrap();
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let mut g = Frames::zeros(BLOCKS, 37, WINDOWS);
    let mut left = 0.0;
    for frame in 0..BLOCKS * WINDOWS {
        let (b, l) = (frame / WINDOWS, frame % WINDOWS);
        for v in 0..37 {
            let cotangent = Vec3::from_fn(|_, _| rng.random_range(-1.0..1.0));
            g.set(b, l, v, &cotangent);
            left += cotangent.dot(&(with.get(b, l, v) - without.get(b, l, v)));
        }
    }
    let mut back = vec![f64::NAN; case.displacement.len()];
    skinner.vjp(&joints, &g, &mut back).unwrap();
    let right: f64 = back.iter().zip(&case.displacement).map(|(a, b)| a * b).sum();
    assert!((left - right).abs() < 1e-12 * left.abs(), "{left} {right}");
}

/// More vertices than a thread takes in a row and than a tile holds, checked against the same vertices in small pieces; and a
/// single pose, and scaled displacements.
#[test]
fn large_garments_pieces_and_single_poses_give_the_same_bits() {
    let case = case();
    let count = 1100;
    let template: Vec<Vec3> = (0..count).map(|v| case.template[v % 37] * (1.0 + v as f64 * 1e-3)).collect();
    let weights =
        BlendWeights::from_rows((0..count).map(|v| case.weights.row(v % 37).map(|(j, w)| (j as u16, w)).collect()));
    let skinner = Skinner::<f32>::new(&template, &weights).unwrap();
    let joints = skinner.joint_frames(&views(&case), WINDOWS).unwrap();
    let mut rng = ChaCha8Rng::seed_from_u64(11);
    let mut random = |n: usize| -> Vec<f32> { (0..n).map(|_| rng.random_range(-1.0..1.0)).collect() };
    let scale = 0.03;
    let dv = random(BLOCKS * WINDOWS * 3 * count);
    let scaled: Vec<f32> = dv.iter().map(|d| scale * d).collect();
    let mut all = Frames::zeros(BLOCKS, count, WINDOWS);
    skinner.forward_scaled(&joints, Some(&dv), scale, &mut all).unwrap();
    let mut same = all.clone();
    skinner.forward(&joints, Some(&scaled), &mut same).unwrap();
    assert!(all == same);
    let mut upstream = Frames::zeros(BLOCKS, count, WINDOWS);
    let cotangents = random(upstream.data().len());
    upstream.data_mut().copy_from_slice(&cotangents);
    let mut back = vec![f32::NAN; dv.len()];
    skinner.vjp_scaled(&joints, &upstream, scale, &mut back).unwrap();
    let mut unscaled = vec![f32::NAN; dv.len()];
    skinner.vjp(&joints, &upstream, &mut unscaled).unwrap();
    assert!(back.iter().zip(&unscaled).all(|(a, b)| *a == scale * b));
    for first in (0..count).step_by(13) {
        let vertices: Vec<u32> = (first as u32..count as u32).take(13).collect();
        let n = vertices.len();
        let piece = skinner.select(&vertices).unwrap();
        let cut = |values: &[f32]| -> Vec<f32> {
            values.chunks_exact(3 * count).flat_map(|row| row[3 * first..3 * (first + n)].to_vec()).collect()
        };
        let mut some = Frames::zeros(BLOCKS, n, WINDOWS);
        piece.forward(&joints, Some(&cut(&scaled)), &mut some).unwrap();
        let mut some_upstream = Frames::zeros(BLOCKS, n, WINDOWS);
        for block in 0..BLOCKS {
            let width = 3 * <f32 as Real>::LANES;
            assert_eq!(some.block(block), &all.block(block)[first * width..][..n * width]);
            some_upstream.block_mut(block).copy_from_slice(&upstream.block(block)[first * width..][..n * width]);
        }
        let mut some_back = vec![f32::NAN; BLOCKS * WINDOWS * 3 * n];
        piece.vjp(&joints, &some_upstream, &mut some_back).unwrap();
        assert_eq!(some_back, cut(&unscaled));
    }
    for frame in 0..BLOCKS * WINDOWS {
        let mut posed = Vec::new();
        skinner.pose(&case.transforms[frame], &dv[frame * 3 * count..][..3 * count], scale, &mut posed).unwrap();
        for (v, p) in posed.iter().enumerate() {
            let expected = all.get(frame / WINDOWS, frame % WINDOWS, v);
            assert_eq!(p.map(f64::from), [expected.x, expected.y, expected.z]);
        }
        assert!(skinner.pose(&case.transforms[frame][..8], &dv[..3 * count], scale, &mut posed).is_err());
        assert!(skinner.pose(&case.transforms[frame], &dv[..3], scale, &mut posed).is_err());
    }
}

#[test]
fn threads_do_not_change_bits_and_wrong_shapes_are_refused() {
    let case = case();
    let skinner = Skinner::<f32>::new(&case.template, &case.weights).unwrap();
    let joints = skinner.joint_frames(&views(&case), WINDOWS).unwrap();
    let dv: Vec<f32> = case.displacement.iter().map(|d| *d as f32).collect();
    let run = |threads: usize| {
        rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(|| {
            let mut out = Frames::zeros(BLOCKS, 37, WINDOWS);
            skinner.forward(&joints, Some(&dv), &mut out).unwrap();
            out
        })
    };
    assert!(run(1) == run(2));
    let mut out = Frames::zeros(BLOCKS, 37, WINDOWS);
    assert!(skinner.forward(&joints, Some(&dv[1..]), &mut out).is_err());
    assert!(skinner.forward(&joints, None, &mut Frames::zeros(BLOCKS, 36, WINDOWS)).is_err());
    assert!(skinner.vjp(&joints, &out, &mut [0.0; 4]).is_err());
    assert!(skinner.joint_frames(&views(&case), 17).is_err());
    assert!(skinner.joint_frames(&views(&case), 4).is_err());
    assert!(skinner.joint_frames(&[&case.transforms[0][..3]], 1).is_err());
    assert!(Skinner::<f32>::new(&case.template[1..], &case.weights).is_err());
}

#[test]
fn smoothing_keeps_sums_and_softens_a_jump() {
    // A strip of 2 x 20 whose body halves belong to different joints.
    let template: Vec<Vec3> = (0..40).map(|i| Vec3::new((i / 2) as f64 * 0.01, (i % 2) as f64 * 0.01, 0.0)).collect();
    let faces: Vec<[u32; 3]> =
        (0..19).flat_map(|i| [[2 * i, 2 * i + 1, 2 * i + 2], [2 * i + 2, 2 * i + 1, 2 * i + 3]]).collect();
    let body: Vec<Vec3> = template.iter().map(|p| p + Vec3::new(0.001, 0.0, 0.005)).collect();
    let rows = (0..40).map(|i| vec![(if i < 20 { 4u16 } else { 9 }, 1.0)]);
    let body_weights = BlendWeights::from_rows(rows);
    let hard = nearest_weights(&template, &body, &body_weights).unwrap();
    assert_eq!(hard, body_weights);
    let weights = |options: &WeightOptions| garment_weights(&template, &faces, &body, &body_weights, options);
    assert_eq!(weights(&WeightOptions::nearest()).unwrap(), hard);
    let soft = weights(&WeightOptions { smoothing_m: 0.035, ..Default::default() }).unwrap();
    let share = |v: usize| soft.row(v).find(|e| e.0 == 9).map_or(0.0, |e| e.1);
    for v in 0..40 {
        assert!((soft.row(v).map(|e| e.1).sum::<f64>() - 1.0).abs() < 1e-12);
    }
    for v in 0..38 {
        assert!(share(v + 2) >= share(v) && share(v + 2) - share(v) < 0.2, "{v}");
    }
    assert!(share(0) < 0.2 && share(39) > 0.8);
    assert!(nearest_weights(&template, &[], &BlendWeights::from_rows([])).is_err());
    assert!(nearest_weights(&template, &body[1..], &body_weights).is_err());
    let default = WeightOptions::default();
    assert!(smoothed_weights(&hard, &template, &[[0, 1, 40]], &default).is_err());
    assert!(smoothed_weights(&hard, &template[1..], &faces, &default).is_err());
    for smoothing_m in [-0.1, 0.6, f64::NAN] {
        assert!(weights(&WeightOptions { smoothing_m, ..default }).unwrap_err().to_string().contains("smoothing"));
    }
    assert!(weights(&WeightOptions { joints: 0, ..default }).is_err());
    // Without faces there is nothing to smooth over.
    assert_eq!(smoothed_weights(&hard, &template, &[], &default).unwrap(), hard);
}

#[test]
fn smoothing_means_the_same_at_every_resolution() {
    // A sheet of equilateral triangles, 0.6 × 0.3 m; the left half belongs to joint 0, the right one to joint 1. Smoothing a
    // step with standard deviation σ gives the normal distribution's sum: 84.1 % at σ.
    let shares = |edge: f64| {
        let (columns, rows) = ((0.6 / edge) as usize, (0.3 / (edge * 0.75f64.sqrt())) as usize);
        let mut points = Vec::new();
        for j in 0..rows {
            for i in 0..columns {
                let x = edge * (i as f64 + 0.5 * (j % 2) as f64) - 0.3;
                points.push(Vec3::new(x, edge * 0.75f64.sqrt() * j as f64, 0.0));
            }
        }
        let mut faces = Vec::new();
        for j in 0..rows as u32 - 1 {
            for i in 0..columns as u32 - 1 {
                let p = j * columns as u32 + i;
                let q = p + columns as u32;
                faces.extend(if j % 2 == 0 {
                    [[p, p + 1, q], [p + 1, q + 1, q]]
                } else {
                    [[p, p + 1, q + 1], [p, q + 1, q]]
                });
            }
        }
        let hard = BlendWeights::from_rows(points.iter().map(|p| vec![(u16::from(p.x > 0.0), 1.0)]));
        let options = WeightOptions { smoothing_m: 0.05, ..Default::default() };
        let soft = smoothed_weights(&hard, &points, &faces, &options).unwrap();
        let row = rows / 2 * columns;
        let share = |v: usize| soft.row(v).find(|e| e.0 == 1).map_or(0.0, |e| e.1);
        // The share at x = σ, between the vertices of the middle row.
        let at = (row..row + columns - 1).find(|&v| points[v + 1].x > 0.05).unwrap();
        let t = (0.05 - points[at].x) / (points[at + 1].x - points[at].x);
        share(at) * (1.0 - t) + share(at + 1) * t
    };
    for edge in [0.01, 0.02] {
        let share = shares(edge);
        // The step lies between two vertices: half an edge, or a tenth to a fifth of σ, times the density 0.24.
        assert!((share - 0.841).abs() < 0.24 * 0.5 * edge / 0.05 + 0.01, "{edge}: {share}");
    }
}
