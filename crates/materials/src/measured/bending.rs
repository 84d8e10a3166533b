//! Bending stiffness by fold direction and curvature (Eq. 7; reference note, 3).

use super::fabrics::{BEND_COLUMNS, BEND_ROWS, BendEntries};
use super::spec::BendingLookup;
use crate::angle::quarter_angle;
use crate::chunk::{CHUNK, Row, clamp, load, store};
use caphy_core::material::HingeBlock;
use caphy_core::{Real, simd_kernel};

/// Table coordinate of the last column: curvature 20 1/m.
const LAST: f64 = 4.0;
/// Curvature between columns [1/m].
const COLUMN: f64 = 5.0;
/// The faithful lookup extends the first segment without end; here it ends so far out that nothing overflows.
const RIDGE_END: f64 = -1e9;
/// Smallest area sum [m²]: a collapsed hinge is infinitely curved and saturates instead of dividing by zero.
const SMALLEST_AREA: f64 = 1e-30;
/// Largest slope of the table coordinate by angle or length; only collapsed hinges reach it.
const LARGEST_SLOPE: f64 = 1e20;
/// Index of the first bending entry among the native parameters, behind 24 stretching entries.
const FIRST_PARAMETER: usize = super::parameters::STRETCH_PARAMETERS;

/// The bending table as first column and rises, so that interpolation is a sum of clamped ramps without a gather.
#[derive(Clone, Copy)]
pub(super) struct BendCurves<T> {
    start: [T; BEND_ROWS],
    rise: [[T; BEND_COLUMNS - 1]; BEND_ROWS],
}

impl<T: Real> BendCurves<T> {
    /// From entries [N·m].
    pub(super) fn new(entries: &BendEntries) -> Self {
        let rise = |row: &[f64; BEND_COLUMNS]| std::array::from_fn(|j| T::of(row[j + 1] - row[j]));
        Self { start: entries.map(|row| T::of(row[0])), rise: std::array::from_fn(|r| rise(&entries[r])) }
    }
}

/// Share of segment j that lies below s: 0 before it, 1 behind it. The first may run on below zero.
#[inline(always)]
fn ramp<T: Real>(s: T, j: usize) -> T {
    let along = s - T::of(j as f64);
    let low = if j == 0 { T::of(RIDGE_END) } else { T::zero() };
    clamp(along, low, T::one())
}

/// 1 when s lies in segment j, else 0: the derivative of [`ramp`]. Both clamps count as outside.
#[inline(always)]
fn inside<T: Real>(s: T, j: usize) -> T {
    let low = T::of(if j == 0 { RIDGE_END } else { j as f64 });
    if s >= low && s < T::of(j as f64 + 1.0) { T::one() } else { T::zero() }
}

/// Weights of the rows at 0, 45 and 90° for a fold line along (du, dv); a zero direction counts as along u.
#[inline(always)]
fn row_weights<T: Real>(du: T, dv: T) -> [T; 3] {
    let b = quarter_angle(dv.abs(), du.abs()) * T::of(4.0 / std::f64::consts::PI);
    let (one, zero) = (T::one(), T::zero());
    let first = if b < one { one - b } else { zero };
    let last = if b > one { b - one } else { zero };
    [first, one - first - last, last]
}

#[inline(always)]
fn mix<T: Real>(weights: [T; 3], values: [T; 3]) -> T {
    weights[0] * values[0] + weights[1] * values[1] + weights[2] * values[2]
}

/// One piece of a block, before any output.
struct Piece<T> {
    /// Table coordinate s.
    s: Row<T>,
    /// Row weights of the side whose stiffness is used.
    weights: [Row<T>; 3],
    /// Stiffness [N·m], not negative.
    k: Row<T>,
}

