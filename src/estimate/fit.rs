//! One cloth's fabric from its poses, by the estimator that was asked for; a fit that was killed goes on from its last step.

use super::config::ReductionChoice;
use super::found::{Estimated, FabricFound};
use crate::artifact;
use caphy_core::material::MaterialModel;
use caphy_core::{Error, Result};
use caphy_garment::estimate::alternation::{alternation, between};
use caphy_garment::estimate::equilibrium::equilibrium;
use caphy_garment::estimate::{
    AlternationSettings, EquilibriumEstimate, EquilibriumSettings, FitState, NativeEvidence, Problem, Reduction,
};
use caphy_materials::MaterialMeasuredSpec;
use caphy_materials::measured::Fabric;
use std::path::{Path, PathBuf};

/// How a fabric is looked for.
#[derive(Debug, Clone)]
pub enum How {
    /// Simulated equilibria are fitted to the scans.
    Equilibrium(EquilibriumSettings),
    /// Shapes between physics and scan by the reference solver, then Eq. 10, repeated.
    Alternation(AlternationSettings),
}

/// Where a fit keeps its state, and what that belongs to.
pub struct Kept<'a> {
    /// Folder of its files.
    pub folder: &'a Path,
    /// Beginning of their names.
    pub name: &'a str,
    /// A state of another key is not continued.
    pub key: &'a str,
}

impl Kept<'_> {
    fn file(&self, number: usize) -> PathBuf {
        self.folder.join(if number == 1 {
            format!("{}.caphy", self.name)
        } else {
            format!("{}-{number}.caphy", self.name)
        })
    }
}

/// Name of each of the ten measured fabrics with its native parameters.
///
/// # Errors
/// Those of the fabrics' tables.
pub fn ten_fabrics() -> Result<Vec<(String, Vec<f64>)>> {
    Fabric::names()?
        .into_iter()
        .map(|name| {
            let material = MaterialMeasuredSpec::new(&name).build_measured()?;
            Ok((name, material.parameters().iter().map(|p| p.value).collect()))
        })
        .collect()
}

/// Finds the fabric of a problem. `fabrics`: known ones of the same material, to name the nearest and to blend; none for other
/// materials. `progress` hears the share done and a word on it; `note` hears what stays.
///
/// # Errors
/// As the estimators; [`Error::Config`] for a reduction that the estimator or the material has not; [`Error::Io`] of the state.
pub fn fit(
    problem: &Problem,
    how: &How,
    choice: ReductionChoice,
    fabrics: &[(String, Vec<f64>)],
    kept: &Kept<'_>,
    progress: &dyn Fn(f64, &str),
    note: &dyn Fn(&str),
) -> Result<FabricFound> {
    if choice == ReductionChoice::Blend && fabrics.is_empty() {
        let remedy = "choose another reduction, or type = \"measured\"";
        return Err(Error::config("reduction", "the ten fabrics can only blend into a measured material", remedy));
    }
    let reduction = match choice {
        ReductionChoice::Blend => Reduction::blend(&*problem.material, fabrics)?,
        _ => Reduction::multipliers(&*problem.material)?,
    };
    let settings = match how {
        How::Alternation(settings) => {
            let mut inner = between(problem, settings.lambda);
            let found = alternation(problem, &reduction, settings, &mut inner, &mut |s, m| progress(s, m))?;
            return Ok(FabricFound::new(problem, Estimated::Alternation(Box::new(found)), Vec::new()));
        }
        How::Equilibrium(settings) => settings,
    };
    let mut found = fitted(problem, reduction, settings, &kept.file(1), kept.key, progress, note)?;
    let evidence = NativeEvidence::at(problem, &found, settings)?;
    let nearest = if fabrics.is_empty() { Vec::new() } else { evidence.odds(fabrics, settings.mesh_log_sd)? };
    if choice == ReductionChoice::Combinations {
        let better = problem.material.with_parameters(&found.parameters)?;
        let along = Reduction::along(&*better, &evidence.determined(settings.held_above))?;
        let next = Problem { material: better.into(), ..problem.clone() };
        // From here the shapes are near: no springs any more.
        let settings = EquilibriumSettings { continuation: vec![0.0], ..settings.clone() };
        let key = format!("{} combinations", kept.key);
        found = fitted(&next, along, &settings, &kept.file(2), &key, progress, note)?;
    }
    Ok(FabricFound::new(problem, Estimated::Equilibrium(Box::new(found)), nearest))
}

fn fitted(
    problem: &Problem,
    reduction: Reduction,
    settings: &EquilibriumSettings,
    state: &Path,
    key: &str,
    progress: &dyn Fn(f64, &str),
    note: &dyn Fn(&str),
) -> Result<EquilibriumEstimate> {
    let resume = artifact::load::<FitState>(state, "estimate", key)?.map(|s| s.0);
    if resume.is_some() {
        note("going on from the last step");
    }
    let mut kept = resume.clone();
    equilibrium(problem, reduction, settings, resume, &mut |p| {
        progress(p.share, p.message);
        if kept.as_ref() != Some(p.state) && p.share < 0.9 {
            artifact::save(state, "estimate", key, p.state)?;
            kept = Some(p.state.clone());
        }
        Ok(())
    })
}
