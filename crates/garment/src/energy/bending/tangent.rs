//! Second derivatives of the bending energy, its lagged form, and its derivatives by the fabric's parameters.
//!
//! # The second derivative of the dihedral angle
//! With e = x1 − x0, a = x2 − x0, b = x3 − x0, ℓ = |e|, t = e/ℓ, unit normals N, in-plane directions m = N0 × t (side 0) and
//! m = t × N1 (side 1), heights h and feet s = a·e/ℓ² (b·e/ℓ²), let α = (da − s₀ de)/h₀, β = (db − s₁ de)/h₁ and τ = de_⊥/ℓ.
//! Then exactly
//!
//! dτ_hinge = N0·α + N1·β,
//! d²τ_hinge = Σ over sides of −2 (m·α)(N·α) − 2 (N·τ)(t·α) − (m·τ)(N·τ).
//!
//! (The polar angle of a about t changes by that much when t is carried along its geodesic.) In sums and differences of both sides,
//! and with τ along the mean normal P and X = P × t, this falls apart into 2 × 2 matrices, so that negative eigenvalues are
//! removed in closed form. The removal is done in these scaled coordinates: the result is positive semidefinite, and the exact
//! matrix wherever that already is.

use super::{Bending, Element, SMALLEST_HEIGHT, arc_tangent};
use crate::energy::tangent::{EnergyTangent, Stencil, Tangent, clamp_2x2, only_frame};
use crate::energy::{EnergyTerm, State};
use caphy_core::material::{HingeBlock, HingeLength, MaterialDescription};
use caphy_core::{Error, Result, Vec3};
use nalgebra::{Matrix3, SymmetricEigen};
use rayon::prelude::*;

/// Hinges that travel through the material in one call.
const BATCH: usize = 256;
/// Steps of differenced stiffness: in the angle [rad], and as a share of the length.
const STEP: f64 = 1e-5;
/// A vector of the twelve coordinates of a hinge.
type Row = [f64; 12];

/// Geometry of a hinge.
struct Fold {
    angle: f64,
    length: f64,
    t: Vec3,
    normals: [Vec3; 2],
    heights: [f64; 2],
    feet: [f64; 2],
}

impl Fold {
    /// `None` for an edge without length.
    fn new(vertices: &[u32; 4], x: &[[f64; 3]]) -> Option<Self> {
        let [x0, x1, x2, x3] = vertices.map(|v| Vec3::from(x[v as usize]));
        let (e, a, b) = (x1 - x0, x2 - x0, x3 - x0);
        let ee = e.norm_squared();
        let length = ee.sqrt();
        if length == 0.0 {
            return None;
        }
        let (n0, n1) = (e.cross(&a), b.cross(&e));
        let side =
            |n: &Vec3| (n.try_normalize(0.0).unwrap_or_default(), (n.norm() / length).max(SMALLEST_HEIGHT * length));
        let ((normal0, h0), (normal1, h1)) = (side(&n0), side(&n1));
        Some(Self {
            angle: arc_tangent(length * n0.dot(&b), n0.dot(&n1)),
            length,
            t: e / length,
            normals: [normal0, normal1],
            heights: [h0, h1],
            feet: [a.dot(&e) / ee, b.dot(&e) / ee],
        })
    }
    /// The functional d·(da − s de)/h of a side over (x0, x1, x2, x3).
    fn on_side(&self, side: usize, d: &Vec3) -> Row {
        let d = d / self.heights[side];
        let along = d * -self.feet[side];
        let mut out = [0.0; 12];
        for k in 0..3 {
            out[3 + k] = along[k];
            out[6 + 3 * side + k] = d[k];
            out[k] = -(along[k] + d[k]);
        }
        out
    }
    /// The functional d·de.
    fn on_edge(d: &Vec3) -> Row {
        let mut out = [0.0; 12];
        for k in 0..3 {
            out[3 + k] = d[k];
            out[k] = -d[k];
        }
        out
    }
    /// dτ.
    fn angle_gradient(&self) -> Row {
        let (a, b) = (self.on_side(0, &self.normals[0]), self.on_side(1, &self.normals[1]));
        std::array::from_fn(|i| a[i] + b[i])
    }
    /// dℓ.
    fn length_gradient(&self) -> Row {
        Self::on_edge(&self.t)
    }
}

