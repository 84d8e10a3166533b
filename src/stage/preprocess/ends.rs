//! Where cloth ends in a labelled scan.

use caphy_core::query::{Adjacency, NearestGrid, boundary_loops};
use caphy_core::scan::Label;
use caphy_core::{TriMesh, Vec3, mesh};
use caphy_garment::template::Rim;
use std::collections::{BTreeMap, BTreeSet};

/// Widest gap of a scan between cloth and where it ends, in its edges, and how far from ends without a gap ends at a gap are [m].
const GAP: f64 = 4.0;
const BESIDE: f64 = 0.04;
/// Times that a vertex's share of cloth is averaged with its neighbours': a border of labels zigzags by half an edge.
const ROUNDS: usize = 2;
/// Edges longer than this many typical ones go across a step in depth; diagonals of squares do not.
const STEP: f64 = 1.5;
/// Ends of pieces nearer to each other than so many edges are joined; a piece of this many points may go around.
const JOINED: f64 = 4.0;
const AROUND: usize = 30;
/// Of vertices at a gap at most so many in a row, less one, are nearest to nothing across it.
const SKIPPED: usize = 4;
/// Cloth within so many edges of its end, wrong labels beside that aside, tells how far above the skin it ends.
const RINGS: usize = 2;

/// The ends of one garment.
pub(super) struct Ends {
    /// Where its label meets others, in pieces.
    pub(super) rims: Vec<Rim>,
    /// The same together with where it lies across a gap from others, joined where pieces go on: longer pieces, less exact.
    pub(super) joined: Vec<Rim>,
    /// All of them, as points [m].
    pub(super) points: Vec<Vec3>,
}

impl Ends {
    /// Where cloth of a label ends in a scan: at skin, and at the other garment unless that one hides it; also across a gap that no camera
    /// looked into, as under a collar. Other holes are no ends, nor is what only touches: the body `goes_on` from a place of cloth to one
    /// beside it.
    pub(super) fn new(
        mesh: &TriMesh,
        labels: &[Label],
        own: Label,
        hiding: Option<Label>,
        goes_on: impl Fn(&Vec3, &Vec3) -> bool,
    ) -> Self {
        let place = |v: u32| mesh.vertices[v as usize];
        let mut lengths: Vec<f64> = mesh.faces.iter().map(|f| (place(f[1]) - place(f[0])).norm()).collect();
        lengths.sort_by(f64::total_cmp);
        let typical = lengths.get(lengths.len() / 2).copied().unwrap_or(0.0);
        let scan = Labelled {
            mesh,
            labels,
            own,
            hiding,
            typical,
            neighbours: Adjacency::new(mesh.vertices.len(), &mesh.faces),
        };
        let rims = scan.rims(&goes_on);
        let mut points: Vec<Vec3> = rims.iter().flat_map(|r| r.points.iter().copied()).collect();
        let (gaps, across) = scan.gaps(&goes_on, &rims);
        points.extend(across);
        let joined = joined(rims.iter().cloned().chain(gaps).collect(), JOINED * typical);
        Self { rims, joined, points }
    }
}

/// A scan, and whose ends are looked for.
struct Labelled<'a> {
    mesh: &'a TriMesh,
    labels: &'a [Label],
    own: Label,
    hiding: Option<Label>,
    /// Median edge [m].
    typical: f64,
    neighbours: Adjacency,
}

/// An edge of the mesh, its lower vertex first.
type Edge = [u32; 2];

