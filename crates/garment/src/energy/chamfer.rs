//! Scan term (Eq. 9): symmetric Chamfer distance to a point cloud.

use super::collision::{NoNearest, lane_points, nearest_of_all, square_distance};
use super::tangent::{EnergyTangent, Stencil, Tangent, isotropic, only_frame};
use super::{EnergyTerm, State, check_energy, check_shapes};
use crate::GarmentRest;
use caphy_core::lanes::Frames;
use caphy_core::material::MaterialReal;
use caphy_core::query::NearestGrid;
use caphy_core::{Error, Real, Result, Vec3};
use rayon::prelude::*;

/// Points of one garment in one scan, ready to be searched.
#[derive(Debug, Clone)]
pub struct ScanCloud<T> {
    points: Vec<[T; 3]>,
    grid: NearestGrid<T>,
}

impl<T: Real> ScanCloud<T> {
    /// From points [m].
    ///
    /// # Errors
    /// [`Error::Mesh`] for a cloud without points, [`Error::NonFinite`] for a bad one.
    pub fn new(name: &str, points: &[Vec3]) -> Result<Self> {
        let points: Vec<[T; 3]> = points.iter().map(|p| [T::of(p.x), T::of(p.y), T::of(p.z)]).collect();
        if points.is_empty() {
            let remedy = "look at the segmentation of this scan, or leave the garment's scan term out";
            return Err(Error::mesh(name, "scan", "has no point of this garment".to_string(), remedy));
        }
        Error::check_finite(&format!("points of {name}"), points.as_flattened())?;
        let grid = NearestGrid::new(&points);
        Ok(Self { points, grid })
    }
    /// Points [m].
    pub fn points(&self) -> &[[T; 3]] {
        &self.points
    }
}

/// E = mean_v min_c |x_v − c|² + mean_c min_v |x_v − c|² [m²] per frame (Eq. 9): squared distances, both directions, mean over
/// points. The nearest pairs are held while differentiating.
///
/// In sums with joules, `weight` of [`EnergyTerm::add`] is λ3d [J/m²].
pub struct Chamfer {
    taking_part: Vec<u32>,
    vertex_count: usize,
}

impl Chamfer {
    /// With the garment vertices that take part: all for `None`, else those marked, so that a hidden waist is not pulled to
    /// anything (`visible_only`).
    ///
    /// # Errors
    /// [`Error::Length`] for a mask of another garment, [`Error::Mesh`] for a mask without a vertex.
    pub fn new(rest: &GarmentRest, visible: Option<&[bool]>) -> Result<Self> {
        let vertex_count = rest.vertex_count();
        let taking_part: Vec<u32> = match visible {
            None => (0..vertex_count as u32).collect(),
            Some(mask) => {
                Error::check_length("mask of visible garment vertices", vertex_count, mask.len())?;
                (0..vertex_count as u32).filter(|&v| mask[v as usize]).collect()
            }
        };
        if taking_part.is_empty() {
            let remedy = "use all vertices, or leave the scan term out";
            return Err(Error::mesh(&rest.name, "scan term", "no garment vertex takes part".to_string(), remedy));
        }
        Ok(Self { taking_part, vertex_count })
    }

    /// Energy and gradient [vertex] of one frame.
    fn frame<T: Real>(
        &self,
        x: &[[T; 3]],
        scan: &ScanCloud<T>,
        wanted: bool,
    ) -> std::result::Result<(f64, Vec<[T; 3]>), NoNearest<T>> {
        let part: Vec<[T; 3]> = self.taking_part.iter().map(|&v| x[v as usize]).collect();
        let mut gradient = vec![[T::zero(); 3]; if wanted { part.len() } else { 0 }];
        let mut energy = 0.0;
        let to_scan = nearest_of_all(&scan.grid, &part).map_err(|e| match e {
            NoNearest::Query(i, p) => NoNearest::Query(self.taking_part[i] as usize, p),
            NoNearest::Empty => NoNearest::Empty,
        })?;
        let to_garment = nearest_of_all(&NearestGrid::new(&part), &scan.points)?;
        let ahead = to_scan.iter().enumerate().map(|(i, &c)| (i, c as usize));
        let back = to_garment.iter().enumerate().map(|(c, &i)| (i as usize, c));
        for (pairs, count) in [
            (&mut ahead.into_iter() as &mut dyn Iterator<Item = (usize, usize)>, part.len()),
            (&mut back.into_iter(), scan.points.len()),
        ] {
            let scale = 1.0 / count as f64;
            let twice = T::of(2.0 * scale);
            for (i, c) in pairs {
                let (p, q) = (part[i], scan.points[c]);
                energy += scale * square_distance(&p, &q).to_f64();
                if wanted {
                    for k in 0..3 {
                        gradient[i][k] += twice * (p[k] - q[k]);
                    }
                }
            }
        }
        Ok((energy, gradient))
    }
}

