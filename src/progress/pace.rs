//! How long the rest will take, from how long the steps before took.

use std::collections::VecDeque;

/// Steps of a kind whose times are kept: enough that a few disturbed ones do not show, few enough that a machine that has
/// become slower is believed soon.
const RECENT: usize = 31;
/// Share of growth before an extrapolation means anything.
const LEAST_GROWTH: f64 = 0.02;

/// Steps of one kind: they take about the same time.
#[derive(Debug, Clone, Copy)]
pub struct Work {
    /// Size of one step, in a unit that all kinds share: what is not measured yet is judged by it.
    pub size: f64,
    /// Steps that are left.
    pub left: usize,
}

/// Remaining time of steps of several kinds.
///
/// Per kind the median of recent times counts, so that a step that waited for the disk does not make the whole night
/// longer. Time between steps (checkpoints, pictures) is added as its mean per step.
#[derive(Debug)]
pub struct Pace {
    kinds: Vec<Kind>,
    between: f64,
    steps: usize,
}

#[derive(Debug)]
struct Kind {
    work: Work,
    recent: VecDeque<f64>,
}

impl Kind {
    fn median(&self) -> Option<f64> {
        let mut times: Vec<f64> = self.recent.iter().copied().collect();
        times.sort_by(f64::total_cmp);
        times.get(times.len() / 2).copied()
    }
}

impl Pace {
    /// Nothing done yet.
    pub fn new(kinds: Vec<Work>) -> Pace {
        let kinds = kinds.into_iter().map(|work| Kind { work, recent: VecDeque::new() }).collect();
        Pace { kinds, between: 0.0, steps: 0 }
    }
    /// One step of a kind was done in so many seconds.
    pub fn step(&mut self, kind: usize, seconds: f64) {
        let kind = &mut self.kinds[kind];
        kind.work.left = kind.work.left.saturating_sub(1);
        if kind.recent.len() == RECENT {
            kind.recent.pop_front();
        }
        kind.recent.push_back(seconds);
        self.steps += 1;
    }
    /// One step of a kind need not be done: an earlier process has done it.
    pub fn skip(&mut self, kind: usize) {
        let work = &mut self.kinds[kind].work;
        work.left = work.left.saturating_sub(1);
    }
    /// Seconds that went into something else than steps.
    pub fn between(&mut self, seconds: f64) {
        self.between += seconds;
    }
    /// So many steps of a kind are left after all: some were done by an earlier process, or have to be done again.
    pub fn set_left(&mut self, kind: usize, left: usize) {
        self.kinds[kind].work.left = left;
    }
    /// Seconds that are left; `None` as long as no step was measured.
    pub fn left(&self) -> Option<f64> {
        let medians: Vec<Option<f64>> = self.kinds.iter().map(Kind::median).collect();
        let measured =
            || self.kinds.iter().zip(&medians).filter_map(|(kind, median)| Some((kind.work.size, (*median)?)));
        let (size, time) = measured().fold((0.0, 0.0), |(size, time), (s, t)| (size + s, time + t));
        if size <= 0.0 {
            return None;
        }
        let between = self.between / self.steps.max(1) as f64;
        let of = |(kind, median): (&Kind, &Option<f64>)| {
            let each = median.unwrap_or(kind.work.size * time / size);
            kind.work.left as f64 * (each + between)
        };
        Some(self.kinds.iter().zip(&medians).map(of).sum())
    }
}

/// Remaining time of something of which only the share that is done is known.
#[derive(Debug, Default)]
pub(super) struct Growth {
    /// Time [s] and share of the first look: a resumed stage starts above zero.
    first: Option<(f64, f64)>,
    last: f64,
}

impl Growth {
    /// Seconds that are left at a time [s]; `None` when that cannot be said yet. A share that falls starts over.
    pub(super) fn left(&mut self, now: f64, share: f64) -> Option<f64> {
        if share < self.last {
            self.first = None;
        }
        self.last = share;
        let (t0, s0) = *self.first.get_or_insert((now, share));
        (share - s0 >= LEAST_GROWTH).then(|| (now - t0) * (1.0 - share) / (share - s0))
    }
}

/// A remaining time in words; something that is not done is never `0 s` away from it.
pub(crate) fn words(left: Option<f64>) -> String {
    let Some(left) = left else { return "remaining time not known yet".into() };
    format!("{} left", duration(left))
}

