//! The surface a style describes, as a level function around the body, and the cuts that end it.
//!
//! Limbs become convex tubes with ease; tubes are joined with a fillet and with the body's own offset surface, so that cloth
//! stays outside it. The garment is the zero level, cut by neckline, cuffs, hem and waist.

use super::distance::DistanceGrid;
use super::rest::Landmarks;
use super::sections::Tube;
use super::style::{LowerStyle, UpperStyle};
use caphy_core::Vec3;

/// Least distance of cloth from skin where the style is tight [m].
pub(crate) const GAP: f64 = 0.005;
/// Half the distance between the two legs of wide trousers [m].
const LEG_GAP: f64 = 0.007;

/// Where a garment ends: what lies at positive values is cut away.
#[derive(Debug, Clone)]
pub(crate) struct Cut {
    pub(crate) name: &'static str,
    surface: CutSurface,
}

#[derive(Debug, Clone)]
enum CutSurface {
    /// A plane, only above a height.
    Plane { point: Vec3, normal: Vec3, above: f64 },
    /// A plane, only on one side of the body: sign · (x - middle) > 0.
    SidePlane { point: Vec3, normal: Vec3, sign: f64, middle: f64 },
    /// A bowl around the neck, deeper in front.
    Neckline { centre: Vec3, drop: f64, depth: f64, bowl: f64 },
}

impl Cut {
    pub(crate) fn value(&self, p: &Vec3) -> f64 {
        match &self.surface {
            CutSurface::Plane { point, normal, above } => (p - point).dot(normal).min(p.y - above),
            CutSurface::SidePlane { point, normal, sign, middle } => (p - point).dot(normal).min(sign * (p.x - middle)),
            CutSurface::Neckline { centre, drop, depth, bowl } => {
                let d = p - centre;
                p.y - (centre.y - drop * smooth_step(-0.4, 1.0, d.z / depth) + bowl * d.x * d.x)
            }
        }
    }
}

