//! Elimination order by nested dissection, and the symbolic part of the factorisation.
//!
//! Garments are surfaces: a level set of a breadth-first search from one end cuts them in two with few vertices, again and again.
//! The tree of cuts is the elimination tree, and every cut is one dense front, so that nothing else needs to be found out.

use super::sparse::Pattern;
use std::sync::Arc;

/// Parts of at most this many vertices are not cut further.
const LEAF: usize = 16;
/// Searches whose levels are tried as cuts of a part.
const CANDIDATES: usize = 6;
/// Weight of a half's n^1.5 against a cut's cube, in vertices.
const HALF: f64 = 30.0;

/// A front: vertices that are eliminated together.
#[derive(Debug, Clone)]
pub(super) struct Node {
    /// First of its own vertices in the elimination order.
    pub(super) start: usize,
    /// Number of its own vertices.
    pub(super) own: usize,
    /// Places in the elimination order of the vertices that are updated, ascending; all behind its own.
    pub(super) boundary: Vec<u32>,
    /// Fronts that come before.
    pub(super) children: Vec<usize>,
    /// For each child the place in this front (own vertices first) of each of its boundary vertices.
    pub(super) places: Vec<Vec<u32>>,
}

/// The symbolic part: it depends on the pattern alone.
#[derive(Debug, Clone)]
pub struct Analysis {
    pub(super) pattern: Arc<Pattern>,
    /// Vertex at each place of the elimination order.
    pub(super) order: Vec<u32>,
    /// Place of each vertex.
    pub(super) place: Vec<u32>,
    /// Fronts, children before parents; the last is the root.
    pub(super) nodes: Vec<Node>,
}

/// The tree of cuts before fronts are worked out.
struct Cut {
    own: Vec<u32>,
    children: Vec<Cut>,
}

impl Analysis {
    /// Orders a pattern.
    pub fn new(pattern: Arc<Pattern>) -> Self {
        let n = pattern.vertex_count();
        let mut side = vec![u32::MAX; n];
        let mut dissection = Dissection { pattern: &pattern, level: vec![u32::MAX; n], inside: &mut side };
        let root = dissection.cut((0..n as u32).collect());
        let mut out =
            Self { pattern: pattern.clone(), order: Vec::with_capacity(n), place: vec![0; n], nodes: Vec::new() };
        out.number(&root);
        for (at, &v) in out.order.iter().enumerate() {
            out.place[v as usize] = at as u32;
        }
        for id in 0..out.nodes.len() {
            out.work_out(id);
        }
        out
    }
    /// Gives places in postorder; returns the front's number.
    fn number(&mut self, cut: &Cut) -> usize {
        let children = cut.children.iter().map(|c| self.number(c)).collect();
        let start = self.order.len();
        self.order.extend(&cut.own);
        self.nodes.push(Node { start, own: cut.own.len(), boundary: Vec::new(), children, places: Vec::new() });
        self.nodes.len() - 1
    }
    fn work_out(&mut self, id: usize) {
        let node = &self.nodes[id];
        let end = node.start + node.own;
        let mut boundary: Vec<u32> = (node.start..end)
            .flat_map(|at| self.pattern.row(self.order[at]).iter().map(|&v| self.place[v as usize]))
            .chain(node.children.iter().flat_map(|&c| self.nodes[c].boundary.iter().copied()))
            .filter(|&place| place as usize >= end)
            .collect();
        boundary.sort_unstable();
        boundary.dedup();
        let place = |at: u32| {
            if (at as usize) < end {
                at - node.start as u32
            } else {
                // Every vertex behind this front that a child updates was collected above.
                (node.own + boundary.binary_search(&at).unwrap_or(0)) as u32
            }
        };
        let places =
            node.children.iter().map(|&c| self.nodes[c].boundary.iter().map(|&at| place(at)).collect()).collect();
        let node = &mut self.nodes[id];
        node.boundary = boundary;
        node.places = places;
    }
    /// Values that a symmetric factor stores.
    pub fn factor_values(&self) -> usize {
        self.nodes.iter().map(|n| 9 * n.own * (n.own + n.boundary.len())).sum()
    }
    /// Multiplications and additions of a symmetric factorisation, about.
    pub fn flops(&self) -> f64 {
        let cost = |n: &Node| {
            let (s, b) = (3.0 * n.own as f64, 3.0 * n.boundary.len() as f64);
            s * s * s / 3.0 + s * s * b + s * b * b
        };
        self.nodes.iter().map(cost).sum()
    }
}

struct Dissection<'a> {
    pattern: &'a Pattern,
    level: Vec<u32>,
    /// Number of the part that each vertex belongs to at present.
    inside: &'a mut Vec<u32>,
}

