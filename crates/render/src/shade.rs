//! Pictures for people: several meshes in one z-buffer, smooth two-sided shading like unglazed clay.
//!
//! A soft key light from the upper left and a weak fill light go with the camera, a sky light with the world; creases
//! are darkened by screen-space ambient occlusion; a soft contact shadow says where the ground is.

use crate::cameras::magnify;
use crate::colours::{linear_to_srgb, srgb_to_linear};
use crate::raster::{NO_COLOUR, ZBuffer, barycentric, centre, corners, to_camera};
use crate::rgb::Rgb;
use caphy_core::segmenter::Camera;
use caphy_core::{TriMesh, Vec3};
use nalgebra::{Matrix3, Matrix3x4, Vector3};
use rayon::prelude::*;

/// A colour that goes well as bare skin.
pub const CLAY_SKIN: [u8; 3] = [214, 180, 158];
/// A colour that goes well as an upper garment.
pub const CLAY_UPPER: [u8; 3] = [92, 134, 178];
/// A colour that goes well as a lower garment.
pub const CLAY_LOWER: [u8; 3] = [118, 122, 132];
/// Plain clay.
pub const CLAY: [u8; 3] = [196, 188, 178];

/// The colour of a mesh.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Paint<'a> {
    /// One sRGB colour.
    Uniform([u8; 3]),
    /// An sRGB colour per vertex, shape [vertex_count], interpolated; missing ones are [`NO_COLOUR`].
    PerVertex(&'a [[u8; 3]]),
}

/// One mesh of a picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Layer<'a> {
    /// The surface [m].
    pub mesh: &'a TriMesh,
    /// Its colour.
    pub colour: Paint<'a>,
    /// Whether corners share normals (smooth) or each face has its own (flat: shows the triangles).
    pub smooth: bool,
}

impl<'a> Layer<'a> {
    /// A smooth layer of one colour.
    pub fn uniform(mesh: &'a TriMesh, colour: [u8; 3]) -> Self {
        Self { mesh, colour: Paint::Uniform(colour), smooth: true }
    }
    /// A smooth layer with a colour per vertex.
    pub fn per_vertex(mesh: &'a TriMesh, colours: &'a [[u8; 3]]) -> Self {
        Self { mesh, colour: Paint::PerVertex(colours), smooth: true }
    }
}

/// Several meshes seen by one camera.
#[derive(Debug, Clone)]
pub struct Picture<'a> {
    /// The eye; its size is the picture's.
    pub camera: Camera,
    /// The meshes; of two at the same depth the earlier shows.
    pub layers: Vec<Layer<'a>>,
    /// Height of the ground [m], which catches a soft shadow; none by default.
    pub ground: Option<f64>,
    /// Background colours (sRGB) at the top and at the bottom.
    pub background: [[u8; 3]; 2],
    /// Samples along each side of a pixel (2 gives 2 × 2), 1 to 4.
    pub supersampling: usize,
    /// Radius of the crease darkening [m]; 0 turns it off.
    pub crease_radius: f64,
}

impl<'a> Picture<'a> {
    /// A picture with the usual light background, 2 × 2 samples, 8 cm crease darkening and no ground.
    pub fn new(camera: Camera, layers: Vec<Layer<'a>>) -> Self {
        let background = [[250, 250, 251], [226, 228, 232]];
        Self { camera, layers, ground: None, background, supersampling: 2, crease_radius: 0.08 }
    }

    /// The same with a ground at height `y` [m].
    pub fn with_ground(mut self, y: f64) -> Self {
        self.ground = Some(y);
        self
    }

