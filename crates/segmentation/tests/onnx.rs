//! A human parser in an ONNX file, made here: it knows colours.
#![cfg(feature = "onnx")]

// Each user of the file needs another part of it.
#[allow(dead_code)]
#[path = "../../formats/tests/onnx/model.rs"]
mod model;

use caphy_core::conformance::segmenter::{CHECKS, COLOURS, SegmenterSubject};
use caphy_core::conformance::{Verdict, run_all};
use caphy_core::files::{Disk, Files};
use caphy_core::scan::{Label, Scan};
use caphy_core::segmenter::{NO_TRIANGLE, Segmenter, SegmenterSpec, View};
use caphy_core::{Result, TriMesh, Vec3};
use caphy_render::{Image, Projection, frame, render};
use caphy_segmentation::colour::PaletteEntry;
use caphy_segmentation::{SegmenterColour, SegmenterColourSpec};
use model::{Model, Type, runnable};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// The one file there is.
struct OneFile(Vec<u8>);
impl Files for OneFile {
    fn read(&self, _: &Path) -> Result<Vec<u8>> {
        Ok(self.0.clone())
    }
}

/// Scores of background (never) and three colours: 2 c·p − |p|² is largest for the nearest colour p, with c and p in [0, 1]. Also the
/// same as class numbers, and as means over blocks of 4 × 4 pixels, whose centres are not at the corners. `flip`: blue comes first.
fn parser(size: [i64; 2], flip: bool) -> Model {
    let [h, w] = size;
    let (mut weights, mut bias) = (vec![0.0; 3], vec![-100.0]);
    for colour in COLOURS {
        let mut c = colour.map(|v| f32::from(v) / 255.0);
        if flip {
            c.reverse();
        }
        weights.extend(c.map(|v| 2.0 * v));
        bias.push(-c.iter().map(|v| v * v).sum::<f32>());
    }
    Model::default()
        .input("picture", Type::Float, &[1, 3, h, w])
        .floats("weights", &[4, 3, 1, 1], &weights)
        .floats("bias", &[4], &bias)
        .node("Conv", &["picture", "weights", "bias"], "scores", &[("kernel_shape", &[1, 1])])
        .node("ArgMax", &["scores"], "numbers", &[("axis", &[1]), ("keepdims", &[0])])
        .node("AveragePool", &["scores"], "coarse", &[("kernel_shape", &[4, 4]), ("strides", &[4, 4])])
        .output("scores", Type::Float, &[1, 4, h, w])
        .output("numbers", Type::Int64, &[1, h, w])
        .output("coarse", Type::Float, &[1, 4, -1, -1])
}

/// Colours as they are, in [0, 1].
const TABLE: &str = "type = \"onnx\"\npath = \"parser.onnx\"\nclasses = { 0 = \"ignore\", 1 = \"body\", 2 = \"upper\", 3 = \"lower\" }\n";
const PLAIN: &str = "pixels = { mean = [0.0, 0.0, 0.0], std = [1.0, 1.0, 1.0] }\n";

fn build(table: &str, model: &Model) -> Result<Box<dyn Segmenter>> {
    let spec: Box<dyn SegmenterSpec> = toml::from_str(table).expect("a table");
    spec.build(&OneFile(model.bytes()))
}

/// A square whose colour runs from one side to the other, drawn as 48 × 64 pixels.
struct Square {
    scan: Scan,
    camera: caphy_core::segmenter::Camera,
    image: Image,
}

