//! The surface of the figure: surface nets on a grid that is finer at the hands, then relaxed on the surface.

use super::figure::Figure;
use caphy_core::query::{Adjacency, hinges};
use caphy_core::{Error, Result, TriMesh, Vec3, mesh};
use rayon::prelude::*;

/// From this distance to the middle on [m], only hand is there.
const HAND_FROM: f64 = 0.64;
/// How many times finer the grid is at the finger tips.
const HAND_FINENESS: f64 = 2.2;
/// Over this length the grid becomes finer [m].
const HAND_RAMP: f64 = 0.08;
/// Axis of the arm in the plane of its cross-sections, pelvis at the origin: height and depth [m].
const HAND_CENTRE: [f64; 2] = [0.45, -0.02];

/// Grid points along each side of a block that is judged as a whole.
const BLOCK: usize = 4;

/// Grid space to body space. Beyond the wrist the grid is stretched in all three axes, so that equal cells become smaller.
fn to_body(q: &Vec3) -> Vec3 {
    let (x, scale) = arm_length(q.x.abs());
    let y = HAND_CENTRE[0] + (q.y - HAND_CENTRE[0]) / scale;
    let z = HAND_CENTRE[1] + (q.z - HAND_CENTRE[1]) / scale;
    Vec3::new(x.copysign(q.x), if scale > 1.0 { y } else { q.y }, if scale > 1.0 { z } else { q.z })
}

/// Body x and local fineness for a grid x; dx_grid / dx_body = fineness.
fn arm_length(grid: f64) -> (f64, f64) {
    let beyond = grid - HAND_FROM;
    if beyond <= 0.0 {
        return (grid, 1.0);
    }
    // Fineness rises linearly with body x over the ramp: grid = u + (f - 1) u² / (2 ramp).
    let rise = (HAND_FINENESS - 1.0) / HAND_RAMP;
    let u = ((1.0 + 2.0 * rise * beyond).sqrt() - 1.0) / rise;
    if u <= HAND_RAMP {
        return (HAND_FROM + u, 1.0 + rise * u);
    }
    let ramp_grid = HAND_RAMP + 0.5 * rise * HAND_RAMP * HAND_RAMP;
    (HAND_FROM + HAND_RAMP + (beyond - ramp_grid) / HAND_FINENESS, HAND_FINENESS)
}

/// A closed manifold triangle mesh of the figure, pelvis at the origin, from cells of a size [m].
pub(super) fn surface(figure: &Figure, cell: f64) -> Result<TriMesh> {
    let mut reason = String::new();
    // Where two sheets cross one cell, surface nets can pinch: a grid shifted by a fraction of a cell does not.
    for attempt in 0..8 {
        let shift = cell * 0.125 * f64::from(attempt);
        let mut mesh = surface_nets(figure, cell, shift);
        match closed_manifold(&mesh) {
            Ok(()) => {
                relax(figure, &mut mesh, 3);
                for _ in 0..4 {
                    flip_edges(&mut mesh);
                    relax(figure, &mut mesh, 4);
                }
                project(figure, &mut mesh);
                closed_manifold(&mesh).map_err(|r| unusable(cell, r))?;
                return Ok(mesh);
            }
            Err(r) => reason = r,
        }
    }
    Err(unusable(cell, reason))
}

fn unusable(cell: f64, reason: String) -> Error {
    Error::numerics(
        format!("mannequin with resolution {cell} m"),
        format!("its surface {reason}"),
        "choose another resolution, near the default of 0.019 m",
    )
}

/// `Err` with the reason when the mesh is not one closed manifold surface.
pub(super) fn closed_manifold(mesh: &TriMesh) -> std::result::Result<(), String> {
    let (good, bad) = hinges(&mesh.faces);
    if !bad.is_empty() {
        return Err(format!("has {} edges with more than two faces", bad.len()));
    }
    if 2 * good.len() != 3 * mesh.faces.len() {
        return Err(format!("is open: {} of {} edge sides are paired", 2 * good.len(), 3 * mesh.faces.len()));
    }
    let adjacency = Adjacency::new(mesh.vertices.len(), &mesh.faces);
    let (_, count) = adjacency.components();
    if count != 1 {
        return Err(format!("has {count} pieces"));
    }
    // One fan of faces around each vertex: as many faces as neighbours.
    let mut faces = vec![0usize; mesh.vertices.len()];
    mesh.faces.iter().flatten().for_each(|&v| faces[v as usize] += 1);
    match (0..faces.len()).find(|&v| faces[v] != adjacency.of(v).len()) {
        Some(v) => Err(format!("touches itself at vertex {v}")),
        None => Ok(()),
    }
}

