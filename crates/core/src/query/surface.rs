//! Exact nearest points of a triangulated surface.

use super::cells::Cells;
use super::triangle::{TriangleFeature, TrianglePoint, is_sliver, nearest_on_triangle};
use crate::{Error, Result, TriMesh, Vec3};

/// A point of a surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SurfacePoint {
    /// The triangle.
    pub face: u32,
    /// Weights of its corners: not negative, sum 1.
    pub barycentric: [f64; 3],
    /// Where on the triangle.
    pub feature: TriangleFeature,
    /// Position [m].
    pub point: Vec3,
    /// Squared distance to the query [m²].
    pub squared_distance: f64,
}

/// Exact nearest-point search over the triangles of a mesh.
///
/// Where several triangles are equally near (a shared edge or corner), the one with the smallest number is named.
#[derive(Debug, Clone)]
pub struct NearestSurface {
    cells: Cells<f64>,
    /// Triangle of each slot; a triangle has a slot in every cell that it touches.
    faces: Vec<u32>,
    corners: Vec<[Vec3; 3]>,
    /// Smallest and largest coordinates of each triangle, a little wider.
    boxes: Vec<[Vec3; 2]>,
}

/// Slots per triangle above which cells are made larger.
const SLOTS: usize = 12;

impl NearestSurface {
    /// Sorts the triangles of a mesh into cells; any finite triangles will do, also without area.
    ///
    /// # Errors
    /// [`Error::Mesh`] naming a face whose vertex does not exist or is not finite.
    pub fn new(vertices: &[Vec3], faces: &[[u32; 3]]) -> Result<Self> {
        let mut corners = Vec::with_capacity(faces.len());
        for (f, face) in faces.iter().enumerate() {
            let mut triangle = [Vec3::zeros(); 3];
            for (corner, &id) in triangle.iter_mut().zip(face) {
                let position = vertices.get(id as usize).filter(|p| p.iter().all(|c| c.is_finite()));
                *corner = *position.ok_or_else(|| {
                    let problem = match vertices.get(id as usize) {
                        None => format!("vertex id {id} but there are {} vertices", vertices.len()),
                        Some(p) => format!("vertex {id} at ({}, {}, {}) is not finite", p.x, p.y, p.z),
                    };
                    Error::mesh("surface to search", format!("face {f}"), problem, "repair the mesh")
                })?;
            }
            corners.push(triangle);
        }
        let bounds = |points: &mut dyn Iterator<Item = &Vec3>| {
            let first = points.next().copied().unwrap_or_else(Vec3::zeros);
            points.fold([first, first], |[lo, hi], p| [lo.inf(p), hi.sup(p)])
        };
        let [low, high] = bounds(&mut corners.as_flattened().iter());
        let longest = (high - low).max();
        // Far above the rounding of distances, far below any triangle.
        let margin = Vec3::repeat(1e-10 * longest);
        let boxes: Vec<[Vec3; 2]> = corners
            .iter()
            .map(|t| {
                let [lo, hi] = bounds(&mut t.iter());
                [lo - margin, hi + margin]
            })
            .collect();
        let mean = boxes.iter().map(|[lo, hi]| (hi - lo).max()).sum::<f64>() / boxes.len().max(1) as f64;
        let array = |v: &Vec3| [v.x, v.y, v.z];
        let mut edge = mean.max(longest / 256.0).max(1e-9);
        let mut cells = Cells::new(array(&low), array(&high), edge);
        // Where triangles differ much in size, the large ones would fill memory.
        while boxes.iter().map(|[lo, hi]| cells.count_in_box(&array(lo), &array(hi))).sum::<usize>()
            > SLOTS * boxes.len()
        {
            edge *= 1.5;
            cells = Cells::new(array(&low), array(&high), edge);
        }
        let mut entries = Vec::with_capacity(4 * boxes.len());
        for (f, ([lo, hi], corners)) in boxes.iter().zip(&corners).enumerate() {
            // Cells of its box that a triangle's plane does not cross are left out.
            let [a, b, c] = corners;
            let normal = if is_sliver(corners) { None } else { (b - a).cross(&(c - a)).try_normalize(0.0) };
            // Half a cell's diagonal, and a little for rounding.
            let reach = cells.edge() * (0.75f64.sqrt() + 1e-2);
            cells.in_box(&array(lo), &array(hi), |cell, middle| {
                let away = normal.map_or(0.0, |n| n.dot(&(Vec3::from(middle) - a)).abs());
                if away <= reach {
                    entries.push((cell, f as u32));
                }
            });
        }
        let faces = cells.fill(&entries);
        Ok(Self { cells, faces, corners, boxes })
    }
    /// [`NearestSurface::new`] of a mesh.
    ///
    /// # Errors
    /// Those of [`NearestSurface::new`].
    pub fn from_mesh(mesh: &TriMesh) -> Result<Self> {
        Self::new(&mesh.vertices, &mesh.faces)
    }
    /// Whether there is no triangle to find.
    pub fn is_empty(&self) -> bool {
        self.corners.is_empty()
    }
    /// Nearest point of the surface; `None` without triangles or for a non-finite query.
    pub fn nearest(&self, query: &Vec3) -> Option<SurfacePoint> {
        self.search(query, None, f64::INFINITY)
    }
    /// As [`NearestSurface::nearest`], but only points with squared distance below `limit` [m²].
    pub fn nearest_within(&self, query: &Vec3, limit: f64) -> Option<SurfacePoint> {
        self.search(query, None, limit)
    }
    /// As [`NearestSurface::nearest`], to the last bit, and the faster the nearer the triangle `known` is: the answer of the
    /// frame before, or of a neighbour. A number that names no triangle does not help.
    pub fn nearest_from(&self, query: &Vec3, known: u32) -> Option<SurfacePoint> {
        match self.corners.get(known as usize) {
            None => self.nearest(query),
            Some(corners) => {
                let found = named(known, nearest_on_triangle(query, corners));
                self.search(query, Some(found), found.squared_distance)
            }
        }
    }
    fn search(&self, query: &Vec3, mut best: Option<SurfacePoint>, mut limit: f64) -> Option<SurfacePoint> {
        if self.corners.is_empty() || !query.iter().all(|c| c.is_finite()) {
            return None;
        }
        self.cells.search(&[query.x, query.y, query.z], limit, |slots| {
            for &face in &self.faces[slots] {
                let [low, high] = &self.boxes[face as usize];
                let away = (low - query).sup(&(query - high)).sup(&Vec3::zeros());
                if away.norm_squared() > limit || best.is_some_and(|b| b.face == face) {
                    continue;
                }
                let found = nearest_on_triangle(query, &self.corners[face as usize]);
                let d = found.squared_distance;
                let better = match &best {
                    None => d < limit,
                    Some(b) => d < b.squared_distance || (d == b.squared_distance && face < b.face),
                };
                if better {
                    best = Some(named(face, found));
                    limit = d;
                }
            }
            limit
        });
        best
    }
}

fn named(face: u32, at: TrianglePoint) -> SurfacePoint {
    let TrianglePoint { barycentric, feature, point, squared_distance } = at;
    SurfacePoint { face, barycentric, feature, point, squared_distance }
}
