//! A synthetic subject: a body with a known shape in known poses, garments of a known style and fabric brought to rest on it,
//! and scans of what can be seen from outside. The rest of the pipeline reads these scans like any other.

use super::{Context, ScanFile, Scans};
use crate::config::SyntheticConfig;
use crate::garment::FittedGarment;
use crate::physics::{Dynamics, Physics};
use crate::scene::label_of;
use crate::simulate::joined;
use crate::track::{BodyTrack, Reach};
use caphy_bodymodel::procedural_motion::static_poses;
use caphy_core::lanes::Frames;
use caphy_core::material::MaterialModel;
use caphy_core::pose::Pose;
use caphy_core::scan::{Label, Scan};
use caphy_core::segmenter::NO_TRIANGLE;
use caphy_core::{Real, Result, TriMesh, Vec3, mesh};
use caphy_garment::contact::ContactMap;
use caphy_garment::energy::{BodyState, ContactOptions, State, frame_normals};
use caphy_garment::relax::{RelaxReport, RelaxSettings, relax};
use caphy_garment::skinning::{Skinner, WeightOptions};
use caphy_garment::template::{BodyRest, GarmentKind, Style, Tailor, Template};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// What is known about a synthetic subject.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Truth {
    /// Shape β.
    pub shape: Vec<f64>,
    /// Pose of each scan.
    pub poses: Vec<Pose>,
    /// Joints of each scan [m].
    pub joints: Vec<Vec<Vec3>>,
    /// Garments, upper first.
    pub garments: Vec<TrueGarment>,
}

/// What is known about a garment.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct TrueGarment {
    /// Upper or lower.
    pub kind: GarmentKind,
    /// Its style.
    pub style: Style,
    /// Native parameters of its fabric.
    pub parameters: Vec<f64>,
    /// Rest area [m²].
    pub area_m2: f64,
    /// How still it hangs.
    pub relaxation: RelaxReport,
}

/// Views that decide what a capture rig sees, and their size [pixels].
const VIEWS: (usize, usize) = (32, 512);
/// Contact for the relaxation: the same as training's default, on a finer mesh.
const CONTACT: ContactOptions = ContactOptions { margin: 4e-3, allowed_depth: 1e-3, load: 50.0 };
/// Evaluations between two searches for contact pairs: cloth moves by a few millimetres at most in between.
const CONTACT_REFRESH: usize = 4;

