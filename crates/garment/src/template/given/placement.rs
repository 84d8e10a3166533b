//! Whether a given garment lies on the body, and what it looks like when it does not: other units, another axis up, another
//! origin.

use crate::template::Tailor;
use caphy_core::query::NearestGrid;
use caphy_core::{Error, Result, TriMesh, Vec3};

/// Half of a worn garment's vertices are nearer to the skin than this [m]: the widest skirts and hanging sleeves are.
const NEAR: f64 = 0.15;
/// A guess about the units must bring the garment this near to be spoken of [m].
const CONVINCING: f64 = 0.06;
/// Nor is a garment smaller than this [m]: shrunk into the body, anything is near its skin.
const SMALLEST: f64 = 0.25;
/// Vertices that are looked at.
const SAMPLES: usize = 1500;

/// What a file's numbers might mean.
const UNITS: [(f64, &str); 7] = [
    (0.001, "millimetres"),
    (0.01, "centimetres"),
    (0.0254, "inches"),
    (0.1, "decimetres"),
    (10.0, "tens of metres"),
    (100.0, "hundreds of metres"),
    (1000.0, "kilometres"),
];

/// Median distance to the body's vertices [m].
fn median_distance(points: &[Vec3], skin: &NearestGrid<f64>) -> f64 {
    let mut all: Vec<f64> =
        points.iter().map(|p| skin.nearest_point(p).map_or(f64::INFINITY, |(_, d2)| d2.sqrt())).collect();
    all.sort_by(f64::total_cmp);
    all.get(all.len() / 2).copied().unwrap_or(f64::INFINITY)
}

/// Refuses a garment that does not lie on the body, with the reason where it shows.
///
/// # Errors
/// [`Error::Mesh`] with the distance found and what would bring the garment onto the body.
pub(super) fn check_placement(name: &str, mesh: &TriMesh, tailor: &Tailor) -> Result<()> {
    let skin = &tailor.reach[0].1;
    let step = mesh.vertices.len().div_ceil(SAMPLES).max(1);
    let points: Vec<Vec3> = mesh.vertices.iter().step_by(step).copied().collect();
    let found = median_distance(&points, skin);
    if found <= NEAR {
        return Ok(());
    }
    let upright = |p: &Vec3| Vec3::new(p.x, p.z, -p.y);
    let guess = |place: &dyn Fn(&Vec3) -> Vec3, what: String, remedy: String| {
        let moved: Vec<Vec3> = points.iter().map(place).collect();
        let (low, high) = caphy_core::mesh::bounds(&moved)?;
        if (high - low).max() < SMALLEST {
            return None;
        }
        let d = median_distance(&moved, skin);
        (d < CONVINCING).then_some((d, what, remedy))
    };
    let mut guesses = vec![guess(&upright, "with z up".into(), "export it with y up".into())];
    for (scale, unit) in UNITS {
        let remedy = format!("set `metres_per_unit = {scale}`");
        guesses.push(guess(&|p| p * scale, format!("in {unit}"), remedy.clone()));
        let both = format!("{remedy} and export it with y up");
        guesses.push(guess(&|p| upright(p) * scale, format!("in {unit} with z up"), both));
    }
    let (low, high) = mesh.bounds().unwrap_or((Vec3::zeros(), Vec3::zeros()));
    let (body_low, body_high) = tailor.body.mesh.bounds().unwrap_or((Vec3::zeros(), Vec3::zeros()));
    let (size, body_size) = (high - low, body_high - body_low);
    // Of the right size, but elsewhere: with its origin at the floor instead of the pelvis, perhaps.
    if guesses.iter().all(Option::is_none) && size.max() < 1.2 * body_size.max() {
        let room = body_size.y - size.y;
        for k in 0..=24 {
            let shift = body_low.y + room * f64::from(k) / 24.0 - low.y;
            let what = format!("moved by {shift:.2} m along y");
            let remedy =
                format!("set `translation_m = [0.0, {shift:.2}, 0.0]`, or better export it on the T-posed body");
            guesses.push(guess(&|p| p + Vec3::y() * shift, what, remedy));
        }
    }
    let best = guesses.into_iter().flatten().min_by(|a, b| a.0.total_cmp(&b.0));
    let sizes = format!(
        "it measures {:.3} × {:.3} × {:.3} around ({:.3}, {:.3}, {:.3}), the body {:.3} × {:.3} × {:.3} m around ({:.3}, {:.3}, {:.3})",
        size.x,
        size.y,
        size.z,
        0.5 * (low.x + high.x),
        0.5 * (low.y + high.y),
        0.5 * (low.z + high.z),
        body_size.x,
        body_size.y,
        body_size.z,
        0.5 * (body_low.x + body_high.x),
        0.5 * (body_low.y + body_high.y),
        0.5 * (body_low.z + body_high.z),
    );
    let problem = format!("covers nothing: half of its vertices are farther than {found:.3} m from the body; {sizes}");
    let remedy = match best {
        Some((d, what, remedy)) => format!("read {what} it would lie on it ({:.0} mm): {remedy}", d * 1e3),
        None => "place it on the T-posed body, in metres, y up, facing +z".into(),
    };
    Err(Error::mesh(name, "whole mesh", problem, remedy))
}
