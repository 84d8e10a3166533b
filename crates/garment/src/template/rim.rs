//! By how much the edges of a worn garment are too wide or too narrow for what scans show of them.
//!
//! A taut edge lies where its girth lets it. A neckline that lies 4 mm too far out all around is 25 mm too wide, and no fit of edges feels
//! it: where the body under it is fitted some millimetres off, in each scan elsewhere, so is the garment, and scans show half of an edge.
//! So each scan may move and turn an edge a little, and what all of them have in common is how much larger it is about its own centre: a
//! Gauss-Newton step of a similarity transformation whose rigid part is each scan's own.

use super::refine::{OTHERS_M, Seen, median};
use super::shape::smooth_step;
use super::{NamedLoop, Template};
use caphy_core::Vec3;
use caphy_core::query::nearest_on_line;
use nalgebra::{SMatrix, SVector};

/// Points along edges are this far apart [m], and smoothed over this distance (a Gaussian's σ): a scan's triangles make them zigzag, and
/// those of a garment make them polygons. Both are smoothed alike.
const STEP: f64 = 3e-3;
const SMOOTH: f64 = 0.01;
/// Pieces shorter than this do not say much [m].
const SHORTEST: f64 = 0.05;
/// How far a garment lies from where it should in one scan, as a whole and by a turn [m]: as bodies are fitted.
const SHIFT: f64 = 3e-3;
/// By how much a template's girths are off without this [1].
const OFF: f64 = 0.02;
/// Least deviation of an edge from its fitted place [m], and how far along it deviations are alike [m]: folds, triangles.
const DEVIATION: f64 = 2e-3;
const ALIKE: f64 = 0.06;
/// An edge this much longer than at rest lies where its girth lets it; a slack one, such as a hem, folds, as does one that is taut in less
/// than half of the scans: a cuff on a lifted arm.
const TAUT: f64 = 1.02;
/// How far from an edge cloth moves with it [m].
const MOVES: f64 = 0.06;

/// A piece of an edge of a garment as a scan shows it.
#[derive(Debug, Clone, PartialEq)]
pub struct Rim {
    /// Along it [m].
    pub points: Vec<Vec3>,
    /// Whether it goes all around.
    pub closed: bool,
}

/// How much larger an edge is [1], with its variance.
#[derive(Debug, Clone, Copy)]
struct Larger {
    by: f64,
    variance: f64,
}

impl Rim {
    fn length(&self) -> f64 {
        let all = self.points.windows(2).map(|p| (p[1] - p[0]).norm()).sum::<f64>();
        match (&self.points[..], self.closed) {
            ([first, .., last], true) => all + (first - last).norm(),
            _ => all,
        }
    }
    /// Points at equal distances along it, smoothed; the ends of an open one stay.
    fn smoothed(&self) -> Rim {
        let total = self.length();
        let count = (total / STEP).round().max(2.0) as usize;
        let mut corners = self.points.iter().chain(self.points.first().filter(|_| self.closed));
        let Some(mut from) = corners.next() else { return self.clone() };
        let mut to = corners.next().unwrap_or(from);
        let mut before = 0.0;
        let mut even = Vec::with_capacity(count + 1);
        for i in 0..count + usize::from(!self.closed) {
            let at = total * i as f64 / count as f64;
            while before + (to - from).norm() < at {
                let Some(next) = corners.next() else { break };
                before += (to - from).norm();
                (from, to) = (to, next);
            }
            let length = (to - from).norm().max(f64::MIN_POSITIVE);
            even.push(from + (to - from) * ((at - before) / length).min(1.0));
        }
        let step = total / count as f64;
        let reach = (3.0 * SMOOTH / step).ceil() as isize;
        let last = even.len() as isize;
        let around = |i: isize| {
            let reach = if self.closed { reach } else { reach.min(i).min(last - 1 - i) };
            let (mut sum, mut weight) = (Vec3::zeros(), 0.0);
            for k in -reach..=reach {
                let w = (-0.5 * (k as f64 * step / SMOOTH).powi(2)).exp();
                sum += even[(i + k).rem_euclid(last) as usize] * w;
                weight += w;
            }
            sum / weight
        };
        Rim { points: (0..last).map(around).collect(), closed: self.closed }
    }
    /// The way from the nearest place to a point, where that is, and the direction of the edge there.
    fn nearest(&self, p: &Vec3) -> Option<(Vec3, Vec3, Vec3)> {
        let ends = self.points.iter().zip(self.points.iter().cycle().skip(1));
        let places = ends.take(self.points.len() - usize::from(!self.closed)).map(|(a, b)| {
            let place = nearest_on_line(p, [a, b]);
            (p - place, place, b - a)
        });
        let (off, place, way) = places.min_by(|a, b| a.0.norm_squared().total_cmp(&b.0.norm_squared()))?;
        Some((off, place, way.try_normalize(0.0)?))
    }
    fn distance(&self, p: &Vec3) -> f64 {
        self.nearest(p).map_or(f64::INFINITY, |n| n.0.norm())
    }
    fn centre(&self) -> Vec3 {
        self.points.iter().sum::<Vec3>() / self.points.len().max(1) as f64
    }
}

