//! The `caphy` program.

use clap::{Parser, Subcommand};
use miette::{IntoDiagnostic, Result};
use std::path::PathBuf;

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

fn main() -> Result<()> {
    let cli = Cli::parse();
    if let Some(threads) = cli.threads {
        rayon::ThreadPoolBuilder::new().num_threads(threads).build_global().into_diagnostic()?;
    }
    match cli.command {
        Command::Run { config, out } => {
            let run = caphy::runner::Run::open(&config, out).map_err(|e| miette::miette!("{e}"))?;
            let started = std::time::Instant::now();
            let summary = run.all().map_err(|e| miette::miette!("{e}"))?;
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
