//! The z-buffer: which triangle each pixel sees, how far away, and its unshaded colour.
//!
//! Vertices are snapped to 1/256 pixel and edges are decided in integers with the top-left rule, so that neighbouring
//! triangles leave no gap and share no pixel. Both sides of a triangle are drawn. Equal depths go to the earlier
//! triangle.

use caphy_core::segmenter::{Camera, NO_TRIANGLE};
use caphy_core::{TriMesh, Vec3};

/// One rendered view, row by row from the top.
#[derive(Debug, Clone, PartialEq)]
pub struct Image {
    /// Width [pixels].
    pub width: usize,
    /// Height [pixels].
    pub height: usize,
    /// Interpolated vertex colour (sRGB), black where nothing is, shape [height · width].
    pub colour: Vec<[u8; 3]>,
    /// Depth along the camera's axis [m], infinite where nothing is, shape [height · width].
    pub depth: Vec<f32>,
    /// Front-most triangle, [`NO_TRIANGLE`] where nothing is, shape [height · width].
    pub triangle: Vec<u32>,
}

/// Colour of a mesh, or of a vertex, without one: mid-grey.
pub const NO_COLOUR: [u8; 3] = [128; 3];

/// Renders a mesh with its vertex colours (sRGB, shape [vertex_count]), unshaded, as a segmenter sees it.
///
/// Colours are interpolated over the triangle, perspective-correct. Without colours (or for vertices beyond their
/// end) the colour is [`NO_COLOUR`]. What lies behind the eye or the image plane is clipped; faces with non-finite
/// corners, without area on the screen or naming missing vertices show nothing; an empty mesh gives an empty image.
pub fn render(mesh: &TriMesh, colours: Option<&[[u8; 3]]>, camera: &Camera) -> Image {
    let points = to_camera(&mesh.vertices, camera);
    let mut buffer = ZBuffer::new(camera.width, camera.height);
    buffer.draw(&points, &mesh.faces, camera, 0);
    let mut colour = vec![[0; 3]; buffer.triangle.len()];
    for (pixel, (&id, out)) in buffer.triangle.iter().zip(&mut colour).enumerate() {
        let Some(face) = mesh.faces.get(id as usize) else { continue };
        let Some(colours) = colours else {
            *out = NO_COLOUR;
            continue;
        };
        let weights = barycentric(&corners(&points, face), centre(pixel, camera.width), camera);
        let corner = face.map(|v| colours.get(v as usize).copied().unwrap_or(NO_COLOUR));
        *out = std::array::from_fn(|k| {
            let mixed: f64 = (0..3).map(|i| weights[i] * f64::from(corner[i][k])).sum();
            (mixed + 0.5) as u8
        });
    }
    let depth = buffer.depths(camera);
    Image { width: camera.width, height: camera.height, colour, depth, triangle: buffer.triangle }
}

/// Positions in camera axes [m], shape [vertex_count].
pub(crate) fn to_camera(vertices: &[Vec3], camera: &Camera) -> Vec<Vec3> {
    vertices.iter().map(|v| camera.world_to_camera * v.push(1.0)).collect()
}

/// Corners of a drawn face (its ids were checked when it was drawn; a missing one would be the origin).
pub(crate) fn corners(points: &[Vec3], face: &[u32; 3]) -> [Vec3; 3] {
    face.map(|v| points.get(v as usize).copied().unwrap_or_default())
}

/// Centre of a pixel [pixels].
pub(crate) fn centre(pixel: usize, width: usize) -> [f64; 2] {
    [(pixel % width) as f64 + 0.5, (pixel / width) as f64 + 0.5]
}

/// Weights of the corners (in camera axes) where the ray through the pixel coordinates meets the triangle's plane,
/// clamped to the triangle: perspective-correct, never negative, sum 1.
pub fn barycentric(corners: &[Vec3; 3], at: [f64; 2], camera: &Camera) -> [f64; 3] {
    let weights = barycentric_unclamped(corners, at, camera).map(|w| w.max(0.0));
    let sum = weights[0] + weights[1] + weights[2];
    if sum > 0.0 && sum.is_finite() { weights.map(|w| w / sum) } else { [1.0 / 3.0; 3] }
}

