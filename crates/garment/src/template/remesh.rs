//! Even triangles: split, collapse, flip and relax edges, always back on the level function and the cuts.

use super::shape::Shape;
use caphy_core::{TriMesh, Vec3};

/// Cut of a vertex that lies on none.
pub(crate) const INTERIOR: u8 = u8::MAX;
/// Edges sharper than this angle's cosine (50°) are eased, so many times at most.
const CREASE_COSINE: f64 = 0.643;
const CREASE_ROUNDS: usize = 12;
const DEAD: [u32; 3] = [u32::MAX; 3];

/// The one or two faces at an edge.
#[derive(Clone, Copy)]
struct EdgeFaces {
    ids: [u32; 2],
    count: usize,
}

impl std::ops::Deref for EdgeFaces {
    type Target = [u32];
    fn deref(&self) -> &[u32] {
        &self.ids[..self.count]
    }
}

struct Remesher<'a, 'b> {
    shape: &'a Shape<'b>,
    target: f64,
    vertices: Vec<Vec3>,
    /// Cut that a boundary vertex lies on, or [`INTERIOR`].
    cut: Vec<u8>,
    faces: Vec<[u32; 3]>,
    /// Vertices that have left the level function.
    free: Vec<bool>,
    /// Faces around each vertex.
    around: Vec<Vec<u32>>,
}

/// Remeshes to edges of about `target` [m]; gives the cut of each vertex too.
pub(crate) fn remesh(shape: &Shape<'_>, mesh: &TriMesh, target: f64) -> (TriMesh, Vec<u8>) {
    let mut r = Remesher::new(shape, mesh, target);
    // From coarse edits to fine ones: first the number of vertices, then their places.
    for round in 0..6 {
        r.trim_ears();
        r.split_long(1.35 * target);
        r.collapse_short(0.78 * target);
        r.flip();
        r.relax(if round < 2 { 0.5 } else { 0.9 });
    }
    for _ in 0..4 {
        r.flip();
        r.relax(0.9);
    }
    r.ease_creases();
    r.collapse_short(0.6 * target);
    r.flip();
    r.finish()
}

impl<'a, 'b> Remesher<'a, 'b> {
    fn new(shape: &'a Shape<'b>, mesh: &TriMesh, target: f64) -> Self {
        let mut r = Self {
            shape,
            target,
            vertices: mesh.vertices.clone(),
            cut: vec![INTERIOR; mesh.vertices.len()],
            faces: mesh.faces.clone(),
            free: vec![false; mesh.vertices.len()],
            around: vec![Vec::new(); mesh.vertices.len()],
        };
        for (f, face) in r.faces.iter().enumerate() {
            for &v in face {
                r.around[v as usize].push(f as u32);
            }
        }
        for (a, b) in r.edges() {
            if r.edge_faces(a, b).len() == 1 {
                for v in [a, b] {
                    let p = &r.vertices[v as usize];
                    let nearest = (0..shape.cuts.len())
                        .min_by(|&i, &j| shape.cuts[i].value(p).abs().total_cmp(&shape.cuts[j].value(p).abs()));
                    r.cut[v as usize] = nearest.map_or(INTERIOR, |k| k as u8);
                }
            }
        }
        r
    }
    /// Edges once each, in the order of faces. Neighbouring faces run along an edge in opposite senses: one of them low to high.
    fn edges(&self) -> Vec<(u32, u32)> {
        let sides = self.faces.iter().filter(|f| **f != DEAD).flat_map(|&[a, b, c]| [(a, b), (b, c), (c, a)]);
        sides.filter(|&(a, b)| a < b || self.edge_faces(a, b).len() == 1).map(|(a, b)| (a.min(b), a.max(b))).collect()
    }
    fn length(&self, a: u32, b: u32) -> f64 {
        (self.vertices[a as usize] - self.vertices[b as usize]).norm()
    }
    fn edge_faces(&self, a: u32, b: u32) -> EdgeFaces {
        let mut out = EdgeFaces { ids: [0; 2], count: 0 };
        for &f in &self.around[a as usize] {
            if out.count < 2 && self.faces[f as usize].contains(&b) {
                out.ids[out.count] = f;
                out.count += 1;
            }
        }
        out
    }
    fn neighbours(&self, v: u32) -> Vec<u32> {
        let mut out: Vec<u32> =
            self.around[v as usize].iter().flat_map(|&f| self.faces[f as usize]).filter(|&w| w != v).collect();
        out.sort_unstable();
        out.dedup();
        out
    }
    fn on_cut(&self, v: u32) -> bool {
        self.cut[v as usize] != INTERIOR
    }
    fn normal(&self, f: &[u32; 3]) -> Vec3 {
        let [a, b, c] = f.map(|v| self.vertices[v as usize]);
        (b - a).cross(&(c - a))
    }
    fn opposite(&self, face: u32, a: u32, b: u32) -> u32 {
        self.faces[face as usize].into_iter().find(|&v| v != a && v != b).unwrap_or(a)
    }
    fn project(&self, v: usize, p: Vec3, steps: usize) -> Vec3 {
        let longest = 0.5 * self.target;
        match self.cut[v] {
            INTERIOR => self.shape.project(&p, steps, longest),
            cut => self.shape.project_to_cut(&p, usize::from(cut), steps + 1, longest),
        }
    }
    /// Edges by length, longest or shortest first.
    fn sorted_edges(&self, keep: impl Fn(f64) -> bool, longest_first: bool) -> Vec<(f64, u32, u32)> {
        let mut list: Vec<(f64, u32, u32)> =
            self.edges().into_iter().map(|(a, b)| (self.length(a, b), a, b)).filter(|e| keep(e.0)).collect();
        list.sort_by(|x, y| {
            let by_length = if longest_first { y.0.total_cmp(&x.0) } else { x.0.total_cmp(&y.0) };
            by_length.then((x.1, x.2).cmp(&(y.1, y.2)))
        });
        list
    }

