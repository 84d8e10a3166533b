//! What one scan says about the body: distances along directions at places of its surface, as rows of a least-squares problem.

use super::correspondence::NormalIndex;
use super::settings::RegistrationSettings;
use super::solve::{Level, Problem, ScanData, TRIAL_END};
use caphy_core::Vec3;
use caphy_core::body::PosedBody;
use caphy_core::query::{Fans, nearest_on_triangle};
use caphy_core::scan::Label;
use nalgebra::{DMatrix, DVector};

/// What one pair says: the distance along a direction should be `target`, with a weight.
pub(super) struct Pull {
    /// Wanted n·(v - p) [m]; negative is inside.
    pub(super) target: f64,
    /// 1/σ² [1/m²], robust weight included.
    pub(super) weight: f64,
}

/// The residuals of a place of the body at signed distance `r` = n·(v - p) and distance `d` [m] from a scan point.
///
/// Skin is attracted. Cloth holds the body inside: outside it, a stiff pull to the surface; deeper than allowed, a
/// weak pull to that depth; in between only the expected ease, which is weak too.
pub(super) fn pulls(settings: &RegistrationSettings, level: &Level, label: Label, r: f64, d: f64) -> [Pull; 2] {
    let none = || Pull { target: 0.0, weight: 0.0 };
    // Far from the solution cloth says as clearly as skin where a limb is.
    let blend = |fine: f64| settings.skin_sigma.powf(1.0 - level.fineness) * fine.powf(level.fineness);
    match label {
        Label::Ignore => [none(), none()],
        Label::Body => [Pull { target: 0.0, weight: robust(d, level.scale) / settings.skin_sigma.powi(2) }, none()],
        Label::Upper | Label::Lower => {
            let w = robust((d - settings.cloth_depth_max).max(0.0), level.scale);
            let ease = Pull { target: -settings.cloth_ease, weight: w / blend(settings.cloth_ease_sigma).powi(2) };
            let bound = if r > 0.0 {
                Pull { target: 0.0, weight: w / settings.outside_sigma.powi(2) }
            } else if r < -settings.cloth_depth_max {
                Pull { target: -settings.cloth_depth_max, weight: w / blend(settings.cloth_deep_sigma).powi(2) }
            } else {
                none()
            };
            [ease, bound]
        }
    }
}

/// Geman-McClure weight of a residual [m] at a scale [m].
pub(super) fn robust(d: f64, scale: f64) -> f64 {
    let s = scale * scale;
    (s / (s + d * d)).powi(2)
}

/// A place on the body's surface: shares of up to three vertices.
#[derive(Debug, Clone, Copy)]
struct Site {
    vertices: [u32; 3],
    shares: [f64; 3],
}

impl Site {
    fn vertex(v: u32) -> Self {
        Self { vertices: [v; 3], shares: [1.0, 0.0, 0.0] }
    }
    fn mix(&self, values: &[Vec3]) -> Vec3 {
        self.vertices.iter().zip(self.shares).map(|(&v, share)| values[v as usize] * share).sum()
    }
}

/// The place nearest to `p` [m] on the triangles around a vertex.
fn nearest_site(fans: &Fans, p: &Vec3, vertex: u32, vertices: &[Vec3], faces: &[[u32; 3]]) -> Site {
    let mut best = (f64::INFINITY, Site::vertex(vertex));
    for &f in fans.of(vertex as usize) {
        let face = faces[f as usize];
        let near = nearest_on_triangle(p, &face.map(|v| vertices[v as usize]));
        if near.squared_distance < best.0 {
            best = (near.squared_distance, Site { vertices: face, shares: near.barycentric });
        }
    }
    best.1
}

/// ½ weight (direction · δ)² + pull (direction · δ), with δ the displacement of a place.
#[derive(Debug, Clone, Copy)]
struct Row {
    site: Site,
    direction: Vec3,
    weight: f64,
    /// Weight times what the distance is too much by.
    pull: f64,
}

/// All rows of one scan.
pub(super) struct Rows {
    /// The vertices that rows speak of.
    pub(super) vertices: Vec<u32>,
    slot_of: Vec<u32>,
    rows: Vec<Row>,
    pub(super) cost: f64,
}