/// First derivatives of a hinge's energy by angle and length, as the gradient has them, and their derivatives.
#[derive(Debug, Clone, Copy, Default)]
struct Slopes {
    turn: f64,
    pull: f64,
    /// [∂turn/∂τ, ∂turn/∂ℓ, ∂pull/∂τ, ∂pull/∂ℓ].
    second: [f64; 4],
}

/// k at a hinge with what it takes to differentiate twice.
#[derive(Debug, Clone, Copy, Default)]
struct Stiffness {
    k: f64,
    by_angle: f64,
    by_length: f64,
    by_angle_twice: f64,
    by_both: f64,
    by_length_twice: f64,
}

/// What a batch asks the material, structure of arrays.
struct Question {
    angle: Vec<f64>,
    rest: Vec<f64>,
    length: Vec<f64>,
    area: Vec<f64>,
    directions: [Vec<f64>; 2],
}

impl Question {
    fn new(batch: &[Element<f64>], folds: &[Option<Fold>], current: bool) -> Self {
        let n = batch.len();
        let direction = |of: fn(&Element<f64>) -> [f64; 2]| {
            (0..2).flat_map(|k| batch.iter().map(move |h| of(h)[k])).collect::<Vec<f64>>()
        };
        let length = |i: usize| if current { folds[i].as_ref().map_or(0.0, |f| f.length) } else { batch[i].length };
        Self {
            angle: folds.iter().map(|f| f.as_ref().map_or(0.0, |f| f.angle)).collect(),
            rest: batch.iter().map(|h| h.angle).collect(),
            length: (0..n).map(length).collect(),
            area: batch.iter().map(|h| h.area).collect(),
            directions: [direction(|h| h.direction0), direction(|h| h.direction1)],
        }
    }
    fn block<'a>(&'a self, angle: &'a [f64], length: &'a [f64]) -> HingeBlock<'a, f64> {
        HingeBlock::new(
            angle.len(),
            [angle, &self.rest, length, &self.area],
            [&self.directions[0], &self.directions[1]],
        )
    }
}

impl Bending<f64> {
    fn real(&self) -> &[Element<f64>] {
        &self.hinges[..self.count]
    }
    fn folds(batch: &[Element<f64>], x: &[[f64; 3]]) -> Vec<Option<Fold>> {
        batch.iter().map(|h| Fold::new(&h.vertices, x)).collect()
    }

    /// k of a batch; `slopes` also its first derivatives, differenced where the material offers none.
    fn stiffness(
        &self,
        facts: &MaterialDescription,
        question: &Question,
        [angle, length]: [&[f64]; 2],
        slopes: bool,
    ) -> Result<[Vec<f64>; 3]> {
        let n = angle.len();
        let mut out = [vec![0.0; n], vec![0.0; n], vec![0.0; n]];
        let [k, by_angle, by_length] = &mut out;
        let mut block = question.block(angle, length);
        block.stiffness = (&mut k[..]).into();
        if slopes && facts.offers.hinge_slopes {
            block.stiffness_by_angle = (&mut by_angle[..]).into();
            block.stiffness_by_length = (&mut by_length[..]).into();
        }
        self.material.hinge((&mut block).into())?;
        if slopes && !facts.offers.hinge_slopes {
            let alone = |angle: &[f64], length: &[f64]| -> Result<Vec<f64>> {
                let mut k = vec![0.0; n];
                let mut block = question.block(angle, length);
                block.stiffness = (&mut k[..]).into();
                self.material.hinge((&mut block).into())?;
                Ok(k)
            };
            let (ahead, behind) = (shifted(angle, STEP), shifted(angle, -STEP));
            let (longer, shorter) = (scaled(length, 1.0 + STEP), scaled(length, 1.0 - STEP));
            let sides =
                [alone(&ahead, length)?, alone(&behind, length)?, alone(angle, &longer)?, alone(angle, &shorter)?];
            for i in 0..n {
                by_angle[i] = (sides[0][i] - sides[1][i]) / (2.0 * STEP);
                by_length[i] = quotient(sides[2][i] - sides[3][i], 2.0 * STEP * length[i]);
            }
        }
        Ok(out)
    }

