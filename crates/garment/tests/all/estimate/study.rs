//! The study's case: a 0.3 m cloth of 441 vertices that hangs, sticks out and drapes.

use caphy_core::Vec3;
use caphy_core::material::{MaterialModel, MaterialSpec};
use caphy_garment::GarmentRest;
use caphy_garment::estimate::{Capture, CutPart, Problem, ScanPoints, Surroundings, cloth};
use caphy_garment::solver::{Forces, Obstacle, Scene, Solver, SolverSettings};
use caphy_materials::MaterialMeasuredSpec;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::sync::Arc;

/// Side of the cloth [m] and cells along it.
pub(crate) const SIDE: f64 = 0.3;

pub(crate) fn fabric(name: &str) -> Arc<dyn MaterialModel> {
    Arc::from(MaterialMeasuredSpec::new(name).build().unwrap())
}

pub(crate) fn scaled(material: &Arc<dyn MaterialModel>, factor: f64) -> Arc<dyn MaterialModel> {
    let values: Vec<f64> = material.parameters().iter().map(|p| p.value * factor).collect();
    Arc::from(material.with_parameters(&values).unwrap())
}

/// Standard normal numbers.
pub(crate) struct Normal(ChaCha8Rng);

impl Normal {
    pub(crate) fn new(seed: u64) -> Self {
        Self(ChaCha8Rng::seed_from_u64(seed))
    }
    pub(crate) fn next(&mut self) -> f64 {
        let (u, v): (f64, f64) = (self.0.random_range(1e-300..1.0), self.0.random_range(0.0..std::f64::consts::TAU));
        (-2.0 * u.ln()).sqrt() * v.cos()
    }
    pub(crate) fn shaken(&mut self, points: &[Vec3], size: f64) -> Vec<Vec3> {
        points.iter().map(|p| p + size * Vec3::new(self.next(), self.next(), self.next())).collect()
    }
}

/// A way to hold the cloth: how it is laid out, which vertices are clamped, what it lies on.
pub(crate) struct Setup {
    pub(crate) name: &'static str,
    pub(crate) start: Vec<Vec3>,
    pub(crate) fixed: Vec<u32>,
    pub(crate) body: Option<Surroundings>,
}

fn clamped(rest: &GarmentRest, inside: impl Fn(&Vec3) -> bool) -> Vec<u32> {
    (0..rest.vertex_count() as u32).filter(|&v| inside(&rest.template.vertices[v as usize])).collect()
}

/// Hangs, cantilevers and a drape over a sphere, without or with contact.
pub(crate) fn setups(rest: &GarmentRest, contact: bool) -> Vec<Setup> {
    let flat = &rest.template.vertices;
    let edge = 1e-9;
    let ripple = |p: &Vec3| 2e-3 * (31.0 * p.x + 17.0 * p.y).sin();
    let upright = |narrow: f64| -> Vec<Vec3> {
        // A slight bow, so that the cloth folds one way.
        flat.iter()
            .map(|p| {
                let s = p.x / SIDE - 0.5;
                Vec3::new(
                    0.5 * SIDE + narrow * (p.x - 0.5 * SIDE),
                    p.y,
                    ripple(p) + (1.0 - narrow) * 0.5 * SIDE * (1.0 - 4.0 * s * s),
                )
            })
            .collect()
    };
    let level =
        || -> Vec<Vec3> { flat.iter().map(|p| Vec3::new(p.x, ripple(p) * p.x * p.y / SIDE / SIDE, -p.y)).collect() };
    let pin = |shape: Vec<Vec3>, fixed: &[u32], to: &dyn Fn(&Vec3) -> Vec3| -> Vec<Vec3> {
        let mut shape = shape;
        fixed.iter().for_each(|&v| shape[v as usize] = to(&flat[v as usize]));
        shape
    };
    let corners = clamped(rest, |p| p.y > SIDE - edge && (p.x < edge || p.x > SIDE - edge));
    let side = clamped(rest, |p| p.x > SIDE - edge && (p.y < edge || p.y > SIDE - edge));
    let mut out = vec![
        Setup {
            name: "hang by two corners",
            start: pin(upright(0.88), &corners, &|p| Vec3::new(0.5 * SIDE + 0.88 * (p.x - 0.5 * SIDE), p.y, 0.0)),
            fixed: corners,
            body: None,
        },
        Setup {
            name: "stick out along u",
            start: pin(level(), &[], &|p| *p),
            fixed: clamped(rest, |p| p.x < 0.151),
            body: None,
        },
        Setup {
            name: "stick out along v",
            start: pin(level(), &[], &|p| *p),
            fixed: clamped(rest, |p| p.y < 0.151),
            body: None,
        },
        Setup {
            name: "hang by the side",
            start: {
                let turned: Vec<Vec3> = upright(1.0)
                    .iter()
                    .zip(flat)
                    .map(|(p, f)| {
                        let s = f.y / SIDE - 0.5;
                        Vec3::new(0.92 * (f.y - 0.15), f.x, p.z + 0.02 * (1.0 - 4.0 * s * s))
                    })
                    .collect();
                pin(turned, &side, &|f| Vec3::new(0.92 * (f.y - 0.15), f.x, 0.0))
            },
            fixed: side,
            body: None,
        },
    ];
    if contact {
        let middle = clamped(rest, |p| (p - Vec3::new(0.15, 0.15, 0.0)).norm() < 0.016);
        let over: Vec<Vec3> =
            flat.iter().map(|p| Vec3::new(p.x - 0.15, 0.0018 + ripple(p).abs() * 0.5, 0.15 - p.y)).collect();
        out.push(Setup {
            name: "over a sphere",
            start: pin(over, &middle, &|p| Vec3::new(p.x - 0.15, 0.0018, 0.15 - p.y)),
            fixed: middle,
            body: Some(cloth::sphere(Vec3::new(0.0, -0.08, 0.0), 0.08, 3e-3).unwrap()),
        });
    } else {
        let diagonal = clamped(rest, |p| p.x + p.y < 0.301);
        out.push(Setup { name: "stick out askew", start: pin(level(), &[], &|p| *p), fixed: diagonal, body: None });
    }
    out
}

