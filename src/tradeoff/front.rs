//! A measured front, and the point on it that a budget picks.

use caphy_core::{Error, Result};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Measured points of one scene.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Front {
    /// The experiment that was measured.
    pub scene: String,
    /// The machine that it was measured on.
    pub machine: String,
    /// Distance of the solver from itself [mm]; errors below are over it.
    pub floor_mm: f64,
    /// Standard deviation of the error between trainings that differ in their seed only [mm].
    pub spread_mm: f64,
    /// The points.
    pub points: Vec<Candidate>,
}

/// A point that can be chosen.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Candidate {
    /// For people.
    pub name: String,
    /// Values of all knobs that act on the net, as `caphy run --set` takes them.
    pub set: Vec<String>,
    /// Distance from the reference solver's surface over the floor, on the motion of the sweep [mm].
    pub error_mm: f64,
    /// The same on other motion, by which nothing is chosen [mm].
    pub check_mm: f64,
    /// Processor time of an animated frame [ms].
    pub frame_ms: f64,
    /// Processor time of training [s]; 0 for the solver.
    pub train_s: f64,
    /// Whether the reference solver makes the frames instead of a net: taken where no net keeps a budget.
    #[serde(default, skip_serializing_if = "is_false")]
    pub solver: bool,
}

fn is_false(value: &bool) -> bool {
    !value
}

/// A point by name, as measurements make it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Preset {
    /// The most accurate point that trains in a fifth of `balanced`'s time.
    Preview,
    /// The cheapest training whose error is that of `reference` within the spread of seeds, or a tenth of it.
    Balanced,
    /// The smallest error.
    Reference,
}

impl Preset {
    /// All of them, cheapest first.
    pub const ALL: [Preset; 3] = [Self::Preview, Self::Balanced, Self::Reference];
}

impl Candidate {
    /// The error that budgets compare [mm]. Nothing is trained for the solver, so that it may be chosen by both motions: folds of another mesh
    /// go their own ways, on one motion more than on another.
    fn judged_mm(&self) -> f64 {
        if self.solver { self.error_mm.max(self.check_mm) } else { self.error_mm }
    }
}

impl std::fmt::Display for Preset {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Preview => "preview",
            Self::Balanced => "balanced",
            Self::Reference => "reference",
        })
    }
}

/// What is asked of a point.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Bounds {
    /// Largest error over the floor [mm]: the cheapest training that keeps it is picked.
    pub error_mm: Option<f64>,
    /// Longest processor time of an animated frame [ms]: the smallest error within it is picked.
    pub time_ms: Option<f64>,
    /// Longest processor time of training [s], likewise.
    pub train_s: Option<f64>,
}

/// A picked point and why.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Pick {
    /// The point.
    pub point: Candidate,
    /// Why it and no other.
    pub because: String,
}

/// Presets: how much faster a preview trains.
const PREVIEW: f64 = 5.0;
/// Share by which `balanced` may be worse than the smallest error.
const BALANCED: f64 = 0.1;

fn cheapest<'a>(points: impl Iterator<Item = &'a Candidate>) -> Option<&'a Candidate> {
    points.min_by(|a, b| a.train_s.total_cmp(&b.train_s))
}

/// The front that is part of the program: the one of `docs/trade.md`.
const EMBEDDED: &str = include_str!("../../docs/trade/front.json");

