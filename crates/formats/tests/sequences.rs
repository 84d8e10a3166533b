//! OBJ sequences, point caches and USD text: read again by the formats' own rules, and bad input refused by name.
//! `tests/validate_exports.py` of the workspace has independent readers do the same.

use caphy_core::{Error, Result, Vec3};
use caphy_formats::colour::MeshColour;
use caphy_formats::moving::{ComputedFrames, MovingMesh, VertexFrames};
use caphy_formats::obj::{ObjSequence, ObjUvs, read_obj};
use caphy_formats::pc2::{PC2_HEADER, Pc2Timing, write_pc2};
use caphy_formats::usd::{UsdScene, write_usda};
use std::path::Path;

const FACES: [[u32; 3]; 2] = [[0, 1, 2], [0, 2, 3]];
const COLOURS: [[u8; 3]; 4] = [[255, 0, 0], [0, 255, 0], [0, 0, 255], [51, 102, 255]];

/// A square that bends over `count` frames; coordinates that `f32` cannot hold exactly.
fn frames(count: usize) -> Vec<Vec<Vec3>> {
    let corner = |x: f64, y: f64, t: f64| Vec3::new(x / 3.0, y + 1e-7 * t, -(x * y) * (0.1 * t).sin());
    (0..count).map(|t| [(0., 0.), (1., 0.), (1., 1.), (0., 1.)].map(|(x, y)| corner(x, y, t as f64)).to_vec()).collect()
}

fn uvs() -> ObjUvs {
    ObjUvs {
        coords: vec![[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0], [0.25, 0.125]],
        faces: vec![[0, 1, 2], [4, 2, 3]],
    }
}

fn square<'a>(frames: &'a dyn VertexFrames) -> MovingMesh<'a> {
    MovingMesh {
        name: "square".into(),
        vertex_count: 4,
        faces: &FACES,
        uvs: None,
        colour: MeshColour::Uniform([255, 128, 0]),
        frames,
    }
}

fn pc2(mesh: &MovingMesh<'_>) -> Result<Vec<u8>> {
    let mut out = Vec::new();
    write_pc2(Path::new("x.pc2"), &mut out, mesh, Pc2Timing::default()).map(|()| out)
}

fn usda(fps: f64, normals: bool, meshes: Vec<MovingMesh<'_>>) -> Result<String> {
    let mut out = Vec::new();
    let scene = UsdScene { name: "avatar".into(), fps, normals, meshes };
    write_usda(Path::new("x.usda"), &mut out, &scene)?;
    Ok(String::from_utf8(out).unwrap())
}

/// All numbers of a piece of text.
fn numbers(text: &str) -> Vec<f64> {
    let other = |c: char| !(c.is_ascii_digit() || "+-.e".contains(c));
    text.split(other).filter(|word| !word.is_empty()).map(|word| word.parse().unwrap()).collect()
}

/// Text between the end of one mark and the next mark.
fn between<'a>(text: &'a str, from: &str, to: &str) -> &'a str {
    let start = text.find(from).unwrap_or_else(|| panic!("no `{from}` in {text}")) + from.len();
    &text[start..start + text[start..].find(to).unwrap()]
}

#[test]
fn an_obj_sequence_comes_back_frame_by_frame() -> Result<()> {
    let (frames, uvs) = (frames(12), uvs());
    let mesh = MovingMesh { uvs: Some(&uvs), colour: MeshColour::PerVertex(&COLOURS), ..square(&frames) };
    let sequence = ObjSequence::new(&mesh)?;
    assert_eq!(sequence.frame_count(), 12);
    assert_eq!((sequence.file_name(0), sequence.file_name(11)), ("frame_0001.obj".into(), "frame_0012.obj".into()));
    for (i, frame) in frames.iter().enumerate() {
        let back = read_obj(Path::new("frame.obj"), &sequence.file(i)?)?;
        assert_eq!(back.scan.mesh.faces, FACES);
        assert_eq!(back.scan.colours.as_deref(), Some(&COLOURS[..]));
        assert_eq!(back.uvs.as_ref(), Some(&uvs));
        for (a, b) in back.scan.mesh.vertices.iter().zip(frame) {
            // Eight decimals are written, the reader rounds to f32.
            assert!((a - b).amax() <= 0.5e-8 + f64::from(f32::EPSILON), "frame {i}: {a} {b}");
        }
    }
    Ok(())
}

