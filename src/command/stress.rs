//! `caphy stress`

use super::json;
use caphy::plugins::Plugins;
use caphy::stress::{self, Atlas, RandomStates};
use caphy_core::Result;
use std::path::PathBuf;
use std::process::ExitCode;

pub(crate) const EXAMPLES: &str = "Examples:
  caphy stress
  caphy stress --material gray-interlock --out atlas
  caphy stress --plugin libmine.so --material all --states 1000000

Writes stress.json, stress.txt, maps (SVG) and stress.html with --out. Fails where an answer is not finite or a gradient wrong; a
tangent that is not positive is shown, not judged.";

#[derive(clap::Args)]
pub(crate) struct Arguments {
    /// A fabric's name, a type, a TOML file with a material's table, or `all`: ten measured fabrics, linked types, loaded ones.
    #[arg(long, default_value = "all")]
    material: String,
    /// Folder for JSON, text, maps and page.
    #[arg(long, value_name = "FOLDER")]
    out: Option<PathBuf>,
    /// Random strains and folds of each fabric, besides the grids.
    #[arg(long, default_value_t = 20_000)]
    states: usize,
    /// Seed of the random states.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Answer as JSON instead of a table.
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(arguments: &Arguments, plugins: &Plugins) -> Result<ExitCode> {
    let (mut atlases, mut random) = (Vec::new(), Vec::new());
    for (name, material) in stress::materials(&arguments.material, plugins)? {
        atlases.push(Atlas::new(&name, &*material)?);
        random.push(stress::random_states(&*material, arguments.states, arguments.seed)?);
    }
    if arguments.json {
        say!("{}", json(&(&atlases, &random))?)?;
    } else {
        tell!("{}", stress::table(&atlases, &random))?;
    }
    if let Some(folder) = &arguments.out {
        say!("{}", stress::write(folder, &atlases, &random)?.display())?;
    }
    let sound = atlases.iter().all(Atlas::sound) && random.iter().all(RandomStates::sound);
    Ok(if sound { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}
