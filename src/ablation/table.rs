//! The table: means over held-out scans and seeds, differences with their intervals, floors.

use super::{AblationConfig, Interval, PaperRow, ratio_interval, title};
use crate::config::{OptimiseConfig, TrainConfig};
use crate::measure::{Fit, PERCEPTUAL};
use crate::plot::number;
use crate::stage::evaluate::{GarmentScore, Scores};
use caphy_core::{Error, Result};
use caphy_garment::template::GarmentKind;
use serde::Serialize;
use std::fmt::Write;

/// All results.
#[derive(Debug, Clone, Serialize)]
pub struct Table {
    /// Seeds that were run.
    pub seeds: Vec<u64>,
    /// Title of the variant that others are compared with.
    pub against: String,
    /// Rows, one per variant and garment, then floors.
    pub rows: Vec<Row>,
}

/// One variant, or a floor, and one garment.
#[derive(Debug, Clone, Serialize)]
pub struct Row {
    /// What it is.
    pub title: String,
    /// Upper or lower.
    pub kind: GarmentKind,
    /// Whether it is a floor: no training can be expected to come below.
    pub floor: bool,
    /// Training steps of a garment; 0 for a floor.
    pub steps: usize,
    /// Number of held-out scans over all seeds.
    pub scans: usize,
    /// Means of everything that is measured, by name and unit.
    pub means: Vec<Measured>,
    /// Differences to the variant that others are compared with.
    pub compared: Vec<Compared>,
    /// Median |log of fabric parameters over the true ones| of groups, over seeds, where a fabric was estimated and the truth is known.
    pub fabric_log_error: Option<f64>,
    /// What the paper says.
    pub paper: Option<PaperRow>,
}

/// A mean.
#[derive(Debug, Clone, Serialize)]
pub struct Measured {
    /// Name and unit.
    pub name: String,
    /// Mean over held-out scans of all seeds.
    pub mean: f64,
    /// Values per seed and scan, in their order.
    pub values: Vec<f64>,
}

/// A relative difference.
#[derive(Debug, Clone, Serialize)]
pub struct Compared {
    /// Name of what is measured.
    pub name: String,
    /// Ratio of the means minus 1, with its interval over pairs of scans.
    pub change: Interval,
}

/// Measures that differences are told of, with the heads of their columns; a network's only where one was given.
pub(super) const COMPARED: [(&str, &str); 4] = [
    ("mean of both, mm", "3D-CD, mm"),
    ("normal maps", "normal maps"),
    ("1 − MS-SSIM", "1 − MS-SSIM"),
    (PERCEPTUAL, "VGG-16"),
];

impl Table {
    /// From the scores of variants, shape [variant][seed].
    ///
    /// # Errors
    /// [`Error::Config`] where no scan was held out.
    pub(super) fn new(
        config: &AblationConfig,
        against: usize,
        scores: &[Vec<Scores>],
        steps: &[usize],
    ) -> Result<Self> {
        let mut rows = Vec::new();
        for kind in [GarmentKind::Upper, GarmentKind::Lower] {
            let held = |index: usize| -> Vec<&GarmentScore> {
                let scans = scores[index].iter().flat_map(|s| &s.scans).filter(|s| s.held_out);
                scans.filter_map(|s| s.garments.iter().find(|g| g.kind == kind)).collect()
            };
            let reference = held(against);
            if reference.is_empty() {
                continue;
            }
            let base = measured(&reference, |g| Some(g.named()));
            let row = |title: &str, means: Vec<Measured>| {
                let compared = COMPARED.iter().filter_map(|(name, _)| {
                    let of = |list: &[Measured]| list.iter().find(|m| m.name == *name).map(|m| m.values.clone());
                    Some(Compared { name: name.to_string(), change: ratio_interval(&of(&means)?, &of(&base)?) })
                });
                let compared = compared.collect();
                let (title, scans) = (title.to_string(), reference.len());
                Row { title, kind, floor: false, steps: 0, scans, means, compared, fabric_log_error: None, paper: None }
            };
            for (index, variant) in config.variant.iter().enumerate() {
                let mut own = row(title(variant), measured(&held(index), |g| Some(g.named())));
                if index == against {
                    own.compared.clear();
                }
                own.steps = steps[index];
                own.fabric_log_error = fabric_error(&scores[index], kind);
                own.paper = variant.paper;
                rows.push(own);
            }
            let floors: [(&str, fn(&GarmentScore) -> Option<&Fit>); 3] = [
                ("skinned template, no training", |g| Some(&g.skinned)),
                ("floor: solver with the true fabric", |g| g.solver.as_ref()),
                ("floor: scan noise (the true garment)", |g| g.truth.as_ref()),
            ];
            for (title, fit) in floors {
                let means = measured(&reference, |g| Some(fit(g)?.named()));
                if !means.is_empty() {
                    rows.push(Row { floor: title.starts_with("floor"), ..row(title, means) });
                }
            }
        }
        if rows.is_empty() {
            let remedy = "hold scans out: `subject.held_out`";
            return Err(Error::config("experiment", "no scan is held out, so that nothing can be compared", remedy));
        }
        let against = title(&config.variant[against]).to_string();
        Ok(Self { seeds: config.seeds.clone(), against, rows })
    }

    /// As text, with what it means.
    pub fn text(&self) -> String {
        let mut out = String::new();
        let mut kind = None;
        for row in &self.rows {
            if kind != Some(row.kind) {
                // Writing to a String cannot fail.
                let _ = writeln!(
                    out,
                    "{}{} garment, {} held-out scans, seeds {:?}; in brackets: against “{}”, 95 % of the draws of scans",
                    if kind.is_some() { "\n" } else { "" },
                    row.kind,
                    row.scans,
                    self.seeds,
                    self.against
                );
                let _ = writeln!(out, "{}", line(&self.head()));
                kind = Some(row.kind);
            }
            let _ = writeln!(out, "{}", line(&self.cells(row)));
        }
        out.push_str(MEANING);
        out
    }
}