#[test]
fn names_of_long_sequences_sort_as_their_frames() {
    let long = ComputedFrames { frame_count: 12_345, compute: |_: usize, _: &mut Vec<Vec3>| Ok(()) };
    let mesh = square(&long);
    let sequence = ObjSequence::new(&mesh).unwrap();
    assert_eq!(
        (sequence.file_name(0), sequence.file_name(12_344)),
        ("frame_00001.obj".into(), "frame_12345.obj".into())
    );
}

#[test]
fn a_point_cache_holds_every_frame_as_f32() -> Result<()> {
    let frames = frames(7);
    let bytes = pc2(&square(&frames))?;
    assert_eq!(bytes.len(), PC2_HEADER + 7 * 4 * 12);
    assert_eq!(&bytes[..12], b"POINTCACHE2\0");
    let int = |at: usize| i32::from_le_bytes(bytes[at..at + 4].try_into().unwrap());
    let float = |at: usize| f32::from_le_bytes(bytes[at..at + 4].try_into().unwrap());
    assert_eq!((int(12), int(16), float(20), float(24), int(28)), (1, 4, 1.0, 1.0, 7));
    let wanted: Vec<f32> = frames.iter().flatten().flat_map(|p| [p.x as f32, p.y as f32, p.z as f32]).collect();
    let got: Vec<f32> = (0..wanted.len()).map(|i| float(PC2_HEADER + 4 * i)).collect();
    assert_eq!(got, wanted);
    Ok(())
}

#[test]
fn frames_may_come_as_f32_or_be_computed() -> Result<()> {
    let stored = frames(5);
    let single: Vec<Vec<[f32; 3]>> =
        stored.iter().map(|f| f.iter().map(|p| [p.x as f32, p.y as f32, p.z as f32]).collect()).collect();
    let computed = ComputedFrames {
        frame_count: 5,
        compute: |frame: usize, out: &mut Vec<Vec3>| {
            out.extend_from_slice(&stored[frame]);
            Ok(())
        },
    };
    let bytes = pc2(&square(&stored))?;
    assert_eq!(pc2(&square(&single))?, bytes);
    assert_eq!(pc2(&square(&computed))?, bytes);
    // What the source of the frames says is handed on.
    let failing = ComputedFrames {
        frame_count: 5,
        compute: |frame: usize, _: &mut Vec<Vec3>| Err(Error::numerics("pose", format!("frame {frame}"), "stop")),
    };
    assert!(pc2(&square(&failing)).unwrap_err().to_string().contains("pose: frame 0"));
    Ok(())
}

