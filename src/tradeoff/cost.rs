//! What work costs: processor time, wall time, memory.

use serde::{Deserialize, Serialize};
use std::time::Instant;

/// Time spent on something.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Spent {
    /// Processor time of all threads [s]; wall time where the system does not tell.
    pub processor_s: f64,
    /// Wall time [s].
    pub wall_s: f64,
}

/// Measures from its start on.
pub(super) struct Stopwatch {
    started: Instant,
    processor: Option<f64>,
}

impl Stopwatch {
    pub(super) fn start() -> Self {
        Self { processor: processor_s(), started: Instant::now() }
    }
    pub(super) fn read(&self) -> Spent {
        let wall_s = self.started.elapsed().as_secs_f64();
        let processor_s = self.processor.zip(processor_s()).map_or(wall_s, |(from, to)| to - from);
        Spent { processor_s, wall_s }
    }
}

/// Ticks per second of `/proc`: what Linux shows to programs on every machine that Rust runs on.
const TICKS: f64 = 100.0;

/// Processor time of this process so far [s], in hundredths of a second; none where there is no `/proc`.
fn processor_s() -> Option<f64> {
    let text = std::fs::read_to_string("/proc/self/stat").ok()?;
    // The name of the program, in brackets, may hold anything.
    let mut fields = text.rsplit_once(')')?.1.split_whitespace().skip(11);
    let mut next = || fields.next()?.parse::<f64>().ok();
    Some((next()? + next()?) / TICKS)
}

/// Forgets the highest memory so far; without effect where there is no `/proc`.
pub(super) fn reset_peak() {
    // Refused in some containers: the peak is then that of the whole process so far, an upper bound.
    std::fs::write("/proc/self/clear_refs", "5").ok();
}

/// Highest memory of this process since [`reset_peak`] [MiB].
pub(super) fn peak_mib() -> Option<f64> {
    let text = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = text.lines().find_map(|l| l.strip_prefix("VmHWM:"))?;
    Some(line.trim().strip_suffix("kB")?.trim().parse::<f64>().ok()? / 1024.0)
}

/// Processes that run or wait, mean of the last minute.
pub(super) fn load() -> Option<f64> {
    std::fs::read_to_string("/proc/loadavg").ok()?.split_whitespace().next()?.parse().ok()
}

/// The machine in words: model and processors.
pub(super) fn machine() -> String {
    let info = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let model = info.lines().find_map(|l| l.strip_prefix("model name")?.split_once(": ")).map(|m| m.1);
    let processors = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
    let threads = rayon::current_num_threads();
    format!("{}, {processors} processors, {threads} threads", model.unwrap_or(std::env::consts::ARCH))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn work_takes_processor_time_and_sleep_does_not() {
        let watch = Stopwatch::start();
        std::thread::sleep(std::time::Duration::from_millis(60));
        assert!(watch.read().wall_s >= 0.06);
        let before = peak_mib();
        let filled = std::hint::black_box(vec![1u8; 64 << 20]);
        assert!(before.is_none() || peak_mib() >= before, "{}", filled.len());
        if processor_s().is_some() {
            // Other tests of this process run beside: only that time is counted can be said.
            let watch = Stopwatch::start();
            let mut sum = 0.0f64;
            while watch.read().processor_s < 0.03 {
                (0..10_000).for_each(|i| sum += std::hint::black_box(f64::from(i)).sqrt());
            }
            assert!(sum > 0.0 && watch.read().wall_s > 0.0);
        }
    }
}
