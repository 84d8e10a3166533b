//! Mesh queries that several crates need: adjacency, boundary loops, hinges, exact nearest points.

use crate::{Real, Vec3};
use std::collections::HashMap;

/// Neighbours of each vertex along edges, in compressed rows, each row sorted.
#[derive(Debug, Clone, PartialEq)]
pub struct Adjacency {
    offsets: Vec<u32>,
    neighbours: Vec<u32>,
}

impl Adjacency {
    /// From the faces of a mesh of `vertex_count` vertices.
    pub fn new(vertex_count: usize, faces: &[[u32; 3]]) -> Self {
        let mut pairs: Vec<(u32, u32)> =
            faces.iter().flat_map(|&[a, b, c]| [(a, b), (b, a), (b, c), (c, b), (c, a), (a, c)]).collect();
        pairs.sort_unstable();
        pairs.dedup();
        let mut offsets = vec![0u32; vertex_count + 1];
        for &(a, _) in &pairs {
            offsets[a as usize + 1] += 1;
        }
        for i in 0..vertex_count {
            offsets[i + 1] += offsets[i];
        }
        Self { offsets, neighbours: pairs.into_iter().map(|(_, b)| b).collect() }
    }
    /// Neighbours of one vertex.
    pub fn of(&self, vertex: usize) -> &[u32] {
        &self.neighbours[self.offsets[vertex] as usize..self.offsets[vertex + 1] as usize]
    }
    /// Number of vertices.
    pub fn vertex_count(&self) -> usize {
        self.offsets.len() - 1
    }
    /// Component number of each vertex, and the number of components.
    pub fn components(&self) -> (Vec<u32>, usize) {
        let n = self.vertex_count();
        let mut component = vec![u32::MAX; n];
        let mut count = 0;
        let mut stack = Vec::new();
        for start in 0..n {
            if component[start] != u32::MAX {
                continue;
            }
            component[start] = count;
            stack.push(start);
            while let Some(v) = stack.pop() {
                for &w in self.of(v) {
                    if component[w as usize] == u32::MAX {
                        component[w as usize] = count;
                        stack.push(w as usize);
                    }
                }
            }
            count += 1;
        }
        (component, count as usize)
    }
}

/// An interior edge and its two faces: `f0 = (n0, n1, n2)`, `f1 = (n1, n0, n3)` up to rotation.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Hinge {
    /// Vertices n0, n1 (the edge), n2, n3 (opposite corners).
    pub vertices: [u32; 4],
    /// Faces on the n2 side and on the n3 side.
    pub faces: [u32; 2],
}

/// Hinges of a mesh, sorted by edge; edges with one face are boundary, with three or more non-manifold, with two faces
/// of opposite orientation flipped: the latter two come back in `bad` as vertex pairs.
pub fn hinges(faces: &[[u32; 3]]) -> (Vec<Hinge>, Vec<[u32; 2]>) {
    // (edge low, high) -> (from, to, opposite, face)
    let mut sides: Vec<([u32; 2], u32, u32, u32)> = Vec::with_capacity(faces.len() * 3);
    for (f, face) in faces.iter().enumerate() {
        for k in 0..3 {
            let (a, b, c) = (face[k], face[(k + 1) % 3], face[(k + 2) % 3]);
            sides.push(([a.min(b), a.max(b)], a, c, f as u32));
        }
    }
    sides.sort_unstable();
    let (mut good, mut bad) = (Vec::new(), Vec::new());
    for group in sides.chunk_by(|a, b| a.0 == b.0) {
        match group {
            [_] => {}
            [(edge, from0, c0, f0), (_, from1, c1, f1)] if from0 != from1 => {
                // Let n0 -> n1 run low to high.
                let (c2, c3, fa, fb) = if *from0 == edge[0] { (*c0, *c1, *f0, *f1) } else { (*c1, *c0, *f1, *f0) };
                good.push(Hinge { vertices: [edge[0], edge[1], c2, c3], faces: [fa, fb] });
            }
            _ => bad.push(group[0].0),
        }
    }
    (good, bad)
}

/// Closed loops of boundary edges, each as vertex ids in the order of the faces' orientation, longest first.
pub fn boundary_loops(faces: &[[u32; 3]]) -> Vec<Vec<u32>> {
    let mut directed: HashMap<(u32, u32), ()> = HashMap::new();
    for f in faces {
        for k in 0..3 {
            directed.insert((f[k], f[(k + 1) % 3]), ());
        }
    }
    let mut next: HashMap<u32, Vec<u32>> = HashMap::new();
    for &(a, b) in directed.keys() {
        if !directed.contains_key(&(b, a)) {
            next.entry(a).or_default().push(b);
        }
    }
    for targets in next.values_mut() {
        targets.sort_unstable_by(|a, b| b.cmp(a));
    }
    let mut starts: Vec<u32> = next.keys().copied().collect();
    starts.sort_unstable();
    let mut loops = Vec::new();
    for start in starts {
        while let Some(first) = next.get_mut(&start).and_then(Vec::pop) {
            let mut ring = vec![start];
            let mut at = first;
            while at != start {
                ring.push(at);
                match next.get_mut(&at).and_then(Vec::pop) {
                    Some(n) => at = n,
                    None => break,
                }
            }
            loops.push(ring);
        }
    }
    loops.sort_by_key(|l| (std::cmp::Reverse(l.len()), l[0]));
    loops
}

