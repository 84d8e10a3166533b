//! Bending energy (Eq. 7): Σ k l²/(8A) (τ − τ_T)² over hinges, with the material's k.

mod fade;
mod single;
mod tangent;

use super::arc_tangent::arc_tangent;
use super::{CHUNK, EnergyTerm, MAX_LANES, Row, State, add_blocks, add_row, pad_to_chunks, row};
use crate::{GarmentRest, RestHinge};
use caphy_core::array::Out;
use caphy_core::lanes::Frames;
use caphy_core::material::{HingeBlock, HingeLength, MaterialDescription, MaterialModel, MaterialReal};
use caphy_core::{Error, Real, Result, Vec3, simd_kernel};
use fade::Fade;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// A hinge with a face lower than this share of its edge, or an edge shorter than this share of a height, loses its bending energy:
/// a needle's dτ/dx stays bounded ([`fade`]).
const SMALLEST_HEIGHT: f64 = 1e-3;
/// Geometry kept between the two passes over a hinge: two unit normals over heights, two foot parameters, the edge's
/// direction, the share of the energy that is left.
const KEPT: usize = 12;
/// Where the share stands in it.
const SHARE: usize = 11;

/// What the dihedral angle is measured from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RestAngle {
    /// The template's angle τ_T (Eq. 7).
    #[default]
    Template,
    /// Zero: cloth that wants to be flat (SNUG).
    Flat,
}

/// A hinge at rest; `weight` is 0 for padding.
#[derive(Debug, Clone, Copy)]
struct Element<T> {
    vertices: [u32; 4],
    angle: T,
    length: T,
    area: T,
    direction0: [T; 2],
    direction1: [T; 2],
    weight: T,
}

/// Bending energy of a garment made of one material.
///
/// With frozen stiffness the gradient holds k; otherwise it includes dk/dτ (and dk/dl where the current length is
/// differentiated). The edge length follows [`HingeLength`] of the material.
///
/// Eq. 7's k is no plate rigidity, which a cylinder of curvature κ would show as ½ k κ² per area: the energy is 0.25 of that
/// along the sides of square cells and on equilateral triangles, 0.375 across cells with diagonals in turn, 0.25 or 0.75
/// across cells whose diagonals are all alike (`tests/all/material_patch.rs`). Template meshes are near equilateral.
pub struct Bending<T> {
    hinges: Vec<Element<T>>,
    /// Hinges that are not padding.
    count: usize,
    vertex_count: usize,
    material: Arc<dyn MaterialModel>,
    /// Stiffness and edge length of each hinge while they are held.
    held: Option<Vec<[T; 2]>>,
}

impl<T: MaterialReal> Bending<T> {
    /// From a rest state.
    pub fn new(rest: &GarmentRest, material: Arc<dyn MaterialModel>, rest_angle: RestAngle) -> Self {
        Self::of_hinges(&rest.hinges, rest.vertex_count(), material, rest_angle)
    }
    /// From hinges alone; all their vertices must be below `vertex_count`.
    pub fn of_hinges(
        hinges: &[RestHinge],
        vertex_count: usize,
        material: Arc<dyn MaterialModel>,
        rest_angle: RestAngle,
    ) -> Self {
        let mut hinges: Vec<_> = hinges
            .iter()
            .map(|h| Element {
                vertices: h.vertices,
                angle: match rest_angle {
                    RestAngle::Template => T::of(h.angle),
                    RestAngle::Flat => T::zero(),
                },
                length: T::of(h.length),
                area: T::of(h.area),
                direction0: h.direction0.map(T::of),
                direction1: h.direction1.map(T::of),
                weight: T::one(),
            })
            .collect();
        let count = hinges.len();
        pad_to_chunks(&mut hinges, |h| h.weight = T::zero());
        Self { hinges, count, vertex_count, material, held: None }
    }
    /// The same garment of another material; nothing is held.
    pub fn set_material(&mut self, material: Arc<dyn MaterialModel>) {
        self.material = material;
        self.held = None;
    }

