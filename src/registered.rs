//! A fitted body and labelled scans against the truth, where it is known.

use caphy_core::body::BodyModel;
use caphy_core::query::NearestGrid;
use caphy_core::scan::{Label, LabelledPoints};
use caphy_core::{Error, Result, TriMesh, Vec3, mesh};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

use crate::synth::Truth;

/// Distances of the fitted body's vertices from the true ones, in one scan's pose [mm].
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct BodyError {
    /// Median and 95th percentile where the scan shows skin.
    pub skin_mm: [f64; 2],
    /// The same under clothes.
    pub covered_mm: [f64; 2],
    /// Mean along the true normal on skin and under clothes: above 0 the fitted body is the fatter one.
    pub outward_mm: [f64; 2],
}

/// Vertices of the true body in the pose of a scan [m].
///
/// # Errors
/// Those of the body.
pub fn true_body(body: &dyn BodyModel, truth: &Truth, scan: usize) -> Result<Vec<Vec3>> {
    let mut person = body.rest(&truth.shape);
    person.displacement.clone_from(&truth.displacement);
    Ok(body.forward(&person.posed(&truth.poses[scan]))?.vertices)
}

/// Fitted against true vertices [m] of one triangulation; the nearest point of the scan says whether a vertex is covered.
///
/// # Errors
/// [`Error::Length`] for different numbers of vertices.
pub fn body_error(fitted: &[Vec3], real: &[Vec3], faces: &[[u32; 3]], scan: &LabelledPoints) -> Result<BodyError> {
    Error::check_length("vertices of the true body", fitted.len(), real.len())?;
    let normals = mesh::vertex_normals(real, faces);
    let points = NearestGrid::from_points(&scan.points);
    let (mut errors, mut outward) = ([Vec::new(), Vec::new()], [0.0; 2]);
    for ((p, q), n) in real.iter().zip(fitted).zip(&normals) {
        let Some((near, _)) = points.nearest_point(p) else { continue };
        let covered = match scan.labels[near as usize] {
            Label::Body => 0,
            Label::Upper | Label::Lower => 1,
            Label::Ignore => continue,
        };
        errors[covered].push(1e3 * (q - p).norm());
        outward[covered] += 1e3 * (q - p).dot(n);
    }
    let counts = errors.each_ref().map(|e| e.len().max(1) as f64);
    let [skin_mm, covered_mm] = errors.map(|mut e| {
        e.sort_by(f64::total_cmp);
        [0.5, 0.95].map(|q| e.get((q * e.len().saturating_sub(1) as f64).round() as usize).copied().unwrap_or(0.0))
    });
    Ok(BodyError { skin_mm, covered_mm, outward_mm: [outward[0] / counts[0], outward[1] / counts[1]] })
}

/// Median and largest distance over the joints that are known (not NaN) [mm].
pub fn joint_error(fitted: &[Vec3], truth: &[Vec3]) -> [f64; 2] {
    let mut distances: Vec<f64> =
        fitted.iter().zip(truth).map(|(a, b)| (a - b).norm() * 1e3).filter(|d| d.is_finite()).collect();
    distances.sort_by(f64::total_cmp);
    let median = distances.get(distances.len() / 2).copied().unwrap_or(f64::NAN);
    [median, distances.last().copied().unwrap_or(f64::NAN)]
}

/// How labels of a scan differ from the true ones.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct LabelError {
    /// Share of vertices with the true label [1].
    pub right: f64,
    /// How far places of borders are from the nearest one of the same two labels' true border, and places of true borders from the borders:
    /// what 95 % (the 95 % Hausdorff distance) and 99 % of them keep within [mm].
    pub border_mm: [f64; 2],
    /// Of the wrong vertices, the distance to a vertex that truly has the label that they were given: what 99 % keep within, and the
    /// largest [mm]; 0 without wrong ones. A patch of a dozen vertices in a slit counts here, and hardly does along all borders.
    pub wrong_mm: [f64; 2],
}

