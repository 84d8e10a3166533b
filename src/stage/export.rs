//! Files for other programs: GLB with the moving avatar, OBJ of every n-th frame, PLY with the scans' colours, the nets as safetensors.

use super::animate::{Film, Played};
use super::preprocess::Subject;
use super::scans::read_framed;
use super::train::Nets;
use super::{Context, Scans, StageOutput};
use crate::avatar::Avatar;
use crate::colours::{ColouredPoints, PartColours};
use crate::inference::{Play, play};
use crate::moving::{self, MovingFigure, MovingFormat};
use crate::pictures::{self, Dressed};
use crate::scene::{Scene, label_of};
use caphy_core::scan::{Label, Scan};
use caphy_core::{Result, TriMesh, Vec3};
use caphy_formats::obj::write_obj;
use caphy_formats::ply::write_ply;
use caphy_formats::weights::write_safetensors;
use caphy_render::Layer;
use caphy_render::shade::CLAY;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// What was written, relative to the run directory.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Exported {
    /// All files.
    pub files: Vec<PathBuf>,
    /// Share of vertices of each part that a scan gave a colour; none where scans have none.
    pub coloured: Vec<(String, f64)>,
    /// A scan beside the avatar, without and with colours.
    pub picture: Option<PathBuf>,
}

impl StageOutput for Exported {
    fn files(&self) -> Vec<PathBuf> {
        self.files.iter().chain(&self.picture).cloned().collect()
    }
}

/// Writes `export/`.
pub fn run(
    context: &Context<'_>,
    subject: &Subject,
    avatar: &Nets,
    film: Option<&Film>,
    scans: &Scans,
) -> Result<Exported> {
    let mut files: Vec<PathBuf> = Vec::new();
    let painted = paint(context, subject, avatar, scans)?;
    let colours = painted.as_ref().map_or(Vec::new(), |p| p.colours.clone());
    if let Some(film) = film {
        moving_files(context, subject, film, &colours, &mut files)?;
    }
    if let Some(painted) = &painted {
        for ((name, _), (mesh, colours)) in painted.seen.iter().zip(painted.rest.iter().zip(&colours)) {
            let scan = Scan { name: name.clone(), mesh: mesh.clone(), colours: Some(colours.clone()), labels: None };
            put(context, &mut files, format!("export/{name}.ply"), &write_ply(&scan))?;
        }
    }
    Avatar::new(context, subject, avatar, colours)?.save(&context.folder.join("export/avatar.caphy"))?;
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
    let (coloured, picture) = painted.map_or((Vec::new(), None), |p| (p.seen, Some(p.picture)));
    Ok(Exported { files, coloured, picture })
}

/// The avatar in the scans' colours.
struct Painted {
    /// Vertex colours of body and garments.
    colours: Vec<Vec<[u8; 3]>>,
    /// Their names, with the share of vertices that a scan showed.
    seen: Vec<(String, f64)>,
    /// Their meshes on the T-posed body.
    rest: Vec<TriMesh>,
    picture: PathBuf,
}

