//! Whole answers of a material, widened to double precision.

use caphy_core::material::{HingeBlock, MaterialModel, MaterialReal, MembraneBlock};
use caphy_materials::measured::MaterialMeasuredSpec;

/// Every output of a membrane block, element by element.
pub(crate) struct Membrane {
    pub(crate) energy: f64,
    pub(crate) stress: [f64; 3],
    pub(crate) held: [[f64; 3]; 3],
    pub(crate) total: [[f64; 3]; 3],
    pub(crate) stiffness: [f64; 4],
    /// [parameter][Suu, Svv, Suv]
    pub(crate) by_parameter: Vec<[f64; 3]>,
}

impl Membrane {
    pub(crate) fn values(&self) -> impl Iterator<Item = f64> {
        let matrices = self.held.iter().chain(&self.total).chain(&self.by_parameter).flatten();
        [self.energy].into_iter().chain(self.stress).chain(self.stiffness).chain(matrices.copied())
    }
}

pub(crate) fn membrane<T: MaterialReal>(model: &dyn MaterialModel, green: &[[f64; 3]]) -> Vec<Membrane> {
    let n = green.len();
    let p = model.parameters().len();
    let flat: Vec<T> = (0..3).flat_map(|c| green.iter().map(move |g| T::of(g[c]))).collect();
    let fresh = |rows: usize| vec![T::nan(); rows * n];
    let (mut energy, mut stress, mut held) = (fresh(1), fresh(3), fresh(9));
    let (mut total, mut stiffness, mut by) = (fresh(9), fresh(4), fresh(3 * p));
    let mut block = MembraneBlock::new(n, &flat);
    block.energy = (&mut energy[..]).into();
    block.stress = (&mut stress[..]).into();
    block.tangent_held = (&mut held[..]).into();
    block.tangent_total = (&mut total[..]).into();
    block.stiffness = (&mut stiffness[..]).into();
    block.stress_by_parameter = (&mut by[..]).into();
    T::membrane(model, &mut block).unwrap();
    let at = |v: &[T], row: usize, i: usize| v[row * n + i].to_f64();
    (0..n)
        .map(|i| Membrane {
            energy: at(&energy, 0, i),
            stress: std::array::from_fn(|c| at(&stress, c, i)),
            held: std::array::from_fn(|c| std::array::from_fn(|d| at(&held, 3 * c + d, i))),
            total: std::array::from_fn(|c| std::array::from_fn(|d| at(&total, 3 * c + d, i))),
            stiffness: std::array::from_fn(|a| at(&stiffness, a, i)),
            by_parameter: (0..p).map(|q| std::array::from_fn(|c| at(&by, 3 * q + c, i))).collect(),
        })
        .collect()
}

#[derive(Clone, Copy)]
pub(crate) struct Hinge {
    pub(crate) angle: f64,
    pub(crate) rest: f64,
    pub(crate) length: f64,
    pub(crate) area: f64,
    pub(crate) direction0: [f64; 2],
    pub(crate) direction1: [f64; 2],
}

pub(crate) struct Bending {
    pub(crate) stiffness: f64,
    pub(crate) by_angle: f64,
    pub(crate) by_length: f64,
    pub(crate) by_parameter: Vec<f64>,
}

impl Bending {
    pub(crate) fn values(&self) -> impl Iterator<Item = f64> {
        [self.stiffness, self.by_angle, self.by_length].into_iter().chain(self.by_parameter.iter().copied())
    }
}

pub(crate) fn hinges<T: MaterialReal>(model: &dyn MaterialModel, hinges: &[Hinge]) -> Vec<Bending> {
    let n = hinges.len();
    let p = model.parameters().len();
    let column = |f: &dyn Fn(&Hinge) -> f64| -> Vec<T> { hinges.iter().map(|h| T::of(f(h))).collect() };
    let (angle, rest) = (column(&|h| h.angle), column(&|h| h.rest));
    let (length, area) = (column(&|h| h.length), column(&|h| h.area));
    let direction0 = [column(&|h| h.direction0[0]), column(&|h| h.direction0[1])].concat();
    let direction1 = [column(&|h| h.direction1[0]), column(&|h| h.direction1[1])].concat();
    let fresh = |rows: usize| vec![T::nan(); rows * n];
    let (mut k, mut by_angle, mut by_length, mut by) = (fresh(1), fresh(1), fresh(1), fresh(p));
    let mut block = HingeBlock {
        count: n,
        angle: (&angle[..]).into(),
        angle_rest: (&rest[..]).into(),
        length: (&length[..]).into(),
        area: (&area[..]).into(),
        direction0: (&direction0[..]).into(),
        direction1: (&direction1[..]).into(),
        stiffness: (&mut k[..]).into(),
        stiffness_by_angle: (&mut by_angle[..]).into(),
        stiffness_by_length: (&mut by_length[..]).into(),
        stiffness_by_parameter: (&mut by[..]).into(),
    };
    T::hinge(model, &mut block).unwrap();
    (0..n)
        .map(|i| Bending {
            stiffness: k[i].to_f64(),
            by_angle: by_angle[i].to_f64(),
            by_length: by_length[i].to_f64(),
            by_parameter: (0..p).map(|q| by[q * n + i].to_f64()).collect(),
        })
        .collect()
}

/// A measured fabric with some keys changed.
pub(crate) fn measured(fabric: &str, change: impl Fn(&mut MaterialMeasuredSpec)) -> Box<dyn MaterialModel> {
    let mut spec = MaterialMeasuredSpec::new(fabric);
    change(&mut spec);
    Box::new(spec.build_measured().unwrap())
}

pub(crate) const FABRICS: [&str; 10] = [
    "ivory-rib-knit",
    "pink-ribbon-brown",
    "white-dots-on-blk",
    "navy-sparkle-sweat",
    "camel-ponte-roma",
    "gray-interlock",
    "11oz-black-denim",
    "white-swim-solid",
    "tango-red-jet-set",
    "royal-target",
];

/// Strains of a low-discrepancy sequence, |G| ≤ `scale`.
pub(crate) fn strains(count: usize, scale: f64) -> Vec<[f64; 3]> {
    let r = [0.819_172_513_396_164_4, 0.671_043_606_703_789_3, 0.549_700_477_901_967_1];
    (1..=count).map(|i| r.map(|r| scale * ((i as f64 * r).fract() * 2.0 - 1.0))).collect()
}

/// Hinges of the same kind: every fold direction, both signs, seams, curvatures around the table's range.
pub(crate) fn folds(count: usize) -> Vec<Hinge> {
    strains(count, 1.0)
        .into_iter()
        .enumerate()
        .map(|(i, s)| {
            let seam = if i % 3 == 0 { 0.7 } else { 0.0 };
            let turn = |phi: f64| [0.01 * phi.cos(), 0.01 * phi.sin()];
            Hinge {
                angle: s[0] * 3.0,
                rest: if i % 2 == 0 { 0.0 } else { 0.4 * s[1] },
                length: 0.01 * (1.0 + 0.3 * s[2]),
                area: 1e-4 * (12.0 + 10.0 * s[1]),
                direction0: turn(3.0 * s[2]),
                direction1: turn(3.0 * s[2] + seam),
            }
        })
        .collect()
}
