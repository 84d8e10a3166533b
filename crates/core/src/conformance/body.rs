//! The promise of [`BodyModel`], checked.

use super::differences::scattered;
use super::{Outcome, Verdict, ensure, table_checks, unexpected};
use crate::body::{BodyModel, BodyParameters, BodySpec, PosedBody};
use crate::files::Files;
use crate::lanes::Frames;
use crate::{Error, Result, Vec3};
use nalgebra::{Matrix3x4, Rotation3};
use std::sync::Arc;

/// A body as its table makes it.
pub struct BodySubject {
    /// A valid table: `type` and its keys. A coarse body makes quick checks.
    pub toml: String,
    /// Makes the body from a table.
    pub create: Box<dyn Fn(&str) -> Result<Box<dyn BodyModel>> + Send + Sync>,
    /// Writes a table back with every default, where the plugin can.
    pub normalise: Option<Box<dyn Fn(&str) -> Result<String> + Send + Sync>>,
}

impl BodySubject {
    /// A body that is linked into this program, by its table.
    pub fn linked(toml: &str, files: Arc<dyn Files>) -> Self {
        fn spec(text: &str) -> Result<Box<dyn BodySpec>> {
            toml::from_str(text).map_err(|e| Error::config("body", e.message().trim(), "correct the table"))
        }
        let write = |text: &str| {
            toml::to_string(&spec(text)?).map_err(|e| Error::config("body", e.to_string(), "correct the table"))
        };
        let create = move |text: &str| spec(text)?.build(&*files);
        Self { toml: toml.into(), create: Box::new(create), normalise: Some(Box::new(write)) }
    }
    /// The body.
    pub fn model(&self) -> std::result::Result<Box<dyn BodyModel>, String> {
        self.model_of(&self.toml)
    }
    fn model_of(&self, toml: &str) -> std::result::Result<Box<dyn BodyModel>, String> {
        (self.create)(toml).map_err(unexpected("making the body"))
    }
}

crate::conformance_list! { body, conformance_checks BodySubject }

table_checks!(BodySubject, same);

/// `Ok` when two bodies answer alike.
fn same(a: &dyn BodyModel, b: &dyn BodyModel) -> std::result::Result<(), String> {
    ensure(a.describe() == b.describe(), || "the description changed".into())?;
    let p = posed(a);
    ensure(forward(a, &p)? == forward(b, &p)?, || "answers changed".into())
}

/// Everything at once: shape, expression, every joint turned by up to half a radian, translation, dT.
fn posed(body: &dyn BodyModel) -> BodyParameters {
    let d = body.describe();
    let vector = |i: usize, scale: f64| Vec3::new(scattered(i, 0), scattered(i, 1), scattered(i, 2)) * scale;
    BodyParameters {
        shape: (0..d.shape_count.min(4)).map(|i| scattered(i, 4)).collect(),
        expression: (0..d.expression_count.min(3)).map(|i| scattered(i, 5)).collect(),
        rotations: (0..d.joints.len()).map(|i| vector(i, 0.5)).collect(),
        translation: Vec3::new(0.3, -0.2, 0.7),
        displacement: (0..d.vertex_count).map(|i| vector(i + 7, 5e-3)).collect(),
    }
}

fn at_rest(body: &dyn BodyModel) -> BodyParameters {
    body.rest(&posed(body).shape)
}

fn forward(body: &dyn BodyModel, parameters: &BodyParameters) -> std::result::Result<PosedBody, String> {
    let out = body.forward(parameters).map_err(unexpected("posing the body"))?;
    let d = body.describe();
    let counts = (out.vertices.len(), out.joints.len(), out.transforms.len());
    ensure(counts == (d.vertex_count, d.joints.len(), d.joints.len()), || {
        format!("{counts:?} vertices, joints, transforms instead of {} and {}", d.vertex_count, d.joints.len())
    })?;
    Ok(out)
}

