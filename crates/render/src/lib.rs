//! A small z-buffer renderer for label views and for pictures.
//!
//! [`cameras`] places the eyes, [`raster`] draws unshaded colour, depth and triangle ids (what a segmenter sees),
//! [`capture`] makes scans of surfaces, [`shade`] draws shaded [`Picture`]s of several meshes (what people see), [`sheet`] puts pictures side by side,
//! [`colours`] turns fields into colours, [`rgb`] holds the pixels and encodes PNG.
//!
//! Everything is deterministic: the same input gives the same bytes on any number of threads.

pub mod cameras;
pub mod capture;
pub mod colours;
mod font;
pub mod raster;
pub mod rgb;
pub mod shade;
pub mod sheet;

pub use cameras::{Projection, frame, look_at, uniform_views, uniform_views_with};
pub use raster::{Image, render};
pub use rgb::{Rgb, png};
pub use shade::{Layer, Paint, Picture};
pub use sheet::contact_sheet;
