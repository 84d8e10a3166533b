//! Simulates a T-shirt on a walking mannequin with the reference solver, frame by frame, and says what every frame took.
//!
//! `cargo run --release -p caphy-garment --example shirt_in_motion -- [resolution m] [material] [static|dynamic] [frames] [sheet.png]`
//! with material `stvk`, `measured` or `full`; 0.025 m gives about 1700 vertices. The picture shows eight frames.

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
use caphy_garment::solver::{Dynamics, Forces, Obstacle, Scene, Solution, Solver, SolverSettings, carried_along};
use caphy_garment::template::{BodyRest, Style, Tailor, UpperStyle};
use caphy_materials::{MaterialMeasuredSpec, MaterialStvk};
use caphy_render::shade::{CLAY_SKIN, CLAY_UPPER};
use caphy_render::{Layer, Picture, Projection, frame, png};
use std::sync::Arc;
use std::time::Instant;

/// Frames per second of the walk.
const RATE: f64 = 30.0;

fn main() -> std::result::Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let resolution: f64 = arguments.next().map_or(Ok(0.025), |text| text.parse())?;
    let name = arguments.next().unwrap_or_else(|| "stvk".into());
    let dynamic = arguments.next().is_none_or(|text| text == "dynamic");
    let count: usize = arguments.next().map_or(Ok(60), |text| text.parse())?;
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
    let grid = NearestGrid::from_points(&shirt.vertices);
    let keep: Vec<bool> =
        skin.vertices.iter().map(|p| grid.nearest_within(&[p.x, p.y, p.z], 0.0144).is_some()).collect();
    let (near, ids) = skin.submesh(&keep);
    let map = ContactMap::new(&shirt.vertices, &weights, &near.vertices, &near.vertex_normals(), 0.08)?;
    let clip = procedural_clip(MotionKind::Walk, 1, count as f64 / RATE + 1.0, RATE)?;
    let skinner = Skinner::<f64>::new(&shirt.vertices, &weights)?;
    let mut solver = Solver::new(&rest, material, Forces::default(), SolverSettings::default())?;
    println!("{} vertices, {} threads, {name}, dynamic {dynamic}", rest.vertex_count(), rayon::current_num_threads());

    let mut state: Option<(Dynamics, Solution, Vec<Vec3>)> = None;
    let (mut seconds, mut pictures) = (Vec::new(), Vec::new());
    for (at, pose) in clip.poses.iter().take(count).enumerate() {
        let posed = body.forward(&subject.posed(pose))?;
        let transforms = [&posed.transforms[..]];
        let mut skinned = Frames::zeros(1, rest.vertex_count(), 1);
        skinner.forward(&skinner.joint_frames(&transforms, 1)?, None, &mut skinned)?;
        let skinned = skinned.frame(0, 0);
        let mut positions = Frames::zeros(1, ids.len(), 1);
        positions.set_frame(0, 0, &ids.iter().map(|&v| posed.vertices[v as usize]).collect::<Vec<_>>())?;
        let normals = frame_normals(&positions, &near.faces)?;
        let search = |x: &Frames<f64>| map.nearest(x, &positions);
        let obstacle = Obstacle { positions: &positions, normals: &normals, before: None, search: Some(&search) };
        let scene = Scene { body: Some(obstacle), ..Scene::default() };
        let began = Instant::now();
        let (dynamics, solution) = match state.take() {
            // The first frame at rest, then as asked.
            None => {
                let solution = solver.solve(&scene, &skinned, &|_| {})?;
                (Dynamics::new(solution.positions.clone(), None, 1.0 / RATE)?, solution)
            }
            Some((mut dynamics, before, skinned_before)) => {
                let start = carried_along(&before.positions, &skinned_before, &skinned)?;
                let solution = if dynamic {
                    dynamics.advance(&mut solver, &scene, Some(&start), &|_| {})?
                } else {
                    solver.solve_from(&before, &scene, &start, &|_| {})?
                };
                (dynamics, solution)
            }
        };
        let taken = began.elapsed().as_secs_f64();
        let r = &solution.report;
        let far = solution.positions.iter().zip(&skinned).map(|(a, b)| (a - b).norm()).fold(0.0, f64::max);
        println!(
            "frame {at}: {:?} in {taken:.2} s, {} steps, {} factorisations, {} evaluations, {} rounds, residual {:.1e} N, \
             strain {:.4} J, {:.0} mm from skinned at most",
            r.outcome,
            r.iterations,
            r.factorisations,
            r.evaluations,
            r.rounds,
            r.residual_n,
            r.energy("strain"),
            1e3 * far
        );
        if at > 0 {
            seconds.push(taken);
        }
        if picture.is_some() && (at + 1) % count.div_ceil(8).max(1) == 0 {
            let skin = TriMesh { vertices: posed.vertices.clone(), faces: skin.faces.clone() };
            let worn = TriMesh { vertices: solution.positions.clone(), faces: shirt.faces.clone() };
            pictures.push((format!("frame {at}"), drawn(&skin, &worn)));
        }
        state = Some((dynamics, solution, skinned));
    }
    seconds.sort_by(f64::total_cmp);
    if let (Some(most), Some(median)) = (seconds.last(), seconds.get(seconds.len() / 2)) {
        let sum: f64 = seconds.iter().sum();
        println!("per frame: mean {:.2} s, median {median:.2} s, most {most:.2} s", sum / seconds.len() as f64);
    }
    if let Some(path) = picture {
        let list: Vec<_> = pictures.iter().map(|(label, picture)| (label.as_str(), picture)).collect();
        std::fs::write(path, png(&caphy_render::contact_sheet(&list, 4))?)?;
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
    let camera = frame((low - pad, high + pad), &Vec3::new(0.35, 0.15, 1.0), Projection::Orthographic, 420, 480);
    Picture::new(camera, vec![Layer::uniform(skin, CLAY_SKIN), Layer::uniform(worn, CLAY_UPPER)]).draw()
}
