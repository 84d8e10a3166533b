//! The ten measured fabrics as a table, as JSON, and as curves.

use crate::artifact::write_atomically;
use crate::plot::{Axes, Curve, escape, lines, standalone};
use caphy_core::extension::{Hinge, MaterialModelExt};
use caphy_core::material::MaterialModel;
use caphy_core::{Error, Result};
use caphy_materials::MaterialMeasuredSpec;
use caphy_materials::measured::{BendEntries, Fabric, StretchEntries, average_lame};
use serde::Serialize;
use std::fmt::Write;
use std::path::{Path, PathBuf};

/// Directions of the stretch curves, from the u axis [degrees]: the directions that were measured.
const STRETCH_ANGLES: [f64; 5] = [0.0, 22.5, 45.0, 67.5, 90.0];
/// Directions of the fold line [degrees].
const FOLD_ANGLES: [f64; 3] = [0.0, 45.0, 90.0];
/// Stretch ratio at the end of the curves; the measurements end at 7/6.
const LARGEST_STRETCH: f64 = 1.25;
/// Curvature at the end of the curves [1/m]; the measurements end at 20.
const LARGEST_CURVATURE: f64 = 25.0;
/// Points per curve.
const POINTS: usize = 251;

/// What is known of a fabric. SI units.
#[derive(Debug, Clone, Serialize)]
pub struct FabricFacts {
    /// Number in the published list, from 1.
    pub m: usize,
    /// The name that `fabric = "…"` takes.
    pub name: String,
    /// What it is usually made into.
    pub typical_use: String,
    /// Fibres.
    pub composition: String,
    /// Area density [kg/m²].
    pub density_kg_per_m2: f64,
    /// Published stretching table, raw [N/m]: c11, c12, c22, c33 unstretched, then at stretch 7/6 and 0, 22.5, 45, 67.5, 90°.
    pub stretching_n_per_m: StretchEntries,
    /// Published bending table [N·m]: fold line at 0, 45, 90°, curvature 0, 5, 10, 15, 20 1/m.
    pub bending_nm: BendEntries,
    /// Published stretching entries below zero; they are evaluated as max(0, ·) after interpolation.
    pub negative_entries: usize,
    /// k0..k3 of the default material at rest [N/m].
    pub rest_stiffness_n_per_m: [f64; 4],
    /// λ and μ at rest [N/m]: the rotational average, for comparison with isotropic sheets.
    pub rest_lame_n_per_m: [f64; 2],
}

/// A fabric with its default material.
struct Sample {
    facts: FabricFacts,
    material: Box<dyn MaterialModel>,
}

fn samples() -> Result<Vec<Sample>> {
    let sample = |fabric: Fabric| -> Result<Sample> {
        let material: Box<dyn MaterialModel> = Box::new(MaterialMeasuredSpec::new(&fabric.name).build_measured()?);
        let k = material.at([0.0; 3])?.stiffness.ok_or_else(|| Error::unsupported("stiffness", &fabric.name))?;
        let facts = FabricFacts {
            m: fabric.m,
            name: fabric.name,
            typical_use: fabric.typical_use,
            composition: fabric.composition,
            density_kg_per_m2: fabric.density.0,
            stretching_n_per_m: fabric.stretching,
            bending_nm: fabric.bending,
            negative_entries: fabric.stretching.iter().flatten().filter(|c| **c < 0.0).count(),
            rest_stiffness_n_per_m: k,
            rest_lame_n_per_m: average_lame(k),
        };
        Ok(Sample { facts, material })
    };
    Fabric::all()?.into_iter().map(sample).collect()
}

/// All ten, in the order of the published list.
///
/// # Errors
/// Only when the embedded catalogue was damaged before the build.
pub fn facts() -> Result<Vec<FabricFacts>> {
    Ok(samples()?.into_iter().map(|s| s.facts).collect())
}

