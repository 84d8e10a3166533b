//! Runs an estimation from a file, writes its results.

use super::config::{EstimateConfig, Method, SurroundingsConfig};
use super::fit::{How, Kept, fit, ten_fabrics};
use super::found::FabricFound;
use super::{input, report};
use crate::artifact::{self, write_atomically};
use crate::files::ProjectFiles;
use crate::plugins::Plugins;
use crate::progress::Progress;
use caphy_core::{Error, Result, Vec3};
use caphy_garment::estimate::{Problem, cloth};
use serde::Serialize;
use std::path::{Path, PathBuf};

/// Everything that is written to `estimate.json`.
#[derive(Debug, Clone, Serialize)]
pub struct Summary {
    /// What was found.
    #[serde(flatten)]
    pub fabric: FabricFound,
    /// Drape coefficients, simulated, per Cusick pose.
    pub drape_coefficients: Vec<(String, f64)>,
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
    let fabrics = if config.material.is_measured() { ten_fabrics()? } else { Vec::new() };
    let how = match config.method {
        Method::Alternation => How::Alternation(config.alternation.clone().unwrap_or_default()),
        Method::Equilibrium => How::Equilibrium(config.equilibrium.clone().unwrap_or_default()),
    };
    let key = state_key(&config, &problem)?;
    let kept = Kept { folder: &folder, name: "state", key: &key };
    let progress = Progress::start("estimate");
    let (set, note) = (|s: f64, m: &str| progress.set(s, m), |line: &str| progress.note(line));
    let fabric = fit(&problem, &how, config.reduction, &fabrics, &kept, &set, &note)?;
    progress.finish();
    let mut drape_coefficients = Vec::new();
    for (pose, shape) in config.pose.iter().zip(fabric.shapes()) {
        let (Some(SurroundingsConfig::Cusick { table_m }), super::ClothConfig::Disc { diameter_m, .. }) =
            (&pose.on, &config.cloth)
        else {
            continue;
        };
        let coefficient = cloth::drape_coefficient(&shape, problem.rest.faces(), 0.5 * diameter_m, 0.5 * table_m)?;
        drape_coefficients.push((pose.name.clone(), coefficient));
    }
    let summary = Summary { fabric, drape_coefficients, page: folder.join("report.html") };
    let json = serde_json::to_string_pretty(&summary)
        .map_err(|e| Error::numerics("estimate.json", e.to_string(), "report this as a defect"))?;
    write_atomically(&folder.join("estimate.json"), json.as_bytes())?;
    report::write(&summary.page, &problem, &summary.fabric, &summary.drape_coefficients, &fabrics)?;
    Ok(summary)
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
