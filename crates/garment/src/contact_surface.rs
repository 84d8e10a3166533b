//! Contact with points of the body's triangles instead of with its vertices.
//!
//! The nearest vertex's tangent plane stands off a round limb between its vertices and jumps from one vertex to the next. Here each
//! garment vertex meets the nearest point of the triangles around its nearest body vertex, with the normal interpolated
//! there: planes turn smoothly while cloth slides. Costs six triangles per vertex and frame.

use crate::energy::BodyState;
use caphy_core::lanes::Frames;
use caphy_core::query::{Fans, nearest_on_triangle};
use caphy_core::{Error, Real, Result, Vec3};
use rayon::prelude::*;

/// The body's triangles, by vertex.
#[derive(Debug, Clone, PartialEq)]
pub struct ContactSurface {
    faces: Vec<[u32; 3]>,
    around: Fans,
}

/// One point of the body, with its normal, for each garment vertex: a body of as many vertices as the garment.
#[derive(Debug, Clone)]
pub struct ContactPoints<T> {
    positions: Frames<T>,
    normals: Frames<T>,
    /// Each garment vertex its own.
    nearest: Vec<u32>,
}

impl<T: Real> ContactPoints<T> {
    /// What the collision term takes.
    pub fn state(&self) -> BodyState<'_, T> {
        BodyState { positions: &self.positions, normals: &self.normals, nearest: Some(&self.nearest) }
    }
}

impl ContactSurface {
    /// For a body's triangles.
    ///
    /// # Errors
    /// [`Error::Mesh`] naming the face with a vertex that is not there.
    pub fn new(vertex_count: usize, faces: &[[u32; 3]]) -> Result<Self> {
        for (f, face) in faces.iter().enumerate() {
            if let Some(v) = face.iter().find(|v| **v as usize >= vertex_count) {
                let problem = format!("names vertex {v} of {vertex_count}");
                return Err(Error::mesh("body", format!("face {f}"), problem, "give the faces of the posed part"));
            }
        }
        Ok(Self { faces: faces.to_vec(), around: Fans::new(vertex_count, faces) })
    }

    /// Where each garment vertex meets the body whose vertex it is nearest to; `nearest` as [`crate::contact::ContactMap::nearest`]
    /// writes it. Vertices without triangles meet themselves.
    ///
    /// # Errors
    /// [`Error::Length`] for shapes that do not fit.
    pub fn points<T: Real>(
        &self,
        garment: &Frames<T>,
        body: &Frames<T>,
        normals: &Frames<T>,
        nearest: &[u32],
    ) -> Result<ContactPoints<T>> {
        let (blocks, n, lanes) = (garment.blocks(), garment.vertices(), garment.lanes_used());
        Error::check_length(
            "nearest body vertices, [block][garment vertex][lane]",
            blocks * n * T::LANES,
            nearest.len(),
        )?;
        Error::check_length("body frames of contact", garment.frames(), body.frames())?;
        Error::check_length("body normals of contact", body.data().len(), normals.data().len())?;
        let mut out = ContactPoints {
            positions: Frames::zeros(blocks, n, lanes),
            normals: Frames::zeros(blocks, n, lanes),
            nearest: (0..blocks * n * T::LANES).map(|i| (i / T::LANES % n.max(1)) as u32).collect(),
        };
        let row = 3 * T::LANES;
        if n == 0 {
            return Ok(out);
        }
        let length = out.positions.block_len();
        let tasks = out.positions.data_mut().par_chunks_mut(length).zip(out.normals.data_mut().par_chunks_mut(length));
        tasks.enumerate().for_each(|(block, (points, outward))| {
            for v in 0..n {
                for lane in 0..lanes {
                    let id = nearest[(block * n + v) * T::LANES + lane];
                    let (at, normal) = self.meeting(&garment.get(block, lane, v), id, |b| {
                        (body.get(block, lane, b), normals.get(block, lane, b))
                    });
                    // Spare lanes repeat the last frame.
                    let end = if lane + 1 == lanes { T::LANES } else { lane + 1 };
                    for l in lane..end {
                        for axis in 0..3 {
                            points[v * row + axis * T::LANES + l] = T::of(at[axis]);
                            outward[v * row + axis * T::LANES + l] = T::of(normal[axis]);
                        }
                    }
                }
            }
        });
        Ok(out)
    }

