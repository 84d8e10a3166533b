//! Networks in ONNX files: a picture in, tensors out.
//!
//! The file is run by ONNX Runtime, which is no part of this program: it is a library of the machine, found when a network is first
//! opened, and only in builds with the feature `onnx`. In other builds, and where the library is missing, [`available`] and
//! [`Network::open`] say so.

mod picture;
#[cfg(feature = "onnx")]
mod runtime;
#[cfg(not(feature = "onnx"))]
#[path = "absent.rs"]
mod runtime;

pub use picture::{ChannelOrder, Corners, Fit, Pixels, Placement};

use caphy_core::{Error, Result};
use std::fmt;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

/// What a build needs to run networks.
pub const FEATURE: &str = "build it with `cargo build --release --features onnx`";

/// Type of a tensor's values.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Element {
    /// Single precision.
    F32,
    /// Integers: of 64, 32 or 8 bits in the file, of 64 here.
    Integer,
    /// Another one, by its ONNX name: neither read nor written here.
    Other(String),
}

/// An input or output as the file declares it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Port {
    /// Name.
    pub name: String,
    /// Type of its values.
    pub element: Element,
    /// Shape; `None` for a size that each run decides.
    pub shape: Vec<Option<usize>>,
}

impl fmt::Display for Port {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let element = match &self.element {
            Element::F32 => "float",
            Element::Integer => "integer",
            Element::Other(name) => name,
        };
        let shape: Vec<String> = self.shape.iter().map(|s| s.map_or("?".into(), |n| n.to_string())).collect();
        write!(f, "`{}` ({element} [{}])", self.name, shape.join(", "))
    }
}

/// Values of an output.
#[derive(Debug, Clone, PartialEq)]
pub enum Values {
    /// Single precision.
    F32(Vec<f32>),
    /// Integers.
    Integer(Vec<i64>),
}

/// An output of one run.
#[derive(Debug, Clone, PartialEq)]
pub struct Tensor {
    /// Sizes, slowest first.
    pub shape: Vec<usize>,
    /// Values, as many as the shape says.
    pub values: Values,
}

/// `Ok` when networks can be run: this build can, and ONNX Runtime's library was found. `asked` is the configuration's key that needs it.
///
/// # Errors
/// [`Error::Config`] with `asked` as key, saying how to build the feature in, or naming `ORT_DYLIB_PATH`.
pub fn available(asked: &str) -> Result<()> {
    runtime::available().map_err(|missing| missing.error(asked))
}

/// Why no network can be run.
struct Missing {
    problem: String,
    remedy: String,
}

impl Missing {
    fn error(self, key: &str) -> Error {
        Error::config(key, self.problem, self.remedy)
    }
}

/// A network that takes one picture, shape [1, 3, height, width].
///
/// Its answers depend on the file, the picture and the number of threads alone. Runs of one network wait for each other: what is
/// parallel is inside.
pub struct Network {
    path: PathBuf,
    input: Port,
    outputs: Vec<Port>,
    session: Mutex<runtime::Session>,
}

impl fmt::Debug for Network {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { path, input, outputs, .. } = self;
        f.debug_struct("Network").field("path", path).field("input", input).field("outputs", outputs).finish()
    }
}

impl Network {
    /// Opens the network in `bytes`, the content of the file `path`, to be run by `threads` threads; `asked` is the configuration's key
    /// that names it.
    ///
    /// # Errors
    /// Those of [`available`]; [`Error::Format`] for what is no ONNX network, for another input than one of pictures, and for one that
    /// has no output.
    pub fn open(asked: &str, path: &Path, bytes: &[u8], threads: usize) -> Result<Self> {
        available(asked)?;
        let session = runtime::Session::open(bytes, threads).map_err(|problem| {
            let remedy = "export it again as one ONNX file, weights included, for the installed ONNX Runtime";
            Error::format(path, "network", one_line(&problem), remedy)
        })?;
        let (inputs, outputs) = session.ports();
        let refused = |at: &str, problem: String| {
            let remedy = "export the network with one float input of shape [1, 3, height, width]";
            Error::format(path, at, problem, remedy)
        };
        let [input] = &inputs[..] else {
            return Err(refused("inputs", format!("there are {}: {}", inputs.len(), list(&inputs))));
        };
        let fits = |at: usize, size: usize| input.shape[at].is_none_or(|n| n == size);
        if input.element != Element::F32 || input.shape.len() != 4 || !fits(0, 1) || !fits(1, 3) {
            return Err(refused("input", format!("it is {input}")));
        }
        if outputs.is_empty() {
            return Err(refused("outputs", "there is none".into()));
        }
        Ok(Self { path: path.into(), input: input.clone(), outputs, session: Mutex::new(session) })
    }

    /// The file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// All outputs, in the file's order.
    pub fn outputs(&self) -> &[Port] {
        &self.outputs
    }

    /// Place of an output by its name.
    ///
    /// # Errors
    /// [`Error::Format`] listing the outputs that there are.
    pub fn output(&self, name: &str) -> Result<usize> {
        self.outputs.iter().position(|o| o.name == name).ok_or_else(|| {
            let problem = format!("there is no output `{name}`");
            Error::format(&self.path, "outputs", problem, format!("name one of {}", list(&self.outputs)))
        })
    }

    /// Height and width of its pictures: those that the file fixes, else those that are `wanted`, else the picture's own.
    ///
    /// # Errors
    /// [`Error::Format`] where the file fixes others than those that are wanted.
    pub fn size(&self, wanted: Option<[usize; 2]>, own: [usize; 2]) -> Result<[usize; 2]> {
        let fixed = [self.input.shape[2], self.input.shape[3]];
        let size: [usize; 2] = std::array::from_fn(|k| fixed[k].or(wanted.map(|w| w[k])).unwrap_or(own[k]));
        match wanted {
            Some([height, width]) if size != [height, width] => {
                let problem = format!("it is {}, not {height} × {width}", self.input);
                Err(Error::format(
                    &self.path,
                    "input",
                    problem,
                    "leave `input` out, or export the network for that size",
                ))
            }
            _ => Ok(size),
        }
    }

    /// Runs the network on one picture, shape [3, height, width]; the answers are those of `outputs` (places), in their order.
    ///
    /// # Errors
    /// [`Error::Length`] for a picture of another length, [`Error::Format`] for a run that fails and for answers that are neither
    /// single precision nor integers.
    pub fn run(&self, picture: Vec<f32>, [height, width]: [usize; 2], outputs: &[usize]) -> Result<Vec<Tensor>> {
        let what = format!("picture for {} [3 · {height} · {width}]", self.path.display());
        Error::check_length(&what, 3 * height * width, picture.len())?;
        // A panic in another thread's run leaves the session as it was before.
        let mut session = self.session.lock().unwrap_or_else(PoisonError::into_inner);
        session.run(&self.input.name, [1, 3, height, width], picture, &self.outputs, outputs).map_err(|problem| {
            let at = format!("run on a picture of {height} × {width}");
            let remedy =
                "export the network for this size, with float or integer outputs; `input` in its table says the size";
            Error::format(&self.path, at, one_line(&problem), remedy)
        })
    }
}

fn list(ports: &[Port]) -> String {
    match ports {
        [] => "none".into(),
        _ => ports.iter().map(Port::to_string).collect::<Vec<_>>().join(", "),
    }
}

/// The runtime's messages have several lines.
fn one_line(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}
