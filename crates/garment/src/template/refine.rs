//! A style brought nearer to a scan, from the best of the samples.
//!
//! Squared distances between surfaces hardly feel a length: a sleeve that is too short by d adds the cube of d. What a scan shows
//! of lengths are its edges, where cloth ends and skin or another garment begins. So the fit has two kinds of measurements: points
//! of the cloth, by their distance from the garment along its normal, and points of its edges, by how far they lie beyond the
//! garment's boundary along its surface. Both are signed, so that Gauss-Newton steps with differences over a few garments find the style.
//! Where a fold lies is chance, in the scan as in each garment that is tried: what counts is the median over a patch as wide as folds.
//!
//! Differs from the paper: it takes the sample as it is.

use super::response::{ANSWERS, DIFFERENCE, Far, MIDDLE, Response, Tried, cost};
use super::rim::Rim;
use super::source::TemplateSource;
use super::{Style, Tailor, Template};
use caphy_core::query::{NearestGrid, NearestSurface, boundary_loops, nearest_on_line};
use caphy_core::{Error, Result, Vec3, mesh};
use nalgebra::DMatrix;
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::ops::Range;

/// Sides of the cubes that patches of points and of edges are cut by [m]: folds are narrower; a neckline has to have some.
const PATCH: f64 = 0.1;
const EDGE_PATCH: f64 = 0.05;
/// How far a patch of simulated cloth is expected to lie from a scanned one [m]: folds are elsewhere.
const SIGMA: f64 = 4e-3;
/// The same of an edge, along the cloth [m]: what cloth folds by hardly makes it shorter.
const EDGE_SIGMA: f64 = 2e-3;
/// An axis that fewer patches answer to is not seen.
const WITNESSES: usize = 3;
/// Vertices of two templates farther apart than this differ [m]: coarse triangulations of one style do so by less.
const DIFFERS: f64 = 5e-3;
/// Scanned edges farther from those of a refined garment are others, or labels gone wrong [m].
pub(super) const OTHERS_M: f64 = 0.03;
pub(super) const OTHERS: Far = Far::Beyond(OTHERS_M / EDGE_SIGMA);
/// Most steps, and what one must promise to gain to be worth its time: half the square of two thirds of a sigma on one patch.
const STEPS: usize = 8;
const WORTH_IT: f64 = 0.2;
/// Steps in a row without a better garment, after which there is none.
const PATIENCE: usize = 2;
/// Most steps of templates as fine as wanted, each many times slower, and the share of the cost that one must promise to gain.
const FINE_STEPS: usize = 3;
const FINE_WORTH_IT: f64 = 0.01;
/// Shares of a step that are tried at the same time.
const SHARES: [f64; 2] = [1.0, 0.4];

/// What a scan shows of a garment.
#[derive(Debug, Clone, Copy)]
pub struct Seen<'a> {
    /// Points of its surface [m].
    pub points: &'a [Vec3],
    /// Points where it ends [m]; none where that is not known.
    pub edges: &'a [Vec3],
    /// Its edges in pieces, each along an edge; none where that is not known.
    pub rims: &'a [Rim],
    /// The same, joined where they go on across gaps that are not seen: longer pieces, less exact.
    pub joined: &'a [Rim],
    /// Points of what is worn over it [m]: what lies nearer to them than to its own points is hidden.
    pub covered_by: &'a [Vec3],
}

/// A template as it was compared with the scan.
#[derive(Debug, Clone, PartialEq)]
pub struct Worn {
    /// The template.
    pub template: Template,
    /// Its vertices in the scan's pose [m].
    pub vertices: Vec<Vec3>,
}

/// Another template as it is worn in the same pose, or in another scan's: where the next one starts from ([`hung_like`](super::hung_like)).
#[derive(Debug, Clone, Copy)]
pub struct WornAs<'a> {
    /// The template.
    pub template: &'a Template,
    /// Its vertices in the pose [m].
    pub vertices: &'a [Vec3],
    /// Number of the scan whose pose it is.
    pub scan: usize,
}

