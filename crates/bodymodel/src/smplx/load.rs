//! SMPL-X `.npz` files: version 1.1 (300 + 100 directions) and the older layout (10 + 10).

use super::{BodySmplx, SmplxArrays};
use caphy_core::body::{BlendWeights, Joint};
use caphy_core::pose::SMPLX_JOINTS;
use caphy_core::{Error, Result, Vec3};
use caphy_formats::npz::{Array, Npz};
use std::path::Path;

/// How much of a file to keep.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SmplxOptions {
    /// Largest number of shape coefficients to keep; files have 10 or 300.
    pub shape_coefficients: usize,
    /// Largest number of expression coefficients to keep; files have 10 or 100.
    pub expression_coefficients: usize,
}

impl Default for SmplxOptions {
    fn default() -> Self {
        // Scans of clothed people determine about ten coefficients; more only cost memory.
        Self { shape_coefficients: 10, expression_coefficients: 10 }
    }
}

/// Columns of `shapedirs` in version 1.1: shape, then expression.
const COLUMNS_V11: (usize, usize) = (300, 100);
/// Likewise in the older layout.
const COLUMNS_OLD: usize = 10;
/// Skinning weights below this are export noise: a metre away they move a vertex by a nanometre.
const WEIGHT_NOISE: f64 = 1e-9;

/// Reads a body in the SMPL-X layout; `path` serves messages and the body's name.
///
/// # Errors
/// [`Error::Format`] that names the array for missing arrays, wrong shapes and bad values; pickles (`.pkl`) are refused
/// with the line that converts them.
pub fn load(path: &Path, bytes: Vec<u8>, options: &SmplxOptions) -> Result<BodySmplx> {
    let npz = Npz::from_bytes(path, bytes)?;
    let stem = path.file_stem().map_or_else(String::new, |s| format!(" {}", s.to_string_lossy()));
    let file = File { npz: &npz, path };

    let template = file.f64s("v_template", &[None, Some(3)])?;
    let n = template.shape[0];
    let points = |flat: &[f64]| -> Vec<Vec3> { flat.chunks_exact(3).map(Vec3::from_column_slice).collect() };
    let faces = file.faces(n)?;
    let joints = file.joints()?;
    let joint_count = joints.len();

    // A direction is a column; directions beyond the limits are never copied out.
    let directions = file.f64s("shapedirs", &[Some(n), Some(3), None])?;
    let columns = directions.shape[2];
    let (shape_columns, expression_columns) = if columns >= COLUMNS_V11.0 + COLUMNS_V11.1 {
        COLUMNS_V11
    } else {
        (columns.min(COLUMNS_OLD), columns.saturating_sub(COLUMNS_OLD).min(COLUMNS_OLD))
    };
    let column = |k: usize| -> Vec<Vec3> {
        (0..n).map(|v| Vec3::from_fn(|axis, _| directions.data[(3 * v + axis) * columns + k])).collect()
    };
    let shape_directions = (0..shape_columns.min(options.shape_coefficients)).map(column).collect();
    let expression_directions =
        (0..expression_columns.min(options.expression_coefficients)).map(|k| column(shape_columns + k)).collect();
    drop(directions);

    let pose_directions = if npz.has("posedirs") {
        let array = npz.f32s("posedirs")?;
        file.check_shape("posedirs", &array.shape, &[Some(n), Some(3), Some(9 * (joint_count - 1))])?;
        array.data
    } else {
        Vec::new()
    };
    let regressor = file.f64s("J_regressor", &[Some(joint_count), Some(n)])?;
    let joint_regressor = regressor.data.chunks_exact(n).map(|row| sparse(row, 0.0)).collect();
    let weights = file.f64s("weights", &[Some(n), Some(joint_count)])?;
    let weights = BlendWeights::from_rows(weights.data.chunks_exact(joint_count).map(|row| {
        let kept = sparse(row, WEIGHT_NOISE);
        let (all, sum) = (row.iter().sum::<f64>(), kept.iter().map(|(_, w)| w).sum::<f64>());
        let scale = if sum > 0.0 { all / sum } else { 1.0 };
        kept.into_iter().map(|(j, w)| (j as u16, w * scale)).collect()
    }));

    BodySmplx::new(SmplxArrays {
        name: format!("smplx{stem}"),
        template: points(&template.data),
        faces,
        shape_directions,
        expression_directions,
        pose_directions,
        joint_regressor,
        weights,
        joints,
    })
}

/// Entries whose size is above a threshold, NaN included so that checks see it.
fn sparse(row: &[f64], threshold: f64) -> Vec<(u32, f64)> {
    row.iter().enumerate().filter(|(_, w)| w.is_nan() || w.abs() > threshold).map(|(i, w)| (i as u32, *w)).collect()
}

struct File<'a> {
    npz: &'a Npz,
    path: &'a Path,
}

impl File<'_> {
    fn error(&self, name: &str, problem: String, remedy: &str) -> Error {
        Error::format(self.path, format!("array `{name}`"), problem, remedy)
    }
    /// `None` stands for any length of at least one.
    fn check_shape(&self, name: &str, shape: &[usize], wanted: &[Option<usize>]) -> Result<()> {
        let fits = shape.len() == wanted.len()
            && shape.iter().zip(wanted).all(|(got, want)| want.map_or(*got > 0, |want| want == *got));
        if fits {
            return Ok(());
        }
        let wanted: Vec<String> = wanted.iter().map(|w| w.map_or_else(|| "any".into(), |w| w.to_string())).collect();
        Err(self.error(
            name,
            format!("has shape {shape:?}, wanted [{}]", wanted.join(", ")),
            "give a model file in the SMPL-X layout",
        ))
    }
    fn f64s(&self, name: &str, wanted: &[Option<usize>]) -> Result<Array<f64>> {
        let array = self.npz.f64s(name)?;
        self.check_shape(name, &array.shape, wanted)?;
        Error::check_finite(&format!("{}, array `{name}`", self.path.display()), &array.data)?;
        Ok(array)
    }
    fn faces(&self, vertex_count: usize) -> Result<Vec<[u32; 3]>> {
        let array = self.npz.i64s("f")?;
        self.check_shape("f", &array.shape, &[None, Some(3)])?;
        if let Some(i) = array.data.iter().position(|&id| id < 0 || id >= vertex_count as i64) {
            return Err(self.error(
                "f",
                format!("face {} names vertex {}, there are {vertex_count}", i / 3, array.data[i]),
                "the file is damaged: get it again",
            ));
        }
        Ok(array.data.as_chunks::<3>().0.iter().map(|f| f.map(|id| id as u32)).collect())
    }
    /// The joint tree; the root's parent is -1, stored in any integer width and sign.
    fn joints(&self) -> Result<Vec<Joint>> {
        let name = "kintree_table";
        let array = self.npz.i64s(name)?;
        self.check_shape(name, &array.shape, &[Some(2), None])?;
        let count = array.shape[1];
        let mut joints = Vec::with_capacity(count);
        for (j, &parent) in array.data[..count].iter().enumerate() {
            let parent = match usize::try_from(parent) {
                _ if j == 0 => None,
                Ok(p) if p < j => Some(p),
                _ => {
                    return Err(self.error(
                        name,
                        format!("joint {j} has parent {parent}"),
                        "parents come before their children: give a model file in the SMPL-X layout",
                    ));
                }
            };
            let joint_name = SMPLX_JOINTS.get(j).map_or_else(|| format!("joint{j}"), |n| (*n).into());
            joints.push(Joint { name: joint_name, parent });
        }
        Ok(joints)
    }
}
