//! Names of the boundary loops of a garment that was not cut here: by which limbs of the body go through them.

use super::NamedLoop;
use super::rest::BodyRest;
use super::style::GarmentKind;
use caphy_core::pose::smplx_joint;
use caphy_core::query::boundary_loops;
use caphy_core::{Error, Result, TriMesh, Vec3};

/// Ends of the body, as bits: which of them a loop parts from the rest.
const HEAD: u8 = 1;
const HANDS: [u8; 2] = [2, 4];
const FEET: [u8; 2] = [8, 16];
const ALL: u8 = 31;
/// How far the ends are drawn out beyond the last joint [m]: farther than any garment reaches.
const BEYOND: f64 = 1.0;

/// Paths from the pelvis to each end of the body, in the order of the bits above.
fn paths(body: &BodyRest) -> [Vec<Vec3>; 5] {
    let joint = |name: &str| body.joints[smplx_joint(name).unwrap_or(0)];
    let drawn_out = |mut path: Vec<Vec3>, along: Option<Vec3>| {
        let [.., before, last] = path[..] else { return path };
        let along = along.or_else(|| (last - before).try_normalize(1e-9)).unwrap_or_else(Vec3::y);
        path.push(last + along * BEYOND);
        path
    };
    let (pelvis, chest) = (joint("pelvis"), joint("spine3"));
    let arm = |side: &str| {
        let path = vec![pelvis, chest, joint(&format!("{side}_shoulder")), joint(&format!("{side}_wrist"))];
        drawn_out(path, None)
    };
    let leg =
        |side: &str| drawn_out(vec![pelvis, joint(&format!("{side}_hip")), joint(&format!("{side}_ankle"))], None);
    let head = drawn_out(vec![pelvis, chest, joint("neck"), joint("head")], Some(Vec3::y()));
    [head, arm("left"), arm("right"), leg("left"), leg("right")]
}

/// Times that a path goes through the fan of triangles from a loop's centre, signed by direction.
fn crossings(path: &[Vec3], ring: &[Vec3]) -> i32 {
    let centre = ring.iter().sum::<Vec3>() / ring.len() as f64;
    let mut total = 0;
    for segment in path.windows(2) {
        let (from, to) = (segment[0], segment[1]);
        let along = to - from;
        for k in 0..ring.len() {
            let (b, c) = (ring[k], ring[(k + 1) % ring.len()]);
            // Signed volumes: the ends lie on both sides of the plane, and the line passes all three sides in one sense.
            let side = |p: &Vec3| (b - centre).cross(&(c - centre)).dot(&(p - centre));
            let (s, t) = (side(&from), side(&to));
            if (s < 0.0) == (t < 0.0) {
                continue;
            }
            let turn = |p: &Vec3, q: &Vec3| along.dot(&(p - from).cross(&(q - from))) < 0.0;
            let sense = turn(&centre, &b);
            if sense == turn(&b, &c) && sense == turn(&c, &centre) {
                total += if t < 0.0 { -1 } else { 1 };
            }
        }
    }
    total
}

/// Number of edges with one face.
pub(super) fn boundary_edge_count(faces: &[[u32; 3]]) -> usize {
    boundary_loops(faces).iter().map(Vec::len).sum()
}

/// What a loop goes around.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Around {
    Neck,
    Arm(usize),
    Leg(usize),
    /// The trunk, both thighs of a skirt included.
    Trunk,
    /// Nothing, or several ends at once: a slit, a torn hole, the front of an open jacket.
    Opening,
}

fn around(ends: u8) -> Around {
    // Which side of the loop the pelvis is on does not matter: an end set and its complement are the same loop.
    for set in [ends, ALL & !ends] {
        match set {
            HEAD => return Around::Neck,
            s if s == HANDS[0] || s == HANDS[1] => return Around::Arm(usize::from(s == HANDS[1])),
            s if s == FEET[0] || s == FEET[1] => return Around::Leg(usize::from(s == FEET[1])),
            s if s == FEET[0] | FEET[1] => return Around::Trunk,
            // One shoulder is bare: the neckline takes that arm in.
            s if s == HEAD | HANDS[0] || s == HEAD | HANDS[1] => return Around::Neck,
            _ => {}
        }
    }
    Around::Opening
}