#[test]
fn usd_holds_units_times_points_and_extent() -> Result<()> {
    let (frames, uvs) = (frames(3), uvs());
    let still = vec![frames[2].clone()];
    let text = usda(
        29.97,
        true,
        vec![
            MovingMesh { uvs: Some(&uvs), colour: MeshColour::PerVertex(&COLOURS), ..square(&frames) },
            MovingMesh { name: "le \"sol\"".into(), ..square(&still) },
        ],
    )?;
    assert!(text.starts_with("#usda 1.0\n("));
    for line in [
        "defaultPrim = \"avatar\"",
        "metersPerUnit = 1\n",
        "upAxis = \"Y\"",
        "startTimeCode = 1\n",
        "endTimeCode = 3\n",
        "timeCodesPerSecond = 29.97\n",
        "def Xform \"avatar\" (",
        "def Mesh \"square\"\n",
        "def Mesh \"le__sol_\" (\n        displayName = \"le \\\"sol\\\"\"",
        "subdivisionScheme = \"none\"",
        "faceVertexCounts = [3, 3]\n",
        "faceVertexIndices = [0, 1, 2, 0, 2, 3]\n",
        "primvars:st:indices = [0, 1, 2, 4, 2, 3]\n",
    ] {
        assert!(text.contains(line), "no `{line}` in {text}");
    }
    let points = between(&text, "point3f[] points.timeSamples = {", "\n        }");
    for (frame, line) in frames.iter().zip(points.trim().lines()) {
        let got = &numbers(line)[1..];
        let wanted: Vec<f32> = frame.iter().flat_map(|p| [p.x as f32, p.y as f32, p.z as f32]).collect();
        assert_eq!(got.iter().map(|&c| c as f32).collect::<Vec<_>>(), wanted);
    }
    let times: Vec<f64> = points.trim().lines().map(|line| numbers(line)[0]).collect();
    assert_eq!(times, [1.0, 2.0, 3.0]);
    let extent = between(&text, "float3[] extent.timeSamples = {", "\n        }");
    for (frame, line) in frames.iter().zip(extent.trim().lines()) {
        let (low, high) = caphy_core::mesh::bounds(frame).unwrap();
        let wanted: Vec<f32> = low.iter().chain(high.iter()).map(|&c| c as f32).collect();
        assert_eq!(numbers(line)[1..].iter().map(|&c| c as f32).collect::<Vec<_>>(), wanted);
    }
    assert_eq!(between(&text, "normal3f[] normals.timeSamples = {", "\n        }").trim().lines().count(), 3);
    // Half of sRGB's range is not half of the light: 102 is 0.133, 51 is 0.0331 (IEC 61966-2-1).
    let colours = numbers(between(&text, "primvars:displayColor = [", "]"));
    assert_eq!(&colours[..9], [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]);
    assert!((colours[9] - 0.0331).abs() < 1e-4 && (colours[10] - 0.1329).abs() < 1e-4 && colours[11] == 1.0);
    // The still mesh has plain values.
    let still = &text[text.find("def Mesh \"le__sol_\"").unwrap()..];
    assert!(still.contains("point3f[] points = [(") && !still.contains("timeSamples"), "{still}");
    Ok(())
}

#[test]
fn the_same_scene_gives_the_same_bytes_whoever_takes_them() -> Result<()> {
    /// Takes one byte at a time, as a slow pipe might.
    struct Slow(Vec<u8>);
    impl std::io::Write for Slow {
        fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
            self.0.extend(bytes.first());
            Ok(bytes.len().min(1))
        }
        fn flush(&mut self) -> std::io::Result<()> {
            Ok(())
        }
    }
    let frames = frames(3);
    let scene = UsdScene { name: "a".into(), fps: 30.0, normals: false, meshes: vec![square(&frames)] };
    let mut slow = Slow(Vec::new());
    write_usda(Path::new("x.usda"), &mut slow, &scene)?;
    let text = usda(30.0, false, vec![square(&frames)])?.replace("\"avatar\"", "\"a\"");
    assert_eq!(String::from_utf8(slow.0).unwrap(), text);
    assert!(!text.contains("normals"));
    Ok(())
}

