//! Two run folders beside each other: what differs in configuration, data, code and results.

use crate::artifact;
use crate::manifest::{CONFIG, Manifest, Program};
use crate::plot::number;
use crate::stage::evaluate::Scores;
use caphy_core::{Error, Result};
use serde::Serialize;
use serde_json::Value;
use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::{Path, PathBuf};

/// What differs between two runs.
#[derive(Debug, Serialize)]
pub struct Difference {
    /// Their folders.
    pub runs: [PathBuf; 2],
    /// Keys of the resolved configurations with other values; where results go does not count.
    pub config: Vec<Changed<Value>>,
    /// Input files and scans with other contents (hashes).
    pub data: Vec<Changed<String>>,
    /// The programs, where they differ.
    pub code: Option<[Program; 2]>,
    /// Stages with other results (hashes).
    pub stages: Vec<Changed<String>>,
    /// Means of what was measured, in both runs whether they differ or not.
    pub results: Vec<Changed<f64>>,
}

/// Something that is not the same in both.
#[derive(Debug, Serialize)]
pub struct Changed<T> {
    /// What it is.
    pub name: String,
    /// In the first run; none where it is not there.
    pub first: Option<T>,
    /// In the second.
    pub second: Option<T>,
}

/// Compares two run folders.
///
/// # Errors
/// Where one has no `run.json` or `config.toml`, or is damaged.
pub fn compare(runs: [&Path; 2]) -> Result<Difference> {
    let [a, b] = [Manifest::read(runs[0])?, Manifest::read(runs[1])?];
    let mut config = changed(leaves(runs[0])?, leaves(runs[1])?);
    config.retain(|c| c.name != "run.out");
    let contents = |m: &Manifest| m.stages.iter().map(|(name, s)| (name.clone(), s.content.clone())).collect();
    let [first, second] = [measured(runs[0])?, measured(runs[1])?];
    let results = first
        .iter()
        .map(|(name, value)| {
            let other = second.iter().find(|(n, _)| n == name).map(|(_, v)| *v);
            Changed { name: name.clone(), first: Some(*value), second: other }
        })
        .chain(second.iter().filter(|(name, _)| !first.iter().any(|(n, _)| n == name)).map(|(name, value)| Changed {
            name: name.clone(),
            first: None,
            second: Some(*value),
        }))
        .collect();
    Ok(Difference {
        runs: runs.map(Path::to_path_buf),
        config,
        data: changed(a.inputs.clone(), b.inputs.clone()),
        stages: changed(contents(&a), contents(&b)),
        code: (a.program != b.program).then_some([a.program, b.program]),
        results,
    })
}

impl Difference {
    /// As text.
    pub fn text(&self) -> String {
        let mut out = format!("first:  {}\nsecond: {}\n", self.runs[0].display(), self.runs[1].display());
        let shown = |value: &Option<String>| value.clone().unwrap_or_else(|| "–".into());
        let mut part = |title: &str, rows: Vec<(String, Option<String>, Option<String>)>| {
            // Writing to a String cannot fail.
            if rows.is_empty() {
                let _ = writeln!(out, "{title}: the same");
                return;
            }
            let _ = writeln!(out, "{title}");
            for (name, first, second) in rows {
                let _ = writeln!(out, "  {name}: {} → {}", shown(&first), shown(&second));
            }
        };
        let text = |value: &Value| value.as_str().map_or_else(|| value.to_string(), |text| format!("\"{text}\""));
        let row = |c: &Changed<Value>| (c.name.clone(), c.first.as_ref().map(text), c.second.as_ref().map(text));
        part("Configuration", self.config.iter().map(row).collect());
        let short = |hash: &String| hash[..hash.len().min(12)].to_string();
        let hashes = |c: &Changed<String>| (c.name.clone(), c.first.as_ref().map(short), c.second.as_ref().map(short));
        part("Data", self.data.iter().map(hashes).collect());
        let code = self.code.iter().map(|[a, b]| {
            let named = |p: &Program| Some(format!("{} ({})", p.version, short(&p.hash)));
            ("caphy".to_string(), named(a), named(b))
        });
        part("Code", code.collect());
        part("Stages", self.stages.iter().map(hashes).collect());
        if !self.results.is_empty() {
            let _ = writeln!(out, "Results{:<51} {:>10} {:>10} {:>9}", "", "first", "second", "change");
        }
        for result in &self.results {
            let value = |v: Option<f64>| v.map_or("–".into(), number);
            let change = match (result.first, result.second) {
                (Some(a), Some(b)) if a != 0.0 => format!("{:+.1} %", 100.0 * (b / a - 1.0)),
                _ => String::new(),
            };
            let _ = writeln!(
                out,
                "  {:<56} {:>10} {:>10} {change:>9}",
                result.name,
                value(result.first),
                value(result.second)
            );
        }
        out
    }
}

/// Means over the held-out and the other scans, where the run was evaluated.
fn measured(folder: &Path) -> Result<Vec<(String, f64)>> {
    let path = folder.join("evaluate.caphy");
    if !path.exists() {
        return Ok(Vec::new());
    }
    Ok(artifact::open::<Scores>(&path, "evaluate")?.means())
}

/// Entries of two maps that differ.
fn changed<T: PartialEq>(mut first: BTreeMap<String, T>, mut second: BTreeMap<String, T>) -> Vec<Changed<T>> {
    let names: Vec<String> = first.keys().chain(second.keys().filter(|n| !first.contains_key(*n))).cloned().collect();
    let both = names.into_iter().map(|name| {
        let (first, second) = (first.remove(&name), second.remove(&name));
        Changed { name, first, second }
    });
    both.filter(|c| c.first != c.second).collect()
}

/// Values of a run's resolved configuration by their dotted keys.
fn leaves(folder: &Path) -> Result<BTreeMap<String, Value>> {
    fn collect(at: &str, value: Value, out: &mut BTreeMap<String, Value>) {
        let inner = |key: &str| if at.is_empty() { key.to_string() } else { format!("{at}.{key}") };
        match value {
            Value::Object(map) => map.into_iter().for_each(|(key, value)| collect(&inner(&key), value, out)),
            // Clips and the like; lists of numbers are one value.
            Value::Array(list) if list.iter().any(Value::is_object) => {
                list.into_iter().enumerate().for_each(|(i, value)| collect(&inner(&i.to_string()), value, out));
            }
            leaf => drop(out.insert(at.to_string(), leaf)),
        }
    }
    let path = folder.join(CONFIG);
    let text = std::fs::read_to_string(&path).map_err(|e| Error::io(&path, "read", e))?;
    let table = crate::config::parse_table(&path, &text)?;
    let value = serde_json::to_value(table)
        .map_err(|e| Error::format(&path, "whole file", e.to_string(), "run the experiment again"))?;
    let mut out = BTreeMap::new();
    collect("", value, &mut out);
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn maps_differ_where_values_or_keys_do() {
        let map = |list: &[(&str, i32)]| list.iter().map(|(k, v)| (k.to_string(), *v)).collect();
        let got = changed(map(&[("a", 1), ("b", 2), ("c", 3)]), map(&[("a", 1), ("b", 4), ("d", 5)]));
        let got: Vec<_> = got.iter().map(|c| (c.name.as_str(), c.first, c.second)).collect();
        assert_eq!(got, [("b", Some(2), Some(4)), ("c", Some(3), None), ("d", None, Some(5))]);
    }
}
