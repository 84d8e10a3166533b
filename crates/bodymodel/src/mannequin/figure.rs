//! The figure: joints and solids of a slim adult of 1.72 m.
//!
//! Lengths follow the segment ratios of Drillis and Contini (1966) for this stature, hand and foot lengths are 0.108 and
//! 0.152 of it, the head is 1/7.5 of it; girths are those of a slim adult (chest 0.93 m, waist 0.80 m, hip 0.97 m). No
//! mesh was copied or fitted. Heights in the tables are above the floor; the pelvis joint stands at [`PELVIS_HEIGHT`] and
//! becomes the origin of the model.

use super::field::{Capsule, Ellipsoid, Loft, Section, Solid, smooth_max, smooth_min};
use super::hand::Hand;
use super::head::Head;
use caphy_core::Vec3;
use caphy_core::pose::SMPLX_JOINTS;

/// Height of the pelvis joint above the floor [m].
pub(super) const PELVIS_HEIGHT: f64 = 0.95;
/// Height of the body with all coefficients zero [m].
pub(super) const STATURE: f64 = 1.72;

/// Joints of the middle and of the left side above the floor [m]; the right side mirrors the left.
const JOINTS: [(&str, [f64; 3]); 16] = [
    ("pelvis", [0.0, 0.950, 0.000]),
    ("spine1", [0.0, 1.055, -0.015]),
    ("spine2", [0.0, 1.175, -0.020]),
    ("spine3", [0.0, 1.245, -0.015]),
    ("neck", [0.0, 1.450, -0.038]),
    ("head", [0.0, 1.550, -0.012]),
    ("jaw", [0.0, 1.560, 0.030]),
    ("left_hip", [0.085, 0.890, 0.000]),
    ("left_knee", [0.118, 0.480, 0.000]),
    ("left_ankle", [0.140, 0.080, -0.030]),
    ("left_foot", [0.158, 0.025, 0.090]),
    ("left_collar", [0.065, 1.395, -0.025]),
    ("left_shoulder", [0.180, 1.400, -0.025]),
    ("left_elbow", [0.445, 1.400, -0.030]),
    ("left_wrist", [0.685, 1.400, -0.022]),
    ("left_eye_smplhf", [0.031, 1.613, 0.062]),
];

/// A joint of the middle or of the left side above the floor [m].
pub(super) fn joint(name: &str) -> Vec3 {
    match JOINTS.iter().find(|(n, _)| *n == name) {
        Some((_, at)) => Vec3::from(*at),
        None => super::hand::joint(name).unwrap_or(Vec3::new(0.0, PELVIS_HEIGHT, 0.0)),
    }
}

/// Joint positions in SMPL-X order, pelvis at the origin [m].
pub(super) fn joints() -> Vec<Vec3> {
    SMPLX_JOINTS
        .iter()
        .map(|name| {
            let (at, side) = match name.strip_prefix("right_") {
                Some(rest) => (joint(&format!("left_{rest}")), -1.0),
                None => (joint(name), 1.0),
            };
            Vec3::new(side * at.x, at.y - PELVIS_HEIGHT, at.z)
        })
        .collect()
}

/// [height, half width, front, back] of the torso above the floor [m].
const TORSO: [[f64; 4]; 20] = [
    [0.785, 0.060, 0.035, 0.045],
    [0.820, 0.112, 0.062, 0.074],
    [0.850, 0.136, 0.082, 0.090],
    [0.890, 0.152, 0.096, 0.098],
    [0.930, 0.160, 0.104, 0.102],
    [0.970, 0.160, 0.107, 0.098],
    [1.010, 0.154, 0.106, 0.089],
    [1.050, 0.139, 0.102, 0.080],
    [1.090, 0.129, 0.098, 0.075],
    [1.130, 0.128, 0.097, 0.077],
    [1.180, 0.136, 0.100, 0.086],
    [1.230, 0.149, 0.106, 0.097],
    [1.280, 0.157, 0.109, 0.106],
    [1.330, 0.160, 0.104, 0.111],
    [1.370, 0.153, 0.089, 0.108],
    [1.400, 0.138, 0.070, 0.101],
    [1.430, 0.108, 0.050, 0.090],
    [1.455, 0.078, 0.036, 0.080],
    [1.480, 0.056, 0.026, 0.074],
    [1.500, 0.046, 0.024, 0.068],
];

