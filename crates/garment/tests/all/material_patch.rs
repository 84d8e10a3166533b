//! Materials on meshes: affine patches, and a sheet rolled onto a cylinder.

use caphy_core::lanes::Frames;
use caphy_core::material::{MaterialModel, MaterialSpec};
use caphy_core::units::KilogramPerSquareMetre;
use caphy_core::{TriMesh, Vec3};
use caphy_garment::GarmentRest;
use caphy_garment::energy::{Bending, EnergyTerm, RestAngle, State, Strain};
use caphy_materials as _;
use std::sync::Arc;

/// How a rectangle is cut into triangles.
#[derive(Debug, Clone, Copy)]
enum Pattern {
    /// All diagonals alike.
    Diagonal,
    /// Diagonals in turn.
    Alternating,
    /// Near equilateral triangles.
    Equilateral,
}

/// A flat sheet of `n` × `n` cells of 1 cm, its inner vertices moved by `jitter` of a cell.
fn sheet(n: usize, pattern: Pattern, jitter: f64) -> (TriMesh, Vec<[[f64; 2]; 3]>) {
    let (mut vertices, mut faces) = (Vec::new(), Vec::new());
    let noise = |i: usize, k: f64| ((i as f64 + 1.0) * k).fract() - 0.5;
    for y in 0..=n {
        for x in 0..=n {
            let inner = x > 0 && y > 0 && x < n && y < n;
            let shift = if inner { jitter } else { 0.0 };
            let i = vertices.len();
            let skew = if matches!(pattern, Pattern::Equilateral) && y % 2 == 1 { 0.5 } else { 0.0 };
            let height = if matches!(pattern, Pattern::Equilateral) { 0.75f64.sqrt() } else { 1.0 };
            let (u, v) =
                (x as f64 + skew + shift * noise(i, 0.754_877), height * (y as f64 + shift * noise(i, 0.569_84)));
            vertices.push(Vec3::new(0.01 * u, 0.01 * v, 0.0));
        }
    }
    for y in 0..n {
        for x in 0..n {
            let a = (y * (n + 1) + x) as u32;
            let (b, c, d) = (a + 1, a + n as u32 + 2, a + n as u32 + 1);
            let other = match pattern {
                Pattern::Diagonal => false,
                Pattern::Alternating => (x + y) % 2 == 1,
                Pattern::Equilateral => y % 2 == 0,
            };
            faces.extend(if other { [[a, b, d], [b, c, d]] } else { [[a, b, c], [a, c, d]] });
        }
    }
    let mesh = TriMesh { vertices, faces };
    let uv = mesh.faces.iter().map(|f| f.map(|v| [mesh.vertices[v as usize].x, mesh.vertices[v as usize].y])).collect();
    (mesh, uv)
}

fn rest(n: usize, pattern: Pattern, jitter: f64) -> GarmentRest {
    let (mesh, uv) = sheet(n, pattern, jitter);
    GarmentRest::new("sheet", mesh, uv, KilogramPerSquareMetre(0.2), "test").expect("a flat sheet")
}

fn material(text: &str) -> Arc<dyn MaterialModel> {
    let spec: Box<dyn MaterialSpec> = toml::from_str(text).expect("a material");
    Arc::from(spec.build().expect("a material"))
}

/// Energy and gradient of a term at positions.
fn ask(term: &dyn EnergyTerm<f64>, points: &[Vec3]) -> (f64, Vec<Vec3>) {
    let mut positions = Frames::zeros(1, points.len(), 1);
    positions.set_frame(0, 0, points).expect("all vertices");
    let (mut energy, mut gradient) = ([0.0], Frames::zeros(1, points.len(), 1));
    term.add(&State::new(&positions), 1.0, &mut energy, Some(&mut gradient)).expect("an energy");
    (energy[0], gradient.frame(0, 0))
}

