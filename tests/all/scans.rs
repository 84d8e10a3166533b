//! Folders of scans as people bring them: other units and axes, files that cannot be used among good ones, stopped runs.

use crate::bad_input::person;
use crate::experiment::{Experiment, edited, tiny_on_scans, value};
use caphy::runner::Run;
use caphy::stage::preprocess::Subject;
use caphy_core::Vec3;
use caphy_core::scan::{Label, Scan};
use caphy_core::segmenter::{Segmenter, View};
use caphy_formats::motion::UpAxis;
use caphy_formats::ply::write_ply;
use caphy_render::{Rgb, png, render, uniform_views};
use caphy_segmentation::SegmenterVertex;

fn preprocess(experiment: &Experiment) -> Subject {
    let run = Run::open(&experiment.config(), Some(experiment.out())).and_then(|run| run.only("preprocess"));
    run.and_then(Run::all).unwrap_or_else(|e| panic!("{e}"));
    value(&experiment.out(), "preprocess")
}

fn plan(experiment: &Experiment) -> String {
    let run = Run::open(&experiment.config(), Some(experiment.out())).and_then(Run::plan);
    run.unwrap_or_else(|e| panic!("{e}")).text()
}

fn moved(scan: &Scan, to: impl Fn(&Vec3) -> Vec3) -> Scan {
    let mut scan = scan.clone();
    scan.mesh.vertices.iter_mut().for_each(|p| *p = to(p));
    scan
}

/// Two people side by side in one file.
fn two(scan: &Scan) -> Scan {
    let mut out = scan.clone();
    let first = out.mesh.vertices.len() as u32;
    out.mesh.vertices.extend(scan.mesh.vertices.iter().map(|p| p + Vec3::new(0.0, 0.0, 0.9)));
    out.mesh.faces.extend(scan.mesh.faces.iter().map(|f| f.map(|v| v + first)));
    out.labels.get_or_insert_default().extend(scan.labels.iter().flatten());
    out.colours = None;
    out
}

#[test]
fn scans_that_cannot_be_used_are_left_out_and_the_others_go_on() {
    let scan = person();
    let experiment = Experiment::new(&tiny_on_scans("scans", &["held"]));
    let write = |name: &str, scan: &Scan| experiment.write(&format!("scans/{name}.ply"), &write_ply(scan));
    write("anna", &scan);
    write("held", &scan);
    write("millimetres", &moved(&scan, |p| 1000.0 * p));
    write("lying", &moved(&scan, |p| Vec3::new(p.x, -p.z, p.y)));
    write("upside-down", &moved(&scan, |p| Vec3::new(p.x, -p.y, -p.z)));
    write("nan", &moved(&scan, |p| if p.y > 0.6 { Vec3::repeat(f64::NAN) } else { *p }));
    write("two", &two(&scan));
    let labels =
        scan.labels.as_ref().map(|l| l.iter().map(|l| if *l == Label::Lower { Label::Body } else { *l }).collect());
    write("no-trousers", &Scan { labels, ..scan.clone() });
    write("no-labels", &Scan { labels: None, ..scan.clone() });
    experiment.write("scans/cut.ply", &write_ply(&scan)[..4000]);

    let told = plan(&experiment);
    for words in ["Scan held (held out)", "no labels on its vertices", "vertex", "not finite", "cut.ply"] {
        assert!(told.contains(words), "`{words}` is missing in {told}");
    }
    let subject = preprocess(&experiment);
    let used: Vec<&str> = subject.scans.iter().map(|s| &*s.name).collect();
    assert_eq!(used, ["anna", "held", "lying", "millimetres", "upside-down"]);
    let frame = |name: &str| subject.scans.iter().find(|s| s.name == name).expect("a scan").frame;
    assert_eq!((frame("anna").metres_per_unit, frame("anna").up), (1.0, UpAxis::Y));
    assert_eq!((frame("millimetres").metres_per_unit, frame("millimetres").up), (1e-3, UpAxis::Y));
    assert_eq!((frame("lying").up, frame("upside-down").up), (UpAxis::Z, UpAxis::MinusY));
    let why = |name: &str| {
        let found = subject.skipped.iter().find(|s| s.name == name);
        found.unwrap_or_else(|| panic!("{name} was used")).problem.clone()
    };
    for (name, words) in [
        ("nan", ["vertex", "not finite"]),
        ("two", ["0.15 m", "one person"]),
        ("no-trousers", ["lower", "labels"]),
        ("no-labels", ["labels", "colour"]),
        ("cut", ["cut.ply", "again"]),
    ] {
        let said = why(name);
        let missing = words.iter().find(|w| !said.contains(**w));
        assert!(missing.is_none(), "`{missing:?}` is missing in {name}: {said}");
    }

    let written = |name: &str| {
        let path = experiment.out().join(format!("{name}.caphy"));
        std::fs::metadata(path).and_then(|m| m.modified()).expect("an artifact")
    };
    let stamp = |name: &str| written(&format!("labelled/{name}"));
    // Another template: the bodies are those found before, and the same scans are left out.
    let (before, bodies) = (stamp("anna"), written("bodies"));
    let config = |edits: &[(&str, &str)]| edited(&tiny_on_scans("scans", &["held"]), edits);
    experiment.configure(&config(&[("[upper]", "[upper]\nmass_g = 150")]));
    let other = preprocess(&experiment);
    assert_eq!((stamp("anna"), written("bodies")), (before, bodies));
    let same = |a: &Subject, b: &Subject| {
        let known = |s: &Subject| serde_json::to_string(&(&s.shape, &s.displacement, &s.scans)).expect("JSON");
        known(a) == known(b) && a.skipped.iter().zip(&b.skipped).all(|(a, b)| a.problem == b.problem)
    };
    assert!(same(&subject, &other) && subject.skipped.len() == other.skipped.len());
    // Another way to fit them: other bodies of the same starts.
    let fit = ("sample_vertices = 900", "sample_vertices = 900\ndisplacement_sigma = 0.0");
    experiment.configure(&config(&[fit, ("[upper]", "[upper]\nmass_g = 150")]));
    let other = preprocess(&experiment);
    assert!(written("bodies") > bodies && !same(&subject, &other));
    let before = stamp("anna");
    // One more scan: what is known of the others is taken from their artifacts.
    write("otto", &scan);
    let more = preprocess(&experiment);
    assert_eq!((more.scans.len(), stamp("anna")), (6, before));
    assert!(stamp("otto") > before);
    // Another unit is another scan.
    experiment.configure(&config(&[("folder", "units = \"m\"\nfolder")]));
    let subject = preprocess(&experiment);
    assert!(subject.skipped.iter().any(|s| s.name == "millimetres" && s.problem.contains("subject.units")));
    assert!(stamp("anna") > before);
}

