//! A subject's garment in the poses of its scans, as a problem for the fabric estimators.

use crate::garment::FittedGarment;
use crate::inference::{Play, play};
use crate::physics::solver_forces;
use crate::scene::{Scene, label_of, outer, scan_frames};
use crate::simulate::joined;
use crate::stage::preprocess::{Subject, SubjectScan};
use crate::stage::scans::read_framed;
use crate::stage::train::Nets;
use crate::stage::{Context, Scans};
use crate::track::BodyTrack;
use caphy_core::lanes::Frames;
use caphy_core::material::MaterialModel;
use caphy_core::pose::Pose;
use caphy_core::{Error, Result, Vec3, mesh};
use caphy_garment::estimate::equilibrium::held_shapes;
use caphy_garment::estimate::{Capture, Problem, ScanPoints, Surroundings};
use caphy_garment::solver::{Solver, SolverSettings};
use caphy_garment::template::GarmentKind;
use std::sync::Arc;

/// λ of the springs that put a garment on its scan before a fit, in weights of a vertex per mm.
const ATTACHED: f64 = 0.3;
/// Force that may be left while it is put there, as a share of a vertex's weight: it only is a start.
const ROUGHLY: f64 = 0.02;

/// The garments of a subject where its scans are.
pub(crate) struct Wardrobe<'a> {
    context: &'a Context<'a>,
    subject: &'a Subject,
    scans: &'a Scans,
    scene: Scene,
    /// The scans that take part, and their bodies.
    chosen: Vec<&'a SubjectScan>,
    track: BodyTrack,
    /// Vertices as the nets have them [m], shape [garment][pose][vertex].
    worn: Vec<Vec<Vec<Vec3>>>,
}

impl<'a> Wardrobe<'a> {
    /// In at most `most` training scans, those whose poses differ most.
    ///
    /// # Errors
    /// [`Error::Config`] without a training scan; those of body and nets.
    pub(crate) fn new(
        context: &'a Context<'a>,
        subject: &'a Subject,
        nets: &Nets,
        scans: &'a Scans,
        most: usize,
    ) -> Result<Self> {
        let all: Vec<&SubjectScan> = subject.training_scans().collect();
        let poses: Vec<&Pose> = all.iter().map(|s| &s.pose).collect();
        let chosen: Vec<&SubjectScan> = spread(&poses, most).into_iter().map(|i| all[i]).collect();
        if chosen.is_empty() {
            return Err(Error::config("subject", "there is no training scan", "hold out fewer scans"));
        }
        let scene = Scene::new(context, subject)?;
        let poses: Vec<Pose> = chosen.iter().map(|s| s.pose.clone()).collect();
        let track = scene.track(&poses)?;
        let spec = &context.config.net;
        let worn = subject
            .garments
            .iter()
            .zip(&nets.garments)
            .map(|(fitted, trained)| play(fitted, trained, spec, &track, Play::Poses))
            .collect::<Result<_>>()?;
        Ok(Self { context, subject, scans, scene, chosen, track, worn })
    }

    /// Vertices of a garment as its net has them [m], shape [pose][vertex].
    pub(crate) fn shapes(&self, garment: usize) -> &[Vec<Vec3>] {
        &self.worn[garment]
    }

    /// The problem of one garment made of a material, each pose starting from the net's shape.
    ///
    /// # Errors
    /// As [`FittedGarment::rest`], those of scans and solver.
    pub(crate) fn problem(
        &self,
        garment: usize,
        material: Arc<dyn MaterialModel>,
        solver: SolverSettings,
    ) -> Result<Problem> {
        let fitted = &self.subject.garments[garment];
        let rest = fitted.rest(&*material)?;
        let forces = solver_forces(&self.context.config.train);
        // Which vertices a solver holds follows from the rest state alone.
        let held = Solver::new(&rest, material.clone(), forces, solver)?.held_vertices().to_vec();
        let visible = scan_frames(self.context, self.subject, fitted, self.scene.scan_track(self.subject)?)?.visible;
        let under = self.under(fitted.kind);
        let map = self.scene.contact(fitted)?;
        let map = Arc::new(match under {
            Some(inner) => map.with_obstacle(self.subject.garments[inner].mesh.vertices.len()),
            None => map,
        });
        let mut captures = Vec::new();
        for (i, scan) in self.chosen.iter().enumerate() {
            let (mut positions, mut normals) = self.track.gather::<f64>(&[i], 1)?;
            if let Some(inner) = under {
                let (at, towards) = surface(&self.subject.garments[inner], &self.worn[inner][i])?;
                positions = joined(&positions, &at);
                normals = joined(&normals, &towards);
            }
            let transforms = self.track.transforms(&[i])[0];
            let skinned = fitted.skinned(transforms)?;
            let map = map.clone();
            captures.push(Capture {
                name: scan.name.clone(),
                start: self.worn[garment][i].clone(),
                fixed: Vec::new(),
                targets: held.iter().map(|&v| skinned[v as usize]).collect(),
                body: Some(Surroundings {
                    positions,
                    normals,
                    search: Some(Arc::new(move |x, body| map.nearest(x, body))),
                }),
                blends: (0..skinned.len())
                    .map(|v| fitted.weights.blend(v, transforms).fixed_columns::<3>(0).into_owned())
                    .collect(),
                scan: self.points(scan, fitted.kind, &visible)?,
                anchors: None,
                sigma_m: None,
            });
        }
        Ok(Problem { rest, material, forces, solver, captures, weighed: fitted.mass_kg.is_some() })
    }

