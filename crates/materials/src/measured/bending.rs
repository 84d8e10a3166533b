//! Bending stiffness by fold direction and curvature (Eq. 7; reference note, 3).

use super::fabrics::{BEND_COLUMNS, BEND_ROWS, BendEntries};
use super::spec::BendingLookup;
use crate::angle::eighth_angle;
use crate::chunk::{CHUNK, Row, clamp, in_pieces, write};
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

/// Where a fold line along (du, dv) lies between the rows at 0, 45 and 90°: whether it is beyond 45°, and the middle row's
/// weight; the rest goes to the row on its side. A zero direction counts as along u.
#[inline(always)]
fn between_rows<T: Real>(du: T, dv: T) -> (bool, T) {
    let (u, v) = (du.abs(), dv.abs());
    let steep = v > u;
    let (small, large) = if steep { (u, v) } else { (v, u) };
    (steep, eighth_angle(small, large) * T::of(4.0 / std::f64::consts::PI))
}

/// Weights of the three rows.
#[inline(always)]
fn row_weights<T: Real>((steep, middle): (bool, T)) -> [T; 3] {
    let (zero, outer) = (T::zero(), T::one() - middle);
    if steep { [zero, middle, outer] } else { [outer, middle, zero] }
}

/// The curves' value there.
#[inline(always)]
fn along_rows<T: Real>((steep, middle): (bool, T), curve: [T; 3]) -> T {
    let outer = if steep { curve[2] } else { curve[0] };
    outer + middle * (curve[1] - outer)
}

#[inline(always)]
fn mix<T: Real>(weights: [T; 3], values: [T; 3]) -> T {
    weights[0] * values[0] + weights[1] * values[1] + weights[2] * values[2]
}

/// What every output of a piece is made of.
struct Lookup<T> {
    /// Signed fold for the faithful lookup, its size against the rest angle for the repaired one [rad].
    fold: Row<T>,
    /// Ten times the area sum [m²], never zero.
    ten_area: Row<T>,
    /// Table coordinate s.
    s: Row<T>,
    /// Row weights of the side whose stiffness is used.
    weights: [Row<T>; 3],
    /// Stiffness [N·m], not negative.
    k: Row<T>,
}

