//! Getting a garment out of the body: a smooth displacement that keeps edges' lengths and every sample off the skin.
//!
//! Position-based: rounds of smoothing the displacement (it fades with the distance from where it is needed), of drawing
//! edges back to their length, and of pushing samples out. The first two weaken from round to round, so that the rounds end
//! where nothing needs a push. Samples lie on every triangle, so that no triangle dips into the
//! skin between its corners.

use crate::template::{StyleRange, Tailor};
use caphy_core::query::Adjacency;
use caphy_core::{Error, Result, TriMesh, Vec3};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// How penetrations of a given garment are resolved.
///
/// On six character garments with up to 19 % of their vertices up to 9.5 mm inside the body, the area changed by at most 1.1 %
/// and nine tenths of the edges by less than 5 %.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PenetrationOptions {
    /// Distance that every point of the garment keeps from the skin [m]. Default 0.003: cloth, its thickness and the body's
    /// own facets.
    pub clearance_m: f64,
    /// Deepest vertex that is still pushed out [m]; deeper ones mean a garment for another body. Default 0.04.
    pub deepest_m: f64,
    /// Largest share of vertices inside the body. Default 0.5.
    pub share: f64,
}

impl Default for PenetrationOptions {
    fn default() -> Self {
        Self { clearance_m: 0.003, deepest_m: 0.04, share: 0.5 }
    }
}

impl PenetrationOptions {
    /// # Errors
    /// [`Error::Parameter`] for a limit that cannot be held: distances to the skin are told apart up to 6 cm.
    fn check(&self) -> Result<()> {
        let range = |name, unit, upper| StyleRange { name, unit, lower: 0.0, upper };
        range("clearance_m", "m", 0.03).check(self.clearance_m)?;
        range("deepest_m", "m", crate::template::FAR - 1e-3).check(self.deepest_m)?;
        range("share", "1", 1.0).check(self.share)
    }
}

/// What was resolved.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct PenetrationFacts {
    /// Share of vertices inside the body, before and after.
    pub inside_share: [f64; 2],
    /// Depth of the deepest vertex inside the body, 0 when none is [m], before and after.
    pub deepest_m: [f64; 2],
    /// Smallest signed distance of any sample on the surface to the skin [m], after.
    pub clearance_m: f64,
    /// Area after over area before.
    pub area_ratio: f64,
    /// Edge length after over before: smallest, 5th percentile, 95th percentile, largest.
    pub edge_ratio: [f64; 4],
    /// Root mean square and largest way of the vertices [m].
    pub moved_m: [f64; 2],
    /// Largest way of a vertex beyond the mean way of its neighbours [m]: what roughness was added.
    pub rough_m: f64,
    /// Rounds of smoothing and pushing.
    pub rounds: usize,
}

/// Samples lie no farther apart than this [m]: over skin of 3 cm radius a chord of that length sags by 0.3 mm.
const SPACING: f64 = 0.009;
/// Length over which the displacement fades [m].
const FADE: f64 = 0.04;
/// Rounds of smoothing and pushing, then rounds of pushing alone.
const ROUNDS: usize = 30;
const LAST_ROUNDS: usize = 30;
/// Pushing goes so far beyond what is missing that rounds end [m].
const OVERSHOOT: f64 = 1e-4;

/// A point on the surface: corners of a face and their weights.
struct Sample {
    face: u32,
    weights: [f64; 3],
}

/// Vertices once each, sides and insides of large triangles in steps of [`SPACING`].
fn samples(mesh: &TriMesh) -> Vec<Sample> {
    let mut out = Vec::new();
    let mut seen = vec![false; mesh.vertices.len()];
    for (f, face) in mesh.faces.iter().enumerate() {
        let [a, b, c] = mesh.corners(f);
        let longest = (b - a).norm().max((c - b).norm()).max((a - c).norm());
        let n = ((longest / SPACING).ceil() as usize).clamp(2, 40);
        for i in 0..=n {
            for j in 0..=n - i {
                let k = n - i - j;
                let corner = [i, j, k].iter().position(|&x| x == n);
                // A side belongs to the face that runs it low to high, or to the only one; insides always count.
                let side = [i, j, k].iter().position(|&x| x == 0);
                let shared = side.is_some_and(|s| face[(s + 1) % 3] > face[(s + 2) % 3]);
                let counts = match corner {
                    Some(v) => !std::mem::replace(&mut seen[face[v] as usize], true),
                    None => !shared || side.is_none(),
                };
                if counts {
                    out.push(Sample { face: f as u32, weights: [i, j, k].map(|x| x as f64 / n as f64) });
                }
            }
        }
    }
    out
}

