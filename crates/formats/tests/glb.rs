//! GLB: decoded again by the format's own rules, and checked by the Khronos validator where it is installed.

use caphy_core::pose::Pose;
use caphy_core::{Result, TriMesh, Vec3};
use caphy_formats::colour::MeshColour;
use caphy_formats::glb::{GlbInterpolation, GlbMesh, GlbMotion, GlbScene, GlbSkin, write_glb, write_glb_to};
use caphy_formats::moving::{ComputedFrames, VertexFrames};
use nalgebra::{Matrix4, Quaternion, Rotation3, Translation3, UnitQuaternion, Vector4};
use serde_json::Value;
use std::path::Path;
use std::process::Command;

/// A square pillar along y with rings of four vertices, open at its ends.
fn pillar(rings: usize) -> TriMesh {
    let mut vertices = Vec::new();
    let mut faces = Vec::new();
    for r in 0..rings {
        for (x, z) in [(0.1, 0.1), (0.1, -0.1), (-0.1, -0.1), (-0.1, 0.1)] {
            vertices.push(Vec3::new(x, 0.25 * r as f64, z));
        }
        if r > 0 {
            for k in 0..4u32 {
                let (a, b) = (4 * (r as u32 - 1) + k, 4 * (r as u32 - 1) + (k + 1) % 4);
                faces.extend([[a, b, b + 4], [a, b + 4, a + 4]]);
            }
        }
    }
    TriMesh::new("pillar", vertices, faces).unwrap()
}

/// Everything that a small scene borrows.
struct Example {
    mesh: TriMesh,
    colours: Vec<[u8; 3]>,
    frames: Vec<Vec<Vec3>>,
    joints: Vec<Vec3>,
    weights: Vec<f64>,
    poses: Vec<Pose>,
}

const PARENTS: [usize; 6] = [usize::MAX, 0, 1, 2, 3, 4];
const NAMES: [&str; 6] = ["pelvis", "a", "b", "c", "d", "e"];

fn example() -> Example {
    let mesh = pillar(7);
    let n = mesh.vertices.len();
    let joints: Vec<Vec3> = (0..6).map(|j| Vec3::new(0.01 * j as f64, 0.25 * j as f64, 0.0)).collect();
    let mut weights = vec![0.0; n * 6];
    for (v, p) in mesh.vertices.iter().enumerate() {
        // Two joints per vertex, so that four slots are exact.
        let x = (p.y / 0.25).clamp(0.0, 5.0);
        let low = (x.floor() as usize).min(4);
        let t = x - low as f64;
        weights[6 * v + low] = 0.7 - 0.6 * t;
        weights[6 * v + low + 1] = 0.3 + 0.6 * t;
    }
    let poses = (0..3)
        .map(|f| {
            let mut pose = Pose::rest(6);
            pose.translation = Vec3::new(0.1 * f as f64, 0.2, -0.3);
            for j in 0..5 {
                pose.rotations[j] = Vec3::new(0.3 * f as f64, 0.1 * j as f64, -0.2);
            }
            pose
        })
        .collect();
    let frames = (0..3)
        .map(|f| {
            mesh.vertices
                .iter()
                .map(|p| p + Vec3::new(0.1 * f as f64 * p.y, -0.05 * f as f64, (p.y + f as f64).sin()))
                .collect()
        })
        .collect();
    let colours = (0..n).map(|v| [v as u8, 128, 255 - v as u8]).collect();
    Example { mesh, colours, frames, joints, weights, poses }
}

impl Example {
    fn skin(&self) -> GlbSkin<'_> {
        GlbSkin { names: &NAMES, parents: &PARENTS, joints: &self.joints, weights: &self.weights, poses: &self.poses }
    }
    fn scene(&self) -> GlbScene<'_> {
        let mesh = |name: &str, colour, motion| GlbMesh { name: name.into(), mesh: &self.mesh, colour, motion };
        GlbScene {
            fps: 30.0,
            interpolation: GlbInterpolation::Linear,
            meshes: vec![
                mesh("still", MeshColour::Uniform([200, 30, 30]), GlbMotion::Still),
                mesh("garment", MeshColour::PerVertex(&self.colours), GlbMotion::Vertices(&self.frames)),
                mesh("body", MeshColour::Uniform([220, 180, 160]), GlbMotion::Skinned(self.skin())),
            ],
        }
    }
}

/// The two chunks of a GLB.
struct Glb {
    json: Value,
    data: Vec<u8>,
}

