//! The promise of [`MaterialModel`], checked.

use super::differences::{Tally, agrees, agrees_within, scattered};
use super::{Outcome, Verdict, ensure, table_checks, unexpected};
use crate::array::Out;
use crate::extension::{Hinge, MaterialModelExt};
use crate::material::{HingeBlock, MaterialModel, MaterialReal, MaterialSpec, MembraneBlock};
use crate::{Error, Real, Result};

/// A material as its table makes it.
pub struct MaterialSubject {
    /// A valid table: `type` and its keys.
    pub toml: String,
    /// Makes the material from a table.
    pub create: Box<dyn Fn(&str) -> Result<Box<dyn MaterialModel>> + Send + Sync>,
    /// Writes a table back with every default, where the plugin can.
    pub normalise: Option<Box<dyn Fn(&str) -> Result<String> + Send + Sync>>,
}

impl MaterialSubject {
    /// A material that is linked into this program, by its table.
    pub fn linked(toml: &str) -> Self {
        fn spec(text: &str) -> Result<Box<dyn MaterialSpec>> {
            toml::from_str(text).map_err(|e| Error::config("material", e.message().trim(), "correct the table"))
        }
        let write = |text: &str| {
            toml::to_string(&spec(text)?).map_err(|e| Error::config("material", e.to_string(), "correct the table"))
        };
        Self { toml: toml.into(), create: Box::new(|text| spec(text)?.build()), normalise: Some(Box::new(write)) }
    }
    /// The material.
    pub fn model(&self) -> std::result::Result<Box<dyn MaterialModel>, String> {
        self.model_of(&self.toml)
    }
    fn model_of(&self, toml: &str) -> std::result::Result<Box<dyn MaterialModel>, String> {
        (self.create)(toml).map_err(unexpected("making the material"))
    }
}

crate::conformance_list! { material, conformance_checks MaterialSubject }

table_checks!(MaterialSubject, same);

/// `Ok` when two materials answer alike.
fn same(a: &dyn MaterialModel, b: &dyn MaterialModel) -> std::result::Result<(), String> {
    ensure(a.describe() == b.describe(), || format!("{:?} became {:?}", a.describe(), b.describe()))?;
    ensure(a.parameters() == b.parameters(), || "parameters changed".into())?;
    let (a, b) = (probe::<f64>(a)?, probe::<f64>(b)?);
    ensure(a == b, || "answers changed".into())
}

/// [`CHECKS`]: [`MaterialDescription::name`](crate::material::MaterialDescription::name) is the `type`.
pub fn name_is_the_type(subject: &MaterialSubject) -> Outcome {
    let name = subject.model()?.describe().name;
    let table: toml::Table = toml::from_str(&subject.toml).map_err(|e| e.message().to_string())?;
    let wanted = table.get("type").and_then(|t| t.as_str()).unwrap_or_default();
    ensure(name == wanted, || format!("`type = \"{wanted}\"` calls itself `{name}`"))?;
    Ok(Verdict::Passed)
}

/// Scattered strains of cloth, [Guu, Gvv, Guv], shear up to 0.1: C = I + 2G is positive for all of them.
fn strains(count: usize) -> Vec<[f64; 3]> {
    let one = |i| [0.12 + 0.18 * scattered(i, 0), 0.12 + 0.18 * scattered(i, 1), 0.1 * scattered(i, 2)];
    (0..count).map(one).collect()
}

/// Scattered hinges of garments: centimetres, folds of up to 60°, up to 30° of them at rest.
fn folds(count: usize) -> Vec<Hinge> {
    let one = |i| {
        let turn = std::f64::consts::PI * scattered(i, 5);
        Hinge {
            angle: 1.05 * scattered(i, 0),
            angle_rest: 0.5 * scattered(i, 1),
            length: 0.012 + 0.006 * scattered(i, 2),
            area: 2e-4 + 1e-4 * scattered(i, 3),
            directions: [[0.01 * turn.cos(), 0.01 * turn.sin()], [0.012 * scattered(i, 6), 0.012 * scattered(i, 7)]],
        }
    };
    (0..count).map(one).collect()
}

/// Structure of arrays from a list.
fn columns<T: Real, const N: usize>(list: &[[f64; N]]) -> Vec<T> {
    (0..N).flat_map(|c| list.iter().map(move |row| T::of(row[c]))).collect()
}

/// Every output that is offered, in one vector per output.
#[derive(Debug, Clone, PartialEq, Default)]
struct Answers<T> {
    energy: Vec<T>,
    stress: Vec<T>,
    tangent_held: Vec<T>,
    tangent_total: Vec<T>,
    stress_by_parameter: Vec<T>,
    stiffness: Vec<T>,
    bending: Vec<T>,
    by_angle: Vec<T>,
    by_length: Vec<T>,
    bending_by_parameter: Vec<T>,
}

