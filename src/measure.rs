//! How near a dressed figure is to a scan of it: distances, renderings, folds.
//!
//! Perceptual distance (Table 1 of the paper) is a network's opinion, VGG-16's, whose weights are not part of this program: it is asked
//! where its file is given. Two measures of what is seen need none: the distance of normal maps, and MS-SSIM.

pub mod crossings;
pub mod perceptual;
mod similarity;
mod views;

pub use perceptual::Perceptual;
pub use similarity::ms_ssim;
pub use views::ScanViews;

use crate::pictures::Dressed;
use crate::quality::{Spectrum, SpectrumFilter};
use crate::scene::label_of;
use caphy_core::query::{NearestGrid, NearestSurface};
use caphy_core::scan::LabelledPoints;
use caphy_core::{Error, Result, TriMesh, Vec3, mesh};
use caphy_garment::template::GarmentKind;
use serde::{Deserialize, Serialize};

/// Name of [`Fit::perceptual`]; the network is whatever was given as VGG-16.
pub const PERCEPTUAL: &str = "perceptual network, VGG-16";

/// How near one garment of a figure is to a scan of it.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Fit {
    /// Mean distance from scan points to the garment's surface [mm], not squared.
    pub scan_to_garment_mm: f64,
    /// Mean distance from visible garment vertices to the nearest scan point [mm], not squared.
    pub garment_to_scan_mm: f64,
    /// As [`Fit::scan_to_garment_mm`] with squared distances [mm²].
    pub scan_to_garment_mm2: f64,
    /// As [`Fit::garment_to_scan_mm`] with squared distances [mm²].
    pub garment_to_scan_mm2: f64,
    /// Eq. 9: sum of both means of *squared* distances between points and vertices [mm²]; the template's edge length sets its
    /// floor.
    pub chamfer_mm2: f64,
    /// Distance of the garment's normal maps over all views [1]: mean length of the difference of normals where either shows it;
    /// where one does not, its normal is 0. 0 for the same, 1 for another place, at most 2.
    pub normal_map: f64,
    /// 1 − MS-SSIM of grey renderings of the garment (Wang, Simoncelli, Bovik 2003), mean over views: 0 for the same.
    pub ms_ssim: f64,
    /// Distance of the same renderings by the features of `evaluate.perceptual_network` ([`perceptual::Features::distance`]), mean over
    /// views: 0 for the same; none without that network.
    #[serde(default)]
    pub perceptual: Option<f64>,
    /// Energy of its normals by wavelength.
    pub spectrum: Spectrum,
    /// Pairs of its triangles that pass through each other.
    pub self_crossings: usize,
}

impl Fit {
    /// All values by name and unit; a table needs no other order.
    pub fn named(&self) -> Vec<(&'static str, f64)> {
        let [fine, middle, coarse] = self.spectrum.0;
        let mut all = vec![
            ("scan → surface, mm", self.scan_to_garment_mm),
            ("vertices → scan, mm", self.garment_to_scan_mm),
            ("mean of both, mm", self.mean_mm()),
            ("scan → surface, squared, mm²", self.scan_to_garment_mm2),
            ("vertices → scan, squared, mm²", self.garment_to_scan_mm2),
            ("Eq. 9 between points and vertices, squared, mm²", self.chamfer_mm2),
            ("normal maps", self.normal_map),
            ("1 − MS-SSIM", self.ms_ssim),
        ];
        all.extend(self.perceptual.map(|distance| (PERCEPTUAL, distance)));
        all.extend([
            ("normals, folds below 8 cm", fine),
            ("normals, folds of 8 to 16 cm", middle),
            ("normals, folds of 16 to 32 cm", coarse),
            ("triangles through each other, pairs", self.self_crossings as f64),
        ]);
        all
    }

    /// Mean of both unsquared distances [mm]: the paper's 3D-CD, whose definition it leaves open.
    pub fn mean_mm(&self) -> f64 {
        0.5 * (self.scan_to_garment_mm + self.garment_to_scan_mm)
    }
}

/// A garment of a scan, prepared for being compared with many figures.
pub struct ScanGarment<'n> {
    name: String,
    kind: GarmentKind,
    points: Vec<Vec3>,
    views: ScanViews<'n>,
}

impl<'n> ScanGarment<'n> {
    /// The points of one garment and views of it; `surface` and `labelled` are the same scan. `network` is asked what it sees, too.
    ///
    /// # Errors
    /// [`Error::Numerics`] for a scan without a point of the garment; [`Error::Length`] for another number of labels; what the network
    /// fails with.
    pub fn new(
        name: &str,
        kind: GarmentKind,
        surface: &TriMesh,
        labelled: &LabelledPoints,
        network: Option<&'n Perceptual>,
    ) -> Result<Self> {
        let (points, _) = labelled.with_label(label_of(kind));
        let Some(bounds) = mesh::bounds(&points) else {
            return Err(nothing_to_compare(name, kind, 0, None));
        };
        let views = ScanViews::new(kind, surface, labelled, bounds, network)?;
        Ok(Self { name: name.into(), kind, points, views })
    }

