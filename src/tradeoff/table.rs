//! Results as text and JSON.

use super::error::Errors;
use super::front::{Candidate, Front, Pick, Preset};
use super::knobs::Acts;
use super::point::Measured;
use super::precision::Precision;
use super::preprocessed::Preprocessed;
use super::yardstick::Yardstick;
use super::{Tradeoff, page};
use crate::artifact::write_atomically;
use crate::config::Setting;
use crate::plot::number;
use caphy_core::{Error, Result};
use serde::{Deserialize, Serialize};
use std::fmt::Write;
use std::path::Path;

/// A trained point.
#[derive(Debug, Clone, Serialize)]
pub struct Row {
    /// The knob that was turned; empty for the experiment's own point, `together` for several.
    pub knob: String,
    /// Its value.
    pub level: String,
    /// Whether it changes the fabric: then it is no candidate of a front.
    pub of_fabric: bool,
    /// What it sets.
    pub set: Vec<String>,
    /// Values of all knobs that act on nets.
    pub fixed: Vec<String>,
    /// Number of the training with these settings.
    pub repeat: usize,
    /// What was measured.
    pub measured: Measured,
    /// Processor time of training until the energy was as low as the experiment's own training ends [s]; none where it was not, and
    /// where energies are those of another mesh or fabric.
    pub quality_s: Option<f64>,
}

impl Row {
    pub(super) fn new(
        knob: &str,
        level: &str,
        acts: Acts,
        set: &[Setting],
        fixed: Vec<String>,
        repeat: usize,
        measured: Measured,
    ) -> Self {
        let set = set.iter().map(Setting::to_string).collect();
        let (knob, level) = (knob.to_string(), level.to_string());
        Self { knob, level, of_fabric: acts == Acts::Fabric, set, fixed, repeat, measured, quality_s: None }
    }
    /// For people.
    pub fn name(&self) -> String {
        match (self.knob.as_str(), self.repeat) {
            ("", 0) => self.level.clone(),
            ("", repeat) => format!("{}, seed {}", self.level, repeat + 1),
            ("together", _) => self.level.clone(),
            (knob, _) => format!("{knob} {}", self.level),
        }
    }
}

/// A way to preprocess.
#[derive(Debug, Clone, Serialize)]
pub struct PreprocessRow {
    /// The knob that was turned; empty for the experiment's own.
    pub knob: String,
    /// Its value.
    pub level: String,
    /// What was measured.
    pub measured: Preprocessed,
}

impl PreprocessRow {
    pub(super) fn new(knob: &str, level: &str, measured: Preprocessed) -> Self {
        Self { knob: knob.into(), level: level.into(), measured }
    }
}

/// The solver as a way to animate.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct SolverRow {
    /// Tolerance and template.
    pub method: String,
    /// Vertices of all garments.
    pub vertices: usize,
    /// Processor time of a frame of all garments [ms].
    pub frame_ms: f64,
    /// Frames whose forces did not come below the tolerance, of how many.
    pub unconverged: [usize; 2],
    /// Against the finest solver.
    pub error: Errors,
    /// What budgets may take of it; none for a method that is only measured.
    pub offer: Option<Offer>,
}

/// The solver as a point that can be chosen.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Offer {
    /// Templates and the solver's settings, as `caphy run --set` takes them.
    pub set: Vec<String>,
    /// Errors on other motion.
    pub check: Errors,
}

/// Everything that was measured.
#[derive(Debug, Serialize)]
pub struct Results {
    /// The experiment.
    pub scene: String,
    /// The machine.
    pub machine: String,
    /// Whether everything was measured, or the sweep still goes on.
    pub complete: bool,
    /// Whether trainings are as long as the experiment's own.
    pub full: bool,
    /// Vertices of the yardstick.
    pub yardstick_vertices: usize,
    /// Frames of the yardstick whose forces did not come below the tolerance, of how many.
    pub yardstick_unconverged: [usize; 2],
    /// Distance of disturbed restarts of the solver from it, on the sweep's motion and on the other.
    pub floors: [Errors; 2],
    /// Trained points.
    pub rows: Vec<Row>,
    /// The solver, and skinning alone.
    pub solver: Vec<SolverRow>,
    /// Ways to preprocess.
    pub preprocess: Vec<PreprocessRow>,
    /// Single against double precision.
    pub precision: Vec<Precision>,
    /// Least and largest cost that was measured: of a frame, over all ways to animate [ms].
    pub span: [f64; 2],
    /// What budgets choose from.
    pub front: Front,
    /// What presets choose.
    pub presets: Vec<(Preset, Pick)>,
}

