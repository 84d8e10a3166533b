//! A garment as it is seen from around: normals and brightness per pixel, of a scan and of a figure by the same cameras.

use super::perceptual::{Features, Perceptual};
use super::similarity::{SMALLEST, ms_ssim};
use crate::pictures::Dressed;
use crate::scene::label_of;
use caphy_core::scan::LabelledPoints;
use caphy_core::segmenter::Camera;
use caphy_core::{Error, Result, TriMesh, Vec3};
use caphy_garment::template::GarmentKind;
use caphy_render::raster::{barycentric, render};
use caphy_render::{Projection, frame};
use std::f64::consts::TAU;

/// Number of cameras, evenly around the person.
const VIEWS: usize = 6;
/// Width and height of a view [pixels].
const SIZE: usize = 224;
/// How much higher than the person cameras stand, to their distance.
const HEIGHT: f64 = 0.15;
/// Cameras stand off by this much more than the garment needs [m]: rays are parallel.
const FAR_AWAY: f64 = 3.0;
/// Where the light comes from, in camera axes (x right, y down, z away): over the left shoulder.
const LIGHT: [f64; 3] = [-0.4, -0.5, -0.77];

const _: () = assert!(SIZE >= SMALLEST);

/// One garment in one view.
struct View {
    /// Normals in camera axes towards the eye, 0 where the garment is not shown, shape [height · width].
    normals: Vec<[f32; 3]>,
    /// Lambert's brightness in [0, 1], 0 where the garment is not shown.
    brightness: Vec<f32>,
}

/// Views of one garment of a scan.
pub struct ScanViews<'n> {
    cameras: Vec<Camera>,
    views: Vec<View>,
    /// What a network sees in the views.
    seen: Option<(&'n Perceptual, Vec<Features>)>,
}

impl<'n> ScanViews<'n> {
    /// Cameras around `bounds` of the garment [m], and what they see of the scan: a triangle with two corners of the garment is its.
    /// `network` is asked, too.
    ///
    /// # Errors
    /// [`Error::Length`] for another number of labels than vertices; those of [`Perceptual::features`].
    pub fn new(
        kind: GarmentKind,
        surface: &TriMesh,
        points: &LabelledPoints,
        bounds: (Vec3, Vec3),
        network: Option<&'n Perceptual>,
    ) -> Result<Self> {
        Error::check_length("labels of the scan", surface.vertices.len(), points.labels.len())?;
        let label = label_of(kind);
        let cameras: Vec<Camera> = (0..VIEWS)
            .map(|i| {
                let (sin, cos) = (TAU * i as f64 / VIEWS as f64).sin_cos();
                let mut camera = frame(bounds, &Vec3::new(sin, HEIGHT, cos), Projection::Orthographic, SIZE, SIZE);
                // An arm in front of the garment is nearer than its bounds, and hides it nevertheless.
                camera.world_to_camera[(2, 3)] += FAR_AWAY;
                camera
            })
            .collect();
        let own = |f: usize| surface.faces[f].iter().filter(|&&v| points.labels[v as usize] == label).count() >= 2;
        let normals = surface.vertex_normals();
        let views: Vec<View> = cameras.iter().map(|camera| look(surface, &normals, own, camera)).collect();
        let seen = network.map(|network| {
            let features = views.iter().map(|view| network.features(&view.brightness, SIZE, SIZE));
            Ok::<_, Error>((network, features.collect::<Result<Vec<_>>>()?))
        });
        Ok(Self { cameras, views, seen: seen.transpose()? })
    }

    /// Distances of a figure's garment from the scan's [1]: of normal maps, and 1 − MS-SSIM of renderings.
    pub fn distances(&self, figure: &Dressed<'_>, garment: usize) -> [f64; 2] {
        let (mut apart, mut pixels, mut likeness) = (0.0, 0usize, 0.0);
        for (seen, scan) in self.of(figure, garment).iter().zip(&self.views) {
            for (a, b) in scan.normals.iter().zip(&seen.normals) {
                if *a != [0.0; 3] || *b != [0.0; 3] {
                    apart += (0..3).map(|k| f64::from(a[k] - b[k]).powi(2)).sum::<f64>().sqrt();
                    pixels += 1;
                }
            }
            // The size is large enough.
            likeness += ms_ssim(&scan.brightness, &seen.brightness, SIZE, SIZE).unwrap_or(0.0);
        }
        [apart / pixels.max(1) as f64, 1.0 - likeness / VIEWS as f64]
    }

    /// Distance of the same renderings by the network's features, mean over views; none without a network.
    ///
    /// # Errors
    /// Those of [`Perceptual::features`].
    pub fn perceptual(&self, figure: &Dressed<'_>, garment: usize) -> Result<Option<f64>> {
        let Some((network, scan)) = &self.seen else { return Ok(None) };
        let mut sum = 0.0;
        for (view, scan) in self.of(figure, garment).iter().zip(scan) {
            sum += network.features(&view.brightness, SIZE, SIZE)?.distance(scan)?;
        }
        Ok(Some(sum / VIEWS as f64))
    }

