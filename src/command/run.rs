//! `caphy run`

use caphy::plugins::Plugins;
use caphy::runner::Run;
use caphy_core::Result;
use std::path::PathBuf;
use std::process::ExitCode;

#[derive(clap::Args)]
pub(crate) struct Arguments {
    /// The experiment's TOML file.
    config: PathBuf,
    /// Folder of the results, instead of the file's `run.out`.
    #[arg(long)]
    out: Option<PathBuf>,
}

pub(crate) fn run(arguments: &Arguments, plugins: &mut Plugins) -> Result<ExitCode> {
    let run = Run::open_with(&arguments.config, arguments.out.clone(), plugins)?;
    let started = std::time::Instant::now();
    let summary = run.all()?;
    println!("{}", summary.table);
    if summary.ran.is_empty() {
        println!("Nothing to do: every stage was up to date.");
    } else {
        println!("Ran {} in {:.0} s.", summary.ran.join(", "), started.elapsed().as_secs_f64());
    }
    println!("Report: {}", summary.folder.join("report.html").display());
    Ok(ExitCode::SUCCESS)
}