/// [height, centre x, centre z, inside, outside, front, back] of the left leg above the floor [m].
const LEG: [[f64; 7]; 20] = [
    [0.030, 0.143, -0.036, 0.026, 0.026, 0.030, 0.032],
    [0.070, 0.140, -0.036, 0.030, 0.030, 0.040, 0.036],
    [0.110, 0.138, -0.034, 0.0295, 0.029, 0.036, 0.035],
    [0.160, 0.136, -0.031, 0.0325, 0.033, 0.039, 0.041],
    [0.210, 0.134, -0.027, 0.037, 0.039, 0.043, 0.050],
    [0.260, 0.132, -0.022, 0.043, 0.045, 0.046, 0.059],
    [0.310, 0.129, -0.017, 0.048, 0.050, 0.049, 0.066],
    [0.350, 0.127, -0.013, 0.051, 0.052, 0.051, 0.068],
    [0.390, 0.124, -0.008, 0.051, 0.051, 0.052, 0.066],
    [0.430, 0.121, -0.002, 0.050, 0.049, 0.053, 0.060],
    [0.480, 0.118, 0.002, 0.051, 0.050, 0.055, 0.055],
    [0.520, 0.115, 0.004, 0.054, 0.052, 0.058, 0.057],
    [0.580, 0.111, 0.005, 0.060, 0.059, 0.066, 0.063],
    [0.650, 0.105, 0.004, 0.067, 0.067, 0.076, 0.070],
    [0.720, 0.099, 0.001, 0.073, 0.075, 0.084, 0.076],
    [0.790, 0.093, -0.002, 0.078, 0.082, 0.088, 0.081],
    [0.850, 0.088, -0.004, 0.077, 0.087, 0.085, 0.082],
    [0.900, 0.085, -0.004, 0.066, 0.080, 0.073, 0.072],
    [0.950, 0.082, -0.004, 0.048, 0.060, 0.055, 0.056],
    [0.980, 0.080, -0.004, 0.030, 0.034, 0.036, 0.034],
];

/// [x, centre height, centre z, above, below, front, back] of the left arm to the wrist, heights above the floor [m].
const ARM: [[f64; 7]; 16] = [
    [0.090, 1.385, -0.026, 0.040, 0.060, 0.050, 0.052],
    [0.140, 1.392, -0.026, 0.050, 0.066, 0.056, 0.058],
    [0.180, 1.398, -0.026, 0.052, 0.063, 0.056, 0.058],
    [0.220, 1.400, -0.026, 0.050, 0.056, 0.052, 0.053],
    [0.270, 1.400, -0.027, 0.045, 0.049, 0.045, 0.046],
    [0.330, 1.400, -0.028, 0.042, 0.045, 0.041, 0.042],
    [0.390, 1.400, -0.029, 0.039, 0.041, 0.038, 0.039],
    [0.445, 1.400, -0.030, 0.037, 0.037, 0.038, 0.038],
    [0.480, 1.400, -0.029, 0.0375, 0.037, 0.041, 0.040],
    [0.520, 1.400, -0.028, 0.036, 0.036, 0.042, 0.040],
    [0.560, 1.400, -0.026, 0.033, 0.033, 0.039, 0.037],
    [0.600, 1.400, -0.025, 0.029, 0.029, 0.035, 0.033],
    [0.640, 1.400, -0.023, 0.0245, 0.024, 0.031, 0.030],
    [0.675, 1.400, -0.022, 0.0205, 0.0205, 0.0285, 0.0285],
    [0.700, 1.399, -0.021, 0.0185, 0.019, 0.029, 0.030],
    [0.720, 1.398, -0.021, 0.0150, 0.016, 0.027, 0.030],
];

/// [z, centre x, centre height, half width, above, below] of the left foot [m]; the toes point outward by about 8°.
const FOOT: [[f64; 6]; 9] = [
    [-0.084, 0.138, 0.032, 0.012, 0.016, 0.014],
    [-0.072, 0.138, 0.034, 0.025, 0.034, 0.030],
    [-0.045, 0.140, 0.034, 0.0315, 0.046, 0.034],
    [0.000, 0.145, 0.033, 0.033, 0.055, 0.033],
    [0.040, 0.151, 0.030, 0.0375, 0.042, 0.030],
    [0.080, 0.158, 0.025, 0.0440, 0.030, 0.025],
    [0.110, 0.163, 0.021, 0.0460, 0.021, 0.021],
    [0.135, 0.165, 0.018, 0.0400, 0.015, 0.018],
    [0.148, 0.165, 0.016, 0.0300, 0.010, 0.014],
];

