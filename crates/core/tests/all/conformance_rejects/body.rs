//! Faulty bodies around a correct one: a stick of two joints and eight vertices.

use super::table::{TABLE, read, write};
use caphy_core::body::{
    BlendWeights, BodyDescription, BodyGradient, BodyModel, BodyParameters, Joint, PosedBody, PosedSkeleton,
    SurfacePoint,
};
use caphy_core::conformance::body::{BodySubject, CHECKS};
use caphy_core::lanes::Frames;
use caphy_core::{Error, Result, Vec3};
use nalgebra::{DMatrix, Matrix3, Matrix3x4, Rotation3};
use std::thread::ThreadId;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Fault {
    None,
    AnotherTableWrittenBack,
    UnknownKeysTaken,
    JointsOfOneName,
    FaceOnALine,
    WeightsBelowOne,
    TransformsShifted,
    HalfTheTranslation,
    RootTurnsAboutTheOrigin,
    DisplacementMovesJoints,
    MissingCoefficientsAreOnes,
    NoChecks,
    GradientHalved,
    JacobianDoubled,
    FramesShifted,
    SkeletonShifted,
    LandmarkOffTheSurface,
    NoHalfTurns,
    ThreadMatters,
}

struct Stick {
    description: BodyDescription,
    landmarks: Vec<String>,
    fault: Fault,
    made_on: ThreadId,
    size: f64,
}

/// Share of the second joint in each vertex.
fn share(vertex: usize) -> f64 {
    vertex as f64 / 7.0
}

impl Stick {
    fn is(&self, fault: Fault) -> bool {
        self.fault == fault
    }
    fn check(&self, p: &BodyParameters) -> Result<()> {
        if p.shape.len() > 3 {
            return Err(Error::Length { what: "shape".into(), expected: 3, got: p.shape.len() });
        }
        Error::check_length("expression", 0, p.expression.len())?;
        Error::check_length("rotations", 2, p.rotations.len())?;
        if !p.displacement.is_empty() {
            Error::check_length("displacement", 8, p.displacement.len())?;
        }
        for (what, values) in [("rotations", &p.rotations), ("displacement", &p.displacement)] {
            let flat: Vec<f64> = values.iter().flatten().copied().collect();
            Error::check_finite(what, &flat)?;
        }
        Error::check_finite("translation", p.translation.as_slice())
    }
    fn pose(&self, p: &BodyParameters) -> PosedBody {
        let beta = |i: usize| {
            let missing = if self.is(Fault::MissingCoefficientsAreOnes) { 1.0 } else { 0.0 };
            p.shape.get(i).copied().unwrap_or(missing)
        };
        let length = self.size * (1.0 + 0.1 * beta(0)) + 0.05 * beta(2);
        let rest: Vec<Vec3> = (0..8)
            .map(|v| {
                let around = v as f64 * 2.4;
                let radius = 0.1 + 0.01 * beta(1);
                let at = Vec3::new(radius * around.cos(), length * share(v), radius * around.sin());
                at + p.displacement.get(v).copied().unwrap_or_default()
            })
            .collect();
        let moved = match p.displacement.first() {
            Some(d) if self.is(Fault::DisplacementMovesJoints) => *d,
            _ => Vec3::zeros(),
        };
        let joints = [Vec3::new(0.02, 0.1 * length, 0.0) + moved, Vec3::new(0.0, 0.6 * length, 0.01) + moved];
        let about = |r: &Vec3, centre: Vec3| {
            let r =
                if self.is(Fault::NoHalfTurns) && r.norm() > std::f64::consts::PI - 1e-4 { r * f64::NAN } else { *r };
            let m: Matrix3<f64> = Rotation3::new(r).into_inner();
            (m, centre - m * centre)
        };
        let pivot = if self.is(Fault::RootTurnsAboutTheOrigin) { Vec3::zeros() } else { joints[0] };
        let (m0, t0) = about(&p.rotations[0], pivot);
        let (m1, t1) = about(&p.rotations[1], joints[1]);
        // The second joint hangs on the first.
        let bones = [(m0, t0), (m0 * m1, m0 * t1 + t0)];
        let translation = p.translation;
        let halved = if self.is(Fault::HalfTheTranslation) { 0.5 } else { 1.0 };
        let elsewhere = self.is(Fault::ThreadMatters) && std::thread::current().id() != self.made_on;
        let bump = Vec3::new(if elsewhere { 1e-12 } else { 0.0 }, 0.0, 0.0);
        let vertices = rest.iter().enumerate().map(|(v, x)| {
            let [a, b] = bones.map(|(m, t)| m * x + t);
            a * (1.0 - share(v)) + b * share(v) + translation * halved + bump
        });
        let shift = if self.is(Fault::TransformsShifted) { Vec3::new(1e-3, 0.0, 0.0) } else { Vec3::zeros() };
        let transforms = bones.map(|(m, t)| {
            let t = t + translation + shift;
            Matrix3x4::from_columns(&[m.column(0).into(), m.column(1).into(), m.column(2).into(), t])
        });
        PosedBody {
            vertices: vertices.collect(),
            joints: vec![m0 * joints[0] + t0 + translation, m0 * joints[1] + t0 + translation],
            transforms: transforms.to_vec(),
        }
    }
}

