//! The body that garments are cut on: its T-posed surface, joints, skinning weights and landmarks.

use super::sections::{Tube, TubeAxes};
use caphy_core::body::{BlendWeights, BodyModel, BodyParameters};
use caphy_core::pose::{SMPLX_JOINTS, smplx_joint};
use caphy_core::{Error, Result, TriMesh, Vec3};

/// A body at rest (T-pose, y up, facing +z, left arm along +x) in the SMPL-X joint layout.
#[derive(Debug, Clone)]
pub struct BodyRest {
    /// Surface; several components are fine (eyes, mouth), faces counter-clockwise from outside.
    pub mesh: TriMesh,
    /// Joints [m], shape [55], in the order of [`SMPLX_JOINTS`].
    pub joints: Vec<Vec3>,
    /// Skinning weights, shape [vertex_count], joints numbered as above.
    pub weights: BlendWeights,
}

impl BodyRest {
    /// A checked body.
    ///
    /// # Errors
    /// [`Error::Mesh`] for an empty or broken surface, [`Error::Length`] for wrong counts, [`Error::NonFinite`] for bad
    /// joints.
    pub fn new(mesh: TriMesh, joints: Vec<Vec3>, weights: BlendWeights) -> Result<Self> {
        if mesh.vertices.is_empty() || mesh.faces.is_empty() {
            let problem = format!("{} vertices and {} faces", mesh.vertices.len(), mesh.faces.len());
            return Err(Error::mesh("body at rest", "whole mesh", problem, "give the body's surface"));
        }
        mesh.check("body at rest")?;
        Error::check_length("joints of the body at rest", SMPLX_JOINTS.len(), joints.len())?;
        let flat: Vec<f64> = joints.iter().flat_map(|j| j.iter().copied()).collect();
        Error::check_finite("joints of the body at rest", &flat)?;
        Error::check_length("skinning weights of the body at rest", mesh.vertices.len(), weights.vertex_count())?;
        Error::check_finite("skinning weights of the body at rest", &weights.weights)?;
        if let Some(&joint) = weights.joints.iter().find(|&&j| usize::from(j) >= SMPLX_JOINTS.len()) {
            return Err(Error::mesh(
                "body at rest",
                "skinning weights",
                format!("joint {joint} but there are {}", SMPLX_JOINTS.len()),
                "number the joints in SMPL-X order",
            ));
        }
        Ok(Self { mesh, joints, weights })
    }

    /// The T-posed surface of a body model. Joints are matched by name; weights of a joint that SMPL-X does not know count
    /// for the nearest ancestor that it does.
    ///
    /// # Errors
    /// Those of [`BodyModel::forward`] and [`BodyRest::new`]; [`Error::Mesh`] when a joint that garments hang on is missing.
    pub fn from_model(body: &dyn BodyModel, parameters: &BodyParameters) -> Result<Self> {
        let description = body.describe();
        let rest = BodyParameters {
            rotations: vec![Vec3::zeros(); description.joints.len()],
            translation: Vec3::zeros(),
            ..parameters.clone()
        };
        let posed = body.forward(&rest)?;
        let mut joints = vec![Vec3::zeros(); SMPLX_JOINTS.len()];
        let mut found = [false; SMPLX_JOINTS.len()];
        let mut to_smplx = vec![0u16; description.joints.len()];
        for (j, joint) in description.joints.iter().enumerate() {
            match (smplx_joint(&joint.name), joint.parent) {
                (Some(id), _) => {
                    joints[id] = posed.joints[j];
                    found[id] = true;
                    to_smplx[j] = id as u16;
                }
                (None, Some(parent)) if parent < j => to_smplx[j] = to_smplx[parent],
                _ => {}
            }
        }
        for name in NEEDED_JOINTS {
            if !smplx_joint(name).is_some_and(|id| found[id]) {
                return Err(Error::mesh(
                    description.name.clone(),
                    format!("joint `{name}`"),
                    "is missing",
                    "garment templates need a body with the main SMPL-X joints; give one or bring your own garment mesh",
                ));
            }
        }
        let rows = (0..description.weights.vertex_count()).map(|v| {
            let mut row: Vec<(u16, f64)> = Vec::new();
            for (j, w) in description.weights.row(v) {
                let id = to_smplx.get(j).copied().unwrap_or(0);
                match row.iter_mut().find(|(known, _)| *known == id) {
                    Some((_, sum)) => *sum += w,
                    None => row.push((id, w)),
                }
            }
            row
        });
        let mesh = TriMesh { vertices: posed.vertices, faces: description.faces.clone() };
        Self::new(mesh, joints, BlendWeights::from_rows(rows))
    }
}

/// Joints whose places the cut of a garment depends on.
const NEEDED_JOINTS: [&str; 12] = [
    "pelvis",
    "spine3",
    "neck",
    "head",
    "left_shoulder",
    "right_shoulder",
    "left_wrist",
    "right_wrist",
    "left_hip",
    "right_hip",
    "left_ankle",
    "right_ankle",
];

/// Which limb a joint belongs to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Limb {
    Trunk,
    Head,
    Arm(usize),
    Hand(usize),
    Leg(usize),
    Foot(usize),
}

