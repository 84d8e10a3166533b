//! `caphy views`

use caphy::config::{Config, SubjectConfig};
use caphy::files::ProjectFiles;
use caphy::plugins::Plugins;
use caphy::stage::scans::{read_scan_of, scan_list};
use caphy_core::{Error, Result};
use caphy_render::{Rgb, png, render, uniform_views};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

pub(crate) const EXAMPLES: &str = "Example:
  caphy views configs/subject.toml --out views
  (run a human parser on the pictures, then use its label images by `[segmenter] type = \"labels\"`)";

#[derive(clap::Args)]
pub(crate) struct Arguments {
    /// The experiment's TOML file, whose scans are rendered.
    config: PathBuf,
    /// Folder of the pictures.
    #[arg(long)]
    out: PathBuf,
}

/// White: what people are photographed against for such parsers.
const BACKGROUND: [u8; 3] = [255; 3];

pub(crate) fn run(arguments: &Arguments, plugins: &mut Plugins) -> Result<ExitCode> {
    let config = Config::read_with(&arguments.config, plugins)?;
    let files = ProjectFiles::new(arguments.config.parent().unwrap_or(Path::new(".")));
    let SubjectConfig::Scans(folder) = &config.subject else {
        return Err(Error::config(
            "subject.type",
            "has no folder of scans",
            "give an experiment with `type = \"scans\"`",
        ));
    };
    let body = config.body.body(&files)?;
    std::fs::create_dir_all(&arguments.out).map_err(|e| Error::io(&arguments.out, "create", e))?;
    let (mut written, mut failed) = (0, 0);
    for file in &scan_list(&files, folder, config.run.seed)?.list {
        let (scan, _, notes) = match read_scan_of(&files, &config.subject, &*body, file) {
            Ok(read) => read,
            Err(error) => {
                note!("warning: scan {}: {error}", file.name);
                failed += 1;
                continue;
            }
        };
        notes.iter().for_each(|note| note!("scan {} {note}", file.name));
        let bounds = scan.mesh.bounds().filter(|_| !scan.mesh.faces.is_empty()).ok_or_else(|| {
            Error::mesh(&file.name, "surface", "there are no faces", "views need a triangulated scan")
        })?;
        for (i, camera) in uniform_views(bounds, config.views.count, config.views.size).iter().enumerate() {
            let picture = Rgb::from_view(&render(&scan.mesh, scan.colours.as_deref(), camera), BACKGROUND);
            let path = arguments.out.join(format!("{}_{i:03}.png", file.name));
            std::fs::write(&path, png(&picture)?).map_err(|e| Error::io(&path, "write", e))?;
            written += 1;
        }
    }
    say!("{written} views in {}", arguments.out.display())?;
    Ok(if failed == 0 { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}
