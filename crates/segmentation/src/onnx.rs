//! `type = "onnx"`: a human parser, run on the rendered views.

use crate::classes::{LabelMap, class_labels};
use crate::view;
use caphy_core::files::Files;
use caphy_core::scan::Label;
use caphy_core::segmenter::{NO_TRIANGLE, Segmenter, SegmenterSpec, View};
use caphy_core::{Error, Result};
use caphy_formats::onnx::{Fit, Network, Pixels, Placement, Tensor, Values};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::PathBuf;

/// `[segmenter]` with `type = "onnx"`.
///
/// ```toml
/// type = "onnx"
/// path = "schp-lip.onnx"
/// map = "lip"
/// output = "fusion"
/// pixels = { channels = "bgr", mean = [0.406, 0.456, 0.485], std = [0.225, 0.224, 0.229] }
/// ```
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SegmenterOnnxSpec {
    /// The network: one float input of shape [1, 3, height, width].
    pub path: PathBuf,
    /// What the class numbers mean. None by default: `classes` says it all.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub map: Option<LabelMap>,
    /// Single classes, by number or by their name in `map`, and what they are: these win over `map`.
    #[serde(default)]
    pub classes: BTreeMap<String, Label>,
    /// Height and width of the network's input [pixels], where its file does not fix them. Default: those of the views.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub input: Option<[usize; 2]>,
    /// The output to read: scores of shape [1, classes, height, width], or class numbers (integers). Default: the first.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub output: Option<String>,
    /// Channels and normalisation.
    #[serde(default)]
    pub pixels: Pixels,
    /// How a view becomes an input of other proportions.
    #[serde(default)]
    pub fit: Fit,
    /// Whether scores of another size than the input lie corner on corner as centres of pixels (`align_corners` of PyTorch). Default
    /// true, as SCHP's; Segformer's do not.
    #[serde(default = "corners")]
    pub align_corners: bool,
    /// Threads that work on one view. Default 2; a fixed number, whatever the machine has.
    #[serde(default = "threads")]
    pub threads: usize,
}

fn corners() -> bool {
    true
}
fn threads() -> usize {
    2
}

/// What is beside the person, white, as parsers are used to and `caphy views` paints it.
const BACKGROUND: [f32; 3] = [1.0; 3];
/// Largest height and width of an input [pixels]: beyond, a slip of the keyboard is likelier.
const LARGEST: usize = 8192;

#[typetag::serde(name = "onnx")]
impl SegmenterSpec for SegmenterOnnxSpec {
    fn build(&self, files: &dyn Files) -> Result<Box<dyn Segmenter>> {
        Ok(Box::new(SegmenterOnnx::new(self, files)?))
    }
}

/// Gives each pixel the label of the class that a network finds there: of the highest score, interpolated between the scores' pixels,
/// the smaller class of equals; or of the nearest class number.
///
/// # Errors
/// [`Error::Mesh`] naming a scan without colours; [`Error::Format`] naming the network for an answer that is neither scores nor class
/// numbers, for another number of classes than `map` has, and for a class without a meaning; [`Error::NonFinite`] for scores.
#[derive(Debug)]
pub struct SegmenterOnnx {
    network: Network,
    output: usize,
    input: Option<[usize; 2]>,
    pixels: Pixels,
    fit: Fit,
    align_corners: bool,
    classes: Classes,
}

impl SegmenterOnnx {
    /// Reads and opens the network.
    ///
    /// # Errors
    /// [`Error::Config`] for values out of range, a class that the map lacks, a build without ONNX, a missing library; those of
    /// [`Network::open`]; [`Error::Io`].
    pub fn new(spec: &SegmenterOnnxSpec, files: &dyn Files) -> Result<Self> {
        spec.pixels.check("segmenter.pixels")?;
        if let Some(size) = spec.input
            && !size.iter().all(|n| (1..=LARGEST).contains(n))
        {
            let remedy = format!("give height and width from 1 to {LARGEST}");
            return Err(Error::config("segmenter.input", format!("{size:?}"), remedy));
        }
        if !(1..=256).contains(&spec.threads) {
            return Err(Error::config("segmenter.threads", format!("{}", spec.threads), "give 1 to 256"));
        }
        let labels = class_labels(spec.map, &spec.classes)?;
        let network = Network::open("segmenter.type", &spec.path, &files.read(&spec.path)?, spec.threads)?;
        let output = spec.output.as_ref().map_or(Ok(0), |name| network.output(name))?;
        let classes = Classes { path: spec.path.clone(), map: spec.map, labels };
        // What the file says of its classes is looked at before the first view is rendered.
        if let [_, Some(count), _, _] = network.outputs()[output].shape[..]
            && network.outputs()[output].element == caphy_formats::onnx::Element::F32
        {
            classes.check_count(count)?;
        }
        let SegmenterOnnxSpec { input, pixels, fit, align_corners, .. } = *spec;
        Ok(Self { network, output, input, pixels, fit, align_corners, classes })
    }
}