    /// Draws the picture.
    pub fn draw(&self) -> Rgb {
        let factor = self.supersampling.clamp(1, 4);
        let camera = magnify(&self.camera, factor);
        let mut buffer = ZBuffer::new(camera.width, camera.height);
        let mut first = 0;
        let layers: Vec<Prepared> = self
            .layers
            .iter()
            .map(|layer| {
                let prepared = Prepared::new(layer, &camera, first);
                buffer.draw(&prepared.points, &layer.mesh.faces, &camera, first);
                first += layer.mesh.faces.len() as u32;
                prepared
            })
            .collect();
        let surface: Vec<Option<Surface>> = (0..buffer.triangle.len())
            .into_par_iter()
            .map(|pixel| surface_at(&layers, &camera, buffer.triangle[pixel], pixel))
            .collect();
        let scene = Scene {
            camera: &camera,
            surface: &surface,
            crease_radius: self.crease_radius as f32,
            spiral: std::array::from_fn(|i| {
                let (sin, cos) = (2.399_963 * (i as f32 + 0.5)).sin_cos();
                [cos, sin]
            }),
            sky: direction(&camera, &Vec3::y()),
            ground: self.ground.and_then(|y| Ground::new(y, &self.layers, &camera)),
            background: self.background.map(|c| c.map(srgb_to_linear)),
        };
        let light: Vec<[f32; 3]> = (0..surface.len()).into_par_iter().map(|pixel| scene.light(pixel)).collect();
        let (width, height) = (self.camera.width, self.camera.height);
        let pixels = (0..width * height)
            .into_par_iter()
            .map(|pixel| {
                let (x, y) = (pixel % width * factor, pixel / width * factor);
                let mut sum = [0.0; 3];
                for row in 0..factor {
                    let start = (y + row) * camera.width + x;
                    for sample in &light[start..start + factor] {
                        sum = std::array::from_fn(|k| sum[k] + sample[k]);
                    }
                }
                sum.map(|s: f32| linear_to_srgb(s / (factor * factor) as f32))
            })
            .collect();
        Rgb { width, height, pixels }
    }
}

/// A layer in camera axes.
struct Prepared<'a> {
    layer: Layer<'a>,
    points: Vec<Vec3>,
    normals: Vec<Vec3>,
    first: u32,
}

impl<'a> Prepared<'a> {
    fn new(layer: &Layer<'a>, camera: &Camera, first: u32) -> Self {
        let points = to_camera(&layer.mesh.vertices, camera);
        let mut normals = vec![Vec3::zeros(); if layer.smooth { points.len() } else { 0 }];
        for face in layer.mesh.faces.iter().filter(|_| layer.smooth) {
            let [a, b, c] = corners(&points, face);
            let n = (b - a).cross(&(c - a));
            // Faces with non-finite corners are never drawn and must not spoil their neighbours.
            for &id in face.iter().filter(|_| n.iter().all(|v| v.is_finite())) {
                if let Some(sum) = normals.get_mut(id as usize) {
                    *sum += n;
                }
            }
        }
        for n in &mut normals {
            *n = n.try_normalize(0.0).unwrap_or_default();
        }
        Self { layer: *layer, points, normals, first }
    }
}

/// What a sample of a pixel sees, in camera axes.
#[derive(Clone, Copy)]
struct Surface {
    point: Vector3<f32>,
    normal: Vector3<f32>,
    albedo: [f32; 3],
}

fn surface_at(layers: &[Prepared], camera: &Camera, id: u32, pixel: usize) -> Option<Surface> {
    let layer = layers.iter().rev().find(|l| l.first <= id)?;
    let face = layer.layer.mesh.faces.get((id - layer.first) as usize)?;
    let triangle = corners(&layer.points, face);
    let weights = barycentric(&triangle, centre(pixel, camera.width), camera);
    let mix = |v: [Vec3; 3]| v[0] * weights[0] + v[1] * weights[1] + v[2] * weights[2];
    let point = mix(triangle);
    let flat = (triangle[1] - triangle[0]).cross(&(triangle[2] - triangle[0]));
    let smooth = if layer.layer.smooth { mix(corners(&layer.normals, face)) } else { flat };
    let normal = [smooth, flat].iter().find_map(|n| n.try_normalize(1e-12)).unwrap_or_else(|| -Vec3::z());
    // Two-sided: the side that the eye sees.
    let sight = if camera.perspective { point } else { Vec3::z() };
    let back = flat.dot(&sight) > 0.0;
    let normal = if back { -normal } else { normal };
    let albedo = match layer.layer.colour {
        Paint::Uniform(c) => c.map(srgb_to_linear),
        Paint::PerVertex(colours) => {
            let c = face.map(|v| colours.get(v as usize).copied().unwrap_or(NO_COLOUR).map(srgb_to_linear));
            std::array::from_fn(|k| (0..3).map(|i| weights[i] as f32 * c[i][k]).sum())
        }
    };
    // An inside is a little darker, so that hems and holes are read as such.
    let albedo = if back { albedo.map(|a| a * 0.72) } else { albedo };
    Some(Surface { point: point.cast(), normal: normal.cast(), albedo })
}