impl Labelled<'_> {
    fn place(&self, v: u32) -> Vec3 {
        self.mesh.vertices[v as usize]
    }
    fn ends_at(&self, v: u32) -> bool {
        let label = self.labels[v as usize];
        label != self.own && self.hiding != Some(label)
    }
    /// Whether a vertex beside cloth, by its smoothed share, is or lies at what cloth ends at.
    fn beyond(&self, v: u32) -> bool {
        let near = || self.neighbours.of(v as usize).iter().any(|&n| self.ends_at(n));
        self.ends_at(v) || (self.labels[v as usize] == self.own && near())
    }
    /// Cloth counts 1, all else -1, averaged with its neighbours.
    fn cloth(&self) -> Vec<f64> {
        let mut share: Vec<f64> = self.labels.iter().map(|l| if *l == self.own { 1.0 } else { -1.0 }).collect();
        for _ in 0..ROUNDS {
            let around = |v: usize| {
                let near = self.neighbours.of(v);
                let sum: f64 = near.iter().map(|&n| share[n as usize]).sum();
                if near.is_empty() { share[v] } else { 0.5 * (share[v] + sum / near.len() as f64) }
            };
            share = (0..share.len()).map(around).collect();
        }
        share
    }
    /// Normals of the cloth alone, where all around is cloth.
    fn sheet(&self) -> Vec<Option<Vec3>> {
        let own = |v: u32| self.labels[v as usize] == self.own;
        let faces: Vec<[u32; 3]> = self.mesh.faces.iter().filter(|f| f.iter().all(|&v| own(v))).copied().collect();
        let normals = mesh::vertex_normals(&self.mesh.vertices, &faces);
        let within = |v: usize| own(v as u32) && self.neighbours.of(v).iter().all(|&n| own(n));
        normals.into_iter().enumerate().map(|(v, n)| within(v).then_some(n)).collect()
    }
    /// The plane in which cloth lies around a vertex at its end: a point [m] and the normal.
    fn plane(&self, v: u32, sheet: &[Option<Vec3>]) -> Option<(Vec3, Vec3)> {
        let mut near: BTreeSet<u32> = [v].into();
        for _ in 0..RINGS {
            let around = near.iter().flat_map(|&v| self.neighbours.of(v as usize)).copied();
            let more: Vec<u32> = around.filter(|&n| self.labels[n as usize] == self.own).collect();
            near.extend(more);
        }
        let (mut at, mut normal, mut count) = (Vec3::zeros(), Vec3::zeros(), 0.0);
        for (&v, n) in near.iter().filter_map(|v| Some((v, sheet[*v as usize]?))) {
            at += self.place(v);
            normal += n;
            count += 1.0;
        }
        Some((at / count, normal.try_normalize(1e-9)?))
    }
    /// Where the label gives way to others, from triangle to triangle.
    fn rims(&self, goes_on: &impl Fn(&Vec3, &Vec3) -> bool) -> Vec<Rim> {
        let cloth = self.cloth();
        let sheet = self.sheet();
        let key = |a: u32, b: u32| -> Edge { [a.min(b), a.max(b)] };
        let mut points: BTreeMap<Edge, Vec3> = BTreeMap::new();
        for face in &self.mesh.faces {
            for (a, b) in [(face[0], face[1]), (face[1], face[2]), (face[2], face[0])] {
                let (a, b) = if cloth[a as usize] > 0.0 { (a, b) } else { (b, a) };
                let [inside, outside] = [a, b].map(|v| cloth[v as usize]);
                let (from, to) = (self.place(a), self.place(b));
                if !(inside > 0.0 && outside <= 0.0 && self.beyond(b) && goes_on(&from, &to)) {
                    continue;
                }
                // Cloth goes on as it does beside its end; half way down to the skin an edge would be too narrow.
                let (mut from, mut way) = (from, to - from);
                if let Some((at, normal)) = self.plane(a, &sheet) {
                    from -= normal * normal.dot(&(from - at));
                    way -= normal * normal.dot(&way);
                }
                // Beyond a step in depth cloth goes no farther than elsewhere.
                let reach = (STEP * self.typical / way.norm().max(1e-12)).min(1.0);
                points.insert(key(a, b), from + way * (reach * inside / (inside - outside)));
            }
        }
        let mut next: BTreeMap<Edge, Vec<Edge>> = BTreeMap::new();
        for &[a, b, c] in &self.mesh.faces {
            let mut met = [key(a, b), key(b, c), key(c, a)].into_iter().filter(|k| points.contains_key(k));
            if let (Some(p), Some(q)) = (met.next(), met.next()) {
                next.entry(p).or_default().push(q);
                next.entry(q).or_default().push(p);
            }
        }
        // Open pieces from one of their ends, then what is left: closed ones.
        let starts = next.iter().filter(|(_, n)| n.len() == 1).chain(&next).map(|(k, n)| (*k, n.len() > 1));
        let mut done: BTreeSet<Edge> = BTreeSet::new();
        let mut rims = Vec::new();
        for (start, closed) in starts {
            if !done.insert(start) {
                continue;
            }
            let mut piece = vec![points[&start]];
            let mut at = start;
            while let Some(&on) = next.get(&at).and_then(|n| n.iter().find(|k| !done.contains(*k))) {
                done.insert(on);
                piece.push(points[&on]);
                at = on;
            }
            rims.push(Rim { points: piece, closed });
        }
        rims
    }
    /// Ends across gaps, in pieces along the rims of the scan, none beside `rims`, but where those end; and points of them that lie apart
    /// from all of those: where cloth can be followed to its end, a rim beside that is the bottom of a gap that cameras look into.
    fn gaps(&self, goes_on: &impl Fn(&Vec3, &Vec3) -> bool, rims: &[Rim]) -> (Vec<Rim>, Vec<Vec3>) {
        let place = |v: u32| self.place(v);
        let (mut sure, mut last) = (Vec::new(), Vec::new());
        for rim in rims {
            let count = rim.points.len();
            last.extend((0..count).map(|i| !rim.closed && (i == 0 || i + 1 == count)));
            sure.extend(&rim.points);
        }
        let sure = NearestGrid::from_points(&sure);
        let beside = |v: u32| sure.nearest_within(&place(v).into(), BESIDE * BESIDE);
        let loops = boundary_loops(&self.mesh.faces);
        let rim: Vec<u32> = loops.iter().flatten().copied().collect();
        let own_rim: Vec<u32> = rim.iter().copied().filter(|v| self.labels[*v as usize] == self.own).collect();
        let nearest = NearestGrid::from_points(&own_rim.iter().map(|&v| place(v)).collect::<Vec<_>>());
        let gap = GAP * self.typical;
        // From the other side of the gap: the rim of a hole that lies across an end goes on into the cloth.
        let mut met: BTreeSet<u32> = BTreeSet::new();
        for &v in rim.iter().filter(|v| self.ends_at(**v)) {
            let Some((near, square)) = nearest.nearest_point(&place(v)) else { continue };
            let near = own_rim[near as usize];
            if square < gap * gap && goes_on(&place(near), &place(v)) {
                met.insert(near);
            }
        }
        let (mut pieces, mut points) = (Vec::new(), Vec::new());
        for ring in &loops {
            let count = ring.len();
            // Along the rim, from the vertex before to the one after.
            let outside = |i: usize| {
                let [before, after] = [i + count - 1, i + 1].map(|at| place(ring[at % count]));
                self.outside(ring[i], (after - before).try_normalize(0.0).unwrap_or_else(Vec3::zeros))
            };
            let is_met: Vec<bool> = ring.iter().map(|v| met.contains(v)).collect();
            points.extend((0..count).filter(|&i| is_met[i] && beside(ring[i]).is_none()).map(outside));
            // Not every vertex is the nearest one to something across the gap: a piece goes on over some.
            let goes_along = |v: u32| beside(v).is_none_or(|(near, _)| last[near as usize]);
            let own: Vec<bool> = ring.iter().map(|&v| self.labels[v as usize] == self.own && goes_along(v)).collect();
            let reaches = |i: usize, step: usize| {
                let way = (0..=SKIPPED.min(count - 1)).map(|k| (i + k * step) % count);
                way.take_while(|&k| own[k]).any(|k| is_met[k])
            };
            let on: Vec<bool> = (0..count).map(|i| reaches(i, 1) && reaches(i, count - 1)).collect();
            let Some(first) = on.iter().position(|on| !on) else {
                pieces.push(Rim { points: (0..count).map(outside).collect(), closed: true });
                continue;
            };
            let around: Vec<usize> = (0..count).map(|k| (first + k) % count).collect();
            let open = around.chunk_by(|&a, &b| on[a] == on[b]).filter(|piece| on[piece[0]]);
            pieces.extend(open.map(|p| Rim { points: p.iter().map(|&i| outside(i)).collect(), closed: false }));
        }
        (pieces, points)
    }
    /// Where cloth ends at a vertex of a rim that goes `along`: the last vertex that is seen is half an edge inside on average.
    fn outside(&self, v: u32, along: Vec3) -> Vec3 {
        let own_of = |v: u32| {
            let near = self.neighbours.of(v as usize).iter().copied();
            near.filter(|&n| self.labels[n as usize] == self.own)
        };
        let ring: Vec<Vec3> = own_of(v).flat_map(own_of).filter(|&n| n != v).map(|n| self.place(n)).collect();
        let inside = ring.iter().sum::<Vec3>() / ring.len().max(1) as f64;
        let way = self.place(v) - inside;
        let outward = (way - along * along.dot(&way)).try_normalize(1e-9).unwrap_or_else(Vec3::zeros);
        self.place(v) + outward * (if ring.is_empty() { 0.0 } else { 0.5 * self.typical })
    }
}

