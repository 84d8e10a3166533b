//! Single against double precision: forces of a small cloth.

use super::{Figures, Outcome, table};
use caphy::plot::{Curve, number};
use caphy::plugins::{Kind, PluginTable, Plugins};
use caphy_core::array::{In, Out};
use caphy_core::lanes::Frames;
use caphy_core::material::{MaterialModel, MaterialReal, MaterialSpec};
use caphy_core::net::{ForwardBlock, ForwardCall};
use caphy_core::units::KilogramPerSquareMetre;
use caphy_core::{TriMesh, Vec3};
use caphy_garment::GarmentRest;
use caphy_garment::energy::{Bending, EnergyTerm, Inertia, InertiaRule, RestAngle, State, Strain};
use caphy_materials::MaterialMeasuredSpec;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
use std::path::Path;
use std::sync::Arc;

/// Squares along a side of the cloth.
const SIDE: usize = 16;
/// An error of forces that trainings do not notice: their gradients differ more from window to window.
const ENOUGH: f64 = 0.01;

fn fabric() -> Outcome<Arc<dyn MaterialModel>> {
    Ok(Arc::from(MaterialMeasuredSpec::new("gray-interlock").build()?))
}

/// A flat square with edges of a length [m], with its lower left corner somewhere.
fn cloth(edge: f64) -> Outcome<GarmentRest> {
    let n = SIDE + 1;
    let vertices: Vec<Vec3> = (0..n * n).map(|v| Vec3::new((v % n) as f64, (v / n) as f64, 0.0) * edge).collect();
    let mut faces = Vec::new();
    for j in 0..SIDE {
        for i in 0..SIDE {
            let id = |i: usize, j: usize| (j * n + i) as u32;
            let [a, b, c, d] = [id(i, j), id(i + 1, j), id(i, j + 1), id(i + 1, j + 1)];
            faces.extend(if (i + j) % 2 == 0 { [[a, b, d], [a, d, c]] } else { [[a, b, c], [b, d, c]] });
        }
    }
    let uv = faces.iter().map(|f| f.map(|v| [vertices[v as usize].x, vertices[v as usize].y])).collect();
    let mesh = TriMesh { vertices, faces };
    Ok(GarmentRest::new("cloth", mesh, uv, KilogramPerSquareMetre(0.2), "flat")?)
}

/// The cloth stretched along x, waved (curvature times edge 0.2), shaken by a thousandth of an edge, moved away from the origin [m].
fn deformed(rest: &GarmentRest, edge: f64, stretch: f64, away: f64) -> Vec<Vec3> {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let mut noise =
        || (rng.next_u32() as f64 / f64::from(u32::MAX) - 0.5) * 2e-3 * edge * (stretch - 1.0).abs().min(1.0);
    let one = |p: &Vec3| {
        let wave = 0.2 * edge * (p.x / edge * 0.7).sin() * (stretch - 1.0).abs().min(1.0);
        Vec3::new(stretch * p.x + noise(), p.y + noise(), wave + noise()) + Vec3::new(0.6, 0.7, -0.4) * away
    };
    rest.template.vertices.iter().map(one).collect()
}

/// Gradient of a term in a precision.
fn forces<T: MaterialReal>(term: &dyn EnergyTerm<T>, frames: &[Vec<Vec3>]) -> Outcome<Vec<Vec3>> {
    let mut x = Frames::<T>::zeros(frames.len(), frames[0].len(), 1);
    frames.iter().enumerate().try_for_each(|(step, points)| x.set_frame(step, 0, points))?;
    let (mut energy, mut gradient) = (vec![0.0; frames.len()], x.clone());
    gradient.clear();
    term.add(&State::new(&x), 1.0, &mut energy, Some(&mut gradient))?;
    Ok(gradient.frame(frames.len() - 1, 0))
}

/// Σ|a − b|² over Σ|b|², as a root.
fn relative(a: &[Vec3], b: &[Vec3]) -> f64 {
    let (off, all) =
        a.iter().zip(b).fold((0.0, 0.0), |s, (a, b)| (s.0 + (a - b).norm_squared(), s.1 + b.norm_squared()));
    (off / all).sqrt()
}

/// Errors of single precision in strain and bending forces: of the evaluation, from positions rounded alike, and with the rounding
/// of positions.
struct Errors {
    evaluation: [f64; 2],
    whole: [f64; 2],
    /// Error of strain forces over the size of bending forces.
    noise_over_bending: f64,
}