    /// k and the derivatives that the second derivative of the energy needs. The contract has none beyond the first: those
    /// are central differences of the slopes, exact where k is piecewise linear or quadratic.
    fn stiffness_twice(&self, facts: &MaterialDescription, question: &Question) -> Result<Vec<Stiffness>> {
        let (angle, length) = (&question.angle[..], &question.length[..]);
        let of = |angle: &[f64], length: &[f64]| self.stiffness(facts, question, [angle, length], true);
        let [k, by_angle, by_length] = of(angle, length)?;
        let mut out: Vec<Stiffness> = (0..k.len())
            .map(|i| Stiffness { k: k[i], by_angle: by_angle[i], by_length: by_length[i], ..Default::default() })
            .collect();
        let constant = by_angle.iter().chain(&by_length).all(|&s| s == 0.0);
        if facts.stiffness_frozen || constant {
            return Ok(out);
        }
        let (ahead, behind) = (of(&shifted(angle, STEP), length)?, of(&shifted(angle, -STEP), length)?);
        for (i, s) in out.iter_mut().enumerate() {
            s.by_angle_twice = (ahead[1][i] - behind[1][i]) / (2.0 * STEP);
        }
        if facts.hinge_length == HingeLength::Current {
            let (longer, shorter) = (of(angle, &scaled(length, 1.0 + STEP))?, of(angle, &scaled(length, 1.0 - STEP))?);
            for (i, s) in out.iter_mut().enumerate() {
                s.by_both = quotient(longer[1][i] - shorter[1][i], 2.0 * STEP * length[i]);
                s.by_length_twice = quotient(longer[2][i] - shorter[2][i], 2.0 * STEP * length[i]);
            }
        }
        Ok(out)
    }

    /// Holds k (and the edge length, where the material looks at it without differentiating) of every hinge as they are at
    /// these positions, so that the force is a true gradient, until [`Bending::release`].
    ///
    /// # Errors
    /// As [`EnergyTangent::tangents`].
    pub fn hold(&mut self, state: &State<'_, f64>) -> Result<()> {
        let x = only_frame("bending", state.positions)?;
        let facts = self.material.describe();
        let current = facts.hinge_length != HingeLength::Rest;
        let mut held = Vec::with_capacity(self.hinges.len());
        for (b, batch) in self.hinges.chunks(BATCH).enumerate() {
            let question = Question::new(batch, &Self::folds(batch, &x), current);
            let lookup = [&question.angle[..], &question.length[..]];
            let [k, ..] =
                self.stiffness(&facts, &question, lookup, false).map_err(|e| self.locate_in(e, b, batch.len()))?;
            held.extend(k.into_iter().zip(&question.length).map(|(k, &length)| [k, length]));
        }
        self.held = Some(held);
        Ok(())
    }
    /// Asks the material again.
    pub fn release(&mut self) {
        self.held = None;
    }
    /// By how much the energy [J] jumps on the way from `before` to `after` ([m], shape [vertex][3]) because hinges fold beyond π.
    ///
    /// Angles live in (−π, π]: a hinge that is folded flat and then further continues at −π, where its energy is another unless τ_T
    /// is 0. Its force does not see that jump, which a search for lower energy would stop at.
    ///
    /// # Errors
    /// As [`EnergyTerm::add`].
    pub fn jump_between(&self, before: &[f64], after: &[f64], weight: f64) -> Result<f64> {
        Error::check_length("positions before a step", 3 * self.vertex_count, before.len())?;
        Error::check_length("positions after a step", 3 * self.vertex_count, after.len())?;
        let points = |x: &[f64]| x.chunks_exact(3).map(|p| [p[0], p[1], p[2]]).collect::<Vec<_>>();
        let (before, after) = (points(before), points(after));
        let facts = self.material.describe();
        let current = facts.hinge_length != HingeLength::Rest;
        let mut jump = 0.0;
        for (b, batch) in self.real().chunks(BATCH).enumerate() {
            let (old, new) = (Self::folds(batch, &before), Self::folds(batch, &after));
            let turned = |i: usize| match (&old[i], &new[i]) {
                (Some(old), Some(new)) => new.angle - old.angle,
                _ => 0.0,
            };
            if (0..batch.len()).all(|i| turned(i).abs() <= std::f64::consts::PI) {
                continue;
            }
            let question = Question::new(batch, &new, current);
            let lookup = [&question.angle[..], &question.length[..]];
            let [k, ..] =
                self.stiffness(&facts, &question, lookup, false).map_err(|e| self.locate_in(e, b, batch.len()))?;
            for (i, hinge) in batch.iter().enumerate() {
                if turned(i).abs() <= std::f64::consts::PI {
                    continue;
                }
                let (k, l) = match &self.held {
                    Some(held) if facts.hinge_length == HingeLength::CurrentHeld => {
                        let [k, l] = held[b * BATCH + i];
                        (k, l)
                    }
                    Some(held) => (held[b * BATCH + i][0], question.length[i]),
                    None => (k[i], question.length[i]),
                };
                let fold = question.angle[i] - hinge.angle;
                let onward = fold - std::f64::consts::TAU.copysign(turned(i));
                jump += weight * k * l * l / (8.0 * hinge.area) * (fold * fold - onward * onward);
            }
        }
        Ok(jump)
    }
    fn locate_in(&self, error: Error, batch: usize, size: usize) -> Error {
        let Error::NonFinite { what, index, value } = error else { return error };
        let [n0, n1, ..] = self.hinges[batch * BATCH + index % size.max(1)].vertices;
        Error::numerics(
            "energy `bending`",
            format!("{what} is {value} at edge {n0}-{n1}"),
            "go back to the last good state with a smaller step, and check that the template is in metres",
        )
    }

