//! PLY and OBJ: what is read and what is refused.

mod support;

use caphy_core::scan::{Label, Scan};
use caphy_core::{TriMesh, Vec3};
use caphy_formats::obj::{read_obj, write_obj};
use caphy_formats::ply::{read_ply, write_ply};
use std::path::Path;

fn ply(bytes: &[u8]) -> caphy_core::Result<Scan> {
    read_ply(Path::new("p/scan.ply"), bytes)
}

fn tetrahedron() -> Scan {
    let p = |x, y, z| Vec3::new(x, y, z);
    Scan {
        name: "scan".into(),
        mesh: TriMesh::new(
            "t",
            vec![p(0.0, 0.0, 0.0), p(1.0, 0.0, 0.0), p(0.0, 1.5, 0.0), p(0.25, 0.0, -1.0)],
            vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]],
        )
        .unwrap(),
        colours: Some(vec![[1, 2, 3], [255, 0, 7], [9, 8, 7], [0, 0, 0]]),
        labels: Some(vec![Label::Body, Label::Upper, Label::Lower, Label::Ignore]),
    }
}

#[test]
fn ply_written_is_read_back() {
    let scan = tetrahedron();
    assert_eq!(ply(&write_ply(&scan)).unwrap(), scan);
    let bare = Scan { colours: None, labels: None, ..scan };
    assert_eq!(ply(&write_ply(&bare)).unwrap(), bare);
    let empty = Scan { name: "scan".into(), ..Scan::default() };
    assert_eq!(ply(&write_ply(&empty)).unwrap(), empty);
}

const ASCII: &str = "ply\nformat ascii 1.0\ncomment made by hand\nelement vertex 5\nproperty double x\nproperty float y\n\
    property float z\nproperty float quality\nproperty uchar red\nproperty uchar green\nproperty uchar blue\n\
    property uchar alpha\nproperty int label\nelement face 2\nproperty list uchar int vertex_index\n\
    property list uchar float texcoord\nelement edge 1\nproperty int vertex1\nend_header\n\
    0 0 0 0.5 10 20 30 255 0\n1 0 0 0.5 10 20 30 255 1\n1 1 0 0.5 10 20 30 255 2\n0 1 0 0.5 10 20 30 255 9\n\
    -1 0.5 1e-3 0.5 10 20 30 255 -4\n5 0 1 2 3 4 2 0.5 0.5\n3 0 1 1 0\n7\n";

#[test]
fn ascii_with_polygons_and_extras() {
    let scan = ply(ASCII.as_bytes()).unwrap();
    assert_eq!(scan.mesh.vertices[4], Vec3::new(-1.0, 0.5, 1e-3));
    // A pentagon becomes three triangles; the second face names a vertex twice.
    assert_eq!(scan.mesh.faces, [[0, 1, 2], [0, 2, 3], [0, 3, 4]]);
    assert_eq!(scan.colours.unwrap()[0], [10, 20, 30]);
    assert_eq!(scan.labels.unwrap(), [Label::Body, Label::Upper, Label::Lower, Label::Ignore, Label::Ignore]);
    assert_eq!(ply(ASCII.replace('\n', "\r\n").as_bytes()).unwrap().mesh, ply(ASCII.as_bytes()).unwrap().mesh);
}

#[test]
fn big_endian_and_faces_first() {
    let mut bytes = b"ply\nformat binary_big_endian 1.0\nelement face 1\nproperty list ushort uint vertex_indices\n\
        element vertex 3\nproperty float x\nproperty double y\nproperty short z\nend_header\n"
        .to_vec();
    bytes.extend(3u16.to_be_bytes());
    [0u32, 1, 2].iter().for_each(|i| bytes.extend(i.to_be_bytes()));
    for (x, y, z) in [(1.5f32, -2.25f64, 7i16), (0.0, 1.0, 0), (2.0, 0.0, -1)] {
        bytes.extend(x.to_be_bytes());
        bytes.extend(y.to_be_bytes());
        bytes.extend(z.to_be_bytes());
    }
    let scan = ply(&bytes).unwrap();
    assert_eq!(scan.mesh.vertices[0], Vec3::new(1.5, -2.25, 7.0));
    assert_eq!((scan.mesh.faces, scan.colours), (vec![[0, 1, 2]], None));
}