impl Segmenter for SegmenterOnnx {
    fn segment(&self, view: &View<'_>, labels: &mut [Label]) -> Result<()> {
        view::check(view, labels)?;
        view::check_colours(view, "onnx")?;
        let size = [view.camera.height, view.camera.width];
        let placement = Placement::new(size, self.network.size(self.input, size)?, self.fit);
        let shown = |(colour, id): (&[u8; 3], &u32)| match *id {
            NO_TRIANGLE => BACKGROUND,
            _ => colour.map(|c| f32::from(c) / 255.0),
        };
        let picture: Vec<[f32; 3]> = view.colour.iter().zip(view.triangle).map(shown).collect();
        let input = self.pixels.tensor(&picture, BACKGROUND, &placement)?;
        let answer = self.network.run(input, placement.input(), &[self.output])?;
        let answer =
            answer.into_iter().next().ok_or_else(|| self.classes.refused("answers", "there is none".into()))?;
        self.classes.label(&answer, &placement, self.align_corners, view, labels)
    }
}

/// What a network's classes mean.
#[derive(Debug)]
struct Classes {
    path: PathBuf,
    map: Option<LabelMap>,
    labels: [Option<Label>; 256],
}

impl Classes {
    fn refused(&self, at: &str, problem: String) -> Error {
        let remedy = "export scores of shape [1, classes, height, width] or integer class numbers of shape [1, height, width]; \
                      `segmenter.output` names another output";
        Error::format(&self.path, at, problem, remedy)
    }

    /// Refuses a network with other classes than are known here.
    fn check_count(&self, count: usize) -> Result<()> {
        let wrong = |problem: String| {
            let remedy =
                "choose the `segmenter.map` that it was trained on, or name its classes in `segmenter.classes`";
            Err(Error::format(&self.path, "classes", problem, remedy))
        };
        if let Some(map) = self.map
            && count < map.classes().len()
        {
            return wrong(format!("it has {count}, the map {}", map.classes().len()));
        }
        match (0..count).find(|&c| self.labels.get(c).copied().flatten().is_none()) {
            Some(class) => wrong(format!("class {class} of its {count} has no meaning")),
            None => Ok(()),
        }
    }

    /// Labels of a view from a network's answer.
    fn label(
        &self,
        answer: &Tensor,
        placement: &Placement,
        corners: bool,
        view: &View<'_>,
        labels: &mut [Label],
    ) -> Result<()> {
        let class_at = self.reader(answer)?;
        for (pixel, (label, id)) in labels.iter_mut().zip(view.triangle).enumerate() {
            *label = Label::Ignore;
            if *id == NO_TRIANGLE {
                continue;
            }
            let (column, row) = (pixel % view.camera.width, pixel / view.camera.width);
            let at = [row as f64 + 0.5, column as f64 + 0.5];
            let class = class_at.class(placement, at, corners);
            *label = usize::try_from(class).ok().and_then(|c| *self.labels.get(c)?).ok_or_else(|| {
                let problem = format!("class {class} at ({column}, {row}) of view {} has no meaning", view.index);
                let remedy = "choose another `segmenter.map`, or name the class in `segmenter.classes`";
                Error::format(&self.path, "answer", problem, remedy)
            })?;
        }
        Ok(())
    }

    /// The answer as scores or as class numbers, whichever it is.
    fn reader<'t>(&self, answer: &'t Tensor) -> Result<Answer<'t>> {
        let refused = |what: &str| Err(self.refused("answer", format!("{what} of shape {:?}", answer.shape)));
        match (&answer.values, &answer.shape[..]) {
            (Values::F32(scores), &[1, count, height, width]) if height * width > 0 => {
                self.check_count(count)?;
                Error::check_finite(&format!("scores of {}", self.path.display()), scores)?;
                Ok(Answer::Scores { scores, count, size: [height, width] })
            }
            (Values::Integer(classes), &[height, width] | &[1, height, width] | &[1, 1, height, width])
                if height * width > 0 =>
            {
                Ok(Answer::Numbers { classes, size: [height, width] })
            }
            (Values::F32(_), _) => refused("floats"),
            (Values::Integer(_), _) => refused("integers"),
        }
    }
}

