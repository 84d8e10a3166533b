//! What stays put while forces are balanced: the scene in the layout of the energies, contact pairs, friction.

use super::Solver;
use super::scene::Scene;
use crate::energy::{
    Attachment, BodyState, EnergyTangent, Friction, Inertia, InertiaRule, Single, SingleBody, SingleTerm, State,
    Tangent, lane_points, nearest_body_vertices, square_distance,
};
use caphy_core::lanes::Frames;
use caphy_core::{Error, Real, Result, Vec3};

const LANES: usize = <f64 as Real>::LANES;

/// A touching vertex that has come back to a body vertex so often, squared, changes for one that is nearer by this share more.
const RETURN: f64 = 0.1;

/// Contact pairs and friction of one round.
#[derive(Debug, Clone)]
pub(super) struct Frozen {
    /// Nearest body vertex, `[garment vertex][lane]`.
    pub(super) nearest: Option<Vec<u32>>,
    /// The same per garment vertex.
    single: Vec<u32>,
    pub(super) friction: Friction,
    /// What each garment vertex touched before; empty where nothing is remembered.
    pub(super) habits: Vec<Habit>,
}

impl Frozen {
    pub(super) fn new(nearest: Option<Vec<u32>>, friction: Friction) -> Self {
        let single = nearest.iter().flatten().step_by(LANES).copied().collect();
        Self { nearest, single, friction, habits: Vec::new() }
    }
}

/// Body vertices that a garment vertex touched before its present one, and how often it came back to one of them.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Habit {
    /// Youngest first; ids plus 1, so that 0 is none.
    before: [u32; 3],
    returns: u32,
}

impl Habit {
    fn change(&mut self, from: u32, to: u32) {
        self.returns += u32::from(self.before.contains(&(to + 1)));
        self.before = [from + 1, self.before[0], self.before[1]];
    }
}

/// A scene in the layout of the energies.
pub(super) struct Prepared<'a> {
    pub(super) scene: &'a Scene<'a>,
    /// Body vertices and normals.
    body: [Vec<[f64; 3]>; 2],
    targets: Option<Vec<f64>>,
    springs: Option<Vec<f64>>,
    momentum: Option<(Attachment<f64>, Vec<f64>)>,
    /// Vertices that do not move.
    pub(super) fixed: Vec<bool>,
}

/// A term with its weight and what its state holds beside the positions.
pub(super) struct Term<'t> {
    name: &'static str,
    term: &'t dyn SolverTerm,
    weight: f64,
    body: Option<(BodyState<'t, f64>, SingleBody<'t>)>,
    targets: Option<&'t [f64]>,
}

/// What a solver needs of an energy.
pub(super) trait SolverTerm: EnergyTangent + SingleTerm {}
impl<E: EnergyTangent + SingleTerm> SolverTerm for E {}

