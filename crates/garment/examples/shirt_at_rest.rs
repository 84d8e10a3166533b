//! Brings a T-shirt to rest on a posed mannequin with the reference solver, and says what it took.
//!
//! `cargo run --release -p caphy-garment --example shirt_at_rest -- [resolution m] [material] [tolerance N] [picture.png]`
//! with material `stvk`, `measured` or `full`; 0.015 m gives about 4400 vertices.

use caphy_bodymodel::BodyMannequin;
use caphy_bodymodel::procedural_motion::{MotionKind, procedural_clip};
use caphy_core::body::{BodyModel, BodyParameters};
use caphy_core::lanes::Frames;
use caphy_core::material::{MaterialModel, MaterialSpec};
use caphy_core::query::NearestGrid;
use caphy_core::units::KilogramPerSquareMetre;
use caphy_core::{Result, TriMesh, Vec3, mesh};
use caphy_garment::GarmentRest;
use caphy_garment::contact::ContactMap;
use caphy_garment::energy::frame_normals;
use caphy_garment::skinning::{Skinner, WeightOptions, garment_weights};
use caphy_garment::solver::{Forces, Obstacle, Scene, Solver, SolverSettings};
use caphy_garment::template::{BodyRest, Style, Tailor, UpperStyle};
use caphy_materials::{MaterialMeasuredSpec, MaterialStvk};
use caphy_render::shade::{CLAY_SKIN, CLAY_UPPER};
use caphy_render::{Layer, Picture, Projection, frame, png};
use std::sync::Arc;
use std::time::Instant;

fn main() -> std::result::Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let resolution: f64 = arguments.next().map_or(Ok(0.015), |text| text.parse())?;
    let name = arguments.next().unwrap_or_else(|| "stvk".into());
    let tolerance: f64 = arguments.next().map_or(Ok(1e-8), |text| text.parse())?;
    let picture = arguments.next();

    let body = BodyMannequin { resolution: 0.0162 }.generate()?;
    let subject = BodyParameters::rest(body.describe().joints.len(), &[]);
    let rest_body = BodyRest::from_model(&body, &subject)?;
    let skin = rest_body.mesh.clone();
    let style = UpperStyle { sleeve_length: 0.4, body_length: 0.5, looseness: 0.02, neckline: 0.3 };
    let template = Tailor::new(rest_body)?.generate(&Style::Upper(style), resolution)?;
    let shirt = &template.mesh;
    let weights = garment_weights(
        &shirt.vertices,
        &shirt.faces,
        &skin.vertices,
        &body.describe().weights,
        &WeightOptions::default(),
    )?;
    let material = fabric(&name)?;
    let density = material.describe().density.unwrap_or(KilogramPerSquareMetre(0.2));
    let rest = GarmentRest::new("shirt", shirt.clone(), template.material_uv.clone(), density, &*template.grain)?;

    // What the shirt can reach of the body.
    let grid = NearestGrid::from_points(&shirt.vertices);
    let keep: Vec<bool> =
        skin.vertices.iter().map(|p| grid.nearest_within(&[p.x, p.y, p.z], 0.0144).is_some()).collect();
    let (near, ids) = skin.submesh(&keep);
    let map = ContactMap::new(&shirt.vertices, &weights, &near.vertices, &near.vertex_normals(), 0.08)?;
    let clip = procedural_clip(MotionKind::Walk, 1, 4.0, 30.0)?;
    let skinner = Skinner::<f64>::new(&shirt.vertices, &weights)?;
    let settings = SolverSettings { tolerance_n: tolerance, ..SolverSettings::default() };
    let began = Instant::now();
    let mut solver = Solver::new(&rest, material, Forces::default(), settings)?;
    println!(
        "{} vertices, {} threads, {name}: order found in {:.3} s, factor of {:.1} million values, {:.2} billion multiplications",
        rest.vertex_count(),
        rayon::current_num_threads(),
        began.elapsed().as_secs_f64(),
        solver.analysis().factor_values() as f64 * 1e-6,
        solver.analysis().flops() * 1e-9,
    );
    for pose in [&clip.poses[20], &clip.poses[45]] {
        let posed = body.forward(&subject.posed(pose))?;
        let transforms = [&posed.transforms[..]];
        let mut start = Frames::zeros(1, rest.vertex_count(), 1);
        skinner.forward(&skinner.joint_frames(&transforms, 1)?, None, &mut start)?;
        let mut positions = Frames::zeros(1, ids.len(), 1);
        positions.set_frame(0, 0, &ids.iter().map(|&v| posed.vertices[v as usize]).collect::<Vec<_>>())?;
        let normals = frame_normals(&positions, &near.faces)?;
        let search = |x: &Frames<f64>| map.nearest(x, &positions);
        let obstacle = Obstacle { positions: &positions, normals: &normals, before: None, search: Some(&search) };
        let scene = Scene { body: Some(obstacle), ..Scene::default() };
        let start = start.frame(0, 0);
        let began = Instant::now();
        let solution = solver.solve(&scene, &start, &|_| {})?;
        let seconds = began.elapsed().as_secs_f64();
        let r = &solution.report;
        println!(
            "{:?} in {seconds:.2} s: {} steps, {} factorisations ({} damped), {} evaluations, {} rounds, residual {:.2e} N, \
             {} touch, {} pairs open",
            r.outcome,
            r.iterations,
            r.factorisations,
            r.damped,
            r.evaluations,
            r.rounds,
            r.residual_n,
            solution.contacts.len(),
            r.pairs_open
        );
        for (term, energy) in &r.energies {
            print!("  {term} {energy:.6} J");
        }
        println!();
        if let Some(path) = &picture {
            let skin = TriMesh { vertices: posed.vertices.clone(), faces: skin.faces.clone() };
            let pair = [("skinned", &start), ("at rest", &solution.positions)].map(|(label, points)| {
                let worn = TriMesh { vertices: points.clone(), faces: shirt.faces.clone() };
                (label, drawn(&skin, &worn))
            });
            let list: Vec<_> = pair.iter().map(|(label, picture)| (*label, picture)).collect();
            std::fs::write(path, png(&caphy_render::contact_sheet(&list, 2))?)?;
            return Ok(());
        }
    }
    Ok(())
}

fn fabric(name: &str) -> Result<Arc<dyn MaterialModel>> {
    let keys = match name {
        "measured" => "fabric = \"gray-interlock\"",
        "full" => "fabric = \"gray-interlock\"\nstiffness_gradient = \"full\"",
        _ => return Ok(Arc::new(MaterialStvk::snug()?)),
    };
    let spec: MaterialMeasuredSpec = toml::from_str(keys)
        .map_err(|e| caphy_core::Error::config("material", e.to_string(), "see the keys of `measured`"))?;
    Ok(Arc::from(spec.build()?))
}

fn drawn(skin: &TriMesh, worn: &TriMesh) -> caphy_render::Rgb {
    let (low, high) = mesh::bounds(&worn.vertices).unwrap_or((Vec3::zeros(), Vec3::repeat(1.0)));
    let pad = Vec3::repeat(0.05);
    let camera = frame((low - pad, high + pad), &Vec3::new(0.35, 0.15, 1.0), Projection::Orthographic, 700, 800);
    Picture::new(camera, vec![Layer::uniform(skin, CLAY_SKIN), Layer::uniform(worn, CLAY_UPPER)]).draw()
}
