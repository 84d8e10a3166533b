//! The subcommands: arguments in, text out. What they do stands in the library.

/// A line of standard output, as `println!`, but an error instead of a panic where it cannot be written.
macro_rules! say {
    ($($text:tt)*) => { $crate::command::write_out(format_args!("{}\n", format_args!($($text)*))) };
}
/// [`say`] without the end of the line.
macro_rules! tell {
    ($($text:tt)*) => { $crate::command::write_out(format_args!($($text)*)) };
}

/// A line of standard error, as `eprintln!`, but nothing instead of a panic where it cannot be written.
macro_rules! note {
    ($($text:tt)*) => { $crate::command::write_note(format_args!("{}\n", format_args!($($text)*))) };
}
pub(crate) use note;

pub(crate) mod ablation;
pub(crate) mod animate;
pub(crate) mod check;
pub(crate) mod estimate;
mod figure;
pub(crate) mod probe;
pub(crate) mod run;
pub(crate) mod show;
pub(crate) mod simulate;
pub(crate) mod stress;
pub(crate) mod synth;
pub(crate) mod tradeoff;
pub(crate) mod train;
pub(crate) mod views;

use caphy_core::{Error, Result};
use serde::Serialize;

/// Writes to standard output. That its reader has gone, such as `head`, is nobody's fault: what was computed is saved by then.
fn write_out(text: std::fmt::Arguments<'_>) -> Result<()> {
    use std::io::{ErrorKind, Write, stdout};
    let mut out = stdout().lock();
    match out.write_fmt(text).and_then(|()| out.flush()) {
        Err(e) if e.kind() != ErrorKind::BrokenPipe => Err(Error::io("standard output", "write", e)),
        _ => Ok(()),
    }
}

/// Writes to standard error. What it says only accompanies what is done.
pub(crate) fn write_note(text: std::fmt::Arguments<'_>) {
    use std::io::{Write, stderr};
    let _ = stderr().lock().write_fmt(text);
}

/// A value as JSON for scripts: every float with all its digits.
fn json(value: &impl Serialize) -> Result<String> {
    serde_json::to_string_pretty(value).map_err(|e| Error::numerics("JSON", e.to_string(), "report this as a defect"))
}
