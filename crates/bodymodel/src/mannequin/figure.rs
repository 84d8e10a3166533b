//! The figure: joints and solids of a slim adult of 1.72 m.
//!
//! Lengths follow the segment ratios of Drillis and Contini (1966) for this stature; girths are those of a slim adult
//! (chest 0.93 m, waist 0.78 m, hip 0.96 m). Heights in the tables are above the floor; the pelvis joint stands at
//! [`PELVIS_HEIGHT`] and becomes the origin of the model.

use super::field::{Capsule, Ellipsoid, Loft, Section, smooth_max, smooth_min};
use caphy_core::Vec3;
use caphy_core::pose::SMPLX_JOINTS;

/// Height of the pelvis joint above the floor [m].
pub(super) const PELVIS_HEIGHT: f64 = 0.95;

/// Joints of the middle and of the left side above the floor [m]; the right side mirrors the left.
const JOINTS: [(&str, [f64; 3]); 31] = [
    ("pelvis", [0.0, 0.950, 0.000]),
    ("spine1", [0.0, 1.055, -0.015]),
    ("spine2", [0.0, 1.175, -0.020]),
    ("spine3", [0.0, 1.245, -0.015]),
    ("neck", [0.0, 1.450, -0.030]),
    ("head", [0.0, 1.550, -0.005]),
    ("jaw", [0.0, 1.560, 0.030]),
    ("left_hip", [0.085, 0.890, 0.000]),
    ("left_knee", [0.118, 0.480, 0.000]),
    ("left_ankle", [0.140, 0.080, -0.030]),
    ("left_foot", [0.158, 0.025, 0.090]),
    ("left_collar", [0.065, 1.395, -0.025]),
    ("left_shoulder", [0.180, 1.400, -0.025]),
    ("left_elbow", [0.445, 1.400, -0.030]),
    ("left_wrist", [0.685, 1.400, -0.022]),
    ("left_eye_smplhf", [0.030, 1.620, 0.060]),
    ("left_index1", [0.772, 1.400, 0.008]),
    ("left_index2", [0.804, 1.400, 0.009]),
    ("left_index3", [0.826, 1.400, 0.010]),
    ("left_middle1", [0.776, 1.400, -0.014]),
    ("left_middle2", [0.812, 1.400, -0.014]),
    ("left_middle3", [0.837, 1.400, -0.014]),
    ("left_pinky1", [0.760, 1.400, -0.052]),
    ("left_pinky2", [0.784, 1.400, -0.052]),
    ("left_pinky3", [0.800, 1.400, -0.051]),
    ("left_ring1", [0.770, 1.400, -0.034]),
    ("left_ring2", [0.802, 1.400, -0.034]),
    ("left_ring3", [0.824, 1.400, -0.033]),
    ("left_thumb1", [0.708, 1.394, 0.006]),
    ("left_thumb2", [0.738, 1.390, 0.032]),
    ("left_thumb3", [0.763, 1.388, 0.048]),
];

/// Joint positions in SMPL-X order, pelvis at the origin [m].
pub(super) fn joints() -> Vec<Vec3> {
    SMPLX_JOINTS
        .iter()
        .map(|name| {
            let (left, side) = match name.strip_prefix("right_") {
                Some(rest) => (format!("left_{rest}"), -1.0),
                None => ((*name).to_string(), 1.0),
            };
            let at = JOINTS.iter().find(|(n, _)| *n == left).map_or([0.0, PELVIS_HEIGHT, 0.0], |(_, p)| *p);
            Vec3::new(side * at[0], at[1] - PELVIS_HEIGHT, at[2])
        })
        .collect()
}

/// [height, half width, front, back] of the torso above the floor [m].
const TORSO: [[f64; 4]; 20] = [
    [0.785, 0.060, 0.035, 0.045],
    [0.820, 0.112, 0.066, 0.078],
    [0.850, 0.136, 0.086, 0.096],
    [0.890, 0.150, 0.099, 0.106],
    [0.930, 0.157, 0.105, 0.106],
    [0.970, 0.156, 0.107, 0.100],
    [1.010, 0.151, 0.104, 0.090],
    [1.050, 0.140, 0.099, 0.081],
    [1.090, 0.1335, 0.095, 0.078],
    [1.130, 0.134, 0.095, 0.081],
    [1.180, 0.141, 0.100, 0.090],
    [1.230, 0.150, 0.108, 0.099],
    [1.280, 0.157, 0.111, 0.106],
    [1.330, 0.160, 0.104, 0.109],
    [1.370, 0.154, 0.088, 0.105],
    [1.400, 0.138, 0.070, 0.097],
    [1.430, 0.108, 0.050, 0.086],
    [1.455, 0.078, 0.036, 0.076],
    [1.480, 0.056, 0.030, 0.068],
    [1.500, 0.046, 0.030, 0.060],
];

