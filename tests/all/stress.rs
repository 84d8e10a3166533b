//! `caphy stress`: maps of linked and loaded fabrics, and a verdict.

use crate::commands::{caphy, refusal, text};
use crate::plugins::woven;

#[test]
fn an_atlas_of_linked_and_loaded_fabrics() {
    let folder = tempfile::tempdir().expect("a folder");
    let stvk = "type = \"stvk\"\nyoung_pa = 0.7e5\npoisson = 0.485\nthickness_m = 4.7e-4\n";
    std::fs::write(folder.path().join("stvk.toml"), stvk).expect("a file");
    std::fs::write(folder.path().join("mine.toml"), "type = \"woven\"\n").expect("a file");
    let library = woven().to_str().expect("UTF-8");
    for (material, plugin) in [("stvk.toml", None), ("gray-interlock", None), ("mine.toml", Some(library))] {
        let mut arguments = vec!["stress", "--material", material, "--states", "2000", "--out", "atlas"];
        arguments.extend(plugin.iter().flat_map(|p| ["--plugin", *p]));
        let output = caphy(folder.path(), &arguments);
        let table = text(&output.stdout);
        assert!(output.status.success(), "{table}{}", text(&output.stderr));
        assert!(table.contains("f32") && table.contains("2000 random states, 0 not finite"), "{table}");
        let read = |name: &str| std::fs::read_to_string(folder.path().join("atlas").join(name)).expect("a file");
        let json: serde_json::Value = serde_json::from_str(&read("stress.json")).expect("JSON");
        let atlas = &json["atlases"][0];
        assert_eq!(atlas["material"], material);
        for precision in ["single", "double"] {
            let membrane = &atlas[precision]["membrane"];
            let (stretches, map) = (membrane["stretches"].as_array(), membrane["map"].as_array());
            assert_eq!(stretches.expect("stretches").len(), map.expect("a map").len());
            assert_eq!(membrane["summary"]["finite"], 1.0);
            assert_eq!(membrane["summary"]["gradient"], 1.0);
        }
        assert!(read("stress.html").matches("<svg").count() == 4 && read("stress.txt").contains(material));
        assert!(read(&format!("{material}-f64-strains.svg")).contains("xmlns"));
    }
    assert!(refusal(folder.path(), &["stress", "--material", "tweed"]).contains("gray-interlock"));
}
