//! What a body is, and how it looks in poses that people take.

use crate::pictures;
use caphy_bodymodel::procedural_motion::static_poses;
use caphy_core::body::BodyModel;
use caphy_core::query::{Adjacency, boundary_loops, hinges};
use caphy_core::{Error, Result, TriMesh, Vec3, mesh};
use caphy_render::Layer;
use caphy_render::shade::CLAY_SKIN;
use serde::Serialize;
use std::fmt::Write;

/// Poses on the contact sheet.
const POSES: usize = 10;
/// Seed of the poses; the first is an A-pose.
const SEED: u64 = 1;

/// What is known of a body in a shape. SI units.
#[derive(Debug, Clone, Serialize)]
pub struct BodyFacts {
    /// The `type` name, with the file's name where there is one.
    pub name: String,
    /// Surface vertices.
    pub vertices: usize,
    /// Surface triangles.
    pub faces: usize,
    /// Separate pieces of the surface.
    pub pieces: usize,
    /// Open boundary loops; 0 for a closed surface.
    pub boundary_loops: usize,
    /// Edges of three or more triangles, or of two that look opposite ways.
    pub bad_edges: usize,
    /// Joints in their order.
    pub joints: Vec<JointFacts>,
    /// Shape coefficients.
    pub shape_coefficients: usize,
    /// Expression coefficients.
    pub expression_coefficients: usize,
    /// Landmarks beyond the joints.
    pub landmarks: usize,
    /// Most joints that move one vertex.
    pub most_joints_per_vertex: usize,
    /// Shape that was shown.
    pub shape: Vec<f64>,
    /// Extent of the T-pose along x, y, z [m]; y is the height.
    pub size_m: [f64; 3],
    /// Volume of the T-pose [m³]; a closed surface encloses it.
    pub volume_m3: f64,
}

/// A joint at rest.
#[derive(Debug, Clone, Serialize)]
pub struct JointFacts {
    /// Its name.
    pub name: String,
    /// Its parent's name.
    pub parent: Option<String>,
    /// Where it is in the T-pose [m].
    pub position_m: [f64; 3],
}

/// Facts of a body in a shape.
///
/// # Errors
/// A shape that is not this body's.
pub fn facts(body: &dyn BodyModel, shape: &[f64]) -> Result<BodyFacts> {
    let description = body.describe();
    let posed = body.forward(&body.rest(shape))?;
    let (low, high) = mesh::bounds(&posed.vertices)
        .ok_or_else(|| Error::mesh(&description.name, "surface", "has no vertices", "give a body with a surface"))?;
    let joints = description
        .joints
        .iter()
        .zip(&posed.joints)
        .map(|(joint, at)| JointFacts {
            name: joint.name.clone(),
            parent: joint.parent.map(|p| description.joints[p].name.clone()),
            position_m: [at.x, at.y, at.z],
        })
        .collect();
    let volume = |f: &[u32; 3]| {
        let [a, b, c] = f.map(|v| posed.vertices[v as usize]);
        a.dot(&b.cross(&c)) / 6.0
    };
    let size = high - low;
    Ok(BodyFacts {
        name: description.name.clone(),
        vertices: description.vertex_count,
        faces: description.faces.len(),
        pieces: Adjacency::new(description.vertex_count, &description.faces).components().1,
        boundary_loops: boundary_loops(&description.faces).len(),
        bad_edges: hinges(&description.faces).1.len(),
        joints,
        shape_coefficients: description.shape_count,
        expression_coefficients: description.expression_count,
        landmarks: body.landmark_names().len(),
        most_joints_per_vertex: (0..description.vertex_count)
            .map(|v| description.weights.row(v).count())
            .max()
            .unwrap_or(0),
        shape: shape.to_vec(),
        size_m: [size.x, size.y, size.z],
        volume_m3: description.faces.iter().map(volume).sum(),
    })
}

/// The facts for people.
pub fn text(f: &BodyFacts) -> String {
    let closed = match (f.boundary_loops, f.bad_edges) {
        (0, 0) => "closed".to_string(),
        (loops, bad) => format!("{loops} boundary loops, {bad} edges that are not manifold"),
    };
    let [x, y, z] = f.size_m;
    let mut out = format!(
        "{}\n  {} vertices, {} triangles in {} pieces, {closed}\n  {} joints, at most {} of them at one vertex; {} \
         landmarks\n  {} shape and {} expression coefficients\n  height {y:.3} m, span {x:.3} m, depth {z:.3} m, volume {:.1} \
         litres in the T-pose\n",
        f.name,
        f.vertices,
        f.faces,
        f.pieces,
        f.joints.len(),
        f.most_joints_per_vertex,
        f.landmarks,
        f.shape_coefficients,
        f.expression_coefficients,
        1e3 * f.volume_m3,
    );
    if !f.shape.is_empty() {
        // Writing to a String cannot fail.
        let _ = writeln!(out, "  shape {:?}", f.shape);
    }
    out
}

/// PNG of the T-pose and poses that people take in front of scanners, front and back; then each of the first shape
/// coefficients at ±2.
///
/// # Errors
/// A shape that is not this body's.
pub fn sheet(body: &dyn BodyModel, shape: &[f64]) -> Result<Vec<u8>> {
    let faces = &body.describe().faces;
    let draw = |vertices: Vec<Vec3>, from: &Vec3| {
        let surface = TriMesh { vertices, faces: faces.clone() };
        let bounds = surface.bounds().unwrap_or((Vec3::zeros(), Vec3::repeat(1.0)));
        pictures::draw(vec![Layer::uniform(&surface, CLAY_SKIN)], pictures::padded(bounds), from)
    };
    let rest = body.rest(shape);
    let mut cells = Vec::new();
    let mut both = |label: String, vertices: Vec<Vec3>| {
        cells.push((label.clone(), draw(vertices.clone(), &pictures::FRONT)));
        cells.push((format!("{label}, back"), draw(vertices, &pictures::BACK)));
    };
    both("T-pose".into(), body.forward(&rest)?.vertices);
    for (i, pose) in static_poses(SEED, POSES).iter().enumerate() {
        both(format!("pose {}", i + 1), body.forward(&rest.posed(pose))?.vertices);
    }
    for coefficient in 0..body.describe().shape_count.min(3) {
        for value in [-2.0, 2.0] {
            let mut changed = shape.to_vec();
            changed.resize(changed.len().max(coefficient + 1), 0.0);
            changed[coefficient] = value;
            let vertices = body.forward(&body.rest(&changed))?.vertices;
            cells.push((format!("shape {} = {value:+}", coefficient + 1), draw(vertices, &pictures::FRONT)));
        }
    }
    pictures::sheet(&cells, 8)
}
