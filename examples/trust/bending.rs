//! A strip that sticks out: the solver against the heavy elastica, and what Eq. 7's k is on different meshes.

use crate::{Section, table};
use caphy_core::Vec3;
use caphy_core::material::{MaterialModel, MaterialSpec};
use caphy_garment::estimate::cloth;
use caphy_garment::solver::{Forces, Scene, Solver, SolverSettings};
use caphy_materials::MaterialStvkSpec;
use std::sync::Arc;

/// Free length and width of the strip [m], its density [kg/m²], its k [N m].
const LENGTH: f64 = 0.1;
const WIDTH: f64 = 0.05;
const DENSITY: f64 = 0.2;
const K: f64 = 2e-3;
/// Steps along the elastica.
const STEPS: usize = 2000;

/// Tip's fall over the length of an inextensible strip of rigidity D [N m] under its weight, clamped level: D θ'' = −w (L − s) cos θ,
/// θ(0) = 0, θ'(L) = 0, by shooting on θ'(0).
fn elastica(rigidity: f64) -> f64 {
    let weight = DENSITY * 9.81;
    let h = LENGTH / STEPS as f64;
    let shoot = |slope: f64| -> (f64, f64) {
        let (mut angle, mut rate, mut fall) = (0.0f64, slope, 0.0);
        for i in 0..STEPS {
            let bend = |s: f64, angle: f64| -weight * (LENGTH - s) * angle.cos() / rigidity;
            let s = i as f64 * h;
            // Midpoint rule: second order, errors of 1e-6 here.
            let (a, r) = (angle + 0.5 * h * rate, rate + 0.5 * h * bend(s, angle));
            fall += h * a.sin();
            angle += h * r;
            rate += h * bend(s + 0.5 * h, a);
        }
        (rate, fall)
    };
    // Falling is positive: the rate starts positive and ends at zero.
    let (mut low, mut high) = (-2.0 * weight * LENGTH * LENGTH / rigidity, 0.0);
    for _ in 0..80 {
        let middle = 0.5 * (low + high);
        if shoot(-middle).0 > 0.0 { low = middle } else { high = middle }
    }
    shoot(-0.5 * (low + high)).1 / LENGTH
}

/// Rigidity whose elastica falls as far.
fn rigidity_of(fall: f64) -> f64 {
    let (mut low, mut high) = (1e-7f64, 1e-1f64);
    for _ in 0..80 {
        let middle = (low * high).sqrt();
        if elastica(middle) > fall { low = middle } else { high = middle }
    }
    (low * high).sqrt()
}

/// Tip's fall over the length, by the solver.
fn simulated(edge: f64) -> Result<f64, Box<dyn std::error::Error>> {
    // Stiff against stretch, without Poisson coupling: nothing but bending shows.
    let text = format!("lambda_n_per_m = 0.0\nmu_n_per_m = 500.0\nbending_nm = {K}\ndensity_kg_per_m2 = {DENSITY}\n");
    let material: Arc<dyn MaterialModel> = Arc::from(toml::from_str::<MaterialStvkSpec>(&text)?.build()?);
    let clamp = 2.0 * edge;
    let (columns, rows) = (((LENGTH + clamp) / edge).round() as usize, (WIDTH / edge).round().max(1.0) as usize);
    let rest = cloth::sheet(columns, rows, [LENGTH + clamp, WIDTH], DENSITY)?;
    let flat = &rest.template.vertices;
    let start: Vec<Vec3> = flat.iter().map(|p| Vec3::new(p.x, 0.0, -p.y)).collect();
    let fixed: Vec<u32> = (0..flat.len() as u32).filter(|&v| flat[v as usize].x <= clamp + 1e-9).collect();
    let settings = SolverSettings { tolerance_n: 1e-10, ..Default::default() };
    let mut solver = Solver::new(&rest, material, Forces::default(), settings)?;
    let solution = solver.solve(&Scene { fixed: &fixed, ..Default::default() }, &start, &|_| {})?;
    let tip: Vec<f64> =
        (0..flat.len()).filter(|&v| flat[v].x >= LENGTH + clamp - 1e-9).map(|v| -solution.positions[v].y).collect();
    Ok(tip.iter().sum::<f64>() / tip.len() as f64 / LENGTH)
}

pub(crate) fn section() -> Section {
    let mut rows = Vec::new();
    for edge in [0.02, 0.0125, 0.01, 0.005, 0.0025] {
        let fall = simulated(edge)?;
        let rigidity = rigidity_of(fall);
        rows.push(vec![
            format!("{}", 1e3 * edge),
            format!("{fall:.4}"),
            format!("{:.3e}", rigidity),
            format!("{:.3}", rigidity / K),
        ]);
    }
    Ok(format!(
        "A strip of {} by {} mm sticks out level and bends under its weight; k = {K} N m in Eq. 7. The rigidity is that of the heavy \
         elastica with the same fall of the tip: a fraction of k that depends on the triangles. A k is no plate rigidity.\n{}",
        1e3 * LENGTH,
        1e3 * WIDTH,
        table(&["edges, mm", "fall of the tip over the length", "rigidity of the elastica, N m", "over k"], &rows)
    ))
}
