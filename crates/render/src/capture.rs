//! What a capture rig makes of surfaces: one outer mesh of its own triangles, with what no camera sees missing.
//!
//! Cameras all around measure depth. A point in front of what some camera sees there, and on the outer side of the surface nearest to
//! it, is free; points near what is seen and not free are inside: cloth has no back of its own, as if there were a body behind
//! it. Between the two lies the surface: on a grid, the distance to the nearest surface that is seen, free points
//! counting positive, and one vertex per cell that its zero level crosses ("surface nets", Gibson 1998). What is seen is at least a
//! cell thick: cloth keeps its border where a camera looks under it into a gap that the grid does not resolve. Surfaces that touch
//! merge, as in real scans; where nothing is seen the mesh is open.

use crate::cameras::{Projection, fibonacci_directions, frame};
use crate::raster::{ZBuffer, barycentric_unclamped, corners, to_camera};
use caphy_core::mesh::bounds;
use caphy_core::query::{NearestSurface, PseudoNormals, SurfacePoint, TriangleFeature};
use caphy_core::segmenter::{Camera, NO_TRIANGLE};
use caphy_core::{Error, Result, TriMesh, Vec3};
use rayon::prelude::*;
use std::collections::HashMap;

/// A rig.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rig {
    /// Cameras, spread evenly between [`LOWEST`] and [`HIGHEST`] around the subject.
    pub cameras: usize,
    /// Width and height of a depth image [pixels].
    pub pixels: usize,
    /// Cell of the grid on which depths are fused [m]: about the mean edge of the mesh.
    pub cell_m: f64,
}

/// Where a vertex of a captured mesh comes from: the nearest point of a surface that is seen.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Origin {
    /// Number of the part.
    pub part: u32,
    /// Its face.
    pub face: u32,
    /// Weights of the face's corners.
    pub barycentric: [f64; 3],
}

/// A captured surface, before noise.
#[derive(Debug, Clone, PartialEq)]
pub struct Captured {
    /// The mesh, counter-clockwise seen from outside.
    pub mesh: TriMesh,
    /// One per vertex.
    pub origins: Vec<Origin>,
}

/// A vertex belongs to a surface that is seen up to this distance [cells]; farther ones close gaps that no camera looks into.
pub const LARGEST_ERROR: f64 = 0.35;

/// Sines of the elevations between which cameras stand: a little below level, as far up as a scaffold goes. Nobody looks up a shirt.
pub const LOWEST: f64 = -0.25;
/// See [`LOWEST`].
pub const HIGHEST: f64 = 0.85;

/// Directions from the subject to the cameras.
fn directions(count: usize) -> Vec<Vec3> {
    fibonacci_directions(count)
        .into_iter()
        .map(|d| {
            let y = LOWEST + 0.5 * (d.y + 1.0) * (HIGHEST - LOWEST);
            let level = Vec3::new(d.x, 0.0, d.z).try_normalize(0.0).unwrap_or_else(Vec3::z);
            level * (1.0 - y * y).sqrt() + Vec3::y() * y
        })
        .collect()
}

/// Depth images of all parts together, each with the place of every face.
struct Images<'a> {
    camera: &'a Camera,
    points: Vec<Vec3>,
    triangle: Vec<u32>,
}

impl Images<'_> {
    /// Whether a point lies in front of what its pixel shows. Depth is that of the shown triangle's plane right behind the point,
    /// so that pixels need not be small against the distance.
    fn sees(&self, point: &Vec3, faces: &[[u32; 3]]) -> bool {
        let (x, y, depth) = self.camera.project(point);
        let (width, height) = (self.camera.width, self.camera.height);
        if !(x >= 0.0 && y >= 0.0 && x < width as f64 && y < height as f64 && depth > 0.0) {
            return false;
        }
        let id = self.triangle[y as usize * width + x as usize];
        let Some(face) = faces.get(id as usize) else {
            return id == NO_TRIANGLE;
        };
        let corners = corners(&self.points, face);
        let weights = barycentric_unclamped(&corners, [x, y], self.camera);
        let plane: f64 = weights.iter().zip(&corners).map(|(w, c)| w * c.z).sum();
        // Far off a slanted triangle its plane says nothing: what is measured ends with it.
        let (near, far) = corners.iter().fold((f64::INFINITY, 0.0f64), |(a, b), c| (a.min(c.z), b.max(c.z)));
        plane.is_finite() && depth < plane.clamp(near, far)
    }
}

