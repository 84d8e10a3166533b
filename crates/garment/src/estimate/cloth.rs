//! Cloth that nobody wears, and what it is laid on in the laboratory.

use super::capture::Surroundings;
use crate::GarmentRest;
use caphy_core::units::KilogramPerSquareMetre;
use caphy_core::{Error, Result, TriMesh, Vec3};
use std::f64::consts::{FRAC_PI_2, PI, TAU};

/// Radius of the rim of a table [m]: laboratory tables have sharp but not cutting edges.
const RIM_M: f64 = 2e-3;
/// Depth of a table's side [m]: cloth that hangs straight down touches it.
const SIDE_M: f64 = 0.12;

/// A flat rectangle in the x-y plane from the origin, (columns + 1) × (rows + 1) vertices, row by row from below; u = x, v = y.
/// Diagonals alternate, so that no direction is favoured.
///
/// # Errors
/// [`Error::Config`] without a cell, [`Error::Parameter`] for a density that is not positive.
pub fn sheet(columns: usize, rows: usize, [width, height]: [f64; 2], density: f64) -> Result<GarmentRest> {
    if columns == 0 || rows == 0 || !(width > 0.0 && height > 0.0) {
        let problem = format!("{columns} × {rows} cells on {width} × {height} m");
        return Err(Error::config("cloth", problem, "give a size in metres and an edge length below it"));
    }
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
    flat("sheet", vertices, faces, density)
}

/// A flat disc in the x-y plane about the origin, rings of vertices about `edge` apart; u = x, v = y.
///
/// # Errors
/// As [`sheet`].
pub fn disc(radius: f64, edge: f64, density: f64) -> Result<GarmentRest> {
    if !(edge > 0.0 && radius >= edge) {
        let problem = format!("radius {radius} m with edges of {edge} m");
        return Err(Error::config("cloth", problem, "give an edge length below the radius"));
    }
    let rings = (radius / edge).round() as usize;
    let mut vertices = vec![Vec3::zeros()];
    let mut faces = Vec::new();
    // Ring k has 6k vertices; ring k − 1 begins at `inner`.
    let mut inner = 0u32;
    for k in 1..=rings {
        let outer = vertices.len() as u32;
        let r = radius * k as f64 / rings as f64;
        vertices.extend((0..6 * k).map(|i| {
            let angle = TAU * i as f64 / (6 * k) as f64;
            Vec3::new(r * angle.cos(), r * angle.sin(), 0.0)
        }));
        let at = |ring: usize, start: u32, i: usize| start + if ring == 0 { 0 } else { (i % (6 * ring)) as u32 };
        for sector in 0..6 {
            for i in 0..k {
                let (a, b) = (at(k, outer, sector * k + i), at(k, outer, sector * k + i + 1));
                let c = at(k - 1, inner, sector * (k - 1) + i);
                faces.push([a, b, c]);
                if i + 1 < k {
                    faces.push([c, b, at(k - 1, inner, sector * (k - 1) + i + 1)]);
                }
            }
        }
        inner = outer;
    }
    flat("disc", vertices, faces, density)
}

fn flat(name: &str, vertices: Vec<Vec3>, faces: Vec<[u32; 3]>, density: f64) -> Result<GarmentRest> {
    let uv = faces.iter().map(|f| f.map(|v| [vertices[v as usize].x, vertices[v as usize].y])).collect();
    GarmentRest::new(name, TriMesh { vertices, faces }, uv, KilogramPerSquareMetre(density), "flat, u along x")
}

/// A round table about the y axis whose top is at y = 0: points `spacing` apart on top, rim and side.
///
/// # Errors
/// [`Error::Config`] for sizes that are not positive.
pub fn table(radius: f64, spacing: f64) -> Result<Surroundings> {
    if !(spacing > 0.0 && radius > 2.0 * RIM_M) {
        return Err(Error::config("table", format!("radius {radius} m"), "give a radius above 4 mm"));
    }
    let (mut points, mut normals) = (vec![Vec3::zeros()], vec![Vec3::y()]);
    let mut ring = |r: f64, y: f64, tilt: f64| {
        let count = ((TAU * r / spacing).ceil() as usize).max(6);
        for i in 0..count {
            let (s, c) = (TAU * i as f64 / count as f64).sin_cos();
            points.push(Vec3::new(r * c, y, r * s));
            normals.push(Vec3::new(tilt.sin() * c, tilt.cos(), tilt.sin() * s));
        }
    };
    let top = radius - RIM_M;
    let rings = (top / spacing).ceil() as usize;
    (1..=rings).for_each(|k| ring(top * k as f64 / rings as f64, 0.0, 0.0));
    let steps = 6;
    for k in 1..=steps {
        let tilt = FRAC_PI_2 * k as f64 / steps as f64;
        ring(top + RIM_M * tilt.sin(), RIM_M * (tilt.cos() - 1.0), tilt);
    }
    let down = (SIDE_M / spacing).ceil() as usize;
    (1..=down).for_each(|k| ring(radius, -RIM_M - SIDE_M * k as f64 / down as f64, FRAC_PI_2));
    Surroundings::new(&points, &normals)
}

