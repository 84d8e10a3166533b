//! File formats of caphy: NPZ, PLY, OBJ with textures, images and motion in; PLY, OBJ (also as a sequence), PC2, USD, GLB,
//! safetensors and TensorBoard events out.
//!
//! Nothing here touches the disk. A reader takes the file's bytes and its path, the path only for messages; a writer
//! returns bytes, or writes to where it is told when there may be many. Damaged input gives a
//! [`caphy_core::Error::Format`] that names the file, the element and the remedy: never a panic, and never an allocation
//! on the word of a header alone.

mod number;
mod polygon;

pub mod colour;
pub mod glb;
pub mod image;
pub mod motion;
pub mod moving;
pub mod npz;
pub mod obj;
pub mod onnx;
pub mod pc2;
pub mod ply;
pub mod scan;
pub mod tensorboard;
pub mod usd;
pub mod weights;
