//! `caphy show`

use super::json;
use caphy::show::fabrics;
use caphy_core::Result;
use std::path::PathBuf;
use std::process::ExitCode;

#[derive(clap::Subcommand)]
pub(crate) enum What {
    /// The ten measured fabrics.
    #[command(
        after_help = "Examples:\n  caphy show fabrics\n  caphy show fabrics --json\n  caphy show fabrics --plot fabrics/"
    )]
    Fabrics {
        /// All numbers as a JSON array of ten objects.
        #[arg(long)]
        json: bool,
        /// Write stress-strain and bending curves of each fabric into this folder.
        #[arg(long, value_name = "DIR")]
        plot: Option<PathBuf>,
    },
}

pub(crate) fn run(what: &What) -> Result<ExitCode> {
    match what {
        What::Fabrics { json: as_json, plot } => {
            if let Some(folder) = plot {
                let page = fabrics::plot(folder)?;
                eprintln!("Curves: {}", page.display());
            }
            if *as_json {
                println!("{}", json(&fabrics::facts()?)?);
            } else if plot.is_none() {
                print!("{}", fabrics::table()?);
            }
        }
    }
    Ok(ExitCode::SUCCESS)
}
