//! From the level function to a first, uneven mesh: marching tetrahedra, then the cuts.

use super::shape::Shape;
use caphy_core::query::Adjacency;
use caphy_core::{TriMesh, Vec3};
use std::collections::HashMap;

/// Corner offsets of a cube, bit k of the index along axis k.
fn corner(i: usize) -> [usize; 3] {
    [i & 1, (i >> 1) & 1, (i >> 2) & 1]
}

/// The six tetrahedra around a cube's main diagonal; neighbouring cubes agree on their faces' diagonals, so the surface
/// is a manifold.
const TETRAHEDRA: [[usize; 4]; 6] =
    [[0, 1, 3, 7], [0, 3, 2, 7], [0, 2, 6, 7], [0, 6, 4, 7], [0, 4, 5, 7], [0, 5, 1, 7]];

/// The zero level of a shape inside its box, oriented outward, cut by all its cuts, largest component only.
pub(crate) fn extract(shape: &Shape<'_>, cell: f64) -> TriMesh {
    let pad = Vec3::repeat(2.0 * cell);
    let (mut low, high) = (shape.low - pad, shape.high + pad);
    // Nodes of the coarse grid lie in the middle plane: the slot between two wide trouser legs is narrower than a cell.
    low.x = shape.middle() - ((shape.middle() - low.x) / (2.0 * cell)).ceil() * 2.0 * cell;
    let size: [usize; 3] = std::array::from_fn(|k| ((high[k] - low[k]) / cell).ceil().clamp(1.0, 600.0) as usize + 1);
    let [nx, ny, nz] = size;
    let index = |x: usize, y: usize, z: usize| (z * ny + y) * nx + x;
    let place = |x: usize, y: usize, z: usize| low + Vec3::new(x as f64, y as f64, z as f64) * cell;
    let values = sample(shape, &low, cell, size);
    let mut mesh = TriMesh::default();
    let mut edge_vertex: HashMap<(u32, u32), u32> = HashMap::new();
    for z in 0..nz - 1 {
        for y in 0..ny - 1 {
            for x in 0..nx - 1 {
                let ids: [usize; 8] = std::array::from_fn(|i| {
                    let [a, b, c] = corner(i);
                    index(x + a, y + b, z + c)
                });
                let inside = ids.iter().filter(|&&i| values[i] < 0.0).count();
                if inside == 0 || inside == 8 {
                    continue;
                }
                let mut vertex = |i: usize, j: usize| -> u32 {
                    let (a, b) = (ids[i], ids[j]);
                    let key = (a.min(b) as u32, a.max(b) as u32);
                    *edge_vertex.entry(key).or_insert_with(|| {
                        let p = |i: usize| {
                            let [a, b, c] = corner(i);
                            place(x + a, y + b, z + c)
                        };
                        let (i, j) = if a < b { (i, j) } else { (j, i) };
                        let (f, g) = (values[ids[i]], values[ids[j]]);
                        mesh.vertices.push(p(i).lerp(&p(j), (f / (f - g)).clamp(0.02, 0.98)));
                        mesh.vertices.len() as u32 - 1
                    })
                };
                for tet in TETRAHEDRA {
                    let (mut low, mut high) = (Vec::with_capacity(4), Vec::with_capacity(4));
                    for i in tet {
                        if values[ids[i]] < 0.0 { low.push(i) } else { high.push(i) }
                    }
                    let at = |i: usize| {
                        let [a, b, c] = corner(i);
                        Vec3::new(a as f64, b as f64, c as f64)
                    };
                    let mean = |of: &[usize]| of.iter().map(|&i| at(i)).sum::<Vec3>() / of.len().max(1) as f64;
                    let outward = mean(&high) - mean(&low);
                    let half = |i: usize, j: usize| 0.5 * (at(i) + at(j));
                    let mut add = |t: [(usize, usize); 3]| {
                        let [a, b, c] = t.map(|(i, j)| half(i, j));
                        let mut ids = t.map(|(i, j)| vertex(i, j));
                        if (b - a).cross(&(c - a)).dot(&outward) < 0.0 {
                            ids.swap(1, 2);
                        }
                        mesh.faces.push(ids);
                    };
                    match (low.as_slice(), high.as_slice()) {
                        (&[a], &[b, c, d]) | (&[b, c, d], &[a]) => add([(a, b), (a, c), (a, d)]),
                        (&[a, b], &[c, d]) => {
                            add([(a, c), (a, d), (b, d)]);
                            add([(a, c), (b, d), (b, c)]);
                        }
                        _ => {}
                    }
                }
            }
        }
    }
    for cut in &shape.cuts {
        mesh = clip(&mesh, |p| cut.value(p), 0.02 * cell);
    }
    largest_component(mesh)
}

