//! Names of prims.

use std::collections::HashSet;

/// The name as an identifier of USD: ASCII letters, digits and underscores, no digit first; anything else becomes an
/// underscore.
pub fn usd_identifier(name: &str) -> String {
    let mut id: String = name.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '_' }).collect();
    if id.is_empty() || id.starts_with(|c: char| c.is_ascii_digit()) {
        id.insert(0, '_');
    }
    id
}

/// Identifiers for prims under one parent: as [`usd_identifier`], with a number after those that others have already.
pub fn usd_identifiers(names: &[&str]) -> Vec<String> {
    let plain: Vec<String> = names.iter().map(|name| usd_identifier(name)).collect();
    let mut taken: HashSet<String> = HashSet::new();
    // The first of each name keeps it, whatever the numbers of others come to.
    let first: Vec<bool> = plain.iter().map(|id| taken.insert(id.clone())).collect();
    plain
        .into_iter()
        .zip(first)
        .map(|(id, first)| {
            if first {
                return id;
            }
            let mut number = 2;
            loop {
                let numbered = format!("{id}_{number}");
                if taken.insert(numbered.clone()) {
                    return numbered;
                }
                number += 1;
            }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_become_valid_and_stay_apart() {
        assert_eq!(usd_identifier("upper"), "upper");
        assert_eq!(usd_identifier("T-shirt (blue)"), "T_shirt__blue_");
        assert_eq!(usd_identifier("3_layers"), "_3_layers");
        assert_eq!(usd_identifier("größe"), "gr__e");
        assert_eq!(usd_identifier(""), "_");
        let ids = usd_identifiers(&["a b", "a-b", "a_b_2", "a_b"]);
        assert_eq!(ids, ["a_b", "a_b_3", "a_b_2", "a_b_4"]);
    }
}
