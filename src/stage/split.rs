//! Which scans are kept for evaluation: those that were named, or a share drawn by the seed, whole sequences where there are some.

use crate::config::HeldOut;
use caphy_core::{Error, Result};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
use std::collections::BTreeMap;

/// For each scan whether it is held out. Scans whose names differ in their last number only are a sequence, of moments that are
/// alike: where scans come in several, none is torn.
///
/// # Errors
/// [`Error::Config`] for a named scan that is not there, or where all are named.
pub(super) fn held_out(names: &[String], how: &HeldOut, seed: u64) -> Result<Vec<bool>> {
    let share = match how {
        HeldOut::Names(held) => {
            if let Some(missing) = held.iter().find(|h| !names.contains(h)) {
                return Err(Error::config(
                    "subject.held_out",
                    format!("there is no scan `{missing}`"),
                    format!("there are: {}", names.join(", ")),
                ));
            }
            let out: Vec<bool> = names.iter().map(|name| held.contains(name)).collect();
            if !names.is_empty() && out.iter().all(|held| *held) {
                let problem = format!("names all of {}", names.join(", "));
                return Err(Error::config("subject.held_out", problem, "leave at least one scan to learn from"));
            }
            return Ok(out);
        }
        HeldOut::Share(share) => *share,
    };
    let mut sequences: BTreeMap<&str, Vec<usize>> = BTreeMap::new();
    for (i, name) in names.iter().enumerate() {
        let stem = name.trim_end_matches(|c: char| c.is_ascii_digit());
        sequences.entry(stem.trim_end_matches(['-', '_', '.', ' '])).or_default().push(i);
    }
    // One sequence is no sequence: numbered poses of one session.
    let mut groups: Vec<Vec<usize>> = if sequences.len() > 1 && 2 * sequences.len() <= names.len() {
        sequences.into_values().collect()
    } else {
        (0..names.len()).map(|i| vec![i]).collect()
    };
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(u64::from_le_bytes(*b"held out"));
    for i in (1..groups.len()).rev() {
        groups.swap(i, (rng.next_u64() % (i as u64 + 1)) as usize);
    }
    // The last group is always left to learn from.
    groups.pop();
    let wanted = share * names.len() as f64;
    let mut out = vec![false; names.len()];
    let mut taken = 0;
    for group in groups {
        // As near to the share as whole groups come.
        let after = taken + group.len();
        if (after as f64 - wanted).abs() < (taken as f64 - wanted).abs() {
            group.iter().for_each(|&i| out[i] = true);
            taken = after;
        }
    }
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn count(names: &[String], share: f64, seed: u64) -> Vec<usize> {
        let held = held_out(names, &HeldOut::Share(share), seed).unwrap();
        (0..names.len()).filter(|&i| held[i]).collect()
    }

    #[test]
    fn a_fifth_is_drawn_by_the_seed() {
        let names: Vec<String> = (0..80).map(|i| format!("scan-{i:02}")).collect();
        assert_eq!(count(&names, 0.2, 1).len(), 16);
        assert_eq!(count(&names, 0.2, 1), count(&names, 0.2, 1));
        assert_ne!(count(&names, 0.2, 1), count(&names, 0.2, 2));
        assert!(count(&names[..2], 0.2, 1).is_empty() && count(&names, 0.0, 1).is_empty());
        assert_eq!(count(&names[..3], 0.2, 1).len(), 1);
        assert_eq!(count(&names[..4], 0.99, 5).len(), 3, "one stays to learn from");
        assert!(held_out(&[], &HeldOut::Share(0.2), 1).is_ok());
        let text = held_out(&names, &HeldOut::Names(names.clone()), 1).unwrap_err().to_string();
        assert!(text.contains("to learn from"), "{text}");
    }

    #[test]
    fn sequences_are_not_torn() {
        let names: Vec<String> = ["walk", "squat", "turn", "reach", "run"]
            .iter()
            .flat_map(|s| (0..8).map(move |i| format!("{s}_{i:04}")))
            .collect();
        for seed in 0..20 {
            let held = count(&names, 0.2, seed);
            assert!(held.len() == 8 && held.iter().all(|i| i / 8 == held[0] / 8), "{held:?}");
        }
        let named = held_out(&names, &HeldOut::Names(vec!["run_0003".into()]), 1).unwrap();
        assert_eq!(named.iter().filter(|h| **h).count(), 1);
        let text = held_out(&names, &HeldOut::Names(vec!["jump".into()]), 1).unwrap_err().to_string();
        assert!(text.contains("jump") && text.contains("walk_0000"), "{text}");
    }
}