impl Front {
    /// The front that is part of the program.
    ///
    /// # Errors
    /// [`Error::Numerics`] for a program that was built with a damaged one.
    pub fn embedded() -> Result<Self> {
        serde_json::from_str(EMBEDDED)
            .map_err(|e| Error::numerics("docs/trade/front.json", e.to_string(), "build the program anew"))
    }
    /// From a file, `tradeoff.json` or its `front` alone.
    ///
    /// # Errors
    /// [`Error::Io`], [`Error::Format`].
    pub fn read(path: &Path) -> Result<Self> {
        #[derive(Deserialize)]
        struct Whole {
            front: Front,
        }
        let text = std::fs::read(path).map_err(|e| Error::io(path, "read", e))?;
        let whole = serde_json::from_slice::<Whole>(&text).map(|whole| whole.front);
        let front = match whole {
            Ok(front) => front,
            Err(_) => serde_json::from_slice::<Front>(&text).map_err(|e| {
                let at = format!("line {}", e.line());
                Error::format(path, at, e.to_string(), "give the tradeoff.json that `caphy tradeoff` has written")
            })?,
        };
        if front.points.is_empty() {
            return Err(Error::format(
                path,
                "front.points",
                "there is no point",
                "let `caphy tradeoff` measure the net",
            ));
        }
        Ok(front)
    }
    /// Nets that no other one beats in error, frame time and training time together; least error first.
    pub fn undominated(&self) -> Vec<&Candidate> {
        let costs = |c: &Candidate| [c.error_mm, c.frame_ms, c.train_s];
        let beats = |a: &Candidate, b: &Candidate| {
            let (a, b) = (costs(a), costs(b));
            (0..3).all(|i| a[i] <= b[i]) && (0..3).any(|i| a[i] < b[i])
        };
        let nets = || self.points.iter().filter(|c| !c.solver);
        let mut out: Vec<&Candidate> = nets().filter(|p| !nets().any(|other| beats(other, p))).collect();
        out.sort_by(|a, b| a.error_mm.total_cmp(&b.error_mm));
        out
    }
    /// The point of a preset, among those that `may` be chosen; none where no point may.
    pub fn preset(&self, preset: Preset, may: &dyn Fn(&Candidate) -> bool) -> Option<Pick> {
        let front: Vec<&Candidate> = self.undominated().into_iter().filter(|c| may(c)).collect();
        let best = *front.first()?;
        let within = best.error_mm + self.spread_mm.max(BALANCED * best.error_mm);
        let balanced = cheapest(front.iter().copied().filter(|c| c.error_mm <= within))?.clone();
        let pick = |point: Candidate, because: String| Some(Pick { point, because });
        match preset {
            Preset::Reference => pick(best.clone(), "the smallest error".into()),
            Preset::Balanced => pick(
                balanced,
                format!(
                    "the cheapest training within {within:.2} mm: the smallest error, {:.2} mm, and its spread",
                    best.error_mm
                ),
            ),
            Preset::Preview => {
                let most = balanced.train_s / PREVIEW;
                match front.iter().find(|c| c.train_s <= most) {
                    Some(point) => pick(
                        (*point).clone(),
                        format!("the smallest error among trainings of at most {most:.1} s, a fifth of `balanced`"),
                    ),
                    None => {
                        let point = cheapest(front.iter().copied())?.clone();
                        let times = balanced.train_s / point.train_s;
                        pick(
                            point,
                            format!("the cheapest training; `balanced` takes {times:.1} times as long, no five"),
                        )
                    }
                }
            }
        }
    }
    /// The point within bounds, among those that `may` be chosen; the solver where no net is.
    ///
    /// # Errors
    /// [`Error::Config`] where nothing fits, naming what is nearest.
    pub fn within(&self, bounds: &Bounds, may: &dyn Fn(&Candidate) -> bool) -> Result<Pick> {
        let front: Vec<&Candidate> = self.undominated().into_iter().filter(|c| may(c)).collect();
        let asked: [(&str, Option<f64>, fn(&Candidate) -> f64, &str); 3] = [
            ("error_mm", bounds.error_mm, Candidate::judged_mm, "mm"),
            ("time_ms", bounds.time_ms, |c| c.frame_ms, "ms per frame"),
            ("train_s", bounds.train_s, |c| c.train_s, "s of training"),
        ];
        // By how much the worst bound is missed; 0 where all are kept.
        let missed = |c: &Candidate| {
            let over = asked.iter().filter_map(|(_, bound, value, _)| Some(value(c) / (*bound)?));
            (over.fold(0.0f64, f64::max) - 1.0).max(0.0)
        };
        let fitting: Vec<&Candidate> = front.iter().copied().filter(|c| missed(c) == 0.0).collect();
        let told: Vec<String> =
            asked.iter().filter_map(|(key, bound, ..)| Some(format!("{key} = {}", (*bound)?))).collect();
        let told = told.join(", ");
        let facts = |c: &Candidate| {
            let all = asked.iter().map(|(.., value, unit)| format!("{:.2} {unit}", value(c)));
            all.collect::<Vec<_>>().join(", ")
        };
        let least = |value: fn(&Candidate) -> f64| fitting.iter().min_by(|a, b| value(a).total_cmp(&value(b)));
        let picked = match bounds.error_mm {
            Some(_) => least(|c| c.train_s).map(|c| (c, "the cheapest training of those that fit")),
            None => least(|c| c.error_mm).map(|c| (c, "the smallest error of those that fit")),
        };
        if let Some((point, why)) = picked {
            let because = format!("{why} {told}: {} of {} points of the front do", fitting.len(), front.len());
            return Ok(Pick { point: (*point).clone(), because });
        }
        let simulated = self.points.iter().filter(|c| c.solver && may(c));
        // Nets are trained all the same, and how long is not the solver's to say.
        let simulated = simulated.filter(|c| bounds.train_s.is_none() && missed(c) == 0.0);
        if let Some(point) = simulated.min_by(|a, b| a.frame_ms.total_cmp(&b.frame_ms)) {
            let because = format!("no net keeps {told}; the cheapest way to simulate that does");
            return Ok(Pick { point: point.clone(), because });
        }
        let nearest = front.iter().min_by(|a, b| missed(a).total_cmp(&missed(b)));
        let remedy = match nearest {
            Some(c) => format!("the nearest is “{}”: {}; the solver itself is `caphy simulate`", c.name, facts(c)),
            None => "choose another front".into(),
        };
        Err(Error::config("budget", format!("no point measured on {} keeps {told}", self.scene), remedy))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn point(name: &str, error_mm: f64, frame_ms: f64, train_s: f64) -> Candidate {
        let (name, set) = (name.into(), Vec::new());
        Candidate { name, set, error_mm, check_mm: error_mm, frame_ms, train_s, solver: false }
    }

    fn front() -> Front {
        Front {
            scene: "test".into(),
            machine: "paper".into(),
            floor_mm: 0.1,
            spread_mm: 0.2,
            points: vec![
                point("slow", 2.0, 3.0, 100.0),
                point("own", 2.15, 3.0, 40.0),
                point("beaten", 2.5, 3.0, 41.0),
                point("small", 4.0, 0.5, 8.0),
                point("quick", 6.0, 1.0, 2.0),
                point("frames", 9.0, 0.1, 50.0),
            ],
        }
    }

    const ANY: &dyn Fn(&Candidate) -> bool = &|_| true;

    #[test]
    fn dominated_points_are_not_on_the_front() {
        let front = front();
        let names: Vec<&str> = front.undominated().iter().map(|c| c.name.as_str()).collect();
        assert_eq!(names, ["slow", "own", "small", "quick", "frames"]);
        // Of two equal points neither beats the other.
        let twice = Front { points: vec![front.points[0].clone(), front.points[0].clone()], ..front };
        assert_eq!(twice.undominated().len(), 2);
    }

    #[test]
    fn budgets_pick_the_cheapest_or_the_best() {
        let front = front();
        let pick =
            |error_mm, time_ms, train_s| front.within(&Bounds { error_mm, time_ms, train_s }, ANY).unwrap().point.name;
        assert_eq!(pick(Some(3.0), None, None), "own");
        assert_eq!(pick(Some(2.0), None, None), "slow");
        assert_eq!(pick(None, Some(0.5), None), "small");
        assert_eq!(pick(None, None, Some(10.0)), "small");
        assert_eq!(pick(Some(5.0), Some(1.0), None), "small");
        let because = front.within(&Bounds { error_mm: Some(3.0), ..Bounds::default() }, ANY).unwrap().because;
        assert!(because.contains("error_mm = 3") && because.contains("2 of 5"), "{because}");
        let restricted: &dyn Fn(&Candidate) -> bool = &|c| c.name != "own";
        assert_eq!(
            front.within(&Bounds { error_mm: Some(3.0), ..Bounds::default() }, restricted).unwrap().point.name,
            "slow"
        );
    }

    #[test]
    fn the_solver_is_taken_where_no_net_keeps_a_budget() {
        let mut front = front();
        let presets = Preset::ALL.map(|p| front.preset(p, ANY).unwrap());
        for (name, error_mm, frame_ms) in [("exact", 0.1, 1000.0), ("rough", 1.0, 300.0)] {
            front.points.push(Candidate { solver: true, ..point(name, error_mm, frame_ms, 0.0) });
        }
        assert_eq!(Preset::ALL.map(|p| front.preset(p, ANY).unwrap()), presets);
        let pick = |bounds: Bounds| front.within(&bounds, ANY);
        let error = |error_mm: f64| Bounds { error_mm: Some(error_mm), ..Bounds::default() };
        assert_eq!(pick(error(2.0)).unwrap().point.name, "slow");
        let picked = pick(error(1.5)).unwrap();
        assert!(picked.point.name == "rough" && picked.because.contains("no net"), "{picked:?}");
        assert_eq!(pick(error(0.5)).unwrap().point.name, "exact");
        // What is only near on one motion is not near enough.
        let worse = Candidate { check_mm: 1.6, ..front.points[front.points.len() - 1].clone() };
        let kept = Front { points: [&front.points[..front.points.len() - 1], &[worse]].concat(), ..front.clone() };
        assert_eq!(kept.within(&error(1.5), ANY).unwrap().point.name, "exact");
        // Too slow, not exact enough, or a bound on what the solver does not do.
        for bounds in
            [Bounds { time_ms: Some(100.0), ..error(1.5) }, error(0.05), Bounds { train_s: Some(1.0), ..error(1.5) }]
        {
            let said = pick(bounds).unwrap_err().to_string();
            assert!(said.contains("error_mm"), "{said}");
        }
        let nets_only: &dyn Fn(&Candidate) -> bool = &|c| !c.solver;
        assert!(front.within(&error(1.5), nets_only).is_err());
    }

    #[test]
    fn what_does_not_fit_is_told_with_the_nearest() {
        let front = front();
        for (bounds, nearest) in [
            (Bounds { error_mm: Some(1.5), ..Bounds::default() }, "slow"),
            (Bounds { time_ms: Some(0.05), ..Bounds::default() }, "frames"),
            // Half of 4 mm is missed by 1, a third of 9 mm by 2.
            (Bounds { error_mm: Some(2.0), time_ms: Some(0.5), train_s: None }, "small"),
        ] {
            let said = front.within(&bounds, ANY).unwrap_err().to_string();
            assert!(said.contains(&format!("“{nearest}”")) && said.contains("caphy simulate"), "{said}");
        }
    }

    #[test]
    fn presets_follow_from_measurements() {
        let mut front = front();
        let name = |front: &Front, preset| front.preset(preset, ANY).unwrap().point.name;
        assert_eq!(Preset::ALL.map(|p| name(&front, p)), ["small", "own", "slow"]);
        // Without anything cheap enough the cheapest, and it says so.
        front.points.retain(|c| c.train_s > 30.0);
        let pick = front.preset(Preset::Preview, ANY).unwrap();
        assert_eq!(pick.point.name, "own");
        assert!(pick.because.contains("1.0 times"), "{}", pick.because);
        assert!(front.preset(Preset::Preview, &|_| false).is_none());
    }

    #[test]
    fn the_embedded_front_is_one() {
        let front = Front::embedded().unwrap();
        for preset in Preset::ALL {
            assert!(front.preset(preset, ANY).is_some());
        }
        let times = [Preset::Preview, Preset::Balanced].map(|p| front.preset(p, ANY).unwrap().point.train_s);
        assert!(times[1] >= 5.0 * times[0], "{times:?}");
        for point in &front.points {
            point.set.iter().for_each(|text| drop(crate::config::Setting::parse(text).unwrap()));
        }
    }

    #[test]
    fn damaged_fronts_are_named() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("tradeoff.json");
        assert!(Front::read(&path).unwrap_err().to_string().contains("tradeoff.json"));
        for (text, word) in [
            ("{\"front\": 3}", "line"),
            ("{", "line"),
            ("{\"scene\":\"\",\"machine\":\"\",\"floor_mm\":0,\"spread_mm\":0,\"points\":[]}", "no point"),
        ] {
            std::fs::write(&path, text).unwrap();
            let said = Front::read(&path).unwrap_err().to_string();
            assert!(said.contains(word) && said.contains("caphy tradeoff"), "{said}");
        }
        let whole = serde_json::json!({ "front": front(), "other": 1 });
        std::fs::write(&path, whole.to_string()).unwrap();
        assert_eq!(Front::read(&path).unwrap(), front());
    }
}
