//! Garment templates, skinning, energies, a reference solver and fabric estimation of caphy.
//!
//! A garment is a triangle mesh with a rest state ([`GarmentRest`]). Per frame it is skinned with the body
//! ([`skinning`], Eq. 2), told about the pose ([`features`]) and judged by the energies of Eqs. 3-12 ([`energy`]).

pub mod contact;
pub mod contact_surface;
pub mod energy;
pub mod estimate;
pub mod features;
pub mod garment;
pub mod skinning;
pub mod solver;
pub mod template;

pub use garment::{GarmentRest, RestHinge};