/// Limb of an SMPL-X joint; side 0 is left, 1 right.
pub(crate) fn limb_of(joint: usize) -> Limb {
    match joint {
        1 | 4 => Limb::Leg(0),
        2 | 5 => Limb::Leg(1),
        7 | 10 => Limb::Foot(0),
        8 | 11 => Limb::Foot(1),
        15 | 22..=24 => Limb::Head,
        16 | 18 => Limb::Arm(0),
        17 | 19 => Limb::Arm(1),
        20 | 25..=39 => Limb::Hand(0),
        21 | 40..=54 => Limb::Hand(1),
        _ => Limb::Trunk,
    }
}

/// Steps in which heights are looked for [m].
const STEP: f64 = 0.005;
/// How much lower a shoulder counts per width that it lacks.
const NARROWER: f64 = 0.5;

/// Heights and sections of the body that styles are measured in [m].
#[derive(Debug, Clone)]
pub(crate) struct Landmarks {
    /// Horizontal sections of trunk, neck and both legs, without arms.
    pub(crate) trunk: Tube,
    /// Sections of the arms, left and right, from the shoulder joint along the arm.
    pub(crate) arms: [Tube; 2],
    /// Sections of the legs, left and right, from the hip joint down the leg.
    pub(crate) legs: [Tube; 2],
    /// Shoulder to wrist and hip to ankle.
    pub(crate) arm_length: [f64; 2],
    pub(crate) leg_length: [f64; 2],
    /// Heights (y).
    pub(crate) neck_base: f64,
    pub(crate) armpit: f64,
    pub(crate) waist: f64,
    pub(crate) crotch: f64,
    pub(crate) mid_thigh: f64,
    /// Middle of the neck at its base (z) and half its width there.
    pub(crate) neck_depth: f64,
    pub(crate) neck_half_width: f64,
    /// The plane between left and right (x).
    pub(crate) middle: f64,
}

/// Summed weights per limb of each triangle: trunk, arms with hands, legs with feet.
fn triangle_limbs(body: &BodyRest) -> (Vec<[f64; 2]>, Vec<[f64; 2]>) {
    let n = body.mesh.vertices.len();
    let (mut arm, mut leg) = (vec![[0.0; 2]; n], vec![[0.0; 2]; n]);
    for v in 0..n {
        for (joint, w) in body.weights.row(v) {
            match limb_of(joint) {
                Limb::Arm(side) | Limb::Hand(side) => arm[v][side] += w,
                Limb::Leg(side) | Limb::Foot(side) => leg[v][side] += w,
                Limb::Trunk | Limb::Head => {}
            }
        }
    }
    let mean = |of: &[[f64; 2]], f: &[u32; 3]| [0, 1].map(|s| f.iter().map(|&v| of[v as usize][s]).sum::<f64>() / 3.0);
    let faces = &body.mesh.faces;
    (faces.iter().map(|f| mean(&arm, f)).collect(), faces.iter().map(|f| mean(&leg, f)).collect())
}

