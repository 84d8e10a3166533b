//! Lagged Coulomb friction: vertices that touch the body resist sliding along it.

use super::single::{Single, SingleTerm, check_single};
use super::tangent::{EnergyTangent, Stencil, Tangent, clamp_2x2, only_frame};
use super::{EnergyTerm, MAX_LANES, State, Touch, add_blocks};
use caphy_core::lanes::Frames;
use caphy_core::{Error, Result, Vec3};

/// E = Σ μ N φ(|u|), u the part of x − anchor along the body's surface, with normals and normal forces N of an earlier state
/// ("lagged": renewed between solves until they agree).
///
/// φ(u) = u − δ/3 beyond the slip distance δ [m], below it u²/δ − u³/(3δ²): the force is μN(2u/δ − u²/δ²) while sticking, and
/// Coulomb's μN beyond (Li et al. 2020, Eq. 13-15, in distance instead of speed). A sticking vertex gives way by up to δ;
/// [`Friction::anchors`] moves on the anchor of one that slid, so that from step to step nothing creeps.
#[derive(Debug, Clone, PartialEq)]
pub struct Friction {
    contacts: Vec<Contact>,
    vertex_count: usize,
    slip: f64,
}

#[derive(Debug, Clone, Copy, PartialEq)]
struct Contact {
    vertex: u32,
    normal: Vec3,
    anchor: Vec3,
    limit: f64,
}

impl Friction {
    /// For contacts with coefficient μ; `anchor` says where a contact's vertex would be had it not slid [m]; `slip` is δ [m].
    ///
    /// # Errors
    /// [`Error::Parameter`] for a negative coefficient or a slip distance that is not positive.
    pub fn new(
        touches: &[Touch],
        coefficient: f64,
        slip: f64,
        vertex_count: usize,
        anchor: impl Fn(&Touch) -> Vec3,
    ) -> Result<Self> {
        let bad = |name: &str, value: f64, unit: &str| Error::Parameter {
            name: name.into(),
            value,
            lower: 0.0,
            upper: f64::INFINITY,
            unit: unit.into(),
        };
        if !(coefficient >= 0.0 && coefficient.is_finite()) {
            return Err(bad("friction coefficient", coefficient, ""));
        }
        if !(slip > 0.0 && slip.is_finite()) {
            return Err(bad("slip distance of friction", slip, "m"));
        }
        let contacts = touches
            .iter()
            .filter(|t| coefficient * t.force > 0.0 && (t.vertex as usize) < vertex_count)
            .map(|t| Contact {
                vertex: t.vertex,
                normal: t.normal.into(),
                anchor: anchor(t),
                limit: coefficient * t.force,
            })
            .collect();
        Ok(Self { contacts, vertex_count, slip })
    }
    /// Limit μN of each vertex [N], 0 where it is free.
    pub fn limits(&self) -> Vec<f64> {
        let mut out = vec![0.0; self.vertex_count];
        self.contacts.iter().for_each(|c| out[c.vertex as usize] += c.limit);
        out
    }
    /// No contacts.
    pub fn none(vertex_count: usize) -> Self {
        Self { contacts: Vec::new(), vertex_count, slip: 1.0 }
    }
    /// Where each vertex would have to be for no friction to act, for the next step: a sliding vertex drags its anchor behind it at
    /// the slip distance, a free one takes it along. Shape [vertex].
    pub fn anchors(&self, x: &[Vec3]) -> Vec<Vec3> {
        let mut out = x.to_vec();
        let points: Vec<[f64; 3]> = x.iter().map(|p| [p.x, p.y, p.z]).collect();
        for c in &self.contacts {
            if let Some(out) = out.get_mut(c.vertex as usize) {
                let u = Self::slide(c, &points);
                *out -= u * (self.slip / u.norm().max(self.slip));
            }
        }
        out
    }
    /// Greatest change of a friction force's limit [N] against an earlier state: what lagging left open.
    pub fn change(&self, earlier: &Self) -> f64 {
        let mut limits = vec![Vec3::zeros(); self.vertex_count];
        self.contacts.iter().for_each(|c| limits[c.vertex as usize] += c.normal * c.limit);
        earlier.contacts.iter().for_each(|c| limits[c.vertex as usize] -= c.normal * c.limit);
        limits.iter().map(|l| l.norm()).fold(0.0, f64::max)
    }
    /// φ(s) and φ′(s)/s.
    fn potential(&self, s: f64) -> (f64, f64) {
        let d = self.slip;
        if s < d { (s * s / d - s * s * s / (3.0 * d * d), (2.0 - s / d) / d) } else { (s - d / 3.0, 1.0 / s) }
    }
    fn slide(contact: &Contact, x: &[[f64; 3]]) -> Vec3 {
        let d = Vec3::from(x[contact.vertex as usize]) - contact.anchor;
        d - contact.normal * contact.normal.dot(&d)
    }
}