/// A world direction in camera axes.
fn direction(camera: &Camera, world: &Vec3) -> Vector3<f32> {
    (camera.world_to_camera.fixed_columns::<3>(0) * world).cast()
}

/// Samples of the crease darkening: (x, y) in units of the radius, a golden-angle spiral. Four pixels of a 2 × 2 block
/// use a quarter each, so that supersampling averages the whole spiral.
const CREASE_SAMPLES: usize = 48;

struct Scene<'a> {
    camera: &'a Camera,
    surface: &'a [Option<Surface>],
    crease_radius: f32,
    /// (cos, sin) of each crease sample.
    spiral: [[f32; 2]; CREASE_SAMPLES],
    sky: Vector3<f32>,
    ground: Option<Ground>,
    background: [[f32; 3]; 2],
}

impl Scene<'_> {
    /// Linear light of one sample.
    fn light(&self, pixel: usize) -> [f32; 3] {
        let Some(s) = &self.surface[pixel] else { return self.behind(pixel) };
        // Towards the lights, camera axes (y down, z away from the eye).
        let key = Vector3::new(-0.45f32, -0.62, -0.64);
        let fill = Vector3::new(0.75f32, -0.05, -0.66);
        // Soft: the light reaches a little around the edge, as from a large window.
        let soft = |l: &Vector3<f32>| ((s.normal.dot(l) + 0.25) / 1.25).max(0.0);
        let sky = 0.5 + 0.5 * s.normal.dot(&self.sky);
        let open = self.openness(pixel, s);
        let amount = 0.8 * soft(&key) * (0.55 + 0.45 * open) + (0.16 * soft(&fill) + 0.14 + 0.16 * sky) * open;
        s.albedo.map(|a| a * amount)
    }

    /// 1 where nothing near covers the surface, towards 0 in creases.
    fn openness(&self, pixel: usize, s: &Surface) -> f32 {
        if self.crease_radius <= 0.0 {
            return 1.0;
        }
        let (width, height) = (self.camera.width, self.camera.height);
        let (px, py) = (pixel % width, pixel / width);
        let scale = self.camera.scale as f32 / if self.camera.perspective { s.point.z } else { 1.0 };
        let reach = (self.crease_radius * scale).clamp(2.0, 0.25 * width as f32);
        let part = (px & 1) + 2 * (py & 1);
        let mut covered = 0.0;
        for i in 0..CREASE_SAMPLES / 4 {
            let n = (4 * i + part) as f32 + 0.5;
            let radius = reach * n / CREASE_SAMPLES as f32;
            let [cos, sin] = self.spiral[4 * i + part];
            let (x, y) = (px as f32 + radius * cos, py as f32 + radius * sin);
            if x < 0.0 || y < 0.0 || x >= width as f32 || y >= height as f32 {
                continue;
            }
            let Some(Some(other)) = self.surface.get(y as usize * width + x as usize) else { continue };
            let to = other.point - s.point;
            let distance = to.norm();
            let near = 1.0 - (distance / self.crease_radius).powi(2);
            if near > 0.0 && distance > 0.0 {
                covered += near * (to.dot(&s.normal) / distance - 0.12).max(0.0);
            }
        }
        (1.0 - 2.2 * covered / (CREASE_SAMPLES / 4) as f32).clamp(0.15, 1.0)
    }

    fn behind(&self, pixel: usize) -> [f32; 3] {
        let t = (pixel / self.camera.width) as f32 / self.camera.height.max(2) as f32;
        let shadow = self.ground.as_ref().map_or(0.0, |g| g.shadow(self.camera, pixel));
        std::array::from_fn(|k| {
            let c = self.background[0][k] * (1.0 - t) + self.background[1][k] * t;
            c * (1.0 - 0.55 * shadow)
        })
    }
}

/// A map of how near the meshes come to the ground, blurred: the contact shadow.
struct Ground {
    height: f64,
    origin: [f64; 2],
    cell: f64,
    size: usize,
    shadow: Vec<f32>,
    /// Where the picture's eye is [m], and its axes back to the world.
    eye: Vec3,
    turn: Matrix3<f64>,
}

impl Ground {
    const SIZE: usize = 192;
    /// Height over the ground at which a surface no longer darkens it [m].
    const FADE: f32 = 0.35;

