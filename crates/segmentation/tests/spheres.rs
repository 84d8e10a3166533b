//! Fusion on scans made here: nested spheres whose right labels are known.

use caphy_core::scan::{Label, Scan};
use caphy_core::segmenter::{Segmenter, View};
use caphy_core::{Result, TriMesh, Vec3};
use caphy_segmentation::colour::PaletteEntry;
use caphy_segmentation::{
    FusionSettings, SegmenterColour, SegmenterColourSpec, SegmenterVertex, label_picture, label_scan,
};

const SKIN: [u8; 3] = [200, 155, 124];
const SHIRT: [u8; 3] = [57, 80, 161];
const SKIRT: [u8; 3] = [60, 60, 64];

/// The part of a sphere between two heights (in radii), as a grid of rings and sectors; a pole is a ring of coincident
/// vertices.
fn sphere(radius: f64, heights: (f64, f64), rings: u32, sectors: u32) -> TriMesh {
    let mut mesh = TriMesh::default();
    let (top, bottom) = (heights.1.acos(), heights.0.acos());
    for r in 0..=rings {
        let a = top + (bottom - top) * f64::from(r) / f64::from(rings);
        for s in 0..sectors {
            let b = std::f64::consts::TAU * f64::from(s) / f64::from(sectors);
            mesh.vertices.push(radius * Vec3::new(a.sin() * b.sin(), a.cos(), a.sin() * b.cos()));
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

fn add(scan: &mut Scan, part: TriMesh, label: Label, colour: [u8; 3]) {
    let offset = scan.mesh.vertices.len() as u32;
    let count = part.vertices.len();
    scan.mesh.vertices.extend(part.vertices);
    scan.mesh.faces.extend(part.faces.iter().map(|f| f.map(|id| id + offset)));
    scan.labels.get_or_insert_default().extend(std::iter::repeat_n(label, count));
    scan.colours.get_or_insert_default().extend(std::iter::repeat_n(colour, count));
}

/// A body of radius 0.5 m, a shirt 5 mm over its upper part, a skirt 8 mm over its lower part, and something inside the
/// body that nobody can see.
fn dressed() -> Scan {
    let mut scan = Scan { name: "spheres".into(), ..Scan::default() };
    add(&mut scan, sphere(0.5, (-1.0, 1.0), 60, 90), Label::Body, SKIN);
    add(&mut scan, sphere(0.505, (0.1, 0.8), 24, 90), Label::Upper, SHIRT);
    add(&mut scan, sphere(0.508, (-0.8, 0.0), 28, 90), Label::Lower, SKIRT);
    add(&mut scan, sphere(0.05, (-1.0, 1.0), 8, 12), Label::Body, SKIN);
    scan
}

fn colour() -> SegmenterColour {
    let entry = |label, colour| PaletteEntry { label, colour };
    let palette = vec![entry(Label::Body, SKIN), entry(Label::Upper, SHIRT), entry(Label::Lower, SKIRT)];
    SegmenterColour::new(&SegmenterColourSpec {
        palette,
        seeds: vec![],
        max_distance: None,
        far: Label::Ignore,
        outline: 0,
    })
    .unwrap()
}

/// Share of the vertices where two labellings agree.
fn agreement(a: &[Label], b: &[Label]) -> f64 {
    a.iter().zip(b).filter(|(a, b)| a == b).count() as f64 / a.len() as f64
}

#[test]
fn nested_spheres_are_told_apart_by_labels_and_by_colours() {
    let scan = dressed();
    let truth = scan.labels.clone().unwrap();
    let hidden = truth.len() - 9 * 12;
    for (name, segmenter) in [("vertex", &SegmenterVertex as &dyn Segmenter), ("colour", &colour())] {
        let fusion = label_scan(&scan, segmenter, &FusionSettings::default()).unwrap();
        let visible = agreement(&fusion.labels[..hidden], &truth[..hidden]);
        println!("{name}: {:.2} % agree, {:?}", 100.0 * visible, fusion.report);
        // Everything but rows of vertices right at a hem.
        assert!(visible > 0.985, "{name}: {visible}");
        assert!(fusion.labels.iter().all(|l| *l != Label::Ignore));
        // The ball inside is unseen, and so is nearly all skin under the cloth.
        assert!(fusion.seen[hidden..].iter().all(|s| !s));
        let under = |v: &usize| (0.2..0.7).contains(&(scan.mesh.vertices[*v].y / 0.5));
        let skin: Vec<usize> = (0..61 * 90).filter(under).collect();
        assert!(skin.iter().filter(|v| fusion.seen[**v]).count() * 100 < skin.len());
        assert_eq!(fusion.report.counts.iter().sum::<usize>(), truth.len());
    }
}

#[test]
fn the_same_bits_on_one_thread_and_on_four() {
    let scan = dressed();
    let settings = FusionSettings { views: 8, size: 128, ..FusionSettings::default() };
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| label_scan(&scan, &colour(), &settings).unwrap())
    };
    assert_eq!(run(1), run(4));
}

#[test]
fn scans_that_cannot_be_labelled_are_named() {
    let mut scan = dressed();
    let settings = FusionSettings { views: 4, size: 64, ..FusionSettings::default() };
    let message = |scan: &Scan, segmenter: &dyn Segmenter, settings: &FusionSettings| {
        label_scan(scan, segmenter, settings).unwrap_err().to_string()
    };
    let empty = Scan { name: "hollow".into(), ..Scan::default() };
    assert!(message(&empty, &SegmenterVertex, &settings).contains("hollow"));
    /// Sees nothing anywhere.
    struct Blind;
    impl Segmenter for Blind {
        fn segment(&self, _: &View<'_>, labels: &mut [Label]) -> Result<()> {
            labels.fill(Label::Ignore);
            Ok(())
        }
    }
    assert!(message(&scan, &Blind, &settings).contains("none of the 4 views"));
    scan.colours = None;
    assert!(message(&scan, &colour(), &settings).contains("spheres"));
    scan.mesh.faces[7][1] = 1 << 30;
    assert!(message(&scan, &SegmenterVertex, &settings).contains("face 7"));
    let scan = dressed();
    for (key, wrong) in [
        ("views", FusionSettings { views: 0, ..settings }),
        ("size", FusionSettings { size: 3, ..settings }),
        ("depth_tolerance", FusionSettings { depth_tolerance: f64::NAN, ..settings }),
        ("min_facing", FusionSettings { min_facing: 1.5, ..settings }),
    ] {
        assert!(message(&scan, &SegmenterVertex, &wrong).contains(key));
    }
}

#[test]
fn flat_and_tiny_scans_are_labelled() {
    // A single triangle: seen from both sides; edge-on views have nothing to say.
    let vertices = vec![Vec3::zeros(), Vec3::x(), Vec3::y()];
    let mut scan = Scan {
        name: "one".into(),
        mesh: TriMesh { vertices, faces: vec![[0, 1, 2]] },
        colours: None,
        labels: Some(vec![Label::Upper; 3]),
    };
    let fusion = label_scan(&scan, &SegmenterVertex, &FusionSettings::default()).unwrap();
    assert_eq!(fusion.labels, [Label::Upper; 3]);
    assert_eq!((fusion.report.unseen, fusion.report.disagreement), (0.0, 0.0));
    // A vertex of no face is still labelled, from the nearest.
    scan.mesh.vertices.push(Vec3::new(0.9, 0.1, 3.0));
    scan.labels = Some(vec![Label::Upper, Label::Lower, Label::Upper, Label::Body]);
    let fusion = label_scan(&scan, &SegmenterVertex, &FusionSettings { smoothing: 0, ..FusionSettings::default() });
    assert_eq!(fusion.unwrap().labels[3], Label::Lower);
}

#[test]
fn settings_parse_with_defaults_and_refuse_unknown_keys() {
    let settings: FusionSettings = toml::from_str("views = 12\nmin_facing = 0.3").unwrap();
    assert_eq!(settings, FusionSettings { views: 12, min_facing: 0.3, ..FusionSettings::default() });
    assert!(toml::from_str::<FusionSettings>("view = 12").unwrap_err().to_string().contains("view"));
}

#[test]
fn a_label_picture_needs_a_label_per_vertex() {
    let scan = dressed();
    let camera =
        caphy_render::frame(scan.mesh.bounds().unwrap(), &Vec3::z(), caphy_render::Projection::Orthographic, 32, 32);
    assert_eq!(label_picture(&scan, scan.labels.as_deref().unwrap(), &camera).unwrap().pixels.len(), 1024);
    assert!(label_picture(&scan, &[Label::Body], &camera).unwrap_err().to_string().contains("spheres"));
}
