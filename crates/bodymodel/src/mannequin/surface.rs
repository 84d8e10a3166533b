//! The surface of the figure: dual contouring of its left half on a grid, relaxed on the surface, and mirrored.

use super::figure::{Figure, PELVIS_HEIGHT, STATURE};
use super::grid::Grid;
use caphy_core::query::{Adjacency, hinges};
use caphy_core::{Error, Result, TriMesh, Vec3, mesh};
use rayon::prelude::*;

/// A mesh that is its own mirror image in x, to the bit: vertices of the left half with the middle ones first come first.
#[derive(Debug, Clone)]
pub(super) struct Symmetric {
    pub(super) mesh: TriMesh,
    /// Number of vertices of the left half, with those in the middle.
    pub(super) half: usize,
    /// The mirror image of each vertex.
    pub(super) mirror: Vec<u32>,
}

/// Grid points along each side of a block that is judged as a whole.
const BLOCK: usize = 4;

/// A closed manifold triangle mesh of the figure, pelvis at the origin, from cells of a size [m].
pub(super) fn surface(figure: &Figure, cell: f64) -> Result<Symmetric> {
    let grid = Grid::new(cell);
    let mut reason = String::new();
    // Where sheets cross a face of a cell diagonally, dual contouring can pinch: a grid shifted by a fraction of a cell
    // does not.
    for attempt in 0..8 {
        let mut half = contour(figure, &grid, cell * 0.125 * f64::from(attempt));
        match closed_manifold(&half.mirrored().mesh) {
            Ok(()) => {
                half.relax(figure, 3);
                for _ in 0..4 {
                    half.flip_edges();
                    half.relax(figure, 4);
                }
                half.project(figure);
                half.stand();
                let whole = half.mirrored();
                return closed_manifold(&whole.mesh).map(|()| whole).map_err(|r| unusable(cell, &r));
            }
            Err(r) => reason = r,
        }
    }
    Err(unusable(cell, &reason))
}

fn unusable(cell: f64, reason: &str) -> Error {
    Error::numerics(
        format!("mannequin with resolution {cell} m"),
        format!("its surface {reason}"),
        "choose another resolution, near the default",
    )
}

/// `Err` with the reason when the mesh is not one closed manifold surface without handles.
fn closed_manifold(mesh: &TriMesh) -> std::result::Result<(), String> {
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
    if let Some(v) = (0..faces.len()).find(|&v| faces[v] != adjacency.of(v).len()) {
        return Err(format!("touches itself at vertex {v}"));
    }
    // V - E + F = 2 - 2 · handles.
    let euler = mesh.vertices.len() as i64 - good.len() as i64 + mesh.faces.len() as i64;
    if euler != 2 {
        return Err(format!("has {} handles", (2 - euler) / 2));
    }
    Ok(())
}

/// The left half (x ≥ 0) of the surface, open along x = 0.
struct Half {
    mesh: TriMesh,
    /// Whether a vertex lies on x = 0.
    middle: Vec<bool>,
}

/// The edges of a cell: axis a, and the corner bits of the two other axes in cyclic order after it.
fn edge(axis: usize, first: usize, second: usize) -> usize {
    4 * axis + first + 2 * second
}

/// Corner (bits x, y, z) at the end `end` of an edge.
fn corner(edge: usize, end: usize) -> usize {
    let axis = edge / 4;
    (end << axis) | ((edge & 1) << ((axis + 1) % 3)) | ((edge >> 1 & 1) << ((axis + 2) % 3))
}

