//! A loaded net as an ordinary [`DeformationNet`].

use super::call::Callee;
use crate::net::{
    BackwardBlock, BackwardCall, DeformationNet, ForwardBlock, ForwardCall, NetManifest, NetOffers, Tensor,
};
use crate::plugin::abi::{MAX_RANK, NetFacts, NetTable, Sink, TensorFacts, Text};
use crate::{Error, Real, Result};
use std::ffi::c_void;

/// Most tensors, parameters or tape values that are believed: more is a number that was never written.
const MOST: usize = 1 << 40;

type Pass<B> = unsafe extern "C" fn(*const c_void, *mut B, Sink) -> i32;

/// A net behind the border. Its manifest is read once: it does not change.
pub(super) struct LoadedNet {
    callee: Callee,
    table: &'static NetTable,
    handle: *mut c_void,
    manifest: NetManifest,
    offers: NetOffers,
}

// SAFETY: the interface requires handles to be usable from several threads at once; the other fields are plain data.
unsafe impl Send for LoadedNet {}
// SAFETY: as above.
unsafe impl Sync for LoadedNet {}

impl Drop for LoadedNet {
    fn drop(&mut self) {
        if let Some(destroy) = self.table.destroy {
            // SAFETY: the handle came from `create` and is dropped once.
            unsafe { destroy(self.handle) }
        }
    }
}

impl LoadedNet {
    pub(super) fn create(
        callee: Callee,
        table: &'static NetTable,
        toml: &str,
        inputs: usize,
        outputs: usize,
    ) -> Result<Self> {
        let create = callee.function("create", table.create)?;
        // Every function is asked for now, so that no later call can meet a null one.
        callee.function("destroy", table.destroy)?;
        callee.function("initialise", table.initialise)?;
        callee.function("tape_len", table.tape_len)?;
        callee.function("forward_f32", table.forward_f32)?;
        callee.function("forward_f64", table.forward_f64)?;
        callee.function("backward_f32", table.backward_f32)?;
        callee.function("backward_f64", table.backward_f64)?;
        let mut handle = std::ptr::null_mut();
        // SAFETY: text, handle and sink outlive the call.
        callee.call("create", |error| unsafe { create(Text::borrowed(toml), inputs, outputs, &mut handle, error) })?;
        if handle.is_null() {
            return Err(callee.malformed("create", "the handle is null"));
        }
        let manifest = NetManifest::new(&callee.type_name, inputs, outputs, 0, Vec::new());
        // From here on the handle is destroyed whatever happens.
        let mut net = Self { callee, table, handle, manifest, offers: NetOffers::ALL };
        net.read_manifest()?;
        Ok(net)
    }

    fn read_manifest(&mut self) -> Result<()> {
        let (callee, handle) = (&self.callee, self.handle);
        let describe = callee.function("describe", self.table.describe)?;
        let mut facts = NetFacts::default();
        // SAFETY: the handle is alive, facts and sink outlive the call.
        callee.call("describe", |error| unsafe { describe(handle, &mut facts, error) })?;
        let (inputs, outputs) = (self.manifest.inputs, self.manifest.outputs);
        if (facts.inputs, facts.outputs) != (inputs, outputs) {
            let what = format!("{} inputs, {} outputs instead of {inputs}, {outputs}", facts.inputs, facts.outputs);
            return Err(callee.malformed("describe", what));
        }
        if facts.state > MOST || facts.tensor_count > 1_000_000 {
            let what = format!("{} values of state, {} tensors", facts.state, facts.tensor_count);
            return Err(callee.malformed("describe", what));
        }
        self.manifest.state = facts.state;
        self.offers = NetOffers {
            double: callee.flag("offers_double", facts.offers_double)?,
            feature_gradient: callee.flag("offers_feature_gradient", facts.offers_feature_gradient)?,
        };
        let tensor = callee.function("tensor", self.table.tensor)?;
        let mut next = 0usize;
        for index in 0..facts.tensor_count {
            let mut read = TensorFacts::default();
            // SAFETY: the handle is alive, facts and sinks outlive the call.
            let name = callee.text("tensor", |name, error| unsafe { tensor(handle, index, &mut read, name, error) })?;
            let shape = read.shape.get(..read.rank).ok_or_else(|| {
                callee.malformed("tensor", format!("`{name}` has {} dimensions, at most {MAX_RANK}", read.rank))
            })?;
            let len = shape.iter().try_fold(1usize, |n, d| n.checked_mul(*d)).filter(|n| *n <= MOST);
            let len = len.ok_or_else(|| callee.malformed("tensor", format!("`{name}` has shape {shape:?}")))?;
            if read.offset != next {
                let what = format!("`{name}` starts at {}, the tensor before ends at {next}", read.offset);
                return Err(callee.malformed("tensor", what));
            }
            next += len;
            self.manifest.tensors.push(Tensor { name, shape: shape.to_vec(), offset: read.offset });
        }
        Ok(())
    }

