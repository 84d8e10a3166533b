//! Vertex normals of many frames in lanes.

use super::{MAX_LANES, add_row, row};
use caphy_core::lanes::Frames;
use caphy_core::{Error, Real, Result, simd_kernel};
use rayon::prelude::*;

/// Area-weighted unit vertex normals of each frame; zero for a vertex without area.
///
/// # Errors
/// [`Error::Mesh`] for a face that names a vertex that the frames do not have.
pub fn frame_normals<T: Real>(positions: &Frames<T>, faces: &[[u32; 3]]) -> Result<Frames<T>> {
    let mut out = Frames::zeros(positions.blocks(), positions.vertices(), positions.lanes_used());
    frame_normals_into(positions, faces, &mut out)?;
    Ok(out)
}

/// [`frame_normals`] into frames of the same shape, whatever they held.
///
/// # Errors
/// As [`frame_normals`]; [`Error::Length`] for another shape.
pub fn frame_normals_into<T: Real>(positions: &Frames<T>, faces: &[[u32; 3]], out: &mut Frames<T>) -> Result<()> {
    let n = positions.vertices();
    if let Some(face) = faces.iter().position(|f| f.iter().any(|&id| id as usize >= n)) {
        let problem = format!("names vertices {:?} but the frames have {n}", faces[face]);
        return Err(Error::mesh("posed mesh", format!("face {face}"), problem, "give the faces of the posed part"));
    }
    Error::check_length("vertices of normals", n, out.vertices())?;
    super::check_same_frames("normals", positions, out)?;
    let block_len = out.block_len();
    if block_len > 0 {
        out.data_mut()
            .par_chunks_mut(block_len)
            .enumerate()
            .for_each(|(block, normals)| block_normals(faces, positions.block(block), normals));
    }
    Ok(())
}

simd_kernel! {
    /// Sums face normals at their corners, then normalises.
    fn block_normals<T>(faces: &[[u32; 3]], x: &[T], normals: &mut [T]) {
        let lanes = T::LANES;
        normals.fill(T::zero());
        for face in faces {
            let (a, b, c) = (row(x, face[0]), row(x, face[1]), row(x, face[2]));
            let mut n = [T::zero(); 3 * MAX_LANES];
            for l in 0..lanes {
                let (i, j) = (lanes + l, 2 * lanes + l);
                let (ux, uy, uz) = (b[l] - a[l], b[i] - a[i], b[j] - a[j]);
                let (vx, vy, vz) = (c[l] - a[l], c[i] - a[i], c[j] - a[j]);
                n[l] = uy * vz - uz * vy;
                n[i] = uz * vx - ux * vz;
                n[j] = ux * vy - uy * vx;
            }
            add_row(normals, face[0], &n);
            add_row(normals, face[1], &n);
            add_row(normals, face[2], &n);
        }
        for n in normals.chunks_exact_mut(3 * lanes) {
            for l in 0..lanes {
                let (i, j) = (lanes + l, 2 * lanes + l);
                let length = (n[l] * n[l] + n[i] * n[i] + n[j] * n[j]).sqrt();
                let scale = if length > T::zero() { T::one() / length } else { T::zero() };
                n[l] *= scale;
                n[i] *= scale;
                n[j] *= scale;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use caphy_core::Vec3;
    use caphy_core::mesh::vertex_normals;

    #[test]
    fn lanes_agree_with_the_mesh_function() {
        let faces = [[0, 1, 2], [2, 1, 3], [0, 2, 3]];
        let mut frames = Frames::<f64>::zeros(2, 5, 2);
        for frame in 0..4 {
            let points: Vec<Vec3> =
                (0..5).map(|i| Vec3::from_fn(|k, _| ((frame * 15 + i * 3 + k) as f64 * 1.7).sin())).collect();
            frames.set_frame(frame / 2, frame % 2, &points).unwrap();
        }
        let normals = frame_normals(&frames, &faces).unwrap();
        for frame in 0..4 {
            let expected = vertex_normals(&frames.frame(frame / 2, frame % 2), &faces);
            for (v, n) in expected.iter().enumerate() {
                assert!((normals.get(frame / 2, frame % 2, v) - n).norm() < 1e-14);
            }
        }
        let mut again = frames.clone();
        frame_normals_into(&frames, &faces, &mut again).unwrap();
        assert_eq!(again, normals);
        assert!(frame_normals(&frames, &[[0, 1, 5]]).is_err());
        assert!(frame_normals_into(&frames, &faces, &mut Frames::zeros(2, 5, 3)).is_err());
    }
}
