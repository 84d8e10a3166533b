//! The promise of [`Segmenter`], checked on a scan that the kit brings: three coloured, labelled patches side by side.

use super::{Outcome, Verdict, ensure, table_checks, unexpected};
use crate::files::Files;
use crate::scan::{Label, Scan};
use crate::segmenter::{Camera, NO_TRIANGLE, Segmenter, SegmenterSpec, View};
use crate::{Error, Result, TriMesh, Vec3};
use nalgebra::Matrix3x4;
use std::sync::Arc;

/// sRGB of the patches labelled body, upper and lower; a segmenter that goes by colour is checked with this palette.
pub const COLOURS: [[u8; 3]; 3] = [[200, 155, 125], [42, 56, 112], [90, 130, 60]];

/// A segmenter as its table makes it.
pub struct SegmenterSubject {
    /// A valid table: `type` and its keys.
    pub toml: String,
    /// Makes the segmenter from a table.
    pub create: Box<dyn Fn(&str) -> Result<Box<dyn Segmenter>> + Send + Sync>,
    /// Writes a table back with every default, where the plugin can.
    pub normalise: Option<Box<dyn Fn(&str) -> Result<String> + Send + Sync>>,
}

impl SegmenterSubject {
    /// A segmenter that is linked into this program, by its table.
    pub fn linked(toml: &str, files: Arc<dyn Files>) -> Self {
        fn spec(text: &str) -> Result<Box<dyn SegmenterSpec>> {
            toml::from_str(text).map_err(|e| Error::config("segmenter", e.message().trim(), "correct the table"))
        }
        let write = |text: &str| {
            toml::to_string(&spec(text)?).map_err(|e| Error::config("segmenter", e.to_string(), "correct the table"))
        };
        let create = move |text: &str| spec(text)?.build(&*files);
        Self { toml: toml.into(), create: Box::new(create), normalise: Some(Box::new(write)) }
    }
    /// The segmenter.
    pub fn model(&self) -> std::result::Result<Box<dyn Segmenter>, String> {
        self.model_of(&self.toml)
    }
    fn model_of(&self, toml: &str) -> std::result::Result<Box<dyn Segmenter>, String> {
        (self.create)(toml).map_err(unexpected("making the segmenter"))
    }
}

crate::conformance_list! { segmenter, conformance_checks SegmenterSubject }

table_checks!(SegmenterSubject, same);

/// `Ok` when two segmenters answer alike.
fn same(a: &dyn Segmenter, b: &dyn Segmenter) -> std::result::Result<(), String> {
    let scene = Scene::patches();
    ensure(scene.labels(a)? == scene.labels(b)?, || "labels changed".into())
}

/// A scan and a rendered view of it.
struct Scene {
    scan: Scan,
    camera: Camera,
    colour: Vec<[u8; 3]>,
    depth: Vec<f32>,
    triangle: Vec<u32>,
}

/// Pixels per metre of the view.
const SCALE: f64 = 10.0;

impl Scene {
    /// Three patches of 6 × 6 pixels with gaps between them, seen straight on.
    fn patches() -> Self {
        let mut scene = Self::empty(24, 8);
        let (mut colours, mut labels) = (Vec::new(), Vec::new());
        for (patch, label) in Label::ALL.into_iter().enumerate() {
            let first = scene.scan.mesh.vertices.len() as u32;
            let (left, top) = (2 + 7 * patch, 1);
            let world = |x: usize, y: usize| Vec3::new((x as f64 - 12.0) / SCALE, (4.0 - y as f64) / SCALE, 0.0);
            let corners = [(left, top), (left + 6, top), (left + 6, top + 6), (left, top + 6)];
            scene.scan.mesh.vertices.extend(corners.map(|(x, y)| world(x, y)));
            scene.scan.mesh.faces.extend([[first, first + 2, first + 1], [first, first + 3, first + 2]]);
            colours.extend([COLOURS[patch]; 4]);
            labels.extend([label; 4]);
            for y in top..top + 6 {
                for x in left..left + 6 {
                    let pixel = y * 24 + x;
                    // The diagonal from the upper left parts the two triangles.
                    scene.triangle[pixel] = 2 * patch as u32 + u32::from(y - top > x - left);
                    scene.colour[pixel] = COLOURS[patch];
                    scene.depth[pixel] = 1.0;
                }
            }
        }
        scene.scan.colours = Some(colours);
        scene.scan.labels = Some(labels);
        scene
    }

    /// A view that shows nothing.
    fn empty(width: usize, height: usize) -> Self {
        let pixels = width * height;
        Self {
            scan: Scan { name: "conformance-patches".into(), mesh: TriMesh::default(), colours: None, labels: None },
            camera: Camera {
                // y down, looking along −z from z = 1.
                world_to_camera: Matrix3x4::new(1., 0., 0., 0., 0., -1., 0., 0., 0., 0., -1., 1.),
                scale: SCALE,
                perspective: false,
                width,
                height,
            },
            colour: vec![[0; 3]; pixels],
            depth: vec![f32::INFINITY; pixels],
            triangle: vec![NO_TRIANGLE; pixels],
        }
    }

