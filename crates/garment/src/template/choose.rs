//! Which template a scan wears: the smallest Chamfer distance among candidates (Sec. 3.1).

use super::{Template, WornAs};
use caphy_core::body::BlendWeights;
use caphy_core::query::{NearestGrid, NearestSurface};
use caphy_core::{Error, Result, Vec3};
use nalgebra::Matrix3x4;
use rayon::prelude::*;

/// Chamfer distance of one candidate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Chamfer {
    /// Mean squared distance in both directions, summed [m²]: what candidates are ordered by.
    pub squared: f64,
    /// Mean distance from scan points to the nearest garment vertex [m].
    pub scan_to_garment: f64,
    /// Mean distance from counted garment vertices to the nearest scan point [m].
    pub garment_to_scan: f64,
    /// Share of garment vertices that counted (were not hidden).
    pub counted: f64,
}

/// The chosen candidate and what all of them measured.
#[derive(Debug, Clone, PartialEq)]
pub struct Choice {
    /// Index of the candidate with the smallest [`Chamfer::squared`]; the first of equals.
    pub index: usize,
    /// One per candidate, in order.
    pub report: Vec<Chamfer>,
}

/// What counts in the comparison.
#[derive(Debug, Clone, Copy, Default)]
pub struct ChooseOptions<'a> {
    /// Scan points of the garment worn over this one [m]: a vertex nearer to them than to its own garment's points is hidden and
    /// does not count. Empty: everything counts.
    pub covered_by: &'a [Vec3],
}

/// Points of a scan, ready for many comparisons.
struct Scan<'a> {
    points: &'a [Vec3],
    own: NearestGrid<f64>,
    cover: Option<NearestGrid<f64>>,
}

impl<'a> Scan<'a> {
    fn new(points: &'a [Vec3], options: &ChooseOptions<'_>) -> Result<Self> {
        for (what, list) in
            [("scan points of a garment", points), ("scan points of the garment over it", options.covered_by)]
        {
            let flat: Vec<f64> = list.iter().flat_map(|p| p.iter().copied()).collect();
            Error::check_finite(what, &flat)?;
        }
        if points.is_empty() {
            let remedy = "check the segmentation: no scan point carries this garment's label";
            return Err(Error::numerics("choice of a garment template", "the scan has no points of it", remedy));
        }
        let cover = (!options.covered_by.is_empty()).then(|| NearestGrid::from_points(options.covered_by));
        Ok(Self { points, own: NearestGrid::from_points(points), cover })
    }
    fn chamfer(&self, garment: &[Vec3]) -> Result<Chamfer> {
        let flat: Vec<f64> = garment.iter().flat_map(|p| p.iter().copied()).collect();
        Error::check_finite("vertices of a garment candidate", &flat)?;
        let mut there = (0.0, 0.0, 0usize);
        for p in garment {
            let Some((_, d2)) = self.own.nearest_point(p) else { continue };
            let hidden = self.cover.as_ref().is_some_and(|c| c.nearest_within(&[p.x, p.y, p.z], d2).is_some());
            if !hidden {
                there = (there.0 + d2, there.1 + d2.sqrt(), there.2 + 1);
            }
        }
        if there.2 == 0 {
            // Nothing of it would be seen, but its points are in the scan: as bad as can be.
            let infinite = f64::INFINITY;
            return Ok(Chamfer {
                squared: infinite,
                scan_to_garment: infinite,
                garment_to_scan: infinite,
                counted: 0.0,
            });
        }
        let grid = NearestGrid::from_points(garment);
        let mut back = (0.0, 0.0);
        for p in self.points {
            if let Some((_, d2)) = grid.nearest_point(p) {
                back = (back.0 + d2, back.1 + d2.sqrt());
            }
        }
        let (n, m) = (there.2 as f64, self.points.len() as f64);
        Ok(Chamfer {
            squared: there.0 / n + back.0 / m,
            scan_to_garment: back.1 / m,
            garment_to_scan: there.1 / n,
            counted: n / garment.len() as f64,
        })
    }
}