/// Exact nearest-point search over a fixed set of points: a uniform grid of cells, searched in growing shells.
///
/// Ties go to the smallest index, so results do not depend on build order or thread count.
#[derive(Debug, Clone)]
pub struct NearestGrid<T> {
    origin: [T; 3],
    cell: T,
    inverse_cell: T,
    size: [i32; 3],
    starts: Vec<u32>,
    ids: Vec<u32>,
    points: Vec<[T; 3]>,
}

impl<T: Real> NearestGrid<T> {
    /// Builds from points [m]; non-finite points are left out. About two points share a cell.
    pub fn new(points: &[[T; 3]]) -> Self {
        let finite = |p: &[T; 3]| p.iter().all(|c| c.is_finite());
        let mut lo = [T::infinity(); 3];
        let mut hi = [T::neg_infinity(); 3];
        let mut count = 0usize;
        for p in points.iter().filter(|p| finite(p)) {
            count += 1;
            for k in 0..3 {
                lo[k] = lo[k].min(p[k]);
                hi[k] = hi[k].max(p[k]);
            }
        }
        if count == 0 {
            lo = [T::zero(); 3];
            hi = lo;
        }
        let extent: [f64; 3] = std::array::from_fn(|k| (hi[k] - lo[k]).to_f64());
        let longest = extent.iter().copied().fold(1e-9, f64::max);
        // Surfaces fill about n^(2/3) of a cube's cells: choose the cell so that a surface point finds company.
        let cell = (longest / (count.max(1) as f64 / 2.0).sqrt()).max(longest / 256.0);
        let size: [i32; 3] = std::array::from_fn(|k| ((extent[k] / cell) as i32 + 1).min(512));
        let cell = T::of(cell);
        let mut grid = Self {
            origin: lo,
            cell,
            inverse_cell: T::one() / cell,
            size,
            starts: vec![0; (size[0] * size[1] * size[2]) as usize + 1],
            ids: Vec::with_capacity(count),
            points: Vec::with_capacity(count),
        };
        let cells: Vec<u32> =
            points.iter().map(|p| if finite(p) { grid.index(grid.cell_of(p)) as u32 } else { u32::MAX }).collect();
        for &c in cells.iter().filter(|&&c| c != u32::MAX) {
            grid.starts[c as usize + 1] += 1;
        }
        for i in 1..grid.starts.len() {
            grid.starts[i] += grid.starts[i - 1];
        }
        let mut at = grid.starts.clone();
        grid.ids = vec![0; count];
        grid.points = vec![[T::zero(); 3]; count];
        for (id, &c) in cells.iter().enumerate().filter(|&(_, &c)| c != u32::MAX) {
            let slot = at[c as usize] as usize;
            grid.ids[slot] = id as u32;
            grid.points[slot] = points[id];
            at[c as usize] += 1;
        }
        grid
    }
    #[inline(always)]
    fn cell_of(&self, p: &[T; 3]) -> [i32; 3] {
        std::array::from_fn(|k| {
            let x = ((p[k] - self.origin[k]) * self.inverse_cell).to_f64();
            (x as i32).clamp(0, self.size[k] - 1)
        })
    }
    #[inline(always)]
    fn index(&self, c: [i32; 3]) -> usize {
        ((c[2] * self.size[1] + c[1]) * self.size[0] + c[0]) as usize
    }
    /// Id of the nearest point and the squared distance [m²]; `None` without points or for a non-finite query.
    pub fn nearest(&self, query: &[T; 3]) -> Option<(u32, T)> {
        self.nearest_within(query, T::infinity())
    }
    /// As [`NearestGrid::nearest`], but only points with squared distance below `limit` [m²]: a known good candidate's
    /// distance makes the search short.
    pub fn nearest_within(&self, query: &[T; 3], limit: T) -> Option<(u32, T)> {
        if self.ids.is_empty() || !query.iter().all(|c| c.is_finite()) {
            return None;
        }
        let centre = self.cell_of(query);
        // Distance from the query to the faces of its (clamped) cell's box decides when a shell cannot improve.
        let mut best: Option<(u32, T)> = None;
        let mut limit = limit;
        let rings = self.size.iter().copied().max().unwrap_or(1);
        for ring in 0..rings {
            if ring > 0 {
                // Everything outside the box of rings < ring lies at least this far away.
                let mut gap = T::infinity();
                for k in 0..3 {
                    let low_cell = centre[k] - ring + 1;
                    let high_cell = centre[k] + ring;
                    if low_cell > 0 {
                        let edge = self.origin[k] + T::of(f64::from(low_cell)) * self.cell;
                        gap = gap.min(query[k] - edge);
                    }
                    if high_cell < self.size[k] {
                        let edge = self.origin[k] + T::of(f64::from(high_cell)) * self.cell;
                        gap = gap.min(edge - query[k]);
                    }
                }
                if gap == T::infinity() {
                    break;
                }
                // Rounding of cell edges is far below a thousandth of a cell.
                let gap = gap - self.cell * T::of(1e-3);
                if gap > T::zero() && gap * gap > limit {
                    break;
                }
            }
            self.visit_ring(centre, ring, |slot| {
                let p = &self.points[slot];
                let d = (p[0] - query[0]) * (p[0] - query[0])
                    + (p[1] - query[1]) * (p[1] - query[1])
                    + (p[2] - query[2]) * (p[2] - query[2]);
                let id = self.ids[slot];
                let better = match best {
                    None => d < limit,
                    Some((best_id, best_d)) => d < best_d || (d == best_d && id < best_id),
                };
                if better {
                    best = Some((id, d));
                    limit = d;
                }
            });
        }
        best
    }
    #[inline(always)]
    fn visit_ring(&self, c: [i32; 3], ring: i32, mut visit: impl FnMut(usize)) {
        let range = |k: usize| ((c[k] - ring).max(0), (c[k] + ring).min(self.size[k] - 1));
        let ((x0, x1), (y0, y1), (z0, z1)) = (range(0), range(1), range(2));
        for z in z0..=z1 {
            for y in y0..=y1 {
                let shell = (z - c[2]).abs() == ring || (y - c[1]).abs() == ring;
                let mut row = |x0: i32, x1: i32| {
                    let from = self.starts[self.index([x0, y, z])] as usize;
                    let to = self.starts[self.index([x1, y, z]) + 1] as usize;
                    (from..to).for_each(&mut visit);
                };
                if shell {
                    row(x0, x1);
                } else {
                    if c[0] - ring >= 0 {
                        row(c[0] - ring, c[0] - ring);
                    }
                    if ring > 0 && c[0] + ring < self.size[0] {
                        row(c[0] + ring, c[0] + ring);
                    }
                }
            }
        }
    }
}