    /// Derivatives of a batch's energy by angle and length.
    fn slopes(
        &self,
        b: usize,
        batch: &[Element<f64>],
        folds: &[Option<Fold>],
        facts: &MaterialDescription,
        weight: f64,
        kind: Tangent,
    ) -> Result<Vec<Slopes>> {
        let current = facts.hinge_length != HingeLength::Rest;
        let question = Question::new(batch, folds, current);
        let held = self.held.as_ref().map(|held| &held[b * BATCH..][..batch.len()]);
        // Constant stiffness: while it is held, and for steps with a frozen one.
        let constant = held.is_some() || (kind == Tangent::Projected && facts.stiffness_frozen);
        let stiffness = match held {
            Some(held) => held.iter().map(|h| Stiffness { k: h[0], ..Default::default() }).collect(),
            None if constant => {
                let lookup = [&question.angle[..], &question.length[..]];
                let [k, ..] =
                    self.stiffness(facts, &question, lookup, false).map_err(|e| self.locate_in(e, b, batch.len()))?;
                k.into_iter().map(|k| Stiffness { k, ..Default::default() }).collect()
            }
            None => self.stiffness_twice(facts, &question).map_err(|e| self.locate_in(e, b, batch.len()))?,
        };
        let rule = facts.hinge_length;
        Ok((0..batch.len())
            .map(|i| {
                let s = stiffness[i];
                let f = weight / (8.0 * batch[i].area);
                let fold = question.angle[i] - batch[i].angle;
                let l = match (held, rule) {
                    (Some(held), HingeLength::CurrentHeld) => held[i][1],
                    _ => question.length[i],
                };
                // What the gradient itself has of dk.
                let (ka, kl) = if facts.stiffness_frozen || constant { (0.0, 0.0) } else { (s.by_angle, s.by_length) };
                let turn = f * l * l * fold * (2.0 * s.k + ka * fold);
                let mut second = [0.0; 4];
                if facts.stiffness_frozen {
                    second[0] = 2.0 * f * l * l * (s.k + s.by_angle * fold);
                    second[1] = 2.0 * f * fold * l * (2.0 * s.k + l * s.by_length);
                } else {
                    second[0] = f * l * l * (2.0 * s.k + 4.0 * s.by_angle * fold + s.by_angle_twice * fold * fold);
                    second[1] = f
                        * fold
                        * l
                        * (2.0 * (2.0 * s.k + s.by_angle * fold) + l * (2.0 * s.by_length + s.by_both * fold));
                }
                let mut pull = 0.0;
                match rule {
                    HingeLength::Rest => second[1] = 0.0,
                    HingeLength::CurrentHeld => {
                        if constant || kind == Tangent::Projected {
                            second[1] = 0.0;
                        }
                    }
                    HingeLength::Current => {
                        pull = f * fold * fold * l * (2.0 * s.k + kl * l);
                        if facts.stiffness_frozen {
                            second[2] = 2.0 * f * l * fold * (2.0 * s.k + s.by_angle * fold);
                            second[3] = 2.0 * f * fold * fold * (s.k + l * s.by_length);
                        } else {
                            second[2] = second[1];
                            second[3] =
                                f * fold * fold * (2.0 * s.k + 4.0 * s.by_length * l + s.by_length_twice * l * l);
                        }
                    }
                }
                Slopes { turn, pull, second }
            })
            .collect())
    }

