//! Sparse matrices of 3 × 3 blocks with a symmetric pattern that is found once and reused.

use crate::energy::Stencil;
use caphy_core::{Error, Result};
use std::sync::Arc;

/// Which vertices are coupled, in compressed rows: symmetric, sorted, the diagonal included.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Pattern {
    offsets: Vec<u32>,
    columns: Vec<u32>,
}

impl Pattern {
    /// All pairs of vertices that share an element.
    ///
    /// # Errors
    /// [`Error::Mesh`] for an element of a vertex that does not exist.
    pub fn new(vertex_count: usize, stencils: &[&Stencil]) -> Result<Self> {
        let mut pairs: Vec<[u32; 2]> = (0..vertex_count as u32).map(|v| [v, v]).collect();
        for stencil in stencils {
            for element in stencil.vertices.chunks_exact(stencil.width.max(1)) {
                for &a in element {
                    if a as usize >= vertex_count {
                        let problem = format!("is part of an element but there are {vertex_count} vertices");
                        let remedy = "give the elements of this garment";
                        return Err(Error::mesh("garment", format!("vertex {a}"), problem, remedy));
                    }
                    pairs.extend(element.iter().filter(|&&b| b != a).map(|&b| [a, b]));
                }
            }
        }
        pairs.sort_unstable();
        pairs.dedup();
        let mut offsets = vec![0u32; vertex_count + 1];
        for pair in &pairs {
            offsets[pair[0] as usize + 1] += 1;
        }
        for i in 0..vertex_count {
            offsets[i + 1] += offsets[i];
        }
        Ok(Self { offsets, columns: pairs.into_iter().map(|p| p[1]).collect() })
    }
    /// Number of vertices (block rows).
    pub fn vertex_count(&self) -> usize {
        self.offsets.len() - 1
    }
    /// Number of blocks.
    pub fn block_count(&self) -> usize {
        self.columns.len()
    }
    /// Vertices coupled to one, itself included.
    pub fn row(&self, vertex: u32) -> &[u32] {
        &self.columns[self.range(vertex)]
    }
    pub(super) fn range(&self, vertex: u32) -> std::ops::Range<usize> {
        self.offsets[vertex as usize] as usize..self.offsets[vertex as usize + 1] as usize
    }
    /// Where each block of each element goes, `[element][width][width]`.
    ///
    /// # Errors
    /// [`Error::Unsupported`] for an element that the pattern was not made for.
    pub fn slots(&self, stencil: &Stencil) -> Result<Vec<u32>> {
        let mut out = Vec::with_capacity(stencil.len() * stencil.width * stencil.width);
        for element in stencil.vertices.chunks_exact(stencil.width.max(1)) {
            for &a in element {
                for &b in element {
                    let found = (a as usize) < self.vertex_count() && (b as usize) < self.vertex_count();
                    let place = if found { self.row(a).binary_search(&b).ok() } else { None };
                    let Some(place) = place else {
                        return Err(Error::unsupported(format!("an element that couples {a} and {b}"), "this matrix"));
                    };
                    out.push(self.offsets[a as usize] + place as u32);
                }
            }
        }
        Ok(out)
    }
}

/// Values [N/m] in a pattern.
#[derive(Debug, Clone)]
pub struct BlockMatrix {
    pattern: Arc<Pattern>,
    values: Vec<f64>,
}

impl BlockMatrix {
    /// Zeros.
    pub fn new(pattern: Arc<Pattern>) -> Self {
        let values = vec![0.0; 9 * pattern.block_count()];
        Self { pattern, values }
    }
    /// The pattern.
    pub fn pattern(&self) -> &Arc<Pattern> {
        &self.pattern
    }
    /// One block, row-major.
    pub(super) fn block(&self, slot: usize) -> &[f64] {
        &self.values[9 * slot..][..9]
    }
    /// Sets all values to zero.
    pub fn clear(&mut self) {
        self.values.fill(0.0);
    }
    /// Adds element blocks, `[element][3 width][3 width]`, at the slots of [`Pattern::slots`].
    pub fn add(&mut self, slots: &[u32], width: usize, blocks: &[f64]) {
        let side = 3 * width;
        for (slots, block) in slots.chunks_exact(width * width).zip(blocks.chunks_exact(side * side)) {
            for (k, &slot) in slots.iter().enumerate() {
                let (i, j) = (k / width, k % width);
                let out = &mut self.values[9 * slot as usize..][..9];
                for r in 0..3 {
                    let row = &block[(3 * i + r) * side + 3 * j..][..3];
                    for c in 0..3 {
                        out[3 * r + c] += row[c];
                    }
                }
            }
        }
    }
    /// Adds a number per vertex to the diagonal.
    pub fn add_diagonal(&mut self, per_vertex: impl Iterator<Item = f64>) {
        for (v, value) in per_vertex.enumerate().take(self.pattern.vertex_count()) {
            let slot = self.diagonal(v as u32);
            for k in [0, 4, 8] {
                self.values[9 * slot + k] += value;
            }
        }
    }
    fn diagonal(&self, vertex: u32) -> usize {
        let place = self.pattern.row(vertex).binary_search(&vertex).unwrap_or(0);
        self.pattern.range(vertex).start + place
    }
    /// Takes fixed vertices out: their rows and columns become those of the unit matrix, times a typical diagonal so that
    /// the condition does not suffer.
    pub fn fix(&mut self, fixed: &[bool]) {
        let scale = self.mean_diagonal().max(f64::MIN_POSITIVE);
        for a in 0..self.pattern.vertex_count() as u32 {
            for slot in self.pattern.range(a) {
                let b = self.pattern.columns[slot];
                if fixed[a as usize] || fixed[b as usize] {
                    let block = &mut self.values[9 * slot..][..9];
                    block.fill(0.0);
                    if a == b {
                        for k in [0, 4, 8] {
                            block[k] = scale;
                        }
                    }
                }
            }
        }
    }
    /// Mean of the diagonal's absolute values.
    pub fn mean_diagonal(&self) -> f64 {
        let n = self.pattern.vertex_count();
        let sum: f64 = (0..n as u32)
            .map(|v| {
                let block = self.block(self.diagonal(v));
                block[0].abs() + block[4].abs() + block[8].abs()
            })
            .sum();
        sum / (3 * n.max(1)) as f64
    }
    /// A x.
    pub fn multiply(&self, x: &[f64]) -> Vec<f64> {
        let mut out = vec![0.0; x.len()];
        for a in 0..self.pattern.vertex_count() as u32 {
            let mut sum = [0.0; 3];
            for slot in self.pattern.range(a) {
                let x = &x[3 * self.pattern.columns[slot] as usize..][..3];
                let block = self.block(slot);
                for r in 0..3 {
                    sum[r] += block[3 * r] * x[0] + block[3 * r + 1] * x[1] + block[3 * r + 2] * x[2];
                }
            }
            out[3 * a as usize..][..3].copy_from_slice(&sum);
        }
        out
    }
    /// Aᵀ x.
    pub fn multiply_transposed(&self, x: &[f64]) -> Vec<f64> {
        let mut out = vec![0.0; x.len()];
        for a in 0..self.pattern.vertex_count() as u32 {
            let x: [f64; 3] = std::array::from_fn(|k| x[3 * a as usize + k]);
            for slot in self.pattern.range(a) {
                let out = &mut out[3 * self.pattern.columns[slot] as usize..][..3];
                let block = self.block(slot);
                for c in 0..3 {
                    out[c] += block[c] * x[0] + block[3 + c] * x[1] + block[6 + c] * x[2];
                }
            }
        }
        out
    }
}
