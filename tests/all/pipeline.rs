//! One tiny run is made once; what follows it happens in copies.

use crate::commands::text;
use crate::experiment::{Experiment, TINY, edited, files, header, value};
use caphy::config::Config;
use caphy::manifest::Manifest;
use caphy::measure::Fit;
use caphy::plugins::Plugins;
use caphy::runner::{Run, compare, replay};
use caphy::stage::Scans;
use caphy::stage::animate::Film;
use caphy::stage::evaluate::Scores;
use caphy::stage::export::Exported;
use caphy::stage::preprocess::Subject;
use caphy::stage::train::Nets;
use caphy_garment::template::GarmentKind;
use std::collections::BTreeSet;
use std::fs::File;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::OnceLock;
use std::time::{Duration, Instant};

/// All stages of [`TINY`], in order.
pub(crate) const STAGES: [&str; 10] = [
    "synth",
    "preprocess",
    "train",
    "optimise",
    "train-optimised",
    "finetune",
    "evaluate",
    "animate",
    "export",
    "report",
];

pub(crate) fn on_threads<T: Send>(threads: usize, work: impl FnOnce() -> T + Send) -> T {
    rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a thread pool").install(work)
}

/// The run folder of one uninterrupted run on two threads; nobody may change it.
pub(crate) fn finished() -> &'static Path {
    static FINISHED: OnceLock<(PathBuf, File)> = OnceLock::new();
    let (folder, _) = FINISHED.get_or_init(|| {
        let root = Path::new(env!("CARGO_TARGET_TMPDIR"));
        std::fs::create_dir_all(root).expect("cargo's folder for tests");
        // Another process that runs these tests is waited for: it holds the lock to its end.
        let lock = File::create(root.join("finished.lock")).expect("a lock file");
        lock.lock().expect("the lock");
        let folder = root.join("finished");
        if folder.exists() {
            std::fs::remove_dir_all(&folder).expect("the last run removed");
        }
        let experiment = Experiment::new(TINY);
        let run = Run::open(&experiment.config(), Some(folder.clone())).expect("an opened run");
        let started = Instant::now();
        let summary = on_threads(2, || run.all()).unwrap_or_else(|e| panic!("{e}"));
        println!("a tiny run takes {:.1} s", started.elapsed().as_secs_f64());
        assert_eq!(summary.ran, STAGES);
        (folder, lock)
    });
    folder
}

/// The start of a PNG as it stands in a data URL; 60 bytes hold its size, a checksum and the first data.
fn start_of_data_url(png: &[u8]) -> String {
    const DIGITS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let digits = png[..60].chunks(3).flat_map(|b| {
        let bits = u32::from_be_bytes([0, b[0], b[1], b[2]]);
        [18, 12, 6, 0].map(|shift| char::from(DIGITS[(bits >> shift) as usize & 63]))
    });
    format!("data:image/png;base64,{}", digits.collect::<String>())
}

#[test]
fn a_run_ends_with_a_report_that_holds_its_pictures() {
    let all = files(finished());
    let html = std::str::from_utf8(&all["report.html"]).expect("text");
    let pictures: Vec<_> = all.iter().filter(|(name, _)| name.starts_with("pictures/")).collect();
    assert!(pictures.len() >= 4, "{} pictures", pictures.len());
    for (name, png) in pictures {
        assert!(html.contains(&start_of_data_url(png)), "{name} is not in the report");
    }
    assert_self_contained(html);
    assert!(html.contains(&start_of_data_url(&all["truth/scans.png"])), "the subject is not in the report");
    for part in ["Warnings", "Limits that apply", "@keyframes", "VGG-16", "2 scans to learn from", "Colours"] {
        assert!(html.contains(part), "`{part}` is not in the report");
    }
    assert!(html.contains("<svg"), "the report has no curves");
    let config = std::str::from_utf8(&all["config.toml"]).expect("text");
    Config::parse(Path::new("config.toml"), config).unwrap_or_else(|e| panic!("{e}"));
}

