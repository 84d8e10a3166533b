//! Garment templates (Sec. 3.1): cut here on any body in the SMPL-X joint layout, or given.
//!
//! Differs from the paper: TailorNet's style space is not free to use, so by default shirts and trousers are cut here from the
//! body's own convex sections ([`Style`]); the choice by Chamfer distance among samples of the style space
//! ([`choose_template`]) is the paper's. Where templates come from is a [`TemplateSource`]: the parametric style space, a
//! folder of meshes, one mesh, or a linear style space in the form that TailorNet's can be exported to. A template is the
//! garment as worn on the T-pose, outside the body; it is not draped.

mod choose;
mod distance;
mod ease;
mod facts;
mod girth;
mod given;
mod grain;
mod loops;
mod refine;
mod remesh;
mod response;
mod rest;
mod rim;
mod sections;
mod shape;
mod source;
mod style;
mod surface;
mod ways;

pub use choose::{Chamfer, Choice, ChooseOptions, choose_template, hung_like, pose_by_nearest_vertex, pose_by_weights};
pub use ease::ease;
pub use facts::{GarmentFacts, GarmentMeasures, LengthFacts, LoopFacts, MeasureErrors, Quantiles};
pub use given::{FitOptions, GivenFacts, GivenMesh, LayoutFacts, PenetrationFacts, PenetrationOptions, Repairs};
pub use refine::{Refinement, Seen, Worn, WornAs, finish, refine};
pub use rest::BodyRest;
pub use rim::Rim;
pub use source::{
    TemplateFolder, TemplateLinear, TemplateMesh, TemplateParametric, TemplateSource, TemplateSpec, read_garment,
    templates,
};
pub use style::{
    GarmentKind, GivenStyle, LOWER_RANGES, LowerStyle, Style, StyleRange, UPPER_RANGES, UpperStyle, sample_styles,
};

use caphy_core::query::{Adjacency, NearestGrid, boundary_loops, hinges};
use caphy_core::{Error, Result, TriMesh, Vec3};
use distance::{DistanceGrid, Skin};
use rayon::prelude::*;
use rest::Landmarks;
pub(crate) use rest::{Limb, limb_of};
use serde::{Deserialize, Serialize};
use shape::{GAP, Shape};

/// Finest and coarsest edge length that a template can be asked for [m].
pub const RESOLUTION_RANGE: StyleRange = StyleRange { name: "resolution", unit: "m", lower: 0.006, upper: 0.05 };
/// No vertex, edge middle or face middle of a template is nearer to the skin than this [m].
const CLEARANCE: f64 = 0.0035;

/// Distances to the skin beyond this are not told apart [m].
const FAR: f64 = 0.06;
/// From here on the sign of the distance grid is beyond doubt [m]: its cell.
const GRID_SURE: f64 = 0.008;

/// A named boundary of a garment.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct NamedLoop {
    /// `neck`, `cuff_left`, `cuff_right`, `hem` or `waist`; of given garments also `bust` (the upper end of a strapless top),
    /// `leg_left` and `leg_right` (of an upper garment with legs), `opening_1`, … (around no limb).
    pub name: String,
    /// Vertices in order around the loop, the garment on their left seen from outside.
    pub vertices: Vec<u32>,
}

/// A garment on the T-posed body.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Template {
    /// What it covers.
    pub kind: GarmentKind,
    /// Its point in the style space.
    pub style: Style,
    /// Rest surface: manifold, one component, open at its loops.
    pub mesh: TriMesh,
    /// Nearest body vertex of each garment vertex, whose skinning weights it takes (Sec. 3.2), shape [vertex_count].
    pub weights_body_vertex: Vec<u32>,
    /// Boundaries, in the order neck, cuffs, hem or waist, cuffs.
    pub loops: Vec<NamedLoop>,
    /// Corner coordinates (u, v) [m] in each rest triangle's plane, shape [face_count, 3, 2]; u along the grain. Isometric to
    /// the rest triangle; faces do not join into a layout.
    pub material_uv: Vec<[[f64; 2]; 3]>,
    /// Edge length asked for; of a given garment its mean edge length [m].
    pub resolution_m: f64,
    /// What the grain follows, in words.
    pub grain: String,
    /// Smallest distance of its vertices to the skin [m].
    pub clearance_m: f64,
    /// What was done to a garment that was not cut here.
    #[serde(default)]
    pub given: Option<GivenFacts>,
}

