//! [`Segmenter`]: a label for every pixel of a rendered view.

use crate::files::Files;
use crate::scan::{Label, Scan};
use crate::{Result, Vec3};
use nalgebra::Matrix3x4;
use serde::{Deserialize, Serialize};

/// A camera: where it looks from, and how points land on pixels. Orthographic or perspective.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Camera {
    /// World to camera (rotation | translation [m]): x right, y *down*, z away from the eye.
    pub world_to_camera: Matrix3x4<f64>,
    /// Pixels per metre (orthographic) or focal length in pixels (perspective).
    pub scale: f64,
    /// Whether depth divides.
    pub perspective: bool,
    /// Image width [pixels].
    pub width: usize,
    /// Image height [pixels].
    pub height: usize,
}

impl Camera {
    /// Pixel coordinates (x right, y down, centres at half-integers) and depth [m] of a world point.
    pub fn project(&self, point: &Vec3) -> (f64, f64, f64) {
        let c = self.world_to_camera * point.push(1.0);
        let s = if self.perspective { self.scale / c.z } else { self.scale };
        (c.x * s + 0.5 * self.width as f64, c.y * s + 0.5 * self.height as f64, c.z)
    }
    /// Where the eye is [m] (for orthographic cameras: a point on the image plane).
    pub fn eye(&self) -> Vec3 {
        let r = self.world_to_camera.fixed_columns::<3>(0);
        -r.transpose() * self.world_to_camera.column(3)
    }
}

/// Triangle id of a pixel that shows nothing.
pub const NO_TRIANGLE: u32 = u32::MAX;

/// One rendered view of a scan, row by row from the top.
pub struct View<'a> {
    /// The scan that was rendered.
    pub scan: &'a Scan,
    /// Number of the view, from 0.
    pub index: usize,
    /// Number of views of this scan.
    pub count: usize,
    /// The camera.
    pub camera: &'a Camera,
    /// sRGB, shape [height · width].
    pub colour: &'a [[u8; 3]],
    /// Depth along the camera's axis [m], infinite where nothing is, shape [height · width].
    pub depth: &'a [f32],
    /// Front-most triangle, [`NO_TRIANGLE`] where nothing is, shape [height · width].
    pub triangle: &'a [u32],
}

/// Finds which pixels show body, upper and lower garment (2D half of Sec. 3.1).
///
/// # Promise
/// Deterministic. Every pixel gets a label; pixels that show nothing get [`Label::Ignore`].
///
/// # Shapes and units
/// `labels` has shape [height · width], row by row from the top, as the images of [`View`].
///
/// # Errors
/// [`crate::Error::Length`] for a wrong number of labels; errors that name the scan when it lacks what the segmenter needs
/// (colours, labels, label images).
pub trait Segmenter: Send + Sync {
    /// Labels one view.
    fn segment(&self, view: &View<'_>, labels: &mut [Label]) -> Result<()>;
}

/// The `[segmenter]` table of a configuration.
#[typetag::serde(tag = "type")]
pub trait SegmenterSpec: std::fmt::Debug + Send + Sync {
    /// Checks the keys, reads files through the host, makes the segmenter.
    fn build(&self, files: &dyn Files) -> Result<Box<dyn Segmenter>>;
}
