//! Fabric estimation: Eq. 10, alternation, equilibrium fit.
//!
//! `cargo run --release --example estimate_study` measures the same case more widely.

mod alternation;
mod bad_input;
mod equilibrium;
mod exact;
mod held;
mod study;
