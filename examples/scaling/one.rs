//! One size, measured.

use super::Outcome;
use caphy::config::TrainConfig;
use caphy::garment::FittedGarment;
use caphy::memory::{MemoryNeed, Sizes};
use caphy::plugins::{Kind, PluginTable, Plugins};
use caphy::track::{BodyTrack, Reach};
use caphy::trainer::{Batch, BatchKind, GarmentLearner, MotionFrames, ScanFrames, untrained};
use caphy_bodymodel::BodyMannequin;
use caphy_bodymodel::procedural_motion::{MotionKind, procedural_clip};
use caphy_core::Vec3;
use caphy_core::body::{BodyModel, BodyParameters};
use caphy_garment::energy::ScanCloud;
use caphy_garment::skinning::WeightOptions;
use caphy_garment::template::{BodyRest, Style, Tailor, Template, UpperStyle};
use nalgebra::Matrix3x4;
use serde::{Deserialize, Serialize};
use std::collections::HashMap;
use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

/// Steps of which the fastest counts.
pub(crate) const STEPS: usize = 5;
/// Vertices of the bench's shirt and its edges [m]: others follow by area.
const KNOWN: (f64, f64) = (4470.0, 0.0154);

/// Finest edges that shirts are cut with [m].
const FINEST: f64 = 0.006;

/// What is measured.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(crate) struct Case {
    /// Wanted garment vertices.
    pub(crate) vertices: usize,
    pub(crate) windows: usize,
    pub(crate) window: usize,
    pub(crate) threads: usize,
    /// Scans whose poses and points a step learns from, a batch at a time; 0 for windows of motion.
    pub(crate) scans: usize,
}

impl Default for Case {
    fn default() -> Self {
        Self { vertices: 5_000, windows: 16, window: 5, threads: 1, scans: 0 }
    }
}

/// What came out.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(crate) struct Measured {
    pub(crate) case: Case,
    /// Garment vertices.
    pub(crate) vertices: usize,
    /// From nothing to the first step.
    pub(crate) setup_s: f64,
    /// Fastest step.
    pub(crate) step_ms: f64,
    /// Its parts [ms].
    pub(crate) stages: Vec<(String, f64)>,
    /// Largest resident memory of the process.
    pub(crate) peak_bytes: usize,
    /// What the plan says, without the state to go back to, which this program does not keep.
    pub(crate) estimated_bytes: usize,
    /// Load average of the machine.
    pub(crate) load: f64,
}

impl Measured {
    /// Time of a part [ms].
    pub(crate) fn stage(&self, name: &str) -> f64 {
        self.stages.iter().find(|s| s.0 == name).map_or(f64::NAN, |s| s.1)
    }
}

/// Largest resident memory of this process [bytes].
fn peak() -> Outcome<usize> {
    let text = std::fs::read_to_string("/proc/self/status")?;
    let line = text.lines().find_map(|l| l.strip_prefix("VmHWM:")).ok_or("no VmHWM")?;
    Ok(1024 * line.trim().trim_end_matches("kB").trim().parse::<usize>()?)
}

/// Edges [m] of a shirt of so many vertices.
fn edge(vertices: usize) -> f64 {
    KNOWN.1 * (KNOWN.0 / vertices as f64).sqrt()
}

/// Splits each triangle at the middles of its sides; a shirt has no waistband whose loop would have to follow.
fn split(template: &mut Template) {
    let mut middles: HashMap<[u32; 2], u32> = HashMap::new();
    let (mut faces, mut uv) = (Vec::new(), Vec::new());
    for (face, corners) in template.mesh.faces.iter().zip(&template.material_uv) {
        let middle: [u32; 3] = std::array::from_fn(|k| {
            let (a, b) = (face[k], face[(k + 1) % 3]);
            *middles.entry([a.min(b), a.max(b)]).or_insert_with(|| {
                let points = &mut template.mesh.vertices;
                points.push(0.5 * (points[a as usize] + points[b as usize]));
                points.len() as u32 - 1
            })
        });
        let half: [[f64; 2]; 3] =
            std::array::from_fn(|k| std::array::from_fn(|c| 0.5 * (corners[k][c] + corners[(k + 1) % 3][c])));
        for k in 0..3 {
            faces.push([face[k], middle[k], middle[(k + 2) % 3]]);
            uv.push([corners[k], half[k], half[(k + 2) % 3]]);
        }
        faces.push(middle);
        uv.push(half);
    }
    (template.mesh.faces, template.material_uv) = (faces, uv);
    template.loops.clear();
}

/// What a scan might show of the shirt: three points for each of its vertices.
fn cloud(shirt: &FittedGarment, posed: &[Matrix3x4<f64>]) -> Outcome<ScanCloud<f32>> {
    let mut points = shirt.skinned(posed)?;
    let middles = shirt.mesh.faces.iter().map(|f| f.iter().map(|&v| points[v as usize]).sum::<Vec3>() / 3.0);
    points.extend(middles.collect::<Vec<_>>());
    Ok(ScanCloud::new("scaling", &points)?)
}

