//! Where the eyes are: views around a scan (Sec. 3.1) and cameras for pictures.

use caphy_core::Vec3;
use caphy_core::segmenter::Camera;
use nalgebra::{Matrix3, Matrix3x4};

/// Share of the image that the framed bounds fill.
const FILL: f64 = 0.94;

/// Shortest extent that is framed [m]: keeps the scale finite for a scan that is a point.
const SMALLEST_EXTENT: f64 = 1e-6;

/// How a view maps depth.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Projection {
    /// Parallel rays: the same pixel size at every depth.
    Orthographic,
    /// Rays through the eye.
    Perspective {
        /// Opening angle over the image's height [rad], clamped to [0.01, 3].
        field_of_view: f64,
    },
}

/// `count` unit vectors spread evenly over the sphere (Fibonacci lattice): equal steps in height, golden-angle steps
/// around y. No vector is ±y for any count.
pub fn fibonacci_directions(count: usize) -> Vec<Vec3> {
    let golden_angle = std::f64::consts::PI * (3.0 - 5.0f64.sqrt());
    (0..count)
        .map(|i| {
            let y = 1.0 - (2 * i + 1) as f64 / count as f64;
            let radius = (1.0 - y * y).sqrt();
            let (sin, cos) = (golden_angle * i as f64).sin_cos();
            Vec3::new(radius * cos, y, radius * sin)
        })
        .collect()
}

/// `count` orthographic cameras around `bounds` (smallest and largest corner [m]), uniformly distributed over the
/// sphere of directions (Sec. 3.1 uses 32), `size`² pixels each, the bounds filling the image.
pub fn uniform_views(bounds: (Vec3, Vec3), count: usize, size: usize) -> Vec<Camera> {
    uniform_views_with(bounds, count, size, Projection::Orthographic)
}

/// As [`uniform_views`], with the projection chosen.
pub fn uniform_views_with(bounds: (Vec3, Vec3), count: usize, size: usize, projection: Projection) -> Vec<Camera> {
    fibonacci_directions(count).iter().map(|d| frame(bounds, d, projection, size, size)).collect()
}

/// A camera of `width` × `height` pixels that sees all of `bounds` [m] from the side `from` points to (a direction from
/// the subject to the eye, any length; zero means from the front, +z).
pub fn frame(bounds: (Vec3, Vec3), from: &Vec3, projection: Projection, width: usize, height: usize) -> Camera {
    let (lo, hi) = bounds;
    let forward = -from.try_normalize(1e-12).unwrap_or_else(Vec3::z);
    let rotation = rotation(&forward, &Vec3::y());
    let corners: [Vec3; 8] = std::array::from_fn(|i| {
        let pick = |k: usize| if i >> k & 1 == 0 { lo[k] } else { hi[k] };
        Vec3::new(pick(0), pick(1), pick(2))
    });
    // Bounds of the box in camera axes.
    let turned = corners.map(|c| rotation * c);
    let (first, rest) = (turned[0], &turned[1..]);
    let (near, far) = rest.iter().fold((first, first), |(a, b), c| (a.inf(c), b.sup(c)));
    let middle = 0.5 * (near + far);
    let half = (0.5 * (far - near)).map(|e| e.max(0.5 * SMALLEST_EXTENT));
    let (w, h) = (0.5 * FILL * width as f64, 0.5 * FILL * height as f64);
    let (scale, distance, perspective) = match projection {
        // The image plane stands off by half the depth again, so that nothing lies on it.
        Projection::Orthographic => ((w / half.x).min(h / half.y), 1.5 * half.z, false),
        Projection::Perspective { field_of_view } => {
            let scale = 0.5 * height as f64 / (0.5 * field_of_view.clamp(0.01, 3.0)).tan();
            // Each corner must project inside: |x| scale / z <= w.
            let distance = turned
                .iter()
                .map(|c| {
                    let d = c - middle;
                    let reach = (d.x.abs() / w.max(0.5)).max(d.y.abs() / h.max(0.5));
                    reach * scale - d.z
                })
                .fold(half.z * 1.05, f64::max);
            (scale, distance, true)
        }
    };
    let translation = Vec3::new(0.0, 0.0, distance) - middle;
    Camera { world_to_camera: join(&rotation, &translation), scale, perspective, width, height }
}

/// A perspective camera at `eye` [m] that looks at `target` [m], `up` pointing up in the image, with the opening angle
/// `field_of_view` [rad] over the image's height (clamped to [0.01, 3]). An `up` along the line of sight is replaced.
pub fn look_at(eye: &Vec3, target: &Vec3, up: &Vec3, field_of_view: f64, width: usize, height: usize) -> Camera {
    let forward = (target - eye).try_normalize(1e-12).unwrap_or_else(|| -Vec3::z());
    let rotation = rotation(&forward, up);
    Camera {
        world_to_camera: join(&rotation, &(-(rotation * eye))),
        scale: 0.5 * height as f64 / (0.5 * field_of_view.clamp(0.01, 3.0)).tan(),
        perspective: true,
        width,
        height,
    }
}

/// The same view with `factor` times as many pixels along each side.
pub(crate) fn magnify(camera: &Camera, factor: usize) -> Camera {
    Camera {
        scale: camera.scale * factor as f64,
        width: camera.width * factor,
        height: camera.height * factor,
        ..camera.clone()
    }
}

