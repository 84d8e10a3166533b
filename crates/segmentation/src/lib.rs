//! Segmenters of caphy and the fusion of their labels over views (Sec. 3.1).
//!
//! A [`Segmenter`](caphy_core::segmenter::Segmenter) labels the pixels of one view; [`label_scan`] renders views around
//! a scan, has each labelled, and gives every vertex the label that most views show at it. Four segmenters stand
//! here: [`SegmenterColour`] knows garments by their colours, [`SegmenterLabels`] reads images that a human parser made,
//! [`SegmenterOnnx`] runs such a parser, [`SegmenterVertex`] reads labels that the scan already has.

pub mod classes;
pub mod colour;
pub mod fusion;
mod islands;
pub mod labels;
pub mod onnx;
pub mod picture;
pub mod seeds;
mod unseen;
pub mod vertex;
mod view;

pub use classes::LabelMap;
pub use colour::{SegmenterColour, SegmenterColourSpec};
pub use fusion::{Fusion, FusionReport, FusionSettings, label_scan};
pub use labels::{SegmenterLabels, SegmenterLabelsSpec};
pub use onnx::{SegmenterOnnx, SegmenterOnnxSpec};
pub use picture::{label_colour, label_colours, label_picture};
pub use seeds::Seed;
pub use vertex::{SegmenterVertex, SegmenterVertexSpec};
