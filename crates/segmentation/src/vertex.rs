//! `type = "vertex"`: the labels that a scan already carries on its vertices.

use crate::view;
use caphy_core::files::Files;
use caphy_core::scan::Label;
use caphy_core::segmenter::{NO_TRIANGLE, Segmenter, SegmenterSpec, View};
use caphy_core::{Error, Result};
use serde::{Deserialize, Serialize};

/// Gives each pixel the stored label ([`Scan::labels`](caphy_core::scan::Scan::labels)) of the corner nearest to it in
/// the image.
///
/// # Errors
/// [`Error::Mesh`] naming the scan when it has no labels, [`Error::Length`] when their number is not the vertices',
/// [`Error::Mesh`] when the triangle image names a face or vertex that the scan lacks.
#[derive(Debug, Clone, Copy, Default)]
pub struct SegmenterVertex;

impl Segmenter for SegmenterVertex {
    fn segment(&self, view: &View<'_>, labels: &mut [Label]) -> Result<()> {
        view::check(view, labels)?;
        let scan = view.scan;
        let stored = scan.labels.as_deref().ok_or_else(|| {
            Error::mesh(
                &scan.name,
                "vertex labels",
                "the scan stores none, but the segmenter `vertex` reads them",
                "store a `label` property per vertex (0 body, 1 upper, 2 lower) in the PLY, or use `type = \"colour\"`",
            )
        })?;
        let what = format!("vertex labels of scan `{}` [vertex_count]", scan.name);
        Error::check_length(&what, scan.mesh.vertices.len(), stored.len())?;
        for (pixel, (&id, label)) in view.triangle.iter().zip(labels).enumerate() {
            *label = Label::Ignore;
            if id == NO_TRIANGLE {
                continue;
            }
            let missing = |element: String| {
                let problem = format!("view {} shows it at pixel {pixel}, but the scan has no such", view.index);
                Error::mesh(&scan.name, element, problem, "render the view from the same mesh")
            };
            let face = scan.mesh.faces.get(id as usize).ok_or_else(|| missing(format!("face {id}")))?;
            let x = (pixel % view.camera.width) as f64 + 0.5;
            let y = (pixel / view.camera.width) as f64 + 0.5;
            let mut nearest = f64::INFINITY;
            for &v in face {
                let point = scan.mesh.vertices.get(v as usize).ok_or_else(|| missing(format!("vertex {v}")))?;
                let (px, py, _) = view.camera.project(point);
                let distance = (px - x).powi(2) + (py - y).powi(2);
                if distance < nearest {
                    nearest = distance;
                    *label = stored[v as usize];
                }
            }
        }
        Ok(())
    }
}

/// `[segmenter]` with `type = "vertex"`: no other keys.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SegmenterVertexSpec {}

#[typetag::serde(name = "vertex")]
impl SegmenterSpec for SegmenterVertexSpec {
    fn build(&self, _files: &dyn Files) -> Result<Box<dyn Segmenter>> {
        Ok(Box::new(SegmenterVertex))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use caphy_core::files::Disk;
    use caphy_core::scan::Scan;
    use caphy_core::{TriMesh, Vec3};
    use caphy_render::{Projection, frame, render};

    fn triangle() -> Scan {
        let vertices = vec![Vec3::zeros(), Vec3::x(), Vec3::y()];
        let labels = Some(vec![Label::Body, Label::Upper, Label::Lower]);
        Scan { name: "one".into(), mesh: TriMesh { vertices, faces: vec![[0, 1, 2]] }, colours: None, labels }
    }

    fn segment(scan: &Scan, faces: &[[u32; 3]]) -> Result<Vec<Label>> {
        let bounds = (Vec3::zeros(), Vec3::new(1.0, 1.0, 0.0));
        let camera = frame(bounds, &Vec3::z(), Projection::Orthographic, 40, 40);
        let image = render(&TriMesh { vertices: triangle().mesh.vertices, faces: faces.to_vec() }, None, &camera);
        let view = View {
            scan,
            index: 0,
            count: 1,
            camera: &camera,
            colour: &image.colour,
            depth: &image.depth,
            triangle: &image.triangle,
        };
        let mut labels = vec![Label::Body; 40 * 40];
        SegmenterVertex.segment(&view, &mut labels)?;
        Ok(labels)
    }

    #[test]
    fn each_pixel_has_its_nearest_corners_label() {
        let labels = segment(&triangle(), &[[0, 1, 2]]).unwrap();
        assert_eq!(labels[0], Label::Ignore);
        assert_eq!(
            (labels[35 * 40 + 4], labels[35 * 40 + 30], labels[6 * 40 + 3]),
            (Label::Body, Label::Upper, Label::Lower)
        );
        let count = |l| labels.iter().filter(|x| **x == l).count();
        // Bisectors cut the right triangle into a square of half its area and two equal quarters.
        assert!(count(Label::Body).abs_diff(2 * count(Label::Upper)) < 60, "{}", count(Label::Body));
        assert!(count(Label::Upper).abs_diff(count(Label::Lower)) < 40);
    }

    #[test]
    fn scans_without_labels_or_with_too_few_are_named() {
        let mut scan = triangle();
        scan.labels = None;
        let text = segment(&scan, &[[0, 1, 2]]).unwrap_err().to_string();
        assert!(text.contains("`one`") && text.contains("colour"), "{text}");
        scan.labels = Some(vec![Label::Body]);
        assert!(segment(&scan, &[[0, 1, 2]]).unwrap_err().to_string().contains("expected 3"));
        let other = segment(&triangle(), &[[0, 2, 2], [0, 1, 2]]).unwrap_err().to_string();
        assert!(other.contains("face 1"), "{other}");
    }

    #[test]
    fn the_table_parses_and_refuses_unknown_keys() {
        let spec: Box<dyn SegmenterSpec> = toml::from_str("type = \"vertex\"").unwrap();
        assert!(spec.build(&Disk).is_ok());
        let wrong = toml::from_str::<Box<dyn SegmenterSpec>>("type = \"vertex\"\nviews = 3").unwrap_err().to_string();
        assert!(wrong.contains("views"), "{wrong}");
        let unknown = toml::from_str::<Box<dyn SegmenterSpec>>("type = \"verteks\"").unwrap_err().to_string();
        assert!(unknown.contains("vertex") && unknown.contains("colour"), "{unknown}");
    }
}
