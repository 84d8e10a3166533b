//! The scene plan: what an experiment needs of everything that caphy can do. Derived once from configuration and data, printed by
//! `caphy run --plan`, and obeyed: what is off is neither run nor allocated.

use crate::config::{Choice, Config, Schedule, SubjectConfig};
use crate::forecast::Forecast;
use crate::garment::FittedGarment;
use crate::memory::{MemoryNeed, Sizes, available, readable};
use crate::progress::duration;
use crate::scene::{REACH, Scene};
use crate::stage::alternation_names;
use crate::stage::preprocess::Subject;
use crate::stage::scans::PlannedScan;
use crate::trainer::pose_features;
use caphy_core::net::NetManifest;
use caphy_core::{Error, Result};
use serde::Serialize;
use std::fmt::Write;

/// A stage and whether this experiment has it.
#[derive(Debug, Clone, Serialize)]
pub struct PlannedStage {
    /// Its name.
    pub name: &'static str,
    /// Stages whose results it uses.
    pub needs: Vec<&'static str>,
    /// Why it is off; `None` when it is on.
    pub off: Option<String>,
    /// Whether its artifact is there and up to date.
    pub done: bool,
    /// Whether it is run even where its artifact is up to date.
    pub again: bool,
}

/// Stages of an experiment in their order.
#[derive(Debug, Clone, Serialize)]
pub struct ScenePlan {
    /// The point that the budget picked, and why; none without a budget.
    pub budget: Option<String>,
    /// All stages.
    pub stages: Vec<PlannedStage>,
    /// What is known of the garments once the subject is there.
    pub garments: Vec<PlannedGarment>,
    /// Frames of training motion and windows that may be drawn; once the subject is there.
    pub motion: Option<PlannedMotion>,
    /// The scans of a folder, as a look at each file shows them.
    pub scans: Vec<PlannedScan>,
    /// How long stages will take, where that was asked for.
    pub time: Option<Forecast>,
    /// Memory that was free when the plan was made [bytes], where the system says so.
    pub available: Option<usize>,
}

/// The part of the body and of the net that a garment needs.
#[derive(Debug, Clone, Serialize)]
pub struct PlannedGarment {
    /// Upper or lower.
    pub name: String,
    /// Vertices of the template.
    pub vertices: usize,
    /// Body vertices that any garment can reach, of all: only these are posed in training and searched for contact.
    pub body_vertices: [usize; 2],
    /// Joints that move it, of all: only these are told to the net.
    pub joints: Vec<String>,
    /// Joints of the body.
    pub all_joints: usize,
    /// Inputs, outputs and parameters of the net.
    pub net: [usize; 3],
    /// Inputs, and parameters, that a net of all joints would have more.
    pub joints_save: [usize; 2],
    /// Energy terms.
    pub terms: Vec<PlannedTerm>,
    /// What training it takes.
    pub memory: MemoryNeed,
}

/// An energy term of a garment's training.
#[derive(Debug, Clone, Serialize)]
pub struct PlannedTerm {
    /// As in the metrics.
    pub name: &'static str,
    /// Why it is off.
    pub off: Option<String>,
    /// What a step does for it, or saves.
    pub work: String,
}

/// Motion to train on.
#[derive(Debug, Clone, Serialize)]
pub struct PlannedMotion {
    /// Frames of all clips.
    pub frames: usize,
    /// First frames of windows.
    pub windows: usize,
    /// Bytes that bodies posed once and kept take: more than `train.keep_bodies_mib`, and they are posed in each step.
    pub bodies: usize,
    /// Whether they are kept.
    pub kept: bool,
}

