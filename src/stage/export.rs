//! Files for other programs: GLB with the moving avatar, OBJ of every n-th frame, the nets as safetensors.

use super::animate::Film;
use super::preprocess::Subject;
use super::train::Nets;
use super::{Context, StageOutput};
use crate::scene::Scene;
use caphy_core::{Result, TriMesh, Vec3};
use caphy_formats::glb::{GlbColour, GlbInterpolation, GlbMesh, GlbMotion, GlbScene, GlbSkin, write_glb};
use caphy_formats::obj::write_obj;
use caphy_formats::weights::write_safetensors;
use caphy_render::shade::{CLAY_LOWER, CLAY_SKIN, CLAY_UPPER};
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// What was written, relative to the run directory.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Exported {
    /// All files.
    pub files: Vec<PathBuf>,
}

impl StageOutput for Exported {
    fn files(&self) -> Vec<PathBuf> {
        self.files.clone()
    }
}

/// Writes `export/`.
pub fn run(context: &Context<'_>, subject: &Subject, avatar: &Nets, film: &Film) -> Result<Exported> {
    let scene = Scene::new(context, subject)?;
    let mut files = Vec::new();
    let mut put = |name: String, bytes: Vec<u8>| -> Result<()> {
        context.write(&name, &bytes)?;
        files.push(name.into());
        Ok(())
    };
    let frames = film.clip.poses.len();
    for frame in (0..frames).step_by(context.config.animate.obj_every) {
        context.progress.set(frame as f64 / frames as f64, "OBJ");
        let posed = scene.body.forward(&scene.subject.posed(&film.clip.poses[frame]))?;
        let body = TriMesh { vertices: posed.vertices, faces: scene.rest.faces.clone() };
        put(format!("export/obj/body_{frame:05}.obj"), write_obj(&body, None)?)?;
        for (garment, played) in subject.garments.iter().zip(&film.garments) {
            let mesh = TriMesh { vertices: played.vertices(frame), faces: garment.mesh.faces.clone() };
            put(format!("export/obj/{}_{frame:05}.obj", garment.kind), write_obj(&mesh, None)?)?;
        }
    }
    put("export/avatar.glb".into(), glb(&scene, subject, film)?)?;
    for trained in &avatar.garments {
        let tensors: Vec<(&str, &[usize], &[f32])> = trained
            .manifest
            .tensors
            .iter()
            .map(|t| (t.name.as_str(), &t.shape[..], &trained.parameters[t.offset..t.offset + t.len()]))
            .collect();
        let facts = [
            ("net", trained.manifest.name.clone()),
            ("garment", trained.kind.to_string()),
            ("metres_per_unit", trained.output_scale_m.to_string()),
        ];
        let bytes = write_safetensors(&tensors, &facts.map(|(k, v)| (k.to_string(), v)).into())?;
        put(format!("export/{}.safetensors", trained.kind), bytes)?;
    }
    Ok(Exported { files })
}

/// The moving avatar: the body skinned by its joints, each garment with its vertices per frame.
fn glb(scene: &Scene, subject: &Subject, film: &Film) -> Result<Vec<u8>> {
    let description = scene.body.describe();
    let joints = &description.joints;
    let names: Vec<&str> = joints.iter().map(|j| j.name.as_str()).collect();
    let parents: Vec<usize> = joints.iter().map(|j| j.parent.unwrap_or(0)).collect();
    let mut weights = vec![0.0; description.vertex_count * joints.len()];
    for v in 0..description.vertex_count {
        for (joint, weight) in description.weights.row(v) {
            weights[v * joints.len() + joint] += weight;
        }
    }
    let skin = GlbSkin {
        names: &names,
        parents: &parents,
        joints: &scene.rest_joints,
        weights: &weights,
        poses: &film.clip.poses,
    };
    let frames: Vec<Vec<Vec<Vec3>>> =
        film.garments.iter().map(|g| (0..g.frames.len()).map(|f| g.vertices(f)).collect()).collect();
    let mut meshes = vec![GlbMesh {
        name: "body".into(),
        mesh: &scene.rest,
        colour: GlbColour::Uniform(CLAY_SKIN),
        motion: GlbMotion::Skinned(skin),
    }];
    for ((garment, frames), colour) in subject.garments.iter().zip(&frames).zip([CLAY_UPPER, CLAY_LOWER]) {
        meshes.push(GlbMesh {
            name: garment.kind.to_string(),
            mesh: &garment.mesh,
            colour: GlbColour::Uniform(colour),
            motion: GlbMotion::Vertices(frames),
        });
    }
    write_glb(&GlbScene { fps: film.clip.fps, interpolation: GlbInterpolation::Linear, meshes })
}
