//! The page of an estimation: values with intervals, poses with pictures, curves among the ten fabrics.

use super::run::{Estimated, Summary, with_values};
use crate::artifact::write_atomically;
use crate::pictures::{BACK, FRONT};
use crate::plot::{self, Axes, Curve, escape, lines, number};
use crate::stage::report::table;
use caphy_core::material::{MaterialModel, MembraneBlock, MembraneCall};
use caphy_core::query::NearestSurface;
use caphy_core::{Result, TriMesh, Vec3, mesh};
use caphy_garment::estimate::{Problem, ScanPoints};
use caphy_render::colours::{ColourMap, field_colours};
use caphy_render::{Layer, Picture, Projection, Rgb, frame, png};
use std::fmt::Write;
use std::path::Path;

/// Stretches at which fabrics are drawn: the published measurements end at 7/6.
const STRETCHES: usize = 33;
/// Size of a picture [pixels].
const SIZE: [usize; 2] = [420, 420];
/// Distance that takes the last colour, in standard deviations of the scan's noise.
const LAST_COLOUR: f64 = 5.0;
/// How far the scan is drawn behind where it is [m].
const BEHIND_M: f64 = 0.01;

const STYLE: &str = "body{font:15px/1.5 system-ui,sans-serif;max-width:1100px;margin:2em auto;padding:0 1em;color:#222}\
h1,h2{font-weight:600}h2{margin-top:2em;border-bottom:1px solid #ddd}img{max-width:48%}\
table{border-collapse:collapse;margin:.6em 0}td,th{padding:.2em .7em;border-bottom:1px solid #e4e4e4;text-align:right}\
td:first-child,th:first-child{text-align:left}.plot{width:48%;min-width:420px}\
.warn{background:#fff6e0;border-left:4px solid #d99a1c;padding:.5em 1em}";

/// Writes `report.html` and its pictures.
pub(super) fn write(folder: &Path, problem: &Problem, summary: &Summary, fabrics: &[(String, Vec<f64>)]) -> Result<()> {
    let mut html = format!(
        "<!doctype html><html lang=\"en\"><meta charset=\"utf-8\"><title>Fabric estimate</title><style>{STYLE}{}</style>\
         <h1>Fabric estimate</h1>",
        plot::STYLE
    );
    let _ = write!(
        html,
        "<p>{}, {} vertices, {} g{}.</p>",
        escape(&problem.rest.name),
        problem.rest.vertex_count(),
        number(1e3 * problem.rest.mass()),
        if summary.weighed { "" } else { " (by the fabric's density: not weighed)" }
    );
    for warning in &summary.warnings {
        let _ = write!(html, "<p class=\"warn\">{}</p>", escape(warning));
    }
    values(&mut html, summary);
    curves(&mut html, problem, summary, fabrics)?;
    poses(&mut html, folder, problem, summary)?;
    html.push_str("</html>");
    write_atomically(&summary.page, html.as_bytes())
}

fn values(html: &mut String, summary: &Summary) {
    html.push_str("<h2>Values</h2>");
    match &summary.estimate {
        Estimated::Equilibrium(e) => {
            let rows = e.unknowns.iter().map(|u| {
                let note = match (u.at_bound, u.held_by_prior) {
                    (true, _) => "at its bound",
                    (_, true) => "held by the prior",
                    _ => "",
                };
                vec![
                    u.name.clone(),
                    format!("{:.3}", u.multiplier),
                    format!("{:.3} to {:.3}", u.interval[0], u.interval[1]),
                    format!("{:.1}", 100.0 * u.log_sd_noise),
                    format!("{:.1}", 100.0 * u.log_sd_friction),
                    format!("{:.1}", 100.0 * e.mesh_log_sd),
                    note.into(),
                ]
            });
            let head = ["", "factor", "95 %", "noise, %", "friction, %", "mesh, %", ""];
            table(html, &head, rows);
            let rows = e.nuisances.iter().map(|n| {
                vec![
                    n.name.clone(),
                    format!("{:.4} ± {:.4} {}", n.value, n.sd, if n.unit == "1" { "" } else { &n.unit }),
                ]
            });
            if !e.nuisances.is_empty() {
                table(html, &["fitted along", "value"], rows);
            }
            html.push_str("<h2>What the poses determine</h2>");
            let rows = e.combinations.iter().map(|c| {
                let word = if c.determined { "" } else { "held by the prior" };
                vec![c.words.clone(), format!("{:.1}", 100.0 * c.log_sd), word.into()]
            });
            table(html, &["combination of logarithms", "known to, %", ""], rows);
        }
        Estimated::Alternation(a) => {
            let rows = a.last.groups.iter().map(|g| {
                let note = match (g.excited, g.at_bound) {
                    (false, _) => "not excited, kept",
                    (true, true) => "at its bound",
                    (true, false) => "",
                };
                vec![g.name.clone(), format!("{:.3}", g.multiplier), format!("{:.2}", g.determined), note.into()]
            });
            table(html, &["", "factor", "determined by data", ""], rows);
            let curves: Vec<Curve> = (0..a.last.groups.len())
                .map(|k| Curve {
                    name: a.last.groups[k].name.clone(),
                    points: a.history.iter().enumerate().map(|(i, m)| ((i + 1) as f64, m[k])).collect(),
                })
                .collect();
            html.push_str(&lines(&Axes { title: "Factors", x: "round", y: "factor", log_y: true }, &curves));
        }
    }
    if !summary.nearest.is_empty() {
        html.push_str("<h2>Nearest of the ten</h2>");
        let rows = summary
            .nearest
            .iter()
            .map(|o| vec![o.name.clone(), format!("{:.1}", 100.0 * o.probability), number(o.distance2.sqrt())]);
        table(html, &["fabric", "odds, %", "distance, sd"], rows);
    }
    if !summary.drape_coefficients.is_empty() {
        let rows = summary.drape_coefficients.iter().map(|(n, d)| vec![n.clone(), format!("{d:.3}")]);
        table(html, &["pose", "drape coefficient, simulated"], rows);
    }
}

