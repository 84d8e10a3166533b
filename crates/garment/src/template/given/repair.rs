//! One oriented manifold piece out of what files hold: what is safe is repaired and counted, the rest refused by element.

use super::GivenMesh;
use caphy_core::{Error, Result, TriMesh, Vec3};
use serde::{Deserialize, Serialize};
use std::collections::HashMap;

/// Boundary vertices nearer than this are the same vertex, written twice along a seam of the texture [m]: rounding of text
/// formats at body scale, far below any edge.
const SAME_PLACE: f64 = 1e-5;
/// Widest gap between two boundary edges that counts as an open seam [m], and as a share of the shorter edge beside it.
const SEAM_GAP: (f64, f64) = (1e-3, 0.2);
/// Pieces with less than this share of the area (buttons, labels) are left out.
const SMALL_PIECE: f64 = 0.05;
/// A triangle lower than this share of its longest side has no usable rest shape (as in [`crate::GarmentRest`]).
const SMALLEST_HEIGHT: f64 = 1e-9;

/// What was repaired, as counts.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Repairs {
    /// Vertices merged with another in the same place (seams of the texture).
    pub welded_vertices: usize,
    /// Vertices merged across an open seam.
    pub closed_seam_vertices: usize,
    /// Widest seam that was closed [m].
    pub widest_seam_m: f64,
    /// Faces left out because merging took their area or because they were there twice.
    pub dropped_faces: usize,
    /// Vertices at which only corners of faces met, split in two.
    pub split_vertices: usize,
    /// Faces turned to agree with their neighbours.
    pub flipped_faces: usize,
    /// Whether the whole garment was turned to face away from the body.
    pub turned_inside_out: bool,
    /// Small pieces left out.
    pub dropped_pieces: usize,
    /// Their share of the area.
    pub dropped_area_share: f64,
    /// Vertices that no face used.
    pub unused_vertices: usize,
}

/// A garment being repaired; vertices and faces remember their number in the file, for messages.
struct Work {
    name: String,
    vertices: Vec<Vec3>,
    vertex_origin: Vec<u32>,
    faces: Vec<[u32; 3]>,
    face_origin: Vec<u32>,
    uv: Option<Vec<[[f64; 2]; 3]>>,
    repairs: Repairs,
}

/// An oriented manifold piece with a boundary; which side faces out is not decided here.
///
/// # Errors
/// [`Error::Mesh`] naming the element: no faces, a vertex that is not finite, ids out of range, a triangle without area, an
/// edge of three faces, an edge at which no orientation fits, several large pieces, no opening. [`Error::NonFinite`] for
/// layout coordinates.
pub(super) fn repair(given: GivenMesh) -> Result<(GivenMesh, Repairs)> {
    let GivenMesh { name, mesh, uv } = given;
    if mesh.faces.is_empty() {
        let problem = format!("{} vertices and no faces", mesh.vertices.len());
        return Err(Error::mesh(name, "whole mesh", problem, "give the garment's surface as triangles"));
    }
    mesh.check(&name)?;
    if let Some(uv) = &uv {
        Error::check_length(&format!("layout corners of {name}"), mesh.faces.len(), uv.len())?;
        Error::check_finite(&format!("layout coordinates of {name}"), uv.as_flattened().as_flattened())?;
    }
    let mut work = Work {
        vertex_origin: (0..mesh.vertices.len() as u32).collect(),
        face_origin: (0..mesh.faces.len() as u32).collect(),
        vertices: mesh.vertices,
        faces: mesh.faces,
        uv,
        name,
        repairs: Repairs::default(),
    };
    work.repairs.unused_vertices = work.compact();
    work.weld();
    work.close_seams();
    work.check_areas()?;
    work.check_edges()?;
    work.split_vertices();
    work.orient()?;
    work.keep_one_piece()?;
    if crate::template::loops::boundary_edge_count(&work.faces) == 0 {
        return Err(Error::mesh(
            work.name,
            "whole mesh",
            "has no opening",
            "give the cloth as a single layer: delete the inner shell and open neck, cuffs, hem or waist",
        ));
    }
    let mesh = TriMesh { vertices: work.vertices, faces: work.faces };
    Ok((GivenMesh { name: work.name, mesh, uv: work.uv }, work.repairs))
}

