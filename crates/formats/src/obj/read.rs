//! The reader: one pass over the bytes, then one over the polygons.

use super::{ObjGroup, ObjMesh, ObjNormals, ObjUvs};
use crate::colour;
use crate::number::{float_prefix, parse_float};
use crate::polygon::Polygons;
use caphy_core::scan::Scan;
use caphy_core::{Error, Result, TriMesh, Vec3};
use std::path::Path;

/// Statements whose geometry would be lost if they were skipped: free-form curves and surfaces, and other files.
const REFUSED: [&[u8]; 11] =
    [b"curv", b"curv2", b"surf", b"cstype", b"bmat", b"parm", b"bsp", b"bzp", b"cdc", b"cdp", b"call"];

/// Statements that a surface does not need: other elements, smoothing, display attributes, and parts of
/// free-form geometry that mean nothing without the statements above.
const SKIPPED: [&[u8]; 25] = [
    b"vp",
    b"p",
    b"l",
    b"s",
    b"mg",
    b"usemap",
    b"maplib",
    b"bevel",
    b"c_interp",
    b"d_interp",
    b"lod",
    b"shadow_obj",
    b"trace_obj",
    b"ctech",
    b"stech",
    b"deg",
    b"step",
    b"trim",
    b"hole",
    b"scrv",
    b"sp",
    b"end",
    b"con",
    b"res",
    b"csh",
];

/// Most numbers that a statement of vertex data has: `v x y z r g b a`.
const MOST_NUMBERS: usize = 7;

pub(super) fn read(path: &Path, bytes: &[u8]) -> Result<ObjMesh> {
    let mut reader = Reader {
        path,
        bytes,
        // A byte order mark is no statement.
        at: if bytes.starts_with(b"\xef\xbb\xbf") { 3 } else { 0 },
        continued_to: None,
        vertices: Vec::new(),
        colours: Vec::new(),
        uvs: Vec::new(),
        normals: Vec::new(),
        polygons: Polygons::default(),
        uv_corners: Corners::default(),
        normal_corners: Corners::default(),
        largest: [(0, 0); 3],
        groups: Vec::new(),
        materials: Vec::new(),
        libraries: Vec::new(),
    };
    while reader.at < bytes.len() {
        reader.statement()?;
    }
    if reader.continued_to == Some(bytes.len()) {
        return Err(Error::format(path, "last line", "ends with a backslash", "the file is cut off: get it again"));
    }
    reader.finish()
}

/// Ids of one attribute, parallel to the polygons' corners, as long as every face has them.
#[derive(Default)]
struct Corners {
    ids: Vec<u32>,
    missing: bool,
}

struct Reader<'a> {
    path: &'a Path,
    bytes: &'a [u8],
    at: usize,
    /// Where the last backslash at the end of a line led.
    continued_to: Option<usize>,
    vertices: Vec<Vec3>,
    colours: Vec<[f32; 3]>,
    uvs: Vec<[f64; 2]>,
    normals: Vec<Vec3>,
    polygons: Polygons,
    uv_corners: Corners,
    normal_corners: Corners,
    /// Largest id of `v`, `vt`, `vn` (from 1) and its place: faces may stand before what they name.
    largest: [(u64, usize); 3],
    /// Names with the number of the first polygon.
    groups: Vec<(String, usize)>,
    /// Materials in use with the number of the first polygon.
    materials: Vec<(String, usize)>,
    /// Files that define materials.
    libraries: Vec<String>,
}

fn is_blank(byte: u8) -> bool {
    matches!(byte, b' ' | b'\t' | 0x0b | 0x0c)
}

fn is_line_end(byte: u8) -> bool {
    matches!(byte, b'\n' | b'\r')
}

/// The start of a word, for messages.
fn shown(word: &[u8]) -> String {
    String::from_utf8_lossy(word).chars().take(40).collect()
}

impl<'a> Reader<'a> {
    fn byte(&self) -> Option<u8> {
        self.bytes.get(self.at).copied()
    }

    /// An error at a place; lines are counted here alone, so that reading need not.
    fn bad(&self, at: usize, problem: impl Into<String>) -> Error {
        let before = &self.bytes[..at];
        // A carriage return counts as a line end of its own only without a line feed behind it.
        let ends = before
            .iter()
            .enumerate()
            .filter(|&(i, &b)| b == b'\n' || b == b'\r' && self.bytes.get(i + 1) != Some(&b'\n'));
        let line = ends.count() + 1;
        Error::format(self.path, format!("line {line}"), problem, "correct the line or export again")
    }

