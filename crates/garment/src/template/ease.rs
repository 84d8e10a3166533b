//! A template as wide and as long as the scans show it, where no style says so.
//!
//! A style has one ease for all of a garment, one shape of neckline, and it is cut on a body that is itself millimetres off under cloth.
//! What is left between the worn template and the scans, averaged over a wide neighbourhood and several poses so that folds cancel, is how
//! much wider the garment is there: it moves along its normals by that. How far the scans' edges lie beyond its own is how much longer it
//! is there: its edges, and less so the cloth beside them, move along the surface. Differs from the paper, whose template is a style's.

use super::refine::{Boundary, OTHERS, OTHERS_M, Patches, Refinement, Seen, WornAs, median, passed_over};
use super::response::{cost_of, near_cost_of};
use super::shape::smooth_step;
use super::{Tailor, Template, grain};
use caphy_core::query::NearestSurface;
use caphy_core::{Result, Vec3, mesh};
use rayon::prelude::*;

/// Width of the neighbourhood that distances are averaged over [m]: wider than folds, narrower than a trunk.
const WIDTH: f64 = 0.045;
/// Distances beyond this pull no harder [m].
const LARGEST: f64 = 0.01;
/// Half the length of edge whose scanned points say together how far it is off [m].
const EDGE: f64 = 0.04;
/// Most that an edge moves at a time [m], and how far from it cloth moves with it [m]: triangles keep half of their height.
const LARGEST_EDGE: f64 = 0.015;
const MOVES: f64 = 0.06;
/// A scan with so many points around a place is heard by half.
const STILL: f64 = 4.0;
/// Most rounds: worn again, cloth answers less than it was moved where it folds.
const ROUNDS: usize = 4;
/// Share of the cost of what is near that a round has to take away: the same garment in other folds differs by a few hundredths.
const WORTH_IT: f64 = 0.1;

