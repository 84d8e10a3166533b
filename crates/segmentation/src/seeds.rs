//! Colours of a palette from places on a scan that the user points at.

use crate::colour::PaletteEntry;
use caphy_core::files::Files;
use caphy_core::scan::Label;
use caphy_core::{Error, Result, Vec3};
use caphy_formats::scan::read_scan;
use caphy_render::colours::srgb_to_linear;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// A place whose colours have a label.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Seed {
    /// What is there.
    pub label: Label,
    /// The scan's file.
    pub path: PathBuf,
    /// A point on it, in the file's own coordinates, as a mesh viewer shows them.
    pub at: [f64; 3],
    /// How far around the point colours are taken, as a share of the scan's largest extent. Default 0.02: 3.5 cm on an adult.
    #[serde(default = "reach")]
    pub reach: f64,
    /// How many colours are taken there at most: a print has several. Default 2, the lighter and the darker tone of a plain cloth.
    #[serde(default = "tones")]
    pub tones: usize,
}

fn reach() -> f64 {
    0.02
}
fn tones() -> usize {
    2
}

/// Rounds of k-means; colours of a cloth stand still after a few.
const ROUNDS: usize = 12;
/// Vertices near a seed below which its colours say little.
const LEAST: usize = 8;

/// Palette entries of seeds, in their order.
///
/// # Errors
/// [`Error::Config`] for values out of range, a place with fewer than eight vertices near it, a scan without colours; those of
/// [`read_scan`].
pub fn colours_of(seeds: &[Seed], files: &dyn Files) -> Result<Vec<PaletteEntry>> {
    let mut palette = Vec::new();
    let mut last: Option<(PathBuf, caphy_core::scan::Scan)> = None;
    for (i, seed) in seeds.iter().enumerate() {
        let key = format!("segmenter.seeds[{i}]");
        if !(seed.reach > 0.0 && seed.reach <= 0.2) || seed.at.iter().any(|c| !c.is_finite()) {
            let problem = format!("reach is {}, at is {:?}", seed.reach, seed.at);
            return Err(Error::config(key, problem, "give a reach from 0 to 0.2 and a point of the scan"));
        }
        if !(1..=8).contains(&seed.tones) {
            return Err(Error::config(key, format!("tones is {}", seed.tones), "give 1 to 8"));
        }
        if last.as_ref().is_none_or(|(path, _)| *path != seed.path) {
            last = Some((seed.path.clone(), read_scan(&seed.path, files)?.0));
        }
        let Some((_, scan)) = &last else { continue };
        let Some(colours) = &scan.colours else {
            let problem = format!("{} has no colours", seed.path.display());
            return Err(Error::config(key, problem, "point at a scan with vertex colours or a texture"));
        };
        let extent = scan.mesh.bounds().map_or(0.0, |(low, high)| (high - low).max());
        let at = Vec3::from(seed.at);
        let near = |p: &Vec3| (p - at).norm() <= seed.reach * extent;
        let found: Vec<[u8; 3]> =
            scan.mesh.vertices.iter().zip(colours).filter(|(p, _)| near(p)).map(|(_, c)| *c).collect();
        if found.len() < LEAST {
            let nearest = scan.mesh.vertices.iter().map(|p| (p - at).norm()).fold(f64::INFINITY, f64::min);
            let problem = format!("{} vertices lie near {:?}, the nearest {nearest:.4} away", found.len(), seed.at);
            return Err(Error::config(key, problem, "give a point on the surface, in the file's own coordinates"));
        }
        palette.extend(means(&found, seed.tones).into_iter().map(|colour| PaletteEntry { label: seed.label, colour }));
    }
    Ok(palette)
}

/// At most `count` means of colours: k-means from quantiles of lightness, the same for the same colours.
fn means(colours: &[[u8; 3]], count: usize) -> Vec<[u8; 3]> {
    let mut sorted = colours.to_vec();
    let light = |c: &[u8; 3]| -> f32 {
        let [r, g, b] = c.map(srgb_to_linear);
        0.2127 * r + 0.7152 * g + 0.0722 * b
    };
    sorted.sort_by(|a, b| light(a).total_cmp(&light(b)).then(a.cmp(b)));
    let mut centres: Vec<[f64; 3]> =
        (0..count).map(|k| sorted[(2 * k + 1) * sorted.len() / (2 * count)].map(f64::from)).collect();
    for _ in 0..ROUNDS {
        let mut sums = vec![([0.0; 3], 0.0); count];
        for colour in &sorted {
            let c = colour.map(f64::from);
            let distance = |centre: &[f64; 3]| (0..3).map(|k| (centre[k] - c[k]).powi(2)).sum::<f64>();
            let nearest = (0..count).min_by(|&a, &b| distance(&centres[a]).total_cmp(&distance(&centres[b])));
            let (sum, n) = &mut sums[nearest.unwrap_or(0)];
            (0..3).for_each(|k| sum[k] += c[k]);
            *n += 1.0;
        }
        for (centre, (sum, n)) in centres.iter_mut().zip(sums) {
            if n > 0.0 {
                *centre = sum.map(|s| s / n);
            }
        }
    }
    let mut out: Vec<[u8; 3]> = centres.into_iter().map(|c| c.map(|v| v.round() as u8)).collect();
    out.dedup();
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_tones_are_told_apart_and_a_plain_cloth_has_one() {
        let mut colours = vec![[10, 12, 40]; 30];
        colours.extend(vec![[200, 190, 210]; 10]);
        assert_eq!(means(&colours, 2), [[10, 12, 40], [200, 190, 210]]);
        assert_eq!(means(&colours[..30], 3), [[10, 12, 40]]);
    }
}
