//! Presets, tables of the user's own, and what is refused.

use caphy_core::Error;
use caphy_core::extension::MaterialModelExt;
use caphy_core::material::{HingeLength, MaterialModel};
use caphy_materials::measured::{
    BendingLookup, EdgeLength, Fabric, Form, MaterialMeasured, MaterialMeasuredSpec, StiffnessGradient, StretchLookup,
    Switches,
};

fn spec(text: &str) -> MaterialMeasuredSpec {
    toml::from_str(text).unwrap_or_else(|e| panic!("{e}"))
}

fn built(text: &str) -> MaterialMeasured {
    spec(text).build_measured().unwrap_or_else(|e| panic!("{e}"))
}

const GRAY: &str = "fabric = \"gray-interlock\"\n";

#[test]
fn presets_set_the_switches_and_each_key_overrides() {
    let plain = Switches::default();
    assert_eq!(spec(GRAY).switches(), plain);
    assert_eq!(spec(&format!("{GRAY}preset = \"default\"")).switches(), plain);
    let old = Switches { bending: BendingLookup::Faithful, ..plain };
    assert_eq!(spec(&format!("{GRAY}preset = \"arcsim-0.2.1\"")).switches(), old);
    let new = Switches { edge_length: EdgeLength::Current, ..old };
    assert_eq!(spec(&format!("{GRAY}preset = \"arcsim-0.3.1\"")).switches(), new);
    assert_eq!(built(&format!("{GRAY}preset = \"arcsim-0.3.1\"")).describe().hinge_length, HingeLength::CurrentHeld);
    for (key, changed) in [
        ("form = \"isotropic\"", Switches { form: Form::Isotropic, ..new }),
        ("lookup = \"direct\"", Switches { lookup: StretchLookup::Direct, ..new }),
        ("stiffness_gradient = \"full\"", Switches { stiffness_gradient: StiffnessGradient::Full, ..new }),
        ("bending = \"repaired\"", Switches { bending: BendingLookup::Repaired, ..new }),
        ("edge_length = \"rest\"", Switches { edge_length: EdgeLength::Rest, ..new }),
    ] {
        assert_eq!(built(&format!("{GRAY}preset = \"arcsim-0.3.1\"\n{key}")).switches(), changed, "{key}");
    }
    let unknown = toml::from_str::<MaterialMeasuredSpec>("preset = \"arcsim\"").unwrap_err().to_string();
    assert!(unknown.contains("arcsim-0.2.1") && unknown.contains("arcsim-0.3.1"), "{unknown}");
}

/// The gray interlock as a table of one's own.
fn own(edit: impl Fn(&mut [[f64; 4]; 6], &mut [[f64; 5]; 3])) -> String {
    let mut fabric = Fabric::named("gray-interlock").unwrap();
    edit(&mut fabric.stretching, &mut fabric.bending);
    format!(
        "[table]\nname = \"my jersey\"\ndensity_kg_per_m2 = {}\nstretching_n_per_m = {:?}\nbending_nm = {:?}\n",
        fabric.density.0, fabric.stretching, fabric.bending
    )
    .replace("NaN", "nan")
}

#[test]
fn a_table_of_ones_own_is_a_fabric_like_any_other() {
    let (mine, shipped) = (built(&own(|_, _| ())), built(GRAY));
    assert_eq!((mine.fabric(), shipped.fabric()), ("my jersey", "gray-interlock"));
    assert_eq!(mine.describe().density, shipped.describe().density);
    for g in [[0.0; 3], [0.1, -0.02, 0.03], [0.4, 0.3, -0.2]] {
        assert_eq!(mine.at(g).unwrap(), shipped.at(g).unwrap());
    }
    // Multipliers and density stand beside it.
    let scaled =
        built(&format!("membrane_multipliers = [2.0, 2.0, 2.0, 2.0]\ndensity_kg_per_m2 = 0.3\n{}", own(|_, _| ())));
    let (a, b) = (scaled.at([0.1, 0.0, 0.05]).unwrap().energy, shipped.at([0.1, 0.0, 0.05]).unwrap().energy);
    assert!((a - 2.0 * b).abs() < 1e-14 * a && scaled.describe().density.unwrap().0 == 0.3);
    // Back and forth through TOML.
    let again: MaterialMeasuredSpec = toml::from_str(&toml::to_string(&spec(&own(|_, _| ()))).unwrap()).unwrap();
    assert_eq!(again, spec(&own(|_, _| ())));
}

#[test]
fn tables_that_make_no_sheet_are_refused_by_row_and_column() {
    let refused = |text: &str| match spec(text).build_measured() {
        Err(Error::Config { key, problem, .. }) => (key, problem),
        other => panic!("{other:?}"),
    };
    let key = |row: usize, column: usize| format!("material.table.stretching_n_per_m[{row}][{column}]");
    for (row, column, value) in
        [(3, 1, f64::NAN), (0, 0, f64::INFINITY), (5, 3, 1e12), (2, 0, 0.0), (4, 2, -1.0), (0, 1, 1e4)]
    {
        let (at, problem) = refused(&own(|s, _| s[row][column] = value));
        assert_eq!(at, key(row, column), "{problem}");
    }
    assert!(refused(&own(|s, _| s[0][1] = 1e4)).1.contains("indefinite"));
    for value in [-1e-6, f64::NAN, 1e10] {
        assert_eq!(refused(&own(|_, b| b[2][4] = value)).0, "material.table.bending_nm[2][4]");
    }
    // What the published tables have is allowed: negative c12 and c33, stretched rows that are indefinite.
    built(&own(|s, _| {
        s[1][3] = -5.0;
        s[2][1] = -5.0;
        s[4][1] = 1e3;
    }));
    assert!(
        refused(&own(|_, _| ()).replace("density_kg_per_m2 = 0.", "density_kg_per_m2 = -0.")).0.contains("density")
    );
    let both = refused(&format!("{GRAY}{}", own(|_, _| ())));
    assert!(both.1.contains("together"), "{both:?}");
    let neither = refused("preset = \"default\"");
    assert!(neither.1.contains("missing"), "{neither:?}");
    // Wrong shapes are the parser's: it counts.
    let shape = own(|_, _| ()).replace("bending_nm = [[", "bending_nm = [[1.0, ");
    let said = toml::from_str::<MaterialMeasuredSpec>(&shape).unwrap_err().to_string();
    assert!(said.contains("row 0") && said.contains("6 values, expected 5"), "{said}");
    let rows = own(|_, _| ()).replace("stretching_n_per_m = [", "stretching_n_per_m = [[1.0, 0.0, 1.0, 0.0], ");
    let said = toml::from_str::<MaterialMeasuredSpec>(&rows).unwrap_err().to_string();
    assert!(said.contains("7 values, expected 6"), "{said}");
    let said = toml::from_str::<MaterialMeasuredSpec>("membrane_multipliers = [1.0, 1.0, 1.0, 1.0, 1.0]").unwrap_err();
    assert!(said.to_string().contains("5 values, expected 4"), "{said}");
}

#[test]
fn a_switch_that_cannot_act_is_refused() {
    for text in [
        format!("{GRAY}lookup = \"direct\"\nstiffness_gradient = \"full\""),
        format!("{GRAY}preset = \"arcsim-0.2.1\"\nlookup = \"direct\"\nstiffness_gradient = \"full\""),
    ] {
        let error = spec(&text).build_measured().unwrap_err().to_string();
        assert!(error.contains("`full`") && error.contains("direct"), "{error}");
    }
}
