//! Every body keeps the promise of its trait.

use caphy_bodymodel as _;
use caphy_core::conformance::body::BodySubject;
use caphy_core::files::Disk;
use std::sync::Arc;

fn subject(toml: &str) -> BodySubject {
    BodySubject::linked(toml, Arc::new(Disk))
}

mod mannequin {
    caphy_core::conformance_tests!(body, super::subject("type = \"mannequin\"\nresolution = 0.03"));
}

/// Bodies in the SMPL-X layout, where their files are at hand.
mod smplx {
    use caphy_core::conformance::body::{BodySubject, CHECKS};
    use caphy_core::conformance::{Verdict, run_all};

    /// One test per table, not one per check: without its file it says so once.
    fn every_check(file: &str, keys: &str) {
        let root = std::env::var("CAPHY_SHARED")
            .unwrap_or_else(|_| concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared").to_string());
        let path = std::path::Path::new(&root).join(file);
        if !path.is_file() {
            eprintln!("SKIPPED: {} is not there; set CAPHY_SHARED", path.display());
            return;
        }
        let subject: BodySubject = super::subject(&format!("type = \"smplx\"\npath = {path:?}\n{keys}"));
        for row in run_all(CHECKS, &subject) {
            assert_eq!(row.outcome, Ok(Verdict::Passed), "{}", row.name);
        }
    }

    #[test]
    fn the_generated_model() {
        every_check("reference/smplx_synthetic_public.npz", "");
    }

    #[test]
    fn every_key_at_once() {
        let keys = "shape_coefficients = 12\nexpression_coefficients = 5\nshape_columns = 300\nhand_mean = true\n\
                    face_contour = true\nextra_joints = { nose = 3, left_heel = 40 }";
        every_check("reference/smplx_synthetic_public.npz", keys);
    }

    #[test]
    fn a_body_in_single_precision() {
        every_check("data/body/anny_smplx_layout.npz", "");
    }
}
