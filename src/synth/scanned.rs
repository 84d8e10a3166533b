//! The person as a capture rig sees them: one outer surface with its own triangles, colours, noise and holes.

use super::{Person, Worn};
use crate::config::{RigConfig, Texture};
use crate::random::{normal, uniform};
use crate::scene::label_of;
use caphy_core::pose::Pose;
use caphy_core::query::{NearestGrid, NearestSurface, PseudoNormals, boundary_loops};
use caphy_core::scan::{Label, Scan};
use caphy_core::{Result, TriMesh, Vec3, mesh};
use caphy_garment::template::BodyRest;
use caphy_render::capture::{Origin, Rig};
use rand_chacha::ChaCha8Rng;

/// A scan and what is true of it.
#[derive(Debug, Clone)]
pub struct Scanned {
    /// The scan; with labels where the rig is told to store them.
    pub scan: Scan,
    /// The true label of every vertex.
    pub labels: Vec<Label>,
    /// Joints of the body [m].
    pub joints: Vec<Vec3>,
}

/// What is under cloth gives way until it is this deep [m], by at most so much: contact holds off the cloth's vertices, and skin would
/// show through the triangles between them. No more than that within [`LOOKED_INTO`] of a border, where cameras see into sleeves and
/// trouser legs; all of it a little farther in.
const DEPTH: f64 = 3e-3;
const GIVES_WAY: f64 = 8e-3;
const LOOKED_INTO: f64 = 0.06;
const FARTHER_IN: f64 = 0.04;
/// Beside a garment's border skin gives way less and less, over this distance [m]: its own triangles reach over the border.
const BESIDE: f64 = 0.012;
/// Skin is under cloth that is nearer than this [m].
const UNDER: f64 = 0.06;

/// Scans a person in a pose.
///
/// # Errors
/// Of the body and of the rig.
pub fn scan(
    rig: &RigConfig,
    person: &Person,
    pose: &Pose,
    worn: &Worn,
    name: &str,
    rng: &mut ChaCha8Rng,
) -> Result<Scanned> {
    let posed = person.body.forward(&person.subject.posed(pose))?;
    // Neither skin nor cloth is faceted.
    let skin = mesh::rounded(&posed.vertices, &person.body.describe().faces);
    // Body first, then garments from inside out.
    let mut layers = vec![(skin, Label::Body)];
    for (garment, shape) in person.garments.iter().zip(&worn.shapes).rev() {
        let cloth = mesh::rounded(shape, &garment.mesh.faces);
        for (layer, _) in &mut layers {
            give_way(layer, &cloth)?;
        }
        layers.push((cloth, label_of(garment.kind)));
    }
    let parts: Vec<&TriMesh> = layers.iter().map(|l| &l.0).collect();
    let fused = Rig { cameras: rig.cameras, pixels: rig.pixels, cell_m: rig.edge_m }.capture(&parts)?;

    let paint = Paint::new(person, rig.texture, &layers)?;
    let mut surface = fused.mesh;
    let colours: Vec<[u8; 3]> = fused.origins.iter().map(|origin| paint.colour(origin, rng)).collect();
    let labels: Vec<Label> = fused.origins.iter().map(|origin| layers[origin.part as usize].1).collect();
    let normals = surface.vertex_normals();
    let keep = without_holes(&surface, rig, rng);
    for (v, n) in surface.vertices.iter_mut().zip(&normals) {
        *v += n * (rig.noise_m * normal(rng));
    }
    let (mesh, old) = surface.submesh(&keep);
    let labels: Vec<Label> = old.iter().map(|&v| labels[v as usize]).collect();
    let colours = Some(old.iter().map(|&v| colours[v as usize]).collect());
    let stored = rig.labels.then(|| labels.clone());
    Ok(Scanned { scan: Scan { name: name.into(), mesh, colours, labels: stored }, labels, joints: posed.joints })
}

