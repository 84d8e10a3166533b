//! What a material answers to given deformation gradients and folds, through the garment's own energies.

use caphy_core::extension::{Hinge, MaterialModelExt};
use caphy_core::lanes::Frames;
use caphy_core::material::{HingeLength, MaterialModel};
use caphy_core::{Error, Result, Vec3};
use caphy_garment::RestHinge;
use caphy_garment::energy::{Bending, EnergyTerm, RestAngle, State};
use caphy_garment::garment::dihedral_angle;
use nalgebra::Matrix3x2;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use std::path::Path;
use std::sync::Arc;

/// A 3×2 deformation gradient, row-major: three rows of two numbers, or the six numbers in a row.
#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(untagged)]
enum Gradient {
    Rows([[f64; 2]; 3]),
    Flat([f64; 6]),
}

/// A hinge to probe, as in `--hinges`.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HingeCase {
    /// Material coordinates of (n0, n1, opposite corner) in the face (n0, n1, n2) [m].
    pub u_side0: [[f64; 2]; 3],
    /// The same in the face (n1, n0, n3); differs on a seam.
    pub u_side1: [[f64; 2]; 3],
    /// World positions of n0, n1, n2, n3 [m].
    pub x: [[f64; 3]; 4],
    /// Rest dihedral angle [rad]. Default 0: flat.
    #[serde(default)]
    pub theta_rest: f64,
}

/// The answer to one deformation gradient, per rest area.
#[derive(Debug, Clone, Serialize)]
pub struct MembraneProbe {
    /// Green strain (Guu, Gvv, Guv) of Eq. 4.
    pub green: [f64; 3],
    /// k0..k3 [N/m], where the model has four constants.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub stiffness: Option<[f64; 4]>,
    /// ψ [J/m²].
    pub energy: f64,
    /// Second Piola-Kirchhoff stress (Suu, Svv, Suv) [N/m].
    pub second_pk: [f64; 3],
    /// First Piola-Kirchhoff stress F S [N/m].
    pub first_pk: [[f64; 2]; 3],
}

/// The answer to one hinge.
#[derive(Debug, Clone, Serialize)]
pub struct HingeProbe {
    /// Dihedral angle [rad], positive when the faces fold toward their normal side.
    pub theta: f64,
    /// k of Eq. 7 [N·m].
    pub stiffness: f64,
    /// Energy of Eq. 7 [J].
    pub energy: f64,
    /// Force on n0..n3 [N].
    pub force: [[f64; 3]; 4],
}

/// Entries of a JSON array, each read by itself, so that a mistake names its entry.
fn entries<T: DeserializeOwned>(path: &Path, text: &[u8], expected: &str) -> Result<Vec<T>> {
    let wrong = |at: String, problem: String| Error::format(path, at, problem, format!("give an array of {expected}"));
    let list: Vec<serde_json::Value> = serde_json::from_slice(text).map_err(|e| wrong("JSON".into(), e.to_string()))?;
    let read = |(i, value)| serde_json::from_value(value).map_err(|e| wrong(format!("entry {i}"), e.to_string()));
    list.into_iter().enumerate().map(read).collect()
}

/// An error about entry `i` of a file.
fn placed(path: &Path, i: usize, error: &Error) -> Error {
    Error::format(path, format!("entry {i}"), error.to_string(), "correct the entry")
}

/// Answers a JSON array of deformation gradients; `path` is for messages.
///
/// # Errors
/// [`Error::Format`] naming the entry that is not 3×2 or whose strain is not finite.
pub fn gradients(material: &dyn MaterialModel, path: &Path, text: &[u8]) -> Result<Vec<MembraneProbe>> {
    let list: Vec<Gradient> = entries(path, text, "3x2 deformation gradients: [[Fxu, Fxv], [Fyu, Fyv], [Fzu, Fzv]]")?;
    let probe = |(i, gradient): (usize, &Gradient)| {
        let f = match gradient {
            Gradient::Rows(rows) => Matrix3x2::from_row_slice(rows.as_flattened()),
            Gradient::Flat(flat) => Matrix3x2::from_row_slice(flat),
        };
        membrane(material, &f).map_err(|e| placed(path, i, &e))
    };
    list.iter().enumerate().map(probe).collect()
}

fn membrane(material: &dyn MaterialModel, f: &Matrix3x2<f64>) -> Result<MembraneProbe> {
    let c = f.transpose() * f;
    let green = [0.5 * (c[(0, 0)] - 1.0), 0.5 * (c[(1, 1)] - 1.0), 0.5 * c[(0, 1)]];
    let answer = material.at(green)?;
    let [suu, svv, suv] = answer.stress;
    let p = f * nalgebra::Matrix2::new(suu, suv, suv, svv);
    Ok(MembraneProbe {
        green,
        stiffness: answer.stiffness,
        energy: answer.energy,
        second_pk: answer.stress,
        first_pk: std::array::from_fn(|r| [p[(r, 0)], p[(r, 1)]]),
    })
}

