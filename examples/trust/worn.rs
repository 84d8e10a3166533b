//! Worn garments: a shirt on a body that is known, its scans from a finer cloth cut into other triangles, with friction and a cut that
//! is off.

use crate::{Section, table};
use caphy::config::{Config, RestScale, SubjectConfig, SyntheticConfig, WornEquilibrium};
use caphy::estimate::{WornOn, attached, capture, put_on, ten_fabrics};
use caphy::files::ProjectFiles;
use caphy::physics::solver_forces;
use caphy::plugins::Plugins;
use caphy::scene::Scene;
use caphy::synth::{Person, scan, wear};
use caphy_bodymodel::procedural_motion::static_poses;
use caphy_core::material::MaterialModel;
use caphy_core::pose::Pose;
use caphy_core::scan::Label;
use caphy_garment::GarmentRest;
use caphy_garment::estimate::equilibrium::equilibrium;
use caphy_garment::estimate::{
    CutPart, EquilibriumEstimate, EquilibriumSettings, NativeEvidence, Problem, Reduction, ScanPoints, reduction,
};
use caphy_garment::solver::Solver;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

/// Edge lengths of the scanned cloth and of the fitted one [m].
const FINE_M: f64 = 0.028;
const COARSE_M: f64 = 0.036;
/// How far the scanned shirts are cut off the fitted ones.
const CUT: RestScale = RestScale { girth: 1.01, length: 0.99 };
/// Poses of each fit.
const POSES: usize = 3;
/// A person in a shirt of one fabric.
const SCENE: &str = r#"
[run]
out = "nowhere"
[subject]
type = "synthetic"
scans = 3
held_out = ["scan-02"]
upper_material = { type = "measured", fabric = "FABRIC" }
lower_material = { type = "measured", fabric = "FABRIC" }
[body]
type = "mannequin"
resolution = 0.025
[segmenter]
type = "vertex"
[upper]
material = { type = "measured", fabric = "FABRIC" }
[net]
type = "gru"
[motion]
clips = [{ type = "procedural", kind = "walk", seconds = 2 }]
"#;

type Outcome<T> = Result<T, Box<dyn std::error::Error>>;

/// A shirt of one fabric on its person.
struct Shirt {
    config: Config,
    synthetic: SyntheticConfig,
    person: Person,
    scene: Scene,
    poses: Vec<Pose>,
}

impl Shirt {
    fn new(fabric: &str, resolution_m: f64, rest: RestScale) -> Outcome<Self> {
        let text = SCENE.replace("FABRIC", fabric);
        let config = Config::parse_set(Path::new("worn.toml"), &text, &[], &mut Plugins::new()?)?;
        let SubjectConfig::Synthetic(synthetic) = config.subject.clone() else {
            return Err("the subject is synthetic".into());
        };
        let synthetic = SyntheticConfig { resolution_m, rest, ..*synthetic };
        let body = Arc::from(config.body.body(&ProjectFiles::new(Path::new(".")))?);
        let mut person = Person::new(&synthetic, body, config.run.seed)?;
        person.templates.truncate(1);
        person.garments.truncate(1);
        person.materials.truncate(1);
        let Person { body, subject, garments, .. } = &person;
        let scene = Scene::dressed(body.clone(), &subject.shape, &subject.displacement, garments)?;
        let poses = static_poses(config.run.seed, POSES);
        Ok(Self { config, synthetic, person, scene, poses })
    }

    /// What scanners see of it in each pose.
    fn scans(&self) -> caphy_core::Result<Vec<ScanPoints>> {
        let one = |(i, pose): (usize, &Pose)| {
            let worn = wear(&self.synthetic, &self.person, &self.scene, pose)?;
            let mut rng = ChaCha8Rng::seed_from_u64(i as u64);
            let scanned = scan(&self.synthetic.rig, &self.person, pose, &worn, &format!("pose {i}"), &mut rng)?;
            let own: Vec<bool> = scanned.labels.iter().map(|l| *l == Label::Upper).collect();
            let (mesh, _) = scanned.scan.mesh.submesh(&own);
            Ok(ScanPoints::Surface { points: mesh.vertices, faces: mesh.faces, visible: None })
        };
        self.poses.iter().enumerate().map(one).collect()
    }

    /// Fitted to the scans of another, which was weighed.
    fn problem(&self, truth: &Shirt) -> Outcome<Problem> {
        let (shirt, material) = (&self.person.garments[0], self.person.materials[0].clone());
        let rest = shirt.rest(&*material)?;
        let density = truth.person.materials[0].describe().density.unwrap_or(rest.density);
        let rest = GarmentRest::new(rest.name, rest.template, rest.material_uv, density, rest.grain)?;
        let (forces, solver) = (solver_forces(&self.config.train), WornEquilibrium::default().solver);
        let track = self.scene.track(&self.poses)?;
        let map = Arc::new(self.scene.contact(shirt)?);
        let mut captures = Vec::new();
        for (i, points) in truth.scans()?.into_iter().enumerate() {
            let (positions, normals) = track.gather::<f64>(&[i], 1)?;
            let on = WornOn { positions, normals, map: map.clone(), transforms: track.transforms(&[i])[0] };
            let mut solver = Solver::new(&rest, material.clone(), forces, solver)?;
            let captured = capture(&format!("pose {i}"), shirt, on, solver.held_vertices(), points)?;
            captures.push(put_on(captured, &mut solver)?);
        }
        let parts = CutPart::of_limbs(&shirt.weights, rest.faces())?;
        Ok(attached(Problem { rest, material, forces, solver, captures, weighed: true, parts })?)
    }
}

