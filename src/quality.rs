//! How a moving garment compares with another of the same mesh: the measures that trained nets are judged by.

use caphy_core::query::Adjacency;
use caphy_core::{Vec3, mesh};
use nalgebra::Rotation3;
use serde::{Deserialize, Serialize};

/// Wavelengths that bound the bands of a [`Spectrum`] [m]: folds of 8, 16 and 32 cm.
pub const WAVELENGTHS: [f64; 3] = [0.08, 0.16, 0.32];

/// Energy of a surface's normals by wavelength: mean squared length of what the normals lose when they are smoothed from one band
/// to the next, from the finest to the coarsest. Its sum and the square of the mean smooth normal make 1.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct Spectrum(pub [f64; WAVELENGTHS.len()]);

/// Smooths normals of one mesh.
pub struct SpectrumFilter {
    neighbours: Adjacency,
    /// Vertex areas over the whole [1].
    shares: Vec<f64>,
    /// Passes of smoothing from one band to the next.
    passes: [usize; WAVELENGTHS.len()],
}

impl SpectrumFilter {
    /// For a rest mesh; wavelengths below about three edges cannot be told apart.
    pub fn new(rest: &caphy_core::TriMesh) -> Self {
        let areas = rest.vertex_areas();
        let total: f64 = areas.iter().sum();
        // A pass keeps half of a vertex and spreads the rest over its neighbours: along each axis of the surface its kernel has
        // a variance of a quarter of the squared edge. A Gaussian halves the amplitude of wavelength λ at σ = 0.187 λ.
        let edge = rest.mean_edge_length();
        let all = WAVELENGTHS.map(|length| ((0.187 * length).powi(2) / (0.25 * edge * edge)).round().max(1.0) as usize);
        let passes = std::array::from_fn(|i| all[i] - if i == 0 { 0 } else { all[i - 1] });
        Self {
            neighbours: Adjacency::new(rest.vertices.len(), &rest.faces),
            shares: areas.iter().map(|a| a / total.max(f64::MIN_POSITIVE)).collect(),
            passes,
        }
    }
    /// Of one shape [m].
    pub fn of(&self, vertices: &[Vec3], faces: &[[u32; 3]]) -> Spectrum {
        self.of_normals(mesh::vertex_normals(vertices, faces))
    }
    /// Of unit normals at the vertices.
    pub fn of_normals(&self, mut normals: Vec<Vec3>) -> Spectrum {
        let bands = self.passes.map(|passes| {
            let mut smooth = normals.clone();
            for _ in 0..passes {
                smooth = self.smoothed(&smooth);
            }
            let lost =
                normals.iter().zip(&smooth).zip(&self.shares).map(|((n, s), w)| w * (n - s).norm_squared()).sum();
            normals = smooth;
            lost
        });
        Spectrum(bands)
    }
    fn smoothed(&self, values: &[Vec3]) -> Vec<Vec3> {
        let one = |v: usize| {
            let near = self.neighbours.of(v);
            if near.is_empty() {
                return values[v];
            }
            let sum: Vec3 = near.iter().map(|&n| values[n as usize]).sum();
            0.5 * values[v] + 0.5 / near.len() as f64 * sum
        };
        (0..values.len()).map(one).collect()
    }
}

impl Spectrum {
    /// Mean of several.
    pub fn mean(list: &[Spectrum]) -> Spectrum {
        let n = list.len().max(1) as f64;
        Spectrum(std::array::from_fn(|i| list.iter().map(|s| s.0[i]).sum::<f64>() / n))
    }
}

/// Motion of some vertices about where skinning puts them, seen from the root [m]: `moved` and `skinned` have shape
/// [frame][vertex], `roots` are the root's rotations as axis times angle [rad].
///
/// The swing is the root of the mean over vertices of the variance over frames of that displacement.
pub fn swing(moved: &[Vec<Vec3>], skinned: &[Vec<Vec3>], roots: &[Vec3], vertices: &[u32]) -> f64 {
    let frames = moved.len() as f64;
    if vertices.is_empty() || moved.is_empty() {
        return 0.0;
    }
    let variance: f64 = vertices
        .iter()
        .map(|&v| {
            let away: Vec<Vec3> = moved
                .iter()
                .zip(skinned)
                .zip(roots)
                .map(|((x, s), root)| Rotation3::new(*root).inverse() * (x[v as usize] - s[v as usize]))
                .collect();
            let mean: Vec3 = away.iter().sum::<Vec3>() / frames;
            away.iter().map(|d| (d - mean).norm_squared()).sum::<f64>() / frames
        })
        .sum::<f64>()
        / vertices.len() as f64;
    variance.sqrt()
}

