//! The binary part of a GLB: arrays, each with its buffer view and accessor.

use crate::colour::linear;
use caphy_core::{Error, Result, Vec3};
use nalgebra::UnitQuaternion;
use serde_json::{Value, json};
use std::io::Write;

const U16: u32 = 5123;
const U32: u32 = 5125;
const F32: u32 = 5126;
/// Buffer view targets: vertex attributes and vertex ids.
const ATTRIBUTES: Option<u32> = Some(34962);
const IDS: Option<u32> = Some(34963);

/// Influences per vertex in one attribute set.
const INFLUENCES: usize = 4;

/// Part of the binary chunk.
pub(super) enum Piece {
    /// As they are.
    Bytes(Vec<u8>),
    /// The morph targets of the scene's mesh of this number.
    Targets(usize),
    /// Weights that walk through this many morph targets.
    Weights(usize),
}

/// Bytes, and the JSON that describes them. Every array starts and ends at a multiple of four bytes.
#[derive(Default)]
pub(super) struct Buffer {
    /// What comes before `bytes`, and its length.
    pieces: Vec<Piece>,
    before: usize,
    bytes: Vec<u8>,
    pub(super) views: Vec<Value>,
    pub(super) accessors: Vec<Value>,
}

/// The size of a file or of a part of it, which the format counts in 32 bits.
pub(super) fn checked_size(bytes: usize) -> Result<u32> {
    u32::try_from(bytes).map_err(|_| {
        let problem = format!("{bytes} bytes, the format holds at most {}", u32::MAX);
        Error::numerics("GLB scene", problem, "export fewer frames, a point cache or USD")
    })
}

/// Smallest and largest coordinates as rounded to `f32`; zero without values.
pub(super) fn bounds_f32(values: impl Iterator<Item = Vec3>) -> [Vec3; 2] {
    let rounded = |v: Vec3| v.map(|c| f64::from(c as f32));
    values.map(rounded).map(|v| [v, v]).reduce(|[lo, hi], [v, _]| [lo.inf(&v), hi.sup(&v)]).unwrap_or_default()
}

/// Weights of `frames` morph targets in as many frames, each 1 in its own and 0 elsewhere.
pub(super) fn write_weights(out: &mut dyn Write, frames: usize) -> std::io::Result<()> {
    let mut row = vec![0u8; 4 * frames];
    for frame in 0..frames {
        row[4 * frame..][..4].copy_from_slice(&1f32.to_le_bytes());
        out.write_all(&row)?;
        row[4 * frame..][..4].fill(0);
    }
    Ok(())
}

