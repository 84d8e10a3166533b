//! The `caphy` program.

use caphy_core::{Error, Result};
use clap::{Parser, Subcommand};
use std::path::PathBuf;
use std::process::ExitCode;

/// From 3D scans of one clothed person to an avatar whose garments move by that person's own fabrics.
#[derive(Parser)]
#[command(version, after_help = "Example:\n  caphy run configs/quickstart.toml")]
struct Cli {
    /// Number of threads; results are the same bits for any number. Default: all cores.
    #[arg(long, global = true)]
    threads: Option<usize>,
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Run every stage of an experiment, from scans to report; finished stages are not run again.
    #[command(after_help = "Example:\n  caphy run configs/quickstart.toml")]
    Run {
        /// The experiment's TOML file.
        config: PathBuf,
        /// Folder of the results, instead of the file's `run.out`.
        #[arg(long)]
        out: Option<PathBuf>,
    },
}

fn main() -> ExitCode {
    match run(&Cli::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::FAILURE
        }
    }
}

fn run(cli: &Cli) -> Result<()> {
    if let Some(threads) = cli.threads {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build_global();
        pool.map_err(|e| {
            Error::config("--threads", e.to_string(), "give a number of threads that the machine can start")
        })?;
    }
    match &cli.command {
        Command::Run { config, out } => {
            let run = caphy::runner::Run::open(config, out.clone())?;
            let started = std::time::Instant::now();
            let summary = run.all()?;
            println!("{}", summary.table);
            if summary.ran.is_empty() {
                println!("Nothing to do: every stage was up to date.");
            } else {
                println!("Ran {} in {:.0} s.", summary.ran.join(", "), started.elapsed().as_secs_f64());
            }
            println!("Report: {}", summary.folder.join("report.html").display());
            Ok(())
        }
    }
}
