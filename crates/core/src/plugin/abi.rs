//! What crosses the border: `repr(C)` tables of functions, status codes, texts.

use crate::material::{HingeBlock, MembraneBlock};
use crate::net::{BackwardBlock, ForwardBlock};
use std::ffi::c_void;

/// Version of this interface; raised with every change of a struct, a code or a meaning.
pub const ABI_VERSION: u32 = 2;
/// Symbol of `uint32_t caphy_plugin_abi_version(void)`.
pub const VERSION_SYMBOL: &str = "caphy_plugin_abi_version";
/// Symbol of `const caphy_plugin_table *caphy_plugin(void)`.
pub const TABLE_SYMBOL: &str = "caphy_plugin";

/// The call succeeded.
pub const OK: i32 = 0;
/// The plugin does not offer what was asked; the text names it.
pub const UNSUPPORTED: i32 = 1;
/// A key of the table cannot be used; the text has three lines: the key, the problem, the remedy.
pub const CONFIG: i32 = 2;
/// Anything else went wrong.
pub const FAILED: i32 = 3;
/// The plugin panicked; the text is the panic's message.
pub const PANICKED: i32 = 4;
/// An array has the wrong length; the text has three lines: its name, the length expected, the length given.
pub const LENGTH: i32 = 5;
/// A value is NaN or infinite; the text has three lines: the array's name, the flat index, the value.
pub const NON_FINITE: i32 = 6;
/// A parameter is out of bounds; the text has five lines: its name, the value, both bounds, the unit.
pub const PARAMETER: i32 = 7;

/// [`PluginEntry::kind`] of a material.
pub const KIND_MATERIAL: u32 = 0;
/// [`PluginEntry::kind`] of a net.
pub const KIND_NET: u32 = 1;

/// Most dimensions of a tensor.
pub const MAX_RANK: usize = 8;

/// Borrowed UTF-8 text.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct Text {
    /// First byte; may be anything when `len` is 0.
    pub data: *const u8,
    /// Number of bytes.
    pub len: usize,
}

impl Text {
    /// A text that lives as long as the program.
    pub const fn of(text: &'static str) -> Self {
        Self { data: text.as_ptr(), len: text.len() }
    }
    /// A text for one call: the caller keeps it alive.
    pub fn borrowed(text: &str) -> Self {
        Self { data: text.as_ptr(), len: text.len() }
    }
    /// The bytes as text; `None` for a null pointer with a length, or bytes that are not UTF-8.
    ///
    /// # Safety
    /// `data` points to `len` readable bytes that live for `'a`, or is null.
    pub unsafe fn get<'a>(self) -> Option<&'a str> {
        if self.len == 0 {
            return Some("");
        }
        if self.data.is_null() {
            return None;
        }
        // SAFETY: not null, and the caller vouches for the bytes.
        std::str::from_utf8(unsafe { std::slice::from_raw_parts(self.data, self.len) }).ok()
    }
}

/// Where a callee writes text: it calls `write(context, data, len)` any number of times.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct Sink {
    /// Handed back to `write`.
    pub context: *mut c_void,
    /// Appends a piece of text.
    pub write: unsafe extern "C" fn(context: *mut c_void, data: *const u8, len: usize),
}

impl Sink {
    /// A sink that appends to a buffer, which must outlive the call that it is given to.
    pub fn to(buffer: &mut Vec<u8>) -> Self {
        unsafe extern "C" fn append(context: *mut c_void, data: *const u8, len: usize) {
            if len == 0 || data.is_null() {
                return;
            }
            // SAFETY: `context` is the buffer of `Sink::to`, alive during the call; the callee vouches for its bytes.
            unsafe { (*context.cast::<Vec<u8>>()).extend_from_slice(std::slice::from_raw_parts(data, len)) }
        }
        Self { context: std::ptr::from_mut(buffer).cast(), write: append }
    }
    /// Appends a text.
    ///
    /// # Safety
    /// The sink's buffer is still alive.
    pub unsafe fn put(self, text: &str) {
        // SAFETY: the caller vouches for the buffer; the text is readable.
        unsafe { (self.write)(self.context, text.as_ptr(), text.len()) }
    }
}

