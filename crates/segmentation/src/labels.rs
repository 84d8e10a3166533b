//! `type = "labels"`: label images that a human parser made of the rendered views.

use crate::classes::{LabelMap, class_labels};
use crate::view;
use caphy_core::files::Files;
use caphy_core::scan::Label;
use caphy_core::segmenter::{NO_TRIANGLE, Segmenter, SegmenterSpec, View};
use caphy_core::{Error, Result};
use caphy_formats::image::read_class_image;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::PathBuf;

/// `[segmenter]` with `type = "labels"`.
///
/// ```toml
/// type = "labels"
/// path = "labels"
/// map = "lip"
/// classes = { scarf = "upper", 8 = "ignore" }
/// ```
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SegmenterLabelsSpec {
    /// Folder with one PNG per scan and view: class numbers as palette indices (as SCHP writes them) or grey levels.
    pub path: PathBuf,
    /// File names: `{scan}` stands for the scan's name, `{view}` for the view's number from 0, with leading zeros or without.
    /// Default: the names that `caphy views` gives its pictures, which parsers keep.
    #[serde(default = "file_name")]
    pub name: String,
    /// What the class numbers mean. None by default: `classes` says it all.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub map: Option<LabelMap>,
    /// Single classes, by number or by their name in `map`, and what they are: these win over `map`.
    #[serde(default)]
    pub classes: BTreeMap<String, Label>,
}

/// Names of pictures of views, and of label images made of them.
fn file_name() -> String {
    "{scan}_{view}.png".into()
}

#[typetag::serde(name = "labels")]
impl SegmenterSpec for SegmenterLabelsSpec {
    fn build(&self, files: &dyn Files) -> Result<Box<dyn Segmenter>> {
        Ok(Box::new(SegmenterLabels::new(self, files)?))
    }
}

/// Gives each pixel the label of its class in an image that was made elsewhere.
///
/// # Errors
/// [`Error::Mesh`] for a scan or view without an image, [`Error::Format`] for an image of another size than the view, or with a
/// class that the map does not have.
#[derive(Debug, Clone)]
pub struct SegmenterLabels {
    folder: PathBuf,
    name: String,
    labels: [Option<Label>; 256],
    /// Files by scan and view, as they are on disk: decoded when their view comes.
    images: BTreeMap<String, BTreeMap<usize, (PathBuf, Vec<u8>)>>,
}

impl SegmenterLabels {
    /// Reads the folder.
    ///
    /// # Errors
    /// [`Error::Config`] for a name without `{scan}` and `{view}`, a class that the map lacks, a folder without such files;
    /// [`Error::Io`].
    pub fn new(spec: &SegmenterLabelsSpec, files: &dyn Files) -> Result<Self> {
        let labels = class_labels(spec.map, &spec.classes)?;
        let parts = pattern(&spec.name)?;
        let mut images: BTreeMap<String, BTreeMap<usize, (PathBuf, Vec<u8>)>> = BTreeMap::new();
        for path in files.list(&spec.path, &["png"])? {
            let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
            let Some((scan, view)) = parts.find(&name) else { continue };
            let bytes = files.read(&path)?;
            if let Some((other, _)) = images.entry(scan.clone()).or_default().insert(view, (path.clone(), bytes)) {
                let problem =
                    format!("{} and {} are both view {view} of scan `{scan}`", other.display(), path.display());
                return Err(Error::config("segmenter.path", problem, "remove one of them"));
            }
        }
        if images.is_empty() {
            let problem = format!("{} holds no `{}`", spec.path.display(), spec.name);
            let remedy = "write the views with `caphy views`, run a human parser on them, and put its images there";
            return Err(Error::config("segmenter.path", problem, remedy));
        }
        Ok(Self { folder: spec.path.clone(), name: spec.name.clone(), labels, images })
    }
}

/// A name around `{scan}` and `{view}`.
struct Pattern {
    before: String,
    between: String,
    after: String,
    scan_first: bool,
}