    fn split_long(&mut self, limit: f64) {
        for (_, a, b) in self.sorted_edges(|l| l > limit, true) {
            let faces = self.edge_faces(a, b);
            if faces.is_empty() {
                continue;
            }
            let m = self.vertices.len() as u32;
            self.vertices.push((self.vertices[a as usize] + self.vertices[b as usize]) * 0.5);
            self.cut.push(if faces.len() == 1 { self.cut[a as usize] } else { INTERIOR });
            self.around.push(Vec::new());
            self.free.push(false);
            for &f in faces.iter() {
                let old = self.faces[f as usize];
                let added = self.faces.len() as u32;
                // The old face keeps a's side, the new one takes b's.
                self.faces[f as usize] = old.map(|v| if v == b { m } else { v });
                self.faces.push(old.map(|v| if v == a { m } else { v }));
                self.around[b as usize].retain(|&g| g != f);
                self.around[b as usize].push(added);
                self.around[m as usize].extend([f, added]);
                let c = old.into_iter().find(|&v| v != a && v != b).unwrap_or(a);
                self.around[c as usize].push(added);
            }
            self.vertices[m as usize] = self.project(m as usize, self.vertices[m as usize], 2);
        }
    }

    fn collapse_short(&mut self, limit: f64) {
        for (_, a, b) in self.sorted_edges(|l| l < limit, false) {
            if self.length(a, b) < limit {
                self.collapse(a, b);
            }
        }
    }
    fn collapse(&mut self, a: u32, b: u32) {
        let shared = self.edge_faces(a, b);
        if shared.is_empty() || (shared.len() == 2 && self.on_cut(a) && self.on_cut(b)) {
            return;
        }
        let (near_a, near_b) = (self.neighbours(a), self.neighbours(b));
        let common = near_a.iter().filter(|v| near_b.binary_search(v).is_ok()).count();
        // What is left around the merged vertex: at least four neighbours, three on a cut.
        let fewest = if shared.len() == 1 { 6 } else { 8 };
        if common != shared.len() || near_a.len() + near_b.len() < fewest {
            return;
        }
        let (pa, pb) = (self.vertices[a as usize], self.vertices[b as usize]);
        let place = match (self.on_cut(a), self.on_cut(b)) {
            (true, false) => pa,
            (false, true) => pb,
            _ => (pa + pb) * 0.5,
        };
        let longest = 1.3 * self.target;
        let too_long = |list: &[u32]| {
            list.iter().any(|&v| v != a && v != b && (self.vertices[v as usize] - place).norm() > longest)
        };
        if too_long(&near_a) || too_long(&near_b) {
            return;
        }
        for v in [a, b] {
            for &f in self.around[v as usize].iter().filter(|f| !shared.contains(f)) {
                let face = self.faces[f as usize];
                let before = self.normal(&face);
                let [p, q, r] = face.map(|w| if w == v { place } else { self.vertices[w as usize] });
                let after = (q - p).cross(&(r - p));
                // Slivers of the cut may turn freely; they have no shape to lose.
                let sliver = before.norm() < 0.02 * self.target * self.target;
                if after.norm() < 1e-3 * self.target * self.target
                    || (!sliver && after.dot(&before) < 0.3 * after.norm() * before.norm())
                {
                    return;
                }
            }
        }
        for &f in shared.iter() {
            for v in self.faces[f as usize] {
                self.around[v as usize].retain(|&g| g != f);
            }
            self.faces[f as usize] = DEAD;
        }
        for f in std::mem::take(&mut self.around[b as usize]) {
            for v in &mut self.faces[f as usize] {
                if *v == b {
                    *v = a;
                }
            }
            self.around[a as usize].push(f);
        }
        if self.cut[a as usize] == INTERIOR {
            self.cut[a as usize] = self.cut[b as usize];
        }
        self.free[a as usize] |= self.free[b as usize] && self.cut[a as usize] == INTERIOR;
        self.vertices[a as usize] = place;
    }

