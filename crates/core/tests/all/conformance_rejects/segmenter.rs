//! Faulty segmenters around a correct one: labels stored on the scan's vertices.

use super::table::{TABLE, read, write};
use caphy_core::conformance::segmenter::{CHECKS, SegmenterSubject};
use caphy_core::scan::Label;
use caphy_core::segmenter::{NO_TRIANGLE, Segmenter, View};
use caphy_core::{Error, Result};
use std::thread::ThreadId;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Fault {
    None,
    AnotherTableWrittenBack,
    UnknownKeysTaken,
    EmptyIsBody,
    NothingFound,
    KeepsWhatStoodThere,
    NoLengthCheck,
    NamelessError,
    ThreadMatters,
}

struct Stored {
    fault: Fault,
    made_on: ThreadId,
    size: f64,
}

impl Segmenter for Stored {
    fn segment(&self, view: &View<'_>, labels: &mut [Label]) -> Result<()> {
        let is = |fault| self.fault == fault;
        if !is(Fault::NoLengthCheck) {
            Error::check_length("labels", view.triangle.len(), labels.len())?;
        }
        let Some(stored) = &view.scan.labels else {
            let name = if is(Fault::NamelessError) { "the scan" } else { &view.scan.name };
            return Err(Error::format(name, "vertices", "has no labels", "store them"));
        };
        for (out, triangle) in labels.iter_mut().zip(view.triangle) {
            let shown = match *triangle {
                NO_TRIANGLE if is(Fault::EmptyIsBody) => Label::Body,
                NO_TRIANGLE => Label::Ignore,
                _ if is(Fault::NothingFound) => Label::Ignore,
                _ if is(Fault::ThreadMatters) && std::thread::current().id() != self.made_on => Label::Ignore,
                // A larger `size` looks at another corner.
                t => stored[view.scan.mesh.faces[t as usize][self.size as usize % 3] as usize],
            };
            if !(is(Fault::KeepsWhatStoodThere) && shown == Label::Body) {
                *out = shown;
            }
        }
        Ok(())
    }
}

fn subject(fault: Fault) -> SegmenterSubject {
    let create = move |text: &str| -> Result<Box<dyn Segmenter>> {
        let size = read(text, fault == Fault::UnknownKeysTaken)?;
        Ok(Box::new(Stored { fault, made_on: std::thread::current().id(), size }))
    };
    let normalise = move |text: &str| write(text, fault == Fault::AnotherTableWrittenBack);
    SegmenterSubject { toml: TABLE.into(), create: Box::new(create), normalise: Some(Box::new(normalise)) }
}

/// Faults and the checks that reject them.
fn faults() -> Vec<(Fault, Vec<&'static str>)> {
    vec![
        (Fault::AnotherTableWrittenBack, vec!["table_survives_a_round_trip"]),
        (Fault::UnknownKeysTaken, vec!["unknown_keys_are_refused"]),
        (Fault::EmptyIsBody, vec!["empty_pixels_are_ignored"]),
        (Fault::NothingFound, vec!["shown_pixels_are_labelled"]),
        (Fault::KeepsWhatStoodThere, vec!["labels_overwrite"]),
        (Fault::NoLengthCheck, vec!["wrong_lengths_are_refused"]),
        (Fault::NamelessError, vec!["bare_scans_are_answered_or_named"]),
        (Fault::ThreadMatters, vec!["threads_change_nothing"]),
    ]
}

#[test]
fn a_correct_segmenter_passes() {
    super::assert_accepted(CHECKS, &subject(Fault::None), &[]);
}

#[test]
fn each_fault_is_rejected_by_its_check() {
    for (fault, expected) in faults() {
        super::assert_rejected(CHECKS, &format!("{fault:?}"), &subject(fault), &expected);
    }
    let sets: Vec<Vec<&str>> = faults().into_iter().map(|f| f.1).collect();
    super::assert_covered(CHECKS, &sets);
}
