//! Meshes and sequences of meshes as OBJ.

use crate::colour::MeshColour;
use crate::moving::MovingMesh;
use crate::obj::ObjUvs;
use caphy_core::{Error, Result, TriMesh, Vec3};
use std::fmt::Write;

/// Writes a mesh [m], with vertex colours (sRGB) when given, shape [vertex_count].
///
/// # Errors
/// [`Error::Length`] when the colours do not cover the vertices.
pub fn write_obj(mesh: &TriMesh, colours: Option<&[[u8; 3]]>) -> Result<Vec<u8>> {
    if let Some(colours) = colours {
        Error::check_length("OBJ vertex colours", mesh.vertices.len(), colours.len())?;
    }
    let mut out = String::with_capacity(40 * mesh.vertices.len() + 24 * mesh.faces.len());
    push_vertices(&mut out, &mesh.vertices, colours);
    push_faces(&mut out, &mesh.faces, None);
    Ok(out.into_bytes())
}

/// A moving mesh as one OBJ file per frame, all with the same faces and texture coordinates.
#[derive(Debug)]
pub struct ObjSequence<'a> {
    mesh: &'a MovingMesh<'a>,
    /// What follows the vertices: the same text in every frame.
    faces: String,
}

impl<'a> ObjSequence<'a> {
    /// Checks the mesh.
    ///
    /// # Errors
    /// Those of [`MovingMesh::check`].
    pub fn new(mesh: &'a MovingMesh<'a>) -> Result<Self> {
        mesh.check()?;
        let mut faces = String::with_capacity(40 * mesh.faces.len());
        push_faces(&mut faces, mesh.faces, mesh.uvs);
        Ok(Self { mesh, faces })
    }
    /// Number of files.
    pub fn frame_count(&self) -> usize {
        self.mesh.frames.frame_count()
    }
    /// Name of a frame's file: `frame_0001.obj` is frame 0. More digits where the sequence needs them, so that the order
    /// of the names is the order of the frames.
    pub fn file_name(&self, frame: usize) -> String {
        let digits = self.frame_count().to_string().len().max(4);
        format!("frame_{:0digits$}.obj", frame + 1)
    }
    /// The file of a frame. Colours per vertex are written; one for all has no place in the format.
    ///
    /// # Errors
    /// Those of [`MovingMesh::frame`].
    pub fn file(&self, frame: usize) -> Result<Vec<u8>> {
        let mut vertices = Vec::with_capacity(self.mesh.vertex_count);
        self.mesh.frame(frame, &mut vertices)?;
        let mut out = String::with_capacity(40 * vertices.len() + self.faces.len());
        let colours = match self.mesh.colour {
            MeshColour::Uniform(_) => None,
            MeshColour::PerVertex(colours) => Some(colours),
        };
        push_vertices(&mut out, &vertices, colours);
        out += &self.faces;
        Ok(out.into_bytes())
    }
}

// Writing to a String cannot fail.

fn push_vertices(out: &mut String, vertices: &[Vec3], colours: Option<&[[u8; 3]]>) {
    *out += "# metres, y up\n";
    for (i, v) in vertices.iter().enumerate() {
        // A hundredth of a micrometre: finer than f32 at body scale.
        let _ = write!(out, "v {:.8} {:.8} {:.8}", v.x, v.y, v.z);
        if let Some(colours) = colours {
            for c in colours[i] {
                let _ = write!(out, " {:.4}", f64::from(c) / 255.0);
            }
        }
        out.push('\n');
    }
}

fn push_faces(out: &mut String, faces: &[[u32; 3]], uvs: Option<&ObjUvs>) {
    for [u, v] in uvs.iter().flat_map(|uvs| &uvs.coords) {
        let _ = writeln!(out, "vt {u:.8} {v:.8}");
    }
    // Ids start at 1 and may then need 33 bits.
    for (f, face) in faces.iter().enumerate() {
        let corner = face.map(|id| u64::from(id) + 1);
        let _ = match uvs.map(|uvs| uvs.faces[f].map(|id| u64::from(id) + 1)) {
            None => writeln!(out, "f {} {} {}", corner[0], corner[1], corner[2]),
            Some(uv) => {
                writeln!(out, "f {}/{} {}/{} {}/{}", corner[0], uv[0], corner[1], uv[1], corner[2], uv[2])
            }
        };
    }
}
