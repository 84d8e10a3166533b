//! Cusick's drape test, simulated with each of the ten fabrics.

use crate::study::fabric;
use crate::{Figures, Section, table};
use caphy::pictures;
use caphy_core::{TriMesh, Vec3, mesh};
use caphy_garment::estimate::cloth;
use caphy_garment::solver::{Forces, Obstacle, Scene, Solver, SolverSettings};
use caphy_render::{Layer, Picture, Projection, frame};
use rayon::prelude::*;

/// Radii of specimen and table, edges of the cloth, spacing of the table's points [m].
const SPECIMEN: f64 = 0.15;
const TABLE: f64 = 0.09;
const EDGE: f64 = 0.012;
const SPACING: f64 = 3e-3;

fn draped(name: &str) -> caphy_core::Result<(Vec<Vec3>, Vec<[u32; 3]>, f64)> {
    let material = fabric(name);
    let density = material.describe().density.map_or(0.2, |d| d.0);
    let rest = cloth::disc(SPECIMEN, EDGE, density)?;
    let flat = &rest.template.vertices;
    let lay = |p: &Vec3| {
        let wave = 1e-3 * (p.norm() / SPECIMEN).powi(4) * (5.0 * p.y.atan2(p.x)).sin();
        Vec3::new(p.x, 1.5e-3 + wave, -p.y)
    };
    let start: Vec<Vec3> = flat.iter().map(lay).collect();
    let fixed: Vec<u32> = (0..flat.len() as u32).filter(|&v| flat[v as usize].norm() <= TABLE + 1e-9).collect();
    let table = cloth::table(TABLE, SPACING)?;
    let settings = SolverSettings { tolerance_n: 1e-6, ..Default::default() };
    let mut solver = Solver::new(&rest, material, Forces::default(), settings)?;
    let body = Obstacle { positions: &table.positions, normals: &table.normals, before: None, search: None };
    let solution = solver.solve(&Scene { body: Some(body), fixed: &fixed, ..Default::default() }, &start, &|_| {})?;
    let coefficient = cloth::drape_coefficient(&solution.positions, rest.faces(), SPECIMEN, TABLE)?;
    Ok((solution.positions, rest.faces().to_vec(), coefficient))
}

pub(crate) fn section(figures: &Figures) -> Section {
    let names = caphy_materials::measured::Fabric::names()?;
    let all: Vec<_> = names.par_iter().map(|name| draped(name)).collect::<caphy_core::Result<_>>()?;
    let mut cells = Vec::new();
    let mut rows = Vec::new();
    for (name, (shape, faces, coefficient)) in names.iter().zip(&all) {
        rows.push(vec![name.clone(), format!("{coefficient:.2}")]);
        let mesh = TriMesh { vertices: shape.clone(), faces: faces.clone() };
        let bounds = mesh::bounds(shape).unwrap_or_default();
        for from in [Vec3::new(0.4, 0.5, 1.0), Vec3::new(0.0, 1.0, 1e-3)] {
            let camera = frame(bounds, &from, Projection::Orthographic, 220, 220);
            let picture = Picture::new(camera, vec![Layer::uniform(&mesh, [150, 170, 200])]).draw();
            cells.push((name.clone(), picture));
        }
    }
    Ok(format!(
        "A disc of 30 cm between a table and a plate of 18 cm, edges of {} mm. (A_proj − A_plate)/(A_disc − A_plate): 0 hangs straight down, 1 \
         stays flat. Simulated with the published tables, not measured on cloth.\n{}{}",
        1e3 * EDGE,
        table(&["fabric", "drape coefficient, simulated"], &rows),
        figures.write("drapes.png", "Ten fabrics over a table", &pictures::sheet(&cells, 5)?)?
    ))
}
