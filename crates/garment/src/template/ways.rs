//! Shortest ways on a garment.
//!
//! On a mesh of edges alone ways are some percent too long, as its triangles happen to lie: two triangulations of one sleeve differ
//! by more than a tailor's tape. So ways run straight across triangles, between points along their edges (Lanthier et al. 1997); first
//! between few, then between many around the way that was found.

use caphy_core::{TriMesh, Vec3};
use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet, BinaryHeap};

/// Points on each edge between its ends, on all of the garment and around a way. On irregular triangles ways are with these too long by
/// half a percent, and by three ten-thousandths.
const FEW: usize = 6;
const MANY: usize = 40;
/// Most times that a way is looked for around the one before, and what one has to gain for another.
const ROUNDS: usize = 8;
const GAIN: f64 = 1e-4;

/// A mesh on which ways between loops of vertices are looked for.
pub(super) struct Lengths<'a> {
    mesh: &'a TriMesh,
    rough: Ways,
}

impl<'a> Lengths<'a> {
    pub(super) fn new(mesh: &'a TriMesh) -> Self {
        Self { mesh, rough: Ways::new(mesh, 0..mesh.faces.len() as u32, FEW) }
    }
    /// Length of the shortest way from one loop to another [m]; infinite where there is none.
    pub(super) fn between(&self, from: &[u32], to: &[u32]) -> f64 {
        let Some(mut way) = self.rough.shortest(from, to) else { return f64::INFINITY };
        for _ in 0..ROUNDS {
            let near = Ways::new(self.mesh, around(self.mesh, &way.faces), MANY);
            let Some(next) = near.shortest(from, to) else { break };
            let gained = way.length - next.length;
            way = next;
            if gained < GAIN * way.length {
                break;
            }
        }
        way.length
    }
}

/// Triangles within two rings of some.
fn around(mesh: &TriMesh, faces: &BTreeSet<u32>) -> BTreeSet<u32> {
    let mut all = faces.clone();
    for _ in 0..2 {
        let mut touched = vec![false; mesh.vertices.len()];
        all.iter().flat_map(|&f| mesh.faces[f as usize]).for_each(|v| touched[v as usize] = true);
        let touches = |f: &u32| mesh.faces[*f as usize].iter().any(|&v| touched[v as usize]);
        all = (0..mesh.faces.len() as u32).filter(touches).collect();
    }
    all
}

/// Where ways on a mesh can bend: its vertices, then points on its edges.
struct Ways {
    points: Vec<Vec3>,
    /// Triangles around each point, as places in `border`.
    around: Vec<Vec<u32>>,
    /// Some triangles of the mesh, and the points on their borders.
    border: Vec<(u32, Vec<u32>)>,
    /// First point on each edge, by its ends in order, and how many there are.
    edges: BTreeMap<[u32; 2], u32>,
    between: usize,
}

/// A way: its length [m] and the triangles that it runs through.
struct Way {
    length: f64,
    faces: BTreeSet<u32>,
}

impl Ways {
    fn new(mesh: &TriMesh, faces: impl IntoIterator<Item = u32>, between: usize) -> Self {
        let mut points = mesh.vertices.clone();
        let mut edges: BTreeMap<[u32; 2], u32> = BTreeMap::new();
        let mut around: Vec<Vec<u32>> = vec![Vec::new(); points.len()];
        let mut border = Vec::new();
        for face in faces {
            let [a, b, c] = mesh.faces[face as usize];
            let mut own = vec![a, b, c];
            for [from, to] in [[a, b], [b, c], [c, a]].map(sorted) {
                let first = *edges.entry([from, to]).or_insert_with(|| {
                    let first = points.len() as u32;
                    let ends = [from, to].map(|v| points[v as usize]);
                    points.extend((1..=between).map(|k| ends[0].lerp(&ends[1], k as f64 / (between + 1) as f64)));
                    around.resize(points.len(), Vec::new());
                    first
                });
                own.extend(first..first + between as u32);
            }
            own.iter().for_each(|&p| around[p as usize].push(border.len() as u32));
            border.push((face, own));
        }
        Self { points, around, border, edges, between }
    }

    /// All points on a loop of vertices.
    fn along(&self, ring: &[u32]) -> Vec<u32> {
        let next = ring.iter().cycle().skip(1);
        let between = ring.iter().zip(next).filter_map(|(&a, &b)| self.edges.get(&sorted([a, b])));
        ring.iter().copied().chain(between.flat_map(|&first| first..first + self.between as u32)).collect()
    }

