//! Networks in ONNX files, run by ONNX Runtime.
#![cfg(feature = "onnx")]

mod model;

use caphy_formats::onnx::{Network, Tensor, Values};
use model::{Model, Type, runnable};
use std::path::Path;

fn open(model: &Model) -> caphy_core::Result<Network> {
    Network::open("segmenter.type", Path::new("small.onnx"), &model.bytes(), 2)
}

/// y = 2 red − blue + 0.5 per pixel, its mean over blocks of 2 × 2, and where it is the largest of (0, y).
fn sums(size: [i64; 2]) -> Model {
    let [h, w] = size;
    Model::default()
        .input("picture", Type::Float, &[1, 3, h, w])
        .floats("weights", &[2, 3, 1, 1], &[0.0, 0.0, 0.0, 2.0, 0.0, -1.0])
        .floats("bias", &[2], &[0.0, 0.5])
        .node("Conv", &["picture", "weights", "bias"], "sum", &[("kernel_shape", &[1, 1])])
        .node("AveragePool", &["sum"], "blocks", &[("kernel_shape", &[2, 2]), ("strides", &[2, 2])])
        .node("ArgMax", &["sum"], "where", &[("axis", &[1]), ("keepdims", &[0])])
        .output("sum", Type::Float, &[1, 2, h, w])
        .output("blocks", Type::Float, &[1, 2, -1, -1])
        .output("where", Type::Int64, &[1, h, w])
}

#[test]
fn a_network_answers_what_its_operations_say() {
    if !runnable() {
        return;
    }
    let network = open(&sums([-1, -1])).unwrap();
    let names: Vec<&str> = network.outputs().iter().map(|o| o.name.as_str()).collect();
    assert_eq!(names, ["sum", "blocks", "where"]);
    assert_eq!(network.size(None, [2, 4]).unwrap(), [2, 4]);
    assert_eq!(network.size(Some([6, 8]), [2, 4]).unwrap(), [6, 8]);
    // Eighths: every sum is exact.
    let (red, blue): (Vec<f32>, Vec<f32>) = (0..8u8).map(|i| (f32::from(i) / 8.0, f32::from(i * i % 8) / 4.0)).unzip();
    let picture = [&red[..], &[7.0; 8], &blue].concat();
    let sum: Vec<f32> = red.iter().zip(&blue).map(|(r, b)| 2.0 * r - b + 0.5).collect();
    let blocks: Vec<f32> = [0, 2].map(|x| 0.25 * (sum[x] + sum[x + 1] + sum[4 + x] + sum[5 + x])).to_vec();
    let places: Vec<usize> = ["where", "blocks", "sum"].map(|name| network.output(name).unwrap()).to_vec();
    let answers = network.run(picture, [2, 4], &places).unwrap();
    let zeros = |n: usize, values: &[f32]| Values::F32([&vec![0.0; n][..], values].concat());
    let expected = [
        Tensor { shape: vec![1, 2, 4], values: Values::Integer(sum.iter().map(|s| i64::from(*s > 0.0)).collect()) },
        Tensor { shape: vec![1, 2, 1, 2], values: zeros(2, &blocks) },
        Tensor { shape: vec![1, 2, 2, 4], values: zeros(8, &sum) },
    ];
    assert_eq!(answers, expected);
    let said = network.output("fusion").unwrap_err().to_string();
    assert!(said.contains("`fusion`") && said.contains("`blocks` (float [1, 2, ?, ?])"), "{said}");
    assert!(network.run(vec![0.0; 5], [2, 4], &[0]).unwrap_err().to_string().contains("expected 24 values, got 5"));
}

