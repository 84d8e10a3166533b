//! Trained nets against the reference solver on the same garments and motion: excess energy, wrinkles, swing, penetration.

use super::preprocess::Subject;
use super::reference::{Reference, fabric};
use super::train::Nets;
use super::{Context, StageOutput};
use crate::garment::FittedGarment;
use crate::inference::{Play, play};
use crate::judge::Judge;
use crate::pictures;
use crate::plot::{Axes, Curve, lines};
use crate::quality::{Spectrum, SpectrumFilter, WAVELENGTHS, mass_height, penetration, swing};
use crate::scene::Scene;
use crate::track::BodyTrack;
use caphy_core::pose::Pose;
use caphy_core::{Result, TriMesh, Vec3};
use caphy_garment::template::GarmentKind;
use serde::{Deserialize, Serialize};
use std::fmt::Write;
use std::path::PathBuf;

/// All comparisons.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Comparison {
    /// One per garment of the subject, in its order.
    pub garments: Vec<GarmentComparison>,
    /// Frames per second.
    pub fps: f64,
    /// Pictures, relative to the run directory.
    pub pictures: Vec<PathBuf>,
}

impl StageOutput for Comparison {
    fn files(&self) -> Vec<PathBuf> {
        self.pictures.clone()
    }
}

/// The three ways in which a garment is put on.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub struct Three<T> {
    /// By skinning alone.
    pub skinned: T,
    /// By the net.
    pub net: T,
    /// By the reference solver.
    pub solver: T,
}

/// The solver's place among the three.
const SOLVER: usize = 2;

impl<T> Three<T> {
    fn of(mut make: impl FnMut(usize) -> Result<T>) -> Result<Self> {
        Ok(Self { skinned: make(0)?, net: make(1)?, solver: make(2)? })
    }
    fn each(&self) -> [&T; 3] {
        [&self.skinned, &self.net, &self.solver]
    }
}

/// One garment.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct GarmentComparison {
    /// Upper or lower.
    pub kind: GarmentKind,
    /// Mean energies per term in single poses [J].
    pub at_rest: Three<Vec<(String, f64)>>,
    /// Mean energies per term in motion [J].
    pub moving: Three<Vec<(String, f64)>>,
    /// Energy of normals by wavelength in motion.
    pub spectrum: Three<Spectrum>,
    /// Swing of the hem, see [`swing`] [m].
    pub swing_m: Three<f64>,
    /// Mean and largest difference of the centre of mass's height from the solver's, in motion [m].
    pub height_m: [f64; 2],
    /// Share of vertices inside the body in motion, before anything is pushed out.
    pub penetrating: Three<f64>,
    /// The deepest of them [m].
    pub deepest_m: Three<f64>,
    /// Height of the hem's centre above the root by frame [m].
    pub hem_m: Three<Vec<f64>>,
    /// Frames in which the solver did not converge, in motion and at rest, of how many.
    pub unconverged: [[usize; 2]; 2],
}

fn total(energies: &[(String, f64)]) -> f64 {
    energies.iter().map(|e| e.1).sum()
}
fn elastic(energies: &[(String, f64)]) -> f64 {
    energies.iter().filter(|e| e.0 == "strain" || e.0 == "bending").map(|e| e.1).sum()
}

impl GarmentComparison {
    /// Energy over the solver's in single poses, as a share of the skinned template's.
    pub fn excess(&self) -> f64 {
        let solver = total(&self.at_rest.solver);
        (total(&self.at_rest.net) - solver) / (total(&self.at_rest.skinned) - solver)
    }
    /// Strain plus bending energy over the solver's, in single poses and in motion.
    pub fn elastic_ratios(&self) -> [f64; 2] {
        [&self.at_rest, &self.moving].map(|e| elastic(&e.net) / elastic(&e.solver))
    }
    /// Swing of the hem over the solver's.
    pub fn swing_ratio(&self) -> f64 {
        self.swing_m.net / self.swing_m.solver
    }
}