    /// The nearest point of the triangles around a vertex, and the normal there.
    fn meeting(&self, p: &Vec3, vertex: u32, body: impl Fn(usize) -> (Vec3, Vec3)) -> (Vec3, Vec3) {
        let own = body(vertex as usize);
        let mut best = ((own.0 - p).norm_squared(), own.0, own.1);
        // Vertices behind the body's, such as another garment's, have no faces here.
        for &face in self.around.of(vertex as usize) {
            let corners = self.faces[face as usize].map(|v| body(v as usize));
            let found = nearest_on_triangle(p, &corners.map(|c| c.0));
            if found.squared_distance < best.0 {
                let [a, b, c] = found.barycentric;
                let normal = a * corners[0].1 + b * corners[1].1 + c * corners[2].1;
                // Opposite normals of a folded body cancel: the vertex's own then.
                best = (found.squared_distance, found.point, normal.try_normalize(1e-6).unwrap_or(own.1));
            }
        }
        (best.1, best.2)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::energy::frame_normals;

    /// A cylinder of radius 1 about z with `n` vertices around, two rings, and points outside of it.
    fn cylinder(n: u32) -> (Vec<Vec3>, Vec<[u32; 3]>) {
        let ring = |z: f64| {
            (0..n).map(move |i| {
                let angle = std::f64::consts::TAU * f64::from(i) / f64::from(n);
                Vec3::new(angle.cos(), angle.sin(), z)
            })
        };
        let vertices = ring(0.0).chain(ring(1.0)).collect();
        let faces = (0..n)
            .flat_map(|i| {
                let j = (i + 1) % n;
                [[i, j, n + i], [j, n + j, n + i]]
            })
            .collect();
        (vertices, faces)
    }

    #[test]
    fn between_vertices_the_surface_is_met_and_its_normal_turns() {
        let n = 24;
        let (body, faces) = cylinder(n);
        let surface = ContactSurface::new(body.len(), &faces).unwrap();
        let half = std::f64::consts::PI / f64::from(n);
        let mut skin = Frames::<f64>::zeros(1, body.len(), 2);
        let mut cloth = Frames::<f64>::zeros(1, 2, 2);
        for lane in 0..2 {
            // The second frame is turned: answers turn with it.
            let turn = nalgebra::Rotation3::new(Vec3::new(0.3, -0.2, 0.9) * lane as f64);
            skin.set_frame(0, lane, &body.iter().map(|p| turn * p).collect::<Vec<_>>()).unwrap();
            let points = [Vec3::new(half.cos(), half.sin(), 0.4) * 1.1, Vec3::new(1.2, 0.0, 0.0)];
            cloth.set_frame(0, lane, &points.map(|p| turn * p)).unwrap();
        }
        let normals = frame_normals(&skin, &faces).unwrap();
        let lanes = <f64 as Real>::LANES;
        let nearest: Vec<u32> = (0..2).flat_map(|_| vec![0u32; lanes]).collect();
        let found = surface.points(&cloth, &skin, &normals, &nearest).unwrap();
        let state = found.state();
        for lane in 0..2 {
            let (at, normal) = (state.positions.get(0, lane, 0), state.normals.get(0, lane, 0));
            let p = cloth.get(0, lane, 0);
            // The chord between two vertices lies cos(half) from the axis, and is met at a right angle.
            let axis = nalgebra::Rotation3::new(Vec3::new(0.3, -0.2, 0.9) * lane as f64) * Vec3::z();
            let from_axis = at - axis * axis.dot(&at);
            assert!((from_axis.norm() - half.cos()).abs() < 1e-12, "{}", from_axis.norm());
            assert!(((p - at).norm() - (1.1 - half.cos())).abs() < 1e-12);
            assert!(normal.dot(&(p - at)) > 0.99 * (p - at).norm());
            // A vertex is met where it is.
            assert!((state.positions.get(0, lane, 1) - skin.get(0, lane, 0)).norm() < 1e-15);
        }
        // Another garment's vertices behind the body's have no triangles: they are met themselves.
        assert!(surface.around.of(2 * n as usize + 5).is_empty());
        assert!(ContactSurface::new(3, &[[0, 1, 3]]).unwrap_err().to_string().contains("face 0"));
        assert!(surface.points(&cloth, &skin, &normals, &nearest[1..]).is_err());
    }
}
