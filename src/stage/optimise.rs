//! Fabrics of the garments from their scans (Sec. 3.4): by simulated equilibria, or by the paper's alternation.

use super::preprocess::Subject;
use super::train::{Nets, config_key};
use super::{Context, Scans, StageOutput, material};
use crate::config::{EstimatorConfig, Inner, WornAlternation};
use crate::estimate::report::{self, drawn};
use crate::estimate::worn::{Wardrobe, attached};
use crate::estimate::{Estimated, FabricFound, How, Kept, ReductionChoice, fit, ten_fabrics};
use crate::pictures;
use caphy_core::material::MaterialModel;
use caphy_core::{Error, Result};
use caphy_garment::estimate::{Problem, Reduction, ShapeBalance};
use caphy_garment::solver::SolverSettings;
use caphy_garment::template::GarmentKind;
use serde::{Deserialize, Serialize};
use std::fmt::Write;
use std::path::PathBuf;
use std::sync::Arc;

/// Estimates of all garments.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Estimates {
    /// One per garment of the subject, in its order.
    pub garments: Vec<GarmentFabric>,
}

impl StageOutput for Estimates {
    fn files(&self) -> Vec<PathBuf> {
        let of =
            |g: &GarmentFabric| g.picture.iter().map(|p| p.file.clone()).chain([g.page.clone()]).collect::<Vec<_>>();
        self.garments.iter().flat_map(of).collect()
    }
}

/// The estimate of one garment's fabric.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct GarmentFabric {
    /// Upper or lower.
    pub kind: GarmentKind,
    /// What was found.
    pub fabric: FabricFound,
    /// Simulated garments over their scans, where the estimator makes any.
    pub picture: Option<FitPicture>,
    /// A page of its own, relative to the run directory.
    pub page: PathBuf,
}

impl Estimates {
    /// The factors as text.
    pub fn table(&self) -> String {
        let mut out = String::new();
        for GarmentFabric { kind, fabric, .. } in &self.garments {
            for f in fabric.estimate.factors() {
                let interval = f.interval.map(|[a, b]| format!("  [{a:.3}, {b:.3}]")).unwrap_or_default();
                // Writing to a String cannot fail.
                let _ = writeln!(out, "{kind} {:24} × {:.3}{interval}  {}", f.name, f.factor, f.note);
            }
            if let Some(first) = fabric.nearest.first() {
                let _ = writeln!(out, "{kind} nearest of the ten: {} ({:.0} %)", first.name, 100.0 * first.probability);
            }
        }
        out
    }
}

/// Simulated garments over their scans.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct FitPicture {
    /// Relative to the run directory.
    pub file: PathBuf,
    /// Distance that takes the last colour [m].
    pub last_colour_m: f64,
}

/// Finds every garment's fabric in the training scans' poses.
pub fn run(context: &Context<'_>, subject: &Subject, nets: &Nets, scans: &Scans) -> Result<Estimates> {
    let estimator = &context.config.optimise.estimator;
    let most = match estimator {
        EstimatorConfig::Equilibrium(e) => e.scans,
        EstimatorConfig::Alternation(_) => usize::MAX,
    };
    let wardrobe = Wardrobe::new(context, subject, nets, scans, most)?;
    let mut garments = Vec::new();
    for (index, (fitted, trained)) in subject.garments.iter().zip(&nets.garments).enumerate() {
        let kind = fitted.kind;
        let set = |s: f64, m: &str| {
            context.progress.set((index as f64 + s) / subject.garments.len() as f64, &format!("{kind}: {m}"));
        };
        let note = |line: &str| context.progress.note(&format!("{kind}: {line}"));
        set(0.0, "");
        let table = &context.config.garment(kind)?.material;
        let start: Arc<dyn MaterialModel> = Arc::from(material(table, config_key(kind), trained.material.as_deref())?);
        let name = format!("checkpoint-{}-{kind}", context.stage);
        let kept = Kept { folder: context.folder, name: &name, key: context.key };
        let fabrics = if table.is_measured() { ten_fabrics()? } else { Vec::new() };
        let simulated = |how: How, choice: ReductionChoice, solver: SolverSettings| -> Result<(FabricFound, Problem)> {
            let problem = attached(wardrobe.problem(index, start.clone(), solver, true)?)?;
            let found = match fit(&problem, &how, choice, &fabrics, &kept, &set, &note) {
                // A fit that comes to nothing must not end the run.
                Err(Error::Numerics { what, problem: why, remedy }) => {
                    let parameters = start.parameters().iter().map(|p| p.value).collect();
                    let warnings =
                        vec![format!("the fabric was not found and stays as it was: {what}: {why}; {remedy}")];
                    FabricFound::new(&problem, Estimated::Kept { parameters, warnings }, Vec::new())
                }
                found => found?,
            };
            Ok((found, problem))
        };
        let (fabric, problem) = match estimator {
            EstimatorConfig::Equilibrium(e) => {
                let (found, problem) = simulated(How::Equilibrium(e.fit.clone()), e.reduction, e.solver)?;
                (trusted(found, e.largest_misfit), problem)
            }
            EstimatorConfig::Alternation(a) => match a.inner {
                Inner::Solver => simulated(How::Alternation(a.settings()), ReductionChoice::Multipliers, a.solver)?,
                Inner::Net => {
                    let problem = wardrobe.problem(index, start, a.solver, false)?;
                    (by_net(&problem, &wardrobe, index, a)?, problem)
                }
            },
        };
        fabric.estimate.warnings().iter().for_each(|warning| note(warning));
        let shapes = fabric.shapes();
        let picture = if shapes.is_empty() {
            None
        } else {
            let (pictures, last_colour_m) = drawn(&problem, &shapes)?;
            let file = PathBuf::from(format!("pictures/{}-{kind}.png", context.stage));
            context.write(&file.to_string_lossy(), &pictures::sheet(&pictures, 4)?)?;
            Some(FitPicture { file, last_colour_m })
        };
        let page = PathBuf::from(format!("{}-{kind}.html", context.stage));
        report::write(&context.folder.join(&page), &problem, &fabric, &[], &fabrics)?;
        garments.push(GarmentFabric { kind, fabric, picture, page });
    }
    if garments.is_empty() {
        return Err(Error::Length { what: "garments".into(), expected: 1, got: 0 });
    }
    Ok(Estimates { garments })
}

/// The same with the values at the start where poses fit worse than `largest` times the noise.
fn trusted(mut found: FabricFound, largest: f64) -> FabricFound {
    let Estimated::Equilibrium(e) = &mut found.estimate else { return found };
    let misfit = e.misfit();
    if misfit > largest {
        e.warnings.insert(
            0,
            format!(
                "not used: the poses fit {misfit:.1} times worse than noise (limit {largest}), so that the values make up for an error \
                 of body or cut; the fabric stays as it was"
            ),
        );
        found.after.clone_from(&found.before);
    }
    found
}

/// One solve of Eq. 10 with the nets' garments held: the paper's step between two trainings.
fn by_net(
    problem: &Problem,
    wardrobe: &Wardrobe<'_>,
    garment: usize,
    settings: &WornAlternation,
) -> Result<FabricFound> {
    let reduction = Reduction::multipliers(&*problem.material)?;
    let balance = ShapeBalance::of(problem, settings.gradient, settings.contact_slack_m);
    let ones = vec![1.0; reduction.len()];
    let shapes = wardrobe.shapes(garment);
    let found = balance.estimate(&*problem.material, &reduction, &ones, shapes, &settings.force_balance)?;
    Ok(FabricFound::new(problem, Estimated::Net(Box::new(found)), Vec::new()))
}
