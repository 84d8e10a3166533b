//! `caphy show` and `caphy probe`, as a shell would call them.

use serde_json::{Value, json};
use std::path::Path;
use std::process::{Command, Output};
use tempfile::TempDir;

pub(crate) fn caphy(folder: &Path, arguments: &[&str]) -> Output {
    let program = env!("CARGO_BIN_EXE_caphy");
    Command::new(program).args(arguments).current_dir(folder).output().expect("caphy starts")
}

pub(crate) fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).expect("UTF-8")
}

fn answer(folder: &Path, arguments: &[&str]) -> Value {
    let output = caphy(folder, arguments);
    assert!(output.status.success(), "{arguments:?}: {}", text(&output.stderr));
    serde_json::from_slice(&output.stdout).expect("JSON")
}

/// What a failing command says.
pub(crate) fn refusal(folder: &Path, arguments: &[&str]) -> String {
    let output = caphy(folder, arguments);
    assert!(!output.status.success(), "{arguments:?} must fail");
    text(&output.stderr)
}

fn folder() -> TempDir {
    tempfile::tempdir().expect("a folder")
}

fn write(folder: &TempDir, name: &str, content: &str) {
    std::fs::write(folder.path().join(name), content).expect("a written file");
}

fn flat(value: &Value) -> Vec<f64> {
    match value {
        Value::Array(list) => list.iter().flat_map(flat).collect(),
        other => vec![other.as_f64().expect("a number")],
    }
}

/// Relative to the largest entry of the array, plus a floor: the tolerance of the reference files.
fn assert_close(id: &str, name: &str, want: &Value, got: &Value, relative: f64, floor: f64) {
    let (want, got) = (flat(want), flat(got));
    assert_eq!(want.len(), got.len(), "{id} {name}");
    let scale = want.iter().fold(0.0f64, |m, w| m.max(w.abs()));
    for (w, g) in want.iter().zip(&got) {
        assert!((w - g).abs() <= relative * scale + floor, "{id} {name}: {g} instead of {w}");
    }
}

fn reference(name: &str) -> Vec<Value> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("crates/materials/tests/data").join(name);
    let file: Value = serde_json::from_slice(&std::fs::read(path).expect("a reference file")).expect("JSON");
    file["cases"].as_array().expect("cases").clone()
}

fn by_fabric(cases: Vec<Value>) -> Vec<(String, Vec<Value>)> {
    let mut groups: Vec<(String, Vec<Value>)> = Vec::new();
    for case in cases {
        let fabric = case["fabric"].as_str().expect("a fabric").to_string();
        match groups.iter_mut().find(|g| g.0 == fabric) {
            Some(group) => group.1.push(case),
            None => groups.push((fabric, vec![case])),
        }
    }
    assert_eq!(groups.len(), 10);
    groups
}

#[test]
fn every_stretch_of_the_reference_through_the_command_line() {
    let folder = folder();
    for (fabric, cases) in by_fabric(reference("arcsim_stretch.json")) {
        write(&folder, "m.toml", &format!("type = \"measured\"\nfabric = \"{fabric}\"\n"));
        let gradients: Vec<&Value> = cases.iter().map(|c| &c["F"]).collect();
        write(&folder, "f.json", &json!(gradients).to_string());
        let answers = answer(folder.path(), &["probe", "m.toml", "--gradients", "f.json", "--json"]);
        assert_eq!(answers.as_array().map(Vec::len), Some(cases.len()));
        for (case, answer) in cases.iter().zip(answers.as_array().expect("an array")) {
            let id = case["id"].as_str().expect("an id");
            assert_close(id, "k", &case["k"], &answer["stiffness"], 1e-9, 1e-7);
            assert_close(id, "W", &case["W_force"], &answer["energy"], 1e-8, 1e-10);
            assert_close(id, "S", &case["S_force"], &answer["second_pk"], 1e-8, 1e-7);
            let (f, s) = (flat(&case["F"]), flat(&answer["second_pk"]));
            let p: Vec<f64> =
                (0..6).map(|i| f[i / 2 * 2] * s[[0, 2][i % 2]] + f[i / 2 * 2 + 1] * s[[2, 1][i % 2]]).collect();
            assert_close(id, "P = F S", &json!(p), &answer["first_pk"], 1e-14, 0.0);
        }
    }
}

