//! Small ONNX files, written byte by byte as the format's protobuf messages say (onnx.proto, opset 13); and whether they can be run here.
//! Tests of other crates include this file.

use std::io::Write;

/// A tensor's value type, by its number in `TensorProto.DataType`.
#[derive(Clone, Copy)]
pub(crate) enum Type {
    Float = 1,
    Int64 = 7,
    Double = 11,
}

/// A network in the making.
#[derive(Default)]
pub(crate) struct Model {
    nodes: Vec<u8>,
    weights: Vec<u8>,
    inputs: Vec<u8>,
    outputs: Vec<u8>,
}

fn varint(mut value: u64, out: &mut Vec<u8>) {
    while value >= 0x80 {
        out.push(value as u8 | 0x80);
        value >>= 7;
    }
    out.push(value as u8);
}

/// A field that holds a number.
fn number(field: u64, value: u64, out: &mut Vec<u8>) {
    varint(field << 3, out);
    varint(value, out);
}

/// A field that holds bytes, text or a message.
fn bytes(field: u64, value: &[u8], out: &mut Vec<u8>) {
    varint(field << 3 | 2, out);
    varint(value.len() as u64, out);
    out.extend_from_slice(value);
}

/// A `ValueInfoProto`; sizes of −1 are decided by each run.
fn port(name: &str, element: Type, shape: &[i64]) -> Vec<u8> {
    let mut dims = Vec::new();
    for (i, size) in shape.iter().enumerate() {
        let mut dim = Vec::new();
        match u64::try_from(*size) {
            Ok(size) => number(1, size, &mut dim),
            Err(_) => bytes(2, format!("{name}_{i}").as_bytes(), &mut dim),
        }
        bytes(1, &dim, &mut dims);
    }
    let (mut tensor, mut kind, mut out) = (Vec::new(), Vec::new(), Vec::new());
    number(1, element as u64, &mut tensor);
    bytes(2, &dims, &mut tensor);
    bytes(1, &tensor, &mut kind);
    bytes(1, name.as_bytes(), &mut out);
    bytes(2, &kind, &mut out);
    out
}

impl Model {
    pub(crate) fn input(mut self, name: &str, element: Type, shape: &[i64]) -> Self {
        bytes(11, &port(name, element, shape), &mut self.inputs);
        self
    }
    pub(crate) fn output(mut self, name: &str, element: Type, shape: &[i64]) -> Self {
        bytes(12, &port(name, element, shape), &mut self.outputs);
        self
    }
    fn initializer(mut self, name: &str, element: Type, shape: &[i64], raw: &[u8]) -> Self {
        let mut tensor = Vec::new();
        shape.iter().for_each(|&n| number(1, n as u64, &mut tensor));
        number(2, element as u64, &mut tensor);
        bytes(8, name.as_bytes(), &mut tensor);
        bytes(9, raw, &mut tensor);
        bytes(5, &tensor, &mut self.weights);
        self
    }
    pub(crate) fn floats(self, name: &str, shape: &[i64], values: &[f32]) -> Self {
        let raw: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        self.initializer(name, Type::Float, shape, &raw)
    }
    pub(crate) fn integers(self, name: &str, shape: &[i64], values: &[i64]) -> Self {
        let raw: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        self.initializer(name, Type::Int64, shape, &raw)
    }
    /// An operation with attributes of one or several integers.
    pub(crate) fn node(mut self, op: &str, from: &[&str], to: &str, attributes: &[(&str, &[i64])]) -> Self {
        let mut node = Vec::new();
        from.iter().for_each(|name| bytes(1, name.as_bytes(), &mut node));
        bytes(2, to.as_bytes(), &mut node);
        bytes(4, op.as_bytes(), &mut node);
        for (name, values) in attributes {
            let mut attribute = Vec::new();
            bytes(1, name.as_bytes(), &mut attribute);
            match values {
                [value] => {
                    number(3, *value as u64, &mut attribute);
                    number(20, 2, &mut attribute);
                }
                _ => {
                    values.iter().for_each(|&v| number(8, v as u64, &mut attribute));
                    number(20, 7, &mut attribute);
                }
            }
            bytes(5, &attribute, &mut node);
        }
        bytes(1, &node, &mut self.nodes);
        self
    }
    /// The file.
    pub(crate) fn bytes(&self) -> Vec<u8> {
        let mut graph = self.nodes.clone();
        bytes(2, b"made-by-a-test", &mut graph);
        for part in [&self.weights, &self.inputs, &self.outputs] {
            graph.extend_from_slice(part);
        }
        let (mut opset, mut model) = (Vec::new(), Vec::new());
        bytes(1, b"", &mut opset);
        number(2, 13, &mut opset);
        number(1, 8, &mut model);
        bytes(7, &graph, &mut model);
        bytes(8, &opset, &mut model);
        model
    }
}

/// Whether networks can be run on this machine; says so where they cannot.
///
/// # Panics
/// Where `ORT_DYLIB_PATH` names a library that cannot be used: somebody wanted these tests.
pub(crate) fn runnable() -> bool {
    let Err(missing) = caphy_formats::onnx::available("tests") else { return true };
    assert!(std::env::var_os("ORT_DYLIB_PATH").is_none(), "{missing}");
    // Straight to the terminal: what the print macros write is only shown for tests that fail.
    let _ = writeln!(std::io::stderr(), "SKIPPED: networks are not run: {missing}");
    false
}
