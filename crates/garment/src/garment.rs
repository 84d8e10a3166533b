//! The rest state of a garment: what every energy needs and no pose changes.

use caphy_core::query::{Hinge, hinges};
use caphy_core::units::KilogramPerSquareMetre;
use caphy_core::{Error, Result, TriMesh, Vec3};

/// A triangle whose smallest height is below this share of its longest side has no usable D_m⁻¹: its strain would be
/// rounding noise even in double precision.
const SMALLEST_HEIGHT: f64 = 1e-9;

/// An interior edge with its two faces at rest (Eq. 7).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RestHinge {
    /// Vertices n0, n1 (the edge), n2, n3 (opposite corners); faces are (n0, n1, n2) and (n1, n0, n3).
    pub vertices: [u32; 4],
    /// Faces on the n2 side and on the n3 side.
    pub faces: [u32; 2],
    /// Dihedral angle τ_T of the template [rad]; 0 when flat, positive when the faces fold toward their normal side.
    pub angle: f64,
    /// Edge length in the template [m].
    pub length: f64,
    /// Sum A of both rest areas [m²].
    pub area: f64,
    /// Material vector n0 → n1 in the layout of the face on the n2 side [m].
    pub direction0: [f64; 2],
    /// The same in the layout of the face on the n3 side; differs on a seam.
    pub direction1: [f64; 2],
}

/// Vertices that the body holds, such as a waistband.
#[derive(Debug, Clone, PartialEq)]
pub struct HeldSet {
    /// What it is, for reports: "waistband".
    pub name: String,
    /// Garment vertices.
    pub vertices: Vec<u32>,
    /// Length of boundary that each vertex stands for [m], so that finer templates are not held harder.
    pub lengths: Vec<f64>,
}

/// A garment at rest: template, material frame, masses, hinges, held vertices.
#[derive(Debug, Clone, PartialEq)]
pub struct GarmentRest {
    /// Name in errors and reports.
    pub name: String,
    /// Template V_T and its faces: rest positions on the T-posed body [m].
    pub template: TriMesh,
    /// Material coordinates of the corners of each face along the yarn axes (u, v) [m].
    pub material_uv: Vec<[[f64; 2]; 3]>,
    /// How the yarn axes were chosen, for reports.
    pub grain: String,
    /// D_m⁻¹ [1/m], row-major `[m00, m01, m10, m11]` with D_m = [u1 − u0, u2 − u0] (columns), so that
    /// F = [x1 − x0, x2 − x0] D_m⁻¹ (Eq. 3).
    pub dm_inverse: Vec<[f64; 4]>,
    /// Area of each face in the template [m²]: the quadrature weight of strain, bending and mass.
    ///
    /// A flat layout that does not match the template (SNUG's tubes) changes F only: the template is then not stress-free.
    pub areas: Vec<f64>,
    /// Hinges in the order of [`caphy_core::query::hinges`].
    pub hinges: Vec<RestHinge>,
    /// Area density.
    pub density: KilogramPerSquareMetre,
    /// A third of the area of the faces around each vertex [m²].
    pub vertex_areas: Vec<f64>,
    /// Mass of each vertex [kg].
    pub vertex_masses: Vec<f64>,
    /// Vertices that the body holds.
    pub held: Vec<HeldSet>,
}

