//! A uniform grid of cells, searched in growing shells around a query.

use crate::Real;
use std::ops::Range;

/// Which entries lie in which cell; an entry is a slot of the searcher's own arrays.
#[derive(Debug, Clone)]
pub(super) struct Cells<T> {
    origin: [T; 3],
    cell: T,
    inverse: T,
    size: [i32; 3],
    starts: Vec<u32>,
}

/// Most cells along an axis.
const MOST: i32 = 512;

impl<T: Real> Cells<T> {
    /// Empty cells of a positive size `cell` [m] over a box; larger ones where the box would need more than 512 along an axis.
    pub(super) fn new(low: [T; 3], high: [T; 3], cell: f64) -> Self {
        let extent: [f64; 3] = std::array::from_fn(|k| (high[k] - low[k]).to_f64());
        let longest = extent.iter().copied().fold(0.0, f64::max);
        let cell = T::of(cell.max(longest / f64::from(MOST - 1)));
        let size: [i32; 3] = std::array::from_fn(|k| ((extent[k] / cell.to_f64()) as i32 + 1).min(MOST));
        Self { origin: low, cell, inverse: T::one() / cell, size, starts: Vec::new() }
    }
    /// Number of the cell that holds a point, which is moved into the box if it lies outside.
    pub(super) fn index_of(&self, p: &[T; 3]) -> u32 {
        self.index(self.cell_at(&self.relative(p))) as u32
    }
    /// Sorts entries (cell, id) by cell, ids in the order given; returns the id of each slot.
    pub(super) fn fill(&mut self, entries: &[(u32, u32)]) -> Vec<u32> {
        let cells = self.size.iter().map(|&n| n as usize).product::<usize>();
        self.starts = vec![0; cells + 1];
        for &(cell, _) in entries {
            self.starts[cell as usize + 1] += 1;
        }
        for c in 0..cells {
            self.starts[c + 1] += self.starts[c];
        }
        let mut at = self.starts.clone();
        let mut ids = vec![0; entries.len()];
        for &(cell, id) in entries {
            let slot = &mut at[cell as usize];
            ids[*slot as usize] = id;
            *slot += 1;
        }
        ids
    }
    #[inline(always)]
    fn relative(&self, p: &[T; 3]) -> [T; 3] {
        std::array::from_fn(|k| p[k] - self.origin[k])
    }
    #[inline(always)]
    fn cell_at(&self, relative: &[T; 3]) -> [i32; 3] {
        // Casts saturate.
        std::array::from_fn(|k| ((relative[k] * self.inverse).to_f64() as i32).clamp(0, self.size[k] - 1))
    }
    #[inline(always)]
    fn index(&self, c: [i32; 3]) -> usize {
        ((c[2] * self.size[1] + c[1]) * self.size[0] + c[0]) as usize
    }

    /// Visits slots near a finite query, shell by shell, until everything left is farther than the limit, a squared
    /// distance [m²]. `visit` returns the limit from then on.
    #[inline(always)]
    pub(super) fn search(&self, query: &[T; 3], mut limit: T, mut visit: impl FnMut(Range<usize>) -> T) {
        let r = self.relative(query);
        let centre = self.cell_at(&r);
        // An entry may lie in the next cell by rounding of its cell number, far below a thousandth of a cell; computed
        // distances are off by a few units in the last place.
        let slack = self.cell * T::of(1e-3);
        let shrink = T::one() - T::of(16.0) * T::epsilon();
        let square = |gap: T| {
            let gap = (gap - slack).max(T::zero());
            gap * gap * shrink
        };
        let edge = |c: i32| T::of(f64::from(c)) * self.cell;
        // Distance to a slab of cells.
        let slab = |k: usize, c: i32| square((edge(c) - r[k]).max(r[k] - edge(c + 1)));
        let outside: [T; 3] = std::array::from_fn(|k| square((-r[k]).max(r[k] - edge(self.size[k]))));
        let rings = self.size[0].max(self.size[1]).max(self.size[2]);
        for ring in 0..rings {
            if ring > 0 {
                // What is left lies beyond one of the faces of the box of smaller rings.
                let mut bound = T::infinity();
                for k in 0..3 {
                    let others = outside[(k + 1) % 3] + outside[(k + 2) % 3];
                    let (low, high) = (centre[k] - ring, centre[k] + ring);
                    if low >= 0 {
                        bound = bound.min(square(r[k] - edge(low + 1)) + others);
                    }
                    if high < self.size[k] {
                        bound = bound.min(square(edge(high) - r[k]) + others);
                    }
                }
                if bound == T::infinity() || bound > limit {
                    break;
                }
            }
            let range = |k: usize| ((centre[k] - ring).max(0), (centre[k] + ring).min(self.size[k] - 1));
            let ((x0, x1), (y0, y1), (z0, z1)) = (range(0), range(1), range(2));
            for z in z0..=z1 {
                let away_z = slab(2, z);
                if away_z > limit {
                    continue;
                }
                for y in y0..=y1 {
                    let away = away_z + slab(1, y);
                    if away + outside[0] > limit {
                        continue;
                    }
                    let mut row = |x0: i32, x1: i32| {
                        let from = self.starts[self.index([x0, y, z])] as usize;
                        let to = self.starts[self.index([x1, y, z]) + 1] as usize;
                        if from < to {
                            limit = visit(from..to);
                        }
                    };
                    if (z - centre[2]).abs() == ring || (y - centre[1]).abs() == ring {
                        row(x0, x1);
                    } else {
                        if centre[0] - ring >= 0 {
                            row(centre[0] - ring, centre[0] - ring);
                        }
                        if centre[0] + ring < self.size[0] {
                            row(centre[0] + ring, centre[0] + ring);
                        }
                    }
                }
            }
        }
    }
}