fn pattern(name: &str) -> Result<Pattern> {
    let wrong = |problem: &str| {
        let remedy = "write it like `{scan}_{view}.png`";
        Err(Error::config("segmenter.name", format!("`{name}` {problem}"), remedy))
    };
    let (Some(scan), Some(view)) = (name.find("{scan}"), name.find("{view}")) else {
        return wrong("lacks `{scan}` or `{view}`");
    };
    if name.contains('/') || name.contains('\\') {
        return wrong("has a folder in it");
    }
    let (first, second) = (scan.min(view), scan.max(view));
    let between = &name[first + 6..second];
    if between.is_empty() {
        return wrong("has nothing between `{scan}` and `{view}`");
    }
    Ok(Pattern {
        before: name[..first].into(),
        between: between.into(),
        after: name[second + 6..].into(),
        scan_first: scan < view,
    })
}

impl Pattern {
    fn find(&self, name: &str) -> Option<(String, usize)> {
        let middle = name.strip_prefix(&self.before)?.strip_suffix(&self.after)?;
        // A scan's name may hold what stands between; a view's number cannot.
        let (a, b) =
            if self.scan_first { middle.rsplit_once(&self.between)? } else { middle.split_once(&self.between)? };
        let (scan, view) = if self.scan_first { (a, b) } else { (b, a) };
        Some((scan.to_string(), view.parse().ok()?))
    }
}

