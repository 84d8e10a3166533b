//! Makes scans of a clothed person with everything known: `cargo run --release -p caphy-bodymodel --example dress_body -- BODY.npz
//! UPPER.obj LOWER.obj SEED FOLDER`.
//!
//! Garments are those of characters, made for the body whose shape the body's file calls `ref__0__mid_betas`; they are carried to a
//! random shape, skinned, pushed out of the skin, subdivided once and made noisy; covered skin is left out, as no scanner sees it.
//! The folder gets `<pose>.ply` with labels and colours, and `ground_truth.npz` with `betas`, `<pose>__full_pose`,
//! `<pose>__joints55` and `<pose>__vertices`.

use caphy_bodymodel::smplx::{SmplxOptions, load};
use caphy_core::body::{BodyModel, BodyParameters};
use caphy_core::pose::Pose;
use caphy_core::query::{Adjacency, NearestGrid, NearestSurface};
use caphy_core::scan::{Label, Scan};
use caphy_core::{TriMesh, Vec3};
use caphy_formats::npz::Npz;
use caphy_formats::obj::read_obj;
use caphy_formats::ply::write_ply;
use nalgebra::Matrix3x4;
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use std::error::Error;
use std::io::Write;
use std::path::Path;

/// Poses by name: joints and rotations [degrees].
const POSES: [(&str, &[(&str, [f64; 3])]); 6] = [
    ("apose", &[("left_shoulder", [0., 0., -45.]), ("right_shoulder", [0., 0., 45.])]),
    (
        "walk",
        &[
            ("pelvis", [0., 25., 0.]),
            ("left_hip", [-30., 0., 4.]),
            ("left_knee", [20., 0., 0.]),
            ("right_hip", [18., 0., -4.]),
            ("right_knee", [12., 0., 0.]),
            ("left_shoulder", [10., 0., -62.]),
            ("right_shoulder", [-10., 0., 62.]),
            ("left_elbow", [0., -25., 0.]),
            ("right_elbow", [0., 35., 0.]),
            ("spine2", [4., -6., 0.]),
        ],
    ),
    (
        "star",
        &[
            ("left_shoulder", [0., 0., 40.]),
            ("right_shoulder", [0., 0., -40.]),
            ("left_hip", [0., 0., 22.]),
            ("right_hip", [0., 0., -22.]),
        ],
    ),
    (
        "reach",
        &[
            ("left_shoulder", [0., -60., -20.]),
            ("right_shoulder", [0., 45., 10.]),
            ("right_elbow", [0., 70., 0.]),
            ("spine1", [10., 0., 0.]),
            ("spine3", [6., 12., 0.]),
            ("neck", [0., 15., 0.]),
        ],
    ),
    (
        "kneeup",
        &[
            ("left_hip", [-75., 0., 8.]),
            ("left_knee", [80., 0., 0.]),
            ("left_shoulder", [0., -15., -30.]),
            ("right_shoulder", [0., 10., 50.]),
            ("left_elbow", [0., -60., 0.]),
        ],
    ),
    (
        "squat",
        &[
            ("pelvis", [20., -40., 0.]),
            ("left_hip", [-70., 0., 14.]),
            ("right_hip", [-70., 0., -14.]),
            ("left_knee", [75., 0., 0.]),
            ("right_knee", [75., 0., 0.]),
            ("left_shoulder", [0., -70., -10.]),
            ("right_shoulder", [0., 70., 10.]),
        ],
    ),
];

fn moved(m: &Matrix3x4<f64>, p: &Vec3) -> Vec3 {
    m * p.push(1.0)
}

/// A garment with the body vertices that carry it and their weights.
struct Garment {
    mesh: TriMesh,
    carriers: Vec<Vec<(u32, f64)>>,
}