#[test]
fn bad_ply_is_refused_with_place_and_value() {
    let cases: [(&str, &str, &[&str]); 10] = [
        ("1 1 0 0.5", "nan 1 0 0.5", &["scan.ply", "`vertex` 2 of 5", "NaN"]),
        ("1 1 0 0.5", "1 1e999 0 0.5", &["`vertex` 2 of 5", "inf"]),
        ("1 1 0 0.5", "1 1 zero 0.5", &["`vertex` 2 of 5", "zero"]),
        ("5 0 1 2 3 4", "5 0 1 2 3 5", &["`face` 0 of 2", "vertex id 5", "5 vertices"]),
        ("5 0 1 2 3 4", "5 0 1 2 3 -1", &["`face` 0 of 2", "vertex id -1"]),
        ("5 0 1 2 3 4", "-5 0 1 2 3 4", &["`face` 0 of 2", "length -5"]),
        ("element vertex 5", "element vertex 5000000000", &["`vertex`", "5000000000", "too short"]),
        ("property float y", "property float why", &["no property `y`"]),
        ("property float quality", "property float y", &["twice"]),
        ("vertex_index", "corners", &["vertex_indices"]),
    ];
    for (from, to, words) in cases {
        assert!(ASCII.contains(from));
        let text = ply(ASCII.replacen(from, to, 1).as_bytes()).unwrap_err().to_string();
        assert!(words.iter().all(|w| text.contains(w)), "{to}: {text}");
    }
}

#[test]
fn the_stand_in_scans_are_read() {
    for pose in ["apose", "kneeup", "star"] {
        let Some(bytes) = support::shared(&format!("data/scans/p1_{pose}.ply")) else { return };
        let scan = ply(&bytes).unwrap();
        scan.mesh.check("scan").unwrap();
        assert_eq!((scan.mesh.vertices.len(), scan.mesh.faces.len()), (50672, 100768));
        let labels = scan.labels.as_ref().unwrap();
        assert!(Label::ALL.iter().all(|l| labels.contains(l)) && !labels.contains(&Label::Ignore));
        assert_eq!(ply(&write_ply(&scan)).unwrap(), Scan { name: "scan".into(), ..scan });
    }
}

fn obj(text: &str) -> caphy_core::Result<caphy_formats::obj::ObjMesh> {
    read_obj(Path::new("scan.obj"), text.as_bytes())
}

const CUBE_SIDE: &str = "# a side\nmtllib a b.mtl\no side of a cube\nv 0 0 0 1 0 0.5\nv 1 0 0 1 0 0.5\nv 1 1 0 1 0 0.5\n\
    v 0 1 0 1 0 0.5\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nvt 0.5 0.5\nvn 0 0 1\ng one two\nusemtl skin tone\ns 1\n\
    f 1/1/1 2/2/1 \\\n3/3/1 4/4/1\nf -4/5 -3/2 -2/3\nl 1 2\n";

#[test]
fn obj_with_polygons_seams_and_colours() {
    let mesh = obj(CUBE_SIDE).unwrap();
    assert_eq!(mesh.scan.mesh.faces, [[0, 1, 2], [0, 2, 3], [0, 1, 2]]);
    let uvs = mesh.uvs.unwrap();
    assert_eq!((uvs.coords.len(), uvs.faces), (5, vec![[0, 1, 2], [0, 2, 3], [4, 1, 2]]));
    assert_eq!(mesh.scan.colours.unwrap(), [[255, 0, 128]; 4]);
    // One face without texture coordinates, one vertex without colour: then none.
    let mesh = obj(&CUBE_SIDE.replace("-4/5 -3/2 -2/3", "1 2 3").replacen(" 1 0 0.5", "", 1)).unwrap();
    assert!(mesh.uvs.is_none() && mesh.scan.colours.is_none());
    assert_eq!(obj("").unwrap().scan.mesh, TriMesh::default());
}