    /// The same with each pose put on its scan: where friction then holds it is where it was seen.
    ///
    /// # Errors
    /// As [`held_shapes`].
    pub(crate) fn attached(&self, mut problem: Problem) -> Result<Problem> {
        let weight = problem.rest.mass() * problem.forces.gravity.norm() / problem.rest.vertex_count() as f64;
        let loose = SolverSettings {
            friction: 0.0,
            tolerance_n: (ROUGHLY * weight).max(problem.solver.tolerance_n),
            ..problem.solver
        };
        let placing = Problem { solver: loose, ..problem.clone() };
        let start: Vec<Vec<Vec3>> = problem.captures.iter().map(|c| c.start.clone()).collect();
        let placed = held_shapes(&placing, &problem.material, &start, ATTACHED)?;
        problem.captures.iter_mut().zip(placed).for_each(|(c, x)| c.start = x);
        Ok(problem)
    }

    /// The garment that lies under another, where there are two.
    fn under(&self, kind: GarmentKind) -> Option<usize> {
        (kind == outer(self.context.config.finetune.layering.order))
            .then(|| self.subject.garments.iter().position(|g| g.kind != kind))
            .flatten()
    }

    /// What a scan shows of a garment.
    fn points(&self, scan: &SubjectScan, kind: GarmentKind, visible: &[bool]) -> Result<ScanPoints> {
        let file = self.scans.list.iter().find(|f| f.name == scan.name).ok_or_else(|| {
            Error::config(
                "subject",
                format!("scan {} is not there any more", scan.name),
                "put it back, or preprocess anew",
            )
        })?;
        let whole = read_framed(self.context.files, file, &scan.frame)?.mesh;
        Error::check_length(&format!("labels of scan {}", scan.name), whole.vertices.len(), scan.points.labels.len())?;
        let own: Vec<bool> = scan.points.labels.iter().map(|l| *l == label_of(kind)).collect();
        let (mesh, _) = whole.submesh(&own);
        Ok(ScanPoints::Surface { points: mesh.vertices, faces: mesh.faces, visible: Some(visible.to_vec()) })
    }
}

/// A garment as something to lie on: vertices and outward unit normals.
fn surface(garment: &FittedGarment, shape: &[Vec3]) -> Result<(Frames<f64>, Frames<f64>)> {
    let frame = |values: &[Vec3]| -> Result<Frames<f64>> {
        let mut out = Frames::zeros(1, values.len(), 1);
        out.set_frame(0, 0, values)?;
        Ok(out)
    };
    Ok((frame(shape)?, frame(&mesh::vertex_normals(shape, &garment.mesh.faces))?))
}

/// At most `most` poses that differ most: the first, then always the one farthest from those taken; in their order.
fn spread(poses: &[&Pose], most: usize) -> Vec<usize> {
    let distance = |a: &Pose, b: &Pose| -> f64 {
        a.rotations.iter().zip(&b.rotations).skip(1).map(|(a, b)| (a - b).norm_squared()).sum()
    };
    let mut taken: Vec<usize> = Vec::new();
    while taken.len() < most.min(poses.len()) {
        let apart = |i: usize| taken.iter().map(|&t| distance(poses[i], poses[t])).fold(f64::INFINITY, f64::min);
        let next = (0..poses.len())
            .filter(|i| !taken.contains(i))
            .max_by(|&a, &b| apart(a).total_cmp(&apart(b)).then(b.cmp(&a)));
        taken.extend(next);
    }
    taken.sort_unstable();
    taken
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_poses_that_differ_most_are_taken() {
        let pose = |angle: f64| Pose {
            rotations: vec![Vec3::zeros(), Vec3::new(angle, 0.0, 0.0)],
            translation: Vec3::zeros(),
        };
        let all: Vec<Pose> = [0.0, 0.1, 1.0, 0.9, -0.5].into_iter().map(pose).collect();
        let all: Vec<&Pose> = all.iter().collect();
        assert_eq!(spread(&all, 3), vec![0, 2, 4]);
        assert_eq!(spread(&all, 9), vec![0, 1, 2, 3, 4]);
        assert!(spread(&[], 3).is_empty());
    }
}
