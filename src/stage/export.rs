//! Files for other programs: GLB with the moving avatar, OBJ of every n-th frame, the nets as safetensors.

use super::animate::Film;
use super::preprocess::Subject;
use super::train::Nets;
use super::{Context, StageOutput};
use crate::moving::{self, MovingFigure, MovingFormat, MovingGarment};
use crate::scene::Scene;
use caphy_core::body::BodyModel;
use caphy_core::motion::MotionClip;
use caphy_core::{Result, TriMesh, Vec3};
use caphy_formats::obj::write_obj;
use caphy_formats::weights::write_safetensors;
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
    let figure = Played { scene: &scene, subject, film };
    let mut files: Vec<PathBuf> = Vec::new();
    let put = |files: &mut Vec<PathBuf>, name: String, bytes: Vec<u8>| -> Result<()> {
        context.write(&name, &bytes)?;
        files.push(name.into());
        Ok(())
    };
    let frames = film.clip.poses.len();
    for frame in (0..frames).step_by(context.config.animate.obj_every) {
        context.progress.set(frame as f64 / frames as f64, "OBJ");
        let body = TriMesh { vertices: figure.body_frame(frame)?, faces: scene.rest.faces.clone() };
        put(&mut files, format!("export/obj/body_{frame:05}.obj"), write_obj(&body, None)?)?;
        for (garment, played) in subject.garments.iter().zip(&film.garments) {
            let mesh = TriMesh { vertices: played.vertices(frame), faces: garment.mesh.faces.clone() };
            put(&mut files, format!("export/obj/{}_{frame:05}.obj", garment.kind), write_obj(&mesh, None)?)?;
        }
    }
    for path in moving::write(&figure, MovingFormat::Glb, &context.folder.join("export"))? {
        let relative = path.strip_prefix(context.folder).unwrap_or(&path);
        files.push(relative.into());
    }
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
        put(&mut files, format!("export/{}.safetensors", trained.kind), bytes)?;
    }
    Ok(Exported { files })
}

/// The avatar as it was played.
struct Played<'a> {
    scene: &'a Scene,
    subject: &'a Subject,
    film: &'a Film,
}

impl MovingFigure for Played<'_> {
    fn body(&self) -> &dyn BodyModel {
        &*self.scene.body
    }
    fn rest(&self) -> &TriMesh {
        &self.scene.rest
    }
    fn rest_joints(&self) -> Result<Vec<Vec3>> {
        Ok(self.scene.rest_joints.clone())
    }
    fn clip(&self) -> &MotionClip {
        &self.film.clip
    }
    fn body_frame(&self, frame: usize) -> Result<Vec<Vec3>> {
        Ok(self.scene.body.forward(&self.scene.subject.posed(&self.film.clip.poses[frame]))?.vertices)
    }
    fn garments(&self) -> Vec<MovingGarment<'_>> {
        self.subject.garments.iter().map(|g| MovingGarment { kind: g.kind, mesh: &g.mesh }).collect()
    }
    fn garment_frame(&self, garment: usize, frame: usize) -> Result<Vec<Vec3>> {
        Ok(self.film.garments[garment].vertices(frame))
    }
}
