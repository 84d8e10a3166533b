//! Faulty materials around a correct one: StVK with a bending stiffness that depends on fold and length.

use caphy_core::conformance::material::{CHECKS, MaterialSubject};
use caphy_core::material::{
    HingeBlock, HingeCall, HingeLength, MaterialDescription, MaterialModel, MaterialOutputs, MembraneBlock,
    MembraneCall,
};
use caphy_core::params::{Parameter, check_values};
use caphy_core::{Error, Real, Result};
use std::thread::ThreadId;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Fault {
    None,
    NothingOptional,
    OtherName,
    AnotherTableWrittenBack,
    UnknownKeysTaken,
    EnergyAtRest,
    EnergyOfHalfTheShear,
    FrozenButNotHeld,
    TangentOfOtherSign,
    HeldTangentAsymmetric,
    ParameterForgotten,
    BendingParameterForgotten,
    SlopeByAngleHalved,
    SlopeByLengthHalved,
    SensitiveToLastBits,
    NegativeBending,
    EdgeHasASense,
    NeighboursMatter,
    EnergyAloneDiffers,
    NoStrainLimit,
    EnergyCutAlone,
    UnfitForItsBounds,
    NoChecks,
    SingleIsAnother,
    BoundsNotChecked,
    NotLinear,
    ThreadMatters,
    AnswersWhatItDoesNotOffer,
}

/// ψ = λ/2 tr² + μ tr(G²), k = b (1 + (θ − θ_rest)²/10) / (1 + 10 l): all derivatives by hand.
#[derive(Clone)]
struct Sheet {
    /// λ, μ [N/m], b [N·m].
    values: [f64; 3],
    fault: Fault,
    made_on: ThreadId,
}

const NAMES: [(&str, &str); 3] = [("lambda", "N/m"), ("mu", "N/m"), ("bending", "N·m")];
const BOUNDS: [f64; 2] = [1e-9, 1e3];

impl Sheet {
    fn is(&self, fault: Fault) -> bool {
        self.fault == fault
    }

    fn membrane_in<T: Real>(&self, block: &mut MembraneBlock<'_, T>) -> Result<()> {
        if !self.is(Fault::NoChecks) {
            block.check(3)?;
        }
        if !self.is(Fault::AnswersWhatItDoesNotOffer) {
            self.describe().offers.check_membrane(block, "sheet")?;
        }
        let n = block.count;
        let [lambda, mu, _] = self.values;
        // Not linear in μ, with the right derivative.
        let (mu, mu_slope) = if self.is(Fault::NotLinear) { (mu + 1e-3 * mu * mu, 1.0 + 2e-3 * mu) } else { (mu, 1.0) };
        let stiff = lambda + 2.0 * mu;
        let stress_factor = if self.is(Fault::FrozenButNotHeld) { 1.01 } else { 1.0 };
        let limit = if size_of::<T>() == 4 { 1e14 } else { 1e100 };
        let elsewhere = self.is(Fault::ThreadMatters) && std::thread::current().id() != self.made_on;
        let alone = self.is(Fault::EnergyAloneDiffers) && !block.stress.wanted();
        for i in 0..n {
            let green = block.green.or_empty();
            let g: [f64; 3] = std::array::from_fn(|c| {
                let value = green[c * n + i].to_f64();
                if self.is(Fault::NoStrainLimit) { value } else { value.clamp(-limit, limit) }
            });
            let [u, v, w] = g;
            if let Some(out) = block.energy.get() {
                let shear = if self.is(Fault::EnergyOfHalfTheShear) { 1.0 } else { 2.0 };
                let mut psi = 0.5 * lambda * (u + v) * (u + v) + mu * (u * u + v * v + shear * w * w);
                if self.is(Fault::EnergyCutAlone) && psi > 1e9 {
                    psi = 1e9;
                }
                if self.is(Fault::UnfitForItsBounds) && lambda > 500.0 {
                    psi = f64::INFINITY;
                }
                psi += if self.is(Fault::EnergyAtRest) { 1e-6 * mu } else { 0.0 };
                if self.is(Fault::SensitiveToLastBits) && (u.to_bits() ^ v.to_bits() ^ w.to_bits()) & 1 == 1 {
                    psi *= 1.0 + 1e-8;
                }
                if (self.is(Fault::NeighboursMatter) && n >= 15 && i + 1 == n) || elsewhere || alone {
                    psi *= 1.0 + 1e-6;
                }
                if self.is(Fault::SingleIsAnother) && size_of::<T>() == 4 {
                    psi *= 1.01;
                }
                out[i] = T::of(psi);
            }
            if let Some(out) = block.stress.get() {
                let s = [stiff * u + lambda * v, stiff * v + lambda * u, 2.0 * mu * w];
                for c in 0..3 {
                    out[c * n + i] = T::of(stress_factor * s[c]);
                }
            }
            let tangent = [stiff, lambda, 0.0, lambda, stiff, 0.0, 0.0, 0.0, 2.0 * mu].map(|t| stress_factor * t);
            if let Some(out) = block.tangent_total.get() {
                for (entry, t) in tangent.iter().enumerate() {
                    let sign = if self.is(Fault::TangentOfOtherSign) && entry == 8 { -1.0 } else { 1.0 };
                    out[entry * n + i] = T::of(sign * t);
                }
            }
            if let Some(out) = block.tangent_held.get() {
                for (entry, t) in tangent.iter().enumerate() {
                    let more = if self.is(Fault::HeldTangentAsymmetric) && entry == 2 { 1.0 } else { 0.0 };
                    out[entry * n + i] = T::of(t + more);
                }
            }
            if let Some(out) = block.stiffness.get() {
                for (row, k) in [stiff, lambda, stiff, 2.0 * mu].into_iter().enumerate() {
                    out[row * n + i] = T::of(k);
                }
            }
            if let Some(out) = block.stress_by_parameter.get() {
                let by_mu = if self.is(Fault::ParameterForgotten) { 0.0 } else { 2.0 * mu_slope };
                let rows = [u + v, u + v, 0.0, by_mu * u, by_mu * v, by_mu * w, 0.0, 0.0, 0.0];
                for (row, value) in rows.into_iter().enumerate() {
                    out[row * n + i] = T::of(stress_factor * value);
                }
            }
        }
        Ok(())
    }