impl BodyModel for Stick {
    fn describe(&self) -> &BodyDescription {
        &self.description
    }
    fn forward(&self, parameters: &BodyParameters) -> Result<PosedBody> {
        if !self.is(Fault::NoChecks) {
            self.check(parameters)?;
        }
        Ok(self.pose(parameters))
    }
    /// By differences: exact enough for a reference, and right by construction.
    fn vjp(&self, parameters: &BodyParameters, gv: &[Vec3], gj: &[Vec3]) -> Result<BodyGradient> {
        self.check(parameters)?;
        for (what, given, count) in [("vertex cotangents", gv, 8), ("joint cotangents", gj, 2)] {
            if !given.is_empty() {
                Error::check_length(what, count, given.len())?;
            }
        }
        let loss = |p: &BodyParameters| {
            let out = self.pose(p);
            let dot = |a: &[Vec3], b: &[Vec3]| a.iter().zip(b).map(|(a, b)| a.dot(b)).sum::<f64>();
            dot(&out.vertices, gv) + dot(&out.joints, gj)
        };
        let slope = |change: &dyn Fn(&mut BodyParameters, f64)| {
            let shifted = |h: f64| {
                let mut p = parameters.clone();
                change(&mut p, h);
                loss(&p)
            };
            (shifted(1e-5) - shifted(-1e-5)) / 2e-5
        };
        let vector = |change: &dyn Fn(&mut BodyParameters, usize, f64)| {
            Vec3::from_fn(|axis, _| slope(&|p: &mut BodyParameters, h| change(p, axis, h)))
        };
        let mut rotations: Vec<Vec3> =
            (0..2).map(|j| vector(&|p: &mut BodyParameters, axis, h| p.rotations[j][axis] += h)).collect();
        if self.is(Fault::GradientHalved) {
            rotations[1] *= 0.5;
        }
        Ok(BodyGradient {
            shape: (0..parameters.shape.len()).map(|i| slope(&|p: &mut BodyParameters, h| p.shape[i] += h)).collect(),
            expression: Vec::new(),
            rotations,
            translation: vector(&|p: &mut BodyParameters, axis, h| p.translation[axis] += h),
            displacement: (0..8)
                .map(|v| {
                    vector(&|p: &mut BodyParameters, axis, h| {
                        p.displacement.resize(8, Vec3::zeros());
                        p.displacement[v][axis] += h;
                    })
                })
                .collect(),
        })
    }
    fn jacobian(&self, parameters: &BodyParameters, vertices: &[u32]) -> Result<DMatrix<f64>> {
        // The default, through a body without this fault.
        let plain = stick(if self.is(Fault::JacobianDoubled) { Fault::None } else { self.fault }, self.size);
        let rows: Vec<nalgebra::RowDVector<f64>> = vertices
            .iter()
            .flat_map(|v| (0..3).map(move |axis| (*v, axis)))
            .map(|(v, axis)| {
                let mut cotangents = vec![Vec3::zeros(); 8];
                cotangents[v as usize][axis] = 1.0;
                let g = plain.vjp(parameters, &cotangents, &[])?;
                let flat = g.translation.iter().chain(g.rotations.iter().flatten()).chain(&g.shape).copied();
                Ok(nalgebra::RowDVector::from_iterator(9 + g.shape.len(), flat))
            })
            .collect::<Result<_>>()?;
        let matrix = DMatrix::from_rows(&rows);
        Ok(if self.is(Fault::JacobianDoubled) { matrix * 2.0 } else { matrix })
    }
    fn skeleton(&self, parameters: &BodyParameters) -> Result<PosedSkeleton> {
        let mut posed = self.forward(parameters)?;
        if self.is(Fault::SkeletonShifted) {
            posed.joints[1].x += 1e-3;
        }
        Ok(PosedSkeleton { joints: posed.joints, transforms: posed.transforms })
    }
    fn landmark_names(&self) -> &[String] {
        &self.landmarks
    }
    fn landmarks(&self, rotations: &[Vec3]) -> Result<Vec<SurfacePoint>> {
        Error::check_length("rotations", 2, rotations.len())?;
        let last = if self.is(Fault::LandmarkOffTheSurface) { 0.6 } else { 0.5 };
        Ok(vec![SurfacePoint::vertex(7), SurfacePoint { vertices: [0, 1, 2], weights: [0.25, 0.25, last] }])
    }
    fn forward_frames(&self, frames: &[BodyParameters], subset: Option<&[u32]>, out: &mut Frames<f32>) -> Result<()> {
        let lanes = out.lanes_used();
        let shift = if self.is(Fault::FramesShifted) { Vec3::new(1e-3, 0.0, 0.0) } else { Vec3::zeros() };
        for (i, p) in frames.iter().enumerate() {
            let all = self.forward(p)?.vertices;
            let ids: Vec<u32> = subset.map_or_else(|| (0..8).collect(), <[u32]>::to_vec);
            let points: Vec<Vec3> = ids.iter().map(|&id| all[id as usize] + shift).collect();
            out.set_frame(i / lanes, i % lanes, &points)?;
        }
        Ok(())
    }
}