    fn block(&self, step: usize, x: &[T], weight: f64, mut gradient: Option<&mut [T]>) -> Result<[f64; MAX_LANES]> {
        let facts = self.material.describe();
        let count = CHUNK * T::LANES;
        let mut input = Input::new(count);
        let mut kept = vec![T::zero(); KEPT * count];
        let mut stiffness = vec![T::zero(); count];
        let mut by_angle = vec![T::zero(); count];
        let mut by_length = vec![T::zero(); count];
        let mut energy = [0.0; MAX_LANES];
        let current = facts.hinge_length != HingeLength::Rest;
        let length_flows = facts.hinge_length == HingeLength::Current;
        for (c, chunk) in self.hinges.chunks_exact(CHUNK).enumerate() {
            measure(chunk, current, x, &mut input, &mut kept);
            if let Some(held) = &self.held {
                let held = &held[c * CHUNK..][..CHUNK];
                for (i, [k, length]) in held.iter().enumerate() {
                    let at = i * T::LANES..(i + 1) * T::LANES;
                    stiffness[at.clone()].fill(*k);
                    if facts.hinge_length == HingeLength::CurrentHeld {
                        input.length[at].fill(*length);
                    }
                }
            } else {
                self.ask(&facts, gradient.is_some(), &input, &mut stiffness, &mut by_angle, &mut by_length)
                    .map_err(|e| self.locate(e, step, c))?;
            }
            sum(chunk, T::of(weight), &input, &kept, &stiffness, &mut energy);
            if let Some(gradient) = gradient.as_deref_mut() {
                let slopes = (&by_angle[..], &by_length[..]);
                scatter(chunk, length_flows, T::of(weight), x, &input, &kept, &stiffness, slopes, gradient);
            }
        }
        Ok(energy)
    }
    /// The material's k for a chunk, and its slopes where the gradient has them.
    fn ask(
        &self,
        facts: &MaterialDescription,
        gradient: bool,
        input: &Input<T>,
        stiffness: &mut [T],
        by_angle: &mut [T],
        by_length: &mut [T],
    ) -> Result<()> {
        let mut block = HingeBlock::new(
            stiffness.len(),
            [&input.angle, &input.angle_rest, &input.length, &input.area],
            [&input.direction0, &input.direction1],
        );
        block.stiffness = Out::from(stiffness);
        if gradient && !facts.stiffness_frozen {
            block.stiffness_by_angle = Out::from(by_angle);
            if facts.hinge_length == HingeLength::Current {
                block.stiffness_by_length = Out::from(by_length);
            }
        }
        T::hinge(&*self.material, &mut block)
    }
    /// Says where a fold was that the material refused.
    fn locate(&self, error: Error, step: usize, chunk: usize) -> Error {
        let Error::NonFinite { what, index, value } = error else { return error };
        let element = index % (CHUNK * T::LANES);
        let (hinge, window) = (chunk * CHUNK + element / T::LANES, element % T::LANES);
        let [n0, n1, ..] = self.hinges[hinge].vertices;
        Error::numerics(
            "energy `bending`",
            format!("{what} is {value} at edge {n0}-{n1} of step {step}, window {window}"),
            "go back to the last good state with a smaller step, and check that the template is in metres",
        )
    }
}

impl<T: MaterialReal> EnergyTerm<T> for Bending<T> {
    fn name(&self) -> &'static str {
        "bending"
    }
    fn add(
        &self,
        state: &State<'_, T>,
        weight: f64,
        energy: &mut [f64],
        gradient: Option<&mut Frames<T>>,
    ) -> Result<()> {
        add_blocks("bending", self.vertex_count, state.positions, energy, gradient, |b, part| {
            self.block(b, state.positions.block(b), weight, part)
        })
    }
}

/// Arrays of a hinge block, `[component][hinge][lane]`.
struct Input<T> {
    angle: Vec<T>,
    angle_rest: Vec<T>,
    length: Vec<T>,
    area: Vec<T>,
    direction0: Vec<T>,
    direction1: Vec<T>,
}

impl<T: Real> Input<T> {
    fn new(count: usize) -> Self {
        let zeros = |n: usize| vec![T::zero(); n];
        Self {
            angle: zeros(count),
            angle_rest: zeros(count),
            length: zeros(count),
            area: zeros(count),
            direction0: zeros(2 * count),
            direction1: zeros(2 * count),
        }
    }
}

