//! ONNX Runtime: its library, loaded once in a process, and sessions.

use super::{Element, Missing, Port, Tensor, Values};
use ort::environment::Environment;
use ort::logging::LogLevel;
use ort::session::builder::GraphOptimizationLevel;
use ort::value::{DynValue, Outlet, TensorElementType, ValueType};
use std::path::PathBuf;
use std::sync::OnceLock;

/// Names the library; ONNX Runtime's bindings in other languages read the same variable.
const VARIABLE: &str = "ORT_DYLIB_PATH";

/// ONNX Runtime allows one environment in a process.
static ENVIRONMENT: OnceLock<Result<Environment, String>> = OnceLock::new();

pub(super) fn available() -> Result<(), Missing> {
    environment().map(drop).map_err(|problem| {
        let remedy = format!(
            "set {VARIABLE} to the file of ONNX Runtime's library, of version 1.{} or newer; docs/scans.md says where it comes from",
            ort::MINOR_VERSION
        );
        Missing { problem: format!("needs ONNX Runtime, which cannot be loaded: {problem}"), remedy }
    })
}

fn environment() -> Result<&'static Environment, &'static str> {
    ENVIRONMENT.get_or_init(load).as_ref().map_err(String::as_str)
}

fn load() -> Result<Environment, String> {
    let (path, named) = match std::env::var_os(VARIABLE).filter(|v| !v.is_empty()) {
        Some(path) => (PathBuf::from(path), format!("{VARIABLE} is set")),
        // Wherever the system looks for libraries.
        None => (PathBuf::from(library_name()), format!("{VARIABLE} is not set")),
    };
    let loaded = ort::init_from(&path).map_err(|e| e.to_string());
    let environment = loaded.and_then(|builder| builder.with_telemetry(false).build().map_err(|e| e.to_string()));
    let environment = environment.map_err(|problem| format!("{named}, and {}", super::one_line(&problem)))?;
    // What goes wrong comes back as an error.
    environment.set_log_level(LogLevel::Fatal);
    Ok(environment)
}

/// The library's name on this system.
fn library_name() -> String {
    format!("{}onnxruntime{}", std::env::consts::DLL_PREFIX, std::env::consts::DLL_SUFFIX)
}

/// A session whose answers do not depend on the machine's number of cores.
fn made(environment: &Environment, bytes: &[u8], threads: usize) -> ort::Result<ort::session::Session> {
    ort::session::Session::builder(environment)?
        .with_intra_threads(threads)?
        .with_inter_threads(1)?
        .with_parallel_execution(false)?
        .with_deterministic_compute(true)?
        .with_optimization_level(GraphOptimizationLevel::Level3)?
        .with_log_level(LogLevel::Fatal)?
        // Threads that wait for the next view must not take time from those that render it.
        .with_config_entry("session.intra_op.allow_spinning", "0")?
        .commit_from_memory(bytes)
}

pub(super) struct Session(ort::session::Session);

impl Session {
    pub(super) fn open(bytes: &[u8], threads: usize) -> Result<Self, String> {
        made(environment()?, bytes, threads).map(Self).map_err(|e| e.to_string())
    }

    /// Inputs and outputs.
    pub(super) fn ports(&self) -> (Vec<Port>, Vec<Port>) {
        let ports = |outlets: &[Outlet]| outlets.iter().map(port).collect();
        (ports(self.0.inputs()), ports(self.0.outputs()))
    }

    pub(super) fn run(
        &mut self,
        input: &str,
        shape: [usize; 4],
        values: Vec<f32>,
        ports: &[Port],
        outputs: &[usize],
    ) -> Result<Vec<Tensor>, String> {
        let tensor = ort::value::Tensor::from_array((shape, values)).map_err(|e| e.to_string())?;
        let answers = self.0.run(ort::inputs![input => tensor]).map_err(|e| e.to_string())?;
        let read = |&i: &usize| {
            let name = &ports[i].name;
            let answer = answers.get(name).ok_or_else(|| format!("there is no answer `{name}`"))?;
            tensor_of(answer).map_err(|problem| format!("answer `{name}`: {problem}"))
        };
        outputs.iter().map(read).collect()
    }
}

fn port(outlet: &Outlet) -> Port {
    let (element, shape) = match outlet.dtype() {
        ValueType::Tensor { ty, shape, .. } => {
            // Sizes that a run decides are −1.
            (element(*ty), shape.iter().map(|&n| usize::try_from(n).ok()).collect())
        }
        other => (Element::Other(other.to_string()), Vec::new()),
    };
    Port { name: outlet.name().into(), element, shape }
}

fn element(ty: TensorElementType) -> Element {
    match ty {
        TensorElementType::Float32 => Element::F32,
        TensorElementType::Int64 | TensorElementType::Int32 | TensorElementType::Uint8 => Element::Integer,
        other => Element::Other(other.to_string()),
    }
}

fn tensor_of(answer: &DynValue) -> Result<Tensor, String> {
    let ValueType::Tensor { ty, shape, .. } = answer.dtype() else {
        return Err(format!("it is {}", answer.dtype()));
    };
    let shape =
        shape.iter().map(|&n| usize::try_from(n).map_err(|_| format!("a size is {n}"))).collect::<Result<_, _>>()?;
    macro_rules! integers {
        ($of:ty) => {
            answer.try_extract_tensor::<$of>().map(|(_, v)| Values::Integer(v.iter().map(|&i| i64::from(i)).collect()))
        };
    }
    let values = match ty {
        TensorElementType::Float32 => answer.try_extract_tensor::<f32>().map(|(_, v)| Values::F32(v.to_vec())),
        TensorElementType::Int64 => integers!(i64),
        TensorElementType::Int32 => integers!(i32),
        TensorElementType::Uint8 => integers!(u8),
        other => return Err(format!("its values are {other}")),
    };
    Ok(Tensor { shape, values: values.map_err(|e| e.to_string())? })
}