/// Naive surface nets: one vertex per cell that the surface crosses, one quad per grid edge that it crosses.
fn surface_nets(figure: &Figure, cell: f64, shift: f64) -> TriMesh {
    // A grid symmetric in x around a plane through x = 0, wide enough for the stretched hands.
    let half = (1.20 / cell).ceil() as usize;
    let size = [2 * half + 1, (1.86 / cell).ceil() as usize, (0.46 / cell).ceil() as usize];
    let corner = Vec3::new(-(half as f64) * cell, -1.02 + shift, -0.20 + shift);
    let at = |i: usize, j: usize, k: usize| corner + Vec3::new(i as f64, j as f64, k as f64) * cell;
    let index = |i: usize, j: usize, k: usize| (i * size[1] + j) * size[2] + k;
    let slab = size[1] * size[2];
    // Blocks of grid points that are surely outside are not looked at again: the distance is a first-order one, and
    // half again as much as a block's radius has been ample.
    let block = |n: usize| n / BLOCK;
    let blocks = size.map(|n| block(n) + 1);
    let radius = 0.5 * BLOCK as f64 * cell * 3f64.sqrt();
    let empty: Vec<bool> = (0..blocks[0] * blocks[1] * blocks[2])
        .into_par_iter()
        .map(|n| {
            let [i, j, k] = [n / (blocks[1] * blocks[2]), n / blocks[2] % blocks[1], n % blocks[2]];
            let middle = at(i * BLOCK, j * BLOCK, k * BLOCK) + Vec3::repeat(0.5 * (BLOCK - 1) as f64 * cell);
            figure.distance(&to_body(&middle)) > 1.5 * radius
        })
        .collect();
    let mut values = vec![1.0; size[0] * slab];
    values.par_chunks_mut(slab).enumerate().for_each(|(i, slab)| {
        for (n, value) in slab.iter_mut().enumerate() {
            let (j, k) = (n / size[2], n % size[2]);
            if !empty[(block(i) * blocks[1] + block(j)) * blocks[2] + block(k)] {
                *value = figure.distance(&to_body(&at(i, j, k)));
            }
        }
    });
    let mut ids = vec![u32::MAX; values.len()];
    let mut vertices = Vec::new();
    for i in 0..size[0] - 1 {
        for j in 0..size[1] - 1 {
            for k in 0..size[2] - 1 {
                let corners: [[usize; 3]; 8] =
                    std::array::from_fn(|c| [i + (c & 1), j + ((c >> 1) & 1), k + ((c >> 2) & 1)]);
                let value = corners.map(|[i, j, k]| values[index(i, j, k)]);
                let inside = value.iter().filter(|v| **v < 0.0).count();
                if inside == 0 || inside == 8 {
                    continue;
                }
                let (mut sum, mut count) = (Vec3::zeros(), 0.0);
                for a in 0..8usize {
                    for bit in [1, 2, 4] {
                        let b = a | bit;
                        if b != a && (value[a] < 0.0) != (value[b] < 0.0) {
                            let t = value[a] / (value[a] - value[b]);
                            let [p, q] = [a, b].map(|c| at(corners[c][0], corners[c][1], corners[c][2]));
                            sum += p + (q - p) * t;
                            count += 1.0;
                        }
                    }
                }
                ids[index(i, j, k)] = vertices.len() as u32;
                vertices.push(to_body(&(sum / count)));
            }
        }
    }
    let mut faces = Vec::new();
    for i in 1..size[0] - 1 {
        for j in 1..size[1] - 1 {
            for k in 1..size[2] - 1 {
                let here = values[index(i, j, k)] < 0.0;
                let ends = [index(i + 1, j, k), index(i, j + 1, k), index(i, j, k + 1)];
                let rings = [
                    [(i, j - 1, k - 1), (i, j, k - 1), (i, j, k), (i, j - 1, k)],
                    [(i - 1, j, k - 1), (i - 1, j, k), (i, j, k), (i, j, k - 1)],
                    [(i - 1, j - 1, k), (i, j - 1, k), (i, j, k), (i - 1, j, k)],
                ];
                for (end, ring) in ends.iter().zip(rings) {
                    if here == (values[*end] < 0.0) {
                        continue;
                    }
                    let mut quad = ring.map(|(i, j, k)| ids[index(i, j, k)]);
                    if !here {
                        quad.reverse();
                    }
                    let [a, b, c, d] = quad.map(|v| vertices[v as usize]);
                    // The shorter diagonal; a tie goes the same way on both sides of the body.
                    if (a - c).norm() < (b - d).norm() {
                        faces.extend([[quad[0], quad[1], quad[2]], [quad[0], quad[2], quad[3]]]);
                    } else {
                        faces.extend([[quad[1], quad[2], quad[3]], [quad[1], quad[3], quad[0]]]);
                    }
                }
            }
        }
    }
    TriMesh { vertices, faces }
}

