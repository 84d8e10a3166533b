//! How a garment's cut may differ from the one that is believed: parts of it longer along the grain, or wider across.

use crate::GarmentRest;
use crate::template::{Limb, limb_of};
use caphy_core::body::BlendWeights;
use caphy_core::{Error, Result};

/// What each part can do: shares by which it differs along u and along v. The grain of worn garments follows the limb.
const WAYS: [&str; 2] = ["ease along the grain (length)", "ease across the grain (girth)"];

/// A part of a garment whose cut may differ by itself.
#[derive(Debug, Clone, PartialEq)]
pub struct CutPart {
    /// Name, such as `sleeves`; empty for all of it.
    pub name: String,
    /// How far each face belongs to it, in [0, 1], shape [face_count].
    pub share: Vec<f64>,
}

impl CutPart {
    /// The whole garment as one part.
    pub fn whole(face_count: usize) -> Vec<Self> {
        vec![Self { name: String::new(), share: vec![1.0; face_count] }]
    }

    /// Trunk, sleeves and legs, as far as a garment has them; both sides together. A face belongs to a part as the blend weights of
    /// its corners say (joints in SMPL-X's order), so that one cut passes into the other where a limb bends.
    ///
    /// # Errors
    /// [`Error::Length`] for faces beyond the weights' vertices.
    pub fn of_limbs(weights: &BlendWeights, faces: &[[u32; 3]]) -> Result<Vec<Self>> {
        let corners = faces.iter().flatten().max().map_or(0, |v| *v as usize + 1);
        Error::check_length(
            "vertices with blend weights",
            corners.max(weights.vertex_count()),
            weights.vertex_count(),
        )?;
        let names = ["trunk", "sleeves", "legs"];
        let mut shares = names.map(|_| vec![0.0; faces.len()]);
        for (f, face) in faces.iter().enumerate() {
            for &v in face {
                for (joint, weight) in weights.row(v as usize) {
                    let part = match limb_of(joint) {
                        Limb::Trunk | Limb::Head => 0,
                        Limb::Arm(_) | Limb::Hand(_) => 1,
                        Limb::Leg(_) | Limb::Foot(_) => 2,
                    };
                    shares[part][f] += weight / 3.0;
                }
            }
        }
        let parts = names.into_iter().zip(shares).map(|(name, share)| Self { name: name.into(), share });
        // What is a part in name only cannot be told from its neighbours.
        Ok(parts.filter(|p| p.share.iter().copied().fold(0.0, f64::max) > 0.5).collect())
    }

    /// Names of what parts can do, in the order of the unknowns: part by part, length then girth.
    pub(crate) fn unknowns(parts: &[Self]) -> Vec<String> {
        let name = |part: &Self, way: &str| match part.name.as_str() {
            "" => way.to_string(),
            name => format!("{name}: {way}"),
        };
        parts.iter().flat_map(|part| WAYS.map(|way| name(part, way))).collect()
    }
}

/// The same garment with each part cut longer by a share along u and wider along v, `ease` in the order of
/// [`CutPart::unknowns`]; its mass stays.
///
/// # Errors
/// What [`GarmentRest::new`] refuses.
pub(crate) fn eased(rest: &GarmentRest, parts: &[CutPart], ease: &[f64]) -> Result<GarmentRest> {
    let factor = |face: usize, way: usize| {
        1.0 + parts.iter().zip(ease.chunks_exact(2)).map(|(part, e)| part.share[face] * e[way]).sum::<f64>()
    };
    let corners = |(f, uv): (usize, &[[f64; 2]; 3])| {
        let [u, v] = [0, 1].map(|way| factor(f, way));
        uv.map(|p| [p[0] * u, p[1] * v])
    };
    let uv = rest.material_uv.iter().enumerate().map(corners).collect();
    let mut out = GarmentRest::new(rest.name.clone(), rest.template.clone(), uv, rest.density, rest.grain.clone())?;
    out.held.clone_from(&rest.held);
    Ok(out)
}
