//! OBJ and PLY against independent readers, on files whose every choice is drawn at random.

use caphy_formats::obj::read_obj;
use caphy_formats::ply::read_ply;
use obj::raw::object::Polygon;
use ply_rs_bw::parser::Parser;
use ply_rs_bw::ply::{DefaultElement, Property};
use std::fmt::Write;
use std::path::Path;

/// Numbers that only look random: the same ones on every machine.
struct Draw(u64);

impl Draw {
    fn below(&mut self, n: u64) -> u64 {
        self.0 = self.0.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (self.0 >> 33) % n
    }
    fn pick<'a, T>(&mut self, from: &'a [T]) -> &'a T {
        &from[self.below(from.len() as u64) as usize]
    }
}

/// A circle's corners lie on a convex polygon, so that a fan is the only right answer.
fn circle(k: u64, n: u64) -> [f64; 2] {
    let angle = std::f64::consts::TAU * k as f64 / n as f64;
    [angle.cos(), angle.sin()]
}

#[test]
fn obj_agrees_with_obj_rs() {
    for seed in 0..200 {
        let mut draw = Draw(seed);
        let n = 3 + draw.below(30);
        let (uvs, normals) = (draw.below(2) == 1, draw.below(2) == 1);
        let end = *draw.pick(&["\n", "\r\n"]);
        let mut text = format!("# drawn\nmtllib a.mtl{end}o name\n");
        for k in 0..n {
            let [x, y] = circle(k, n);
            match draw.below(3) {
                0 => write!(text, "v {x:.6} {y:.6} 0").unwrap(),
                1 => write!(text, "v\t{x:e}  {y} -0.0 1.0 ").unwrap(),
                _ => write!(text, "  v {x:+.3} {y:.12} 0e0 # at {k}").unwrap(),
            }
            text += end;
            write!(text, "vt {:.4} {:.5}{end}vn 0 0 {}{end}", x.abs(), y.abs(), k + 1).unwrap();
        }
        for _ in 0..draw.below(20) {
            let corners = 3 + draw.below(n.min(6) - 2);
            let first = draw.below(n - corners + 1);
            text += *draw.pick(&["f", "f ", "fo\t"]);
            for k in first..first + corners {
                let id = if draw.below(3) == 0 { k as i64 - n as i64 } else { k as i64 + 1 };
                match (uvs, normals) {
                    (false, false) => write!(text, " {id}").unwrap(),
                    (true, false) => write!(text, " {id}/{}", n - k).unwrap(),
                    (false, true) => write!(text, " {id}//{id}").unwrap(),
                    (true, true) => write!(text, " {id}/{}/{id}", n - k).unwrap(),
                }
            }
            text += end;
            if draw.below(4) == 0 {
                write!(text, "g part{}{end}s off{end}usemtl m{end}", draw.below(3)).unwrap();
            }
        }
        let ours = read_obj(Path::new("a.obj"), text.as_bytes()).unwrap();
        let theirs = obj::raw::parse_obj(text.as_bytes()).unwrap();
        assert_eq!(ours.scan.mesh.vertices.len(), theirs.positions.len());
        for (p, q) in ours.scan.mesh.vertices.iter().zip(&theirs.positions) {
            // obj-rs rounds to f32: half a unit in the last of 24 bits.
            for (a, b) in [(p.x, q.0), (p.y, q.1), (p.z, q.2)] {
                assert!((a - f64::from(b)).abs() <= 6e-8 * a.abs(), "{a} is not {b}");
            }
        }
        let (mut faces, mut uv_faces, mut normal_faces) = (Vec::new(), Vec::new(), Vec::new());
        for polygon in &theirs.polygons {
            let corners: Vec<[usize; 3]> = match polygon {
                Polygon::P(c) => c.iter().map(|&p| [p, 0, 0]).collect(),
                Polygon::PT(c) => c.iter().map(|&(p, t)| [p, t, 0]).collect(),
                Polygon::PN(c) => c.iter().map(|&(p, n)| [p, 0, n]).collect(),
                Polygon::PTN(c) => c.iter().map(|&(p, t, n)| [p, t, n]).collect(),
            };
            for k in 2..corners.len() {
                let triangle = [corners[0], corners[k - 1], corners[k]];
                faces.push(triangle.map(|c| c[0] as u32));
                uv_faces.push(triangle.map(|c| c[1] as u32));
                normal_faces.push(triangle.map(|c| c[2] as u32));
            }
        }
        assert_eq!(ours.scan.mesh.faces, faces, "seed {seed}:\n{text}");
        assert_eq!(ours.uvs.map(|u| u.faces), (uvs && !faces.is_empty()).then_some(uv_faces));
        let vectors = ours.normals.as_ref().map(|n| n.vectors.iter().map(|v| v.z as f32).collect::<Vec<_>>());
        assert_eq!(ours.normals.map(|u| u.faces), (normals && !faces.is_empty()).then_some(normal_faces));
        if let Some(vectors) = vectors {
            assert_eq!(vectors, theirs.normals.iter().map(|v| v.2).collect::<Vec<_>>());
        }
    }
}

