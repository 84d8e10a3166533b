//! `caphy probe`

use super::json;
use caphy::inputs;
use caphy::plugins::Plugins;
use caphy::probe;
use caphy_core::material::MaterialModel;
use caphy_core::{Error, Result};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;

pub(crate) const EXAMPLES: &str = "Examples:
  printf 'type = \"measured\"\\nfabric = \"gray-interlock\"\\n' > gray.toml
  echo '[[[1.1, 0], [0, 1], [0, 0]]]' > stretch.json
  caphy probe gray.toml --gradients stretch.json
  caphy probe gray.toml --hinges folds.json --json

MATERIAL.toml holds what an experiment's material table holds. --gradients: an array of 3x2 deformation gradients,
row-major. --hinges: an array of {u_side0, u_side1, x, theta_rest}: material coordinates [m] of the corners (n0, n1,
opposite) on both sides, world positions [m] of n0, n1, n2, n3, rest angle [rad].";

#[derive(clap::Args)]
#[command(group(clap::ArgGroup::new("input").required(true).args(["gradients", "hinges"])))]
pub(crate) struct Arguments {
    /// A fabric's name, or a TOML file with a material's table: `type = "…"` and its keys.
    material: String,
    /// JSON array of 3x2 deformation gradients, row-major.
    #[arg(long, value_name = "FILE")]
    gradients: Option<PathBuf>,
    /// JSON array of hinges.
    #[arg(long, value_name = "FILE")]
    hinges: Option<PathBuf>,
    /// Answer as a JSON array instead of a table.
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(arguments: &Arguments, plugins: &Plugins) -> Result<ExitCode> {
    let material: Arc<dyn MaterialModel> = Arc::from(inputs::material(&arguments.material, plugins)?);
    let read = |path: &Path| std::fs::read(path).map_err(|e| Error::io(path, "read", e));
    if let Some(file) = &arguments.gradients {
        let answers = probe::gradients(&*material, file, &read(file)?)?;
        if arguments.json {
            say!("{}", json(&answers)?)?;
        } else {
            say!("      Guu       Gvv       Guv   psi [J/m²]    Suu [N/m]    Svv [N/m]    Suv [N/m]")?;
            for a in &answers {
                let [u, v, w] = a.green;
                let [suu, svv, suv] = a.second_pk;
                say!("{u:9.5} {v:9.5} {w:9.5} {:12.5e} {suu:12.5e} {svv:12.5e} {suv:12.5e}", a.energy)?;
            }
        }
    }
    if let Some(file) = &arguments.hinges {
        let answers = probe::hinges(&material, file, &read(file)?)?;
        if arguments.json {
            say!("{}", json(&answers)?)?;
        } else {
            say!("theta [rad]      k [N·m]   energy [J]   |force| on n0, n1, n2, n3 [N]")?;
            for a in &answers {
                let size = |f: &[f64; 3]| f[0].hypot(f[1]).hypot(f[2]);
                let forces: Vec<String> = a.force.iter().map(|f| format!("{:10.3e}", size(f))).collect();
                say!("{:11.6} {:12.5e} {:12.5e}   {}", a.theta, a.stiffness, a.energy, forces.join(" "))?;
            }
        }
    }
    Ok(ExitCode::SUCCESS)
}