struct Resolver<'a> {
    tailor: &'a Tailor,
    faces: &'a [[u32; 3]],
    samples: Vec<Sample>,
    clearance: f64,
}

impl Resolver<'_> {
    fn place(&self, s: &Sample, x: &[Vec3]) -> Vec3 {
        let f = self.faces[s.face as usize];
        (0..3).map(|k| x[f[k] as usize] * s.weights[k]).sum()
    }
    /// The push that each vertex needs most [m].
    fn pushes(&self, x: &[Vec3]) -> (Vec<Vec3>, f64) {
        let needs: Vec<Option<(f64, Vec3)>> = self
            .samples
            .par_iter()
            .map(|s| {
                let p = self.place(s, x);
                if self.tailor.grid.value(&p) > self.clearance + 0.008 {
                    return None;
                }
                let (d, out) = self.tailor.skin(&p, crate::template::FAR)?;
                (d < self.clearance).then_some((self.clearance - d, out))
            })
            .collect();
        let mut push = vec![(0.0f64, Vec3::zeros()); x.len()];
        let mut worst = 0.0f64;
        for (s, need) in self.samples.iter().zip(needs) {
            let Some((missing, out)) = need else { continue };
            worst = worst.max(missing);
            let squares: f64 = s.weights.iter().map(|w| w * w).sum();
            for (&v, w) in self.faces[s.face as usize].iter().zip(s.weights) {
                let way = (missing + OVERSHOOT) * w / squares;
                if way > push[v as usize].0 {
                    push[v as usize] = (way, out);
                }
            }
        }
        (push.into_iter().map(|(way, out)| out * way).collect(), worst)
    }
    /// Smallest signed distance of any sample [m].
    fn clearance(&self, x: &[Vec3]) -> f64 {
        let all: Vec<f64> = self.samples.par_iter().map(|s| self.tailor.distance(&self.place(s, x))).collect();
        all.into_iter().fold(f64::INFINITY, f64::min)
    }
}

/// Share of vertices inside the body and depth of the deepest [m].
fn inside(mesh: &TriMesh, tailor: &Tailor) -> (f64, f64, usize) {
    let distances: Vec<f64> = mesh.vertices.par_iter().map(|p| tailor.distance(p)).collect();
    let count = distances.iter().filter(|d| **d < 0.0).count();
    let deepest = distances.iter().enumerate().fold((0.0, 0), |b, (v, &d)| if -d > b.0 { (-d, v) } else { b });
    (count as f64 / distances.len().max(1) as f64, deepest.0, deepest.1)
}