    /// Upper or lower.
    pub fn kind(&self) -> GarmentKind {
        self.kind
    }

    /// Compares with a garment of a figure; `visible` tells which of its vertices scans show.
    ///
    /// # Errors
    /// [`Error::Numerics`] without a visible vertex; what a mesh is refused for.
    pub fn compare(
        &self,
        figure: &Dressed<'_>,
        garment: usize,
        visible: &[bool],
        filter: &SpectrumFilter,
    ) -> Result<Fit> {
        let TriMesh { vertices, faces } = &figure.garments[garment];
        let seen: Vec<Vec3> = vertices.iter().zip(visible).filter(|(_, v)| **v).map(|(p, _)| *p).collect();
        if seen.is_empty() {
            return Err(nothing_to_compare(&self.name, self.kind, self.points.len(), Some(0)));
        }
        let on_surface = NearestSurface::new(vertices, faces)?.nearest_all(&self.points, None)?;
        let [scan_to_garment, scan_to_garment2] = means(on_surface.iter().map(|at| at.squared_distance));
        let to_nearest = |from: &[Vec3], to: &[Vec3]| {
            let grid = NearestGrid::from_points(to);
            let squares: Vec<f64> = from.iter().filter_map(|p| grid.nearest_point(p)).map(|(_, d)| d).collect();
            means(squares.into_iter())
        };
        let [_, there] = to_nearest(&self.points, &seen);
        let [garment_to_scan, back] = to_nearest(&seen, &self.points);
        let [normal_map, ms_ssim] = self.views.distances(figure, garment);
        Ok(Fit {
            scan_to_garment_mm: 1e3 * scan_to_garment,
            garment_to_scan_mm: 1e3 * garment_to_scan,
            scan_to_garment_mm2: 1e6 * scan_to_garment2,
            garment_to_scan_mm2: 1e6 * back,
            chamfer_mm2: 1e6 * (there + back),
            normal_map,
            ms_ssim,
            perceptual: self.views.perceptual(figure, garment)?,
            spectrum: filter.of(vertices, faces),
            self_crossings: crossings::count(vertices, faces),
        })
    }
}

fn nothing_to_compare(scan: &str, kind: GarmentKind, points: usize, seen: Option<usize>) -> Error {
    let seen = seen.map_or(String::new(), |n| format!(" and {n} visible vertices"));
    Error::numerics(
        format!("scan {scan}"),
        format!("{points} points{seen} of the {kind} garment"),
        "look at the labels in the report, or leave the scan out",
    )
}

/// Mean of the roots, and mean.
fn means(squares: impl Iterator<Item = f64>) -> [f64; 2] {
    let (mut roots, mut sum, mut count) = (0.0, 0.0, 0usize);
    for square in squares {
        roots += square.sqrt();
        sum += square;
        count += 1;
    }
    let n = count.max(1) as f64;
    [roots / n, sum / n]
}

/// Energy of a scan's normals by wavelength, seen at the vertices of a garment that lies near it: every scan point counts at its
/// nearest vertex, so that noise averages; a vertex without points, or that scans do not show, keeps the garment's own normal.
pub fn scan_spectrum(
    points: &LabelledPoints,
    garment: &TriMesh,
    kind: GarmentKind,
    visible: &[bool],
    filter: &SpectrumFilter,
) -> Spectrum {
    let own = garment.vertex_normals();
    let grid = NearestGrid::from_points(&garment.vertices);
    let mut sums = vec![Vec3::zeros(); own.len()];
    let label = label_of(kind);
    for ((p, n), _) in points.points.iter().zip(&points.normals).zip(&points.labels).filter(|(_, l)| **l == label) {
        if let Some((v, _)) = grid.nearest_point(p) {
            // The other side of a fold is not this vertex's.
            if n.dot(&own[v as usize]) > 0.0 {
                sums[v as usize] += n;
            }
        }
    }
    let normals = sums
        .iter()
        .zip(&own)
        .zip(visible)
        .map(|((sum, own), seen)| if *seen { sum.try_normalize(1e-12).unwrap_or(*own) } else { *own });
    filter.of_normals(normals.collect())
}

