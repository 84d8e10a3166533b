//! A synthetic subject: a body with a known shape in known poses, garments of a known style and fabric brought to rest on it,
//! and scans of what can be seen from outside. The rest of the pipeline reads these scans like any other.

use super::{Context, ScanFile, Scans, split};
use crate::artifact;
use crate::config::SyntheticConfig;
use crate::motion;
use crate::pictures;
use crate::scene::Scene;
use crate::synth::{Person, Scanned, TrueGarment, Truth, Worn, scan, wear};
use caphy_bodymodel::procedural_motion::static_poses;
use caphy_core::pose::Pose;
use caphy_core::scan::Scan;
use caphy_core::{Error, Result, Vec3};
use caphy_garment::solver::Outcome;
use caphy_garment::template::GarmentKind;
use caphy_render::Layer;
use caphy_render::shade::CLAY;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use rayon::prelude::*;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Folder of what is true, beside the scans: no stage reads it.
pub const TRUTH: &str = "truth";

/// Makes the subject; writes its scans under `scans/`, what is true of them under `truth/`.
pub fn run(context: &Context<'_>, config: &SyntheticConfig) -> Result<Scans> {
    let seed = context.config.run.seed;
    // Before anything is simulated: a name may be wrong.
    let roles = roles(config, seed)?;
    let body: Arc<dyn caphy_core::body::BodyModel> = Arc::from(context.config.body.body(context.files)?);
    context.progress.set(0.0, "garments are cut");
    let person = Person::new(config, body, seed)?;
    let scene =
        Scene::dressed(person.body.clone(), &person.subject.shape, &person.subject.displacement, &person.garments)?;
    let poses = poses(context, config, &scene.rest_joints[0])?;
    let finished = AtomicUsize::new(0);
    // One error for one input, whatever the number of threads.
    let captured: Vec<Result<((Worn, Scanned), String)>> = poses
        .par_iter()
        .enumerate()
        .map(|(i, pose)| {
            let name = name(i);
            let worn = at_rest(context, config, &person, &scene, pose, &name)?;
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            rng.set_stream(1000 + i as u64);
            let scanned = scan(&config.rig, &person, pose, &worn, &name, &mut rng)?;
            let file = caphy_formats::ply::write_ply(&scanned.scan);
            context.write(&format!("scans/{name}.ply"), &file)?;
            let labelled = Scan { labels: Some(scanned.labels.clone()), ..scanned.scan.clone() };
            context.write(&format!("{TRUTH}/{name}.ply"), &caphy_formats::ply::write_ply(&labelled))?;
            let count = finished.fetch_add(1, Ordering::Relaxed) + 1;
            context.progress.set(count as f64 / poses.len() as f64, &format!("{count} of {} scans", poses.len()));
            Ok(((worn, scanned), artifact::hash(&file)))
        })
        .collect();
    let (captured, contents): (Vec<_>, Vec<_>) = captured.into_iter().collect::<Result<Vec<_>>>()?.into_iter().unzip();
    context.write(&format!("{TRUTH}/scans.png"), &picture(&captured)?)?;
    let truth = truth(config, &person, &poses, &captured);
    report(context, &truth);
    let json = serde_json::to_vec(&truth)
        .map_err(|e| Error::config("truth.json", e.to_string(), "report this as a defect"))?;
    context.write(&format!("{TRUTH}/truth.json"), &json)?;
    let list = roles
        .into_iter()
        .zip(contents)
        .map(|((name, held_out), content)| ScanFile {
            path: format!("scans/{name}.ply").into(),
            name,
            held_out,
            content: Some(content),
        })
        .collect();
    Ok(Scans { list, truth: Some(truth) })
}

/// Names of the scans, and whether each is held out.
///
/// # Errors
/// As [`split::held_out`].
pub(crate) fn roles(config: &SyntheticConfig, seed: u64) -> Result<Vec<(String, bool)>> {
    let names: Vec<String> = (0..config.scans).map(name).collect();
    let held = split::held_out(&names, &config.held_out, seed)?;
    Ok(names.into_iter().zip(held).collect())
}

fn name(scan: usize) -> String {
    format!("scan-{scan:02}")
}

