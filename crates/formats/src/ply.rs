//! PLY scans: ascii and binary of either byte order, any number types, polygons of any size.
//!
//! ply-rs-bw reads the header's grammar. Elements are read here, straight into the scan: its generic containers hold
//! each property of each vertex under a name, many times the memory and time of the scan itself.

use caphy_core::scan::{Label, Scan};
use caphy_core::{Error, Result, TriMesh, Vec3};
use ply_rs_bw::parser::{Parser, Reader};
use ply_rs_bw::ply::{DefaultElement, ElementDef, Encoding, PropertyType, ScalarType};
use std::path::Path;

const REWRITE: &str = "write the file again from the program that made it";

/// Reads a scan.
///
/// Vertex properties: `x y z` (any number type) [m]; `red green blue` (8 bit, or float in [0, 1]), optional; `label`
/// (0 body, 1 upper, 2 lower, others ignored), optional. Faces: the list `vertex_indices` or `vertex_index`; polygons
/// become triangle fans; triangles that name a vertex twice have no area and are left out. Other properties and
/// elements are skipped. A file without faces is a point cloud.
///
/// # Errors
/// [`Error::Format`] naming the element: damaged header, file cut off, position that is not finite, vertex id out of
/// range.
pub fn read_ply(path: &Path, bytes: &[u8]) -> Result<Scan> {
    let mut reader = Reader::new(bytes);
    let header = Parser::<DefaultElement>::new().read_header(&mut reader).map_err(|e| {
        // The library's text repeats the line, which may be anything.
        let problem: String = e.to_string().chars().take(200).collect();
        Error::format(path, "header", problem, REWRITE)
    })?;
    let payload = reader.into_inner();
    let text = &bytes[..bytes.len() - payload.len()];
    // The library keeps elements and properties by name: a repeated name would silently shift the columns.
    let lines = |word: &[u8]| text.split(|&b| b == b'\n' || b == b'\r').filter(|l| l.starts_with(word)).count();
    let properties: usize = header.elements.values().map(|e| e.properties.len()).sum();
    if lines(b"element") != header.elements.len() || lines(b"property") != properties {
        return Err(Error::format(path, "header", "an element or property name occurs twice", "rename one of them"));
    }
    let elements: Vec<&ElementDef> = header.elements.values().collect();
    match header.encoding {
        Encoding::Ascii => read_elements(path, &elements, Ascii { rest: payload }),
        Encoding::BinaryLittleEndian => read_elements(path, &elements, Binary::<false> { rest: payload }),
        Encoding::BinaryBigEndian => read_elements(path, &elements, Binary::<true> { rest: payload }),
    }
}

/// Writes a scan as binary little-endian PLY: float positions, colours and labels where the scan has them.
pub fn write_ply(scan: &Scan) -> Vec<u8> {
    let mesh = &scan.mesh;
    let mut header = format!(
        "ply\nformat binary_little_endian 1.0\ncomment metres, y up\nelement vertex {}\n\
         property float x\nproperty float y\nproperty float z\n",
        mesh.vertices.len()
    );
    // An attribute that does not cover every vertex cannot be written as a column.
    let colours = scan.colours.as_ref().filter(|c| c.len() == mesh.vertices.len());
    let labels = scan.labels.as_ref().filter(|l| l.len() == mesh.vertices.len());
    if colours.is_some() {
        header += "property uchar red\nproperty uchar green\nproperty uchar blue\n";
    }
    if labels.is_some() {
        header += "property uchar label\n";
    }
    header += &format!("element face {}\nproperty list uchar int vertex_indices\nend_header\n", mesh.faces.len());
    let mut out = header.into_bytes();
    out.reserve(16 * mesh.vertices.len() + 13 * mesh.faces.len());
    for (i, v) in mesh.vertices.iter().enumerate() {
        for c in v.iter() {
            out.extend((*c as f32).to_le_bytes());
        }
        if let Some(colours) = colours {
            out.extend(colours[i]);
        }
        if let Some(labels) = labels {
            out.push(labels[i] as u8);
        }
    }
    for face in &mesh.faces {
        out.push(3);
        for id in face {
            out.extend(id.to_le_bytes());
        }
    }
    out
}

/// Why a number could not be had.
enum Stop {
    End,
    NotANumber(String),
}