impl GarmentRest {
    /// A garment from its template and explicit material coordinates [m] of each face's corners.
    ///
    /// # Errors
    /// [`Error::Length`] for a wrong number of faces in `material_uv`, [`Error::Mesh`] naming the face that has no area (in
    /// the template or in its layout), the edge that is not manifold, or the vertex that is not finite;
    /// [`Error::Parameter`] for a density that is not positive.
    pub fn new(
        name: impl Into<String>,
        template: TriMesh,
        material_uv: Vec<[[f64; 2]; 3]>,
        density: KilogramPerSquareMetre,
        grain: impl Into<String>,
    ) -> Result<Self> {
        let name = name.into();
        template.check(&name)?;
        Error::check_length(
            "material coordinates, one triple of corners per face",
            template.faces.len(),
            material_uv.len(),
        )?;
        if !(density.0 > 0.0 && density.0.is_finite()) {
            return Err(Error::Parameter {
                name: format!("area density of {name}"),
                value: density.0,
                lower: 0.0,
                upper: f64::INFINITY,
                unit: KilogramPerSquareMetre::SYMBOL.into(),
            });
        }
        let areas = template.face_areas();
        let dm_inverse = material_uv
            .iter()
            .enumerate()
            .map(|(face, uv)| {
                check_area(&name, face, "in the template", areas[face], &template.corners(face))?;
                invert_layout(&name, face, uv)
            })
            .collect::<Result<Vec<_>>>()?;
        let hinges = rest_hinges(&name, &template, &material_uv, &areas)?;
        let vertex_areas = template.vertex_areas();
        let vertex_masses = vertex_areas.iter().map(|a| a * density.0).collect();
        Ok(Self {
            name,
            template,
            material_uv,
            grain: grain.into(),
            dm_inverse,
            areas,
            hinges,
            density,
            vertex_areas,
            vertex_masses,
            held: Vec::new(),
        })
    }
    /// Number of vertices.
    pub fn vertex_count(&self) -> usize {
        self.template.vertices.len()
    }
    /// Vertex ids of each triangle.
    pub fn faces(&self) -> &[[u32; 3]] {
        &self.template.faces
    }
    /// Green strain [Guu, Gvv, Guv] of a face (Eqs. 3 and 4) with the vertices at `x` [m].
    pub fn green(&self, face: usize, x: &[Vec3]) -> [f64; 3] {
        let [a, b, c] = self.faces()[face].map(|v| x[v as usize]);
        let [m00, m01, m10, m11] = self.dm_inverse[face];
        let (d1, d2) = (b - a, c - a);
        let (fu, fv) = (d1 * m00 + d2 * m10, d1 * m01 + d2 * m11);
        [0.5 * (fu.norm_squared() - 1.0), 0.5 * (fv.norm_squared() - 1.0), 0.5 * fu.dot(&fv)]
    }
    /// Rest area [m²].
    pub fn area(&self) -> f64 {
        self.areas.iter().sum()
    }
    /// Mass [kg].
    pub fn mass(&self) -> f64 {
        self.area() * self.density.0
    }
    /// Smallest, mean (by area) and largest ratio of layout area to template area: 1 for a layout that was cut from the
    /// template, else the share by which the template is not stress-free.
    pub fn layout_ratio(&self) -> (f64, f64, f64) {
        let mut out = (f64::INFINITY, 0.0, 0.0f64);
        for (m, area) in self.dm_inverse.iter().zip(&self.areas) {
            let layout = 0.5 / (m[0] * m[3] - m[1] * m[2]).abs();
            out = (out.0.min(layout / area), out.1 + layout, out.2.max(layout / area));
        }
        (out.0, out.1 / self.area(), out.2)
    }
    /// The same garment with another area density (a weighed one).
    pub fn with_density(mut self, density: KilogramPerSquareMetre) -> Result<Self> {
        let held = std::mem::take(&mut self.held);
        let mut rest = Self::new(self.name, self.template, self.material_uv, density, self.grain)?;
        rest.held = held;
        Ok(rest)
    }
    /// The same garment that the body also holds at these vertices, usually a boundary loop of
    /// [`caphy_core::query::boundary_loops`].
    ///
    /// A vertex stands for half the boundary edges at it whose other end is held too; without such an edge (a strap's
    /// patch), for the square root of its area.
    pub fn holding(mut self, name: impl Into<String>, vertices: &[u32]) -> Result<Self> {
        let name = name.into();
        let n = self.vertex_count();
        let mut held = vec![false; n];
        for &v in vertices {
            match held.get_mut(v as usize) {
                Some(slot) if !*slot => *slot = true,
                Some(_) => {
                    let problem = format!("appears twice in the held set `{name}`");
                    return Err(Error::mesh(&self.name, format!("vertex {v}"), problem, "name each vertex once"));
                }
                None => {
                    let problem = format!("is held by `{name}` but there are {n} vertices");
                    return Err(Error::mesh(
                        &self.name,
                        format!("vertex {v}"),
                        problem,
                        "hold vertices of this garment",
                    ));
                }
            }
        }
        let mut length = vec![0.0; n];
        let interior: std::collections::HashSet<[u32; 2]> =
            self.hinges.iter().map(|h| [h.vertices[0], h.vertices[1]]).collect();
        for face in &self.template.faces {
            for k in 0..3 {
                let (a, b) = (face[k], face[(k + 1) % 3]);
                if held[a as usize] && held[b as usize] && !interior.contains(&[a.min(b), a.max(b)]) {
                    let half = 0.5 * (self.template.vertices[a as usize] - self.template.vertices[b as usize]).norm();
                    length[a as usize] += half;
                    length[b as usize] += half;
                }
            }
        }
        let lengths = vertices
            .iter()
            .map(|&v| match length[v as usize] {
                0.0 => self.vertex_areas[v as usize].sqrt(),
                length => length,
            })
            .collect();
        self.held.push(HeldSet { name, vertices: vertices.to_vec(), lengths });
        Ok(self)
    }
}