#[test]
fn sizes_that_a_file_fixes_are_kept() {
    if !runnable() {
        return;
    }
    let network = open(&sums([6, 8])).unwrap();
    assert_eq!(network.size(None, [512, 512]).unwrap(), [6, 8]);
    assert_eq!(network.size(Some([6, 8]), [512, 512]).unwrap(), [6, 8]);
    let said = network.size(Some([6, 9]), [512, 512]).unwrap_err().to_string();
    assert!(said.contains("`picture` (float [1, 3, 6, 8])") && said.contains("6 × 9"), "{said}");
}

#[test]
fn files_that_are_no_such_network_are_named() {
    if !runnable() {
        return;
    }
    let whole = sums([-1, -1]).bytes();
    for cut in [&[][..], b"PK no network", &whole[..whole.len() / 2], &whole[..whole.len() - 3], &whole[1..]] {
        let said = Network::open("segmenter.type", Path::new("small.onnx"), cut, 1).unwrap_err().to_string();
        assert!(said.contains("small.onnx, network") && !said.contains('\n'), "{said}");
    }
    let passed = |input: &[i64], element| {
        Model::default().input("x", element, input).node("Identity", &["x"], "y", &[]).output("y", element, input)
    };
    let two = passed(&[1, 3, 4, 4], Type::Float).input("z", Type::Float, &[1]);
    for (model, words) in [
        (passed(&[1, 4, 4, 3], Type::Float), "`x` (float [1, 4, 4, 3])"),
        (passed(&[2, 3, 4, 4], Type::Float), "`x` (float [2, 3, 4, 4])"),
        (passed(&[3, 4, 4], Type::Float), "`x` (float [3, 4, 4])"),
        (passed(&[1, 3, 4, 4], Type::Double), "`x` (f64 [1, 3, 4, 4])"),
        (two, "there are 2"),
    ] {
        let said = open(&model).unwrap_err().to_string();
        assert!(said.contains(words) && said.contains("[1, 3, height, width]"), "{said}");
    }
}

#[test]
fn runs_that_fail_are_named() {
    if !runnable() {
        return;
    }
    // Only pictures of 16 values can be reshaped.
    let reshaped = Model::default()
        .input("x", Type::Float, &[1, 3, -1, -1])
        .integers("shape", &[3], &[1, 6, 8])
        .node("Reshape", &["x", "shape"], "y", &[])
        .output("y", Type::Float, &[1, 6, 8]);
    let network = open(&reshaped).unwrap();
    assert_eq!(network.run(vec![0.0; 48], [4, 4], &[0]).unwrap()[0].shape, [1, 6, 8]);
    let said = network.run(vec![0.0; 75], [5, 5], &[0]).unwrap_err().to_string();
    assert!(said.contains("small.onnx") && said.contains("5 × 5") && !said.contains('\n'), "{said}");
    let doubles = Model::default()
        .input("x", Type::Float, &[1, 3, -1, -1])
        .node("Cast", &["x"], "y", &[("to", &[Type::Double as i64])])
        .output("y", Type::Double, &[1, 3, -1, -1]);
    let said = open(&doubles).unwrap().run(vec![0.0; 12], [2, 2], &[0]).unwrap_err().to_string();
    assert!(said.contains("answer `y`") && said.contains("f64"), "{said}");
}

/// A process loads one library, once: another one needs another process.
#[test]
fn a_missing_library_is_named() {
    let test = std::env::current_exe().unwrap();
    let output = std::process::Command::new(test)
        .args(["--exact", "child_whose_library_is_missing", "--ignored", "--nocapture"])
        .env("ORT_DYLIB_PATH", "/nowhere/libonnxruntime.so")
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success() && said.contains("1 passed"), "{said}");
}

#[test]
#[ignore = "runs in a process of its own, started by a_missing_library_is_named"]
fn child_whose_library_is_missing() {
    for _ in 0..2 {
        let said = open(&sums([-1, -1])).unwrap_err().to_string();
        for words in ["`segmenter.type`", "/nowhere/libonnxruntime.so", "set ORT_DYLIB_PATH", "docs/scans.md"] {
            assert!(said.contains(words), "{said}");
        }
    }
}