    /// The end of a backslash's line when the backslash is its last word.
    fn continuation(&self, backslash: usize) -> Option<usize> {
        let mut at = backslash + 1;
        while self.bytes.get(at).copied().is_some_and(is_blank) {
            at += 1;
        }
        match (self.bytes.get(at), self.bytes.get(at + 1)) {
            (None, _) => Some(at),
            (Some(b'\r'), Some(b'\n')) => Some(at + 2),
            (Some(&b), _) if is_line_end(b) => Some(at + 1),
            _ => None,
        }
    }

    /// Goes to the next word; `false` at the end of the statement.
    #[inline]
    fn word_follows(&mut self) -> bool {
        loop {
            match self.byte() {
                Some(b' ' | b'\t' | 0x0b | 0x0c) => self.at += 1,
                Some(b'\\') => match self.continuation(self.at) {
                    Some(next) => {
                        self.at = next;
                        self.continued_to = Some(next);
                    }
                    None => return true,
                },
                None | Some(b'\n' | b'\r' | b'#') => return false,
                _ => return true,
            }
        }
    }

    /// Whether a word ends here.
    #[inline]
    fn at_word_end(&self) -> bool {
        match self.byte() {
            None | Some(b' ' | b'\t' | 0x0b | 0x0c | b'\n' | b'\r' | b'#') => true,
            Some(b'\\') => self.continuation(self.at).is_some(),
            _ => false,
        }
    }

