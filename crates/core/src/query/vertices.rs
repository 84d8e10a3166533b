//! Exact nearest vertices.

use super::cells::Cells;
use crate::{Real, Vec3};

/// Exact nearest-point search over a fixed set of points.
///
/// Ties go to the smallest index, so results do not depend on build order or thread count.
#[derive(Debug, Clone)]
pub struct NearestGrid<T> {
    cells: Cells<T>,
    /// Id and position of each slot.
    ids: Vec<u32>,
    points: Vec<[T; 3]>,
    /// Slot of each id, `u32::MAX` for points that are not finite.
    slots: Vec<u32>,
}

fn finite<T: Real>(p: &[T; 3]) -> bool {
    p.iter().all(|c| c.is_finite())
}

#[inline(always)]
fn square_distance<T: Real>(a: &[T; 3], b: &[T; 3]) -> T {
    let (x, y, z) = (a[0] - b[0], a[1] - b[1], a[2] - b[2]);
    x * x + y * y + z * z
}

impl<T: Real> NearestGrid<T> {
    /// Builds from points [m]; non-finite points are left out. About two points share a cell.
    pub fn new(points: &[[T; 3]]) -> Self {
        let mut lo = [T::infinity(); 3];
        let mut hi = [T::neg_infinity(); 3];
        let mut count = 0usize;
        for p in points.iter().filter(|p| finite(p)) {
            count += 1;
            for k in 0..3 {
                lo[k] = lo[k].min(p[k]);
                hi[k] = hi[k].max(p[k]);
            }
        }
        if count == 0 {
            lo = [T::zero(); 3];
            hi = lo;
        }
        let longest = (0..3).map(|k| (hi[k] - lo[k]).to_f64()).fold(1e-9, f64::max);
        // Surfaces fill about n^(2/3) of a cube's cells: choose the cell so that a surface point finds company.
        let cell = (longest / (count.max(1) as f64 / 2.0).sqrt()).max(longest / 256.0);
        let mut cells = Cells::new(lo, hi, cell);
        let entries: Vec<(u32, u32)> = points
            .iter()
            .enumerate()
            .filter(|(_, p)| finite(p))
            .map(|(id, p)| (cells.index_of(p), id as u32))
            .collect();
        let ids = cells.fill(&entries);
        let mut slots = vec![u32::MAX; points.len()];
        for (slot, &id) in ids.iter().enumerate() {
            slots[id as usize] = slot as u32;
        }
        Self { points: ids.iter().map(|&id| points[id as usize]).collect(), cells, ids, slots }
    }
    /// Whether there is no point to find.
    pub fn is_empty(&self) -> bool {
        self.ids.is_empty()
    }
    /// Id of the nearest point and the squared distance [m²]; `None` without points, for a query that is not finite, or one so
    /// far that the square is not.
    pub fn nearest(&self, query: &[T; 3]) -> Option<(u32, T)> {
        self.search(query, None, T::infinity())
    }
    /// As [`NearestGrid::nearest`], but only points with squared distance below `limit` [m²].
    pub fn nearest_within(&self, query: &[T; 3], limit: T) -> Option<(u32, T)> {
        self.search(query, None, limit)
    }
    /// As [`NearestGrid::nearest`], to the last bit, and the faster the nearer the point `known` is: the answer of the frame
    /// before, or of a neighbour. An id that names no finite point does not help.
    pub fn nearest_from(&self, query: &[T; 3], known: u32) -> Option<(u32, T)> {
        let slot = self.slots.get(known as usize).copied().unwrap_or(u32::MAX);
        match self.points.get(slot as usize) {
            None => self.nearest(query),
            Some(p) => {
                let d = square_distance(p, query);
                self.search(query, Some((known, d)), d)
            }
        }
    }
    fn search(&self, query: &[T; 3], mut best: Option<(u32, T)>, mut limit: T) -> Option<(u32, T)> {
        if self.ids.is_empty() || !finite(query) {
            return None;
        }
        self.cells.search(query, limit, |slots| {
            for (&id, p) in self.ids[slots.clone()].iter().zip(&self.points[slots]) {
                let d = square_distance(p, query);
                let better = match best {
                    None => d < limit,
                    Some((best_id, best_d)) => d < best_d || (d == best_d && id < best_id),
                };
                if better {
                    best = Some((id, d));
                    limit = d;
                }
            }
            limit
        });
        best
    }
}

impl NearestGrid<f64> {
    /// Builds from vectors.
    pub fn from_points(points: &[Vec3]) -> Self {
        let arrays: Vec<[f64; 3]> = points.iter().map(|p| [p.x, p.y, p.z]).collect();
        Self::new(&arrays)
    }
    /// [`NearestGrid::nearest`] of a vector.
    pub fn nearest_point(&self, query: &Vec3) -> Option<(u32, f64)> {
        self.nearest(&[query.x, query.y, query.z])
    }
}
