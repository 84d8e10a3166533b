//! A jointed figure of tubes with SMPL-X joint names: a second, independent body model for tests.
//!
//! Shape 0 scales the whole figure by 5 % per unit, shape 1 widens it by 5 mm per unit.

use caphy_core::body::{BlendWeights, BodyDescription, BodyGradient, BodyModel, BodyParameters, Joint, PosedBody};
use caphy_core::pose::SMPLX_JOINTS;
use caphy_core::{Error, Result, Vec3};
use nalgebra::{DMatrix, Matrix3, Matrix3x4, Rotation3};

/// Joint, parent, position [m] of the left side or the middle.
const SKELETON: [(&str, &str, [f64; 3]); 14] = [
    ("pelvis", "", [0.0, 0.0, 0.0]),
    ("hip", "pelvis", [0.1, -0.05, 0.0]),
    ("knee", "hip", [0.1, -0.45, 0.0]),
    ("ankle", "knee", [0.1, -0.88, -0.01]),
    ("foot", "ankle", [0.12, -0.93, 0.12]),
    ("spine1", "pelvis", [0.0, 0.1, 0.0]),
    ("spine2", "spine1", [0.0, 0.2, 0.0]),
    ("spine3", "spine2", [0.0, 0.3, 0.0]),
    ("neck", "spine3", [0.0, 0.5, 0.0]),
    ("head", "neck", [0.0, 0.6, 0.02]),
    ("collar", "spine3", [0.04, 0.44, 0.0]),
    ("shoulder", "collar", [0.18, 0.45, 0.0]),
    ("elbow", "shoulder", [0.45, 0.45, 0.0]),
    ("wrist", "elbow", [0.70, 0.45, 0.0]),
];

/// Tube around a bone: joint, far end relative to the joint [m], half widths at its start and end [m]: across, and in z (or y
/// for a foot).
const TUBES: [(&str, [f64; 3], [f64; 2], [f64; 2]); 10] = [
    ("pelvis", [0.0, 0.1, 0.0], [0.16, 0.11], [0.15, 0.10]),
    ("spine1", [0.0, 0.1, 0.0], [0.15, 0.10], [0.16, 0.10]),
    ("spine2", [0.0, 0.1, 0.0], [0.16, 0.10], [0.17, 0.11]),
    ("spine3", [0.0, 0.18, 0.0], [0.17, 0.11], [0.13, 0.08]),
    ("head", [0.0, 0.18, 0.03], [0.06, 0.08], [0.07, 0.09]),
    ("hip", [0.0, -0.40, 0.0], [0.085, 0.085], [0.055, 0.06]),
    ("knee", [0.0, -0.43, -0.01], [0.055, 0.06], [0.035, 0.04]),
    ("ankle", [0.02, -0.02, 0.16], [0.035, 0.04], [0.04, 0.02]),
    ("shoulder", [0.27, 0.0, 0.0], [0.05, 0.05], [0.04, 0.04]),
    ("elbow", [0.25, 0.0, 0.0], [0.04, 0.04], [0.03, 0.025]),
];

/// Hand: a flat tube.
const HAND: ([f64; 3], [f64; 2], [f64; 2]) = ([0.17, 0.0, 0.0], [0.03, 0.02], [0.04, 0.01]);

/// The figure.
pub(crate) struct Figure {
    description: BodyDescription,
    joints: Vec<Vec3>,
    vertices: Vec<Vec3>,
    /// Direction in which shape 1 moves a vertex.
    outward: Vec<Vec3>,
    /// Joint whose tube a vertex is on.
    pub(crate) tube_of: Vec<usize>,
}

const WIDER: f64 = 0.005;
const TALLER: f64 = 0.05;

