//! Edges of a mesh: hinges inside, loops at the boundary.

use std::collections::HashMap;

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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::query::Adjacency;

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