#[test]
fn obj_in_the_forms_that_programs_write() {
    let square = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n";
    let faces = |text: &str| obj(text).unwrap().scan.mesh.faces;
    let two = [[0, 1, 2], [0, 2, 3]];
    for (what, text) in [
        ("line feeds", format!("{square}f 1 2 3 4\n")),
        ("no last line feed", format!("{square}f 1 2 3 4")),
        ("carriage returns and line feeds", format!("{square}f 1 2 3 4\n").replace('\n', "\r\n")),
        ("carriage returns", format!("{square}f 1 2 3 4\n").replace('\n', "\r")),
        ("a byte order mark", format!("\u{feff}{square}f 1 2 3 4\n")),
        ("tabs and blanks", format!("{square}\tf  1\t2 3 4 \t\n").replace("v 1", "v \t 1")),
        ("backslashes", format!("{square}f 1 2\\\n 3 \\ \r\n4\n")),
        ("a backslash that is no continuation", format!("mtllib c:\\a b\\c.mtl\n{square}f 1 2 3 4\n")),
        ("a comment right behind", format!("{square}f 1 2 3 4#5\n# f 1 2 3 \\\n")),
        ("faces first", format!("f 1 2 3 4\n{square}")),
        ("counted backwards", format!("{square}f -4 -3 -2 -1\n")),
        ("empty slashes", format!("{square}f 1/ 2/ 3/ 4/\n")),
        ("double empty slashes", format!("{square}f 1// 2// 3// 4//\n")),
        ("everything that is skipped", format!("{square}vp 1 2\ns 1\nmg 1 2\nlod 3\nl 1 2\np 1\nf 1 2 3 4\n")),
    ] {
        assert_eq!(faces(&text), two, "{what}");
    }
    // A dart, from its inner corner: the other diagonal.
    assert_eq!(faces("v 0 0 0\nv 2 0 0\nv 0.5 0.5 0\nv 0 2 0\nf 2 3 4 1\n"), [[2, 3, 0], [2, 0, 1]]);
    // Positions keep their double precision.
    assert_eq!(obj("v 0.1234567890123 1e-300 -7\n").unwrap().scan.mesh.vertices[0].x, 0.1234567890123);
}

#[test]
fn obj_colours_in_either_range() {
    let colours = |text: &str| obj(text).unwrap().scan.colours.unwrap();
    assert_eq!(colours("v 0 0 0 1 0.5 0\nv 1 0 0 1.01 0 0.002\n"), [[255, 128, 0], [255, 0, 1]]);
    assert_eq!(colours("v 0 0 0 255 128 1\nv 1 0 0 0 0 0.6\n"), [[255, 128, 1], [0, 0, 1]]);
    assert_eq!(colours("v 0 0 0 255 128 1 255\n"), [[255, 128, 1]]);
    let float = "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\n\
        property float diffuse_red\nproperty float diffuse_green\nproperty ushort diffuse_blue\nend_header\n0 0 0 ";
    assert_eq!(ply(format!("{float}1 0.5 65535").as_bytes()).unwrap().colours.unwrap(), [[255, 128, 255]]);
    assert!(ply(format!("{float}1 nan 0").as_bytes()).unwrap_err().to_string().contains("colour"));
}

#[test]
fn obj_groups_hold_their_faces() {
    let text = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3\ng empty\no shirt\ng left  sleeve # one\nf 1 2 3 4\nf 1 1 2\n\
        g right\nf 1 2 4\ng nothing\nf 1 1 1\ng last\n";
    let groups = obj(text).unwrap().groups;
    let named: Vec<(&str, std::ops::Range<usize>)> =
        groups.iter().map(|g| (g.name.as_str(), g.faces.clone())).collect();
    assert_eq!(named, [("left sleeve", 1..3), ("right", 3..4)]);
}

#[test]
fn obj_normals_come_with_their_corners() {
    let text = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvn 0 0 1\nvn 0 1e-3 1\nf 1//1 2//-1 3//1 4//2\n";
    let normals = obj(text).unwrap().normals.unwrap();
    assert_eq!(normals.faces, [[0, 1, 0], [0, 0, 1]]);
    assert_eq!(normals.vectors[1], Vec3::new(0.0, 1e-3, 1.0));
    assert!(obj(&format!("{text}f 1 2 3\n")).unwrap().normals.is_none());
}

#[test]
fn ply_strips_and_other_line_ends() {
    let text = "ply\nformat ascii 1.0\nelement vertex 5\nproperty float x\nproperty float y\nproperty float z\n\
        element tristrips 1\nproperty list int int vertex_indices\nend_header\n0 0 0\n0 1 0\n1 0 0\n1 1 0\n2 0 0\n\
        9 0 1 2 3 -1 2 3 4 4\n";
    let wanted = [[0, 1, 2], [2, 1, 3], [2, 3, 4]];
    for ending in ["\n", "\r\n", "\r"] {
        assert_eq!(ply(text.replace('\n', ending).as_bytes()).unwrap().mesh.faces, wanted, "{ending:?}");
    }
    // Binary data right behind a carriage return may start with a line feed.
    let mut bytes = b"ply\rformat binary_little_endian 1.0\relement vertex 1\rproperty uchar x\rproperty uchar y\r\
        property uchar z\rend_header\r"
        .to_vec();
    bytes.extend(b"\n\r\n");
    assert_eq!(ply(&bytes).unwrap().mesh.vertices, [Vec3::new(10.0, 13.0, 10.0)]);
}

