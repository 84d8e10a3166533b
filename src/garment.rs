//! A subject's garments as stages hand them on.

use crate::trainer::CurvePoint;
use caphy_core::body::BlendWeights;
use caphy_core::material::MaterialModel;
use caphy_core::net::NetManifest;
use caphy_core::units::KilogramPerSquareMetre;
use caphy_core::{Error, Result, TriMesh, Vec3};
use caphy_garment::GarmentRest;
use caphy_garment::features::PoseFeatures;
use caphy_garment::skinning::{WeightOptions, garment_weights};
use caphy_garment::template::{GarmentKind, NamedLoop, Style, Template, pose_by_weights};
use nalgebra::Matrix3x4;
use serde::{Deserialize, Serialize};

/// A garment fitted to a subject: its template on the T-posed body.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct FittedGarment {
    /// Upper or lower.
    pub kind: GarmentKind,
    /// The chosen style.
    pub style: Style,
    /// V_T [m].
    pub mesh: TriMesh,
    /// w_G.
    pub weights: BlendWeights,
    /// Material coordinates per face corner [m].
    pub material_uv: Vec<[[f64; 2]; 3]>,
    /// Boundary loops.
    pub loops: Vec<NamedLoop>,
    /// How the yarn axes were chosen.
    pub grain: String,
    /// What it weighs [kg], where somebody weighed it.
    pub mass_kg: Option<f64>,
}

impl FittedGarment {
    /// A template that takes its weights from the T-posed body [m] that it lies on.
    ///
    /// # Errors
    /// As [`garment_weights`].
    pub fn new(template: Template, body: &[Vec3], weights: &BlendWeights, options: &WeightOptions) -> Result<Self> {
        let weights = garment_weights(&template.mesh.vertices, &template.mesh.faces, body, weights, options)?;
        Ok(Self {
            kind: template.kind,
            style: template.style,
            weights,
            material_uv: template.material_uv,
            loops: template.loops,
            grain: template.grain,
            mesh: template.mesh,
            mass_kg: None,
        })
    }
    /// The same, weighed [g].
    pub fn weighing(self, mass_g: Option<f64>) -> Self {
        Self { mass_kg: mass_g.map(|g| 1e-3 * g), ..self }
    }
    /// The template posed by its weights alone [m] (Eq. 2 with dV = 0).
    ///
    /// # Errors
    /// [`Error::Mesh`] for joints without a transform.
    pub fn skinned(&self, transforms: &[Matrix3x4<f64>]) -> Result<Vec<Vec3>> {
        pose_by_weights(&self.mesh.vertices, &self.weights, transforms)
    }
    /// A shape of one pose [m] as it moves along, vertex by vertex, into another pose.
    pub fn carried(&self, shape: &[Vec3], from: &[Matrix3x4<f64>], to: &[Matrix3x4<f64>]) -> Vec<Vec3> {
        let move_vertex = |(v, p): (usize, &Vec3)| {
            let (from, to) = (self.weights.blend(v, from), self.weights.blend(v, to));
            // Blended rotations shrink; where they shrink to nothing, the vertex stays.
            match from.fixed_columns::<3>(0).into_owned().try_inverse() {
                Some(inverse) => to * (inverse * (p - from.column(3))).push(1.0),
                None => *p,
            }
        };
        shape.iter().enumerate().map(move_vertex).collect()
    }
    /// Rest state when made of a material, waistband held; its density that of the garment where it was weighed.
    ///
    /// Errors: [`Error::Config`] for a material without density: static shapes only show stiffness over density.
    pub fn rest(&self, material: &dyn MaterialModel) -> Result<GarmentRest> {
        let make = |density: KilogramPerSquareMetre| {
            let name = self.kind.to_string();
            GarmentRest::new(name, self.mesh.clone(), self.material_uv.clone(), density, self.grain.clone())
        };
        let description = material.describe();
        let rest = match (self.mass_kg, description.density) {
            (Some(mass), _) => make(KilogramPerSquareMetre(mass / make(KilogramPerSquareMetre(1.0))?.area()))?,
            (None, Some(density)) => make(density)?,
            (None, None) => {
                return Err(Error::config(
                    "material",
                    format!("`{}` has no area density", description.name),
                    "give mass_g, the garment's mass, or density_kg_per_m2",
                ));
            }
        };
        self.loops
            .iter()
            .filter(|l| l.name == "waist")
            .try_fold(rest, |rest, waist| rest.holding("waistband", &waist.vertices))
    }
}

/// A garment's net after (or before) training.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct TrainedGarment {
    /// Upper or lower.
    pub kind: GarmentKind,
    /// What the net is told.
    pub features: PoseFeatures,
    /// The net's sizes.
    pub manifest: NetManifest,
    /// Flat parameters.
    pub parameters: Vec<f32>,
    /// Metres per unit of the net's output.
    pub output_scale_m: f64,
    /// Frame rate of carried state [1/s].
    pub fps: f64,
    /// Native parameters of its fabric where they were estimated, else as configured.
    pub material: Option<Vec<f64>>,
    /// Training's record.
    pub curve: Vec<CurvePoint>,
}
