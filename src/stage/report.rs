//! `report.html`: one self-contained page with pictures of every stage, curves, and the tables.

mod remarks;

use super::animate::{Film, strip_frames};
use super::compare::Comparison;
use super::evaluate::Scores;
use super::export::Exported;
use super::optimise::Estimates;
use super::preprocess::Subject;
use super::train::{Nets, config_key};
use super::{Context, Scans, StageOutput, material};
use crate::estimate::{report as fabric, ten_fabrics};
use crate::page;
use crate::page::table;
use crate::plan::ScenePlan;
use crate::plot::{Axes, Curve, escape, lines, number};
use crate::trainer::CurvePoint;
use crate::training;
use caphy_core::Result;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::PathBuf;

/// What the report shows.
pub struct Inputs<'a> {
    /// The scans.
    pub scans: &'a Scans,
    /// Preprocessing.
    pub subject: &'a Subject,
    /// Fabric estimates, one per alternation.
    pub fabrics: &'a [Estimates],
    /// Nets before fine-tuning, with the record of training.
    pub nets: &'a Nets,
    /// Measurements against scans, where there are scans.
    pub scores: Option<&'a Scores>,
    /// Measurements against the reference solver, where they were asked for.
    pub comparison: Option<&'a Comparison>,
    /// The played clip, where one was.
    pub film: Option<&'a Film>,
    /// Exported files.
    pub exported: &'a Exported,
    /// Seconds per stage, milliseconds per step.
    pub timings: &'a BTreeMap<String, f64>,
}

/// The written page.
#[derive(Debug, Serialize, Deserialize)]
pub struct Page {
    file: PathBuf,
}

impl StageOutput for Page {
    fn files(&self) -> Vec<PathBuf> {
        vec![self.file.clone()]
    }
}

/// Writes the page.
pub fn run(context: &Context<'_>, inputs: &Inputs<'_>) -> Result<Page> {
    let mut html = page::head("caphy report");
    overview(&mut html, context, inputs);
    let picture = |html: &mut String, title: &str, name: &str, text: &str| -> Result<()> {
        let source = embedded(context, name)?;
        let (title, text) = (escape(title), escape(text));
        let _ = write!(html, "<h2>{title}</h2><p>{text}</p><img alt=\"{title}\" src=\"{source}\">");
        Ok(())
    };
    list(&mut html, "Warnings", "warn", &remarks::warnings(inputs));
    if let Some(played) = inputs.film {
        let solver = context.config.animate.as_ref().and_then(|a| a.solver);
        film(&mut html, &embedded(context, "pictures/strip.png")?, played, solver.map(|s| s.tolerance_n));
    }
    if inputs.scans.truth.is_some() {
        picture(
            &mut html,
            "The subject",
            "truth/scans.png",
            "A generated person in clothes of known fabric, at rest by the reference solver in every pose, as a capture rig sees them.",
        )?;
    }
    if !inputs.subject.scans.is_empty() {
        picture(
            &mut html,
            "Scans, labels, bodies",
            "pictures/scans.png",
            "Each scan with its label per vertex, the body found under the clothes, and that body (red) over the scan: red \
             should show on skin only.",
        )?;
        fits(&mut html, inputs);
    }
    picture(&mut html, "Garment templates", "pictures/templates.png", "The chosen styles on the T-posed body.")?;
    if !inputs.subject.choices.is_empty() {
        choices(&mut html, inputs);
    }
    curves(&mut html, inputs);
    previews(&mut html, context)?;
    fabrics(&mut html, context, inputs)?;
    if inputs.film.is_some() {
        picture(
            &mut html,
            "Animation",
            "pictures/animation.png",
            "Frames of the played clip, from the front and from behind.",
        )?;
    }
    if let Some(scores) = inputs.scores {
        picture(
            &mut html,
            "Measurements",
            "pictures/evaluation.png",
            "Scans and the fine-tuned avatar in their poses, held-out scans first; nothing was pushed out here.",
        )?;
        let _ = write!(html, "<pre>{}</pre>", escape(&scores.table()));
    }
    if let Some(comparison) = inputs.comparison {
        for name in &comparison.pictures {
            let text = "The same frames, from the left: skinned template, trained net, reference solver.";
            picture(&mut html, "Against the reference solver", &name.display().to_string(), text)?;
        }
        html.push_str(&comparison.plots());
        let _ = write!(html, "<pre>{}</pre>", escape(&comparison.table()));
    }
    if let Some(name) = &inputs.exported.picture {
        let text = "A scan, the avatar in its pose, and the avatar in the colours of the scans that were learnt from.";
        picture(&mut html, "Colours", &name.display().to_string(), text)?;
        let rows =
            inputs.exported.coloured.iter().map(|(part, share)| vec![part.clone(), format!("{:.0}", 100.0 * share)]);
        table(&mut html, &["part", "vertices that scans show, %"], rows);
    }
    list(&mut html, "Limits that apply", "limits", &remarks::limits(context.config, inputs));
    let files: Vec<String> = inputs.exported.files.iter().take(12).map(|f| escape(&f.display().to_string())).collect();
    let _ = write!(
        html,
        "<h2>Files</h2><p>{} exported, among them:</p><pre>{}</pre></html>",
        inputs.exported.files.len(),
        files.join("\n")
    );
    context.write("report.html", html.as_bytes())?;
    Ok(Page { file: "report.html".into() })
}

