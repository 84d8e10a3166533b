//! Garments that were not cut here: from a file, registered or sampled from a linear space, made ready to be worn.
//!
//! A given garment lies on the T-posed body. It is checked for its place, repaired, turned outward, its boundary loops are
//! named, its triangles split towards the resolution asked for, and it is moved out of the body. Whatever was done is in
//! [`GivenFacts`]; what cannot be done is refused with the element.

mod layout;
mod penetration;
mod placement;
mod refine;
mod repair;

pub use layout::LayoutFacts;
pub use penetration::{PenetrationFacts, PenetrationOptions};
pub use repair::Repairs;

use super::loops::Openings;
use super::style::{GarmentKind, GivenStyle, Style};
use super::{FAR, RESOLUTION_RANGE, Tailor, Template, grain};
use caphy_core::{Error, Result, TriMesh, Vec3};
use serde::{Deserialize, Serialize};

/// Most faces that splitting may lead to.
const MOST_FACES: usize = 1_000_000;

/// A garment as a file holds it.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct GivenMesh {
    /// Name in messages and artifacts.
    pub name: String,
    /// Surface on the T-posed body, in the file's own unit.
    pub mesh: TriMesh,
    /// Layout coordinates of each face's corners in their own unit, shape [face_count, 3, 2], where there is a layout.
    pub uv: Option<Vec<[[f64; 2]; 3]>>,
}

/// How a given garment is brought onto the body.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FitOptions {
    /// What it covers. Default: found out from where its openings are.
    pub kind: Option<GarmentKind>,
    /// Metres per unit of the file. Default 1.
    pub metres_per_unit: f64,
    /// Added to positions after that [m]. Default none.
    pub translation_m: [f64; 3],
    /// Whether triangles are split until edges are about the resolution asked for. Default true: made for characters, given
    /// garments have edges of several centimetres.
    pub split: bool,
    /// Getting it out of the body.
    pub penetration: PenetrationOptions,
}

impl Default for FitOptions {
    fn default() -> Self {
        Self {
            kind: None,
            metres_per_unit: 1.0,
            translation_m: [0.0; 3],
            split: true,
            penetration: PenetrationOptions::default(),
        }
    }
}

/// What was done to a given garment.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct GivenFacts {
    /// Repairs of its mesh.
    pub repairs: Repairs,
    /// Whether the kind was given or found out.
    pub kind_given: bool,
    /// Its layout, where it has one.
    pub layout: Option<LayoutFacts>,
    /// Times that every triangle was split into four.
    pub splits: usize,
    /// Getting it out of the body.
    pub penetration: PenetrationFacts,
    /// Shape coefficients of the body that its maker dressed, where the source names them: another shape is what
    /// penetrations or a loose fit may come from.
    pub made_for_shape: Vec<f64>,
}

impl Tailor {
    /// What a given garment covers, by the limbs that go through its openings; a tube around the trunk by its height.
    ///
    /// # Errors
    /// [`Error::Mesh`] as for [`Tailor::fit`].
    pub fn kind_of(&self, given: GivenMesh, options: &FitOptions) -> Result<GarmentKind> {
        if let Some(kind) = options.kind {
            return Ok(kind);
        }
        let (given, _) = self.placed(given, options)?;
        Ok(self.kind_from_openings(&given.mesh, &Openings::find(&given.mesh, &self.body)))
    }