/// Nothing is fetched: neither from the network nor from files beside the page.
pub(crate) fn assert_self_contained(html: &str) {
    // Pictures and plots hold none of these by chance: base64 has no quotes and no brackets.
    let attributes = ["src=", "href=", "url(", "srcset=", "data=", "action=", "poster=", "import "];
    for attribute in attributes {
        for (at, _) in html.match_indices(attribute) {
            // `data=` and the like within a word of base64 are no attributes.
            if attribute != "url(" && !html[..at].ends_with([' ', '@']) {
                continue;
            }
            let target = html[at + attribute.len()..].trim_start_matches(['"', '\'']);
            let shown: String = target.chars().take(60).collect();
            assert!(target.starts_with("data:image/"), "the page needs {attribute}{shown}");
        }
    }
    for tag in ["<script", "<link", "<iframe", "<base", "http:", "https:"] {
        assert!(!html.contains(tag), "the page has {tag}");
    }
}

/// Whether a browser without a window draws the page in full, with every picture. Skipped where there is none.
#[test]
fn a_browser_shows_the_report() {
    let names = ["chromium", "chromium-browser", "google-chrome", "headless_shell"];
    let path = std::env::var_os("PATH").unwrap_or_default();
    let found = std::env::split_paths(&path).flat_map(|folder| names.map(|n| folder.join(n))).find(|p| p.is_file());
    let Some(browser) = found else {
        use std::io::Write;
        // Straight to the terminal: what the print macros write is only shown for tests that fail.
        let _ = writeln!(std::io::stderr(), "SKIPPED: the report is not opened, there is no {}", names.join(", "));
        return;
    };
    let folder = tempfile::tempdir().expect("a temporary folder");
    // Alone in its folder: what it needs from elsewhere is not there.
    let page = folder.path().join("report.html");
    let mut html = std::fs::read_to_string(finished().join("report.html")).expect("the report");
    let count = "<p id=\"drawn\"></p><script>addEventListener('load',()=>{const all=[...document.images];\
                 document.getElementById('drawn').textContent='drawn '+all.filter(i=>i.complete&&i.naturalWidth>99).length+\
                 ' of '+all.length})</script>";
    html = html.replace("</html>", &format!("{count}</html>"));
    std::fs::write(&page, &html).expect("written");
    let profile = folder.path().join("profile");
    let output = Command::new(&browser)
        .args(["--headless", "--no-sandbox", "--disable-gpu", "--virtual-time-budget=20000", "--dump-dom"])
        .arg(format!("--user-data-dir={}", profile.display()))
        .arg(&page)
        .stderr(Stdio::null())
        .output()
        .expect("the browser starts");
    let drawn = String::from_utf8_lossy(&output.stdout).to_string();
    let pictures = html.matches("<img ").count();
    assert!(pictures >= 6 && drawn.contains(&format!("drawn {pictures} of {pictures}")), "{}", {
        let at = drawn.rfind("id=\"drawn\"").unwrap_or(0);
        drawn[at..].chars().take(80).collect::<String>()
    });
}