impl Template {
    /// Rest area [m²].
    pub fn area(&self) -> f64 {
        self.mesh.face_areas().iter().sum()
    }
    /// Length of each loop [m]: neck, cuff, hem or waist girth.
    pub fn girths(&self) -> Vec<(String, f64)> {
        self.loops
            .iter()
            .map(|l| {
                let next = l.vertices.iter().cycle().skip(1);
                let place = |v: &u32| self.mesh.vertices[*v as usize];
                (l.name.clone(), l.vertices.iter().zip(next).map(|(a, b)| (place(a) - place(b)).norm()).sum())
            })
            .collect()
    }
    /// Loops that the body holds: the waistband of trousers and skirts, the upper end of a strapless top. Shirts hang on the
    /// shoulders.
    pub fn attachments(&self) -> impl Iterator<Item = &NamedLoop> {
        attachments(&self.loops)
    }
    /// A loop by name.
    pub fn boundary(&self, name: &str) -> Option<&NamedLoop> {
        self.loops.iter().find(|l| l.name == name)
    }
}

/// Those of named loops that the body holds; see [`Template::attachments`].
pub fn attachments(loops: &[NamedLoop]) -> impl Iterator<Item = &NamedLoop> {
    loops.iter().filter(|l| matches!(l.name.as_str(), "waist" | "bust"))
}

/// A body measured once, on which any number of garments can be cut.
#[derive(Debug, Clone)]
pub struct Tailor {
    body: BodyRest,
    marks: Landmarks,
    grid: DistanceGrid,
    skin: Skin,
    /// Body vertices that shirts and trousers may hang on, with their search.
    reach: [(Vec<u32>, NearestGrid<f64>); 2],
}

impl Tailor {
    /// Measures a body at rest.
    ///
    /// # Errors
    /// Those of [`BodyRest::new`]; [`Error::Mesh`] when a limb has no surface or the joints are no body's.
    pub fn new(body: BodyRest) -> Result<Self> {
        let body = BodyRest::new(body.mesh, body.joints, body.weights)?;
        let marks = Landmarks::measure(&body)?;
        let dominant: Vec<Limb> = (0..body.mesh.vertices.len())
            .map(|v| {
                let best = body.weights.row(v).fold((0, 0.0), |b, (j, w)| if w > b.1 { (j, w) } else { b });
                limb_of(best.0)
            })
            .collect();
        let hangs_on = |upper: bool| {
            let ids: Vec<u32> = (0..dominant.len() as u32)
                .filter(|&v| match dominant[v as usize] {
                    Limb::Trunk | Limb::Leg(_) => true,
                    Limb::Arm(_) => upper,
                    Limb::Foot(_) => !upper,
                    Limb::Head | Limb::Hand(_) => false,
                })
                .collect();
            let points: Vec<Vec3> = ids.iter().map(|&v| body.mesh.vertices[v as usize]).collect();
            let grid = NearestGrid::from_points(&points);
            (ids, grid)
        };
        let reach = [hangs_on(true), hangs_on(false)];
        let worn = (0..dominant.len())
            .filter(|&v| !matches!(dominant[v], Limb::Head | Limb::Hand(_)))
            .map(|v| body.mesh.vertices[v]);
        let (low, high) = worn.fold((Vec3::repeat(f64::INFINITY), Vec3::repeat(f64::NEG_INFINITY)), |(lo, hi), p| {
            (lo.inf(&p), hi.sup(&p))
        });
        let size = high - low;
        if !(size.max() > 0.3 && size.max() < 5.0) {
            let problem = format!("measures {:.3} × {:.3} × {:.3} m without head and hands", size.x, size.y, size.z);
            return Err(Error::mesh("body at rest", "whole mesh", problem, "give a whole body in metres"));
        }
        let grid = DistanceGrid::new(&body.mesh, low, high);
        let skin = Skin::new(&body.mesh)?;
        Ok(Self { body, marks, grid, skin, reach })
    }