    fn view(&self) -> View<'_> {
        View {
            scan: &self.scan,
            index: 0,
            count: 1,
            camera: &self.camera,
            colour: &self.colour,
            depth: &self.depth,
            triangle: &self.triangle,
        }
    }

    fn labels(&self, segmenter: &dyn Segmenter) -> std::result::Result<Vec<Label>, String> {
        self.labels_over(segmenter, Label::Ignore)
    }

    fn labels_over(&self, segmenter: &dyn Segmenter, before: Label) -> std::result::Result<Vec<Label>, String> {
        let mut labels = vec![before; self.triangle.len()];
        segmenter.segment(&self.view(), &mut labels).map_err(unexpected("labelling a view"))?;
        Ok(labels)
    }
}

/// [`CHECKS`]: pixels without a triangle, in views with and without a person, the smallest included.
pub fn empty_pixels_are_ignored(segmenter: &dyn Segmenter) -> Outcome {
    let mut scenes = vec![Scene::patches(), Scene::patches(), Scene::patches()];
    // The same scan, seen from where it does not show.
    for (scene, (width, height)) in scenes[1..].iter_mut().zip([(24, 8), (1, 1)]) {
        *scene = Scene { scan: scene.scan.clone(), ..Scene::empty(width, height) };
    }
    for scene in scenes {
        let labels = scene.labels_over(segmenter, Label::Body)?;
        let wrong = labels.iter().zip(&scene.triangle).position(|(l, t)| *t == NO_TRIANGLE && *l != Label::Ignore);
        ensure(wrong.is_none(), || format!("pixel {wrong:?} shows nothing and is labelled"))?;
    }
    Ok(Verdict::Passed)
}

/// [`CHECKS`]: not everything is ignored.
pub fn shown_pixels_are_labelled(segmenter: &dyn Segmenter) -> Outcome {
    let labels = Scene::patches().labels(segmenter)?;
    ensure(labels.iter().any(|l| *l != Label::Ignore), || "nothing of the person was labelled".into())?;
    Ok(Verdict::Passed)
}

/// [`CHECKS`]: what stood in the labels before.
pub fn labels_overwrite(segmenter: &dyn Segmenter) -> Outcome {
    let scene = Scene::patches();
    let first = scene.labels_over(segmenter, Label::Ignore)?;
    for before in Label::ALL {
        let kept = scene.labels_over(segmenter, before)? != first;
        ensure(!kept, || format!("labels depend on {before:?} standing there before"))?;
    }
    Ok(Verdict::Passed)
}

/// [`CHECKS`]: [`Error::Length`].
pub fn wrong_lengths_are_refused(segmenter: &dyn Segmenter) -> Outcome {
    let scene = Scene::patches();
    for len in [0, scene.triangle.len() - 1, scene.triangle.len() + 1] {
        let refused =
            matches!(segmenter.segment(&scene.view(), &mut vec![Label::Ignore; len]), Err(Error::Length { .. }));
        ensure(refused, || format!("{len} labels for {} pixels are no Length error", scene.triangle.len()))?;
    }
    Ok(Verdict::Passed)
}

/// [`CHECKS`]: no colours, no labels: either not needed, or the error names the scan.
pub fn bare_scans_are_answered_or_named(segmenter: &dyn Segmenter) -> Outcome {
    let mut scene = Scene::patches();
    scene.scan.colours = None;
    scene.scan.labels = None;
    let mut labels = vec![Label::Ignore; scene.triangle.len()];
    match segmenter.segment(&scene.view(), &mut labels) {
        Ok(()) => Ok(Verdict::Passed),
        Err(error) if error.to_string().contains(&scene.scan.name) => Ok(Verdict::Passed),
        Err(error) => Err(format!("the error does not name the scan: {error}")),
    }
}

/// [`CHECKS`]: pure, on any thread.
pub fn threads_change_nothing(segmenter: &dyn Segmenter) -> Outcome {
    let scene = Scene::patches();
    let first = scene.labels(segmenter)?;
    let others: Vec<std::result::Result<bool, String>> = std::thread::scope(|scope| {
        let threads: Vec<_> = (0..4).map(|_| scope.spawn(|| Ok(scene.labels(segmenter)? == first))).collect();
        threads.into_iter().map(|t| t.join().unwrap_or_else(|_| Err("a thread panicked".into()))).collect()
    });
    for same in others {
        ensure(same?, || "other labels on another thread".into())?;
    }
    Ok(Verdict::Passed)
}