impl ScenePlan {
    /// Which stages an experiment has.
    pub fn new(config: &Config) -> Self {
        let mut stages: Vec<PlannedStage> = Vec::new();
        let mut add = |name, needs: &[&'static str], off: Option<&str>| {
            stages.push(PlannedStage {
                name,
                needs: needs.to_vec(),
                off: off.map(str::to_string),
                done: false,
                again: false,
            });
        };
        let subject = match &config.subject {
            SubjectConfig::Synthetic(_) => {
                add("synth", &[], None);
                add("preprocess", &["synth"], None);
                "preprocess"
            }
            SubjectConfig::Scans(_) => {
                add("preprocess", &[], None);
                "preprocess"
            }
            SubjectConfig::Dressed(_) => {
                add("dress", &[], None);
                "dress"
            }
        };
        let no_scans = matches!(config.subject, SubjectConfig::Dressed(_)).then_some("there are no scans");
        add("train", &[subject], None);
        let mut nets = "train";
        for alternation in 0..config.optimise.alternations {
            let (optimise, again) = alternation_names(alternation);
            add(optimise, &[subject, nets], no_scans);
            add(again, &[subject, nets, optimise], no_scans);
            if no_scans.is_none() {
                nets = again;
            }
        }
        let alone = if config.garments().count() < 2 {
            Some("there is one garment")
        } else if config.finetune.epochs == 0 {
            Some("finetune.epochs = 0")
        } else {
            None
        };
        add("finetune", &[subject, nets], alone);
        let avatar = if alone.is_none() { "finetune" } else { nets };
        add("evaluate", &[subject, nets, avatar], no_scans);
        let compare = config.compare.is_none().then_some("there is no [compare]");
        add("reference", &[subject], compare);
        add("compare", &[subject, nets, "reference"], compare);
        let animate = config.animate.is_none().then_some("there is no [animate]");
        add("animate", &[subject, avatar], animate);
        match animate {
            None => add("export", &[subject, avatar, "animate"], None),
            Some(_) => add("export", &[subject, avatar], None),
        }
        let shown: Vec<&'static str> = stages.iter().filter(|s| s.off.is_none()).map(|s| s.name).collect();
        stages.push(PlannedStage { name: "report", needs: shown, off: None, done: false, again: false });
        let budget = config.choice.as_ref().map(Choice::text);
        Self {
            budget,
            stages,
            garments: Vec::new(),
            motion: None,
            scans: Vec::new(),
            time: None,
            available: available(),
        }
    }

    /// Narrows the plan to one stage and what it needs.
    ///
    /// # Errors
    /// [`Error::Config`] for a stage that the experiment does not have, with those that it has.
    pub fn only(mut self, target: &str) -> Result<Self> {
        self.find("--only", target)?;
        let mut wanted = vec![target.to_string()];
        // A stage's needs come before it.
        for stage in self.stages.iter_mut().rev().filter(|s| s.off.is_none()) {
            if wanted.iter().any(|w| w == stage.name) {
                wanted.extend(stage.needs.iter().map(|n| n.to_string()));
            } else {
                stage.off = Some(format!("--only {target}"));
            }
        }
        Ok(self)
    }

    /// Narrows the plan to one stage and all before it.
    ///
    /// # Errors
    /// As [`ScenePlan::only`].
    pub fn until(mut self, target: &str) -> Result<Self> {
        let last = self.find("--until", target)?;
        for stage in self.stages[last + 1..].iter_mut().filter(|s| s.off.is_none()) {
            stage.off = Some(format!("--until {target}"));
        }
        Ok(self)
    }

    /// Has one stage, and whatever uses its results, run again even where it is up to date.
    ///
    /// # Errors
    /// As [`ScenePlan::only`].
    pub fn from(mut self, target: &str) -> Result<Self> {
        let first = self.find("--from", target)?;
        self.stages[first].again = true;
        let mut changed = vec![target];
        // Whatever uses a stage comes after it.
        for stage in self.stages[first + 1..].iter_mut().filter(|s| s.off.is_none()) {
            if stage.needs.iter().any(|n| changed.contains(n)) {
                stage.again = true;
                changed.push(stage.name);
            }
        }
        Ok(self)
    }

