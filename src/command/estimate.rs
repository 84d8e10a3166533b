//! `caphy estimate`

use super::json;
use caphy::estimate::{self, Estimated};
use caphy::plugins::Plugins;
use caphy_core::Result;
use std::path::PathBuf;
use std::process::ExitCode;

pub(crate) const EXAMPLES: &str = "Examples:
  caphy estimate swatch.toml
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
    /// The estimation's TOML file.
    config: PathBuf,
    /// Folder of the results, instead of the file's `out`.
    #[arg(long)]
    out: Option<PathBuf>,
    /// Print everything as JSON.
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(arguments: &Arguments, plugins: &Plugins) -> Result<ExitCode> {
    let summary = estimate::run(&arguments.config, arguments.out.as_deref(), plugins)?;
    if arguments.json {
        println!("{}", json(&summary)?);
        return Ok(ExitCode::SUCCESS);
    }
    match &summary.estimate {
        Estimated::Equilibrium(e) => {
            for u in &e.unknowns {
                let note = if u.held_by_prior { "  held by the prior" } else { "" };
                println!("{:24} × {:7.3}  [{:.3}, {:.3}]{note}", u.name, u.multiplier, u.interval[0], u.interval[1]);
            }
        }
        Estimated::Alternation(a) => {
            for g in &a.last.groups {
                println!("{:24} × {:7.3}{}", g.name, g.multiplier, if g.excited { "" } else { "  not excited" });
            }
        }
    }
    if let Some(first) = summary.nearest.first() {
        println!("nearest of the ten: {} ({:.0} %)", first.name, 100.0 * first.probability);
    }
    for (pose, coefficient) in &summary.drape_coefficients {
        println!("drape coefficient of {pose}, simulated: {coefficient:.3}");
    }
    for warning in &summary.warnings {
        println!("note: {warning}");
    }
    println!("Report: {}", summary.page.display());
    Ok(ExitCode::SUCCESS)
}