/// Signed dihedral angle [rad] of faces (x0, x1, x2) and (x1, x0, x3) in (−π, π]: 0 when flat, positive when they fold toward
/// their normal side (ARCSim's convention); 0 for a face without area.
///
/// −ê·(N0 × N1) of unit normals equals |e| n0·(x3 − x0) up to the common positive factor of the cosine, with
/// n0 = e × (x2 − x0) and n1 = (x3 − x0) × e.
pub fn dihedral_angle(x: &[Vec3; 4]) -> f64 {
    let (e, a, b) = (x[1] - x[0], x[2] - x[0], x[3] - x[0]);
    let (n0, n1) = (e.cross(&a), b.cross(&e));
    let (sine, cosine) = (e.norm() * n0.dot(&b), n0.dot(&n1));
    if sine == 0.0 && cosine == 0.0 { 0.0 } else { sine.atan2(cosine) }
}

fn rest_hinges(name: &str, template: &TriMesh, uv: &[[[f64; 2]; 3]], areas: &[f64]) -> Result<Vec<RestHinge>> {
    let (good, bad) = hinges(&template.faces);
    if let Some(edge) = bad.first() {
        return Err(Error::mesh(
            name,
            format!("edge {}-{} (and {} more)", edge[0], edge[1], bad.len() - 1),
            "belongs to three or more faces, or to two of opposite orientation".to_string(),
            "make the garment an oriented manifold: split the edge or flip the faces",
        ));
    }
    Ok(good.iter().map(|hinge| rest_hinge(hinge, template, uv, areas)).collect())
}

fn rest_hinge(hinge: &Hinge, template: &TriMesh, uv: &[[[f64; 2]; 3]], areas: &[f64]) -> RestHinge {
    let [n0, n1, ..] = hinge.vertices;
    let direction = |face: u32| {
        let corner = |id: u32| template.faces[face as usize].iter().position(|&v| v == id).unwrap_or(0);
        let (from, to) = (uv[face as usize][corner(n0)], uv[face as usize][corner(n1)]);
        [to[0] - from[0], to[1] - from[1]]
    };
    let x = hinge.vertices.map(|id| template.vertices[id as usize]);
    RestHinge {
        vertices: hinge.vertices,
        faces: hinge.faces,
        angle: dihedral_angle(&x),
        length: (x[1] - x[0]).norm(),
        area: hinge.faces.iter().map(|&f| areas[f as usize]).sum(),
        direction0: direction(hinge.faces[0]),
        direction1: direction(hinge.faces[1]),
    }
}

fn check_area(name: &str, face: usize, place: &str, area: f64, corners: &[Vec3; 3]) -> Result<()> {
    let [a, b, c] = corners;
    let longest = (b - a).norm().max((c - b).norm()).max((a - c).norm());
    if 2.0 * area > SMALLEST_HEIGHT * longest * longest {
        return Ok(());
    }
    Err(Error::mesh(
        name,
        format!("face {face}"),
        format!("has area {area:e} m² {place} with longest side {longest:e} m"),
        "remove or merge degenerate triangles of the template",
    ))
}

fn invert_layout(name: &str, face: usize, uv: &[[f64; 2]; 3]) -> Result<[f64; 4]> {
    Error::check_finite(&format!("material coordinates of face {face} of {name}"), uv.as_flattened())?;
    // Columns of D_m = [[a, b], [c, d]].
    let (a, c) = (uv[1][0] - uv[0][0], uv[1][1] - uv[0][1]);
    let (b, d) = (uv[2][0] - uv[0][0], uv[2][1] - uv[0][1]);
    let determinant = a * d - b * c;
    check_area(name, face, "in its material layout", 0.5 * determinant.abs(), &uv.map(|p| Vec3::new(p[0], p[1], 0.0)))?;
    Ok([d / determinant, -b / determinant, -c / determinant, a / determinant])
}