/// What the columns are.
pub(super) const MEANING: &str = "\n3D-CD: mean of the mean distances scan → surface and visible vertices → scan, not squared. Normal maps and \
MS-SSIM stand in for the paper's perceptual error by VGG-16, for which no network is part of this program, and cannot be compared \
with it in size. Intervals tell what other scans of \
the same people would change; what another training would, only several seeds show.\n";

fn line(cells: &[String]) -> String {
    let Some((title, rest)) = cells.split_first() else { return String::new() };
    let mut out = format!("{title:<38}");
    for (i, cell) in rest.iter().enumerate() {
        // Compared measures stand before the last three columns.
        let width = [32, 9, 7, 26][(i + 4).saturating_sub(rest.len())];
        let _ = write!(out, " {cell:<width$}");
    }
    out.trim_end().to_string()
}

impl Table {
    /// Measures that differences are told of and that were measured, with their heads.
    pub(super) fn compared(&self) -> impl Iterator<Item = (&'static str, &'static str)> {
        let known = |name: &str| self.rows.iter().any(|row| row.means.iter().any(|m| m.name == name));
        COMPARED.into_iter().filter(move |(name, _)| known(name))
    }
    /// Heads of the columns.
    pub(super) fn head(&self) -> Vec<String> {
        let compared = self.compared().map(|(_, head)| head);
        let all = std::iter::once("").chain(compared).chain(["inside, %", "steps", "paper: 3D-CD, perceptual"]);
        all.map(str::to_string).collect()
    }
    /// A row, one cell per column.
    pub(super) fn cells(&self, row: &Row) -> Vec<String> {
        let mean = |name: &str| row.means.iter().find(|m| m.name == name).map(|m| m.mean);
        let compared = |name: &str| {
            let value = mean(name).map_or("–".into(), number);
            match row.compared.iter().find(|c| c.name == name) {
                Some(c) => format!("{value} ({})", percent(&c.change)),
                None => value,
            }
        };
        let paper = row.paper.map_or(String::new(), |p| {
            let [a, b] = p.chamfer_mm.map(|v| v.to_string());
            let [c, d] = p.perceptual.map(|v| v.to_string());
            format!("{a}, {b}; {c}, {d}")
        });
        let mut out = vec![row.title.clone()];
        out.extend(self.compared().map(|(name, _)| compared(name)));
        out.push(mean("inside body, %").map_or("–".into(), |v| format!("{v:.2}")));
        out.push(if row.steps == 0 { "–".into() } else { row.steps.to_string() });
        out.push(paper);
        out
    }
}

/// A change in percent with its interval.
fn percent(change: &Interval) -> String {
    let signed = |v: f64| format!("{:+.1}", 100.0 * v);
    match change.interval {
        Some([low, high]) => format!("{} %, {} to {}", signed(change.value), signed(low), signed(high)),
        None => format!("{} %", signed(change.value)),
    }
}

/// Means and values of named measures over garments; nothing where one of them has none.
fn measured(
    garments: &[&GarmentScore],
    named: impl Fn(&GarmentScore) -> Option<Vec<(&'static str, f64)>>,
) -> Vec<Measured> {
    let Some(all) = garments.iter().map(|g| named(g)).collect::<Option<Vec<_>>>() else { return Vec::new() };
    let Some(first) = all.first() else { return Vec::new() };
    (0..first.len())
        .map(|i| {
            let values: Vec<f64> = all.iter().map(|list| list[i].1).collect();
            let mean = values.iter().sum::<f64>() / values.len() as f64;
            Measured { name: first[i].0.into(), mean, values }
        })
        .collect()
}

/// Median over seeds and groups of parameters of |log (estimate / truth)|.
fn fabric_error(scores: &[Scores], kind: GarmentKind) -> Option<f64> {
    let fabrics = scores.iter().flat_map(|s| &s.fabrics).filter(|f| f.kind == kind);
    let mut errors: Vec<f64> =
        fabrics.flat_map(|f| &f.groups).map(|(_, _, after)| after.ln().abs()).filter(|e| e.is_finite()).collect();
    errors.sort_by(f64::total_cmp);
    errors.get(errors.len() / 2).copied()
}

/// Steps that one garment's net makes, over all trainings, with so many scans to learn from.
pub(super) fn steps(train: &TrainConfig, optimise: &OptimiseConfig, scans: usize) -> usize {
    train.steps_of_round(scans) * (train.rounds + optimise.alternations * optimise.rounds)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Config;
    use std::path::Path;

    #[test]
    fn steps_are_those_that_a_run_makes() {
        let tiny = Config::parse(Path::new("tiny.toml"), include_str!("../../tests/all/tiny.toml")).unwrap();
        // Per round 3 batches of windows, 1 of single poses, 4 of the two scans; 3 rounds and 2 with the estimated fabric.
        assert_eq!(steps(&tiny.train, &tiny.optimise, 2), (3 + 1 + 4) * (3 + 2));
    }

    #[test]
    fn changes_are_told_with_their_interval() {
        assert_eq!(percent(&Interval { value: 0.123, interval: Some([-0.05, 0.3]) }), "+12.3 %, -5.0 to +30.0");
        assert_eq!(percent(&Interval { value: -0.5, interval: None }), "-50.0 %");
    }
}
