//! Pictures and facts of inputs: `caphy show …`.

pub mod fabrics;
