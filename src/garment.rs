//! A subject's garments as stages hand them on.

use crate::trainer::CurvePoint;
use caphy_core::body::BlendWeights;
use caphy_core::material::MaterialModel;
use caphy_core::net::NetManifest;
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
        })
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
    /// Rest state when made of a material, waistband held.
    ///
    /// Errors: [`Error::Config`] for a material without density: static shapes only show stiffness over density.
    pub fn rest(&self, material: &dyn MaterialModel) -> Result<GarmentRest> {
        let description = material.describe();
        let density = description.density.ok_or_else(|| {
            Error::config(
                "material",
                format!("`{}` has no area density", description.name),
                "give density_kg_per_m2: weigh the garment and divide by its area",
            )
        })?;
        let name = self.kind.to_string();
        let rest = GarmentRest::new(name, self.mesh.clone(), self.material_uv.clone(), density, self.grain.clone())?;
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
