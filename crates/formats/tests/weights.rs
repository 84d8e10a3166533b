//! Safetensors: round trip, same bytes each time.

use caphy_formats::weights::{read_safetensors, read_safetensors_metadata, write_safetensors};
use std::collections::BTreeMap;
use std::path::Path;

const FILE: &str = "net.safetensors";

fn metadata() -> BTreeMap<String, String> {
    [("type", "gru"), ("layers", "4"), ("note", "quotes \" and ü")].map(|(k, v)| (k.into(), v.into())).into()
}

fn example() -> Vec<u8> {
    let matrix: Vec<f32> = (0..6).map(|i| i as f32 * 0.1 - 0.3).collect();
    write_safetensors(
        &[("gru.weight_ih_l0", &[2, 3], &matrix), ("gru.bias", &[1], &[f32::MIN_POSITIVE]), ("empty", &[0, 4], &[])],
        &metadata(),
    )
    .unwrap()
}

#[test]
fn what_is_written_is_read_back() {
    let bytes = example();
    assert_eq!(bytes, example(), "the same bytes each time");
    let tensors = read_safetensors(Path::new(FILE), &bytes).unwrap();
    let names: Vec<&str> = tensors.iter().map(|t| t.0.as_str()).collect();
    assert_eq!(names, ["empty", "gru.bias", "gru.weight_ih_l0"]);
    assert_eq!(tensors[0].1, [0, 4]);
    assert_eq!(tensors[1].2, [f32::MIN_POSITIVE]);
    assert_eq!((tensors[2].1.as_slice(), tensors[2].2[5]), ([2, 3].as_slice(), 5.0 * 0.1 - 0.3));
    assert_eq!(read_safetensors_metadata(Path::new(FILE), &bytes).unwrap(), metadata());
    for meta in [BTreeMap::new(), metadata()] {
        let bytes = write_safetensors(&[], &meta).unwrap();
        assert!(read_safetensors(Path::new(FILE), &bytes).unwrap().is_empty());
        assert_eq!(read_safetensors_metadata(Path::new(FILE), &bytes).unwrap(), meta);
    }
}

#[test]
fn wrong_shapes_and_names_are_refused() {
    let none = BTreeMap::new();
    let text = write_safetensors(&[("w", &[2, 2], &[0.0; 3])], &none).unwrap_err().to_string();
    assert!(text.contains("`w`") && text.contains("[2, 2]") && text.contains("got 3"), "{text}");
    assert!(write_safetensors(&[("w", &[usize::MAX, 2], &[])], &none).is_err());
    assert!(write_safetensors(&[("w", &[1], &[0.0]), ("w", &[1], &[0.0])], &none).is_err());
    assert!(write_safetensors(&[("__metadata__", &[1], &[0.0])], &none).is_err());
}

#[test]
fn other_types_are_refused_and_doubles_rounded() {
    let header = |kind: &str, size: usize| {
        let text = format!("{{\"w\":{{\"dtype\":\"{kind}\",\"shape\":[1],\"data_offsets\":[0,{size}]}}}}");
        let mut bytes = (text.len() as u64).to_le_bytes().to_vec();
        bytes.extend(text.as_bytes());
        bytes
    };
    let double = [header("F64", 8), 0.5f64.to_le_bytes().to_vec()].concat();
    assert_eq!(read_safetensors(Path::new(FILE), &double).unwrap()[0].2, [0.5]);
    let text = read_safetensors(Path::new(FILE), &[header("I32", 4), vec![0; 4]].concat()).unwrap_err().to_string();
    assert!(text.contains(FILE) && text.contains("`w`") && text.contains("I32"), "{text}");
}