fn errors(rest: &GarmentRest, material: &Arc<dyn MaterialModel>, exact: &[Vec3]) -> Outcome<Errors> {
    let rounded: Vec<Vec3> = exact.iter().map(|p| p.map(|c| f64::from(c as f32))).collect();
    let strain = (Strain::<f32>::new(rest, material.clone()), Strain::<f64>::new(rest, material.clone()));
    let angle = RestAngle::Template;
    let bending =
        (Bending::<f32>::new(rest, material.clone(), angle), Bending::<f64>::new(rest, material.clone(), angle));
    let both = |single: &dyn EnergyTerm<f32>, double: &dyn EnergyTerm<f64>| -> Outcome<([f64; 2], [f64; 2])> {
        let f32s = forces(single, std::slice::from_ref(&rounded))?;
        let (alike, truth) = (forces(double, std::slice::from_ref(&rounded))?, forces(double, &[exact.to_vec()])?);
        let size = truth.iter().map(|f| f.norm_squared()).sum::<f64>().sqrt();
        Ok(([relative(&f32s, &alike), relative(&f32s, &truth)], [size, relative(&f32s, &truth) * size]))
    };
    let (s, strain_size) = both(&strain.0, &strain.1)?;
    let (b, bending_size) = both(&bending.0, &bending.1)?;
    Ok(Errors { evaluation: [s[0], b[0]], whole: [s[1], b[1]], noise_over_bending: strain_size[1] / bending_size[0] })
}

/// Four curves over log10 of x.
fn curves(found: &[(f64, Errors)]) -> Vec<Curve> {
    let curve = |name: &str, of: fn(&Errors) -> f64| Curve {
        name: name.into(),
        points: found.iter().map(|(x, e)| (x.log10(), of(e))).collect(),
    };
    vec![
        curve("strain, evaluated", |e| e.evaluation[0]),
        curve("strain, positions too", |e| e.whole[0]),
        curve("bending, evaluated", |e| e.evaluation[1]),
        curve("bending, positions too", |e| e.whole[1]),
    ]
}

fn rows(found: &[(f64, Errors)]) -> Vec<Vec<String>> {
    let row = |(x, e): &(f64, Errors)| {
        [*x, e.evaluation[0], e.whole[0], e.evaluation[1], e.whole[1]].into_iter().map(number).collect()
    };
    found.iter().map(row).collect()
}

const ERRORS: [&str; 4] =
    ["strain, evaluated", "strain, positions too", "bending, evaluated", "bending, positions too"];

fn measured_table(x: &str, found: &[(f64, Errors)]) -> String {
    let head: Vec<&str> = std::iter::once(x).chain(ERRORS).collect();
    table(&head, &rows(found))
}

/// The first x from which on all errors with positions stay below what is enough.
fn enough_from(found: &[(f64, Errors)], which: usize) -> Option<f64> {
    let good = |e: &Errors| e.whole[which] < ENOUGH;
    let bad = found.iter().rposition(|(_, e)| !good(e));
    found.get(bad.map_or(0, |b| b + 1)).map(|f| f.0)
}