impl<T> Answers<T> {
    fn all(&self) -> [(&'static str, &[T]); 10] {
        [
            ("energy", &self.energy),
            ("stress", &self.stress),
            ("tangent_held", &self.tangent_held),
            ("tangent_total", &self.tangent_total),
            ("stress_by_parameter", &self.stress_by_parameter),
            ("stiffness", &self.stiffness),
            ("bending stiffness", &self.bending),
            ("stiffness_by_angle", &self.by_angle),
            ("stiffness_by_length", &self.by_length),
            ("bending stiffness_by_parameter", &self.bending_by_parameter),
        ]
    }
}

/// An output array where it is offered; filled with a value that an unwritten element would betray.
fn room<T: Real>(offered: bool, len: usize) -> Vec<T> {
    if offered { vec![T::nan(); len] } else { Vec::new() }
}

fn out<T>(values: &mut Vec<T>) -> Out<'_, T> {
    if values.is_empty() { Out::absent() } else { values.as_mut_slice().into() }
}

fn ask_membrane<T: MaterialReal>(
    model: &dyn MaterialModel,
    green: &[[f64; 3]],
) -> std::result::Result<Answers<T>, String> {
    let (n, offers, parameters) = (green.len(), model.describe().offers, model.parameters().len());
    let input: Vec<T> = columns(green);
    let mut a = Answers {
        energy: room(true, n),
        stress: room(true, 3 * n),
        tangent_held: room(offers.tangent_held, 9 * n),
        tangent_total: room(offers.tangent_total, 9 * n),
        stress_by_parameter: room(offers.by_parameter, 3 * n * parameters),
        stiffness: room(offers.stiffness, 4 * n),
        ..Answers::default()
    };
    let mut block = MembraneBlock::new(n, &input);
    block.energy = out(&mut a.energy);
    block.stress = out(&mut a.stress);
    block.tangent_held = out(&mut a.tangent_held);
    block.tangent_total = out(&mut a.tangent_total);
    block.stress_by_parameter = out(&mut a.stress_by_parameter);
    block.stiffness = out(&mut a.stiffness);
    T::membrane(model, &mut block).map_err(unexpected("a membrane block"))?;
    Ok(a)
}

/// Arrays of a hinge block.
struct HingeArrays<T> {
    scalars: [Vec<T>; 4],
    directions: [Vec<T>; 2],
}

impl<T: Real> HingeArrays<T> {
    fn of(hinges: &[Hinge]) -> Self {
        let scalars = |f: fn(&Hinge) -> f64| hinges.iter().map(|h| T::of(f(h))).collect();
        let side = |s: usize| columns(&hinges.iter().map(|h| h.directions[s]).collect::<Vec<_>>());
        Self {
            scalars: [scalars(|h| h.angle), scalars(|h| h.angle_rest), scalars(|h| h.length), scalars(|h| h.area)],
            directions: [side(0), side(1)],
        }
    }
    fn block(&self) -> HingeBlock<'_, T> {
        HingeBlock::new(
            self.scalars[0].len(),
            std::array::from_fn(|i| &self.scalars[i][..]),
            std::array::from_fn(|i| &self.directions[i][..]),
        )
    }
}

fn ask_hinge<T: MaterialReal>(model: &dyn MaterialModel, hinges: &[Hinge]) -> std::result::Result<Answers<T>, String> {
    let (n, offers, parameters) = (hinges.len(), model.describe().offers, model.parameters().len());
    let arrays = HingeArrays::of(hinges);
    let mut a = Answers {
        bending: room(true, n),
        by_angle: room(offers.hinge_slopes, n),
        by_length: room(offers.hinge_slopes, n),
        bending_by_parameter: room(offers.by_parameter, n * parameters),
        ..Answers::default()
    };
    let mut block = arrays.block();
    block.stiffness = out(&mut a.bending);
    block.stiffness_by_angle = out(&mut a.by_angle);
    block.stiffness_by_length = out(&mut a.by_length);
    block.stiffness_by_parameter = out(&mut a.bending_by_parameter);
    T::hinge(model, &mut block).map_err(unexpected("a hinge block"))?;
    Ok(a)
}

/// All answers to the scattered strains and folds.
fn probe<T: MaterialReal>(model: &dyn MaterialModel) -> std::result::Result<[Answers<T>; 2], String> {
    Ok([ask_membrane(model, &strains(37))?, ask_hinge(model, &folds(37))?])
}

/// [`CHECKS`]: ψ(0) = 0 and S(0) = 0, exactly.
pub fn rest_is_free_of_stress(model: &dyn MaterialModel) -> Outcome {
    fn at_rest<T: MaterialReal>(model: &dyn MaterialModel) -> std::result::Result<(), String> {
        let a = ask_membrane::<T>(model, &[[0.0; 3]; 2])?;
        ensure(a.energy.iter().chain(&a.stress).all(|v| *v == T::zero()), || {
            format!("energy {:?} J/m², stress {:?} N/m", a.energy, a.stress)
        })
    }
    at_rest::<f32>(model)?;
    at_rest::<f64>(model)?;
    Ok(Verdict::Passed)
}

/// Energy density at a strain, NaN for an error: differences then fail.
fn energy(model: &dyn MaterialModel, green: [f64; 3]) -> f64 {
    model.at(green).map_or(f64::NAN, |a| a.energy)
}

fn shifted(mut green: [f64; 3], component: usize, by: f64) -> [f64; 3] {
    green[component] += by;
    green
}

const COMPONENTS: [&str; 3] = ["Suu", "Svv", "Suv"];

