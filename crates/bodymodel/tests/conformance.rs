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

/// The generated model of the reference file, where it is at hand.
mod smplx {
    use caphy_core::conformance::body::{BodySubject, CHECKS};
    use caphy_core::conformance::run_all;

    /// One test, not one per check: without its file it says so once.
    #[test]
    fn every_check() {
        let root = std::env::var("CAPHY_SHARED")
            .unwrap_or_else(|_| concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared").to_string());
        let path = std::path::Path::new(&root).join("reference/smplx_synthetic_public.npz");
        if !path.is_file() {
            eprintln!("SKIPPED: {} is not there; set CAPHY_SHARED", path.display());
            return;
        }
        let subject: BodySubject = super::subject(&format!("type = \"smplx\"\npath = {path:?}"));
        for row in run_all(CHECKS, &subject) {
            assert!(row.outcome.is_ok(), "{}: {:?}", row.name, row.outcome);
        }
    }
}
