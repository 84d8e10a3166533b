//! A template as wide and as long as the scans show it, where no style says so.
//!
//! A style has one ease for all of a garment, one shape of neckline, and it is cut on a body that is itself millimetres off under cloth.
//! What is left between the worn template and the scans, averaged over a wide neighbourhood and several poses so that folds cancel, is how
//! much wider the garment is there: it moves along its normals by that. How far the scans' edges lie beyond its own is how much longer it
//! is there: its edges, and less so the cloth beside them, move along the surface. At last each edge gets the girth that scans show of it.
//! Differs from the paper, whose template is a style's.

use super::girth::{girths, grown};
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
/// Share of the cost of what is near that a change of width has to take away where one scan says all: the same garment in other folds
/// differs by less. Folds of several scans are other ones each time.
const WORTH_IT: f64 = 0.17;
/// After a round that takes away less than this share there is no other.
const LITTLE: f64 = 0.05;
/// What one scan says beyond so many times the typical deviation counts less, which is no less than this [m]: a fold, a hand.
const APART: f64 = 2.0;
const TYPICAL: f64 = 1e-3;

/// Moves a finished template towards the scans that it was finished with, and its edges towards more after them; `wear` as of
/// [`super::finish`]. Given garments keep their own shape.
///
/// # Errors
/// Those of `wear`.
pub fn ease(
    tailor: &Tailor,
    finished: Refinement,
    seen: &[Seen<'_>],
    wear: impl Fn(&Template, usize, WornAs<'_>) -> Result<Vec<Vec3>> + Sync,
) -> Result<Refinement> {
    let mut now = finished;
    let standing = now.worn.len();
    let more = (now.worn.len()..seen.len())
        .into_par_iter()
        .map(|scan| wear(&now.template, scan, WornAs { template: &now.template, vertices: &now.worn[0], scan: 0 }));
    let more = more.collect::<Result<Vec<_>>>()?;
    now.worn.extend(more);
    if now.template.given.is_some() {
        return Ok(now);
    }
    let patches: Vec<Patches> = seen.iter().map(Patches::new).collect();
    let residuals = |worn: &[Vec<Vec3>], faces: &[[u32; 3]]| -> Result<Vec<f64>> {
        let each = patches.iter().zip(seen).zip(worn).map(|((p, s), w)| p.residuals(s, w, faces));
        Ok(each.collect::<Result<Vec<_>>>()?.concat())
    };
    // `None` for moves that cannot be worn.
    let moved = |now: &Refinement, moves: &[Vec3]| -> Result<Option<Moved>> {
        let template = tailor.moved(&now.template, moves);
        let all = now.worn.par_iter().enumerate();
        let like = |(scan, vertices): (usize, &Vec<Vec3>)| {
            wear(&template, scan, WornAs { template: &now.template, vertices, scan })
        };
        let Some(worn) = passed_over(all.map(like).collect::<Result<Vec<_>>>())? else { return Ok(None) };
        let residuals = residuals(&worn, &template.mesh.faces)?;
        Ok(Some(Moved { template, worn, residuals }))
    };
    let start = residuals(&now.worn, &now.template.mesh.faces)?;
    let (mut cost, mut near) = (cost_of(&start, OTHERS), near_cost_of(&start, OTHERS));
    let worth_it = WORTH_IT / (seen.len().max(1) as f64).sqrt();
    let mut widths = true;
    for _ in 0..ROUNDS {
        // In other poses arms and folds hide one side of sleeves more than the other: edges are seen all the same.
        let offsets = offsets(&now.template, &now.worn[..standing], &seen[..standing])?;
        let Moves { across, along } = Moves::new(&now.template, &offsets, &edge_moves(&now.template, &now.worn, seen));
        let cheaper = |by: f64| move |m: &Moved| cost_of(&m.residuals, OTHERS) < cost - by;
        let mut to = None;
        if widths {
            // Folds make cloth look wider or narrower: that has to pay.
            let both: Vec<Vec3> = across.iter().zip(&along).map(|(a, b)| a + b).collect();
            to = moved(&now, &both)?.filter(cheaper(worth_it * near));
            widths = to.is_some();
        }
        if to.is_none() {
            // They hardly move an edge.
            to = moved(&now, &along)?.filter(cheaper(0.0));
        }
        let Some(to) = to else { break };
        let gained = cost - cost_of(&to.residuals, OTHERS);
        let little = gained < LITTLE * near;
        (cost, near) = (cost - gained, near_cost_of(&to.residuals, OTHERS));
        now.replace(&patches, to.template, to.worn, &to.residuals);
        if little {
            break;
        }
    }
    let factors = girths(&now.template, &now.worn, seen);
    if factors.iter().any(|f| *f != 1.0)
        && let Some(to) = moved(&now, &grown(&now.template, &factors))?
    {
        now.replace(&patches, to.template, to.worn, &to.residuals);
    }
    Ok(now)
}

/// A template that was moved, as it is worn in each scan [m], and how scans differ from it.
struct Moved {
    template: Template,
    worn: Vec<Vec<Vec3>>,
    residuals: Vec<f64>,
}

/// Where the vertices of a template go [m].
struct Moves {
    /// Along normals, as [`offsets`] say.
    across: Vec<Vec3>,
    /// Along the surface, with its edges.
    along: Vec<Vec3>,
}

impl Moves {
    fn new(template: &Template, offsets: &[f64], edges: &[(Vec3, Vec3)]) -> Self {
        let normals = template.mesh.vertex_normals();
        let with_edges = |p: &Vec3, normal: &Vec3| {
            let (mut sum, mut weight, mut nearest) = (Vec3::zeros(), 0.0, f64::INFINITY);
            for (at, shift) in edges {
                let square = (p - at).norm_squared();
                nearest = nearest.min(square);
                let w = (-0.5 * square / (EDGE * EDGE)).exp();
                sum += shift * w;
                weight += w;
            }
            let moved = sum * (1.0 - smooth_step(0.0, MOVES, nearest.sqrt())) / f64::max(weight, f64::MIN_POSITIVE);
            moved - normal * normal.dot(&moved)
        };
        let vertices = template.mesh.vertices.par_iter().zip(&normals);
        Self {
            across: normals.iter().zip(offsets).map(|(n, d)| n * *d).collect(),
            along: vertices.map(|(p, n)| with_edges(p, n)).collect(),
        }
    }
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
/// all. (Of the mean m with its variance v the share m²/(m² + v), which is the mean's best scale where m is the truth; what lies apart from
/// the median weighs less, as Huber has it.)
fn agreed(said: &[Said]) -> f64 {
    let heard: f64 = said.iter().map(|s| s.weight).sum();
    let trust = heard / said.len().max(1) as f64;
    let middle = median_of(said, |s| s.value);
    let typical = median_of(said, |s| (s.value - middle).abs()).max(TYPICAL);
    let weight = |s: &Said| s.weight * (APART * typical / (s.value - middle).abs().max(f64::MIN_POSITIVE)).min(1.0);
    let counted: f64 = said.iter().map(weight).sum();
    let mean = said.iter().map(|s| weight(s) * s.value).sum::<f64>() / counted.max(f64::MIN_POSITIVE);
    let spread: f64 = said.iter().map(|s| weight(s) * (s.value - mean).powi(2)).sum();
    let variance = if counted > 1.0 { spread / (counted * (counted - 1.0)) } else { 0.0 };
    // Scans that see little say little, even together.
    trust * mean * mean * mean / (mean * mean + variance).max(f64::MIN_POSITIVE)
}

/// The weighted median of something about what scans say; 0 without weight.
fn median_of(said: &[Said], of: impl Fn(&Said) -> f64) -> f64 {
    let mut all: Vec<(f64, f64)> = said.iter().map(|s| (of(s), s.weight)).collect();
    all.sort_by(|a, b| a.0.total_cmp(&b.0));
    let half = 0.5 * all.iter().map(|a| a.1).sum::<f64>();
    let mut so_far = 0.0;
    for (k, (value, weight)) in all.iter().enumerate() {
        so_far += weight;
        if so_far > half {
            return *value;
        }
        if so_far == half && half > 0.0 {
            // Between two halves.
            return all.get(k + 1).map_or(*value, |next| 0.5 * (value + next.0));
        }
    }
    0.0
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
        // Four scans of five differ by 1 mm from the middle: all count, m = 5 mm, v = 4/(5 · 4) mm².
        let spread = [0.004, 0.005, 0.006, 0.004, 0.006];
        assert!((said(&spread) - 0.005 * 25.0 / (25.0 + 4.0 / 20.0)).abs() < 1e-9, "{}", said(&spread));
        // A fold in one of three scans counts by 2/9: m = 2/2.2222 mm, v = (2/9 · 8.1² + 2 · 0.9²)/(2.2222 · 1.2222) mm².
        let (weight, m): (f64, f64) = (2.0 / 9.0, 0.9);
        let v = (weight * (9.0 - m).powi(2) + 2.0 * m * m) / ((2.0 + weight) * (1.0 + weight));
        let fold = said(&[0.009, 0.0, 0.0]);
        assert!((fold - 1e-3 * m * m * m / (m * m + v)).abs() < 1e-9 && fold < 2e-4, "{fold}");
        assert!(said(&[0.006, -0.006, 0.0]).abs() < 1e-12 && said(&[]) == 0.0 && said(&[0.0; 3]) == 0.0);
        // A scan that sees little says little.
        let half = agreed(&[Said { value: 0.004, weight: 1.0 }, Said { value: 0.0, weight: 0.0 }]);
        assert!((half - 0.002).abs() < 1e-12, "{half}");
    }
}