impl Results {
    pub(super) fn new(sweep: &Tradeoff, machine: String, yardstick: &Yardstick) -> Self {
        let scene = sweep.path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        Self {
            front: Front {
                scene: scene.clone(),
                machine: machine.clone(),
                floor_mm: 0.0,
                spread_mm: 0.0,
                points: Vec::new(),
            },
            scene,
            machine,
            complete: false,
            full: sweep.full,
            yardstick_vertices: yardstick.vertices,
            yardstick_unconverged: yardstick.unconverged,
            floors: yardstick.floors,
            rows: Vec::new(),
            solver: Vec::new(),
            preprocess: Vec::new(),
            precision: Vec::new(),
            span: [0.0; 2],
            presets: Vec::new(),
        }
    }
    /// A point; one that is there under another name already is left out.
    pub(super) fn add(&mut self, row: Row) {
        self.rows.push(row);
    }
    /// The experiment's own point.
    pub(super) fn own(&self) -> Option<&Row> {
        self.rows.iter().find(|r| r.knob.is_empty())
    }
    /// Standard deviation of the error between trainings that differ in their seed only [mm].
    pub(super) fn spread_mm(&self) -> f64 {
        let errors: Vec<f64> =
            self.rows.iter().filter(|r| r.knob.is_empty()).map(|r| r.measured.error.surface_mm).collect();
        deviation(&errors)
    }
    /// Whether another point that could be chosen costs no more of anything and has a smaller error.
    pub(super) fn is_beaten(&self, row: &Row) -> bool {
        let costs = |r: &Row| [r.measured.error.surface_mm, r.measured.frame_ms, r.measured.train_s];
        let own = costs(row);
        let candidates = self.rows.iter().filter(|r| !r.of_fabric && !std::ptr::eq(*r, row));
        candidates.map(costs).any(|other| (0..3).all(|i| other[i] <= own[i]) && other != own)
    }
    /// Front, presets, times to quality: what all points so far say together.
    fn conclude(&mut self) {
        let own = self.own().cloned();
        if let Some(own) = &own {
            let target = last_level(&own.measured.curve);
            for row in &mut self.rows {
                let comparable = row.measured.vertices == own.measured.vertices && !row.of_fabric;
                row.quality_s = comparable
                    .then(|| reached(&row.measured.curve, target))
                    .flatten()
                    .map(|share| share * row.measured.train_s);
            }
        }
        let [floor, floor_check] = self.floors.map(|f| f.surface_mm);
        let candidates = self.rows.iter().filter(|r| !r.of_fabric && r.repeat == 0).map(|row| Candidate {
            name: row.name(),
            set: row.fixed.clone(),
            error_mm: (row.measured.error.surface_mm - floor).max(0.0),
            check_mm: (row.measured.check.surface_mm - floor_check).max(0.0),
            frame_ms: row.measured.frame_ms,
            train_s: row.measured.train_s,
            solver: false,
        });
        let simulated = self.solver.iter().filter_map(|row| {
            let offer = row.offer.as_ref()?;
            Some(Candidate {
                name: format!("the solver, {}", row.method),
                set: offer.set.clone(),
                error_mm: (row.error.surface_mm - floor).max(0.0),
                check_mm: (offer.check.surface_mm - floor_check).max(0.0),
                frame_ms: row.frame_ms,
                train_s: 0.0,
                solver: true,
            })
        });
        let points: Vec<Candidate> = candidates.chain(simulated).collect();
        self.front.spread_mm = self.spread_mm();
        self.front.floor_mm = floor;
        self.front.points = points;
        let may = |_: &Candidate| true;
        self.presets = Preset::ALL.iter().filter_map(|&p| Some((p, self.front.preset(p, &may)?))).collect();
        let times: Vec<f64> =
            self.solver.iter().map(|r| r.frame_ms).chain(self.rows.iter().map(|r| r.measured.frame_ms)).collect();
        self.span = [times.iter().copied().fold(f64::INFINITY, f64::min), times.iter().copied().fold(0.0, f64::max)];
    }
    /// Writes everything, with what follows from it, into a folder.
    pub(super) fn write(&mut self, folder: &Path) -> Result<()> {
        self.conclude();
        let json = serde_json::to_vec_pretty(self)
            .map_err(|e| Error::numerics("tradeoff.json", e.to_string(), "report this as a defect"))?;
        write_atomically(&folder.join("tradeoff.json"), &json)?;
        write_atomically(&folder.join("tradeoff.txt"), self.text().as_bytes())?;
        write_atomically(&folder.join("report.html"), page::page(self).as_bytes())
    }

