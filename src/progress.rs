//! Progress for people: a bar with the remaining time on a terminal, plain lines elsewhere.

use indicatif::{ProgressBar, ProgressStyle};
use std::io::IsTerminal;
use std::sync::Mutex;
use std::time::{Duration, Instant};

/// Progress of one stage; safe to call from any thread.
pub struct Progress {
    stage: String,
    bar: Option<ProgressBar>,
    started: Instant,
    lines: Mutex<Lines>,
}

struct Lines {
    last: Instant,
    from: Option<(Instant, f64)>,
}

const STEPS: f64 = 1000.0;
/// Seconds between plain lines where there is no terminal.
const LINE_EVERY: Duration = Duration::from_secs(10);

impl Progress {
    /// Starts showing a stage.
    pub fn start(stage: &str) -> Self {
        let bar = std::io::stderr().is_terminal().then(|| {
            let bar = ProgressBar::new(STEPS as u64);
            let style =
                ProgressStyle::with_template("{prefix:>12} {bar:36} {percent:>3}% {elapsed} left {eta} {wide_msg}")
                    .unwrap_or_else(|_| ProgressStyle::default_bar());
            bar.set_style(style);
            bar.set_prefix(stage.to_string());
            bar
        });
        if bar.is_none() {
            eprintln!("{stage:>12} started");
        }
        let started = Instant::now();
        Self { stage: stage.into(), bar, started, lines: Mutex::new(Lines { last: started, from: None }) }
    }
    /// Shows nothing: for work that is over in a moment.
    pub fn silent() -> Self {
        let started = Instant::now();
        Self {
            stage: String::new(),
            bar: Some(ProgressBar::hidden()),
            started,
            lines: Mutex::new(Lines { last: started, from: None }),
        }
    }
    /// Sets the share done, in [0, 1], with a short word on what is going on.
    pub fn set(&self, share: f64, message: &str) {
        let share = share.clamp(0.0, 1.0);
        if let Some(bar) = &self.bar {
            bar.set_position((share * STEPS) as u64);
            bar.set_message(message.to_string());
            return;
        }
        let Ok(mut lines) = self.lines.lock() else { return };
        let now = Instant::now();
        // A resumed stage starts above zero: only what this process did says how fast it goes.
        let (t0, s0) = *lines.from.get_or_insert((now, share));
        if now - lines.last >= LINE_EVERY {
            lines.last = now;
            let left = if share > s0 {
                format!("{:.0} s left", (now - t0).as_secs_f64() * (1.0 - share) / (share - s0))
            } else {
                "remaining time not known yet".into()
            };
            eprintln!("{:>12} {:3.0} %, {left}, {message}", self.stage, 100.0 * share);
        }
    }
    /// Prints a line that stays.
    pub fn note(&self, line: &str) {
        match &self.bar {
            Some(bar) => bar.println(format!("{:>12} {line}", self.stage)),
            None => eprintln!("{:>12} {line}", self.stage),
        }
    }
    /// Ends the bar and returns the seconds it took.
    pub fn finish(&self) -> f64 {
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
        }
        let seconds = self.started.elapsed().as_secs_f64();
        eprintln!("{:>12} done in {seconds:.1} s", self.stage);
        seconds
    }
}