impl EnergyTerm<f64> for Friction {
    fn name(&self) -> &'static str {
        "friction"
    }
    fn add(
        &self,
        state: &State<'_, f64>,
        weight: f64,
        energy: &mut [f64],
        gradient: Option<&mut Frames<f64>>,
    ) -> Result<()> {
        let points = only_frame("friction", state.positions)?;
        add_blocks("friction", self.vertex_count, state.positions, energy, gradient, |_, part| {
            let mut energy = 0.0;
            let mut part = part;
            for c in &self.contacts {
                let u = Self::slide(c, &points);
                let (phi, over_s) = self.potential(u.norm());
                energy += weight * c.limit * phi;
                if let Some(part) = part.as_deref_mut() {
                    let force = u * (weight * c.limit * over_s);
                    let lanes = part.len() / (3 * self.vertex_count);
                    for k in 0..3 {
                        let at = (3 * c.vertex as usize + k) * lanes;
                        part[at..at + lanes].iter_mut().for_each(|g| *g += force[k]);
                    }
                }
            }
            let mut out = [0.0; MAX_LANES];
            out.fill(energy);
            Ok(out)
        })
    }
}

impl SingleTerm for Friction {
    fn add_single(&self, pose: &Single<'_>, weight: f64, mut gradient: Option<&mut [f64]>) -> Result<f64> {
        pose.check("friction", self.vertex_count, gradient.as_deref())?;
        let mut energy = 0.0;
        for c in &self.contacts {
            let at = 3 * c.vertex as usize;
            let x = &pose.positions[at..at + 3];
            let d = Vec3::new(x[0], x[1], x[2]) - c.anchor;
            let u = d - c.normal * c.normal.dot(&d);
            let (phi, over_s) = self.potential(u.norm());
            energy += weight * c.limit * phi;
            if let Some(gradient) = gradient.as_deref_mut() {
                let force = u * (weight * c.limit * over_s);
                (0..3).for_each(|k| gradient[at + k] += force[k]);
            }
        }
        check_single("friction", pose.positions, energy)
    }
}

impl EnergyTangent for Friction {
    fn stencil(&self) -> Stencil {
        Stencil { width: 1, vertices: (0..self.vertex_count as u32).collect() }
    }
    fn tangents(&self, state: &State<'_, f64>, weight: f64, kind: Tangent, blocks: &mut [f64]) -> Result<()> {
        Error::check_length("second derivatives of friction", 9 * self.vertex_count, blocks.len())?;
        let points = only_frame("friction", state.positions)?;
        blocks.fill(0.0);
        for c in &self.contacts {
            let u = Self::slide(c, &points);
            let (s, d) = (u.norm(), self.slip);
            let limit = weight * c.limit;
            // Along the slide φ″, across it φ′/s.
            let (along, across) = if s < d { (2.0 / d - 2.0 * s / (d * d), (2.0 - s / d) / d) } else { (0.0, 1.0 / s) };
            let direction = u.try_normalize(0.0).unwrap_or_default();
            let [along, _, across] = match kind {
                Tangent::Exact => [along, 0.0, across],
                Tangent::Projected => clamp_2x2([along, 0.0, across]),
            };
            for i in 0..9 {
                let (r, q) = (i / 3, i % 3);
                let surface = f64::from(u8::from(r == q)) - c.normal[r] * c.normal[q];
                let line = direction[r] * direction[q];
                blocks[9 * c.vertex as usize + i] += limit * (along * line + across * (surface - line));
            }
        }
        Ok(())
    }
}