/// Root of the mean squared angle between the rotations of two poses, over some joints [rad].
pub fn pose_distance(a: &caphy_core::pose::Pose, b: &caphy_core::pose::Pose, joints: &[usize]) -> f64 {
    let rotation = |v: &Vec3| nalgebra::UnitQuaternion::new(*v);
    let squares = joints.iter().filter_map(|&j| {
        let (a, b) = (a.rotations.get(j)?, b.rotations.get(j)?);
        Some(rotation(a).angle_to(&rotation(b)).powi(2))
    });
    let [_, mean] = means(squares);
    mean.sqrt()
}

/// Which vertices of a posed garment one scan shows: those whose nearest scan point belongs to the garment.
pub fn shown(vertices: &[Vec3], kind: GarmentKind, points: &LabelledPoints) -> Vec<bool> {
    let grid = NearestGrid::from_points(&points.points);
    let label = label_of(kind);
    let near = |p| grid.nearest_point(p).is_some_and(|(id, _)| points.labels[id as usize] == label);
    vertices.iter().map(near).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use caphy_core::pose::Pose;
    use caphy_core::scan::Label;

    /// A square sheet of 0.4 m facing +z at a height, `n` cells along an edge.
    fn sheet(n: u32, z: f64) -> TriMesh {
        let at = |i: u32, j: u32| j * (n + 1) + i;
        let mut mesh = TriMesh::default();
        for j in 0..=n {
            for i in 0..=n {
                let unit = |k: u32| 0.4 * (f64::from(k) / f64::from(n) - 0.5);
                mesh.vertices.push(Vec3::new(unit(i), unit(j), z));
            }
        }
        for j in 0..n {
            for i in 0..n {
                mesh.faces.push([at(i, j), at(i + 1, j), at(i, j + 1)]);
                mesh.faces.push([at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)]);
            }
        }
        mesh
    }

    fn labelled(mesh: &TriMesh) -> LabelledPoints {
        let labels = vec![Label::Upper; mesh.vertices.len()];
        LabelledPoints { points: mesh.vertices.clone(), normals: mesh.vertex_normals(), labels }
    }

    #[test]
    fn a_shifted_sheet_is_as_far_as_it_was_shifted() {
        let (scan, garment) = (sheet(80, 0.0), sheet(10, 0.03));
        let points = labelled(&scan);
        let compared = ScanGarment::new("s", GarmentKind::Upper, &scan, &points, None).unwrap();
        let body = TriMesh::default();
        let figure = |mesh: TriMesh| Dressed { body: &body, garments: vec![mesh] };
        let filter = SpectrumFilter::new(&garment);
        let seen = vec![true; garment.vertices.len()];
        let away = compared.compare(&figure(garment.clone()), 0, &seen, &filter).unwrap();
        // Every vertex of the coarse sheet stands above one of the fine one.
        for (value, expected) in [
            (away.scan_to_garment_mm, 30.0),
            (away.garment_to_scan_mm, 30.0),
            (away.scan_to_garment_mm2, 900.0),
            (away.garment_to_scan_mm2, 900.0),
            (away.mean_mm(), 30.0),
        ] {
            assert!((value - expected).abs() < 1e-9, "{value} is not {expected}");
        }
        // Between vertices 40 mm apart a point is up to 28 mm to the side.
        assert!(away.chamfer_mm2 > 1800.0 && away.chamfer_mm2 < 1800.0 + 2.0 * 20.0 * 20.0);
        assert_eq!(away.self_crossings, 0);
        let same = compared.compare(&figure(sheet(10, 0.0)), 0, &seen, &filter).unwrap();
        assert!(same.normal_map < 1e-3 && same.ms_ssim < 1e-3, "{same:?}");
        assert!(away.normal_map > same.normal_map && away.ms_ssim > same.ms_ssim);
        // Seen at its vertices, a flat scan has the folds of a flat garment: none.
        let folds = scan_spectrum(&points, &garment, GarmentKind::Upper, &seen, &filter);
        assert!(folds.0.iter().all(|e| *e < 1e-20), "{folds:?}");
        assert!(compared.compare(&figure(garment), 0, &vec![false; seen.len()], &filter).is_err());
        assert!(ScanGarment::new("s", GarmentKind::Lower, &scan, &points, None).is_err());
    }

    #[test]
    fn poses_are_apart_by_their_angles() {
        let pose = |angles: [f64; 3]| Pose {
            translation: Vec3::zeros(),
            rotations: angles.iter().map(|a| Vec3::new(*a, 0.0, 0.0)).collect(),
        };
        let (a, b) = (pose([2.0, 0.1, 0.5]), pose([0.0, 0.4, 0.1]));
        // The root is not among the joints: turning is no other pose.
        assert!((pose_distance(&a, &b, &[1, 2]) - (0.5f64 * (0.09 + 0.16)).sqrt()).abs() < 1e-7);
        assert!(pose_distance(&a, &a, &[0, 1, 2]) < 1e-7);
    }
}
