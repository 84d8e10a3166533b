//! A full disk, a folder that may not be written, damaged and edited files, two runs in one folder: clear errors, nothing lost.

use crate::commands::text;
use crate::experiment::{Experiment, TINY, edited, files};
use crate::pipeline::{STAGES, assert_same_results, damage, finished, program};
use std::collections::BTreeMap;
use std::ffi::OsStr;
use std::io::Write;
use std::path::Path;
use std::process::{Command, Output, Stdio};

/// The tiny run without the artifacts of some stages.
fn without(stages: &[&str]) -> Experiment {
    let experiment = Experiment::copy_of(finished(), TINY);
    for stage in stages {
        std::fs::remove_file(experiment.out().join(format!("{stage}.caphy"))).expect("an artifact");
    }
    experiment
}

/// The program on an experiment, started by a shell that prepares its surroundings; `$@` is the program.
fn prepared(experiment: &Experiment, shell: &[&str], script: &str, variables: &[(&str, &OsStr)]) -> Output {
    let program = program(experiment);
    let mut command = Command::new(shell[0]);
    command.args(&shell[1..]).args(["sh", "-c", script, "sh"]).arg(program.get_program()).args(program.get_args());
    command.env("OUT", experiment.out()).envs(variables.iter().copied()).stdin(Stdio::null());
    command.output().expect("a shell")
}

/// Whether this system lets anybody mount in a space of their own; says so where it does not.
fn mounts(what: &str) -> bool {
    let can = Command::new("unshare").args(["-Urm", "mount", "-t", "tmpfs", "none", "/tmp"]).output();
    let can = can.is_ok_and(|output| output.status.success());
    if !can {
        // Straight to the terminal: what the print macros write is only shown for tests that fail.
        let _ = writeln!(std::io::stderr(), "SKIPPED: {what}: this system lets nobody mount (unshare -Urm)");
    }
    can
}