/// Sides of faces by edge: (low, high), whether the face runs low to high, face.
fn sides(faces: &[[u32; 3]]) -> Vec<([u32; 2], bool, u32)> {
    let mut out = Vec::with_capacity(3 * faces.len());
    for (f, face) in faces.iter().enumerate() {
        for k in 0..3 {
            let (a, b) = (face[k], face[(k + 1) % 3]);
            out.push(([a.min(b), a.max(b)], a < b, f as u32));
        }
    }
    out.sort_unstable();
    out
}

/// Boundary neighbours of each vertex.
fn boundary(vertex_count: usize, faces: &[[u32; 3]]) -> Vec<Vec<u32>> {
    let mut out = vec![Vec::new(); vertex_count];
    for group in sides(faces).chunk_by(|a, b| a.0 == b.0) {
        if let &[([a, b], ..)] = group {
            out[a as usize].push(b);
            out[b as usize].push(a);
        }
    }
    out
}

/// Cells of points for searches within one cell's size.
struct Cells {
    cell: f64,
    ids: HashMap<[i64; 3], Vec<u32>>,
}

impl Cells {
    fn new(points: &[Vec3], ids: impl Iterator<Item = u32>, cell: f64) -> Self {
        let mut out = Self { cell, ids: HashMap::new() };
        for id in ids {
            let key = out.key(&points[id as usize]);
            out.ids.entry(key).or_default().push(id);
        }
        out
    }
    fn key(&self, p: &Vec3) -> [i64; 3] {
        // Casts saturate: points astronomically far away share a cell, and distances tell them apart.
        [0, 1, 2].map(|k| (p[k] / self.cell).floor() as i64)
    }
    /// Everything that may be within a cell's size, in ascending order.
    fn near(&self, p: &Vec3) -> Vec<u32> {
        let [x, y, z] = self.key(p);
        let mut out = Vec::new();
        for i in -1..=1 {
            for j in -1..=1 {
                for k in -1..=1 {
                    let key = [x.saturating_add(i), y.saturating_add(j), z.saturating_add(k)];
                    out.extend(self.ids.get(&key).into_iter().flatten());
                }
            }
        }
        out.sort_unstable();
        out.dedup();
        out
    }
}

impl Work {
    /// Drops vertices without faces; gives their number.
    fn compact(&mut self) -> usize {
        let mut new = vec![u32::MAX; self.vertices.len()];
        self.faces.iter().flatten().for_each(|&v| new[v as usize] = 0);
        let (mut vertices, mut origin) = (Vec::new(), Vec::new());
        for (v, slot) in new.iter_mut().enumerate() {
            if *slot == 0 {
                *slot = vertices.len() as u32;
                vertices.push(self.vertices[v]);
                origin.push(self.vertex_origin[v]);
            }
        }
        let dropped = self.vertices.len() - vertices.len();
        self.faces.iter_mut().flatten().for_each(|v| *v = new[*v as usize]);
        (self.vertices, self.vertex_origin) = (vertices, origin);
        dropped
    }
    fn keep_faces(&mut self, keep: &[bool]) {
        let mut each = keep.iter();
        self.faces.retain(|_| each.next() == Some(&true));
        let mut each = keep.iter();
        self.face_origin.retain(|_| each.next() == Some(&true));
        if let Some(uv) = &mut self.uv {
            let mut each = keep.iter();
            uv.retain(|_| each.next() == Some(&true));
        }
        self.compact();
    }
    /// Replaces vertices by others and drops the faces that lose their area by it, or that repeat another.
    fn merge(&mut self, into: &[u32]) {
        self.faces.iter_mut().flatten().for_each(|v| *v = into[*v as usize]);
        let mut seen = std::collections::HashSet::new();
        let keep: Vec<bool> = self
            .faces
            .iter()
            .map(|f| {
                let mut key = *f;
                key.sort_unstable();
                key[0] != key[1] && key[1] != key[2] && seen.insert(key)
            })
            .collect();
        self.repairs.dropped_faces += keep.iter().filter(|k| !**k).count();
        self.keep_faces(&keep);
    }