/// Points one after the other.
pub(super) fn flat(points: &[Vec3]) -> Vec<f64> {
    points.iter().flat_map(|p| [p.x, p.y, p.z]).collect()
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
                Some(flat(targets))
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
                Some(flat(springs.targets))
            }
            None => None,
        };
        let momentum = match &scene.momentum {
            Some(past) => {
                Error::check_length("positions one step ago", n, past.now.len())?;
                Error::check_length("velocities one step ago", n, past.velocity.len())?;
                let inertia = Inertia::<f64>::new(&solver.rest, past.step, InertiaRule::KnownVelocity)?;
                let ahead: Vec<Vec3> = past.now.iter().zip(past.velocity).map(|(x, v)| x + v * past.step).collect();
                Some((inertia.next_step()?, flat(&ahead)))
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
        let mut body = [Vec::new(), Vec::new()];
        if let Some(of) = &scene.body {
            for frames in [of.positions, of.normals] {
                Error::check_length("frames of the body", 1, frames.frames())?;
            }
            Error::check_length("body normals", of.positions.vertices(), of.normals.vertices())?;
            body = [of.positions, of.normals].map(|frames| lane_points(frames, 0, 0));
        }
        Ok(Self { scene, body, targets, springs, momentum, fixed })
    }

    /// The terms that act.
    pub(super) fn terms<'t>(&'t self, solver: &'t Solver, frozen: &'t Frozen) -> Vec<Term<'t>> {
        let [strain, bending, gravity, collision, attachment] = solver.forces.weights;
        let alone = |name, term: &'t dyn SolverTerm, weight| Term { name, term, weight, body: None, targets: None };
        let mut out = vec![
            alone("strain", &solver.strain, strain),
            alone("bending", &solver.bending, bending),
            alone("gravity", &solver.gravity, gravity),
        ];
        if let Some(body) = &self.scene.body {
            let state =
                BodyState { positions: body.positions, normals: body.normals, nearest: frozen.nearest.as_deref() };
            let single = SingleBody { positions: &self.body[0], normals: &self.body[1], nearest: &frozen.single };
            out.push(Term { body: Some((state, single)), ..alone("collision", &solver.collision, collision) });
        }
        if let Some(targets) = &self.targets {
            out.push(Term { targets: Some(targets), ..alone("attachment", &solver.attachment, attachment) });
        }
        if let (Some(targets), Some(springs)) = (&self.springs, &self.scene.springs) {
            out.push(Term { targets: Some(targets), ..alone("springs", springs.attachment, 1.0) });
        }
        if let Some((springs, targets)) = &self.momentum {
            out.push(Term { targets: Some(targets), ..alone("inertia", springs, 1.0) });
        }
        if self.scene.body.is_some() && solver.settings.friction > 0.0 {
            out.push(alone("friction", &frozen.friction, 1.0));
        }
        out.retain(|term| term.weight != 0.0);
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

    pub(super) fn has_body_vertex(&self, id: u32) -> bool {
        (id as usize) < self.body[0].len()
    }
    /// Keeps touching vertices, `[garment vertex]`, at their old body vertex unless the new one is nearer by a share of `preference`,
    /// and more where they have come back before; answers how many changed.
    ///
    /// Where two limbs press cloth between them, the nearest vertex lies now on one side, now on the other, and each pushes
    /// it centimetres into the other. So a vertex is not thrown deep into another surface than its own. In a hollow, outside means
    /// outside of both surfaces: there it is held off the one that it is deeper in.
    pub(super) fn keep_pairs(
        &self,
        x: &[f64],
        old: &[u32],
        new: &mut [u32],
        touching: &[bool],
        (preference, margin): (f64, f64),
        habits: &mut [Habit],
    ) -> usize {
        let [points, normals] = &self.body;
        let mut changed = 0;
        for (v, (new, old)) in new.chunks_exact_mut(LANES).zip(old.chunks_exact(LANES)).enumerate() {
            let (a, b) = (old[0] as usize, new[0] as usize);
            if a == b || !touching[v] || a.max(b) >= points.len() {
                continue;
            }
            let at = [x[3 * v], x[3 * v + 1], x[3 * v + 2]];
            let distance = |id: usize| square_distance(&points[id], &at).sqrt();
            let along = |id: usize, to: &[f64; 3]| -> f64 { (0..3).map(|k| normals[id][k] * to[k]).sum() };
            let depth = |id: usize| margin - along(id, &[0, 1, 2].map(|k| at[k] - points[id][k]));
            // Beginning to touch the other surface is one thing, being thrown deep into it another.
            let thrown = depth(b) > depth(a).max(margin);
            let across: f64 = (0..3).map(|k| (normals[a][k] - normals[b][k]) * (points[a][k] - points[b][k])).sum();
            let hollow = across < 0.0 && depth(a) > depth(b);
            let preference = preference + RETURN * f64::from(habits[v].returns).powi(2);
            if thrown || hollow || distance(a) <= distance(b) * (1.0 + preference) {
                new.copy_from_slice(old);
            } else {
                habits[v].change(old[0], new[0]);
                changed += 1;
            }
        }
        changed
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
    x: Frames<f64>,
    pub(super) evaluations: usize,
}