/// All of it.
pub(crate) fn section(figures: &Figures) -> Outcome<String> {
    let material = fabric()?;
    eprintln!("single precision: stretch");
    let rest = cloth(0.01)?;
    let mut stretch = Vec::new();
    for i in 0..=12 {
        let strain = 10f64.powf(-6.0 + 0.5 * f64::from(i));
        stretch.push((strain, errors(&rest, &material, &deformed(&rest, 0.01, 1.0 + strain, 1.0))?));
    }
    for large in [2.0, 5.0, 9.0] {
        stretch.push((large, errors(&rest, &material, &deformed(&rest, 0.01, 1.0 + large, 1.0))?));
    }
    eprintln!("single precision: element size");
    let mut size = Vec::new();
    for i in 0..=10 {
        let edge = 10f64.powf(-5.0 + 0.5 * f64::from(i));
        let rest = cloth(edge)?;
        size.push((edge, errors(&rest, &material, &deformed(&rest, edge, 1.05, 1.0))?));
    }
    eprintln!("single precision: stiffness ratio");
    let mut ratio = Vec::new();
    for i in 0..=8 {
        let mu = 10f64.powf(-1.0 + f64::from(i));
        let text = format!("lambda_n_per_m = {mu:?}\nmu_n_per_m = {mu:?}\nbending_nm = 1e-5");
        let spec: caphy_materials::MaterialStvkSpec = toml::from_str(&text)?;
        let stiff: Arc<dyn MaterialModel> = Arc::from(spec.build()?);
        // k/l² against μ.
        ratio.push((mu / (1e-5 / 1e-4), errors(&rest, &stiff, &deformed(&rest, 0.01, 1.001, 1.0))?));
    }
    eprintln!("single precision: clips");
    let (place, clip) = clips(&rest, &material)?;
    let net = net_drift()?;

    let noise = Curve {
        name: "strain's noise".into(),
        points: ratio.iter().map(|(x, e)| (x.log10(), e.noise_over_bending)).collect(),
    };
    let plots = [
        figures.plot(
            "stretch",
            "f32 against f64: strain",
            "log10 of stretch − 1",
            "relative error of forces",
            curves(&stretch),
        )?,
        figures.plot(
            "size",
            "f32 against f64: element size",
            "log10 of the edge [m]",
            "relative error of forces",
            curves(&size),
        )?,
        figures.plot(
            "ratio",
            "f32: noise of strain over bending forces",
            "log10 of μ l²/k",
            "over bending",
            vec![noise],
        )?,
        figures.plot(
            "clip",
            "f32 against f64: a clip that walks away",
            "log10 of seconds at 1.4 m/s",
            "relative error of forces",
            clip,
        )?,
    ];
    let from =
        |found, scale: f64| [0, 1].map(|which| enough_from(found, which).map_or("none".into(), |x| number(scale * x)));
    let ([size_s, size_b], [strain_s, strain_b]) = (from(&size, 1e3), from(&stretch, 100.0));
    let far = |which: usize| place.iter().take_while(|(_, e)| e[which] < ENOUGH).last().map_or(0.0, |p| p.0);
    let gray = ratio.first().map_or(0.0, |r| r.1.noise_over_bending / r.0);
    let place_rows: Vec<Vec<String>> =
        place.iter().map(|(t, e)| [*t, 1.4 * t, e[0], e[1], e[2]].into_iter().map(number).collect()).collect();
    let ratio_rows: Vec<Vec<String>> =
        ratio.iter().map(|(x, e)| [*x, e.whole[0], e.noise_over_bending].into_iter().map(number).collect()).collect();
    Ok(format!(
        "## Single against double precision\n\n\
         Forces of a square of {count} vertices (gray-interlock, edges of 10 mm, about a metre from the origin, where nothing else is said), \
         root of the sum of squares of their error over that of the forces. *Evaluated*: from positions that f32 holds exactly. \
         *Positions too*: with the rounding of positions, 6e-8 of their distance from the origin. The second is what a training in f32 sees.\n\n\
         **What follows.** Evaluation is never the trouble (errors up to 1e-4); positions are. A metre from the origin and in f32, strain forces are right to \
         {enough} % for edges from {size_s} mm and strains from {strain_s} % on, bending forces from {size_b} mm and {strain_b} %; a cloth that walks away keeps that \
         for {far_s:.0} s (strain), {far_b:.0} s (bending), {far_i:.0} s (inertia). Training, whose gradients differ by more from window to window, stays in f32 \
         with edges of a centimetre and clips of seconds around the origin. What asks for equilibrium does not: there strain forces cancel, \
         and their rounding alone is {gray:.1} times μ l²/k times the bending forces. The reference solver, estimates and all checks are in f64 \
         throughout. For templates finer than 3 mm or clips that leave the origin by more than some ten metres: centre the clip first \
         (windows are what training sees), or simulate.\n\n\
         ### Stretch\n{a}{b}\n### Element size\n\nStretched by 5 %.\n{c}{d}\n\
         ### Stiffness ratio\n\nStVK, k = 1e-5 N m, stretched by 0.1 %: error of strain forces, and over the bending forces.\n{e}{f}\n\
         ### Clip length\n\nA cloth at 5 % strain that moves away at 1.4 m/s; inertia over 1/30 s with a jerk of a millimetre.\n{g}{h}\n{net}",
        count = rest.vertex_count(),
        enough = 100.0 * ENOUGH,
        far_s = far(0),
        far_b = far(1),
        far_i = far(2),
        a = measured_table("stretch − 1", &stretch),
        b = plots[0],
        c = measured_table("edge, m", &size),
        d = plots[1],
        e = table(&["μ l²/k", "strain", "noise of strain over bending"], &ratio_rows),
        f = plots[2],
        g = table(&["seconds", "metres", "strain", "bending", "inertia"], &place_rows),
        h = plots[3],
    ))
}

/// Errors of strain, bending and inertia with time, and their curves.
type Clip = (Vec<(f64, [f64; 3])>, Vec<Curve>);