/// Labels of a scan's vertices against the true ones.
///
/// # Errors
/// [`Error::Length`] for different numbers of vertices and labels.
pub fn label_error(mesh: &TriMesh, labels: &[Label], truth: &[Label]) -> Result<LabelError> {
    let points = &mesh.vertices;
    Error::check_length("labels of a scan", points.len(), labels.len())?;
    Error::check_length("true labels of a scan", points.len(), truth.len())?;
    let wrong: Vec<usize> = (0..points.len()).filter(|&v| labels[v] != truth[v]).collect();
    let mut moved = Vec::with_capacity(wrong.len());
    for label in Label::ALL {
        let own: Vec<Vec3> = points.iter().zip(truth).filter(|(_, t)| **t == label).map(|(p, _)| *p).collect();
        let grid = NearestGrid::from_points(&own);
        let given = wrong.iter().filter(|&&v| labels[v] == label);
        moved.extend(given.map(|&v| grid.nearest_point(&points[v]).map_or(f64::INFINITY, |n| 1e3 * n.1.sqrt())));
    }
    let (found, real) = (borders(mesh, labels), borders(mesh, truth));
    let mut apart = Vec::new();
    for (from, to) in [(&found, &real), (&real, &found)] {
        for (pair, places) in from {
            let grid = NearestGrid::from_points(to.get(pair).map_or(&[][..], Vec::as_slice));
            apart.extend(places.iter().map(|p| grid.nearest_point(p).map_or(f64::INFINITY, |n| 1e3 * n.1.sqrt())));
        }
    }
    let right = 1.0 - wrong.len() as f64 / points.len().max(1) as f64;
    let [border_mm, wrong_mm] = [(apart, [0.95, 0.99]), (moved, [0.99, 1.0])].map(|(mut all, shares)| {
        all.sort_by(f64::total_cmp);
        shares.map(|q| all.get((q * all.len().saturating_sub(1) as f64).round() as usize).copied().unwrap_or(0.0))
    });
    Ok(LabelError { right, border_mm, wrong_mm })
}

/// Middles of the edges between two labels [m], by these.
fn borders(mesh: &TriMesh, labels: &[Label]) -> BTreeMap<[Label; 2], Vec<Vec3>> {
    let mut out: BTreeMap<[Label; 2], Vec<Vec3>> = BTreeMap::new();
    for &[a, b, c] in &mesh.faces {
        for [p, q] in [[a, b], [b, c], [c, a]].map(|e| e.map(|v| v as usize)) {
            let [one, other] = [labels[p], labels[q]];
            if one != other {
                let places = out.entry([one.min(other), one.max(other)]).or_default();
                places.push((mesh.vertices[p] + mesh.vertices[q]) * 0.5);
            }
        }
    }
    out
}

