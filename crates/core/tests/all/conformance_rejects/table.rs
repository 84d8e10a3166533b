//! A table with one key, for the faulty plugins.

use caphy_core::{Error, Result};

/// `type = "…"` and `size`.
pub(crate) const TABLE: &str = "type = \"small\"\nsize = 2.0\n";

/// The value of `size`; other keys are refused unless `lenient`.
pub(crate) fn read(text: &str, lenient: bool) -> Result<f64> {
    let table: toml::Table = toml::from_str(text).map_err(|e| Error::config("table", e.message(), "correct it"))?;
    for key in table.keys() {
        if !["type", "size"].contains(&key.as_str()) && !lenient {
            return Err(Error::config(key, "is unknown", "remove it"));
        }
    }
    Ok(table["size"].as_float().expect("a number"))
}

/// The table written back, with another value when `changed`.
pub(crate) fn write(text: &str, changed: bool) -> Result<String> {
    let size = read(text, true)? + if changed { 1.0 } else { 0.0 };
    Ok(format!("type = \"small\"\nsize = {size:?}\n"))
}
