//! `docs/trade.md`, its figures, and the front that becomes part of the program.

use super::page::plots;
use super::table::Results;
use crate::artifact::write_atomically;
use crate::plot::standalone;
use caphy_core::{Error, Result};
use std::fmt::Write;
use std::path::Path;

/// What the page says whatever was measured.
const HEAD: &str = include_str!("docs_head.md");

/// Writes the page; figures and front go into a folder of its name beside it.
pub(super) fn write(results: &Results, page: &Path) -> Result<()> {
    let stem = page.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let folder = page.with_extension("");
    let mut out = HEAD.replace("SCENE", &results.scene);
    for (name, svg) in plots(results) {
        write_atomically(&folder.join(format!("{name}.svg")), standalone(&svg).as_bytes())?;
        // Writing to a String cannot fail.
        let _ = writeln!(out, "![{name}]({stem}/{name}.svg)\n");
    }
    for (title, head, rows) in results.tables() {
        let line = |cells: &[String]| format!("| {} |", cells.join(" | ").replace('\n', " "));
        let _ = writeln!(out, "## {title}\n\n{}", line(&head));
        let _ = writeln!(out, "{}", line(&vec!["---".to_string(); head.len()]));
        for row in rows {
            let _ = writeln!(out, "{}", line(&row));
        }
        out.push('\n');
    }
    out.push_str("## What the numbers are\n\n");
    for fact in results.facts() {
        let _ = writeln!(out, "- {fact}");
    }
    write_atomically(page, out.as_bytes())?;
    let mut front = serde_json::to_string_pretty(&results.front)
        .map_err(|e| Error::numerics("front.json", e.to_string(), "report this as a defect"))?;
    front.push('\n');
    write_atomically(&folder.join("front.json"), front.as_bytes())
}