/// [x, height, z] where a toe leaves the foot and where it ends, and the radii there [m]; the big toe first.
const TOES: [[f64; 8]; 5] = [
    [0.137, 0.019, 0.110, 0.0160, 0.145, 0.0150, 0.161, 0.0130],
    [0.159, 0.016, 0.120, 0.0115, 0.167, 0.0125, 0.158, 0.0100],
    [0.175, 0.015, 0.116, 0.0110, 0.183, 0.0115, 0.149, 0.0095],
    [0.190, 0.014, 0.108, 0.0105, 0.197, 0.0110, 0.137, 0.0090],
    [0.203, 0.014, 0.094, 0.0110, 0.209, 0.0110, 0.122, 0.0090],
];

/// The solids of the figure. Only the left side is kept.
pub(super) struct Figure {
    torso: Loft,
    /// Masses on the torso, with the width of their seams to the torso and to their mirror images [m].
    trunk: Vec<(Ellipsoid, f64, f64)>,
    trapezius: Capsule,
    leg: Loft,
    /// Masses on the leg, with the width of their seams [m].
    muscles: Vec<(Ellipsoid, f64)>,
    foot: Loft,
    toes: [Capsule; 5],
    /// The hollow under the foot.
    arch: Ellipsoid,
    head: Head,
    arm: Loft,
    /// Masses on the arm, with the width of their seams [m].
    arm_muscles: Vec<(Ellipsoid, f64)>,
    hand: Hand,
}

/// From this distance to the middle on, nothing but hand and forearm is there [m].
const HAND_REACH: f64 = 0.60;

impl Figure {
    /// The figure from its tables.
    pub(super) fn new() -> Self {
        let section = |at, centre, radii| Section { at, centre, radii };
        // Axis y: the other two axes are z, then x.
        let torso: Vec<_> = TORSO.iter().map(|&[y, a, f, b]| section(y, [-0.004, 0.0], [f, b, a, a])).collect();
        let leg: Vec<_> = LEG.iter().map(|&[y, x, z, i, o, f, b]| section(y, [z, x], [f, b, o, i])).collect();
        // Axis x: then y, z. Axis z: then x, y.
        let arm: Vec<_> = ARM.iter().map(|&[x, y, z, u, d, f, b]| section(x, [y, z], [u, d, f, b])).collect();
        let foot: Vec<_> = FOOT.iter().map(|&[z, x, y, w, u, d]| section(z, [x, y], [w, w, u, d])).collect();
        let v = Vec3::new;
        let (plain, turned) = (Ellipsoid::new, Ellipsoid::turned);
        Self {
            torso: Loft::new(1, 2.35, 0.05, &torso),
            trunk: vec![
                // Pectoral: its outer end runs up and back to the arm.
                (turned([0.082, 1.312, 0.058], [0.088, 0.058, 0.046], [0.0, 0.35, 0.30]), 0.040, 0.030),
                // Shoulder blade and the muscles on it.
                (turned([0.090, 1.320, -0.070], [0.066, 0.095, 0.050], [0.0, -0.15, 0.20]), 0.045, 0.045),
                // Latissimus: the line from the armpit to the waist.
                (turned([0.124, 1.245, -0.042], [0.040, 0.130, 0.055], [0.0, 0.0, -0.12]), 0.040, 0.040),
                (plain([0.076, 0.893, -0.058], [0.080, 0.088, 0.070]), 0.045, 0.020),
            ],
            trapezius: Capsule::new(v(0.018, 1.478, -0.056), v(0.165, 1.424, -0.036), [0.033, 0.029]),
            leg: Loft::new(1, 2.0, 0.03, &leg),
            muscles: vec![
                // Quadriceps: outer mass and the drop above the inner side of the knee.
                (turned([0.140, 0.680, 0.016], [0.036, 0.140, 0.050], [0.0, 0.0, -0.08]), 0.035),
                (turned([0.091, 0.565, 0.030], [0.028, 0.060, 0.032], [0.0, 0.0, 0.10]), 0.030),
                (plain([0.119, 0.486, 0.040], [0.026, 0.033, 0.021]), 0.022),
                // Calf: the inner head is larger and hangs lower.
                (plain([0.107, 0.335, -0.048], [0.031, 0.080, 0.038]), 0.030),
                (plain([0.147, 0.352, -0.044], [0.030, 0.074, 0.036]), 0.030),
                // Ankle bones; the inner one is higher.
                (plain([0.114, 0.088, -0.034], [0.011, 0.013, 0.013]), 0.014),
                (plain([0.165, 0.078, -0.040], [0.011, 0.013, 0.013]), 0.014),
            ],
            foot: Loft::new(2, 2.3, 0.014, &foot),
            toes: TOES.map(|[x, y, z, r, tx, ty, tz, tr]| Capsule::new(v(x, y, z), v(tx, ty, tz), [r, tr])),
            arch: turned([0.108, 0.004, 0.015], [0.026, 0.018, 0.052], [0.0, 0.12, 0.0]),
            head: Head::new(),
            arm: Loft::new(0, 2.1, 0.012, &arm),
            arm_muscles: vec![
                (plain([0.204, 1.403, -0.026], [0.068, 0.051, 0.056]), 0.035),
                (plain([0.319, 1.402, -0.008], [0.078, 0.036, 0.035]), 0.030),
                (plain([0.300, 1.396, -0.050], [0.088, 0.038, 0.032]), 0.030),
                (plain([0.492, 1.405, -0.004], [0.068, 0.031, 0.030]), 0.030),
                (plain([0.447, 1.397, -0.058], [0.020, 0.018, 0.014]), 0.020),
            ],
            hand: Hand::new(),
        }
    }

