//! Which fabrics make a sheet: a step of the fit that would give one that shrinks by itself is not worth a simulation.

use caphy_core::Result;
use caphy_core::material::{MaterialModel, MembraneBlock};

/// Green strains at which a fabric is asked: rest, stretch along u, v, both, and sheared: up to what a corner that carries the cloth
/// sees.
const STRAINS: [[f64; 3]; 11] = [
    [0.0, 0.0, 0.0],
    [0.02, 0.0, 0.0],
    [0.0, 0.02, 0.0],
    [0.02, 0.02, 0.0],
    [0.06, 0.0, 0.0],
    [0.0, 0.06, 0.0],
    [0.06, 0.06, 0.0],
    [0.15, 0.0, 0.0],
    [0.0, 0.15, 0.0],
    [0.15, 0.15, 0.0],
    [0.08, 0.04, 0.03],
];

/// Where the starting fabric resists every strain: nobody asks more of an estimated one.
pub(crate) struct Sheet {
    resists: Vec<bool>,
}

impl Sheet {
    pub(crate) fn new(start: &dyn MaterialModel) -> Result<Self> {
        Ok(Self { resists: resists(start)? })
    }
    pub(crate) fn admits(&self, material: &dyn MaterialModel) -> Result<bool> {
        Ok(self.resists.iter().zip(resists(material)?).all(|(start, now)| now || !start))
    }
}

/// Whether stretch along u and v together is resisted in every mixture, with the stiffness held.
fn resists(material: &dyn MaterialModel) -> Result<Vec<bool>> {
    let n = STRAINS.len();
    if !material.describe().offers.tangent_held {
        return Ok(vec![true; n]);
    }
    let green: Vec<f64> = (0..3).flat_map(|k| STRAINS.iter().map(move |g| g[k])).collect();
    let mut tangent = vec![0.0; 9 * n];
    let mut block = MembraneBlock::new(n, &green);
    block.tangent_held = (&mut tangent[..]).into();
    material.membrane((&mut block).into())?;
    Ok((0..n)
        .map(|i| {
            let c = |row: usize, column: usize| tangent[(3 * row + column) * n + i];
            let coupling = 0.5 * (c(0, 1) + c(1, 0));
            c(0, 0) > 0.0 && c(1, 1) > 0.0 && coupling * coupling < c(0, 0) * c(1, 1)
        })
        .collect())
}