/// As [`barycentric`] on the whole plane of the triangle: weights may be negative; NaN for a plane seen edge-on.
pub fn barycentric_unclamped(corners: &[Vec3; 3], at: [f64; 2], camera: &Camera) -> [f64; 3] {
    let x = (at[0] - 0.5 * camera.width as f64) / camera.scale;
    let y = (at[1] - 0.5 * camera.height as f64) / camera.scale;
    let [a, b, c] = corners;
    let weights = if camera.perspective {
        // Volumes of the ray with each side: also right for corners behind the eye.
        let ray = Vec3::new(x, y, 1.0);
        [ray.dot(&b.cross(c)), ray.dot(&c.cross(a)), ray.dot(&a.cross(b))]
    } else {
        let area = |p: &Vec3, q: &Vec3| (p.x - x) * (q.y - y) - (q.x - x) * (p.y - y);
        [area(b, c), area(c, a), area(a, b)]
    };
    let sum = weights[0] + weights[1] + weights[2];
    weights.map(|w| w / sum)
}

/// Bits below the pixel.
const SUBPIXEL: i64 = 8;
/// One pixel in snapped units.
const ONE: i64 = 1 << SUBPIXEL;
/// Triangles that reach farther from the image's middle than this [pixels] are cut first: products of snapped
/// coordinates then stay below 2^59.
const GUARD: f64 = (1 << 20) as f64;
/// Nearest depth in front of a perspective eye [m].
const NEAR: f64 = 1e-3;

/// A vertex on the screen.
#[derive(Debug, Clone, Copy, Default)]
struct Snapped {
    x: i32,
    y: i32,
    /// Grows with depth and is linear on the screen: depth itself, or -1/depth in perspective.
    key: f32,
    /// Inside the guard band and in front.
    inside: bool,
}

/// Depth and triangle id per pixel; several meshes may be drawn into one.
#[derive(Debug, Clone)]
pub(crate) struct ZBuffer {
    width: usize,
    height: usize,
    key: Vec<f32>,
    /// Id of the front-most triangle, [`NO_TRIANGLE`] where nothing is.
    pub(crate) triangle: Vec<u32>,
}

impl ZBuffer {
    pub(crate) fn new(width: usize, height: usize) -> Self {
        let count = width * height;
        Self { width, height, key: vec![f32::INFINITY; count], triangle: vec![NO_TRIANGLE; count] }
    }

    /// Depth [m] per pixel, infinite where nothing is.
    pub(crate) fn depths(&self, camera: &Camera) -> Vec<f32> {
        let depth = |k: &f32| if camera.perspective && k.is_finite() { -1.0 / k } else { *k };
        self.key.iter().map(depth).collect()
    }

    /// Draws faces over points in camera axes; face `f` gets the id `first_id + f`.
    pub(crate) fn draw(&mut self, points: &[Vec3], faces: &[[u32; 3]], camera: &Camera, first_id: u32) {
        let screen: Vec<Snapped> = points.iter().map(|p| snap(p, camera)).collect();
        for (f, face) in faces.iter().enumerate() {
            let [Some(a), Some(b), Some(c)] = face.map(|v| screen.get(v as usize)) else { continue };
            let id = first_id + f as u32;
            if a.inside && b.inside && c.inside {
                self.triangle(a, b, c, id);
            } else {
                let polygon = clip(&corners(points, face), camera);
                let ring: Vec<Snapped> = polygon.iter().map(|p| snap(p, camera)).collect();
                for pair in ring.get(1..).unwrap_or_default().windows(2) {
                    self.triangle(&ring[0], &pair[0], &pair[1], id);
                }
            }
        }
    }

