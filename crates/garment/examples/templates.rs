//! Templates measured and drawn, on the mannequin and, where the shared data is, on the Anny body:
//!
//! ```text
//! cargo run --release -p caphy-garment --example templates -- styles [COUNT]   # time and quality of the style space
//! cargo run --release -p caphy-garment --example templates -- given            # every garment of the shared data, resolved
//! cargo run --release -p caphy-garment --example templates -- tearing          # skinning weights over extreme poses
//! ```
//!
//! With `CAPHY_PICTURES=DIR`, pictures of what is measured are written there. `CAPHY_SHARED` names the shared data.

use caphy_bodymodel as _;
use caphy_core::body::{BodyModel, BodyParameters, BodySpec};
use caphy_core::files::{Disk, Files};
use caphy_core::pose::Pose;
use caphy_core::{TriMesh, Vec3};
use caphy_formats::npz::Npz;
use caphy_garment::skinning::{WeightOptions, garment_weights};
use caphy_garment::template::{
    BodyRest, FitOptions, GarmentFacts, GarmentKind, LowerStyle, Quantiles, Style, Tailor, TemplateFolder,
    TemplateSpec, UpperStyle, pose_by_weights, read_garment, sample_styles,
};
use caphy_render::cameras::{Projection, frame};
use caphy_render::shade::{CLAY_LOWER, CLAY_SKIN, CLAY_UPPER, Layer, Picture};
use caphy_render::{contact_sheet, png};
use std::path::{Path, PathBuf};
use std::time::Instant;

type Outcome<T> = Result<T, Box<dyn std::error::Error>>;

/// Edge length at which styles are compared with scans [m].
const CHOOSING: f64 = 0.035;

