//! Which term left the finite numbers, in which frame, at which element.
//!
//! Only asked after something went wrong: every term is evaluated again, frame by frame.

use super::{Dynamics, Physics};
use caphy_core::Real;
use caphy_core::array::Out;
use caphy_core::lanes::Frames;
use caphy_core::material::{MaterialReal, MembraneBlock};
use caphy_garment::GarmentRest;
use caphy_garment::energy::{BodyState, EnergyTerm, State};

/// A value of a term that is not finite.
#[derive(Debug, Clone, PartialEq)]
pub struct PhysicsFault {
    /// Name of the term.
    pub term: &'static str,
    /// Time step in the batch.
    pub step: usize,
    /// Window in the batch.
    pub window: usize,
    /// What is not finite, and where.
    pub what: String,
}

impl<T: MaterialReal> Physics<T> {
    /// The first term, in the order of evaluation, that has an energy or gradient that is not finite at finite positions; of
    /// that term the first frame; `None` when all are finite.
    pub fn fault(
        &self,
        rest: &GarmentRest,
        state: &State<'_, T>,
        dynamics: Dynamics,
        scale: f64,
    ) -> Option<PhysicsFault> {
        let positions = state.positions;
        for (term, weight) in self.terms() {
            let inertia = term.name() == "inertia";
            if weight == 0.0 || inertia && dynamics == Dynamics::Static {
                continue;
            }
            // Inertia looks at the two frames before.
            let span = if inertia { 3 } else { 1 };
            for step in span - 1..positions.blocks() {
                for window in 0..positions.lanes_used() {
                    let frame = Cut::new(state, step + 1 - span, span, window);
                    if let Some(what) = self.fault_in(term, weight * scale, rest, &frame) {
                        return Some(PhysicsFault { term: term.name(), step, window, what });
                    }
                }
            }
        }
        None
    }

    fn fault_in(&self, term: &dyn EnergyTerm<T>, factor: f64, rest: &GarmentRest, frame: &Cut<T>) -> Option<String> {
        let x = &frame.positions;
        let mut energy = vec![0.0; x.frames()];
        let mut gradient = Frames::zeros(x.blocks(), x.vertices(), 1);
        let refused = term.add(&frame.state(), factor, &mut energy, Some(&mut gradient)).err();
        let broken = (0..x.blocks()).flat_map(|b| (0..x.vertices()).map(move |v| (b, v)));
        let vertex = || broken.clone().find(|&(b, v)| !gradient.get(b, 0, v).iter().all(|g| g.is_finite()));
        let finite = refused.is_none() && energy.iter().all(|e| e.is_finite()) && vertex().is_none();
        if finite {
            return None;
        }
        if term.name() == "strain"
            && let Some(what) = self.triangle(rest, x)
        {
            return Some(what);
        }
        match (refused, vertex()) {
            (Some(error), _) => Some(error.to_string()),
            (None, Some((b, v))) => {
                let (g, p) = (gradient.get(b, 0, v), x.get(b, 0, v));
                Some(format!(
                    "the gradient at vertex {v} is ({}, {}, {}), the vertex at ({}, {}, {})",
                    g.x, g.y, g.z, p.x, p.y, p.z
                ))
            }
            (None, None) => Some("the energy of the frame".into()),
        }
    }

    /// The first triangle at which the material's answer is not finite.
    fn triangle(&self, rest: &GarmentRest, x: &Frames<T>) -> Option<String> {
        (0..rest.faces().len()).find_map(|f| {
            let [m00, m01, m10, m11] = rest.dm_inverse[f].map(T::of);
            let corner = |i: usize| {
                let p = x.get(0, 0, rest.faces()[f][i] as usize);
                [T::of(p.x), T::of(p.y), T::of(p.z)]
            };
            let (a, b, c) = (corner(0), corner(1), corner(2));
            let (mut uu, mut vv, mut uv) = (T::zero(), T::zero(), T::zero());
            for k in 0..3 {
                let (d1, d2) = (b[k] - a[k], c[k] - a[k]);
                let (fu, fv) = (d1 * m00 + d2 * m10, d1 * m01 + d2 * m11);
                uu += fu * fu;
                vv += fv * fv;
                uv += fu * fv;
            }
            let half = T::of(0.5);
            let green = [half * (uu - T::one()), half * (vv - T::one()), half * uv];
            let (mut energy, mut stress) = ([T::zero()], [T::zero(); 3]);
            let mut block = MembraneBlock::new(1, &green);
            block.energy = Out::from(&mut energy[..]);
            block.stress = Out::from(&mut stress[..]);
            let answer = T::membrane(&*self.material, &mut block);
            let problem = match answer {
                Err(error) => error.to_string(),
                Ok(()) if !energy[0].is_finite() => format!("the energy density is {}", energy[0].to_f64()),
                Ok(()) if !stress.iter().all(|s| s.is_finite()) => {
                    format!("the stress is {:?} N/m", stress.map(|s| s.to_f64()))
                }
                Ok(()) => return None,
            };
            let corners = [a, b, c].map(|p| p.map(|c| c.to_f64()).into());
            let [major, minor] = crate::training::measures::principal_stretches(corners, rest.dm_inverse[f]);
            let [i, j, k] = rest.faces()[f];
            Some(format!("{problem} at triangle {f} (vertices {i}, {j}, {k}), stretched by {major:.4} and {minor:.4}"))
        })
    }
}

/// A few consecutive frames of one window, apart from the batch.
struct Cut<T> {
    positions: Frames<T>,
    body: Option<(Frames<T>, Frames<T>, Option<Vec<u32>>)>,
    targets: Option<Frames<T>>,
}

impl<T: Real> Cut<T> {
    fn new(state: &State<'_, T>, first: usize, steps: usize, window: usize) -> Cut<T> {
        let cut = |from: &Frames<T>| {
            let mut out = Frames::zeros(steps, from.vertices(), 1);
            for step in 0..steps {
                for v in 0..from.vertices() {
                    out.set(step, 0, v, &from.get(first + step, window, v));
                }
            }
            out
        };
        let count = state.positions.vertices();
        let nearest = |all: &[u32]| {
            let rows = &all[first * count * T::LANES..(first + steps) * count * T::LANES];
            rows.chunks_exact(T::LANES).flat_map(|row| std::iter::repeat_n(row[window], T::LANES)).collect()
        };
        Cut {
            positions: cut(state.positions),
            body: state.body.map(|b| (cut(b.positions), cut(b.normals), b.nearest.map(nearest))),
            targets: state.targets.map(cut),
        }
    }
    fn state(&self) -> State<'_, T> {
        let mut state = State::new(&self.positions);
        if let Some((positions, normals, nearest)) = &self.body {
            state = state.with_body(BodyState { positions, normals, nearest: nearest.as_deref() });
        }
        if let Some(targets) = &self.targets {
            state = state.with_targets(targets);
        }
        state
    }
}