    /// Drops triangles that hang on the rest by one edge only.
    fn trim_ears(&mut self) {
        for v in 0..self.vertices.len() {
            if let &[f] = self.around[v].as_slice() {
                let face = self.faces[f as usize];
                if face.iter().any(|&w| w as usize != v && self.around[w as usize].len() < 2) {
                    continue;
                }
                for w in face {
                    self.around[w as usize].retain(|&g| g != f);
                }
                self.faces[f as usize] = DEAD;
                self.cut[v] = INTERIOR;
            }
        }
    }

    /// Flips edges whose flip brings the numbers of neighbours nearer to six (four on a cut), or, at equal numbers, the two
    /// angles that face the edge nearer to Delaunay's.
    fn flip(&mut self) {
        for (a, b) in self.edges() {
            let faces = self.edge_faces(a, b);
            let &[f, g] = &*faces else { continue };
            let (c, d) = (self.opposite(f, a, b), self.opposite(g, a, b));
            if c == d || !self.edge_faces(c, d).is_empty() || (self.on_cut(c) && self.on_cut(d)) {
                continue;
            }
            let ideal = |v: u32| if self.on_cut(v) { 4.0 } else { 6.0 };
            let count = |v: u32| self.around[v as usize].len() as f64 + if self.on_cut(v) { 1.0 } else { 0.0 };
            let off = |v: u32, change: f64| (count(v) + change - ideal(v)).powi(2);
            let before = off(a, 0.0) + off(b, 0.0) + off(c, 0.0) + off(d, 0.0);
            let after = off(a, -1.0) + off(b, -1.0) + off(c, 1.0) + off(d, 1.0);
            if count(a) <= 3.0 || count(b) <= 3.0 || after > before {
                continue;
            }
            let angle = |apex: u32, p: u32, q: u32| {
                let at = self.vertices[apex as usize];
                (self.vertices[p as usize] - at).angle(&(self.vertices[q as usize] - at))
            };
            let facing = angle(c, a, b) + angle(d, a, b);
            let facing_after = angle(a, c, d) + angle(b, c, d);
            if after == before && facing <= facing_after + 0.1 {
                continue;
            }
            if facing_after > 4.2 {
                continue;
            }
            // Face f runs a → b or b → a: keep its sense.
            let face = self.faces[f as usize];
            let forward = (0..3).any(|k| face[k] == a && face[(k + 1) % 3] == b);
            let (new_f, new_g) = if forward { ([c, a, d], [d, b, c]) } else { ([c, d, a], [d, c, b]) };
            let old = self.normal(&face) + self.normal(&self.faces[g as usize]);
            let fits = |t: &[u32; 3]| {
                let n = self.normal(t);
                n.dot(&old) > 0.5 * n.norm() * old.norm() && n.norm() > 1e-3 * self.target * self.target
            };
            if !fits(&new_f) || !fits(&new_g) {
                continue;
            }
            self.faces[f as usize] = new_f;
            self.faces[g as usize] = new_g;
            self.around[b as usize].retain(|&x| x != f);
            self.around[a as usize].retain(|&x| x != g);
            self.around[d as usize].push(f);
            self.around[c as usize].push(g);
        }
    }

