//! Exact nearest points of many frames at once, one frame per lane.
//!
//! A body's neighbourhoods are the same in every pose. So its points are grouped once, in the rest pose, and a frame only
//! needs the boxes of the groups. All lanes of a block then look at the same points at the same time: distances to one
//! point in 16 frames are three loads and a few operations, where a grid per frame has to find each of them alone.

use crate::{Real, Vec3, simd_kernel};

/// Points of a group: few enough that boxes are tight, enough that a box is worth its test; as many as a mask has bits.
const GROUP: usize = u8::BITS as usize;
/// Groups that share an outer box.
const OUTER: usize = 8;
/// The widest register, in values.
const MAX_LANES: usize = 16;
/// Values of a box per lane: low corner, high corner.
const BOX: usize = 6;

/// Points in groups that stay together, for searches over frames in lanes (see [`crate::lanes`]).
///
/// Answers are exact whatever the groups are: those of a pose in which nothing lies together are slow, not wrong. Distances
/// are rounded as those of [`NearestGrid`](super::NearestGrid), equal ones go to the smallest id, so both give the same bits.
#[derive(Debug, Clone, PartialEq)]
pub struct NearestInLanes {
    /// Ids group by group; all groups are full but the last.
    ids: Vec<u32>,
}

/// Boxes of all groups in one block of frames, `[group][low xyz, high xyz][lane]`.
#[derive(Debug, Clone)]
pub struct LaneBoxes<T> {
    groups: Vec<T>,
    outer: Vec<T>,
}

/// Queries of a search.
#[derive(Debug, Clone, Copy)]
pub struct Asked<'a> {
    /// Rows of the queries.
    pub rows: &'a [u32],
    /// The group where each search begins; `None`: the first.
    pub home: Option<&'a [u32]>,
    /// Which points may answer each query, `[query][group]`, see [`NearestInLanes::mask`]; `None`: all.
    pub may: Option<&'a [u8]>,
}

/// Best answers so far, `[query][lane]`; several searches may add to the same.
#[derive(Debug, Clone, PartialEq)]
pub struct LaneAnswers<T> {
    /// Squared distances [m²], infinite where nothing was found.
    pub squares: Vec<T>,
    /// Ids, `u32::MAX` where nothing was found: without finite points, for a query that is not finite, or one so far away that
    /// the square is not.
    pub ids: Vec<u32>,
}

impl<T: Real> LaneAnswers<T> {
    /// Nothing found yet.
    pub fn none(queries: usize) -> Self {
        let n = queries * T::LANES;
        Self { squares: vec![T::infinity(); n], ids: vec![u32::MAX; n] }
    }
}

