//! One instant: what surrounds the garment while it is solved for.

use crate::energy::Attachment;
use caphy_core::lanes::Frames;
use caphy_core::{Result, Vec3};

/// The posed body.
#[derive(Clone, Copy)]
pub struct Obstacle<'a> {
    /// Body vertices [m], one frame; another garment may stand behind them.
    pub positions: &'a Frames<f64>,
    /// Outward unit normals.
    pub normals: &'a Frames<f64>,
    /// Body vertices one time step ago, for friction on a moving body; `None`: it stands still.
    pub before: Option<&'a Frames<f64>>,
    /// Finds the nearest body vertex of each garment vertex, as [`crate::contact::ContactMap::nearest`] does; `None` searches among
    /// all.
    pub search: Option<&'a dyn Fn(&Frames<f64>) -> Result<Vec<u32>>>,
}

/// Springs of one's own, such as those to scan points of known correspondence.
#[derive(Clone, Copy)]
pub struct Springs<'a> {
    /// Vertices and stiffness, see [`Attachment::springs`].
    pub attachment: &'a Attachment<f64>,
    /// Where they pull to [m], in the order of the vertices.
    pub targets: &'a [Vec3],
}

/// The past of a backward Euler step.
#[derive(Debug, Clone, Copy)]
pub struct Momentum<'a> {
    /// Time step Δt [s].
    pub step: f64,
    /// Positions one step ago [m].
    pub now: &'a [Vec3],
    /// Velocity one step ago [m/s].
    pub velocity: &'a [Vec3],
}

/// Everything around a garment at one instant. [`Scene::default`] is empty space: strain, bending and gravity alone.
#[derive(Clone, Copy, Default)]
pub struct Scene<'a> {
    /// The body.
    pub body: Option<Obstacle<'a>>,
    /// Where held vertices belong [m], in the order of [`super::Solver::held_vertices`]; needed when there are any.
    pub targets: Option<&'a [Vec3]>,
    /// Further springs.
    pub springs: Option<Springs<'a>>,
    /// Vertices that do not move from where the solve starts.
    pub fixed: &'a [u32],
    /// Inertia; `None` for a quasi-static pose.
    pub momentum: Option<Momentum<'a>>,
    /// Where friction holds each vertex [m], on the body as it was before: [`super::Solution::anchors`] of the last pose or step.
    /// `None`: where the time step, or else the solve, starts.
    pub anchors: Option<&'a [Vec3]>,
}