/// Area of the part of a mesh that lies below a height [m²]: of trousers what no shirt covers, where that is its hem's.
pub fn area_below(mesh: &TriMesh, height_m: f64) -> f64 {
    let below = |[a, b, c]: [Vec3; 3]| {
        let area = 0.5 * (b - a).cross(&(c - a)).norm();
        let mut y = [a.y, b.y, c.y];
        y.sort_by(f64::total_cmp);
        let [low, middle, high] = y;
        // The corner that is cut off on one side of a line of equal height, as a share of the whole.
        let corner = |from: f64, to: f64, other: f64| (height_m - from).powi(2) / ((to - from) * (other - from));
        area * if height_m >= high {
            1.0
        } else if height_m <= low {
            0.0
        } else if height_m <= middle {
            corner(low, middle, high)
        } else {
            1.0 - corner(high, middle, low)
        }
    };
    (0..mesh.faces.len()).map(|f| below(mesh.corners(f))).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn areas_below_a_height_are_cut_along_it() {
        // A trapezium: a square with a triangle beside it, in a slanted plane of unit area per unit of height and width.
        let at = |x: f64, y: f64| Vec3::new(x, y, y);
        let mesh = TriMesh {
            vertices: vec![at(0.0, 0.0), at(1.0, 0.0), at(1.0, 1.0), at(0.0, 1.0), at(2.0, 0.0)],
            faces: vec![[0, 1, 2], [0, 2, 3], [1, 4, 2]],
        };
        let slant = 2f64.sqrt();
        for h in [-0.5f64, 0.0, 0.25, 0.5, 0.9, 1.0, 3.0] {
            let h_in = h.clamp(0.0, 1.0);
            let expected = slant * (h_in + h_in - 0.5 * h_in * h_in);
            assert!((area_below(&mesh, h) - expected).abs() < 1e-12, "{h}");
        }
    }

    #[test]
    fn a_border_that_moved_by_two_of_ten_points_is_known() {
        // A strip of squares of 1 cm.
        let points: Vec<Vec3> = (0..20).map(|i| Vec3::new(f64::from(i % 10), f64::from(i / 10), 0.0) * 0.01).collect();
        let faces = (0..9u32).flat_map(|i| [[i, i + 1, i + 10], [i + 1, i + 11, i + 10]]).collect();
        let strip = TriMesh { vertices: points, faces };
        let label =
            |to: usize| (0..20).map(|i| if i % 10 < to { Label::Upper } else { Label::Body }).collect::<Vec<_>>();
        let error = label_error(&strip, &label(7), &label(5)).unwrap();
        assert!((error.right - 0.8).abs() < 1e-12, "{error:?}");
        assert!([error.border_mm, error.wrong_mm].concat().iter().all(|d| (d - 20.0).abs() < 1e-9), "{error:?}");
        let same = label_error(&strip, &label(5), &label(5)).unwrap();
        assert_eq!((same.right, same.border_mm, same.wrong_mm), (1.0, [0.0; 2], [0.0; 2]));
        assert!(label_error(&strip, &label(5)[1..], &label(5)).is_err());
        // A border that is not there at all is nowhere near.
        let bare = label_error(&strip, &[Label::Body; 20], &label(5)).unwrap();
        assert!(bare.border_mm[0].is_infinite() && bare.right == 0.5, "{bare:?}");
        // Another label beyond the same border: the border of these two is not there.
        let other: Vec<Label> = label(5).iter().map(|l| if *l == Label::Body { Label::Lower } else { *l }).collect();
        assert!(label_error(&strip, &other, &label(5)).unwrap().border_mm[0].is_infinite());
    }

    #[test]
    fn a_body_that_is_fatter_under_cloth_is_seen() {
        // A sheet facing +z, its left half covered, moved out by 4 mm there.
        let points: Vec<Vec3> = (0..100).map(|i| Vec3::new(f64::from(i % 10), f64::from(i / 10), 0.0) * 0.05).collect();
        let faces: Vec<[u32; 3]> =
            (0..90u32).filter(|i| i % 10 < 9).flat_map(|i| [[i, i + 1, i + 10], [i + 1, i + 11, i + 10]]).collect();
        let covered = |p: &Vec3| p.x < 0.22;
        let labels = points.iter().map(|p| if covered(p) { Label::Upper } else { Label::Body }).collect();
        let fitted: Vec<Vec3> =
            points.iter().map(|p| p + Vec3::z() * if covered(p) { 0.004 } else { -0.001 }).collect();
        let scan = LabelledPoints { points: points.clone(), normals: vec![Vec3::z(); 100], labels };
        let e = body_error(&fitted, &points, &faces, &scan).unwrap();
        assert!((e.covered_mm[0] - 4.0).abs() < 1e-9 && (e.outward_mm[0] + 1.0).abs() < 1e-9, "{e:?}");
        assert!((e.outward_mm[1] - 4.0).abs() < 1e-9 && (e.skin_mm[1] - 1.0).abs() < 1e-9, "{e:?}");
        assert_eq!(joint_error(&[Vec3::zeros(); 2], &[Vec3::x() * 0.003, Vec3::repeat(f64::NAN)]), [3.0, 3.0]);
    }
}
