//! Progress for people: a bar with the remaining time on a terminal, plain lines elsewhere.

mod pace;

pub use pace::{Pace, Work};
pub(crate) use pace::{duration, words};

use indicatif::{ProgressBar, ProgressStyle};
use std::io::{IsTerminal, Write};
use std::sync::Mutex;
use std::time::{Duration, Instant};

/// Prints a line that stays, like those of a stage. A log that cannot be written (its disk is full, its reader has gone) ends no run.
pub fn say(name: &str, line: &str) {
    writeln!(std::io::stderr(), "{name:>12} {line}").ok();
}

/// Progress of one stage; safe to call from any thread.
pub struct Progress {
    stage: String,
    bar: Option<ProgressBar>,
    started: Instant,
    lines: Mutex<Lines>,
}

struct Lines {
    last: Instant,
    growth: pace::Growth,
}

const STEPS: f64 = 1000.0;
/// Seconds between plain lines where there is no terminal.
const LINE_EVERY: Duration = Duration::from_secs(10);

impl Progress {
    /// Starts showing a stage.
    pub fn start(stage: &str) -> Self {
        let bar = std::io::stderr().is_terminal().then(|| {
            let bar = ProgressBar::new(STEPS as u64);
            let style = ProgressStyle::with_template("{prefix:>12} {bar:36} {percent:>3}% {elapsed} {wide_msg}")
                .unwrap_or_else(|_| ProgressStyle::default_bar());
            bar.set_style(style);
            bar.set_prefix(stage.to_string());
            bar
        });
        if bar.is_none() {
            say(stage, "started");
        }
        let started = Instant::now();
        let lines = Lines { last: started, growth: pace::Growth::default() };
        Self { stage: stage.into(), bar, started, lines: Mutex::new(lines) }
    }
    /// Shows nothing: for work that is over in a moment.
    pub fn silent() -> Self {
        let started = Instant::now();
        Self {
            stage: String::new(),
            bar: Some(ProgressBar::hidden()),
            started,
            lines: Mutex::new(Lines { last: started, growth: pace::Growth::default() }),
        }
    }
    /// Sets the share done, in [0, 1], with a short word on what is going on. What is left is judged by how fast the share grew
    /// in this process.
    pub fn set(&self, share: f64, message: &str) {
        let share = share.clamp(0.0, 1.0);
        let Ok(mut lines) = self.lines.lock() else { return };
        let left = lines.growth.left(self.started.elapsed().as_secs_f64(), share);
        self.show(&mut lines, share, left, message);
    }
    /// As [`Progress::set`], by a caller who knows better how many seconds are left.
    pub fn set_left(&self, share: f64, left: Option<f64>, message: &str) {
        let Ok(mut lines) = self.lines.lock() else { return };
        self.show(&mut lines, share.clamp(0.0, 1.0), left, message);
    }
    fn show(&self, lines: &mut Lines, share: f64, left: Option<f64>, message: &str) {
        if let Some(bar) = &self.bar {
            bar.set_position((share * STEPS) as u64);
            bar.set_message(format!("{}, {message}", pace::words(left)));
            return;
        }
        let now = Instant::now();
        if now - lines.last >= LINE_EVERY {
            lines.last = now;
            let line = format!("{:3.0} %, {}, {message}", (100.0 * share).floor(), pace::words(left));
            say(&self.stage, &line);
        }
    }
    /// Prints a line that stays.
    pub fn note(&self, line: &str) {
        match &self.bar {
            Some(bar) => bar.println(format!("{:>12} {line}", self.stage)),
            None => say(&self.stage, line),
        }
    }
    /// Ends the bar and returns the seconds it took.
    pub fn finish(&self) -> f64 {
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
        }
        let seconds = self.started.elapsed().as_secs_f64();
        say(&self.stage, &format!("done in {seconds:.1} s"));
        seconds
    }
}
