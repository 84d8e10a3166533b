//! Arrays of exactly so many numbers: serde's own arrays take what they need from a longer list and say nothing.

use serde::de::{Deserialize, Deserializer, Error};

fn fit<T, E: Error, const N: usize>(list: Vec<T>) -> Result<[T; N], E> {
    let got = list.len();
    list.try_into().map_err(|_| E::custom(format!("{got} values, expected {N}")))
}

/// `N` numbers.
pub(crate) fn row<'de, D: Deserializer<'de>, const N: usize>(deserializer: D) -> Result<[f64; N], D::Error> {
    fit(Vec::deserialize(deserializer)?)
}

/// `R` rows of `N` numbers.
pub(crate) fn rows<'de, D: Deserializer<'de>, const N: usize, const R: usize>(
    deserializer: D,
) -> Result<[[f64; N]; R], D::Error> {
    let rows = Vec::<Vec<f64>>::deserialize(deserializer)?;
    let one = |(i, row): (usize, Vec<f64>)| fit(row).map_err(|e: D::Error| D::Error::custom(format!("row {i}: {e}")));
    fit(rows.into_iter().enumerate().map(one).collect::<Result<_, _>>()?)
}