/// Largest distance between points [m].
fn apart(a: &[Vec3], b: &[Vec3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).norm()).fold(0.0, |m, d| if d > m || d.is_nan() { d } else { m })
}

/// Rounding of a body of metres in double precision, with room for sums over hundreds of terms.
const ROUNDING: f64 = 1e-9;

/// [`CHECKS`]: joints.
pub fn skeleton_is_a_tree(body: &dyn BodyModel) -> Outcome {
    let joints = &body.describe().joints;
    ensure(!joints.is_empty(), || "there is no joint".into())?;
    for (i, joint) in joints.iter().enumerate() {
        let earlier = joint.parent.is_none_or(|p| p < i);
        ensure(earlier, || format!("`{}` ({i}) comes before its parent {:?}", joint.name, joint.parent))?;
    }
    let mut names: Vec<&str> = joints.iter().map(|j| j.name.as_str()).collect();
    names.sort_unstable();
    ensure(names.windows(2).all(|w| w[0] != w[1]) && !names.contains(&""), || {
        "joints without a name, or two of one name".into()
    })?;
    Ok(Verdict::Passed)
}

/// [`CHECKS`]: faces.
pub fn surface_is_sound(body: &dyn BodyModel) -> Outcome {
    let d = body.describe();
    ensure(!d.faces.is_empty(), || "there is no face".into())?;
    for (i, f) in d.faces.iter().enumerate() {
        let inside = f.iter().all(|v| (*v as usize) < d.vertex_count);
        let distinct = f[0] != f[1] && f[1] != f[2] && f[2] != f[0];
        ensure(inside && distinct, || format!("face {i} is {f:?}, with {} vertices", d.vertex_count))?;
    }
    Ok(Verdict::Passed)
}

/// [`CHECKS`]: skinning weights.
pub fn weights_sum_to_one(body: &dyn BodyModel) -> Outcome {
    let d = body.describe();
    ensure(d.weights.vertex_count() == d.vertex_count, || {
        format!("weights of {} vertices, there are {}", d.weights.vertex_count(), d.vertex_count)
    })?;
    for v in 0..d.vertex_count {
        let (mut sum, mut sound) = (0.0, true);
        for (joint, weight) in d.weights.row(v) {
            sum += weight;
            sound &= joint < d.joints.len() && weight >= 0.0;
        }
        // Published weights are single precision.
        ensure(sound && (sum - 1.0f64).abs() < 1e-5, || format!("vertex {v}: sum {sum}"))?;
    }
    Ok(Verdict::Passed)
}

/// [`CHECKS`]: transforms of the T-pose.
pub fn rest_is_the_identity(body: &dyn BodyModel) -> Outcome {
    let rest = forward(body, &at_rest(body))?;
    for (j, transform) in rest.transforms.iter().enumerate() {
        let off = (transform - Matrix3x4::identity()).norm();
        ensure(off < ROUNDING, || format!("joint {j} is transformed by {transform:?}"))?;
    }
    Ok(Verdict::Passed)
}

/// [`CHECKS`]: translation.
pub fn translation_comes_last(body: &dyn BodyModel) -> Outcome {
    let mut parameters = posed(body);
    let by = parameters.translation;
    let moved = forward(body, &parameters)?;
    parameters.translation = Vec3::zeros();
    let here = forward(body, &parameters)?;
    let shift = |points: &[Vec3]| points.iter().map(|p| p + by).collect::<Vec<_>>();
    ensure(apart(&moved.vertices, &shift(&here.vertices)) < ROUNDING, || "vertices do not move with it".into())?;
    ensure(apart(&moved.joints, &shift(&here.joints)) < ROUNDING, || "joints do not move with it".into())?;
    for (a, b) in moved.transforms.iter().zip(&here.transforms) {
        let wanted = b.column(3) + by;
        ensure((a.column(3) - wanted).norm() < ROUNDING, || "transforms do not contain it".into())?;
    }
    Ok(Verdict::Passed)
}

