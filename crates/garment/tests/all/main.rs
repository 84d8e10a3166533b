//! Tests of the crate from outside, in one program: what they share of it is built once.

mod estimate;
mod extremes;
mod material_patch;
mod skinning;
mod snug;
mod solver;
mod support;
mod template;
mod terms;
