//! A figure in motion, and the files that other programs open of it: GLB, USD, point caches, OBJ sequences.

use crate::artifact::{write_atomically, write_atomically_with};
use crate::pictures;
use caphy_core::body::{BodyDescription, BodyModel};
use caphy_core::motion::MotionClip;
use caphy_core::pose::Pose;
use caphy_core::{Error, Result, TriMesh, Vec3, mesh};
use caphy_formats::colour::MeshColour;
use caphy_formats::glb::{GlbInterpolation, GlbMesh, GlbMotion, GlbScene, GlbSkin, write_glb_to};
use caphy_formats::moving::{ComputedFrames, MovingMesh, VertexFrames};
use caphy_formats::obj::{ObjSequence, write_obj};
use caphy_formats::pc2::{Pc2Timing, write_pc2};
use caphy_formats::usd::{UsdScene, write_usda};
use caphy_garment::template::GarmentKind;
use caphy_render::shade::{CLAY_LOWER, CLAY_SKIN, CLAY_UPPER};
use caphy_render::{Layer, Rgb};
use std::path::{Path, PathBuf};

/// A garment of a figure.
#[derive(Debug, Clone, Copy)]
pub struct MovingGarment<'a> {
    /// What it covers.
    pub kind: GarmentKind,
    /// Its mesh on the T-posed body.
    pub mesh: &'a TriMesh,
}

/// A body and garments in every frame of a clip.
pub trait MovingFigure: Sync {
    /// The body model.
    fn body(&self) -> &dyn BodyModel;
    /// The T-posed surface of this body's shape [m].
    fn rest(&self) -> &TriMesh;
    /// Its joints [m].
    fn rest_joints(&self) -> Result<Vec<Vec3>>;
    /// The motion.
    fn clip(&self) -> &MotionClip;
    /// Body vertices of a frame [m].
    fn body_frame(&self, frame: usize) -> Result<Vec<Vec3>>;
    /// Its garments.
    fn garments(&self) -> Vec<MovingGarment<'_>>;
    /// Vertices of a garment in a frame [m].
    fn garment_frame(&self, garment: usize, frame: usize) -> Result<Vec<Vec3>>;
    /// Vertex colours (sRGB) of the body (0) and of its garments (from 1 on), where there are any.
    fn colours(&self, _part: usize) -> Option<&[[u8; 3]]> {
        None
    }
}

/// The colours of a part, or one colour.
fn colour_of(figure: &dyn MovingFigure, part: usize, otherwise: [u8; 3]) -> MeshColour<'_> {
    figure.colours(part).map_or(MeshColour::Uniform(otherwise), MeshColour::PerVertex)
}

/// Files that a figure can be written as.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum MovingFormat {
    /// glTF: the body skinned by its joints, garments with their vertices per frame; one file.
    Glb,
    /// USD as text with time samples; one file.
    Usd,
    /// A mesh (OBJ) and its point cache for each of body and garments.
    Pc2,
    /// A folder of OBJ, one per frame, for each of body and garments.
    Obj,
}

/// What GLB needs of a body.
pub struct BodySkin {
    parents: Vec<usize>,
    /// Dense, shape [vertex_count, joint_count].
    weights: Vec<f64>,
}

impl BodySkin {
    /// Spreads the body's blend weights.
    pub fn new(description: &BodyDescription) -> Self {
        let count = description.joints.len();
        let mut weights = vec![0.0; description.vertex_count * count];
        for v in 0..description.vertex_count {
            for (joint, weight) in description.weights.row(v) {
                weights[v * count + joint] += weight;
            }
        }
        Self { parents: description.joints.iter().map(|j| j.parent.unwrap_or(0)).collect(), weights }
    }
    /// The skin in motion; pose correctives are not in it.
    pub fn moving<'a>(&'a self, names: &'a [&'a str], joints: &'a [Vec3], poses: &'a [Pose]) -> GlbSkin<'a> {
        GlbSkin { names, parents: &self.parents, joints, weights: &self.weights, poses }
    }
}

/// Colour of a garment in files and pictures.
pub fn garment_colour(kind: GarmentKind) -> [u8; 3] {
    match kind {
        GarmentKind::Upper => CLAY_UPPER,
        GarmentKind::Lower => CLAY_LOWER,
    }
}

