//! Facts about a template, for reports.

use super::ways::Lengths;
use super::{GarmentKind, GivenFacts, NamedLoop, Style, Template};
use caphy_core::TriMesh;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Values at shares of a sorted row.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Quantiles {
    /// The smallest.
    pub least: f64,
    /// 5th percentile.
    pub p05: f64,
    /// 50th percentile.
    pub median: f64,
    /// 95th percentile.
    pub p95: f64,
    /// The largest.
    pub largest: f64,
}

impl Quantiles {
    /// Of values in any order; zeros without values.
    pub fn of(mut values: Vec<f64>) -> Self {
        values.sort_by(f64::total_cmp);
        let at = |q: f64| values.get((q * (values.len().max(1) - 1) as f64).round() as usize).copied().unwrap_or(0.0);
        Self { least: at(0.0), p05: at(0.05), median: at(0.5), p95: at(0.95), largest: at(1.0) }
    }
}

/// A boundary loop.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LoopFacts {
    /// As in [`super::NamedLoop`].
    pub name: String,
    /// Number of vertices.
    pub vertices: usize,
    /// Length along it [m].
    pub girth_m: f64,
    /// Whether the body holds it.
    pub held: bool,
}

/// The shortest way on the garment from one loop to another.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LengthFacts {
    /// First loop.
    pub from: String,
    /// Second loop.
    pub to: String,
    /// Length [m], straight across triangles: some ten-thousandths longer than the true one.
    pub length_m: f64,
}

/// What a tailor would measure of a garment.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct GarmentMeasures {
    /// Area [m²].
    pub area_m2: f64,
    /// Length of each boundary loop [m].
    pub girths_m: Vec<(String, f64)>,
    /// Shortest way on the garment from one loop to another [m], named `neck to hem`.
    pub lengths_m: Vec<(String, f64)>,
}

/// How one garment's measures differ from another's.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MeasureErrors {
    /// Differences of area, as a share [1].
    pub area: f64,
    /// Differences of girths and lengths that both have [m].
    pub lengths_m: Vec<(String, f64)>,
}

impl GarmentMeasures {
    /// These less the true ones.
    pub fn against(&self, truth: &Self) -> MeasureErrors {
        let all = |m: &Self| m.girths_m.iter().chain(&m.lengths_m).cloned().collect::<Vec<_>>();
        let theirs = all(truth);
        let lengths_m = all(self)
            .into_iter()
            .filter_map(|(name, value)| {
                let other = theirs.iter().find(|t| t.0 == name)?.1;
                Some((name, value - other))
            })
            .collect();
        MeasureErrors { area: self.area_m2 / truth.area_m2 - 1.0, lengths_m }
    }
}

impl MeasureErrors {
    /// The largest difference of a length or girth, by its size [m]; 0 without any.
    pub fn largest_m(&self) -> f64 {
        self.lengths_m.iter().map(|l| l.1.abs()).fold(0.0, f64::max)
    }
}

/// What there is to say about a template.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct GarmentFacts {
    /// Upper or lower.
    pub kind: GarmentKind,
    /// Its point in the style space, or the garment that it is.
    pub style: Style,
    /// Number of vertices.
    pub vertices: usize,
    /// Number of triangles.
    pub faces: usize,
    /// Area [m²].
    pub area_m2: f64,
    /// Edge length asked for; of a given garment the mean [m].
    pub resolution_m: f64,
    /// Edge lengths [m], each edge once.
    pub edge_length_m: Quantiles,
    /// Angles of triangles [°].
    pub angle_deg: Quantiles,
    /// Smallest distance of vertices to the skin [m].
    pub clearance_m: f64,
    /// Boundary loops.
    pub loops: Vec<LoopFacts>,
    /// Ways between loops.
    pub lengths: Vec<LengthFacts>,
    /// What the grain follows.
    pub grain: String,
    /// Triangles of the material layout over those of the template, by area: below 1 where the worn garment is stretched.
    pub layout_area_ratio: f64,
    /// What was done to a given garment.
    pub given: Option<GivenFacts>,
}

/// Edge lengths, each edge once [m].
pub(crate) fn edge_lengths(mesh: &TriMesh) -> Vec<f64> {
    let mut edges: Vec<[u32; 2]> =
        mesh.faces.iter().flat_map(|&[a, b, c]| [[a, b], [b, c], [c, a]]).map(|[a, b]| [a.min(b), a.max(b)]).collect();
    edges.sort_unstable();
    edges.dedup();
    edges.iter().map(|e| (mesh.vertices[e[0] as usize] - mesh.vertices[e[1] as usize]).norm()).collect()
}

/// Angles of all corners [°].
fn angles(mesh: &TriMesh) -> Vec<f64> {
    (0..mesh.faces.len())
        .flat_map(|f| {
            let p = mesh.corners(f);
            [0, 1, 2].map(|k| (p[(k + 1) % 3] - p[k]).angle(&(p[(k + 2) % 3] - p[k])).to_degrees())
        })
        .collect()
}

