//! The plugin's side of the border: ordinary trait objects behind C functions.

use super::abi::{
    CONFIG, FAILED, LENGTH, MAX_RANK, MaterialFacts, MaterialTable, NON_FINITE, NetFacts, NetTable, OK, PANICKED,
    PARAMETER, ParameterFacts, Sink, TensorFacts, Text, UNSUPPORTED,
};
use crate::material::{HingeBlock, HingeLength, MaterialModel, MaterialReal, MaterialSpec, MembraneBlock};
use crate::net::{BackwardBlock, BackwardCall, DeformationNet, ForwardBlock, ForwardCall, NetSpec};
use crate::{Error, Result};
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::ffi::c_void;
use std::panic::{AssertUnwindSafe, catch_unwind};

/// Exports the named types of this crate as a plugin library.
///
/// The names are those of the `#[typetag::serde(name = "…")]` attributes.
///
/// ```ignore
/// caphy_core::export_plugin! { materials: ["woven"], nets: [] }
/// ```
#[macro_export]
macro_rules! export_plugin {
    (materials: [$($material:literal),* $(,)?], nets: [$($net:literal),* $(,)?] $(,)?) => {
        /// Version of the interface that this library was built with.
        #[unsafe(no_mangle)]
        pub extern "C" fn caphy_plugin_abi_version() -> u32 {
            $crate::plugin::ABI_VERSION
        }
        /// The types of this library.
        #[unsafe(no_mangle)]
        pub extern "C" fn caphy_plugin() -> *const $crate::plugin::abi::PluginTable {
            &$crate::plugin_table!(materials: [$($material),*], nets: [$($net),*]).0
        }
    };
}

/// The table behind [`export_plugin!`](crate::export_plugin), as a reference to a `static`.
#[doc(hidden)]
#[macro_export]
macro_rules! plugin_table {
    (materials: [$($material:literal),*], nets: [$($net:literal),*]) => {{
        use $crate::plugin::{abi, export};
        const TYPES: &[abi::PluginEntry] = &[
            $(export::material_entry($material),)*
            $(export::net_entry($net),)*
        ];
        static TABLE: abi::Shared<abi::PluginTable> = abi::Shared(abi::PluginTable {
            struct_size: size_of::<abi::PluginTable>(),
            type_count: TYPES.len(),
            types: TYPES.as_ptr(),
        });
        &TABLE
    }};
}

/// Entry of a material type.
pub const fn material_entry(name: &'static str) -> super::abi::PluginEntry {
    super::abi::PluginEntry {
        kind: super::abi::KIND_MATERIAL,
        name: Text::of(name),
        material: &MATERIAL,
        net: std::ptr::null(),
    }
}

/// Entry of a net type.
pub const fn net_entry(name: &'static str) -> super::abi::PluginEntry {
    super::abi::PluginEntry { kind: super::abi::KIND_NET, name: Text::of(name), material: std::ptr::null(), net: &NET }
}

static MATERIAL: MaterialTable = MaterialTable {
    struct_size: size_of::<MaterialTable>(),
    create: Some(material_create),
    destroy: Some(material_destroy),
    describe: Some(material_describe),
    parameter: Some(material_parameter),
    with_parameters: Some(material_with_parameters),
    membrane_f32: Some(material_membrane::<f32>),
    membrane_f64: Some(material_membrane::<f64>),
    hinge_f32: Some(material_hinge::<f32>),
    hinge_f64: Some(material_hinge::<f64>),
    normalise: Some(normalise::<dyn MaterialSpec>),
};

static NET: NetTable = NetTable {
    struct_size: size_of::<NetTable>(),
    create: Some(net_create),
    destroy: Some(net_destroy),
    describe: Some(net_describe),
    tensor: Some(net_tensor),
    initialise: Some(net_initialise),
    tape_len: Some(net_tape_len),
    forward_f32: Some(net_forward_f32),
    forward_f64: Some(net_forward_f64),
    backward_f32: Some(net_backward_f32),
    backward_f64: Some(net_backward_f64),
    normalise: Some(normalise::<dyn NetSpec>),
};

