//! By how much the edges of a worn garment are too wide or too narrow for what scans show of them.
//!
//! A taut edge lies where its girth lets it. A neckline that lies 4 mm too far out all around is 25 mm too wide, and no fit of edges feels
//! it: where the body under it is fitted some millimetres off, in each scan elsewhere, so is the garment, and scans show half of an edge.
//! So each scan may move and turn an edge a little, and what all of them have in common is how much larger it is about its own centre: a
//! Gauss-Newton step of a similarity transformation whose rigid part is each scan's own.
//!
//! A slack edge, such as a hem, hangs anywhere, in folds that are other ones in each scan and in each garment. Where all of it is seen, its
//! size is known as that of a taut one. A part tells nothing: scans show best where cloth lies on the skin, which is where it is narrowest.

use super::refine::{OTHERS_M, Seen, median};
use super::rim::{Rim, STEP};
use super::shape::smooth_step;
use super::{NamedLoop, Template};
use caphy_core::Vec3;
use nalgebra::{SMatrix, SVector};

/// Pieces shorter than this do not say much [m].
const SHORTEST: f64 = 0.05;
/// How far a garment lies from where it should in one scan, as a whole and by a turn [m]: as bodies are fitted.
const SHIFT: f64 = 3e-3;
/// By how much a template's girths are off without this [1], of taut edges and of slack ones.
const OFF: [f64; 2] = [0.02, 0.03];
/// Least deviation of an edge from its fitted place [m], and how far along it deviations are alike [m]: folds, triangles.
const DEVIATION: f64 = 2e-3;
const ALIKE: f64 = 0.06;
/// An edge this much longer than at rest lies where its girth lets it; a slack one, such as a hem, folds, as does one that is taut in less
/// than half of the scans, such as the cuff of a lifted arm.
const TAUT: f64 = 1.02;
/// Of a slack edge a scan shows the size where it shows all of it but this share [1]: where it hangs is chance, and a part lies nearer or
/// farther.
const WHOLE: f64 = 0.15;
/// And where it has the same shape there: about its centre an ellipse, or a line in folds, is smaller than a circle of the same girth. By half
/// a percent where it lies this far from it on average, as a share of the radius.
const SHAPE: f64 = 0.06;
/// How far from an edge cloth moves with it [m].
const MOVES: f64 = 0.06;

/// How much larger an edge is [1], with its variance.
#[derive(Debug, Clone, Copy)]
struct Larger {
    by: f64,
    variance: f64,
}

/// What a scan says of an edge.
#[derive(Debug, Clone, Copy)]
struct Said {
    /// Whether the garment's edge is taut there.
    taut: bool,
    /// How much larger about its own centre, by what is known well.
    size: Option<Larger>,
    /// The same where nearly all of it is seen, in the garment's shape.
    whole: Option<Larger>,
}