    /// vᵀ ∂(gradient)/∂Θ_j for every native parameter j: the adjoint of [`Bending::add_by_direction`]. `v` [m], shape [vertex][3].
    ///
    /// # Errors
    /// [`Error::Unsupported`] for a material without parameter derivatives, [`Error::Length`].
    pub fn by_parameter(&self, state: &State<'_, f64>, weight: f64, v: &[f64]) -> Result<Vec<f64>> {
        let x = only_frame("bending", state.positions)?;
        Error::check_length("vector of bending's parameter derivative", 3 * self.vertex_count, v.len())?;
        let p = self.material.parameters().len();
        let mut out = vec![0.0; p];
        self.each_by_parameter(&x, weight, |hinge, fold, slopes| {
            let along =
                |row: &Row| -> f64 { (0..12).map(|i| row[i] * v[3 * hinge.vertices[i / 3] as usize + i % 3]).sum() };
            let (angle, length) = (along(&fold.angle_gradient()), along(&fold.length_gradient()));
            out.iter_mut().zip(slopes).for_each(|(out, s)| *out += s[0] * angle + s[1] * length);
        })?;
        Ok(out)
    }
    /// Adds ∂(gradient)/∂Θ · direction [N] to `out`, shape [vertex][3]; `direction` in the parameters' units.
    ///
    /// # Errors
    /// As [`Bending::by_parameter`].
    pub fn add_by_direction(
        &self,
        state: &State<'_, f64>,
        weight: f64,
        direction: &[f64],
        out: &mut [f64],
    ) -> Result<()> {
        let x = only_frame("bending", state.positions)?;
        Error::check_length("parameter direction", self.material.parameters().len(), direction.len())?;
        Error::check_length("parameter derivative of bending's gradient", 3 * self.vertex_count, out.len())?;
        self.each_by_parameter(&x, weight, |hinge, fold, slopes| {
            let sum = |k: usize| slopes.iter().zip(direction).map(|(s, d)| s[k] * d).sum::<f64>();
            let (turn, pull) = (sum(0), sum(1));
            let (angle, length) = (fold.angle_gradient(), fold.length_gradient());
            for i in 0..12 {
                out[3 * hinge.vertices[i / 3] as usize + i % 3] += turn * angle[i] + pull * length[i];
            }
        })
    }
    /// Calls `f` with [∂turn/∂Θ, ∂pull/∂Θ] per parameter at every hinge.
    fn each_by_parameter(
        &self,
        x: &[[f64; 3]],
        weight: f64,
        mut f: impl FnMut(&Element<f64>, &Fold, &[[f64; 2]]),
    ) -> Result<()> {
        let facts = self.material.describe();
        let p = self.material.parameters().len();
        let current = facts.hinge_length != HingeLength::Rest;
        for (b, batch) in self.real().chunks(BATCH).enumerate() {
            let n = batch.len();
            let folds = Self::folds(batch, x);
            let question = Question::new(batch, &folds, current);
            let ask = |angle: &[f64], length: &[f64]| -> Result<Vec<f64>> {
                let mut out = vec![0.0; p * n];
                let mut block = question.block(angle, length);
                block.stiffness_by_parameter = (&mut out[..]).into();
                self.material.hinge((&mut block).into()).map_err(|e| self.locate_in(e, b, n))?;
                Ok(out)
            };
            let (angle, length) = (&question.angle[..], &question.length[..]);
            let k = ask(angle, length)?;
            // The gradient has dk/dτ and dk/dl unless stiffness is frozen; their derivatives by Θ are differenced.
            let differ = |ahead: Vec<f64>, behind: Vec<f64>, scale: &dyn Fn(usize) -> f64| -> Vec<f64> {
                (0..p * n).map(|i| quotient(ahead[i] - behind[i], 2.0 * STEP * scale(i % n))).collect()
            };
            let (mut by_angle, mut by_length) = (vec![0.0; p * n], vec![0.0; p * n]);
            if !facts.stiffness_frozen {
                by_angle = differ(ask(&shifted(angle, STEP), length)?, ask(&shifted(angle, -STEP), length)?, &|_| 1.0);
                if facts.hinge_length == HingeLength::Current {
                    let (longer, shorter) = (scaled(length, 1.0 + STEP), scaled(length, 1.0 - STEP));
                    by_length = differ(ask(angle, &longer)?, ask(angle, &shorter)?, &|i| length[i]);
                }
            }
            let mut slopes = vec![[0.0; 2]; p];
            for (i, (hinge, fold)) in batch.iter().zip(&folds).enumerate() {
                let Some(geometry) = fold else { continue };
                let scale = weight / (8.0 * hinge.area);
                let (fold, l) = (angle[i] - hinge.angle, length[i]);
                for (j, slope) in slopes.iter_mut().enumerate() {
                    let at = j * n + i;
                    slope[0] = scale * l * l * fold * (2.0 * k[at] + by_angle[at] * fold);
                    slope[1] = if facts.hinge_length == HingeLength::Current {
                        scale * fold * fold * l * (2.0 * k[at] + by_length[at] * l)
                    } else {
                        0.0
                    };
                }
                f(hinge, geometry, &slopes);
            }
        }
        Ok(())
    }
}