#[test]
fn the_avatar_is_exported() {
    let all = files(finished());
    let glb = &all["export/avatar.glb"];
    assert_eq!(&glb[..4], b"glTF");
    let word = |at: usize| u32::from_le_bytes(glb[at..at + 4].try_into().expect("four bytes")) as usize;
    assert_eq!((word(4), word(8)), (2, glb.len()));
    let scene: serde_json::Value = serde_json::from_slice(&glb[20..20 + word(12)]).expect("the JSON chunk");
    let meshes: Vec<_> = scene["meshes"].as_array().expect("meshes").iter().map(|m| &m["name"]).collect();
    assert_eq!(meshes, ["body", "upper", "lower"]);
    assert_eq!(scene["skins"].as_array().map(Vec::len), Some(1));
    assert_eq!(scene["animations"].as_array().map(Vec::len), Some(1));
    // In the scans' colours: upper and lower garment of a generated person differ.
    for mesh in scene["meshes"].as_array().expect("meshes") {
        assert!(mesh["primitives"][0]["attributes"]["COLOR_0"].is_u64(), "{} has no colours", mesh["name"]);
    }
    let mean = |part: &str| {
        let name = format!("export/{part}.ply");
        let scan = caphy_formats::ply::read_ply(Path::new(&name), &all[&name]).expect("a PLY");
        let colours = scan.colours.expect("colours");
        assert_eq!(colours.len(), scan.mesh.vertices.len());
        [0, 1, 2].map(|k| colours.iter().map(|c| f64::from(c[k])).sum::<f64>() / colours.len() as f64)
    };
    let (upper, lower) = (mean("upper"), mean("lower"));
    let apart: f64 = (0..3).map(|k| (upper[k] - lower[k]).powi(2)).sum::<f64>().sqrt();
    assert!(apart > 30.0, "{upper:?} {lower:?}");
    let exported: Exported = value(finished(), "export");
    assert!(exported.coloured.iter().all(|(_, share)| *share > 0.3), "{:?}", exported.coloured);

    // 1 s at 30 fps are 31 frames, every fifth from the first on as OBJ.
    for part in ["body", "upper", "lower"] {
        let name = |n: &String| n.starts_with(&format!("export/obj/{part}_")) && n.ends_with(".obj");
        assert_eq!(all.keys().filter(|n| name(n)).count(), 7, "OBJ files of {part}");
    }
    let film: Film = value(finished(), "animate");
    assert_eq!(film.clip.poses.len(), 31);
    for garment in &film.garments {
        let path = format!("export/obj/{}_00005.obj", garment.kind);
        let mesh = caphy_formats::obj::read_obj(Path::new(&path), &all[&path]).expect("an OBJ").scan.mesh;
        let shown = garment.vertices(5);
        assert_eq!(mesh.vertices.len(), shown.len());
        for (a, b) in mesh.vertices.iter().zip(&shown) {
            assert!((a - b).norm() < 1e-5, "{path}: {a} is not {b}");
        }
        // Nothing flies away: a person with stretched arms fits into a cube of 2.5 m around the pelvis.
        for (frame, positions) in garment.frames.iter().enumerate() {
            let pelvis = film.clip.poses[frame].translation;
            for p in positions {
                let from_pelvis = [0, 1, 2].map(|k| f64::from(p[k]) - pelvis[k]);
                assert!(from_pelvis.iter().all(|d| d.abs() < 1.25), "{} in frame {frame}: {p:?}", garment.kind);
            }
        }
    }
    let nets: Nets = value(finished(), "finetune");
    for garment in &nets.garments {
        let bytes = &all[&format!("export/{}.safetensors", garment.kind)];
        let length = u64::from_le_bytes(bytes[..8].try_into().expect("eight bytes")) as usize;
        assert_eq!(bytes.len(), 8 + length + 4 * garment.parameters.len());
        let described: serde_json::Value = serde_json::from_slice(&bytes[8..8 + length]).expect("a header");
        assert_eq!(described["__metadata__"]["garment"], garment.kind.to_string());
    }
}

#[test]
fn what_was_fitted_is_near_the_truth() {
    let scores: Scores = value(finished(), "evaluate");
    assert_eq!(scores.scans.iter().filter(|s| s.held_out).count(), 1);
    for scan in &scores.scans {
        // The requirements on stand-in scans; a generated subject with stored labels must meet them all the more.
        let [median, _] = scan.joint_error_mm.expect("the truth is known");
        assert!(median <= 30.0, "{}: joints {median} mm off", scan.name);
        let agreement = scan.label_agreement.expect("labels are stored");
        assert!(agreement >= 0.95, "{}: {agreement} of the labels", scan.name);
        assert_eq!(scan.garments.len(), 2);
        for garment in &scan.garments {
            // Vertices are 5 cm apart: a point on a well-placed triangle is up to 29 mm from the nearest corner.
            assert!(garment.net.scan_to_garment_mm < 40.0, "{}: {garment:?}", scan.name);
            // The scan lies on the true garment, but for noise of half a millimetre; nothing is nearer than that.
            let truth = garment.truth.as_ref().expect("the truth is known");
            assert!(truth.scan_to_garment_mm < 1.0 && truth.scan_to_garment_mm < garment.net.scan_to_garment_mm);
            assert!(truth.normal_map < garment.net.normal_map && truth.ms_ssim < garment.net.ms_ssim, "{garment:?}");
            // A mean square is never below the squared mean.
            let Fit { scan_to_garment_mm: mean, scan_to_garment_mm2: square, .. } = garment.net;
            assert!(square >= mean * mean, "{garment:?}");
            assert!(garment.solver.is_none(), "not asked for");
            // Two scans are learnt from: each has the other one.
            assert!(garment.nearest_scan_deg.is_some_and(|a| a > 0.0 && a < 180.0), "{garment:?}");
            assert!(garment.nearest_motion_deg.is_some_and(|a| a > 0.0 && a < 180.0), "{garment:?}");
        }
    }
    assert_eq!(scores.fabrics.len(), 2);
}