    /// Makes a template of a garment that lies on the T-posed body, with edges of about `resolution_m` [m] if it may be
    /// split; `coefficients` are what its source made it from, for the record.
    ///
    /// # Errors
    /// [`Error::Mesh`] naming the element: what cannot be repaired (no faces, values that are not finite, edges of three faces,
    /// triangles without area, several large pieces, no opening), a garment that is not on the body (with the unit that
    /// would put it there), or that is deeper inside it than the options allow; [`Error::Parameter`] for options out of
    /// range; [`Error::Numerics`] when parts of it cannot be brought out of the body.
    pub fn fit(
        &self,
        given: GivenMesh,
        coefficients: &[f64],
        resolution_m: f64,
        options: &FitOptions,
    ) -> Result<Template> {
        RESOLUTION_RANGE.check(resolution_m)?;
        let (GivenMesh { name, mut mesh, mut uv }, mut repairs) = self.placed(given, options)?;
        let openings = Openings::find(&mesh, &self.body);
        let kind = options.kind.unwrap_or_else(|| self.kind_from_openings(&mesh, &openings));
        if self.faces_inward(&mesh) {
            repairs.turned_inside_out = true;
            mesh.faces.iter_mut().for_each(|f| f.swap(1, 2));
            if let Some(uv) = &mut uv {
                uv.iter_mut().for_each(|c| c.swap(1, 2));
            }
        }
        let mut layout = None;
        let mut pattern = None;
        if let Some(uv) = uv {
            let (metric, facts) = layout::metric_layout(&mesh, &uv);
            (pattern, layout) = (metric, Some(facts));
        }
        let splits = match options.split {
            true => (0..=refine::splits_for(&mesh, resolution_m))
                .rev()
                .find(|&n| mesh.faces.len() << (2 * n) <= MOST_FACES)
                .unwrap_or(0),
            false => 0,
        };
        for _ in 0..splits {
            (mesh, pattern) = refine::split(&mesh, pattern.as_deref());
        }
        let penetration = penetration::resolve(&name, &mut mesh, self, &options.penetration)?;
        // Named last: splitting has added vertices to them.
        let loops = Openings::find(&mesh, &self.body).named(&name, kind)?;
        let weights_body_vertex = self.nearest_skin(kind, &mesh);
        let (material_uv, grain) = match (pattern, &layout) {
            (Some(pattern), Some(facts)) => (pattern, facts.note()),
            _ => (grain::material_uv(&mesh, &self.body, &weights_body_vertex), grain::GRAIN_NOTE.to_string()),
        };
        let clearance_m = mesh.vertices.iter().map(|p| self.distance(p)).fold(f64::INFINITY, f64::min);
        Ok(Template {
            kind,
            style: Style::Given(GivenStyle { garment: kind, name, coefficients: coefficients.to_vec() }),
            resolution_m: mesh.mean_edge_length(),
            mesh,
            weights_body_vertex,
            loops,
            material_uv,
            grain,
            clearance_m,
            given: Some(GivenFacts {
                repairs,
                kind_given: options.kind.is_some(),
                layout,
                splits,
                penetration,
                made_for_shape: Vec::new(),
            }),
        })
    }

    /// In metres, on the body, repaired.
    fn placed(&self, mut given: GivenMesh, options: &FitOptions) -> Result<(GivenMesh, Repairs)> {
        let scale = options.metres_per_unit;
        if !(scale > 0.0 && scale.is_finite()) {
            return Err(Error::Parameter {
                name: "metres_per_unit".into(),
                value: scale,
                lower: f64::MIN_POSITIVE,
                upper: f64::MAX,
                unit: "m".into(),
            });
        }
        Error::check_finite("translation_m of a given garment", &options.translation_m)?;
        let shift = Vec3::from(options.translation_m);
        given.mesh.vertices.iter_mut().for_each(|p| *p = *p * scale + shift);
        given.mesh.check(&given.name)?;
        if given.mesh.faces.is_empty() {
            // Said by the repair in better words.
            return repair::repair(given);
        }
        placement::check_placement(&given.name, &given.mesh, self)?;
        repair::repair(given)
    }

    fn kind_from_openings(&self, mesh: &TriMesh, openings: &Openings) -> GarmentKind {
        openings.kind().unwrap_or_else(|| {
            let areas = mesh.vertex_areas();
            let above = mesh.vertices.iter().zip(&areas).filter(|(p, _)| p.y > self.marks.waist);
            let share = above.map(|(_, a)| a).sum::<f64>() / areas.iter().sum::<f64>();
            if share > 0.5 { GarmentKind::Upper } else { GarmentKind::Lower }
        })
    }

    /// Whether more of the surface looks at the body than away from it.
    fn faces_inward(&self, mesh: &TriMesh) -> bool {
        let sum: f64 = (0..mesh.faces.len())
            .map(|f| {
                let [a, b, c] = mesh.corners(f);
                let normal = (b - a).cross(&(c - a));
                let centre = (a + b + c) / 3.0;
                self.skin(&centre, FAR).map_or(0.0, |(_, out)| normal.dot(&out))
            })
            .sum();
        sum < 0.0
    }
}