/// [`CHECKS`]: x' = R (x − root) + root.
pub fn the_root_turns_everything(body: &dyn BodyModel) -> Outcome {
    let mut parameters = posed(body);
    parameters.translation = Vec3::zeros();
    parameters.rotations[0] = Vec3::zeros();
    let straight = forward(body, &parameters)?;
    parameters.rotations[0] = Vec3::new(0.4, -1.1, 0.7);
    let turned = forward(body, &parameters)?;
    let (rotation, root) = (Rotation3::new(parameters.rotations[0]), straight.joints[0]);
    let turn = |points: &[Vec3]| points.iter().map(|p| rotation * (p - root) + root).collect::<Vec<_>>();
    let vertices = apart(&turned.vertices, &turn(&straight.vertices));
    ensure(vertices < ROUNDING, || format!("vertices are up to {vertices} m away"))?;
    let joints = apart(&turned.joints, &turn(&straight.joints));
    ensure(joints < ROUNDING, || format!("joints are up to {joints} m away"))?;
    Ok(Verdict::Passed)
}

/// [`CHECKS`]: dT at rest.
pub fn displacements_add_in_the_rest_pose(body: &dyn BodyModel) -> Outcome {
    let plain = at_rest(body);
    let with = BodyParameters { displacement: posed(body).displacement, ..plain.clone() };
    let (here, there) = (forward(body, &plain)?, forward(body, &with)?);
    let wanted: Vec<Vec3> = here.vertices.iter().zip(&with.displacement).map(|(v, d)| v + d).collect();
    ensure(apart(&there.vertices, &wanted) < ROUNDING, || "vertices are not T(β) + dT".into())?;
    ensure(apart(&there.joints, &here.joints) < ROUNDING, || "joints move with dT".into())?;
    Ok(Verdict::Passed)
}

/// [`CHECKS`]: short coefficient vectors.
pub fn missing_coefficients_are_zeros(body: &dyn BodyModel) -> Outcome {
    let d = body.describe();
    let mut short = posed(body);
    short.shape.truncate(1);
    short.expression.truncate(1);
    let mut long = short.clone();
    if !long.shape.is_empty() {
        long.shape.resize(d.shape_count, 0.0);
    }
    if !long.expression.is_empty() {
        long.expression.resize(d.expression_count, 0.0);
    }
    let off = apart(&forward(body, &short)?.vertices, &forward(body, &long)?.vertices);
    ensure(off < ROUNDING, || format!("{off} m between missing and zero coefficients"))?;
    Ok(Verdict::Passed)
}

/// [`CHECKS`]: [`Error::Length`] and [`Error::NonFinite`].
pub fn wrong_counts_are_refused(body: &dyn BodyModel) -> Outcome {
    let d = body.describe();
    let good = posed(body);
    let too_long = BodyParameters { shape: vec![0.1; d.shape_count + 1], ..good.clone() };
    let expression = BodyParameters { expression: vec![0.1; d.expression_count + 1], ..good.clone() };
    let mut joints = good.clone();
    joints.rotations.pop();
    let mut displacement = good.clone();
    displacement.displacement.push(Vec3::zeros());
    for (what, bad) in [
        ("too many shape coefficients", too_long),
        ("too many expression coefficients", expression),
        ("one rotation too few", joints),
        ("one displacement too many", displacement),
    ] {
        ensure(matches!(body.forward(&bad), Err(Error::Length { .. })), || format!("{what} are no Length error"))?;
    }
    let mut rotation = good.clone();
    rotation.rotations[0].y = f64::NAN;
    let mut translation = good.clone();
    translation.translation.z = f64::INFINITY;
    let mut dt = good.clone();
    dt.displacement[1].x = f64::NAN;
    for (what, bad) in [("a rotation", rotation), ("a translation", translation), ("a displacement", dt)] {
        let refused = matches!(body.forward(&bad), Err(Error::NonFinite { .. }));
        ensure(refused, || format!("{what} that is not finite is no NonFinite error"))?;
    }
    let few = vec![Vec3::zeros(); d.vertex_count - 1];
    let refused = matches!(body.vjp(&good, &few, &[]), Err(Error::Length { .. }));
    ensure(refused, || "one cotangent too few is no Length error".into())?;
    Ok(Verdict::Passed)
}

