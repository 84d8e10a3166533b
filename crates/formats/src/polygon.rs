//! Polygons into triangles.

use caphy_core::Vec3;

/// Largest polygon that is cut by ears: the search grows with the cube of the corners.
const MOST_EARS: usize = 128;

/// Polygons of any size, one after another.
#[derive(Default)]
pub(crate) struct Polygons {
    /// Vertex ids of all corners.
    pub(crate) corners: Vec<u32>,
    /// End of each polygon in `corners`.
    pub(crate) ends: Vec<usize>,
}

impl Polygons {
    /// Calls back with each polygon's number and the triangles of its corners, as places in `corners`.
    ///
    /// A polygon is cut from its first corner where that gives no triangle turned over; a concave one of at most 128
    /// corners by ears. Triangles that name a vertex twice have no area and are left out. All ids must be below the
    /// number of `vertices`.
    pub(crate) fn triangles(&self, vertices: &[Vec3], mut triangle: impl FnMut(usize, [usize; 3])) {
        let mut start = 0;
        let mut local = Vec::new();
        for (number, &end) in self.ends.iter().enumerate() {
            let polygon = &self.corners[start..end];
            if let &[a, b, c] = polygon {
                if a != b && b != c && c != a {
                    triangle(number, [start, start + 1, start + 2]);
                }
            } else {
                local.clear();
                cut(polygon, vertices, &mut local);
                for t in &local {
                    let [a, b, c] = t.map(|k| polygon[k]);
                    if a != b && b != c && c != a {
                        triangle(number, t.map(|k| start + k));
                    }
                }
            }
            start = end;
        }
    }
}

/// Appends the triangles of one polygon, as corner numbers.
fn cut(polygon: &[u32], vertices: &[Vec3], out: &mut Vec<[usize; 3]>) {
    let n = polygon.len();
    let at = |k: usize| vertices[polygon[k] as usize];
    // Twice the area vector (Newell): the side that the polygon faces, concave or not.
    let mut facing = Vec3::zeros();
    for k in 2..n {
        facing += (at(k - 1) - at(0)).cross(&(at(k) - at(0)));
    }
    let turn = |a: usize, b: usize, c: usize| (at(b) - at(a)).cross(&(at(c) - at(a))).dot(&facing);
    let fan_from = |first: usize| (1..n - 1).map(move |k| [first, (first + k) % n, (first + k + 1) % n]);
    let turned_over = |[a, b, c]: [usize; 3]| turn(a, b, c) < 0.0;
    // NaN of overflowing positions compares as not turned over: such a polygon stays a fan.
    if !(4..=MOST_EARS).contains(&n) || !fan_from(0).any(turned_over) {
        out.extend((2..n).map(|k| [0, k - 1, k]));
        return;
    }
    if n == 4 && !fan_from(1).any(turned_over) {
        out.extend(fan_from(1));
        return;
    }
    let mut ring: Vec<usize> = (0..n).collect();
    let mut k = 0;
    let mut refused = 0;
    while ring.len() > 3 && refused < ring.len() {
        let m = ring.len();
        k %= m;
        let (before, ear, after) = (ring[(k + m - 1) % m], ring[k], ring[(k + 1) % m]);
        let is_ear = turn(before, ear, after) > 0.0
            && !ring.iter().any(|&p| {
                // A vertex that occurs twice (a keyhole) touches its own ear without lying in it.
                ![before, ear, after].iter().any(|&q| polygon[q] == polygon[p])
                    && turn(before, ear, p) >= 0.0
                    && turn(ear, after, p) >= 0.0
                    && turn(after, before, p) >= 0.0
            });
        if is_ear {
            out.push([before, ear, after]);
            ring.remove(k);
            refused = 0;
        } else {
            k += 1;
            refused += 1;
        }
    }
    // The last ear, or what crosses itself: as a fan.
    out.extend((2..ring.len()).map(|k| [ring[0], ring[k - 1], ring[k]]));
}

#[cfg(test)]
mod tests {
    use super::*;

    fn triangulated(outline: &[[f64; 2]]) -> (Vec<[usize; 3]>, f64, f64) {
        // Tilted out of every coordinate plane.
        let vertices: Vec<Vec3> = outline.iter().map(|p| Vec3::new(p[0], p[1], 0.5 * p[0] - 0.25 * p[1])).collect();
        let polygons = Polygons { corners: (0..outline.len() as u32).collect(), ends: vec![outline.len()] };
        let mut triangles = Vec::new();
        polygons.triangles(&vertices, |_, t| triangles.push(t));
        let signed = |t: &[usize]| -> f64 {
            (0..t.len())
                .map(|k| (outline[t[k]], outline[t[(k + 1) % t.len()]]))
                .map(|(p, q)| 0.5 * (p[0] * q[1] - p[1] * q[0]))
                .sum()
        };
        let whole = signed(&(0..outline.len()).collect::<Vec<_>>());
        let covered: f64 = triangles.iter().map(|t| signed(t).abs()).sum();
        (triangles, whole, covered)
    }

    #[test]
    fn convex_polygons_are_fans_and_concave_ones_are_covered_once() {
        let (fan, _, _) = triangulated(&[[0.0, 0.0], [2.0, 0.0], [3.0, 1.0], [1.0, 2.0], [0.0, 1.0]]);
        assert_eq!(fan, [[0, 1, 2], [0, 2, 3], [0, 3, 4]]);
        let arrow = [[0.0, 0.0], [2.0, 0.0], [0.5, 0.5], [0.0, 2.0]];
        let letter_c = [[0.0, 0.0], [3.0, 0.0], [3.0, 1.0], [1.0, 1.0], [1.0, 2.0], [3.0, 2.0], [3.0, 3.0], [0.0, 3.0]];
        let star: Vec<[f64; 2]> = (0..20)
            .map(|k| {
                let (angle, radius) = (std::f64::consts::PI * f64::from(k) / 10.0, if k % 2 == 0 { 2.0 } else { 0.5 });
                [radius * angle.cos(), radius * angle.sin()]
            })
            .collect();
        for outline in [arrow.as_slice(), &letter_c, &star] {
            for first in 0..outline.len() {
                let mut turned = outline.to_vec();
                turned.rotate_left(first);
                let (triangles, whole, covered) = triangulated(&turned);
                assert_eq!(triangles.len(), outline.len() - 2);
                // Twenty products of numbers below 10 in f64.
                assert!((whole - covered).abs() < 1e-13, "from corner {first}: {covered} of {whole}");
            }
        }
    }

    #[test]
    fn crossing_repeated_and_huge_polygons_end() {
        let (bow_tie, _, _) = triangulated(&[[0.0, 0.0], [1.0, 1.0], [1.0, 0.0], [0.0, 1.0], [-1.0, 0.5]]);
        assert!(!bow_tie.is_empty());
        let vertices =
            [Vec3::new(1e300, 0.0, 0.0), Vec3::new(0.0, 1e300, 0.0), Vec3::new(0.0, 0.0, -1e300), Vec3::zeros()];
        let polygons =
            Polygons { corners: vec![0, 1, 2, 3, 0, 0, 1, 2, 2, 2, 1, 1, 1, 1, 0, 1], ends: vec![4, 8, 10, 14, 16] };
        let mut count = 0;
        polygons.triangles(&vertices, |_, _| count += 1);
        assert_eq!(count, 3);
    }
}
