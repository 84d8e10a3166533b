//! Multifrontal factorisation of block matrices: Cholesky, and LU for what is not symmetric or not definite.
//!
//! Written here rather than taken from `faer`: cutting a surface gives the elimination tree with its dense fronts at once, so
//! that the whole factorisation is a few hundred lines around the matrix product that the nets already use, while `faer`
//! would add more to the build than the rest of this crate (measured in `benches/results`), has no nested dissection, and orders by minimum
//! degree.

use super::dense;
use super::ordering::{Analysis, Node};
use super::sparse::BlockMatrix;
use super::substitution::Columns;
use caphy_core::{Error, Result};
use rayon::prelude::*;
use std::sync::Arc;

/// A pivot below this share of the mean diagonal counts as zero: the solution would be rounding noise.
const SMALLEST_PIVOT: f64 = 1e-14;

/// What to compute.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// A = L Lᵀ: only the lower triangle is looked at.
    Cholesky,
    /// P A = L U with exchanges inside fronts.
    Lu,
}

#[derive(Debug, Clone, Default)]
struct Front {
    /// L (and U in its first rows for LU), column-major, 3 (own + boundary) rows, 3 own columns.
    panel: Vec<f64>,
    /// U12 of LU, 3 own rows.
    upper: Vec<f64>,
    exchanges: Vec<u32>,
}

impl Front {
    fn columns(&self, node: &Node) -> Columns<'_> {
        Columns { panel: &self.panel, upper: &self.upper, exchanges: &self.exchanges, own: 3 * node.own }
    }
}

/// A factorised matrix.
#[derive(Debug, Clone)]
pub struct Factor {
    analysis: Arc<Analysis>,
    kind: Kind,
    fronts: Vec<Front>,
    /// Pivots of LU that were too small and were replaced: refine what is solved with them.
    pub replaced_pivots: usize,
}

/// What a subtree leaves: its Schur complement, its fronts in order, replaced pivots.
struct Done {
    schur: Vec<f64>,
    fronts: Vec<Front>,
    replaced: usize,
}

impl Factor {
    /// Factorises. `Ok(None)`: a Cholesky factorisation met a pivot that is not positive.
    ///
    /// The same bits on any number of threads: fronts are summed in the order of the tree.
    ///
    /// # Errors
    /// [`Error::NonFinite`] for a matrix with values that are not finite.
    pub fn new(analysis: &Arc<Analysis>, matrix: &BlockMatrix, kind: Kind) -> Result<Option<Self>> {
        let scale = matrix.mean_diagonal();
        if !scale.is_finite() {
            return Err(Error::NonFinite { what: "diagonal of the tangent matrix".into(), index: 0, value: scale });
        }
        let least = SMALLEST_PIVOT * scale;
        let Some(root) = analysis.nodes.len().checked_sub(1) else {
            return Ok(Some(Self { analysis: analysis.clone(), kind, fronts: Vec::new(), replaced_pivots: 0 }));
        };
        let Some(done) = subtree(analysis, matrix, kind, least.max(f64::MIN_POSITIVE), root) else { return Ok(None) };
        Ok(Some(Self { analysis: analysis.clone(), kind, fronts: done.fronts, replaced_pivots: done.replaced }))
    }

    /// A⁻¹ b.
    pub fn solve(&self, b: &[f64]) -> Vec<f64> {
        self.through(b, false)
    }
    /// A⁻ᵀ b.
    pub fn solve_transposed(&self, b: &[f64]) -> Vec<f64> {
        self.through(b, self.kind == Kind::Lu)
    }

