//! A synthetic subject: a person of known shape in clothes of known cut and fabric, brought to rest in every pose, and scanned.

mod person;
mod scanned;
mod worn;

pub use person::Person;
pub use scanned::{Scanned, scan};
pub use worn::{Worn, wear};

use caphy_core::pose::Pose;
use caphy_core::scan::Label;
use caphy_core::{TriMesh, Vec3};
use caphy_garment::solver::SolveReport;
use caphy_garment::template::{GarmentKind, GarmentMeasures, Style};
use serde::{Deserialize, Serialize};

/// What is known about a synthetic subject. Only evaluation and report look at it.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Truth {
    /// Shape β.
    pub shape: Vec<f64>,
    /// Displacements dT that no shape coefficient describes [m]; empty for none.
    pub displacement: Vec<Vec3>,
    /// Pose of each scan.
    pub poses: Vec<Pose>,
    /// Joints of each scan [m].
    pub joints: Vec<Vec<Vec3>>,
    /// True label of every vertex of each scan.
    pub labels: Vec<Vec<Label>>,
    /// Garments, upper first.
    pub garments: Vec<TrueGarment>,
}

/// What is known about a garment.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct TrueGarment {
    /// Upper or lower.
    pub kind: GarmentKind,
    /// Its style.
    pub style: Style,
    /// Its template on the T-posed body [m].
    pub template: TriMesh,
    /// The template's measures.
    pub measures: GarmentMeasures,
    /// Factors of girth and length of the rest shape that it hangs by, against the template.
    pub rest_scale: [f64; 2],
    /// Native parameters of its fabric.
    pub parameters: Vec<f64>,
    /// Vertices at rest in each scan [m].
    pub at_rest: Vec<Vec<Vec3>>,
    /// How each scan's rest state was found.
    pub solved: Vec<SolveReport>,
}
