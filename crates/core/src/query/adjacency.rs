//! Neighbours of vertices.

/// Neighbours of each vertex along edges, in compressed rows, each row sorted.
#[derive(Debug, Clone, PartialEq)]
pub struct Adjacency {
    offsets: Vec<u32>,
    neighbours: Vec<u32>,
}

impl Adjacency {
    /// From the faces of a mesh of `vertex_count` vertices.
    pub fn new(vertex_count: usize, faces: &[[u32; 3]]) -> Self {
        let mut pairs: Vec<(u32, u32)> =
            faces.iter().flat_map(|&[a, b, c]| [(a, b), (b, a), (b, c), (c, b), (c, a), (a, c)]).collect();
        pairs.sort_unstable();
        pairs.dedup();
        let mut offsets = vec![0u32; vertex_count + 1];
        for &(a, _) in &pairs {
            offsets[a as usize + 1] += 1;
        }
        for i in 0..vertex_count {
            offsets[i + 1] += offsets[i];
        }
        Self { offsets, neighbours: pairs.into_iter().map(|(_, b)| b).collect() }
    }
    /// Neighbours of one vertex.
    pub fn of(&self, vertex: usize) -> &[u32] {
        &self.neighbours[self.offsets[vertex] as usize..self.offsets[vertex + 1] as usize]
    }
    /// Number of vertices.
    pub fn vertex_count(&self) -> usize {
        self.offsets.len() - 1
    }
    /// Component number of each vertex, and the number of components.
    pub fn components(&self) -> (Vec<u32>, usize) {
        let n = self.vertex_count();
        let mut component = vec![u32::MAX; n];
        let mut count = 0;
        let mut stack = Vec::new();
        for start in 0..n {
            if component[start] != u32::MAX {
                continue;
            }
            component[start] = count;
            stack.push(start);
            while let Some(v) = stack.pop() {
                for &w in self.of(v) {
                    if component[w as usize] == u32::MAX {
                        component[w as usize] = count;
                        stack.push(w as usize);
                    }
                }
            }
            count += 1;
        }
        (component, count as usize)
    }
}
