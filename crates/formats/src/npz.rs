//! NumPy archives (`.npz`): a zip of `.npy` arrays. Pickles are refused, never unpickled.
//!
//! Files of this field mix widths freely (faces as `u4` or `i8`, rates as `f8` or `i8`, weights as `f4` or `f8`): a
//! caller asks for the type that it needs. Sizes are checked before memory is taken: the directory against the file,
//! an array's header against its entry, and what an entry says it holds against what it packs.
//!
//! NaN and infinities pass through [`Npz::f64s`] and [`Npz::f32s`], since some files mark missing values so; callers
//! that cannot use them call [`Npz::finite_f64s`] and [`Npz::finite_f32s`].

mod archive;

use archive::{Entry, Refused, read_directory};
use caphy_core::{Error, Real, Result};
use std::io::Read;
use std::path::{Path, PathBuf};

/// Largest array that is read [bytes as `f64`]: ten times a body model's largest (SMPL-X pose correctives, 122 MB).
const LARGEST_ARRAY: u64 = 2 << 30;
/// Array up to which any compression is believed [bytes as `f64`]: twice a body model's largest, since arrays of zeros
/// (correctives that were switched off) pack a thousandfold and are real.
const LARGEST_EMPTY: u64 = 256 << 20;
/// Compression that is believed above that; floats of measurements pack by less than 4, sparse weights by 50.
const LARGEST_RATIO: u64 = 100;
/// Most texts of one array: each is a piece of memory of its own.
const MOST_TEXTS: usize = 1 << 20;
/// Longest `.npy` header that is read [bytes]: NumPy's own limit for untrusted files is of this order.
const LONGEST_HEADER: usize = 64 << 10;

/// An array in C order: the last axis varies fastest, whatever the order in the file.
#[derive(Debug, Clone, PartialEq)]
pub struct Array<T> {
    /// Length of each axis; empty for a scalar.
    pub shape: Vec<usize>,
    /// Values, shape [product of `shape`].
    pub data: Vec<T>,
}

/// A NumPy archive in memory; arrays are inflated when asked for.
pub struct Npz {
    path: PathBuf,
    bytes: Vec<u8>,
    names: Vec<String>,
    /// Parallel to `names`.
    entries: Vec<Entry>,
}