/// Tension [N/m] along a yarn over stretch without lateral strain (first Piola-Kirchhoff).
fn tension(model: &dyn MaterialModel, axis: usize) -> Result<Vec<(f64, f64)>> {
    let strains: Vec<f64> = (0..STRETCHES).map(|i| 0.2 * i as f64 / (STRETCHES - 1) as f64).collect();
    let mut green = vec![0.0; 3 * STRETCHES];
    for (i, e) in strains.iter().enumerate() {
        green[axis * STRETCHES + i] = e + 0.5 * e * e;
    }
    let mut stress = vec![0.0; 3 * STRETCHES];
    let mut block = MembraneBlock::new(STRETCHES, &green);
    block.stress = (&mut stress[..]).into();
    model.membrane(MembraneCall::F64(&mut block))?;
    Ok((0..STRETCHES).map(|i| (100.0 * strains[i], (1.0 + strains[i]) * stress[axis * STRETCHES + i])).collect())
}

fn curves(html: &mut String, problem: &Problem, summary: &Summary, fabrics: &[(String, Vec<f64>)]) -> Result<()> {
    html.push_str("<h2>Tension over stretch</h2><p>Before, after with its 95 % band, and the nearest of the ten.</p>");
    let factors = |end: usize| -> Option<Vec<f64>> {
        let Estimated::Equilibrium(e) = &summary.estimate else { return None };
        let groups = caphy_garment::estimate::reduction::groups(&*problem.material);
        (groups.len() == e.unknowns.len()).then(|| {
            let mut values = summary.after.clone();
            for (group, u) in groups.iter().zip(&e.unknowns) {
                let ratio = (u.interval[end] / u.multiplier).clamp(1e-2, 1e2);
                group.members.iter().for_each(|&i| values[i] *= ratio);
            }
            for (value, p) in values.iter_mut().zip(problem.material.parameters()) {
                *value = value.clamp(p.lower, p.upper);
            }
            values
        })
    };
    let mut shown: Vec<(String, Vec<f64>)> =
        vec![("before".into(), summary.before.clone()), ("after".into(), summary.after.clone())];
    for (end, name) in ["2.5 %", "97.5 %"].iter().enumerate() {
        if let Some(values) = factors(end) {
            shown.push((name.to_string(), values));
        }
    }
    let mut near: Vec<&str> = summary.nearest.iter().take(4).map(|o| o.name.as_str()).collect();
    if near.is_empty() {
        near = fabrics.iter().take(4).map(|f| f.0.as_str()).collect();
    }
    for name in near {
        if let Some(found) = fabrics.iter().find(|f| f.0 == name) {
            let inside =
                problem.material.parameters().iter().zip(&found.1).all(|(p, v)| p.lower <= *v && *v <= p.upper);
            if inside {
                shown.push(found.clone());
            }
        }
    }
    for (axis, yarn) in ["u", "v"].iter().enumerate() {
        let mut list = Vec::new();
        for (name, values) in &shown {
            list.push(Curve { name: name.clone(), points: tension(&*with_values(problem, values)?, axis)? });
        }
        let title = format!("Along {yarn}");
        html.push_str(&lines(&Axes { title: &title, x: "stretch, %", y: "N/m", log_y: false }, &list));
    }
    Ok(())
}