/// By what the girth of each loop of a template has to grow [1] to be what scans show; 1 where they do not show it, and of slack loops.
pub(super) fn girths(template: &Template, worn: &[Vec<Vec3>], seen: &[Seen<'_>]) -> Vec<f64> {
    let edges = |vertices: &[Vec3]| -> Vec<Rim> {
        let rim =
            |l: &NamedLoop| Rim { points: l.vertices.iter().map(|&v| vertices[v as usize]).collect(), closed: true };
        template.loops.iter().map(rim).collect()
    };
    let rest: Vec<f64> = edges(&template.mesh.vertices).iter().map(Rim::length).collect();
    // Of each edge whether it is taut, and what the scan says.
    let of_scan = |(vertices, seen): (&Vec<Vec3>, &Seen<'_>)| -> Vec<(bool, Option<Larger>)> {
        let worn = edges(vertices);
        let larger = larger(&worn.iter().map(Rim::smoothed).collect::<Vec<_>>(), seen.rims);
        let taut = worn.iter().zip(&rest).map(|(worn, rest)| worn.length() >= TAUT * rest);
        taut.zip(larger).collect()
    };
    let scans: Vec<Vec<(bool, Option<Larger>)>> = worn.iter().zip(seen).map(of_scan).collect();
    let factor = |k: usize| {
        let taut = scans.iter().filter(|scan| scan[k].0);
        let often = 2 * taut.clone().count() >= scans.len();
        if often { 1.0 + together(taut.filter_map(|scan| scan[k].1)) } else { 1.0 }
    };
    (0..template.loops.len()).map(factor).collect()
}

/// What scans say together, as far as they know it better than the template does: less where they differ by more than they should.
fn together(scans: impl Iterator<Item = Larger> + Clone) -> f64 {
    let known: f64 = scans.clone().map(|s| 1.0 / s.variance).sum();
    if known == 0.0 {
        return 0.0;
    }
    let mean = scans.clone().map(|s| s.by / s.variance).sum::<f64>() / known;
    let (count, misfit) = scans.fold((0usize, 0.0), |(n, sum), s| (n + 1, sum + (s.by - mean).powi(2) / s.variance));
    let inflated = (misfit / count.saturating_sub(1).max(1) as f64).max(1.0) / known;
    mean * OFF * OFF / (OFF * OFF + inflated)
}

/// How much larger than each of a worn garment's edges its pieces in a scan are.
fn larger(edges: &[Rim], pieces: &[Rim]) -> Vec<Option<Larger>> {
    let mut points: Vec<Vec<Vec3>> = vec![Vec::new(); edges.len()];
    for piece in pieces.iter().filter(|r| r.length() >= SHORTEST).map(Rim::smoothed) {
        let from = |edge: &Rim| median(piece.points.iter().map(|p| edge.distance(p)));
        let near = edges.iter().map(from).enumerate().min_by(|a, b| a.1.total_cmp(&b.1));
        if let Some((k, _)) = near.filter(|n| n.1 <= OTHERS_M) {
            points[k].extend(piece.points);
        }
    }
    edges.iter().zip(&points).map(|(edge, points)| similar(edge, points)).collect()
}

/// The similarity transformation that takes an edge to points of it, as one step: how much larger; moved and turned within what bodies are
/// off by. `None` without points, or where they do not tell a size from a place.
fn similar(edge: &Rim, points: &[Vec3]) -> Option<Larger> {
    let centre = edge.centre();
    let radius = edge.length() / std::f64::consts::TAU;
    let mut rows: Vec<(SVector<f64, 7>, f64)> = Vec::with_capacity(2 * points.len());
    for p in points {
        let Some((off, place, along)) = edge.nearest(p) else { continue };
        let arm = place - centre;
        let Some(across) = along.cross(&arm).try_normalize(1e-9) else { continue };
        for direction in [across, across.cross(&along)] {
            let turn = arm.cross(&direction) / radius;
            let [d, t] = [direction, turn].map(|v| [v.x, v.y, v.z]);
            let row = [arm.dot(&direction), d[0], d[1], d[2], t[0], t[1], t[2]];
            rows.push((SVector::from_row_slice(&row), off.dot(&direction)));
        }
    }
    let solved = |deviation: f64| {
        let weight = STEP / ALIKE / (deviation * deviation);
        let mut normal = SMatrix::<f64, 7, 7>::zeros();
        let mut right = SVector::<f64, 7>::zeros();
        for (row, off) in &rows {
            normal += row * row.transpose() * weight;
            right += row * (off * weight);
        }
        for k in 1..7 {
            normal[(k, k)] += 1.0 / (SHIFT * SHIFT);
        }
        let inverse = normal.try_inverse().filter(|i| i[(0, 0)] > 0.0)?;
        Some((inverse * right, inverse[(0, 0)]))
    };
    let (first, _) = solved(DEVIATION)?;
    let square: f64 = rows.iter().map(|(row, off)| (off - row.dot(&first)).powi(2)).sum();
    let (found, variance) = solved((2.0 * square / rows.len() as f64).sqrt().max(DEVIATION))?;
    Some(Larger { by: found[0], variance })
}

/// Where the vertices of a template go [m] for its loops to grow by factors, each about its own centre; cloth beside them less and less.
pub(super) fn grown(template: &Template, factors: &[f64]) -> Vec<Vec3> {
    let place = |v: &u32| template.mesh.vertices[*v as usize];
    let mut moves = vec![Vec3::zeros(); template.mesh.vertices.len()];
    for (ring, factor) in template.loops.iter().zip(factors).filter(|(_, f)| **f != 1.0) {
        let rim = Rim { points: ring.vertices.iter().map(place).collect(), closed: true };
        let centre = rim.centre();
        for (p, moved) in template.mesh.vertices.iter().zip(&mut moves) {
            *moved += (p - centre) * ((factor - 1.0) * (1.0 - smooth_step(0.0, MOVES, rim.distance(p))));
        }
    }
    moves
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::template::{GarmentKind, Style};
    use caphy_core::TriMesh;

    /// An arc of an ellipse in the plane y = `height` [m], from the one angle to the other.
    fn arc([wide, deep]: [f64; 2], height: f64, angles: [f64; 2], at: Vec3) -> Rim {
        let count = 120;
        let point = |i: i32| {
            let (sin, cos) = (angles[0] + (angles[1] - angles[0]) * f64::from(i) / f64::from(count)).sin_cos();
            Vec3::new(wide * cos, height, deep * sin) + at
        };
        let closed = angles == ALL;
        Rim { points: (0..count + i32::from(!closed)).map(point).collect(), closed }
    }
    const ALL: [f64; 2] = [0.0, std::f64::consts::TAU];

    #[test]
    fn smoothing_keeps_ends_and_makes_zigzags_straight() {
        let zigzag = |i: i32| Vec3::new(2e-3 * f64::from(i), if i % 2 == 0 { 2e-3 } else { -2e-3 }, 0.0);
        let open = Rim { points: (0..101).map(zigzag).collect(), closed: false };
        assert!(open.length() > 0.44);
        let smooth = open.smoothed();
        assert!((smooth.points[0] - zigzag(0)).norm() < 1e-12);
        assert!((smooth.points[smooth.points.len() - 1] - zigzag(100)).norm() < 1e-12);
        let inner = &smooth.points[20..smooth.points.len() - 20];
        assert!(inner.iter().all(|p| p.y.abs() < 1e-3), "{inner:?}");
        // Of a circle a Gaussian leaves exp(-σ²/2r²), all around alike.
        let circle = arc([0.09; 2], 0.0, ALL, Vec3::zeros()).smoothed();
        let left = 0.09 * (-0.5 * (SMOOTH / 0.09f64).powi(2)).exp();
        let radii: Vec<f64> = circle.points.iter().map(|p| p.norm()).collect();
        assert!(radii.iter().all(|r| (r - left).abs() < 5e-5), "{left} {radii:?}");
    }

    #[test]
    fn a_size_is_told_from_places_that_differ_by_scan() {
        // The front half of a neckline in one scan, its back in another: 4 % smaller, elsewhere by 3 mm in each.
        let neck = arc([0.1, 0.08], 1.4, ALL, Vec3::zeros());
        let smaller = [0.096, 0.0768];
        let scans = [([0.0, 3.1], Vec3::new(0.0, 0.0, -0.003)), ([3.2, 6.2], Vec3::new(0.003, 0.001, 0.0))];
        let said: Vec<Larger> = scans
            .iter()
            .filter_map(|&(angles, shift)| larger(&[neck.smoothed()], &[arc(smaller, 1.4, angles, shift)])[0])
            .collect();
        assert_eq!(said.len(), 2);
        let by = together(said.iter().copied());
        // Each by itself takes some of the shift for a size; the template's own girth is believed a little.
        assert!((by + 0.04).abs() < 0.012, "{by} {said:?}");
        let whole = larger(&[neck.smoothed()], &[arc(smaller, 1.4, ALL, Vec3::new(0.003, 0.0, 0.002))])[0].unwrap();
        assert!((whole.by + 0.04).abs() < 1e-3 && whole.variance < said[0].variance, "{whole:?}");
        // The same size, turned: no larger.
        let turned = nalgebra::Rotation3::from_scaled_axis(Vec3::new(0.03, 0.0, 0.02));
        let mut leaning = arc([0.1, 0.08], 0.0, ALL, Vec3::zeros());
        leaning.points.iter_mut().for_each(|p| *p = turned * *p + Vec3::new(0.0, 1.4, 0.0));
        assert!(larger(&[neck.smoothed()], &[leaning])[0].unwrap().by.abs() < 1e-3);
        // Far away, too short, or nothing: nothing is said.
        let far = arc(smaller, 1.5, ALL, Vec3::zeros());
        let short = arc(smaller, 1.4, [0.0, 0.3], Vec3::zeros());
        for pieces in [&[far][..], &[short], &[]] {
            assert!(larger(&[neck.smoothed()], pieces)[0].is_none());
        }
    }

    #[test]
    fn scans_that_contradict_each_other_are_believed_less() {
        let said = |by: f64| Larger { by, variance: 1e-4 };
        let agreeing = together([said(0.03), said(0.03)].into_iter());
        assert!((agreeing - 0.03 * 4e-4 / 4.5e-4).abs() < 1e-9, "{agreeing}");
        // χ² = 18 for one degree of freedom.
        let apart = together([said(0.06), said(0.0)].into_iter());
        assert!((apart - 0.03 * 4e-4 / (4e-4 + 9e-4)).abs() < 1e-9, "{apart}");
        assert_eq!(together(std::iter::empty()), 0.0);
    }

    /// A tube along y between a neck above and a hem below.
    fn tube() -> Template {
        let mut mesh = TriMesh::default();
        for i in 0..9 {
            for k in 0..36 {
                let (s, c) = (std::f64::consts::TAU * f64::from(k) / 36.0).sin_cos();
                mesh.vertices.push(Vec3::new(0.1 * c, 0.03 * f64::from(i), 0.1 * s));
            }
        }
        for i in 0..8u32 {
            for k in 0..36 {
                let (p, q) = (36 * i + k, 36 * i + (k + 1) % 36);
                mesh.faces.extend([[p, p + 36, q], [q, p + 36, q + 36]]);
            }
        }
        let ring = |name: &str, ids: std::ops::Range<u32>| NamedLoop { name: name.into(), vertices: ids.collect() };
        Template {
            kind: GarmentKind::Upper,
            style: Style::from_values(GarmentKind::Upper, &[0.4, 0.5, 0.02, 0.3]).unwrap(),
            weights_body_vertex: vec![0; mesh.vertices.len()],
            loops: vec![ring("neck", 288..324), ring("hem", 0..36)],
            material_uv: vec![[[0.0; 2]; 3]; mesh.faces.len()],
            mesh,
            resolution_m: 0.03,
            grain: "test".into(),
            clearance_m: 0.004,
            given: None,
        }
    }

    #[test]
    fn taut_edges_grow_to_what_scans_show_and_slack_ones_do_not() {
        let template = tube();
        // The neck is stretched by 5 % as it is worn, the hem is not.
        let stretch = |v: usize| if v < 288 { 1.0 } else { 1.05 };
        let place = |(v, p): (usize, &Vec3)| Vec3::new(p.x * stretch(v), p.y, p.z * stretch(v));
        let worn: Vec<Vec3> = template.mesh.vertices.iter().enumerate().map(place).collect();
        let rims = [arc([0.103 * 1.05; 2], 0.24, ALL, Vec3::zeros()), arc([0.103; 2], 0.0, ALL, Vec3::zeros())];
        let seen = Seen { points: &[], edges: &[], rims: &rims, covered_by: &[] };
        let [neck, hem] = girths(&template, &[worn.clone(), worn.clone()], &[seen, seen])[..] else { panic!() };
        // The template's polygon of 36 sides is known to a thousandth.
        assert!((neck - 1.03).abs() < 3e-3 && hem == 1.0, "{neck} {hem}");
        let nothing = Seen { rims: &[], ..seen };
        assert_eq!(girths(&template, std::slice::from_ref(&worn), &[nothing]), [1.0, 1.0]);
        // Taut in one scan of three.
        let slack = template.mesh.vertices.clone();
        assert_eq!(girths(&template, &[worn, slack.clone(), slack], &[seen; 3]), [1.0, 1.0]);

        let moves = grown(&template, &[1.03, 1.0]);
        let mut larger = template.clone();
        larger.mesh.vertices.iter_mut().zip(&moves).for_each(|(p, m)| *p += m);
        let girth = |t: &Template, k: usize| t.girths()[k].1;
        assert!((girth(&larger, 0) - 1.03 * girth(&template, 0)).abs() < 1e-12);
        for (p, m) in template.mesh.vertices.iter().zip(&moves) {
            assert!((p.y < 0.19) == (m.norm() < 1e-12) && m.norm() < 0.0031, "{p:?} {m:?}");
        }
    }
}