    /// Merges boundary vertices in the same place. Only those: layers of cloth that touch inside stay apart.
    fn weld(&mut self) {
        let rims = boundary(self.vertices.len(), &self.faces);
        let on_rim = |v: &u32| !rims[*v as usize].is_empty();
        let cells = Cells::new(&self.vertices, (0..rims.len() as u32).filter(on_rim), SAME_PLACE);
        let mut into: Vec<u32> = (0..rims.len() as u32).collect();
        let mut welded = 0;
        for v in (0..rims.len() as u32).filter(on_rim) {
            let p = self.vertices[v as usize];
            let same =
                |&w: &u32| w < v && into[w as usize] == w && (self.vertices[w as usize] - p).norm() <= SAME_PLACE;
            if let Some(w) = cells.near(&p).into_iter().find(same) {
                into[v as usize] = w;
                welded += 1;
            }
        }
        self.repairs.welded_vertices = welded;
        self.merge(&into);
    }

    /// Closes narrow gaps between boundary edges: mutually nearest vertices, where a neighbour along the boundary is paired
    /// too or already shared.
    fn close_seams(&mut self) {
        let rims = boundary(self.vertices.len(), &self.faces);
        let on_rim = |v: &u32| !rims[*v as usize].is_empty();
        let reach: Vec<f64> = (0..rims.len())
            .map(|v| {
                let edge = |&w: &u32| (self.vertices[w as usize] - self.vertices[v]).norm();
                (SEAM_GAP.1 * rims[v].iter().map(edge).fold(f64::INFINITY, f64::min)).min(SEAM_GAP.0)
            })
            .collect();
        let cells = Cells::new(&self.vertices, (0..rims.len() as u32).filter(on_rim), SEAM_GAP.0);
        let beside = |v: u32, w: u32| self.faces.iter().any(|f| f.contains(&v) && f.contains(&w));
        let mut nearest = vec![u32::MAX; rims.len()];
        for v in (0..rims.len() as u32).filter(on_rim) {
            let p = self.vertices[v as usize];
            let distance = |w: u32| (self.vertices[w as usize] - p).norm();
            let best = cells
                .near(&p)
                .into_iter()
                .filter(|&w| w != v && distance(w) <= reach[v as usize].min(reach[w as usize]))
                .filter(|&w| !beside(v, w))
                .min_by(|&a, &b| distance(a).total_cmp(&distance(b)));
            nearest[v as usize] = best.unwrap_or(u32::MAX);
        }
        let partner = |v: u32| {
            let w = nearest[v as usize];
            (w != u32::MAX && nearest[w as usize] == v).then_some(w)
        };
        let mut into: Vec<u32> = (0..rims.len() as u32).collect();
        let mut places = self.vertices.clone();
        for v in 0..rims.len() as u32 {
            let Some(w) = partner(v).filter(|&w| v < w) else { continue };
            let along = rims[v as usize]
                .iter()
                .any(|&a| rims[w as usize].contains(&a) || partner(a).is_some_and(|b| rims[w as usize].contains(&b)));
            if along {
                let gap = (self.vertices[v as usize] - self.vertices[w as usize]).norm();
                places[v as usize] = (self.vertices[v as usize] + self.vertices[w as usize]) * 0.5;
                into[w as usize] = v;
                self.repairs.closed_seam_vertices += 1;
                self.repairs.widest_seam_m = self.repairs.widest_seam_m.max(gap);
            }
        }
        self.vertices = places;
        self.merge(&into);
    }

