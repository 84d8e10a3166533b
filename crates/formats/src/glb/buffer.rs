//! The binary part of a GLB: arrays, each with its buffer view and accessor.

use crate::colour::linear;
use caphy_core::{Error, Result, Vec3};
use nalgebra::UnitQuaternion;
use serde_json::{Value, json};

const U16: u32 = 5123;
const U32: u32 = 5125;
const F32: u32 = 5126;
/// Buffer view targets: vertex attributes and vertex ids.
const ATTRIBUTES: Option<u32> = Some(34962);
const IDS: Option<u32> = Some(34963);

/// Influences per vertex in one attribute set.
const INFLUENCES: usize = 4;

/// Bytes, and the JSON that describes them. Every array starts and ends at a multiple of four bytes.
#[derive(Default)]
pub(super) struct Buffer {
    pub(super) bytes: Vec<u8>,
    pub(super) views: Vec<Value>,
    pub(super) accessors: Vec<Value>,
}

impl Buffer {
    /// Describes what was appended since `start`; returns the accessor's id.
    fn describe(&mut self, start: usize, target: Option<u32>, kind: &str, component: u32, count: usize) -> usize {
        let mut view = json!({ "buffer": 0, "byteOffset": start, "byteLength": self.bytes.len() - start });
        if let Some(target) = target {
            view["target"] = target.into();
        }
        self.bytes.resize(self.bytes.len().next_multiple_of(4), 0);
        self.accessors.push(json!({
            "bufferView": self.views.len(), "componentType": component, "count": count, "type": kind
        }));
        self.views.push(view);
        self.accessors.len() - 1
    }
    fn push_f32(&mut self, value: f64) {
        self.bytes.extend((value as f32).to_le_bytes());
    }
    fn push_vectors(&mut self, values: &[Vec3], target: Option<u32>) -> usize {
        let start = self.bytes.len();
        for c in values.iter().flat_map(|v| v.iter()) {
            self.push_f32(*c);
        }
        self.describe(start, target, "VEC3", F32, values.len())
    }
    /// Normals or their differences.
    pub(super) fn normals(&mut self, values: &[Vec3]) -> usize {
        self.push_vectors(values, ATTRIBUTES)
    }
    /// Translations of a node, one per frame.
    pub(super) fn translations(&mut self, values: &[Vec3]) -> usize {
        self.push_vectors(values, None)
    }
    /// Positions or their differences, with the bounds that the format demands, as rounded to `f32`.
    pub(super) fn positions(&mut self, values: &[Vec3]) -> usize {
        let id = self.push_vectors(values, ATTRIBUTES);
        let rounded = |v: &Vec3| v.map(|c| f64::from(c as f32));
        let first = values.first().map(rounded).unwrap_or_else(Vec3::zeros);
        let (lo, hi) = values.iter().map(rounded).fold((first, first), |(lo, hi), v| (lo.inf(&v), hi.sup(&v)));
        self.accessors[id]["min"] = json!([lo.x, lo.y, lo.z]);
        self.accessors[id]["max"] = json!([hi.x, hi.y, hi.z]);
        id
    }
    /// Linear colours with 16 bits, enough for the dark end of sRGB.
    pub(super) fn colours(&mut self, colours: &[[u8; 3]]) -> usize {
        let start = self.bytes.len();
        for colour in colours {
            for channel in colour {
                self.bytes.extend(((linear(*channel) * 65535.0).round() as u16).to_le_bytes());
            }
            self.bytes.extend(u16::MAX.to_le_bytes());
        }
        let id = self.describe(start, ATTRIBUTES, "VEC4", U16, colours.len());
        self.accessors[id]["normalized"] = true.into();
        id
    }
    pub(super) fn indices(&mut self, faces: &[[u32; 3]]) -> usize {
        let start = self.bytes.len();
        for id in faces.iter().flatten() {
            self.bytes.extend(id.to_le_bytes());
        }
        self.describe(start, IDS, "SCALAR", U32, 3 * faces.len())
    }
    pub(super) fn scalars(&mut self, values: impl Iterator<Item = f64>) -> usize {
        let start = self.bytes.len();
        for value in values {
            self.push_f32(value);
        }
        let count = (self.bytes.len() - start) / 4;
        self.describe(start, None, "SCALAR", F32, count)
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
        let start = self.bytes.len();
        // Both orders are x, y, z, w.
        for c in values.iter().flat_map(|q| q.coords.iter()) {
            self.push_f32(*c);
        }
        self.describe(start, None, "VEC4", F32, values.len())
    }
    /// Joints rest without rotation: their inverse is a translation. Column-major.
    pub(super) fn inverse_bind_matrices(&mut self, joints: &[Vec3]) -> usize {
        let start = self.bytes.len();
        for joint in joints {
            let columns = nalgebra::Matrix4::new_translation(&-joint);
            for c in columns.iter() {
                self.push_f32(*c);
            }
        }
        self.describe(start, None, "MAT4", F32, joints.len())
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
        let start = self.bytes.len();
        self.bytes.extend(ids);
        let ids = self.describe(start, ATTRIBUTES, "VEC4", U16, count);
        let start = self.bytes.len();
        for weight in kept {
            self.push_f32(f64::from(weight));
        }
        Ok((ids, self.describe(start, ATTRIBUTES, "VEC4", F32, count)))
    }
}
