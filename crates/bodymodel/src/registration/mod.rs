//! Segmentation-aware registration: one naked body shape and a pose per scan, under the clothes (Sec. 3.1).
//!
//! # Method
//! Skin of the scan attracts the body. Cloth holds it inside: a stiff one-sided bound, a weak expectation of ease,
//! and a weak pull where the body is deeper than clothes usually are. Correspondences go both ways, to the nearest
//! point whose normal is compatible; residuals are distances along the scan's normal (of cloth, whose folds point anywhere, along
//! the skin's) with Geman-McClure weights whose scale shrinks. Priors hold the pose (knees and elbows bend one way) and the shape (N(0, 1)). Gauss-Newton steps
//! with the body's own Jacobian solve all poses and the shared shape together: the arrow-shaped system by Schur's
//! complement. What no shape explains, dT takes up: in the last third of the iterations a smooth field is found in turn
//! with them. The start is a coarse search over heading, position, arms and legs, whose best poses are tried before
//! one is kept. Scans with skin that the body is not near to are looked at again, limb by limb, before dT is found.
//!
//! Nothing here assumes SMPL-X but the joint names that choose priors and limbs; joints of other names get defaults.
//!
//! Differs from the paper: the paper prints no energy for this step ("constraining the deformed vertices to align the
//! uncovered skin areas while being underneath the clothing areas").

mod again;
mod correspondence;
mod displacement;
mod prior;
mod rows;
mod settings;
mod solve;
mod start;

pub use settings::RegistrationSettings;

use caphy_core::body::BodyModel;
use caphy_core::pose::Pose;
use caphy_core::query::Fans;
use caphy_core::scan::LabelledPoints;
use caphy_core::{Error, Result, Vec3};
use caphy_formats::motion::UpAxis;
use correspondence::Samples;
use prior::Group;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use solve::{Level, Problem, ScanData, State, TRIAL_END};

/// A scan to fit, with outward normals and labels.
#[derive(Debug, Clone)]
pub struct RegistrationScan<'a> {
    /// Name for reports and errors.
    pub name: &'a str,
    /// Points [m], y up; normals; labels. Points labelled [`Ignore`](caphy_core::scan::Label::Ignore) are not looked
    /// at.
    pub points: &'a LabelledPoints,
    /// A rough pose, from a keypoint fit say; it joins the poses that are tried. `None`: only that the person stands
    /// more or less upright is known.
    pub start: Option<Pose>,
}

/// How well one scan was fitted.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ScanFit {
    /// The scan's name.
    pub name: String,
    /// Root mean square distance of bare skin to the body along the normal, over sampled skin points within the last
    /// robust scale [mm]; dT included.
    pub skin_rms_mm: f64,
    /// Share of sampled skin points with the body within the last robust scale [1]: low when a limb was missed.
    pub skin_found_share: f64,
    /// Share of the sampled, covered body vertices that lie inside the cloth, or less than 2 mm outside [1].
    pub inside_share: f64,
    /// Median depth of covered body vertices under the cloth [mm].
    pub cloth_depth_mm: f64,
    /// Gauss-Newton iterations of the joint stage.
    pub iterations: usize,
    /// Largest change of a rotation [rad] or the translation [m] in the last step.
    pub last_step: f64,
}

/// Where one scan's fit starts: a rough pose with a shape of its own.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ScanStart {
    /// The pose.
    pub pose: Pose,
    /// Shape β [1] that goes with it, since people differ in height; shape [shape_coefficients].
    pub shape: Vec<f64>,
}

/// A body under the clothes of all scans.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Registration {
    /// Shape β [1], shared by all scans.
    pub shape: Vec<f64>,
    /// One pose per scan, in the order given.
    pub poses: Vec<Pose>,
    /// Displacements dT of the T-posed surface [m], shape [vertex_count], shared by all scans.
    pub displacement: Vec<Vec3>,
    /// One report per scan, in the order given.
    pub report: Vec<ScanFit>,
}

/// How badly the body fits the points each way up, best first: mean capped squared distance [m²] of a coarse search. Labels do
/// not matter.
///
/// # Errors
/// Those of the body.
pub fn find_up(body: &dyn BodyModel, points: &LabelledPoints) -> Result<Vec<(UpAxis, f64)>> {
    let proxy = start::Proxy::new(body, &[])?;
    let mut found: Vec<(UpAxis, f64)> = UpAxis::ALL
        .par_iter()
        .map(|&up| {
            let turn = |list: &[Vec3]| list.iter().map(|v| up.to_y_up() * v).collect::<Vec<_>>();
            let turned = LabelledPoints {
                points: turn(&points.points),
                normals: turn(&points.normals),
                labels: points.labels.clone(),
            };
            (up, proxy.misfit(&turned, RegistrationSettings::default().start_headings))
        })
        .collect();
    found.sort_by(|a, b| a.1.total_cmp(&b.1));
    Ok(found)
}