/// [height, centre x, centre z, inside, outside, front, back] of the left leg above the floor [m].
const LEG: [[f64; 7]; 19] = [
    [0.030, 0.143, -0.034, 0.028, 0.028, 0.030, 0.030],
    [0.080, 0.140, -0.034, 0.034, 0.033, 0.042, 0.036],
    [0.120, 0.138, -0.034, 0.033, 0.032, 0.039, 0.034],
    [0.180, 0.136, -0.030, 0.036, 0.036, 0.040, 0.042],
    [0.240, 0.133, -0.024, 0.043, 0.044, 0.045, 0.056],
    [0.300, 0.130, -0.018, 0.051, 0.051, 0.049, 0.068],
    [0.350, 0.127, -0.014, 0.054, 0.054, 0.051, 0.071],
    [0.400, 0.124, -0.008, 0.053, 0.052, 0.052, 0.065],
    [0.440, 0.121, -0.002, 0.052, 0.050, 0.054, 0.058],
    [0.480, 0.118, 0.002, 0.053, 0.051, 0.058, 0.055],
    [0.520, 0.115, 0.004, 0.056, 0.053, 0.060, 0.057],
    [0.580, 0.111, 0.004, 0.062, 0.060, 0.066, 0.064],
    [0.650, 0.105, 0.003, 0.069, 0.069, 0.076, 0.072],
    [0.720, 0.099, 0.001, 0.075, 0.076, 0.083, 0.079],
    [0.790, 0.093, -0.002, 0.079, 0.080, 0.087, 0.086],
    [0.850, 0.088, -0.004, 0.078, 0.077, 0.084, 0.086],
    [0.900, 0.085, -0.004, 0.066, 0.066, 0.072, 0.074],
    [0.950, 0.082, -0.004, 0.048, 0.050, 0.054, 0.056],
    [0.980, 0.080, -0.004, 0.030, 0.030, 0.034, 0.034],
];

/// [x, centre height, centre z, above, below, front, back] of the left arm and hand, heights above the floor [m].
const ARM: [[f64; 7]; 20] = [
    [0.090, 1.385, -0.026, 0.040, 0.060, 0.050, 0.052],
    [0.140, 1.392, -0.026, 0.050, 0.066, 0.056, 0.058],
    [0.180, 1.398, -0.026, 0.055, 0.064, 0.057, 0.058],
    [0.220, 1.400, -0.026, 0.053, 0.058, 0.053, 0.054],
    [0.270, 1.400, -0.027, 0.048, 0.051, 0.047, 0.048],
    [0.330, 1.400, -0.028, 0.045, 0.047, 0.044, 0.044],
    [0.390, 1.400, -0.029, 0.042, 0.043, 0.040, 0.040],
    [0.445, 1.400, -0.030, 0.038, 0.039, 0.039, 0.040],
    [0.490, 1.400, -0.029, 0.039, 0.040, 0.043, 0.041],
    [0.540, 1.400, -0.027, 0.036, 0.038, 0.041, 0.039],
    [0.600, 1.400, -0.025, 0.030, 0.031, 0.034, 0.033],
    [0.650, 1.400, -0.023, 0.024, 0.024, 0.029, 0.029],
    [0.685, 1.400, -0.022, 0.021, 0.021, 0.029, 0.029],
    [0.715, 1.400, -0.021, 0.019, 0.020, 0.036, 0.035],
    [0.745, 1.400, -0.021, 0.017, 0.018, 0.041, 0.040],
    [0.775, 1.400, -0.020, 0.015, 0.016, 0.041, 0.041],
    [0.805, 1.400, -0.019, 0.013, 0.014, 0.038, 0.040],
    [0.835, 1.400, -0.017, 0.012, 0.012, 0.033, 0.035],
    [0.855, 1.400, -0.015, 0.010, 0.010, 0.025, 0.024],
    [0.868, 1.400, -0.014, 0.007, 0.007, 0.014, 0.012],
];

/// [z, centre x, centre height, half width, above, below] of the left foot [m]; the toes point outward by about 8°.
const FOOT: [[f64; 6]; 9] = [
    [-0.082, 0.138, 0.032, 0.014, 0.016, 0.014],
    [-0.068, 0.139, 0.034, 0.027, 0.036, 0.032],
    [-0.040, 0.141, 0.034, 0.033, 0.050, 0.034],
    [0.000, 0.146, 0.033, 0.034, 0.058, 0.033],
    [0.045, 0.152, 0.030, 0.039, 0.042, 0.030],
    [0.090, 0.158, 0.024, 0.046, 0.028, 0.024],
    [0.130, 0.162, 0.020, 0.046, 0.019, 0.020],
    [0.158, 0.163, 0.017, 0.036, 0.014, 0.016],
    [0.172, 0.163, 0.015, 0.020, 0.008, 0.010],
];

