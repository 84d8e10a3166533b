//! Which part of the body a garment vertex can touch.
//!
//! Captured motion moves hands and forearms through the trunk. Were every body vertex a candidate, cloth at the belly would find
//! a forearm inside the body nearest and be dragged out around it. A garment vertex therefore only meets the skin near
//! the vertices that its own joint moves, measured in the T-pose; what it leaves out is contact across limbs (a hand on
//! a hip), which a penalty on nearest vertices cannot resolve anyway.

use crate::energy::{NoNearest, lane_points, nearest_of_all};
use caphy_core::body::BlendWeights;
use caphy_core::lanes::Frames;
use caphy_core::query::NearestGrid;
use caphy_core::{Error, Real, Result, Vec3};
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Garment vertices with the same dominant joint, and the body vertices that they can touch.
#[derive(Debug, Clone, PartialEq)]
struct Region {
    garment: Vec<u32>,
    body: Vec<u32>,
}

/// Candidates for contact, fixed in the T-pose.
#[derive(Debug, Clone, PartialEq)]
pub struct ContactMap {
    regions: Vec<Region>,
    garment_count: usize,
    body_count: usize,
}

impl ContactMap {
    /// For a template with its weights and a T-posed body (its reachable part, in the order of the frames to come): a region's
    /// candidates lie within `distance` [m] of any of its vertices, or are the nearest when there are none.
    ///
    /// # Errors
    /// [`Error::Length`] for other weights than vertices, [`Error::Mesh`] for a body without vertices.
    pub fn new(template: &[Vec3], weights: &BlendWeights, body: &[Vec3], distance: f64) -> Result<Self> {
        Error::check_length("rows of garment weights", template.len(), weights.vertex_count())?;
        let whole = NearestGrid::from_points(body);
        let mut by_joint: BTreeMap<usize, Vec<u32>> = BTreeMap::new();
        for v in 0..template.len() {
            let strongest = weights.row(v).fold((0, 0.0), |best, (j, w)| if w > best.1 { (j, w) } else { best });
            by_joint.entry(strongest.0).or_default().push(v as u32);
        }
        let limit = distance * distance;
        let regions = by_joint
            .into_values()
            .map(|garment| {
                let points: Vec<Vec3> = garment.iter().map(|&v| template[v as usize]).collect();
                let grid = NearestGrid::from_points(&points);
                let mut ids: Vec<u32> = (0..body.len() as u32)
                    .filter(|&b| {
                        let p = body[b as usize];
                        grid.nearest_within(&[p.x, p.y, p.z], limit).is_some()
                    })
                    .collect();
                if ids.is_empty() {
                    ids = points.iter().filter_map(|p| whole.nearest_point(p)).map(|(id, _)| id).collect();
                    ids.sort_unstable();
                    ids.dedup();
                }
                if ids.is_empty() {
                    return Err(Error::mesh("body", "whole surface", "has no vertices", "give the body's surface"));
                }
                Ok(Region { garment, body: ids })
            })
            .collect::<Result<Vec<_>>>()?;
        Ok(Self { regions, garment_count: template.len(), body_count: body.len() })
    }

    /// The same with further obstacle vertices behind the body's, which every garment vertex can touch: another garment.
    pub fn with_obstacle(mut self, vertices: usize) -> Self {
        let added = self.body_count as u32..(self.body_count + vertices) as u32;
        for region in &mut self.regions {
            region.body.extend(added.clone());
        }
        self.body_count += vertices;
        self
    }