/// Cotangents of vertices and joints.
fn cotangents(body: &dyn BodyModel) -> [Vec<Vec3>; 2] {
    let vectors = |n: usize, from: usize| {
        (0..n).map(|i| Vec3::new(scattered(i, from), scattered(i, from + 1), scattered(i, from + 2))).collect()
    };
    [vectors(body.describe().vertex_count, 3), vectors(body.describe().joints.len(), 6)]
}

/// A named change of one parameter.
type Change = (String, Box<dyn Fn(&mut BodyParameters, f64)>, f64);

/// [`CHECKS`]: vector-Jacobian products in a general pose, with joints at zero rotation and near π.
pub fn gradients_agree_with_differences(body: &dyn BodyModel) -> Outcome {
    let [gv, gj] = cotangents(body);
    let mut zero = posed(body);
    zero.rotations.iter_mut().for_each(|r| *r = Vec3::zeros());
    let mut half_turn = posed(body);
    half_turn.rotations[0] = Vec3::new(0.0, std::f64::consts::PI - 1e-3, 0.0);
    for (pose, parameters) in [("a pose", posed(body)), ("the T-pose", zero), ("a half turn", half_turn)] {
        let gradient = body.vjp(&parameters, &gv, &gj).map_err(unexpected("a vector-Jacobian product"))?;
        let mut changes: Vec<Change> = Vec::new();
        for (i, g) in gradient.shape.iter().enumerate() {
            changes.push((format!("shape {i}"), Box::new(move |p, h| p.shape[i] += h), *g));
        }
        for (i, g) in gradient.expression.iter().enumerate() {
            changes.push((format!("expression {i}"), Box::new(move |p, h| p.expression[i] += h), *g));
        }
        let joints = gradient.rotations.len();
        for j in (0..joints).step_by((joints / 8).max(1)) {
            for axis in 0..3 {
                let g = gradient.rotations[j][axis];
                changes.push((
                    format!("rotation {j}, axis {axis}"),
                    Box::new(move |p, h| p.rotations[j][axis] += h),
                    g,
                ));
            }
        }
        for axis in 0..3 {
            let g = gradient.translation[axis];
            changes.push((format!("translation {axis}"), Box::new(move |p, h| p.translation[axis] += h), g));
        }
        let vertices = gradient.displacement.len();
        for v in (0..vertices).step_by((vertices / 4).max(1)) {
            let g = gradient.displacement[v][v % 3];
            changes.push((format!("dT {v}"), Box::new(move |p, h| p.displacement[v][v % 3] += h), g));
        }
        let loss = |p: &BodyParameters| -> std::result::Result<f64, String> {
            let out = forward(body, p)?;
            let dot = |a: &[Vec3], b: &[Vec3]| a.iter().zip(b).map(|(a, b)| a.dot(b)).sum::<f64>();
            Ok(dot(&out.vertices, &gv) + dot(&out.joints, &gj))
        };
        // The loss sums over all vertices: its rounding, divided by the step, bounds what a difference can tell.
        let size: f64 = gv.iter().map(|g| g.norm()).sum::<f64>() * 2.0;
        let h = 1e-5;
        for (what, change, g) in changes {
            let shifted = |h: f64| {
                let mut p = parameters.clone();
                change(&mut p, h);
                loss(&p)
            };
            let difference = (shifted(h)? - shifted(-h)?) / (2.0 * h);
            let tolerance = 1e-6 * g.abs() + f64::EPSILON * size / h * 8.0 + 1e-8 * size;
            ensure((difference - g).abs() <= tolerance, || format!("{what} in {pose}: {g} instead of {difference}"))?;
        }
    }
    Ok(Verdict::Passed)
}

