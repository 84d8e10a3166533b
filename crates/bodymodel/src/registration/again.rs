//! A second look at scans whose limbs were missed: an arm beside the trunk is easily taken for cloth, and a forearm that starts on the
//! wrong side of the elbow never comes back.
//!
//! The coarse search did not know the person's shape and had every limb to find at once. Now all but one limb stand: each is turned
//! through its table by itself, and what explains the scan best goes from coarse to fine with the shape held.

use super::RegistrationScan;
use super::displacement::measure;
use super::prior::Group;
use super::solve::{Level, Problem, ScanData, State, TRIAL_END, cost, step};
use super::start::Proxy;
use caphy_core::Result;
use caphy_core::pose::Pose;
use rayon::prelude::*;

/// Share of skin points with a body near from which on nothing is missing [1]: a hand is 3 % of a body's skin, but 10 % of what
/// shirt and trousers leave bare; holes and hair are less.
const ENOUGH: f64 = 0.95;
/// Poses per limb that are tried to the end.
const PER_LIMB: usize = 3;

/// Fits the scans with too little skin on the body again, limb by limb, and keeps what explains them better.
pub(super) fn look_again(
    problem: &Problem,
    scans: &[RegistrationScan],
    data: &[ScanData],
    state: &mut State,
) -> Result<()> {
    let fine = Level::at(problem.settings, 1.0, Group::End, false);
    let proxy = Proxy::new(problem.body, &state.shape)?;
    let better: Vec<Option<Pose>> = (0..scans.len())
        .into_par_iter()
        .map(|i| {
            let enough = |state: &State, which| -> Result<bool> {
                Ok(measure(problem, &data[i], state, which, &fine)?.skin_found_share >= ENOUGH)
            };
            if enough(state, i)? {
                return Ok(None);
            }
            let mut least = cost(problem, &data[i], &state.shape, &state.poses[i], &fine)?;
            let mut best = None;
            for pose in proxy.other_limbs(scans[i].points, &state.poses[i], PER_LIMB) {
                let trial = refine(problem, &data[i], &state.shape, pose)?;
                let cost = cost(problem, &data[i], &state.shape, &trial.poses[0], &fine)?;
                if cost < least {
                    let found = enough(&trial, 0)?;
                    (least, best) = (cost, trial.poses.into_iter().next());
                    if found {
                        break;
                    }
                }
            }
            Ok(best)
        })
        .collect::<Result<_>>()?;
    for (slot, pose) in state.poses.iter_mut().zip(better) {
        if let Some(pose) = pose {
            *slot = pose;
        }
    }
    Ok(())
}

/// A pose from coarse to fine, as the first fit went, with the shape held.
fn refine(problem: &Problem, scan: &ScanData, shape: &[f64], pose: Pose) -> Result<State> {
    let mut state = State { shape: shape.to_vec(), poses: vec![pose], displacement: Vec::new() };
    let (trial, rest) = (problem.settings.start_iterations, problem.settings.iterations * 2 / 3);
    let coarse = (0..trial).map(|i| TRIAL_END * i as f64 / trial as f64);
    let fine = (0..rest).map(|i| TRIAL_END + (1.0 - TRIAL_END) * (i + 1) as f64 / rest as f64);
    for x in coarse.chain(fine) {
        step(problem, &[scan], &mut state, &Level::at(problem.settings, x, Group::End, false))?;
    }
    Ok(state)
}