/// A time in words, rounded up to whole seconds, at least one.
pub(crate) fn duration(seconds: f64) -> String {
    let seconds = seconds.ceil().max(1.0) as u64;
    match seconds {
        0..100 => format!("{seconds} s"),
        100..6000 => format!("{} min {:02} s", seconds / 60, seconds % 60),
        _ => format!("{} h {:02} min", seconds / 3600, seconds % 3600 / 60),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two garments, 5 rounds of 40 window steps and 8 scan steps: seconds of each step, by its kind.
    fn timeline() -> Vec<(usize, f64)> {
        // Times scatter by some per cent around these; every 17th step waits for something.
        let base = [0.080, 0.015, 0.040, 0.009];
        let mut out = Vec::new();
        for garment in 0..2 {
            for _ in 0..5 {
                for (kind, count) in [(2 * garment, 40), (2 * garment + 1, 8)] {
                    for _ in 0..count {
                        let i = out.len();
                        let scatter = 1.0 + 0.06 * ((i * 37 % 11) as f64 / 10.0 - 0.5);
                        let wait = if i % 17 == 16 { 4.0 } else { 1.0 };
                        out.push((kind, base[kind] * scatter * wait));
                    }
                }
            }
        }
        out
    }

    fn works() -> Vec<Work> {
        // A lower garment of half the size; a window step holds 80 frames, a scan step 16.
        [(80.0, 200), (16.0, 40), (40.0, 200), (8.0, 40)].map(|(size, left)| Work { size, left }).to_vec()
    }

    #[test]
    fn the_remaining_time_is_true_and_does_not_jump() {
        let steps = timeline();
        let mut pace = Pace::new(works());
        assert_eq!(pace.left(), None);
        let mut before: Option<f64> = None;
        for (i, &(kind, seconds)) in steps.iter().enumerate() {
            pace.step(kind, seconds);
            // A checkpoint every 20 steps.
            let pause = if i % 20 == 19 { 0.05 } else { 0.0 };
            pace.between(pause);
            let rest = &steps[i + 1..];
            let pauses = (i + 1..steps.len()).filter(|i| i % 20 == 19).count() as f64 * 0.05;
            let truth = rest.iter().map(|s| s.1).sum::<f64>() + pauses;
            let left = pace.left().expect("a step was measured");
            // Waits are 3/17 of the time and no median shows them; before the other kinds are measured, their sizes
            // are off by a fifth.
            assert!((left - truth).abs() < 0.3 * truth + 0.5, "step {i}: {left} s, truly {truth} s");
            if let Some(before) = before {
                let passed = seconds + pause;
                assert!((left - before + passed).abs() < 0.1 * before + 0.5, "step {i}: from {before} to {left} s");
            }
            if !rest.is_empty() {
                assert!(left > 0.0);
            }
            before = Some(left);
        }
        assert_eq!(pace.left(), Some(0.0));
    }

    #[test]
    fn one_long_step_changes_nothing_and_a_slower_machine_does() {
        let mut pace = Pace::new(vec![Work { size: 1.0, left: 1000 }]);
        (0..50).for_each(|_| pace.step(0, 0.1));
        let before = pace.left().unwrap();
        pace.step(0, 30.0);
        assert!((pace.left().unwrap() - (before - 0.1)).abs() < 1e-9);
        (0..16).for_each(|_| pace.step(0, 0.2));
        assert!((pace.left().unwrap() - 933.0 * 0.2).abs() < 1e-9, "{:?}", pace.left());
    }

    #[test]
    fn what_was_done_before_does_not_count_as_fast() {
        let mut pace = Pace::new(vec![Work { size: 1.0, left: 1000 }]);
        pace.set_left(0, 100);
        pace.step(0, 0.5);
        assert!((pace.left().unwrap() - 49.5).abs() < 1e-9);
    }

    #[test]
    fn shares_are_extrapolated_from_where_this_process_began() {
        let mut growth = Growth::default();
        assert_eq!(growth.left(10.0, 0.5), None);
        assert_eq!(growth.left(11.0, 0.51), None, "too little to judge by");
        let left = growth.left(15.0, 0.6).unwrap();
        assert!((left - 20.0).abs() < 1e-9, "{left}");
        assert_eq!(growth.left(16.0, 0.1), None, "another part begins");
    }

    #[test]
    fn nothing_unfinished_is_0_s_away() {
        let said: Vec<String> = [0.0, 0.2, 42.1, 130.0, 7325.0].map(|s| words(Some(s))).to_vec();
        assert_eq!(said, ["1 s left", "1 s left", "43 s left", "2 min 10 s left", "2 h 02 min left"]);
        assert!(words(None).contains("not known"));
    }
}
