//! The 30³ table in which the shipped simulator keeps the stretching stiffness (reference note, 2.2).

use super::fabrics::{STRETCH_COLUMNS, STRETCH_ROWS, StretchEntries};
use super::membrane::{Jet, Lookup, Rule, Stiffness, WeightsJet, answer};
use super::point::{add_weights, doubled, stiffness_at};
use super::sample_point::{SamplePoint, sample_point};
use crate::chunk::{CHUNK, Row, clamp, index};
use caphy_core::material::MembraneBlock;
use caphy_core::{Real, simd_kernel};
use std::sync::Arc;

/// Nodes per axis.
const SIDE: usize = 30;
/// Nodes per unit of strain.
const DENSITY: f64 = 30.0;
/// Strain of the first node on the Guu and Gvv axes.
const FIRST: f64 = -0.25;
/// Largest grid coordinate: inside the last cell.
const LAST: f64 = 29.0 - 1e-5;
/// Values between neighbours along Guu, Gvv, Guv.
const STEP: [usize; 3] = [SIDE * SIDE * 4, SIDE * 4, 4];
/// Values from a cell's first node to the end of its last.
const CELL: usize = STEP[0] + STEP[1] + STEP[2] + 4;

/// Where each node falls in the published table: the part that no parameter changes.
#[derive(Debug)]
struct NodePoints(Vec<SamplePoint<f64>>);

impl NodePoints {
    fn new() -> Self {
        let strain = |i: usize| i as f64 / DENSITY;
        let mut points = Vec::with_capacity(SIDE * SIDE * SIDE);
        for u in 0..SIDE {
            for v in 0..SIDE {
                for w in 0..SIDE {
                    points.push(sample_point(FIRST + strain(u), FIRST + strain(v), strain(w)));
                }
            }
        }
        Self(points)
    }
}

/// The table of one set of entries, in both precisions, nodes `[Guu][Gvv][|Guv|][k0, k1, k2, k3]` [N/m].
#[derive(Debug)]
pub(super) struct StretchTable {
    points: Arc<NodePoints>,
    single: Vec<f32>,
    double: Vec<f64>,
}

impl StretchTable {
    /// Tabulates the entries.
    pub(super) fn new(entries: &StretchEntries) -> Self {
        Self::tabulate(Arc::new(NodePoints::new()), entries)
    }
    /// Tabulates other entries on the same nodes, whose sample points are kept.
    pub(super) fn with_entries(&self, entries: &StretchEntries) -> Self {
        Self::tabulate(Arc::clone(&self.points), entries)
    }
    fn tabulate(points: Arc<NodePoints>, entries: &StretchEntries) -> Self {
        let doubled = doubled(entries);
        let double: Vec<f64> = points.0.iter().flat_map(|p| stiffness_at(&doubled, *p)).collect();
        let single = double.iter().map(|k| *k as f32).collect();
        Self { points, single, double }
    }
    /// The lookup in single precision.
    pub(super) fn single(&self) -> TableLookup<'_, f32> {
        TableLookup { points: &self.points.0, nodes: &self.single }
    }
    /// The lookup in double precision.
    pub(super) fn double(&self) -> TableLookup<'_, f64> {
        TableLookup { points: &self.points.0, nodes: &self.double }
    }
}

/// Trilinear interpolation in a [`StretchTable`].
#[derive(Clone, Copy)]
pub(super) struct TableLookup<'a, T> {
    points: &'a [SamplePoint<f64>],
    nodes: &'a [T],
}

/// Grid coordinates (x, y, z) of a strain before clamping.
#[inline(always)]
fn coordinates<T: Real>(green: [T; 3]) -> [T; 3] {
    let density = T::of(DENSITY);
    [density * (green[0] - T::of(FIRST)), density * (green[1] - T::of(FIRST)), density * green[2].abs()]
}

/// First node (as an index into the values), fractions, and derivatives of the clamped coordinates by G.
#[inline(always)]
fn cell<T: Real>(green: [T; 3]) -> (usize, [T; 3], [T; 3]) {
    let raw = coordinates(green);
    let mut first = 0;
    let mut fraction = [T::zero(); 3];
    let mut slope = [T::zero(); 3];
    for axis in 0..3 {
        let inside = clamp(raw[axis], T::zero(), T::of(LAST));
        let whole = inside.floor();
        fraction[axis] = inside - whole;
        first += index(whole) * STEP[axis];
        if raw[axis] >= T::zero() && raw[axis] < T::of(LAST) {
            slope[axis] = T::of(DENSITY);
        }
    }
    // |Guv|: the slope turns with the sign and is given as 0 on the fold itself.
    if green[2] < T::zero() {
        slope[2] = -slope[2];
    } else if green[2] == T::zero() {
        slope[2] = T::zero();
    }
    (first, fraction, slope)
}

#[inline(always)]
fn four<T: Real>(values: &[T], start: usize) -> [T; 4] {
    [values[start], values[start + 1], values[start + 2], values[start + 3]]
}

