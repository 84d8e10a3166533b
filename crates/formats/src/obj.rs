//! Wavefront OBJ: polygons, texture coordinates, normals, vertex colours, groups.

mod read;

use caphy_core::scan::Scan;
use caphy_core::{Error, Result, TriMesh, Vec3};
use std::fmt::Write;
use std::ops::Range;
use std::path::Path;

/// An OBJ file: a scan and, where every face has them, texture coordinates and normals.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ObjMesh {
    /// The surface, with colours when every vertex has one.
    pub scan: Scan,
    /// Texture coordinates, `None` unless every face has them.
    pub uvs: Option<ObjUvs>,
    /// Normals, `None` unless every face has them.
    pub normals: Option<ObjNormals>,
    /// Groups and objects that have faces, in the file's order.
    pub groups: Vec<ObjGroup>,
}

/// Texture coordinates per corner, so that seams stay seams.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ObjUvs {
    /// Coordinates (u, v), shape [uv_count].
    pub coords: Vec<[f64; 2]>,
    /// Ids into `coords` of each corner, shape [face_count, 3], parallel to the mesh's faces.
    pub faces: Vec<[u32; 3]>,
}

/// Normals per corner, so that creases stay creases; as the file has them: neither unit length nor finite for certain.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ObjNormals {
    /// Directions, shape [normal_count].
    pub vectors: Vec<Vec3>,
    /// Ids into `vectors` of each corner, shape [face_count, 3], parallel to the mesh's faces.
    pub faces: Vec<[u32; 3]>,
}

/// Faces that follow one `g` or `o` statement, up to the next.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct ObjGroup {
    /// What the statement says: often one name, or several parted by blanks; the same name may come again.
    pub name: String,
    /// Triangles of the mesh.
    pub faces: Range<usize>,
}

/// Reads a mesh [m].
///
/// Vertex colours are sRGB floats in [0, 1], or in [0, 255] when a channel of the file exceeds 2. Polygons become
/// triangles: a fan, or for a concave polygon of at most 128 corners, ears; triangles that name a vertex twice have no
/// area and are left out. Faces may stand before the vertices that they name by positive index. Materials, smoothing,
/// points, lines and display attributes are skipped.
///
/// # Errors
/// [`Error::Format`] naming the line: a statement cut off, what is no number, a position, colour or texture coordinate
/// that is not finite, an index out of range, free-form surfaces, what is no statement of the format.
pub fn read_obj(path: &Path, bytes: &[u8]) -> Result<ObjMesh> {
    read::read(path, bytes)
}

/// Writes a mesh [m], with vertex colours (sRGB) when given, shape [vertex_count].
///
/// A sequence is one such file per frame; all share the faces.
///
/// # Errors
/// [`Error::Length`] when the colours do not cover the vertices.
pub fn write_obj(mesh: &TriMesh, colours: Option<&[[u8; 3]]>) -> Result<Vec<u8>> {
    if let Some(colours) = colours {
        Error::check_length("OBJ vertex colours", mesh.vertices.len(), colours.len())?;
    }
    let mut out = String::with_capacity(40 * mesh.vertices.len() + 24 * mesh.faces.len());
    out += "# metres, y up\n";
    for (i, v) in mesh.vertices.iter().enumerate() {
        // A hundredth of a micrometre: finer than f32 at body scale. Writing to a String cannot fail.
        let _ = write!(out, "v {:.8} {:.8} {:.8}", v.x, v.y, v.z);
        if let Some(colours) = colours {
            for c in colours[i] {
                let _ = write!(out, " {:.4}", f64::from(c) / 255.0);
            }
        }
        out.push('\n');
    }
    for f in &mesh.faces {
        let _ = writeln!(out, "f {} {} {}", u64::from(f[0]) + 1, u64::from(f[1]) + 1, u64::from(f[2]) + 1);
    }
    Ok(out.into_bytes())
}