/// Moves a finished template towards scans; `wear` as of [`super::finish`]. Given garments keep their own shape.
///
/// # Errors
/// Those of `wear`.
pub fn ease(
    tailor: &Tailor,
    finished: Refinement,
    seen: &[Seen<'_>],
    wear: impl Fn(&Template, usize, Option<WornAs<'_>>) -> Result<Vec<Vec3>> + Sync,
) -> Result<Refinement> {
    let mut now = finished;
    if now.template.given.is_some() {
        return Ok(now);
    }
    let patches: Vec<Patches> = seen.iter().map(Patches::new).collect();
    let residuals = |worn: &[Vec<Vec3>], faces: &[[u32; 3]]| -> Result<Vec<f64>> {
        let each = patches.iter().zip(seen).zip(worn).map(|((p, s), w)| p.residuals(s, w, faces));
        Ok(each.collect::<Result<Vec<_>>>()?.concat())
    };
    let start = residuals(&now.worn, &now.template.mesh.faces)?;
    let (mut cost, mut near) = (cost_of(&start, OTHERS), near_cost_of(&start, OTHERS));
    for _ in 0..ROUNDS {
        let template = tailor.moved(&now.template, &moves(&now.template, &now.worn, seen)?);
        let like = |vertices| Some(WornAs { template: &now.template, vertices });
        let worn = now.worn.par_iter().enumerate().map(|(scan, worn)| wear(&template, scan, like(worn)));
        let worn = worn.collect::<Result<Vec<_>>>();
        let Some(worn) = passed_over(worn)? else { break };
        let residuals = residuals(&worn, &template.mesh.faces)?;
        let reached = cost_of(&residuals, OTHERS);
        if reached > cost - WORTH_IT * near {
            break;
        }
        (cost, near) = (reached, near_cost_of(&residuals, OTHERS));
        now.replace(&patches, template, worn, &residuals);
    }
    Ok(now)
}

/// Where the vertices of a template go [m]: along normals as [`offsets`] say, and along the surface with its edges.
fn moves(template: &Template, worn: &[Vec<Vec3>], seen: &[Seen<'_>]) -> Result<Vec<Vec3>> {
    let normals = template.mesh.vertex_normals();
    let edges = edge_moves(template, worn, seen);
    let along = |p: &Vec3, normal: &Vec3| {
        let (mut sum, mut weight, mut nearest) = (Vec3::zeros(), 0.0, f64::INFINITY);
        for (at, shift) in &edges {
            let square = (p - at).norm_squared();
            nearest = nearest.min(square);
            let w = (-0.5 * square / (EDGE * EDGE)).exp();
            sum += shift * w;
            weight += w;
        }
        let moved = sum * (1.0 - smooth_step(0.0, MOVES, nearest.sqrt())) / f64::max(weight, f64::MIN_POSITIVE);
        moved - normal * normal.dot(&moved)
    };
    let offsets = offsets(template, worn, seen)?;
    let rows = template.mesh.vertices.par_iter().zip(&normals).zip(offsets);
    Ok(rows.map(|((p, n), d)| n * d + along(p, n)).collect())
}

/// Middles of a template's edges, and how far along the surface the scans have them [m].
fn edge_moves(template: &Template, worn: &[Vec<Vec3>], seen: &[Seen<'_>]) -> Vec<(Vec3, Vec3)> {
    let rest = Boundary::new(&template.mesh.vertices, &template.mesh.faces);
    let middle = |k: usize| (rest.edges[k].0[0] + rest.edges[k].0[1]) * 0.5;
    let known: Vec<Vec<(Vec3, f64)>> = worn
        .iter()
        .zip(seen)
        .map(|(vertices, seen)| {
            // Of the same faces: the edges are in the same order.
            let boundary = Boundary::new(vertices, &template.mesh.faces);
            let beyond = |p: &Vec3| {
                let (k, offset) = boundary.nearest(p)?;
                (offset.norm() <= OTHERS_M).then(|| (middle(k), offset.dot(&boundary.edges[k].1)))
            };
            seen.edges.iter().filter_map(beyond).collect()
        })
        .collect();
    let moved = |k: usize| {
        let at = middle(k);
        let of_scan = |known: &Vec<(Vec3, f64)>| {
            let near: Vec<f64> = known.iter().filter(|(p, _)| (p - at).norm() <= EDGE).map(|k| k.1).collect();
            let count = near.len() as f64;
            Said { value: median(near.into_iter()), weight: count / (count + STILL) }
        };
        let by = agreed(&known.iter().map(of_scan).collect::<Vec<_>>());
        (at, rest.edges[k].1 * by.clamp(-LARGEST_EDGE, LARGEST_EDGE))
    };
    (0..rest.edges.len()).into_par_iter().map(moved).collect()
}

/// What one scan says of a place.
struct Said {
    /// A distance [m].
    value: f64,
    /// How much it is heard: less where little is seen, at most 1.
    weight: f64,
}

/// What scans say together: their mean, as far as they agree. Folds lie elsewhere in each scan; what a garment is too narrow by shows in
/// all. (Of the mean m with its variance v the share m²/(m² + v), which is the mean's best scale where m is the truth.)
fn agreed(said: &[Said]) -> f64 {
    let heard: f64 = said.iter().map(|s| s.weight).sum();
    let mean = said.iter().map(|s| s.weight * s.value).sum::<f64>() / heard.max(f64::MIN_POSITIVE);
    let spread: f64 = said.iter().map(|s| s.weight * (s.value - mean).powi(2)).sum();
    let variance = if heard > 1.0 { spread / (heard * (heard - 1.0)) } else { 0.0 };
    // Scans that see little say little, even together.
    let trust = heard / said.len().max(1) as f64;
    trust * mean * mean * mean / (mean * mean + variance).max(f64::MIN_POSITIVE)
}

/// How far scans lie outside of a worn template around each of its vertices [m].
fn offsets(template: &Template, worn: &[Vec<Vec3>], seen: &[Seen<'_>]) -> Result<Vec<f64>> {
    let (rest, faces) = (&template.mesh.vertices, &template.mesh.faces);
    let mut known: Vec<Vec<(Vec3, f64)>> = Vec::new();
    for (vertices, seen) in worn.iter().zip(seen) {
        let flat = NearestSurface::new(vertices, faces)?;
        let round = mesh::rounded(vertices, faces);
        let surface = NearestSurface::from_mesh(&round)?;
        let outside = |p: &Vec3| {
            let (place, near) = (flat.nearest(p)?, surface.nearest(p)?);
            let corners = faces[place.face as usize].map(|v| rest[v as usize]);
            let at: Vec3 = corners.iter().zip(&place.barycentric).map(|(c, w)| c * *w).sum();
            let [a, b, c] = round.corners(near.face as usize);
            let normal = (b - a).cross(&(c - a)).try_normalize(0.0).unwrap_or_else(Vec3::zeros);
            Some((at, (p - near.point).dot(&normal).clamp(-LARGEST, LARGEST)))
        };
        known.push(seen.points.iter().filter_map(outside).collect());
    }
    let of_scan = |p: &Vec3, known: &[(Vec3, f64)]| {
        let (mut sum, mut weight) = (0.0, 0.0);
        for (at, distance) in known {
            let square = (p - at).norm_squared() / (WIDTH * WIDTH);
            // Beyond three widths a point weighs less than a hundredth.
            if square < 9.0 {
                let w = (-0.5 * square).exp();
                sum += w * distance;
                weight += w;
            }
        }
        Said { value: sum / f64::max(weight, f64::MIN_POSITIVE), weight: weight / (weight + STILL) }
    };
    let around = |p: &Vec3| agreed(&known.iter().map(|known| of_scan(p, known)).collect::<Vec<_>>());
    Ok(rest.par_iter().map(around).collect())
}

impl Tailor {
    /// A template whose vertices have moved [m], or as far as the skin lets them.
    fn moved(&self, template: &Template, moves: &[Vec3]) -> Template {
        let mut mesh = template.mesh.clone();
        mesh.vertices.iter_mut().zip(moves).for_each(|(p, m)| *p += m);
        self.push_out(&mut mesh);
        let weights_body_vertex = self.nearest_skin(template.kind, &mesh);
        let material_uv = grain::material_uv(&mesh, &self.body, &weights_body_vertex);
        let clearance_m = mesh.vertices.iter().map(|p| self.distance(p)).fold(f64::INFINITY, f64::min);
        Template { mesh, weights_body_vertex, material_uv, clearance_m, ..template.clone() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_scans_agree_on_is_believed_and_folds_are_not() {
        let said =
            |values: &[f64]| agreed(&values.iter().map(|&value| Said { value, weight: 1.0 }).collect::<Vec<_>>());
        assert!((said(&[0.004; 3]) - 0.004).abs() < 1e-12);
        assert!((said(&[0.004]) - 0.004).abs() < 1e-12, "one scan is all there is");
        // A fold in one of three scans: the mean, 3 mm, with a variance of (3 mm)², by half.
        assert!((said(&[0.009, 0.0, 0.0]) - 0.0015).abs() < 1e-9);
        assert!(said(&[0.006, -0.006, 0.0]).abs() < 1e-12 && said(&[]) == 0.0 && said(&[0.0; 3]) == 0.0);
        // A scan that sees little says little.
        let half = agreed(&[Said { value: 0.004, weight: 1.0 }, Said { value: 0.0, weight: 0.0 }]);
        assert!((half - 0.002).abs() < 1e-12, "{half}");
    }
}
