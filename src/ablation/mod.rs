//! `caphy ablation`: one experiment with parts of the method left out, each trained on the same scans, and compared scan by scan
//! (Table 1 of the paper).

mod bootstrap;
mod page;
mod table;

pub use bootstrap::{Interval, ratio_interval};
pub use table::{Compared, Measured, Row, Table};

use crate::artifact;
use crate::config::{Config, Setting, SubjectConfig, parse_table, place};
use crate::files::ProjectFiles;
use crate::manifest::Manifest;
use crate::plugins::Plugins;
use crate::runner::Run;
use crate::stage::evaluate::Scores;
use crate::variants::{anew, share};
use caphy_core::{Error, Result};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// The file of an ablation.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AblationConfig {
    /// The experiment, relative to this file's folder.
    pub experiment: PathBuf,
    /// Folder of the results, relative to this file's folder unless absolute.
    pub out: PathBuf,
    /// One run of every variant per seed; a synthetic subject is another person with each. Default `[1]`.
    #[serde(default = "one_seed")]
    pub seeds: Vec<u64>,
    /// Name of the variant that the others are compared with. Default the last one.
    #[serde(default)]
    pub against: Option<String>,
    /// Settings of all variants, as `caphy run --set` takes them. Default none.
    #[serde(default)]
    pub set: Vec<String>,
    /// The variants, in the order of the table.
    pub variant: Vec<VariantConfig>,
}

fn one_seed() -> Vec<u64> {
    vec![1]
}

/// `[[variant]]`
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct VariantConfig {
    /// Name of its folders: letters, digits, `-` and `_`.
    pub name: String,
    /// What is left out, for people. Default the name.
    #[serde(default)]
    pub title: Option<String>,
    /// Its settings beside those of all.
    #[serde(default)]
    pub set: Vec<String>,
    /// What the paper says of it, for its two cases: 3D-CD [mm] and 2D perceptual error [1]. Default nothing.
    #[serde(default)]
    pub paper: Option<PaperRow>,
}

/// A row of the paper's Table 1.
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PaperRow {
    /// 3D-CD of both cases [mm].
    pub chamfer_mm: [f64; 2],
    /// 2D perceptual error of both cases, by VGG-16 [1].
    pub perceptual: [f64; 2],
}

/// An ablation that can be run.
pub struct Ablation {
    config: AblationConfig,
    experiment: PathBuf,
    folder: PathBuf,
    /// Settings per variant, without the seed.
    settings: Vec<Vec<Setting>>,
    against: usize,
}

/// What came of it.
#[derive(Debug)]
pub struct Ended {
    /// The results.
    pub table: Table,
    /// Where they are.
    pub folder: PathBuf,
    /// Runs in which anything was done, as `seed-1/full`.
    pub ran: Vec<String>,
}

/// Folder, within a seed's, of what all variants share.
const SUBJECT: &str = "subject";

impl Ablation {
    /// Reads the file and checks every variant before anything runs; `out` replaces the file's.
    ///
    /// # Errors
    /// [`Error::Format`] with line and column; [`Error::Config`] naming a variant's setting or name.
    pub fn open(path: &Path, out: Option<PathBuf>, plugins: &Plugins) -> Result<Self> {
        let text = std::fs::read_to_string(path).map_err(|e| Error::io(path, "read", e))?;
        let table = parse_table(path, &text)?;
        let read = |table: &toml::Table| -> std::result::Result<AblationConfig, String> {
            table.clone().try_into().map_err(|e: toml::de::Error| e.message().trim().to_string())
        };
        let config = read(&table)
            .map_err(|message| place::error(path, &text, "", &table, &message, &|table| read(table).err()))?;
        let files = ProjectFiles::new(path.parent().unwrap_or(Path::new(".")));
        let experiment = files.resolve(&config.experiment)?;
        let folder = match out {
            Some(out) => out,
            None => files.resolve(&config.out)?,
        };
        let against = against(&config)?;
        let mut ablation = Self { experiment, folder, settings: Vec::new(), against, config };
        for variant in &ablation.config.variant {
            let parsed = ablation.config.set.iter().chain(&variant.set).map(|text| Setting::parse(text));
            ablation.settings.push(parsed.collect::<Result<_>>().map_err(|e| of_variant(&variant.name, e))?);
        }
        for (index, variant) in ablation.config.variant.iter().enumerate() {
            let read = Config::read_set(&ablation.experiment, &ablation.settings[index], &mut anew(plugins)?);
            let read = read.map_err(|e| of_variant(&variant.name, e))?;
            if let SubjectConfig::Dressed(_) = read.subject {
                return Err(Error::config("experiment", "has no scans to compare with", "name one with scans"));
            }
            if index == against && matches!(read.subject, SubjectConfig::Synthetic(_)) {
                let floor = Setting::new("evaluate.solver_floor", true.into())?;
                ablation.settings[index].push(floor);
            }
        }
        Ok(ablation)
    }

