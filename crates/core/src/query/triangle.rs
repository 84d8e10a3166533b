//! Nearest point of one triangle.

use crate::Vec3;

/// Which part of a triangle a point lies on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TriangleFeature {
    /// A corner: 0, 1 or 2.
    Corner(u8),
    /// The side from corner k to corner (k + 1) mod 3.
    Side(u8),
    /// Neither.
    Inside,
}

/// A point of a triangle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TrianglePoint {
    /// Weights of the corners: not negative, sum 1.
    pub barycentric: [f64; 3],
    /// Where it lies.
    pub feature: TriangleFeature,
    /// Position [m].
    pub point: Vec3,
    /// Squared distance to the query [m²].
    pub squared_distance: f64,
}

/// Height over longest side below which a triangle is treated as a sliver: the region tests lose as many digits as
/// the square of this has zeros, four of sixteen.
const SLIVER: f64 = 1e-2;

/// The nearest point of a triangle to `p` [m]; corners may coincide or lie on a line.
///
/// Well-shaped triangles go by the regions of their planes (Ericson, *Real-Time Collision Detection*, 5.1.5), slivers by a
/// projection onto an orthonormal frame along their longest side and by their three sides.
pub fn nearest_on_triangle(p: &Vec3, corners: &[Vec3; 3]) -> TrianglePoint {
    Weights::of_nearest(p, corners, is_sliver(corners)).on(corners)
}

/// The nearest point of a line from one end to another to `p` [m]; the ends may coincide.
pub fn nearest_on_line(p: &Vec3, [from, to]: [&Vec3; 2]) -> Vec3 {
    let way = to - from;
    let share = (p - from).dot(&way) / way.norm_squared();
    // Not a number, of no length, is its start.
    if share > 0.0 { from + way * share.min(1.0) } else { *from }
}

/// A point of a triangle by its weights alone.
#[derive(Debug, Clone, Copy)]
pub(super) struct Weights {
    barycentric: [f64; 3],
    feature: TriangleFeature,
    /// To the query [m²].
    pub(super) squared_distance: f64,
}

impl Weights {
    #[inline(always)]
    pub(super) fn of_nearest(p: &Vec3, corners: &[Vec3; 3], is_sliver: bool) -> Self {
        // With the query at the origin, the error of the distance is one of the triangle's size, not of its place.
        let at = corners.map(|c| c - p);
        let (barycentric, feature) =
            if is_sliver { sliver(&at) } else { by_regions(&at, &(at[1] - at[0]), &(at[2] - at[0])) };
        Self { barycentric, feature, squared_distance: mix(&at, barycentric).norm_squared() }
    }
    pub(super) fn on(self, corners: &[Vec3; 3]) -> TrianglePoint {
        let Self { barycentric, feature, squared_distance } = self;
        TrianglePoint { barycentric, feature, point: mix(corners, barycentric), squared_distance }
    }
}

#[inline(always)]
fn mix(corners: &[Vec3; 3], weights: [f64; 3]) -> Vec3 {
    corners[0] * weights[0] + corners[1] * weights[1] + corners[2] * weights[2]
}

/// Whether the normal of a triangle is too uncertain to reason by.
pub(super) fn is_sliver([a, b, c]: &[Vec3; 3]) -> bool {
    let (ab, ac, bc) = (b - a, c - a, c - b);
    let longest = ab.norm_squared().max(ac.norm_squared()).max(bc.norm_squared());
    // |ab × ac| = longest side · height. Not a number, from overflow, is a sliver, too.
    let clear = ab.cross(&ac).norm_squared() > SLIVER * SLIVER * longest * longest;
    !clear
}

#[inline(always)]
fn by_regions(at: &[Vec3; 3], ab: &Vec3, ac: &Vec3) -> ([f64; 3], TriangleFeature) {
    use TriangleFeature::{Corner, Inside, Side};
    let [a, b, c] = at;
    let (d1, d2) = (-ab.dot(a), -ac.dot(a));
    if d1 <= 0.0 && d2 <= 0.0 {
        return ([1.0, 0.0, 0.0], Corner(0));
    }
    let (d3, d4) = (-ab.dot(b), -ac.dot(b));
    if d3 >= 0.0 && d4 <= d3 {
        return ([0.0, 1.0, 0.0], Corner(1));
    }
    let vc = d1 * d4 - d3 * d2;
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        let t = d1 / (d1 - d3);
        return ([1.0 - t, t, 0.0], Side(0));
    }
    let (d5, d6) = (-ab.dot(c), -ac.dot(c));
    if d6 >= 0.0 && d5 <= d6 {
        return ([0.0, 0.0, 1.0], Corner(2));
    }
    let vb = d5 * d2 - d1 * d6;
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        let t = d2 / (d2 - d6);
        return ([1.0 - t, 0.0, t], Side(2));
    }
    let va = d3 * d6 - d5 * d4;
    if va <= 0.0 && d4 >= d3 && d5 >= d6 {
        let t = (d4 - d3) / ((d4 - d3) + (d5 - d6));
        return ([0.0, 1.0 - t, t], Side(1));
    }
    let sum = va + vb + vc;
    let (v, w) = (vb / sum, vc / sum);
    ([1.0 - v - w, v, w], Inside)
}

fn sliver(at: &[Vec3; 3]) -> ([f64; 3], TriangleFeature) {
    use TriangleFeature::{Corner, Inside, Side};
    let side = |k: usize| at[(k + 1) % 3] - at[k];
    let mut best = ([1.0, 0.0, 0.0], Corner(0), at[0].norm_squared());
    let mut offer = |barycentric: [f64; 3], feature: TriangleFeature| {
        let square = mix(at, barycentric).norm_squared();
        if square < best.2 {
            best = (barycentric, feature, square);
        }
    };
    for k in 0..3 {
        let (edge, next) = (side(k), (k + 1) % 3);
        let length = edge.norm_squared();
        let t = if length > 0.0 { (-at[k].dot(&edge) / length).clamp(0.0, 1.0) } else { 0.0 };
        let mut barycentric = [0.0; 3];
        (barycentric[k], barycentric[next]) = (1.0 - t, t);
        let feature = match t {
            0.0 => Corner(k as u8),
            1.0 => Corner(next as u8),
            _ => Side(k as u8),
        };
        offer(barycentric, feature);
    }
    // Inside: coordinates along the longest side and across it. Orthogonal to the last bit (the second subtraction), so
    // that a length along the sliver does not leak into its tiny height.
    let k = (0..3).fold(0, |a, b| if side(b).norm_squared() > side(a).norm_squared() { b } else { a });
    let (i, j, o) = (k, (k + 1) % 3, (k + 2) % 3);
    let base = side(k);
    let length = base.norm();
    let across = |v: Vec3, u: &Vec3| {
        let once = v - u * v.dot(u);
        once - u * once.dot(u)
    };
    if let Some(u) = base.try_normalize(0.0)
        && let up = across(at[o] - at[i], &u)
        && let Some(n) = up.try_normalize(0.0)
    {
        let from = -at[i];
        let wo = across(from, &u).dot(&n) / up.norm();
        let wj = (from.dot(&u) - wo * (at[o] - at[i]).dot(&u)) / length;
        let mut barycentric = [0.0; 3];
        (barycentric[i], barycentric[j], barycentric[o]) = (1.0 - wj - wo, wj, wo);
        if barycentric.iter().all(|&w| w > 0.0) {
            offer(barycentric, Inside);
        }
    }
    (best.0, best.1)
}