fn stick(fault: Fault, size: f64) -> Stick {
    let joint = |name: &str, parent| Joint { name: name.into(), parent };
    let second = if fault == Fault::JointsOfOneName { "root" } else { "tip" };
    let mut faces: Vec<[u32; 3]> = (0..6).map(|v| [v, v + 1, v + 2]).collect();
    if fault == Fault::FaceOnALine {
        faces[3] = [3, 3, 4];
    }
    let lost = if fault == Fault::WeightsBelowOne { 0.1 } else { 0.0 };
    let row = |v: usize| vec![(0, 1.0 - share(v)), (1, (share(v) - lost).max(0.0))];
    let description = BodyDescription {
        name: "small".into(),
        joints: vec![joint("root", None), joint(second, Some(0))],
        faces,
        vertex_count: 8,
        shape_count: 3,
        expression_count: 0,
        weights: BlendWeights::from_rows((0..8).map(row)),
    };
    Stick {
        description,
        landmarks: vec!["top".into(), "side".into()],
        fault,
        made_on: std::thread::current().id(),
        size,
    }
}

fn subject(fault: Fault) -> BodySubject {
    let create = move |text: &str| -> Result<Box<dyn BodyModel>> {
        Ok(Box::new(stick(fault, read(text, fault == Fault::UnknownKeysTaken)?)))
    };
    let normalise = move |text: &str| write(text, fault == Fault::AnotherTableWrittenBack);
    BodySubject { toml: TABLE.into(), create: Box::new(create), normalise: Some(Box::new(normalise)) }
}

/// Faults and the checks that reject them.
fn faults() -> Vec<(Fault, Vec<&'static str>)> {
    vec![
        (Fault::AnotherTableWrittenBack, vec!["table_survives_a_round_trip"]),
        (Fault::UnknownKeysTaken, vec!["unknown_keys_are_refused"]),
        (Fault::JointsOfOneName, vec!["skeleton_is_a_tree"]),
        (Fault::FaceOnALine, vec!["surface_is_sound"]),
        (Fault::WeightsBelowOne, vec!["weights_sum_to_one"]),
        (Fault::TransformsShifted, vec!["rest_is_the_identity"]),
        (Fault::HalfTheTranslation, vec!["translation_comes_last"]),
        (Fault::RootTurnsAboutTheOrigin, vec!["the_root_turns_everything"]),
        (Fault::DisplacementMovesJoints, vec!["displacements_add_in_the_rest_pose"]),
        (Fault::MissingCoefficientsAreOnes, vec!["missing_coefficients_are_zeros"]),
        (Fault::NoChecks, vec!["wrong_counts_are_refused"]),
        (Fault::GradientHalved, vec!["gradients_agree_with_differences"]),
        (Fault::JacobianDoubled, vec!["the_jacobian_is_made_of_products"]),
        (Fault::FramesShifted, vec!["frames_agree_with_poses"]),
        (Fault::SkeletonShifted, vec!["skeleton_agrees_with_poses"]),
        (Fault::LandmarkOffTheSurface, vec!["landmarks_ride_on_the_surface"]),
        (Fault::NoHalfTurns, vec!["extremes_are_finite"]),
        (Fault::ThreadMatters, vec!["threads_change_nothing"]),
    ]
}

#[test]
fn a_correct_body_passes() {
    super::assert_accepted(CHECKS, &subject(Fault::None), &[]);
}

#[test]
fn each_fault_is_rejected_by_its_check() {
    for (fault, expected) in faults() {
        super::assert_rejected(CHECKS, &format!("{fault:?}"), &subject(fault), &expected);
    }
    let sets: Vec<Vec<&str>> = faults().into_iter().map(|f| f.1).collect();
    super::assert_covered(CHECKS, &sets);
}