    fn word(&mut self) -> &'a [u8] {
        let start = self.at;
        while !self.at_word_end() {
            self.at += 1;
        }
        &self.bytes[start..self.at]
    }

    /// The word at a place, for messages.
    fn word_at(&mut self, place: usize) -> String {
        self.at = place;
        shown(self.word())
    }

    /// Goes behind the end of the statement.
    fn skip_statement(&mut self) {
        loop {
            match self.byte() {
                None => return,
                Some(b'\n' | b'\r') => {
                    self.at += 1;
                    return;
                }
                Some(b'#') => {
                    let rest = &self.bytes[self.at..];
                    self.at += rest.iter().position(|&b| is_line_end(b)).unwrap_or(rest.len());
                }
                Some(b'\\') => match self.continuation(self.at) {
                    Some(next) => {
                        self.at = next;
                        self.continued_to = Some(next);
                    }
                    None => self.at += 1,
                },
                Some(_) => self.at += 1,
            }
        }
    }

    fn statement(&mut self) -> Result<()> {
        if self.word_follows() {
            let start = self.at;
            match self.word() {
                b"v" => self.vertex(start)?,
                b"vt" => self.uv(start)?,
                b"vn" => self.normal(start)?,
                b"f" | b"fo" => self.face(start)?,
                b"g" | b"o" => {
                    let name = self.words();
                    begin(&mut self.groups, name, self.polygons.ends.len());
                }
                b"usemtl" => {
                    let name = self.words();
                    begin(&mut self.materials, name, self.polygons.ends.len());
                }
                b"mtllib" => {
                    let name = self.words();
                    self.libraries.push(name);
                }
                word if REFUSED.contains(&word) => {
                    let word = String::from_utf8_lossy(word);
                    let (problem, remedy) = if word == "call" {
                        ("includes another file (`call`)".to_string(), "export everything into one file")
                    } else {
                        (format!("free-form geometry (`{word}`)"), "export the surface as polygons")
                    };
                    return Err(self.with_remedy(start, problem, remedy));
                }
                word if SKIPPED.contains(&word) => {}
                // Skipping it would hide a damaged vertex, and every id after it would name another one.
                word => {
                    let word = shown(word);
                    return Err(self.bad(start, format!("`{word}` is no statement of an OBJ file")));
                }
            }
        }
        self.skip_statement();
        Ok(())
    }

    fn with_remedy(&self, at: usize, problem: String, remedy: &str) -> Error {
        match self.bad(at, problem) {
            Error::Format { path, at, problem, .. } => Error::Format { path, at, problem, remedy: remedy.into() },
            other => other,
        }
    }

    /// The numbers up to the end of the statement.
    #[inline]
    fn numbers(&mut self, start: usize) -> Result<([f64; MOST_NUMBERS], usize)> {
        let mut numbers = [0.0; MOST_NUMBERS];
        let mut count = 0;
        while self.word_follows() {
            let value = self.number()?;
            let Some(slot) = numbers.get_mut(count) else {
                return Err(self.bad(start, format!("more than {MOST_NUMBERS} numbers")));
            };
            *slot = value;
            count += 1;
        }
        Ok((numbers, count))
    }

    #[inline]
    fn number(&mut self) -> Result<f64> {
        let start = self.at;
        if let Some((value, length)) = float_prefix(&self.bytes[start..]) {
            self.at = start + length;
            if self.at_word_end() {
                return Ok(value);
            }
            self.at = start;
        }
        let word = self.word();
        parse_float(word).ok_or_else(|| {
            let word = shown(word);
            self.bad(start, format!("`{word}` is no number"))
        })
    }

    #[inline]
    fn vertex(&mut self, start: usize) -> Result<()> {
        let (numbers, count) = self.numbers(start)?;
        let [x, y, z, ..] = numbers;
        match count {
            // With a weight, which only free-form geometry uses.
            3 | 4 => {}
            // `x y z r g b` and, from some scanners, `x y z r g b a`.
            6 | 7 => {
                let colour = [numbers[3], numbers[4], numbers[5]];
                if !colour.iter().all(|c| c.is_finite()) {
                    let n = self.vertices.len() + 1;
                    return Err(self.bad(start, format!("vertex {n}: colour {colour:?} is not finite")));
                }
                self.colours.push(colour.map(|c| c as f32));
            }
            n => return Err(self.bad(start, format!("a vertex of {n} numbers; x y z, or x y z r g b, are needed"))),
        }
        if !(x.is_finite() && y.is_finite() && z.is_finite()) {
            let n = self.vertices.len() + 1;
            let problem = format!("vertex {n}: position {:?} is not finite", [x, y, z]);
            return Err(self.with_remedy(
                start,
                problem,
                "repair or drop the vertex in the program that wrote the mesh",
            ));
        }
        self.vertices.push(Vec3::new(x, y, z));
        Ok(())
    }

    #[inline]
    fn uv(&mut self, start: usize) -> Result<()> {
        let (numbers, count) = self.numbers(start)?;
        // A third number is for solid textures; without a second it is 0.
        if !(1..=3).contains(&count) {
            return Err(self.bad(start, format!("texture coordinates of {count} numbers, not u v")));
        }
        let uv = [numbers[0], numbers[1]];
        if !uv.iter().all(|c| c.is_finite()) {
            return Err(self.bad(start, format!("texture coordinates {uv:?} are not finite")));
        }
        self.uvs.push(uv);
        Ok(())
    }

    #[inline]
    fn normal(&mut self, start: usize) -> Result<()> {
        let ([x, y, z, ..], count) = self.numbers(start)?;
        if count != 3 {
            return Err(self.bad(start, format!("a normal of {count} numbers, not x y z")));
        }
        // Exporters write `nan` for the normals of faces without area: kept, as nothing hangs on it.
        self.normals.push(Vec3::new(x, y, z));
        Ok(())
    }

    /// The rest of the statement, words parted by one blank.
    fn words(&mut self) -> String {
        let mut name = String::new();
        while self.word_follows() {
            if !name.is_empty() {
                name.push(' ');
            }
            name += &String::from_utf8_lossy(self.word());
        }
        name
    }

    #[inline]
    fn face(&mut self, start: usize) -> Result<()> {
        let first = self.polygons.corners.len();
        let mut form = None;
        while self.word_follows() {
            let word = self.at;
            let vertex = self.index(word, 0)?;
            let (mut uv, mut normal) = (None, None);
            if self.byte() == Some(b'/') {
                self.at += 1;
                if !self.at_word_end() && self.byte() != Some(b'/') {
                    uv = Some(self.index(word, 1)?);
                }
                if self.byte() == Some(b'/') {
                    self.at += 1;
                    if !self.at_word_end() {
                        normal = Some(self.index(word, 2)?);
                    }
                }
            }
            if !self.at_word_end() {
                let word = self.word_at(word);
                return Err(self.bad(start, format!("corner `{word}` is not like 1, 1/2, 1//3 or 1/2/3")));
            }
            let this = (uv.is_some(), normal.is_some());
            if *form.get_or_insert(this) != this {
                let text = self.word_at(word);
                return Err(self.bad(word, format!("corner `{text}` names other things than the corners before it")));
            }
            self.polygons.corners.push(vertex);
            self.uv_corners.push(uv);
            self.normal_corners.push(normal);
        }
        let corners = self.polygons.corners.len() - first;
        if corners < 3 {
            return Err(self.bad(start, format!("a face of {corners} corners, at least 3 are needed")));
        }
        self.polygons.ends.push(first + corners);
        Ok(())
    }

    /// An id of `v`, `vt` or `vn` (kind 0, 1, 2), counted from 0.
    #[inline]
    fn index(&mut self, word: usize, kind: usize) -> Result<u32> {
        let negative = self.byte() == Some(b'-');
        self.at += usize::from(negative || self.byte() == Some(b'+'));
        let start = self.at;
        let mut id = 0u64;
        while let Some(digit) = self.byte().map(|b| b.wrapping_sub(b'0')).filter(|&d| d < 10) {
            id = id.saturating_mul(10).saturating_add(u64::from(digit));
            self.at += 1;
        }
        let count = [self.vertices.len(), self.uvs.len(), self.normals.len()][kind] as u64;
        if self.at == start || id == 0 || negative && id > count {
            let digits = self.at > start;
            let text = self.word_at(word);
            let problem = match (digits, id) {
                (false, _) => format!("corner `{text}` is not like 1, 1/2, 1//3 or 1/2/3"),
                (true, 0) => format!("corner `{text}`: index zero, they count from 1 (or from -1, backwards)"),
                _ => format!("corner `{text}`: index -{id}, but {count} {} stand before it", STATEMENTS[kind]),
            };
            return Err(self.bad(word, problem));
        }
        let id = if negative { count + 1 - id } else { id };
        if id > self.largest[kind].0 {
            self.largest[kind] = (id, word);
        }
        // What does not fit is refused at the end with the largest id.
        Ok((id - 1) as u32)
    }

    fn finish(mut self) -> Result<ObjMesh> {
        for kind in 0..3 {
            let count = [self.vertices.len(), self.uvs.len(), self.normals.len()][kind] as u64;
            let (id, place) = self.largest[kind];
            if id > count.min(u64::from(u32::MAX)) {
                let text = self.word_at(place);
                let statement = STATEMENTS[kind];
                return Err(
                    self.bad(place, format!("corner `{text}`: index {id}, but the file has {count} {statement}"))
                );
            }
        }
        let has_uvs = !self.uv_corners.missing && !self.polygons.ends.is_empty();
        let has_normals = !self.normal_corners.missing && !self.polygons.ends.is_empty();
        let mut faces = Vec::with_capacity(self.polygons.ends.len());
        let mut uv_faces = Vec::with_capacity(if has_uvs { faces.capacity() } else { 0 });
        let mut normal_faces = Vec::with_capacity(if has_normals { faces.capacity() } else { 0 });
        let mut ranges = [self.groups, self.materials].map(|named| (named.into_iter().peekable(), Vec::new()));
        self.polygons.triangles(&self.vertices, |number, t| {
            for (names, ranges) in &mut ranges {
                while let Some((name, _)) = names.next_if(|&(_, first)| first <= number) {
                    ranges.push(ObjGroup { name, faces: faces.len()..faces.len() });
                }
            }
            faces.push(t.map(|k| self.polygons.corners[k]));
            if has_uvs {
                uv_faces.push(t.map(|k| self.uv_corners.ids[k]));
            }
            if has_normals {
                normal_faces.push(t.map(|k| self.normal_corners.ids[k]));
            }
            for (_, ranges) in &mut ranges {
                if let Some(range) = ranges.last_mut() {
                    range.faces.end = faces.len();
                }
            }
        });
        let [groups, materials] = ranges.map(|(_, mut ranges)| {
            ranges.retain(|g: &ObjGroup| !g.faces.is_empty());
            ranges
        });
        let name = self.path.file_stem().map(|s| s.to_string_lossy().into_owned()).unwrap_or_default();
        let coloured = !self.vertices.is_empty() && self.colours.len() == self.vertices.len();
        let colours = coloured.then(|| colour::to_bytes(&self.colours));
        Ok(ObjMesh {
            scan: Scan { name, mesh: TriMesh { vertices: self.vertices, faces }, colours, labels: None },
            uvs: has_uvs.then_some(ObjUvs { coords: self.uvs, faces: uv_faces }),
            normals: has_normals.then_some(ObjNormals { vectors: self.normals, faces: normal_faces }),
            groups,
            materials,
            material_files: self.libraries,
        })
    }
}

/// Notes a name from a polygon on; one without polygons is only a name.
fn begin(named: &mut Vec<(String, usize)>, name: String, first: usize) {
    if named.last().is_some_and(|&(_, start)| start == first) {
        named.pop();
    }
    named.push((name, first));
}

/// What an index of each kind counts.
const STATEMENTS: [&str; 3] = ["vertices", "texture coordinates", "normals"];

impl Corners {
    #[inline]
    fn push(&mut self, id: Option<u32>) {
        if self.missing {
            return;
        }
        match id {
            Some(id) => self.ids.push(id),
            None => *self = Self { ids: Vec::new(), missing: true },
        }
    }
}
