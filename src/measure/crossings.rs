//! Cloth through itself: pairs of triangles of one garment that cross.

use caphy_core::Vec3;
use caphy_core::mesh;
use std::collections::HashMap;

/// Pairs of triangles that pass through each other and share no vertex.
///
/// Found by the edges of each that pierce the other, ends included; triangles that merely lie in one plane do not cross.
pub fn count(vertices: &[Vec3], faces: &[[u32; 3]]) -> usize {
    let corners: Vec<[Vec3; 3]> = faces.iter().map(|f| f.map(|v| vertices[v as usize])).collect();
    let boxes: Vec<(Vec3, Vec3)> =
        corners.iter().map(|c| (c[0].inf(&c[1]).inf(&c[2]), c[0].sup(&c[1]).sup(&c[2]))).collect();
    let Some((lowest, _)) = mesh::bounds(vertices) else { return 0 };
    // Cells of the mean size of a triangle: each then lies in a few.
    let size = boxes.iter().map(|(lo, hi)| (hi - lo).amax()).sum::<f64>() / boxes.len().max(1) as f64;
    if !(size > 0.0 && size.is_finite()) {
        return 0;
    }
    let cell = |p: &Vec3| ((p - lowest) / size).map(|x| x.floor() as i64);
    let mut cells: HashMap<[i64; 3], Vec<u32>> = HashMap::new();
    for (f, (lo, hi)) in boxes.iter().enumerate() {
        let (a, b) = (cell(lo), cell(hi));
        for x in a.x..=b.x {
            for y in a.y..=b.y {
                for z in a.z..=b.z {
                    cells.entry([x, y, z]).or_default().push(f as u32);
                }
            }
        }
    }
    let mut count = 0;
    for (at, list) in &cells {
        for (i, &f) in list.iter().enumerate() {
            for &g in &list[i + 1..] {
                let (f, g) = (f as usize, g as usize);
                let start = cell(&boxes[f].0.sup(&boxes[g].0));
                // A pair is looked at in the first cell that both share.
                let first = [start.x, start.y, start.z] == *at;
                let apart = (0..3).any(|k| boxes[f].0[k] > boxes[g].1[k] || boxes[g].0[k] > boxes[f].1[k]);
                let touching = faces[f].iter().any(|v| faces[g].contains(v));
                if first && !apart && !touching && cross(&corners[f], &corners[g]) {
                    count += 1;
                }
            }
        }
    }
    count
}

/// Whether an edge of one triangle pierces the other.
fn cross(a: &[Vec3; 3], b: &[Vec3; 3]) -> bool {
    let pierced = |edges: &[Vec3; 3], by: &[Vec3; 3]| (0..3).any(|i| pierces(&edges[i], &edges[(i + 1) % 3], by));
    pierced(a, b) || pierced(b, a)
}

/// Whether a segment meets a triangle (Möller and Trumbore 1997).
fn pierces(from: &Vec3, to: &Vec3, [a, b, c]: &[Vec3; 3]) -> bool {
    let (along, u, v) = (to - from, b - a, c - a);
    let p = along.cross(&v);
    let volume = u.dot(&p);
    if volume == 0.0 {
        return false;
    }
    let s = (from - a) / volume;
    let q = s.cross(&u);
    let (x, y, t) = (s.dot(&p), along.dot(&q), v.dot(&q));
    x >= 0.0 && y >= 0.0 && x + y <= 1.0 && (0.0..=1.0).contains(&t)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A strip of triangles along x, `n` cells long and one wide, bent by `place`.
    fn strip(n: u32, place: impl Fn(f64, f64) -> Vec3) -> (Vec<Vec3>, Vec<[u32; 3]>) {
        let vertices = (0..=n).flat_map(|i| [0.0, 1.0].map(|w| place(f64::from(i), w))).collect();
        let faces = (0..n).flat_map(|i| [[2 * i, 2 * i + 2, 2 * i + 1], [2 * i + 2, 2 * i + 3, 2 * i + 1]]).collect();
        (vertices, faces)
    }

    #[test]
    fn what_crosses_is_counted_once_and_neighbours_do_not() {
        let (flat, faces) = strip(12, |x, y| Vec3::new(x, y, 0.0));
        assert_eq!(count(&flat, &faces), 0);
        // A triangle through the middle of a cell's triangle, and one beside the strip.
        let with = |corners: [[f64; 3]; 3]| {
            let (mut vertices, mut faces) = (flat.clone(), faces.clone());
            let first = vertices.len() as u32;
            vertices.extend(corners.map(|c| Vec3::new(c[0], c[1], c[2])));
            faces.push([first, first + 1, first + 2]);
            count(&vertices, &faces)
        };
        assert_eq!(with([[4.2, 0.2, -0.5], [4.25, 0.2, 0.5], [4.3, 0.3, 0.5]]), 1);
        assert_eq!(with([[4.2, 1.2, -0.5], [4.25, 1.2, 0.5], [4.3, 1.3, 0.5]]), 0);
        // Across the diagonal: both triangles of the cell.
        assert_eq!(with([[4.1, 0.1, -0.4], [4.9, 0.9, -0.4], [4.5, 0.5, 2.0]]), 2);
        assert_eq!(count(&[], &[]), 0);
    }

    #[test]
    fn counting_by_cells_is_counting_all_pairs() {
        // A strip rolled so tightly that its turns cut through each other.
        let rolled = |x: f64, y: f64| {
            let angle = 0.9 * x;
            let radius = 1.0 + 0.3 * (0.37 * x).sin();
            Vec3::new(radius * angle.cos(), radius * angle.sin(), y + 0.1 * x)
        };
        let (vertices, faces) = strip(60, rolled);
        let corners: Vec<[Vec3; 3]> = faces.iter().map(|f| f.map(|v| vertices[v as usize])).collect();
        let mut brute = 0;
        for f in 0..faces.len() {
            for g in f + 1..faces.len() {
                let touching = faces[f].iter().any(|v| faces[g].contains(v));
                brute += usize::from(!touching && cross(&corners[f], &corners[g]));
            }
        }
        assert!(brute > 10, "{brute}");
        assert_eq!(count(&vertices, &faces), brute);
    }
}