/// The patches of surface in a cell: for each edge that the surface crosses the number of its patch, else `u8::MAX`; and
/// the number of patches. On a face that four edges cross, what is inside is taken to be apart.
fn patches(inside: [bool; 8]) -> ([u8; 12], usize) {
    let crossed = |e: usize| inside[corner(e, 0)] != inside[corner(e, 1)];
    let mut group: [usize; 12] = std::array::from_fn(|e| e);
    let mut link = |a: usize, b: usize| {
        let (a, b) = (group[a], group[b]);
        group.iter_mut().filter(|g| **g == b).for_each(|g| *g = a);
    };
    for n in 0..3 {
        let (u, v) = ((n + 1) % 3, (n + 2) % 3);
        for side in 0..2 {
            // Edges along u lie at v = 0 and 1, and the other way round.
            let along_u = |at_v: usize| edge(u, at_v, side);
            let along_v = |at_u: usize| edge(v, side, at_u);
            let all = [along_u(0), along_u(1), along_v(0), along_v(1)];
            let on: Vec<usize> = all.into_iter().filter(|&e| crossed(e)).collect();
            if on.len() == 2 {
                link(on[0], on[1]);
            } else if on.len() == 4 {
                for (at_u, at_v) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
                    if inside[(side << n) | (at_u << u) | (at_v << v)] {
                        link(along_u(at_v), along_v(at_u));
                    }
                }
            }
        }
    }
    let mut out = [u8::MAX; 12];
    let mut count = 0;
    for e in 0..12 {
        if crossed(e) && out[e] == u8::MAX {
            for f in e..12 {
                if crossed(f) && group[f] == group[e] {
                    out[f] = count;
                }
            }
            count += 1;
        }
    }
    (out, count as usize)
}

/// Dual contouring: one vertex per patch in a cell, one quad per grid edge that the surface crosses (Nielson 2004).
///
/// The cells of the first layer are centred on x = 0; by symmetry no edge across them is crossed.
fn contour(figure: &Figure, grid: &Grid, shift: f64) -> Half {
    let cell = grid.cell;
    let (low, high) = grid.bounds();
    let corner_at = Vec3::new(-0.5 * cell, low.y + shift, low.z + shift);
    let size = [high.x + 0.5 * cell, high.y - low.y, high.z - low.z].map(|length| (length / cell).ceil() as usize + 1);
    let at = |i: usize, j: usize, k: usize| corner_at + Vec3::new(i as f64, j as f64, k as f64) * cell;
    let index = |i: usize, j: usize, k: usize| (i * size[1] + j) * size[2] + k;
    let values = sample(figure, grid, size, &at);
    let mut mesh = TriMesh::default();
    let mut middle = Vec::new();
    // Vertices of the edges of each cell that the surface crosses.
    let mut slots = vec![u32::MAX; values.len()];
    let mut cells: Vec<[u32; 12]> = Vec::new();
    for i in 0..size[0] - 1 {
        for j in 0..size[1] - 1 {
            for k in 0..size[2] - 1 {
                let place = |c: usize| [i + (c & 1), j + (c >> 1 & 1), k + (c >> 2 & 1)];
                let value: [f64; 8] = std::array::from_fn(|c| {
                    let [i, j, k] = place(c);
                    values[index(i, j, k)]
                });
                let inside = value.map(|v| v < 0.0);
                if inside.iter().all(|s| *s == inside[0]) {
                    continue;
                }
                let (patch, count) = patches(inside);
                let (mut sums, mut counts) = ([Vec3::zeros(); 12], [0.0; 12]);
                for e in (0..12).filter(|&e| patch[e] != u8::MAX) {
                    let (a, b) = (corner(e, 0), corner(e, 1));
                    let [p, q] = [a, b].map(|c| {
                        let [i, j, k] = place(c);
                        at(i, j, k)
                    });
                    let n = usize::from(patch[e]);
                    sums[n] += p + (q - p) * (value[a] / (value[a] - value[b]));
                    counts[n] += 1.0;
                }
                let first = mesh.vertices.len() as u32;
                for n in 0..count {
                    let mut p = grid.to_body(&(sums[n] / counts[n]));
                    if i == 0 {
                        p.x = 0.0;
                    }
                    mesh.vertices.push(p);
                    middle.push(i == 0);
                }
                slots[index(i, j, k)] = cells.len() as u32;
                cells.push(patch.map(|n| if n == u8::MAX { u32::MAX } else { first + u32::from(n) }));
            }
        }
    }
    for i in 1..size[0] - 1 {
        for j in 1..size[1] - 1 {
            for k in 1..size[2] - 1 {
                let here = values[index(i, j, k)] < 0.0;
                for axis in 0..3 {
                    let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
                    let mut end = [i, j, k];
                    end[axis] += 1;
                    if here == (values[index(end[0], end[1], end[2])] < 0.0) {
                        continue;
                    }
                    // The four cells around the edge, counter-clockwise seen from its end.
                    let mut quad = [(1, 1), (0, 1), (0, 0), (1, 0)].map(|(a, b): (usize, usize)| {
                        let mut c = [i, j, k];
                        (c[u], c[v]) = (c[u] - a, c[v] - b);
                        cells[slots[index(c[0], c[1], c[2])] as usize][edge(axis, a, b)]
                    });
                    if !here {
                        quad.reverse();
                    }
                    let [a, b, c, d] = quad.map(|v| mesh.vertices[v as usize]);
                    // The shorter diagonal, but never one along the middle: its mirror image would be the same edge.
                    let middle = |a: usize, b: usize| middle[quad[a] as usize] && middle[quad[b] as usize];
                    if !middle(0, 2) && (middle(1, 3) || (a - c).norm() < (b - d).norm()) {
                        mesh.faces.extend([[quad[0], quad[1], quad[2]], [quad[0], quad[2], quad[3]]]);
                    } else {
                        mesh.faces.extend([[quad[1], quad[2], quad[3]], [quad[1], quad[3], quad[0]]]);
                    }
                }
            }
        }
    }
    Half { mesh, middle }
}