/// What a run failed with, in words; a panic is no error.
fn refused(output: &Output, words: &[&str]) -> String {
    let said = text(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{said}");
    let last = said.lines().last().unwrap_or_default();
    assert!(last.starts_with("error: ") && words.iter().all(|word| last.contains(word)), "{words:?} in {said}");
    last.to_string()
}

/// Nothing that was there has other bits; what a stage records while it runs, and the list of results, may have changed.
fn assert_kept(before: &BTreeMap<String, Vec<u8>>, out: &Path, what: &str) {
    let after = files(out);
    let growing = |name: &str| ["metrics-", "tensorboard/", "previews/"].iter().any(|start| name.starts_with(start));
    for (name, bytes) in before.iter().filter(|(name, _)| !growing(name) && *name != "run.json") {
        assert!(after.get(name) == Some(bytes), "{what}: {name} has other bits, or is gone");
    }
    let halves: Vec<&String> = after.keys().filter(|name| name.ends_with(".tmp")).collect();
    assert!(halves.is_empty(), "{what}: half written: {halves:?}");
}

/// Where a file may not become longer: the write fails in its middle. The limit is a share of the artifact that is missing.
#[test]
fn a_limit_of_file_sizes_ends_in_an_error_and_nothing_is_lost() {
    for (stages, share, names) in
        [(["train"], 0.3, "checkpoint-upper.caphy"), (["export"], 0.0, "pictures/colours.png")]
    {
        let experiment = without(&stages);
        let before = files(&experiment.out());
        let artifact = std::fs::metadata(finished().join(format!("{}.caphy", stages[0]))).expect("an artifact").len();
        // POSIX counts in blocks of 512 bytes. A process that does not ignore the signal would be killed by it.
        let blocks = ((share * artifact as f64) as u64 / 512).to_string();
        let script = "trap '' XFSZ; ulimit -f \"$BLOCKS\"; exec \"$@\"";
        let output = prepared(&experiment, &["env"], script, &[("BLOCKS", blocks.as_ref())]);
        let what = format!("{stages:?} with files of {blocks} blocks");
        refused(&output, &[names, "cannot write", "ulimit -f", "run again"]);
        assert_kept(&before, &experiment.out(), &what);
        assert_eq!(experiment.run().ran, stages, "{what}");
        assert_same_results(&experiment.out());
    }
}

/// A disk of its own, with so much room beside what is there already. The shell takes what is on it to `KEPT` before it goes.
#[test]
fn a_full_disk_ends_in_an_error_and_nothing_is_lost() {
    if !mounts("a full disk") {
        return;
    }
    for (stages, room) in [(["train"], 300 << 10), (["export"], 40 << 10)] {
        let experiment = without(&stages);
        let before = files(&experiment.out());
        // Files take whole pages.
        let pages: u64 = before.values().map(|bytes| bytes.len().div_ceil(4096) as u64).sum();
        let (size, kept) = ((4096 * pages + room).to_string(), experiment.folder.path().join("kept"));
        let script = "mkdir \"$KEPT\" && cp -R \"$OUT\" \"$KEPT\"/before && mount -t tmpfs -o size=\"$SIZE\" none \"$OUT\" && \
                      cp -R \"$KEPT\"/before/. \"$OUT\" || exit 9; \"$@\"; code=$?; cp -R \"$OUT\" \"$KEPT\"/after; exit $code";
        let variables = [("SIZE", size.as_ref()), ("KEPT", kept.as_os_str())];
        let output = prepared(&experiment, &["unshare", "-Urm"], script, &variables);
        let what = format!("{stages:?} with {room} bytes of room");
        let out = experiment.out().display().to_string();
        refused(&output, &[&out, "cannot write", "free some space", "what was finished is kept"]);
        assert_kept(&before, &kept.join("after"), &what);
        // On a larger disk it goes on.
        let larger = Experiment::copy_of(&kept.join("after"), TINY);
        assert_eq!(larger.run().ran, stages, "{what}");
        assert_same_results(&larger.out());
    }
}

#[test]
fn a_folder_that_may_not_be_written_is_named() {
    // Root writes where permissions forbid it, but not on what is mounted for reading only, nor below a file.
    let experiment = without(&["export"]);
    let before = files(&experiment.out());
    if mounts("a folder that may not be written") {
        let script = "mount --bind \"$OUT\" \"$OUT\" && mount -o remount,bind,ro \"$OUT\" || exit 9; exec \"$@\"";
        let output = prepared(&experiment, &["unshare", "-Urm"], script, &[]);
        let out = experiment.out().display().to_string();
        refused(&output, &[&out, "Read-only file system", "allow it, or name another place"]);
        assert!(files(&experiment.out()) == before, "files changed");
    }
    let pictures = experiment.out().join("export");
    std::fs::rename(&pictures, experiment.folder.path().join("away")).expect("moved");
    std::fs::write(&pictures, b"a file in the way").expect("written");
    let said = experiment.error();
    assert!(said.contains(&pictures.display().to_string()) && said.contains("cannot create"), "{said}");
    std::fs::remove_file(&pictures).expect("removed");
    assert_eq!(experiment.run().ran, ["export"]);
    assert_same_results(&experiment.out());
}

/// A folder where an artifact's temporary file must be stops a stage at its end: its checkpoints stay.
fn with_damaged_checkpoints(stage: &'static str, checkpoints: &[&str]) {
    let experiment = without(&[stage]);
    let way = experiment.out().join(format!("{stage}.caphy.tmp"));
    std::fs::create_dir(&way).expect("a folder");
    let said = experiment.error();
    assert!(said.contains(&format!("{stage}.caphy")) && said.contains("cannot write"), "{said}");
    std::fs::remove_dir(&way).expect("removed");
    let before = files(&experiment.out());
    for name in checkpoints {
        let path = experiment.out().join(name);
        damage(&path);
        let said = experiment.error();
        assert!(said.contains(name) && said.contains("damaged or edited"), "{said}");
        assert!(said.contains("delete the file"), "{said}");
        // As it was, for the next one.
        std::fs::write(&path, &before[*name]).expect("written");
        assert_kept(&before, &experiment.out(), name);
    }
    // One is deleted as the error says, the others are gone on from.
    std::fs::remove_file(experiment.out().join(checkpoints[0])).expect("removed");
    assert_eq!(experiment.run().ran, [stage]);
    assert_same_results(&experiment.out());
}

#[test]
fn a_damaged_checkpoint_is_named_and_the_stage_comes_to_the_same_bits_without_it() {
    with_damaged_checkpoints("finetune", &["checkpoint-finetune.caphy"]);
}

#[test]
#[ignore = "the same of the other stages with checkpoints"]
fn damaged_checkpoints_of_scans_and_of_training() {
    with_damaged_checkpoints("synth", &["checkpoint-synth-scan-00.caphy", "checkpoint-synth-scan-02.caphy"]);
    with_damaged_checkpoints("train", &["checkpoint-upper.caphy", "checkpoint-lower.caphy"]);
}

#[test]
fn edited_results_are_named_and_nothing_is_made_of_them() {
    let experiment = Experiment::copy_of(finished(), TINY);
    let before = files(&experiment.out());
    let results = STAGES.map(|stage| format!("{stage}.caphy"));
    for name in results.iter().map(String::as_str).chain(["scans/scan-01.ply"]) {
        let path = experiment.out().join(name);
        // What a stage made stands at the end; before it, the key, without which the stage would just run again.
        let mut edited = before[name].clone();
        *edited.last_mut().expect("a body") ^= 1;
        std::fs::write(&path, edited).expect("written");
        let said = experiment.error();
        assert!(
            said.contains(name) && said.contains("damaged or edited") && said.contains("delete the file"),
            "{said}"
        );
        std::fs::write(&path, &before[name]).expect("written");
        assert_kept(&before, &experiment.out(), name);
    }
    // Files that only tell about a run are written again.
    for name in ["run.json", "timings.json", "config.toml"] {
        std::fs::write(experiment.out().join(name), b"{").expect("written");
    }
    assert!(experiment.run().ran.is_empty());
    assert_same_results(&experiment.out());
}

#[test]
fn a_run_that_is_refused_its_folder_changes_nothing_there() {
    let experiment = Experiment::copy_of(finished(), TINY);
    let held = caphy::runner::Run::open(&experiment.config(), Some(experiment.out())).expect("an opened run");
    let before = files(&experiment.out());
    let other = Experiment::new(&edited(TINY, &[("rounds = 3", "rounds = 4")]));
    for more in [&[][..], &["--plan"], &["--only", "train"], &["--from", "synth"]] {
        let mut command = Command::new(env!("CARGO_BIN_EXE_caphy"));
        command.arg("run").arg(other.config()).arg("--out").arg(experiment.out()).args(more);
        refused(&command.output().expect("the program ends"), &["in use by another run", "choose another folder"]);
        assert!(files(&experiment.out()) == before, "{more:?}: files changed");
    }
    drop(held);
    assert!(experiment.run().ran.is_empty());
}

/// What a run says may go to a log on a full disk: the run is worth more.
#[test]
fn a_log_that_cannot_be_written_ends_no_run() {
    if !Path::new("/dev/full").exists() {
        return;
    }
    let experiment = without(&["export"]);
    let mut command = program(&experiment);
    let log = std::fs::File::options().write(true).open("/dev/full").expect("a device that is full");
    assert!(command.stderr(log).status().expect("the program ends").success());
    assert_same_results(&experiment.out());
}

/// What the program writes to a full device and to a reader that has gone: an error, and nothing worth a word.
#[test]
fn output_that_cannot_be_written_is_an_error_and_no_panic() {
    let started = |out: Stdio| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_caphy"));
        command.args(["show", "fabrics"]).stdin(Stdio::null()).stdout(out).output().expect("caphy starts")
    };
    if let Ok(full) = std::fs::OpenOptions::new().write(true).open("/dev/full") {
        let output = started(full.into());
        let said = text(&output.stderr);
        assert!(output.status.code() == Some(1), "{:?} {said}", output.status);
        assert!(said.contains("standard output") && !said.contains("panicked"), "{said}");
    }
    let (reader, writer) = std::io::pipe().expect("a pipe");
    drop(reader);
    let output = started(writer.into());
    assert!(output.status.success(), "{:?} {}", output.status, text(&output.stderr));
}
