//! Posing as the equations say, dense and slow: what the layouts of files are checked against.

use crate::smplx::generated::{ModelFile, Npy};
use caphy_core::Vec3;
use caphy_core::body::BodyParameters;
use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3};

/// The values of an array of any of the types that [`Npy`] makes.
pub(crate) fn values(npy: &Npy) -> Vec<f64> {
    fn read<const N: usize>(data: &[u8], f: impl Fn([u8; N]) -> f64) -> Vec<f64> {
        data.as_chunks::<N>().0.iter().map(|b| f(*b)).collect()
    }
    match npy.descr {
        "<f4" => read(&npy.data, |b| f64::from(f32::from_le_bytes(b))),
        "<f8" => read(&npy.data, f64::from_le_bytes),
        "<i4" => read(&npy.data, |b| f64::from(i32::from_le_bytes(b))),
        "<i8" => read(&npy.data, |b| i64::from_le_bytes(b) as f64),
        "<u4" => read(&npy.data, |b| f64::from(u32::from_le_bytes(b))),
        "<u2" => read(&npy.data, |b| f64::from(u16::from_le_bytes(b))),
        "<u8" => read(&npy.data, |b| u64::from_le_bytes(b) as f64),
        other => panic!("{other}"),
    }
}

/// Vertices and joints [m] of Eq. 1; `shape_columns` of the directions are shape.
pub(crate) fn pose(file: &ModelFile, shape_columns: usize, p: &BodyParameters) -> (Vec<Vec3>, Vec<Vec3>) {
    let array = |name: &str| values(&file.arrays[name]);
    let template = array("v_template");
    let (n, joints) = (template.len() / 3, file.arrays["weights"].shape[1]);
    let parents = array("kintree_table");
    let (directions, columns) = (array("shapedirs"), file.arrays["shapedirs"].shape[2]);
    let mut rest = template;
    for (i, x) in rest.iter_mut().enumerate() {
        for (k, c) in p.shape.iter().enumerate() {
            *x += c * directions[i * columns + k];
        }
        for (k, c) in p.expression.iter().enumerate() {
            *x += c * directions[i * columns + shape_columns + k];
        }
    }
    let at = |field: &[f64], v: usize| Vec3::new(field[3 * v], field[3 * v + 1], field[3 * v + 2]);
    let regressor = array("J_regressor");
    let centres: Vec<Vec3> = (0..joints).map(|j| (0..n).map(|v| at(&rest, v) * regressor[j * n + v]).sum()).collect();
    let local: Vec<Matrix3<f64>> = p.rotations.iter().map(|r| Rotation3::new(*r).into_inner()).collect();
    if let Some(correctives) = file.arrays.get("posedirs").map(values) {
        let features: Vec<f64> = local[1..]
            .iter()
            .flat_map(|r| (0..9).map(|k| r[(k / 3, k % 3)] - f64::from(u8::from(k / 3 == k % 3))))
            .collect();
        for (x, row) in rest.iter_mut().zip(correctives.chunks_exact(features.len().max(1))) {
            *x += row.iter().zip(&features).map(|(d, f)| d * f).sum::<f64>();
        }
    }
    // G_j takes the rest position of what hangs on joint j to the world.
    let mut world: Vec<Isometry3<f64>> = Vec::new();
    for j in 0..joints {
        let turn = Isometry3::from_parts(Translation3::from(centres[j]), Rotation3::new(p.rotations[j]).into())
            * Translation3::from(-centres[j]);
        world.push(if j == 0 { turn } else { world[parents[j] as usize] * turn });
    }
    let weights = array("weights");
    let vertices = (0..n)
        .map(|v| {
            let x = at(&rest, v) + p.displacement.get(v).copied().unwrap_or_default();
            let sum: Vec3 =
                (0..joints).map(|j| (world[j] * nalgebra::Point3::from(x)).coords * weights[v * joints + j]).sum();
            sum + p.translation
        })
        .collect();
    let posed =
        centres.iter().zip(&world).map(|(c, g)| (g * nalgebra::Point3::from(*c)).coords + p.translation).collect();
    (vertices, posed)
}