impl Npz {
    /// Opens an archive. `path` serves messages only.
    ///
    /// # Errors
    /// [`Error::Format`] for a pickle (with the one line that converts it), a damaged or cut-off archive.
    pub fn from_bytes(path: &Path, bytes: Vec<u8>) -> Result<Self> {
        let is_pickle_name =
            path.extension().is_some_and(|e| e.eq_ignore_ascii_case("pkl") || e.eq_ignore_ascii_case("pickle"));
        // Pickle protocols 2 to 5 start with 0x80 and their number.
        if is_pickle_name || matches!(bytes.as_slice(), [0x80, 2..=5, ..]) {
            let from = path.display();
            let to = path.with_extension("npz");
            let to = to.display();
            return Err(Error::format(
                path,
                "whole file",
                "is a Python pickle, which can run any code when read",
                format!(
                    "if you trust it, convert it once: python3 -c \"import pickle, numpy; \
                     d = pickle.load(open('{from}', 'rb'), encoding='latin1'); \
                     numpy.savez('{to}', **{{k: v.toarray() if hasattr(v, 'toarray') else numpy.array(v) \
                     for k, v in d.items()}})\""
                ),
            ));
        }
        let entries = read_directory(&bytes)
            .map_err(|Refused { problem, remedy }| Error::format(path, "zip directory", problem, remedy))?;
        let mut entries: Vec<(String, Entry)> = entries
            .into_iter()
            .filter_map(|entry| Some((entry.name.strip_suffix(".npy")?.to_string(), entry)))
            .collect();
        entries.sort_by(|a, b| a.0.cmp(&b.0));
        let (names, entries) = entries.into_iter().unzip();
        Ok(Self { path: path.into(), bytes, names, entries })
    }
    /// Path that was given, for messages of callers.
    pub fn path(&self) -> &Path {
        &self.path
    }
    /// Names of all arrays, sorted.
    pub fn names(&self) -> &[String] {
        &self.names
    }
    /// Whether an array of this name exists.
    pub fn has(&self, name: &str) -> bool {
        self.names.binary_search_by(|n| n.as_str().cmp(name)).is_ok()
    }
    /// A floating-point, integer or boolean array as `f64`. NaN and infinities pass: callers check.
    ///
    /// # Errors
    /// [`Error::Format`]: no such array (listing those that exist), not numeric, header and content disagree.
    pub fn f64s(&self, name: &str) -> Result<Array<f64>> {
        let raw = self.raw(name)?;
        let data = match raw.header.kind {
            Kind::Float(2) => raw.decode(|b: [u8; 2]| half(u16::from_le_bytes(b))),
            Kind::Float(4) => raw.decode(|b| f64::from(f32::from_le_bytes(b))),
            Kind::Float(_) => raw.decode(f64::from_le_bytes),
            Kind::Int(1) => raw.decode(|b| f64::from(i8::from_le_bytes(b))),
            Kind::Int(2) => raw.decode(|b| f64::from(i16::from_le_bytes(b))),
            Kind::Int(4) => raw.decode(|b| f64::from(i32::from_le_bytes(b))),
            Kind::Int(_) => raw.decode(|b| i64::from_le_bytes(b) as f64),
            Kind::Uint(1) => raw.decode(|b| f64::from(u8::from_le_bytes(b))),
            Kind::Uint(2) => raw.decode(|b| f64::from(u16::from_le_bytes(b))),
            Kind::Uint(4) => raw.decode(|b| f64::from(u32::from_le_bytes(b))),
            Kind::Uint(_) => raw.decode(|b| u64::from_le_bytes(b) as f64),
            Kind::Unicode(_) | Kind::Bytes(_) => return Err(self.wrong_kind(name, &raw, "numbers")),
        };
        Ok(raw.ordered(data))
    }
    /// A numeric array as `f32`; wider values are rounded. See [`Npz::f64s`].
    pub fn f32s(&self, name: &str) -> Result<Array<f32>> {
        let raw = self.raw(name)?;
        // The large arrays of body models are f4: they skip the way through f64.
        if raw.header.kind == Kind::Float(4) {
            let data = raw.decode(f32::from_le_bytes);
            return Ok(raw.ordered(data));
        }
        drop(raw);
        let wide = self.f64s(name)?;
        Ok(Array { shape: wide.shape, data: wide.data.into_iter().map(|x| x as f32).collect() })
    }
    /// [`Npz::f64s`] without NaN and infinities.
    ///
    /// # Errors
    /// Those of [`Npz::f64s`], and [`Error::Format`] naming the first value that is not finite.
    pub fn finite_f64s(&self, name: &str) -> Result<Array<f64>> {
        self.finite(name, self.f64s(name)?)
    }
    /// [`Npz::f32s`] without NaN and infinities, those of `f64` values too large for `f32` among them.
    ///
    /// # Errors
    /// Those of [`Npz::f64s`], and [`Error::Format`] naming the first value that is not finite.
    pub fn finite_f32s(&self, name: &str) -> Result<Array<f32>> {
        self.finite(name, self.f32s(name)?)
    }
    /// An integer or boolean array of any width as `i64`.
    ///
    /// Unsigned values keep their value (`u32::MAX`, the parent of a root joint, stays 4294967295); `u64` values over
    /// `i64::MAX` become `i64::MAX`, which is no valid index either.
    ///
    /// # Errors
    /// [`Error::Format`]: no such array (listing those that exist), not integers, header and content disagree.
    pub fn i64s(&self, name: &str) -> Result<Array<i64>> {
        let raw = self.raw(name)?;
        let data = match raw.header.kind {
            Kind::Int(1) => raw.decode(|b| i64::from(i8::from_le_bytes(b))),
            Kind::Int(2) => raw.decode(|b| i64::from(i16::from_le_bytes(b))),
            Kind::Int(4) => raw.decode(|b| i64::from(i32::from_le_bytes(b))),
            Kind::Int(_) => raw.decode(i64::from_le_bytes),
            Kind::Uint(1) => raw.decode(|b| i64::from(u8::from_le_bytes(b))),
            Kind::Uint(2) => raw.decode(|b| i64::from(u16::from_le_bytes(b))),
            Kind::Uint(4) => raw.decode(|b| i64::from(u32::from_le_bytes(b))),
            Kind::Uint(_) => raw.decode(|b| i64::try_from(u64::from_le_bytes(b)).unwrap_or(i64::MAX)),
            Kind::Float(_) | Kind::Unicode(_) | Kind::Bytes(_) => {
                return Err(self.wrong_kind(name, &raw, "integers"));
            }
        };
        Ok(raw.ordered(data))
    }
    /// An array of texts (`<U…` or `|S…`), flat in C order, padding removed.
    ///
    /// # Errors
    /// [`Error::Format`]: no such array (listing those that exist), not texts, invalid characters.
    pub fn strings(&self, name: &str) -> Result<Vec<String>> {
        let raw = self.raw(name)?;
        if raw.header.count > MOST_TEXTS {
            let problem = format!("{} texts, at most {MOST_TEXTS} are read", raw.header.count);
            return Err(Error::format(&self.path, format!("array `{name}`"), problem, "texts are names: save fewer"));
        }
        let bad = |i: usize| {
            Error::format(
                &self.path,
                format!("array `{name}`, element {i}"),
                "is no valid Unicode text",
                "save the array again as texts",
            )
        };
        let size = raw.header.kind.size();
        let elements = || if size == 0 { raw.data.chunks(1) } else { raw.data.chunks(size) };
        let data: Vec<String> = match raw.header.kind {
            // A '<U0' array holds only empty texts.
            Kind::Unicode(0) | Kind::Bytes(0) => vec![String::new(); raw.header.count],
            Kind::Unicode(_) => elements()
                .enumerate()
                .map(|(i, b)| {
                    let text: Option<String> =
                        b.as_chunks::<4>().0.iter().map(|c| char::from_u32(raw.u32_of(*c))).collect();
                    text.map(|t| t.trim_end_matches('\0').into()).ok_or_else(|| bad(i))
                })
                .collect::<Result<_>>()?,
            Kind::Bytes(_) => elements()
                .enumerate()
                .map(|(i, b)| std::str::from_utf8(b).map(|t| t.trim_end_matches('\0').into()).map_err(|_| bad(i)))
                .collect::<Result<_>>()?,
            _ => return Err(self.wrong_kind(name, &raw, "texts")),
        };
        Ok(raw.ordered(data).data)
    }
    /// The single number of a scalar or one-element array. See [`Npz::f64s`].
    pub fn f64_scalar(&self, name: &str) -> Result<f64> {
        let array = self.f64s(name)?;
        match array.data.as_slice() {
            [value] => Ok(*value),
            _ => Err(Error::format(
                &self.path,
                format!("array `{name}`"),
                format!("has shape {:?}", array.shape),
                "one number is needed",
            )),
        }
    }