impl NearestInLanes {
    /// Groups the points `ids` by where they lie in one pose [m], shape [point].
    ///
    /// # Panics
    /// For an id that names no point.
    pub fn new(points: &[Vec3], ids: &[u32]) -> Self {
        let mut ids = ids.to_vec();
        arrange(&mut ids, points);
        Self { ids }
    }
    /// Points that can be found, group by group.
    pub fn ids(&self) -> &[u32] {
        &self.ids
    }
    /// Number of groups.
    pub fn groups(&self) -> usize {
        self.ids.len().div_ceil(GROUP)
    }
    /// The group of the point nearest to a query in the pose of [`NearestInLanes::new`], among those that may answer it: where a
    /// search should begin. 0 without such points.
    pub fn home(&self, points: &[Vec3], query: &Vec3, may: impl Fn(u32) -> bool) -> u32 {
        let mut best = (f64::INFINITY, 0);
        for (slot, &id) in self.ids.iter().enumerate() {
            let square = (points[id as usize] - query).norm_squared();
            if square < best.0 && may(id) {
                best = (square, slot / GROUP);
            }
        }
        best.1 as u32
    }
    /// Which points may answer a query, for [`Asked::may`]: a bit for each point of a group, shape [group].
    pub fn mask(&self, may: impl Fn(u32) -> bool) -> Vec<u8> {
        let bits = |ids: &[u32]| ids.iter().enumerate().fold(0, |bits, (k, &id)| bits | u8::from(may(id)) << k);
        self.ids.chunks(GROUP).map(bits).collect()
    }
    /// The points that a mask names.
    pub fn named<'a>(&'a self, mask: &'a [u8]) -> impl Iterator<Item = u32> + 'a {
        let groups = self.ids.chunks(GROUP).zip(mask);
        groups
            .flat_map(|(ids, bits)| ids.iter().enumerate().filter(move |(k, _)| bits >> k & 1 == 1).map(|(_, &id)| id))
    }
    /// Boxes of the groups in one block of frames, `[point][xyz][lane]` [m].
    pub fn boxes<T: Real>(&self, points: &[T]) -> LaneBoxes<T> {
        let groups = self.groups();
        let mut boxes = LaneBoxes {
            groups: vec![T::zero(); groups * BOX * T::LANES],
            outer: vec![T::zero(); groups.div_ceil(OUTER) * BOX * T::LANES],
        };
        enclose(&self.ids, points, &mut boxes.groups, &mut boxes.outer);
        boxes
    }
    /// Nearest points of some queries in one block. `points` and `queries` are `[point][xyz][lane]` [m]; `answers` has a row for each
    /// query.
    ///
    /// # Panics
    /// For boxes, homes, masks or answers of another shape.
    pub fn search<T: Real>(
        &self,
        points: &[T],
        boxes: &LaneBoxes<T>,
        queries: &[T],
        asked: Asked<'_>,
        answers: &mut LaneAnswers<T>,
    ) {
        let count = asked.rows.len();
        assert_eq!(boxes.groups.len(), self.groups() * BOX * T::LANES, "boxes of another search");
        assert!(asked.home.is_none_or(|home| home.len() == count), "a home for each query");
        assert!(asked.may.is_none_or(|may| may.len() == count * self.groups()), "a mask for each query");
        assert_eq!((answers.squares.len(), answers.ids.len()), (count * T::LANES, count * T::LANES));
        if self.ids.is_empty() {
            return;
        }
        look(&self.ids, points, boxes, queries, asked, answers);
    }
}

/// Sorts ids so that runs of [`GROUP`], and runs of [`OUTER`] of these, lie together: halves along the longest side.
fn arrange(ids: &mut [u32], points: &[Vec3]) {
    if ids.len() <= GROUP {
        ids.sort_unstable();
        return;
    }
    let (mut low, mut high) = (Vec3::repeat(f64::INFINITY), Vec3::repeat(f64::NEG_INFINITY));
    for &id in ids.iter() {
        // Comparisons with what is not a number change nothing.
        low = low.zip_map(&points[id as usize], f64::min);
        high = high.zip_map(&points[id as usize], f64::max);
    }
    let axis = (high - low).imax();
    ids.sort_unstable_by(|&a, &b| points[a as usize][axis].total_cmp(&points[b as usize][axis]).then(a.cmp(&b)));
    let unit = if ids.len() > GROUP * OUTER { GROUP * OUTER } else { GROUP };
    let (front, back) = ids.split_at_mut((ids.len() / 2).next_multiple_of(unit));
    arrange(front, points);
    arrange(back, points);
}

/// The three rows of a point.
#[inline(always)]
fn row<T: Real>(values: &[T], id: u32) -> &[T] {
    let n = 3 * T::LANES;
    &values[id as usize * n..][..n]
}

simd_kernel! {
    /// Boxes of groups and of outer groups. Coordinates that are no numbers are left out, since no comparison holds for them.
    fn enclose<T>(ids: &[u32], points: &[T], groups: &mut [T], outer: &mut [T]) {
        let lanes = T::LANES;
        let side = 3 * lanes;
        for (ids, out) in ids.chunks(GROUP).zip(groups.chunks_exact_mut(BOX * lanes)) {
            let mut low = [T::infinity(); 3 * MAX_LANES];
            let mut high = [T::neg_infinity(); 3 * MAX_LANES];
            for &id in ids {
                let p = row(points, id);
                for i in 0..side {
                    low[i] = if p[i] < low[i] { p[i] } else { low[i] };
                    high[i] = if p[i] > high[i] { p[i] } else { high[i] };
                }
            }
            out[..side].copy_from_slice(&low[..side]);
            out[side..].copy_from_slice(&high[..side]);
        }
        for (inner, out) in groups.chunks(OUTER * BOX * lanes).zip(outer.chunks_exact_mut(BOX * lanes)) {
            let mut low = [T::infinity(); 3 * MAX_LANES];
            let mut high = [T::neg_infinity(); 3 * MAX_LANES];
            for b in inner.chunks_exact(BOX * lanes) {
                for i in 0..side {
                    low[i] = if b[i] < low[i] { b[i] } else { low[i] };
                    high[i] = if b[side + i] > high[i] { b[side + i] } else { high[i] };
                }
            }
            out[..side].copy_from_slice(&low[..side]);
            out[side..].copy_from_slice(&high[..side]);
        }
    }
}