#[test]
fn every_fold_of_the_reference_through_the_command_line() {
    let folder = folder();
    for (fabric, cases) in by_fabric(reference("arcsim_bend.json")) {
        let hinge = |c: &Value| json!({ "u_side0": c["u_side0"], "u_side1": c["u_side1"], "x": c["x"], "theta_rest": c["theta_rest"] });
        write(&folder, "h.json", &json!(cases.iter().map(hinge).collect::<Vec<_>>()).to_string());
        for rule in ["rest", "current"] {
            let table = "type = \"measured\"\nbending = \"faithful\"";
            write(&folder, "m.toml", &format!("{table}\nfabric = \"{fabric}\"\nedge_length = \"{rule}\"\n"));
            let answers = answer(folder.path(), &["probe", "m.toml", "--hinges", "h.json", "--json"]);
            for (case, answer) in cases.iter().zip(answers.as_array().expect("an array")) {
                let (id, want) = (case["id"].as_str().expect("an id"), &case[format!("{rule}_length")]);
                // The angle of a flat hinge is rounding of its coordinates.
                assert_close(id, "theta", &want["theta"], &answer["theta"], 1e-9, 1e-10);
                assert_close(id, "k", &want["k"], &answer["stiffness"], 1e-9, 1e-15);
                assert_close(id, "E", &want["energy"], &answer["energy"], 1e-8, 1e-18);
                assert_close(id, "f", &want["force_frozen_k"], &answer["force"], 1e-7, 1e-12);
            }
        }
    }
}

#[test]
fn a_model_without_four_constants_has_no_stiffness_in_its_answers() {
    let folder = folder();
    write(&folder, "m.toml", "type = \"stvk\"\nlambda_n_per_m = 20.0\nmu_n_per_m = 10.0\n");
    write(&folder, "f.json", "[[[1.1, 0], [0, 1], [0, 0]]]");
    let answers = answer(folder.path(), &["probe", "m.toml", "--gradients", "f.json", "--json"]);
    assert_close("stvk", "S", &json!([0.105 * 40.0, 0.105 * 20.0, 0.0]), &answers[0]["second_pk"], 1e-12, 0.0);
    assert_eq!(answers[0]["stiffness"], json!([40.0, 20.0, 40.0, 20.0]));
}

#[test]
fn mistakes_name_file_key_line_and_column() {
    let folder = folder();
    write(&folder, "f.json", "[[[1.1, 0], [0, 1], [0, 0]]]");
    let says = |table: &str| {
        write(&folder, "m.toml", table);
        refusal(folder.path(), &["probe", "m.toml", "--gradients", "f.json"])
    };
    for (table, words) in [
        (
            "type = \"measured\"\nfabric = \"gray-interlock\"\n  from = \"x\"",
            &["m.toml, line 3, column 3", "`from`"][..],
        ),
        ("type = \"linen\"", &["line 1, column 1", "`linen`", "`measured`", "`stvk`", "--plugin"]),
        ("fabric = \"gray-interlock\"", &["m.toml", "missing field `type`"]),
        ("type = \"measured\"", &["m.toml", "fabric"]),
        ("type = \"measured\"\nfabric = \"linen\"", &["`linen`", "gray-interlock", "royal-target"]),
        ("type = \"measured\"\nfabric = 3", &["line 2, column 1", "integer `3`"]),
        ("type = \"measured\"\nfabric = ", &["line 2"]),
    ] {
        let said = says(table);
        for word in words {
            assert!(said.contains(word), "`{word}` is missing in: {said}");
        }
    }
    assert!(refusal(folder.path(), &["probe", "m.toml"]).contains("--gradients"));
    assert!(refusal(folder.path(), &["probe", "absent.toml", "--gradients", "f.json"]).contains("absent.toml"));
}

#[test]
fn fabrics_are_shown_as_table_json_and_curves() {
    let folder = folder();
    let facts = answer(folder.path(), &["show", "fabrics", "--json"]);
    let facts = facts.as_array().expect("an array");
    assert_eq!(facts.len(), 10);
    assert_eq!((&facts[5]["name"], &facts[5]["m"]), (&json!("gray-interlock"), &json!(6)));
    assert_close("gray", "k", &json!([41.64, 0.0, 109.84, 66.89]), &facts[5]["rest_stiffness_n_per_m"], 0.0, 0.005);
    let negative: u64 = facts.iter().map(|f| f["negative_entries"].as_u64().expect("a count")).sum();
    assert_eq!(negative, 20);

    let table = text(&caphy(folder.path(), &["show", "fabrics"]).stdout);
    assert!(facts.iter().all(|f| table.contains(f["name"].as_str().expect("a name"))), "{table}");
    assert!(table.contains("Wang"), "the source is named where the data is shown");

    let output = caphy(folder.path(), &["show", "fabrics", "--plot", "curves"]);
    assert!(output.status.success() && text(&output.stderr).contains("fabrics.html"));
    assert_eq!(std::fs::read_dir(folder.path().join("curves")).expect("a folder").count(), 21);
}

#[test]
fn every_command_has_help_with_an_example() {
    let folder = folder();
    for command in [&["run"][..], &["show", "fabrics"], &["probe"], &["check"]] {
        let help = text(&caphy(folder.path(), &[command, &["--help"]].concat()).stdout);
        assert!(help.contains("Example"), "{command:?}: {help}");
    }
}