/// [`CHECKS`]: [`BodyModel::jacobian`].
pub fn the_jacobian_is_made_of_products(body: &dyn BodyModel) -> Outcome {
    let parameters = posed(body);
    let n = body.describe().vertex_count;
    let vertices = [0, n as u32 / 2, n as u32 - 1];
    let jacobian = body.jacobian(&parameters, &vertices).map_err(unexpected("a Jacobian"))?;
    let columns = 3 + 3 * parameters.rotations.len() + parameters.shape.len();
    ensure(jacobian.shape() == (9, columns), || format!("shape {:?}, not (9, {columns})", jacobian.shape()))?;
    for (i, &v) in vertices.iter().enumerate() {
        for axis in 0..3 {
            let mut cotangents = vec![Vec3::zeros(); n];
            cotangents[v as usize][axis] = 1.0;
            let g = body.vjp(&parameters, &cotangents, &[]).map_err(unexpected("a vector-Jacobian product"))?;
            let row: Vec<f64> =
                g.translation.iter().chain(g.rotations.iter().flatten()).chain(&g.shape).copied().collect();
            for (column, wanted) in row.iter().enumerate() {
                let got = jacobian[(3 * i + axis, column)];
                ensure((got - wanted).abs() < ROUNDING, || {
                    format!("vertex {v}, axis {axis}, column {column}: {got} instead of {wanted}")
                })?;
            }
        }
    }
    Ok(Verdict::Passed)
}

/// [`CHECKS`]: [`BodyModel::forward_frames`], all vertices and some, to 1e-5 m in single precision.
pub fn frames_agree_with_poses(body: &dyn BodyModel) -> Outcome {
    let n = body.describe().vertex_count;
    let mut frames = Vec::new();
    for i in 0..6 {
        let mut p = posed(body);
        p.rotations.iter_mut().enumerate().for_each(|(j, r)| *r *= scattered(i + j, 9));
        p.translation.x += i as f64;
        frames.push(p);
    }
    let some: Vec<u32> = (0..n as u32).rev().step_by(3).collect();
    for subset in [None, Some(&some[..])] {
        let count = subset.map_or(n, <[u32]>::len);
        let mut out = Frames::<f32>::zeros(2, count, 3);
        body.forward_frames(&frames, subset, &mut out).map_err(unexpected("a batch"))?;
        for (i, p) in frames.iter().enumerate() {
            let all = forward(body, p)?.vertices;
            let wanted: Vec<Vec3> = match subset {
                None => all,
                Some(ids) => ids.iter().map(|&id| all[id as usize]).collect(),
            };
            let off = apart(&out.frame(i / 3, i % 3), &wanted);
            ensure(off < 1e-5, || format!("frame {i} is {off} m off in a batch of {count} vertices"))?;
        }
    }
    Ok(Verdict::Passed)
}

/// [`CHECKS`]: [`BodyModel::skeleton`], at rest and in a pose.
pub fn skeleton_agrees_with_poses(body: &dyn BodyModel) -> Outcome {
    for parameters in [at_rest(body), posed(body)] {
        let (whole, alone) =
            (forward(body, &parameters)?, body.skeleton(&parameters).map_err(unexpected("a skeleton"))?);
        let counts = (alone.joints.len(), alone.transforms.len());
        ensure(counts == (whole.joints.len(), whole.transforms.len()), || format!("{counts:?} joints, transforms"))?;
        let off = apart(&alone.joints, &whole.joints);
        ensure(off < ROUNDING, || format!("joints are up to {off} m away"))?;
        for (j, (a, b)) in alone.transforms.iter().zip(&whole.transforms).enumerate() {
            ensure((a - b).norm() < ROUNDING, || format!("joint {j} is transformed by {a:?} instead of {b:?}"))?;
        }
    }
    Ok(Verdict::Passed)
}