/// Facts about a material: [`crate::material::MaterialDescription`] without its name.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default)]
pub struct MaterialFacts {
    /// Area density [kg/m²]; NaN when the material does not know it.
    pub density: f64,
    /// Number of native parameters.
    pub parameter_count: usize,
    /// 1 when the stress holds the stiffness instead of differentiating it.
    pub stiffness_frozen: u8,
    /// Edge length in Eq. 7: 0 rest, 1 current but held, 2 current.
    pub hinge_length: u8,
    /// 1 when energy and stress are linear in the parameters.
    pub linear_in_parameters: u8,
    /// 1 when `tangent_held` is answered.
    pub offers_tangent_held: u8,
    /// 1 when `tangent_total` is answered.
    pub offers_tangent_total: u8,
    /// 1 when derivatives by parameters are answered.
    pub offers_by_parameter: u8,
    /// 1 when the four orthotropic constants are answered.
    pub offers_stiffness: u8,
    /// 1 when derivatives of the bending stiffness by angle and length are answered.
    pub offers_hinge_slopes: u8,
}

/// Value and bounds of a native parameter.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default)]
pub struct ParameterFacts {
    /// Present value, in the parameter's unit.
    pub value: f64,
    /// Smallest allowed value.
    pub lower: f64,
    /// Largest allowed value.
    pub upper: f64,
}

