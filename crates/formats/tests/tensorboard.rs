//! Event files against TensorBoard's own.

use caphy_formats::tensorboard::{Value, first_record, step_record};

/// What `tensorboard` 2.21 (its protocol buffers and its masked CRC-32C) makes of the events below.
const THEIRS: &str = "1800000000000000a37f4b22090000203c8d49da411a0d627261696e2e4576656e743a32048c56454800000000000000fe92489d\
    090000503c8d49da4110f0a2042a390a150a0e77696e646f77732f73747261696e150000803d0a200a0e70726576696577732f75\
    70706572220e080210ac021803220589504e47211453d54a220000000000000078113dfd090000803c8d49da412a170a150a0e77\
    696e646f77732f73747261696e15000000c09e4df14e";

#[test]
fn records_are_those_that_tensorboard_writes() {
    let picture = Value::Picture { width: 300, height: 2, png: b"\x89PNG!" };
    let mut ours = first_record(1_764_111_600.5);
    let values = [("windows/strain", Value::Scalar(0.0625)), ("previews/upper", picture)];
    ours.extend(step_record(1_764_111_601.25, 70_000, &values));
    ours.extend(step_record(1_764_111_602.0, 0, &[("windows/strain", Value::Scalar(-2.0))]));
    let ours: String = ours.iter().map(|byte| format!("{byte:02x}")).collect();
    assert_eq!(ours, THEIRS);
}

#[test]
fn a_record_is_as_long_at_any_time() {
    let at = |time| step_record(time, 12, &[("a", Value::Scalar(1.0))]).len();
    assert_eq!(at(0.0), at(1.8e9 + 1.0 / 3.0));
}