    /// As text, with what it means.
    pub fn text(&self) -> String {
        let mut out = String::new();
        for (title, head, rows) in self.tables() {
            let _ = writeln!(out, "{title}");
            let _ = writeln!(out, "{}", aligned(&head, &rows));
        }
        let _ = writeln!(out, "{}", self.facts().join("\n"));
        out
    }

    /// All tables: title, heads, rows.
    pub(super) fn tables(&self) -> Vec<(&'static str, Vec<String>, Vec<Vec<String>>)> {
        let text = |list: &[&str]| list.iter().map(|s| s.to_string()).collect::<Vec<_>>();
        let optional = |v: Option<f64>| v.map_or("–".into(), number);
        let mut out = Vec::new();
        let floor = self.floors[0].surface_mm;
        let head = [
            &[
                "",
                "vertices",
                "train, s",
                "wall, s",
                "step, ms",
                "frame, ms",
                "MiB",
                "to quality, s",
                "error over floor, mm",
                "other motion, mm",
            ][..],
            &Errors::NAMES[..],
        ];
        let rows = self.rows.iter().map(|r| {
            let m = &r.measured;
            let mut cells = vec![
                r.name(),
                m.vertices.to_string(),
                number(m.train_s),
                number(m.train_wall_s),
                number(m.step_ms),
                number(m.frame_ms),
                m.peak_mib.map_or("–".into(), |v| format!("{v:.0}")),
                optional(r.quality_s),
                number((m.error.surface_mm - floor).max(0.0)),
                number((m.check.surface_mm - self.floors[1].surface_mm).max(0.0)),
            ];
            cells.extend(m.error.values().map(number));
            cells
        });
        out.push(("Nets", text(&head.concat()), rows.collect()));
        let head = [
            &["", "vertices", "frame, ms", "not converged", "error over floor, mm", "other motion, mm"][..],
            &Errors::NAMES[..],
        ];
        let rows = self.solver.iter().map(|r| {
            let [open, all] = r.unconverged;
            let mut cells = vec![
                r.method.clone(),
                r.vertices.to_string(),
                number(r.frame_ms),
                if all == 0 { "–".into() } else { format!("{open} of {all}") },
                number((r.error.surface_mm - floor).max(0.0)),
                optional(r.offer.as_ref().map(|o| (o.check.surface_mm - self.floors[1].surface_mm).max(0.0))),
            ];
            cells.extend(r.error.values().map(number));
            cells
        });
        out.push(("The solver, and skinning alone", text(&head.concat()), rows.collect()));
        if !self.preprocess.is_empty() {
            let head = ["", "processor, s", "wall, s", "wrong labels, %", "body, mm", "scans left out"];
            let rows = self.preprocess.iter().map(|r| {
                let m = &r.measured;
                vec![
                    format!("{} {}", r.knob, r.level).trim().to_string(),
                    number(m.processor_s),
                    number(m.wall_s),
                    optional(m.wrong_labels.map(|v| 100.0 * v)),
                    number(m.body_mm),
                    m.skipped.to_string(),
                ]
            });
            out.push(("Preprocessing", text(&head), rows.collect()));
        }
        let head = ["", "single, ms per frame", "double, ms per frame", "energy differs by", "forces differ by"];
        let rows = self.precision.iter().map(|p| {
            let [single, double] = p.frame_ms.map(number);
            vec![p.garment.clone(), single, double, format!("{:.1e}", p.energy), format!("{:.1e}", p.force)]
        });
        out.push(("Energies and forces in single and in double precision", text(&head), rows.collect()));
        let head = ["", "point", "error over floor, mm", "other motion, mm", "train, s", "frame, ms", "why"];
        let rows = self.presets.iter().map(|(preset, pick)| {
            let p = &pick.point;
            vec![
                preset.to_string(),
                p.name.clone(),
                number(p.error_mm),
                number(p.check_mm),
                number(p.train_s),
                number(p.frame_ms),
                pick.because.clone(),
            ]
        });
        out.push(("Presets", text(&head), rows.collect()));
        out
    }

