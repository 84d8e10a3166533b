//! Time of nearest-vertex and nearest-surface queries at the size of a shirt on a body, against an independent crate
//! (parry3d) in the same run, one thread unless RAYON_NUM_THREADS says otherwise.

use caphy_core::query::{NearestGrid, NearestSurface};
use caphy_core::{TriMesh, Vec3};
use criterion::{BatchSize, Criterion, criterion_group, criterion_main};
use parry3d_f64::math::Vector;
use parry3d_f64::query::PointQuery;
use parry3d_f64::shape::{Polyline, TriMesh as ParryMesh};
use std::hint::black_box;

/// A closed bumpy figure of the proportions of a body, 1.8 m tall.
fn figure(splits: usize) -> TriMesh {
    let vertices = [Vec3::x(), Vec3::y(), Vec3::z(), -Vec3::x(), -Vec3::y(), -Vec3::z()].to_vec();
    let faces = vec![[0, 1, 2], [1, 3, 2], [3, 4, 2], [4, 0, 2], [1, 0, 5], [3, 1, 5], [4, 3, 5], [0, 4, 5]];
    let mut mesh = TriMesh { vertices, faces };
    for _ in 0..splits {
        mesh = mesh.subdivided();
        mesh.vertices.iter_mut().for_each(|v| *v = v.normalize());
    }
    for v in &mut mesh.vertices {
        let bump = 1.0 + 0.2 * (4.0 * v.x).sin() * (5.0 * v.y).cos() + 0.1 * (9.0 * v.z).sin();
        *v = Vec3::new(0.25 * v.x, 0.9 * v.y, 0.15 * v.z) * bump;
    }
    mesh
}

/// The upper part of the figure, `gap` [m] outside of it: cloth.
fn cloth(body: &TriMesh, gap: f64) -> Vec<Vec3> {
    let normals = body.vertex_normals();
    let upper = |v: &&usize| (-0.1..0.6).contains(&body.vertices[**v].y);
    let ids: Vec<usize> = (0..body.vertices.len()).collect();
    ids.iter().filter(upper).map(|&v| body.vertices[v] + normals[v] * gap).collect()
}

fn queries(c: &mut Criterion) {
    let threads = std::env::var("RAYON_NUM_THREADS").unwrap_or_else(|_| "1".into());
    let threads: usize = threads.parse().expect("a number of threads");
    rayon::ThreadPoolBuilder::new().num_threads(threads).build_global().expect("first use of the pool");
    // 16386 vertices, 32768 triangles; about half of them under the cloth.
    let body = figure(6);
    let parry = |p: &Vec3| Vector::new(p.x, p.y, p.z);
    let points: Vec<Vector> = body.vertices.iter().map(parry).collect();
    let arrays: Vec<[f64; 3]> = body.vertices.iter().map(|&v| v.into()).collect();
    let single: Vec<[f32; 3]> = body.vertices.iter().map(|v| [v.x as f32, v.y as f32, v.z as f32]).collect();
    // Every eighth: an iteration is short enough to run undisturbed now and then on a busy machine.
    let near: Vec<Vec3> = cloth(&body, 0.012).into_iter().step_by(8).collect();
    let far: Vec<Vec3> = near.iter().map(|p| p + Vec3::new(0.4, 0.2, 0.8)).collect();
    println!("{} body vertices, {} triangles, {} queries", body.vertices.len(), body.faces.len(), near.len());

    let mut group = c.benchmark_group("build");
    group.bench_function("vertices f64", |b| b.iter(|| NearestGrid::new(black_box(&arrays))));
    group.bench_function("vertices f32", |b| b.iter(|| NearestGrid::new(black_box(&single))));
    group.bench_function("surface", |b| b.iter(|| NearestSurface::from_mesh(black_box(&body)).expect("sound")));
    group.bench_function("surface parry", |b| {
        let make = |(points, faces)| ParryMesh::new(points, faces).expect("sound");
        b.iter_batched(|| (points.clone(), body.faces.clone()), make, BatchSize::LargeInput)
    });
    group.finish();

    let grid = NearestGrid::new(&arrays);
    let grid_single = NearestGrid::new(&single);
    let cloud = Polyline::new(points.clone(), Some((0..points.len() as u32).map(|i| [i, i]).collect()));
    let surface = NearestSurface::from_mesh(&body).expect("sound");
    let parry_mesh = ParryMesh::new(points, body.faces.clone()).expect("sound");
    for (name, queries) in [("12 mm outside", &near), ("0.9 m away", &far)] {
        let arrays: Vec<[f64; 3]> = queries.iter().map(|&q| q.into()).collect();
        let single: Vec<[f32; 3]> = queries.iter().map(|q| [q.x as f32, q.y as f32, q.z as f32]).collect();
        let vectors: Vec<Vector> = queries.iter().map(parry).collect();
        let vertices: Vec<u32> = arrays.iter().filter_map(|q| grid.nearest(q)).map(|(id, _)| id).collect();
        let faces: Vec<u32> = queries.iter().filter_map(|q| surface.nearest(q)).map(|at| at.face).collect();
        let mut group = c.benchmark_group(name);
        group.bench_function("vertex f64", |b| {
            b.iter(|| arrays.iter().map(|q| grid.nearest(q).map_or(0.0, |n| n.1)).sum::<f64>())
        });
        group.bench_function("vertex f32", |b| {
            b.iter(|| single.iter().map(|q| grid_single.nearest(q).map_or(0.0, |n| n.1)).sum::<f32>())
        });
        group.bench_function("vertex f64 batch", |b| b.iter(|| grid.nearest_all(&arrays, None).expect("finite")));
        group.bench_function("vertex f64 known", |b| {
            b.iter(|| grid.nearest_all(&arrays, Some(&vertices)).expect("finite"))
        });
        group.bench_function("vertex parry", |b| {
            b.iter(|| vectors.iter().map(|q| cloud.distance_to_local_point(*q, false)).sum::<f64>())
        });
        group.bench_function("surface", |b| {
            b.iter(|| queries.iter().filter_map(|q| surface.nearest(q)).map(|n| n.squared_distance).sum::<f64>())
        });
        group.bench_function("surface batch", |b| b.iter(|| surface.nearest_all(queries, None).expect("finite")));
        group.bench_function("surface known", |b| {
            b.iter(|| surface.nearest_all(queries, Some(&faces)).expect("finite"))
        });
        group.bench_function("surface parry", |b| {
            b.iter(|| vectors.iter().map(|q| parry_mesh.distance_to_local_point(*q, false)).sum::<f64>())
        });
        group.finish();
    }
}

criterion_group!(benches, queries);
criterion_main!(benches);
