//! How far a moving garment is from the reference solver's: distances, strain, folds, energy, depth.

use crate::quality::{Spectrum, SpectrumFilter};
use crate::training::measures::principal_stretches;
use caphy_core::query::NearestSurface;
use caphy_core::{Error, Result, TriMesh, Vec3};
use caphy_garment::GarmentRest;
use serde::{Deserialize, Serialize};

/// Errors of a garment over the frames of a clip.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct Errors {
    /// Distance between the surfaces, mean of both directions and all frames [mm]. The measure that points are chosen by.
    pub surface_mm: f64,
    /// Distance of points that are the same on the template, mean [mm]: what slides along itself counts, too.
    pub vertex_mm: f64,
    /// Energy over the solver's as a share of the skinned template's; of energies of one frame, without inertia.
    pub energy: f64,
    /// Root mean square difference of the principal stretches [1].
    pub strain: f64,
    /// Difference of the energies of normals by wavelength, summed over wavelengths, as a share of the solver's sum.
    pub normals: f64,
    /// Share of vertices deeper inside the body than `evaluate.penetration_m`.
    pub inside: f64,
    /// The deepest of them [mm].
    pub deepest_mm: f64,
}

impl Errors {
    /// Names and units, in the order of [`Errors::values`].
    pub const NAMES: [&'static str; 7] = [
        "surface, mm",
        "vertices, mm",
        "energy excess / skinned",
        "stretch, rms",
        "normals' spectrum",
        "inside",
        "deepest, mm",
    ];
    /// All of them.
    pub fn values(&self) -> [f64; 7] {
        [self.surface_mm, self.vertex_mm, self.energy, self.strain, self.normals, self.inside, self.deepest_mm]
    }
    /// Mean of several garments.
    pub fn mean(list: &[Errors]) -> Errors {
        let count = list.len().max(1) as f64;
        let mut sums = [0.0; 7];
        for errors in list {
            sums.iter_mut().zip(errors.values()).for_each(|(sum, value)| *sum += value / count);
        }
        let [surface_mm, vertex_mm, energy, strain, normals, inside, deepest_mm] = sums;
        Errors { surface_mm, vertex_mm, energy, strain, normals, inside, deepest_mm }
    }
}

/// A garment's answer by the finest solver, prepared for comparison.
pub(super) struct Yard {
    rest: GarmentRest,
    filter: SpectrumFilter,
    /// Vertices [m], shape [frame][vertex].
    frames: Vec<Vec<Vec3>>,
    surfaces: Vec<NearestSurface>,
    /// Principal stretches, shape [frame][triangle].
    stretches: Vec<Vec<[f64; 2]>>,
    spectrum: Spectrum,
}

/// Shapes of another mesh of the same garment.
pub(super) struct Shapes<'a> {
    /// That mesh on the T-posed body [m].
    pub(super) template: &'a TriMesh,
    /// Its vertices [m], shape [frame][vertex].
    pub(super) frames: &'a [Vec<Vec3>],
}

impl Yard {
    /// Of a simulated garment.
    pub(super) fn new(rest: GarmentRest, template: &TriMesh, frames: Vec<Vec<Vec3>>) -> Result<Self> {
        let filter = SpectrumFilter::new(template);
        let surfaces = frames.iter().map(|x| NearestSurface::new(x, &template.faces)).collect::<Result<_>>()?;
        let stretches = frames.iter().map(|x| stretches(&rest, x)).collect();
        let spectrum = mean_spectrum(&filter, &template.faces, &frames);
        Ok(Self { rest, filter, frames, surfaces, stretches, spectrum })
    }
    /// Distances, strain and folds of other shapes in the same frames; energy and depth are not known here.
    ///
    /// # Errors
    /// [`Error::Length`] for another number of frames.
    pub(super) fn errors(&self, shapes: &Shapes<'_>) -> Result<Errors> {
        Error::check_length("compared frames", self.frames.len(), shapes.frames.len())?;
        let faces = &shapes.template.faces;
        // Where each vertex of the solver's template lies on the other template: the same point of the cloth.
        let on_template = NearestSurface::from_mesh(shapes.template)?;
        let places: Vec<([u32; 3], [f64; 3])> = self
            .rest
            .template
            .vertices
            .iter()
            .map(|v| {
                let near = on_template.nearest(v).ok_or_else(|| {
                    Error::mesh("template", "triangles", "there are none", "give the garment a template")
                })?;
                Ok((faces[near.face as usize], near.barycentric))
            })
            .collect::<Result<_>>()?;
        let mut out = Errors::default();
        let mut mapped_frames = Vec::with_capacity(shapes.frames.len());
        let (count, area) = (self.frames.len().max(1) as f64, self.rest.areas.iter().sum::<f64>());
        for (i, shape) in shapes.frames.iter().enumerate() {
            let mapped: Vec<Vec3> = places
                .iter()
                .map(|(corners, weights)| (0..3).map(|k| weights[k] * shape[corners[k] as usize]).sum())
                .collect();
            let yard = &self.frames[i];
            out.vertex_mm += 1e3 * mean(mapped.iter().zip(yard).map(|(a, b)| (a - b).norm())) / count;
            let there = NearestSurface::new(shape, faces)?;
            let to = |surface: &NearestSurface, points: &[Vec3]| {
                mean(points.iter().filter_map(|p| surface.nearest(p)).map(|near| near.squared_distance.sqrt()))
            };
            out.surface_mm += 0.5e3 * (to(&there, yard) + to(&self.surfaces[i], shape)) / count;
            let differences = stretches(&self.rest, &mapped).into_iter().zip(&self.stretches[i]).zip(&self.rest.areas);
            let squares = differences.map(|((a, b), w)| w * ((a[0] - b[0]).powi(2) + (a[1] - b[1]).powi(2)));
            out.strain += squares.sum::<f64>() / (2.0 * area) / count;
            mapped_frames.push(mapped);
        }
        out.strain = out.strain.sqrt();
        let spectrum = mean_spectrum(&self.filter, &self.rest.template.faces, &mapped_frames);
        let total: f64 = self.spectrum.0.iter().sum();
        let differences = spectrum.0.iter().zip(self.spectrum.0).map(|(a, b)| (a - b).abs());
        out.normals = differences.sum::<f64>() / total.max(f64::MIN_POSITIVE);
        Ok(out)
    }
}

fn mean(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = values.fold((0.0, 0usize), |(sum, count), v| (sum + v, count + 1));
    sum / count.max(1) as f64
}

fn stretches(rest: &GarmentRest, shape: &[Vec3]) -> Vec<[f64; 2]> {
    let of = |(f, face): (usize, &[u32; 3])| {
        if rest.areas[f] > 0.0 {
            principal_stretches(face.map(|v| shape[v as usize]), rest.dm_inverse[f])
        } else {
            [1.0; 2]
        }
    };
    rest.faces().iter().enumerate().map(of).collect()
}

fn mean_spectrum(filter: &SpectrumFilter, faces: &[[u32; 3]], frames: &[Vec<Vec3>]) -> Spectrum {
    Spectrum::mean(&frames.iter().map(|x| filter.of(x, faces)).collect::<Vec<_>>())
}