    fn finite<T: Real>(&self, name: &str, array: Array<T>) -> Result<Array<T>> {
        let Some(flat) = array.data.iter().position(|x| !x.is_finite()) else { return Ok(array) };
        let mut rest = flat;
        let mut index: Vec<usize> = array.shape.iter().rev().map(|&n| (rest % n, rest /= n).0).collect();
        index.reverse();
        Err(Error::format(
            &self.path,
            format!("array `{name}`, element {index:?} of {:?}", array.shape),
            format!("is {}", array.data[flat].to_f64()),
            "finite numbers are needed: repair the file or drop what the value belongs to",
        ))
    }

    fn wrong_kind(&self, name: &str, raw: &Raw, wanted: &str) -> Error {
        Error::format(
            &self.path,
            format!("array `{name}`"),
            format!("has type '{}', shape {:?}", raw.header.descr, raw.header.shape),
            format!("{wanted} are needed"),
        )
    }

    fn raw(&self, name: &str) -> Result<Raw> {
        let at = || format!("array `{name}`");
        let Ok(place) = self.names.binary_search_by(|n| n.as_str().cmp(name)) else {
            let list = if self.names.is_empty() { "none".into() } else { self.names.join(", ") };
            return Err(Error::format(&self.path, at(), "is missing", format!("arrays in this file: {list}")));
        };
        let found = &self.entries[place];
        let damaged = |problem: String| {
            Error::format(&self.path, at(), problem, "the file is damaged or made to deceive: get it again")
        };
        let mut entry = found
            .open(&self.bytes)
            .map_err(|Refused { problem, remedy }| Error::format(&self.path, at(), problem, remedy))?;

        let mut start = [0u8; 10];
        entry.read_exact(&mut start).map_err(|e| damaged(format!("no .npy header: {e}")))?;
        if !start.starts_with(b"\x93NUMPY") {
            return Err(damaged(format!("starts with {:02x?}, not with the .npy magic", &start[..6])));
        }
        let mut length = usize::from(u16::from_le_bytes([start[8], start[9]]));
        let mut before_data = 10;
        match start[6] {
            1 => {}
            2 | 3 => {
                let mut high = [0u8; 2];
                entry.read_exact(&mut high).map_err(|e| damaged(format!("no .npy header: {e}")))?;
                length |= usize::from(u16::from_le_bytes(high)) << 16;
                before_data = 12;
            }
            v => return Err(damaged(format!(".npy version {v}, known are 1 to 3"))),
        }
        if length > LONGEST_HEADER {
            return Err(damaged(format!(".npy header of {length} bytes, at most {LONGEST_HEADER} are read")));
        }
        let mut text = vec![0u8; length];
        entry.read_exact(&mut text).map_err(|e| damaged(format!("cut off in the .npy header: {e}")))?;
        let header = Header::parse(&text).map_err(|problem| {
            Error::format(&self.path, at(), problem, "save plain arrays of numbers or texts with numpy.savez")
        })?;

        // All three must agree before memory is taken: what the header needs, what the zip directory announces, the cap.
        let expected = (header.count as u64)
            .checked_mul(header.kind.size() as u64)
            .ok_or_else(|| damaged(format!("shape {:?} overflows", header.shape)))?;
        let held = found.size.saturating_sub((before_data + length) as u64);
        if expected != held {
            return Err(damaged(format!(
                "type '{}' and shape {:?} need {expected} bytes, the archive announces {held}",
                header.descr, header.shape
            )));
        }
        // Narrow numbers grow to eight bytes when they are handed out, and texts to more than that.
        let handed_out = expected.max((header.count as u64).saturating_mul(8));
        if handed_out > LARGEST_ARRAY {
            return Err(damaged(format!("{handed_out} bytes in memory, at most {LARGEST_ARRAY} are read")));
        }
        if handed_out > LARGEST_EMPTY && found.size / LARGEST_RATIO > found.compressed {
            let problem = format!("{expected} bytes out of {}: more than {LARGEST_RATIO} to 1", found.compressed);
            let remedy = "if the array is real, save it with numpy.savez (not compressed)";
            return Err(Error::format(&self.path, at(), problem, remedy));
        }
        // A directory may lie: memory grows with what really arrives.
        let mut data = Vec::with_capacity((expected as usize).min(64 << 20));
        entry
            .by_ref()
            .take(expected + 1)
            .read_to_end(&mut data)
            .map_err(|e| damaged(format!("cannot inflate: {e}")))?;
        if data.len() as u64 != expected {
            return Err(damaged(format!("{} bytes of data instead of {expected}", data.len())));
        }
        entry.finish().map_err(damaged)?;
        Ok(Raw { header, data })
    }
}