/// [`CHECKS`]: S is ∂ψ/∂G (half of it in shear). With frozen stiffness it is K G of the present constants K, or the held
/// tangent times G where the model has no four constants, and ψ is half of its work.
pub fn stress_is_the_gradient(model: &dyn MaterialModel) -> Outcome {
    let facts = model.describe();
    if facts.stiffness_frozen {
        return frozen_stress(model, &strains(60));
    }
    for component in 0..3 {
        let mut tally = Tally::default();
        for green in strains(60) {
            let stress = model.at(green).map_err(unexpected("a strain"))?.stress;
            let share = if component == 2 { 2.0 } else { 1.0 };
            let scale = stress.iter().fold(0.0f64, |m, s| m.max(s.abs()));
            let right = agrees(share * stress[component], scale, 1.0, |h| energy(model, shifted(green, component, h)));
            tally.add(right, || format!("G = {green:?}, S = {stress:?}"));
        }
        tally.check(COMPONENTS[component])?;
    }
    Ok(Verdict::Passed)
}

fn frozen_stress(model: &dyn MaterialModel, green: &[[f64; 3]]) -> Outcome {
    let offers = model.describe().offers;
    if !offers.stiffness && !offers.tangent_held {
        return Ok(Verdict::NotOffered);
    }
    for &green in green {
        let answer = model.at(green).map_err(unexpected("a strain"))?;
        let tangent = match answer.stiffness {
            Some([k0, k1, k2, k3]) => [[k0, k1, 0.0], [k1, k2, 0.0], [0.0, 0.0, k3]],
            None => model.tangent_held_at(green).map_err(unexpected("a tangent"))?,
        };
        let wanted: [f64; 3] = std::array::from_fn(|r| (0..3).map(|c| tangent[r][c] * green[c]).sum());
        let largest = green.iter().fold(0.3f64, |m, g| m.max(g.abs()));
        let scale = tangent.iter().flatten().fold(0.0f64, |m, t| m.max(t.abs())) * largest;
        for c in 0..3 {
            ensure((wanted[c] - answer.stress[c]).abs() <= 1e-11 * scale, || {
                format!("{} is {} instead of K G = {} N/m at G = {green:?}", COMPONENTS[c], answer.stress[c], wanted[c])
            })?;
        }
        let work = 0.5 * (wanted[0] * green[0] + wanted[1] * green[1]) + wanted[2] * green[2];
        ensure((work - answer.energy).abs() <= 1e-11 * scale * largest.max(1.0), || {
            format!("energy {} instead of ½ S:G = {work} J/m² at G = {green:?}", answer.energy)
        })?;
    }
    Ok(Verdict::Passed)
}

/// [`CHECKS`]: `tangent_total` is ∂S/∂G.
pub fn tangent_is_the_derivative(model: &dyn MaterialModel) -> Outcome {
    if !model.describe().offers.tangent_total {
        return Ok(Verdict::NotOffered);
    }
    for (row, name) in COMPONENTS.iter().enumerate() {
        for column in 0..3 {
            let mut tally = Tally::default();
            for green in strains(40) {
                let tangent = model.tangent_total_at(green).map_err(unexpected("a tangent"))?;
                let scale = tangent.iter().flatten().fold(0.0f64, |m, t| m.max(t.abs()));
                let right = agrees(tangent[row][column], scale, 1.0, |h| {
                    model.at(shifted(green, column, h)).map_or(f64::NAN, |a| a.stress[row])
                });
                tally.add(right, || format!("G = {green:?}, tangent {tangent:?}"));
            }
            tally.check(&format!("∂{name}/∂{}", ["Guu", "Gvv", "Guv"][column]))?;
        }
    }
    Ok(Verdict::Passed)
}

/// [`CHECKS`]: second derivatives commute. Suv is half of ∂ψ/∂Guv, so that its row counts twice.
pub fn held_tangent_is_symmetric(model: &dyn MaterialModel) -> Outcome {
    let facts = model.describe();
    if !facts.offers.tangent_held {
        return Ok(Verdict::NotOffered);
    }
    for green in strains(40) {
        let held = model.tangent_held_at(green).map_err(unexpected("a tangent"))?;
        let scale = held.iter().flatten().fold(0.0f64, |m, t| m.max(t.abs()));
        let symmetric = |t: &[[f64; 3]; 3]| {
            let pairs = [(t[0][1], t[1][0]), (t[0][2], 2.0 * t[2][0]), (t[1][2], 2.0 * t[2][1])];
            pairs.iter().all(|(a, b)| (a - b).abs() <= 1e-11 * scale)
        };
        ensure(symmetric(&held), || format!("{held:?} at G = {green:?}"))?;
        if !facts.stiffness_frozen && facts.offers.tangent_total {
            let total = model.tangent_total_at(green).map_err(unexpected("a tangent"))?;
            ensure(symmetric(&total), || format!("the total one, {total:?} at G = {green:?}"))?;
        }
    }
    Ok(Verdict::Passed)
}

