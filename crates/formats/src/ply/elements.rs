//! The elements, straight into the scan.

use super::REWRITE;
use super::header::{Element, Encoding, Kind};
use crate::colour;
use crate::number::{float_prefix, parse_float};
use crate::polygon::Polygons;
use caphy_core::scan::{Label, Scan};
use caphy_core::{Error, Result, TriMesh, Vec3};
use std::path::Path;

const CUT_OFF: &str = "the file is cut off: get it again";

/// Why a number could not be had.
enum Stop {
    End,
    NotANumber(String),
}

/// Numbers one after another.
trait Numbers {
    fn next(&mut self, kind: Kind) -> std::result::Result<f64, Stop>;
    /// Whether `count` rows can still come, lists counted as empty.
    fn can_hold(&self, count: usize, columns: &[Column]) -> bool;
}

struct Binary<'a, const BIG: bool> {
    rest: &'a [u8],
}

impl<const BIG: bool> Binary<'_, BIG> {
    #[inline(always)]
    fn take<const N: usize>(&mut self) -> std::result::Result<[u8; N], Stop> {
        let (head, rest) = self.rest.split_first_chunk::<N>().ok_or(Stop::End)?;
        self.rest = rest;
        let mut head = *head;
        if BIG {
            head.reverse();
        }
        Ok(head)
    }
}

impl<const BIG: bool> Numbers for Binary<'_, BIG> {
    #[inline(always)]
    fn next(&mut self, kind: Kind) -> std::result::Result<f64, Stop> {
        Ok(match kind {
            Kind::I8 => f64::from(i8::from_le_bytes(self.take()?)),
            Kind::U8 => f64::from(u8::from_le_bytes(self.take()?)),
            Kind::I16 => f64::from(i16::from_le_bytes(self.take()?)),
            Kind::U16 => f64::from(u16::from_le_bytes(self.take()?)),
            Kind::I32 => f64::from(i32::from_le_bytes(self.take()?)),
            Kind::U32 => f64::from(u32::from_le_bytes(self.take()?)),
            Kind::F32 => f64::from(f32::from_le_bytes(self.take()?)),
            Kind::F64 => f64::from_le_bytes(self.take()?),
        })
    }
    fn can_hold(&self, count: usize, columns: &[Column]) -> bool {
        let row: usize = columns.iter().map(|c| c.list_length.unwrap_or(c.kind).size()).sum();
        count.checked_mul(row).is_some_and(|bytes| bytes <= self.rest.len())
    }
}

struct Ascii<'a> {
    rest: &'a [u8],
}

impl Numbers for Ascii<'_> {
    #[inline]
    fn next(&mut self, _kind: Kind) -> std::result::Result<f64, Stop> {
        let start = self.rest.iter().position(|b| !b.is_ascii_whitespace()).ok_or(Stop::End)?;
        let word = &self.rest[start..];
        if let Some((value, length)) = float_prefix(word)
            && word.get(length).is_none_or(u8::is_ascii_whitespace)
        {
            self.rest = &word[length..];
            return Ok(value);
        }
        let end = word.iter().position(u8::is_ascii_whitespace).unwrap_or(word.len());
        let (word, rest) = word.split_at(end);
        self.rest = rest;
        parse_float(word).ok_or_else(|| Stop::NotANumber(String::from_utf8_lossy(word).chars().take(40).collect()))
    }
    fn can_hold(&self, count: usize, columns: &[Column]) -> bool {
        // A number takes a digit and a separator; the last one of the file may lack the separator.
        count.checked_mul(2 * columns.len()).is_some_and(|bytes| bytes <= self.rest.len() + 1)
    }
}

/// What a property is for.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Role {
    Position(usize),
    Colour(usize),
    Label,
    Corners,
    Strips,
    Skipped,
}

struct Column {
    role: Role,
    kind: Kind,
    list_length: Option<Kind>,
}

fn columns(element: &Element) -> Vec<Column> {
    let role = |name: &str, is_list: bool| match (element.name.as_str(), name, is_list) {
        ("vertex", "x", false) => Role::Position(0),
        ("vertex", "y", false) => Role::Position(1),
        ("vertex", "z", false) => Role::Position(2),
        ("vertex", "red" | "diffuse_red", false) => Role::Colour(0),
        ("vertex", "green" | "diffuse_green", false) => Role::Colour(1),
        ("vertex", "blue" | "diffuse_blue", false) => Role::Colour(2),
        ("vertex", "label", false) => Role::Label,
        ("face", "vertex_indices" | "vertex_index", true) => Role::Corners,
        ("tristrips", "vertex_indices" | "vertex_index", true) => Role::Strips,
        _ => Role::Skipped,
    };
    let column = |p: &super::header::Property| Column {
        role: role(&p.name, p.list_length.is_some()),
        kind: p.kind,
        list_length: p.list_length,
    };
    element.properties.iter().map(column).collect()
}