/// Every scan from in front and from behind.
fn picture(captured: &[(Worn, Scanned)]) -> Result<Vec<u8>> {
    let mut cells = Vec::new();
    for (_, Scanned { scan, .. }) in captured {
        let bounds = pictures::padded(scan.mesh.bounds().unwrap_or((Vec3::zeros(), Vec3::repeat(1.0))));
        for from in [pictures::FRONT, pictures::BACK] {
            let layer = match &scan.colours {
                Some(colours) => Layer::per_vertex(&scan.mesh, colours),
                None => Layer::uniform(&scan.mesh, CLAY),
            };
            cells.push((scan.name.clone(), pictures::draw(vec![layer], bounds, &from)));
        }
    }
    pictures::sheet(&cells, 6)
}

/// The configured poses.
fn poses(context: &Context<'_>, config: &SyntheticConfig, pelvis: &Vec3) -> Result<Vec<Pose>> {
    let Some(clip) = &config.clip else { return Ok(static_poses(context.config.run.seed, config.scans)) };
    let poses = motion::load(context.files, clip, None, context.config.motion.fps, pelvis)?.clip.poses;
    if poses.len() < config.scans {
        let problem = format!("has {} frames for {} scans", poses.len(), config.scans);
        return Err(Error::config("subject.clip", problem, "give a longer clip, or ask for fewer scans"));
    }
    let last = (config.scans - 1).max(1);
    Ok((0..config.scans).map(|i| poses[i * (poses.len() - 1) / last].clone()).collect())
}

/// Clothes at rest in one pose, as a killed run left them where it did.
fn at_rest(
    context: &Context<'_>,
    config: &SyntheticConfig,
    person: &Person,
    scene: &Scene,
    pose: &Pose,
    name: &str,
) -> Result<Worn> {
    let path = context.folder.join(format!("checkpoint-synth-{name}.caphy"));
    if let Some((worn, _)) = artifact::load(&path, context.stage, context.key)? {
        return Ok(worn);
    }
    let worn = wear(config, person, scene, pose)?;
    artifact::save(&path, context.stage, context.key, &worn)?;
    Ok(worn)
}

fn truth(config: &SyntheticConfig, person: &Person, poses: &[Pose], captured: &[(Worn, Scanned)]) -> Truth {
    let garments = person
        .templates
        .iter()
        .zip(&person.materials)
        .enumerate()
        .map(|(k, (template, material))| TrueGarment {
            kind: template.kind,
            style: template.style.clone(),
            template: template.mesh.clone(),
            measures: template.measures(),
            rest_scale: [config.rest.girth, config.rest.length],
            parameters: material.parameters().iter().map(|p| p.value).collect(),
            at_rest: captured.iter().map(|(worn, _)| worn.shapes[k].clone()).collect(),
            solved: captured.iter().map(|(worn, _)| worn.reports[k].clone()).collect(),
        })
        .collect();
    Truth {
        shape: person.subject.shape.clone(),
        displacement: person.subject.displacement.clone(),
        poses: poses.to_vec(),
        joints: captured.iter().map(|(_, scanned)| scanned.joints.clone()).collect(),
        labels: captured.iter().map(|(_, scanned)| scanned.labels.clone()).collect(),
        garments,
    }
}

/// Says how exactly garments hang, and names the poses in which they do not.
fn report(context: &Context<'_>, truth: &Truth) {
    for garment in &truth.garments {
        let worst = garment.solved.iter().map(|r| r.residual_n).fold(0.0, f64::max);
        let steps: usize = garment.solved.iter().map(|r| r.iterations).sum();
        let kind: GarmentKind = garment.kind;
        let count = garment.template.vertices.len();
        context.progress.note(&format!("{kind}: {count} vertices, {steps} steps, largest force left {worst:.1e} N"));
        for (i, r) in garment.solved.iter().enumerate().filter(|(_, r)| r.outcome != Outcome::Converged) {
            context.progress.note(&format!(
                "{kind} in {}: {:?} with {:.1e} N left on vertex {}",
                name(i),
                r.outcome,
                r.residual_n,
                r.residual_vertex
            ));
        }
    }
}