/// [`CHECKS`]: ∂S/∂Θ and ∂k/∂Θ against [`MaterialModel::with_parameters`].
pub fn parameter_derivatives_are_exact(model: &dyn MaterialModel) -> Outcome {
    if !model.describe().offers.by_parameter {
        return Ok(Verdict::NotOffered);
    }
    let (green, hinges, parameters) = (strains(24), folds(24), model.parameters());
    let n = green.len();
    let (here, bend) = (ask_membrane::<f64>(model, &green)?, ask_hinge::<f64>(model, &hinges)?);
    let values: Vec<f64> = parameters.iter().map(|p| p.value).collect();
    let peak = |v: &[f64]| v.iter().fold(0.0f64, |m, s| m.max(s.abs()));
    let (stress_peak, bend_peak) = (peak(&here.stress), peak(&bend.bending));
    for (p, parameter) in parameters.iter().enumerate() {
        let unit = if parameter.value == 0.0 { parameter.upper - parameter.lower } else { parameter.value.abs() };
        let moved = |share: f64| {
            let mut values = values.clone();
            values[p] = (values[p] + share * unit).clamp(parameter.lower, parameter.upper);
            let changed = model.with_parameters(&values).map_err(unexpected("with_parameters"))?;
            let step = values[p] - parameter.value;
            Ok::<_, String>((step, ask_membrane::<f64>(&*changed, &green)?, ask_hinge::<f64>(&*changed, &hinges)?))
        };
        // Both sides: at a clamp one of them has no slope.
        let sides = [moved(1e-5)?, moved(-1e-5)?];
        let compare =
            |what: &str, derivative: &[f64], from: &[f64], of: fn(&[Answers<f64>; 2]) -> &[f64], peak: f64| {
                let mut tally = Tally::default();
                for i in 0..from.len() {
                    let right = sides.iter().any(|(step, membrane, hinge)| {
                        let pair = [membrane.clone(), hinge.clone()];
                        let difference = (of(&pair)[i] - from[i]) / step;
                        (difference - derivative[i]).abs() <= 1e-6 * (derivative[i].abs() + peak / unit)
                    });
                    tally.add(right, || format!("element {i}: {} per {}", derivative[i], parameter.unit));
                }
                tally.check(&format!("{what} by `{}`", parameter.name))
            };
        let stress_part = &here.stress_by_parameter[3 * n * p..3 * n * (p + 1)];
        compare("stress", stress_part, &here.stress, |a| &a[0].stress, stress_peak)?;
        let bend_part = &bend.bending_by_parameter[n * p..n * (p + 1)];
        compare("bending stiffness", bend_part, &bend.bending, |a| &a[1].bending, bend_peak)?;
    }
    Ok(Verdict::Passed)
}

/// [`CHECKS`]: dk/dθ and dk/dl.
pub fn hinge_slopes_are_exact(model: &dyn MaterialModel) -> Outcome {
    if !model.describe().offers.hinge_slopes {
        return Ok(Verdict::NotOffered);
    }
    let hinges = folds(60);
    let answers = ask_hinge::<f64>(model, &hinges)?;
    let stiffness = |hinge: &Hinge| model.bending_stiffness(hinge).unwrap_or(f64::NAN);
    let (mut angle, mut length) = (Tally::default(), Tally::default());
    for (i, hinge) in hinges.iter().enumerate() {
        let k = answers.bending[i];
        let by_angle = |h| stiffness(&Hinge { angle: hinge.angle + h, ..*hinge });
        angle.add(agrees(answers.by_angle[i], k, 1.0, by_angle), || format!("{hinge:?}"));
        let by_length = |h| stiffness(&Hinge { length: hinge.length + h, ..*hinge });
        length.add(agrees(answers.by_length[i], k / hinge.length, hinge.length, by_length), || format!("{hinge:?}"));
    }
    angle.check("dk/dθ")?;
    length.check("dk/dl")?;
    Ok(Verdict::Passed)
}

/// [`CHECKS`]: ψ(G(F)) = ψ(G(RF)) up to rounding of G.
pub fn rotations_change_nothing(model: &dyn MaterialModel) -> Outcome {
    use nalgebra::{Matrix3x2, Rotation3, Vector3};
    let green = |f: &Matrix3x2<f64>| {
        let c = f.transpose() * f;
        [0.5 * (c[(0, 0)] - 1.0), 0.5 * (c[(1, 1)] - 1.0), 0.5 * c[(0, 1)]]
    };
    let mut tally = Tally::default();
    for i in 0..40 {
        let f = Matrix3x2::from_fn(|r, c| f64::from(u8::from(r == c)) + 0.2 * scattered(i, 2 * r + c));
        let axis = Vector3::new(scattered(i, 6), scattered(i, 7), scattered(i, 8)) * 3.0;
        let (a, b) = (green(&f), green(&(Rotation3::new(axis) * f)));
        let (one, other) = (model.at(a).map_err(unexpected("a strain"))?, model.at(b).map_err(unexpected("a strain"))?);
        let scale = one.stress.iter().fold(one.energy.abs(), |m, s| m.max(s.abs()));
        tally.add((one.energy - other.energy).abs() <= 1e-10 * scale, || {
            format!("F = {f:?}: {} and {} J/m²", one.energy, other.energy)
        });
    }
    tally.check("the energy of a turned cloth")?;
    Ok(Verdict::Passed)
}