pub(super) fn read(path: &Path, encoding: Encoding, elements: &[Element], payload: &[u8]) -> Result<Scan> {
    match encoding {
        Encoding::Ascii => read_from(path, elements, Ascii { rest: payload }),
        Encoding::LittleEndian => read_from(path, elements, Binary::<false> { rest: payload }),
        Encoding::BigEndian => read_from(path, elements, Binary::<true> { rest: payload }),
    }
}

/// Vertex attributes and faces as they come.
#[derive(Default)]
struct Gathered {
    vertices: Vec<Vec3>,
    colours: Vec<[f32; 3]>,
    labels: Vec<Label>,
    polygons: Polygons,
}

fn read_from<N: Numbers>(path: &Path, elements: &[Element], mut numbers: N) -> Result<Scan> {
    let named = |name: &str| elements.iter().find(|e| e.name == name);
    let Some(vertex) = named("vertex") else {
        return Err(Error::format(path, "header", "no element `vertex`", "a scan has vertices: export the mesh"));
    };
    let vertex_columns = columns(vertex);
    let has = |role: Role| vertex_columns.iter().any(|c| c.role == role);
    for (axis, name) in ["x", "y", "z"].into_iter().enumerate() {
        if !has(Role::Position(axis)) {
            let at = "header, element `vertex`";
            return Err(Error::format(path, at, format!("no property `{name}`"), "export vertex positions"));
        }
    }
    let has_colour = (0..3).all(|c| has(Role::Colour(c)));
    let has_label = has(Role::Label);
    for name in ["face", "tristrips"] {
        if let Some(element) = named(name)
            && element.count > 0
            && !columns(element).iter().any(|c| matches!(c.role, Role::Corners | Role::Strips))
        {
            let at = format!("header, element `{name}`");
            return Err(Error::format(path, at, "no list `vertex_indices`", "export faces as lists of vertex ids"));
        }
    }

    let mut gathered = Gathered::default();
    for element in elements {
        let columns = columns(element);
        // Before any memory is taken on the header's word.
        if !numbers.can_hold(element.count, &columns) {
            return Err(Error::format(
                path,
                format!("element `{}`", element.name),
                format!("the header announces {} of them, the file is too short for that", element.count),
                CUT_OFF,
            ));
        }
        if columns.is_empty() {
            continue;
        }
        let rows = Rows { path, element, columns: &columns };
        match element.name.as_str() {
            "vertex" => rows.vertices(&mut numbers, has_colour, has_label, &mut gathered)?,
            _ => rows.lists(&mut numbers, vertex.count, &mut gathered.polygons)?,
        }
    }
    let Gathered { vertices, colours, labels, polygons } = gathered;
    let mut faces = Vec::with_capacity(polygons.ends.len());
    polygons.triangles(&vertices, |_, t| faces.push(t.map(|k| polygons.corners[k])));
    Ok(Scan {
        name: path.file_stem().map(|s| s.to_string_lossy().into_owned()).unwrap_or_default(),
        mesh: TriMesh { vertices, faces },
        colours: has_colour.then(|| colour::to_bytes(&colours)),
        labels: has_label.then_some(labels),
    })
}

/// The rows of one element.
struct Rows<'a> {
    path: &'a Path,
    element: &'a Element,
    columns: &'a [Column],
}

