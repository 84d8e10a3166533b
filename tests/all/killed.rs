//! A whole run killed at any moment, from the first stage to the last, ends with the bits of one that was left alone.

use crate::experiment::{Experiment, TINY, files};
use crate::pipeline::{STAGES, assert_same_results, finished, program};
use crate::record::left_behind;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
use std::path::Path;
use std::process::Stdio;
use std::time::{Duration, Instant};

/// Deaths in all.
const DEATHS: usize = 20;

/// A number in [0, 1).
fn share(rng: &mut ChaCha8Rng) -> f64 {
    f64::from(rng.next_u32()) / 2f64.powi(32)
}

/// Starts the program and kills it after so long; tells whether it was still running.
fn killed_after(experiment: &Experiment, time: Duration) -> bool {
    let mut child = program(experiment).stderr(Stdio::null()).spawn().expect("the program starts");
    std::thread::sleep(time);
    let running = child.try_wait().expect("a child").is_none();
    child.kill().ok();
    child.wait().expect("a child");
    running
}

/// The stage that has begun and is not done.
fn hit(out: &Path) -> &'static str {
    STAGES.into_iter().find(|stage| !out.join(format!("{stage}.caphy")).exists()).unwrap_or("the end")
}

/// Everything that a run leaves, times aside.
fn assert_same_as_finished(experiment: &Experiment, what: &str) {
    assert_same_results(&experiment.out());
    let (expected, got) = (left_behind(finished()), left_behind(&experiment.out()));
    assert!(got.keys().eq(expected.keys()), "{what}: {:?}\n{:?}", got.keys(), expected.keys());
    for (name, bytes) in &expected {
        assert!(&got[name] == bytes, "{what}: {name} has other bits");
    }
    let left: Vec<String> = files(&experiment.out()).into_keys().filter(|n| n.contains("checkpoint-")).collect();
    assert!(left.is_empty(), "{what}: checkpoints of finished stages: {left:?}");
}

#[test]
#[ignore = "about fifteen whole runs take some minutes; .ci/slow runs it"]
fn whole_runs_killed_at_twenty_moments_end_with_the_same_bits() {
    finished();
    let started = Instant::now();
    let whole = Experiment::new(TINY);
    assert!(program(&whole).stderr(Stdio::null()).status().expect("the program ends").success());
    let lasts = started.elapsed();
    assert_same_as_finished(&whole, "left alone");
    let mut rng = ChaCha8Rng::seed_from_u64(20);
    let mut hits: Vec<(&str, usize)> = STAGES.map(|stage| (stage, 0)).to_vec();
    let (mut deaths, mut runs) = (0, 0);
    // Killed again and again until it is done, then the next one.
    while deaths < DEATHS {
        let experiment = Experiment::new(TINY);
        runs += 1;
        loop {
            // Anywhere in a whole run; what is left of one may end before.
            let time = lasts.mul_f64(share(&mut rng));
            if deaths == DEATHS || !killed_after(&experiment, time) {
                break;
            }
            let stage = hit(&experiment.out());
            deaths += 1;
            hits.iter_mut().filter(|h| h.0 == stage).for_each(|h| h.1 += 1);
            println!("death {deaths} of run {runs}, {:.1} s after its start: {stage}", time.as_secs_f64());
        }
        assert!(program(&experiment).stderr(Stdio::null()).status().expect("the program ends").success());
        assert_same_as_finished(&experiment, &format!("run {runs}"));
    }
    println!("{deaths} deaths in {runs} runs, by stage: {hits:?}; a run takes {:.1} s", lasts.as_secs_f64());
    assert!(hits.iter().filter(|h| h.1 > 0).count() >= 4, "{hits:?}");
}
