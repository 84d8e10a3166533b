//! Splitting a coarse garment: every triangle into four, new vertices on a curve through the old ones, so that neither the
//! silhouette nor the fit shrinks.

use crate::template::distance::angle_weighted_normals;
use caphy_core::TriMesh;
use caphy_core::query::boundary_loops;
use std::collections::HashMap;

/// Times that triangles are split at most: four to the fifth is a thousand.
const MOST: usize = 5;

/// Number of splits that brings the mean edge nearest to `resolution` [m] (in ratio).
pub(super) fn splits_for(mesh: &TriMesh, resolution: f64) -> usize {
    let ratio = mesh.mean_edge_length() / resolution;
    (ratio.log2().round().max(0.0) as usize).min(MOST)
}

/// Splits every triangle into four. New vertices inside lie on the cubic between point-normal pairs (Vlachos et al. 2001)
/// at its middle, those on the boundary on the four-point curve (Dyn et al. 1987); layout corners at the middle.
pub(super) fn split(mesh: &TriMesh, uv: Option<&[[[f64; 2]; 3]]>) -> (TriMesh, Option<Vec<[[f64; 2]; 3]>>) {
    let normals = angle_weighted_normals(mesh);
    // Boundary neighbours, to continue the curve at both ends.
    let mut beside: HashMap<u32, [u32; 2]> = HashMap::new();
    for ring in boundary_loops(&mesh.faces) {
        let n = ring.len();
        for k in 0..n {
            beside.insert(ring[k], [ring[(k + n - 1) % n], ring[(k + 1) % n]]);
        }
    }
    let mut uses: HashMap<[u32; 2], u32> = HashMap::new();
    for f in &mesh.faces {
        for k in 0..3 {
            let (a, b) = (f[k], f[(k + 1) % 3]);
            *uses.entry([a.min(b), a.max(b)]).or_default() += 1;
        }
    }
    let mut out = mesh.subdivided();
    // The same walk as in `subdivided` meets the new vertices in the order of their numbers.
    let mut next = mesh.vertices.len();
    let mut seen: HashMap<[u32; 2], ()> = HashMap::with_capacity(uses.len());
    for f in &mesh.faces {
        for k in 0..3 {
            let (a, b) = (f[k], f[(k + 1) % 3]);
            let edge = [a.min(b), a.max(b)];
            if seen.insert(edge, ()).is_some() {
                continue;
            }
            let (p, q) = (mesh.vertices[a as usize], mesh.vertices[b as usize]);
            let place = if uses[&edge] == 1 {
                let other = |v: u32, not: u32| beside.get(&v).and_then(|n| n.iter().copied().find(|&w| w != not));
                match (other(a, b), other(b, a)) {
                    (Some(l), Some(r)) => {
                        (p + q) * (9.0 / 16.0) - (mesh.vertices[l as usize] + mesh.vertices[r as usize]) / 16.0
                    }
                    _ => (p + q) * 0.5,
                }
            } else {
                let (n, m) = (normals[a as usize], normals[b as usize]);
                let d = q - p;
                (p + q) * 0.5 + (m * d.dot(&m) - n * d.dot(&n)) * 0.125
            };
            out.vertices[next] = place;
            next += 1;
        }
    }
    let split_uv = uv.map(|uv| {
        uv.iter()
            .flat_map(|&[a, b, c]| {
                let middle = |p: [f64; 2], q: [f64; 2]| [0.5 * (p[0] + q[0]), 0.5 * (p[1] + q[1])];
                let (ab, bc, ca) = (middle(a, b), middle(b, c), middle(c, a));
                [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
            })
            .collect()
    });
    (out, split_uv)
}

#[cfg(test)]
mod tests {
    use super::*;
    use caphy_core::Vec3;

    #[test]
    fn a_coarse_tube_keeps_its_radius() {
        let mut mesh = TriMesh::default();
        for i in 0..5 {
            for k in 0..12 {
                let (s, c) = (std::f64::consts::TAU * f64::from(k) / 12.0).sin_cos();
                mesh.vertices.push(Vec3::new(0.1 * c, 0.05 * f64::from(i), 0.1 * s));
            }
        }
        for i in 0..4u32 {
            for k in 0..12 {
                let (p, q) = (12 * i + k, 12 * i + (k + 1) % 12);
                mesh.faces.extend([[p, p + 12, q], [q, p + 12, q + 12]]);
            }
        }
        let uv: Vec<[[f64; 2]; 3]> =
            mesh.faces.iter().map(|f| f.map(|v| [f64::from(v % 12), f64::from(v / 12)])).collect();
        assert_eq!(splits_for(&mesh, 0.0125), 2);
        assert_eq!(splits_for(&mesh, 1.0), 0);
        let (fine, fine_uv) = split(&mesh, Some(&uv));
        let fine_uv = fine_uv.unwrap();
        assert_eq!(fine.faces.len(), 4 * mesh.faces.len());
        assert_eq!(fine_uv.len(), fine.faces.len());
        assert_eq!(boundary_loops(&fine.faces).iter().map(Vec::len).collect::<Vec<_>>(), [24, 24]);
        assert!(caphy_core::query::hinges(&fine.faces).1.is_empty());
        for p in &fine.vertices {
            // Chord middles of a 12-gon lie 3.4 % inside, the curves' middles less than half a percent.
            let r = (p.x * p.x + p.z * p.z).sqrt();
            assert!((r / 0.1 - 1.0).abs() < 0.005, "{r}");
            assert!(p.y > -1e-12 && p.y < 0.2 + 1e-12);
        }
        // Layout corners belong to their faces: the first child keeps the first corner.
        assert_eq!(fine_uv[4][0], uv[1][0]);
        assert_eq!(fine_uv[4][1], [0.5 * (uv[1][0][0] + uv[1][1][0]), 0.5 * (uv[1][0][1] + uv[1][1][1])]);
    }
}