impl Workspace {
    pub(super) fn new(vertex_count: usize) -> Self {
        Self { x: Frames::zeros(1, vertex_count, 1), evaluations: 0 }
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
        self.evaluations += 1;
        let mut gradient = gradient;
        if let Some(gradient) = &mut gradient {
            gradient.clear();
            gradient.resize(x.len(), 0.0);
        }
        let mut energies = Vec::new();
        for Term { name, term, weight, body, targets } in prepared.terms(solver, frozen) {
            let pose = Single { positions: x, body: body.map(|b| b.1), targets };
            energies.push((name, term.add_single(&pose, weight, gradient.as_deref_mut().map(|g| &mut g[..]))?));
        }
        if let Some(gradient) = gradient {
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
        for Term { name, term, weight, body, .. } in prepared.terms(solver, frozen) {
            let alone = State::new(&self.x);
            let state = body.map_or(alone, |(body, _)| alone.with_body(body));
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

#[cfg(test)]
mod tests {
    use super::*;

    /// Two surfaces that face each other 3 mm apart, the upper one's vertices right above the lower one's, and a third vertex
    /// beside the first.
    #[test]
    fn a_vertex_between_two_surfaces_keeps_its_side() {
        let points = vec![[0.0, 0.0, 0.0], [0.0, 3e-3, 0.0], [0.01, 0.0, 0.0]];
        let normals = vec![[0.0, 1.0, 0.0], [0.0, -1.0, 0.0], [0.0, 1.0, 0.0]];
        let scene = Scene::default();
        let prepared = Prepared {
            scene: &scene,
            body: [points, normals],
            targets: None,
            springs: None,
            momentum: None,
            fixed: vec![false],
        };
        let lanes = |id: u32| vec![id; LANES];
        let after = |x: [f64; 3], old: u32, new: u32, touching: bool, preference: f64| {
            let mut pairs = lanes(new);
            let changed = prepared.keep_pairs(
                &x,
                &lanes(old),
                &mut pairs,
                &[touching],
                (preference, 2e-3),
                &mut [Habit::default()],
            );
            assert_eq!(changed, usize::from(touching && pairs == lanes(new) && old != new));
            pairs[0]
        };
        // Outside both: beginning to touch the other surface counts.
        assert_eq!(after([0.0, 1.6e-3, 0.0], 0, 1, true, 0.0), 1);
        // Past the other surface by 2 mm, which would be 4 mm deep: stays with the one that it is outside of.
        assert_eq!(after([0.0, 5e-3, 0.0], 0, 1, true, 0.0), 0);
        // Inside its own surface and outside of the other: a gap between them is a hollow, and it is not let go.
        assert_eq!(after([0.0, -8e-3, 0.0], 2, 1, true, 0.0), 2);
        // Inside the one surface that both are of.
        assert_eq!(after([0.009, -1e-3, 0.0], 0, 2, true, 0.0), 2);
        // Along one surface the nearer one is taken, unless the old one is preferred by more than that.
        assert_eq!(after([0.006, 1e-3, 0.0], 0, 2, true, 0.0), 2);
        assert_eq!(after([0.006, 1e-3, 0.0], 0, 2, true, 1.0), 0);
        // Without touch there is nothing to keep.
        assert_eq!(after([0.0, 5e-3, 0.0], 0, 1, false, 0.0), 1);
    }

    /// Positions and normals of two body vertices, one garment vertex at `x` held to the first, the second found nearer.
    fn changes(points: [[f64; 3]; 2], normals: [[f64; 3]; 2], x: [f64; 3], habit: &mut [Habit]) -> bool {
        let scene = Scene::default();
        let prepared = Prepared {
            scene: &scene,
            body: [points.to_vec(), normals.to_vec()],
            targets: None,
            springs: None,
            momentum: None,
            fixed: vec![false],
        };
        let mut pairs = vec![1; LANES];
        prepared.keep_pairs(&x, &[0; LANES], &mut pairs, &[true], (0.0, 2e-3), habit) == 1
    }

    #[test]
    fn no_vertex_is_thrown_deep_and_hollows_hold_it_off_both_sides() {
        // A floor and a wall that meet at a right angle; beside the corner, 1 mm above the floor.
        let hollow = ([[0.01, 0.0, 0.0], [0.0, 0.01, 0.0]], [[0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]);
        let at = |x: [f64; 3]| changes(hollow.0, hollow.1, x, &mut [Habit::default()]);
        // 1 mm off the floor and 1.5 mm off the wall: the floor it is; the other way round the wall.
        assert!(!at([1.5e-3, 1e-3, 0.0]) && at([1e-3, 1.5e-3, 0.0]));
        // 5 mm behind the wall.
        assert!(!at([-5e-3, 1.5e-3, 0.0]));
        // Over an edge the nearer side holds, though the other tangent plane lies above.
        let edge = ([[-0.01, 0.0, 0.0], [0.0, -0.01, 0.0]], [[0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]);
        assert!(changes(edge.0, edge.1, [1e-3, -5e-3, 0.0], &mut [Habit::default()]));
    }

    #[test]
    fn who_keeps_coming_back_stays() {
        let flat = ([[0.0; 3], [0.01, 0.0, 0.0]], [[0.0, 1.0, 0.0]; 2]);
        let nearer = [6e-3, 1e-3, 0.0];
        let mut habit = [Habit::default()];
        // Forward a hundred times: nothing comes back.
        (10..110).for_each(|body| habit[0].change(body, body + 1));
        assert!(changes(flat.0, flat.1, nearer, &mut habit));
        // To and fro: 6.1 mm from one and 4.1 mm from the other is a share of 0.48, less than 0.1 times three squared.
        for _ in 0..3 {
            habit[0].change(1, 0);
            habit[0].change(0, 1);
        }
        assert!(!changes(flat.0, flat.1, nearer, &mut habit));
    }
}