impl Glb {
    fn open(bytes: &[u8]) -> Self {
        let u32_at = |i: usize| u32::from_le_bytes(bytes[i..i + 4].try_into().unwrap()) as usize;
        assert_eq!((&bytes[..4], u32_at(4), u32_at(8)), (b"glTF".as_slice(), 2, bytes.len()));
        let length = u32_at(12);
        assert_eq!((&bytes[16..20], length % 4), (b"JSON".as_slice(), 0));
        let data = 20 + length;
        assert_eq!(&bytes[data + 4..data + 8], b"BIN\0");
        assert_eq!(u32_at(data), bytes.len() - data - 8);
        Self { json: serde_json::from_slice(&bytes[20..data]).unwrap(), data: bytes[data + 8..].to_vec() }
    }
    /// The numbers of an accessor, whatever its type.
    fn numbers(&self, id: &Value) -> Vec<f64> {
        let accessor = &self.json["accessors"][id.as_u64().unwrap() as usize];
        let view = &self.json["bufferViews"][accessor["bufferView"].as_u64().unwrap() as usize];
        let start = view["byteOffset"].as_u64().unwrap() as usize;
        let bytes = &self.data[start..start + view["byteLength"].as_u64().unwrap() as usize];
        match accessor["componentType"].as_u64().unwrap() {
            5123 => bytes.chunks_exact(2).map(|b| f64::from(u16::from_le_bytes(b.try_into().unwrap()))).collect(),
            5125 => bytes.chunks_exact(4).map(|b| f64::from(u32::from_le_bytes(b.try_into().unwrap()))).collect(),
            _ => bytes.chunks_exact(4).map(|b| f64::from(f32::from_le_bytes(b.try_into().unwrap()))).collect(),
        }
    }
    fn vectors(&self, id: &Value) -> Vec<Vec3> {
        self.numbers(id).chunks_exact(3).map(Vec3::from_column_slice).collect()
    }
    /// Output of the animation channel of a node, if it has one.
    fn channel(&self, node: usize, path: &str) -> Option<Vec<f64>> {
        let animation = &self.json["animations"][0];
        let channel = animation["channels"]
            .as_array()?
            .iter()
            .find(|c| c["target"]["node"] == node && c["target"]["path"] == path)?;
        Some(self.numbers(&animation["samplers"][channel["sampler"].as_u64()? as usize]["output"]))
    }
}

#[test]
fn frames_come_back_from_morph_targets() {
    let e = example();
    let glb = Glb::open(&write_glb(&e.scene()).unwrap());
    let primitive = &glb.json["meshes"][1]["primitives"][0];
    let base = glb.vectors(&primitive["attributes"]["POSITION"]);
    let weights = glb.channel(1, "weights").unwrap();
    let targets = primitive["targets"].as_array().unwrap();
    for (f, frame) in e.frames.iter().enumerate() {
        for (v, p) in frame.iter().enumerate() {
            let sum: Vec3 =
                targets.iter().enumerate().map(|(k, t)| weights[3 * f + k] * glb.vectors(&t["POSITION"])[v]).sum();
            // Base and difference are each rounded to f32 at a size of up to 2.5 m.
            assert!((base[v] + sum - p).norm() < 1e-6);
        }
    }
    let indices = glb.numbers(&primitive["indices"]);
    assert_eq!(indices[..6], [0.0, 1.0, 5.0, 0.0, 5.0, 4.0]);
}