impl Garment {
    fn read(path: &str, body: &[Vec3]) -> Result<Self, Box<dyn Error>> {
        let path = Path::new(path);
        let mesh = read_obj(path, &std::fs::read(path)?)?.scan.mesh;
        let adjacency = Adjacency::new(mesh.vertices.len(), &mesh.faces);
        let grid = NearestGrid::from_points(body);
        let nearest: Vec<u32> = mesh.vertices.iter().map(|p| grid.nearest_point(p).map_or(0, |n| n.0)).collect();
        // The carriers of a vertex and its two rings: a single one tears between arm and trunk.
        let carriers = (0..mesh.vertices.len())
            .map(|v| {
                let mut ring = vec![v as u32];
                for _ in 0..2 {
                    let wider: Vec<u32> = ring.iter().flat_map(|&w| adjacency.of(w as usize).iter().copied()).collect();
                    ring.extend(wider);
                    ring.sort_unstable();
                    ring.dedup();
                }
                let share = 1.0 / ring.len() as f64;
                ring.iter().map(|&w| (nearest[w as usize], share)).collect()
            })
            .collect();
        Ok(Self { mesh, carriers })
    }
    /// Carried by displacements of the body at rest, then posed, then out of the skin.
    fn worn(
        &self,
        shift: &[Vec3],
        transforms: &[Matrix3x4<f64>],
        skin: &TriMesh,
        gap: f64,
    ) -> Result<TriMesh, Box<dyn Error>> {
        let mut mesh = self.mesh.clone();
        for (p, carriers) in mesh.vertices.iter_mut().zip(&self.carriers) {
            let shift: Vec3 = carriers.iter().map(|&(b, w)| shift[b as usize] * w).sum();
            let m = carriers.iter().fold(Matrix3x4::zeros(), |m, &(b, w)| m + transforms[b as usize] * w);
            *p = moved(&m, &(*p + shift));
        }
        let normals = skin.vertex_normals();
        let surface = NearestSurface::from_mesh(skin)?;
        for _ in 0..3 {
            for p in &mut mesh.vertices {
                let Some(near) = surface.nearest(p) else { continue };
                let face = skin.faces[near.face as usize];
                let n: Vec3 = face.iter().map(|&v| normals[v as usize]).sum::<Vec3>().normalize();
                let depth = (*p - near.point).dot(&n);
                if depth < gap && near.squared_distance < 9e-4 {
                    *p += n * (gap - depth);
                }
            }
        }
        Ok(mesh.subdivided())
    }
}

fn npy(shape: &[usize], values: &[f64]) -> Vec<u8> {
    let shape: Vec<String> = shape.iter().map(|n| format!("{n},")).collect();
    let mut header = format!("{{'descr': '<f8', 'fortran_order': False, 'shape': ({}), }}", shape.concat());
    while (header.len() + 11) % 64 != 0 {
        header.push(' ');
    }
    header.push('\n');
    let mut out = b"\x93NUMPY\x01\x00".to_vec();
    out.extend((header.len() as u16).to_le_bytes());
    out.extend(header.as_bytes());
    values.iter().for_each(|v| out.extend(v.to_le_bytes()));
    out
}