/// Sentences under a title; nothing for none.
fn list(html: &mut String, title: &str, class: &str, sentences: &[String]) {
    if sentences.is_empty() {
        return;
    }
    let items: String = sentences.iter().map(|s| format!("<li>{}</li>", escape(s))).collect();
    let _ = write!(html, "<h2>{title}</h2><ul class=\"{class}\">{items}</ul>");
}

/// A picture of the run directory as a data URL.
fn embedded(context: &Context<'_>, name: &str) -> Result<String> {
    page::embedded(&context.folder.join(name))
}

fn overview(html: &mut String, context: &Context<'_>, inputs: &Inputs<'_>) {
    let held = inputs.subject.scans.iter().filter(|s| s.held_out).count();
    let (scans, vertices) = (
        inputs.subject.scans.len(),
        inputs.subject.garments.iter().map(|g| format!("{} {} vertices", g.kind, g.mesh.vertices.len())),
    );
    let vertices: Vec<String> = vertices.collect();
    let kind = if inputs.scans.truth.is_some() { "synthetic subject" } else { "subject" };
    let _ = write!(html, "<p>{kind}, {scans} scans ({held} held out), garments: {}.</p>", vertices.join(", "));
    if let Some(choice) = &context.config.choice {
        let _ = write!(html, "<p>Budget: {}</p>", escape(&choice.text()));
    }
    let mut rows: Vec<(&str, f64)> = Vec::new();
    for stage in ScenePlan::new(context.config).stages {
        rows.extend(inputs.timings.get(stage.name).map(|seconds| (stage.name, *seconds)));
    }
    rows.push(("all", rows.iter().map(|row| row.1).sum()));
    table(html, &["stage", "s"], rows.iter().map(|(name, seconds)| vec![name.to_string(), format!("{seconds:.1}")]));
    let steps = inputs.timings.iter().filter(|(name, _)| name.ends_with("ms"));
    table(html, &["training step, all threads", "median ms"], steps.map(|(n, ms)| vec![n.clone(), format!("{ms:.1}")]));
}

/// `tolerance_n`: where frames are simulated, what forces were brought down to [N].
fn film(html: &mut String, strip: &str, film: &Film, tolerance_n: Option<f64>) {
    let frames = strip_frames();
    let [width, height] = crate::pictures::SIZE;
    let margin = caphy_render::sheet::MARGIN;
    let (step, seconds) = (width + margin, film.clip.duration());
    let _ = write!(
        html,
        "<h2>The avatar moves</h2><style>@keyframes play{{to{{background-position:-{end}px -{margin}px}}}}</style>\
         <div style=\"width:{width}px;height:{height}px;background:url({strip}) -{margin}px -{margin}px;\
         animation:play {seconds:.2}s steps({frames}) infinite\" role=\"img\" aria-label=\"the avatar in motion\"></div>",
        end = margin + frames * step,
    );
    if let Some(tolerance) = tolerance_n {
        let _ = write!(
            html,
            "<p>Simulated by the reference solver, forces down to {tolerance:.0e} N (<code>[animate] solver</code>). The exported avatar \
             has its nets, which were not asked here.</p>"
        );
    }
    let rows = film
        .garments
        .iter()
        .map(|g| vec![g.kind.to_string(), format!("{:.2}", 100.0 * g.penetrating), format!("{:.1}", g.deepest_mm)]);
    table(html, &["garment", "vertices inside the body before push-out, %", "deepest, mm"], rows);
}

fn fits(html: &mut String, inputs: &Inputs<'_>) {
    let rows = inputs.subject.scans.iter().map(|s| {
        vec![
            format!("{}{}", s.name, if s.held_out { " (held out)" } else { "" }),
            format!("{:.2}", 100.0 * s.fusion.disagreement),
            format!("{:.2}", 100.0 * s.fusion.unseen),
            s.label_agreement.map_or("–".into(), |a| format!("{:.2}", 100.0 * a)),
            format!("{:.1}", s.fit.skin_rms_mm),
            format!("{:.0}", 100.0 * s.fit.inside_share),
            format!("{:.1}", s.fit.cloth_depth_mm),
        ]
    });
    let head = [
        "scan",
        "votes against, %",
        "unseen, %",
        "labels as stored, %",
        "skin to scan, mm rms",
        "covered skin inside cloth, %",
        "median depth under cloth, mm",
    ];
    table(html, &head, rows);
    for scan in &inputs.subject.scans {
        for note in &scan.notes {
            let _ = write!(html, "<p>Scan {} {}.</p>", escape(&scan.name), escape(note));
        }
    }
}

