#![no_main]
//! NPZ: the archive itself, and `.npy` entries behind right checksums.

use caphy_formats::npz::Npz;
use libfuzzer_sys::fuzz_target;
use std::path::Path;

fuzz_target!(|data: &[u8]| {
    let Some((&mode, rest)) = data.split_first() else { return };
    let bytes = if mode % 2 == 0 { rest.to_vec() } else { caphy_fuzz::stored_zip(&[("a.npy", rest)]) };
    let Some(npz) = caphy_fuzz::accepted("body.npz", Npz::from_bytes(Path::new("body.npz"), bytes)) else { return };
    for name in npz.names() {
        let volume = |shape: &[usize]| shape.iter().product::<usize>();
        if let Some(a) = caphy_fuzz::accepted("body.npz", npz.f64s(name)) {
            assert_eq!(volume(&a.shape), a.data.len());
        }
        if let Some(a) = caphy_fuzz::accepted("body.npz", npz.f32s(name)) {
            assert_eq!(volume(&a.shape), a.data.len());
        }
        if let Some(a) = caphy_fuzz::accepted("body.npz", npz.i64s(name)) {
            assert_eq!(volume(&a.shape), a.data.len());
        }
        caphy_fuzz::accepted("body.npz", npz.strings(name));
        caphy_fuzz::accepted("body.npz", npz.f64_scalar(name));
    }
});