/// Makes the subject and writes its scans under `scans/`.
pub fn run(context: &Context<'_>, config: &SyntheticConfig) -> Result<Scans> {
    let seed = context.config.run.seed;
    let mut rng = ChaCha8Rng::seed_from_u64(seed.wrapping_mul(7919).wrapping_add(17));
    let body = context.config.body.body(context.files)?;
    let shape: Vec<f64> = (0..body.describe().shape_count.min(4)).map(|_| uniform(&mut rng, -0.8, 0.8)).collect();
    let subject = body.rest(&shape);
    let poses = static_poses(seed, config.scans);
    let rest = BodyRest::from_model(&*body, &subject)?;
    let rest_mesh = rest.mesh.clone();
    let tailor = Tailor::new(rest)?;

    let mut between = |ranges: &[(f64, f64)]| ranges.iter().map(|&(a, b)| uniform(&mut rng, a, b)).collect::<Vec<_>>();
    let styles = [
        Style::from_unit(GarmentKind::Upper, &between(&[(0.3, 0.6), (0.35, 0.55), (0.3, 0.5), (0.2, 0.5)]))?,
        Style::from_unit(GarmentKind::Lower, &between(&[(0.75, 0.95), (0.3, 0.5), (0.4, 0.7)]))?,
    ];
    let tables =
        [(&config.upper_material, "subject.upper_material"), (&config.lower_material, "subject.lower_material")];
    let templates: Vec<Template> = tailor.generate_all(&styles, config.resolution_m)?;
    let reach = {
        let vertices: Vec<&[Vec3]> = templates.iter().map(|t| &t.mesh.vertices[..]).collect();
        Reach::new(&rest_mesh, &vertices, 0.15)?
    };
    let track = BodyTrack::new(&*body, &subject, &reach, &poses)?;

    // Trousers first: the shirt hangs over them.
    let mut at_rest: Vec<(usize, Vec<Vec<Vec3>>, RelaxReport, Arc<dyn MaterialModel>)> = Vec::new();
    for index in [1, 0] {
        let template = &templates[index];
        let (table, key) = tables[index];
        let material: Arc<dyn MaterialModel> = Arc::from(table.material(key)?);
        let weights = &body.describe().weights;
        let worn = FittedGarment::new(template.clone(), &rest_mesh.vertices, weights, &WeightOptions::default())?;
        let under = at_rest.first().map(|(under, shapes, ..)| (&templates[*under].mesh.faces[..], &shapes[..]));
        let say = |s: f64| {
            context.progress.set(0.4 * at_rest.len() as f64 + 0.4 * s, &format!("{} comes to rest", template.kind))
        };
        let contact = reach.contact(&rest_mesh, &worn)?;
        let (shapes, report) = drape(&worn, material.clone(), &track, contact, under, &say)?;
        let still = report.at_rest.iter().filter(|&&r| r).count();
        context.progress.note(&format!(
            "{}: {} vertices, {still} of {} poses at rest after {} iterations",
            template.kind,
            template.mesh.vertices.len(),
            report.at_rest.len(),
            report.iterations
        ));
        at_rest.push((index, shapes, report, material));
    }
    at_rest.sort_by_key(|a| a.0);

    let mut list = Vec::new();
    let mut true_joints = Vec::new();
    let faces = &body.describe().faces;
    for (i, pose) in poses.iter().enumerate() {
        context.progress.set(0.8 + 0.2 * i as f64 / poses.len() as f64, "scanning");
        let posed = body.forward(&subject.posed(pose))?;
        true_joints.push(posed.joints);
        let skin = TriMesh { vertices: posed.vertices, faces: faces.clone() };
        let mut parts = vec![(skin, Label::Body)];
        for (index, shapes, ..) in &at_rest {
            let worn = TriMesh { vertices: shapes[i].clone(), faces: templates[*index].mesh.faces.clone() };
            parts.push((worn.subdivided(), label_of(templates[*index].kind)));
        }
        let name = format!("scan-{i:02}");
        let mut noise = ChaCha8Rng::seed_from_u64(seed);
        noise.set_stream(1000 + i as u64);
        let scan = scan(&name, parts, config.noise_m, &mut noise);
        let file = format!("scans/{name}.ply");
        context.write(&file, &caphy_formats::ply::write_ply(&scan))?;
        let held_out = i + config.held_out >= poses.len();
        list.push(ScanFile { name, path: file.into(), held_out });
    }
    let garments = at_rest
        .into_iter()
        .map(|(index, _, relaxation, material)| TrueGarment {
            kind: templates[index].kind,
            style: templates[index].style.clone(),
            parameters: material.parameters().iter().map(|p| p.value).collect(),
            area_m2: templates[index].area(),
            relaxation,
        })
        .collect();
    Ok(Scans { list, truth: Some(Truth { shape, poses, joints: true_joints, garments }) })
}