fn choices(html: &mut String, inputs: &Inputs<'_>) {
    let rows = inputs.subject.choices.iter().zip(&inputs.subject.garments).map(|(c, g)| {
        let girths: Vec<String> =
            c.measures.girths_m.iter().map(|(name, m)| format!("{name} {:.0} cm", 100.0 * m)).collect();
        vec![
            c.kind.to_string(),
            c.scan.clone(),
            c.styles.to_string(),
            format!("{:.0}", c.median_sample_mm2),
            format!("{:.0}", c.best_sample_mm2),
            format!("{:.0}", c.refined_mm2),
            format!("{:.1}", c.edges_off_mm),
            g.style.values().iter().map(|v| number(*v)).collect::<Vec<_>>().join(", "),
            format!("{:.3}", c.measures.area_m2),
            girths.join(", "),
        ]
    });
    let head = [
        "garment",
        "compared with",
        "styles",
        "median Chamfer, mm²",
        "best worn",
        "refined",
        "edges off, mm",
        "style",
        "area, m²",
        "girths",
    ];
    table(html, &head, rows);
}

fn curves(html: &mut String, inputs: &Inputs<'_>) {
    html.push_str("<h2>Training</h2><p>Energies per frame by step, on random windows and on scan poses.</p>");
    for garment in &inputs.nets.garments {
        for (scans, what) in [(false, "random windows"), (true, "scan poses")] {
            let points: Vec<&CurvePoint> = garment.curve.iter().filter(|p| p.scans == scans).collect();
            let mut names: Vec<&str> = Vec::new();
            for (name, _) in points.iter().flat_map(|p| &p.energies) {
                if !names.contains(&name.as_str()) && name != "gravity" {
                    names.push(name);
                }
            }
            let curves: Vec<Curve> = names
                .into_iter()
                .map(|name| {
                    let value = |p: &&CurvePoint| {
                        let energy = p.energies.iter().find(|(n, _)| n == name)?.1;
                        Some((p.step as f64, energy))
                    };
                    Curve { name: name.into(), points: points.iter().filter_map(value).collect() }
                })
                .collect();
            let title = format!("{}: {what}", garment.kind);
            html.push_str(&lines(&Axes { title: &title, x: "step", y: "J per frame", log_y: true }, &curves));
        }
    }
}

/// The first and the last picture of every training that was drawn, folded away.
fn previews(html: &mut String, context: &Context<'_>) -> Result<()> {
    for (what, files) in training::previews(context.folder) {
        let (Some(first), Some(last)) = (files.first(), files.last()) else { continue };
        let _ = write!(html, "<details><summary>Pictures of {} while it learned</summary>", escape(&what));
        for (step, file) in if first == last { vec![last] } else { vec![first, last] } {
            let source = embedded(context, &file.to_string_lossy())?;
            let _ = write!(html, "<p>after step {step}</p><img alt=\"{} {step}\" src=\"{source}\">", escape(&what));
        }
        html.push_str("</details>");
    }
    Ok(())
}

fn fabrics(html: &mut String, context: &Context<'_>, inputs: &Inputs<'_>) -> Result<()> {
    html.push_str("<h2>Fabric</h2>");
    if inputs.fabrics.is_empty() {
        html.push_str("<p>Not estimated: as configured.</p>");
    }
    let known = ten_fabrics()?;
    for garment in inputs.fabrics.iter().flat_map(|e| &e.garments) {
        let _ = write!(html, "<h3>{}</h3>", garment.kind);
        let found = &garment.fabric;
        for warning in found.estimate.warnings() {
            let _ = write!(html, "<p class=\"warn\">{}</p>", escape(warning));
        }
        fabric::values(html, found);
        let table = &context.config.garment(garment.kind)?.material;
        let model = material(table, config_key(garment.kind), Some(&found.after))?;
        let fabrics = if table.is_measured() { &known[..] } else { &[] };
        fabric::curves(html, &*model, found, fabrics)?;
        fabric::fits(html, &found.estimate);
        if let Some(picture) = &garment.picture {
            let source = embedded(context, &picture.file.to_string_lossy())?;
            let text = fabric::coloured_by(picture.last_colour_m);
            let _ = write!(html, "<p>{text}</p><img alt=\"{} over its scans\" src=\"{source}\">", garment.kind);
        }
    }
    Ok(())
}
