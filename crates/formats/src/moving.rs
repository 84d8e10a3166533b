//! Meshes that move with fixed faces: what the writers of animation take.

use crate::colour::MeshColour;
use crate::obj::ObjUvs;
use caphy_core::{Error, Result, Vec3};
use std::fmt;

/// Vertex positions of a mesh in each frame of a clip.
///
/// Writers ask for one frame at a time and may ask for it again, so that a clip need not be held in memory.
pub trait VertexFrames: Sync {
    /// Number of frames.
    fn frame_count(&self) -> usize;
    /// Appends the positions of a frame [m], shape [vertex_count], to `out`, which comes empty.
    ///
    /// The same frame gives the same positions each time.
    ///
    /// # Errors
    /// What keeps the frame from being had.
    fn frame(&self, frame: usize, out: &mut Vec<Vec3>) -> Result<()>;
}

impl fmt::Debug for dyn VertexFrames + '_ {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} frames", self.frame_count())
    }
}

impl VertexFrames for Vec<Vec<Vec3>> {
    fn frame_count(&self) -> usize {
        self.len()
    }
    fn frame(&self, frame: usize, out: &mut Vec<Vec3>) -> Result<()> {
        out.extend_from_slice(&self[frame]);
        Ok(())
    }
}

impl VertexFrames for Vec<Vec<[f32; 3]>> {
    fn frame_count(&self) -> usize {
        self.len()
    }
    fn frame(&self, frame: usize, out: &mut Vec<Vec3>) -> Result<()> {
        out.extend(self[frame].iter().map(|p| Vec3::from(p.map(f64::from))));
        Ok(())
    }
}

/// Frames that are computed when they are written: a body that is posed by its motion.
pub struct ComputedFrames<F> {
    /// Number of frames.
    pub frame_count: usize,
    /// As [`VertexFrames::frame`].
    pub compute: F,
}

impl<F: Fn(usize, &mut Vec<Vec3>) -> Result<()> + Sync> VertexFrames for ComputedFrames<F> {
    fn frame_count(&self) -> usize {
        self.frame_count
    }
    fn frame(&self, frame: usize, out: &mut Vec<Vec3>) -> Result<()> {
        (self.compute)(frame, out)
    }
}

/// A mesh whose vertices move and whose faces stay.
#[derive(Debug, Clone)]
pub struct MovingMesh<'a> {
    /// Name.
    pub name: String,
    /// Number of vertices in every frame.
    pub vertex_count: usize,
    /// Vertex ids of each triangle, shape [face_count, 3].
    pub faces: &'a [[u32; 3]],
    /// Texture coordinates, where there are any.
    pub uvs: Option<&'a ObjUvs>,
    /// Colour, where the format has one.
    pub colour: MeshColour<'a>,
    /// Positions [m], y up. A mesh that stands still has one frame.
    pub frames: &'a dyn VertexFrames,
}

impl MovingMesh<'_> {
    /// Whatever can be said without looking at a frame: at least one vertex, face and frame, ids in range, as many colours
    /// as vertices and texture triangles as faces.
    ///
    /// # Errors
    /// [`Error::Mesh`], [`Error::Length`] or [`Error::NonFinite`] naming the mesh and the element.
    pub fn check(&self) -> Result<()> {
        let name = &self.name;
        if self.vertex_count == 0 || self.faces.is_empty() {
            return Err(Error::mesh(name, "whole mesh", "has no faces", "leave it out"));
        }
        if self.frames.frame_count() == 0 {
            return Err(Error::mesh(name, "motion", "has no frames", "give at least one; a still mesh has one"));
        }
        // Formats count in 32 bits with sign.
        let most = i32::MAX as usize / 3;
        if self.vertex_count > most || self.faces.len() > most || self.frames.frame_count() > most {
            let problem = format!(
                "{} vertices, {} faces, {} frames; files hold at most {most} of each",
                self.vertex_count,
                self.faces.len(),
                self.frames.frame_count()
            );
            return Err(Error::mesh(name, "whole mesh", problem, "split the mesh or the clip"));
        }
        check_ids(name, "face", "vertex", self.faces, self.vertex_count)?;
        self.colour.check(name, self.vertex_count)?;
        if let Some(uvs) = self.uvs {
            Error::check_length(&format!("mesh `{name}`, texture triangles"), self.faces.len(), uvs.faces.len())?;
            Error::check_finite(&format!("mesh `{name}`, texture coordinates"), uvs.coords.as_flattened())?;
            check_ids(name, "texture triangle", "coordinate", &uvs.faces, uvs.coords.len())?;
        }
        Ok(())
    }

    /// Puts a frame into `out`, checked: as many vertices as the mesh has, each one a finite `f32`.
    ///
    /// # Errors
    /// [`Error::Length`] or [`Error::NonFinite`] naming mesh, frame and vertex; whatever the source of the frames says.
    pub fn frame(&self, frame: usize, out: &mut Vec<Vec3>) -> Result<()> {
        checked_frame(&self.name, self.vertex_count, self.frames, frame, out)
    }
}

/// As [`MovingMesh::frame`].
pub(crate) fn checked_frame(
    name: &str,
    vertex_count: usize,
    frames: &dyn VertexFrames,
    frame: usize,
    out: &mut Vec<Vec3>,
) -> Result<()> {
    out.clear();
    frames.frame(frame, out)?;
    let what = || format!("mesh `{name}`, frame {frame}");
    Error::check_length(&what(), vertex_count, out.len())?;
    // Beyond the range of f32 a position would become infinite in the file.
    let lost = |c: &f64| !(*c as f32).is_finite();
    match out.iter().enumerate().find_map(|(v, p)| Some((v, p.iter().position(lost)?))) {
        None => Ok(()),
        Some((v, axis)) => {
            Err(Error::NonFinite { what: format!("{}, vertex {v}", what()), index: axis, value: out[v][axis] })
        }
    }
}

fn check_ids(name: &str, row: &str, column: &str, faces: &[[u32; 3]], count: usize) -> Result<()> {
    match faces.iter().enumerate().find_map(|(f, ids)| Some((f, *ids.iter().find(|&&id| id as usize >= count)?))) {
        None => Ok(()),
        Some((f, id)) => Err(Error::mesh(
            name,
            format!("{row} {f}"),
            format!("names {column} {id}, but there are {count}"),
            "take faces and vertices from the same mesh",
        )),
    }
}