impl Rows<'_> {
    fn bad(&self, row: usize, problem: String, remedy: &str) -> Error {
        Error::format(
            self.path,
            format!("element `{}` {row} of {}", self.element.name, self.element.count),
            problem,
            remedy,
        )
    }

    #[inline(always)]
    fn number<N: Numbers>(&self, numbers: &mut N, row: usize, kind: Kind) -> Result<f64> {
        numbers.next(kind).map_err(|stop| match stop {
            Stop::End => self.bad(row, "the file ends here".into(), CUT_OFF),
            Stop::NotANumber(word) => self.bad(row, format!("`{word}` is no number"), REWRITE),
        })
    }

    /// Length of a list that follows.
    #[inline(always)]
    fn length<N: Numbers>(&self, numbers: &mut N, row: usize, kind: Kind) -> Result<u64> {
        let length = self.number(numbers, row, kind)?;
        if !(length.fract() == 0.0 && length >= 0.0) {
            return Err(self.bad(row, format!("a list of length {length}"), REWRITE));
        }
        // Saturates: a list that long ends with the file.
        Ok(length as u64)
    }

    fn vertices<N: Numbers>(
        &self,
        numbers: &mut N,
        has_colour: bool,
        has_label: bool,
        out: &mut Gathered,
    ) -> Result<()> {
        let count = self.element.count;
        out.vertices.reserve_exact(count);
        out.colours.reserve_exact(if has_colour { count } else { 0 });
        out.labels.reserve_exact(if has_label { count } else { 0 });
        for row in 0..count {
            let mut position = [0.0; 3];
            let mut colour = [0f32; 3];
            let mut label = Label::Ignore;
            for column in self.columns {
                if let Some(length) = column.list_length {
                    for _ in 0..self.length(numbers, row, length)? {
                        self.number(numbers, row, column.kind)?;
                    }
                    continue;
                }
                let value = self.number(numbers, row, column.kind)?;
                match column.role {
                    Role::Position(axis) => position[axis] = value,
                    Role::Colour(channel) => colour[channel] = channel_of(value, column.kind),
                    // Casts of floats saturate and send NaN to 0: only whole numbers in range are labels.
                    Role::Label if value.fract() == 0.0 && (0.0..=255.0).contains(&value) => {
                        label = Label::from_byte(value as u8);
                    }
                    _ => {}
                }
            }
            if !position.iter().all(|c| c.is_finite()) {
                let problem = format!("position {position:?} is not finite");
                return Err(self.bad(row, problem, "repair or drop the vertex in the program that wrote the mesh"));
            }
            out.vertices.push(Vec3::from(position));
            if has_colour {
                if !colour.iter().all(|c| c.is_finite()) {
                    return Err(self.bad(row, format!("colour {colour:?} is not finite"), REWRITE));
                }
                out.colours.push(colour);
            }
            if has_label {
                out.labels.push(label);
            }
        }
        Ok(())
    }

    /// Faces, strips, and whatever is skipped.
    fn lists<N: Numbers>(&self, numbers: &mut N, vertex_count: usize, out: &mut Polygons) -> Result<()> {
        // The largest id of 32 bits is no id: it is a -1 that was written unsigned.
        let ids = vertex_count.min(u32::MAX as usize) as f64;
        for row in 0..self.element.count {
            for column in self.columns {
                let Some(length) = column.list_length else {
                    self.number(numbers, row, column.kind)?;
                    continue;
                };
                let length = self.length(numbers, row, length)?;
                let mut strip = Strip::default();
                for _ in 0..length {
                    let id = self.number(numbers, row, column.kind)?;
                    if column.role == Role::Skipped {
                        continue;
                    }
                    if column.role == Role::Strips && id == -1.0 {
                        strip = Strip::default();
                        continue;
                    }
                    if !(id.fract() == 0.0 && id >= 0.0 && id < ids) {
                        let problem = format!("vertex id {id}, but there are {vertex_count} vertices");
                        return Err(self.bad(row, problem, REWRITE));
                    }
                    if column.role == Role::Corners {
                        out.corners.push(id as u32);
                    } else if let Some(corners) = strip.push(id as u32) {
                        out.corners.extend(corners);
                        out.ends.push(out.corners.len());
                    }
                }
                if column.role == Role::Corners {
                    out.ends.push(out.corners.len());
                }
            }
        }
        Ok(())
    }
}

/// A strip: each vertex makes a triangle with the two before it, every second one turned over.
#[derive(Default)]
struct Strip {
    last: [u32; 2],
    count: usize,
}

impl Strip {
    fn push(&mut self, id: u32) -> Option<[u32; 3]> {
        let [a, b] = self.last;
        let triangle = match self.count {
            0 | 1 => None,
            n if n % 2 == 0 => Some([a, b, id]),
            _ => Some([b, a, id]),
        };
        self.last = [b, id];
        self.count += 1;
        triangle
    }
}

/// A colour channel in [0, 1]: integers of 8 or 16 bits; floats as they stand (in [0, 1], or throughout in [0, 255]).
fn channel_of(value: f64, kind: Kind) -> f32 {
    match kind {
        Kind::F32 | Kind::F64 => value as f32,
        Kind::I16 | Kind::U16 => (value / 65535.0).clamp(0.0, 1.0) as f32,
        _ => (value / 255.0).clamp(0.0, 1.0) as f32,
    }
}
