//! `caphy synth`

use caphy::artifact::write_atomically;
use caphy::config::Texture;
use caphy::inputs;
use caphy::plugins::Plugins;
use caphy::runner::Run;
use caphy::stage::synth::TRUTH;
use caphy_core::{Error, Result};
use std::path::PathBuf;
use std::process::ExitCode;
use toml::{Table, Value};

pub(crate) const EXAMPLES: &str = "Examples:
  caphy synth --scans 9 --out person
  caphy synth --upper-material gray-interlock --lower-material 11oz-black-denim --texture patterned --holes 6 --displacement 0.004 --out person
  caphy synth configs/quickstart.toml --out person

Writes DIR/scans, to be read by `[subject] type = \"scans\"`, and DIR/truth: what is true of them, for judging, never for fitting. Without
an experiment, one is made of the options and written to DIR/experiment.toml; `caphy run` of it goes on from these scans.
MATERIAL is what `caphy simulate` takes; --body what `caphy show body` takes.";

#[derive(clap::Args)]
pub(crate) struct Arguments {
    /// An experiment whose subject is synthetic, instead of the options below.
    #[arg(conflicts_with_all = ["body", "scans", "upper_material", "lower_material", "seed", "noise", "holes", "texture", "displacement"])]
    config: Option<PathBuf>,
    /// The body. [default: mannequin]
    #[arg(long)]
    body: Option<String>,
    /// Number of scans. [default: 9]
    #[arg(long)]
    scans: Option<usize>,
    /// The upper garment's fabric. [default: gray-interlock]
    #[arg(long, value_name = "MATERIAL")]
    upper_material: Option<String>,
    /// The lower garment's fabric. [default: 11oz-black-denim]
    #[arg(long, value_name = "MATERIAL")]
    lower_material: Option<String>,
    /// Standard deviation of the noise [m]. [default: 0.0005]
    #[arg(long)]
    noise: Option<f64>,
    /// Small holes in every scan. [default: 0]
    #[arg(long)]
    holes: Option<usize>,
    /// What the surfaces look like. [default: plain]
    #[arg(long, value_enum)]
    texture: Option<Texture>,
    /// Root mean square of a displacement of the skin that no shape coefficient describes [m]. [default: 0]
    #[arg(long)]
    displacement: Option<f64>,
    /// Seed of everything that is not said. [default: 1]
    #[arg(long)]
    seed: Option<u64>,
    /// Folder of the scans.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
}

pub(crate) fn run(arguments: &Arguments, plugins: &mut Plugins) -> Result<ExitCode> {
    let path = match &arguments.config {
        Some(path) => path.clone(),
        None => {
            let path = arguments.out.join("experiment.toml");
            write_atomically(&path, experiment(arguments, plugins)?.to_string().as_bytes())?;
            path
        }
    };
    let started = std::time::Instant::now();
    let run = Run::open_with(&path, Some(arguments.out.clone()), plugins)?.only("synth")?;
    if run.all()?.ran.is_empty() {
        say!("Nothing to do: the scans were up to date.")?;
    } else {
        say!("Scanned in {:.0} s.", started.elapsed().as_secs_f64())?;
    }
    say!("{}", arguments.out.join("scans").display())?;
    say!("{}", arguments.out.join(TRUTH).display())?;
    Ok(ExitCode::SUCCESS)
}

/// The experiment that the options describe; what only later stages need has its defaults.
fn experiment(arguments: &Arguments, plugins: &Plugins) -> Result<Table> {
    let wrong = |e: toml::ser::Error| Error::config("experiment.toml", e.to_string(), "report this as a defect");
    let table = |entries: Vec<(&str, Value)>| -> Table {
        entries.into_iter().map(|(key, value)| (key.to_string(), value)).collect()
    };
    let mut rig = table(vec![]);
    rig.extend(arguments.noise.map(|n| ("noise_m".to_string(), Value::from(n))));
    rig.extend(arguments.holes.map(|n| ("holes".to_string(), Value::from(n as i64))));
    if let Some(texture) = arguments.texture {
        rig.insert("texture".into(), Value::try_from(texture).map_err(wrong)?);
    }
    let mut subject = table(vec![
        ("type", "synthetic".into()),
        ("scans", Value::from(arguments.scans.unwrap_or(9) as i64)),
        ("rig", rig.into()),
    ]);
    subject.extend(arguments.displacement.map(|d| ("displacement_m".to_string(), Value::from(d))));
    let fabrics = [
        ("upper", arguments.upper_material.as_deref().unwrap_or("gray-interlock")),
        ("lower", arguments.lower_material.as_deref().unwrap_or("11oz-black-denim")),
    ];
    let mut out = table(vec![
        ("run", table(vec![("out", ".".into()), ("seed", Value::from(arguments.seed.unwrap_or(1) as i64))]).into()),
        ("body", inputs::body_table(arguments.body.as_deref().unwrap_or("mannequin"), plugins)?.anywhere()?.into()),
        ("segmenter", table(vec![("type", "vertex".into())]).into()),
        ("net", table(vec![("type", "gru".into())]).into()),
    ]);
    let walk = table(vec![("type", "procedural".into()), ("kind", "walk".into()), ("seconds", 6.into())]);
    out.insert("motion".into(), table(vec![("clips", vec![walk].into())]).into());
    for (key, fabric) in fabrics {
        let material = inputs::material_table(fabric, plugins)?.anywhere()?;
        subject.insert(format!("{key}_material"), material.clone().into());
        out.insert(key.into(), table(vec![("material", material.into())]).into());
    }
    out.insert("subject".into(), subject.into());
    Ok(out)
}
