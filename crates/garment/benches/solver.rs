//! Time of the parts of a Newton step of the reference solver: a tube of 4424 vertices, one pose, f64, one thread unless
//! RAYON_NUM_THREADS says otherwise.

use caphy_core::lanes::Frames;
use caphy_core::material::MaterialModel;
use caphy_core::units::KilogramPerSquareMetre;
use caphy_core::{TriMesh, Vec3};
use caphy_garment::GarmentRest;
use caphy_garment::energy::{
    Bending, EnergyTangent, EnergyTerm, RestAngle, Single, SingleTerm, State, Strain, Tangent,
};
use caphy_garment::solver::factor::{Factor, Kind};
use caphy_garment::solver::sparse::{BlockMatrix, Pattern};
use caphy_garment::solver::{Analysis, Forces, Scene, Solver, SolverSettings};
use caphy_materials::MaterialStvk;
use criterion::{Criterion, criterion_group, criterion_main};
use std::hint::black_box;
use std::sync::Arc;

/// A wavy tube standing on the ground; its layout is the unrolled surface.
fn tube(rings: usize, around: usize, radius: f64, height: f64) -> GarmentRest {
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
    GarmentRest::new("tube", TriMesh { vertices, faces }, uv, KilogramPerSquareMetre(0.2), "unrolled")
        .expect("a good tube")
}

fn parts(c: &mut Criterion) {
    // One thread is the honest unit of comparison.
    let threads = std::env::var("RAYON_NUM_THREADS").ok().and_then(|n| n.parse().ok()).unwrap_or(1);
    rayon::ThreadPoolBuilder::new().num_threads(threads).build_global().expect("the only pool");
    let rest = tube(79, 56, 0.2, 0.7);
    let material: Arc<dyn MaterialModel> = Arc::new(MaterialStvk::snug().expect("the constants of SNUG"));
    let strain = Strain::<f64>::new(&rest, material.clone());
    let bending = Bending::<f64>::new(&rest, material.clone(), RestAngle::Template);
    let points: Vec<Vec3> = rest
        .template
        .vertices
        .iter()
        .map(|p| p + 0.003 * Vec3::new((9.0 * p.y).sin(), 0.2, (7.0 * p.x).cos()))
        .collect();
    let mut frames = Frames::zeros(1, points.len(), 1);
    frames.set_frame(0, 0, &points).expect("same length");
    let flat: Vec<f64> = points.iter().flat_map(|p| [p.x, p.y, p.z]).collect();
    let mut group = c.benchmark_group(format!("{} vertices, one pose, {threads} thread(s)", rest.vertex_count()));
    group.sample_size(10).warm_up_time(std::time::Duration::from_millis(300));
    group.measurement_time(std::time::Duration::from_secs(1));

    let (mut gradient, mut energy) = (vec![0.0; flat.len()], [0.0]);
    let mut lanes = Frames::zeros(1, points.len(), 1);
    let pose = Single::new(&flat);
    for (name, single, batched) in
        [("strain", &strain as &dyn SingleTerm, &strain as &dyn EnergyTerm<f64>), ("bending", &bending, &bending)]
    {
        group.bench_function(format!("{name}, energy and forces"), |b| {
            b.iter(|| black_box(single.add_single(&pose, 1.0, Some(&mut gradient)).expect("finite")))
        });
        group.bench_function(format!("{name}, energy and forces, frames in lanes"), |b| {
            b.iter(|| batched.add(&State::new(&frames), 1.0, &mut energy, Some(&mut lanes)).expect("finite"))
        });
    }

    let stencils = [strain.stencil(), bending.stencil()];
    let pattern = Arc::new(Pattern::new(rest.vertex_count(), &[&stencils[0], &stencils[1]]).expect("good elements"));
    let slots = stencils.each_ref().map(|s| pattern.slots(s).expect("elements of the pattern"));
    let mut blocks = stencils.each_ref().map(|s| vec![0.0; s.block_values()]);
    let mut matrix = BlockMatrix::new(pattern.clone());
    let state = State::new(&frames);
    for (name, kind) in [("exact", Tangent::Exact), ("projected", Tangent::Projected)] {
        group.bench_function(format!("tangent matrix, {name}"), |b| {
            b.iter(|| {
                matrix.clear();
                strain.tangents(&state, 1.0, kind, &mut blocks[0]).expect("finite");
                bending.tangents(&state, 1.0, kind, &mut blocks[1]).expect("finite");
                matrix.add(&slots[0], 3, &blocks[0]);
                matrix.add(&slots[1], 4, &blocks[1]);
            })
        });
    }
    matrix.add_diagonal(rest.vertex_masses.iter().map(|m| 900.0 * m));
    group.bench_function("elimination order", |b| b.iter(|| black_box(Analysis::new(pattern.clone()))));
    let analysis = Arc::new(Analysis::new(pattern.clone()));
    for kind in [Kind::Cholesky, Kind::Lu] {
        group.bench_function(format!("factorisation, {kind:?}"), |b| {
            b.iter(|| black_box(Factor::new(&analysis, &matrix, kind).expect("finite").is_some()))
        });
    }
    let factor = Factor::new(&analysis, &matrix, Kind::Cholesky).expect("finite").expect("held by its momentum");
    group.bench_function("solve with a factor", |b| b.iter(|| black_box(factor.solve(&flat))));

    // A small whole solve: a tube that hangs by its upper edge.
    let small = tube(20, 14, 0.2, 0.7);
    let held: Vec<u32> = (19 * 14..20 * 14).collect();
    let mut solver =
        Solver::new(&small, material, Forces::default(), SolverSettings::default()).expect("good settings");
    let scene = Scene { fixed: &held, ..Scene::default() };
    let start = small.template.vertices.clone();
    group.bench_function("whole solve, 280 vertices that hang", |b| {
        b.iter(|| black_box(solver.solve(&scene, &start, &|_| {}).expect("finite").report.iterations))
    });
    group.finish();
}

criterion_group!(benches, parts);
criterion_main!(benches);
