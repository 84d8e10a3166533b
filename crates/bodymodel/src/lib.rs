//! Body models of caphy: the SMPL-X layout, a mannequin, registration under clothing.

pub mod mannequin;
pub mod procedural_motion;
pub mod registration;
pub mod smplx;

pub use mannequin::BodyMannequin;
pub use smplx::BodySmplx;