#[test]
fn templates_are_worn_before_they_are_chosen() {
    let fabric = "fabric = \"navy-sparkle-sweat\" }\nstyles = 6\nworn = ";
    let experiment = Experiment::copy_of(finished(), &edited(TINY, &[(&format!("{fabric}0"), &format!("{fabric}2"))]));
    let run = Run::open(&experiment.config(), Some(experiment.out())).unwrap_or_else(|e| panic!("{e}"));
    run.only("preprocess").and_then(|run| run.all()).unwrap_or_else(|e| panic!("{e}"));
    let [bare, worn] = [finished(), &experiment.out()].map(|out| value::<Subject>(out, "preprocess"));
    let scans: Scans = value(&experiment.out(), "synth");
    let truth = scans.truth.expect("the truth is known");
    for (k, kind) in [(0, GarmentKind::Upper), (1, GarmentKind::Lower)] {
        assert!(bare.choices[k].kind == kind && worn.choices[k].kind == kind);
    }
    // The upper garment was worn, the lower one, under it, was not.
    let errors = [&bare, &worn].map(|s| s.choices[0].measures.against(&truth.garments[0].measures));
    assert!(worn.choices[0].edges_off_mm > 0.0);
    assert_eq!(worn.choices[1].measures, bare.choices[1].measures);
    assert_ne!(worn.choices[0].measures, bare.choices[0].measures, "wearing changes what is found");
    // As exact as a pose that was fitted in eight steps to 300 points allows: the edge length of the template.
    assert!(errors[1].largest_m() < 0.05, "{:?}", errors[1]);
}

#[test]
fn a_second_run_does_nothing() {
    let experiment = Experiment::copy_of(finished(), TINY);
    let mut before = files(&experiment.out());
    let summary = experiment.run();
    assert!(summary.ran.is_empty(), "ran {:?}", summary.ran);
    assert!(summary.table.contains("scan-02 (held out)"), "{}", summary.table);
    let mut after = files(&experiment.out());
    // The copy's configuration lies elsewhere, and nothing else is new.
    let (old, new) = (before.remove("run.json"), after.remove("run.json"));
    let manifest =
        |bytes: Option<Vec<u8>>| -> Manifest { serde_json::from_slice(&bytes.expect("run.json")).expect("JSON") };
    let (old, new) = (manifest(old), manifest(new));
    assert_ne!(old.base, new.base);
    assert_eq!(Manifest { base: old.base.clone(), ..new }, old);
    assert!(after == before, "files changed");
    assert!(old.stages.keys().map(String::as_str).collect::<BTreeSet<_>>() == STAGES.into(), "{:?}", old.stages);
    assert!(
        old.inputs.keys().map(String::as_str).eq(["scan scan-00", "scan scan-01", "scan scan-02"]),
        "{:?}",
        old.inputs
    );
    // Unless it is told to.
    let again = |run: Run| run.from("export")?.until("export")?.all();
    let summary = Run::open(&experiment.config(), Some(experiment.out())).and_then(again);
    assert_eq!(summary.unwrap_or_else(|e| panic!("{e}")).ran, ["export"]);
    let export = &files(&experiment.out())["export.caphy"];
    assert!(export == &before["export.caphy"], "exported again with other bits");
}

/// Asks for times, and finds them for these stages, with nothing left behind.
fn assert_times_of(experiment: &Experiment, stages: &[&str], there: &[String]) {
    let output =
        program(experiment).args(["--plan", "--time"]).stdout(Stdio::piped()).output().expect("the program ends");
    let said = text(&output.stdout);
    assert!(output.status.success(), "{said}{}", text(&output.stderr));
    for stage in stages {
        let line =
            said.lines().find(|line| line.trim_start().starts_with(&format!("{stage} "))).expect("a line per stage");
        assert!(line.contains("to run, about "), "{line}");
    }
    assert!(said.contains("Time: about ") && said.contains("tried on 2 scans"), "{said}");
    assert!(files(&experiment.out()).keys().eq(there), "{:?}", files(&experiment.out()).keys());
}

