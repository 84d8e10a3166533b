//! `caphy check`

use super::json;
use caphy::conformity::{self, Report};
use caphy::files::ProjectFiles;
use caphy::plugins::Plugins;
use caphy_core::{Error, Result};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;

pub(crate) const EXAMPLES: &str = "Examples:
  caphy check measured
  caphy check target/release/libcaphy_plugin_woven.so
  caphy check smplx --table body.toml

A type is checked with a small table of its own; --table gives another, which types whose keys have no defaults need.";

#[derive(clap::Args)]
pub(crate) struct Arguments {
    /// A plugin library, or the `type` name of a plugin that is linked or loaded by --plugin.
    #[arg(value_name = "LIB_OR_NAME")]
    subject: String,
    /// TOML file with the type's table; paths in it are relative to it.
    #[arg(long, value_name = "FILE")]
    table: Option<PathBuf>,
    /// Answer as a JSON array instead of a table.
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(arguments: &Arguments, plugins: &mut Plugins) -> Result<ExitCode> {
    let read = |path: &PathBuf| std::fs::read_to_string(path).map_err(|e| Error::io(path, "read", e));
    let table = arguments.table.as_ref().map(read).transpose()?;
    let folder = arguments.table.as_deref().and_then(Path::parent).unwrap_or(Path::new("."));
    let files = Arc::new(ProjectFiles::new(folder));
    let path = Path::new(&arguments.subject);
    let is_path = path.components().count() > 1 || path.extension().is_some() || path.is_file();
    // A plugin that panics says so in the table; the trace would only drown it.
    std::panic::set_hook(Box::new(|_| {}));
    let reports: Vec<Report> = if is_path {
        let library = plugins.load(path)?;
        conformity::library(&library, plugins, table.as_deref(), files)?
    } else {
        conformity::named(plugins, &arguments.subject, table.as_deref(), files)?
    };
    if arguments.json {
        say!("{}", json(&reports)?)?;
    } else {
        for report in &reports {
            say!("{}", report.text())?;
        }
    }
    let failures: usize = reports.iter().map(Report::failures).sum();
    Ok(if failures == 0 { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}