    fn through(&self, b: &[f64], transposed: bool) -> Vec<f64> {
        let analysis = &*self.analysis;
        let mut x: Vec<f64> = analysis
            .order
            .iter()
            .flat_map(|&v| b.get(3 * v as usize..3 * v as usize + 3).unwrap_or(&[0.0; 3]).iter().copied())
            .collect();
        let mut part = Vec::new();
        for (node, front) in analysis.nodes.iter().zip(&self.fronts) {
            collect(node, &x, &mut part);
            let columns = front.columns(node);
            match (self.kind, transposed) {
                (Kind::Cholesky, _) => columns.forward_cholesky(&mut part),
                (Kind::Lu, false) => columns.forward_lu(&mut part),
                (Kind::Lu, true) => columns.forward_transposed(&mut part),
            }
            x[3 * node.start..][..3 * node.own].copy_from_slice(&part[..3 * node.own]);
            for (&place, part) in node.boundary.iter().zip(part[3 * node.own..].chunks_exact(3)) {
                x[3 * place as usize..][..3].copy_from_slice(part);
            }
        }
        for (node, front) in analysis.nodes.iter().zip(&self.fronts).rev() {
            collect(node, &x, &mut part);
            let columns = front.columns(node);
            match (self.kind, transposed) {
                (Kind::Cholesky, _) => columns.backward_cholesky(&mut part),
                (Kind::Lu, false) => columns.backward_lu(&mut part),
                (Kind::Lu, true) => columns.backward_transposed(&mut part),
            }
            x[3 * node.start..][..3 * node.own].copy_from_slice(&part[..3 * node.own]);
        }
        let mut out = vec![0.0; x.len()];
        for (at, &v) in analysis.order.iter().enumerate() {
            out[3 * v as usize..][..3].copy_from_slice(&x[3 * at..][..3]);
        }
        out
    }
}

/// Factorises a front after its children.
fn subtree(analysis: &Analysis, matrix: &BlockMatrix, kind: Kind, least: f64, id: usize) -> Option<Done> {
    let node = &analysis.nodes[id];
    let children: Vec<Option<Done>> =
        node.children.par_iter().map(|&c| subtree(analysis, matrix, kind, least, c)).collect();
    let children = children.into_iter().collect::<Option<Vec<_>>>()?;
    let (s, b) = (3 * node.own, 3 * node.boundary.len());
    let rows = s + b;
    let mut panel = vec![0.0; rows * s];
    let mut upper = vec![0.0; if kind == Kind::Lu { s * b } else { 0 }];
    let mut schur = vec![0.0; b * b];
    let mut fronts = Vec::new();
    let mut replaced = 0;
    for (child, places) in children.into_iter().zip(&node.places) {
        extend_add(&child.schur, places, node.own, [&mut panel, &mut upper, &mut schur], rows, kind);
        fronts.extend(child.fronts);
        replaced += child.replaced;
    }
    gather(analysis, node, matrix, [&mut panel, &mut upper], rows, kind);
    let mut exchanges = Vec::new();
    match kind {
        Kind::Cholesky => {
            if !dense::cholesky(&mut panel, rows, s, least) {
                return None;
            }
            dense::update_symmetric(&mut schur, &panel, rows, s);
        }
        Kind::Lu => {
            let (swaps, small) = dense::lu(&mut panel, rows, s, &mut upper, least);
            exchanges = swaps;
            replaced += small;
            dense::update_general(&mut schur, &panel, rows, s, &upper);
        }
    }
    fronts.push(Front { panel, upper, exchanges });
    Some(Done { schur, fronts, replaced })
}

/// Adds a child's Schur complement to the front. Cholesky: lower triangle alone.
fn extend_add(child: &[f64], places: &[u32], own: usize, to: [&mut Vec<f64>; 3], rows: usize, kind: Kind) {
    let [panel, upper, schur] = to;
    let n = 3 * places.len();
    let s = 3 * own;
    let b = rows - s;
    for (j, &pj) in places.iter().enumerate() {
        for c in 0..3 {
            let (from, column) = (3 * j + c, 3 * pj as usize + c);
            let first = if kind == Kind::Cholesky { j } else { 0 };
            for (i, &pi) in places.iter().enumerate().skip(first) {
                let row = 3 * pi as usize;
                let source = &child[from * n + 3 * i..][..3];
                let target = if column < s {
                    &mut panel[column * rows + row..][..3]
                } else if row < s {
                    // Above the diagonal of a symmetric front: never looked at.
                    match kind {
                        Kind::Cholesky => continue,
                        Kind::Lu => &mut upper[(column - s) * s + row..][..3],
                    }
                } else {
                    &mut schur[(column - s) * b + row - s..][..3]
                };
                target.iter_mut().zip(source).for_each(|(t, v)| *t += v);
            }
        }
    }
}