#[test]
fn skinning_by_the_formats_rules_is_linear_blend_skinning() {
    let e = example();
    let glb = Glb::open(&write_glb(&e.scene()).unwrap());
    let attributes = &glb.json["meshes"][2]["primitives"][0]["attributes"];
    let rest = glb.vectors(&attributes["POSITION"]);
    let (ids, weights) = (glb.numbers(&attributes["JOINTS_0"]), glb.numbers(&attributes["WEIGHTS_0"]));
    let skin = &glb.json["skins"][0];
    let nodes: Vec<usize> = skin["joints"].as_array().unwrap().iter().map(|j| j.as_u64().unwrap() as usize).collect();
    let bind = glb.numbers(&skin["inverseBindMatrices"]);
    for (f, pose) in e.poses.iter().enumerate() {
        // By the file.
        let mut world = vec![Matrix4::identity(); 6];
        // By the formula of the body: the root turns about its rest position, then everything is translated.
        let mut formula = vec![Matrix4::identity(); 6];
        for j in 0..6 {
            let node = &glb.json["nodes"][nodes[j]];
            let mut offset = Vec3::from_iterator((0..3).map(|c| node["translation"][c].as_f64().unwrap()));
            if let Some(way) = glb.channel(nodes[j], "translation") {
                offset = Vec3::from_column_slice(&way[3 * f..3 * f + 3]);
            }
            let turn = glb.channel(nodes[j], "rotation").map_or(UnitQuaternion::identity(), |q| {
                let q = &q[4 * f..4 * f + 4];
                assert!((Vector4::from_column_slice(q).norm() - 1.0).abs() < 1e-6);
                UnitQuaternion::from_quaternion(Quaternion::new(q[3], q[0], q[1], q[2]))
            });
            let local = Translation3::from(offset).to_homogeneous() * turn.to_homogeneous();
            let about = Translation3::from(e.joints[j]).to_homogeneous()
                * Rotation3::from_scaled_axis(pose.rotations[j]).to_homogeneous()
                * Translation3::from(-e.joints[j]).to_homogeneous();
            if j == 0 {
                world[j] = local;
                formula[j] = Translation3::from(pose.translation).to_homogeneous() * about;
            } else {
                world[j] = world[j - 1] * local;
                formula[j] = formula[j - 1] * about;
            }
        }
        for v in 0..rest.len() {
            assert!((weights[4 * v..4 * v + 4].iter().sum::<f64>() - 1.0).abs() < 2e-7);
            let mut got = Vec3::zeros();
            for k in 0..4 {
                let j = ids[4 * v + k] as usize;
                let inverse = Matrix4::from_column_slice(&bind[16 * j..16 * j + 16]);
                got += weights[4 * v + k] * (world[j] * inverse).transform_point(&rest[v].into()).coords;
            }
            let wanted: Vec3 = (0..6)
                .map(|j| e.weights[6 * v + j] * formula[j].transform_point(&e.mesh.vertices[v].into()).coords)
                .sum();
            assert!((got - wanted).norm() < 3e-6, "frame {f}, vertex {v}: {got} instead of {wanted}");
        }
    }
    assert!(glb.channel(nodes[5], "rotation").is_none(), "a joint that rests needs no channel");
}

#[test]
fn four_largest_weights_are_kept() {
    let mut e = example();
    e.weights[..6].copy_from_slice(&[0.1, 0.3, 0.05, 0.2, 0.05, 0.3]);
    let glb = Glb::open(&write_glb(&e.scene()).unwrap());
    let attributes = &glb.json["meshes"][2]["primitives"][0]["attributes"];
    assert_eq!(glb.numbers(&attributes["JOINTS_0"])[..4], [1.0, 5.0, 3.0, 0.0]);
    let w = glb.numbers(&attributes["WEIGHTS_0"]);
    for (got, kept) in w.iter().zip([0.3, 0.3, 0.2, 0.1]) {
        assert!((got - kept / 0.9).abs() < 1e-7);
    }
}

#[test]
fn the_same_scene_gives_the_same_bytes() {
    let e = example();
    assert_eq!(write_glb(&e.scene()).unwrap(), write_glb(&e.scene()).unwrap());
}

#[test]
fn what_cannot_be_written_is_refused_by_name() {
    let e = example();
    fn refused<'a>(mut scene: GlbScene<'a>, change: impl FnOnce(&mut GlbScene<'a>), word: &str) {
        change(&mut scene);
        let text = write_glb(&scene).unwrap_err().to_string();
        assert!(text.contains(word), "{text}");
    }
    fn with_skin<'a>(mut scene: GlbScene<'a>, skin: GlbSkin<'a>) -> GlbScene<'a> {
        scene.meshes[2].motion = GlbMotion::Skinned(skin);
        scene
    }
    let empty = TriMesh::default();
    let short = vec![e.frames[0].clone(), vec![Vec3::zeros()]];
    let mut lost = e.frames.clone();
    lost[2][5].y = f64::NAN;
    let none: Vec<Vec<Vec3>> = vec![];
    let no_weights = vec![0.0; e.weights.len()];
    let backwards = [usize::MAX, 2, 0, 2, 3, 4];
    let other_body = [Pose::rest(55)];
    refused(e.scene(), |s| s.fps = 0.0, "frame rate 0");
    refused(e.scene(), |s| s.meshes.clear(), "no meshes");
    refused(e.scene(), |s| s.meshes[0].mesh = &empty, "still");
    refused(e.scene(), |s| s.meshes[1].colour = MeshColour::PerVertex(&[]), "garment");
    refused(e.scene(), |s| s.meshes[1].motion = GlbMotion::Vertices(&short), "frame 1");
    refused(e.scene(), |s| s.meshes[1].motion = GlbMotion::Vertices(&lost), "frame 2, vertex 5");
    refused(e.scene(), |s| s.meshes[1].motion = GlbMotion::Vertices(&none), "no frames");
    refused(with_skin(e.scene(), GlbSkin { weights: &no_weights, ..e.skin() }), |_| (), "vertex 0");
    refused(with_skin(e.scene(), GlbSkin { weights: &[], ..e.skin() }), |_| (), "weights");
    refused(with_skin(e.scene(), GlbSkin { parents: &backwards, ..e.skin() }), |_| (), "joint 1");
    refused(with_skin(e.scene(), GlbSkin { poses: &other_body, ..e.skin() }), |_| (), "frame 0, rotations");
}

