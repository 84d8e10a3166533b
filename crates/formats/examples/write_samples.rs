//! Writes small samples of every format that goes out, and what they must hold, for `tests/validate_exports.py`:
//! `cargo run -p caphy-formats --example write_samples -- DIR`.
//!
//! A figure of 55 joints in the SMPL-X order and a garment around it move for twelve frames. `expected.json` holds the
//! positions of every frame in double precision, posed here by the textbook formula of linear blend skinning, so that
//! readers check skins and channels of a GLB against something that no writer made.

use caphy_core::pose::{Pose, SMPLX_JOINTS, SMPLX_PARENTS};
use caphy_core::scan::{Label, Scan};
use caphy_core::{Error, Result, TriMesh, Vec3};
use caphy_formats::colour::MeshColour;
use caphy_formats::glb::{GlbInterpolation, GlbMesh, GlbMotion, GlbScene, GlbSkin, write_glb_to};
use caphy_formats::moving::MovingMesh;
use caphy_formats::obj::{ObjSequence, ObjUvs};
use caphy_formats::pc2::{Pc2Timing, write_pc2};
use caphy_formats::ply::write_ply;
use caphy_formats::usd::{UsdScene, write_usda};
use nalgebra::{Isometry3, Translation3, UnitQuaternion};
use serde_json::{Value, json};
use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};

const FPS: f64 = 24.0;
const FRAMES: usize = 12;

/// A tube along y with a seam of texture coordinates, open at its ends.
fn tube(radius: f64, low: f64, high: f64, rings: usize, sides: usize) -> (TriMesh, ObjUvs) {
    let (mut vertices, mut faces) = (Vec::new(), Vec::new());
    let mut uvs = ObjUvs::default();
    for r in 0..rings {
        let t = r as f64 / (rings - 1) as f64;
        for s in 0..=sides {
            let around = s as f64 / sides as f64;
            let angle = std::f64::consts::TAU * around;
            if s < sides {
                vertices.push(Vec3::new(radius * angle.sin(), low + t * (high - low), 0.7 * radius * angle.cos()));
            }
            uvs.coords.push([around, t]);
        }
    }
    let id = |r: usize, s: usize| (r * sides + s % sides) as u32;
    // The last column of coordinates is not the first one again.
    let uv = |r: usize, s: usize| (r * (sides + 1) + s) as u32;
    for r in 1..rings {
        for s in 0..sides {
            faces.extend([[id(r - 1, s), id(r - 1, s + 1), id(r, s + 1)], [id(r - 1, s), id(r, s + 1), id(r, s)]]);
            uvs.faces.extend([[uv(r - 1, s), uv(r - 1, s + 1), uv(r, s + 1)], [uv(r - 1, s), uv(r, s + 1), uv(r, s)]]);
        }
    }
    (TriMesh { vertices, faces }, uvs)
}

struct Figure {
    joints: Vec<Vec3>,
    poses: Vec<Pose>,
}