impl Square {
    fn new() -> Self {
        let vertices = vec![Vec3::zeros(), Vec3::x(), Vec3::new(1.0, 1.0, 0.0), Vec3::y()];
        let mesh = TriMesh { vertices, faces: vec![[0, 1, 2], [0, 2, 3]] };
        let colours = vec![COLOURS[0], COLOURS[1], COLOURS[2], [90, 20, 200]];
        let scan = Scan { name: "square".into(), mesh, colours: Some(colours), labels: None };
        let camera = frame(scan.mesh.bounds().unwrap(), &Vec3::z(), Projection::Orthographic, 64, 48);
        let image = render(&scan.mesh, scan.colours.as_deref(), &camera);
        Self { scan, camera, image }
    }
    fn labels(&self, segmenter: &dyn Segmenter) -> Result<Vec<Label>> {
        let Image { colour, depth, triangle, .. } = &self.image;
        let view = View { scan: &self.scan, index: 0, count: 1, camera: &self.camera, colour, depth, triangle };
        let mut labels = vec![Label::Body; triangle.len()];
        segmenter.segment(&view, &mut labels)?;
        Ok(labels)
    }
    /// The rule that the parser is made of, in integers: the nearest colours in RGB; several where they are equally near.
    fn nearest(&self, pixel: usize) -> Vec<Label> {
        if self.image.triangle[pixel] == NO_TRIANGLE {
            return vec![Label::Ignore];
        }
        let of = |colour: &[u8; 3]| -> i32 {
            (0..3).map(|k| (i32::from(colour[k]) - i32::from(self.image.colour[pixel][k])).pow(2)).sum()
        };
        let least = COLOURS.iter().map(of).min().unwrap();
        Label::ALL.into_iter().zip(&COLOURS).filter(|(_, c)| of(c) == least).map(|(label, _)| label).collect()
    }
    fn assert_exact(&self, labels: &[Label]) {
        let wrong = (0..labels.len()).find(|&i| !self.nearest(i).contains(&labels[i]));
        assert_eq!(wrong, None, "{wrong:?} is {:?}", wrong.map(|i| labels[i]));
        let count = |l: Label| labels.iter().filter(|x| **x == l).count();
        assert!(Label::ALL.into_iter().all(|l| count(l) > 100), "every label is there");
    }
}

#[test]
fn labels_are_exactly_those_of_the_rule_that_the_network_holds() {
    if !runnable() {
        return;
    }
    let square = Square::new();
    for output in ["", "output = \"scores\"\n", "output = \"numbers\"\n"] {
        let segmenter = build(&format!("{TABLE}{PLAIN}{output}"), &parser([-1, -1], false)).unwrap();
        square.assert_exact(&square.labels(&*segmenter).unwrap());
    }
    let blue_first = PLAIN.replace("{ mean", "{ channels = \"bgr\", mean");
    let segmenter = build(&format!("{TABLE}{blue_first}"), &parser([-1, -1], true)).unwrap();
    square.assert_exact(&square.labels(&*segmenter).unwrap());
    let wrong_way = build(&format!("{TABLE}{PLAIN}"), &parser([-1, -1], true)).unwrap();
    assert_ne!(square.labels(&*wrong_way).unwrap(), square.labels(&*segmenter).unwrap(), "the order counts");
}

#[test]
fn plain_colours_are_labelled_as_the_segmenter_colour_does() {
    if !runnable() {
        return;
    }
    let mut square = Square::new();
    square.scan.colours = Some(vec![COLOURS[1]; 4]);
    square.image = render(&square.scan.mesh, square.scan.colours.as_deref(), &square.camera);
    let palette = Label::ALL.into_iter().zip(COLOURS).map(|(label, colour)| PaletteEntry { label, colour }).collect();
    let spec = SegmenterColourSpec { palette, seeds: vec![], max_distance: None, far: Label::Ignore, outline: 0 };
    let colour = SegmenterColour::new(&spec).unwrap();
    let segmenter = build(&format!("{TABLE}{PLAIN}"), &parser([-1, -1], false)).unwrap();
    assert_eq!(square.labels(&*segmenter).unwrap(), square.labels(&colour).unwrap());
}