    fn hinge_in<T: Real>(&self, block: &mut HingeBlock<'_, T>) -> Result<()> {
        if !self.is(Fault::NoChecks) {
            block.check(3)?;
        }
        self.describe().offers.check_hinge(block, "sheet")?;
        let n = block.count;
        for i in 0..n {
            let at = |values: &[T]| values[i].to_f64();
            let fold = at(block.angle.or_empty()) - at(block.angle_rest.or_empty());
            let length = at(block.length.or_empty()).abs();
            let mut b = self.values[2];
            b *= if self.is(Fault::NegativeBending) { -1.0 } else { 1.0 };
            b *= if self.is(Fault::EdgeHasASense) && at(block.direction0.or_empty()) > 0.0 { 1.1 } else { 1.0 };
            let (rise, room) = (1.0 + 0.1 * fold * fold, 1.0 / (1.0 + 10.0 * length));
            if let Some(out) = block.stiffness.get() {
                out[i] = T::of(b * rise * room);
            }
            if let Some(out) = block.stiffness_by_angle.get() {
                let share = if self.is(Fault::SlopeByAngleHalved) { 0.5 } else { 1.0 };
                out[i] = T::of(share * b * 0.2 * fold * room);
            }
            if let Some(out) = block.stiffness_by_length.get() {
                let share = if self.is(Fault::SlopeByLengthHalved) { 0.5 } else { 1.0 };
                out[i] = T::of(share * b * rise * -10.0 * room * room);
            }
            if let Some(out) = block.stiffness_by_parameter.get() {
                let by_bending = if self.is(Fault::BendingParameterForgotten) { 0.0 } else { b / self.values[2] };
                for (p, value) in [0.0, 0.0, by_bending * rise * room].into_iter().enumerate() {
                    out[p * n + i] = T::of(value);
                }
            }
        }
        Ok(())
    }
}

impl MaterialModel for Sheet {
    fn describe(&self) -> MaterialDescription {
        let mut offers = MaterialOutputs::ALL;
        if self.is(Fault::NothingOptional) {
            offers = MaterialOutputs::REQUIRED;
        }
        if self.is(Fault::AnswersWhatItDoesNotOffer) {
            offers.stiffness = false;
        }
        MaterialDescription {
            name: if self.is(Fault::OtherName) { "shirt" } else { "sheet" }.into(),
            density: None,
            stiffness_frozen: self.is(Fault::FrozenButNotHeld),
            hinge_length: HingeLength::Rest,
            linear_in_parameters: true,
            offers,
        }
    }
    fn membrane(&self, call: MembraneCall<'_, '_>) -> Result<()> {
        match call {
            MembraneCall::F32(block) => self.membrane_in(block),
            MembraneCall::F64(block) => self.membrane_in(block),
        }
    }
    fn hinge(&self, call: HingeCall<'_, '_>) -> Result<()> {
        match call {
            HingeCall::F32(block) => self.hinge_in(block),
            HingeCall::F64(block) => self.hinge_in(block),
        }
    }
    fn parameters(&self) -> Vec<Parameter> {
        let one = |((name, unit), value): (&(&str, &str), f64)| Parameter {
            name: (*name).into(),
            unit: (*unit).into(),
            value,
            lower: BOUNDS[0],
            upper: BOUNDS[1],
        };
        NAMES.iter().zip(self.values).map(one).collect()
    }
    fn with_parameters(&self, values: &[f64]) -> Result<Box<dyn MaterialModel>> {
        if self.is(Fault::BoundsNotChecked) {
            Error::check_length("parameter values", 3, values.len())?;
        } else {
            check_values(&self.parameters(), values)?;
        }
        Ok(Box::new(Self { values: [values[0], values[1], values[2]], ..self.clone() }))
    }
}