/// Garments' names: their kind, numbered where one comes twice.
fn garment_names(garments: &[MovingGarment<'_>]) -> Vec<String> {
    let mut names: Vec<String> = Vec::new();
    for garment in garments {
        let name = garment.kind.to_string();
        let before =
            names.iter().filter(|n| n.trim_end_matches(|c: char| c.is_ascii_digit() || c == '-') == name).count();
        names.push(if before == 0 { name } else { format!("{name}-{}", before + 1) });
    }
    names
}

/// Writes the figure below `folder` and returns the files, or for OBJ sequences their folders.
///
/// # Errors
/// What a frame cannot be computed for; [`Error::Io`].
pub fn write(figure: &dyn MovingFigure, format: MovingFormat, folder: &Path) -> Result<Vec<PathBuf>> {
    let garments = figure.garments();
    let names = garment_names(&garments);
    let frame_count = figure.clip().poses.len();
    let body_frames = ComputedFrames {
        frame_count,
        compute: |frame: usize, out: &mut Vec<Vec3>| {
            out.extend(figure.body_frame(frame)?);
            Ok(())
        },
    };
    let garment_frames: Vec<_> = (0..garments.len())
        .map(|g| ComputedFrames {
            frame_count,
            compute: move |frame: usize, out: &mut Vec<Vec3>| {
                out.extend(figure.garment_frame(g, frame)?);
                Ok(())
            },
        })
        .collect();
    if format == MovingFormat::Glb {
        let frames: Vec<&dyn VertexFrames> = garment_frames.iter().map(|f| f as &dyn VertexFrames).collect();
        let path = folder.join("avatar.glb");
        write_glb_file(figure, &garments, &names, &frames, &path)?;
        return Ok(vec![path]);
    }
    let mut meshes = vec![MovingMesh {
        name: "body".into(),
        vertex_count: figure.rest().vertices.len(),
        faces: &figure.rest().faces,
        uvs: None,
        colour: colour_of(figure, 0, CLAY_SKIN),
        frames: &body_frames,
    }];
    for (g, ((garment, name), frames)) in garments.iter().zip(&names).zip(&garment_frames).enumerate() {
        meshes.push(MovingMesh {
            name: name.clone(),
            vertex_count: garment.mesh.vertices.len(),
            faces: &garment.mesh.faces,
            uvs: None,
            colour: colour_of(figure, g + 1, garment_colour(garment.kind)),
            frames,
        });
    }
    let mut files = Vec::new();
    match format {
        MovingFormat::Glb => {}
        MovingFormat::Usd => {
            let path = folder.join("avatar.usda");
            let scene = UsdScene { name: "avatar".into(), fps: figure.clip().fps, normals: true, meshes };
            write_atomically_with(&path, |out| write_usda(&path, out, &scene))?;
            files.push(path);
        }
        MovingFormat::Pc2 => {
            for (part, mesh) in meshes.iter().enumerate() {
                let (surface, cache) =
                    (folder.join(format!("{}.obj", mesh.name)), folder.join(format!("{}.pc2", mesh.name)));
                let mut vertices = Vec::new();
                mesh.frame(0, &mut vertices)?;
                let first = TriMesh { vertices, faces: mesh.faces.to_vec() };
                write_atomically(&surface, &write_obj(&first, figure.colours(part))?)?;
                write_atomically_with(&cache, |out| write_pc2(&cache, out, mesh, Pc2Timing::default()))?;
                files.extend([surface, cache]);
            }
        }
        MovingFormat::Obj => {
            for mesh in &meshes {
                let sequence = ObjSequence::new(mesh)?;
                let own = folder.join(&mesh.name);
                for frame in 0..sequence.frame_count() {
                    write_atomically(&own.join(sequence.file_name(frame)), &sequence.file(frame)?)?;
                }
                files.push(own);
            }
        }
    }
    Ok(files)
}

fn write_glb_file(
    figure: &dyn MovingFigure,
    garments: &[MovingGarment<'_>],
    names: &[String],
    frames: &[&dyn VertexFrames],
    path: &Path,
) -> Result<()> {
    let description = figure.body().describe();
    let joint_names: Vec<&str> = description.joints.iter().map(|j| j.name.as_str()).collect();
    let (skin, joints) = (BodySkin::new(description), figure.rest_joints()?);
    let mut meshes = vec![GlbMesh {
        name: "body".into(),
        mesh: figure.rest(),
        colour: colour_of(figure, 0, CLAY_SKIN),
        motion: GlbMotion::Skinned(skin.moving(&joint_names, &joints, &figure.clip().poses)),
    }];
    for (g, ((garment, name), frames)) in garments.iter().zip(names).zip(frames).enumerate() {
        meshes.push(GlbMesh {
            name: name.clone(),
            mesh: garment.mesh,
            colour: colour_of(figure, g + 1, garment_colour(garment.kind)),
            motion: GlbMotion::Vertices(*frames),
        });
    }
    let scene = GlbScene { fps: figure.clip().fps, interpolation: GlbInterpolation::Linear, meshes };
    write_atomically_with(path, |out| write_glb_to(path, out, &scene))
}

/// A frame of the figure from one side.
///
/// # Errors
/// What the frame cannot be computed for.
pub fn picture(figure: &dyn MovingFigure, frame: usize, from: &Vec3) -> Result<Rgb> {
    let body = TriMesh { vertices: figure.body_frame(frame)?, faces: figure.rest().faces.clone() };
    let garments = figure.garments();
    let worn = garments
        .iter()
        .enumerate()
        .map(|(g, garment)| {
            Ok(TriMesh { vertices: figure.garment_frame(g, frame)?, faces: garment.mesh.faces.clone() })
        })
        .collect::<Result<Vec<_>>>()?;
    let mut layers = vec![Layer::uniform(&body, CLAY_SKIN)];
    layers.extend(worn.iter().zip(&garments).map(|(mesh, g)| Layer::uniform(mesh, garment_colour(g.kind))));
    let bounds = mesh::bounds(&body.vertices)
        .ok_or_else(|| Error::mesh("body", "posed surface", "has no vertices", "give a body with a surface"))?;
    Ok(pictures::draw(layers, pictures::padded(bounds), from))
}

/// PNG of `count` frames spread over the clip, front and back in turn.
///
/// # Errors
/// As [`picture`].
pub fn preview(figure: &dyn MovingFigure, count: usize) -> Result<Vec<u8>> {
    let clip = figure.clip();
    let last = clip.poses.len() - 1;
    let count = count.clamp(1, clip.poses.len());
    let cells = (0..count)
        .map(|i| {
            let frame = if count == 1 { 0 } else { i * last / (count - 1) };
            let (side, from) = if i % 2 == 0 { ("", pictures::FRONT) } else { (", back", pictures::BACK) };
            Ok((format!("{:.2} s{side}", frame as f64 / clip.fps), picture(figure, frame, &from)?))
        })
        .collect::<Result<Vec<_>>>()?;
    pictures::sheet(&cells, count.min(8))
}
