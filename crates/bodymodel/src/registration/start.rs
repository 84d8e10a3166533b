//! Where to start: a coarse search over heading, position, arms and legs with a thinned body.
//!
//! Iterative closest points only finds the pose whose basin it starts in. The search poses a few hundred vertices by
//! plain linear blend skinning (pose correctives are smaller than what it resolves), measures a symmetric, capped
//! distance to a few hundred scan points in position and normal, and turns one limb at a time through a table of
//! angles.

use super::correspondence::spread;
use caphy_core::body::{BodyDescription, BodyModel};
use caphy_core::pose::Pose;
use caphy_core::scan::{Label, LabelledPoints};
use caphy_core::{Result, Vec3, mesh, simd_kernel};
use nalgebra::{Matrix3, Rotation3};

/// Vertices and scan points of the coarse search, each.
const POINTS: usize = 384;
/// Distance that stands for opposite normals, times one half [m]: a third of a limb's girth.
const NORMAL_LENGTH: f32 = 0.08;
/// Distance beyond which a point counts as not explained [m].
const CAP: f32 = 0.25;

/// The body as the search sees it: rest joints and a few weighted vertices.
pub(super) struct Proxy<'a> {
    body: &'a BodyDescription,
    /// Rest joints [m].
    joints: Vec<Vec3>,
    vertices: Vec<u32>,
    rest: Vec<Vec3>,
    normals: Vec<Vec3>,
}

/// Positions and normals, coordinate by coordinate.
#[derive(Default, Clone)]
struct Cloud {
    coordinates: [Vec<f32>; 6],
}

impl Cloud {
    fn new(points: &[Vec3], normals: &[Vec3]) -> Self {
        let mut out = Self::default();
        for (p, n) in points.iter().zip(normals) {
            for k in 0..3 {
                out.coordinates[k].push(p[k] as f32);
                out.coordinates[k + 3].push(n[k] as f32 * NORMAL_LENGTH);
            }
        }
        out
    }
    fn len(&self) -> usize {
        self.coordinates[0].len()
    }
}

simd_kernel! {
    /// Squared distances in six dimensions from one point to all of a cloud, and the running minimum per point.
    fn distances<T>(point: &[T; 6], cloud: &[&[T]; 6], out: &mut [T], minimum: &mut [T]) {
        let n = out.len();
        let [x, y, z, u, v, w] = [&cloud[0][..n], &cloud[1][..n], &cloud[2][..n], &cloud[3][..n], &cloud[4][..n], &cloud[5][..n]];
        let minimum = &mut minimum[..n];
        for i in 0..n {
            let (a, b, c) = (x[i] - point[0], y[i] - point[1], z[i] - point[2]);
            let (d, e, f) = (u[i] - point[3], v[i] - point[4], w[i] - point[5]);
            let s = a * a + b * b + c * c + d * d + e * e + f * f;
            out[i] = s;
            minimum[i] = if s < minimum[i] { s } else { minimum[i] };
        }
    }
}

simd_kernel! {
    /// Smallest of some values.
    fn smallest<T>(values: &[T]) -> T {
        let mut best = [T::infinity(); 16];
        let chunks = values.chunks_exact(16);
        let rest = chunks.remainder();
        for chunk in chunks {
            for k in 0..16 {
                best[k] = if chunk[k] < best[k] { chunk[k] } else { best[k] };
            }
        }
        let mut out = T::infinity();
        for &v in best.iter().chain(rest) {
            out = if v < out { v } else { out };
        }
        out
    }
}

/// The scan as the search sees it.
struct Target {
    points: Vec<Vec3>,
    cloud: Cloud,
}

impl Target {
    fn new(scan: &LabelledPoints) -> Self {
        let usable = |i: usize| {
            scan.labels[i] != Label::Ignore
                && scan.points[i].iter().chain(scan.normals[i].iter()).all(|c| c.is_finite())
        };
        let ids: Vec<usize> = (0..scan.points.len()).filter(|&i| usable(i)).collect();
        let kept: Vec<Vec3> = ids.iter().map(|&i| scan.points[i]).collect();
        let chosen = spread(&kept, POINTS);
        let points: Vec<Vec3> = chosen.iter().map(|&i| kept[i as usize]).collect();
        let normals: Vec<Vec3> = chosen.iter().map(|&i| scan.normals[ids[i as usize]]).collect();
        Self { cloud: Cloud::new(&points, &normals), points }
    }
}

