//! Brings a knit shirt and trousers to rest in the poses of a scan session, as synthetic subjects wear them, and says what it took.
//!
//! `cargo run --release -p caphy-garment --example clothes_at_rest -- [resolution m] [tolerance N] [poses] [upper|lower|both]`
//! with poses such as `0,3,5`; the default is what `caphy synth` does in its nine first poses.

use caphy_bodymodel::BodyMannequin;
use caphy_bodymodel::procedural_motion::static_poses;
use caphy_core::body::{BlendWeights, BodyModel, BodyParameters};
use caphy_core::lanes::Frames;
use caphy_core::material::{MaterialModel, MaterialSpec};
use caphy_core::query::NearestGrid;
use caphy_core::units::KilogramPerSquareMetre;
use caphy_core::{Result, Vec3};
use caphy_garment::GarmentRest;
use caphy_garment::contact::ContactMap;
use caphy_garment::energy::{ContactOptions, frame_normals};
use caphy_garment::skinning::{WeightOptions, garment_weights};
use caphy_garment::solver::{Forces, Obstacle, Scene, Solver, SolverSettings};
use caphy_garment::template::{BodyRest, LowerStyle, Style, Tailor, Template, UpperStyle, pose_by_weights};
use caphy_materials::MaterialMeasuredSpec;
use std::sync::Arc;

/// The same as synthetic subjects have.
const CONTACT: ContactOptions = ContactOptions { margin: 4e-3, allowed_depth: 1e-3, load: 50.0 };
const FRICTION: f64 = 0.3;

/// A garment with all that its poses share.
struct Garment {
    template: Template,
    weights: BlendWeights,
    solver: Solver,
    contact: ContactMap,
}

fn main() -> std::result::Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let resolution: f64 = arguments.next().map_or(Ok(0.027), |text| text.parse())?;
    let tolerance: f64 = arguments.next().map_or(Ok(5e-5), |text| text.parse())?;
    let poses = arguments.next().unwrap_or_else(|| "0,1,2,3,4,5,6,7,8".into());
    let poses = poses.split(',').map(str::parse).collect::<std::result::Result<Vec<usize>, _>>()?;
    let which = arguments.next().unwrap_or_else(|| "both".into());

    let body = BodyMannequin::default().generate()?;
    let subject = BodyParameters::rest(body.describe().joints.len(), &[0.54, 0.72, 0.44, 0.35]);
    let rest_body = BodyRest::from_model(&body, &subject)?;
    let skin = rest_body.mesh.clone();
    let styles = [
        Style::Upper(UpperStyle { sleeve_length: 0.33, body_length: 0.46, looseness: 0.017, neckline: 0.38 }),
        Style::Lower(LowerStyle { leg_length: 0.89, looseness: 0.017, rise: 0.62 }),
    ];
    let mut garments = Vec::new();
    let templates = Tailor::new(rest_body)?.generate_all(&styles, resolution)?;
    let grid = NearestGrid::from_points(&templates.iter().flat_map(|t| t.mesh.vertices.clone()).collect::<Vec<_>>());
    let keep: Vec<bool> =
        skin.vertices.iter().map(|p| grid.nearest_within(&[p.x, p.y, p.z], 0.0144).is_some()).collect();
    let (near, ids) = skin.submesh(&keep);
    let settings = SolverSettings { tolerance_n: tolerance, friction: FRICTION, ..SolverSettings::default() };
    for (template, fabric) in templates.into_iter().zip(["gray-interlock", "11oz-black-denim"]) {
        let mesh = &template.mesh;
        let weights = garment_weights(
            &mesh.vertices,
            &mesh.faces,
            &skin.vertices,
            &body.describe().weights,
            &WeightOptions::default(),
        )?;
        let material = measured(fabric)?;
        let density = material.describe().density.unwrap_or(KilogramPerSquareMetre(0.2));
        let rest = GarmentRest::new(fabric, mesh.clone(), template.material_uv.clone(), density, &*template.grain)?;
        let rest = template
            .loops
            .iter()
            .filter(|l| l.name == "waist")
            .try_fold(rest, |rest, waist| rest.holding("waistband", &waist.vertices))?;
        let forces = Forces { contact: CONTACT, ..Forces::default() };
        let contact = ContactMap::new(&mesh.vertices, &weights, &near.vertices, &near.vertex_normals(), 0.08)?;
        garments.push(Garment { solver: Solver::new(&rest, material, forces, settings)?, template, weights, contact });
    }
    let all = static_poses(1, poses.iter().max().map_or(0, |p| p + 1));
    let before = processor_seconds();
    for &pose in &poses {
        let posed = body.forward(&subject.posed(&all[pose]))?;
        let mut points: Vec<Vec3> = ids.iter().map(|&v| posed.vertices[v as usize]).collect();
        let mut faces = near.faces.clone();
        // The shirt falls over the trousers.
        for (k, name) in [(1, "lower"), (0, "upper")] {
            if which == name || which == "both" || (which == "upper" && k == 1 && resolution == 0.0) {
                let garment = &mut garments[k];
                let shape = at_rest(garment, &posed.transforms, &points, &faces, ids.len(), (pose, name))?;
                let first = points.len() as u32;
                points.extend(shape);
                faces.extend(garment.template.mesh.faces.iter().map(|f| f.map(|v| v + first)));
            }
        }
    }
    println!("{:.1} s of processor time", processor_seconds() - before);
    Ok(())
}