/// By what the girth of each loop of a template has to grow [1] to be what scans show; 1 where they do not show it.
pub(super) fn girths(template: &Template, worn: &[Vec<Vec3>], seen: &[Seen<'_>]) -> Vec<f64> {
    let edges = |vertices: &[Vec3]| -> Vec<Rim> {
        let rim =
            |l: &NamedLoop| Rim { points: l.vertices.iter().map(|&v| vertices[v as usize]).collect(), closed: true };
        template.loops.iter().map(rim).collect()
    };
    let rest: Vec<f64> = edges(&template.mesh.vertices).iter().map(Rim::length).collect();
    let of_scan = |(vertices, seen): (&Vec<Vec3>, &Seen<'_>)| -> Vec<Said> {
        let worn = edges(vertices);
        let smooth: Vec<Rim> = worn.iter().map(Rim::smoothed).collect();
        let pieces = beside(&smooth, seen.rims);
        let joined = beside(&smooth, seen.joined);
        let points = |rims: &[Rim]| rims.iter().flat_map(|r| &r.points).copied().collect::<Vec<_>>();
        let all_around = |k: usize| {
            let seen: f64 = joined[k].iter().map(|piece| smooth[k].beside(piece)).sum();
            (seen / smooth[k].length() - 1.0).abs() < WHOLE
        };
        let whole = |k: usize| {
            let size = all_around(k).then(|| similar(&smooth[k], &points(&joined[k]))).flatten();
            size.filter(|s| s.1 < SHAPE).map(|s| s.0)
        };
        let said = |k: usize| Said {
            taut: worn[k].length() >= TAUT * rest[k],
            size: similar(&smooth[k], &points(&pieces[k])).map(|s| s.0),
            whole: whole(k),
        };
        (0..worn.len()).map(said).collect()
    };
    let scans: Vec<Vec<Said>> = worn.iter().zip(seen).map(of_scan).collect();
    let factor = |k: usize| {
        let all = scans.iter().map(|scan| scan[k]);
        let taut = all.clone().filter(|said| said.taut);
        let often = 2 * taut.clone().count() >= scans.len();
        1.0 + if often {
            together(taut.filter_map(|s| s.size), OFF[0])
        } else {
            together(all.filter_map(|s| s.whole), OFF[1])
        }
    };
    (0..template.loops.len()).map(factor).collect()
}

/// What scans say together, as far as they know it better than the template does: less where they differ by more than they should.
fn together(scans: impl Iterator<Item = Larger> + Clone, off: f64) -> f64 {
    let known: f64 = scans.clone().map(|s| 1.0 / s.variance).sum();
    if known == 0.0 {
        return 0.0;
    }
    let mean = scans.clone().map(|s| s.by / s.variance).sum::<f64>() / known;
    let (count, misfit) = scans.fold((0usize, 0.0), |(n, sum), s| (n + 1, sum + (s.by - mean).powi(2) / s.variance));
    let inflated = (misfit / count.saturating_sub(1).max(1) as f64).max(1.0) / known;
    mean * off * off / (off * off + inflated)
}

/// Of each of a worn garment's edges the pieces in a scan that lie at it, smoothed as it is.
fn beside(edges: &[Rim], pieces: &[Rim]) -> Vec<Vec<Rim>> {
    let mut found: Vec<Vec<Rim>> = vec![Vec::new(); edges.len()];
    for piece in pieces.iter().filter(|r| r.length() >= SHORTEST).map(Rim::smoothed) {
        let from = |edge: &Rim| median(piece.points.iter().map(|p| edge.distance(p)));
        let near = edges.iter().map(from).enumerate().min_by(|a, b| a.1.total_cmp(&b.1));
        if let Some((k, _)) = near.filter(|n| n.1 <= OTHERS_M) {
            found[k].push(piece);
        }
    }
    found
}

/// The similarity transformation that takes an edge to points of it, as one step: how much larger; moved and turned within what bodies are
/// off by. Also how far points lie from it then, as a share of its radius. `None` without points, or where they do not tell a size from a
/// place.
fn similar(edge: &Rim, points: &[Vec3]) -> Option<(Larger, f64)> {
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
    let apart = (2.0 * square / rows.len() as f64).sqrt();
    let (found, variance) = solved(apart.max(DEVIATION))?;
    Some((Larger { by: found[0], variance }, apart / radius))
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
    use super::super::rim::tests::{ALL, arc};
    use super::*;
    use crate::template::{GarmentKind, Style};
    use caphy_core::TriMesh;

    fn size(edge: &Rim, pieces: &[Rim]) -> Option<Larger> {
        let edge = edge.smoothed();
        let pieces = beside(std::slice::from_ref(&edge), pieces).concat();
        similar(&edge, &pieces.iter().flat_map(|r| &r.points).copied().collect::<Vec<_>>()).map(|s| s.0)
    }

    #[test]
    fn a_size_is_told_from_places_that_differ_by_scan() {
        // The front half of a neckline in one scan, its back in another: 4 % smaller, elsewhere by 3 mm in each.
        let neck = arc([0.1, 0.08], 1.4, ALL, Vec3::zeros());
        let smaller = [0.096, 0.0768];
        let scans = [([0.0, 3.1], Vec3::new(0.0, 0.0, -0.003)), ([3.2, 6.2], Vec3::new(0.003, 0.001, 0.0))];
        let said: Vec<Larger> =
            scans.iter().filter_map(|&(angles, shift)| size(&neck, &[arc(smaller, 1.4, angles, shift)])).collect();
        assert_eq!(said.len(), 2);
        let by = together(said.iter().copied(), OFF[0]);
        // Each by itself takes some of the shift for a size; the template's own girth is believed a little.
        assert!((by + 0.04).abs() < 0.012, "{by} {said:?}");
        let whole = size(&neck, &[arc(smaller, 1.4, ALL, Vec3::new(0.003, 0.0, 0.002))]).unwrap();
        assert!((whole.by + 0.04).abs() < 1e-3 && whole.variance < said[0].variance, "{whole:?}");
        // The same size, turned: no larger.
        let turned = nalgebra::Rotation3::from_scaled_axis(Vec3::new(0.03, 0.0, 0.02));
        let mut leaning = arc([0.1, 0.08], 0.0, ALL, Vec3::zeros());
        leaning.points.iter_mut().for_each(|p| *p = turned * *p + Vec3::new(0.0, 1.4, 0.0));
        assert!(size(&neck, &[leaning]).unwrap().by.abs() < 1e-3);
        // Far away, too short, or nothing: nothing is said.
        let far = arc(smaller, 1.5, ALL, Vec3::zeros());
        let short = arc(smaller, 1.4, [0.0, 0.3], Vec3::zeros());
        for pieces in [&[far][..], &[short], &[]] {
            assert!(size(&neck, pieces).is_none());
        }
    }

    #[test]
    fn scans_that_contradict_each_other_are_believed_less() {
        let said = |by: f64| Larger { by, variance: 1e-4 };
        let agreeing = together([said(0.03), said(0.03)].into_iter(), OFF[0]);
        assert!((agreeing - 0.03 * 4e-4 / 4.5e-4).abs() < 1e-9, "{agreeing}");
        // χ² = 18 for one degree of freedom.
        let apart = together([said(0.06), said(0.0)].into_iter(), OFF[0]);
        assert!((apart - 0.03 * 4e-4 / (4e-4 + 9e-4)).abs() < 1e-9, "{apart}");
        assert_eq!(together(std::iter::empty(), OFF[0]), 0.0);
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
    fn taut_edges_grow_to_the_place_that_scans_show_and_slack_ones_where_all_is_seen() {
        let template = tube();
        // The neck is stretched by 5 % as it is worn, the hem is not.
        let stretch = |v: usize| if v < 288 { 1.0 } else { 1.05 };
        let place = |(v, p): (usize, &Vec3)| Vec3::new(p.x * stretch(v), p.y, p.z * stretch(v));
        let worn: Vec<Vec3> = template.mesh.vertices.iter().enumerate().map(place).collect();
        // Beside the hem lies all of a narrower line, which is skin's: a slack edge is told by what is joined alone.
        let rims = [arc([0.103 * 1.05; 2], 0.24, ALL, Vec3::zeros()), arc([0.097; 2], 0.0, ALL, Vec3::zeros())];
        let seen = Seen { points: &[], edges: &[], rims: &rims, joined: &[], covered_by: &[] };
        let [neck, hem] = girths(&template, &[worn.clone(), worn.clone()], &[seen, seen])[..] else { panic!() };
        // The template's polygon of 36 sides is known to a thousandth.
        assert!((neck - 1.03).abs() < 3e-3 && hem == 1.0, "{neck} {hem}");
        let nothing = Seen { rims: &[], ..seen };
        assert_eq!(girths(&template, std::slice::from_ref(&worn), &[nothing]), [1.0, 1.0]);
        // A slack hem that is seen across gaps, from all around or from the front alone, hanging 6 mm nearer.
        let nearer = Vec3::new(0.006, 0.0, 0.0);
        let [all, front] = [ALL, [-1.3, 1.3]].map(|angles| [arc([0.103; 2], 0.0, angles, nearer)]);
        let seen_as = |joined| Seen { rims: &[], joined, ..seen };
        let by = |seen| girths(&template, &[worn.clone(), worn.clone()], &[seen, seen])[1] - 1.0;
        // One step from 6 mm beside it is off by 6²/2 · 100 mm, 0.2 %.
        assert!((by(seen_as(&all)) - 0.03).abs() < 0.002, "{}", by(seen_as(&all)));
        assert_eq!(by(seen_as(&front)), 0.0);
        // Of the same length as the garment's, but flat: about its centre it is smaller.
        let flat = [arc([0.11, 0.0895], 0.0, ALL, Vec3::zeros())];
        let longer = flat[0].length() / arc([0.1; 2], 0.0, ALL, Vec3::zeros()).length() - 1.0;
        assert!(longer.abs() < 1e-3 && by(seen_as(&flat)) == 0.0, "{longer} {}", by(seen_as(&flat)));
        // Taut in one scan of three: how it lies in that says nothing of it.
        let slack = template.mesh.vertices.clone();
        let narrow = [arc([0.1 * 1.05; 2], 0.24, ALL, Vec3::zeros())];
        let narrow = Seen { rims: &narrow, ..seen };
        let as_long = [arc([0.1; 2], 0.24, ALL, Vec3::zeros())];
        let as_long = Seen { rims: &as_long, ..seen };
        let [neck, hem] = girths(&template, &[worn, slack.clone(), slack], &[narrow, as_long, as_long])[..] else {
            panic!()
        };
        assert!((neck - 1.0).abs() < 3e-3 && hem == 1.0, "{neck} {hem}");

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
