//! Wavefront OBJ: polygons, texture coordinates, vertex colours.
//!
//! obj-rs's raw parser does the reading. It fails on vertex colours (`v x y z r g b`) and panics on free-form surfaces, so
//! those lines are taken out first; a counting reader gives back the line number that its errors lack.

mod write;

pub use write::{ObjSequence, write_obj};

use crate::ply::fan;
use ::obj::raw::object::Polygon;
use caphy_core::scan::Scan;
use caphy_core::{Error, Result, TriMesh, Vec3};
use std::io::{BufRead, Read};
use std::path::Path;

/// An OBJ file: a scan and, where every face has them, texture coordinates.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ObjMesh {
    /// The surface, with colours when every vertex has one.
    pub scan: Scan,
    /// Texture coordinates, `None` unless every face has them.
    pub uvs: Option<ObjUvs>,
}

/// Texture coordinates per corner, so that seams stay seams.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ObjUvs {
    /// Coordinates (u, v), shape [uv_count].
    pub coords: Vec<[f64; 2]>,
    /// Ids into `coords` of each corner, shape [face_count, 3], parallel to the mesh's faces.
    pub faces: Vec<[u32; 3]>,
}

/// Statements of free-form curves and surfaces: geometry that would be lost if they were skipped.
const FREE_FORM: [&str; 6] = ["curv", "curv2", "surf", "cstype", "bmat", "parm"];

/// Reads a mesh [m].
///
/// Positions have the precision of `f32` (obj-rs). Vertex colours are floats in [0, 1], sRGB. Polygons become triangle
/// fans; triangles that name a vertex twice have no area and are left out. Groups, materials, normals, points and lines
/// are skipped.
///
/// # Errors
/// [`Error::Format`] naming the line: a statement cut off, an id out of range, free-form surfaces, no text; or naming
/// the vertex whose position is not finite.
pub fn read_obj(path: &Path, bytes: &[u8]) -> Result<ObjMesh> {
    let text = std::str::from_utf8(bytes)
        .map(std::borrow::Cow::Borrowed)
        // Names of groups and materials may be in any encoding; they are skipped.
        .unwrap_or_else(|_| String::from_utf8_lossy(bytes));
    let (clean, colours) = without_extras(path, &text)?;
    let mut counted = Counted { rest: clean.as_bytes(), lines: 0 };
    let raw = ::obj::raw::parse_obj(&mut counted).map_err(|e| {
        Error::format(path, format!("line {}", counted.lines), e.to_string(), "correct the line or export again")
    })?;

    let mut vertices = Vec::with_capacity(raw.positions.len());
    for (i, &(x, y, z, _)) in raw.positions.iter().enumerate() {
        let p = [x, y, z];
        if !p.iter().all(|c| c.is_finite()) {
            return Err(Error::format(
                path,
                format!("vertex {}", i + 1),
                format!("position {p:?} is not finite"),
                "repair or drop the vertex in the program that wrote the mesh",
            ));
        }
        vertices.push(Vec3::from(p.map(f64::from)));
    }
    let mut faces = Vec::with_capacity(raw.polygons.len());
    let mut uv_faces = Vec::new();
    let mut every_face_has_uv = !raw.polygons.is_empty();
    let (mut ids, mut uv_ids) = (Vec::new(), Vec::new());
    for polygon in &raw.polygons {
        ids.clear();
        uv_ids.clear();
        // obj-rs has checked the ids against the counts, which fit in memory and hence in 32 bits here.
        match polygon {
            Polygon::P(corners) => ids.extend(corners.iter().map(|&p| p as u32)),
            Polygon::PN(corners) => ids.extend(corners.iter().map(|&(p, _)| p as u32)),
            Polygon::PT(corners) => {
                ids.extend(corners.iter().map(|&(p, _)| p as u32));
                uv_ids.extend(corners.iter().map(|&(_, t)| t as u32));
            }
            Polygon::PTN(corners) => {
                ids.extend(corners.iter().map(|&(p, _, _)| p as u32));
                uv_ids.extend(corners.iter().map(|&(_, t, _)| t as u32));
            }
        }
        let has_uv = uv_ids.len() == ids.len();
        every_face_has_uv &= has_uv;
        fan(&ids, |corners| {
            faces.push(corners.map(|c| ids[c]));
            if has_uv {
                uv_faces.push(corners.map(|c| uv_ids[c]));
            }
        });
    }
    let name = path.file_stem().map(|s| s.to_string_lossy().into_owned()).unwrap_or_default();
    let colours = (!vertices.is_empty() && colours.len() == vertices.len()).then_some(colours);
    let coords = || raw.tex_coords.iter().map(|&(u, v, _)| [f64::from(u), f64::from(v)]).collect();
    Ok(ObjMesh {
        scan: Scan { name, mesh: TriMesh { vertices, faces }, colours, labels: None },
        uvs: every_face_has_uv.then(|| ObjUvs { coords: coords(), faces: uv_faces }),
    })
}

