//! From the file to a problem: the cloth, its poses, their scans.

use super::config::{Clamp, ClothConfig, EstimateConfig, PoseConfig, SurroundingsConfig};
use crate::files::ProjectFiles;
use caphy_core::files::Files;
use caphy_core::material::MaterialModel;
use caphy_core::scan::Scan;
use caphy_core::units::KilogramPerSquareMetre;
use caphy_core::{Error, Result, TriMesh, Vec3};
use caphy_garment::GarmentRest;
use caphy_garment::estimate::{Capture, CutPart, Problem, ScanPoints, Surroundings, cloth};
use caphy_garment::solver::Forces;
use std::path::Path;
use std::sync::Arc;

/// Distance of points on tables and balls [m]: their facets stay below 0.1 mm.
const SPACING_M: f64 = 3e-3;
/// Height of a cloth laid over a table [m], within the contact margin.
const LAID_M: f64 = 1.5e-3;
/// Ripple of a cloth laid flat [m]: perfectly flat cloth has no way to choose where to fold.
const RIPPLE_M: f64 = 1e-3;

/// The problem that a file describes.
///
/// # Errors
/// [`Error::Io`], [`Error::Format`] and [`Error::Mesh`] for its files; [`Error::Config`] naming the key.
pub(super) fn problem(config: &EstimateConfig, files: &ProjectFiles) -> Result<Problem> {
    let material: Arc<dyn MaterialModel> = Arc::from(config.material.material("material")?);
    let (rest, weighed) = cloth_at_rest(&config.cloth, &*material, files)?;
    let captures = config.pose.iter().map(|p| capture(p, config, &rest, files)).collect::<Result<_>>()?;
    let forces = Forces { contact: config.contact, ..Forces::default() };
    let parts = CutPart::whole(rest.faces().len());
    Ok(Problem { rest, material, forces, solver: config.solver, captures, weighed, parts })
}

/// Reads a mesh by its ending.
fn read(path: &Path, files: &ProjectFiles) -> Result<Scan> {
    let bytes = files.read(path)?;
    if path.extension().is_some_and(|e| e.eq_ignore_ascii_case("obj")) {
        Ok(caphy_formats::obj::read_obj(path, &bytes)?.scan)
    } else {
        caphy_formats::ply::read_ply(path, &bytes)
    }
}

fn cloth_at_rest(
    config: &ClothConfig,
    material: &dyn MaterialModel,
    files: &ProjectFiles,
) -> Result<(GarmentRest, bool)> {
    // The mass sets the density once the area is known.
    let make = |density: f64| -> Result<GarmentRest> {
        match config {
            ClothConfig::Rectangle { size_m, edge_m, .. } => {
                let cells = size_m.map(|s| (s / edge_m).round().clamp(0.0, 1e4) as usize);
                cloth::sheet(cells[0], cells[1], *size_m, density)
            }
            ClothConfig::Disc { diameter_m, edge_m, .. } => cloth::disc(0.5 * diameter_m, *edge_m, density),
            ClothConfig::Mesh { path, held, .. } => {
                let rest = mesh_at_rest(path, density, files)?;
                if held.is_empty() { Ok(rest) } else { rest.holding("held", held) }
            }
        }
    };
    let mass_g = match config {
        ClothConfig::Rectangle { mass_g, .. } | ClothConfig::Disc { mass_g, .. } | ClothConfig::Mesh { mass_g, .. } => {
            *mass_g
        }
    };
    if let Some(mass) = mass_g {
        if !(mass > 0.0 && mass.is_finite()) {
            return Err(Error::config("cloth.mass_g", format!("{mass} g"), "weigh the cloth and give grams"));
        }
        let area = make(1.0)?.area();
        return Ok((make(1e-3 * mass / area)?, true));
    }
    let facts = material.describe();
    let Some(KilogramPerSquareMetre(density)) = facts.density else {
        let problem = format!("is not given, and material `{}` has no area density", facts.name);
        return Err(Error::config(
            "cloth.mass_g",
            problem,
            "weigh the cloth and give grams, or the material its density",
        ));
    };
    Ok((make(density)?, false))
}

fn mesh_at_rest(path: &Path, density: f64, files: &ProjectFiles) -> Result<GarmentRest> {
    let obj = caphy_formats::obj::read_obj(path, &files.read(path)?)?;
    let mesh = obj.scan.mesh;
    let name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let (uv, grain) = match obj.uvs {
        Some(uvs) => (uvs.faces.iter().map(|f| f.map(|k| uvs.coords[k as usize])).collect(), "the file's layout"),
        None => {
            if let Some(v) = mesh.vertices.iter().position(|p| p.z.abs() > 1e-9) {
                return Err(Error::mesh(
                    path.display().to_string(),
                    format!("vertex {v}"),
                    format!("lies at z = {} m and the file has no texture coordinates", mesh.vertices[v].z),
                    "give a layout in metres along the yarns, or a cloth flat in the x-y plane",
                ));
            }
            let flat = |v: u32| [mesh.vertices[v as usize].x, mesh.vertices[v as usize].y];
            (mesh.faces.iter().map(|f| f.map(flat)).collect(), "flat, u along x")
        }
    };
    GarmentRest::new(name, mesh, uv, KilogramPerSquareMetre(density), grain)
}

