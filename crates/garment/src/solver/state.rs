//! What stays put while forces are balanced: the scene in the layout of the energies, contact pairs, friction.

use super::Solver;
use super::scene::Scene;
use super::settings::out_of_bounds;
use crate::energy::{
    Attachment, BodyState, EnergyTangent, Friction, Inertia, InertiaRule, State, Tangent, nearest_body_vertices,
};
use caphy_core::lanes::Frames;
use caphy_core::{Error, Real, Result, Vec3};

const LANES: usize = <f64 as Real>::LANES;

/// Contact pairs and friction of one round.
#[derive(Debug, Clone)]
pub(super) struct Frozen {
    /// Nearest body vertex, `[garment vertex][lane]`.
    pub(super) nearest: Option<Vec<u32>>,
    pub(super) friction: Friction,
}

/// A scene in the layout of the energies.
pub(super) struct Prepared<'a> {
    pub(super) scene: &'a Scene<'a>,
    targets: Option<Frames<f64>>,
    springs: Option<Frames<f64>>,
    momentum: Option<(Attachment<f64>, Frames<f64>)>,
    /// Vertices that do not move.
    pub(super) fixed: Vec<bool>,
}

/// One frame.
pub(super) fn frame_of(points: &[Vec3]) -> Result<Frames<f64>> {
    let mut frames = Frames::zeros(1, points.len(), 1);
    frames.set_frame(0, 0, points)?;
    Ok(frames)
}

pub(super) fn points_of(x: &[f64]) -> Vec<Vec3> {
    x.chunks_exact(3).map(|p| Vec3::new(p[0], p[1], p[2])).collect()
}

fn fill(frames: &mut Frames<f64>, x: &[f64]) {
    for (row, value) in frames.data_mut().chunks_exact_mut(LANES).zip(x) {
        row.fill(*value);
    }
}

impl<'a> Prepared<'a> {
    pub(super) fn new(solver: &Solver, scene: &'a Scene<'a>) -> Result<Self> {
        let n = solver.vertex_count();
        let held = solver.held_vertices();
        let targets = match scene.targets {
            Some(targets) => {
                Error::check_length("targets of held vertices", held.len(), targets.len())?;
                Some(frame_of(targets)?)
            }
            None if held.is_empty() => None,
            None => {
                return Err(Error::config(
                    "scene.targets",
                    format!("{} vertices are held and the scene has no targets for them", held.len()),
                    "give where the body carries them, or solve a garment that holds none",
                ));
            }
        };
        let springs = match &scene.springs {
            Some(springs) => {
                Error::check_length("targets of springs", springs.attachment.vertices().len(), springs.targets.len())?;
                Some(frame_of(springs.targets)?)
            }
            None => None,
        };
        let momentum = match &scene.momentum {
            Some(past) => {
                Error::check_length("positions one step ago", n, past.now.len())?;
                Error::check_length("velocities one step ago", n, past.velocity.len())?;
                if !(past.step > 0.0 && past.step.is_finite()) {
                    return Err(out_of_bounds("time step", past.step, "s"));
                }
                let ahead: Vec<Vec3> = past.now.iter().zip(past.velocity).map(|(x, v)| x + v * past.step).collect();
                let inertia = Inertia::<f64>::new(&solver.rest, past.step, InertiaRule::KnownVelocity)?;
                Some((inertia.next_step()?, frame_of(&ahead)?))
            }
            None => None,
        };
        let mut fixed = vec![false; n];
        for &v in scene.fixed {
            let Some(slot) = fixed.get_mut(v as usize) else {
                let problem = format!("is fixed but there are {n} vertices");
                return Err(Error::mesh(
                    &solver.rest.name,
                    format!("vertex {v}"),
                    problem,
                    "fix vertices of this garment",
                ));
            };
            *slot = true;
        }
        Ok(Self { scene, targets, springs, momentum, fixed })
    }

