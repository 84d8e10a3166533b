//! The page of an ablation, self-contained.

use super::table::MEANING;
use super::{PaperRow, Row, Table};
use crate::page;
use crate::plot::{Difference, escape, intervals, number};
use caphy_core::Result;
use std::fmt::Write;
use std::path::PathBuf;

/// What the paper has for a measure, of both cases.
type OfPaper = fn(&PaperRow) -> [f64; 2];

/// A plot per measure that differences are told of: rows against the one that others are compared with, beside the paper's.
fn plots(table: &Table, rows: &[&Row]) -> String {
    let chamfer: (&str, OfPaper) = ("the paper’s two cases", |p| p.chamfer_mm);
    // Another measure than ours, and the only one of pictures that there is.
    let perceptual: (&str, OfPaper) = ("the paper’s two cases, by VGG-16", |p| p.perceptual);
    let base = rows.iter().find(|r| r.title == table.against).and_then(|r| r.paper);
    let mut out = String::new();
    for (i, (name, head)) in table.compared().enumerate() {
        let (legend, of) = if i == 0 { chamfer } else { perceptual };
        let difference = |row: &&Row| {
            let compared = row.compared.iter().find(|c| c.name == name)?;
            let others = match (row.paper, base) {
                (Some(own), Some(base)) => (0..2).map(|case| of(&own)[case] / of(&base)[case] - 1.0).collect(),
                _ => Vec::new(),
            };
            Some(Difference { name: row.title.clone(), change: compared.change, others })
        };
        let differences: Vec<Difference> = rows.iter().filter_map(difference).collect();
        let title = if i == 0 { "3D-CD" } else { head };
        out += &intervals(title, &format!("change against “{}”, %", table.against), legend, &differences);
    }
    out
}

/// The page: a table per garment, everything that was measured, pictures by title.
pub(super) fn page(table: &Table, pictures: &[(String, PathBuf)]) -> Result<String> {
    let mut html = page::head("caphy ablation");
    // Writing to a String cannot fail.
    let _ = write!(
        html,
        "<p>Seeds {:?}. In brackets: the change against “{}”, and where 95 % of the draws of scans lie.</p>",
        table.seeds,
        escape(&table.against)
    );
    let mut kinds: Vec<_> = table.rows.iter().map(|r| r.kind).collect();
    kinds.dedup();
    for kind in kinds {
        let rows: Vec<_> = table.rows.iter().filter(|r| r.kind == kind).collect();
        let _ = write!(html, "<h2>{kind} garment</h2><p>{} held-out scans.</p>", rows[0].scans);
        html.push_str(&plots(table, &rows));
        let head = table.head();
        let head: Vec<&str> = head.iter().map(String::as_str).collect();
        page::table(&mut html, &head, rows.iter().map(|r| table.cells(r)));
        let _ = write!(html, "<details><summary>Everything that was measured</summary>");
        let names: Vec<&str> = rows[0].means.iter().map(|m| m.name.as_str()).collect();
        let head: Vec<&str> =
            std::iter::once("").chain(names.iter().copied()).chain(["fabric, median |log ratio|"]).collect();
        let cells = rows.iter().map(|row| {
            let mean =
                |name: &&str| row.means.iter().find(|m| m.name == **name).map_or("–".to_string(), |m| number(m.mean));
            let mut cells = vec![row.title.clone()];
            cells.extend(names.iter().map(mean));
            cells.push(row.fabric_log_error.map_or("–".into(), number));
            cells
        });
        page::table(&mut html, &head, cells);
        html.push_str("</details>");
    }
    let _ = write!(html, "<p>{}</p><h2>Held-out scans</h2>", escape(MEANING.trim()));
    for (title, path) in pictures {
        let source = page::embedded(path)?;
        let _ = write!(html, "<h3>{0}</h3><img alt=\"{0}\" src=\"{source}\">", escape(title));
    }
    html.push_str("</html>");
    Ok(html)
}