/// 0 below `a`, 1 above `b`, smooth between.
pub(crate) fn smooth_step(a: f64, b: f64, x: f64) -> f64 {
    let t = ((x - a) / (b - a)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

/// Minimum with a fillet of width `k`.
fn smooth_min(a: f64, b: f64, k: f64) -> f64 {
    let h = (k - (a - b).abs()).max(0.0) / k;
    a.min(b) - h * h * k * 0.25
}

fn smooth_max(a: f64, b: f64, k: f64) -> f64 {
    -smooth_min(-a, -b, k)
}

#[derive(Debug, Clone)]
enum Parts {
    /// `yoke`: heights between which the trunk's convex sections give way to the body's own shoulders.
    Upper {
        arms: [Tube; 2],
        fillet: f64,
        yoke: (f64, f64),
    },
    Lower {
        legs: [Tube; 2],
        crotch: f64,
        middle: f64,
    },
}

/// Level function of one style on one body: negative inside the cloth [m].
pub(crate) struct Shape<'a> {
    body: &'a DistanceGrid,
    gap: f64,
    trunk: Tube,
    parts: Parts,
    pub(crate) cuts: Vec<Cut>,
    /// Box around the garment [m].
    pub(crate) low: Vec3,
    pub(crate) high: Vec3,
}

/// How fast hanging cloth may follow the body inward: tight knits do, wide cuts fall straight.
fn hang_slope(looseness: f64) -> f64 {
    0.7 * (1.0 - (looseness / 0.035).min(1.0)).powi(2)
}

impl<'a> Shape<'a> {
    /// A shirt; `gap` is the least distance of the surface from skin [m].
    pub(crate) fn upper(marks: &Landmarks, body: &'a DistanceGrid, style: &UpperStyle, gap: f64) -> Self {
        let loose = style.looseness;
        let slope = hang_slope(loose);
        let base = marks.trunk.axes.origin.y;
        let mut trunk = marks.trunk.clone();
        trunk.hang(marks.armpit - 0.01 - base, false, slope);
        trunk.smooth(0.015);
        let (top, chest) = (marks.neck_base - base, marks.armpit - base);
        trunk.add_ease(|y, _| gap + loose * smooth_step(top, chest, y));

        let mut arms = marks.arms.clone();
        for (arm, length) in arms.iter_mut().zip(marks.arm_length) {
            arm.hang(0.25 * length, true, slope);
            arm.smooth(0.015);
            // A sleeve rests on the arm's top: its ease hangs below.
            arm.add_ease(|s, n| gap + loose * (0.9 - 0.35 * (s / length).clamp(0.0, 1.0)) * (1.0 - 0.85 * n.y));
        }
        let hem = marks.waist + style.body_length * (marks.mid_thigh - marks.waist);
        let mut cuts = vec![
            neckline(marks, style.neckline),
            Cut {
                name: "hem",
                surface: CutSurface::Plane {
                    point: Vec3::new(0.0, hem, 0.0),
                    normal: -Vec3::y(),
                    above: f64::NEG_INFINITY,
                },
            },
        ];
        let (mut low, mut high) = trunk_box(&trunk, hem, marks.neck_base + 0.02);
        let mut fillet = 0.05f64;
        for side in 0..2 {
            let arm = &arms[side];
            let (shoulder, along) = (arm.axes.origin, arm.axes.along);
            let sign = [1.0, -1.0][side];
            // The shortest sleeve ends just outside the trunk's side: the armhole of a wide shirt drops.
            let side_at = (0..9)
                .map(|i| {
                    let y = marks.armpit - 0.05 + 0.01 * f64::from(i);
                    let x = trunk.axes.origin.x + sign * trunk.reach_at(y - base, &(Vec3::x() * sign));
                    arm.axes.along_of(&Vec3::new(x, y, shoulder.z))
                })
                .fold(0.0, f64::max);
            let shortest = side_at + 0.014;
            let longest = (marks.arm_length[side] - 0.012).max(shortest);
            let end = shortest + style.sleeve_length * (longest - shortest);
            fillet = fillet.min(3.5 * (end - side_at));
            // Without a sleeve the armhole leans inward towards the shoulder.
            let lean = 0.55 * (1.0 - style.sleeve_length / 0.2).max(0.0) / (1.0 + loose / 0.02);
            let normal = (along + Vec3::y() * lean).normalize();
            let down = arm.reach_at(end, &-Vec3::y());
            let point = shoulder + along * end - Vec3::y() * down;
            cuts.push(Cut {
                name: ["cuff_left", "cuff_right"][side],
                surface: CutSurface::Plane { point, normal, above: point.y - 0.03 },
            });
            for s in [0.0, end] {
                let centre = shoulder + along * s;
                let reach = (0..super::sections::DIRECTIONS)
                    .map(|k| arm.reach_at(s, &arm.axes.direction(k)))
                    .fold(0.0, f64::max);
                low = low.inf(&(centre - Vec3::repeat(reach)));
                high = high.sup(&(centre + Vec3::repeat(reach)));
            }
            let tip = shoulder + along * (end + lean * down * 2.0 + 0.01);
            low.x = low.x.min(tip.x);
            high.x = high.x.max(tip.x);
        }
        low.y = low.y.max(hem);
        let yoke = (marks.armpit + 0.04, marks.neck_base - 0.01);
        Self { body, gap, trunk, parts: Parts::Upper { arms, fillet, yoke }, cuts, low, high }
    }

    /// Trousers; `gap` is the least distance of the surface from skin [m].
    pub(crate) fn lower(marks: &Landmarks, body: &'a DistanceGrid, style: &LowerStyle, gap: f64) -> Self {
        let loose = style.looseness;
        let slope = hang_slope(loose);
        let base = marks.trunk.axes.origin.y;
        let waist = marks.crotch + (0.48 + 0.52 * style.rise) * (marks.waist - marks.crotch);
        let mut trunk = marks.trunk.clone();
        trunk.smooth(0.015);
        // The waistband holds the trousers up: ease begins below it.
        let (top, seat) = (waist - base, marks.crotch + 0.04 - base);
        trunk.add_ease(|y, _| gap + loose * (0.1 + 0.9 * (1.0 - smooth_step(seat, top, y))));
        let mut legs = marks.legs.clone();
        for (leg, leg_length) in legs.iter_mut().zip(marks.leg_length) {
            let below_crotch = leg.axes.origin.y - marks.crotch + 0.05;
            leg.hang(below_crotch, true, slope + 0.05);
            leg.smooth(0.02);
            // Ease hangs outside and behind rather than between the legs, and narrows to the cuff.
            let inward = if leg.axes.origin.x >= marks.middle { -Vec3::x() } else { Vec3::x() };
            leg.add_ease(|s, n| {
                gap + loose * (1.0 - 0.4 * (s / leg_length).clamp(0.0, 1.0)) * (1.0 - 0.6 * n.dot(&inward).max(0.0))
            });
        }
        let middle = marks.middle;
        let (low, mut high) = trunk_box(&trunk, marks.crotch - 0.1, waist);
        high.y = waist;
        let mut shape = Self {
            body,
            gap,
            trunk,
            parts: Parts::Lower { legs, crotch: marks.crotch - gap - 0.3 * loose, middle },
            cuts: Vec::new(),
            low,
            high,
        };
        let fork = shape.fork(marks);
        shape.cuts.push(Cut {
            name: "waist",
            surface: CutSurface::Plane {
                point: Vec3::new(0.0, waist, 0.0),
                normal: Vec3::y(),
                above: f64::NEG_INFINITY,
            },
        });
        if let Parts::Lower { legs, .. } = &shape.parts {
            for side in 0..2 {
                let (hip, along) = (legs[side].axes.origin, legs[side].axes.along);
                let longest = marks.leg_length[side] - 0.01;
                let shortest = (legs[side].axes.along_of(&Vec3::new(hip.x, fork, hip.z)) + 0.035).min(longest);
                let end = shortest + style.leg_length * (longest - shortest);
                let point = hip + along * end;
                let sign = if hip.x >= middle { 1.0 } else { -1.0 };
                shape.cuts.push(Cut {
                    name: ["cuff_left", "cuff_right"][side],
                    surface: CutSurface::SidePlane { point, normal: along, sign, middle },
                });
                for s in [end, 0.5 * end] {
                    let centre = hip + along * s;
                    let reach = (0..super::sections::DIRECTIONS)
                        .map(|k| legs[side].reach_at(s, &legs[side].axes.direction(k)))
                        .fold(0.0, f64::max);
                    shape.low = shape.low.inf(&(centre - Vec3::new(reach, 0.03, reach)));
                    shape.high = shape.high.sup(&(centre + Vec3::new(reach, 0.03, reach)));
                }
            }
        }
        shape
    }

    /// Height below which the two legs are apart.
    fn fork(&self, marks: &Landmarks) -> f64 {
        let mut y = marks.crotch + 0.02;
        let bottom = marks.mid_thigh - 0.3 * (marks.crotch - marks.mid_thigh);
        while y > bottom {
            let apart = (-12..=12).all(|i| {
                let z = marks.trunk.axes.origin.z + 0.015 * f64::from(i);
                self.value(&Vec3::new(marks.middle, y, z)) > 0.0
            });
            if apart {
                return y;
            }
            y -= 0.005;
        }
        bottom
    }

    /// The plane between left and right (x) [m].
    pub(crate) fn middle(&self) -> f64 {
        match &self.parts {
            Parts::Upper { .. } => self.trunk.axes.origin.x,
            Parts::Lower { middle, .. } => *middle,
        }
    }
    /// The level function [m].
    pub(crate) fn value(&self, p: &Vec3) -> f64 {
        let skin = self.body.value(p);
        let cloth = match &self.parts {
            Parts::Upper { arms, fillet, yoke } => {
                let own = smooth_step(yoke.0, yoke.1, p.y);
                let trunk = self.trunk.value(p) * (1.0 - own) + (skin - self.gap) * own;
                // Only the arm on this side can matter.
                let side = usize::from((p - self.trunk.axes.origin).dot(&arms[0].axes.along) < 0.0);
                let s = arms[side].axes.along_of(p);
                // The tube ends inside the trunk.
                let arm = if s < -0.08 { 0.08 } else { smooth_max(arms[side].value(p), -0.02 - s, 0.02) };
                // The fillet fills the armpit; on the shoulder, where both agree, it would only stand off.
                let down = arms[side].axes.origin.y - p.y;
                let width = 0.008 + (*fillet - 0.008).max(0.0) * smooth_step(-0.02, 0.05, down);
                smooth_min(trunk, arm, width)
            }
            Parts::Lower { legs, crotch, middle } => {
                let side = usize::from((p.x >= *middle) != (legs[0].axes.origin.x >= *middle));
                let inward = if p.x >= *middle { middle - p.x } else { p.x - middle };
                let mut leg = smooth_max(legs[side].value(p), -legs[side].axes.along_of(p), 0.02);
                leg = smooth_max(leg, inward + LEG_GAP, 0.01);
                // Seat and legs agree on the outside; between the legs the one gives way to the other.
                let seat = smooth_step(*crotch, crotch + 0.07, p.y);
                if seat == 0.0 { leg } else { leg * (1.0 - seat) + self.trunk.value(p) * seat }
            }
        };
        smooth_min(cloth, skin - self.gap, 0.008)
    }

    /// Value and gradient by forward differences.
    pub(crate) fn gradient(&self, p: &Vec3) -> (f64, Vec3) {
        forward_difference(|q| self.value(q), p)
    }
    /// Moves a point to the zero level.
    pub(crate) fn project(&self, p: &Vec3, steps: usize, longest: f64) -> Vec3 {
        let mut at = *p;
        for _ in 0..steps {
            let (f, g) = self.gradient(&at);
            if f.abs() < 1e-5 {
                break;
            }
            let step = g * (f / g.norm_squared().max(0.1));
            at -= step * (longest / step.norm().max(longest));
        }
        at
    }
    /// Moves a point to the zero level and onto a cut.
    pub(crate) fn project_to_cut(&self, p: &Vec3, cut: usize, steps: usize, longest: f64) -> Vec3 {
        let mut at = *p;
        for _ in 0..steps {
            let (f, g) = self.gradient(&at);
            let (c, h) = forward_difference(|q| self.cuts[cut].value(q), &at);
            let (gg, gh, hh) = (g.norm_squared().max(1e-6), g.dot(&h), h.norm_squared().max(1e-6));
            let determinant = gg * hh - gh * gh;
            let step = if determinant > 1e-3 * gg * hh {
                g * ((f * hh - c * gh) / determinant) + h * ((c * gg - f * gh) / determinant)
            } else {
                h * (c / hh)
            };
            let length = step.norm();
            at -= step * (longest / length.max(longest));
            if length < 1e-5 {
                break;
            }
        }
        at
    }
}

fn forward_difference(f: impl Fn(&Vec3) -> f64, p: &Vec3) -> (f64, Vec3) {
    const STEP: f64 = 5e-4;
    let at = f(p);
    let d = |axis: Vec3| (f(&(p + axis * STEP)) - at) / STEP;
    (at, Vec3::new(d(Vec3::x()), d(Vec3::y()), d(Vec3::z())))
}

fn neckline(marks: &Landmarks, depth: f64) -> Cut {
    let w = marks.neck_half_width;
    let centre = Vec3::new(marks.trunk.axes.origin.x, marks.neck_base - 0.008 * depth, marks.neck_depth);
    let drop = 0.03 + 0.09 * depth;
    let bowl = 0.6 * drop / (w * 1.6).powi(2);
    Cut { name: "neck", surface: CutSurface::Neckline { centre, drop, depth: w * 1.1, bowl } }
}

/// Box around the trunk's sections between two heights [m].
fn trunk_box(trunk: &Tube, from: f64, to: f64) -> (Vec3, Vec3) {
    let o = trunk.axes.origin;
    let (mut low, mut high) = (Vec3::new(o.x, from, o.z), Vec3::new(o.x, to, o.z));
    let mut y = from;
    while y <= to {
        let reach = |d: Vec3| trunk.reach_at(y - o.y, &d);
        low.x = low.x.min(o.x - reach(-Vec3::x()));
        high.x = high.x.max(o.x + reach(Vec3::x()));
        low.z = low.z.min(o.z - reach(-Vec3::z()));
        high.z = high.z.max(o.z + reach(Vec3::z()));
        y += 0.01;
    }
    (low, high)
}
