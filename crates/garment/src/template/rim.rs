//! Edges of garments as lines: even points along them, smooth, and what lies beside them.

use caphy_core::Vec3;
use caphy_core::query::nearest_on_line;

/// Points along edges are this far apart [m], and smoothed over this distance (a Gaussian's σ): a scan's triangles make them zigzag, and
/// those of a garment make them polygons. Both are smoothed alike.
pub(super) const STEP: f64 = 3e-3;
const SMOOTH: f64 = 0.01;

/// A piece of an edge of a garment as a scan shows it.
#[derive(Debug, Clone, PartialEq)]
pub struct Rim {
    /// Along it [m].
    pub points: Vec<Vec3>,
    /// Whether it goes all around.
    pub closed: bool,
}

impl Rim {
    pub(super) fn length(&self) -> f64 {
        let all = self.points.windows(2).map(|p| (p[1] - p[0]).norm()).sum::<f64>();
        match (&self.points[..], self.closed) {
            ([first, .., last], true) => all + (first - last).norm(),
            _ => all,
        }
    }
    /// Points at equal distances along it, smoothed; the ends of an open one stay.
    pub(super) fn smoothed(&self) -> Rim {
        let total = self.length();
        let count = (total / STEP).round().max(2.0) as usize;
        let mut corners = self.points.iter().chain(self.points.first().filter(|_| self.closed));
        let Some(mut from) = corners.next() else { return self.clone() };
        let mut to = corners.next().unwrap_or(from);
        let mut before = 0.0;
        let mut even = Vec::with_capacity(count + 1);
        for i in 0..count + usize::from(!self.closed) {
            let at = total * i as f64 / count as f64;
            while before + (to - from).norm() < at {
                let Some(next) = corners.next() else { break };
                before += (to - from).norm();
                (from, to) = (to, next);
            }
            let length = (to - from).norm().max(f64::MIN_POSITIVE);
            even.push(from + (to - from) * ((at - before) / length).min(1.0));
        }
        let step = total / count as f64;
        let reach = (3.0 * SMOOTH / step).ceil() as isize;
        let last = even.len() as isize;
        let around = |i: isize| {
            let reach = if self.closed { reach } else { reach.min(i).min(last - 1 - i) };
            let (mut sum, mut weight) = (Vec3::zeros(), 0.0);
            for k in -reach..=reach {
                let w = (-0.5 * (k as f64 * step / SMOOTH).powi(2)).exp();
                sum += even[(i + k).rem_euclid(last) as usize] * w;
                weight += w;
            }
            sum / weight
        };
        Rim { points: (0..last).map(around).collect(), closed: self.closed }
    }
    /// From point to point, and back to the first where it goes all around.
    fn sides(&self) -> impl Iterator<Item = (&Vec3, &Vec3)> {
        let ends = self.points.iter().zip(self.points.iter().cycle().skip(1));
        ends.take(self.points.len().saturating_sub(usize::from(!self.closed)))
    }
    /// The way from the nearest place to a point, where that is, and the direction of the edge there.
    pub(super) fn nearest(&self, p: &Vec3) -> Option<(Vec3, Vec3, Vec3)> {
        let places = self.sides().map(|(a, b)| {
            let place = nearest_on_line(p, [a, b]);
            (p - place, place, b - a)
        });
        let (off, place, way) = places.min_by(|a, b| a.0.norm_squared().total_cmp(&b.0.norm_squared()))?;
        Some((off, place, way.try_normalize(0.0)?))
    }
    /// How far from its first point along it the place nearest to a point is [m].
    fn along(&self, p: &Vec3) -> f64 {
        let (mut before, mut at, mut nearest) = (0.0, 0.0, f64::INFINITY);
        for (a, b) in self.sides() {
            let place = nearest_on_line(p, [a, b]);
            let square = (p - place).norm_squared();
            if square < nearest {
                (nearest, at) = (square, before + (place - a).norm());
            }
            before += (b - a).norm();
        }
        at
    }
    /// Length of the part of it that a piece lies beside, from where its one end is nearest to where its other end is [m].
    pub(super) fn beside(&self, piece: &Rim) -> f64 {
        let whole = self.length();
        if piece.closed || whole == 0.0 {
            return whole;
        }
        let at: Vec<f64> = piece.points.iter().map(|p| self.along(p)).collect();
        // Around a closed one the short way.
        let step = |w: &[f64]| w[1] - w[0] - if self.closed { whole * ((w[1] - w[0]) / whole).round() } else { 0.0 };
        at.windows(2).map(step).sum::<f64>().abs()
    }
    pub(super) fn distance(&self, p: &Vec3) -> f64 {
        self.nearest(p).map_or(f64::INFINITY, |n| n.0.norm())
    }
    pub(super) fn centre(&self) -> Vec3 {
        self.points.iter().sum::<Vec3>() / self.points.len().max(1) as f64
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// An arc of an ellipse in the plane y = `height` [m], from the one angle to the other.
    pub(crate) fn arc([wide, deep]: [f64; 2], height: f64, angles: [f64; 2], at: Vec3) -> Rim {
        let count = 120;
        let point = |i: i32| {
            let (sin, cos) = (angles[0] + (angles[1] - angles[0]) * f64::from(i) / f64::from(count)).sin_cos();
            Vec3::new(wide * cos, height, deep * sin) + at
        };
        let closed = angles == ALL;
        Rim { points: (0..count + i32::from(!closed)).map(point).collect(), closed }
    }
    pub(crate) const ALL: [f64; 2] = [0.0, std::f64::consts::TAU];

    #[test]
    fn smoothing_keeps_ends_and_makes_zigzags_straight() {
        let zigzag = |i: i32| Vec3::new(2e-3 * f64::from(i), if i % 2 == 0 { 2e-3 } else { -2e-3 }, 0.0);
        let open = Rim { points: (0..101).map(zigzag).collect(), closed: false };
        assert!(open.length() > 0.44);
        let smooth = open.smoothed();
        assert!((smooth.points[0] - zigzag(0)).norm() < 1e-12);
        assert!((smooth.points[smooth.points.len() - 1] - zigzag(100)).norm() < 1e-12);
        let inner = &smooth.points[20..smooth.points.len() - 20];
        assert!(inner.iter().all(|p| p.y.abs() < 1e-3), "{inner:?}");
        // Of a circle a Gaussian leaves exp(-σ²/2r²), all around alike.
        let circle = arc([0.09; 2], 0.0, ALL, Vec3::zeros()).smoothed();
        let left = 0.09 * (-0.5 * (SMOOTH / 0.09f64).powi(2)).exp();
        let radii: Vec<f64> = circle.points.iter().map(|p| p.norm()).collect();
        assert!(radii.iter().all(|r| (r - left).abs() < 5e-5), "{left} {radii:?}");
    }

    #[test]
    fn a_piece_lies_beside_as_much_of_a_loop_as_it_goes_around() {
        let ring = arc([0.1, 0.1], 0.0, ALL, Vec3::zeros());
        let whole = ring.length();
        // Across the first point, and backwards.
        for (angles, share) in [([0.5, 1.5], 1.0), ([-0.4, 0.8], 1.2), ([1.0, -1.0], 2.0), ([0.1, 5.1], 5.0)] {
            let near = ring.beside(&arc([0.103; 2], 0.002, angles, Vec3::zeros()));
            // At a corner of the polygon it stands still: 3 mm outside by up to 3 mm times the corner's 0.05.
            assert!((near - whole * share / ALL[1]).abs() < 2e-4, "{angles:?} {near}");
        }
        assert_eq!(ring.beside(&arc([0.09; 2], 0.0, ALL, Vec3::zeros())), whole);
        let open = arc([0.1; 2], 0.0, [0.0, 2.0], Vec3::zeros());
        assert!((open.beside(&arc([0.1; 2], 0.0, [0.5, 3.0], Vec3::zeros())) - 0.15).abs() < 1e-4);
    }
}
