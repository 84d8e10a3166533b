//! Patches of a label too small to be skin or cloth of their own: a crease as dark as hair, a check in the colour of skin.

use super::fusion::{count, majority};
use caphy_core::TriMesh;
use caphy_core::query::Adjacency;
use caphy_core::scan::Label;

/// Gives connected patches of one label with an area below `smallest` [m²] the label that most edges around them lead to, smallest patches
/// first. A piece of mesh that has one label all over keeps it, whatever its size.
pub(crate) fn without_islands(mesh: &TriMesh, adjacency: &Adjacency, labels: &mut [Label], smallest: f64) {
    let mut areas = vec![0.0; labels.len()];
    for (face, area) in mesh.faces.iter().zip(mesh.face_areas()) {
        face.iter().for_each(|&v| areas[v as usize] += area / 3.0);
    }
    // What a patch has taken may be an island again: a dot on a patch that is taken itself.
    let mut before = usize::MAX;
    loop {
        let patches = patches(adjacency, labels);
        let count_now = patches.len();
        let mut small: Vec<(f64, Vec<u32>)> = patches
            .into_iter()
            .map(|patch| (patch.iter().map(|&v| areas[v as usize]).sum::<f64>(), patch))
            .filter(|(area, _)| *area < smallest)
            .collect();
        if small.is_empty() || count_now >= before {
            return;
        }
        before = count_now;
        small.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1[0].cmp(&b.1[0])));
        for (_, patch) in small {
            let own = labels[patch[0] as usize];
            let mut votes = [0; 3];
            for &w in patch.iter().flat_map(|&v| adjacency.of(v as usize)) {
                if labels[w as usize] != own {
                    count(&mut votes, labels[w as usize]);
                }
            }
            if let Some((label, _)) = majority(&votes) {
                patch.iter().for_each(|&v| labels[v as usize] = label);
            }
        }
    }
}

/// Vertices of each connected patch of one label; patches by their first vertex.
fn patches(adjacency: &Adjacency, labels: &[Label]) -> Vec<Vec<u32>> {
    let mut met = vec![false; labels.len()];
    let mut out = Vec::new();
    for start in 0..labels.len() {
        if std::mem::replace(&mut met[start], true) {
            continue;
        }
        let mut patch = vec![start as u32];
        let mut next = 0;
        while let Some(&v) = patch.get(next) {
            next += 1;
            for &w in adjacency.of(v as usize) {
                if labels[w as usize] == labels[start] && !std::mem::replace(&mut met[w as usize], true) {
                    patch.push(w);
                }
            }
        }
        out.push(patch);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use caphy_core::Vec3;

    /// A sheet of 21 x 21 vertices, 1 cm apart: 1 cm² each.
    fn sheet() -> TriMesh {
        let square = |i: u32| [[i, i + 1, i + 21], [i + 1, i + 22, i + 21]];
        TriMesh {
            vertices: (0..441).map(|i| Vec3::new(f64::from(i % 21), f64::from(i / 21), 0.0) * 0.01).collect(),
            faces: (0..420).filter(|i| i % 21 < 20).flat_map(square).collect(),
        }
    }

    #[test]
    fn small_patches_take_the_label_around_them_and_large_ones_stay() {
        let mesh = sheet();
        let adjacency = Adjacency::new(441, &mesh.faces);
        let at = |x: usize, y: usize| 21 * y + x;
        let mut labels = vec![Label::Upper; 441];
        // Skin of 4 x 4 = 16 cm² with a dot of trousers inside, and of 5 x 5 = 25 cm².
        (0..16).for_each(|i| labels[at(3 + i % 4, 3 + i / 4)] = Label::Body);
        labels[at(4, 4)] = Label::Lower;
        (0..25).for_each(|i| labels[at(12 + i % 5, 12 + i / 5)] = Label::Body);
        let mut wanted = vec![Label::Upper; 441];
        (0..25).for_each(|i| wanted[at(12 + i % 5, 12 + i / 5)] = Label::Body);
        without_islands(&mesh, &adjacency, &mut labels, 20e-4);
        assert!(labels == wanted);
        // All of a piece of mesh: nothing around it says otherwise.
        let mut alone = vec![Label::Body; 441];
        without_islands(&mesh, &adjacency, &mut alone, 1.0);
        assert!(alone.iter().all(|l| *l == Label::Body));
        labels[0] = Label::Lower;
        let before = labels.clone();
        without_islands(&mesh, &adjacency, &mut labels, 0.0);
        assert!(labels == before, "0 takes nothing away");
    }
}
