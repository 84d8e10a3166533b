//! Who is scanned: a body, and clothes that are cut on it.

use crate::config::SyntheticConfig;
use crate::garment::FittedGarment;
use caphy_core::body::{BodyModel, BodyParameters};
use caphy_core::material::MaterialModel;
use caphy_core::{Result, Vec3};
use caphy_garment::skinning::WeightOptions;
use caphy_garment::template::{BodyRest, GarmentKind, Style, Tailor, Template};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use std::f64::consts::TAU;
use std::sync::Arc;

use crate::random::{normal, uniform};

/// A body and its clothes, upper first.
pub struct Person {
    /// The body.
    pub body: Arc<dyn BodyModel>,
    /// Shape and dT, T-posed.
    pub subject: BodyParameters,
    /// Templates on the T-posed body; `garments` hang by them.
    pub templates: Vec<Template>,
    /// Garments with the layout of their rest shape.
    pub garments: Vec<FittedGarment>,
    /// Fabric of each.
    pub materials: Vec<Arc<dyn MaterialModel>>,
}

/// Waves that the displacement is a sum of, and the range of their lengths [m]: longer than a hand, shorter than a trunk, as flesh
/// differs from person to person.
const WAVES: usize = 24;
const WAVE_LENGTHS: (f64, f64) = (0.15, 0.5);

impl Person {
    /// What the configuration says, the rest drawn by the seed.
    ///
    /// # Errors
    /// Of the body, the tailor and the fabrics.
    pub fn new(config: &SyntheticConfig, body: Arc<dyn BodyModel>, seed: u64) -> Result<Self> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed.wrapping_mul(7919).wrapping_add(17));
        let drawn: Vec<f64> = (0..body.describe().shape_count.min(4)).map(|_| uniform(&mut rng, -0.8, 0.8)).collect();
        let mut between =
            |ranges: &[(f64, f64)]| ranges.iter().map(|&(a, b)| uniform(&mut rng, a, b)).collect::<Vec<_>>();
        let upper =
            Style::from_unit(GarmentKind::Upper, &between(&[(0.3, 0.6), (0.35, 0.55), (0.3, 0.5), (0.2, 0.5)]))?;
        let lower = Style::from_unit(GarmentKind::Lower, &between(&[(0.75, 0.95), (0.3, 0.5), (0.4, 0.7)]))?;
        let mut styles = Vec::new();
        for (kind, drawn) in [(GarmentKind::Upper, upper), (GarmentKind::Lower, lower)] {
            styles.push(config.style(kind)?.unwrap_or(drawn));
        }
        let mut subject = body.rest(config.shape.as_deref().unwrap_or(&drawn));
        if config.displacement_m > 0.0 {
            subject.displacement = displacement(&*body, &subject, config.displacement_m, &mut rng)?;
        }
        let rest = BodyRest::from_model(&*body, &subject)?;
        let skin = rest.mesh.vertices.clone();
        let templates = Tailor::new(rest)?.generate_all(&styles, config.resolution_m)?;
        let weights = &body.describe().weights;
        let garments = templates
            .iter()
            .map(|template| {
                let mut cut = template.clone();
                let scale = [config.rest.girth, config.rest.length];
                cut.material_uv.iter_mut().flatten().for_each(|uv| {
                    uv.iter_mut().zip(scale).for_each(|(c, s)| *c *= s);
                });
                FittedGarment::new(cut, &skin, weights, &WeightOptions::default())
            })
            .collect::<Result<Vec<_>>>()?;
        let materials = vec![
            Arc::from(config.upper_material.material("subject.upper_material")?),
            Arc::from(config.lower_material.material("subject.lower_material")?),
        ];
        Ok(Self { body, subject, templates, garments, materials })
    }
}

/// A smooth field along the normals with a root mean square of `size` [m].
fn displacement(body: &dyn BodyModel, subject: &BodyParameters, size: f64, rng: &mut ChaCha8Rng) -> Result<Vec<Vec3>> {
    let rest = BodyRest::from_model(body, subject)?.mesh;
    let waves: Vec<(Vec3, f64)> = (0..WAVES)
        .map(|_| {
            let direction = Vec3::from_fn(|_, _| normal(rng)).try_normalize(0.0).unwrap_or_else(Vec3::x);
            let length = uniform(rng, WAVE_LENGTHS.0, WAVE_LENGTHS.1);
            (direction * (TAU / length), uniform(rng, 0.0, TAU))
        })
        .collect();
    let height = |p: &Vec3| waves.iter().map(|(k, phase)| (k.dot(p) + phase).sin()).sum::<f64>();
    let heights: Vec<f64> = rest.vertices.iter().map(height).collect();
    let root_mean_square = (heights.iter().map(|h| h * h).sum::<f64>() / heights.len().max(1) as f64).sqrt();
    Ok(rest.vertex_normals().iter().zip(heights).map(|(n, h)| n * (h * size / root_mean_square)).collect())
}