/// Hinges at the edge of what a mesh can do, and beyond.
fn extreme_hinges() -> Vec<Hinge> {
    let mut hinges = Vec::new();
    let pi = std::f64::consts::PI;
    for angle in [-pi, -1e-12, 0.0, 1e-12, pi] {
        for (length, area) in [(0.01, 1e-4), (0.0, 1e-4), (0.01, 0.0), (0.0, 0.0), (1e3, 1e-30), (1e-12, 1e6)] {
            for directions in [[[1.0, 0.0], [0.0, -1.0]], [[0.0, 0.0]; 2], [[1e-20, 1e-20], [1e15, -1e15]]] {
                hinges.push(Hinge { angle, angle_rest: 0.3, length, area, directions });
            }
        }
    }
    hinges
}

/// [`CHECKS`]: k ≥ 0.
pub fn bending_is_not_negative(model: &dyn MaterialModel) -> Outcome {
    let hinges: Vec<Hinge> = folds(200).into_iter().chain(extreme_hinges()).collect();
    for (hinge, k) in hinges.iter().zip(ask_hinge::<f64>(model, &hinges)?.bending) {
        ensure(k >= 0.0 && k.is_finite(), || format!("k = {k} N·m for {hinge:?}"))?;
    }
    Ok(Verdict::Passed)
}

/// [`CHECKS`]: k is the same for the edge read backwards, and with its sides exchanged.
pub fn bending_ignores_the_edges_sense(model: &dyn MaterialModel) -> Outcome {
    for hinge in folds(60) {
        let [a, b] = hinge.directions;
        let k = |directions| model.bending_stiffness(&Hinge { directions, ..hinge }).map_err(unexpected("a hinge"));
        let (here, back, swapped) = (k([a, b])?, k([[-a[0], -a[1]], [-b[0], -b[1]]])?, k([b, a])?);
        ensure((back - here).abs() <= 1e-12 * here.abs(), || {
            format!("{here} and, backwards, {back} N·m for {hinge:?}")
        })?;
        ensure((swapped - here).abs() <= 1e-12 * here.abs(), || {
            format!("{here} and, sides exchanged, {swapped} N·m for {hinge:?}")
        })?;
    }
    Ok(Verdict::Passed)
}

/// Element `i` of every output of a block, as bits would compare.
fn element<T: Copy>(values: &[T], count: usize, i: usize) -> Vec<T> {
    (0..values.len() / count.max(1)).map(|row| values[row * count + i]).collect()
}

/// [`CHECKS`]: any block size, any order, the same bits.
pub fn elements_are_independent(model: &dyn MaterialModel) -> Outcome {
    fn in_precision<T: MaterialReal>(model: &dyn MaterialModel) -> std::result::Result<(), String> {
        let (green, hinges) = (strains(70), folds(70));
        let (all, bend) = (ask_membrane::<T>(model, &green)?, ask_hinge::<T>(model, &hinges)?);
        for count in [0, 1, 2, 15, 16, 17, 33, 64, 65] {
            // The last elements, backwards: another place in another block.
            let order: Vec<usize> = (0..count).map(|i| 69 - i).collect();
            let some = ask_membrane::<T>(model, &order.iter().map(|&i| green[i]).collect::<Vec<_>>())?;
            let some_bend = ask_hinge::<T>(model, &order.iter().map(|&i| hinges[i]).collect::<Vec<_>>())?;
            for (whole, part) in [(&all, &some), (&bend, &some_bend)] {
                for ((name, whole), (_, part)) in whole.all().into_iter().zip(part.all()) {
                    for (place, &i) in order.iter().enumerate().filter(|_| !whole.is_empty()) {
                        let (a, b) = (element(whole, 70, i), element(part, count, place));
                        ensure(a == b, || format!("{name} in a block of {count}: {b:?} instead of {a:?}"))?;
                    }
                }
            }
        }
        Ok(())
    }
    in_precision::<f32>(model)?;
    in_precision::<f64>(model)?;
    Ok(Verdict::Passed)
}

/// [`CHECKS`]: each output alone has the bits that it has among all.
pub fn outputs_are_independent(model: &dyn MaterialModel) -> Outcome {
    let (green, hinges) = (strains(37), folds(37));
    let (all, bend) = (ask_membrane::<f64>(model, &green)?, ask_hinge::<f64>(model, &hinges)?);
    let input: Vec<f64> = columns(&green);
    for (which, (name, wanted)) in all.all().into_iter().enumerate().take(6) {
        let mut values = vec![f64::NAN; wanted.len()];
        let mut block = MembraneBlock::new(37, &input);
        let place = match which {
            0 => &mut block.energy,
            1 => &mut block.stress,
            2 => &mut block.tangent_held,
            3 => &mut block.tangent_total,
            4 => &mut block.stress_by_parameter,
            _ => &mut block.stiffness,
        };
        *place = out(&mut values);
        f64::membrane(model, &mut block).map_err(unexpected("a membrane block"))?;
        ensure(values == wanted, || format!("{name} alone differs from {name} among all"))?;
    }
    let arrays = HingeArrays::of(&hinges);
    for (which, (name, wanted)) in bend.all().into_iter().skip(6).enumerate() {
        let mut values = vec![f64::NAN; wanted.len()];
        let mut block = arrays.block();
        let place = match which {
            0 => &mut block.stiffness,
            1 => &mut block.stiffness_by_angle,
            2 => &mut block.stiffness_by_length,
            _ => &mut block.stiffness_by_parameter,
        };
        *place = out(&mut values);
        f64::hinge(model, &mut block).map_err(unexpected("a hinge block"))?;
        ensure(values == wanted, || format!("{name} alone differs from {name} among all"))?;
    }
    Ok(Verdict::Passed)
}