const KINDS: [(&str, &str); 8] = [
    ("char", "int8"),
    ("uchar", "uint8"),
    ("short", "int16"),
    ("ushort", "uint16"),
    ("int", "int32"),
    ("uint", "uint32"),
    ("float", "float32"),
    ("double", "float64"),
];

#[derive(Clone, Copy, PartialEq)]
enum Order {
    Ascii,
    Little,
    Big,
}

/// Appends a number of a kind; its value must fit.
fn put(out: &mut Vec<u8>, order: Order, kind: usize, value: f64) {
    if order == Order::Ascii {
        out.extend(format!("{value} ").as_bytes());
        return;
    }
    let mut bytes = match kind {
        0 => (value as i8).to_le_bytes().to_vec(),
        1 => (value as u8).to_le_bytes().to_vec(),
        2 => (value as i16).to_le_bytes().to_vec(),
        3 => (value as u16).to_le_bytes().to_vec(),
        4 => (value as i32).to_le_bytes().to_vec(),
        5 => (value as u32).to_le_bytes().to_vec(),
        6 => (value as f32).to_le_bytes().to_vec(),
        _ => value.to_le_bytes().to_vec(),
    };
    if order == Order::Big {
        bytes.reverse();
    }
    out.extend(bytes);
}

fn number(property: &Property) -> f64 {
    match *property {
        Property::Char(x) => f64::from(x),
        Property::UChar(x) => f64::from(x),
        Property::Short(x) => f64::from(x),
        Property::UShort(x) => f64::from(x),
        Property::Int(x) => f64::from(x),
        Property::UInt(x) => f64::from(x),
        Property::Float(x) => f64::from(x),
        Property::Double(x) => x,
        ref list => panic!("{list:?} is a list"),
    }
}

fn list(property: &Property) -> Vec<u32> {
    match property {
        Property::ListChar(x) => x.iter().map(|&x| x as u32).collect(),
        Property::ListUChar(x) => x.iter().map(|&x| u32::from(x)).collect(),
        Property::ListShort(x) => x.iter().map(|&x| x as u32).collect(),
        Property::ListUShort(x) => x.iter().map(|&x| u32::from(x)).collect(),
        Property::ListInt(x) => x.iter().map(|&x| x as u32).collect(),
        Property::ListUInt(x) => x.clone(),
        other => panic!("{other:?} is no list of ids"),
    }
}