/// Angle, length and what [`forces`] needs (`[12][lane]`) of the hinges in a register's lanes, vertices `[xyz][lane]`.
#[inline(always)]
fn geometry<T: Real>(
    [x0, x1, x2, x3]: [&[T]; 4],
    angle: &mut [T; MAX_LANES],
    length: &mut [T; MAX_LANES],
    keep: &mut [T],
) {
    let lanes = T::LANES;
    let tiny = T::of(fade::TINY);
    let mut needle = false;
    let floor = T::of(SMALLEST_HEIGHT * SMALLEST_HEIGHT);
    for l in 0..lanes {
        let (m, n) = (lanes + l, 2 * lanes + l);
        let (ex, ey, ez) = (x1[l] - x0[l], x1[m] - x0[m], x1[n] - x0[n]);
        let (ax, ay, az) = (x2[l] - x0[l], x2[m] - x0[m], x2[n] - x0[n]);
        let (bx, by, bz) = (x3[l] - x0[l], x3[m] - x0[m], x3[n] - x0[n]);
        // Normals n0 = e × a, n1 = b × e: twice the faces' areas long.
        let (px, py, pz) = (ey * az - ez * ay, ez * ax - ex * az, ex * ay - ey * ax);
        let (qx, qy, qz) = (by * ez - bz * ey, bz * ex - bx * ez, bx * ey - by * ex);
        let ee = ex * ex + ey * ey + ez * ez;
        let edge = ee.sqrt();
        // −ê·(n0 × n1) = |e| n0·b, see `dihedral_angle`.
        angle[l] = arc_tangent(edge * (px * bx + py * by + pz * bz), px * qx + py * qy + pz * qz);
        length[l] = edge;
        let (pp, qq) = (px * px + py * py + pz * pz, qx * qx + qy * qy + qz * qz);
        // |n| = |e| h, so N/h = n |e| / |n|².
        let least = floor * ee * ee + tiny;
        needle |= fade::is_thin(pp, ee) | fade::is_thin(qq, ee);
        let sp = edge / if pp > least { pp } else { least };
        let sq = edge / if qq > least { qq } else { least };
        let inverse = T::one() / (ee + tiny);
        let direction = edge * inverse;
        keep[l] = px * sp;
        keep[lanes + l] = py * sp;
        keep[2 * lanes + l] = pz * sp;
        keep[3 * lanes + l] = qx * sq;
        keep[4 * lanes + l] = qy * sq;
        keep[5 * lanes + l] = qz * sq;
        keep[6 * lanes + l] = (ax * ex + ay * ey + az * ez) * inverse;
        keep[7 * lanes + l] = (bx * ex + by * ey + bz * ez) * inverse;
        keep[8 * lanes + l] = ex * direction;
        keep[9 * lanes + l] = ey * direction;
        keep[10 * lanes + l] = ez * direction;
        keep[11 * lanes + l] = T::one();
    }
    if needle {
        fade_lanes([x0, x1, x2, x3], keep);
    }
}

/// Whether a hinge is one of those that lose their energy.
pub(super) fn is_needle(x: [Vec3; 4]) -> bool {
    Fade::new(x).is_some()
}

/// The vertices of one lane.
fn lane_of<T: Real>(x: [&[T]; 4], l: usize) -> [Vec3; 4] {
    x.map(|x| Vec3::new(x[l].to_f64(), x[T::LANES + l].to_f64(), x[2 * T::LANES + l].to_f64()))
}

/// Corrects what is kept of hinges with a needle.
#[cold]
fn fade_lanes<T: Real>(x: [&[T]; 4], keep: &mut [T]) {
    for l in 0..T::LANES {
        if let Some(fade) = Fade::new(lane_of(x, l)) {
            for k in 0..3 {
                keep[k * T::LANES + l] = T::of(fade.turns[0][k]);
                keep[(3 + k) * T::LANES + l] = T::of(fade.turns[1][k]);
            }
            keep[11 * T::LANES + l] = T::of(fade.share);
        }
    }
}

/// Adds to the forces of [`forces`] what comes from the share of needles itself; `energy`: that of whole hinges.
#[cold]
fn fade_forces<T: Real>(x: [&[T]; 4], energy: &[T; MAX_LANES], rows: &mut [Row<T>; 4]) {
    for l in 0..T::LANES {
        if let Some(fade) = Fade::new(lane_of(x, l)) {
            for (row, gradient) in rows.iter_mut().zip(&fade.gradient) {
                for k in 0..3 {
                    row[k * T::LANES + l] += energy[l] * T::of(gradient[k]);
                }
            }
        }
    }
}

/// Forces on the four vertices of the hinges in a register's lanes, from dE/dτ and dE/dl.
#[inline(always)]
fn forces<T: Real>(turn: &[T; MAX_LANES], pull: &[T; MAX_LANES], kept: &[T]) -> [Row<T>; 4] {
    let lanes = T::LANES;
    let mut g0 = [T::zero(); 3 * MAX_LANES];
    let mut g1 = [T::zero(); 3 * MAX_LANES];
    let mut g2 = [T::zero(); 3 * MAX_LANES];
    let mut g3 = [T::zero(); 3 * MAX_LANES];
    for axis in 0..3 {
        for l in 0..lanes {
            let i = axis * lanes + l;
            let (a, b) = (turn[l] * kept[i], turn[l] * kept[3 * lanes + i]);
            // The foot of each height shares the opposite of its force between the edge's ends.
            let along = kept[6 * lanes + l] * a + kept[7 * lanes + l] * b;
            let stretch = pull[l] * kept[8 * lanes + i];
            g2[i] = a;
            g3[i] = b;
            g1[i] = stretch - along;
            g0[i] = along - a - b - stretch;
        }
    }
    [g0, g1, g2, g3]
}

