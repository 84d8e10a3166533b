//! Exact nearest points of a triangulated surface.

use super::triangle::{TriangleFeature, TrianglePoint, Weights, is_sliver};
use crate::mesh::bounds;
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

/// Exact nearest-point search over the triangles of a mesh: a tree of boxes, nearer branches first.
///
/// Triangles of a mesh overlap many cells of a grid or few, as their sizes differ; a tree does not care, and is faster from
/// afar. Where several triangles are equally near (a shared edge or corner), the one with the smallest number is named.
#[derive(Debug, Clone)]
pub struct NearestSurface {
    /// Parents before children; the left child of a node is the next one.
    nodes: Vec<Node>,
    /// Triangles in the order of the leaves.
    triangles: Vec<Triangle>,
    /// Place of each face in that order.
    slots: Vec<u32>,
}

#[derive(Debug, Clone)]
struct Triangle {
    corners: [Vec3; 3],
    face: u32,
    sliver: bool,
}

#[derive(Debug, Clone)]
struct Node {
    low: Vec3,
    high: Vec3,
    /// First triangle of a leaf, right child of an inner node.
    at: u32,
    /// Triangles of a leaf, 0 for an inner node.
    count: u32,
}

/// Most triangles of a leaf.
const LEAF: usize = 4;
/// Branches that can wait: halving gives at most one per level, and faces are counted in 32 bits.
const WAITING: usize = 33;

impl NearestSurface {
    /// Sorts the triangles of a mesh into a tree; any finite triangles will do, also without area.
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
        let longest = bounds(corners.as_flattened()).map_or(0.0, |(low, high)| (high - low).max());
        // Far above the rounding of distances, far below any triangle.
        let margin = Vec3::repeat(1e-10 * longest);
        let boxes: Vec<(Vec3, Vec3)> =
            corners.iter().map(|[a, b, c]| (a.inf(b).inf(c) - margin, a.sup(b).sup(c) + margin)).collect();
        let mut order: Vec<u32> = (0..corners.len() as u32).collect();
        let mut nodes = Vec::with_capacity(corners.len());
        if !order.is_empty() {
            grow(&mut nodes, &mut order, 0, &boxes);
        }
        let triangle = |&face: &u32| {
            let corners = corners[face as usize];
            Triangle { corners, face, sliver: is_sliver(&corners) }
        };
        let mut slots = vec![0; order.len()];
        for (slot, &face) in order.iter().enumerate() {
            slots[face as usize] = slot as u32;
        }
        Ok(Self { nodes, triangles: order.iter().map(triangle).collect(), slots })
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
        self.triangles.is_empty()
    }
    /// Nearest point of the surface; `None` without triangles, for a query that is not finite, or one so far that the squared
    /// distance is not.
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
        let known = self.slots.get(known as usize).map(|&slot| &self.triangles[slot as usize]);
        self.search(query, known, f64::INFINITY)
    }
    fn search<'a>(&'a self, query: &Vec3, known: Option<&'a Triangle>, limit: f64) -> Option<SurfacePoint> {
        if self.nodes.is_empty() || !query.iter().all(|c| c.is_finite()) {
            return None;
        }
        let mut best = Best { limit, found: None };
        if let Some(triangle) = known {
            best.offer(query, triangle);
        }
        // Branches that wait, with the squared distance of their boxes.
        let mut waiting = [(0.0, 0u32); WAITING];
        let mut count = 1;
        while count > 0 {
            count -= 1;
            let (away, mut at) = waiting[count];
            if away > best.limit {
                continue;
            }
            loop {
                let node = &self.nodes[at as usize];
                if node.count > 0 {
                    for triangle in &self.triangles[node.at as usize..][..node.count as usize] {
                        best.offer(query, triangle);
                    }
                    break;
                }
                let children = [at + 1, node.at];
                let [left, right] = children.map(|child| self.nodes[child as usize].away(query));
                let (near, far) = if right < left { (1, 0) } else { (0, 1) };
                let (nearer, farther) = (left.min(right), left.max(right));
                if farther <= best.limit {
                    waiting[count] = (farther, children[far]);
                    count += 1;
                }
                if nearer > best.limit {
                    break;
                }
                at = children[near];
            }
        }
        best.found.map(|(triangle, at)| {
            let TrianglePoint { barycentric, feature, point, squared_distance } = at.on(&triangle.corners);
            SurfacePoint { face: triangle.face, barycentric, feature, point, squared_distance }
        })
    }
}

/// What was found, and the squared distance that counts from now on [m²].
struct Best<'a> {
    limit: f64,
    found: Option<(&'a Triangle, Weights)>,
}

impl<'a> Best<'a> {
    #[inline(always)]
    fn offer(&mut self, query: &Vec3, triangle: &'a Triangle) {
        let at = Weights::of_nearest(query, &triangle.corners, triangle.sliver);
        let d = at.squared_distance;
        let better = match &self.found {
            None => d < self.limit,
            Some((other, _)) => d < self.limit || (d == self.limit && triangle.face < other.face),
        };
        if better {
            *self = Self { limit: d, found: Some((triangle, at)) };
        }
    }
}

impl Node {
    /// Squared distance to the box, never more than a computed distance to anything in it.
    #[inline(always)]
    fn away(&self, query: &Vec3) -> f64 {
        let offset = (self.low - query).sup(&(query - self.high)).sup(&Vec3::zeros());
        offset.norm_squared() * (1.0 - 16.0 * f64::EPSILON)
    }
}

/// Appends the tree of some faces, halved at the middle one along the longest side of their centres' box.
fn grow(nodes: &mut Vec<Node>, order: &mut [u32], first: u32, boxes: &[(Vec3, Vec3)]) {
    let of = |&face: &u32| boxes[face as usize];
    let Some(all) = order.iter().map(of).reduce(|(l, h), (low, high)| (l.inf(&low), h.sup(&high))) else { return };
    let me = nodes.len();
    nodes.push(Node { low: all.0, high: all.1, at: first, count: order.len() as u32 });
    if order.len() <= LEAF {
        return;
    }
    // Twice the centre.
    let centre = |face: &u32| boxes[*face as usize].0 + boxes[*face as usize].1;
    let start = centre(&order[0]);
    let (low, high) = order.iter().map(centre).fold((start, start), |(l, h), c| (l.inf(&c), h.sup(&c)));
    let axis = (high - low).imax();
    let half = order.len() / 2;
    order.select_nth_unstable_by(half, |a, b| centre(a)[axis].total_cmp(&centre(b)[axis]).then(a.cmp(b)));
    let (left, right) = order.split_at_mut(half);
    grow(nodes, left, first, boxes);
    (nodes[me].at, nodes[me].count) = (nodes.len() as u32, 0);
    grow(nodes, right, first + half as u32, boxes);
}
