//! Panics stop at the border and carry their message.

use caphy_core::host::Library;
use caphy_core::material::{
    HingeCall, HingeLength, MaterialDescription, MaterialModel, MaterialOutputs, MaterialSpec, MembraneBlock,
    MembraneCall,
};
use caphy_core::net::{DeformationNet, NetSpec};
use caphy_core::params::Parameter;
use caphy_core::{Error, PluginProblem, Result};
use std::path::Path;

/// `type = "panicky"`: panics where its table says.
#[derive(Debug, Clone, serde::Serialize, serde::Deserialize)]
struct PanickySpec {
    at: String,
}

#[typetag::serde(name = "panicky")]
impl MaterialSpec for PanickySpec {
    fn build(&self) -> Result<Box<dyn MaterialModel>> {
        self.panic_at("create");
        Ok(Box::new(Panicky(self.clone())))
    }
}

#[typetag::serde(name = "panicky")]
impl NetSpec for PanickySpec {
    fn build(&self, inputs: usize, outputs: usize) -> Result<Box<dyn DeformationNet>> {
        panic!("no net of {inputs} by {outputs}")
    }
}

impl PanickySpec {
    fn panic_at(&self, call: &str) {
        assert!(self.at != call, "told to panic in {call}");
    }
}

struct Panicky(PanickySpec);

impl Drop for Panicky {
    fn drop(&mut self) {
        self.0.panic_at("destroy");
    }
}

impl MaterialModel for Panicky {
    fn describe(&self) -> MaterialDescription {
        self.0.panic_at("describe");
        MaterialDescription {
            name: "panicky".into(),
            density: None,
            stiffness_frozen: false,
            hinge_length: HingeLength::Rest,
            linear_in_parameters: false,
            offers: MaterialOutputs::REQUIRED,
        }
    }
    fn membrane(&self, _: MembraneCall<'_, '_>) -> Result<()> {
        self.0.panic_at("membrane_f64");
        Ok(())
    }
    fn hinge(&self, _: HingeCall<'_, '_>) -> Result<()> {
        Ok(())
    }
    fn parameters(&self) -> Vec<Parameter> {
        self.0.panic_at("parameter");
        Vec::new()
    }
    fn with_parameters(&self, _: &[f64]) -> Result<Box<dyn MaterialModel>> {
        self.0.panic_at("with_parameters");
        Ok(Box::new(Panicky(self.0.clone())))
    }
}

fn library() -> Library {
    let table = caphy_core::plugin_table!(materials: ["panicky"], nets: ["panicky"]);
    // SAFETY: the macro's table is static and of this version.
    unsafe { Library::from_table(Path::new("panicky"), &table.0) }.expect("a table")
}

fn toml(at: &str) -> String {
    format!("type = \"panicky\"\nat = \"{at}\"")
}

fn assert_panic(result: Result<()>, at: &str, words: &str) {
    match result {
        Err(Error::Plugin { problem: PluginProblem::Panic { type_name, call, message }, .. }) => {
            assert_eq!((&*type_name, &*call), ("panicky", at));
            assert!(message.contains(words), "{message}");
        }
        other => panic!("{at}: {other:?}"),
    }
}

#[test]
fn every_call_of_a_material_may_panic() {
    let library = library();
    for at in ["create", "describe"] {
        assert_panic(library.material("panicky", &toml(at)).map(drop), at, &format!("told to panic in {at}"));
    }
    // The count is asked for together with the facts.
    assert_panic(library.material("panicky", &toml("parameter")).map(drop), "describe", "told to panic in parameter");
    let green = [0.0; 3];
    let mut energy = [0.0f64];
    let mut block = MembraneBlock::new(1, &green);
    block.energy = (&mut energy[..]).into();
    let model = library.material("panicky", &toml("membrane_f64")).expect("a material");
    assert_panic(model.membrane((&mut block).into()), "membrane_f64", "told to panic in membrane_f64");
    // It still answers elsewhere, and again.
    let mut block = MembraneBlock::new(1, &green);
    assert_panic(model.membrane((&mut block).into()), "membrane_f64", "told");
    let model = library.material("panicky", &toml("with_parameters")).expect("a material");
    assert_panic(model.with_parameters(&[]).map(drop), "with_parameters", "told to panic in with_parameters");
    // Nobody can be told, but nobody is hurt.
    drop(library.material("panicky", &toml("destroy")).expect("a material"));
}

#[test]
fn a_net_may_panic() {
    assert_panic(library().net("panicky", &toml(""), 2, 3).map(drop), "create", "no net of 2 by 3");
}
