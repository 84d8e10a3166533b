//! Memory of a step, kept for the next: a step of a shirt fills 30 MB, and asking the system for it anew every time costs more
//! than some of the energies.

use caphy_core::lanes::Frames;
use std::ops::{Deref, DerefMut};
use std::sync::{Arc, Mutex, PoisonError};

/// Memory that waits to be used again.
#[derive(Debug, Clone, Default)]
pub(super) struct Pool(Arc<Mutex<Vec<Vec<f32>>>>);

impl Pool {
    /// Values, some left from before.
    pub(super) fn values(&self, len: usize) -> Lent<Vec<f32>> {
        let mut memory = self.take(len);
        memory.resize(len, 0.0);
        Lent { held: memory, pool: self.clone() }
    }
    /// Zeros.
    pub(super) fn zeros(&self, len: usize) -> Lent<Vec<f32>> {
        let mut values = self.values(len);
        values.fill(0.0);
        values
    }
    /// Frames with values left from before.
    pub(super) fn frames(&self, blocks: usize, vertices: usize, lanes_used: usize) -> Lent<Frames<f32>> {
        let memory = self.take(blocks * Frames::<f32>::length_of_block(vertices));
        Lent { held: Frames::with_memory(memory, blocks, vertices, lanes_used), pool: self.clone() }
    }
    /// The smallest that is large enough; else the largest, to grow.
    fn take(&self, len: usize) -> Vec<f32> {
        let mut free = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let best = (0..free.len()).min_by_key(|&i| {
            let capacity = free[i].capacity();
            if capacity >= len { (0, capacity) } else { (1, usize::MAX - capacity) }
        });
        best.map(|i| free.swap_remove(i)).unwrap_or_default()
    }
}

/// What can be taken apart into its memory.
pub trait Memory {
    /// Leaves nothing behind.
    fn take(&mut self) -> Vec<f32>;
}
impl Memory for Vec<f32> {
    fn take(&mut self) -> Vec<f32> {
        std::mem::take(self)
    }
}
impl Memory for Frames<f32> {
    fn take(&mut self) -> Vec<f32> {
        std::mem::replace(self, Frames::zeros(0, 0, 1)).into_memory()
    }
}

/// Values or frames whose memory goes back to its owner when they are dropped.
#[derive(Debug)]
pub struct Lent<M: Memory> {
    held: M,
    pool: Pool,
}

impl<M: Memory> Deref for Lent<M> {
    type Target = M;
    fn deref(&self) -> &M {
        &self.held
    }
}
impl<M: Memory> DerefMut for Lent<M> {
    fn deref_mut(&mut self) -> &mut M {
        &mut self.held
    }
}
impl<M: Memory> Drop for Lent<M> {
    fn drop(&mut self) {
        let memory = self.held.take();
        self.pool.0.lock().unwrap_or_else(PoisonError::into_inner).push(memory);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn memory_comes_back_and_the_smallest_that_fits_is_taken() {
        let pool = Pool::default();
        let (small, large) = (pool.values(10), pool.frames(2, 5, 3));
        let at = (small.as_ptr(), large.data().as_ptr());
        drop((small, large));
        let again = pool.zeros(7);
        assert_eq!((again.as_ptr(), again.len()), (at.0, 7));
        assert!(again.iter().all(|v| *v == 0.0));
        let frames = pool.frames(1, 9, 16);
        assert_eq!((frames.data().as_ptr(), frames.vertices(), frames.lanes_used()), (at.1, 9, 16));
        // Nothing is free: new memory.
        assert_eq!(pool.values(3).len(), 3);
    }
}
