//! How far a simulated shape is from a scan: rows of a least-squares problem.
//!
//! Known vertices give one row per coordinate. A scanned surface gives, for each of its points, the distance along the garment's
//! normal at the nearest place, and past the garment's edge also the distance across that edge: without it a longer and a
//! shorter cloth would fit alike. The other way round, garment vertices are measured to the scan's surface; those rows keep
//! the garment from leaving the scan and balance its edge, but repeat the noise of the same points, so that they do not count as
//! measurements. A garment vertex whose nearest scan point lies on the border of a hole was not seen, and has no row.

use super::capture::ScanPoints;
use crate::GarmentRest;
use caphy_core::query::{NearestSurface, SurfacePoint, TriangleFeature, hinges};
use caphy_core::{Result, Vec3, mesh};
use std::collections::HashSet;

/// Share of a row from a garment vertex inside the cloth.
const REPEATED: f64 = 0.25;

/// One distance along a direction.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Row {
    /// Garment vertices around the garment's point, and their weights there.
    pub(crate) vertices: [u32; 3],
    pub(crate) weights: [f64; 3],
    /// Unit direction.
    pub(crate) direction: Vec3,
    /// Distance of the garment's point from the scan's along it [m].
    pub(crate) distance: f64,
    /// Share of the cost.
    pub(crate) share: f64,
    /// Whether it is a measurement of its own.
    pub(crate) counts: bool,
    /// 1 where the garment ends beyond the scan, −1 where the scan ends beyond the garment, else 0.
    pub(crate) beyond: i8,
}

/// Vertices and edges of a mesh's border.
#[derive(Debug, Clone, Default)]
struct Border {
    vertices: Vec<bool>,
    edges: HashSet<[u32; 2]>,
}

impl Border {
    fn new(vertex_count: usize, faces: &[[u32; 3]]) -> Self {
        let (inner, bad) = hinges(faces);
        let shared: HashSet<[u32; 2]> = inner
            .iter()
            .map(|h| sorted(h.vertices[0], h.vertices[1]))
            .chain(bad.into_iter().map(|[a, b]| sorted(a, b)))
            .collect();
        let mut out = Self { vertices: vec![false; vertex_count], edges: HashSet::new() };
        for face in faces {
            for k in 0..3 {
                let edge = sorted(face[k], face[(k + 1) % 3]);
                if !shared.contains(&edge) {
                    edge.iter().for_each(|&v| out.vertices[v as usize] = true);
                    out.edges.insert(edge);
                }
            }
        }
        out
    }
    fn holds(&self, faces: &[[u32; 3]], at: &SurfacePoint) -> bool {
        let face = faces[at.face as usize];
        match at.feature {
            TriangleFeature::Inside => false,
            TriangleFeature::Corner(k) => self.vertices[face[k as usize] as usize],
            TriangleFeature::Side(k) => self.edges.contains(&sorted(face[k as usize], face[(k as usize + 1) % 3])),
        }
    }
}

fn sorted(a: u32, b: u32) -> [u32; 2] {
    [a.min(b), a.max(b)]
}

/// A scan that shapes of one garment are compared with.
pub(crate) struct Comparison {
    scan: ScanPoints,
    /// The scan's triangles, where it has any.
    surface: Option<(NearestSurface, Border)>,
    garment: Border,
    faces: Vec<[u32; 3]>,
    /// Garment vertices that do not move.
    fixed: Vec<bool>,
}

impl Comparison {
    pub(crate) fn new(rest: &GarmentRest, scan: &ScanPoints, fixed: &[u32]) -> Result<Self> {
        let surface = match scan {
            ScanPoints::Surface { points, faces, .. } if !faces.is_empty() => {
                Some((NearestSurface::new(points, faces)?, Border::new(points.len(), faces)))
            }
            _ => None,
        };
        let mut is_fixed = vec![false; rest.vertex_count()];
        fixed.iter().for_each(|&v| is_fixed[v as usize] = true);
        Ok(Self {
            scan: scan.clone(),
            surface,
            garment: Border::new(rest.vertex_count(), rest.faces()),
            faces: rest.faces().to_vec(),
            fixed: is_fixed,
        })
    }

