//! The table of states.

use caphy_core::Vec3;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// What an extreme does to a cloth.
pub(crate) struct Extreme {
    /// Name, as in the design.
    pub(crate) name: &'static str,
    /// Positions from those at rest [m].
    pub(crate) positions: fn(&[Vec3]) -> Vec<Vec3>,
    /// Whether any guard of the energies acts there.
    pub(crate) guarded: bool,
}

fn map(rest: &[Vec3], f: impl Fn(&Vec3) -> Vec3) -> Vec<Vec3> {
    rest.iter().map(f).collect()
}

/// Shaken by so much [m], always alike.
pub(crate) fn shaken(points: &[Vec3], size: f64) -> Vec<Vec3> {
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    points.iter().map(|p| p + Vec3::from_fn(|_, _| rng.random_range(-size..size))).collect()
}

/// Folded along a column by an angle.
fn folded(rest: &[Vec3], angle: f64) -> Vec<Vec3> {
    map(rest, |p| {
        let over = p.x - 0.05;
        if over <= 0.0 {
            Vec3::new(p.x, p.y, 0.0)
        } else {
            Vec3::new(0.05 + over * angle.cos(), p.y, over * angle.sin())
        }
    })
}

/// One per line.
pub(crate) const EXTREMES: &[Extreme] = &[
    Extreme { name: "regular, shaken", positions: |x| shaken(x, 2e-3), guarded: false },
    Extreme { name: "inverted", positions: |x| map(x, |p| Vec3::new(-p.x, p.y, p.z)), guarded: false },
    Extreme {
        name: "turned inside out in part",
        positions: |x| map(x, |p| Vec3::new((p.x - 0.06).abs(), p.y, p.z)),
        guarded: false,
    },
    Extreme {
        name: "zero area: collapsed to a line",
        positions: |x| map(x, |p| Vec3::new(p.x, 0.0, 0.0)),
        guarded: true,
    },
    Extreme { name: "collapsed to a point", positions: |x| vec![Vec3::new(0.1, 0.2, 0.3); x.len()], guarded: true },
    Extreme { name: "shrunk to micrometres", positions: |x| map(x, |p| p * 1e-4), guarded: false },
    Extreme {
        name: "needles",
        positions: |x| {
            let mut out = shaken(x, 1e-3);
            // Beside the middle of the edge opposite, by 4 µm.
            out[12] = 0.5 * (out[6] + out[8]) + Vec3::new(0.0, 4e-6, 3e-6);
            out[7] = 0.5 * (out[6] + out[8]) - Vec3::new(0.0, 2e-6, 5e-6);
            out
        },
        guarded: true,
    },
    Extreme {
        name: "coincident vertices",
        positions: |x| {
            let mut out = shaken(x, 1e-3);
            (out[7], out[17]) = (out[12], out[18]);
            out
        },
        guarded: true,
    },
    Extreme { name: "stretch x10 along u", positions: |x| map(x, |p| Vec3::new(10.0 * p.x, p.y, p.z)), guarded: false },
    Extreme { name: "stretch x10 both ways", positions: |x| map(x, |p| p * 10.0), guarded: false },
    Extreme {
        name: "one vertex torn away",
        positions: |x| {
            let mut out = shaken(x, 1e-3);
            out[12].z += 5.0;
            out
        },
        guarded: false,
    },
    Extreme { name: "stretch x1000", positions: |x| map(&shaken(x, 1e-3), |p| p * 1e3), guarded: false },
    Extreme {
        name: "equal principal strains",
        positions: |x| map(x, |p| Vec3::new(1.1 * p.x, 1.1 * p.y, 0.0)),
        guarded: false,
    },
    Extreme {
        name: "folded almost by 180 degrees",
        positions: |x| folded(x, 0.999 * std::f64::consts::PI),
        guarded: false,
    },
    Extreme { name: "folded by +180 degrees", positions: |x| folded(x, std::f64::consts::PI), guarded: false },
    Extreme { name: "folded by -180 degrees", positions: |x| folded(x, -std::f64::consts::PI), guarded: false },
    Extreme { name: "crumpled", positions: |x| shaken(x, 0.05), guarded: false },
    Extreme { name: "far from the origin", positions: |x| map(x, |p| p + Vec3::repeat(1e3)), guarded: false },
];