/// Distances at all grid points. Blocks that are surely inside or outside keep one sign: the distance is a first-order
/// one, and half again as much as a block's radius has been ample.
fn sample(
    figure: &Figure,
    grid: &Grid,
    size: [usize; 3],
    at: &(impl Fn(usize, usize, usize) -> Vec3 + Sync),
) -> Vec<f64> {
    let slab = size[1] * size[2];
    let blocks = size.map(|n| n.div_ceil(BLOCK));
    let uniform: Vec<f64> = (0..blocks[0] * blocks[1] * blocks[2])
        .into_par_iter()
        .map(|n| {
            let [i, j, k] = [n / (blocks[1] * blocks[2]), n / blocks[2] % blocks[1], n % blocks[2]].map(|b| b * BLOCK);
            let (low, high) = (at(i, j, k), at(i + BLOCK - 1, j + BLOCK - 1, k + BLOCK - 1));
            let middle = grid.to_body(&(0.5 * (low + high)));
            let radius = (0..8)
                .map(|c| {
                    let q = Vec3::from_fn(|axis, _| if c >> axis & 1 == 0 { low[axis] } else { high[axis] });
                    (grid.to_body(&q) - middle).norm()
                })
                .fold(0.0, f64::max);
            let d = figure.distance(&middle);
            if d.abs() > 1.5 * radius { d } else { 0.0 }
        })
        .collect();
    let mut values = vec![0.0; size[0] * slab];
    values.par_chunks_mut(slab).enumerate().for_each(|(i, slab)| {
        for (n, value) in slab.iter_mut().enumerate() {
            let (j, k) = (n / size[2], n % size[2]);
            let block = uniform[((i / BLOCK) * blocks[1] + j / BLOCK) * blocks[2] + k / BLOCK];
            *value = if block == 0.0 { figure.distance(&grid.to_body(&at(i, j, k))) } else { block };
        }
    });
    values
}