/// Runs the plugin's own code: errors and panics become a status and a text.
///
/// # Safety
/// `error` is alive.
unsafe fn guarded(error: Sink, run: impl FnOnce() -> Result<()>) -> i32 {
    let (status, text) = match catch_unwind(AssertUnwindSafe(run)) {
        Ok(Ok(())) => return OK,
        Ok(Err(Error::Unsupported { what, .. })) => (UNSUPPORTED, what),
        Ok(Err(Error::Config { key, problem, remedy })) => (CONFIG, lines([&key, &problem, &remedy])),
        Ok(Err(Error::Length { what, expected, got })) => (LENGTH, lines([&what, &expected, &got])),
        Ok(Err(Error::NonFinite { what, index, value })) => (NON_FINITE, lines([&what, &index, &value])),
        Ok(Err(Error::Parameter { name, value, lower, upper, unit })) => {
            (PARAMETER, lines([&name, &value, &lower, &upper, &unit]))
        }
        Ok(Err(other)) => (FAILED, other.to_string()),
        Err(payload) => {
            let text = payload.downcast_ref::<&str>().map(|t| (*t).to_string());
            (
                PANICKED,
                text.or_else(|| payload.downcast_ref::<String>().cloned()).unwrap_or_else(|| "no message".into()),
            )
        }
    };
    // SAFETY: the caller vouches for the sink.
    unsafe { error.put(&text) };
    status
}

/// One line per part; a part of several lines becomes one.
fn lines<const N: usize>(parts: [&dyn std::fmt::Display; N]) -> String {
    parts.map(|part| part.to_string().replace(['\r', '\n'], " ")).join("\n")
}

/// The key of an error about a table that cannot be read at all: the parser's message says where.
pub const WHOLE_TABLE: &str = "(table)";

/// The text of a table as a specification.
///
/// # Safety
/// `toml` is readable for the call.
unsafe fn spec<S: ?Sized>(toml: Text) -> Result<Box<S>>
where
    Box<S>: DeserializeOwned,
{
    // SAFETY: the caller vouches for the text.
    let text = unsafe { toml.get() };
    let text = text.ok_or_else(|| Error::config(WHOLE_TABLE, "is not UTF-8 text", "hand over UTF-8"))?;
    toml::from_str(text).map_err(|e| Error::config(WHOLE_TABLE, e.message().trim(), "correct the table"))
}

unsafe extern "C" fn normalise<S: ?Sized>(toml: Text, out: Sink, error: Sink) -> i32
where
    Box<S>: DeserializeOwned + Serialize,
{
    let run = || {
        // SAFETY: the host keeps text and sink alive during the call.
        let spec = unsafe { spec::<S>(toml) }?;
        let text = toml::to_string(&spec)
            .map_err(|e| Error::config(WHOLE_TABLE, e.to_string(), "report this to the plugin's author"))?;
        // SAFETY: as above.
        unsafe { out.put(&text) };
        Ok(())
    };
    // SAFETY: as above.
    unsafe { guarded(error, run) }
}

type MaterialHandle = Box<dyn MaterialModel>;
type NetHandle = Box<dyn DeformationNet>;

/// Hands a boxed value out as a handle.
///
/// # Safety
/// `out` is writable.
unsafe fn give<T>(value: T, out: *mut *mut c_void) {
    // SAFETY: the caller vouches for `out`.
    unsafe { *out = Box::into_raw(Box::new(value)).cast() }
}

/// The material behind a handle.
///
/// # Safety
/// `handle` was given by [`material_create`] or [`material_with_parameters`] and not destroyed.
unsafe fn material<'a>(handle: *const c_void) -> &'a dyn MaterialModel {
    // SAFETY: the caller vouches for the handle.
    unsafe { &**handle.cast::<MaterialHandle>() }
}

unsafe extern "C" fn material_create(toml: Text, out: *mut *mut c_void, error: Sink) -> i32 {
    let run = || {
        // SAFETY: the host keeps the text alive during the call.
        let built = unsafe { spec::<dyn MaterialSpec>(toml) }?.build()?;
        // SAFETY: `out` is the host's own variable.
        unsafe { give::<MaterialHandle>(built, out) };
        Ok(())
    };
    // SAFETY: the host keeps the sink alive during the call.
    unsafe { guarded(error, run) }
}

unsafe extern "C" fn material_destroy(handle: *mut c_void) {
    // A destructor that panics must not cross the border, and nobody is left to tell.
    let drop_it = || {
        // SAFETY: the host destroys each handle once.
        drop(unsafe { Box::from_raw(handle.cast::<MaterialHandle>()) });
    };
    catch_unwind(AssertUnwindSafe(drop_it)).ok();
}

