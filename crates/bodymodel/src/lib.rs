//! Body models of caphy: the SMPL-X layout, a mannequin, registration under clothing.

pub mod registration;
pub mod smplx;

pub use smplx::BodySmplx;
