//! The page of an estimation: values with intervals, poses with pictures, curves among the ten fabrics.

use super::found::{Estimated, FabricFound};
use crate::artifact::write_atomically;
use crate::page::{self, data_url, table};
use crate::pictures::{BACK, FRONT};
use crate::plot::{Axes, Curve, escape, lines, number};
use caphy_core::material::{MaterialModel, MembraneBlock, MembraneCall};
use caphy_core::query::NearestSurface;
use caphy_core::{Result, TriMesh, Vec3, mesh};
use caphy_garment::estimate::{FabricEstimate, Problem, ScanPoints};
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

/// Writes a page with its pictures.
///
/// `drapes`: drape coefficients by pose.
pub(crate) fn write(
    file: &Path,
    problem: &Problem,
    found: &FabricFound,
    drapes: &[(String, f64)],
    fabrics: &[(String, Vec<f64>)],
) -> Result<()> {
    let mut html = page::head("Fabric estimate");
    let _ = write!(
        html,
        "<p>{}, {} vertices, {} g{}.</p>",
        escape(&problem.rest.name),
        problem.rest.vertex_count(),
        number(1e3 * problem.rest.mass()),
        if found.weighed { "" } else { " (by the fabric's density: not weighed)" }
    );
    for warning in found.estimate.warnings() {
        let _ = write!(html, "<p class=\"warn\">{}</p>", escape(warning));
    }
    values(&mut html, found);
    if !drapes.is_empty() {
        let rows = drapes.iter().map(|(n, d)| vec![n.clone(), format!("{d:.3}")]);
        table(&mut html, &["pose", "drape coefficient, simulated"], rows);
    }
    curves(&mut html, &*problem.material, found, fabrics)?;
    html.push_str("<h2>Poses</h2>");
    fits(&mut html, &found.estimate);
    poses(&mut html, problem, found)?;
    html.push_str("</html>");
    write_atomically(file, html.as_bytes())
}

