//! Tests of the crate from outside, in one program: what they share of it is built once.

mod conformance;
mod mannequin;
mod registration;
mod registration_scans;
mod smplx;