impl Figure {
    pub(crate) fn new() -> Self {
        let mut joints: Vec<(String, String, Vec3)> = Vec::new();
        for (name, parent, p) in SKELETON {
            if p[0] == 0.0 {
                joints.push((name.into(), parent.into(), Vec3::from(p)));
                continue;
            }
            for (side, s) in [("left", 1.0), ("right", -1.0)] {
                let parent = if SKELETON.iter().any(|j| j.0 == parent && j.2[0] == 0.0) {
                    parent.to_string()
                } else {
                    format!("{side}_{parent}")
                };
                joints.push((format!("{side}_{name}"), parent, Vec3::new(s * p[0], p[1], p[2])));
            }
        }
        // The order of SMPL-X, which puts parents first.
        joints.sort_by_key(|j| SMPLX_JOINTS.iter().position(|n| *n == j.0));
        let index = |name: &str| joints.iter().position(|j| j.0 == name);
        let mut out = Self {
            description: BodyDescription {
                name: "figure".into(),
                joints: joints
                    .iter()
                    .map(|j| Joint { name: j.0.clone(), parent: if j.1.is_empty() { None } else { index(&j.1) } })
                    .collect(),
                faces: vec![],
                vertex_count: 0,
                shape_count: 2,
                expression_count: 0,
                weights: BlendWeights::default(),
            },
            joints: joints.iter().map(|j| j.2).collect(),
            vertices: vec![],
            outward: vec![],
            tube_of: vec![],
        };
        let mut rows = Vec::new();
        let hands = [("wrist", HAND.0, HAND.1, HAND.2)];
        for (name, far, start, end) in TUBES.iter().chain(&hands) {
            for (side, s) in [("", 1.0), ("left_", 1.0), ("right_", -1.0)] {
                if let Some(j) = index(&format!("{side}{name}")) {
                    out.tube(j, Vec3::new(s * far[0], far[1], far[2]), *start, *end, &mut rows);
                }
            }
        }
        out.description.vertex_count = out.vertices.len();
        out.description.weights = BlendWeights::from_rows(rows);
        out
    }
    fn tube(&mut self, joint: usize, far: Vec3, start: [f64; 2], end: [f64; 2], rows: &mut Vec<Vec<(u16, f64)>>) {
        const AROUND: usize = 20;
        let rings = (far.norm() / 0.015).round() as usize;
        let along = far.normalize();
        let second = if along.z.abs() > 0.7 { Vec3::y() } else { Vec3::z() };
        let first = second.cross(&along).normalize();
        let second = along.cross(&first);
        let base = self.vertices.len() as u32;
        for ring in 0..=rings {
            let t = ring as f64 / rings as f64;
            let centre = self.joints[joint] + far * t;
            // A part of the parent's motion near the joint.
            let mut row = vec![(joint as u16, 1.0)];
            if let Some(p) = self.description.joints[joint].parent {
                let w = 0.5 * (1.0 - t * far.norm() / 0.05).max(0.0);
                row = vec![(p as u16, w), (joint as u16, 1.0 - w)];
            }
            for k in 0..AROUND {
                let a = std::f64::consts::TAU * k as f64 / AROUND as f64;
                let [x, z] = [0, 1].map(|i| start[i] + (end[i] - start[i]) * t);
                let out = first * (a.cos() * x) + second * (a.sin() * z);
                self.vertices.push(centre + out);
                self.outward.push(out.normalize());
                self.tube_of.push(joint);
                rows.push(row.clone());
                if ring < rings {
                    let id = |r: usize, k: usize| base + (r * AROUND + k % AROUND) as u32;
                    self.description.faces.push([id(ring, k), id(ring, k + 1), id(ring + 1, k + 1)]);
                    self.description.faces.push([id(ring, k), id(ring + 1, k + 1), id(ring + 1, k)]);
                }
            }
        }
        for (ring, t) in [(0, 0.0), (rings, 1.0)] {
            let id = self.vertices.len() as u32;
            self.vertices.push(self.joints[joint] + far * t);
            self.outward.push(if ring == 0 { -along } else { along });
            self.tube_of.push(joint);
            rows.push(vec![(joint as u16, 1.0)]);
            for k in 0..AROUND as u32 {
                let at = base + ring as u32 * AROUND as u32;
                let (a, b) = (at + k, at + (k + 1) % AROUND as u32);
                self.description.faces.push(if ring == 0 { [id, b, a] } else { [id, a, b] });
            }
        }
    }
    /// World rotation of each joint, and what the linear map from rest joints to posed joints and vertices needs.
    fn rotations(&self, p: &BodyParameters) -> Vec<Matrix3<f64>> {
        let mut world: Vec<Matrix3<f64>> = Vec::new();
        for (j, joint) in self.description.joints.iter().enumerate() {
            let local = Rotation3::from_scaled_axis(p.rotations[j]).into_inner();
            world.push(joint.parent.map_or(local, |q| world[q] * local));
        }
        world
    }
    fn posed_joints(&self, world: &[Matrix3<f64>], rest: &[Vec3]) -> Vec<Vec3> {
        let mut posed: Vec<Vec3> = Vec::new();
        for (j, joint) in self.description.joints.iter().enumerate() {
            posed.push(joint.parent.map_or(rest[j], |q| posed[q] + world[q] * (rest[j] - rest[q])));
        }
        posed
    }
    fn skin(&self, world: &[Matrix3<f64>], rest: &[Vec3], posed: &[Vec3], v: usize, x: Vec3) -> Vec3 {
        self.description.weights.row(v).map(|(j, w)| (posed[j] + world[j] * (x - rest[j])) * w).sum()
    }
    fn shaped(&self, shape: &[f64]) -> (Vec<Vec3>, Vec<Vec3>) {
        let at = |k: usize| shape.get(k).copied().unwrap_or(0.0);
        let scale = 1.0 + TALLER * at(0);
        let vertices = self.vertices.iter().zip(&self.outward).map(|(v, o)| v * scale + o * (WIDER * at(1))).collect();
        (self.joints.iter().map(|j| j * scale).collect(), vertices)
    }
    fn descends(&self, mut joint: usize, from: usize) -> bool {
        while joint != from {
            match self.description.joints[joint].parent {
                Some(p) => joint = p,
                None => return false,
            }
        }
        true
    }
}