    /// Terms with their states and weights at `x`.
    pub(super) fn terms<'t>(
        &'t self,
        solver: &'t Solver,
        frozen: &'t Frozen,
        x: &'t Frames<f64>,
    ) -> Vec<(&'static str, &'t dyn EnergyTangent, State<'t, f64>, f64)> {
        let alone = State::new(x);
        let [strain, bending, gravity, collision, attachment] = solver.forces.weights;
        let mut out: Vec<(&'static str, &dyn EnergyTangent, State<'_, f64>, f64)> = vec![
            ("strain", &solver.strain, alone, strain),
            ("bending", &solver.bending, alone, bending),
            ("gravity", &solver.gravity, alone, gravity),
        ];
        if let Some(body) = &self.scene.body {
            let state =
                BodyState { positions: body.positions, normals: body.normals, nearest: frozen.nearest.as_deref() };
            out.push(("collision", &solver.collision, alone.with_body(state), collision));
        }
        if let Some(targets) = &self.targets {
            out.push(("attachment", &solver.attachment, alone.with_targets(targets), attachment));
        }
        if let (Some(targets), Some(springs)) = (&self.springs, &self.scene.springs) {
            out.push(("springs", springs.attachment, alone.with_targets(targets), 1.0));
        }
        if let Some((springs, targets)) = &self.momentum {
            out.push(("inertia", springs, alone.with_targets(targets), 1.0));
        }
        if self.scene.body.is_some() && solver.settings.friction > 0.0 {
            out.push(("friction", &frozen.friction, alone, 1.0));
        }
        out.retain(|term| term.3 != 0.0);
        out
    }

    /// Nearest body vertices at these positions.
    pub(super) fn search(&self, x: &Frames<f64>) -> Result<Option<Vec<u32>>> {
        let Some(body) = &self.scene.body else { return Ok(None) };
        let found = match body.search {
            Some(search) => search(x)?,
            None => nearest_body_vertices(x, body.positions)?,
        };
        Error::check_length("nearest body vertices, [garment vertex][lane]", LANES * x.vertices(), found.len())?;
        Ok(Some(found))
    }

    /// The body's part of a garment vertex's motion, for friction: how far its body vertex went in this step.
    pub(super) fn carried(&self, body_vertex: u32) -> Vec3 {
        match &self.scene.body {
            Some(body) => body.before.map_or(Vec3::zeros(), |before| {
                body.positions.get(0, 0, body_vertex as usize) - before.get(0, 0, body_vertex as usize)
            }),
            None => Vec3::zeros(),
        }
    }
}

/// Buffers of one solve.
pub(super) struct Workspace {
    pub(super) x: Frames<f64>,
    g: Frames<f64>,
    pub(super) evaluations: usize,
}

impl Workspace {
    pub(super) fn new(vertex_count: usize) -> Self {
        Self { x: Frames::zeros(1, vertex_count, 1), g: Frames::zeros(1, vertex_count, 1), evaluations: 0 }
    }
    pub(super) fn set(&mut self, x: &[f64]) -> &Frames<f64> {
        fill(&mut self.x, x);
        &self.x
    }
    /// Energy per term [J], and the gradient [N] with zeros at fixed vertices.
    pub(super) fn evaluate(
        &mut self,
        solver: &Solver,
        prepared: &Prepared<'_>,
        frozen: &Frozen,
        x: &[f64],
        gradient: Option<&mut Vec<f64>>,
    ) -> Result<Vec<(&'static str, f64)>> {
        fill(&mut self.x, x);
        self.evaluations += 1;
        self.g.clear();
        let wanted = gradient.is_some();
        let mut energies = Vec::new();
        for (name, term, state, weight) in prepared.terms(solver, frozen, &self.x) {
            let mut energy = [0.0];
            term.add(&state, weight, &mut energy, if wanted { Some(&mut self.g) } else { None })?;
            energies.push((name, energy[0]));
        }
        if let Some(gradient) = gradient {
            gradient.clear();
            gradient.extend(self.g.data().chunks_exact(LANES).map(|lanes| lanes[0]));
            for (v, _) in prepared.fixed.iter().enumerate().filter(|f| *f.1) {
                gradient[3 * v..3 * v + 3].fill(0.0);
            }
        }
        Ok(energies)
    }
    /// The tangent matrix at `x`, fixed vertices taken out.
    pub(super) fn tangent(
        &mut self,
        solver: &Solver,
        prepared: &Prepared<'_>,
        frozen: &Frozen,
        x: &[f64],
        kind: Tangent,
        matrix: &mut super::sparse::BlockMatrix,
    ) -> Result<()> {
        fill(&mut self.x, x);
        matrix.clear();
        for (name, term, state, weight) in prepared.terms(solver, frozen, &self.x) {
            let own;
            let (slots, width, values) = match name {
                "strain" => (&solver.slots[0], 3, 9 * solver.slots[0].len()),
                "bending" => (&solver.slots[1], 4, 9 * solver.slots[1].len()),
                _ => {
                    let stencil = term.stencil();
                    own = matrix.pattern().slots(&stencil)?;
                    (&own, stencil.width, stencil.block_values())
                }
            };
            let mut blocks = vec![0.0; values];
            term.tangents(&state, weight, kind, &mut blocks)?;
            matrix.add(slots, width, &blocks);
        }
        matrix.fix(&prepared.fixed);
        Ok(())
    }
}

/// Sum of energies.
pub(super) fn total(energies: &[(&'static str, f64)]) -> f64 {
    energies.iter().map(|e| e.1).sum()
}

/// Largest vector per vertex: length and vertex.
pub(super) fn largest(g: &[f64]) -> (f64, usize) {
    let mut out = (0.0, 0);
    for (v, g) in g.chunks_exact(3).enumerate() {
        let length = (g[0] * g[0] + g[1] * g[1] + g[2] * g[2]).sqrt();
        // NaN counts as the largest.
        if length > out.0 || length.is_nan() {
            out = (length, v);
        }
    }
    out
}