#[test]
fn a_plan_tells_how_long_stages_will_take() {
    let experiment = Experiment::copy_of(finished(), TINY);
    for stage in ["train", "evaluate"] {
        std::fs::remove_file(experiment.out().join(format!("{stage}.caphy"))).expect("an artifact");
    }
    let there: Vec<String> = files(&experiment.out()).into_keys().collect();
    // What comes after a stage that is not done is not known to be done.
    assert_times_of(&experiment, &["train", "train-optimised", "finetune", "evaluate", "animate", "export"], &there);
}

#[test]
#[ignore = "the same with scans and templates to be made: three times as long"]
fn a_plan_tells_how_long_all_stages_will_take() {
    let all: Vec<&str> = STAGES.into_iter().filter(|stage| *stage != "report").collect();
    assert_times_of(&Experiment::new(TINY), &all, &["config.toml".into(), "lock".into()]);
}

#[test]
fn settings_take_the_place_of_the_files_own() {
    let experiment = Experiment::copy_of(finished(), &edited(TINY, &[("out = \"out\"", "out = \"../run/out\"")]));
    let above = experiment.folder.path().join("run");
    std::fs::create_dir(&above).expect("a folder");
    std::fs::rename(experiment.out(), above.join("out")).expect("moved");
    std::fs::create_dir(experiment.folder.path().join("configs")).expect("a folder");
    std::fs::rename(experiment.config(), experiment.folder.path().join("configs/experiment.toml")).expect("moved");
    let run = |more: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_caphy"));
        command.current_dir(experiment.folder.path()).args(["run", "configs/experiment.toml"]).args(more);
        let output = command.output().expect("the program ends");
        (output.status.success(), text(&output.stdout) + &text(&output.stderr))
    };
    let (ended, said) = run(&["--set", "evaluate.penetration_m=1e-2", "--set", "animate.clip.seed = 12"]);
    assert!(ended && said.contains("Ran evaluate, animate, export, report"), "{said}");
    // Where the report lies is said without detours.
    assert!(said.contains("Report: run/out/report.html\n"), "{said}");
    let manifest = Manifest::read(&above.join("out")).unwrap_or_else(|e| panic!("{e}"));
    assert_eq!(manifest.set, ["evaluate.penetration_m=0.01", "animate.clip.seed=12"]);
    let resolved = Config::read(&above.join("out/config.toml")).unwrap_or_else(|e| panic!("{e}"));
    assert_eq!(resolved.evaluate.penetration_m, 1e-2);

    for (setting, words) in [
        ("train.roundz=3", ["--set train.roundz=3", "rounds"]),
        ("train.rounds=many", ["--set train.rounds=\"many\"", "invalid type"]),
        ("upper.material.fabric=silk", ["--set upper.material.fabric=\"silk\"", "gray-interlock"]),
        ("train.batch=17", ["--set train.batch=17", "give 1 to 16"]),
        ("upper.style=[0.5]", ["--set upper.style=[0.5]", "found from the scans"]),
    ] {
        // Beside one that is right.
        let (ended, said) = run(&["--set", "train.rounds=3", "--set", setting]);
        assert!(!ended && words.iter().all(|w| said.contains(w)), "{setting}: {said}");
    }
    // Two runs beside each other.
    let between = compare([finished(), &above.join("out")]).unwrap_or_else(|e| panic!("{e}"));
    let keys: Vec<&str> = between.config.iter().map(|c| c.name.as_str()).collect();
    assert_eq!(keys, ["animate.clip.seed", "evaluate.penetration_m"]);
    // What penetrates is counted while the clip is played, too.
    let stages: Vec<&str> = between.stages.iter().map(|c| c.name.as_str()).collect();
    assert_eq!(stages, ["animate", "evaluate"]);
    assert!(between.data.is_empty() && between.code.is_some(), "the tests are another program");
    let name = "upper, held out: scan → surface, mm";
    let row = between.results.iter().find(|r| r.name == name).expect("a mean");
    assert!(row.first.is_some() && row.first == row.second);
    let said = between.text();
    for word in ["animate.clip.seed: 11 → 12", "Data: the same", name, "+0.0 %"] {
        assert!(said.contains(word), "{word} is missing in {said}");
    }
}

