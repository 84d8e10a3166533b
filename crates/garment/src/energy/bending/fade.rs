//! Hinges with a needle for a face lose their bending energy, together with its gradient.
//!
//! dτ/dx grows without bound, as 1/h where a face's height h over the edge goes to zero, and as 1/l where the edge does; in the
//! end there is no angle at all. With r = (h/(q l))² and r' = (l/(q h))², q = [`SMALLEST_HEIGHT`], each face multiplies the hinge's
//! energy by χ(r) χ(r'), where χ(r) = r (2 − r) below 1, with slope 0 at 1, and 1 beyond. (ARCSim bounds the gradient alone, which is
//! then not that of its energy: a line search along it fails.) Hinges of better faces are untouched.

use super::SMALLEST_HEIGHT;
use caphy_core::{Real, Vec3};

/// Keeps divisions finite for collapsed hinges: far below any square of a real length or area.
pub(super) const TINY: f64 = 1e-30;

/// How a hinge fades.
pub(super) struct Fade {
    /// Product of both factors χ.
    pub(super) share: f64,
    /// The product times N/h of each face.
    pub(super) turns: [Vec3; 2],
    /// Gradient of the product by the four vertices.
    pub(super) gradient: [Vec3; 4],
}

/// Whether a face is a needle, from |n|², twice its area squared, and the edge's square.
#[inline(always)]
pub(super) fn is_thin<T: Real>(square: T, edge: T) -> bool {
    let floor = T::of(SMALLEST_HEIGHT * SMALLEST_HEIGHT);
    // Written so that NaN is none: it goes its own way to the energy and is found out there.
    (square <= floor * edge * edge + T::of(TINY)) | (edge * edge <= floor * square + T::of(TINY))
}

/// χ and its slope.
fn faded(r: f64) -> (f64, f64) {
    if r < 1.0 { (r * (2.0 - r), 2.0 * (1.0 - r)) } else { (1.0, 0.0) }
}

/// One face: its factor, the factor over |n|², the factor's slopes by |n|² and by the edge's square.
struct Side {
    factor: f64,
    over_square: f64,
    by_square: f64,
    by_edge: f64,
}

impl Side {
    fn new(square: f64, edge: f64) -> Self {
        let floor = SMALLEST_HEIGHT * SMALLEST_HEIGHT;
        let (low, short) = (floor * edge * edge + TINY, floor * square + TINY);
        let (r, s) = (square / low, edge * edge / short);
        let ((a, a_slope), (b, b_slope)) = (faded(r), faded(s));
        Self {
            factor: a * b,
            over_square: b * if r < 1.0 { (2.0 - r) / low } else { 1.0 / square },
            by_square: a_slope * b / low - a * b_slope * s * floor / short,
            by_edge: a * b_slope * 2.0 * edge / short - a_slope * b * r * 2.0 * floor * edge / low,
        }
    }
}

impl Fade {
    /// `None` for a hinge whose faces are none of them needles.
    pub(super) fn new([x0, x1, x2, x3]: [Vec3; 4]) -> Option<Self> {
        let (e, a, b) = (x1 - x0, x2 - x0, x3 - x0);
        let (n0, n1) = (e.cross(&a), b.cross(&e));
        let (pp, qq, ee) = (n0.norm_squared(), n1.norm_squared(), e.norm_squared());
        if !is_thin(pp, ee) && !is_thin(qq, ee) {
            return None;
        }
        let (p, q) = (Side::new(pp, ee), Side::new(qq, ee));
        let (by_p, by_q) = (p.by_square * q.factor, q.by_square * p.factor);
        let by_edge = p.by_edge * q.factor + q.by_edge * p.factor;
        // |n|² by the opposite corner and by the edge.
        let (g2, g3) = (n0.cross(&e) * (2.0 * by_p), e.cross(&n1) * (2.0 * by_q));
        let g1 = a.cross(&n0) * (2.0 * by_p) + n1.cross(&b) * (2.0 * by_q) + e * (2.0 * by_edge);
        let edge = ee.sqrt();
        Some(Self {
            share: p.factor * q.factor,
            turns: [n0 * (edge * p.over_square * q.factor), n1 * (edge * q.over_square * p.factor)],
            gradient: [-(g1 + g2 + g3), g1, g2, g3],
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn hinge(left: f64, right: f64) -> [Vec3; 4] {
        let edge = Vec3::new(0.01, 0.002, -0.003);
        let across = Vec3::new(0.1, -0.5, 0.0).cross(&edge).normalize();
        let other = (edge.cross(&across).normalize() * 0.6 - across * 0.8).normalize();
        let l = edge.norm() * SMALLEST_HEIGHT;
        [Vec3::zeros(), edge, 0.3 * edge + across * (left * l), 0.7 * edge + other * (right * l)]
    }

    #[test]
    fn high_faces_are_untouched_and_the_border_is_no_step() {
        assert!(Fade::new(hinge(1.001, 500.0)).is_none());
        let near = Fade::new(hinge(0.999_999, 500.0)).unwrap();
        assert!((near.share - 1.0).abs() < 1e-10 && near.gradient.iter().all(|g| g.norm() < 1e-4 / 1e-5));
        // On the edge, but for rounding.
        assert!(Fade::new(hinge(0.0, 500.0)).unwrap().share < 1e-20);
        let point = Fade::new([Vec3::zeros(); 4]).unwrap();
        assert!(point.share == 0.0 && point.gradient.iter().chain(&point.turns).all(|g| *g == Vec3::zeros()));
    }

    #[test]
    fn the_gradient_is_that_of_the_share() {
        let short = |share: f64| {
            let [x0, x1, x2, x3] = hinge(1000.0, 700.0);
            [x0, x0 + (x1 - x0) * share, x2, x3]
        };
        for x in [hinge(0.5, 300.0), hinge(700.0, 0.1), hinge(0.4, 0.8), short(9e-4), short(3e-4)] {
            let fade = Fade::new(x).unwrap();
            let size = fade.gradient.iter().map(|g| g.norm()).fold(0.0, f64::max);
            for v in 0..4 {
                for k in 0..3 {
                    // A thousandth of a height of 1e-5 m: errors of the square of that.
                    let h = 1e-8;
                    let at = |by: f64| {
                        let mut moved = x;
                        moved[v][k] += by;
                        Fade::new(moved).unwrap().share
                    };
                    let slope = (at(h) - at(-h)) / (2.0 * h);
                    assert!((slope - fade.gradient[v][k]).abs() < 1e-4 * size, "{v} {k}: {slope} {:?}", fade.gradient);
                }
            }
        }
    }
}