impl Rig {
    /// Captures parts (body, garments) that lie around and over each other.
    ///
    /// Deterministic on any number of threads. No vertex lies farther than [`LARGEST_ERROR`] cells from a seen surface.
    ///
    /// # Errors
    /// [`Error::Mesh`] where there is nothing to see, or a part names a vertex that is missing or not finite; [`Error::Parameter`]
    /// for a cell that is not positive, or so small that the grid has more than 2²⁰ cells along an axis.
    pub fn capture(&self, parts: &[&TriMesh]) -> Result<Captured> {
        let (all, first_face) = together(parts);
        all.check("surface to capture")?;
        let Some((low, high)) = bounds(&all.vertices) else {
            return Err(Error::mesh("surface to capture", "vertices", "there are none", "give at least one part"));
        };
        let cells = (high - low).max() / self.cell_m;
        if !(self.cell_m > 0.0 && cells < MOST_CELLS) {
            return Err(Error::Parameter {
                name: "cell of the capture grid".into(),
                value: self.cell_m,
                lower: (high - low).max() / MOST_CELLS,
                upper: f64::INFINITY,
                unit: "m".into(),
            });
        }
        let cameras: Vec<Camera> = directions(self.cameras)
            .iter()
            .map(|from| frame((low, high), from, Projection::Orthographic, self.pixels, self.pixels))
            .collect();
        let images: Vec<Images<'_>> = cameras
            .par_iter()
            .map(|camera| {
                let points = to_camera(&all.vertices, camera);
                let mut buffer = ZBuffer::new(camera.width, camera.height);
                buffer.draw(&points, &all.faces, camera, 0);
                Images { camera, points, triangle: buffer.triangle }
            })
            .collect();
        let mut seen = vec![false; all.faces.len()];
        for id in images.iter().flat_map(|i| &i.triangle).filter(|id| **id != NO_TRIANGLE) {
            seen[*id as usize] = true;
        }
        let visible: Vec<u32> = (0..all.faces.len() as u32).filter(|&f| seen[f as usize]).collect();
        let faces: Vec<[u32; 3]> = visible.iter().map(|&f| all.faces[f as usize]).collect();
        let surface = NearestSurface::new(&all.vertices, &faces)?;
        let origin = |point: &Vec3| -> Option<(Origin, f64)> {
            let found = surface.nearest(point)?;
            let face = visible[found.face as usize];
            let part = first_face.partition_point(|&first| first <= face) - 1;
            let origin = Origin { part: part as u32, face: face - first_face[part], barycentric: found.barycentric };
            Some((origin, found.squared_distance.sqrt()))
        };

        let grid = Grid { low: low - Vec3::repeat(2.0 * self.cell_m), cell: self.cell_m };
        let nodes = grid.around(&all.vertices, &faces);
        let normals = PseudoNormals::new(&all.vertices, &faces);
        let border = Border::new(&faces);
        let sheets = sheets(&all.vertices, &faces, &visible, &first_face)?;
        // Distance to what is seen, if the point is no farther than a cell behind it: one of the two ends of each of the grid's
        // edges that cross a sheet is.
        let behind = |point: &Vec3| -> Option<f64> {
            let backs = sheets.iter().filter_map(|(first, sheet)| {
                let mut nearest = sheet.nearest_within(point, self.cell_m * self.cell_m)?;
                nearest.face += first;
                let signed = normals.signed_distance(point, &nearest);
                (signed < 0.0 && !border.holds(&nearest)).then_some(-signed)
            });
            backs.min_by(f64::total_cmp)
        };
        let values: Vec<f64> = nodes
            .par_iter()
            .map(|&node| {
                let point = grid.place(node);
                let Some(nearest) = surface.nearest(&point) else { return f64::INFINITY };
                let signed = normals.signed_distance(&point, &nearest);
                // Beside an open border there is no outer side.
                let outside = signed > 0.0 || border.holds(&nearest);
                match behind(&point) {
                    Some(depth) => -depth,
                    None if outside && images.iter().any(|image| image.sees(&point, &all.faces)) => signed.abs(),
                    None => -signed.abs(),
                }
            })
            .collect();
        let net = grid.net(&nodes, &values);
        let origins: Vec<Option<(Origin, f64)>> = net.vertices.par_iter().map(origin).collect();
        let keep: Vec<bool> =
            origins.iter().map(|o| o.is_some_and(|(_, distance)| distance <= LARGEST_ERROR * self.cell_m)).collect();
        let (mesh, old) = net.submesh(&keep);
        let origins = old.iter().filter_map(|&v| origins[v as usize].map(|o| o.0)).collect();
        Ok(Captured { mesh, origins })
    }
}

