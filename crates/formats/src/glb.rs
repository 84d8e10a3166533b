//! Binary glTF 2.0 (`.glb`): still meshes, meshes with a position per frame, skinned bodies.
//!
//! A garment's frames become one morph target each, with weights that walk through them: every viewer plays that. The
//! body is skinned by its joints (glTF has no pose correctives: near bent joints it differs from the body model by them).
//!
//! Per frame a garment takes 24 bytes per vertex (positions and normals) and the weights 4 bytes per frame of the clip:
//! a minute at 30 Hz of 4400 vertices is 200 MB. Longer clips are what PC2 and USD are for. Frames are asked for twice,
//! for their bounds and for their bytes, and one at a time is in memory.

mod buffer;

use crate::colour::MeshColour;

use crate::colour::linear;
use crate::moving::{VertexFrames, checked_frame};
use buffer::{Buffer, Piece};
use caphy_core::mesh::vertex_normals;
use caphy_core::pose::Pose;
use caphy_core::{Error, Result, TriMesh, Vec3};
use nalgebra::UnitQuaternion;
use serde_json::{Value, json};
use std::io::Write;
use std::path::Path;

/// What goes into one file.
#[derive(Debug, Clone)]
pub struct GlbScene<'a> {
    /// Frames per second of everything that moves.
    pub fps: f64,
    /// What happens between frames.
    pub interpolation: GlbInterpolation,
    /// The meshes.
    pub meshes: Vec<GlbMesh<'a>>,
}

/// What happens between frames.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum GlbInterpolation {
    /// A frame stays until the next.
    Step,
    /// Straight ways of vertices, shortest arcs of joints.
    Linear,
}

/// A mesh of the scene.
#[derive(Debug, Clone)]
pub struct GlbMesh<'a> {
    /// Name shown by viewers.
    pub name: String,
    /// Rest mesh [m], y up.
    pub mesh: &'a TriMesh,
    /// Colour.
    pub colour: MeshColour<'a>,
    /// Motion.
    pub motion: GlbMotion<'a>,
}

/// Motion of a mesh.
#[derive(Debug, Clone, Copy)]
pub enum GlbMotion<'a> {
    /// None.
    Still,
    /// Vertex positions in each frame.
    Vertices(&'a dyn VertexFrames),
    /// Linear blend skinning.
    Skinned(GlbSkin<'a>),
}

/// Skinning of a mesh; the mesh's vertices are the rest pose.
#[derive(Debug, Clone, Copy)]
pub struct GlbSkin<'a> {
    /// Joint names, shape [joint_count].
    pub names: &'a [&'a str],
    /// Parent of each joint, before its children; the first is the root (its entry is ignored). Shape [joint_count].
    pub parents: &'a [usize],
    /// Rest positions of the joints [m], shape [joint_count].
    pub joints: &'a [Vec3],
    /// Weights, shape [vertex_count, joint_count]; the four largest of each vertex are kept and scaled to sum 1.
    pub weights: &'a [f64],
    /// One pose per frame, with `joint_count` rotations.
    pub poses: &'a [Pose],
}

/// The scene as one array of bytes; see [`write_glb_to`].
///
/// # Errors
/// Those of [`write_glb_to`].
pub fn write_glb(scene: &GlbScene) -> Result<Vec<u8>> {
    let mut out = Vec::new();
    write_glb_to(Path::new("memory"), &mut out, scene)?;
    Ok(out)
}

/// Writes the scene, one frame in memory at a time; `path` is for messages.
///
/// # Errors
/// [`Error::Length`] and [`Error::NonFinite`] naming mesh and array; [`Error::Mesh`] for an empty mesh, no frames, an
/// unordered joint tree, a vertex without weights; [`Error::Numerics`] for a frame rate that is not positive or a file
/// of over 4 GiB, which the format cannot hold; [`Error::Io`]. Nothing is written before all of them but the last are
/// excluded.
pub fn write_glb_to(path: &Path, out: &mut dyn Write, scene: &GlbScene) -> Result<()> {
    if !(scene.fps.is_finite() && scene.fps > 0.0) {
        let problem = format!("frame rate {} 1/s", scene.fps);
        return Err(Error::numerics("GLB scene", problem, "give a positive frame rate"));
    }
    if scene.meshes.is_empty() {
        return Err(Error::numerics("GLB scene", "has no meshes", "give at least one"));
    }
    let mut w = Writer { scene, buffer: Buffer::default(), nodes: vec![], roots: vec![], parts: Parts::default() };
    for (index, mesh) in scene.meshes.iter().enumerate() {
        w.mesh(index, mesh)?;
    }
    w.finish(path, out)
}

