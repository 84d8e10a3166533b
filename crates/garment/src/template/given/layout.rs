//! Whether a layout (texture coordinates) is the garment's pattern in metres: isometric up to one unit.

use caphy_core::TriMesh;
use serde::{Deserialize, Serialize};

/// A layout is metric when nine tenths of the garment's area are stretched within this factor of the median: sewing patterns
/// differ from the worn shape by what the fabric gives, textures by what packing wants.
const EVEN: f64 = 1.15;
/// Units that a layout of real patterns comes in [m]; within [`SAME_UNIT`] of one, exactly that one.
const UNITS: [f64; 4] = [1.0, 0.01, 0.001, 0.0254];
const SAME_UNIT: f64 = 0.05;
/// A triangle of the layout smaller than this share of its worn area, in median units, has no directions.
const COLLAPSED: f64 = 1e-3;

/// What was found out about a layout.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LayoutFacts {
    /// Whether it is used as the material frame.
    pub metric: bool,
    /// Metres per unit of the layout.
    pub metres_per_unit: f64,
    /// Principal stretches from the layout (in metres) to the worn triangles: the 5th percentile, median and 95th by area.
    pub stretch: [f64; 3],
    /// Faces laid out mirrored (left and right halves share a place), turned back.
    pub mirrored_faces: usize,
}

/// Principal stretches of one triangle from layout to space, larger first, and whether the layout is mirrored; `None` for
/// a layout without area.
fn stretches(corners: &[caphy_core::Vec3; 3], uv: &[[f64; 2]; 3]) -> Option<([f64; 2], bool)> {
    let (e, d) = (corners[1] - corners[0], corners[2] - corners[0]);
    let (a, c) = (uv[1][0] - uv[0][0], uv[1][1] - uv[0][1]);
    let (b, g) = (uv[2][0] - uv[0][0], uv[2][1] - uv[0][1]);
    let determinant = a * g - b * c;
    if determinant == 0.0 {
        return None;
    }
    // Columns of the deformation gradient F (Eq. 3), then the eigenvalues of FᵀF.
    let u = (e * g - d * c) / determinant;
    let v = (d * a - e * b) / determinant;
    let (uu, vv, uv) = (u.norm_squared(), v.norm_squared(), u.dot(&v));
    let (mean, half) = (0.5 * (uu + vv), (0.25 * (uu - vv).powi(2) + uv * uv).sqrt());
    Some(([(mean + half).sqrt(), (mean - half).max(0.0).sqrt()], determinant < 0.0))
}

/// The layout in metres, mirrored faces turned back, where it is metric; and the facts. Compare on the mesh as given, before
/// anything moves its vertices.
pub(super) fn metric_layout(mesh: &TriMesh, uv: &[[[f64; 2]; 3]]) -> (Option<Vec<[[f64; 2]; 3]>>, LayoutFacts) {
    let areas = mesh.face_areas();
    let mut samples: Vec<(f64, f64)> = Vec::with_capacity(2 * areas.len());
    let mut mirrored = Vec::with_capacity(areas.len());
    let mut collapsed = false;
    for (f, corner) in uv.iter().enumerate() {
        match stretches(&mesh.corners(f), corner) {
            Some((s, m)) => {
                samples.extend(s.map(|s| (s, areas[f])));
                mirrored.push(m);
            }
            None => {
                collapsed = true;
                mirrored.push(false);
            }
        }
    }
    samples.sort_by(|a, b| a.0.total_cmp(&b.0));
    let total: f64 = samples.iter().map(|s| s.1).sum();
    let quantile = |q: f64| {
        let mut sum = 0.0;
        samples
            .iter()
            .find(|s| {
                sum += s.1;
                sum >= q * total
            })
            .or(samples.last())
            .map_or(f64::INFINITY, |s| s.0)
    };
    let (low, median, high) = (quantile(0.05), quantile(0.5), quantile(0.95));
    collapsed |= samples.first().is_none_or(|s| s.0 <= 0.0)
        || samples.last().is_none_or(|s| !s.0.is_finite() || s.0 > median / COLLAPSED);
    let metric = !collapsed && median.is_finite() && high < EVEN * median && low > median / EVEN;
    let unit = UNITS.into_iter().find(|u| (median / u - 1.0).abs() < SAME_UNIT).unwrap_or(median);
    let facts = LayoutFacts {
        metric,
        metres_per_unit: unit,
        stretch: [low, median, high].map(|s| s / unit),
        mirrored_faces: mirrored.iter().filter(|m| **m).count(),
    };
    let scaled = || {
        uv.iter()
            .zip(&mirrored)
            .map(|(corner, &m)| corner.map(|[u, v]| [u * unit, if m { -v * unit } else { v * unit }]))
            .collect()
    };
    (metric.then(scaled), facts)
}

