//! Time of each energy term and of skinning at T-shirt scale: a tube of 4424 vertices in 80 frames (5 steps of 16 windows,
//! f32) around a body of 10475 vertices, one thread unless RAYON_NUM_THREADS says otherwise.

use caphy_core::body::BlendWeights;
use caphy_core::lanes::Frames;
use caphy_core::material::MaterialModel;
use caphy_core::units::KilogramPerSquareMetre;
use caphy_core::{TriMesh, Vec3};
use caphy_garment::GarmentRest;
use caphy_garment::energy::{
    Bending, BodyState, Chamfer, Collision, ContactOptions, EnergyTerm, Gravity, Inertia, InertiaRule, RestAngle,
    ScanCloud, State, Strain, frame_normals, gravity::EARTH, nearest_body_vertices,
};
use caphy_garment::skinning::Skinner;
use caphy_materials::MaterialStvk;
use criterion::{Criterion, criterion_group, criterion_main};
use nalgebra::{Isometry3, Matrix3x4};
use std::hint::black_box;
use std::sync::Arc;

const STEPS: usize = 5;
const WINDOWS: usize = 16;

/// A wavy tube standing on the ground; its layout is the unrolled surface.
fn tube(rings: usize, around: usize, radius: f64, height: f64) -> (TriMesh, Vec<[[f64; 2]; 3]>) {
    let angle = |a: usize| a as f64 / around as f64 * std::f64::consts::TAU;
    let vertices = (0..rings * around)
        .map(|i| {
            let (ring, a) = (i / around, angle(i % around));
            let r = radius * (1.0 + 0.02 * (5.0 * a).sin());
            Vec3::new(r * a.cos(), ring as f64 / (rings - 1) as f64 * height, r * a.sin())
        })
        .collect();
    let (mut faces, mut uv) = (Vec::new(), Vec::new());
    let (du, dv) = (radius * angle(1), height / (rings - 1) as f64);
    for ring in 0..rings - 1 {
        for a in 0..around {
            let id = |r: usize, a: usize| (r * around + a % around) as u32;
            let at = |r: usize, a: usize| [-(a as f64) * du, r as f64 * dv];
            faces.push([id(ring, a), id(ring + 1, a), id(ring, a + 1)]);
            uv.push([at(ring, a), at(ring + 1, a), at(ring, a + 1)]);
            faces.push([id(ring, a + 1), id(ring + 1, a), id(ring + 1, a + 1)]);
            uv.push([at(ring, a + 1), at(ring + 1, a), at(ring + 1, a + 1)]);
        }
    }
    (TriMesh { vertices, faces }, uv)
}

fn moved(points: &[Vec3], amplitude: f64) -> Frames<f32> {
    let mut frames = Frames::zeros(STEPS, points.len(), WINDOWS);
    for step in 0..STEPS {
        for window in 0..WINDOWS {
            let phase = (step * WINDOWS + window) as f64;
            let at =
                |p: &Vec3| p + amplitude * Vec3::new((9.0 * p.y + phase).sin(), 0.2 * phase.cos(), (7.0 * p.x).cos());
            frames.set_frame(step, window, &points.iter().map(at).collect::<Vec<_>>()).expect("same length");
        }
    }
    frames
}