/// Element types that are read, with their size in bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    Float(usize),
    Int(usize),
    /// Unsigned integers, and booleans as one byte.
    Uint(usize),
    Unicode(usize),
    Bytes(usize),
}

impl Kind {
    fn size(self) -> usize {
        match self {
            Self::Float(n) | Self::Int(n) | Self::Uint(n) | Self::Unicode(n) | Self::Bytes(n) => n,
        }
    }
}

struct Header {
    descr: String,
    kind: Kind,
    big_endian: bool,
    fortran: bool,
    shape: Vec<usize>,
    count: usize,
}

impl Header {
    /// Parses `{'descr': '<f4', 'fortran_order': False, 'shape': (3, 4), }`, the only form NumPy writes for plain types.
    fn parse(text: &[u8]) -> std::result::Result<Self, String> {
        let text = std::str::from_utf8(text).map_err(|_| "header is no text".to_string())?;
        let after = |key: &str| {
            let at = text.find(&format!("'{key}'")).ok_or_else(|| format!("header without '{key}': {text:.120}"))?;
            text[at + key.len() + 2..]
                .trim_start()
                .strip_prefix(':')
                .map(str::trim_start)
                .ok_or_else(|| format!("no value after '{key}' in the header"))
        };
        let descr = after("descr")?
            .strip_prefix('\'')
            .and_then(|t| t.split_once('\''))
            .map(|(d, _)| d.to_string())
            .ok_or("structured element types are not read")?;
        let mut chars = descr.chars();
        let order = chars.next().unwrap_or(' ');
        let (code, width) = if "<>=|".contains(order) {
            (chars.next().unwrap_or(' '), chars.as_str())
        } else {
            (order, chars.as_str())
        };
        let unknown = || format!("element type '{descr}' is not read");
        let width: usize = width.parse().map_err(|_| unknown())?;
        let kind = match (code, width) {
            ('f', 2 | 4 | 8) => Kind::Float(width),
            ('i', 1 | 2 | 4 | 8) => Kind::Int(width),
            ('u', 1 | 2 | 4 | 8) | ('b', 1) => Kind::Uint(width),
            ('U', 0..=65536) => Kind::Unicode(4 * width),
            ('S', 0..=65536) => Kind::Bytes(width),
            _ => return Err(unknown()),
        };
        let fortran = match after("fortran_order")? {
            t if t.starts_with("True") => true,
            t if t.starts_with("False") => false,
            _ => return Err("'fortran_order' is neither True nor False".into()),
        };
        let inside = after("shape")?
            .strip_prefix('(')
            .and_then(|t| t.split_once(')'))
            .map(|(s, _)| s)
            .ok_or("'shape' is no tuple")?;
        let shape = inside
            .split(',')
            .map(|n| n.trim().trim_end_matches('L'))
            .filter(|n| !n.is_empty())
            .map(|n| n.parse::<usize>().map_err(|_| format!("axis length `{n:.40}` in the shape")))
            .collect::<std::result::Result<Vec<_>, _>>()?;
        // Axes of length 0 must not hide an overflow: callers multiply some of the axes.
        let full = shape.iter().try_fold(1usize, |a, &n| a.checked_mul(n.max(1)));
        let full = full.ok_or_else(|| format!("shape {shape:?} overflows"))?;
        let count = if shape.contains(&0) { 0 } else { full };
        // Elements of no bytes ('<U0') would make the count free of any file size.
        if kind.size() == 0 && count > LONGEST_HEADER {
            return Err(format!("{count} empty texts"));
        }
        Ok(Self { big_endian: order == '>', descr, kind, fortran, shape, count })
    }
}