/// As in runs, but that the body is known.
fn settings() -> EquilibriumSettings {
    EquilibriumSettings { body_offset_sd_m: 0.0, ..WornEquilibrium::default().fit }
}

/// Logarithm of values over the truth for each group of numbers; NaN for a column whose sum is not positive, as some tables have
/// it.
fn logs(truth: &dyn MaterialModel, values: &[f64]) -> Vec<(String, f64)> {
    let known: Vec<f64> = truth.parameters().iter().map(|p| p.value).collect();
    let sum = |values: &[f64], members: &[usize]| members.iter().map(|&i| values[i]).sum::<f64>();
    let log = |members: &[usize]| sum(values, members).ln() - sum(&known, members).ln();
    reduction::groups(truth).into_iter().map(|g| (g.name, log(&g.members))).collect()
}

/// Bending's mean and the table's columns but the Poisson coupling: median |log ratio|.
pub(crate) fn listed(truth: &dyn MaterialModel, values: &[f64]) -> f64 {
    let kept = logs(truth, values).into_iter().filter(|(name, log)| !name.contains("c12") && log.is_finite());
    middle(kept.map(|(_, log)| log.abs()).collect())
}

pub(crate) fn middle(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(f64::NAN)
}

/// 95 % intervals, those of unknowns that the prior does not hold: how many cover the truth, of how many.
pub(crate) fn coverage(truth: &dyn MaterialModel, found: &EquilibriumEstimate) -> [usize; 2] {
    let errors = logs(truth, &found.parameters);
    let judged = found.unknowns.iter().zip(&errors).filter(|(u, (_, log))| !u.held_by_prior && log.is_finite());
    let inside = judged.clone().filter(|(u, (_, log))| log.abs() <= 1.96 * u.log_sd).count();
    [inside, judged.count()]
}

/// All ten, each from another's table.
pub(crate) fn section() -> Section {
    let all = ten_fabrics()?;
    let head = [
        "truth",
        "started from",
        "median ∣log ratio∣ before",
        "after",
        "intervals that cover",
        "nearest of the ten",
        "place of the truth",
        "distance left in each pose, mm",
        "poses left out",
        "s",
    ];
    let (mut rows, mut odds_rows) = (Vec::new(), Vec::new());
    let (mut before_all, mut after_all, mut covered, mut right) = (Vec::new(), Vec::new(), [0; 2], 0);
    for (k, (name, _)) in all.iter().enumerate() {
        let other = &all[(k + 3) % all.len()].0;
        let begun = Instant::now();
        let truth = Shirt::new(name, FINE_M, CUT)?;
        let problem = Shirt::new(other, COARSE_M, RestScale::default())?.problem(&truth)?;
        let reduction = Reduction::multipliers(&*problem.material)?;
        let found = match equilibrium(&problem, reduction, &settings(), None, &mut |_| Ok(())) {
            Ok(found) => found,
            Err(error) => {
                rows.push(vec![name.clone(), other.clone(), error.to_string()]);
                continue;
            }
        };
        let fabric = &*truth.person.materials[0];
        let start: Vec<f64> = problem.material.parameters().iter().map(|p| p.value).collect();
        let (before, after) = (listed(fabric, &start), listed(fabric, &found.parameters));
        let counts = coverage(fabric, &found);
        covered = [covered[0] + counts[0], covered[1] + counts[1]];
        let odds = NativeEvidence::at(&problem, &found, &settings())?.odds(&all, settings().mesh_log_sd)?;
        let place = odds.iter().position(|o| o.name == *name).map_or(0, |p| p + 1);
        right += usize::from(place == 1);
        before_all.push(before);
        after_all.push(after);
        rows.push(vec![
            name.clone(),
            other.clone(),
            format!("{before:.2}"),
            format!("{after:.2}"),
            format!("{} of {}", counts[0], counts[1]),
            odds[0].name.clone(),
            place.to_string(),
            found.poses.iter().map(|p| format!("{:.1}", p.rms_mm)).collect::<Vec<_>>().join(", "),
            found.poses.iter().filter(|p| p.left_out.is_some()).count().to_string(),
            format!("{:.0}", begun.elapsed().as_secs_f64()),
        ]);
        let share = |of: &str| odds.iter().find(|o| o.name == of).map_or(0.0, |o| o.probability);
        let cells = all.iter().map(|(of, _)| format!("{:.0}", 100.0 * share(of)));
        odds_rows.push(std::iter::once(name.clone()).chain(cells).collect::<Vec<_>>());
        eprintln!("  {}", rows[rows.len() - 1].join("  "));
    }
    let mut matrix = vec!["truth"];
    matrix.extend(all.iter().map(|f| f.0.as_str()));
    Ok(format!(
        "A short-sleeved shirt on a mannequin whose shape and poses are known, in {POSES} poses; scanned with 0.5 mm of noise from a cloth of \
         {:.0} mm edges, fitted with {:.0} mm edges of another cut: girth {:+.0} %, length {:+.0} %, each part's cut fitted along. Friction is \
         0.3 in both. The whole table of another fabric as start, the shirt weighed. The truth is the nearest of the ten for {right} of {}; \
         the median ∣log ratio∣ of bending and the tables' columns (without the Poisson coupling) goes from {:.2} to {:.2}; of {} intervals \
         that the prior does not hold {} cover the truth.\n{}\nOdds of the ten, %:\n{}",
        1e3 * FINE_M,
        1e3 * COARSE_M,
        100.0 * (CUT.girth - 1.0),
        100.0 * (CUT.length - 1.0),
        rows.len(),
        middle(before_all),
        middle(after_all),
        covered[1],
        covered[0],
        table(&head, &rows),
        table(&matrix, &odds_rows),
    ))
}