/// Where faces end.
struct Border<'a> {
    faces: &'a [[u32; 3]],
    /// Whether each side of a face is its own alone.
    sides: Vec<[bool; 3]>,
    vertices: std::collections::HashSet<u32>,
}

impl<'a> Border<'a> {
    fn new(faces: &'a [[u32; 3]]) -> Self {
        let edge = |f: &[u32; 3], k: usize| [f[k].min(f[(k + 1) % 3]), f[k].max(f[(k + 1) % 3])];
        let mut count: HashMap<[u32; 2], u32> = HashMap::new();
        for face in faces {
            (0..3).for_each(|k| *count.entry(edge(face, k)).or_default() += 1);
        }
        let sides: Vec<[bool; 3]> = faces.iter().map(|f| [0, 1, 2].map(|k| count[&edge(f, k)] == 1)).collect();
        let ends = |(face, sides): (&[u32; 3], &[bool; 3])| -> Vec<u32> {
            (0..3).filter(|&k| sides[k]).flat_map(|k| [face[k], face[(k + 1) % 3]]).collect()
        };
        let vertices = faces.iter().zip(&sides).flat_map(ends).collect();
        Self { faces, sides, vertices }
    }
    fn holds(&self, point: &SurfacePoint) -> bool {
        let face = point.face as usize;
        match point.feature {
            TriangleFeature::Inside => false,
            TriangleFeature::Side(k) => self.sides[face][k as usize],
            TriangleFeature::Corner(k) => self.vertices.contains(&self.faces[face][k as usize]),
        }
    }
}

/// What is seen of each part, and the number of its first face among all that are seen.
fn sheets(
    vertices: &[Vec3],
    faces: &[[u32; 3]],
    visible: &[u32],
    first_face: &[u32],
) -> Result<Vec<(u32, NearestSurface)>> {
    let starts: Vec<usize> = first_face.iter().map(|first| visible.partition_point(|f| f < first)).collect();
    let ends = starts.iter().skip(1).copied().chain([faces.len()]);
    let parts = starts.iter().copied().zip(ends).filter(|(start, end)| start < end);
    parts.map(|(start, end)| Ok((start as u32, NearestSurface::new(vertices, &faces[start..end])?))).collect()
}

/// Cells along an axis that a key has room for.
const MOST_CELLS: f64 = (1 << 20) as f64;

/// All parts as one mesh, and the first face of each.
fn together(parts: &[&TriMesh]) -> (TriMesh, Vec<u32>) {
    let mut all = TriMesh::default();
    let mut first = Vec::new();
    for part in parts {
        let offset = all.vertices.len() as u32;
        first.push(all.faces.len() as u32);
        all.faces.extend(part.faces.iter().map(|f| f.map(|id| id + offset)));
        all.vertices.extend_from_slice(&part.vertices);
    }
    (all, first)
}

/// A grid without bounds.
struct Grid {
    low: Vec3,
    cell: f64,
}

/// A node by its place along the axes, 21 bits each, x lowest.
type Key = u64;

