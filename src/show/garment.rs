//! What garments are, and how they lie on the T-posed body.

use crate::moving::garment_colour;
use crate::pictures;
use caphy_core::{Result, TriMesh};
use caphy_garment::template::{GarmentFacts, Quantiles, Repairs, Style, Template};
use caphy_render::Layer;
use caphy_render::shade::CLAY_SKIN;
use std::fmt::Write;

/// A style in a few words.
fn style_text(style: &Style) -> String {
    match style {
        Style::Given(s) if s.coefficients.is_empty() => s.name.clone(),
        Style::Given(s) => format!("{} {:?}", s.name, s.coefficients),
        other => {
            let names = other.kind().ranges().iter().map(|r| r.name);
            let values = names.zip(other.values()).map(|(name, value)| format!("{name} {value:.3}"));
            values.collect::<Vec<_>>().join(", ")
        }
    }
}

/// What was repaired, in words.
fn repairs_text(r: &Repairs) -> String {
    let counts = [
        (r.welded_vertices, "vertices merged"),
        (r.closed_seam_vertices, "merged across open seams"),
        (r.dropped_faces, "faces dropped"),
        (r.split_vertices, "vertices split"),
        (r.flipped_faces, "faces turned"),
        (r.dropped_pieces, "small pieces dropped"),
        (r.unused_vertices, "unused vertices dropped"),
    ];
    let mut words: Vec<String> =
        counts.iter().filter(|(count, _)| *count > 0).map(|(count, what)| format!("{count} {what}")).collect();
    if r.turned_inside_out {
        words.push("turned inside out".into());
    }
    if words.is_empty() { "none".into() } else { words.join(", ") }
}

/// The facts for people.
pub fn text(f: &GarmentFacts) -> String {
    let millimetres = |q: &Quantiles| format!("{:.1} / {:.1} / {:.1}", 1e3 * q.p05, 1e3 * q.median, 1e3 * q.p95);
    let mut out = format!(
        "{}: {}\n  {} vertices, {} triangles, {:.4} m²; clearance {:.1} mm\n  edges {} mm, angles {:.0} / {:.0} / {:.0}° \
         (5 %, median, 95 %), smallest angle {:.1}°\n  yarn axes: {}; layout / template area {:.3}\n",
        f.kind,
        style_text(&f.style),
        f.vertices,
        f.faces,
        f.area_m2,
        1e3 * f.clearance_m,
        millimetres(&f.edge_length_m),
        f.angle_deg.p05,
        f.angle_deg.median,
        f.angle_deg.p95,
        f.angle_deg.least,
        f.grain,
        f.layout_area_ratio,
    );
    // Writing to a String cannot fail.
    for l in &f.loops {
        let held = if l.held { ", held by the body" } else { "" };
        let _ = writeln!(out, "  {}: girth {:.3} m, {} vertices{held}", l.name, l.girth_m, l.vertices);
    }
    for l in &f.lengths {
        let _ = writeln!(out, "  {} to {}: {:.3} m", l.from, l.to, l.length_m);
    }
    if let Some(given) = &f.given {
        let p = &given.penetration;
        let _ = writeln!(
            out,
            "  inside the body: {:.2} % of vertices, {:.1} mm deep before; {:.2} %, {:.1} mm after; area x {:.3}",
            1e2 * p.inside_share[0],
            1e3 * p.deepest_m[0],
            1e2 * p.inside_share[1],
            1e3 * p.deepest_m[1],
            p.area_ratio
        );
        let repairs = repairs_text(&given.repairs);
        let _ = writeln!(out, "  repairs: {repairs}; every triangle split in four {} times", given.splits);
    }
    out
}

/// PNG of templates on the T-posed body, front and back.
///
/// # Errors
/// Only for pictures of no size.
pub fn sheet(rest: &TriMesh, templates: &[Template]) -> Result<Vec<u8>> {
    let bounds = pictures::padded(rest.bounds().unwrap_or_default());
    let mut cells = Vec::new();
    for template in templates {
        let layers =
            || vec![Layer::uniform(rest, CLAY_SKIN), Layer::uniform(&template.mesh, garment_colour(template.kind))];
        let label = match &template.style {
            Style::Given(s) => s.name.clone(),
            other => other.values().iter().map(|v| format!("{v:.2}")).collect::<Vec<_>>().join(" "),
        };
        cells.push((label, pictures::draw(layers(), bounds, &pictures::FRONT)));
        cells.push(("back".to_string(), pictures::draw(layers(), bounds, &pictures::BACK)));
    }
    pictures::sheet(&cells, 8)
}
