//! What is known of one scanned pose: what surrounded the cloth, and the scan's points.

use super::roughness;
use crate::GarmentRest;
use crate::solver::Solution;
use caphy_core::lanes::Frames;
use caphy_core::{Error, Result, Vec3};
use nalgebra::Matrix3;
use std::sync::Arc;

/// Finds the body vertex of each garment vertex, `[garment vertex][lane]`, from garment and body positions.
pub type ContactSearch = Arc<dyn Fn(&Frames<f64>, &Frames<f64>) -> Result<Vec<u32>> + Send + Sync>;

/// What the cloth may touch.
#[derive(Clone)]
pub struct Surroundings {
    /// Vertices [m], one frame.
    pub positions: Frames<f64>,
    /// Outward unit normals.
    pub normals: Frames<f64>,
    /// Finds contact pairs; `None`: the nearest vertex of all.
    pub search: Option<ContactSearch>,
}

impl Surroundings {
    /// From points [m] and outward unit normals at them.
    ///
    /// # Errors
    /// [`Error::Length`], [`Error::Mesh`] without a point.
    pub fn new(points: &[Vec3], normals: &[Vec3]) -> Result<Self> {
        Error::check_length("normals of what the cloth may touch", points.len(), normals.len())?;
        if points.is_empty() {
            return Err(Error::mesh(
                "surroundings",
                "points",
                "there are none",
                "leave the body out, or give its mesh",
            ));
        }
        let frame = |v: &[Vec3]| -> Result<Frames<f64>> {
            let mut out = Frames::zeros(1, v.len(), 1);
            out.set_frame(0, 0, v)?;
            Ok(out)
        };
        Ok(Self { positions: frame(points)?, normals: frame(normals)?, search: None })
    }
    /// The same, each point moved along its normal by a distance [m].
    pub(crate) fn offset(&self, distance: impl Fn(usize) -> f64) -> Self {
        let mut out = self.clone();
        for v in 0..self.positions.vertices() {
            let to = self.positions.get(0, 0, v) + self.normals.get(0, 0, v) * distance(v);
            out.positions.set(0, 0, v, &to);
        }
        out
    }
}

/// The points of a scan that show the cloth.
#[derive(Debug, Clone, PartialEq)]
pub enum ScanPoints {
    /// Points [m] of known garment vertices, as registered data has.
    Known {
        /// Garment vertices.
        vertices: Vec<u32>,
        /// Where each was seen.
        points: Vec<Vec3>,
    },
    /// A scanned surface.
    Surface {
        /// Points [m].
        points: Vec<Vec3>,
        /// Triangles between them; with none, only distances from points to the garment count.
        faces: Vec<[u32; 3]>,
        /// Garment vertices that a scanner could see, or all.
        visible: Option<Vec<bool>>,
    },
}

impl ScanPoints {
    /// Where points were seen [m].
    pub fn points(&self) -> &[Vec3] {
        match self {
            Self::Known { points, .. } | Self::Surface { points, .. } => points,
        }
    }
}

/// One pose of the cloth.
#[derive(Clone)]
pub struct Capture {
    /// Name in reports.
    pub name: String,
    /// Shape that solves start from [m], shape [vertex]: registered to the scan, or skinned. Clamped vertices stay where they are
    /// here.
    pub start: Vec<Vec3>,
    /// Clamped vertices.
    pub fixed: Vec<u32>,
    /// Where held vertices belong [m], in the order of [`crate::solver::Solver::held_vertices`]; empty when there are none.
    pub targets: Vec<Vec3>,
    /// What the cloth may touch.
    pub body: Option<Surroundings>,
    /// Blended transform of each vertex without its translation, for canonical gradients; empty: the identity, as for cloth that is
    /// not worn.
    pub blends: Vec<Matrix3<f64>>,
    /// The scan.
    pub scan: ScanPoints,
    /// Where friction holds each vertex [m]; `None`: where it starts.
    pub anchors: Option<Vec<Vec3>>,
    /// A solution whose contacts say on which side of the body the cloth is, such as one that began where skinning puts it; `None`:
    /// where it starts. A crease between two limbs is nearest now to one, now to the other: without, what is at rest there is thrown
    /// out through the other side.
    pub worn: Option<Arc<Solution>>,
    /// Standard deviation of the scan's noise per coordinate [m]; `None`: from the scan's own roughness.
    pub sigma_m: Option<f64>,
}

