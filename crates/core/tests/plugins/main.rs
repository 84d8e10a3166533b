//! Plugin libraries across the real border: the examples in Rust and C, and libraries with one fault each.

mod build;
mod examples;
mod faults;
mod panics;