/// A sphere: points about `spacing` apart, spread evenly.
///
/// # Errors
/// As [`table`].
pub fn sphere(centre: Vec3, radius: f64, spacing: f64) -> Result<Surroundings> {
    if !(spacing > 0.0 && radius > 0.0) {
        return Err(Error::config("sphere", format!("radius {radius} m"), "give a positive radius"));
    }
    let count = ((4.0 * PI * radius * radius / (spacing * spacing)).ceil() as usize).max(12);
    let golden = PI * (3.0 - 5.0f64.sqrt());
    let normals: Vec<Vec3> = (0..count)
        .map(|i| {
            let y = 1.0 - 2.0 * (i as f64 + 0.5) / count as f64;
            let r = (1.0 - y * y).sqrt();
            Vec3::new(r * (golden * i as f64).cos(), y, r * (golden * i as f64).sin())
        })
        .collect();
    let points: Vec<Vec3> = normals.iter().map(|n| centre + n * radius).collect();
    Surroundings::new(&points, &normals)
}

/// Drape coefficient of Cusick's test: (A_projected − A_disc) / (A_specimen − A_disc), the shadow that a round specimen throws
/// straight down over the table that it hangs from; 1 for a board, near 0 for silk.
///
/// `shape` [m] lies about the y axis; `specimen` and `disc` are radii [m]. The shadow is counted on a grid of 1/800 of the
/// specimen's diameter, which leaves 0.1 % of its area.
///
/// # Errors
/// [`Error::Config`] for a specimen that is not larger than the disc.
pub fn drape_coefficient(shape: &[Vec3], faces: &[[u32; 3]], specimen: f64, disc: f64) -> Result<f64> {
    if !(specimen > disc && disc > 0.0) {
        let problem = format!("a specimen of radius {specimen} m on a disc of {disc} m");
        return Err(Error::config("drape", problem, "give a specimen that is larger than its disc"));
    }
    let cells = 800i64;
    let size = 2.0 * specimen / cells as f64;
    // A stiff cloth may reach past its own radius by stretching.
    let half = cells * 11 / 20;
    let side = (2 * half) as usize;
    let mut covered = vec![false; side * side];
    for face in faces {
        let p = face.map(|v| [shape[v as usize].x / size + half as f64, shape[v as usize].z / size + half as f64]);
        let area = (p[1][0] - p[0][0]) * (p[2][1] - p[0][1]) - (p[1][1] - p[0][1]) * (p[2][0] - p[0][0]);
        if area == 0.0 || !area.is_finite() {
            continue;
        }
        let bound = |axis: usize| {
            let low = p.iter().map(|q| q[axis]).fold(f64::INFINITY, f64::min).floor().max(0.0) as usize;
            let high = p.iter().map(|q| q[axis]).fold(0.0, f64::max).ceil().min(side as f64) as usize;
            low..high
        };
        for j in bound(1) {
            for i in bound(0) {
                let q = [i as f64 + 0.5, j as f64 + 0.5];
                let inside = (0..3).all(|k| {
                    let (a, b) = (p[k], p[(k + 1) % 3]);
                    ((b[0] - a[0]) * (q[1] - a[1]) - (b[1] - a[1]) * (q[0] - a[0])) * area.signum() >= 0.0
                });
                if inside {
                    covered[j * side + i] = true;
                }
            }
        }
    }
    let projected = covered.iter().filter(|c| **c).count() as f64 * size * size;
    let of = |r: f64| PI * r * r;
    Ok((projected - of(disc)) / (of(specimen) - of(disc)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_disc_has_its_area_and_no_holes() {
        let rest = disc(0.15, 0.01, 0.2).unwrap();
        // A polygon of 90 sides.
        let polygon = 0.5 * 90.0 * 0.15f64.powi(2) * (TAU / 90.0).sin();
        assert!((rest.area() - polygon).abs() < 1e-12, "{} {polygon}", rest.area());
        assert_eq!(caphy_core::query::boundary_loops(rest.faces()).len(), 1);
        assert!(rest.template.vertex_normals().iter().all(|n| n.z > 0.999));
        assert!(disc(0.01, 0.02, 0.2).is_err() && sheet(0, 1, [0.1, 0.1], 0.2).is_err());
        assert!(sheet(2, 2, [0.1, 0.1], 0.0).is_err(), "zero density");
    }

    #[test]
    fn a_board_and_a_cone_have_their_coefficients() {
        let rest = disc(0.15, 5e-3, 0.2).unwrap();
        let lay = |f: &dyn Fn(f64) -> (f64, f64)| -> Vec<Vec3> {
            rest.template
                .vertices
                .iter()
                .map(|p| {
                    let r = p.norm();
                    let (to, down) = f(r);
                    let s = if r > 0.0 { to / r } else { 0.0 };
                    Vec3::new(p.x * s, -down, -p.y * s)
                })
                .collect()
        };
        let board = drape_coefficient(&lay(&|r| (r, 0.0)), rest.faces(), 0.15, 0.09).unwrap();
        assert!((board - 1.0).abs() < 3e-3, "{board}");
        // Beyond the table the cloth falls by 60°: the shadow reaches to 0.09 + 0.06 / 2.
        let bent = |r: f64| if r < 0.09 { (r, 0.0) } else { (0.09 + 0.5 * (r - 0.09), 0.75f64.sqrt() * (r - 0.09)) };
        let expected = (0.12f64.powi(2) - 0.09f64.powi(2)) / (0.15f64.powi(2) - 0.09f64.powi(2));
        let found = drape_coefficient(&lay(&bent), rest.faces(), 0.15, 0.09).unwrap();
        assert!((found - expected).abs() < 3e-3, "{found} {expected}");
        assert!(drape_coefficient(&lay(&bent), rest.faces(), 0.09, 0.15).is_err());
    }
}