    /// Training steps of a garment's net in every variant, with so many scans to learn from.
    ///
    /// # Errors
    /// As [`Ablation::open`].
    pub fn steps(&self, scans: usize) -> Result<Vec<usize>> {
        let of = |settings: &Vec<Setting>| {
            let config = Config::read_set(&self.experiment, settings, &mut Plugins::new()?)?;
            Ok(table::steps(&config.train, &config.optimise, scans))
        };
        self.settings.iter().map(of).collect()
    }

    /// Runs what is not done yet and writes `ablation.json`, `ablation.txt` and `report.html`; `say` hears which run begins.
    ///
    /// # Errors
    /// What runs give.
    pub fn run(&self, plugins: &Plugins, say: &dyn Fn(&str)) -> Result<Ended> {
        let mut ran = Vec::new();
        let mut scores: Vec<Vec<Scores>> = vec![Vec::new(); self.config.variant.len()];
        let mut steps = vec![0; self.config.variant.len()];
        for seed in &self.config.seeds {
            let folder = self.folder.join(format!("seed-{seed}"));
            let open = |name: &str, settings: &[Setting], until: &str| -> Result<Run> {
                let seed = i64::try_from(*seed)
                    .map_err(|_| Error::config("seeds", seed.to_string(), "give numbers below 2^63"))?;
                let settings = [settings, &[Setting::new("run.seed", seed.into())?]].concat();
                let mut plugins = anew(plugins)?;
                Run::open_set(&self.experiment, Some(folder.join(name)), &settings, &mut plugins)?.until(until)
            };
            say(&format!("seed {seed}: scans and templates"));
            let common = self.config.set.iter().map(|text| Setting::parse(text)).collect::<Result<Vec<_>>>()?;
            let shared = open(SUBJECT, &common, "preprocess")?.all()?.ran;
            if !shared.is_empty() {
                ran.push(format!("seed-{seed}/{SUBJECT}"));
            }
            for (index, variant) in self.config.variant.iter().enumerate() {
                say(&format!("seed {seed}: {}", variant.name));
                let own = folder.join(&variant.name);
                if !shared.is_empty() || Manifest::read(&own).is_err() {
                    share(&folder.join(SUBJECT), &own)?;
                }
                let run = open(&variant.name, &self.settings[index], "evaluate")?;
                let (train, optimise) = (run.config().train.clone(), run.config().optimise.clone());
                if !run.all()?.ran.is_empty() {
                    ran.push(format!("seed-{seed}/{}", variant.name));
                }
                let measured: Scores = artifact::open(&own.join("evaluate.caphy"), "evaluate")?;
                let learnt = measured.scans.iter().filter(|s| !s.held_out).count();
                steps[index] = table::steps(&train, &optimise, learnt);
                scores[index].push(measured);
            }
        }
        let table = Table::new(&self.config, self.against, &scores, &steps)?;
        let json = serde_json::to_vec_pretty(&table)
            .map_err(|e| Error::numerics("ablation.json", e.to_string(), "report this as a defect"))?;
        artifact::write_atomically(&self.folder.join("ablation.json"), &json)?;
        artifact::write_atomically(&self.folder.join("ablation.txt"), table.text().as_bytes())?;
        artifact::write_atomically(&self.folder.join("report.html"), self.page(&table)?.as_bytes())?;
        Ok(Ended { table, folder: self.folder.clone(), ran })
    }

