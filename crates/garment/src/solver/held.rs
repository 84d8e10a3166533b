//! Rest with contacts that are held: what a small change of fabric, cut or body does.

use super::Solver;
use super::newton::Newton;
use super::relaxation::Guide;
use super::scene::Scene;
use super::solution::{Method, Progress, Solution, SolveReport};
use super::state::flat;
use super::state::{Prepared, Workspace};
use caphy_core::{Error, Result, Vec3};

/// Where contacts that are held come from.
#[derive(Debug, Clone, Copy)]
pub enum Contacts<'a> {
    /// Those of an earlier solution.
    Of(&'a Solution),
    /// Found where the solve starts, on the sides that the cloth is on in a solution before, where there is one.
    AtStart(Option<&'a Solution>),
}

impl Solver {
    /// Brings the garment to rest from `start` [m] with contact pairs and friction limits held. The answer depends smoothly on
    /// everything else, as [`Solver::linearise`] says it does. Friction pulls to the anchors of the solve that the contacts come from.
    ///
    /// Good for answers near the start: a vertex that slides over the body meets the tangent plane of where it was.
    ///
    /// # Errors
    /// As [`Solver::solve`].
    pub fn solve_held(
        &mut self,
        contacts: Contacts<'_>,
        scene: &Scene<'_>,
        start: &[Vec3],
        progress: &dyn Fn(Progress),
    ) -> Result<Solution> {
        Error::check_length("start of the solver", self.vertex_count(), start.len())?;
        let mut x = flat(start);
        Error::check_finite("start of the solver", &x)?;
        self.release();
        let prepared = Prepared::new(self, scene)?;
        let mut workspace = Workspace::new(self.vertex_count());
        let mut frozen = match contacts {
            Contacts::Of(earlier) => {
                Error::check_length("vertices of the earlier solution", self.vertex_count(), earlier.positions.len())?;
                let pairs = earlier.pairs().unwrap_or_default();
                if let Some(id) = pairs.iter().find(|id| !prepared.has_body_vertex(**id)) {
                    return Err(Error::mesh(
                        "body",
                        format!("vertex {id}"),
                        "was touched by the earlier solution and is not there",
                        "give the scene that it was solved in",
                    ));
                }
                earlier.frozen.clone()
            }
            Contacts::AtStart(before) => {
                let pairs = before.and_then(Solution::pairs);
                self.contacts_at(&prepared, &mut workspace, &x, (start, pairs))?
            }
        };
        let settings = self.settings;
        let mut factorisations = 0;
        if prepared.scene.body.is_some() && settings.guided_steps > 0 {
            let mut relaxed = x.clone();
            let how = (Guide::FactorHeld, settings.guided_steps, self.handover_n());
            let answer = self.relax(&prepared, start, &mut workspace, (&mut relaxed, &mut frozen), how, progress);
            // A start that is too wild for it is left to Newton's steps.
            if let Ok(answer) = answer
                && relaxed.iter().all(|x| x.is_finite())
            {
                x = relaxed;
                factorisations = answer.factorisations;
            }
        }
        let mut newton = Newton::new(self);
        let steps = (settings.iterations, settings.tolerance_n);
        let stop = newton.run(self, &prepared, &frozen, &mut workspace, &mut x, steps, progress)?;
        let report = SolveReport {
            factorisations: factorisations + newton.factorisations,
            rounds: 1,
            damped: newton.damped,
            ..SolveReport::new(stop.into(), Method::Newton, newton.iterations)
        };
        self.finish(&prepared, frozen, workspace, &x, report)
    }
}