impl<T: MaterialReal> EnergyTerm<T> for Chamfer {
    fn name(&self) -> &'static str {
        "chamfer"
    }
    fn add(
        &self,
        state: &State<'_, T>,
        weight: f64,
        energy: &mut [f64],
        gradient: Option<&mut Frames<T>>,
    ) -> Result<()> {
        let x = state.positions;
        check_shapes("chamfer", self.vertex_count, x, energy, gradient.as_deref())?;
        Error::check_length("scans of the batch, one per frame", x.frames(), state.scans.len())?;
        let lanes = x.lanes_used();
        let wanted = gradient.is_some();
        let results: Vec<Result<(f64, Vec<[T; 3]>)>> = (0..x.frames())
            .into_par_iter()
            .map(|frame| {
                let (block, lane) = (frame / lanes, frame % lanes);
                let answer = self.frame(&lane_points(x, block, lane), state.scans[frame], wanted);
                let (value, gradient) = answer.map_err(|e| e.into_error(block, lane))?;
                check_energy("chamfer", x, block, lane, weight * value)?;
                Ok((value, gradient))
            })
            .collect();
        let results = results.into_iter().collect::<Result<Vec<_>>>()?;
        for (slot, (value, _)) in energy.iter_mut().zip(&results) {
            *slot += weight * value;
        }
        let Some(gradient) = gradient else { return Ok(()) };
        let weight = T::of(weight);
        for (frame, (_, part)) in results.iter().enumerate() {
            let (block, lane) = (frame / lanes, frame % lanes);
            // Spare lanes repeat the last window, as in the positions.
            let last = if lane + 1 == lanes { T::LANES } else { lane + 1 };
            let values = gradient.block_mut(block);
            for (&v, g) in self.taking_part.iter().zip(part) {
                for (k, g) in g.iter().enumerate() {
                    let at = (v as usize * 3 + k) * T::LANES;
                    values[at + lane..at + last].iter_mut().for_each(|slot| *slot += weight * *g);
                }
            }
        }
        Ok(())
    }
}

impl EnergyTangent for Chamfer {
    fn stencil(&self) -> Stencil {
        Stencil { width: 1, vertices: self.taking_part.clone() }
    }
    fn tangents(&self, state: &State<'_, f64>, weight: f64, _: Tangent, blocks: &mut [f64]) -> Result<()> {
        Error::check_length("second derivatives of the scan term", 9 * self.taking_part.len(), blocks.len())?;
        let x = only_frame("chamfer", state.positions)?;
        Error::check_length("vertices of the garment in chamfer", self.vertex_count, x.len())?;
        Error::check_length("scans of the batch, one per frame", 1, state.scans.len())?;
        let scan = state.scans[0];
        let part: Vec<[f64; 3]> = self.taking_part.iter().map(|&v| x[v as usize]).collect();
        let to_garment = nearest_of_all(&NearestGrid::new(&part), &scan.points).map_err(|e| e.into_error(0, 0))?;
        let mut stiffness = vec![2.0 * weight / part.len() as f64; part.len()];
        for i in to_garment {
            stiffness[i as usize] += 2.0 * weight / scan.points.len() as f64;
        }
        isotropic(stiffness.into_iter(), blocks);
        Ok(())
    }
}
