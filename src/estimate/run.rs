//! Runs an estimation, keeps its state, writes its results.

use super::config::{EstimateConfig, Method, ReductionChoice, SurroundingsConfig};
use super::{input, report};
use crate::artifact::{self, write_atomically};
use crate::files::ProjectFiles;
use crate::plugins::Plugins;
use crate::progress::Progress;
use caphy_core::material::MaterialModel;
use caphy_core::{Error, Result, Vec3};
use caphy_garment::estimate::alternation::{alternation, between};
use caphy_garment::estimate::equilibrium::{FabricOdds, equilibrium};
use caphy_garment::estimate::{
    AlternationEstimate, EquilibriumEstimate, EquilibriumSettings, FitState, NativeEvidence, Problem, Reduction, cloth,
};
use caphy_materials::MaterialMeasuredSpec;
use caphy_materials::measured::Fabric;
use serde::Serialize;
use std::path::{Path, PathBuf};

/// What was found.
#[derive(Debug, Clone, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Estimated {
    /// By the equilibrium fit.
    Equilibrium(Box<EquilibriumEstimate>),
    /// By the paper's alternation.
    Alternation(Box<AlternationEstimate>),
}

/// Everything that is written to `estimate.json`.
#[derive(Debug, Clone, Serialize)]
pub struct Summary {
    /// The material's type.
    pub material: String,
    /// Names and units of its native parameters.
    pub parameter_names: Vec<[String; 2]>,
    /// Native parameters before.
    pub before: Vec<f64>,
    /// Native parameters after.
    pub after: Vec<f64>,
    /// Area density that was assumed [kg/m²].
    pub density_kg_per_m2: f64,
    /// Whether the cloth was weighed.
    pub weighed: bool,
    /// The estimate with its evidence.
    pub estimate: Estimated,
    /// The ten measured fabrics, nearest first; for a measured material by the equilibrium fit.
    pub nearest: Vec<FabricOdds>,
    /// Drape coefficients, simulated, per Cusick pose.
    pub drape_coefficients: Vec<(String, f64)>,
    /// What the user must know.
    pub warnings: Vec<String>,
    /// The written page.
    #[serde(skip)]
    pub page: PathBuf,
}