/// [`CHECKS`]: [`BodyModel::landmark_names`] and [`BodyModel::landmarks`]; not offered by bodies without landmarks.
pub fn landmarks_ride_on_the_surface(body: &dyn BodyModel) -> Outcome {
    let (d, names) = (body.describe(), body.landmark_names());
    let mut sorted: Vec<&str> = names.iter().map(String::as_str).collect();
    sorted.sort_unstable();
    ensure(sorted.windows(2).all(|w| w[0] != w[1]) && !sorted.contains(&""), || {
        "landmarks without a name, or two of one name".into()
    })?;
    if let Some(name) = names.iter().find(|name| d.joint(name).is_some()) {
        return Err(format!("the landmark `{name}` is called like a joint"));
    }
    for parameters in [at_rest(body), posed(body)] {
        let points = body.landmarks(&parameters.rotations).map_err(unexpected("placing landmarks"))?;
        ensure(points.len() == names.len(), || format!("{} points of {} names", points.len(), names.len()))?;
        for (name, point) in names.iter().zip(&points) {
            let exist = point.vertices.iter().all(|v| (*v as usize) < d.vertex_count);
            let sum: f64 = point.weights.iter().sum();
            // Published weights are single precision.
            ensure(exist && (sum - 1.0).abs() < 1e-5, || {
                format!("`{name}` is {point:?} of {} vertices", d.vertex_count)
            })?;
        }
    }
    let few = vec![Vec3::zeros(); d.joints.len() - 1];
    let refused = matches!(body.landmarks(&few), Err(Error::Length { .. }));
    ensure(refused, || "one rotation too few is no Length error".into())?;
    Ok(if names.is_empty() { Verdict::NotOffered } else { Verdict::Passed })
}

/// [`CHECKS`]: every joint at π, forward and backward.
pub fn extremes_are_finite(body: &dyn BodyModel) -> Outcome {
    let [gv, gj] = cotangents(body);
    for axis in [Vec3::x(), Vec3::y(), Vec3::z(), -Vec3::z()] {
        let mut p = posed(body);
        p.rotations.iter_mut().for_each(|r| *r = axis * std::f64::consts::PI);
        let out = forward(body, &p)?;
        let finite = out.vertices.iter().chain(&out.joints).all(|v| v.iter().all(|x| x.is_finite()));
        ensure(finite, || format!("the pose about {axis:?} is not finite"))?;
        let g = body.vjp(&p, &gv, &gj).map_err(unexpected("a vector-Jacobian product"))?;
        let finite = g.rotations.iter().chain(&g.displacement).all(|v| v.iter().all(|x| x.is_finite()))
            && g.shape.iter().chain(&g.expression).all(|x| x.is_finite());
        ensure(finite, || format!("the gradient about {axis:?} is not finite"))?;
    }
    Ok(Verdict::Passed)
}

/// [`CHECKS`]: pure, on any thread.
pub fn threads_change_nothing(body: &dyn BodyModel) -> Outcome {
    let [gv, gj] = cotangents(body);
    let run = || -> std::result::Result<_, String> {
        let p = posed(body);
        let g = body.vjp(&p, &gv, &gj).map_err(unexpected("a vector-Jacobian product"))?;
        Ok((forward(body, &p)?, g))
    };
    let first = run()?;
    let others: Vec<std::result::Result<bool, String>> = std::thread::scope(|scope| {
        let threads: Vec<_> = (0..4).map(|_| scope.spawn(|| Ok(run()? == first))).collect();
        threads.into_iter().map(|t| t.join().unwrap_or_else(|_| Err("a thread panicked".into()))).collect()
    });
    for same in others {
        ensure(same?, || "other bits on another thread".into())?;
    }
    Ok(Verdict::Passed)
}
