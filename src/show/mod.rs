//! Pictures and facts of inputs: `caphy show …`.

pub mod body;
pub mod fabrics;
pub mod garment;
pub mod motion;