/// The hinges of a piece.
struct Piece<'a, T> {
    angle: &'a Row<T>,
    rest: &'a Row<T>,
    length: &'a Row<T>,
    area: &'a Row<T>,
    /// (du, dv) on both sides.
    directions: [[&'a Row<T>; 2]; 2],
}

/// Stiffness of a piece, and with `DERIVATIVES` what its derivatives are made of.
#[inline(always)]
fn look_up<T: Real, const REPAIRED: bool, const DERIVATIVES: bool>(
    curves: &BendCurves<T>,
    hinges: &Piece<'_, T>,
    l: &mut Lookup<T>,
) {
    let (zero, ten) = (T::zero(), T::of(2.0 * COLUMN));
    let low = if REPAIRED { zero } else { T::of(RIDGE_END) };
    let [[du0, dv0], [du1, dv1]] = hinges.directions;
    for i in 0..CHUNK {
        let a = hinges.area[i];
        let ten_area = ten * if a > T::of(SMALLEST_AREA) { a } else { T::of(SMALLEST_AREA) };
        let fold = if REPAIRED { (hinges.angle[i] - hinges.rest[i]).abs() } else { hinges.angle[i] };
        let s = clamp(fold * hinges.length[i] / ten_area, low, T::of(LAST));
        let mut curve = curves.start;
        for j in 0..BEND_COLUMNS - 1 {
            let along = ramp(s, j);
            for r in 0..BEND_ROWS {
                curve[r] += curves.rise[r][j] * along;
            }
        }
        let side0 = between_rows(du0[i], dv0[i]);
        let side1 = between_rows(du1[i], dv1[i]);
        let (k0, k1) = (along_rows(side0, curve), along_rows(side1, curve));
        let second = k1 < k0;
        let k = if second { k1 } else { k0 };
        l.k[i] = if k > zero { k } else { zero };
        if DERIVATIVES {
            let weights = row_weights(if second { side1 } else { side0 });
            for r in 0..BEND_ROWS {
                l.weights[r][i] = weights[r];
            }
            l.s[i] = s;
            l.fold[i] = fold;
            l.ten_area[i] = ten_area;
        }
    }
}

simd_kernel! {
    /// Answers a checked block: k = min over both sides of max(0, bilinear).
    pub(super) fn hinge_by_table<T>(curves: BendCurves<T>, lookup: BendingLookup, block: &mut HingeBlock<'_, T>) {
        let n = block.count;
        let repaired = lookup == BendingLookup::Repaired;
        let zero = T::zero();
        let (angle, rest) = (block.angle.or_empty(), block.angle_rest.or_empty());
        let (length, area) = (block.length.or_empty(), block.area.or_empty());
        let (du0, dv0) = block.direction0.or_empty().split_at(n);
        let (du1, dv1) = block.direction1.or_empty().split_at(n);
        if let Some(out) = block.stiffness_by_parameter.get() {
            out.fill(zero);
        }
        let derivatives = block.stiffness_by_angle.wanted()
            || block.stiffness_by_length.wanted()
            || block.stiffness_by_parameter.wanted();
        let row = [zero; CHUNK];
        let mut l = Lookup { fold: row, ten_area: row, s: row, weights: [row; 3], k: row };
        let mut start = 0;
        while start < n {
            in_pieces!(start; angle, rest, length, area, du0, dv0, du1, dv1);
            let hinges = Piece { angle, rest, length, area, directions: [[du0, dv0], [du1, dv1]] };
            // What is wanted is settled before the loop: inside of it, AVX2 has only slow conditional stores for it.
            match (repaired, derivatives) {
                (true, false) => look_up::<T, true, false>(&curves, &hinges, &mut l),
                (true, true) => look_up::<T, true, true>(&curves, &hinges, &mut l),
                (false, false) => look_up::<T, false, false>(&curves, &hinges, &mut l),
                (false, true) => look_up::<T, false, true>(&curves, &hinges, &mut l),
            }
            if let Some(out) = block.stiffness.get() {
                write(out, start, |i| l.k[i]);
            }
            if block.stiffness_by_angle.wanted() || block.stiffness_by_length.wanted() {
                let largest = T::of(LARGEST_SLOPE);
                let mut slope = [zero; CHUNK];
                for i in 0..CHUNK {
                    let mut curve = [zero; BEND_ROWS];
                    for r in 0..BEND_ROWS {
                        for j in 0..BEND_COLUMNS - 1 {
                            curve[r] += curves.rise[r][j] * inside(l.s[i], j);
                        }
                    }
                    let weights = [l.weights[0][i], l.weights[1][i], l.weights[2][i]];
                    slope[i] = if l.k[i] > zero { mix(weights, curve) } else { zero };
                }
                if let Some(out) = block.stiffness_by_angle.get() {
                    write(out, start, |i| {
                        let turn = angle[i] - rest[i];
                        // On the fold of |θ − θ_rest| the mean of both sides, 0.
                        let sign = if !repaired || turn > zero {
                            T::one()
                        } else if turn < zero {
                            -T::one()
                        } else {
                            zero
                        };
                        slope[i] * sign * clamp(length[i] / l.ten_area[i], -largest, largest)
                    });
                }
                if let Some(out) = block.stiffness_by_length.get() {
                    write(out, start, |i| slope[i] * clamp(l.fold[i] / l.ten_area[i], -largest, largest));
                }
            }
            if let Some(out) = block.stiffness_by_parameter.get() {
                for r in 0..BEND_ROWS {
                    for j in 0..BEND_COLUMNS {
                        let parameter = FIRST_PARAMETER + r * BEND_COLUMNS + j;
                        write(&mut out[parameter * n..(parameter + 1) * n], start, |i| {
                            let s = l.s[i];
                            let before = if j == 0 { T::one() } else { ramp(s, j - 1) };
                            let behind = if j == BEND_COLUMNS - 1 { zero } else { ramp(s, j) };
                            if l.k[i] > zero { l.weights[r][i] * (before - behind) } else { zero }
                        });
                    }
                }
            }
            start += CHUNK;
        }
    }
}