impl Segmenter for SegmenterLabels {
    fn segment(&self, view: &View<'_>, labels: &mut [Label]) -> Result<()> {
        view::check(view, labels)?;
        if view.triangle.iter().all(|t| *t == NO_TRIANGLE) {
            // Nothing to be labelled: an image of it is not needed.
            labels.fill(Label::Ignore);
            return Ok(());
        }
        let scan = &view.scan.name;
        let Some(of_scan) = self.images.get(scan) else {
            let names: Vec<&str> = self.images.keys().map(String::as_str).collect();
            let problem =
                format!("{} has none named `{}`; it has scans {}", self.folder.display(), self.name, names.join(", "));
            return Err(Error::mesh(scan, "label images", problem, "make label images of this scan's views"));
        };
        let Some((path, bytes)) = of_scan.get(&view.index) else {
            let problem =
                format!("is missing in {}, which has {} views of this scan", self.folder.display(), of_scan.len());
            let remedy = "make label images of all views, as many as `views.count`";
            return Err(Error::mesh(scan, format!("label image of view {}", view.index), problem, remedy));
        };
        if let Some((_, (extra, _))) = of_scan.range(view.count..).next() {
            let problem = format!("{} belongs to more than the {} views of this run", extra.display(), view.count);
            let remedy = "set `views.count` to what the images were made with: other counts are other cameras";
            return Err(Error::mesh(scan, "label images", problem, remedy));
        }
        let image = read_class_image(path, bytes)?;
        let (width, height) = (view.camera.width, view.camera.height);
        if (image.width, image.height) != (width, height) {
            let problem = format!("is {} × {} pixels, the view {width} × {height}", image.width, image.height);
            return Err(Error::format(path, "size", problem, "set `views.size` to what the images were made with"));
        }
        for (pixel, (label, class)) in labels.iter_mut().zip(&image.classes).enumerate() {
            *label = match self.labels[usize::from(*class)] {
                _ if view.triangle[pixel] == NO_TRIANGLE => Label::Ignore,
                Some(label) => label,
                None => {
                    let at = format!("pixel ({}, {})", pixel % width, pixel / width);
                    let problem = format!("class {class} has no meaning");
                    let remedy = "choose another `segmenter.map`, or name the class in `segmenter.classes`";
                    return Err(Error::format(path, at, problem, remedy));
                }
            };
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use caphy_core::scan::Scan;
    use caphy_core::{TriMesh, Vec3};
    use caphy_render::{Projection, frame, render};
    use std::path::Path;

    struct Memory(BTreeMap<PathBuf, Vec<u8>>);
    impl Files for Memory {
        fn read(&self, path: &Path) -> Result<Vec<u8>> {
            Ok(self.0[path].clone())
        }
        fn list(&self, _: &Path, _: &[&str]) -> Result<Vec<PathBuf>> {
            Ok(self.0.keys().cloned().collect())
        }
    }

    fn grey(size: u32, of: impl Fn(u32) -> u8) -> Vec<u8> {
        let mut bytes = Vec::new();
        let mut encoder = png::Encoder::new(&mut bytes, size, size);
        encoder.set_color(png::ColorType::Grayscale);
        let data: Vec<u8> = (0..size * size).map(|i| of(i / size)).collect();
        encoder.write_header().unwrap().write_image_data(&data).unwrap();
        bytes
    }

    fn spec(text: &str) -> SegmenterLabelsSpec {
        toml::from_str(&format!("path = \"l\"\n{text}")).unwrap()
    }

    fn segment(segmenter: &SegmenterLabels, name: &str, index: usize, count: usize) -> Result<Vec<Label>> {
        let vertices = vec![Vec3::zeros(), Vec3::x(), Vec3::new(1.0, 1.0, 0.0), Vec3::y()];
        let mesh = TriMesh { vertices, faces: vec![[0, 1, 2], [0, 2, 3]] };
        let scan = Scan { name: name.into(), mesh, colours: None, labels: None };
        let camera = frame(scan.mesh.bounds().unwrap(), &Vec3::z(), Projection::Orthographic, 32, 32);
        let image = render(&scan.mesh, None, &camera);
        let view = View {
            scan: &scan,
            index,
            count,
            camera: &camera,
            colour: &image.colour,
            depth: &image.depth,
            triangle: &image.triangle,
        };
        let mut labels = vec![Label::Body; 32 * 32];
        segmenter.segment(&view, &mut labels)?;
        Ok(labels)
    }

    #[test]
    fn classes_become_labels_and_mistakes_are_named() {
        // Upper half hair, lower half a skirt; the next view in another size, then with an unknown class.
        let half = |top, bottom| move |row| if row < 16 { top } else { bottom };
        let files = [
            ("an_na_000.png", grey(32, half(2, 12))),
            ("an_na_001.png", grey(16, half(2, 12))),
            ("an_na_002.png", grey(32, half(2, 77))),
            ("readme.png", vec![]),
        ];
        let files = Memory(files.map(|(n, b)| (n.into(), b)).into_iter().collect());
        let segmenter = SegmenterLabels::new(&spec("map = \"lip\""), &files).unwrap();
        let labels = segment(&segmenter, "an_na", 0, 3).unwrap();
        assert_eq!([labels[5 * 32 + 5], labels[25 * 32 + 5], labels[0]], [Label::Body, Label::Lower, Label::Ignore]);
        let own = SegmenterLabels::new(&spec("map = \"lip\"\nclasses = { hair = \"ignore\", 12 = \"upper\" }"), &files)
            .unwrap();
        let labels = segment(&own, "an_na", 0, 3).unwrap();
        assert_eq!([labels[5 * 32 + 5], labels[25 * 32 + 5]], [Label::Ignore, Label::Upper]);
        for (name, index, count, words) in [
            ("an_na", 1, 3, ["16 × 16", "views.size"]),
            ("an_na", 2, 3, ["class 77", "segmenter.classes"]),
            ("an_na", 3, 4, ["view 3", "views.count"]),
            ("an_na", 0, 2, ["002.png", "views.count"]),
            ("otto", 0, 3, ["otto", "an_na"]),
        ] {
            let text = segment(&segmenter, name, index, count).unwrap_err().to_string();
            assert!(words.iter().all(|w| text.contains(w)), "{text}");
        }
    }

    #[test]
    fn tables_that_cannot_work_are_refused() {
        let files = Memory(BTreeMap::from([("x.png".into(), vec![])]));
        for (text, word) in [
            ("", "segmenter.map"),
            ("map = \"atr\"\nclasses = { trousers = \"lower\" }", "pants"),
            ("map = \"atr\"\nname = \"{scan}.png\"", "{view}"),
            ("map = \"atr\"\nname = \"{scan}{view}.png\"", "between"),
            ("map = \"atr\"", "caphy views"),
        ] {
            let said = SegmenterLabels::new(&spec(text), &files).unwrap_err().to_string();
            assert!(said.contains(word), "{text}: {said}");
        }
        assert!(toml::from_str::<SegmenterLabelsSpec>("path = \"l\"\nmap = \"coco\"").is_err());
    }
}