    /// What the cameras see of a figure's garment.
    fn of(&self, figure: &Dressed<'_>, garment: usize) -> Vec<View> {
        // What is in front of the garment hides it.
        let mut all = TriMesh::default();
        let mut normals = Vec::new();
        let mut own = 0..0;
        let parts = std::iter::once(figure.body).chain(&figure.garments);
        for (i, part) in parts.enumerate() {
            let (first, start) = (all.vertices.len() as u32, all.faces.len());
            all.vertices.extend_from_slice(&part.vertices);
            normals.extend(part.vertex_normals());
            all.faces.extend(part.faces.iter().map(|f| f.map(|v| v + first)));
            if i == garment + 1 {
                own = start..all.faces.len();
            }
        }
        self.cameras.iter().map(|camera| look(&all, &normals, |f| own.contains(&f), camera)).collect()
    }
}

/// What a camera sees of the faces that are the garment's `own`.
fn look(mesh: &TriMesh, normals: &[Vec3], own: impl Fn(usize) -> bool, camera: &Camera) -> View {
    let image = render(mesh, None, camera);
    let rotation = camera.world_to_camera.fixed_columns::<3>(0).into_owned();
    let light = Vec3::from(LIGHT).normalize();
    let mut view = View { normals: vec![[0.0; 3]; image.triangle.len()], brightness: vec![0.0; image.triangle.len()] };
    for (pixel, &id) in image.triangle.iter().enumerate() {
        let Some(face) = mesh.faces.get(id as usize).filter(|_| own(id as usize)) else { continue };
        let corners = face.map(|v| camera.world_to_camera * mesh.vertices[v as usize].push(1.0));
        let at = [(pixel % camera.width) as f64 + 0.5, (pixel / camera.width) as f64 + 0.5];
        let weights = barycentric(&corners, at, camera);
        let mixed: Vec3 = (0..3).map(|i| weights[i] * normals[face[i] as usize]).sum();
        let Some(mut normal) = (rotation * mixed).try_normalize(1e-12) else { continue };
        // Cloth has two sides.
        if normal.z > 0.0 {
            normal = -normal;
        }
        view.normals[pixel] = [normal.x as f32, normal.y as f32, normal.z as f32];
        view.brightness[pixel] = (0.2 + 0.8 * normal.dot(&light).max(0.0)) as f32;
    }
    view
}

#[cfg(test)]
mod tests {
    use super::*;
    use caphy_core::scan::Label;

    /// A closed box of half sizes, outward faces.
    fn block(half: Vec3, middle: Vec3) -> TriMesh {
        let vertices =
            (0..8).map(|i| middle + Vec3::from_fn(|k, _| if i >> k & 1 == 0 { -half[k] } else { half[k] })).collect();
        let quads: [[u32; 4]; 6] = [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];
        let faces = quads.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect();
        TriMesh { vertices, faces }
    }

    #[test]
    fn what_hides_the_garment_and_where_it_is_not_count() {
        let scan = block(Vec3::new(0.2, 0.3, 0.1), Vec3::zeros());
        let points = LabelledPoints {
            points: scan.vertices.clone(),
            normals: scan.vertex_normals(),
            labels: vec![Label::Upper; 8],
        };
        let views = ScanViews::new(GarmentKind::Upper, &scan, &points, scan.bounds().unwrap(), None).unwrap();
        let of =
            |body: &TriMesh, garment: &TriMesh| views.distances(&Dressed { body, garments: vec![garment.clone()] }, 0);
        let nothing = TriMesh::default();
        assert!(of(&nothing, &scan).iter().all(|d| d.abs() < 1e-9), "{:?}", of(&nothing, &scan));
        // A body inside changes nothing, one around it hides all of it: then every normal is a unit away from 0.
        let (inside, around) = (block(Vec3::repeat(0.05), Vec3::zeros()), block(Vec3::repeat(0.5), Vec3::zeros()));
        assert_eq!(of(&inside, &scan), of(&nothing, &scan));
        let [hidden, unlike] = of(&around, &scan);
        assert!((hidden - 1.0).abs() < 1e-6 && unlike > 0.3, "{hidden} {unlike}");
        // The same block turned inside out looks the same.
        let turned = TriMesh { faces: scan.faces.iter().map(|&[a, b, c]| [a, c, b]).collect(), ..scan.clone() };
        assert!(of(&nothing, &turned)[0] < 1e-6);
        let [moved, _] = of(&nothing, &block(Vec3::new(0.2, 0.3, 0.1), Vec3::new(0.05, 0.0, 0.0)));
        assert!(moved > 0.05 && moved < hidden, "{moved}");
    }
}
