//! The grid on which the figure is sampled: equal cells in grid space, finer in the body at hands, head and feet.

use super::figure::PELVIS_HEIGHT;
use caphy_core::Vec3;

/// A part of the body where cells are finer. Beyond `from` along its axis the grid is stretched, rising over `ramp`, along
/// the axis by `along` times, across it by `across` times, about a line through `centre`.
struct Part {
    /// Where it begins, and over what length it becomes finer, along the axis [m].
    from: f64,
    ramp: f64,
    along: f64,
    across: [f64; 2],
    /// In the two other axes, in cyclic order after the axis [m].
    centre: [f64; 2],
}

/// Grid space to body space.
pub(super) struct Grid {
    /// Size of the cells in grid space [m].
    pub(super) cell: f64,
    hand: Part,
    head: Part,
    foot: Part,
}

/// Fingers are lost in cells larger than this across them [m].
const LARGEST_FINGER_CELL: f64 = 0.0055;

impl Grid {
    /// Cells of a size [m] in trunk and limbs.
    pub(super) fn new(cell: f64) -> Self {
        // Fingers need a certain fineness whatever the rest of the body has.
        let finger = (cell / LARGEST_FINGER_CELL).max(3.6);
        Self {
            cell,
            hand: Part {
                from: 0.640,
                ramp: 0.120,
                along: 0.62 * finger,
                across: [finger, finger],
                centre: [1.398 - PELVIS_HEIGHT, -0.015],
            },
            head: Part { from: 1.470 - PELVIS_HEIGHT, ramp: 0.06, along: 1.95, across: [1.9, 1.8], centre: [0.0, 0.0] },
            // Down from the ankle: the axis points to the floor.
            foot: Part { from: PELVIS_HEIGHT - 0.14, ramp: 0.09, along: 1.5, across: [1.4, 1.4], centre: [0.02, 0.15] },
        }
    }

    /// The body position of a grid position.
    pub(super) fn to_body(&self, q: &Vec3) -> Vec3 {
        let side = 1f64.copysign(q.x);
        let x = q.x.abs();
        if x > self.hand.from {
            let (x, [y, z]) = self.hand.at(x, [q.y, q.z]);
            Vec3::new(side * x, y, z)
        } else if q.y > self.head.from {
            let (y, [z, x]) = self.head.at(q.y, [q.z, x]);
            Vec3::new(side * x, y, z)
        } else if q.y < -self.foot.from {
            let (down, [z, x]) = self.foot.at(-q.y, [q.z, x]);
            Vec3::new(side * x, -down, z)
        } else {
            *q
        }
    }

    /// Smallest and largest corner of the part of grid space that holds the body's left half, with a margin [m].
    pub(super) fn bounds(&self) -> (Vec3, Vec3) {
        let margin = 2.0 * self.cell;
        let [hand, head, foot] = [(&self.hand, 0.90), (&self.head, 0.775), (&self.foot, 0.952)]
            .map(|(part, end): (&Part, f64)| part.reach(end));
        // Half extents of hand, head and foot across their axes, stretched.
        let across = |part: &Part, k: usize, half: f64| part.across[k] * half;
        let (hand_up, hand_side) = (across(&self.hand, 0, 0.045), across(&self.hand, 1, 0.095));
        let head_front = across(&self.head, 0, 0.125);
        let foot_front = across(&self.foot, 0, 0.165);
        let front = hand_side.max(head_front).max(foot_front).max(0.19);
        let low = Vec3::new(0.0, -foot, -front);
        let high = Vec3::new(hand, head.max(self.hand.centre[0] + hand_up), front);
        (low.add_scalar(-margin), high.add_scalar(margin))
    }
}

impl Part {
    /// How far grid space reaches for a body position along the axis.
    fn reach(&self, body: f64) -> f64 {
        let u = body - self.from;
        let rise = (self.along - 1.0) / self.ramp;
        let ramp = u.clamp(0.0, self.ramp);
        self.from + ramp + 0.5 * rise * ramp * ramp + self.along * (u - ramp).max(0.0)
    }

    /// Body position along and across the axis for a grid position beyond `from`.
    fn at(&self, along: f64, across: [f64; 2]) -> (f64, [f64; 2]) {
        let beyond = along - self.from;
        // d grid / d body rises linearly over the ramp: grid = u + (f - 1) u² / (2 ramp).
        let rise = (self.along - 1.0) / self.ramp;
        let u = ((1.0 + 2.0 * rise * beyond).sqrt() - 1.0) / rise;
        let ramp_end = self.ramp + 0.5 * rise * self.ramp * self.ramp;
        let (u, t) =
            if u <= self.ramp { (u, u / self.ramp) } else { (self.ramp + (beyond - ramp_end) / self.along, 1.0) };
        let squeeze = |k: usize| self.centre[k] + (across[k] - self.centre[k]) / (1.0 + (self.across[k] - 1.0) * t);
        (self.from + u, [squeeze(0), squeeze(1)])
    }
}