#[derive(Default)]
struct Parts {
    meshes: Vec<Value>,
    materials: Vec<Value>,
    skins: Vec<Value>,
    samplers: Vec<Value>,
    channels: Vec<Value>,
}

struct Writer<'a> {
    scene: &'a GlbScene<'a>,
    buffer: Buffer,
    nodes: Vec<Value>,
    roots: Vec<usize>,
    parts: Parts,
}

impl Writer<'_> {
    fn mesh(&mut self, index: usize, item: &GlbMesh) -> Result<()> {
        let (name, mesh) = (&item.name, item.mesh);
        mesh.check(name)?;
        let vertex_count = mesh.vertices.len();
        if vertex_count == 0 || mesh.faces.is_empty() {
            return Err(Error::mesh(name, "whole mesh", "has no faces", "leave it out of the scene"));
        }
        let normals = unit_normals(&mesh.vertices, &mesh.faces);
        let mut attributes = serde_json::Map::new();
        attributes.insert("POSITION".into(), self.buffer.positions(&mesh.vertices).into());
        attributes.insert("NORMAL".into(), self.buffer.normals(&normals).into());
        item.colour.check(name, vertex_count)?;
        // glTF colours are linear; white is the factor that leaves vertex colours as they are.
        let base = match item.colour {
            MeshColour::Uniform(colour) => colour.map(linear),
            MeshColour::PerVertex(colours) => {
                attributes.insert("COLOR_0".into(), self.buffer.colours(colours).into());
                [1.0; 3]
            }
        };
        let material = self.parts.materials.len();
        self.parts.materials.push(json!({
            "name": name,
            "doubleSided": true,
            "pbrMetallicRoughness": {
                "baseColorFactor": [base[0], base[1], base[2], 1.0], "metallicFactor": 0.0, "roughnessFactor": 0.9
            }
        }));
        if let GlbMotion::Skinned(skin) = &item.motion {
            check_skin(name, skin, vertex_count)?;
            let (ids, weights) = self.buffer.influences(name, skin.weights, skin.joints.len())?;
            attributes.insert("JOINTS_0".into(), ids.into());
            attributes.insert("WEIGHTS_0".into(), weights.into());
        }
        let mut primitive = json!({
            "attributes": attributes, "indices": self.buffer.indices(&mesh.faces), "material": material
        });
        let mesh_id = self.parts.meshes.len();
        let node = self.nodes.len();
        self.roots.push(node);
        self.nodes.push(json!({ "name": name, "mesh": mesh_id }));
        let mut entry = json!({ "name": name });
        match &item.motion {
            GlbMotion::Still => {}
            GlbMotion::Vertices(frames) => {
                let count = frames.frame_count();
                // First, since it knows whether the clip fits into the format at all.
                primitive["targets"] = self.targets(index, item, *frames)?.into();
                let input = self.times(name, count)?;
                // A viewer that does not animate shows the first frame.
                entry["weights"] = (0..count).map(|k| f64::from(u8::from(k == 0))).collect::<Vec<f64>>().into();
                let output = self.buffer.walking_weights(count)?;
                self.channel(node, "weights", input, output);
            }
            GlbMotion::Skinned(skin) => self.skin(name, skin, node)?,
        }
        entry["primitives"] = json!([primitive]);
        self.parts.meshes.push(entry);
        Ok(())
    }

    /// Describes a morph target per frame; their bytes are made when they are written.
    fn targets(&mut self, index: usize, item: &GlbMesh, frames: &dyn VertexFrames) -> Result<Vec<Value>> {
        let rest = &item.mesh.vertices;
        let mut vertices = Vec::with_capacity(rest.len());
        self.buffer.targets(index, frames.frame_count(), rest.len(), |frame| {
            checked_frame(&item.name, rest.len(), frames, frame, &mut vertices)?;
            Ok(buffer::bounds_f32(vertices.iter().zip(rest).map(|(a, b)| a - b)))
        })
    }

    fn skin(&mut self, name: &str, skin: &GlbSkin, mesh_node: usize) -> Result<()> {
        let first = self.nodes.len();
        let count = skin.joints.len();
        for joint in 0..count {
            let offset =
                if joint == 0 { skin.joints[0] } else { skin.joints[joint] - skin.joints[skin.parents[joint]] };
            let mut node = json!({ "name": skin.names[joint], "translation": [offset.x, offset.y, offset.z] });
            let children: Vec<usize> = (1..count).filter(|&c| skin.parents[c] == joint).map(|c| first + c).collect();
            if !children.is_empty() {
                node["children"] = children.into();
            }
            self.nodes.push(node);
        }
        self.roots.push(first);
        let skin_id = self.parts.skins.len();
        self.nodes[mesh_node]["skin"] = skin_id.into();
        let joints: Vec<usize> = (first..first + count).collect();
        self.parts.skins.push(json!({
            "name": name, "joints": joints, "skeleton": first,
            "inverseBindMatrices": self.buffer.inverse_bind_matrices(skin.joints)
        }));

        let input = self.times(name, skin.poses.len())?;
        // The root turns about its own rest position, then the body moves: as a node, rest position plus translation.
        let way: Vec<Vec3> = skin.poses.iter().map(|p| skin.joints[0] + p.translation).collect();
        let output = self.buffer.translations(&way);
        self.channel(first, "translation", input, output);
        for joint in 0..count {
            // Most joints of most clips (face, fingers) rest: no channel is smaller than a constant one.
            if skin.poses.iter().all(|p| p.rotations[joint] == Vec3::zeros()) {
                continue;
            }
            let mut last = UnitQuaternion::identity();
            let turns: Vec<UnitQuaternion<f64>> = skin
                .poses
                .iter()
                .map(|p| {
                    let q = UnitQuaternion::from_scaled_axis(p.rotations[joint]);
                    // q and -q are the same turn: the nearer one keeps curves smooth in editors.
                    last = if q.coords.dot(&last.coords) < 0.0 { UnitQuaternion::new_unchecked(-*q) } else { q };
                    last
                })
                .collect();
            let output = self.buffer.quaternions(&turns);
            self.channel(first + joint, "rotation", input, output);
        }
        Ok(())
    }

    fn times(&mut self, name: &str, frames: usize) -> Result<usize> {
        if frames == 0 {
            return Err(Error::mesh(name, "motion", "has no frames", "make the mesh a still one"));
        }
        Ok(self.buffer.times(frames, self.scene.fps))
    }

    fn channel(&mut self, node: usize, path: &str, input: usize, output: usize) {
        let interpolation = match self.scene.interpolation {
            GlbInterpolation::Step => "STEP",
            GlbInterpolation::Linear => "LINEAR",
        };
        let sampler = self.parts.samplers.len();
        self.parts.samplers.push(json!({ "input": input, "output": output, "interpolation": interpolation }));
        self.parts.channels.push(json!({ "sampler": sampler, "target": { "node": node, "path": path } }));
    }

    fn finish(self, path: &Path, out: &mut dyn Write) -> Result<()> {
        let data = self.buffer.len();
        let mut document = json!({
            "asset": { "version": "2.0", "generator": "caphy" },
            "scene": 0,
            "scenes": [{ "nodes": self.roots }],
            "nodes": self.nodes,
            "meshes": self.parts.meshes,
            "materials": self.parts.materials,
            "buffers": [{ "byteLength": data }],
            "bufferViews": self.buffer.views,
            "accessors": self.buffer.accessors,
        });
        // Empty lists are against the format.
        if !self.parts.skins.is_empty() {
            document["skins"] = self.parts.skins.into();
        }
        if !self.parts.channels.is_empty() {
            document["animations"] =
                json!([{ "name": "motion", "samplers": self.parts.samplers, "channels": self.parts.channels }]);
        }
        let mut text = document.to_string().into_bytes();
        drop(document);
        text.resize(text.len().next_multiple_of(4), b' ');
        // Every accessor is padded to four bytes as it is written.
        let total = buffer::checked_size(12 + 8 + text.len() + 8 + data)?;
        let failed = |e| Error::io(path, "write", e);
        let mut head = Vec::with_capacity(20);
        head.extend(b"glTF");
        head.extend(2u32.to_le_bytes());
        head.extend(total.to_le_bytes());
        head.extend((text.len() as u32).to_le_bytes());
        head.extend(b"JSON");
        out.write_all(&head).map_err(failed)?;
        out.write_all(&text).map_err(failed)?;
        drop(text);
        out.write_all(&(data as u32).to_le_bytes()).map_err(failed)?;
        out.write_all(b"BIN\0").map_err(failed)?;
        for piece in self.buffer.into_pieces() {
            match piece {
                Piece::Bytes(bytes) => out.write_all(&bytes).map_err(failed)?,
                Piece::Weights(frames) => buffer::write_weights(out, frames).map_err(failed)?,
                Piece::Targets(index) => write_targets(path, out, &self.scene.meshes[index])?,
            }
        }
        out.flush().map_err(failed)
    }
}