    /// Narrows the plan to stages that another run has.
    ///
    /// # Errors
    /// [`Error::Config`] for a stage that this experiment does not have.
    pub(crate) fn like<'n>(mut self, names: impl Iterator<Item = &'n String> + Clone) -> Result<Self> {
        names.clone().try_for_each(|name| self.find("--replay", name).map(drop))?;
        for stage in self.stages.iter_mut().filter(|s| s.off.is_none()) {
            if !names.clone().any(|name| name == stage.name) {
                stage.off = Some("the other run does not have it".into());
            }
        }
        Ok(self)
    }

    /// Has every stage run again.
    pub(crate) fn all_again(&mut self) {
        self.stages.iter_mut().filter(|s| s.off.is_none()).for_each(|s| s.again = true);
    }

    /// The place of a stage that is on.
    fn find(&self, option: &str, target: &str) -> Result<usize> {
        match self.stages.iter().position(|s| s.name == target) {
            Some(at) => match &self.stages[at].off {
                None => Ok(at),
                Some(why) => Err(Error::config(option, format!("`{target}` is off: {why}"), "choose another stage")),
            },
            None => {
                let on: Vec<&str> = self.stages.iter().filter(|s| s.off.is_none()).map(|s| s.name).collect();
                let remedy = format!("choose one of {}", on.join(", "));
                Err(Error::config(option, format!("there is no stage `{target}`"), remedy))
            }
        }
    }

    /// Whether a stage is run even where its artifact is up to date.
    pub(crate) fn is_again(&self, stage: &str) -> bool {
        self.stages.iter().any(|s| s.name == stage && s.again && s.off.is_none())
    }

    /// Whether a stage is on.
    pub fn has(&self, stage: &str) -> bool {
        self.stages.iter().any(|s| s.name == stage && s.off.is_none())
    }

    /// Notes that a stage's artifact is up to date.
    pub(crate) fn done(&mut self, stage: &str) {
        for planned in self.stages.iter_mut().filter(|s| s.name == stage) {
            (planned.done, planned.again) = (true, false);
        }
    }

    /// Adds what only the subject tells.
    ///
    /// # Errors
    /// What the body, the clips or the net are refused for.
    pub(crate) fn describe(
        &mut self,
        config: &Config,
        scene: &Scene,
        subject: &Subject,
        motion: PlannedMotion,
    ) -> Result<()> {
        let body = scene.body.describe();
        for garment in &subject.garments {
            let features = pose_features(garment, body)?;
            let net = config.net.net(features.count(), 3 * garment.mesh.vertices.len())?;
            let manifest = net.manifest();
            let parameters = |manifest: &NetManifest| manifest.tensors.iter().map(|t| t.len()).sum::<usize>();
            let told = (body.joints.len() - 1 - features.joints().len()) * features.options().rotation.len();
            let whole = config.net.net(features.count() + told, 3 * garment.mesh.vertices.len())?;
            let sizes = Sizes {
                net: manifest,
                tape: net.tape_len(config.train.window, config.train.batch)?,
                vertices: garment.mesh.vertices.len(),
                body_vertices: scene.reach.vertices.len(),
                joints: body.joints.len(),
                frames: motion.frames,
            };
            let names = features.joints().iter().map(|&j| body.joints[j].name.clone()).collect();
            self.garments.push(PlannedGarment {
                name: garment.kind.to_string(),
                vertices: garment.mesh.vertices.len(),
                body_vertices: [scene.reach.vertices.len(), body.vertex_count],
                joints: names,
                all_joints: body.joints.len(),
                net: [manifest.inputs, manifest.outputs, parameters(manifest)],
                joints_save: [told, parameters(whole.manifest()) - parameters(manifest)],
                terms: terms(config, scene, subject, garment),
                memory: MemoryNeed::training(&sizes, &config.train),
            });
        }
        self.motion = Some(motion);
        Ok(())
    }

    /// The plan as text.
    pub fn text(&self) -> String {
        let mut out = self.budget.as_ref().map_or(String::new(), |text| format!("Budget: {text}\n"));
        out.push_str("Stages\n");
        for stage in &self.stages {
            let state = match (&stage.off, stage.done) {
                (Some(why), _) => format!("off: {why}"),
                (None, true) => "up to date".into(),
                (None, false) if stage.again => "to run again".into(),
                (None, false) => "to run".into(),
            };
            let seconds = self.time.as_ref().and_then(|time| time.seconds.get(stage.name));
            let about = seconds.map_or(String::new(), |seconds| format!(", about {}", duration(*seconds)));
            let _ = writeln!(out, "  {:18} {state}{about}", stage.name);
        }
        if let Some(time) = &self.time {
            out.push_str(&time.text());
        }
        for scan in &self.scans {
            let role = if scan.held_out { " (held out)" } else { "" };
            let _ = writeln!(out, "Scan {}{role}: {}", scan.name, scan.facts);
            for problem in &scan.problems {
                let _ = writeln!(out, "  ! {problem}");
            }
        }
        if self.garments.is_empty() {
            out.push_str("Garments: known once the subject is there.\n");
        }
        for g in &self.garments {
            let _ = writeln!(out, "Garment {}: {} vertices", g.name, g.vertices);
            let [near, all] = g.body_vertices;
            let _ = writeln!(out, "  body in contact    {near} of {all} vertices");
            let _ = writeln!(
                out,
                "                     others lie more than {REACH} m from every garment in the T-pose: {:.0} % of the posing of bodies",
                100.0 * (1.0 - near as f64 / all.max(1) as f64)
            );
            let _ =
                writeln!(out, "  joints             {} of {}: {}", g.joints.len(), g.all_joints, g.joints.join(", "));
            let [inputs, parameters] = g.joints_save;
            let _ = writeln!(
                out,
                "                     others move no vertex of it: {inputs} inputs and {parameters} parameters less"
            );
            let _ = writeln!(
                out,
                "  net                {} inputs, {} outputs, {} parameters",
                g.net[0], g.net[1], g.net[2]
            );
            let on: Vec<&str> = g.terms.iter().filter(|t| t.off.is_none()).map(|t| t.name).collect();
            let _ = writeln!(out, "  energies           {}", on.join(", "));
            for term in &g.terms {
                if let Some(why) = &term.off {
                    let _ = writeln!(out, "  no {:15} {why}: saves {}", term.name, term.work);
                }
            }
            let need = &g.memory;
            let _ = writeln!(
                out,
                "  memory             about {}: net {}, its last good state {}, a step {}, motion {}",
                readable(need.total()),
                readable(need.net),
                readable(need.good_state),
                readable(need.step),
                readable(need.motion)
            );
            if let Some(free) = self.available.filter(|free| need.total() > *free) {
                let _ = writeln!(
                    out,
                    "  ! does not fit into the {} that are free: take a coarser template (`resolution_m`), a smaller net \
                     (`net.hidden`), a smaller `train.batch`, or less `train.keep_bodies_mib`",
                    readable(free)
                );
            }
        }
        if let Some(motion) = &self.motion {
            let _ = writeln!(out, "Motion: {} frames, {} windows", motion.frames, motion.windows);
            let bodies = readable(motion.bodies);
            let _ = if motion.kept {
                writeln!(out, "  bodies             posed once and kept, {bodies}: they come back in every round")
            } else {
                writeln!(
                    out,
                    "  bodies             posed in each step: kept, they would take {bodies}, more than train.keep_bodies_mib"
                )
            };
        }
        out
    }
}

