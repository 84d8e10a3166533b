//! `caphy tradeoff`

use super::json;
use caphy::files::shown;
use caphy::plugins::Plugins;
use caphy::tradeoff::Tradeoff;
use caphy_core::Result;
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Instant;

pub(crate) const EXAMPLES: &str = "Examples:
  caphy tradeoff configs/quickstart.toml
  caphy tradeoff configs/walker.toml --out trade --json

Turns every knob of an experiment by itself and then together, and measures what each point costs and how far it is from the
reference solver on motion that training does not see. Trainings are short unless --full is given; `[tradeoff]` in the file says
which knobs, which motion, how many seeds. Killed or changed, it goes on from what is done. OUT/report.html has plots and tables;
`[budget] front = \"OUT/tradeoff.json\"` in an experiment picks a point.";

#[derive(clap::Args)]
pub(crate) struct Arguments {
    /// The experiment's TOML file.
    config: PathBuf,
    /// Folder of the results. Default: the file's `run.out` with `-tradeoff` behind it.
    #[arg(long)]
    out: Option<PathBuf>,
    /// Train as long as the experiment says.
    #[arg(long)]
    full: bool,
    /// Everything that was measured as JSON.
    #[arg(long)]
    json: bool,
    /// Also write a page of documentation, with its figures and its front in a folder beside it.
    #[arg(long, value_name = "PAGE.md")]
    docs: Option<PathBuf>,
}

pub(crate) fn run(arguments: &Arguments, plugins: &Plugins) -> Result<ExitCode> {
    let started = Instant::now();
    let sweep = Tradeoff::open(&arguments.config, arguments.out.clone(), arguments.full, plugins)?;
    let ended = sweep.run(plugins, &|what| note!("{what}"))?;
    if let Some(page) = &arguments.docs {
        Tradeoff::document(&ended.results, page)?;
    }
    if arguments.json {
        say!("{}", json(&ended.results)?)?;
        return Ok(ExitCode::SUCCESS);
    }
    tell!("{}", ended.results.text())?;
    match ended.computed {
        0 => say!("Nothing to do: every point was measured.")?,
        count => say!("Measured {count} points in {:.0} s.", started.elapsed().as_secs_f64())?,
    }
    say!("Report: {}", shown(&ended.folder.join("report.html")).display())?;
    Ok(ExitCode::SUCCESS)
}