/// Pieces, those joined whose ends are within reach [m] of each other, nearest ones first.
fn joined(pieces: Vec<Rim>, reach: f64) -> Vec<Rim> {
    let mut pieces: Vec<Option<Rim>> = pieces.into_iter().filter(|rim| !rim.points.is_empty()).map(Some).collect();
    // Of the open pieces: the piece that an end is of, which changes, and where it is.
    let mut ends: Vec<(usize, Vec3)> = Vec::new();
    let mut bounds: Vec<[usize; 2]> = Vec::new();
    for (i, rim) in pieces.iter().enumerate() {
        bounds.push([ends.len(), ends.len() + 1]);
        if let Some(Rim { points, closed: false }) = rim {
            ends.extend([(i, points[0]), (i, points[points.len() - 1])]);
        }
    }
    let mut pairs: Vec<(f64, usize, usize)> = Vec::new();
    for (l, b) in ends.iter().enumerate() {
        let before = ends[..l].iter().enumerate().map(|(k, a)| ((a.1 - b.1).norm(), k, l));
        pairs.extend(before.filter(|pair| pair.0 < reach));
    }
    pairs.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut free = vec![true; ends.len()];
    // Once more at the end: a piece that is long enough by then may go around.
    for &(_, k, l) in pairs.iter().chain(&pairs) {
        let (a, b) = (ends[k].0, ends[l].0);
        if !(free[k] && free[l]) {
            continue;
        }
        if a == b {
            // Around, and not back.
            if let Some(rim) = pieces[a].as_mut().filter(|rim| rim.points.len() >= AROUND) {
                rim.closed = true;
                [free[k], free[l]] = [false; 2];
            }
            continue;
        }
        let Some(mut second) = pieces[b].take() else { continue };
        let Some(first) = pieces[a].as_mut() else { continue };
        if bounds[b][1] == l {
            second.points.reverse();
            bounds[b].reverse();
        }
        if bounds[a][0] == k {
            first.points.reverse();
            bounds[a].reverse();
        }
        first.points.append(&mut second.points);
        bounds[a][1] = bounds[b][1];
        ends[bounds[b][1]].0 = a;
        [free[k], free[l]] = [false; 2];
    }
    pieces.into_iter().flatten().collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cloth_ends_at_skin_and_across_gaps_and_not_at_holes() {
        // A sheet of 1 cm squares: cloth up to x = 0.1, skin from there on.
        let square = |i: u32| [[i, i + 1, i + 21], [i + 1, i + 22, i + 21]];
        let sheet = |keep: &dyn Fn(u32) -> bool| TriMesh {
            vertices: (0..441).map(|i| Vec3::new(f64::from(i % 21), f64::from(i / 21), 0.0) * 0.01).collect(),
            faces: (0..420).filter(|i| i % 21 < 20 && keep(*i)).flat_map(square).collect(),
        };
        let label = |i: usize| if i % 21 <= 10 { Label::Upper } else { Label::Body };
        let labels: Vec<Label> = (0..441).map(label).collect();
        let anywhere = |_: &Vec3, _: &Vec3| true;
        let points = |mesh: &TriMesh, labels: &[Label], own, hiding, goes_on: fn(&Vec3, &Vec3) -> bool| {
            Ends::new(mesh, labels, own, hiding, goes_on).points
        };
        let whole = points(&sheet(&|_| true), &labels, Label::Upper, None, anywhere);
        // Half an edge beyond the cloth; its own last vertex at the sheet's rim.
        assert!(whole.len() > 21 && whole.iter().all(|p| p.x > 0.0999 && p.x < 0.11), "{whole:?}");
        assert!(points(&sheet(&|_| true), &labels, Label::Upper, Some(Label::Body), anywhere).is_empty());
        // Something that only touches the cloth along half of that.
        let touching = points(&sheet(&|_| true), &labels, Label::Upper, None, |a, _| a.y > 0.1);
        assert!(touching.len() > 9 && touching.iter().all(|p| p.y > 0.09), "{touching:?}");
        // A gap of two squares beside the cloth, and a hole in the middle of it.
        let torn = sheet(&|i| !(10..12).contains(&(i % 21)) && (i % 21, i / 21) != (4, 9));
        let across = points(&torn, &labels, Label::Upper, None, anywhere);
        assert!(across.len() >= 20, "{across:?}");
        // Half an edge beyond the last vertex; at the sheet's corners it leans.
        let inner = across.iter().filter(|p| p.y > 0.005 && p.y < 0.195);
        assert!(inner.clone().count() >= 19 && inner.clone().all(|p| (p.x - 0.105).abs() < 1e-9), "{across:?}");
        // The gap is closed along a part: around there the closed part says where the cloth ends.
        let partly = sheet(&|i| !(10..12).contains(&(i % 21)) || i / 21 < 8);
        let both = points(&partly, &labels, Label::Upper, None, anywhere);
        let at_gap: Vec<&Vec3> = both.iter().filter(|p| p.y > 0.081).collect();
        assert!(at_gap.len() > 5 && at_gap.iter().all(|p| p.y > 0.08 + BESIDE - 0.011), "{at_gap:?}");
    }

    #[test]
    fn borders_of_labels_are_followed_from_triangle_to_triangle() {
        // A sheet of 7 mm squares; a disc of cloth of 6 cm, and cloth beyond x = 25 cm.
        let across = 46u32;
        let square = |i: u32| [[i, i + 1, i + across], [i + 1, i + across + 1, i + across]];
        let sheet = TriMesh {
            vertices: (0..across * across)
                .map(|i| Vec3::new(f64::from(i % across), f64::from(i / across), 0.0) * 0.007)
                .collect(),
            faces: (0..across * (across - 1)).filter(|i| i % across < across - 1).flat_map(square).collect(),
        };
        let centre = Vec3::new(0.1234, 0.1567, 0.0);
        let cloth = |p: &Vec3| (p - centre).norm() < 0.06 || p.x > 0.25;
        let labels: Vec<Label> =
            sheet.vertices.iter().map(|p| if cloth(p) { Label::Upper } else { Label::Body }).collect();
        let rims = Ends::new(&sheet, &labels, Label::Upper, None, |_, _| true).rims;
        let [straight, round] = &rims[..] else { panic!("{} pieces", rims.len()) };
        assert!(!straight.closed && round.closed);
        // Labels are known at vertices: each place within half of the longest edge.
        let off = |p: &Vec3| ((p - centre).norm() - 0.06).abs();
        assert!(round.points.iter().all(|p| off(p) < 0.0035 * 2f64.sqrt()), "{round:?}");
        let mean = round.points.iter().map(|p| (p - centre).norm() - 0.06).sum::<f64>() / round.points.len() as f64;
        assert!(mean.abs() < 0.5e-3, "{mean}");
        // One after the other: all around, and from the one side of the sheet to the other.
        let steps = |rim: &Rim| rim.points.windows(2).map(|w| (w[1] - w[0]).norm()).fold(0.0, f64::max);
        assert!(steps(round) < 0.01 && steps(straight) < 0.01);
        let ends = [straight.points[0], straight.points[straight.points.len() - 1]];
        assert!((ends[0] - ends[1]).norm() > 0.31);
        // What only touches cuts a border in two.
        let apart = Ends::new(&sheet, &labels, Label::Upper, None, |a, _| a.x > 0.2 || a.y < 0.2).rims;
        assert!(apart.iter().all(|r| !r.closed) && apart.len() == 2, "{apart:?}");
    }

    #[test]
    fn pieces_that_go_on_are_joined() {
        let at = |x: f64| Vec3::new(x, 0.0, 0.0);
        let piece = |xs: &[f64]| Rim { points: xs.iter().map(|&x| at(x)).collect(), closed: false };
        let xs = |rim: &Rim| rim.points.iter().map(|p| p.x).collect::<Vec<_>>();
        // Whichever way each goes; not farther than the reach, nor back to a piece's own start.
        let line = joined(vec![piece(&[2.0, 1.0]), piece(&[2.05, 3.0]), piece(&[0.0, 0.9]), piece(&[4.0])], 0.5);
        assert_eq!(line.iter().map(xs).collect::<Vec<_>>(), [vec![3.0, 2.05, 2.0, 1.0, 0.9, 0.0], vec![4.0]]);
        assert!(joined(vec![piece(&[0.0, 0.2])], 0.5).iter().all(|rim| !rim.closed));
        // Two halves of a circle become one that is closed.
        let half = |from: i32| {
            let place = |i: i32| {
                let (sin, cos) = (std::f64::consts::TAU * f64::from(i) / 60.0).sin_cos();
                Vec3::new(cos, sin, 0.0)
            };
            Rim { points: (from..from + 30).map(place).collect(), closed: false }
        };
        let circle = joined(vec![half(0), half(30)], 0.2);
        assert!(circle.len() == 1 && circle[0].closed && circle[0].points.len() == 60);
    }

    #[test]
    fn an_end_goes_on_across_gaps_all_around() {
        // A limb with a sleeve to y = 12.5 cm; around a third of it no camera looked in between.
        let around = 63u32;
        let place = |i: u32| {
            let (sin, cos) = (std::f64::consts::TAU * f64::from(i % around) / f64::from(around)).sin_cos();
            Vec3::new(0.05 * cos, 0.005 * f64::from(i / around), 0.05 * sin)
        };
        let square = |i: u32| {
            let (a, b) = (i, i / around * around + (i + 1) % around);
            [[a, a + around, b], [b, a + around, b + around]]
        };
        let seen = |i: &u32| i % around >= 21 || !(25..27).contains(&(i / around));
        let limb = TriMesh {
            vertices: (0..around * 40).map(place).collect(),
            faces: (0..around * 39).filter(seen).flat_map(square).collect(),
        };
        let labels: Vec<Label> =
            (0..around * 40).map(|i| if i / around <= 25 { Label::Upper } else { Label::Body }).collect();
        let ends = Ends::new(&limb, &labels, Label::Upper, None, |_, _| true);
        let [part] = &ends.rims[..] else { panic!("{} pieces", ends.rims.len()) };
        let [whole] = &ends.joined[..] else { panic!("{} joined pieces", ends.joined.len()) };
        assert!(!part.closed && whole.closed);
        assert!(whole.points.iter().all(|p| (p.y - 0.1275).abs() < 1.5e-3), "{whole:?}");
        let steps = whole.points.iter().zip(whole.points.iter().cycle().skip(1)).map(|(a, b)| (a - b).norm());
        assert!(steps.fold(0.0, f64::max) < JOINED * 0.005 * 2f64.sqrt());
    }

    #[test]
    fn cloth_ends_as_far_above_the_skin_as_it_lies_beside_that() {
        // A limb of 5 cm with a sleeve 4 mm above it to y = 12.5 cm, in squares of 5 mm; every fifth label at the end is wrong.
        let around = 63u32;
        let place = |i: u32| {
            let radius = if i / around <= 25 { 0.054 } else { 0.05 };
            let (sin, cos) = (std::f64::consts::TAU * f64::from(i % around) / f64::from(around)).sin_cos();
            Vec3::new(radius * cos, 0.005 * f64::from(i / around), radius * sin)
        };
        let square = |i: u32| {
            let (a, b) = (i, i / around * around + (i + 1) % around);
            [[a, a + around, b], [b, a + around, b + around]]
        };
        let limb = TriMesh {
            vertices: (0..around * 40).map(place).collect(),
            faces: (0..around * 39).flat_map(square).collect(),
        };
        let cloth = |i: u32| i / around <= 25 || (i / around == 26 && i.is_multiple_of(5));
        let labels: Vec<Label> = (0..around * 40).map(|i| if cloth(i) { Label::Upper } else { Label::Body }).collect();
        let rims = Ends::new(&limb, &labels, Label::Upper, None, |_, _| true).rims;
        let [cuff] = &rims[..] else { panic!("{} pieces", rims.len()) };
        assert!(cuff.closed);
        // Two edges around a limb a plane lies at most 10²/2·54 mm lower, on average a third of that; half way down is 2 mm.
        let radius = |p: &Vec3| p.x.hypot(p.z);
        let mean = cuff.points.iter().map(radius).sum::<f64>() / cuff.points.len() as f64;
        assert!((mean - 0.054).abs() < 4e-4, "{mean}");
        assert!(cuff.points.iter().all(|p| (radius(p) - 0.054).abs() < 1e-3 && p.y > 0.125 && p.y < 0.132), "{cuff:?}");
    }
}