    /// Pictures of every variant beside its scans, for the first seed.
    fn page(&self, table: &Table) -> Result<String> {
        let first = self.config.seeds.first().copied().unwrap_or_default();
        let folder = self.folder.join(format!("seed-{first}"));
        let pictures: Vec<(String, PathBuf)> = self
            .config
            .variant
            .iter()
            .map(|v| (title(v).to_string(), folder.join(&v.name).join("pictures/evaluation.png")))
            .collect();
        page::page(table, &pictures)
    }
}

fn title(variant: &VariantConfig) -> &str {
    variant.title.as_deref().unwrap_or(&variant.name)
}

fn of_variant(name: &str, error: Error) -> Error {
    match error {
        Error::Config { key, problem, remedy } => {
            Error::config(format!("variant `{name}`, {}", key.trim_start_matches("--")), problem, remedy)
        }
        other => other,
    }
}

/// The variant that others are compared with; refuses names that cannot be folders of their own.
fn against(config: &AblationConfig) -> Result<usize> {
    let names: Vec<&str> = config.variant.iter().map(|v| v.name.as_str()).collect();
    for (i, name) in names.iter().enumerate() {
        let plain = !name.is_empty() && name.chars().all(|c| c.is_ascii_alphanumeric() || "-_".contains(c));
        if !plain || *name == SUBJECT || names[..i].contains(name) {
            let remedy = format!("give each its own, of letters, digits, `-` and `_`, other than `{SUBJECT}`");
            return Err(Error::config("variant.name", format!("`{name}`"), remedy));
        }
    }
    if config.seeds.is_empty() {
        return Err(Error::config("seeds", "is empty", "give at least one number"));
    }
    let missing = |name: &str| {
        Error::config("against", format!("there is no variant `{name}`"), format!("there are: {}", names.join(", ")))
    };
    match &config.against {
        Some(name) => names.iter().position(|n| n == name).ok_or_else(|| missing(name)),
        None => names.len().checked_sub(1).ok_or_else(|| Error::config("variant", "there is none", "add [[variant]]")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn open(text: &str) -> Result<Ablation> {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("tiny.toml"), include_str!("../../tests/all/tiny.toml")).unwrap();
        let path = folder.path().join("ablation.toml");
        std::fs::write(&path, format!("experiment = \"tiny.toml\"\nout = \"out\"\n{text}")).unwrap();
        Ablation::open(&path, None, &Plugins::new().unwrap())
    }

    #[test]
    fn mistakes_are_found_before_anything_runs() {
        let two = "[[variant]]\nname = \"a\"\n[[variant]]\nname = \"b\"\n";
        let opened = open(two).unwrap();
        assert_eq!(opened.against, 1);
        assert_eq!(opened.settings[0].len(), 0);
        assert_eq!(opened.settings[1][0].to_string(), "evaluate.solver_floor=true");
        assert_eq!(open(&format!("against = \"a\"\n{two}")).unwrap().against, 0);
        for (text, words) in [
            (two.replace("\"b\"", "\"a\""), vec!["variant.name", "`a`"]),
            (two.replace("\"b\"", "\"../b\""), vec!["variant.name", "../b"]),
            (two.replace("\"b\"", "\"subject\""), vec!["variant.name", "subject"]),
            (format!("against = \"c\"\n{two}"), vec!["no variant `c`", "a, b"]),
            (format!("seeds = []\n{two}"), vec!["seeds"]),
            (two.replace("name = \"b\"", "name = \"b\"\nset = [\"train.roundz=1\"]"), vec!["variant `b`", "roundz"]),
            (two.replace("name = \"b\"", "name = \"b\"\nsets = []"), vec!["line 7", "sets"]),
            ("variant = []".into(), vec!["[[variant]]"]),
        ] {
            let said = open(&text).map(drop).unwrap_err().to_string();
            assert!(words.iter().all(|w| said.contains(w)), "{words:?} in {said}");
        }
    }
}