fn capture(pose: &PoseConfig, config: &EstimateConfig, rest: &GarmentRest, files: &ProjectFiles) -> Result<Capture> {
    let key = |part: &str| format!("pose `{}`, {part}", pose.name);
    let scan = read(&pose.scan, files)?;
    let scan = match pose.label {
        None => scan.mesh,
        Some(label) => {
            let labels = scan.labels.as_ref().ok_or_else(|| {
                Error::config(key("label"), "the scan has no labels", "leave it out, or label the scan")
            })?;
            scan.mesh.submesh(&labels.iter().map(|l| *l == label).collect::<Vec<_>>()).0
        }
    };
    let n = rest.vertex_count();
    if pose.registered && scan.vertices.len() != n {
        let problem = format!("has {} vertices, the cloth {n}", scan.vertices.len());
        return Err(Error::config(key("scan"), problem, "leave out `registered`, or give the cloth's own vertices"));
    }
    let mut fixed = clamped(pose, rest)?;
    let mut on = None;
    match &pose.on {
        None => {}
        Some(SurroundingsConfig::Mesh { path }) => {
            let mesh: TriMesh = read(path, files)?.mesh;
            if mesh.faces.is_empty() {
                return Err(Error::config(key("on"), "has no surface, only points", "give a mesh with triangles"));
            }
            on = Some(Surroundings::new(&mesh.vertices, &mesh.vertex_normals())?);
        }
        Some(SurroundingsConfig::Sphere { centre, radius_m }) => {
            on = Some(cloth::sphere(Vec3::from(*centre), *radius_m, SPACING_M)?);
        }
        Some(SurroundingsConfig::Cusick { table_m }) => {
            if !matches!(config.cloth, ClothConfig::Disc { diameter_m, .. } if diameter_m > *table_m) {
                let problem = "Cusick's test wants a disc that is larger than its table";
                return Err(Error::config(key("on"), problem, "cut the cloth as type = \"disc\""));
            }
            let between = |v: &u32| rest.template.vertices[*v as usize].norm() <= 0.5 * table_m + 1e-9;
            fixed.extend((0..n as u32).filter(between));
            on = Some(cloth::table(0.5 * table_m, SPACING_M)?);
        }
    }
    fixed.sort_unstable();
    fixed.dedup();
    let start = match (&pose.start, pose.registered, &pose.on) {
        (Some(path), ..) => {
            let shape = read(path, files)?.mesh.vertices;
            if shape.len() != n {
                let problem = format!("has {} vertices, the cloth {n}", shape.len());
                return Err(Error::config(key("start"), problem, "give the cloth's vertices in their order"));
            }
            shape
        }
        (None, true, _) => scan.vertices.clone(),
        (None, false, Some(SurroundingsConfig::Cusick { .. })) => {
            let lay = |p: &Vec3| {
                // Two waves around, more where it may move.
                let wave = RIPPLE_M * (p.norm() / 0.15).powi(4) * (5.0 * p.y.atan2(p.x)).sin();
                Vec3::new(p.x, LAID_M + wave, -p.y)
            };
            rest.template.vertices.iter().map(lay).collect()
        }
        _ => rest.template.vertices.clone(),
    };
    let held = rest.held.iter().flat_map(|set| &set.vertices);
    Ok(Capture {
        name: pose.name.clone(),
        targets: held.map(|&v| start[v as usize]).collect(),
        start,
        fixed,
        body: on,
        blends: Vec::new(),
        scan: if pose.registered {
            ScanPoints::Known { vertices: (0..n as u32).collect(), points: scan.vertices }
        } else {
            ScanPoints::Surface { points: scan.vertices, faces: scan.faces, visible: None }
        },
        anchors: None,
        worn: None,
        sigma_m: pose.sigma_m,
    })
}

fn clamped(pose: &PoseConfig, rest: &GarmentRest) -> Result<Vec<u32>> {
    let mut out = Vec::new();
    for clamp in &pose.clamps {
        let inside = |f: &dyn Fn(&Vec3) -> bool| -> Vec<u32> {
            (0..rest.vertex_count() as u32).filter(|&v| f(&rest.template.vertices[v as usize])).collect()
        };
        let found = match clamp {
            Clamp::Vertices { vertices } => vertices.clone(),
            Clamp::Plane { normal, offset_m } => inside(&|p| Vec3::from(*normal).dot(p) >= *offset_m),
            Clamp::Pin { at, within_m } => inside(&|p| (p - Vec3::from(*at)).norm() <= *within_m),
        };
        if found.is_empty() {
            let key = format!("pose `{}`, clamps", pose.name);
            return Err(Error::config(key, format!("{clamp:?} holds no vertex"), "look at the cloth's rest shape"));
        }
        out.extend(found);
    }
    Ok(out)
}