fn terms(c: &mut Criterion) {
    // One thread is the honest unit of comparison.
    let threads = std::env::var("RAYON_NUM_THREADS").ok().and_then(|n| n.parse().ok()).unwrap_or(1);
    rayon::ThreadPoolBuilder::new().num_threads(threads).build_global().expect("the only pool");
    let (template, uv) = tube(79, 56, 0.2, 0.7);
    let rest = GarmentRest::new("tube", template, uv, KilogramPerSquareMetre(0.2), "unrolled").expect("a good tube");
    let (body, _) = tube(116, 90, 0.195, 0.9);
    let material: Arc<dyn MaterialModel> = Arc::new(MaterialStvk::snug().expect("the constants of SNUG"));
    let x = moved(&rest.template.vertices, 0.003);
    let body_x = moved(&body.vertices, 0.002);
    let body_n = frame_normals(&body_x, &body.faces).expect("faces in range");
    let nearest = nearest_body_vertices(&x, &body_x).expect("finite");
    let body_state = BodyState { positions: &body_x, normals: &body_n, nearest: Some(&nearest) };
    let seen: Vec<Vec3> = body.vertices.iter().filter(|p| p.y <= 0.7).copied().collect();
    let cloud = ScanCloud::<f32>::new("scan", &seen).expect("points");
    let scans = vec![&cloud; x.frames()];
    let state = State::new(&x).with_body(body_state).with_scans(&scans);
    let all: Vec<Box<dyn EnergyTerm<f32>>> = vec![
        Box::new(Strain::new(&rest, material.clone())),
        Box::new(Bending::new(&rest, material, RestAngle::Template)),
        Box::new(Gravity::new(&rest, EARTH)),
        Box::new(Inertia::new(&rest, 1.0 / 30.0, InertiaRule::KnownVelocity).expect("a good step")),
        Box::new(Collision::new(&rest, &ContactOptions::default()).expect("good options")),
        Box::new(Chamfer::new(&rest, None).expect("vertices")),
    ];
    let mut gradient = Frames::zeros(STEPS, rest.vertex_count(), WINDOWS);
    let mut energy = vec![0.0; x.frames()];
    let mut group = c.benchmark_group(format!("{} vertices, 80 frames, {threads} thread(s)", rest.vertex_count()));
    group.sample_size(10).warm_up_time(std::time::Duration::from_millis(300));
    group.measurement_time(std::time::Duration::from_secs(1));
    for term in &all {
        group.bench_function(term.name(), |b| {
            b.iter(|| {
                gradient.clear();
                term.add(&state, 1.0, &mut energy, Some(&mut gradient)).expect("finite");
                black_box(&energy);
            })
        });
    }
    group.bench_function(format!("nearest of {} body vertices", body.vertices.len()), |b| {
        b.iter(|| black_box(nearest_body_vertices(&x, &body_x).expect("finite")))
    });
    group.bench_function("body normals", |b| b.iter(|| black_box(frame_normals(&body_x, &body.faces).expect("faces"))));

    let rows = (0..rest.vertex_count()).map(|v| {
        let s = (v as f64 * 0.01).sin().abs();
        vec![(0, 0.4 * s), (3, 0.3), (6, 0.3), (9, 0.4 * (1.0 - s))]
    });
    let skinner = Skinner::<f32>::new(&rest.template.vertices, &BlendWeights::from_rows(rows)).expect("good weights");
    let transforms: Vec<Vec<Matrix3x4<f64>>> = (0..x.frames())
        .map(|f| {
            let turn = |j: usize| Isometry3::rotation(Vec3::new(0.0, 0.1 * (f + j) as f64, 0.0)).to_homogeneous();
            (0..10).map(|j| turn(j).fixed_rows::<3>(0).into_owned()).collect()
        })
        .collect();
    let frames: Vec<&[Matrix3x4<f64>]> = transforms.iter().map(Vec::as_slice).collect();
    let joints = skinner.joint_frames(&frames, WINDOWS).expect("enough joints");
    let mut dv = vec![0.001f32; x.frames() * 3 * rest.vertex_count()];
    let mut out = Frames::zeros(STEPS, rest.vertex_count(), WINDOWS);
    group
        .bench_function("skinning", |b| b.iter(|| skinner.forward(&joints, Some(&dv), &mut out).expect("same shapes")));
    group.bench_function("skinning backward", |b| b.iter(|| skinner.vjp(&joints, &x, &mut dv).expect("same shapes")));
    group.finish();
}

criterion_group!(benches, terms);
criterion_main!(benches);
