//! `caphy ablation`

use super::json;
use caphy::ablation::Ablation;
use caphy::files::shown;
use caphy::plugins::Plugins;
use caphy_core::Result;
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Instant;

pub(crate) const EXAMPLES: &str = "Example:
  caphy ablation configs/ablation.toml

The file names an experiment, seeds, and variants, each a name and a list of settings as `caphy run --set` takes them. Every variant has
a run folder of its own, OUT/seed-N/NAME; scans and templates are made once per seed. Killed or changed, it goes on from what is done.
OUT/report.html has the table and pictures, OUT/ablation.json every value of every scan.";

#[derive(clap::Args)]
pub(crate) struct Arguments {
    /// The ablation's TOML file.
    config: PathBuf,
    /// Folder of the results, instead of the file's `out`.
    #[arg(long)]
    out: Option<PathBuf>,
    /// The table as JSON.
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(arguments: &Arguments, plugins: &Plugins) -> Result<ExitCode> {
    let started = Instant::now();
    let ablation = Ablation::open(&arguments.config, arguments.out.clone(), plugins)?;
    let ended = ablation.run(plugins, &|what| note!("{what}"))?;
    if arguments.json {
        say!("{}", json(&ended.table)?)?;
        return Ok(ExitCode::SUCCESS);
    }
    tell!("{}", ended.table.text())?;
    if ended.ran.is_empty() {
        say!("Nothing to do: every run was up to date.")?;
    } else {
        say!("Ran {} in {:.0} s.", ended.ran.join(", "), started.elapsed().as_secs_f64())?;
    }
    say!("Report: {}", shown(&ended.folder.join("report.html")).display())?;
    Ok(ExitCode::SUCCESS)
}
