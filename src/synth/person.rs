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
                // u is along the grain, which follows the limb.
                let scale = [config.rest.length, config.rest.girth];
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Config;
    use crate::files::ProjectFiles;
    use crate::plugins::Plugins;

    #[test]
    fn a_longer_rest_shape_is_longer_along_the_sleeve() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("tiny.toml");
        std::fs::write(&path, include_str!("../../tests/all/tiny.toml")).unwrap();
        let config = Config::read_set(&path, &[], &mut Plugins::new().unwrap()).unwrap();
        let crate::config::SubjectConfig::Synthetic(mut synthetic) = config.subject else {
            panic!("tiny is synthetic")
        };
        synthetic.rest.length = 1.1;
        let body: Arc<dyn BodyModel> = Arc::from(config.body.body(&ProjectFiles::new(folder.path())).unwrap());
        let person = Person::new(&synthetic, body, 1).unwrap();
        let shirt = &person.garments[0];
        let (mut along, mut around) = (Vec::new(), Vec::new());
        for (f, uv) in shirt.material_uv.iter().enumerate() {
            let p = shirt.mesh.corners(f);
            for k in 0..3 {
                let (a, b) = (k, (k + 1) % 3);
                let edge = p[b] - p[a];
                // Arms are along x; edges of sleeves only.
                if p[a].x.abs().min(p[b].x.abs()) < 0.24 {
                    continue;
                }
                let ratio = (uv[b][0] - uv[a][0]).hypot(uv[b][1] - uv[a][1]) / edge.norm();
                match edge.x.abs() / edge.norm() {
                    c if c > 0.97 => along.push(ratio),
                    c if c < 0.2 => around.push(ratio),
                    _ => {}
                }
            }
        }
        // An edge at an angle a to the grain is longer by less than 10 %: sqrt(1.1² cos²a + sin²a), 1.09 at cos a = 0.95.
        assert!(along.len() > 10 && along.iter().all(|r| *r > 1.08 && *r < 1.1 + 1e-9), "{along:?}");
        assert!(around.len() > 10 && around.iter().all(|r| *r < 1.02), "{around:?}");
    }
}
