//! Vertices of many frames, one frame per SIMD lane.
//!
//! Memory is `[block][vertex][xyz][lane]` with `L = T::LANES` lanes. In training a lane is a window and a block a time
//! step, so that inertia (block b against b-1) stays in its lane. Lanes beyond the number of windows repeat the last
//! window: they cost nothing extra and stay finite; whoever sums over frames leaves them out.

use crate::{Error, Real, Result, Vec3};

/// Vertex positions (or gradients) [m or N] of `blocks · L` frames.
#[derive(Debug, Clone, PartialEq)]
pub struct Frames<T> {
    blocks: usize,
    vertices: usize,
    lanes_used: usize,
    data: Vec<T>,
}

impl<T: Real> Frames<T> {
    /// Zeros for `blocks` time steps of `lanes_used <= T::LANES` windows.
    pub fn zeros(blocks: usize, vertices: usize, lanes_used: usize) -> Self {
        // Fresh zeros come cheaper from the system than by growing.
        Self::with_memory(vec![T::zero(); blocks * Self::length_of_block(vertices)], blocks, vertices, lanes_used)
    }
    /// The same shape in memory that was used before: values are what it held, or zeros where it grows.
    pub fn with_memory(memory: Vec<T>, blocks: usize, vertices: usize, lanes_used: usize) -> Self {
        assert!((1..=T::LANES).contains(&lanes_used), "lanes_used = {lanes_used} must lie in 1..={}", T::LANES);
        let mut data = memory;
        data.resize(blocks * Self::length_of_block(vertices), T::zero());
        Self { blocks, vertices, lanes_used, data }
    }
    /// The memory, to be used again.
    pub fn into_memory(self) -> Vec<T> {
        self.data
    }
    /// Values per block of so many vertices.
    pub const fn length_of_block(vertices: usize) -> usize {
        vertices * 3 * T::LANES
    }
    /// Number of blocks (time steps).
    pub fn blocks(&self) -> usize {
        self.blocks
    }
    /// Number of vertices per frame.
    pub fn vertices(&self) -> usize {
        self.vertices
    }
    /// Number of lanes that carry a frame of their own.
    pub fn lanes_used(&self) -> usize {
        self.lanes_used
    }
    /// Number of frames that count.
    pub fn frames(&self) -> usize {
        self.blocks * self.lanes_used
    }
    /// All values, `[block][vertex][xyz][lane]`.
    pub fn data(&self) -> &[T] {
        &self.data
    }
    /// All values, `[block][vertex][xyz][lane]`.
    pub fn data_mut(&mut self) -> &mut [T] {
        &mut self.data
    }
    /// One block, `[vertex][xyz][lane]`.
    pub fn block(&self, block: usize) -> &[T] {
        let n = self.vertices * 3 * T::LANES;
        &self.data[block * n..(block + 1) * n]
    }
    /// One block, `[vertex][xyz][lane]`.
    pub fn block_mut(&mut self, block: usize) -> &mut [T] {
        let n = self.vertices * 3 * T::LANES;
        &mut self.data[block * n..(block + 1) * n]
    }
    /// Values per block.
    pub fn block_len(&self) -> usize {
        self.vertices * 3 * T::LANES
    }
    /// One vertex of one frame [m].
    pub fn get(&self, block: usize, lane: usize, vertex: usize) -> Vec3 {
        let i = (block * self.vertices + vertex) * 3 * T::LANES + lane;
        Vec3::new(self.data[i].to_f64(), self.data[i + T::LANES].to_f64(), self.data[i + 2 * T::LANES].to_f64())
    }
    /// Sets one vertex of one frame; setting the last used lane also fills the lanes behind it.
    pub fn set(&mut self, block: usize, lane: usize, vertex: usize, value: &Vec3) {
        let last = if lane + 1 == self.lanes_used { T::LANES } else { lane + 1 };
        let i = (block * self.vertices + vertex) * 3 * T::LANES;
        for axis in 0..3 {
            for l in lane..last {
                self.data[i + axis * T::LANES + l] = T::of(value[axis]);
            }
        }
    }
    /// One frame as points [m], shape [vertices].
    pub fn frame(&self, block: usize, lane: usize) -> Vec<Vec3> {
        (0..self.vertices).map(|v| self.get(block, lane, v)).collect()
    }
    /// Sets one frame from points [m], shape [vertices].
    pub fn set_frame(&mut self, block: usize, lane: usize, points: &[Vec3]) -> Result<()> {
        Error::check_length("points of one frame", self.vertices, points.len())?;
        for (vertex, point) in points.iter().enumerate() {
            self.set(block, lane, vertex, point);
        }
        Ok(())
    }
    /// Sets every value to zero.
    pub fn clear(&mut self) {
        self.data.fill(T::zero());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_round_trip_and_spare_lanes_repeat_the_last() {
        let mut frames = Frames::<f32>::zeros(2, 3, 2);
        let points = [Vec3::new(1., 2., 3.), Vec3::new(4., 5., 6.), Vec3::new(7., 8., 9.)];
        frames.set_frame(1, 1, &points).unwrap();
        assert_eq!(frames.frame(1, 1), points);
        assert_eq!(frames.get(1, 15, 2), points[2]);
        assert_eq!(frames.get(1, 0, 2), Vec3::zeros());
        assert!(frames.set_frame(0, 0, &points[..2]).is_err());
        let again = Frames::with_memory(frames.into_memory(), 1, 7, 16);
        assert_eq!((again.block_len(), again.get(0, 15, 6)), (again.data().len(), Vec3::zeros()));
    }
}