/// Label images of a scan's views, as PNG files: right arm, upper clothes, pants and background of LIP in the colours of PASCAL VOC's
/// map, as viewers save palettes.
fn label_images(scan: &Scan, count: usize, size: usize) -> Vec<Vec<u8>> {
    let cameras = uniform_views(scan.mesh.bounds().expect("vertices"), count, size);
    let image = |(index, camera)| {
        let image = render(&scan.mesh, None, camera);
        let (colour, depth, triangle) = (&image.colour, &image.depth, &image.triangle);
        let view = View { scan, index, count, camera, colour, depth, triangle };
        let mut seen = vec![Label::Ignore; size * size];
        SegmenterVertex.segment(&view, &mut seen).unwrap_or_else(|e| panic!("{e}"));
        let colour = |label: &Label| match label {
            Label::Body => [192, 128, 128],
            Label::Upper => [128, 0, 128],
            Label::Lower => [192, 0, 0],
            Label::Ignore => [0, 0, 0],
        };
        let picture = Rgb { width: size, height: size, pixels: seen.iter().map(colour).collect() };
        png(&picture).unwrap_or_else(|e| panic!("{e}"))
    };
    cameras.iter().enumerate().map(image).collect()
}

/// One scan is right; of the others something is wrong with what the segmenter reads, and each is named.
#[test]
fn scans_whose_labels_cannot_be_read_are_left_out_and_the_others_go_on() {
    let scan = person();
    let bare = write_ply(&Scan { labels: None, colours: None, ..scan.clone() });
    // Where up is known it is not searched for.
    let config = edited(&tiny_on_scans("scans", &[]), &[("folder", "units = \"m\"\nup = \"y\"\nfolder")]);
    let labels = "type = \"labels\"\npath = \"labels\"\nmap = \"lip\"";
    let experiment = Experiment::new(&edited(&config, &[("type = \"vertex\"", labels)]));
    let images = label_images(&scan, 8, 128);
    let small = label_images(&scan, 8, 64);
    let unknown = png(&Rgb { width: 128, height: 128, pixels: vec![[128, 64, 128]; 128 * 128] })
        .unwrap_or_else(|e| panic!("{e}"));
    // What is changed of a scan's images, and what is said of it.
    let table: [(&str, Vec<(usize, Option<&[u8]>)>, [&str; 2]); 6] = [
        ("no-images", (0..8).map(|i| (i, None)).collect(), ["no-images", "make label images"]),
        ("too-few", vec![(3, None), (7, None)], ["view 3", "views.count"]),
        ("too-many", vec![(8, Some(&images[0][..]))], ["too-many_008.png", "views.count"]),
        ("small", vec![(2, Some(&small[2][..]))], ["64 × 64", "views.size"]),
        ("other-classes", vec![(0, Some(&unknown[..]))], ["has no meaning", "segmenter.map"]),
        ("cut", vec![(5, Some(&images[5][..60]))], ["cut_005.png", "PNG"]),
    ];
    let put =
        |name: &str, index: usize, bytes: &[u8]| experiment.write(&format!("labels/{name}_{index:03}.png"), bytes);
    for name in table.iter().map(|row| row.0).chain(["right"]) {
        experiment.write(&format!("scans/{name}.ply"), &bare);
        let changed = table.iter().find(|row| row.0 == name).map(|row| &row.1[..]).unwrap_or_default();
        for (index, image) in images.iter().enumerate().filter(|(i, _)| changed.iter().all(|c| c.0 != *i)) {
            put(name, index, image);
        }
        changed.iter().for_each(|(index, bytes)| bytes.iter().for_each(|bytes| put(name, *index, bytes)));
    }
    let subject = preprocess(&experiment);
    assert_eq!(subject.scans.iter().map(|s| &*s.name).collect::<Vec<_>>(), ["right"]);
    for (name, _, words) in &table {
        let skipped = subject.skipped.iter().find(|s| s.name == *name).unwrap_or_else(|| panic!("{name} was used"));
        let missing = words.iter().find(|w| !skipped.problem.contains(**w));
        assert!(missing.is_none(), "`{missing:?}` is missing in {name}: {}", skipped.problem);
    }

    // Colours are asked for, and one scan has them.
    let colour = "type = \"colour\"\npalette = [{ label = \"upper\", colour = [40, 40, 90] }, \
                  { label = \"lower\", colour = [90, 90, 90] }, { label = \"body\", colour = [200, 160, 130] }]";
    let experiment = Experiment::new(&edited(&config, &[("type = \"vertex\"", colour)]));
    let shade = |l: &Label| match l {
        Label::Upper => [40, 40, 90],
        Label::Lower => [90, 90, 90],
        _ => [200, 160, 130],
    };
    let colours = scan.labels.as_ref().map(|labels| labels.iter().map(shade).collect());
    experiment.write("scans/right.ply", &write_ply(&Scan { labels: None, colours, ..scan.clone() }));
    experiment.write("scans/no-colours.ply", &bare);
    assert!(plan(&experiment).contains("has no colours, which the segmenter `colour` reads"));
    let subject = preprocess(&experiment);
    assert_eq!((subject.scans.len(), &*subject.skipped[0].name), (1, "no-colours"));
    assert!(subject.skipped[0].problem.contains("vertex colours"), "{}", subject.skipped[0].problem);
}