#[test]
fn a_lost_file_runs_its_stage_alone() {
    let experiment = Experiment::copy_of(finished(), TINY);
    let lose = |name: &str| std::fs::remove_file(experiment.out().join(name)).expect(name);
    for (file, stage) in [
        ("pictures/templates.png", "preprocess"),
        ("pictures/strip.png", "animate"),
        ("export/obj/upper_00010.obj", "export"),
        ("evaluate.caphy", "evaluate"),
        ("report.html", "report"),
    ] {
        lose(file);
        // The stage makes the same bits again, so that nothing after it is out of date.
        assert_eq!(experiment.run().ran, [stage], "after {file} was lost");
    }
    let (old, new) = (files(finished()), files(&experiment.out()));
    for name in ["pictures/templates.png", "pictures/strip.png", "export/obj/upper_00010.obj", "evaluate.caphy"] {
        assert!(old[name] == new[name], "{name} came back with other bits");
    }
}

#[test]
fn a_run_folder_can_be_moved() {
    let experiment = Experiment::copy_of(finished(), TINY);
    std::fs::remove_file(experiment.out().join("scans/scan-01.ply")).expect("a scan");
    assert_eq!(experiment.run().ran, ["synth"], "another folder's scans are not this one's");
    // Relative paths mean the same folder.
    let output = Command::new(env!("CARGO_BIN_EXE_caphy"))
        .current_dir(experiment.folder.path())
        .args(["run", "experiment.toml"])
        .output()
        .expect("the program ends");
    let said = String::from_utf8_lossy(&output.stdout);
    assert!(said.contains("Nothing to do"), "{said}{}", String::from_utf8_lossy(&output.stderr));
}

#[test]
fn a_changed_section_runs_what_depends_on_it() {
    let config = edited(TINY, &[("seed = 11 }", "seed = 12 }")]);
    let experiment = Experiment::copy_of(finished(), &config);
    assert_eq!(experiment.run().ran, ["animate", "export", "report"]);
    // The limit of penetrations is counted against while playing, too.
    let config = edited(&config, &[("[animate]", "[evaluate]\npenetration_m = 1e-2\n\n[animate]")]);
    experiment.configure(&config);
    assert_eq!(experiment.run().ran, ["evaluate", "animate", "export", "report"]);
    experiment.configure(&edited(&config, &[("epochs = 6", "epochs = 2")]));
    assert_eq!(experiment.run().ran, ["finetune", "evaluate", "animate", "export", "report"]);
}

#[test]
fn another_fabric_keeps_the_fitted_body() {
    let experiment = Experiment::copy_of(finished(), &edited(TINY, &[("navy-sparkle-sweat", "ivory-rib-knit")]));
    let ran = experiment.run_until("train-optimised").ran;
    assert_eq!(ran, STAGES[2..5]);
}

#[test]
fn a_replay_on_one_thread_gives_the_same_bits_as_two() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let out = folder.path().join("again");
    let mut plugins = Plugins::new().expect("the linked types");
    let replayed = on_threads(1, || replay(finished(), Some(out.clone()), &mut plugins));
    let replayed = replayed.unwrap_or_else(|e| panic!("{e}"));
    assert_eq!(replayed.summary.ran, STAGES);
    assert!(replayed.is_same(), "{}", replayed.text());
    assert!(replayed.text().contains("The same bits in 9 of 9 stages"), "{}", replayed.text());
    assert_same_results(&out);
    // What was tampered with is named; nothing is run again for that.
    let copy = Experiment::copy_of(finished(), TINY);
    damage(&copy.out().join("scans/scan-01.ply"));
    std::fs::write(copy.out().join("pictures/new.png"), b"new").expect("written");
    let mut plugins = Plugins::new().expect("the linked types");
    let changed = replay(&copy.out(), Some(out.clone()), &mut plugins).unwrap_or_else(|e| panic!("{e}"));
    assert!(changed.summary.ran.is_empty() && !changed.is_same());
    assert_eq!(changed.files, ["pictures/new.png", "scans/scan-01.ply"]);
    let mut plugins = Plugins::new().expect("the linked types");
    let itself = replay(&out, Some(out.clone()), &mut plugins).expect_err("no replay into itself").to_string();
    assert!(itself.contains("is the run itself"), "{itself}");
}

