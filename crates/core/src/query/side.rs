//! On which side of a surface a point lies.

use super::surface::SurfacePoint;
use super::triangle::TriangleFeature;
use crate::Vec3;

/// Normals of faces, edges and vertices that tell the side of any point from its nearest surface point.
///
/// The normal of a face decides wrongly where the nearest point lies on an edge or a corner; the sum of the faces at an edge,
/// and the faces at a vertex weighted by their angles there, decide rightly (Bærentzen, Aanæs 2005, *Signed distance
/// computation using the angle weighted pseudonormal*). That holds for closed surfaces of one orientation whose faces share
/// their vertices; beyond the border of an open one the side is that of the border's own normal.
#[derive(Debug, Clone)]
pub struct PseudoNormals {
    corners: Vec<[u32; 3]>,
    faces: Vec<Vec3>,
    sides: Vec<[Vec3; 3]>,
    vertices: Vec<Vec3>,
}

impl PseudoNormals {
    /// From a mesh whose ids are in range; faces without area count nothing.
    pub fn new(vertices: &[Vec3], faces: &[[u32; 3]]) -> Self {
        let mut at_vertices = vec![Vec3::zeros(); vertices.len()];
        let mut normals = Vec::with_capacity(faces.len());
        let mut edges: Vec<([u32; 2], u32, u8)> = Vec::with_capacity(3 * faces.len());
        for (f, face) in faces.iter().enumerate() {
            let p = face.map(|id| vertices[id as usize]);
            let normal = (p[1] - p[0]).cross(&(p[2] - p[0])).try_normalize(0.0).unwrap_or_else(Vec3::zeros);
            for k in 0..3 {
                let (next, last) = ((k + 1) % 3, (k + 2) % 3);
                let angle = (p[next] - p[k]).angle(&(p[last] - p[k]));
                at_vertices[face[k] as usize] += normal * angle;
                let (a, b) = (face[k], face[next]);
                edges.push(([a.min(b), a.max(b)], f as u32, k as u8));
            }
            normals.push(normal);
        }
        edges.sort_unstable();
        let mut sides = vec![[Vec3::zeros(); 3]; faces.len()];
        for shared in edges.chunk_by(|a, b| a.0 == b.0) {
            let sum: Vec3 = shared.iter().map(|&(_, f, _)| normals[f as usize]).sum();
            for &(_, f, k) in shared {
                sides[f as usize][k as usize] = sum;
            }
        }
        Self { corners: faces.to_vec(), faces: normals, sides, vertices: at_vertices }
    }
    /// The normal at a point of the surface, not of unit length.
    pub fn at(&self, point: &SurfacePoint) -> Vec3 {
        let face = point.face as usize;
        match point.feature {
            TriangleFeature::Inside => self.faces[face],
            TriangleFeature::Side(k) => self.sides[face][k as usize],
            TriangleFeature::Corner(k) => self.vertices[self.corners[face][k as usize] as usize],
        }
    }
    /// Distance of `query` from its nearest surface point [m], negative inside.
    pub fn signed_distance(&self, query: &Vec3, nearest: &SurfacePoint) -> f64 {
        let distance = nearest.squared_distance.sqrt();
        if self.at(nearest).dot(&(query - nearest.point)) < 0.0 { -distance } else { distance }
    }
}