#[test]
fn label_images_of_the_views_bring_the_labels_back() {
    let scan = person();
    let labels = "type = \"labels\"\npath = \"labels\"\nmap = \"lip\"";
    let edits = [("type = \"vertex\"", labels), ("count = 8\nsize = 128", "count = 16\nsize = 256")];
    let experiment = Experiment::new(&edited(&tiny_on_scans("scans", &[]), &edits));
    experiment.write("scans/anna.ply", &write_ply(&Scan { labels: None, colours: None, ..scan.clone() }));
    for (index, picture) in label_images(&scan, 16, 256).iter().enumerate() {
        experiment.write(&format!("labels/anna_{index:03}.png"), picture);
    }
    let subject = preprocess(&experiment);
    let truth = scan.labels.as_ref().expect("labels");
    let same = truth.iter().zip(&subject.scans[0].points.labels).filter(|(a, b)| a == b).count();
    let share = same as f64 / truth.len() as f64;
    assert!(share >= 0.97, "{:.1} % of the labels", 100.0 * share);
    // Images are inputs: without one of them the stage is not up to date, and says which is missing.
    std::fs::remove_file(experiment.folder.path().join("labels/anna_003.png")).expect("an image");
    let said =
        Run::open(&experiment.config(), Some(experiment.out())).and_then(Run::all).expect_err("an error").to_string();
    assert!(said.contains("view 3") && said.contains("views.count"), "{said}");
}