/// Adds the matrix's rows and columns of the front's own vertices.
fn gather(
    analysis: &Analysis,
    node: &Node,
    matrix: &BlockMatrix,
    [panel, upper]: [&mut Vec<f64>; 2],
    rows: usize,
    kind: Kind,
) {
    let s = 3 * node.own;
    let end = node.start + node.own;
    for j in 0..node.own {
        let vertex = analysis.order[node.start + j];
        for slot in analysis.pattern.range(vertex) {
            let place =
                analysis.place[analysis.pattern.row(vertex)[slot - analysis.pattern.range(vertex).start] as usize];
            let at = place as usize;
            if at < node.start {
                continue;
            }
            let block = matrix.block(slot);
            if at < end {
                // Both own: this block row, exact for both kinds since the pattern holds both triangles.
                let column = at - node.start;
                for r in 0..3 {
                    for c in 0..3 {
                        panel[(3 * column + c) * rows + 3 * j + r] += block[3 * r + c];
                    }
                }
                continue;
            }
            let row = 3 * (node.own + node.boundary.binary_search(&place).unwrap_or(0));
            // Block (own, boundary) is at hand; its mirror (boundary, own) is fetched for LU.
            let mirror = match kind {
                Kind::Cholesky => None,
                Kind::Lu => analysis
                    .pattern
                    .row(analysis.order[at])
                    .binary_search(&vertex)
                    .ok()
                    .map(|k| matrix.block(analysis.pattern.range(analysis.order[at]).start + k)),
            };
            for r in 0..3 {
                for c in 0..3 {
                    let below = mirror.map_or(block[3 * c + r], |m| m[3 * r + c]);
                    panel[(3 * j + c) * rows + row + r] += below;
                    if kind == Kind::Lu {
                        upper[(row - s + c) * s + 3 * j + r] += block[3 * r + c];
                    }
                }
            }
        }
    }
}