unsafe extern "C" fn material_describe(handle: *const c_void, out: *mut MaterialFacts, error: Sink) -> i32 {
    let run = || {
        // SAFETY: handles come from this module.
        let model = unsafe { material(handle) };
        let d = model.describe();
        let facts = MaterialFacts {
            density: d.density.map_or(f64::NAN, |d| d.0),
            parameter_count: model.parameters().len(),
            stiffness_frozen: d.stiffness_frozen.into(),
            hinge_length: match d.hinge_length {
                HingeLength::Rest => 0,
                HingeLength::CurrentHeld => 1,
                HingeLength::Current => 2,
            },
            linear_in_parameters: d.linear_in_parameters.into(),
            offers_tangent_held: d.offers.tangent_held.into(),
            offers_tangent_total: d.offers.tangent_total.into(),
            offers_by_parameter: d.offers.by_parameter.into(),
            offers_stiffness: d.offers.stiffness.into(),
            offers_hinge_slopes: d.offers.hinge_slopes.into(),
        };
        // SAFETY: `out` is the host's own variable.
        unsafe { *out = facts };
        Ok(())
    };
    // SAFETY: the host keeps the sink alive during the call.
    unsafe { guarded(error, run) }
}

unsafe extern "C" fn material_parameter(
    handle: *const c_void,
    index: usize,
    out: *mut ParameterFacts,
    name: Sink,
    unit: Sink,
    error: Sink,
) -> i32 {
    let run = || {
        // SAFETY: handles come from this module.
        let all = unsafe { material(handle) }.parameters();
        let p = all.get(index).ok_or_else(|| Error::Length {
            what: "parameters".into(),
            expected: all.len(),
            got: index.saturating_add(1),
        })?;
        // SAFETY: `out` is the host's own variable, and the host keeps the sinks alive during the call.
        unsafe {
            *out = ParameterFacts { value: p.value, lower: p.lower, upper: p.upper };
            name.put(&p.name);
            unit.put(&p.unit);
        }
        Ok(())
    };
    // SAFETY: the host keeps the sink alive during the call.
    unsafe { guarded(error, run) }
}

unsafe extern "C" fn material_with_parameters(
    handle: *const c_void,
    values: *const f64,
    count: usize,
    out: *mut *mut c_void,
    error: Sink,
) -> i32 {
    let run = || {
        // SAFETY: the host hands over `count` values and a handle of this module.
        let (model, values) = unsafe { (material(handle), slice(values, count)) };
        let changed = model.with_parameters(values)?;
        // SAFETY: `out` is the host's own variable.
        unsafe { give::<MaterialHandle>(changed, out) };
        Ok(())
    };
    // SAFETY: the host keeps the sink alive during the call.
    unsafe { guarded(error, run) }
}

/// A slice that may be null when it is empty.
///
/// # Safety
/// `data` points to `count` readable values that live for `'a`, or `count` is 0.
unsafe fn slice<'a, T>(data: *const T, count: usize) -> &'a [T] {
    if count == 0 {
        return &[];
    }
    // SAFETY: the caller vouches for the values.
    unsafe { std::slice::from_raw_parts(data, count) }
}

unsafe extern "C" fn material_membrane<T: MaterialReal>(
    handle: *const c_void,
    block: *mut MembraneBlock<'static, T>,
    error: Sink,
) -> i32 {
    // SAFETY: the handle is of this module; the host lends the block for the call alone, and it is not kept.
    let run = || unsafe { T::membrane(material(handle), &mut *block) };
    // SAFETY: the host keeps the sink alive during the call.
    unsafe { guarded(error, run) }
}

unsafe extern "C" fn material_hinge<T: MaterialReal>(
    handle: *const c_void,
    block: *mut HingeBlock<'static, T>,
    error: Sink,
) -> i32 {
    // SAFETY: the handle is of this module; the host lends the block for the call alone, and it is not kept.
    let run = || unsafe { T::hinge(material(handle), &mut *block) };
    // SAFETY: the host keeps the sink alive during the call.
    unsafe { guarded(error, run) }
}

/// The net behind a handle.
///
/// # Safety
/// `handle` was given by [`net_create`] and not destroyed.
unsafe fn net<'a>(handle: *const c_void) -> &'a dyn DeformationNet {
    // SAFETY: the caller vouches for the handle.
    unsafe { &**handle.cast::<NetHandle>() }
}

unsafe extern "C" fn net_create(toml: Text, inputs: usize, outputs: usize, out: *mut *mut c_void, error: Sink) -> i32 {
    let run = || {
        // SAFETY: the host keeps the text alive during the call.
        let built = unsafe { spec::<dyn NetSpec>(toml) }?.build(inputs, outputs)?;
        // SAFETY: `out` is the host's own variable.
        unsafe { give::<NetHandle>(built, out) };
        Ok(())
    };
    // SAFETY: the host keeps the sink alive during the call.
    unsafe { guarded(error, run) }
}