    fn vertex_name(&self, v: u32) -> u32 {
        self.vertex_origin[v as usize]
    }

    fn check_areas(&self) -> Result<()> {
        for (f, face) in self.faces.iter().enumerate() {
            let [a, b, c] = face.map(|v| self.vertices[v as usize]);
            let longest = (b - a).norm().max((c - b).norm()).max((a - c).norm());
            let twice_area = (b - a).cross(&(c - a)).norm();
            if twice_area <= SMALLEST_HEIGHT * longest * longest {
                return Err(Error::mesh(
                    &self.name,
                    format!("face {}", self.face_origin[f]),
                    format!("has area {:e} m² with longest side {longest:e} m", 0.5 * twice_area),
                    "remove or merge degenerate triangles in the program that wrote the garment",
                ));
            }
        }
        Ok(())
    }

    fn check_edges(&self) -> Result<()> {
        let sides = sides(&self.faces);
        let crowded: Vec<_> = sides.chunk_by(|a, b| a.0 == b.0).filter(|g| g.len() > 2).collect();
        let Some(first) = crowded.first() else { return Ok(()) };
        let [a, b] = first[0].0.map(|v| self.vertex_name(v));
        let faces: Vec<String> = first.iter().map(|s| self.face_origin[s.2 as usize].to_string()).collect();
        Err(Error::mesh(
            &self.name,
            format!("edge {a}-{b} (and {} more)", crowded.len() - 1),
            format!("belongs to {} faces: {}", first.len(), faces.join(", ")),
            "cut what is sewn on (pockets, collars, linings) off the garment, or delete the inner layer",
        ))
    }

    /// Gives each fan of faces around a vertex a vertex of its own.
    fn split_vertices(&mut self) {
        let mut around: Vec<Vec<u32>> = vec![Vec::new(); self.vertices.len()];
        for (f, face) in self.faces.iter().enumerate() {
            face.iter().for_each(|&v| around[v as usize].push(f as u32));
        }
        for (v, faces) in around.iter().enumerate() {
            let v = v as u32;
            let mut left = faces.clone();
            let mut fans: Vec<Vec<u32>> = Vec::new();
            while let Some(start) = left.pop() {
                let mut fan = vec![start];
                let mut at = 0;
                while at < fan.len() {
                    let here = self.faces[fan[at] as usize];
                    left.retain(|&f| {
                        let touches = self.faces[f as usize].iter().any(|&w| w != v && here.contains(&w));
                        if touches {
                            fan.push(f);
                        }
                        !touches
                    });
                    at += 1;
                }
                fans.push(fan);
            }
            // The largest fan keeps the vertex.
            fans.sort_by_key(|fan| (std::cmp::Reverse(fan.len()), fan[0]));
            for fan in fans.iter().skip(1) {
                let copy = self.vertices.len() as u32;
                self.vertices.push(self.vertices[v as usize]);
                self.vertex_origin.push(self.vertex_origin[v as usize]);
                for &f in fan {
                    self.faces[f as usize].iter_mut().filter(|w| **w == v).for_each(|w| *w = copy);
                }
                self.repairs.split_vertices += 1;
            }
        }
    }