/// A front's own unknowns and behind them those of its boundary.
fn collect(node: &Node, x: &[f64], part: &mut Vec<f64>) {
    part.clear();
    part.extend_from_slice(&x[3 * node.start..][..3 * node.own]);
    for &place in &node.boundary {
        part.extend_from_slice(&x[3 * place as usize..][..3]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::energy::Stencil;
    use crate::solver::sparse::Pattern;
    use nalgebra::DMatrix;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    /// Triangles of a grid and a separate small part.
    fn pattern(n: u32) -> Arc<Pattern> {
        let mut vertices = Vec::new();
        for i in 0..n - 1 {
            for j in 0..n - 1 {
                let v = i * n + j;
                vertices.extend([v, v + 1, v + n, v + n + 1]);
            }
        }
        let alone = n * n;
        vertices.extend([alone, alone + 1, alone + 2, alone + 3]);
        let stencil = Stencil { width: 4, vertices };
        Arc::new(Pattern::new((n * n + 5) as usize, &[&stencil]).unwrap())
    }
    fn random(pattern: &Arc<Pattern>, symmetric: bool, diagonal: f64) -> (BlockMatrix, DMatrix<f64>) {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let n = pattern.vertex_count();
        let mut matrix = BlockMatrix::new(pattern.clone());
        let mut dense = DMatrix::zeros(3 * n, 3 * n);
        for v in 0..n as u32 {
            for &w in pattern.row(v) {
                if symmetric && w < v {
                    continue;
                }
                let mut pair = [0.0; 36];
                for i in 0..3 {
                    for j in 0..3 {
                        let value: f64 = rng.random_range(-1.0..1.0);
                        if v == w {
                            let value = if i == j {
                                diagonal + value
                            } else if symmetric && j < i {
                                continue;
                            } else {
                                value
                            };
                            for (a, b) in if symmetric && i != j { vec![(i, j), (j, i)] } else { vec![(i, j)] } {
                                pair[6 * a + b] = value;
                                dense[(3 * v as usize + a, 3 * v as usize + b)] = value;
                            }
                        } else {
                            pair[6 * i + 3 + j] = value;
                            dense[(3 * v as usize + i, 3 * w as usize + j)] = value;
                            if symmetric {
                                pair[6 * (3 + j) + i] = value;
                                dense[(3 * w as usize + j, 3 * v as usize + i)] = value;
                            }
                        }
                    }
                }
                if v == w {
                    let one: Vec<f64> = (0..9).map(|k| pair[6 * (k / 3) + k % 3]).collect();
                    let slots = pattern.slots(&Stencil { width: 1, vertices: vec![v] }).unwrap();
                    matrix.add(&slots, 1, &one);
                } else {
                    let slots = pattern.slots(&Stencil { width: 2, vertices: vec![v, w] }).unwrap();
                    matrix.add(&slots, 2, &pair);
                }
            }
        }
        (matrix, dense)
    }

    #[test]
    fn both_factorisations_solve_what_dense_algebra_solves() {
        for n in [2, 5, 17] {
            let pattern = pattern(n);
            let analysis = Arc::new(Analysis::new(pattern.clone()));
            let mut seen = analysis.order.clone();
            seen.sort_unstable();
            assert_eq!(seen, (0..pattern.vertex_count() as u32).collect::<Vec<_>>(), "every vertex once");
            for (kind, symmetric, diagonal) in
                [(Kind::Cholesky, true, 40.0), (Kind::Lu, true, 40.0), (Kind::Lu, false, 30.0), (Kind::Lu, true, 6.0)]
            {
                let (matrix, dense) = random(&pattern, symmetric, diagonal);
                let b: Vec<f64> = (0..dense.nrows()).map(|i| (i as f64 * 0.7).sin()).collect();
                let product = &dense * nalgebra::DVector::from_vec(b.clone());
                let close = |a: &[f64], b: &[f64], tolerance: f64| {
                    let scale = b.iter().fold(0.0f64, |m, v| m.max(v.abs()));
                    let worst = a.iter().zip(b).fold(0.0f64, |m, (a, b)| m.max((a - b).abs()));
                    assert!(worst <= tolerance * scale, "{kind:?} n {n} diagonal {diagonal}: {worst:e} of {scale:e}");
                };
                close(&matrix.multiply(&b), product.as_slice(), 1e-14);
                let transposed = dense.transpose() * nalgebra::DVector::from_vec(b.clone());
                close(&matrix.multiply_transposed(&b), transposed.as_slice(), 1e-14);
                let factor = Factor::new(&analysis, &matrix, kind).unwrap().unwrap();
                // An indefinite matrix is worse conditioned, and exchanges stay inside fronts.
                let tolerance = if diagonal > 10.0 { 1e-12 } else { 1e-8 };
                close(&matrix.multiply(&factor.solve(&b)), &b, tolerance);
                close(&matrix.multiply_transposed(&factor.solve_transposed(&b)), &b, tolerance);
            }
            let (indefinite, _) = random(&pattern, true, -3.0);
            assert!(Factor::new(&analysis, &indefinite, Kind::Cholesky).unwrap().is_none());
        }
    }

    #[test]
    fn bits_do_not_depend_on_threads() {
        let pattern = pattern(23);
        let analysis = Arc::new(Analysis::new(pattern.clone()));
        let (matrix, _) = random(&pattern, true, 40.0);
        let b: Vec<f64> = (0..3 * pattern.vertex_count()).map(|i| (i as f64).cos()).collect();
        let with = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| Factor::new(&analysis, &matrix, Kind::Cholesky).unwrap().unwrap().solve(&b))
        };
        assert_eq!(with(1), with(3));
    }

    #[test]
    fn no_vertices_is_no_work() {
        let pattern = Arc::new(Pattern::new(0, &[]).unwrap());
        let analysis = Arc::new(Analysis::new(pattern.clone()));
        let factor = Factor::new(&analysis, &BlockMatrix::new(pattern), Kind::Cholesky).unwrap().unwrap();
        assert!(factor.solve(&[]).is_empty());
    }
}
