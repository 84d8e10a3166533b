//! Distance to the body: a shared grid for shaping cloth, an exact query for checking it.

use caphy_core::{TriMesh, Vec3};
use rayon::prelude::*;

/// Cell of the distance grid [m].
const CELL: f64 = 0.008;
/// Distances beyond this are not told apart [m].
const BAND: f64 = 0.024;

/// Signed distance to the outer surface of a body on a regular grid [m], positive outside, cut off at ±[`BAND`].
#[derive(Debug, Clone)]
pub(crate) struct DistanceGrid {
    origin: Vec3,
    size: [usize; 3],
    values: Vec<f32>,
}

/// What of a triangle is nearest: a corner, a side (from corner k to the next) or the inside.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Feature {
    Corner(usize),
    Side(usize),
    Inside,
}

/// Nearest point of a triangle.
pub(crate) fn nearest_on_triangle(p: &Vec3, corners: &[Vec3; 3]) -> Vec3 {
    nearest_feature(p, corners).0
}

fn nearest_feature(p: &Vec3, [a, b, c]: &[Vec3; 3]) -> (Vec3, Feature) {
    let (ab, ac, ap) = (b - a, c - a, p - a);
    let (d1, d2) = (ab.dot(&ap), ac.dot(&ap));
    if d1 <= 0.0 && d2 <= 0.0 {
        return (*a, Feature::Corner(0));
    }
    let bp = p - b;
    let (d3, d4) = (ab.dot(&bp), ac.dot(&bp));
    if d3 >= 0.0 && d4 <= d3 {
        return (*b, Feature::Corner(1));
    }
    let vc = d1 * d4 - d3 * d2;
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        return (a + ab * (d1 / (d1 - d3)), Feature::Side(0));
    }
    let cp = p - c;
    let (d5, d6) = (ab.dot(&cp), ac.dot(&cp));
    if d6 >= 0.0 && d5 <= d6 {
        return (*c, Feature::Corner(2));
    }
    let vb = d5 * d2 - d1 * d6;
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        return (a + ac * (d2 / (d2 - d6)), Feature::Side(2));
    }
    let va = d3 * d6 - d5 * d4;
    if va <= 0.0 && d4 >= d3 && d5 >= d6 {
        return (b + (c - b) * ((d4 - d3) / ((d4 - d3) + (d5 - d6))), Feature::Side(1));
    }
    let sum = va + vb + vc;
    if sum <= 0.0 {
        return (*a, Feature::Corner(0));
    }
    (a + ab * (vb / sum) + ac * (vc / sum), Feature::Inside)
}

