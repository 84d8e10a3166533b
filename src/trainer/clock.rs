//! Where a training step's time goes.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Adds up wall time by stage. Copies of a clock add to the same sums; a clock that is off only asks whether it is on.
#[derive(Debug, Clone, Default)]
pub struct StageClock(Option<Arc<Mutex<Vec<(&'static str, Duration)>>>>);

impl StageClock {
    /// A clock that measures nothing.
    pub fn off() -> Self {
        Self(None)
    }
    /// A clock that runs.
    pub fn on() -> Self {
        Self(Some(Arc::default()))
    }
    /// Does something and adds its time to a stage.
    pub fn time<R>(&self, stage: &'static str, f: impl FnOnce() -> R) -> R {
        let Some(sums) = &self.0 else { return f() };
        let started = Instant::now();
        let out = f();
        let spent = started.elapsed();
        // Sums are whole at every moment: a panic elsewhere does not spoil them.
        let mut sums = sums.lock().unwrap_or_else(PoisonError::into_inner);
        match sums.iter_mut().find(|(name, _)| *name == stage) {
            Some((_, sum)) => *sum += spent,
            None => sums.push((stage, spent)),
        }
        out
    }
    /// Sums so far, in the order in which stages were first met; nothing when off.
    pub fn sums(&self) -> Vec<(&'static str, Duration)> {
        self.0.as_ref().map_or(Vec::new(), |sums| sums.lock().unwrap_or_else(PoisonError::into_inner).clone())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn copies_add_to_the_same_sums_and_a_clock_that_is_off_measures_nothing() {
        let clock = StageClock::on();
        let copy = clock.clone();
        assert_eq!(clock.time("a", || 1), 1);
        copy.time("b", || std::thread::sleep(Duration::from_millis(2)));
        copy.time("a", || ());
        let sums = clock.sums();
        assert_eq!(sums.iter().map(|s| s.0).collect::<Vec<_>>(), ["a", "b"]);
        assert!(sums[1].1 >= Duration::from_millis(2));
        let off = StageClock::off();
        assert_eq!((off.time("a", || 2), off.sums().len()), (2, 0));
    }
}
