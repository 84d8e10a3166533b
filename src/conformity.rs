//! The conformance checks of a plugin by its name: linked types, and those of loaded libraries.

use crate::plugins::{Kind, Plugins};
use caphy_core::conformance::body::BodySubject;
use caphy_core::conformance::material::MaterialSubject;
use caphy_core::conformance::net::NetSubject;
use caphy_core::conformance::segmenter::{COLOURS, SegmenterSubject};
use caphy_core::conformance::{Row, Verdict, body, material, net, run_all, segmenter};
use caphy_core::files::Files;
use caphy_core::host::Library;
use caphy_core::{Error, Result};
use serde::Serialize;
use std::sync::Arc;

/// A type and how its checks came out.
#[derive(Debug, Serialize)]
pub struct Report {
    /// `material`, `net`, `body` or `segmenter`.
    pub kind: &'static str,
    /// The `type` name.
    pub name: String,
    /// The table that was checked.
    pub table: String,
    /// All checks of the trait.
    pub checks: Vec<CheckReport>,
}

/// One check.
#[derive(Debug, Serialize)]
pub struct CheckReport {
    /// Name.
    pub name: &'static str,
    /// The promise.
    pub promise: &'static str,
    /// `passed`, `not offered` or `failed`.
    pub outcome: &'static str,
    /// What is wrong, when it failed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub problem: Option<String>,
}

impl From<Row> for CheckReport {
    fn from(row: Row) -> Self {
        let (outcome, problem) = match row.outcome {
            Ok(Verdict::Passed) => ("passed", None),
            Ok(Verdict::NotOffered) => ("not offered", None),
            Err(problem) => ("failed", Some(problem)),
        };
        Self { name: row.name, promise: row.about, outcome, problem }
    }
}

impl Report {
    /// Number of failed checks.
    pub fn failures(&self) -> usize {
        self.checks.iter().filter(|c| c.problem.is_some()).count()
    }

    /// A table for people.
    pub fn text(&self) -> String {
        let mut out = format!("{} `{}`, checked as {}\n", self.kind, self.name, self.table.trim().replace('\n', ", "));
        for check in &self.checks {
            out += &format!("  {:11}  {:34}  {}\n", check.outcome, check.name, check.promise);
            if let Some(problem) = &check.problem {
                out += &format!("               {}\n", problem.replace('\n', "\n               "));
            }
        }
        let count = |outcome: &str| self.checks.iter().filter(|c| c.outcome == outcome).count();
        let (passed, lacking) = (count("passed"), count("not offered"));
        out + &format!("  {passed} passed, {lacking} not offered, {} failed\n", self.failures())
    }
}

/// A small table for types that have keys without a default.
fn example_table(name: &str) -> String {
    let keys = match name {
        "measured" => "fabric = \"gray-interlock\"\n".to_string(),
        "stvk" | "neo_hookean" => "young_pa = 0.7e5\npoisson = 0.485\nthickness_m = 4.7e-4\n".into(),
        // Small ones: differences take one pass per parameter.
        "gru" => "layers = 2\nhidden = 12\n".into(),
        "mlp" => "hidden = [12, 12]\n".into(),
        "mannequin" => "resolution = 0.03\n".into(),
        "colour" => {
            let entry = |(name, colour)| format!("{{ label = \"{name}\", colour = {colour:?} }}");
            let palette: Vec<String> = ["body", "upper", "lower"].into_iter().zip(COLOURS).map(entry).collect();
            format!("palette = [{}]\n", palette.join(", "))
        }
        _ => String::new(),
    };
    format!("type = \"{name}\"\n{keys}")
}

/// Checks a type of this name, whatever its kind; `table` replaces the small one that is tried otherwise.
///
/// # Errors
/// [`Error::Config`] listing all types for a name that does not exist.
pub fn named(plugins: &Plugins, name: &str, table: Option<&str>, files: Arc<dyn Files>) -> Result<Vec<Report>> {
    let kinds: Vec<Kind> = Kind::CHECKED.into_iter().filter(|k| plugins.names(*k).iter().any(|n| n == name)).collect();
    if kinds.is_empty() {
        let all: Vec<String> = Kind::CHECKED.iter().map(|k| format!("{k}: {}", plugins.names(*k).join(", "))).collect();
        let problem = "there is no such type, and no such file";
        return Err(Error::config(name, problem, format!("give the path of a library, or one of {}", all.join("; "))));
    }
    let table = table.map_or_else(|| example_table(name), str::to_string);
    Ok(kinds.into_iter().map(|kind| report(plugins.library(kind, name), kind, name, &table, &files)).collect())
}

/// Checks every type of a library; `table` is used for the type that it names.
///
/// # Errors
/// None so far: a type that cannot be made fails its checks.
pub fn library(
    library: &Arc<Library>,
    plugins: &Plugins,
    table: Option<&str>,
    files: Arc<dyn Files>,
) -> Result<Vec<Report>> {
    let named =
        |text: &str| -> Option<String> { Some(text.parse::<toml::Table>().ok()?.get("type")?.as_str()?.into()) };
    let mut reports = Vec::new();
    for kind in Kind::CHECKED {
        for name in plugins.names(kind) {
            if !plugins.library(kind, &name).is_some_and(|l| Arc::ptr_eq(l, library)) {
                continue;
            }
            let own = table.filter(|t| named(t).is_none_or(|n| n == name));
            let table = own.map_or_else(|| example_table(&name), str::to_string);
            reports.push(report(Some(library), kind, &name, &table, &files));
        }
    }
    Ok(reports)
}

fn report(library: Option<&Arc<Library>>, kind: Kind, name: &str, table: &str, files: &Arc<dyn Files>) -> Report {
    let rows = match (kind, library) {
        (Kind::Material, Some(library)) => run_all(material::CHECKS, &library.material_subject(name, table)),
        (Kind::Net, Some(library)) => run_all(net::CHECKS, &library.net_subject(name, table)),
        (Kind::Material, None) => run_all(material::CHECKS, &MaterialSubject::linked(table)),
        (Kind::Net, None) => run_all(net::CHECKS, &NetSubject::linked(table)),
        (Kind::Body, _) => run_all(body::CHECKS, &BodySubject::linked(table, Arc::clone(files))),
        (Kind::Segmenter, _) => run_all(segmenter::CHECKS, &SegmenterSubject::linked(table, Arc::clone(files))),
        // No kit: whoever asks goes through `Kind::CHECKED`.
        (Kind::Template, _) => Vec::new(),
    };
    let checks = rows.into_iter().map(CheckReport::from).collect();
    Report { kind: kind.key(), name: name.into(), table: table.into(), checks }
}