/// Boundary loops with their names, and the kind of garment they make where they tell.
pub(crate) struct Openings {
    rings: Vec<(Vec<u32>, Around, f64)>,
}

impl Openings {
    pub(crate) fn find(mesh: &TriMesh, body: &BodyRest) -> Self {
        let paths = paths(body);
        let rings = boundary_loops(&mesh.faces)
            .into_iter()
            .map(|ring| {
                let points: Vec<Vec3> = ring.iter().map(|&v| mesh.vertices[v as usize]).collect();
                let height = points.iter().map(|p| p.y).sum::<f64>() / points.len() as f64;
                let ends =
                    (0..5).filter(|&k| crossings(&paths[k], &points) % 2 != 0).fold(0u8, |ends, k| ends | 1 << k);
                (ring, around(ends), height)
            })
            .collect();
        Self { rings }
    }
    /// What the loops say; nothing for a tube around the trunk.
    pub(crate) fn kind(&self) -> Option<GarmentKind> {
        let any = |of: fn(&Around) -> bool| self.rings.iter().any(|r| of(&r.1));
        if any(|a| matches!(a, Around::Neck | Around::Arm(_))) {
            Some(GarmentKind::Upper)
        } else if any(|a| matches!(a, Around::Leg(_))) {
            Some(GarmentKind::Lower)
        } else {
            None
        }
    }
    /// Loops by name, in the order neck, waist, hem, cuffs, others.
    ///
    /// # Errors
    /// [`Error::Mesh`] when no loop goes around any part of the body.
    pub(crate) fn named(self, name: &str, kind: GarmentKind) -> Result<Vec<NamedLoop>> {
        if self.rings.iter().all(|r| r.1 == Around::Opening) {
            let list: Vec<String> = self.rings.iter().map(|r| format!("{} vertices", r.0.len())).collect();
            return Err(Error::mesh(
                name,
                "boundary loops",
                format!("none of {} goes around the neck, the trunk or a limb ({})", self.rings.len(), list.join(", ")),
                "give a garment that is worn: close the front of a jacket, and place it on the T-posed body",
            ));
        }
        // Rings around the trunk from above: the lowest of a shirt is its hem, the highest of trousers their waist.
        let mut heights: Vec<f64> = self.rings.iter().filter(|r| r.1 == Around::Trunk).map(|r| r.2).collect();
        heights.sort_by(|a, b| b.total_cmp(a));
        let mut openings = 0;
        let mut out: Vec<(usize, NamedLoop)> = Vec::new();
        for (vertices, around, height) in self.rings {
            let (rank, label) = match (around, kind) {
                (Around::Neck, _) => (0, "neck".to_string()),
                (Around::Trunk, GarmentKind::Lower) if heights[0] == height => (1, "waist".into()),
                (Around::Trunk, GarmentKind::Upper) if heights.len() > 1 && heights[0] == height => (1, "bust".into()),
                (Around::Trunk, _) => (2, "hem".into()),
                (Around::Arm(side), _) | (Around::Leg(side), GarmentKind::Lower) => {
                    (3 + side, ["cuff_left", "cuff_right"][side].into())
                }
                (Around::Leg(side), GarmentKind::Upper) => (5 + side, ["leg_left", "leg_right"][side].into()),
                (Around::Opening, _) => {
                    openings += 1;
                    (7, format!("opening_{openings}"))
                }
            };
            out.push((rank, NamedLoop { name: label, vertices }));
        }
        out.sort_by_key(|(rank, _)| *rank);
        // Two loops of one name (a bow of two straps around one arm): the later ones are numbered.
        let mut named: Vec<NamedLoop> = Vec::new();
        for (_, mut ring) in out {
            let base = ring.name.clone();
            let mut number = 1;
            while named.iter().any(|l| l.name == ring.name) {
                number += 1;
                ring.name = format!("{base}_{number}");
            }
            named.push(ring);
        }
        Ok(named)
    }
}