/// Height of the centre of mass [m].
pub fn mass_height(vertices: &[Vec3], masses: &[f64]) -> f64 {
    let total: f64 = masses.iter().sum();
    vertices.iter().zip(masses).map(|(p, m)| p.y * m).sum::<f64>() / total
}

/// Share of vertices inside the body and the deepest of them [m], of clearances over all frames.
pub fn penetration(clearance: &[f64], limit: f64) -> [f64; 2] {
    let inside = clearance.iter().filter(|&&d| d < -limit).count();
    [inside as f64 / clearance.len().max(1) as f64, -clearance.iter().copied().fold(0.0, f64::min)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use caphy_core::TriMesh;

    /// A square sheet of 1 m with `n` cells along an edge.
    fn sheet(n: u32) -> TriMesh {
        let at = |i: u32, j: u32| j * (n + 1) + i;
        let mut mesh = TriMesh::default();
        for j in 0..=n {
            for i in 0..=n {
                mesh.vertices.push(Vec3::new(f64::from(i) / f64::from(n), 0.0, f64::from(j) / f64::from(n)));
            }
        }
        for j in 0..n {
            for i in 0..n {
                mesh.faces.push([at(i, j), at(i, j + 1), at(i + 1, j)]);
                mesh.faces.push([at(i + 1, j), at(i, j + 1), at(i + 1, j + 1)]);
            }
        }
        mesh
    }

    #[test]
    fn a_wave_shows_in_its_band() {
        let rest = sheet(50);
        let filter = SpectrumFilter::new(&rest);
        for (length, band) in [(0.06, 0), (0.115, 1), (0.23, 2)] {
            let mut waved = rest.vertices.clone();
            for p in &mut waved {
                p.y = 0.002 * length / 0.06 * (std::f64::consts::TAU * p.x / length).sin();
            }
            let Spectrum(bands) = filter.of(&waved, &rest.faces);
            let most = (0..bands.len()).max_by(|&a, &b| bands[a].total_cmp(&bands[b]));
            assert_eq!(most, Some(band), "{length} m: {bands:?}");
        }
        let flat = filter.of(&rest.vertices, &rest.faces);
        assert!(flat.0.iter().all(|&b| b < 1e-20), "{flat:?}");
    }

    #[test]
    fn a_swing_is_seen_from_the_root_and_stillness_is_none() {
        // A pendulum of amplitude a about the skinned place has a variance of a²/2, whichever way the person turns.
        let frames = 40;
        let (mut moved, mut skinned, mut roots) = (Vec::new(), Vec::new(), Vec::new());
        for t in 0..frames {
            let phase = std::f64::consts::TAU * f64::from(t) / f64::from(frames);
            let root = Vec3::new(0.0, 0.7 * phase, 0.0);
            let away = Rotation3::new(root) * Vec3::new(0.01 * phase.sin(), 0.0, 0.003);
            skinned.push(vec![Vec3::new(0.1 * phase, 1.0, 0.0)]);
            moved.push(vec![skinned[t as usize][0] + away]);
            roots.push(root);
        }
        assert!((swing(&moved, &skinned, &roots, &[0]) - 0.01 / 2f64.sqrt()).abs() < 1e-12);
        assert_eq!(swing(&skinned, &skinned, &roots, &[0]), 0.0);
    }

    #[test]
    fn only_what_is_deeper_than_the_limit_penetrates() {
        assert_eq!(penetration(&[0.001, -0.0005, -0.003, 0.1], 0.001), [0.25, 0.003]);
        assert_eq!(mass_height(&[Vec3::y(), Vec3::y() * 4.0], &[2.0, 1.0]), 2.0);
    }
}