    fn triangle(&mut self, a: &Snapped, b: &Snapped, c: &Snapped, id: u32) {
        let (min_x, max_x) = (a.x.min(b.x).min(c.x), a.x.max(b.x).max(c.x));
        let (min_y, max_y) = (a.y.min(b.y).min(c.y), a.y.max(b.y).max(c.y));
        // Pixels whose centres the box holds.
        const HALF: i32 = (ONE / 2) as i32;
        let x0 = ((min_x + HALF - 1) >> SUBPIXEL).max(0);
        let y0 = ((min_y + HALF - 1) >> SUBPIXEL).max(0);
        let x1 = ((max_x - HALF) >> SUBPIXEL).min(self.width as i32 - 1);
        let y1 = ((max_y - HALF) >> SUBPIXEL).min(self.height as i32 - 1);
        if x0 > x1 || y0 > y1 {
            return;
        }
        let area = cross(a, b, i64::from(c.x), i64::from(c.y));
        if area == 0 {
            return;
        }
        let (b, c, area) = if area < 0 { (c, b, -area) } else { (b, c, area) };
        // At the first pixel centre: twice the area towards each side; the corner opposite to the side weighs with it.
        let (px, py) = (i64::from(x0) * ONE + ONE / 2, i64::from(y0) * ONE + ONE / 2);
        let (wa, wb, wc) = (cross(b, c, px, py), cross(c, a, px, py), cross(a, b, px, py));
        let step_x = [c.y - b.y, a.y - c.y, b.y - a.y].map(|d| -i64::from(d) * ONE);
        let step_y = [c.x - b.x, a.x - c.x, b.x - a.x].map(|d| i64::from(d) * ONE);
        let inverse = 1.0 / area as f64;
        let (kb, kc) = (f64::from(b.key - a.key), f64::from(c.key - a.key));
        let mut row_key = f64::from(a.key) + (wb as f64 * kb + wc as f64 * kc) * inverse;
        let key_x = (step_x[1] as f64 * kb + step_x[2] as f64 * kc) * inverse;
        let key_y = (step_y[1] as f64 * kb + step_y[2] as f64 * kc) * inverse;
        // Slivers extrapolate wildly; a triangle's depth never leaves its corners' range.
        let (lowest, highest) = (a.key.min(b.key).min(c.key), a.key.max(b.key).max(c.key));
        let mut row = [wa - owned(b, c), wb - owned(c, a), wc - owned(a, b)];
        for y in y0..=y1 {
            let mut w = row;
            let start = y as usize * self.width;
            let (from, to) = (start + x0 as usize, start + x1 as usize + 1);
            let (keys, ids) = (&mut self.key[from..to], &mut self.triangle[from..to]);
            for (i, (key, id_out)) in keys.iter_mut().zip(ids).enumerate() {
                if (w[0] | w[1] | w[2]) >= 0 {
                    let k = ((row_key + key_x * i as f64) as f32).clamp(lowest, highest);
                    if k < *key {
                        *key = k;
                        *id_out = id;
                    }
                }
                w = std::array::from_fn(|e| w[e] + step_x[e]);
            }
            row = std::array::from_fn(|e| row[e] + step_y[e]);
            row_key += key_y;
        }
    }
}

/// Twice the signed area of (a, b, point).
#[inline(always)]
fn cross(a: &Snapped, b: &Snapped, x: i64, y: i64) -> i64 {
    let (ax, ay) = (i64::from(a.x), i64::from(a.y));
    (i64::from(b.x) - ax) * (y - ay) - (i64::from(b.y) - ay) * (x - ax)
}

/// 0 when the side a → b owns the pixels that lie exactly on it (a top or left side), else 1: they then fall outside.
#[inline(always)]
fn owned(a: &Snapped, b: &Snapped) -> i64 {
    let (dx, dy) = (b.x - a.x, b.y - a.y);
    i64::from(!(dy < 0 || (dy == 0 && dx > 0)))
}

