//! The header: which elements follow, with which properties, in which encoding.

use super::REWRITE;
use caphy_core::{Error, Result};
use std::path::Path;

/// How the elements are stored.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Encoding {
    Ascii,
    LittleEndian,
    BigEndian,
}

/// Type of a number.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Kind {
    fn parse(word: &str) -> Option<Self> {
        Some(match word {
            "char" | "int8" => Self::I8,
            "uchar" | "uint8" => Self::U8,
            "short" | "int16" => Self::I16,
            "ushort" | "uint16" => Self::U16,
            "int" | "int32" => Self::I32,
            "uint" | "uint32" => Self::U32,
            "float" | "float32" => Self::F32,
            "double" | "float64" => Self::F64,
            _ => return None,
        })
    }
    /// Size [bytes] in a binary file.
    pub(super) fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }
}

pub(super) struct Property {
    pub(super) name: String,
    pub(super) kind: Kind,
    /// Type of the length that stands before a list.
    pub(super) list_length: Option<Kind>,
}

pub(super) struct Element {
    pub(super) name: String,
    pub(super) count: usize,
    pub(super) properties: Vec<Property>,
}

/// The header and what follows it.
pub(super) fn read<'a>(path: &Path, bytes: &'a [u8]) -> Result<(Encoding, Vec<Element>, &'a [u8])> {
    let mut lines = Lines::new(bytes);
    let bad =
        |line: usize, problem: String, remedy: &str| Err(Error::format(path, format!("line {line}"), problem, remedy));
    if lines.next().is_none_or(|line| line.trim_ascii_end() != b"ply") {
        return bad(1, "does not start with `ply`".into(), "the file is damaged or no PLY: get it again");
    }
    let mut encoding = None;
    let mut elements: Vec<Element> = Vec::new();
    while let Some(line) = lines.next() {
        let number = lines.number;
        let text = String::from_utf8_lossy(line);
        let words: Vec<&str> = text.split_ascii_whitespace().take(6).collect();
        match words.as_slice() {
            [] | ["comment" | "obj_info", ..] => {}
            ["format", name, "1.0"] if encoding.is_none() => {
                encoding = Some(match *name {
                    "ascii" => Encoding::Ascii,
                    "binary_little_endian" => Encoding::LittleEndian,
                    "binary_big_endian" => Encoding::BigEndian,
                    other => return bad(number, format!("unknown encoding `{other:.40}`"), REWRITE),
                });
            }
            ["element", name, count] => {
                let Ok(count) = count.parse() else {
                    return bad(number, format!("`{count:.40}` is no number of elements"), REWRITE);
                };
                if elements.iter().any(|e| e.name == *name) {
                    return bad(number, format!("element `{name:.40}` occurs twice"), "rename one of them");
                }
                elements.push(Element { name: (*name).to_string(), count, properties: Vec::new() });
            }
            ["property", rest @ ..] => {
                let Some(element) = elements.last_mut() else {
                    return bad(number, "a property before the first element".into(), REWRITE);
                };
                let (list_length, kind, name) = match rest {
                    ["list", length, kind, name] => (Some(*length), *kind, *name),
                    [kind, name] => (None, *kind, *name),
                    _ => return bad(number, format!("`{text:.60}` is not like `property float x`"), REWRITE),
                };
                let parsed = (list_length.map(Kind::parse), Kind::parse(kind));
                let (list_length, Some(kind)) = (parsed.0.flatten(), parsed.1) else {
                    return bad(number, format!("unknown type in `{text:.60}`"), REWRITE);
                };
                if parsed.0.is_some() && list_length.is_none() {
                    return bad(number, format!("unknown type in `{text:.60}`"), REWRITE);
                }
                if element.properties.iter().any(|p| p.name == name) {
                    return bad(number, format!("property `{name:.40}` occurs twice"), "rename one of them");
                }
                element.properties.push(Property { name: name.to_string(), kind, list_length });
            }
            ["end_header"] => {
                let Some(encoding) = encoding else {
                    return bad(number, "no line `format` in the header".into(), REWRITE);
                };
                return Ok((encoding, elements, lines.rest));
            }
            _ => return bad(number, format!("`{text:.60}` is no line of a PLY 1.0 header"), REWRITE),
        }
    }
    bad(lines.number, "the file ends in its header".into(), "the file is cut off: get it again")
}

/// Lines with their number. The first one settles how lines end, since what follows the last may be binary.
struct Lines<'a> {
    rest: &'a [u8],
    number: usize,
    /// Carriage returns alone.
    old: bool,
}

impl<'a> Lines<'a> {
    fn new(bytes: &'a [u8]) -> Self {
        let end = bytes.iter().position(|b| matches!(b, b'\n' | b'\r'));
        let old = end.is_some_and(|e| bytes[e] == b'\r' && bytes.get(e + 1) != Some(&b'\n'));
        Self { rest: bytes, number: 0, old }
    }
    /// The next line that is ended; `None` at the end of the file.
    fn next(&mut self) -> Option<&'a [u8]> {
        let ending = if self.old { b'\r' } else { b'\n' };
        let end = self.rest.iter().position(|&b| b == ending)?;
        let (line, rest) = (&self.rest[..end], &self.rest[end + 1..]);
        self.rest = rest;
        self.number += 1;
        Some(line)
    }
}
