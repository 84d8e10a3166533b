//! Distance to the body: a shared grid for shaping cloth, an exact query for checking it.

use caphy_core::query::{NearestSurface, PseudoNormals, nearest_on_triangle};
use caphy_core::{Result, TriMesh, Vec3};
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
                            let offset = p - nearest_on_triangle(&p, &corners).point;
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

/// A body's surface with its outside, for exact nearest points.
#[derive(Debug, Clone)]
pub(crate) struct Skin {
    surface: NearestSurface,
    /// With these the sign of the distance is right at corners and sides, too (Bærentzen and Aanæs 2005).
    normals: PseudoNormals,
    /// -1 for a surface whose faces look inward.
    turned: f64,
}

impl Skin {
    /// Of a body's mesh.
    ///
    /// # Errors
    /// Those of [`NearestSurface::from_mesh`].
    pub(crate) fn new(mesh: &TriMesh) -> Result<Self> {
        Ok(Self {
            surface: NearestSurface::from_mesh(mesh)?,
            normals: PseudoNormals::new(&mesh.vertices, &mesh.faces),
            turned: if signed_volume(mesh) < 0.0 { -1.0 } else { 1.0 },
        })
    }
    /// Nearest surface point, its signed distance [m] (negative inside) and the direction out of the body there; no farther
    /// than `limit`. The sign is that of the surface nearby: where parts of a body overlap, ask a [`DistanceGrid`] too.
    pub(crate) fn signed(&self, p: &Vec3, limit: f64) -> Option<(Vec3, f64, Vec3)> {
        let nearest = self.surface.nearest_within(p, limit * limit)?;
        let normal = self.normals.at(&nearest) * self.turned;
        let (q, d) = (nearest.point, nearest.squared_distance.sqrt());
        let sign = if (p - q).dot(&normal) < 0.0 { -1.0 } else { 1.0 };
        // On the surface itself the offset has no direction.
        let out = if d > 1e-7 { (p - q) * (sign / d) } else { normal.try_normalize(0.0).unwrap_or_else(Vec3::zeros) };
        Some((q, sign * d, out))
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
        let skin = Skin::new(&mesh).unwrap();
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
                let (_, signed, out) = skin.signed(&p, 0.05).unwrap();
                assert!((signed - depth).abs() < sag + 1e-9 && out.dot(&n) > 0.9);
                let corner = 0.1 + depth - 3f64.sqrt() * CELL;
                let bound = sag + CELL * CELL / 8.0 * 2.0 / corner;
                assert!((grid.value(&p) - depth).abs() < bound, "{depth} {}", grid.value(&p));
            }
        }
        assert!(grid.value(&Vec3::zeros()) < -0.02);
        assert!(skin.signed(&Vec3::repeat(1.0), 0.05).is_none());
    }
}
