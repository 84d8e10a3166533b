//! Points beyond the joints, as the official package returns them behind the joints: picked vertices, landmarks of the face,
//! and its contour.

use super::BodySmplx;
use super::arrays::is_off_one;
use super::rotation::rotation;
use caphy_core::body::SurfacePoint;
use caphy_core::{Error, Result, Vec3};
use nalgebra::Matrix3;

/// Vertices of the SMPL-X surface, which [`PICKED_VERTICES`] belong to.
pub(super) const SMPLX_VERTEX_COUNT: usize = 10475;

/// Vertices of SMPL-X that stand for joints, by the official names and in the official order.
pub const PICKED_VERTICES: [(&str, u32); 21] = [
    ("nose", 9120),
    ("right_eye", 9929),
    ("left_eye", 9448),
    ("right_ear", 616),
    ("left_ear", 6),
    ("left_big_toe", 5770),
    ("left_small_toe", 5780),
    ("left_heel", 8846),
    ("right_big_toe", 8463),
    ("right_small_toe", 8474),
    ("right_heel", 8635),
    ("left_thumb", 5361),
    ("left_index", 4933),
    ("left_middle", 5058),
    ("left_ring", 5169),
    ("left_pinky", 5286),
    ("right_thumb", 8079),
    ("right_index", 7669),
    ("right_middle", 7794),
    ("right_ring", 7905),
    ("right_pinky", 8022),
];

/// What [`BodySmplx::with_landmarks`] takes.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct SmplxLandmarks {
    /// Vertices by name, in order.
    pub picked: Vec<(String, u32)>,
    /// Landmarks of the face, called `face_1`, `face_2`, ….
    pub face: Vec<SurfacePoint>,
    /// Contour of the face, whose points are called `contour_1`, `contour_2`, ….
    pub contour: Option<FaceContour>,
}

/// The contour of the face as seen from the front: other points of the surface for each degree by which the head turns.
#[derive(Debug, Clone, PartialEq)]
pub struct FaceContour {
    /// Points per yaw, shape [[`FaceContour::ROWS`]][contour_count]: 0° to 39°, then -1° to -39°.
    pub rows: Vec<Vec<SurfacePoint>>,
}

impl FaceContour {
    /// Number of yaws.
    pub const ROWS: usize = 79;

    /// Row of a head that is turned by this rotation, as the official package chooses it.
    fn row(turn: &Matrix3<f64>) -> usize {
        let size = (turn[(0, 0)] * turn[(0, 0)] + turn[(1, 0)] * turn[(1, 0)]).sqrt();
        let yaw = -(-turn[(2, 0)]).atan2(size).to_degrees();
        let degrees = yaw.min(39.0).round_ties_even() as i32;
        match degrees {
            0.. => degrees as usize,
            -39..0 => (39 - degrees) as usize,
            _ => Self::ROWS - 1,
        }
    }
}

/// Landmarks of a body.
#[derive(Debug, Clone)]
pub(super) struct Placed {
    pub(super) names: Vec<String>,
    /// Those that do not depend on the pose.
    fixed: Vec<SurfacePoint>,
    contour: Option<FaceContour>,
    /// From the neck to the root: the joints whose rotations turn the head against the world.
    neck_chain: Vec<usize>,
}

impl BodySmplx {
    /// The body with landmarks.
    ///
    /// # Errors
    /// [`Error::Mesh`] that names the landmark for vertices that do not exist, weights that do not sum to 1, contour rows of
    /// another number or length, and a contour on a body without a joint `neck`.
    pub fn with_landmarks(mut self, landmarks: SmplxLandmarks) -> Result<Self> {
        let bad = |name: &str, problem: String| {
            Error::mesh(
                &self.description.name,
                format!("landmark `{name}`"),
                problem,
                "correct or leave out the landmarks",
            )
        };
        let check = |name: &str, point: &SurfacePoint| {
            let count = self.template.len();
            if let Some(v) = point.vertices.iter().find(|v| **v as usize >= count) {
                return Err(bad(name, format!("names vertex {v}, there are {count}")));
            }
            let sum: f64 = point.weights.iter().sum();
            if is_off_one(sum) { Err(bad(name, format!("has weights that sum to {sum}"))) } else { Ok(()) }
        };
        let (mut names, mut fixed) = (Vec::new(), Vec::new());
        let picked = landmarks.picked.into_iter().map(|(name, id)| (name, SurfacePoint::vertex(id)));
        let face = landmarks.face.into_iter().enumerate().map(|(i, point)| (format!("face_{}", i + 1), point));
        for (name, point) in picked.chain(face) {
            check(&name, &point)?;
            if names.contains(&name) || self.description.joint(&name).is_some() {
                return Err(bad(&name, "has a name that is taken".into()));
            }
            names.push(name);
            fixed.push(point);
        }
        let mut neck_chain = Vec::new();
        if let Some(contour) = &landmarks.contour {
            let width = contour.rows.first().map_or(0, Vec::len);
            if contour.rows.len() != FaceContour::ROWS || contour.rows.iter().any(|row| row.len() != width) {
                let problem = format!("has {} rows, not {} of one length", contour.rows.len(), FaceContour::ROWS);
                return Err(bad("contour_1", problem));
            }
            let mut at = self.description.joint("neck");
            if at.is_none() {
                return Err(bad("contour_1", "needs a joint called `neck`".into()));
            }
            while let Some(j) = at {
                neck_chain.push(j);
                at = self.description.joints[j].parent;
            }
            for (yaw, row) in contour.rows.iter().enumerate() {
                for (i, point) in row.iter().enumerate() {
                    check(&format!("contour_{}, row {yaw}", i + 1), point)?;
                }
            }
            names.extend((1..=width).map(|i| format!("contour_{i}")));
        }
        self.landmarks = if names.is_empty() {
            None
        } else {
            Some(Box::new(Placed { names, fixed, contour: landmarks.contour, neck_chain }))
        };
        Ok(self)
    }
}

impl Placed {
    /// Points in a pose, for rotations as they act.
    pub(super) fn points(&self, rotations: &[Vec3]) -> Vec<SurfacePoint> {
        let mut out = self.fixed.clone();
        if let Some(contour) = &self.contour {
            let turn = self.neck_chain.iter().fold(Matrix3::identity(), |turn, &j| rotation(&rotations[j]) * turn);
            out.extend_from_slice(&contour.rows[FaceContour::row(&turn)]);
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_yaw_has_its_row() {
        // The yaw of the official package is against the sense of the rotation.
        let row = |yaw: f64| FaceContour::row(&rotation(&Vec3::new(0.0, -yaw.to_radians(), 0.0)));
        let expected =
            [(0.0, 0), (0.4, 0), (1.0, 1), (38.6, 39), (39.4, 39), (60.0, 39), (-0.4, 0), (-0.6, 40), (-1.0, 40)];
        for (yaw, wanted) in expected.into_iter().chain([(-38.9, 78), (-39.4, 78), (-39.6, 78), (-80.0, 78)]) {
            assert_eq!(row(yaw), wanted, "{yaw}");
        }
    }
}