    /// The body.
    pub fn body(&self) -> &BodyRest {
        &self.body
    }

    /// Cuts one garment with edges of about `resolution_m` [m].
    ///
    /// # Errors
    /// [`Error::Parameter`] for a style or resolution outside its range; [`Error::Numerics`] when the surface does not come
    /// out as one piece with its loops (a body whose limbs are no limbs).
    pub fn generate(&self, style: &Style, resolution_m: f64) -> Result<Template> {
        style.check()?;
        RESOLUTION_RANGE.check(resolution_m)?;
        // Flat triangles cut corners: on a limb of 4.5 cm radius an edge L sags by L²/8r.
        let gap = GAP + resolution_m * resolution_m / (8.0 * 0.045);
        let shape = match style {
            Style::Upper(s) => Shape::upper(&self.marks, &self.grid, s, gap),
            Style::Lower(s) => Shape::lower(&self.marks, &self.grid, s, gap),
            Style::Given(s) => {
                let what = format!("`{}`, which is no point of the parametric style space", s.name);
                return Err(Error::unsupported(what, "the parametric style space"));
            }
        };
        let raw = surface::extract(&shape, (0.7 * resolution_m).min(0.02));
        let (mut mesh, cuts) = remesh::remesh(&shape, &raw, resolution_m);
        self.push_out(&mut mesh);
        let loops = named_loops(&shape, &mesh, &cuts, style)?;

        let weights_body_vertex = self.nearest_skin(style.kind(), &mesh);
        let material_uv = grain::material_uv(&mesh, &self.body, &weights_body_vertex);
        let clearance_m = mesh.vertices.iter().map(|p| self.distance(p)).fold(f64::INFINITY, f64::min);
        Ok(Template {
            kind: style.kind(),
            style: style.clone(),
            mesh,
            weights_body_vertex,
            loops,
            material_uv,
            resolution_m,
            grain: grain::GRAIN_NOTE.into(),
            clearance_m,
            given: None,
        })
    }

    /// Nearest body vertex of each garment vertex among those that it may hang on.
    fn nearest_skin(&self, kind: GarmentKind, mesh: &TriMesh) -> Vec<u32> {
        let (ids, grid) = &self.reach[usize::from(kind == GarmentKind::Lower)];
        mesh.vertices.iter().map(|p| grid.nearest_point(p).map_or(0, |(i, _)| ids[i as usize])).collect()
    }

    /// Cuts many garments in parallel; the result does not depend on the number of threads.
    ///
    /// # Errors
    /// The first failure in the order of the styles, as [`Tailor::generate`].
    pub fn generate_all(&self, styles: &[Style], resolution_m: f64) -> Result<Vec<Template>> {
        let made: Vec<Result<Template>> = styles.par_iter().map(|s| self.generate(s, resolution_m)).collect();
        made.into_iter().collect()
    }

    /// Signed distance of a point to the skin [m], negative inside, and the direction out of the body; `None` where the skin is
    /// farther than `limit`.
    pub(crate) fn skin(&self, p: &Vec3, limit: f64) -> Option<(f64, Vec3)> {
        let (q, d, out) = self.skin.signed(p, limit)?;
        // Well inside or outside, the grid's flood knows the side, also where limbs overlap.
        let rough = self.grid.value(p);
        let sure = rough.abs() > GRID_SURE;
        if sure && (rough < 0.0) != (d < 0.0) {
            return Some((-d, ((p - q) * -d.signum()).try_normalize(1e-9).unwrap_or(-out)));
        }
        Some((d, out))
    }
    /// Signed distance of a point to the skin [m], negative inside; [`FAR`] beyond that.
    pub(crate) fn distance(&self, p: &Vec3) -> f64 {
        match self.skin(p, FAR) {
            Some((d, _)) => d,
            None if self.grid.value(p) < 0.0 => -FAR,
            None => FAR,
        }
    }

