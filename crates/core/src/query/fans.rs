//! Triangles around vertices.

/// The triangles around each vertex, in compressed rows, each row in the order of the faces.
#[derive(Debug, Clone, PartialEq)]
pub struct Fans {
    offsets: Vec<u32>,
    faces: Vec<u32>,
}

impl Fans {
    /// From the faces of a mesh of `vertex_count` vertices; each of their vertices is one of these.
    pub fn new(vertex_count: usize, faces: &[[u32; 3]]) -> Self {
        let mut offsets = vec![0u32; vertex_count + 1];
        for &v in faces.iter().flatten() {
            offsets[v as usize + 1] += 1;
        }
        for v in 0..vertex_count {
            offsets[v + 1] += offsets[v];
        }
        let mut at = offsets.clone();
        let mut around = vec![0; 3 * faces.len()];
        for (f, face) in faces.iter().enumerate() {
            for &v in face {
                around[at[v as usize] as usize] = f as u32;
                at[v as usize] += 1;
            }
        }
        Self { offsets, faces: around }
    }
    /// Faces around one vertex; none around a vertex that the mesh does not have.
    pub fn of(&self, vertex: usize) -> &[u32] {
        match self.offsets.get(vertex..vertex + 2) {
            Some(range) => &self.faces[range[0] as usize..range[1] as usize],
            None => &[],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_vertex_knows_its_triangles() {
        let fans = Fans::new(5, &[[0, 1, 2], [2, 1, 3]]);
        assert_eq!([0, 1, 2, 3, 4].map(|v| fans.of(v).to_vec()), [vec![0], vec![0, 1], vec![0, 1], vec![1], vec![]]);
        assert!(fans.of(5).is_empty() && fans.of(17).is_empty());
    }
}