    /// The shortest way from one loop of vertices to another (Dijkstra).
    fn shortest(&self, from: &[u32], to: &[u32]) -> Option<Way> {
        // Lengths are not negative: their bits sort as they do.
        let mut best = vec![f64::INFINITY; self.points.len()];
        let mut came: Vec<Option<(u32, u32)>> = vec![None; self.points.len()];
        let mut end = vec![false; self.points.len()];
        self.along(to).into_iter().for_each(|p| end[p as usize] = true);
        let mut queue: BinaryHeap<Reverse<(u64, u32)>> = BinaryHeap::new();
        for p in self.along(from) {
            best[p as usize] = 0.0;
            queue.push(Reverse((0, p)));
        }
        while let Some(Reverse((bits, at))) = queue.pop() {
            let length = f64::from_bits(bits);
            if length > best[at as usize] {
                continue;
            }
            if end[at as usize] {
                let back = std::iter::successors(came[at as usize], |(_, before)| came[*before as usize]);
                return Some(Way { length, faces: back.map(|(face, _)| face).collect() });
            }
            for &place in &self.around[at as usize] {
                let (face, border) = &self.border[place as usize];
                for &next in border {
                    let length = length + (self.points[next as usize] - self.points[at as usize]).norm();
                    if length < best[next as usize] {
                        best[next as usize] = length;
                        came[next as usize] = Some((*face, at));
                        queue.push(Reverse((length.to_bits(), next)));
                    }
                }
            }
        }
        None
    }
}

fn sorted([a, b]: [u32; 2]) -> [u32; 2] {
    [a.min(b), a.max(b)]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A flat sheet of irregular triangles, 0.5 m by 0.3 m, turned in its plane.
    fn sheet(turn: f64) -> (TriMesh, impl Fn(u32, u32) -> u32) {
        let (n, m) = (25u32, 15u32);
        let at = move |i: u32, j: u32| i * (m + 1) + j;
        let mut mesh = TriMesh::default();
        for i in 0..=n {
            for j in 0..=m {
                let inner = i > 0 && i < n && j > 0 && j < m;
                let shake = |a: f64| if inner { 0.007 * (a * f64::from(at(i, j))).sin() } else { 0.0 };
                let (x, y) = (0.02 * f64::from(i) + shake(12.9898), 0.02 * f64::from(j) + shake(78.233));
                mesh.vertices.push(Vec3::new(x * turn.cos() - y * turn.sin(), x * turn.sin() + y * turn.cos(), 0.0));
            }
        }
        for i in 0..n {
            for j in 0..m {
                let [p, q, r, s] = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
                mesh.faces.extend(if (i + j) % 3 == 0 { [[p, q, r], [p, r, s]] } else { [[p, q, s], [q, r, s]] });
            }
        }
        (mesh, at)
    }

    #[test]
    fn ways_on_irregular_triangles_are_straight() {
        let (mesh, at) = sheet(0.3);
        let lengths = Lengths::new(&mesh);
        for (from, to) in [((0, 0), (25, 15)), ((0, 0), (25, 4)), ((3, 2), (9, 15)), ((0, 15), (20, 1))] {
            let [a, b] = [from, to].map(|(i, j)| at(i, j));
            let straight = (mesh.vertices[a as usize] - mesh.vertices[b as usize]).norm();
            let found = lengths.between(&[a], &[b]);
            assert!(found >= straight - 1e-12 && found < 1.0003 * straight, "{found} {straight}");
            let rough = lengths.rough.shortest(&[a], &[b]).unwrap();
            assert!(rough.length < 1.006 * straight, "{} {straight}", rough.length);
        }
    }

    #[test]
    fn ways_begin_and_end_anywhere_on_loops() {
        // The shortest way to the diagonal of a square ends at its middle, which is half of a distance of points from the next one.
        let mesh = TriMesh {
            vertices: vec![Vec3::zeros(), Vec3::x(), Vec3::y(), Vec3::new(1.0, 1.0, 0.0)],
            faces: vec![[0, 1, 2], [1, 3, 2]],
        };
        let lengths = Lengths::new(&mesh);
        let to_diagonal = lengths.between(&[0], &[1, 2]);
        let off = (0.5f64.sqrt()).hypot(0.5 * 2f64.sqrt() / (MANY + 1) as f64);
        assert!((to_diagonal - off).abs() < 1e-12, "{to_diagonal} {off}");
        // Across the diagonal, and along one side.
        assert!((lengths.between(&[0], &[3]) - off - off).abs() < 1e-12 && lengths.between(&[0], &[0, 1]) == 0.0);
        let apart = TriMesh { vertices: mesh.vertices.repeat(2), faces: vec![[0, 1, 2], [4, 5, 6]] };
        assert_eq!(Lengths::new(&apart).between(&[0], &[4, 5]), f64::INFINITY);
    }
}