impl Template {
    /// Area, girths and lengths.
    pub fn measures(&self) -> GarmentMeasures {
        GarmentMeasures {
            area_m2: self.area(),
            girths_m: self.girths(),
            lengths_m: self.lengths().into_iter().map(|l| (format!("{} to {}", l.from, l.to), l.length_m)).collect(),
        }
    }
    /// Ways between loops.
    fn lengths(&self) -> Vec<LengthFacts> {
        let pairs: Vec<[&NamedLoop; 2]> = (0..self.loops.len())
            .flat_map(|i| self.loops[i + 1..].iter().map(move |to| [&self.loops[i], to]))
            .collect();
        let lengths = Lengths::new(&self.mesh);
        let length = |&[from, to]: &[&NamedLoop; 2]| LengthFacts {
            from: from.name.clone(),
            to: to.name.clone(),
            length_m: lengths.between(&from.vertices, &to.vertices),
        };
        pairs.par_iter().map(length).collect()
    }
    /// Everything worth telling.
    pub fn facts(&self) -> GarmentFacts {
        let held: Vec<&str> = self.attachments().map(|l| l.name.as_str()).collect();
        let loops = self
            .loops
            .iter()
            .zip(self.girths())
            .map(|(l, (_, girth_m))| LoopFacts {
                name: l.name.clone(),
                vertices: l.vertices.len(),
                girth_m,
                held: held.contains(&l.name.as_str()),
            })
            .collect();
        let flat = |t: &[[f64; 2]; 3]| {
            0.5 * ((t[1][0] - t[0][0]) * (t[2][1] - t[0][1]) - (t[2][0] - t[0][0]) * (t[1][1] - t[0][1])).abs()
        };
        GarmentFacts {
            kind: self.kind,
            style: self.style.clone(),
            vertices: self.mesh.vertices.len(),
            faces: self.mesh.faces.len(),
            area_m2: self.area(),
            resolution_m: self.resolution_m,
            edge_length_m: Quantiles::of(edge_lengths(&self.mesh)),
            angle_deg: Quantiles::of(angles(&self.mesh)),
            clearance_m: self.clearance_m,
            loops,
            lengths: self.lengths(),
            grain: self.grain.clone(),
            layout_area_ratio: self.material_uv.iter().map(flat).sum::<f64>() / self.area(),
            given: self.given.clone(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use caphy_core::Vec3;

    #[test]
    fn a_tube_is_described() {
        // Radius 0.1, height 0.4, 24 around, 9 rings.
        let mut mesh = TriMesh::default();
        for i in 0..9 {
            for k in 0..24 {
                let (s, c) = (std::f64::consts::TAU * f64::from(k) / 24.0).sin_cos();
                mesh.vertices.push(Vec3::new(0.1 * c, 0.05 * f64::from(i), 0.1 * s));
            }
        }
        for i in 0..8u32 {
            for k in 0..24 {
                let (p, q) = (24 * i + k, 24 * i + (k + 1) % 24);
                mesh.faces.extend([[p, p + 24, q], [q, p + 24, q + 24]]);
            }
        }
        let ring = |name: &str, ids: std::ops::Range<u32>| NamedLoop { name: name.into(), vertices: ids.collect() };
        let uv = (0..mesh.faces.len()).map(|f| mesh.corners(f)).map(|p| {
            let side = (p[1] - p[0]).norm();
            let x = (p[2] - p[0]).dot(&(p[1] - p[0])) / side;
            [[0.0, 0.0], [side, 0.0], [x, ((p[2] - p[0]).norm_squared() - x * x).sqrt()]]
        });
        let style = Style::from_values(GarmentKind::Lower, &[0.5, 0.01, 0.5]).unwrap();
        let template = Template {
            kind: GarmentKind::Lower,
            style,
            weights_body_vertex: vec![0; mesh.vertices.len()],
            loops: vec![ring("waist", 192..216), ring("hem", 0..24)],
            material_uv: uv.collect(),
            mesh,
            resolution_m: 0.05,
            grain: "test".into(),
            clearance_m: 0.004,
            given: None,
        };
        let facts = template.facts();
        assert_eq!(facts.lengths.len(), 1);
        assert!((facts.lengths[0].length_m - 0.4).abs() < 1e-12, "{:?}", facts.lengths);
        let chord = 0.2 * (std::f64::consts::PI / 24.0).sin();
        assert!((facts.loops[0].girth_m - 24.0 * chord).abs() < 1e-12 && facts.loops[0].held && !facts.loops[1].held);
        assert!((facts.layout_area_ratio - 1.0).abs() < 1e-12);
        assert!((facts.edge_length_m.least - chord).abs() < 1e-12);
        assert!((facts.edge_length_m.largest - chord.hypot(0.05)).abs() < 1e-12);
        assert!((facts.angle_deg.largest - 90.0).abs() < 1e-6);
        let measures = template.measures();
        let mut longer = measures.clone();
        longer.lengths_m[0].1 += 0.01;
        longer.girths_m[1].1 -= 0.002;
        longer.girths_m.push(("cuff_left".into(), 0.2));
        let errors = longer.against(&measures);
        assert!((errors.largest_m() - 0.01).abs() < 1e-12 && errors.area == 0.0);
        assert_eq!(errors.lengths_m.iter().map(|l| &l.0[..]).collect::<Vec<_>>(), ["waist", "hem", "waist to hem"]);
        assert!(serde_json::to_string(&facts).unwrap().contains("\"girth_m\""));
    }
}
