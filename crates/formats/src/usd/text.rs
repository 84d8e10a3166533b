//! The grammar of `.usda` files, written in pieces of bounded size.

use caphy_core::{Error, Result};
use std::fmt::Write as _;
use std::io::Write;
use std::path::Path;

/// Text that is handed on when this many bytes have come together.
const PIECE: usize = 1 << 16;

/// Writes properties of a prim, indented by eight.
pub(super) struct Text<'a> {
    path: &'a Path,
    out: &'a mut dyn Write,
    piece: String,
}

impl<'a> Text<'a> {
    pub(super) fn new(path: &'a Path, out: &'a mut dyn Write) -> Self {
        Self { path, out, piece: String::with_capacity(PIECE + 256) }
    }
    fn hand_on(&mut self) -> Result<()> {
        self.out.write_all(self.piece.as_bytes()).map_err(|e| Error::io(self.path, "write", e))?;
        self.piece.clear();
        Ok(())
    }
    pub(super) fn finish(mut self) -> Result<()> {
        self.hand_on()?;
        self.out.flush().map_err(|e| Error::io(self.path, "write", e))
    }
    pub(super) fn line(&mut self, text: &str) -> Result<()> {
        self.piece += text;
        self.piece.push('\n');
        if self.piece.len() >= PIECE { self.hand_on() } else { Ok(()) }
    }
    /// `[a, b, …]`.
    pub(super) fn values(&mut self, count: usize, mut value: impl FnMut(&mut String, usize)) -> Result<()> {
        self.piece.push('[');
        for i in 0..count {
            if i > 0 {
                self.piece += ", ";
            }
            value(&mut self.piece, i);
            if self.piece.len() >= PIECE {
                self.hand_on()?;
            }
        }
        self.piece.push(']');
        Ok(())
    }
    /// A property with one value for all time, and how it is interpolated over the mesh.
    pub(super) fn list(
        &mut self,
        name: &str,
        count: usize,
        interpolation: Option<&str>,
        value: impl FnMut(&mut String, usize),
    ) -> Result<()> {
        let _ = write!(self.piece, "        {name} = ");
        self.values(count, value)?;
        self.end(interpolation)
    }
    /// A property with a value per frame; a plain one when there is one frame.
    pub(super) fn samples(
        &mut self,
        name: &str,
        frames: usize,
        interpolation: Option<&str>,
        mut value: impl FnMut(&mut Self, usize) -> Result<()>,
    ) -> Result<()> {
        if frames == 1 {
            let _ = write!(self.piece, "        {name} = ");
            value(self, 0)?;
            return self.end(interpolation);
        }
        if interpolation.is_some() {
            let _ = write!(self.piece, "        {name}");
            self.end(interpolation)?;
        }
        self.line(&format!("        {name}.timeSamples = {{"))?;
        for frame in 0..frames {
            let _ = write!(self.piece, "            {}: ", super::FIRST + frame);
            value(self, frame)?;
            self.line(",")?;
        }
        self.line("        }")
    }
    /// Ends a property's line with its metadata.
    fn end(&mut self, interpolation: Option<&str>) -> Result<()> {
        match interpolation {
            None => self.line(""),
            Some(kind) => self.line(&format!(" (\n            interpolation = \"{kind}\"\n        )")),
        }
    }
}

/// `(x, y, z)` with as many digits as bring back the same `f32`.
pub(super) fn tuple(out: &mut String, values: &[f32]) {
    out.push('(');
    for (i, value) in values.iter().enumerate() {
        let _ = write!(out, "{}{value}", if i > 0 { ", " } else { "" });
    }
    out.push(')');
}

/// A string literal.
pub(super) fn quoted(text: &str) -> String {
    let mut out = String::from('"');
    for c in text.chars() {
        match c {
            '"' | '\\' => out.extend(['\\', c]),
            '\n' => out += "\\n",
            // Other control characters have no business in a name.
            c if c.is_control() => out.push(' '),
            c => out.push(c),
        }
    }
    out.push('"');
    out
}
