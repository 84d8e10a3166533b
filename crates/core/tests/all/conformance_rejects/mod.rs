//! The conformance kit itself: each check rejects an implementation that is wrong in that one thing, and only it.

mod body;
mod material;
mod net;
mod segmenter;
mod table;

use caphy_core::conformance::{Check, Verdict, run_all};
use std::collections::BTreeSet;

/// Runs a whole list on a faulty subject and compares the checks that fail with those that should.
fn assert_rejected<S>(checks: &[Check<S>], fault: &str, subject: &S, expected: &[&'static str]) {
    let rows = run_all(checks, subject);
    let failed: BTreeSet<&str> = rows.iter().filter(|r| r.outcome.is_err()).map(|r| r.name).collect();
    let told: Vec<String> =
        rows.iter().filter_map(|r| r.outcome.as_ref().err().map(|e| format!("{}: {e}", r.name))).collect();
    assert_eq!(failed, expected.iter().copied().collect(), "{fault}: {told:#?}");
}

/// A correct subject passes everything; `not_offered` is what it declares to lack.
fn assert_accepted<S>(checks: &[Check<S>], subject: &S, not_offered: &[&str]) {
    for row in run_all(checks, subject) {
        let expected = if not_offered.contains(&row.name) { Verdict::NotOffered } else { Verdict::Passed };
        assert_eq!(row.outcome, Ok(expected), "{}", row.name);
    }
}

/// Every check has an implementation that it alone rejects.
fn assert_covered<S>(checks: &[Check<S>], faults: &[Vec<&'static str>]) {
    for check in checks {
        let alone = faults.iter().any(|failing| failing[..] == [check.name]);
        assert!(alone, "`{}` has no faulty implementation that it alone rejects", check.name);
    }
}