/// The candidate nearest to a scan: `candidates` are garment vertices posed like the scan [m], `scan_points` the scan's
/// points of that garment [m]. Symmetric Chamfer distance, squared, means over points.
///
/// # Errors
/// [`Error::Numerics`] without candidates or scan points, [`Error::NonFinite`] for bad values.
pub fn choose_template(candidates: &[Vec<Vec3>], scan_points: &[Vec3], options: &ChooseOptions<'_>) -> Result<Choice> {
    let scan = Scan::new(scan_points, options)?;
    let measured: Vec<Result<Chamfer>> = candidates.par_iter().map(|c| scan.chamfer(c)).collect();
    let report: Vec<Chamfer> = measured.into_iter().collect::<Result<_>>()?;
    let best = (0..report.len()).min_by(|&a, &b| report[a].squared.total_cmp(&report[b].squared));
    match best {
        Some(index) => Ok(Choice { index, report }),
        None => Err(Error::numerics("choice of a garment template", "no candidates", "sample at least one style")),
    }
}

fn transform(m: &Matrix3x4<f64>, p: &Vec3) -> Vec3 {
    m * p.push(1.0)
}

/// A template posed by linear blend skinning, each vertex with the weights of its nearest body vertex (Eq. 2 without dV):
/// `body_weights` w, shape [body_vertex_count]; `transforms` A_j of the pose, shape [joint_count].
///
/// # Errors
/// [`Error::Mesh`] when weights or transforms belong to another body.
pub fn pose_by_nearest_vertex(
    template: &Template,
    body_weights: &BlendWeights,
    transforms: &[Matrix3x4<f64>],
) -> Result<Vec<Vec3>> {
    check_transforms(body_weights, transforms)?;
    let vertices = template.mesh.vertices.iter().zip(&template.weights_body_vertex);
    vertices
        .map(|(p, &near)| {
            if (near as usize) < body_weights.vertex_count() {
                Ok(transform(&body_weights.blend(near as usize, transforms), p))
            } else {
                let problem = format!("does not exist, there are {}", body_weights.vertex_count());
                let remedy = "pose the template with the body it was cut on";
                Err(Error::mesh("garment template", format!("body vertex {near}"), problem, remedy))
            }
        })
        .collect()
}

/// Where a template would hang in a pose [m], by how another one does there: at the same places of cloth, beyond them as the body turns. A
/// first guess for a solver, from where cloth has little left to fall.
///
/// # Errors
/// As [`pose_by_nearest_vertex`]; [`Error::Length`] for a worn template that is not of its vertices.
pub fn hung_like(
    template: &Template,
    other: WornAs<'_>,
    body_weights: &BlendWeights,
    transforms: &[Matrix3x4<f64>],
) -> Result<Vec<Vec3>> {
    let there = &other.template.mesh;
    Error::check_length("vertices of a worn template", there.vertices.len(), other.vertices.len())?;
    let skinned = pose_by_nearest_vertex(template, body_weights, transforms)?;
    let rest = NearestSurface::from_mesh(there)?;
    let hung = |((p, &near), skinned): ((&Vec3, &u32), Vec3)| {
        let Some(place) = rest.nearest(p) else { return skinned };
        let face = there.faces[place.face as usize];
        let at: Vec3 = face.iter().zip(&place.barycentric).map(|(&v, w)| other.vertices[v as usize] * *w).sum();
        at + body_weights.blend(near as usize, transforms).fixed_columns::<3>(0) * (p - place.point)
    };
    Ok(template.mesh.vertices.iter().zip(&template.weights_body_vertex).zip(skinned).map(hung).collect())
}

/// Vertices posed by linear blend skinning with their own weights, shape [vertex_count] each.
///
/// # Errors
/// [`Error::Length`] when counts differ, [`Error::Mesh`] when a weight names a joint without transform.
pub fn pose_by_weights(vertices: &[Vec3], weights: &BlendWeights, transforms: &[Matrix3x4<f64>]) -> Result<Vec<Vec3>> {
    Error::check_length("skinning weights of a garment", vertices.len(), weights.vertex_count())?;
    check_transforms(weights, transforms)?;
    Ok(vertices.iter().enumerate().map(|(v, p)| transform(&weights.blend(v, transforms), p)).collect())
}

fn check_transforms(weights: &BlendWeights, transforms: &[Matrix3x4<f64>]) -> Result<()> {
    match weights.joints.iter().find(|&&j| usize::from(j) >= transforms.len()) {
        None => Ok(()),
        Some(joint) => Err(Error::mesh(
            "garment template",
            format!("joint {joint}"),
            format!("has no transform, there are {}", transforms.len()),
            "pose with the body that the weights belong to",
        )),
    }
}
