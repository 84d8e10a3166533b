//! Point caches (PC2, version 1): positions per frame without faces, for the mesh cache modifiers of Blender and others.
//!
//! The cache goes onto a mesh with the same vertices in the same order, such as the first frame of an OBJ sequence. The
//! file holds little-endian: `POINTCACHE2` with a zero byte, version, point count (`i32`), first frame, frames between
//! samples (`f32`), sample count (`i32`), then x, y, z of each point of each sample (`f32`).

use crate::moving::MovingMesh;
use caphy_core::{Error, Result};
use std::io::Write;
use std::path::Path;

/// Bytes before the first sample.
pub const PC2_HEADER: usize = 32;

/// When the samples of a cache are; the format counts frames and knows no seconds.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pc2Timing {
    /// Frame number of the first sample.
    pub first_frame: f32,
    /// Frames between two samples: the player's rate over the clip's.
    pub frames_per_sample: f32,
}

impl Default for Pc2Timing {
    /// One sample per frame from frame 1, where timelines start.
    fn default() -> Self {
        Self { first_frame: 1.0, frames_per_sample: 1.0 }
    }
}

/// Writes a moving mesh [m], y up, frame by frame; `path` is for messages.
///
/// # Errors
/// Those of [`MovingMesh::check`] and [`MovingMesh::frame`]; [`Error::Numerics`] for a timing that is not finite or does
/// not advance; [`Error::Io`].
pub fn write_pc2(path: &Path, out: &mut dyn Write, mesh: &MovingMesh<'_>, timing: Pc2Timing) -> Result<()> {
    mesh.check()?;
    let Pc2Timing { first_frame, frames_per_sample } = timing;
    if !(first_frame.is_finite() && frames_per_sample.is_finite() && frames_per_sample > 0.0) {
        return Err(Error::numerics(
            format!("point cache of `{}`", mesh.name),
            format!("first frame {first_frame}, {frames_per_sample} frames per sample"),
            "give a finite first frame and a positive step",
        ));
    }
    let failed = |e| Error::io(path, "write", e);
    let frames = mesh.frames.frame_count();
    let mut bytes = Vec::with_capacity(PC2_HEADER.max(12 * mesh.vertex_count));
    bytes.extend(b"POINTCACHE2\0");
    bytes.extend(1i32.to_le_bytes());
    // `check` has seen that both fit.
    bytes.extend((mesh.vertex_count as i32).to_le_bytes());
    bytes.extend(first_frame.to_le_bytes());
    bytes.extend(frames_per_sample.to_le_bytes());
    bytes.extend((frames as i32).to_le_bytes());
    out.write_all(&bytes).map_err(failed)?;
    let mut vertices = Vec::with_capacity(mesh.vertex_count);
    for frame in 0..frames {
        mesh.frame(frame, &mut vertices)?;
        bytes.clear();
        for c in vertices.iter().flat_map(|v| v.iter()) {
            bytes.extend((*c as f32).to_le_bytes());
        }
        out.write_all(&bytes).map_err(failed)?;
    }
    out.flush().map_err(failed)
}