impl Rows {
    /// Pairs of a posed body and a scan, both ways.
    pub(super) fn new(problem: &Problem, scan: &ScanData, posed: &PosedBody, normals: &[Vec3], level: &Level) -> Self {
        let settings = problem.settings;
        let mut out = Self { vertices: vec![], slot_of: vec![u32::MAX; posed.vertices.len()], rows: vec![], cost: 0.0 };
        let reach = REACH * level.scale;
        let samples = problem.samples.at(level);
        let share = settings.evidence / samples.len().max(1) as f64;
        for &vertex in samples {
            let (v, n) = (posed.vertices[vertex as usize], normals[vertex as usize]);
            match scan.index.nearest(&v, &n, reach) {
                Some((id, _)) => {
                    let (p, n) = (scan.index.point(id), scan.index.normal(id));
                    out.pair(settings, level, share, Site::vertex(vertex), v, p, n, scan.labels[id]);
                }
                None => out.missing(settings, level, share),
            }
        }
        let body = NormalIndex::new(&posed.vertices, normals, settings.normal_angle_max, |_| true);
        let faces = &problem.body.describe().faces;
        let samples = scan.samples.at(level);
        let share = settings.evidence / samples.len().max(1) as f64;
        for &id in samples {
            let (p, n) = (scan.index.point(id as usize), scan.index.normal(id as usize));
            let Some((vertex, _)) = body.nearest(&p, &n, reach) else {
                out.missing(settings, level, share);
                continue;
            };
            let site = nearest_site(problem.fans, &p, vertex as u32, &posed.vertices, faces);
            let label = scan.labels[id as usize];
            // A fold's normal points anywhere: what lies under it is as deep as the skin says.
            let n = if label == Label::Body { n } else { site.mix(normals).try_normalize(0.0).unwrap_or(n) };
            out.pair(settings, level, share, site, site.mix(&posed.vertices), p, n, label);
        }
        out
    }
    /// Adds a pair of a place at `v` and scan point `p`, measured along `n`.
    fn pair(
        &mut self,
        settings: &RegistrationSettings,
        level: &Level,
        share: f64,
        site: Site,
        v: Vec3,
        p: Vec3,
        n: Vec3,
        label: Label,
    ) {
        if label == Label::Ignore {
            return;
        }
        let (r, d) = (n.dot(&(v - p)), (v - p).norm());
        let (mut weight, mut pull, mut total) = (0.0, 0.0, 0.0);
        for wish in pulls(settings, level, label, r, d) {
            let w = wish.weight * share;
            weight += w;
            pull += w * (r - wish.target);
            total = f64::max(total, w);
            self.cost += 0.5 * w * (r - wish.target).powi(2);
        }
        self.add(Row { site, direction: n, weight, pull });
        // Far from the solution surfaces must not only touch but also stop sliding. Later that would only hold a limb's
        // twist, which no smooth surface shows, where it happens to be.
        let sideways = total * SLIDING * (1.0 - level.fineness / TRIAL_END).max(0.0);
        if sideways > 0.0 {
            let along = v - p - n * r;
            for direction in tangents(&n) {
                self.add(Row { site, direction, weight: sideways, pull: sideways * direction.dot(&along) });
            }
            self.cost += 0.5 * sideways * (d * d - r * r).max(0.0);
        }
    }
    fn add(&mut self, row: Row) {
        if row.weight <= 0.0 {
            return;
        }
        for (&v, share) in row.site.vertices.iter().zip(row.site.shares) {
            if share > 0.0 && self.slot_of[v as usize] == u32::MAX {
                self.slot_of[v as usize] = self.vertices.len() as u32;
                self.vertices.push(v);
            }
        }
        self.rows.push(row);
    }
    /// A sample without a partner costs as much as one at the edge of the search.
    fn missing(&mut self, settings: &RegistrationSettings, level: &Level, share: f64) {
        self.cost += 0.5 * share * (level.scale / settings.skin_sigma).powi(2) * 0.25;
    }
    /// Hessian and gradient in the parameters of `jacobian`'s columns, which are three rows per entry of `vertices`.
    pub(super) fn equations(&self, jacobian: &DMatrix<f64>) -> (DMatrix<f64>, DVector<f64>) {
        let by_vertex = jacobian.transpose();
        let count = by_vertex.nrows();
        let mut scaled = DMatrix::zeros(count, self.rows.len());
        let mut pulled = DVector::zeros(self.rows.len());
        for (k, row) in self.rows.iter().enumerate() {
            let scale = row.weight.sqrt();
            pulled[k] = row.pull / scale;
            let mut column = scaled.column_mut(k);
            for (&v, share) in row.site.vertices.iter().zip(row.site.shares) {
                if share > 0.0 {
                    let at = 3 * self.slot_of[v as usize] as usize;
                    for axis in 0..3 {
                        column.axpy(scale * share * row.direction[axis], &by_vertex.column(at + axis), 1.0);
                    }
                }
            }
        }
        (&scaled * scaled.transpose(), &scaled * pulled)
    }
}

/// Two directions across a unit vector, and across each other.
fn tangents(n: &Vec3) -> [Vec3; 2] {
    let other = if n.x.abs() < 0.6 { Vec3::x() } else { Vec3::y() };
    let first = n.cross(&other).normalize();
    [first, n.cross(&first)]
}

/// Weight of the distance along the surface against that along the normal, in the first iteration.
const SLIDING: f64 = 0.3;

/// Farthest partner, in robust scales: its weight is 1 %.
const REACH: f64 = 3.0;