simd_kernel! {
    /// Answers a checked block: k = min over both sides of max(0, bilinear).
    pub(super) fn hinge_by_table<T>(curves: BendCurves<T>, lookup: BendingLookup, block: &mut HingeBlock<'_, T>) {
        let n = block.count;
        let repaired = lookup == BendingLookup::Repaired;
        let (zero, ten) = (T::zero(), T::of(2.0 * COLUMN));
        let (angle, rest) = (block.angle.or_empty(), block.angle_rest.or_empty());
        let (length, area) = (block.length.or_empty(), block.area.or_empty());
        let (du0, dv0) = block.direction0.or_empty().split_at(n);
        let (du1, dv1) = block.direction1.or_empty().split_at(n);
        if let Some(out) = block.stiffness_by_parameter.get() {
            out.fill(zero);
        }
        let mut start = 0;
        while start < n {
            let (angle, rest) = (load(angle, start), load(rest, start));
            let (length, area) = (load(length, start), load(area, start));
            let (du0, dv0) = (load(du0, start), load(dv0, start));
            let (du1, dv1) = (load(du1, start), load(dv1, start));
            let mut piece = Piece { s: [zero; CHUNK], weights: [[zero; CHUNK]; 3], k: [zero; CHUNK] };
            // Signed fold for the faithful lookup, its size against the rest angle for the repaired one.
            let mut fold = [zero; CHUNK];
            let mut ten_area = [zero; CHUNK];
            for i in 0..CHUNK {
                let a = area[i];
                ten_area[i] = ten * if a > T::of(SMALLEST_AREA) { a } else { T::of(SMALLEST_AREA) };
                fold[i] = if repaired { (angle[i] - rest[i]).abs() } else { angle[i] };
                let low = if repaired { zero } else { T::of(RIDGE_END) };
                piece.s[i] = clamp(fold[i] * length[i] / ten_area[i], low, T::of(LAST));
            }
            for i in 0..CHUNK {
                let s = piece.s[i];
                let mut curve = curves.start;
                for r in 0..BEND_ROWS {
                    for j in 0..BEND_COLUMNS - 1 {
                        curve[r] += curves.rise[r][j] * ramp(s, j);
                    }
                }
                let side0 = row_weights(du0[i], dv0[i]);
                let side1 = row_weights(du1[i], dv1[i]);
                let (k0, k1) = (mix(side0, curve), mix(side1, curve));
                let second = k1 < k0;
                let k = if second { k1 } else { k0 };
                for r in 0..BEND_ROWS {
                    piece.weights[r][i] = if second { side1[r] } else { side0[r] };
                }
                piece.k[i] = if k > zero { k } else { zero };
            }
            if let Some(out) = block.stiffness.get() {
                store(out, start, &piece.k);
            }
            if block.stiffness_by_angle.wanted() || block.stiffness_by_length.wanted() {
                let largest = T::of(LARGEST_SLOPE);
                let mut slope = [zero; CHUNK];
                for i in 0..CHUNK {
                    let mut curve = [zero; BEND_ROWS];
                    for r in 0..BEND_ROWS {
                        for j in 0..BEND_COLUMNS - 1 {
                            curve[r] += curves.rise[r][j] * inside(piece.s[i], j);
                        }
                    }
                    let weights = [piece.weights[0][i], piece.weights[1][i], piece.weights[2][i]];
                    slope[i] = if piece.k[i] > zero { mix(weights, curve) } else { zero };
                }
                let mut out_piece = [zero; CHUNK];
                if let Some(out) = block.stiffness_by_angle.get() {
                    for i in 0..CHUNK {
                        let turn = angle[i] - rest[i];
                        // On the fold of |θ − θ_rest| the mean of both sides, 0.
                        let sign = if !repaired || turn > zero {
                            T::one()
                        } else if turn < zero {
                            -T::one()
                        } else {
                            zero
                        };
                        out_piece[i] = slope[i] * sign * clamp(length[i] / ten_area[i], -largest, largest);
                    }
                    store(out, start, &out_piece);
                }
                if let Some(out) = block.stiffness_by_length.get() {
                    for i in 0..CHUNK {
                        out_piece[i] = slope[i] * clamp(fold[i] / ten_area[i], -largest, largest);
                    }
                    store(out, start, &out_piece);
                }
            }
            if let Some(out) = block.stiffness_by_parameter.get() {
                for r in 0..BEND_ROWS {
                    for j in 0..BEND_COLUMNS {
                        let mut out_piece = [zero; CHUNK];
                        for i in 0..CHUNK {
                            let s = piece.s[i];
                            let before = if j == 0 { T::one() } else { ramp(s, j - 1) };
                            let behind = if j == BEND_COLUMNS - 1 { zero } else { ramp(s, j) };
                            let share = piece.weights[r][i] * (before - behind);
                            out_piece[i] = if piece.k[i] > zero { share } else { zero };
                        }
                        let parameter = FIRST_PARAMETER + r * BEND_COLUMNS + j;
                        store(&mut out[parameter * n..(parameter + 1) * n], start, &out_piece);
                    }
                }
            }
            start += CHUNK;
        }
    }
}