unsafe extern "C" fn net_destroy(handle: *mut c_void) {
    // As for materials.
    let drop_it = || {
        // SAFETY: the host destroys each handle once.
        drop(unsafe { Box::from_raw(handle.cast::<NetHandle>()) });
    };
    catch_unwind(AssertUnwindSafe(drop_it)).ok();
}

unsafe extern "C" fn net_describe(handle: *const c_void, out: *mut NetFacts, error: Sink) -> i32 {
    let run = || {
        // SAFETY: handles come from this module.
        let net = unsafe { net(handle) };
        let (manifest, offers) = (net.manifest(), net.offers());
        let facts = NetFacts {
            inputs: manifest.inputs,
            outputs: manifest.outputs,
            state: manifest.state,
            tensor_count: manifest.tensors.len(),
            offers_double: offers.double.into(),
            offers_feature_gradient: offers.feature_gradient.into(),
        };
        // SAFETY: `out` is the host's own variable.
        unsafe { *out = facts };
        Ok(())
    };
    // SAFETY: the host keeps the sink alive during the call.
    unsafe { guarded(error, run) }
}

unsafe extern "C" fn net_tensor(
    handle: *const c_void,
    index: usize,
    out: *mut TensorFacts,
    name: Sink,
    error: Sink,
) -> i32 {
    let run = || {
        // SAFETY: handles come from this module.
        let all = &unsafe { net(handle) }.manifest().tensors;
        let tensor = all.get(index).ok_or_else(|| Error::Length {
            what: "tensors".into(),
            expected: all.len(),
            got: index.saturating_add(1),
        })?;
        let rank = tensor.shape.len();
        if rank > MAX_RANK {
            let what = format!("tensor {} of {rank} dimensions (at most {MAX_RANK})", tensor.name);
            return Err(Error::unsupported(what, "the plugin interface"));
        }
        let mut facts = TensorFacts { offset: tensor.offset, rank, shape: [0; MAX_RANK] };
        facts.shape[..rank].copy_from_slice(&tensor.shape);
        // SAFETY: `out` is the host's own variable, and the host keeps the sink alive during the call.
        unsafe {
            *out = facts;
            name.put(&tensor.name);
        }
        Ok(())
    };
    // SAFETY: the host keeps the sink alive during the call.
    unsafe { guarded(error, run) }
}

unsafe extern "C" fn net_initialise(handle: *const c_void, seed: u64, out: *mut f64, count: usize, error: Sink) -> i32 {
    let run = || {
        // SAFETY: handles come from this module.
        let values = unsafe { net(handle) }.initialise(seed)?;
        Error::check_length("first parameters of the net", count, values.len())?;
        if count > 0 {
            // SAFETY: `out` has room for `count` values of the host's own.
            unsafe { std::slice::from_raw_parts_mut(out, count) }.copy_from_slice(&values);
        }
        Ok(())
    };
    // SAFETY: the host keeps the sink alive during the call.
    unsafe { guarded(error, run) }
}

unsafe extern "C" fn net_tape_len(
    handle: *const c_void,
    steps: usize,
    batch: usize,
    out: *mut usize,
    error: Sink,
) -> i32 {
    let run = || {
        // SAFETY: the handle is of this module, `out` the host's own variable.
        unsafe { *out = net(handle).tape_len(steps, batch)? };
        Ok(())
    };
    // SAFETY: the host keeps the sink alive during the call.
    unsafe { guarded(error, run) }
}

macro_rules! passes {
    ($($name:ident: $block:ident<$real:ty> => $method:ident($call:ident::$variant:ident)),* $(,)?) => {
        $(
            unsafe extern "C" fn $name(handle: *const c_void, block: *mut $block<'static, $real>, error: Sink) -> i32 {
                // SAFETY: the handle is of this module; the host lends the block for the call alone, and it is not kept.
                let run = || unsafe { net(handle).$method($call::$variant(&mut *block)) };
                // SAFETY: the host keeps the sink alive during the call.
                unsafe { guarded(error, run) }
            }
        )*
    };
}

passes! {
    net_forward_f32: ForwardBlock<f32> => forward(ForwardCall::F32),
    net_forward_f64: ForwardBlock<f64> => forward(ForwardCall::F64),
    net_backward_f32: BackwardBlock<f32> => backward(BackwardCall::F32),
    net_backward_f64: BackwardBlock<f64> => backward(BackwardCall::F64),
}
