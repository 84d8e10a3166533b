//! Convex cross sections along an axis: what cloth spans when it bridges the hollows of a body.
//!
//! A section is stored as its support function h(θ) [m]: how far the body reaches from the axis in direction θ. Support
//! functions make the operations of dressmaking plain arithmetic: ease is an addition, hanging straight a running maximum.

use caphy_core::{Error, Result, TriMesh, Vec3};

/// Directions per section. At 64 the corners of the polygon stand out by 0.1 % of the radius.
pub(crate) const DIRECTIONS: usize = 64;
/// Distance of sections [m].
pub(crate) const ROW: f64 = 0.01;

/// Axis and two normals of a tube.
#[derive(Debug, Clone)]
pub(crate) struct TubeAxes {
    pub(crate) origin: Vec3,
    pub(crate) along: Vec3,
    across: [Vec3; 2],
}

impl TubeAxes {
    /// `along` and `side` need not be unit or orthogonal.
    pub(crate) fn new(origin: Vec3, along: Vec3, side: Vec3) -> Self {
        let along = along.try_normalize(0.0).unwrap_or_else(Vec3::y);
        let first = (side - along * side.dot(&along)).try_normalize(1e-9).unwrap_or_else(Vec3::z);
        Self { origin, along, across: [first, along.cross(&first)] }
    }
    /// Place along the axis [m].
    pub(crate) fn along_of(&self, p: &Vec3) -> f64 {
        (p - self.origin).dot(&self.along)
    }
    /// Unit vector of a direction.
    pub(crate) fn direction(&self, k: usize) -> Vec3 {
        let (s, c) = (std::f64::consts::TAU * k as f64 / DIRECTIONS as f64).sin_cos();
        self.across[0] * c + self.across[1] * s
    }
}

/// Sections of one limb: a smooth convex tube.
#[derive(Debug, Clone)]
pub(crate) struct Tube {
    pub(crate) axes: TubeAxes,
    /// Place of the first row along the axis [m].
    pub(crate) first: f64,
    /// Support functions [m], shape [row_count][DIRECTIONS].
    pub(crate) rows: Vec<[f32; DIRECTIONS]>,
    cos: [f32; DIRECTIONS],
    sin: [f32; DIRECTIONS],
}

impl Tube {
    /// Sections of the kept triangles over `range` (from, to) along the axis [m]. Rows outside `whole` repeat the nearest row
    /// inside: there the limb is no closed ring.
    pub(crate) fn measure(
        name: &str,
        mesh: &TriMesh,
        keep: &[bool],
        axes: TubeAxes,
        whole: (f64, f64),
        range: (f64, f64),
    ) -> Result<Self> {
        let count = (((range.1 - range.0) / ROW).ceil().max(0.0) as usize).min(1000) + 2;
        let angle = |k: usize| std::f64::consts::TAU * k as f64 / DIRECTIONS as f64;
        let cos: [f32; DIRECTIONS] = std::array::from_fn(|k| angle(k).cos() as f32);
        let sin: [f32; DIRECTIONS] = std::array::from_fn(|k| angle(k).sin() as f32);
        let mut rows = vec![[f32::NEG_INFINITY; DIRECTIONS]; count];
        for (f, _) in keep.iter().enumerate().filter(|&(_, &k)| k) {
            let corners = mesh.corners(f);
            let along = corners.map(|p| (axes.along_of(&p) - range.0) / ROW);
            let low = along.iter().copied().fold(f64::INFINITY, f64::min).ceil().max(0.0);
            let high = along.iter().copied().fold(f64::NEG_INFINITY, f64::max).floor().min((count - 1) as f64);
            if low > high {
                continue;
            }
            for row in low as usize..=high as usize {
                let level = row as f64;
                for k in 0..3 {
                    let (a, b) = (along[k], along[(k + 1) % 3]);
                    if (a - level) * (b - level) > 0.0 || a == b {
                        continue;
                    }
                    let p = corners[k].lerp(&corners[(k + 1) % 3], (level - a) / (b - a)) - axes.origin;
                    let (x, y) = (p.dot(&axes.across[0]) as f32, p.dot(&axes.across[1]) as f32);
                    for d in 0..DIRECTIONS {
                        rows[row][d] = rows[row][d].max(x * cos[d] + y * sin[d]);
                    }
                }
            }
        }
        let place = |row: usize| range.0 + row as f64 * ROW;
        let good: Vec<usize> = (0..count)
            .filter(|&r| rows[r][0].is_finite() && place(r) >= whole.0 - 1e-9 && place(r) <= whole.1 + 1e-9)
            .collect();
        if good.is_empty() {
            return Err(Error::mesh(
                "body at rest",
                name,
                format!("no triangle that its joints move lies between {:.3} and {:.3} m along it", whole.0, whole.1),
                "check that weights, joints and surface belong to the same T-posed body in metres",
            ));
        }
        for r in 0..count {
            if good.binary_search(&r).is_err() {
                let nearest = *good.iter().min_by_key(|&&g| g.abs_diff(r)).unwrap_or(&good[0]);
                rows[r] = rows[nearest];
            }
        }
        Ok(Self { axes, first: range.0, rows, cos, sin })
    }