impl DistanceGrid {
    /// Distances to `mesh` inside a box. What can be reached from the box's corner without crossing the surface is outside,
    /// so inner parts (mouth, eyes) do not matter; the surface itself tells the sign only within half a cell.
    pub(crate) fn new(mesh: &TriMesh, low: Vec3, high: Vec3) -> Self {
        let pad = Vec3::repeat(BAND + 2.0 * CELL);
        let (low, high) = (low - pad, high + pad);
        let size: [usize; 3] =
            std::array::from_fn(|k| ((((high[k] - low[k]) / CELL).ceil().max(1.0)) as usize + 1).min(800));
        let turned = if signed_volume(mesh) < 0.0 { -1.0 } else { 1.0 };
        let [nx, ny, nz] = size;
        let plane = nx * ny;
        // (squared distance, cosine between the offset and the nearest face's normal)
        let mut nearest = vec![(f32::INFINITY, 0f32); plane * nz];
        nearest.par_chunks_mut(plane * 8).enumerate().for_each(|(chunk, part)| {
            let z0 = chunk * 8;
            let z1 = z0 + part.len() / plane - 1;
            for f in 0..mesh.faces.len() {
                let corners = mesh.corners(f);
                let range = |k: usize, top: usize| {
                    let lo = corners.iter().map(|c| c[k]).fold(f64::INFINITY, f64::min) - BAND - low[k];
                    let hi = corners.iter().map(|c| c[k]).fold(f64::NEG_INFINITY, f64::max) + BAND - low[k];
                    ((lo / CELL).ceil().max(0.0) as usize, ((hi / CELL).floor().min(top as f64 - 1.0)))
                };
                let (zl, zh) = range(2, nz);
                let (zl, zh) = (zl.max(z0), zh.min(z1 as f64));
                let ((xl, xh), (yl, yh)) = (range(0, nx), range(1, ny));
                if zl as f64 > zh || xl as f64 > xh || yl as f64 > yh {
                    continue;
                }
                let normal = (corners[1] - corners[0]).cross(&(corners[2] - corners[0]));
                let normal = normal.try_normalize(0.0).unwrap_or_else(Vec3::zeros) * turned;
                for z in zl..=zh as usize {
                    for y in yl..=yh as usize {
                        for x in xl..=xh as usize {
                            let p = low + Vec3::new(x as f64, y as f64, z as f64) * CELL;
                            if normal.dot(&(p - corners[0])).abs() > BAND {
                                continue;
                            }
                            let offset = p - nearest_on_triangle(&p, &corners);
                            let d2 = offset.norm_squared() as f32;
                            let slot = &mut part[(z - z0) * plane + y * nx + x];
                            let cosine = (offset.dot(&normal) / offset.norm().max(1e-12)) as f32;
                            // Several faces share a nearest edge or corner: the one faced most squarely knows the side.
                            let same = (d2 - slot.0).abs() <= 1e-6 * d2;
                            if (same && cosine.abs() > slot.1.abs()) || (!same && d2 < slot.0) {
                                *slot = (d2, cosine);
                            }
                        }
                    }
                }
            }
        });
        let free = (0.51 * CELL * 0.51 * CELL) as f32;
        let mut outside = vec![false; nearest.len()];
        let mut stack = vec![0usize];
        outside[0] = true;
        while let Some(at) = stack.pop() {
            let (x, y, z) = (at % nx, (at / nx) % ny, at / plane);
            let mut visit = |ok: bool, to: usize| {
                if ok && !outside[to] && nearest[to].0 > free {
                    outside[to] = true;
                    stack.push(to);
                }
            };
            visit(x > 0, at.wrapping_sub(1));
            visit(x + 1 < nx, at + 1);
            visit(y > 0, at.wrapping_sub(nx));
            visit(y + 1 < ny, at + nx);
            visit(z > 0, at.wrapping_sub(plane));
            visit(z + 1 < nz, at + plane);
        }
        // Nodes too near to the surface to be reached: outside when they face it from outside and the outside is next to them.
        let beside_outside = |at: usize| {
            let (x, y, z) = (at % nx, (at / nx) % ny, at / plane);
            (x > 0 && outside[at - 1])
                || (x + 1 < nx && outside[at + 1])
                || (y > 0 && outside[at - nx])
                || (y + 1 < ny && outside[at + nx])
                || (z > 0 && outside[at - plane])
                || (z + 1 < nz && outside[at + plane])
        };
        let values = nearest
            .iter()
            .enumerate()
            .map(|(at, &(d2, cosine))| {
                let d = d2.sqrt().min(BAND as f32);
                if outside[at] || (d2 <= free && cosine >= 0.0 && beside_outside(at)) { d } else { -d }
            })
            .collect();
        Self { origin: low, size, values }
    }

    /// Distance by trilinear interpolation [m]; [`BAND`] outside the grid.
    pub(crate) fn value(&self, p: &Vec3) -> f64 {
        let t = (p - self.origin) / CELL;
        let inside = |k: usize| t[k] >= 0.0 && t[k] < (self.size[k] - 1) as f64;
        if !(inside(0) && inside(1) && inside(2)) {
            return BAND;
        }
        let [x, y, z] = [t.x as usize, t.y as usize, t.z as usize];
        let [fx, fy, fz] = [t.x - x as f64, t.y - y as f64, t.z - z as f64];
        let [nx, ny, _] = self.size;
        let at = |i: usize, j: usize, k: usize| f64::from(self.values[((z + k) * ny + y + j) * nx + x + i]);
        let row = |j: usize, k: usize| at(0, j, k) * (1.0 - fx) + at(1, j, k) * fx;
        let sheet = |k: usize| row(0, k) * (1.0 - fy) + row(1, k) * fy;
        sheet(0) * (1.0 - fz) + sheet(1) * fz
    }
}

/// Unit vertex normals weighted by the angle of each face, which do not depend on how quads are cut; zero without faces.
pub(crate) fn angle_weighted_normals(mesh: &TriMesh) -> Vec<Vec3> {
    let mut normals = vec![Vec3::zeros(); mesh.vertices.len()];
    for (f, face) in mesh.faces.iter().enumerate() {
        let p = mesh.corners(f);
        let n = (p[1] - p[0]).cross(&(p[2] - p[0])).try_normalize(0.0).unwrap_or_else(Vec3::zeros);
        for k in 0..3 {
            normals[face[k] as usize] += n * (p[(k + 1) % 3] - p[k]).angle(&(p[(k + 2) % 3] - p[k]));
        }
    }
    normals.into_iter().map(|n| n.try_normalize(0.0).unwrap_or_else(Vec3::zeros)).collect()
}

fn signed_volume(mesh: &TriMesh) -> f64 {
    (0..mesh.faces.len())
        .map(|f| {
            let [a, b, c] = mesh.corners(f);
            a.dot(&b.cross(&c))
        })
        .sum()
}

