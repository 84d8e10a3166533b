//! Parts of pages that need nothing but themselves: pictures as data URLs, tables.

use crate::plot::escape;
use caphy_core::{Error, Result};
use std::fmt::Write;
use std::path::Path;

const STYLE: &str = "body{font:15px/1.5 system-ui,sans-serif;max-width:1100px;margin:2em auto;padding:0 1em;color:#222}\
h1,h2{font-weight:600}h2{margin-top:2em;border-bottom:1px solid #ddd}img{max-width:100%}\
table{border-collapse:collapse;margin:.6em 0;display:block;overflow-x:auto}\
td,th{padding:.2em .7em;border-bottom:1px solid #e4e4e4;text-align:right}\
td:first-child,th:first-child{text-align:left}.plot{width:48%;min-width:420px}pre{overflow-x:auto}\
.warn{background:#fff6e0;border-left:4px solid #d99a1c;padding:.5em 1em}ul.warn{padding-left:2.2em}";

/// The beginning of a page with a title.
pub(crate) fn head(title: &str) -> String {
    let title = escape(title);
    format!(
        "<!doctype html><html lang=\"en\"><meta charset=\"utf-8\"><title>{title}</title><style>{STYLE}{plot}</style>\
         <h1>{title}</h1>",
        plot = crate::plot::STYLE,
    )
}

/// A PNG as a data URL.
///
/// # Errors
/// [`Error::Io`].
pub(crate) fn embedded(path: &Path) -> Result<String> {
    let bytes = std::fs::read(path).map_err(|e| Error::io(path, "read", e))?;
    Ok(data_url(&bytes))
}

/// The same of a PNG in memory.
pub(crate) fn data_url(png: &[u8]) -> String {
    format!("data:image/png;base64,{}", base64(png))
}

/// Standard base64 with padding (RFC 4648).
fn base64(bytes: &[u8]) -> String {
    const LETTERS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut out = String::with_capacity(bytes.len().div_ceil(3) * 4);
    for chunk in bytes.chunks(3) {
        let value = chunk.iter().fold(0u32, |v, b| v << 8 | u32::from(*b)) << (8 * (3 - chunk.len()));
        for k in 0..4 {
            if k <= chunk.len() {
                out.push(char::from(LETTERS[(value >> (18 - 6 * k) & 63) as usize]));
            } else {
                out.push('=');
            }
        }
    }
    out
}

/// A table with a head, its cells escaped.
pub(crate) fn table(html: &mut String, head: &[&str], rows: impl IntoIterator<Item = Vec<String>>) {
    let cells =
        |tag: &str, row: &[String]| -> String { row.iter().map(|c| format!("<{tag}>{}</{tag}>", escape(c))).collect() };
    let head: Vec<String> = head.iter().map(|h| h.to_string()).collect();
    let _ = write!(html, "<table><tr>{}</tr>", cells("th", &head));
    for row in rows {
        let _ = write!(html, "<tr>{}</tr>", cells("td", &row));
    }
    html.push_str("</table>");
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn base64_meets_the_standard_vectors() {
        for (text, code) in [("", ""), ("f", "Zg=="), ("fo", "Zm8="), ("foo", "Zm9v"), ("foobar", "Zm9vYmFy")] {
            assert_eq!(base64(text.as_bytes()), code);
        }
    }

    #[test]
    fn cells_are_escaped() {
        let mut html = String::new();
        table(&mut html, &["a<b"], [vec!["1 & 2".to_string()]]);
        assert_eq!(html, "<table><tr><th>a&lt;b</th></tr><tr><td>1 &amp; 2</td></tr></table>");
    }
}