/// Moves what lies under cloth inwards.
fn give_way(inner: &mut TriMesh, cloth: &TriMesh) -> Result<()> {
    let surface = NearestSurface::from_mesh(cloth)?;
    let border: Vec<Vec3> =
        boundary_loops(&cloth.faces).into_iter().flatten().map(|v| cloth.vertices[v as usize]).collect();
    let border = NearestGrid::from_points(&border);
    let cloth_normals = PseudoNormals::new(&cloth.vertices, &cloth.faces);
    let normals = inner.vertex_normals();
    for (p, n) in inner.vertices.iter_mut().zip(&normals) {
        let Some(found) = surface.nearest_within(p, UNDER * UNDER) else { continue };
        let up = cloth_normals.at(&found).try_normalize(0.0).unwrap_or(*n);
        let above = up.dot(&(*p - found.point));
        // A hand that touches trousers is not under them.
        if above > GIVES_WAY || up.dot(n) < 0.0 {
            continue;
        }
        let beside = (found.squared_distance - above * above).max(0.0).sqrt();
        let share = (1.0 - beside / BESIDE).max(0.0);
        let edge = border.nearest_point(p).map_or(f64::INFINITY, |(_, square)| square.sqrt());
        let inside = ((edge - LOOKED_INTO) / FARTHER_IN).clamp(0.0, 1.0);
        *p -= n * ((above + DEPTH).clamp(GIVES_WAY * inside, GIVES_WAY) * share);
    }
    Ok(())
}

/// Vertices outside of all holes.
fn without_holes(surface: &TriMesh, rig: &RigConfig, rng: &mut ChaCha8Rng) -> Vec<bool> {
    let mut keep = vec![true; surface.vertices.len()];
    for _ in 0..rig.holes {
        let at = uniform(rng, 0.0, surface.vertices.len() as f64) as usize;
        let Some(centre) = surface.vertices.get(at) else { continue };
        for (keep, v) in keep.iter_mut().zip(&surface.vertices) {
            *keep &= (v - centre).norm() > rig.hole_radius_m;
        }
    }
    keep
}

/// Colours of all layers.
struct Paint<'a> {
    layers: &'a [(TriMesh, Label)],
    /// Normals of each layer as posed.
    normals: Vec<Vec<Vec3>>,
    /// Vertices of each layer in the T-pose [m]: where patterns lie.
    rest: Vec<Vec<Vec3>>,
    /// Which share of a vertex of the body has hair on it, and a shoe [1].
    hair: Vec<f64>,
    shoes: Vec<f64>,
    texture: Texture,
}

/// sRGB.
type Colour = [f64; 3];
const SKIN: Colour = [205.0, 160.0, 134.0];
const HAIR: Colour = [70.0, 52.0, 40.0];
const SHOES: Colour = [150.0, 148.0, 150.0];
const SHIRT: [Colour; 2] = [[46.0, 84.0, 140.0], [120.0, 165.0, 205.0]];
const TROUSERS: [Colour; 2] = [[70.0, 66.0, 62.0], [98.0, 90.0, 58.0]];
/// Period of stripes and checks [m].
const PERIOD: f64 = 0.06;
/// Where the light comes from, and its share.
const LIGHT: [f64; 3] = [0.35, 0.8, 0.5];
const LIGHT_SHARE: f64 = 0.4;
/// Mottling of dyed cloth and skin, as a share.
const MOTTLE: f64 = 0.04;

impl<'a> Paint<'a> {
    fn new(person: &Person, texture: Texture, layers: &'a [(TriMesh, Label)]) -> Result<Self> {
        let body = person.body.describe();
        let body_rest = BodyRest::from_model(&*person.body, &person.subject)?;
        let strongest =
            |v: usize| body.weights.row(v).fold((0, 0.0), |best, (j, w)| if w > best.1 { (j, w) } else { best }).0;
        let named = |v: usize, names: &[&str]| {
            let name = body.joints[strongest(v)].name.as_str();
            names.iter().any(|n| name.ends_with(n))
        };
        let head = body_rest.joints[caphy_core::pose::smplx_joint("head").unwrap_or(0)];
        let crown = body_rest.mesh.vertices.iter().map(|v| v.y).fold(f64::NEG_INFINITY, f64::max);
        let count = body_rest.mesh.vertices.len();
        let hair = (0..count).map(|v| {
            let p = body_rest.mesh.vertices[v] - head;
            // Above a slanted line from the brow down to the nape.
            named(v, &["head", "jaw"]) && p.y > 0.55 * (crown - head.y) + 0.9 * p.z.min(0.1)
        });
        let shoes = (0..count).map(|v| named(v, &["ankle", "foot"]));
        let dressed: Vec<Vec3> = hair.zip(shoes).map(|(h, s)| Vec3::new(f64::from(h), f64::from(s), 0.0)).collect();
        let dressed = TriMesh { vertices: dressed, faces: body_rest.mesh.faces.clone() }.subdivided().vertices;
        let (hair, shoes) = dressed.iter().map(|d| (d.x, d.y)).unzip();
        let mut rest = vec![body_rest.mesh.subdivided().vertices];
        rest.extend(person.templates.iter().rev().map(|t| t.mesh.subdivided().vertices));
        let normals = layers.iter().map(|(m, _)| mesh::vertex_normals(&m.vertices, &m.faces)).collect();
        Ok(Self { layers, normals, rest, hair, shoes, texture })
    }