    /// `None` without vertices.
    fn new(height: f64, layers: &[Layer], camera: &Camera) -> Option<Self> {
        // From below, or edge-on, there is no ground to see.
        let above = if camera.perspective { camera.eye().y > height } else { camera.world_to_camera[(2, 1)] < -1e-6 };
        let bounds = layers.iter().filter_map(|l| l.mesh.bounds());
        let (lo, hi) = bounds.reduce(|a, b| (a.0.inf(&b.0), a.1.sup(&b.1)))?;
        let finite = lo.iter().chain(hi.iter()).all(|v| v.is_finite());
        if !above || !finite {
            return None;
        }
        let extent = (hi.x - lo.x).max(hi.z - lo.z).max(1e-3);
        let margin = 0.3 * extent.min(1.0);
        let cell = (extent + 2.0 * margin) / Self::SIZE as f64;
        let half = 0.5 * cell * Self::SIZE as f64;
        let origin = [0.5 * (lo.x + hi.x) - half, 0.5 * (lo.z + hi.z) - half];
        // Seen from the ground upwards: image x = world x, image y = world z, depth = height.
        let world_to_camera = Matrix3x4::new(
            1.0,
            0.0,
            0.0,
            -origin[0] - half, //
            0.0,
            0.0,
            1.0,
            -origin[1] - half, //
            0.0,
            1.0,
            0.0,
            1e-3 - height,
        );
        let below =
            Camera { world_to_camera, scale: 1.0 / cell, perspective: false, width: Self::SIZE, height: Self::SIZE };
        let mut buffer = ZBuffer::new(Self::SIZE, Self::SIZE);
        for layer in layers {
            buffer.draw(&to_camera(&layer.mesh.vertices, &below), &layer.mesh.faces, &below, 0);
        }
        let near = |d: &f32| if d.is_finite() { (1.0 - d / Self::FADE).max(0.0).powi(2) } else { 0.0 };
        let contact: Vec<f32> = buffer.depths(&below).iter().map(near).collect();
        // Sharp right at the contact, wide around it.
        let tight = blurred(&contact, Self::SIZE, (0.012 / cell).ceil() as usize);
        let wide = blurred(&contact, Self::SIZE, (0.05 / cell).ceil() as usize);
        let shadow = tight.iter().zip(&wide).map(|(t, w)| 0.45 * t + 0.9 * w).collect();
        let turn = camera.world_to_camera.fixed_columns::<3>(0).transpose();
        Some(Self { height, origin, cell, size: Self::SIZE, shadow, eye: camera.eye(), turn })
    }

    /// Darkness in [0, 1] of the ground that a pixel sees.
    fn shadow(&self, camera: &Camera, pixel: usize) -> f32 {
        let at = centre(pixel, camera.width);
        let x = (at[0] - 0.5 * camera.width as f64) / camera.scale;
        let y = (at[1] - 0.5 * camera.height as f64) / camera.scale;
        let (eye, turn) = (self.eye, self.turn);
        let (from, along) = if camera.perspective {
            (eye, turn * Vec3::new(x, y, 1.0))
        } else {
            (eye + turn * Vec3::new(x, y, 0.0), turn * Vec3::z())
        };
        let t = (self.height - from.y) / along.y;
        if !(t > 0.0 && t.is_finite()) {
            return 0.0;
        }
        let hit = from + along * t;
        let (u, v) = ((hit.x - self.origin[0]) / self.cell - 0.5, (hit.z - self.origin[1]) / self.cell - 0.5);
        let last = (self.size - 1) as f64;
        if !(u >= 0.0 && v >= 0.0 && u < last && v < last) {
            return 0.0;
        }
        let (i, j) = (u as usize, v as usize);
        let (fu, fv) = ((u - i as f64) as f32, (v - j as f64) as f32);
        let s = |i: usize, j: usize| self.shadow[j * self.size + i];
        let low = s(i, j) * (1.0 - fu) + s(i + 1, j) * fu;
        let high = s(i, j + 1) * (1.0 - fu) + s(i + 1, j + 1) * fu;
        (low * (1.0 - fv) + high * fv).min(1.0)
    }
}

