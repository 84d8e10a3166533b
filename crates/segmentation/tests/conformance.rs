//! Every segmenter keeps the promise of its trait.

use caphy_core::conformance::segmenter::{COLOURS, SegmenterSubject};
use caphy_core::files::Disk;
use caphy_segmentation as _;
use std::sync::Arc;

fn subject(toml: &str) -> SegmenterSubject {
    SegmenterSubject::linked(toml, Arc::new(Disk))
}

mod vertex {
    caphy_core::conformance_tests!(segmenter, super::subject("type = \"vertex\""));
}

mod colour {
    fn toml() -> String {
        let names = ["body", "upper", "lower"];
        let entry = |(name, colour)| format!("{{ label = \"{name}\", colour = {colour:?} }}");
        let palette: Vec<String> = names.iter().zip(super::COLOURS).map(entry).collect();
        format!("type = \"colour\"\npalette = [{}]", palette.join(", "))
    }
    caphy_core::conformance_tests!(segmenter, super::subject(&toml()));
}