    /// Distance to the surface [m], first order near it, negative inside; pelvis at the origin.
    pub(super) fn distance(&self, p: &Vec3) -> f64 {
        let near = Vec3::new(p.x.abs(), p.y + PELVIS_HEIGHT, p.z);
        if near.x > HAND_REACH {
            return self.hand.join(&near, self.arm(&near));
        }
        let far = Vec3::new(-near.x, near.y, near.z);
        // What lies beside the middle meets its mirror image softly, so that no crease runs down x = 0.
        let mut d = self.torso.distance(&near);
        for (solid, seam, middle) in &self.trunk {
            let (low, high) = solid.bounds();
            if super::field::outside(&near, &low, &high) < d + seam {
                let here = solid.distance(&near);
                let both = if near.x > 0.2 { here } else { smooth_min(here, solid.distance(&far), *middle) };
                d = smooth_min(d, both, *seam);
            }
        }
        if near.y < 1.10 {
            let mut leg = self.leg(&near);
            if near.x < 0.2 {
                leg = smooth_min(leg, self.leg(&far), 0.015);
            }
            d = smooth_min(d, leg, 0.05);
        }
        if near.y > 1.3 {
            d = self.head.join(&near, d);
            d = self.trapezius.join(&near, d, 0.05);
        }
        if near.x > 0.02 && near.y > 1.1 { smooth_min(d, self.arm(&near), 0.05) } else { d }
    }

    fn arm(&self, p: &Vec3) -> f64 {
        let arm = self.arm.distance(p);
        self.arm_muscles.iter().fold(arm, |d, (solid, seam)| solid.join(p, d, *seam))
    }

    fn leg(&self, p: &Vec3) -> f64 {
        let leg = self.leg.distance(p);
        let mut leg = self.muscles.iter().fold(leg, |d, (solid, seam)| solid.join(p, d, *seam));
        if p.y < 0.25 {
            let sole = self.toes.iter().fold(self.foot.distance(p), |d, toe| toe.join(p, d, 0.014));
            leg = smooth_min(leg, sole, 0.035);
            leg = smooth_max(leg, -self.arch.distance(p), 0.020);
            // The sole is flat: nothing is below the floor.
            leg = smooth_max(leg, -p.y, 0.008);
        }
        leg
    }

    /// Direction in which the distance grows fastest, by central differences.
    pub(super) fn gradient(&self, p: &Vec3) -> Vec3 {
        let h = 1e-4;
        Vec3::from_fn(|k, _| {
            let step = Vec3::ith(k, h);
            (self.distance(&(p + step)) - self.distance(&(p - step))) / (2.0 * h)
        })
    }
}