/// Whether a box may hold something at most as far as the best in any lane.
///
/// Exact without slack: rounding is monotonic, so that the rounded distance to the box is at most the rounded distance to
/// anything in it. At most, not below: an equal distance may belong to a smaller id.
#[inline(always)]
fn worth<T: Real>(corners: &[T], q: &[T], best: &[T; MAX_LANES]) -> bool {
    let lanes = T::LANES;
    let corners = &corners[..BOX * lanes];
    let mut hits = [0u32; MAX_LANES];
    for l in 0..lanes {
        let mut square = T::zero();
        for axis in 0..3 {
            let i = axis * lanes + l;
            let (below, above) = (corners[i] - q[i], q[i] - corners[3 * lanes + i]);
            let gap = if below > above { below } else { above };
            let gap = if gap > T::zero() { gap } else { T::zero() };
            square += gap * gap;
        }
        hits[l] = u32::from(square <= best[l]);
    }
    let mut any = 0;
    for l in 0..lanes {
        any |= hits[l];
    }
    any != 0
}

/// Compares those of a group's points that a mask names with the best in every lane.
#[inline(always)]
fn visit<T: Real>(
    (ids, mask): (&[u32], u8),
    points: &[T],
    q: &[T],
    best: &mut [T; MAX_LANES],
    chosen: &mut [u32; MAX_LANES],
) {
    let lanes = T::LANES;
    for (k, &id) in ids.iter().enumerate() {
        if mask >> k & 1 == 0 {
            continue;
        }
        let p = row(points, id);
        for l in 0..lanes {
            let (x, y, z) = (p[l] - q[l], p[lanes + l] - q[lanes + l], p[2 * lanes + l] - q[2 * lanes + l]);
            let square = x * x + y * y + z * z;
            let better = (square < best[l]) | ((square == best[l]) & (id < chosen[l]));
            best[l] = if better { square } else { best[l] };
            chosen[l] = if better { id } else { chosen[l] };
        }
    }
}

simd_kernel! {
    /// The search of [`NearestInLanes::search`].
    fn look<T>(
        ids: &[u32],
        points: &[T],
        boxes: &LaneBoxes<T>,
        queries: &[T],
        asked: Asked<'_>,
        answers: &mut LaneAnswers<T>,
    ) {
        let lanes = T::LANES;
        let width = BOX * lanes;
        let groups = ids.len().div_ceil(GROUP);
        let group = |g: usize| &ids[g * GROUP..][..GROUP.min(ids.len() - g * GROUP)];
        let rows = answers.squares.chunks_exact_mut(lanes).zip(answers.ids.chunks_exact_mut(lanes));
        for (i, (&v, (squares, found))) in asked.rows.iter().zip(rows).enumerate() {
            let q = row(queries, v);
            let mut best = [T::infinity(); MAX_LANES];
            let mut chosen = [u32::MAX; MAX_LANES];
            best[..lanes].copy_from_slice(squares);
            chosen[..lanes].copy_from_slice(found);
            let home = asked.home.map_or(0, |home| home[i] as usize);
            let mask = |g: usize| asked.may.map_or(u8::MAX, |may| may[i * groups + g]);
            visit((group(home), mask(home)), points, q, &mut best, &mut chosen);
            for (o, outer) in boxes.outer.chunks_exact(width).enumerate() {
                if !worth(outer, q, &best) {
                    continue;
                }
                let inner = &boxes.groups[o * OUTER * width..];
                for (g, corners) in inner.chunks_exact(width).take(OUTER).enumerate() {
                    let g = o * OUTER + g;
                    let mask = mask(g);
                    if g != home && mask != 0 && worth(corners, q, &best) {
                        visit((group(g), mask), points, q, &mut best, &mut chosen);
                    }
                }
            }
            for l in 0..lanes {
                // Equally far, at infinity.
                chosen[l] = if best[l] < T::infinity() { chosen[l] } else { u32::MAX };
            }
            squares.copy_from_slice(&best[..lanes]);
            found.copy_from_slice(&chosen[..lanes]);
        }
    }
}