/// [height, half width, front, back, centre z] of head and neck above the floor [m].
const HEAD: [[f64; 5]; 15] = [
    [1.420, 0.062, 0.056, 0.054, -0.030],
    [1.460, 0.056, 0.054, 0.052, -0.026],
    [1.490, 0.0535, 0.054, 0.052, -0.020],
    [1.510, 0.0535, 0.066, 0.054, -0.014],
    [1.525, 0.056, 0.084, 0.060, -0.010],
    [1.545, 0.061, 0.092, 0.070, -0.006],
    [1.570, 0.0665, 0.093, 0.081, -0.003],
    [1.600, 0.0715, 0.091, 0.091, -0.002],
    [1.630, 0.0745, 0.091, 0.097, -0.002],
    [1.660, 0.0735, 0.087, 0.095, -0.003],
    [1.680, 0.0680, 0.078, 0.086, -0.004],
    [1.697, 0.0570, 0.064, 0.072, -0.005],
    [1.709, 0.0420, 0.046, 0.054, -0.006],
    [1.716, 0.0270, 0.029, 0.034, -0.007],
    [1.720, 0.0090, 0.010, 0.012, -0.007],
];

/// The solids of the figure. Only the left side is kept.
pub(super) struct Figure {
    torso: Loft,
    head: Loft,
    leg: Loft,
    arm: Loft,
    foot: Loft,
    thumb: [Capsule; 2],
    trapezius: Capsule,
    deltoid: Ellipsoid,
    chest: Ellipsoid,
    glute: Ellipsoid,
    nose: Ellipsoid,
}

impl Figure {
    /// The figure from its tables.
    pub(super) fn new() -> Self {
        let section = |at, centre, radii| Section { at, centre, radii };
        // Axis y: the other two axes are z, then x.
        let torso: Vec<_> = TORSO.iter().map(|&[y, a, f, b]| section(y, [-0.004, 0.0], [f, b, a, a])).collect();
        let head: Vec<_> = HEAD.iter().map(|&[y, a, f, b, z]| section(y, [z, 0.0], [f, b, a, a])).collect();
        let leg: Vec<_> = LEG.iter().map(|&[y, x, z, i, o, f, b]| section(y, [z, x], [f, b, o, i])).collect();
        // Axis x: then y, z. Axis z: then x, y.
        let arm: Vec<_> = ARM.iter().map(|&[x, y, z, u, d, f, b]| section(x, [y, z], [u, d, f, b])).collect();
        let foot: Vec<_> = FOOT.iter().map(|&[z, x, y, w, u, d]| section(z, [x, y], [w, w, u, d])).collect();
        let v = Vec3::new;
        Self {
            torso: Loft::new(1, 2.35, 0.05, &torso),
            head: Loft::new(1, 2.1, 0.008, &head),
            leg: Loft::new(1, 2.0, 0.03, &leg),
            arm: Loft::new(0, 2.2, 0.012, &arm),
            foot: Loft::new(2, 2.4, 0.012, &foot),
            thumb: [
                Capsule { ends: [v(0.705, 1.394, 0.000), v(0.740, 1.390, 0.033)], radii: [0.0155, 0.0135] },
                Capsule { ends: [v(0.740, 1.390, 0.033), v(0.778, 1.388, 0.056)], radii: [0.0135, 0.0100] },
            ],
            trapezius: Capsule { ends: [v(0.020, 1.466, -0.045), v(0.170, 1.414, -0.030)], radii: [0.040, 0.040] },
            deltoid: Ellipsoid { centre: v(0.195, 1.400, -0.026), radii: v(0.062, 0.050, 0.054) },
            chest: Ellipsoid { centre: v(0.078, 1.285, 0.066), radii: v(0.066, 0.056, 0.048) },
            glute: Ellipsoid { centre: v(0.074, 0.900, -0.062), radii: v(0.078, 0.082, 0.066) },
            nose: Ellipsoid { centre: v(0.0, 1.592, 0.088), radii: v(0.011, 0.020, 0.015) },
        }
    }

    /// Distance to the surface [m], first order near it, negative inside; pelvis at the origin.
    pub(super) fn distance(&self, p: &Vec3) -> f64 {
        let near = Vec3::new(p.x.abs(), p.y + PELVIS_HEIGHT, p.z);
        let far = Vec3::new(-near.x, near.y, near.z);
        // What lies beside the middle meets its mirror image softly, so that no crease runs down x = 0.
        let both = |solid: &dyn Fn(&Vec3) -> f64, k: f64| {
            let here = solid(&near);
            if near.x > 0.2 { here } else { smooth_min(here, solid(&far), k) }
        };
        let mut d = self.torso.distance(&near);
        d = smooth_min(d, both(&|q| self.chest.distance(q), 0.03), 0.045);
        d = smooth_min(d, both(&|q| self.glute.distance(q), 0.03), 0.045);
        let mut leg = both(&|q| self.leg.distance(q), 0.015);
        let sole = self.foot.distance(&near);
        // The sole is flat: nothing is below the floor.
        leg = smooth_min(leg, smooth_max(sole, -near.y, 0.008), 0.035);
        d = smooth_min(d, leg, 0.05);
        let head = smooth_min(self.head.distance(&near), self.nose.distance(&near), 0.016);
        d = smooth_min(d, head, 0.04);
        d = smooth_min(d, self.trapezius.distance(&near), 0.05);
        let arm = smooth_min(self.arm.distance(&near), self.deltoid.distance(&near), 0.03);
        let thumb = self.thumb.iter().map(|t| t.distance(&near)).fold(f64::INFINITY, f64::min);
        smooth_min(d, smooth_min(arm, thumb, 0.012), 0.05)
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
