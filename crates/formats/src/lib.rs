//! File formats of caphy: NPZ, PLY, OBJ and motion in; PLY, OBJ, GLB and safetensors out.
//!
//! Nothing here touches the disk. A reader takes the file's bytes and its path, the path only for messages; a writer
//! returns bytes. Damaged input gives a [`caphy_core::Error::Format`] that names the file, the element and the remedy:
//! never a panic, and never an allocation on the word of a header alone.

mod colour;
mod number;
mod polygon;

pub mod glb;
pub mod motion;
pub mod npz;
pub mod obj;
pub mod ply;
pub mod weights;
