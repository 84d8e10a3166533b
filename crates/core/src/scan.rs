//! A 3D scan of the clothed person.

use crate::{TriMesh, Vec3};
use serde::{Deserialize, Serialize};

/// What a pixel or a scan vertex shows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
#[repr(u8)]
pub enum Label {
    /// Skin, hair, shoes: everything that is not one of the garments.
    Body = 0,
    /// The upper garment.
    Upper = 1,
    /// The lower garment.
    Lower = 2,
    /// Nothing, or not known.
    Ignore = 255,
}

impl Label {
    /// The labels that count.
    pub const ALL: [Label; 3] = [Label::Body, Label::Upper, Label::Lower];
    /// The label of a stored byte; unknown bytes are [`Label::Ignore`].
    pub fn from_byte(byte: u8) -> Self {
        match byte {
            0 => Self::Body,
            1 => Self::Upper,
            2 => Self::Lower,
            _ => Self::Ignore,
        }
    }
}

/// One scan: a mesh (any topology, several components) with optional attributes per vertex.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Scan {
    /// Name, usually the file's stem.
    pub name: String,
    /// The surface.
    pub mesh: TriMesh,
    /// Vertex colours (sRGB), shape [vertex_count].
    pub colours: Option<Vec<[u8; 3]>>,
    /// Vertex labels stored with the scan, shape [vertex_count].
    pub labels: Option<Vec<Label>>,
}

/// A scan with a label on every vertex: what preprocessing hands on.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LabelledPoints {
    /// Positions [m].
    pub points: Vec<Vec3>,
    /// Outward unit normals.
    pub normals: Vec<Vec3>,
    /// One label per point.
    pub labels: Vec<Label>,
}

impl LabelledPoints {
    /// The points that carry a label, with their normals.
    pub fn with_label(&self, label: Label) -> (Vec<Vec3>, Vec<Vec3>) {
        let keep = |i: &usize| self.labels[*i] == label;
        let ids: Vec<usize> = (0..self.points.len()).filter(keep).collect();
        (ids.iter().map(|&i| self.points[i]).collect(), ids.iter().map(|&i| self.normals[i]).collect())
    }
}