const TABLE: &str = "type = \"sheet\"\nstiffness = 20.0\n";

fn subject(fault: Fault) -> MaterialSubject {
    let read = move |text: &str| -> Result<f64> {
        let table: toml::Table =
            toml::from_str(text).map_err(|e| Error::config("sheet", e.message(), "correct the table"))?;
        for key in table.keys() {
            if !["type", "stiffness"].contains(&key.as_str()) && fault != Fault::UnknownKeysTaken {
                return Err(Error::config(key, "is unknown", "remove it"));
            }
        }
        Ok(table["stiffness"].as_float().expect("a number"))
    };
    let create = move |text: &str| -> Result<Box<dyn MaterialModel>> {
        let values = [read(text)?, 10.0, 1e-5];
        Ok(Box::new(Sheet { values, fault, made_on: std::thread::current().id() }))
    };
    let change = if fault == Fault::AnotherTableWrittenBack { 1.0 } else { 0.0 };
    let normalise = move |text: &str| Ok(format!("type = \"sheet\"\nstiffness = {:?}\n", read(text)? + change));
    MaterialSubject { toml: TABLE.into(), create: Box::new(create), normalise: Some(Box::new(normalise)) }
}

/// Faults and the checks that reject them.
fn faults() -> Vec<(Fault, Vec<&'static str>)> {
    vec![
        (Fault::OtherName, vec!["name_is_the_type"]),
        (Fault::AnotherTableWrittenBack, vec!["table_survives_a_round_trip"]),
        (Fault::UnknownKeysTaken, vec!["unknown_keys_are_refused"]),
        (Fault::EnergyAtRest, vec!["rest_is_free_of_stress"]),
        (Fault::EnergyOfHalfTheShear, vec!["stress_is_the_gradient"]),
        (Fault::FrozenButNotHeld, vec!["stress_is_the_gradient"]),
        (Fault::TangentOfOtherSign, vec!["tangent_is_the_derivative"]),
        (Fault::HeldTangentAsymmetric, vec!["held_tangent_is_symmetric"]),
        (Fault::ParameterForgotten, vec!["parameter_derivatives_are_exact"]),
        (Fault::BendingParameterForgotten, vec!["parameter_derivatives_are_exact"]),
        (Fault::SlopeByAngleHalved, vec!["hinge_slopes_are_exact"]),
        (Fault::SlopeByLengthHalved, vec!["hinge_slopes_are_exact"]),
        (Fault::SensitiveToLastBits, vec!["rotations_change_nothing"]),
        (Fault::NegativeBending, vec!["bending_is_not_negative"]),
        (Fault::EdgeHasASense, vec!["bending_ignores_the_edges_sense"]),
        (Fault::NeighboursMatter, vec!["elements_are_independent"]),
        (Fault::EnergyAloneDiffers, vec!["outputs_are_independent"]),
        (Fault::NoStrainLimit, vec!["extremes_are_finite"]),
        (Fault::EnergyCutAlone, vec!["extremes_keep_the_gradient"]),
        (Fault::UnfitForItsBounds, vec!["bounds_are_survived"]),
        (Fault::NoChecks, vec!["bad_blocks_are_refused"]),
        (Fault::SingleIsAnother, vec!["single_agrees_with_double"]),
        (Fault::BoundsNotChecked, vec!["parameters_are_sound"]),
        (Fault::NotLinear, vec!["linearity_is_as_declared"]),
        (Fault::ThreadMatters, vec!["threads_change_nothing"]),
        (Fault::AnswersWhatItDoesNotOffer, vec!["offers_are_true"]),
    ]
}

#[test]
fn correct_materials_pass() {
    super::assert_accepted(CHECKS, &subject(Fault::None), &[]);
    let optional = [
        "tangent_is_the_derivative",
        "held_tangent_is_symmetric",
        "parameter_derivatives_are_exact",
        "hinge_slopes_are_exact",
    ];
    super::assert_accepted(CHECKS, &subject(Fault::NothingOptional), &optional);
}

#[test]
fn each_fault_is_rejected_by_its_check() {
    for (fault, expected) in faults() {
        super::assert_rejected(CHECKS, &format!("{fault:?}"), &subject(fault), &expected);
    }
    let sets: Vec<Vec<&str>> = faults().into_iter().map(|f| f.1).collect();
    super::assert_covered(CHECKS, &sets);
}