impl Figure {
    /// Joints on a spiral, each near its parent; most of them turn.
    fn new() -> Self {
        let mut joints: Vec<Vec3> = Vec::new();
        for j in 0..SMPLX_JOINTS.len() {
            let k = j as f64;
            let step = Vec3::new(0.12 * (2.1 * k).sin(), 0.1 * (1.3 * k).cos(), 0.05 * (0.7 * k).sin());
            joints.push(if j == 0 { Vec3::new(0.0, 0.9, 0.02) } else { joints[SMPLX_PARENTS[j]] + step });
        }
        let poses = (0..FRAMES)
            .map(|frame| {
                let mut pose = Pose::rest(joints.len());
                let t = frame as f64 / FRAMES as f64;
                pose.translation = Vec3::new(0.5 * t, 0.1 * (6.0 * t).sin(), -0.2);
                for (j, rotation) in pose.rotations.iter_mut().enumerate().filter(|(j, _)| j % 5 != 4) {
                    let k = j as f64;
                    *rotation = Vec3::new((k + 5.0 * t).sin(), (2.0 * k).cos() * t, 0.3 * k.sin()) * 0.6;
                }
                // One that goes round, past half a turn.
                pose.rotations[0].y = 7.0 * t;
                pose
            })
            .collect();
        Self { joints, poses }
    }
    /// The three nearest joints of each vertex, by the inverse of their distance; shape [vertex_count, joint_count].
    fn weights(&self, mesh: &TriMesh) -> Vec<f64> {
        let mut weights = vec![0.0; mesh.vertices.len() * self.joints.len()];
        for (v, row) in mesh.vertices.iter().zip(weights.chunks_exact_mut(self.joints.len())) {
            let mut near: Vec<(f64, usize)> =
                self.joints.iter().enumerate().map(|(j, p)| ((p - v).norm() + 0.01, j)).collect();
            near.sort_by(|a, b| a.0.total_cmp(&b.0));
            let total: f64 = near[..3].iter().map(|(d, _)| 1.0 / d).sum();
            for (d, j) in &near[..3] {
                row[*j] = 1.0 / d / total;
            }
        }
        weights
    }
    /// Linear blend skinning: v' = Σ w_j G_j G_j(rest)⁻¹ v, the root turning about its rest position.
    fn pose(&self, mesh: &TriMesh, weights: &[f64], pose: &Pose) -> Vec<Vec3> {
        let mut global: Vec<Isometry3<f64>> = Vec::new();
        for (j, rest) in self.joints.iter().enumerate() {
            let turn = UnitQuaternion::from_scaled_axis(pose.rotations[j]);
            global.push(match j {
                0 => Isometry3::from_parts(Translation3::from(rest + pose.translation), turn),
                _ => {
                    let parent = SMPLX_PARENTS[j];
                    global[parent] * Isometry3::from_parts(Translation3::from(rest - self.joints[parent]), turn)
                }
            });
        }
        mesh.vertices
            .iter()
            .zip(weights.chunks_exact(self.joints.len()))
            .map(|(v, row)| {
                let moved =
                    |(j, w): (usize, &f64)| (global[j] * nalgebra::Point3::from(v - self.joints[j])).coords * *w;
                row.iter().enumerate().map(moved).sum()
            })
            .collect()
    }
}

fn rows(vertices: &[Vec3]) -> Value {
    vertices.iter().map(|p| [p.x, p.y, p.z]).collect::<Vec<_>>().into_iter().map(|p| json!(p)).collect()
}

fn create(path: &Path) -> Result<BufWriter<File>> {
    Ok(BufWriter::new(File::create(path).map_err(|e| Error::io(path, "create", e))?))
}