/// Functions of a material type. None may be null except `normalise`.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct MaterialTable {
    /// `sizeof` of this struct as the plugin was built.
    pub struct_size: usize,
    /// Makes a material from its TOML table (`type` and its keys).
    pub create: Option<unsafe extern "C" fn(toml: Text, out: *mut *mut c_void, error: Sink) -> i32>,
    /// Ends a material.
    pub destroy: Option<unsafe extern "C" fn(material: *mut c_void)>,
    /// Facts.
    pub describe: Option<unsafe extern "C" fn(material: *const c_void, out: *mut MaterialFacts, error: Sink) -> i32>,
    /// Parameter `index`, its name and its unit.
    pub parameter: Option<
        unsafe extern "C" fn(
            material: *const c_void,
            index: usize,
            out: *mut ParameterFacts,
            name: Sink,
            unit: Sink,
            error: Sink,
        ) -> i32,
    >,
    /// A new material with other parameter values, all of them, within their bounds.
    pub with_parameters: Option<
        unsafe extern "C" fn(
            material: *const c_void,
            values: *const f64,
            count: usize,
            out: *mut *mut c_void,
            error: Sink,
        ) -> i32,
    >,
    /// Membrane block, single precision.
    pub membrane_f32: Option<
        unsafe extern "C" fn(material: *const c_void, block: *mut MembraneBlock<'static, f32>, error: Sink) -> i32,
    >,
    /// Membrane block, double precision.
    pub membrane_f64: Option<
        unsafe extern "C" fn(material: *const c_void, block: *mut MembraneBlock<'static, f64>, error: Sink) -> i32,
    >,
    /// Hinge block, single precision.
    pub hinge_f32:
        Option<unsafe extern "C" fn(material: *const c_void, block: *mut HingeBlock<'static, f32>, error: Sink) -> i32>,
    /// Hinge block, double precision.
    pub hinge_f64:
        Option<unsafe extern "C" fn(material: *const c_void, block: *mut HingeBlock<'static, f64>, error: Sink) -> i32>,
    /// Writes the table back with every default filled in; null when the plugin cannot.
    pub normalise: Option<unsafe extern "C" fn(toml: Text, out: Sink, error: Sink) -> i32>,
}

/// Sizes of a net.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default)]
pub struct NetFacts {
    /// Features per frame.
    pub inputs: usize,
    /// Outputs per frame.
    pub outputs: usize,
    /// Values of carried state per window.
    pub state: usize,
    /// Number of tensors.
    pub tensor_count: usize,
    /// 1 when double precision is answered.
    pub offers_double: u8,
    /// 1 when the gradient by the features is answered.
    pub offers_feature_gradient: u8,
}

/// Shape and place of a tensor in the flat parameters.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default)]
pub struct TensorFacts {
    /// First element in the flat vector.
    pub offset: usize,
    /// Number of dimensions, at most [`MAX_RANK`].
    pub rank: usize,
    /// Row-major shape; the first `rank` count.
    pub shape: [usize; MAX_RANK],
}

/// Functions of a net type. None may be null except `normalise`.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct NetTable {
    /// `sizeof` of this struct as the plugin was built.
    pub struct_size: usize,
    /// Makes a net of these sizes from its TOML table.
    pub create: Option<
        unsafe extern "C" fn(toml: Text, inputs: usize, outputs: usize, out: *mut *mut c_void, error: Sink) -> i32,
    >,
    /// Ends a net.
    pub destroy: Option<unsafe extern "C" fn(net: *mut c_void)>,
    /// Sizes.
    pub describe: Option<unsafe extern "C" fn(net: *const c_void, out: *mut NetFacts, error: Sink) -> i32>,
    /// Tensor `index` and its name.
    pub tensor: Option<
        unsafe extern "C" fn(net: *const c_void, index: usize, out: *mut TensorFacts, name: Sink, error: Sink) -> i32,
    >,
    /// First parameters from a seed, `count` of them.
    pub initialise:
        Option<unsafe extern "C" fn(net: *const c_void, seed: u64, out: *mut f64, count: usize, error: Sink) -> i32>,
    /// Length of the tape of a pass.
    pub tape_len: Option<
        unsafe extern "C" fn(net: *const c_void, steps: usize, batch: usize, out: *mut usize, error: Sink) -> i32,
    >,
    /// Forward pass, single precision.
    pub forward_f32:
        Option<unsafe extern "C" fn(net: *const c_void, block: *mut ForwardBlock<'static, f32>, error: Sink) -> i32>,
    /// Forward pass, double precision.
    pub forward_f64:
        Option<unsafe extern "C" fn(net: *const c_void, block: *mut ForwardBlock<'static, f64>, error: Sink) -> i32>,
    /// Backward pass, single precision.
    pub backward_f32:
        Option<unsafe extern "C" fn(net: *const c_void, block: *mut BackwardBlock<'static, f32>, error: Sink) -> i32>,
    /// Backward pass, double precision.
    pub backward_f64:
        Option<unsafe extern "C" fn(net: *const c_void, block: *mut BackwardBlock<'static, f64>, error: Sink) -> i32>,
    /// Writes the table back with every default filled in; null when the plugin cannot.
    pub normalise: Option<unsafe extern "C" fn(toml: Text, out: Sink, error: Sink) -> i32>,
}

/// One type of a library; the table of its kind is set, the other is null.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct PluginEntry {
    /// [`KIND_MATERIAL`] or [`KIND_NET`].
    pub kind: u32,
    /// The `type` name in TOML.
    pub name: Text,
    /// Functions of a material.
    pub material: *const MaterialTable,
    /// Functions of a net.
    pub net: *const NetTable,
}

/// What `caphy_plugin` returns.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct PluginTable {
    /// `sizeof` of this struct as the plugin was built.
    pub struct_size: usize,
    /// Number of types.
    pub type_count: usize,
    /// The types.
    pub types: *const PluginEntry,
}

/// A table that may stand in a `static`.
#[repr(transparent)]
pub struct Shared<T>(pub T);

// SAFETY: tables are never written after their construction, and what they point to is static.
unsafe impl<T> Sync for Shared<T> {}
