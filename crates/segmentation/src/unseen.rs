//! Labels of vertices that no view shows: slits under collars and cuffs, and between limbs.

use crate::fusion::{count, majority};
use caphy_core::Vec3;
use caphy_core::query::{Adjacency, NearestGrid};
use caphy_core::scan::{Label, Scan};
use rayon::prelude::*;

/// Vertices that are seen show the colours of their labels to unseen ones as far as this [m]: skin in a slit under a cuff and the arm.
const REACH: f64 = 0.1;
/// A label is known by so many of its vertices around, those with the likest colours: fewer may have been labelled wrongly.
const KNOWN_BY: usize = 8;
/// Colours are as much apart as noise is [levels of 255], and so many times more to say another label than the neighbours'.
const NOISE: f64 = 6.0;
const CLEARLY: f64 = 2.0;
/// No more seen vertices are compared with than about so many: scans of a million would take minutes.
const COMPARED: usize = 100_000;

/// Gives labels to vertices without one: breadth-first along edges, each ring by the majority of its labelled
/// neighbours; for components without any, from the nearest seen vertex; then colours may know better.
pub(crate) fn fill(scan: &Scan, adjacency: &Adjacency, seen: &[bool], labels: &mut [Label]) {
    let vertices = &scan.mesh.vertices;
    let mut ring: Vec<u32> = (0..labels.len() as u32).filter(|&v| labels[v as usize] != Label::Ignore).collect();
    let mut queued: Vec<bool> = seen.to_vec();
    while !ring.is_empty() {
        let mut next = Vec::new();
        for &v in &ring {
            for &w in adjacency.of(v as usize) {
                if !std::mem::replace(&mut queued[w as usize], true) {
                    next.push(w);
                }
            }
        }
        // All of a ring is decided from the rings before it, so that the order inside a ring does not matter.
        let decided: Vec<Label> = next.iter().map(|&w| neighbours_label(adjacency, labels, w as usize)).collect();
        for (&w, label) in next.iter().zip(decided) {
            labels[w as usize] = label;
        }
        ring = next;
    }
    if labels.contains(&Label::Ignore) {
        let sources: Vec<usize> = (0..labels.len()).filter(|&v| seen[v]).collect();
        let points: Vec<Vec3> = sources.iter().map(|&v| vertices[v]).collect();
        let grid = NearestGrid::from_points(&points);
        for v in 0..labels.len() {
            if labels[v] == Label::Ignore
                && let Some((nearest, _)) = grid.nearest_point(&vertices[v])
            {
                labels[v] = labels[sources[nearest as usize]];
            }
        }
    }
    if let Some(colours) = &scan.colours {
        by_colour(vertices, colours, seen, labels);
    }
}

/// The commonest label among a vertex's neighbours, [`Label::Ignore`] when none has one.
fn neighbours_label(adjacency: &Adjacency, labels: &[Label], vertex: usize) -> Label {
    let mut votes = [0; 3];
    adjacency.of(vertex).iter().for_each(|&w| count(&mut votes, labels[w as usize]));
    majority(&votes).map_or(Label::Ignore, |(label, _)| label)
}

/// Unseen vertices take another label when its colours around them are clearly more like theirs than those of the one that they have.
fn by_colour(vertices: &[Vec3], colours: &[[u8; 3]], seen: &[bool], labels: &mut [Label]) {
    let known: Vec<usize> = (0..labels.len()).filter(|&v| seen[v]).collect();
    let known: Vec<usize> = known.iter().copied().step_by(known.len().div_ceil(COMPARED).max(1)).collect();
    let decided = |v: usize| {
        let mut apart: [Vec<f64>; 3] = Default::default();
        for &w in known.iter().filter(|&&w| (vertices[w] - vertices[v]).norm_squared() <= REACH * REACH) {
            if let Some(of_label) = apart.get_mut(labels[w] as usize) {
                let channels = colours[v].iter().zip(&colours[w]);
                of_label.push(channels.map(|(a, b)| (f64::from(*a) - f64::from(*b)).powi(2)).sum::<f64>().sqrt());
            }
        }
        // The KNOWN_BY-th likest; no label has colours that it does not show here.
        let likest = apart.map(|mut of_label| {
            let enough = of_label.len() >= KNOWN_BY;
            enough.then(|| *of_label.select_nth_unstable_by(KNOWN_BY - 1, f64::total_cmp).1 + NOISE)
        });
        let found = Label::ALL.into_iter().filter_map(|l| Some((l, likest[l as usize]?)));
        let own = likest.get(labels[v] as usize).copied().flatten();
        match (found.min_by(|a, b| a.1.total_cmp(&b.1)), own) {
            (Some((label, best)), Some(own)) if CLEARLY * best < own => label,
            _ => labels[v],
        }
    };
    let unseen: Vec<usize> = (0..labels.len()).filter(|&v| !seen[v]).collect();
    let new: Vec<Label> = unseen.par_iter().map(|&v| decided(v)).collect();
    unseen.into_iter().zip(new).for_each(|(v, label)| labels[v] = label);
}

#[cfg(test)]
mod tests {
    use super::*;
    use caphy_core::TriMesh;

    /// A sleeve's edge over a slit: rows of 25 vertices 4 mm apart, of cloth, of skin that no view shows, then a gap in the mesh and two of
    /// seen skin.
    fn slit(hidden: [u8; 3]) -> (Scan, Vec<bool>, Vec<Label>) {
        let (cloth, skin) = ([30, 40, 120], [190, 150, 130]);
        let place = |row: u32, k: u32| Vec3::new(0.004 * f64::from(k), 0.004 * f64::from(row), 0.0);
        let square = |i: u32| [[i, i + 1, i + 25], [i + 1, i + 26, i + 25]];
        let faces = (0..75).filter(|i| i % 25 < 24 && i / 25 != 1).flat_map(square).collect();
        let vertices = (0..100).map(|i| place(i / 25, i % 25)).collect();
        let row = |i: usize| i / 25;
        let shade = |i: usize, c: [u8; 3]| c.map(|x| x - (i % 5) as u8);
        let colours = (0..100).map(|i| shade(i, [cloth, hidden, skin, skin][row(i)])).collect();
        let labels = (0..100).map(|i| [Label::Upper, Label::Ignore, Label::Body, Label::Body][row(i)]).collect();
        let seen = (0..100).map(|i| row(i) != 1).collect();
        let mesh = TriMesh { vertices, faces };
        (Scan { name: "slit".into(), mesh, colours: Some(colours), labels: None }, seen, labels)
    }

    #[test]
    fn skin_in_a_slit_under_cloth_is_known_by_its_colour() {
        let filled = |hidden: [u8; 3], colours: bool| {
            let (mut scan, seen, mut labels) = slit(hidden);
            scan.colours = scan.colours.filter(|_| colours);
            let adjacency = Adjacency::new(100, &scan.mesh.faces);
            fill(&scan, &adjacency, &seen, &mut labels);
            assert!((0..100).all(|v| !seen[v] || labels[v] == slit(hidden).2[v]), "what is seen stays");
            labels[25..50].to_vec()
        };
        // Along edges only the cloth is near; skin in the dark is still more like skin.
        assert_eq!(filled([184, 145, 126], true), [Label::Body; 25]);
        assert_eq!(filled([184, 145, 126], false), [Label::Upper; 25]);
        assert_eq!(filled([33, 41, 118], true), [Label::Upper; 25]);
        // Between both: the neighbours say.
        assert_eq!(filled([110, 95, 125], true), [Label::Upper; 25]);
    }
}
