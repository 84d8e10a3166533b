//! `caphy estimate`

use super::json;
use caphy::estimate;
use caphy::plugins::Plugins;
use caphy::runner::Run;
use caphy_core::Result;
use std::path::PathBuf;
use std::process::ExitCode;

pub(crate) const EXAMPLES: &str = "Examples:
  caphy estimate subject.toml                  # an experiment: the garments of its scans, trained first where they are not yet
  caphy estimate swatch.toml                   # a cloth given by files
  caphy estimate swatch.toml --out fitted --json

swatch.toml:
  out = \"fitted\"
  cloth = { type = \"rectangle\", size_m = [0.3, 0.3], edge_m = 0.015, mass_g = 16.2 }
  material = { type = \"measured\", fabric = \"gray-interlock\" }
  [[pose]]
  name = \"sticks out\"
  scan = \"sticks-out.ply\"
  start = \"sticks-out-start.obj\"
  clamps = [{ normal = [-1.0, 0.0, 0.0], offset_m = -0.15 }]

The fabric whose simulated equilibria lie nearest to the scans, with intervals, what the poses determine, and pictures in report.html.
Run again after it was killed, it goes on from its last step.";

#[derive(clap::Args)]
pub(crate) struct Arguments {
    /// The TOML file of an estimation or of an experiment; the latter's `[optimise]` says how.
    config: PathBuf,
    /// Folder of the results, instead of the file's `out`.
    #[arg(long)]
    out: Option<PathBuf>,
    /// Print everything as JSON.
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(arguments: &Arguments, plugins: &mut Plugins) -> Result<ExitCode> {
    if estimate::is_experiment(&arguments.config)? {
        let run = Run::open_with(&arguments.config, arguments.out.clone(), plugins)?.only("optimise")?;
        let summary = run.all()?;
        if arguments.json {
            say!("{}", json(&summary.fabrics)?)?;
            return Ok(ExitCode::SUCCESS);
        }
        tell!("{}", summary.table)?;
        for page in summary.fabrics.iter().flat_map(|f| &f.garments).map(|g| summary.folder.join(&g.page)) {
            say!("Report: {}", page.display())?;
        }
        return Ok(ExitCode::SUCCESS);
    }
    let summary = estimate::run(&arguments.config, arguments.out.as_deref(), plugins)?;
    if arguments.json {
        say!("{}", json(&summary)?)?;
        return Ok(ExitCode::SUCCESS);
    }
    for f in summary.fabric.estimate.factors() {
        let interval = f.interval.map(|[low, high]| format!("  [{low:.3}, {high:.3}]")).unwrap_or_default();
        say!("{:24} × {:7.3}{interval}  {}", f.name, f.factor, f.note)?;
    }
    if let Some(first) = summary.fabric.nearest.first() {
        say!("nearest of the ten: {} ({:.0} %)", first.name, 100.0 * first.probability)?;
    }
    for (pose, coefficient) in &summary.drape_coefficients {
        say!("drape coefficient of {pose}, simulated: {coefficient:.3}")?;
    }
    for warning in summary.fabric.estimate.warnings() {
        say!("note: {warning}")?;
    }
    say!("Report: {}", summary.page.display())?;
    Ok(ExitCode::SUCCESS)
}
