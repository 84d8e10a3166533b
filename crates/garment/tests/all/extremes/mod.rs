//! Extremes that must be survived, as a table: every state with every shipped fabric, every energy term, in both precisions, and
//! with the solver. Each has a finite answer whose gradient is the energy's, or a typed error that names the place.

mod states;
mod suite;

use caphy_core::material::{MaterialModel, MaterialSpec};
use caphy_core::units::KilogramPerSquareMetre;
use caphy_core::{TriMesh, Vec3};
use caphy_garment::GarmentRest;
use std::sync::Arc;

/// All shipped fabrics and the switches that change what they answer.
pub(crate) fn fabrics() -> Vec<(String, Arc<dyn MaterialModel>)> {
    use caphy_materials as _;
    let measured = caphy_materials::measured::Fabric::all().expect("the catalogue");
    let mut tables: Vec<String> =
        measured.iter().map(|f| format!("type = \"measured\"\nfabric = {:?}", f.name)).collect();
    let gray = |key: &str| format!("type = \"measured\"\nfabric = \"gray-interlock\"\n{key}");
    tables.push(gray("stiffness_gradient = \"full\""));
    tables.push(gray("lookup = \"direct\""));
    tables.push(gray("bending = \"faithful\"\nedge_length = \"current\""));
    for kind in ["stvk", "neo_hookean"] {
        tables.push(constants(kind, 20.9, 11.1, 4e-5, "rest"));
        tables.push(constants(kind, 20.9, 11.1, 4e-5, "current"));
    }
    tables.into_iter().map(|table| (table.replace('\n', ", "), fabric(&table))).collect()
}

/// A table of constants [N/m, N/m, N·m].
pub(crate) fn constants(kind: &str, lambda: f64, mu: f64, bending: f64, length: &str) -> String {
    format!(
        "type = \"{kind}\"\nlambda_n_per_m = {lambda:?}\nmu_n_per_m = {mu:?}\nbending_nm = {bending:?}\nhinge_length = \"{length}\""
    )
}

/// The material of a table.
pub(crate) fn fabric(table: &str) -> Arc<dyn MaterialModel> {
    let spec: Box<dyn MaterialSpec> = toml::from_str(table).expect("a table");
    Arc::from(spec.build().expect("a material"))
}

/// A cloth of 4 × 4 squares of 25 mm, u = x, v = y; the middle is curved a little, so that rest angles are not all 0.
pub(crate) fn cloth() -> GarmentRest {
    let n = 5usize;
    let at = |i: usize, j: usize| {
        let (x, y) = (0.025 * i as f64, 0.025 * j as f64);
        Vec3::new(x, y, 0.2 * x * (0.1 - x))
    };
    let vertices: Vec<Vec3> = (0..n * n).map(|v| at(v % n, v / n)).collect();
    let mut faces = Vec::new();
    for j in 0..n - 1 {
        for i in 0..n - 1 {
            let id = |i: usize, j: usize| (j * n + i) as u32;
            let [a, b, c, d] = [id(i, j), id(i + 1, j), id(i, j + 1), id(i + 1, j + 1)];
            faces.extend(if (i + j) % 2 == 0 { [[a, b, d], [a, d, c]] } else { [[a, b, c], [b, d, c]] });
        }
    }
    let uv = faces.iter().map(|f| f.map(|v| [vertices[v as usize].x, vertices[v as usize].y])).collect();
    let rest = GarmentRest::new("cloth", TriMesh { vertices, faces }, uv, KilogramPerSquareMetre(0.2), "flat");
    rest.expect("a cloth").holding("edge", &[0, 1, 2, 3, 4]).expect("held vertices")
}