/// A network's answer.
enum Answer<'t> {
    /// Shape [count, height, width].
    Scores { scores: &'t [f32], count: usize, size: [usize; 2] },
    /// Shape [height, width].
    Numbers { classes: &'t [i64], size: [usize; 2] },
}

impl Answer<'_> {
    /// The class at (row, column) of the picture [pixels].
    fn class(&self, placement: &Placement, at: [f64; 2], corners: bool) -> i64 {
        match *self {
            Answer::Numbers { classes, size } => classes[placement.answer_at(at, size, corners).nearest()],
            Answer::Scores { scores, count, size } => {
                let (place, plane) = (placement.answer_at(at, size, corners), size[0] * size[1]);
                let mut best = (f32::NEG_INFINITY, 0);
                for class in 0..count {
                    let score = place.mix(|pixel| scores[class * plane + pixel]);
                    if score > best.0 {
                        best = (score, class);
                    }
                }
                best.1 as i64
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use caphy_core::scan::Scan;
    use caphy_core::{TriMesh, Vec3};
    use caphy_render::{Projection, frame, render};

    /// Labels that an answer gives to a square of 12 × 12 pixels in the middle of a view of 16 × 16.
    fn labels(map: Option<LabelMap>, classes: &[(&str, Label)], answer: &Tensor) -> Result<Vec<Label>> {
        let vertices = vec![Vec3::zeros(), Vec3::x(), Vec3::new(1.0, 1.0, 0.0), Vec3::y()];
        let mesh = TriMesh { vertices, faces: vec![[0, 1, 2], [0, 2, 3]] };
        let scan = Scan { name: "sq".into(), mesh, colours: None, labels: None };
        let around = (Vec3::new(-0.1, -0.1, 0.0), Vec3::new(1.1, 1.1, 0.0));
        let camera = frame(around, &Vec3::z(), Projection::Orthographic, 16, 16);
        let image = render(&scan.mesh, None, &camera);
        let (colour, depth, triangle) = (&image.colour, &image.depth, &image.triangle);
        let view = View { scan: &scan, index: 3, count: 4, camera: &camera, colour, depth, triangle };
        let classes = classes.iter().map(|(name, label)| (name.to_string(), *label)).collect();
        let known = Classes { path: "net.onnx".into(), map, labels: class_labels(map, &classes)? };
        let mut labels = vec![Label::Body; 256];
        known.label(answer, &Placement::new([16, 16], [16, 16], Fit::Letterbox), true, &view, &mut labels)?;
        Ok(labels)
    }

    /// Scores of classes at four corners.
    fn corners(scores: &[[f32; 4]]) -> Tensor {
        Tensor { shape: vec![1, scores.len(), 2, 2], values: Values::F32(scores.as_flattened().to_vec()) }
    }

    const PARTS: [(&str, Label); 3] = [("0", Label::Ignore), ("1", Label::Upper), ("2", Label::Lower)];

    #[test]
    fn scores_are_interpolated_before_the_highest_is_taken() {
        // Class 1 falls from 3 on the left to −1 on the right, class 2 is 0 everywhere: equal at three quarters.
        let answer = corners(&[[-9.0; 4], [3.0, -1.0, 3.0, -1.0], [0.0; 4]]);
        let labels = labels(None, &PARTS, &answer).unwrap();
        let row = &labels[8 * 16..9 * 16];
        // Centres run from 0.5 to 15.5: three quarters is 11.75, and the last of class 1 the pixel with centre 11.5.
        assert!(row[2..=11].iter().all(|l| *l == Label::Upper), "{row:?}");
        assert!(row[12..14].iter().all(|l| *l == Label::Lower), "{row:?}");
        assert_eq!([labels[0], row[0], row[15]], [Label::Ignore; 3]);
    }

    #[test]
    fn class_numbers_are_taken_from_the_nearest_pixel() {
        for shape in [vec![2, 2], vec![1, 2, 2], vec![1, 1, 2, 2]] {
            let answer = Tensor { shape, values: Values::Integer(vec![1, 2, 1, 0]) };
            let labels = labels(None, &PARTS, &answer).unwrap();
            let at = |row: usize, column: usize| labels[row * 16 + column];
            assert_eq!(
                [at(2, 2), at(2, 13), at(13, 2), at(13, 13)],
                [Label::Upper, Label::Lower, Label::Upper, Label::Ignore]
            );
        }
    }

    #[test]
    fn equal_scores_go_to_the_smaller_class() {
        let labels = labels(None, &PARTS, &corners(&[[0.0; 4], [2.0; 4], [2.0; 4]])).unwrap();
        assert_eq!(labels[8 * 16 + 8], Label::Upper);
    }

    #[test]
    fn answers_that_are_no_labels_are_named() {
        let said = |map, classes: &[_], answer: &Tensor| labels(map, classes, answer).unwrap_err().to_string();
        let numbers = |shape: Vec<usize>, values| Tensor { shape, values: Values::Integer(values) };
        let scores = |shape: Vec<usize>| {
            let count = shape.iter().product();
            Tensor { shape, values: Values::F32(vec![0.0; count]) }
        };
        for (map, answer, words) in [
            (None, numbers(vec![1, 2, 2], vec![1, 7, 1, 0]), ["class 7", "segmenter.classes"]),
            (None, numbers(vec![1, 2, 2], vec![1, -1, 1, 0]), ["class -1", "view 3"]),
            (None, numbers(vec![2, 2, 2], vec![0; 8]), ["integers of shape [2, 2, 2]", "segmenter.output"]),
            (None, scores(vec![3, 2, 2]), ["floats of shape [3, 2, 2]", "[1, classes, height, width]"]),
            (None, scores(vec![1, 3, 0, 2]), ["floats of shape [1, 3, 0, 2]", "net.onnx"]),
            (None, scores(vec![1, 4, 2, 2]), ["class 3 of its 4", "segmenter.map"]),
            (Some(LabelMap::Lip), scores(vec![1, 18, 2, 2]), ["it has 18, the map 20", "segmenter.map"]),
            (Some(LabelMap::Pascal), scores(vec![1, 20, 2, 2]), ["class 7 of its 20", "net.onnx"]),
        ] {
            let said = said(map, &PARTS[usize::from(map.is_some()) * 3..], &answer);
            assert!(words.iter().all(|w| said.contains(w)), "{said}");
        }
        let nan = said(None, &PARTS, &corners(&[[f32::NAN; 4], [0.0; 4], [0.0; 4]]));
        assert!(nan.contains("scores of net.onnx") && nan.contains("not finite"), "{nan}");
    }

    #[test]
    fn tables_that_cannot_work_are_refused() {
        let refused = |text: &str| {
            let spec: SegmenterOnnxSpec = toml::from_str(&format!("path = \"no.onnx\"\n{text}")).unwrap();
            SegmenterOnnx::new(&spec, &caphy_core::files::Disk).unwrap_err().to_string()
        };
        for (text, key) in [
            ("", "segmenter.map"),
            ("map = \"lip\"\nclasses = { trousers = \"lower\" }", "segmenter.classes"),
            ("map = \"lip\"\ninput = [473, 0]", "segmenter.input"),
            ("map = \"lip\"\nthreads = 0", "segmenter.threads"),
            ("map = \"lip\"\npixels = { std = [1.0, 1.0, -1.0] }", "segmenter.pixels.std"),
            ("map = \"lip\"", "no.onnx"),
        ] {
            let said = refused(text);
            assert!(said.contains(key), "{text}: {said}");
        }
        let unknown = toml::from_str::<SegmenterOnnxSpec>("path = \"a\"\npixels = { order = \"bgr\" }").unwrap_err();
        assert!(unknown.to_string().contains("order"));
    }

    #[cfg(not(feature = "onnx"))]
    #[test]
    fn a_build_without_networks_says_how_to_get_one_with_them() {
        let spec: SegmenterOnnxSpec = toml::from_str("path = \"src/lib.rs\"\nmap = \"atr\"").unwrap();
        let said = SegmenterOnnx::new(&spec, &caphy_core::files::Disk).unwrap_err().to_string();
        assert!(said.contains("`segmenter.type`") && said.contains("--features onnx"), "{said}");
    }
}