/// The lines that obj-rs shall see, each on its own line number, and the colours taken off the vertices.
fn without_extras(path: &Path, text: &str) -> Result<(String, Vec<[u8; 3]>)> {
    let mut clean = String::with_capacity(text.len());
    let mut colours = Vec::new();
    let mut statement = String::new();
    let mut continued = 0;
    for (number, line) in text.lines().enumerate() {
        let line = line.split('#').next().unwrap_or_default();
        // A backslash joins lines; the joined statement goes to the last one's number.
        if let Some(part) = line.trim_end().strip_suffix('\\') {
            statement += part;
            statement.push(' ');
            continued += 1;
            clean.push('\n');
            continue;
        }
        let joined;
        let whole = if continued == 0 {
            line
        } else {
            statement += line;
            continued = 0;
            joined = std::mem::take(&mut statement);
            &joined
        };
        let mut words = whole.split_whitespace();
        match words.next() {
            Some("v") => {
                let numbers: Vec<&str> = words.collect();
                // `x y z r g b` and, from some scanners, `x y z r g b a`.
                let position = if matches!(numbers.len(), 6 | 7) { 3 } else { numbers.len() };
                if position != numbers.len() {
                    let mut colour = [0u8; 3];
                    for (channel, word) in colour.iter_mut().zip(&numbers[position..]) {
                        let value: f64 = word.parse().map_err(|_| {
                            let at = format!("line {}", number + 1);
                            let problem = format!("colour `{word:.40}` is no number");
                            Error::format(path, at, problem, "correct the line or export again")
                        })?;
                        // Casts to u8 saturate and send NaN to 0.
                        *channel = (value * 255.0).round() as u8;
                    }
                    colours.push(colour);
                }
                clean.push('v');
                for word in &numbers[..position] {
                    clean.push(' ');
                    clean += word;
                }
            }
            Some("vt" | "vn" | "f" | "fo") => clean += whole,
            Some(word) if FREE_FORM.contains(&word) => {
                return Err(Error::format(
                    path,
                    format!("line {}", number + 1),
                    format!("free-form geometry (`{word}`)"),
                    "export the surface as polygons",
                ));
            }
            // Groups, materials, smoothing, display attributes: nothing that a scan needs.
            _ => {}
        }
        clean.push('\n');
    }
    if continued > 0 {
        return Err(Error::format(path, "last line", "ends with a backslash", "the file is cut off: get it again"));
    }
    Ok((clean, colours))
}

/// Counts the lines that were handed out.
struct Counted<'a> {
    rest: &'a [u8],
    lines: usize,
}

impl Read for Counted<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        self.rest.read(buffer)
    }
}

impl BufRead for Counted<'_> {
    fn fill_buf(&mut self) -> std::io::Result<&[u8]> {
        Ok(self.rest)
    }
    fn consume(&mut self, amount: usize) {
        // Lines are consumed one by one, each with its line feed.
        self.lines += usize::from(amount > 0);
        self.rest = self.rest.get(amount..).unwrap_or_default();
    }
}