/// Outcome of [`refine`], [`finish`] and [`ease`](super::ease).
#[derive(Debug, Clone, PartialEq)]
pub struct Refinement {
    /// The best style found; an eased template differs from it.
    pub style: Style,
    /// The template of that style.
    pub template: Template,
    /// It as it was compared with each scan [m].
    pub worn: Vec<Vec<Vec3>>,
    /// Root mean square distance of the scans' edges from its boundary, along its surface [m]; 0 without edges.
    pub edges_off_m: f64,
    /// Templates made on the way, beside the start.
    pub evaluations: usize,
    /// Change of each residual per axis, as measured last. Shape [residuals, axes].
    slopes: DMatrix<f64>,
}

/// A style as it is worn, and how scans differ from it.
struct Trial {
    template: Template,
    /// In the pose of each scan [m], from the one of this number on.
    worn: Vec<Vec<Vec3>>,
    first: usize,
    /// Distances over sigma: of each scan patches of points, then of edges.
    residuals: Vec<f64>,
}

/// Improves a style by Gauss-Newton steps. `wear` takes a template to the scan's pose, as `start` was taken there, whose edges are about
/// `resolution_m` long [m]; it is told how one of a style nearby is worn there. A source without anything between its garments gives the
/// start back: nothing is worn again.
///
/// # Errors
/// Those of [`TemplateSource::template`] and of `wear` (styles that no garment can be made of, or worn, are passed over);
/// [`Error::Numerics`] without scan points, [`Error::NonFinite`] for bad ones.
pub fn refine(
    source: &dyn TemplateSource,
    tailor: &Tailor,
    start: Worn,
    resolution_m: f64,
    seen: Seen<'_>,
    wear: impl Fn(&Template, WornAs<'_>) -> Result<Vec<Vec3>> + Sync,
) -> Result<Refinement> {
    for (what, list) in [("scan points of a garment", seen.points), ("edges of a scanned garment", seen.edges)] {
        let flat: Vec<f64> = list.iter().flat_map(|p| p.iter().copied()).collect();
        Error::check_finite(what, &flat)?;
    }
    if seen.points.is_empty() {
        let remedy = "check the segmentation: no scan point carries this garment's label";
        return Err(Error::numerics("refinement of a garment template", "the scan has no points of it", remedy));
    }
    let patches = Patches::new(&seen);
    let attempt = |style: &Style, like: &Trial| -> Result<Trial> {
        let template = source.template(tailor, style, resolution_m)?;
        let worn = wear(&template, like.worn_in(0))?;
        let residuals = patches.residuals(&seen, &worn, &template.mesh.faces)?;
        Ok(Trial { template, worn: vec![worn], first: 0, residuals })
    };
    let Worn { template, vertices: worn } = start;
    let start = &template.style.clone();
    let mut u = source.coordinates(start);
    let axes = u.len();
    let residuals = patches.residuals(&seen, &worn, &template.mesh.faces)?;
    let mut now = Trial { template, worn: vec![worn], first: 0, residuals };
    let mut evaluations = 0;
    // Garments a difference away along some axes; `None` where none can be made.
    let around = |u: &[f64], now: &Trial, axes: &[usize], outward: bool| -> Result<Vec<Option<(Vec<f64>, Trial)>>> {
        let away = |&axis: &usize| {
            let to = beside(u, axis, outward);
            let trial = passed_over(source.at(start, &to).and_then(|style| attempt(&style, now)))?;
            Ok(trial.map(|t| (to, t)))
        };
        axes.par_iter().map(away).collect()
    };
    // What the scan says nothing of goes to the middle at once and stays there.
    let every: Vec<usize> = (0..axes).collect();
    let mut near = around(&u, &now, &every, false)?;
    evaluations += axes;
    let cover = Cover::new(&seen);
    let mut free = Vec::new();
    for (k, trial) in near.iter().enumerate() {
        if answered(&now, trial.as_ref()) && cover.shows(&now, trial.as_ref())? {
            free.push(k);
        }
    }
    if free.len() < axes {
        every.iter().filter(|k| !free.contains(k)).for_each(|&k| u[k] = MIDDLE);
        now = attempt(&source.at(start, &u)?, &now)?;
        near = around(&u, &now, &free, false)?;
        evaluations += 1 + free.len();
    }
    let mut slopes = DMatrix::zeros(now.residuals.len(), axes);
    let mut tried = vec![now.as_tried(&u)];
    let mut in_vain = 0;
    for round in 0..if free.is_empty() { 0 } else { STEPS } {
        if round > 0 {
            // From the other side each time: folds of the middle one are then in no slope.
            near = around(&u, &now, &free, round % 2 == 1)?;
            evaluations += free.len();
        }
        tried.extend(near.iter().flatten().map(|(to, trial)| trial.as_tried(to)));
        let model = Response::around(&u, &tried, &free)?;
        let (step, gain) = model.step(&u, Far::Nowhere)?;
        slopes = model.slopes;
        if gain < WORTH_IT {
            break;
        }
        let shared: Vec<Option<(Vec<f64>, Trial)>> = SHARES
            .par_iter()
            .map(|share| {
                let to: Vec<f64> = u.iter().zip(step.iter()).map(|(u, s)| u + share * s).collect();
                let trial = passed_over(source.at(start, &to).and_then(|style| attempt(&style, &now)))?;
                Ok(trial.map(|t| (to, t)))
            })
            .collect::<Result<_>>()?;
        evaluations += shared.len();
        tried.extend(shared.iter().flatten().map(|(to, trial)| trial.as_tried(to)));
        // Of the neighbours, too, one may be better than both. Where none is, the next model knows more; not for ever.
        let best = shared
            .into_iter()
            .chain(std::mem::take(&mut near))
            .flatten()
            .map(|(to, trial)| (cost(&to, &trial.residuals, Far::Nowhere), to, trial))
            .min_by(|a, b| a.0.total_cmp(&b.0));
        if let Some((reached, to, trial)) = best
            && reached < cost(&u, &now.residuals, Far::Nowhere)
        {
            (u, now, in_vain) = (to, trial, 0);
        } else {
            in_vain += 1;
            if in_vain == PATIENCE {
                break;
            }
        }
    }
    Ok(refinement(&[patches], now, evaluations, slopes))
}

/// Takes a refined style to templates with edges of about `to_m` [m], and to more scans: `seen` begins with the scan that it was refined with
/// at `from_m`, `wear` takes a template to the pose of the scan of a number, told how one of a style nearby is worn in it or in another.
/// Coarse cloth does not fold where finer cloth does and keeps farther from the skin: the same scan is that of a wider garment of finer
/// triangles. How a step changes the residuals is known from coarse garments; the residuals are those of the fine ones. The folds of
/// several scans are other ones each time.
///
/// # Errors
/// Those of [`refine`].
pub fn finish(
    source: &dyn TemplateSource,
    tailor: &Tailor,
    refined: &Refinement,
    [from_m, to_m]: [f64; 2],
    seen: &[Seen<'_>],
    wear: impl Fn(&Template, usize, WornAs<'_>) -> Result<Vec<Vec3>> + Sync,
) -> Result<Refinement> {
    let patches: Vec<Patches> = seen.iter().map(Patches::new).collect();
    let attempt = |style: &Style, resolution_m: f64, scans: Range<usize>, like: &Trial| -> Result<Trial> {
        let template = source.template(tailor, style, resolution_m)?;
        let first = scans.start;
        let one = |scan: usize| {
            let worn = wear(&template, scan, like.worn_in(scan))?;
            let residuals = patches[scan].residuals(&seen[scan], &worn, &template.mesh.faces)?;
            Ok((worn, residuals))
        };
        let all: Vec<(Vec<Vec3>, Vec<f64>)> = scans.into_par_iter().map(one).collect::<Result<_>>()?;
        let (worn, residuals): (Vec<_>, Vec<_>) = all.into_iter().unzip();
        Ok(Trial { template, worn, first, residuals: residuals.concat() })
    };
    let start = &refined.style;
    let mut u = source.coordinates(start);
    let mut evaluations = 0;
    let mut slopes = refined.slopes.clone();
    let mut coarse =
        Trial { template: refined.template.clone(), worn: refined.worn.clone(), first: 0, residuals: Vec::new() };
    if slopes.iter().any(|s| *s != 0.0) && seen.len() > 1 {
        let more = 1..seen.len();
        let here = attempt(start, from_m, more.clone(), &coarse)?;
        let beside = (0..u.len())
            .into_par_iter()
            .map(|axis| {
                if slopes.column(axis).iter().all(|s| *s == 0.0) {
                    return Ok(None);
                }
                let to = beside(&u, axis, false);
                let trial = source.at(start, &to).and_then(|s| attempt(&s, from_m, more.clone(), &here));
                Ok(passed_over(trial)?.map(|t| (to, t)))
            })
            .collect::<Result<Vec<_>>>()?;
        evaluations += 1 + u.len();
        let theirs = slopes_between(&u, &here, &beside);
        slopes = DMatrix::from_fn(slopes.nrows() + theirs.nrows(), u.len(), |row, axis| {
            if row < slopes.nrows() { slopes[(row, axis)] } else { theirs[(row - slopes.nrows(), axis)] }
        });
        coarse.worn.extend(here.worn);
    }
    let mut now = attempt(start, to_m, 0..seen.len(), &coarse)?;
    evaluations += 1;
    Error::check_length("residuals of a refined template", slopes.nrows(), now.residuals.len())?;
    for _ in 0..FINE_STEPS {
        let model = Response { residuals: now.residuals.clone(), slopes };
        let (step, gain) = model.step(&u, OTHERS)?;
        slopes = model.slopes;
        if gain < FINE_WORTH_IT * cost(&u, &now.residuals, OTHERS) {
            break;
        }
        let mut better = false;
        for share in SHARES {
            let to: Vec<f64> = u.iter().zip(step.iter()).map(|(u, s)| u + share * s).collect();
            evaluations += 1;
            let trial = source.at(start, &to).and_then(|s| attempt(&s, to_m, 0..seen.len(), &now));
            let cheaper = |t: &Trial| cost(&to, &t.residuals, OTHERS) < cost(&u, &now.residuals, OTHERS);
            if let Some(trial) = passed_over(trial)?.filter(cheaper) {
                (u, now, better) = (to, trial, true);
                break;
            }
        }
        if !better {
            break;
        }
    }
    Ok(refinement(&patches, now, evaluations, slopes))
}

impl Trial {
    /// As it is worn in a scan; in another one where it was not put on in that.
    fn worn_in(&self, scan: usize) -> WornAs<'_> {
        let at = scan.checked_sub(self.first).filter(|k| *k < self.worn.len()).unwrap_or(0);
        WornAs { template: &self.template, vertices: &self.worn[at], scan: self.first + at }
    }
    fn as_tried(&self, u: &[f64]) -> Tried {
        Tried { u: u.to_vec(), residuals: self.residuals.clone() }
    }
}

/// The place a difference away along one axis, towards the middle of the range, or away from it if that lies in the range.
fn beside(u: &[f64], axis: usize, outward: bool) -> Vec<f64> {
    let mut to = u.to_vec();
    let inward = if u[axis] > MIDDLE { -DIFFERENCE } else { DIFFERENCE };
    to[axis] += if outward && (0.0..=1.0).contains(&(u[axis] - inward)) { -inward } else { inward };
    to
}

fn refinement(patches: &[Patches], trial: Trial, evaluations: usize, slopes: DMatrix<f64>) -> Refinement {
    Refinement {
        style: trial.template.style.clone(),
        edges_off_m: edges_off(patches, &trial.residuals),
        template: trial.template,
        worn: trial.worn,
        evaluations,
        slopes,
    }
}

/// Root mean square distance of edges [m].
fn edges_off(patches: &[Patches], residuals: &[f64]) -> f64 {
    let (mut square, mut count, mut at) = (0.0, 0usize, 0);
    for patches in patches {
        let edges = at + patches.points.len();
        at = edges + patches.edges.len();
        square += residuals[edges..at].iter().map(|r| (r * EDGE_SIGMA).powi(2)).sum::<f64>();
        count += patches.edges.len();
    }
    (square / count.max(1) as f64).sqrt()
}

impl Refinement {
    /// Another template of the same style, worn in the same scans.
    pub(super) fn replace(&mut self, patches: &[Patches], template: Template, worn: Vec<Vec<Vec3>>, residuals: &[f64]) {
        (self.template, self.worn) = (template, worn);
        self.edges_off_m = edges_off(patches, residuals);
        self.evaluations += 1;
    }
}

/// Whether enough patches answer to a step along an axis, where one can be made.
fn answered(now: &Trial, beside: Option<&(Vec<f64>, Trial)>) -> bool {
    let Some((_, trial)) = beside else { return false };
    let changes = now.residuals.iter().zip(&trial.residuals).map(|(a, b)| b - a);
    changes.filter(|c| c.abs() >= ANSWERS).count() >= WITNESSES
}

/// What is hidden by another garment.
struct Cover {
    own: NearestGrid<f64>,
    over: Option<NearestGrid<f64>>,
}

impl Cover {
    fn new(seen: &Seen<'_>) -> Self {
        let over = (!seen.covered_by.is_empty()).then(|| NearestGrid::from_points(seen.covered_by));
        Self { own: NearestGrid::from_points(seen.points), over }
    }
    fn hides(&self, p: &Vec3) -> bool {
        let Some(over) = &self.over else { return false };
        let own = self.own.nearest_point(p).map_or(f64::INFINITY, |n| n.1);
        over.nearest_point(p).is_some_and(|n| n.1 < own)
    }
    /// Whether two templates differ where it is seen. Where the one is cut otherwise only under the other garment, whatever answers has
    /// other folds.
    fn shows(&self, now: &Trial, beside: Option<&(Vec<f64>, Trial)>) -> Result<bool> {
        let Some((_, other)) = beside else { return Ok(false) };
        let (mut differing, mut hidden) = (0, 0);
        for (a, b) in [(now, other), (other, now)] {
            let surface = NearestSurface::from_mesh(&b.template.mesh)?;
            for (rest, worn) in a.template.mesh.vertices.iter().zip(a.worn.iter().flatten()) {
                if surface.nearest(rest).is_none_or(|near| near.squared_distance > DIFFERS * DIFFERS) {
                    differing += 1;
                    hidden += usize::from(self.hides(worn));
                }
            }
        }
        // In narrow folds, as between the legs, triangulations differ, too: not none has to be seen, but the smaller part.
        Ok(2 * hidden <= differing)
    }
}

/// Change of residuals per axis between trials; 0 where it is not more than other folds are, and along axes without a trial.
fn slopes_between(u: &[f64], now: &Trial, beside: &[Option<(Vec<f64>, Trial)>]) -> DMatrix<f64> {
    DMatrix::from_fn(now.residuals.len(), u.len(), |row, axis| {
        let Some((to, trial)) = &beside[axis] else { return 0.0 };
        let change = trial.residuals[row] - now.residuals[row];
        if change.abs() < ANSWERS { 0.0 } else { change / (to[axis] - u[axis]) }
    })
}

/// `None` for a style that no garment can be made of, or worn.
pub(super) fn passed_over<T>(trial: Result<T>) -> Result<Option<T>> {
    match trial {
        Ok(trial) => Ok(Some(trial)),
        Err(Error::Numerics { .. } | Error::Mesh { .. }) => Ok(None),
        Err(other) => Err(other),
    }
}

/// Points that are taken together.
pub(super) struct Patches {
    points: Vec<Vec<usize>>,
    edges: Vec<Vec<usize>>,
}

impl Patches {
    pub(super) fn new(seen: &Seen<'_>) -> Self {
        Self { points: in_cubes(seen.points, PATCH), edges: in_cubes(seen.edges, EDGE_PATCH) }
    }
    /// Median signed distance over its sigma of each patch from a garment.
    pub(super) fn residuals(&self, seen: &Seen<'_>, vertices: &[Vec3], faces: &[[u32; 3]]) -> Result<Vec<f64>> {
        let round = mesh::rounded(vertices, faces);
        let surface = NearestSurface::from_mesh(&round)?;
        let boundary = Boundary::new(vertices, faces);
        let from_surface = |p: &Vec3| {
            let Some(near) = surface.nearest(p) else { return 0.0 };
            let [a, b, c] = round.corners(near.face as usize);
            let normal = (b - a).cross(&(c - a)).try_normalize(0.0).unwrap_or_else(Vec3::zeros);
            (p - near.point).dot(&normal)
        };
        let points =
            self.points.iter().map(|patch| median(patch.iter().map(|&i| from_surface(&seen.points[i]))) / SIGMA);
        let beyond = |patch: &Vec<usize>| median(patch.iter().map(|&i| boundary.beyond(&seen.edges[i]))) / EDGE_SIGMA;
        Ok(points.chain(self.edges.iter().map(beyond)).collect())
    }
}

/// Places of points by the cube of a grid that they lie in; cubes in an order of their own. Cubes with a few points only are left
/// out: what is torn off by the cube's wall, a wrong label, a small hole.
fn in_cubes(points: &[Vec3], side: f64) -> Vec<Vec<usize>> {
    let mut cubes: BTreeMap<[i64; 3], Vec<usize>> = BTreeMap::new();
    for (i, p) in points.iter().enumerate() {
        cubes.entry([p.x, p.y, p.z].map(|c| (c / side).floor() as i64)).or_default().push(i);
    }
    let mut counts: Vec<usize> = cubes.values().map(Vec::len).collect();
    counts.sort_unstable();
    let few = counts.get(counts.len() / 2).map_or(0, |median| median / 4);
    cubes.into_values().filter(|patch| patch.len() > few).collect()
}

pub(super) fn median(values: impl Iterator<Item = f64>) -> f64 {
    let mut all: Vec<f64> = values.collect();
    all.sort_by(f64::total_cmp);
    all.get(all.len() / 2).copied().unwrap_or(0.0)
}

/// The edges of a garment that have one triangle, with the direction out of it.
pub(super) struct Boundary {
    pub(super) edges: Vec<([Vec3; 2], Vec3)>,
}

impl Boundary {
    pub(super) fn new(vertices: &[Vec3], faces: &[[u32; 3]]) -> Self {
        let mut next = vec![u32::MAX; vertices.len()];
        for ring in boundary_loops(faces) {
            for (k, &v) in ring.iter().enumerate() {
                next[v as usize] = ring[(k + 1) % ring.len()];
            }
        }
        let mut edges = Vec::new();
        for face in faces {
            for k in 0..3 {
                let (a, b) = (face[k] as usize, face[(k + 1) % 3] as usize);
                if next[a] as usize != b && next[b] as usize != a {
                    continue;
                }
                let (p, q, inner) = (vertices[a], vertices[b], vertices[face[(k + 2) % 3] as usize]);
                let along = (q - p).try_normalize(0.0).unwrap_or_else(Vec3::x);
                let away = (p - inner) - along * (p - inner).dot(&along);
                edges.push(([p, q], away.try_normalize(0.0).unwrap_or_else(Vec3::zeros)));
            }
        }
        Self { edges }
    }
    /// The nearest edge, and the way from it [m].
    pub(super) fn nearest(&self, p: &Vec3) -> Option<(usize, Vec3)> {
        let offset = |(ends, _): &([Vec3; 2], Vec3)| p - nearest_on_line(p, [&ends[0], &ends[1]]);
        let all = self.edges.iter().map(offset).enumerate();
        all.min_by(|a, b| a.1.norm_squared().total_cmp(&b.1.norm_squared()))
    }
    /// How far a point lies beyond the nearest edge along the surface [m], negative on the garment; 0 without edges.
    fn beyond(&self, p: &Vec3) -> f64 {
        self.nearest(p).map_or(0.0, |(k, offset)| offset.dot(&self.edges[k].1))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn edges_are_signed_along_the_surface() {
        // A strip of two squares along x, its boundary all around.
        let vertices: Vec<Vec3> = (0..6).map(|i| Vec3::new(f64::from(i / 2), f64::from(i % 2), 0.0)).collect();
        let faces = [[0, 2, 1], [1, 2, 3], [2, 4, 3], [3, 4, 5]];
        let boundary = Boundary::new(&vertices, &faces);
        assert_eq!(boundary.edges.len(), 6);
        // Beyond the end, off the surface: only the way along it counts.
        assert!((boundary.beyond(&Vec3::new(2.25, 0.5, 0.1)) - 0.25).abs() < 1e-12);
        assert!((boundary.beyond(&Vec3::new(1.9, 0.5, -0.1)) + 0.1).abs() < 1e-12);
        assert!((boundary.beyond(&Vec3::new(0.5, 1.25, 0.0)) - 0.25).abs() < 1e-12);
        let seen = Seen {
            points: &[Vec3::new(0.5, 0.5, 0.01)],
            edges: &[Vec3::new(2.02, 0.5, 0.0)],
            rims: &[],
            joined: &[],
            covered_by: &[],
        };
        let r = Patches::new(&seen).residuals(&seen, &vertices, &faces).unwrap();
        assert!((r[0].abs() - 0.01 / SIGMA).abs() < 1e-9 && (r[1] - 0.02 / EDGE_SIGMA).abs() < 1e-9, "{r:?}");
    }
}