struct Raw {
    header: Header,
    /// `count` elements of `kind.size()` bytes, in the file's order.
    data: Vec<u8>,
}

impl Raw {
    /// Every element through `read`, which gets little-endian bytes; N is the element's size.
    fn decode<const N: usize, T>(&self, read: impl Fn([u8; N]) -> T) -> Vec<T> {
        let (chunks, _) = self.data.as_chunks::<N>();
        if self.header.big_endian {
            let swap = |b: &[u8; N]| {
                let mut b = *b;
                b.reverse();
                b
            };
            chunks.iter().map(|b| read(swap(b))).collect()
        } else {
            chunks.iter().map(|b| read(*b)).collect()
        }
    }
    fn u32_of(&self, bytes: [u8; 4]) -> u32 {
        if self.header.big_endian { u32::from_be_bytes(bytes) } else { u32::from_le_bytes(bytes) }
    }
    /// The values in C order.
    fn ordered<T: Clone>(&self, data: Vec<T>) -> Array<T> {
        let shape = self.header.shape.clone();
        if !self.header.fortran || shape.len() < 2 || data.is_empty() {
            return Array { shape, data };
        }
        // Stride of each axis in the file, where the first axis varies fastest.
        let mut strides = vec![1; shape.len()];
        for axis in 1..shape.len() {
            strides[axis] = strides[axis - 1] * shape[axis - 1];
        }
        let mut index = vec![0; shape.len()];
        let mut at = 0;
        let mut out = Vec::with_capacity(data.len());
        for _ in 0..data.len() {
            out.push(data[at].clone());
            for axis in (0..shape.len()).rev() {
                index[axis] += 1;
                at += strides[axis];
                if index[axis] < shape[axis] {
                    break;
                }
                at -= strides[axis] * shape[axis];
                index[axis] = 0;
            }
        }
        Array { shape, data: out }
    }
}

/// IEEE 754 half precision.
fn half(bits: u16) -> f64 {
    let sign = if bits & 0x8000 == 0 { 1.0 } else { -1.0 };
    let fraction = f64::from(bits & 0x3ff);
    match (bits >> 10) & 0x1f {
        0 => sign * fraction * 2f64.powi(-24),
        31 if fraction == 0.0 => sign * f64::INFINITY,
        31 => f64::NAN,
        e => sign * (1.0 + fraction / 1024.0) * 2f64.powi(i32::from(e) - 15),
    }
}
