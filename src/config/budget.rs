//! `[budget]`: a point of a measured front in place of values that nobody has set.

use super::Setting;
use crate::files::ProjectFiles;
use crate::tradeoff::{Bounds, Candidate, Front, Pick, Preset};
use caphy_core::{Error, Result};
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// `[budget]`: either a preset, or bounds.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct BudgetConfig {
    /// Largest distance from the reference solver over its floor [mm]: the cheapest training that keeps it is taken.
    pub error_mm: Option<f64>,
    /// Longest processor time of an animated frame [ms]: the smallest error within it is taken.
    pub time_ms: Option<f64>,
    /// Longest processor time of training [s], likewise.
    pub train_s: Option<f64>,
    /// `"preview"`, `"balanced"` or `"reference"`.
    pub preset: Option<Preset>,
    /// A `tradeoff.json`, relative to the configuration's folder unless absolute. Default: the front of `docs/trade.md`, which is part
    /// of the program.
    pub front: Option<PathBuf>,
}

/// What a budget has set.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Choice {
    /// The point and why it was picked.
    pub pick: Pick,
    /// Scene and machine of the front.
    pub measured_on: String,
    /// What it set, as `--set` takes it.
    pub set: Vec<String>,
    /// What the file sets otherwise and keeps: the point's error is then not that of this run.
    pub kept: Vec<String>,
}

impl Choice {
    /// In a sentence or two.
    pub fn text(&self) -> String {
        let Pick { point: p, because } = &self.pick;
        let mut out = format!(
            "“{}”: {because}. Measured on {}: {:.2} mm over the floor ({:.2} mm on other motion), {:.2} ms per frame, {}. Sets {}.",
            p.name,
            self.measured_on,
            p.error_mm,
            p.check_mm,
            p.frame_ms,
            if p.solver {
                "simulated: the avatar's nets are trained as the file has them".into()
            } else {
                format!("{:.1} s of training", p.train_s)
            },
            if self.set.is_empty() { "nothing: the file sets all of it".into() } else { self.set.join(", ") }
        );
        if !self.kept.is_empty() {
            out.push_str(&format!(
                " The file's own {} stay, so that this run is not what was measured.",
                self.kept.join(", ")
            ));
        }
        out
    }
}

impl BudgetConfig {
    fn check(&self) -> Result<()> {
        let bounds = [("error_mm", self.error_mm), ("time_ms", self.time_ms), ("train_s", self.train_s)];
        for (key, value) in bounds {
            if let Some(value) = value.filter(|v| !(v.is_finite() && *v > 0.0)) {
                return Err(Error::config(format!("budget.{key}"), value.to_string(), "give a positive number"));
            }
        }
        let bounded = bounds.iter().any(|(_, value)| value.is_some());
        match (self.preset, bounded) {
            (Some(_), true) => Err(Error::config("budget.preset", "is given beside bounds", "give one or the other")),
            (None, false) => {
                let remedy = "give error_mm, time_ms, train_s or preset";
                Err(Error::config("budget", "says nothing", remedy))
            }
            _ => Ok(()),
        }
    }
}

/// What a point says of a table: settings for what is not there, and what is there otherwise.
fn applied_to(table: &toml::Table, point: &Candidate) -> Result<(Vec<Setting>, Vec<String>)> {
    let (mut free, mut kept) = (Vec::new(), Vec::new());
    for text in &point.set {
        let setting = Setting::parse(text)?;
        let key = setting.key();
        let first = key.split('.').next().unwrap_or_default();
        // Garments that this experiment does not have.
        if ["upper", "lower"].contains(&first) && !table.contains_key(first) {
            continue;
        }
        let there = key.split('.').try_fold(None, |at: Option<&toml::Value>, part| {
            let next = match at {
                None => table.get(part),
                Some(value) => value.get(part),
            };
            next.map(Some)
        });
        match (there.flatten(), setting.value()) {
            (None, _) => free.push(setting.clone()),
            // A table of a type: what it leaves out may be filled in where the rest agrees.
            (Some(toml::Value::Table(own)), Some(toml::Value::Table(wanted))) => {
                if own.iter().any(|(k, v)| wanted.get(k) != Some(v)) {
                    kept.push(format!("`{key}`"));
                    continue;
                }
                for (k, v) in wanted.iter().filter(|(k, _)| !own.contains_key(*k)) {
                    free.push(Setting::new(&format!("{key}.{k}"), v.clone())?);
                }
            }
            (Some(own), wanted) if Some(own) != wanted => kept.push(format!("`{key}` = {own}")),
            _ => {}
        }
    }
    Ok((free, kept))
}