/// The cloth at rest in a setup.
pub(crate) fn at_rest(
    rest: &GarmentRest,
    material: &Arc<dyn MaterialModel>,
    setup: &Setup,
    settings: SolverSettings,
) -> Vec<Vec3> {
    let mut solver = Solver::new(rest, material.clone(), Forces::default(), settings).unwrap();
    let scene = Scene {
        body: setup.body.as_ref().map(|b| Obstacle {
            positions: &b.positions,
            normals: &b.normals,
            before: None,
            search: None,
        }),
        fixed: &setup.fixed,
        anchors: Some(&setup.start),
        ..Default::default()
    };
    let solution = solver.solve(&scene, &setup.start, &|_| {}).unwrap();
    let r = &solution.report;
    eprintln!("{}: {:?} {} steps {:.1e} N", setup.name, r.outcome, r.iterations, r.residual_n);
    solution.positions
}

/// A problem whose scans are equilibria of `truth`, with Gaussian noise of `noise` on every coordinate, to be fitted from `begin`.
pub(crate) fn problem(
    rest: &GarmentRest,
    setups: &[Setup],
    shapes: &[Vec<Vec3>],
    begin: Arc<dyn MaterialModel>,
    noise: f64,
    seed: u64,
    settings: SolverSettings,
) -> Problem {
    let mut random = Normal::new(seed);
    let captures = setups
        .iter()
        .zip(shapes)
        .map(|(setup, shape)| {
            let points = random.shaken(shape, noise);
            let mut start = points.clone();
            setup.fixed.iter().for_each(|&v| start[v as usize] = shape[v as usize]);
            Capture {
                name: setup.name.into(),
                start,
                fixed: setup.fixed.clone(),
                targets: Vec::new(),
                body: setup.body.clone(),
                scan: ScanPoints::Known { vertices: (0..shape.len() as u32).collect(), points },
                blends: Vec::new(),
                anchors: Some(setup.start.clone()),
                worn: None,
                sigma_m: (noise == 0.0).then_some(1e-6),
            }
        })
        .collect();
    Problem {
        rest: rest.clone(),
        material: begin,
        forces: Forces::default(),
        solver: settings,
        captures,
        weighed: true,
        parts: CutPart::whole(rest.faces().len()),
    }
}

/// Noise of the study's scans [m].
pub(crate) const NOISE_M: f64 = 5e-4;

/// A fabric in its five poses.
pub(crate) struct Case {
    pub(crate) name: String,
    pub(crate) truth: Arc<dyn MaterialModel>,
    pub(crate) rest: GarmentRest,
    pub(crate) setups: Vec<Setup>,
    pub(crate) shapes: Vec<Vec<Vec3>>,
}

impl Case {
    pub(crate) fn new(name: &str, contact: bool) -> Self {
        Self::solved(name, contact, 1e-9)
    }
    /// Equilibria whose forces are below a tolerance [N].
    pub(crate) fn solved(name: &str, contact: bool, tolerance_n: f64) -> Self {
        Self { name: name.into(), ..Self::cut(fabric(name), 20, contact, tolerance_n) }
    }
    /// Of any fabric and fineness.
    pub(crate) fn cut(truth: Arc<dyn MaterialModel>, cells: usize, contact: bool, tolerance_n: f64) -> Self {
        let rest = cloth::sheet(cells, cells, [SIDE, SIDE], truth.describe().density.unwrap().0).unwrap();
        let setups = setups(&rest, contact);
        let settings = SolverSettings { tolerance_n, ..Default::default() };
        let shapes = setups.iter().map(|s| at_rest(&rest, &truth, s, settings)).collect();
        Self { name: truth.describe().name, truth, rest, setups, shapes }
    }
    pub(crate) fn problem(&self, begin: Arc<dyn MaterialModel>, noise: f64, seed: u64) -> Problem {
        let settings = SolverSettings { tolerance_n: 1e-9, ..Default::default() };
        problem(&self.rest, &self.setups, &self.shapes, begin, noise, seed, settings)
    }
    /// Estimated over true, per group.
    pub(crate) fn ratios(&self, parameters: &[f64]) -> Vec<f64> {
        let truth = self.truth.parameters();
        caphy_garment::estimate::reduction::groups(&*self.truth)
            .iter()
            .map(|g| {
                let sum = |of: &dyn Fn(usize) -> f64| g.members.iter().map(|&i| of(i)).sum::<f64>();
                sum(&|i| parameters[i]) / sum(&|i| truth[i].value)
            })
            .collect()
    }
}
