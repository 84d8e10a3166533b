//! `caphy run`

use super::json;
use caphy::plugins::Plugins;
use caphy::runner::Run;
use caphy_core::Result;
use std::path::PathBuf;
use std::process::ExitCode;

pub(crate) const EXAMPLES: &str = "Examples:
  caphy run configs/quickstart.toml
  caphy run configs/walker.toml --plan
  caphy run configs/walker.toml --only train";

#[derive(clap::Args)]
pub(crate) struct Arguments {
    /// The experiment's TOML file.
    config: PathBuf,
    /// Folder of the results, instead of the file's `run.out`.
    #[arg(long)]
    out: Option<PathBuf>,
    /// Run this stage and what it needs, nothing else.
    #[arg(long, value_name = "STAGE")]
    only: Option<String>,
    /// Say what would be run, and what the scene needs of body, net and energies; run nothing.
    #[arg(long)]
    plan: bool,
    /// Say where the time of training steps goes.
    #[arg(long)]
    profile: bool,
    /// With --plan: the plan as JSON.
    #[arg(long, requires = "plan")]
    json: bool,
}

pub(crate) fn run(arguments: &Arguments, plugins: &mut Plugins) -> Result<ExitCode> {
    let mut run = Run::open_with(&arguments.config, arguments.out.clone(), plugins)?;
    if let Some(stage) = &arguments.only {
        run = run.only(stage)?;
    }
    if arguments.plan {
        let plan = run.plan()?;
        if arguments.json {
            println!("{}", json(&plan)?);
        } else {
            print!("{}", plan.text());
        }
        return Ok(ExitCode::SUCCESS);
    }
    if arguments.profile {
        run = run.profiled();
    }
    let started = std::time::Instant::now();
    let summary = run.all()?;
    print!("{}", summary.table);
    if arguments.profile {
        for (part, ms) in &summary.profile {
            println!("{ms:9.2} ms  {}", part.trim_end_matches(", ms"));
        }
    }
    if summary.ran.is_empty() {
        println!("Nothing to do: every stage was up to date.");
    } else {
        println!("Ran {} in {:.0} s.", summary.ran.join(", "), started.elapsed().as_secs_f64());
    }
    if let Some(report) = &summary.report {
        println!("Report: {}", report.display());
    }
    Ok(ExitCode::SUCCESS)
}