impl Dissection<'_> {
    fn cut(&mut self, part: Vec<u32>) -> Cut {
        if part.len() <= LEAF {
            return Cut { own: part, children: Vec::new() };
        }
        // Marks are unique per part: its first vertex is in no other part at the same time.
        let mark = part[0];
        part.iter().for_each(|&v| self.inside[v as usize] = mark);
        let first = self.search(part[0], mark);
        if first.len() < part.len() {
            let mut parts = vec![first];
            let mut seen: usize = parts[0].len();
            for &v in &part {
                if seen < part.len() && self.level[v as usize] == u32::MAX {
                    let next = self.search(v, mark);
                    seen += next.len();
                    parts.push(next);
                }
            }
            self.forget(&part);
            return Cut { own: Vec::new(), children: parts.into_iter().map(|p| self.cut(p)).collect() };
        }
        // From one end to the other, and across: the farthest vertex of the farthest vertex, then the ends of the middle level.
        self.forget(&part);
        let mut roots = vec![first.last().copied().unwrap_or(mark)];
        let mut best: Option<(f64, u32, Vec<u32>, Vec<u32>)> = None;
        for round in 0..CANDIDATES {
            let Some(&root) = roots.get(round) else { break };
            let sorted = self.search(root, mark);
            if round < 2 {
                roots.push(sorted.last().copied().unwrap_or(root));
            }
            if round == 1 {
                let middle = self.level[sorted[sorted.len() / 2] as usize];
                let ring: Vec<u32> = sorted.iter().copied().filter(|&v| self.level[v as usize] == middle).collect();
                roots.extend([ring[0], ring[ring.len() / 2], ring[ring.len() - 1]]);
            }
            if let Some((cost, level)) = self.cheapest_level(&sorted)
                && best.as_ref().is_none_or(|b| cost < b.0)
            {
                let levels = sorted.iter().map(|&v| self.level[v as usize]).collect();
                best = Some((cost, level, sorted, levels));
            }
            self.forget(&part);
        }
        let Some((_, cut, sorted, levels)) = best else { return Cut { own: part, children: Vec::new() } };
        for (&v, level) in sorted.iter().zip(levels) {
            self.level[v as usize] = level;
        }
        let (mut own, mut near, mut far) = (Vec::new(), Vec::new(), Vec::new());
        for &v in &sorted {
            let level = self.level[v as usize];
            // A vertex of the cut that touches nothing beyond it need not be in it.
            let needed = |me: &Self| {
                me.pattern.row(v).iter().any(|&w| me.inside[w as usize] == mark && me.level[w as usize] == cut + 1)
            };
            match level.cmp(&cut) {
                std::cmp::Ordering::Less => near.push(v),
                std::cmp::Ordering::Greater => far.push(v),
                std::cmp::Ordering::Equal if needed(self) => own.push(v),
                std::cmp::Ordering::Equal => near.push(v),
            }
        }
        self.forget(&part);
        own.iter().for_each(|&v| self.inside[v as usize] = u32::MAX);
        near.iter().for_each(|&v| self.inside[v as usize] = u32::MAX);
        far.iter().for_each(|&v| self.inside[v as usize] = u32::MAX);
        Cut { own, children: vec![self.cut(near), self.cut(far)] }
    }
    /// The level whose removal makes the least work, with that work.
    fn cheapest_level(&self, sorted: &[u32]) -> Option<(f64, u32)> {
        let depth = sorted.last().map_or(0, |&v| self.level[v as usize]) as usize + 1;
        let mut sizes = vec![0usize; depth];
        // Vertices of a level that touch nothing beyond it need not be cut.
        for &v in sorted {
            let level = self.level[v as usize];
            if self.pattern.row(v).iter().any(|&w| self.level[w as usize] == level + 1) {
                sizes[level as usize] += 1;
            }
        }
        let mut counts = vec![0usize; depth];
        sorted.iter().for_each(|&v| counts[self.level[v as usize] as usize] += 1);
        let mut before = 0;
        let mut best: Option<(f64, u32)> = None;
        for (level, &size) in sizes.iter().enumerate() {
            let after = sorted.len() - before - counts[level];
            if before > 0 && after > 0 {
                // Work grows with the cube of a cut and with n^1.5 of each half.
                let halves = (before as f64).powf(1.5) + (after as f64).powf(1.5);
                let cost = (size as f64).powi(3) * 4.0 + halves * HALF;
                if best.is_none_or(|b| cost < b.0) {
                    best = Some((cost, level as u32));
                }
            }
            before += counts[level];
        }
        best
    }
    fn forget(&mut self, part: &[u32]) {
        part.iter().for_each(|&v| self.level[v as usize] = u32::MAX);
    }
    /// Vertices of the part that can be reached, nearest first; writes their levels.
    fn search(&mut self, from: u32, mark: u32) -> Vec<u32> {
        let mut queue = vec![from];
        self.level[from as usize] = 0;
        let mut at = 0;
        while let Some(&v) = queue.get(at) {
            at += 1;
            for &w in self.pattern.row(v) {
                if self.inside[w as usize] == mark && self.level[w as usize] == u32::MAX {
                    self.level[w as usize] = self.level[v as usize] + 1;
                    queue.push(w);
                }
            }
        }
        queue
    }
}