/// Brings a garment to rest on the body in every frame of a track, over another garment where there is one.
///
/// Returns its vertices per frame and how still they are.
pub fn drape(
    garment: &FittedGarment,
    material: Arc<dyn MaterialModel>,
    track: &BodyTrack,
    mut contact: ContactMap,
    under: Option<(&[[u32; 3]], &[Vec<Vec3>])>,
    progress: &dyn Fn(f64),
) -> Result<(Vec<Vec<Vec3>>, RelaxReport)> {
    let frames = track.len();
    let blocks = frames.div_ceil(<f64 as Real>::LANES);
    let lanes = frames.div_ceil(blocks.max(1));
    // The last frame fills up the last block.
    let ids: Vec<usize> = (0..blocks * lanes).map(|i| i.min(frames.saturating_sub(1))).collect();
    let rest = garment.rest(&*material)?;
    // Inertia never counts here: its rate only has to be valid.
    let physics = Physics::<f64>::new(&rest, material, &CONTACT, 30.0, &Default::default())?;
    let skinner = Skinner::<f64>::new(&garment.mesh.vertices, &garment.weights)?;
    let transforms = track.transforms(&ids);
    let mut x = Frames::zeros(blocks, skinner.vertex_count(), lanes);
    skinner.forward(&skinner.joint_frames(&transforms, lanes)?, None, &mut x)?;
    let holder = skinner.select(physics.attachment.vertices())?;
    let mut targets = Frames::zeros(blocks, holder.vertex_count(), lanes);
    holder.forward(&holder.joint_frames(&transforms, lanes)?, None, &mut targets)?;
    let (mut body, mut normals) = track.gather::<f64>(&ids, lanes)?;
    if let Some((faces, shapes)) = under {
        let mut other = Frames::zeros(blocks, shapes.first().map_or(0, Vec::len), lanes);
        for (slot, &id) in ids.iter().enumerate() {
            other.set_frame(slot / lanes, slot % lanes, &shapes[id])?;
        }
        let other_normals = frame_normals(&other, faces)?;
        contact = contact.with_obstacle(other.vertices());
        body = joined(&body, &other);
        normals = joined(&normals, &other_normals);
    }
    let mut nearest = Vec::new();
    let mut evaluations = 0;
    let gradient = |x: &Frames<f64>, g: &mut Frames<f64>| -> Result<()> {
        if evaluations % CONTACT_REFRESH == 0 {
            nearest = contact.nearest(x, &body)?;
        }
        evaluations += 1;
        g.clear();
        let state = State::new(x)
            .with_body(BodyState { positions: &body, normals: &normals, nearest: Some(&nearest) })
            .with_targets(&targets);
        physics.add(&state, Dynamics::Static, 1.0, Some(g))?;
        Ok(())
    };
    let mut report = relax(&mut x, &RelaxSettings::default(), gradient, progress)?;
    report.residual_n.truncate(frames);
    report.at_rest.truncate(frames);
    let shapes = (0..frames).map(|i| x.frame(i / lanes, i % lanes)).collect();
    Ok((shapes, report))
}

/// What cameras all around see of the parts: one mesh with noise, colours and labels.
fn scan(name: &str, parts: Vec<(TriMesh, Label)>, noise_m: f64, rng: &mut ChaCha8Rng) -> Scan {
    let mut all = TriMesh::default();
    let mut labels = Vec::new();
    for (part, label) in parts {
        let offset = all.vertices.len() as u32;
        all.faces.extend(part.faces.iter().map(|f| f.map(|id| id + offset)));
        labels.extend(std::iter::repeat_n(label, part.vertices.len()));
        all.vertices.extend(part.vertices);
    }
    let bounds = mesh::bounds(&all.vertices).unwrap_or((Vec3::zeros(), Vec3::repeat(1.0)));
    let cameras = caphy_render::uniform_views(bounds, VIEWS.0, VIEWS.1);
    let views: Vec<Vec<u32>> =
        cameras.par_iter().map(|camera| caphy_render::render(&all, None, camera).triangle).collect();
    let mut seen = vec![false; all.vertices.len()];
    for id in views.into_iter().flatten().filter(|&id| id != NO_TRIANGLE) {
        for v in all.faces[id as usize] {
            seen[v as usize] = true;
        }
    }
    let (mut mesh, old) = all.submesh(&seen);
    for v in &mut mesh.vertices {
        *v += Vec3::from_fn(|_, _| noise_m * normal(rng));
    }
    let labels: Vec<Label> = old.iter().map(|&id| labels[id as usize]).collect();
    let colours = labels
        .iter()
        .map(|label| {
            let base: [u8; 3] = match label {
                Label::Upper => [46, 84, 140],
                Label::Lower => [70, 66, 62],
                _ => [205, 160, 134],
            };
            // A little mottling, as dyed cloth and skin have.
            let shade = 1.0 + 0.06 * normal(rng);
            base.map(|c| (f64::from(c) * shade).clamp(0.0, 255.0) as u8)
        })
        .collect();
    Scan { name: name.into(), mesh, colours: Some(colours), labels: Some(labels) }
}

/// A number in [a, b).
fn uniform(rng: &mut ChaCha8Rng, a: f64, b: f64) -> f64 {
    a + (b - a) * (rng.next_u64() >> 11) as f64 / (1u64 << 53) as f64
}

/// A standard normal number (Box-Muller).
fn normal(rng: &mut ChaCha8Rng) -> f64 {
    let (u, v) = (uniform(rng, f64::MIN_POSITIVE, 1.0), uniform(rng, 0.0, std::f64::consts::TAU));
    (-2.0 * u.ln()).sqrt() * v.cos()
}