/// A table with what its `[budget]` sets, and what that was; the table itself where it has none, or one that cannot be read, which
/// whoever reads the whole table complains about.
///
/// # Errors
/// [`Error::Config`] for a budget that says nothing or that no point keeps; what [`Front::read`] gives.
pub(super) fn applied(mut table: toml::Table, files: &ProjectFiles) -> Result<(toml::Table, Option<Choice>)> {
    let read = table.get("budget").map(|value| value.clone().try_into::<BudgetConfig>());
    let Some(Ok(budget)) = read else { return Ok((table, None)) };
    budget.check()?;
    let front = match &budget.front {
        Some(path) => Front::read(&files.resolve(path)?)?,
        None => Front::embedded()?,
    };
    let agrees = |point: &Candidate| applied_to(&table, point).is_ok_and(|(_, kept)| kept.is_empty());
    // What is simulated is what `[animate]` plays.
    let nets_only = !table.contains_key("animate");
    let able = |point: &Candidate| !(point.solver && nets_only);
    // Where every point contradicts the file, the file's values hold all the same.
    let any = front.points.iter().any(|point| able(point) && agrees(point));
    let may = |point: &Candidate| able(point) && (!any || agrees(point));
    let pick = match budget.preset {
        Some(preset) => front.preset(preset, &may).ok_or_else(|| {
            Error::config("budget.front", "there is no point on it", "measure one with `caphy tradeoff`")
        })?,
        None => {
            let bounds = Bounds { error_mm: budget.error_mm, time_ms: budget.time_ms, train_s: budget.train_s };
            front.within(&bounds, &may)?
        }
    };
    let (free, kept) = applied_to(&table, &pick.point)?;
    free.iter().try_for_each(|setting| setting.apply(&mut table))?;
    let set = free.iter().map(Setting::to_string).collect();
    let measured_on = format!("“{}” ({})", front.scene, front.machine);
    Ok((table, Some(Choice { pick, measured_on, set, kept })))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn front(folder: &std::path::Path) -> ProjectFiles {
        let point = |name: &str, net: &str, rounds: usize, error_mm: f64, train_s: f64| Candidate {
            name: name.into(),
            set: vec![format!("net={net}"), format!("train.rounds={rounds}"), "lower.resolution_m=0.02".into()],
            error_mm,
            check_mm: error_mm,
            frame_ms: train_s / 10.0,
            train_s,
            solver: false,
        };
        let solver = Candidate {
            name: "simulated".into(),
            set: vec!["upper.resolution_m=0.03".into(), "animate.solver={ tolerance_n = 0.02 }".into()],
            solver: true,
            ..point("", "{ type = \"gru\" }", 1, 0.3, 0.0)
        };
        let points = vec![
            point("best", "{ type = \"gru\", layers = 4, hidden = 256 }", 24, 1.0, 100.0),
            point("middle", "{ type = \"gru\", layers = 2, hidden = 64 }", 12, 1.05, 30.0),
            point("small", "{ type = \"mlp\", hidden = [64] }", 6, 5.0, 4.0),
            solver,
        ];
        let front = Front { scene: "s".into(), machine: "m".into(), floor_mm: 0.0, spread_mm: 0.0, points };
        std::fs::write(folder.join("f.json"), serde_json::to_string(&front).unwrap()).unwrap();
        ProjectFiles::new(folder)
    }

    fn choose(text: &str) -> Result<(toml::Table, Option<Choice>)> {
        let folder = tempfile::tempdir().unwrap();
        let files = front(folder.path());
        applied(text.parse().unwrap(), &files)
    }

    #[test]
    fn what_nobody_has_set_is_set() {
        let (table, choice) = choose("[upper]\n[budget]\nerror_mm = 1.2\nfront = \"f.json\"").unwrap();
        let choice = choice.unwrap();
        assert_eq!(choice.pick.point.name, "middle");
        assert_eq!(table["net"]["hidden"].as_integer(), Some(64));
        assert_eq!(table["train"]["rounds"].as_integer(), Some(12));
        // No lower garment, so none of its values.
        assert_eq!((choice.set.len(), choice.kept.len(), table.contains_key("lower")), (2, 0, false));
        assert!(choice.text().contains("“middle”") && choice.text().contains("1.05 mm"), "{}", choice.text());
        for (preset, name) in [("preview", "small"), ("balanced", "middle"), ("reference", "best")] {
            let text = format!("[budget]\npreset = \"{preset}\"\nfront = \"f.json\"");
            assert_eq!(choose(&text).unwrap().1.unwrap().pick.point.name, name);
        }
    }

    #[test]
    fn what_is_animated_may_be_simulated() {
        let budget = "[upper]\n[budget]\nerror_mm = 0.5\nfront = \"f.json\"";
        let (table, choice) = choose(&format!("{budget}\n[animate]")).unwrap();
        let choice = choice.unwrap();
        assert!(choice.pick.point.solver && !table.contains_key("net"), "{choice:?}");
        assert_eq!(table["animate"]["solver"]["tolerance_n"].as_float(), Some(0.02));
        assert!(choice.text().contains("simulated:") && !choice.text().contains("s of training"), "{}", choice.text());
        // Nothing is animated: a budget is the nets' to keep.
        assert!(choose(budget).unwrap_err().to_string().contains("“best”"));
    }

    #[test]
    fn what_the_file_sets_stays() {
        // A type alone is completed by a point of that type.
        let with = "[net]\ntype = \"gru\"\n[budget]\ntime_ms = 3\nfront = \"f.json\"";
        let (table, choice) = choose(with).unwrap();
        assert_eq!(choice.unwrap().pick.point.name, "middle");
        assert_eq!(table["net"]["layers"].as_integer(), Some(2));
        // Among points that agree with the file none is quick enough.
        let said = choose("[net]\ntype = \"gru\"\n[budget]\ntime_ms = 1\nfront = \"f.json\"").unwrap_err().to_string();
        assert!(said.contains("time_ms = 1") && said.contains("“middle”"), "{said}");
        // No point has 7 rounds: the file's value holds, and that is said.
        let text = "[train]\nrounds = 7\n[budget]\ntime_ms = 1\nfront = \"f.json\"";
        let (table, choice) = choose(text).unwrap();
        let choice = choice.unwrap();
        assert_eq!((table["train"]["rounds"].as_integer(), choice.pick.point.name.as_str()), (Some(7), "small"));
        assert!(choice.text().contains("`train.rounds` = 7"), "{}", choice.text());
    }

    #[test]
    fn budgets_that_say_nothing_or_too_much_are_refused() {
        for (text, words) in [
            ("[budget]", ["budget", "error_mm"]),
            ("[budget]\nerror_mm = -1", ["budget.error_mm", "positive"]),
            ("[budget]\nerror_mm = 1\npreset = \"preview\"", ["budget.preset", "one or the other"]),
            ("[budget]\nerror_mm = 0.5\nfront = \"f.json\"", ["error_mm = 0.5", "“best”"]),
            ("[budget]\nerror_mm = 0.5\nfront = \"g.json\"", ["g.json", "read"]),
        ] {
            let said = choose(text).unwrap_err().to_string();
            assert!(words.iter().all(|w| said.contains(w)), "{words:?} in {said}");
        }
        assert_eq!(choose("[train]").unwrap().1, None);
    }
}