    /// Turns faces until neighbours agree; in each piece the smaller part by area.
    fn orient(&mut self) -> Result<()> {
        let sides = sides(&self.faces);
        // (other face, whether both run along their edge in the same sense)
        let mut neighbours: Vec<Vec<(u32, bool, [u32; 2])>> = vec![Vec::new(); self.faces.len()];
        for group in sides.chunk_by(|a, b| a.0 == b.0) {
            if let &[(edge, s, f), (_, t, g)] = group {
                neighbours[f as usize].push((g, s == t, edge));
                neighbours[g as usize].push((f, s == t, edge));
            }
        }
        let areas = TriMesh { vertices: self.vertices.clone(), faces: self.faces.clone() }.face_areas();
        let mut turned: Vec<Option<bool>> = vec![None; self.faces.len()];
        for start in 0..self.faces.len() {
            if turned[start].is_some() {
                continue;
            }
            turned[start] = Some(false);
            let mut piece = vec![start as u32];
            let mut at = 0;
            while at < piece.len() {
                let f = piece[at] as usize;
                let own = turned[f] == Some(true);
                for &(g, same, edge) in &neighbours[f] {
                    let wanted = own ^ same;
                    match turned[g as usize] {
                        None => {
                            turned[g as usize] = Some(wanted);
                            piece.push(g);
                        }
                        Some(t) if t != wanted => {
                            let [a, b] = edge.map(|v| self.vertex_name(v));
                            let problem = format!(
                                "its faces {} and {} can not agree on a side: the surface is twisted like a Möbius strip",
                                self.face_origin[f], self.face_origin[g as usize]
                            );
                            let remedy = "cut the garment along this edge, or delete the part that closes the ring";
                            return Err(Error::mesh(&self.name, format!("edge {a}-{b}"), problem, remedy));
                        }
                        Some(_) => {}
                    }
                }
                at += 1;
            }
            let area = |state: bool| -> f64 {
                piece.iter().filter(|&&f| turned[f as usize] == Some(state)).map(|&f| areas[f as usize]).sum()
            };
            // The majority keeps its side.
            if area(true) > area(false) {
                piece.iter().for_each(|&f| turned[f as usize] = turned[f as usize].map(|t| !t));
            }
        }
        for f in 0..self.faces.len() {
            if turned[f] == Some(true) {
                self.turn(f);
                self.repairs.flipped_faces += 1;
            }
        }
        Ok(())
    }

    fn turn(&mut self, f: usize) {
        self.faces[f].swap(1, 2);
        if let Some(uv) = &mut self.uv {
            uv[f].swap(1, 2);
        }
    }

