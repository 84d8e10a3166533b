//! Atlases as a table, as JSON, and as a page of maps.

use super::{Atlas, Precision, RandomStates};
use crate::artifact::write_atomically;
use crate::page::{head, table as html_table};
use crate::plot::{Map, escape, number, standalone};
use caphy_core::{Error, Result};
use std::fmt::Write;
use std::path::{Path, PathBuf};

/// Letters of maps: colour and meaning.
const LEGEND: [(char, &str, &str); 4] = [
    ('.', "#cfe6d2", "sound"),
    ('t', "#e3b34c", "gives way"),
    ('g', "#c8502d", "gradient wrong"),
    ('x', "#222222", "not finite"),
];

const HEAD: [&str; 9] = [
    "fabric",
    "precision",
    "finite",
    "gradient",
    "tangent positive",
    "sound stretches",
    "error of S",
    "folds: sound",
    "sound to 1/m",
];

fn rows(atlases: &[Atlas]) -> Vec<Vec<String>> {
    let percent = |share: f64| format!("{:.1} %", 100.0 * share);
    let row = |a: &Atlas, name: &str, p: &Precision| {
        let m = &p.membrane;
        vec![
            a.material.clone(),
            name.to_string(),
            percent(m.summary.finite.min(p.fold.summary.finite)),
            percent(m.summary.gradient),
            percent(m.summary.positive),
            format!("{} to {}", number(m.sound_from), number(m.sound_to)),
            number(m.largest_error),
            percent(p.fold.summary.positive),
            number(p.fold.sound_to),
        ]
    };
    atlases.iter().flat_map(|a| [row(a, "f32", &a.single), row(a, "f64", &a.double)]).collect()
}

/// A table for people.
pub fn table(atlases: &[Atlas], random: &[RandomStates]) -> String {
    let rows = rows(atlases);
    let widths: Vec<usize> = (0..HEAD.len())
        .map(|c| rows.iter().map(|r| r[c].chars().count()).chain([HEAD[c].chars().count()]).max().unwrap_or(0))
        .collect();
    let line = |cells: &[String]| {
        let padded = cells.iter().zip(&widths).enumerate().map(|(c, (cell, width))| {
            let space = " ".repeat(width - cell.chars().count());
            if c < 2 { format!("{cell}{space}") } else { format!("{space}{cell}") }
        });
        padded.collect::<Vec<_>>().join("  ").trim_end().to_string() + "\n"
    };
    let mut out = line(&HEAD.map(str::to_string)) + &rows.iter().map(|r| line(r)).collect::<String>();
    out += "\nPrincipal stretches 0 to 10 in five directions; folds of -180 to 180 degrees with edges of 0.1 mm to 0.1 m. Sound \
            stretches: along any direction, sides held.\n";
    for a in atlases.iter().filter(|a| a.stiffness_frozen) {
        let _ = writeln!(
            out,
            "{}: stiffness held while differentiating; its force is off the energy's gradient by up to {:.0} % of the largest stress.",
            a.material,
            100.0 * a.frozen_gap
        );
    }
    for (a, r) in atlases.iter().zip(random) {
        let _ = writeln!(
            out,
            "{}: {} random states, {} not finite, {} of {} gradients wrong{}",
            a.material,
            r.states,
            r.not_finite,
            r.gradient_wrong,
            r.slopes,
            r.first.as_ref().map(|f| format!("; first: {f}")).unwrap_or_default()
        );
    }
    out
}

/// Maps of one precision: strains, folds.
fn maps(name: &str, bits: &str, p: &Precision) -> [(&'static str, String); 2] {
    let pick = |values: &[f64], wanted: &[f64], scale: f64| -> Vec<(usize, String)> {
        let near = |w: &f64| values.iter().position(|v| (v * scale - w).abs() <= 1e-6 * w.abs().max(1e-3));
        wanted.iter().filter_map(|w| Some((near(w)?, number(*w)))).collect()
    };
    let ticks = pick(&p.membrane.stretches, &[0.0, 0.1, 1.0, 10.0], 1.0);
    let membrane = Map {
        title: &format!("{name}, {bits}: strains"),
        x: ("first principal stretch", ticks.clone()),
        y: ("second principal stretch", ticks),
        rows: &p.membrane.map,
        legend: &LEGEND,
    };
    let degrees = 180.0 / std::f64::consts::PI;
    let fold = Map {
        title: &format!("{name}, {bits}: folds"),
        x: ("fold [degrees]", pick(&p.fold.angles, &[-180.0, -90.0, 0.0, 90.0, 180.0], degrees)),
        y: ("edge length [mm]", pick(&p.fold.lengths, &[0.1, 1.0, 10.0, 100.0], 1e3)),
        rows: &p.fold.map,
        legend: &LEGEND,
    };
    [("strains", membrane.svg()), ("folds", fold.svg())]
}

/// Writes `stress.json`, `stress.txt`, a map per fabric and precision (SVG) and `stress.html` with all of it into a folder; returns
/// the page's path.
///
/// # Errors
/// [`Error::Io`] for the folder.
pub fn write(folder: &Path, atlases: &[Atlas], random: &[RandomStates]) -> Result<PathBuf> {
    let all = serde_json::json!({ "legend": { ".": "sound", "t": "gives way", "g": "gradient wrong", "x": "not finite" },
        "atlases": atlases, "random": random });
    let json = serde_json::to_vec_pretty(&all)
        .map_err(|e| Error::numerics("stress.json", e.to_string(), "report this as a defect"))?;
    write_atomically(&folder.join("stress.json"), &json)?;
    let text = table(atlases, random);
    write_atomically(&folder.join("stress.txt"), text.as_bytes())?;
    let mut page = head("Stability atlas");
    page += "<p>Where fabrics have a finite energy, the right gradient and a positive tangent: states of a cloth by their two principal \
             stretches (the worst of five directions from the u axis) and by the fold of an equilateral pair of triangles. Green is \
             sound. Yellow gives way: the tangent ∂S/∂G, or a fold's moment, falls in some direction, as compressed StVK cloth does \
             and as measured tables do by themselves; solvers must damp there. Red and black would be faults.</p>";
    html_table(&mut page, &HEAD, rows(atlases));
    let _ = write!(page, "<pre>{}</pre>", escape(text.split_once("\n\n").map_or("", |t| t.1)));
    page += "<style>.map{width:24.5%;min-width:250px}</style>";
    for a in atlases {
        let _ = write!(page, "<h2>{}</h2>", escape(&a.material));
        for (bits, precision) in [("f64", &a.double), ("f32", &a.single)] {
            for (kind, svg) in maps(&a.material, bits, precision) {
                let name = format!("{}-{bits}-{kind}.svg", a.material.replace(['/', '\\', ' '], "_"));
                write_atomically(&folder.join(name), standalone(&svg).as_bytes())?;
                page += &svg;
            }
        }
    }
    let path = folder.join("stress.html");
    write_atomically(&path, page.as_bytes())?;
    Ok(path)
}

/// The map of strains in double precision as an `<svg>` element.
pub fn strain_map(atlas: &Atlas) -> String {
    let [(_, strains), _] = maps(&atlas.material, "f64", &atlas.double);
    strains
}