    /// Sentences beside the tables.
    pub(super) fn facts(&self) -> Vec<String> {
        let [least, most] = self.span;
        let [floor, other] = self.floors.map(|f| number(f.surface_mm));
        let [open, all] = self.yardstick_unconverged;
        let loads = self.rows.iter().filter_map(|r| r.measured.load);
        let mut out = vec![
            format!(
                "Machine: {}, with {} processes running or waiting while points were trained. Times are processor times unless they say wall; a frame of nets or skinning takes the least time of many plays.",
                self.machine,
                match (loads.clone().reduce(f64::min), loads.reduce(f64::max)) {
                    (Some(least), Some(most)) => format!("{} to {}", number(least), number(most)),
                    _ => "an unknown number of".into(),
                }
            ),
            format!(
                "Errors are distances between surfaces from the solver on {} vertices, over the floor: restarts of the solver, begun earlier and disturbed, lie {floor} mm from it ({other} mm on the other motion). In {open} of {all} of its frames forces did not come below the tolerance.",
                self.yardstick_vertices
            ),
            format!(
                "Trainings that differ in their seed only scatter by {} mm (standard deviation).",
                number(self.front.spread_mm)
            ),
            format!("The dearest frame costs {} times the cheapest.", number(most / least)),
        ];
        if !self.complete {
            out.push("The sweep is not complete.".into());
        }
        if !self.full {
            out.push("Trainings are shorter than the experiment's own: knobs are compared at equal, few rounds. `--full` takes its own.".into());
        }
        out
    }
}

/// Standard deviation of a sample; 0 of fewer than two.
fn deviation(values: &[f64]) -> f64 {
    let count = values.len() as f64;
    if values.len() < 2 {
        return 0.0;
    }
    let mean = values.iter().sum::<f64>() / count;
    (values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (count - 1.0)).sqrt()
}

/// Points of a curve that are averaged: single batches scatter.
const AVERAGED: usize = 5;

/// Mean energy at the end of a training; infinite without a curve.
fn last_level(curve: &[(f64, f64)]) -> f64 {
    let tail = &curve[curve.len().saturating_sub(AVERAGED)..];
    if tail.is_empty() { f64::NEG_INFINITY } else { tail.iter().map(|p| p.1).sum::<f64>() / tail.len() as f64 }
}

/// Share of a training after which its mean energy was at a level.
fn reached(curve: &[(f64, f64)], level: f64) -> Option<f64> {
    let window = AVERAGED.min(curve.len());
    if window == 0 {
        return None;
    }
    curve.windows(window).find(|w| w.iter().map(|p| p.1).sum::<f64>() / window as f64 <= level).map(|w| w[window - 1].0)
}

fn aligned(head: &[String], rows: &[Vec<String>]) -> String {
    let width = |column: usize| {
        let all = std::iter::once(head).chain(rows.iter().map(Vec::as_slice));
        all.map(|row| row.get(column).map_or(0, |cell| cell.chars().count())).max().unwrap_or(0)
    };
    let widths: Vec<usize> = (0..head.len()).map(width).collect();
    let mut out = String::new();
    for row in std::iter::once(head).chain(rows.iter().map(Vec::as_slice)) {
        let mut line = String::new();
        for (column, (cell, width)) in row.iter().zip(&widths).enumerate() {
            let pad = " ".repeat(width - cell.chars().count());
            // Names to the left, numbers to the right.
            let _ = if column == 0 { write!(line, "{cell}{pad}") } else { write!(line, "  {pad}{cell}") };
        }
        let _ = writeln!(out, "  {}", line.trim_end());
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn time_to_quality_is_read_off_the_curve() {
        let curve = |scale: f64| (1..=20).map(|i| (f64::from(i) / 20.0, scale / f64::from(i))).collect::<Vec<_>>();
        let level = last_level(&curve(1.0));
        assert_eq!(reached(&curve(1.0), level), Some(1.0));
        // With twice the energy everywhere it is never reached, with half of it long before.
        assert_eq!(reached(&curve(2.0), level), None);
        assert!(reached(&curve(0.5), level).is_some_and(|s| (0.4..0.7).contains(&s)));
        assert_eq!(reached(&[], level), None);
        assert!((deviation(&[1.0, 2.0, 3.0]) - 1.0).abs() < 1e-12 && deviation(&[1.0]) == 0.0);
    }
}