/// Energy terms of one garment's training, each with the reason why it is off and what that saves.
fn terms(config: &Config, scene: &Scene, subject: &Subject, garment: &FittedGarment) -> Vec<PlannedTerm> {
    let w = &config.train.weights;
    let weight = |name: &str, value: &Schedule| value.is_zero().then(|| format!("train.weights.{name} = 0"));
    let or = |first: Option<String>, holds: bool, why: &str| first.or_else(|| holds.then(|| why.to_string()));
    let waistband = garment.loops.iter().any(|l| l.name == "waist");
    let (vertices, faces) = (garment.mesh.vertices.len(), garment.mesh.faces.len());
    let hinges = caphy_core::query::hinges(&garment.mesh.faces).0.len();
    let still = config.train.window < 3 && config.train.lead_in == 0;
    let no_scans = subject.training_scans().next().is_none();
    let term = |name, off, work: String| PlannedTerm { name, off, work };
    vec![
        term("strain", weight("strain", &w.strain), format!("a pass over {faces} triangles")),
        term("bending", weight("bending", &w.bending), format!("a pass over {hinges} hinges")),
        term("gravity", weight("gravity", &w.gravity), format!("a pass over {vertices} vertices")),
        term(
            "inertia",
            or(weight("inertia", &w.inertia), still, "train.window < 3: no velocity is known"),
            format!("a pass over {vertices} vertices"),
        ),
        term(
            "collision",
            weight("collision", &w.collision),
            format!("{} posed body vertices and the search among them", scene.reach.vertices.len()),
        ),
        term(
            "attachment",
            or(weight("attachment", &w.attachment), !waistband, "the garment has no waistband"),
            "springs and their targets".into(),
        ),
        term(
            "scan",
            or(weight("scan", &w.scan), no_scans, "there are no scans"),
            "a search among the scans' points, and back".into(),
        ),
        term(
            "layering",
            or(weight("layering", &w.layering), subject.garments.len() < 2, "there is one garment"),
            "a search among the other garment's vertices".into(),
        ),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    #[test]
    fn a_plan_is_narrowed_and_repeated_by_what_stages_use() {
        let text = include_str!("../tests/all/tiny.toml");
        let plan = || ScenePlan::new(&Config::parse(Path::new("tiny.toml"), text).unwrap());
        let on = |plan: &ScenePlan| plan.stages.iter().filter(|s| s.off.is_none()).map(|s| s.name).collect::<Vec<_>>();
        let again = |plan: ScenePlan| plan.stages.iter().filter(|s| s.again).map(|s| s.name).collect::<Vec<_>>();
        let road = ["synth", "preprocess", "train", "optimise", "train-optimised", "finetune", "evaluate"];
        assert_eq!(on(&plan().until("evaluate").unwrap()), road);
        assert_eq!(on(&plan().only("optimise").unwrap()), road[..4]);
        assert_eq!(again(plan().from("animate").unwrap()), ["animate", "export", "report"]);
        // Evaluation is not part of what is animated.
        assert_eq!(again(plan().from("evaluate").unwrap()), ["evaluate", "report"]);
        assert_eq!(again(plan().until("finetune").and_then(|p| p.from("optimise")).unwrap()), road[3..6]);
        let said = plan().until("optimise").and_then(|p| p.from("finetune")).unwrap_err().to_string();
        assert!(said.contains("--from") && said.contains("--until optimise"), "{said}");
        let said = plan().from("training").unwrap_err().to_string();
        assert!(said.contains("no stage `training`") && said.contains("finetune"), "{said}");
        assert!(plan().from("compare").unwrap_err().to_string().contains("there is no [compare]"));
    }
}