/// Moves a garment out of the body.
///
/// # Errors
/// [`Error::Mesh`] above the limits of the options, with the vertex; [`Error::Numerics`] when samples stay inside.
pub(super) fn resolve(
    name: &str,
    mesh: &mut TriMesh,
    tailor: &Tailor,
    options: &PenetrationOptions,
) -> Result<PenetrationFacts> {
    options.check()?;
    let (share, deepest, vertex) = inside(mesh, tailor);
    let remedy =
        "fit the garment to this body's shape first; the limits are `share` and `deepest_m` of its penetration";
    if share > options.share {
        let problem = format!(
            "{:.1} % of its vertices are inside the body, more than {:.1} %",
            100.0 * share,
            100.0 * options.share
        );
        return Err(Error::mesh(name, "whole mesh", problem, remedy));
    }
    if deepest > options.deepest_m {
        let p = mesh.vertices[vertex];
        let problem = format!(
            "at ({:.3}, {:.3}, {:.3}) is {:.1} mm inside the body, more than {:.1} mm",
            p.x,
            p.y,
            p.z,
            deepest * 1e3,
            options.deepest_m * 1e3
        );
        return Err(Error::mesh(name, format!("vertex {vertex}"), problem, remedy));
    }
    let start = mesh.clone();
    let adjacency = Adjacency::new(mesh.vertices.len(), &mesh.faces);
    let faces = mesh.faces.clone();
    let resolver = Resolver { tailor, faces: &faces, samples: samples(mesh), clearance: options.clearance_m };
    let edge = mesh.mean_edge_length();
    // Smoothing by a step of a half and fading by this much leaves a displacement of exp(-r / FADE) far from its cause.
    let fade = 1.0 / (1.0 + 0.25 * (edge / FADE).powi(2));
    let edges: Vec<(u32, u32, f64)> = (0..mesh.vertices.len() as u32)
        .flat_map(|a| adjacency.of(a as usize).iter().filter(move |&&b| a < b).map(move |&b| (a, b)))
        .map(|(a, b)| (a, b, (start.vertices[a as usize] - start.vertices[b as usize]).norm()))
        .collect();
    let x = &mut mesh.vertices;
    let mut rounds = 0;
    let (mut push, mut worst) = resolver.pushes(x);
    while worst > 0.0 && rounds < ROUNDS {
        for (p, d) in x.iter_mut().zip(&push) {
            *p += d;
        }
        let amount = 1.0 - rounds as f64 / ROUNDS as f64;
        smooth_displacement(x, &start.vertices, &adjacency, fade, amount);
        keep_lengths(x, &edges, &adjacency, amount);
        (push, worst) = resolver.pushes(x);
        rounds += 1;
    }
    // The last pushes are small; spread by one smoothing step of their own so that no vertex stands out.
    for _ in 0..LAST_ROUNDS {
        if worst <= 0.0 {
            break;
        }
        for v in 0..x.len() {
            let near = adjacency.of(v);
            let mean = near.iter().map(|&w| push[w as usize]).sum::<Vec3>() / near.len().max(1) as f64;
            // A vertex takes part in its neighbours' push, but never loses of its own.
            let part = mean * 0.5;
            x[v] += if part.norm() > push[v].norm() { part } else { push[v] };
        }
        (push, worst) = resolver.pushes(x);
        rounds += 1;
    }
    let clearance = resolver.clearance(x);
    let (share_after, deepest_after, _) = inside(mesh, tailor);
    if clearance <= 0.0 {
        return Err(Error::numerics(
            format!("penetrations of {name}"),
            format!("a point of the surface stays {:.2} mm inside the body after {rounds} rounds", -clearance * 1e3),
            "subdivide the garment (`resolution_m`), give it more room, or move limbs of the body apart in the T-pose",
        ));
    }
    let mut ratios: Vec<f64> =
        edges.iter().map(|&(a, b, l)| (mesh.vertices[a as usize] - mesh.vertices[b as usize]).norm() / l).collect();
    ratios.sort_by(f64::total_cmp);
    let at = |q: f64| ratios.get((q * (ratios.len().max(1) - 1) as f64) as usize).copied().unwrap_or(1.0);
    let moved: Vec<Vec3> = mesh.vertices.iter().zip(&start.vertices).map(|(p, q)| p - q).collect();
    let square: f64 = moved.iter().map(|d| d.norm_squared()).sum();
    let rough = (0..moved.len())
        .map(|v| {
            let near = adjacency.of(v);
            (moved[v] - near.iter().map(|&w| moved[w as usize]).sum::<Vec3>() / near.len().max(1) as f64).norm()
        })
        .fold(0.0, f64::max);
    let area = |m: &TriMesh| m.face_areas().iter().sum::<f64>();
    Ok(PenetrationFacts {
        inside_share: [share, share_after],
        deepest_m: [deepest, deepest_after],
        clearance_m: clearance,
        area_ratio: area(mesh) / area(&start),
        edge_ratio: [at(0.0), at(0.05), at(0.95), at(1.0)],
        moved_m: [(square / moved.len().max(1) as f64).sqrt(), moved.iter().map(|d| d.norm()).fold(0.0, f64::max)],
        rough_m: rough,
        rounds,
    })
}

/// u ← (1 − a) u + a · fade · (u + mean of the neighbours' u) / 2, twice.
fn smooth_displacement(x: &mut [Vec3], start: &[Vec3], adjacency: &Adjacency, fade: f64, amount: f64) {
    let mut u: Vec<Vec3> = x.iter().zip(start).map(|(p, q)| p - q).collect();
    for _ in 0..2 {
        let next: Vec<Vec3> = (0..u.len())
            .map(|v| {
                let near = adjacency.of(v);
                let mean = near.iter().map(|&w| u[w as usize]).sum::<Vec3>() / near.len().max(1) as f64;
                u[v] * (1.0 - amount) + (u[v] + mean) * (0.5 * fade * amount)
            })
            .collect();
        u = next;
    }
    for ((p, q), d) in x.iter_mut().zip(start).zip(&u) {
        *p = q + d;
    }
}

/// Draws edges back to their length by a share, all from the same old places.
fn keep_lengths(x: &mut [Vec3], edges: &[(u32, u32, f64)], adjacency: &Adjacency, amount: f64) {
    let mut way = vec![Vec3::zeros(); x.len()];
    for &(a, b, length) in edges {
        let d = x[b as usize] - x[a as usize];
        let now = d.norm();
        let correction = d * (0.5 * (now - length) / now.max(1e-12));
        way[a as usize] += correction;
        way[b as usize] -= correction;
    }
    for (v, p) in x.iter_mut().enumerate() {
        // Six corrections per vertex overlap: taken in full they would overshoot.
        *p += way[v] * (1.5 * amount / adjacency.of(v).len().max(1) as f64);
    }
}
