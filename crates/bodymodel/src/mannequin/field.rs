//! Implicit solids: lofts and ellipsoids whose value is a first-order distance [m], negative inside, and their blends.

use caphy_core::Vec3;
use nalgebra::{Matrix3, Rotation3};

/// A solid of the figure.
pub(super) trait Solid {
    /// Distance [m], first order near the surface, negative inside.
    fn distance(&self, p: &Vec3) -> f64;
    /// Smallest and largest corner of what it fills [m].
    fn bounds(&self) -> (Vec3, Vec3);
    /// Union of `d` and this solid with a seam of width `k` [m]; a solid that is too far to matter is not evaluated.
    fn join(&self, p: &Vec3, d: f64, k: f64) -> f64 {
        let (low, high) = self.bounds();
        if outside(p, &low, &high) >= d + k { d } else { smooth_min(d, self.distance(p), k) }
    }
}

/// How far outside its box a solid is still evaluated [m]; farther away the distance to the box stands in.
const MARGIN: f64 = 0.08;

/// Samples of a loft's table; between them everything is linear.
const SAMPLES: usize = 384;

/// One cross-section of a loft.
#[derive(Debug, Clone, Copy)]
pub(super) struct Section {
    /// Position along the axis [m].
    pub(super) at: f64,
    /// Centre in the two other axes [m].
    pub(super) centre: [f64; 2],
    /// Radii towards +first, -first, +second, -second axis [m].
    pub(super) radii: [f64; 4],
}

impl Section {
    fn values(&self) -> [f64; 6] {
        [self.centre[0], self.centre[1], self.radii[0], self.radii[1], self.radii[2], self.radii[3]]
    }
}

/// A solid with smoothly varying, superelliptic cross-sections along a coordinate axis.
#[derive(Debug, Clone)]
pub(super) struct Loft {
    axis: usize,
    from: f64,
    to: f64,
    exponent: f64,
    /// Radius with which the ends are rounded [m].
    rounding: f64,
    samples: Vec<[f64; 6]>,
    low: Vec3,
    high: Vec3,
}

impl Loft {
    /// Sections in ascending order; `axis` 0, 1, 2 for x, y, z, the other two in cyclic order after it.
    pub(super) fn new(axis: usize, exponent: f64, rounding: f64, sections: &[Section]) -> Self {
        let (from, to) = (sections[0].at, sections[sections.len() - 1].at);
        let samples: Vec<[f64; 6]> =
            (0..SAMPLES).map(|i| hermite(sections, from + (to - from) * i as f64 / (SAMPLES - 1) as f64)).collect();
        let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
        let mut low = Vec3::repeat(f64::INFINITY);
        let mut high = -low;
        (low[axis], high[axis]) = (from, to);
        for s in &samples {
            low[u] = low[u].min(s[0] - s[3]);
            high[u] = high[u].max(s[0] + s[2]);
            low[v] = low[v].min(s[1] - s[5]);
            high[v] = high[v].max(s[1] + s[4]);
        }
        Self { axis, from, to, exponent, rounding, samples, low, high }
    }
}

impl Solid for Loft {
    fn bounds(&self) -> (Vec3, Vec3) {
        (self.low, self.high)
    }
    fn distance(&self, p: &Vec3) -> f64 {
        let far = outside(p, &self.low, &self.high);
        if far > MARGIN {
            return far;
        }
        let x = ((p[self.axis] - self.from) / (self.to - self.from)).clamp(0.0, 1.0) * (SAMPLES - 1) as f64;
        let i = (x as usize).min(SAMPLES - 2);
        let t = x - i as f64;
        let s: [f64; 6] = std::array::from_fn(|k| self.samples[i][k] * (1.0 - t) + self.samples[i + 1][k] * t);
        // Change of the sections along the axis.
        let per_metre = (SAMPLES - 1) as f64 / (self.to - self.from);
        let g: [f64; 6] = std::array::from_fn(|k| (self.samples[i + 1][k] - self.samples[i][k]) * per_metre);
        let (u, v) = (p[(self.axis + 1) % 3] - s[0], p[(self.axis + 2) % 3] - s[1]);
        let (a, da) = if u > 0.0 { (s[2], g[2]) } else { (s[3], g[3]) };
        let (b, db) = if v > 0.0 { (s[4], g[4]) } else { (s[5], g[5]) };
        let centre_rate = [g[0] * u.signum(), g[1] * v.signum()];
        let side = superellipse([u.abs(), v.abs()], [a, b], centre_rate, [da, db], self.exponent);
        let end = (self.from - p[self.axis]).max(p[self.axis] - self.to);
        smooth_max(side, end, self.rounding)
    }
}

