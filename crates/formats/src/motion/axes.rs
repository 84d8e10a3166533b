//! Which way is up in a file.

use caphy_core::Vec3;
use nalgebra::{Unit, UnitQuaternion};
use serde::{Deserialize, Serialize};

/// The axis of a file's world that points up. caphy's own is y.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub enum UpAxis {
    /// x up.
    #[serde(rename = "x")]
    X,
    /// x down.
    #[serde(rename = "-x")]
    MinusX,
    /// y up: BVH and ASF as a rule, SMPL bodies.
    #[default]
    #[serde(rename = "y")]
    Y,
    /// y down: cameras of computer vision.
    #[serde(rename = "-y")]
    MinusY,
    /// z up: AMASS, Blender.
    #[serde(rename = "z")]
    Z,
    /// z down.
    #[serde(rename = "-z")]
    MinusZ,
}

impl UpAxis {
    /// All of them.
    pub const ALL: [Self; 6] = [Self::Y, Self::Z, Self::MinusY, Self::MinusZ, Self::X, Self::MinusX];
    /// As in a configuration.
    pub fn name(self) -> &'static str {
        match self {
            Self::X => "x",
            Self::MinusX => "-x",
            Self::Y => "y",
            Self::MinusY => "-y",
            Self::Z => "z",
            Self::MinusZ => "-z",
        }
    }
    /// The upward direction in the file's world.
    pub fn direction(self) -> Vec3 {
        match self {
            Self::X => Vec3::x(),
            Self::MinusX => -Vec3::x(),
            Self::Y => Vec3::y(),
            Self::MinusY => -Vec3::y(),
            Self::Z => Vec3::z(),
            Self::MinusZ => -Vec3::z(),
        }
    }
    /// The smallest rotation that turns the file's world to y up: -90° about x from z up; half a turn about x from y down.
    pub fn to_y_up(self) -> UnitQuaternion<f64> {
        match self {
            // From exact halves: `rotation_between` has no axis for the half turn, and rounds the quarter turns.
            Self::Y => UnitQuaternion::identity(),
            Self::MinusY => UnitQuaternion::from_axis_angle(&Vec3::x_axis(), std::f64::consts::PI),
            other => {
                let axis = Unit::new_normalize(other.direction().cross(&Vec3::y()));
                UnitQuaternion::from_axis_angle(&axis, std::f64::consts::FRAC_PI_2)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_axis_is_turned_up() {
        for axis in UpAxis::ALL {
            let turned = axis.to_y_up() * axis.direction();
            assert!((turned - Vec3::y()).norm() < 1e-15, "{axis:?}: {turned}");
        }
        let forward = UpAxis::Z.to_y_up() * -Vec3::y();
        assert!((forward - Vec3::z()).norm() < 1e-15, "AMASS bodies face -y, caphy's +z");
    }
}
