//! USD as text (`.usda`): meshes with time samples under one Xform.
//!
//! Time codes are frame numbers from 1, the timeline's first; `timeCodesPerSecond` says how long a frame lasts. A mesh of
//! one frame has plain values and no time samples. Colours are linear, as USD wants them.

mod identifier;
mod text;

pub use identifier::{usd_identifier, usd_identifiers};

use crate::colour::{MeshColour, linear};
use crate::moving::MovingMesh;
use caphy_core::mesh::{bounds, vertex_normals};
use caphy_core::{Error, Result, Vec3};
use std::fmt::Write as _;
use std::io::Write;
use std::path::Path;
use text::{Text, quoted, tuple};

/// What goes into one file.
#[derive(Debug, Clone)]
pub struct UsdScene<'a> {
    /// Name of the Xform above all meshes, the stage's default prim.
    pub name: String,
    /// Frames per second.
    pub fps: f64,
    /// Whether vertex normals are written; without them most programs shade each triangle flat.
    pub normals: bool,
    /// The meshes; those that move have the same number of frames.
    pub meshes: Vec<MovingMesh<'a>>,
}

/// Number of the first frame.
const FIRST: usize = 1;

/// Writes the scene as it goes, one frame in memory at a time; `path` is for messages.
///
/// Names that are no identifiers of USD are made valid ([`usd_identifiers`]) and kept as display names.
///
/// # Errors
/// Those of [`MovingMesh::check`] and [`MovingMesh::frame`]; [`Error::Numerics`] for a frame rate that is not positive or a
/// scene without meshes; [`Error::Length`] for meshes of different frame counts; [`Error::Io`].
pub fn write_usda(path: &Path, out: &mut dyn Write, scene: &UsdScene<'_>) -> Result<()> {
    if !(scene.fps.is_finite() && scene.fps > 0.0) {
        let problem = format!("frame rate {} 1/s", scene.fps);
        return Err(Error::numerics("USD scene", problem, "give a positive frame rate"));
    }
    let frames = scene.meshes.iter().map(|m| m.frames.frame_count()).max().unwrap_or(0);
    if frames == 0 {
        return Err(Error::numerics("USD scene", "has no meshes or no frames", "give at least one mesh of one frame"));
    }
    for mesh in &scene.meshes {
        mesh.check()?;
        if mesh.frames.frame_count() != 1 {
            Error::check_length(&format!("frames of mesh `{}`", mesh.name), frames, mesh.frames.frame_count())?;
        }
    }
    let mut text = Text::new(path, out);
    let root = usd_identifier(&scene.name);
    let fps = scene.fps;
    let last = FIRST + frames - 1;
    text.line(&format!(
        "#usda 1.0\n(\n    defaultPrim = \"{root}\"\n    doc = \"caphy, metres\"\n    startTimeCode = {FIRST}\n    \
         endTimeCode = {last}\n    timeCodesPerSecond = {fps}\n    framesPerSecond = {fps}\n    metersPerUnit = 1\n    \
         upAxis = \"Y\"\n)\n"
    ))?;
    text.line(&format!("def Xform \"{root}\" (\n    kind = \"component\"\n)\n{{"))?;
    let names: Vec<&str> = scene.meshes.iter().map(|m| m.name.as_str()).collect();
    for (mesh, id) in scene.meshes.iter().zip(usd_identifiers(&names)) {
        write_mesh(&mut text, mesh, &id, scene.normals)?;
    }
    text.line("}")?;
    text.finish()
}

fn write_mesh(text: &mut Text<'_>, mesh: &MovingMesh<'_>, id: &str, normals: bool) -> Result<()> {
    let meta = match mesh.name == id {
        true => String::new(),
        false => format!(" (\n        displayName = {}\n    )", quoted(&mesh.name)),
    };
    text.line(&format!("    def Mesh \"{id}\"{meta}\n    {{"))?;
    text.line("        uniform token subdivisionScheme = \"none\"")?;
    // Cloth is seen from both sides.
    text.line("        uniform bool doubleSided = 1")?;
    text.list("int[] faceVertexCounts", mesh.faces.len(), None, |out, _| out.push('3'))?;
    let corners = mesh.faces.as_flattened();
    text.list("int[] faceVertexIndices", corners.len(), None, |out, i| {
        let _ = write!(out, "{}", corners[i]);
    })?;
    let (colours, kind) = match &mesh.colour {
        MeshColour::Uniform(colour) => (std::slice::from_ref(colour), "constant"),
        MeshColour::PerVertex(colours) => (*colours, "vertex"),
    };
    let linear = |i: usize| colours[i].map(|c| linear(c) as f32);
    text.list("color3f[] primvars:displayColor", colours.len(), Some(kind), |out, i| tuple(out, &linear(i)))?;
    if let Some(uvs) = mesh.uvs {
        let uv = |out: &mut String, i: usize| tuple(out, &uvs.coords[i].map(|c| c as f32));
        text.list("texCoord2f[] primvars:st", uvs.coords.len(), Some("faceVarying"), uv)?;
        let ids = uvs.faces.as_flattened();
        text.list("int[] primvars:st:indices", ids.len(), None, |out, i| {
            let _ = write!(out, "{}", ids[i]);
        })?;
    }

    let frames = mesh.frames.frame_count();
    let mut vertices = Vec::with_capacity(mesh.vertex_count);
    let mut extents: Vec<[Vec3; 2]> = Vec::with_capacity(frames);
    text.samples("point3f[] points", frames, None, |text, frame| {
        mesh.frame(frame, &mut vertices)?;
        extents.extend(bounds(&vertices).map(|(low, high)| [low, high]));
        text.values(vertices.len(), |out, v| tuple(out, &single(&vertices[v])))
    })?;
    text.samples("float3[] extent", frames, None, |text, frame| {
        text.values(2, |out, k| tuple(out, &single(&extents[frame][k])))
    })?;
    if normals {
        text.samples("normal3f[] normals", frames, Some("vertex"), |text, frame| {
            mesh.frame(frame, &mut vertices)?;
            let normals = vertex_normals(&vertices, mesh.faces);
            text.values(normals.len(), |out, v| tuple(out, &single(&normals[v])))
        })?;
    }
    text.line("    }")
}

fn single(v: &Vec3) -> [f32; 3] {
    [v.x as f32, v.y as f32, v.z as f32]
}