const AXIS: [Key; 3] = [1, 1 << 21, 1 << 42];

fn key(at: [u32; 3]) -> Key {
    (0..3).map(|k| AXIS[k] * Key::from(at[k])).sum()
}

impl Grid {
    fn place(&self, node: Key) -> Vec3 {
        self.low + Vec3::from_fn(|k, _| ((node >> (21 * k)) & 0x1f_ffff) as f64) * self.cell
    }

    /// Corners of all cells that the boxes of faces reach into, sorted.
    fn around(&self, vertices: &[Vec3], faces: &[[u32; 3]]) -> Vec<Key> {
        let mut nodes: Vec<Key> = Vec::new();
        for face in faces {
            let corners = face.map(|v| (vertices[v as usize] - self.low) / self.cell);
            let from = corners[0].inf(&corners[1]).inf(&corners[2]).map(|c| c.floor() as u32);
            let to = corners[0].sup(&corners[1]).sup(&corners[2]).map(|c| c.floor() as u32 + 1);
            for z in from.z..=to.z {
                for y in from.y..=to.y {
                    nodes.extend((from.x..=to.x).map(|x| key([x, y, z])));
                }
            }
        }
        nodes.par_sort_unstable();
        nodes.dedup();
        nodes
    }

    /// The zero level: a vertex in each whole cell that it crosses, in the middle of its crossings of the cell's edges, a quad
    /// around each crossed edge whose four cells are whole. Positive values are outside.
    fn net(&self, nodes: &[Key], values: &[f64]) -> TriMesh {
        let value: HashMap<Key, f64> = nodes.iter().copied().zip(values.iter().copied()).collect();
        let mut mesh = TriMesh::default();
        let mut vertex: HashMap<Key, u32> = HashMap::new();
        for &node in nodes {
            let at: [Option<f64>; 8] = std::array::from_fn(|c| value.get(&(node + corner(c))).copied());
            let mut corner_values = [0.0; 8];
            let whole = at.iter().zip(&mut corner_values).all(|(from, to)| from.map(|v| *to = v).is_some());
            let inside = corner_values.iter().filter(|v| **v < 0.0).count();
            if !whole || inside == 0 || inside == 8 {
                continue;
            }
            let (mut sum, mut count) = (Vec3::zeros(), 0.0);
            for a in 0..8usize {
                for k in (0..3).filter(|k| a & (1 << k) == 0) {
                    let b = a | (1 << k);
                    let (f, g) = (corner_values[a], corner_values[b]);
                    if (f < 0.0) != (g < 0.0) {
                        let (p, q) = (self.place(node + corner(a)), self.place(node + corner(b)));
                        sum += p.lerp(&q, f / (f - g));
                        count += 1.0;
                    }
                }
            }
            vertex.insert(node, mesh.vertices.len() as u32);
            mesh.vertices.push(sum / count);
        }
        for &node in nodes {
            let Some(here) = value.get(&node) else { continue };
            for k in 0..3 {
                let Some(there) = value.get(&(node + AXIS[k])) else { continue };
                if (*here < 0.0) == (*there < 0.0) {
                    continue;
                }
                let (u, v) = (AXIS[(k + 1) % 3], AXIS[(k + 2) % 3]);
                // Cells around the edge, counter-clockwise seen from its end; none lies before the grid, whose first layer is empty.
                let around = [0, u, u + v, v].map(|back| vertex.get(&node.wrapping_sub(back)).copied());
                let [Some(a), Some(b), Some(c), Some(d)] = around else { continue };
                // From cell (0, 0) back along u, u + v, v: this runs clockwise about +k.
                let ring = if *here < 0.0 { [a, b, c, d] } else { [a, d, c, b] };
                let length = |p: u32, q: u32| (mesh.vertices[p as usize] - mesh.vertices[q as usize]).norm_squared();
                let [a, b, c, d] = ring;
                let halves = if length(a, c) <= length(b, d) { [[a, b, c], [a, c, d]] } else { [[a, b, d], [b, c, d]] };
                mesh.faces.extend(halves);
            }
        }
        mesh
    }
}