#[test]
fn ply_agrees_with_ply_rs_bw() {
    for seed in 0..300 {
        let mut draw = Draw(seed);
        let (order, name) = *draw.pick(&[
            (Order::Ascii, "ascii"),
            (Order::Little, "binary_little_endian"),
            (Order::Big, "binary_big_endian"),
        ]);
        let mut header = format!("ply\nformat {name} 1.0\ncomment drawn\nobj_info seed {seed}\n");
        let mut body = Vec::new();
        let n = 3 + draw.below(20);
        let faces = draw.below(10);
        let other = draw.below(3);
        // Elements in any order; properties in any order among extras, scalars and lists.
        let mut elements = vec!["vertex", "face", "other"];
        elements.rotate_left(draw.below(3) as usize);
        for element in elements {
            let count = [("vertex", n), ("face", faces), ("other", other)].iter().find(|e| e.0 == element).unwrap().1;
            writeln!(header, "element {element} {count}").unwrap();
            let mut columns: Vec<(String, usize, Option<usize>)> = match element {
                "vertex" => {
                    let kind = |draw: &mut Draw| *draw.pick(&[0, 2, 4, 6, 7]);
                    vec![
                        ("x".into(), kind(&mut draw), None),
                        ("y".into(), kind(&mut draw), None),
                        ("z".into(), 7, None),
                    ]
                }
                "face" => {
                    vec![("vertex_indices".into(), draw.below(6) as usize, Some(draw.below(6) as usize))]
                }
                // ply-rs-bw takes a line for an element without properties.
                _ => vec![("flag".into(), 4, None)],
            };
            for extra in 0..draw.below(3) {
                let length = (draw.below(2) == 1).then(|| draw.below(6) as usize);
                columns.push((format!("extra{extra}"), draw.below(8) as usize, length));
            }
            let turn = draw.below(columns.len() as u64) as usize;
            columns.rotate_left(turn);
            for (name, kind, length) in &columns {
                let word =
                    |draw: &mut Draw, kind: usize| if draw.below(2) == 0 { KINDS[kind].0 } else { KINDS[kind].1 };
                match length {
                    Some(length) => {
                        let (a, b) = (word(&mut draw, *length), word(&mut draw, *kind));
                        writeln!(header, "property list {a} {b} {name}").unwrap();
                    }
                    None => writeln!(header, "property {} {name}", word(&mut draw, *kind)).unwrap(),
                }
            }
            for row in 0..count {
                for (name, kind, length) in &columns {
                    let [x, y] = circle(row, n);
                    match (name.as_str(), length) {
                        ("vertex_indices", Some(length)) => {
                            let corners = draw.below(n.min(6) + 1);
                            let first = draw.below(n - corners + 1);
                            put(&mut body, order, *length, corners as f64);
                            (first..first + corners).for_each(|k| put(&mut body, order, *kind, k as f64));
                        }
                        (_, Some(length)) => {
                            let items = draw.below(4);
                            put(&mut body, order, *length, items as f64);
                            (0..items).for_each(|k| put(&mut body, order, *kind, k as f64));
                        }
                        ("x" | "y", None) => {
                            // A circle of 100, whole where the column is.
                            let value = 100.0 * if name == "x" { x } else { y };
                            put(
                                &mut body,
                                order,
                                *kind,
                                if *kind < 6 { value.trunc() } else { f64::from(value as f32) },
                            );
                        }
                        ("z", None) => put(&mut body, order, *kind, 0.0),
                        _ => put(&mut body, order, *kind, draw.below(100) as f64),
                    }
                }
                if order == Order::Ascii {
                    body.push(b'\n');
                }
            }
        }
        header += "end_header\n";
        let bytes = [header.as_bytes(), &body].concat();
        let ours = read_ply(Path::new("a.ply"), &bytes).unwrap_or_else(|e| panic!("seed {seed}: {e}\n{header}"));
        let theirs = Parser::<DefaultElement>::new().read_ply(&mut bytes.as_slice());
        let theirs = theirs.unwrap_or_else(|e| panic!("seed {seed}: {e}\n{header}"));
        let vertices: Vec<[f64; 3]> =
            theirs.payload["vertex"].iter().map(|v| ["x", "y", "z"].map(|axis| number(&v[axis]))).collect();
        assert_eq!(ours.mesh.vertices.iter().map(|v| [v.x, v.y, v.z]).collect::<Vec<_>>(), vertices, "seed {seed}");
        // Polygons on a circle are convex (all but flat where whole numbers coincide): compared corner by corner.
        let mut covered: Vec<u32> = ours.mesh.faces.iter().flatten().copied().collect();
        let mut wanted = Vec::new();
        let mut triangles = 0;
        for face in theirs.payload.get("face").into_iter().flatten() {
            let polygon = list(&face["vertex_indices"]);
            if polygon.len() >= 3 {
                wanted.extend(polygon.iter().copied());
                triangles += polygon.len() - 2;
            }
        }
        assert_eq!(ours.mesh.faces.len(), triangles, "seed {seed}");
        for ids in [&mut covered, &mut wanted] {
            ids.sort_unstable();
            ids.dedup();
        }
        assert_eq!(covered, wanted, "seed {seed}");
    }
}