/// Numbers one after another.
trait Numbers {
    fn next(&mut self, kind: &ScalarType) -> std::result::Result<f64, Stop>;
    /// Whether `count` rows can still come, lists counted as empty.
    fn can_hold(&self, count: usize, columns: &[Column<'_>]) -> bool;
}

struct Binary<'a, const BIG: bool> {
    rest: &'a [u8],
}

fn width(kind: &ScalarType) -> usize {
    match kind {
        ScalarType::Char | ScalarType::UChar => 1,
        ScalarType::Short | ScalarType::UShort => 2,
        ScalarType::Int | ScalarType::UInt | ScalarType::Float => 4,
        ScalarType::Double => 8,
    }
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
    fn next(&mut self, kind: &ScalarType) -> std::result::Result<f64, Stop> {
        Ok(match kind {
            ScalarType::Char => f64::from(i8::from_le_bytes(self.take()?)),
            ScalarType::UChar => f64::from(u8::from_le_bytes(self.take()?)),
            ScalarType::Short => f64::from(i16::from_le_bytes(self.take()?)),
            ScalarType::UShort => f64::from(u16::from_le_bytes(self.take()?)),
            ScalarType::Int => f64::from(i32::from_le_bytes(self.take()?)),
            ScalarType::UInt => f64::from(u32::from_le_bytes(self.take()?)),
            ScalarType::Float => f64::from(f32::from_le_bytes(self.take()?)),
            ScalarType::Double => f64::from_le_bytes(self.take()?),
        })
    }
    fn can_hold(&self, count: usize, columns: &[Column<'_>]) -> bool {
        let row: usize = columns.iter().map(|c| width(c.list_length.unwrap_or(c.kind))).sum();
        count.checked_mul(row).is_some_and(|bytes| bytes <= self.rest.len())
    }
}

struct Ascii<'a> {
    rest: &'a [u8],
}

impl Numbers for Ascii<'_> {
    fn next(&mut self, _kind: &ScalarType) -> std::result::Result<f64, Stop> {
        let start = self.rest.iter().position(|b| !b.is_ascii_whitespace()).ok_or(Stop::End)?;
        let rest = &self.rest[start..];
        let end = rest.iter().position(|b| b.is_ascii_whitespace()).unwrap_or(rest.len());
        let (word, rest) = rest.split_at(end);
        self.rest = rest;
        let text = String::from_utf8_lossy(word);
        text.parse().map_err(|_| Stop::NotANumber(text.chars().take(40).collect()))
    }
    fn can_hold(&self, count: usize, columns: &[Column<'_>]) -> bool {
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
    Skipped,
}

struct Column<'a> {
    role: Role,
    kind: &'a ScalarType,
    /// Type of the length that stands before a list.
    list_length: Option<&'a ScalarType>,
}

fn columns(element: &ElementDef) -> Vec<Column<'_>> {
    let role = |name: &str, is_list: bool| match (element.name.as_str(), name, is_list) {
        ("vertex", "x", false) => Role::Position(0),
        ("vertex", "y", false) => Role::Position(1),
        ("vertex", "z", false) => Role::Position(2),
        ("vertex", "red", false) => Role::Colour(0),
        ("vertex", "green", false) => Role::Colour(1),
        ("vertex", "blue", false) => Role::Colour(2),
        ("vertex", "label", false) => Role::Label,
        ("face", "vertex_indices" | "vertex_index", true) => Role::Corners,
        _ => Role::Skipped,
    };
    element
        .properties
        .values()
        .map(|p| match &p.data_type {
            PropertyType::Scalar(kind) => Column { role: role(&p.name, false), kind, list_length: None },
            PropertyType::List(length, kind) => Column { role: role(&p.name, true), kind, list_length: Some(length) },
        })
        .collect()
}

