//! Readers on files of 100 000 vertices and about 200 000 triangles, beside independent readers of the same files.

use caphy_core::scan::{Label, Scan};
use caphy_core::{TriMesh, Vec3};
use caphy_formats::npz::Npz;
use caphy_formats::obj::read_obj;
use caphy_formats::ply::{read_ply, write_ply};
use criterion::measurement::{Measurement, ValueFormatter, WallTime};
use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use ply_rs_bw::parser::Parser;
use ply_rs_bw::ply::DefaultElement;
use std::fmt::Write;
use std::hint::black_box;
use std::path::Path;

#[path = "../tests/support/mod.rs"]
mod support;

/// Time [ns] that this thread had a processor, so that a machine which others use gives the same figures; the readers use
/// one thread and wait for nothing. Known to a scheduler's tick (1 to 4 ms), which many iterations average out.
struct ThreadTime;

impl ThreadTime {
    fn now() -> u64 {
        let text = std::fs::read_to_string("/proc/thread-self/schedstat").expect("Linux's scheduler statistics");
        text.split_whitespace().next().and_then(|ns| ns.parse().ok()).expect("nanoseconds on a processor")
    }
}

impl Measurement for ThreadTime {
    type Intermediate = u64;
    type Value = u64;
    fn start(&self) -> u64 {
        Self::now()
    }
    fn end(&self, start: u64) -> u64 {
        // A sample shorter than a tick must not be nothing.
        (Self::now() - start).max(1)
    }
    fn add(&self, a: &u64, b: &u64) -> u64 {
        a + b
    }
    fn zero(&self) -> u64 {
        0
    }
    fn to_f64(&self, value: &u64) -> f64 {
        *value as f64
    }
    fn formatter(&self) -> &dyn ValueFormatter {
        WallTime.formatter()
    }
}

/// Vertices along each side of the sheet.
const SIDE: usize = 317;

/// A wavy sheet of SIDE × SIDE vertices [m].
fn sheet() -> Scan {
    let mut mesh = TriMesh::default();
    for i in 0..SIDE {
        for j in 0..SIDE {
            let (x, y) = (i as f64 / SIDE as f64, j as f64 / SIDE as f64);
            mesh.vertices.push(Vec3::new(x - 0.5, y + 0.1, 0.2 * (9.0 * x).sin() * (7.0 * y).cos()));
        }
    }
    let id = |i: usize, j: usize| (i * SIDE + j) as u32;
    for i in 1..SIDE {
        for j in 1..SIDE {
            let (a, b, c, d) = (id(i - 1, j - 1), id(i, j - 1), id(i, j), id(i - 1, j));
            mesh.faces.extend([[a, b, c], [a, c, d]]);
        }
    }
    let colours = (0..mesh.vertices.len()).map(|i| [(i % 256) as u8, (i / 256 % 256) as u8, 128]).collect();
    let labels = (0..mesh.vertices.len()).map(|i| Label::from_byte((i % 3) as u8)).collect();
    Scan { name: "sheet".into(), mesh, colours: Some(colours), labels: Some(labels) }
}

/// Positions of 6 decimals, as Blender and most scanners write them; the rest on demand.
fn obj_text(scan: &Scan, colours: bool, attributes: bool) -> String {
    let mut text = String::new();
    for (i, v) in scan.mesh.vertices.iter().enumerate() {
        write!(text, "v {:.6} {:.6} {:.6}", v.x, v.y, v.z).unwrap();
        if let (true, Some(all)) = (colours, &scan.colours) {
            let [r, g, b] = all[i].map(|c| f64::from(c) / 255.0);
            write!(text, " {r:.4} {g:.4} {b:.4}").unwrap();
        }
        text.push('\n');
    }
    if attributes {
        for v in &scan.mesh.vertices {
            writeln!(text, "vt {:.6} {:.6}", v.x + 0.5, v.y).unwrap();
        }
        for v in scan.mesh.vertex_normals() {
            writeln!(text, "vn {:.4} {:.4} {:.4}", v.x, v.y, v.z).unwrap();
        }
    }
    for f in &scan.mesh.faces {
        let [a, b, c] = f.map(|id| id + 1);
        if attributes {
            writeln!(text, "f {a}/{a}/{a} {b}/{b}/{b} {c}/{c}/{c}").unwrap();
        } else {
            writeln!(text, "f {a} {b} {c}").unwrap();
        }
    }
    text
}

