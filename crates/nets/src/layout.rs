//! Sizes that a net accepts, and its tensors inside the flat vectors.

use caphy_core::net::NetManifest;
use caphy_core::{Error, Result};
use std::ops::Range;

/// Widest layer that is accepted: far beyond use, and sizes stay far from overflow.
pub(crate) const MAX_WIDTH: usize = 65_536;
/// Most hidden layers.
pub(crate) const MAX_LAYERS: usize = 64;

/// `Ok` when `value` lies in `1..=largest`.
pub(crate) fn check_size(key: &str, value: usize, largest: usize) -> Result<()> {
    if (1..=largest).contains(&value) {
        Ok(())
    } else {
        Err(Error::config(key, format!("{value} is not a usable size"), format!("give a number from 1 to {largest}")))
    }
}

/// `Ok` when both ends of the net have a width.
pub(crate) fn check_ends(inputs: usize, outputs: usize) -> Result<()> {
    for (what, size) in [("inputs", inputs), ("outputs", outputs)] {
        if size == 0 {
            return Err(Error::config(
                "net",
                format!("the net would have 0 {what}"),
                "a net needs at least one pose feature and one garment vertex",
            ));
        }
    }
    Ok(())
}

/// Where tensor `index` of the manifest stands in the flat vector.
pub(crate) fn range(manifest: &NetManifest, index: usize) -> Range<usize> {
    let tensor = &manifest.tensors[index];
    tensor.offset..tensor.offset + tensor.len()
}

/// Two tensors of one vector, `first` before `second`.
pub(crate) fn pair<'a, T>(
    values: &'a mut [T],
    first: &Range<usize>,
    second: &Range<usize>,
) -> (&'a mut [T], &'a mut [T]) {
    let (low, high) = values.split_at_mut(second.start);
    (&mut low[first.clone()], &mut high[..second.len()])
}