fn poses(html: &mut String, folder: &Path, problem: &Problem, summary: &Summary) -> Result<()> {
    html.push_str("<h2>Poses</h2>");
    if let Estimated::Equilibrium(e) = &summary.estimate {
        let rows = e.poses.iter().map(|p| {
            vec![
                p.name.clone(),
                format!("{:.2}", p.chi2),
                format!("{:.2}", p.chi2_over_median),
                format!("{:.2}", p.rms_mm),
                format!("{:.2}", p.sigma_mm),
                p.measurements.to_string(),
                p.contacts.to_string(),
                p.free_modes.to_string(),
                p.left_out.clone().unwrap_or_default(),
            ]
        });
        let head = [
            "pose",
            "χ² per point",
            "of the median's",
            "rms, mm",
            "noise, mm",
            "points",
            "touching",
            "free modes",
            "left out",
        ];
        table(html, &head, rows);
    }
    let shapes = match &summary.estimate {
        Estimated::Equilibrium(e) => &e.shapes,
        Estimated::Alternation(a) => &a.shapes,
    };
    for (i, (capture, shape)) in problem.captures.iter().zip(shapes).enumerate() {
        let simulated =
            TriMesh { vertices: shape.iter().map(|p| Vec3::from(*p)).collect(), faces: problem.rest.faces().to_vec() };
        let sigma = capture.noise(&problem.rest)?;
        let away = distances(&simulated, &capture.scan)?;
        let colours = field_colours(&away, (0.0, LAST_COLOUR * sigma), ColourMap::Viridis);
        let scan = match &capture.scan {
            ScanPoints::Surface { points, faces, .. } => TriMesh { vertices: points.clone(), faces: faces.clone() },
            ScanPoints::Known { vertices, points } if vertices.len() == simulated.vertices.len() => {
                TriMesh { vertices: points.clone(), faces: simulated.faces.clone() }
            }
            ScanPoints::Known { .. } => TriMesh::default(),
        };
        let bounds = mesh::bounds(&simulated.vertices).unwrap_or_default();
        let _ = write!(html, "<h3>{}</h3>", escape(&capture.name));
        for (side, from) in [("front", &FRONT), ("back", &BACK)] {
            let camera = frame(bounds, from, Projection::Orthographic, SIZE[0], SIZE[1]);
            let mut picture = Picture::new(camera, vec![Layer::per_vertex(&simulated, &colours)]);
            // Two surfaces half a millimetre apart hide each other in patches: the scan steps back.
            let back = from.normalize() * BEHIND_M;
            let behind =
                TriMesh { vertices: scan.vertices.iter().map(|p| p - back).collect(), faces: scan.faces.clone() };
            picture.layers.push(Layer::uniform(&behind, [190, 190, 190]));
            let drawn: Rgb = picture.draw();
            let name = format!("pictures/pose-{i:02}-{side}.png");
            write_atomically(&folder.join(&name), &png(&drawn)?)?;
            let _ = write!(html, "<img alt=\"{} {side}\" src=\"{name}\">", escape(&capture.name));
        }
        let _ = write!(
            html,
            "<p>The simulated cloth, coloured by its distance to the scan from 0 (dark) to {} mm (light), over the scan (grey).</p>",
            number(1e3 * LAST_COLOUR * sigma)
        );
    }
    Ok(())
}

/// Distance of each simulated vertex from the scan [m].
fn distances(simulated: &TriMesh, scan: &ScanPoints) -> Result<Vec<f64>> {
    let n = simulated.vertices.len();
    Ok(match scan {
        ScanPoints::Known { vertices, points } => {
            let mut out = vec![f64::NAN; n];
            for (&v, p) in vertices.iter().zip(points) {
                out[v as usize] = (simulated.vertices[v as usize] - p).norm();
            }
            out
        }
        ScanPoints::Surface { points, faces, .. } if !faces.is_empty() => NearestSurface::new(points, faces)?
            .nearest_all(&simulated.vertices, None)?
            .iter()
            .map(|p| p.squared_distance.sqrt())
            .collect(),
        ScanPoints::Surface { points, .. } => {
            let grid = caphy_core::query::NearestGrid::from_points(points);
            simulated.vertices.iter().map(|p| grid.nearest_point(p).map_or(f64::NAN, |n| n.1.sqrt())).collect()
        }
    })
}