    /// Rows at a shape [m].
    pub(crate) fn rows(&self, x: &[Vec3]) -> Result<Vec<Row>> {
        let mut out = match &self.scan {
            ScanPoints::Known { vertices, points } => {
                let axis = |k: usize| Vec3::from_fn(|r, _| f64::from(u8::from(r == k)));
                let of = |(&v, p): (&u32, &Vec3)| {
                    let d = x[v as usize] - p;
                    [0, 1, 2].map(|k| Row {
                        vertices: [v; 3],
                        weights: [1.0, 0.0, 0.0],
                        direction: axis(k),
                        distance: d[k],
                        share: 1.0,
                        counts: true,
                        beyond: 0,
                    })
                };
                vertices.iter().zip(points).flat_map(of).collect()
            }
            ScanPoints::Surface { points, visible, .. } => {
                let mut rows = self.scan_rows(x, points)?;
                rows.extend(self.garment_rows(x, visible.as_deref())?);
                rows
            }
        };
        out.retain(|r| r.vertices.iter().zip(&r.weights).any(|(&v, &w)| w > 0.0 && !self.fixed[v as usize]));
        Ok(out)
    }

    fn scan_rows(&self, x: &[Vec3], points: &[Vec3]) -> Result<Vec<Row>> {
        let normals = mesh::vertex_normals(x, &self.faces);
        let found = NearestSurface::new(x, &self.faces)?.nearest_all(points, None)?;
        let mut rows = Vec::with_capacity(points.len());
        for (c, at) in points.iter().zip(&found) {
            let vertices = self.faces[at.face as usize];
            let d = at.point - c;
            let corner = |k: usize| x[vertices[k] as usize];
            let row = |direction: Vec3| Row {
                vertices,
                weights: at.barycentric,
                direction,
                distance: direction.dot(&d),
                share: 1.0,
                counts: true,
                beyond: 0,
            };
            if self.garment.holds(&self.faces, at) {
                let Some(n) = (corner(1) - corner(0)).cross(&(corner(2) - corner(0))).try_normalize(0.0) else {
                    continue;
                };
                rows.push(row(n));
                if let Some(across) = (d - n * n.dot(&d)).try_normalize(1e-12) {
                    rows.push(Row { beyond: -1, ..row(across) });
                }
            } else {
                let n: Vec3 = (0..3).map(|k| normals[vertices[k] as usize] * at.barycentric[k]).sum();
                rows.extend(n.try_normalize(0.0).map(row));
            }
        }
        Ok(rows)
    }

    fn garment_rows(&self, x: &[Vec3], visible: Option<&[bool]>) -> Result<Vec<Row>> {
        let (Some((surface, border)), ScanPoints::Surface { points, faces, .. }) = (&self.surface, &self.scan) else {
            return Ok(Vec::new());
        };
        let found = surface.nearest_all(x, None)?;
        let mut rows = Vec::new();
        for (v, at) in found.iter().enumerate() {
            if !visible.is_none_or(|mask| mask[v]) {
                continue;
            }
            let (own, other) = (self.garment.vertices[v], border.holds(faces, at));
            if other && !own {
                continue;
            }
            let d = x[v] - at.point;
            let face = faces[at.face as usize].map(|k| points[k as usize]);
            let Some(n) = (face[1] - face[0]).cross(&(face[2] - face[0])).try_normalize(0.0) else { continue };
            let row = |direction: Vec3, share: f64| Row {
                vertices: [v as u32; 3],
                weights: [1.0, 0.0, 0.0],
                direction,
                distance: direction.dot(&d),
                share,
                counts: false,
                beyond: 0,
            };
            rows.push(row(n, REPEATED));
            if other && let Some(across) = (d - n * n.dot(&d)).try_normalize(1e-12) {
                rows.push(Row { counts: true, beyond: 1, ..row(across, 1.0) });
            }
        }
        Ok(rows)
    }

    /// Where springs pull each garment vertex that the scan shows [m]: its own point, or the nearest one.
    pub(crate) fn targets(&self, x: &[Vec3]) -> Result<(Vec<u32>, Vec<Vec3>)> {
        match &self.scan {
            ScanPoints::Known { vertices, points } => Ok((vertices.clone(), points.clone())),
            ScanPoints::Surface { points, faces, visible } => {
                let seen = |v: &usize| visible.as_ref().is_none_or(|mask| mask[*v]) && !self.fixed[*v];
                let ids: Vec<usize> = (0..x.len()).filter(seen).collect();
                let places: Vec<Vec3> = ids.iter().map(|&v| x[v]).collect();
                Ok(match &self.surface {
                    Some((surface, border)) => surface
                        .nearest_all(&places, None)?
                        .into_iter()
                        .zip(ids)
                        .filter(|(at, v)| self.garment.vertices[*v] || !border.holds(faces, at))
                        .map(|(at, v)| (v as u32, at.point))
                        .unzip(),
                    None => {
                        let grid = caphy_core::query::NearestGrid::from_points(points);
                        ids.iter()
                            .zip(&places)
                            .filter_map(|(&v, p)| Some((v as u32, points[grid.nearest_point(p)?.0 as usize])))
                            .unzip()
                    }
                })
            }
        }
    }
}