fn clips(rest: &GarmentRest, material: &Arc<dyn MaterialModel>) -> Outcome<Clip> {
    let inertia = (
        Inertia::<f32>::new(rest, 1.0 / 30.0, InertiaRule::KnownVelocity)?,
        Inertia::<f64>::new(rest, 1.0 / 30.0, InertiaRule::KnownVelocity)?,
    );
    let mut found = Vec::new();
    for seconds in [1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 1000.0, 3600.0] {
        let away = 1.4 * seconds;
        let exact = deformed(rest, 0.01, 1.05, away);
        let e = errors(rest, material, &exact)?;
        let step = |t: f64| -> Vec<Vec3> {
            let jerk = if t == 2.0 { 1e-3 } else { 0.0 };
            exact.iter().map(|p| p + Vec3::new(1.4 / 30.0 * t, jerk, 0.0)).collect()
        };
        let frames = [step(0.0), step(1.0), step(2.0)];
        let off = relative(&forces(&inertia.0, &frames)?, &forces(&inertia.1, &frames)?);
        found.push((seconds, [e.whole[0], e.whole[1], off]));
    }
    let curve = |name: &str, k: usize| Curve {
        name: name.into(),
        points: found.iter().map(|(t, e): &(f64, [f64; 3])| (t.log10(), e[k])).collect(),
    };
    let curves = vec![curve("strain", 0), curve("bending", 1), curve("inertia", 2)];
    Ok((found, curves))
}

/// What a net that carries memory has drifted after a clip.
fn net_drift() -> Outcome<String> {
    let plugins = Plugins::new()?;
    let table_of = PluginTable::parse(&plugins, Kind::Net, Path::new("extremes.toml"), "type = \"gru\"")?;
    let (inputs, outputs) = (80, 300);
    let net = table_of.net(inputs, outputs)?;
    let mut parameters = net.initialise(1)?;
    // The head of a fresh net is zero: one that says something.
    parameters.iter_mut().enumerate().for_each(|(i, p)| {
        if *p == 0.0 {
            *p = 0.05 * (1.3 * i as f64).sin();
        }
    });
    let single: Vec<f32> = parameters.iter().map(|p| *p as f32).collect();
    // From the same values, so that only the evaluation differs.
    let double: Vec<f64> = single.iter().map(|p| f64::from(*p)).collect();
    let steps = 250;
    let manifest = net.manifest();
    let (mut state32, mut state64) = (vec![0.0f32; manifest.state], vec![0.0f64; manifest.state]);
    let mut rows = Vec::new();
    for second in 1..=400usize {
        let features: Vec<f32> = (0..steps * inputs)
            .map(|i| {
                let (t, j) = ((i / inputs + steps * (second - 1)) as f32 / 30.0, (i % inputs) as f32);
                (t * (0.5 + 0.07 * j) + j).sin()
            })
            .collect();
        let wide: Vec<f64> = features.iter().map(|f| f64::from(*f)).collect();
        let (mut out32, mut out64) = (vec![0.0f32; steps * outputs], vec![0.0f64; steps * outputs]);
        let (before32, before64) = (state32.clone(), state64.clone());
        let mut block = ForwardBlock {
            steps,
            batch: 1,
            parameters: In::from(&single[..]),
            features: In::from(&features[..]),
            state_before: In::from(&before32[..]),
            output: Out::from(&mut out32[..]),
            state_after: Out::from(&mut state32[..]),
            tape: Out::absent(),
        };
        net.forward(ForwardCall::F32(&mut block))?;
        let mut block = ForwardBlock {
            steps,
            batch: 1,
            parameters: In::from(&double[..]),
            features: In::from(&wide[..]),
            state_before: In::from(&before64[..]),
            output: Out::from(&mut out64[..]),
            state_after: Out::from(&mut state64[..]),
            tape: Out::absent(),
        };
        net.forward(ForwardCall::F64(&mut block))?;
        if [1, 4, 20, 100, 400].contains(&second) {
            let last = (steps - 1) * outputs;
            let off =
                out32[last..].iter().zip(&out64[last..]).map(|(a, b)| (f64::from(*a) - b).abs()).fold(0.0, f64::max);
            let peak = out64[last..].iter().map(|v| v.abs()).fold(0.0, f64::max);
            rows.push(vec![(second * steps).to_string(), number(off / peak)]);
        }
    }
    Ok(format!(
        "The paper's net, whose memory goes through the whole clip, in f32 against f64: the largest error of an output over the largest \
         output. It forgets its own rounding, and does not grow.\n{}",
        table(&["frames", "error"], &rows)
    ))
}