/// Cubic through the sections, tangents by finite differences limited so that it never overshoots.
fn hermite(sections: &[Section], at: f64) -> [f64; 6] {
    let last = sections.len() - 1;
    let i = sections.iter().rposition(|s| s.at <= at).unwrap_or(0).min(last - 1);
    let h = sections[i + 1].at - sections[i].at;
    let t = ((at - sections[i].at) / h).clamp(0.0, 1.0);
    let slope = |k: usize, i: usize| {
        (sections[i + 1].values()[k] - sections[i].values()[k]) / (sections[i + 1].at - sections[i].at)
    };
    let tangent = |k: usize, i: usize| {
        if i == 0 {
            return slope(k, 0);
        }
        if i == last {
            return slope(k, last - 1);
        }
        let (l, r) = (slope(k, i - 1), slope(k, i));
        if l * r <= 0.0 { 0.0 } else { 2.0 * l * r / (l + r) }
    };
    std::array::from_fn(|k| {
        let (a, b) = (sections[i].values()[k], sections[i + 1].values()[k]);
        let (ta, tb) = (tangent(k, i) * h, tangent(k, i + 1) * h);
        let (t2, t3) = (t * t, t * t * t);
        a * (2.0 * t3 - 3.0 * t2 + 1.0) + ta * (t3 - 2.0 * t2 + t) + b * (3.0 * t2 - 2.0 * t3) + tb * (t3 - t2)
    })
}

/// (ρ - 1)/|∇ρ| for ρ = ((u/a)^n + (v/b)^n)^(1/n), with centre and radii changing along the axis at the given rates: the
/// distance to first order.
fn superellipse(at: [f64; 2], radii: [f64; 2], centre_rate: [f64; 2], radius_rate: [f64; 2], n: f64) -> f64 {
    let [x, y] = [0, 1].map(|k| at[k] / radii[k]);
    let rho = if n == 2.0 { x.hypot(y) } else { (x.powf(n) + y.powf(n)).powf(1.0 / n) };
    if rho < 0.2 {
        return (rho - 1.0) * radii[0].min(radii[1]);
    }
    let power = |t: f64| if n == 2.0 { t / rho } else { (t / rho).powf(n - 1.0) };
    let across = [power(x) / radii[0], power(y) / radii[1]];
    let along: f64 = (0..2).map(|k| across[k] * (centre_rate[k] + [x, y][k] * radius_rate[k])).sum();
    (rho - 1.0) / (across[0] * across[0] + across[1] * across[1] + along * along).sqrt()
}

/// An ellipsoid.
#[derive(Debug, Clone, Copy)]
pub(super) struct Ellipsoid {
    centre: Vec3,
    radii: Vec3,
    /// Body axes to the ellipsoid's.
    turn: Matrix3<f64>,
    low: Vec3,
    high: Vec3,
}

impl Ellipsoid {
    /// Centre and radii [m], along the body's axes.
    pub(super) fn new(centre: [f64; 3], radii: [f64; 3]) -> Self {
        Self::turned(centre, radii, [0.0; 3])
    }
    /// The same turned about its centre by a rotation vector [rad].
    pub(super) fn turned(centre: [f64; 3], radii: [f64; 3], turn: [f64; 3]) -> Self {
        let (centre, radii) = (Vec3::from(centre), Vec3::from(radii));
        let rotation = Rotation3::from_scaled_axis(Vec3::from(turn)).into_inner();
        let reach = Vec3::from_fn(|k, _| rotation.row(k).transpose().component_mul(&radii).norm());
        Self { centre, radii, turn: rotation.transpose(), low: centre - reach, high: centre + reach }
    }
}

impl Solid for Ellipsoid {
    fn bounds(&self) -> (Vec3, Vec3) {
        (self.low, self.high)
    }
    fn distance(&self, p: &Vec3) -> f64 {
        let far = outside(p, &self.low, &self.high);
        if far > MARGIN {
            return far;
        }
        let x = (self.turn * (p - self.centre)).component_div(&self.radii);
        let rho = x.norm();
        if rho < 0.2 {
            return (rho - 1.0) * self.radii.min();
        }
        (rho - 1.0) * rho / x.component_div(&self.radii).norm()
    }
}

/// A capsule whose radius changes from one end to the other.
#[derive(Debug, Clone, Copy)]
pub(super) struct Capsule {
    ends: [Vec3; 2],
    radii: [f64; 2],
    low: Vec3,
    high: Vec3,
}

impl Capsule {
    /// Ends and the radii there [m].
    pub(super) fn new(from: Vec3, to: Vec3, radii: [f64; 2]) -> Self {
        let [a, b] = radii.map(Vec3::repeat);
        Self { ends: [from, to], radii, low: (from - a).inf(&(to - b)), high: (from + a).sup(&(to + b)) }
    }
}

impl Solid for Capsule {
    fn bounds(&self) -> (Vec3, Vec3) {
        (self.low, self.high)
    }
    fn distance(&self, p: &Vec3) -> f64 {
        let along = self.ends[1] - self.ends[0];
        let t = ((p - self.ends[0]).dot(&along) / along.norm_squared()).clamp(0.0, 1.0);
        (p - self.ends[0] - along * t).norm() - (self.radii[0] * (1.0 - t) + self.radii[1] * t)
    }
}

/// Distance to a box, 0 inside.
pub(super) fn outside(p: &Vec3, low: &Vec3, high: &Vec3) -> f64 {
    (low - p).sup(&(p - high)).sup(&Vec3::zeros()).norm()
}

/// Union whose seam is rounded over a width `k` [m]; where the two are farther apart than `k` it is the plain minimum.
pub(super) fn smooth_min(a: f64, b: f64, k: f64) -> f64 {
    let h = (k - (a - b).abs()).max(0.0) / k;
    a.min(b) - 0.25 * h * h * k
}

/// Intersection likewise.
pub(super) fn smooth_max(a: f64, b: f64, k: f64) -> f64 {
    -smooth_min(-a, -b, k)
}