fn main() -> Result<()> {
    let Some(folder) = std::env::args_os().nth(1).map(PathBuf::from) else {
        return Err(Error::numerics("write_samples", "no folder given", "name the folder to write to"));
    };
    let put = |name: &str, bytes: &[u8]| {
        let path = folder.join(name);
        std::fs::write(&path, bytes).map_err(|e| Error::io(path, "write", e))
    };
    let objects = folder.join("garment");
    std::fs::create_dir_all(&objects).map_err(|e| Error::io(&objects, "create", e))?;

    let figure = Figure::new();
    let (body, _) = tube(0.14, 0.1, 1.7, 20, 12);
    let weights = figure.weights(&body);
    let (garment, uvs) = tube(0.2, 0.8, 1.4, 9, 16);
    let colours: Vec<[u8; 3]> = (0..garment.vertices.len()).map(|v| [v as u8, 60, 255 - v as u8]).collect();
    let worn = figure.weights(&garment);
    let body_frames: Vec<Vec<Vec3>> = figure.poses.iter().map(|p| figure.pose(&body, &weights, p)).collect();
    let garment_frames: Vec<Vec<Vec3>> = figure
        .poses
        .iter()
        .enumerate()
        .map(|(frame, pose)| {
            let ripple = |p: Vec3| p + Vec3::new(0.0, 0.0, 0.01 * (40.0 * p.y + frame as f64).sin());
            figure.pose(&garment, &worn, pose).into_iter().map(ripple).collect()
        })
        .collect();
    let floor = TriMesh {
        vertices: [[-1., -1.], [-1., 1.], [1., 1.], [1., -1.]].map(|[x, z]| Vec3::new(x, 0.0, z)).to_vec(),
        faces: vec![[0, 1, 2], [0, 2, 3]],
    };
    let floor_frames = vec![floor.vertices.clone()];

    let skin = GlbSkin {
        names: &SMPLX_JOINTS,
        parents: &SMPLX_PARENTS,
        joints: &figure.joints,
        weights: &weights,
        poses: &figure.poses,
    };
    let mesh = |name: &str, mesh, colour, motion| GlbMesh { name: name.into(), mesh, colour, motion };
    let scene = GlbScene {
        fps: FPS,
        interpolation: GlbInterpolation::Linear,
        meshes: vec![
            mesh("body", &body, MeshColour::Uniform([220, 180, 160]), GlbMotion::Skinned(skin)),
            mesh("garment", &garment, MeshColour::PerVertex(&colours), GlbMotion::Vertices(&garment_frames)),
            mesh("floor no. 1", &floor, MeshColour::Uniform([90, 90, 90]), GlbMotion::Still),
        ],
    };
    let path = folder.join("avatar.glb");
    write_glb_to(&path, &mut create(&path)?, &scene)?;

    let body_mesh = MovingMesh {
        name: "body".into(),
        vertex_count: body.vertices.len(),
        faces: &body.faces,
        uvs: None,
        colour: MeshColour::Uniform([220, 180, 160]),
        frames: &body_frames,
    };
    let garment_mesh = MovingMesh {
        name: "garment".into(),
        vertex_count: garment.vertices.len(),
        faces: &garment.faces,
        uvs: Some(&uvs),
        colour: MeshColour::PerVertex(&colours),
        frames: &garment_frames,
    };
    let floor_mesh = MovingMesh {
        name: "floor no. 1".into(),
        vertex_count: 4,
        faces: &floor.faces,
        uvs: None,
        colour: MeshColour::Uniform([90, 90, 90]),
        frames: &floor_frames,
    };
    for mesh in [&body_mesh, &garment_mesh] {
        let path = folder.join(format!("{}.pc2", mesh.name));
        write_pc2(&path, &mut create(&path)?, mesh, Pc2Timing::default())?;
    }
    let sequence = ObjSequence::new(&garment_mesh)?;
    for frame in 0..sequence.frame_count() {
        put(&format!("garment/{}", sequence.file_name(frame)), &sequence.file(frame)?)?;
    }
    let path = folder.join("avatar.usda");
    let meshes = vec![body_mesh, garment_mesh.clone(), floor_mesh];
    write_usda(&path, &mut create(&path)?, &UsdScene { name: "avatar".into(), fps: FPS, normals: true, meshes })?;
    let labels = (0..garment.vertices.len()).map(|v| Label::from_byte((v % 3) as u8)).collect();
    let scan =
        Scan { name: "scan".into(), mesh: garment.clone(), colours: Some(colours.clone()), labels: Some(labels) };
    put("scan.ply", &write_ply(&scan))?;

    let expected = |mesh: &TriMesh, frames: &[Vec<Vec3>]| json!({ "faces": mesh.faces, "frames": frames.iter().map(|f| rows(f)).collect::<Vec<_>>() });
    let mut meshes = json!({
        "body": expected(&body, &body_frames),
        "garment": expected(&garment, &garment_frames),
        "floor no. 1": expected(&floor, &floor_frames),
        "scan": expected(&garment, std::slice::from_ref(&garment.vertices)),
    });
    let corner_uvs = |f: &[u32; 3]| f.map(|id| uvs.coords[id as usize]);
    meshes["garment"]["corner_uvs"] = uvs.faces.iter().map(|f| json!(corner_uvs(f))).collect();
    meshes["garment"]["colours"] = json!(colours);
    meshes["scan"]["colours"] = json!(colours);
    put("expected.json", json!({ "fps": FPS, "meshes": meshes }).to_string().as_bytes())
}