/// Values at the nodes of the grid: everywhere on a grid of double cells, between only near the zero level.
fn sample(shape: &Shape<'_>, low: &Vec3, cell: f64, [nx, ny, nz]: [usize; 3]) -> Vec<f64> {
    let mut values = vec![f64::NAN; nx * ny * nz];
    let place = |x: usize, y: usize, z: usize| low + Vec3::new(x as f64, y as f64, z as f64) * cell;
    let index = |x: usize, y: usize, z: usize| (z * ny + y) * nx + x;
    // Beyond the cuts nothing is kept: whatever is there, a constant outside value closes the surface, and the cut opens it
    // again.
    let margin = 6.0 * cell;
    let value = |p: &Vec3| {
        if shape.cuts.iter().any(|c| c.value(p) > margin) { 1.0 } else { shape.value(p) }
    };
    for z in 0..nz {
        for y in 0..ny {
            for x in 0..nx {
                if (x | y | z) & 1 == 0 {
                    values[index(x, y, z)] = value(&place(x, y, z));
                }
            }
        }
    }
    // The level function changes by less than about three times the distance, so twice a coarse cell's diagonal is safe.
    let far = 6.0 * cell;
    for z in 0..nz {
        for y in 0..ny {
            for x in 0..nx {
                if (x | y | z) & 1 == 0 {
                    continue;
                }
                let around = |k: usize, n: usize| [k & !1, if k & 1 == 1 && k + 1 < n { k + 1 } else { k & !1 }];
                let (xs, ys, zs) = (around(x, nx), around(y, ny), around(z, nz));
                let mut bounds = (f64::INFINITY, f64::NEG_INFINITY);
                for &k in &zs {
                    for &j in &ys {
                        for &i in &xs {
                            let v = values[index(i, j, k)];
                            bounds = (bounds.0.min(v), bounds.1.max(v));
                        }
                    }
                }
                values[index(x, y, z)] = if bounds.0 > far {
                    bounds.0
                } else if bounds.1 < -far {
                    bounds.1
                } else {
                    value(&place(x, y, z))
                };
            }
        }
    }
    values
}

/// The part of a mesh where `level` is negative; triangles on the border are cut.
fn clip(mesh: &TriMesh, level: impl Fn(&Vec3) -> f64, smallest: f64) -> TriMesh {
    // No vertex counts as lying on the cut: slivers vanish in remeshing, pinched loops would not.
    let levels: Vec<f64> = mesh
        .vertices
        .iter()
        .map(|p| {
            let g = level(p);
            if g.abs() < smallest { smallest.copysign(g) } else { g }
        })
        .collect();
    let mut out = TriMesh { vertices: mesh.vertices.clone(), faces: Vec::with_capacity(mesh.faces.len()) };
    let mut cut_vertex: HashMap<(u32, u32), u32> = HashMap::new();
    for f in &mesh.faces {
        let kept = f.map(|v| levels[v as usize] < 0.0);
        let mut crossing = |a: u32, b: u32| -> u32 {
            *cut_vertex.entry((a.min(b), a.max(b))).or_insert_with(|| {
                let (a, b) = (a.min(b) as usize, a.max(b) as usize);
                let t = levels[a] / (levels[a] - levels[b]);
                out.vertices.push(mesh.vertices[a].lerp(&mesh.vertices[b], t));
                out.vertices.len() as u32 - 1
            })
        };
        match kept.iter().filter(|&&k| k).count() {
            3 => out.faces.push(*f),
            count @ (1 | 2) => {
                // Turn the triangle so that its odd corner comes first.
                let odd = (0..3).find(|&k| kept[k] == (count == 1)).unwrap_or(0);
                let [a, b, c] = [f[odd], f[(odd + 1) % 3], f[(odd + 2) % 3]];
                let (ab, ac) = (crossing(a, b), crossing(a, c));
                if count == 1 {
                    out.faces.push([a, ab, ac]);
                } else {
                    out.faces.push([ab, b, c]);
                    out.faces.push([ab, c, ac]);
                }
            }
            _ => {}
        }
    }
    out
}

/// The component with most faces; unused vertices dropped.
fn largest_component(mesh: TriMesh) -> TriMesh {
    let (component, count) = Adjacency::new(mesh.vertices.len(), &mesh.faces).components();
    let mut faces = vec![0usize; count];
    for f in &mesh.faces {
        faces[component[f[0] as usize] as usize] += 1;
    }
    let Some(best) = (0..count).max_by_key(|&c| (faces[c], std::cmp::Reverse(c))) else { return mesh };
    let keep: Vec<bool> = component.iter().map(|&c| c as usize == best).collect();
    mesh.submesh(&keep).0
}