fn snap(p: &Vec3, camera: &Camera) -> Snapped {
    let (s, key, near) =
        if camera.perspective { (camera.scale / p.z, -1.0 / p.z, NEAR) } else { (camera.scale, p.z, 0.0) };
    let (x, y) = (p.x * s, p.y * s);
    // A comparison with NaN is false, so non-finite points are never inside. Cut points may sit on the guard itself.
    let inside = p.z >= near && x.abs() <= GUARD * 1.001 && y.abs() <= GUARD * 1.001 && (key as f32).is_finite();
    if !inside {
        return Snapped::default();
    }
    let fixed = |v: f64, size: usize| ((v + 0.5 * size as f64) * ONE as f64).round() as i32;
    Snapped { x: fixed(x, camera.width), y: fixed(y, camera.height), key: key as f32, inside }
}

/// The part of a triangle (camera axes) in front of the eye and inside the guard band, as a convex ring; empty when
/// nothing is left or a corner is not finite.
fn clip(corners: &[Vec3; 3], camera: &Camera) -> Vec<Vec3> {
    if !corners.iter().all(|c| c.iter().all(|v| v.is_finite())) {
        return Vec::new();
    }
    // Each plane: normal · p + offset >= 0 is kept.
    let g = GUARD / camera.scale;
    let (slope, width) = if camera.perspective { (g, 0.0) } else { (0.0, g) };
    let near = if camera.perspective { NEAR * (1.0 + 1e-9) } else { 0.0 };
    let planes = [
        (Vec3::z(), -near),
        (Vec3::new(1.0, 0.0, slope), width),
        (Vec3::new(-1.0, 0.0, slope), width),
        (Vec3::new(0.0, 1.0, slope), width),
        (Vec3::new(0.0, -1.0, slope), width),
    ];
    let mut ring = corners.to_vec();
    for (normal, offset) in planes {
        let distance = |p: &Vec3| normal.dot(p) + offset;
        let mut kept = Vec::with_capacity(ring.len() + 1);
        for (i, p) in ring.iter().enumerate() {
            let q = &ring[(i + 1) % ring.len()];
            let (dp, dq) = (distance(p), distance(q));
            if dp >= 0.0 {
                kept.push(*p);
            }
            // Always cut from the inner to the outer end: the neighbour across this side finds the same point.
            if dp >= 0.0 && dq < 0.0 {
                kept.push(p + (q - p) * (dp / (dp - dq)));
            } else if dp < 0.0 && dq >= 0.0 {
                kept.push(q + (p - q) * (dq / (dq - dp)));
            }
        }
        ring = kept;
    }
    ring
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cameras::{Projection, frame, look_at};

    /// Image plane z = 0, 1 pixel per metre, pixel (0,0) at the world origin, y down.
    fn flat(width: usize, height: usize) -> Camera {
        let mut m = nalgebra::Matrix3x4::identity();
        m[(0, 3)] = -0.5 * width as f64;
        m[(1, 3)] = -0.5 * height as f64;
        Camera { world_to_camera: m, scale: 1.0, perspective: false, width, height }
    }

    fn noise(seed: u32) -> f64 {
        let mut x = seed.wrapping_mul(2654435761).wrapping_add(977);
        x ^= x >> 15;
        x = x.wrapping_mul(2246822519);
        x ^= x >> 13;
        f64::from(x) / f64::from(u32::MAX)
    }

    fn mesh(points: &[[f64; 3]], faces: &[[u32; 3]]) -> TriMesh {
        TriMesh { vertices: points.iter().map(|p| Vec3::from(*p)).collect(), faces: faces.to_vec() }
    }

    #[test]
    fn a_split_square_covers_each_pixel_exactly_once() {
        // Corners on pixel centres: every side needs the top-left rule.
        let square = mesh(
            &[[1.5, 1.5, 1.0], [5.5, 1.5, 1.0], [5.5, 4.5, 1.0], [1.5, 4.5, 1.0], [3.5, 2.5, 1.0]],
            &[[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]],
        );
        let mut count = vec![0; 64];
        for face in 0..4 {
            for flip in [false, true] {
                let f = square.faces[face];
                let one = TriMesh {
                    vertices: square.vertices.clone(),
                    faces: vec![if flip { [f[1], f[0], f[2]] } else { f }],
                };
                for (c, t) in count.iter_mut().zip(render(&one, None, &flat(8, 8)).triangle) {
                    *c += i32::from(t == 0);
                }
            }
        }
        for y in 0..8 {
            for x in 0..8 {
                // Left and top are owned, right and bottom are not; twice for both orientations.
                let inside = (1..5).contains(&x) && (1..4).contains(&y);
                assert_eq!(count[y * 8 + x], if inside { 2 } else { 0 }, "pixel {x} {y}");
            }
        }
    }

    #[test]
    fn a_random_fan_is_watertight() {
        for trial in 0..20 {
            let n = 24;
            let mut points = vec![[32.0 + noise(trial), 32.0 - noise(trial + 99), 1.0]];
            for i in 0..n {
                let a = f64::from(i) / f64::from(n) * std::f64::consts::TAU;
                let r = 20.0 + 8.0 * noise(1000 * trial + i);
                points.push([32.0 + r * a.cos(), 32.0 + r * a.sin(), 1.0 + noise(i)]);
            }
            let faces: Vec<_> = (0..n).map(|i| [0, 1 + i, 1 + (i + 1) % n]).collect();
            let fan = mesh(&points, &faces);
            let mut count = vec![0; 64 * 64];
            for face in &fan.faces {
                let one = TriMesh { vertices: fan.vertices.clone(), faces: vec![*face] };
                for (c, t) in count.iter_mut().zip(render(&one, None, &flat(64, 64)).triangle) {
                    *c += i32::from(t == 0);
                }
            }
            assert!(count.iter().all(|&c| c <= 1), "a pixel drawn twice");
            for (pixel, &c) in count.iter().enumerate() {
                let p = centre(pixel, 64);
                if (p[0] - 32.5).hypot(p[1] - 31.5) < 17.0 {
                    assert_eq!(c, 1, "hole at {p:?}");
                }
            }
        }
    }

    #[test]
    fn depth_and_colour_equal_a_ray_cast_in_both_projections() {
        let points: Vec<[f64; 3]> =
            (0..30).map(|i| [noise(3 * i) - 0.5, noise(3 * i + 1) - 0.5, 2.0 * noise(3 * i + 2) - 1.0]).collect();
        let faces: Vec<[u32; 3]> = (0..10).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
        let soup = mesh(&points, &faces);
        let colours: Vec<[u8; 3]> =
            (0..30).map(|i| [0, 1, 2].map(|k| (255.0 * noise(500 + 3 * i + k)) as u8)).collect();
        let bounds = soup.bounds().unwrap();
        for projection in [Projection::Orthographic, Projection::Perspective { field_of_view: 1.2 }] {
            let camera = frame(bounds, &Vec3::new(0.3, 0.2, 1.0), projection, 96, 80);
            let image = render(&soup, Some(&colours), &camera);
            let seen = to_camera(&soup.vertices, &camera);
            let mut compared = 0;
            for pixel in 0..96 * 80 {
                let mut best = (f64::INFINITY, NO_TRIANGLE, [0.0; 3]);
                // Pixels near a side may fall either way by the snapping.
                let mut near_side = false;
                for (f, face) in soup.faces.iter().enumerate() {
                    let c = corners(&seen, face);
                    let w = barycentric_unclamped(&c, centre(pixel, 96), &camera);
                    near_side |= w.iter().any(|w| w.abs() < 0.05);
                    if w.iter().all(|&w| w >= 0.0) {
                        let z = (0..3).map(|i| w[i] * c[i].z).sum::<f64>();
                        if z < best.0 {
                            best = (z, f as u32, w);
                        }
                    }
                }
                if near_side {
                    continue;
                }
                compared += 1;
                assert_eq!(image.triangle[pixel], best.1);
                if best.1 == NO_TRIANGLE {
                    assert!(image.depth[pixel].is_infinite() && image.colour[pixel] == [0; 3]);
                    continue;
                }
                // Snapping moves a vertex by up to 1/512 pixel; steep triangles turn that into depth.
                let slope = 3.0 / f64::from(80) / 512.0 * 50.0;
                assert!((f64::from(image.depth[pixel]) - best.0).abs() < slope, "{} {}", image.depth[pixel], best.0);
                let face = soup.faces[best.1 as usize];
                for k in 0..3 {
                    let c: f64 = (0..3).map(|i| best.2[i] * f64::from(colours[face[i] as usize][k])).sum();
                    assert!((c - f64::from(image.colour[pixel][k])).abs() <= 0.51);
                }
            }
            assert!(compared > 1000, "{compared}");
        }
    }

    #[test]
    fn a_floor_through_the_eye_is_clipped_at_the_eye() {
        // A huge floor below the eye reaches far behind it: the lower half of the image sees it, the upper does not.
        let floor = mesh(
            &[[-1e7, -1.0, -1e7], [1e7, -1.0, -1e7], [1e7, -1.0, 1e7], [-1e7, -1.0, 1e7]],
            &[[0, 1, 2], [0, 2, 3]],
        );
        let camera = look_at(&Vec3::zeros(), &-Vec3::z(), &Vec3::y(), 1.5, 64, 64);
        let image = render(&floor, None, &camera);
        for y in 0..64 {
            for x in 0..64 {
                let hit = image.triangle[y * 64 + x] != NO_TRIANGLE;
                assert_eq!(hit, y >= 32, "pixel {x} {y}");
                if y > 40 {
                    let expected = camera.scale / (y as f64 + 0.5 - 32.0);
                    let relative = f64::from(image.depth[y * 64 + x]) / expected - 1.0;
                    assert!(relative.abs() < 1e-3, "pixel {x} {y}: {relative}");
                }
            }
        }
    }

    #[test]
    fn bad_meshes_show_nothing_and_do_not_panic() {
        let camera = frame((Vec3::zeros(), Vec3::new(1.0, 1.0, 1.0)), &Vec3::z(), Projection::Orthographic, 16, 16);
        let empty = TriMesh::default();
        assert!(render(&empty, None, &camera).triangle.iter().all(|&t| t == NO_TRIANGLE));
        let bad = mesh(
            &[
                [0.0; 3],
                [1.0, f64::NAN, 0.0],
                [0.0, 1.0, 0.0],
                [f64::INFINITY, 0.0, 0.0],
                [1.0, 0.0, 0.0],
                [1e300, 0.0, 0.0],
            ],
            &[[0, 1, 2], [0, 2, 3], [0, 0, 2], [0, 2, 77], [0, 4, 4], [5, 5, 5], [0, 5, 2]],
        );
        for projection in [Projection::Orthographic, Projection::Perspective { field_of_view: 0.8 }] {
            let camera = frame((Vec3::zeros(), Vec3::new(1.0, 1.0, 1.0)), &Vec3::z(), projection, 16, 16);
            let image = render(&bad, Some(&[[1, 2, 3]]), &camera);
            assert!(image.triangle.iter().all(|&t| t == NO_TRIANGLE || t == 6));
            assert!(image.depth.iter().all(|d| !d.is_nan()));
        }
        let none = Camera { width: 0, height: 0, ..camera };
        assert!(render(&bad, None, &none).colour.is_empty());
    }

    #[test]
    fn equal_depths_go_to_the_first_and_hidden_ones_stay_hidden() {
        let p = [[0.0, 0.0, 2.0], [8.0, 0.0, 2.0], [0.0, 8.0, 2.0], [0.0, 0.0, 1.0], [4.0, 0.0, 1.0], [0.0, 4.0, 1.0]];
        let image = render(&mesh(&p, &[[0, 1, 2], [2, 1, 0], [3, 4, 5]]), None, &flat(8, 8));
        assert_eq!((image.triangle[0], image.triangle[6]), (2, 0));
        assert_eq!((image.depth[0], image.depth[6]), (1.0, 2.0));
    }
}
