#![no_main]
//! PLY: a scan that is read is whole, and comes back from the writer.

use caphy_formats::ply::{read_ply, write_ply};
use libfuzzer_sys::fuzz_target;
use std::path::Path;

fuzz_target!(|data: &[u8]| {
    let file = Path::new("scan.ply");
    let Some(scan) = caphy_fuzz::accepted("scan.ply", read_ply(file, data)) else { return };
    let vertices = scan.mesh.vertices.len();
    scan.mesh.check("scan").unwrap();
    assert!(scan.colours.as_ref().is_none_or(|c| c.len() == vertices));
    assert!(scan.labels.as_ref().is_none_or(|l| l.len() == vertices));
    // Positions are written as f32, which the largest f64 overflow.
    if scan.mesh.vertices.iter().all(|v| v.amax() < f64::from(f32::MAX)) {
        let again = read_ply(file, &write_ply(&scan)).unwrap();
        assert_eq!(again.mesh.faces, scan.mesh.faces);
        assert_eq!((again.colours, again.labels), (scan.colours, scan.labels));
    }
});