#[test]
fn views_of_other_sizes_and_coarse_scores_move_borders_by_less_than_their_pixels() {
    if !runnable() {
        return;
    }
    let square = Square::new();
    // Pixels around one, within a reach [pixels].
    let around = |i: usize, reach: usize| -> Vec<usize> {
        let (x, y) = (i % 64, i / 64);
        let rows = y.saturating_sub(reach)..=(y + reach).min(47);
        rows.flat_map(|r| (x.saturating_sub(reach)..=(x + reach).min(63)).map(move |c| r * 64 + c)).collect()
    };
    let shown = |i: usize| square.image.triangle[i] != NO_TRIANGLE;
    // How far one pixel of what the network reads or writes reaches in the view [pixels].
    for (table, size, reach) in [
        ("", [96, 96], 1),
        ("fit = \"stretch\"\n", [96, 96], 1),
        ("input = [40, 56]\n", [-1, -1], 2),
        ("output = \"coarse\"\nalign_corners = false\n", [-1, -1], 4),
    ] {
        let segmenter = build(&format!("{TABLE}{PLAIN}{table}"), &parser(size, false)).unwrap();
        let labels = square.labels(&*segmenter).unwrap();
        // The parser was not told what a background is: what is mixed with white may be anything.
        let inner = (0..labels.len()).filter(|&i| around(i, 2 * reach).into_iter().all(shown));
        let moved = |i: &usize| !around(*i, reach).into_iter().any(|j| square.nearest(j).contains(&labels[*i]));
        let far: Vec<usize> = inner.clone().filter(moved).collect();
        assert!(inner.count() > 500 && far.is_empty(), "{table}{size:?}: {far:?}");
        assert!((0..labels.len()).filter(|&i| !shown(i)).all(|i| labels[i] == Label::Ignore));
    }
}

#[test]
fn the_promise_of_the_trait_is_kept() {
    if !runnable() {
        return;
    }
    let folder = std::env::temp_dir().join(format!("caphy-onnx-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    for (name, size) in [("any", [-1, -1]), ("fixed", [16, 48])] {
        let path: PathBuf = folder.join(format!("{name}.onnx"));
        std::fs::write(&path, parser(size, false).bytes()).unwrap();
        let table = format!("{TABLE}{PLAIN}").replace("parser.onnx", &path.display().to_string());
        for row in run_all(CHECKS, &SegmenterSubject::linked(&table, Arc::new(Disk))) {
            assert_eq!(row.outcome, Ok(Verdict::Passed), "{name}: {}", row.name);
        }
    }
    std::fs::remove_dir_all(&folder).unwrap();
}

#[test]
fn the_number_of_threads_changes_no_label() {
    if !runnable() {
        return;
    }
    let square = Square::new();
    let with = |threads: usize| {
        let table = format!("{TABLE}{PLAIN}threads = {threads}\n");
        square.labels(&*build(&table, &parser([-1, -1], false)).unwrap()).unwrap()
    };
    assert_eq!(with(1), with(3));
}

#[test]
fn networks_that_do_not_fit_the_table_are_named() {
    if !runnable() {
        return;
    }
    let said = |table: &str, model: &Model| {
        let built = build(table, model).and_then(|segmenter| Square::new().labels(&*segmenter));
        built.unwrap_err().to_string()
    };
    let any = parser([-1, -1], false);
    let fewer = TABLE.replace(", 3 = \"lower\"", "");
    for (table, model, words) in [
        (fewer, &any, ["class 3 of its 4", "segmenter.classes"]),
        (format!("{TABLE}map = \"lip\"\n"), &any, ["it has 4, the map 20", "parser.onnx"]),
        (format!("{TABLE}output = \"fusion\"\n"), &any, ["`fusion`", "`coarse`"]),
        (format!("{TABLE}input = [32, 32]\n"), &parser([64, 64], false), ["`picture`", "32 × 32"]),
    ] {
        let said = said(&table, model);
        assert!(words.iter().all(|w| said.contains(w)), "{said}");
    }
    // Numbers say nothing of how many there are: the first that is unknown is named where it is found.
    let unknown = TABLE.replace(", 2 = \"upper\"", "");
    let said_later = said(&format!("{unknown}{PLAIN}output = \"numbers\"\n"), &any);
    assert!(said_later.contains("class 2 at (") && said_later.contains("view 0"), "{said_later}");
    // Scans without colours are named, too.
    let mut square = Square::new();
    square.scan.colours = None;
    let error = square.labels(&*build(&format!("{TABLE}{PLAIN}"), &any).unwrap()).unwrap_err().to_string();
    assert!(error.contains("`square`") && error.contains("`onnx`"), "{error}");
}