    fn colour(&self, origin: &Origin, rng: &mut ChaCha8Rng) -> [u8; 3] {
        let part = origin.part as usize;
        let (surface, label) = &self.layers[part];
        let face = surface.faces[origin.face as usize].map(|v| v as usize);
        let mixed =
            |values: &[Vec3]| -> Vec3 { face.iter().zip(&origin.barycentric).map(|(&v, w)| values[v] * *w).sum() };
        let share = |of: &[f64]| -> f64 { face.iter().zip(&origin.barycentric).map(|(&v, w)| of[v] * w).sum() };
        let patterned = self.texture == Texture::Patterned;
        let at = mixed(&self.rest[part]);
        let stripe = |x: f64| usize::from(x.rem_euclid(PERIOD) < 0.5 * PERIOD);
        let base = match label {
            Label::Upper => SHIRT[if patterned { stripe(at.y) } else { 0 }],
            Label::Lower => TROUSERS[if patterned { stripe(at.y) ^ stripe(at.x) } else { 0 }],
            _ if patterned && share(&self.hair) > 0.5 => HAIR,
            _ if patterned && share(&self.shoes) > 0.5 => SHOES,
            _ => SKIN,
        };
        let lit = if patterned {
            let normal = mixed(&self.normals[part]).try_normalize(0.0).unwrap_or_else(Vec3::y);
            let towards = normal.dot(&Vec3::from(LIGHT).normalize());
            // Wrapped around, as under a sky.
            1.0 - LIGHT_SHARE * (0.5 - 0.5 * towards)
        } else {
            1.0
        };
        let shade = lit * (1.0 + MOTTLE * normal(rng));
        base.map(|c| (c * shade).clamp(0.0, 255.0) as u8)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A square of 0.4 m with edges of 2 cm, facing +z.
    fn sheet(x: f64, z: f64) -> TriMesh {
        let at = |i: u32| Vec3::new(x + 0.02 * f64::from(i % 21), 0.02 * f64::from(i / 21), z);
        let square = |i: u32| [[i, i + 1, i + 21], [i + 1, i + 22, i + 21]];
        let faces = (0..420).filter(|i| i % 21 < 20).flat_map(square).collect();
        TriMesh { vertices: (0..441).map(at).collect(), faces }
    }

    #[test]
    fn skin_gives_way_where_it_would_show() {
        let depths = |cloth: &TriMesh| {
            let mut skin = sheet(0.0, 0.0);
            give_way(&mut skin, cloth).unwrap();
            skin.vertices.iter().map(|p| (p.x, -p.z)).collect::<Vec<_>>()
        };
        // Within 6 cm of a border: here the left one.
        let all = |list: &[(f64, f64)], want: f64| list.iter().all(|(x, d)| *x > 0.05 || (d - want).abs() < 1e-9);
        // Cloth 1 mm above the right half; skin 2 cm beside it stays.
        let half = depths(&sheet(0.2, 0.001));
        let wanted = |x: f64| if x > 0.199 { DEPTH - 0.001 } else { 0.0 };
        assert!(half.iter().all(|&(x, d)| x > 0.25 || (d - wanted(x)).abs() < 1e-9), "{half:?}");
        assert!(all(&depths(&sheet(0.0, -0.002)), DEPTH + 0.002), "skin showed through");
        let loose = depths(&sheet(0.0, 0.02));
        assert!(all(&loose, 0.0), "cameras look in");
        assert!((loose[220].1 - GIVES_WAY).abs() < 1e-9, "20 cm from all borders nothing is seen");
        let mut turned = sheet(0.0, -0.002);
        turned.faces.iter_mut().for_each(|f| f.swap(1, 2));
        assert!(depths(&turned).iter().all(|(_, d)| *d == 0.0), "a hand on trousers");
    }
}
