//! `caphy run`

use super::json;
use caphy::config::Setting;
use caphy::files::shown;
use caphy::plugins::Plugins;
use caphy::runner::{self, Run, Summary};
use caphy_core::{Error, Result};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Instant;

pub(crate) const EXAMPLES: &str = "Examples:
  caphy run configs/quickstart.toml
  caphy run configs/walker.toml --plan
  caphy run configs/quickstart.toml --plan --time
  caphy run configs/walker.toml --only train
  caphy run configs/quickstart.toml --set train.rounds=30 --set upper.material.fabric=ivory-rib-knit --out longer
  caphy run --compare runs/quickstart longer
  caphy run --replay longer";

#[derive(clap::Args)]
#[command(group(clap::ArgGroup::new("what").required(true).args(["config", "replay", "compare"])))]
pub(crate) struct Arguments {
    /// The experiment's TOML file.
    config: Option<PathBuf>,
    /// Folder of the results, instead of the file's `run.out`.
    #[arg(long)]
    out: Option<PathBuf>,
    /// Put a value in the place of the file's own: a dotted key, and a TOML value or a bare word; nothing takes the key out. May be
    /// given several times.
    #[arg(long, value_name = "KEY=VALUE", requires = "config")]
    set: Vec<String>,
    /// Run this stage and what it needs, nothing else.
    #[arg(long, value_name = "STAGE", conflicts_with = "until", requires = "config")]
    only: Option<String>,
    /// Run this stage, and whatever uses its results, again even where they are up to date.
    #[arg(long, value_name = "STAGE", requires = "config")]
    from: Option<String>,
    /// Stop after this stage.
    #[arg(long, value_name = "STAGE", requires = "config")]
    until: Option<String>,
    /// Say what would be run, and what the scene needs of body, net and energies; run nothing.
    #[arg(long, requires = "config")]
    plan: bool,
    /// With --plan: also say how long every stage will take here, by trying it on two scans and a few steps.
    #[arg(long, requires = "plan")]
    time: bool,
    /// Say where the time of training steps goes.
    #[arg(long)]
    profile: bool,
    /// Run what this run folder says once more, into `--out` or `RUN-replay`, and compare the bits; fails where they differ.
    #[arg(long, value_name = "RUN")]
    replay: Option<PathBuf>,
    /// Say what differs between two run folders: configuration, data, code, results.
    #[arg(long, num_args = 2, value_names = ["RUN", "RUN"], conflicts_with_all = ["out", "profile"])]
    compare: Vec<PathBuf>,
    /// The answer of --plan, --replay or --compare as JSON.
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(arguments: &Arguments, plugins: &mut Plugins) -> Result<ExitCode> {
    let started = Instant::now();
    if let Some(of) = &arguments.replay {
        let replayed = runner::replay(of, arguments.out.clone(), plugins)?;
        if arguments.json {
            say!("{}", json(&replayed)?)?;
        } else {
            ended(&replayed.summary, started, arguments.profile)?;
            tell!("{}", replayed.text())?;
        }
        return Ok(if replayed.is_same() { ExitCode::SUCCESS } else { ExitCode::FAILURE });
    }
    if let [first, second] = &arguments.compare[..] {
        let difference = runner::compare([first, second])?;
        if arguments.json {
            say!("{}", json(&difference)?)?;
        } else {
            tell!("{}", difference.text())?;
        }
        return Ok(ExitCode::SUCCESS);
    }
    if arguments.json && !arguments.plan {
        let remedy = "give it with --plan, --replay or --compare";
        return Err(Error::config("--json", "a run has no answer in JSON", remedy));
    }
    let settings = arguments.set.iter().map(|text| Setting::parse(text)).collect::<Result<Vec<_>>>()?;
    let config = arguments.config.as_deref().unwrap_or(Path::new(""));
    let mut run = Run::open_set(config, arguments.out.clone(), &settings, plugins)?;
    if let Some(stage) = &arguments.only {
        run = run.only(stage)?;
    }
    if let Some(stage) = &arguments.until {
        run = run.until(stage)?;
    }
    if let Some(stage) = &arguments.from {
        run = run.from(stage)?;
    }
    if arguments.plan {
        if arguments.time {
            run = run.timed();
        }
        let plan = run.plan()?;
        if arguments.json {
            say!("{}", json(&plan)?)?;
        } else {
            tell!("{}", plan.text())?;
        }
        return Ok(ExitCode::SUCCESS);
    }
    if arguments.profile {
        run = run.profiled();
    }
    let summary = run.all()?;
    ended(&summary, started, arguments.profile)?;
    Ok(ExitCode::SUCCESS)
}

/// What a run says at its end.
fn ended(summary: &Summary, started: Instant, profile: bool) -> Result<()> {
    tell!("{}", summary.table)?;
    if profile {
        for (part, ms) in &summary.profile {
            say!("{ms:9.2} ms  {}", part.trim_end_matches(", ms"))?;
        }
    }
    if summary.ran.is_empty() {
        say!("Nothing to do: every stage was up to date.")?;
    } else {
        say!("Ran {} in {:.0} s.", summary.ran.join(", "), started.elapsed().as_secs_f64())?;
    }
    if let Some(report) = &summary.report {
        say!("Report: {}", shown(report).display())?;
    }
    Ok(())
}
