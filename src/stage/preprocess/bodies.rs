//! One body under the clothes of all scans: an artifact of its own, so that templates can be chosen again without it.

use super::LabelledScan;
use crate::artifact;
use crate::fixed_shape::FixedShape;
use crate::stage::{Context, ScanFile};
use caphy_bodymodel::registration::{
    RegistrationScan, RegistrationSettings, ScanFit, ScanStart, register, register_from,
};
use caphy_core::body::{BodyModel, BodyParameters};
use caphy_core::pose::Pose;
use caphy_core::query::NearestGrid;
use caphy_core::scan::LabelledPoints;
use caphy_core::{Error, Result, Vec3};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Its file in the run directory, and the stage in its header.
pub(crate) const FILE: &str = "bodies.caphy";
const STAGE: &str = "bodies";
/// Distance from the body at which a scan point is not this person [m]: beyond wide sleeves and long hair.
const STRANGE: f64 = 0.15;
/// Share of such points with which a scan is left out, and with which it is mentioned.
const STRANGE_SHARES: (f64, f64) = (0.2, 0.02);
/// Share of bare skin with the body near below which a scan is mentioned: hair and holes are less, a forearm is more.
const FOUND: f64 = 0.9;

/// Body shape and poses of a subject.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(super) struct Bodies {
    /// Shape β and displacements dT [m]; `None` without a scan to learn from.
    pub(super) shape: Option<(Vec<f64>, Vec<Vec3>)>,
    /// One per labelled scan, in their order; `None` where there was no shape to fit it with.
    pub(super) scans: Vec<Option<FittedScan>>,
}

/// One scan with the body in it.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(super) struct FittedScan {
    pub(super) pose: Pose,
    pub(super) fit: ScanFit,
    /// Share of its points far from the body [1].
    pub(super) strange_share: f64,
}

impl FittedScan {
    /// Whether too much of it is no part of this person.
    pub(super) fn is_strange(&self) -> bool {
        self.strange_share > STRANGE_SHARES.0
    }
    /// Why such a scan is left out.
    pub(super) fn strange(&self, name: &str) -> Error {
        let problem =
            format!("{:.0} % of its points are more than {STRANGE} m from the fitted body", 100.0 * self.strange_share);
        let remedy =
            "is it one person, whole, without floor and backdrop? Perhaps `subject.starts` or `subject.up` helps";
        Error::mesh(name, "points", problem, remedy)
    }
    /// What is to be looked at.
    pub(super) fn notes(&self) -> Vec<String> {
        let mut notes = Vec::new();
        if self.strange_share > STRANGE_SHARES.1 {
            notes.push(format!("has {:.0} % of its points far from the body", 100.0 * self.strange_share));
        }
        if self.fit.skin_found_share < FOUND {
            notes.push(format!(
                "has skin without the body near, {:.0} % of it: look at it in pictures/scans.png; if a limb is wrong, give its pose in \
                 `subject.starts`",
                100.0 * (1.0 - self.fit.skin_found_share)
            ));
        }
        notes
    }
}

/// The body in all scans, from its artifact when nothing has changed; progress goes from the one share to the other.
pub(super) fn fitted(
    context: &Context<'_>,
    body: &dyn BodyModel,
    labelled: &[(&ScanFile, LabelledScan)],
    shares: [f64; 2],
) -> Result<Bodies> {
    // Each scan's key knows the body and all settings of registration.
    let scans: Vec<(&str, bool, &str)> =
        labelled.iter().map(|(file, scan)| (&*file.name, file.held_out, &*scan.key)).collect();
    let key = artifact::hash(format!("{scans:?}").as_bytes());
    let path = context.folder.join(FILE);
    // A damaged artifact is made anew: it is only a shortcut.
    if let Ok(Some((bodies, _))) = artifact::load::<Bodies>(&path, STAGE, &key) {
        return Ok(bodies);
    }
    let bodies = fit(context, body, labelled, shares)?;
    artifact::save(&path, STAGE, &key, &bodies)?;
    Ok(bodies)
}

/// Fits shape and poses to all scans; those whose points are not explained, and held-out ones, which get a pose, have no say in the shape.
fn fit(
    context: &Context<'_>,
    body: &dyn BodyModel,
    labelled: &[(&ScanFile, LabelledScan)],
    [from, to]: [f64; 2],
) -> Result<Bodies> {
    let (config, progress) = (context.config, context.progress);
    let mut scans: Vec<Option<FittedScan>> = vec![None; labelled.len()];
    loop {
        let used: Vec<usize> =
            (0..labelled.len()).filter(|&i| !scans[i].as_ref().is_some_and(FittedScan::is_strange)).collect();
        let (held, training): (Vec<usize>, Vec<usize>) = used.iter().partition(|&&i| labelled[i].0.held_out);
        if training.is_empty() {
            return Ok(Bodies { shape: None, scans });
        }
        let as_scan =
            |i: usize| RegistrationScan { name: &labelled[i].0.name, points: &labelled[i].1.points, start: None };
        let inputs: Vec<RegistrationScan<'_>> = training.iter().map(|&i| as_scan(i)).collect();
        let starts: Vec<ScanStart> = training.iter().map(|&i| labelled[i].1.start.clone()).collect();
        let share = training.len() as f64 / used.len() as f64;
        let fit = register_from(body, &inputs, &starts, &config.registration, &|s| {
            progress.set(from + (to - from) * share * s, "body under the clothes");
        })?;
        let mut subject_body = body.rest(&fit.shape);
        subject_body.displacement = fit.displacement.clone();
        let fixed = FixedShape::new(body, &subject_body)?;
        let settings = RegistrationSettings { displacement_sigma: 0.0, ..config.registration.clone() };
        let alone: Vec<(Pose, ScanFit)> = held
            .par_iter()
            .map(|&i| {
                // The start found before went with a shape of its own: with the subject's it is searched for again.
                let scan = RegistrationScan { start: labelled[i].1.given.clone(), ..as_scan(i) };
                let mut fit = register(&fixed, &[scan], &settings, &|_| ())?;
                Ok((fit.poses.swap_remove(0), fit.report.swap_remove(0)))
            })
            .collect::<Result<_>>()?;
        let found = training.iter().chain(&held).zip(fit.poses.into_iter().zip(fit.report).chain(alone));
        let mut strange = false;
        for (&i, (pose, report)) in found {
            let strange_share = strange_share(body, &subject_body, &pose, &labelled[i].1.points)?;
            let fitted = FittedScan { pose, fit: report, strange_share };
            strange |= fitted.is_strange();
            scans[i] = Some(fitted);
        }
        if !strange {
            return Ok(Bodies { shape: Some((fit.shape, fit.displacement)), scans });
        }
        // They have pulled at the shape: it is found again without them.
    }
}

/// Share of scan points far from the posed body.
fn strange_share(body: &dyn BodyModel, subject: &BodyParameters, pose: &Pose, points: &LabelledPoints) -> Result<f64> {
    let grid = NearestGrid::from_points(&body.forward(&subject.posed(pose))?.vertices);
    let far = |p: &&Vec3| grid.nearest_within(&[p.x, p.y, p.z], STRANGE * STRANGE).is_none();
    Ok(points.points.iter().filter(far).count() as f64 / points.points.len().max(1) as f64)
}
