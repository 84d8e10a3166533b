//! The batches of a training, in order: a function of the configuration and the seed, so that a resumed run goes on where
//! it was.

use crate::trainer::{Batch, BatchKind};

/// All batches, made round by round: a night's worth of them is never held at once.
pub struct Order<'a> {
    make: Box<dyn Fn(usize) -> Vec<Batch> + 'a>,
    /// First step of each round, and the number of steps.
    starts: Vec<usize>,
    /// Steps on scan poses before each round, and in all.
    scan_starts: Vec<usize>,
    /// The round at hand.
    round: usize,
    batches: Vec<Batch>,
}

impl<'a> Order<'a> {
    /// Rounds of batches; `make` gives the same ones for a round whenever it is asked.
    pub fn new(rounds: usize, make: impl Fn(usize) -> Vec<Batch> + 'a) -> Order<'a> {
        let (mut starts, mut scan_starts) = (vec![0], vec![0]);
        for round in 0..rounds {
            let batches = make(round);
            starts.push(starts[round] + batches.len());
            scan_starts.push(scan_starts[round] + batches.iter().filter(|b| b.kind != BatchKind::Windows).count());
        }
        Order { make: Box::new(make), starts, scan_starts, round: usize::MAX, batches: Vec::new() }
    }
    /// Number of steps.
    pub fn len(&self) -> usize {
        self.starts[self.starts.len() - 1]
    }
    /// Whether there are no steps.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
    /// The round that a step belongs to.
    pub fn round(&self, step: usize) -> usize {
        self.starts.partition_point(|&start| start <= step).saturating_sub(1)
    }
    /// The number of rounds that are complete after so many steps, where that is the end of one.
    pub fn rounds_done(&self, steps: usize) -> Option<usize> {
        self.starts.binary_search(&steps).ok()
    }
    /// The batch of a step.
    pub fn batch(&mut self, step: usize) -> &Batch {
        let round = self.round(step);
        if self.round != round {
            self.batches = (self.make)(round);
            self.round = round;
        }
        &self.batches[step - self.starts[round]]
    }
    /// Steps on windows and on scan poses from a step on.
    pub fn left(&mut self, step: usize) -> [usize; 2] {
        let scans_before = if step >= self.len() {
            self.scan_starts[self.scan_starts.len() - 1]
        } else {
            self.batch(step);
            let here = &self.batches[..step - self.starts[self.round]];
            self.scan_starts[self.round] + here.iter().filter(|b| b.kind != BatchKind::Windows).count()
        };
        let scans = self.scan_starts[self.scan_starts.len() - 1] - scans_before;
        [self.len() - step.min(self.len()) - scans, scans]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_are_counted_across_rounds() {
        // Round r: r + 1 steps on windows, then one on scans.
        let make = |round: usize| -> Vec<Batch> {
            let batch = |i, kind| Batch { frames: vec![10 * round + i], windows: 1, kind };
            (0..=round).map(|i| batch(i, BatchKind::Windows)).chain([batch(9, BatchKind::Scans)]).collect()
        };
        let mut order = Order::new(3, make);
        assert_eq!(order.len(), 9);
        let frames: Vec<usize> = (0..9).map(|step| order.batch(step).frames[0]).collect();
        assert_eq!(frames, [0, 9, 10, 11, 19, 20, 21, 22, 29]);
        assert_eq!(order.batch(1).frames[0], 9, "back to an earlier round");
        assert_eq!((0..9).map(|s| order.round(s)).collect::<Vec<_>>(), [0, 0, 1, 1, 1, 2, 2, 2, 2]);
        assert_eq!([0, 1, 2, 5, 9].map(|s| order.rounds_done(s)), [Some(0), None, Some(1), Some(2), Some(3)]);
        assert_eq!([0, 1, 2, 4, 8, 9].map(|s| order.left(s)), [[6, 3], [5, 3], [5, 2], [3, 2], [0, 1], [0, 0]]);
        assert!(Order::new(0, make).is_empty());
    }
}