/// World to camera rotation: rows x right, y down, z along the unit vector `forward`.
fn rotation(forward: &Vec3, up: &Vec3) -> Matrix3<f64> {
    // Near its pole `up` says nothing about the image's upright: take the axis that `forward` has least of.
    let right = [*up, Vec3::z(), Vec3::x()]
        .iter()
        .filter_map(|u| u.try_normalize(1e-12))
        .map(|u| forward.cross(&u))
        .find(|r| r.norm() > 1e-3)
        .and_then(|r| r.try_normalize(0.0))
        .unwrap_or_else(Vec3::x);
    let down = forward.cross(&right);
    Matrix3::from_rows(&[right.transpose(), down.transpose(), forward.transpose()])
}

fn join(rotation: &Matrix3<f64>, translation: &Vec3) -> Matrix3x4<f64> {
    let mut m = Matrix3x4::zeros();
    m.fixed_columns_mut::<3>(0).copy_from(rotation);
    m.set_column(3, translation);
    m
}

#[cfg(test)]
mod tests {
    use super::*;

    fn person() -> (Vec3, Vec3) {
        (Vec3::new(-0.6, -0.9, -0.2), Vec3::new(0.7, 0.8, 0.3))
    }

    fn proper(camera: &Camera) {
        let r = camera.world_to_camera.fixed_columns::<3>(0).into_owned();
        assert!((r * r.transpose() - Matrix3::identity()).norm() < 1e-12);
        assert!((r.determinant() - 1.0).abs() < 1e-12);
    }

    #[test]
    fn views_are_proper_and_see_the_whole_box() {
        let (lo, hi) = person();
        for projection in [Projection::Orthographic, Projection::Perspective { field_of_view: 0.6 }] {
            for camera in uniform_views_with((lo, hi), 32, 512, projection) {
                proper(&camera);
                let mut touches = 0.0f64;
                for i in 0..8 {
                    let p = Vec3::new([lo.x, hi.x][i & 1], [lo.y, hi.y][i >> 1 & 1], [lo.z, hi.z][i >> 2]);
                    let (x, y, z) = camera.project(&p);
                    let margin = 512.0 * 0.5 * (1.0 - FILL) - 1e-6;
                    assert!(x >= margin && x <= 512.0 - margin && y >= margin && y <= 512.0 - margin && z > 0.0);
                    touches = touches.max((x - 256.0).abs()).max((y - 256.0).abs());
                }
                // The frame is tight.
                assert!((touches - 256.0 * FILL).abs() < 1e-6);
            }
        }
    }

    #[test]
    fn directions_are_uniform() {
        let d = fibonacci_directions(32);
        // A uniform set has zero mean and the second moment 1/3 in every direction; a direction's share of the sphere,
        // 4π/32, is a square of 0.63 rad: neighbours closer than about half of that would be a clump.
        assert!(d.iter().sum::<Vec3>().norm() / 32.0 < 0.02);
        let second = d.iter().map(|v| v * v.transpose()).sum::<Matrix3<f64>>() / 32.0;
        assert!((second - Matrix3::identity() / 3.0).norm() < 0.02);
        let closest = (0..32).flat_map(|i| (0..i).map(move |j| (i, j))).map(|(i, j)| d[i].angle(&d[j]));
        assert!(closest.fold(9.0, f64::min) > 0.35);
        assert!(fibonacci_directions(0).is_empty());
    }

    #[test]
    fn poles_and_points_have_cameras_too() {
        for from in [Vec3::y(), -Vec3::y(), Vec3::zeros(), Vec3::new(1e-5, 1.0, 0.0)] {
            let camera = frame(person(), &from, Projection::Orthographic, 64, 64);
            proper(&camera);
        }
        let point = (Vec3::x(), Vec3::x());
        for camera in uniform_views(point, 3, 16) {
            let (x, y, z) = camera.project(&Vec3::x());
            assert!((x - 8.0).abs() < 1e-6 && (y - 8.0).abs() < 1e-6 && z > 0.0 && camera.scale.is_finite());
        }
    }

    #[test]
    fn front_view_has_x_right_and_y_up() {
        let camera = look_at(&Vec3::new(0.0, 0.0, 3.0), &Vec3::zeros(), &Vec3::y(), 0.7, 100, 80);
        let (x, y, z) = camera.project(&Vec3::new(0.1, 0.2, 0.0));
        assert!(x > 50.0 && y < 40.0 && (z - 3.0).abs() < 1e-12);
        assert!((camera.eye() - Vec3::new(0.0, 0.0, 3.0)).norm() < 1e-12);
        let same = frame(person(), &Vec3::z(), Projection::Orthographic, 100, 80);
        let (x, y, _) = same.project(&Vec3::new(0.3, 0.3, 0.0));
        assert!(x > 50.0 && y < 40.0);
        proper(&look_at(&Vec3::y(), &Vec3::zeros(), &Vec3::y(), 0.7, 8, 8));
        proper(&look_at(&Vec3::y(), &Vec3::y(), &Vec3::zeros(), 0.7, 8, 8));
    }
}