/// Artifacts and files of a run against those of the uninterrupted run on two threads.
pub(crate) fn assert_same_results(out: &Path) {
    let (expected, got) = (files(finished()), files(out));
    for stage in STAGES {
        let name = format!("{stage}.caphy");
        let content = |folder: &Path| header(&folder.join(&name)).content;
        assert_eq!(content(out), content(finished()), "{name}");
        assert!(got[&name] == expected[&name], "{name} has other bits");
    }
    // The report also tells times.
    let folders = ["scans/", "truth/", "pictures/", "export/"];
    let results = |name: &&String| folders.iter().any(|folder| name.starts_with(folder));
    assert!(got.keys().filter(results).eq(expected.keys().filter(results)), "other files");
    for name in expected.keys().filter(results) {
        assert!(got[name] == expected[name], "{name} has other bits");
    }
}

/// The program on an experiment.
pub(crate) fn program(experiment: &Experiment) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_caphy"));
    command.arg("run").arg(experiment.config()).arg("--out").arg(experiment.out());
    command.stdin(Stdio::null()).stdout(Stdio::null());
    command
}

/// Runs the program and kills it as soon as a checkpoint is there; tells whether it was killed before its stage was done.
pub(crate) fn killed_at(experiment: &Experiment, checkpoint: &str, stage: &str) -> bool {
    let checkpoint = experiment.out().join(checkpoint);
    let mut child = program(experiment).stderr(Stdio::null()).spawn().expect("the program starts");
    let started = Instant::now();
    while !checkpoint.exists() {
        assert!(started.elapsed() < Duration::from_secs(120), "no {} in two minutes", checkpoint.display());
        if child.try_wait().expect("a child").is_some() {
            return false;
        }
        std::thread::sleep(Duration::from_millis(1));
    }
    child.kill().expect("killed");
    child.wait().expect("a child");
    checkpoint.exists() && !experiment.out().join(format!("{stage}.caphy")).exists()
}

#[test]
fn a_killed_run_goes_on_to_the_same_bits() {
    // A busy machine may let a stage finish between two looks: then there is nothing to go on from, and it is done again.
    let mut attempts = 0;
    let experiment = loop {
        let experiment = Experiment::new(TINY);
        if killed_at(&experiment, "checkpoint-upper.caphy", "train") {
            break experiment;
        }
        attempts += 1;
        assert!(attempts < 5, "training was never caught at a checkpoint");
    };
    // What a crash while writing leaves behind.
    std::fs::write(experiment.out().join("checkpoint-upper.caphy.tmp"), b"half a checkpoint").expect("written");
    std::fs::write(experiment.out().join("train.caphy.tmp"), b"half an artifact").expect("written");

    // A damaged checkpoint is never gone on from.
    let damaged = Experiment::copy_of(&experiment.out(), TINY);
    damage(&damaged.out().join("checkpoint-upper.caphy"));
    let text = damaged.error();
    assert!(text.contains("checkpoint-upper.caphy") && text.contains("delete the file"), "{text}");

    if !killed_at(&experiment, "checkpoint-finetune.caphy", "finetune") {
        println!("fine-tuning was not caught at a checkpoint; only training was interrupted");
    }
    let output = program(&experiment).stderr(Stdio::piped()).output().expect("the program ends");
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{said}");
    assert_same_results(&experiment.out());
    let left: Vec<String> = files(&experiment.out())
        .into_keys()
        .filter(|n| n.starts_with("checkpoint-") && n.ends_with(".caphy"))
        .collect();
    assert!(left.is_empty(), "checkpoints of finished stages: {left:?}");
}

