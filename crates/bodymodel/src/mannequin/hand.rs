//! The left hand: palm, four fingers and a thumb, slightly spread and bent as a resting hand is.

use super::field::{Capsule, Ellipsoid, Loft, Section, Solid};
use caphy_core::Vec3;

/// A finger from its first joint to its tip.
pub(super) struct Finger {
    /// Name in the joint layout, without side and number.
    pub(super) name: &'static str,
    /// The three joints and the middle of the tip's ball, above the floor [m].
    pub(super) points: [Vec3; 4],
    /// Radii there [m].
    radii: [f64; 4],
}

/// [x, height, z] of the first joint, heading in the plane of the hand and first bend downwards [rad], the three
/// segments' lengths [m], the radii at the joints and at the tip [m].
const FINGERS: [(&str, [f64; 12]); 4] = [
    ("index", [0.774, 1.400, 0.012, 0.105, 0.06, 0.042, 0.025, 0.0160, 0.0098, 0.0090, 0.0080, 0.0070]),
    ("middle", [0.780, 1.402, -0.011, 0.010, 0.06, 0.046, 0.028, 0.0170, 0.0100, 0.0092, 0.0082, 0.0072]),
    ("pinky", [0.762, 1.397, -0.054, -0.215, 0.06, 0.033, 0.019, 0.0140, 0.0084, 0.0076, 0.0067, 0.0059]),
    ("ring", [0.774, 1.401, -0.033, -0.090, 0.06, 0.042, 0.026, 0.0160, 0.0095, 0.0087, 0.0077, 0.0067]),
];

/// Each joint of a finger bends it down by this much more [rad].
const BEND: f64 = 0.07;

/// Thumb: joints and the middle of the tip's ball, above the floor [m].
const THUMB: [[f64; 3]; 4] =
    [[0.708, 1.392, 0.004], [0.742, 1.386, 0.036], [0.769, 1.383, 0.052], [0.789, 1.382, 0.062]];
const THUMB_RADII: [f64; 4] = [0.0150, 0.0112, 0.0102, 0.0084];

/// The four fingers in the order of the joint layout, then the thumb.
pub(super) fn fingers() -> [Finger; 5] {
    let finger = |(name, t): (&'static str, [f64; 12])| {
        let mut points = [Vec3::new(t[0], t[1], t[2]); 4];
        for k in 0..3 {
            let down = t[4] + BEND * k as f64;
            let along = Vec3::new(t[3].cos() * down.cos(), -down.sin(), t[3].sin() * down.cos());
            points[k + 1] = points[k] + along * t[5 + k];
        }
        Finger { name, points, radii: [t[8], t[9], t[10], t[11]] }
    };
    let [a, b, c, d] = FINGERS.map(finger);
    [a, b, c, d, Finger { name: "thumb", points: THUMB.map(Vec3::from), radii: THUMB_RADII }]
}

/// A joint of the hand such as `left_index1`, above the floor [m].
pub(super) fn joint(name: &str) -> Option<Vec3> {
    let name = name.strip_prefix("left_")?;
    let number = name.chars().last()?.to_digit(10)? as usize;
    let finger = fingers().into_iter().find(|f| name.starts_with(f.name))?;
    finger.points.get(number - 1).copied()
}

/// [x, centre height, centre z, above, below, front, back] of the palm [m].
const PALM: [[f64; 7]; 8] = [
    [0.680, 1.400, -0.022, 0.0190, 0.0190, 0.0270, 0.0270],
    [0.700, 1.399, -0.021, 0.0180, 0.0185, 0.0300, 0.0310],
    [0.720, 1.399, -0.020, 0.0160, 0.0175, 0.0355, 0.0360],
    [0.740, 1.399, -0.020, 0.0145, 0.0160, 0.0395, 0.0395],
    [0.760, 1.399, -0.020, 0.0132, 0.0145, 0.0415, 0.0410],
    [0.775, 1.399, -0.019, 0.0122, 0.0130, 0.0400, 0.0405],
    [0.788, 1.398, -0.017, 0.0100, 0.0110, 0.0350, 0.0340],
    [0.798, 1.397, -0.014, 0.0070, 0.0080, 0.0270, 0.0240],
];

/// The solids of the left hand.
pub(super) struct Hand {
    palm: Loft,
    /// Ball of the thumb and edge of the hand.
    pads: [Ellipsoid; 2],
    fingers: Vec<Capsule>,
    thumb: Vec<Capsule>,
    low: Vec3,
    high: Vec3,
}

impl Hand {
    pub(super) fn new() -> Self {
        let sections: Vec<_> =
            PALM.iter().map(|&[x, y, z, u, d, f, b]| Section { at: x, centre: [y, z], radii: [u, d, f, b] }).collect();
        let palm = Loft::new(0, 2.3, 0.010, &sections);
        let capsules = |finger: &Finger| -> Vec<Capsule> {
            let segment =
                |k: usize| Capsule::new(finger.points[k], finger.points[k + 1], [finger.radii[k], finger.radii[k + 1]]);
            (0..3).map(segment).collect()
        };
        let fingers = fingers();
        let solids: Vec<Capsule> = fingers[..4].iter().flat_map(capsules).collect();
        let thumb = capsules(&fingers[4]);
        let pads = [
            Ellipsoid::turned([0.722, 1.388, 0.010], [0.034, 0.015, 0.018], [0.0, -0.65, 0.0]),
            Ellipsoid::turned([0.728, 1.390, -0.044], [0.034, 0.014, 0.014], [0.0, 0.1, 0.0]),
        ];
        let (mut low, mut high) = palm.bounds();
        for (a, b) in solids.iter().chain(&thumb).map(Solid::bounds).chain(pads.iter().map(Solid::bounds)) {
            (low, high) = (low.inf(&a), high.sup(&b));
        }
        Self { palm, pads, fingers: solids, thumb, low, high }
    }

    /// The hand joined to the arm at distance `arm` [m].
    pub(super) fn join(&self, p: &Vec3, arm: f64) -> f64 {
        const SEAM: f64 = 0.02;
        if super::field::outside(p, &self.low, &self.high) >= arm + SEAM {
            return arm;
        }
        let mut d = self.palm.join(p, arm, SEAM);
        for pad in &self.pads {
            d = pad.join(p, d, 0.015);
        }
        // Segments of one finger share their joint: a plain union. Fingers must not melt into each other.
        for finger in self.fingers.chunks_exact(3) {
            d = super::field::smooth_min(d, chain(finger, p), 0.006);
        }
        super::field::smooth_min(d, chain(&self.thumb, p), 0.014)
    }
}

/// Segments of a finger, their seams rounded a little.
fn chain(segments: &[Capsule], p: &Vec3) -> f64 {
    let mut d = f64::INFINITY;
    for s in segments {
        d = if d.is_finite() { s.join(p, d, 0.003) } else { s.distance(p) };
    }
    d
}