fn shared() -> PathBuf {
    std::env::var_os("CAPHY_SHARED")
        .map_or_else(|| PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared")), PathBuf::from)
}

struct Subject {
    name: &'static str,
    model: Box<dyn BodyModel>,
    shape: Vec<f64>,
}

impl Subject {
    fn rest(&self) -> Outcome<BodyRest> {
        Ok(BodyRest::from_model(&*self.model, &self.parameters())?)
    }
    fn parameters(&self) -> BodyParameters {
        BodyParameters::rest(self.model.describe().joints.len(), &self.shape)
    }
}

fn body(spec: &str) -> Outcome<Box<dyn BodyModel>> {
    Ok(toml::from_str::<Box<dyn BodySpec>>(spec)?.build(&Disk)?)
}

fn anny() -> Outcome<Option<Subject>> {
    let path = shared().join("data/body/anny_smplx_layout.npz");
    if !path.exists() {
        println!("SKIPPED: {} is not there (set CAPHY_SHARED)", path.display());
        return Ok(None);
    }
    let npz = Npz::from_bytes(&path, Disk.read(&path)?)?;
    let shape = npz.f64s("ref__0__mid_betas")?.data;
    let model = body(&format!("type = \"smplx\"\npath = '{}'", path.display()))?;
    Ok(Some(Subject { name: "anny", model, shape }))
}

fn subjects() -> Outcome<Vec<Subject>> {
    let mut out = vec![Subject { name: "mannequin", model: body("type = \"mannequin\"")?, shape: Vec::new() }];
    out.extend(anny()?);
    Ok(out)
}

fn save(name: &str, cells: &[(String, caphy_render::Rgb)], columns: usize) -> Outcome<()> {
    if let Some(folder) = std::env::var_os("CAPHY_PICTURES") {
        let list: Vec<(&str, &caphy_render::Rgb)> = cells.iter().map(|(n, p)| (n.as_str(), p)).collect();
        std::fs::write(Path::new(&folder).join(name), png(&contact_sheet(&list, columns))?)?;
    }
    Ok(())
}

/// A garment on its body from a side, flat triangles.
fn shot(skin: &TriMesh, cloth: &TriMesh, kind: GarmentKind, from: Vec3) -> caphy_render::Rgb {
    let (low, high) = cloth.bounds().unwrap_or((Vec3::zeros(), Vec3::repeat(1.0)));
    let bounds = (low - Vec3::repeat(0.05), high + Vec3::repeat(0.05));
    let camera = frame(bounds, &from, Projection::Orthographic, 420, 420);
    let colour = if kind == GarmentKind::Upper { CLAY_UPPER } else { CLAY_LOWER };
    let mut layer = Layer::uniform(cloth, colour);
    layer.smooth = false;
    Picture::new(camera, vec![Layer::uniform(skin, CLAY_SKIN), layer]).draw()
}

fn range(q: &Quantiles, scale: f64, digits: usize) -> String {
    let v = |x: f64| format!("{:.digits$}", x * scale);
    format!("{} [{}, {}] ({}–{})", v(q.median), v(q.p05), v(q.p95), v(q.least), v(q.largest))
}

/// Processor time of this program so far [s], where the system tells: unlike the clock, it does not count others' work.
fn processor_seconds() -> f64 {
    let text = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    // After the name in parentheses, times are the 12th and 13th field, in hundredths of a second.
    let after = text.rsplit(')').next().unwrap_or_default();
    after.split_whitespace().skip(11).take(2).filter_map(|t| t.parse::<f64>().ok()).sum::<f64>() / 100.0
}

fn styles(count: usize) -> Outcome<()> {
    println!(
        "| body | kind | styles | failed | clock, s | processor, s | vertices | edge, mm | angle, ° | angles < 20° | clearance, mm |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|---|");
    for subject in subjects()? {
        let rest = subject.rest()?;
        let start = Instant::now();
        let tailor = Tailor::new(rest.clone())?;
        let measured = start.elapsed().as_secs_f64();
        for kind in [GarmentKind::Upper, GarmentKind::Lower] {
            let row = sample_styles(kind, count, 7);
            let (start, worked) = (Instant::now(), processor_seconds());
            let made: Vec<_> = {
                use rayon::prelude::*;
                row.par_iter().map(|s| tailor.generate(s, CHOOSING)).collect()
            };
            let (time, worked) = (start.elapsed().as_secs_f64(), processor_seconds() - worked);
            let failed: Vec<_> = made.iter().filter_map(|t| t.as_ref().err()).collect();
            failed.iter().for_each(|e| eprintln!("{e}"));
            let good: Vec<_> = made.iter().flatten().collect();
            let facts: Vec<GarmentFacts> = good.iter().map(|t| t.facts()).collect();
            let (mut edges, mut angles, mut sharp) = (Vec::new(), Vec::new(), 0);
            for t in &good {
                for f in 0..t.mesh.faces.len() {
                    let p = t.mesh.corners(f);
                    for k in 0..3 {
                        let (a, b) = (p[(k + 1) % 3] - p[k], p[(k + 2) % 3] - p[k]);
                        edges.push(a.norm());
                        let angle = a.angle(&b).to_degrees();
                        sharp += usize::from(angle < 20.0);
                        angles.push(angle);
                    }
                }
            }
            let corners = angles.len();
            println!(
                "| {} | {kind} | {count} | {} | {time:.1} (+ {measured:.1}) | {worked:.1} | {} | {} | {} | {:.3} % | {} |",
                subject.name,
                failed.len(),
                range(&Quantiles::of(facts.iter().map(|f| f.vertices as f64).collect()), 1.0, 0),
                range(&Quantiles::of(edges), 1e3, 1),
                range(&Quantiles::of(angles), 1.0, 1),
                100.0 * sharp as f64 / corners.max(1) as f64,
                range(&Quantiles::of(facts.iter().map(|f| f.clearance_m).collect()), 1e3, 2),
            );
            let cells: Vec<(String, caphy_render::Rgb)> = good
                .iter()
                .take(12)
                .map(|t| {
                    (format!("{:.2?}", t.style.to_unit()), shot(&rest.mesh, &t.mesh, kind, Vec3::new(0.5, 0.2, 1.0)))
                })
                .collect();
            save(&format!("styles-{}-{kind}.png", subject.name), &cells, 4)?;
        }
    }
    Ok(())
}

fn given() -> Outcome<()> {
    let Some(subject) = anny()? else { return Ok(()) };
    let rest = subject.rest()?;
    let tailor = Tailor::new(rest.clone())?;
    let folder = shared().join("data/garments");
    println!(
        "| garment | kind | loops | vertices | inside before | deepest, mm | clearance after, mm | area | edges (least, 5 %, 95 %, most) \
         | moved rms, most, rough, mm | rounds | time, s |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|---|---|");
    let mut cells = Vec::new();
    for path in Disk.list(&folder, &["obj"])? {
        let before = read_garment(&path, &Disk.read(&path)?)?;
        for split in [false, true] {
            let options = FitOptions { split, ..FitOptions::default() };
            let start = Instant::now();
            let t = match tailor.fit(before.clone(), &[], 0.02, &options) {
                Ok(t) => t,
                Err(e) => {
                    println!("| {} | {e} |", before.name);
                    continue;
                }
            };
            let time = start.elapsed().as_secs_f64();
            let facts = t.facts();
            let Some(given) = &facts.given else { continue };
            let p = &given.penetration;
            let loops: Vec<String> = facts.loops.iter().map(|l| format!("{} {:.2}", l.name, l.girth_m)).collect();
            println!(
                "| {} | {} | {} | {} | {:.1} % | {:.1} | {:.2} | {:.4} | {:.2?} | {:.2}, {:.2}, {:.2} | {} | {time:.2} |",
                before.name,
                facts.kind,
                loops.join(", "),
                facts.vertices,
                100.0 * p.inside_share[0],
                p.deepest_m[0] * 1e3,
                p.clearance_m * 1e3,
                p.area_ratio,
                p.edge_ratio,
                p.moved_m[0] * 1e3,
                p.moved_m[1] * 1e3,
                p.rough_m * 1e3,
                p.rounds
            );
            if split {
                for (label, from) in [("front", Vec3::new(0.4, 0.2, 1.0)), ("back", Vec3::new(-0.4, 0.2, -1.0))] {
                    let name = |when: &str| format!("{} {when} {label}", before.name);
                    cells.push((name("before"), shot(&rest.mesh, &before.mesh, t.kind, from)));
                    cells.push((name("after"), shot(&rest.mesh, &t.mesh, t.kind, from)));
                }
            }
        }
    }
    save("given.png", &cells, 4)?;
    let spec = TemplateFolder { path: folder, fit: FitOptions::default() };
    let source = spec.build(&Disk)?;
    for kind in [GarmentKind::Upper, GarmentKind::Lower] {
        println!("{kind} garments of the folder: {}", source.styles(&tailor, kind, 300, 0)?.len());
    }
    Ok(())
}

/// Poses that pull at armpits and crotch.
fn poses(model: &dyn BodyModel) -> Vec<(&'static str, Pose)> {
    let count = model.describe().joints.len();
    let pose = |turns: &[(&str, Vec3)]| {
        let mut rotations = vec![Vec3::zeros(); count];
        for (name, turn) in turns {
            if let Some(j) = model.describe().joint(name) {
                rotations[j] = *turn;
            }
        }
        Pose { rotations, translation: Vec3::zeros() }
    };
    let z = Vec3::z;
    let x = Vec3::x;
    vec![
        ("arms down", pose(&[("left_shoulder", z() * -1.2), ("right_shoulder", z() * 1.2)])),
        (
            "arms up",
            pose(&[
                ("left_shoulder", z() * 1.1),
                ("right_shoulder", z() * -1.1),
                ("left_collar", z() * 0.3),
                ("right_collar", z() * -0.3),
            ]),
        ),
        ("arms forward", pose(&[("left_shoulder", Vec3::y() * -1.4), ("right_shoulder", Vec3::y() * 1.4)])),
        ("knee up", pose(&[("left_hip", x() * -1.6), ("left_knee", x() * 1.7)])),
        (
            "squat",
            pose(&[
                ("left_hip", x() * -1.7),
                ("right_hip", x() * -1.7),
                ("left_knee", x() * 2.0),
                ("right_knee", x() * 2.0),
            ]),
        ),
        ("straddle", pose(&[("left_hip", z() * 0.8), ("right_hip", z() * -0.8)])),
    ]
}

fn tearing() -> Outcome<()> {
    let garments = [
        Style::Upper(UpperStyle { sleeve_length: 0.35, body_length: 0.5, looseness: 0.02, neckline: 0.2 }),
        Style::Lower(LowerStyle { leg_length: 0.9, looseness: 0.02, rise: 0.6 }),
    ];
    println!(
        "| body | garment | edge, mm | smoothing, m | arms down | arms up | arms forward | knee up | squat | straddle | 99 % of edges | drift, mm |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|---|---|");
    for subject in subjects()? {
        let rest = subject.rest()?;
        let tailor = Tailor::new(rest.clone())?;
        for style in &garments {
            for resolution in [0.012, 0.025] {
                let t = tailor.generate(style, resolution)?;
                let mut nearest: Vec<Vec<Vec3>> = Vec::new();
                for smoothing_m in SMOOTHING {
                    let options = WeightOptions { smoothing_m, ..WeightOptions::default() };
                    let w = garment_weights(
                        &t.mesh.vertices,
                        &t.mesh.faces,
                        &rest.mesh.vertices,
                        &subject.model.describe().weights,
                        &options,
                    )?;
                    let (mut worst, mut all, mut drift, mut drifts) = (Vec::new(), Vec::new(), 0.0, 0);
                    for (k, (_, pose)) in poses(&*subject.model).iter().enumerate() {
                        let posed = subject.model.forward(&subject.parameters().posed(pose))?;
                        let x = pose_by_weights(&t.mesh.vertices, &w, &posed.transforms)?;
                        let mut most = 0.0f64;
                        for f in &t.mesh.faces {
                            for (a, b) in [(f[0], f[1]), (f[1], f[2]), (f[2], f[0])] {
                                let (a, b) = (a as usize, b as usize);
                                let ratio = (x[a] - x[b]).norm() / (t.mesh.vertices[a] - t.mesh.vertices[b]).norm();
                                most = most.max(ratio);
                                all.push(ratio);
                            }
                        }
                        worst.push(format!("{most:.2}"));
                        match nearest.get(k) {
                            Some(n) => {
                                drift += n.iter().zip(&x).map(|(p, q)| (p - q).norm()).sum::<f64>();
                                drifts += x.len();
                            }
                            None => nearest.push(x),
                        }
                    }
                    all.sort_by(f64::total_cmp);
                    println!(
                        "| {} | {} | {:.0} | {smoothing_m} | {} | {:.2} | {:.1} |",
                        subject.name,
                        t.kind,
                        resolution * 1e3,
                        worst.join(" | "),
                        all[all.len() * 99 / 100],
                        1e3 * drift / drifts.max(1) as f64
                    );
                }
            }
        }
    }
    Ok(())
}

/// Amounts of smoothing compared [m].
const SMOOTHING: [f64; 5] = [0.0, 0.02, 0.04, 0.08, 0.16];

fn main() -> Outcome<()> {
    let words: Vec<String> = std::env::args().skip(1).collect();
    match words.iter().map(String::as_str).collect::<Vec<_>>().as_slice() {
        ["styles"] => styles(300),
        ["styles", count] => styles(count.parse()?),
        ["given"] => given(),
        ["tearing"] => tearing(),
        _ => Err("give `styles [COUNT]`, `given` or `tearing`".into()),
    }
}