/// Strains at the edge of what cloth can do, and beyond: collapsed, torn, equal principal strains, unphysical.
fn extreme_strains<T: Real>() -> Vec<[f64; 3]> {
    let largest = T::max_value().to_f64();
    let mut strains = vec![
        [-0.5, -0.5, 0.0],
        [-0.5, 0.0, 0.0],
        [0.1, 0.1, 0.0],
        [1e-300, -1e-300, 1e-300],
        // Stretch ×10 along u, along 45°.
        [49.5, 0.0, 0.0],
        [24.75, 24.75, 24.75],
        // No deformation has these.
        [-2.0, -3.0, 5.0],
        [0.0, 0.0, 10.0],
    ];
    for size in [1e3, 1e6, 1e12, 1e18, 1e30, largest] {
        for [u, v, w] in [[1.0, 1.0, 0.0], [-1.0, 1.0, 1.0], [0.0, 0.0, -1.0], [-1.0, -1.0, 0.5]] {
            strains.push([size * u, size * v, size * w]);
        }
    }
    strains
}

/// [`CHECKS`]: no finite input gives a value that is not finite.
pub fn extremes_are_finite(model: &dyn MaterialModel) -> Outcome {
    fn in_precision<T: MaterialReal>(model: &dyn MaterialModel) -> std::result::Result<(), String> {
        let (green, hinges) = (extreme_strains::<T>(), extreme_hinges());
        for (answers, count) in
            [(ask_membrane::<T>(model, &green)?, green.len()), (ask_hinge(model, &hinges)?, hinges.len())]
        {
            for (name, values) in answers.all() {
                if let Some(at) = values.iter().position(|v| !v.is_finite()) {
                    let i = at % count;
                    let place = green.get(i).map(|g| format!("G = {g:?}")).unwrap_or_default();
                    let place = if count == green.len() { place } else { format!("{:?}", hinges[i]) };
                    return Err(format!("{name} is {} for {place} in {} bits", values[at], 8 * size_of::<T>()));
                }
            }
        }
        Ok(())
    }
    in_precision::<f32>(model)?;
    in_precision::<f64>(model)?;
    Ok(Verdict::Passed)
}

/// Strains of deformations that meshes can have and cloth should not: collapsed to a line and to a point, stretched tenfold, with
/// equal principal strains.
const MISHAPS: [[f64; 3]; 8] = [
    [-0.5, -0.5, 0.0],
    [-0.5, 0.0, 0.0],
    [-0.25, -0.25, 0.25],
    [-0.4999, 2.0, 0.0],
    [0.1, 0.1, 0.0],
    [49.5, 0.0, 0.0],
    [49.5, 49.5, 0.0],
    [24.75, 24.75, 24.75],
];

/// [`CHECKS`]: the stress as in [`stress_is_the_gradient`] where cloth never is, across every guard: up to 1e12, a stretch of a
/// million. What a material with frozen stiffness owes beyond tenfold stretch is not defined.
///
/// Not asked of a material whose stress is wrong where cloth is.
pub fn extremes_keep_the_gradient(model: &dyn MaterialModel) -> Outcome {
    if stress_is_the_gradient(model).is_err() {
        return Ok(Verdict::NotOffered);
    }
    if model.describe().stiffness_frozen {
        return frozen_stress(model, &MISHAPS);
    }
    let mut all = MISHAPS.to_vec();
    for size in [1.0, 10.0, 70.0, 150.0, 1e3, 1e4, 1.5e6, 1e8, 1e12] {
        for pattern in [[1.0, 0.3, 0.0], [0.2, 1.0, 0.4], [1.0, 0.9, 0.8], [-0.1, 1.0, -0.2]] {
            all.push(pattern.map(|p| p * size));
        }
    }
    for green in all {
        let here = model.at(green).map_err(unexpected("a strain"))?;
        let scale = here.stress.iter().fold(0.0f64, |m, s| m.max(s.abs()));
        let step = green.iter().fold(1.0f64, |m, g| m.max(g.abs()));
        // A few roundings of the energy, however it is summed.
        let noise = 8.0 * f64::EPSILON * here.energy.abs().max(scale * step);
        for component in 0..3 {
            let slope = here.stress[component] * if component == 2 { 2.0 } else { 1.0 };
            let right = agrees_within(slope, scale, step, noise, |h| energy(model, shifted(green, component, h)));
            ensure(right, || {
                format!(
                    "{} = {} N/m is not the energy's slope at G = {green:?}",
                    COMPONENTS[component], here.stress[component]
                )
            })?;
        }
    }
    Ok(Verdict::Passed)
}