/// Mean capped squared distance, both directions [m²].
fn misfit(body: &Cloud, target: &Target, scratch: &mut [Vec<f32>; 2]) -> f64 {
    let n = target.cloud.len();
    let cap = CAP * CAP;
    let [row, minimum] = scratch;
    row.resize(n, 0.0);
    minimum.clear();
    minimum.resize(n, f32::INFINITY);
    let slices: [&[f32]; 6] = std::array::from_fn(|k| &target.cloud.coordinates[k][..]);
    let mut to_scan = 0.0f64;
    for i in 0..body.len() {
        let point: [f32; 6] = std::array::from_fn(|k| body.coordinates[k][i]);
        distances(&point, &slices, row, minimum);
        to_scan += f64::from(smallest(row).min(cap));
    }
    let to_body: f64 = minimum.iter().map(|d| f64::from(d.min(cap))).sum();
    to_scan / body.len().max(1) as f64 + to_body / n.max(1) as f64
}

/// One limb of the search: its joints and the table of their rotations.
struct Limb {
    joints: [usize; 2],
    table: Vec<[Vec3; 2]>,
}

impl Limb {
    /// A pose with this limb turned to an entry of its table.
    fn turned(&self, pose: &Pose, entry: &[Vec3; 2]) -> Pose {
        let mut out = pose.clone();
        for (&joint, rotation) in self.joints.iter().zip(entry) {
            out.rotations[joint] = *rotation;
        }
        out
    }
}

fn turn(axis: usize, degrees: f64) -> Rotation3<f64> {
    let mut v = Vec3::zeros();
    v[axis] = degrees.to_radians();
    Rotation3::new(v)
}

/// The rotation of a limb that points along `along` [m] at rest to where `turned` takes it, without twist: twist
/// under a sleeve is not seen by any scan, so a search must not invent it.
fn swing(along: &Vec3, turned: &Rotation3<f64>) -> Vec3 {
    Rotation3::rotation_between(along, &(turned * along)).unwrap_or_else(Rotation3::identity).scaled_axis()
}

/// Arms and legs of a body whose joints have the SMPL-X names, `rest` [m] its rest joints; none for others.
fn limbs(body: &BodyDescription, rest: &[Vec3]) -> Vec<Limb> {
    let along = |joints: [usize; 2]| rest[joints[1]] - rest[joints[0]];
    let mut out = Vec::new();
    for (side, s) in [("left", 1.0), ("right", -1.0)] {
        let pair = |a: &str, b: &str| Some([body.joint(&format!("{side}_{a}"))?, body.joint(&format!("{side}_{b}"))?]);
        if let Some(joints) = pair("hip", "knee") {
            let mut table = Vec::new();
            for apart in [0.0, 15.0, 35.0] {
                for forward in [-25.0, 0.0, 30.0, 60.0, 90.0] {
                    for knee in [0.0, 45.0, 90.0] {
                        let hip = turn(2, s * apart) * turn(0, -forward);
                        table.push([swing(&along(joints), &hip), turn(0, knee).scaled_axis()]);
                    }
                }
            }
            out.push(Limb { joints, table });
        }
        if let Some(joints) = pair("shoulder", "elbow") {
            let mut table = Vec::new();
            for down in [-70.0, -35.0, 0.0, 30.0, 55.0, 80.0] {
                for forward in [-30.0, 0.0, 40.0, 80.0] {
                    for elbow in [0.0, 50.0, 100.0] {
                        let shoulder = turn(1, -s * forward) * turn(2, -s * down);
                        table.push([swing(&along(joints), &shoulder), turn(1, -s * elbow).scaled_axis()]);
                    }
                }
            }
            out.push(Limb { joints, table });
        }
    }
    out
}