#[test]
fn obj_written_is_read_back() {
    let scan = tetrahedron();
    let bytes = write_obj(&scan.mesh, scan.colours.as_deref()).unwrap();
    let back = read_obj(Path::new("scan.obj"), &bytes).unwrap();
    assert_eq!(back.scan, Scan { labels: None, ..scan.clone() });
    assert!(write_obj(&scan.mesh, Some(&[])).is_err());
}

#[test]
fn bad_obj_is_refused_with_place_and_value() {
    for (from, to, words) in [
        ("f -4/5", "f 9/5", ["scan.obj", "line 19", "`9/5`", "index 9"]),
        ("f -4/5", "f 0/5", ["scan.obj", "line 19", "`0/5`", "zero"]),
        ("f -4/5 -3/2 -2/3", "f -4/5 -3/2", ["scan.obj", "line 19", "2 corners", "at least 3"]),
        ("v 1 1 0 1 0 0.5", "v 1 1", ["scan.obj", "line 6", "2 numbers", "x y z"]),
        ("v 1 1 0 1 0 0.5", "v 1 1 0 red 0 0", ["scan.obj", "line 6", "`red`", "no number"]),
        ("v 1 1 0 1 0 0.5", "v 1 nan 0", ["scan.obj", "line 6", "vertex 3", "NaN"]),
        ("v 1 1 0 1 0 0.5", "v 1 1e400 0", ["scan.obj", "line 6", "vertex 3", "inf"]),
        ("f -4/5 -3/2 -2/3", "f -4/5 -3 -2/3", ["scan.obj", "line 19", "`-3`", "corners before"]),
        ("f -4/5 -3/2 -2/3", "f -4/5 -3/2 -2/3/4/5", ["scan.obj", "line 19", "-2/3/4/5", "1/2/3"]),
        ("f -4/5 -3/2 -2/3", "f -5/5 -3/2 -2/3", ["scan.obj", "line 19", "index -5", "4 vertices"]),
        ("f -4/5 -3/2 -2/3", "f -4/6 -3/2 -2/3", ["scan.obj", "line 19", "index 6", "5 texture"]),
        ("f -4/5 -3/2 -2/3", "f 99999999999999999999/5 1/2 2/3", ["scan.obj", "line 19", "index 1", "4 vertices"]),
        ("f -4/5 -3/2 -2/3", "f 1 2 x", ["scan.obj", "line 19", "`x`", "1/2/3"]),
        ("vn 0 0 1", "vn 0 0", ["scan.obj", "line 13", "2 numbers", "x y z"]),
        ("vt 1 1", "vt 1 inf", ["scan.obj", "line 10", "inf", "finite"]),
        ("v 1 1 0 1 0 0.5", "v 1 1 0 1 nan 0.5", ["scan.obj", "line 6", "vertex 3", "colour"]),
        ("v 1 1 0 1 0 0.5", "v 1 1 0 1 0 0.5 1 9", ["scan.obj", "line 6", "more than 7", "numbers"]),
        ("v 1 1 0 1 0 0.5", "w 1 1 0 1 0 0.5", ["scan.obj", "line 6", "`w`", "no statement"]),
        ("s 1", "call other.obj", ["scan.obj", "line 16", "another file", "call"]),
        ("l 1 2\n", "l 1 2 \\\n", ["scan.obj", "last line", "backslash", "cut off"]),
        ("s 1", "cstype bspline", ["scan.obj", "line 16", "free-form", "cstype"]),
    ] {
        assert!(CUBE_SIDE.contains(from));
        let text = obj(&CUBE_SIDE.replacen(from, to, 1)).unwrap_err().to_string();
        assert!(words.iter().all(|w| text.contains(w)), "{to}: {text}");
    }
}

#[test]
fn the_reference_tube_is_read() {
    let Some(bytes) = support::shared("reference/tube.obj") else { return };
    let tube = read_obj(Path::new("tube.obj"), &bytes).unwrap();
    assert_eq!((tube.scan.mesh.vertices.len(), tube.scan.mesh.faces.len()), (1488, 2880));
    assert_eq!(tube.uvs.unwrap().coords.len(), 1519);
}
