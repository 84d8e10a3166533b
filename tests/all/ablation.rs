//! Variants of one experiment beside each other. Everything that can be is taken over from the tiny run.

use crate::commands::{caphy, text};
use crate::experiment::{Experiment, TINY, copy_folder, files};
use crate::pipeline::{assert_self_contained, finished};
use serde_json::Value;

const ABLATION: &str = r#"
experiment = "experiment.toml"
out = "table"

[[variant]]
name = "no-fabric"
set = ["optimise.alternations=0", "optimise.rounds=", "optimise.estimator="]
paper = { chamfer_mm = [6.754, 7.419], perceptual = [0.3462, 0.3906] }

[[variant]]
name = "full"
title = "everything"
"#;

#[test]
fn variants_share_scans_and_are_compared_scan_by_scan() {
    let experiment = Experiment::new(TINY);
    experiment.write("ablation.toml", ABLATION.as_bytes());
    let at = experiment.folder.path();
    for folder in ["subject", "full"] {
        copy_folder(finished(), &at.join("table/seed-1").join(folder));
    }
    let output = caphy(at, &["ablation", "ablation.toml"]);
    let said = text(&output.stdout) + &text(&output.stderr);
    assert!(output.status.success(), "{said}");
    // Scans, templates and the first training are taken over.
    assert!(said.contains("Ran seed-1/no-fabric, seed-1/full in"), "{said}");
    for (stage, times) in
        [("synth started", 0), ("preprocess started", 0), ("train started", 0), ("evaluate started", 2)]
    {
        assert_eq!(said.matches(stage).count(), times, "{stage}: {said}");
    }
    for line in
        ["everything", "no-fabric", "floor: solver with the true fabric", "floor: scan noise", "skinned template"]
    {
        assert!(said.matches(line).count() >= 2, "`{line}` for both garments in {said}");
    }
    let all = files(&at.join("table"));
    let page = std::str::from_utf8(&all["report.html"]).expect("text");
    assert_self_contained(page);
    // Three measures of two garments.
    assert_eq!(page.matches("change against “everything”, %").count(), 6);
    let table: Value = serde_json::from_slice(&all["ablation.json"]).expect("JSON");
    let row = |title: &str| {
        let rows = table["rows"].as_array().expect("rows");
        rows.iter()
            .find(|r| r["title"] == title && r["kind"] == "upper")
            .unwrap_or_else(|| panic!("no {title}"))
            .clone()
    };
    let chamfer = |row: &Value| {
        let means = row["means"].as_array().expect("means");
        means.iter().find(|m| m["name"] == "mean of both, mm").expect("3D-CD")["mean"].as_f64().expect("a number")
    };
    let (left_out, full) = (row("no-fabric"), row("everything"));
    let change = left_out["compared"][0]["change"]["value"].as_f64().expect("a number");
    assert!((change - (chamfer(&left_out) / chamfer(&full) - 1.0)).abs() < 1e-12);
    // One scan has no interval, and nothing is compared with itself.
    assert!(left_out["compared"][0]["change"]["interval"].is_null());
    assert_eq!(full["compared"].as_array().map(Vec::len), Some(0));
    // The true garment is nearer than anything that is learnt.
    assert!(chamfer(&row("floor: scan noise (the true garment)")) < chamfer(&full));
    assert_eq!((left_out["steps"].as_u64(), full["steps"].as_u64()), (Some(3 * 8), Some(5 * 8)));
    assert_eq!(left_out["paper"]["chamfer_mm"][0], 6.754);

    let again = caphy(at, &["ablation", "ablation.toml"]);
    assert!(text(&again.stdout).contains("Nothing to do"), "{}", text(&again.stdout));
    experiment.write("ablation.toml", ABLATION.replace("alternations=0", "alternation=0").as_bytes());
    let refused = caphy(at, &["ablation", "ablation.toml"]);
    let said = text(&refused.stderr);
    assert!(
        !refused.status.success() && said.contains("variant `no-fabric`") && said.contains("alternations"),
        "{said}"
    );
}