    /// Moves vertices along the surface towards the middle of their neighbours, all from the same old places.
    fn relax(&mut self, amount: f64) {
        let mut next = self.vertices.clone();
        for v in 0..self.vertices.len() {
            if self.around[v].is_empty() {
                continue;
            }
            let p = self.vertices[v];
            let near = self.neighbours(v as u32);
            let goal = if self.on_cut(v as u32) {
                let ends: Vec<u32> =
                    near.into_iter().filter(|&w| self.on_cut(w) && self.edge_faces(v as u32, w).len() == 1).collect();
                let &[l, r] = ends.as_slice() else { continue };
                let (l, r) = (self.vertices[l as usize], self.vertices[r as usize]);
                let along = (r - l).try_normalize(0.0).unwrap_or_else(Vec3::zeros);
                p + along * ((l + r) * 0.5 - p).dot(&along)
            } else {
                // Triangles that are too large pull: areas even out, not only angles.
                let (mut sum, mut total) = (Vec3::zeros(), 0.0);
                let mut normal = Vec3::zeros();
                for &f in &self.around[v] {
                    let face = self.faces[f as usize];
                    let n = self.normal(&face);
                    let centre = face.iter().map(|&w| self.vertices[w as usize]).sum::<Vec3>() / 3.0;
                    sum += centre * n.norm();
                    total += n.norm();
                    normal += n;
                }
                if total <= 0.0 {
                    continue;
                }
                let normal = normal.try_normalize(0.0).unwrap_or_else(Vec3::zeros);
                let step = sum / total - p;
                p + (step - normal * step.dot(&normal))
            };
            next[v] = self.project(v, p + (goal - p) * amount, 2);
        }
        self.vertices = next;
    }

    /// Rounds what the mesh is too coarse to follow (a crotch between close thighs): vertices at sharp edges leave the level
    /// function for the middle of their neighbours.
    fn ease_creases(&mut self) {
        for _ in 0..CREASE_ROUNDS {
            let mut sharp = vec![false; self.vertices.len()];
            for (a, b) in self.edges() {
                if let &[f, g] = &*self.edge_faces(a, b) {
                    let (n, m) = (self.normal(&self.faces[f as usize]), self.normal(&self.faces[g as usize]));
                    if n.dot(&m) < CREASE_COSINE * n.norm() * m.norm() {
                        for v in [a, b, self.opposite(f, a, b), self.opposite(g, a, b)] {
                            sharp[v as usize] = !self.on_cut(v) || sharp[v as usize];
                        }
                    }
                }
            }
            if !sharp.contains(&true) {
                return;
            }
            let mut next = self.vertices.clone();
            for v in (0..sharp.len()).filter(|&v| sharp[v]) {
                let near = self.neighbours(v as u32);
                let mean = near.iter().map(|&w| self.vertices[w as usize]).sum::<Vec3>() / near.len().max(1) as f64;
                next[v] = self.vertices[v].lerp(&mean, 0.3);
                self.free[v] = true;
            }
            self.vertices = next;
        }
    }

    fn finish(self) -> (TriMesh, Vec<u8>) {
        let mut id = vec![u32::MAX; self.vertices.len()];
        let (mut vertices, mut cut) = (Vec::new(), Vec::new());
        for v in 0..self.vertices.len() {
            if !self.around[v].is_empty() {
                id[v] = vertices.len() as u32;
                let p = self.vertices[v];
                vertices.push(if self.free[v] { p } else { self.project(v, p, 6) });
                cut.push(self.cut[v]);
            }
        }
        let faces = self.faces.iter().filter(|f| **f != DEAD).map(|f| f.map(|v| id[v as usize])).collect();
        (TriMesh { vertices, faces }, cut)
    }
}