impl Comparison {
    /// What was measured, as text.
    pub fn table(&self) -> String {
        let mut out = String::from("Nets against the reference solver (each garment alone on the body):\n");
        for g in &self.garments {
            let [rest, moving] = g.elastic_ratios();
            let _ = writeln!(out, "{}: excess energy {:.1} % of the skinned template's", g.kind, 100.0 * g.excess());
            let _ =
                writeln!(out, "  strain+bending over the solver's: {rest:.2} in single poses, {moving:.2} in motion");
            let _ = writeln!(
                out,
                "  hem swing {:.1} mm, the solver's {:.1} mm ({:.2})",
                1e3 * g.swing_m.net,
                1e3 * g.swing_m.solver,
                g.swing_ratio()
            );
            let [mean, most] = g.height_m;
            let _ = writeln!(
                out,
                "  centre of mass {:.1} mm off in height (mean), {:.1} mm at most",
                1e3 * mean,
                1e3 * most
            );
            let _ = writeln!(
                out,
                "  inside the body {:.2} % of vertices, {:.1} mm at most (solver {:.2} %, {:.1} mm; skinned {:.2} %, {:.1} mm)",
                100.0 * g.penetrating.net,
                1e3 * g.deepest_m.net,
                100.0 * g.penetrating.solver,
                1e3 * g.deepest_m.solver,
                100.0 * g.penetrating.skinned,
                1e3 * g.deepest_m.skinned,
            );
            for (name, energies) in [("single poses", &g.at_rest), ("in motion", &g.moving)] {
                for (way, list) in ["skinned", "net", "solver"].iter().zip(energies.each()) {
                    let terms: Vec<String> = list.iter().map(|(n, e)| format!("{n} {:.2}", 1e3 * e)).collect();
                    let _ = writeln!(out, "  mJ, {name:12} {way:8} {}", terms.join(", "));
                }
            }
            let bands = ["below 8 cm", "8-16 cm", "16-32 cm"];
            for (i, band) in bands.iter().enumerate().take(WAVELENGTHS.len()) {
                let [skinned, net, solver] = g.spectrum.each().map(|s| s.0[i]);
                let _ = writeln!(out, "  normals {band:10} skinned {skinned:.4}, net {net:.4}, solver {solver:.4}");
            }
            let [[m, n], [r, s]] = g.unconverged;
            if m + r > 0 {
                let _ = writeln!(out, "  the solver did not converge in {m} of {n} frames in motion, {r} of {s} poses");
            }
        }
        out
    }
    /// Hem height by time, as SVG.
    pub fn plots(&self) -> String {
        let mut out = String::new();
        for g in &self.garments {
            let curves: Vec<Curve> = ["skinned", "net", "solver"]
                .iter()
                .zip(g.hem_m.each())
                .map(|(name, heights)| Curve {
                    name: name.to_string(),
                    points: heights.iter().enumerate().map(|(i, h)| (i as f64 / self.fps, 1e3 * h)).collect(),
                })
                .collect();
            let title = format!("{}: height of the hem above the pelvis", g.kind);
            out.push_str(&lines(&Axes { title: &title, x: "s", y: "mm", log_y: false }, &curves));
        }
        out
    }
}

/// Mean energies of shapes over all frames, per way; the solver's as it has them itself.
fn mean_energies(
    judge: &Judge<'_>,
    track: &BodyTrack,
    ways: &[&[Vec<Vec3>]; 3],
    solver: &[(String, f64)],
) -> Result<Three<Vec<(String, f64)>>> {
    Three::of(|way| if way == SOLVER { Ok(solver.to_vec()) } else { judge.mean_energies(track, ways[way]) })
}