/// The bytes of a mesh's morph targets: differences of positions and of normals, frame by frame.
fn write_targets(path: &Path, out: &mut dyn Write, item: &GlbMesh) -> Result<()> {
    let GlbMotion::Vertices(frames) = item.motion else { return Ok(()) };
    let rest = &item.mesh.vertices;
    let normals = unit_normals(rest, &item.mesh.faces);
    let mut vertices = Vec::with_capacity(rest.len());
    let mut bytes = Vec::with_capacity(24 * rest.len());
    for frame in 0..frames.frame_count() {
        checked_frame(&item.name, rest.len(), frames, frame, &mut vertices)?;
        let turned = unit_normals(&vertices, &item.mesh.faces);
        bytes.clear();
        let differences = vertices.iter().zip(rest).chain(turned.iter().zip(&normals));
        for c in differences.flat_map(|(a, b)| (a - b).data.0[0]) {
            bytes.extend((c as f32).to_le_bytes());
        }
        out.write_all(&bytes).map_err(|e| Error::io(path, "write", e))?;
    }
    Ok(())
}

fn check_skin(name: &str, skin: &GlbSkin, vertex_count: usize) -> Result<()> {
    let count = skin.joints.len();
    let what = |array: &str| format!("mesh `{name}`, {array}");
    Error::check_length(&what("joint names"), count, skin.names.len())?;
    Error::check_length(&what("joint parents"), count, skin.parents.len())?;
    Error::check_length(&what("weights"), vertex_count.saturating_mul(count), skin.weights.len())?;
    Error::check_finite(&what("weights"), skin.weights)?;
    if count == 0 || count > usize::from(u16::MAX) {
        return Err(Error::mesh(name, "joints", format!("{count} of them"), "1 to 65535 are possible"));
    }
    if let Some(joint) = (1..count).find(|&j| skin.parents[j] >= j) {
        return Err(Error::mesh(
            name,
            format!("joint {joint}"),
            format!("its parent is {}", skin.parents[joint]),
            "order joints with parents before children, one root first",
        ));
    }
    for (joint, position) in skin.joints.iter().enumerate() {
        Error::check_finite(&what(&format!("joint {joint}")), position.as_slice())?;
    }
    for (frame, pose) in skin.poses.iter().enumerate() {
        Error::check_length(&what(&format!("frame {frame}, rotations")), count, pose.rotations.len())?;
        for vector in pose.rotations.iter().chain([&pose.translation]) {
            Error::check_finite(&what(&format!("frame {frame}")), vector.as_slice())?;
        }
    }
    Ok(())
}

/// Vertex normals of unit length; up for a vertex without area, since the format allows no zero.
fn unit_normals(vertices: &[Vec3], faces: &[[u32; 3]]) -> Vec<Vec3> {
    let mut normals = vertex_normals(vertices, faces);
    for n in &mut normals {
        if *n == Vec3::zeros() {
            *n = Vec3::y();
        }
    }
    normals
}