impl NearestGrid<f64> {
    /// Builds from vectors.
    pub fn from_points(points: &[Vec3]) -> Self {
        let arrays: Vec<[f64; 3]> = points.iter().map(|p| [p.x, p.y, p.z]).collect();
        Self::new(&arrays)
    }
    /// [`NearestGrid::nearest`] of a vector.
    pub fn nearest_point(&self, query: &Vec3) -> Option<(u32, f64)> {
        self.nearest(&[query.x, query.y, query.z])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn noise(seed: u32) -> f64 {
        let mut x = seed.wrapping_mul(2654435761).wrapping_add(12345);
        x ^= x >> 15;
        x = x.wrapping_mul(2246822519);
        x ^= x >> 13;
        f64::from(x) / f64::from(u32::MAX)
    }

    #[test]
    fn nearest_equals_brute_force_also_far_outside() {
        let points: Vec<[f64; 3]> = (0..2000)
            .map(|i| {
                let a = noise(3 * i) * std::f64::consts::TAU;
                [a.cos() * 0.3, noise(3 * i + 1), a.sin() * 0.2]
            })
            .collect();
        let grid = NearestGrid::new(&points);
        for q in 0..500 {
            let s = if q % 5 == 0 { 20.0 } else { 1.5 };
            let query = [0, 1, 2].map(|k| (noise(90_000 + 3 * q + k) - 0.5) * s + if k == 1 { 0.5 } else { 0.0 });
            let brute = points
                .iter()
                .enumerate()
                .map(|(i, p)| ((0..3).map(|k| (p[k] - query[k]).powi(2)).sum::<f64>(), i as u32))
                .min_by(|a, b| a.partial_cmp(b).unwrap())
                .unwrap();
            let (id, d) = grid.nearest(&query).unwrap();
            assert!((d - brute.0).abs() <= 1e-12 * brute.0 && id == brute.1, "query {q}");
        }
    }

    #[test]
    fn no_points_and_bad_queries_have_no_nearest() {
        assert!(NearestGrid::<f32>::new(&[]).nearest(&[0.0; 3]).is_none());
        let grid = NearestGrid::new(&[[0.0f32, f32::NAN, 0.0], [1.0, 1.0, 1.0]]);
        assert_eq!(grid.nearest(&[0.0; 3]).unwrap().0, 1);
        assert!(grid.nearest(&[f32::NAN; 3]).is_none());
    }

    #[test]
    fn a_strip_has_one_hinge_and_one_loop() {
        let faces = [[0, 1, 2], [0, 2, 3]];
        let (good, bad) = hinges(&faces);
        assert_eq!(good, [Hinge { vertices: [0, 2, 3, 1], faces: [1, 0] }]);
        assert!(bad.is_empty());
        assert_eq!(boundary_loops(&faces), [vec![0, 1, 2, 3]]);
        assert_eq!(hinges(&[[0, 1, 2], [0, 1, 3]]).1, [[0, 1]]);
        assert_eq!(Adjacency::new(5, &faces).components().1, 2);
    }
}