#[test]
fn an_affine_patch_is_in_equilibrium_inside() {
    let rest = rest(8, Pattern::Alternating, 0.5);
    // F = [Fu, Fv], out of the plane, with shear.
    let (fu, fv) = (Vec3::new(1.08, 0.03, -0.2), Vec3::new(0.1, 0.95, 0.15));
    let points: Vec<Vec3> =
        rest.template.vertices.iter().map(|p| fu * p.x + fv * p.y + Vec3::new(1.0, 2.0, 3.0)).collect();
    let green = [0.5 * (fu.dot(&fu) - 1.0), 0.5 * (fv.dot(&fv) - 1.0), 0.5 * fu.dot(&fv)];
    for text in [
        "type = \"stvk\"\nlambda_n_per_m = 20.0\nmu_n_per_m = 11.0",
        "type = \"neo_hookean\"\nlambda_n_per_m = 20.0\nmu_n_per_m = 11.0",
        "type = \"measured\"\nfabric = \"gray-interlock\"",
        "type = \"measured\"\nfabric = \"royal-target\"\nstiffness_gradient = \"full\"",
    ] {
        let model = material(text);
        let (energy, gradient) = ask(&Strain::new(&rest, Arc::clone(&model)), &points);
        let psi = caphy_core::extension::MaterialModelExt::at(&*model, green).expect("an answer").energy;
        assert!(
            (energy - psi * rest.area()).abs() < 1e-12 * energy,
            "{text}: {energy} instead of {}",
            psi * rest.area()
        );
        let force = gradient.iter().map(|g| g.norm()).fold(0.0, f64::max);
        let inside = |p: &Vec3| p.x > 1e-6 && p.y > 1e-6 && p.x < 0.08 - 1e-6 && p.y < 0.08 - 1e-6;
        for (p, g) in rest.template.vertices.iter().zip(&gradient).filter(|(p, _)| inside(p)) {
            assert!(g.norm() < 1e-11 * force, "{text}: {g:?} at {p:?}, largest {force}");
        }
        // The boundary's forces balance each other, in force and moment.
        let sum: Vec3 = gradient.iter().sum();
        let moment: Vec3 = points.iter().zip(&gradient).map(|(p, g)| p.cross(g)).sum();
        assert!(sum.norm() < 1e-11 * force && moment.norm() < 1e-10 * force, "{text}");
    }
}

/// Eq. 7's energy of the sheet on a cylinder whose axis lies at an angle to v [degrees], over the plate's ½ k κ² A.
fn mesh_factor(pattern: Pattern, n: usize, axis: f64, radius: f64) -> f64 {
    let rest = rest(n, pattern, 0.0);
    let k = 4e-5;
    let model = material(&format!("type = \"stvk\"\nlambda_n_per_m = 20.0\nmu_n_per_m = 11.0\nbending_nm = {k:e}"));
    let (s, c) = axis.to_radians().sin_cos();
    let roll = |p: &Vec3| {
        let (around, along) = (p.x * c + p.y * s, -p.x * s + p.y * c);
        let angle = around / radius;
        Vec3::new(radius * angle.sin(), along, radius * (1.0 - angle.cos()))
    };
    let points: Vec<Vec3> = rest.template.vertices.iter().map(roll).collect();
    let (energy, _) = ask(&Bending::new(&rest, model, RestAngle::Template), &points);
    energy / (0.5 * k / (radius * radius) * rest.area())
}

#[test]
fn bending_of_a_cylinder_depends_on_the_mesh() {
    // Eq. 7's k is no plate rigidity: these factors of fine meshes are what k has to be multiplied with for this pattern and
    // direction. Along a cell's side: hinges of length h fold by κh over an area h², k h² (κh)² / 8h² = k κ² h² / 8 per cell,
    // a quarter of ½ k κ² h².
    for (pattern, axis, printed) in [
        (Pattern::Diagonal, 0.0, 0.25),
        (Pattern::Diagonal, 45.0, 0.75),
        (Pattern::Diagonal, -45.0, 0.25),
        (Pattern::Alternating, 0.0, 0.25),
        (Pattern::Alternating, 45.0, 0.375),
        (Pattern::Equilateral, 0.0, 0.25),
        (Pattern::Equilateral, 90.0, 0.25),
    ] {
        let factor = mesh_factor(pattern, 40, axis, 1.0);
        println!("{pattern:?} mesh, axis at {axis}° to v: {factor:.3} of the plate's energy");
        // The border has no hinges: a share of 1/40 of each direction is missing, and curvature per cell is 0.01.
        assert!((factor - printed).abs() <= printed / 40.0 + 1e-3, "{pattern:?} {axis}: {factor}");
        // It is the mesh's pattern that counts, not its fineness nor the radius.
        let coarse = mesh_factor(pattern, 20, axis, 1.0);
        assert!((coarse - factor).abs() < 0.04, "{pattern:?} {axis}: {coarse} on half as many cells");
        assert!((mesh_factor(pattern, 40, axis, 0.25) - factor).abs() < 0.01, "{pattern:?} {axis}");
    }
}
