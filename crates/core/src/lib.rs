//! The vocabulary and the four traits of caphy.
//!
//! Everything that a plugin author needs stands here and nothing else: meshes, frames in lanes, poses and joints,
//! units, parameters, errors, and the traits [`MaterialModel`](material::MaterialModel),
//! [`BodyModel`](body::BodyModel), [`DeformationNet`](net::DeformationNet) and [`Segmenter`](segmenter::Segmenter).
//! The crate names no plugin, holds no global state, reads no file, clock or environment variable.
//!
//! Conventions: SI units (m, kg, s, N, J, rad), y up, a T-posed body faces +z with +x to its left.

pub mod array;
pub mod body;
pub mod conformance;
pub mod energy_material;
pub mod error;
pub mod extension;
pub mod files;
#[cfg(feature = "host")]
pub mod host;
pub mod lanes;
pub mod material;
pub mod mesh;
pub mod motion;
pub mod net;
pub mod params;
pub mod plugin;
pub mod pose;
pub mod query;
pub mod scan;
pub mod segmenter;
pub mod simd;
pub mod strain_limit;
pub mod units;

pub use error::{Error, PluginProblem, Result};
pub use mesh::TriMesh;
pub use simd::Real;

/// A point or vector in metres (or unitless for directions), double precision.
pub type Vec3 = nalgebra::Vector3<f64>;
