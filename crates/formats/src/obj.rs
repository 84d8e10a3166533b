//! Wavefront OBJ: polygons, texture coordinates, normals, vertex colours, groups.

mod read;
mod write;

pub use write::{ObjSequence, write_obj};

use caphy_core::scan::Scan;
use caphy_core::{Result, Vec3};
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
    /// Materials of `usemtl` and the faces that have them, in the file's order.
    pub materials: Vec<ObjGroup>,
    /// What `mtllib` names: files that define the materials.
    pub material_files: Vec<String>,
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

/// Faces that follow one `g`, `o` or `usemtl` statement, up to the next.
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
/// area and are left out. Faces may stand before the vertices that they name by positive index. Smoothing,
/// points, lines and display attributes are skipped.
///
/// # Errors
/// [`Error::Format`](caphy_core::Error::Format) naming the line: a statement cut off, what is no number, a position,
/// colour or texture coordinate that is not finite, an index out of range, free-form surfaces, what is no statement of
/// the format.
pub fn read_obj(path: &Path, bytes: &[u8]) -> Result<ObjMesh> {
    read::read(path, bytes)
}