fn shifted(values: &[f64], by: f64) -> Vec<f64> {
    values.iter().map(|v| v + by).collect()
}
fn scaled(values: &[f64], by: f64) -> Vec<f64> {
    values.iter().map(|v| v * by).collect()
}
/// 0 for a collapsed edge, whose stiffness has no slope.
fn quotient(a: f64, b: f64) -> f64 {
    if b == 0.0 { 0.0 } else { a / b }
}

/// Second derivative of a hinge's energy to `out` `[12][12]`: turn d²τ + pull d²ℓ + [dτ dℓ] second [dτ dℓ]ᵀ.
fn block(fold: &Fold, slopes: &Slopes, kind: Tangent, out: &mut [f64]) {
    let Fold { angle, length, t, normals: [n0, n1], .. } = fold;
    let (m0, m1) = (n0.cross(t), t.cross(n1));
    // N0 = c P + s X and N1 = c P − s X with X = P × t.
    let (c, s) = ((0.5 * angle).cos(), -(0.5 * angle).sin());
    let p = n0 * c + t.cross(n0) * s;
    // Without area on side 0 the other side says where the mean normal is.
    let p = if p == Vec3::zeros() { n1 * c - t.cross(n1) * s } else { p };
    let x = p.cross(t);
    let half = std::f64::consts::FRAC_1_SQRT_2;
    let both = |d0: &Vec3, d1: &Vec3| -> [Row; 2] {
        let (a, b) = (fold.on_side(0, d0), fold.on_side(1, d1));
        [std::array::from_fn(|i| half * (a[i] + b[i])), std::array::from_fn(|i| half * (a[i] - b[i]))]
    };
    let [radial_sum, radial_difference] = both(&m0, &m1);
    let [normal_sum, normal_difference] = both(n0, n1);
    let [along_sum, along_difference] = both(t, t);
    let (tilt_p, tilt_x) = (Fold::on_edge(&(p / *length)), Fold::on_edge(&(x / *length)));
    let stretch = fold.length_gradient();

    let root = std::f64::consts::SQRT_2;
    let Slopes { turn, pull, second: [by_angle, angle_by_length, length_by_angle, by_length] } = *slopes;
    // Sum of both sides: the angle itself (normal_sum times √2) and the length live here.
    let mut sum = Matrix3::new(
        0.0,
        -turn,
        0.0,
        -turn,
        2.0 * by_angle,
        root * angle_by_length,
        0.0,
        root * length_by_angle,
        by_length,
    );
    let stiff = pull * length;
    let mut pairs = [
        (normal_difference, radial_difference, [0.0, -turn, 0.0]),
        (along_sum, tilt_p, [0.0, -root * c * turn, 2.0 * c * s * turn + stiff]),
        (along_difference, tilt_x, [0.0, -root * s * turn, -2.0 * c * s * turn + stiff]),
    ];
    if kind == Tangent::Projected {
        sum = clamp_3x3((sum + sum.transpose()) * 0.5);
        pairs.iter_mut().for_each(|pair| pair.2 = clamp_2x2(pair.2));
    }
    out.fill(0.0);
    let rows = [radial_sum, normal_sum, stretch];
    for i in 0..3 {
        let mixed: Row = std::array::from_fn(|k| (0..3).map(|j| sum[(i, j)] * rows[j][k]).sum());
        add_outer(&rows[i], &mixed, out);
    }
    for (first, second, [a, b, d]) in &pairs {
        let mixed: Row = std::array::from_fn(|k| a * first[k] + b * second[k]);
        add_outer(first, &mixed, out);
        let mixed: Row = std::array::from_fn(|k| b * first[k] + d * second[k]);
        add_outer(second, &mixed, out);
    }
}

