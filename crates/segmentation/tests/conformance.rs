//! Every segmenter keeps the promise of its trait (`onnx`: tests/onnx.rs, with the library that it needs).

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

mod labels {
    use caphy_core::Result;
    use caphy_core::conformance::segmenter::SegmenterSubject;
    use caphy_core::files::Files;
    use std::path::{Path, PathBuf};
    use std::sync::Arc;

    /// A folder with one label image, of the size of the kit's view: face, upper clothes, pants of LIP from left to right.
    struct Folder;

    impl Files for Folder {
        fn read(&self, _: &Path) -> Result<Vec<u8>> {
            let mut bytes = Vec::new();
            let mut encoder = png::Encoder::new(&mut bytes, 24, 8);
            encoder.set_color(png::ColorType::Grayscale);
            let class = |column: usize| [13, 5, 9][(column / 8).min(2)];
            let image: Vec<u8> = (0..24 * 8).map(|i| class(i % 24)).collect();
            encoder.write_header().unwrap().write_image_data(&image).unwrap();
            Ok(bytes)
        }
        fn list(&self, folder: &Path, _: &[&str]) -> Result<Vec<PathBuf>> {
            Ok(vec![folder.join("conformance-patches_000.png")])
        }
    }

    caphy_core::conformance_tests!(
        segmenter,
        SegmenterSubject::linked("type = \"labels\"\npath = \"labels\"\nmap = \"lip\"", Arc::new(Folder))
    );
}