impl LayoutFacts {
    /// The note on the grain for artifacts and reports.
    pub(super) fn note(&self) -> String {
        let [low, median, high] = self.stretch;
        format!(
            "u and v of the file's own layout, {:.6} m per unit; from it the worn garment is stretched {low:.3} to {high:.3} \
             (5th to 95th percentile), median {median:.3}; which of u and v is the warp is not known",
            self.metres_per_unit
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use caphy_core::Vec3;

    /// A half pipe of 10 × 10 squares, whose unrolled surface is its layout, in units of `unit` metres.
    fn pipe(unit: f64) -> (TriMesh, Vec<[[f64; 2]; 3]>) {
        let mut mesh = TriMesh::default();
        let mut flat = Vec::new();
        for i in 0..11 {
            for k in 0..11 {
                let (s, c) = (std::f64::consts::PI * f64::from(k) / 10.0).sin_cos();
                mesh.vertices.push(Vec3::new(0.2 * c, 0.06 * f64::from(i), 0.2 * s));
                flat.push([0.06 * f64::from(i) / unit, 0.2 * std::f64::consts::PI * f64::from(k) / 10.0 / unit]);
            }
        }
        let mut uv = Vec::new();
        for i in 0..10u32 {
            for k in 0..10u32 {
                let p = 11 * i + k;
                for face in [[p, p + 1, p + 11], [p + 1, p + 12, p + 11]] {
                    mesh.faces.push(face);
                    uv.push(face.map(|v| flat[v as usize]));
                }
            }
        }
        (mesh, uv)
    }

    #[test]
    fn a_pattern_in_any_unit_is_metric() {
        for (unit, exact) in [(1.0, true), (0.01, true), (0.001, true), (0.37, false)] {
            let (mesh, uv) = pipe(unit);
            let (layout, facts) = metric_layout(&mesh, &uv);
            assert!(facts.metric, "{facts:?}");
            // Chords of 18° are 0.4 % shorter than their arcs.
            assert!((facts.metres_per_unit / unit - 1.0).abs() < if exact { 1e-12 } else { 0.005 }, "{facts:?}");
            let layout = layout.unwrap();
            let p = mesh.corners(7);
            let flat =
                ((layout[7][1][0] - layout[7][0][0]).powi(2) + (layout[7][1][1] - layout[7][0][1]).powi(2)).sqrt();
            assert!((flat / (p[1] - p[0]).norm() - 1.0).abs() < 0.006);
            // Mirroring is turned back: the determinant has the faces' sense.
            let d = |t: &[[f64; 2]; 3]| {
                (t[1][0] - t[0][0]) * (t[2][1] - t[0][1]) - (t[2][0] - t[0][0]) * (t[1][1] - t[0][1])
            };
            assert!(layout.iter().all(|t| d(t) > 0.0));
        }
    }

    #[test]
    fn textures_are_not_patterns() {
        // Squeezed along v.
        let (mesh, mut uv) = pipe(1.0);
        uv.iter_mut().flatten().for_each(|c| c[1] *= 0.5);
        let (layout, facts) = metric_layout(&mesh, &uv);
        assert!(layout.is_none() && !facts.metric && facts.stretch[2] > 1.9 * facts.stretch[0]);
        // Everything at one point.
        let (layout, facts) = metric_layout(&mesh, &vec![[[0.5; 2]; 3]; mesh.faces.len()]);
        assert!(layout.is_none() && !facts.metric);
        // One triangle without area among good ones can not be divided by.
        let (mesh, mut uv) = pipe(1.0);
        uv[20] = [[0.0; 2]; 3];
        assert!(metric_layout(&mesh, &uv).0.is_none());
    }

    #[test]
    fn a_mirrored_half_is_used() {
        let (mesh, mut uv) = pipe(1.0);
        let n = uv.len() / 2;
        uv[..n].iter_mut().flatten().for_each(|c| c[1] = -c[1]);
        let (layout, facts) = metric_layout(&mesh, &uv);
        assert!(layout.is_some());
        assert!(facts.mirrored_faces == n || facts.mirrored_faces == mesh.faces.len() - n, "{facts:?}");
    }
}