impl BodyModel for Figure {
    fn describe(&self) -> &BodyDescription {
        &self.description
    }
    fn forward(&self, p: &BodyParameters) -> Result<PosedBody> {
        Error::check_length("rotations", self.joints.len(), p.rotations.len())?;
        let (rest, vertices) = self.shaped(&p.shape);
        let world = self.rotations(p);
        let posed = self.posed_joints(&world, &rest);
        let transforms = (0..rest.len())
            .map(|j| {
                let mut m = Matrix3x4::zeros();
                m.fixed_view_mut::<3, 3>(0, 0).copy_from(&world[j]);
                m.set_column(3, &(posed[j] - world[j] * rest[j] + p.translation));
                m
            })
            .collect();
        Ok(PosedBody {
            vertices: (0..vertices.len())
                .map(|v| {
                    let dt = p.displacement.get(v).copied().unwrap_or_else(Vec3::zeros);
                    self.skin(&world, &rest, &posed, v, vertices[v] + dt) + p.translation
                })
                .collect(),
            joints: posed.iter().map(|j| j + p.translation).collect(),
            transforms,
        })
    }
    fn vjp(&self, p: &BodyParameters, gv: &[Vec3], _gj: &[Vec3]) -> Result<BodyGradient> {
        let ids: Vec<u32> = (0..gv.len() as u32).collect();
        let rows = nalgebra::DVector::from_iterator(3 * gv.len(), gv.iter().flat_map(|g| [g.x, g.y, g.z]));
        let g = self.jacobian(p, &ids)?.tr_mul(&rows);
        let n = p.rotations.len();
        Ok(BodyGradient {
            shape: g.rows(3 + 3 * n, p.shape.len()).iter().copied().collect(),
            expression: vec![],
            rotations: (0..n).map(|j| g.fixed_rows::<3>(3 + 3 * j).into_owned()).collect(),
            translation: g.fixed_rows::<3>(0).into_owned(),
            displacement: vec![],
        })
    }
    fn jacobian(&self, p: &BodyParameters, ids: &[u32]) -> Result<DMatrix<f64>> {
        let (rest, vertices) = self.shaped(&p.shape);
        let world = self.rotations(p);
        let posed = self.posed_joints(&world, &rest);
        let n = rest.len();
        let mut out = DMatrix::zeros(3 * ids.len(), 3 + 3 * n + p.shape.len());
        // World axis about which component k of joint j turns: parent's rotation times the left Jacobian.
        let axes: Vec<Matrix3<f64>> = (0..n)
            .map(|j| {
                let (t, r) = (p.rotations[j].norm(), p.rotations[j].cross_matrix());
                let left = if t < 1e-6 {
                    Matrix3::identity() + r * 0.5
                } else {
                    Matrix3::identity() + r * ((1.0 - t.cos()) / (t * t)) + r * r * ((t - t.sin()) / (t * t * t))
                };
                self.description.joints[j].parent.map_or(left, |q| world[q] * left)
            })
            .collect();
        let ancestors: Vec<Vec<usize>> =
            (0..n).map(|part| (0..n).filter(|&j| self.descends(part, j)).collect()).collect();
        // Posing is linear in rest joints and vertices: shape 0 moves both, shape 1 vertices only.
        let taller: Vec<Vec3> = self.joints.iter().map(|j| j * TALLER).collect();
        let unmoved = vec![Vec3::zeros(); n];
        let posed_taller = self.posed_joints(&world, &taller);
        for (i, &v) in ids.iter().enumerate() {
            let v = v as usize;
            for a in 0..3 {
                out[(3 * i + a, a)] = 1.0;
            }
            for (part, w) in self.description.weights.row(v) {
                let at = posed[part] + world[part] * (vertices[v] - rest[part]);
                for &j in &ancestors[part] {
                    for k in 0..3 {
                        let d: Vec3 = axes[j].column(k).cross(&(at - posed[j])) * w;
                        (0..3).for_each(|a| out[(3 * i + a, 3 + 3 * j + k)] += d[a]);
                    }
                }
            }
            for k in 0..p.shape.len() {
                let d = if k == 0 {
                    self.skin(&world, &taller, &posed_taller, v, self.vertices[v] * TALLER)
                } else {
                    self.skin(&world, &unmoved, &unmoved, v, self.outward[v] * WIDER)
                };
                (0..3).for_each(|a| out[(3 * i + a, 3 + 3 * n + k)] = d[a]);
            }
        }
        Ok(out)
    }
}
