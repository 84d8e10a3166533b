//! What a reader of the report must know: warnings of this run, and limits that apply to it.

use super::Inputs;
use crate::config::{Config, SubjectConfig};
use crate::garment::FittedGarment;
use crate::plot::number;
use caphy_garment::solver::Outcome;

/// A held-out pose whose joints are farther than this from every scan that was learnt from, root mean square [°].
const FAR_DEG: f64 = 20.0;
/// Fewer scans to learn from than this are few; the paper has 50 to 120.
const FEW_SCANS: usize = 20;
/// More vertices than this inside the body are many.
const MANY_INSIDE: f64 = 0.02;

/// What went not as one would wish, in this run.
pub(super) fn warnings(inputs: &Inputs<'_>) -> Vec<String> {
    let mut out = Vec::new();
    for scan in &inputs.subject.skipped {
        out.push(format!("Scan {} was left out: {}", scan.name, scan.problem));
    }
    for garment in inputs.scans.truth.iter().flat_map(|t| &t.garments) {
        let left = garment.solved.iter().filter(|r| r.outcome != Outcome::Converged).count();
        if left > 0 {
            let all = garment.solved.len();
            out.push(format!("The true {} garment did not come to rest in {left} of {all} scans.", garment.kind));
        }
    }
    if !inputs.subject.scans.is_empty() && !inputs.subject.scans.iter().any(|s| s.held_out) {
        out.push("No scan was held out: distances tell how well the avatar remembers its scans, not what it does in other poses.".into());
    }
    for scan in inputs.scores.iter().flat_map(|s| &s.scans).filter(|s| s.held_out) {
        for g in &scan.garments {
            let (net, skinned) = (g.net.mean_mm(), g.skinned.mean_mm());
            if net >= skinned {
                out.push(format!(
                    "On held-out scan {} the {} garment is no nearer to the scan ({} mm) than plain skinning ({} mm).",
                    scan.name,
                    g.kind,
                    number(net),
                    number(skinned)
                ));
            }
            if let Some(angle) = g.nearest_scan_deg.filter(|a| *a > FAR_DEG) {
                out.push(format!(
                    "Held-out scan {}: joints that move the {} garment are {angle:.0}° from every scan that was learnt from.",
                    scan.name, g.kind
                ));
            }
            if g.penetrating > MANY_INSIDE {
                let share = 100.0 * g.penetrating;
                out.push(format!(
                    "Held-out scan {}: {share:.1} % of the {} garment lie inside the body.",
                    scan.name, g.kind
                ));
            }
            if g.net.self_crossings > 0 {
                let (pairs, skinned) = (g.net.self_crossings, g.skinned.self_crossings);
                out.push(format!(
                    "Held-out scan {}: {pairs} pairs of triangles of the {} garment pass through each other (skinned: {skinned}).",
                    scan.name, g.kind
                ));
            }
        }
    }
    for garment in inputs.film.iter().flat_map(|f| &f.garments).filter(|g| g.penetrating > MANY_INSIDE) {
        let share = 100.0 * garment.penetrating;
        out.push(format!(
            "In the played clip {share:.1} % of the {} garment lay inside the body before they were pushed out.",
            garment.kind
        ));
    }
    for (part, share) in inputs.exported.coloured.iter().filter(|(part, share)| part != "body" && *share < 0.5) {
        out.push(format!(
            "Scans show the colour of {:.0} % of the {part} garment only; the rest took its neighbours'.",
            100.0 * share
        ));
    }
    out
}

/// What this run cannot tell, as it was set up.
pub(super) fn limits(config: &Config, inputs: &Inputs<'_>) -> Vec<String> {
    let mut out: Vec<String> = Vec::new();
    match &config.subject {
        SubjectConfig::Synthetic(_) => out.push(
            "The subject is generated: its cloth obeys the equations that nets learn by. What is near here says little of captured people.".into(),
        ),
        SubjectConfig::Scans(_) => out.push("The truth under the clothes is not known: distances are to scans, with their noise and holes.".into()),
        SubjectConfig::Dressed(_) => out.push("There are no scans: nothing ties shapes or fabric to a real garment.".into()),
    }
    let learnt = inputs.subject.training_scans().count();
    if (1..FEW_SCANS).contains(&learnt) {
        out.push(format!("{learnt} scans to learn from; the paper has 50 to 120."));
    }
    let finest = |g: &FittedGarment| 3.0 * g.mesh.mean_edge_length();
    for garment in &inputs.subject.garments {
        out.push(format!(
            "The {} template has edges of {:.0} mm: folds shorter than about {:.0} mm cannot be.",
            garment.kind,
            1e3 * garment.mesh.mean_edge_length(),
            1e3 * finest(garment)
        ));
    }
    let source = |key: &str| {
        let garment = if key == "upper" { &config.upper } else { &config.lower };
        garment.as_ref().and_then(|g| g.template.table().get("type")).and_then(|t| t.as_str()) == Some("parametric")
    };
    if source("upper") || source("lower") {
        out.push(
            "Templates come from a small space of shirts and trousers: no skirts, dresses, collars or pockets.".into(),
        );
    }
    out.push("In training and playing, cloth does not touch itself and slides on the body without friction; hands and hips do not push it.".into());
    if config.body.table().get("type").and_then(|t| t.as_str()) == Some("mannequin") {
        out.push("The body is a mannequin, not a model learnt from people.".into());
    }
    if inputs.scores.is_some_and(|scores| scores.perceptual()) {
        out.push("The paper does not say which layers of VGG-16 its perceptual distance compares, nor how it renders: compare within this report.".into());
    } else if inputs.scores.is_some() {
        out.push("Perceptual distance is not VGG-16's: normal maps and MS-SSIM stand in for it, and cannot be compared with the paper's in size.".into());
    }
    if !inputs.exported.coloured.is_empty() {
        out.push("Colours hold the light of the scans, one per vertex.".into());
    }
    out
}
