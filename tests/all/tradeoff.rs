//! Knobs swept, interrupted, and chosen from by a budget.

use crate::commands::{caphy, refusal, text};
use crate::experiment::{Experiment, edited, files};
use crate::pipeline::assert_self_contained;
use serde_json::Value;
use std::path::Path;

/// A coarse shirt, a small net, two knobs.
const SWEPT: &str = r#"
[run]
out = "out"

[subject]
type = "dressed"

[body]
type = "mannequin"
resolution = 0.03

[upper]
material = { type = "stvk", young_pa = 0.7e5, poisson = 0.485, thickness_m = 0.47e-3, density_kg_per_m2 = 0.2 }
style = [0.3, 0.4, 0.015, 0.05]
resolution_m = 0.05

[net]
type = "gru"
layers = 1
hidden = 16

[motion]
clips = [{ type = "procedural", kind = "walk", seconds = 2 }]

[train]
rounds = 4
windows = 48
still_poses = 16

[tradeoff]
knobs = ["rounds", "hidden"]
rounds = 2
seeds = 2
from_s = 0
seconds = 0.3
combinations = 0
"#;

fn swept(at: &Path, arguments: &[&str]) -> (Value, String) {
    let output = caphy(at, &[&["tradeoff", "experiment.toml"], arguments].concat());
    let said = text(&output.stderr);
    assert!(output.status.success(), "{said}");
    let json = std::fs::read(at.join("out-tradeoff/tradeoff.json")).expect("results");
    (serde_json::from_slice(&json).expect("JSON"), text(&output.stdout) + &said)
}

/// What does not depend on how fast the machine is: errors of every point.
fn errors(results: &Value) -> Vec<(String, String, Value, Value)> {
    let rows = results["rows"].as_array().expect("rows");
    let of = |row: &Value| {
        let part = |key: &str| row[key].as_str().expect("a text").to_string();
        let measured = &row["measured"];
        (part("knob"), part("level"), measured["error"].clone(), measured["check"].clone())
    };
    // Which knobs are turned together depends on what they cost.
    rows.iter().map(of).filter(|row| row.0 != "together").collect()
}