/// Three box blurs along both axes (nearly a Gaussian), zero outside.
fn blurred(values: &[f32], size: usize, radius: usize) -> Vec<f32> {
    let mut from = values.to_vec();
    let mut to = vec![0.0; from.len()];
    for pass in 0..6 {
        let along = |line: usize, i: usize| if pass % 2 == 0 { line * size + i } else { i * size + line };
        for line in 0..size {
            for i in 0..size {
                let (a, b) = (i.saturating_sub(radius), (i + radius).min(size - 1));
                let sum: f32 = (a..=b).map(|j| from[along(line, j)]).sum();
                to[along(line, i)] = sum / (2 * radius + 1) as f32;
            }
        }
        std::mem::swap(&mut from, &mut to);
    }
    from
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cameras::{Projection, frame};

    fn ball(centre: Vec3, radius: f64) -> TriMesh {
        let (rings, sectors) = (24u32, 32u32);
        let mut mesh = TriMesh::default();
        for r in 0..=rings {
            for s in 0..sectors {
                let a = std::f64::consts::PI * f64::from(r) / f64::from(rings);
                let b = std::f64::consts::TAU * f64::from(s) / f64::from(sectors);
                mesh.vertices.push(centre + radius * Vec3::new(a.sin() * b.sin(), a.cos(), a.sin() * b.cos()));
            }
        }
        for r in 0..rings {
            for s in 0..sectors {
                let id = |r, s| r * sectors + s % sectors;
                mesh.faces.push([id(r, s), id(r + 1, s), id(r + 1, s + 1)]);
                mesh.faces.push([id(r, s), id(r + 1, s + 1), id(r, s + 1)]);
            }
        }
        mesh
    }

    fn camera(mesh: &TriMesh) -> Camera {
        frame(mesh.bounds().unwrap(), &Vec3::new(0.2, 0.3, 1.0), Projection::Perspective { field_of_view: 0.5 }, 64, 64)
    }

    fn brightness(c: [u8; 3]) -> i32 {
        c.iter().map(|&v| i32::from(v)).sum()
    }

    #[test]
    fn a_ball_is_lit_from_the_upper_left_and_both_sides_look_alike() {
        let mesh = ball(Vec3::zeros(), 0.5);
        let picture = Picture::new(camera(&mesh), vec![Layer::uniform(&mesh, CLAY)]).draw();
        let at = |x: usize, y: usize| brightness(picture.pixels[y * 64 + x]);
        assert!(at(22, 20) > at(42, 44) + 60);
        // The corner shows the background.
        assert!(at(0, 0) > 700);
        let mut inside_out = mesh.clone();
        inside_out.faces.iter_mut().for_each(|f| f.swap(0, 1));
        let other = Picture::new(camera(&mesh), vec![Layer::uniform(&inside_out, CLAY)]).draw();
        let back = |x: usize, y: usize| brightness(other.pixels[y * 64 + x]);
        // The same shading, only darker: never black.
        assert!(back(22, 20) > back(42, 44) + 40 && back(22, 20) < at(22, 20) && back(32, 32) > 150);
    }

    #[test]
    fn the_nearer_layer_shows_and_the_ground_is_darker_under_it() {
        let (near, far) = (ball(Vec3::new(0.0, 0.0, 0.4), 0.3), ball(Vec3::zeros(), 0.5));
        let red = vec![[255, 0, 0]; near.vertices.len()];
        let layers = vec![Layer::uniform(&far, [0, 0, 255]), Layer::per_vertex(&near, &red)];
        let view =
            frame((Vec3::repeat(-0.9), Vec3::repeat(0.9)), &Vec3::new(0.0, 0.5, 1.0), Projection::Orthographic, 96, 96);
        let plain = Picture::new(view.clone(), layers.clone()).draw();
        let [r, _, b] = plain.pixels[48 * 96 + 48];
        assert!(r > 100 && b < 30);
        let grounded = Picture::new(view, layers).with_ground(-0.5).draw();
        let darkened =
            plain.pixels.iter().zip(&grounded.pixels).filter(|(a, b)| brightness(**a) > brightness(**b) + 20);
        assert!(darkened.count() > 30);
    }

    #[test]
    fn nothing_and_nonsense_give_a_background() {
        let mut mesh = TriMesh { vertices: vec![Vec3::repeat(f64::NAN); 3], faces: vec![[0, 1, 2], [0, 1, 9]] };
        let view = frame((Vec3::zeros(), Vec3::x()), &Vec3::new(0.0, 1.0, 1.0), Projection::Orthographic, 16, 16);
        for _ in 0..2 {
            let picture = Picture::new(view.clone(), vec![Layer::uniform(&mesh, CLAY)]).with_ground(0.0).draw();
            assert!(picture.pixels.iter().all(|p| brightness(*p) > 600));
            mesh = TriMesh::default();
        }
    }
}