    fn row_at(&self, along: f64) -> (usize, f32) {
        let t = ((along - self.first) / ROW).clamp(0.0, (self.rows.len() - 1) as f64);
        let row = (t as usize).min(self.rows.len() - 2);
        (row, (t - row as f64) as f32)
    }
    /// Reach from the axis in the direction nearest to `direction` [m].
    pub(crate) fn reach_at(&self, along: f64, direction: &Vec3) -> f64 {
        let (x, y) = (direction.dot(&self.axes.across[0]), direction.dot(&self.axes.across[1]));
        let k = (y.atan2(x) / std::f64::consts::TAU * DIRECTIONS as f64).round() as i64;
        let k = k.rem_euclid(DIRECTIONS as i64) as usize;
        let (row, t) = self.row_at(along);
        f64::from(self.rows[row][k] * (1.0 - t) + self.rows[row + 1][k] * t)
    }
    /// Girth of the convex section [m] (Cauchy: the integral of the support function).
    pub(crate) fn girth_at(&self, along: f64) -> f64 {
        let (row, t) = self.row_at(along);
        let sum: f32 = (0..DIRECTIONS).map(|k| self.rows[row][k] * (1.0 - t) + self.rows[row + 1][k] * t).sum();
        f64::from(sum) * std::f64::consts::TAU / DIRECTIONS as f64
    }
    /// Place along the axis of the smallest girth between two world heights (for an upright tube) [m].
    pub(crate) fn narrowest(&self, from: f64, to: f64) -> f64 {
        let (from, to) = (from - self.axes.origin.y, to - self.axes.origin.y);
        let steps = ((to - from) / ROW).max(1.0) as usize;
        let mut best = (f64::INFINITY, from);
        for i in 0..=steps {
            let at = from + (to - from) * i as f64 / steps as f64;
            let girth = self.girth_at(at);
            if girth < best.0 {
                best = (girth, at);
            }
        }
        best.1
    }
    /// Signed distance to the tube in its section plane [m]; negative inside. Exact where sections do not change along the
    /// axis, a smooth level function elsewhere.
    pub(crate) fn value(&self, p: &Vec3) -> f64 {
        let d = p - self.axes.origin;
        let (x, y) = (d.dot(&self.axes.across[0]) as f32, d.dot(&self.axes.across[1]) as f32);
        let (row, t) = self.row_at(d.dot(&self.axes.along));
        let (low, high) = (&self.rows[row], &self.rows[row + 1]);
        let mut g = [0f32; DIRECTIONS];
        for k in 0..DIRECTIONS {
            g[k] = x * self.cos[k] + y * self.sin[k] - (low[k] + (high[k] - low[k]) * t);
        }
        let mut best = 0;
        for k in 1..DIRECTIONS {
            if g[k] > g[best] {
                best = k;
            }
        }
        // The peak of the parabola through the three best directions: no facets.
        let (l, c, r) = (g[(best + DIRECTIONS - 1) % DIRECTIONS], g[best], g[(best + 1) % DIRECTIONS]);
        let bend = 2.0 * c - l - r;
        let peak = if bend > 1e-9 { c + (r - l) * (r - l) / (8.0 * bend) } else { c };
        f64::from(peak)
    }
    /// Adds `ease(place along the axis, direction)` [m].
    pub(crate) fn add_ease(&mut self, ease: impl Fn(f64, &Vec3) -> f64) {
        let directions: Vec<Vec3> = (0..DIRECTIONS).map(|k| self.axes.direction(k)).collect();
        for (r, row) in self.rows.iter_mut().enumerate() {
            let at = self.first + r as f64 * ROW;
            for k in 0..DIRECTIONS {
                row[k] += ease(at, &directions[k]) as f32;
            }
        }
    }
    /// Lets cloth hang from wider sections: starting at `from` [m], going along the axis (or against it), no section is narrower
    /// than the one before it less `slope` times the distance.
    pub(crate) fn hang(&mut self, from: f64, forward: bool, slope: f64) {
        let start = self.row_at(from).0;
        let drop = (slope * ROW) as f32;
        let order: Vec<usize> =
            if forward { (start + 1..self.rows.len()).collect() } else { (0..start).rev().collect() };
        for r in order {
            let before = self.rows[if forward { r - 1 } else { r + 1 }];
            for k in 0..DIRECTIONS {
                self.rows[r][k] = self.rows[r][k].max(before[k] - drop);
            }
        }
    }
    /// Smooths along the axis with a bell of standard deviation `sigma` [m], and a little around it.
    pub(crate) fn smooth(&mut self, sigma: f64) {
        let reach = (3.0 * sigma / ROW).ceil() as i64;
        let bell: Vec<f32> = (-reach..=reach).map(|i| (-0.5 * (i as f64 * ROW / sigma).powi(2)).exp() as f32).collect();
        let total: f32 = bell.iter().sum();
        let old = self.rows.clone();
        let last = old.len() as i64 - 1;
        for (r, row) in self.rows.iter_mut().enumerate() {
            let mut sum = [0f32; DIRECTIONS];
            for (i, w) in (-reach..=reach).zip(&bell) {
                let from = &old[(r as i64 + i).clamp(0, last) as usize];
                for k in 0..DIRECTIONS {
                    sum[k] += w * from[k];
                }
            }
            for k in 0..DIRECTIONS {
                let (l, h) = (sum[(k + DIRECTIONS - 1) % DIRECTIONS], sum[(k + 1) % DIRECTIONS]);
                row[k] = (0.5 * sum[k] + 0.25 * (l + h)) / total;
            }
        }
    }
}