impl Buffer {
    /// Length of the whole chunk so far.
    pub(super) fn len(&self) -> usize {
        self.before + self.bytes.len()
    }
    /// The chunk, in order.
    pub(super) fn into_pieces(mut self) -> Vec<Piece> {
        self.pieces.push(Piece::Bytes(self.bytes));
        self.pieces
    }
    /// Makes room for what is made only when it is written; returns where it starts.
    fn promise(&mut self, piece: Piece, length: usize) -> usize {
        let start = self.len();
        self.pieces.extend([Piece::Bytes(std::mem::take(&mut self.bytes)), piece]);
        self.before = start + length;
        start
    }
    /// Describes an array; returns the accessor's id.
    fn describe(
        &mut self,
        bytes: std::ops::Range<usize>,
        target: Option<u32>,
        kind: &str,
        component: u32,
        count: usize,
    ) -> usize {
        let mut view = json!({ "buffer": 0, "byteOffset": bytes.start, "byteLength": bytes.len() });
        if let Some(target) = target {
            view["target"] = target.into();
        }
        self.accessors.push(json!({
            "bufferView": self.views.len(), "componentType": component, "count": count, "type": kind
        }));
        self.views.push(view);
        self.accessors.len() - 1
    }
    /// Describes what was appended since `start`, and pads it.
    fn close(&mut self, start: usize, target: Option<u32>, kind: &str, component: u32, count: usize) -> usize {
        let end = self.len();
        self.bytes.resize(self.bytes.len().next_multiple_of(4), 0);
        self.describe(start..end, target, kind, component, count)
    }
    /// Bounds of positions, which the format demands.
    fn bound(&mut self, accessor: usize, [lo, hi]: [Vec3; 2]) {
        self.accessors[accessor]["min"] = json!([lo.x, lo.y, lo.z]);
        self.accessors[accessor]["max"] = json!([hi.x, hi.y, hi.z]);
    }
    /// Describes the morph targets of a mesh, positions before normals in each frame; `bounds` are those of the
    /// differences of positions in a frame.
    pub(super) fn targets(
        &mut self,
        mesh: usize,
        frames: usize,
        vertices: usize,
        mut bounds: impl FnMut(usize) -> Result<[Vec3; 2]>,
    ) -> Result<Vec<Value>> {
        let array = 12 * vertices;
        let length = (2 * array).saturating_mul(frames);
        checked_size(self.len().saturating_add(length))?;
        let start = self.promise(Piece::Targets(mesh), length);
        (0..frames)
            .map(|frame| {
                let at = start + 2 * array * frame;
                let position = self.describe(at..at + array, ATTRIBUTES, "VEC3", F32, vertices);
                self.bound(position, bounds(frame)?);
                let normal = self.describe(at + array..at + 2 * array, ATTRIBUTES, "VEC3", F32, vertices);
                Ok(json!({ "POSITION": position, "NORMAL": normal }))
            })
            .collect()
    }
    /// Describes what [`write_weights`] writes.
    pub(super) fn walking_weights(&mut self, frames: usize) -> Result<usize> {
        let count = frames.saturating_mul(frames);
        let length = count.saturating_mul(4);
        checked_size(self.len().saturating_add(length))?;
        let start = self.promise(Piece::Weights(frames), length);
        Ok(self.describe(start..start + length, None, "SCALAR", F32, count))
    }
    fn push_f32(&mut self, value: f64) {
        self.bytes.extend((value as f32).to_le_bytes());
    }
    fn push_vectors(&mut self, values: &[Vec3], target: Option<u32>) -> usize {
        let start = self.len();
        for c in values.iter().flat_map(|v| v.iter()) {
            self.push_f32(*c);
        }
        self.close(start, target, "VEC3", F32, values.len())
    }
    /// Normals.
    pub(super) fn normals(&mut self, values: &[Vec3]) -> usize {
        self.push_vectors(values, ATTRIBUTES)
    }
    /// Translations of a node, one per frame.
    pub(super) fn translations(&mut self, values: &[Vec3]) -> usize {
        self.push_vectors(values, None)
    }
    /// Positions with their bounds.
    pub(super) fn positions(&mut self, values: &[Vec3]) -> usize {
        let id = self.push_vectors(values, ATTRIBUTES);
        self.bound(id, bounds_f32(values.iter().copied()));
        id
    }
    /// Linear colours with 16 bits, enough for the dark end of sRGB.
    pub(super) fn colours(&mut self, colours: &[[u8; 3]]) -> usize {
        let start = self.len();
        for colour in colours {
            for channel in colour {
                self.bytes.extend(((linear(*channel) * 65535.0).round() as u16).to_le_bytes());
            }
            self.bytes.extend(u16::MAX.to_le_bytes());
        }
        let id = self.close(start, ATTRIBUTES, "VEC4", U16, colours.len());
        self.accessors[id]["normalized"] = true.into();
        id
    }
    pub(super) fn indices(&mut self, faces: &[[u32; 3]]) -> usize {
        let start = self.len();
        for id in faces.iter().flatten() {
            self.bytes.extend(id.to_le_bytes());
        }
        self.close(start, IDS, "SCALAR", U32, 3 * faces.len())
    }
    pub(super) fn scalars(&mut self, values: impl Iterator<Item = f64>) -> usize {
        let start = self.len();
        for value in values {
            self.push_f32(value);
        }
        let count = (self.len() - start) / 4;
        self.close(start, None, "SCALAR", F32, count)
    }
    /// Times of frames [s], with their bounds.
    pub(super) fn times(&mut self, frames: usize, fps: f64) -> usize {
        let id = self.scalars((0..frames).map(|f| f as f64 / fps));
        let last = (frames.saturating_sub(1) as f64 / fps) as f32;
        self.accessors[id]["min"] = json!([0.0]);
        self.accessors[id]["max"] = json!([f64::from(last)]);
        id
    }
    pub(super) fn quaternions(&mut self, values: &[UnitQuaternion<f64>]) -> usize {
        let start = self.len();
        // Both orders are x, y, z, w.
        for c in values.iter().flat_map(|q| q.coords.iter()) {
            self.push_f32(*c);
        }
        self.close(start, None, "VEC4", F32, values.len())
    }
    /// Joints rest without rotation: their inverse is a translation. Column-major.
    pub(super) fn inverse_bind_matrices(&mut self, joints: &[Vec3]) -> usize {
        let start = self.len();
        for joint in joints {
            let columns = nalgebra::Matrix4::new_translation(&-joint);
            for c in columns.iter() {
                self.push_f32(*c);
            }
        }
        self.close(start, None, "MAT4", F32, joints.len())
    }
    /// The four largest weights of each vertex, scaled to sum 1: accessors of joint ids and of weights.
    pub(super) fn influences(&mut self, name: &str, weights: &[f64], joints: usize) -> Result<(usize, usize)> {
        let mut ids: Vec<u8> = Vec::with_capacity(weights.len() / joints * 8);
        let mut kept: Vec<f32> = Vec::with_capacity(weights.len() / joints * INFLUENCES);
        for (vertex, row) in weights.chunks_exact(joints).enumerate() {
            let mut best: [(f64, usize); INFLUENCES] = [(0.0, 0); INFLUENCES];
            for (joint, &weight) in row.iter().enumerate() {
                // Strictly larger: of equal weights the first joint wins, on every machine.
                if let Some(slot) = best.iter().position(|(w, _)| weight > *w) {
                    best[slot..].rotate_right(1);
                    best[slot] = (weight, joint);
                }
            }
            let total: f64 = best.iter().map(|(w, _)| w).sum();
            if total <= 0.0 {
                return Err(Error::mesh(
                    name,
                    format!("vertex {vertex}"),
                    "has no positive skinning weight",
                    "give every vertex a joint",
                ));
            }
            let mut scaled = best.map(|(w, _)| (w / total) as f32);
            // The largest takes the rounding, so that the sum is 1 as the format demands.
            scaled[0] = 1.0 - (scaled[1] + scaled[2] + scaled[3]);
            for (slot, &weight) in scaled.iter().enumerate() {
                // A joint without weight must be written as 0.
                let id = if weight > 0.0 { best[slot].1 as u16 } else { 0 };
                ids.extend(id.to_le_bytes());
                kept.push(weight);
            }
        }
        let count = kept.len() / INFLUENCES;
        let start = self.len();
        self.bytes.extend(ids);
        let ids = self.close(start, ATTRIBUTES, "VEC4", U16, count);
        let start = self.len();
        for weight in kept {
            self.push_f32(f64::from(weight));
        }
        Ok((ids, self.close(start, ATTRIBUTES, "VEC4", F32, count)))
    }
}
