//! A loaded material as an ordinary [`MaterialModel`].

use super::call::Callee;
use crate::Result;
use crate::material::{
    HingeBlock, HingeCall, HingeLength, MaterialDescription, MaterialModel, MaterialOutputs, MembraneBlock,
    MembraneCall,
};
use crate::params::{Parameter, check_values};
use crate::plugin::abi::{MaterialFacts, MaterialTable, ParameterFacts, Sink, Text};
use crate::units::KilogramPerSquareMetre;
use std::ffi::c_void;

/// Most parameters that are believed: more is a length that was never written.
const MOST_PARAMETERS: usize = 1_000_000;

/// Functions of a block in one precision.
type Ask<B> = unsafe extern "C" fn(*const c_void, *mut B, Sink) -> i32;

/// A material behind the border. Facts and parameters are read once: they do not change.
pub(super) struct LoadedMaterial {
    callee: Callee,
    table: &'static MaterialTable,
    handle: *mut c_void,
    description: MaterialDescription,
    parameters: Vec<Parameter>,
}

// SAFETY: the interface requires handles to be usable from several threads at once; the other fields are plain data.
unsafe impl Send for LoadedMaterial {}
// SAFETY: as above.
unsafe impl Sync for LoadedMaterial {}

impl Drop for LoadedMaterial {
    fn drop(&mut self) {
        if let Some(destroy) = self.table.destroy {
            // SAFETY: the handle came from `create` or `with_parameters` and is dropped once.
            unsafe { destroy(self.handle) }
        }
    }
}

impl LoadedMaterial {
    pub(super) fn create(callee: Callee, table: &'static MaterialTable, toml: &str) -> Result<Self> {
        let create = callee.function("create", table.create)?;
        // Every function is asked for now, so that no later call can meet a null one.
        callee.function("destroy", table.destroy)?;
        callee.function("with_parameters", table.with_parameters)?;
        callee.function("membrane_f32", table.membrane_f32)?;
        callee.function("membrane_f64", table.membrane_f64)?;
        callee.function("hinge_f32", table.hinge_f32)?;
        callee.function("hinge_f64", table.hinge_f64)?;
        let mut handle = std::ptr::null_mut();
        // SAFETY: text, handle and sink outlive the call.
        callee.call("create", |error| unsafe { create(Text::borrowed(toml), &mut handle, error) })?;
        Self::wrap(callee, table, handle, "create")
    }

    fn wrap(callee: Callee, table: &'static MaterialTable, handle: *mut c_void, call: &str) -> Result<Self> {
        if handle.is_null() {
            return Err(callee.malformed(call, "the handle is null"));
        }
        let nothing = MaterialDescription {
            name: callee.type_name.clone(),
            density: None,
            stiffness_frozen: false,
            hinge_length: HingeLength::Rest,
            linear_in_parameters: false,
            offers: MaterialOutputs::REQUIRED,
        };
        // From here on the handle is destroyed whatever happens.
        let mut material = Self { callee, table, handle, description: nothing, parameters: Vec::new() };
        material.read_facts()?;
        Ok(material)
    }