/// Takes the colours of all scans that may be learnt from; `None` where they have none.
fn paint(context: &Context<'_>, subject: &Subject, avatar: &Nets, scans: &Scans) -> Result<Option<Painted>> {
    if subject.scans.is_empty() {
        return Ok(None);
    }
    let scene = Scene::new(context, subject)?;
    let poses: Vec<_> = subject.scans.iter().map(|s| s.pose.clone()).collect();
    let track = scene.track(&poses)?;
    let mut worn = Vec::new();
    for (fitted, trained) in subject.garments.iter().zip(&avatar.garments) {
        worn.push(play(fitted, trained, &context.config.net, &track, Play::Poses)?);
    }
    let mut rest = vec![scene.rest.clone()];
    rest.extend(subject.garments.iter().map(|g| g.mesh.clone()));
    let labels = std::iter::once(Label::Body).chain(subject.garments.iter().map(|g| label_of(g.kind)));
    let labels: Vec<Label> = labels.collect();
    let mut parts: Vec<PartColours> = rest.iter().map(|mesh| PartColours::new(mesh.vertices.len())).collect();
    // The avatar in the pose of a scan.
    let posed = |i: usize| -> Result<Vec<Vec<Vec3>>> {
        let body = scene.body.forward(&scene.subject.posed(&poses[i]))?.vertices;
        Ok(std::iter::once(body).chain(worn.iter().map(|frames| frames[i].clone())).collect())
    };
    let mut shown: Option<(usize, Scan)> = None;
    for (i, scan) in subject.scans.iter().enumerate() {
        context.progress.set(0.3 * i as f64 / subject.scans.len() as f64, "colours");
        let Some(file) = scans.list.iter().find(|file| file.name == scan.name) else { continue };
        let surface = read_framed(context.files, file, &scan.frame)?;
        let Some(colours) = &surface.colours else { continue };
        if !scan.held_out {
            for ((part, label), (vertices, mesh)) in parts.iter_mut().zip(&labels).zip(posed(i)?.iter().zip(&rest)) {
                let own: Vec<usize> =
                    (0..colours.len()).filter(|&v| scan.points.labels.get(v) == Some(label)).collect();
                let points = ColouredPoints::new(
                    own.iter().map(|&v| scan.points.points[v]).collect(),
                    own.iter().map(|&v| scan.points.normals[v]).collect(),
                    own.iter().map(|&v| colours[v]).collect(),
                );
                part.see(vertices, &mesh.faces, &points);
            }
        }
        // A scan that no colour came from, if there is one.
        if shown.is_none() || scan.held_out && shown.as_ref().is_some_and(|(k, _)| !subject.scans[*k].held_out) {
            shown = Some((i, surface));
        }
    }
    let colours: Option<Vec<_>> = parts.iter().zip(&rest).map(|(part, mesh)| part.finish(&mesh.faces)).collect();
    let (Some(colours), Some((i, surface))) = (colours, shown) else { return Ok(None) };
    let name = |k: usize| if k == 0 { "body".to_string() } else { subject.garments[k - 1].kind.to_string() };
    let seen = parts.iter().enumerate().map(|(k, part)| (name(k), part.seen())).collect();
    let mut cells = Vec::new();
    let meshes: Vec<TriMesh> = posed(i)?
        .into_iter()
        .zip(&rest)
        .map(|(vertices, mesh)| TriMesh { vertices, faces: mesh.faces.clone() })
        .collect();
    let bounds = pictures::padded(surface.mesh.bounds().unwrap_or((Vec3::zeros(), Vec3::repeat(1.0))));
    for from in [pictures::FRONT, pictures::BACK] {
        let layer = match &surface.colours {
            Some(colours) => Layer::per_vertex(&surface.mesh, colours),
            None => Layer::uniform(&surface.mesh, CLAY),
        };
        cells.push((surface.name.clone(), pictures::draw(vec![layer], bounds, &from)));
        let dressed = Dressed { body: &meshes[0], garments: meshes[1..].to_vec() };
        cells.push(("avatar".into(), pictures::dressed(&dressed, &from)));
        let layers = meshes.iter().zip(&colours).map(|(mesh, colours)| Layer::per_vertex(mesh, colours)).collect();
        cells.push(("in the scans' colours".into(), pictures::draw(layers, bounds, &from)));
    }
    let picture = PathBuf::from("pictures/colours.png");
    context.write("pictures/colours.png", &pictures::sheet(&cells, 6)?)?;
    Ok(Some(Painted { colours, seen, rest, picture }))
}

fn put(context: &Context<'_>, files: &mut Vec<PathBuf>, name: String, bytes: &[u8]) -> Result<()> {
    context.write(&name, bytes)?;
    files.push(name.into());
    Ok(())
}

/// The played clip.
fn moving_files(
    context: &Context<'_>,
    subject: &Subject,
    film: &Film,
    colours: &[Vec<[u8; 3]>],
    files: &mut Vec<PathBuf>,
) -> Result<()> {
    let scene = Scene::new(context, subject)?;
    let figure = Played { scene: &scene, garments: &subject.garments, film, colours };
    let frames = film.clip.poses.len();
    let every = context.config.animate.as_ref().map_or(1, |a| a.obj_every);
    for frame in (0..frames).step_by(every) {
        context.progress.set(frame as f64 / frames as f64, "OBJ");
        let body = TriMesh { vertices: figure.body_frame(frame)?, faces: scene.rest.faces.clone() };
        put(context, files, format!("export/obj/body_{frame:05}.obj"), &write_obj(&body, figure.colours(0))?)?;
        for (g, (garment, played)) in subject.garments.iter().zip(&film.garments).enumerate() {
            let mesh = TriMesh { vertices: played.vertices(frame), faces: garment.mesh.faces.clone() };
            put(
                context,
                files,
                format!("export/obj/{}_{frame:05}.obj", garment.kind),
                &write_obj(&mesh, figure.colours(g + 1))?,
            )?;
        }
    }
    for path in moving::write(&figure, MovingFormat::Glb, &context.folder.join("export"))? {
        let relative = path.strip_prefix(context.folder).unwrap_or(&path);
        files.push(relative.into());
    }
    Ok(())
}