    /// Moves vertices out until vertices, edge middles and face middles keep their clearance.
    fn push_out(&self, mesh: &mut TriMesh) {
        for _ in 0..6 {
            let mut push = vec![(0.0f64, Vec3::zeros()); mesh.vertices.len()];
            let mut any = false;
            let mut need = |p: &Vec3, of: &[u32]| {
                if self.grid.value(p) > 2.0 * CLEARANCE {
                    return;
                }
                let Some((signed, out)) = self.skin(p, 0.03) else { return };
                let missing = CLEARANCE - signed;
                if missing > 0.0 {
                    any = true;
                    for &v in of {
                        if missing > push[v as usize].0 {
                            push[v as usize] = (missing, out);
                        }
                    }
                }
            };
            for (v, p) in mesh.vertices.iter().enumerate() {
                need(p, &[v as u32]);
            }
            for f in &mesh.faces {
                let p = f.map(|v| mesh.vertices[v as usize]);
                need(&((p[0] + p[1] + p[2]) / 3.0), f);
                for k in 0..3 {
                    if f[k] < f[(k + 1) % 3] {
                        need(&((p[k] + p[(k + 1) % 3]) * 0.5), &[f[k], f[(k + 1) % 3]]);
                    }
                }
            }
            if !any {
                break;
            }
            for (p, (amount, out)) in mesh.vertices.iter_mut().zip(&push) {
                *p += out * (amount * 1.1);
            }
        }
    }
}

/// Cuts one garment on a body; for several on the same body, share a [`Tailor`].
///
/// # Errors
/// As [`Tailor::new`] and [`Tailor::generate`].
pub fn generate(body: &BodyRest, style: &Style, resolution_m: f64) -> Result<Template> {
    Tailor::new(body.clone())?.generate(style, resolution_m)
}

/// Checks that the mesh is one manifold piece with a loop per cut, and names them.
fn named_loops(shape: &Shape<'_>, mesh: &TriMesh, cuts: &[u8], style: &Style) -> Result<Vec<NamedLoop>> {
    let failed = |problem: String| {
        let remedy = "look at the body at rest (T-pose, metres, y up, facing +z) or choose a less extreme style";
        Err(Error::numerics(format!("garment template {style:?}"), problem, remedy))
    };
    if mesh.faces.is_empty() || !mesh.vertices.iter().all(|p| p.iter().all(|c| c.is_finite())) {
        return failed(format!("the surface has {} faces, some perhaps not finite", mesh.faces.len()));
    }
    let bad = hinges(&mesh.faces).1;
    let pieces = Adjacency::new(mesh.vertices.len(), &mesh.faces).components().1;
    let rings = boundary_loops(&mesh.faces);
    if !bad.is_empty() || pieces != 1 || rings.len() != shape.cuts.len() {
        return failed(format!(
            "{} non-manifold edges, {pieces} pieces, {} boundary loops instead of {}",
            bad.len(),
            rings.len(),
            shape.cuts.len()
        ));
    }
    let mut loops = Vec::new();
    for (k, cut) in shape.cuts.iter().enumerate() {
        let own = |ring: &&Vec<u32>| {
            let on = ring.iter().filter(|&&v| usize::from(cuts[v as usize]) == k).count();
            2 * on > ring.len()
        };
        match rings.iter().find(own) {
            Some(ring) => loops.push(NamedLoop { name: cut.name.into(), vertices: ring.clone() }),
            None => return failed(format!("no boundary loop belongs to the {}", cut.name)),
        }
    }
    Ok(loops)
}