/// Moves vertices along the surface towards the mean of their neighbours, and back onto the surface.
fn relax(figure: &Figure, mesh: &mut TriMesh, rounds: usize) {
    let adjacency = Adjacency::new(mesh.vertices.len(), &mesh.faces);
    for _ in 0..rounds {
        let normals = mesh::vertex_normals(&mesh.vertices, &mesh.faces);
        let old = &mesh.vertices;
        mesh.vertices = (0..old.len())
            .into_par_iter()
            .map(|v| {
                let around = adjacency.of(v);
                let mean = around.iter().map(|&w| old[w as usize]).sum::<Vec3>() / around.len() as f64;
                let step = (mean - old[v]) * 0.6;
                let p = old[v] + step - normals[v] * normals[v].dot(&step);
                // One step along the normal, with a one-sided slope: two values instead of seven.
                let (h, value) = (1e-4, figure.distance(&p));
                let slope = (figure.distance(&(p + normals[v] * h)) - value) / h;
                p - normals[v] * (value / slope.max(0.3))
            })
            .collect();
    }
}

/// Puts every vertex on the surface, along the gradient.
fn project(figure: &Figure, mesh: &mut TriMesh) {
    mesh.vertices.par_iter_mut().for_each(|p| {
        for _ in 0..3 {
            let g = figure.gradient(p);
            // A flat gradient (a seam of two solids) has no direction to go.
            *p -= g * (figure.distance(p) / g.norm_squared().max(0.1));
        }
    });
}

/// Flips edges where that brings the four vertices nearer to six neighbours each.
fn flip_edges(mesh: &mut TriMesh) {
    let mut degree = vec![0i32; mesh.vertices.len()];
    mesh.faces.iter().flatten().for_each(|&v| degree[v as usize] += 1);
    let mut edges: std::collections::HashSet<[u32; 2]> = std::collections::HashSet::new();
    let key = |a: u32, b: u32| [a.min(b), a.max(b)];
    for f in &mesh.faces {
        for k in 0..3 {
            edges.insert(key(f[k], f[(k + 1) % 3]));
        }
    }
    let mut touched = vec![false; mesh.faces.len()];
    for hinge in hinges(&mesh.faces).0 {
        let [a, b, c, d] = hinge.vertices;
        let [f, g] = hinge.faces.map(|f| f as usize);
        if touched[f] || touched[g] || edges.contains(&key(c, d)) {
            continue;
        }
        let cost = |change: i32| -> i32 {
            [(a, -change), (b, -change), (c, change), (d, change)]
                .iter()
                .map(|&(v, change)| (degree[v as usize] + change - 6).pow(2))
                .sum()
        };
        let [pa, pb, pc, pd] = [a, b, c, d].map(|v| mesh.vertices[v as usize]);
        let normal = |p: Vec3, q: Vec3, r: Vec3| (q - p).cross(&(r - p));
        let (old, new) = ([normal(pa, pb, pc), normal(pb, pa, pd)], [normal(pc, pa, pd), normal(pd, pb, pc)]);
        let mean = (old[0] + old[1]).normalize();
        // Both new triangles must face the old way and not be slivers.
        let smallest = new.iter().map(|n| n.dot(&mean)).fold(f64::INFINITY, f64::min);
        let largest_old = old.iter().map(|n| n.norm()).fold(0.0, f64::max);
        if cost(1) < cost(0) && smallest > 0.3 * largest_old {
            mesh.faces[f] = [c, a, d];
            mesh.faces[g] = [d, b, c];
            (touched[f], touched[g]) = (true, true);
            edges.remove(&key(a, b));
            edges.insert(key(c, d));
            degree[a as usize] -= 1;
            degree[b as usize] -= 1;
            degree[c as usize] += 1;
            degree[d as usize] += 1;
        }
    }
}