/// Triangles of a body sorted into cells, for exact nearest points.
#[derive(Debug, Clone)]
pub(crate) struct TriangleCells {
    triangles: Vec<[Vec3; 3]>,
    /// Vertex ids of each triangle.
    faces: Vec<[u32; 3]>,
    /// Unit normals: of each triangle, of its three sides (mean of both faces), of each vertex (weighted by angle). With these
    /// the sign of the distance is right at corners and sides, too (Bærentzen and Aanæs 2005).
    face_normals: Vec<Vec3>,
    side_normals: Vec<[Vec3; 3]>,
    vertex_normals: Vec<Vec3>,
    origin: Vec3,
    size: [i64; 3],
    starts: Vec<u32>,
    ids: Vec<u32>,
}

/// Cell of the exact search [m].
const SEARCH_CELL: f64 = 0.03;

impl TriangleCells {
    /// Sorts the triangles of a mesh.
    pub(crate) fn new(mesh: &TriMesh) -> Self {
        let triangles: Vec<[Vec3; 3]> = (0..mesh.faces.len()).map(|f| mesh.corners(f)).collect();
        let (low, high) = mesh.bounds().unwrap_or((Vec3::zeros(), Vec3::zeros()));
        let size: [i64; 3] = std::array::from_fn(|k| (((high[k] - low[k]) / SEARCH_CELL) as i64 + 1).clamp(1, 400));
        let mut entries: Vec<(u32, u32)> = Vec::new();
        let cell = |v: f64, k: usize| (((v - low[k]) / SEARCH_CELL) as i64).clamp(0, size[k] - 1);
        for (id, t) in triangles.iter().enumerate() {
            let range = |k: usize| {
                let lo = t.iter().map(|c| c[k]).fold(f64::INFINITY, f64::min);
                let hi = t.iter().map(|c| c[k]).fold(f64::NEG_INFINITY, f64::max);
                cell(lo, k)..=cell(hi, k)
            };
            for z in range(2) {
                for y in range(1) {
                    for x in range(0) {
                        entries.push((((z * size[1] + y) * size[0] + x) as u32, id as u32));
                    }
                }
            }
        }
        entries.sort_unstable();
        let cells = (size[0] * size[1] * size[2]) as usize;
        let mut starts = vec![0u32; cells + 1];
        for &(c, _) in &entries {
            starts[c as usize + 1] += 1;
        }
        for c in 0..cells {
            starts[c + 1] += starts[c];
        }
        let turned = if signed_volume(mesh) < 0.0 { -1.0 } else { 1.0 };
        let unit = |n: Vec3| n.try_normalize(0.0).unwrap_or_else(Vec3::zeros);
        let face_normals: Vec<Vec3> =
            triangles.iter().map(|[a, b, c]| unit((b - a).cross(&(c - a))) * turned).collect();
        let vertex_normals = angle_weighted_normals(mesh).into_iter().map(|n| n * turned).collect();
        let mut by_edge: std::collections::HashMap<[u32; 2], Vec3> = std::collections::HashMap::new();
        for (face, n) in mesh.faces.iter().zip(&face_normals) {
            for k in 0..3 {
                let (a, b) = (face[k], face[(k + 1) % 3]);
                *by_edge.entry([a.min(b), a.max(b)]).or_insert_with(Vec3::zeros) += n;
            }
        }
        let side = |f: &[u32; 3], k: usize| {
            let (a, b) = (f[k], f[(k + 1) % 3]);
            by_edge.get(&[a.min(b), a.max(b)]).map_or_else(Vec3::zeros, |n| unit(*n))
        };
        let side_normals = mesh.faces.iter().map(|f| [side(f, 0), side(f, 1), side(f, 2)]).collect();
        let ids = entries.into_iter().map(|(_, id)| id).collect();
        let faces = mesh.faces.clone();
        Self { triangles, faces, face_normals, side_normals, vertex_normals, origin: low, size, starts, ids }
    }
    /// Nearest surface point, its signed distance [m] (negative inside) and the direction out of the body there; no farther
    /// than `limit`. The sign is that of the surface nearby: where parts of a body overlap, ask a [`DistanceGrid`] too.
    pub(crate) fn signed(&self, p: &Vec3, limit: f64) -> Option<(Vec3, f64, Vec3)> {
        let (q, d, id) = self.nearest_triangle(p, limit)?;
        let id = id as usize;
        let normal = match nearest_feature(p, &self.triangles[id]).1 {
            Feature::Corner(k) => self.vertex_normals[self.faces[id][k] as usize],
            Feature::Side(k) => self.side_normals[id][k],
            Feature::Inside => self.face_normals[id],
        };
        let sign = if (p - q).dot(&normal) < 0.0 { -1.0 } else { 1.0 };
        // On the surface itself the offset has no direction.
        let out = if d > 1e-7 { (p - q) * (sign / d) } else { normal };
        Some((q, sign * d, out))
    }
    /// Nearest surface point, its distance [m] and triangle, no farther than `limit`.
    fn nearest_triangle(&self, p: &Vec3, limit: f64) -> Option<(Vec3, f64, u32)> {
        let mut best: Option<(Vec3, f64, u32)> = None;
        let mut reach = limit;
        let base: [i64; 3] = std::array::from_fn(|k| ((p[k] - self.origin[k]) / SEARCH_CELL).floor() as i64);
        let rings = (limit / SEARCH_CELL).ceil() as i64 + 1;
        for ring in 0..=rings {
            if (ring - 1) as f64 * SEARCH_CELL > reach {
                break;
            }
            let range = |k: usize| (base[k] - ring).max(0)..=(base[k] + ring).min(self.size[k] - 1);
            for z in range(2) {
                for y in range(1) {
                    for x in range(0) {
                        let shell = [x - base[0], y - base[1], z - base[2]].iter().any(|d| d.abs() == ring);
                        if !shell {
                            continue;
                        }
                        let cell = ((z * self.size[1] + y) * self.size[0] + x) as usize;
                        for &id in &self.ids[self.starts[cell] as usize..self.starts[cell + 1] as usize] {
                            let q = nearest_on_triangle(p, &self.triangles[id as usize]);
                            let d = (p - q).norm();
                            if d < reach {
                                reach = d;
                                best = Some((q, d, id));
                            }
                        }
                    }
                }
            }
        }
        best
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// An octahedron subdivided to a sphere of radius 0.1 m.
    fn sphere() -> TriMesh {
        let mut corners = vec![];
        for (sx, sy, sz) in [
            (1., 1., 1.),
            (-1., 1., 1.),
            (1., -1., 1.),
            (1., 1., -1.),
            (-1., -1., 1.),
            (-1., 1., -1.),
            (1., -1., -1.),
            (-1., -1., -1.),
        ] {
            let (a, b, c) = (Vec3::x() * sx, Vec3::y() * sy, Vec3::z() * sz);
            corners.push(if sx * sy * sz > 0.0 { [a, b, c] } else { [a, c, b] });
        }
        for _ in 0..4 {
            corners = corners
                .into_iter()
                .flat_map(|[a, b, c]| {
                    let m = |p: Vec3, q: Vec3| (p + q).normalize();
                    let (ab, bc, ca) = (m(a, b), m(b, c), m(c, a));
                    [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
                })
                .collect();
        }
        let vertices: Vec<Vec3> = corners.iter().flatten().map(|p| p * 0.1).collect();
        let faces = (0..corners.len() as u32).map(|f| [3 * f, 3 * f + 1, 3 * f + 2]).collect();
        TriMesh { vertices, faces }
    }

    #[test]
    fn grid_and_exact_distances_of_a_sphere() {
        let mesh = sphere();
        let grid = DistanceGrid::new(&mesh, Vec3::repeat(-0.1), Vec3::repeat(0.1));
        let cells = TriangleCells::new(&mesh);
        let plane = |f: usize| {
            let [a, b, c] = mesh.corners(f);
            (b - a).cross(&(c - a)).normalize().dot(&a).abs()
        };
        let sag = 0.1 - (0..mesh.faces.len()).map(plane).fold(f64::INFINITY, f64::min);
        assert!(sag < 4e-4, "the sphere of this test is round to {sag} m");
        for i in 0..200 {
            let a = f64::from(i) * 2.399963;
            let z = 1.0 - (f64::from(i) + 0.5) / 100.0;
            let r = (1.0 - z * z).sqrt();
            let n = Vec3::new(r * a.cos(), r * a.sin(), z);
            for depth in [-0.012, -0.004, -0.001, 0.001, 0.004, 0.012] {
                let p = n * (0.1 + depth);
                // The facets sag below the sphere; a trilinear cell adds h²/8 times the sum of both curvatures, 2/r at the
                // corner of the cell nearest to the centre.
                assert!((cells.nearest_triangle(&p, 0.05).unwrap().1 - depth.abs()).abs() < sag + 1e-9);
                let (_, signed, out) = cells.signed(&p, 0.05).unwrap();
                assert!((signed - depth).abs() < sag + 1e-9 && out.dot(&n) > 0.9);
                let corner = 0.1 + depth - 3f64.sqrt() * CELL;
                let bound = sag + CELL * CELL / 8.0 * 2.0 / corner;
                assert!((grid.value(&p) - depth).abs() < bound, "{depth} {}", grid.value(&p));
            }
        }
        assert!(grid.value(&Vec3::zeros()) < -0.02);
        assert!(cells.signed(&Vec3::repeat(1.0), 0.05).is_none());
    }
}
