//! The reference solver: second derivatives, closed forms, friction, sensitivities, extremes.

mod analytic;
mod contact;
mod extremes;
mod sensitivities;
mod single;
mod tangents;

use crate::support;

use caphy_core::lanes::Frames;
use caphy_core::units::KilogramPerSquareMetre;
use caphy_core::{TriMesh, Vec3};
use caphy_garment::GarmentRest;
use caphy_garment::solver::Progress;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// A flat rectangle in the x-y plane, (columns + 1) × (rows + 1) vertices, row by row from below; u = x, v = y.
pub(crate) fn sheet(columns: usize, rows: usize, [width, height]: [f64; 2], density: f64) -> GarmentRest {
    let vertices: Vec<Vec3> = (0..=rows)
        .flat_map(|j| {
            (0..=columns)
                .map(move |i| Vec3::new(width * i as f64 / columns as f64, height * j as f64 / rows as f64, 0.0))
        })
        .collect();
    let id = |i: usize, j: usize| (j * (columns + 1) + i) as u32;
    let mut faces = Vec::new();
    for j in 0..rows {
        for i in 0..columns {
            let [a, b, c, d] = [id(i, j), id(i + 1, j), id(i, j + 1), id(i + 1, j + 1)];
            if (i + j) % 2 == 0 {
                faces.extend([[a, b, d], [a, d, c]]);
            } else {
                faces.extend([[a, b, c], [b, d, c]]);
            }
        }
    }
    let uv = faces.iter().map(|f| f.map(|v| [vertices[v as usize].x, vertices[v as usize].y])).collect();
    GarmentRest::new("sheet", TriMesh { vertices, faces }, uv, KilogramPerSquareMetre(density), "flat").unwrap()
}

pub(crate) fn shaken(points: &[Vec3], size: f64, seed: u64) -> Vec<Vec3> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    points.iter().map(|p| p + Vec3::from_fn(|_, _| rng.random_range(-size..size))).collect()
}

pub(crate) fn frame(points: &[Vec3]) -> Frames<f64> {
    let mut out = Frames::zeros(1, points.len(), 1);
    out.set_frame(0, 0, points).unwrap();
    out
}

pub(crate) fn quiet(_: Progress) {}
