//! A stress written by hand beside the energy: used where it is given, and compared with the energy by the kit.

use caphy_core::conformance::material::{CHECKS, MaterialSubject};
use caphy_core::conformance::run_all;
use caphy_core::energy_material::{EnergyFacts, EnergyMaterial, FromEnergy, HingeState, Scalar};
use caphy_core::extension::MaterialModelExt;
use caphy_core::material::{MaterialModel, MaterialSpec};
use caphy_core::params::Parameter;
use caphy_core::{Error, Result};

/// ψ = k/2 (Guu² + Gvv² + 2 Guv²); `factor` spoils the hand-written stress when it is not 1.
#[derive(Debug, Clone, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
struct HandWritten {
    k: f64,
    factor: f64,
}

#[typetag::serde(name = "hand_written")]
impl MaterialSpec for HandWritten {
    fn build(&self) -> Result<Box<dyn MaterialModel>> {
        Ok(FromEnergy::boxed(self.clone()))
    }
}

impl EnergyMaterial for HandWritten {
    fn facts(&self) -> EnergyFacts {
        EnergyFacts { linear_in_parameters: true, ..EnergyFacts::named("hand_written") }
    }
    fn parameters(&self) -> Vec<Parameter> {
        vec![Parameter { name: "k".into(), unit: "N/m".into(), value: self.k, lower: 0.0, upper: 1e6 }]
    }
    fn with_values(&self, values: &[f64]) -> Result<Self> {
        Error::check_length("parameter values", 1, values.len())?;
        Ok(Self { k: values[0], ..self.clone() })
    }
    #[inline(always)]
    fn energy<S: Scalar>(&self, theta: &[S], [u, v, w]: [S; 3]) -> S {
        theta[0] * (u.squared() + v.squared() + w.squared().times(2.0)).times(0.5)
    }
    #[inline(always)]
    fn stress<S: Scalar>(&self, theta: &[S], green: [S; 3]) -> Option<[S; 3]> {
        Some(green.map(|g| theta[0] * g.times(self.factor)))
    }
    #[inline(always)]
    fn bending_stiffness<S: Scalar>(&self, theta: &[S], hinge: &HingeState<S>) -> S {
        // Depends on fold and length, so that the slopes have something to say.
        let fold = hinge.angle - hinge.angle_rest;
        theta[0] * (S::constant(1.0) + fold.squared().times(0.1)).times(1e-6)
            / (S::constant(1.0) + hinge.length.squared())
    }
}

fn failures(factor: f64) -> Vec<&'static str> {
    let subject = MaterialSubject::linked(&format!("type = \"hand_written\"\nk = 12.0\nfactor = {factor:?}"));
    run_all(CHECKS, &subject).into_iter().filter(|row| row.outcome.is_err()).map(|row| row.name).collect()
}

#[test]
fn a_right_one_passes_every_check() {
    assert_eq!(failures(1.0), [""; 0]);
}

#[test]
fn it_is_used_and_a_wrong_one_is_found() {
    // Tangents and parameter derivatives follow the hand-written stress: only the energy contradicts it.
    assert_eq!(failures(1.1), ["stress_is_the_gradient"]);
    let model = HandWritten { k: 12.0, factor: 1.1 }.build().expect("a material");
    assert!((model.at([0.1, 0.0, 0.05]).expect("an answer").stress[0] - 1.32).abs() < 1e-15);
    assert!((model.tangent_total_at([0.0; 3]).expect("a tangent")[2][2] - 13.2).abs() < 1e-14);
}