    /// Length of the tape, where the plugin can say.
    fn tape(&self, steps: usize, batch: usize) -> Result<usize> {
        let tape_len = self.callee.function("tape_len", self.table.tape_len)?;
        let mut out = 0;
        // SAFETY: the handle is alive, the number and the sink outlive the call.
        self.callee.call("tape_len", |error| unsafe { tape_len(self.handle, steps, batch, &mut out, error) })?;
        if out > MOST {
            return Err(self.callee.malformed("tape_len", format!("{out} values")));
        }
        Ok(out)
    }

    fn ask<B>(&self, call: &str, function: Option<Pass<B>>, block: *mut B) -> Result<()> {
        let function = self.callee.function(call, function)?;
        // SAFETY: the handle is alive; the block is borrowed for the call, checked, and of the layout of this version.
        self.callee.call(call, |error| unsafe { function(self.handle, block, error) })
    }

    fn forward_in<T: Real>(
        &self,
        call: &str,
        function: Option<Pass<ForwardBlock<'static, T>>>,
        block: &mut ForwardBlock<'_, T>,
    ) -> Result<()> {
        block.check(&self.manifest, self.tape(block.steps, block.batch)?)?;
        self.ask(call, function, std::ptr::from_mut(block).cast())
    }

    fn backward_in<T: Real>(
        &self,
        call: &str,
        function: Option<Pass<BackwardBlock<'static, T>>>,
        block: &mut BackwardBlock<'_, T>,
    ) -> Result<()> {
        block.check(&self.manifest, self.tape(block.steps, block.batch)?)?;
        if block.feature_gradient.wanted() && !self.offers.feature_gradient {
            return Err(Error::unsupported("the gradient by the features", &self.callee.type_name));
        }
        self.ask(call, function, std::ptr::from_mut(block).cast())
    }

    fn check_double(&self) -> Result<()> {
        if self.offers.double { Ok(()) } else { Err(Error::unsupported("double precision", &self.callee.type_name)) }
    }
}

impl DeformationNet for LoadedNet {
    fn manifest(&self) -> &NetManifest {
        &self.manifest
    }
    fn offers(&self) -> NetOffers {
        self.offers
    }
    fn initialise(&self, seed: u64) -> Result<Vec<f64>> {
        let initialise = self.callee.function("initialise", self.table.initialise)?;
        let mut values = vec![0.0; self.manifest.parameter_count()];
        // SAFETY: the handle is alive, the values have room for as many as are asked for.
        self.callee.call("initialise", |error| unsafe {
            initialise(self.handle, seed, values.as_mut_ptr(), values.len(), error)
        })?;
        Error::check_finite("first parameters of the net", &values)?;
        Ok(values)
    }
    fn tape_len(&self, steps: usize, batch: usize) -> Result<usize> {
        self.tape(steps, batch)
    }
    fn forward(&self, call: ForwardCall<'_, '_>) -> Result<()> {
        match call {
            ForwardCall::F32(block) => self.forward_in("forward_f32", self.table.forward_f32, block),
            ForwardCall::F64(block) => {
                self.check_double()?;
                self.forward_in("forward_f64", self.table.forward_f64, block)
            }
        }
    }
    fn backward(&self, call: BackwardCall<'_, '_>) -> Result<()> {
        match call {
            BackwardCall::F32(block) => self.backward_in("backward_f32", self.table.backward_f32, block),
            BackwardCall::F64(block) => {
                self.check_double()?;
                self.backward_in("backward_f64", self.table.backward_f64, block)
            }
        }
    }
}
