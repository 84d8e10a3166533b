//! Files for other programs: GLB with the moving avatar, OBJ of every n-th frame, the nets as safetensors.

use super::animate::{Film, Played};
use super::preprocess::Subject;
use super::train::Nets;
use super::{Context, StageOutput};
use crate::avatar::Avatar;
use crate::moving::{self, MovingFigure, MovingFormat};
use crate::scene::Scene;
use caphy_core::{Result, TriMesh};
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
pub fn run(context: &Context<'_>, subject: &Subject, avatar: &Nets, film: Option<&Film>) -> Result<Exported> {
    let mut files: Vec<PathBuf> = Vec::new();
    if let Some(film) = film {
        moving_files(context, subject, film, &mut files)?;
    }
    Avatar::new(context, subject, avatar)?.save(&context.folder.join("export/avatar.caphy"))?;
    files.push("export/avatar.caphy".into());
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
        put(context, &mut files, format!("export/{}.safetensors", trained.kind), &bytes)?;
    }
    Ok(Exported { files })
}

fn put(context: &Context<'_>, files: &mut Vec<PathBuf>, name: String, bytes: &[u8]) -> Result<()> {
    context.write(&name, bytes)?;
    files.push(name.into());
    Ok(())
}

/// The played clip.
fn moving_files(context: &Context<'_>, subject: &Subject, film: &Film, files: &mut Vec<PathBuf>) -> Result<()> {
    let scene = Scene::new(context, subject)?;
    let figure = Played { scene: &scene, garments: &subject.garments, film };
    let frames = film.clip.poses.len();
    let every = context.config.animate.as_ref().map_or(1, |a| a.obj_every);
    for frame in (0..frames).step_by(every) {
        context.progress.set(frame as f64 / frames as f64, "OBJ");
        let body = TriMesh { vertices: figure.body_frame(frame)?, faces: scene.rest.faces.clone() };
        put(context, files, format!("export/obj/body_{frame:05}.obj"), &write_obj(&body, None)?)?;
        for (garment, played) in subject.garments.iter().zip(&film.garments) {
            let mesh = TriMesh { vertices: played.vertices(frame), faces: garment.mesh.faces.clone() };
            put(context, files, format!("export/obj/{}_{frame:05}.obj", garment.kind), &write_obj(&mesh, None)?)?;
        }
    }
    for path in moving::write(&figure, MovingFormat::Glb, &context.folder.join("export"))? {
        let relative = path.strip_prefix(context.folder).unwrap_or(&path);
        files.push(relative.into());
    }
    Ok(())
}