impl Half {
    /// Both halves. The right one's vertices follow the left one's in the same order, without those in the middle.
    fn mirrored(&self) -> Symmetric {
        let half = self.mesh.vertices.len();
        let mut mesh = self.mesh.clone();
        let mut mirror: Vec<u32> = (0..half as u32).collect();
        for v in (0..half).filter(|&v| !self.middle[v]) {
            let p = self.mesh.vertices[v];
            mirror[v] = mesh.vertices.len() as u32;
            mirror.push(v as u32);
            mesh.vertices.push(Vec3::new(-p.x, p.y, p.z));
        }
        mesh.faces.extend(self.mesh.faces.iter().map(|f| [f[0], f[2], f[1]].map(|v| mirror[v as usize])));
        Symmetric { mesh, half, mirror }
    }

    /// Normals; in the middle without x, as those of the whole are.
    fn normals(&self) -> Vec<Vec3> {
        let mut normals = mesh::vertex_normals(&self.mesh.vertices, &self.mesh.faces);
        for (n, _) in normals.iter_mut().zip(&self.middle).filter(|(_, middle)| **middle) {
            n.x = 0.0;
            *n = n.try_normalize(1e-9).unwrap_or(*n);
        }
        normals
    }

    /// Moves vertices along the surface towards the mean of their neighbours, and back onto the surface.
    fn relax(&mut self, figure: &Figure, rounds: usize) {
        let adjacency = Adjacency::new(self.mesh.vertices.len(), &self.mesh.faces);
        for _ in 0..rounds {
            let normals = self.normals();
            let (old, middle) = (&self.mesh.vertices, &self.middle);
            self.mesh.vertices = (0..old.len())
                .into_par_iter()
                .map(|v| {
                    let (mut sum, mut count) = (Vec3::zeros(), 0.0);
                    for &w in adjacency.of(v) {
                        // A vertex in the middle has the mirror images of its neighbours around it, too.
                        let p = old[w as usize];
                        let twice = middle[v] && !middle[w as usize];
                        sum += if twice { Vec3::new(0.0, 2.0 * p.y, 2.0 * p.z) } else { p };
                        count += if twice { 2.0 } else { 1.0 };
                    }
                    let step = (sum / count - old[v]) * 0.6;
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
    fn project(&mut self, figure: &Figure) {
        self.mesh.vertices.par_iter_mut().zip(&self.middle).for_each(|(p, middle)| {
            for _ in 0..3 {
                let mut g = figure.gradient(p);
                if *middle {
                    g.x = 0.0;
                }
                // A flat gradient (a seam of two solids) has no direction to go.
                *p -= g * (figure.distance(p) / g.norm_squared().max(0.1));
            }
        });
    }

    /// Stretches heights by the little that is missing, so that soles and crown are exactly where the figure says.
    fn stand(&mut self) {
        let Some((low, high)) = self.mesh.bounds() else { return };
        let (down, up) = (PELVIS_HEIGHT / -low.y, (STATURE - PELVIS_HEIGHT) / high.y);
        for p in &mut self.mesh.vertices {
            p.y *= if p.y < 0.0 { down } else { up };
        }
    }

    /// Flips edges where that brings the four vertices nearer to six neighbours each.
    fn flip_edges(&mut self) {
        let (mesh, middle) = (&mut self.mesh, &self.middle);
        // Faces and flips beside the middle count for both sides.
        let both = |v: u32| if middle[v as usize] { 2 } else { 1 };
        let mut degree = vec![0i32; mesh.vertices.len()];
        mesh.faces.iter().flatten().for_each(|&v| degree[v as usize] += both(v));
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
            let along_middle = middle[c as usize] && middle[d as usize];
            if touched[f] || touched[g] || along_middle || edges.contains(&key(c, d)) {
                continue;
            }
            let cost = |change: i32| -> i32 {
                [(a, -change), (b, -change), (c, change), (d, change)]
                    .iter()
                    .map(|&(v, change)| (degree[v as usize] + change * both(v) - 6).pow(2))
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
                for (v, change) in [(a, -1), (b, -1), (c, 1), (d, 1)] {
                    degree[v as usize] += change * both(v);
                }
            }
        }
    }
}