/// [`CHECKS`]: [`extremes_are_finite`] and [`bending_is_not_negative`] with each parameter, and all, at either bound; values that
/// do not go together may be refused.
///
/// Not asked of a material that fails either with its present values.
pub fn bounds_are_survived(model: &dyn MaterialModel) -> Outcome {
    if extremes_are_finite(model).is_err() || bending_is_not_negative(model).is_err() {
        return Ok(Verdict::NotOffered);
    }
    let parameters = model.parameters();
    let values: Vec<f64> = parameters.iter().map(|p| p.value).collect();
    let bounds: [fn(&crate::params::Parameter) -> f64; 2] = [|p| p.lower, |p| p.upper];
    for bound in bounds {
        let all = std::iter::once(parameters.iter().map(bound).collect::<Vec<f64>>());
        let each = parameters.iter().enumerate().map(|(i, p)| {
            let mut changed = values.clone();
            changed[i] = bound(p);
            changed
        });
        for values in all.chain(each) {
            let Ok(changed) = model.with_parameters(&values) else { continue };
            let place = |problem: String| format!("with the parameters {values:?}: {problem}");
            extremes_are_finite(&*changed).map_err(place)?;
            bending_is_not_negative(&*changed).map_err(place)?;
        }
    }
    Ok(Verdict::Passed)
}

/// [`CHECKS`]: [`Error::Length`] and [`Error::NonFinite`].
pub fn bad_blocks_are_refused(model: &dyn MaterialModel) -> Outcome {
    let mut energy = [0.0f64; 4];
    for (len, expected) in [(11, "Length"), (13, "Length"), (0, "Length")] {
        let green = vec![0.0; len];
        let mut block = MembraneBlock::new(4, &green);
        block.energy = (&mut energy[..]).into();
        let refused = matches!(f64::membrane(model, &mut block), Err(Error::Length { .. }));
        ensure(refused, || format!("{len} strain components for 4 elements are no {expected} error"))?;
    }
    let green = [0.0; 12];
    let mut block = MembraneBlock::new(4, &green);
    block.energy = (&mut energy[..3]).into();
    let refused = matches!(f64::membrane(model, &mut block), Err(Error::Length { .. }));
    ensure(refused, || "room for 3 energies of 4 elements is no Length error".into())?;
    for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        let mut green = [0.0; 12];
        green[7] = bad;
        let mut block = MembraneBlock::new(4, &green);
        block.energy = (&mut energy[..]).into();
        let refused = matches!(f64::membrane(model, &mut block), Err(Error::NonFinite { index: 7, .. }));
        ensure(refused, || format!("a strain of {bad} is no NonFinite error with its index"))?;
        let mut arrays = HingeArrays::<f64>::of(&folds(4));
        arrays.scalars[0][2] = bad;
        let mut block = arrays.block();
        block.stiffness = (&mut energy[..]).into();
        let refused = matches!(f64::hinge(model, &mut block), Err(Error::NonFinite { index: 2, .. }));
        ensure(refused, || format!("an angle of {bad} is no NonFinite error with its index"))?;
    }
    let mut arrays = HingeArrays::<f64>::of(&folds(4));
    arrays.directions[1].pop();
    let mut block = arrays.block();
    block.stiffness = (&mut energy[..]).into();
    let refused = matches!(f64::hinge(model, &mut block), Err(Error::Length { .. }));
    ensure(refused, || "7 direction components of 4 hinges are no Length error".into())?;
    Ok(Verdict::Passed)
}

/// [`CHECKS`]: f32 against f64, relative to each output's largest value: 2e-4 allows a few thousand roundings, and elements
/// beside a kink may differ.
pub fn single_agrees_with_double(model: &dyn MaterialModel) -> Outcome {
    let (single, double) = (probe::<f32>(model)?, probe::<f64>(model)?);
    for (single, double) in single.iter().zip(&double) {
        for ((name, single), (_, double)) in single.all().into_iter().zip(double.all()) {
            let peak = double.iter().fold(0.0f64, |m, v| m.max(v.abs()));
            let mut tally = Tally::default();
            for (s, d) in single.iter().zip(double) {
                let right = (f64::from(*s) - d).abs() <= 2e-4 * peak;
                tally.add(right, || format!("{s} in single, {d} in double precision"));
            }
            tally.check(name)?;
        }
    }
    Ok(Verdict::Passed)
}

/// [`CHECKS`]: names, bounds, and what [`MaterialModel::with_parameters`] makes of values inside and outside.
pub fn parameters_are_sound(model: &dyn MaterialModel) -> Outcome {
    let parameters = model.parameters();
    let mut names: Vec<&str> = parameters.iter().map(|p| p.name.as_str()).collect();
    names.sort_unstable();
    ensure(names.windows(2).all(|w| w[0] != w[1]), || "two parameters share a name".into())?;
    for p in &parameters {
        ensure(!p.name.is_empty() && !p.unit.is_empty(), || format!("{p:?} has no name or no unit"))?;
        p.check().map_err(unexpected("a present value"))?;
    }
    let values: Vec<f64> = parameters.iter().map(|p| p.value).collect();
    let same = model.with_parameters(&values).map_err(unexpected("with the present values"))?;
    ensure(same.parameters() == parameters, || "with the present values, parameters differ".into())?;
    ensure(same.describe() == model.describe(), || "with the present values, the description differs".into())?;
    ensure(probe::<f64>(&*same)? == probe::<f64>(model)?, || "with the present values, answers differ".into())?;
    let long = [&values[..], &[1.0]].concat();
    ensure(matches!(model.with_parameters(&long), Err(Error::Length { .. })), || {
        format!("{} values for {} parameters are no Length error", long.len(), values.len())
    })?;
    for (i, p) in parameters.iter().enumerate() {
        for bad in [p.upper + (p.upper - p.lower).max(1.0), p.lower - (p.upper - p.lower).max(1.0), f64::NAN] {
            let mut changed = values.clone();
            changed[i] = bad;
            let refused = matches!(model.with_parameters(&changed), Err(Error::Parameter { .. }));
            ensure(refused, || {
                format!("`{}` = {bad} outside [{}, {}] is no Parameter error", p.name, p.lower, p.upper)
            })?;
        }
        // A value in the middle is taken over.
        let mut changed = values.clone();
        changed[i] = p.value + 1e-3 * (p.upper - p.value);
        if let Ok(other) = model.with_parameters(&changed) {
            let got = other.parameters()[i].value;
            ensure(got == changed[i], || format!("`{}` = {} became {got}", p.name, changed[i]))?;
        }
    }
    Ok(Verdict::Passed)
}