/// A table for people.
///
/// # Errors
/// As [`facts`].
pub fn table() -> Result<String> {
    let mut out = String::from(
        " m  fabric               g/m²      k0      k1      k2      k3   λ avg   μ avg   bend 0°  45°  90°  typical use\n\
         \x20                             —————————— at rest, N/m ————————————————————  —— µN·m, flat ——\n",
    );
    for f in facts()? {
        let k = f.rest_stiffness_n_per_m;
        let [lambda, mu] = f.rest_lame_n_per_m;
        // Writing to a String cannot fail.
        let _ = writeln!(
            out,
            "{:2}  {:19} {:5.0} {:7.1} {:7.1} {:7.1} {:7.1} {:7.1} {:7.1}  {:7.1} {:5.1} {:5.1}  {}",
            f.m,
            f.name,
            1e3 * f.density_kg_per_m2,
            k[0],
            k[1],
            k[2],
            k[3],
            lambda,
            mu,
            1e6 * f.bending_nm[0][0],
            1e6 * f.bending_nm[1][0],
            1e6 * f.bending_nm[2][0],
            f.typical_use,
        );
    }
    out.push_str(
        "\nk0 acts on u, k2 on v; nobody told us which of the two is warp. λ, μ: rotational average of k0..k3, as an isotropic \
         sheet\nwould have. Measured by Wang et al. 2011, distributed with ARCSim for educational, research and \
         not-for-profit use.\n",
    );
    Ok(out)
}

/// Tension [N/m of width] of a sheet stretched along a direction, sides held: the direction's component of F S.
fn tension(material: &dyn MaterialModel, degrees: f64, stretch: f64) -> Result<f64> {
    let (s, c) = degrees.to_radians().sin_cos();
    let along = 0.5 * (stretch * stretch - 1.0);
    let [suu, svv, suv] = material.at([along * c * c, along * s * s, along * s * c])?.stress;
    Ok(stretch * (suu * c * c + svv * s * s + 2.0 * suv * s * c))
}

/// Bending stiffness [N·m] of a fold along a direction at a curvature θ l/(2A) [1/m].
fn bending(material: &dyn MaterialModel, degrees: f64, curvature: f64) -> Result<f64> {
    let (s, c) = degrees.to_radians().sin_cos();
    // Any small hinge will do: only its curvature is looked up.
    let (length, area) = (1e-2, 1e-4);
    let angle = curvature * 2.0 * area / length;
    material.bending_stiffness(&Hinge { angle, angle_rest: 0.0, length, area, directions: [[c, s]; 2] })
}

fn curves(angles: &[f64], from: f64, to: f64, value: impl Fn(f64, f64) -> Result<f64>) -> Result<Vec<Curve>> {
    let curve = |&angle: &f64| {
        let point = |i| {
            let x = from + (to - from) * i as f64 / (POINTS - 1) as f64;
            Ok((x, value(angle, x)?))
        };
        Ok(Curve { name: format!("{angle}°"), points: (0..POINTS).map(point).collect::<Result<_>>()? })
    };
    angles.iter().map(curve).collect()
}