#[test]
fn the_khronos_validator_finds_no_error() -> Result<()> {
    let folder = tempfile::tempdir().unwrap();
    let mut e = example();
    // A vertex without faces has no normal of its own.
    let lonely = Vec3::new(0.0, 3.0, 0.0);
    e.mesh.vertices.push(lonely);
    e.colours.push([1, 2, 3]);
    e.frames.iter_mut().for_each(|f| f.push(lonely));
    e.weights.extend([0.1, 0.3, 0.05, 0.2, 0.05, 0.3]);
    let mut files = Vec::new();
    for (name, interpolation) in [("step", GlbInterpolation::Step), ("linear", GlbInterpolation::Linear)] {
        let file = folder.path().join(format!("{name}.glb"));
        std::fs::write(&file, write_glb(&GlbScene { interpolation, ..e.scene() })?).unwrap();
        files.push(file);
    }
    let mut still = e.scene();
    still.meshes.truncate(1);
    let file = folder.path().join("still.glb");
    std::fs::write(&file, write_glb(&still)?).unwrap();
    files.push(file);
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/validate_glb.mjs");
    match Command::new("node").arg(script).args(&files).output() {
        Err(e) => println!("SKIPPED: node cannot be started ({e}): GLB files were not validated"),
        Ok(output) => {
            let text = String::from_utf8_lossy(&output.stdout);
            match output.status.code() {
                Some(3) => println!("SKIPPED: GLB files were not validated: {text}"),
                code => assert_eq!(code, Some(0), "{text}{}", String::from_utf8_lossy(&output.stderr)),
            }
            println!("{text}");
        }
    }
    Ok(())
}

#[test]
fn long_clips_are_written_piece_by_piece_and_too_long_ones_refused_before_any_frame() {
    /// Counts bytes and keeps none.
    #[derive(Default)]
    struct Meter {
        total: usize,
        largest: usize,
        json: usize,
    }
    impl std::io::Write for Meter {
        fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
            self.total += bytes.len();
            if bytes.starts_with(b"{") {
                self.json = bytes.len();
            } else {
                self.largest = self.largest.max(bytes.len());
            }
            Ok(bytes.len())
        }
        fn flush(&mut self) -> std::io::Result<()> {
            Ok(())
        }
    }
    let mesh = pillar(100);
    let count = mesh.vertices.len();
    let rest = mesh.vertices.clone();
    let asked = std::sync::atomic::AtomicUsize::new(0);
    let clip = |frame_count| ComputedFrames {
        frame_count,
        compute: |frame: usize, out: &mut Vec<Vec3>| {
            asked.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
            out.extend(rest.iter().map(|p| p + Vec3::x() * frame as f64 * 1e-3));
            Ok(())
        },
    };
    let write = |frames: &dyn VertexFrames, out: &mut Meter| {
        let colour = MeshColour::Uniform([9, 9, 9]);
        let meshes = vec![GlbMesh { name: "g".into(), mesh: &mesh, colour, motion: GlbMotion::Vertices(frames) }];
        let scene = GlbScene { fps: 30.0, interpolation: GlbInterpolation::Linear, meshes };
        write_glb_to(Path::new("long.glb"), out, &scene)
    };
    let mut meter = Meter::default();
    write(&clip(600), &mut meter).unwrap();
    assert!(meter.total > 600 * (24 * count + 4 * 600), "{}", meter.total);
    // Nothing but the description grows with the clip: a piece is a frame, a row of weights or a still array.
    assert!(meter.largest <= 64 * count, "{} for {count} vertices", meter.largest);
    assert!(meter.json < 600 * 1000, "{}", meter.json);
    assert_eq!(asked.swap(0, std::sync::atomic::Ordering::Relaxed), 2 * 600);
    let text = write(&clip(200_000_000), &mut Meter::default()).unwrap_err().to_string();
    assert!(text.contains("the format holds at most"), "{text}");
    assert_eq!(asked.load(std::sync::atomic::Ordering::Relaxed), 0);
}
