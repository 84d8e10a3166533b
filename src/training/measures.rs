//! What is looked at now and then while training: how far cloth is stretched and how deep it lies in the body.

use crate::track::BodyTrack;
use crate::trainer::Batch;
use caphy_core::lanes::Frames;
use caphy_core::{Real, Result, Vec3};
use caphy_garment::GarmentRest;
use caphy_garment::contact::ContactMap;
use rayon::prelude::*;
use serde::Serialize;

/// Measurements of one garment over the frames of a batch.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Measures {
    /// The larger principal stretch of each triangle (1: as at rest).
    pub major_stretch: Spread,
    /// The smaller one.
    pub minor_stretch: Spread,
    /// Where the garment lies in the body.
    pub body: Depth,
}

/// Extremes and percentiles, each a value that occurs (nearest rank).
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Spread {
    /// The smallest value.
    pub least: f32,
    /// 1 % are at most this.
    pub p1: f32,
    /// Half are at most this.
    pub p50: f32,
    /// 99 % are at most this.
    pub p99: f32,
    /// The largest value.
    pub most: f32,
}

/// Vertices beneath the tangent plane of the body vertex that they touch.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Depth {
    /// Their share of all vertices of all frames.
    pub inside: f64,
    /// The deepest of them [mm].
    pub deepest_mm: f64,
    /// Their mean depth [mm]; 0 without any.
    pub mean_mm: f64,
}

impl Spread {
    /// Of some values; zeros for none.
    pub fn of(values: &mut [f32]) -> Spread {
        if values.is_empty() {
            return Spread { least: 0.0, p1: 0.0, p50: 0.0, p99: 0.0, most: 0.0 };
        }
        let last = values.len() - 1;
        let mut rank = |share: f64| {
            let at = ((share * values.len() as f64).ceil() as usize).saturating_sub(1).min(last);
            *values.select_nth_unstable_by(at, f32::total_cmp).1
        };
        Spread { least: rank(0.0), p1: rank(0.01), p50: rank(0.5), p99: rank(0.99), most: rank(1.0) }
    }
}

/// Principal stretches of a triangle from its corners [m] and D_m⁻¹: larger and smaller singular value of F (Eq. 3).
pub fn principal_stretches([a, b, c]: [Vec3; 3], [m00, m01, m10, m11]: [f64; 4]) -> [f64; 2] {
    let (d1, d2) = (b - a, c - a);
    let (fu, fv) = (d1 * m00 + d2 * m10, d1 * m01 + d2 * m11);
    let (uu, vv, uv) = (fu.norm_squared(), fv.norm_squared(), fu.dot(&fv));
    let major = (0.5 * (uu + vv) + (0.5 * (uu - vv)).hypot(uv)).sqrt();
    // By the area, which does not cancel where the triangle has almost collapsed.
    let minor = if major > 0.0 { fu.cross(&fv).norm() / major } else { 0.0 };
    [major, minor]
}

/// Principal stretches over all triangles (those that have an area at rest) and frames.
pub fn stretches(rest: &GarmentRest, positions: &Frames<f32>) -> [Spread; 2] {
    let lanes = positions.lanes_used();
    let faces = || (0..rest.faces().len()).filter(|&f| rest.areas[f] > 0.0);
    // The order of frames is that of the batch on any number of threads.
    let pairs: Vec<[f32; 2]> = (0..positions.frames())
        .into_par_iter()
        .flat_map_iter(|frame| {
            let (block, lane) = (frame / lanes, frame % lanes);
            faces().map(move |f| {
                let corners = rest.faces()[f].map(|v| positions.get(block, lane, v as usize));
                principal_stretches(corners, rest.dm_inverse[f]).map(|s| s as f32)
            })
        })
        .collect();
    [0, 1].map(|i| Spread::of(&mut pairs.iter().map(|p| p[i]).collect::<Vec<f32>>()))
}

/// Depth of a batch's garments in the body.
///
/// # Errors
/// As [`ContactMap::nearest`].
pub fn depth(map: &ContactMap, track: &BodyTrack, batch: &Batch, positions: &Frames<f32>) -> Result<Depth> {
    let (body, normals) = track.gather::<f32>(&batch.frames, batch.windows)?;
    let nearest = map.nearest(positions, &body)?;
    let (lanes, vertices) = (positions.lanes_used(), positions.vertices());
    let per_frame: Vec<(usize, f64, f64)> = (0..positions.frames())
        .into_par_iter()
        .map(|frame| {
            let (block, lane) = (frame / lanes, frame % lanes);
            let (mut count, mut sum, mut deepest) = (0, 0.0, 0.0f64);
            for v in 0..vertices {
                let id = nearest[(block * vertices + v) * <f32 as Real>::LANES + lane] as usize;
                let gap = positions.get(block, lane, v) - body.get(block, lane, id);
                let depth = -normals.get(block, lane, id).dot(&gap);
                if depth > 0.0 {
                    count += 1;
                    sum += depth;
                    deepest = deepest.max(depth);
                }
            }
            (count, sum, deepest)
        })
        .collect();
    let (count, sum, deepest) = per_frame.iter().fold((0, 0.0, 0.0f64), |(c, s, d), p| (c + p.0, s + p.1, d.max(p.2)));
    Ok(Depth {
        inside: count as f64 / (positions.frames() * vertices).max(1) as f64,
        deepest_mm: 1e3 * deepest,
        mean_mm: if count == 0 { 0.0 } else { 1e3 * sum / count as f64 },
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stretches_are_those_of_the_deformation() {
        // Rest: u along x, v along y, 2 m by 4 m. Stretched by 1.5 and 0.25, then turned: turning changes nothing.
        let inverse = [0.5, 0.0, 0.0, 0.25];
        let turn = nalgebra::Rotation3::new(Vec3::new(0.3, -1.1, 0.4));
        let corners = [Vec3::zeros(), turn * Vec3::new(3.0, 0.0, 0.0), turn * Vec3::new(0.0, 1.0, 0.0)];
        let [major, minor] = principal_stretches(corners, inverse);
        assert!((major - 1.5).abs() < 1e-12 && (minor - 0.25).abs() < 1e-12, "{major} {minor}");
        // Simple shear by g: the squares are 1 + g²/2 ± g √(1 + g²/4).
        let g = 0.7f64;
        let sheared = [Vec3::zeros(), Vec3::new(2.0, 0.0, 0.0), Vec3::new(4.0 * g, 4.0, 0.0)];
        let [major, minor] = principal_stretches(sheared, inverse);
        let [a, b] = [1.0, -1.0].map(|s| (1.0 + g * g / 2.0 + s * g * (1.0 + g * g / 4.0).sqrt()).sqrt());
        assert!((major - a).abs() < 1e-12 && (minor - b).abs() < 1e-12, "{major} {minor}");
        assert_eq!(principal_stretches([Vec3::repeat(0.2); 3], inverse), [0.0, 0.0]);
    }

    #[test]
    fn percentiles_are_values_of_nearest_rank() {
        let mut values: Vec<f32> = (1..=200).rev().map(|i| i as f32).collect();
        let spread = Spread::of(&mut values);
        assert_eq!(spread, Spread { least: 1.0, p1: 2.0, p50: 100.0, p99: 198.0, most: 200.0 });
        assert_eq!(Spread::of(&mut [3.0]), Spread { least: 3.0, p1: 3.0, p50: 3.0, p99: 3.0, most: 3.0 });
        assert_eq!(Spread::of(&mut []).most, 0.0);
    }
}
