//! `caphy train`

use super::figure::Figure;
use caphy::artifact::write_atomically;
use caphy::config::Translation;
use caphy::files::ProjectFiles;
use caphy::inputs::{self, GarmentArgument, MotionArgument};
use caphy::plugins::Plugins;
use caphy::runner::Run;
use caphy_core::body::BodyModel;
use caphy_core::{Error, Result};
use caphy_garment::template::{BodyRest, GarmentKind, Tailor};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use toml::{Table, Value};

pub(crate) const EXAMPLES: &str = "Examples:
  caphy train --garment upper --material gray-interlock --motion walk --motion reach --out shirt
  caphy train --body SMPLX_NEUTRAL.npz --garment shirt.obj --material knit.toml --motion mocap/ --out shirt
  caphy animate shirt/export/avatar.caphy --motion 35_01.amc --out walk

Writes DIR/experiment.toml and runs it: change the file and run it again with `caphy run`. MOTION is what `caphy show motion` takes,
or a folder of clips; --body, --garment and --material take what `caphy simulate` takes.";

#[derive(clap::Args)]
pub(crate) struct Arguments {
    #[command(flatten)]
    figure: Figure,
    /// The fabric of each garment, in their order; one for all may stand alone.
    #[arg(long, required = true)]
    material: Vec<String>,
    /// A clip or a folder of clips; may be given several times.
    #[arg(long, required = true)]
    motion: Vec<String>,
    /// Length of a generated motion [s].
    #[arg(long, default_value_t = 10.0)]
    seconds: f64,
    /// What the translation of an .npz means.
    #[arg(long, value_enum, default_value_t)]
    translation: Translation,
    /// Frame rate [1/s].
    #[arg(long, default_value_t = 30.0)]
    fps: f64,
    /// Copies of every clip that differ from it, see `[motion.variation]`: with a few clips alone, nets learn them by heart.
    #[arg(long, default_value_t = 10)]
    copies: usize,
    /// The net: a type, or a TOML file that holds an experiment's [net] table.
    #[arg(long, default_value = "gru")]
    net: String,
    /// Rounds of training, see `[train] rounds`.
    #[arg(long, default_value_t = 24)]
    rounds: usize,
    /// Seed of everything random.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Folder of the experiment and its results.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
}

pub(crate) fn run(arguments: &Arguments, plugins: &mut Plugins) -> Result<ExitCode> {
    let experiment = experiment(arguments, plugins)?;
    let path = arguments.out.join("experiment.toml");
    write_atomically(&path, experiment.to_string().as_bytes())?;
    let started = std::time::Instant::now();
    let summary = Run::open_with(&path, Some(arguments.out.clone()), plugins)?.only("export")?.all()?;
    if summary.ran.is_empty() {
        say!("Nothing to do: every stage was up to date.")?;
    } else {
        say!("Ran {} in {:.0} s.", summary.ran.join(", "), started.elapsed().as_secs_f64())?;
    }
    say!("{}", path.display())?;
    say!("{}", arguments.out.join("export").join("avatar.caphy").display())?;
    Ok(ExitCode::SUCCESS)
}

/// The experiment that the arguments describe.
fn experiment(arguments: &Arguments, plugins: &Plugins) -> Result<Table> {
    let figure = &arguments.figure;
    let wrong = |e: toml::ser::Error| Error::config("experiment.toml", e.to_string(), "report this as a defect");
    let table = |entries: Vec<(&str, Value)>| -> Table {
        entries.into_iter().map(|(key, value)| (key.to_string(), value)).collect()
    };
    let count = figure.garment.len();
    if count == 0 {
        return Err(Error::config("--garment", "is not given", "name what is to be trained, such as `upper`"));
    }
    if ![1, count].contains(&arguments.material.len()) {
        let problem = format!("{} fabrics for {count} garments", arguments.material.len());
        return Err(Error::config("--material", problem, "give one for all, or one for each in their order"));
    }
    let named = figure.body.as_deref().unwrap_or("mannequin");
    let body = inputs::body_table(named, plugins)?;
    let model: Box<dyn BodyModel> = body.table.body(&body.files)?;
    let tailor = Tailor::new(BodyRest::from_model(&*model, &model.rest(&figure.shape.shape))?)?;
    let mut out = table(vec![
        ("run", table(vec![("out", ".".into()), ("seed", Value::Integer(arguments.seed as i64))]).into()),
        ("subject", table(vec![("type", "dressed".into()), ("shape", figure.shape.shape.clone().into())]).into()),
        ("body", body.anywhere()?.into()),
        ("net", inputs::net_table(&arguments.net, plugins)?.anywhere()?.into()),
        ("train", table(vec![("rounds", Value::Integer(arguments.rounds as i64))]).into()),
    ]);
    for (i, argument) in figure.garment.iter().enumerate() {
        let garment = GarmentArgument::parse(argument, plugins)?;
        let kind = garment.worn(&tailor)?.kind();
        let material = arguments.material.get(i).unwrap_or(&arguments.material[0]);
        let mut entries = vec![
            ("material", inputs::material_table(material, plugins)?.anywhere()?.into()),
            ("template", garment.table().anywhere()?.into()),
            ("resolution_m", figure.resolution.into()),
            ("weights", Table::try_from(figure.weights()).map_err(wrong)?.into()),
        ];
        entries.extend(garment.values().map(|values| ("style", values.to_vec().into())));
        let key = match kind {
            GarmentKind::Upper => "upper",
            GarmentKind::Lower => "lower",
        };
        if out.insert(key.into(), table(entries).into()).is_some() {
            let problem = format!("two {key} garments");
            return Err(Error::config("--garment", problem, "give one garment for each part of the body"));
        }
    }
    let mut clips = Vec::new();
    for argument in &arguments.motion {
        let (mut clip, files) = if Path::new(argument).is_dir() {
            let translation = Value::try_from(arguments.translation).map_err(wrong)?;
            let path = argument.as_str().into();
            let clip = table(vec![("type", "folder".into()), ("path", path), ("translation", translation)]);
            (clip, ProjectFiles::new("."))
        } else {
            let named = MotionArgument::parse(argument, arguments.seconds, arguments.translation)?;
            (Table::try_from(&named.clip).map_err(wrong)?, named.files)
        };
        inputs::make_absolute(&mut clip, &files)?;
        clips.push(Value::from(clip));
    }
    let variation = table(vec![("copies", Value::Integer(arguments.copies as i64))]);
    let motion = vec![("fps", arguments.fps.into()), ("variation", variation.into()), ("clips", clips.into())];
    out.insert("motion".into(), table(motion).into());
    Ok(out)
}