/// Factors with their intervals, what was fitted along, what the poses determine, the nearest of the ten.
pub(crate) fn values(html: &mut String, found: &FabricFound) {
    html.push_str("<h3>Values</h3>");
    match &found.estimate {
        Estimated::Equilibrium(e) => {
            let rows = e.unknowns.iter().zip(found.estimate.factors()).map(|(u, f)| {
                vec![
                    f.name,
                    format!("{:.3}", u.multiplier),
                    format!("{:.3} to {:.3}", u.interval[0], u.interval[1]),
                    format!("{:.1}", 100.0 * u.log_sd_noise),
                    format!("{:.1}", 100.0 * u.log_sd_friction),
                    format!("{:.1}", 100.0 * e.mesh_log_sd),
                    f.note.into(),
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
            html.push_str("<h3>What the poses determine</h3>");
            let rows = e.combinations.iter().map(|c| {
                let word = if c.determined { "" } else { "held by the prior" };
                vec![c.words.clone(), format!("{:.1}", 100.0 * c.log_sd), word.into()]
            });
            table(html, &["combination of logarithms", "known to, %", ""], rows);
        }
        Estimated::Alternation(a) => {
            balance(html, &a.last, &found.estimate);
            let curves: Vec<Curve> = (0..a.last.groups.len())
                .map(|k| Curve {
                    name: a.last.groups[k].name.clone(),
                    points: a.history.iter().enumerate().map(|(i, m)| ((i + 1) as f64, m[k])).collect(),
                })
                .collect();
            html.push_str(&lines(&Axes { title: "Factors", x: "round", y: "factor", log_y: true }, &curves));
        }
        Estimated::Net(e) => balance(html, e, &found.estimate),
        Estimated::Kept { .. } => html.push_str("<p>None was found: as at the start.</p>"),
    }
    if !found.nearest.is_empty() {
        html.push_str("<h3>Nearest of the ten</h3>");
        let rows = found
            .nearest
            .iter()
            .map(|o| vec![o.name.clone(), format!("{:.1}", 100.0 * o.probability), number(o.distance2.sqrt())]);
        table(html, &["fabric", "odds, %", "distance, sd"], rows);
    }
}

/// What Eq. 10 says.
fn balance(html: &mut String, e: &FabricEstimate, estimate: &Estimated) {
    let _ = write!(
        html,
        "<p>Eq. 10: gradient {} N → {} N (rms), {} of {} rows, singular values {}.</p>",
        number(e.residual_before_n),
        number(e.residual_after_n),
        e.rows[0],
        e.rows[1],
        e.singular_values.iter().map(|v| number(*v)).collect::<Vec<_>>().join(", "),
    );
    let rows = e.groups.iter().zip(estimate.factors()).map(|(g, f)| {
        vec![f.name, format!("{:.3}", f.factor), format!("{:.0} %", 100.0 * g.determined), f.note.into()]
    });
    table(html, &["", "factor", "determined by the shapes", ""], rows);
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

/// Tension before, after with its band, and among the nearest of the ten.
pub(crate) fn curves(
    html: &mut String,
    material: &dyn MaterialModel,
    found: &FabricFound,
    fabrics: &[(String, Vec<f64>)],
) -> Result<()> {
    html.push_str("<h3>Tension over stretch</h3><p>Before, after with its 95 % band, and the nearest of the ten.</p>");
    let factors = |end: usize| -> Option<Vec<f64>> {
        let Estimated::Equilibrium(e) = &found.estimate else { return None };
        let groups = caphy_garment::estimate::reduction::groups(material);
        (groups.len() == e.unknowns.len()).then(|| {
            let mut values = found.after.clone();
            for (group, u) in groups.iter().zip(&e.unknowns) {
                let ratio = (u.interval[end] / u.multiplier).clamp(1e-2, 1e2);
                group.members.iter().for_each(|&i| values[i] *= ratio);
            }
            for (value, p) in values.iter_mut().zip(material.parameters()) {
                *value = value.clamp(p.lower, p.upper);
            }
            values
        })
    };
    let mut shown: Vec<(String, Vec<f64>)> =
        vec![("before".into(), found.before.clone()), ("after".into(), found.after.clone())];
    for (end, name) in ["2.5 %", "97.5 %"].iter().enumerate() {
        if let Some(values) = factors(end) {
            shown.push((name.to_string(), values));
        }
    }
    let mut near: Vec<&str> = found.nearest.iter().take(4).map(|o| o.name.as_str()).collect();
    if near.is_empty() {
        near = fabrics.iter().take(4).map(|f| f.0.as_str()).collect();
    }
    for name in near {
        if let Some(known) = fabrics.iter().find(|f| f.0 == name) {
            let inside = material.parameters().iter().zip(&known.1).all(|(p, v)| p.lower <= *v && *v <= p.upper);
            if inside {
                shown.push(known.clone());
            }
        }
    }
    for (axis, yarn) in ["u", "v"].iter().enumerate() {
        let mut list = Vec::new();
        for (name, values) in &shown {
            list.push(Curve { name: name.clone(), points: tension(&*material.with_parameters(values)?, axis)? });
        }
        let title = format!("Along {yarn}");
        html.push_str(&lines(&Axes { title: &title, x: "stretch, %", y: "N/m", log_y: false }, &list));
    }
    Ok(())
}

/// How each pose fits.
pub(crate) fn fits(html: &mut String, estimate: &Estimated) {
    let Estimated::Equilibrium(e) = estimate else { return };
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

fn poses(html: &mut String, problem: &Problem, found: &FabricFound) -> Result<()> {
    let (pictures, last) = drawn(problem, &found.shapes())?;
    for pair in pictures.chunks(2) {
        let capture = escape(&pair[0].0);
        let _ = write!(html, "<h3>{capture}</h3>");
        for ((_, picture), side) in pair.iter().zip(["front", "back"]) {
            let _ = write!(html, "<img alt=\"{capture} {side}\" src=\"{}\">", data_url(&png(picture)?));
        }
        let _ = write!(html, "<p>{}</p>", coloured_by(last));
    }
    Ok(())
}

/// What the pictures of poses show; `last`: distance that takes the last colour [m].
pub(crate) fn coloured_by(last: f64) -> String {
    format!(
        "The simulated cloth, coloured by its distance to the scan from 0 (dark) to {} mm (light), over the scan (grey).",
        number(1e3 * last)
    )
}

/// Simulated cloth over its scan, two pictures per pose, from the front and from behind, coloured by distance up to the
/// returned one [m].
pub(crate) fn drawn(problem: &Problem, shapes: &[Vec<Vec3>]) -> Result<(Vec<(String, Rgb)>, f64)> {
    let sigmas = problem.captures.iter().map(|c| c.noise(&problem.rest)).collect::<Result<Vec<_>>>()?;
    let last = LAST_COLOUR * sigmas.iter().copied().fold(0.0, f64::max);
    let mut out = Vec::new();
    for (capture, shape) in problem.captures.iter().zip(shapes) {
        let simulated = TriMesh { vertices: shape.clone(), faces: problem.rest.faces().to_vec() };
        let away = distances(&simulated, &capture.scan)?;
        let colours = field_colours(&away, (0.0, last), ColourMap::Viridis);
        let scan = match &capture.scan {
            ScanPoints::Surface { points, faces, .. } => TriMesh { vertices: points.clone(), faces: faces.clone() },
            ScanPoints::Known { vertices, points } if vertices.len() == simulated.vertices.len() => {
                TriMesh { vertices: points.clone(), faces: simulated.faces.clone() }
            }
            ScanPoints::Known { .. } => TriMesh::default(),
        };
        let bounds = mesh::bounds(&simulated.vertices).unwrap_or_default();
        for from in [&FRONT, &BACK] {
            let camera = frame(bounds, from, Projection::Orthographic, SIZE[0], SIZE[1]);
            let mut picture = Picture::new(camera, vec![Layer::per_vertex(&simulated, &colours)]);
            // Two surfaces half a millimetre apart hide each other in patches: the scan steps back.
            let back = from.normalize() * BEHIND_M;
            let behind =
                TriMesh { vertices: scan.vertices.iter().map(|p| p - back).collect(), faces: scan.faces.clone() };
            picture.layers.push(Layer::uniform(&behind, [190, 190, 190]));
            out.push((capture.name.clone(), picture.draw()));
        }
    }
    Ok((out, last))
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