fn flat(points: &[Vec3]) -> Vec<f64> {
    points.iter().flatten().copied().collect()
}

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [body_path, upper, lower, seed, folder] = &arguments[..] else {
        return Err("give a body (.npz), an upper and a lower garment (.obj), a seed and a folder".into());
    };
    let mut rng = ChaCha8Rng::seed_from_u64(seed.parse()?);
    let mut normal = move || (0..12).map(|_| rng.random::<f64>()).sum::<f64>() - 6.0;
    let body_path = Path::new(body_path);
    let options = SmplxOptions { expression_coefficients: Some(0), ..SmplxOptions::default() };
    let body = load(body_path, std::fs::read(body_path)?, &options)?;
    let joints = &body.describe().joints;
    let middle = Npz::from_bytes(body_path, std::fs::read(body_path)?)?.f64s("ref__0__mid_betas")?.data[..10].to_vec();
    let betas: Vec<f64> = (0..10).map(|_| normal()).collect();
    let [made_for, rest] = [&middle, &betas].map(|shape| body.forward(&body.rest(shape)));
    let (made_for, rest) = (made_for?.vertices, rest?.vertices);
    let shift: Vec<Vec3> = rest.iter().zip(&made_for).map(|(a, b)| a - b).collect();
    let garments = [(Garment::read(upper, &made_for)?, Label::Upper), (Garment::read(lower, &made_for)?, Label::Lower)];
    std::fs::create_dir_all(folder)?;
    let mut truth = vec![("betas".to_string(), npy(&[10], &betas))];
    for (name, turned) in POSES {
        let mut pose = Pose::rest(joints.len());
        for (joint, degrees) in turned {
            let j = joints.iter().position(|j| j.name == *joint).ok_or("a joint that the body lacks")?;
            pose.rotations[j] = Vec3::from(*degrees).map(f64::to_radians);
        }
        for (rotation, joint) in pose.rotations.iter_mut().zip(joints) {
            // Nobody stands exactly.
            if !["index", "middle", "pinky", "ring", "thumb", "jaw", "eye", "foot"]
                .iter()
                .any(|k| joint.name.contains(k))
            {
                *rotation += Vec3::from_fn(|_, _| 0.04 * normal());
            }
        }
        pose.translation = Vec3::new(0.1 * normal(), 0.95, 0.1 * normal());
        let posed = body.forward(&BodyParameters::rest(joints.len(), &betas).posed(&pose))?;
        let skin = TriMesh { vertices: posed.vertices.clone(), faces: body.describe().faces.clone() };
        let weights = &body.describe().weights;
        let transforms: Vec<_> = (0..skin.vertices.len()).map(|v| weights.blend(v, &posed.transforms)).collect();
        let mut bare = vec![true; skin.vertices.len()];
        let normals = skin.vertex_normals();
        let mut worn = Vec::new();
        for (garment, label) in &garments {
            let mesh = garment.worn(&shift, &transforms, &skin, 0.004)?;
            let surface = NearestSurface::from_mesh(&mesh)?;
            for (v, bare) in bare.iter_mut().enumerate() {
                if let Some(near) = surface.nearest(&skin.vertices[v])
                    && near.squared_distance < 0.06f64.powi(2)
                    && (near.point - skin.vertices[v]).dot(&normals[v]) > 0.5 * near.squared_distance.sqrt()
                {
                    *bare = false;
                }
            }
            worn.push((mesh, *label));
        }
        worn.insert(0, (skin.submesh(&bare).0.subdivided(), Label::Body));
        let mut scan = Scan { name: name.into(), colours: Some(vec![]), labels: Some(vec![]), ..Scan::default() };
        for (mesh, label) in &worn {
            let first = scan.mesh.vertices.len() as u32;
            scan.mesh.faces.extend(mesh.faces.iter().map(|f| f.map(|v| v + first)));
            for p in &mesh.vertices {
                scan.mesh.vertices.push(p + Vec3::from_fn(|_, _| 6e-4 * normal()));
                let base = match label {
                    Label::Upper => [57, 80, 161],
                    Label::Lower => [60, 60, 64],
                    _ => [200, 155, 124],
                };
                let tone = 6.0 * normal();
                let colour = base.map(|c| (f64::from(c) + tone + 3.0 * normal()).clamp(0.0, 255.0) as u8);
                scan.colours.get_or_insert_default().push(colour);
                scan.labels.get_or_insert_default().push(*label);
            }
        }
        std::fs::write(Path::new(folder).join(format!("{name}.ply")), write_ply(&scan))?;
        truth.push((format!("{name}__full_pose"), npy(&[joints.len(), 3], &flat(&pose.rotations))));
        truth.push((format!("{name}__joints55"), npy(&[joints.len(), 3], &flat(&posed.joints))));
        truth.push((format!("{name}__vertices"), npy(&[posed.vertices.len(), 3], &flat(&posed.vertices))));
    }
    let mut zip = zip::ZipWriter::new(std::fs::File::create(Path::new(folder).join("ground_truth.npz"))?);
    for (name, bytes) in truth {
        zip.start_file(format!("{name}.npy"), zip::write::FileOptions::default())?;
        zip.write_all(&bytes)?;
    }
    zip.finish()?;
    Ok(())
}