#[test]
fn knobs_are_swept_once_and_a_budget_chooses() {
    let experiment = Experiment::new(SWEPT);
    let at = experiment.folder.path();
    let (first, said) = swept(at, &["--docs", "trade.md"]);
    let rows = errors(&first);
    let names: Vec<String> = rows.iter().map(|r| format!("{} {}", r.0, r.1).trim().to_string()).collect();
    let own = "as configured";
    assert_eq!(names[..], [own, own, "rounds 1", "rounds 4", "hidden 4", "hidden 8", "hidden 32"], "{said}");
    // Another seed is another training; the solver's floor lies below every net.
    assert_ne!(rows[0].2, rows[1].2);
    let surface = |value: &Value| value["surface_mm"].as_f64().expect("a number");
    let floor = surface(&first["floors"][0]);
    assert!(rows.iter().all(|r| surface(&r.2) > floor && surface(&r.3) > 0.0), "{floor} mm, {rows:?}");
    let solver = first["solver"].as_array().expect("methods");
    let named = |name: &str| solver.iter().find(|r| r["method"] == name).unwrap_or_else(|| panic!("no {name}"));
    let exact = named("1e-2 N, fine template");
    assert!(surface(&exact["error"]) < surface(&named("skinning alone")["error"]), "{said}");
    // Budgets may take the solver where it was measured on both motions.
    let points = first["front"]["points"].as_array().expect("points");
    let offered: Vec<&Value> = points.iter().filter(|p| p["solver"] == true).collect();
    assert_eq!(offered.len(), solver.iter().filter(|r| !r["offer"].is_null()).count());
    assert_eq!(offered.len(), 3, "{said}");
    for point in offered {
        let set = point["set"].as_array().expect("settings");
        assert!(set.iter().any(|s| s == "animate.solver={ friction = 0.0 }") && point["check_mm"].is_f64(), "{point}");
    }
    let times = |row: &Value| row["measured"]["train_s"].as_f64().expect("a time");
    assert!(first["rows"].as_array().expect("rows").iter().all(|row| times(row) > 0.0));
    let doubles = &first["precision"][0];
    assert!(doubles["energy"].as_f64().is_some_and(|e| e > 0.0 && e < 1e-3), "{doubles}");
    let all = files(&at.join("out-tradeoff"));
    assert_self_contained(std::str::from_utf8(&all["report.html"]).expect("text"));
    assert!(text(&all["tradeoff.txt"]).contains("hidden 32"));
    let page = std::fs::read_to_string(at.join("trade.md")).expect("a page");
    assert!(page.contains("| hidden 32 |") && page.contains("(trade/animation.svg)"), "{page}");

    // Everything is known; nothing is computed, and the table is the same to the last digit.
    let (again, said) = swept(at, &[]);
    assert!(said.contains("Nothing to do"), "{said}");
    assert_eq!(
        (&again["rows"], &again["solver"], &again["front"]["points"]),
        (&first["rows"], &first["solver"], &first["front"]["points"])
    );

    // One point is lost in the middle of its training, one simulation is lost: they alone come back, to the same errors.
    let sweep = at.join("out-tradeoff");
    let point = std::fs::read_dir(&sweep).expect("a folder").flatten().map(|e| e.path());
    let mut points: Vec<_> =
        point.filter(|p| p.file_name().is_some_and(|n| n.to_string_lossy().starts_with("point-"))).collect();
    points.sort();
    std::fs::remove_file(points[0].join("measured.caphy")).expect("a measured point");
    std::fs::remove_file(sweep.join("yardstick/upper-clip-1.caphy")).expect("a simulation");
    let (resumed, said) = swept(at, &[]);
    assert!(said.contains("Measured 2 points"), "{said}");
    assert_eq!(errors(&resumed), rows);
    assert_eq!(resumed["floors"], first["floors"]);

    // Knobs that paid are turned together; which ones, the machine's times have a say in.
    experiment.configure(&edited(SWEPT, &[("combinations = 0", "combinations = 1")]));
    let (joined, said) = swept(at, &[]);
    let together = joined["rows"].as_array().expect("rows").iter().filter(|r| r["knob"] == "together");
    let together: Vec<&str> = together.map(|r| r["level"].as_str().expect("a name")).collect();
    assert!(together.len() <= 2, "{said}");
    assert!(together.iter().all(|name| name.contains("rounds ") && name.contains("hidden ")), "{together:?}");

    // An experiment that sets none of it takes a point.
    let bare = edited(
        SWEPT,
        &[
            ("[net]\ntype = \"gru\"\nlayers = 1\nhidden = 16\n", ""),
            ("rounds = 4\n", ""),
            ("resolution_m = 0.05\n", ""),
        ],
    );
    let with = |budget: &str| {
        experiment.configure(&format!("{bare}\n[budget]\nfront = \"out-tradeoff/tradeoff.json\"\n{budget}\n"));
    };
    with("preset = \"reference\"");
    let plan = caphy(at, &["run", "experiment.toml", "--plan", "--json"]);
    let plan: Value = serde_json::from_slice(&plan.stdout).unwrap_or_else(|e| panic!("{e}: {}", text(&plan.stderr)));
    let why = plan["budget"].as_str().expect("a reason");
    assert!(why.contains("the smallest error") && why.contains("experiment"), "{why}");
    let best = &first["presets"][2][1]["point"];
    assert!(why.contains(best["name"].as_str().expect("a name")), "{why}");
    let resolved = std::fs::read_to_string(at.join("out/config.toml")).expect("a configuration");
    let resolved: toml::Table = resolved.parse().expect("TOML");
    assert!(!resolved.contains_key("budget") && resolved["upper"]["resolution_m"].as_float() == Some(0.05));
    with("error_mm = 1e-6");
    let said = refusal(at, &["run", "experiment.toml", "--plan"]);
    assert!(said.contains("error_mm = 0.000001") && said.contains("nearest"), "{said}");
}

#[test]
fn mistakes_are_found_before_anything_is_swept() {
    for (edit, words) in [
        (("knobs = [\"rounds\"", "knobs = [\"round\""), ["`round`", "rounds"]),
        (("seeds = 2", "seads = 2"), ["seads", "seeds"]),
        (("seeds = 2", "seeds = 0"), ["tradeoff.seeds", "at least 1"]),
        (("seconds = 0.3", "seconds = -1"), ["tradeoff.seconds", "positive"]),
    ] {
        let experiment = Experiment::new(&edited(SWEPT, &[edit]));
        let error = refusal(experiment.folder.path(), &["tradeoff", "experiment.toml"]);
        assert!(words.iter().all(|w| error.contains(w)), "{words:?} are not in: {error}");
        assert!(!experiment.folder.path().join("out-tradeoff").exists());
    }
    for (edit, words) in [
        (("[train]", "[budget]\neror_mm = 3\n\n[train]"), ["eror_mm", "error_mm"]),
        (("[train]", "[budget]\n\n[train]"), ["budget", "says nothing"]),
    ] {
        let error = Experiment::new(&edited(SWEPT, &[edit])).error();
        assert!(words.iter().all(|w| error.contains(w)), "{words:?} are not in: {error}");
    }
}
