#![no_main]
//! Safetensors: tensors fill their shapes, and come back from the writer.

use caphy_formats::weights::{read_safetensors, read_safetensors_metadata, write_safetensors};
use libfuzzer_sys::fuzz_target;
use std::path::Path;

fuzz_target!(|data: &[u8]| {
    let file = Path::new("net.safetensors");
    let metadata = caphy_fuzz::accepted("net.safetensors", read_safetensors_metadata(file, data));
    let Some(tensors) = caphy_fuzz::accepted("net.safetensors", read_safetensors(file, data)) else { return };
    for (_, shape, values) in &tensors {
        assert_eq!(shape.iter().product::<usize>(), values.len());
    }
    let borrowed: Vec<(&str, &[usize], &[f32])> =
        tensors.iter().map(|(n, s, v)| (n.as_str(), s.as_slice(), v.as_slice())).collect();
    let metadata = metadata.unwrap_or_default();
    let again = write_safetensors(&borrowed, &metadata).unwrap();
    let bits = |all: &[(String, Vec<usize>, Vec<f32>)]| -> Vec<(String, Vec<usize>, Vec<u32>)> {
        all.iter().map(|(n, s, v)| (n.clone(), s.clone(), v.iter().map(|x| x.to_bits()).collect())).collect()
    };
    assert_eq!(bits(&read_safetensors(file, &again).unwrap()), bits(&tensors));
    assert_eq!(read_safetensors_metadata(file, &again).unwrap(), metadata);
});