    /// Nearest candidate of each garment vertex, `[block][garment vertex][lane]`; spare lanes repeat the last frame: the
    /// `nearest` of [`crate::energy::BodyState`].
    ///
    /// # Errors
    /// [`Error::Length`] for other garments or bodies, [`Error::Numerics`] naming a garment vertex that is not finite.
    pub fn nearest<T: Real>(&self, garment: &Frames<T>, body: &Frames<T>) -> Result<Vec<u32>> {
        Error::check_length("garment vertices of the contact map", self.garment_count, garment.vertices())?;
        Error::check_length("body vertices of the contact map", self.body_count, body.vertices())?;
        Error::check_length("body frames of the contact search", garment.frames(), body.frames())?;
        let (lanes, n) = (garment.lanes_used(), garment.vertices());
        let per_frame: Vec<Result<Vec<u32>>> = (0..garment.frames())
            .into_par_iter()
            .map(|frame| {
                let (block, lane) = (frame / lanes, frame % lanes);
                let (cloth, skin) = (lane_points(garment, block, lane), lane_points(body, block, lane));
                let mut out = vec![0u32; n];
                for region in &self.regions {
                    let points: Vec<[T; 3]> = region.body.iter().map(|&b| skin[b as usize]).collect();
                    let queries: Vec<[T; 3]> = region.garment.iter().map(|&v| cloth[v as usize]).collect();
                    let found = nearest_of_all(&NearestGrid::new(&points), &queries).map_err(|e| match e {
                        // The search counts within its region, people count within the garment.
                        NoNearest::Query(i, at) => {
                            NoNearest::Query(region.garment[i] as usize, at).into_error(block, lane)
                        }
                        empty => empty.into_error(block, lane),
                    })?;
                    for (&v, id) in region.garment.iter().zip(found) {
                        out[v as usize] = region.body[id as usize];
                    }
                }
                Ok(out)
            })
            .collect();
        let per_frame = per_frame.into_iter().collect::<Result<Vec<_>>>()?;
        let mut out = vec![0u32; garment.blocks() * n * T::LANES];
        if n == 0 {
            return Ok(out);
        }
        for (block, rows) in out.chunks_exact_mut(n * T::LANES).enumerate() {
            for (v, row) in rows.chunks_exact_mut(T::LANES).enumerate() {
                for (l, slot) in row.iter_mut().enumerate() {
                    *slot = per_frame[block * lanes + l.min(lanes - 1)][v];
                }
            }
        }
        Ok(out)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::energy::nearest_body_vertices;

    /// A trunk (joint 0) and a forearm (joint 1) far from it in the T-pose.
    fn scene() -> (Vec<Vec3>, BlendWeights, Vec<Vec3>) {
        let trunk: Vec<Vec3> = (0..10).map(|i| Vec3::new(0.0, 0.1 * i as f64, 0.1)).collect();
        let arm: Vec<Vec3> = (0..5).map(|i| Vec3::new(0.8 + 0.1 * i as f64, 0.9, 0.0)).collect();
        let body: Vec<Vec3> = trunk.iter().chain(&arm).copied().collect();
        let shirt: Vec<Vec3> = trunk.iter().map(|p| p + Vec3::new(0.0, 0.0, 0.01)).collect();
        let weights = BlendWeights::from_rows(shirt.iter().map(|_| vec![(0u16, 1.0)]));
        (shirt, weights, body)
    }

    #[test]
    fn a_forearm_inside_the_trunk_does_not_attract_the_shirt() {
        let (shirt, weights, body) = scene();
        let map = ContactMap::new(&shirt, &weights, &body, 0.1).unwrap();
        let mut posed = body.clone();
        for (i, p) in posed[10..].iter_mut().enumerate() {
            *p = shirt[i] + Vec3::new(0.001, 0.0, 0.0);
        }
        let mut garment = Frames::<f64>::zeros(1, 10, 1);
        garment.set_frame(0, 0, &shirt).unwrap();
        let mut frames = Frames::<f64>::zeros(1, 15, 1);
        frames.set_frame(0, 0, &posed).unwrap();
        let nearest = map.nearest(&garment, &frames).unwrap();
        assert!(nearest.iter().all(|&id| id < 10));
        assert!(nearest_body_vertices(&garment, &frames).unwrap().iter().any(|&id| id >= 10));
    }

    #[test]
    fn without_limit_it_equals_the_search_among_all() {
        let (shirt, weights, body) = scene();
        let map = ContactMap::new(&shirt, &weights, &body, 10.0).unwrap();
        let mut garment = Frames::<f32>::zeros(2, 10, 3);
        let mut frames = Frames::<f32>::zeros(2, 15, 3);
        for f in 0..6 {
            let shift = Vec3::new(0.02 * f as f64, 0.013 * f as f64, 0.0);
            garment.set_frame(f / 3, f % 3, &shirt.iter().map(|p| p + shift).collect::<Vec<_>>()).unwrap();
            frames.set_frame(f / 3, f % 3, &body).unwrap();
        }
        assert_eq!(map.nearest(&garment, &frames).unwrap(), nearest_body_vertices(&garment, &frames).unwrap());
        let bad = Frames::<f32>::zeros(2, 9, 3);
        assert!(map.nearest(&bad, &frames).is_err());
        garment.data_mut()[0] = f32::NAN;
        assert!(map.nearest(&garment, &frames).unwrap_err().to_string().contains("vertex 0"));
    }
}