simd_kernel! {
    /// Angle and length of each hinge, the rest quantities spread over lanes, and what [`scatter`] needs to `kept`
    /// `[hinge][11][lane]`.
    fn measure<T>(chunk: &[Element<T>], current: bool, x: &[T], input: &mut Input<T>, kept: &mut [T]) {
        let lanes = T::LANES;
        let count = CHUNK * lanes;
        for (i, hinge) in chunk.iter().enumerate() {
            let [x0, x1, x2, x3] = hinge.vertices;
            let (x0, x1, x2, x3) = (row(x, x0), row(x, x1), row(x, x2), row(x, x3));
            let mut angle = [T::zero(); MAX_LANES];
            let mut length = [T::zero(); MAX_LANES];
            let keep = &mut kept[i * KEPT * lanes..][..KEPT * lanes];
            geometry([x0, x1, x2, x3], &mut angle, &mut length, keep);
            let at = i * lanes;
            input.angle[at..][..lanes].copy_from_slice(&angle[..lanes]);
            if current {
                input.length[at..][..lanes].copy_from_slice(&length[..lanes]);
            } else {
                input.length[at..][..lanes].fill(hinge.length);
            }
            input.angle_rest[at..][..lanes].fill(hinge.angle);
            input.area[at..][..lanes].fill(hinge.area);
            for k in 0..2 {
                input.direction0[k * count + at..][..lanes].fill(hinge.direction0[k]);
                input.direction1[k * count + at..][..lanes].fill(hinge.direction1[k]);
            }
        }
    }
}

simd_kernel! {
    /// Adds Σ k l²/(8A)(τ − τ_T)² per lane (Eq. 7): in T within a chunk, in f64 across chunks.
    fn sum<T>(
        chunk: &[Element<T>],
        weight: T,
        input: &Input<T>,
        kept: &[T],
        stiffness: &[T],
        energy: &mut [f64; MAX_LANES],
    ) {
        let lanes = T::LANES;
        let mut total = [T::zero(); MAX_LANES];
        for (i, hinge) in chunk.iter().enumerate() {
            let factor = hinge.weight / (T::of(8.0) * hinge.area);
            let at = i * lanes;
            let share = &kept[at * KEPT + SHARE * lanes..][..lanes];
            let (angle, length, k) =
                (&input.angle[at..][..lanes], &input.length[at..][..lanes], &stiffness[at..][..lanes]);
            for l in 0..lanes {
                let fold = angle[l] - hinge.angle;
                total[l] += factor * k[l] * length[l] * length[l] * fold * fold * share[l];
            }
        }
        for l in 0..lanes {
            energy[l] += (weight * total[l]).to_f64();
        }
    }
}

simd_kernel! {
    /// Adds the gradient of Eq. 7 to the four vertices.
    fn scatter<T>(
        chunk: &[Element<T>],
        length_flows: bool,
        weight: T,
        x: &[T],
        input: &Input<T>,
        kept: &[T],
        stiffness: &[T],
        slopes: (&[T], &[T]),
        gradient: &mut [T],
    ) {
        let lanes = T::LANES;
        let flow = if length_flows { T::one() } else { T::zero() };
        for (i, hinge) in chunk.iter().enumerate() {
            let factor = weight * hinge.weight / (T::of(8.0) * hinge.area);
            let at = i * lanes;
            let (angle, length, k) =
                (&input.angle[at..][..lanes], &input.length[at..][..lanes], &stiffness[at..][..lanes]);
            let (by_angle, by_length) = (&slopes.0[at..][..lanes], &slopes.1[at..][..lanes]);
            let kept = &kept[at * KEPT..][..KEPT * lanes];
            let mut turn = [T::zero(); MAX_LANES];
            let mut pull = [T::zero(); MAX_LANES];
            let share = &kept[SHARE * lanes..][..lanes];
            let mut needle = false;
            for l in 0..lanes {
                let fold = angle[l] - hinge.angle;
                needle |= share[l] != T::one();
                // dE/dτ and dE/dl.
                turn[l] = factor * length[l] * length[l] * fold * (k[l] + k[l] + by_angle[l] * fold);
                pull[l] = flow * share[l] * factor * fold * fold * length[l] * (k[l] + k[l] + by_length[l] * length[l]);
            }
            let mut rows = forces(&turn, &pull, kept);
            if needle {
                let mut whole = [T::zero(); MAX_LANES];
                for l in 0..lanes {
                    let fold = angle[l] - hinge.angle;
                    whole[l] = factor * k[l] * length[l] * length[l] * fold * fold;
                }
                fade_forces(hinge.vertices.map(|v| row(x, v)), &whole, &mut rows);
            }
            for (vertex, row) in hinge.vertices.into_iter().zip(&rows) {
                add_row(gradient, vertex, row);
            }
        }
    }
}