#[test]
fn bad_meshes_are_refused_by_name_and_element() {
    let good = frames(3);
    let mut short = frames(3);
    short[1].pop();
    let mut lost = frames(3);
    lost[2][3].z = f64::NAN;
    let mut huge = frames(3);
    huge[0][1].y = 1e39;
    let none: Vec<Vec<Vec3>> = vec![];
    let out_of_range = [[0, 1, 2], [0, 2, 4]];
    let refused = |mesh: MovingMesh<'_>, words: &[&str]| {
        let sequence = ObjSequence::new(&mesh).and_then(|s| (0..s.frame_count()).try_for_each(|i| s.file(i).map(drop)));
        for error in [sequence.unwrap_err(), pc2(&mesh).unwrap_err(), usda(30.0, true, vec![mesh.clone()]).unwrap_err()]
        {
            let text = error.to_string();
            assert!(words.iter().all(|word| text.contains(word)), "{words:?}: {text}");
        }
    };
    refused(square(&short), &["square", "frame 1", "expected 4", "got 3"]);
    refused(square(&lost), &["square", "frame 2, vertex 3", "NaN", "index 2"]);
    // A finite number that the files' 32 bits cannot hold.
    refused(square(&huge), &["square", "frame 0, vertex 1", "index 1"]);
    refused(MovingMesh { faces: &out_of_range, ..square(&good) }, &["square", "face 1", "vertex 4", "there are 4"]);
    refused(MovingMesh { faces: &[], ..square(&good) }, &["square", "no faces"]);
    refused(
        MovingMesh { colour: MeshColour::PerVertex(&COLOURS[1..]), ..square(&good) },
        &["square", "colours", "got 3"],
    );
    let mut bad = uvs();
    bad.faces[1][0] = 5;
    refused(MovingMesh { uvs: Some(&bad), ..square(&good) }, &["texture triangle 1", "coordinate 5"]);
    bad.faces.pop();
    refused(MovingMesh { uvs: Some(&bad), ..square(&good) }, &["texture triangles", "got 1"]);
    let mut bad = uvs();
    bad.coords[2][1] = f64::INFINITY;
    refused(MovingMesh { uvs: Some(&bad), ..square(&good) }, &["texture coordinates", "index 5"]);
    // USD says it of the scene, the others of the mesh.
    assert!(pc2(&square(&none)).unwrap_err().to_string().contains("no frames"));
    assert!(ObjSequence::new(&square(&none)).unwrap_err().to_string().contains("no frames"));
    assert!(usda(30.0, false, vec![square(&none)]).unwrap_err().to_string().contains("no frames"));
}

#[test]
fn bad_times_and_full_disks_are_refused() {
    let (three, five) = (frames(3), frames(5));
    for fps in [0.0, -30.0, f64::NAN, f64::INFINITY] {
        assert!(usda(fps, false, vec![square(&three)]).unwrap_err().to_string().contains("frame rate"));
    }
    assert!(usda(30.0, false, vec![]).unwrap_err().to_string().contains("no meshes"));
    let text = usda(30.0, false, vec![square(&three), square(&five)]).unwrap_err().to_string();
    assert!(text.contains("frames of mesh `square`") && text.contains("expected 5"), "{text}");
    for (first_frame, frames_per_sample) in [(f32::NAN, 1.0), (1.0, 0.0), (1.0, -1.0), (1.0, f32::INFINITY)] {
        let timing = Pc2Timing { first_frame, frames_per_sample };
        let text = write_pc2(Path::new("x.pc2"), &mut Vec::new(), &square(&three), timing).unwrap_err().to_string();
        assert!(text.contains("frames per sample"), "{text}");
    }
    struct Full;
    impl std::io::Write for Full {
        fn write(&mut self, _: &[u8]) -> std::io::Result<usize> {
            Err(std::io::Error::other("disk full"))
        }
        fn flush(&mut self) -> std::io::Result<()> {
            Ok(())
        }
    }
    let text = write_pc2(Path::new("x.pc2"), &mut Full, &square(&three), Pc2Timing::default()).unwrap_err().to_string();
    assert!(text.contains("x.pc2") && text.contains("disk full"), "{text}");
    let scene = UsdScene { name: "a".into(), fps: 30.0, normals: false, meshes: vec![square(&three)] };
    let text = write_usda(Path::new("y.usda"), &mut Full, &scene).unwrap_err().to_string();
    assert!(text.contains("y.usda") && text.contains("disk full"), "{text}");
}