/// Measures every garment.
pub fn run(context: &Context<'_>, subject: &Subject, nets: &Nets, reference: &Reference) -> Result<Comparison> {
    let scene = Scene::new(context, subject)?;
    let limit = context.config.evaluate.penetration_m;
    let train = &context.config.train;
    let track = scene.track(&reference.poses)?;
    let standing: Vec<Pose> = reference.resting.iter().map(|&f| reference.poses[f].clone()).collect();
    let still = scene.track(&standing)?;
    let roots: Vec<Vec3> = reference.poses.iter().map(|p| p.rotations[0]).collect();
    let (mut garments, mut drawn) = (Vec::new(), Vec::new());
    let count = subject.garments.len().max(1) as f64;
    for (k, ((garment, trained), simulated)) in
        subject.garments.iter().zip(&nets.garments).zip(&reference.garments).enumerate()
    {
        context.progress.set(k as f64 / count, &garment.kind.to_string());
        let model = fabric(context, garment.kind, Some(nets))?;
        let judge = Judge::new(&scene, garment, model, reference.fps, train)?;
        let (skinned, skinned_still) = (judge.skinned(&track)?, judge.skinned(&still)?);
        let net = &context.config.net;
        let moving = play(garment, trained, net, &track, Play::Clip)?;
        let posed = play(garment, trained, net, &still, Play::Poses)?;
        let resting: [&[Vec<Vec3>]; 3] = [&skinned_still, &posed, &simulated.at_rest];
        let ways: [&[Vec<Vec3>]; 3] = [&skinned, &moving, &simulated.moving];
        let hem = judge.hem();
        let filter = SpectrumFilter::new(&garment.mesh);
        let depths = Three::of(|way| Ok(penetration(&judge.clearances(&track, ways[way])?, limit)))?;
        let masses = &judge.rest.vertex_masses;
        let heights: Vec<f64> = moving
            .iter()
            .zip(&simulated.moving)
            .map(|(a, b)| (mass_height(a, masses) - mass_height(b, masses)).abs())
            .collect();
        garments.push(GarmentComparison {
            kind: garment.kind,
            at_rest: mean_energies(&judge, &still, &resting, &simulated.energies[1])?,
            moving: mean_energies(&judge, &track, &ways, &simulated.energies[0])?,
            spectrum: Three::of(|way| {
                let all: Vec<_> = ways[way].iter().map(|x| filter.of(x, &garment.mesh.faces)).collect();
                Ok(Spectrum::mean(&all))
            })?,
            swing_m: Three::of(|way| Ok(swing(ways[way], &skinned, &roots, &hem)))?,
            height_m: [
                heights.iter().sum::<f64>() / heights.len().max(1) as f64,
                heights.iter().copied().fold(0.0, f64::max),
            ],
            penetrating: Three::of(|way| Ok(depths.each()[way][0]))?,
            deepest_m: Three::of(|way| Ok(depths.each()[way][1]))?,
            hem_m: Three::of(|way| {
                let height = |(x, pose): (&Vec<Vec3>, &Pose)| {
                    let mean = hem.iter().map(|&v| x[v as usize].y).sum::<f64>() / hem.len().max(1) as f64;
                    mean - pose.translation.y
                };
                Ok(ways[way].iter().zip(&reference.poses).map(height).collect())
            })?,
            unconverged: [
                [simulated.unconverged[0], simulated.moving.len()],
                [simulated.unconverged[1], simulated.at_rest.len()],
            ],
        });
        drawn.push((garment, [skinned, moving, simulated.moving.clone()]));
    }
    let pictures = draw(context, &scene, reference, &drawn)?;
    Ok(Comparison { garments, fps: reference.fps, pictures })
}

/// Frames of the clip that are drawn per garment.
const SHOWN: usize = 4;

/// A picture per garment: frames of the clip, each skinned, by the net, by the solver.
fn draw(
    context: &Context<'_>,
    scene: &Scene,
    reference: &Reference,
    drawn: &[(&FittedGarment, [Vec<Vec<Vec3>>; 3])],
) -> Result<Vec<PathBuf>> {
    let last = reference.poses.len() - 1;
    let mut files = Vec::new();
    for (garment, ways) in drawn {
        let mut cells = Vec::new();
        for i in 1..=SHOWN {
            let frame = i * last / SHOWN;
            let (side, from) = if i % 2 == 1 { ("", pictures::FRONT) } else { (", back", pictures::BACK) };
            let posed = scene.body.forward(&scene.subject.posed(&reference.poses[frame]))?;
            let body = TriMesh { vertices: posed.vertices, faces: scene.rest.faces.clone() };
            for (name, frames) in ["skinned", "net", "solver"].iter().zip(ways) {
                let cloth = TriMesh { vertices: frames[frame].clone(), faces: garment.mesh.faces.clone() };
                let label = format!("{name} {:.1} s{side}", frame as f64 / reference.fps);
                cells.push((label, pictures::worn(&body, &cloth, garment.kind, &from)));
            }
        }
        let file = format!("pictures/compare-{}.png", garment.kind);
        context.write(&file, &pictures::sheet(&cells, 2 * ways.len())?)?;
        files.push(file.into());
    }
    Ok(files)
}
