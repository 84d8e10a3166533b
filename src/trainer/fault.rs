//! What a step that left the finite numbers stumbled over: asked once, after the fact.

use super::{Batch, BatchKind, GarmentLearner};
use crate::physics::Dynamics;
use caphy_core::Error;
use caphy_core::array::{In, Out};
use caphy_core::lanes::Frames;
use caphy_core::net::{ForwardBlock, ForwardCall};
use caphy_garment::contact_surface::ContactPoints;
use caphy_garment::energy::{BodyState, EnergyTerm, ScanCloud, State};

/// The first thing on a step's way that is not finite.
#[derive(Debug, Clone, PartialEq)]
pub struct Fault {
    /// What computes it: an energy term, the net, the body.
    pub source: String,
    /// What it is and where, within its frame.
    pub what: String,
    /// The frame in the batch's track; `None` where no frame is to blame.
    pub frame: Option<usize>,
}

impl GarmentLearner<'_> {
    /// Looks along the way of a batch through net, skinning and energies, in their order, for the first value that is not
    /// finite. Changes nothing, so that it can be asked between a step that failed and going back.
    pub fn fault(&self, batch: &Batch) -> Option<Fault> {
        let (track, features) = self.told(batch);
        let found = |source: &str, what: String, frame| Some(Fault { source: source.into(), what, frame });
        for &frame in &batch.frames {
            if let Some(i) = features[frame].iter().position(|f| !f.is_finite()) {
                return found("pose features", format!("feature {i} is {}", features[frame][i]), Some(frame));
            }
            let broken = track.transforms[frame].iter().position(|t| !t.iter().all(|x| x.is_finite()));
            if let Some(joint) = broken {
                return found("the body", format!("the transform of joint {joint} is not finite"), Some(frame));
            }
        }
        let tensor = |i: usize| {
            let tensors = &self.net.manifest().tensors;
            let holding = tensors.iter().find(|t| (t.offset..t.offset + t.len()).contains(&i));
            holding.map_or("?".to_string(), |t| format!("`{}`, value {}", t.name, i - t.offset))
        };
        if let Some(i) = self.parameters.iter().position(|p| !p.is_finite()) {
            return found("the net", format!("its parameter {} is {}", tensor(i), self.parameters[i]), None);
        }
        let windows = batch.windows;
        let steps = batch.frames.len() / windows;
        let inputs: Vec<f32> = batch.frames.iter().flat_map(|&f| features[f].iter().copied()).collect();
        let outputs = self.net.manifest().outputs;
        let mut output = vec![0.0f32; steps * windows * outputs];
        let mut block = ForwardBlock {
            steps,
            batch: windows,
            parameters: (&self.parameters[..]).into(),
            features: (&inputs[..]).into(),
            state_before: In::absent(),
            output: (&mut output[..]).into(),
            state_after: Out::absent(),
            tape: Out::absent(),
        };
        if let Err(error) = self.net.forward(ForwardCall::F32(&mut block)) {
            return found("the net", error.to_string(), None);
        }
        output.iter_mut().for_each(|d| *d *= self.output_scale);
        if let Some(i) = output.iter().position(|d| !d.is_finite()) {
            let what = format!("its displacement of vertex {} is {} m", i % outputs / 3, output[i]);
            return found("the net", what, Some(batch.frames[i / outputs]));
        }
        self.fault_of_energies(batch, track, &output, steps)
            .unwrap_or_else(|error| found("the energies", error.to_string(), None))
            .or_else(|| {
                let i = self.gradient.iter().position(|g| !g.is_finite())?;
                found("the net", format!("the gradient by its parameter {} is {}", tensor(i), self.gradient[i]), None)
            })
    }

    fn fault_of_energies(
        &self,
        batch: &Batch,
        track: &crate::track::BodyTrack,
        output: &[f32],
        steps: usize,
    ) -> Result<Option<Fault>, Error> {
        let windows = batch.windows;
        let frame_of = |step: usize, window: usize| Some(batch.frames[step * windows + window]);
        let broken = |source: &str, what: &str, values: &Frames<f32>| {
            for step in 0..steps {
                for window in 0..windows {
                    for v in 0..values.vertices() {
                        let p = values.get(step, window, v);
                        if !p.iter().all(|x| x.is_finite()) {
                            let what = format!("{what} {v} is ({}, {}, {})", p.x, p.y, p.z);
                            return Some(Fault { source: source.into(), what, frame: frame_of(step, window) });
                        }
                    }
                }
            }
            None
        };
        let transforms = track.transforms(&batch.frames);
        let mut positions = Frames::zeros(steps, self.skinner.vertex_count(), windows);
        self.skinner.forward(&self.skinner.joint_frames(&transforms, windows)?, Some(output), &mut positions)?;
        let mut targets = Frames::zeros(steps, self.held.vertex_count(), windows);
        self.held.forward(&self.held.joint_frames(&transforms, windows)?, None, &mut targets)?;
        let (body, normals) = track.gather::<f32>(&batch.frames, windows)?;
        let geometry = broken("skinning", "vertex", &positions)
            .or_else(|| broken("skinning", "the target of held vertex", &targets))
            .or_else(|| broken("the body", "vertex", &body))
            .or_else(|| broken("the body", "the normal at vertex", &normals));
        if geometry.is_some() {
            return Ok(geometry);
        }
        let nearest = self.contact.nearest(&positions, &body)?;
        let met = self.surface.as_ref().map(|s| s.points(&positions, &body, &normals, &nearest)).transpose()?;
        let vertices = BodyState { positions: &body, normals: &normals, nearest: Some(&nearest) };
        let state = State::new(&positions)
            .with_body(met.as_ref().map_or(vertices, ContactPoints::state))
            .with_targets(&targets);
        let scale = 1.0 / batch.frames.len() as f64;
        let dynamics = if batch.kind == BatchKind::Windows { Dynamics::Moving } else { Dynamics::Static };
        if let Some(fault) = self.physics.fault(&self.rest, &state, dynamics, scale) {
            let source = format!("energy `{}`", fault.term);
            return Ok(Some(Fault { source, what: fault.what, frame: frame_of(fault.step, fault.window) }));
        }
        if batch.kind == BatchKind::Scans && self.scan_weight > 0.0 {
            let clouds: Vec<&ScanCloud<f32>> = batch.frames.iter().map(|&f| &self.scans.clouds[f]).collect();
            let mut energy = vec![0.0; batch.frames.len()];
            let mut gradient = Frames::zeros(steps, positions.vertices(), windows);
            let state = state.with_scans(&clouds);
            self.chamfer.add(&state, self.scan_weight * scale, &mut energy, Some(&mut gradient))?;
            if let Some(i) = energy.iter().position(|e| !e.is_finite()) {
                let what = format!("it is {}", energy[i]);
                return Ok(Some(Fault { source: "energy `scan`".into(), what, frame: Some(batch.frames[i]) }));
            }
            return Ok(broken("energy `scan`", "the gradient at vertex", &gradient));
        }
        Ok(None)
    }
}