impl<T: Real> Lookup<T> for TableLookup<'_, T> {
    #[inline(always)]
    fn stiffness(&self, green: &[Row<T>; 3], out: &mut Stiffness<T>) {
        let mut fraction = [[T::zero(); CHUNK]; 3];
        let mut first = [0i32; CHUNK];
        let (zero, last) = (T::zero(), T::of(LAST));
        for i in 0..CHUNK {
            let raw = coordinates([green[0][i], green[1][i], green[2][i]]);
            let x = clamp(raw[0], zero, last);
            let y = clamp(raw[1], zero, last);
            let z = clamp(raw[2], zero, last);
            let (a, b, c) = (x.floor(), y.floor(), z.floor());
            fraction[0][i] = x - a;
            fraction[1][i] = y - b;
            fraction[2][i] = z - c;
            // Below 27000: exact in either precision.
            let side = T::of(SIDE as f64);
            first[i] = ((a * side + b) * side + c).to_f64() as i32;
        }
        for i in 0..CHUNK {
            let start = first[i] as usize * 4;
            let rows = &self.nodes[start..start + CELL];
            let (fx, fy, fz) = (fraction[0][i], fraction[1][i], fraction[2][i]);
            // Both nodes of a |Guv| pair are neighbours in memory: eight values at a time.
            let mut pair = [zero; 8];
            for j in 0..8 {
                let low = rows[j] + fx * (rows[STEP[0] + j] - rows[j]);
                let high = rows[STEP[1] + j] + fx * (rows[STEP[0] + STEP[1] + j] - rows[STEP[1] + j]);
                pair[j] = low + fy * (high - low);
            }
            for a in 0..4 {
                out[i][a] = pair[a] + fz * (pair[4 + a] - pair[a]);
            }
        }
    }

    #[inline(always)]
    fn jet(&self, green: [T; 3]) -> Jet<T> {
        let (first, f, slope) = cell(green);
        let corner = |u: usize, v: usize, w: usize| four(self.nodes, first + u * STEP[0] + v * STEP[1] + w * STEP[2]);
        let (c000, c001, c010, c011) = (corner(0, 0, 0), corner(0, 0, 1), corner(0, 1, 0), corner(0, 1, 1));
        let (c100, c101, c110, c111) = (corner(1, 0, 0), corner(1, 0, 1), corner(1, 1, 0), corner(1, 1, 1));
        let zero = [T::zero(); 4];
        let mut jet = Jet { value: zero, slope: [zero; 3], mixed: [zero; 3] };
        let lerp = |a: T, b: T, t: T| a + t * (b - a);
        for a in 0..4 {
            // Along Guu first, keeping both value and difference on the four remaining edges.
            let edge = [
                (c000[a], c100[a] - c000[a]),
                (c001[a], c101[a] - c001[a]),
                (c010[a], c110[a] - c010[a]),
                (c011[a], c111[a] - c011[a]),
            ];
            let at = edge.map(|(low, rise)| low + f[0] * rise);
            let rise = edge.map(|e| e.1);
            let (low, high) = (lerp(at[0], at[2], f[1]), lerp(at[1], at[3], f[1]));
            jet.value[a] = lerp(low, high, f[2]);
            let (rise_low, rise_high) = (lerp(rise[0], rise[2], f[1]), lerp(rise[1], rise[3], f[1]));
            jet.slope[0][a] = slope[0] * lerp(rise_low, rise_high, f[2]);
            jet.slope[1][a] = slope[1] * lerp(at[2] - at[0], at[3] - at[1], f[2]);
            jet.slope[2][a] = slope[2] * (high - low);
            jet.mixed[0][a] = slope[0] * slope[1] * lerp(rise[2] - rise[0], rise[3] - rise[1], f[2]);
            jet.mixed[1][a] = slope[0] * slope[2] * (rise_high - rise_low);
            jet.mixed[2][a] = slope[1] * slope[2] * ((at[3] - at[2]) - (at[1] - at[0]));
        }
        jet
    }

    #[inline(always)]
    fn weights(&self, green: [T; 3]) -> WeightsJet<T> {
        let (first, f, slope) = cell(green);
        let zero = [[T::zero(); STRETCH_COLUMNS]; STRETCH_ROWS];
        let mut weights = WeightsJet { value: zero, slope: [zero; 3] };
        for corner in 0..8usize {
            let side = [corner & 1, (corner >> 1) & 1, corner >> 2];
            let node = first + side[0] * STEP[0] + side[1] * STEP[1] + side[2] * STEP[2];
            let mut share = [T::zero(); 3];
            let mut rise = [T::zero(); 3];
            for axis in 0..3 {
                let up = side[axis] == 1;
                share[axis] = if up { f[axis] } else { T::one() - f[axis] };
                rise[axis] = if up { slope[axis] } else { -slope[axis] };
            }
            // Where the clamp max(0, ·) holds a node at zero, its entries have no influence.
            let active = four(self.nodes, node).map(|k| k > T::zero());
            let point = self.points[node / 4];
            let point = SamplePoint { stretch: T::of(point.stretch), angle: T::of(point.angle) };
            add_weights(point, share[0] * share[1] * share[2], active, &mut weights.value);
            add_weights(point, rise[0] * share[1] * share[2], active, &mut weights.slope[0]);
            add_weights(point, share[0] * rise[1] * share[2], active, &mut weights.slope[1]);
            add_weights(point, share[0] * share[1] * rise[2], active, &mut weights.slope[2]);
        }
        weights
    }
}

simd_kernel! {
    /// Answers a checked block by table lookup.
    pub(super) fn membrane_by_table<T>(lookup: TableLookup<'_, T>, rule: Rule, block: &mut MembraneBlock<'_, T>) {
        answer(&lookup, rule, block);
    }
}
