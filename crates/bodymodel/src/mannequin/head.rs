//! Head and neck: a mannequin's face, with brow, nose, mouth, chin and ears suggested.

use super::field::{Capsule, Ellipsoid, Loft, Section, Solid, smooth_max, smooth_min};
use caphy_core::Vec3;

/// [height, half width, front, back, centre] of the head: z of its front and back and of its widest place [m].
const HEAD: [[f64; 5]; 17] = [
    [1.500, 0.018, 0.082, 0.040, 0.062],
    [1.508, 0.027, 0.091, 0.022, 0.050],
    [1.520, 0.0375, 0.0945, -0.006, 0.030],
    [1.535, 0.0455, 0.0945, -0.034, 0.012],
    [1.550, 0.0530, 0.0945, -0.056, 0.002],
    [1.565, 0.0580, 0.0945, -0.072, -0.002],
    [1.585, 0.0630, 0.0945, -0.085, -0.004],
    [1.605, 0.0670, 0.0935, -0.094, -0.005],
    [1.625, 0.0725, 0.0935, -0.099, -0.006],
    [1.645, 0.0745, 0.0930, -0.100, -0.008],
    [1.665, 0.0730, 0.0885, -0.097, -0.009],
    [1.683, 0.0675, 0.0790, -0.089, -0.010],
    [1.698, 0.0570, 0.0640, -0.076, -0.010],
    [1.709, 0.0430, 0.0460, -0.059, -0.010],
    [1.716, 0.0275, 0.0270, -0.040, -0.010],
    [1.719, 0.0170, 0.0130, -0.028, -0.010],
    [1.7205, 0.0060, 0.0000, -0.018, -0.010],
];

/// [height, half width, front, back, centre z] of the neck [m]; it leans forward.
const NECK: [[f64; 5]; 7] = [
    [1.400, 0.064, 0.050, 0.052, -0.040],
    [1.440, 0.057, 0.051, 0.051, -0.036],
    [1.470, 0.0520, 0.054, 0.051, -0.030],
    [1.500, 0.0495, 0.055, 0.052, -0.024],
    [1.530, 0.0490, 0.052, 0.053, -0.020],
    [1.560, 0.0490, 0.042, 0.052, -0.022],
    [1.590, 0.0440, 0.034, 0.046, -0.024],
];

/// The solids of head and neck; what lies beside the middle is kept for the left side.
pub(super) struct Head {
    skull: Loft,
    neck: Loft,
    /// Masses on the head with the width of their seams [m].
    masses: Vec<(Ellipsoid, f64)>,
    /// The bridge of the nose.
    bridge: Capsule,
    /// Hollows of the eyes.
    socket: Ellipsoid,
    /// Closed lids.
    lid: Ellipsoid,
    /// The muscle from behind the ear to the breastbone.
    sternomastoid: Capsule,
}

impl Head {
    pub(super) fn new() -> Self {
        let skull: Vec<_> = HEAD
            .iter()
            .map(|&[y, a, f, b, z]| Section { at: y, centre: [z, 0.0], radii: [f - z, z - b, a, a] })
            .collect();
        let neck: Vec<_> =
            NECK.iter().map(|&[y, a, f, b, z]| Section { at: y, centre: [z, 0.0], radii: [f, b, a, a] }).collect();
        let (plain, turned) = (Ellipsoid::new, Ellipsoid::turned);
        Self {
            skull: Loft::new(1, 2.2, 0.006, &skull),
            neck: Loft::new(1, 2.0, 0.02, &neck),
            masses: vec![
                // Brow.
                (turned([0.029, 1.632, 0.079], [0.025, 0.0065, 0.012], [0.0, 0.35, -0.06]), 0.016),
                // Cheekbone.
                (turned([0.041, 1.592, 0.062], [0.018, 0.010, 0.014], [0.0, 0.7, 0.1]), 0.026),
                // Corner of the jaw.
                (turned([0.039, 1.538, 0.020], [0.009, 0.018, 0.020], [0.35, 0.0, 0.0]), 0.022),
                // Chin.
                (plain([0.0, 1.513, 0.081], [0.018, 0.012, 0.013]), 0.018),
                // Mouth: two lips.
                (plain([0.0, 1.5565, 0.087], [0.024, 0.0065, 0.0125]), 0.008),
                (plain([0.0, 1.5445, 0.087], [0.021, 0.0065, 0.0120]), 0.008),
                // Tip and wings of the nose.
                (plain([0.0, 1.580, 0.107], [0.0120, 0.0095, 0.0115]), 0.008),
                (plain([0.0105, 1.576, 0.098], [0.0080, 0.0075, 0.0100]), 0.006),
                // Ear.
                (turned([0.0725, 1.600, -0.012], [0.0085, 0.030, 0.017], [-0.2, 0.25, -0.12]), 0.008),
            ],
            bridge: Capsule::new(Vec3::new(0.0, 1.622, 0.088), Vec3::new(0.0, 1.584, 0.105), [0.0075, 0.0090]),
            socket: turned([0.031, 1.614, 0.100], [0.0175, 0.0110, 0.0165], [0.0, 0.25, 0.0]),
            lid: plain([0.031, 1.6135, 0.073], [0.0145, 0.0095, 0.0125]),
            sternomastoid: Capsule::new(
                Vec3::new(0.050, 1.545, -0.026),
                Vec3::new(0.014, 1.430, 0.020),
                [0.008, 0.010],
            ),
        }
    }

    /// Head and neck joined to the trunk at distance `trunk` [m]; `p` on the left side.
    pub(super) fn join(&self, p: &Vec3, trunk: f64) -> f64 {
        let neck = self.sternomastoid.join(p, self.neck.distance(p), 0.03);
        let mut head = self.skull.distance(p);
        for (solid, seam) in &self.masses {
            head = solid.join(p, head, *seam);
        }
        head = self.bridge.join(p, head, 0.012);
        head = smooth_max(head, -self.socket.distance(p), 0.014);
        head = self.lid.join(p, head, 0.006);
        smooth_min(trunk, smooth_min(head, neck, 0.024), 0.04)
    }
}