#[test]
fn training_says_where_it_goes_on() {
    let mut attempts = 0;
    loop {
        // Everything before training is taken over, so that only training is interrupted.
        let experiment = Experiment::copy_of(finished(), TINY);
        for stage in ["train", "optimise", "train-optimised", "finetune"] {
            std::fs::remove_file(experiment.out().join(format!("{stage}.caphy"))).expect("an artifact");
        }
        if killed_at(&experiment, "checkpoint-lower.caphy", "train") {
            let output = program(&experiment).stderr(Stdio::piped()).output().expect("the program ends");
            let said = String::from_utf8_lossy(&output.stderr);
            assert!(said.contains("lower: going on from step "), "{said}");
            // The stages behind it find their results still valid.
            assert!(!said.contains("evaluate started"), "{said}");
            assert_same_results(&experiment.out());
            return;
        }
        attempts += 1;
        assert!(attempts < 5, "training was never caught at a checkpoint");
    }
}

#[test]
fn a_folder_in_use_is_refused() {
    let experiment = Experiment::new(TINY);
    let first = Run::open(&experiment.config(), Some(experiment.out())).unwrap_or_else(|e| panic!("{e}"));
    let text = experiment.error();
    assert!(text.contains("in use by another run"), "{text}");
    assert!(text.contains(&experiment.out().display().to_string()), "{text}");
    // The same from another process.
    let output = program(&experiment).stderr(Stdio::piped()).output().expect("the program ends");
    assert!(!output.status.success());
    assert!(String::from_utf8_lossy(&output.stderr).contains("another run"));
    drop(first);
    Run::open(&experiment.config(), Some(experiment.out())).unwrap_or_else(|e| panic!("{e}"));
}

/// Flips one bit in the middle of a file.
pub(crate) fn damage(path: &Path) {
    let mut bytes = std::fs::read(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    std::fs::write(path, bytes).expect("written");
}

#[test]
fn a_damaged_artifact_is_named_and_can_be_made_again() {
    let experiment = Experiment::copy_of(finished(), TINY);
    let path = experiment.out().join("train.caphy");
    let sound = std::fs::read(&path).expect("an artifact");
    let expect_error = |what: &str| {
        let text = experiment.error();
        assert!(text.contains("train.caphy") && text.contains("delete the file"), "{what}: {text}");
    };
    damage(&path);
    expect_error("one bit");
    for (what, length) in [("cut off", sound.len() / 2), ("without a body", 100), ("empty", 0)] {
        std::fs::write(&path, &sound[..length]).expect("written");
        expect_error(what);
    }
    std::fs::write(&path, b"something else\nentirely").expect("written");
    expect_error("another file");
    std::fs::remove_file(&path).expect("removed");
    assert_eq!(experiment.run().ran, ["train"]);
    assert!(std::fs::read(&path).expect("an artifact") == sound, "train.caphy came back with other bits");
}

/// The solver in place of nets: only what is animated is made again.
#[test]
fn what_is_animated_can_be_simulated() {
    let clip = "clip = { type = \"procedural\", kind = \"walk\", seconds = 1, seed = 11 }";
    let config = edited(TINY, &[(clip, &format!("{clip}\nseconds = 0.2\nsolver = {{}}"))]);
    let experiment = Experiment::copy_of(finished(), &config);
    assert_eq!(experiment.run().ran, ["animate", "export", "report"]);
    let (out, [simulated, played]) =
        (experiment.out(), [&experiment.out(), finished()].map(|o| value::<Film>(o, "animate")));
    for (a, b) in simulated.garments.iter().zip(&played.garments) {
        assert_eq!(a.frames.len(), 7);
        let apart = |f: usize| {
            let all = a.vertices(f).iter().zip(b.vertices(f)).map(|(p, q)| (p - q).norm()).collect::<Vec<_>>();
            all.iter().sum::<f64>() / all.len() as f64
        };
        // The same person at the same time, in clothes that hang otherwise.
        let apart = (0..7).map(apart).fold(f64::INFINITY, f64::min);
        assert!(apart > 1e-4 && apart < 0.1, "{apart}");
    }
    // At rest on a body that it can rest on: what training comes to in three rounds is worse.
    assert!(simulated.garments.iter().all(|g| g.penetrating < 0.05), "{simulated:?}");
    let page = std::fs::read_to_string(out.join("report.html")).unwrap();
    assert!(page.contains("Simulated by the reference solver, forces down to 1e-2 N"));
    let wrong = config.replace("solver = {}", "solver = { tolerance_n = 0 }");
    experiment.configure(&wrong);
    assert!(experiment.error().contains("animate.solver.tolerance_n"));
}