#[cfg(test)]
mod tests {
    use super::*;

    const DENSITY: KilogramPerSquareMetre = KilogramPerSquareMetre(0.2);

    fn strip(height: f64) -> (TriMesh, Vec<[[f64; 2]; 3]>) {
        let vertices =
            vec![Vec3::zeros(), Vec3::new(0.0, 1.0, 0.0), Vec3::new(-1.0, 0.5, 0.0), Vec3::new(1.0, 0.5, height)];
        let uv = vec![[[0.0, 0.0], [0.0, 1.0], [-1.0, 0.5]], [[0.0, 1.0], [0.0, 0.0], [1.0, 0.5]]];
        (TriMesh { vertices, faces: vec![[0, 1, 2], [1, 0, 3]] }, uv)
    }

    #[test]
    fn the_fold_toward_the_normal_side_is_positive() {
        // Both faces look along +z; the second rises toward +z.
        let (mesh, uv) = strip(1.0);
        assert!(mesh.vertex_normals()[2].z > 0.0);
        let rest = GarmentRest::new("strip", mesh, uv, DENSITY, "test").unwrap();
        assert!((rest.hinges[0].angle - std::f64::consts::FRAC_PI_4).abs() < 1e-15, "{}", rest.hinges[0].angle);
        assert_eq!(rest.hinges[0].direction0, [0.0, 1.0]);
        assert_eq!(rest.hinges[0].direction1, [0.0, 1.0]);
        let (mesh, uv) = strip(-1.0);
        let rest = GarmentRest::new("strip", mesh, uv, DENSITY, "test").unwrap();
        assert!((rest.hinges[0].angle + std::f64::consts::FRAC_PI_4).abs() < 1e-15);
        assert!((rest.mass() - rest.vertex_masses.iter().sum::<f64>()).abs() < 1e-15);
    }

    #[test]
    fn faces_without_area_and_bad_edges_are_named() {
        let (mut mesh, uv) = strip(0.0);
        mesh.vertices[3] = Vec3::new(0.0, 2.0, 0.0);
        let text = GarmentRest::new("strip", mesh, uv, DENSITY, "test").unwrap_err().to_string();
        assert!(text.contains("strip") && text.contains("face 1") && text.contains("template"), "{text}");
        let (mesh, mut uv) = strip(0.0);
        uv[0][2] = [0.0, 0.5];
        let text = GarmentRest::new("strip", mesh, uv, DENSITY, "test").unwrap_err().to_string();
        assert!(text.contains("face 0") && text.contains("layout"), "{text}");
        let (mut mesh, mut uv) = strip(0.0);
        mesh.faces.push([0, 1, 3]);
        uv.push([[0.0, 0.0], [0.0, 1.0], [1.0, 0.5]]);
        let text = GarmentRest::new("strip", mesh, uv, DENSITY, "test").unwrap_err().to_string();
        assert!(text.contains("edge 0-1"), "{text}");
        let (mesh, uv) = strip(0.0);
        assert!(GarmentRest::new("strip", mesh.clone(), uv[..1].to_vec(), DENSITY, "test").is_err());
        assert!(GarmentRest::new("strip", mesh.clone(), uv.clone(), KilogramPerSquareMetre(0.0), "test").is_err());
        let mut nan = uv.clone();
        nan[1][1][0] = f64::NAN;
        assert!(GarmentRest::new("strip", mesh, nan, DENSITY, "test").is_err());
    }

    #[test]
    fn a_held_loop_carries_its_length() {
        let (mesh, uv) = strip(0.0);
        let rest = GarmentRest::new("strip", mesh, uv, DENSITY, "test").unwrap();
        let perimeter = 4.0 * 1.25f64.sqrt();
        let rest = rest.holding("hem", &[0, 3, 1, 2]).unwrap();
        assert!((rest.held[0].lengths.iter().sum::<f64>() - perimeter).abs() < 1e-12);
        assert!(rest.clone().holding("hem", &[0, 9]).is_err());
        assert!(rest.clone().holding("hem", &[0, 0]).is_err());
        assert!(rest.with_density(KilogramPerSquareMetre(0.4)).unwrap().held.len() == 1);
    }
}