impl Capture {
    /// `Ok` when the cloth can come to rest here and the scan says something about it.
    ///
    /// # Errors
    /// [`Error::Length`] and [`Error::NonFinite`] for shapes that do not fit, [`Error::Config`] naming the pose when nothing holds
    /// the cloth or it may still turn freely, or when the scan has no point of it.
    pub fn check(&self, rest: &GarmentRest) -> Result<()> {
        let n = rest.vertex_count();
        let key = |part: &str| format!("pose `{}`, {part}", self.name);
        Error::check_length(&key("start"), n, self.start.len())?;
        for (what, points) in [("start", &self.start[..]), ("scan", self.scan.points())] {
            let flat: Vec<f64> = points.iter().flatten().copied().collect();
            Error::check_finite(&key(what), &flat)?;
        }
        if let Some(v) = self.fixed.iter().find(|&&v| v as usize >= n) {
            let problem = format!("vertex {v} is clamped but there are {n}");
            return Err(Error::config(key("clamps"), problem, "clamp vertices of this cloth"));
        }
        if !self.blends.is_empty() {
            Error::check_length(&key("blended transforms"), n, self.blends.len())?;
        }
        let worn = self.worn.as_ref().map(|s| &s.positions);
        for (what, points) in [("anchors", self.anchors.as_ref()), ("solution that it was worn in", worn)] {
            if let Some(points) = points {
                Error::check_length(&key(what), n, points.len())?;
            }
        }
        self.check_held()?;
        self.check_scan(n)
    }
    fn check_held(&self) -> Result<()> {
        if self.body.is_some() {
            return Ok(());
        }
        let held: Vec<Vec3> =
            self.fixed.iter().map(|&v| self.start[v as usize]).chain(self.targets.iter().copied()).collect();
        let key = format!("pose `{}`", self.name);
        let Some(first) = held.first() else {
            return Err(Error::config(
                key,
                "nothing holds the cloth: no body, no clamp, no held loop",
                "give what it lies on (`body`), or clamp vertices",
            ));
        };
        // Gravity holds every other rigid motion of a hanging cloth.
        let apart = held.iter().map(|p| (p - first).xz().norm()).fold(0.0, f64::max);
        if apart < 1e-3 {
            return Err(Error::config(
                key,
                format!(
                    "{} clamped vertices lie above one another ({apart:.1e} m apart): the cloth may turn",
                    held.len()
                ),
                "clamp vertices at two places that are apart sideways",
            ));
        }
        Ok(())
    }
    fn check_scan(&self, n: usize) -> Result<()> {
        let key = format!("pose `{}`, scan", self.name);
        if self.scan.points().is_empty() {
            return Err(Error::config(key, "has no point of this cloth", "look at its labels, or leave the pose out"));
        }
        match &self.scan {
            ScanPoints::Known { vertices, points } => {
                Error::check_length(&key, points.len(), vertices.len())?;
                match vertices.iter().find(|&&v| v as usize >= n) {
                    None => Ok(()),
                    Some(v) => {
                        let problem = format!("names vertex {v} but the cloth has {n}");
                        Err(Error::config(key, problem, "give points of this cloth's vertices"))
                    }
                }
            }
            ScanPoints::Surface { points, faces, visible } => {
                if let Some(face) = faces.iter().flatten().find(|&&v| v as usize >= points.len()) {
                    let problem = format!("a triangle names point {face} but there are {}", points.len());
                    return Err(Error::config(key, problem, "repair the scan"));
                }
                match visible {
                    Some(mask) => Error::check_length(&format!("{key}, visible vertices"), n, mask.len()),
                    None => Ok(()),
                }
            }
        }
    }
    /// Noise of the scan [m]: as given, else from its roughness.
    ///
    /// # Errors
    /// [`Error::Config`] when it cannot be told.
    pub fn noise(&self, rest: &GarmentRest) -> Result<f64> {
        let found = match (self.sigma_m, &self.scan) {
            (Some(sigma), _) => Some(sigma),
            (None, ScanPoints::Known { vertices, points }) => {
                let mut place = vec![u32::MAX; rest.vertex_count()];
                vertices.iter().enumerate().for_each(|(i, &v)| place[v as usize] = i as u32);
                let faces: Vec<[u32; 3]> = rest
                    .faces()
                    .iter()
                    .map(|f| f.map(|v| place[v as usize]))
                    .filter(|f| !f.contains(&u32::MAX))
                    .collect();
                roughness::of_points(points, &faces)
            }
            (None, ScanPoints::Surface { points, faces, .. }) => roughness::of_points(points, faces),
        };
        found.filter(|s| s.is_finite() && *s > 0.0).ok_or_else(|| {
            Error::config(
                format!("pose `{}`, sigma_m", self.name),
                "the scan's noise cannot be told from its points",
                "give the standard deviation of its coordinates in metres",
            )
        })
    }
}