/// [`CHECKS`]: doubling all parameters doubles energy, stress and bending stiffness, where that is declared.
pub fn linearity_is_as_declared(model: &dyn MaterialModel) -> Outcome {
    if !model.describe().linear_in_parameters {
        return Ok(Verdict::NotOffered);
    }
    let values: Vec<f64> = model.parameters().iter().map(|p| p.value * 1.5).collect();
    let larger = model.with_parameters(&values).map_err(unexpected("1.5 times the present values"))?;
    let (before, after) = (probe::<f64>(model)?, probe::<f64>(&*larger)?);
    for (before, after) in before.iter().zip(&after) {
        for ((name, a), (_, b)) in before.all().into_iter().zip(after.all()) {
            if !["energy", "stress", "bending stiffness"].contains(&name) {
                continue;
            }
            let peak = a.iter().fold(0.0f64, |m, v| m.max(v.abs()));
            let wrong = a.iter().zip(b).find(|(a, b)| (1.5 * **a - **b).abs() > 1e-10 * peak);
            ensure(wrong.is_none(), || format!("{name} {wrong:?} with all parameters 1.5 times as large"))?;
        }
    }
    Ok(Verdict::Passed)
}

/// [`CHECKS`]: pure, on any thread.
pub fn threads_change_nothing(model: &dyn MaterialModel) -> Outcome {
    let first = (probe::<f32>(model)?, probe::<f64>(model)?);
    let others: Vec<std::result::Result<bool, String>> = std::thread::scope(|scope| {
        let one = || Ok((probe::<f32>(model)?, probe::<f64>(model)?) == first);
        let threads: Vec<_> = (0..4).map(|_| scope.spawn(one)).collect();
        threads.into_iter().map(|t| t.join().unwrap_or_else(|_| Err("a thread panicked".into()))).collect()
    });
    for same in others {
        ensure(same?, || "other bits on another thread".into())?;
    }
    Ok(Verdict::Passed)
}

/// [`CHECKS`]: declared outputs are answered (every other check relies on it), the rest is [`Error::Unsupported`].
pub fn offers_are_true(model: &dyn MaterialModel) -> Outcome {
    let (offers, parameters) = (model.describe().offers, model.parameters().len());
    let green = [0.05, 0.01, 0.02];
    let mut values = vec![0.0f64; 9.max(3 * parameters)];
    for (name, offered, which, len) in [
        ("tangent_held", offers.tangent_held, 0, 9),
        ("tangent_total", offers.tangent_total, 1, 9),
        ("stress_by_parameter", offers.by_parameter, 2, 3 * parameters),
        ("stiffness", offers.stiffness, 3, 4),
    ] {
        let mut block = MembraneBlock::new(1, &green);
        let place = match which {
            0 => &mut block.tangent_held,
            1 => &mut block.tangent_total,
            2 => &mut block.stress_by_parameter,
            _ => &mut block.stiffness,
        };
        *place = (&mut values[..len]).into();
        answered(name, offered, f64::membrane(model, &mut block))?;
    }
    let arrays = HingeArrays::<f64>::of(&folds(1));
    for (name, offered, which, len) in [
        ("stiffness_by_angle", offers.hinge_slopes, 0, 1),
        ("stiffness_by_length", offers.hinge_slopes, 1, 1),
        ("bending stiffness_by_parameter", offers.by_parameter, 2, parameters),
    ] {
        let mut block = arrays.block();
        let place = match which {
            0 => &mut block.stiffness_by_angle,
            1 => &mut block.stiffness_by_length,
            _ => &mut block.stiffness_by_parameter,
        };
        *place = (&mut values[..len]).into();
        answered(name, offered, f64::hinge(model, &mut block))?;
    }
    Ok(Verdict::Passed)
}

/// An output is answered when it is offered, and refused cleanly when not.
pub(super) fn answered(name: &str, offered: bool, result: Result<()>) -> std::result::Result<(), String> {
    match (offered, result) {
        (true, Ok(())) | (false, Err(Error::Unsupported { .. })) => Ok(()),
        (true, Err(error)) => Err(format!("{name} is declared, but: {error}")),
        (false, Ok(())) => Err(format!("{name} is declared as not offered, but answered")),
        (false, Err(error)) => Err(format!("{name} is not offered, but the error is not Unsupported: {error}")),
    }
}
