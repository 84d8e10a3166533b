//! Knobs turned together: greedily, towards cheaper trainings and towards smaller errors, along what paid one by one.

use super::knobs::{Acts, Knob, Level};
use super::table::{Results, Row};
use crate::config::Setting;

/// A template that the solver moves.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Mesh {
    /// The coarsest of the sweep.
    Coarse,
    /// The experiment's own.
    Own,
    /// The finest of the sweep, which the yardstick has.
    Fine,
}

/// A way to animate by the solver, without a net.
#[derive(Debug)]
pub(super) struct Method {
    pub(super) name: &'static str,
    /// Largest force left on a vertex [N]; none: no solver, skinning alone.
    pub(super) tolerance_n: Option<f64>,
    pub(super) mesh: Mesh,
    /// Whether budgets may take it: it is measured on the other motion, too.
    pub(super) offered: bool,
}

const fn method(name: &'static str, tolerance_n: Option<f64>, mesh: Mesh, offered: bool) -> Method {
    Method { name, tolerance_n, mesh, offered }
}

/// The solver's knobs: tolerance and template.
pub(super) const SOLVERS: &[Method] = &[
    method("skinning alone", None, Mesh::Own, false),
    method("1e-2 N, coarse template", Some(1e-2), Mesh::Coarse, true),
    method("1e-1 N", Some(1e-1), Mesh::Own, false),
    method("1e-2 N", Some(1e-2), Mesh::Own, true),
    method("1e-2 N, fine template", Some(1e-2), Mesh::Fine, true),
];

/// Where a walk leads.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Direction {
    Cheaper,
    Better,
}

impl Direction {
    pub(super) const ALL: [Direction; 2] = [Self::Cheaper, Self::Better];
}

/// A level that paid, one of its knob.
#[derive(Debug, Clone, PartialEq)]
struct Paid {
    knob: &'static str,
    level: String,
    set: Vec<Setting>,
    /// Change of log cost and of the error [mm] against the experiment's own point, per unit of the other.
    gain: f64,
}

/// Adds level after level to the experiment's own point, the ones that paid most first, one of each knob; a level after which some
/// other point is both cheaper and better is taken back.
pub(super) struct Walk {
    waiting: Vec<Paid>,
    kept: Vec<Paid>,
    left: usize,
    tried: Option<Paid>,
}

/// Whether settings would undo each other: one key is the other or stands inside of it.
fn clash(a: &[Setting], b: &[Setting]) -> bool {
    let inside =
        |inner: &str, outer: &str| inner == outer || inner.strip_prefix(outer).is_some_and(|r| r.starts_with('.'));
    a.iter().any(|a| b.iter().any(|b| inside(&a.key(), &b.key()) || inside(&b.key(), &a.key())))
}

/// Cost that walks go by: of training, and of frames as far as they differ.
fn cost(row: &Row) -> f64 {
    (row.measured.train_s * row.measured.frame_ms).max(f64::MIN_POSITIVE).ln()
}

impl Walk {
    pub(super) fn new(direction: Direction, results: &Results, levels: &[(&'static Knob, Level)], most: usize) -> Self {
        let mut waiting: Vec<Paid> = Vec::new();
        let Some(own) = results.own() else { return Self { waiting, kept: Vec::new(), left: 0, tried: None } };
        let spread = results.spread_mm().max(0.01 * own.measured.error.surface_mm);
        for (knob, level) in levels.iter().filter(|(knob, _)| knob.acts == Acts::Net) {
            let Some(row) = results.rows.iter().find(|r| r.knob == knob.name && r.level == level.name) else {
                continue;
            };
            let saved = cost(own) - cost(row);
            let worse = row.measured.error.surface_mm - own.measured.error.surface_mm;
            let gain = match direction {
                Direction::Cheaper if saved > 0.05 => saved / worse.max(spread),
                Direction::Better if worse < -spread => -worse / (-saved).max(0.05),
                _ => continue,
            };
            let paid = Paid { knob: knob.name, level: level.name.clone(), set: level.set.clone(), gain };
            match waiting.iter_mut().find(|other| other.knob == paid.knob || clash(&other.set, &paid.set)) {
                Some(other) if other.gain < paid.gain => *other = paid,
                Some(_) => {}
                None => waiting.push(paid),
            }
        }
        waiting.sort_by(|a, b| a.gain.total_cmp(&b.gain));
        // The best alone is measured already.
        let kept: Vec<Paid> = waiting.pop().into_iter().collect();
        Self { waiting, kept, left: most, tried: None }
    }

    /// The next combination, by name and settings; looks at how the last one did.
    pub(super) fn next(&mut self, results: &Results) -> Option<(String, Vec<Setting>)> {
        if let (Some(tried), Some(row)) = (self.tried.take(), results.rows.last())
            && !results.is_beaten(row)
        {
            self.kept.push(tried);
        }
        self.left = self.left.checked_sub(1)?;
        let next = self.waiting.pop()?;
        let all = || self.kept.iter().chain([&next]);
        let name = all().map(|p| format!("{} {}", p.knob, p.level)).collect::<Vec<_>>().join(", ");
        let set = all().flat_map(|p| p.set.clone()).collect();
        self.tried = Some(next);
        Some((name, set))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn settings_that_undo_each_other_are_told() {
        let of = |text: &str| vec![Setting::parse(text).unwrap()];
        assert!(clash(&of("net={ type = \"mlp\" }"), &of("net.hidden=3")));
        assert!(clash(&of("train.rounds=1"), &of("train.rounds=2")));
        assert!(
            !clash(&of("net.layers=1"), &of("net.hidden=3")) && !clash(&of("train.window=1"), &of("train.windows=2"))
        );
    }
}
