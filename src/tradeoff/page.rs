//! The page of a sweep, self-contained.

use super::table::Results;
use crate::page;
use crate::plot::{Axes, Cloud, costs, escape};
use std::fmt::Write;

/// A plot per stage: file name, SVG.
pub(super) fn plots(results: &Results) -> Vec<(&'static str, String)> {
    let floor = results.floors[0].surface_mm;
    let over = |error: f64| (error - floor).max(0.0);
    let nets = |cost: fn(&super::Measured) -> f64| -> Vec<Cloud> {
        let kind = |name: &str, wanted: &dyn Fn(&super::Row) -> bool| Cloud {
            name: name.into(),
            points: results
                .rows
                .iter()
                .filter(|r| wanted(r))
                .map(|r| (cost(&r.measured), over(r.measured.error.surface_mm), r.name()))
                .collect(),
        };
        let all = [
            kind("as configured", &|r| r.knob.is_empty()),
            kind("one knob", &|r| !r.knob.is_empty() && r.knob != "together" && !r.of_fabric),
            kind("knobs together", &|r| r.knob == "together"),
            kind("another fabric", &|r| r.of_fabric),
        ];
        all.into_iter().filter(|c| !c.points.is_empty()).collect()
    };
    let axes = |title, x, y| Axes { title, x, y, log_y: true };
    let error = "mm from the solver, over the floor";
    let mut out =
        vec![("training", costs(&axes("Training", "processor time of training, s", error), &nets(|m| m.train_s)))];
    let mut animate = nets(|m| m.frame_ms);
    let solver = results.solver.iter().map(|r| (r.frame_ms, over(r.error.surface_mm), r.method.clone())).collect();
    animate.push(Cloud { name: "no net".into(), points: solver });
    out.push(("animation", costs(&axes("Animation", "processor time of a frame, ms", error), &animate)));
    let labels: Vec<_> = results
        .preprocess
        .iter()
        .filter_map(|r| {
            Some((r.measured.processor_s, 100.0 * r.measured.wrong_labels?, format!("{} {}", r.knob, r.level)))
        })
        .collect();
    if !labels.is_empty() {
        let cloud = Cloud { name: "labels".into(), points: labels };
        out.push(("preprocessing", costs(&axes("Preprocessing", "processor time, s", "wrong labels, %"), &[cloud])));
    }
    out
}

/// The page: plots, tables, what they mean.
pub(super) fn page(results: &Results) -> String {
    let mut html = page::head(&format!("caphy tradeoff: {}", results.scene));
    for fact in results.facts() {
        // Writing to a String cannot fail.
        let _ = write!(html, "<p>{}</p>", escape(&fact));
    }
    html.push_str("<p>Points tell their names when pointed at; the dashed line is the front.</p>");
    for (_, svg) in plots(results) {
        html.push_str(&svg);
    }
    for (title, head, rows) in results.tables() {
        let _ = write!(html, "<h2>{}</h2>", escape(title));
        let head: Vec<&str> = head.iter().map(String::as_str).collect();
        page::table(&mut html, &head, rows);
    }
    html.push_str("<details><summary>Settings of every point</summary>");
    let rows = results.rows.iter().map(|r| vec![r.name(), r.set.join("  ")]);
    page::table(&mut html, &["", "set"], rows);
    html.push_str("</details></html>");
    html
}
