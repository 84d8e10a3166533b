//! Tests of the crate from outside, in one program: what they share of it is built once. Those of loaded libraries are another one, for
//! they need the feature `host`.

mod conformance_rejects;
mod energy_material;
mod nearest;
