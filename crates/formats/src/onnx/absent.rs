//! In place of ONNX Runtime where the feature `onnx` is off: says so.

use super::{FEATURE, Missing, Port, Tensor};
use std::convert::Infallible;

pub(super) fn available() -> Result<(), Missing> {
    let problem = "needs ONNX Runtime, which this program was built without".into();
    Err(Missing { problem, remedy: FEATURE.into() })
}

/// There is none.
pub(super) struct Session(Infallible);

impl Session {
    pub(super) fn open(_bytes: &[u8], _threads: usize) -> Result<Self, String> {
        Err("no network can be opened".into())
    }
    pub(super) fn ports(&self) -> (Vec<Port>, Vec<Port>) {
        match self.0 {}
    }
    pub(super) fn run(
        &mut self,
        _input: &str,
        _shape: [usize; 4],
        _values: Vec<f32>,
        _ports: &[Port],
        _outputs: &[usize],
    ) -> Result<Vec<Tensor>, String> {
        match self.0 {}
    }
}