/// Writes `NAME-stretch.svg`, `NAME-bending.svg` for each fabric and `fabrics.html` with all of them; returns the page's path.
///
/// # Errors
/// [`Error::Io`] for the folder.
pub fn plot(folder: &Path) -> Result<PathBuf> {
    let mut page = String::from(
        "<!doctype html><html lang=\"en\"><meta charset=\"utf-8\"><title>Measured fabrics</title>\
         <style>body{font:15px sans-serif;max-width:1200px;margin:2em auto}img{width:49%}</style>\
         <h1>The ten measured fabrics</h1><p>Tension along a direction against stretch with the sides held, and bending \
         stiffness against curvature for fold lines in three directions, of the default material. Directions are measured \
         from u. The measurements end at stretch 1.167 and curvature 20 1/m.</p>",
    );
    for Sample { facts, material } in samples()? {
        let model = &*material;
        let stretch = lines(
            &Axes { title: &facts.name, x: "stretch ratio", y: "tension [N/m]", log_y: false },
            &curves(&STRETCH_ANGLES, 1.0, LARGEST_STRETCH, |angle, x| tension(model, angle, x))?,
        );
        let bend = lines(
            &Axes { title: &facts.name, x: "curvature [1/m]", y: "bending stiffness [µN·m]", log_y: false },
            &curves(&FOLD_ANGLES, 0.0, LARGEST_CURVATURE, |angle, x| Ok(1e6 * bending(model, angle, x)?))?,
        );
        let _ = write!(
            page,
            "<h2>{}</h2><p>{}; {}</p>",
            facts.name,
            escape(&facts.composition),
            escape(&facts.typical_use)
        );
        for (kind, svg) in [("stretch", stretch), ("bending", bend)] {
            let name = format!("{}-{kind}.svg", facts.name);
            write_atomically(&folder.join(&name), standalone(&svg).as_bytes())?;
            let _ = write!(page, "<img alt=\"{kind} of {}\" src=\"{name}\">", facts.name);
        }
    }
    let path = folder.join("fabrics.html");
    write_atomically(&path, page.as_bytes())?;
    Ok(path)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn curves_show_the_measured_sheet() {
        let samples = samples().expect("ten fabrics");
        for Sample { facts, material } in &samples {
            let k = facts.rest_stiffness_n_per_m;
            // A small stretch along u and v meets k0 and k2 alone; the table's slope adds less than a tenth.
            for (angle, k) in [(0.0, k[0]), (90.0, k[2])] {
                let slope = tension(&**material, angle, 1.001).expect("a tension") / 1e-3;
                assert!((slope / k - 1.0).abs() < 0.1, "{}: {slope} {k}", facts.name);
            }
            for (row, angle) in FOLD_ANGLES.iter().enumerate() {
                for (column, curvature) in [0.0, 5.0, 10.0, 15.0, 20.0].into_iter().enumerate() {
                    let k = bending(&**material, *angle, curvature).expect("a stiffness");
                    let published = facts.bending_nm[row][column];
                    assert!((k / published - 1.0).abs() < 1e-12, "{}: {k:e} {published:e}", facts.name);
                }
            }
        }
        let navy = &samples[3];
        assert_eq!(navy.facts.name, "navy-sparkle-sweat");
        let pull = |s: f64| tension(&*navy.material, 45.0, s).expect("a tension");
        let falls = |i: u32| pull(1.01 + 0.01 * f64::from(i)) < pull(1.0 + 0.01 * f64::from(i));
        assert!((0..24).any(falls), "tension that is not monotone, as published");
    }

    /// The table that helps to choose a start: its numbers are these, and each fabric is in it.
    #[test]
    fn the_table_by_garment_holds_what_is_measured() {
        let page = include_str!("../../docs/scans.md");
        for f in facts().expect("ten fabrics") {
            let row = page.lines().find(|line| line.contains(&format!("| `{}` |", f.name))).expect("a row per fabric");
            let [k0, _, k2, k3] = f.rest_stiffness_n_per_m;
            let bend: Vec<String> = f.bending_nm.iter().map(|row| format!("{:.0}", 1e6 * row[0])).collect();
            let numbers =
                format!("| {:.0} | {k0:.0}, {k2:.0}, {k3:.0} | {} |", 1e3 * f.density_kg_per_m2, bend.join(", "));
            assert!(row.ends_with(&numbers), "{numbers} in {row}");
        }
    }

    #[test]
    fn plots_are_files_that_stand_alone() {
        let folder = tempfile::tempdir().expect("a folder");
        let page = std::fs::read_to_string(plot(folder.path()).expect("plots")).expect("a page");
        for fabric in facts().expect("ten fabrics") {
            for kind in ["stretch", "bending"] {
                let name = format!("{}-{kind}.svg", fabric.name);
                let svg = std::fs::read_to_string(folder.path().join(&name)).expect("a plot");
                assert!(page.contains(&name) && svg.contains("xmlns") && svg.contains("<style>"), "{name}");
                assert!(!svg.contains("NaN") && !svg.contains("no data"), "{name}");
            }
        }
    }
}
