//! The reference solver: brings a garment to rest in one pose, or through one time step, by the energies of Eqs. 3-7 without any
//! network.
//!
//! What nets are judged against, what makes synthetic scans, and what fabric estimation differentiates through.
//!
//! * [`Solver::solve`]: Newton steps on the energies with a sparse factorisation ([`factor`]), contact pairs and friction frozen
//!   within a round ([`SolverSettings`]), the force residual [N] as the measure.
//! * [`Solver::attach_and_release`]: the same from a scan, first pulled to its points, then let go.
//! * [`Solver::solve_from`]: the next pose of a sequence.
//! * [`Solver::solve_held`]: after a small change, contacts as they were.
//! * [`Dynamics`]: backward Euler steps of a sequence.
//! * [`Solver::linearise`]: dx*/dΘ and dx*/d(anything) by the implicit function theorem ([`sensitivity`]).
//!
//! With frozen stiffness (`stiffness_gradient = "frozen"`) forces are not a gradient: every step then minimises the energy of the
//! fabric linearised with its present stiffness, and near rest steps use the true, unsymmetric derivative of the
//! forces. What is reported is the force of the material itself.
//!
//! # Limitations
//! Cloth does not collide with itself. Contact is a penalty with the nearest body vertex's tangent plane: positions jump a
//! little where the nearest vertex changes. Between two limbs cloth keeps to the side where it is. Rest states of cloth are
//! many; which buckling pattern is found depends on the start.

mod dense;
pub mod dynamics;
pub mod factor;
mod held;
mod lbfgs;
mod modes;
mod newton;
mod ordering;
mod pose;
mod relaxation;
mod scene;
pub mod sensitivity;
mod settings;
mod solution;
pub mod sparse;
mod state;
mod substitution;
mod vector;

pub use dynamics::Dynamics;
pub use held::Contacts;
pub use ordering::Analysis;
pub use scene::{Momentum, Obstacle, Scene, Springs};
pub use sensitivity::Linearisation;
pub use settings::{Forces, SolverSettings};
pub use solution::{Method, Outcome, Progress, SoftMode, Solution, SolveReport};

use crate::GarmentRest;
use crate::energy::{Attachment, Bending, Collision, EnergyTangent, Gravity, State, Strain};
use caphy_core::Result;
use caphy_core::lanes::Frames;
use caphy_core::material::{HingeLength, MaterialModel};
use sparse::Pattern;
use std::sync::Arc;

/// A garment of one fabric, ready to be solved for in any scene: the elimination order is worked out once.
///
/// ```
/// use caphy_core::{TriMesh, Vec3, units::KilogramPerSquareMetre};
/// use caphy_garment::{GarmentRest, solver::{Forces, Scene, Solver, SolverSettings}};
/// use caphy_materials::MaterialStvk;
/// // A square of 10 cm that hangs by its upper edge.
/// let corner = |x: f64, y: f64| Vec3::new(x, y, 0.0);
/// let mesh = TriMesh {
///     vertices: vec![corner(0.0, 0.0), corner(0.1, 0.0), corner(0.0, 0.1), corner(0.1, 0.1)],
///     faces: vec![[0, 1, 2], [1, 3, 2]],
/// };
/// let uv = mesh.faces.iter().map(|f| f.map(|v| [mesh.vertices[v as usize].x, mesh.vertices[v as usize].y])).collect();
/// let start = mesh.vertices.clone();
/// let rest = GarmentRest::new("square", mesh, uv, KilogramPerSquareMetre(0.2), "flat")?;
/// let material = std::sync::Arc::new(MaterialStvk::snug()?);
/// let mut solver = Solver::new(&rest, material, Forces::default(), SolverSettings::default())?;
/// let solution = solver.solve(&Scene { fixed: &[2, 3], ..Default::default() }, &start, &|_| {})?;
/// assert!(solution.converged() && solution.positions[0].y < 0.0);
/// # Ok::<(), caphy_core::Error>(())
/// ```
pub struct Solver {
    rest: GarmentRest,
    material: Arc<dyn MaterialModel>,
    forces: Forces,
    settings: SolverSettings,
    strain: Strain<f64>,
    bending: Bending<f64>,
    gravity: Gravity<f64>,
    collision: Collision<f64>,
    attachment: Attachment<f64>,
    pattern: Arc<Pattern>,
    /// Where the blocks of triangles and hinges go.
    slots: [Vec<u32>; 2],
    analysis: Arc<Analysis>,
}

impl Solver {
    /// For a garment made of a material.
    ///
    /// # Errors
    /// [`caphy_core::Error::Parameter`] for settings out of bounds.
    pub fn new(
        rest: &GarmentRest,
        material: Arc<dyn MaterialModel>,
        forces: Forces,
        settings: SolverSettings,
    ) -> Result<Self> {
        settings.check()?;
        let strain = Strain::new(rest, material.clone());
        let bending = Bending::new(rest, material.clone(), forces.rest_angle);
        let (triangles, hinges) = (strain.stencil(), bending.stencil());
        let pattern = Arc::new(Pattern::new(rest.vertex_count(), &[&triangles, &hinges])?);
        let slots = [pattern.slots(&triangles)?, pattern.slots(&hinges)?];
        Ok(Self {
            rest: rest.clone(),
            forces,
            settings,
            gravity: Gravity::new(rest, forces.gravity),
            collision: Collision::new(rest, &forces.contact)?,
            attachment: Attachment::new(rest, forces.attachment),
            analysis: Arc::new(Analysis::new(pattern.clone())),
            material,
            strain,
            bending,
            pattern,
            slots,
        })
    }
    /// The same garment of another material: nothing else is worked out again.
    pub fn set_material(&mut self, material: Arc<dyn MaterialModel>) {
        self.strain.set_material(material.clone());
        self.bending.set_material(material.clone());
        self.material = material;
    }
    /// Other settings.
    ///
    /// # Errors
    /// [`caphy_core::Error::Parameter`] for settings out of bounds.
    pub fn set_settings(&mut self, settings: SolverSettings) -> Result<()> {
        settings.check()?;
        self.settings = settings;
        Ok(())
    }
    /// The settings.
    pub fn settings(&self) -> &SolverSettings {
        &self.settings
    }
    /// The garment.
    pub fn rest(&self) -> &GarmentRest {
        &self.rest
    }
    /// The material.
    pub fn material(&self) -> &Arc<dyn MaterialModel> {
        &self.material
    }
    /// Number of vertices.
    pub fn vertex_count(&self) -> usize {
        self.rest.vertex_count()
    }
    /// Garment vertices that the body holds: a scene gives their targets in this order.
    pub fn held_vertices(&self) -> &[u32] {
        self.attachment.vertices()
    }
    /// The elimination order.
    pub fn analysis(&self) -> &Analysis {
        &self.analysis
    }
    /// Whether forces are the gradient of an energy.
    fn conservative(&self) -> bool {
        let facts = self.material.describe();
        !facts.stiffness_frozen && facts.hinge_length != HingeLength::CurrentHeld
    }
    /// Holds the fabric's stiffness as it is at these positions.
    fn hold(&mut self, x: &Frames<f64>) -> Result<()> {
        let state = State::new(x);
        self.strain.hold(&state)?;
        self.bending.hold(&state)
    }
    fn release(&mut self) {
        self.strain.release();
        self.bending.release();
    }
}