/// Estimates what a file asks for, into `out` instead of the file's folder where given. A run that was killed goes on from its
/// last step.
///
/// # Errors
/// Those of the file, of its inputs and of the estimators; [`Error::Io`].
pub fn run(path: &Path, out: Option<&Path>, plugins: &Plugins) -> Result<Summary> {
    let config = EstimateConfig::read(path, plugins)?;
    let files = ProjectFiles::new(path.parent().unwrap_or(Path::new(".")));
    let folder = match out {
        Some(out) => out.to_path_buf(),
        None => files.resolve(&config.out)?,
    };
    let problem = input::problem(&config, &files)?;
    let fabrics = if config.material.table().get("type").and_then(|t| t.as_str()) == Some("measured") {
        ten_fabrics()?
    } else {
        Vec::new()
    };
    if config.reduction == ReductionChoice::Blend && fabrics.is_empty() {
        let remedy = "choose another reduction, or type = \"measured\"";
        return Err(Error::config("reduction", "the ten fabrics can only blend into a measured material", remedy));
    }
    let reduction = match config.reduction {
        ReductionChoice::Blend => Reduction::blend(&*problem.material, &fabrics)?,
        _ => Reduction::multipliers(&*problem.material)?,
    };
    let progress = Progress::start("estimate");
    let mut nearest = Vec::new();
    let estimate = match config.method {
        Method::Alternation => {
            let settings = config.alternation.clone().unwrap_or_default();
            let mut inner = between(&problem, settings.lambda);
            let found = alternation(&problem, &reduction, &settings, &mut inner, &mut |s, m| progress.set(s, m))?;
            Estimated::Alternation(Box::new(found))
        }
        Method::Equilibrium => {
            let settings = config.equilibrium.clone().unwrap_or_default();
            let key = state_key(&config, &problem)?;
            let mut found = fitted(&problem, reduction, &settings, &folder.join("state.caphy"), &key, &progress)?;
            let evidence = NativeEvidence::at(&problem, &found, &settings)?;
            if !fabrics.is_empty() {
                nearest = evidence.odds(&fabrics, settings.mesh_log_sd)?;
            }
            if config.reduction == ReductionChoice::Combinations {
                let better = problem.material.with_parameters(&found.parameters)?;
                let along = Reduction::along(&*better, &evidence.determined(settings.held_above))?;
                let next = Problem { material: better.into(), ..input::problem(&config, &files)? };
                // From here the shapes are near: no springs any more.
                let settings = EquilibriumSettings { continuation: vec![0.0], ..settings };
                let key = format!("{key} combinations");
                found = fitted(&next, along, &settings, &folder.join("state-2.caphy"), &key, &progress)?;
            }
            Estimated::Equilibrium(Box::new(found))
        }
    };
    progress.finish();
    let (after, shapes, warnings) = match &estimate {
        Estimated::Equilibrium(e) => (e.parameters.clone(), &e.shapes, e.warnings.clone()),
        Estimated::Alternation(a) => (a.last.parameters.clone(), &a.shapes, a.last.warnings.clone()),
    };
    let mut drape_coefficients = Vec::new();
    for (pose, shape) in config.pose.iter().zip(shapes) {
        let (Some(SurroundingsConfig::Cusick { table_m }), super::ClothConfig::Disc { diameter_m, .. }) =
            (&pose.on, &config.cloth)
        else {
            continue;
        };
        let shape: Vec<Vec3> = shape.iter().map(|p| Vec3::from(*p)).collect();
        let coefficient = cloth::drape_coefficient(&shape, problem.rest.faces(), 0.5 * diameter_m, 0.5 * table_m)?;
        drape_coefficients.push((pose.name.clone(), coefficient));
    }
    let parameters = problem.material.parameters();
    let page = folder.join("report.html");
    let summary = Summary {
        material: problem.material.describe().name,
        parameter_names: parameters.iter().map(|p| [p.name.clone(), p.unit.clone()]).collect(),
        before: parameters.iter().map(|p| p.value).collect(),
        after,
        density_kg_per_m2: problem.rest.density.0,
        weighed: problem.weighed,
        estimate,
        nearest,
        drape_coefficients,
        warnings,
        page,
    };
    let json = serde_json::to_string_pretty(&summary)
        .map_err(|e| Error::numerics("estimate.json", e.to_string(), "report this as a defect"))?;
    write_atomically(&folder.join("estimate.json"), json.as_bytes())?;
    report::write(&folder, &problem, &summary, &fabrics)?;
    Ok(summary)
}

/// The ten measured fabrics' native parameters.
fn ten_fabrics() -> Result<Vec<(String, Vec<f64>)>> {
    Fabric::names()?
        .into_iter()
        .map(|name| {
            let material = MaterialMeasuredSpec::new(&name).build_measured()?;
            Ok((name, material.parameters().iter().map(|p| p.value).collect()))
        })
        .collect()
}

/// What a state belongs to: the file and the contents of everything that it names.
fn state_key(config: &EstimateConfig, problem: &Problem) -> Result<String> {
    let text =
        toml::to_string(config).map_err(|e| Error::config("(whole file)", e.to_string(), "report this as a defect"))?;
    let mut all = text.into_bytes();
    let mut add = |points: &[Vec3]| points.iter().flatten().for_each(|c| all.extend_from_slice(&c.to_le_bytes()));
    add(&problem.rest.template.vertices);
    for capture in &problem.captures {
        add(&capture.start);
        add(capture.scan.points());
        if let Some(body) = &capture.body {
            add(&body.positions.frame(0, 0));
        }
    }
    Ok(artifact::hash(&all))
}

fn fitted(
    problem: &Problem,
    reduction: Reduction,
    settings: &EquilibriumSettings,
    state: &Path,
    key: &str,
    progress: &Progress,
) -> Result<EquilibriumEstimate> {
    let resume = artifact::load::<FitState>(state, "estimate", key)?.map(|s| s.0);
    if resume.is_some() {
        progress.note("going on from the last step");
    }
    let mut kept = resume.clone();
    equilibrium(problem, reduction, settings, resume, &mut |p| {
        progress.set(p.share, p.message);
        if kept.as_ref() != Some(p.state) && p.share < 0.9 {
            artifact::save(state, "estimate", key, p.state)?;
            kept = Some(p.state.clone());
        }
        Ok(())
    })
}

/// The configured material with other values.
pub(super) fn with_values(problem: &Problem, values: &[f64]) -> Result<Box<dyn MaterialModel>> {
    problem.material.with_parameters(values)
}