impl<'a> Proxy<'a> {
    /// Thins the T-posed body of a shape.
    pub(super) fn new(body: &'a dyn BodyModel, shape: &[f64]) -> Result<Self> {
        let description = body.describe();
        let posed = body.forward(&body.rest(shape))?;
        let normals = mesh::vertex_normals(&posed.vertices, &description.faces);
        let vertices: Vec<u32> = spread(&posed.vertices, POINTS);
        Ok(Self {
            body: description,
            rest: vertices.iter().map(|&v| posed.vertices[v as usize]).collect(),
            normals: vertices.iter().map(|&v| normals[v as usize]).collect(),
            joints: posed.joints,
            vertices,
        })
    }
    fn pose(&self, pose: &Pose) -> Cloud {
        // World rotation and position of each joint, parents first.
        let mut world: Vec<(Matrix3<f64>, Vec3)> = Vec::with_capacity(self.joints.len());
        for (j, joint) in self.body.joints.iter().enumerate() {
            let local = Rotation3::from_scaled_axis(pose.rotations[j]).into_inner();
            world.push(match joint.parent {
                None => (local, self.joints[j] + pose.translation),
                Some(p) => {
                    let (r, t) = world[p];
                    (r * local, t + r * (self.joints[j] - self.joints[p]))
                }
            });
        }
        let mut points = Vec::with_capacity(self.rest.len());
        let mut normals = Vec::with_capacity(self.rest.len());
        for (i, &v) in self.vertices.iter().enumerate() {
            let (mut p, mut n) = (Vec3::zeros(), Vec3::zeros());
            for (j, w) in self.body.weights.row(v as usize) {
                let (r, t) = &world[j];
                p += (t + r * (self.rest[i] - self.joints[j])) * w;
                n += r * self.normals[i] * w;
            }
            points.push(p);
            normals.push(n.try_normalize(0.0).unwrap_or_else(Vec3::zeros));
        }
        Cloud::new(&points, &normals)
    }
    /// How badly the best pose of the search fits: mean capped squared distance [m²].
    pub(super) fn misfit(&self, scan: &LabelledPoints, headings: usize) -> f64 {
        let target = Target::new(scan);
        let limbs = limbs(self.body, &self.joints);
        let found = self.descents(&target, &limbs, headings);
        found.iter().map(|f| f.0).fold(f64::INFINITY, f64::min)
    }
    /// One pose per heading, each the end of a descent from upright.
    fn descents(&self, target: &Target, limbs: &[Limb], headings: usize) -> Vec<(f64, Pose)> {
        let root = self.body.joints.iter().position(|j| j.parent.is_none());
        let from = |heading: usize| {
            let mut pose = Pose::rest(self.joints.len());
            if let Some(root) = root {
                let yaw = std::f64::consts::TAU * heading as f64 / headings as f64;
                // The shorter way round.
                pose.rotations[root] =
                    Vec3::y() * if yaw > std::f64::consts::PI { yaw - std::f64::consts::TAU } else { yaw };
            }
            self.descend(pose, root, limbs, target)
        };
        (0..headings).map(from).collect()
    }
    /// Poses to try, best first: one per heading, at most `count`, and before them a given one, as it is and searched
    /// from.
    pub(super) fn search(
        &self,
        scan: &LabelledPoints,
        headings: usize,
        count: usize,
        given: Option<&Pose>,
    ) -> Vec<Pose> {
        let target = Target::new(scan);
        let limbs = limbs(self.body, &self.joints);
        let root = self.body.joints.iter().position(|j| j.parent.is_none());
        let mut found = self.descents(&target, &limbs, headings);
        found.sort_by(|a, b| a.0.total_cmp(&b.0));
        found.truncate(count);
        let mut out: Vec<Pose> = Vec::new();
        if let Some(pose) = given {
            out.push(pose.clone());
            out.push(self.descend(pose.clone(), root, &limbs, &target).1);
        }
        out.extend(found.into_iter().map(|(_, pose)| pose));
        out
    }
    /// A pose with one limb turned another way: of each limb's table the `count` entries that explain the scan best, best limb first.
    /// Last the end of a search from upright with the pose's heading: more than a limb may be wrong.
    pub(super) fn other_limbs(&self, scan: &LabelledPoints, pose: &Pose, count: usize) -> Vec<Pose> {
        let target = Target::new(scan);
        let mut scratch = [Vec::new(), Vec::new()];
        let mut found: Vec<(f64, Pose)> = Vec::new();
        let limbs = limbs(self.body, &self.joints);
        for limb in &limbs {
            let mut of_limb: Vec<(f64, Pose)> = Vec::new();
            for entry in &limb.table {
                let trial = limb.turned(pose, entry);
                of_limb.push((misfit(&self.pose(&trial), &target, &mut scratch), trial));
            }
            of_limb.sort_by(|a, b| a.0.total_cmp(&b.0));
            found.extend(of_limb.into_iter().take(count));
        }
        found.sort_by(|a, b| a.0.total_cmp(&b.0));
        let root = self.body.joints.iter().position(|j| j.parent.is_none());
        let mut upright = Pose::rest(pose.rotations.len());
        upright.translation = pose.translation;
        if let Some(root) = root {
            let ahead = Rotation3::from_scaled_axis(pose.rotations[root]) * Vec3::z();
            upright.rotations[root] = Vec3::y() * ahead.x.atan2(ahead.z);
        }
        let anew = self.descend(upright, root, &limbs, &target).1;
        found.into_iter().map(|(_, pose)| pose).chain([anew]).collect()
    }
    /// Places the body, turns one limb at a time through its table, tilts the whole; twice.
    fn descend(&self, mut pose: Pose, root: Option<usize>, limbs: &[Limb], target: &Target) -> (f64, Pose) {
        let mut scratch = [Vec::new(), Vec::new()];
        let mut best = self.place(&mut pose, target, &mut scratch);
        for _ in 0..2 {
            for limb in limbs {
                for entry in &limb.table {
                    let trial = limb.turned(&pose, entry);
                    let cost = misfit(&self.pose(&trial), target, &mut scratch);
                    if cost < best {
                        (best, pose) = (cost, trial);
                    }
                }
            }
            if let Some(root) = root {
                for degrees in [20.0, 10.0] {
                    for axis in 0..3 {
                        for sign in [-1.0, 1.0] {
                            let mut trial = pose.clone();
                            let turned = turn(axis, sign * degrees) * Rotation3::from_scaled_axis(pose.rotations[root]);
                            trial.rotations[root] = turned.scaled_axis();
                            let cost = misfit(&self.pose(&trial), target, &mut scratch);
                            if cost < best {
                                (best, pose) = (cost, trial);
                            }
                        }
                    }
                }
            }
            best = best.min(self.place(&mut pose, target, &mut scratch));
        }
        (best, pose)
    }
    /// Moves the body as a whole to the cheapest of a few positions: boxes aligned below, above and by the median,
    /// then a pattern search around the best.
    fn place(&self, pose: &mut Pose, target: &Target, scratch: &mut [Vec<f32>; 2]) -> f64 {
        let posed = self.pose(pose);
        let range = |mut values: Vec<f64>| {
            values.sort_by(f64::total_cmp);
            let at = |share: f64| values.get((values.len().saturating_sub(1) as f64 * share) as usize).copied();
            [0.01, 0.5, 0.99].map(|share| at(share).unwrap_or(0.0))
        };
        let body: [[f64; 3]; 3] =
            std::array::from_fn(|k| range(posed.coordinates[k].iter().map(|&c| f64::from(c)).collect()));
        let scan: [[f64; 3]; 3] = std::array::from_fn(|k| range(target.points.iter().map(|p| p[k]).collect()));
        let here = pose.translation;
        let mut candidates = vec![here];
        for y in 0..3 {
            candidates
                .push(here + Vec3::new(scan[0][1] - body[0][1], scan[1][y] - body[1][y], scan[2][1] - body[2][1]));
        }
        let mut best = f64::INFINITY;
        let mut at = here;
        let shift = |t: Vec3, scratch: &mut [Vec<f32>; 2]| {
            let mut moved = posed.clone();
            for k in 0..3 {
                let d = (t[k] - here[k]) as f32;
                moved.coordinates[k].iter_mut().for_each(|c| *c += d);
            }
            misfit(&moved, target, scratch)
        };
        for candidate in candidates {
            let cost = shift(candidate, scratch);
            if cost < best {
                (best, at) = (cost, candidate);
            }
        }
        for step in [0.1, 0.05, 0.025] {
            for _ in 0..4 {
                let centre = at;
                for axis in 0..3 {
                    for sign in [-1.0, 1.0] {
                        let mut candidate = centre;
                        candidate[axis] += sign * step;
                        let cost = shift(candidate, scratch);
                        if cost < best {
                            (best, at) = (cost, candidate);
                        }
                    }
                }
                if at == centre {
                    break;
                }
            }
        }
        pose.translation = at;
        best
    }
}