/// Key of a cell's corner from that of its first.
fn corner(c: usize) -> Key {
    (0..3).filter(|k| c & (1 << k) != 0).map(|k| AXIS[k]).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use caphy_core::query::hinges;

    /// A sphere of latitudes and longitudes.
    fn sphere(centre: Vec3, radius: f64, rings: u32) -> TriMesh {
        let around = 2 * rings;
        let mut mesh = TriMesh::default();
        for i in 0..=rings {
            let polar = std::f64::consts::PI * f64::from(i) / f64::from(rings);
            for j in 0..around {
                let turn = std::f64::consts::TAU * f64::from(j) / f64::from(around);
                let out = Vec3::new(polar.sin() * turn.cos(), polar.cos(), polar.sin() * turn.sin());
                mesh.vertices.push(centre + radius * out);
            }
        }
        for i in 0..rings {
            for j in 0..around {
                let id = |i: u32, j: u32| i * around + j % around;
                let [a, b, c, d] = [id(i, j), id(i, j + 1), id(i + 1, j + 1), id(i + 1, j)];
                if i > 0 {
                    mesh.faces.push([a, b, c]);
                }
                if i + 1 < rings {
                    mesh.faces.push([a, c, d]);
                }
            }
        }
        mesh
    }

    const RIG: Rig = Rig { cameras: 24, pixels: 256, cell_m: 0.02 };

    /// Of the triangles' chords of 16 mm 0.1 mm; of points of the surface that are a cell's diagonal apart (√3 · 20 mm)²/(8 · 0.3 m) =
    /// 0.5 mm; of distances along a cell's edge between its ends (20 mm)²/(8 · 0.3 m) = 0.17 mm.
    const SAG: f64 = 0.77e-3;

    fn radius(mesh: &TriMesh, centre: Vec3) -> Vec<f64> {
        mesh.vertices.iter().map(|v| (v - centre).norm()).collect()
    }

    #[test]
    fn a_sphere_is_captured_whole_outward_and_on_its_surface() {
        let ball = sphere(Vec3::new(0.1, 0.9, -0.2), 0.3, 60);
        let captured = RIG.capture(&[&ball]).unwrap();
        let (mesh, centre) = (&captured.mesh, Vec3::new(0.1, 0.9, -0.2));
        for r in radius(mesh, centre) {
            assert!((r - 0.3).abs() < SAG, "{r}");
        }
        let (inner, bad) = hinges(&mesh.faces);
        assert!(bad.is_empty() && 2 * inner.len() == 3 * mesh.faces.len(), "closed");
        for f in 0..mesh.faces.len() {
            let [a, b, c] = mesh.corners(f);
            assert!((b - a).cross(&(c - a)).dot(&(a - centre)) > 0.0, "face {f} looks inward");
        }
        let area: f64 = mesh.face_areas().iter().sum();
        assert!((area / (4.0 * std::f64::consts::PI * 0.09) - 1.0).abs() < 0.01, "{area}");
        let edge = mesh.mean_edge_length();
        assert!((0.8..1.5).contains(&(edge / RIG.cell_m)), "{edge}");
        // Each vertex knows where it comes from; faces smaller than a pixel, such as those at the poles, may be missed.
        let pixel = 0.6 / 0.94 / 256.0;
        for (v, origin) in mesh.vertices.iter().zip(&captured.origins) {
            let corners = ball.corners(origin.face as usize);
            let at: Vec3 = corners.iter().zip(&origin.barycentric).map(|(c, w)| c * *w).sum();
            assert!(origin.part == 0 && (at - v).norm() < SAG + pixel);
        }
    }

    #[test]
    fn what_lies_inside_is_missing_and_what_sticks_out_is_there() {
        let centre = Vec3::zeros();
        let (inner, outer) = (sphere(centre, 0.28, 40), sphere(centre, 0.3, 60));
        let captured = RIG.capture(&[&inner, &outer]).unwrap();
        assert!(captured.origins.iter().all(|o| o.part == 1));
        assert!(radius(&captured.mesh, centre).iter().all(|r| *r > 0.295));
        // Cut open, the outer one shows the inner one, and its own inside where cameras look into it.
        let keep: Vec<bool> = outer.vertices.iter().map(|v| v.x < 0.2).collect();
        let (cup, _) = outer.submesh(&keep);
        let captured = RIG.capture(&[&inner, &cup]).unwrap();
        let count = |part| captured.origins.iter().filter(|o| o.part == part).count();
        assert!(count(0) > 100 && count(1) > 1000, "{} {}", count(0), count(1));
        for (v, o) in captured.mesh.vertices.iter().zip(&captured.origins).filter(|(_, o)| o.part == 0) {
            // The deepest ray past the rim touches the inner sphere acos(0.28 / 0.3) farther round than the rim, at x = 0.0994.
            assert!(v.x > 0.0994 - LARGEST_ERROR * RIG.cell_m, "{v:?} {o:?} cannot be seen");
        }
        for (r, o) in radius(&captured.mesh, centre).iter().zip(&captured.origins) {
            let truth = if o.part == 0 { 0.28 } else { 0.3 };
            assert!((r - truth).abs() < LARGEST_ERROR * RIG.cell_m + SAG, "{r}");
        }
    }

    #[test]
    fn cloth_over_a_gap_that_the_grid_does_not_resolve_ends_where_it_ends() {
        // Three quarters of a cell above the inner sphere, open at x = 0.2; cameras look under the rim.
        let (inner, outer) = (sphere(Vec3::zeros(), 0.285, 60), sphere(Vec3::zeros(), 0.3, 60));
        let keep: Vec<bool> = outer.vertices.iter().map(|v| v.x < 0.2).collect();
        let (cup, _) = outer.submesh(&keep);
        let captured = RIG.capture(&[&inner, &cup]).unwrap();
        let rim = cup.vertices.iter().map(|v| v.x).fold(f64::NEG_INFINITY, f64::max);
        // The rim is a zigzag of the edges' 16 mm; a vertex lies somewhere in its cell.
        let farthest = 0.016 + 3f64.sqrt() * RIG.cell_m;
        let skin = captured.mesh.vertices.iter().zip(&captured.origins).filter(|(_, o)| o.part == 0);
        let under = skin.map(|(v, _)| rim - v.x).fold(f64::NEG_INFINITY, f64::max);
        assert!(under < farthest, "{under} under cloth");
    }

    #[test]
    fn spheres_that_touch_become_one_surface() {
        let (a, b) = (sphere(Vec3::zeros(), 0.2, 40), sphere(Vec3::new(0.39, 0.0, 0.0), 0.2, 40));
        let captured = RIG.capture(&[&a, &b]).unwrap();
        let adjacency = caphy_core::query::Adjacency::new(captured.mesh.vertices.len(), &captured.mesh.faces);
        assert_eq!(adjacency.components().1, 1);
        let deep = captured.mesh.vertices.iter().filter(|v| {
            let (a, b) = (v.norm(), (*v - Vec3::new(0.39, 0.0, 0.0)).norm());
            a < 0.2 - 0.5 * RIG.cell_m || b < 0.2 - 0.5 * RIG.cell_m
        });
        assert_eq!(deep.count(), 0, "what lies in the other sphere is not seen");
    }

    #[test]
    fn the_same_bits_on_any_number_of_threads() {
        let ball = sphere(Vec3::zeros(), 0.3, 30);
        let on = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| RIG.capture(&[&ball]).unwrap())
        };
        assert!(on(1) == on(2));
    }

    #[test]
    fn nothing_to_see_and_grids_without_end_are_refused() {
        assert!(RIG.capture(&[]).unwrap_err().to_string().contains("none"));
        let ball = sphere(Vec3::zeros(), 0.3, 6);
        for cell_m in [0.0, f64::NAN, 1e-8] {
            assert!(Rig { cell_m, ..RIG }.capture(&[&ball]).unwrap_err().to_string().contains("cell"));
        }
    }
}