fn at_rest(
    garment: &mut Garment,
    transforms: &[nalgebra::Matrix3x4<f64>],
    points: &[Vec3],
    faces: &[[u32; 3]],
    skin: usize,
    (pose, name): (usize, &str),
) -> Result<Vec<Vec3>> {
    let mut positions = Frames::zeros(1, points.len(), 1);
    positions.set_frame(0, 0, points)?;
    let normals = frame_normals(&positions, faces)?;
    let contact = garment.contact.clone().with_obstacle(points.len() - skin);
    let search = |x: &Frames<f64>| contact.nearest(x, &positions);
    let start = pose_by_weights(&garment.template.mesh.vertices, &garment.weights, transforms)?;
    let solver = &mut garment.solver;
    let targets: Vec<Vec3> = solver.held_vertices().iter().map(|&v| start[v as usize]).collect();
    let obstacle = Obstacle { positions: &positions, normals: &normals, before: None, search: Some(&search) };
    let scene = Scene { body: Some(obstacle), targets: Some(&targets), ..Scene::default() };
    let before = processor_seconds();
    let solution = solver.solve(&scene, &start, &|_| {})?;
    let r = &solution.report;
    println!(
        "pose {pose} {name}: {:?} in {:.2} s, {} vertices, {} steps, {} factorisations ({} damped), {} evaluations, {} rounds, \
         {:.1e} N, {:.6} J",
        r.outcome,
        processor_seconds() - before,
        start.len(),
        r.iterations,
        r.factorisations,
        r.damped,
        r.evaluations,
        r.rounds,
        r.residual_n,
        r.energies.iter().map(|e| e.1).sum::<f64>(),
    );
    Ok(solution.positions)
}

fn measured(fabric: &str) -> Result<Arc<dyn MaterialModel>> {
    let spec: MaterialMeasuredSpec = toml::from_str(&format!("fabric = \"{fabric}\""))
        .map_err(|e| caphy_core::Error::config("material", e.to_string(), "see the keys of `measured`"))?;
    Ok(Arc::from(spec.build()?))
}

/// Of all threads so far, by the kernel's hundredths of a second; NaN where there is no `/proc`.
fn processor_seconds() -> f64 {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let after_name = stat.rsplit(')').next().unwrap_or_default();
    let ticks: Vec<f64> = after_name.split_whitespace().skip(11).take(2).filter_map(|t| t.parse().ok()).collect();
    if ticks.len() == 2 { (ticks[0] + ticks[1]) / 100.0 } else { f64::NAN }
}