#[inline(always)]
fn add_outer(left: &Row, right: &Row, out: &mut [f64]) {
    for (l, row) in left.iter().zip(out.chunks_exact_mut(12)) {
        for k in 0..12 {
            row[k] += l * right[k];
        }
    }
}

fn clamp_3x3(m: Matrix3<f64>) -> Matrix3<f64> {
    if m[(0, 2)] == 0.0 && m[(1, 2)] == 0.0 {
        let [a, b, d] = clamp_2x2([m[(0, 0)], m[(0, 1)], m[(1, 1)]]);
        return Matrix3::new(a, b, 0.0, b, d, 0.0, 0.0, 0.0, m[(2, 2)].max(0.0));
    }
    // No convergence is needed for safety: what comes back is checked by the factorisation.
    let Some(eigen) = SymmetricEigen::try_new(m, f64::EPSILON, 200) else { return Matrix3::zeros() };
    let mut out = Matrix3::zeros();
    for (value, vector) in eigen.eigenvalues.iter().zip(eigen.eigenvectors.column_iter()) {
        if *value > 0.0 {
            out += vector * vector.transpose() * *value;
        }
    }
    out
}

impl EnergyTangent for Bending<f64> {
    fn stencil(&self) -> Stencil {
        Stencil { width: 4, vertices: self.real().iter().flat_map(|h| h.vertices).collect() }
    }
    fn tangents(&self, state: &State<'_, f64>, weight: f64, kind: Tangent, blocks: &mut [f64]) -> Result<()> {
        let x = only_frame(self.name(), state.positions)?;
        Error::check_length("vertices of the garment in bending", self.vertex_count, x.len())?;
        Error::check_length("second derivatives of bending", 144 * self.count, blocks.len())?;
        let facts = self.material.describe();
        let results: Vec<Result<()>> = self
            .real()
            .par_chunks(BATCH)
            .zip(blocks.par_chunks_mut(144 * BATCH))
            .enumerate()
            .map(|(b, (batch, out))| {
                let folds = Self::folds(batch, &x);
                let slopes = self.slopes(b, batch, &folds, &facts, weight, kind)?;
                for ((fold, slopes), out) in folds.iter().zip(&slopes).zip(out.chunks_exact_mut(144)) {
                    match fold {
                        Some(fold) => block(fold, slopes, kind, out),
                        None => out.fill(0.0),
                    }
                }
                Ok(())
            })
            .collect();
        results.into_iter().collect()
    }
}