/// Where each scan's fit starts, by itself: coarse search, then a short fit from the best poses. `progress` gets values rising
/// from 0 to 1, from any thread.
///
/// # Errors
/// As [`register`].
pub fn find_starts(
    body: &dyn BodyModel,
    scans: &[RegistrationScan],
    settings: &RegistrationSettings,
    progress: &(dyn Fn(f64) + Sync),
) -> Result<Vec<ScanStart>> {
    let prepared = Prepared::new(body, scans, settings)?;
    let problem = prepared.problem(body, settings);
    let shape = vec![0.0; prepared.shape_count];
    let proxy = start::Proxy::new(body, &shape)?;
    let done = std::sync::atomic::AtomicUsize::new(0);
    scans
        .par_iter()
        .zip(&prepared.data)
        .map(|(scan, data)| {
            let candidates =
                proxy.search(scan.points, settings.start_headings, settings.start_trials, scan.start.as_ref());
            let mut best = try_starts(&problem, data, &shape, candidates)?;
            let count = done.fetch_add(1, std::sync::atomic::Ordering::Relaxed) + 1;
            progress(count as f64 / scans.len() as f64);
            Ok(ScanStart { pose: best.poses.swap_remove(0), shape: best.shape })
        })
        .collect()
}

/// Fits one shape and a pose per scan: [`find_starts`], then [`register_from`]. `progress` gets values rising from 0 to 1, from
/// any thread.
///
/// # Errors
/// [`Error::Config`] for settings out of range; [`Error::Length`], [`Error::NonFinite`] or [`Error::Mesh`] for scans
/// and start poses that cannot be used; [`Error::Numerics`] where the equations have no solution; the body's own
/// errors.
pub fn register(
    body: &dyn BodyModel,
    scans: &[RegistrationScan],
    settings: &RegistrationSettings,
    progress: &(dyn Fn(f64) + Sync),
) -> Result<Registration> {
    let starts = find_starts(body, scans, settings, &|s| progress(0.4 * s))?;
    register_from(body, scans, &starts, settings, &|s| progress(0.4 + 0.6 * s))
}

/// What both halves of a registration need.
struct Prepared<'a> {
    shape_count: usize,
    data: Vec<ScanData<'a>>,
    samples: Samples,
    fans: Fans,
    priors: Vec<prior::JointPrior>,
}

impl<'a> Prepared<'a> {
    fn new(body: &dyn BodyModel, scans: &'a [RegistrationScan], settings: &RegistrationSettings) -> Result<Self> {
        settings.check()?;
        let description = body.describe();
        let joint_count = description.joints.len();
        for scan in scans {
            if let Some(pose) = &scan.start {
                Error::check_length(&format!("start pose of scan `{}`", scan.name), joint_count, pose.rotations.len())?;
                for v in pose.rotations.iter().chain([&pose.translation]) {
                    Error::check_finite(&format!("start pose of scan `{}`", scan.name), v.as_slice())?;
                }
            }
        }
        let shape_count = settings.shape_coefficients.min(description.shape_count);
        let (rest, _) = solve::pose_body(body, &vec![0.0; shape_count], &Pose::rest(joint_count), &[])?;
        Ok(Self {
            shape_count,
            data: scans.par_iter().map(|s| solve::prepare(s.name, s.points, settings)).collect::<Result<_>>()?,
            samples: Samples::new(&rest.vertices, settings.sample_vertices),
            fans: Fans::new(description.vertex_count, &description.faces),
            priors: prior::joint_priors(description),
        })
    }
    fn problem<'b>(&'b self, body: &'b dyn BodyModel, settings: &'b RegistrationSettings) -> Problem<'b> {
        Problem { body, settings, priors: &self.priors, samples: &self.samples, fans: &self.fans }
    }
}

