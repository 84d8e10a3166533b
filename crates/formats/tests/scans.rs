//! PLY and OBJ: what is read, what is refused, and damage at every place.

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
fn ply_damage_anywhere_is_an_error_not_a_panic() {
    for whole in [write_ply(&tetrahedron()), ASCII.as_bytes().to_vec()] {
        // The last two bytes of the text file are a digit and a line feed.
        for cut in 0..whole.len() - 2 {
            let text = ply(&whole[..cut]).expect_err("cut off").to_string();
            assert!(text.contains("scan.ply"), "{text}");
        }
        for place in 0..whole.len() {
            for value in [0, b' ', b'9', 0x7f, 0xff] {
                let mut bad = whole.clone();
                bad[place] = value;
                let _ = ply(&bad);
            }
        }
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
        ("s 1", "cstype bspline", ["scan.obj", "line 16", "free-form", "cstype"]),
    ] {
        assert!(CUBE_SIDE.contains(from));
        let text = obj(&CUBE_SIDE.replacen(from, to, 1)).unwrap_err().to_string();
        assert!(words.iter().all(|w| text.contains(w)), "{to}: {text}");
    }
}

#[test]
fn obj_damage_anywhere_does_not_panic() {
    let whole = CUBE_SIDE.as_bytes();
    for cut in 0..whole.len() {
        // A text file that ends between two lines is a smaller mesh: ids are what can be checked.
        if let Ok(mesh) = read_obj(Path::new("scan.obj"), &whole[..cut]) {
            mesh.scan.mesh.check("cut").unwrap();
        }
        for value in [0, b' ', b'9', b'/', b'\\', 0xff] {
            let mut bad = whole.to_vec();
            bad[cut] = value;
            let _ = read_obj(Path::new("scan.obj"), &bad);
        }
    }
}

#[test]
fn the_reference_tube_is_read() {
    let Some(bytes) = support::shared("reference/tube.obj") else { return };
    let tube = read_obj(Path::new("tube.obj"), &bytes).unwrap();
    assert_eq!((tube.scan.mesh.vertices.len(), tube.scan.mesh.faces.len()), (1488, 2880));
    assert_eq!(tube.uvs.unwrap().coords.len(), 1519);
}