pub(crate) fn measure(case: &Case) -> Outcome<Measured> {
    rayon::ThreadPoolBuilder::new().num_threads(case.threads).build_global()?;
    let started = Instant::now();
    let body: Arc<dyn BodyModel> = Arc::new(BodyMannequin { resolution: 0.0193 }.generate()?);
    let subject = BodyParameters::rest(body.describe().joints.len(), &[]);
    let rest = BodyRest::from_model(&*body, &subject)?;
    let skin = rest.mesh.clone();
    let style = UpperStyle { sleeve_length: 0.4, body_length: 0.5, looseness: 0.02, neckline: 0.3 };
    // Finer than shirts are cut: triangles are split in four.
    let splits = (0..).find(|s| edge(case.vertices >> (2 * s)) >= FINEST).unwrap_or(0);
    let mut template = Tailor::new(rest)?.generate(&Style::Upper(style), edge(case.vertices >> (2 * splits)))?;
    for _ in 0..splits {
        split(&mut template);
    }
    eprintln!("  template {:.1} s", started.elapsed().as_secs_f64());
    let shirt = FittedGarment::new(template, &skin.vertices, &body.describe().weights, &WeightOptions::default())?;
    eprintln!("  weights {:.1} s", started.elapsed().as_secs_f64());
    let reach = Reach::new(&skin, &[&shirt.mesh.vertices], 0.12)?;
    let clip = procedural_clip(MotionKind::Walk, 1, (case.scans as f64 / 30.0).max(3.0), 30.0)?;
    let count = clip.poses.len();
    let config = TrainConfig { batch: case.windows, window: case.window, still_poses: 0, ..TrainConfig::default() };
    let motion = MotionFrames {
        track: BodyTrack::new(&*body, &subject, &reach, &clip.poses)?,
        starts: (0..count - case.window).collect(),
        has_before: (0..count).map(|i| i > 0).collect(),
        fps: 30.0,
    };
    let track = BodyTrack::new(&*body, &subject, &reach, &clip.poses[..case.scans.max(1)])?;
    let clouds = track.transforms.iter().map(|posed| cloud(&shirt, posed)).collect::<Outcome<_>>()?;
    let scans = ScanFrames { track: Arc::new(track), clouds, visible: vec![true; shirt.mesh.vertices.len()] };
    let (plugins, path) = (Plugins::new()?, Path::new("scaling.toml"));
    let net = PluginTable::parse(&plugins, Kind::Net, path, "type = \"gru\"")?;
    let fabric =
        PluginTable::parse(&plugins, Kind::Material, path, "type = \"measured\"\nfabric = \"gray-interlock\"")?;
    let first = untrained(&shirt, body.describe(), &net, &config, &motion, &scans.track, 1)?;
    let contact = reach.contact(&skin, &shirt)?;
    eprintln!("  contact {:.1} s", started.elapsed().as_secs_f64());
    let material = Arc::from(fabric.material("material")?);
    let built = net.net(first.manifest.inputs, first.manifest.outputs)?;
    let sizes = Sizes {
        net: &first.manifest,
        tape: built.tape_len(case.window, case.windows)?,
        vertices: shirt.mesh.vertices.len(),
        body_vertices: reach.vertices.len(),
        joints: body.describe().joints.len(),
        frames: count,
    };
    let need = MemoryNeed::training(&sizes, &config);
    let estimated_bytes = need.total() - need.good_state;
    let mut learner = GarmentLearner::new(&shirt, &first, material, &net, &config, &motion, &scans, contact)?;
    drop(first);
    let batch = match case.scans {
        0 => Batch {
            frames: (0..case.window).flat_map(|t| (0..case.windows).map(move |w| 4 * w + t)).collect(),
            windows: case.windows,
            kind: BatchKind::Windows,
        },
        scans => {
            let windows = scans.min(case.windows);
            Batch { frames: (0..windows).collect(), windows, kind: BatchKind::Scans }
        }
    };
    let mut fastest: Option<(f64, Vec<(String, f64)>)> = None;
    let mut setup_s = 0.0;
    for i in 0..=STEPS {
        if i == 0 {
            setup_s = started.elapsed().as_secs_f64();
        }
        learner.set_profiling(true);
        let begun = Instant::now();
        let pass = learner.forward(&batch)?;
        learner.backward(&pass)?;
        learner.step(1e-9, 1.0)?;
        let ms = begun.elapsed().as_secs_f64() * 1e3;
        let stages = learner.profile().iter().map(|(n, t)| (n.to_string(), t.as_secs_f64() * 1e3)).collect();
        // The first step fetches its memory.
        if i > 0 && fastest.as_ref().is_none_or(|f| ms < f.0) {
            fastest = Some((ms, stages));
        }
    }
    let (step_ms, stages) = fastest.ok_or("no step")?;
    let load = std::fs::read_to_string("/proc/loadavg")?;
    Ok(Measured {
        case: case.clone(),
        vertices: shirt.mesh.vertices.len(),
        setup_s,
        step_ms,
        stages,
        peak_bytes: peak()?,
        estimated_bytes,
        load: load.split(' ').next().unwrap_or_default().parse()?,
    })
}