/// Fits one shape and a pose per scan from a start for each. `progress` gets values rising from 0 to 1, from any thread.
///
/// # Errors
/// As [`register`]; [`Error::Length`] for starts that are not as many as scans, or of another body.
pub fn register_from(
    body: &dyn BodyModel,
    scans: &[RegistrationScan],
    starts: &[ScanStart],
    settings: &RegistrationSettings,
    progress: &(dyn Fn(f64) + Sync),
) -> Result<Registration> {
    let prepared = Prepared::new(body, scans, settings)?;
    let problem = prepared.problem(body, settings);
    let (shape_count, data) = (prepared.shape_count, &prepared.data);
    Error::check_length("starts of a registration", scans.len(), starts.len())?;
    for (scan, start) in scans.iter().zip(starts) {
        let joints = body.describe().joints.len();
        Error::check_length(&format!("start pose of scan `{}`", scan.name), joints, start.pose.rotations.len())?;
        Error::check_length(&format!("start shape of scan `{}`", scan.name), shape_count, start.shape.len())?;
    }
    let mut state = State {
        shape: vec![0.0; shape_count],
        poses: starts.iter().map(|s| s.pose.clone()).collect(),
        displacement: Vec::new(),
    };
    // People differ in height: the mean of what each start found.
    for start in starts {
        for (s, v) in state.shape.iter_mut().zip(&start.shape) {
            *s += v / starts.len() as f64;
        }
    }
    let all: Vec<&ScanData> = data.iter().collect();
    let mut last = vec![0.0; scans.len()];
    let mut iterations = 0;
    // Two thirds refine from where the trials ended. The last third lets pose, shape and dT come to terms: shape and pose had taken up
    // what dT explains.
    let refining = settings.iterations * 2 / 3;
    let fine = Level::at(settings, 1.0, Group::End, true);
    for i in 0..settings.iterations {
        let level = if i < refining {
            let x = TRIAL_END + (1.0 - TRIAL_END) * i as f64 / refining as f64;
            Level::at(settings, x, Group::End, true)
        } else {
            if i == refining {
                again::look_again(&problem, scans, data, &mut state)?;
            }
            state.displacement = displacement::displace(&problem, &all, &state, &fine)?;
            fine
        };
        last = solve::step(&problem, &all, &mut state, &level)?;
        iterations += 1;
        progress(0.95 * iterations as f64 / settings.iterations as f64);
        let still = i >= refining && last.iter().all(|&step| step < CONVERGED);
        if still && settings.displacement_sigma <= 0.0 {
            break;
        }
    }
    state.displacement = displacement::displace(&problem, &all, &state, &fine)?;
    let report = scans
        .par_iter()
        .zip(data)
        .enumerate()
        .map(|(i, (scan, data))| {
            let fit = displacement::measure(&problem, data, &state, i, &fine)?;
            Ok(ScanFit {
                name: scan.name.to_owned(),
                skin_rms_mm: 1e3 * fit.skin_rms,
                skin_found_share: fit.skin_found_share,
                inside_share: fit.inside_share,
                cloth_depth_mm: 1e3 * fit.cloth_depth,
                iterations,
                last_step: last[i],
            })
        })
        .collect::<Result<_>>()?;
    progress(1.0);
    Ok(Registration { shape: state.shape, poses: state.poses, displacement: state.displacement, report })
}

/// Steps below this [rad or m] are not worth another iteration: 0.3 mm at the end of an arm.
const CONVERGED: f64 = 5e-4;

/// Runs a short fit from every candidate and keeps the cheapest.
fn try_starts(problem: &Problem, scan: &ScanData, shape: &[f64], candidates: Vec<Pose>) -> Result<State> {
    let count = problem.settings.start_iterations;
    let mut best: Option<(f64, State)> = None;
    for pose in candidates {
        let mut state = State { shape: shape.to_vec(), poses: vec![pose], displacement: Vec::new() };
        for i in 0..count {
            let x = TRIAL_END * i as f64 / count as f64;
            let group = if i < 2 { Group::Root } else { Group::End };
            solve::step(problem, &[scan], &mut state, &Level::at(problem.settings, x, group, i >= 4))?;
        }
        let level = Level::at(problem.settings, TRIAL_END, Group::End, true);
        let cost = solve::cost(problem, scan, &state.shape, &state.poses[0], &level)?;
        if best.as_ref().is_none_or(|(b, _)| cost < *b) {
            best = Some((cost, state));
        }
    }
    best.map(|(_, state)| state).ok_or_else(|| {
        Error::numerics(
            format!("registration of scan `{}`", scan.name),
            "no start pose was found",
            "give a start pose for this scan",
        )
    })
}