fn read_elements<N: Numbers>(path: &Path, elements: &[&ElementDef], mut numbers: N) -> Result<Scan> {
    let named = |name: &str| elements.iter().find(|e| e.name == name);
    let Some(vertex) = named("vertex") else {
        return Err(Error::format(path, "header", "no element `vertex`", "a scan has vertices: export the mesh"));
    };
    let vertex_count = vertex.count;
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
    if let Some(face) = named("face")
        && face.count > 0
        && !columns(face).iter().any(|c| c.role == Role::Corners)
    {
        let at = "header, element `face`";
        return Err(Error::format(path, at, "no list `vertex_indices`", "export faces as lists of vertex ids"));
    }

    let mut scan = Scan {
        name: path.file_stem().map(|s| s.to_string_lossy().into_owned()).unwrap_or_default(),
        mesh: TriMesh::default(),
        colours: has_colour.then(Vec::new),
        labels: has_label.then(Vec::new),
    };
    let mut polygon: Vec<u32> = Vec::new();
    for element in elements {
        let columns = columns(element);
        if columns.is_empty() {
            continue;
        }
        let at = |row: usize| format!("element `{}` {row} of {}", element.name, element.count);
        let stop = |row: usize, stop: Stop| match stop {
            Stop::End => Error::format(path, at(row), "the file ends here", "the file is cut off: get it again"),
            Stop::NotANumber(word) => Error::format(path, at(row), format!("`{word}` is no number"), REWRITE),
        };
        // Before any memory is taken on the header's word.
        if !numbers.can_hold(element.count, &columns) {
            return Err(Error::format(
                path,
                format!("element `{}`", element.name),
                format!("the header announces {} of them, the file is too short for that", element.count),
                "the file is cut off: get it again",
            ));
        }
        let is_vertex = element.name == "vertex";
        if is_vertex {
            scan.mesh.vertices.reserve(vertex_count);
        } else if element.name == "face" {
            scan.mesh.faces.reserve(element.count);
        }
        for row in 0..element.count {
            let mut position = [0.0; 3];
            let mut colour = [0u8; 3];
            let mut label = Label::Ignore;
            for column in &columns {
                let Some(length_kind) = column.list_length else {
                    let value = numbers.next(column.kind).map_err(|s| stop(row, s))?;
                    match column.role {
                        Role::Position(axis) => position[axis] = value,
                        Role::Colour(channel) => colour[channel] = byte(value, column.kind),
                        // Casts of floats saturate and send NaN to 0: only whole numbers in range are labels.
                        Role::Label if value.fract() == 0.0 && (0.0..=255.0).contains(&value) => {
                            label = Label::from_byte(value as u8);
                        }
                        _ => {}
                    }
                    continue;
                };
                let length = numbers.next(length_kind).map_err(|s| stop(row, s))?;
                if !(length.fract() == 0.0 && length >= 0.0) {
                    return Err(Error::format(path, at(row), format!("a list of length {length}"), REWRITE));
                }
                polygon.clear();
                let mut k = 0.0;
                while k < length {
                    let id = numbers.next(column.kind).map_err(|s| stop(row, s))?;
                    if column.role == Role::Corners {
                        if !(id.fract() == 0.0 && id >= 0.0 && id < vertex_count as f64 && id < f64::from(u32::MAX)) {
                            let problem = format!("vertex id {id}, but there are {vertex_count} vertices");
                            return Err(Error::format(path, at(row), problem, REWRITE));
                        }
                        polygon.push(id as u32);
                    }
                    k += 1.0;
                }
                if column.role == Role::Corners {
                    fan(&polygon, |corners| scan.mesh.faces.push(corners.map(|c| polygon[c])));
                }
            }
            if is_vertex {
                if !position.iter().all(|c| c.is_finite()) {
                    return Err(Error::format(
                        path,
                        at(row),
                        format!("position {position:?} is not finite"),
                        "repair or drop the vertex in the program that wrote the mesh",
                    ));
                }
                scan.mesh.vertices.push(Vec3::from(position));
                if let Some(colours) = &mut scan.colours {
                    colours.push(colour);
                }
                if let Some(labels) = &mut scan.labels {
                    labels.push(label);
                }
            }
        }
    }
    Ok(scan)
}

/// A colour channel: integers of 8 or 16 bits, or floats in [0, 1].
fn byte(value: f64, kind: &ScalarType) -> u8 {
    // Casts to u8 saturate and send NaN to 0.
    match kind {
        ScalarType::Float | ScalarType::Double => (value * 255.0).round() as u8,
        ScalarType::Short | ScalarType::UShort => (value / 257.0).round() as u8,
        _ => value as u8,
    }
}

/// Calls back with the corner numbers of each triangle of a polygon's fan, leaving out those that name a vertex twice.
pub(crate) fn fan(polygon: &[u32], mut triangle: impl FnMut([usize; 3])) {
    for k in 2..polygon.len() {
        let (a, b, c) = (polygon[0], polygon[k - 1], polygon[k]);
        if a != b && b != c && c != a {
            triangle([0, k - 1, k]);
        }
    }
}