    fn read_facts(&mut self) -> Result<()> {
        let (callee, handle) = (&self.callee, self.handle);
        let describe = callee.function("describe", self.table.describe)?;
        let mut facts = MaterialFacts::default();
        // SAFETY: the handle is alive, facts and sink outlive the call.
        callee.call("describe", |error| unsafe { describe(handle, &mut facts, error) })?;
        let wrong = |what: String| callee.malformed("describe", what);
        self.description.density = match facts.density {
            d if d.is_nan() => None,
            d if d.is_finite() && d > 0.0 => Some(KilogramPerSquareMetre(d)),
            d => return Err(wrong(format!("density is {d} kg/m²"))),
        };
        self.description.hinge_length = match facts.hinge_length {
            0 => HingeLength::Rest,
            1 => HingeLength::CurrentHeld,
            2 => HingeLength::Current,
            other => return Err(wrong(format!("hinge_length is {other}, not 0, 1 or 2"))),
        };
        self.description.stiffness_frozen = callee.flag("stiffness_frozen", facts.stiffness_frozen)?;
        self.description.linear_in_parameters = callee.flag("linear_in_parameters", facts.linear_in_parameters)?;
        self.description.offers = MaterialOutputs {
            tangent_held: callee.flag("offers_tangent_held", facts.offers_tangent_held)?,
            tangent_total: callee.flag("offers_tangent_total", facts.offers_tangent_total)?,
            by_parameter: callee.flag("offers_by_parameter", facts.offers_by_parameter)?,
            stiffness: callee.flag("offers_stiffness", facts.offers_stiffness)?,
            hinge_slopes: callee.flag("offers_hinge_slopes", facts.offers_hinge_slopes)?,
        };
        if facts.parameter_count > MOST_PARAMETERS {
            return Err(wrong(format!("{} parameters", facts.parameter_count)));
        }
        let parameter = callee.function("parameter", self.table.parameter)?;
        for index in 0..facts.parameter_count {
            let mut read = ParameterFacts::default();
            let mut unit = Vec::new();
            let unit_sink = Sink::to(&mut unit);
            // SAFETY: the handle is alive, facts and sinks outlive the call.
            let name = callee.text("parameter", |name, error| unsafe {
                parameter(handle, index, &mut read, name, unit_sink, error)
            })?;
            let unit =
                String::from_utf8(unit).map_err(|_| callee.malformed("parameter", "a unit that is not UTF-8"))?;
            let ParameterFacts { value, lower, upper } = read;
            let parameter = Parameter { name, unit, value, lower, upper };
            parameter.check().map_err(|e| callee.malformed("parameter", e.to_string()))?;
            self.parameters.push(parameter);
        }
        Ok(())
    }

    /// Hands a checked block over.
    fn ask<B>(&self, call: &str, function: Option<Ask<B>>, block: *mut B) -> Result<()> {
        let function = self.callee.function(call, function)?;
        // SAFETY: the handle is alive; the block is borrowed for the call, checked, and of the layout of this version.
        self.callee.call(call, |error| unsafe { function(self.handle, block, error) })
    }
}

impl MaterialModel for LoadedMaterial {
    fn describe(&self) -> MaterialDescription {
        self.description.clone()
    }
    fn membrane(&self, call: MembraneCall<'_, '_>) -> Result<()> {
        let (offers, name, count) = (&self.description.offers, &self.callee.type_name, self.parameters.len());
        match call {
            MembraneCall::F32(block) => {
                block.check(count)?;
                offers.check_membrane(block, name)?;
                self.ask(
                    "membrane_f32",
                    self.table.membrane_f32,
                    std::ptr::from_mut(block).cast::<MembraneBlock<'_, _>>(),
                )
            }
            MembraneCall::F64(block) => {
                block.check(count)?;
                offers.check_membrane(block, name)?;
                self.ask(
                    "membrane_f64",
                    self.table.membrane_f64,
                    std::ptr::from_mut(block).cast::<MembraneBlock<'_, _>>(),
                )
            }
        }
    }
    fn hinge(&self, call: HingeCall<'_, '_>) -> Result<()> {
        let (offers, name, count) = (&self.description.offers, &self.callee.type_name, self.parameters.len());
        match call {
            HingeCall::F32(block) => {
                block.check(count)?;
                offers.check_hinge(block, name)?;
                self.ask("hinge_f32", self.table.hinge_f32, std::ptr::from_mut(block).cast::<HingeBlock<'_, _>>())
            }
            HingeCall::F64(block) => {
                block.check(count)?;
                offers.check_hinge(block, name)?;
                self.ask("hinge_f64", self.table.hinge_f64, std::ptr::from_mut(block).cast::<HingeBlock<'_, _>>())
            }
        }
    }
    fn parameters(&self) -> Vec<Parameter> {
        self.parameters.clone()
    }
    fn with_parameters(&self, values: &[f64]) -> Result<Box<dyn MaterialModel>> {
        check_values(&self.parameters, values)?;
        let with_parameters = self.callee.function("with_parameters", self.table.with_parameters)?;
        let mut handle = std::ptr::null_mut();
        // SAFETY: the handle is alive, values, new handle and sink outlive the call.
        self.callee.call("with_parameters", |error| unsafe {
            with_parameters(self.handle, values.as_ptr(), values.len(), &mut handle, error)
        })?;
        let changed = Self::wrap(self.callee.clone(), self.table, handle, "with_parameters")?;
        if changed.parameters.len() != self.parameters.len() {
            let what = format!("{} parameters instead of {}", changed.parameters.len(), self.parameters.len());
            return Err(self.callee.malformed("with_parameters", what));
        }
        Ok(Box::new(changed))
    }
}