/// Answers a JSON array of [`HingeCase`]; `path` is for messages.
///
/// Energy and force are those of the garment's bending term in double precision: with frozen stiffness, k is held.
///
/// # Errors
/// [`Error::Format`] naming the entry that lacks a key, has no area, or is not finite.
pub fn hinges(material: &Arc<dyn MaterialModel>, path: &Path, text: &[u8]) -> Result<Vec<HingeProbe>> {
    let list: Vec<HingeCase> = entries(path, text, "objects with u_side0, u_side1, x and theta_rest")?;
    list.iter().enumerate().map(|(i, case)| hinge(material, case).map_err(|e| placed(path, i, &e))).collect()
}

fn area(u: &[[f64; 2]; 3]) -> f64 {
    let (a, b) = ([u[1][0] - u[0][0], u[1][1] - u[0][1]], [u[2][0] - u[0][0], u[2][1] - u[0][1]]);
    0.5 * (a[0] * b[1] - a[1] * b[0]).abs()
}

fn hinge(material: &Arc<dyn MaterialModel>, case: &HingeCase) -> Result<HingeProbe> {
    for (name, values) in [
        ("u_side0", case.u_side0.as_flattened()),
        ("u_side1", case.u_side1.as_flattened()),
        ("x", case.x.as_flattened()),
        ("theta_rest", &[case.theta_rest][..]),
    ] {
        Error::check_finite(name, values)?;
    }
    for (name, u) in [("u_side0", &case.u_side0), ("u_side1", &case.u_side1)] {
        if area(u) == 0.0 {
            return Err(Error::config(name, "the face has no area", "give three corners that are not on one line"));
        }
    }
    let edge = |u: &[[f64; 2]; 3]| [u[1][0] - u[0][0], u[1][1] - u[0][1]];
    let (direction0, direction1) = (edge(&case.u_side0), edge(&case.u_side1));
    let rest = RestHinge {
        vertices: [0, 1, 2, 3],
        faces: [0, 1],
        angle: case.theta_rest,
        // On a seam the mean of both sides (ARCSim).
        length: 0.5 * (direction0[0].hypot(direction0[1]) + direction1[0].hypot(direction1[1])),
        area: area(&case.u_side0) + area(&case.u_side1),
        direction0,
        direction1,
    };
    let x = case.x.map(Vec3::from);
    let theta = dihedral_angle(&x);
    let length = match material.describe().hinge_length {
        HingeLength::Rest => rest.length,
        HingeLength::Current | HingeLength::CurrentHeld => (x[1] - x[0]).norm(),
    };
    let directions = [direction0, direction1];
    let state = Hinge { angle: theta, angle_rest: rest.angle, length, area: rest.area, directions };
    let stiffness = material.bending_stiffness(&state)?;

    let term = Bending::<f64>::of_hinges(&[rest], 4, Arc::clone(material), RestAngle::Template);
    let mut positions = Frames::zeros(1, 4, 1);
    positions.set_frame(0, 0, &x)?;
    let (mut energy, mut gradient) = ([0.0], Frames::zeros(1, 4, 1));
    term.add(&State::new(&positions), 1.0, &mut energy, Some(&mut gradient))?;
    let force = std::array::from_fn(|v| (-gradient.get(0, 0, v)).into());
    Ok(HingeProbe { theta, stiffness, energy: energy[0], force })
}

#[cfg(test)]
mod tests {
    use super::*;
    use caphy_materials::MaterialStvk;

    #[test]
    fn a_mistake_names_its_entry() {
        let snug = MaterialStvk::snug().expect("valid constants");
        let says = |text: &str| gradients(&snug, Path::new("f.json"), text.as_bytes()).unwrap_err().to_string();
        for (text, words) in [
            ("[[[1,0],[0,1],[0,0]], [[1,0],[0,1]]]", "entry 1"),
            ("{}", "expected a sequence"),
            ("[[1e200,0,0,1,0,0]]", "not finite"),
            ("[[1e999,0,0,1,0,0]]", "number out of range"),
            ("[", "EOF"),
        ] {
            let said = says(text);
            assert!(
                said.contains(words) && said.contains("f.json") && said.contains("3x2") | said.contains("entry"),
                "{said}"
            );
        }
        let flat = gradients(&snug, Path::new("f.json"), b"[[1.1,0,0,1,0,0], [[1.1,0],[0,1],[0,0]]]").expect("answers");
        assert_eq!(flat[0].first_pk, flat[1].first_pk);
        assert!((flat[0].green[0] - 0.105).abs() < 1e-15);

        let snug: Arc<dyn MaterialModel> = Arc::new(snug);
        let says = |text: &str| hinges(&snug, Path::new("h.json"), text.as_bytes()).unwrap_err().to_string();
        let case = |last: &str| {
            format!(
                r#"[{{"u_side0":[[0,0],[1,0],[0,{last}]],"u_side1":[[0,0],[1,0],[0,-1]],"x":[[0,0,0],[1,0,0],[0,1,0],[0,-1,0]]}}]"#
            )
        };
        assert!(hinges(&snug, Path::new("h.json"), case("1").as_bytes()).is_ok());
        assert!(says(&case("0")).contains("u_side0"));
        assert!(says(&case("1").replace("u_side1", "u_side2")).contains("u_side2"));
        assert!(
            says(&case("1").replace(r#","x":[[0,0,0],[1,0,0],[0,1,0],[0,-1,0]]"#, "")).contains("missing field `x`")
        );
    }
}