    /// Leaves out small pieces.
    fn keep_one_piece(&mut self) -> Result<()> {
        let adjacency = caphy_core::query::Adjacency::new(self.vertices.len(), &self.faces);
        let (piece_of, count) = adjacency.components();
        if count == 1 {
            return Ok(());
        }
        let areas = TriMesh { vertices: self.vertices.clone(), faces: self.faces.clone() }.face_areas();
        let mut sums = vec![0.0; count];
        self.faces.iter().zip(&areas).for_each(|(f, a)| sums[piece_of[f[0] as usize] as usize] += a);
        let best = (0..count).fold(0, |b, c| if sums[c] > sums[b] { c } else { b });
        let total: f64 = sums.iter().sum();
        let rest = 1.0 - sums[best] / total;
        if rest > SMALL_PIECE {
            let mut sorted = sums.clone();
            sorted.sort_by(|a, b| b.total_cmp(a));
            let list: Vec<String> = sorted.iter().take(6).map(|a| format!("{a:.4}")).collect();
            let second = (0..count)
                .filter(|&c| c != best)
                .fold(usize::MAX, |b, c| if b == usize::MAX || sums[c] > sums[b] { c } else { b });
            let face = self.faces.iter().position(|f| piece_of[f[0] as usize] as usize == second).unwrap_or(0);
            return Err(Error::mesh(
                &self.name,
                format!("piece of face {}", self.face_origin[face]),
                format!("the garment has {count} pieces of {} m²", list.join(", ")),
                "sew the pieces together (merge their boundary vertices), or give one garment a file",
            ));
        }
        self.repairs.dropped_pieces = count - 1;
        self.repairs.dropped_area_share = rest;
        let keep: Vec<bool> = self.faces.iter().map(|f| piece_of[f[0] as usize] as usize == best).collect();
        self.keep_faces(&keep);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A tube around the y axis, `rings` rings of 12 vertices, open at both ends.
    fn tube(rings: u32) -> TriMesh {
        let mut mesh = TriMesh::default();
        for i in 0..rings {
            for k in 0..12 {
                let (s, c) = (std::f64::consts::TAU * f64::from(k) / 12.0).sin_cos();
                mesh.vertices.push(Vec3::new(0.15 * c, 0.05 * f64::from(i), 0.15 * s));
            }
        }
        for i in 0..rings - 1 {
            for k in 0..12 {
                let (p, q) = (12 * i + k, 12 * i + (k + 1) % 12);
                mesh.faces.extend([[p, p + 12, q], [q, p + 12, q + 12]]);
            }
        }
        mesh
    }

    fn given(mesh: TriMesh) -> GivenMesh {
        GivenMesh { name: "tube".into(), mesh, uv: None }
    }

    fn manifold(mesh: &TriMesh) -> bool {
        caphy_core::query::hinges(&mesh.faces).1.is_empty()
    }

    #[test]
    fn a_sound_tube_stays_as_it_is() {
        let mesh = tube(4);
        let (out, repairs) = repair(given(mesh.clone())).unwrap();
        assert_eq!((out.mesh, repairs), (mesh, Repairs::default()));
    }

    #[test]
    fn triangles_of_their_own_vertices_are_welded_and_layout_corners_kept() {
        let mesh = tube(4);
        let soup = TriMesh {
            vertices: (0..mesh.faces.len()).flat_map(|f| mesh.corners(f)).collect(),
            faces: (0..mesh.faces.len() as u32).map(|f| [3 * f, 3 * f + 1, 3 * f + 2]).collect(),
        };
        let uv: Vec<[[f64; 2]; 3]> = (0..soup.faces.len()).map(|f| [[f as f64, 0.0], [0.0, 1.0], [2.0, 2.0]]).collect();
        let (out, repairs) = repair(GivenMesh { name: "tube".into(), mesh: soup, uv: Some(uv.clone()) }).unwrap();
        assert_eq!(out.mesh.vertices.len(), mesh.vertices.len());
        assert_eq!(repairs.welded_vertices, 3 * mesh.faces.len() - mesh.vertices.len());
        assert!(manifold(&out.mesh));
        assert_eq!(out.uv.unwrap(), uv);
    }

    #[test]
    fn an_open_seam_is_closed_and_measured() {
        // The ring of angle 0 is written twice, half a millimetre apart.
        let mut mesh = tube(4);
        let faces = mesh.faces.clone();
        for i in 0..4u32 {
            let p = mesh.vertices[12 * i as usize];
            mesh.vertices.push(p + Vec3::new(0.0, 0.0, 5e-4));
        }
        for (f, face) in faces.iter().enumerate() {
            // Faces of the first column use the copies.
            if (f / 2) % 12 == 0 {
                mesh.faces[f] = face.map(|v| if v % 12 == 0 { 48 + v / 12 } else { v });
            }
        }
        let (out, repairs) = repair(given(mesh)).unwrap();
        assert_eq!((repairs.closed_seam_vertices, repairs.welded_vertices), (4, 0));
        assert!((repairs.widest_seam_m - 5e-4).abs() < 1e-12);
        assert_eq!(caphy_core::query::boundary_loops(&out.mesh.faces).len(), 2);
    }

    #[test]
    fn flipped_faces_are_turned_and_layouts_with_them() {
        let mut mesh = tube(4);
        for f in [0, 5, 17] {
            mesh.faces[f].swap(0, 1);
        }
        let uv: Vec<[[f64; 2]; 3]> = (0..mesh.faces.len()).map(|_| [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]).collect();
        let (out, repairs) = repair(GivenMesh { name: "tube".into(), mesh, uv: Some(uv) }).unwrap();
        assert_eq!(repairs.flipped_faces, 3);
        assert!(manifold(&out.mesh));
        assert_eq!(out.uv.unwrap()[5], [[0.0, 0.0], [0.0, 1.0], [1.0, 0.0]]);
    }

    #[test]
    fn what_cannot_be_repaired_is_named() {
        let text = |mesh: TriMesh| repair(given(mesh)).unwrap_err().to_string();
        assert!(text(TriMesh::default()).contains("no faces"));
        let mut mesh = tube(4);
        mesh.vertices[7].z = f64::NAN;
        assert!(text(mesh).contains("vertex 7"));
        let mut mesh = tube(4);
        mesh.faces[3][1] = 4000;
        assert!(text(mesh).contains("face 3"));
        // A fin on an inner edge.
        let mut mesh = tube(4);
        mesh.vertices.push(Vec3::new(0.5, 0.1, 0.0));
        mesh.faces.push([12, 13, 48]);
        let fin = text(mesh);
        assert!(fin.contains("edge 12-13") && fin.contains("3 faces") && fin.contains("72"), "{fin}");
        // Two tubes.
        let mut mesh = tube(4);
        let other = tube(4);
        mesh.vertices.extend(other.vertices.iter().map(|p| p + Vec3::x()));
        mesh.faces.extend(other.faces.iter().map(|f| f.map(|v| v + 48)));
        assert!(text(mesh).contains("2 pieces"));
        // A tetrahedron has no opening.
        let vertices = vec![Vec3::zeros(), Vec3::x(), Vec3::y(), Vec3::z()];
        let closed = TriMesh { vertices, faces: vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]] };
        assert!(text(closed).contains("no opening"));
        // A needle.
        let mut mesh = tube(4);
        mesh.vertices.extend([Vec3::new(0.2, 0.3, 0.0), Vec3::new(0.3, 0.3, 0.0), Vec3::new(0.4, 0.3, 0.0)]);
        mesh.faces.push([48, 49, 50]);
        assert!(text(mesh).contains("face 72"));
    }

    #[test]
    fn a_moebius_strip_is_refused() {
        let mut mesh = TriMesh::default();
        for k in 0..20 {
            let a = std::f64::consts::TAU * f64::from(k) / 20.0;
            let (s, c) = a.sin_cos();
            for side in [-0.03, 0.03] {
                let (t, h) = (0.5 * a).sin_cos();
                let r = 0.2 + side * h;
                mesh.vertices.push(Vec3::new(r * c, side * t, r * s));
            }
        }
        for k in 0..20u32 {
            let (p, q) = (2 * k, 2 * k + 1);
            let (r, s) = if k == 19 { (1, 0) } else { (p + 2, q + 2) };
            mesh.faces.extend([[p, q, r], [q, s, r]]);
        }
        let text = repair(given(mesh)).unwrap_err().to_string();
        assert!(text.contains("edge") && text.contains("twisted"), "{text}");
    }

    #[test]
    fn a_button_is_left_out_and_a_touching_corner_split() {
        let mut mesh = tube(4);
        let n = mesh.vertices.len() as u32;
        let o = Vec3::new(0.2, 0.1, 0.0);
        mesh.vertices.extend([o, o + Vec3::y() * 0.01, o + Vec3::z() * 0.01]);
        mesh.faces.push([n, n + 1, n + 2]);
        // A flap that hangs on the hem by one corner.
        mesh.vertices.extend([Vec3::new(0.16, -0.02, 0.0), Vec3::new(0.15, -0.02, 0.01)]);
        mesh.faces.push([0, n + 3, n + 4]);
        let (out, repairs) = repair(given(mesh)).unwrap();
        assert_eq!((repairs.split_vertices, repairs.dropped_pieces), (1, 2));
        assert_eq!(out.mesh, tube(4));
        assert!(repairs.dropped_area_share > 0.0 && repairs.dropped_area_share < 0.01);
    }
}