impl Landmarks {
    pub(crate) fn measure(body: &BodyRest) -> Result<Self> {
        let joint = |name: &str| body.joints[smplx_joint(name).unwrap_or(0)];
        let pair = |name: &str| [joint(&format!("left_{name}")), joint(&format!("right_{name}"))];
        let (arm_weights, leg_weights) = triangle_limbs(body);
        let (shoulders, wrists, hips, ankles) = (pair("shoulder"), pair("wrist"), pair("hip"), pair("ankle"));
        let (pelvis, neck, head, spine3) = (joint("pelvis"), joint("neck"), joint("head"), joint("spine3"));
        let length = |a: &[Vec3; 2], b: &[Vec3; 2], what: &str| -> Result<[f64; 2]> {
            let lengths = [0, 1].map(|s| (b[s] - a[s]).norm());
            if lengths.iter().all(|&l| l > 0.05) && (a[0] - a[1]).norm() > 0.02 {
                Ok(lengths)
            } else {
                let problem = format!("the {what} are {:.3} and {:.3} m long", lengths[0], lengths[1]);
                Err(Error::mesh(
                    "body at rest",
                    format!("{what} joints"),
                    problem,
                    "give joints of a whole body in metres",
                ))
            }
        };
        let arm_length = length(&shoulders, &wrists, "arms")?;
        let leg_length = length(&hips, &ankles, "legs")?;

        let up = TubeAxes::new(pelvis, Vec3::y(), Vec3::x());
        let keep: Vec<bool> = arm_weights.iter().map(|w| w[0] + w[1] < 0.5).collect();
        let trunk_range = (ankles[0].y.min(ankles[1].y) - pelvis.y, head.y - pelvis.y);
        let trunk = Tube::measure("trunk", &body.mesh, &keep, up, trunk_range, trunk_range)?;

        let arm = |side: usize| {
            let axes = TubeAxes::new(shoulders[side], wrists[side] - shoulders[side], Vec3::y());
            let keep: Vec<bool> = arm_weights.iter().map(|w| w[side] > 0.5).collect();
            // Nearer the shoulder the arm's skin is no closed ring: it ends at the armpit.
            let whole = (0.22 * arm_length[side], arm_length[side] + 0.01);
            Tube::measure(
                ["left arm", "right arm"][side],
                &body.mesh,
                &keep,
                axes,
                whole,
                (0.0, arm_length[side] + 0.02),
            )
        };
        let arms = [arm(0)?, arm(1)?];
        let armpit_of = |side: usize| shoulders[side].y - arms[side].reach_at(0.0, &-Vec3::y()) - 0.01;
        let armpit = armpit_of(0).min(armpit_of(1));

        // The narrowest girth between chest and pelvis, and the neck's narrowest above the shoulders.
        let shoulder_height = 0.5 * (shoulders[0].y + shoulders[1].y);
        let waist =
            trunk.narrowest(pelvis.y.max(hips[0].y) + 0.04, spine3.y.max(pelvis.y + 0.1).min(armpit)) + pelvis.y;
        let throat = trunk.narrowest(neck.y.min(head.y - 0.02) - 0.02, head.y) + pelvis.y;
        let neck_girth = trunk.girth_at(throat - pelvis.y);
        let mut neck_base = throat;
        let short_of_base = |y: f64| 1.3 * neck_girth - trunk.girth_at(y - pelvis.y);
        while neck_base > shoulder_height && short_of_base(neck_base) > 0.0 {
            neck_base -= STEP;
        }
        // Between the last two steps: millimetres of skin must not move it by a step.
        let (below, above) = (short_of_base(neck_base), short_of_base(neck_base + STEP));
        if below < 0.0 && above > 0.0 {
            neck_base += STEP * below / (below - above);
        }
        let at = neck_base - pelvis.y;
        let (front, back) = (trunk.reach_at(at, &Vec3::z()), trunk.reach_at(at, &-Vec3::z()));
        let neck_depth = pelvis.z + 0.5 * (front - back);
        // A girth 1.3 times the throat's, as its base has, goes with about that width.
        let width = |y: f64| trunk.reach_at(y - pelvis.y, &Vec3::x()) + trunk.reach_at(y - pelvis.y, &-Vec3::x());
        let neck_half_width = 0.5 * width(neck_base).min(1.3 * width(throat));

        // On square shoulders the neckline must still clear the cloth that lies on them beside the neck. Where shoulders are flat a width is
        // reached or not by a millimetre: what is narrower counts, too, but lower.
        let half = |y: f64| {
            [1.0, -1.0].map(|x| trunk.reach_at(y - pelvis.y, &(Vec3::x() * x))).into_iter().fold(0.0, f64::max)
        };
        let steps = ((neck_base - armpit) / STEP).max(0.0) as usize;
        let shoulder_top = (0..=steps)
            .map(|i| neck_base - STEP * i as f64)
            .map(|y| y - NARROWER * (1.8 * neck_half_width - half(y)).max(0.0))
            .fold(armpit, f64::max);
        let neck_base = neck_base.max(shoulder_top + 0.025);

        // The crotch is where the sections of the two thighs come apart from below.
        let middle = 0.5 * (hips[0].x + hips[1].x);
        let hip_height = 0.5 * (hips[0].y + hips[1].y);
        let knee = hip_height - 0.5 * (leg_length[0] + leg_length[1]) * 0.5;
        let crotch = crotch_height(body, middle, pelvis.z, hip_height, knee);
        let leg = |side: usize| {
            let axes = TubeAxes::new(hips[side], ankles[side] - hips[side], Vec3::x());
            let keep: Vec<bool> = leg_weights.iter().map(|w| w[side] > 0.5).collect();
            let whole = (hips[side].y - crotch + 0.02, leg_length[side] + 0.01);
            Tube::measure(
                ["left leg", "right leg"][side],
                &body.mesh,
                &keep,
                axes,
                whole,
                (0.0, leg_length[side] + 0.02),
            )
        };
        let legs = [leg(0)?, leg(1)?];
        Ok(Self {
            trunk,
            arms,
            legs,
            arm_length,
            leg_length,
            neck_base,
            armpit,
            waist,
            crotch,
            mid_thigh: 0.5 * (crotch + knee),
            neck_depth,
            neck_half_width,
            middle,
        })
    }
}

/// Lowest height between the legs where the surface still crosses the middle plane, going down from the hips.
fn crotch_height(body: &BodyRest, middle: f64, depth: f64, hip: f64, knee: f64) -> f64 {
    let mut low: Option<f64> = None;
    for f in 0..body.mesh.faces.len() {
        let p = body.mesh.corners(f);
        let inside = |v: &Vec3| v.y < hip + 0.05 && v.y > knee && (v.z - depth).abs() < 0.25;
        let crosses = p.iter().any(|v| v.x >= middle) && p.iter().any(|v| v.x <= middle);
        if crosses && p.iter().all(inside) {
            let y = p.iter().map(|v| v.y).fold(f64::INFINITY, f64::min);
            low = Some(low.map_or(y, |l| l.min(y)));
        }
    }
    // Without a surface there (an open body), the anatomical average.
    low.unwrap_or(hip - 0.1 * (hip - knee) * 2.0)
}