fn obj(c: &mut Criterion<ThreadTime>) {
    let scan = sheet();
    let file = Path::new("sheet.obj");
    let mut group = c.benchmark_group("obj");
    for (name, colours, attributes) in
        [("positions", false, false), ("colours", true, false), ("uvs and normals", false, true)]
    {
        let text = obj_text(&scan, colours, attributes);
        let read = read_obj(file, text.as_bytes()).unwrap();
        assert_eq!(read.scan.mesh.faces, scan.mesh.faces);
        assert_eq!(read.scan.colours, scan.colours.clone().filter(|_| colours));
        assert_eq!(read.normals.is_some(), attributes);
        group.throughput(Throughput::Bytes(text.len() as u64));
        group.bench_function(name, |b| b.iter(|| read_obj(file, black_box(text.as_bytes())).unwrap()));
        // obj-rs has no vertex colours.
        if !colours {
            group.bench_function(format!("{name}, obj-rs"), |b| {
                b.iter(|| ::obj::raw::parse_obj(black_box(text.as_bytes())).unwrap())
            });
        }
    }
}

/// The same scan as text.
fn ply_text(scan: &Scan) -> Vec<u8> {
    let binary = write_ply(scan);
    let end = b"end_header\n";
    let header = binary.windows(end.len()).position(|w| w == end).unwrap() + end.len();
    let mut text = String::from_utf8(binary[..header].to_vec()).unwrap().replace("binary_little_endian", "ascii");
    let (colours, labels) = (scan.colours.as_ref().unwrap(), scan.labels.as_ref().unwrap());
    for (i, v) in scan.mesh.vertices.iter().enumerate() {
        let [r, g, b] = colours[i];
        writeln!(text, "{:.6} {:.6} {:.6} {r} {g} {b} {}", v.x, v.y, v.z, labels[i] as u8).unwrap();
    }
    for [a, b, c] in &scan.mesh.faces {
        writeln!(text, "3 {a} {b} {c}").unwrap();
    }
    text.into_bytes()
}

fn ply(c: &mut Criterion<ThreadTime>) {
    let scan = sheet();
    let file = Path::new("sheet.ply");
    let mut group = c.benchmark_group("ply");
    for (name, bytes) in [("binary", write_ply(&scan)), ("ascii", ply_text(&scan))] {
        let read = read_ply(file, &bytes).unwrap();
        assert_eq!((&read.mesh.faces, &read.colours, &read.labels), (&scan.mesh.faces, &scan.colours, &scan.labels));
        group.throughput(Throughput::Bytes(bytes.len() as u64));
        group.bench_function(name, |b| b.iter(|| read_ply(file, black_box(&bytes)).unwrap()));
        group.sample_size(10);
        group.bench_function(format!("{name}, ply-rs-bw"), |b| {
            b.iter(|| Parser::<DefaultElement>::new().read_ply(&mut black_box(bytes.as_slice())).unwrap())
        });
        group.sample_size(100);
    }
}

fn npz(c: &mut Criterion<ThreadTime>) {
    let scan = sheet();
    let mut group = c.benchmark_group("npz");
    let vertices = scan.mesh.vertices.iter().flat_map(|v| [v.x, v.y, v.z]);
    let faces = scan.mesh.faces.iter().flatten().map(|&id| i64::from(id));
    let shape = |rows: usize| [rows as u64, 3];
    let arrays = [
        ("vertices", support::array(&shape(scan.mesh.vertices.len()), vertices)),
        ("faces", support::array(&shape(scan.mesh.faces.len()), faces)),
    ];
    for (name, deflated) in [("stored", false), ("deflated", true)] {
        let bytes = support::archive(&arrays, deflated);
        group.throughput(Throughput::Bytes(bytes.len() as u64));
        group.bench_function(name, |b| {
            b.iter(|| {
                let npz = Npz::from_bytes(Path::new("sheet.npz"), bytes.clone()).unwrap();
                (npz.f64s("vertices").unwrap(), npz.i64s("faces").unwrap())
            })
        });
    }
}

criterion_group! {
    name = benches;
    config = Criterion::default().with_measurement(ThreadTime);
    targets = obj, ply, npz
}
criterion_main!(benches);
